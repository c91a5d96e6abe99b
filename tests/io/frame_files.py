"""A made-up flight over a plot, as software and cameras state it: written here after their format
descriptions, from cameras on the ellipsoid; numpy, scipy and pyproj alone."""

import json
from pathlib import Path

import numpy as np
import pyproj
from PIL import Image
from scipy.spatial.transform import Rotation

CRS, ORIGIN, GROUND = "EPSG:32734", (262_000.0, 6_220_000.0), 312.4
"""The plot's corner, 3 degrees west of the middle of its zone: grid north is another than true."""
SIZE, FOCAL, CENTRE = (400, 300), (310.0, 306.0), (203.5, 147.0)
"""Columns and rows; focal lengths; column and row of the axis from the middle of the first [px]."""
RADIAL, TANGENTIAL = (-0.11, 0.03, -0.04), (0.002, -0.003)
SHOTS = {
    "DJI_0001.TIF": ((2.0, 3.0, 30.0), (0.0, 0.0, 0.0)),
    "DJI_0002.TIF": ((6.0, -12.0, 28.0), (-20.0, 25.0, 0.0)),
    "DJI_0003.TIF": ((14.0, 8.0, 33.0), (245.0, 18.0, 6.0)),
}
"""East, north of the corner and height above the ground [m]; yaw, pitch and roll from true north,
of a camera that looks straight down at zero."""
POINTS = np.array(
    [[0, 0, 0], [5, 0, 0], [5, 5, 0], [0, 5, 0], [2.5, 2.5, 1.0], [1.0, 4.0, 0.5]], float
)
"""East, north and height over the plot [m]."""

_DEGREES = pyproj.Transformer.from_crs(CRS, "EPSG:4326", always_xy=True)
_EARTH = pyproj.Transformer.from_crs("EPSG:4979", "EPSG:4978", always_xy=True)


def _factors(longitude, latitude):
    return pyproj.Proj(CRS).get_factors(longitude, latitude)


def geographic(point):
    """Longitude, latitude and height of a place over the plot."""
    longitude, latitude = _DEGREES.transform(ORIGIN[0] + point[0], ORIGIN[1] + point[1])
    return longitude, latitude, GROUND + point[2]


def local(longitude, latitude):
    """East, north and up there, one a row, in geocentric coordinates."""
    lon, lat = np.radians([longitude, latitude])
    east = [-np.sin(lon), np.cos(lon), 0.0]
    up = [np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)]
    return np.array([east, np.cross(up, east), up])


def axes_of(angles):
    """Right, down and ahead (rows) in east, north and up, by an aircraft's angles."""
    turn = Rotation.from_euler("ZYX", angles, degrees=True).as_matrix()
    to_local = np.array([[0, 1, 0], [1, 0, 0], [0, 0, -1]])  # of north, east and down
    forward, right, down = (to_local @ turn).T
    return np.stack([right, -forward, down])


def truth(name, points=POINTS):
    """Column and row of points over the plot, by a camera on the ellipsoid."""
    place, angles = SHOTS[name]
    longitude, latitude, height = geographic(place)
    camera = np.array(_EARTH.transform(longitude, latitude, height))
    found = []
    for point in points:
        away = np.array(_EARTH.transform(*geographic(point))) - camera
        x, y, z = axes_of(angles) @ local(longitude, latitude) @ away
        x, y = x / z, y / z
        r2 = x * x + y * y
        swollen = 1 + RADIAL[0] * r2 + RADIAL[1] * r2**2 + RADIAL[2] * r2**3
        p1, p2 = TANGENTIAL
        across = x * swollen + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
        down = y * swollen + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
        found.append((CENTRE[0] + FOCAL[0] * across, CENTRE[1] + FOCAL[1] * down))
    return np.array(found)


def on_grid(name):
    """Position and axes in the coordinates of the zone, in which its heights are as long as its
    metres."""
    (x, y, height), angles = SHOTS[name]
    factors = _factors(*geographic((x, y, 0.0))[:2])
    turn = np.radians(factors.meridian_convergence)
    c, s = np.cos(turn), np.sin(turn)
    axes = axes_of(angles) @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1.0]])
    z = GROUND + height * factors.meridional_scale
    return np.array([ORIGIN[0] + x, ORIGIN[1] + y, z]), axes


def write_odm(folder: Path) -> Path:
    report = folder / "odm_report"
    report.mkdir(parents=True, exist_ok=True)
    longer, (columns, rows) = max(SIZE), SIZE
    camera = {
        "projection_type": "brown", "width": columns, "height": rows,
        "focal_x": FOCAL[0] / longer, "focal_y": FOCAL[1] / longer,
        "c_x": (CENTRE[0] + 0.5 - columns / 2) / longer,
        "c_y": (CENTRE[1] + 0.5 - rows / 2) / longer,
        **dict(zip(("k1", "k2", "k3", "p1", "p2"), (*RADIAL, *TANGENTIAL), strict=True)),
    }  # fmt: skip
    (folder / "cameras.json").write_text(json.dumps({"v2 dji m3m 400 300 brown 0.6": camera}))
    features = []
    for name in SHOTS:
        position, axes = on_grid(name)
        features.append(
            {
                "type": "Feature",
                "properties": {
                    "filename": name, "focal": camera["focal_x"], "width": columns,
                    "height": rows, "translation": position.tolist(),
                    "rotation": Rotation.from_matrix(axes).as_rotvec().tolist(),
                },
                "geometry": {
                    "type": "Point",
                    "coordinates": [*_DEGREES.transform(*position[:2]), position[2]],
                },
            }
        )  # fmt: skip
    path = report / "shots.geojson"
    path.write_text(json.dumps({"type": "FeatureCollection", "features": features}, indent=1))
    return path


def write_pix4d(folder: Path) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    lines = ["imageName X Y Z Omega Phi Kappa"]
    cameras = [
        "fileName imageWidth imageHeight ", "camera matrix K [3x3]", "radial distortion [3x1]",
        "tangential distortion [2x1]", "camera position t [3x1]", "camera rotation R [3x3]",
        "camera model m = K [R|-Rt] X", "",
    ]  # fmt: skip
    matrix = [[FOCAL[0], 0, CENTRE[0] + 0.5], [0, FOCAL[1], CENTRE[1] + 0.5], [0, 0, 1]]
    for name in SHOTS:
        position, axes = on_grid(name)
        patb = np.stack([axes[0], -axes[1], -axes[2]], axis=1)  # right, up and back as columns
        omega = np.degrees(np.arctan2(-patb[1, 2], patb[2, 2]))
        phi = np.degrees(np.arcsin(patb[0, 2]))
        kappa = np.degrees(np.arctan2(-patb[0, 1], patb[0, 0]))
        lines.append(" ".join([name, *(f"{v:.9f}" for v in (*position, omega, phi, kappa))]))
        cameras.append(f"{name} {SIZE[0]} {SIZE[1]}")
        rows = (*matrix, RADIAL, TANGENTIAL, position - [*ORIGIN, 0.0], *axes)
        cameras += [" ".join(f"{v:.12f}" for v in row) for row in rows]
    external = folder / "fynbos_calibrated_external_camera_parameters.txt"
    external.write_text("\n".join(lines) + "\n")
    (folder / "fynbos_calibrated_camera_parameters.txt").write_text("\n".join(cameras) + "\n")
    (folder / "fynbos_wkt.prj").write_text(pyproj.CRS(CRS).to_wkt("WKT1_ESRI"))
    return external


def write_metashape(folder: Path, *, component: bool = False) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    turn = Rotation.from_euler("XYZ", [40.0, -70.0, 10.0], degrees=True).as_matrix()
    middle, scale = np.array(_EARTH.transform(*geographic((3.0, 3.0, 0.0)))), 2.5
    numbers = lambda values: " ".join(f"{v:.16g}" for v in np.ravel(values))  # noqa: E731
    whole = (
        f"<transform><rotation>{numbers(turn)}</rotation><translation>{numbers(middle)}"
        f"</translation><scale>{scale}</scale></transform>"
    )
    belongs = ' component_id="0"' if component else ""
    cameras = []
    for k, (name, (place, angles)) in enumerate(SHOTS.items()):
        longitude, latitude, height = geographic(place)
        centre = np.array(_EARTH.transform(longitude, latitude, height))
        matrix = np.eye(4)
        matrix[:3, :3] = turn.T @ (axes_of(angles) @ local(longitude, latitude)).T
        matrix[:3, 3] = turn.T @ (centre - middle) / scale
        cameras.append(
            f'<camera id="{k}" sensor_id="0"{belongs} label="{name}"><transform>{numbers(matrix)}'
            "</transform><orientation>1</orientation></camera>"
        )
    (columns, rows), (k1, k2, k3), (p1, p2) = SIZE, RADIAL, TANGENTIAL
    offset = CENTRE[0] + 0.5 - columns / 2, CENTRE[1] + 0.5 - rows / 2
    text = f"""<?xml version="1.0" encoding="UTF-8"?>
<document version="2.0.0"><chunk label="Chunk 1" enabled="true">
 <sensors next_id="1"><sensor id="0" label="M3M" type="frame">
  <resolution width="{columns}" height="{rows}"/>
  <calibration type="frame" class="initial"><f>999</f></calibration>
  <calibration type="frame" class="adjusted">
   <resolution width="{columns}" height="{rows}"/>
   <f>{FOCAL[1]}</f><cx>{offset[0]}</cx><cy>{offset[1]}</cy><b1>{FOCAL[0] - FOCAL[1]}</b1>
   <k1>{k1}</k1><k2>{k2}</k2><k3>{k3}</k3><p1>{p2}</p1><p2>{p1}</p2>
  </calibration></sensor></sensors>
 {f'<components><component id="0">{whole}</component></components>' if component else ""}
 <cameras next_id="4"><group id="0">{"".join(cameras[:1])}</group>{"".join(cameras[1:])}
  <camera id="3" sensor_id="0" label="not_aligned.TIF"/></cameras>
 <reference>{pyproj.CRS("EPSG:4326").to_wkt("WKT1_GDAL").replace('"', "&quot;")}</reference>
 {"" if component else whole}
</chunk></document>"""
    path = folder / "cameras.xml"
    path.write_text(text)
    return path


def write_picture(path: Path, xmp: str, gps: dict | None = None, mm=(1.0, 1.0)):
    """A picture with metadata; `mm`, columns and rows of its array in a mm."""
    tags = Image.Exif()
    tags[700] = (
        '<x:xmpmeta xmlns:x="adobe:ns:meta/"><rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-'
        f'syntax-ns#"><rdf:Description rdf:about="" {xmp}/></rdf:RDF></x:xmpmeta>'
    ).encode()
    tags.get_ifd(0x8769).update({0xA20E: mm[0], 0xA20F: mm[1], 0xA210: 4})
    tags[0x8769] = 0  # or the table of these is not written
    if gps is not None:
        tags.get_ifd(0x8825).update(gps)
        tags[0x8825] = 0
    Image.new("I;16", SIZE).save(path, exif=tags)


def write_dji_pictures(folder: Path, more: str = "") -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    for name, (place, angles) in SHOTS.items():
        longitude, latitude, height = geographic(place)
        # The gimbal's forward axis is the optical one: its pitch, and a roll about that axis.
        right, down, ahead = axes_of(angles)
        gimbal = np.stack([ahead, right, down], axis=1)[[1, 0, 2]] * [[1.0], [1.0], [-1.0]]
        yaw = angles[0]  # straight down yaw and roll are one: that of the aircraft is its yaw
        pitch, roll = angles[1] - 90.0, 0.0
        if angles[2]:
            yaw, pitch, roll = Rotation.from_matrix(gimbal).as_euler("ZYX", degrees=True)
        numbers = ",".join(map(str, (*FOCAL, 1.5, -2.0, *RADIAL[:2], *TANGENTIAL, RADIAL[2])))
        stated = {
            "GpsLatitude": f"{latitude:.10f}", "GpsLongitude": f"{longitude:.10f}",
            "AbsoluteAltitude": f"{height:+.3f}", "RelativeAltitude": f"{place[2]:+.3f}",
            "GimbalYawDegree": f"{yaw:+.6f}", "GimbalPitchDegree": f"{pitch:+.6f}",
            "GimbalRollDegree": f"{roll:+.6f}", "DewarpData": f"2022-06-08;{numbers}",
            "CalibratedOpticalCenterX": str(CENTRE[0] - 1.5),
            "CalibratedOpticalCenterY": str(CENTRE[1] + 2.0),
        }  # fmt: skip
        keys = " ".join(f'drone-dji:{key}="{value}"' for key, value in stated.items())
        about = f'xmlns:drone-dji="http://www.dji.com/drone-dji/1.0/" {keys} {more}'
        write_picture(folder / name, about)
    return folder


def write_micasense_pictures(folder: Path) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    mm = 250.0, 250.0 * FOCAL[1] / FOCAL[0]
    for name, (place, (yaw, pitch, roll)) in SHOTS.items():
        longitude, latitude, height = geographic(place)
        focal, centre = FOCAL[0] / mm[0], [c / m for c, m in zip(CENTRE, mm, strict=True)]
        stated = {
            "Yaw": yaw, "Pitch": pitch, "Roll": roll, "PerspectiveFocalLength": focal,
            "PrincipalPoint": ",".join(map(str, centre)),
            "PerspectiveDistortion": ",".join(map(str, (*RADIAL, *TANGENTIAL))),
        }  # fmt: skip
        keys = " ".join(f'Camera:{key}="{value}"' for key, value in stated.items())
        about = (
            'xmlns:DLS="http://micasense.com/DLS/1.0/" DLS:Yaw="1.7" DLS:Pitch="0.1" DLS:Roll="0" '
            f'xmlns:Camera="http://pix4d.com/camera/1.0/" {keys}'
        )
        degrees = lambda v: (int(abs(v)), int(abs(v) * 60 % 60), abs(v) * 3600 % 60)  # noqa: E731
        gps = {1: "S", 2: degrees(latitude), 3: "E", 4: degrees(longitude), 5: b"\0", 6: height}
        write_picture(folder / name, about, gps, mm=mm)
    return folder

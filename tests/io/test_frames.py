"""Poses and lenses of a flight's frames, as software and cameras state them: against projections of
ground points made by hand."""

import json
import re
from pathlib import Path

import numpy as np
import pyproj
import pytest

import fynjax as fx
from fynjax._core.errors import InputError
from fynjax.app.io.captures import read_view
from fynjax.app.io.captures._metadata import read_band
from fynjax.app.io.frames import PICTURE_TAG, PicturePlace, picture_place, read_frames
from fynjax.app.io.raster import write_geotiff
from tests.io import dji_files as dji
from tests.io import frame_files as made
from tests.io.frame_files import CRS, GROUND, ORIGIN, POINTS

WRITERS = {
    "odm": made.write_odm,
    "pix4d": made.write_pix4d,
    "metashape": made.write_metashape,
    "dji": made.write_dji_pictures,
    "micasense": made.write_micasense_pictures,
}
PLACE = {"crs": CRS, "origin": ORIGIN, "ground": GROUND}


@pytest.mark.parametrize("kind", WRITERS)
def test_a_flight_has_the_same_pixels_whoever_states_it(tmp_path, kind):
    """And those of its cameras on the ellipsoid, to a fiftieth of a pixel: the plot is taken for
    flat."""
    frames = read_frames(WRITERS[kind](tmp_path / "flight"), **PLACE)
    assert [frame.name for frame in frames] == list(made.SHOTS)
    for frame in frames:
        np.testing.assert_allclose(frame.pixels(POINTS), made.truth(frame.name), atol=0.02)
        assert frame.lens.size == made.SIZE
        np.testing.assert_allclose(frame.lens.radial[:3], made.RADIAL, rtol=1e-9)
        np.testing.assert_allclose(frame.lens.tangential, made.TANGENTIAL, rtol=1e-9)
        assert frame.sees(POINTS).all()
        np.testing.assert_allclose(
            frame.pose.position[:2], made.SHOTS[frame.name][0][:2], atol=0.01
        )


def test_a_plot_on_another_grid_has_the_same_pixels(tmp_path):
    """Of the zone next to it, whose north is 3.4 degrees away and whose metre is 0.2 % longer."""
    other = "EPSG:32733"
    to_other = pyproj.Transformer.from_crs(CRS, other, always_xy=True)
    corner = to_other.transform(*ORIGIN)
    path = made.write_pix4d(tmp_path / "flight")
    grid = pyproj.Proj(other).get_factors(*made.geographic((0, 0, 0))[:2])
    for frame in read_frames(path, crs=other, origin=corner, ground=GROUND):
        x, y = to_other.transform(*(POINTS[:, :2] + ORIGIN).T)
        height = POINTS[:, 2] * grid.meridional_scale
        points = np.stack([x - corner[0], y - corner[1], height], axis=1)
        np.testing.assert_allclose(frame.pixels(points), made.truth(frame.name), atol=0.02)


def test_exports_are_found_in_their_folder(tmp_path):
    path = made.write_odm(tmp_path / "flight")
    for given in (path, path.parent, path.parent.parent):
        assert len(read_frames(given, **PLACE)) == 3
    single = made.write_dji_pictures(tmp_path / "pictures") / "DJI_0002.TIF"
    assert [frame.name for frame in read_frames(single, **PLACE)] == ["DJI_0002.TIF"]
    inner = made.write_pix4d(tmp_path / "pix4d")
    assert len(read_frames(str(inner).replace("_external", ""), **PLACE)) == 3
    whole = made.write_metashape(tmp_path / "metashape", component=True)
    assert len(read_frames(whole, **PLACE)) == 3
    (tmp_path / "pix4d" / "cameras.xml").write_text(whole.read_text())
    with pytest.raises(InputError, match=r"one export of frames.*name one"):
        read_frames(tmp_path / "pix4d", **PLACE)


def one_image(folder: Path, numbers: str) -> list[fx.Frame]:
    """A Pix4D file of one image, in the plot's own metres, ten metres up."""
    folder.mkdir(exist_ok=True)
    external = folder / "a_calibrated_external_camera_parameters.txt"
    external.write_text(f"imageName X Y Z Omega Phi Kappa\nmy picture.JPG 0 0 10 {numbers}\n")
    omega, phi, kappa = np.radians([float(n) for n in numbers.split()])
    (so, co), (sp, cp), (sk, ck) = ((np.sin(a), np.cos(a)) for a in (omega, phi, kappa))
    # The matrix of photogrammetry's textbooks, from the camera (right, up, back) to the ground.
    matrix = np.array(
        [
            [cp * ck, -cp * sk, sp],
            [co * sk + so * sp * ck, co * ck - so * sp * sk, -so * cp],
            [so * sk - co * sp * ck, so * ck + co * sp * sk, co * cp],
        ]
    )
    rows = (np.diag([1, -1, -1]) @ matrix.T).tolist()
    lines = [*["fileName imageWidth imageHeight"] * 7, "my picture.JPG 201 101", "100 0 100.5",
             "0 100 50.5", "0 0 1", "0 0 0", "0 0", "0 0 10"]  # fmt: skip
    lines += [" ".join(map(str, row)) for row in rows]
    (folder / "a_calibrated_camera_parameters.txt").write_text("\n".join(lines))
    return read_frames(folder, ground=0.0)


T30, T40 = 10.0 * np.tan(np.radians(30.0)), 10.0 * np.tan(np.radians(40.0))


@pytest.mark.parametrize(
    ("angles", "point", "pixel"),
    [
        ("0 0 0", (1.0, 2.0), (110.0, 30.0)),  # straight down, the upper edge to the north
        ("0 0 90", (1.0, 2.0), (120.0, 60.0)),  # turned to the west, against the clock
        ("30 0 0", (0.0, T30), (100.0, 50.0)),  # about the east axis: it looks north
        ("30 0 0", (0.0, T40), (100.0, 50.0 - 100.0 * np.tan(np.radians(10.0)))),
        ("0 30 0", (-T30, 0.0), (100.0, 50.0)),  # about the north axis: it looks west
        ("0 30 -90", (-T30, 0.0), (100.0, 50.0)),
        ("30 0 90", (0.0, T40), (100.0 + 100.0 * np.tan(np.radians(10.0)), 50.0)),
    ],
)
def test_omega_phi_and_kappa_turn_about_east_north_and_up(tmp_path, angles, point, pixel):
    (frame,) = one_image(tmp_path, angles)
    assert frame.name == "my picture.JPG"
    assert frame.pixels([*point, 0.0]).tolist() == pytest.approx(pixel, abs=1e-3)


@pytest.mark.parametrize(
    ("gimbal", "axes"),
    [
        # Yaw, pitch and roll of the gimbal; right, down and ahead of the picture.
        ((0, -90, 0), ([1, 0, 0], [0, -1, 0], [0, 0, -1])),  # straight down, north at the top
        ((90, -90, 0), ([0, -1, 0], [-1, 0, 0], [0, 0, -1])),  # east at the top
        ((0, 0, 0), ([1, 0, 0], [0, 0, -1], [0, 1, 0])),  # level to the north, the sky at the top
        ((90, -45, 0), ([0, -1, 0], [-np.sqrt(0.5), 0, -np.sqrt(0.5)],
                        [np.sqrt(0.5), 0, -np.sqrt(0.5)])),
        ((0, -90, 90), ([0, -1, 0], [-1, 0, 0], [0, 0, -1])),  # a roll about the axis itself
        ((180, -90, 180), ([1, 0, 0], [0, -1, 0], [0, 0, -1])),  # as DJI has it now and then
    ],
)  # fmt: skip
def test_a_gimbals_axis_is_the_optical_one(tmp_path, gimbal, axes):
    stated = zip(("Yaw", "Pitch", "Roll"), gimbal, strict=True)
    keys = " ".join(f'drone-dji:Gimbal{key}Degree="{value:+.2f}"' for key, value in stated)
    path = tmp_path / "DJI_0001.TIF"
    made.write_picture(
        path,
        f'xmlns:drone-dji="http://www.dji.com/drone-dji/1.0/" {keys} drone-dji:GpsLatitude="-34.1" '
        'drone-dji:GpsLongtitude="18.4" drone-dji:RelativeAltitude="+30.0"',
    )
    view = read_view(path, above_takeoff=True)
    np.testing.assert_allclose(view.axes, axes, atol=1e-9)
    assert (view.latitude, view.longitude, view.height, view.lens) == (-34.1, 18.4, 30.0, None)
    # Where only the height above the point of take-off is known, that is taken for the ground.
    (frame,) = read_frames(path, crs=CRS, origin=ORIGIN)
    assert float(frame.pose.position[2]) == pytest.approx(30.0, rel=1e-3)


def test_a_dji_that_states_its_focal_length_has_a_straight_lens(tmp_path):
    folder = made.write_dji_pictures(
        tmp_path / "a", 'drone-dji:CalibratedFocalLength="300.0" drone-dji:DewarpFlag="1"'
    )
    lens = read_view(folder / "DJI_0001.TIF").lens
    assert lens == fx.Lens(made.SIZE, (300.0, 300.0), (made.CENTRE[0] - 1.5, made.CENTRE[1] + 2.0))


@pytest.mark.parametrize(
    ("camera", "expected"),
    [
        # An angle of 45 degrees, to the right: in focal lengths.
        ({"projection_type": "perspective", "focal": 0.5, "k1": 0.1, "k2": 0.02}, 1.12),
        ({"projection_type": "fisheye", "focal": 0.5, "k1": 0.1, "k2": 0.0},
         np.pi / 4 * (1 + 0.1 * (np.pi / 4) ** 2)),
        ({"projection_type": "fisheye_opencv", "focal_x": 0.5, "focal_y": 0.4, "c_x": 0.0,
          "c_y": 0.0, "k1": 0.0, "k2": 0.0, "k3": 0.0, "k4": 0.1},
         np.pi / 4 * (1 + 0.1 * (np.pi / 4) ** 8)),
    ],
)  # fmt: skip
def test_lenses_of_opendronemap(tmp_path, camera, expected):
    path = made.write_odm(tmp_path / "flight")
    size = {"width": made.SIZE[0], "height": made.SIZE[1]}
    (path.parent.parent / "cameras.json").write_text(json.dumps({"v2 mine": camera | size}))
    shots = json.loads(path.read_text())
    for shot in shots["features"]:
        shot["properties"]["camera"] = "mine"
    path.write_text(json.dumps(shots))
    lens = read_frames(path, **PLACE)[0].lens
    column, row = lens.pixels([1.0, 0.0])
    assert column == pytest.approx(199.5 + 200.0 * expected)
    assert row == pytest.approx(149.5)


def edit(path: Path, old: str, new: str) -> None:
    text = path.read_text("utf-8")
    assert re.search(old, text, re.DOTALL)
    path.write_text(re.sub(old, new, text, count=1, flags=re.DOTALL), encoding="utf-8")


@pytest.mark.parametrize(
    ("file", "old", "new", "message"),
    [
        ("odm_report/shots.geojson", r"\}\s*\Z", "", r"shots.geojson, row \d+: expected JSON"),
        ("odm_report/shots.geojson", '"filename"', '"name"', "its file's name as feature 1"),
        ("odm_report/shots.geojson", '"rotation": .\n *[^,]*', '"rotation": [\n "x"',
         "3 numbers as 'rotation' of DJI_0001.TIF"),
        ("odm_report/shots.geojson", '"translation": .\n *[^,]*', '"translation": [\n 261999',
         r"DJI_0001.TIF in the UTM zone of its coordinates \(EPSG:32734\), but it lies 3.0 m"),
        ("odm_report/shots.geojson", '"focal": [^,]*', '"focal": 0.9', "0 of 1 fit"),
        ("odm_report/shots.geojson", '"features": .*', '"features": 3}', "collection of features"),
        ("odm_report/shots.geojson", '"features": .*', '"features": []}', "but there are none"),
        ("odm_report/shots.geojson", "DJI_0002", "DJI_0001", "more of DJI_0001.TIF"),
        ("cameras.json", '"brown"', '"browm"', "cameras.json.*'browm'. Did you mean 'brown'"),
        ("cameras.json", '"focal_x": [^,]*', '"focal_x": null', "a number as 'focal_x' of 'v2 dji"),
        ("cameras.json", '"focal_x": [^,]*', '"focal_x": -0.1', "a positive focal length"),
        ("cameras.json", ".*", "[]", "cameras by name"),
    ],
)  # fmt: skip
def test_a_damaged_export_of_opendronemap_is_refused(tmp_path, file, old, new, message):
    path = made.write_odm(tmp_path)
    edit(tmp_path / file, old, new)
    with pytest.raises(InputError, match=message):
        read_frames(path, **PLACE)


EXTERNAL = "fynbos_calibrated_external_camera_parameters.txt"
INTERNAL = "fynbos_calibrated_camera_parameters.txt"


@pytest.mark.parametrize(
    ("file", "old", "new", "message"),
    [
        (EXTERNAL, "Omega Phi", "Phi Omega", "external.*row 1: expected the header 'imageName"),
        (EXTERNAL, r"\n[^\n]*\n\Z", "\nDJI_0003.TIF 1 2 3\n", r"external.*row 4: .*6 numbers"),
        (EXTERNAL, "DJI_0002", "DJI_9", r"external.*row 3: expected a camera of DJI_9.TIF"),
        (EXTERNAL, r"(DJI_0002.TIF \S+ \S+ \S+) \S+", r"\1 40.0",
         r"external.*row 3: expected one attitude of DJI_0002.TIF, .* differ by \d+.\d degrees"),
        (EXTERNAL, r"\n.*", "\n", "but there are none"),
        (INTERNAL, "fileName", "name", "camera_parameters.txt, row 1: expected Pix4D's header"),
        (INTERNAL, r"\n[^\n]*\n\Z", "\n", "row 29: expected ten lines of DJI_0003.TIF, but got 9"),
        (INTERNAL, r"(DJI_0002.TIF 400 300\n)\S+", r"\1x",
         "row 20: expected 9 numbers as the camera matrix of DJI_0002.TIF"),
        ("fynbos_wkt.prj", ".*", "PROJCS[", "wkt.prj.*coordinate reference system"),
    ],
)  # fmt: skip
def test_a_damaged_export_of_pix4d_is_refused(tmp_path, file, old, new, message):
    path = made.write_pix4d(tmp_path / "a")
    edit(path.with_name(file), old, new)
    with pytest.raises(InputError, match=message):
        read_frames(path, **PLACE)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("</document>", "", r"cameras.xml: expected XML, but it is damaged \(.*line \d+"),
        (r"\?>", '?><!DOCTYPE a [<!ENTITY b "c">]>', "without entities"),
        ("<chunk.*</chunk>", "", "one chunk with cameras.*but got 0"),
        ("(?<=</cameras>).*</transform>", "<reference>EPSG:4326</reference>",
         "a chunk that is georeferenced, but it has no 'transform'"),
        ("<reference>.*</reference>", "<reference>LOCAL_CS[&quot;x&quot;]</reference>",
         "a place on Earth|reference system as WKT"),
        ("<reference>.*</reference>", "", "reference system as WKT, but got ''"),
        ('sensor_id="0"', 'sensor_id="7"', "the sensor of DJI_0001.TIF, '7', but there are 0"),
        ("<calibration.*</calibration>", "", "a calibration of sensor M3M"),
        ('calibration type="frame" class="adj', 'calibration type="spherical" class="adj',
         "sensor M3M is 'spherical'"),
        ("<f>[0-9.]*</f><cx>", "<cx>", "a number as 'f' of sensor M3M"),
        (r"<transform>\S+ ", "<transform>", "16 numbers as the transform of DJI_0001.TIF"),
        (r"<scale>2.5</scale>", "", "transform with 'scale'"),
        (r"<rotation>\S+ ", "<rotation>2.0 ", "attitude of DJI_0001.TIF: .* a rotation"),
    ],
)  # fmt: skip
def test_a_damaged_export_of_metashape_is_refused(tmp_path, old, new, message):
    path = made.write_metashape(tmp_path / "a")
    edit(path, old, new)
    with pytest.raises(InputError, match=message):
        read_frames(path, **PLACE)


def test_pictures_without_what_is_needed_are_refused(tmp_path):
    dji = 'xmlns:drone-dji="http://www.dji.com/drone-dji/1.0/"'
    turned = 'drone-dji:GimbalYawDegree="0" drone-dji:GimbalPitchDegree="-90"'
    path = tmp_path / "DJI_0001.TIF"
    for xmp, message in (
        (f"{dji} {turned}", "DJI_0001.TIF: .*'GimbalRollDegree'"),
        (f'{dji} {turned} drone-dji:GimbalRollDegree="0"', "latitude and longitude"),
        ('xmlns:DLS="http://micasense.com/DLS/1.0/" DLS:Yaw="1" DLS:Pitch="0" DLS:Roll="0"',
         "with 'Yaw'"),
    ):  # fmt: skip
        made.write_picture(path, xmp)
        with pytest.raises(InputError, match=message):
            read_frames(path, **PLACE)


@pytest.mark.parametrize("bands", [dji.MAVIC, dji.PHANTOM])
def test_pixels_of_each_band_lie_where_the_maker_lays_them(tmp_path, bands):
    """A raw pixel by way of lens and homography or shift, as the maker's guide has it, to the pixel
    of a file cut at its edges; and back from the text of its tag."""
    name = "DJI_20261122100000_0001" if bands is dji.MAVIC else "DJI_001"
    dark = [np.full(dji.SHAPE, 0.1) for _ in bands]
    files = dji.write_dji(tmp_path, name, dark, bands, lens=True)
    known = {path.name: read_band(path).registration for path in files}
    place = PicturePlace(dji.SHAPE[::-1], (3, 7), known)
    tag = tmp_path / "a.tif"
    write_geotiff(
        tag, np.zeros((1, *dji.SHAPE)), ["a"], pixel_m=1.0, tags={PICTURE_TAG: place.text()}
    )
    lens = fx.Lens(dji.SHAPE[::-1], dji.FOCAL, (80.0, 60.0))
    row, column = np.indices(dji.SHAPE, dtype=float)
    for path, band in zip(files, bands, strict=True):
        found = picture_place(tag, fx.Frame(fx.Pose([0.0, 0.0, 9.0]), lens, path.name))
        expected = np.stack(dji.frame_place(band, distorted=True), axis=-1) - (3, 7)
        moved = found.of_frame(path.name, np.stack([column, row], axis=-1))
        np.testing.assert_allclose(moved, expected, atol=0.01)
        assert np.abs(moved - np.stack([column, row], axis=-1)).max() > 5.0
    with pytest.raises(InputError, match=r"expected the pose of DJI_.*that of DJI_9"):
        picture_place(tag, fx.Frame(fx.Pose([0.0, 0.0, 9.0]), lens, "DJI_9.TIF"))


def test_pictures_that_do_not_say_where_they_were_taken_are_left_out(tmp_path):
    made.write_dji_pictures(tmp_path)
    path = tmp_path / "DJI_0002.TIF"
    made.write_picture(path, 'xmlns:drone-dji="http://www.dji.com/drone-dji/1.0/"')
    with pytest.warns(UserWarning, match="left out: .*DJI_0002.TIF"):
        frames = read_frames(tmp_path, **PLACE)
    assert [frame.name for frame in frames] == ["DJI_0001.TIF", "DJI_0003.TIF"]


def test_what_is_not_known_of_the_plot_is_asked_for(tmp_path):
    path = made.write_metashape(tmp_path / "a")
    for change, message in (
        ({"ground": None}, r"`ground`.*DJI_0001.TIF is at 342.40 m"),
        ({"crs": None}, "longitude and latitude: state `crs`"),
        ({"crs": "EPSG:4326"}, "in degrees"),
    ):
        with pytest.raises(InputError, match=message):
            read_frames(path, **PLACE | change)
    (tmp_path / "empty").mkdir()
    (tmp_path / "notes.txt").touch()
    for name, message in (
        ("empty", "shots.geojson .*but this folder has none"),
        ("notes.txt", "but it is called otherwise"),
        ("shots.geojson", "there is no such file"),
    ):
        with pytest.raises(InputError, match=message):
            read_frames(tmp_path / name, **PLACE)
    missing = made.write_odm(tmp_path / "flight")
    (tmp_path / "flight" / "cameras.json").unlink()
    with pytest.raises(InputError, match=r"cameras.json: expected the cameras of OpenDroneMap"):
        read_frames(missing, **PLACE)

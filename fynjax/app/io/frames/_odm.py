"""OpenDroneMap: `shots.geojson` (OpenDroneMap, `opendm/shots.py`) and `cameras.json`, whose models
of lenses are those of OpenSfM (Mapillary, Geometric Models).

A shot has its position in the flight's UTM zone, and the rotation from there to the camera (right,
down, ahead) as a vector: its axis times its angle. A camera's lengths are in units of the longer
side of the picture, from its middle.
"""

import functools
import json
from pathlib import Path
from typing import Any

import numpy as np
import pyproj
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from fynjax._core.errors import InputError, did_you_mean, in_file
from fynjax._core.tables import as_utf8
from fynjax.app.io.frames._shot import Shot, between, finite
from fynjax.app.io.raster import utm_zone
from fynjax.app.io.text import existing_file, read_bytes
from fynjax.sensors import Lens

_RADIAL: dict[str, int] = {
    "perspective": 2, "simple_radial": 1, "radial": 2, "brown": 3, "fisheye": 2,
    "fisheye_opencv": 4,
}  # fmt: skip
"""Radial coefficients of the models of a lens that can be read."""
_NEAR = 1.0
"""Metres by which a position may miss that of its longitude and latitude."""


def odm_shots(path: Path) -> list[Shot]:
    """Shots of a `shots.geojson`, whose `cameras.json` lies beside it or in the folder above."""
    beside = [path.parent / "cameras.json", path.parent.parent / "cameras.json"]
    cameras_file = next((p for p in beside if p.is_file()), beside[1])
    existing_file(cameras_file, "the cameras of OpenDroneMap beside shots.geojson or above it")
    cameras = _json(cameras_file)
    with in_file(cameras_file):
        if not isinstance(cameras, dict) or not cameras:
            raise InputError("expected cameras by name, as OpenDroneMap writes them")
        lenses = {name: _lens(name, camera) for name, camera in cameras.items()}
    with in_file(path):
        listed = _json(path)
        features = listed.get("features") if isinstance(listed, dict) else None
        if not isinstance(features, list):
            raise InputError("expected a collection of features, as OpenDroneMap writes it")
        return [_shot(k, feature, cameras, lenses) for k, feature in enumerate(features, 1)]


def _json(path: Path) -> Any:
    try:
        return json.loads(as_utf8(read_bytes(path), path))
    except json.JSONDecodeError as error:
        raise InputError(
            f"expected JSON, but {error.msg} at character {error.colno}. Was the file cut short?",
            file=path,
            row=error.lineno,
        ) from error
    except (RecursionError, ValueError) as error:  # of numbers with thousands of digits
        raise InputError("expected JSON, but it nests too deep or is damaged", file=path) from error


def _lens(name: str, camera: Any) -> Lens:
    if not isinstance(camera, dict):
        raise InputError(f"expected the numbers of a camera by name, but {name!r} has none")
    kind = camera.get("projection_type")
    if kind not in _RADIAL:
        raise InputError(
            f"expected a lens of the kinds {', '.join(_RADIAL)}, but {name!r} is {kind!r}."
            f"{did_you_mean(str(kind), _RADIAL)}"
        )

    def number(*keys: str) -> float:
        value = next((camera[key] for key in keys if key in camera), None)
        return float(finite(value, 1, f"{keys[0]!r} of {name!r}")[0])

    def maybe(key: str) -> float:
        return number(key) if key in camera else 0.0

    columns, rows = number("width"), number("height")
    longer = max(columns, rows)
    centre = (0.5 * (columns - 1) + maybe("c_x") * longer, 0.5 * (rows - 1) + maybe("c_y") * longer)
    focal = (number("focal_x", "focal") * longer, number("focal_y", "focal") * longer)
    radial = tuple(maybe(f"k{k}") for k in range(1, _RADIAL[kind] + 1))
    bent = (maybe("p1"), maybe("p2")) if kind == "brown" else (0.0, 0.0)
    size = (int(columns), int(rows))
    return Lens(size, focal, centre, radial, bent, fisheye=kind.startswith("fisheye"))


def _shot(number: int, feature: Any, cameras: dict[str, Any], lenses: dict[str, Lens]) -> Shot:
    about = feature.get("properties") if isinstance(feature, dict) else None
    name = about.get("filename") if isinstance(about, dict) else None
    if not isinstance(name, str) or not isinstance(about, dict):
        raise InputError(f"expected a shot with its file's name as feature {number}")
    position = finite(about.get("translation"), 3, f"'translation' of {name}")
    rotation = finite(about.get("rotation"), 3, f"'rotation' of {name}")
    geometry = feature.get("geometry")
    degrees = geometry.get("coordinates") if isinstance(geometry, dict) else None
    axes = Rotation.from_rotvec(rotation).as_matrix()
    lens = lenses[_camera(name, about, cameras)]
    return Shot(name, position, axes, lens, _zone(name, position, degrees))


def _camera(name: str, about: dict[str, Any], cameras: dict[str, Any]) -> str:
    """Name of the camera that took a shot: by name where it is stated, else by size and focal
    length."""
    stated = about.get("camera")
    for known in cameras:
        if stated is not None and known.removeprefix("v2 ") == str(stated).removeprefix("v2 "):
            return known

    def same(camera: dict[str, Any]) -> bool:
        known = float(camera.get("focal", camera.get("focal_x", np.nan)))
        size = [camera.get("width"), camera.get("height")]
        near = abs(known / focal - 1.0) < 1e-6
        return near and size == [about.get("width"), about.get("height")]

    focal = float(finite(about.get("focal"), 1, f"'focal' of {name}")[0])
    if not focal > 0.0:
        raise InputError(f"expected a positive 'focal' of {name}, but got {focal:g}")
    fitting = [key for key, camera in cameras.items() if same(camera)]
    if len(fitting) != 1:
        raise InputError(
            f"expected {name} of one camera of cameras.json, by width, height and focal length, "
            f"but {len(fitting)} of {len(cameras)} fit. Are both files of one flight?"
        )
    return fitting[0]


def _zone(name: str, position: Float[np.ndarray, " 3"], degrees: Any) -> pyproj.CRS:
    """The UTM zone that a position is in, checked by its longitude and latitude."""
    longitude, latitude = finite(degrees, 3, f"'coordinates' of {name}")[:2]
    if not (abs(longitude) <= 180.0 and abs(latitude) <= 84.0):
        raise InputError(
            f"expected longitude and latitude of {name} in a UTM zone, but got {longitude:g}, "
            f"{latitude:g} degrees"
        )
    zone = utm_zone(longitude, latitude)
    system, degrees = (_system(one) for one in (zone, "EPSG:4326"))
    there = between(degrees, system).transform(longitude, latitude)
    missed = np.hypot(*np.subtract(there, position[:2]))
    if not missed < _NEAR:
        raise InputError(
            f"expected the 'translation' of {name} in the UTM zone of its coordinates ({zone}), "
            f"but it lies {missed:.1f} m from them. Was the flight processed without positions?"
        )
    return system


_system = functools.cache(pyproj.CRS.from_user_input)

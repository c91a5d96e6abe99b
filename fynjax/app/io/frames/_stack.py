"""Frames of a flight on the ground's grid of a plot, in one file: what a fit compares."""

import dataclasses
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from jaxtyping import Bool, Float

from fynjax._core.errors import InputError, listed, names_file, refusing
from fynjax.app.io.frames._lay import lens_of_record
from fynjax.app.io.raster import check_netcdf
from fynjax.app.io.text import existing_file
from fynjax.scene import PARAMETERS
from fynjax.sensors import Frame, Lens, Pose

POSE = ("camera_east", "camera_north", "camera_height", "yaw", "pitch", "roll")
"""Variables of the pose of each frame, in the plot's metres and degrees."""
_NEEDED = ("reflectance", "wavelength", "solar_zenith", "solar_azimuth", "lens", *POSE)
_WHAT = "frames that `fynjax frames --images` laid on the ground"


@dataclass(frozen=True)
class FrameStack:
    """Frames on one grid of the ground."""

    frames: tuple[Frame, ...]
    """Pose, lens and name of each."""
    bands: tuple[str, ...]
    wavelength: tuple[float, ...]
    """Centre of each band [nm]."""
    reflectance: Float[np.ndarray, "frame band y x"]
    """Reflectance factor [-], y to the north; NaN where a frame does not see the ground."""
    pixel: float
    """Side of a pixel on the ground [m]."""
    sun: tuple[tuple[float, float] | None, ...]
    """Zenith and azimuth of the sun of each frame [degrees]; None: that of the plot."""
    relative: str = ""
    """Why the reflectance is not absolute; "" where it is."""

    @property
    def seen(self) -> Bool[np.ndarray, "frame y x"]:
        """Pixels that a frame sees in all bands."""
        return np.isfinite(self.reflectance).all(axis=1)

    @property
    def views(self) -> tuple[str, ...]:
        """A word for each frame, by which its view is called: its name without the ending."""
        words = [_word(Path(frame.name).stem) for frame in self.frames]
        if len(set(words)) < len(words):
            words = [f"{word}_{k}" for k, word in enumerate(words, 1)]
        return tuple(words)

    def variables(self, about: Mapping[str, str]) -> dict[str, Any]:
        """Variables of a dataset with the dimensions frame, band, y and x; `about`, further
        attributes of what lies on the grid."""
        factor = {"long_name": "reflectance factor", "units": "1", **about}
        factor["standard_name"] = "surface_bidirectional_reflectance"
        poses = [[*f.pose.position, f.pose.yaw, f.pose.pitch, f.pose.roll] for f in self.frames]
        suns = [(np.nan, np.nan) if sun is None else sun for sun in self.sun]
        known: dict[str, Any] = {
            "reflectance": (("frame", "band", "y", "x"), self.reflectance.astype("f4"), factor),
            "lens": ("frame", [json.dumps(dataclasses.asdict(f.lens)) if f.lens else ""
                               for f in self.frames], {"long_name": "lens, as JSON"}),
        }  # fmt: skip
        for name, values in zip(POSE, np.asarray(poses, float).T, strict=True):
            unit = "m" if name.startswith("camera") else "degree"
            known[name] = ("frame", values, {"units": unit, "long_name": _LONG[name]})
        for name, values in zip(("zenith", "azimuth"), np.asarray(suns, float).T, strict=True):
            what = {"units": "degree", "long_name": f"{name} of the sun; missing: the plot's"}
            what["standard_name"] = f"solar_{name}_angle"
            known[f"solar_{name}"] = ("frame", values, what)
        centre = {"units": "nm", "long_name": "band centre"}
        centre["standard_name"] = "sensor_band_central_radiation_wavelength"
        return known | {"wavelength": ("band", list(self.wavelength), centre)}


_LONG = {
    "camera_east": "position of the camera, east of the plot's south-west corner",
    "camera_north": "position of the camera, north of the plot's south-west corner",
    "camera_height": "height of the camera above the mean level of the plot's ground",
    "yaw": "direction of the picture's upper edge, clockwise from the plot's north",
    "pitch": "angle of looking ahead from straight down",
    "roll": "angle by which the camera's right side is down",
}


def _word(text: str) -> str:
    plain = "".join(c if c.isalnum() and c.isascii() else "_" for c in text)
    return plain if plain.isidentifier() else f"frame_{plain}"


def is_frame_stack(path: Path) -> bool:
    """Whether the file `path` is one of frames on the ground; of one that cannot be read it says
    no."""
    if path.suffix.lower() not in (".nc", ".nc4") or not path.is_file():
        return False
    try:
        check_netcdf(path)
        with xr.open_dataset(path, engine="netcdf4") as data:
            return "frame" in data.dims and "view_zenith" in data
    except (InputError, OSError, ValueError):  # whoever reads it next says what is wrong
        return False


@names_file
def read_frame_stack(path: str | Path) -> FrameStack:
    """Read frames on the ground's grid, as `fynjax frames --images` writes them.

    **Arguments:** `path` of the NetCDF file.

    **Returns:** a `FrameStack`.

    **Raises:** `InputError` for a file without reflectance, pose, lens or sun of its frames, with
    values out of range, and for a damaged one.
    """
    path = Path(path)
    existing_file(path, _WHAT)
    check_netcdf(path)
    words = "cannot be read as NetCDF ({error}). Is it damaged?"
    with (
        refusing(OSError, ValueError, RuntimeError, words=words),
        xr.open_dataset(path, engine="netcdf4") as data,
    ):
        if missing := [name for name in _NEEDED if name not in data.variables]:
            hint = " Give it the frames: --images FOLDER" if missing[0] == "reflectance" else ""
            raise InputError(f"expected {_WHAT}, but {missing[0]!r} is missing.{hint}")
        data = data.load()
    for name in (*POSE, "lens", "solar_zenith", "solar_azimuth"):
        if data[name].dims != ("frame",):
            got = listed(map(str, data[name].dims)) or "no dimension"
            raise InputError(f"expected {name!r} by frame, but got {got}")
    dims = data["reflectance"].dims
    if dims != ("frame", "band", "y", "x") or not data["reflectance"].size:
        raise InputError(
            f"expected reflectance by frame, band, y and x, but got {listed(map(str, dims))}"
        )
    for axis, words in (("y", "from south to north"), ("x", "from west to east")):
        if axis in data.variables and not (np.diff(data[axis].values) > 0.0).all():
            raise InputError(f"expected {axis} {words}, but its values do not rise")
    values = np.asarray(data["reflectance"].values, float)
    if np.isfinite(values).any() and (usual := float(np.nanmedian(values))) > 1.5:
        raise InputError(
            f"expected reflectance as fractions, but its median is {usual:g}. In percent? Divide "
            "by 100."
        )
    pixel = data.attrs.get("pixel_m")
    if not (isinstance(pixel, float | np.floating) and 0.0 < pixel < np.inf):
        raise InputError(f"expected a positive size of a pixel, 'pixel_m', but got {pixel!r}")
    names = [str(name) for name in data["frame"].values]
    poses = np.stack([np.asarray(data[name].values, float) for name in POSE], axis=-1)
    if poses.shape != (len(names), len(POSE)) or not np.isfinite(poses).all():
        raise InputError("expected a pose of each frame in numbers, but some are missing")
    suns = np.stack([data["solar_zenith"].values, data["solar_azimuth"].values], axis=-1)
    frames = tuple(
        Frame(Pose(pose[:3], *pose[3:]), _lens(str(lens), name), name)
        for pose, lens, name in zip(poses, data["lens"].values, names, strict=True)
    )
    lowest = PARAMETERS["sun_zenith"].upper
    for frame, image, sun in zip(frames, values, suns, strict=True):
        if not frame.pose.position[2] > 0.0:
            height = f"{float(frame.pose.position[2]):g}"
            raise InputError(f"expected {frame.name} above the ground, but its height is {height}")
        if sun[0] > lowest:
            words = f"expected the sun of {frame.name} at most {lowest:g} degrees off the zenith"
            raise InputError(f"{words}, but got {sun[0]:g}")
        if not np.isfinite(image).all(axis=0).any():
            raise InputError(f"expected pixels of {frame.name}, but all are missing")
    return FrameStack(
        frames,
        tuple(map(str, data["band"].values)),
        tuple(map(float, data["wavelength"].values)),
        values,
        float(pixel),
        tuple((float(z), float(a)) if np.isfinite([z, a]).all() else None for z, a in suns),
        str(data.attrs.get("relative_reflectance", "")),
    )


def _lens(text: str, name: str) -> Lens | None:
    if not text:
        return None
    words = f"expected the lens of {name} as JSON, but it is damaged ({{error}})"
    with refusing(ValueError, TypeError, AttributeError, RecursionError, words=words):
        return lens_of_record(json.loads(text))

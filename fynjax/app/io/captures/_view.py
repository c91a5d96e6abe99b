"""Where a camera was and how it was turned when it took a picture, by the picture's metadata.

DJI's angles are those of the gimbal, whose forward axis is the optical one, about north, east and
down in the order yaw, pitch, roll (Mavic 3M Image Processing Guide v1.0, DJI, 2023): a pitch of -90
looks straight down. The angles of the namespace Camera, as MicaSense has them, are those of a
camera that looks straight down at zero (Pix4D, Specifications of xmp.camera tags).
"""

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from fynjax._core.errors import InputError, names_file
from fynjax.app.io.captures._band import Stated
from fynjax.app.io.captures._camera_place import is_fix
from fynjax.app.io.captures._dji import dji_lens, optical_centre
from fynjax.app.io.raster import open_raster
from fynjax.sensors import Lens


@dataclass(frozen=True)
class PictureView:
    """Position and attitude of a camera, and its lens."""

    latitude: float
    """Latitude [degrees]."""
    longitude: float
    """Longitude [degrees]."""
    height: float
    """Height above the point of take-off, or of the sea or the ellipsoid, as the receiver has it
    [m]."""
    above_takeoff: bool
    """Which of these the height is."""
    axes: Float[np.ndarray, "3 3"]
    """Unit vectors (east, north, up) of the picture's right and lower edge and of the optical axis,
    one a row."""
    lens: Lens | None
    """None where nothing is stated of it."""


@names_file
def read_view(path: str | Path, *, above_takeoff: bool = False) -> PictureView:
    """Read a picture's metadata, not its pixels.

    **Arguments:** `path`: a picture of a DJI camera on a gimbal, or of one that writes its own yaw,
    pitch and roll (MicaSense); `above_takeoff`: take the height above the point of take-off, which
    DJI states.

    **Returns:** a `PictureView`.

    **Raises:** `InputError` for a file that cannot be read, or lacks the position or the attitude.
    """
    with open_raster(Path(path), "a picture of a drone's camera") as file:
        picture = file.dataset
        shape = (picture.height, picture.width)
        stated = Stated(file.xmp, {**picture.tags(), **picture.tags(ns="EXIF")})
    gimbal = "GimbalPitchDegree" in stated.xmp
    keys = [f"Gimbal{k}Degree" if gimbal else k for k in ("Yaw", "Pitch", "Roll")]
    turn = Rotation.from_euler("ZYX", [stated.numbers(key, 1)[0] for key in keys], degrees=True)
    if gimbal:  # from an axis ahead to one that looks down
        turn *= Rotation.from_euler("Y", 90.0, degrees=True)
    forward, right, down = turn.as_matrix()[[1, 0, 2]].T * [1.0, 1.0, -1.0]
    latitude, longitude = _place(stated)
    if above_takeoff:
        height = stated.numbers("RelativeAltitude", 1)[0]
    elif "AbsoluteAltitude" in stated.xmp:
        height = stated.numbers("AbsoluteAltitude", 1)[0]
    else:
        height = stated.exif("GPSAltitude")
        if re.search("1", stated.tags.get("EXIF_GPSAltitudeRef", "")):
            height = -height
    lens = _of_gimbal(stated, shape) if gimbal else _of_camera(stated, shape)
    axes = np.stack([right, -forward, down])
    return PictureView(latitude, longitude, height, above_takeoff, axes, lens)


def _place(stated: Stated) -> tuple[float, float]:
    """Latitude and longitude [degrees]."""
    found = [stated.maybe("GpsLatitude")]
    found.append(stated.maybe("GpsLongitude") or stated.maybe("GpsLongtitude"))
    degrees = [value[0] for value in found if value] if all(found) else stated.degrees()
    if degrees is None or not is_fix(*degrees):
        raise InputError(
            "expected latitude and longitude in the metadata, but there are none. Had the receiver "
            "no satellites?"
        )
    return degrees[0], degrees[1]


def _of_gimbal(stated: Stated, shape: tuple[int, int]) -> Lens | None:
    """The lens of a DJI: with the distortion of `DewarpData`, or straight."""
    lens = dji_lens(stated, shape)
    focal = stated.maybe("CalibratedFocalLength")
    if lens is not None or not focal:
        return lens
    rows, columns = shape
    centre = optical_centre(stated) or [0.5 * (columns - 1), 0.5 * (rows - 1)]
    return Lens((columns, rows), (focal[0], focal[0]), (centre[0], centre[1]))


def _of_camera(stated: Stated, shape: tuple[int, int]) -> Lens | None:
    """The lens by the namespace Camera: lengths in mm, which EXIF has the pixels of, and
    distortion as k1, k2, k3, p1, p2."""
    if "PerspectiveFocalLength" not in stated.xmp:
        return None
    per_mm = [stated.exif(f"FocalPlane{axis}Resolution") for axis in "XY"]
    focal = stated.numbers("PerspectiveFocalLength", 1)[0]
    x, y = stated.numbers("PrincipalPoint", 2)
    bent = [0.0] * 5
    if "PerspectiveDistortion" in stated.xmp:
        bent = stated.numbers("PerspectiveDistortion", 5)
    rows, columns = shape
    return Lens(
        (columns, rows),
        (focal * per_mm[0], focal * per_mm[1]),
        (x * per_mm[0], y * per_mm[1]),
        tuple(bent[:3]),
        (bent[3], bent[4]),
    )

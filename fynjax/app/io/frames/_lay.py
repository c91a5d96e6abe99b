"""Pictures of reflectance, each on the pixels of its camera, laid on the ground of a plot."""

import json
import math
import re
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.ndimage import map_coordinates

from fynjax._core.errors import InputError, in_file, listed
from fynjax.app.io.captures import Registration, capture_of
from fynjax.app.io.raster import open_raster
from fynjax.sensors import Frame, Lens

SUFFIX = "_reflectance"
"""What `fynjax reflectance` puts after the name of a capture."""
PICTURE_TAG = "picture"
"""Tag of a picture's size, the corner where it was cut, and how the pixels of its bands' own
pictures came there."""
TIME_TAG = "time_utc"
"""Tag of when a picture was taken, ISO 8601 in UTC."""
_IMAGES = (".tif", ".tiff")
_FINEST = 8
"""Points along the edge of a pixel of the ground whose reflectance is averaged, at most."""


@dataclass(frozen=True)
class PicturePlace:
    """Where the pixels of a file lie in the picture that its camera took."""

    size: tuple[int, int]
    """Columns and rows of the whole picture."""
    corner: tuple[int, int] = (0, 0)
    """Column and row of the file's top left pixel."""
    bands: Mapping[str, Registration | None] = field(default_factory=dict)
    """Lens and homography by which the picture of each band, by the name of its file, was laid on
    the whole one; None: it was not moved. Empty: none was."""

    def text(self) -> str:
        """The place of a picture as the text of its GeoTIFF tag."""
        bands = {
            name: None
            if one is None
            else {
                "homography": one.homography.tolist(),
                "lens": None if one.lens is None else asdict(one.lens),
            }
            for name, one in self.bands.items()
        }
        return json.dumps({"size": self.size, "corner": self.corner, "bands": bands})

    def band_of(self, name: str) -> str | None:
        """The band's file that a frame called `name` is of; None: of none of these."""
        same = [band for band in self.bands if Path(band).stem == Path(name).stem]
        if not same and capture_of(name) == Path(name).stem:
            same = list(self.bands)  # a frame of the whole capture has the pose of its first band
        return same[0] if same else None

    def of_frame(self, name: str, pixels: Float[Any, "*point 2"]) -> Float[np.ndarray, "*point 2"]:
        """Columns and rows in the file of those in the own picture of a frame called `name`."""
        band = self.band_of(name)
        moved = None if band is None else self.bands[band]
        return (pixels if moved is None else moved.places(pixels)) - np.asarray(self.corner)


def pictures_of(frames: Sequence[Frame], folder: Path) -> dict[str, Path]:
    """Files of reflectance in a folder by the names of their frames.

    A file is of the frame whose name it has, or that of its capture, with or without
    "_reflectance". Of the frames of one capture, a band each, that counts which the file names
    first among those whose pixels it has, or the first.

    **Arguments:** `frames` of a flight; the `folder`.

    **Raises:** `InputError` for a folder without any that fit.
    """
    if not folder.is_dir():
        raise InputError("expected a folder of frames of reflectance, but it is none", file=folder)
    files = {
        path.stem.removesuffix(SUFFIX): path
        for path in sorted(folder.iterdir())
        if path.suffix.lower() in _IMAGES and not path.stem.endswith(f"{SUFFIX}_sd")
    }
    named: dict[Path, list[str]] = {}
    for frame in frames:
        keys = Path(frame.name).stem, capture_of(frame.name)
        if (path := next((files[key] for key in keys if key in files), None)) is not None:
            named.setdefault(path, []).append(frame.name)
    if not named:
        raise InputError(
            f"expected frames of reflectance named after those of the flight, such as "
            f"{Path(frames[0].name).stem}{SUFFIX}.tif, but this folder has "
            f"{listed(path.name for path in files.values()) or 'no GeoTIFF'}",
            file=folder,
        )
    return {_of_band(path, names): path for path, names in named.items()}


def _of_band(path: Path, names: Sequence[str]) -> str:
    """The first of some frames of one capture whose pixels are in its file, or the first."""
    if len(names) > 1:
        with suppress(InputError):  # of a damaged file whoever reads it next says what is wrong
            with open_raster(path, "a frame of reflectance") as file:
                stated = file.tags.get(PICTURE_TAG)
            if stated is not None:
                at = _stated(stated)
                order = {band: number for number, band in enumerate(at.bands)}
                return min(names, key=lambda name: order.get(at.band_of(name) or "", len(order)))
    return names[0]


def picture_place(path: Path, frame: Frame) -> PicturePlace:
    """Where the pixels of a file lie in its frame's picture.

    **Arguments:** `path` of the file; its `frame`, with a lens.

    **Raises:** `InputError` for a file on a map, one of another size than the picture that does not
    say where it was cut, and one that has other bands than that of the frame.
    """
    assert frame.lens is not None
    with open_raster(path, "a frame of reflectance") as file:
        rows, columns = file.shape
        if file.crs is not None and file.on_earth:
            raise InputError(
                "expected a frame on the pixels of its camera, but it was laid on a map: "
                "`fynjax reflectance --own-pixels` leaves it where it was"
            )
        stated = file.tags.get(PICTURE_TAG)
    place = PicturePlace((columns, rows))
    with in_file(path):
        if stated is not None:
            place = _stated(stated)
        if place.size != frame.lens.size:
            wide, high = frame.lens.size
            raise InputError(
                f"expected {wide} x {high} pixels, as the lens of {frame.name} has, but got "
                f"{place.size[0]} x {place.size[1]}. Is it cut, or of another camera?"
            )
        if place.bands and place.band_of(frame.name) is None:
            raise InputError(
                f"expected the pose of {listed(place.bands)}, whose pixels it has, but the flight "
                f"has that of {frame.name}"
            )
    return place


_DAMAGED = (ValueError, LookupError, TypeError, AttributeError, ArithmeticError, RecursionError)
"""What damaged JSON ends in."""


def _stated(text: str) -> PicturePlace:
    if '"straight"' in text:
        raise InputError(
            "expected a picture as `fynjax reflectance` writes it now, but an earlier version "
            "wrote this one: write it anew"
        )
    try:
        known = json.loads(text)
        size, corner = (tuple(map(int, known[key])) for key in ("size", "corner"))
        bands = {str(name): _registration(one) for name, one in known.get("bands", {}).items()}
        return PicturePlace((size[0], size[1]), (corner[0], corner[1]), bands)
    except _DAMAGED as error:
        raise InputError(
            f"expected size and corner of the picture as the tag {PICTURE_TAG!r}, but got "
            f"{text[:60]!r}"
        ) from error


def _registration(known: dict[str, Any] | None) -> Registration | None:
    if known is None:
        return None
    matrix = np.asarray(known["homography"], float)
    if matrix.shape != (3, 3) or not np.isfinite(matrix).all():
        raise ValueError("a matrix of three rows and columns")
    return Registration(matrix, None if known["lens"] is None else lens_of_record(known["lens"]))


def lens_of_record(known: Mapping[str, Any]) -> Lens:
    """A lens of its fields as JSON has them. Raises `TypeError` or `InputError` for other ones."""
    lists = {key: tuple(value) for key, value in known.items() if isinstance(value, list)}
    return Lens(**{**known, **lists})


def picture_time(path: Path) -> datetime | None:
    """When the picture `path` was taken, by its tag; None where it does not say."""
    with open_raster(path, "a frame of reflectance") as file:
        return utc_time(file.tags.get(TIME_TAG, ""))


def utc_time(text: str) -> datetime | None:
    """The time that a `text` of the metadata of a camera that counts in UTC means, such as
    "2026:11:22 10:00:00"; None of anything else."""
    plain = re.sub(r"^(\d{4}):(\d{2}):(\d{2})", r"\1-\2-\3", text.strip())
    try:
        time = datetime.fromisoformat(plain)
    except ValueError:
        return None
    return time.replace(tzinfo=UTC) if time.tzinfo is None else time.astimezone(UTC)


def points_wanted(frame: Frame, pixel: float) -> int:
    """Points along the edge of a `pixel` on the ground [m] that the own pixels of a `frame` ask
    for."""
    assert frame.lens is not None
    own = float(frame.pose.position[2]) / max(frame.lens.focal_length)
    return int(np.clip(math.ceil(pixel / own - 1e-6), 1, _FINEST))


def lay_picture(
    values: Float[np.ndarray, "band row column"], places: Float[np.ndarray, "y x 2"], points: int
) -> Float[np.ndarray, "band south east"]:
    """A picture on the ground: means over `points` x `points` places of each pixel there, between
    the picture's own (bilinear).

    **Arguments:**

    - `values`: rows from the top; NaN where there are no data.
    - `places`: column and row of each point of the ground, of the first of `values` on.
    - `points`: along the edge of a pixel of the ground.

    **Returns:** NaN where a point lies beyond the picture or next to one without data.
    """
    at = np.moveaxis(places, -1, 0)[::-1]
    at = np.nan_to_num(at, nan=-2.0)
    found = np.stack([map_coordinates(band, at, order=1, cval=np.nan) for band in values])
    bands, high, wide = found.shape
    blocks = found.reshape(bands, high // points, points, wide // points, points)
    return np.asarray(blocks.mean(axis=(2, 4)))

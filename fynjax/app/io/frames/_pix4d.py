"""Pix4D: `*_calibrated_external_camera_parameters.txt` and `*_calibrated_camera_parameters.txt` of
the folder `1_initial/params`, after Pix4D's article on internal and external camera parameters.

The first has positions in the project's output system, and omega, phi and kappa: right-handed turns
about the east, north and upward axis, one after another about axes that were turned by those
before, which bring these axes to the camera's (right, up, back). The second has the matrix of a
camera, its distortion and its rotation from the ground to the camera (right, down, ahead), with
positions less an offset. Its principal point counts from the picture's corner; nothing says so in
words, but that of the file in mm counts from the sensor's.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyproj
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from fynjax._core.errors import InputError, in_file
from fynjax._core.tables import as_utf8
from fynjax.app.io.frames._shot import Shot, finite
from fynjax.app.io.raster import parse_crs
from fynjax.app.io.text import existing_file, read_bytes
from fynjax.sensors import Lens

EXTERNAL, INTERNAL = (
    "_calibrated_external_camera_parameters.txt",
    "_calibrated_camera_parameters.txt",
)
_COLUMNS = "imageName X Y Z Omega Phi Kappa"
_HEADER = 7
"""Lines that say what the file of cameras has."""
_APART = 0.5
"""Degrees by which the attitudes of both files may differ."""


@dataclass(frozen=True)
class _Camera:
    lens: Lens
    axes: Float[np.ndarray, "3 3"]


def pix4d_shots(path: Path) -> list[Shot]:
    """Shots of a file of external parameters, with that of the cameras beside it."""
    stem = path.name.removesuffix(EXTERNAL).removesuffix(INTERNAL)
    external, internal = (path.with_name(stem + end) for end in (EXTERNAL, INTERNAL))
    existing_file(external, "positions and attitudes (external parameters) of Pix4D")
    existing_file(internal, "Pix4D's cameras, image by image, beside the external parameters")
    system = path.with_name(f"{stem}_wkt.prj")
    crs = None
    if system.is_file():
        crs = pyproj.CRS.from_wkt(parse_crs(_text(system), system).to_wkt())
    with in_file(internal):
        cameras = dict(_cameras(internal))
    with in_file(external):
        return [_shot(name, row, at, cameras, crs) for name, row, at in _rows(external)]


def _text(path: Path) -> str:
    return as_utf8(read_bytes(path), path).decode()


def _rows(path: Path) -> Iterator[tuple[str, int, Float[np.ndarray, " 6"]]]:
    """Name, line and six numbers of each image."""
    header, *lines = _text(path).splitlines() or [""]
    if " ".join(header.split()) != _COLUMNS:
        raise InputError(f"expected the header {_COLUMNS!r}, but got {header[:60]!r}", row=1)
    for row, line in enumerate(lines, 2):
        if not line.strip():
            continue
        name, *numbers = line.rsplit(None, 6)
        with _line(row):
            yield name, row, finite(numbers, 6, f"position and angles of {name[:40]}")


@contextmanager
def _line(row: int) -> Iterator[None]:
    """Have the `InputError`s of a block name a line, unless they name one."""
    try:
        yield
    except InputError as error:
        raise InputError(error.message, file=error.file, row=error.row or row) from error


def _cameras(path: Path) -> Iterator[tuple[str, _Camera]]:
    """Name and numbers of each image: ten lines of each."""
    lines = [(row, line) for row, line in enumerate(_text(path).splitlines(), 1) if line.strip()]
    if not lines or not lines[0][1].startswith("fileName imageWidth imageHeight"):
        raise InputError("expected Pix4D's header, 'fileName imageWidth imageHeight' first", row=1)
    lines = lines[_HEADER:]
    for start in range(0, len(lines), 10):
        block = lines[start : start + 10]
        with _line(block[0][0]):
            yield _camera(block)


def _camera(block: list[tuple[int, str]]) -> tuple[str, _Camera]:
    name, *size = block[0][1].rsplit(None, 2)
    columns, rows = finite(size, 2, "width and height [pixel] after an image's name")
    if len(block) < 10:
        raise InputError(f"expected ten lines of {name}, but got {len(block)}: was it cut short?")

    def numbers(first: int, lines: int, count: int, what: str) -> Float[np.ndarray, " value"]:
        with _line(block[first][0]):
            found = " ".join(line for _, line in block[first : first + lines]).split()
            return finite(found, count, f"{what} of {name}")

    matrix = numbers(1, 3, 9, "the camera matrix").reshape(3, 3)
    radial = numbers(4, 1, 3, "radial distortion")
    tangential = numbers(5, 1, 2, "tangential distortion")
    numbers(6, 1, 3, "the position")
    axes = numbers(7, 3, 9, "the rotation").reshape(3, 3)
    lens = Lens(
        (int(columns), int(rows)),
        (float(matrix[0, 0]), float(matrix[1, 1])),
        (float(matrix[0, 2]) - 0.5, float(matrix[1, 2]) - 0.5),
        tuple(radial.tolist()),
        (float(tangential[0]), float(tangential[1])),
        float(matrix[0, 1]),
    )
    return name, _Camera(lens, axes)


def _shot(
    name: str,
    row: int,
    numbers: Float[np.ndarray, " 6"],
    cameras: dict[str, _Camera],
    crs: pyproj.CRS | None,
) -> Shot:
    with _line(row):
        if name not in cameras:
            raise InputError(f"expected a camera of {name}, but the file of cameras has none")
        right, up, back = Rotation.from_euler("XYZ", numbers[3:], degrees=True).as_matrix().T
        axes = np.stack([right, -up, -back])
        camera = cameras[name]
        cosine = 0.5 * (np.trace(axes @ camera.axes.T) - 1.0)
        apart = np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0)))
        if not apart < _APART:
            raise InputError(
                f"expected one attitude of {name}, but omega, phi and kappa differ by {apart:.1f} "
                "degrees from the rotation in the file of cameras. Are both of one run?"
            )
        return Shot(name, numbers[:3], axes, camera.lens, crs)

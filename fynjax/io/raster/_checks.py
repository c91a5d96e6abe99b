"""Checks of how the cells of a raster lie: north up, square."""

from pathlib import Path
from typing import Any

from fynjax._core.errors import InputError


def check_north_up(transform: Any, path: Path, what: str, *, may_be_flipped: bool = False) -> None:
    """Refuse a raster that is rotated or, unless it `may_be_flipped`, not north up.

    `transform` is the affine map from its columns and rows to its coordinates; `what` names it in
    the error, such as "an image".
    """
    t = transform
    rotated = abs(t.b) > 1e-9 * abs(t.a) or abs(t.d) > 1e-9 * abs(t.a)
    if rotated or (not may_be_flipped and (t.a < 0 or t.e > 0)):
        raise InputError(
            f"expected {what} with north up, but this one is rotated"
            f"{'' if may_be_flipped else ' or upside down'}. Warp it first: "
            f"gdalwarp {path.name} north_up.tif",
            file=path,
        )


def check_square(transform: Any, path: Path, what: str) -> None:
    """Refuse cells that are not square; `what` names them, such as "pixels"."""
    width, height = transform.a, abs(transform.e)
    if abs(height - width) > 1e-3 * width:
        raise InputError(
            f"expected square {what}, but they are {width:g} by {height:g}. Warp with -tr first.",
            file=path,
        )

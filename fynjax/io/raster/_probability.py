"""Probability maps: rasters of 0 to 255 that say where plants are likely to stand."""

import warnings
from pathlib import Path

import numpy as np
from jaxtyping import Float64
from numpy.typing import NDArray

from fynjax._core.errors import InputError, names_file
from fynjax.io.raster._over_plot import read_over_plot


@names_file
def read_probability_map(
    path: str | Path,
    size_m: tuple[float, float],
    *,
    origin_m: tuple[float, float] | None = None,
    option: str = "origin_m",
) -> Float64[np.ndarray, "y x"]:
    """Read the part of a raster of 0 to 255 that lies over a plot, as `assign_sites` takes it.

    Where the plot lies in the raster: with its south-west corner at `origin_m`, if given. Else, in
    a raster of the plot's own frame (any local system, as fynjax writes it for a plot without a
    place on Earth), at (0, 0). Else, in a raster with a place on Earth, at the raster's own
    corner, if the raster is as large as the plot; a larger one cannot be placed without
    `origin_m`. A raster may miss the plot's edges by half a cell, but by no more than 2 % of the
    plot: it is then stretched over the plot.

    Where the plot's edges meet those of cells the cells are taken as they are. Else the plot is
    divided into cells no larger than the raster's, each with the area-weighted mean of what it
    covers: so the mean over the plot is kept, and with it the share of points accepted.

    **Arguments:**

    - `path`: any raster of one band that GDAL reads; whole numbers or fractions of 0 to 255.
    - `size_m`: (x, y) extent of the plot [m].
    - `origin_m`: (x, y) of the plot's south-west corner, in the raster's coordinates [m].
    - `option`: what the user calls `origin_m`, for errors.

    **Returns:** the map over the plot's extent, 0 to 255, row 0 at the southern edge.

    **Raises:** `InputError` for a raster that is missing or cut short, has no coordinate reference
    system, is in degrees or feet, is rotated, has several bands, does not cover the plot; that has
    cells without data or NaN over the plot, values outside 0-255 or within 0-1, or nothing but 0.
    Warns where the map has one value all over the plot.
    """
    path = Path(path)
    part = read_over_plot(path, "a probability map", size_m, origin_m=origin_m, option=option)
    part.check_single(
        "a map of one band of 0 to 255",
        f"Make a map of an image with `fynjax pattern {path.name}`, or choose a band: "
        "gdal_translate -b 1",
    )
    _check_values(part.values, path)
    values = np.clip(part.in_own_cells()[0], 0.0, 255.0)
    if np.ptp(values) < 1e-9:
        warnings.warn(
            f"{path}: the probability map is {values.flat[0]:g} all over the plot, so it sets no "
            "pattern",
            stacklevel=3,
        )
    return values


def _check_values(values: NDArray[np.float64], path: Path) -> None:
    """Refuse numbers that cannot be 0 to 255."""
    low, high = float(values.min()), float(values.max())
    if low < 0.0 or high > 255.0:
        raise InputError(
            f"expected values of 0 to 255, but they range from {low:g} to {high:g} over the plot. "
            "A no-data value that the file does not declare (gdal_edit.py -a_nodata), or another "
            f"scale (gdal_translate -ot Byte -scale {low:g} {high:g} 0 255)?"
        )
    if high == 0.0:
        raise InputError(
            "expected values above 0 where plants may stand, but the map is 0 all over the plot: "
            "no plant could be placed"
        )
    if high <= 1.0:
        raise InputError(
            f"expected values of 0 to 255, but the largest over the plot is {high:g}. Chances of 0 "
            f"to 1, or a mask? Multiply by 255: gdal_translate -ot Byte -scale 0 1 0 255 "
            f"{path.name} map.tif"
        )

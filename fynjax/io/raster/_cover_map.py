"""Rasters of what lies on the ground."""

from pathlib import Path

import numpy as np
from jaxtyping import Float64

from fynjax._core.errors import InputError, names_file
from fynjax.io.raster._over_plot import read_over_plot
from fynjax.io.text import did_you_mean
from fynjax.scene import COVERS


@names_file
def read_cover_map(
    path: Path,
    size_m: tuple[float, float],
    shape: tuple[int, int],
    *,
    origin_m: tuple[float, float] | None,
    option: str,
) -> Float64[np.ndarray, "kind y x"]:
    """Shares of soil, litter, char and rock in each voxel column of a plot.

    From a GeoTIFF whose bands are named after the covers, any of them, with values of 0 to 1; the
    soil is the rest.

    **Arguments:**

    - `path`: the GeoTIFF.
    - `size_m`: (x, y) extent of the plot [m].
    - `shape`: rows and columns of voxels.
    - `origin_m`, `option`: where the plot lies in the raster, as `read_probability_map` has them.

    **Returns:** shares [kind, y, x] of 0 to 1, y to the north [-].

    **Raises:** `InputError` for a raster that cannot be read or placed, bands of other names, and
    shares below 0 or that sum to more than 1.
    """
    part = read_over_plot(path, "a map of the ground", size_m, origin_m=origin_m, option=option)
    covers = [name.lower() for name in part.names]
    for number, cover in enumerate(covers, 1):
        if cover not in COVERS or cover in covers[: number - 1]:
            raise InputError(
                f"expected bands named {', '.join(COVERS)} (any of them, once), but band {number} "
                f"is {part.names[number - 1] or 'unnamed'!r}.{did_you_mean(cover, COVERS)} The "
                "names are the bands' descriptions."
            )
    total = part.values.sum(axis=0)
    if part.values.min() < 0.0 or total.max() > 1.0 + 1e-3:
        wrong = part.values.min() if part.values.min() < 0.0 else total.max()
        raise InputError(
            "expected shares of 0 to 1 that sum to at most 1, but "
            f"{'one is' if wrong < 0 else 'they sum to'} {wrong:g}. Percent? Divide by 100."
        )
    shares = np.zeros((len(COVERS) + 1, *shape))
    for name, values in zip(covers, part.in_cells(shape), strict=True):
        shares[1 + COVERS.index(name)] = np.clip(values, 0.0, 1.0)  # but for rounding
    shares[0] = np.maximum(1.0 - shares[1:].sum(axis=0), 0.0)
    return shares

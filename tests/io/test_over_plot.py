"""The part of a raster over a plot, put on other cells."""

from pathlib import Path

import numpy as np
from scipy.interpolate import RegularGridInterpolator

from fynjax.app.io.raster._over_plot import OverPlot

VALUES = np.random.default_rng(0).normal(size=(2, 8, 10))  # rows from the north


def over(values, edges):
    return OverPlot(Path("a.tif"), values, edges, ("", ""), ("", ""))


def test_smooth_quantities_are_linear_between_wide_cells_and_means_of_narrow_ones():
    """Against another interpolator; the plot begins 0.5 rows and 1.25 columns into the part."""
    part = over(VALUES, ((0.5, 7.0), (1.25, 9.25)))
    row = 0.5 + (np.arange(26) + 0.5) * 6.5 / 26
    column = 1.25 + (np.arange(20) + 0.5) * 8.0 / 20
    at = np.stack(np.meshgrid(row, column, indexing="ij"), axis=-1)
    for got, band in zip(part.at_centres((26, 20)), VALUES, strict=True):
        middle = (np.arange(8) + 0.5, np.arange(10) + 0.5)
        other = RegularGridInterpolator(middle, band, bounds_error=False, fill_value=None)
        np.testing.assert_allclose(got[::-1], other(at), atol=1e-12)
    whole = over(VALUES, ((0.0, 8.0), (0.0, 10.0)))
    means = VALUES.reshape(2, 2, 4, 2, 5).mean(axis=(2, 4))
    np.testing.assert_allclose(whole.at_centres((2, 2)), means[:, ::-1], atol=1e-12)
    # Rows apart from columns; a single row stays what it is.
    strip = over(VALUES[:, :1], ((0.25, 0.75), (0.0, 10.0)))
    np.testing.assert_allclose(
        strip.at_centres((3, 5)), np.repeat(VALUES[:, :1].reshape(2, 1, 5, 2).mean(-1), 3, axis=1)
    )

"""Bands that several lenses took at once, brought onto the first one's pixels."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

from fynjax._core.errors import InputError
from fynjax._core.extras import require
from fynjax._core.progress import advance, track

_SMOOTH = 1.5
"""Standard deviation of the smoothing before edges are taken [pixel]."""
_LEAST_TILES = 6
_LEAST_MATCH = 0.25
"""Correlation of the edges of two bands below which they are not of one scene: between bands of one
capture it was 0.42 (red and near infrared over bushes) to 0.99, between captures 0.07 to 0.15."""


@dataclass(frozen=True)
class Alignment:
    """How one band was laid on the first."""

    shift: tuple[float, float]
    """Movement of the image's middle (east, north) [pixel]."""
    residual: float
    """Median distance by which tiles still miss each other [pixel]."""
    match: float
    """Correlation of the edges of both bands afterwards [-]."""


def align_bands(
    image: Float[np.ndarray, "band y x"],
) -> tuple[Float[np.ndarray, "band row column"], tuple[slice, slice], list[Alignment]]:
    """Lay every band on the first, whose frame is kept.

    The lenses of a camera sit side by side and are not quite parallel. Bands are compared by their
    edges, since plants are bright in one band and dark in another: the shift of the whole by the
    peak of the cross-correlation (scikit-image, Guizar-Sicairos et al. 2008), then that of tiles,
    to which an affine map is fitted, robust to tiles without a match (RANSAC). One affine map
    serves ground that is flat beside the height of flight; a wall or a tall tree keeps its
    parallax.

    **Arguments:** `image`: [band, y, x] in any unit, finite, at least 80 x 80 pixels; row 0 at the
    southern edge.

    **Returns:** the aligned bands, cut to the part that all of them cover; that cut as slices (y,
    x) of the first band; an `Alignment` for each band.

    **Raises:** `InputError` where a band does not fit the first; `MissingExtraError` without
    scikit-image.
    """
    filters = require("skimage.filters", "analysis", "scikit-image")
    transform = require("skimage.transform", "analysis", "scikit-image")
    bands, rows, columns = image.shape
    tile = min(rows, columns) // 5
    if tile < 16:
        raise InputError(
            f"bands can be aligned from 80 x 80 pixels on, but are {columns} x {rows}. Align them "
            "first, and leave it out here (--no-align)."
        )

    def edges(band: NDArray[Any]) -> NDArray[np.float64]:
        wide = float(band.std()) or 1.0
        return np.asarray(filters.sobel(filters.gaussian(band / wide, _SMOOTH)), float)

    first = edges(image[0])
    corners = np.array([[0, 0], [columns - 1, 0], [columns - 1, rows - 1], [0, rows - 1]], float)
    outlines = [corners]
    aligned = [image[0]]
    alignments = [Alignment((0.0, 0.0), 0.0, 1.0)]
    middle = np.array([[(columns - 1) / 2.0, (rows - 1) / 2.0]])
    for number in track(range(1, bands), "Align the bands"):
        # First the shift of the whole, then an affine map by what its tiles are still off.
        other = edges(image[number])
        shift = _shift(first, other)
        onto = transform.AffineTransform(translation=-shift)
        onto = _fitted(first, transform.warp(other, onto, order=1), onto, tile)
        # How well both fit where they overlap.
        after = transform.warp(other, onto, order=1)
        outlines.append(onto.inverse(corners))
        y, x = _common(outlines[:1] + outlines[-1:])
        match = float(np.corrcoef(first[y, x].ravel(), after[y, x].ravel())[0, 1])
        if not match > _LEAST_MATCH:
            raise InputError(
                f"band {number + 1} does not fit the first: their edges correlate by {match:.2f} "
                "after alignment. Are all files of one capture, and of the ground from above?"
            )
        _, moved = _tile_shifts(first, after, tile)
        missed = float(np.median(np.hypot(*moved.T))) if len(moved) else float("nan")
        east, north = (middle - onto(middle))[0]
        alignments.append(Alignment((float(east), float(north)), missed, match))
        warped = transform.warp(image[number], onto, order=1, preserve_range=True)
        aligned.append(warped.astype(image.dtype))
        advance(0, match=match)
    y, x = _common(outlines)
    return np.stack([band[y, x] for band in aligned]), (y, x), alignments


def _shift(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    """By how much (x, y) the content of `b` must move to lie on `a` [pixel]."""
    registration = require("skimage.registration", "analysis", "scikit-image")
    # Not normalised to phase: at the noise of a camera that follows fixed patterns of its chip.
    shift = registration.phase_cross_correlation(
        a - a.mean(), b - b.mean(), upsample_factor=10, normalization=None
    )[0]
    return np.asarray(shift[::-1], float)


def _tile_shifts(
    a: NDArray[np.float64], b: NDArray[np.float64], tile: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Middles of tiles (x, y) and the shifts of `b` onto `a` in each [pixel]."""
    taper = np.outer(np.hanning(tile), np.hanning(tile))
    margin = tile // 3  # where the whole was shifted nothing is left to compare
    middles, shifts = [], []
    for y in range(margin, a.shape[0] - tile - margin + 1, tile // 2):
        for x in range(margin, a.shape[1] - tile - margin + 1, tile // 2):
            p, q = (band[y : y + tile, x : x + tile] for band in (a, b))
            if np.ptp(p) == 0.0 or np.ptp(q) == 0.0:
                continue
            shift = _shift((p - p.mean()) * taper, (q - q.mean()) * taper)
            if np.hypot(*shift) < tile / 8.0:
                middles.append((x + (tile - 1) / 2.0, y + (tile - 1) / 2.0))
                shifts.append(shift)
    return np.array(middles).reshape(-1, 2), np.array(shifts).reshape(-1, 2)


def _fitted(a: NDArray[np.float64], b: NDArray[np.float64], onto: Any, tile: int) -> Any:
    """The affine map from pixels of the first band to those of the other, by tiles.

    `b` is the other band already moved by `onto`, which is what comes back where too few tiles
    find a match.
    """
    measure = require("skimage.measure", "analysis", "scikit-image")
    middles, shifts = _tile_shifts(a, b, tile)
    if len(middles) < _LEAST_TILES:
        return onto
    model, kept = measure.ransac(
        (middles, onto(middles - shifts)),
        type(onto),
        min_samples=4,
        residual_threshold=1.5,
        max_trials=500,
        rng=0,
    )
    return onto if model is None or kept.sum() < _LEAST_TILES else model


def _common(corners: list[NDArray[np.float64]]) -> tuple[slice, slice]:
    """Rows and columns inside every quadrilateral of corners (x, y), in order around it."""
    stacked = np.stack(corners)
    left = int(np.ceil(stacked[:, [0, 3], 0].max()))
    right = int(np.floor(stacked[:, [1, 2], 0].min()))
    low = int(np.ceil(stacked[:, [0, 1], 1].max()))
    high = int(np.floor(stacked[:, [2, 3], 1].min()))
    if right - left < 2 or high - low < 2:
        raise InputError("the bands have no part in common. Are all files of one capture?")
    return slice(low, high + 1), slice(left, right + 1)

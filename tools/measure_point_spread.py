"""Measure the point spread of a RedEdge on the edges of a reflectance panel.

`python -m tools.measure_point_spread IMG_0000_1.tif IMG_0000_2.tif ...` prints, for each band and
each edge of the panel, the full width at half maximum of the Gaussian that comes on top of the
pixel's own footprint, in pixels, as a sensor file has it (`psf.width_pixels`).

An edge that is not quite along the pixels is seen at all distances from their centres (slanted
edge, ISO 12233); the step that pixels and blur make of it is fitted to them.
"""

import sys
from pathlib import Path

import numpy as np
from PIL import Image
from scipy.optimize import least_squares
from scipy.special import ndtr

from fynjax._core.spectral import FWHM_PER_SIGMA
from fynjax.app.io.captures._panel import find_panel

REACH = 6.0
"""Pixels on each side of an edge that are compared: beyond lies what is not the panel."""
SEARCHED = 12.0
"""Pixels about its rough place in which an edge is looked for."""


def step(distance: np.ndarray, sigma: float) -> np.ndarray:
    """From 0 to 1 at distance 0 [pixels], by a pixel of width 1 and a Gaussian of `sigma`."""

    def integral(x: np.ndarray) -> np.ndarray:  # of the cumulative normal distribution
        z = x / sigma
        return x * ndtr(z) + sigma * np.exp(-0.5 * z**2) / np.sqrt(2.0 * np.pi)

    return integral(distance + 0.5) - integral(distance - 0.5)


def edge_width(picture: np.ndarray, start: np.ndarray, end: np.ndarray) -> tuple[float, float]:
    """Full width at half maximum [pixels] of the Gaussian at the edge near the line from `start` to
    `end` (row, column), and the root mean square of what the fit leaves, over the height of the
    step."""
    length = np.linalg.norm(end - start)
    along = (end - start) / length
    row, column = np.indices(picture.shape)
    places = np.stack([row, column], axis=-1) - start
    share, far = places @ along / length, places @ np.array([-along[1], along[0]])
    middle = (share > 0.2) & (share < 0.8)  # without the corners
    rough = np.arange(-SEARCHED, SEARCHED)
    profile = [picture[middle & (np.abs(far - x) < 1.0)].mean() for x in rough]
    offset = rough[np.argmax(np.abs(np.gradient(profile)))]
    near = middle & (np.abs(far - offset) < REACH)
    value, share, far = picture[near], share[near] - 0.5, far[near]

    def model(p: np.ndarray) -> np.ndarray:
        """A step whose place and turn are fitted too, between sides that may be sloped."""
        distance = far - p[0] - p[1] * share
        low, high = p[3] + p[4] * distance, p[5] + p[6] * distance
        return low + (high - low) * step(distance, abs(p[2]) + 1e-3)

    sides = value[far < offset - 3.0].mean(), value[far > offset + 3.0].mean()
    first = [offset, 0.0, 0.7, sides[0], 0.0, sides[1], 0.0]
    found = least_squares(lambda p: model(p) - value, first, x_scale=np.maximum(np.abs(first), 0.1))
    left = np.sqrt(np.mean(found.fun**2)) / abs(found.x[5] - found.x[3])
    return FWHM_PER_SIGMA * abs(found.x[2]), float(left)


def panel_widths(picture: np.ndarray) -> list[tuple[float, float]]:
    """`edge_width` of the four edges of the panel in a picture."""
    inner = find_panel(picture)
    if inner is None:
        raise SystemExit("no panel found")
    middle = inner.mean(axis=0)
    corners = (middle + (inner - middle) / 0.75 - 0.5)[:, ::-1]  # `find_panel` has three quarters
    edges = zip(corners, np.roll(corners, -1, axis=0), strict=True)
    return [edge_width(picture, start, end) for start, end in edges]


if __name__ == "__main__":
    for path in map(Path, sys.argv[1:]):
        found = panel_widths(np.asarray(Image.open(path), float))
        print(path.name, ", ".join(f"{width:.2f} (rest {left:.3f})" for width, left in found))

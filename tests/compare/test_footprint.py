"""Blur of an image from its power spectrum: a known one is given back."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter, uniform_filter

from fynjax.app.compare import pixel_footprint

FINER, SIDE, SIGMA = 6, 128, 1.0 / 2.35482


@pytest.fixture(scope="module")
def ground() -> np.ndarray:
    """Discs of many sizes, one over the other ("dead leaves"; Lee, Mumford and Huang 2001)."""
    n, random = SIDE * FINER, np.random.default_rng(0)
    y, x = np.mgrid[:n, :n]
    scene = np.zeros((n, n))
    for r in random.uniform(150.0**-2, 1.5**-2, 20000) ** -0.5:
        cx, cy = random.uniform(0, n, 2)
        rows = slice(max(int(cy - r), 0), int(cy + r) + 2)
        columns = slice(max(int(cx - r), 0), int(cx + r) + 2)
        disc = (x[rows, columns] - cx) ** 2 + (y[rows, columns] - cy) ** 2 <= r * r
        scene[rows, columns][disc] = random.normal()
    return scene


def photograph(ground: np.ndarray, width: float) -> np.ndarray:
    """Pixels of a ground that optics blur by `width` pixels, full width at half maximum."""
    blurred = gaussian_filter(ground, FINER * width * SIGMA)
    return blurred.reshape(SIDE, FINER, SIDE, FINER).mean(axis=(1, 3))


@pytest.mark.parametrize("width", [2.0, 3.0])
@pytest.mark.parametrize("noise", [0.0, 0.01])
def test_a_known_blur_is_given_back(ground, width, noise):
    """As the square of the same variance; the camera's own blur does not count."""
    image = photograph(ground, width)[None]
    image = image + noise * np.random.default_rng(1).normal(size=image.shape)
    mask = np.ones(image.shape[1:], bool)
    mask[:8] = False
    image[:, :8] = np.nan
    for own in (0.0, 1.5):
        variance = (width**2 - own**2) * SIGMA**2
        found = pixel_footprint(image, mask, blur=own)
        assert found == pytest.approx(np.sqrt(1.0 + 12.0 * variance), rel=0.15 if own else 0.1)


@pytest.mark.parametrize("side", [2, 3, 4])
def test_means_over_squares_are_known_as_such(ground, side):
    image = uniform_filter(ground, side * FINER)[::FINER, ::FINER][None]
    assert pixel_footprint(image, np.ones(image.shape[1:], bool)) == pytest.approx(side, rel=0.1)


def test_a_sharp_image_is_sharp_and_a_small_one_says_nothing(ground):
    sharp = photograph(ground, 0.0)
    every = np.ones(sharp.shape, bool)
    assert 0.7 < pixel_footprint(sharp[None], every) < 1.5
    assert pixel_footprint(sharp[None, :60], every[:60]) is None
    noise = np.random.default_rng(2).normal(size=(1, *sharp.shape))
    assert pixel_footprint(noise, every) is None

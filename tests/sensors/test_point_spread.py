"""The point spread of a RedEdge, measured on the edges of a panel."""

import numpy as np
import pytest
from PIL import Image
from scipy.special import ndtr

from fynjax.sensors import shipped_sensor
from tools.measure_point_spread import edge_width, panel_widths


@pytest.mark.parametrize("width", [0.6, 1.7, 2.5])
def test_the_width_of_an_edge_is_found(width):
    """Of an edge that was blurred, averaged over pixels by many points each, and made noisy."""
    rng, sigma = np.random.default_rng(0), width / np.sqrt(8.0 * np.log(2.0))
    row, column = np.indices((120, 40)).astype(float)
    points = (np.arange(8) + 0.5) / 8 - 0.5
    image = np.zeros(row.shape)
    for y in points:
        for x in points:
            image += ndtr((column + x - 20.3 - 0.03 * (row + y - 60.0)) / sigma) / 64.0
    image = 100.0 + 900.0 * image + rng.normal(0.0, 9.0, image.shape)
    found, left = edge_width(image, np.array([10.0, 18.0]), np.array([110.0, 18.0]))
    assert found == pytest.approx(width, abs=0.05)
    assert left == pytest.approx(0.01, rel=0.1)


def test_the_shipped_width_is_that_of_the_pictures(shared_data):
    folder = shared_data / "eco" / "uas_micasense"
    widths = [
        width
        for band in (2, 5)
        for width, _ in panel_widths(np.asarray(Image.open(folder / f"IMG_0000_{band}.tif"), float))
    ]
    stated = float(shipped_sensor("rededge_3").psf.width[0])
    assert stated == pytest.approx(np.mean(widths), abs=0.2)
    assert min(widths) > 1.2
    assert max(widths) < 2.1

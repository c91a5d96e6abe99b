"""K-means of an image: known clusters, another K-means, the order, and what sites make of it."""

from typing import Any

import numpy as np
import pytest
from scipy.cluster.vq import kmeans2

from fynjax._core.errors import InputError
from fynjax.canopy import (
    assign_sites,
    band_roles,
    choose_greenness,
    poisson_disk,
    vegetation_pattern,
)
from fynjax.canopy._pattern import even_levels

pytest.importorskip("sklearn", reason="needs the extra `analysis`")

BANDS = ("green", "red", "nir")
NDVI = choose_greenness(BANDS)
#                  green  red   nir
SPECTRA = np.array(
    [
        [0.18, 0.25, 0.30],  # sand
        [0.10, 0.12, 0.22],  # dry shrub
        [0.05, 0.04, 0.35],  # green shrub
    ]
)


def drawn(noise: float = 0.01, size: int = 60) -> tuple[np.ndarray, np.ndarray]:
    """An image [band, y, x] of known classes, 0 the least green, and the classes."""
    rng = np.random.default_rng(4)
    y, x = np.mgrid[:size, :size] / size
    truth = np.where(y < 0.3, 2, np.where(x < 0.45, 0, 1))  # row 0, the south, is green
    image = SPECTRA[truth].transpose(2, 0, 1) + noise * rng.standard_normal((3, size, size))
    return image, truth


def test_known_clusters_come_back_in_order() -> None:
    image, truth = drawn()
    found = vegetation_pattern(image, NDVI)
    np.testing.assert_array_equal(found.cluster, truth)
    assert found.grey.dtype == np.uint8
    np.testing.assert_array_equal(found.grey, np.array([85, 170, 255])[truth])
    np.testing.assert_allclose(found.share, np.bincount(truth.ravel()) / truth.size)
    np.testing.assert_allclose(found.spectrum, SPECTRA, atol=2e-3)
    np.testing.assert_allclose(found.spread, 0.01, rtol=0.1)
    ndvi = (SPECTRA[:, 2] - SPECTRA[:, 1]) / (SPECTRA[:, 2] + SPECTRA[:, 1])
    np.testing.assert_allclose(found.greenness, ndvi, atol=0.01)


@pytest.mark.parametrize("dtype", [np.uint16, np.float32])
def test_the_unit_of_a_band_does_not_matter(dtype: Any) -> None:
    image, truth = drawn()
    # One band is brighter by far, as of a camera with another exposure.
    raw = (image.clip(0) * np.array([40000.0, 20000.0, 60000.0])[:, None, None]).astype(dtype)
    np.testing.assert_array_equal(vegetation_pattern(raw, NDVI).cluster, truth)


def test_the_inertia_is_the_least_that_another_k_means_finds() -> None:
    image, _ = drawn(noise=0.07, size=30)  # the clusters overlap widely
    found = vegetation_pattern(image, NDVI, greenness_weight=0.0)
    points = image.reshape(3, -1).T
    points = (points - points.mean(axis=0)) / points.std(axis=0)

    def inertia(label: np.ndarray) -> float:
        return sum(
            float(((points[label == k] - points[label == k].mean(axis=0)) ** 2).sum())
            for k in range(3)
        )

    others = [inertia(kmeans2(points, 3, iter=300, minit="++", rng=s)[1]) for s in range(40)]
    assert inertia(found.cluster.ravel()) == pytest.approx(min(others), rel=1e-4)
    assert found.inertia * len(points) == pytest.approx(min(others), rel=1e-4)


def test_many_pixels_are_clustered_as_few(monkeypatch: pytest.MonkeyPatch) -> None:
    image, truth = drawn()
    monkeypatch.setattr("fynjax.canopy._pattern._SAMPLE", 400)
    np.testing.assert_array_equal(vegetation_pattern(image, NDVI).cluster, truth)


def test_the_same_seed_gives_the_same_map() -> None:
    image, _ = drawn(noise=0.1)
    first, again = (vegetation_pattern(image, NDVI, clusters=5, seed=9) for _ in range(2))
    np.testing.assert_array_equal(first.grey, again.grey)


def test_light_and_shadow_do_not_hide_the_plants() -> None:
    """Shadow is what varies most here; the bands alone follow it, with greenness they do not."""
    rng = np.random.default_rng(1)
    plant = rng.random((50, 50)) < 0.4
    light = np.where(rng.random((50, 50)) < 0.5, 1.0, 0.25)
    image = SPECTRA[np.where(plant, 2, 0)].transpose(2, 0, 1) * light
    image += 0.003 * rng.standard_normal(image.shape)
    alone = vegetation_pattern(image, NDVI, clusters=2, greenness_weight=0.0)
    both = vegetation_pattern(image, NDVI, clusters=2)
    assert np.mean((both.cluster == 1) == plant) > 0.999
    assert np.mean((alone.cluster == 1) == plant) < 0.9


def test_masked_pixels_take_no_part() -> None:
    image, truth = drawn()
    image[:, :, 50:] = 1e9  # what a file without data may hold
    image[1, 0, 0] = np.nan
    mask = np.ones(truth.shape, bool)
    mask[:, 50:] = False
    mask[0, 0] = False
    found = vegetation_pattern(image, NDVI, mask=mask)
    np.testing.assert_array_equal(found.cluster, np.where(mask, truth, -1))
    assert found.nodata == 0
    np.testing.assert_array_equal(found.grey, np.where(mask, np.array([85, 170, 255])[truth], 0))
    assert found.share.sum() == pytest.approx(1.0)
    # Where 0 is a level it cannot also say that there is no data.
    bare = vegetation_pattern(image, NDVI, mask=mask, levels=[0, 1, 255])
    assert bare.nodata == 2
    np.testing.assert_array_equal(bare.grey, np.where(mask, np.array([0, 1, 255])[truth], 2))


def test_even_levels() -> None:
    assert even_levels(3) == (85, 170, 255)
    assert even_levels(2) == (128, 255)


@pytest.mark.parametrize(
    ("names", "wavelengths", "index", "order"),
    [
        (("b1", "b2", "b3"), (560, 650, 860), "auto", [0, 1, 2]),
        (("GREEN", "Red", "Near infrared"), None, "auto", [0, 1, 2]),
        (BANDS, None, "ndvi", [0, 1, 2]),
        (("b1", "b2", "b3"), None, "3", [1, 0, 2]),  # near infrared alone
        (("b1", "b2", "b3"), None, "-b2", [0, 1, 2]),
        (("b1", "b2", "b3"), None, "b2", [2, 1, 0]),
    ],
)
def test_what_orders_the_clusters(
    names: tuple[str, ...], wavelengths: Any, index: str, order: list[int]
) -> None:
    image, truth = drawn()
    green = choose_greenness(names, wavelengths, index=index)
    rank = np.argsort(order)  # class -> place, where `order` lists classes by greenness
    np.testing.assert_array_equal(vegetation_pattern(image, green).cluster, rank[truth])


def test_excess_green_orders_colour_pictures() -> None:
    _, truth = drawn()
    colours = np.array([[200, 180, 150], [120, 110, 80], [60, 110, 50]])  # red, green, blue
    image = colours[truth].transpose(2, 0, 1)
    green = choose_greenness(("red", "green", "blue"))
    found = vegetation_pattern(image, green)
    np.testing.assert_array_equal(found.cluster, truth)
    # (2 * 110 - 60 - 50) / 220
    assert found.greenness[2] == pytest.approx(0.5)


def test_bands_are_known_by_name_then_by_wavelength() -> None:
    names = ("Blue", "Green", "Red", "NIR", "Red edge")
    assert band_roles(names) == {"blue": 0, "green": 1, "red": 2, "nir": 3}
    waves = [475.0, 560.0, 668.0, 717.0, 842.0, 1600.0]
    assert band_roles([f"b{k}" for k in range(6)], waves) == {
        "blue": 0,
        "green": 1,
        "red": 2,
        "nir": 4,
    }
    assert band_roles(["x", "y"], [None, 1600.0]) == {}


@pytest.mark.parametrize(
    ("names", "index", "word"),
    [
        (("b1", "b2"), "auto", "--bands"),
        (("red", "green"), "ndvi", "known as nir"),
        (("red", "nir"), "excess_green", "known as green"),
        (("red", "nir"), "ndwi", "auto, ndvi, excess_green, or a band"),
        (("red", "nir"), "3", "its number from 1"),
    ],
)
def test_a_greenness_that_cannot_be(names: tuple[str, ...], index: str, word: str) -> None:
    with pytest.raises(InputError, match=word):
        choose_greenness(names, index=index)


@pytest.mark.parametrize(
    ("change", "word"),
    [
        ({"clusters": 1}, "`clusters` must be from 2 to 255"),
        ({"levels": [0, 255]}, "`levels` must be 3"),
        ({"levels": [255, 128, 0]}, "not falling"),
        ({"levels": [0, 0, 0]}, "the last above 0"),
        ({"levels": [0, 128, 256]}, "from 0 to 255"),
        ({"levels": [0, 0.5, 1.0]}, "whole numbers"),
        ({"greenness_weight": -1.0}, "at least 0"),
        ({"mask": np.ones((3, 3), bool)}, "`mask` must have shape"),
        ({"mask": np.zeros((60, 60), bool)}, "at least 3 pixels with data"),
        ({"image": np.ones((3, 9, 9))}, "Is it blank"),
        ({"image": np.ones((9, 9))}, r"\[band, y, x\]"),
        ({"image": np.full((3, 60, 60), np.nan), "mask": np.ones((60, 60), bool)}, "finite"),
        ({"image": drawn()[0] - 5.0}, "offset subtracted twice"),
    ],
)
def test_bad_input(change: dict[str, Any], word: str) -> None:
    arguments = {"image": drawn()[0]} | change
    with pytest.raises(InputError, match=word):
        vegetation_pattern(arguments.pop("image"), NDVI, **arguments)


def test_sites_follow_the_greys() -> None:
    """The first to be accepted are of each cluster as many as its points times its grey."""
    image, truth = drawn()
    found = vegetation_pattern(image, NDVI)
    points = poisson_disk((10.0, 10.0), 0.04, seed=2)
    (sites,) = assign_sites(points, [6000], probability=found.grey, extent=(10, 10), seed=7)

    def count(places: np.ndarray) -> np.ndarray:
        column, row = (places / 10.0 * 60).astype(int).T
        return np.bincount(truth[row, column], minlength=3)

    offered = count(points) * np.array([85, 170, 255]) / 255.0
    assert offered.sum() > 2 * 6000  # else the second round would fill up the sparse clusters
    expected = 6000 * offered / offered.sum()
    chi2 = float(((count(sites) - expected) ** 2 / expected).sum())
    assert chi2 < 13.8  # 2 degrees of freedom, 0.1 %

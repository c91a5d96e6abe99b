"""Spectral diversity: plain loops after the definitions of papers and R packages, closed forms.

No package of R was run. `specdiv`, `rasterdiv` and `biodivMapR` state their definitions in code,
which the loops here follow; the value of rasterdiv is that of the formula in its own tests.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from fynjax.diversity import (
    coefficient_of_variation,
    diversity_map,
    hill_partition,
    hull_volume,
    lit_pixels,
    mean_spectral_angle,
    normalise_brightness,
    principal_components,
    spectral_partition,
    spectral_rao,
    spectral_species,
    windows,
)
from fynjax.errors import InputError


def image(seed: int = 0, bands: int = 4, side: int = 6) -> np.ndarray:
    """[band, y, x] reflectance."""
    return np.random.default_rng(seed).uniform(0.05, 0.5, size=(bands, side, side))


def pixels(seed: int = 0, count: int = 7, bands: int = 4) -> np.ndarray:
    return np.random.default_rng(seed).uniform(0.05, 0.5, size=(count, bands))


def with_masked(spectra: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The same pixels with two more, of NaN and of a large number, that do not count."""
    more = np.vstack([spectra[:3], np.full((1, spectra.shape[1]), np.nan), spectra[3:]])
    more = np.vstack([more, np.full((1, spectra.shape[1]), 9.0)])
    return more, np.array([True] * 3 + [False] + [True] * (len(spectra) - 3) + [False])


def test_windows_are_pieces_of_the_image() -> None:
    data = image()[:, :, :5]
    cut = np.asarray(windows(data, 2))
    assert cut.shape == (3, 2, 4, 4)
    for row in range(3):
        for column in range(2):
            piece = data[:, 2 * row : 2 * row + 2, 2 * column : 2 * column + 2]
            np.testing.assert_array_equal(cut[row, column], piece.reshape(4, -1).T)
    cover = np.zeros((2, 2, 4))
    cover[0, :, :2] = cover[1, :, 2:] = 30.0  # two windows, a species each
    assert float(hill_partition(windows(cover, 2).mean(axis=2)).beta) == pytest.approx(2.0)


def test_coefficient_of_variation_is_its_loop() -> None:
    spectra = pixels()
    for freedom in (0, 1):
        bands = []
        for band in spectra.T:
            mean = sum(band) / 7
            bands.append(np.sqrt(sum((v - mean) ** 2 for v in band) / (7 - freedom)) / mean)
        got = coefficient_of_variation(*with_masked(spectra), freedom=freedom)
        assert float(got) == pytest.approx(sum(bands) / 4, rel=1e-12)


def test_mean_angle_is_its_loop() -> None:
    spectra = pixels()
    mean = spectra.mean(axis=0)
    cosines = [x @ mean / np.sqrt((x @ x) * (mean @ mean)) for x in spectra]
    expected = np.degrees(np.arccos(cosines)).mean()
    assert float(mean_spectral_angle(*with_masked(spectra))) == pytest.approx(expected, rel=1e-9)
    assert float(mean_spectral_angle([[0.1, 0.2], [0.2, 0.4]])) == pytest.approx(0.0, abs=1e-6)


def test_rao_of_the_example_in_the_tests_of_rasterdiv() -> None:
    """tests/testthat/test_paRao.R: a 3 x 3 window, alpha 1; sum of 2 d / 9^2 is 640 / 81.

    The distances between its values: 12 pairs of 10, 6 of 20 and 8 of 10.
    """
    window = np.array([10.0, 10.0, 10.0, 20.0, 20.0, 20.0, 20.0, 30.0, 30.0])
    assert float(spectral_rao(window[:, None])) == pytest.approx(640.0 / 81.0, rel=1e-12)


def test_rao_is_its_double_loop() -> None:
    """mpaRaoS of rasterdiv: every unordered pair twice, over the number of pixels squared."""
    spectra = pixels()
    total = sum(np.sqrt(sum((a - b) ** 2)) for a in spectra for b in spectra)
    got = spectral_rao(*with_masked(spectra))
    assert float(got) == pytest.approx(total / 49.0, rel=1e-12)
    assert spectral_rao(np.stack([[spectra] * 3] * 2)).shape == (2, 3)


def parts_in_loops(sites: list[np.ndarray]) -> dict[str, object]:
    """Sums of squares as `sum_squares` and `sum_squares_beta` of specdiv form them."""
    everything = np.vstack(sites)
    centre = everything.mean(axis=0)
    gamma = np.zeros(everything.shape[1])
    for pixel in everything:
        gamma += (pixel - centre) ** 2
    alpha, between = [], []
    for site in sites:
        within, apart = np.zeros(len(centre)), np.zeros(len(centre))
        for pixel in site:
            within += (pixel - site.mean(axis=0)) ** 2
            apart += (site.mean(axis=0) - centre) ** 2  # once for each pixel of the site
        alpha.append(within)
        between.append(apart)
    beta = np.sum(between, axis=0)
    count = len(everything)
    return {
        "alpha": [a.sum() for a in alpha],
        "beta": beta.sum(),
        "gamma": gamma.sum(),
        "alpha_diversity": [a.sum() / (len(s) - 1) for a, s in zip(alpha, sites)],
        "beta_diversity": beta.sum() / (count - 1),
        "gamma_diversity": gamma.sum() / (count - 1),
        "site_share": [b.sum() / beta.sum() for b in between],
        "alpha_band_share": [a / a.sum() for a in alpha],
        "beta_band_share": beta / beta.sum(),
        "gamma_band_share": gamma / gamma.sum(),
    }


@pytest.mark.parametrize("masked", [False, True])
def test_sums_of_squares_are_the_loops_of_specdiv(masked: bool) -> None:
    spectra = np.stack([pixels(k) + 0.1 * k for k in range(3)])
    valid = np.ones(spectra.shape[:2], bool)
    if masked:  # sites of 7, 5 and 6 pixels, and NaN where none counts
        valid[1, :2] = valid[2, 4] = False
    sites = [x[k] for x, k in zip(spectra, valid)]
    got = spectral_partition(np.where(valid[..., None], spectra, np.nan), valid)
    for name, value in parts_in_loops(sites).items():
        np.testing.assert_allclose(getattr(got, name), value, rtol=1e-10, err_msg=name)
    assert float(got.alpha.sum() + got.beta) == pytest.approx(float(got.gamma), rel=1e-12)
    assert float(got.site_share.sum()) == pytest.approx(1.0)


def test_brightness_and_shade() -> None:
    spectra = pixels()
    got = np.asarray(normalise_brightness(spectra))
    np.testing.assert_allclose(np.linalg.norm(got, axis=1), 1.0)
    np.testing.assert_allclose(normalise_brightness(3.0 * spectra), got, rtol=1e-12)
    lit = lit_pixels(np.array([[0.1, 0.3], [0.1, 0.28], [np.nan, 0.9]]), 0.2)
    assert lit.tolist() == [True, False, False]


SLOPED = {
    "cv": coefficient_of_variation,
    "angle": mean_spectral_angle,
    "rao": spectral_rao,
    "beta": lambda x: spectral_partition(x.reshape(2, 3, 4)).beta_diversity,
    "share": lambda x: spectral_partition(x.reshape(2, 3, 4)).site_share[0],
    "normalised": lambda x: spectral_rao(normalise_brightness(x)),
}


@pytest.mark.parametrize("name", SLOPED)
def test_slopes_are_difference_quotients(name: str) -> None:
    spectra = jnp.asarray(pixels(3, count=6))
    slope = jax.jit(jax.grad(SLOPED[name]))(spectra)
    function = jax.jit(SLOPED[name])
    for place in ((0, 0), (2, 3), (5, 1)):
        step = jnp.zeros_like(spectra).at[place].set(1e-5)
        quotient = (function(spectra + step) - function(spectra - step)) / 2e-5
        assert float(slope[place]) == pytest.approx(float(quotient), rel=1e-5, abs=1e-8)


@pytest.mark.parametrize("name", ["cv", "angle", "rao"])
def test_equal_pixels_and_masked_ones_have_finite_slopes(name: str) -> None:
    function = SLOPED[name]
    equal = jnp.full((3, 2), 0.25)
    assert float(function(equal)) == pytest.approx(0.0, abs=1e-6)
    assert bool(jnp.isfinite(jax.grad(function)(equal)).all())
    spectra, valid = with_masked(pixels())
    slope = jax.grad(lambda x: function(x, valid))(jnp.asarray(spectra))
    assert bool(jnp.isfinite(slope).all())
    assert not np.asarray(slope)[~valid].any()


def test_components_are_those_of_the_covariance() -> None:
    spectra = pixels(1, count=40)
    for standardise in (False, True):
        got = principal_components(spectra, 3, standardise=standardise)
        matrix = np.corrcoef(spectra.T) if standardise else np.cov(spectra.T)
        value = np.sort(np.linalg.eigvalsh(matrix))[::-1]
        np.testing.assert_allclose(got.variance, value[:3], rtol=1e-10)
        np.testing.assert_allclose(got.share, value[:3] / value.sum(), rtol=1e-10)
        np.testing.assert_allclose(got.axes @ matrix, got.variance[:, None] * got.axes, atol=1e-12)
        scores = got.scores(spectra)
        np.testing.assert_allclose(np.cov(scores.T), np.diag(got.variance), atol=1e-12)


def test_hulls_of_known_volume() -> None:
    corners = np.array(np.meshgrid(*[[0.0, 1.0]] * 3)).reshape(3, -1).T * [2.0, 3.0, 4.0]
    inside = np.vstack([corners, [[1.0, 1.0, 1.0]]])
    assert hull_volume(inside) == pytest.approx(24.0)
    turn = np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))[0]
    assert hull_volume(inside @ turn) == pytest.approx(24.0)
    assert hull_volume(corners[[0, 1, 2, 4]]) == pytest.approx(4.0)  # a corner: 2 * 3 * 4 / 6
    assert hull_volume([[1.0], [4.0], [2.0]]) == 3.0
    assert hull_volume(np.c_[corners[:, :2], corners[:, 0]]) == 0.0


def test_map_has_what_each_window_has_alone() -> None:
    data = image(side=7)
    valid = np.ones((7, 7), bool)
    valid[:3, :3] = False
    valid[0, 0] = valid[4, 4] = valid[1, 1] = False
    data[:, ~valid] = np.nan
    got = diversity_map(data, 3, valid=valid, pixel=0.5, components=2)
    assert dict(got.sizes) == {"y": 2, "x": 2}
    np.testing.assert_allclose(got["x"], [0.75, 2.25])
    assert got["pixels"].values.tolist() == [[0, 9], [9, 8]]
    assert np.isnan(got["spectral_rao"].values[0, 0])
    block = data[:, 3:6, 3:6].reshape(4, -1).T
    block = block[np.isfinite(block).all(axis=1)]
    expected = {
        "coefficient_of_variation": coefficient_of_variation(block),
        "spectral_variance": block.var(axis=0, ddof=1).sum(),
        "spectral_rao": spectral_rao(block),
        "mean_spectral_angle": mean_spectral_angle(block),
    }
    for name, value in expected.items():
        assert got[name].values[1, 1] == pytest.approx(float(value), rel=1e-9), name
        assert got[name].attrs["long_name"]
    assert got["mean_spectral_angle"].attrs["units"] == "degree"
    used = np.hstack([data[:, :3, 3:6].reshape(4, -1), data[:, 3:6, :6].reshape(4, -1)])
    used = used[:, np.isfinite(used).all(axis=0)].T
    hull = hull_volume(principal_components(used, 2).scores(block))
    assert got["hull_volume"].values[1, 1] == pytest.approx(hull)


def spots(repeat: int = 1) -> np.ndarray:
    """Two windows of 100 pixels of three tight spots: 50 a, 49 b, 1 c; and 100 a."""
    rng = np.random.default_rng(0)
    places = np.array([[0.1, 0.5, 0.2], [0.5, 0.1, 0.3], [0.9, 0.9, 0.1]])
    kinds = np.array([[0] * 50 + [1] * 49 + [2], [0] * 100])
    return places[kinds] + rng.normal(0.0, 1e-3, size=(2, 100, 3))


@pytest.mark.parametrize("repeats", [1, 2])
def test_spectral_species_of_spots(repeats: int) -> None:
    """Closed forms: the single pixel is below 2 % (pcelim of biodivMapR) and does not count."""
    spectra = spots()
    clusters = 3 if repeats == 1 else 2  # half of the pixels may lack the rare spot
    got = spectral_species(spectra, clusters=clusters, components=2, repeats=repeats, seed=1)
    if repeats == 1:
        p = np.array([50.0, 49.0]) / 99.0
        np.testing.assert_allclose(got.shannon, [-np.sum(p * np.log(p)), 0.0], atol=1e-12)
        assert got.bray_curtis[0, 1] == pytest.approx(1.0 - p[0])
        assert len(set(got.label[0, :50])) == 1 == len(set(got.label[1]))
        every = spectral_species(spectra, clusters=3, components=2, least_share=0.0)
        p = np.array([0.5, 0.49, 0.01])
        assert every.shannon[0] == pytest.approx(-np.sum(p * np.log(p)))
    assert got.share.shape == (repeats, 2, clusters)
    np.testing.assert_allclose(got.share.sum(axis=-1), 1.0)
    again = spectral_species(spectra, clusters=clusters, components=2, repeats=repeats, seed=1)
    np.testing.assert_array_equal(got.label, again.label)
    masked = np.ones((2, 100), bool)
    masked[0, 50:] = False
    alone = spectral_species(spectra + 0.0, masked, clusters=2, components=2)
    assert (alone.label[0, 50:] == -1).all()


def test_components_count_alike_when_pixels_are_clustered() -> None:
    """Brightness varies ten times as much as the slope, but the slope has the two clusters."""
    rng = np.random.default_rng(0)
    brightness, kind = rng.uniform(-10.0, 10.0, (2, 100)), np.tile([0, 1], (2, 50))
    slope = 2.0 * kind - 1.0 + 0.01 * rng.normal(size=kind.shape)
    spectra = np.stack([brightness + slope, brightness - slope], axis=-1)
    label = spectral_species(spectra, clusters=2, components=2).label
    assert (label == kind).all() or (label == 1 - kind).all()


FLAT = np.full((3, 2), 0.2)


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: windows(image()[0], 2), r"\[band, y, x\]"),
        (lambda: windows(image(), 7), "from 1 to 6 pixels"),
        (lambda: lit_pixels([[0.1]], -0.1), "at least 0"),
        (lambda: lit_pixels(np.zeros((3, 0)), 0.1), "bands on its last axis"),
        (lambda: normalise_brightness([[0.0, 0.0]]), "zero in all bands"),
        (lambda: coefficient_of_variation(pixels()[0]), r"\[..., pixel, band\]"),
        (lambda: spectral_rao(np.zeros((3, 0))), r"\[..., pixel, band\]"),
        (lambda: spectral_rao(pixels(), [True]), r"must have shape \(7,\), but has \(1,\)"),
        (lambda: spectral_rao(pixels(), [False] * 7), "two pixels or more that count.*is 0"),
        (
            lambda: spectral_rao([pixels(), pixels()], [[True] * 7, [True] + [False] * 6]),
            "is 1 in window 2",
        ),
        (lambda: mean_spectral_angle([[0.1, np.nan], [0.1, 0.2]]), "1 pixels that count have NaN"),
        (lambda: coefficient_of_variation([[0.1, 0.0], [0.2, 0.0]]), "mean is positive"),
        (lambda: spectral_partition(pixels()), "two sites or more"),
        (lambda: principal_components(pixels(), 5), "number of bands"),
        (lambda: principal_components([[0.1, np.inf], [0.1, 0.2]], 1), "finite"),
        (lambda: principal_components(FLAT, 1), "all pixels are equal"),
        (lambda: hull_volume(pixels()[:4]), "more than components"),
        (lambda: hull_volume(np.full((5, 2), np.nan)), "finite points"),
        (lambda: diversity_map(image(), 3, valid=np.zeros((6, 6), bool)), "has 0 of 9"),
        (lambda: diversity_map(image(), 3, valid=np.ones((2, 2), bool)), r"shape \(6, 6\)"),
        (lambda: diversity_map(image(), 3, least_share=0.0), "above 0 and at most 1"),
        (lambda: spectral_species(pixels(), clusters=2), r"\[..., pixel, band\]"),
        (lambda: spectral_species(spots(), clusters=201), "from 2 to the 200 pixels"),
        (lambda: spectral_species(spots(), np.zeros((2, 100), bool)), "one has none"),
        (lambda: spectral_species(spots(), np.ones(100, bool)), r"shape \(2, 100\)"),
        (lambda: spectral_species(spots(), clusters=3, least_share=1.0), "below 1"),
        (lambda: spectral_species(spots()[:1], clusters=3), "two windows or more"),
        (
            lambda: spectral_species(spots(), clusters=3, components=2, least_share=0.9),
            "no cluster has 0.9 of the pixels of window 1",
        ),
    ],
)
def test_wrong_spectra_are_refused(call, words: str) -> None:
    with pytest.raises(InputError, match=words):
        call()

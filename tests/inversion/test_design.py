"""Designed bands against exhaustive search, closed forms and difference quotients."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import fynjax as fx
from fynjax._core.errors import InputError
from fynjax.diversity import bhattacharyya_distance, jeffries_matusita_distance
from fynjax.inversion import COARSE, coarser
from fynjax.inversion import _design as bands_of_design
from fynjax.inversion._bands import BandStatistics, PlantingSpectra, _photons, gaussian_weights
from fynjax.inversion._design import _Limits
from fynjax.inversion._information import fisher_information
from fynjax.leaf import LeafParameters, prospect
from fynjax.scene import ModelError, aim
from fynjax.sensors import BandSet, Gains, shipped_sensor
from tests.scene.plots import small_parameters

GRID = np.arange(405.0, 2496.0, 10.0)
LIMITS = _Limits(405.0, 2495.0, 10.0, 100.0)
PRIOR_SD = {"chlorophyll": 15.0, "water": 0.005}
# What a model is off by: of wavelengths that err together, the nearer the more.
AT = np.linspace(400.0, 2500.0, 43)
ALIKE = np.exp(-0.5 * ((AT - AT[:, None]) / 300.0) ** 2)
OFF = ModelError(AT, np.linspace(0.15, 0.08, 43), ALIKE)


@pytest.fixture(autouse=True)
def double():
    with jax.enable_x64(True):
        yield


def spectra_of_leaves(target="quantities", asked=((1.0, 0.0),), plantings=3, **changes):
    """Plots that are one leaf, whose chlorophyll and water are unknown; pixels differ by a few
    smooth spectra."""
    usual = {"chlorophyll": 40.0, "water": 0.015}

    def leaf(values):
        optics = prospect(LeafParameters.many(**dict(zip(usual, values))))
        return jnp.ravel(optics.reflectance)[5:2100:10]  # from 400 nm on, a nanometre each

    at = jnp.array([*usual.values()])
    slope = np.asarray(jax.jacfwd(leaf)(at)) * np.array([*PRIOR_SD.values()])
    random = np.random.default_rng(1)
    mean = np.asarray(leaf(at)) * (1.0 + 0.02 * random.normal(size=(plantings, 1)))
    basis = 0.02 * np.cos(np.pi * np.arange(4) * (GRID[:, None] - 400.0) / 2100.0)
    root = random.normal(size=(plantings, 4, 4))
    second = root @ root.swapaxes(1, 2)
    second_slope = np.stack([second, 0.2 * second], axis=-1)
    fields = {
        "grid": GRID,
        "mean": mean,
        "mean_slope": np.broadcast_to(slope, (plantings, *slope.shape)),
        "basis": basis,
        "second": second,
        "second_slope": second_slope,
        "photons": 1e3 * np.ones(len(GRID)),
        "asked": np.broadcast_to(np.array(asked), (plantings, len(asked), 2)),
        "species": np.full((plantings, 2), 20.0),
        "species_mean": np.stack([mean, 1.2 * mean], axis=1),
        "species_second": np.stack([second, 0.5 * second], axis=1),
        "pixels": 400.0,
        "model_error": np.zeros((len(GRID), len(GRID))),
        **changes,
    }
    return PlantingSpectra(
        **{k: jnp.asarray(v) for k, v in fields.items()}, relative_sd=0.01, target=target
    )


def every(spectra):
    return jnp.ones(len(spectra.mean))


NO_GAINS = Gains(0.0)


def scores(spectra, centre, width, gains=NO_GAINS):
    centre, width = (jnp.asarray(one, float) for one in (centre, width))
    weights = gaussian_weights(spectra.grid, centre, width)
    seen = bands_of_design._seen(spectra, weights, width, gains)
    return np.asarray(bands_of_design._scores_of(spectra, seen, every(spectra)))


TARGETS = pytest.mark.parametrize("target", ["quantities", "information", "separability"])


def test_weights_are_those_of_a_band_set():
    bands = BandSet(("a", "b", "c"), (560.0, 1203.3, 2000.0), (10.0, 35.5, 100.0))
    found = gaussian_weights(jnp.asarray(GRID), jnp.array(bands.centre), jnp.array(bands.fwhm))
    np.testing.assert_allclose(found, bands.weights(GRID), atol=1e-12)


def test_bands_lie_within_the_range():
    """From the narrowest to the widest, their responses up to the ends of the range."""
    centre, width = LIMITS.bands(np.array([0.0, 1.0, 0.5, 0.0, 1.0, 0.5]))
    np.testing.assert_allclose(width, [10.0, 100.0, np.sqrt(1000.0)])
    np.testing.assert_allclose(centre, [419.0, 2355.0, 1450.0])
    BandSet(("a", "b", "c"), tuple(centre), tuple(width)).weights(GRID)  # no more than 1e-3 lost


@TARGETS
def test_the_gradient_in_centre_and_width_is_the_difference_quotient(target):
    spectra = spectra_of_leaves(target, model_error=OFF.covariance(GRID))
    x = np.array([0.2, 0.55, 0.3, 0.6])
    value, slope = bands_of_design._ascent(x, spectra, LIMITS, every(spectra))
    assert np.isfinite(value)
    for i in range(len(x)):
        step = 1e-5 * np.eye(len(x))[i]
        ends = [
            float(bands_of_design._ascent(x + s, spectra, LIMITS, every(spectra))[0])
            for s in (step, -step)
        ]
        assert float(slope[i]) == pytest.approx((ends[0] - ends[1]) / 2e-5, rel=1e-4, abs=1e-7)


def test_what_is_no_number_is_never_chosen():
    """Of one pixel, whose values have no covariance."""
    spectra = spectra_of_leaves(second=np.zeros((3, 4, 4)), second_slope=np.zeros((3, 4, 4, 2)))
    x = np.array([0.2, 0.55, 0.3, 0.6])
    assert float(bands_of_design._ascent(x, spectra, LIMITS, every(spectra))[0]) == np.inf


def test_the_ascent_finds_what_an_exhaustive_search_finds():
    """Two bands of 20 nm, every pair of centres 10 nm apart."""
    spectra = spectra_of_leaves(asked=((1.0, 0.0), (0.0, 1.0)))
    limits = _Limits(405.0, 2495.0, 20.0, 20.0)
    ends = bands_of_design._search(spectra, limits, 2, 4, 0, every(spectra))
    centre = np.arange(435.0, 2466.0, 10.0)
    width = jnp.full(len(centre), 20.0)
    weights = gaussian_weights(spectra.grid, jnp.asarray(centre), width)
    seen = bands_of_design._seen(spectra, weights, width)
    pairs = np.stack(np.triu_indices(len(centre), 1), axis=1)
    values = bands_of_design._values_of(spectra, seen, jnp.asarray(pairs), every(spectra))
    best = float(np.max(values))
    assert best * (1.0 - 1e-9) <= ends[0][0] <= best * 1.02
    chosen = np.sort(np.asarray(limits.bands(ends[0][1])[0]))
    np.testing.assert_allclose(chosen, centre[pairs[int(np.argmax(values))]], atol=10.0)
    # Channels of a sensor, by exchange.
    found = bands_of_design.best_channels(spectra, seen, 2, every(spectra))
    of_found = bands_of_design._values_of(spectra, seen, jnp.array([found]), every(spectra))
    assert float(of_found[0]) >= 0.999 * best


@pytest.mark.parametrize(
    ("asked", "low", "high"), [((0.0, 1.0), 1100.0, 2500.0), ((1.0, 0.0), 500.0, 760.0)]
)
def test_a_band_is_where_the_substance_absorbs(asked, low, high):
    """Water in the shortwave infrared, chlorophyll in the visible and the red edge."""
    spectra = spectra_of_leaves(asked=(asked,))
    _, x = bands_of_design._search(spectra, LIMITS, 1, 2, 0, every(spectra))[0]
    assert low < float(LIMITS.bands(x)[0][0]) < high


def smooth(random, *shape):
    """Random spectra with a standard deviation of about 1, which bend within 500 nm."""
    at = np.pi * np.arange(5) * (GRID[:, None] - 400.0) / 2100.0
    return random.normal(size=(*shape, 5)) @ np.cos(at).T / np.sqrt(3.0)


def of_chance(plantings, mean_slope=0.0, target="quantities", free=6, seed=0):
    """Plantings whose slopes by six parameters are drawn anew for each, about `mean_slope`, and
    whose means are drawn from the covariance of their pixels."""
    random = np.random.default_rng([plantings, seed])
    slope = 0.02 * np.moveaxis(smooth(random, plantings, free), 1, 2) + mean_slope
    root = random.normal(size=(4, 4))
    second = np.broadcast_to(root @ root.T, (plantings, 4, 4))
    change = random.normal(size=(plantings, 4, 4, free))
    asked = np.eye(free)[: None if target == "information" else 1]
    given = spectra_of_leaves(target, plantings=plantings, photons=np.full(len(GRID), 1e12))
    means = 0.2 + 0.3 * random.normal(size=(plantings, 4)) @ root.T @ np.asarray(given.basis).T
    fields = {
        "mean": means, "mean_slope": slope, "second": second,
        "second_slope": change + change.swapaxes(1, 2) if np.ndim(mean_slope) == 0 else 0 * change,
        "asked": np.broadcast_to(asked, (plantings, *asked.shape)),
    }  # fmt: skip
    return dataclasses.replace(given, **{name: jnp.asarray(one) for name, one in fields.items()})


@pytest.mark.parametrize("target", ["quantities", "information"])
def test_slopes_of_chance_are_no_knowledge_however_many_bands(target):
    """Nothing is said but for what leads astray, which is less the more plantings."""
    said = {}
    for plantings in (4, 64):
        spectra = of_chance(plantings, target=target)
        said[plantings] = [
            scores(spectra, np.linspace(500.0, 2400.0, n), np.full(n, 40.0)).mean() for n in (2, 13)
        ]
    most = 0.01 if target == "quantities" else 0.05
    assert np.max([*said.values()]) < most, said
    assert np.abs(said[64]).max() < 0.3 * np.abs(said[4]).max(), said
    assert said[64][-1] < said[64][0] + most, said


def test_what_is_removed_is_what_a_regression_explains():
    """Of many plots with parameters, plantings and errors of their own, by least squares; and with
    few plantings a little less."""
    random = np.random.default_rng(7)
    shared = 0.06 * smooth(random, 6).T
    centre, width = np.array([500.0, 800.0, 1200.0, 2200.0]), np.full(4, 40.0)
    weights = BandSet(tuple("abcd"), tuple(centre), tuple(width)).weights(GRID)
    many = of_chance(3000, shared)
    u = random.normal(size=(3000, 6))
    mean = np.asarray(many.mean) @ weights.T
    seen = mean + np.einsum("pk,pwk,bw->pb", u, many.mean_slope, weights)
    seen += 0.01 * mean.mean(axis=0) * random.normal(size=seen.shape)
    seen -= seen.mean(axis=0)
    left = u[:, 0] - seen @ np.linalg.lstsq(seen, u[:, 0], rcond=None)[0]
    explained = 1.0 - left.var() / u[:, 0].var()
    assert 0.15 < explained < 0.5
    found = scores(of_chance(200, shared), centre, width).mean()
    assert found == pytest.approx(explained, abs=0.03)
    few = np.mean([scores(of_chance(6, shared, seed=i), centre, width).mean() for i in range(8)])
    assert explained - 0.15 < few < explained + 0.01


def test_a_planting_is_judged_by_what_others_show():
    """Nothing of a planting itself is in the estimates that it is judged by: one that is left out
    has the same score, and where its slopes are the opposite they lead astray."""
    spectra = spectra_of_leaves(plantings=5)
    weights = gaussian_weights(spectra.grid, jnp.array([700.0]), jnp.array([20.0]))
    seen = bands_of_design._seen(spectra, weights, jnp.array([20.0]))
    whole = bands_of_design._scores_of(spectra, seen, every(spectra))
    left = bands_of_design._scores_of(spectra, seen, every(spectra).at[2].set(0.0))
    assert float(whole[2, 0]) == pytest.approx(float(left[2, 0]), rel=1e-12)
    assert float(whole[1, 0]) != pytest.approx(float(left[1, 0]), rel=1e-6)
    away = seen._replace(mean_slope=seen.mean_slope.at[2].mul(-1.0))
    assert float(bands_of_design._scores_of(spectra, away, every(spectra))[2, 0]) < 0.0


def alike(spectra):
    """All plantings as the first."""
    same = jax.tree.map(lambda a: jnp.broadcast_to(a[:1] if a.ndim else a, a.shape), spectra)
    kept = ("grid", "basis", "photons", "model_error")
    return dataclasses.replace(same, **{name: getattr(spectra, name) for name in kept})


@pytest.mark.parametrize("off", [None, OFF])
@pytest.mark.parametrize("gains", [Gains(0.0), Gains((0.05, 0.1), 0.4)])
def test_what_is_removed_is_that_of_the_fisher_information(off, gains):
    """Plantings alike: the errors are the sensor's and the model's alone, and those by hand."""
    asked = ((0.6, 0.8),)
    believed = np.zeros((len(GRID), len(GRID)))
    of_model = believed if off is None else off.covariance(GRID)
    spectra = spectra_of_leaves(asked=asked, model_error=of_model)
    spectra = alike(spectra)
    centre, width = np.array([560.0, 1650.0]), np.array([30.0, 60.0])
    weights = BandSet(("a", "b"), centre, width).weights(GRID)
    mean = weights @ np.asarray(spectra.mean[0])
    rows = weights @ np.asarray(spectra.basis)
    variance = np.einsum("bi,ij,bj->b", rows, spectra.second[0], rows)
    noise = mean**2 / (width * 1e3 * mean)
    sd = np.sqrt(variance + noise)
    slopes = np.concatenate(
        [
            weights @ np.asarray(spectra.mean_slope[0]),
            np.einsum("bi,ijk,bj->bk", rows, spectra.second_slope[0], rows) / (2 * sd[:, None]),
        ]
    )
    # Of the variance of n pixels of known values with noise: (4 v s^2 + 2 s^4) / n.
    of_sd = (4.0 * variance * noise + 2.0 * noise**2) / (4.0 * sd**2)
    values = np.concatenate([mean, sd])
    errors = np.diag((0.01 * values) ** 2 + np.concatenate([noise, of_sd]) / 400)
    # A statistic over its value is off by the band's factor, the mean of those of its wavelengths.
    share = weights * np.asarray(spectra.mean[0]) / mean[:, None]
    factors = share @ of_model @ share.T + gains.covariance(2)
    errors += np.outer(values, values) * np.kron(np.ones((2, 2)), factors)
    known = fisher_information(("a", "b"), slopes, errors, np.ones(2))
    after = np.linalg.inv(np.eye(2) + known.fisher)
    direction = np.array(asked[0])
    assert scores(spectra, centre, width, gains)[0, 0] == pytest.approx(
        1.0 - direction @ after @ direction, rel=1e-8
    )
    one_by_one = {"target": "information", "asked": jnp.broadcast_to(jnp.eye(2), (3, 2, 2))}
    gained = scores(dataclasses.replace(spectra, **one_by_one), centre, width, gains)[0, 0]
    assert gained == pytest.approx(-0.5 * np.log2(np.diag(after)).sum(), rel=1e-8)
    assert gained <= -0.5 * np.log2(np.linalg.det(after))


def test_bands_are_off_by_what_images_with_factors_are():
    """Of 4000 images whose wavelengths have factors drawn from the model's error, and whose bands
    have gains: covariance of the logarithms of means and standard deviations of their bands."""
    random = np.random.default_rng(11)
    gains = Gains((0.04, 0.05, 0.06), 0.5)
    spectra = alike(spectra_of_leaves(photons=np.ones(len(GRID)), model_error=OFF.covariance(GRID)))
    bands = BandSet(("a", "b", "c"), (550.0, 670.0, 1650.0), (40.0, 100.0, 60.0))
    weights = bands.weights(GRID)
    pixel = 1.0 + 0.1 * random.normal(size=(50, 1))  # all wavelengths of a pixel alike
    pixels = np.asarray(spectra.mean[0]) * pixel
    shares = np.stack([np.interp(GRID, AT, row) for row in np.eye(len(AT))], axis=1)
    draws = random.normal(size=(4000, len(AT))) @ np.linalg.cholesky(ALIKE + 1e-9 * np.eye(43)).T
    off = np.exp(0.2 * (draws * np.asarray(OFF.sd)) @ shares.T)
    sd = np.array(gains.sd)
    one = np.sqrt(0.5) * random.normal(size=(4000, 1)) + np.sqrt(0.5) * random.normal(
        size=(4000, 3)
    )
    seen = np.einsum("pw,dw,bw->dpb", pixels, off, weights) * np.exp(0.2 * sd * one)[:, None]
    logs = np.log(np.concatenate([seen.mean(axis=1), seen.std(axis=1)], axis=1))
    found = bands_of_design._seen(spectra, jnp.asarray(weights), jnp.asarray(bands.fwhm), gains)
    expected = np.kron(np.ones((2, 2)), found.factors)
    np.testing.assert_allclose(np.cov(logs.T) / 0.2**2, expected, atol=0.0015)
    assert expected.max() > 0.02


def test_what_only_the_level_tells_is_lost_in_the_factors():
    """A parameter that scales all, and one that scales wavelengths beyond 1000 nm, means and
    spreads alike: where these err together, their ratio still tells the second; where they err
    apart, or each band has a gain of its own, it does not."""
    level, beyond = np.asarray(spectra_of_leaves().mean[0]), GRID > 1000.0
    second = np.eye(2)
    changes = {
        "mean_slope": np.stack([0.1 * np.stack([level, level * beyond], axis=1)] * 3),
        "basis": 0.1 * np.stack([level * ~beyond, level * beyond], axis=1),
        "second": np.stack([second] * 3),
        "second_slope": np.stack([0.2 * np.stack([second, np.diag([0.0, 1.0])], axis=2)] * 3),
        "species_second": np.stack([[second, second]] * 3),
        "photons": np.full(len(GRID), 1e9),
        "asked": np.stack([np.eye(2)] * 3),
    }
    spectra = alike(dataclasses.replace(spectra_of_leaves(), **changes))
    together = ModelError([400.0, 2500.0], [0.3, 0.3], np.ones((2, 2)))
    apart = ModelError([900.0, 1100.0], [0.3, 0.3], np.eye(2))

    def told(error, gains=NO_GAINS):
        off = jnp.asarray(error.covariance(GRID))
        found = dataclasses.replace(spectra, model_error=off)
        return scores(found, [700.0, 1650.0], [40.0, 40.0], gains)[0]

    assert told(together.wider(0.0)).min() > 0.9
    common = told(together)
    assert common[0] < 0.2 < 0.9 < common[1]
    assert told(apart).max() < 0.2
    assert told(together, Gains(0.1, 0.0))[1] < 0.5


def test_the_share_left_is_that_of_the_definition():
    """The same numbers by NumPy's covariances, from the docstring's words."""
    spectra = spectra_of_leaves(plantings=5, photons=np.full(len(GRID), 1e12))
    random = np.random.default_rng(2)
    slope = 0.02 * np.moveaxis(smooth(random, 5, 2), 1, 2)
    spectra = dataclasses.replace(spectra, mean_slope=jnp.asarray(slope))
    bands = BandSet(("a", "b"), (560.0, 1650.0), (30.0, 60.0))
    weights = bands.weights(GRID)
    pixel = np.einsum("wi,pij,vj->pwv", spectra.basis, spectra.second, spectra.basis)
    rows = weights @ np.asarray(spectra.basis)
    seen = np.einsum("bw,pwv,cv->pbc", weights, pixel, weights)
    sd = np.sqrt(np.diagonal(seen, axis1=1, axis2=2))
    values = np.concatenate([spectra.mean @ weights.T, sd], axis=1)
    of_sd = np.einsum("bi,pijk,bj->pbk", rows, spectra.second_slope, rows) / (2.0 * sd[..., None])
    slopes = np.concatenate([weights @ slope, of_sd], axis=1)
    g = np.array([1.0, 0.0])
    found = scores(spectra, bands.centre, bands.fwhm)[:, 0]
    for out, score in enumerate(found):
        rest = [p for p in range(5) if p != out]
        mean, spread, whole = seen[rest].mean(axis=0), np.zeros((4, 4)), pixel[rest]
        every = np.diagonal(whole, axis1=1, axis2=2)
        total = every.mean(axis=0).sum()
        plot = np.asarray(spectra.mean)[rest]
        spread[:2, :2] = mean * np.var(plot, axis=0, ddof=1).sum() / total
        relative = np.var(np.sqrt(every), axis=0, ddof=1).sum() / total
        spread[2:, 2:] = relative * mean**2 / np.sqrt(np.outer(np.diag(mean), np.diag(mean)))
        centre = values[rest].mean(axis=0)
        error = np.diag((0.01 * centre) ** 2)
        total = 0.5 * np.cov(values[rest].T) + 0.5 * spread + error
        total += np.mean([slopes[p] @ slopes[p].T for p in rest], axis=0)
        estimate = np.linalg.solve(total, np.mean([slopes[p] @ g for p in rest], axis=0))
        # A parameter as large as its prior, another planting, another mean of four, and errors.
        left = np.sum((g - slopes[out].T @ estimate) ** 2)
        left += ((values[out] - centre) @ estimate) ** 2 / (1.0 + 1.0 / 4.0)
        assert score == pytest.approx(1.0 - left - estimate @ error @ estimate, abs=1e-6)


def test_photons_are_those_of_the_sun_and_none_in_the_water_windows():
    """As many as the signal-to-noise ratio asks for in the band that it is of."""
    light = small_parameters()
    bands = BandSet(tuple(map(str, GRID)), tuple(GRID), (10.0,) * len(GRID), response="box")
    photons = _photons(light, bands, 200.0)
    at = dict(zip(GRID, photons, strict=True))
    assert 10.0 * 0.1 * 0.5 * (at[545.0] + at[555.0]) == pytest.approx(200.0**2, rel=0.05)
    assert max(at[1375.0], at[1905.0]) < 1e-6 * at[555.0]
    # Planck's law of 5800 K, per photon, to what air takes of green light.
    planck = {nm: nm**-4.0 / np.expm1(1.4388e7 / (nm * 5800.0)) for nm in (555.0, 865.0, 1655.0)}
    for nm in (865.0, 1655.0):
        assert at[nm] / at[555.0] == pytest.approx(planck[nm] / planck[555.0], rel=0.4)


def species_apart(plantings, count, bands, apart):
    """Two species of `count` pixels in each planting: of one covariance, their means 2 `apart`
    standard deviations apart along one direction of the components."""
    random = np.random.default_rng(5)
    weight = random.normal(size=(plantings, 2, bands, count))
    weight[:, 1, 0] += 2.0 * apart
    basis = 0.02 * np.cos(np.pi * np.arange(bands) * (GRID[:, None] - 400.0) / 2100.0)
    return spectra_of_leaves(
        "separability", plantings=plantings, photons=np.full(len(GRID), 1e12), basis=basis,
        species=np.full((plantings, 2), float(count)),
        species_mean=0.2 + weight.mean(axis=3) @ basis.T,
        species_second=np.stack([[np.cov(one) for one in both] for both in weight]),
        second=np.broadcast_to(np.eye(bands), (plantings, bands, bands)),
        second_slope=np.zeros((plantings, bands, bands, 2)),
    )  # fmt: skip


@pytest.mark.parametrize("bands", [4, 10, 50])
def test_species_that_are_alike_are_not_separate_and_others_not_more_than_they_are(bands):
    """Twenty pixels of each species in each of six plantings, in 4 to 50 bands."""
    centre, width = np.linspace(450.0, 2450.0, bands), np.full(bands, 20.0)
    assert 0.0 <= scores(species_apart(6, 20, bands, 0.0), centre, width).mean() < 0.05
    expected = 2.0 - 2.0 * np.exp(-0.5)  # of means 2 standard deviations apart
    found = scores(species_apart(6, 20, bands, 1.0), centre, width).mean()
    assert expected - (0.15 if bands < 50 else 0.5) < found < expected + 0.1


def test_distances_are_those_of_the_pixels():
    """Of species with one covariance in plantings that are alike."""
    pixels = np.random.default_rng(5).normal(size=(50, 4)) @ np.diag([1.0, 2.0, 0.5, 1.0])
    off = np.array([1.0, 1.0, 0.2, 0.0])
    second, mean = np.cov(pixels.T), pixels.mean(axis=0)
    spectra = spectra_of_leaves(
        "separability",
        photons=np.full(len(GRID), 1e12),
        species_second=np.broadcast_to(second, (3, 2, 4, 4)),
    )
    means = np.stack([mean, mean + off]) @ np.asarray(spectra.basis).T + 0.2
    spectra = dataclasses.replace(
        spectra, species_mean=jnp.broadcast_to(jnp.asarray(means), (3, *means.shape))
    )
    centre, width = np.array([700.0, 1700.0]), np.array([20.0, 50.0])
    rows = BandSet(("a", "b"), centre, width).weights(GRID) @ np.asarray(spectra.basis)
    both = [one @ rows.T for one in (pixels, pixels + off)]
    distance = jeffries_matusita_distance(bhattacharyya_distance(*both, shrinkage=0.0))
    assert scores(spectra, centre, width)[0, 0] == pytest.approx(float(distance), rel=1e-6)


def test_shot_noise_falls_with_the_root_of_the_photons():
    """A band twice as wide collects twice as many; where there is no light nothing is known."""
    spectra = spectra_of_leaves()
    flat = dataclasses.replace(spectra, mean=jnp.full_like(spectra.mean, 0.2))
    width = jnp.array([20.0, 40.0])
    weights = gaussian_weights(spectra.grid, jnp.array([1000.0, 1000.0]), width)
    noise = np.asarray(bands_of_design._seen(flat, weights, width).noise)
    assert noise[0] == pytest.approx(0.2**2 / (20.0 * 1e3 * 0.2))
    assert noise[0] / noise[1] == pytest.approx(2.0)
    dark = dataclasses.replace(spectra, photons=jnp.full(len(GRID), 1e-12))
    assert scores(dark, [560.0], [30.0]).max() < 1e-3 < scores(spectra, [560.0], [30.0]).min()


# -- of a scene --------------------------------------------------------------------------------

COLUMNS = "taxon", "growth_form", "mean_diameter_cm", "cover_percent", "height_max_m"
TABLE = [
    dict(zip(COLUMNS, row, strict=True))
    for row in (("Erica", "rounded_shrub", 40, 30, 0.6), ("Restio", "tussock", 30, 15, 0.5))
]


@pytest.fixture(scope="module")
def scene():
    return fx.Scene.from_table(TABLE, size=2.0, voxel=0.25, structure="even", seed=1)


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"bands": 0}, "`bands` as a whole number from 1 to 210, but got 0"),
        ({"bands": 211}, "from 1 to 210, but got 211"),
        ({"target": "shanon"}, "got 'shanon'. Did you mean 'shannon'"),
        ({"target": "canopy_height"}, "no free parameter changes canopy_height in every planting"),
        ({"target": ["ground.*", "shannon"]}, "no free parameter changes shannon in every"),
        ({"target": "canopy*"}, "does not depend on any of the free"),
        ({"spectrum": (300.0, 900.0)}, "of 400 to 2500 nm, but got 300, 900"),
        ({"spectrum": (900.0, 500.0)}, "`spectrum` as two numbers in order"),
        ({"spectrum": (500.0, 600.0)}, "a band 100 nm wide does not fit"),
        ({"widths": (2.0, 50.0)}, "`widths` as two numbers.*of 10 to inf nm"),
        ({"plantings": 3}, "4 `plantings` or more"),
        ({"plantings": 4.5}, "`plantings` as a whole number"),
        ({"bands": 2.5}, "`bands` as a whole number"),
        ({"starts": 1.5}, "`starts` as a whole number of at least 1, but got 1.5"),
        ({"seed": -1}, "`seed` as a whole number"),
        ({"pixel": (0.5, 2.0)}, "at least two pixels on a plot of 2 x 2 m"),
        ({"snr": 0.0}, "`snr` must be a positive number"),
        ({"relative_sd": 0.0}, "`relative_sd` must be a positive number"),
        ({"pixel": 0.0}, "expected `pixel` as one or more positive numbers"),
        ({"pixel": (0.2, 0.3)}, "multiple of the smallest, 0.2 m, .*but got 0.3 m"),
        ({"compare": ["mavic"]}, "mavic"),
        ({"compare": [shipped_sensor("sentinel_2a").select([12])], "spectrum": (400.0, 900.0)},
         "no band from 405 to 895 nm"),
        ({"spectrum": (1350.0, 1450.0), "widths": (10.0, 20.0)}, "no light comes through the air"),
    ],
)  # fmt: skip
def test_what_does_not_fit_is_refused_in_a_line(scene, changes, text):
    free = fx.free(scene, "ground.brightness")
    with pytest.raises(InputError, match=text) as caught:
        fx.design(scene, **{"free": free, **changes})
    assert "\n" not in str(caught.value)


def test_known_plants_have_no_other_planting(scene):
    known = eqx.tree_at(lambda s: s.planting.place, scene, jnp.zeros_like(scene.planting.place))
    with pytest.raises(InputError, match="its plants are known"):
        fx.design(known, free=fx.free(scene, "ground.brightness"))


def test_the_interval_counts_that_designs_share_plantings():
    """By hand: Student's 90 % of 4 degrees of freedom, and 1/5 + 1/4 of the variance. Over 300
    draws of five or eight plantings of `of_chance` it held 97 % of the expected gains; with the
    plantings as if they were independent 88 and 93 %."""
    gain = np.array([0.0, 1.0, 2.0, 3.0, 4.0])[:, None]
    expected = 2.13185 * np.sqrt(2.5) * np.sqrt(0.45)
    assert bands_of_design.half_interval(gain)[0] == pytest.approx(expected, rel=1e-5)


@pytest.mark.slow
def test_a_design_of_a_scene(scene):
    """Means and spreads are those of the image in the camera's own bands, to what the spectrum
    bends within 10 nm and the light within a band; the record holds what was found."""
    free = fx.free(scene, "species.*.cover", "ground.brightness")
    rendered = []
    real = bands_of_design.render_plantings

    def kept(*arguments):
        rendered.append(real(*arguments))
        return rendered[0]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(bands_of_design, "render_plantings", kept)
        found = fx.design(
            scene, 2, ("shannon", "species.*.cover"), free=free, pixel=(0.25, 0.5), plantings=4,
            starts=2, spectrum=(400.0, 1000.0), compare=("mavic_3m",),
        )  # fmt: skip
    camera = shipped_sensor("mavic_3m")
    seen: BandStatistics = bands_of_design._bands_of(rendered[0][0], camera)
    coarse = coarser(scene, scene.parameters)

    def observed(u, stand=coarse):
        values = free.named(jnp.array([0.0, 0.0, u]))
        return np.asarray(
            fx.observe(
                stand, camera, pixel=0.25, point_spread=False, accuracy=COARSE,
                parameters=scene.with_values(values).parameters,
            ).reflectance
        )  # fmt: skip

    image = observed(0.0)
    # Slopes beside those by covers are of the stand in expectation.
    darker, brighter = (observed(u, coarse.expected()) for u in (-0.1, 0.1))
    bright = (brighter - darker) / 0.2
    slope = np.mean(bright, axis=(1, 2))
    np.testing.assert_allclose(seen.mean_slope[0][:, 2], slope, rtol=0.04)
    off = image - image.mean(axis=(1, 2), keepdims=True)
    change = 2.0 * np.mean(off * bright, axis=(1, 2))
    np.testing.assert_allclose(seen.variance_slope[0][:, 2], change, rtol=0.08)
    np.testing.assert_allclose(seen.mean[0], image.mean(axis=(1, 2)), rtol=0.03)
    sd = np.sqrt(np.diagonal(seen.covariance[0]))
    np.testing.assert_allclose(sd, image.std(axis=(1, 2)), rtol=0.03)
    # Pixels twice as wide are means of these, and collect four times the light.
    wide: BandStatistics = bands_of_design._bands_of(rendered[0][1], camera)
    of_image, of_off, of_slope = (
        one.reshape(4, 4, 2, 4, 2).mean(axis=(2, 4)) for one in (image, off, bright)
    )
    sd = np.sqrt(np.diagonal(wide.covariance[0]))
    np.testing.assert_allclose(sd, of_image.std(axis=(1, 2)), rtol=0.03)
    change = 2.0 * np.mean(of_off * of_slope, axis=(1, 2))
    np.testing.assert_allclose(wide.variance_slope[0][:, 2], change, rtol=0.1)
    np.testing.assert_allclose(wide.mean, seen.mean, rtol=1e-6)
    np.testing.assert_allclose(wide.noise, seen.noise / 4.0, rtol=1e-6)
    assert (float(rendered[0][0].pixels), float(rendered[0][1].pixels)) == (64.0, 16.0)
    assert found.pixels["pixel_m"].tolist() == [0.25, 0.5]
    assert found.pixels["value"].max() == pytest.approx(found.table["value"][0], rel=1e-6)
    assert found.pixel == found.pixels["pixel_m"][found.pixels["value"].idxmax()]
    assert list(found.table["sensor"]) == ["designed", "mavic_3m", "best 2 of aviris_ng"]
    assert list(found.quantities.columns) == [
        "shannon", "species.Erica.cover", "species.Restio.cover"
    ]  # fmt: skip
    assert found.quantities.iloc[0].mean() == pytest.approx(found.table["value"][0], rel=1e-9)
    assert found.starts[0] == pytest.approx(found.table["value"][0], rel=1e-6)
    assert found.table["value"][0] >= 0.99 * found.table["value"][2]
    gain = found.table["gain_q95"] - found.table["gain"]
    assert (gain[1:] > 0.0).all()
    assert (found.table["gain_q05"][1:] <= found.table["gain_q95"][1:]).all()
    assert found.table["gain"][0] == 0.0
    assert (np.diff(found.bands.centre) > 0).all()
    assert str(found).count("\n") == 2
    assert "the design has" in found._repr_html_()
    data = found.spectra
    assert data["response"].dims == ("band", "wavelength")
    assert data["slope"].shape == (3, data.sizes["wavelength"])
    assert aim(scene, scene.parameters, found.sensor).sensor.bands == found.bands

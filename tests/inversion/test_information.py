"""Bounds against closed forms, and sensors whose order is known beforehand."""

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest

from fynjax._core.errors import InputError
from fynjax.inversion import BandFactors, ParameterSpace, even_bands, free_space, sweep_sensors
from fynjax.inversion._fit_result import scatter_covariance
from fynjax.inversion._information import fisher_information, shared_slopes
from fynjax.inversion._sensor_sweep import _measure, _Sweep, image_and_slopes
from fynjax.scene import ModelError, Placement, truth_of_pixels
from fynjax.sensors import Gains, shipped_sensor
from tests.inversion.linear import DATA, MATRIX, SPACE, posterior
from tests.scene.plots import drone, reflectance, small_parameters, small_plot

SLOPES, VARIANCE = np.asarray(MATRIX), np.asarray(DATA.sd) ** 2
PRIOR_SD = np.asarray(SPACE.prior_sd)


def information(**changes):
    return fisher_information(
        **{
            "names": SPACE.names, "jacobian": SLOPES, "covariance": VARIANCE,
            "prior_sd": PRIOR_SD, **changes,
        }
    )  # fmt: skip


def test_bounds_with_priors_are_the_sd_of_the_normal_posterior():
    found = information()
    _, covariance = posterior()
    np.testing.assert_allclose(found.bayesian, np.sqrt(np.diag(covariance)), rtol=1e-10)
    np.testing.assert_allclose(found.constrained, 1 - np.diag(covariance) / PRIOR_SD**2, atol=1e-12)


def test_bounds_without_priors_are_those_of_least_squares():
    """The third parameter changes nothing: no bound of it, and it does not harm the others."""
    found = information()
    two = np.linalg.inv(SLOPES[:, :2].T @ (SLOPES[:, :2] / VARIANCE[:, None]))
    np.testing.assert_allclose(found.joint[:2], np.sqrt(np.diag(two)), rtol=1e-10)
    np.testing.assert_allclose(
        found.conditional[:2],
        1 / np.sqrt((SLOPES[:, :2] ** 2 / VARIANCE[:, None]).sum(0)),
        rtol=1e-10,
    )
    assert np.isinf([found.joint[2], found.bound[2], found.conditional[2]]).all()
    assert found.bayesian[2] == pytest.approx(PRIOR_SD[2])
    assert np.all(found.conditional[:2] <= found.bound[:2])
    assert np.all(found.bound[:2] <= found.joint[:2] * (1 + 1e-12))
    (direction,) = found.weakly_constrained_directions()
    assert abs(direction["c.cover"]) == pytest.approx(1.0)


def test_what_the_data_add_and_the_prior_make_the_posterior():
    """Precisions add, parameter by parameter."""
    found = information()
    together = 1 / found.bound**2 + 1 / PRIOR_SD**2
    np.testing.assert_allclose(1 / found.bayesian**2, together, rtol=1e-9)


def test_a_sum_is_seen_and_its_difference_is_not():
    found = fisher_information(("a", "b"), np.array([[1.0, 1.0]]), np.ones(1) * 1e-4, np.ones(2))
    assert np.isinf(found.joint).all()
    assert np.isfinite(found.bound).all()
    np.testing.assert_allclose(found.bayesian, np.sqrt(0.5), rtol=1e-3)
    (direction,) = found.weakly_constrained_directions()
    assert direction["a"] == pytest.approx(-direction["b"])


def test_correlated_errors_count_as_they_are():
    """A difference of two readings whose common error cancels."""
    common = np.full((2, 2), 100.0) + np.eye(2) * 0.01
    found = fisher_information(("a",), np.array([[1.0], [-1.0]]), common, np.ones(1))
    assert found.joint[0] == pytest.approx(0.1 / np.sqrt(2), rel=1e-6)


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"jacobian": SLOPES[:, :2]}, "3 parameters are named"),
        ({"covariance": VARIANCE[:2]}, "4 observations"),
        ({"covariance": -VARIANCE}, "positive definite"),
        ({"covariance": np.ones((4, 4))}, "positive definite"),
    ],
)
def test_wrong_shapes_and_errors_are_refused(changes, text):
    with pytest.raises(InputError, match=text):
        information(**changes)


# -- few plantings --------------------------------------------------------------------------


FREE, BLOCKS = 4, [np.arange(3), np.arange(3, 9), np.arange(9, 21)]
NAMES = tuple("abcd")
ERROR = 0.1 * np.eye(21)


def of_blocks(count, slopes, covariance):
    rows = slice(0, BLOCKS[count - 1][-1] + 1)
    return fisher_information(NAMES, slopes[rows], covariance[rows, rows], np.ones(FREE)).bound


@pytest.fixture(scope="module")
def known_truth():
    """Of 50 draws each: bounds from few plantings over those of known slopes and covariance, with
    one, two and three blocks of statistics, of which the third tells nothing."""
    random = np.random.default_rng(0)
    factors = random.normal(size=(21, 4))
    root = np.linalg.cholesky(factors @ factors.T + np.eye(21))
    slopes = random.normal(size=(21, FREE)) * np.repeat([2.0, 1.0, 0.0], [3, 6, 12])[:, None]
    total = root @ root.T + ERROR
    # What the first two blocks tell of the third, so that it adds nothing.
    slopes[9:] = total[9:, :9] @ np.linalg.solve(total[:9, :9], slopes[:9])
    truth = [of_blocks(k, slopes, total) for k in (1, 2, 3)]
    np.testing.assert_allclose(truth[2], truth[1])
    ratios = {}
    for plantings in (5, 9, 17, 33):
        found = []
        for _ in range(50):
            values = random.normal(size=(plantings, 21)) @ root.T
            chance = 0.4 * root @ random.normal(size=(plantings, 21, FREE))
            covariance = scatter_covariance(values) + ERROR
            shared = shared_slopes(slopes + chance, covariance, BLOCKS)
            found.append([of_blocks(k, shared, covariance) for k in (1, 2, 3)])
        ratios[plantings] = np.array(found) / truth
    return ratios


def test_bounds_from_few_plantings_are_near_those_of_known_slopes(known_truth):
    """Rather above than below, the less so the more plantings; and chance alone is no knowledge."""
    middle = {p: np.median(r, axis=(0, 2)) for p, r in known_truth.items()}
    for plantings, most in ((5, 2.5), (9, 1.7), (17, 1.35), (33, 1.2)):
        ratio = middle[plantings]
        assert np.all((ratio > 0.95) & (ratio < most)), (plantings, ratio)
    low = np.quantile(known_truth[17], 0.1, axis=(0, 2))
    assert np.all(low > 0.75), low


def test_slopes_without_chance_stay_as_they_are():
    slopes = np.random.default_rng(0).normal(size=(21, FREE))
    same = shared_slopes(np.repeat(slopes[None], 5, axis=0), np.eye(21), BLOCKS)
    np.testing.assert_allclose(same, slopes, rtol=1e-6)


def test_slopes_that_are_all_chance_are_none():
    random = np.random.default_rng(0)
    norms = [
        np.linalg.norm(shared_slopes(random.normal(size=(9, 21, FREE)), np.eye(21), BLOCKS))
        for _ in range(50)
    ]
    assert np.mean(np.square(norms)) < 0.25 * 21 * FREE / 9  # of the mean's square


def test_a_covariance_of_few_plantings_goes_towards_its_target():
    """Two pairs of equal statistics: what few draws show amiss is made good by such a target."""
    random = np.random.default_rng(0)
    target = np.kron(np.eye(2), np.full((2, 2), 0.9) + 0.1 * np.eye(2))
    root = np.linalg.cholesky(target)
    few = [random.normal(size=(4, 4)) @ root.T for _ in range(100)]
    off = [[np.linalg.norm(scatter_covariance(d, t) - target) for d in few] for t in (None, target)]
    assert np.mean(off[1]) < 0.8 * np.mean(off[0])
    many = scatter_covariance(random.normal(size=(20000, 4)) @ root.T, target)
    np.testing.assert_allclose(many, target, atol=0.05)


def images(random, plantings, slopes_of_chance):
    """Images with bright patches of every size, and slopes most of which is chance."""
    made = []
    for _ in range(plantings):
        patches = [
            np.kron(random.normal(size=(4, 20 // side, 20 // side)), np.ones((side, side)))
            for side in (1, 2, 4, 10)
        ]
        image = 0.1 * np.exp(0.2 * sum(patches))
        own = random.normal(size=(4, 20, 20, 5)) * slopes_of_chance
        made.append((image, image[..., None] * (own + np.linspace(-0.2, 0.2, 5))))
    return made


KINDS = "conditional", "bound", "joint", "bayesian"
FIVE = ParameterSpace(
    "abcde", [-np.inf] * 5, [np.inf] * 5, [0.0] * 5, [1.0, 1.0, 0.1, 2.0, 5.0],
    distribution="normal",
)  # fmt: skip
FOUR = even_bands(4, 450.0, 900.0)
ALIKE = np.array([[1.0, 0.7, 0.2, 0.0], [0.7, 1.0, 0.6, 0.4], [0.2, 0.6, 1.0, 0.9],
                  [0.0, 0.4, 0.9, 1.0]])  # fmt: skip
OFF = ModelError(FOUR.centre, [0.12, 0.13, 0.15, 0.1], ALIKE)
CERTAIN = Gains(0.0)


def factors_of(gains=CERTAIN, off=None):
    return BandFactors.of_bands([(FOUR, gains)], off)


def of_factors(factors, steps=(1, 4), bands=(1, 2, 4), seed=0):
    """Statistics of one image, and their covariance by factors of its four bands."""
    image, slopes = images(np.random.default_rng(seed), 1, 0.3)[0]
    one = _measure(image, slopes, steps, bands, [1e-9], 2, 0)[1e-9]
    blocks = one.blocks
    sweep, sure = (_Sweep.of([one, one], FIVE, 0.01, f) for f in (factors, factors_of()))
    np.testing.assert_array_equal(sweep.slopes, sure.slopes)
    values = np.concatenate([block.values for block in blocks])
    return image, values, sweep.covariance - sure.covariance, sweep


def by_numpy(image, steps, bands):
    """Statistics in the order of `_measure`, by NumPy alone."""
    found = []
    for count in bands:
        wide = image.reshape(count, -1, *image.shape[1:]).mean(axis=1)
        found.append(wide.mean(axis=(1, 2)))
    for step in sorted(steps, reverse=True):
        side = image.shape[1] // step
        for count in bands:
            wide = image.reshape(count, -1, side, step, side, step).mean(axis=(1, 3, 5))
            flat = wide.reshape(count, -1)
            kinds = [flat.std(axis=1), *np.quantile(flat, [0.1, 0.5, 0.9], axis=1)]
            found.append(np.stack(kinds, axis=1).ravel())
    return np.concatenate(found)


@pytest.mark.parametrize("off", [None, OFF])
@pytest.mark.parametrize("gains", [CERTAIN, Gains(0.1, 1.0)])
def test_factors_of_bands_do_to_statistics_what_they_do_to_images(gains, off):
    """Sample covariance of the statistics of 500 images with factors of their own: means, spreads
    and quantiles of all pixels and numbers of bands. Of gains here those that all bands share."""
    steps, bands = (1, 4), (1, 2, 4)
    image, values, covariance, sweep = of_factors(factors_of(gains, off))
    np.testing.assert_allclose(by_numpy(image, steps, bands), values, rtol=1e-6)
    sd = np.zeros(4) if off is None else np.asarray(off.sd)
    root = np.hstack([np.linalg.cholesky(ALIKE) * sd[:, None], np.full((4, 1), gains.sd)])
    unit = np.random.default_rng(1).normal(size=(500, 5))
    # Of covariance one without chance, and small: what is of first order is all there is.
    unit = np.linalg.solve(np.linalg.cholesky(np.cov(unit.T)), (unit - unit.mean(axis=0)).T).T
    logs = unit @ root.T
    seen = [by_numpy(image * np.exp(0.05 * log)[:, None, None], steps, bands) for log in logs]
    expected = 0.05**-2 * np.cov(np.transpose(seen)) / np.outer(values, values)
    relative = covariance / np.outer(values, values)
    np.testing.assert_allclose(relative, expected, atol=0.002)
    # Slopes of quantiles are means over a window; of means and spreads they are to the digit.
    rows = [at if step == 0 else at[::4] for (step, _), at in zip(sweep.keys, sweep.rows)]
    exact = np.ix_(*2 * [np.concatenate(rows)])
    np.testing.assert_allclose(relative[exact], expected[exact], atol=6e-5)


def test_gains_of_wide_bands_are_as_uncertain_as_those_of_narrow_ones():
    """Of a camera with few bands each has a gain of its own, and half the variance is common; and
    what few bands tell of parameters, many bands have no second, independent look at."""
    gains = Gains(0.1, 0.5)
    _, values, covariance, sweep = of_factors(factors_of(gains))
    relative = covariance / np.outer(values, values)
    for (_, count), at in zip(sweep.keys, sweep.rows, strict=True):
        kinds = len(at) // count
        expected = np.kron(gains.covariance(count), np.ones((kinds, kinds)))
        np.testing.assert_allclose(relative[np.ix_(at, at)], expected, atol=2e-3)
    # Wide bands given the narrow ones, of means: what is left has nothing to do with these.
    one, two, four = (sweep.rows[i] for i in range(3))
    for wide in (one, two):
        weight = relative[np.ix_(wide, four)] @ np.linalg.inv(relative[np.ix_(four, four)])
        np.testing.assert_allclose(weight.sum(axis=1), 1.0, rtol=1e-6)
    through = np.linalg.inv(relative[np.ix_(two, two)])
    between = relative[np.ix_(one, two)] @ through @ relative[np.ix_(two, four)]
    np.testing.assert_allclose(relative[np.ix_(one, four)], between, atol=1e-9)


@pytest.mark.parametrize("plantings", [3, 5, 16])
@pytest.mark.parametrize("chance", [0.3, 3.0])
@pytest.mark.parametrize("seed", range(3))
def test_smaller_pixels_and_more_bands_never_know_less(plantings, chance, seed):
    """Whatever chance does to slopes and scatter: bounds of all kinds, of each parameter."""
    random = np.random.default_rng(seed)
    steps, bands = [1, 2, 10, 20], [1, 2, 4]
    measured = [
        _measure(image, slopes, steps, bands, [0.01, 0.5], 4, seed)
        for image, slopes in images(random, plantings, chance)
    ]
    for noise in (0.01, 0.5):
        found = []
        for factors in (factors_of(), factors_of(Gains(0.05, 0.5)), factors_of(off=OFF)):
            sweep = _Sweep.of([one[noise] for one in measured], FIVE, 0.01, factors)
            found.append({(s, n): sweep.bounds(s, n)[1] for s in steps for n in bands})
            never_less(found[-1])
        for known, *others in zip(*(one.values() for one in found), strict=True):
            for kind in KINDS:  # and with factors never more
                sure = getattr(known, kind) * (1.0 - 1e-6)
                assert all(np.all(getattr(one, kind) >= sure) for one in others), kind


def never_less(found):
    """Of bounds by pixel and number of bands."""
    for (size, count), fine in found.items():
        for (larger, fewer), coarse in found.items():
            if larger >= size and count % fewer == 0:
                for kind in KINDS:
                    limit = getattr(coarse, kind) * (1 + 1e-6)
                    assert np.all(getattr(fine, kind) <= limit), (kind, size, count, larger, fewer)


# -- sensors --------------------------------------------------------------------------------


SENSOR = dataclasses.replace(shipped_sensor("mavic_3m"), bands=even_bands(4, 450.0, 900.0))


def test_images_beside_slopes_show_the_whole_plants_whose_truth_is_taken():
    """The scatter of such images between plantings is that of measured plots, and the species that
    lead in their pixels are those in sight, in sweeps of sensors and in designs of bands; slopes
    by cover are of the stand in expectation, which has other plants."""
    plot, parameters = small_plot(extent=(0.8, 0.8)), small_parameters()
    camera, cover = drone(plot, pixel=0.2), parameters.species.cover
    names = tuple(f"species.{taxon}.cover" for taxon in plot.taxa)
    image, slopes = image_and_slopes(camera, plot, parameters, names, cover)
    seen = [reflectance(camera, stand, parameters) for stand in (plot, plot.expected())]
    np.testing.assert_allclose(image, seen[0], rtol=1e-6)
    assert np.abs(seen[1] / seen[0] - 1.0).max() > 0.01
    numbers = plot.counts(parameters), plot.whole_counts(parameters)
    stands = [dataclasses.replace(plot, number=number) for number in numbers]
    shares = [truth_of_pixels(camera, stand, parameters).species for stand in stands]
    np.testing.assert_allclose(*shares, rtol=1e-6, atol=1e-9)
    assert slopes.shape == (*image.shape, len(names))


@pytest.fixture(scope="module")
def swept():
    """A tiny plot under sensors of several pixels, bands and noises."""
    model = small_plot(dtype="float32")
    parameters = small_parameters()
    space = free_space(
        model, parameters, ["species.*.cover", "ground.brightness", "light.sun_zenith"],
        lambda _: 0.3,
    )  # fmt: skip
    space = ParameterSpace(
        space.names,
        space.lower,
        space.upper.at[space.names.index("light.sun_zenith")].set(60.0),
        space.prior,
        space.prior_sd,
        distribution=space.distribution,
    )
    options = {
        "gsd": [0.1, 0.8, 1.6],
        "bands": [1, 4],
        "noise": [0.01, 0.3],
        "stand_realisations": 2,
    }
    found = sweep_sensors(model, parameters, space, SENSOR, Placement(50.0), **options)
    return model, parameters, space, found, options


@pytest.mark.study
def test_every_sensor_has_bounds_in_their_order(swept):
    _, _, space, found, _ = swept
    assert len(found) == 12
    assert [s.pixels for s, _ in found[::4]] == [256, 4, 1]
    for _, one in found:
        assert np.all(one.conditional <= one.bound * (1 + 1e-6))
        assert np.all(one.bayesian <= one.prior_sd * (1 + 1e-9))
    np.testing.assert_allclose(found[0][1].prior_sd, space.prior_sd, rtol=1e-6)
    for noise in (0.01, 0.3):
        never_less({(s.gsd, s.bands): one for s, one in found if s.noise == noise})


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 1])
def test_the_default_of_a_small_plot_has_bounds_in_order(seed):
    """And every cover has one in the finest pixels with all bands."""
    model, parameters = small_plot(dtype="float32"), small_parameters()
    space = free_space(model, parameters, ["species.*.cover", "ground.brightness"], lambda _: 0.3)
    model = model.reordered(100 * seed)
    found = sweep_sensors(
        model, parameters, space, SENSOR, Placement(50.0), gsd=[0.1, 0.2, 1.6], bands=[1, 2, 4],
        seed=seed,
    )  # fmt: skip
    never_less({(s.gsd, s.bands): one for s, one in found})
    assert np.isfinite(found[2][1].bound).all()


@pytest.mark.study
def test_bounds_of_the_default_are_near_those_of_many_plantings():
    model, parameters = small_plot(dtype="float32"), small_parameters()
    space = free_space(model, parameters, ["species.*.cover", "ground.brightness"], lambda _: 0.3)
    few, many = (
        sweep_sensors(
            model, parameters, space, SENSOR, Placement(50.0), gsd=[0.1, 0.2, 1.6], bands=[1, 2, 4],
            **more,
        )
        for more in ({}, {"stand_realisations": 255})
    )  # fmt: skip
    ratio = np.array([a.bound / b.bound for (_, a), (_, b) in zip(few, many)])
    assert 0.8 < np.median(ratio) < 1.4
    assert np.all((ratio > 0.15) & (ratio < 3.0))  # of a species of six plants 0.2 to 0.9


@pytest.mark.study
def test_an_image_of_one_pixel_in_one_band_sees_one_direction(swept):
    _, _, _, found, _ = swept
    last = next(i for s, i in found if s.gsd == 1.6 and s.bands == 1 and s.noise == 0.01)
    assert (last.information > 1e-6 * last.information[0]).sum() == 1
    assert len(last.weakly_constrained_directions(1e-6)) == len(last.names) - 1


@pytest.mark.study
def test_the_ground_is_seen_in_most_bands_and_noise_blurs_it(swept):
    _, _, space, found, _ = swept
    ground = space.names.index("ground.brightness")
    bound = {(s.gsd, s.bands, s.noise): one.conditional[ground] for s, one in found}
    assert np.isfinite(bound[0.1, 4, 0.01])
    assert bound[0.1, 4, 0.01] <= bound[0.1, 4, 0.3] * (1 + 1e-6)
    assert bound[1.6, 1, 0.01] < bound[1.6, 1, 0.3]


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"gsd": [0.1, 0.25]}, "multiples of the finest"),
        ({"gsd": [3.2]}, "larger than the plot"),
        ({"bands": [3]}, "must divide 4"),
        ({"stand_realisations": 1}, "at least 2"),
        ({"noise": []}, "must be given"),
    ],
)
def test_sensors_that_do_not_fit_are_refused(changes, text):
    model = small_plot()
    parameters = small_parameters()
    space = free_space(model, parameters, ["species.*.cover"], lambda _: 0.3)
    with pytest.raises(InputError, match=text):
        sweep_sensors(model, parameters, space, SENSOR, **{"gsd": [0.1], "bands": [4], **changes})


def test_even_bands_share_their_range():
    bands = even_bands(4, 450.0, 850.0)
    np.testing.assert_allclose(bands.centre, [500, 600, 700, 800])
    grid = np.arange(400.0, 901.0)
    np.testing.assert_allclose(
        bands.average(grid, jnp.asarray(grid)), [500, 600, 700, 800], atol=0.6
    )
    with pytest.raises(InputError, match="between 400 and 2500"):
        even_bands(4, 300.0, 900.0)

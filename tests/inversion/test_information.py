"""Bounds against closed forms, and sensors whose order is known beforehand."""

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest

from fynjax._core.errors import InputError
from fynjax.inversion import (
    ParameterSpace,
    even_bands,
    fisher_information,
    free_space,
    sweep_sensors,
)
from fynjax.scene import Placement
from fynjax.sensors import shipped_sensor
from tests.inversion.linear import DATA, MATRIX, SPACE, posterior
from tests.scene.plots import small_parameters, small_plot

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


# -- sensors --------------------------------------------------------------------------------


SENSOR = dataclasses.replace(shipped_sensor("mavic_3m"), bands=even_bands(4, 450.0, 900.0))


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

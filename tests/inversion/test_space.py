"""Parameter spaces: the transform, its inverse and its slope; priors and bounds."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from fynjax._core.errors import InputError
from fynjax.inversion import PLAUSIBLE, ParameterSpace, make_space, match_names
from fynjax.scene import parameter_units


@pytest.fixture
def space():
    return make_space(
        {"species.Erica.cover": 0.2, "ground.moisture": 0.5, "species.Erica.leaf.water": 0.02},
        {"species.Erica.cover": 0.25, "ground.moisture": 0.5, "species.Erica.leaf.water": 0.3},
    )


def test_the_prior_is_the_origin_and_its_width_the_unit(space):
    np.testing.assert_allclose(space.physical(jnp.zeros(3)), [0.2, 0.5, 0.02], rtol=1e-12)
    np.testing.assert_allclose(space.slope(jnp.zeros(3)), [0.05, 0.25, 0.006], rtol=1e-9)


def test_the_transform_inverts_and_stays_inside_its_bounds(space):
    u = jnp.array([-1.3, 0.4, 2.2])
    np.testing.assert_allclose(space.whitened(space.physical(u)), u, rtol=1e-9)
    far = np.asarray(space.physical(jnp.array([-30.0, 30.0, 30.0])))
    assert np.all((far >= np.asarray(space.lower)) & (far <= np.asarray(space.upper)))


def test_slope_is_the_derivative(space):
    u = jnp.array([-1.3, 0.4, 2.2])
    jacobian = jax.jacfwd(space.physical)(u)
    np.testing.assert_allclose(jnp.diagonal(jacobian), space.slope(u), rtol=1e-12)


def test_every_parameter_but_the_azimuth_can_be_free():
    assert set(parameter_units()) - set(PLAUSIBLE) == {"sun_azimuth"}


def test_a_zero_centre_gets_a_width():
    space = make_space({"ground.moisture": 0.0}, {"ground.moisture": 0.3})
    assert 0.0 < float(space.prior[0]) < 0.05
    assert float(space.prior_sd[0]) == pytest.approx(0.1)


@pytest.mark.parametrize(
    ("prior", "sd", "text"), [(2.0, 0.1, "inside its bounds"), (0.5, 0.0, "positive width")]
)
def test_impossible_priors_are_refused(prior, sd, text):
    with pytest.raises(InputError, match=text):
        ParameterSpace(("a.cover",), jnp.zeros(1), jnp.ones(1), jnp.array([prior]), jnp.array([sd]))


def test_unknown_kinds_and_patterns_are_refused():
    with pytest.raises(InputError, match="cannot be free"):
        make_space({"light.sun_azimuth": 10.0}, {"light.sun_azimuth": 0.1})
    with pytest.raises(InputError, match=r"no parameter is called 'species.Eirca"):
        match_names(["species.Erica.cover"], ["species.Eirca.*"])
    names = ["species.Erica.cover", "ground.moisture"]
    assert match_names(names, ["*.cover"]) == ["species.Erica.cover"]

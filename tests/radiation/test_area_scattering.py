"""The area scattering function: closed form, brute force, normalisation, reciprocity."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from fynjax.canopy import EllipsoidalLeafAngle, TabulatedLeafAngle, leaf_angle
from fynjax.radiation._phase import area_scattering
from tests.helpers import assert_gradients
from tests.radiation.scenes import spherical_gamma, towards

ANGLES = {
    **{
        name: leaf_angle(name)
        for name in (
            "spherical", "uniform", "planophile", "erectophile", "plagiophile", "extremophile"
        )
    },
    "ellipsoid 0.4": EllipsoidalLeafAngle(0.4),
    "ellipsoid 2.5": EllipsoidalLeafAngle(2.5),
    "table": TabulatedLeafAngle(np.linspace(0.2, 1.0, 18)),
}  # fmt: skip
SOME = jnp.asarray(towards([0.0, 25.0, 70.0, 110.0, 155.0], [0.0, 40.0, 200.0, 310.0, 95.0]))


def sphere(levels: int = 32, azimuths: int = 48) -> tuple[np.ndarray, np.ndarray]:
    """Directions and solid angles of the whole sphere."""
    node, weight = np.polynomial.legendre.leggauss(levels)
    turn = (np.arange(azimuths) + 0.5) * (360 / azimuths)
    vectors = towards(np.rad2deg(np.arccos(node))[:, None], turn).reshape(-1, 3)
    return vectors, np.repeat(weight * 2 * np.pi / azimuths, azimuths)


def brute_force(angle, incoming, outgoing, n=900, turns=720):
    """Reflection and transmission summed leaf by leaf, from the definition."""
    leaf = (np.arange(n) + 0.5) * (0.5 * np.pi / n)
    density = np.asarray(angle.inclination_density(jnp.asarray(leaf)))
    normals = towards(np.rad2deg(leaf)[:, None], (np.arange(turns) + 0.5) * (360 / turns))
    before, after = normals @ np.asarray(incoming), normals @ np.asarray(outgoing)
    share = np.abs(before * after) * density[:, None] / density.sum() / turns
    same_side = before * after < 0  # the light arrives against the normal it leaves along
    return share[same_side].sum(), share[~same_side].sum()


def test_spherical_at_its_ends_by_hand():
    """The mean of the squared cosine over a sphere is 1/3; light cannot be reflected onwards."""
    vectors = jnp.asarray(towards([30.0, 150.0], [20.0, 200.0]))
    reflected, transmitted = area_scattering(leaf_angle("spherical"), vectors[:1], vectors)
    np.testing.assert_allclose(reflected, [[0.0, 1 / 3]], atol=1e-12)
    np.testing.assert_allclose(transmitted, [[1 / 3, 0.0]], atol=1e-12)


def test_spherical_closed_form():
    reflected, transmitted = area_scattering(leaf_angle("spherical"), SOME, SOME)
    scattering = np.arccos(np.clip(np.asarray(SOME @ SOME.T), -1, 1))
    want = spherical_gamma(scattering, 0.4, 0.3)
    np.testing.assert_allclose(0.4 * reflected + 0.3 * transmitted, want, atol=1e-9)


def test_quadrature_over_normals_agrees_with_the_closed_form():
    """A ratio of one takes the general road; 32 x 96 normals leave 5e-4 of the peak of 1/3."""
    closed = area_scattering(leaf_angle("spherical"), SOME, SOME)
    general = area_scattering(EllipsoidalLeafAngle(1.0), SOME, SOME)
    for one, other in zip(closed, general, strict=True):
        np.testing.assert_allclose(one, other, atol=5e-4 / 3)


@pytest.mark.parametrize("name", ["planophile", "erectophile", "ellipsoid 2.5"])
@pytest.mark.parametrize("pair", [(3, 1), (4, 2), (1, 2), (4, 3)])
def test_against_a_sum_over_leaves(name, pair):
    incoming, outgoing = SOME[pair[0]], SOME[pair[1]]
    want = brute_force(ANGLES[name], incoming, outgoing)
    got = [float(g[0, 0]) for g in area_scattering(ANGLES[name], incoming[None], outgoing[None])]
    np.testing.assert_allclose(got, want, atol=3e-4)


@pytest.mark.parametrize("name", ANGLES)
def test_what_a_leaf_meets_it_scatters(name):
    """(1/pi) times the integral over all outgoing directions is the projection G."""
    vectors, weight = sphere()
    for gamma in area_scattering(ANGLES[name], SOME, jnp.asarray(vectors)):
        got = np.asarray(gamma) @ weight / np.pi
        np.testing.assert_allclose(got, ANGLES[name].projection(SOME[:, 2]), rtol=2e-3)


@pytest.mark.parametrize("name", ANGLES)
def test_reciprocity(name):
    """Light sent back along its way meets the same leaves."""
    forth = area_scattering(ANGLES[name], SOME, SOME)
    back = area_scattering(ANGLES[name], -SOME, -SOME)
    for one, other in zip(forth, back, strict=True):
        np.testing.assert_allclose(one, other.T, atol=1e-12)


@pytest.mark.parametrize("name", ["spherical", "planophile"])
def test_gradients_in_the_directions(name):
    """Vectors are free here, off the sphere too; the smooth closed form is exact there as well."""
    rtol = 1e-6 if name == "spherical" else 1e-5
    away = jnp.asarray(towards([35.0, 145.0], [77.0, 260.0]))
    assert_gradients(
        jax.jit(lambda at: area_scattering(ANGLES[name], *at)),
        (SOME[1:2], away),
        step=1e-7,
        rtol=rtol,
    )

"""Leaf angle distributions against hand integrals, an ellipsoid's shadow and brute force."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import brentq

from fynjax._core.errors import InputError
from fynjax.canopy import (
    AbstractLeafAngle,
    EllipsoidalLeafAngle,
    SphericalLeafAngle,
    TabulatedLeafAngle,
    TiltedLeafAngle,
    TrigonometricLeafAngle,
    VerhoefLeafAngle,
    leaf_angle,
    projections,
)
from tests.helpers import assert_gradients

NAMES = ["spherical", "uniform", "planophile", "erectophile", "plagiophile", "extremophile"]
OTHERS = {
    "ellipsoid 0.4": EllipsoidalLeafAngle(0.4),
    "ellipsoid 2.5": EllipsoidalLeafAngle(2.5),
    "mixed waves": TrigonometricLeafAngle(0.3, -0.5),
    "Verhoef": VerhoefLeafAngle(0.3, -0.5),
    "Verhoef, spherical": VerhoefLeafAngle(-0.35, -0.15),
    "table": TabulatedLeafAngle(np.linspace(0.2, 1.0, 18)),
    "tilted": TiltedLeafAngle(leaf_angle("erectophile"), -2.5),
}
ALL = {**{name: leaf_angle(name) for name in NAMES}, **OTHERS}

# Integrals over [0, 90] degrees of g cos t (the nadir) and of (2/pi) g sin t (the horizon), with
# g = (2/pi)(1 + a cos 2t + b cos 4t): cos t against (1, cos 2t, cos 4t) gives (1, 1/3, -1/15), and
# sin t gives (1, -1/3, -1/15).
NADIR = {
    "spherical": 1 / 2,
    "uniform": 2 / np.pi,
    "planophile": 8 / (3 * np.pi),
    "erectophile": 4 / (3 * np.pi),
    "plagiophile": 32 / (15 * np.pi),
    "extremophile": 28 / (15 * np.pi),
}
HORIZON = {
    "spherical": 1 / 2,
    "uniform": (2 / np.pi) ** 2,
    "planophile": (2 / np.pi) ** 2 * 2 / 3,
    "erectophile": (2 / np.pi) ** 2 * 4 / 3,
    "plagiophile": (2 / np.pi) ** 2 * 16 / 15,
    "extremophile": (2 / np.pi) ** 2 * 14 / 15,
}


def projection_by_brute_force(angle: AbstractLeafAngle, cosine: float) -> float:
    """Mean of |normal . direction| over a fine grid of normals."""
    n = 1800
    leaf = (np.arange(n) + 0.5) * (0.5 * np.pi / n)
    turn = (np.arange(720) + 0.5) * (np.pi / 720)
    density = np.asarray(angle.inclination_density(jnp.asarray(leaf)))
    sine = np.sqrt(1 - cosine**2)
    facing = cosine * np.cos(leaf)[:, None] + sine * np.sin(leaf)[:, None] * np.cos(turn)
    return float(density @ np.abs(facing).mean(1) * (0.5 * np.pi / n))


def ellipsoid_projection(chi: float, cosine: np.ndarray) -> np.ndarray:
    """Shadow of an ellipsoid of revolution over half its surface, in closed form."""
    if chi > 1:
        e = np.sqrt(1 - chi**-2)
        half_surface = chi + np.log((1 + e) / (1 - e)) / (2 * e * chi)
    else:
        e = np.sqrt(1 - chi**2)
        half_surface = chi + np.arcsin(e) / e
    return np.sqrt(chi**2 * cosine**2 + 1 - cosine**2) / half_surface


@pytest.mark.parametrize("name", NAMES)
def test_projection_at_the_nadir_and_at_the_horizon(name):
    got = leaf_angle(name).projection(jnp.array([1.0, 0.0]))
    np.testing.assert_allclose(got, [NADIR[name], HORIZON[name]], rtol=1e-6)


def test_spherical_projection_is_one_half_everywhere():
    got = SphericalLeafAngle().projection(jnp.linspace(-1.0, 1.0, 41))
    np.testing.assert_array_equal(got, 0.5)


@pytest.mark.parametrize("name", ALL)
def test_density_integrates_to_one(name):
    n = 18000  # a multiple of the table's bins
    leaf = (jnp.arange(n) + 0.5) * (0.5 * jnp.pi / n)
    density = ALL[name].inclination_density(leaf)
    assert float(density.min()) >= 0
    total = float(density.mean() * 0.5 * jnp.pi)
    if name == "table":  # documented as normalised on use, from any positive numbers
        total /= float(OTHERS["table"].density.mean() * 0.5 * jnp.pi)
    assert total == pytest.approx(1.0, abs=1e-6)


@pytest.mark.parametrize("name", ALL)
def test_mean_projection_over_the_hemisphere_is_one_half(name):
    """Every flat leaf casts half its area on average, whatever its inclination."""
    cosine = (jnp.arange(20000) + 0.5) / 20000
    assert float(ALL[name].projection(cosine).mean()) == pytest.approx(0.5, abs=1e-5)


@pytest.mark.parametrize("name", [n for n in ALL if n not in ("spherical", "table")])
@pytest.mark.parametrize("cosine", [0.95, 0.6, 0.2])
def test_projection_against_brute_force(name, cosine):
    """The 32 inclinations of the quadrature leave at most 0.05 %."""
    want = projection_by_brute_force(ALL[name], cosine)
    assert float(ALL[name].projection(cosine)) == pytest.approx(want, rel=5e-4)


@pytest.mark.parametrize("name", ALL)
def test_opposite_directions_project_alike(name):
    cosine = jnp.linspace(0.05, 1.0, 9)
    np.testing.assert_array_equal(ALL[name].projection(cosine), ALL[name].projection(-cosine))


@pytest.mark.parametrize("chi", [0.3, 0.7, 1.5, 3.0])
def test_ellipsoidal_projection_is_the_shadow_of_an_ellipsoid(chi):
    cosine = np.linspace(0.05, 1.0, 20)
    got = EllipsoidalLeafAngle(chi).projection(jnp.asarray(cosine))
    np.testing.assert_allclose(got, ellipsoid_projection(chi, cosine), rtol=1e-3)


def test_ellipsoid_of_ratio_one_is_a_sphere():
    angle = EllipsoidalLeafAngle(1.0)
    leaf = jnp.linspace(0.0, 0.5 * jnp.pi, 50)
    np.testing.assert_allclose(angle.inclination_density(leaf), np.sin(leaf), atol=1e-12)
    np.testing.assert_allclose(angle.projection(jnp.linspace(0.0, 1.0, 30)), 0.5, rtol=5e-4)


@pytest.mark.parametrize("name", ALL)
def test_normals_are_unit_vectors_of_the_upper_hemisphere_with_weights_of_one(name):
    vectors, weight = ALL[name].normals()
    np.testing.assert_allclose(np.linalg.norm(vectors, axis=1), 1.0, atol=1e-12)
    assert float(vectors[:, 2].min()) > 0
    assert float(weight.sum()) == pytest.approx(1.0, abs=1e-12)
    np.testing.assert_allclose(weight @ vectors[:, :2], 0.0, atol=1e-12)


def test_a_table_made_from_random_normals_of_a_sphere():
    rng = np.random.default_rng(3)
    normals = rng.normal(size=(200_000, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    angle = TabulatedLeafAngle.from_normals(normals, np.full(len(normals), 1e-4))
    centres = (np.arange(18) + 0.5) * (0.5 * np.pi / 18)
    np.testing.assert_allclose(angle.density, np.sin(centres), atol=0.03)
    np.testing.assert_allclose(angle.projection(jnp.linspace(0.0, 1.0, 11)), 0.5, atol=0.005)


def test_a_table_weighs_normals_by_area_and_ignores_their_sign():
    normals = np.array([[0.0, 0.0, 1.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])
    angle = TabulatedLeafAngle.from_normals(normals, np.array([1.0, 2.0, 1.0]), bins=9)
    width = 0.5 * np.pi / 9
    want = np.zeros(9)
    want[0], want[-1] = 0.75 / width, 0.25 / width
    np.testing.assert_allclose(angle.density, want, rtol=1e-12)


@pytest.mark.parametrize("cosine", [0.95, 0.6, 0.2])
def test_a_table_of_many_normals_projects_as_they_do(cosine):
    rng = np.random.default_rng(5)
    leaf, turn = np.arccos(rng.beta(2.0, 3.0, 100_000)), rng.uniform(0, 2 * np.pi, 100_000)
    normals = np.stack(
        [np.sin(leaf) * np.sin(turn), np.sin(leaf) * np.cos(turn), np.cos(leaf)], axis=1
    )
    area = rng.uniform(0.5, 1.5, len(leaf))
    direction = np.array([np.sqrt(1 - cosine**2), 0.0, cosine])
    want = np.average(np.abs(normals @ direction), weights=area)
    got = TabulatedLeafAngle.from_normals(normals, area).projection(cosine)
    assert float(got) == pytest.approx(want, rel=0.01)


def test_gradients_in_the_direction_and_in_the_parameters():
    cosine = jnp.array([0.11, 0.47, 0.83])

    def projections(values):
        second, fourth, ratio, bins, mu = values
        angles = (
            TrigonometricLeafAngle(second, fourth),
            EllipsoidalLeafAngle(ratio),
            TabulatedLeafAngle(bins),
        )
        return [a.projection(mu) for a in angles] + [a.normals()[1][::96] for a in angles]

    at = (jnp.array(0.4), jnp.array(-0.2), jnp.array(1.7), jnp.linspace(0.3, 1.0, 6), cosine)
    assert_gradients(jax.jit(projections), at, rtol=2e-6)


@pytest.mark.parametrize("name", ["planophile", "ellipsoid 2.5"])
@pytest.mark.parametrize("cosine", [0.0, 1.0, -1.0])
def test_the_slope_is_finite_at_the_nadir_and_at_the_horizon(name, cosine):
    assert np.isfinite(jax.grad(ALL[name].projection)(cosine))


@pytest.mark.parametrize("name", ALL)
def test_single_precision_stays_single(name):
    cosine = jnp.linspace(0.0, 1.0, 11, dtype=jnp.float32)
    got = ALL[name].projection(cosine)
    assert got.dtype == jnp.float32
    np.testing.assert_allclose(got, ALL[name].projection(cosine.astype(float)), rtol=2e-5)


def test_an_unknown_name_is_refused():
    with pytest.raises(InputError, match=r"`name`.*spherical.*'Planophile'"):
        leaf_angle("Planophile")


def test_a_kind_with_a_projection_of_its_own_is_refused():
    """It would be left out wherever many kinds are computed at once."""

    class Level(AbstractLeafAngle):
        def inclination_density(self, inclination):
            return jnp.exp(-50.0 * inclination)

    np.testing.assert_allclose(projections([Level()], jnp.array([1.0])), 1.0, atol=2e-3)
    for name in ("projection", "normals"):
        with pytest.raises(TypeError, match=f"must not define {name}"):
            type("Own", (Level,), {name: lambda self: None})


# Shares of the leaves by 15 degrees of inclination, sums of the 18 classes that the functions
# `verhoef_bimodal` and `campbell` of prosail 2.0.5 (GPL-3) return.
PROSAIL = {
    (1.0, 0.0): (0.80254, 0.11761, 0.05037, 0.02142, 0.0071, 0.00097),
    (-1.0, 0.0): (0.00097, 0.0071, 0.02142, 0.05037, 0.11761, 0.80254),
    (0.0, -1.0): (0.00403, 0.03589, 0.46008, 0.46008, 0.03589, 0.00403),
    (-0.35, -0.15): (0.05847, 0.07754, 0.12413, 0.20839, 0.27333, 0.25814),
    (0.3, -0.5): (0.12488, 0.25611, 0.41774, 0.13243, 0.04686, 0.02199),
    20.0: (0.53147, 0.27275, 0.09429, 0.04639, 0.0303, 0.0248),
    57.0: (0.03959, 0.11245, 0.16956, 0.20805, 0.23027, 0.24009),
    70.0: (0.00656, 0.02342, 0.0552, 0.12738, 0.28641, 0.50103),
}


@pytest.mark.parametrize("given", PROSAIL, ids=str)
def test_shares_are_those_of_prosail(given):
    verhoef = isinstance(given, tuple)
    angle = VerhoefLeafAngle(*given) if verhoef else EllipsoidalLeafAngle.from_mean_angle(given)
    edges = np.arange(7) * np.pi / 12
    node, weight = np.polynomial.legendre.leggauss(200)
    at = edges[:-1, None] + (node + 1.0) * np.pi / 24
    shares = np.asarray(angle.inclination_density(jnp.asarray(at))) @ weight * np.pi / 24
    atol = 0.02 if verhoef and 1.0 in np.abs(given) else 2e-5  # the former have ends without bound
    np.testing.assert_allclose(shares, PROSAIL[given], atol=atol)


def test_means_of_verhoefs_names():
    inclination = np.rad2deg(
        np.arccos(np.abs(np.asarray(leaf_angle("spherical").normals()[0])[:, 2]))
    )
    for given, mean in (((1.0, 0.0), 8.5), ((-1.0, 0.0), 81.5), ((-0.35, -0.15), 57.8)):
        weight = np.asarray(VerhoefLeafAngle(*given).normals()[1])
        assert float(weight @ inclination) == pytest.approx(mean, abs=0.05)
        # x = 2 t + a sin x + b/2 sin 2x, by Verhoef's own iteration: mean of 90 degrees less F.
        t, x = np.linspace(0.0, np.pi / 2, 20001), 2 * np.linspace(0.0, np.pi / 2, 20001)
        for _ in range(2000):
            x = x + 0.5 * (given[0] * np.sin(x) + 0.5 * given[1] * np.sin(2 * x) - x + 2 * t)
        below = 2.0 * (x - t) / np.pi
        assert 90.0 - np.rad2deg(np.trapezoid(below, t)) == pytest.approx(mean, abs=0.05)


def test_gradients_of_verhoefs_distribution():
    def density(a, b, t):
        return VerhoefLeafAngle(a, b).inclination_density(t)

    def seen(a, b):
        return VerhoefLeafAngle(a, b).projection(jnp.asarray([0.6]))[0]

    for function, at in ((density, (-0.35, -0.15, 0.7)), (seen, (-0.35, -0.15))):
        at = [jnp.asarray(value) for value in at]
        slopes = jax.grad(function, argnums=tuple(range(len(at))))(*at)
        for k, slope in enumerate(slopes):
            ends = [function(*at[:k], at[k] + s * 1e-4, *at[k + 1 :]) for s in (1, -1)]
            assert float(slope) == pytest.approx(float(ends[0] - ends[1]) / 2e-4, rel=1e-4)


def test_coefficients_that_are_no_distribution_are_refused():
    with pytest.raises(InputError, match=r"0\.8 and -0\.5"):
        VerhoefLeafAngle(0.8, -0.5)


@pytest.mark.parametrize("name", ["spherical", "erectophile", "planophile", "plagiophile"])
@pytest.mark.parametrize("mean", [12.0, 40.0, 57.3, 80.0])
def test_tilted_leaves_have_the_mean_angle_and_their_own_projection(name, mean):
    """Against the tilt and the shadow on a fine grid of inclinations, by scipy."""
    leaf = (np.arange(20000) + 0.5) * (0.5 * np.pi / 20000)
    base = np.asarray(leaf_angle(name).inclination_density(jnp.asarray(leaf)), float)

    def tilted(tilt):
        density = base * np.exp(tilt * (leaf - np.radians(mean)))
        return density / density.sum()

    tilt = brentq(lambda t: tilted(t) @ leaf - np.radians(mean), -80.0, 80.0)
    (angle,) = TiltedLeafAngle.to_means([leaf_angle(name)], np.array([mean]))
    assert float(angle.mean_angle) == pytest.approx(mean, abs=1e-3)
    assert float(angle.tilt) == pytest.approx(tilt, abs=0.02)
    turn = (np.arange(360) + 0.5) * (np.pi / 360)
    for cosine in (1.0, 0.7, 0.2):
        facing = cosine * np.cos(leaf)[::20, None] + np.sqrt(1 - cosine**2) * np.sin(leaf)[
            ::20, None
        ] * np.cos(turn)
        shares = tilted(tilt)[::20]
        want = shares @ np.abs(facing).mean(axis=1) / shares.sum()
        assert float(angle.projection(cosine)) == pytest.approx(want, rel=5e-3)


def test_leaves_at_their_own_mean_angle_are_as_they_are():
    every = [*ALL.values()]
    cosine = jnp.linspace(0.0, 1.0, 7)
    same = TiltedLeafAngle.to_means(every, jnp.stack([angle.mean_angle for angle in every]))
    np.testing.assert_allclose(projections(same, cosine), projections(every, cosine), rtol=1e-4)


def test_the_slope_by_the_mean_angle_is_that_of_the_tilt_that_is_sought():
    means = jnp.array([25.0, 50.0, 70.0])
    bases = [leaf_angle("spherical"), leaf_angle("planophile"), OTHERS["ellipsoid 0.4"]]

    def of_means(values):
        return projections(TiltedLeafAngle.to_means(bases, values[0]), jnp.array([0.2, 0.6, 1.0]))

    assert_gradients(jax.jit(of_means), (means,), rtol=1e-5)


def test_a_mean_angle_that_a_table_cannot_have_is_come_near_to():
    upright = TabulatedLeafAngle(np.array([0.0, 0.0, 1.0]))  # none below 60 degrees
    (angle,) = TiltedLeafAngle.to_means([upright], jnp.array([20.0]))
    assert 60.0 < float(angle.mean_angle) < 65.0
    slope = jax.grad(lambda m: TiltedLeafAngle.to_means([upright], m)[0].projection(1.0))
    assert slope(jnp.array([20.0])) == 0.0


def test_mean_angle_of_ellipsoids_is_near_what_was_asked_for():
    normals, _ = leaf_angle("spherical").normals()
    inclination = np.rad2deg(np.arccos(np.asarray(normals)[:, 2]))
    for mean in (10.0, 30.0, 58.0, 80.0):
        weight = np.asarray(EllipsoidalLeafAngle.from_mean_angle(mean).normals()[1])
        assert float(weight @ inclination) == pytest.approx(mean, abs=1.3)

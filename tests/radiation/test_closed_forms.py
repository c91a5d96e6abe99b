"""Uniform slabs with an answer on paper: gaps, single scattering, soil, the thin limit.

In a laterally uniform slab the solution is independent of the sideways resolution, and layers are
integrated exactly, so what is compared to a formula is compared to (nearly) rounding.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from fynjax.canopy import EllipsoidalLeafAngle, leaf_angle
from fynjax.radiation import Accuracy, parallel_rays, render
from tests.radiation.scenes import (
    FINE,
    fluxes_of,
    reflectance_of,
    slab,
    solver,
    spherical_gamma,
    towards,
)

ANGLES = {
    "spherical": leaf_angle("spherical"),
    "planophile": leaf_angle("planophile"),
    "erectophile": leaf_angle("erectophile"),
    "ellipsoid": EllipsoidalLeafAngle(1.8),
}
COARSE = Accuracy(lattice=1, coarsening=(1, 1), levels=2, azimuths=4, tolerance=1e-9)
VIEW_ZENITH = np.array([0.0, 20.0, 20.0, 50.0, 70.0, 35.0])
VIEW_AZIMUTH = np.array([0.0, 270.0, 90.0, 270.0, 90.0, 10.0])


def depth(angle, zenith, lai):
    mu = np.cos(np.deg2rad(zenith))
    return np.asarray(angle.projection(jnp.asarray(mu))) * lai / mu


@jax.jit
def look(light, zenith, azimuth):
    x = jnp.array([0.3, 1.1])
    return jax.vmap(lambda z, a: render(light, parallel_rays(x, x, 0.2, z, a)))(zenith, azimuth)


@pytest.mark.parametrize("name", ANGLES)
@pytest.mark.parametrize("zenith", [0.0, 37.0, 75.0])
def test_direct_light_at_the_ground(name, zenith):
    """exp(-G LAI / cos) (Ross 1981), of the direct share of the light."""
    scene = slab(2.4, [(0.4, 0.3, 0.2), (0.0, 0.0, 0.0)], zenith, angle=ANGLES[name], sky=0.25)
    direct = fluxes_of(solver(COARSE)(scene)).transmitted_direct
    np.testing.assert_allclose(direct, 0.75 * np.exp(-depth(ANGLES[name], zenith, 2.4)), rtol=1e-6)


@pytest.mark.parametrize("name", ANGLES)
def test_gap_towards_the_sensor(name):
    scene = slab(2.4, [(0.4, 0.3, 0.2), (0.0, 0.0, 0.0)], 30.0, angle=ANGLES[name])
    gap = look(solver(COARSE)(scene), VIEW_ZENITH, VIEW_AZIMUTH).gap
    want = np.exp(-depth(ANGLES[name], VIEW_ZENITH, 2.4))
    np.testing.assert_allclose(gap, np.broadcast_to(want[:, None, None], gap.shape), rtol=1e-6)


@pytest.mark.parametrize("lai", [0.3, 3.0, 8.0])
def test_light_scattered_once_by_spherical_leaves(lai):
    """BRF = Gamma / (mu0 mu) (1 - exp(-k LAI)) / k, k = 1/(2 mu0) + 1/(2 mu)."""
    optics = [(0.5, 0.4, 0.2), (0.06, 0.015, 0.0)]
    first = look(solver(COARSE)(slab(lai, optics, 40.0)), VIEW_ZENITH, VIEW_AZIMUTH).sunlit_leaves
    mu0, mu = np.cos(np.deg2rad(40.0)), np.cos(np.deg2rad(VIEW_ZENITH))
    k = 0.5 / mu0 + 0.5 / mu
    # The light travels away from the sun.
    turned = np.arccos(np.clip(-towards(VIEW_ZENITH, VIEW_AZIMUTH) @ towards(40.0, 270.0), -1, 1))
    for band, (rho, tau, _) in enumerate(optics):
        gamma = spherical_gamma(turned, rho, tau)
        want = gamma / (mu0 * mu) * -np.expm1(-k * lai) / k
        got = np.pi * np.asarray(first)[:, band]
        np.testing.assert_allclose(got, np.broadcast_to(want[:, None, None], got.shape), rtol=1e-4)


def test_a_very_dark_leaf_scatters_once():
    """As the leaf's albedo goes to zero over black soil, all that is left is single scattering."""
    scene = slab(3.0, [(0.5, 0.4, 0.0), (5e-6, 4e-6, 0.0)], 40.0)
    light = solver(COARSE)(scene)
    total = reflectance_of(light, VIEW_ZENITH, VIEW_AZIMUTH)[:, 1]
    single = np.pi * look(light, VIEW_ZENITH, VIEW_AZIMUTH).sunlit_leaves[:, 1, 0, 0]
    np.testing.assert_allclose(total, single, rtol=1e-4)


@pytest.mark.parametrize("name", ANGLES)
def test_soil_under_black_leaves(name):
    """BRF = soil exp(-k LAI): one gap down, one gap up."""
    angle = ANGLES[name]
    scene = slab(1.2, [(0.0, 0.0, 0.3), (0.0, 0.0, 1.0)], 40.0, angle=angle)
    got = reflectance_of(solver(COARSE)(scene), VIEW_ZENITH, VIEW_AZIMUTH)
    gaps = np.exp(-depth(angle, 40.0, 1.2) - depth(angle, VIEW_ZENITH, 1.2))
    np.testing.assert_allclose(got, gaps[:, None] * np.array([0.3, 1.0]), rtol=1e-6)


def test_soil_enters_as_a_geometric_series():
    """R(a) = R(0) + P a / (1 - a S), with one S for albedo and every view.

    Over Lambertian soil under a uniform slab light that comes back from below has one shape, so
    two soils fix P and S, and the rest follow.
    """
    soils = np.array([0.0, 0.2, 1.0, 0.5, 0.85])
    scene = slab(2.0, [(0.45, 0.4, a) for a in soils], 35.0, sky=0.2)
    light = solver(FINE)(scene)
    views = np.asarray(reflectance_of(light, VIEW_ZENITH, VIEW_AZIMUTH))
    curves = np.concatenate([views, np.asarray(fluxes_of(light).albedo)[None]])
    gain = curves - curves[:, :1]
    # gain(a) (1 - a S) = P a at a = soils[1] and soils[2]
    a, b = soils[1:3]
    share = (gain[:, 2] / b - gain[:, 1] / a) / (gain[:, 2] - gain[:, 1])
    np.testing.assert_allclose(share, share[0], rtol=1e-6)
    slope = gain[:, 1] * (1 - a * share) / a
    want = slope[:, None] * soils / (1 - soils * share[:, None])
    np.testing.assert_allclose(gain, want, rtol=1e-6, atol=1e-9)


def test_thin_canopy():
    """First order in LAI, all six ways: one leaf on the path, or one between soil and soil.

    d BRF / d LAI = Gamma / (mu0 mu) - a k + a (down from the sun + up to the view) + a2 (back
    to the soil), each an integral of Gamma over directions.
    """
    lai, rho, tau = 1e-4, 0.45, 0.3
    optics = [(rho, tau, 0.0), (rho, tau, 0.25)]
    got = np.asarray(
        reflectance_of(solver(FINE)(slab(lai, optics, 40.0)), VIEW_ZENITH, VIEW_AZIMUTH)
    )
    node, weight = np.polynomial.legendre.leggauss(64)
    cosine, weight = 0.5 * (node + 1), np.repeat(0.5 * weight * 2 * np.pi / 128, 128)
    turn = (np.arange(128) + 0.5) * 360 / 128
    upper = towards(np.rad2deg(np.arccos(cosine))[:, None], turn).reshape(-1, 3)
    lower = upper * [1, 1, -1]
    sunward, views = towards(40.0, 270.0), towards(VIEW_ZENITH, VIEW_AZIMUTH)
    mu0, mu = sunward[2], views[:, 2]

    def gamma(incoming, outgoing):
        angle = np.arccos(np.clip(incoming @ outgoing.T, -1, 1))
        return spherical_gamma(angle, rho, tau)

    down = gamma(-sunward[None], lower)[0] @ weight / np.pi / mu0
    up = weight @ gamma(upper, views) / np.pi / mu
    every = np.arange(0, len(upper), 7)  # any evenly spread sample; azimuths are alike
    back = np.average(gamma(upper[every], lower) @ weight, weights=weight[every]) * 2 / np.pi
    k = 0.5 / mu0 + 0.5 / mu
    leaf = gamma(-sunward[None], views)[0] / (mu0 * mu)
    for band, (_, _, soil) in enumerate(optics):
        want = leaf - soil * k + soil * (down + up) + soil**2 * back
        np.testing.assert_allclose((got[:, band] - soil) / lai, want, rtol=5e-3)

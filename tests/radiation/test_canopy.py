"""The one-line canopy against discrete ordinates, closed forms and differences."""

import json

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from fynjax.errors import InputError
from fynjax.radiation import canopy_reflectance

RHO, TAU, SOIL = jnp.array([0.06, 0.48]), jnp.array([0.02, 0.45]), jnp.array([0.1, 0.2])


def test_against_discrete_ordinates(shared_data):
    with open(shared_data / "rt" / "slab_uniform_turbid.json", encoding="utf-8") as file:
        cases = json.load(file)["cases"]
    for case in cases[::4]:
        optics, scene = case["optics"], case["scene"]
        one = lambda name: jnp.full(2, optics[name])  # noqa: E731, B023
        for (zenith, azimuth), want in zip(case["views"], case["result"]["brf"]):
            if azimuth == 0 and zenith in (0, 30, -60):
                got = canopy_reflectance(
                    one("rho"),
                    one("tau"),
                    float(scene["lai"]),
                    soil=one("soil"),
                    sun_zenith=float(case["sza"]),
                    view_zenith=float(abs(zenith)),
                    # There positive angles look away from the sun.
                    relative_azimuth=180.0 if zenith > 0 else 0.0,
                )
                np.testing.assert_allclose(got, want, rtol=5e-3)


def test_without_leaves_there_is_soil_and_black_leaves_hide_it():
    bare = canopy_reflectance(RHO, TAU, 0.0, soil=SOIL)
    np.testing.assert_allclose(bare, SOIL, rtol=1e-6)
    black = canopy_reflectance(0 * RHO, 0 * TAU, 1.5, soil=SOIL, sun_zenith=40.0, view_zenith=20.0)
    path = 0.5 * 1.5 * sum(1 / np.cos(np.deg2rad(a)) for a in (40.0, 20.0))
    np.testing.assert_allclose(black, SOIL * np.exp(-path), rtol=1e-5)


def test_gradients_are_those_of_differences():
    weight = jnp.array([1.0, -0.7])

    def figure(rho, tau, area, soil):
        return weight @ canopy_reflectance(rho, tau, area, soil=soil, sky_share=0.2)

    at = (RHO, TAU, jnp.asarray(1.7), SOIL)
    slopes = jax.grad(figure, argnums=(0, 1, 2, 3))(*at)
    for k, slope in enumerate(slopes):
        step = 1e-4 * jnp.ones_like(at[k])
        ends = [figure(*at[:k], at[k] + s * step, *at[k + 1 :]) for s in (1, -1)]
        assert float(slope.sum()) == pytest.approx(float(ends[0] - ends[1]) / 2e-4, rel=1e-4)


def test_what_cannot_be_is_refused():
    for wrong in (
        {"leaf_area_index": -1.0}, {"sky_share": 1.2}, {"view_zenith": 90.0}, {"sun_zenith": -1.0},
    ):  # fmt: skip
        with pytest.raises(InputError):
            canopy_reflectance(RHO, TAU, **wrong)

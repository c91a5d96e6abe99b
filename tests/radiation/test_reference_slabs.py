"""Turbid slabs against 32-stream discrete ordinates and a Monte Carlo (reference data)."""

import json

import numpy as np
import pytest

from fynjax.canopy import leaf_angle
from tests.radiation.scenes import FINE, fluxes_of, reflectance_of, slab, solver, views_of_reference


def load(folder, name):
    with open(folder / "rt" / name, encoding="utf-8") as file:
        return json.load(file)["cases"]


def simulate(case):
    scene, optics = case["scene"], case["optics"]
    angle = leaf_angle("spherical" if scene["lad"] == "uniform" else scene["lad"])
    light = solver(FINE)(
        slab(
            scene["lai"], [(optics["rho"], optics["tau"], optics["soil"])], case["sza"], angle=angle
        )
    )
    brf = reflectance_of(light, *views_of_reference(case["views"]))
    return np.asarray(brf)[:, 0], fluxes_of(light)


def standard_error(want, name):
    """Of a flux of the Monte Carlo; where the file has none, of so many yes-or-no photons."""
    found = want[name]
    return want.get(f"{name}_se", np.sqrt(found * (1 - found) / want["photons"]))


def assert_fluxes(flux, want, rtol, sigma=0.0):
    names = {
        "albedo": flux.albedo[0],
        "transmission_total": flux.transmitted[0],
        "absorbed_canopy": flux.absorbed.sum(),
        "transmission_direct": flux.transmitted_direct[0],
        "absorbed_soil": flux.ground_absorbed[0],
    }
    for name, got in names.items():
        error = sigma * standard_error(want, name) if sigma else 0.0
        np.testing.assert_allclose(got, want[name], rtol=rtol, atol=error, err_msg=name)


@pytest.mark.parametrize("index", range(15))
def test_spherical_leaves(shared_data, index):
    """The reference is good to 1e-5; what is allowed is six levels of zenith, twenty layers."""
    case = load(shared_data, "slab_uniform_turbid.json")[index]
    brf, flux = simulate(case)
    np.testing.assert_allclose(brf, case["result"]["brf"], rtol=5e-3)
    assert_fluxes(flux, case["result"], 2e-3)


@pytest.mark.parametrize("index", range(4))
def test_planophile_and_erectophile_leaves(shared_data, index):
    case = load(shared_data, "slab_lad_turbid.json")[index]
    want = case["result"]
    brf, flux = simulate(case)
    excess = np.abs(brf / want["brf"] - 1) - 2 * np.array(want["brf_se"]) / np.array(want["brf"])
    assert excess.max() < 5e-3
    assert_fluxes(flux, want, 2e-3, sigma=2.0)

"""The one-line canopy against 4SAIL, discrete ordinates, closed forms and differences.

`canopy_peers.csv` holds reflectance factors of a canopy of leaf area index 3 (`RHO`, `TAU`, `SOIL`)
at 180 geometries: `prosail` of 4SAIL with Verhoef's distribution (-0.35, -0.15) and hspot 0.05;
`sail` of 4SAIL without hot spot and with spherical leaves exactly, its 18 classes of inclination
put in for its own; `disort` of the same canopy by discrete ordinates of 32 streams. Computed for
this test by the function `foursail` of prosail 2.0.5 (GPL-3) and by PythonicDISORT 1.8 (MIT).
"""

import json
from functools import partial
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
import pytest

from fynjax.canopy import VerhoefLeafAngle
from fynjax.errors import InputError
from fynjax.radiation import Accuracy, canopy_albedo, canopy_reflectance, voxel_scene
from tests.radiation.scenes import reflectance_of, solver

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
                    hot_spot=0.0,
                )
                np.testing.assert_allclose(got, want, rtol=5e-3)


PEERS = pd.read_csv(Path(__file__).with_name("canopy_peers.csv"))
GEOMETRY = jnp.asarray(PEERS.iloc[:, :3].to_numpy(float))
FLAT = (PEERS.sun_zenith == PEERS.view_zenith) & (PEERS.relative_azimuth == 0)


def reflectances(angle, size, geometry=GEOMETRY):
    def one(at):
        return canopy_reflectance(
            RHO,
            TAU,
            3.0,
            soil=SOIL,
            leaf_angles=angle,
            sun_zenith=at[0],
            view_zenith=at[1],
            relative_azimuth=at[2],
            hot_spot=size,
        )

    return np.asarray(jax.jit(lambda all: jax.lax.map(one, all))(geometry))


def peer(name):
    return PEERS[[f"{name}_red", f"{name}_nir"]].to_numpy()


def test_prosail_at_180_geometries_with_the_hot_spot():
    error = np.abs(reflectances(VerhoefLeafAngle(-0.35, -0.15), 0.05) / peer("prosail") - 1.0)
    # In the hot spot, where most light is scattered once, and elsewhere but low and far forward.
    assert FLAT.sum() == 3
    assert error[FLAT, 0].max() < 2e-3
    assert np.sum(error[:, 0] < 0.01) >= 170
    # The rest is 4SAIL's two streams, see below.
    assert error[:, 0].max() < 0.02
    assert error[:, 1].max() < 0.1


def test_what_4sail_lacks_is_what_discrete_ordinates_have():
    ours, exact, sail = reflectances("spherical", 0.0), peer("disort"), peer("sail")
    np.testing.assert_allclose(ours, exact, rtol=2e-3)
    assert np.abs(sail / exact - 1.0).max(axis=0) == pytest.approx([0.0167, 0.0843], abs=5e-4)


def test_hot_spot_of_discs():
    # An overlap of discs with the same integral, which is otherwise another model: see `hot_spot`.
    diameter, views = 0.1, jnp.asarray([30.0, 32.0, 35.0, 40.0, 50.0, 65.0])
    scene = voxel_scene(
        jnp.full((1, 20, 1, 1), 3.0),
        RHO[None],
        TAU[None],
        voxel=(1.0, 1.0, 0.05),
        ground=SOIL,
        sun_zenith=30.0,
        sun_azimuth=0.0,
        leaf_diameter=diameter,
    )
    light = solver(Accuracy(lattice=1, coarsening=(1, 1), levels=6, azimuths=8))(scene)
    discs = np.asarray(reflectance_of(light, views, jnp.zeros(6)))
    geometry = jnp.stack([jnp.full(6, 30.0), views, jnp.zeros(6)], axis=1)
    ours = reflectances("spherical", 2.0 / 3.0 * diameter, geometry)
    np.testing.assert_allclose(ours[0], discs[0], rtol=5e-3)
    np.testing.assert_allclose(ours, discs, rtol=0.055)
    points = reflectances("spherical", 0.0, geometry)
    assert (points[:2, 0] < 0.65 * ours[:2, 0]).all()


def test_hot_spot_in_single_precision():
    both = []
    for dtype in (jnp.float32, jnp.float64):
        optics = [values.astype(dtype) for values in (RHO, TAU, SOIL)]
        at = {"sun_zenith": 30.0, "view_zenith": 30.01, "hot_spot": 0.001}
        both.append(canopy_reflectance(*optics[:2], 3.0, soil=optics[2], **at))
    assert both[0].dtype == jnp.float32
    np.testing.assert_allclose(*both, rtol=2e-3)


def test_hot_spot_is_off_at_zero_and_only_of_the_sun():
    off = reflectances("spherical", 0.0, jnp.asarray([[30.0, 29.9, 0.0], [30.0, 30.1, 0.0]]))
    np.testing.assert_allclose(*off, rtol=3e-3)
    at = {"soil": SOIL, "sun_zenith": 30.0, "view_zenith": 30.0}
    sky = [canopy_reflectance(RHO, TAU, 2.0, hot_spot=q, sky_share=1.0, **at) for q in (0.0, 0.1)]
    np.testing.assert_allclose(sky[0], sky[1], rtol=1e-6)


def test_gradients_in_the_hot_spot_and_beside_it():
    def red(size, view, azimuth, area):
        return canopy_reflectance(
            RHO,
            TAU,
            area,
            soil=SOIL,
            sun_zenith=30.0,
            view_zenith=view,
            relative_azimuth=azimuth,
            hot_spot=size,
        )[0]

    slopes = jax.jit(jax.grad(red, argnums=(0, 1, 2, 3)))
    value = jax.jit(red)
    at = [0.05, 34.0, 5.0, 2.0]
    for k, slope in enumerate(slopes(*at)):
        step = 1e-4 * at[k]
        ends = [value(*[a + s * step * (i == k) for i, a in enumerate(at)]) for s in (1, -1)]
        assert float(slope) == pytest.approx(float(ends[0] - ends[1]) / (2 * step), rel=2e-3)
    views = jnp.asarray([30.0, 34.0])
    many = jax.vmap(value, in_axes=(None, 0, None, None))(0.05, views, 5.0, 2.0)
    assert float(many[1]) == pytest.approx(float(value(*at)), rel=1e-6)
    for size in (0.0, 0.05):
        assert np.isfinite(slopes(size, 30.0, 0.0, 2.0)).all()
        assert np.isfinite(slopes(size, 0.0, 0.0, 0.0)).all()


def test_albedo_is_the_mean_reflectance_over_the_hemisphere():
    node, weight = np.polynomial.legendre.leggauss(8)
    square = 0.5 * (node + 1.0)  # of the cosine, so that weights are those of the flux
    zenith, azimuth = np.rad2deg(np.arccos(np.sqrt(square))), np.arange(15.0, 180.0, 30.0)
    rows = [(40.0, z, a) for z in zenith for a in azimuth]
    factor = reflectances("planophile", 0.0, jnp.asarray(rows)).reshape(8, 6, 2).mean(axis=1)
    albedo = canopy_albedo(RHO, TAU, 3.0, soil=SOIL, leaf_angles="planophile", sun_zenith=40.0)
    np.testing.assert_allclose(0.5 * weight @ factor, albedo.black_sky, rtol=3e-3)
    # White-sky: by reciprocity the mean over the sun's directions of the black-sky.
    black = [
        canopy_albedo(RHO, TAU, 3.0, soil=SOIL, leaf_angles="planophile", sun_zenith=z).black_sky
        for z in jnp.asarray(zenith)
    ]
    np.testing.assert_allclose(0.5 * weight @ jnp.stack(black), albedo.white_sky, rtol=3e-3)


def test_albedo_against_discrete_ordinates():
    # 32 streams, as in `canopy_peers.csv`; spherical leaves.
    for sun, red, infrared in ((20.0, 0.020982, 0.410960), (60.0, 0.022932, 0.513967)):
        albedo = canopy_albedo(RHO, TAU, 3.0, soil=SOIL, sun_zenith=sun)
        np.testing.assert_allclose(albedo.black_sky, [red, infrared], rtol=3e-3)
    np.testing.assert_allclose(albedo.white_sky, [0.022546, 0.476515], rtol=3e-3)


def test_furnace_loses_no_light():
    one = jnp.ones(1)
    for angle in ("spherical", VerhoefLeafAngle(-0.9, 0.0)):
        for albedo in canopy_albedo(0.6 * one, 0.4 * one, 4.0, soil=1.0, leaf_angles=angle):
            np.testing.assert_allclose(albedo, 1.0, rtol=1e-4)
    bare = canopy_albedo(RHO, TAU, 0.0, soil=SOIL)
    np.testing.assert_allclose(jnp.stack(bare), jnp.stack([SOIL, SOIL]), rtol=1e-6)


def test_without_leaves_there_is_soil_and_black_leaves_hide_it():
    bare = canopy_reflectance(RHO, TAU, 0.0, soil=SOIL)
    np.testing.assert_allclose(bare, SOIL, rtol=1e-6)
    black = canopy_reflectance(
        0 * RHO, 0 * TAU, 1.5, soil=SOIL, sun_zenith=40.0, view_zenith=20.0,
        hot_spot=0.0,
    )  # fmt: skip
    path = 0.5 * 1.5 * sum(1 / np.cos(np.deg2rad(a)) for a in (40.0, 20.0))
    np.testing.assert_allclose(black, SOIL * np.exp(-path), rtol=1e-5)


@jax.jit
def figure(rho, tau, area, soil):
    shown = canopy_reflectance(rho, tau, area, soil=soil, sky_share=0.2)
    return jnp.array([1.0, -0.7]) @ shown


@partial(jax.jit, static_argnums=0)
def slopes(which, *at):
    return jax.grad(figure, which)(*at)


AT = RHO, TAU, jnp.asarray(1.7), SOIL


@pytest.mark.parametrize("which", [(0,), (1,), (0, 1), (2,), (3,)])
def test_slopes_by_some_of_the_arguments_are_those_by_all(which):
    """Where leaf optics alone change, the light on its way to them does not."""
    every = slopes((0, 1, 2, 3), *AT)
    for place, got in zip(which, slopes(which, *AT), strict=True):
        np.testing.assert_allclose(got, every[place], rtol=1e-5)


def test_gradients_are_those_of_differences():
    for k, slope in enumerate(slopes((0, 1, 2, 3), *AT)):
        step = 1e-4 * jnp.ones_like(AT[k])
        ends = [figure(*AT[:k], AT[k] + s * step, *AT[k + 1 :]) for s in (1, -1)]
        assert float(slope.sum()) == pytest.approx(float(ends[0] - ends[1]) / 2e-4, rel=1e-4)


def test_what_cannot_be_is_refused():
    for wrong in (
        {"leaf_area_index": -1.0}, {"sky_share": 1.2}, {"view_zenith": 90.0}, {"sun_zenith": -1.0},
        {"hot_spot": -0.1},
    ):  # fmt: skip
        with pytest.raises(InputError):
            canopy_reflectance(RHO, TAU, **wrong)


@pytest.mark.parametrize(
    ("how", "words"),
    [
        ({"layers": 0}, "`layers` must be a whole number of 1 or more, but is 0"),
        ({"layers": -1}, "is -1"),
        ({"layers": 2.5}, "is 2.5"),
        ({"layers": "9"}, "is '9'"),
        ({"layers": None}, "is None"),
        ({"leaf_area_index": []}, r"`leaf_area_index` must be one number, but has shape \(0,\)"),
        ({"leaf_area_index": [1.0, 2.0]}, "jax.vmap"),
        ({"soil": [0.1, 0.1, 0.1]}, r"one for each of 2 bands, but has shape \(3,\)"),
        ({"soil": 1500.0}, "ten thousandths"),
        ({"soil": 15.0}, "in percent"),
        ({"sky_share": 20.0}, "in percent"),
    ],
)
def test_a_wrong_canopy_is_refused(how, words):
    with pytest.raises(InputError, match=words):
        canopy_reflectance(RHO, TAU, **how)


def test_ten_thousandths_are_named():
    with pytest.raises(InputError, match="ten thousandths"):
        canopy_reflectance(1e4 * RHO, 1e4 * TAU)
    with pytest.raises(InputError, match="in percent"):
        canopy_albedo(100 * RHO, 100 * TAU)


def canopy_of(share):
    """A sum of reflectance factors, of parameters as shares of their ranges."""
    area, sun, view, turn, sky, size, soil, rho, tau = share * jnp.array(
        [20.0, 89.4, 89.4, 360.0, 1.0, 5.0, 1.0, 1.0, 1.0]
    )
    most = jnp.maximum(rho + tau, 1.0)
    return canopy_reflectance(
        rho[None] / most, tau[None] / most, area, soil=soil[None], sun_zenith=sun, view_zenith=view,
        relative_azimuth=turn, sky_share=sky[None], hot_spot=size,
    ).sum()  # fmt: skip


@pytest.mark.parametrize("count", [30, pytest.param(1000, marks=pytest.mark.study)])
def test_values_and_slopes_are_finite_within_and_at_all_bounds(count):
    chance = np.random.default_rng(count)
    share = chance.uniform(size=(count, 9))
    share = np.where(chance.uniform(size=share.shape) < 0.35, share.round(), share)
    share[0] = [1.0, 0.86, 1.0, 0.18, 0.0, 1.0, 0.96, 0.03, 0.47]  # the hot spot overflowed
    compiled = jax.jit(jax.value_and_grad(canopy_of))
    for at in jnp.asarray(share, jnp.float32):
        value, slope = compiled(at)
        assert np.isfinite(slope).all(), at
        assert 0.0 <= value < np.inf, at

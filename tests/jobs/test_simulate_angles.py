"""Reflectance of a plot by direction, against photons and closed forms."""

import json

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pandas as pd
import pytest
import xarray as xr

from fynjax._core.errors import InputError
from fynjax.app.assembly import build_plot
from fynjax.app.io.plot import read_plot
from fynjax.app.jobs import simulate
from fynjax.app.jobs._simulate_angles import AZIMUTHS, ZENITHS, _voxels, angular_reflectance
from fynjax.radiation import Accuracy, voxel_scene
from fynjax.scene import hard_scene
from fynjax.sensors import shipped_sensor
from tests import reference
from tests.radiation.test_reference_scenes import floating_spheres
from tests.small import write_plot


def scene_of(folder, **keys):
    """A plot in the bands of the drone's camera, under the sun alone."""
    plot = read_plot(write_plot(folder, voxel=keys.pop("voxel", 0.1))).replace(**keys)
    scene, parameters = build_plot(plot, seed=1)
    voxels = _voxels(hard_scene(scene, parameters), parameters, shipped_sensor("mavic_3m").bands)
    dark = jnp.zeros_like(voxels.illumination.sky)
    return eqx.tree_at(
        lambda v: (v.illumination.sun, v.illumination.sky), voxels, (dark + 1.0, dark)
    )


@pytest.mark.slow
def test_views_and_albedo_are_those_of_photons(tmp_path):
    """On evenly filled voxels, red and near infrared; the albedo is the mean of the views."""
    voxels = scene_of(tmp_path)
    found = angular_reflectance(voxels)
    for band in (1, 3):
        want = reference.fluxes(voxels, photons=100_000, seed=3, band=band).albedo
        assert found.albedo[band] == pytest.approx(want.mean, rel=0.015, abs=2 * want.error)
        zenith, azimuth = np.array([0.0, 45.0, 45.0, 45.0]), np.array([0.0, 0.0, 180.0, 90.0])
        views = reference.reflectance(voxels, zenith, azimuth, photons=50_000, seed=3, band=band)
        got = [found.at(angle)[band] for angle in (0.0, 45.0, -45.0)]
        got.append(found.hemisphere[band, ZENITHS == 45.0, AZIMUTHS == 90.0].item())
        assert np.all(np.abs(got / views.mean - 1.0) < 0.02 + 2 * views.error / views.mean)


@pytest.mark.study
def test_albedo_with_the_structure_of_plants_is_that_of_photons(tmp_path):
    """Photons run through the finest voxels. With hot spot it is 0.3 % more."""
    found = angular_reflectance(scene_of(tmp_path, structure_m=None))
    finest = scene_of(tmp_path, voxel=0.025)
    for band in (1, 3):
        want = reference.fluxes(finest, photons=200_000, seed=3, band=band).albedo
        assert found.albedo[band] == pytest.approx(want.mean, rel=0.01, abs=2 * want.error)


@pytest.mark.study
@pytest.mark.parametrize("index", [0, 2], ids=["near infrared", "red"])
def test_floating_spheres_of_rami(shared_data, index):
    """Of the turbid spheres of HET01 all views of a Monte Carlo within 1 % and two standard errors,
    and their albedo within 1 %. Its zenith angles are positive away from the sun."""
    with open(shared_data / "rt" / "het01_turbid.json", encoding="utf-8") as file:
        case = json.load(file)["cases"][index]
    want, accuracy = case["result"], Accuracy(sublayers=2, levels=4, azimuths=8)
    found = angular_reflectance(floating_spheres(case, 2.0, 4), accuracy)
    across = found.hemisphere[0, :, np.flatnonzero(AZIMUTHS == 90.0)[0]]
    got = [found.at(-z)[0] if a == 0 else across[z == ZENITHS][0] for z, a in case["views"]]
    off = np.abs(np.array(got) / want["brf"] - 1.0) - 2.0 * np.array(want["brf_se"]) / want["brf"]
    print(np.round(100.0 * (np.array(got) / want["brf"] - 1.0), 2), found.albedo / want["albedo"])
    assert off.max() < 0.01
    assert found.albedo[0] == pytest.approx(want["albedo"], rel=0.01)


def test_bare_ground_is_alike_from_everywhere():
    scene = voxel_scene(
        jnp.zeros((1, 2, 4, 4)), jnp.array([[0.1, 0.4]]), jnp.array([[0.1, 0.4]]),
        voxel=(0.25, 0.25, 0.25), ground=jnp.array([0.2, 0.3]), sun_zenith=33.3,
    )  # fmt: skip
    found = angular_reflectance(scene)
    for values in (found.hemisphere, found.plane):
        np.testing.assert_allclose(
            values.reshape(2, -1).T, [[0.2, 0.3]] * values[0].size, rtol=1e-5
        )
    np.testing.assert_allclose(found.albedo, [0.2, 0.3], rtol=1e-5)
    assert 33.3 in found.angles.round(4)


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    folder = tmp_path_factory.mktemp("angles")
    plot = write_plot(folder, "[sun]\nzenith_deg = 40.0\nazimuth_deg = 320.0\n")
    made = simulate(plot, folder / "out", sensor="mavic_3m", angles=True, seed=4)
    return made, folder


def test_the_hot_spot_is_where_the_sun_is(run):
    made, folder = run
    with xr.open_dataset(folder / "out" / "angles.nc") as data:
        assert data.brf.dims == ("band", "view_zenith", "view_azimuth")
        assert data.brf.attrs["standard_name"] == "surface_bidirectional_reflectance"
        assert data.view_azimuth.attrs["standard_name"] == "sensor_azimuth_angle"
        assert data.attrs["Conventions"].startswith("CF")
        assert float(data.sun_azimuth) == 320.0
        plane = data.brf_principal_plane.sel(band="nir")
        assert float(plane.view_angle[int(np.argmax(plane.values))]) == 40.0
        beside = plane.sel(view_angle=[35.0, 45.0]).max()
        assert float(plane.max()) > 1.1 * float(beside)
        # The plane lies in the hemisphere, on both sides.
        for angle, azimuth in ((45.0, 320.0), (-45.0, 140.0)):
            ring = data.brf.sel(band="nir", view_zenith=45.0, view_azimuth=azimuth)
            assert float(plane.sel(view_angle=angle)) == pytest.approx(float(ring), rel=1e-5)
        nadir = data.brf.sel(band="nir", view_zenith=0.0)
        np.testing.assert_allclose(nadir, made.nadir["nir"], rtol=1e-6)
        np.testing.assert_allclose(data.albedo, list(made.albedo.values()))
    table = pd.read_csv(folder / "out" / "principal_plane.csv")
    assert table["nir"].max() == pytest.approx(made.towards_sun["nir"])
    assert f"{made.towards_sun['nir'] / made.nadir['nir']:.2f} times" in made.headline[1]


def test_what_does_not_go_together_is_refused(run, tmp_path):
    _, folder = run
    plot = folder / "plot.toml"
    for options, says in (
        ({"pixel": 0.1}, "no pixel with angles"),
        ({"products": ("radiance",)}, "no product with angles"),
        ({"truth": True}, "no truth with angles"),
        ({"noise": True}, "no noise with angles"),
        ({"sensor": "scanning_lidar"}, "is a LiDAR"),
    ):
        with pytest.raises(InputError, match=says):
            simulate(plot, tmp_path / "out", **{"sensor": "mavic_3m", "angles": True, **options})
    with pytest.raises(InputError, match="periodic"):
        simulate(
            read_plot(plot).replace(boundary="open"),
            tmp_path / "out",
            sensor="mavic_3m",
            angles=True,
        )


def test_bands_without_spectra_are_left_out(run, tmp_path):
    """The first of EMIT is at 381 nm."""
    _, folder = run
    few = shipped_sensor("emit").select([0, 20, 70])
    made = simulate(folder / "plot.toml", tmp_path / "out", sensor=few, angles=True, seed=4)
    assert list(made.nadir) == list(few.bands.names[1:])

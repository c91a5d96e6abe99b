"""What returns come from: against counted rays, closed forms, and plants that stand alone."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import fynjax as fx
from fynjax.errors import InputError
from fynjax.radiation import parallel_rays, voxel_scene
from fynjax.sensors import LidarReturns
from fynjax.sensors.lidar import GROUND, shares_of_returns
from tests import reference
from tests.scene.test_truth import COLUMNS, SPECIES
from tests.sensors.lidar_scenes import VOXEL, patchy, scanner


def straight_down(scene, columns, each):
    """`each` pulses of one pencil onto the middle of every voxel column, and a return of each."""
    beams = scanner().beams((5.0, 5.0), top=scene.height)
    middles = (np.arange(columns) + 0.5) * VOXEL
    x, y = (np.repeat(grid.ravel(), each) for grid in np.meshgrid(middles, middles))
    count, height = len(x), 5.0
    beams = dataclasses.replace(
        beams,
        origin=np.stack([x, y, np.full(count, height)], axis=1),
        direction=np.tile([0.0, 0.0, -1.0], (count, 1)),
        pencils=np.zeros((1, 2)),
        pencil_width=1e-6,
        line=np.zeros(count, int),
        **{name: np.ones(count) for name in ("irradiance", "time", "scan_angle", "start")},
    )
    one, nothing = np.ones(count, int), np.zeros(count)
    returns = LidarReturns(
        np.arange(count), beams.origin, np.full(count, height), nothing, nothing, one, one,
        one, nothing, nothing, 0 * one,
    )  # fmt: skip
    return beams, returns


def shares(scene, lidar, groups=((0,), (1,)), columns=3, each=2500):
    beams, returns = straight_down(scene, columns, each)
    species, ground = shares_of_returns(scene, lidar, beams, returns, groups, key=jax.random.key(1))
    np.testing.assert_allclose(species.sum(axis=0) + ground, 1.0, atol=1e-6)
    by_column = np.concatenate([species, ground[None]]).reshape(-1, columns, columns, each)
    return by_column.mean(axis=-1)


def alike(scene, angle="spherical"):
    """The scene with leaves of one colour and one distribution of normals."""
    optics = scene.classes
    return dataclasses.replace(
        scene,
        classes=dataclasses.replace(
            optics,
            reflectance=jnp.full_like(optics.reflectance, 0.4),
            angle_of_class=(optics.angle_of_class[1],) * 2,
        ),
    )


def test_shares_over_many_pulses_are_those_of_rays_counted_one_by_one():
    scene = alike(patchy())
    long_pulse = dataclasses.replace(scanner(), sample=100.0)  # all light is in one return
    found = shares(scene, long_pulse)
    rays = parallel_rays((np.arange(3) + 0.5) * VOXEL, (np.arange(3) + 0.5) * VOXEL, VOXEL, 0, 0)
    counted = reference.first_met(scene, rays, samples=4000, seed=3)
    counted = np.concatenate([counted[:2], counted[2:].sum(axis=0, keepdims=True)])
    assert counted.std(axis=(1, 2)).min() > 0.05
    # Both have a standard error of 0.01 at most.
    np.testing.assert_allclose(found, counted, atol=0.045)
    assert np.sqrt(np.mean((found - counted) ** 2)) < 0.014


def test_a_return_is_shared_by_area_and_brightness_and_only_within_its_range():
    density = np.zeros((2, 4, 1, 1))
    density[:, 3] = np.array([100.0, 300.0])[:, None, None]  # opaque: the top layer of both
    density[0, 0] = 100.0  # never reached
    rho = np.array([0.45, 0.3])
    scene = voxel_scene(
        jnp.asarray(density),
        jnp.asarray(rho[:, None]),
        jnp.array([[0.4], [0.1]]),
        voxel=(VOXEL, VOXEL, VOXEL),
        ground=jnp.array([0.3]),
        sun_zenith=30.0,
    )
    expected = np.array([100.0, 300.0]) * rho
    lidar = dataclasses.replace(scanner(), sample=100.0)
    found = shares(scene, lidar, columns=1, each=4)[:, 0, 0]
    np.testing.assert_allclose(found[:2], expected / expected.sum(), rtol=1e-5)
    together = shares(scene, lidar, groups=((0, 1),), columns=1, each=4)[:, 0, 0]
    np.testing.assert_allclose(together, [1.0, 0.0], atol=1e-6)
    # A return 3 m above all that is there is of noise: nothing has a share.
    beams, returns = straight_down(scene, 1, 4)
    short = dataclasses.replace(returns, distance=returns.distance - 4.0)
    species, ground = shares_of_returns(
        scene, scanner(), beams, short, ((0,), (1,)), key=jax.random.key(0)
    )
    assert not species.any()
    assert not ground.any()


@pytest.fixture(scope="module")
def table():
    return [dict(zip(COLUMNS, row, strict=True)) for row in SPECIES]


def test_plants_that_stand_alone_lead_in_all_returns_but_those_of_the_ground(table):
    scene = fx.Scene.from_table(table, size=2.0, voxel=0.25, structure="even", seed=3)
    lidar = scanner(pulse_density=500.0)
    cloud = fx.observe(scene, lidar, seed=4)
    truth = cloud.truth()
    np.testing.assert_allclose(truth.species.sum(axis=0) + truth.ground, 1.0, atol=1e-5)
    place = truth.leading()[0]
    np.testing.assert_array_equal(place == -1, truth.ground >= truth.species.max(axis=0))
    # What sent more to the echo's highest sample is what has the larger share about its range.
    ground = cloud.returns.classification == GROUND
    assert np.mean(ground == (truth.ground >= 0.5)) > 0.93
    assert 0.05 < ground.mean() < 0.95
    found = truth.to_xarray()
    assert found["leading_species"].attrs["flag_meanings"] == "none Erica logs Restio"
    np.testing.assert_allclose(found["species_share"].sum("species") + found["ground_share"], 1.0,
                               atol=1e-5)  # fmt: skip
    for i, name in enumerate(truth.taxa):
        alone = scene.with_values(
            {f"species.{other}.cover": 0.0 for other in truth.taxa if other != name}
        )
        own = fx.observe(alone, lidar, seed=4).truth()
        assert set(np.unique(own.leading()[0])) <= {-1, i}, name
        # Three logs of 25 cm voxels never have half of a return.
        np.testing.assert_array_equal(own.species.max(axis=1) > 0.4, np.arange(3) == i)
    # Those that cover more as seen from above lead more often.
    seen = np.asarray(fx.pixel_truth(scene, "mavic_3m", pixel=0.5).species).mean(axis=(1, 2))
    np.testing.assert_array_equal(
        np.argsort(np.bincount(place[place >= 0], minlength=3)), np.argsort(seen)
    )


def test_inside_a_transformation_there_are_no_returns(table):
    scene = fx.Scene.from_table(table, size=1.0, voxel=0.25, structure="even", seed=3)

    def truth(parameters):
        return fx.observe(scene, "scanning_lidar", parameters=parameters).truth().ground.sum()

    with pytest.raises(InputError, match="no single returns"):
        jax.grad(truth, allow_int=True)(scene.parameters)

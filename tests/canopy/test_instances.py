"""Standing plants on their sites: geometry by hand, areas, derivatives, common random numbers."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from fynjax._core.errors import InputError
from fynjax.canopy import (
    Organ,
    PlantModel,
    VoxelGrid,
    assign_sites,
    deposit,
    instance_area,
    instantiate,
    plant_model,
    poisson_disk,
    random_orientation,
    soft_count,
    soft_weights,
    stack_plants,
    target_area,
)
from tests.helpers import assert_gradients


def pointer() -> PlantModel:
    """A leaf at the north rim, a wooden top, a flower at the east rim."""
    return PlantModel(
        jnp.array([[0.0, 0.5, 0.5], [0.0, 0.0, 1.0], [0.5, 0.0, 0.0]]),
        jnp.ones(3),
        jnp.eye(3),
        jnp.array([Organ.LEAF, Organ.WOOD, Organ.FLOWER]),
    )


def test_azimuth_turns_clockwise_from_north_and_tilt_leans_there() -> None:
    site, one = np.array([[10.0, 20.0]]), np.ones(1)
    at, area, organ = instantiate(pointer(), site, 90.0 * one, one, 2.0, 3.0, 0.7, 0.2, 0.1)
    np.testing.assert_allclose(at, [[11, 20, 1.5], [10, 20, 3], [10, 19, 0]], atol=1e-12)
    np.testing.assert_allclose(area, [0.7, 0.2, 0.1])
    np.testing.assert_array_equal(organ, [0, 1, 2])
    at, *_ = instantiate(pointer(), site, 90.0 * one, one, 2.0, 3.0, 0.7, tilt=30.0 * one)
    np.testing.assert_allclose(at[1], [10 + 1.5, 20, 3 * np.sqrt(0.75)], atol=1e-12)
    # How far a tilt reaches sideways is what eq. (5) adds to the crown's radius.
    reach = float(jnp.sqrt(instance_area(2.0, 3.0, rotation_spread=30.0) / jnp.pi)) - 1.0
    assert float(at[1, 0] - 10.0) == pytest.approx(reach)


def test_turning_and_leaning_keep_distances() -> None:
    plant, one = plant_model("broad_leaved", 20, seed=0), np.ones(1)
    at, *_ = instantiate(
        plant, np.array([[5.0, 7.0]]), 77.0 * one, one, 1.0, 1.0, 1.0, tilt=25 * one
    )
    distance = lambda p: np.linalg.norm(p[:, None] - p[None], axis=-1)  # noqa: E731
    np.testing.assert_allclose(
        distance(np.asarray(at)), distance(np.asarray(plant.position)), atol=1e-12
    )


def test_sizes_and_areas_one_for_all_or_one_for_each() -> None:
    plant = plant_model("rounded_shrub", 30, seed=0)
    sites, turn = np.zeros((2, 2)), np.zeros(2)
    weight = np.array([1.0, 0.25])
    at, area, organ = instantiate(
        plant, sites, turn, weight, np.array([1.0, 2.0]), 1.5, np.array([3.0, 4.0]), 0.5, 0.1
    )
    np.testing.assert_allclose(at[30:, :2], 2.0 * at[:30, :2])
    np.testing.assert_allclose(at[30:, 2], at[:30, 2])
    for plant_number, leaf in ((0, 3.0), (1, 1.0)):
        part = np.s_[30 * plant_number : 30 * (plant_number + 1)]
        per_organ = np.bincount(organ[part], weights=area[part])
        np.testing.assert_allclose(
            per_organ, np.array([leaf, 0.5, 0.1]) * [1, weight[plant_number], weight[plant_number]]
        )


def test_stacked_plants_equal_one_call_each() -> None:
    models = [plant_model("rounded_shrub", 20, seed=0), plant_model("tussock", 20, seed=0)]
    kind = np.array([0, 1, 1, 0])
    sites = np.arange(8.0).reshape(4, 2)
    turn, size = np.array([0.0, 50.0, 120.0, 300.0]), np.array([0.2, 0.5, 0.6, 0.3])
    together = instantiate(
        stack_plants(models, kind), sites, turn, np.ones(4), size, 2 * size, size**2, 0.1, 0.2
    )
    for i in range(4):
        alone = instantiate(
            models[kind[i]], sites[i : i + 1], turn[i : i + 1], np.ones(1),
            size[i], 2 * size[i], size[i] ** 2, 0.1, 0.2,
        )  # fmt: skip
        for whole, part in zip(together, alone, strict=True):
            np.testing.assert_allclose(whole[20 * i : 20 * (i + 1)], part, rtol=1e-12, atol=1e-14)
    with pytest.raises(InputError, match="same number"):
        stack_plants([models[0], plant_model("tussock", 21, seed=0)], kind)


def test_single_precision_stays_single() -> None:
    plant = plant_model("climber", 10, seed=0)
    sites = np.zeros((3, 2), np.float32)
    at, area, _ = instantiate(
        plant, sites, np.zeros(3), np.ones(3), np.float64(0.5), 0.5, np.ones(3), tilt=np.zeros(3)
    )
    assert at.dtype == area.dtype == jnp.float32


def test_random_orientation() -> None:
    azimuth, tilt = random_orientation(4000, seed=1, rotation_spread=10.0)
    assert azimuth.min() >= 0.0
    assert azimuth.max() < 360.0
    counts, _ = np.histogram(azimuth, 8, (0, 360))
    assert np.abs(counts - 500).max() < 4 * np.sqrt(500)
    assert np.sqrt(np.mean(tilt**2)) == pytest.approx(10.0, rel=0.04)
    np.testing.assert_array_equal(azimuth[:7], random_orientation(7, seed=1)[0])
    np.testing.assert_array_equal(random_orientation(7, seed=1)[1], 0.0)
    with pytest.raises(InputError, match="radians"):
        instantiate(
            plant_model("climber", 3, seed=0), np.zeros((4000, 2)), np.radians(azimuth),
            np.ones(4000), 1.0, 1.0, 1.0,
        )  # fmt: skip


GRID = VoxelGrid.cover((3.0, 3.0), 1.2, 0.5, 0.3)
FORMS = ("rounded_shrub", "upright_ericoid", "deadwood")
SITES = assign_sites(poisson_disk((3.0, 3.0), 0.1, seed=0, periodic=True), [60, 60, 60], seed=1)
MODELS = [plant_model(form, 24, seed=i) for i, form in enumerate(FORMS)]
TURNS = [random_orientation(60, seed=i, rotation_spread=1.0) for i in range(3)]


def small_scene(parameters: dict[str, jax.Array], width: float = 1.0) -> jax.Array:
    """Area density [species, z, y, x] of three species on 3 m x 3 m."""
    density = []
    for s in range(3):
        diameter, height = parameters["diameter"][s], parameters["height"][s]
        terms = (parameters[name] for name in ("spread", "packing", "fill"))
        each = instance_area(diameter, height, *terms)
        count = soft_count(target_area(9.0, parameters["cover"][s]), each)
        azimuth, unit_tilt = TURNS[s]
        at, area, _ = instantiate(
            MODELS[s], SITES[s], azimuth, soft_weights(count, 60, width=width), diameter, height,
            parameters["leaf"] * diameter**2, 0.3 * diameter**2, 0.01,
            tilt=parameters["spread"] * unit_tilt,
        )  # fmt: skip
        density.append(deposit(at, area, jnp.zeros(at.shape[0], int), GRID, 1)[0])
    return jnp.stack(density)


def parameters() -> dict[str, jax.Array]:
    return {
        "cover": jnp.array([0.203, 0.11, 0.077]),
        "diameter": jnp.array([0.43, 0.31, 0.52]),
        "height": jnp.array([0.71, 1.13, 0.4]),
        "packing": jnp.array(0.07),
        "fill": jnp.array(0.83),
        "spread": jnp.array(6.0),
        "leaf": jnp.array(2.1),
    }


def test_gradients_of_a_scene() -> None:
    """From every parameter of the table to a nonlinear figure of the grid."""
    assert_gradients(
        jax.jit(lambda p: jnp.sum(1.0 - jnp.exp(-0.3 * small_scene(p)), axis=(1, 2, 3))),
        parameters(),
        rtol=1e-5,
    )


def test_area_on_the_grid_follows_the_cover() -> None:
    p = parameters()
    total = small_scene(p).sum((1, 2, 3)) * GRID.voxel_volume
    for s in range(3):
        one = instance_area(p["diameter"][s], p["height"][s], p["spread"], p["packing"], p["fill"])
        count = 9.0 * p["cover"][s] / one
        wood, leaf = 0.3 * p["diameter"][s] ** 2, 2.1 * p["diameter"][s] ** 2
        per_plant = wood if FORMS[s] == "deadwood" else leaf + wood + 0.01
        assert float(total[s]) == pytest.approx(float(count * per_plant), rel=1e-10)


def test_no_cover_has_no_area_and_a_finite_slope() -> None:
    p = parameters() | {"cover": jnp.zeros(3)}
    np.testing.assert_array_equal(small_scene(p), 0.0)
    slope = jax.jit(
        jax.grad(lambda p: jnp.sum(small_scene(p) * jnp.arange(3.0)[:, None, None, None]))
    )(p)
    assert all(np.all(np.isfinite(leaf)) for leaf in jax.tree.leaves(slope))
    assert float(slope["cover"][1]) > 0.0


def test_a_species_cover_does_not_move_another_species() -> None:
    before = small_scene(parameters())
    changed = parameters() | {"cover": jnp.array([0.29, 0.11, 0.077])}
    after = small_scene(changed)
    np.testing.assert_array_equal(before[1:], after[1:])
    assert not np.array_equal(before[0], after[0])
    # And its own plants stay where they were: more are added, none is moved.
    assert float((after[0] - before[0]).min()) > -1e-12

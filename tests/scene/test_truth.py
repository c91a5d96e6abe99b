"""Shares of species in pixels: what the stand has, in the pixels and blur of the image."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import fynjax as fx
from fynjax.errors import InputError

COLUMNS = "taxon", "growth_form", "mean_diameter_cm", "cover_percent", "height_max_m"
SPECIES = (
    ("Erica", "rounded_shrub", 40, 40, 0.6),
    ("logs", "deadwood", 40, 10, 0.3),
    ("Restio", "tussock", 30, 20, 0.5),
)


@pytest.fixture(scope="module")
def scene():
    table = [dict(zip(COLUMNS, row, strict=True)) for row in SPECIES]
    return fx.Scene.from_table(table, size=2.0, voxel=0.25, structure="even", seed=3)


@pytest.fixture(scope="module")
def truth(scene):
    return fx.pixel_truth(scene, "mavic_3m", pixel=0.25)


def test_shares_of_a_pixel_sum_to_one_and_ground_is_the_gap(scene, truth):
    ground = truth.sunlit_ground + truth.shaded_ground
    np.testing.assert_allclose(truth.species.sum(axis=0) + ground, 1.0, atol=1e-5)
    # The gap is that of straight down, the camera's view is a little slanted.
    assert float(ground.mean()) == pytest.approx(
        float(scene.gap_fraction(scene.parameters)), abs=0.01
    )


def test_species_are_where_they_stand_and_logs_are_wood(scene, truth):
    assert float(truth.live[1].max()) == float(truth.dead[1].max()) == 0.0 < truth.wood[1].max()
    dead = scene.parameters.species.dead_fraction[0]
    np.testing.assert_allclose(truth.dead[0], dead * (truth.live[0] + truth.dead[0]), atol=1e-6)
    # Without the others each is seen where it stood, and by more where they hid it.
    for i, name in enumerate(truth.taxa):
        alone = scene.with_values(
            {f"species.{other}.cover": 0.0 for other in truth.taxa if other != name}
        )
        seen = fx.pixel_truth(alone, "mavic_3m", pixel=0.25).species
        assert float(jnp.delete(seen, i, axis=0).max()) == 0.0
        np.testing.assert_array_less(truth.species[i], seen[i] + 1e-5)


def test_wider_pixels_are_means_of_narrow_ones_without_blur(scene):
    fine, coarse = (
        fx.pixel_truth(scene, "mavic_3m", pixel=p, point_spread=False) for p in (0.5, 1.0)
    )
    means = np.asarray(fine.species).reshape(3, 2, 2, 2, 2).mean(axis=(2, 4))
    np.testing.assert_allclose(coarse.species, means, atol=1e-6)


def test_the_leading_species_and_the_dataset(truth):
    place, share = truth.leading()
    np.testing.assert_array_equal(
        np.asarray(truth.species).argmax(axis=0)[share > 0], place[share > 0]
    )
    found = truth.to_xarray()
    assert found["live"].sel(species="Erica").attrs["units"] == "1"
    assert found["live"].attrs["long_name"] == "share of the pixel that is live leaf of a species"
    assert found["leading_species"].attrs["flag_meanings"] == "none Erica logs Restio"
    bare = dataclasses.replace(
        truth, **dict.fromkeys(("live", "dead", "wood", "flowers"), 0 * truth.live)
    )
    assert (bare.leading()[0] == -1).all()
    assert "see Erica" in str(truth)


def test_the_slope_is_that_of_the_shares_and_of_more_plants(scene):
    def seen(p, value, scene):
        leaf_area = dataclasses.replace(
            p.species, leaf_area_index=p.species.leaf_area_index * value
        )
        return fx.pixel_truth(
            scene, "mavic_3m", pixel=0.5, parameters=dataclasses.replace(p, species=leaf_area)
        ).live.mean(axis=(1, 2))[0]

    both = eqx.filter_jit(jax.value_and_grad(seen, argnums=(0, 1)))
    p, step = scene.parameters, 0.02
    up, down = (both(p, jnp.asarray(1 + s), scene)[0] for s in (step, -step))
    _, (by_plot, by_value) = both(p, jnp.asarray(1.0), scene)
    # Leaf area is shared with plants that fade, whose slope is up to 3 % another.
    assert by_value == pytest.approx(float(up - down) / (2 * step), rel=1e-2)
    assert by_plot.species.cover[0] > 0 > by_plot.species.cover[2]


def test_room_for_plants_that_never_stand_changes_nothing(scene, truth):
    """And scenes of other numbers of plants have the same shapes, which compile once."""
    padded = scene.padded()
    found = fx.pixel_truth(padded, "mavic_3m", pixel=0.25)
    for one, other in zip(jax.tree.leaves(found), jax.tree.leaves(truth), strict=True):
        np.testing.assert_allclose(one, other, atol=1e-6)
    image = fx.observe(padded, "mavic_3m", pixel=0.25)["nir"]
    np.testing.assert_allclose(image, fx.observe(scene, "mavic_3m", pixel=0.25)["nir"], atol=1e-6)

    def shapes(cover):
        table = [dict(zip(COLUMNS, row, strict=True)) for row in SPECIES]
        table[0]["cover_percent"] = cover
        more = fx.Scene.from_table(table, size=2.0, voxel=0.25, structure="even", seed=3)
        return [np.shape(leaf) for leaf in jax.tree.leaves(more.padded())]

    sizes = scene.planting.sizes
    room = (sizes[0] + 1, sizes[1] + 500, sizes[2])
    wider = fx.observe(scene.padded(room), "mavic_3m", pixel=0.25)["nir"]
    np.testing.assert_allclose(wider, image, atol=1e-6)
    for few in ((sizes[0], *room[1:]), (*room[:2], sizes[2] - 1)):
        with pytest.raises(
            InputError, match=f"at least {sizes[0] + 1} plants, {sizes[1]} elements"
        ):
            scene.padded(few)
    plants = scene.planting.plants(np.arange(len(scene.planting.species)))
    assert plants.padded() is plants  # its elements are not listed: too many for images at once
    assert shapes(40) == shapes(38) == [np.shape(leaf) for leaf in jax.tree.leaves(padded)]


def test_a_lidar_has_no_pixels(scene):
    with pytest.raises(InputError, match="expected a sensor"):
        fx.pixel_truth(scene, "scanning_lidar")

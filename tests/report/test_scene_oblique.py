"""The pictures of a scene against what they should show: places, areas, ground."""

import numpy as np
import pytest

from fynjax.app.assembly import build_plot
from fynjax.app.io.plot import example_folder, read_plot
from fynjax.app.jobs._build import drawn_plants
from fynjax.app.report.figures import DrawnPlants
from fynjax.app.report.figures._scene import (
    _AREAS,
    BARK,
    GROUND,
    element_points,
    from_above,
    rgb,
    sides,
    species_colours,
)
from fynjax.app.report.figures._scene_oblique import View, height_at, relief
from fynjax.canopy import FORMS, Organ, plant_model
from fynjax.scene import Instances, hard_instances, hard_scene, individual_seeds

EXTENT = (4.0, 2.0)
EAST, NORTH = 0.3, 0.1


def plane(x, y):
    return EAST * x + NORTH * y


def on_a_slope() -> tuple[Instances, np.ndarray]:
    """Two plants on a plane, and its height in cells of 10 cm."""
    x, y = np.array([1.0, 3.0]), np.array([0.5, 1.5])
    none = np.zeros(2)
    plants = Instances(
        ("a",), EXTENT, np.zeros(2, int), x, y, plane(x, y), none, none,
        np.array([0.3, 0.5]), np.array([0.8, 0.6]),
    )  # fmt: skip
    column, row = (np.arange(40) + 0.5) * 0.1, (np.arange(20) + 0.5) * 0.1
    return plants, plane(column, row[:, None])


UP = np.array([0.0, 0.0, 1.0])


def drawn(plants: Instances, form: str, area: tuple[float, float, float], **other) -> DrawnPlants:
    """Plants of one growth form with areas of leaves, wood and flowers over their crowns."""
    given = {"dead": np.zeros(1), "models": [None], "seed": 0}
    return DrawnPlants(plants, [form], np.array([area]), **(given | other))


def test_stems_of_a_column_are_drawn_as_beads_of_their_width():
    plants, _ = on_a_slope()
    stated = drawn(plants, "column", (2.5, 0.0, 0.0))
    _, _, area = element_points(stated, 300.0, UP)
    disc = np.pi / 4 * np.mean(plants.diameter**2)
    assert len(area) / 2 == pytest.approx(disc * 2.5 / (np.pi / 4 * 0.038**2), rel=0.02)


def test_plants_are_drawn_where_they_stand():
    plants, _ = on_a_slope()
    place, _, _ = element_points(drawn(plants, "rounded_shrub", (4.0, 0.5, 0.0)), 300.0, UP)
    for one, points in enumerate(np.split(place, 2)):
        low, high = points[:, 2].min(), points[:, 2].max()
        height = plants.height[one]
        assert low == pytest.approx(plants.z[one], abs=0.15 * height)
        assert high == pytest.approx(plants.z[one] + height, abs=0.1 * height)


def test_the_ground_is_drawn_as_the_plane_that_it_is():
    plants, ground = on_a_slope()
    place, light, area = relief(plants.extent, View(EXTENT, 2.0), ground)
    assert len(place) == len(light) == len(area)
    x, y, z = place.astype(float).T
    inner = (x > 0.06) & (x < 3.94) & (y > 0.06) & (y < 1.94)
    np.testing.assert_allclose(z[inner], plane(x[inner], y[inner]), atol=1e-5)
    assert np.all(z <= plane(x, y) + 0.06)  # the faces hang below the edges
    beside = np.array([-1.0, 9.0])
    np.testing.assert_allclose(
        height_at(ground, EXTENT, beside, np.full(2, 1.0)), plane(np.array([0.05, 3.95]), 1.0)
    )
    assert np.all(height_at(None, EXTENT, x, y) == 0.0)


@pytest.mark.parametrize("form", [f for f, d in FORMS.items() if d.leaf_area_index > 0])
def test_points_show_the_area_that_leaves_turn_to_the_eye(form):
    """Area over the crowns, times the mean |cosine| of their elements; pixels in disc."""
    plants, _ = on_a_slope()
    facing = []
    for seed in individual_seeds(0, 0)[: len(plants.diameter)]:
        shape = plant_model(form, 9000, seed=seed)
        leaf = np.asarray(shape.organ) == Organ.LEAF
        facing.append(np.abs(np.asarray(shape.normal)[leaf, 2]).mean())
    _, _, area = element_points(drawn(plants, form, (3.0, 0.0, 0.0)), 300.0, UP)
    crowns = np.pi / 4.0 * plants.diameter**2
    assert area.sum() == pytest.approx(3.0 * (crowns * facing).sum(), rel=0.03)
    pixels = _AREAS[sides(area * 300.0**2)].sum()
    assert pixels == pytest.approx(area.sum() * 300.0**2, rel=0.05)


@pytest.mark.parametrize("organ", Organ)
def test_only_organs_with_area_are_drawn(organ):
    """All points have the hue of the only organ with area: the species', that of bark, or pale."""
    plants, _ = on_a_slope()
    areas = 3.0 * (np.arange(len(Organ)) == organ)
    _, tint, _ = element_points(drawn(plants, "upright_ericoid", tuple(areas)), 300.0, UP)
    own = rgb(species_colours(["upright_ericoid"])[0])
    hue = {Organ.LEAF: own, Organ.WOOD: rgb(BARK), Organ.FLOWER: 0.35 * own + 0.65}[organ]
    bright = tint.sum(axis=1, keepdims=True)
    np.testing.assert_allclose(tint / bright, np.tile(hue / hue.sum(), (len(tint), 1)), atol=1e-5)
    none = drawn(plants, "upright_ericoid", (0.0, 0.0, 0.0))
    assert len(element_points(none, 300.0, UP)[0]) == 0


def test_dead_tissue_and_flowers_have_colours_of_their_own():
    plants, _ = on_a_slope()

    def hue(areas, dead):
        _, tint, _ = element_points(
            drawn(plants, "rounded_shrub", areas, dead=np.array([dead])), 300.0, UP
        )
        return tint.mean(axis=0) / tint.mean()

    green = hue((3.0, 0.0, 0.0), 0.0)
    assert green[1] > 1.5 * green[0]
    half, all_dead = hue((3.0, 0.0, 0.0), 0.5), hue((3.0, 0.0, 0.0), 1.0)
    assert green[0] < half[0] < all_dead[0]
    assert hue((0.0, 0.0, 1.0), 0.0)[0] > green[0]


def test_a_plant_of_its_own_shape_is_drawn_as_that():
    plants, _ = on_a_slope()
    own = plant_model("climber", 40, seed=3)
    place, _, _ = element_points(
        drawn(plants, "rounded_shrub", (3.0, 0.0, 0.0), models=[own]), 300.0, UP
    )
    first = (place[:40] - [plants.x[0], plants.y[0], plants.z[0]]) / [0.3, 0.3, 0.8]
    np.testing.assert_allclose(first, np.asarray(own.position), atol=1e-5)


def test_as_much_ground_shows_from_above_as_the_scene_says():
    """Two ways to the gap: pixels of a picture, and light through columns of 2.5 cm, in which the
    scene spreads foliage over tufts of 5 cm and so hides a little of the ground."""
    plot = read_plot(example_folder() / "plot.toml")
    plot = plot.replace(size_m=(1.0, 1.0))
    scene, parameters = build_plot(plot)
    instances, hard = hard_instances(scene, parameters), hard_scene(scene, parameters)
    plants = drawn_plants(plot, hard, parameters, instances, plot.seed)
    image = from_above(plants, 0.004, periodic=True)
    ground = np.all(image == rgb(GROUND), axis=-1).mean()
    assert ground == pytest.approx(float(hard.gap_fraction(parameters)), abs=0.06)

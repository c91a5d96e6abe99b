"""Projected cover: as many plants as lie over the share of the ground that is asked for.

Crowns are counted here on a fine grid, plant after plant, over many plantings.
"""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from fynjax._core.errors import InputError
from fynjax.canopy import clumping, projected_count
from fynjax.inversion import free_space
from fynjax.scene import (
    PlantingRules,
    PlotParameters,
    Scene,
    Species,
    build_scene,
    hard_instances,
    projected_cover,
)
from tests.scene.plots import small_parameters

ASKED = np.array([0.01, 0.05, 0.2, 0.45, 0.7, 0.95])
DIAMETER = (0.9, 0.4, 0.15)
CELL = 0.025


def _patches() -> np.ndarray:
    """Two thirds of the plot with plants, in patches, half of them sparse."""
    y, x = np.mgrid[:48, :48] // 8
    return np.choose((x + 2 * y) % 3, [0, 80, 255]).astype(np.uint8)


def _scene(size: float, cover: float, diameters=DIAMETER, **options) -> Scene:
    parameters = jax.tree.map(lambda v: v[:1] if v.ndim else v, small_parameters())
    alike = lambda v: jnp.full(len(diameters), v)  # noqa: E731
    species = dataclasses.replace(
        jax.tree.map(lambda v: alike(v[0]), parameters.species),
        cover=alike(cover), packing=alike(0.0), fill=alike(1.0), diameter=jnp.array(diameters),
    )  # fmt: skip
    rules = {"structure": "even", "cover_definition": "projected"} | options.pop("rules", {})
    return build_scene(
        [Species(f"species {d}", "rounded_shrub") for d in diameters],
        dataclasses.replace(
            parameters,
            species=species,
            leaf=jax.tree.map(lambda v: alike(jnp.ravel(v)[0]), parameters.leaf),
        ),
        extent=(size, size), voxel=0.5, seed=5, dtype="float64", rules=PlantingRules(**rules),
        **options,
    )  # fmt: skip


def _covered(scene: Scene, plantings: int) -> list[list[np.ndarray]]:
    """Share of the ground under the first 0, 1, 2, ... plants of each species, for each planting:
    cells whose centres lie in a crown, one by one."""
    size, found = scene.grid.extent[0], [[] for _ in scene.taxa]
    centre = (np.arange(round(size / CELL)) + 0.5) * CELL
    diameter = np.asarray(scene.parameters.species.diameter)
    for number in range(plantings):
        planting = scene.realisation(number + 1).planting
        order = np.argsort(np.asarray(planting.place), kind="stable")
        for one, radius in enumerate(diameter / 2.0):
            mine = order[np.asarray(planting.species)[order] == one]
            free, shares = np.ones((centre.size, centre.size), bool), [0.0]
            for x, y, r in zip(*np.asarray(planting.foot)[mine].T, radius * planting.size[mine]):
                across, along = np.abs(centre - x), np.abs(centre - y)
                if scene.boundary == "periodic":
                    across, along = (np.minimum(d, size - d) for d in (across, along))
                rows, columns = np.flatnonzero(along < r), np.flatnonzero(across < r)
                under = along[rows, None] ** 2 + across[columns] ** 2 < float(r) ** 2
                block = np.ix_(rows, columns)
                shares.append(shares[-1] + np.count_nonzero(free[block] & under) / free.size)
                free[block] &= ~under
            found[one].append(np.array(shares))
    return found


def _with_cover(scene: Scene, covers) -> PlotParameters:
    return eqx.tree_at(lambda p: p.species.cover, scene.parameters, jnp.broadcast_to(covers, 3))


@pytest.mark.parametrize(
    ("options", "most"),
    [
        ({}, 0.95),
        pytest.param({"boundary": "open"}, 0.95, marks=pytest.mark.study),
        pytest.param({"rules": {"probability": _patches()}}, 0.45, marks=pytest.mark.study),
        ({"rules": {"probability": _patches()}, "boundary": "open"}, 0.45),
    ],
    ids=["periodic", "open", "clumped", "clumped and open"],
)
def test_the_mean_cover_of_plantings_is_what_was_asked(options: dict, most: float) -> None:
    """Within 2 % of it and three standard errors, for three sizes of crowns, from 1 to 95 % of the
    ground; crowns at random would be off by a tenth where they are small."""
    plantings = 10
    scene = _scene(3.0, 0.7 * most, **options)
    found, checked = _covered(scene, plantings), 0
    for asked in ASKED[most >= ASKED]:
        for count, covered in zip(np.asarray(scene.counts(_with_cover(scene, asked))), found):
            if count > min(map(len, covered)) - 1:  # no sites for so many
                continue
            # Whole plants, the next lower number or the next higher one: a line between.
            got = [np.interp(count, np.arange(len(c)), c) for c in covered]
            error = np.std(got) / np.sqrt(plantings)
            assert abs(np.mean(got) - asked) < 0.02 * asked + 3.0 * error
            checked += 1
    assert checked > 2.5 * np.count_nonzero(most >= ASKED)


def test_the_slope_of_the_number_is_that_of_the_cover_that_is_planted() -> None:
    """By cover and by diameter: differences of the number, and one more plant on the grid."""
    scene, asked = _scene(3.0, 0.42), jnp.array([0.3, 0.4, 0.5])
    species = scene.parameters.species

    def counts(cover, diameter):
        fields = lambda p: (p.species.cover, p.species.diameter)  # noqa: E731
        return scene.counts(eqx.tree_at(fields, scene.parameters, (cover, diameter)))

    at, step = (asked, species.diameter), 1e-6
    for i in range(2):
        slope = np.diag(jax.jacrev(counts, i)(*at))
        ends = [counts(*(v + s * step * (j == i) for j, v in enumerate(at))) for s in (1, -1)]
        np.testing.assert_allclose(slope, (ends[0] - ends[1]) / (2 * step), rtol=1e-4)
    slope = np.diag(jax.jacfwd(counts)(*at))
    for number, each, covered in zip(np.asarray(counts(*at)), slope, _covered(scene, 10)):
        near = [max(number - 0.3 * number, 0.0), number + 0.3 * number]
        ends = [np.interp(near, np.arange(len(c)), c) for c in covered]
        one_more = np.mean(np.diff(ends, axis=1)) / np.ptp(near)
        assert one_more * each == pytest.approx(1.0, abs=0.06 if number > 20 else 0.2)


def test_the_slope_of_the_gap_is_that_of_its_mean_over_plantings() -> None:
    """By projected covers: of the expected stand, a difference of means."""
    scene, step = _scene(3.0, 0.4), 0.2
    gap = eqx.filter_jit(lambda scene, x: scene.gap_fraction(_with_cover(scene, 0.4 * jnp.exp(x))))
    slope = eqx.filter_jit(jax.grad(lambda x, scene: gap(scene, x)))
    plantings = [scene.reordered(seed) for seed in range(30)]
    slopes = np.array([slope(jnp.zeros(()), one) for one in plantings])
    ends = [np.array([gap(one, s * step) for one in plantings]) for s in (1.0, -1.0)]
    differences = (ends[0] - ends[1]) / (2 * step)
    error = np.hypot(*(x.std() / np.sqrt(len(x)) for x in (slopes, differences)))
    assert error < 0.05 * abs(slopes.mean())
    assert abs(slopes.mean() - differences.mean()) < 2.5 * error


def test_crowns_at_the_edges_of_an_open_plot() -> None:
    """Of a disc of half a metre: within 4 m it lies in closed form of the mean over the plot, a
    quarter of it at a corner."""
    parts = clumping(None, (4.0, 4.0), 1.0, periodic=False)
    within = 1.0 - (4.0 / 3.0 * 0.5**3 * 0.5 - 0.5**4 / 32.0) / (np.pi * 0.25)
    assert parts.mean() == pytest.approx(1.0)
    assert parts.max() == pytest.approx(1.0 / within, rel=0.01)
    assert 0.3 / within < parts.min() < 0.55 / within
    np.testing.assert_allclose(clumping(None, (4.0, 4.0), 1.0, periodic=True), 1.0)


@pytest.mark.parametrize("factor", [1.0, 1.15])
def test_one_species_that_grows_beyond_its_sites_covers_what_is_asked(factor: float) -> None:
    """Its further plants stand on spare sites, nearer to each other than the first are; with the
    distance of those for all of them it would cover 4 % too much."""
    row = {"taxon": "a", "growth_form": "rounded_shrub", "mean_diameter_cm": 25,
           "cover_percent": 55, "height_max_m": 0.5}  # fmt: skip
    scene = Scene.from_table([row], size=2.4, voxel=0.2, structure="even", seed=3)
    more = scene.scaled({"species.*.cover": factor}).parameters
    found = [
        projected_cover(hard_instances(scene.realisation(k), more), cell=0.02).species[0]
        for k in range(12)
    ]
    assert np.mean(found) == pytest.approx(0.55 * factor, rel=0.025)


def test_single_large_crowns_and_none() -> None:
    """Of a crown that covers a fifth of the plot there is one in every second planting, to cover a
    tenth; no cover needs no plant, with a slope."""
    crown = jnp.asarray(0.2)
    assert float(projected_count(0.1, crown, 1.0)) == pytest.approx(0.5, rel=1e-3)
    assert float(projected_count(0.2 + 0.5 * 0.16, crown, 1.0)) == pytest.approx(1.5, rel=1e-3)
    assert float(projected_count(0.0, crown, 1.0)) == 0.0
    assert float(jax.grad(lambda c: projected_count(c, crown, 1.0))(0.0)) == pytest.approx(
        5.0, rel=1e-3
    )
    dense = jnp.array([0.1, 0.1, 2.8])  # the mean of what the thirds leave free
    count = projected_count(jnp.asarray(0.5), 1.0, 1e5, clumping=dense)
    assert float(jnp.mean(jnp.exp(-count * dense / 1e5))) == pytest.approx(0.5, abs=1e-4)
    for most in (0.99, 1.0):
        count = projected_count(jnp.asarray(most), 1e-3, 1.0)
        assert float(count) == pytest.approx(np.log(0.01) / np.log(1 - 1e-3), rel=1e-3)


ROWS = [
    {"taxon": "Calluna vulgaris", "growth_form": "rounded_shrub", "mean_diameter_cm": 40,
     "cover_percent": 45, "height_max_m": 0.5},
    {"taxon": "Molinia caerulea", "growth_form": "tussock", "mean_diameter_cm": 30,
     "cover_percent": 20, "height_max_m": 0.6},
]  # fmt: skip


@pytest.mark.parametrize(
    ("change", "column", "word"),
    [
        ({"packing_percent": 20}, "packing_percent", "overlap is counted as it is planted"),
        ({"fill_percent": 80}, "fill_percent", 'cover_definition = "article"'),
        ({"branches": 3}, "branches", "Molinia caerulea"),
        ({"minimum_object_area_m2": 0.1}, "minimum_object_area_m2", "eq"),
        ({"cover_percent": 99.5}, "cover_percent", "99.5 % .* cover 99 % at most"),
    ],
)
def test_what_has_no_place_beside_projected_covers_is_refused(change, column, word) -> None:
    rows = [ROWS[0], ROWS[1] | change]
    with pytest.raises(InputError, match=word) as error:
        Scene.from_table(rows, size=2.0, cover_definition="projected")
    assert (error.value.row, error.value.column) == (2, column)
    if column != "cover_percent":  # by itself the table then is the article's
        scene = Scene.from_table(rows, size=2.0, voxel=0.5, structure="even")
        assert scene.rules.cover_definition == "article"


def test_where_the_map_has_no_plants_they_cover_nothing() -> None:
    """Of three metres the western 1.2 have none; small crowns reach 7.5 cm into it."""
    west = np.where(np.arange(60) < 24, 0, 255)[None].repeat(60, axis=0)
    with pytest.raises(InputError, match=r"0\.15 is to cover 70 % .* cover 6[45]\.?\d* % at most"):
        _scene(3.0, 0.7, rules={"probability": west})


def test_a_table_is_projected_unless_it_is_said() -> None:
    """45 % asked is less of the ground if it is the article's sum of crowns, but more than the 36 %
    of crowns at random."""
    planted = {}
    for definition in ("projected", "article"):
        scene = Scene.from_table(
            ROWS, size=12.0, voxel=0.5, structure="even", seed=2, cover_definition=definition
        )
        plants = hard_instances(scene, scene.parameters)
        planted[definition] = projected_cover(plants, cell=0.02).species
    scene = Scene.from_table(ROWS, size=2.0, voxel=0.5, structure="even")
    assert scene.rules.cover_definition == "projected"
    fitted = free_space(
        scene,
        scene.parameters,
        ["species.*.cover", "species.*.packing", "species.*.fill"],
        lambda _: 0.2,
    ).names
    assert fitted == tuple(f"species.{row['taxon']}.cover" for row in ROWS)
    np.testing.assert_allclose(planted["projected"], [0.45, 0.2], rtol=0.05)
    assert 1.1 * (1.0 - np.exp(-0.45)) < planted["article"][0] < 0.95 * 0.45
    assert 1.02 * (1.0 - np.exp(-0.2)) < planted["article"][1] < 1.01 * 0.2

"""Structure metrics of voxels against those of drawn clouds, and finite differences."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from fynjax._core.errors import InputError
from fynjax.metrics.structure import (
    STRUCTURE_METRICS,
    StructureSettings,
    bin_returns,
    cell_grid,
    cell_structure,
    voxel_height_percentiles,
    voxel_structure,
)
from tests.helpers import assert_gradients
from tests.metrics.structure_clouds import LOW_PRESETS

OF_AREA = replace(StructureSettings(), diversity_of="leaf_area", top="plot")
CONVENTIONS = {**LOW_PRESETS, "of area": OF_AREA}
# Compiling is what these tests cost: the other conventions are left to the studies.
SOME = [
    pytest.param(name, marks=() if name in ("fynjax", "of area") else pytest.mark.study)
    for name in CONVENTIONS
]


def voxels(density, settings, **options):
    run = jax.jit(lambda d: voxel_structure(d, settings, **options))
    return run(jnp.asarray(density))


def shrubs(seed: int = 3):
    """Area density of blobs on 4 m x 4 m x 1.6 m in voxels of 10 cm."""
    rng = np.random.default_rng(seed)
    density = np.zeros((16, 40, 40))
    z, y, x = (0.1 * (np.indices(density.shape) + 0.5)[i] for i in range(3))
    for _ in range(30):
        (cx, cy), r = rng.uniform(0.0, 4.0, 2), rng.uniform(0.2, 0.6)
        tall = r * rng.uniform(0.8, 2.2)
        inside = ((x - cx) ** 2 + (y - cy) ** 2) / r**2 + (2 * z / tall - 1) ** 2 < 1
        density[inside] = np.maximum(density[inside], rng.uniform(1.0, 5.0))
    return density


def drawn(density, pulses, rng):
    """Heights of the first thing that even pulses from above hit, with G = 0.5."""
    number = int(pulses * 16.0)
    x, y = rng.uniform(0.0, 4.0, (2, number))
    columns = density[::-1, (y / 0.1).astype(int), (x / 0.1).astype(int)] * 0.1
    depth = rng.exponential(2.0, number)  # area met before the hit
    above = np.cumsum(columns, axis=0)
    hit = (above > depth).argmax(axis=0)
    none = above[-1] <= depth
    inside = columns[hit, np.arange(number)]
    left = above[hit, np.arange(number)] - depth
    height = 0.1 * (15 - hit + np.where(none, 0.0, left / np.where(none, 1.0, inside)))
    return x, y, np.where(none, 0.0, height)


@pytest.mark.parametrize(("pulses", "bound"), [(40.0, 0.06), (693.0, 0.02)])
@pytest.mark.parametrize("name", [*SOME, pytest.param("canopy", marks=pytest.mark.study)])
def test_voxels_against_drawn_clouds(name, pulses, bound) -> None:
    """Means over cells, against the mean of drawn clouds, which has its own error of 1 % or so."""
    gap_of_canopy = replace(StructureSettings(), gap_of="canopy", cv_lowest=0.25, degrees_lost=0)
    settings = CONVENTIONS.get(name, gap_of_canopy)
    layers = int(np.ceil((1.6 - settings.base) / settings.layer - 1e-9))
    density = shrubs()
    found = voxels(
        density, settings, voxel=(0.1, 0.1), grain=2.0, pulses=pulses, layers=layers
    ).means()
    rng, grid = np.random.default_rng(0), cell_grid((0, 0, 4, 4), 2.0)
    rounds = [
        cell_structure(bin_returns(*drawn(density, pulses, rng), grid, settings)).means()
        for _ in range(60 if pulses < 100 else 12)
    ]
    for metric in STRUCTURE_METRICS:
        values = np.array([one[metric] for one in rounds])
        values = values[np.isfinite(values)]
        if metric == "leaf_area_density_std" and name == "GEDI L2B" and not values.size:
            continue  # plants are no taller than one layer of it and a bit
        mean, error = values.mean(), values.std() / np.sqrt(values.size)
        allowed = bound * mean + 3.0 * error + 0.002
        assert abs(float(found[metric]) - mean) < allowed, metric


def test_voxels_of_a_uniform_slab() -> None:
    """Beer and Lambert on whole and cut voxels: the density comes back, and so does the gap."""
    settings = StructureSettings(layer=0.25, lowest=0.25, diversity_lowest=0.25)
    density = jnp.full((10, 4, 4), 1.6).at[8:].set(0.0)  # to 0.8 m: layers end at 0.75 and 1 m
    found = voxels(
        density, replace(settings, top="plot"), voxel=(0.5, 0.1), grain=2.0, pulses=1e4, layers=3
    )
    mean = (1.6 + 1.6 + 1.6 * 0.2) / 3
    np.testing.assert_allclose(found.metrics["leaf_area_density_mean"], mean, rtol=1e-3)
    np.testing.assert_allclose(found.metrics["gap_fraction"], np.exp(-0.8 * 0.7), rtol=1e-9)
    # A return from z above the floor of the slab: 1 - exp(-0.8 (0.8 - z)) of them are higher.
    z = np.linspace(0.0, 0.8, 20_001)
    higher = 1.0 - np.exp(-0.8 * (0.8 - z))
    mean, square = np.trapezoid(higher, z), np.trapezoid(2 * z * higher, z)
    cv = np.sqrt(square - mean**2) / mean
    np.testing.assert_allclose(found.metrics["height_cv"], cv, rtol=1e-3)
    # On ground that is 0.1 m up, all is 0.1 m lower, with a tenth of a metre of slab less.
    raised = voxels(
        density, settings, voxel=(0.5, 0.1), grain=2.0, pulses=1e4, layers=3,
        ground=jnp.full((4, 4), 0.1),
    )  # fmt: skip
    np.testing.assert_allclose(raised.metrics["gap_fraction"], np.exp(-0.8 * 0.6), rtol=1e-9)


def test_a_cell_counts_by_the_chance_that_it_is_defined() -> None:
    """Of two expected returns in a cell, a coefficient of variation needs another one: the chance
    of at least one of one expected, 1 - 1 / e."""
    found = voxels(
        jnp.ones((8, 4, 4)), StructureSettings(), voxel=(0.5, 0.1), grain=2.0, pulses=0.5, layers=3
    )
    np.testing.assert_allclose(found.defined["height_cv"], 1.0 - np.exp(-1.0), rtol=1e-9)
    np.testing.assert_allclose(found.defined["gap_fraction"], 1.0)


def test_percentiles_of_height_are_those_of_drawn_first_hits() -> None:
    """Pulses that meet leaves at random depths, on columns with a ground of their own."""
    rng = np.random.default_rng(2)
    density, ground = rng.uniform(0.0, 4.0, (6, 3, 2)), rng.uniform(0.0, 0.2, (3, 2))
    depth = np.concatenate([np.zeros((1, 3, 2)), np.cumsum(0.5 * density[::-1] * 0.15, axis=0)])
    levels, drawn = 0.9 - 0.15 * np.arange(7), []
    for (row, column), floor in np.ndenumerate(ground):
        optical = rng.exponential(size=40_000)
        hit = np.interp(optical, depth[:, row, column], levels, right=0.0)
        drawn.append(np.maximum(hit - floor, 0.0))
    percents = [40.0, 60.0, 95.0]
    found = voxel_height_percentiles(
        jnp.asarray(density), percents, thick=0.15, ground=jnp.asarray(ground)
    )
    np.testing.assert_allclose(found, np.percentile(drawn, percents), atol=0.006)
    assert_gradients(
        lambda d: voxel_height_percentiles(d, percents, thick=0.15), jnp.asarray(density)
    )


def test_slopes_in_area_density_and_ground() -> None:
    rng = np.random.default_rng(8)
    start = {
        "density": jnp.asarray(rng.uniform(0.1, 3.0, (5, 2, 4))),
        "ground": jnp.asarray(rng.uniform(0.01, 0.14, (2, 4))),
    }

    @jax.jit
    def metrics(p):
        return voxel_structure(
            p["density"], StructureSettings(canopy_cell=0.5), voxel=(0.5, 0.15), grain=1.0,
            pulses=30.0, layers=3, ground=p["ground"],
        ).metrics  # fmt: skip

    assert_gradients(metrics, start, rtol=1e-4, step=1e-5)
    bare = jax.jit(
        jax.grad(lambda d: sum(v.sum() for v in metrics({**start, "density": d}).values()))
    )
    assert np.isfinite(bare(jnp.zeros((5, 2, 4)))).all()


def test_single_precision_stays() -> None:
    found = voxels(
        jnp.ones((6, 4, 4), jnp.float32), StructureSettings(), voxel=(0.5, 0.15), grain=2.0,
        pulses=50.0, layers=3,
    )  # fmt: skip
    assert all(v.dtype == jnp.float32 for v in found.metrics.values())
    assert all(v.dtype == jnp.float32 for v in found.defined.values())


def test_what_voxels_cannot_have() -> None:
    options = {"grain": 2.0, "pulses": 9.0, "layers": 3}
    columns = StructureSettings(rugosity_of="columns")
    with pytest.raises(InputError, match="rugosity_of"):
        voxel_structure(jnp.ones((3, 9, 9)), columns, voxel=(0.5, 0.1), **options)
    with pytest.raises(InputError, match="voxels of"):
        voxel_structure(jnp.ones((3, 9, 9)), StructureSettings(), voxel=(0.3, 0.1), **options)
    with pytest.raises(InputError, match="one cell of"):
        voxel_structure(jnp.ones((3, 3, 3)), StructureSettings(), voxel=(0.5, 0.1), **options)

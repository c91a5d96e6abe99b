"""Smooth structure metrics against the exact ones, drawn clouds, and finite differences."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from fynjax._core.errors import InputError
from fynjax.metrics import (
    STRUCTURE_METRICS,
    StructureSettings,
    bin_returns,
    cell_grid,
    cell_structure,
    height_intersection,
    smooth_cell_structure,
    voxel_height_percentiles,
    voxel_structure,
)
from fynjax.metrics.structure._smooth import height_percentile_rmse, smooth_height_intersection
from tests.helpers import assert_gradients
from tests.metrics.structure_clouds import LOW_PRESETS, fynbos_cells

OF_AREA = replace(StructureSettings(), diversity_of="leaf_area", top="plot")
CONVENTIONS = {**LOW_PRESETS, "of area": OF_AREA}
# Compiling is what these tests cost: the other conventions are left to the studies.
SOME = [
    pytest.param(name, marks=() if name in ("fynjax", "of area") else pytest.mark.study)
    for name in CONVENTIONS
]


def smooth(returns, height=None, weight=None, width=0.02):
    def metrics(height, weight):
        return smooth_cell_structure(
            height,
            jnp.asarray(returns.cell),
            jnp.asarray(returns.canopy),
            returns.settings,
            cells=returns.grid.rows * returns.grid.columns,
            layers=returns.layers,
            canopy_cells=returns.canopy_cells,
            weight=weight,
            width=width,
        )

    return jax.jit(metrics)(jnp.asarray(returns.height) if height is None else height, weight)


def voxels(density, settings, **options):
    run = jax.jit(lambda d: voxel_structure(d, settings, **options))
    return run(jnp.asarray(density))


@pytest.mark.parametrize("number", [1317, 20_000])
@pytest.mark.parametrize("name", SOME)
def test_smooth_means_are_within_2_percent_of_exact_ones(name, number) -> None:
    """At widths of 2 cm, the paper's density and fifteen times as much."""
    returns = fynbos_cells(CONVENTIONS[name], number)
    exact = cell_structure(returns).means()
    found = smooth(returns).means()
    for metric in STRUCTURE_METRICS:
        assert float(found[metric]) == pytest.approx(exact[metric], rel=0.02), metric


def test_smooth_metrics_of_cells_tend_to_exact_ones() -> None:
    """Every cell, as the width goes to nothing; but for layers that a single return decides."""
    returns = fynbos_cells(StructureSettings(), 20_000)
    exact = cell_structure(returns).metrics
    for width, bound in ((0.02, 0.08), (0.0005, 0.005)):
        found = smooth(returns, width=width).metrics
        for metric in ("gap_fraction", "foliage_height_diversity", "rugosity", "height_cv"):
            np.testing.assert_allclose(
                found[metric].reshape(5, 5), exact[metric], rtol=bound, err_msg=metric
            )


def small():
    """Twenty returns in two cells, some on the ground."""
    rng = np.random.default_rng(5)
    x, y = rng.uniform(0.0, 2.0, 20), rng.uniform(0.0, 1.0, 20)
    h = np.where(rng.random(20) < 0.2, 0.0, rng.gamma(4.0, 0.16, 20))
    return x, y, h


@pytest.mark.parametrize("name", SOME)
def test_slopes_in_heights_and_weights(name) -> None:
    settings = replace(CONVENTIONS[name], cv_lowest=0.15)
    returns = bin_returns(*small(), cell_grid((0, 0, 2, 1), 1.0), settings)
    start = {"height": jnp.asarray(returns.height) + 0.01, "weight": jnp.full(20, 0.8)}

    @jax.jit
    def metrics(p):
        return smooth(returns, p["height"], p["weight"], width=0.15).metrics

    assert_gradients(metrics, start, rtol=2e-4, step=1e-6)


def test_no_nan_at_edges() -> None:
    """Bare ground, one return, empty cells, weights of zero: finite values and slopes."""
    settings = StructureSettings()
    cell = canopy = jnp.zeros(3, int)

    @jax.jit
    def total(h, w):
        found = smooth_cell_structure(
            h, cell, canopy, settings, cells=2, layers=4, canopy_cells=2, weight=w
        )
        return sum(found.means().values()) + sum(v.sum() for v in found.metrics.values())

    slope = jax.jit(jax.value_and_grad(total, argnums=(0, 1)))
    for height in ([0.0, 0.0, 0.0], [0.5, 0.5, 0.5], [0.25, 0.1, 0.0], [0.0, 3.0, 0.375]):
        for weight in ([1.0, 1.0, 1.0], [0.0, 0.0, 0.0], [0.0, 1.0, 0.0]):
            value, slopes = slope(jnp.asarray(height), jnp.asarray(weight))
            assert np.isfinite(value)
            assert all(np.isfinite(s).all() for s in slopes)


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
    returns = fynbos_cells(StructureSettings())
    found = smooth(returns, jnp.asarray(returns.height, jnp.float32))
    of_voxels = voxels(
        jnp.ones((6, 4, 4), jnp.float32), StructureSettings(), voxel=(0.5, 0.15), grain=2.0,
        pulses=50.0, layers=3,
    )  # fmt: skip
    for one in (found, of_voxels):
        assert all(v.dtype == jnp.float32 for v in one.metrics.values())
        assert all(v.dtype == jnp.float32 for v in one.defined.values())
    exact = cell_structure(returns).means()
    assert float(found.means()["rugosity"]) == pytest.approx(exact["rugosity"], rel=0.02)


def test_what_has_no_smooth_form() -> None:
    returns = fynbos_cells(StructureSettings(rugosity_of="columns"))
    with pytest.raises(InputError, match="rugosity_of"):
        smooth(returns)
    with pytest.raises(InputError, match="`width`"):
        smooth(fynbos_cells(StructureSettings()), width=0.5)
    options = {"grain": 2.0, "pulses": 9.0, "layers": 3}
    with pytest.raises(InputError, match="voxels of"):
        voxel_structure(jnp.ones((3, 9, 9)), StructureSettings(), voxel=(0.3, 0.1), **options)
    with pytest.raises(InputError, match="one cell of"):
        voxel_structure(jnp.ones((3, 3, 3)), StructureSettings(), voxel=(0.5, 0.1), **options)


def test_agreement_of_heights_smooth_and_exact() -> None:
    """Against the exact overlap and NumPy's percentiles; slopes against differences."""
    rng = np.random.default_rng(8)
    percents = tuple(range(5, 100, 5))
    ground = rng.random(20_000) < 0.1
    real = np.where(ground, 0.0, rng.gamma(4.0, 0.16, 20_000))
    for factor in (0.7, 1.0, 1.2, 1.6):
        other = np.where(rng.random(15_000) < 0.15, 0.0, factor * rng.gamma(4.0, 0.16, 15_000))
        smooth = smooth_height_intersection(jnp.asarray(real), jnp.asarray(other), 0.1, highest=3.0)
        assert float(smooth) == pytest.approx(height_intersection(real, other, 0.1), abs=0.007)
        rmse = height_percentile_rmse(jnp.asarray(real), jnp.asarray(other), percents)
        gap = np.percentile(real, percents) - np.percentile(other, percents)
        assert float(rmse) == pytest.approx(np.sqrt(np.mean(gap**2)), rel=1e-9)
    first, second = jnp.asarray(real), jnp.asarray(other)
    for measure in (
        lambda s: smooth_height_intersection(first, s * second, 0.1, highest=3.0),
        lambda s: height_percentile_rmse(first, s * second, percents),
    ):
        step = 1e-4
        slope = (measure(1.0 + step) - measure(1.0 - step)) / (2.0 * step)
        assert float(jax.grad(measure)(1.0)) == pytest.approx(float(slope), rel=0.02)
    assert float(jax.grad(lambda s: height_percentile_rmse(first, s * first, percents))(1.0)) == 0.0

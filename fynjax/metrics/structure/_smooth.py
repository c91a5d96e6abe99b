"""Structure metrics that an inversion can use: smooth in the area density of voxels."""

from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from fynjax._core.errors import InputError
from fynjax.metrics.structure._profile import Pair, leaf_area_gap, profile_metrics, ratio, root
from fynjax.metrics.structure._settings import STRUCTURE_METRICS, StructureSettings

# Added to shares before their logarithm is taken: the slope of -p ln p is infinite at 0.
_FLOOR = 1e-5
_SUBDIVISIONS = 8


class SmoothStructure(eqx.Module):
    """Structure in each cell, smooth; finite everywhere."""

    metrics: dict[str, Float[Array, " cell"]]
    """Values of each metric in each cell, by its name in `STRUCTURE_METRICS`; any number where
    undefined."""
    defined: dict[str, Float[Array, " cell"]]
    """Degree to which each metric is defined in each cell [-], 0 to 1: its weight in a mean over
    cells."""

    def means(self) -> dict[str, Float[Array, ""]]:
        """Mean of each metric over the cells where it is defined; 0 where it is so in none."""
        return {
            name: ratio(jnp, jnp.sum(self.defined[name] * value), jnp.sum(self.defined[name]))
            for name, value in self.metrics.items()
        }


def voxel_structure(
    density: Float[Array, "z y x"],
    settings: StructureSettings,
    *,
    voxel: tuple[float, float],
    grain: float,
    pulses: float,
    layers: int,
    projection: float = 0.5,
    ground: Float[Array, "y x"] | None = None,
) -> SmoothStructure:
    """Expected structure metrics of an area density on voxels, as a LiDAR at nadir measures it.

    Pulses fall evenly on the columns and return from the first thing they hit, by the law of Beer
    and Lambert: `pulses` times the loss of gap probability in a layer return from it. The metrics
    are those of the expected counts. The canopy's height is the expected highest return of the
    pulses on a canopy cell, and its variance includes that of the highest return.

    **Arguments:**

    - `density`: area density [m2 m-3], not negative; index 0 is the lowest voxel.
    - `settings`: layers and thresholds.
    - `voxel`: side and height of a voxel [m].
    - `grain`: side of a cell [m], a whole number of canopy cells, and these of voxels; what is
      left over at the eastern and northern edge is left out, as in `cell_grid`.
    - `pulses`: for each square metre [m-2].
    - `layers`: number of layers from `settings.base` up; what returns from above them is in the
      highest.
    - `projection`: G, projected over leaf area [-]; `settings.extinction` is what the analyst
      takes for it.
    - `ground`: height of the ground in each column above the floor of the voxels [m]; 0 unless
      given.

    **Returns:** a `SmoothStructure`. Means over cells are within 2 % of the mean of many drawn
    clouds at the 693 pulses of the paper's simulation, and within 6 % at 40 (rugosity, gap fraction
    and coefficient of variation 2 %), where the logarithm of few returns is not that of their mean
    (tested on 4 m by 4 m of shrubs). Returns beyond the first of a pulse are not modelled.

    **Raises:** `InputError` for sizes that do not divide each other, or for `rugosity_of`
    "columns".

    Differentiable in `density` and `ground` to any order but where the ground crosses a voxel's
    edge.

    >>> import jax
    >>> import jax.numpy as jnp
    >>> from fynjax.metrics.structure import StructureSettings, voxel_structure
    >>> @jax.jit
    ... def gap_fraction(density):
    ...     structure = voxel_structure(
    ...         density,
    ...         StructureSettings(),
    ...         voxel=(0.5, 0.25),
    ...         grain=1.0,
    ...         pulses=700.0,
    ...         layers=4,
    ...     )
    ...     return structure.means()["gap_fraction"]
    >>> round(float(gap_fraction(jnp.full((4, 2, 2), 2.0))), 3)  # exp(-G LAI): exp(-0.5 * 1.8)
    0.407
    """
    side, thick = voxel
    if settings.rugosity_of != "canopy":
        raise InputError("voxels have the rugosity of the canopy alone (`rugosity_of` 'canopy')")
    canopy_cells = max(1, round(grain / settings.canopy_cell))
    across = grain / canopy_cells / side
    if abs(across - round(across)) > 1e-6 or round(across) < 1:
        raise InputError(
            f"canopy cells of {grain / canopy_cells:g} m must be whole numbers of voxels of "
            f"{side:g} m. Take another `canopy_cell` or `grain`."
        )
    pixels = round(across)
    wide = pixels * canopy_cells
    rows, columns = (n // wide for n in density.shape[1:])
    if min(rows, columns) < 1:
        raise InputError(
            f"expected voxels over at least one cell of {grain:g} m, but they cover "
            f"{density.shape[2] * side:g} by {density.shape[1] * side:g} m"
        )
    dtype = density.dtype
    floor = jnp.zeros(density.shape[1:], dtype) if ground is None else ground
    number, hit = pulses * grain**2, pulses * (grain / canopy_cells) ** 2

    def gap_at(heights: Float[Array, " level"]) -> Float[Array, "cell pixel level"]:
        """Gap probability from the sky to heights above the ground, for canopy cells."""
        gaps = _gaps(density, thick, projection, floor, heights).reshape(*density.shape[1:], -1)
        gaps = gaps[: rows * wide, : columns * wide]
        shape = (rows, canopy_cells, pixels, columns, canopy_cells, pixels, -1)
        mean = gaps.reshape(shape).mean(axis=(2, 5))  # row, pixel row, column, pixel column, level
        return mean.transpose(0, 2, 1, 3, 4).reshape(rows * columns, canopy_cells**2, -1)

    def gap_of_cell(height: float) -> Float[Array, " cell"]:
        return gap_at(jnp.asarray([height], dtype)).mean(axis=1)[:, 0]

    # Returns expected from each layer: the fall of the gap probability through it. From the ground
    # up: what returns from below the ground's threshold lies under all layers.
    low = max(settings.base, settings.ground_height)
    steps = settings.base + settings.layer * jnp.arange(layers + 1, dtype=dtype)
    gaps = gap_at(jnp.maximum(steps, low)).mean(axis=1).at[:, -1].set(1.0)
    if low <= 0.0:
        gaps = gaps.at[:, 0].set(0.0)  # returns from the ground are in the lowest layer

    def weight_of_ground(below: float) -> Array | float:
        """Returns by which the weight of the ground's adds to those from below a height."""
        has = settings.ground_height > 0.0
        return (settings.ground_weight - 1.0) * (gap_of_cell(below) if has else 0.0)

    weighted = weight_of_ground(settings.ground_height)
    metrics = _layered(number * jnp.diff(gaps, axis=1), number * (gaps[:, 0] + weighted), settings)
    if settings.gap_of == "canopy":
        share = jnp.mean(gap_at(jnp.asarray([settings.gap_height], dtype))[..., 0] ** hit, axis=1)
    else:  # the share of returns below the threshold, those of the ground weighted
        share = gap_of_cell(settings.gap_height)
        share = share + weight_of_ground(min(settings.ground_height, settings.gap_height))
        share = share / (1.0 + weighted)
    fine = jnp.arange(density.shape[0] * _SUBDIVISIONS + 1, dtype=dtype) * (thick / _SUBDIVISIONS)
    column = gap_at(fine)
    # All pulses on a canopy cell pass a height with the power of what one does, and that is the
    # distribution of the highest return.
    metrics["rugosity"] = _rugosity(column**hit, fine, settings.degrees_lost)
    above = jnp.ones(rows * columns, dtype)
    if settings.cv_lowest > 0.0:
        above = 1.0 - gap_of_cell(settings.cv_lowest)
    metrics["height_cv"] = _height_cv(
        column.mean(axis=1), fine, number * above, number, settings.cv_lowest
    )
    # By leaf area the gap fraction is among the metrics of layers already.
    metrics.setdefault("gap_fraction", (share, jnp.ones_like(share)))
    return SmoothStructure(
        {name: metrics[name][0] for name in STRUCTURE_METRICS},
        {name: metrics[name][1].astype(dtype) for name in STRUCTURE_METRICS},
    )


def _height_cv(
    gap: Float[Array, "cell level"], level: Array, mass: Array, number: float, lowest: float
) -> Pair:
    """Coefficient of variation of single returns above `lowest`, of which `mass` of `number` are
    expected: from moments, over their share."""
    above = ratio(jnp, mass, jnp.asarray(number, level.dtype))
    moments = _height_moments(gap, level, lowest)
    mean, square = (ratio(jnp, moment, above) for moment in moments)
    return ratio(jnp, root(jnp, square - mean**2), mean), _present(mass - 1.0)


def _rugosity(gap: Float[Array, "cell pixel level"], level: Array, lost: int) -> Pair:
    """Standard deviation of the canopy's height, whose distribution function in each pixel is
    `gap`: the sample variance expected of independent values with unequal means."""
    mean, square = _height_moments(gap, level, 0.0)
    many = mean.shape[1]
    between = jnp.sum((mean - mean.mean(axis=1, keepdims=True)) ** 2, axis=1)
    within = jnp.mean(jnp.maximum(square - mean**2, 0.0), axis=1)
    variance = between / max(many - lost, 1) + within * (1.0 if lost else (many - 1) / many)
    return root(jnp, variance) * (many > 1), jnp.full_like(variance, float(many > 1))


def voxel_height_percentiles(
    density: Float[Array, "z y x"],
    percents: Sequence[float],
    *,
    thick: float,
    projection: float = 0.5,
    ground: Float[Array, "y x"] | None = None,
) -> Float[Array, " percent"]:
    """Percentiles of the heights of first returns above the ground [m], as a LiDAR at nadir is
    expected to measure them of an area density on voxels.

    Pulses fall evenly on the columns and return from the first thing they hit, by the law of Beer
    and Lambert: the share of them that returns from below a height is the gap probability from the
    sky to it. Those that reach the ground count, at 0 m.

    **Arguments:**

    - `density`, `projection`, `ground`: as of `voxel_structure`.
    - `percents`: of the percentiles, 0 to 100.
    - `thick`: height of a voxel [m].

    Differentiable in `density` and `ground` where the percentile is above the ground.

    >>> import jax.numpy as jnp
    >>> from fynjax.metrics.structure import voxel_height_percentiles
    >>> even = jnp.full((4, 1, 1), 2.0)  # 1 m of leaves: exp(-0.5 * 2 (1 - h)) = 0.5
    >>> voxel_height_percentiles(even, [50.0], thick=0.25).round(3).tolist()
    [0.307]
    """
    dtype, fine = density.dtype, density.shape[0] * _SUBDIVISIONS
    floor = jnp.zeros(density.shape[1:], dtype) if ground is None else ground
    heights = jnp.arange(fine + 1, dtype=dtype) * (thick / _SUBDIVISIONS)
    gap = _gaps(density, thick, projection, floor, heights).mean(axis=0)
    return jnp.interp(jnp.asarray(percents, dtype) / 100.0, gap, heights)


def _gaps(
    density: Float[Array, "z y x"],
    thick: float,
    projection: float,
    ground: Float[Array, "y x"],
    heights: Float[Array, " level"],
) -> Float[Array, "column level"]:
    """Gap probability of each column from the sky to heights above its ground."""
    # Area above each level of the grid; linear between levels, as density is even in a voxel.
    inside = jnp.cumsum(density[::-1], axis=0)[::-1] * thick
    above = jnp.concatenate([inside, jnp.zeros((1, *density.shape[1:]), density.dtype)])
    levels = jnp.arange(density.shape[0] + 1, dtype=density.dtype) * thick
    area_above = jax.vmap(lambda g, a: jnp.interp(g + heights, levels, a), in_axes=(0, 1))
    return jnp.exp(-projection * area_above(ground.ravel(), above.reshape(len(levels), -1)))


def _layered(
    counts: Float[Array, "cell layer"], under: Float[Array, " cell"], settings: StructureSettings
) -> dict[str, Pair]:
    """Metrics of layers from expected returns in them and under them, and their weights."""
    reached = jnp.cumsum(counts[:, ::-1], axis=1)[:, ::-1]
    total = under + reached[:, 0]
    present = _present(reached)
    if settings.top == "plot":
        present = _present(jnp.sum(reached, axis=0)) * _present(total)[:, None]
    left = under[:, None] + jnp.cumsum(counts, axis=1) - counts
    found, density, defined = profile_metrics(
        jnp, counts, under, present, _present(left), settings, _FLOOR
    )
    number = jnp.sum(defined[:, settings.first_layer(settings.lowest) :], axis=1)
    start = settings.first_layer(settings.diversity_lowest)
    some = jnp.where(found["foliage_height_diversity"][1], 1.0, 0.0)
    weights = {
        "leaf_area_density_mean": _present(number),
        "leaf_area_density_std": _present(number - settings.degrees_lost),
        "foliage_height_diversity": _present(reached[:, start]) * some,
    }
    metrics = {name: (found[name][0], weight) for name, weight in weights.items()}
    if settings.gap_of == "leaf_area":
        gap, _ = leaf_area_gap(jnp, density, defined, settings, total)
        metrics["gap_fraction"] = (gap, _present(total))
    return metrics


def _height_moments(
    gap: Float[Array, "*cell level"], level: Float[Array, " level"], lowest: float
) -> tuple[Float[Array, "*cell"], Float[Array, "*cell"]]:
    """Mean and mean square of heights above `lowest` [m], times the share that is above it.

    With 1 - `gap` as the probability to be higher than `level`. By the trapezoidal rule.
    """
    start = jnp.asarray(lowest, level.dtype)
    # E[h] = h0 P(h > h0) + integral of P(h > z) from h0 up, and E[h^2] likewise with 2 z.
    at = jnp.maximum(level, start)
    higher = 1.0 - gap
    low = jax.vmap(lambda g: jnp.interp(start, level, g))(higher.reshape(-1, len(level)))
    low = low.reshape(higher.shape[:-1])
    higher = jnp.where(level < start, low[..., None], higher)
    mean = start * low + jnp.trapezoid(higher, at, axis=-1)
    return mean, start**2 * low + jnp.trapezoid(2.0 * at * higher, at, axis=-1)


def _present(count: Any) -> Any:
    """Probability that something is there, of which `count` are expected [-]."""
    return -jnp.expm1(-jnp.maximum(count, 0.0))

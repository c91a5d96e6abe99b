"""Two clouds in, their structure compared at one density of returns."""

import warnings
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd

from fynjax._core.errors import in_file
from fynjax._core.progress import advance, stage
from fynjax._core.seeds import generator
from fynjax.app.compare.structure._cloud import HeightCloud, common_plot, height_cloud, open_cloud
from fynjax.app.compare.structure._grain import choose_cells
from fynjax.app.compare.structure._notes import comparison_notes, nearly_highest
from fynjax.app.compare.structure._result import CloudSide, CloudStructure, StructureComparison
from fynjax.app.compare.structure._settings import ComparisonSettings
from fynjax.app.terrain import Bounds, PointCloud
from fynjax.metrics.structure import (
    STRUCTURE_METRICS,
    BinnedReturns,
    CellGrid,
    CellStructure,
    cell_structure,
)


def compare_clouds(
    real_path: str | Path,
    simulated_path: str | Path,
    *,
    settings: ComparisonSettings | None = None,
    seed: int = 0,
) -> StructureComparison:
    """Compare the structure of a real and a simulated cloud as the paper does in figure 13.

    Heights are taken above each cloud's own ground. Both are cut to the whole cells of the plot
    that they share. The grain is chosen on the sparser cloud. The denser one is thinned to its
    number of returns, repeatedly; its value is the median over thinnings, and its interval their
    central part. Both have a bootstrap interval over cells too. Cells with too few returns, and
    those where a metric is undefined, do not count for its mean.

    **Arguments:**

    - `real_path`, `simulated_path`: clouds, as `fynjax.app.terrain.read_cloud` reads them. They may
      differ in density and in the level of their heights. A cloud without ground classes is
      filtered, and returns far below its ground are left out as noise and counted.
    - `settings`: of reading, cells, thinning and bootstrap; those of the paper if not given.
    - `seed`: of thinnings and bootstrap.

    **Returns:** a `StructureComparison`.

    **Raises:** `InputError`, with the file where it is one's fault: no common plot, different
    reference systems, no ground, no grain that fits.
    """
    settings = ComparisonSettings() if settings is None else settings
    return compare_pair(read_pair(real_path, simulated_path, settings), seed=seed)


class CloudPair(NamedTuple):
    """A real and a simulated cloud on the plot that they share."""

    heights: list[HeightCloud]
    """Returns above the ground of each."""
    binned: list[BinnedReturns]
    """Returns of each in the cells."""
    grid: CellGrid
    grains: pd.DataFrame
    """A row for each size of cell that was tried, `grain_m` [m]: its number of cells and returns,
    how much the metrics change to the next larger one [%], and which was taken (`choose_grain`)."""
    bounds: Bounds
    """The plot."""
    notes: list[str]
    """Remarks on the reading."""
    settings: ComparisonSettings


def read_pair(
    real_path: str | Path, simulated_path: str | Path, settings: ComparisonSettings
) -> CloudPair:
    """Read two clouds, and find their ground, their common plot and the grain.

    **Arguments:** `real_path`, `simulated_path` and `settings` as of `compare_clouds`, whose errors
    it raises.
    """
    paths = Path(real_path), Path(simulated_path)
    clouds, bounds, notes = _on_one_plot(paths, settings)
    slack = 0.0 if settings.bounds else max(_spacing(cloud) for cloud in clouds)
    with stage("Find the ground", total=2):
        heights = []
        for cloud, path, how in zip(clouds, paths, (settings.real, settings.simulated)):
            heights.append(height_cloud(cloud, path, how, bounds, slack))
            advance()
    sparser = int(len(heights[1]) < len(heights[0]))
    with stage("Choose the grain"):
        grid, grains = choose_cells(heights[sparser], bounds, slack, settings)
        binned = [part.binned(grid, settings.structure) for part in heights]
    return CloudPair(heights, binned, grid, grains, bounds, notes, settings)


def compare_pair(pair: CloudPair, *, seed: int = 0) -> StructureComparison:
    """Compare the structure of two clouds that are read.

    **Arguments:** `pair`, from `read_pair`; `seed` as of `compare_clouds`.
    """
    rng = generator(seed)
    heights, binned, grid, grains, bounds, notes, settings = pair
    target = min(len(part) for part in binned)
    denser = int(len(binned[1]) > len(binned[0]))
    thinned = "neither" if len(binned[0]) == len(binned[1]) else ("real", "simulated")[denser]
    full = [cell_structure(part) for part in binned]
    repeated: list[CellStructure] = []
    rounds: list[tuple[np.ndarray, float, float]] = []
    other = binned[1 - denser].height
    percentiles = np.percentile(other, settings.percents)
    bins = _bins(binned, settings)
    shares = height_shares(other, settings.histogram_bin, bins)
    draws = settings.repetitions if thinned != "neither" else 1
    with stage("Thin the denser cloud", total=draws):
        for _ in range(draws):
            index = rng.choice(len(binned[denser]), target, replace=False, shuffle=False)
            part = binned[denser].take(np.sort(index))
            repeated.append(cell_structure(part))
            rounds.append(_agreement(part.height, percentiles, shares, bins, settings))
            advance()
    thinnings: list[list[CellStructure]] = [[], []]
    thinnings[denser] = repeated if thinned != "neither" else []
    shown = [percentiles, percentiles]
    shown[denser] = np.median([r[0] for r in rounds], axis=0)
    with stage("Resample the cells"):
        sides = [
            _side(heights[i], binned[i], full[i], thinnings[i], shown[i], bins, settings, rng)
            for i in (0, 1)
        ]
    whole = _agreement(binned[denser].height, percentiles, shares, bins, settings)
    # A profile ends at the other cloud's highest layer; nothing is known above its own.
    edges = max((part.edges for part in full), key=len)
    missing = (len(edges) - 1 - len(s.profile) for s in sides)
    sides = [
        replace(s, profile=np.append(s.profile, np.full(n, np.nan)))
        for s, n in zip(sides, missing, strict=True)
    ]
    result = StructureComparison(
        settings=settings.structure,
        options=settings.options(),
        seed=seed,
        grain=grid.grain,
        bounds=grid.bounds,
        plot=bounds,
        grains=grains,
        matched_returns=target,
        thinned=thinned,
        real=sides[0],
        simulated=sides[1],
        percents=settings.percents,
        heights=_agreements(rounds, whole, settings),
        edges=edges,
        histogram_edges=settings.histogram_bin * np.arange(bins + 1),
        notes=(),
    )
    return replace(result, notes=(*notes, *comparison_notes(result)))


def cloud_structure(
    path: str | Path, settings: ComparisonSettings | None = None, *, seed: int = 0
) -> CloudStructure:
    """The structure of one cloud: its ground, grain, metrics in each cell and their means.

    **Arguments:**

    - `path`: a cloud, as `fynjax.app.terrain.read_cloud` reads it.
    - `settings`: those of thinning and of the simulated cloud are not used; `real` is how the cloud
      is read.
    - `seed`: of the bootstrap.

    **Returns:** a `CloudStructure`.

    **Raises:** `InputError` as `compare_clouds`.
    """
    rng = generator(seed)
    settings = ComparisonSettings() if settings is None else settings
    path = Path(path)
    with stage("Read the cloud"):
        cloud = open_cloud(path, settings.real)
    bounds = cloud.bounds if settings.bounds is None else settings.bounds
    slack = 0.0 if settings.bounds else _spacing(cloud)
    with stage("Find the ground"):
        heights = height_cloud(cloud, path, settings.real, bounds, slack)
    with stage("Choose the grain"):
        grid, grains = choose_cells(heights, bounds, slack, settings)
    binned = heights.binned(grid, settings.structure)
    structure = cell_structure(binned)
    percentiles = np.percentile(binned.height, settings.percents)
    bins = _bins([binned], settings)
    side = _side(heights, binned, structure, [], percentiles, bins, settings, rng)
    return CloudStructure(side, grid.grain, grains, structure)


def _on_one_plot(
    paths: tuple[Path, Path], settings: ComparisonSettings
) -> tuple[tuple[PointCloud, PointCloud], Bounds, list[str]]:
    """Both clouds in the real one's coordinates, the plot that is compared, and remarks."""
    with stage("Read the clouds"):
        real = open_cloud(paths[0], settings.real)
        simulated = open_cloud(paths[1], settings.simulated)
    stated = settings.simulated_shift
    with in_file(paths[1]):
        bounds, shift, notes = common_plot(
            real, simulated, settings.bounds, None if stated is None else stated[:2]
        )
    up = stated[2] if stated is not None and len(stated) == 3 else 0.0
    x, y, z = simulated.x + shift[0], simulated.y + shift[1], simulated.z + up
    return (real, replace(simulated, x=x, y=y, z=z)), bounds, notes


def _spacing(cloud: PointCloud) -> float:
    """Mean distance of returns [m]: by so much a cloud falls short of its plot's edges."""
    west, south, east, north = cloud.bounds
    return float(np.sqrt((east - west) * (north - south) / len(cloud)))


def _bins(binned: list[BinnedReturns], settings: ComparisonSettings) -> int:
    """Bins of height up to the highest return of all."""
    highest = max(float(cloud.height.max()) for cloud in binned)
    return int(np.floor(highest / settings.histogram_bin + 1e-6)) + 1


def _agreement(
    height: np.ndarray,
    percentiles: np.ndarray,
    shares: np.ndarray,
    bins: int,
    settings: ComparisonSettings,
) -> tuple[np.ndarray, float, float]:
    """Percentiles of heights, and how far they and the histogram are from another cloud's."""
    of_heights = np.percentile(height, settings.percents)
    both = np.minimum(height_shares(height, settings.histogram_bin, bins), shares)
    return of_heights, float(np.sqrt(np.mean((of_heights - percentiles) ** 2))), float(both.sum())


def height_shares(height: np.ndarray, width: float, bins: int) -> np.ndarray:
    """Share of returns in each bin of heights above the ground [-].

    `width` is the height of a bin [m]; bins begin at the ground, and higher returns count in the
    last.
    """
    # As for layers, what is a rounding error below an edge is on it.
    index = np.floor(height / width + 1e-6).astype(np.int64)
    counts = np.bincount(np.clip(index, 0, bins - 1), minlength=bins)
    return counts / counts.sum()


def _agreements(
    rounds: list[tuple[np.ndarray, float, float]],
    whole: tuple[np.ndarray, float, float],
    settings: ComparisonSettings,
) -> pd.DataFrame:
    """Agreement of the distributions of heights (`StructureComparison.heights`), from `_agreement`
    of each thinning and of all returns."""
    rows = {}
    for name, unit, values, full in (
        ("height_percentile_rmse", "m", [r[1] for r in rounds], whole[1]),
        ("height_intersection", "1", [r[2] for r in rounds], whole[2]),
    ):
        interval = central_interval(values, settings.confidence)
        rows[name] = (unit, float(np.median(values)), full, *interval)
    columns = ("unit", "value", "full", "thinning_low", "thinning_high")
    return pd.DataFrame.from_dict(rows, orient="index", columns=columns)


def central_interval(values: list[float] | np.ndarray, confidence: float) -> tuple[float, float]:
    """Quantiles between which the share `confidence` of a sample lies [-]."""
    tail = 50.0 * (1.0 - confidence)
    low, high = np.percentile(values, [tail, 100.0 - tail])
    return float(low), float(high)


def bootstrap_interval(
    cells: np.ndarray, settings: ComparisonSettings, rng: np.random.Generator
) -> tuple[float, float]:
    """Percentile interval of the mean over cells, by resampling cells (Efron 1979); NaN for fewer
    than two. Cells are taken as independent; neighbours that are alike make it too narrow."""
    if cells.size < 2:
        return np.nan, np.nan
    from scipy.stats import bootstrap  # late: it takes half a second

    interval = bootstrap(
        (cells,),
        np.mean,
        n_resamples=settings.resamples,
        confidence_level=settings.confidence,
        method="percentile",
        rng=rng,
        batch=max(1, 10_000_000 // cells.size),
    ).confidence_interval
    return float(interval.low), float(interval.high)


def _estimates(
    full: CellStructure,
    thinnings: list[CellStructure],
    settings: ComparisonSettings,
    rng: np.random.Generator,
) -> tuple[dict[str, np.ndarray], pd.DataFrame]:
    """Each metric in cells, and its mean over them with intervals (`CloudSide.metrics`)."""
    least = settings.least_returns
    parts = thinnings or [full]
    cells, rows = {}, {}
    means = pd.DataFrame([part.means(least) for part in parts])
    whole = full.means(least)
    for name in STRUCTURE_METRICS:
        stack = np.stack(
            [np.where(part.counted(least), part.metrics[name], np.nan) for part in parts]
        )
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RuntimeWarning)  # cells without any value stay NaN
            cells[name] = np.nanmedian(stack, axis=0)
        series, defined = means[name].dropna(), cells[name][np.isfinite(cells[name])]
        thinning = (np.nan, np.nan)
        if thinnings and len(series):
            thinning = central_interval(series.to_numpy(), settings.confidence)
        resampled = bootstrap_interval(defined, settings, rng)
        rows[name] = (series.median(), whole[name], *thinning, *resampled)
    columns = ("value", "full", "thinning_low", "thinning_high", "bootstrap_low", "bootstrap_high")
    return cells, pd.DataFrame.from_dict(rows, orient="index", columns=columns)


def _side(
    cloud: HeightCloud,
    binned: BinnedReturns,
    structure: CellStructure,
    thinnings: list[CellStructure],
    percentiles: np.ndarray,
    bins: int,
    settings: ComparisonSettings,
    rng: np.random.Generator,
) -> CloudSide:
    """A cloud over the plot's cells; `thinnings` is empty of one that was not thinned."""
    cells, metrics = _estimates(structure, thinnings, settings, rng)
    west, south, east, north = structure.grid.bounds
    return CloudSide(
        file=str(cloud.file),
        returns=len(binned),
        density=len(binned) / ((east - west) * (north - south)),
        ground=cloud.ground,
        ground_share=cloud.ground_share,
        below_ground=cloud.below_ground,
        below_ground_share=cloud.below_ground / (cloud.below_ground + len(cloud)),
        too_high=cloud.too_high,
        highest=float(binned.height.max()),
        nearly_highest=nearly_highest(binned.height),
        metrics=metrics,
        cells=cells,
        profile=structure.profile(settings.least_returns),
        percentiles=percentiles,
        histogram=height_shares(binned.height, settings.histogram_bin, bins),
    )

"""What a comparison of two clouds found, as numbers, tables and data sets."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr
from jaxtyping import Float

from fynjax.compare.structure._published import structure_2006
from fynjax.metrics import STRUCTURE_METRICS, CellStructure, GrainCheck, StructureSettings

Interval = tuple[float, float]

_NEXT_TO_NOTHING = 1e-3
"""Values below this, in the metric's own unit, are rounding and noise, and nothing to divide by."""


@dataclass(frozen=True)
class MetricEstimate:
    """One number of one cloud. `None` where it is undefined."""

    value: float | None
    """Mean over cells; of a cloud that was thinned, the median over thinnings."""
    full: float | None
    """Of all returns, without thinning."""
    thinning_interval: Interval | None
    """Central part of the thinnings; none for a cloud that was not thinned."""
    bootstrap_interval: Interval | None
    """Percentile interval of the mean over resampled cells; none with less than two cells."""


@dataclass(frozen=True)
class MetricComparison:
    """One structure metric of both clouds."""

    name: str
    unit: str
    real: MetricEstimate
    simulated: MetricEstimate

    @property
    def difference_percent(self) -> float | None:
        """Simulated minus real, over real [%]; none where the real value is next to nothing."""
        real, simulated = self.real.value, self.simulated.value
        if real is None or simulated is None or abs(real) < _NEXT_TO_NOTHING:
            return None
        return 100.0 * (simulated - real) / real


@dataclass(frozen=True)
class CloudSide:
    """One of the clouds, over the plot's cells."""

    file: str
    returns: int
    """In the plot's cells, before thinning."""
    density: float
    """Returns for each square metre, before thinning [m-2]."""
    ground: str
    """How the ground was found."""
    ground_share: float | None
    below_ground: int
    """Returns left out as noise below the ground."""
    below_ground_share: float
    """These over all returns of the plot [-]."""
    too_high: int
    highest: float
    """Height of the highest return in the cells [m]."""
    nearly_highest: float
    """The 99.9th percentile of height [m]; in small clouds what ten returns are above."""
    cells: dict[str, Float[np.ndarray, "y x"]]
    """Each metric in each cell, the median over thinnings; NaN where undefined."""
    profile: Float[np.ndarray, " layer"]
    """Leaf area density, mean over cells of all returns [m2 m-3]; NaN where undefined."""
    percentiles: Float[np.ndarray, " percent"]
    """Of heights [m], the median over thinnings."""
    histogram: Float[np.ndarray, " bin"]
    """Share of returns in bins of height [-], all returns."""


@dataclass(frozen=True)
class DistributionComparison:
    """One number of how two distributions of heights agree."""

    value: float
    """Median over thinnings."""
    interval: Interval
    """Central part of the thinnings."""
    full: float
    """Of all returns, without thinning."""


@dataclass(frozen=True)
class StructureComparison:
    """Structure of a real and a simulated cloud at one density of returns."""

    settings: StructureSettings
    options: dict[str, Any]
    """All other settings by name: repetitions, resamples, confidence, rule of the grain, bins."""
    seed: int
    grain: float
    """Side of a cell [m]."""
    bounds: tuple[float, float, float, float]
    """Edges of the cells in the real cloud's coordinates [m]."""
    plot: tuple[float, float, float, float]
    """Edges of the plot that the cells were cut from [m]."""
    grains: tuple[GrainCheck, ...]
    """The grains that were tried, on the sparser cloud; a given one, and the next larger."""
    matched_returns: int
    """Returns of both clouds after matching."""
    thinned: str
    """"simulated", "real", or "neither" where both have as many."""
    real: CloudSide
    simulated: CloudSide
    metrics: tuple[MetricComparison, ...]
    percents: tuple[float, ...]
    percentile_rmse: DistributionComparison
    """Between the percentiles of height [m]."""
    height_intersection: DistributionComparison
    """Of the histograms of height [-]."""
    edges: Float[np.ndarray, " edge"]
    """Of the layers [m]."""
    histogram_edges: Float[np.ndarray, " edge"]
    """Of the bins of height [m]."""
    notes: tuple[str, ...]
    """What a reader should know of how the two were brought together."""

    def table(self) -> pd.DataFrame:
        """A row for each metric, with intervals and the paper's values where they are printed.

        Empty fields are undefined or not printed.
        """
        paper = structure_2006()
        rows = [
            {
                "metric": metric.name,
                "unit": metric.unit,
                **_columns("real", metric.real),
                **_columns("simulated", metric.simulated),
                "difference_percent": metric.difference_percent,
                "paper_real": paper[metric.name].real,
                "paper_simulated": paper[metric.name].simulated,
                "paper_difference_percent": paper[metric.name].difference_percent,
            }
            for metric in self.metrics
        ]
        for name, unit, agreement in (
            ("height_percentile_rmse", "m", self.percentile_rmse),
            ("height_intersection", "1", self.height_intersection),
        ):
            low, high = agreement.interval
            rows.append(
                {
                    "metric": name,
                    "unit": unit,
                    "simulated": agreement.value,
                    "simulated_full": agreement.full,
                    "simulated_thinning_low": low,
                    "simulated_thinning_high": high,
                    "paper_simulated": paper[name].simulated,
                }
            )
        return pd.DataFrame(rows)

    def settings_table(self) -> pd.DataFrame:
        """Every setting that the numbers depend on, as name and value."""
        everything = {**self.settings.as_dict(), **self.options, "seed": self.seed}
        everything |= {"grain": self.grain, "matched_returns": self.matched_returns}
        everything |= {"cell_bounds": list(self.bounds), "plot_bounds": list(self.plot)}
        everything["thinned"] = self.thinned
        return pd.DataFrame({"setting": list(everything), "value": list(everything.values())})

    def dataset(self) -> xr.Dataset:
        """Maps, means with intervals, profiles, percentiles and histograms, with all settings."""
        west, south, _, _ = self.bounds
        rows, columns = next(iter(self.real.cells.values())).shape
        cloud = [name for name, _ in self._sides()]
        middle = 0.5 * (self.edges[1:] + self.edges[:-1])
        bins = 0.5 * (self.histogram_edges[1:] + self.histogram_edges[:-1])

        def both(field: str) -> np.ndarray:
            return np.stack([getattr(side, field) for _, side in self._sides()])

        data: dict[str, Any] = {
            name: (
                ("cloud", "y", "x"),
                np.stack([side.cells[name] for _, side in self._sides()]),
                {"units": unit, "long_name": name.replace("_", " ")},
            )
            for name, unit in STRUCTURE_METRICS.items()
        }
        data |= self._means()
        data["leaf_area_density"] = (
            ("cloud", "layer"),
            both("profile"),
            {"units": "m2 m-3", "long_name": "leaf area density, mean over cells"},
        )
        data["height_percentile"] = (
            ("cloud", "percent"),
            both("percentiles"),
            {"units": "m", "long_name": "percentile of height above ground"},
        )
        data["height_share"] = (
            ("cloud", "bin"),
            both("histogram"),
            {"units": "1", "long_name": "share of returns"},
        )
        for name, unit, agreement in (
            ("height_percentile_rmse", "m", self.percentile_rmse),
            ("height_intersection", "1", self.height_intersection),
        ):
            for end, value in zip(
                ("", "_full", "_thinning_low", "_thinning_high"),
                (agreement.value, agreement.full, *agreement.interval),
            ):
                said = f"{name}{end}".replace("_", " ")
                data[name + end] = ((), value, {"units": unit, "long_name": said})
        metres = {"units": "m"}
        return xr.Dataset(
            data,
            coords={
                "cloud": cloud,
                "metric": [metric.name for metric in self.metrics],
                "x": ("x", west + (np.arange(columns) + 0.5) * self.grain, metres),
                "y": ("y", south + (np.arange(rows) + 0.5) * self.grain, metres),
                "layer": ("layer", middle, {**metres, "long_name": "middle of the layer"}),
                "bin": ("bin", bins, {**metres, "long_name": "middle of the bin"}),
                "percent": ("percent", np.asarray(self.percents)),
            },
            attrs={
                str(name): _plain(value)
                for name, value in self.settings_table().itertuples(index=False)
            },
        )

    def _means(self) -> dict[str, Any]:
        """Mean of each metric over the cells of both clouds, with intervals; NaN if undefined."""
        means: dict[str, Any] = {
            "metric_unit": (("metric",), [metric.unit for metric in self.metrics], {}),
            "metric_difference_percent": (
                ("metric",),
                np.array([metric.difference_percent for metric in self.metrics], float),
                {"units": "percent", "long_name": "simulated minus real, over real"},
            ),
        }
        rows = [
            [_columns("metric_mean", getattr(metric, name)) for metric in self.metrics]
            for name, _ in self._sides()
        ]
        for key in rows[0][0]:
            means[key] = (
                ("cloud", "metric"),
                np.array([[row[key] for row in side] for side in rows], float),
                {"units": "1", "long_name": f"{key.replace('_', ' ')}, in the unit of the metric"},
            )
        return means

    def curves(self) -> dict[str, pd.DataFrame]:
        """Profile, percentiles and histogram of both clouds: a row for each height."""

        def both(field: str) -> dict[str, np.ndarray]:
            return {name: getattr(side, field) for name, side in self._sides()}

        def ends(edges: np.ndarray) -> dict[str, np.ndarray]:
            return {"low_m": edges[:-1], "high_m": edges[1:]}

        return {
            "profile": pd.DataFrame({**ends(self.edges), **both("profile")}),
            "percentiles": pd.DataFrame({"percent": self.percents, **both("percentiles")}),
            "histogram": pd.DataFrame({**ends(self.histogram_edges), **both("histogram")}),
        }

    def _sides(self) -> tuple[tuple[str, CloudSide], ...]:
        return ("real", self.real), ("simulated", self.simulated)


@dataclass(frozen=True)
class CloudStructure:
    """Structure of one cloud."""

    side: CloudSide
    grain: float
    """Side of a cell [m]."""
    grains: tuple[GrainCheck, ...]
    """The grains that were tried; a given one, and the next larger."""
    structure: CellStructure
    """Every metric in each cell, with its settings."""
    metrics: dict[str, MetricEstimate]
    """Mean over cells and its bootstrap interval."""

    def table(self) -> pd.DataFrame:
        """A row for each metric; empty fields are undefined."""
        return pd.DataFrame(
            [
                {"metric": name, "unit": STRUCTURE_METRICS[name], **_columns("cloud", estimate)}
                for name, estimate in self.metrics.items()
            ]
        ).rename(columns={"cloud": "value"})


def _columns(prefix: str, estimate: MetricEstimate) -> dict[str, float | None]:
    columns: dict[str, float | None] = {prefix: estimate.value, f"{prefix}_full": estimate.full}
    for kind, interval in (
        ("thinning", estimate.thinning_interval),
        ("bootstrap", estimate.bootstrap_interval),
    ):
        low, high = interval or (None, None)
        columns |= {f"{prefix}_{kind}_low": low, f"{prefix}_{kind}_high": high}
    return columns


def _plain(value: Any) -> str | float | int:
    """A value that NetCDF takes as an attribute."""
    if isinstance(value, bool):
        return int(value)
    return value if isinstance(value, str | float | int) else str(value)

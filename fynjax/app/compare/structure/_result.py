"""What a comparison of two clouds found, as numbers, tables and data sets."""

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr
from jaxtyping import Float

from fynjax.app.compare.structure._published import structure_2006
from fynjax.metrics.structure import STRUCTURE_METRICS, CellStructure, StructureSettings

_NEXT_TO_NOTHING = 1e-3
"""Values below this, in the metric's own unit, are rounding and noise, and nothing to divide by."""


@dataclass(frozen=True)
class CloudSide:
    """One cloud over the plot's cells."""

    file: str
    returns: int
    """Returns in the plot's cells, before thinning."""
    density: float
    """Returns for each square metre, before thinning [m-2]."""
    ground: str
    """Way in which the ground was found."""
    ground_share: float | None
    """Share of returns that are ground [-]; none where heights were given."""
    below_ground: int
    """Returns left out as noise below the ground."""
    below_ground_share: float
    """Returns left out as noise below the ground, over all returns of the plot [-]."""
    too_high: int
    """Returns left out as higher than plants."""
    highest: float
    """Height of the highest return in the cells [m]."""
    nearly_highest: float
    """The 99.9th percentile of height [m]; in small clouds what ten returns are above."""
    metrics: pd.DataFrame
    """Mean of each metric over cells, a row by its name, in its unit; NaN where undefined. Columns:
    `value`, of a cloud that was thinned the median over thinnings; `full`, of all returns;
    `thinning_low` and `thinning_high`, the central part of the thinnings; `bootstrap_low` and
    `bootstrap_high`, the percentile interval of the mean over resampled cells."""
    cells: dict[str, Float[np.ndarray, "y x"]]
    """Values of each metric in each cell, the median over thinnings; NaN where undefined."""
    profile: Float[np.ndarray, " layer"]
    """Leaf area density, mean over cells of all returns [m2 m-3]; NaN where undefined."""
    percentiles: Float[np.ndarray, " percent"]
    """Percentiles of height [m], the median over thinnings."""
    histogram: Float[np.ndarray, " bin"]
    """Share of returns in bins of height [-], all returns."""


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
    grains: pd.DataFrame
    """A row for each grain that was tried, on the sparser cloud; a given one, and the next
    larger."""
    matched_returns: int
    """Returns of both clouds after matching."""
    thinned: str
    """"simulated", "real", or "neither" where both have as many."""
    real: CloudSide
    simulated: CloudSide
    percents: tuple[float, ...]
    """Percentiles of height that were compared [%]."""
    heights: pd.DataFrame
    """Agreement of the distributions of heights: rows "height_percentile_rmse" [m] and
    "height_intersection" [-], columns `unit`, `value` (median over thinnings), `full` (of all
    returns), `thinning_low` and `thinning_high`."""
    edges: Float[np.ndarray, " edge"]
    """Edges of the layers [m]."""
    histogram_edges: Float[np.ndarray, " bin_edge"]
    """Edges of the bins of height [m]."""
    notes: tuple[str, ...]
    """Sentences on how the two were brought together."""

    @property
    def sides(self) -> dict[str, CloudSide]:
        """Both clouds, by "real" and "simulated"."""
        return {"real": self.real, "simulated": self.simulated}

    @property
    def difference_percent(self) -> pd.Series:
        """Simulated minus real over real, of each metric [%]; NaN where the real value is next to
        nothing, or one is undefined."""
        real, simulated = (side.metrics["value"] for side in self.sides.values())
        return 100.0 * (simulated - real) / real.where(real.abs() >= _NEXT_TO_NOTHING)

    def table(self) -> pd.DataFrame:
        """A row for each metric, with intervals and the paper's values where they are printed; NaN
        where something is undefined or not printed."""
        columns = [_named(side.metrics, name) for name, side in self.sides.items()]
        table = pd.concat(columns, axis=1)
        table.insert(0, "unit", pd.Series(STRUCTURE_METRICS))
        table["difference_percent"] = self.difference_percent
        table = pd.concat([table, _named(self.heights, "simulated")])
        paper = structure_2006()
        for field in ("real", "simulated", "difference_percent"):
            printed = [getattr(paper[str(name)], field) for name in table.index]
            table[f"paper_{field}"] = np.array(printed, float)
        return table.rename_axis("metric").reset_index()

    def settings_table(self) -> pd.DataFrame:
        """Every setting that the numbers depend on, as name and value."""
        everything = {**asdict(self.settings), **self.options, "seed": self.seed}
        everything |= {"grain": self.grain, "matched_returns": self.matched_returns}
        everything |= {"cell_bounds": list(self.bounds), "plot_bounds": list(self.plot)}
        everything["thinned"] = self.thinned
        return pd.DataFrame({"setting": list(everything), "value": list(everything.values())})

    def dataset(self) -> xr.Dataset:
        """Maps, means with intervals, profiles, percentiles and histograms, with all settings."""
        west, south, _, _ = self.bounds
        sides = list(self.sides.values())
        rows, columns = next(iter(self.real.cells.values())).shape

        def both(dimensions: tuple[str, ...], values: list[Any], unit: str, what: str) -> Any:
            attributes = {"units": unit, "long_name": what}
            return (("cloud", *dimensions), np.stack(values), attributes)

        data: dict[str, Any] = {
            name: both(("y", "x"), [side.cells[name] for side in sides], unit, _words(name))
            for name, unit in STRUCTURE_METRICS.items()
        }
        data["metric_unit"] = ("metric", list(STRUCTURE_METRICS.values()))
        data["metric_difference_percent"] = (
            "metric",
            self.difference_percent.to_numpy(),
            {"units": "percent", "long_name": "simulated minus real, over real"},
        )
        for name in _named(self.real.metrics, "metric_mean").columns:
            values = [_named(side.metrics, "metric_mean")[name] for side in sides]
            what = f"{_words(name)}, in the unit of the metric"
            data[name] = both(("metric",), values, "1", what)
        for name, field, dimension, unit, what in (
            ("leaf_area_density", "profile", "layer", "m2 m-3",
             "leaf area density, mean over cells"),
            ("height_percentile", "percentiles", "percent", "m",
             "percentile of height above ground"),
            ("height_share", "histogram", "bin", "1", "share of returns"),
        ):  # fmt: skip
            data[name] = both((dimension,), [getattr(side, field) for side in sides], unit, what)
        for measure, numbers in self.heights.T.items():
            row = _named(numbers.to_frame().T, str(measure)).iloc[0]
            for column, value in row.drop("unit").items():
                attributes = {"units": row["unit"], "long_name": _words(str(column))}
                data[str(column)] = ((), float(value), attributes)
        metres = {"units": "m"}
        middle, bins = (_middle(edges) for edges in (self.edges, self.histogram_edges))
        return xr.Dataset(
            data,
            coords={
                "cloud": list(self.sides),
                "metric": list(STRUCTURE_METRICS),
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

    def curves(self) -> dict[str, pd.DataFrame]:
        """Profile, percentiles and histogram of both clouds: a row for each height."""

        def both(field: str) -> dict[str, np.ndarray]:
            return {name: getattr(side, field) for name, side in self.sides.items()}

        def ends(edges: np.ndarray) -> dict[str, np.ndarray]:
            return {"low_m": edges[:-1], "high_m": edges[1:]}

        return {
            "profile": pd.DataFrame({**ends(self.edges), **both("profile")}),
            "percentiles": pd.DataFrame({"percent": self.percents, **both("percentiles")}),
            "histogram": pd.DataFrame({**ends(self.histogram_edges), **both("histogram")}),
        }


@dataclass(frozen=True)
class CloudStructure:
    """Structure of one cloud."""

    side: CloudSide
    grain: float
    """Side of a cell [m]."""
    grains: pd.DataFrame
    """A row for each grain that was tried; a given one, and the next larger."""
    structure: CellStructure
    """Every metric in each cell, with its settings."""


def _named(numbers: pd.DataFrame, name: str) -> pd.DataFrame:
    """Columns under a name: `value` becomes "name", `full` "name_full" and so on."""
    new = {c: name if c == "value" else f"{name}_{c}" for c in numbers.columns if c != "unit"}
    return numbers.rename(columns=new)


def _words(name: str) -> str:
    return name.replace("_", " ")


def _middle(edges: np.ndarray) -> np.ndarray:
    return 0.5 * (edges[1:] + edges[:-1])


def _plain(value: object) -> str | float | int:
    """A value that NetCDF takes as an attribute."""
    if isinstance(value, bool):
        return int(value)
    return value if isinstance(value, str | float | int) else str(value)

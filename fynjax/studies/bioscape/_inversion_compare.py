"""Estimates from spectra against the measurements of the field: tables."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from jaxtyping import Float

from fynjax.app.compare import leave_one_out
from fynjax.studies.bioscape._inversion import FREE, WORDS, PlotEstimate, ReferencePlot
from fynjax.studies.bioscape._plots import BioscapePlot

TABLES_PRIOR, OTHERS_PRIOR, BIAS_CORRECTED = (
    "spectrum, the plot's tables as prior",
    "spectrum, other plots as prior",
    "spectrum, other plots as prior and bias correction",
)
TABLE, MEAN, REGRESSION = "the plot's tables alone", "mean of the other plots", "published PLSR"
PREDICTORS = {
    TABLES_PRIOR: "the posterior with cover and traits of the plot's own tables as a weak prior: "
    "it uses what it is compared with",
    OTHERS_PRIOR: "the posterior with the mean of the other plots as prior of live cover and "
    "traits; of the plot's own tables it uses the shares of the species, the dead cover and the "
    "litter",
    BIAS_CORRECTED: "the same, with a leave-one-out bias correction: the model's mean error on the "
    "other plots is taken off, and how far that error varies counts as uncertainty",
    TABLE: "the centre of the first prior: traits of species that the library lacks are those of "
    "their genus, family or growth form",
    MEAN: "the mean of the field's values over all other plots: knows nothing of the plot",
    REGRESSION: "partial least squares on the spectrum (BioSCape workshop). It was trained on "
    "plots of this peninsula, perhaps these, to means in which a species without a measured trait "
    "counts as zero: much of its agreement with those (r 0.69) is with the share of cover that was "
    "measured. Partial least squares on means over the measured species of the 18 plots, each left "
    "out in turn, find r 0.35 to 0.47 for leaf mass per area, which follows the share of restios, "
    "and nothing for water",
}
ENOUGH = 0.8
"""Share of the listed cover that must have a measured trait for the plot's mean to count as
known [-] (Pakeman and Quested 2007, Applied Vegetation Science 10:91)."""


CONSTRAINED, NOT_CONSTRAINED = 0.5, "not constrained"
"""A quantity is constrained where the spectrum removes so much of its prior variance [-]; words of
another."""
_QUANTILES = {"estimate": 0.5, "q025": 0.025, "q05": 0.05, "q95": 0.95, "q975": 0.975}


@dataclass(frozen=True)
class Field:
    """Measurements of the field, by plot."""

    value: dict[str, Float[np.ndarray, " plot"]]
    """Measured quantities by name in `WORDS`, in their units. Traits are means over the species
    measured."""
    share: dict[str, Float[np.ndarray, " plot"]]
    """Share of the listed cover behind each measured quantity [-]."""


def field_values(plots: Sequence[BioscapePlot]) -> Field:
    """Covers as the crew noted them, and cover-weighted means of measured traits."""
    value = {
        "live_cover": np.array([100.0 * p.live for p in plots]),
        "dead_cover": np.array([100.0 * p.dead for p in plots]),
        "bare_cover": np.array([100.0 * (p.soil + p.rock) for p in plots]),
    }
    share = {name: np.ones(len(plots)) for name in value}
    for trait in ("leaf_mass_per_area", "water_content"):
        means = [_measured_mean(plot, trait) for plot in plots]
        value[trait], share[trait] = (np.array([mean[k] for mean in means]) for k in (0, 1))
    return Field(value, share)


def _measured_mean(plot: BioscapePlot, trait: str) -> tuple[float, float]:
    pairs = [
        (s.cover, s.traits[trait].value)
        for s in plot.species
        if s.traits[trait].source == "measured"
    ]
    total = sum(cover for cover, _ in pairs)
    if total <= 0:
        return np.nan, 0.0
    return sum(c * v for c, v in pairs) / total, total / plot.listed_cover


def others(values: Float[np.ndarray, " plot"]) -> tuple[np.ndarray, np.ndarray]:
    """Mean and standard deviation over all other plots, of each."""
    mean = leave_one_out(values[:, None])[:, 0]
    sd = [np.nanstd(np.delete(values, i), ddof=1) for i in range(len(values))]
    return mean, np.array(sd)


def estimate_table(
    plots: Sequence[BioscapePlot],
    predictor: str,
    references: Sequence[ReferencePlot],
    estimates: Sequence[PlotEstimate],
    field: Field,
) -> pd.DataFrame:
    """Every quantity of every plot: field, prior, estimate and its interval."""
    rows = []
    for i, (plot, reference, fit) in enumerate(zip(plots, references, estimates)):
        u = fit.draws()
        for name, (_, unit) in WORDS.items():
            draws = fit.quantity(reference, name, u)
            removed = fit.removed(reference, name)
            rows.append(
                {
                    "plot": plot.name,
                    "predictor": predictor,
                    "quantity": name,
                    "unit": unit,
                    "field": field.value[name][i] if name in field.value else np.nan,
                    "measured_share": field.share[name][i] if name in field.value else np.nan,
                    "prior": fit.quantity(reference, name, np.zeros_like(u[:1]))[0],
                    "sd": draws.std(),
                    **dict(zip(_QUANTILES, np.quantile(draws, list(_QUANTILES.values())))),
                    "constrained": removed,
                    "verdict": "" if removed >= CONSTRAINED else NOT_CONSTRAINED,
                }
            )
    return pd.DataFrame(rows)


def simple_table(
    plots: Sequence[str],
    predictor: str,
    values: dict[str, Float[np.ndarray, " plot"]],
    field: Field,
) -> pd.DataFrame:
    """Every quantity of every plot by a predictor that states no interval."""
    parts = [
        pd.DataFrame(
            {
                "plot": list(plots),
                "predictor": predictor,
                "quantity": name,
                "unit": WORDS[name][1],
                "field": field.value[name],
                "measured_share": field.share[name],
                "estimate": estimate,
            }
        )
        for name, estimate in values.items()
    ]
    return pd.concat(parts, ignore_index=True)


def agreement(table: pd.DataFrame) -> pd.DataFrame:
    """Correlation, RMSE and bias of each predictor, over all plots and over those of whose
    cover enough has a measured trait (`ENOUGH`)."""
    rows = []
    for (name, predictor), part in table.groupby(["quantity", "predictor"], sort=False):
        known = part[np.isfinite(part["field"]) & np.isfinite(part["estimate"])]
        enough = known[known["measured_share"] >= ENOUGH]
        for which, chosen in (("all", known), (f"{ENOUGH:.0%} of cover measured", enough)):
            if which != "all" and len(chosen) == len(known):
                continue
            x, y = chosen["field"].to_numpy(), chosen["estimate"].to_numpy()
            several = len(x) > 2 and np.ptp(x) > 0 and np.ptp(y) > 0
            stated = "q025" in chosen and len(x) and np.isfinite(chosen["q025"]).all()
            rows.append(
                {
                    "quantity": name,
                    "predictor": predictor,
                    "plots": which,
                    "count": len(x),
                    "correlation": np.corrcoef(x, y)[0, 1] if several else np.nan,
                    "rmse": np.sqrt(np.mean((y - x) ** 2)) if len(x) else np.nan,
                    "bias": np.mean(y - x) if len(x) else np.nan,
                    "inside_90": _inside(chosen, "q05", "q95") if stated else np.nan,
                    "inside_95": _inside(chosen, "q025", "q975") if stated else np.nan,
                    "constrained": chosen["constrained"].mean() if len(x) else np.nan,
                }
            )
    return pd.DataFrame(rows)


def _inside(table: pd.DataFrame, low: str, high: str) -> float:
    return float(((table[low] <= table["field"]) & (table["field"] <= table[high])).mean())


def parameter_table(
    plots: Sequence[str], predictor: str, estimates: Sequence[PlotEstimate]
) -> pd.DataFrame:
    """Every free parameter of every plot."""
    tables = [
        pd.DataFrame(
            {
                "plot": plot,
                "predictor": predictor,
                "parameter": fit.space.names,
                "what": [FREE[name].what for name in fit.space.names],
                "prior": np.asarray(fit.space.prior),
                "estimate": np.asarray(fit.space.physical(fit.whitened)),
                "shift": fit.whitened,
                "constrained": fit.constrained,
            }
        )
        for plot, fit in zip(plots, estimates)
    ]
    return pd.concat(tables, ignore_index=True)


def shift_table(parameters: pd.DataFrame) -> pd.DataFrame:
    """Shifts of every parameter from its prior, over plots: one that is the same in all plots is
    an error of the model.

    Columns: mean and standard deviation of the shift over plots, in prior standard deviations;
    `mean_over_error`, the mean over its standard error; the mean share of the prior variance
    removed.
    """
    plots = parameters.groupby(["predictor", "parameter"], sort=False)
    shift = plots["shift"]
    table = pd.DataFrame({"mean_shift": shift.mean(), "sd_shift": shift.std()})
    error: pd.Series = table["sd_shift"] / np.sqrt(shift.count())
    table["mean_over_error"] = table["mean_shift"] / error.where(error > 0)
    table["constrained"] = plots["constrained"].mean()
    table = table.reset_index()
    table.insert(2, "what", [FREE[name].what for name in table["parameter"]])
    return table

"""What spectra say of plots against what the field says: tables."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from jaxtyping import Float

from fynjax.compare import leave_one_out
from fynjax.studies.bioscape._inversion import FREE, QUANTITIES, Estimate, Reference, quantity
from fynjax.studies.bioscape._plots import BioscapePlot

OWN, ELSEWHERE, TAUGHT = (
    "spectrum, the plot's tables as prior",
    "spectrum, other plots as prior",
    "spectrum, other plots as prior and teacher",
)
TABLE, MEAN, REGRESSION = "the plot's tables alone", "mean of the other plots", "published PLSR"
PREDICTORS = {
    OWN: "the posterior with cover and traits of the plot's own tables as a weak prior: it knows "
    "what it is compared with",
    ELSEWHERE: "the posterior with the mean of the other plots as prior of live cover and traits; "
    "of the plot's own tables it knows which species stand there in which shares, the dead cover "
    "and the litter",
    TAUGHT: "the same, after the model has learnt from the other plots what it is off by on "
    "average, and how far that varies",
    TABLE: "the centre of the first prior: traits of species that the library lacks are those of "
    "their genus, family or growth form",
    MEAN: "the mean of the field's values over all other plots: knows nothing of the plot",
    REGRESSION: "partial least squares on the spectrum (BioSCape workshop). It was trained on "
    "plots of this peninsula, perhaps these, to means in which a species without a measured trait "
    "counts as zero",
}
ENOUGH = 0.8
"""Share of the listed cover that must have a measured trait for the plot's mean to count as
known [-] (Pakeman and Quested 2007, Applied Vegetation Science 10:91)."""


@dataclass(frozen=True)
class Field:
    """What the field says of plots."""

    value: dict[str, Float[np.ndarray, " plot"]]
    """By name in `QUANTITIES`, in their units. Traits are means over the species measured."""
    share: dict[str, Float[np.ndarray, " plot"]]
    """Share of the listed cover behind it [-]."""


def field_values(plots: Sequence[BioscapePlot]) -> Field:
    """Live cover and cover-weighted means of measured traits."""
    value = {"live_cover": np.array([100.0 * p.live for p in plots])}
    share = {"live_cover": np.ones(len(plots))}
    for trait in ("leaf_mass_per_area", "water_content"):
        found = [_measured_mean(plot, trait) for plot in plots]
        value[trait], share[trait] = (np.array([f[k] for f in found]) for k in (0, 1))
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
    references: Sequence[Reference],
    estimates: Sequence[Estimate],
    field: Field,
) -> pd.DataFrame:
    """Every quantity of every plot: field, prior, estimate and its interval."""
    rows = []
    for i, (plot, reference, found) in enumerate(zip(plots, references, estimates)):
        for name, (free, _, unit) in QUANTITIES.items():
            k = found.space.names.index(free)
            draws = quantity(reference, name, found.draws(free))
            low, middle, high = np.quantile(draws, (0.025, 0.5, 0.975))
            prior = quantity(reference, name, float(found.space.prior[k]))
            rows.append(
                {
                    "plot": plot.name,
                    "predictor": predictor,
                    "quantity": name,
                    "unit": unit,
                    "field": field.value[name][i],
                    "measured_share": field.share[name][i],
                    "prior": prior,
                    "estimate": middle,
                    "sd": draws.std(),
                    "q025": low,
                    "q975": high,
                    "constrained": found.constrained[k],
                }
            )
    return pd.DataFrame(rows)


def simple_table(
    plots: Sequence[str],
    predictor: str,
    values: dict[str, Float[np.ndarray, " plot"]],
    field: Field,
) -> pd.DataFrame:
    """The same of a predictor that states no interval."""
    parts = [
        pd.DataFrame(
            {
                "plot": list(plots),
                "predictor": predictor,
                "quantity": name,
                "unit": QUANTITIES[name][2],
                "field": field.value[name],
                "measured_share": field.share[name],
                "estimate": estimate,
            }
        )
        for name, estimate in values.items()
    ]
    return pd.concat(parts, ignore_index=True)


def agreement(table: pd.DataFrame) -> pd.DataFrame:
    """Correlation, RMSE and bias of each predictor, over all plots and over those of which the
    field knows enough (`ENOUGH`)."""
    rows = []
    for (name, predictor), part in table.groupby(["quantity", "predictor"], sort=False):
        known = part[np.isfinite(part["field"]) & np.isfinite(part["estimate"])]
        enough = known[known["measured_share"] >= ENOUGH]
        for which, chosen in (("all", known), (f"{ENOUGH:.0%} of cover measured", enough)):
            if which != "all" and len(chosen) == len(known):
                continue
            x, y = chosen["field"].to_numpy(), chosen["estimate"].to_numpy()
            several = len(x) > 2 and np.ptp(x) > 0 and np.ptp(y) > 0
            inside = (chosen["q025"] <= x) & (x <= chosen["q975"]) if "q025" in chosen else None
            rows.append(
                {
                    "quantity": name,
                    "predictor": predictor,
                    "plots": which,
                    "count": len(x),
                    "correlation": np.corrcoef(x, y)[0, 1] if several else np.nan,
                    "rmse": np.sqrt(np.mean((y - x) ** 2)) if len(x) else np.nan,
                    "bias": np.mean(y - x) if len(x) else np.nan,
                    "inside_95": inside.mean()
                    if inside is not None and np.isfinite(chosen["q025"]).all() and len(x)
                    else np.nan,
                    "constrained": chosen["constrained"].mean() if len(x) else np.nan,
                }
            )
    return pd.DataFrame(rows)


def parameter_table(
    plots: Sequence[str], predictor: str, estimates: Sequence[Estimate]
) -> pd.DataFrame:
    """Every free parameter of every plot."""
    rows = []
    for plot, found in zip(plots, estimates):
        values = np.asarray(found.space.physical(found.whitened))  # type: ignore[arg-type]
        for i, name in enumerate(found.space.names):
            rows.append(
                {
                    "plot": plot,
                    "predictor": predictor,
                    "parameter": name,
                    "what": FREE[name].what,
                    "prior": float(found.space.prior[i]),
                    "estimate": values[i],
                    "moved": found.whitened[i],
                    "constrained": found.constrained[i],
                }
            )
    return pd.DataFrame(rows)


def why_table(parameters: pd.DataFrame) -> pd.DataFrame:
    """What all plots do alike: a parameter that moves the same way everywhere tells of the model,
    not of the plots.

    Columns: mean and standard deviation of the shift over plots, in prior standard deviations;
    `alike`, the mean over its standard error; the mean share of the prior variance removed.
    """
    rows = []
    for (predictor, name), part in parameters.groupby(["predictor", "parameter"], sort=False):
        moved = part["moved"].to_numpy()
        several = len(moved) > 1
        spread = moved.std(ddof=1) if several else np.nan
        error = spread / np.sqrt(len(moved))
        rows.append(
            {
                "predictor": predictor,
                "parameter": name,
                "what": FREE[str(name)].what,
                "mean_shift": moved.mean(),
                "sd_shift": spread,
                "alike": moved.mean() / error if several and error > 0 else np.nan,
                "constrained": part["constrained"].mean(),
            }
        )
    return pd.DataFrame(rows)

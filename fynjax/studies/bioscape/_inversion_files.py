"""Results of `fynjax bioscape calibrate`: tables, figures, a page."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
import pandas as pd
from jaxtyping import Float

from fynjax.app.jobs import JobResult, Rows, Run
from fynjax.app.report import figures
from fynjax.app.report.pages import Page, Part, Picture, Section, Table
from fynjax.studies.bioscape._assumed import COVERS_MEAN
from fynjax.studies.bioscape._inversion import MODEL_SD, WORDS, PlotEstimate
from fynjax.studies.bioscape._inversion_compare import (
    BIAS_CORRECTED,
    CONSTRAINED,
    ENOUGH,
    MEAN,
    NOT_CONSTRAINED,
    OTHERS_PRIOR,
    PREDICTORS,
    REGRESSION,
    TABLES_PRIOR,
    agreement,
    parameters_by_plot,
    shift_table,
)
from fynjax.studies.bioscape._scenes import Resolution

_SHARED = 3.0
"""A shift this many standard errors from zero is one that plots share."""


@dataclass(frozen=True)
class Findings:
    """Estimates and residuals of all plots."""

    plots: tuple[str, ...]
    wavelength: Float[np.ndarray, " band"]
    measured: Float[np.ndarray, "plot band"]
    estimates: dict[str, list[PlotEstimate]]
    """Estimates by the name of their prior, in the order of the plots."""
    table: pd.DataFrame
    """Estimates of each predictor."""

    @property
    def residuals(self) -> dict[str, Float[np.ndarray, "plot band"]]:
        """Model less measured: from the tables, and after each fit."""
        rest = {"tables alone": self._spectra(TABLES_PRIOR, "before") - self.measured}
        for prior in self.estimates:
            rest[prior.split(", ")[1]] = self._spectra(prior, "after") - self.measured
        return rest

    def _spectra(self, prior: str, which: str) -> np.ndarray:
        return np.stack([getattr(fit, which) for fit in self.estimates[prior]])


class CalibratePlotsResult(JobResult):
    """Result of `calibrate_plots`: agreement with the field, and shifts of the parameters."""

    command: Literal["bioscape calibrate"] = "bioscape calibrate"
    plots: list[str]
    bands: int
    size_m: float
    voxel_m: float
    realisations: int
    agreement: Rows
    """Agreement of the estimates with the field: the rows of agreement.csv."""
    parameter_shifts: Rows
    """Shifts of the parameters that plots share: the rows of parameter_shifts.csv."""


def write_findings(
    run: Run,
    findings: Findings,
    resolution: Resolution,
    realisations: int,
    inputs: Sequence[str | Path | None],
    *,
    warnings: list[str],
) -> CalibratePlotsResult:
    """Write tables, figures and the page."""
    table, score = findings.table, agreement(findings.table)
    parameters = pd.concat(
        [parameters_by_plot(findings.plots, name, e) for name, e in findings.estimates.items()],
        ignore_index=True,
    )
    shifts = shift_table(parameters)
    run.table("estimates.csv", table, "cover and traits of every plot by every predictor")
    run.table("agreement.csv", score, "agreement of the estimates with the field")
    run.table("parameters.csv", parameters, "every free parameter of every plot")
    run.table("parameter_shifts.csv", shifts, "shifts that all plots share")
    run.table("spectra.csv", _spectra_table(findings), "measured and fitted spectra")
    # The prior that knows most of the model.
    best = next(p for p in (BIAS_CORRECTED, OTHERS_PRIOR, TABLES_PRIOR) if p in findings.estimates)
    headline = _headline(findings, score, best)
    sections = [
        Section("", [" ".join(headline[1:])]),
        _field_section(table, score),
        _stand_section(table, best),
        _shift_section(findings, parameters, shifts),
        Section("Plot by plot", [Table(table, "Every estimate", digits=3, folded=True)]),
        Section("How", _how(resolution, realisations)),
    ]
    title = "Cover and leaf traits from spectra of plots"
    run.page(Page("bioscape calibrate", title, headline[0], sections, record=run.record(inputs)))
    stopped = {
        name
        for fits in findings.estimates.values()
        for name, fit in zip(findings.plots, fits)
        if not fit.converged
    }
    return run.result(
        CalibratePlotsResult,
        headline=headline,
        warnings=warnings,
        converged=not stopped,
        status=f"not converged in its steps: the fit of {', '.join(sorted(stopped))}"
        if stopped
        else "ok",
        plots=findings.plots,
        bands=findings.wavelength.size,
        size_m=resolution.size_m,
        voxel_m=resolution.voxel_m,
        realisations=realisations,
        agreement=score,
        parameter_shifts=shifts,
    )


def _field_section(table: pd.DataFrame, score: pd.DataFrame) -> Section:
    known = set(score["quantity"][score["count"] > 0])
    titles = {name: f"{words} [{unit}]" for name, (words, unit) in WORDS.items() if name in known}
    figure = figures.estimates_plot(
        table,
        titles,
        priors=(TABLES_PRIOR, OTHERS_PRIOR, BIAS_CORRECTED),
        regression=REGRESSION,
        measured_share=ENOUGH,
    )
    scores = Table(
        score[score["count"] > 0].assign(quantity=lambda t: [WORDS[q][0] for q in t["quantity"]]),
        "Cover in %, leaf mass per area in g m-2, water in % of fresh mass.",
        headers={
            "correlation": "r",
            "rmse": "RMSE",
            "inside_90": "inside 90 % interval",
            "inside_95": "inside 95 % interval",
            "constrained": "prior variance removed",
        },
        digits=3,
    )
    picture = Picture(
        "estimates.png",
        figure,
        "estimates with their 95 % intervals against the field",
        "Estimates with their 95 % intervals against the field; on the line is right. In the "
        "first row the plot's own tables are the prior, so that agreement is no merit of the "
        "spectrum; below, other plots are. A filled point is a plot of whose cover most has a "
        "measured trait.",
    )
    predictors = " ".join(f"“{p}”: {PREDICTORS[p]}." for p in score["predictor"].unique())
    return Section("Against the field", [predictors, scores, picture])


def _stand_section(table: pd.DataFrame, prior: str) -> Section:
    """Every quantity of every plot with its interval, of one prior."""
    chosen = table[table["predictor"] == prior]
    rows = []
    for plot, part in chosen.groupby("plot", sort=False):
        row = {"plot": plot}
        for one in part.to_dict("records"):
            words, unit = WORDS[one["quantity"]]
            text = f"{one['estimate']:.3g} ({one['q05']:.3g} to {one['q95']:.3g})"
            row[f"{words} [{unit}]"] = text if not one["verdict"] else f"{text}, {one['verdict']}"
        rows.append(row)
    verdicts = []
    for name, (words, _) in WORDS.items():
        part = chosen[chosen["quantity"] == name]
        known = int((part["verdict"] == "").sum())
        verdicts.append(
            f"{words} in {known} of {len(part)} plots ({part['constrained'].mean():.0%} of the "
            "prior variance removed on average)"
        )
    lines = [
        f"By the {prior}: medians with 90 % intervals. “{NOT_CONSTRAINED.capitalize()}” where the "
        f"spectrum removes less than {CONSTRAINED:.0%} of the prior variance, so that the interval "
        "is mostly the prior's. Leaf area, dead tissue and ground seen are those of the planted "
        "scene; no table has them.",
        f"Constrained: {'; '.join(verdicts)}.",
    ]
    return Section("The stand of each plot", [*lines, Table(pd.DataFrame(rows), folded=True)])


def _shift_section(findings: Findings, parameters: pd.DataFrame, shifts: pd.DataFrame) -> Section:
    parts: list[Part] = []
    if len(findings.plots) > 1:
        parts += _reasons(findings, shifts)
    parts += [
        Picture(
            "shifts.png",
            figures.shifts_plot(parameters),
            "shifts of the parameters from their priors",
            "Shift of each parameter from its prior, a point a plot, the bar their mean. A shift "
            "that all plots share is an error of the model.",
        ),
        Picture(
            "residuals.png",
            figures.residuals_plot(findings.wavelength, findings.residuals),
            "residuals between model and measurement",
            "Residuals between model and measurement, mean and standard deviation of the plots: "
            "what no free parameter can explain.",
        ),
        Table(
            shifts,
            "Shifts of every parameter, over all plots",
            headers={
                "mean_shift": "mean shift [prior sd]",
                "sd_shift": "its sd over plots",
                "mean_over_error": "mean over its standard error",
            },
            digits=3,
            folded=True,
        ),
    ]
    return Section("Shifts from the prior", parts)


def _headline(findings: Findings, score: pd.DataFrame, prior: str) -> list[str]:
    rest = findings.residuals
    before, after = (
        np.sqrt(np.mean(rest[name] ** 2)) for name in ("tables alone", prior.split(", ")[1])
    )
    lines = [
        f"{len(findings.plots)} plots, {findings.wavelength.size} bands. Model less measured "
        f"spectra: root mean square {before:.4f} before, by the tables alone, {after:.4f} after, "
        f"by the {prior}. {COVERS_MEAN}"
    ]
    table = findings.table[findings.table["predictor"] == prior]
    every = {
        (row["quantity"], row["predictor"]): row
        for row in score[score["plots"] == "all"].to_dict("records")
    }
    for name, (words, unit) in WORDS.items():
        score_of = every[name, prior]
        if not score_of["count"]:
            continue
        own = table[(table["quantity"] == name) & table[["field", "estimate"]].notna().all(axis=1)]
        # Of the plot's own tables it is zero, but for the last bit.
        known_before = round(float(np.sqrt(np.mean((own["prior"] - own["field"]) ** 2))), 6)
        line = (
            f"{words[0].upper()}{words[1:]} by the {prior}: r {score_of['correlation']:.2f}, RMSE "
            f"{known_before:.3g} before, {score_of['rmse']:.3g} {unit} after, bias "
            f"{score_of['bias']:+.3g}"
        )
        if (name, MEAN) in every:
            line += f" (mean of the other plots: RMSE {every[name, MEAN]['rmse']:.3g})"
        if score_of["constrained"] < CONSTRAINED:
            line += f"; {NOT_CONSTRAINED}"
        lines.append(line + ".")
    return lines


def _reasons(findings: Findings, shifts: pd.DataFrame) -> list[str]:
    """Sentences on residuals, and on shifts of parameters that all plots share."""
    size = {name: np.sqrt(np.mean(rest**2)) for name, rest in findings.residuals.items()}
    sentences = [
        "Root mean square of the residuals between model and measurement: "
        + "; ".join(f"{name}, {value:.4f}" for name, value in size.items())
        + "."
    ]
    for prior in findings.estimates:
        part = shifts[shifts["predictor"] == prior].set_index("parameter")
        shared = part[part["mean_over_error"].abs() >= _SHARED]
        moves = [
            f"{str(n).replace('_', ' ')} {'up' if r['mean_shift'] > 0 else 'down'} by "
            f"{abs(r['mean_shift']):.1f}"
            for n, r in shared.sort_values("mean_shift", key=abs)[::-1].head(5).iterrows()
        ]
        sentences.append(
            f"With {prior.split(', ')[1]}, all plots shift alike (prior standard deviations): "
            f"{', '.join(moves)}. An error that every plot shares is the model's, and a trait that "
            "moves with it is estimated wrongly by that much."
            if moves
            else f"With {prior.split(', ')[1]} no parameter shifts alike in all plots."
        )
        constrained = part["constrained"].sort_values(ascending=False)
        named = [f"{str(n).replace('_', ' ')} {share:.0%}" for n, share in constrained.items()]
        sentences.append(
            f"Prior variance that the spectra remove: {', '.join(named[:4])}; least: "
            f"{', '.join(named[-3:])}."
        )
    return sentences


def _how(resolution: Resolution, realisations: int) -> list[str]:
    return [
        f"Each plot is a square of {resolution.size_m:g} m that repeats itself, in voxels of "
        f"{100 * resolution.voxel_m:g} cm, with the species of its table. Parameters are those of "
        "the whole plot, factors on what its tables say: a mean spectrum does not "
        "distinguish species. They are fitted by least squares; intervals are of the Gaussian "
        "about the fit, "
        f"and only sensitivity that {realisations} stand realisations share counts as information.",
        "Errors of a spectrum: what the prior's own plots were off by with their parameters known, "
        f"shared by bands; without a prior {100 * MODEL_SD:g} % in each band for itself, a gain "
        "and an offset common to all bands, and what flights over one plot differ by, pooled over "
        "the plots, over the number of flights. With the leave-one-out bias correction the "
        "model's mean error on the other plots is added to it, and the covariance of these errors "
        "replaces all others.",
        "Live cover follows from the crowns' cover by the law of crowns set at random. Traits of "
        "the field are means over the species with a measured value, weighted with cover.",
    ]


def _spectra_table(findings: Findings) -> pd.DataFrame:
    count, bands = findings.measured.shape
    columns = {
        "plot": np.repeat(findings.plots, bands),
        "wavelength_nm": np.tile(findings.wavelength, count),
        "measured": findings.measured.ravel(),
    }
    for name, rest in findings.residuals.items():
        columns[name.replace(" ", "_")] = (rest + findings.measured).ravel()
    return pd.DataFrame(columns)

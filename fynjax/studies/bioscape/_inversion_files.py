"""What `fynjax calibrate-plots` writes: tables, figures, a page."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from jaxtyping import Float

from fynjax.io.text import write_text
from fynjax.report.figures import estimates_plot, residuals_plot, save_figure, shifts_plot
from fynjax.report.pages import Page
from fynjax.studies.bioscape._inversion import MODEL_SD, QUANTITIES, Estimate
from fynjax.studies.bioscape._inversion_compare import (
    ELSEWHERE,
    ENOUGH,
    MEAN,
    OWN,
    PREDICTORS,
    REGRESSION,
    TAUGHT,
    agreement,
    parameter_table,
    why_table,
)
from fynjax.studies.bioscape._scenes import Resolution

_ALIKE = 3.0
"""A shift this many standard errors from zero is one that plots share."""


@dataclass
class Findings:
    """What was found of all plots."""

    plots: tuple[str, ...]
    wavelength: Float[np.ndarray, " band"]
    measured: Float[np.ndarray, "plot band"]
    estimates: dict[str, list[Estimate]]
    """By prior, in the order of the plots."""
    tables: list[pd.DataFrame] = field(default_factory=list)

    def simple(self, table: pd.DataFrame) -> None:
        """Add estimates of one predictor."""
        self.tables.append(table)

    @property
    def table(self) -> pd.DataFrame:
        return pd.concat(self.tables, ignore_index=True)

    @property
    def residuals(self) -> dict[str, Float[np.ndarray, "plot band"]]:
        """Model less measured: from the tables, and after each fit."""
        found = {"tables alone": self._spectra(OWN, "before") - self.measured}
        for prior in self.estimates:
            found[prior.split(", ")[1]] = self._spectra(prior, "after") - self.measured
        return found

    def _spectra(self, prior: str, which: str) -> np.ndarray:
        return np.stack([getattr(one, which) for one in self.estimates[prior]])


def write_findings(
    output: Path,
    findings: Findings,
    resolution: Resolution,
    plantings: int,
    record: Mapping[str, str | int],
) -> dict[str, Any]:
    """Write all of it into `output`; the summary for `run_job`."""
    table, score = findings.table, agreement(findings.table)
    parameters = pd.concat(
        [parameter_table(findings.plots, name, e) for name, e in findings.estimates.items()],
        ignore_index=True,
    )
    why = why_table(parameters)
    spectra = _spectra_table(findings)
    written = {
        "estimates.csv": (table, "cover and traits of every plot by every predictor"),
        "agreement.csv": (score, "their agreement with the field"),
        "parameters.csv": (parameters, "every free parameter of every plot"),
        "why.csv": (why, "what the spectra pull the same way in all plots"),
        "spectra.csv": (spectra, "measured and fitted spectra"),
    }
    for name, (rows, _) in written.items():
        write_text(output / name, rows.to_csv(index=False, float_format="%.6g"))
    several = len(findings.plots) > 1
    figures = {
        "estimates": (
            estimates_plot(
                table,
                {name: f"{words} [{unit}]" for name, (_, words, unit) in QUANTITIES.items()},
                priors=(OWN, ELSEWHERE, TAUGHT),
                regression=REGRESSION,
                measured_share=ENOUGH,
            ),
            "Estimates with their 95 % intervals against the field; on the line is right. In the "
            "first row the plot's own tables are the prior, so that agreement is no merit of the "
            "spectrum; below, other plots are. A filled point is a plot of whose cover most has a "
            "measured trait.",
        ),
        "shifts": (
            shifts_plot(parameters),
            "What the spectra pull on, a point a plot, the bar their mean. What all plots do alike "
            "is what the model lacks, not what the plots have.",
        ),
        "residuals": (
            residuals_plot(findings.wavelength, findings.residuals),
            "What is left between model and measurement, mean and standard deviation of the "
            "plots: what no free parameter can explain.",
        ),
    }  # fmt: skip
    for name, (figure, _) in figures.items():
        save_figure(figure, output / f"{name}.png")
    headline = _headline(findings, score)
    page = Page("Cover and leaf traits from spectra of plots", headline[0])
    page.paragraph(" ".join(headline[1:]))
    page.section("Against the field")
    page.paragraph(" ".join(f"“{p}”: {PREDICTORS[p]}." for p in score["predictor"].unique()))
    page.table(
        score.assign(quantity=[QUANTITIES[q][1] for q in score["quantity"]]),
        headers={"correlation": "r", "rmse": "RMSE", "inside_95": "inside 95 % interval",
                 "constrained": "prior variance removed"},
        digits=3,
        caption="Cover in %, leaf mass per area in g m-2, water in % of fresh mass.",
    )  # fmt: skip
    page.figure(output / "estimates.png", figures["estimates"][1])
    page.section("Why")
    for text in _reasons(findings, why) if several else ():
        page.paragraph(text)
    page.figure(output / "shifts.png", figures["shifts"][1])
    page.figure(output / "residuals.png", figures["residuals"][1])
    page.table(why, digits=3, folded=True, caption="Shifts of every parameter, over all plots",
               headers={"mean_shift": "mean shift [prior sd]", "sd_shift": "its sd over plots",
                        "alike": "mean over its standard error"})  # fmt: skip
    page.section("Plot by plot")
    page.table(table, digits=3, folded=True, caption="Every estimate")
    page.section("How")
    for text in _how(findings, resolution, plantings):
        page.paragraph(text)
    page.footer(record)
    page.write(output / "report.html")
    stopped = sorted(
        {n for es in findings.estimates.values() for n, e in zip(findings.plots, es)
         if not e.converged}
    )  # fmt: skip
    return {
        "headline": headline,
        "files": {
            "report.html": "the report",
            **{name: what for name, (_, what) in written.items()},
            **{f"{name}.png": caption.split(".")[0] for name, (_, caption) in figures.items()},
        },
        "warnings": [f"the fit did not converge in its steps: {', '.join(stopped)}"]
        if stopped
        else [],
        "calibrate_plots": {
            "plots": list(findings.plots),
            "bands": int(findings.wavelength.size),
            "size_m": resolution.size_m,
            "voxel_m": resolution.voxel_m,
            "plantings": plantings,
            "agreement": score.to_dict("records"),
            "why": why.to_dict("records"),
        },
    }


def _headline(findings: Findings, score: pd.DataFrame) -> list[str]:
    lines = [f"{len(findings.plots)} plots, {findings.wavelength.size} bands."]
    prior = next(p for p in (TAUGHT, ELSEWHERE, OWN) if p in findings.estimates)
    every = {
        (row["quantity"], row["predictor"]): row
        for row in score[score["plots"] == "all"].to_dict("records")
    }
    for name, (_, words, unit) in QUANTITIES.items():
        mine = every[name, prior]
        line = (
            f"{words[0].upper()}{words[1:]} by the {prior}: r {mine['correlation']:.2f}, RMSE "
            f"{mine['rmse']:.3g} {unit}, bias {mine['bias']:+.3g}"
        )
        if (name, MEAN) in every:
            line += f" (mean of the other plots: RMSE {every[name, MEAN]['rmse']:.3g})"
        lines.append(line + ".")
    return lines


def _reasons(findings: Findings, why: pd.DataFrame) -> list[str]:
    """What the posteriors say of the reasons, in sentences."""
    told = []
    rest = findings.residuals
    size = {name: np.sqrt(np.mean(r**2)) for name, r in rest.items()}
    told.append(
        "Root mean square of what is left between model and measurement: "
        + "; ".join(f"{name}, {value:.4f}" for name, value in size.items())
        + "."
    )
    for prior in findings.estimates:
        part = why[why["predictor"] == prior].set_index("parameter")
        alike = part[part["alike"].abs() >= _ALIKE].sort_values("mean_shift", key=abs)[::-1]
        moves = [
            f"{str(n).replace('_', ' ')} {'up' if r['mean_shift'] > 0 else 'down'} by "
            f"{abs(r['mean_shift']):.1f}"
            for n, r in alike.head(5).iterrows()
        ]
        told.append(
            f"With the {prior.split(', ')[1]}, all plots pull alike (prior standard deviations): "
            f"{', '.join(moves)}. An error that every plot shares is the model's, and a trait that "
            "moves with it is estimated wrongly by that much."
            if moves
            else f"With the {prior.split(', ')[1]} no parameter moves alike in all plots."
        )
        seen = part.sort_values("constrained", ascending=False)
        best = [f"{str(n).replace('_', ' ')} {r['constrained']:.0%}" for n, r in seen.iterrows()]
        told.append(
            f"Prior variance that the spectra remove: {', '.join(best[:4])}; least: "
            f"{', '.join(best[-3:])}."
        )
    return told


def _how(findings: Findings, resolution: Resolution, plantings: int) -> list[str]:
    return [
        f"Each plot is a square of {resolution.size_m:g} m that repeats itself, in voxels of "
        f"{100 * resolution.voxel_m:g} cm, with the species of its table. Parameters are those of "
        "the whole plot, factors on what its tables say: a mean spectrum does not tell species "
        "apart. They are fitted by least squares; intervals are of the Gaussian about the fit, "
        f"and only what {plantings} plantings of the plot agree on counts as known.",
        f"Errors of a spectrum: {100 * MODEL_SD:g} % in each band for itself, a gain and an offset "
        "common to all bands, and what flights over one plot differ by, pooled over the plots, "
        "over the number of flights. Where other plots teach, the model's mean error on them is "
        "added to it, and the covariance of these errors takes the place of all others.",
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

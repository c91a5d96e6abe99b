"""Results of `fynjax bioscape learn`: a prior file, tables, figures, a page."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import jax.numpy as jnp
import numpy as np
import pandas as pd
from jaxtyping import Float

from fynjax import __version__
from fynjax.app.compare import MODEL, OTHERS, PlotSpectraPair, agreement_table, mean_agreement
from fynjax.app.io.plot import (
    PRIOR_PARAMETERS,
    LeftOutPlot,
    PriorError,
    PriorFile,
    PriorParameter,
    write_prior,
)
from fynjax.app.jobs import JobResult, Rows, Run
from fynjax.app.report import figures
from fynjax.app.report.pages import Page, Picture, Section, Table
from fynjax.inversion import Hyperprior, ParameterSpace, Population
from fynjax.sensors import BandSet
from fynjax.studies.bioscape._assumed import COVERS_MEAN
from fynjax.studies.bioscape._population import COVER_ERROR, MEANS, PER_PLOT, effect_matrix
from fynjax.studies.bioscape._scenes import Resolution

ASSUMED, LEFT_OUT = "as assumed", "learned, plot left out"
"""Populations that plots are simulated from."""


@dataclass(frozen=True)
class Lesson:
    """A learned population, and the plots that it was learned from."""

    title: str
    licence: str
    sources: Sequence[str]
    plots: tuple[str, ...]
    forms: Collection[str]
    """Growth forms that stand in a plot."""
    bands: BandSet
    measured: Float[np.ndarray, "plot band"]
    """Measured reflectance, mean of the flights [-]."""
    space: ParameterSpace
    prior: Hyperprior
    population: Population
    left_out: Sequence[Population]
    """Population of all plots but one, for each plot."""
    ground: Float[np.ndarray, " plot"]
    """Share that tables leave to the ground [-]."""
    predicted: dict[str, Float[np.ndarray, "plot statistic"]]
    """Logarithm of reflectance and ground seen, by population (`ASSUMED` and others)."""
    parameters: Float[np.ndarray, "plot parameter"]
    """Parameters of each plot, whitened."""
    resolution: Resolution

    @property
    def learned(self) -> list[int]:
        """Places in `PER_PLOT` of what plots can teach: a growth form that none of them has would
        only follow the others, by what is assumed of it."""
        stand = ("", *self.forms)
        return [i for i, name in enumerate(PER_PLOT) if name.partition(".")[2] in stand]

    def file(self) -> PriorFile:
        """The prior file, of the growth forms that stand in a plot."""
        found, own = self.population, self.learned
        slope = np.asarray(self.space.slope(jnp.asarray(found.mean[: len(PER_PLOT)])))[own]
        columns = {
            "mean": self._physical(found),
            "mean_sd": slope * np.sqrt(np.diagonal(found.covariance)[own]),
            "plot_sd": slope * (effect_matrix()[own] @ found.sd),
            "assumed": np.asarray(self.space.prior)[own],
            "assumed_sd": np.asarray(self.space.slope(jnp.zeros(len(PER_PLOT))))[own],
        }
        rows = [
            PriorParameter(name=PER_PLOT[place], **{key: float(v[i]) for key, v in columns.items()})
            for i, place in enumerate(own)
        ]
        bands = len(self.bands)
        covariance = found.error[:bands, :bands]
        sd = np.sqrt(np.diagonal(covariance))
        of_means = found.covariance[np.ix_(own, own)]
        mean_sd = np.sqrt(np.diagonal(of_means))
        side, voxel = self.resolution.size_m, self.resolution.voxel_m
        return PriorFile(
            title=self.title,
            licence=self.licence,
            sources=list(self.sources),
            made_with=f"fynjax {__version__}, plots of {side:g} m in voxels of {voxel:g} m",
            plots=len(self.plots),
            parameters=rows,
            error=PriorError(
                wavelength_nm=[float(c) for c in self.bands.centre],
                sd=sd.tolist(),
                correlation=(covariance / np.outer(sd, sd)).tolist(),
            ),
            mean_correlation=(of_means / np.outer(mean_sd, mean_sd)).tolist(),
            left_out=[
                LeftOutPlot(plot=name, means=self._physical(one).tolist())
                for name, one in zip(self.plots, self.left_out)
            ],
        )

    def _physical(self, population: Population) -> np.ndarray:
        mean = jnp.asarray(population.mean[: len(PER_PLOT)])
        return np.asarray(self.space.physical(mean))[self.learned]

    def parameter_table(self) -> pd.DataFrame:
        """A row for each parameter of the population: assumed, learned, and by how much it moved
        in assumed standard deviations."""
        rows = pd.DataFrame([p.model_dump() for p in self.file().parameters])
        rows["moved"] = self.population.mean[self.learned]
        rows["what"] = [PRIOR_PARAMETERS[name] for name in rows["name"]]
        return rows

    def plot_table(self) -> pd.DataFrame:
        """Parameters of each plot, its spectrum known, and the ground seen there."""
        values = [np.asarray(self.space.physical(jnp.asarray(u))) for u in self.parameters]
        names = [PER_PLOT[i] for i in self.learned]
        table = pd.DataFrame(np.stack(values)[:, self.learned], columns=names)
        table.insert(0, "plot", list(self.plots))
        table["ground_by_tables"] = self.ground
        for name, predicted in self.predicted.items():
            table[f"ground seen, {name}"] = predicted[:, -1]
        return table

    def scores(self) -> pd.DataFrame:
        """Agreement of each population with the measured spectra, and of the other plots' mean."""
        tables = []
        for name, predicted in self.predicted.items():
            pair = PlotSpectraPair(
                self.plots,
                np.asarray(self.bands.centre),
                np.exp(predicted[:, :-1]),
                tuple(m[None] for m in self.measured),
            )
            mean = mean_agreement(agreement_table(pair))
            mean = mean[mean["region"] == "full"]
            kept = mean[mean["predictor"] == MODEL].assign(predictor=name)
            tables.append(kept)
        tables.append(mean[mean["predictor"] == OTHERS])
        return pd.concat(tables, ignore_index=True).drop(columns="region")


class LearnResult(JobResult):
    """Result of `learn`: the population and its scores."""

    command: Literal["bioscape learn"] = "bioscape learn"
    plots: list[str]
    bands: int
    size_m: float
    voxel_m: float
    parameters: Rows
    """Parameters that the plots share: the rows of population.csv."""
    scores: Rows
    """Agreement with the measured spectra: the rows of scores.csv."""


def write_lesson(
    run: Run, lesson: Lesson, inputs: Sequence[Path], *, warnings: list[str]
) -> LearnResult:
    """Write the prior file, tables, figures and the page."""
    write_prior(run.path("prior.toml", "the population, for --prior"), lesson.file())
    parameters, plots, scores = lesson.parameter_table(), lesson.plot_table(), lesson.scores()
    bands = len(lesson.bands)
    error = pd.DataFrame(
        {
            "wavelength_nm": lesson.bands.centre,
            "sd": np.sqrt(np.diagonal(lesson.population.error)[:bands]),
            "assumed_sd": np.sqrt(np.diagonal(lesson.prior.error)[:bands]),
        }
    )
    run.table("population.csv", parameters, "what the plots share, and how much they vary")
    run.table("plots.csv", plots, "parameters of each plot, its spectrum known")
    run.table("scores.csv", scores, "agreement with the measured spectra")
    run.table("error.csv", error, "the model's remaining error by wavelength")
    left = scores[scores["predictor"] == LEFT_OUT].iloc[0]
    before = scores[scores["predictor"] == ASSUMED].iloc[0]
    headline = [
        f"Learned from {len(lesson.plots)} plots, {bands} bands. {COVERS_MEAN}",
        f"Each plot left out: RMSE {left['rmse']:.4f}, SAM {left['spectral_angle']:.1f}°; as "
        f"assumed {before['rmse']:.4f}, {before['spectral_angle']:.1f}°.",
    ]
    crowns = lesson.population.mean[MEANS.index(COVER_ERROR)]
    gap = {name: float(p[:, -1].mean()) for name, p in lesson.predicted.items()}
    extra = (
        f"Ground seen from above: {gap[LEFT_OUT]:.2f} of a plot on average, {gap[ASSUMED]:.2f} "
        f"as assumed; tables leave {lesson.ground.mean():.2f} to it, of which crowns that crews "
        f"count as closed explain {crowns:.2f}."
    )
    figure = Picture(
        "population.png",
        figures.population_plot(
            parameters["name"].tolist(),
            lesson.population.mean[lesson.learned],
            np.sqrt(np.diagonal(lesson.population.covariance))[lesson.learned],
            lesson.parameters[:, lesson.learned],
            error,
        ),
        "population and plots",
        "In assumed standard deviations from what was assumed. Bars: the population's mean with "
        "its standard error; points: plots. Below, the error that no parameter explains.",
    )
    sections = [
        Section("Scores", [" ".join(headline), Table(scores, digits=3)]),
        Section("What moved", [figure, Table(parameters, digits=3), extra]),
        Section("Plot by plot", [Table(plots, digits=3, folded=True)]),
        Section("How", [*_HOW, Table(error, digits=3, folded=True)]),
    ]
    lead = f"What {len(lesson.plots)} plots share, and how they vary, learned from their spectra."
    title, record = "A population of plots", run.record(inputs)
    run.page(Page("bioscape learn", title, lead, sections, {}, record, headline[0]))
    return run.result(
        LearnResult,
        headline=headline,
        warnings=warnings,
        plots=list(lesson.plots),
        bands=bands,
        size_m=lesson.resolution.size_m,
        voxel_m=lesson.resolution.voxel_m,
        parameters=parameters,
        scores=scores,
    )


_HOW = (
    "Each plot's logarithm of reflectance is linearised about the plot's own estimate, three "
    "times. A linear mixed model of all plots then gives the population's means, the standard "
    "deviations of random effects between plots, and the covariance of the error that no "
    "parameter explains, by expectation maximisation of the marginal posterior (Laplace). The "
    "share of ground seen from above is one more datum, with the error of crews.",
    "Assumed beforehand: means of growth forms as their defaults, dead tissue to one unit of its "
    "logit, leaf area and clumping to a half, errors of growth forms correlated by 0.7; the others "
    "by the priors of their records. Effects between plots of half of that, worth four plots; an "
    "error of a tenth, shared by bands within 200 nm, worth ten plots; crews judge covers to 0.10, "
    "and ground seen through crowns to 0.15 in all plots alike. Parameters and structure were "
    "chosen before left-out scores of the 18 plots of the shipped prior were read, but for a slope "
    "of dead tissue on dead cover, dropped after that: the marginal density was higher without. "
    "Clumping was added when earlier scores were known, since too much ground was seen; its scores "
    "were read after that.",
    "Left out: means, variances and error are estimated again without the plot, from the same "
    "linearisations, and the plot is simulated at the means with its own tables.",
)

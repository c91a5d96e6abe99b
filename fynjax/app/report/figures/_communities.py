"""Diversity and species as sensors of coarser and coarser pixels see them."""

from typing import Any

import numpy as np
import pandas as pd

from fynjax.app.report.figures._style import GREY, SERIES, Figure, style

_COLOURS = SERIES[:6]
_LINES = ("-", "--", ":", "-.")


@style()
def agreement_plot(table: pd.DataFrame, threshold: float) -> Figure:
    """Squared correlation of each spectral metric with each diversity against the pixel: a row of
    panels for each sensor, a column for each diversity.

    **Arguments:** `table` with the columns sensor, noise, metric, diversity, pixel_m, r2, q05, q95,
    of which the least noise is shown; `threshold`, where a dashed line is drawn.
    """
    least = table[table["noise"] == table["noise"].min()]
    sensors, diversities = (list(least[name].unique()) for name in ("sensor", "diversity"))
    figure = Figure(figsize=(2.2 * len(diversities) + 0.6, 2.0 * len(sensors) + 0.7))
    grid: Any = figure.subplots(
        len(sensors), len(diversities), squeeze=False, sharex=True, sharey=True
    )
    for (s, d), axes in np.ndenumerate(grid):
        part = least[(least["sensor"] == sensors[s]) & (least["diversity"] == diversities[d])]
        for k, (metric, line) in enumerate(part.groupby("metric", sort=False)):
            colour = _COLOURS[k % len(_COLOURS)]
            axes.semilogx(line["pixel_m"], line["r2"], "-o", ms=3, color=colour, label=metric)
            axes.fill_between(
                line["pixel_m"], line["q05"], line["q95"], color=colour, alpha=0.1, lw=0
            )
        axes.axhline(threshold, color=GREY, ls="--", lw=0.8)
        axes.set_ylim(0.0, 1.0)
        if s == 0:
            axes.set_title(diversities[d])
        if d == 0:
            axes.set_ylabel(sensors[s])
    handles, names = grid[0, 0].get_legend_handles_labels()
    figure.legend(handles, names, loc="outside upper left", ncols=len(names))
    figure.supxlabel("Pixel on the ground [m]", fontsize=8.5)
    figure.supylabel("Squared correlation [-]", fontsize=8.5)
    return figure


@style()
def recognition_plot(table: pd.DataFrame) -> Figure:
    """Share of pixels whose species is recognised against the pixel, for each sensor and noise.

    **Arguments:** `table` with the columns sensor, noise, pixel_m, accuracy, q05, q95, by_chance,
    species.
    """
    figure = Figure(figsize=(6.0, 3.4))
    axes: Any = figure.subplots()
    noises = list(table["noise"].unique())
    for k, (sensor, mine) in enumerate(table.groupby("sensor", sort=False)):
        colour = _COLOURS[k % len(_COLOURS)]
        for noise, line in mine.groupby("noise"):
            kind = _LINES[noises.index(noise) % len(_LINES)]
            label = f"{sensor}, noise {100 * float(str(noise)):g} %"
            axes.semilogx(
                line["pixel_m"], line["accuracy"], "o", ls=kind, ms=3, color=colour, label=label
            )
            axes.fill_between(
                line["pixel_m"], line["q05"], line["q95"], color=colour, alpha=0.12, lw=0
            )
        first = mine[mine["noise"] == noises[0]]
        axes.semilogx(first["pixel_m"], first["by_chance"], ls=":", lw=0.8, color=GREY)
        if k == 0:
            for _, row in first[first["species"] > 0].iterrows():
                axes.annotate(
                    f"{row['species']:.0f}", (row["pixel_m"], row["by_chance"]), fontsize=7,
                    xytext=(0, 3), textcoords="offset points", ha="center", color=GREY,
                )  # fmt: skip
    axes.set(ylim=(0.0, 1.02), xlabel="Pixel on the ground [m]")
    axes.set_ylabel("Pixels recognised [-]")
    figure.legend(loc="outside upper left", ncols=2)
    return figure

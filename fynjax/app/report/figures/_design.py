"""Bands of a designed sensor over spectra and their slopes, and beside those of other sensors."""

from typing import Any

import numpy as np

from fynjax.app.report.figures._style import (
    BLUE,
    GREY,
    SERIES,
    VERMILION,
    Figure,
    name_rows,
    style,
    words,
)
from fynjax.inversion import BandDesign

_MOST = 12
"""Curves of a panel, at most."""
_SEEN = 0.006
"""Share of the range that a band is drawn wide, at least."""


@style()
def design_plot(found: BandDesign) -> Figure:
    """Spectra of the species, slopes of the mean spectrum, and the bands of all sensors.

    **Arguments:** `found`, whose bands are shaded in all panels.
    """
    figure = Figure(figsize=(7.6, 6.4))
    panels: Any = figure.subplots(3, 1, sharex=True, height_ratios=(3, 3, 2))
    data = found.spectra
    wavelength = data["wavelength"].to_numpy()
    spectra, slopes = (
        dict(zip(data[over].to_numpy(), data[name].to_numpy(), strict=True))
        for over, name in (("species", "species_spectrum"), ("quantity", "slope"))
    )
    spectra["whole plot"] = data["spectrum"].to_numpy()
    for axes, curves in zip(panels, (spectra, slopes)):
        known = {name: curve for name, curve in curves.items() if np.isfinite(curve).all()}
        for k, (name, curve) in enumerate([*known.items()][-_MOST:]):
            line, colour = "-" if k < len(SERIES) else "--", SERIES[k % len(SERIES)]
            axes.plot(
                wavelength, curve, line, lw=1.1, color=colour,
                label=words(name.removeprefix("species.")),
            )  # fmt: skip
        if known:
            axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), fontsize=7)
    panels[0].set_ylabel("Reflectance factor [-]")
    panels[1].set_ylabel("Change for one\nprior sd [-]")
    sensors = {"designed": found.bands} | {one.name: one.bands for one in found.cameras}
    rows = name_rows(panels[2], list(sensors))
    for row, bands in zip(rows, sensors.values(), strict=True):
        wide = np.maximum(bands.fwhm, _SEEN * np.ptp(wavelength))
        panels[2].barh(
            np.full(len(bands), row), wide, height=0.6,
            left=np.array(bands.centre) - wide / 2,
            color=VERMILION if row == 0 else GREY,
        )  # fmt: skip
    for axes in panels:
        for centre, width in zip(found.bands.centre, found.bands.fwhm, strict=True):
            ends = centre - width / 2, centre + width / 2
            axes.axvspan(*ends, color="#F3E3DC", lw=0, zorder=0)
    panels[2].set_xlabel("Wavelength [nm]")
    return figure


@style()
def gain_plot(found: BandDesign) -> Figure:
    """The target of each sensor in plantings left out of the design, and the design's gain.

    **Arguments:** `found`, with its table of sensors.
    """
    table = found.table
    figure = Figure(figsize=(7.0, 1.0 + 0.36 * len(table)))
    left, right = figure.subplots(1, 2, sharey=True)
    labels = [f"{row.sensor} ({row.bands})" for row in table.itertuples()]
    rows = name_rows(left, labels)
    left.plot(table["left_out"], rows, "o", color=BLUE)
    left.set_xlabel(words(found.target), fontsize=8)
    others = table["gain"].to_numpy()[1:]
    spread = np.abs(table[["gain_q05", "gain_q95"]].to_numpy()[1:].T - others)
    right.errorbar(others, rows[1:], xerr=spread, fmt="o", color=VERMILION, ecolor=GREY)
    right.axvline(0.0, color=GREY, lw=0.8)
    right.set_xlabel("gain of the design", fontsize=8)
    return figure

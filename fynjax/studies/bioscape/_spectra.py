"""Measured spectra of BioSCape's plots: AVIRIS-NG reflectance, one row a flight over a plot."""

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from fynjax._core.errors import InputError
from fynjax.app.io.text import TextTable, open_table
from fynjax.sensors import shipped_sensor
from fynjax.studies.bioscape._tables import VISITS, find_table, flight_time

WAVES = "*waves.csv", "a table of band centres"
_MASKED = -0.01
"""Value of the tables in bands that are masked; -9999 is a pixel without any value."""
_LARGEST = 2.0
_WHOLE = 0.9
"""Least share of the usual bands that a spectrum must have."""


@dataclass(frozen=True)
class Spectrometer:
    """Bands of the spectra."""

    centre: Float[np.ndarray, " band"]
    """Centres of the bands [nm], increasing."""
    fwhm: Float[np.ndarray, " band"]
    """Full width at half maximum [nm]."""


@dataclass(frozen=True)
class PlotSpectra:
    """Measured spectra of one plot."""

    times: tuple[str, ...]
    """Start of each flight line that has a spectrum, ISO 8601."""
    reflectance: Float[np.ndarray, "flight band"]
    """Surface reflectance [-]; NaN where the band is masked."""
    left_out: int
    """Flights over the plot without a spectrum, or with one that has gaps."""


def read_spectrometer(folder: str | Path) -> Spectrometer:
    """Band centres of a folder of BioSCape's tables; without a table of them, AVIRIS-NG's.

    The widths are those of the nearest band of the shipped AVIRIS-NG: the tables have none.
    Raises `InputError` for centres that are no increasing wavelengths in nm.
    """
    shipped = shipped_sensor("aviris_ng").bands
    known, width = np.asarray(shipped.centre), np.asarray(shipped.fwhm)
    path = find_table(Path(folder), WAVES)
    if path is None:
        return Spectrometer(known, width)
    table = open_table(path, WAVES[1])
    centre = table.columns([table.width - 1])[table.width - 1].to_numpy()
    if centre.size < 2 or not np.all(np.diff(centre) > 0) or not 200 < centre[0] < 3000:
        raise InputError(
            "expected two or more increasing band centres in nm, but got "
            f"{centre.size}{f', from {centre[0]:g} to {centre[-1]:g}' if centre.size else ''}. "
            "Micrometres, or bands out of order?",
            file=path,
        )
    nearest = np.abs(centre[:, None] - known).argmin(axis=1)
    return Spectrometer(centre, width[nearest])


def read_plot_spectra(folder: str | Path) -> dict[str, PlotSpectra]:
    """Measured spectra by plot of a folder of BioSCape's tables; empty without `*VegCenters.csv`.

    A spectrum is left out where it has no value in a tenth of the bands that most spectra have.
    **Raises:** `InputError` for a table without bands or with another
    number of them than of wavelengths, and for a value that is no reflectance.
    """
    path = find_table(Path(folder), VISITS)
    if path is None:
        return {}
    bands = read_spectrometer(folder).centre.size
    table = open_table(path, VISITS[1])
    header = table.names
    columns = [i for i, name in enumerate(header) if re.fullmatch(r"Band_\d+", name)]
    if len(columns) != bands:
        raise InputError(
            f"expected a column Band_1, Band_2, ... for each of {bands} wavelengths, but there are "
            f"{len(columns)}. Do spectra and {WAVES[0]} belong together?",
            file=path,
            row=table.row,
        )
    for name in ("BScpPID", "start_time"):
        if name not in header:
            raise InputError("expected this column, but there is none", file=path, column=name)
    plot, start = header.index("BScpPID"), header.index("start_time")
    names, times, values = [], [], []
    for where, cells in table.records():
        names.append(cells[plot])
        flight_time(cells[start], path, where)
        times.append(cells[start])
        values.append([_reflectance(table, cells[i], where, header[i]) for i in columns])
    if not values:
        return {}
    reflectance = np.asarray(values)
    some = np.isfinite(reflectance).any(axis=1)
    dark = np.isnan(reflectance[some]).mean(axis=0) > 0.5 if some.any() else np.ones(bands, bool)
    lit = np.isfinite(reflectance[:, ~dark])
    whole = some & (lit.sum(axis=1) >= _WHOLE * lit.shape[1])
    spectra: dict[str, PlotSpectra] = {}
    for name in dict.fromkeys(names):
        mine = np.array([n == name for n in names])
        keep = np.flatnonzero(mine & whole)
        spectra[name] = PlotSpectra(
            tuple(times[i] for i in keep), reflectance[keep], int(mine.sum() - keep.size)
        )
    return spectra


def _reflectance(table: TextTable, text: str, row: int, column: str) -> float:
    value = table.number(text, row, column, ("", "na", "nan"))
    if value <= -1.0 or abs(value - _MASKED) < 1e-6:
        return np.nan
    if value > _LARGEST:
        raise InputError(
            f"expected a reflectance as a fraction, but got {text!r}. "
            "Percent, or 10 000 times the fraction?",
            file=table.path,
            row=row,
            column=column,
        )
    return value

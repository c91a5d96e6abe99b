"""Spectra as files read them, as one table and one dataset."""

import json
import re
from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd
import xarray as xr

from fynjax.io.spectra._record import MeasuredSpectrum

_DIGITS = 3
"""Decimals of a wavelength [nm]: bands nearer to each other are the same."""


def measured_dataset(
    spectra: Sequence[tuple[str, MeasuredSpectrum]], attributes: Mapping[str, str | int]
) -> xr.Dataset:
    """Spectra of files over all their wavelengths, NaN where one has no such band.

    **Arguments:**

    - `spectra`: file and spectrum of each.
    - `attributes`: of the dataset, such as where it comes from.

    **Returns:** reflectance and, where any was measured, transmittance [spectrum, wavelength] as
    fractions; wavelength [nm]; of each spectrum its file, format, repairs made while reading, and
    what else the file says, as JSON. Names that occur twice are numbered.
    """
    names = _numbered([s.name for _, s in spectra])
    grids = [np.round(s.wavelength, _DIGITS) for _, s in spectra]
    wavelength = np.unique(np.concatenate(grids))
    variables: dict[str, tuple[tuple[str, ...], np.ndarray, dict[str, str]]] = {}
    for quantity in ("reflectance", "transmittance"):
        rows = [getattr(s, quantity) for _, s in spectra]
        if all(row is None for row in rows):
            continue
        values = np.full((len(rows), wavelength.size), np.nan, np.float32)
        for row, grid, into in zip(rows, grids, values):
            if row is not None:
                into[np.searchsorted(wavelength, grid)] = row
        long_name = f"measured {quantity}, as a fraction"
        variables[quantity] = (
            ("spectrum", "wavelength"), values, {"units": "1", "long_name": long_name}
        )  # fmt: skip
    texts = {
        "file": ([file for file, _ in spectra], "file of the spectrum"),
        "format": ([str(s.meta.get("format", "")) for _, s in spectra], "format of the file"),
        "repairs": (["; ".join(s.meta["repairs"]) for _, s in spectra], "repairs while reading"),
        "header": ([_header(s) for _, s in spectra], "what else the file says, as JSON"),
    }
    for name, (cells, long_name) in texts.items():
        variables[name] = (("spectrum",), np.array(cells, object), {"long_name": long_name})
    about = {"units": "nm", "standard_name": "radiation_wavelength", "long_name": "band centre"}
    return xr.Dataset(
        variables,
        coords={
            "wavelength": ("wavelength", wavelength, about),
            "spectrum": ("spectrum", np.array(names, object), {"long_name": "name of spectrum"}),
        },
        attrs={"Conventions": "CF-1.11", "title": "Measured spectra", **attributes},
    )


def _header(spectrum: MeasuredSpectrum) -> str:
    rest = {k: v for k, v in spectrum.meta.items() if k not in ("format", "repairs")}
    return json.dumps(rest, default=str, ensure_ascii=False)


def _numbered(names: Sequence[str]) -> list[str]:
    """Names, those that occur before with a number that no other has."""
    unique: dict[str, None] = {}
    for name in names:
        count, free = 1, name
        while free in unique:
            count += 1
            free = f"{name}_{count}"
        unique[free] = None
    return list(unique)


def measured_table(dataset: xr.Dataset) -> pd.DataFrame:
    """A column of wavelengths and one of each spectrum, which `read_spectra` reads again.

    **Arguments:** `dataset`, as `measured_dataset` makes it.

    **Returns:** `wavelength_nm`, and of each spectrum its name with `_R` (reflectance) or `_T`.
    """
    columns: dict[str, np.ndarray] = {"wavelength_nm": dataset["wavelength"].values}
    for quantity, mark in (("reflectance", "R"), ("transmittance", "T")):
        if quantity not in dataset:
            continue
        for name, row in zip(dataset["spectrum"].values, dataset[quantity].values):
            if np.isfinite(row).any():
                # The word would be read as the unit.
                columns[f"{re.sub('%|percent', 'pct', name, flags=re.I)}_{mark}"] = row
    return pd.DataFrame(columns)

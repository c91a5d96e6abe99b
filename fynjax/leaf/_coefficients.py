"""Absorption and refraction tables of PROSPECT, on any grid inside 400-2500 nm."""

from functools import lru_cache
from importlib import resources
from typing import Literal, get_args

import numpy as np
import pandas as pd

from fynjax._core.errors import InputError

ProspectVersion = Literal["5", "D", "PRO"]
"""Versions of PROSPECT: 5 (2008), D (2017), PRO (2021)."""

FIRST_WAVELENGTH, LAST_WAVELENGTH = 400.0, 2500.0

# Field of `LeafParameters` to column of the table, in the order of the kernel's vector.
_COLUMNS = {
    "chlorophyll": "cab",
    "carotenoids": "car",
    "anthocyanins": "ant",
    "brown_pigments": "brown",
    "water": "ewt",
    "dry_matter": "lma",
    "proteins": "prot",
    "carbon_constituents": "cbc",
}
_SPLIT = ("proteins", "carbon_constituents")  # what PROSPECT-PRO has in place of dry matter
_LACKS = {"5": ("anthocyanins", *_SPLIT), "D": _SPLIT, "PRO": ("dry_matter",)}
CONSTITUENTS = {
    version: {name: column for name, column in _COLUMNS.items() if name not in lacks}
    for version, lacks in _LACKS.items()
}


def check_version(version: str) -> None:
    """Raise `InputError` unless `version` is one of "5", "D", "PRO"."""
    if version not in get_args(ProspectVersion):
        raise InputError(f'`version` must be "5", "D" or "PRO", but is {version!r}')


@lru_cache
def _table(version: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Wavelength [band], refractive index [band], specific absorption [constituent, band]."""
    name = "prospect_5.csv.gz" if version == "5" else "prospect_pro.csv.gz"
    path = resources.files("fynjax.leaf") / "data" / name
    with resources.as_file(path) as file:
        table = pd.read_csv(file)
    columns = list(CONSTITUENTS[version].values())
    return (
        table["wl"].to_numpy(np.float64),
        table["nr"].to_numpy(np.float64),
        np.ascontiguousarray(table[columns].to_numpy(np.float64).T),
    )


def native_wavelength() -> np.ndarray:
    """The wavelengths of the tables, 400 to 2500 nm in steps of 1 nm."""
    return _table("D")[0]


def check_in_tables(wavelength: np.ndarray) -> None:
    """Raise `InputError` unless every band centre lies inside the tables."""
    if wavelength.ndim != 1 or wavelength.size == 0:
        raise InputError(
            f"`wavelength` must be a vector of at least one band, but has shape {wavelength.shape}"
        )
    low, high = float(np.min(wavelength)), float(np.max(wavelength))
    if not (low >= FIRST_WAVELENGTH and high <= LAST_WAVELENGTH):
        hint = (
            "are they in µm? Multiply by 1000"
            if high < 100.0
            else "PROSPECT has no absorption data outside, so leave such bands out"
        )
        raise InputError(
            "`wavelength` must lie within 400 to 2500 nm, but runs from "
            f"{low:g} to {high:g}; {hint}"
        )


def coefficients_at(version: str, wavelength: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Refractive index [band] and specific absorption [constituent, band] at `wavelength` [nm].

    Linear between the 1 nm steps of the tables; the spectral resolution of the tables is coarser.
    """
    tabulated, index, absorption = _table(version)
    if wavelength.shape == tabulated.shape and np.array_equal(wavelength, tabulated):
        return index, absorption
    return (
        np.interp(wavelength, tabulated, index),
        np.stack([np.interp(wavelength, tabulated, row) for row in absorption]),
    )

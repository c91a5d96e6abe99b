"""Spectra as a fit takes them: arrays, tables of pandas, and what xarray holds."""

from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from jaxtyping import Float

from fynjax._core.errors import InputError, listed

_SHORTEST, _LONGEST = 100.0, 50000.0
_PERCENT = 1.5
"""No leaf has a median reflectance or transmittance as large as this."""


class SpectraSource(NamedTuple):
    """What is known of each spectrum besides its values."""

    labels: tuple[str, ...]
    """Name of each spectrum."""
    files: tuple[str, ...] = ()
    """File of each spectrum; empty where they are not from files."""
    repairs: tuple[str, ...] = ()
    """Repairs of each spectrum while it was read, in sentences; empty as `files`."""


class Spectra(NamedTuple):
    """Spectra on the same bands, of which one of R and T may be missing."""

    wavelength: Float[np.ndarray, " band"]
    """Band centres, ascending [nm]."""
    reflectance: Float[np.ndarray, "leaf band"] | None
    """Reflectance, NaN where missing [-]."""
    transmittance: Float[np.ndarray, "leaf band"] | None
    """Transmittance, NaN where missing [-]."""
    source: SpectraSource


def as_spectra(wavelength: Any, reflectance: Any, transmittance: Any) -> Spectra:
    """The spectra that the first three arguments of `fit_leaf` hold, in any form it takes.

    Raises `InputError` for another form, and for wavelengths that are not in nm, are there twice
    or, of arrays, do not ascend; the values are checked later, by blocks.
    """
    import xarray as xr  # late: the command line need not wait for it

    labelled = isinstance(wavelength, xr.Dataset | xr.DataArray | pd.DataFrame)
    whole = isinstance(wavelength, xr.Dataset)
    if labelled and (reflectance is not None or (whole and transmittance is not None)):
        raise InputError(
            "expected a table or what xarray holds as the only argument, with reflectance in it; "
            "of a dataset transmittance too, of others as `transmittance=`"
        )
    given = {"reflectance": reflectance, "transmittance": transmittance}
    more: dict[str, tuple[str, ...]] = {}
    if whole:
        given = {what: wavelength.get(what) for what in given}
        for key, name in (("files", "file"), ("repairs", "repairs")):
            if name in wavelength:
                more[key] = tuple(map(str, np.atleast_1d(wavelength[name].values)))
    elif labelled:
        given["reflectance"] = wavelength
    given = {what: part for what, part in given.items() if part is not None}
    if not given:
        found = f", but the dataset has {listed(map(str, wavelength))}" if whole else ""
        raise InputError(f"a fit needs reflectance, transmittance, or both{found}")
    if labelled:
        tables = {what: _table(part, what) for what, part in given.items()}
        first, *others = tables.values()
        for other in others:
            if not (other.columns.equals(first.columns) and set(other.index) == set(first.index)):
                raise InputError(
                    "reflectance and transmittance must have the same labels and wavelengths"
                )
        given = {what: table.loc[first.index].to_numpy() for what, table in tables.items()}
        wavelength, labels = first.columns, tuple(map(str, first.index))
    else:
        given = {w: np.atleast_2d(_numbers(v, f"an array of {w}")) for w, v in given.items()}
        labels = tuple(f"leaf_{i + 1}" for i in range(len(next(iter(given.values())))))
    grid = _numbers(wavelength, "wavelengths [nm], or a pandas or xarray object").astype(float)
    if grid.ndim != 1 or np.any(np.diff(grid) <= 0):
        raise InputError("`wavelength` must be an ascending vector [nm]")
    for array in given.values():
        if array.shape != (len(labels), grid.size):
            raise InputError(f"spectra must have the shape (leaf, {grid.size}), but {array.shape}")
    if not labels or not grid.size:
        raise InputError(f"expected spectra, but got {len(labels)} of {grid.size} bands")
    if not (grid[0] >= _SHORTEST and grid[-1] <= _LONGEST):
        raise InputError(
            f"wavelengths must be in nm, {_SHORTEST:g} to {_LONGEST:g}, but run from {grid[0]:g} "
            f"to {grid[-1]:g}; are they in µm? Multiply them by 1000"
        )
    source = SpectraSource(labels, **more)
    return Spectra(grid, given.get("reflectance"), given.get("transmittance"), source)


def check_fractions(values: Float[np.ndarray, "leaf band"], labels: tuple[str, ...]) -> None:
    """Raise `InputError` where a spectrum is in percent or digital numbers."""
    for row, label in zip(values, labels):
        known = row[np.isfinite(row)]
        if known.size and (middle := np.median(known)) > _PERCENT:
            raise InputError(
                f"spectra must be fractions of 0 to 1, but the median of {label!r} is "
                f"{middle:.4g}; is it in percent, or digital numbers? Divide first"
            )


def _numbers(values: Any, what: str) -> np.ndarray:
    try:
        array = np.asarray(values)
        return array if array.dtype.kind in "fiu" else array.astype(float)
    except (TypeError, ValueError) as error:
        raise InputError(
            f"expected {what}, but got {type(values).__name__}. Files are read by "
            "`fx.read_spectra`; within JAX's transformations use `prospect`"
        ) from error


def _table(given: Any, what: str) -> pd.DataFrame:
    """A row for each spectrum by its label, a column for each wavelength [nm], ascending."""
    if isinstance(given, pd.DataFrame):
        table = _upright(given, what)
    elif hasattr(given, "coords"):
        table = _of_array(given, what)
    else:
        raise InputError(
            f"expected {what} with labels, as the other, but got {type(given).__name__}"
        )
    for axis, kind in ((table.columns, "wavelength"), (table.index, "label")):
        if axis.has_duplicates:
            twice = axis[axis.duplicated()][0]
            raise InputError(f"the {kind} {twice} is there twice in {what}; number or drop one")
    try:
        return table.astype(float).sort_index(axis=1)
    except (TypeError, ValueError) as error:
        raise InputError(f"expected numbers in the table of {what}, but {error}") from error


def _of_array(array: Any, what: str) -> pd.DataFrame:
    """Spectra of a DataArray over `wavelength`, and one dimension more or none."""
    at = array.coords.get("wavelength")
    others = [] if at is None else [dim for dim in array.dims if dim not in at.dims]
    if at is None or at.ndim != 1 or len(others) > 1:
        raise InputError(
            f"expected {what} over spectra and a coordinate `wavelength` [nm], but it has the "
            f"dimensions {listed(map(str, array.dims)) or 'none'}"
        )
    (dim,) = others or ("spectrum",)
    array = array if others else array.expand_dims(dim)
    labels = array.indexes.get(dim, [f"leaf_{i + 1}" for i in range(array.sizes[dim])])
    return pd.DataFrame(array.transpose(dim, *at.dims).values, labels, at.values)


def _upright(table: pd.DataFrame, what: str) -> pd.DataFrame:
    """A table of pandas with wavelengths as columns.

    Wavelengths are the axis that is named so, else the only one whose labels are all numbers of 100
    to 50 000, be they texts.
    """
    if table.empty:
        raise InputError(f"expected spectra, but the table of {what} is empty: {table.shape}")
    axes = table.columns, table.index
    numbers = [np.asarray(pd.to_numeric(pd.Series(list(a)), errors="coerce"), float) for a in axes]
    named = [i for i in (0, 1) if str(axes[i].name).lower().startswith("wavelength")]
    inside = [
        i for i in named or (0, 1) if ((n := numbers[i]) >= _SHORTEST).all() and n.max() <= _LONGEST
    ]
    if len(inside) == 2:
        raise InputError(
            f"both columns and index of {what} could be wavelengths; name the right one: "
            'table.columns.name = "wavelength"'
        )
    if not inside:
        hints = [
            f"; are those of {n.min():g} to {n.max():g} in µm? Multiply them by 1000"
            for n in numbers if (n < _SHORTEST).all() and np.any(n % 1.0)
        ]  # fmt: skip
        words = [name for name, number in zip(axes[0], numbers[0]) if np.isnan(number)]
        of_bands = [name for name in words if str(name).lower().startswith("wavelength")]
        if of_bands or 0 < len(words) < 0.5 * len(axes[0]):
            hints.append(f"; first table.set_index({(of_bands or words)[0]!r})")
        raise InputError(
            f"expected a table of {what} with wavelengths [nm] as columns or as index, but neither "
            f"holds numbers of {_SHORTEST:g} to {_LONGEST:g} alone{''.join(hints[:1])}"
        )
    return (table.T if inside[0] else table).set_axis(numbers[inside[0]], axis=1)

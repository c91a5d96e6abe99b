"""Atmospheres that a user computed elsewhere (MODTRAN, libRadtran, 6S), from CSV or NetCDF."""

import re
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import xarray as xr

from fynjax._core.errors import InputError, listed, names_file, refusing
from fynjax._core.memory import bounded_memory
from fynjax._core.spectral import check_wavelength
from fynjax.app.io.raster import check_netcdf
from fynjax.app.io.text import did_you_mean, existing_file, open_table
from fynjax.sensors.air import Atmosphere

_KINDS = {
    "wavelength": "length",
    "direct": "irradiance",
    "diffuse": "irradiance",
    "upward_direct": "share",
    "upward_diffuse": "share",
    "upward_transmittance": "share",
    "path_radiance": "radiance",
    "spherical_albedo": "share",
}
_TOTAL = "upward_transmittance"
_APART = ("upward_direct", "upward_diffuse")
_EXAMPLES = {
    "length": "nm",
    "irradiance": "W m-2 um-1",
    "radiance": "W m-2 sr-1 um-1",
    "share": "1",
}
_POWER = {"w": 1.0, "mw": 1e-3, "uw": 1e-6}
_AREA = {"m-2": 1.0, "cm-2": 1e4}
_WIDTH = {"um-1": 1.0, "nm-1": 1e3, "micron-1": 1.0}
_SHARES = {"": 1.0, "1": 1.0, "-": 1.0, "fraction": 1.0, "%": 0.01, "percent": 0.01}
_LARGEST = {"length": 1e6, "irradiance": 4000.0, "radiance": 1500.0, "share": 1.0}
_BELOW = re.compile(r"(nm|um|micron|sr|cm|m)-?(\d?)")
_HEADER = re.compile(r"([A-Za-z_ ]++)(?:[\[(](.*)[\])])?")


@names_file
def read_atmosphere(path: str | Path) -> Atmosphere:
    r"""Read the curves of an atmosphere from CSV, or from NetCDF (`.nc`).

    A CSV file has one header row, `name [unit]` in each column, and rows in increasing wavelength;
    a NetCDF file has variables of the same names with an attribute `units`:

        wavelength [nm], direct [W m-2 um-1], diffuse [W m-2 um-1], upward_direct [1],
        upward_diffuse [1], path_radiance [W m-2 sr-1 um-1], spherical_albedo [1]

    `direct` and `diffuse` are irradiances of a horizontal black ground; `upward_direct` and
    `upward_diffuse` the transmittances from ground to sensor, unscattered and scattered (those of
    `fynjax.sensors.Atmosphere`). A file may have their sum alone instead, `upward_transmittance`:
    all of it then counts as direct, so that the surroundings light the ground by way of the
    spherical albedo but send no light into the line of sight, and dark pixels among bright ones are
    too dark.

    Irradiance and radiance may be in W, mW or µW, m-2 or cm-2, nm-1 or µm-1, written with exponents
    or with `/`; shares as fractions or in %. Lines that start with `#` are skipped.

    **Arguments:** `path`, the file.

    **Returns:** a `fynjax.sensors.air.Atmosphere` on the wavelengths of the file, in the units
    above.

    **Raises:** `InputError` with file, row and column: a missing curve, the sum of the upward
    transmittances beside its parts, a missing or unknown unit, wavelengths in µm or out of order, a
    value that is no number, negative, or impossibly large.

    >>> import pathlib, tempfile
    >>> from fynjax.app.io.instruments import read_atmosphere
    >>> text = '''wavelength [nm],direct [W/m2/nm],diffuse [W/m2/nm],upward_direct [%],\
    ... upward_diffuse [%],path_radiance [W m-2 sr-1 um-1],spherical_albedo
    ... 500,1.20,0.30,72,8,25,0.10
    ... 900,0.80,0.05,89,3,3,0.02'''
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = pathlib.Path(folder) / "air.csv"
    ...     _ = path.write_text(text)
    ...     air = read_atmosphere(path)
    >>> [round(float(value), 1) for value in air.direct]
    [1200.0, 800.0]
    """
    path = existing_file(path, "a file of atmospheric curves")
    suffix = path.suffix.lower()
    if suffix in (".nc", ".nc4", ".cdf"):
        columns, rows = _from_netcdf(path)
    else:
        columns, rows = _from_table(path)
    parts = [name for name in _APART if name in columns]
    if parts and _TOTAL in columns:
        raise InputError(
            f"expected {_TOTAL!r} or its parts {_APART[0]!r} and {_APART[1]!r}, but the file has "
            "both: leave one out",
            column=_TOTAL,
        )
    left_out = (_TOTAL,) if parts else _APART
    wanted = [name for name in _KINDS if name not in left_out]
    missing = [name for name in wanted if name not in columns]
    if missing:
        near = did_you_mean(missing[0], [name for name in columns if name not in _KINDS])
        hints = {
            "spherical_albedo": " A column of zeros leaves the light between ground and air out.",
            _TOTAL: f" Or give its parts, {_APART[0]!r} and {_APART[1]!r}.",
        }
        hint = hints.get(missing[0], "")
        words = f"expected a curve {missing[0]!r}, but the file has {listed(columns)}.{near}{hint}"
        raise InputError(words, column=missing[0])
    curves = {name: _converted(name, *columns[name], rows) for name in wanted}
    try:
        check_wavelength(curves["wavelength"])
    except InputError as error:
        raise InputError(str(error), column="wavelength") from error
    wavelength = curves.pop("wavelength")
    if _TOTAL in curves:
        curves["upward_direct"] = curves.pop(_TOTAL)
        curves["upward_diffuse"] = np.zeros_like(wavelength)
    return Atmosphere(tuple(wavelength), **{k: jnp.asarray(v) for k, v in curves.items()})


def _from_table(path: Path) -> tuple[dict[str, tuple[str | None, np.ndarray]], list[int]]:
    table = open_table(path, "an atmosphere")
    values = table.columns(range(table.width)).to_numpy()
    columns: dict[str, tuple[str | None, np.ndarray]] = {}
    for index, label in enumerate(table.names):
        match = _HEADER.fullmatch(label)
        name, unit = (match[1], match[2]) if match else (label, None)
        name = name.strip().lower().replace(" ", "_")
        if name in columns:
            raise InputError("this column is there twice", row=table.row, column=label)
        columns[name] = (unit, values[:, index])
    return columns, [row for row, _ in table.rows()]


def _from_netcdf(path: Path) -> tuple[dict[str, tuple[str | None, np.ndarray]], list[int]]:
    check_netcdf(path)
    words = "expected a NetCDF file, but cannot read it: {error}"
    with (
        refusing(OSError, RuntimeError, TypeError, ValueError, words=words),
        bounded_memory(path),
        xr.open_dataset(path, engine="netcdf4") as data,
    ):
        columns = {
            str(name): (variable.attrs.get("units"), np.asarray(variable.values, np.float64))
            for name, variable in data.variables.items()
            if str(name) in _KINDS or variable.ndim == 1
        }
    for name, (_, values) in columns.items():
        if name in _KINDS and values.ndim != 1:
            raise InputError(
                f"expected one value for each wavelength, but it has shape {values.shape}: choose "
                "one sun and sensor first",
                column=name,
            )
    return columns, []


def _converted(name: str, unit: str | None, values: np.ndarray, rows: list[int]) -> np.ndarray:
    """Values in the record's unit, checked."""
    kind = _KINDS[name]
    values = values * _factor(kind, unit, name)
    largest = _LARGEST[kind]
    wrong = ~np.isfinite(values) | (values < 0.0) | (values > largest)
    if wrong.any():
        at = int(np.argmax(wrong))
        hint = " Is the unit right?" if values[at] > largest else ""
        raise InputError(
            f"expected 0 to {largest:g} {_EXAMPLES[kind]}, but found {values[at]:g} "
            f"{_EXAMPLES[kind]}.{hint}",
            row=rows[at] if rows else None,
            column=name,
        )
    return values


def _factor(kind: str, unit: str | None, name: str) -> float:
    """What one of the file's units is in the record's."""
    example = _EXAMPLES[kind]
    if unit is None and kind != "share":
        words = f"expected a unit, such as '{name} [{example}]', but there is none"
        raise InputError(words, column=name)
    plain = str(unit or "").strip().lower().replace("µ", "u").replace("μ", "u")
    if kind == "share":
        factor = _SHARES.get(plain)
    elif kind == "length":
        if plain in ("um", "micron", "microns", "micrometer", "micrometre"):
            words = "expected wavelengths in nm, but the unit is µm: multiply by 1000"
            raise InputError(words, column=name)
        factor = 1.0 if plain in ("nm", "nanometer", "nanometre", "nanometers") else None
    else:
        factor = _spectral_factor(plain, kind)
    if factor is None:
        raise InputError(
            f"unknown unit {unit!r} of {kind if kind != 'share' else 'a share'}: write it like "
            f"'{example}'",
            column=name,
        )
    return factor


def _spectral_factor(unit: str, kind: str) -> float | None:
    """Factor of a spectral irradiance or radiance, or none if the unit is not one."""
    above, _, below = re.sub(r"[()^*]", "", unit).partition("/")
    parts = above.split() + [f"{m[1]}-{m[2] or 1}" for m in _BELOW.finditer(below)]
    steradians = parts.count("sr-1")
    parts = [part for part in parts if part != "sr-1"]
    if len(parts) != 3 or steradians != (1 if kind == "radiance" else 0):
        return None
    factor = 1.0
    for table in (_POWER, _AREA, _WIDTH):
        known = [part for part in parts if part in table]
        if len(known) != 1:
            return None
        factor *= table[known[0]]
    return factor

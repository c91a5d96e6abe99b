"""ENVI spectral libraries: a binary block of spectra with a text header."""

import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fynjax._core.errors import InputError
from fynjax.io.spectra._record import Spectrum, note

_DTYPES = {"1": "u1", "2": "i2", "3": "i4", "4": "f4", "5": "f8", "12": "u2", "13": "u4"}


_MICROMETRES = ("micro", "um", "µm")
_NANOMETRES = ("nano", "nm")
_UNSAID = ("", "unknown", "index")


def read_header(path: Path) -> dict[str, str]:
    """Keys and values of an ENVI header, keys in lower case; `InputError` where it is none."""
    text = path.read_text(encoding="utf-8", errors="replace")
    if not text.lstrip().upper().startswith("ENVI"):
        raise InputError("expected an ENVI header, which starts with the word ENVI", file=path)
    pairs = re.findall(r"^\s*([^=\n{}]+?)\s*=\s*(\{.*?\}|[^\n]*)", text, re.M | re.S)
    return {key.strip().lower(): value.strip().strip("{}").strip() for key, value in pairs}


def envi_pair(path: str | Path, suffixes: tuple[str, ...], what: str) -> tuple[Path, Path]:
    """Header and data file of an ENVI file, given one of them; raises `InputError` for a lost one.

    `suffixes` are those that a data file may have, `what` it is.
    """
    path = Path(path)
    if path.suffix.lower() != ".hdr":
        options = [path.with_suffix(".hdr"), path.with_name(path.name + ".hdr")]
        found = [p for p in options if p.is_file()]
        if not found:
            raise InputError(f"the ENVI header (.hdr) is missing beside this {what}", file=path)
        if not path.is_file():
            raise InputError("no such file", file=path)
        return found[0], path
    stem = path.with_suffix("")
    names = [stem, *(path.with_suffix(s) for s in suffixes)]
    names += [stem.with_suffix(s) for s in suffixes]
    data = next((p for p in names if p.is_file()), None)
    if data is None:
        raise InputError(f"the data file ({suffixes[0]}) is missing beside this header", file=path)
    if not path.is_file():
        raise InputError("no such file", file=path)
    return path, data


def header_wavelengths(header: dict[str, str], path: Path) -> tuple[NDArray[np.float64], float]:
    """Band centres of a header [nm], and the factor that made them nm of the file's numbers.

    Raises `KeyError` or `ValueError` where there are none, `InputError` for an unknown unit.
    """
    wavelength = np.array([float(x) for x in header["wavelength"].split(",")])
    unit = header.get("wavelength units", "").lower()
    if unit.startswith(_MICROMETRES) or (unit in _UNSAID and wavelength.max() < 100):
        return wavelength * 1000.0, 1000.0
    if not unit.startswith(_NANOMETRES) and unit not in _UNSAID:
        raise InputError(
            f"expected wavelengths in Nanometers or Micrometers, but the unit is {unit!r}",
            file=path,
            column="wavelength units",
        )
    if wavelength.max() < 100:
        raise InputError(
            f"the header says {unit!r}, but wavelengths end at {wavelength.max():g}; are they µm?",
            file=path,
        )
    return wavelength, 1.0


def read_envi_library(path: str | Path) -> list[Spectrum]:
    """Read an ENVI spectral library, given its data file or its header.

    **Raises:** `InputError` if one of the two files is missing, the header lacks a needed field, or
    the data are cut short.
    """
    header_path, data_path = envi_pair(path, (".sli", ".slb"), "library")
    header = read_header(header_path)
    try:
        bands, lines = int(header["samples"]), int(header["lines"])
        dtype = np.dtype(_DTYPES[header["data type"]])
        wavelength, converted = header_wavelengths(header, header_path)
    except (KeyError, ValueError) as error:
        raise InputError(
            f"the header needs samples, lines, data type and wavelength; wrong: {error}",
            file=header_path,
        ) from error
    if "librar" not in header.get("file type", "librar").lower():
        raise InputError(
            f"expected an ENVI spectral library, but this is {header['file type']!r}",
            file=header_path,
        )
    dtype = dtype.newbyteorder(">" if header.get("byte order", "0") == "1" else "<")
    raw = data_path.read_bytes()[int(header.get("header offset", "0")) :]
    if len(raw) < bands * lines * dtype.itemsize:
        raise InputError(
            f"the file is cut short: {lines} spectra of {bands} bands need "
            f"{bands * lines * dtype.itemsize} bytes, but it has {len(raw)}",
            file=data_path,
        )
    if len(wavelength) != bands:
        raise InputError(f"{len(wavelength)} wavelengths for {bands} bands", file=header_path)
    values = np.frombuffer(raw, dtype, bands * lines).reshape(lines, bands).astype(float)
    meta: dict = {"format": "ENVI spectral library"}
    scale = float(header.get("reflectance scale factor", "1") or 1)
    if scale != 1:
        values = values / scale
        note(meta, f"divided by the header's reflectance scale factor {scale:g}")
    if converted != 1.0:
        note(meta, "wavelengths converted from µm to nm")
    names = [n.strip() for n in header.get("spectra names", "").split(",") if n.strip()]
    names = names if len(names) == lines else [f"{data_path.stem}_{i + 1}" for i in range(lines)]
    ignore = header.get("data ignore value")
    if ignore is not None:
        values = np.where(values * scale == float(ignore), np.nan, values)
    return [
        Spectrum(name, wavelength, row, None, {**meta, "repairs": list(meta.get("repairs", []))})
        for name, row in zip(names, values)
    ]

"""ENVI headers and spectral libraries."""

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fynjax._core.errors import LARGEST, InputError, in_file, names_file, refusing
from fynjax._core.files import is_elsewhere, read_bytes
from fynjax.app.io.spectra._names import stated_quantity
from fynjax.app.io.spectra._record import (
    MeasuredSpectrum,
    as_fractions,
    in_nanometres,
    note,
    single_spectrum,
    without_marks,
)
from fynjax.app.io.text import stated_number

_INTERLEAVES = ("bsq", "bil", "bip")
"""Orders of the values in a data file: bands one by one, by line, by pixel."""
_TYPES = {
    **{"1": "u1", "2": "i2", "3": "i4", "4": "f4", "5": "f8", "6": "c8", "9": "c16"},
    **{"12": "u2", "13": "u4", "14": "i8", "15": "u8"},
}
"""NumPy's types by the numbers that `data type` has for them."""
_NO_HEADER = (
    "cannot be read as an ENVI header, which starts with the word ENVI and has samples, lines, "
    "bands and data type"
)


class Layout(NamedTuple):
    """Where the values are in the data file of an ENVI header."""

    nrows: int
    """Number of lines."""
    ncols: int
    """Number of samples in a line."""
    nbands: int
    """Number of bands."""
    offset: int
    """Number of bytes before the first value."""
    dtype: np.dtype
    """Type of a value, with its order of bytes."""


def _whole(value: Any) -> int:
    stated_number(value)
    return int(value)


def _fields(text: str) -> dict[str, Any]:
    """Fields of a header by their names; lines that start with a semicolon are remarks."""
    fields: dict[str, Any] = {}
    lines = iter([line for line in text.splitlines() if not line.startswith(";")])
    for line in lines:
        name, equals, value = (part.strip() for part in line.partition("="))
        if not equals:
            continue
        name = name.lower()
        fields[name] = value
        if value.startswith("{"):
            parts = [value]
            while not parts[-1].endswith("}"):
                if (more := next(lines, None)) is None:
                    raise ValueError(f"the brace of {name:.20} is never closed")
                parts.append(more.strip())
            within = "\n".join(parts)[1:-1]
            listed = [part.strip() for part in within.split(",")]
            fields[name] = within.strip() if name == "description" else listed
    return fields


def _layout(header: dict[str, Any]) -> Layout:
    kind, order = str(header["data type"]), _whole(header.get("byte order", 0))
    if kind not in _TYPES or order not in (0, 1):
        raise ValueError(f"no data type {kind:.20} or byte order {order}")
    lines, samples, bands = (_whole(header[name]) for name in ("lines", "samples", "bands"))
    offset = _whole(header.get("header offset", 0))
    if min(lines, samples, bands, offset) < 0:
        raise ValueError("a number of lines, samples, bands or bytes is negative")
    return Layout(lines, samples, bands, offset, np.dtype("<>"[order] + _TYPES[kind]))


@names_file
def read_header(path: Path) -> dict[str, Any]:
    """Fields of an ENVI header, names in lower case; what stands in braces is a list of texts.

    **Arguments:** `path`, the header file.

    **Returns:** the fields, and `layout`, the `Layout` of the data file.

    **Raises:** `InputError` where it is no ENVI header, lacks a field without which the data cannot
    be read, or has its values in an order that there is not.
    """
    text = read_bytes(path).decode("utf-8", "replace")
    try:
        if not text.lstrip().startswith("ENVI"):
            raise ValueError("it starts otherwise")
        header = _fields(text)
        layout = _layout(header)
        place = header.get("map info")
        for number in place[1:7] if isinstance(place, list) else ():
            try:  # GDAL takes 2 for 2.0D+05
                number and stated_number(number)
            except ValueError as error:
                raise ValueError(f"map info: {error}") from error
    except KeyError as error:
        raise InputError(f"{_NO_HEADER} ({error} is missing)") from error
    except ValueError as error:
        raise InputError(f"{_NO_HEADER} ({error})") from error
    order = str(header.get("interleave", "bsq")).strip()
    if order.lower() not in _INTERLEAVES:
        raise InputError(
            f"expected the interleave {' or '.join(_INTERLEAVES)}, but got {order[:20]!r}: how the "
            "values are ordered would be a guess"
        )
    return {**header, "layout": layout}


@names_file
def open_envi(
    path: str | Path, suffixes: tuple[str, ...], what: str
) -> tuple[dict[str, Any], Path, Path]:
    """Header and data file of an ENVI file, given either of them.

    **Arguments:**

    - `path`: the header or the data file.
    - `suffixes`: those that a data file may have.
    - `what`: names the file in errors, such as "image".

    **Returns:** fields of the header as of `read_header`, path of the header, path of the data.

    **Raises:** `InputError` where one of them is missing, or a link to another folder, or the data
    are cut short; as `read_header`.
    """
    path = Path(path)
    header_path, data = path, path
    if path.suffix.lower() == ".hdr":
        stem = path.with_suffix("")
        names = [stem, *(p.with_suffix(s) for s in suffixes for p in (path, stem))]
        lost = f"the data file ({suffixes[0]}) is missing beside this header"
        data = next((p for p in names if p.is_file()), path)
    else:
        names = [path.with_suffix(".hdr"), path.with_name(path.name + ".hdr")]
        lost = f"the ENVI header (.hdr) is missing beside this {what}"
        header_path = next((p for p in names if p.is_file()), path)
    if header_path == data:
        raise InputError(lost if path.is_file() else "no such file")
    for part in (header_path, data):
        if is_elsewhere(path, part):
            raise InputError(
                f"expected header and data in one folder, but {part.name} is a link to "
                "another. If you trust it, copy what it leads to: cp -L"
            )
    header = read_header(header_path)
    layout = header["layout"]
    cells = layout.nbands * layout.nrows * layout.ncols
    needed = int(layout.offset + cells * np.dtype(layout.dtype).itemsize)
    if (there := data.stat().st_size) < needed:
        raise InputError(
            f"the file is cut short: by its header it needs {needed} bytes, but it has {there}. "
            "Copy it again.",
            file=data,
        )
    return header, header_path, data


def header_numbers(
    header: dict[str, Any], key: str, count: int, default: float = np.nan
) -> NDArray[np.float64]:
    """A number for each band from a field of an ENVI header.

    **Arguments:**

    - `header`: fields, as of `read_header`.
    - `key`: name of the field.
    - `count`: number of bands.
    - `default`: of each band where the header has no such field.

    **Returns:** shape (`count`,).

    **Raises:** `InputError` for what is no number, and for another count.
    """
    if key not in header:
        return np.full(count, default)
    with refusing(ValueError, words="expected lists of numbers, but {error}", column=key):
        values = np.array([stated_number(value) for value in np.ravel(header[key]).tolist()])
    if (np.abs(values) > LARGEST).any():
        raise InputError(f"expected numbers within {LARGEST:g}", column=key)
    if values.size != count:
        words = f"expected {count} values, one for each band, but got {values.size}"
        raise InputError(words, column=key)
    return values


def good_bands(header: dict[str, Any], count: int) -> NDArray[np.bool_]:
    """Bands that are to be used by a header's list of bad bands, shape (`count`,); all without one.

    **Arguments:** `header`: fields, as of `read_header`; `count`: number of bands.

    **Raises:** `InputError` as `header_numbers`.
    """
    return header_numbers(header, "bbl", count, 1.0) != 0.0


def read_envi_library(path: str | Path) -> list[MeasuredSpectrum]:
    """Read an ENVI spectral library, given its data file or its header.

    **Raises:** `InputError` if one of the two files is missing, the header lacks a needed field, or
    the data are cut short.
    """
    header, header_path, data_path = open_envi(path, (".sli", ".slb"), "library")
    kind = header.get("file type", "ENVI Spectral Library")
    if "librar" not in str(kind).lower():
        raise InputError(f"expected an ENVI spectral library, but this is {kind!r}")
    layout = header["layout"]
    with in_file(header_path):
        if "wavelength" not in header:
            raise InputError("the header needs wavelength")
        stated = header_numbers(header, "wavelength", layout.ncols)
        good = good_bands(header, layout.ncols)
        wavelength, factor = in_nanometres(stated, header.get("wavelength units", ""))
        with refusing(TypeError, ValueError, words="expected a number, but {error}"):
            scale = stated_number(header.get("reflectance scale factor", 1.0))
            ignore = stated_number(header.get("data ignore value", "nan"))
    lines, bands = layout.nrows, layout.ncols
    values = np.fromfile(data_path, layout.dtype, lines * bands, offset=layout.offset)
    values = values.reshape(lines, bands).astype(float)
    meta: dict[str, Any] = {"format": "ENVI spectral library"}
    values = np.where((values == ignore) | ~good, np.nan, values)
    if not good.all():
        note(meta, f"{(~good).sum()} bands that the header's list calls bad set to missing")
    if scale != 1.0:
        note(meta, f"divided by the header's reflectance scale factor {scale:g}")
        values = without_marks(values, scale, meta) / scale
    else:
        values = as_fractions(values, meta)
    if factor != 1.0:
        note(meta, "wavelengths converted from µm to nm")
    names = header.get("spectra names", [])
    if len(names) != lines:
        names = [f"{data_path.stem}_{i + 1}" for i in range(lines)]
    titles = np.ravel(header.get("z plot titles", []))[1:2]
    with in_file(header_path):
        through = stated_quantity(f"Y units: {title}" for title in titles) == "transmittance"
    rows = zip(names, values)
    return [single_spectrum(name, wavelength, row, meta, through).noted() for name, row in rows]

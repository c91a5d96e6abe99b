"""Text of small spectrometers (Ocean Optics' SpectraSuite, OceanView, OOIBase32 and Jaz; Avantes'
AvaSoft) and of the spectral library of the USGS (splib06, splib07).

Their layout was taken from public files: those of the R package lightr's tests (GPL, none of which
is here), and U.S. Geological Survey Data Series 1035 (Kokaly et al. 2017).
"""

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from fynjax._core.errors import InputError, refusing
from fynjax._core.tables import is_number
from fynjax.app.io.spectra._names import stated_quantity
from fynjax.app.io.spectra._record import (
    MeasuredSpectrum,
    as_fractions,
    in_nanometres,
    note,
    single_spectrum,
)

_BEGIN = re.compile(r"[^>]*+>{3,}+ ?Begin [^<>]*Data ?<{3,}", re.I)
_END = re.compile(r"[^>]*+>{3,}+ ?End [^<>]*Data ?<{3,}", re.I)
_OCEAN = re.compile(
    r"(SpectraSuite|OOIBase32|Jaz|OceanView|Overture|Ocean Optics).*|Data from .* Node", re.I
)
_COLUMNS = {
    "wavelength": r"w|wave|wavelength|wl|nm|lambda",
    "dark": r"d|dark",
    "white": r"r|ref|reference|white",
    "sample": r"s|sample|scope|target|counts",
    "reflectance": r"p|processed|refl.*|r ?%",
    "transmittance": r"trans.*",
}
_PERCENT_FROM, _COUNTS_FROM = 1.5, 250.0
"""Median from which values are percent, and largest value of percent."""
_DELETED = -1e30
"""Values below it are deleted channels of the USGS, stated as -1.23e34."""
_RECORD = re.compile(rb"\s*splib\d\d\w* record", re.I)


def _numbers(line: str) -> list[float] | None:
    """The numbers of a line; None of one with words, or without any."""
    marks = r"[;\t ]+" if ";" in line or "\t" in line else r"[, ]+"
    cells = [cell for cell in re.split(marks, line.strip()) if cell]
    if not cells or not all(map(is_number, cells)):
        return None
    return [float(cell.replace(",", ".")) for cell in cells]


def _roles(line: str) -> dict[str, int]:
    """Which column holds what, by a line of their names."""
    marks = ";" if ";" in line else "\t" if "\t" in line else ","
    cells = [cell.strip() for cell in line.split(marks)]
    if len(cells) == 1:
        cells = line.split()
    found: dict[str, int] = {}
    for i, cell in enumerate(cells):
        plain = re.split(r"[\[(]", cell)[0].rstrip().lower()
        role = next((role for role, words in _COLUMNS.items() if re.fullmatch(words, plain)), "")
        found.setdefault(role, i)
    return {role: i for role, i in found.items() if role}


def read_small_spectrometer(data: bytes, file: Path) -> MeasuredSpectrum | None:
    """The spectrum of a text file of Ocean Optics or Avantes; `None` where it is neither.

    Their processed values are taken where there are any, in percent or as fractions by their size;
    else reflectance is formed of sample, white reference and dark.

    **Arguments:** `data`: content of the file; `file`: names the spectrum.

    **Raises:** `InputError` for counts without a reference, and a file without values.
    """
    lines = data.decode().splitlines()
    begin = next((i for i, line in enumerate(lines[:200]) if _BEGIN.match(line)), None)
    first = next((i for i, line in enumerate(lines[:200]) if len(_numbers(line) or ()) > 1), None)
    if begin is not None:
        start, maker = begin + 1, "Ocean Optics"
    elif first is not None and any(_OCEAN.match(line.strip()) for line in lines[:3]):
        start, maker = first, "Ocean Optics"
    else:
        start, maker = first or 0, "Avantes"
    if first is None:
        if begin is None:
            return None
        raise InputError("the file has a header but no values; is it cut short?")
    above = lines[max(0, start - 3) : max(start, first)]
    named = (r for line in reversed(above) if len(r := _roles(line)) > 1 and "wavelength" in r)
    roles = next(named, {})
    raw = {"dark", "white", "sample"} & set(roles)
    of_leaf = {"reflectance", "transmittance"} & set(roles)
    counts = any("counts" in line.lower() for line in above)
    if maker == "Avantes" and len(raw) + bool(of_leaf) < (1 if counts and raw else 3):
        return None
    rows = []
    for line in lines[max(start, first) :]:
        if _END.match(line):
            break
        numbers = _numbers(line)
        if numbers is not None:
            rows.append(numbers)
        elif line.strip():
            raise InputError(f"expected numbers, but got {line.strip()!r:.60}")
    width = min(map(len, rows))
    values = np.array([row[:width] for row in rows])
    meta: dict[str, Any] = {"format": f"text of {maker}"}
    return _reflectance(file, values, roles, lines[:start], meta, above)


def _reflectance(
    file: Path,
    values: np.ndarray,
    roles: dict[str, int],
    head: Sequence[str],
    meta: dict[str, Any],
    above: Sequence[str],
) -> MeasuredSpectrum:
    wavelength = values[:, roles.get("wavelength", 0)]
    raw = [roles.get(role, -1) for role in ("sample", "white", "dark")]
    of_leaf = [roles[role] for role in ("reflectance", "transmittance") if role in roles]
    processed = of_leaf[0] if of_leaf else None
    if processed is None and not roles:
        processed = 1
    stated = " ".join(line.partition(":")[2] for line in head).lower()
    through = "transmittance" in roles or "transm" in stated
    shown = None if processed is None else values[:, processed]
    usable = shown is not None and np.isfinite(shown).all() and np.abs(shown).max() > 0.0
    if usable and processed is not None:
        found = values[:, processed]
        through |= stated_quantity(head) == "transmittance"
        inside = (wavelength >= 450.0) & (wavelength <= 950.0)
        typical = float(np.median(found[inside] if inside.any() else found))
        if typical > _COUNTS_FROM:
            raise InputError(
                f"the values are counts (median {typical:g}), not reflectance: take the spectrum "
                "again with a dark and a white reference, in the program's mode for reflectance"
            )
        if typical > _PERCENT_FROM or any("%" in line for line in above):
            found = found / 100.0
            note(meta, "converted from percent, which the values are by their size")
    elif min(raw) >= 0:
        sample, white, dark = (values[:, at] for at in raw)
        with np.errstate(divide="ignore", invalid="ignore"):
            found = np.where(white != dark, (sample - dark) / (white - dark), np.nan)
        note(meta, "reflectance formed of sample, white reference and dark")
    else:
        raise InputError(
            "expected reflectance, but the file has counts of "
            f"{', '.join(role for role in roles if role != 'wavelength')} only: save it in the "
            "program's mode for reflectance, with a dark and a white reference"
        )
    noise = (wavelength < 350.0) | (np.abs(found) > 2.0)
    if noise.any() and not noise.all():
        note(meta, f"{noise.sum()} bands below 350 nm, or without light, set to missing")
        found = np.where(noise, np.nan, found)
    return single_spectrum(file.stem, wavelength, found, meta, through)


# -- JCAMP-DX ----------------------------------------------------------------------------------


def read_jcamp(data: bytes, file: Path) -> MeasuredSpectrum | None:
    """The spectrum of a JCAMP-DX file (4.24, in plain numbers); `None` where it is none.

    **Arguments:** `data`: content of the file; `file`: names the spectrum.

    **Raises:** `InputError` for compressed numbers, another quantity, and wavelengths in a unit
    that is neither nm, µm nor cm-1.
    """
    text = data.decode()
    if not re.match(r"\s*##TITLE=", text, re.I):
        return None
    parts = (part.partition("=") for part in re.sub(r"\$\$.*", "", text).split("##")[1:])
    head = {key.strip().upper(): value.strip() for key, _, value in parts}
    form, _, rows = next(
        (head[key].partition("\n") for key in ("XYDATA", "XYPOINTS") if key in head), ("", "", "")
    )
    cells = [re.split(r"[,;\s]+", row.strip(" ,;\t\r")) for row in rows.splitlines() if row.strip()]
    if not cells or not all(is_number(cell) for row in cells for cell in row):
        raise InputError(
            "expected a JCAMP-DX spectrum of plain numbers, but they are compressed or missing: "
            "export it as text of two columns (.csv) from the instrument's program"
        )
    with refusing(KeyError, ValueError, words="expected a number in the head, but got {error}"):
        scales = [float(head.get(key, 1.0)) for key in ("XFACTOR", "YFACTOR")]
        if "++" in form:  # each row has the first wavelength, and values at equal steps
            values = np.array([float(cell) for row in cells for cell in row[1:]])
            wavelength = np.linspace(float(head["FIRSTX"]), float(head["LASTX"]), values.size)
        else:
            numbers = np.array([float(cell) for row in cells for cell in row])
            wavelength, values = numbers[: numbers.size // 2 * 2].reshape(-1, 2).T
            wavelength = scales[0] * wavelength
        if (count := int(float(head.get("NPOINTS", values.size)))) != values.size:
            raise InputError(
                f"expected {count} values as the header says, but found {values.size}; "
                "is the file cut short?"
            )
    meta: dict[str, Any] = {"format": "JCAMP-DX"}
    unit = head.get("XUNITS", "").lower()
    if "1/cm" in unit or "cm-1" in unit:
        wavelength = 1e7 / wavelength
        note(meta, "wavelengths converted from wave numbers to nm")
    else:
        wavelength, _ = in_nanometres(wavelength, unit)
    quantity = stated_quantity([f"Y units: {head.get('YUNITS', '')}"])
    values = as_fractions(scales[1] * values[None], meta)[0]
    name = head.get("TITLE") or file.stem
    return single_spectrum(name, wavelength, values, meta, quantity == "transmittance")


# -- the library of the USGS -----------------------------------------------------------------


def _record(data: bytes) -> tuple[str, np.ndarray] | None:
    """Title and values of a file of the USGS library; None of another."""
    if not _RECORD.match(data):
        return None
    title, _, rest = data.decode(errors="replace").partition("\n")
    cells = rest.split()
    if not all(map(is_number, cells)):
        return None
    values = np.array(cells, float)
    return title.strip(), np.where(values < _DELETED, np.nan, values)


def read_usgs(data: bytes, file: Path) -> MeasuredSpectrum | None:
    """The spectrum of a file of the USGS library, whose wavelengths are in another file of its
    folder, or of the folder above it; `None` where it is none.

    **Arguments:** `data`: content of the file; `file`: names the spectrum.

    **Raises:** `InputError` for a file of wavelengths or of errors, and where no file beside has
    as many wavelengths.
    """
    found = _record(data)
    if found is None:
        return None
    title, values = found
    if re.search(r"wavelengths|bandpass|error ?bars?|resolution|wavenumber", title, re.I):
        raise InputError(
            f"expected a spectrum, but {title!r:.80} is what others of the library need: give "
            "theirs alone"
        )
    for folder in (file.parent, file.parent.parent):
        for other in sorted(folder.glob("*.txt")):
            if other == file or "wave" not in other.name.lower():
                continue
            beside = _record(other.read_bytes())
            if beside is None or len(beside[1]) != len(values):
                continue
            if "wavelengths" in beside[0].lower():
                wavelength = beside[1]
                factor = 1000.0 if np.nanmax(wavelength) < 300.0 else 1.0
                meta: dict[str, Any] = {"format": "USGS spectral library", "title": title}
                note(meta, f"wavelengths from {other.name}, beside it")
                name = re.sub(r"^splib\w* record=?\d*:? *", "", title, flags=re.I)
                name = " ".join(name.split()) or file.stem
                return single_spectrum(name, factor * wavelength, values, meta, through=False)
    raise InputError(
        f"a file of the USGS library ({title:.60}) holds {len(values)} values without their "
        "wavelengths, which are in another: put that (splib07a_Wavelengths_..., with as many "
        f"values) beside it, or both side by side: paste wavelengths.txt {file.name} > both.txt"
    )

"""Spectra in text: columns of spectra, rows of spectra, and the ECOSTRESS library's own layout."""

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from fynjax._core.errors import InputError
from fynjax._core.tables import TextTable, is_number, open_table, trimmed, without_header
from fynjax.app.io.spectra._layout import (
    NAME_KEYS,
    WAVELENGTH,
    TableLayout,
    check_not_numbers_alone,
    layout_of,
)
from fynjax.app.io.spectra._names import leaves_only, marked, unsure
from fynjax.app.io.spectra._record import MeasuredSpectrum, in_nanometres, note, single_spectrum

_UNITS = {
    "µm": re.compile(r"(?<![a-z])[uµμ]m\b|micro", re.I),
    "nm": re.compile(r"\bnm\b|_nm|nano", re.I),
}
"""How a header names the unit of wavelengths."""
_OTHER_UNITS = (
    (re.compile(r"cm ?\^?([-−]1|⁻¹)|wave[ _]?number|1/cm", re.I), "wave numbers", -1, 1e7),
    (re.compile(r"[(\[](å|a)[)\]]|[åa]ngstr", re.I), "ångström", 1, 0.1),
)
"""How a header names another unit: the power of the numbers, and the factor, that give nm."""
MISSING = {"", "na", "nan", "null", "none", "-", "#n/a", "-999", "-9999", "-9999.0", "-999.0"}
"""What stands for a missing value, in small letters."""
_PERCENT = 1.5, 110.0
"""What a twentieth of a spectrum in percent is above, and what it is not [%]."""
_REFLECTIVE = 2600.0
"""Wavelength [nm] above which no spectrometer of reflected sunlight has a band."""


def _to_nm(wavelength: np.ndarray, label: str, meta: dict[str, Any]) -> np.ndarray:
    """Wavelengths in nm by the unit in a header, or, where it has none, by their size."""
    for sign, words, power, nm in _OTHER_UNITS:
        if sign.search(label) and np.all(wavelength > 0.0):
            note(meta, f"wavelengths converted from {words} to nm")
            return nm * wavelength**power
    unit = next((unit for unit, sign in _UNITS.items() if sign.search(label)), "")
    wavelength, factor = in_nanometres(wavelength, unit)
    if not unit and factor == 1.0 and wavelength.min() > _REFLECTIVE:
        raise InputError(
            f"expected wavelengths in nm, but they run from {wavelength.min():g} to "
            f"{wavelength.max():g} and the header has no unit; are they wave numbers or ångström? "
            "Write 'cm-1', 'Å' or, if it is so, 'nm' behind the name of the column"
        )
    if factor != 1.0:
        note(
            meta, f"wavelengths converted from µm{'' if unit else ', as all are below 100,'} to nm"
        )
    return wavelength


def _percent(label: str) -> bool:
    return "%" in label or "percent" in label.lower()


def _as_fractions(values: np.ndarray, meta: dict[str, Any]) -> np.ndarray:
    """Values [spectrum, band] of a table that states no unit, from percent where every spectrum has
    such numbers."""
    known = values[np.isfinite(values).any(axis=1)]
    if not known.size:
        return values
    high = np.nanpercentile(known, 95.0, axis=1)
    if np.nanmedian(known) <= _PERCENT[0] or high.min() <= _PERCENT[0] or high.max() > _PERCENT[1]:
        return values
    note(meta, f"converted from percent, which values up to {np.nanmax(known):.3g} are")
    return values / 100.0


def _library(table: TextTable, keys: dict[str, str]) -> MeasuredSpectrum:
    """The spectrum of a file of the ECOSTRESS library, below its header of `keys`."""
    meta = {"format": "ECOSTRESS", "header": keys}
    wavelength, values = table.columns([0, 1]).to_numpy().T
    stated = re.match(r"\d+", keys.get("number of x values", ""))
    if stated and stated[0].lstrip("0") != str(len(values)):
        raise InputError(
            f"expected {stated[0][:20]} values as the header says, but found {len(values)}; "
            "is the file cut short?"
        )
    wavelength = _to_nm(wavelength, keys.get("x units", keys.get("first column", "")), meta)
    label = keys.get("y units", keys.get("second column", ""))
    if _percent(label):
        values = values / 100.0
        note(meta, "reflectance converted from percent")
    through = "transm" in (label + keys.get("measurement", "")).lower()
    return single_spectrum(keys.get("name") or table.path.stem, wavelength, values, meta, through)


def _paired(
    columns: dict[str, np.ndarray], wavelength: np.ndarray, meta: dict, stem: str
) -> list[MeasuredSpectrum]:
    """Spectra from named columns; a transmittance column joins the reflectance of its name."""
    records: dict[str, dict[str, Any]] = {}
    names = {n: re.sub(r"\(?%\)?|\[%\]|percent", "", n, flags=re.I).strip(" _") for n in columns}
    doubtful = unsure(names.values())
    if not any(map(_percent, columns)):
        values = _as_fractions(np.array([*columns.values()]), meta)
        columns = dict(zip(columns, values, strict=True))
    for label, values in columns.items():
        row_meta = {**meta, "repairs": list(meta.get("repairs", []))}
        if _percent(label):
            values = values / 100.0
            note(row_meta, "converted from percent as the header says")
        quantity, base, _ = marked(names[label], names.values())
        if names[label] in doubtful:
            quantity, base = "", names[label]
        kind = quantity or "reflectance"
        record = records.setdefault(base or stem, {"meta": row_meta})
        if kind in record:  # two columns whose names differ only in case or marks
            record = records.setdefault(label, {"meta": row_meta})
        record[kind] = values
    return [
        MeasuredSpectrum(name, wavelength, r.get("reflectance"), r.get("transmittance"), r["meta"])
        for name, r in records.items()
    ]


def _by_row(table: TextTable, layout: TableLayout) -> list[MeasuredSpectrum]:
    """Wide layout: one row a spectrum, wavelengths as column names."""
    header, file, bands = table.names, table.path, layout.bands
    meta: dict[str, Any] = {"format": "table, one row a spectrum"}
    meta["layout"] = f"{layout.words}: {layout.evidence[0]}"
    wavelength = _to_nm(np.array(list(bands.values())), layout.unit, meta)
    others = [i for i in range(len(header)) if i not in bands]
    labels = [name.lower() for name in header]
    name_at = next((i for i in others if labels[i] in NAME_KEYS), others[0] if others else None)
    frame = table.columns(list(bands), others, MISSING)
    texts = frame[others].to_dict("records")
    quantities = {i: {marked(cell)[0] for cell in frame[i] if not marked(cell)[1]} for i in others}
    kind_at = next((i for i in others if "transmittance" in quantities[i]), None)
    records: dict[str, MeasuredSpectrum] = {}
    rows: list[int] = []
    table_values = _as_fractions(frame[list(bands)].to_numpy(), meta)
    for number, (values, cells) in enumerate(zip(table_values, texts), start=1):
        name = (cells[name_at] if name_at is not None else "") or f"{file.stem}_{number}"
        row_meta = {**meta, "repairs": list(meta.get("repairs", []))}
        row_meta["columns"] = {header[i]: cells[i] for i in others}
        kind = "" if kind_at is None else marked(cells[kind_at])[0]
        if kind_at is not None and not kind:
            name = f"{name} {cells[kind_at]}"
        through = kind == "transmittance"
        old = records.get(name)
        if old is not None and through and old.transmittance is None:
            records[name] = replace(old, transmittance=values)
            continue
        if old is not None and not through and old.reflectance is None:
            records[name] = replace(old, reflectance=values)
            continue
        if old is not None:
            rows = rows or [row for row, _ in table.rows()]
        unique = name if old is None else f"{name}_row{rows[number - 1]}"
        records[unique] = single_spectrum(unique, wavelength, values, row_meta, through)
    return list(records.values())


def _by_column(table: TextTable, above: list[list[str]], at: int) -> list[MeasuredSpectrum]:
    """One column a spectrum, behind the column `at` of wavelengths, before which rows are numbered;
    `above` stands over the numbers."""
    file = table.path
    if len(above[-1:] and above[-1]) < 2:
        above = [row for row in above if len(row) > 1]
    labelled = (r for r in above if len(r) > at and WAVELENGTH.match(r[at]))
    label_row = next(labelled, above[0] if above else [])
    named_row = next((r for r in above if r[0].lower().strip(":") in NAME_KEYS), label_row)
    header = trimmed(named_row)
    if header and (above == [named_row] or WAVELENGTH.match(header[at])):
        table.names, table.headed = tuple(header), True
    elif len(header) != table.width:  # a title
        header = []
    if not header:
        without_header(table, table.names, 2)
    width = table.width
    names = [name or f"{file.stem}_{i}" for i, name in enumerate(header or [""] * width)]
    if width == 2 and not header:
        names[1] = file.stem
    table.names = (*names[:at], "wavelength", *names[at + 1 :])
    frame = table.columns(range(at, width), (), MISSING)
    meta: dict[str, Any] = {"format": "table, one column a spectrum"}
    wavelength = _to_nm(frame[at].to_numpy(), label_row[at] if len(label_row) > at else "", meta)
    if any(name.endswith(".asd") for name in names[at + 1 :]):
        meta["panel"] = "unknown"  # as of the binary, whose export it is
    columns: dict[str, np.ndarray] = {}
    for i in range(at + 1, width):
        name = names[i].removesuffix(".asd")
        columns[name if name not in columns else f"{name}_{i}"] = frame[i].to_numpy()
    return _paired(columns, wavelength, meta, file.stem)


def read_text_spectra(data: bytes, file: Path) -> list[MeasuredSpectrum]:
    """Read spectra from a table of any layout that `read_spectra` lists.

    **Arguments:** `data`: content of the file; `file`: it names a spectrum without a name.

    **Raises:** `InputError` as `open_table`, for a table without wavelengths, and with row and
    column of what cannot be read.
    """
    table = open_table(file, "a table of spectra", data=data, titled=False)
    header = table.names
    if next(table.rows(), None) is not None:
        layout = layout_of(table)
        if layout.by_row:
            return leaves_only(_by_row(table, layout))
    else:
        layout = None
    start = None
    above: list[tuple[int, list[str]]] = []
    for row, cells in table.rows(0):
        if len(cells) > 1 and is_number(cells[0]):
            start = row
            table.names = tuple(trimmed(cells))
            break
        above.append((row, cells))
    if start is None:
        check_not_numbers_alone(table)
        raise InputError(
            "unknown format: neither a column of wavelengths nor wavelengths as column names"
        )
    table.skip, table.headed = start - 1, False
    lines = (table.line(row).partition(":") for row, _ in above[:60])
    keys = {key.strip().lower(): value.strip() for key, mark, value in lines if mark}
    if "first column" in keys or "x units" in keys:
        return [_library(table, keys)]
    titles = [cells for _, cells in above]
    if table.separator == " ":  # names may hold single ones
        for k, (row, cells) in enumerate(above):
            if len(cells) > table.width:
                titles[k] = re.split(r"\t+ *| {2,}", table.line(row))
    if len(titles) == 1 and len(titles[0]) == table.width - 1 and header[:1] == ("",):
        titles = [list(header)]  # R names no column of row names
    at = layout.at if layout is not None and len(above) == 1 and layout.at < table.width - 1 else 0
    found = _by_column(table, titles, at)
    if layout is not None:
        words = f"{layout.words}: {layout.evidence[0]}"
        found = [one.noted(meta={"layout": words}) for one in found]
        if layout.rejected and found:
            found[0] = found[0].noted(f"taken as {words}; not {layout.rejected[0]}")
    return leaves_only(found)

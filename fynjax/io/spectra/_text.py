"""Spectra in text: columns of spectra, rows of spectra, and the ECOSTRESS library's own layout."""

import csv
import re
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from fynjax._core.errors import InputError
from fynjax.io.spectra._record import MeasuredSpectrum, note

_NUMBER = re.compile(r"^[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?$")
_WAVELENGTH = re.compile(r"^(wave[ _]?length|wavelen|wvl?|wl|lambda|nm|[uµμ]m|x)\b", re.I)
_BAND_NAME = re.compile(r"^(?:[A-Za-z_. ]{0,12}?)(\d{3,4}(?:\.\d+)?|[0-2]\.\d+)\s*_?(nm|[uµμ]m)?$")
# What is left of plain numbers between commas: no sign, since -999 may mean a missing value.
_PLAIN = dict.fromkeys(map(ord, "0123456789.,eE "))
_MISSING = {"", "na", "nan", "null", "none", "-", "#n/a", "-999", "-9999", "-9999.0", "-999.0"}
_NAME_KEYS = ("name", "id", "sample", "sample_id", "spectrum", "spectra", "file name", "filename")
_TRAN = re.compile(r"(^|[ _.\-(])(t|tran|trans|transm|transmittance|tau)(?=$|[ _.\-)%])", re.I)
_REFL = re.compile(r"(^|[ _.\-(])(r|refl|reflectance|rho)(?=$|[ _.\-)%])", re.I)


class _Rows(Sequence[list[str]]):
    """Rows of cells, split when asked for: thousands of spectra would not fit as text cells."""

    def __init__(
        self, lines: list[str], split: Callable[[str], list[str]], *, commas: bool = False
    ) -> None:
        self._lines, self._split, self._commas = lines, split, commas

    def __len__(self) -> int:
        return len(self._lines)

    def __getitem__(self, at: Any) -> Any:
        if isinstance(at, slice):
            return _Rows(self._lines[at], self._split, commas=self._commas)
        return self._split(self._lines[at])

    def numbers(self, at: int, first: int, count: int) -> tuple[list[str], np.ndarray] | None:
        """The cells of a row before column `first`, and the `count` numbers that are all the rest.

        None unless those are plain numbers between commas: a tenth of the time of cells.
        """
        line = self._lines[at]
        *before, rest = line.split(",", first)
        signs = rest.replace("e-", "e").replace("E-", "E") if "-" in rest else rest
        if not self._commas or '"' in line or len(before) != first or signs.translate(_PLAIN):
            return None
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("error", DeprecationWarning)
                values = np.fromstring(rest, sep=",")
        except (DeprecationWarning, ValueError):  # an empty cell, or one with two points
            return None
        return ([cell.strip() for cell in before], values) if values.size == count else None


def _rows(text: str) -> _Rows:
    lines = [
        line for line in text.splitlines() if line.strip() and not line.lstrip().startswith("#")
    ]
    sample = lines[: min(len(lines), 60)]
    counts = {sep: sum(line.count(sep) for line in sample) for sep in ("\t", ";", ",")}
    sep = max(counts, key=lambda s: counts[s])
    for other in ("\t", ";"):
        # Commas may be decimal points: one more in a line than the columns are separated by.
        if counts[other] >= len(sample) / 2 and counts[","] <= counts[other] + len(sample):
            sep = other
    if counts[sep] == 0:
        return _Rows(lines, str.split)
    comma = re.compile(r"^[+-]?\d*,\d+([eE][+-]?\d+)?$")

    def split(line: str) -> list[str]:
        cells = [cell.strip() for cell in next(csv.reader([line], delimiter=sep))]
        if sep != ",":
            cells = [c.replace(",", ".") if comma.match(c) else c for c in cells]
        return cells

    return _Rows(lines, split, commas=sep == ",")


def cell_value(cell: str, file: Path, row: int, column: str) -> float:
    """The number in a cell; NaN for the marks of a missing value."""
    if cell.lower() in _MISSING:
        return float("nan")
    if not _NUMBER.match(cell):
        raise InputError(
            f"expected a number, but found {cell!r}", file=file, row=row, column=column
        )
    return float(cell)


def _to_nm(wavelength: np.ndarray, label: str, meta: dict[str, Any], file: Path) -> np.ndarray:
    says_um = bool(re.search(r"[uµμ]m\b|micro", label, re.I))
    says_nm = bool(re.search(r"\bnm\b|_nm|nano", label, re.I))
    highest = float(np.nanmax(wavelength))
    if says_um and highest < 100.0:
        note(meta, "wavelengths converted from µm to nm")
        return wavelength * 1000.0
    if says_um:
        raise InputError(
            f"the header {label!r} says µm, but wavelengths run to {highest:g}; are they in nm?",
            file=file,
        )
    if highest < 100.0:
        if says_nm:
            raise InputError(
                f"the header {label!r} says nm, but wavelengths end at {highest:g}; are they µm? "
                "Name the column wavelength_um",
                file=file,
            )
        note(meta, "wavelengths below 100 taken as µm and converted to nm")
        return wavelength * 1000.0
    return wavelength


def _percent(label: str) -> bool:
    return "%" in label or "percent" in label.lower()


def _ecostress(text: str, file: Path) -> list[MeasuredSpectrum] | None:
    head, keys = text.splitlines()[:60], {}
    for line in head:
        if ":" in line:
            key, _, value = line.partition(":")
            keys[key.strip().lower()] = value.strip()
    if "first column" not in keys and "x units" not in keys:
        return None
    rows = []
    for number, line in enumerate(text.splitlines(), 1):
        cells = line.split()
        if len(cells) == 2 and _NUMBER.match(cells[0]) and _NUMBER.match(cells[1]):
            rows.append((float(cells[0]), float(cells[1])))
        elif rows and line.strip():
            raise InputError("expected wavelength and reflectance", file=file, row=number)
    if not rows:
        raise InputError("the library file has a header but no values; is it cut short?", file=file)
    meta: dict[str, Any] = {"format": "ECOSTRESS", "header": keys}
    table = np.array(rows)
    stated = re.match(r"\d+", keys.get("number of x values", ""))
    if stated and stated[0].lstrip("0") != str(len(table)):
        raise InputError(
            f"expected {stated[0][:20]} values as the header says, but found {len(table)}; "
            "is the file cut short?",
            file=file,
        )
    wavelength = _to_nm(table[:, 0], keys.get("x units", keys.get("first column", "")), meta, file)
    label = keys.get("y units", keys.get("second column", ""))
    values = table[:, 1]
    if _percent(label):
        values = values / 100.0
        note(meta, "reflectance converted from percent")
    through = "transm" in (label + keys.get("measurement", "")).lower()
    name = keys.get("name", file.stem) or file.stem
    return [
        MeasuredSpectrum(
            name, wavelength, None if through else values, values if through else None, meta
        )
    ]


def _paired(
    columns: dict[str, np.ndarray], wavelength: np.ndarray, meta: dict, stem: str
) -> list[MeasuredSpectrum]:
    """Spectra from named columns; a transmittance column joins the reflectance of its name."""
    records: dict[str, dict[str, Any]] = {}
    for label, values in columns.items():
        row_meta = {**meta, "repairs": list(meta.get("repairs", []))}
        if _percent(label):
            values = values / 100.0
            note(row_meta, "converted from percent as the header says")
        clean = re.sub(r"\(?%\)?|\[%\]|percent", "", label, flags=re.I).strip(" _")
        # Where a name has several such marks, as 'leaf R 3_T', the last one tells.
        marks = [*_REFL.finditer(clean), *_TRAN.finditer(clean)]
        match = max(marks, key=lambda m: m.start(2), default=None)
        through = match is not None and match.re is _TRAN
        kind = "transmittance" if through else "reflectance"
        base = (clean[: match.start()] + clean[match.end() :]).strip(" _.-()") if match else clean
        record = records.setdefault(base or stem, {"meta": row_meta})
        if kind in record:  # two columns whose names differ only in case or marks
            record = records.setdefault(label, {"meta": row_meta})
        record[kind] = values
    return [
        MeasuredSpectrum(name, wavelength, r.get("reflectance"), r.get("transmittance"), r["meta"])
        for name, r in records.items()
    ]


def _by_row(rows: _Rows, bands: dict[int, float], unit: str, file: Path) -> list[MeasuredSpectrum]:
    """Wide layout: one row a spectrum, wavelengths as column names."""
    header, base = rows[0], {"format": "table, one row a spectrum"}
    meta: dict[str, Any] = dict(base)
    wavelength = _to_nm(np.array(list(bands.values())), unit, meta, file)
    others = [i for i in range(len(header)) if i not in bands]
    name_at = next(
        (i for i in others if header[i].lower() in _NAME_KEYS), others[0] if others else None
    )
    kind_at = next(
        (i for i in others if header[i].lower() in ("measurement", "type", "kind")), None
    )
    records: dict[str, MeasuredSpectrum] = {}
    # Bands behind everything else are read at once.
    last = others == list(range(len(others)))
    for number in range(2, len(rows) + 1):
        plain = rows.numbers(number - 1, len(others), len(bands)) if last else None
        if plain is not None:
            row, values = plain
        else:
            row = rows[number - 1]
            if len(row) < len(header):
                raise InputError(
                    f"expected {len(header)} columns, but found {len(row)}; is the file cut short?",
                    file=file, row=number,
                )  # fmt: skip
            values = np.array([cell_value(row[i], file, number, header[i]) for i in bands])
        name = row[name_at] if name_at is not None and row[name_at] else f"{file.stem}_{number - 1}"
        row_meta = {**meta, "repairs": list(meta.get("repairs", []))}
        row_meta["columns"] = {header[i]: row[i] for i in others}
        through = kind_at is not None and row[kind_at].lower().startswith("t")
        old = records.get(name)
        if old is not None and through and old.transmittance is None:
            records[name] = MeasuredSpectrum(name, wavelength, old.reflectance, values, old.meta)
            continue
        if old is not None and not through and old.reflectance is None:
            records[name] = MeasuredSpectrum(name, wavelength, values, old.transmittance, old.meta)
            continue
        unique = name if old is None else f"{name}_row{number}"
        records[unique] = MeasuredSpectrum(
            unique, wavelength, None if through else values, values if through else None, row_meta
        )
    return list(records.values())


def read_text_spectra(text: str, file: Path) -> list[MeasuredSpectrum]:
    """Read spectra from text of any layout that `read_spectra` lists."""
    library = _ecostress(text, file)
    if library is not None:
        return library
    rows = _rows(text)
    header = rows[0]
    named = {i: _BAND_NAME.match(cell) for i, cell in enumerate(header)}
    bands = {i: float(m[1]) for i, m in named.items() if m}
    if (
        len(bands) >= 10
        and len(rows) > 1
        and not all(_NUMBER.match(c) for c in header[:1] + rows[1][:1])
    ):
        units = {m[2] for m in named.values() if m and m[2]}
        return _by_row(rows, bands, " ".join(sorted(units)), file)
    if len(bands) >= 10 and len(rows) > 1 and len(bands) == len(header):
        return _by_row(rows, bands, "", file)

    first = next((i for i, row in enumerate(rows) if len(row) > 1 and _NUMBER.match(row[0])), None)
    if first is None:
        raise InputError(
            "unknown format: neither a column of wavelengths nor wavelengths as column names",
            file=file,
        )
    above, body = list(rows[:first]), rows[first:]
    if len(above[-1:] and above[-1]) < 2:
        above = [row for row in above if len(row) > 1]
    label_row = next((r for r in above if _WAVELENGTH.match(r[0])), above[0] if above else [])
    label = label_row[0] if label_row else ""
    named_row = next((r for r in above if r[0].lower().strip(":") in _NAME_KEYS), label_row)
    width = len(body[0])
    names = [
        named_row[i] if i < len(named_row) and named_row[i] else f"{file.stem}_{i}"
        for i in range(width)
    ]
    if width == 2 and not named_row:
        names[1] = file.stem
    start = len(text.splitlines()) - len(body) + 1
    values = np.empty((len(body), width))
    for number in range(len(body)):
        plain = body.numbers(number, 0, width)
        if plain is not None:
            values[number] = plain[1]
            continue
        row = body[number]
        if len(row) != width:
            raise InputError(
                f"expected {width} columns, but found {len(row)}; is the file cut short?",
                file=file, row=start + number,
            )  # fmt: skip
        for i in range(width):
            values[number, i] = cell_value(
                row[i], file, start + number, names[i] if i else "wavelength"
            )
    meta: dict[str, Any] = {"format": "table, one column a spectrum"}
    wavelength = _to_nm(values[:, 0], label, meta, file)
    columns: dict[str, np.ndarray] = {}
    for i in range(1, width):
        name = names[i].removesuffix(".asd")
        columns[name if name not in columns else f"{name}_{i}"] = values[:, i]
    return _paired(columns, wavelength, meta, file.stem)

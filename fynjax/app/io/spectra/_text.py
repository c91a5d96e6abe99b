"""Spectra in text: columns of spectra, rows of spectra, and the ECOSTRESS library's own layout."""

import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from fynjax._core.errors import InputError
from fynjax._core.tables import (
    TextTable,
    is_number,
    open_table,
    split_line,
    trimmed,
    without_header,
)
from fynjax.app.io.spectra._layout import (
    NAME_KEYS,
    WAVELENGTH,
    TableLayout,
    are_wavelengths,
    check_not_numbers_alone,
    layout_of,
)
from fynjax.app.io.spectra._names import (
    as_transmittance,
    leaves_only,
    marked,
    other_quantity,
    stated_quantity,
    unsure,
)
from fynjax.app.io.spectra._record import (
    MeasuredSpectrum,
    as_fractions,
    in_nanometres,
    note,
    single_spectrum,
    without_marks,
)

if TYPE_CHECKING:
    import pandas as pd

_UNITS = {
    "µm": re.compile(r"(?<![a-z])[uµμ]m\b|micro", re.I),
    "nm": re.compile(r"\bnm\b|_nm|nano", re.I),
}
"""How a header names the unit of wavelengths."""
_OTHER_UNITS = (
    (re.compile(r"cm ?\^?([-−]1|⁻¹)|wave[ _]?number|1/cm", re.I), "wave numbers", -1, 1e7),
    (re.compile(r"[(\[](å|a)[)\]]|[åa]ngstr", re.I), "ångström", 1, 0.1),
    (re.compile(r"\bthz\b|_thz|terah", re.I), "frequencies", -1, 299_792.458),
    (re.compile(r"\bev\b|_ev\b|electron ?volt", re.I), "energies of photons", -1, 1239.841984),
)
"""How a header names another unit: the power of the numbers, and the factor, that give nm."""
MISSING = {"", "na", "nan", "null", "none", "-", "#n/a", "-999", "-9999", "-9999.0", "-999.0"}
"""What stands for a missing value, in small letters."""
_IDS = (*NAME_KEYS, "replicate", "rep", "site", "date", "scan", "leaf_id", "plant_id")
_LONGEST_LOG = 200
"""Lines that a log below the numbers may have."""
_KEYS_OF_QUANTITY = ("y units", "second column", "measurement")
_SCALES = {
    "percent": (re.compile(r"\(?%\)?|\[%\]|percent", re.I), 100.0),
    "ten thousandths": (re.compile(r"[(\[]?[x*×] ?(10[ ,]?000|10\^4|1e4)[)\]]?", re.I), 1e4),
}
"""How a header names the scale of its values."""
_QUANTITIES = re.compile(
    r"quantity|(measurement|data|spectrum)?[ _]?(type|units?)|measurement", re.I
)
"""Names of columns of what a row is."""
_TARGET = re.compile(r"target|tgt|sample", re.I)
_WHITE = re.compile(r"(white )?(reference|panel|standard)|white|wr|spectralon", re.I)
_DARK = re.compile(r"dark( current)?", re.I)
_REFLECTIVE = 2600.0
"""Wavelength [nm] above which no spectrometer of reflected sunlight has a band."""


def _to_nm(wavelength: np.ndarray, label: str, meta: dict[str, Any]) -> np.ndarray:
    """Wavelengths in nm by the unit in a header, or, where it has none, by their size."""
    for sign, words, power, nm in _OTHER_UNITS:
        if sign.search(label) and np.all(wavelength > 0.0):
            note(meta, f"wavelengths converted from {words} to nm")
            return nm * wavelength**power
    unit = next((unit for unit, sign in _UNITS.items() if sign.search(label)), "")
    if not unit and re.search(r"freq|energy|[gm]hz|hertz", label, re.I):
        raise InputError(
            f"expected wavelengths in nm, but the header says {label!r:.60}: convert them, or "
            "write THz or eV behind the name"
        )
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
        values = without_marks(values, 100.0, meta) / 100.0
        note(meta, "reflectance converted from percent")
    quantity = stated_quantity(f"Y units: {keys.get(key, '')}" for key in _KEYS_OF_QUANTITY)
    through = quantity == "transmittance"
    return single_spectrum(keys.get("name") or table.path.stem, wavelength, values, meta, through)


def _ratio(columns: dict[str, np.ndarray], meta: dict[str, Any]) -> dict[str, np.ndarray]:
    """Columns, those of a target and of its white reference as their ratio where no other is
    reflectance, and left out beside it."""
    plain = {name: re.sub(r"[_.\-]+", " ", name).strip() for name in columns}
    found = [
        next((name for name in columns if sign.fullmatch(plain[name])), None)
        for sign in (_TARGET, _WHITE, _DARK)
    ]
    target, white, dark = found
    if target is None or white is None:
        return columns
    if np.nanmean(columns[white] >= columns[target]) < 0.95:  # two leaves, of those names
        return columns
    rest = {name: values for name, values in columns.items() if name not in found}
    if any(marked(name)[0] for name in rest):
        note(meta, f"columns {target!r} and {white!r} left out beside reflectance")
        return rest
    zero = 0.0 if dark is None else columns[dark]
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = (columns[target] - zero) / (columns[white] - zero)
    note(meta, f"reflectance formed as {target!r} over the white reference {white!r}")
    return {**rest, "reflectance": np.where(np.isfinite(ratio), ratio, np.nan)}


def _paired(
    columns: dict[str, np.ndarray], wavelength: np.ndarray, meta: dict, stem: str
) -> list[MeasuredSpectrum]:
    """Spectra from named columns; a transmittance column joins the reflectance of its name."""
    records: dict[str, dict[str, Any]] = {}
    columns = _ratio(columns, meta)
    names, stated = {}, {}
    for label in columns:
        found = ((k, sign, scale) for k, (sign, scale) in _SCALES.items() if sign.search(label))
        words, sign, scale = next(found, ("", None, 1.0))
        names[label] = (sign.sub("", label) if sign else label).strip(" _")
        stated[label] = words, scale
    doubtful = unsure(names.values())
    if not any(words for words, _ in stated.values()):
        # Exports of ASD's binary have counts, but no reflectance in whole numbers.
        most = {"most": 0.0} if "panel" in meta else {}
        values = as_fractions(np.array([*columns.values()]), meta, **most)
        columns = dict(zip(columns, values, strict=True))
    for label, values in columns.items():
        row_meta = {**meta, "repairs": list(meta.get("repairs", []))}
        words, scale = stated[label]
        values = without_marks(values, scale, row_meta) / scale
        if words:
            note(row_meta, f"converted from {words} as the header says")
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
    wavelength = _to_nm(np.array(list(bands.values())), layout.unit, meta)
    beside = [i for i in layout.through if i not in bands]
    all_passed = bool(layout.through) and not beside
    if all_passed:
        note(meta, "taken for transmittance, as the T before the wavelengths says")
    others = [i for i in range(len(header)) if i not in bands and i not in beside]
    labels = [name.lower() for name in header]
    name_at = next((i for i in others if labels[i] in NAME_KEYS), others[0] if others else None)
    frame = table.columns([*bands, *beside], others, MISSING)
    texts = frame[others].to_dict("records")
    quantities = {i: {marked(cell)[0] for cell in frame[i] if not marked(cell)[1]} for i in others}
    kind_at = next((i for i in others if "transmittance" in quantities[i]), None)
    records: dict[str, MeasuredSpectrum] = {}
    rows: list[int] = []
    both = as_fractions(frame[[*bands, *beside]].to_numpy(), meta)
    table_values, passed = both[:, : len(bands)], both[:, len(bands) :]
    said_at = [i for i in others if _QUANTITIES.fullmatch(labels[i])]
    for number, (values, cells) in enumerate(zip(table_values, texts), start=1):
        name = (cells[name_at] if name_at is not None else "") or f"{file.stem}_{number}"
        row_meta = {**meta, "repairs": list(meta.get("repairs", []))}
        row_meta["columns"] = {header[i]: cells[i] for i in others}
        kind = "" if kind_at is None else marked(cells[kind_at])[0]
        if kind_at is not None and not kind:
            name = f"{name} {cells[kind_at]}"
        name += "".join(f" {cells[i]}" for i in said_at if other_quantity(cells[i]))
        through = all_passed or kind == "transmittance"
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
        if beside:
            records[unique] = replace(records[unique], transmittance=passed[number - 1])
    return list(records.values())


def _by_column(table: TextTable, above: list[list[str]], at: int) -> list[MeasuredSpectrum]:
    """One column a spectrum, behind the column `at` of wavelengths, before which rows are numbered;
    `above` stands over the numbers."""
    file = table.path
    if len(above[-1:] and above[-1]) < 2:
        above = [row for row in above if len(row) > 1]
    labelled = (r for r in above if len(r) > at and WAVELENGTH.match(r[at]))
    label_row = next(labelled, above[0] if above else [])
    keyed = (r for r in above if r[0].lower().strip(":") in NAME_KEYS)
    named_row = next(keyed, label_row)
    full = [r for r in above if len(trimmed(r)) == table.width and not any(map(is_number, r[1:]))]
    if full and named_row not in full:  # a number of the plot, or a unit alone, is no name
        named_row = label_row if label_row in full else full[0]
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
    units = [r[1] for r in above if len(r) > 1 and re.fullmatch(r"\W*x ?units?\W*", r[0], re.I)]
    unit = " ".join([label_row[at] if len(label_row) > at else "", *units])
    wavelength = _to_nm(frame[at].to_numpy(), unit, meta)
    if any(name.endswith(".asd") for name in names[at + 1 :]):
        meta["panel"] = "unknown"  # as of the binary, whose export it is
    found = []
    for start, end in _blocks(frame, label_row, at, width):
        title = ""
        if end < width or start > at:
            title = next((r[start] for r in above if r is not label_row and len(r) > start), "")
            wavelength = _to_nm(frame[start].dropna().to_numpy(), label_row[start], {})
        known = frame[start].notna()
        columns: dict[str, np.ndarray] = {}
        for i in range(start + 1, end):
            name = f"{title} {names[i].removesuffix('.asd')}".strip()
            columns[name if name not in columns else f"{name}_{i}"] = frame[i][known].to_numpy()
        found += _paired(
            columns, wavelength, {**meta, "repairs": [*meta.get("repairs", [])]}, title or file.stem
        )
    return found


def _blocks(
    frame: "pd.DataFrame", labels: list[str], at: int, width: int
) -> Iterator[tuple[int, int]]:
    """First and last column, the last left out, of each block that begins with its own wavelengths,
    as programs of laboratories write each spectrum; one that is a copy begins none."""
    starts = [at]
    for i in range(at + 2, min(len(labels), width - 1)):
        if WAVELENGTH.match(labels[i]) and are_wavelengths(frame[i].dropna().tolist()):
            starts.append(i)
    return zip(starts, [*starts[1:], width], strict=True)


def _cut_log(table: TextTable, meta: dict[str, Any]) -> None:
    """Leave out lines without a number below the numbers, where programs write their log."""
    lines = table.data.split(b"\n")
    last = len(lines)
    for k in range(len(lines) - 1, max(len(lines) - _LONGEST_LOG, table.skip, 1), -1):
        cells = split_line(lines[k].decode(), table.separator)
        if any(is_number(cell) or cell.lower() in MISSING - {""} for cell in cells):
            break
        last = k if any(cells) else last
    else:
        return
    if last < len(lines):
        log = lines[last].decode().strip()
        note(meta, f"lines below the numbers left out, the first of them {log!r:.60}")
        table.data = b"\n".join([*lines[:last], b""])


def _long(table: TextTable) -> list[MeasuredSpectrum]:
    """Spectra of a long table, in which each row is a value of one sample at one wavelength; none
    of another table."""
    names = table.names
    first = next(table.rows())[1]
    at = next((i for i, name in enumerate(names) if WAVELENGTH.match(name)), None)
    if at is None or not 3 <= len(names) <= len(first) or not is_number(first[at]):
        return []
    words = {
        i for i in range(len(names))
        if i != at and (not is_number(first[i]) or names[i].lower() in _IDS)
    }  # fmt: skip
    numbers = [i for i in range(len(names)) if i != at and i not in words]
    values = [i for i in numbers if marked(names[i])[0] or names[i].lower() in ("value", "values")]
    values = values or numbers
    if (
        not words
        or len(values) > 2
        or (len(values) == 2 and not all(marked(names[i])[0] for i in values))
    ):
        return []
    frame = table.columns(
        [at, *values], [i for i in range(len(names)) if i not in (at, *values)], MISSING
    )
    of_one = any(names[i].lower() in _IDS and not is_number(first[i]) for i in words)
    if not of_one and not frame[at].duplicated().any():
        return []
    by = sorted(words)
    if frame.duplicated([*by, at]).any():  # leaves numbered within a sample
        by = [i for i in range(len(names)) if i not in (at, *values)]
    if frame.duplicated([*by, at]).any():
        raise InputError(
            "expected one value of each sample at each wavelength, but "
            f"{' '.join(map(str, frame[frame.duplicated([*by, at])][[*by, at]].iloc[0]))} is there "
            "twice; is a column missing that tells the samples apart?"
        )
    meta: dict[str, Any] = {"format": "table, a row a value of one sample at one wavelength"}
    frame["name"] = frame[by].agg(" ".join, axis=1)
    columns: dict[str, np.ndarray] = {}
    for i in values:
        wide = frame.pivot(index=at, columns="name", values=i)
        mark = f" {names[i]}" if marked(names[i])[0] else ""
        columns |= {f"{name}{mark}": wide[name].to_numpy() for name in frame["name"].unique()}
    return _paired(columns, _to_nm(wide.index.to_numpy(), names[at], meta), meta, table.path.stem)


def _said(found: list[MeasuredSpectrum], layout: TableLayout | None) -> list[MeasuredSpectrum]:
    """Spectra with how their table was taken; the first notes what else it might have been."""
    if layout is None:
        return found
    words = f"{layout.words}: {layout.evidence[0]}"
    found = [one.noted(meta={"layout": words}) for one in found]
    if layout.rejected and found:
        found[0] = found[0].noted(f"taken as {words}; not {layout.rejected[0]}")
    return found


def read_text_spectra(data: bytes, file: Path) -> list[MeasuredSpectrum]:
    """Read spectra from a table of any layout that `read_spectra` lists.

    **Arguments:** `data`: content of the file; `file`: it names a spectrum without a name.

    **Raises:** `InputError` as `open_table`, for a table without wavelengths, and with row and
    column of what cannot be read.
    """
    table = open_table(file, "a table of spectra", data=data, titled=False)
    meta: dict[str, Any] = {}
    _cut_log(table, meta)
    header = table.names
    if next(table.rows(), None) is not None:
        if long := _long(table):
            return leaves_only(long, file.stem)
        layout = layout_of(table)
        if layout.by_row:
            return leaves_only(_said(_by_row(table, layout), layout), file.stem)
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
    quantity = stated_quantity(
        line
        for line, (_, cells) in zip((table.line(row) for row, _ in above[:60]), above)
        if (len(set(cells[1:])) < 2 or len(cells) < table.width)
        and not (any(map(WAVELENGTH.match, cells)) and any(map(other_quantity, cells)))
    )
    titles = [cells for _, cells in above]
    if table.separator == " ":  # names may hold single ones
        for k, (row, cells) in enumerate(above):
            if len(cells) > table.width:
                titles[k] = re.split(r"\t+ *| {2,}", table.line(row))
    if len(titles) == 1 and len(titles[0]) == table.width - 1 and header[:1] == ("",):
        titles = [list(header)]  # R names no column of row names
    at = layout.at if layout is not None and len(above) == 1 and layout.at < table.width - 1 else 0
    found = _by_column(table, titles, at)
    if quantity == "transmittance" and all(one.transmittance is None for one in found):
        found = [as_transmittance(one) for one in found]
    if meta and found:
        found[0] = found[0].noted(*meta["repairs"])
    return leaves_only(_said(found, layout), file.stem)

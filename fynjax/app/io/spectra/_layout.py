"""How a table holds spectra, by its numbers and the words of its header."""

import itertools
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from fynjax._core.errors import InputError
from fynjax._core.tables import TextTable, is_number

WAVELENGTH = re.compile(
    r"^(wave[ _]?(length|number)?|wavelen|wvl?|wl|lambda|nm|[uµμ]m|x)s?(?![^\W\d_])", re.I
)
"""Names of a column of wavelengths."""
_BAND_NAME = re.compile(
    r"^(?P<before>[A-Za-z_. ]{0,12}?)(\d{3,5}(?:\.\d+)?|\d{1,2}\.\d+)\s*_?(nm|[uµμ]m)?$"
)
_BEFORE_BANDS = re.compile(
    r"(x|w|wl|wv|wvl|wave|wavelength|nm|b|band|r|rfl|refl|reflectance|t|trans|rho|lambda)?[_. ]*",
    re.I,
)
"""What programs write before the wavelengths that are names of columns."""
_PASSED = ("t", "trans", "transmittance")
_MOST_ROWS = 64
_LEAST_NM, _MOST_NM = 250.0, 30_000.0
_LEAST_SPAN = np.log(1.15)
"""Logarithm of the longest over the shortest wavelength of a spectrum, at least: samples are
numbered in narrow runs."""
NAME_KEYS = (
    *("name", "id", "sample", "sample_id", "spectrum", "spectra", "file name", "filename"),
    *("leaf", "species", "taxon", "plot", "plant"),
)
"""Names of a column of names."""
_FEW_BANDS = 10
"""Names of columns from which on they may be bands."""


@dataclass(frozen=True)
class TableLayout:
    """Where the spectra of a table stand."""

    by_row: bool
    """Whether each row is a spectrum, and wavelengths are names of columns."""
    at: int
    """Column of the wavelengths, where each column is a spectrum."""
    bands: Mapping[int, float]
    """Wavelengths by column, where each row is a spectrum."""
    unit: str
    """Unit that these names state; empty: none."""
    evidence: tuple[str, ...]
    """Why it was taken so."""
    rejected: tuple[str, ...] = ()
    """What else it might have been, and why not."""
    through: tuple[int, ...] = ()
    """Columns of transmittance at the wavelengths of `bands`, or `bands` where all are such."""

    @property
    def words(self) -> str:
        """The layout in words."""
        return "a row a spectrum" if self.by_row else "a column a spectrum"


def _named_bands(header: Sequence[str]) -> tuple[dict[int, float], str, bool, tuple[int, ...]]:
    """Columns whose names may be wavelengths, their unit, whether the words before the numbers are
    such as programs write, and columns of transmittance, as T400 is beside R400."""
    matches = {i: _BAND_NAME.match(name.replace(",", ".")) for i, name in enumerate(header)}
    found = {i: m for i, m in matches.items() if m}
    bands = {i: float(m[2]) for i, m in found.items()}
    passed = {i: w for i, w in bands.items() if found[i]["before"].strip(" _.").lower() in _PASSED}
    others = {i: w for i, w in bands.items() if i not in passed}
    through: tuple[int, ...] = ()
    if passed and [*passed.values()] == [*others.values()]:
        bands, through = others, tuple(passed)
    elif passed:
        through = tuple(passed)
    units = sorted({m[3] for m in found.values() if m[3]})
    usual = all(_BEFORE_BANDS.fullmatch(m["before"]) for m in found.values())
    return bands, " ".join(units), usual, through


def _mostly_one_way(values: Sequence[float]) -> bool:
    """Whether numbers rise, or fall, but for the overlaps of a few detectors."""
    steps = np.diff(values)
    if not steps.size:
        return False
    return bool(max((steps > 0).sum(), (steps < 0).sum()) >= max(0.9 * steps.size, steps.size - 3))


def are_wavelengths(values: Sequence[float]) -> bool:
    """Whether numbers can be wavelengths, in nm, in µm or as wave numbers."""
    array = np.asarray(values, float)
    if array.size < 2 or not np.isfinite(array).all() or not _mostly_one_way(values):
        return False
    low, high = float(array.min()), float(array.max())
    counts = bool(np.array_equal(array, np.arange(array.size) + array[0])) and array[0] in (0, 1)
    return not counts and (
        (low >= _LEAST_NM and high <= _MOST_NM) or (low >= 0.001 * _LEAST_NM and high <= 30.0)
    )


def _roughness(values: np.ndarray, axis: int) -> float:
    """Second differences along an axis over the values themselves, their median."""
    bends = np.abs(np.diff(values, 2, axis=axis))
    size = np.median(np.abs(values))
    return float(np.median(bends) / size) if bends.size and size > 0.0 else np.inf


def layout_of(table: TextTable) -> TableLayout:
    """Whether a table holds its spectra in columns or in rows.

    What decides, in this order: whether the header's numbers and the first columns' numbers can be
    wavelengths at all; the words of the header, which may call a column wavelength; and along which
    of both directions the values are smooth, as spectra are over wavelength. Digits in names that
    are in no order are no wavelengths.

    **Arguments:** `table`, whose names are those of its first row.

    **Raises:** `InputError` as `TextTable.rows`.
    """
    header = table.names
    rows = [cells for _, cells in itertools.islice(table.rows(), _MOST_ROWS)]
    bands, unit, usual, through = _named_bands(header)
    in_header = len(bands) >= _FEW_BANDS and are_wavelengths(list(bands.values()))
    at, named, stands = _column(header, rows)
    shown = list(bands.values())
    names = f"{len(bands)} names of columns with numbers, {_ends(shown)}" if bands else ""
    if not in_header:
        many = len(bands) >= _FEW_BANDS
        rejected = (f"{names}: in no order, or no wavelengths",) if many else ()
        return TableLayout(False, at, {}, "", (_about(header, at, named, stands),), rejected)
    if not stands:
        _check_bands_of_both(bands, through)
        evidence = (f"{names}, as wavelengths are",)
        return TableLayout(True, at, bands, unit, evidence, through=through)
    if is_number(header[at]) and len(bands) < len(header):  # a table without a header
        return TableLayout(False, at, {}, "", (_about(header, at, named, stands),))
    rough = _both(rows, at, bands)
    smooth = (
        f"values are {rough[1] / max(rough[0], 1e-9):.2g} times as rough along rows as down columns"
    )
    column = _about(header, at, named, stands)
    samples = (f"{names}: names of samples",)
    of_samples = header[at].lower().strip(" :") in NAME_KEYS and bool(header[at])
    cells = [row[at] for _, row in table.rows() if at < len(row) and is_number(row[at])]
    down = [float(cell.replace(",", ".")) for cell in cells]
    if named or _are_down(down, shown, rough, usual, of_samples):
        return TableLayout(False, at, {}, "", (column, smooth), samples)
    _check_bands_of_both(bands, through)
    rejected = (f"{column}: numbers of samples",)
    return TableLayout(True, at, bands, unit, (names, smooth), rejected, through)


def _check_bands_of_both(bands: Mapping[int, float], through: Sequence[int]) -> None:
    """Raise `InputError` where some columns are of transmittance, at other wavelengths than the
    rest."""
    if set(through) & set(bands) and not set(through) >= set(bands):
        raise InputError(
            f"expected columns such as R400 and T400 at the same wavelengths, but of {len(bands)} "
            f"only {len(through)} are of transmittance, at others: put both in tables of their own"
        )


def _are_down(
    down: Sequence[float],
    along: Sequence[float],
    rough: tuple[float, float],
    usual: bool,
    of_samples: bool,
) -> bool:
    """Whether of numbers down a column and along the header those of the column are wavelengths.

    One that alone spans a spectrum is; then one that spans a fifth more of a spectrum, in octaves;
    last what most of these say: along which the values are smoother, which has the finer steps, and
    whether the corner is named as samples are.
    """
    spans = [np.log(max(values) / min(values)) for values in (down, along)]
    wide = [span >= _LEAST_SPAN for span in spans]
    if wide[0] != wide[1]:
        return wide[0]
    if not usual:
        return True
    if wide[0] and max(spans) > 1.2 * min(spans):
        return bool(spans[0] > spans[1])
    steps = [float(np.median(np.abs(np.diff(values)))) for values in (down, along)]
    smoother = (rough[0] < 0.5 * rough[1]) - (rough[1] < 0.5 * rough[0])
    finer = (steps[0] < 0.4 * steps[1]) - (steps[1] < 0.4 * steps[0])
    return bool(smoother + finer * wide[0] - of_samples > 0)


def _column(header: Sequence[str], rows: Sequence[Sequence[str]]) -> tuple[int, bool, bool]:
    """The column that may hold wavelengths: its place, whether its name says so, and whether its
    numbers can be."""
    numbers = {}
    for i in range(min(len(header), 3)):
        cells = [row[i] if i < len(row) else "" for row in rows]
        if all(is_number(cell) for cell in cells):
            numbers[i] = are_wavelengths([float(cell.replace(",", ".")) for cell in cells])
    called = [i for i in numbers if WAVELENGTH.match(header[i]) and numbers[i]]
    if called:
        return called[0], True, True
    counts = bool(rows) and [row[0] for row in rows] in (
        [str(k + first) for k in range(len(rows))] for first in (0, 1)
    )
    at = 1 if counts and numbers.get(1) else 0
    return at, bool(WAVELENGTH.match(header[at])) if header else False, numbers.get(at, False)


def _both(
    rows: Sequence[Sequence[str]], at: int, bands: Mapping[int, float]
) -> tuple[float, float]:
    """Roughness of the values down columns, and along rows."""
    places = [i for i in bands if i != at]

    def number(row: Sequence[str], i: int) -> float:
        there = i < len(row) and is_number(row[i])
        return float(row[i].replace(",", ".")) if there else np.nan

    cells = [[number(row, i) for i in places] for row in rows]
    values = np.asarray(cells, float)
    values = values[np.isfinite(values).all(axis=1)]
    if not values.size:
        return np.inf, np.inf
    return _roughness(values, 0), _roughness(values, 1)


def _ends(values: Sequence[float]) -> str:
    return f"{values[0]:g} to {values[-1]:g}" if values else ""


def _about(header: Sequence[str], at: int, named: bool, stands: bool) -> str:
    name = f"column {at + 1} ({header[at]!r})" if header and header[at] else f"column {at + 1}"
    if named:
        return f"{name} is named as wavelengths are"
    return f"{name} has numbers that rise as wavelengths do" if stands else f"{name} is the first"


def check_not_numbers_alone(table: TextTable) -> None:
    """Raise `InputError` for values without wavelengths, as the library of the USGS has them."""
    rows = [cells for _, cells in itertools.islice(table.rows(), _MOST_ROWS)]
    numbers = sum(len(cells) == 1 and is_number(cells[0].strip()) for cells in rows)
    if 2 * numbers > len(rows):
        raise InputError(
            "expected a column of wavelengths beside that of the values, but the rows have one "
            "number each. The wavelengths are in another file: put both side by side, as in "
            f"paste wavelengths.txt {table.path.name} > both.txt"
        )

"""Text of field spectrometers: SVC (`.sig`) and Spectral Evolution (`.sed`).

Both hold the white reference, the target and the reflectance of one spectrum, below a header of
keys, as the makers' manuals show them (SVC HR-1024i User Manual; Spectral Evolution PSR+ manual).
"""

import re
from pathlib import Path
from typing import Any

import numpy as np

from fynjax._core.errors import InputError
from fynjax._core.tables import open_table
from fynjax.app.io.spectra._record import MeasuredSpectrum, note, single_spectrum
from fynjax.app.io.spectra._text import MISSING

_SVC = "/*** Spectra Vista"
_SED = "data:"
_LONGEST_HEAD = 1 << 16
_KEPT = ("instrument", "integration", "time", "units", "date", "measurement")


def _without_overlap(
    wavelength: np.ndarray, values: np.ndarray
) -> tuple[np.ndarray, list[float], list[float]]:
    """Which bands stay where detectors overlap; where they were cut [nm]; and by how much the right
    detector is above the left one in the overlap, which both saw, relative [-]."""
    kept, cuts, jumps = np.ones(wavelength.shape, bool), [], []
    starts = [0, *np.flatnonzero(np.diff(wavelength) <= 0) + 1, wavelength.size]
    for before, first, after in zip(starts, starts[1:], starts[2:]):
        cut = 0.5 * (wavelength[first - 1] + wavelength[first])
        kept[:first] &= wavelength[:first] < cut
        kept[first:] &= wavelength[first:] >= cut
        cuts.append(float(cut))
        right = slice(
            first, first + np.searchsorted(wavelength[first:after], wavelength[first - 1])
        )
        left = np.interp(wavelength[right], wavelength[before:first], values[before:first])
        both = left.mean() if left.size else np.nan
        jumps.append(float(values[right].mean() / both - 1.0) if both > 0 else np.nan)
    return kept, cuts, jumps


def read_field_spectrum(data: bytes, file: Path) -> MeasuredSpectrum | None:
    """The spectrum of a file of SVC or Spectral Evolution; `None` where it is neither.

    Where the ranges of two detectors overlap, both are cut in the middle of the overlap, and what
    they differ by in it is `meta["jumps"]`. A file without reflectance has that of its target over
    its reference.

    **Arguments:** `data`: content of the file; `file`: for errors, and the name of the spectrum.

    **Raises:** `InputError` for a file without reflectance, and as `open_table`.
    """
    lines = data[:_LONGEST_HEAD].decode(errors="replace").splitlines()
    svc = next((line for line in lines if line.strip()), "").startswith(_SVC)
    marks = [i for i, line in enumerate(lines[:120]) if line.strip().lower() in ("data=", _SED)]
    if not marks or not (svc or lines[marks[0]].strip().lower() == _SED):
        return None
    start, label = marks[0] + 1, "reflectance %"
    if not svc:
        label = lines[start] if start < len(lines) else ""
        start += 1
        if not label.lower().startswith(("wvl", "wave")):
            return None
    names = re.split(r"\t|\s{2,}", label.strip())
    places = (i for i, n in enumerate(names) if re.search("refl|trans", n, re.IGNORECASE))
    column = 3 if svc else next(places, -1)
    stated = next(
        (line for line in lines[: marks[0]] if line.lower().startswith("measurement")), ""
    )
    named = names[column] if not svc and 0 <= column < len(names) else ""
    through = "trans" in (named + stated).lower()  # programs call the column so whatever it is
    quantity = "transmittance" if through else "reflectance"
    parts = [1, 2] if svc else _target_and_reference(names)
    if column < 0 and not parts:
        raise InputError("the file has no column of reflectance, nor those of target and reference")
    table = open_table(file, "a spectrum", data=data, titled=False)
    table.separator, table.skip, table.headed = " ", start, False
    row, cells = next(table.rows(), (0, []))
    if not cells:
        raise InputError("the file has a header but no values; is it cut short?")
    if parts and not 0 <= column < len(cells):
        column = -1
    needed = max([column, *(parts if column < 0 else [])]) + 1
    if len(cells) < needed:
        raise InputError(
            f"expected {needed} columns, but found {len(cells)}; is the file cut short, or "
            "saved without reflectance?",
            row=row,
        )
    table.names = tuple(str(i + 1) for i in range(len(cells)))
    meta: dict[str, Any] = {"format": "SVC" if svc else "Spectral Evolution"}
    if column < 0:
        wavelength, white, target = table.columns([0, *parts], (), MISSING).to_numpy().T
        with np.errstate(divide="ignore", invalid="ignore"):
            values = np.where(np.abs(white) > 0, target / white, np.nan)
        note(meta, f"{quantity} formed as target over white reference")
        if not np.isfinite(values).any():
            raise InputError("the white reference is zero, so there is no reflectance")
    else:
        wavelength, values = table.columns([0, column], (), MISSING).to_numpy().T
    for line in lines[: marks[0]]:
        key, _, value = line.partition("=" if svc else ":")
        if key.strip().lower() in _KEPT:
            meta[key.strip().lower()] = value.strip()
    if svc and (error := _error_of_target(lines[: marks[0]])):
        note(meta, f"the spectrometer states error {error} of the target: was it saturated?")
        meta["doubtful"] = f"error {error} of the target"
    if column >= 0 and (svc or "%" in (names[column] if len(names) > column else label)):
        values = values / 100.0
        note(meta, f"{quantity} converted from percent")
    kept, changes, jumps = _without_overlap(wavelength, values)
    if changes:
        meta |= {"splices": changes, "jumps": jumps}
        note(meta, f"overlap of detectors cut at {', '.join(f'{c:g}' for c in changes)} nm")
    return single_spectrum(file.stem, wavelength[kept], values[kept], meta, through)


def _target_and_reference(names: list[str]) -> list[int]:
    """Columns of reference and target in a Spectral Evolution file; none without them."""
    found = [
        next((i for i, name in enumerate(names) if mark in name.lower()), -1)
        for mark in ("(ref", "(target")
    ]
    return found if min(found) > 0 else []


def _error_of_target(head: list[str]) -> int:
    """Error that an SVC states of the target, 0 for none: the second of `error= reference, target`.

    What stands for the reference is no fault: public files have 6 or 7 there.
    """
    stated = next((line.partition("=")[2] for line in head if line.startswith("error=")), "")
    numbers = re.findall(r"-?\d+", stated)
    return int(numbers[1]) if len(numbers) > 1 else 0

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
from fynjax.io.spectra._record import MeasuredSpectrum, note
from fynjax.io.spectra._text import MISSING

_SVC = "/*** Spectra Vista"
_SED = "data:"
_LONGEST_HEAD = 1 << 16
_KEPT = ("instrument", "integration", "time", "units", "date", "measurement")


def _without_overlap(wavelength: np.ndarray) -> tuple[np.ndarray, list[float]]:
    """Which bands stay where detectors overlap, and where they were cut [nm]."""
    kept, cuts = np.ones(wavelength.shape, bool), []
    for first in np.flatnonzero(np.diff(wavelength) <= 0) + 1:
        cut = 0.5 * (wavelength[first - 1] + wavelength[first])
        kept[:first] &= wavelength[:first] < cut
        kept[first:] &= wavelength[first:] >= cut
        cuts.append(float(cut))
    return kept, cuts


def read_field_spectrum(data: bytes, file: Path) -> MeasuredSpectrum | None:
    """The spectrum of a file of SVC or Spectral Evolution; `None` where it is neither.

    Where the ranges of two detectors overlap, both are cut in the middle of the overlap.

    **Arguments:**

    - `data`: content of the file.
    - `file`: for errors, and the name of the spectrum.

    **Raises:** `InputError` for a file without reflectance, and as `open_table`.
    """
    lines = data[:_LONGEST_HEAD].decode(errors="replace").splitlines()
    svc = lines[0].startswith(_SVC)
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
    column = 3 if svc else next((i for i, n in enumerate(names) if "refl" in n.lower()), -1)
    if column < 0:
        raise InputError("the file has no column of reflectance", file=file)
    table = open_table(file, "a spectrum", data=data)
    table.separator, table.skip, table.headed = " ", start, False
    row, cells = next(table.rows(), (0, []))
    if not cells:
        raise InputError("the file has a header but no values; is it cut short?", file=file)
    if len(cells) <= column:
        raise InputError(
            f"expected {column + 1} columns, but found {len(cells)}; is the file cut short, or "
            "saved without reflectance?",
            file=file,
            row=row,
        )
    table.names = tuple(str(i + 1) for i in range(len(cells)))
    wavelength, values = table.columns([0, column], (), MISSING).to_numpy().T
    meta: dict[str, Any] = {"format": "SVC" if svc else "Spectral Evolution"}
    for line in lines[: marks[0]]:
        key, _, value = line.partition("=" if svc else ":")
        if key.strip().lower() in _KEPT:
            meta[key.strip().lower()] = value.strip()
    if svc or "%" in (names[column] if len(names) > column else label):
        values = values / 100.0
        note(meta, "reflectance converted from percent")
    kept, changes = _without_overlap(wavelength)
    if changes:
        meta["splices"] = changes
        note(meta, f"overlap of detectors cut at {', '.join(f'{c:g}' for c in changes)} nm")
    return MeasuredSpectrum(file.stem, wavelength[kept], values[kept], None, meta)

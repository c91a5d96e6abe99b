"""Spectra of many files, as one dataset and one table."""

import json
import re
import warnings
from collections.abc import Mapping, Sequence
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr

from fynjax._core.errors import InputError
from fynjax.app.io.spectra._names import as_transmittance, join_pairs, join_stated, with_doubts
from fynjax.app.io.spectra._read import read_curve, read_usable_spectra, with_panel
from fynjax.app.io.spectra._record import MeasuredSpectrum
from fynjax.app.io.text import atomic_path
from fynjax.leaf import DARKEST_JUMP, LARGEST_JUMP, correct_detector_jumps

_DIGITS = 3
"""Decimals of a wavelength [nm]: bands nearer to each other are the same."""
_NOTED_JUMP = 0.005
"""Relative jump between detectors from which on a repair is noted [-]."""
_ASD_BANDS = np.arange(350.0, 2501.0)
_ASD_CHANGES = ((1000.0,), (1800.0, 1830.0))
"""Last wavelengths of the first and of the second detector of an ASD [nm]."""
_NAMED_REFUSALS = 5
"""Refused spectra, and those in doubt, that the warnings name."""

Read = list[tuple[str, MeasuredSpectrum]]
"""File and spectrum of each that can be used."""
Refused = list[tuple[str, str, InputError]]
"""File, name and error of each that cannot; the name is empty where the whole file is none."""


def read_spectra(
    paths: str | Path | Sequence[str | Path],
    *,
    panel: str | Path | None = None,
    detector_changes: Sequence[float] | None = None,
    transmittance: str | Path | Sequence[str | Path] = (),
) -> xr.Dataset:
    """Read every spectrum of files or folders, of any format that `fynjax fit-leaf` takes.

    **Arguments:**

    - `paths`: a file, a folder, or several: ASD, SVC, Spectral Evolution, CSV, TSV, text, ENVI
      libraries (see `fynjax.app.io.spectra.read_spectra_file`). Of folders every file in them and
      below is read, but hidden ones and ENVI headers.
    - `panel`: file of the white panel's own reflectance, for spectra relative to it; those of ASD
      files that hold it are absolute already.
    - `detector_changes`: wavelengths where detectors change [nm], at which jumps are taken out of
      all spectra (`correct_detector_jumps`); `None` for those that files state, `()` for none.
    - `transmittance`: files or folders with the transmittance of the same leaves, one for each, by
      name or in the same order. Not needed where the names say it (`oak_R.asd` and `oak_T.asd`) or
      the files.

    **Returns:** reflectance and, where any was measured, transmittance [spectrum, wavelength] as
    fractions, NaN where a spectrum has no such band; wavelength [nm]; of each spectrum its name
    (numbered where it occurs twice), file, format, repairs made while reading, and what else the
    file says, as JSON. CF conventions, and the files' hashes. `fynjax.fit_leaf` takes it whole.

    **Raises:** `InputError` where no spectrum can be used, with the first reason. Warns of others
    that cannot, of a white panel that is unknown, and of what may be no leaf of its own or a
    transmittance by its name or by less than 0.02 at 450 nm.

    >>> import pathlib, tempfile
    >>> import fynjax as fx
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = pathlib.Path(folder) / "leaves.csv"
    ...     _ = path.write_text("wavelength,protea,restio\\n500,0.05,0.08\\n800,0.48,0.40\\n")
    ...     spectra = fx.read_spectra(folder)
    >>> spectra["reflectance"].sel(spectrum="restio").values
    array([0.08, 0.4 ])
    """
    from fynjax.app.io.raster import provenance  # late: it imports this package

    read, refused = usable_spectra(paths, panel, detector_changes, transmittance)
    for sentence in warnings_of_reading(read, refused):
        warnings.warn(sentence, stacklevel=2)
    inputs = dict.fromkeys([*(file for file, _ in read), *([] if panel is None else [panel])])
    return measured_dataset(read, provenance(inputs=inputs))


def example_folder() -> Path:
    """Folder of shipped example spectra of six leaves.

    `reflectance` holds an ASD file of each, relative to the white panel of `panel.csv`;
    `transmittance.csv` what a sphere measured of them; `laboratory.csv` chlorophyll and carotenoids
    [ug cm-2], water and dry matter [g cm-2]. Simulated: see its `README.md`.
    """
    return Path(str(files("fynjax.app.io.spectra") / "data" / "leaves"))


def usable_spectra(
    paths: str | Path | Sequence[str | Path],
    panel: str | Path | None = None,
    detector_changes: Sequence[float] | None = None,
    transmittance: str | Path | Sequence[str | Path] = (),
) -> tuple[Read, Refused]:
    """The spectra of files and folders that can be used, and what could not be.

    **Arguments:** `paths`, `panel`, `detector_changes` and `transmittance` as of `read_spectra`.

    **Returns:** file and spectrum of each that can be used; file, name and error of the others,
    the name empty where the whole file cannot be read.

    **Raises:** `InputError` where no spectrum can be used, with the first reason.
    """
    curve = None if panel is None else read_curve(panel, "the panel")
    found, refused = _read_all(paths)
    if transmittance:
        through, bad = _read_all(transmittance)
        found = join_stated(found, [(file, as_transmittance(s)) for file, s in through])
        refused += bad
    else:
        found = join_pairs(found)
    read: Read = []
    for name, spectrum in with_doubts(found):
        try:
            absolute = spectrum if curve is None else with_panel(spectrum, *curve)
        except InputError as error:
            refused.append((name, spectrum.name, error))
            continue
        read.append((name, _without_jumps(absolute, detector_changes)))
    if not read:
        raise refused[0][2] if refused else InputError("no file of spectra was given")
    return read, refused


def _read_all(paths: str | Path | Sequence[str | Path]) -> tuple[Read, Refused]:
    """The spectra of files and folders as they stand there."""
    found: Read = []
    refused: Refused = []
    for file in _files([paths] if isinstance(paths, str | Path) else paths):
        try:
            usable, bad = read_usable_spectra(file)
        except InputError as error:
            usable, bad = [], [("", error)]
        found += [(str(file), spectrum) for spectrum in usable]
        refused += [(str(file), name, error) for name, error in bad]
    return found, refused


def _files(paths: Sequence[str | Path]) -> list[Path]:
    """Files, and those in folders and below them."""
    files = []
    for path in map(Path, paths):
        if not path.is_dir():
            files.append(path)
            continue
        inside = sorted(p for p in path.rglob("*") if p.is_file())
        inside = [p for p in inside if p.suffix.lower() != ".hdr"]
        shown = [p for p in inside if not any(s[0] == "." for s in p.relative_to(path).parts)]
        if not shown:
            raise InputError("expected files of spectra, but the folder has none", file=path)
        files += shown
    return files


def _without_jumps(spectrum: MeasuredSpectrum, changes: Sequence[float] | None) -> MeasuredSpectrum:
    """The spectrum with the jumps of its detectors taken out at `changes` [nm], or, if None, where
    the file says that they change."""
    stated = changes is not None
    measured = spectrum.meta.get("jumps") if changes is None else None
    changes = spectrum.meta.get("splices", []) if changes is None else changes
    notes: list[str] = []
    parts: dict[str, Any] = {}
    if not changes and not stated and (changes := _asd_changes(spectrum)):
        at = " and ".join(f"{c:g}" for c in changes)
        notes.append(f"bands are those of an ASD, with a step of its detectors at {at} nm")
    if not changes:
        return spectrum
    for quantity in ("reflectance", "transmittance"):
        before = getattr(spectrum, quantity)
        if before is not None:
            parts[quantity], jumps = correct_detector_jumps(
                spectrum.wavelength, before, changes, measured
            )
            for at, jump in zip(changes, jumps):
                level = float(np.interp(at, spectrum.wavelength, before))
                if np.isfinite(jump) and abs(jump) > _NOTED_JUMP:
                    what = "taken out"
                    if abs(jump) > LARGEST_JUMP:
                        what = "too large, left alone"
                    elif level < DARKEST_JUMP:
                        what = f"left alone, since an offset would look like it at {level:.2f}"
                    notes.append(f"detectors change at {at:g} nm: {100 * jump:+.1f} %, {what}")
                if stated and not np.isfinite(jump):
                    notes.append(f"detectors change at {at:g} nm: too few bands beside it to tell")
    return spectrum.noted(*notes, **parts)


def _asd_changes(spectrum: MeasuredSpectrum) -> list[float]:
    """Where the detectors of an ASD change in a spectrum whose file does not say so, such as a text
    export: the bands are 350 to 2500 nm by 1 nm, and the step stands out from those beside it."""
    grid, values = spectrum.wavelength, spectrum.reflectance
    if values is None or not np.array_equal(grid, _ASD_BANDS):
        return []
    found = []
    for places in _ASD_CHANGES:
        steps = {}
        for at in places:
            near = [at + shift for shift in (-36, -24, 24, 36)]
            _, jumps = zip(*(correct_detector_jumps(grid, values, [c]) for c in (at, *near)))
            step, usual = abs(float(jumps[0][0])), np.abs(np.ravel(jumps[1:]))
            if _NOTED_JUMP < step <= LARGEST_JUMP and step > 3.0 * np.nanmax(usual):
                steps[at] = step
        if steps:
            found.append(max(steps, key=lambda at: steps[at]))
    return found


def warnings_of_reading(read: Read, refused: Refused, table: str = "") -> list[str]:
    """What to warn of after reading spectra.

    **Arguments:** `read` and `refused`, as of `usable_spectra`; `table`, the file that lists all.

    **Returns:** sentences: the first spectra that were refused, and panels that are unknown.
    """
    said = [f"Refused: {error}" for _, _, error in refused[:_NAMED_REFUSALS]]
    if len(refused) > _NAMED_REFUSALS:
        see = f", see {table}" if table else ""
        said.append(f"{len(refused) - _NAMED_REFUSALS} more were refused{see}.")
    for key, what in (
        ("left_out", "columns of {} were left out, since they are no leaves: {}."),
        ("saturated", "{}: saturated detectors ({}), whose bands are left out."),
        ("doubtful", "{}: {}."),
    ):
        reasons = [(Path(file).name, s.meta[key]) for file, s in read if key in s.meta]
        for file, why in reasons[:_NAMED_REFUSALS]:
            said.append(what.format(file, why if isinstance(why, str) else ", ".join(why)))
        if len(reasons) > _NAMED_REFUSALS:
            said.append(f"So it is of {len(reasons) - _NAMED_REFUSALS} more.")
    relative = sum(s.meta.get("panel") == "unknown" for _, s in read)
    if relative:
        said.append(
            f"The reflectance of {relative} ASD spectra is relative to a white panel whose own "
            "reflectance is not in the file: 1 to 2 % too high with a usual panel, 6 % at 2500 nm. "
            f"Give its table by {'--panel' if table else '`panel`'}."
        )
    return said


def measured_dataset(spectra: Read, attributes: Mapping[str, str | int]) -> xr.Dataset:
    """Spectra of files over all their wavelengths, NaN where one has no such band.

    **Arguments:** `spectra`: file and spectrum of each; `attributes`: of the dataset, such as where
    it comes from.

    **Returns:** as `read_spectra`.
    """
    names = _numbered([s.name for _, s in spectra])
    grids = [np.round(s.wavelength, _DIGITS) for _, s in spectra]
    wavelength = np.unique(np.concatenate(grids))
    variables: dict[str, tuple[tuple[str, ...], np.ndarray, dict[str, str]]] = {}
    for quantity in ("reflectance", "transmittance"):
        rows = [getattr(s, quantity) for _, s in spectra]
        if all(row is None for row in rows):
            continue
        values = np.full((len(rows), wavelength.size), np.nan)
        for row, grid, into in zip(rows, grids, values):
            if row is not None:
                into[np.searchsorted(wavelength, grid)] = row
        long_name = f"measured {quantity}, as a fraction"
        variables[quantity] = (
            ("spectrum", "wavelength"), values, {"units": "1", "long_name": long_name}
        )  # fmt: skip
    texts = {
        "file": ([file for file, _ in spectra], "file of the spectrum"),
        "format": ([str(s.meta.get("format", "")) for _, s in spectra], "format of the file"),
        "repairs": (["; ".join(s.meta["repairs"]) for _, s in spectra], "repairs while reading"),
        "header": ([_header(s) for _, s in spectra], "what else the file says, as JSON"),
    }
    for name, (cells, long_name) in texts.items():
        variables[name] = (("spectrum",), np.array(cells, object), {"long_name": long_name})
    about = {"units": "nm", "standard_name": "radiation_wavelength", "long_name": "band centre"}
    return xr.Dataset(
        variables,
        coords={
            "wavelength": ("wavelength", wavelength, about),
            "spectrum": ("spectrum", np.array(names, object), {"long_name": "name of spectrum"}),
        },
        attrs={"Conventions": "CF-1.11", "title": "Measured spectra", **attributes},
    )


def _header(spectrum: MeasuredSpectrum) -> str:
    rest = {k: v for k, v in spectrum.meta.items() if k not in ("format", "repairs", "layout")}
    return json.dumps(rest, default=str, ensure_ascii=False)


def _numbered(names: Sequence[str]) -> list[str]:
    """Names, those that occur before with a number that no other has."""
    unique: dict[str, None] = {}
    for name in names:
        count, free = 1, name
        while free in unique:
            count += 1
            free = f"{name}_{count}"
        unique[free] = None
    return list(unique)


def measured_table(dataset: xr.Dataset) -> pd.DataFrame:
    """A column of wavelengths and one of each spectrum, which `read_spectra` reads again.

    **Arguments:** `dataset`, as `read_spectra` makes it.

    **Returns:** `wavelength_nm`, and of each spectrum its name with `_R` (reflectance) or `_T`.
    """
    columns: dict[str, np.ndarray] = {"wavelength_nm": dataset["wavelength"].values}
    for quantity, mark in (("reflectance", "R"), ("transmittance", "T")):
        if quantity not in dataset:
            continue
        for name, row in zip(dataset["spectrum"].values, dataset[quantity].values):
            if np.isfinite(row).any():
                # The word would be read as the unit.
                columns[f"{re.sub('%|percent', 'pct', name, flags=re.I)}_{mark}"] = row
    return pd.DataFrame(columns)


def write_spectra_netcdf(dataset: xr.Dataset, path: str | Path) -> None:
    """Write a `dataset` of spectra to the file `path`, as compressed NetCDF-4; spectra as 32 bit
    numbers."""
    encoding = {
        key: {"zlib": True} | ({"dtype": "float32"} if "wavelength" in values.dims else {})
        for key, values in dataset.data_vars.items() if values.dtype.kind == "f"
    }  # fmt: skip
    with atomic_path(path) as partial:
        dataset.to_netcdf(partial, engine="netcdf4", encoding=encoding)

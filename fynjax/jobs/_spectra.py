"""What jobs on files of spectra say of what they read."""

from collections.abc import Sequence
from pathlib import Path

from fynjax._core.errors import InputError
from fynjax.io.spectra import MeasuredSpectrum, read_curve, read_spectra_files, with_panel
from fynjax.io.text import existing_file
from fynjax.jobs._result import Record

_NAMED_REFUSALS = 5
"""Refused spectra that the warnings name."""


class RefusedSpectrum(Record):
    """A spectrum that could not be used, and why."""

    file: str
    name: str
    reason: str


class SpectrumRepair(Record):
    """What was repaired while a spectrum was read."""

    file: str
    name: str
    repair: str


def refused_spectra(refused: Sequence[tuple[str, str, InputError]]) -> list[RefusedSpectrum]:
    """Records of file, name and error of refused spectra."""
    return [RefusedSpectrum(file=f, name=n, reason=str(e)) for f, n, e in refused]


def repairs(spectra: Sequence[tuple[str, MeasuredSpectrum]]) -> list[SpectrumRepair]:
    """Records of what was repaired, of files and their spectra."""
    return [
        SpectrumRepair(file=file, name=spectrum.name, repair=sentence)
        for file, spectrum in spectra
        for sentence in spectrum.meta["repairs"]
    ]


def usable_spectra(
    paths: Sequence[str | Path], panel: str | Path | None
) -> tuple[list[tuple[str, MeasuredSpectrum]], list[tuple[str, str, InputError]]]:
    """Spectra of files and folders, times the reflectance of a `panel` where its table is given.

    **Returns:** as `read_spectra_files`.

    **Raises:** `InputError` where no spectrum can be used, with the first reason, and for a path
    that is neither a file nor a folder.
    """
    for path in paths:
        if not Path(path).is_dir():
            existing_file(path, "a file of spectra")
    read, refused = read_spectra_files(paths)
    if panel is None:
        return read, refused
    curve, spectra = read_curve(panel, "the panel"), []
    for file, spectrum in read:
        try:
            spectra.append((file, with_panel(spectrum, *curve)))
        except InputError as error:
            refused.append((file, spectrum.name, error))
    if not spectra:
        raise refused[0][2]
    return spectra, refused


def warnings_of_reading(
    spectra: Sequence[tuple[str, MeasuredSpectrum]],
    refused: Sequence[tuple[str, str, InputError]],
    table: str,
) -> list[str]:
    """Refused spectra, the first ones by name (`table` lists all), and panels that are unknown."""
    warnings = [f"Refused: {error}" for _, _, error in refused[:_NAMED_REFUSALS]]
    if len(refused) > _NAMED_REFUSALS:
        warnings.append(f"{len(refused) - _NAMED_REFUSALS} more were refused, see {table}.")
    relative = sum(s.meta.get("panel") == "unknown" for _, s in spectra)
    if relative:
        warnings.append(
            f"The reflectance of {relative} ASD spectra is relative to a white panel whose own "
            "reflectance is not in the file: 1 to 2 % too high with a usual panel, 6 % at 2500 nm. "
            "Give its table by --panel."
        )
    return warnings

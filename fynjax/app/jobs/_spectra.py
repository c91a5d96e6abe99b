"""Records of what was repaired and refused while spectra were read."""

import xarray as xr

from fynjax.app.io.spectra import Refused
from fynjax.app.jobs._result import Record


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


def refused_spectra(refused: Refused) -> list[RefusedSpectrum]:
    """Records of file, name and error of refused spectra."""
    return [RefusedSpectrum(file=f, name=n, reason=str(e)) for f, n, e in refused]


def repairs(spectra: xr.Dataset) -> list[SpectrumRepair]:
    """Records of what was repaired of spectra, as `measured_dataset` holds them."""
    rows = zip(spectra["file"].values, spectra["spectrum"].values, spectra["repairs"].values)
    return [
        SpectrumRepair(file=file, name=name, repair=sentence)
        for file, name, said in rows
        for sentence in said.split("; ") if said
    ]  # fmt: skip

"""The job of `fynjax convert`: spectra of any format in, one CSV and one NetCDF out."""

from collections.abc import Sequence
from pathlib import Path
from typing import Literal

import pandas as pd

from fynjax._core.dry_run import begin_work
from fynjax._core.precision import double_precision
from fynjax.app.io.spectra import (
    measured_dataset,
    measured_table,
    usable_spectra,
    warnings_of_reading,
    write_spectra_netcdf,
)
from fynjax.app.jobs._result import JobResult
from fynjax.app.jobs._run import Run
from fynjax.app.jobs._spectra import RefusedSpectrum, SpectrumRepair, refused_spectra, repairs
from fynjax.app.report import figures
from fynjax.app.report.pages import Picture, Table


class ConvertResult(JobResult):
    """Result of `convert`: how many spectra were written, repaired and refused."""

    command: Literal["convert"] = "convert"
    spectra: int
    bands: int
    refused: list[RefusedSpectrum]
    repairs: list[SpectrumRepair]


@double_precision
def convert(
    paths: Sequence[str | Path], output: str | Path, *, panel: str | Path | None = None
) -> ConvertResult:
    """Write spectra of any format as one CSV and one NetCDF.

    Reads ASD, SVC, Spectral Evolution, CSV, text, ECOSTRESS and ENVI libraries, one file or whole
    folders. A file or a spectrum that cannot be used does not stop the others.

    **Arguments:**

    - `paths`: files of spectra, or folders of them, of any format that `fynjax.read_spectra` takes.
    - `output`: folder, made if missing.
    - `panel`: table of the white panel's own reflectance, where files lack it.

    **Returns:** `ConvertResult`. Writes `spectra.csv` (wavelengths in nm, a column a spectrum,
    fractions), `spectra.nc` (CF conventions, with file, format and header of each spectrum) and
    `sources.csv` (what was read, repaired and refused).

    **Raises:** `InputError` if no file holds a usable spectrum.

    Example: `jobs.convert(["campaign"], "spectra")`.
    """
    run = Run(output)
    with run.stage("Read", "read"):
        spectra, refused = usable_spectra(paths, panel, detector_changes=())
    size = f"{len(spectra)} spectra"
    begin_work({"spectra.csv": size, "spectra.nc": size, "sources.csv": "", "report.html": ""})
    dataset = measured_dataset(spectra, run.record([*(file for file, _ in spectra), panel]))
    what = "reflectance and transmittance over wavelength, one column a spectrum"
    with run.stage("Write", "write"):
        run.table("spectra.csv", measured_table(dataset), what, "%.7g")
        what = "the same with units, file, format and header of each spectrum"
        write_spectra_netcdf(dataset, run.path("spectra.nc", what))
    names = dataset["spectrum"].values
    rows = [
        {
            "name": name,
            "file": file,
            "format": spectrum.meta.get("format", ""),
            "bands": spectrum.wavelength.size,
            "from_nm": spectrum.wavelength[0],
            "to_nm": spectrum.wavelength[-1],
            "repairs": "; ".join(spectrum.meta["repairs"]),
        }
        for name, (file, spectrum) in zip(names, spectra)
    ]
    rows += [{"name": n, "file": f, "refused": str(error)} for f, n, error in refused]
    run.table("sources.csv", pd.DataFrame(rows), "what was read, repaired and refused")
    bands = dataset.sizes["wavelength"]
    ends = f"{dataset['wavelength'].values[0]:g} to {dataset['wavelength'].values[-1]:g} nm"
    headline = [f"{len(spectra)} spectra of {bands} bands, {ends}, as fractions."]
    inputs = [*dict.fromkeys(file for file, _ in spectra), panel]
    picture = Picture("spectra.png", figures.measured_figure(dataset), "every spectrum")
    sources = Table(pd.DataFrame(rows), "What was read, repaired and refused.", folded=True)
    run.pictures(
        "convert", f"{len(spectra)} measured spectra", headline, [picture, sources], inputs
    )
    return run.result(
        ConvertResult,
        headline=headline,
        warnings=warnings_of_reading(spectra, refused, "sources.csv"),
        status="ok" if not refused else f"{len(refused)} refused: see sources.csv",
        spectra=len(spectra),
        bands=bands,
        refused=refused_spectra(refused),
        repairs=repairs(dataset),
    )

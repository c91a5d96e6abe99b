"""`fynjax convert`."""

from fynjax.cli._fit_leaf import PanelTable, Spectra, existing_panel, existing_spectra
from fynjax.cli._runtime import Job, command


@command("convert")
def convert(spectra: Spectra, panel: PanelTable = None) -> Job:
    """Write spectra of any format as one CSV and one NetCDF.

    Reads ASD, SVC, Spectral Evolution, CSV, text, ECOSTRESS and ENVI libraries, one file or whole
    folders. Writes spectra.csv (wavelengths in nm, a column a spectrum, fractions of 0 to 1),
    spectra.nc (the same with units, file and header of each) and sources.csv.

    Example:  fynjax convert campaign leaf_1.asd --output spectra
    """
    existing_spectra(spectra)
    existing_panel(panel)
    from fynjax import jobs

    return lambda folder: jobs.convert(spectra, folder, panel=panel)

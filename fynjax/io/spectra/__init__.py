"""Spectra from files of field spectrometers, text and ENVI libraries; results of leaf fits."""

from fynjax.io.spectra._asd import read_asd
from fynjax.io.spectra._envi import header_numbers, in_nanometres, open_envi, read_header
from fynjax.io.spectra._export import measured_dataset, measured_table
from fynjax.io.spectra._leaf_results import (
    posterior_dataset,
    prior_decides,
    species_table,
    spectra_dataset,
    traits_table,
    write_spectra_netcdf,
    write_traits_csv,
)
from fynjax.io.spectra._panel import read_curve, with_panel
from fynjax.io.spectra._read import (
    read_spectra,
    read_spectra_files,
    read_usable_spectra,
    reflectances,
)
from fynjax.io.spectra._record import MeasuredSpectrum, note

__all__ = [
    "MeasuredSpectrum",
    "header_numbers",
    "in_nanometres",
    "measured_dataset",
    "measured_table",
    "note",
    "open_envi",
    "posterior_dataset",
    "prior_decides",
    "read_asd",
    "read_curve",
    "read_header",
    "read_spectra",
    "read_spectra_files",
    "read_usable_spectra",
    "reflectances",
    "species_table",
    "spectra_dataset",
    "traits_table",
    "with_panel",
    "write_spectra_netcdf",
    "write_traits_csv",
]

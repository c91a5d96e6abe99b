"""Spectra from files of field spectrometers, text and ENVI libraries."""

from fynjax.io.spectra._asd import read_asd
from fynjax.io.spectra._dataset import (
    Refused,
    example_folder,
    measured_dataset,
    measured_table,
    read_spectra,
    usable_spectra,
    warnings_of_reading,
    write_spectra_netcdf,
)
from fynjax.io.spectra._envi import header_numbers, open_envi, read_header
from fynjax.io.spectra._panel import read_curve
from fynjax.io.spectra._read import read_spectra_file, read_usable_spectra, reflectances
from fynjax.io.spectra._record import MeasuredSpectrum, check_widths, in_nanometres

__all__ = [
    "MeasuredSpectrum",
    "Refused",
    "check_widths",
    "example_folder",
    "header_numbers",
    "in_nanometres",
    "measured_dataset",
    "measured_table",
    "open_envi",
    "read_asd",
    "read_curve",
    "read_header",
    "read_spectra",
    "read_spectra_file",
    "read_usable_spectra",
    "reflectances",
    "usable_spectra",
    "warnings_of_reading",
    "write_spectra_netcdf",
]

"""Files in and out: plot files and their tables, images, runs."""

from fynjax.io._asd import read_asd
from fynjax.io._atomic import atomic_path, staged_folder, write_text
from fynjax.io._build import build_plot
from fynjax.io._fit_leaf import run_fit_leaf
from fynjax.io._netcdf import image_array, provenance, write_run
from fynjax.io._plot import (
    GROWTH_FORMS,
    PROSPECT_COLUMNS,
    Calibration,
    Ground,
    LeafSource,
    Plot,
    Sensor,
    Sky,
    Species,
    Sun,
)
from fynjax.io._plot_file import example_folder, read_plot
from fynjax.io._rasters import ImageMeta, read_image, write_geotiff
from fynjax.io._run_summary import ParameterSummary, RunSummary, StatisticSummary
from fynjax.io._spectra import read_spectra
from fynjax.io._spectra_record import Spectrum
from fynjax.io._statistics import TargetStatistics, read_statistics

__all__ = [
    "GROWTH_FORMS",
    "PROSPECT_COLUMNS",
    "Calibration",
    "Ground",
    "ImageMeta",
    "LeafSource",
    "ParameterSummary",
    "Plot",
    "RunSummary",
    "Sensor",
    "Sky",
    "Species",
    "Spectrum",
    "StatisticSummary",
    "Sun",
    "TargetStatistics",
    "atomic_path",
    "build_plot",
    "example_folder",
    "image_array",
    "provenance",
    "read_asd",
    "read_image",
    "read_plot",
    "read_spectra",
    "read_statistics",
    "run_fit_leaf",
    "staged_folder",
    "write_geotiff",
    "write_run",
    "write_text",
]

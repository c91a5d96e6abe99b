"""Files in and out: plot files and their tables, images, runs."""

from fynjax.io._asd import read_asd
from fynjax.io._atmosphere_file import read_atmosphere
from fynjax.io._atomic import atomic_path, staged_folder, write_text
from fynjax.io._band_stack import BandStack, read_band_stack
from fynjax.io._bioscape import BioscapePlot, BioscapeSpecies, read_bioscape
from fynjax.io._bioscape_files import run_bioscape, write_plot_files
from fynjax.io._build import build_plot
from fynjax.io._fit_leaf import run_fit_leaf
from fynjax.io._lidar_cloud import write_cloud
from fynjax.io._lidar_file import load_lidar
from fynjax.io._netcdf import image_array, provenance, write_run
from fynjax.io._plot import (
    GROWTH_FORMS,
    PROSPECT_COLUMNS,
    Air,
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
from fynjax.io._plot_sensing import build_sensing
from fynjax.io._probability import read_probability_map, write_probability_map
from fynjax.io._products import (
    Cube,
    write_cube_envi,
    write_cube_geotiff,
    write_cubes_netcdf,
)
from fynjax.io._products_read import read_cube
from fynjax.io._rasters import ImageMeta, read_image, write_geotiff
from fynjax.io._run_summary import ParameterSummary, RunSummary, StatisticSummary
from fynjax.io._sensor_file import load_sensor
from fynjax.io._spectra import read_spectra
from fynjax.io._spectra_record import Spectrum
from fynjax.io._statistics import TargetStatistics, read_statistics

__all__ = [
    "GROWTH_FORMS",
    "PROSPECT_COLUMNS",
    "Air",
    "BandStack",
    "BioscapePlot",
    "BioscapeSpecies",
    "Calibration",
    "Cube",
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
    "build_sensing",
    "example_folder",
    "image_array",
    "load_lidar",
    "load_sensor",
    "provenance",
    "read_asd",
    "read_atmosphere",
    "read_band_stack",
    "read_bioscape",
    "read_cube",
    "read_image",
    "read_plot",
    "read_probability_map",
    "read_spectra",
    "read_statistics",
    "run_bioscape",
    "run_fit_leaf",
    "staged_folder",
    "write_cloud",
    "write_cube_envi",
    "write_cube_geotiff",
    "write_cubes_netcdf",
    "write_geotiff",
    "write_plot_files",
    "write_probability_map",
    "write_run",
    "write_text",
]

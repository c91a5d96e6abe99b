"""Rasters in and out: images, cubes, maps, and where they lie on Earth."""

from fynjax.io.raster._align import Alignment, align_bands
from fynjax.io.raster._band_stack import BandStack, band_wavelength, read_band_stack
from fynjax.io.raster._checks import check_north_up, check_square
from fynjax.io.raster._cover_map import read_cover_map
from fynjax.io.raster._cubes import (
    QUANTITIES,
    Cube,
    write_cube_envi,
    write_cube_geotiff,
    write_cubes_netcdf,
)
from fynjax.io.raster._netcdf import file_hash, image_array, provenance, write_run
from fynjax.io.raster._over_plot import read_over_plot
from fynjax.io.raster._probability import read_probability_map, write_probability_map
from fynjax.io.raster._products_read import read_cube
from fynjax.io.raster._reader import METRES, has_place, is_local, open_raster
from fynjax.io.raster._writer import ImageMeta, check_scale, read_image, write_geotiff

__all__ = [
    "METRES",
    "QUANTITIES",
    "Alignment",
    "BandStack",
    "Cube",
    "ImageMeta",
    "align_bands",
    "band_wavelength",
    "check_north_up",
    "check_scale",
    "check_square",
    "file_hash",
    "has_place",
    "image_array",
    "is_local",
    "open_raster",
    "provenance",
    "read_band_stack",
    "read_cover_map",
    "read_cube",
    "read_image",
    "read_over_plot",
    "read_probability_map",
    "write_cube_envi",
    "write_cube_geotiff",
    "write_cubes_netcdf",
    "write_geotiff",
    "write_probability_map",
    "write_run",
]

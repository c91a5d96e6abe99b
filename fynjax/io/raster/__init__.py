"""Rasters in and out: images, cubes, maps, and where they lie on Earth."""

from fynjax.io.raster._align import Alignment, align_bands
from fynjax.io.raster._band_stack import BandStack, read_band_stack
from fynjax.io.raster._blocks import CubeBlocks, MapWriter, open_blocks
from fynjax.io.raster._cover_map import read_cover_map
from fynjax.io.raster._crs import UNITS, check_metric, parse_crs, utm_zone
from fynjax.io.raster._cubes import (
    QUANTITIES,
    Cube,
    write_cube_envi,
    write_cube_geotiff,
    write_cubes_netcdf,
)
from fynjax.io.raster._image import open_image
from fynjax.io.raster._lazy import open_cube
from fynjax.io.raster._netcdf import (
    check_netcdf,
    content_hash,
    file_hash,
    image_array,
    provenance,
    write_run,
)
from fynjax.io.raster._over_plot import read_over_plot
from fynjax.io.raster._probability import read_probability_map
from fynjax.io.raster._qgis import colour_bands, write_qgis_style
from fynjax.io.raster._reader import METRES, RAW_COUNTS, Raster, RasterFile, open_raster
from fynjax.io.raster._scale import RELATIVE_TAG, check_reflectance
from fynjax.io.raster._writer import write_geotiff

__all__ = [
    "METRES",
    "QUANTITIES",
    "RAW_COUNTS",
    "RELATIVE_TAG",
    "UNITS",
    "Alignment",
    "BandStack",
    "Cube",
    "CubeBlocks",
    "MapWriter",
    "Raster",
    "RasterFile",
    "align_bands",
    "check_metric",
    "check_netcdf",
    "check_reflectance",
    "colour_bands",
    "content_hash",
    "file_hash",
    "image_array",
    "open_blocks",
    "open_cube",
    "open_image",
    "open_raster",
    "parse_crs",
    "provenance",
    "read_band_stack",
    "read_cover_map",
    "read_over_plot",
    "read_probability_map",
    "utm_zone",
    "write_cube_envi",
    "write_cube_geotiff",
    "write_cubes_netcdf",
    "write_geotiff",
    "write_qgis_style",
    "write_run",
]

"""Image products of a sensor, out: GeoTIFF, ENVI and NetCDF."""

import os
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pyproj
import xarray as xr
from numpy.typing import NDArray
from rasterio.crs import CRS

from fynjax._core.extras import require
from fynjax.io.raster._netcdf import grid_mapping, image_array, write_run
from fynjax.io.raster._writer import write_geotiff

NODATA = -9999.0
"""Value of pixels without data in written products, as imaging spectrometers' products have it."""

QUANTITIES = {
    "reflectance": ("1", "surface_bidirectional_reflectance", "reflectance factor"),
    "reflectance_sd": (
        "1",
        "surface_bidirectional_reflectance standard_error",
        "standard deviation of the reflectance factor",
    ),
    "radiance": (
        "W m-2 sr-1 um-1",
        "upwelling_radiance_per_unit_wavelength_in_air",
        "radiance at the sensor",
    ),
}
"""Unit, CF standard name and name of what a product may hold."""


@dataclass(frozen=True)
class Cube:
    """An image of any number of bands, with its wavelengths and its place."""

    values: NDArray[np.float64]
    """[band, y, x], y increasing to the north; NaN where there are no data."""
    names: tuple[str, ...]
    """Of the bands."""
    wavelength: NDArray[np.float64] | None
    """Band centres [nm]; `None` where the file says none."""
    fwhm: NDArray[np.float64] | None
    """Full widths at half maximum [nm]; `None` as above."""
    good: NDArray[np.bool_]
    """Bands that are to be used."""
    pixel_m: float | None
    """Side of a pixel [m]; `None` where the file has no place."""
    origin_m: tuple[float, float] | None
    """South-west corner (x, y) [m]; `None` as above."""
    quantity: str = "reflectance"
    """A key of `QUANTITIES`; of a file what it says, if it does, else by its unit."""
    crs: str | None = None
    """Coordinate reference system as WKT; `None` for the plot's own frame, or none."""
    attributes: Mapping[str, str] = field(default_factory=dict)
    """What else a file says."""


def write_cube_geotiff(path: str | Path, cube: Cube, record: Mapping[str, Any]) -> None:
    """Write a cube as GeoTIFF; `record` becomes its tags, such as that of `provenance`."""
    write_geotiff(
        path,
        cube.values,
        list(cube.names),
        **_place(cube),
        wavelengths=_listed(cube.wavelength),
        widths=_listed(cube.fwhm),
        crs=cube.crs,
        nodata=NODATA,
        tags={
            "quantity": cube.quantity,
            "units": QUANTITIES[cube.quantity][0],
            **{k: str(v) for k, v in record.items()},
        },
    )


def write_cube_envi(path: str | Path, cube: Cube, record: Mapping[str, Any]) -> None:
    """Write a cube as ENVI file: the header `path` (.hdr), and beside it the data (.dat).

    Interleaved by line, float32. The header has wavelengths and widths in nanometres, the list of
    bad bands, the place and its reference system, and `record`. Neither file appears until both are
    complete. Raises `MissingExtraError` without SPy (the extra `envi`).
    """
    envi = require("spectral.io.envi", "envi", "spectral")
    path = Path(path)
    unit, _, name = QUANTITIES[cube.quantity]
    values = np.where(np.isfinite(cube.values), cube.values, NODATA).astype(np.float32)
    header: dict[str, Any] = {
        "description": f"{name} [{unit}], {record.get('source', 'fynjax')}",
        "band names": list(cube.names),
        "bbl": [int(good) for good in cube.good],
        "data ignore value": NODATA,
        **_envi_place(cube),
        "data units": unit,
        "fynjax quantity": cube.quantity,
        **{f"fynjax {key}": _plain(value) for key, value in record.items()},
    }
    if cube.wavelength is not None:
        header["wavelength"] = [f"{v:.6g}" for v in cube.wavelength]
        header["wavelength units"] = "Nanometers"
    if cube.fwhm is not None:
        header["fwhm"] = [f"{v:.6g}" for v in cube.fwhm]
    path.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=path.parent, prefix=".envi_") as folder:
        written = Path(folder) / path.name
        envi.save_image(
            str(written),
            np.ascontiguousarray(values[:, ::-1].transpose(1, 2, 0)),
            dtype=np.float32,
            interleave="bil",
            ext=".dat",
            byteorder=0,
            metadata=header,
        )
        os.replace(written.with_suffix(".dat"), path.with_suffix(".dat"))
        os.replace(written, path)


def write_cubes_netcdf(
    path: str | Path, cubes: Mapping[str, Cube], record: Mapping[str, Any]
) -> None:
    """Write cubes of the same bands and pixels as variables of one NetCDF file."""
    variables = {}
    for name, cube in cubes.items():
        unit, standard, long = QUANTITIES[cube.quantity]
        if cube.wavelength is None or cube.fwhm is None:
            raise ValueError("a cube must have wavelengths and widths to be written as NetCDF")
        array = image_array(
            cube.values.astype(np.float32),
            list(cube.names),
            list(cube.wavelength),
            **_place(cube),
            crs=cube.crs,
            long_name=long,
            standard_name=standard,
            units=unit,
        )
        array = array.assign_coords(
            fwhm=(
                "band",
                cube.fwhm,
                {"units": "nm", "long_name": "full width of the band at half maximum"},
            ),
        )
        array.attrs["pixel_m"] = cube.pixel_m  # one pixel alone does not show its side
        array.encoding["_FillValue"] = np.float32(NODATA)
        variables[name] = array
        variables[f"{name}_good"] = xr.DataArray(
            cube.good.astype(np.int8),
            dims="band",
            attrs={
                "long_name": f"bands of the {long} that are to be used",
                "units": "1",
                "flag_values": np.array([0, 1], np.int8),
                "flag_meanings": "bad good",
            },
        )
        if cube.crs is not None:
            variables["crs"] = grid_mapping(cube.crs)
    write_run(path, xr.Dataset(variables), record)


def _place(cube: Cube) -> dict[str, Any]:
    if cube.pixel_m is None or cube.origin_m is None:
        raise ValueError("a cube must have a place to be written, but has none")
    return {"origin_m": cube.origin_m, "pixel_m": cube.pixel_m}


def _envi_place(cube: Cube) -> dict[str, Any]:
    """Where an ENVI header says that the image lies."""
    (west, south), pixel = _place(cube).values()
    # The corner of the first pixel, which is the north-western one.
    corner = (west, south + cube.values.shape[1] * pixel, pixel, pixel)
    numbers = ["1", "1", *(f"{v:.12g}" for v in corner)]
    if cube.crs is None:
        return {"map info": ["Arbitrary", *numbers, "0", "units=Meters"]}
    system = pyproj.CRS.from_user_input(cube.crs)
    esri = CRS.from_user_input(cube.crs).to_wkt(version="WKT1_ESRI")
    name, zone = system.name.replace(",", " "), []
    if system.utm_zone is not None and "WGS 84" in name:
        half = "North" if system.utm_zone.endswith("N") else "South"
        name, zone = "UTM", [system.utm_zone[:-1], half, "WGS-84"]
    return {
        "map info": [name, *numbers, *zone, "units=Meters"],
        "coordinate system string": f"{{{esri}}}",  # of a list SPy would change the commas
    }


def _listed(values: NDArray[np.float64] | None) -> list[float] | None:
    return None if values is None else values.tolist()


def _plain(value: Any) -> str:
    """Text without what an ENVI header takes for its own."""
    return " ".join(str(value).translate(str.maketrans("{}=", "()~")).split())

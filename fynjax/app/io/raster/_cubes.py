"""Image products of a sensor as GeoTIFF, ENVI and NetCDF."""

import os
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import rasterio
import xarray as xr
from jaxtyping import Bool, Float

from fynjax.app.io.raster._netcdf import grid_mapping, image_array, write_run
from fynjax.app.io.raster._writer import grid_profile, north_up, write_geotiff

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
    """An image product: any number of bands with their wavelengths, and where it lies."""

    values: Float[np.ndarray, "band y x"]
    """Values [band, y, x], y increasing to the north; NaN where there are no data."""
    names: tuple[str, ...]
    """Names of the bands."""
    wavelength: Float[np.ndarray, " band"]
    """Band centres [nm]."""
    fwhm: Float[np.ndarray, " band"]
    """Full widths of the bands at half maximum [nm]."""
    good: Bool[np.ndarray, " band"]
    """Bands that are to be used."""
    pixel_m: float
    """Side of a pixel [m]."""
    origin_m: tuple[float, float]
    """South-west corner (x, y) of the image [m]."""
    quantity: str = "reflectance"
    """Quantity of the values, a key of `QUANTITIES`."""
    crs: str | None = None
    """Coordinate reference system as WKT; `None` for the plot's own frame."""


def write_cube_geotiff(path: str | Path, cube: Cube, record: Mapping[str, Any]) -> None:
    """Write a cube as GeoTIFF, whole or not at all.

    **Arguments:**

    - `path`: the file to write.
    - `cube`: in the unit of its quantity (`QUANTITIES`).
    - `record`: becomes the file's tags, such as that of `provenance`.
    """
    write_geotiff(
        path,
        cube.values,
        list(cube.names),
        pixel_m=cube.pixel_m,
        origin_m=cube.origin_m,
        wavelengths=cube.wavelength.tolist(),
        widths=cube.fwhm.tolist(),
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
    complete.

    **Arguments:**

    - `path`: the header to write.
    - `cube`: in the unit of its quantity (`QUANTITIES`).
    - `record`: becomes fields of the header, such as that of `provenance`.
    """
    path = Path(path)
    unit, _, name = QUANTITIES[cube.quantity]
    bands, rows, columns = cube.values.shape
    header = {
        "wavelength": _listed([f"{v:.6g}" for v in cube.wavelength]),
        "wavelength_units": "Nanometers",
        "fwhm": _listed([f"{v:.6g}" for v in cube.fwhm]),
        "bbl": _listed([int(good) for good in cube.good]),
        "data_units": unit,
        "fynjax_quantity": cube.quantity,
        **{f"fynjax_{key}": _plain(value) for key, value in record.items()},
    }
    transform = north_up(cube.pixel_m, cube.origin_m, rows)
    profile = grid_profile(bands, (rows, columns), transform, cube.crs, NODATA)
    if cube.crs is None:
        del profile["crs"]
    values = np.where(np.isfinite(cube.values), cube.values, NODATA).astype(np.float32)
    path.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=path.parent, prefix=".envi_") as folder:
        data = (Path(folder) / path.name).with_suffix(".dat")
        with rasterio.open(data, "w", driver="ENVI", interleave="bil", **profile) as file:
            file.write(np.ascontiguousarray(values[:, ::-1]))
            file.descriptions = cube.names
            file.update_tags(ns="ENVI", **header)
        written = data.with_suffix(".hdr")
        text = written.read_text(encoding="utf-8")  # GDAL describes it by its temporary name
        described = f"{name} [{unit}], {_plain(record.get('source', 'fynjax'))}"
        written.write_text(text.replace(f"\n{data}}}", f"\n{described}}}"), encoding="utf-8")
        os.replace(data, path.with_suffix(".dat"))
        os.replace(written, path)


def write_cubes_netcdf(
    path: str | Path, cubes: Mapping[str, Cube], record: Mapping[str, Any]
) -> None:
    """Write cubes of the same bands and pixels as variables of one NetCDF file.

    **Arguments:**

    - `path`: the file to write.
    - `cubes`: by the name of their variable, in the units of their quantities (`QUANTITIES`).
    - `record`: becomes the file's attributes, such as that of `provenance`.
    """
    variables = {}
    for name, cube in cubes.items():
        unit, standard, long = QUANTITIES[cube.quantity]
        array = image_array(
            cube.values.astype(np.float32),
            list(cube.names),
            list(cube.wavelength),
            pixel_m=cube.pixel_m,
            origin_m=cube.origin_m,
            crs=cube.crs,
            long_name=long,
            standard_name=standard,
            units=unit,
        )
        about = {"units": "nm", "long_name": "full width of the band at half maximum"}
        array = array.assign_coords(fwhm=("band", cube.fwhm, about))
        array.attrs["pixel_m"] = cube.pixel_m  # one pixel alone does not show its side
        array.encoding["_FillValue"] = np.float32(NODATA)
        variables[name] = array
        flags = {"flag_values": np.array([0, 1], np.int8), "flag_meanings": "bad good"}
        flags |= {"long_name": f"bands of the {long} that are to be used", "units": "1"}
        good = xr.DataArray(cube.good.astype(np.int8), dims="band", attrs=flags)
        variables[f"{name}_good"] = good
        if cube.crs is not None:
            variables["crs"] = grid_mapping(cube.crs)
    write_run(path, xr.Dataset(variables), record)


def _listed(values: Sequence[Any]) -> str:
    """A list as an ENVI header has it."""
    return f"{{ {' , '.join(map(str, values))} }}"


def _plain(value: Any) -> str:
    """Text without what an ENVI header takes for its own."""
    return " ".join(str(value).translate(str.maketrans("{}=", "()~")).split())

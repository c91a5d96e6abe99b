"""Image products of a sensor: GeoTIFF, ENVI and NetCDF out, GeoTIFF and ENVI in."""

import os
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import rasterio
import xarray as xr
from numpy.typing import NDArray
from rasterio.crs import CRS

from fynjax._core.errors import InputError
from fynjax.io.raster._netcdf import grid_mapping, image_array, write_run
from fynjax.io.raster._reader import open_raster
from fynjax.io.raster._writer import north_up, write_geotiff
from fynjax.sensors import RADIANCE_UNITS

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
_NO_UNIT = ("", "1", "none", "unitless", "reflectance")


@dataclass(frozen=True)
class Cube:
    """An image of any number of bands, with its wavelengths and its place."""

    values: NDArray[np.float64]
    """Values [band, y, x], y increasing to the north; NaN where there are no data."""
    names: tuple[str, ...]
    """Names of the bands."""
    wavelength: NDArray[np.float64] | None
    """Band centres [nm]; `None` where the file says none."""
    fwhm: NDArray[np.float64] | None
    """Full widths of the bands at half maximum [nm]; `None` where the file says none."""
    good: NDArray[np.bool_]
    """Bands that are to be used."""
    pixel_m: float | None
    """Side of a pixel [m]; `None` where the file has no place."""
    origin_m: tuple[float, float] | None
    """South-west corner (x, y) of the image [m]; `None` where the file has no place."""
    quantity: str = "reflectance"
    """What the values are, a key of `QUANTITIES`: as the file says, else by its unit."""
    crs: str | None = None
    """Coordinate reference system as WKT; `None` for the plot's own frame, or none."""
    attributes: Mapping[str, str] = field(default_factory=dict)
    """What else a file says."""


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
        **_place(cube),
        wavelengths=None if cube.wavelength is None else cube.wavelength.tolist(),
        widths=None if cube.fwhm is None else cube.fwhm.tolist(),
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
    place = _place(cube)
    header = {
        "bbl": _listed([int(good) for good in cube.good]),
        "data_units": unit,
        "fynjax_quantity": cube.quantity,
        **{f"fynjax_{key}": _plain(value) for key, value in record.items()},
    }
    if cube.wavelength is not None:
        header["wavelength"] = _listed([f"{v:.6g}" for v in cube.wavelength])
        header["wavelength_units"] = "Nanometers"
    if cube.fwhm is not None:
        header["fwhm"] = _listed([f"{v:.6g}" for v in cube.fwhm])
    profile = {
        "dtype": "float32",
        "count": bands,
        "height": rows,
        "width": columns,
        "crs": None if cube.crs is None else CRS.from_user_input(cube.crs),
        "transform": north_up(place["pixel_m"], place["origin_m"], rows),
        "nodata": NODATA,
        "interleave": "bil",
    }
    values = np.where(np.isfinite(cube.values), cube.values, NODATA).astype(np.float32)
    path.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=path.parent, prefix=".envi_") as folder:
        data = (Path(folder) / path.name).with_suffix(".dat")
        with rasterio.open(data, "w", driver="ENVI", **profile) as file:
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


def _listed(values: Sequence[Any]) -> str:
    """A list as an ENVI header has it."""
    return f"{{ {' , '.join(map(str, values))} }}"


def _plain(value: Any) -> str:
    """Text without what an ENVI header takes for its own."""
    return " ".join(str(value).translate(str.maketrans("{}=", "()~")).split())


def read_cube(path: str | Path) -> Cube:
    """Read an image of any number of bands: ENVI (header or data file), GeoTIFF, or what else GDAL
    reads. (A NetCDF product is one for xarray: `xr.open_dataset(path).reflectance`.)

    **Arguments:**

    - `path`: the image; of an ENVI file the header or the data.

    **Returns:** a `Cube`: no-data values are NaN, wavelengths in nm whatever the header's unit,
    reflectance [-] or radiance [W m-2 sr-1 um-1].

    **Raises:** `InputError` as `open_raster`; for a header with another number of wavelengths than
    bands or an unknown unit; and for an image that is rotated.

    >>> import pathlib, tempfile
    >>> import numpy as np
    >>> from fynjax.io.raster import read_cube, write_geotiff
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = pathlib.Path(folder) / "image.tif"
    ...     write_geotiff(
    ...         path, np.full((2, 3, 4), 0.25), ["red", "nir"], pixel_m=0.5,
    ...         wavelengths=[660.0, 860.0], crs="EPSG:32734",
    ...     )
    ...     cube = read_cube(path)
    >>> cube.values.shape, cube.names, cube.pixel_m
    ((2, 3, 4), ('red', 'nir'), 0.5)
    >>> cube.wavelength
    array([660., 860.])
    """
    with open_raster(path, "an image") as file:
        pixel = file.cell_m
        raster = file.read()
        wavelength, fwhm = (None if np.isnan(v).any() else v for v in (file.wavelengths, file.fwhm))
    if not np.isfinite(raster.values).any():
        raise InputError(
            "expected an image, but all of its pixels are without data", file=file.path
        )
    unit = file.tags.get("units", file.tags.get("data units", "")).strip()
    if unit not in RADIANCE_UNITS and unit.lower() not in _NO_UNIT:
        raise InputError(
            f"expected values in one of {', '.join(map(repr, RADIANCE_UNITS))}, or reflectance "
            f"('1'), but the file says {unit!r}",
            file=file.header_path,
        )
    stated = file.tags.get("quantity", file.tags.get("fynjax quantity", ""))
    quantity = stated if stated in QUANTITIES else "reflectance"
    return Cube(
        values=raster.values * RADIANCE_UNITS.get(unit, 1.0),
        names=tuple(name or f"band_{n}" for n, name in enumerate(file.names, start=1)),
        wavelength=wavelength,
        fwhm=fwhm,
        good=file.good & (bool(file.header) | np.isfinite(raster.values).any(axis=(1, 2))),
        pixel_m=pixel,
        origin_m=None if pixel is None else raster.origin,
        quantity="radiance" if unit in RADIANCE_UNITS else quantity,
        crs=file.crs.to_wkt() if file.crs else None,
        attributes=file.tags,
    )

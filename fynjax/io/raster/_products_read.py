"""Images of any number of bands, in: ENVI, GeoTIFF and the product's own NetCDF."""

from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from fynjax._core.errors import InputError
from fynjax.io.raster._cubes import QUANTITIES, Cube
from fynjax.io.raster._reader import open_raster
from fynjax.io.raster._writer import _placement
from fynjax.io.spectra import envi_pair, header_wavelengths, read_header
from fynjax.io.text import existing_file
from fynjax.sensors import RADIANCE_UNITS

_ENVI_DATA = (".dat", ".img", ".bil", ".bsq", ".bip")
_BYTES = {
    "1": 1,
    "2": 2,
    "3": 4,
    "4": 4,
    "5": 8,
    "6": 8,
    "9": 16,
    "12": 2,
    "13": 4,
    "14": 8,
    "15": 8,
}


def read_cube(path: str | Path, quantity: str | None = None) -> Cube:
    """Read an image of any number of bands: ENVI (header or data file), NetCDF, or GeoTIFF.

    **Arguments:** `quantity`, 'reflectance' or 'radiance', of a NetCDF file that has both.

    **Returns:** a `Cube`: no-data values are NaN, wavelengths in nm whatever the header's unit.

    **Raises:** `InputError` for a file that is missing, cut short or no image; an ENVI header that
    lacks a field, has another number of wavelengths than bands or an unknown unit; an image that
    is rotated.
    """
    path = Path(path)
    if path.suffix.lower() in (".nc", ".nc4"):
        return _read_netcdf(path, quantity)
    beside = (path.with_suffix(".hdr"), path.with_name(path.name + ".hdr"))
    tiff = path.suffix.lower() in (".tif", ".tiff")
    if path.suffix.lower() == ".hdr" or (not tiff and any(p.is_file() for p in beside)):
        return _read_envi(path)
    return _read_raster(path, {}, path)


def _read_envi(path: Path) -> Cube:
    header_path, data_path = envi_pair(path, _ENVI_DATA, "image")
    header = read_header(header_path)
    try:
        size = [int(header[key]) for key in ("bands", "lines", "samples")]
        each = _BYTES[header["data type"]]
        offset = int(header.get("header offset", "0") or 0)
    except (KeyError, ValueError) as error:
        raise InputError(
            f"the header needs samples, lines, bands and data type; wrong: {error}",
            file=header_path,
        ) from error
    if min(size) < 1:
        raise InputError(
            f"expected an image of at least one pixel, but it has {size[2]} samples, {size[1]} "
            f"lines and {size[0]} bands",
            file=header_path,
        )
    needed, there = offset + int(np.prod(size)) * each, data_path.stat().st_size
    if there < needed:
        raise InputError(
            f"the file is cut short: {size[1]} lines of {size[2]} samples in {size[0]} bands need "
            f"{needed} bytes, but it has {there}. Copy it again.",
            file=data_path,
        )
    return _read_raster(data_path, header, header_path)


def _read_raster(path: Path, header: dict[str, str], header_path: Path) -> Cube:
    """An open raster; `header` is its ENVI header, where it has one."""
    with open_raster(path, "an image") as file:
        pixel, origin, north_up = _placement(file, path)
        raw = file.read().astype(np.float64)
        valid = file.read_masks() > 0
        scale, offset = (np.array(v)[:, None, None] for v in (file.scales, file.offsets))
        tags = {str(k): str(v) for k, v in file.tags().items()}
        by_band = [file.tags(n) for n in range(1, file.count + 1)]
        names = tuple(d or f"band_{n}" for n, d in enumerate(file.descriptions, start=1))
        crs = file.crs.to_wkt() if file.crs else None
    values = np.where(valid, raw * scale + offset, np.nan)
    count = len(values)
    if header:
        wavelength, fwhm, good = _spectral_axis(header, header_path, count)
        factor = float(header.get("reflectance scale factor", "1") or 1)
        values = values / factor
        listed = [n.strip() for n in header.get("band names", "").split(",")]
        names = tuple(listed) if len(listed) == count else names
        tags = header
    else:
        wavelength, fwhm = (_of_tags(by_band, key) for key in ("wavelength", "fwhm"))
        good = np.asarray(np.isfinite(values).any(axis=(1, 2)))
    if not np.isfinite(values).any():
        raise InputError("expected an image, but all of its pixels are without data", file=path)
    if north_up:
        values = values[:, ::-1]
    unit = tags.get("units", tags.get("data units", "")).strip()
    if unit in RADIANCE_UNITS:
        values = values * RADIANCE_UNITS[unit]
    elif unit.lower() not in ("", "1", "none", "unitless", "reflectance"):
        raise InputError(
            f"expected values in one of {', '.join(map(repr, RADIANCE_UNITS))}, or reflectance "
            f"('1'), but the file says {unit!r}",
            file=header_path if header else path,
        )
    return Cube(
        np.ascontiguousarray(values),
        names,
        wavelength,
        fwhm,
        good,
        pixel,
        origin,
        "radiance" if unit in RADIANCE_UNITS else _told(tags),
        crs,
        tags,
    )


def _told(tags: dict[str, str]) -> str:
    """What an image without unit holds, as a product of this program says it."""
    told = tags.get("quantity", tags.get("fynjax quantity", ""))
    return told if told in QUANTITIES else "reflectance"


def _spectral_axis(
    header: dict[str, str], path: Path, count: int
) -> tuple[NDArray[np.float64] | None, NDArray[np.float64] | None, NDArray[np.bool_]]:
    """Centres, widths [nm] and use of the bands, as an ENVI header has them."""
    wavelength = fwhm = None
    factor = 1.0
    try:
        if "wavelength" in header:
            wavelength, factor = header_wavelengths(header, path)
        if "fwhm" in header:
            fwhm = factor * np.array([float(v) for v in header["fwhm"].split(",")])
        good = np.array(
            [float(v) != 0.0 for v in header.get("bbl", "1," * (count - 1) + "1").split(",")]
        )
    except InputError:
        raise
    except ValueError as error:
        raise InputError(f"expected lists of numbers, but {error}", file=path) from error
    for key, values in (("wavelength", wavelength), ("fwhm", fwhm), ("bbl", good)):
        if values is not None and len(values) != count:
            raise InputError(
                f"expected {count} values, one for each band, but got {len(values)}",
                file=path,
                column=key,
            )
    return wavelength, fwhm, good


def _of_tags(by_band: list[dict[str, str]], key: str) -> NDArray[np.float64] | None:
    try:
        return np.array([float(tags[key]) for tags in by_band])
    except (KeyError, ValueError):
        return None


def _read_netcdf(path: Path, quantity: str | None) -> Cube:
    existing_file(path, "an image")
    try:
        with xr.open_dataset(path, engine="netcdf4") as data:
            data = data.load()
    except (OSError, ValueError) as error:
        raise InputError(
            f"expected a NetCDF file, but cannot read it: {error}", file=path
        ) from error
    found = [n for n in QUANTITIES if n in data]
    wanted = found[0] if quantity is None and found else quantity
    if wanted not in found:
        raise InputError(
            f"expected a variable {wanted or ' or '.join(QUANTITIES)!r}, but the file has "
            f"{', '.join(map(str, data.data_vars))}",
            file=path,
        )
    array: Any = data[wanted]
    if array.dims != ("band", "y", "x") or not {"wavelength", "band"} <= set(array.coords):
        raise InputError(
            f"expected {wanted} with axes band, y, x and wavelengths, but it has "
            f"{', '.join(map(str, array.dims))}",
            file=path,
        )
    x, y = (np.asarray(array[axis].values, float) for axis in "xy")
    values = np.asarray(array.values, float)
    pixel = float(array.attrs.get("pixel_m", x[1] - x[0] if x.size > 1 else np.nan))
    known = np.isfinite(pixel)
    mapping = data.get(array.attrs.get("grid_mapping", ""))
    return Cube(
        values,
        tuple(map(str, array["band"].values)),
        np.asarray(array["wavelength"].values, float),
        np.asarray(array["fwhm"].values, float) if "fwhm" in array.coords else None,
        np.asarray(data[f"{wanted}_good"].values, bool)
        if f"{wanted}_good" in data
        else np.isfinite(values).any(axis=(1, 2)),
        pixel if known else None,
        (float(x[0] - pixel / 2), float(y[0] - pixel / 2)) if known else None,
        str(wanted),
        None if mapping is None else mapping.attrs.get("crs_wkt"),
        {str(k): str(v) for k, v in data.attrs.items()},
    )

"""Cubes by blocks of rows, and maps written by blocks: neither is ever in memory as a whole."""

import math
import os
import re
import shutil
import struct
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pyproj
import rasterio
import rasterio.shutil
import xarray as xr
from jaxtyping import Bool, Float
from rasterio import Affine
from rasterio.crs import CRS
from rasterio.errors import RasterioError
from rasterio.windows import Window

from fynjax._core.checkpoint import Journal, forget_journal
from fynjax._core.errors import InputError, in_file, listed, refusing
from fynjax._core.extras import require
from fynjax._core.files import check_name
from fynjax._core.memory import bounded_memory
from fynjax.app.io.raster._crs import check_in_area, geotransform, parse_crs
from fynjax.app.io.raster._groups import WAVELENGTHS, ordered_axes, read_tree, with_groups
from fynjax.app.io.raster._lookup import lookup_table
from fynjax.app.io.raster._netcdf import CONVENTIONS, check_netcdf, with_history
from fynjax.app.io.raster._reader import RasterFile, open_raster, wherever
from fynjax.app.io.raster._scale import check_reflectance
from fynjax.app.io.raster._writer import LOCAL_FRAME, grid_profile
from fynjax.app.io.raster._zarr import check_zarr
from fynjax.app.io.spectra import check_widths, in_nanometres
from fynjax.app.io.text import atomic_path, check_fits

_SIZE = 2**27
"""Bytes of a block, about."""
_MOST_CHUNKS = 1 << 14
"""Chunks that a row of pixels may lie in."""
_MOST_REFLECTANCE = 2.5
"""Beyond, values are no reflectance factors but counts, such as ten thousandths."""
_LEAST_REFLECTANCE = 0.01
"""Least of the brightest values of a reflectance image [-]; below, its scale is another."""
_DARK = -0.01
"""Below, a value is a mark for missing data: spectrometers' noise about black is smaller."""
_NO_NOISE = 5.0
"""A reflectance further below 0 marks missing data; noise in the air's absorption bands is less."""
_FEW_BANDS = 4
"""In fewer, one negative number in all of them may be noise."""
_INNER = 512
"""Side of the tiles of a map [pixels]."""


@dataclass(frozen=True)
class CubeBlocks:
    """An open image of reflectance, to be read by blocks of rows, row 0 at the top of the file."""

    path: Path
    shape: tuple[int, int]
    """Rows and columns of pixels."""
    wavelength: Float[np.ndarray, " band"]
    """Centre of each band [nm]; NaN where the file says none."""
    fwhm: Float[np.ndarray, " band"]
    """Full width of each band at half maximum [nm]; NaN where the file says none."""
    good: Bool[np.ndarray, " band"]
    """Bands that are to be used."""
    transform: Affine
    """Affine map from column and row to x and y; the identity without a place, and of a swath."""
    crs: str | None
    """Coordinate reference system as WKT."""
    source: Any
    """File or array that `read` takes values of."""
    location: xr.Dataset | None = None
    """Lookup table that places the pixels of a swath on a map, with the file's attributes; `None`
    for what is no swath."""
    names: tuple[str, ...] = ()
    """Names of the bands, empty ones where the file has none."""
    valid: tuple[float, float] = (-math.inf, math.inf)
    """Least and largest value that is data, as the file says."""

    @property
    def files(self) -> tuple[Path, ...]:
        """All files and folders that it is read from."""
        if not isinstance(self.source, RasterFile):
            return (self.path,)
        names = map(Path, self.source.dataset.files)
        return tuple(sorted({self.path.absolute(), self.source.header_path.absolute(), *names}))

    @property
    def rows_at_once(self) -> int:
        """Rows of a block that fits well in memory."""
        row = 4 * self.shape[1] * len(self.wavelength)
        return int(min(max(_SIZE // max(row, 1), 1), self.shape[0]))

    def read(self, start: int, rows: int) -> Float[np.ndarray, "row column band"]:
        """Reflectance of `rows` rows from `start` on, as the file scales it [-]; NaN without data.

        Warns where pixels have one negative number in all bands: a mark of missing data that the
        file does not declare, taken as one.

        **Raises:** `InputError` naming the rows where they cannot be read.
        """
        window = Window(0, start, self.shape[1], rows)
        place = f"rows {start + 1} to {start + rows}"
        words = f"{place} cannot be read ({{error}}). Is the file damaged there?"
        with refusing(RasterioError, *_UNREADABLE, words=words, file=self.path):
            if isinstance(self.source, RasterFile):
                raster = self.source.read(
                    self.source.bands, window=window, zero_is_data=False, dtype=np.float32
                )
                values = np.moveaxis(raster.values, 0, 2)
                t = self.transform
                return self._marked(values[::-1] if t.is_identity or t.e < 0 else values)
            part = self.source.isel({self.source.dims[0]: slice(start, start + rows)})
            # A scale may lead beyond what a float holds.
            with np.errstate(all="ignore"), bounded_memory(self.path):
                values = np.asarray(part.values, np.float32)
        low, high = self.valid
        values = np.where((np.abs(values) > 1e6) | (values < low) | (values > high), np.nan, values)
        values = np.where((values == 0).all(axis=2, keepdims=True), np.nan, values)
        return self._marked(values)

    def _marked(
        self, values: Float[np.ndarray, "row column band"]
    ) -> Float[np.ndarray, "row column band"]:
        """The values without pixels that have one negative number in all bands."""
        if values.shape[2] < _FEW_BANDS:
            return values
        first = values[..., :1]
        marked = (first < 0.0) & (values == first).all(axis=2, keepdims=True)
        if not marked.any():
            return values
        warnings.warn(
            f"{self.path}: pixels with {first[marked][0]:g} in all bands are taken for missing "
            "data, which the file does not declare",
            stacklevel=3,
        )
        return np.where(marked, np.float32(np.nan), values)

    @property
    def _eight_bits(self) -> bool:
        """Whether the file holds whole numbers of 8 bits."""
        if isinstance(self.source, RasterFile):
            kinds = self.source.dataset.dtypes
        else:
            kinds = [self.source.encoding.get("dtype", self.source.dtype)]
        return all(np.dtype(kind).kind in "iu" and np.dtype(kind).itemsize == 1 for kind in kinds)

    def sample(self) -> Float[np.ndarray, "pixel band"]:
        """Pixels of some four rows, as `read`, whose errors it raises."""
        step = max(self.shape[0] // 4, 1)
        parts = [self.read(start, 1) for start in range(0, self.shape[0], step)]
        return np.concatenate([p.reshape(-1, p.shape[2]) for p in parts])

    def scale(self) -> float:
        """What values are divided by to become reflectance factors: 1, or 10 000 where a sample of
        the pixels shows that they are ten thousandths.

        **Raises:** `InputError` for values that are neither, such as radiance or numbers of 8 bits,
        without data, and for numbers that mark missing data and are not declared.
        """
        sample = self.sample()[:, self.good]
        finite = sample[np.isfinite(sample)]
        values = finite[finite > _DARK]
        if not finite.size:  # the sampled rows may lie in a border
            return 1.0
        high = float(np.quantile(values, 0.95)) if values.size else 0.0
        scale = 1.0 if high <= _MOST_REFLECTANCE else 1e4
        lowest = float(finite.min())
        if values.size < 0.5 * finite.size and lowest >= -_NO_NOISE * scale:
            raise InputError(
                "expected reflectance of at least 0, but most values are below, down to "
                f"{lowest:g}. Does the file state a scale below 0?",
                file=self.path,
            )
        if lowest < -_NO_NOISE * scale:
            raise InputError(
                f"expected reflectance of at least 0, but got {lowest:g}. A mark of missing data "
                f"that the file does not declare? Declare it: gdal_edit.py -a_nodata {lowest:g}, "
                "'data ignore value' in an ENVI header, _FillValue in NetCDF",
                file=self.path,
            )
        if high < _LEAST_REFLECTANCE or (scale != 1.0 and self._eight_bits):
            check_reflectance(high, self.path, eight_bits=self._eight_bits)
        if scale == 1.0 or 100.0 < high <= 1e4 * _MOST_REFLECTANCE:
            return scale
        raise InputError(
            "expected reflectance, as shares or in ten thousandths, but 5 % of the values are "
            f"above {high:.3g}. Is this radiance, or in percent?",
            file=self.path,
        )


@contextmanager
def open_blocks(path: str | Path) -> Iterator[CubeBlocks]:
    """Open an image of reflectance of any size: ENVI, GeoTIFF, NetCDF or zarr.

    **Arguments:** `path`; of an ENVI image the header or the data. NetCDF (as EMIT's are, too) and
    zarr hold a variable `reflectance` and its wavelengths, NetCDF and HDF5 also in a group, as
    those of AVIRIS-3, AVIRIS-5 and NEON do; axes and place go by what they say. EMIT's are swaths,
    rows and columns as the sensor saw them: `MapWriter` places what is made of them by the file's
    own lookup table.

    **Raises:** `InputError` for what is none of these, as `open_raster`, for a variable of other
    than three dimensions, and for coordinates that only in kilometres are in the area of their
    system. Warns of coordinates of a map without a system.
    """
    path = Path(path)
    check_name(path)
    if path.suffix.lower() in (".nc", ".nc4", ".h5", ".hdf5", ".zarr"):
        with in_file(path), ExitStack() as opened:
            # The file may have two marks of no data.
            with warnings.catch_warnings(action="ignore", category=xr.SerializationWarning):
                cube = _cube_of(path, opened)
            yield cube
        return
    with open_raster(path, "an image") as file:
        about = str(file.header.get("description")).replace(file.path.name, "")
        about = re.sub(r"\S*[/\\]\S*", "", about)  # GDAL writes the file's path there
        _check_no_radiance(about, units=(file.header.get("data units"), *file.dataset.units))
        places = np.array(file.bands) - 1
        # GeoTIFF's own tags may call bands bad.
        marks = [file.dataset.tags(n).get("bbl", "1").strip() for n in file.bands]
        yield CubeBlocks(
            path=file.path,
            shape=file.shape,
            wavelength=file.wavelengths[places],
            fwhm=file.fwhm[places],
            good=file.good[places] & ~np.isin(marks, ("0", "0.0", "false")),
            transform=file.dataset.transform,
            crs=file.crs.to_wkt() if file.crs else None,
            source=file,
            names=tuple(file.names[n - 1] or "" for n in file.bands),
        )


def _check_no_radiance(about: str, units: Sequence[Any] = ()) -> None:
    """Refuse what its file calls radiance, in words or by a unit per steradian."""
    texts = [text for text in map(str, units) if _STERADIAN.search(text)]
    if _RADIANCE.search(about) and "reflectance" not in about.lower():
        texts.append(about.strip())
    if texts:
        raise InputError(f"expected reflectance, but the file says that it is radiance: {texts[0]}")


_UNREADABLE = (
    *(OSError, ValueError, LookupError, RuntimeError, AttributeError, TypeError),
    *(ArithmeticError, AssertionError, MemoryError, struct.error),
)
"""Errors that the libraries raise at damaged files."""


_RADIANCE = re.compile(r"(?<!ir)radiance", re.I)
_STERADIAN = re.compile(r"(?<!ir)radiance|\b(?:sr|str|steradians?)(?:\b|[-^])", re.I)
_BAND = re.compile(r"(?:sr_)?b(?:and)?_?\d+a?|blue|green|red|red_?edge\d*|nir\d*|swir_?\d*", re.I)
"""Names of variables, each a band, as images of satellites are kept in xarray."""


def _with_bands(data: xr.Dataset) -> xr.Dataset:
    """The dataset with a variable `reflectance` where variables, or the coordinate `band` of its
    only image, have names of bands."""
    if "reflectance" in data:
        return data
    bands = [str(name) for name in data.data_vars if _BAND.fullmatch(str(name))]
    if len(bands) > 1 and len({data[name].dims for name in bands}) == 1:
        values = data[bands].to_dataarray("band").assign_attrs(data[bands[0]].attrs)
        values.encoding = {k: v for k, v in data[bands[0]].encoding.items() if k == "grid_mapping"}
        return data.drop_vars(bands).assign(reflectance=values)
    images = {
        name: v for name, v in data.data_vars.items() if v.ndim >= 3 and "band" in v.coords
    }  # fmt: skip
    if len(images) == 1:
        ((name, values),) = images.items()
        if values["band"].dtype.kind in "OSUT":
            _check_no_radiance(str(name))
            return data.rename({name: "reflectance"})
    return data


def _reflectance(data: xr.Dataset, around: list[xr.Dataset]) -> xr.DataArray:
    """The variable `reflectance` over y, x and bands."""
    if "reflectance" not in data:
        raise InputError(
            f"expected a variable 'reflectance', but it has {listed(map(str, data)) or 'none'}"
        )
    values = data["reflectance"]
    said = str(values.attrs.get("long_name"))
    _check_no_radiance(said, units=[values.attrs.get("units")])
    for axis in [d for d in values.dims if d in ("time", "t") and values.ndim > 3]:
        if values.sizes[axis] != 1:
            raise InputError(
                f"expected one image, but it has {values.sizes[axis]} along {axis!r}. Take one: "
                f"image.isel({axis}=0).to_netcdf('one.nc')"
            )
        values = values.isel({axis: 0})
    if values.ndim != 3 or values.dtype.kind not in "fiu" or not values.size:
        raise InputError(
            "expected reflectance as numbers of three dimensions, but it has "
            f"{dict(values.sizes)} of {values.dtype}"
        )
    return values.transpose(*ordered_axes(values, [data, *around]))


def _column(
    names: Sequence[str], sources: Sequence[xr.Dataset], count: int
) -> tuple[Float[np.ndarray, " band"] | None, str]:
    """The first variable of these names that has one number a band, and its unit."""
    for source in sources:
        for name in names:
            if name in source.variables and source[name].size == count:
                found = source[name]
                unit = str(found.attrs.get("units", ""))
                return np.asarray(found.values, float).reshape(count), unit
    return None, ""


@refusing(*_UNREADABLE, words="cannot be read as an image ({error})")
@np.errstate(all="ignore")  # a scale may lead beyond what a float holds
def _cube_of(path: Path, opened: ExitStack) -> CubeBlocks:
    if not path.exists():
        raise InputError("expected an image, but there is no such file")
    zarr = path.suffix.lower() == ".zarr"
    if not zarr:
        check_netcdf(path)
    kind: dict[str, Any] = {}
    if zarr:
        require("zarr", "map")
        kind = {"engine": "zarr", "consolidated": False, "drop_variables": check_zarr(path)}
    tree = None if zarr else read_tree(path)
    data = _with_bands(opened.enter_context(xr.open_dataset(path, **kind)))
    around: list[xr.Dataset] = []
    if tree is not None:
        data, around = with_groups(path, tree, data, opened)
    values = _reflectance(data, around)
    has_location = tree is not None and "/location" in tree.groups
    location = _location(path, data, opened) if has_location else None
    count, spectral = values.shape[2], values.dims[2]
    named = spectral in values.coords and values.coords[spectral].dtype.kind in "OSUT"
    row = 4.0 * values.shape[1] * count
    check_fits(2.0 * row, f"{values.shape[1]} pixels of a row in {count} bands", "Is it damaged?")
    sources = (data, *around)
    named_so = [str(n) for s in sources for n in s.variables if WAVELENGTHS.fullmatch(str(n))]
    wavelength, unit = _column(named_so, sources, count)
    width, _ = _column(("fwhm", "FWHM"), (data, *around), count)
    good, _ = _column(("good_wavelengths", "reflectance_good"), (data, *around), count)
    if wavelength is not None:  # some files state by -1 or -9999 that a band has none
        wavelength = np.where(np.isfinite(wavelength) & (wavelength < 0.0), np.nan, wavelength)
    if wavelength is not None and not np.isnan(wavelength).all():
        wavelength, factor = in_nanometres(wavelength, unit)
        width = None if width is None else width * factor
    if width is not None:
        check_widths(width)
    # zarr decodes them one by one, those too that are not there.
    long = values.encoding.get("preferred_chunks", {}) if zarr else {}
    pieces = math.prod(-(-values.sizes[d] // long.get(d, 1)) for d in values.dims[1:] if long)
    if pieces > _MOST_CHUNKS:
        raise InputError(
            f"expected at most {_MOST_CHUNKS} chunks in a row of pixels, but there are {pieces}. "
            "Write larger chunks"
        )
    crs, transform = _place(data, values)
    # In memory y rises to the north; a block is as in a file, its first row northernmost. A swath
    # stays as it is: its lookup table counts rows as they are in the file.
    for axis, way in zip(values.dims[:2], (-1.0, 1.0), strict=True):
        there = location is None and axis in values.coords and values.sizes[axis] > 1
        if there and way * float(values[axis][-1] - values[axis][0]) < 0.0:
            values = values.isel({axis: slice(None, None, -1)})
    return CubeBlocks(
        path=path,
        shape=(values.shape[0], values.shape[1]),
        wavelength=np.full(count, np.nan) if wavelength is None else wavelength,
        fwhm=np.full(count, np.nan) if width is None else width,
        good=np.ones(count, bool) if good is None else good != 0,
        transform=transform,
        crs=crs,
        source=values,
        location=location,
        names=tuple(map(str, values.coords[spectral].values)) if named else ("",) * count,
        valid=_valid_range(values),
    )


def _valid_range(values: xr.DataArray) -> tuple[float, float]:
    """Least and largest value by CF's attributes, which are of the stored numbers, unless these
    are whole and the attributes are not."""
    of = values.attrs
    both = np.asarray(of.get("valid_range", (of.get("valid_min"), of.get("valid_max"))), object)
    stored = np.dtype(values.encoding.get("dtype", values.dtype)).kind
    whole = all(one is None or np.asarray(one).dtype.kind in "iu" for one in both)
    scaled = stored == "f" or whole
    scale = float(values.encoding.get("scale_factor", 1.0)) if scaled else 1.0
    offset = float(values.encoding.get("add_offset", 0.0)) if scaled else 0.0
    low, high = (
        bound if one is None else float(one) * scale + offset
        for one, bound in zip(both, (-math.inf, math.inf), strict=True)
    )
    slack = 1e-6 * max((abs(one) for one in (low, high) if math.isfinite(one)), default=0.0)
    return min(low, high) - slack, max(low, high) + slack


def _location(path: Path, data: xr.Dataset, opened: ExitStack) -> xr.Dataset | None:
    """The group that holds a swath's lookup table, with the attributes of the file."""
    group = opened.enter_context(xr.open_dataset(path, group="location", decode_times=False))
    return group.assign_attrs(data.attrs) if "glt_x" in group or "glt_y" in group else None


def _place(data: xr.Dataset, values: xr.DataArray) -> tuple[str | None, Affine]:
    mapping = values.encoding.get("grid_mapping", values.attrs.get("grid_mapping", "crs"))
    mapping = mapping.partition(":")[0].strip()
    mapping = mapping if mapping in data.variables else "spatial_ref"
    about = data[mapping].attrs if mapping in data.variables else {}
    y, x = values.dims[:2]
    placed = x in values.coords and y in values.coords
    wkt = _stated_crs(about)
    if wkt is None and placed and _in_degrees(values[x], values[y]):
        wkt = parse_crs(4326).to_wkt()
    if wkt is None:
        if placed and min(np.abs(values[axis]).max() for axis in (x, y)) > _FAR:
            warnings.warn(
                f"{values.encoding.get('source', 'the image')}: {x} and {y} are coordinates of a "
                "map, but no reference system is stated, so that the image has no place. State it: "
                "a variable crs with an attribute crs_wkt, named as grid_mapping of reflectance",
                stacklevel=2,
            )
        return wkt, Affine.identity()
    stated = geotransform(about.get("GeoTransform"), "GeoTransform")
    if not placed or stated.b != 0.0 or stated.d != 0.0:
        return wkt, stated
    crs = CRS.from_wkt(wkt)
    xs, ys = (_in_units_of(crs, values[axis]) for axis in (x, y))
    check_in_area(crs, float(xs.mean()), float(ys.mean()))
    steps = [_step(xs, str(x)), _step(ys, str(y))]
    own = values.attrs.get("pixel_m")
    width, height = (own or step or other or 1.0 for step, other in (steps, steps[::-1]))
    return wkt, Affine(width, 0.0, xs.min() - width / 2, 0.0, -height, ys.max() + height / 2)


_FAR = 1e5
"""Coordinates beyond are those of a map, and no plot's own [m]."""


def _stated_crs(about: Mapping[str, Any]) -> str | None:
    """The reference system of a grid mapping as WKT: by its text, its code, or CF's parameters."""
    for key in ("crs_wkt", "spatial_ref", "epsg_code", "epsg", "EPSG"):
        if key in about and str(about[key]).strip():
            text = str(about[key]).strip()
            return parse_crs(f"EPSG:{text}" if text.isdigit() else text).to_wkt()
    if "grid_mapping_name" not in about:
        return None
    words = "expected a grid mapping as CF states it, but it cannot be read ({error})"
    with refusing(pyproj.exceptions.CRSError, KeyError, TypeError, ValueError, words=words):
        system = pyproj.CRS.from_cf(dict(about))
        return parse_crs(system.to_wkt("WKT2_2019")).to_wkt()


def _in_degrees(x: xr.DataArray, y: xr.DataArray) -> bool:
    """Whether coordinates are longitude and latitude by their names or units."""
    return all(
        str(axis.name).lower() in (word, word[:3])
        or axis.attrs.get("standard_name") == word
        or str(axis.attrs.get("units", "")).lower().startswith(f"degrees_{way}")
        for axis, word, way in ((x, "longitude", "east"), (y, "latitude", "north"))
    )


def _in_units_of(crs: CRS, places: xr.DataArray) -> np.ndarray:
    """Coordinates in the unit of their system: those in kilometres are converted."""
    unit = str(places.attrs.get("units", "")).strip().lower()
    thousand = unit in ("km", "kms") or unit.startswith(("kilomet", "1000 m"))
    factor = 1000.0 / crs.units_factor[1] if thousand and crs.is_projected else 1.0
    return np.asarray(places, float) * factor


def _step(places: np.ndarray, name: str) -> float | None:
    """Distance of the middles of pixels that follow each other; None of one pixel.

    **Raises:** `InputError` for steps that differ.
    """
    if len(places) < 2:
        return None
    steps = np.diff(places)
    step = float(places[-1] - places[0]) / (len(places) - 1)
    # Coordinates may be stored in 32 bits.
    slack = 1e-2 * abs(step) + 4.0 * float(np.spacing(np.float32(np.abs(places).max())))
    if step == 0.0 or not np.abs(steps - step).max() <= slack:
        raise InputError(
            f"expected pixels of one size, but {name!r} has steps from {steps.min():g} to "
            f"{steps.max():g}. Warp the image onto a regular grid first"
        )
    return abs(step)


def grid_coordinates(
    transform: Affine, crs: str | None, shape: tuple[int, int], rows: int
) -> tuple[tuple[str, str], dict[str, Any]]:
    """Dimensions of a grid, and its coordinates `y` and `x` of the middles of pixels with their CF
    attributes. A grid that is turned has two numbers a pixel, over row and column: dask makes them
    by blocks of `rows` when they are asked for.

    **Arguments:**

    - `transform`: from column and row to x and y.
    - `crs`: reference system, None without one.
    - `shape`: rows and columns.
    - `rows`: of a block.
    """
    if transform.is_identity:
        axes = {"y": ("", "1"), "x": ("", "1")}
    elif crs and CRS.from_user_input(crs).is_geographic:
        axes = {"y": ("latitude", "degrees_north"), "x": ("longitude", "degrees_east")}
    else:
        axes = {a: (f"projection_{a}_coordinate", "m") for a in "yx"}
    row, column = (np.arange(count) + 0.5 for count in shape)
    y, x = transform.e * row + transform.f, transform.a * column + transform.c
    turned = transform.b != 0.0 or transform.d != 0.0
    if turned:
        array: Any = require("dask.array", "map", "dask")
        y = transform.d * column[None, :] + array.from_array(y[:, None], chunks=rows)
        x = x[None, :] + transform.b * array.from_array(row[:, None], chunks=rows)
    dims = ("row", "column") if turned else ("y", "x")
    coordinates = {}
    for axis, values in (("y", y), ("x", x)):
        standard, unit = axes[axis]
        named = {"standard_name": standard} if standard else {}
        attributes = {"units": unit, "long_name": f"{axis} of the middles of pixels", **named}
        coordinates[axis] = (dims if turned else axis, values, attributes)
    return dims, coordinates


_refusing_full_disks = refusing(
    RasterioError,
    OSError,
    words="cannot write the maps ({error}). Is the disk full? If not, the same command goes on "
    "from what was kept before",
)


class MapWriter:
    """Maps of one raster that are written block by block, in any order, and kept as they come.
    `finish` makes a cloud-optimised GeoTIFF of them.

    Maps of a swath are on the swath while they are made. `finish` and `finish_zarr` place them: on
    the grid of the file's lookup table each pixel is that of the swath which the table names.
    """

    def __init__(
        self,
        folder: Path,
        signature: str,
        bands: Sequence[tuple[str, str]],
        like: CubeBlocks,
        blocks: int,
    ) -> None:
        """Begin in `folder`, or go on with what an interrupted run of the same `signature` left.

        `bands` have names and units. Raises `InputError` for a folder of another run, and for a
        lookup table of a swath that places nothing.
        """
        self._folder, self._bands, self._like = folder, tuple(bands), like
        self._on_map = folder / "placed.tif"
        at = like.location
        with in_file(like.path):
            self._table = None if at is None else lookup_table(at, like.shape)
        self._journal = Journal(folder, signature)
        self.damaged: set[int] = set()
        """Blocks of the cube that could not be read, of an interrupted run too."""
        self.done = np.zeros(blocks, bool)
        """Blocks that are there, as they were written."""
        for block in range(blocks):
            with suppress(InputError):  # one that is damaged is to be done again
                if (kept := self._journal.kept(block)) is not None:
                    self._note(block, bool(kept[1]))

    def _note(self, block: int, damaged: bool) -> None:
        self.done[block] = True
        self.damaged |= {block} if damaged else set()

    def write(
        self,
        block: int,
        start: int,
        values: Float[np.ndarray, "band row column"],
        *,
        damaged: bool = False,
    ) -> None:
        """Write a block whose first row is `start`; `damaged` where the cube has no data there
        because it could not be read."""
        numbers = np.asarray(start), np.asarray(damaged)
        self._journal.put(block, [*numbers, values.astype(np.float32)])
        self._note(block, damaged)

    def _begin(
        self, path: Path, shape: tuple[int, int], transform: Affine, crs: str | None
    ) -> None:
        """A GeoTIFF of all maps, yet without data."""
        profile = grid_profile(len(self._bands), shape, transform, crs, float("nan"))
        profile |= {"driver": "GTiff", "interleave": "band", "bigtiff": "if_safer"}
        with wherever(), rasterio.open(path, "w", **profile):
            pass

    @cached_property
    @_refusing_full_disks
    def _file(self) -> Path:
        """All blocks that are there as one GeoTIFF; of a swath on the swath."""
        path, like = self._folder / "maps.tif", self._like
        self._begin(path, like.shape, like.transform, like.crs)
        with wherever(), rasterio.open(path, "r+") as file:
            for block in np.flatnonzero(self.done):
                kept = self._journal.kept(int(block))
                if kept is None:
                    words = "the checkpoint was removed meanwhile: the same command begins anew"
                    raise InputError(words, file=self._folder)
                start, _, values = kept
                file.write(values, window=Window(0, int(start), *values.shape[:0:-1]))
        return path

    @cached_property
    @_refusing_full_disks
    def _placed(self) -> Path:
        """The maps in their place: of a swath another file than that in the making."""
        if self._table is None:
            return self._file
        self._begin(self._on_map, self._table.shape, self._table.transform, self._table.crs)
        with (
            wherever(),
            rasterio.open(self._file, driver="GTiff") as swath,
            rasterio.open(self._on_map, "r+") as onto,
        ):
            self._table.place(swath, onto)
        return self._on_map

    @_refusing_full_disks
    def finish(self, path: Path, tags: Mapping[str, str | int]) -> None:
        """Write all of it as a cloud-optimised GeoTIFF, whole or not at all. Raises `InputError`
        where the lookup table of a swath cannot be read."""
        placed = self._placed
        with wherever():
            with rasterio.open(placed, "r+") as file:
                file.descriptions = tuple(name for name, _ in self._bands)
                file.units = tuple(unit for _, unit in self._bands)
                file.update_tags(**{k: str(v) for k, v in tags.items()})
            with atomic_path(path) as partial:
                rasterio.shutil.copy(
                    placed, partial, driver="COG", compress="deflate", predictor="3",
                    blocksize=_INNER, overview_resampling="average", bigtiff="if_safer",
                )  # fmt: skip

    def finish_zarr(
        self, path: Path, tags: Mapping[str, str | int], names: Mapping[str, str]
    ) -> None:
        """Write all of it as a zarr group of one array a map, whole or not at all. `names` are the
        long names of the maps. Raises `MissingExtraError` without zarr, dask or rioxarray, and as
        `finish`."""
        require("zarr", "map")
        require("dask", "map")
        rioxarray: Any = require("rioxarray", "map")
        grid: Any = self._like if self._table is None else self._table
        blocks = {"band": 1, "y": _INNER, "x": _INNER}
        with (
            wherever(),
            rioxarray.open_rasterio(self._placed, chunks=blocks, parse_coordinates=False) as maps,
        ):
            shape = maps.shape[1:]
            dims, coordinates = grid_coordinates(grid.transform, grid.crs, shape, _INNER)
            reference = {"crs_wkt": grid.crs or LOCAL_FRAME}
            if dims == ("row", "column"):
                reference["GeoTransform"] = " ".join(map(repr, grid.transform.to_gdal()))
            data = xr.Dataset(coords=coordinates, attrs={"Conventions": CONVENTIONS})
            data = data.assign_attrs(with_history(tags))
            data["crs"] = (), np.int32(0), {"long_name": "coordinate reference system", **reference}
            for values, (name, unit) in zip(maps.data, self._bands, strict=True):
                described = {"units": unit, "long_name": names[name], "grid_mapping": "crs"}
                data[name] = dims, values, described
            chunks = tuple(min(_INNER, count) for count in shape)
            encoding: dict[Any, Any] = {axis: {"_FillValue": None} for axis in ("y", "x")}
            encoding |= {name: {"chunks": chunks} for name, _ in self._bands}
            partial = path.with_name(f"{path.name}.partial")
            shutil.rmtree(partial, ignore_errors=True)
            data.to_zarr(partial, mode="w", consolidated=False, encoding=encoding)
        shutil.rmtree(path, ignore_errors=True)
        os.replace(partial, path)

    def read(self, step: int = 1) -> Float[np.ndarray, "band row column"]:
        """All bands, every `step`-th row and column; of a swath on the swath."""
        with wherever(), rasterio.open(self._file, driver="GTiff") as file:
            size = (math.ceil(file.height / step), math.ceil(file.width / step))
            return np.asarray(file.read(out_shape=(file.count, *size)))

    def forget(self) -> None:
        """Remove what was in the making."""
        for path in (self._folder / "maps.tif", self._on_map):
            path.unlink(missing_ok=True)
            path.with_suffix(".tif.aux.xml").unlink(missing_ok=True)
        forget_journal(self._folder)

"""The one reader of rasters: every GeoTIFF, ENVI cube and map is opened and checked here.

On disk row 0 is mostly the northern edge; in memory y increases to the north, as everywhere in
fynjax. The flip happens here and nowhere else.
"""

import math
import os
import re
import sys
import warnings
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import rasterio
from jaxtyping import Bool, Float
from numpy.typing import DTypeLike, NDArray
from rasterio import Affine
from rasterio._err import CPLE_BaseError  # it has no public name
from rasterio.crs import CRS
from rasterio.enums import ColorInterp
from rasterio.errors import CRSError, NotGeoreferencedWarning, RasterioError
from rasterio.windows import Window

from fynjax._core.errors import LARGEST, InputError, in_file, refusing
from fynjax._core.files import check_stated_size, existing_file, how_to_import, is_elsewhere
from fynjax._core.progress import track
from fynjax.app.io.raster._crs import check_lengths, check_metric, is_local, stretch, utm_zone
from fynjax.app.io.spectra import check_widths, good_bands, header_numbers, in_nanometres, open_envi
from fynjax.app.io.text import check_fits, stated_number

METRES = ("", "m", "metre", "metres", "meter", "meters")
"""What a raster may call the unit of its heights."""
ENVI_DATA = (".dat", ".img", ".bil", ".bsq", ".bip")
_RDF = "{http://www.w3.org/1999/02/22-rdf-syntax-ns#}"
_DJI = "{http://www.dji.com/drone-dji/"
_OF_LIGHT_SENSOR = re.compile(r"\{\S*/DLS/\S*\}(Yaw|Pitch|Roll)")
"""Angles of MicaSense's light sensor [radians], which have the names of a camera's."""
_RAW = {"RadiometricCalibration", "DarkRowValue", "BlackLevel", "BlackCurrent", "SensorGain"}
"""Metadata (XMP) that raw captures of MicaSense and DJI have."""
RAW_COUNTS = (
    "expected reflectance, or a mosaic, but this is a camera's raw capture, whose counts depend on "
    "gain and exposure of each band. Make reflectance first: fynjax reflectance"
)
"""Error of a raw capture where an image is asked for."""
_MOST_BANDS = 4096
_SMALLEST = 5e-4
"""Side of the smallest pixel that a raster has [m]: 30 m of the ground are 2.8e-4 degrees."""
_IN_NAME = re.compile(r"(?<!\d)([3-9]\d\d|10\d\d)(\.\d+)?(?!\d)")
"""Wavelength [nm] in the name of a band of a camera."""
_WITH_UNIT = re.compile(
    r"(\d+(?:\.\d+)?)\s*(nm|nanomet(?:er|re)s?|[uµμ]m|micro(?:n|met(?:er|re))s?)\b", re.IGNORECASE
)
"""Wavelength and its unit in the name of a band."""
_BLOCK = 1 << 24
"""Values read at once, where a raster is read by blocks of rows."""


@dataclass(frozen=True)
class Raster:
    """Bands of a raster, or of a part of it."""

    values: Float[np.ndarray, "band y x"]
    """Values in the file's unit, its scale and offset applied; y to the north; NaN without data."""
    mask: Bool[np.ndarray, "y x"]
    """True where every band has data."""
    full: Bool[np.ndarray, "y x"]
    """True where a band has the largest value of its integer type."""
    transform: Affine
    """Affine map from column and row, counted from the north-west corner, to x and y in the file's
    system."""

    @property
    def origin(self) -> tuple[float, float]:
        """South-west corner (x, y)."""
        x, y = self.transform @ (0.0, float(self.values.shape[1]))
        return float(x), float(y)


@dataclass(frozen=True)
class RasterFile:
    """An open raster: what it states of itself. Bands are counted from 1."""

    path: Path
    what: str
    """Role of the file, for errors, such as "a probability map"."""
    dataset: Any
    """The open dataset of rasterio."""
    header: dict[str, Any]
    """Fields of the ENVI header; empty for other formats."""
    header_path: Path
    """The ENVI header; the raster itself for other formats."""

    shape: tuple[int, int]
    """Rows and columns of pixels."""
    bands: tuple[int, ...]
    """Numbers of the bands, without one that says where there are data (alpha)."""
    names: tuple[str, ...]
    """Description of each band; empty where it has none."""
    units: tuple[str, ...]
    """Unit of each band; empty where it has none."""
    tags: dict[str, str]
    """Statements of the file about its image as a whole."""
    crs: CRS | None
    """Coordinate reference system, if it states one."""

    @cached_property
    def _bands_nm(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Centre and full width at half maximum of each band [nm]; NaN where not stated."""
        count = self.dataset.count
        if self.header:
            with in_file(self.header_path):
                stated = header_numbers(self.header, "wavelength", count)
                stated[stated < 0.0] = np.nan  # as headers state that a band has none
                width = header_numbers(self.header, "fwhm", count)
            unit = str(self.header.get("wavelength units", ""))
        else:
            tags = [
                {k.lower(): v for k, v in self.dataset.tags(n).items()} for n in range(1, count + 1)
            ]
            stated, width = (
                np.array([_positive(of.get(key)) for of in tags]) for key in ("wavelength", "fwhm")
            )
            unit = next((of["wavelength_units"] for of in tags if "wavelength_units" in of), "")
            if np.isnan(stated).all():  # as GDAL's own drivers have them
                imagery = [self.dataset.tags(n, ns="IMAGERY") for n in range(1, count + 1)]
                stated, width = (
                    np.array([_positive(of.get(key)) for of in imagery])
                    for key in ("CENTRAL_WAVELENGTH_UM", "FWHM_UM")
                )
                unit = "um"
            if np.isnan(stated).all():
                stated, unit = self._in_texts()
        if np.isnan(stated).all():
            return stated, np.full(count, np.nan)
        with in_file(self.header_path):
            centre, factor = in_nanometres(stated, unit)
            check_widths(width * factor)
        return centre, width * factor

    def _in_texts(self) -> tuple[NDArray[np.float64], str]:
        """Wavelength of each band by a list among the file's tags, by tags such as "Band_1", or by
        the names of the bands, and the unit; NaN where none of them has one for every band."""
        count, tags = self.dataset.count, {key.lower(): text for key, text in self.tags.items()}
        for key in ("wavelength", "wavelengths"):
            parts = re.split(r"[\s,;]+", tags.get(key, "").strip("{}[]() \n"))
            listed = np.array([_positive(part) for part in parts])
            if len(parts) == count and np.isfinite(listed).all():
                return listed, tags.get("wavelength_units", tags.get("wavelength units", ""))
        of_bands = [tags.get(f"band_{n}", "") for n in range(1, count + 1)]
        for texts in (self.names, of_bands):
            found = [_WITH_UNIT.findall(text) for text in texts]
            units = {one[0][1][0].lower() == "n" for one in found if len(one) == 1}
            if all(len(found[n - 1]) == 1 for n in self.bands) and len(units) == 1:
                stated = np.array([float(one[0][0]) if one else np.nan for one in found])
                return stated, "nm" if units == {True} else "um"
        plain = [_positive(name) for name in self.names]
        if len(self.bands) > 1 and all(350.0 <= plain[n - 1] <= 2600.0 for n in self.bands):
            return np.array(plain), "nm"
        found = [_IN_NAME.findall(name) for name in self.names]
        if all(len(found[n - 1]) == 1 for n in self.bands):
            stated = np.array([float("".join(one[0])) if one else np.nan for one in found])
            return stated, "nm"
        return np.full(count, np.nan), "nm"

    @property
    def wavelengths(self) -> Float[np.ndarray, " band"]:
        """Centre of each band [nm]; NaN where not stated. `InputError` for another unit."""
        return self._bands_nm[0]

    @property
    def fwhm(self) -> Float[np.ndarray, " band"]:
        """Full width at half maximum of each band [nm]; NaN where not stated."""
        return self._bands_nm[1]

    @cached_property
    def good(self) -> Bool[np.ndarray, " band"]:
        """Bands that are to be used by the header's list of bad bands."""
        with in_file(self.header_path):
            return good_bands(self.header, self.dataset.count)

    @cached_property
    def xmp(self) -> dict[str, list[str]]:
        """Metadata (XMP) that a camera wrote into its picture: texts by name without namespace; of
        two with one name DJI's own, or else the first."""
        text = self.dataset.tags(ns="xml:XMP").get("xml:XMP", "").strip().strip("\0")
        if not text:
            return {}
        if "<!DOCTYPE" in text or "<!ENTITY" in text:
            raise InputError("the metadata (XMP) must not define entities, but do")
        with refusing(ElementTree.ParseError, words="the metadata (XMP) cannot be read: {error}"):
            root = ElementTree.fromstring(text)
        found: list[tuple[str, list[str]]] = []
        for description in root.iter(f"{_RDF}Description"):
            found += [(name, [value.strip()]) for name, value in description.attrib.items()]
            for child in description:
                items = [item.text or "" for item in child.iter(f"{_RDF}li")] or [child.text or ""]
                found.append((child.tag, [item.strip() for item in items]))
        found = [item for item in found if not _OF_LIGHT_SENSOR.fullmatch(item[0])]
        found.sort(key=lambda item: not item[0].startswith(_DJI))
        stated: dict[str, list[str]] = {}
        for name, texts in found:
            stated.setdefault(name.rpartition("}")[2], texts)
        return stated

    @property
    def is_raw_capture(self) -> bool:
        """Whether it is a camera's own picture of one band, in counts, and no product of it."""
        return not self.has_place and len(self.bands) == 1 and not _RAW.isdisjoint(self.xmp)

    # -- place ------------------------------------------------------------------------------

    @property
    def has_place(self) -> bool:
        """Whether it has a coordinate reference system and a place in it."""
        return self.crs is not None and not self.dataset.transform.is_identity

    @property
    def on_earth(self) -> bool:
        """Whether its place is one on Earth, not in a frame of a plot's own."""
        return self.crs is not None and self.has_place and not is_local(self.crs)

    @property
    def cell_m(self) -> float | None:
        """Side of a cell [m]; `None` without a place, or where it is in degrees.

        **Raises:** `InputError` for a raster that is rotated, and cells that are not square.
        """
        t = self.dataset.transform
        if t.is_identity:
            return None
        self._check_upright(may_be_flipped=True)
        if self.crs is not None and self.crs.is_geographic:
            return None
        width, height = abs(t.a), abs(t.e)
        self._check_no_degrees(width)
        if abs(height - width) > 1e-3 * width:
            raise InputError(
                f"expected square cells, but they are {width:g} by {height:g}. Warp with -tr first."
            )
        return float(width)

    @property
    def pixel_m(self) -> float | None:
        """Side of a square as large as a pixel, on the ground [m]; `None` without a place.

        A system in feet, or in another unit of length, is converted, and so is one that stretches
        lengths by more than 1 %, as maps for the web do. A rotated image is as good as one with
        north up.

        **Raises:** `InputError` for an image in degrees.
        """
        t = self.dataset.transform
        if t.is_identity:
            return None
        scale = 1.0
        if self.crs is not None:
            middle = t @ (0.5 * self.shape[1], 0.5 * self.shape[0])
            if self.crs.is_geographic:
                raise InputError(
                    f"expected {self.what} with pixels in metres, but its coordinates are in "
                    "degrees, in which a pixel is not square. Warp it first: gdalwarp -t_srs "
                    f"{utm_zone(*middle)} -r bilinear {self.path.name} metres.tif"
                )
            scale = float(self.crs.units_factor[1]) / stretch(self.crs, *middle)[0]
        side = math.sqrt(abs(t.determinant)) * scale
        self._check_no_degrees(side)
        return side

    def _check_no_degrees(self, side: float) -> None:
        if side < _SMALLEST:
            raise InputError(
                f"expected {self.what} with pixels in metres, but they are {side:.3g} wide: are "
                "they in degrees? State it, and warp: gdalwarp -s_srs EPSG:4326 -t_srs EPSG:... "
                f"-r bilinear {self.path.name} metres.tif"
            )

    def check_place(self, *, crs: CRS | None = None, height_stated: bool = True) -> CRS:
        """Reference system of a raster that has a place, in metres, and is north up.

        **Arguments:** `crs`, that which the user states, if any; `height_stated`: the unit of
        heights is stated elsewhere, or there are none.

        **Raises:** `InputError` without a system or a place, in degrees or feet, and for a raster
        that is rotated or upside down.
        """
        system = self.crs if crs is None else crs
        if system is None or self.dataset.transform.is_identity:
            raise InputError(
                "expected a raster with a coordinate reference system and a place, but it has "
                f"{'no system' if system is None else 'no place'}. Give it one: "
                f"gdal_edit.py -a_srs EPSG:... -a_ullr WEST NORTH EAST SOUTH {self.path.name}"
            )
        check_metric(system, height_stated=height_stated)
        self._check_no_degrees(abs(self.dataset.transform.a))
        rows, columns = self.shape
        middle = self.dataset.transform @ (0.5 * columns, 0.5 * rows)
        name = self.path.name.replace("{", "{{").replace("}", "}}")
        check_lengths(
            system,
            middle[0],
            middle[1],
            f"Warp it first: gdalwarp -t_srs {{zone}} {name} metres.tif",
        )
        self._check_upright()
        return system

    def _check_upright(self, *, may_be_flipped: bool = False) -> None:
        t = self.dataset.transform
        rotated = max(abs(t.b), abs(t.d)) > 1e-9 * abs(t.a)
        if rotated or (not may_be_flipped and (t.a < 0 or t.e > 0)):
            raise InputError(
                f"expected {self.what} with north up, but this one is "
                f"{'rotated' if rotated else 'upside down'}. Warp it first: "
                f"gdalwarp {self.path.name} north_up.tif"
            )

    # -- values -----------------------------------------------------------------------------

    def _scaling(self, bands: Sequence[int], dtype: np.dtype) -> tuple[np.ndarray, np.ndarray]:
        """Factor and offset that make values of the stored numbers, by band."""
        with np.errstate(over="ignore"):  # what becomes infinite is warned of in `read`
            scale, offset = (
                np.array([of[n - 1] for n in bands], dtype)[:, None, None]
                for of in (self.dataset.scales, self.dataset.offsets)
            )
        if (scale == 0.0).any():
            raise InputError(
                "expected a scale of its values that is not 0, but a band has 0: nothing would be "
                "left of them. Is the file damaged? Else state it: gdal_edit.py -scale 1 "
                f"{self.path.name}"
            )
        if not (scale != 1.0).any():  # GDAL applies that of a header in its newer versions
            scale = scale / np.asarray(self._divisor(), dtype)
        return scale, offset

    def read(
        self,
        bands: Sequence[int] | None = None,
        *,
        window: Window | None = None,
        step: int = 1,
        zero_is_data: bool = True,
        dtype: DTypeLike = np.float64,
    ) -> Raster:
        """Read bands, all of them unless given, by blocks of rows.

        **Arguments:**

        - `window`: rows and columns to read.
        - `step`: every `step`-th row and column is read, from the north-west corner.
        - `zero_is_data`: false for images. Mosaics fill their border with zeros and rarely declare
          it; no ground reflects nothing. A pixel that is 0 in every band has then no data.
        - `dtype`: of the values.

        **Raises:** `InputError` for values that are no real numbers or have a scale of 0, and for
        more of them than this machine has memory for.
        """
        file = self.dataset
        bands = list(file.indexes if bands is None else bands)
        window = Window(0, 0, *self.shape[::-1]) if window is None else window
        left, top, width, height = window.flatten()
        shape = (len(bands), -(-height // step), -(-width // step))
        self._check_size(shape, np.dtype(dtype).itemsize, len(bands) * height * width)
        kinds = [np.dtype(file.dtypes[n - 1]) for n in bands]
        if any(kind.kind not in "iuf" for kind in kinds):
            raise InputError(f"expected numbers, but it has {kinds[0]}")
        scale, offset = self._scaling(bands, np.dtype(dtype))
        values = np.empty(shape, dtype)
        valid = np.empty(shape, bool)
        full = np.zeros(shape[1:], bool)
        block = max(_BLOCK // max(len(bands) * width, 1) // step, 1) * step
        for start in track(range(0, height, block), f"Read {self.path.name}"):
            part = Window(left, top + start, width, min(block, height - start))
            raw = file.read(bands, window=part)[:, ::step, ::step]
            data = file.read_masks(bands, window=part)[:, ::step, ::step] > 0
            # Zeros in all bands of an image, and what the file masks, are no data.
            rows = slice(start // step, start // step + raw.shape[1])
            with np.errstate(all="ignore"):  # what is no number is warned of below
                values[:, rows] = raw
            if not zero_is_data:
                data &= ~(raw == 0).all(axis=0)
            valid[:, rows] = data
            if raw.dtype.kind in "iu":
                full[rows] = (raw == np.iinfo(raw.dtype).max).any(axis=0)
        if (scale != 1.0).any() or (offset != 0.0).any():
            with np.errstate(all="ignore"):
                values *= scale
                values += offset
        with np.errstate(invalid="ignore"):
            wrong = valid & (np.abs(values) > LARGEST)
        if wrong.any():
            warnings.warn(
                f"{self.path}: {int(wrong.sum())} of {wrong.size} values are infinite or beyond "
                f"{LARGEST:g}, such as {values[wrong][0]:g}. They are taken for missing data.",
                stacklevel=2,
            )
        valid &= np.isfinite(values) & ~wrong
        values[~valid] = np.nan
        # In memory y rises to the north.
        t = file.transform
        if t.is_identity or t.e < 0:
            values, valid, full = values[:, ::-1], valid[:, ::-1], full[::-1]
            place = t @ Affine.translation(left, top) @ Affine.scale(step)
        else:  # row 0 is the southern edge
            place = t @ Affine.translation(left, top + height) @ Affine.scale(step, -step)
        return Raster(values, np.asarray(valid.all(axis=0)), full, place)

    def stored_band(self, number: int) -> NDArray[Any]:
        """The numbers of a band as they stand in the file [row, column], row 0 at the top.

        **Raises:** `InputError` as `read`.
        """
        kind = np.dtype(self.dataset.dtypes[number - 1])
        self._check_size((1, *self.shape), kind.itemsize, math.prod(self.shape))
        return np.asarray(self.dataset.read(number))

    def _divisor(self) -> float:
        """Divisor of the values that the ENVI header states; 1 without one."""
        try:
            divisor = stated_number(self.header.get("reflectance scale factor", 1.0))
        except (TypeError, ValueError):
            divisor = math.nan
        if not (math.isfinite(divisor) and divisor > 0.0):
            raise InputError(
                "expected a positive number as reflectance scale factor, but got "
                f"{self.header['reflectance scale factor']!r}",
                file=self.header_path,
            )
        return divisor

    def _check_size(self, shape: tuple[int, ...], itemsize: int, stored: int) -> None:
        """Refuse a raster that memory cannot hold, or that its file cannot hold."""
        rows, columns = self.shape
        stored *= np.dtype(self.dataset.dtypes[0]).itemsize
        what = f"{columns} x {rows} pixels in {self.dataset.count} bands"
        check_stated_size(self.path, stored, what, packed=True)
        check_fits(
            2.0 * math.prod(shape) * itemsize,
            f"{columns} x {rows} pixels in {shape[0]} bands",
            f"Cut a part: gdalwarp -te WEST SOUTH EAST NORTH {self.path.name} part.tif",
        )


_FORMATS = ("GTiff", "ENVI", "HFA", "AAIGrid", "SRTMHGT", "EHdr", "PNG", "JPEG")
"""Drivers of GDAL that read the file they are given, and open no other place that it names."""
_WHOLE = (b"II*\0", b"II+\0", b"MM\0*", b"MM\0+", b"EHFA_HEADER_TAG\0")
"""First bytes of files of TIFF and ERDAS, which hold their values themselves."""


def _names_others(path: Path, name: str) -> InputError:
    return InputError(
        f"expected a raster that holds its own values, but {name} names other files, as a virtual "
        "raster (VRT) does, and those are not followed. If you trust it, make it a "
        f"GeoTIFF: gdal_translate {path.name} {path.stem}_own.tif"
    )


def _check_beside(path: Path) -> None:
    """Refuse a raster beside which lies an overview or a mask that has values of other files: GDAL
    opens those by whatever driver, and who made them would choose what of this machine, or of a
    network, is read."""
    own = tuple(f"{name}.".lower() for name in (path.name, path.stem))
    for name in os.listdir(path.parent):
        beside = path.with_name(name)
        known = name.lower().startswith(own) and name.lower().endswith((".ovr", ".msk"))
        if known or name.lower() in [f"{one}{kind}" for one in own for kind in ("aux", "rrd")]:
            if not beside.is_file() or is_elsewhere(path, beside):
                raise _names_others(path, name)
            with beside.open("rb") as file:
                if not file.read(16).startswith(_WHOLE):
                    raise _names_others(path, name)
            _open(beside).close()


def _open(path: Path) -> Any:
    """A raster as rasterio has it, if it names no others."""
    # The environment registers GDAL's drivers; `rasterio.open` takes one name only. A whole path is
    # never taken for an address, or an option of a driver.
    with without_words(), rasterio.Env():
        dataset = rasterio.io.DatasetReader(path.absolute(), driver=list(_FORMATS))
    if any(key.upper() == "OVERVIEW_FILE" for key in dataset.tags(ns="OVERVIEWS")):
        raise _names_others(path, "its metadata")
    # Files of ERDAS may keep values in another, wherever it is; those beside may be links.
    for name in dataset.files:
        if Path(name).parent != path.absolute().parent or is_elsewhere(path, Path(name)):
            raise _names_others(path, "it")
    return dataset


@contextmanager
def wherever() -> Iterator[None]:
    """Without rasterio's warning of rasters that have no place: whoever needs one asks for it."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", NotGeoreferencedWarning)
        yield


@contextmanager
def without_words() -> Iterator[None]:
    """Without the tracebacks that Python prints where rasterio fails to log words of GDAL that
    are no text, such as a damaged file's tags in them. Errors themselves are raised."""
    before = sys.unraisablehook
    sys.unraisablehook = lambda _: None
    try:
        yield
    finally:
        sys.unraisablehook = before


@contextmanager
def open_raster(path: str | Path, what: str) -> Iterator[RasterFile]:
    """A raster open for reading: GeoTIFF, ENVI (data or header), IMG, ASC, HGT, BIL, PNG or JPEG.

    Nothing else is read but what GDAL has beside a raster (overviews, a mask, a world file): a
    virtual raster (VRT) and other formats that name files or addresses are refused, also as such a
    file beside.

    **Arguments:** `path`: the file; `what`: names the file in errors, such as "a probability map".

    **Returns:** a context manager that gives a `RasterFile`.

    **Raises:** `InputError` for a file that is missing, cut short, damaged, no raster, or one that
    names others, and an ENVI header that lacks a field; also where GDAL fails inside the block.
    """
    path = existing_file(path, what)
    header_path = path
    beside = (path.with_suffix(".hdr"), path.with_name(path.name + ".hdr"))
    tiff = path.suffix.lower() in (".tif", ".tiff")
    header: dict[str, Any] = {}
    if path.suffix.lower() == ".hdr" or (not tiff and any(p.is_file() for p in beside)):
        header, header_path, path = open_envi(path, ENVI_DATA, "image")
    with in_file(path), _dataset(path, what) as dataset:
        listed = header.get("band names", ())
        names = listed if len(listed) == dataset.count else dataset.descriptions
        kinds = enumerate(dataset.colorinterp, 1)
        yield RasterFile(
            path=path,
            what=what,
            dataset=dataset,
            header=header,
            header_path=header_path,
            shape=(dataset.height, dataset.width),
            bands=tuple(n for n, kind in kinds if kind != ColorInterp.alpha),
            names=tuple((name or "").strip() for name in names),
            units=tuple((unit or "").strip() for unit in dataset.units),
            tags={str(k): str(v) for k, v in (header or dataset.tags()).items()},
            crs=dataset.crs,
        )


@contextmanager
def _dataset(path: Path, what: str) -> Iterator[Any]:
    """An open dataset of rasterio; what GDAL says of its file, then or in the block, as an
    `InputError`."""
    try:
        with wherever():
            warnings.simplefilter("ignore", RuntimeWarning)  # no-data values beyond the data's type
            _check_beside(path)
            dataset = _open(path)
        with dataset:
            if not dataset.count:
                raise InputError(f"expected {what}, but GDAL sees no bands in it")
            if dataset.count > _MOST_BANDS:
                raise InputError(
                    f"cannot be read as {what}: it states {dataset.count} bands. Is it damaged?"
                )
            if not all(abs(number) < LARGEST for number in dataset.transform):
                raise InputError(
                    f"cannot be read as {what}: its place is no place ({dataset.transform.c:g}, "
                    f"{dataset.transform.f:g}). Is it damaged?"
                )
            yield dataset
    except UnicodeDecodeError as error:
        raise InputError(
            f"expected {what} whose names and tags are UTF-8 text, but byte "
            f"0x{error.object[error.start]:02x} in one of them is none. Is it damaged, or named "
            "in another encoding? Copy it again, or name its bands in plain letters."
        ) from error
    except (RasterioError, CRSError, CPLE_BaseError) as error:
        raise _unreadable(path, what, error) from error


def _unreadable(path: Path, what: str, error: Exception) -> InputError:
    """The error of a file that GDAL cannot read, with what it seems to be."""
    with path.open("rb") as file:
        head = file.read(1 << 12).lower()
    if head.lstrip().startswith(b"<") or b"<vrtdataset" in head:
        return _names_others(path, "it")
    if head.startswith((b"\x89hdf", b"cdf")):
        return InputError(
            f"expected {what} as GeoTIFF or ENVI, but this is HDF5 or NetCDF.{how_to_import(path)}"
        )
    reason = " ".join(str(error.__cause__ or error).split())
    return InputError(
        f"cannot be read as {what} ({reason}). Is it cut short, or not a GeoTIFF? Copy it again."
    )


def _positive(text: str | None) -> float:
    """A positive number, or NaN."""
    try:
        value = stated_number(text or "nan")
    except ValueError:
        return math.nan
    return value if math.isfinite(value) and value > 0.0 else math.nan

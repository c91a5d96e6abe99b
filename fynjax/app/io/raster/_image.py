"""An image in one file, or in a file for each band, as programs for drone pictures write it."""

import re
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
import rasterio

from fynjax._core.errors import InputError
from fynjax.app.io.raster._reader import RasterFile, open_raster, wherever

_NAMED = re.compile(
    r"(?P<head>(?:.*[ _.-])?)(?P<band>red[ _-]?edge|nir|blue|green|red|re|b|g|r)", re.IGNORECASE
)
_SHORT = {"re": "rededge", "b": "blue", "g": "green", "r": "red"}
_NAMES = {"rededge": "red_edge"}
_TYPES = {
    **{"uint8": "Byte", "uint16": "UInt16", "int16": "Int16"},
    **{"uint32": "UInt32", "int32": "Int32", "float32": "Float32"},
}
"""GDAL's names of types of numbers; others are read as Float64."""
_TIFF = (".tif", ".tiff")


def band_of_file(path: Path) -> tuple[str, str] | None:
    """The band that a file is named after, such as `map_transparent_reflectance_red edge.tif`, and
    the name before it; `None` of a file named after no band."""
    found = _NAMED.fullmatch(path.stem)
    if found is None:
        return None
    plain = re.sub(r"[ _-]", "", found["band"].lower())
    plain = _SHORT.get(plain, plain)
    return _NAMES.get(plain, plain), found["head"]


def _files_of_bands(path: Path) -> dict[str, Path]:
    """The files beside `path` that are named as it is, but for the band."""
    own = band_of_file(path)
    if own is None or path.suffix.lower() not in _TIFF or not path.is_file():
        return {}
    files: dict[str, Path] = {}
    for other in sorted(path.parent.iterdir()):
        named = band_of_file(other) if other.suffix.lower() in _TIFF else None
        if named is not None and named[1] == own[1]:
            files.setdefault(named[0], other)
    return files if len(files) > 1 else {}


@contextmanager
def open_image(path: str | Path, what: str) -> Iterator[RasterFile]:
    """An image open for reading, as `open_raster` opens a file.

    A file of a single band that is named after it, such as Pix4D's
    `map_transparent_reflectance_green.tif` or DJI Terra's `result_Green.tif`, is opened together
    with those beside it that differ in the name of the band only, as one image with these names.

    **Arguments:** `path`, `what`: as of `open_raster`.

    **Raises:** `InputError` as `open_raster`, and for files of bands with other pixels.
    """
    with ExitStack() as opened:
        first = opened.enter_context(open_raster(path, what))
        alone = len(first.bands) != 1 or first.is_raw_capture
        files = {} if alone else _files_of_bands(first.path)
        if not files:
            yield first
            return
        parts = {
            band: opened.enter_context(open_raster(file, what)) for band, file in files.items()
        }
        for part in parts.values():
            _check_pixels(first, part)
        with wherever():
            dataset = opened.enter_context(rasterio.open(_joined(list(parts.values()))))
        yield replace(
            first,
            dataset=dataset,
            bands=tuple(dataset.indexes),
            names=tuple(parts),
            units=("",) * len(parts),
        )


def _check_pixels(first: RasterFile, part: RasterFile) -> None:
    a, b = first.dataset, part.dataset
    alike = first.shape == part.shape and first.crs == part.crs
    if not alike or not a.transform.almost_equals(b.transform, 1e-3 * abs(a.transform.a)):
        raise InputError(
            f"expected the pixels and the place of {first.path.name}, whose image it seems to be a "
            "band of, but it has others. Warp both onto the same pixels, or rename it: gdalwarp "
            "-t_srs ... -te ... -tr ...",
            file=part.path,
        )
    if len(part.bands) != 1 or np.dtype(b.dtypes[0]).kind not in "iuf":
        raise InputError(
            f"expected one band of an image, as {first.path.name} is, but it has "
            f"{len(part.bands)} of {b.dtypes[0]}. Rename it if it is none of that image.",
            file=part.path,
        )


def _joined(parts: list[RasterFile]) -> str:
    """A virtual raster of the first bands of files, as text that GDAL opens."""
    data = parts[0].dataset
    kinds = [np.dtype(part.dataset.dtypes[part.bands[0] - 1]) for part in parts]
    kind = _TYPES.get(np.result_type(*kinds).name, "Float64")
    root = ElementTree.Element(
        "VRTDataset", rasterXSize=str(data.width), rasterYSize=str(data.height)
    )
    if parts[0].crs is not None:
        ElementTree.SubElement(root, "SRS").text = parts[0].crs.to_wkt()
    if not data.transform.is_identity:
        numbers = ", ".join(repr(float(number)) for number in data.transform.to_gdal())
        ElementTree.SubElement(root, "GeoTransform").text = numbers
    for number, part in enumerate(parts, 1):
        of, k = part.dataset, part.bands[0]
        band = ElementTree.SubElement(root, "VRTRasterBand", dataType=kind, band=str(number))
        if of.nodatavals[k - 1] is not None:
            ElementTree.SubElement(band, "NoDataValue").text = repr(float(of.nodatavals[k - 1]))
        ElementTree.SubElement(band, "Scale").text = repr(float(of.scales[k - 1]))
        ElementTree.SubElement(band, "Offset").text = repr(float(of.offsets[k - 1]))
        source = ElementTree.SubElement(band, "SimpleSource")
        ElementTree.SubElement(source, "SourceFilename", relativeToVRT="0").text = str(
            part.path.absolute()
        )
        ElementTree.SubElement(source, "SourceBand").text = str(k)
    return ElementTree.tostring(root, encoding="unicode")

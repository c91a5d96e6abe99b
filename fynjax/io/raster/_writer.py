"""GeoTIFF images, in and out.

In memory an image is [band, y, x] with y increasing to the north, as everywhere in fynjax; on
disk row 0 is the northern edge, as every GIS expects. The flip happens here and nowhere else.
"""

import json
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import rasterio
from numpy.typing import ArrayLike, NDArray
from rasterio import Affine
from rasterio.crs import CRS
from rasterio.enums import ColorInterp

from fynjax._core.errors import InputError
from fynjax.io.raster._checks import check_north_up, check_square
from fynjax.io.raster._reader import open_raster
from fynjax.io.text import atomic_path, did_you_mean

LOCAL_FRAME = 'LOCAL_CS["fynjax plot frame, origin south-west",UNIT["metre",1]]'
"""Coordinate system of a plot without a place on Earth: x east, y north, in metres."""


@dataclass(frozen=True)
class ImageMeta:
    """What a file says of its image, beside the values."""

    file: Path
    bands: tuple[str, ...]
    """Names, in the order of the returned array."""
    pixel_m: float | None
    """Side of a pixel [m]; `None` where the file has no metric georeference."""
    origin_m: tuple[float, float] | None
    """South-west corner (x, y) in the file's coordinates [m]; `None` as above."""
    crs: str | None
    """Coordinate reference system as WKT."""
    masked: int
    """Pixels that are not used."""
    scale: float
    """Factor that a tag of the file asked for; 1 if none."""
    tags: dict[str, str]


def write_geotiff(
    path: str | Path,
    image: ArrayLike,
    band_names: Sequence[str],
    *,
    pixel_m: float,
    wavelengths: Sequence[float] | None = None,
    widths: Sequence[float] | None = None,
    origin_m: tuple[float, float] = (0.0, 0.0),
    crs: str | None = None,
    nodata: float = float("nan"),
    tags: Mapping[str, Any] | None = None,
) -> None:
    """Write an image as a compressed float32 GeoTIFF, whole or not at all.

    **Arguments:**

    - `image`: [band, y, x], y increasing to the north; reflectance [-].
    - `band_names`: one for each band; they become the band descriptions.
    - `pixel_m`: side of a pixel [m].
    - `wavelengths`: band centres; `widths`: full widths at half maximum, with them [nm].
    - `origin_m`: (x, y) of the south-west corner [m].
    - `crs`: anything rasterio reads, such as "EPSG:32734"; `None` is the plot's local frame.
    - `nodata`: value of pixels without data. Non-finite pixels are written as it.
    - `tags`: file attributes such as those of `provenance`.

    **Raises:** `ValueError` if shapes and names do not fit together.
    """
    values = np.asarray(image)
    if values.ndim != 3 or values.shape[0] != len(band_names):
        raise ValueError(
            f"`image` must be [band, y, x] with {len(band_names)} bands, but has shape "
            f"{values.shape}"
        )
    if wavelengths is not None and len(wavelengths) != len(band_names):
        raise ValueError(
            f"`wavelengths` must have {len(band_names)} values, but has {len(wavelengths)}"
        )
    values = np.where(np.isfinite(values), values, nodata).astype(np.float32)
    bands, rows, columns = values.shape
    north = origin_m[1] + rows * pixel_m
    profile = {
        "driver": "GTiff",
        "dtype": "float32",
        "count": bands,
        "height": rows,
        "width": columns,
        "crs": CRS.from_user_input(crs) if crs else CRS.from_wkt(LOCAL_FRAME),
        "transform": Affine(pixel_m, 0.0, origin_m[0], 0.0, -pixel_m, north),
        "nodata": nodata,
        "compress": "deflate",
        "predictor": 3,
        "tiled": min(rows, columns) >= 256,
        "photometric": "minisblack",
        "alpha": "no",
    }
    with atomic_path(path) as partial, rasterio.open(partial, "w", **profile) as file:
        file.write(np.ascontiguousarray(values[:, ::-1, :]))
        for number, name in enumerate(band_names, start=1):
            file.set_band_description(number, name)
            if wavelengths is not None:
                centre = float(wavelengths[number - 1])
                file.update_tags(number, wavelength=f"{centre:g}", wavelength_units="Nanometers")
                imagery = {"CENTRAL_WAVELENGTH_UM": f"{centre / 1e3:.7g}"}
                if widths is not None:
                    width = float(widths[number - 1])
                    file.update_tags(number, fwhm=f"{width:g}")
                    imagery["FWHM_UM"] = f"{width / 1e3:.7g}"
                file.update_tags(number, ns="IMAGERY", **imagery)
        file.update_tags(**{key: _tag(value) for key, value in (tags or {}).items()})


def _tag(value: Any) -> str:
    return value if isinstance(value, str) else json.dumps(value)


def _plain(name: str) -> str:
    return name.lower().replace(" ", "_").replace("-", "_")


def _choose_bands(
    descriptions: Sequence[str | None], count: int, expected: Sequence[str], path: Path
) -> list[int]:
    """Index in the file of each expected band: by name where the file names them, else by order."""
    names = [_plain(d) if d else "" for d in descriptions]
    wanted = [_plain(name) for name in expected]
    if all(name in names for name in wanted):
        return [names.index(name) for name in wanted]
    if count != len(expected):
        found = ", ".join(d or "unnamed" for d in descriptions)
        hint = (
            " A colour picture? The multispectral bands are separate files: stack them first."
            if count in (1, 3) and len(expected) == 4
            else ""
        )
        raise InputError(
            f"expected {len(expected)} bands ({', '.join(expected)}), but got {count} ({found})."
            f"{hint}",
            file=path,
        )
    if any(name in wanted for name in names):
        lost = next(name for name in wanted if name not in names)
        raise InputError(
            f"expected a band {lost!r}, but the file has {', '.join(filter(None, names))}."
            f"{did_you_mean(lost, [n for n in names if n not in wanted])}",
            file=path,
        )
    return list(range(count))


def check_scale(values: NDArray[np.float64], valid: NDArray[np.bool_], path: Path) -> None:
    """Refuse values that are no reflectance; never guess a scale."""
    lowest = float(values[:, valid].min())
    if lowest < -0.5:
        where = int((values[:, valid] < -0.5).any(axis=0).sum())
        raise InputError(
            f"expected reflectance as a fraction, but got {lowest:g} (in {where} pixels). "
            "A no-data value that the file does not declare? Set it with: "
            f"gdal_edit.py -a_nodata {lowest:g} {path.name}",
            file=path,
        )
    medians = np.median(values[:, valid], axis=1)
    if medians.min() < 0:
        raise InputError(
            f"expected reflectance of at least 0, but the median of a band is {medians.min():g}. "
            "Was a dark offset subtracted twice, or is this an index?",
            file=path,
        )
    brightest = float(medians.max())
    if brightest <= 1.5:
        return
    scale = 0.01 if brightest <= 100 else 0.0001
    kind = "percent" if brightest <= 100 else "integers of 0 to 10000"
    raise InputError(
        f"expected reflectance as a fraction, but the median of the brightest band is "
        f"{brightest:g}. Is it in {kind}? Then state it: gdal_edit.py -scale {scale:g} {path.name}",
        file=path,
    )


def _placement(file: Any, path: Path) -> tuple[float | None, tuple[float, float] | None, bool]:
    """Pixel size [m], south-west corner and whether row 0 is north."""
    t = file.transform
    if t.is_identity:
        return None, None, True
    check_north_up(t, path, "an image", may_be_flipped=True)
    north_up = t.e < 0
    if file.crs is not None and file.crs.is_geographic:
        return None, None, north_up
    check_square(t, path, "pixels")
    south = t.f + t.e * file.height if north_up else t.f
    return float(t.a), (float(t.c), float(south)), north_up


def read_image(
    path: str | Path, expected_bands: Sequence[str]
) -> tuple[NDArray[np.float64], NDArray[np.bool_], ImageMeta]:
    """Read a multispectral reflectance image.

    Bands are taken by name where the file's band descriptions have all the expected names, else
    by order. A scale and offset are applied only where the file's own tags state them.

    **Arguments:**

    - `path`: any raster that GDAL reads; GeoTIFF is usual.
    - `expected_bands`: names, in the order wanted.

    **Returns:** image [band, y, x], y increasing to the north, reflectance [-], NaN where masked;
    mask [y, x], true where every band has a finite value that is data; `ImageMeta`. Warns with
    the number of pixels that are masked.

    **Raises:** `InputError` if the file is missing, cut short, has other bands, is not in
    fractions, or has no pixel that can be used.
    """
    path = Path(path)
    with open_raster(path, "an image") as file:
        pixel, origin, north_up = _placement(file, path)
        alpha = [k for k, c in enumerate(file.colorinterp) if c == ColorInterp.alpha]
        data = [k for k in range(file.count) if k not in alpha]
        descriptions = [file.descriptions[k] for k in data]
        order = _choose_bands(descriptions, len(data), expected_bands, path)
        numbers = [data[k] + 1 for k in order]
        raw = file.read(numbers)
        valid = (file.read_masks(numbers) > 0).all(axis=0)
        scales = np.array([file.scales[n - 1] for n in numbers])[:, None, None]
        offsets = np.array([file.offsets[n - 1] for n in numbers])[:, None, None]
        tags = {str(k): str(v) for k, v in file.tags().items()}
        crs = file.crs.to_wkt() if file.crs else None
    values = raw.astype(np.float64) * scales + offsets
    finite = np.isfinite(values).all(axis=0)
    # Mosaics fill their border with zeros and rarely declare it; no ground reflects nothing.
    blank = (raw == 0).all(axis=0)
    valid = valid & finite & ~blank
    masked = int((~valid).sum())
    if not valid.any():
        raise InputError(
            f"expected an image, but all {valid.size} pixels are masked (no data, NaN, or zero in "
            "every band)",
            file=path,
        )
    check_scale(values, valid, path)
    if masked:
        warnings.warn(
            f"{path}: {masked} of {valid.size} pixels are masked (no data, NaN, or zero in every "
            "band) and not used",
            stacklevel=2,
        )
    values[:, ~valid] = np.nan
    if north_up:
        values, valid = values[:, ::-1, :], valid[::-1, :]
    names = tuple(descriptions[k] or expected_bands[j] for j, k in enumerate(order))
    meta = ImageMeta(path, names, pixel, origin, crs, masked, float(scales.flat[0]), tags)
    return np.ascontiguousarray(values), np.ascontiguousarray(valid), meta

"""Images of any number of bands: one GeoTIFF, or the single-band files of one capture."""

import itertools
import re
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float
from rasterio import Affine
from rasterio.enums import ColorInterp

from fynjax._core.errors import InputError, in_file
from fynjax.app.io.raster._align import Alignment, align_bands
from fynjax.app.io.raster._image import band_of_file, open_image
from fynjax.app.io.raster._reader import RAW_COUNTS, open_raster
from fynjax.app.io.raster._writer import north_up
from fynjax.app.io.text import stated_number

_COLOURS = {ColorInterp.red: "red", ColorInterp.green: "green", ColorInterp.blue: "blue"}


@dataclass(frozen=True)
class BandStack:
    """An image, what is known of its bands, and where it lies."""

    values: Float[np.ndarray, "band y x"]
    """Values of each band, in the file's unit; row 0 at the southern edge."""
    mask: Bool[np.ndarray, "y x"]
    """True where every band has a finite value that is data."""
    names: tuple[str, ...]
    wavelengths: tuple[float | None, ...]
    """Centres [nm], where known."""
    transform: Affine
    """Affine map from column and row, counted from the north-west corner, to x and y [m]."""
    crs: str | None
    """Coordinate reference system as WKT; `None` is the plot's local frame."""
    alignment: tuple[Alignment, ...] | None = None
    """Movement of single-band files onto the first; `None` where none had to be."""
    raw: bool = False
    """Whether the values are counts of a camera's raw capture, of its own gain in each band."""

    @property
    def known_as(self) -> str:
        """The bands as people call them: name, and wavelength where it is known; few of many."""
        return _listed(
            [
                name if wave is None or f"{wave:g}" in name else f"{name} {wave:g} nm"
                for name, wave in zip(self.names, self.wavelengths, strict=True)
            ]
        )


def _listed(names: Sequence[str]) -> str:
    """Names with commas; of more than eight the first two and the last."""
    few = names if len(names) <= 8 else [*names[:2], "...", names[-1]]
    return ", ".join(few)


def read_band_stack(
    paths: Sequence[str | Path],
    *,
    bands: Sequence[str] | None = None,
    pixel_m: float | None = None,
    align: bool = True,
) -> BandStack:
    """Read an image of any number of bands, in whatever unit.

    Names and wavelengths of the bands are those of the file's descriptions and tags, or of the
    metadata (XMP) that multispectral cameras write into their single-band files. Where such a file
    states its dark level, that is taken off. Bands without any data are left out, with a warning.

    **Arguments:**

    - `paths`: one file of several bands, or any of files that are named after their bands
      (`open_image`); or files of one band each, in order, on the same pixels or of one capture.
      Files of a capture have no place on Earth; they are aligned (`align_bands`), unless `align`
      is false.
    - `bands`: names of the bands, or their wavelengths [nm], in the order of the files; they
      replace what the files say.
    - `pixel_m`: side of a pixel on the ground [m]. Needed for an image without a coordinate
      reference system, which is then put into the plot's local frame, its south-west corner at
      (0, 0) and the top of the picture north.

    **Returns:** a `BandStack` of the bands that have data, in the file's unit.

    **Raises:** `InputError` for files that are missing or cut short, do not fit together, are in
    degrees or feet or rotated, have no place while `pixel_m` is not given, or have no data;
    `MissingExtraError` where bands must be aligned and scikit-image is missing.
    """
    files = [Path(path) for path in paths]
    if not files:
        raise InputError("expected an image, but got no file")
    with in_file(files[0]):
        first, placed = _read(files[0], beside=len(files) == 1)
        parts = [first]
        for path in files[1:]:
            part, same = _read(path)
            with in_file(path):
                _check_together(first, part, placed == same, files[0].name)
            parts.append(part)
        names = [name for part in parts for name in part.names]
        waves = [wave for part in parts for wave in part.wavelengths]
        if len(parts) > 1:  # of single-band files nobody wrote which is which
            names = [
                f"band {k}" if re.fullmatch(r"band \d+", name) else name
                for k, name in enumerate(names, 1)
            ]
        if bands is not None:
            names, waves = _stated(bands, len(names))
        values = np.concatenate([part.values for part in parts])
        mask = np.all([part.mask for part in parts], axis=0)
        stack = _with_data(replace(first, values=values, mask=mask), names, waves, files[0])
        if not placed:
            return _in_own_frame(stack, pixel_m, align and len(parts) > 1)
        if pixel_m is not None:
            raise InputError(
                f"`pixel_m` is for an image without a coordinate reference system, but this one "
                f"has pixels of {stack.transform.a:g} m. Leave it out."
            )
        return stack


def _with_data(
    stack: BandStack, names: Sequence[str], waves: Sequence[float | None], path: Path
) -> BandStack:
    """The bands that have data, and the pixels that all of these know."""
    alive = np.isfinite(stack.values).any(axis=(1, 2))
    values = stack.values[alive] if not alive.all() else stack.values
    mask = stack.mask & np.isfinite(values).all(axis=0)
    if not alive.any() or not mask.any():
        raise InputError(
            f"expected an image, but all {mask.size} pixels are without data (no data, NaN, or "
            "zero in every band)"
        )
    if not alive.all():
        dead = list(itertools.compress(names, ~alive))
        warnings.warn(
            f"{path}: {len(dead)} of {len(alive)} bands have no data and are left out: "
            f"{_listed(dead)}",
            stacklevel=3,
        )
    return replace(
        stack,
        values=values,
        mask=mask,
        names=tuple(itertools.compress(names, alive)),
        wavelengths=tuple(itertools.compress(waves, alive)),
    )


def _in_own_frame(stack: BandStack, pixel_m: float | None, align: bool) -> BandStack:
    """A picture without a place in the plot's own frame, its bands laid on the first."""
    if pixel_m is None:
        raise InputError(
            RAW_COUNTS
            if stack.raw
            else "expected an image with a coordinate reference system, but it has none. An "
            "orthophoto has one; for a single picture say how large a pixel is on the ground: "
            "--pixel METRES. The map is then in a frame of the plot's own."
        )
    if not (np.isfinite(pixel_m) and pixel_m > 0.0):
        raise InputError(f"`pixel_m` must be positive [m], but is {pixel_m}")
    values, mask, alignment = stack.values, stack.mask, None
    if align:
        if not mask.all():
            raise InputError(
                f"bands can be aligned where all pixels are data, but {int((~mask).sum())} of "
                f"{mask.size} are not. Align them first, and leave it out here (--no-align)."
            )
        values, cut, alignments = align_bands(values)
        mask, alignment = mask[cut], tuple(alignments)
    transform = north_up(pixel_m, (0.0, 0.0), mask.shape[0])
    return replace(
        stack, values=values, mask=mask, transform=transform, crs=None, alignment=alignment
    )


def _read(path: Path, *, beside: bool = False) -> tuple[BandStack, bool]:
    """The bands of one file, with those `beside` it (`open_image`), and whether it has a place."""
    with (open_image if beside else open_raster)(path, "an image") as file:
        if file.crs is not None:
            file.check_place()
        colours = file.dataset.colorinterp
        numbers = file.bands
        masks = len(numbers) == len(colours) or _is_mask(
            file.stored_band(next(n for n in file.dataset.indexes if n not in numbers))
        )
        if not masks:
            numbers = file.dataset.indexes
        # Exact for up to 16 bits, and half the memory.
        kind = np.result_type(np.float32, *(file.dataset.dtypes[n - 1] for n in numbers))
        raster = file.read(numbers, zero_is_data=False, dtype=kind)
        xmp = file.xmp if len(numbers) == 1 else {}
        names: list[str] = []
        waves: list[float | None] = []
        for number, wave in zip(numbers, file.wavelengths[np.array(numbers) - 1], strict=True):
            colour = _COLOURS.get(colours[number - 1]) if masks else None
            given = file.names[number - 1] or "".join(xmp.get("BandName", [])[:1]) or colour
            if not given and len(numbers) == 1 and (named := band_of_file(path)):
                given = named[0]
            names.append((given or f"band {number}").strip())
            stated = _numbers(xmp, "CentralWavelength") if np.isnan(wave) else [float(wave)]
            waves.append(stated[0] if stated else None)
        crs = file.crs.to_wkt() if file.crs is not None and file.on_earth else None
        placed, raw = file.has_place, file.is_raw_capture
    values = raster.values
    if dark := _numbers(xmp, "DarkRowValue"):  # what the camera's covered pixels read
        values = values - kind.type(np.mean(dark))
    with_data = np.isfinite(values).any(axis=(1, 2))
    mask = np.isfinite(values[with_data]).all(axis=0) & with_data.any()
    stack = BandStack(values, mask, tuple(names), tuple(waves), raster.transform, crs, raw=raw)
    return stack, placed


def _is_mask(band: np.ndarray) -> bool:
    """Whether a band called alpha says which pixels are data.

    Programs call the fourth of four 8-bit bands so by default, also where it is near infrared
    (and the first three red, green and blue, whatever they are).
    """
    top = np.iinfo(band.dtype).max if band.dtype.kind in "ui" else 1.0
    return float(np.mean((band == 0) | (band == top))) > 0.99


def _numbers(xmp: dict[str, list[str]], key: str) -> list[float]:
    """Positive numbers that a camera states under a name."""
    try:
        values = [stated_number(part) for text in xmp.get(key, []) for part in text.split(",")]
    except ValueError:
        return []
    return [value for value in values if np.isfinite(value) and value > 0.0]


def _check_together(a: BandStack, b: BandStack, alike_placed: bool, first: str) -> None:
    if len(a.values) != 1 or len(b.values) != 1:
        raise InputError(
            "expected one image of several bands, or files of one band each, but "
            f"{first} has {len(a.values)} and this one {len(b.values)}. Stack the bands of "
            "one image: gdal_merge.py -separate"
        )
    if a.values.shape != b.values.shape:
        raise InputError(
            f"expected {a.values.shape[2]} x {a.values.shape[1]} pixels as in {first}, but "
            f"this file has {b.values.shape[2]} x {b.values.shape[1]}. Are both of one capture?"
        )
    if not alike_placed or a.crs != b.crs or not a.transform.almost_equals(b.transform, 1e-3):
        raise InputError(
            f"expected the same place and coordinate reference system as {first}, but this "
            "file has others. Warp both onto the same pixels: gdalwarp -t_srs ... -te ... -tr ..."
        )


def _stated(bands: Sequence[str], count: int) -> tuple[list[str], list[float | None]]:
    """Names and wavelengths, from a list of either."""
    given = [band.strip() for band in bands]
    if len(given) != count or not all(given):
        raise InputError(
            f"expected names or wavelengths of {count} bands, but got {len(given)} "
            f"({', '.join(given)})"
        )
    waves: list[float | None] = []
    for band in given:
        wave = float(band) if re.fullmatch(r"\d+(\.\d+)?", band) else None
        if wave is not None and not 300.0 <= wave <= 15000.0:
            raise InputError(
                f"a wavelength must be in nm, 300 to 15000, but is {band}. Is it a band's number? "
                "Give names, such as red, or wavelengths."
            )
        waves.append(wave)
    return [b if w is None else f"{w:g} nm" for b, w in zip(given, waves, strict=True)], waves

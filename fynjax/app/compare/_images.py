"""Drone images as a comparison needs them: their bands, by blocks, thinned where they are large.

Two images are compared by the distributions of their pixels, not pixel by pixel. They may differ in
size, place and coordinate system, and need none.
"""

import re
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from scipy.ndimage import binary_opening, binary_propagation

from fynjax._core.errors import InputError, names_file
from fynjax.app.io.raster import RAW_COUNTS, RELATIVE_TAG, RasterFile, check_reflectance, open_image
from fynjax.canopy import band_word
from fynjax.metrics import BANDS
from fynjax.sensors import BandSet, mavic_3m

FEW_PIXELS = 30
"""Compared pixels below which distributions say nothing."""

# Wavelengths [nm] that are taken for each band.
_KNOWN = {
    "blue": (440.0, 510.0),
    "green": (530.0, 585.0),
    "red": (625.0, 690.0),
    "red_edge": (700.0, 750.0),
    "nir": (780.0, 900.0),
}


class OtherBands(NamedTuple):
    """Bands to be read beside the four, as a `BandSet` has them; NaN where not known."""

    names: tuple[str, ...]
    centre: tuple[float, ...]
    """Centre wavelength [nm]."""
    fwhm: tuple[float, ...]
    """Full width at half maximum [nm]."""


_COLOUR = re.compile(r"coastal|violet|blue|cyan|green(?!ness)|yellow|orange|red|nir|swir|pan")
"""Beginning of a name of a band of reflected light, in one spelling."""
_SAME_NM = 10.0
"""Wavelengths of one band differ by no more [nm]."""
_MOST_BANDS = 16
"""Most bands that a camera has; with more it is a spectrometer, compared by its spectra."""


@dataclass(frozen=True)
class DroneImage:
    """The pixels of an image that are compared, and what was left out."""

    file: Path
    values: Float[np.ndarray, "band y x"]
    """Reflectance [-], y to the north; NaN where masked."""
    bands: tuple[str, ...]
    """Name of each band: `fynjax.metrics.BANDS`, and then the others."""
    mask: Bool[np.ndarray, "y x"]
    """True where a pixel is compared."""
    taken: tuple[str, ...]
    """Name of each band in the file."""
    chosen_by: str
    """Way in which the bands were identified: 'option', 'names', 'wavelengths' or 'order'."""
    shape: tuple[int, int]
    """Rows and columns of the file."""
    step: int
    """Every `step`-th row and column was read."""
    pixel_m: float | None
    """Side of the file's pixels [m], where it says."""
    crs: str | None
    without_data: int
    """Read pixels that are no data, not finite, or zero in every band."""
    saturated: int
    """Read pixels that reach the saturation in a band."""
    not_positive: int
    """Compared pixels with a reflectance of zero or less in a band."""

    @property
    def pixels(self) -> Float[np.ndarray, "band pixel"]:
        """The compared pixels."""
        return self.values[:, self.mask]

    def description(self) -> str:
        """Bands and pixels that were read, in sentences."""
        rows, columns = self.shape
        place = "" if self.pixel_m is None else f" of {self.pixel_m:g} m"
        text = f"{columns} x {rows} pixels{place}; bands by {self.chosen_by}"
        text += f" ({', '.join(self.taken)}); "
        if self.step > 1:
            text += f"every {self.step}th row and column read; "
        text += f"{int(self.mask.sum())} pixels compared"
        left = [
            f"{count} {what}"
            for count, what in ((self.without_data, "without data"), (self.saturated, "saturated"))
            if count
        ]
        text += f", {' and '.join(left)} left out" if left else ""
        if self.not_positive:
            text += f"; {self.not_positive} of them have a band at or below 0"
        return text + "."


@names_file
def read_drone_image(
    path: str | Path,
    *,
    bands: Sequence[str] | None = None,
    camera: BandSet | OtherBands | None = None,
    saturation: float | None = None,
    most_pixels: int | None = 1_000_000,
) -> DroneImage:
    """Read the bands of a camera's image, in blocks of rows.

    Green, red, red edge and near infrared must be there, because indices need them.

    **Arguments:**

    - `path`: any raster that GDAL reads. Its scale and offset tags are applied, no scale is
      guessed.
    - `bands`: what each band of the file is, in its order, such as "blue", "green", "red", "nir",
      "red_edge", and others of the `camera`; any other name is a band that is not used. If not
      given, bands are known by their names (of the files, where each band has its own:
      `open_image`), else by their wavelengths, else, of exactly four bands without either, by the
      order green, red, red edge, near infrared, if they grow brighter towards near infrared as
      vegetation does.
    - `camera`: bands of the camera. Each that the file has, by name or by a wavelength within its
      width, is read beside the four, and a pixel without data in any of them is left out. Without
      a camera the four alone are read.
    - `saturation`: saturation threshold [-]: pixels that reach it in a band are left out. In files
      of integers the largest value of their type always is, unless it is their no-data value.
    - `most_pixels`: of a larger image every k-th row and column is read, with the smallest k that
      gives no more; `None` reads all.

    **Returns:** a `DroneImage`: reflectance [-] of the pixels that are compared.

    **Raises:** `InputError` for a file that is missing or cut short, for a band that cannot be
    identified, for values that are no fractions, for coordinates in degrees, or without a pixel to
    compare; and where bands without names are not as bright as vegetation in their order. Warns of
    bands taken by their order, of near infrared that is darker than red, and where pixels pile up
    at a band's largest value, as clipped ones do.

    >>> import pathlib, tempfile
    >>> import numpy as np
    >>> from fynjax.app.compare import read_drone_image
    >>> from fynjax.app.io.raster import write_geotiff
    >>> levels = np.linspace(0.9, 1.1, 900).reshape(30, 30)
    >>> bands = {"green": 0.05, "red": 0.04, "red_edge": 0.15, "nir": 0.30}
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = pathlib.Path(folder) / "drone.tif"
    ...     picture = [level * levels for level in bands.values()]
    ...     write_geotiff(path, picture, list(bands), pixel_m=0.1)
    ...     image = read_drone_image(path)
    >>> image.chosen_by, image.pixels.shape
    ('names', (4, 900))
    """
    path = Path(path)
    with open_image(path, "a drone image") as file:
        if file.is_raw_capture:
            raise InputError(RAW_COUNTS)
        if doubt := file.tags.get(RELATIVE_TAG):
            warnings.warn(f"{path}: {doubt}", stacklevel=3)
        # Programs call the last of four bands alpha, also where it is near infrared.
        data = file.dataset.indexes if file.dataset.count == len(BANDS) else file.bands
        names, numbers, taken, how = _find_bands(file, data, bands, camera)
        step = 1 if most_pixels is None else thinning(*file.shape, most_pixels)
        image = file.read(numbers, step=step, zero_is_data=False)
        pixel = file.pixel_m
        crs = None if file.crs is None else file.crs.to_string()
        scaled = any(file.dataset.scales[n - 1] != 1.0 for n in numbers)
        kind = None if scaled else np.result_type(*(file.dataset.dtypes[n - 1] for n in numbers))
        shape = file.shape
    values, valid = image.values, image.mask & ~_holes(image.values, path)
    saturated = valid & image.full
    if saturation is not None:
        with np.errstate(invalid="ignore"):
            saturated |= valid & (values >= saturation).any(axis=0)
    used = valid & ~saturated
    if not used.any():
        raise InputError(
            f"expected an image, but of {valid.size} pixels {int((~valid).sum())} are without data "
            f"and {int(saturated.sum())} saturated: none is left"
        )
    _check_scale(values[:, used], kind, path)
    if (pixels := int(used.sum())) < FEW_PIXELS:
        warnings.warn(
            f"{path}: {pixels} pixels are compared, which is too few for distributions; means "
            "alone can be compared, if at all",
            stacklevel=3,
        )
    _check_order(values[: len(BANDS), used], how, taken, path)
    _warn_of_clipping(values[:, used], names, path)
    values[:, ~used] = np.nan
    return DroneImage(
        file=path,
        values=np.ascontiguousarray(values),
        bands=names,
        mask=np.ascontiguousarray(used),
        taken=taken,
        chosen_by=how,
        shape=shape,
        step=step,
        pixel_m=pixel,
        crs=crs,
        without_data=int((~valid).sum()),
        saturated=int(saturated.sum()),
        not_positive=int((values[:, used] <= 0.0).any(axis=0).sum()),
    )


def _holes(values: Float[np.ndarray, "band y x"], path: Path) -> Bool[np.ndarray, "y x"]:
    """Pixels that are 0 in a band, in patches of 3 x 3 at least, although another has half its
    median at least: no shadow or dark leaf, but a band that the mosaic has not there."""
    with np.errstate(invalid="ignore"), warnings.catch_warnings(action="ignore"):
        half = 0.5 * np.nanmedian(np.where(values == 0.0, np.nan, values), axis=(1, 2))
        lit = ((values >= half[:, None, None]) & (values > 0.0)).any(axis=0)
    zero, square = (values == 0.0) & lit, np.ones((1, 3, 3))
    # A patch may go on beyond the image, and where it has no data.
    dark = np.pad(zero | ~np.isfinite(values), ((0, 0), (1, 1), (1, 1)), constant_values=True)
    patches = binary_opening(dark, square)[:, 1:-1, 1:-1] & zero
    holes = binary_propagation(patches, square, zero).any(axis=0)
    if holes.any():
        warnings.warn(
            f"{path}: {int(holes.sum())} pixels are 0 in one band and bright in another: taken for "
            "a hole of that band, they are without data",
            stacklevel=4,
        )
    return np.asarray(holes)


def shared_bands(
    *images: str | Path, bands: Sequence[Sequence[str] | None] = (None, None)
) -> OtherBands | None:
    """Bands of reflected light that two images have beside the four, as the first names them.

    A band of the second is the same if its name is, or if their wavelengths are within 10 nm.

    **Arguments:** two `images`; the names of their `bands` where they are stated.

    **Returns:** `OtherBands`, for `read_drone_image`; `None` without any, and where more are shared
    than a camera has.

    **Raises:** `InputError` for images that cannot be opened.
    """
    first, second = map(_colours, images, bands)
    found = {}
    for word, (name, centre) in first.items():
        if word in second or any(abs(wave - centre) <= _SAME_NM for _, wave in second.values()):
            found[name] = centre
    if not 0 < len(found) <= _MOST_BANDS:
        return None
    return OtherBands(tuple(found), tuple(found.values()), (2.0 * _SAME_NM,) * len(found))


def _colours(path: str | Path, stated: Sequence[str] | None) -> dict[str, tuple[str, float]]:
    """Name and centre [nm] of each band of reflected light, by the name in one spelling."""
    with open_image(path, "a drone image") as file:
        names, waves = file.names if stated is None else stated, file.wavelengths
    found: dict[str, tuple[str, float]] = {}
    for name, wave in zip(names, waves, strict=False):
        if _COLOUR.match(word := band_word(name or "")):
            found.setdefault(word, (word if word in _KNOWN else name.lower(), float(wave)))
        elif 350.0 < wave < 2600.0:
            word = "blue" if abs(wave - 475.0) <= _SAME_NM else f"{wave:g} nm"
            found.setdefault(word, (word, float(wave)))
    return found


def _check_order(
    pixels: Float[np.ndarray, "band pixel"], how: str, taken: Sequence[str], path: Path
) -> None:
    """Say which bands were taken by their order, and refuse or doubt what no vegetation is."""
    medians = np.median(pixels, axis=1)
    *others, edge, nir = medians
    say = f"Say what each band of the file is, {_OPTION}"
    if how == "order":
        if not max(medians[:2]) < edge < nir:
            listed = ", ".join(f"{value:.3g}" for value in medians)
            raise InputError(
                f"expected bands in the order {', '.join(BANDS)}, since the file names none, but "
                f"their medians are {listed}: vegetation is brightest in near infrared, then in "
                f"the red edge. {say}"
            )
        warnings.warn(
            f"{path}: the file names no band: they are taken to be {', '.join(BANDS)}, in this "
            f"order; green and red cannot be known by their values. {say}",
            stacklevel=4,
        )
    elif nir < 0.9 * max(*others, edge):
        what = ", ".join(f"{n} {m:.3g}" for n, m in zip(taken, medians, strict=False))
        warnings.warn(
            f"{path}: the bands have medians of {what}: vegetation is brightest in near infrared. "
            "Are the bands named right?",
            stacklevel=4,
        )


def _check_scale(
    pixels: Float[np.ndarray, "band pixel"], kind: np.dtype[Any] | None, path: Path
) -> None:
    """Refuse numbers that are no fractions; no scale is guessed. `kind` where unscaled."""
    lowest, medians = float(pixels.min()), np.median(pixels, axis=1)
    darkest, brightest = float(medians.min()), float(medians.max())
    if lowest < -0.5:
        raise InputError(
            f"expected reflectance as a fraction, but got {lowest:g} (in "
            f"{int((pixels < -0.5).any(axis=0).sum())} pixels). A no-data value that the file "
            f"does not declare? Set it with: gdal_edit.py -a_nodata {lowest:g} {path.name}"
        )
    if darkest < 0.0:
        raise InputError(
            f"expected reflectance of at least 0, but the median of a band is {darkest:g}. "
            "Was a dark offset subtracted twice, or is this an index?"
        )
    check_reflectance(brightest, path, eight_bits=kind is not None and kind.itemsize == 1)


def thinning(rows: int, columns: int, most: int) -> int:
    """The smallest k for which every k-th row and column make no more than `most` pixels."""
    step = max(1, int(np.floor(np.sqrt(rows * columns / most))))
    while -(-rows // step) * -(-columns // step) > most:
        step += 1
    return step


_OPTION = (
    "such as --bands nir,red_edge,red,green of one with near infrared first (validate: "
    "--real-bands, --simulated-bands)"
)


def _find_bands(
    file: RasterFile,
    data: Sequence[int],
    stated: Sequence[str] | None,
    camera: BandSet | OtherBands | None,
) -> tuple[tuple[str, ...], list[int], tuple[str, ...], str]:
    """Names of the bands that are read, `BANDS` first, and of each its number in the file, what
    the file calls it; and how the four were found."""
    at, taken, how = _find_four(file, data, stated)
    described = [file.names[n - 1] for n in data] if stated is None else stated
    roles = [band_word(name) for name in described]
    waves = file.wavelengths[np.array(data) - 1]
    names, places, shown = list(BANDS), list(at), list(taken)
    others = zip(camera.names, camera.centre, camera.fwhm, strict=True) if camera else ()
    for name, centre, width in others:
        if name in BANDS:
            continue
        low, high = _KNOWN.get(name, (centre - 0.5 * width, centre + 0.5 * width))
        free = [k for k in range(len(data)) if k not in places]
        found = [k for k in free if roles[k] == band_word(name)]
        if len(found) != 1 and stated is None:
            inside = [k for k in free if low <= waves[k] <= high]
            found = sorted(inside, key=lambda k: float(abs(waves[k] - centre)))[:1]
        if len(found) == 1:
            names.append(name)
            places += found
            shown.append(described[found[0]] or f"{waves[found[0]]:g} nm")
    return tuple(names), [data[k] for k in places], tuple(shown), how


def _find_four(
    file: RasterFile, data: Sequence[int], stated: Sequence[str] | None
) -> tuple[list[int], tuple[str, ...], str]:
    """Place in `data` of each of `BANDS`, what the file calls it, and how it was found."""
    described = [file.names[n - 1] for n in data]
    labels = [d or f"band {n}" for d, n in zip(described, data, strict=True)]
    if stated is not None:
        if len(stated) != len(data):
            raise InputError(
                f"expected names of {len(data)} bands, but got {len(stated)} ({', '.join(stated)})"
            )
        roles = [band_word(name) for name in stated]
        missing = [band for band in BANDS if roles.count(band) != 1]
        if missing:
            raise InputError(
                f"expected each of {', '.join(BANDS)} once among the stated bands, but "
                f"{missing[0]} is there {roles.count(missing[0])} times in {', '.join(stated)}"
            )
        return [roles.index(b) for b in BANDS], tuple(BANDS), "option"
    roles = [band_word(name) for name in described]
    if all(roles.count(band) == 1 for band in BANDS):
        at = [roles.index(band) for band in BANDS]
        return at, tuple(labels[k] for k in at), "names"
    waves = file.wavelengths[np.array(data) - 1]
    near: dict[str, int] = {}
    drone = mavic_3m()
    centres = dict(zip(drone.names, drone.centre, strict=True))
    for band in BANDS:
        low, high = _KNOWN[band]
        inside = [(abs(w - centres[band]), k) for k, w in enumerate(waves) if low <= w <= high]
        if inside:
            near[band] = min(inside)[1]
    if set(near) == set(BANDS):
        at = [near[band] for band in BANDS]
        return at, tuple(f"{waves[k]:g} nm" for k in at), "wavelengths"
    if len(data) == len(BANDS) and not any(roles) and np.isnan(waves).all():
        return list(range(len(data))), tuple(labels), "order"
    unnamed = [b for b in BANDS if roles.count(b) != 1]
    absent = next((b for b in unnamed if b not in near), unnamed[0])
    shown = [
        label if np.isnan(w) else f"{label} {w:g} nm"
        for label, w in zip(labels, waves, strict=True)
    ]
    raise InputError(
        f"expected the bands {', '.join(BANDS)}, but no single band is known as {absent} among "
        f"{', '.join(shown[:8])}{', ...' if len(shown) > 8 else ''}. "
        + (
            f"Say what each band of the file is, {_OPTION}"
            if len(data) > 1
            else "A band of several files? Name them after it, as result_Green.tif and "
            "result_NIR.tif, or join them: gdal_merge.py -separate -o image.tif GREEN RED ..."
        )
    )


def _warn_of_clipping(
    pixels: Float[np.ndarray, "band pixel"], names: Sequence[str], path: Path
) -> None:
    piled = []
    for name, band in zip(names, pixels, strict=True):
        top = band.max()
        share = float(np.mean(band == top))
        if share > 1e-3 and band.min() < top and band.size * share > 20:
            piled.append(f"{name} {100 * share:.2g} % at {top:.4g}")
    if piled:
        warnings.warn(
            f"{path}: many pixels have a band's largest value ({', '.join(piled)}). Are they "
            "clipped? --saturation leaves those out that reach a reflectance",
            stacklevel=4,
        )

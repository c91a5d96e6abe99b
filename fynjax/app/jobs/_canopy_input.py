"""Pixels of canopies as people have them: a table, or an image, of bands or wavelengths."""

import re
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pandas as pd
from jaxtyping import Float
from rasterio import Affine

from fynjax._core.errors import InputError, did_you_mean, in_file
from fynjax.app.io.raster import RELATIVE_TAG, open_blocks
from fynjax.app.io.text import open_table
from fynjax.metrics import BAND_TERMS
from fynjax.sensors import BandSet, Sensor

ANGLES = ("sun_zenith", "view_zenith", "relative_azimuth")
"""Columns that say how a pixel is lit and seen [degrees]."""
_AZIMUTHS = "sun_azimuth", "view_azimuth"
"""Columns whose difference is the last of them."""
_TABLES = (".csv", ".txt", ".tsv", ".xlsx", ".tab")
_BAND = re.compile(r"(?:sr[_ .]?)?b(?:and)?[_ .]?0*(\d+a?)", re.I)
_WAVELENGTH = re.compile(
    r"(?:(?:r|rho|refl|reflectance|x|band|wl|w|nm)[ _.]?)?(\d{3,4}(?:\.\d+)?)(?:[ _.]?nm)?", re.I
)
_COUNTED = re.compile(r"b(?:and[ _.]?)?0*(\d+)", re.I)
_CATALOGUE = {
    "coastal": 443.0, "rededge1": 704.0, "rededge2": 740.0, "rededge3": 783.0, "nir08": 865.0,
    "nir09": 945.0, "swir16": 1610.0, "swir22": 2200.0,
}  # fmt: skip
"""Names of bands in catalogues of satellites (STAC), with their middles [nm]."""
_LANDSAT = 2.75e-5, -0.2
"""Factor and offset of Landsat's collection 2."""
_NEAR = 780.0, 1300.0
"""Near infrared, where canopies are brightest [nm]."""
_DARKEST, _BRIGHTEST = 0.08, 0.75
"""What the brightest canopies of an image reflect there at least, and at most [-]."""
_PERCENT = "Percent, by their numbers."
_LEAST_STORED = 6000.0
"""Below what stands there for a reflectance of 0, 7273."""
_OFFSET = 0.1
"""What Sentinel-2's numbers have added to reflectance since 2022 [-]."""
_OXYGEN = (748.0, 753.0), (759.5, 763.5), 0.8
"""Beside and in the line of oxygen [nm]; below this share of what is beside it, it is radiance."""


@dataclass(frozen=True)
class CanopyPixels:
    """Reflectance of pixels, and what stood beside it."""

    bands: BandSet | Float[np.ndarray, " band"]
    """Bands of a sensor, or wavelengths [nm], rising."""
    reflectance: Float[np.ndarray, "pixel band"]
    said: list[str]
    """Sentences on which columns were taken for bands, and in which scale."""
    notes: pd.DataFrame | None = None
    """Other columns of a table."""
    angles: pd.DataFrame | None = None
    """Columns of `ANGLES` of a table."""
    shape: tuple[int, int] | None = None
    """Rows and columns of an image, row 0 at the top."""
    transform: Affine = field(default_factory=Affine.identity)
    crs: str | None = None


def read_canopy_pixels(path: str | Path, sensor: Sensor | None) -> CanopyPixels:
    """Pixels of a table (CSV, Excel) or an image (GeoTIFF, ENVI, NetCDF, zarr).

    Bands have names of the `sensor`, as B2, B02, SR_B2, band_2 or blue, or wavelengths in nm, as
    665, R665 or 665nm. Fractions, percent, ten thousandths and Landsat's collection 2 are
    distinguished by their numbers.

    **Raises:** `InputError` for fewer than three bands, and what `open_table` and `open_blocks`
    refuse.
    """
    path = Path(path)
    with in_file(path):
        return (_table if path.suffix.lower() in _TABLES else _image)(path, sensor)


def _table(path: Path, sensor: Sensor | None) -> CanopyPixels:
    table = open_table(path, "a table of pixels")
    places, bands, words = _places(table.names, None, sensor)
    asked = {_plain(name): i for i, name in enumerate(table.names)}
    both = ANGLES[2] not in asked and set(_AZIMUTHS) <= set(asked)
    angles = {n: asked[n] for n in (*ANGLES, *_AZIMUTHS * both) if n in asked}
    for name, i in angles.items():
        if re.search(r"[(\[]\s*rad", table.names[i], re.I):
            raise InputError(f"expected {name} in degrees, but its column is {table.names[i]!r}")
    numbers = [*places, *angles.values()]
    rest = [i for i in range(table.width) if i not in numbers]
    frame = table.columns(numbers, rest, missing=("", "na", "nan", "none", "null"))
    names = [table.names[i] for i in places]
    values, said = _scaled(frame[places].to_numpy(float), names, sensor)
    said += _doubts(values, bands, said, sensor)
    notes = frame[rest].set_axis([table.names[i] or "row" for i in rest], axis=1)
    seen = frame[list(angles.values())].set_axis(list(angles), axis=1)
    if both:
        seen[ANGLES[2]] = seen[_AZIMUTHS[1]] - seen[_AZIMUTHS[0]]
    return CanopyPixels(bands, values, [words, *said], notes, seen if angles else None)


def _plain(name: str) -> str:
    return re.sub(r"\W+", "_", re.sub(r"[(\[].*", "", name).strip().lower())


def _image(path: Path, sensor: Sensor | None) -> CanopyPixels:
    with open_blocks(path) as cube:
        if cube.location is not None:
            raise InputError("expected an image on a map, but this is a swath: warp it first")
        stated = np.where(cube.good, cube.wavelength, np.nan)
        places, bands, words = _places(cube.names, stated, sensor)
        rows = cube.shape[0]
        parts = [
            cube.read(start, min(cube.rows_at_once, rows - start))[:, :, places]
            for start in range(0, rows, cube.rows_at_once)
        ]
        values = np.concatenate(parts).reshape(-1, len(places)).astype(float)
        values, said = _scaled(values, [cube.names[i] for i in places], sensor)
        said += _doubts(values, bands, said, sensor)
        if doubt := getattr(cube.source, "tags", {}).get(RELATIVE_TAG):
            said.append(f"{doubt}. Traits of it are wrong by more than their intervals.")
        return CanopyPixels(
            bands, values, [words, *said],
            shape=cube.shape, transform=cube.transform, crs=cube.crs,
        )  # fmt: skip


def _places(
    names: tuple[str, ...], stated: np.ndarray | None, sensor: Sensor | None
) -> tuple[list[int], BandSet | np.ndarray, str]:
    """Columns that are bands, what bands they are, and that in words."""
    if sensor is not None:
        found: dict[int, int] = {}
        apart: dict[int, float] = {}
        if stated is None or np.isnan(stated).all():
            known = [_band_of(name, sensor.bands) is not None for name in names]
            stated = np.where(known, np.nan, _wavelengths(names))
            _check_no_count(names, sensor)
        near = [_nearest(float(at), sensor.bands) for at in stated]
        for i, name in enumerate(names):
            band, off = _band_of(name, sensor.bands), 0.0
            if np.isfinite(stated[i]) and band != near[i]:  # names may only count
                band = near[i]
                off = abs(sensor.bands.centre[band or 0] - stated[i])
            if band is not None and off < apart.get(band, np.inf):
                found[band], apart[band] = i, off
        order = sorted(found)
        if (most := max(map(near.count, order), default=0)) > 2:
            raise InputError(
                f"expected a column for each band of {sensor.name}, but {most} wavelengths are "
                "within one of them, as of a spectrum. Leave the sensor out: spectra are fitted by "
                "their wavelengths"
            )
        if len(order) < 3:
            raise InputError(
                f"expected at least three bands of {sensor.name} "
                f"({', '.join(sensor.bands.names[:13])}), but of "
                f"{', '.join(filter(None, names[:13])) or 'bands without names'} only "
                f"{len(order)} are. Name bands as there, as blue, green, red, nir, swir_1, or by "
                "their wavelengths: 665"
            )
        words = ", ".join(f"{names[found[b]] or b + 1} as {sensor.bands.names[b]}" for b in order)
        if len(order) > 13:
            words = f"{len(order)} bands by wavelength"
        left = _left_out(names, list(found.values()))
        return [found[b] for b in order], sensor.bands.select(order), f"Bands: {words}.{left}"
    own = _wavelengths(names) if stated is None or np.isnan(stated).all() else stated
    order = [int(i) for i in np.argsort(own, kind="stable") if 400.0 <= own[i] <= 2500.0]
    if len(order) < 3:
        hint = did_you_mean(next(filter(_BAND.fullmatch, names), ""), names)
        raise InputError(
            "expected bands named by their wavelengths in nm, such as 665, but got "
            f"{', '.join(filter(None, names[:13])) or 'no names'}. "
            "State the sensor whose bands these are: --sensor sentinel_2a"
            if hint or not any(np.isfinite(own))
            else f"expected three bands from 400 to 2500 nm or more, but {len(order)} are"
        )
    keep = np.concatenate([[True], np.diff(own[order]) > 0.0])  # detectors may overlap
    if stated is None and not keep.all():
        second = int(np.argmin(keep))
        raise InputError(
            f"expected one column for each wavelength, but {names[order[second - 1]]} and "
            f"{names[order[second]]} are both of {own[order[second]]:g} nm. Rename one"
        )
    order = [i for i, k in zip(order, keep) if k]
    centre = own[order]
    words = f"Bands: {len(order)} from {centre[0]:g} to {centre[-1]:g} nm"
    if stated is None:
        some = order if len(order) <= 13 else [order[0], order[-1]]
        words += f", {(', ' if some is order else ' to ').join(names[i] for i in some)}"
    return order, centre, f"{words}.{_left_out(names, order)}"


def _check_no_count(names: tuple[str, ...], sensor: Sensor) -> None:
    """Refuse names that only count the bands of a file, where the sensor's own do not."""
    of_bands = [name for name in names if _band_of(name, sensor.bands) is not None]
    numbers = [_COUNTED.fullmatch(name.strip()) for name in of_bands]
    in_order = [m is not None and int(m[1]) == i + 1 for i, m in enumerate(numbers)]
    # "B1" to "B8" may be the sensor's; beyond, its own go on by B8A.
    said = any(m and m[0].lower().startswith("band") for m in numbers) or len(numbers) > 8
    if said and all(in_order) and any(re.fullmatch(r"B\d+A", n) for n in sensor.bands.names):
        raise InputError(
            f"expected names of bands of {sensor.name}, such as B2, B3, B8A, but {of_bands[0]} to "
            f"{of_bands[-1]} only count the file's bands. Name them, or state their wavelengths in "
            "the file"
        )


def _left_out(names: tuple[str, ...], used: list[int]) -> str:
    """Names of the columns or bands of a file that were not taken as bands, in a sentence."""
    plain = list(map(_plain, names))
    angles = (*ANGLES, *_AZIMUTHS * (set(_AZIMUTHS) <= set(plain)))
    rest = [n for i, n in enumerate(names) if n and i not in used and plain[i] not in angles]
    more = ", ..." if len(rest) > 13 else ""
    return f" Not used as bands: {', '.join(rest[:13])}{more}." if rest else ""


def _band_of(name: str, bands: BandSet) -> int | None:
    """The band that a name means: its own, its number, or its colour."""
    plain = [own.lower() for own in bands.names]
    text = _plain(name)
    if text in plain:
        return plain.index(text)
    if match := _BAND.fullmatch(name.strip()):
        number = f"b{match[1].lower()}"
        return plain.index(number) if number in plain else None
    colour = text.replace("_", "")
    if colour in _CATALOGUE:
        return _nearest(_CATALOGUE[colour], bands)
    for term in BAND_TERMS.values():
        if term.word.replace("_", "") == colour:
            centre, width = np.asarray(bands.centre), np.asarray(bands.fwhm)
            fits = (centre >= term.shortest) & (centre <= term.longest) & (width <= term.widest)
            apart = np.where(fits, np.abs(centre - term.usual), np.inf)
            return int(np.argmin(apart)) if fits.any() else None
    return None


def _nearest(wavelength: float, bands: BandSet) -> int | None:
    if not np.isfinite(wavelength):
        return None
    apart = np.abs(np.asarray(bands.centre) - wavelength)
    place = int(np.argmin(apart))
    return place if apart[place] <= max(10.0, 0.5 * float(bands.fwhm[place])) else None


def _wavelengths(names: tuple[str, ...]) -> np.ndarray:
    found = [_WAVELENGTH.fullmatch(name.strip()) for name in names]
    return np.array([np.nan if m is None else float(m[1]) for m in found])


def _scaled(
    values: np.ndarray, names: list[str], sensor: Sensor | None
) -> tuple[np.ndarray, list[str]]:
    """Reflectance as fractions, and what the numbers were; nothing of a pixel that is all 0."""
    values = np.where((values == 0.0).all(axis=1, keepdims=True), np.nan, values)
    known = values[np.isfinite(values) & (values > -0.01)]
    if not known.size:
        raise InputError("expected reflectance, but no pixel has any")
    high = float(np.quantile(known, 0.95))
    if high <= 1.5:
        return values, []
    if high <= 100.0:
        return values / 100.0, [_PERCENT]
    low = np.quantile(known[known > 0.0], [0.01, 0.05])
    whose = "" if sensor is None else sensor.name
    if low[1] > _LEAST_STORED and high < 65536.0:
        if not (whose.startswith("landsat") or all(n.lower().startswith("sr_b") for n in names)):
            raise InputError(
                "no ground reflects 0.6 in all bands, as these numbers say in ten thousandths. Are "
                "they of Landsat's collection 2? Name them SR_B1, SR_B2 and so on"
            )
        factor, offset = _LANDSAT
        scaled = np.where(values > 0.0, values * factor + offset, np.nan)
        return scaled, [f"Landsat collection 2: numbers times {factor:g}, less {-offset:g}."]
    if high <= 2.0e4:
        return values / 1e4, ["Ten thousandths, by their numbers."]
    raise InputError(
        f"expected reflectance, but 5 % of the values are above {high:.4g}. Is it radiance, or "
        "counts?"
    )


def _doubts(
    values: np.ndarray, bands: BandSet | np.ndarray, said: list[str], sensor: Sensor | None
) -> list[str]:
    """Sentences on an offset that is still in reflectance, and on a near infrared that no canopies
    have.

    **Raises:** `InputError` for fine bands that show the line of oxygen, as radiance does.
    """
    centre = np.asarray(getattr(bands, "centre", bands))
    beside, within, least = _OXYGEN
    columns = [(centre > low) & (centre < high) for low, high in (beside, within)]
    if all(one.any() for one in columns):
        level, line = (values[:, one].mean(axis=1) for one in columns)
        there = (level > 0.0) & (line > 0.0)
        bright = there & (level >= 0.5 * np.quantile(level[there], 0.95)) if there.any() else there
        share = float(np.median(line[bright] / level[bright])) if bright.any() else 1.0
        if share < least:
            raise InputError(
                f"expected reflectance, but at 761 nm, where oxygen absorbs, there is {share:.2f} "
                "of what is at 750 nm, as in radiance and above the atmosphere. Make reflectance "
                "of the surface of it first"
            )
    doubts = []
    some = values[np.isfinite(values) & (values > 0.0)]
    few = centre.size <= 13 and (centre < 700.0).any()
    of_sentinel = sensor is None or sensor.name.startswith("sentinel_2")
    if of_sentinel and few and some.size and np.quantile(some, 0.01) >= _OFFSET:
        doubts.append(
            "Hardly any reflectance is below 0.1: if this is Sentinel-2's, is its offset of 1000 "
            "ten thousandths (baseline 04.00, since 2022) still in it? Take it off first."
        )
    near = values[:, (centre > _NEAR[0]) & (centre < _NEAR[1])]
    if not np.isfinite(near).any():
        return doubts
    high = float(np.nanquantile(near, 0.95))
    # What is percent by its numbers alone may be radiance.
    darkest = (2.0 if _PERCENT in said else 1.0) * _DARKEST
    if darkest < high < _BRIGHTEST:
        return doubts
    return [
        *doubts,
        f"So read, the near infrared of the brightest pixels is {high:.2g}, but of canopies "
        f"{darkest:g} to {_BRIGHTEST:g}: are the numbers in another scale, such as thousandths, "
        "counts or radiance? Then give fractions of 0 to 1.",
    ]

"""Pixels of canopies as people have them: a table, or an image, of bands or wavelengths."""

import re
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pandas as pd
from jaxtyping import Float
from rasterio import Affine

from fynjax._core.errors import InputError, did_you_mean, in_file
from fynjax.app.io.raster import open_blocks
from fynjax.app.io.text import open_table
from fynjax.metrics import BAND_TERMS
from fynjax.sensors import BandSet, Sensor

ANGLES = ("sun_zenith", "view_zenith", "relative_azimuth")
"""Columns that say how a pixel is lit and seen [degrees]."""
_TABLES = (".csv", ".txt", ".tsv", ".xlsx", ".tab")
_BAND = re.compile(r"(?:sr[_ .]?)?b(?:and)?[_ .]?0*(\d+a?)", re.I)
_WAVELENGTH = re.compile(r"(?:[a-z]{1,12}[ _.]?)?(\d{3,4}(?:\.\d+)?)(?:[ _.]?nm)?", re.I)
_LANDSAT = 2.75e-5, -0.2
"""Factor and offset of Landsat's collection 2."""
_LEAST_STORED = 6000.0
"""Below what stands there for a reflectance of 0, 7273."""


@dataclass(frozen=True)
class CanopyPixels:
    """Reflectance of pixels, and what stood beside it."""

    bands: BandSet | Float[np.ndarray, " band"]
    """Bands of a sensor, or wavelengths [nm], rising."""
    reflectance: Float[np.ndarray, "pixel band"]
    said: list[str]
    """What was taken for what."""
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
    665, R665 or 665nm. Fractions, percent, ten thousandths and Landsat's collection 2 are told by
    their numbers.

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
    angles = {name: asked[name] for name in ANGLES if name in asked}
    numbers = [*places, *angles.values()]
    rest = [i for i in range(table.width) if i not in numbers]
    frame = table.columns(numbers, rest, missing=("", "na", "nan", "none", "null"))
    values, said = _scaled(frame[places].to_numpy(float), [table.names[i] for i in places])
    notes = frame[rest].set_axis([table.names[i] or "row" for i in rest], axis=1)
    seen = frame[list(angles.values())].set_axis(list(angles), axis=1)
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
        values, said = _scaled(values, [cube.names[i] for i in places])
        return CanopyPixels(
            bands, values, [words, *said],
            shape=cube.shape, transform=cube.transform, crs=cube.crs,
        )  # fmt: skip


def _places(
    names: tuple[str, ...], stated: np.ndarray | None, sensor: Sensor | None
) -> tuple[list[int], BandSet | np.ndarray, str]:
    """Columns that are bands, what bands they are, and that in words."""
    if sensor is not None:
        found = {}
        for i, name in enumerate(names):
            band = _band_of(name, sensor.bands)
            if band is None and stated is not None and np.isfinite(stated[i]):
                band = _nearest(float(stated[i]), sensor.bands)
            if band is not None and band not in found:
                found[band] = i
        order = sorted(found)
        if len(order) < 3:
            raise InputError(
                f"expected at least three bands of {sensor.name} "
                f"({', '.join(sensor.bands.names[:13])}), but of {', '.join(names[:13])} only "
                f"{len(order)} are"
            )
        words = ", ".join(f"{names[found[b]] or b + 1} as {sensor.bands.names[b]}" for b in order)
        if len(order) > 13:
            words = f"{len(order)} bands by wavelength"
        return [found[b] for b in order], sensor.bands.select(order), f"Bands: {words}."
    own = _wavelengths(names) if stated is None or np.isnan(stated).all() else stated
    order = [int(i) for i in np.argsort(own) if 400.0 <= own[i] <= 2500.0]
    if len(order) < 3:
        hint = did_you_mean(next(filter(_BAND.fullmatch, names), ""), names)
        raise InputError(
            "expected bands named by their wavelengths in nm, such as 665, but got "
            f"{', '.join(filter(None, names[:13])) or 'no names'}. "
            "State the sensor whose bands these are: --sensor sentinel_2a"
            if hint or not any(np.isfinite(own))
            else f"expected three bands from 400 to 2500 nm or more, but {len(order)} are"
        )
    centre = own[order]
    keep = np.concatenate([[True], np.diff(centre) > 0.0])  # detectors may overlap
    order = [i for i, k in zip(order, keep) if k]
    centre = own[order]
    return order, centre, f"Bands: {len(order)} from {centre[0]:g} to {centre[-1]:g} nm."


def _band_of(name: str, bands: BandSet) -> int | None:
    """The band that a name means: its own, its number, or its colour."""
    plain = [own.lower() for own in bands.names]
    text = _plain(name)
    if text in plain:
        return plain.index(text)
    if match := _BAND.fullmatch(name.strip()):
        number = f"b{match[1].lower()}"
        return plain.index(number) if number in plain else None
    colours = {term.word.replace("_", ""): term for term in BAND_TERMS.values()}
    term = colours.get(text.replace("_", ""))
    return None if term is None else _nearest(term.usual, bands)


def _nearest(wavelength: float, bands: BandSet) -> int | None:
    apart = np.abs(np.asarray(bands.centre) - wavelength)
    place = int(np.argmin(apart))
    return place if apart[place] <= max(10.0, 0.5 * float(bands.fwhm[place])) else None


def _wavelengths(names: tuple[str, ...]) -> np.ndarray:
    found = [_WAVELENGTH.fullmatch(name.strip()) for name in names]
    return np.array([np.nan if m is None else float(m[1]) for m in found])


def _scaled(values: np.ndarray, names: list[str]) -> tuple[np.ndarray, list[str]]:
    """Reflectance as fractions, and what the numbers were."""
    known = values[np.isfinite(values) & (values > -0.01)]
    if not known.size:
        raise InputError("expected reflectance, but no pixel has any")
    high = float(np.quantile(known, 0.95))
    if high <= 1.5:
        return values, []
    if high <= 100.0:
        return values / 100.0, ["Percent, by their numbers."]
    stored = np.quantile(known, 0.05) > _LEAST_STORED
    if stored and all(name.lower().startswith("sr_b") for name in names):
        factor, offset = _LANDSAT
        scaled = np.where(values > 0.0, values * factor + offset, np.nan)
        return scaled, [f"Landsat collection 2: numbers times {factor:g}, less {-offset:g}."]
    if high <= 2.0e4:
        return values / 1e4, ["Ten thousandths, by their numbers."]
    raise InputError(
        f"expected reflectance, but 5 % of the values are above {high:.4g}. Is it radiance, or "
        "counts?"
    )

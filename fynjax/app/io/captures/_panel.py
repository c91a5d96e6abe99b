"""Panels of known reflectance in pictures of a camera: where they are, and what they reflect."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray
from pydantic import model_validator
from scipy import ndimage
from scipy.spatial import ConvexHull

from fynjax._core.errors import InputError, in_file, names_file
from fynjax._core.precision import double_precision
from fynjax.app.io.captures._capture import Capture
from fynjax.app.io.text import Strict, in_unit, read_rows, stated_number
from fynjax.sensors import BandSet, PanelReading, panel_coverage, panel_reading

_EVEN = 0.08
"""Spread over mean of a panel's pixels up to which it is one surface [-]; that of a RedEdge's own
panel is 0.02."""
_INNER = 0.75
"""Side of the area that is read over that of the panel."""
_ALIKE = 0.15
"""Share of their own side by which areas in different bands may differ."""


@dataclass(frozen=True)
class PanelView:
    """Where a panel lies in all bands of a capture, and its radiance there."""

    capture: Capture
    areas: tuple[Float[np.ndarray, "corner 2"], ...]
    """Corners (x, y) of the panel in each band, on its own pixels [pixel], y down from the top."""
    found: str
    """Origin of its place: 'found in the picture', 'given', or 'stated by the camera'."""
    mean: Float[np.ndarray, " band"]
    """Mean radiance of the panel in each band [W m-2 sr-1 um-1]."""
    spread: Float[np.ndarray, " band"]
    """Standard deviation of its radiance between pixels [W m-2 sr-1 um-1]."""
    count: tuple[int, ...]
    """Number of pixels that were read in each band."""


class _PanelRow(Strict):
    """One row of a panel's file."""

    band: str | None = None
    wavelength_nm: float | None = in_unit("nm", default=None, ge=300, le=15000)
    """Wavelength [nm]."""
    reflectance: float = in_unit("-", gt=0, le=1.2)
    """Reflectance factor [-]."""

    @model_validator(mode="after")
    def _of_what(self) -> "_PanelRow":
        if (self.band is None) == (self.wavelength_nm is None):
            raise ValueError("a row needs either `band` or `wavelength_nm`")
        return self


def panel_reflectance(given: str | None, capture: Capture) -> Float[np.ndarray, " band"]:
    """Reflectance of a panel in each band of a capture [-].

    **Arguments:**

    - `given`: a number for all bands, numbers with commas in the order of the bands, or a CSV file
      with the columns `band,reflectance` or `wavelength_nm,reflectance` (a spectrum, which is
      averaged over the bands). `None`: as the camera states it, where it read the panel's code.
    - `capture`: the picture of the panel, with its bands.

    **Returns:** reflectance factors, above 0 and at most 1.2 [-].

    **Raises:** `InputError` where it is not given and not stated, or does not fit the bands.
    """
    bands = capture.bands
    if given is None:
        missing = [band.name for band in bands if band.panel_reflectance is None]
        if missing:
            raise InputError(
                f"expected the panel's reflectance, but the pictures do not state it "
                f"({', '.join(missing)}). Its maker gives one for each band: --panel-reflectance "
                f"{','.join(['0.5'] * len(bands))} in the order {', '.join(capture.names)}, or a "
                "CSV file with the columns band,reflectance.",
                file=bands[0].path,
            )
        return np.array([band.panel_reflectance for band in bands])
    try:
        values = np.array([stated_number(part) for part in given.split(",")])
    except ValueError:
        return _of_file(Path(given), capture)
    if values.size not in (1, len(bands)):
        raise InputError(
            f"expected one reflectance of the panel, or {len(bands)} in the order "
            f"{', '.join(capture.names)}, but got {values.size}: {given}"
        )
    if not np.all((values > 0.0) & (values <= 1.2)):
        raise InputError(
            f"a panel's reflectance must be above 0 and at most 1.2, but is {given}. In percent? "
            "Divide by 100."
        )
    return np.broadcast_to(values, len(bands)).copy()


@names_file
def _of_file(path: Path, capture: Capture) -> Float[np.ndarray, " band"]:
    rows = [row for _, row in read_rows(path, _PanelRow, "a panel's reflectance")]
    named = [row.band.lower() for row in rows if row.band is not None]
    if 0 < len(named) < len(rows):
        raise InputError(
            f"expected every row to name a `band`, or every one a `wavelength_nm`, but "
            f"{len(named)} of {len(rows)} name a band. A table of bands and a spectrum in one file?"
        )
    if twice := [band for band in named if named.count(band) > 1]:
        raise InputError(
            f"expected one row for each band, but {twice[0]!r} has {named.count(twice[0])}. Of two "
            "panels? Give each a file of its own: --panel-reflectance, once for each"
        )
    known = {row.band.lower(): row.reflectance for row in rows if row.band is not None}
    if known:
        missing = [name for name in capture.names if name.lower() not in known]
        if missing:
            raise InputError(
                f"expected the reflectance in band {missing[0]!r}, but there is only "
                f"{', '.join(known)}"
            )
        return np.array([known[name.lower()] for name in capture.names])
    spectrum = sorted((row.wavelength_nm or 0.0, row.reflectance) for row in rows)
    waves, values = np.array(spectrum).T
    bands = BandSet(
        capture.names,
        tuple(band.wavelength for band in capture.bands),
        tuple(band.fwhm for band in capture.bands),
    )
    return bands.weights(waves, max_loss=0.02) @ values


@double_precision
def read_panel(capture: Capture, area: NDArray[np.float64] | None = None) -> PanelView:
    """Read the radiance of a panel in every band of a capture.

    **Arguments:**

    - `capture`: the picture of the panel.
    - `area`: corners (x, y) [pixel], shape (corner, 2), y down from the top, inside the panel in
      every band (the lenses show a near panel some pixels apart). If not given, it is what the
      camera states, or else the brightest even square near the middle (`find_panel`).

    **Returns:** a `PanelView`: its area, and mean and spread of its radiance [W m-2 sr-1 um-1].

    **Raises:** `InputError` where there is no panel, or it is saturated, uneven, or at another
    place in some band.
    """
    stated = [band.panel_area for band in capture.bands]
    areas: list[NDArray[np.float64]]
    pictures = capture.radiance()
    if area is not None:
        how, areas = "given", [np.asarray(area, float)] * len(stated)
    elif all(corners is not None for corners in stated):
        how, areas = "stated by the camera", [corners for corners in stated if corners is not None]
    else:
        how, areas = "found in the picture", []
        for band, picture in zip(capture.bands, pictures, strict=True):
            corners = find_panel(picture)
            if corners is None:
                raise InputError(
                    f"expected a panel near the middle of the picture, but found no even bright "
                    f"square in band {band.name}. Say where it is: --panel-area "
                    '"x,y x,y x,y x,y", columns and rows of its corners.',
                    file=band.path,
                )
            areas.append(corners)
        _check_alike(areas, capture)
    readings = [
        _read(picture, corners, capture, k)
        for k, (picture, corners) in enumerate(zip(pictures, areas, strict=True))
    ]
    return PanelView(
        capture,
        tuple(areas),
        how,
        np.array([float(r.mean[0]) for r in readings]),
        np.array([float(r.spread[0]) for r in readings]),
        tuple(r.count for r in readings),
    )


def _read(
    picture: NDArray[np.float32], corners: NDArray[np.float64], capture: Capture, k: int
) -> PanelReading:
    band = capture.bands[k]
    with in_file(band.path):
        cover = panel_coverage(corners, picture.shape)
        if band.full[cover >= 1.0].any():
            share = float(band.full[cover >= 1.0].mean())
            raise InputError(
                f"the panel is saturated in band {band.name}: {100 * share:.3g} % of its pixels "
                "are full. Choose a picture of it with a shorter exposure."
            )
        reading = panel_reading(jnp.asarray(picture[None], float), jnp.asarray(cover))
    mean, spread = float(reading.mean[0]), float(reading.spread[0])
    if not mean > 0.0 or spread > _EVEN * mean:
        raise InputError(
            f"expected an even panel, but in band {band.name} its pixels spread by "
            f"{100 * spread / max(mean, 1e-9):.0f} % of their mean. Does the area reach over its "
            "edge, or is there a shadow? Lenses see a near panel some tens of pixels apart.",
            file=band.path,
        )
    return reading


def _check_alike(areas: Sequence[NDArray[np.float64]], capture: Capture) -> None:
    sides = np.array([np.sqrt(_area(corners)) for corners in areas])
    usual = float(np.median(sides))
    odd = np.abs(sides - usual) > _ALIKE * usual
    middles = np.array([corners.mean(axis=0) for corners in areas])
    away = np.hypot(*(middles - np.median(middles, axis=0)).T)
    odd |= away > max(usual, 0.15 * capture.bands[0].counts.shape[1])
    if odd.any():
        k = int(odd.argmax())
        raise InputError(
            f"expected the panel at nearly the same place in all bands, but in band "
            f"{capture.names[k]} the brightest even square is {sides[k]:.0f} pixels wide at column "
            f"{middles[k, 0]:.0f}, row {middles[k, 1]:.0f}, and in most {usual:.0f} pixels. Say "
            'where it is: --panel-area "x,y x,y x,y x,y".',
            file=capture.bands[k].path,
        )


def find_panel(picture: Float[np.ndarray, "row column"]) -> Float[np.ndarray, "4 2"] | None:
    """Corners (x, y) well inside the brightest even square near the middle [pixel], or `None`.

    Squares of a tenth of the picture's height are looked at whose middle lies in the middle
    two thirds; the brightest even one is grown to where the brightness changes, which must be a
    rectangle; its inner three quarters are returned. It may be turned.
    """
    values = np.asarray(picture, dtype=np.float64)
    # Mean and spread in a square window around each pixel; the brightest even one near the middle.
    side = max(values.shape[0] // 10, 4)
    mean = ndimage.uniform_filter(values, side)
    spread = np.sqrt(np.maximum(ndimage.uniform_filter(values**2, side) - mean**2, 0.0))
    even = (mean > 0.0) & (spread < 0.5 * _EVEN * mean)
    rows, columns = (slice(n // 6, n - n // 6) for n in values.shape)
    inside = np.where(even, mean, -np.inf)[rows, columns]
    at = np.unravel_index(int(inside.argmax()), inside.shape)
    if not np.isfinite(inside[at]):
        return None
    seed = (int(at[0]) + rows.start, int(at[1]) + columns.start)
    # The brightest window touches the panel's edge where fall-off makes that side brighter.
    like = np.abs(ndimage.gaussian_filter(values, 2.0) / mean[seed] - 1.0) < 2.0 * _EVEN
    labels, _ = ndimage.label(like)
    if labels[seed] == 0:
        return None
    region = ndimage.binary_fill_holes(labels == labels[seed])
    # Grown to where the brightness changes, it must fill a rectangle.
    corners = _rectangle(np.argwhere(region)[:, ::-1] + 0.5)
    if region.sum() < 0.85 * _area(corners):
        return None
    middle = corners.mean(axis=0)
    return middle + _INNER * (corners - middle)


def _rectangle(points: NDArray[np.floating[Any]]) -> NDArray[np.float64]:
    """Corners of the smallest rectangle around points, to one degree of turning."""
    hull = points[ConvexHull(points).vertices]
    best, least = np.zeros((4, 2)), np.inf
    for angle in np.radians(np.arange(90.0)):
        turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        turned = hull @ turn
        (x0, y0), (x1, y1) = turned.min(axis=0), turned.max(axis=0)
        if (x1 - x0) * (y1 - y0) < least:
            least = (x1 - x0) * (y1 - y0)
            best = np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]]) @ turn.T
    return best


def _area(corners: NDArray[np.float64]) -> float:
    """Area of a polygon (shoelace formula)."""
    x, y = corners.T
    return 0.5 * abs(float(np.dot(x, np.roll(y, -1)) - np.dot(y, np.roll(x, -1))))

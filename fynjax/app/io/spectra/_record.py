"""A spectrum as a file holds it, and the checks every reader shares."""

from dataclasses import dataclass, field, replace
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from fynjax._core.errors import InputError

# Bands where an outdoor spectrum is noise: no check looks there, and the fit can leave them out.
WATER_WINDOWS = ((1340.0, 1420.0), (1790.0, 1970.0), (2400.0, 2600.0))
_LOWEST, _HIGHEST = -0.02, 1.05
# Of a thin or opaque leaf too much stray light or gap taken off leaves a transmittance below zero,
# rarely further than this.
_OVERCORRECTED = -0.1
# No ratio of two counts of 16 bits, be they noise, is larger.
_LARGEST_RATIO = 65535.0
_BRIGHT = (750.0, 1300.0)
_DARKEST = 0.01
"""Reflectance that leaves, soils and rocks exceed somewhere from 750 to 1300 nm; tar and water
under no sun glint have .02 to .05 there."""
_MICROMETRES = ("micro", "um", "\u00b5m", "\u03bcm")
_NANOMETRES = ("nano", "nm")
_UNSTATED = ("", "unknown", "index", "1", "dimensionless")
_PERCENT = 1.5, 110.0
"""What a twentieth of a spectrum in percent is above, and what it is not [%]."""
_TEN_THOUSANDTHS = 1000.0, 12_000.0
"""The same of reflectance times 10000: above, as reflectance times 1000 and bytes are below it."""
_NO_DATA = np.array(
    [-1, -9, -99, -99.9, -999, -999.9, -9999, -9999.9, -32767, -32768, 32767, 65535], np.float32
)
"""Numbers that programs write where there is no value."""
_LONGEST = 1e6
"""No file states a longer wavelength: a millimetre in nm."""


@dataclass(frozen=True)
class MeasuredSpectrum:
    """One measured spectrum."""

    name: str
    """Name in the file, or the file's name."""
    wavelength: np.ndarray
    """Band centres [nm], ascending."""
    reflectance: np.ndarray | None
    """Reflectance [-], NaN where missing; `None` if only transmittance was measured."""
    transmittance: np.ndarray | None = None
    """Transmittance [-], NaN where missing; `None` if not measured."""
    meta: dict[str, Any] = field(default_factory=dict)
    """Further statements of the file; `format` and `repairs` (sentences) are always there."""

    def noted(self, *sentences: str, meta: dict[str, Any] | None = None, **fields: Any) -> Self:
        """A copy with `sentences` among its repairs, the statements `meta`, and other `fields`."""
        repairs = [*self.meta.get("repairs", []), *sentences]
        return replace(self, meta={**self.meta, **(meta or {}), "repairs": repairs}, **fields)


def single_spectrum(
    name: str, wavelength: np.ndarray, values: np.ndarray, meta: dict[str, Any], through: bool
) -> MeasuredSpectrum:
    """A spectrum of transmittance alone (`through`), or of reflectance alone."""
    reflected, passed = (None, values) if through else (values, None)
    return MeasuredSpectrum(name, wavelength, reflected, passed, meta)


def note(meta: dict[str, Any], sentence: str) -> None:
    """Add `sentence` to the repairs in `meta`, which belongs to a spectrum under construction."""
    meta.setdefault("repairs", []).append(sentence)


def in_nanometres(wavelength: NDArray[np.float64], unit: str) -> tuple[NDArray[np.float64], float]:
    """Band centres in nanometres.

    **Arguments:**

    - `wavelength`: band centres in `unit`, shape (band,).
    - `unit`: as a file states it; empty where it states none.

    **Returns:** band centres [nm], and the factor from `unit` to nm.

    **Raises:** `InputError` for a unit that is neither nm nor µm, for numbers that are in the other
    of both, and for a wavelength that no spectrometer has.
    """
    unit = unit.strip().lower()
    lowest, highest = float(np.nanmin(wavelength)), float(np.nanmax(wavelength))
    if not 0.0 <= lowest <= highest <= _LONGEST:
        wrong = lowest if lowest < 0.0 else highest
        words = f"expected wavelengths in Nanometers or Micrometers, but one is {wrong:g}"
        raise InputError(words, column="wavelength")
    micrometres = unit.startswith(_MICROMETRES)
    if not micrometres and not unit.startswith(_NANOMETRES) and unit not in _UNSTATED:
        words = f"expected wavelengths in Nanometers or Micrometers, but the unit is {unit!r}"
        raise InputError(words, column="wavelength units")
    if unit not in _UNSTATED and micrometres != (highest < 100.0):
        raise InputError(
            f"wavelengths are stated in {unit!r}, but run to {highest:g}; are they "
            f"{'nm' if micrometres else 'µm'}?"
        )
    return (wavelength * 1000.0, 1000.0) if highest < 100.0 else (wavelength, 1.0)


def without_marks(
    values: NDArray[np.float64], scale: float, meta: dict[str, Any]
) -> NDArray[np.float64]:
    """Values without the numbers that stand for none, where reflectance 1 is `scale`."""
    gone = np.isin(values.astype(np.float32), _NO_DATA) & (np.abs(values) > 0.5 * scale)
    if not gone.any():
        return values
    shown = " ".join(f"{number:.6g}" for number in np.unique(values[gone]))
    note(meta, f"{gone.sum()} values of {shown} taken for missing, which they mark")
    return np.where(gone, np.nan, values)


def as_fractions(
    values: NDArray[np.float64], meta: dict[str, Any], most: float = _TEN_THOUSANDTHS[1]
) -> NDArray[np.float64]:
    """Values [spectrum, band] of a file that states no unit, those that mark gaps missing.

    Percent, and reflectance times 10000 in whole numbers, are known by numbers that every spectrum
    has such, and become fractions; above `most` nothing does.
    """
    marks = np.isin(values.astype(np.float32), _NO_DATA)
    known = np.where(marks, np.nan, values)
    known = known[np.isfinite(known).any(axis=1)]
    scale = 1.0
    if known.size and np.nanmedian(known) > _PERCENT[0]:
        high = np.nanpercentile(known, 95.0, axis=1)
        whole = bool(np.all(np.isnan(known) | (known == np.round(known))))
        if high.min() > _PERCENT[0] and high.max() <= _PERCENT[1]:
            scale, words = 100.0, "percent, which"
        elif whole and high.min() > _TEN_THOUSANDTHS[0] and high.max() <= most:
            scale, words = 10_000.0, "reflectance times 10000, which (if they are no counts) whole"
    values = without_marks(values, scale, meta)
    if scale > 1.0:
        note(meta, f"converted from {words} values up to {np.nanmax(known):.4g} are")
    return values / scale


def check_widths(width: NDArray[np.float64]) -> None:
    """Refuse full widths of bands that no spectrometer has.

    **Arguments:** `width`, full widths at half maximum [nm], shape (band,); NaN where unknown.

    **Raises:** `InputError` for one below 0 or above 1e6 nm.
    """
    wrong = width[(width < 0.0) | (width > _LONGEST)]
    if wrong.size:
        words = f"expected full widths of bands from 0 to {_LONGEST:g} nm, but one is {wrong[0]:g}"
        raise InputError(words, column="fwhm")


def in_windows(wavelength: np.ndarray, windows: tuple[tuple[float, float], ...]) -> np.ndarray:
    """Which bands lie in one of the windows [nm], ends included."""
    inside = np.zeros(wavelength.shape, bool)
    for low, high in windows:
        inside |= (wavelength >= low) & (wavelength <= high)
    return inside


def _checked(
    values: np.ndarray,
    wavelength: np.ndarray,
    looked_at: np.ndarray,
    what: str,
    name: str,
    meta: dict,
) -> np.ndarray:
    finite = np.isfinite(values)
    if not finite.any():
        raise InputError(f"the {what} of spectrum {name!r} has no value, only NaN")
    shown = values[finite & looked_at]
    if shown.size and np.median(shown) > 1.5:
        raise InputError(
            f"the {what} of spectrum {name!r} must be a fraction of 0 to 1, but its median is "
            f"{np.median(shown):.4g}; is it in percent, or times 10000? Divide first. Counts of a "
            "detector need those of a white reference"
        )
    bright = shown[in_windows(wavelength[finite & looked_at], (_BRIGHT,))]
    if what == "reflectance" and bright.size and np.max(bright) < _DARKEST:
        raise InputError(
            f"the reflectance of spectrum {name!r} is {np.max(bright):.3g} at most from "
            f"{_BRIGHT[0]:g} to {_BRIGHT[1]:g} nm, darker than any leaf or ground; was it divided "
            "by 100 twice, or does the header say '%' of fractions?"
        )
    known = ~np.isnan(values)
    if what == "transmittance":
        slight = known & (values < _LOWEST) & (values >= _OVERCORRECTED)
        if slight.any():
            note(
                meta,
                f"{slight.sum()} bands of slightly negative transmittance (down to "
                f"{values[slight].min():.3f}) masked; was too much taken off for gaps or dark "
                "current?",
            )
            values, known = np.where(slight, np.nan, values), known & ~slight
            if not known.any():
                raise InputError(f"the transmittance of {name!r} is negative throughout")
    wrong = known & looked_at & ~((values >= _LOWEST) & (values <= _HIGHEST))
    if wrong.sum() > 0.05 * shown.size:
        low, high = float(shown.min()), float(shown.max())
        hint = "negative" if low < _LOWEST else "above one"
        raise InputError(
            f"the {what} of spectrum {name!r} must lie within 0 to 1, but runs from {low:.4g} to "
            f"{high:.4g} and is {hint} in {wrong.sum()} bands; was the white reference right?"
        )
    wrong |= known & ~(np.abs(values) <= _LARGEST_RATIO)
    if wrong.any():
        values = np.where(wrong, np.nan, values)
        note(meta, f"{wrong.sum()} impossible values of {what} set to missing")
    return values


def check_spectrum(spectrum: MeasuredSpectrum) -> MeasuredSpectrum:
    """Sort the bands and refuse what cannot be a reflectance or transmittance."""
    spectrum = spectrum.noted()
    meta = spectrum.meta
    wavelength = np.asarray(spectrum.wavelength, float)
    if not np.all(np.isfinite(wavelength)):
        raise InputError(f"spectrum {spectrum.name!r} has a band without wavelength")
    if wavelength.size < 2:
        raise InputError(
            f"spectrum {spectrum.name!r} has {wavelength.size} band; a spectrum needs two or more"
        )
    if wavelength.min() < 100.0 or wavelength.max() > 50000.0:
        raise InputError(
            f"wavelengths of spectrum {spectrum.name!r} must be in nm, 100 to 50000, but run from "
            f"{wavelength.min():g} to {wavelength.max():g}; are they in µm or wave numbers?"
        )
    order = np.argsort(wavelength, kind="stable")
    if not np.all(np.diff(wavelength) > 0):
        if np.any(np.diff(wavelength[order]) == 0):
            twice = wavelength[order][:-1][np.diff(wavelength[order]) == 0][0]
            raise InputError(
                f"the wavelength {twice:g} nm occurs twice in spectrum {spectrum.name!r}; "
                "average or remove the overlap of the detectors first"
            )
        note(meta, "bands sorted by wavelength")
    wavelength = wavelength[order]
    looked_at = (
        ~in_windows(wavelength, WATER_WINDOWS) & (wavelength >= 400.0) & (wavelength <= 2600.0)
    )
    parts: dict[str, Any] = {}
    for what in ("reflectance", "transmittance"):
        if getattr(spectrum, what) is None:
            continue
        values = np.asarray(getattr(spectrum, what), float)
        if values.shape != wavelength.shape:
            raise InputError(
                f"spectrum {spectrum.name!r} has {wavelength.size} wavelengths but {values.size} "
                f"values of {what}; is the file cut short?"
            )
        parts[what] = _checked(values[order], wavelength, looked_at, what, spectrum.name, meta)
    if not parts:
        raise InputError(f"spectrum {spectrum.name!r} has neither R nor T")
    return replace(spectrum, wavelength=wavelength, **parts)

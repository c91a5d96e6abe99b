"""ASD FieldSpec binary files, versions 6, 7 and 8.

Layout after the maker's "ASD File Format, Version 8" (Analytical Spectral Devices, 2010): a header
of 484 bytes, the spectrum, the white reference with a header of its own. Target and reference are
stored as counts whatever the data type says; reflectance is their ratio, times that of the white
panel where the file holds its calibration.
"""

import struct
from pathlib import Path
from typing import Any

import numpy as np

from fynjax._core.errors import InputError, names_file
from fynjax.app.io.spectra._record import MeasuredSpectrum, measured, note

_HEADER = 484
_TYPES = {
    0: "raw",
    1: "reflectance",
    2: "radiance",
    3: "no units",
    4: "irradiance",
    5: "quality index",
    6: "transmittance",
    7: "unknown",
    8: "absorbance",
}
_FORMATS = {0: ("<f4", 4), 1: ("<i4", 4), 2: ("<f8", 8)}
# Strings of the material report; bytes of an array's header, of a constituent's numbers.
_REPORT_STRINGS, _ARRAY, _CONSTITUENT = 20, 10, 92
_CALIBRATION, _ABSOLUTE = "<b20sihh", 0
_FLAGS = 422
"""Second of the four bytes of flags from 421 on: bits 1, 2 and 4 are saturation of the detectors in
their order, 8 and 16 alarms of the coolers of the second and third."""
_DETECTORS = ("VNIR", "SWIR 1", "SWIR 2")


def is_asd(data: bytes) -> bool:
    """Whether the content starts like an ASD binary of any version."""
    return data[:3] in (b"ASD", b"as2", b"as3", b"as4", b"as5", b"as6", b"as7", b"as8")


def _header(data: bytes) -> tuple[str, str, float, float, int]:
    """Version, type, first wavelength, step [nm] and number of bands of what is reflectance."""
    version = data[:3].decode("latin1")
    if version not in ("as6", "as7", "as8"):
        raise InputError(
            f"expected an ASD file of version 6, 7 or 8, but this is {version!r}; "
            "export it as text with the maker's software"
        )
    if len(data) < _HEADER:
        raise InputError(
            f"the file is cut short: {len(data)} bytes, the header alone has {_HEADER}"
        )
    start, step = struct.unpack_from("<ff", data, 191)
    (count,) = struct.unpack_from("<H", data, 204)
    kind = _TYPES.get(data[186], "unknown")
    if data[199] not in _FORMATS or count < 2 or not step > 0 or not 0 < start < 30000:
        raise InputError("the header is damaged: no valid band count or number format")
    needed = _HEADER + _FORMATS[data[199]][1] * count
    if len(data) < needed:
        raise InputError(
            f"the file is cut short: {count} bands need {needed} bytes, but it has {len(data)}"
        )
    if kind in ("radiance", "irradiance", "absorbance", "quality index"):
        raise InputError(
            f"the file holds {kind}, not reflectance; convert it with its white reference in the "
            "maker's software, or save as reflectance"
        )
    return version, kind, start, step, count


@names_file
def read_asd(path: str | Path, data: bytes | None = None) -> MeasuredSpectrum:
    """Read one ASD binary file as reflectance (or transmittance, if its type says so).

    **Arguments:** `path`: the file; `data`: its content, if it was read already.

    **Returns:** a `MeasuredSpectrum` with target over white reference, unchecked: outdoor spectra
    hold any number in the water bands. Reflectance is multiplied by that of the white panel if
    the file holds it (versions 7 and 8, calibration of type ABS). `meta` has the version, type,
    instrument, integration time [ms], gains, the wavelengths of the detector changes, `splices`
    [nm], and `panel`, "applied" or "unknown". Bands of a detector that the file calls saturated are
    NaN, and `saturated` names it.

    **Raises:** `InputError` for a version below 6, a file cut short, radiance or irradiance (its
    reference block need not be a white panel), a missing white reference, or one that is zero.
    """
    path = Path(path)
    data = path.read_bytes() if data is None else data
    version, kind, start, step, count = _header(data)
    dtype, size = _FORMATS[data[199]]
    target = np.frombuffer(data, dtype, count, _HEADER).astype(float)
    offset = _HEADER + size * count
    if len(data) < offset + 20:
        raise InputError("the file has no white reference, so no reflectance")
    (length,) = struct.unpack_from("<H", data, offset + 18)
    if len(data) < offset + 20 + length + size * count:
        raise InputError("the file is cut short inside its white reference")
    white = np.frombuffer(data, dtype, count, offset + 20 + length).astype(float)
    dead = ~(np.abs(white) > 0)
    if dead.mean() > 0.5:
        raise InputError(
            "the white reference is zero, so there is no reflectance; was the spectrum saved "
            "before a white reference was taken?"
        )
    splices = [float(s) for s in struct.unpack_from("<ff", data, 444)]
    last = start + step * (count - 1)
    meta: dict[str, Any] = {
        "format": f"ASD {version}",
        "type": kind,
        "instrument": int(data[431]),
        "integration_ms": int(struct.unpack_from("<I", data, 390)[0]),
        "gains": list(struct.unpack_from("<HH", data, 436)),
        "splices": [s for s in splices if start < s < last],
    }
    if kind == "raw":
        note(meta, "reflectance formed as raw target over white reference")
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        ratio = np.where(dead, np.nan, target / white)
    if dead.any():
        note(meta, f"{int(dead.sum())} bands with zero white reference set to missing")
    wavelength = start + step * np.arange(count)
    through = kind == "transmittance"
    panel = None if through else _panel(data, offset + 20 + length + size * count, count)
    if not through:
        meta["panel"] = "unknown" if panel is None else "applied"
    if panel is not None:
        ratio = ratio * panel
        note(
            meta,
            "multiplied by the white panel's own reflectance in the file, "
            f"{panel.min():.3f} to {panel.max():.3f}",
        )
    ratio = _without_saturated(wavelength, ratio, splices, data[_FLAGS], meta)
    return measured(path.stem, wavelength, ratio, meta, through)


def _without_saturated(
    wavelength: np.ndarray,
    ratio: np.ndarray,
    splices: list[float],
    flags: int,
    meta: dict[str, Any],
) -> np.ndarray:
    """The spectrum without the bands of detectors that were saturated, or not cooled."""
    place = np.searchsorted(splices, wavelength, side="left")
    flagged = [k for k in range(3) if flags >> k & 1 and (place == k).any()]
    for k in flagged:
        note(meta, f"{_DETECTORS[k]} detector saturated: its bands set to missing")
    if flagged:
        meta["saturated"] = [_DETECTORS[k] for k in flagged]
    for k in (1, 2):
        if flags >> (k + 2) & 1:
            note(meta, f"alarm of the cooling of the {_DETECTORS[k]} detector: is it noisy?")
    return np.where(np.isin(place, flagged), np.nan, ratio)


def _panel(data: bytes, offset: int, count: int) -> np.ndarray | None:
    """Reflectance of the white panel after the reference, which ends at `offset`, if it is there.

    Between lie the material report and the dependent variables, of changing length.
    """
    if data[:3] == b"as6":
        return None
    try:
        offset = _after_strings(data, offset + 2, _REPORT_STRINGS)
        (constituents,) = struct.unpack_from("<H", data, offset)
        offset += 2 + (_ARRAY if constituents else 2)
        for _ in range(constituents):
            offset = _after_strings(data, offset, 2) + _CONSTITUENT
        (variables,) = struct.unpack_from("<H", data, offset + 2)
        offset += 4
        if variables:
            offset = _after_strings(data, offset + _ARRAY, variables) + _ARRAY + 4 * variables
        else:
            offset += 4
        (series,) = struct.unpack_from("<B", data, offset)
        step = struct.calcsize(_CALIBRATION)
        kinds = [
            struct.unpack_from(_CALIBRATION, data, offset + 1 + step * i)[0] for i in range(series)
        ]
        if _ABSOLUTE not in kinds:
            return None
        offset += 1 + step * series + 8 * count * kinds.index(_ABSOLUTE)
        panel = np.frombuffer(data, "<f8", count, offset)
    except (struct.error, ValueError):  # cut short behind the spectra, which are whole
        return None
    usable = np.isfinite(panel).all() and panel.min() > 0.0 and panel.max() < 1.1
    return panel if usable else None


def _after_strings(data: bytes, offset: int, count: int) -> int:
    """Offset behind `count` strings, each with its length in front of it."""
    for _ in range(count):
        offset += 2 + int(struct.unpack_from("<H", data, offset)[0])
    return offset

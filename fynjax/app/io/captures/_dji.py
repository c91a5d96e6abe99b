"""What DJI's multispectral cameras write into a picture of one band.

By the makers' guides: P4 Multispectral Image Processing Guide v1.0 (DJI, 2020) and Mavic 3M Image
Processing Guide v1.0 (DJI, 2023). A band's signal is (I - black level) / (gain x exposure), I the
counts over the scale of 16 bits, times the vignetting polynomial; reflectance is signal x
`SensorGainAdjustment` / `Irradiance` x a factor rho_NIR, the same in all bands. The guides leave
undefined

- rho_NIR, and with it the unit of `Irradiance`: without a panel reflectance is right up to one
  factor that all bands share, and so are NDVI and other ratios of bands;
- what the light sensor's 'built-in algorithm' compensates in `Irradiance`, its tilt for one;
- whether the black level is to be subtracted before the vignetting polynomial: it is here, since
  a lens dims light and not what a covered pixel reads.
"""

import math
import re
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray
from PIL import Image

from fynjax._core.errors import InputError
from fynjax.app.io.captures._band import RawBand, Stated
from fynjax.app.io.captures._camera_place import CameraPlace, is_fix
from fynjax.app.io.captures._lens import Registration
from fynjax.sensors import CameraRadiometry, Lens

_BLACK_LEVEL = 0xC61A
"""Tag of a TIFF with the black level, where a Phantom 4 Multispectral has it."""
_TILT_SD = 1.0
"""Assumed standard deviation of a gimbal's axis from the vertical [degrees]."""
_OBLIQUE = 5.0
"""Angle from the vertical above which a gimbal was turned on purpose [degrees]."""
_FULL = 65520
"""Counts of a full pixel: those of a converter of 12 bits, times 16."""


def dji_band(path: Path, counts: NDArray[np.uint16], bits: int, stated: Stated) -> RawBand:
    """A picture of a Mavic 3 Multispectral or Phantom 4 Multispectral.

    Keys are those of its XMP metadata (namespaces drone-dji, then Camera).
    """
    black = _first(stated, "BlackCurrent", "BlackLevel")
    if black is None:
        with Image.open(path) as file:
            stored = getattr(file, "tag_v2", {}).get(_BLACK_LEVEL, [])
        black = [float(value) for value in np.ravel(stored)]
    if len(set(black)) > 1:
        words = "one black level, but got " + ", ".join(f"{value:g}" for value in black)
        raise InputError(f"expected {words}. Was a decimal comma written? Use the camera's files")
    known = {
        "black level": black[0] if black else stated.numbers("BlackCurrent", 1)[0],
        "gain": stated.numbers("SensorGain", 1)[0],
        "adjustment of gain": stated.numbers("SensorGainAdjustment", 1)[0],
        "exposure": 1e-6 * stated.numbers("ExposureTime", 1)[0],  # stated in microseconds
    }
    for name, value in known.items():
        if not value > 0.0 or (name == "black level" and value >= counts.max()):
            raise InputError(f"expected a positive {name}, below the counts, but got {value:g}")
    wavelength, fwhm = _band(stated)
    light = stated.maybe("Irradiance")
    vignetting = _vignetting(stated)
    registration = _registration(stated, counts.shape)
    lens = None if registration is None else registration.lens
    focal = _first(stated, "CalibratedFocalLength")
    pitch = _first(stated, "GimbalPitchDegree")
    tilt = abs(pitch[0] + 90.0) if pitch else 0.0
    utc = "".join(stated.xmp.get("UTCAtExposure", [])[:1])
    return RawBand(
        path=path,
        counts=counts,
        camera=CameraRadiometry(
            sensitivity=jnp.asarray(known["adjustment of gain"]),
            exposure=jnp.asarray(known["exposure"]),
            black_level=jnp.asarray(known["black level"]),
            gain=jnp.asarray(known["gain"]),
            full_scale=2.0**bits,
            vignetting_is="correction",
            **vignetting,
        ),
        saturation=_FULL if bits == 16 else 2**bits - 1,
        name=stated.text("BandName"),
        wavelength=wavelength,
        fwhm=fwhm,
        capture="".join(stated.xmp.get("CaptureUUID", [])[:1]),
        time=utc or stated.tags.get("EXIF_DateTimeOriginal", ""),  # of a DJI in local time
        utc=utc,
        focal_length=focal[0] if focal else lens.focal_length[0] if lens else None,
        irradiance=light[0] if light and light[0] > 0.0 else None,
        irradiance_tilt=stated.tilt("FlightPitchDegree", "FlightRollDegree"),
        sensor=_camera(stated, wavelength),
        absolute=False,
        registration=registration,
        missing=() if vignetting else ("vignetting",),
        place=_place(stated, tilt),
        oblique=tilt if tilt > _OBLIQUE else None,
    )


def _first(stated: Stated, *keys: str) -> list[float] | None:
    """Numbers of the first key that has some."""
    return next((found for key in keys if (found := stated.maybe(key))), None)


def _done(stated: Stated, flag: str) -> bool:
    """Whether the camera itself has already corrected the picture."""
    return stated.maybe(flag) == [1.0]


def _camera(stated: Stated, wavelength: float) -> str:
    """The sensor: a Phantom has five bands, of blue and 840 nm, and places these by a shift each,
    where a Mavic states a matrix."""
    by_shift = stated.xmp.get("RelativeOpticalCenterX") and not stated.xmp.get("CalibratedHMatrix")
    own = min(abs(wavelength - 450.0), abs(wavelength - 840.0)) < 5.0
    return "phantom_4m" if by_shift or own else "mavic_3m"


def _band(stated: Stated) -> tuple[float, float]:
    """Centre and full width at half maximum [nm]: `BandFreq` has half of it, as 560(+/-16)nm."""
    text = "".join(stated.xmp.get("BandFreq", [])[:1])
    numbers = [float(number) for number in re.findall(r"\d+(?:\.\d+)?", text)]
    if len(numbers) == 2:
        return numbers[0], 2.0 * numbers[1]
    return stated.numbers("CentralWavelength", 1)[0], stated.numbers("WavelengthFWHM", 1)[0]


def _centre(stated: Stated) -> list[float]:
    """Column and row of the designed optical axis [pixel], which must be stated."""
    return optical_centre(stated) or [
        stated.numbers(f"CalibratedOpticalCenter{axis}", 1)[0] for axis in "XY"
    ]


def optical_centre(stated: Stated) -> list[float] | None:
    """Column and row of the designed optical axis [pixel]; None where they are not stated."""
    if not stated.xmp.get("CalibratedOpticalCenterX"):
        return stated.numbers("VignettingCenter", 2) if stated.xmp.get("VignettingCenter") else None
    return [stated.numbers(f"CalibratedOpticalCenter{axis}", 1)[0] for axis in "XY"]


def _vignetting(stated: Stated) -> dict[str, Any]:
    """Arguments of `CameraRadiometry`; none where nothing is stated, or all is done."""
    if _done(stated, "VignettingFlag"):
        return {"vignetting": jnp.zeros(1)}
    keys = [key for key in ("VignettingData", "VignettingPolynomial") if stated.xmp.get(key)]
    if not keys:
        return {}
    return {
        "vignetting_centre": jnp.asarray(_centre(stated)),
        "vignetting": jnp.asarray(stated.numbers(keys[0], 6)),
    }


def _registration(stated: Stated, shape: tuple[int, ...]) -> Registration | None:
    """Distortion and homography; none where neither is stated."""
    matrix = np.eye(3)
    if stated.xmp.get("CalibratedHMatrix"):
        matrix = np.reshape(stated.numbers("CalibratedHMatrix", 9), (3, 3))
    else:  # A Phantom 4's: what is at a pixel of the NIR is at that plus this here.
        shift = [stated.maybe(f"RelativeOpticalCenter{axis}") for axis in "XY"]
        matrix[:2, 2] = [-s[0] if s else 0.0 for s in shift]
    if not abs(np.linalg.det(matrix)) > 1e-9:
        raise InputError(
            f"expected an invertible matrix as 'CalibratedHMatrix', but got {matrix.tolist()}"
        )
    lens = dji_lens(stated, shape)
    return (
        None if lens is None and np.array_equal(matrix, np.eye(3)) else Registration(matrix, lens)
    )


def dji_lens(stated: Stated, shape: tuple[int, ...]) -> Lens | None:
    """The lens by `DewarpData` (date; fx, fy, cx, cy, k1, k2, p1, p2, k3) of a picture of `shape`
    (rows, columns); None without, and where the camera itself has straightened the picture."""
    text = stated.xmp.get("DewarpData")
    if not text or _done(stated, "DewarpFlag"):
        return None
    try:
        fx, fy, cx, cy, k1, k2, p1, p2, k3 = map(float, text[0].rpartition(";")[2].split(","))
    except ValueError:
        raise InputError(
            f"expected a date and nine numbers as 'DewarpData', but got {text[0]}"
        ) from None
    x, y = _centre(stated)
    rows, columns = shape
    return Lens((columns, rows), (fx, fy), (x + cx, y + cy), (k1, k2, k3), (p1, p2))


def _place(stated: Stated, tilt: float) -> CameraPlace | None:
    latitude = _first(stated, "GpsLatitude")
    longitude = _first(stated, "GpsLongitude", "GpsLongtitude")  # a Phantom's own spelling
    heading = _first(stated, "FlightYawDegree")
    if not (latitude and longitude and heading and is_fix(latitude[0], longitude[0])):
        return None
    height = _first(stated, "RelativeAltitude")
    spread = [_first(stated, f"RtkStd{axis}") for axis in ("Lat", "Lon")]
    known = [value[0] for value in spread if value and value[0] > 0.0]
    return CameraPlace(
        latitude[0],
        longitude[0],
        heading[0],
        max(_TILT_SD, tilt),
        height[0] if height and height[0] > 0.0 else None,
        *([math.hypot(*known)] if len(known) == 2 else []),
    )

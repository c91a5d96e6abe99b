"""What a MicaSense camera writes into a picture of one band."""

from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from fynjax._core.errors import InputError
from fynjax.app.io.captures._band import RawBand, Stated
from fynjax.app.io.captures._camera_place import CameraPlace, is_fix
from fynjax.sensors import CameraRadiometry

_PER_MICROMETRE = 1e3
"""MicaSense states radiance and irradiance per nm."""
_TILT_SD = 5.0
"""Assumed standard deviation of the axis from the vertical, of a camera fixed to a drone
[degrees]."""
_OBLIQUE = 15.0
"""Angle from the vertical beyond that of a drone in flight: the camera looks aside [degrees]."""
_CONVERTER_STEP = 16
"""Counts of 16 bits are those of a converter of 12 bits, times this."""


def micasense_band(path: Path, counts: NDArray[np.uint16], bits: int, stated: Stated) -> RawBand:
    """A picture of a MicaSense RedEdge or Altum camera, firmware 2.1 or later.

    Keys are those of its XMP (namespaces MicaSense, Camera and DLS) and EXIF metadata. The light
    sensor's `HorizontalIrradiance` is preferred, which it corrected for its own tilt; older ones
    give `SpectralIrradiance` or `Irradiance` alone. Vignetting is a polynomial of the distance from
    a centre, or of a RedEdge-P or Altum-PT one of column and row.
    """
    radiometric = stated.numbers("RadiometricCalibration", 3)
    if not radiometric[0] > 0.0:
        raise InputError(
            "expected a first number above 0 as 'RadiometricCalibration', by which counts become "
            f"radiance, but got {radiometric[0]:g}. Use the camera's own files."
        )
    exposure, iso = stated.exif("ExposureTime"), stated.exif("ISOSpeed")
    if not (exposure > 0.0 and iso > 0.0):
        raise InputError(
            f"expected a positive exposure and ISO speed, but got {exposure:g} s and {iso:g}"
        )
    pitch, length = stated.maybe_exif("FocalPlaneXResolution"), stated.maybe_exif("FocalLength")
    irradiance, tilt = _irradiance(stated)
    albedo = stated.maybe("Albedo")
    lean = stated.tilt("Pitch", "Roll") or 0.0  # of the camera, straight down at zero
    return RawBand(
        path=path,
        counts=counts,
        camera=CameraRadiometry(
            sensitivity=jnp.asarray(radiometric[0] * _PER_MICROMETRE),
            exposure=jnp.asarray(exposure),
            black_level=jnp.asarray(np.mean(stated.numbers("DarkRowValue"))),
            gain=jnp.asarray(iso / 100.0),
            full_scale=2.0**bits,
            row_gradient=jnp.asarray(radiometric[1:]),
            **_vignetting(stated),
        ),
        saturation=2**bits - (_CONVERTER_STEP if bits == 16 else 1),
        name=stated.text("BandName"),
        wavelength=stated.numbers("CentralWavelength", 1)[0],
        fwhm=stated.numbers("WavelengthFWHM", 1)[0],
        capture=stated.text("CaptureId"),
        time=stated.tags.get("EXIF_DateTimeOriginal", ""),
        utc=stated.tags.get("EXIF_DateTimeOriginal", ""),
        # The resolution is per mm (unit 4 of EXIF), as the focal length is in mm.
        focal_length=None if not (pitch and length) else pitch * length,
        irradiance=irradiance,
        irradiance_tilt=tilt,
        sensor="rededge_3",
        place=_place(stated, lean),
        oblique=lean if lean > _OBLIQUE else None,
        panel_reflectance=None if albedo is None else float(albedo[0]),
        panel_area=_panel_area(stated),
    )


def _vignetting(stated: Stated) -> dict[str, Any]:
    """Arguments of `CameraRadiometry`."""
    if "VignettingPolynomial2D" not in stated.xmp:
        return {
            "vignetting_centre": jnp.asarray(stated.numbers("VignettingCenter", 2)),
            "vignetting": jnp.asarray(stated.numbers("VignettingPolynomial")),
        }
    powers = stated.numbers("VignettingPolynomial2DName")
    if not all(power in range(100) for power in powers):
        raise InputError(
            "expected powers of column and row as 'VignettingPolynomial2DName', but got "
            f"{', '.join(f'{p:g}' for p in powers)}"
        )
    pairs = tuple(zip(map(int, powers[::2]), map(int, powers[1::2])))
    numbers = stated.numbers("VignettingPolynomial2D", len(powers) // 2)
    return {"vignetting": jnp.asarray(numbers), "vignetting_powers": pairs}


def _irradiance(stated: Stated) -> tuple[float | None, float | None]:
    """Irradiance [W m-2 um-1] and the tilt it was not corrected for [degrees]."""
    level = stated.maybe("HorizontalIrradiance")
    flat = bool(level and level[0] > 0.0)
    if not flat:
        level = stated.maybe("SpectralIrradiance") or stated.maybe("Irradiance")
    if not level or level[0] <= 0.0:
        return None, None
    # Light sensors that correct for tilt state uW cm-2 nm-1 where they do not name their scale.
    assumed = 0.01 if "HorizontalIrradiance" in stated.xmp else 1.0
    scale = (stated.maybe("IrradianceScaleToSIUnits") or [assumed])[0]
    tilt = None if flat else stated.tilt("IrradiancePitch", "IrradianceRoll")
    return level[0] * scale * _PER_MICROMETRE, tilt


def _panel_area(stated: Stated) -> NDArray[Any] | None:
    numbers = stated.maybe("ReflectArea")
    if not numbers or len(numbers) < 6 or len(numbers) % 2:
        return None
    return np.asarray(numbers, dtype=np.float64).reshape(-1, 2)


def _place(stated: Stated, lean: float = 0.0) -> CameraPlace | None:
    """The camera's place by GPS; its heading is taken to be that of the light sensor."""
    degrees = stated.degrees()
    heading = stated.maybe("IrradianceYaw")
    if not degrees or not heading or not is_fix(*degrees):
        return None
    return CameraPlace(*degrees, heading[0], max(_TILT_SD, lean))

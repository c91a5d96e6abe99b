"""What a MicaSense camera writes into a picture of one band, and its counts."""

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from fynjax._core.errors import LARGEST, InputError
from fynjax.io.raster import open_raster
from fynjax.sensors import CameraRadiometry

_PER_MICROMETRE = 1e3
"""MicaSense states radiance and irradiance per nm."""
_CONVERTER_STEP = 16
"""Counts of 16 bits are those of a converter of 12 bits, times this."""

_LARGEST_EXIF = 1e7
"""Nothing is larger of what is read of the EXIF metadata: exposure, sensitivity, lengths."""


@dataclass(frozen=True)
class RedEdgeBand:
    """One file: one band of one capture."""

    path: Path
    counts: NDArray[np.uint16]
    """Counts of each pixel [-], row 0 at the top of the picture."""
    camera: CameraRadiometry
    """Numbers by which counts become radiance."""
    saturation: int
    """Counts of a full pixel."""
    name: str
    wavelength: float
    """Centre of the band [nm]."""
    fwhm: float
    """Full width of the band at half maximum [nm]."""
    capture: str
    """Identifier that all bands of one capture share."""
    time: str
    """When it was taken, as the camera has it (UTC)."""
    focal_length: float | None
    """Focal length of the lens [pixel]; `None` where the file does not say."""
    irradiance: float | None
    """Irradiance that the downwelling light sensor measured [W m-2 um-1]; `None` without one."""
    irradiance_tilt: float | None
    """Angle of the light sensor from the horizontal [degrees]; `None` where it corrected for it."""
    panel_reflectance: float | None
    """Reflectance of a panel that the camera itself found by its code [-]; else `None`."""
    panel_area: NDArray[np.float64] | None
    """Corners (x, y) of the panel that the camera found [pixel], as `panel_coverage` takes them."""

    @property
    def full(self) -> NDArray[np.bool_]:
        """Which pixels are saturated."""
        return self.counts >= self.saturation


def read_rededge_band(path: str | Path) -> RedEdgeBand:
    """Read a raw picture of a MicaSense RedEdge or Altum camera, firmware 2.1 or later.

    Keys are those of its XMP (namespaces MicaSense, Camera and DLS) and EXIF metadata. The light
    sensor's `HorizontalIrradiance` is preferred, which it corrected for its own tilt; older ones
    give `SpectralIrradiance` or `Irradiance` alone.

    **Raises:** `InputError` for a file that cannot be read, is no picture of one band in whole
    numbers, has counts beyond its bit depth, or lacks metadata, which it names.
    """
    path = Path(path)
    with open_raster(path, "a raw picture of a multispectral camera") as file:
        picture = file.dataset
        if picture.count != 1 or picture.dtypes[0] not in ("uint8", "uint16"):
            raise InputError(
                "expected a raw picture of one band in counts (16 bits), but this has "
                f"{picture.count} of {picture.dtypes[0]}. Is it a product, or a preview?",
                file=path,
            )
        counts = file.stored_band(1)
        bits = int(picture.tags(1, ns="IMAGE_STRUCTURE").get("NBITS", counts.dtype.itemsize * 8))
        stated = _Stated(
            path,
            file.xmp,
            {**picture.tags(), **picture.tags(ns="EXIF")},
        )
    if bits < 12:
        raise InputError(
            f"expected counts of 12 or 16 bits, but this has {bits}. Is it a preview?", file=path
        )
    if int(counts.max()) >= 2**bits:
        raise InputError(
            f"expected counts below 2^{bits} = {2**bits}, but some are {int(counts.max())}. Was "
            "the file rewritten by another program?",
            file=path,
        )
    radiometric = stated.numbers("RadiometricCalibration", 3)
    exposure, iso = stated.exif("ExposureTime"), stated.exif("ISOSpeed")
    if not (exposure > 0.0 and iso > 0.0):
        raise InputError(
            f"expected a positive exposure and ISO speed, but got {exposure:g} s and {iso:g}",
            file=path,
        )
    pitch, length = stated.maybe_exif("FocalPlaneXResolution"), stated.maybe_exif("FocalLength")
    irradiance, tilt = _irradiance(stated)
    albedo = stated.maybe("Albedo")
    return RedEdgeBand(
        path=path,
        counts=counts.astype(np.uint16),
        camera=CameraRadiometry(
            sensitivity=jnp.asarray(radiometric[0] * _PER_MICROMETRE),
            exposure=jnp.asarray(exposure),
            black_level=jnp.asarray(np.mean(stated.numbers("DarkRowValue"))),
            gain=jnp.asarray(iso / 100.0),
            full_scale=2.0**bits,
            row_gradient=jnp.asarray(radiometric[1:]),
            vignetting_centre=jnp.asarray(stated.numbers("VignettingCenter", 2)),
            vignetting=jnp.asarray(stated.numbers("VignettingPolynomial")),
        ),
        saturation=2**bits - (_CONVERTER_STEP if bits == 16 else 1),
        name=stated.text("BandName"),
        wavelength=stated.numbers("CentralWavelength", 1)[0],
        fwhm=stated.numbers("WavelengthFWHM", 1)[0],
        capture=stated.text("CaptureId"),
        time=stated.tags.get("EXIF_DateTimeOriginal", ""),
        # The resolution is per mm (unit 4 of EXIF), as the focal length is in mm.
        focal_length=None if not (pitch and length) else pitch * length,
        irradiance=irradiance,
        irradiance_tilt=tilt,
        panel_reflectance=None if albedo is None else float(albedo[0]),
        panel_area=_panel_area(stated),
    )


@dataclass(frozen=True)
class _Stated:
    """Metadata of a file by name, and errors for what is missing."""

    path: Path
    xmp: dict[str, list[str]]
    tags: dict[str, str]

    def text(self, key: str) -> str:
        if not self.xmp.get(key):
            if {"SensorGain", "BandFreq"} & set(self.xmp):
                raise InputError(
                    "expected a raw picture of a MicaSense camera, but this one is of a DJI, whose "
                    "raw captures are not read. Make reflectance maps of them in DJI Terra, Pix4D, "
                    "Metashape or ODM first: all commands read these",
                    file=self.path,
                )
            if key.startswith("Vignetting") and "VignettingPolynomial2D" in self.xmp:
                raise InputError(
                    "expected a vignetting polynomial in one dimension, but this camera, such as a "
                    "RedEdge-P or Altum-PT, has one in two, which is not supported. Make "
                    "reflectance maps in Pix4D, Metashape or with the maker's own library first",
                    file=self.path,
                )
            raise InputError(
                f"expected metadata (XMP) with {key!r}, but "
                + ("it has none of that name" if self.xmp else "there are none at all")
                + ". Raw pictures of a RedEdge or Altum have them from firmware 2.1 on; other "
                "programs drop them: use the camera's own files.",
                file=self.path,
            )
        return self.xmp[key][0]

    def numbers(self, key: str, count: int | None = None) -> list[float]:
        self.text(key)
        values = self.maybe(key)
        if values is None or (count is not None and len(values) != count):
            raise InputError(
                f"expected {count or 'some'} numbers as {key!r} in the metadata, but got "
                f"{', '.join(self.xmp[key])}",
                file=self.path,
            )
        return values

    def maybe(self, key: str) -> list[float] | None:
        """Numbers, if the key is there and they are numbers."""
        try:
            parts = [part for text in self.xmp.get(key, []) for part in text.split(",")]
            values = [float(part) for part in parts]
        except ValueError:
            return None
        return values if values and np.all(np.abs(values) < LARGEST) else None

    def maybe_exif(self, key: str) -> float | None:
        number = re.search(r"[-+\d.eE]+", self.tags.get(f"EXIF_{key}", ""))
        try:
            value = float(number.group()) if number else None
        except ValueError:
            return None
        return None if value is None or not abs(value) < _LARGEST_EXIF else value

    def exif(self, key: str) -> float:
        value = self.maybe_exif(key)
        if value is None:
            raise InputError(
                f"expected EXIF metadata with {key!r}, but there is none. Use the camera's own "
                "files.",
                file=self.path,
            )
        return value


def _irradiance(stated: _Stated) -> tuple[float | None, float | None]:
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
    tilt = None
    angles = [stated.maybe(f"Irradiance{name}") for name in ("Pitch", "Roll")]
    if not flat and all(angles):
        cosines = [np.cos(np.radians(angle[0])) for angle in angles if angle]
        tilt = float(np.degrees(np.arccos(np.prod(cosines))))
    return level[0] * scale * _PER_MICROMETRE, tilt


def _panel_area(stated: _Stated) -> NDArray[Any] | None:
    numbers = stated.maybe("ReflectArea")
    if not numbers or len(numbers) < 6 or len(numbers) % 2:
        return None
    return np.asarray(numbers, dtype=np.float64).reshape(-1, 2)

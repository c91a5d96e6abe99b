"""A raw picture of one band, and what its metadata state by name."""

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fynjax._core.errors import LARGEST, InputError
from fynjax.app.io.captures._camera_place import CameraPlace
from fynjax.app.io.captures._lens import Registration
from fynjax.app.io.text import stated_number
from fynjax.sensors import CameraRadiometry

_LARGEST_EXIF = 1e7
"""Nothing is larger of what is read of the EXIF metadata: exposure, sensitivity, lengths."""


@dataclass(frozen=True)
class RawBand:
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
    """Identifier that all bands of one capture share; empty where the camera writes none."""
    time: str
    """When it was taken, as the camera has it."""
    utc: str
    """Time of the exposure in UTC; empty where the camera states local time alone."""
    focal_length: float | None
    """Focal length of the lens [pixel]; `None` where the file does not say."""
    irradiance: float | None
    """Irradiance that the downwelling light sensor measured [W m-2 um-1], or in a unit of the
    maker's own (`absolute`); `None` without one."""
    irradiance_tilt: float | None
    """Angle of the light sensor from the horizontal [degrees]; `None` where it corrected for it."""
    sensor: str
    """Name of the shipped sensor whose errors of calibration are taken for this camera."""
    absolute: bool = True
    """Whether radiance and irradiance are in W m-2 (sr-1) um-1. Otherwise one factor between them,
    the same in all bands, is not defined by the maker."""
    registration: Registration | None = None
    """Place of the band's pixels in a frame that all bands share, by the maker."""
    missing: tuple[str, ...] = ()
    """Corrections of the maker's that the file has no numbers for, such as 'vignetting'."""
    place: CameraPlace | None = None
    """Where the camera was, and its heading; `None` where the file does not say."""
    oblique: float | None = None
    """Angle of the camera's axis from the vertical [degrees], where the file states one too large
    for the picture to be laid on the map as if the camera looked straight down."""
    panel_reflectance: float | None = None
    """Reflectance of a panel that the camera itself found by its code [-]; else `None`."""
    panel_area: NDArray[np.float64] | None = None
    """Corners (x, y) of the panel that the camera found [pixel], as `panel_coverage` takes them."""

    @property
    def full(self) -> NDArray[np.bool_]:
        """Which pixels are saturated."""
        return self.counts >= self.saturation


@dataclass(frozen=True)
class Stated:
    """Metadata of a file by name, and errors for what is missing."""

    xmp: dict[str, list[str]]
    tags: dict[str, str]

    def text(self, key: str) -> str:
        if not self.xmp.get(key):
            raise InputError(
                f"expected metadata (XMP) with {key!r}, but "
                + ("it has none of that name" if self.xmp else "there are none at all")
                + ". The camera writes them (a RedEdge or Altum from firmware 2.1 on) and other "
                "programs drop them: use the camera's own files."
            )
        return self.xmp[key][0]

    def numbers(self, key: str, count: int | None = None) -> list[float]:
        self.text(key)
        values = self.maybe(key)
        if values is None or (count is not None and len(values) != count):
            raise InputError(
                f"expected {count or 'some'} numbers as {key!r} in the metadata, but got "
                f"{', '.join(self.xmp[key])}"
            )
        return values

    def maybe(self, key: str) -> list[float] | None:
        """Numbers, if the key is there and they are numbers."""
        try:
            parts = [part for text in self.xmp.get(key, []) for part in text.split(",")]
            values = [stated_number(part) for part in parts]
        except ValueError:
            return None
        return values if values and np.all(np.abs(values) < LARGEST) else None

    def tilt(self, *keys: str) -> float | None:
        """Angle from the horizontal by pitch and roll under these keys [degrees]; `None` without
        both."""
        angles = [self.maybe(key) for key in keys]
        cosine = np.prod([np.cos(np.radians(angle[0])) for angle in angles if angle])
        return float(np.degrees(np.arccos(cosine))) if all(angles) else None

    def degrees(self) -> tuple[float, float] | None:
        """Latitude and longitude by EXIF [degrees]; `None` without both."""
        found = []
        for name, below in (("Latitude", "S"), ("Longitude", "W")):
            parts = re.findall(r"[\d.]+", self.tags.get(f"EXIF_GPS{name}", ""))
            if len(parts) != 3:
                return None
            size = sum(float(part) / 60**k for k, part in enumerate(parts))
            found.append(-size if self.tags.get(f"EXIF_GPS{name}Ref") == below else size)
        return found[0], found[1]

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
                "files."
            )
        return value

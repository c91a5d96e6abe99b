"""Raw pictures of a RedEdge, made from known radiance."""

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from PIL import Image

from fynjax.sensors import CameraRadiometry
from tests.helpers import radiance_to_counts

BANDS = (("Blue", 475, 20), ("Red", 668, 10), ("NIR", 840, 40))
IRRADIANCE = np.array([1300.0, 1200.0, 900.0])
"""W m-2 um-1"""
_CALIBRATION = (1.5e-4, 1.2e-7, 1.4e-6)  # W m-2 sr-1 nm-1 s, s, -
_EXPOSURE, _ISO, _DARK = 0.0002, 200, (5092, 5082, 5049, 5063)
_CENTRE, _FALLOFF = (70.2, 48.5), (-3e-5, 1e-7, -2e-7, 1e-11, -1.5e-14, 7e-18)

_XMP = """<x:xmpmeta xmlns:x="adobe:ns:meta/">
 <rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#">
  <rdf:Description rdf:about="" xmlns:MicaSense="http://micasense.com/MicaSense/1.0/">
   <MicaSense:RadiometricCalibration>{calibration}</MicaSense:RadiometricCalibration>
   <MicaSense:CaptureId>{capture}</MicaSense:CaptureId>
   <MicaSense:DarkRowValue>{dark}</MicaSense:DarkRowValue>
  </rdf:Description>
  <rdf:Description rdf:about="" xmlns:Camera="http://pix4d.com/1.0"
    Camera:BandName="{name}" Camera:CentralWavelength="{centre}">
   <Camera:WavelengthFWHM>{fwhm}</Camera:WavelengthFWHM>
   <Camera:VignettingCenter>{middle}</Camera:VignettingCenter>
   <Camera:VignettingPolynomial>{falloff}</Camera:VignettingPolynomial>
   <Camera:IrradiancePitch>-3.0</Camera:IrradiancePitch>
   <Camera:IrradianceRoll>4.0</Camera:IrradianceRoll>
   {more}
  </rdf:Description>
 </rdf:RDF>
</x:xmpmeta>"""


def _sequence(values: Sequence[float]) -> str:
    return "<rdf:Seq>" + "".join(f"<rdf:li>{v!r}</rdf:li>" for v in values) + "</rdf:Seq>"


def camera() -> CameraRadiometry:
    """How these files count light, in the units of fynjax."""
    return CameraRadiometry(
        1e3 * _CALIBRATION[0], _EXPOSURE, np.mean(_DARK), _ISO / 100.0,
        row_gradient=_CALIBRATION[1:], vignetting_centre=_CENTRE, vignetting=_FALLOFF,
    )  # fmt: skip


def write_rededge(
    folder: Path,
    name: str,
    radiance: np.ndarray,
    *,
    light: Sequence[float] | None = tuple(IRRADIANCE),
    capture: str | None = None,
    more: str = "",
    change: Callable[[str], str] = str,
    exif: bool = True,
) -> list[Path]:
    """Files of a capture of `radiance` [band, row, column] in W m-2 sr-1 um-1, rounded as the
    camera does and cut off where it is full.

    `light` is what its light sensor states [W m-2 um-1], `change` edits the metadata.
    """
    paths = []
    for k, (picture, (band, centre, fwhm)) in enumerate(zip(radiance, BANDS, strict=True), 1):
        counts = np.asarray(radiance_to_counts(picture, camera()))
        counts = np.clip(np.round(counts / 16.0) * 16, 0, 65520).astype(np.uint16)
        stated = more
        if light is not None:
            stated += f"<Camera:Irradiance>{light[k - 1] / 1e3}</Camera:Irradiance>"
        text = _XMP.format(
            calibration=_sequence(_CALIBRATION), capture=capture or f"id of {name}",
            dark=_sequence(_DARK), name=band, centre=centre, fwhm=fwhm,
            middle=_sequence(_CENTRE), falloff=_sequence(_FALLOFF), more=stated,
        )  # fmt: skip
        tags = Image.Exif()
        tags[700] = change(text).encode()
        if exif:
            tags.get_ifd(0x8769).update(
                {
                    0x829A: _EXPOSURE,
                    0x8833: _ISO,
                    0x9003: "2026:11:22 10:00:00",
                    0x920A: 5.5,
                    0xA20E: 266.667,
                }
            )
            tags[0x8769] = 0  # or the table of these is not written
        path = folder / f"{name}_{k}.tif"
        Image.fromarray(counts).save(path, exif=tags)
        paths.append(path)
    return paths


def panel_scene(
    known: Sequence[float] = (0.5,), shape: tuple[int, int] = (120, 160)
) -> tuple[np.ndarray, list[np.ndarray]]:
    """Reflectance [row, column] of dark ground with square panels, and their corners (x, y)."""
    scene = np.full(shape, 0.08)
    scene[:, ::7] = 0.11  # uneven, as ground is
    side, corners = 30, []
    for k, rho in enumerate(known):
        left, top = 65 - 45 * k, 45
        scene[top : top + side, left : left + side] = rho
        corners.append(
            np.array([[left, top], [left + side, top], [left + side, top + side],
                      [left, top + side]], float)
        )  # fmt: skip
    return scene, corners


def lit(reflectance: np.ndarray, share: float = 1.0) -> np.ndarray:
    """Radiance [band, row, column] of a reflectance, the same in all bands, in full sun."""
    return reflectance * (share * IRRADIANCE / np.pi)[:, None, None]

"""Raw pictures of DJI's multispectral cameras, made from known reflectance by the forward formula
of its Image Processing Guides, written here anew: numpy alone."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType

import numpy as np
from PIL import Image

SCALE = 13.0
"""Reflectance over signal x SensorGainAdjustment / Irradiance, which the maker leaves undefined."""
SHAPE = (120, 160)
OPTICAL_CENTRE = (83.0, 57.0)


class Band:
    """One camera, and its settings in one picture."""

    def __init__(self, name, suffix, centre, half, *, gain, exposure, adjustment, light, lens):
        self.name, self.suffix, self.centre, self.half = name, suffix, centre, half
        self.gain, self.exposure, self.adjustment, self.light = gain, exposure, adjustment, light
        self.homography, self.shift = lens


def _turned(degrees: float, right: float, down: float) -> np.ndarray:
    """A homography: turned about the optical centre, moved, and slightly in perspective."""
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    x, y = OPTICAL_CENTRE
    turn = np.array(
        [[c, -s, x - c * x + s * y + right], [s, c, y - s * x - c * y + down], [0, 0, 1]]
    )
    return turn @ np.array([[1, 0, 0], [0, 1, 0], [2e-6, -3e-6, 1.0]])


MAVIC = (
    Band("Green", "MS_G", 560, 16, gain=1.0, exposure=732, adjustment=0.83, light=16077.6,
         lens=(_turned(0.4, 5.0, -3.0), None)),
    Band("Red", "MS_R", 650, 16, gain=2.0, exposure=518, adjustment=1.21, light=13096.1,
         lens=(_turned(-0.3, -4.0, 2.0), None)),
    Band("RedEdge", "MS_RE", 730, 16, gain=1.033, exposure=976, adjustment=0.64, light=10038.8,
         lens=(_turned(0.2, 2.5, 4.5), None)),
    Band("NIR", "MS_NIR", 860, 26, gain=1.005, exposure=1200, adjustment=1.0, light=9741.7,
         lens=(np.eye(3), None)),
)  # fmt: skip
PHANTOM = tuple(
    Band(name, str(k + 1), centre, half, gain=1.0 + 0.3 * k, exposure=900 - 100 * k,
         adjustment=0.7 + 0.1 * k, light=9000.0 - 900 * k, lens=(None, shift))
    for k, (name, centre, half, shift) in enumerate(
        (("Blue", 450, 16, (4.0, -6.0)), ("Green", 560, 16, (-3.0, 2.5)),
         ("Red", 650, 16, (6.0, 3.0)), ("RedEdge", 730, 16, (-5.0, -2.0)),
         ("NIR", 840, 26, (0.0, 0.0)))
    )
)  # fmt: skip
VIGNETTING = (2.1e-4, 1.2e-5, -2.8e-8, 5.2e-10, -4.2e-12, 1.4e-14)
FOCAL, OFF_CENTRE, DISTORTION = (135.0, 134.0), (1.5, -2.0), (-0.11, 0.06, 0.03, -0.02, -0.02)


def brightening() -> np.ndarray:
    """What DJI's polynomial multiplies a pixel with [row, column]."""
    row, column = np.indices(SHAPE)
    r = np.hypot(column - OPTICAL_CENTRE[0], row - OPTICAL_CENTRE[1])
    return 1.0 + sum(k * r ** (power + 1) for power, k in enumerate(VIGNETTING))


def straight(column: np.ndarray, row: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Where a lens without distortion would have shown what this one shows at a pixel: the model
    of distortion turned round by iteration."""
    middle = np.add(OPTICAL_CENTRE, OFF_CENTRE)
    seen_x, seen_y = (column - middle[0]) / FOCAL[0], (row - middle[1]) / FOCAL[1]
    x, y = seen_x, seen_y
    k1, k2, p1, p2, k3 = DISTORTION
    for _ in range(40):
        r2 = x**2 + y**2
        radial = 1 + k1 * r2 + k2 * r2**2 + k3 * r2**3
        x = (seen_x - 2 * p1 * x * y - p2 * (r2 + 2 * x**2)) / radial
        y = (seen_y - p1 * (r2 + 2 * y**2) - 2 * p2 * x * y) / radial
    return middle[0] + FOCAL[0] * x, middle[1] + FOCAL[1] * y


def frame_place(band: Band, *, distorted: bool) -> tuple[np.ndarray, np.ndarray]:
    """Column and row, in the frame that all bands share, of each pixel [row, column] of a band."""
    row, column = np.indices(SHAPE, dtype=float)
    if distorted:
        column, row = straight(column, row)
    if band.homography is None:
        return column - band.shift[0], row - band.shift[1]
    x, y, w = np.einsum("ij,jrc->irc", band.homography, np.stack([column, row, np.ones(SHAPE)]))
    return x / w, y / w


def write_dji(
    folder: Path,
    name: str,
    reflectance: Sequence[np.ndarray],
    bands: Sequence[Band] = MAVIC,
    *,
    light: float = 1.0,
    lens: bool = False,
    black: int = 3200,
    change: Callable[[str], str] = str,
    black_in_tiff: bool = False,
    more: Mapping[str, object] = MappingProxyType({}),
) -> list[Path]:
    """Files of a capture of `reflectance` [band][row, column] on each band's own pixels, in `light`
    times the usual light. With `lens`, metadata of distortion and place are written. `more`
    is stated too, and `change` edits the metadata of every band."""
    paths = []
    for rho, band in zip(reflectance, bands, strict=True):
        signal = rho * light * band.light / (SCALE * band.adjustment)
        full_scale = signal * band.gain * band.exposure * 1e-6 / brightening()
        counts = np.clip(np.round(black + 65536.0 * full_scale), 0, 65535).astype(np.uint16)
        stated = {
            "BandName": band.name,
            "BandFreq": f"{band.centre}(+/-{band.half})nm",
            "SensorGain": band.gain,
            "ExposureTime": band.exposure,
            "SensorGainAdjustment": band.adjustment,
            "Irradiance": light * band.light,
            "CaptureUUID": f"id of {name}",
            "UTCAtExposure": "2026:11:22 10:00:00.123",
            "CalibratedOpticalCenterX": OPTICAL_CENTRE[0],
            "CalibratedOpticalCenterY": OPTICAL_CENTRE[1],
            "CalibratedFocalLength": 135.0,
            "VignettingData": ", ".join(map(str, VIGNETTING)),
            "FlightPitchDegree": "-3.0",
            "FlightRollDegree": "+4.0",
            "DewarpFlag": 0,
        }
        if not black_in_tiff:
            stated["BlackCurrent"] = black
        if lens:
            numbers = (*FOCAL, *OFF_CENTRE, *DISTORTION)
            stated["DewarpData"] = "2026-01-01;" + ",".join(map(str, numbers))
            if band.homography is None:
                stated["RelativeOpticalCenterX"], stated["RelativeOpticalCenterY"] = band.shift
            else:
                stated["CalibratedHMatrix"] = ",".join(map(str, band.homography.ravel()))
        stated |= more
        own = "\n".join(f'drone-dji:{key}="{value}"' for key, value in stated.items())
        # Other programs' names for the same are in other units, and come first.
        text = (
            '<x:xmpmeta xmlns:x="adobe:ns:meta/"><rdf:RDF '
            'xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#"><rdf:Description '
            'rdf:about="" xmlns:drone-dji="http://www.dji.com/drone-dji/1.0/" '
            'xmlns:Camera="http://pix4d.com/camera/1.0" Camera:Irradiance="0.5" '
            f"{own}/></rdf:RDF></x:xmpmeta>"
        )
        tags = Image.Exif()
        tags[700] = change(text).encode()
        if black_in_tiff:
            tags[0xC61A] = black
        joint = "" if len(band.suffix) == 1 else "_"
        path = folder / f"{name}{joint}{band.suffix}.TIF"
        Image.fromarray(counts).save(path, format="TIFF", exif=tags)
        paths.append(path)
    return paths

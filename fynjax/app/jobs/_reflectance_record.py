"""Records, sentences and warnings of a calibration to reflectance."""

from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from fynjax.app.io.captures import AlignedCapture, Capture, PanelView
from fynjax.app.io.raster import Cube
from fynjax.app.io.text import table_text
from fynjax.app.jobs._result import Number, Record
from fynjax.sensors import EmpiricalLine

RELATIVE_REFLECTANCE = (
    "reflectance by this camera's light sensor alone is right up to one factor that all bands "
    "share, since its maker leaves the sensor's unit undefined: NDVI and other ratios of bands are "
    "right, reflectance itself is not. For it, photograph a panel: --panel NAME "
    "--panel-reflectance R"
)
"""Warning of DJI's captures without a panel."""


class CapturedBand(Record):
    """A band of a capture, with its line: reflectance = gain x radiance + offset."""

    name: str
    wavelength_nm: float
    fwhm_nm: float
    gain: float
    offset: float
    gain_sd: float
    offset_sd: float
    covariance: float
    light_since_panel: float | None
    """Light over that at the time of the panel's picture [-]."""
    saturated: float
    """Share of the pixels that are saturated [-]."""
    median_reflectance: Number


class CaptureSummary(Record):
    """A capture that was converted."""

    capture: str | None
    time: str | None
    radiance_unit: str
    """Unit of the radiance that the lines of its bands take."""
    missing_corrections: list[str]
    """Corrections of the camera's maker that the files have no numbers for."""
    size: list[int]
    """Columns and rows of the converted image [pixels]."""
    pixel_m: float | None
    place_sd_m: float | None
    """Standard deviation of where the middle lies on Earth [m]; `None` where it has no place."""
    light_sensor_tilt_deg: float | None
    alignment_residual_px: float | None
    bands: list[CapturedBand]


class PanelBand(Record):
    """A panel in a band."""

    name: str
    reflectance: float
    radiance: float
    spread: float
    pixels: int
    area_px: list[list[float]]
    reflectance_by_light_sensor: float | None


class PanelSummary(Record):
    """A panel in a capture."""

    capture: str
    found: str
    bands: list[PanelBand]


def capture_summary(
    capture: Capture,
    aligned: AlignedCapture,
    line: EmpiricalLine,
    change: NDArray[np.float64] | None,
    cube: Cube,
    side: float | None,
    spread: float | None,
) -> CaptureSummary:
    """Record of a converted capture. `change` is the light over that at the panel [-], `side` the
    side of a pixel [m], `spread` the standard deviation of the capture's place [m]."""
    middle = np.nanmedian(cube.values, axis=(1, 2))
    first = capture.bands[0]
    return CaptureSummary(
        capture=first.capture or None,
        time=first.time,
        radiance_unit="W m-2 sr-1 um-1" if capture.absolute else "the camera maker's own",
        missing_corrections=sorted({name for band in capture.bands for name in band.missing}),
        size=list(cube.values.shape[:0:-1]),
        pixel_m=side,
        place_sd_m=spread,
        light_sensor_tilt_deg=first.irradiance_tilt,
        alignment_residual_px=(
            None if aligned.alignment is None else max(a.residual for a in aligned.alignment)
        ),
        bands=[
            CapturedBand(
                name=band.name,
                wavelength_nm=band.wavelength,
                fwhm_nm=band.fwhm,
                gain=float(line.gain[k]),
                offset=float(line.offset[k]),
                gain_sd=float(np.sqrt(line.covariance[k, 0, 0])),
                offset_sd=float(np.sqrt(line.covariance[k, 1, 1])),
                covariance=float(line.covariance[k, 0, 1]),
                light_since_panel=None if change is None else float(change[k]),
                saturated=float(aligned.full[k].mean()),
                median_reflectance=float(middle[k]),
            )
            for k, band in enumerate(capture.bands)
        ],
    )


def capture_sentence(name: str, summary: CaptureSummary) -> str:
    """A converted capture in a sentence."""
    values = [np.nan if b.median_reflectance is None else b.median_reflectance
              for b in summary.bands]  # fmt: skip
    bands = _by_band([b.name for b in summary.bands], values)
    width, height = summary.size
    side = f" of {summary.pixel_m:.3g} m" if summary.pixel_m else ""
    miss = summary.alignment_residual_px
    aligned = "" if miss is None else f"; bands aligned to {miss:.1f} pixels"
    placed = f", placed to {summary.place_sd_m:.1f} m" if summary.place_sd_m else ""
    return f"{name}: {width} x {height} pixels{side}{aligned}{placed}. Median reflectance {bands}."


def capture_warnings(name: str, summary: CaptureSummary, light: str) -> list[str]:
    """Warnings of a converted capture: saturated pixels, light that changed."""
    warnings = []
    worst = max(summary.bands, key=lambda band: band.saturated)
    if worst.saturated > 0.01:
        warnings.append(
            f"{name}: {100 * worst.saturated:.1f} % of {worst.name} are saturated, and have "
            "no data in the product"
        )
    changes = [b.light_since_panel for b in summary.bands if b.light_since_panel is not None]
    if light == "panel" and changes and max(abs(c - 1.0) for c in changes) > 0.1:
        warnings.append(
            f"{name}: the light sensor says that the light changed by a factor of "
            f"{min(changes):.2f} to {max(changes):.2f} since the picture of the panel (a tilted "
            "sensor says so too). Where light did change, use --light both"
        )
    return warnings


def oblique_warning(tilts: Mapping[str, float]) -> str:
    """Warning of captures by a camera that looked aside, by name its angle from the vertical
    [degrees]."""
    count = f" and {len(tilts) - 1} more" if len(tilts) > 1 else ""
    return (
        f"{next(iter(tilts))}{count}: the camera looked up to {max(tilts.values()):.0f} degrees "
        "away from straight down, by the pictures' metadata. Such a picture cannot be laid on the "
        "map by position and height alone, and stays on the pixels of its camera. By its pose it "
        "is laid on the ground of a plot: fynjax frames FLIGHT --plot PLOT --images RESULTS, where "
        "FLIGHT is the folder of the raw pictures and RESULTS that of these images"
    )


def _by_band(names: Sequence[str], values: Sequence[float] | NDArray[np.float64]) -> str:
    return ", ".join(f"{name} {value:.3g}" for name, value in zip(names, values, strict=True))


def panel_sentences(
    panels: Sequence[PanelView], known: Sequence[NDArray[np.float64]], light: str
) -> list[str]:
    """Sentences on the panels or the light sensor that the reflectance rests on."""
    if not panels:
        return ["No panel: reflectance is pi L / E by the downwelling light sensor."]
    by = {
        "panel": "the light is taken as steady since",
        "both": "changes of the light since are those of the light sensor",
        "sensor": "it is not used: reflectance is pi L / E by the light sensor",
    }[light]
    return [
        f"Panel in {panel.capture.name}, {panel.found}: reflectance "
        f"{_by_band(panel.capture.names, rho)}, "
        f"{min(panel.count)} pixels or more in each band, spread "
        f"{100 * float(np.max(panel.spread / panel.mean)):.1f} %; {by}."
        for panel, rho in zip(panels, known, strict=True)
    ]


def one_panel_sentence(panels: Sequence[PanelView], light: str, apart: NDArray[np.float64]) -> str:
    """A sentence on one panel in several pictures, between which its signal differs by the share
    `apart` in each band [-]."""
    worst = int(np.argmax(apart))
    beyond = " beyond what the light sensor says" if light == "both" else ""
    return (
        f"{len(panels)} pictures of one panel, whose mean signal is taken: between them the light "
        f"changed{beyond} by up to {100 * apart[worst]:.1f} % ({panels[0].capture.names[worst]}). "
        "Where a shadow fell on one, name the other: --panel NAME"
        + ("." if beyond else "; where light did change, use --light both.")
    )


def panel_summary(panel: PanelView, known: NDArray[np.float64]) -> PanelSummary:
    """Record of a panel; `known` is its reflectance in each band."""
    return PanelSummary(
        capture=panel.capture.name,
        found=panel.found,
        bands=[
            PanelBand(
                name=band.name,
                reflectance=float(known[k]),
                radiance=float(panel.mean[k]),
                spread=float(panel.spread[k]),
                pixels=int(panel.count[k]),
                area_px=panel.areas[k].round(1).tolist(),
                reflectance_by_light_sensor=(
                    None
                    if band.irradiance is None or not band.absolute
                    else float(np.pi * panel.mean[k] / band.irradiance)
                ),
            )
            for k, band in enumerate(panel.capture.bands)
        ],
    )


def calibration_table(captures: Mapping[str, CaptureSummary]) -> str:
    """The lines of every capture and band, as CSV."""
    columns = ("name", "wavelength_nm", "gain", "offset", "gain_sd", "offset_sd", "covariance")
    rows = [
        {"capture": name} | band.model_dump(include=set(columns))
        for name, capture in captures.items()
        for band in capture.bands
    ]
    table = pd.DataFrame(rows)[["capture", *columns]].rename(columns={"name": "band"})
    units = dict.fromkeys(capture.radiance_unit for capture in captures.values())
    head = f"# reflectance = gain x radiance [{' or '.join(units)}] + offset\n"
    return head + table_text(table)

"""What is told and kept of a calibration to reflectance."""

import csv
import io
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fynjax.io.micasense import AlignedCapture, Capture, PanelSeen
from fynjax.io.raster import Cube
from fynjax.sensors import EmpiricalLine


def told_of_capture(
    capture: Capture,
    aligned: AlignedCapture,
    line: EmpiricalLine,
    change: NDArray[np.float64] | None,
    cube: Cube,
    side: float | None,
) -> dict[str, Any]:
    """What is recorded of a converted capture; `change` is that of the light since the panel."""
    middle = np.nanmedian(cube.values, axis=(1, 2))
    return {
        "capture": capture.bands[0].capture,
        "time": capture.bands[0].time,
        "size": list(cube.values.shape[:0:-1]),
        "pixel_m": side,
        "light_sensor_tilt_deg": capture.bands[0].irradiance_tilt,
        "alignment_residual_px": (
            None if aligned.alignment is None else max(a.residual for a in aligned.alignment)
        ),
        "bands": [
            {
                "name": band.name,
                "wavelength_nm": band.wavelength,
                "fwhm_nm": band.fwhm,
                "gain": float(line.gain[k]),
                "offset": float(line.offset[k]),
                "gain_sd": float(np.sqrt(line.covariance[k, 0, 0])),
                "offset_sd": float(np.sqrt(line.covariance[k, 1, 1])),
                "covariance": float(line.covariance[k, 0, 1]),
                "light_since_panel": None if change is None else float(change[k]),
                "saturated": float(aligned.full[k].mean()),
                "median_reflectance": float(middle[k]),
            }
            for k, band in enumerate(capture.bands)
        ],
    }


def sentence_of(name: str, told: dict[str, Any]) -> str:
    names, values = zip(*((b["name"], b["median_reflectance"]) for b in told["bands"]))
    bands = _by_band(names, values)
    width, height = told["size"]
    side = f" of {told['pixel_m']:.3g} m" if told["pixel_m"] else ""
    miss = told["alignment_residual_px"]
    aligned = "" if miss is None else f"; bands aligned to {miss:.1f} pixels"
    return f"{name}: {width} x {height} pixels{side}{aligned}. Median reflectance {bands}."


def warnings_of(name: str, told: dict[str, Any], light: str) -> list[str]:
    found = []
    worst = max(told["bands"], key=lambda b: b["saturated"])
    if worst["saturated"] > 0.01:
        found.append(
            f"{name}: {100 * worst['saturated']:.1f} % of {worst['name']} are saturated, and have "
            "no data in the product"
        )
    changes = [b["light_since_panel"] for b in told["bands"] if b["light_since_panel"] is not None]
    if light == "panel" and changes and max(abs(c - 1.0) for c in changes) > 0.1:
        found.append(
            f"{name}: the light sensor says that the light changed by a factor of "
            f"{min(changes):.2f} to {max(changes):.2f} since the panel was seen (a sensor that was "
            "tilted says so too). Where light did change, use --light both"
        )
    return found


def _by_band(names: Sequence[str], values: Sequence[float] | NDArray[np.float64]) -> str:
    return ", ".join(f"{name} {value:.3g}" for name, value in zip(names, values, strict=True))


def panel_sentences(
    seen: Sequence[PanelSeen], known: Sequence[NDArray[np.float64]], light: str
) -> list[str]:
    """What the reflectance rests on."""
    if not seen:
        return ["No panel: reflectance is pi L / E by the downwelling light sensor."]
    by = {
        "panel": "the light is taken as steady since",
        "both": "changes of the light since are those of the light sensor",
        "sensor": "it is not used: reflectance is pi L / E by the light sensor",
    }[light]
    return [
        f"Panel in {one.capture.name}, {one.found}: reflectance "
        f"{_by_band(one.capture.names, rho)}, "
        f"{min(one.count)} pixels or more in each band, spread "
        f"{100 * float(np.max(one.spread / one.mean)):.1f} %; {by}."
        for one, rho in zip(seen, known, strict=True)
    ]


def told_of_panel(one: PanelSeen, known: NDArray[np.float64]) -> dict[str, Any]:
    return {
        "capture": one.capture.name,
        "found": one.found,
        "bands": [
            {
                "name": band.name,
                "reflectance": float(known[k]),
                "radiance": float(one.mean[k]),
                "spread": float(one.spread[k]),
                "pixels": one.count[k],
                "area_px": one.areas[k].round(1).tolist(),
                "reflectance_by_light_sensor": (
                    None
                    if band.irradiance is None
                    else float(np.pi * one.mean[k] / band.irradiance)
                ),
            }
            for k, band in enumerate(one.capture.bands)
        ],
    }


def calibration_table(record: dict[str, Any]) -> str:
    columns = ("name", "wavelength_nm", "gain", "offset", "gain_sd", "offset_sd", "covariance")
    text = io.StringIO()
    text.write("# reflectance = gain x radiance [W m-2 sr-1 um-1] + offset\n")
    table = csv.writer(text, lineterminator="\n")
    table.writerow(["capture", "band", *columns[1:]])
    for name, told in record.items():
        for band in told["bands"]:
            table.writerow([name, *(band[c] for c in columns)])
    return text.getvalue()

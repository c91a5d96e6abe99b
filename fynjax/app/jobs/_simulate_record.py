"""Record and warnings of a simulated image."""

import dataclasses
from importlib.metadata import version
from typing import Any

import numpy as np

from fynjax.app.io.plot import AtmosphereTable, Plot
from fynjax.scene import AimedSensor, Observation, PlotAir
from fynjax.sensors import OrthographicCamera, Sensor, frame_of


def run_record(
    plot: Plot,
    instrument: Sensor,
    aimed: AimedSensor,
    air: AtmosphereTable,
    noisy: bool,
    observation: Observation,
    seconds: dict[str, float],
) -> dict[str, Any]:
    """Versions, settings and times of a simulation, for `run.json`."""
    camera, accuracy = aimed.sensor.camera, aimed.accuracy
    frame, angles = frame_of(camera), {}
    optics = instrument.ground_sample_distance(aimed.sensor_height)
    if frame is not None:
        angles = {"tilt_deg": frame.tilt, "heading_deg": frame.heading}
    elif isinstance(camera, OrthographicCamera):
        angles = {"view_zenith_deg": camera.view_zenith, "view_azimuth_deg": camera.view_azimuth}
    solves = accuracy.solves
    of_air: dict[str, Any] = {
        "model": air.source,
        "file": None if air.file is None else air.file.name,
    }
    if air.source not in ("file", "none"):
        of_air |= {
            "water_vapour_cm": air.water_vapour_cm,
            "aerosol_optical_depth_550": air.aerosol_optical_depth,
            "aerosol_optical_depth_500_of_sky": plot.sky.aerosol_optical_depth,
            "ozone_cm_atm": air.ozone_cm_atm,
            "pressure_hpa": air.pressure_hpa,
        }
    return {
        "versions": {n: version(n) for n in ("jax", "equinox", "numpy", "rasterio", "xarray")},
        "plot": {
            "name": plot.name,
            "size_m": list(plot.size_m),
            "voxel_m": plot.voxel_m,
            "structure_m": plot.structure_m,
            "boundary": plot.boundary,
            "sun_zenith_deg": plot.sun.zenith,
            "sun_azimuth_deg": plot.sun.azimuth,
            "solar_factor": plot.sun.solar_factor,
        },
        "sensor": {
            "name": instrument.name,
            "source": instrument.source,
            "kind": type(camera).__name__,
            "bands": len(instrument.bands),
            "bands_simulated": len(aimed.sensor.bands),
            "altitude_m": float(aimed.sensor_height),
            "pixel_m": aimed.pixel,
            "pixel_of_the_optics_m": float(optics),
            "rows_columns": list(aimed.shape),
            "south_west_corner_from_that_of_the_plot_m": list(aimed.origin),
            **{k: float(v) for k, v in angles.items()},
            "point_spread": aimed.sensor.psf is not None,
            "noise": bool(noisy),
            "pixels_averaged_in_noise": float(aimed.averaged),
            "reflectance_by": "the known air" if aimed.panels is None else "panels",
        },
        "atmosphere": of_air,
        "accuracy": {
            **{f.name: getattr(accuracy, f.name) for f in dataclasses.fields(accuracy)},
            "bands_reduced_to_few_solves": solves is not None and len(aimed.sensor.bands) > solves,
            "largest_residual": float(np.max(observation.residual)),
            "precision": observation.reflectance.dtype.name,
        },
        "timings_s": dict(seconds),
    }


def warnings_of(plot: Plot, aimed: AimedSensor, instrument: Sensor) -> list[str]:
    """Warnings of a simulated image: of panels, bands, pixels and air that are not as asked."""
    said = []
    if plot.sensor.panels and aimed.panels is None:
        said.append(f"the plot file's panels are those of {plot.sensor.name}, and left out here")
    if aimed.panels is not None and len(aimed.panels.coverage) == 1:
        said.append(
            "one panel cannot separate the light scattered by the air; reflectance_sd allows for it"
        )
    every = zip(instrument.bands.names, instrument.bands.centre, strict=True)
    there = aimed.sensor.bands.names
    lost = [f"{name} ({centre:.5g} nm)" for name, centre in every if name not in there]
    if lost:
        named = ", ".join(lost if len(lost) <= 4 else [*lost[:3], "...", lost[-1]])
        said.append(
            f"{len(lost)} of {len(instrument.bands)} bands of {instrument.name} reach beyond the "
            f"spectra of leaves and ground, 400 to 2500 nm, and hold no data: {named}"
        )
    sizes = aimed.sensor.band_pixel
    if sizes is not None and len(set(sizes)) > 1:
        said.append(
            f"bands of {aimed.sensor.name} have pixels of {min(sizes):g} to {max(sizes):g} m in "
            f"its products; here all have {aimed.pixel:g} m"
        )
    slant = 1.0 / float(np.min(aimed.rays.cosine))
    if isinstance(aimed.air, PlotAir) and slant >= 1.05:
        said.append(
            f"the air is that of a view straight down, but lines of sight are up to {slant:.2f} "
            "times as long: their radiance lacks the difference (give curves of your own for that "
            "view)"
        )
    return said

"""A LiDAR over a plot: point cloud, waveforms, pictures."""

import dataclasses
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import numpy as np
import pandas as pd
import xarray as xr

from fynjax._core.errors import InputError
from fynjax._core.extras import require
from fynjax._core.progress import Progress
from fynjax.assembly import build_plot, cover_spectra, soil_spectra
from fynjax.compare import Heights, compare_heights, lowest_ground
from fynjax.io.instruments import write_cloud
from fynjax.io.plot import Plot, plot_place
from fynjax.io.raster import provenance, write_run
from fynjax.io.text import write_text
from fynjax.jobs._calibrate import _Clock, peak_memory_mib
from fynjax.radiation import VoxelScene
from fynjax.report.figures import height_profiles, save_figure, side_view
from fynjax.report.pages import Page
from fynjax.scene import Camera, PlotModel, band_wavelengths, hard_model
from fynjax.sensors import (
    Lidar,
    LidarBeams,
    LidarReturns,
    Waveforms,
    detect_returns,
    lidar_waveforms,
    received_electrons,
)
from fynjax.sensors.lidar import GROUND


def simulate_lidar(
    plot: Plot,
    lidar: Lidar,
    folder: Path,
    *,
    seed: int,
    noise: bool,
    files: Sequence[Path],
    progress: Progress,
) -> dict[str, Any]:
    """Fly a LiDAR over a plot's hard scene; cloud, waveforms and pictures into `folder`.

    **Arguments:**

    - `seed`: of plants, pulses, the leaves they hit and noise.
    - `noise`: whether the receiver is noisy. Which leaf a pencil of light hits is drawn always.
    - `files`: the LiDAR's own file, for the provenance record.

    The optics are those of the plot's leaves, wood and ground at the laser's wavelength. Single
    scattering, see `lidar_waveforms`.

    **Returns:** the summary: headline, files, densities and percentiles, times [s], memory [MiB].

    **Raises:** `InputError` as `build_plot` and `Lidar.beams`, and where no pulse has a return;
    `MissingExtraError` without laspy and lazrs.
    """
    for package in ("laspy", "lazrs"):
        require(package, "terrain")
    seconds: dict[str, float] = {}
    began = time.perf_counter()
    with progress.stage("Build the plot"), _Clock(seconds, "build"):
        model, parameters = build_plot(plot, seed=seed)
        model = laser_model(plot, hard_model(model, parameters), lidar)
        scene = eqx.filter_jit(lambda m, p: m.scene(p))(model, parameters)
        jax.block_until_ready(scene)
    ground = 0.0 if model.terrain is None else float(np.mean(model.terrain))
    beams = lidar.beams(plot.size_m, top=scene.height, ground=ground, seed=seed)
    leaves, counting = jax.random.split(jax.random.key(seed))
    sublayers = _sublayers(beams, scene.vertical / scene.horizontal)
    with progress.stage("Trace the pulses"), _Clock(seconds, "waveforms"):
        echoes = lidar_waveforms(scene, lidar, beams, key=leaves, sublayers=sublayers)
        electrons = received_electrons(lidar, beams, echoes.total, key=counting if noise else None)
        jax.block_until_ready(electrons)
    with progress.stage("Find the returns"), _Clock(seconds, "returns"):
        returns = detect_returns(lidar, beams, np.asarray(electrons), echoes)
    if len(returns) == 0:
        raise InputError(
            f"no pulse of {lidar.name!r} has a return: does its range gate hold the ground, "
            f"{lidar.geometry.altitude:g} m below, and is the signal above the noise?",
            file=plot.file,
        )
    with progress.stage("Compare with what was planted"), _Clock(seconds, "profile"):
        compared = compare_heights(model, parameters, scene, beams, returns, sublayers=sublayers)
    record = provenance(seed=seed, inputs=[*plot.inputs, *files])
    record["lidar"] = lidar.name
    record["noise"] = "drawn" if noise else "none"
    summary = _summary(plot, lidar, beams, returns, compared)
    summary["warnings"] = _warnings(lidar, scene, beams, echoes)
    with progress.stage("Write"), _Clock(seconds, "write"):
        place = plot_place(plot)
        lowest = 0.0 if plot.terrain is None or place.crs is None else lowest_ground(plot)
        cloud, origin = folder / "cloud.laz", (*place.origin_m, lowest)
        write_cloud(cloud, returns, origin_m=origin, crs=place.crs, attributes=record)
        dataset = waveform_dataset(lidar, beams, np.asarray(electrons), echoes)
        write_run(folder / "waveforms.nc", dataset, record)
        write_text(folder / "heights.csv", compared.table().to_csv(index=False))
    with progress.stage("Draw"), _Clock(seconds, "figures"):
        title = f"{plot.name}, {lidar.name}"
        side = side_view(returns, compared.height, plot.size_m, title=title)
        save_figure(side, folder / "cloud.png")
        save_figure(height_profiles(compared), folder / "profile.png")
    seconds["total"] = time.perf_counter() - began
    _page(folder, plot, lidar, summary, compared, seconds, record)
    files = {
        "cloud.laz": "point cloud, LAS 1.4",
        "waveforms.nc": "waveform of every pulse, NetCDF",
        "heights.csv": "percentiles of height of returns and of planted area",
        "cloud.png": "the cloud from the side and from above",
        "profile.png": "returns and planted area against height",
        "report.html": "all of it on one page",
    }
    return {
        **summary,
        "files": files,
        "seed": seed,
        "timings_s": seconds,
        "peak_memory_mib": peak_memory_mib(),
    }


def laser_model(plot: Plot, model: PlotModel, lidar: Lidar) -> PlotModel:
    """The same plot with the optics of its ground and leaves in the laser's line."""
    bands = lidar.bands
    wavelength = band_wavelengths(bands)
    return dataclasses.replace(
        model,
        camera=Camera(bands, lidar.geometry.altitude, 1.0),
        soil=soil_spectra(plot, wavelength),
        covers=cover_spectra(plot, wavelength),
        diffuse=np.zeros(len(wavelength)),  # no sky: the laser is the light
    )


def waveform_dataset(
    lidar: Lidar, beams: LidarBeams, electrons: np.ndarray, echoes: Waveforms
) -> xr.Dataset:
    """What was recorded of each pulse, and the noise-free return of its ground."""

    def each(values: np.ndarray, name: str, units: str) -> tuple[str, np.ndarray, dict[str, str]]:
        return "pulse", values, {"long_name": name, "units": units}

    axes = zip("xyz", ("east", "north", "up"))
    where: dict[str, Any] = {}
    for k, (letter, name) in enumerate(axes):
        where[f"origin_{letter}"] = each(
            beams.origin[:, k], f"place of the sensor, {name} of the south-west bottom corner", "m"
        )
        where[f"direction_{letter}"] = each(
            beams.direction[:, k], f"direction of the pulse, {name}", "1"
        )
    recorded = {"long_name": "electrons counted, mean background taken off", "units": "1"}
    ground = {"long_name": "apparent reflectance of the ground in the sample", "units": "1"}
    samples = (np.arange(beams.samples) + 0.5) * lidar.sample
    return xr.Dataset(
        {
            "waveform": (("pulse", "sample"), electrons.astype(np.float32), recorded),
            "ground_waveform": (
                ("pulse", "sample"),
                np.asarray(echoes.ground, np.float32),
                ground,
            ),
            **where,
            "first_range": each(beams.start, "range at which the first sample begins", "m"),
            "irradiance": each(
                beams.irradiance, "of the pulse, relative to the beam's middle", "1"
            ),
            "scan_angle": each(beams.scan_angle, "angle from straight down", "degree"),
            "time": each(beams.time, "time of the pulse since the start of the flight", "s"),
        },
        coords={
            "pulse": each(np.arange(len(beams)), "index of the pulse", "1"),
            "sample": (
                "sample",
                samples,
                {"long_name": "range of the sample's middle beyond first_range", "units": "m"},
            ),
        },
        attrs={
            "title": f"waveforms of {lidar.name}",
            "wavelength_nm": lidar.wavelength,
            "pulse_fwhm_ns": lidar.pulse_length,
            "sample_m": lidar.sample,
            "comment": "single scattering",
        },
    )


def _sublayers(beams: LidarBeams, shape: float) -> int:
    """Steps in a layer, so that a pulse moves by at most half a voxel in each."""
    slant = np.abs(beams.direction[:, 2]).min()
    run = float(np.sqrt(1.0 - slant**2) / slant)
    return max(int(np.ceil(2.0 * run * shape)), 1)


def _warnings(lidar: Lidar, scene: VoxelScene, beams: LidarBeams, echoes: Waveforms) -> list[str]:
    """What the range gate cut off."""
    if lidar.gate is None:
        return []
    low = 0.0 if scene.terrain is None else float(np.min(np.asarray(scene.terrain)))
    deep = (beams.origin[:, 2] - low) / np.abs(beams.direction[:, 2]) + 2.0 * lidar.pulse_sd
    high = (beams.origin[:, 2] - scene.height) / np.abs(beams.direction[:, 2])
    lost = []
    if (share := float(np.mean(deep > lidar.gate[1]))) > 0:
        lost.append(f"{100 * share:.0f} % of the pulses may end below the range gate")
    if (share := float(np.mean(high < lidar.gate[0]))) > 0:
        lost.append(f"{100 * share:.0f} % of the pulses may begin above the range gate")
    return [f"{text}, {lidar.gate[0]:g} to {lidar.gate[1]:g} m" for text in lost]


def _summary(
    plot: Plot,
    lidar: Lidar,
    beams: LidarBeams,
    returns: LidarReturns,
    compared: Heights,
) -> dict[str, Any]:
    area = float(np.prod(plot.size_m))
    ground = int(np.sum(returns.classification == GROUND))
    density, pulses = len(returns) / area, len(beams) / area
    seen = len(np.unique(returns.beam)) / len(beams)
    headline = [
        f"{plot.name}, {lidar.name}: {len(returns)} returns, {density:.1f} per m² of "
        f"{pulses:.1f} pulses per m²; {100 * seen:.1f} % of the pulses have a return.",
        f"{100 * ground / len(returns):.1f} % of the returns are ground.",
    ]
    if (rmse := compared.rmse) is not None:
        off = ", ".join(f"{value:.3f} m off those of {name}" for name, value in rmse.items())
        headline.append(f"Percentiles of height of the vegetation returns are {off} (rmse).")
    return {
        "headline": headline,
        "returns": len(returns),
        "returns_per_m2": density,
        "pulses_per_m2": pulses,
        "share_of_pulses_with_returns": seen,
        "ground_returns": ground,
        "percentile_rmse_m": compared.rmse,
    }


def _page(
    folder: Path,
    plot: Plot,
    lidar: Lidar,
    summary: dict[str, Any],
    compared: Heights,
    seconds: dict[str, float],
    record: Any,
) -> None:
    page = Page(f"LiDAR: {plot.name}", summary["headline"][0])
    page.key_figures(
        {
            "returns per m²": f"{summary['returns_per_m2']:.1f}",
            "pulses per m²": f"{summary['pulses_per_m2']:.1f}",
            "ground": f"{100 * summary['ground_returns'] / summary['returns']:.1f} %",
        }
    )
    page.paragraph(" ".join([*summary["headline"][1:], *summary["warnings"]]))
    page.figure(folder / "cloud.png", "The cloud from the south, and from above.")
    page.figure(
        folder / "profile.png",
        "Vegetation returns against height, beside where the light first meets plants (the gap "
        "law) and where their area is. Higher plants hide lower ones, so the second lies above "
        "the third.",
    )
    page.table(compared.table(), caption="Percentiles of height above ground.", folded=True)
    page.paragraph(
        f"{lidar.source} Single scattering: light that leaves send on and back more than once is "
        "left out."
    )
    page.table(
        pd.DataFrame({"what": list(seconds), "seconds": list(seconds.values())}),
        caption="Wall time.",
        folded=True,
    )
    page.footer(record)
    page.write(folder / "report.html")

"""The job of `fynjax simulate` with a LiDAR: point cloud, waveforms, pictures."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np
import pandas as pd

from fynjax._core.dry_run import begin_work
from fynjax._core.errors import InputError
from fynjax._core.extras import require
from fynjax.app.assembly import build_plot, check_memory, ground_heights
from fynjax.app.compare import Heights, compare_heights
from fynjax.app.io.instruments import write_cloud
from fynjax.app.io.plot import Plot, plot_place
from fynjax.app.io.raster import write_run
from fynjax.app.jobs._result import JobResult, Number
from fynjax.app.jobs._run import Run
from fynjax.app.report import figures
from fynjax.app.report.pages import Page, Part, Picture, Section, Table
from fynjax.radiation import VoxelScene
from fynjax.scene import LidarObservation, ReturnTruth, hard_scene, observe
from fynjax.sensors import FlashGeometry, Lidar, LidarBeams, LidarReturns
from fynjax.sensors.lidar import GROUND

_SEEN_M = 1.0
"""Height above the ground at which the gap between frames is stated [m]."""


class SimulateLidarResult(JobResult):
    """What `simulate` measured with a LiDAR."""

    command: Literal["simulate"] = "simulate"
    returns: int
    returns_per_m2: float
    pulses_per_m2: float
    share_of_pulses_with_returns: float
    ground_returns: int
    percentile_rmse_m: dict[str, Number] | None
    """RMS difference of percentiles of height of the returns from those of the plants [m]."""


def simulate_lidar(
    run: Run, plot: Plot, lidar: Lidar, *, noise: bool, files: Sequence[Path]
) -> SimulateLidarResult:
    """Simulate a LiDAR over a plot; write cloud, waveforms and pictures.

    **Arguments:**

    - `run`, whose seed is that of plants, pulses, the leaves they hit and noise.
    - `noise`: whether the receiver is noisy. Which leaf a pencil of light hits is drawn always.
    - `files`: the LiDAR's own file, for the provenance record.

    The optics are those of the plot's leaves, wood and ground at the laser's wavelength. Which
    light comes back, see `lidar_waveforms`.

    **Raises:** `InputError` as `build_plot` and `Lidar.beams`, and where no pulse has a return;
    `MissingExtraError` without laspy and lazrs.
    """
    for package in ("laspy", "lazrs"):
        require(package, "terrain")
    check_memory(plot, listed=True)
    with run.stage("Build the plot", "build"):
        scene, parameters = build_plot(plot, seed=run.seed)
        extent, level = scene.grid.extent, scene.ground_level
        pulses = len(lidar.beams(extent[:2], top=extent[2], ground=level, seed=run.seed))
    begin_work(
        {"cloud.laz": "", "cloud_species.csv": f"{len(scene.taxa)} species", "truth.nc": "",
         "waveforms.nc": f"{pulses} pulses", "report.html": ""}
    )  # fmt: skip
    with run.stage("Send the pulses", "observe"):
        scene = hard_scene(scene, parameters)
        observation = observe(scene, lidar, parameters=parameters, noise=noise, seed=run.seed)
    voxels, beams, returns = observation.voxels, observation.beams, observation.returns
    if not returns:
        raise InputError(
            f"no pulse of {lidar.name!r} has a return: does its range gate hold the ground, "
            f"{lidar.geometry.altitude:g} m below, and is the signal above the noise?",
            file=plot.file,
        )
    with run.stage("Find the species of the returns", "truth"):
        truth = observation.truth()
    with run.stage("Compare with what was planted", "profile"):
        heights = compare_heights(
            scene, parameters, voxels, beams, returns, sublayers=observation.sublayers
        )
    record = run.record([*plot.inputs, *files])
    record["lidar"] = lidar.name
    record["noise"] = "drawn" if noise else "none"
    with run.stage("Write", "write"):
        species = _write(run, plot, observation, truth, heights, record)
    counts = _counts(plot, beams, returns)
    headline = [*_headline(plot, lidar, counts, heights), *_seams(plot, lidar)]
    warnings = _warnings(lidar, voxels, beams)
    with run.stage("Draw", "figures"):
        run.total()
        remarks = [*headline[1:], *warnings]
        sections = _sections(run, plot, lidar, returns, heights, species, remarks)
        keys = {
            "returns per m²": f"{counts['returns_per_m2']:.1f}",
            "pulses per m²": f"{counts['pulses_per_m2']:.1f}",
            "ground": f"{100 * counts['ground_returns'] / counts['returns']:.1f} %",
        }
        page = Page("simulate lidar", f"LiDAR: {plot.name}", headline[0], sections, keys, record)
        held = "" if heights.rmse is None else headline[2]
        run.page(replace(page, trust=held))
    return run.result(
        SimulateLidarResult,
        headline=headline,
        warnings=warnings,
        percentile_rmse_m=heights.rmse,
        **counts,
    )


def _write(
    run: Run,
    plot: Plot,
    observation: LidarObservation,
    truth: ReturnTruth,
    heights: Heights,
    record: dict[str, str | int],
) -> pd.DataFrame:
    """Write the cloud, the waveforms and their truth, and give the table of species."""
    assert observation.returns is not None
    place, ground = plot_place(plot), ground_heights(plot)
    lowest = 0.0 if ground is None or place.crs is None else float(ground.min())
    write_cloud(
        run.path("cloud.laz", "point cloud, LAS 1.4"),
        observation.returns,
        origin_m=(*place.origin_m, lowest),
        crs=place.crs,
        attributes=record,
        leading=truth.leading(),
    )
    waveforms = run.path("waveforms.nc", "waveform of every pulse, NetCDF")
    write_run(waveforms, observation.to_xarray(), record)
    what = "share of each species in each return, NetCDF"
    write_run(run.path("truth.nc", what), truth.to_xarray(), record)
    leading, _ = truth.leading()
    names = ("ground or none", *truth.taxa)
    count = np.bincount(leading + 1, minlength=len(names))
    species = pd.DataFrame({"species": range(len(names)), "taxon": names, "returns": count})
    run.table("cloud_species.csv", species, "number of each species in cloud.laz", None)
    what = "percentiles of height of returns and of planted area"
    run.table("heights.csv", heights.table(), what, None)
    return species


def _warnings(lidar: Lidar, voxels: VoxelScene, beams: LidarBeams) -> list[str]:
    """Warnings of pulses that the range gate may cut off."""
    if lidar.gate is None:
        return []
    low = 0.0 if voxels.terrain is None else float(np.min(np.asarray(voxels.terrain)))
    deep = (beams.origin[:, 2] - low) / np.abs(beams.direction[:, 2]) + 2.0 * lidar.pulse_sd
    high = (beams.origin[:, 2] - voxels.height) / np.abs(beams.direction[:, 2])
    lost = []
    if (share := float(np.mean(deep > lidar.gate[1]))) > 0:
        lost.append(f"{100 * share:.0f} % of the pulses may end below the range gate")
    if (share := float(np.mean(high < lidar.gate[0]))) > 0:
        lost.append(f"{100 * share:.0f} % of the pulses may begin above the range gate")
    return [f"{text}, {lidar.gate[0]:g} to {lidar.gate[1]:g} m" for text in lost]


def _seams(plot: Plot, lidar: Lidar) -> list[str]:
    """Where the frames of a flash camera leave slits in the cloud: they are pyramids, and meet at
    the ground at best."""
    at = lidar.geometry
    if not isinstance(at, FlashGeometry) or max(plot.size_m) <= at.frame_step * (1 + 1e-6):
        return []
    pixel = 1e-3 * at.pixel_pitch_um / at.focal_length_mm
    strips = [at.frame_step - pixel * count * (at.altitude - _SEEN_M) for count in at.array]
    if max(strips) <= 0:
        return []
    return [
        f"Frames stand {at.frame_step:g} m apart and narrow upward: between two of them a strip of "
        f"{max(strips):.2f} m of what is {_SEEN_M:g} m high is not seen, so the cloud has slits."
    ]


def _counts(plot: Plot, beams: LidarBeams, returns: LidarReturns) -> dict[str, float]:
    """Numbers of returns and pulses, by their names in the result."""
    area = float(np.prod(plot.size_m))
    return {
        "returns": len(returns),
        "returns_per_m2": len(returns) / area,
        "pulses_per_m2": len(beams) / area,
        "share_of_pulses_with_returns": len(np.unique(returns.beam)) / len(beams),
        "ground_returns": int(np.sum(returns.classification == GROUND)),
    }


def _headline(plot: Plot, lidar: Lidar, counts: dict[str, float], heights: Heights) -> list[str]:
    lines = [
        f"{plot.name}, {lidar.name}: {counts['returns']} returns, {counts['returns_per_m2']:.1f} "
        f"per m² of {counts['pulses_per_m2']:.1f} pulses per m²; "
        f"{100 * counts['share_of_pulses_with_returns']:.1f} % of the pulses have a return.",
        f"{100 * counts['ground_returns'] / counts['returns']:.1f} % of the returns are ground.",
    ]
    if heights.rmse is not None:
        off = ", ".join(f"{value:.3f} m off those of {n}" for n, value in heights.rmse.items())
        lines.append(f"Percentiles of height of the vegetation returns are {off} (rmse).")
    return lines


def _sections(run: Run, plot: Plot, lidar: Lidar, returns: LidarReturns, heights: Heights,
              species: pd.DataFrame, remarks: list[str]) -> list[Section]:  # fmt: skip
    title = f"{plot.name}, {lidar.name}"
    late = "has left the narrow beam and is left out."
    if isinstance(lidar.geometry, FlashGeometry):
        late = "comes late; it is part of the waveforms."
    parts: list[Part] = [
        " ".join(remarks),
        Picture(
            "cloud.png",
            figures.side_view(returns, heights.height, plot.size_m, title=title),
            "the cloud from the side and from above",
            "The cloud from the south, and from above.",
        ),
        Picture(
            "profile.png",
            figures.height_profiles(heights),
            "returns and planted area against height",
            "Vegetation returns against height, beside where the light first meets plants (the "
            "gap law) and where their area is. Higher plants hide lower ones, so the second lies "
            "above the third.",
        ),
        Table(heights.table(), "Percentiles of height above ground.", folded=True),
        Table(species, "Species that most of a return's light comes from.", folded=True),
        f"{lidar.source} Light that is scattered more than once {late}",
        run.times(folded=True),
    ]
    return [Section("", parts)]

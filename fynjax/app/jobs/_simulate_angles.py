"""The job of `fynjax simulate --angles`: how bright a plot is from every direction."""

from collections.abc import Sequence
from pathlib import Path
from typing import Literal, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
import xarray as xr
from jaxtyping import Float

from fynjax._core.dry_run import begin_work
from fynjax._core.errors import InputError
from fynjax.app.assembly import build_plot
from fynjax.app.io.plot import Plot
from fynjax.app.io.raster import write_run
from fynjax.app.jobs._result import JobResult
from fynjax.app.jobs._run import Run
from fynjax.app.report import figures
from fynjax.app.report.pages import Page, Picture, Section, Table
from fynjax.radiation import Accuracy, Light, VoxelScene, directional_reflectance, solve_light
from fynjax.scene import PlotParameters, Scene, hard_scene, visible_sensor
from fynjax.sensors import BandSet, Sensor

ZENITHS = np.arange(0.0, 76.0, 7.5)
"""Zenith angles of the views [degrees]."""
AZIMUTHS = np.arange(0.0, 360.0, 15.0)
"""Azimuths of the views, clockwise from that of the sun [degrees]."""
PLANE = np.arange(-75.0, 76.0, 2.5)
"""Angles of the views in the plane of the sun [degrees]; on the sun's side above 0."""
_BANDS = ("red", "nir")
_SHOWN = 6


class SimulateAnglesResult(JobResult):
    """What `simulate --angles` found."""

    command: Literal["simulate"] = "simulate"
    bands: int
    views: int
    nadir: dict[str, float]
    """Reflectance factor from above, by band [-]."""
    towards_sun: dict[str, float]
    """Reflectance factor from where the sun is, by band [-]."""
    albedo: dict[str, float]
    """Share of the sun's light that leaves upward, by band [-]."""


class AngularReflectance(NamedTuple):
    """Bidirectional reflectance factor of a scene under its sun alone."""

    hemisphere: Float[np.ndarray, "band zenith azimuth"]
    """At `ZENITHS` and `AZIMUTHS` from the sun's [-]."""
    plane: Float[np.ndarray, "band angle"]
    """At `angles` [-]."""
    angles: Float[np.ndarray, " angle"]
    """`PLANE` and the sun's own zenith angle [degrees]."""

    def at(self, angle: float) -> Float[np.ndarray, " band"]:
        """In the plane of the sun, at the view nearest to an angle [degrees] [-]."""
        return self.plane[:, int(np.argmin(np.abs(self.angles - angle)))]

    @property
    def albedo(self) -> Float[np.ndarray, " band"]:
        """Share of the sun's light that leaves upward, the mean of the views weighted by their
        cosine [-]; beyond the lowest view as bright as there."""
        edge = np.linspace(0.0, 0.5 * np.pi, 2001)
        middle = 0.5 * (edge[1:] + edge[:-1])
        weight = np.diff(np.sin(edge) ** 2)
        ring = self.hemisphere.mean(axis=2)
        return np.array([weight @ np.interp(middle, np.deg2rad(ZENITHS), one) for one in ring])


def angular_reflectance(voxels: VoxelScene, accuracy: Accuracy | None = None) -> AngularReflectance:
    """The bidirectional reflectance factor of a scene over the hemisphere.

    **Arguments:**

    - `voxels`: a scene with periodic sides; its sky is left out.
    - `accuracy`: of the light.
    """
    light = _lit(voxels, Accuracy() if accuracy is None else accuracy)
    sun = float(voxels.illumination.sun_azimuth)
    angles = np.unique(np.append(PLANE, float(voxels.illumination.sun_zenith)))
    zenith, azimuth = np.meshgrid(ZENITHS, AZIMUTHS, indexing="ij")
    # From straight above there is one view; in the plane, the other side has the other azimuth.
    views = np.concatenate(
        [
            np.stack([zenith[1:], azimuth[1:]], axis=-1).reshape(-1, 2),
            np.stack([np.abs(angles), np.where(angles < 0, 180.0, 0.0)], axis=-1),
        ]
    )
    factor = np.asarray(_look(light, views[:, 0], (views[:, 1] + sun) % 360.0)).T
    plane = factor[:, -len(angles) :]
    rings = factor[:, : -len(angles)].reshape(len(factor), len(ZENITHS) - 1, len(AZIMUTHS))
    above = np.broadcast_to(plane[:, None, angles == 0.0], (len(factor), 1, len(AZIMUTHS)))
    return AngularReflectance(np.concatenate([above, rings], axis=1), plane, angles)


@eqx.filter_jit
def _lit(voxels: VoxelScene, accuracy: Accuracy) -> Light:
    dark = jnp.zeros_like(voxels.illumination.sky)
    alone = eqx.tree_at(
        lambda v: (v.illumination.sun, v.illumination.sky), voxels, (dark + 1.0, dark)
    )
    return solve_light(alone, accuracy)


_look = eqx.filter_jit(directional_reflectance)


@eqx.filter_jit
def _voxels(scene: Scene, parameters: PlotParameters, bands: BandSet) -> VoxelScene:
    return scene.voxels(parameters, bands)


def simulate_angles(
    run: Run, plot: Plot, instrument: Sensor, *, files: Sequence[Path]
) -> SimulateAnglesResult:
    """Simulate the bidirectional reflectance factor of a plot; write it and pictures.

    **Arguments:**

    - `run`, whose seed is that of the plants.
    - `instrument`: whose bands are taken.
    - `files`: the sensor's own file, for the provenance record.

    Leaves have the size of their form, whatever the plot file says: without it there is no hot
    spot.

    **Raises:** `InputError` as `build_plot`, and for a plot with open sides.
    """
    if plot.boundary == "open":
        raise InputError(
            'expected boundary = "periodic" for reflectance by angle, but it is "open": low views '
            "would look past the plot",
            file=plot.file,
        )
    instrument = visible_sensor(instrument)
    with run.stage("Build the plot", "build"):
        scene, parameters = build_plot(plot.replace(hot_spot=True), seed=run.seed)
    views = f"{len(ZENITHS)} x {len(AZIMUTHS)} views"
    begin_work({"angles.nc": views, "principal_plane.csv": "", "report.html": ""})
    with run.stage("Measure"):
        voxels = _voxels(hard_scene(scene, parameters), parameters, instrument.bands)
        found = jax.block_until_ready(angular_reflectance(voxels))
    record = run.record([*plot.inputs, *files])
    names = instrument.bands.names
    sun = (float(parameters.light.sun_zenith), float(parameters.light.sun_azimuth))
    dataset = angles_dataset(found, instrument.bands, sun)
    write_run(run.path("angles.nc", "reflectance factor by angle, NetCDF"), dataset, record)
    table = pd.DataFrame(found.plane.T, columns=list(names))
    table.insert(0, "view_angle_deg", found.angles)
    what = "reflectance factor in the plane of the sun; on its side above 0"
    run.table("principal_plane.csv", table, what, None)
    by_band = {"nadir": found.at(0.0), "towards_sun": found.at(sun[0]), "albedo": found.albedo}
    table = pd.DataFrame(by_band, index=list(names)).rename_axis("band").reset_index()
    headline = _headline(plot, table, sun)
    run.page(
        Page("simulate angles", plot.name, headline[0], _sections(dataset, table), record=record)
    )
    return run.result(
        SimulateAnglesResult,
        headline=headline,
        bands=len(names),
        views=len(ZENITHS[1:]) * len(AZIMUTHS) + len(found.angles),
        **{k: dict(zip(names, v.tolist(), strict=True)) for k, v in by_band.items()},
    )


def angles_dataset(
    found: AngularReflectance, bands: BandSet, sun: tuple[float, float]
) -> xr.Dataset:
    """The reflectance factor with names and units of the CF conventions.

    **Arguments:** `sun`: its zenith angle and azimuth [degrees].
    """

    def about(name: str, words: str, unit: str = "degree") -> dict[str, str]:
        named = {"standard_name": name} if name else {}
        return {**named, "units": unit, "long_name": words}

    brf = "surface_bidirectional_reflectance"
    words = "bidirectional reflectance factor, sun alone"
    turned = "of the view, clockwise from"
    centre = about("sensor_band_central_radiation_wavelength", "band centre", "nm")
    axes: dict[str, tuple[str, np.ndarray, dict[str, str]]] = {
        "view_zenith": ("view_zenith", ZENITHS, about("sensor_zenith_angle", "of the view")),
        "view_azimuth": (
            "view_azimuth",
            (AZIMUTHS + sun[1]) % 360.0,
            about("sensor_azimuth_angle", f"{turned} north"),
        ),
        "relative_azimuth": ("view_azimuth", AZIMUTHS, about("", f"{turned} that of the sun")),
        "view_angle": ("view_angle", found.angles, about("", "zenith, above 0 on the sun's side")),
    }
    directions = ("band", "view_zenith", "view_azimuth")
    data = {
        "brf": (directions, found.hemisphere.astype(np.float32), about(brf, words, "1")),
        "brf_principal_plane": (
            ("band", "view_angle"),
            found.plane.astype(np.float32),
            about(brf, f"{words}, in the plane of the sun", "1"),
        ),
        "albedo": (
            "band",
            found.albedo,
            about("surface_albedo", "share of light that leaves", "1"),
        ),
    }
    coordinates = {
        "band": ("band", list(bands.names), {"long_name": "band name"}),
        "wavelength": ("band", np.asarray(bands.centre), centre),
        "sun_zenith": ((), sun[0], about("solar_zenith_angle", "of the sun")),
        "sun_azimuth": ((), sun[1], about("solar_azimuth_angle", "of the sun")),
        **axes,
    }
    return xr.Dataset(data, coordinates, {"title": "reflectance factor by direction of view"})


def _headline(plot: Plot, table: pd.DataFrame, sun: tuple[float, float]) -> list[str]:
    shown = table.head(_SHOWN)
    above = ", ".join(f"{b} {v:.4f}" for b, v in zip(shown["band"], shown["nadir"]))
    lines = [f"{plot.name}: reflectance factor from above {above}."]
    more = shown["towards_sun"] / shown["nadir"]
    lines.append(
        f"From where the sun is, {sun[0]:g} degrees off the zenith, it is "
        + ", ".join(f"{b} {v:.2f}" for b, v in zip(shown["band"], more))
        + " times as bright: the hot spot."
    )
    share = ", ".join(f"{b} {v:.4f}" for b, v in zip(shown["band"], shown["albedo"]))
    lines.append(f"Albedo under the sun alone, the mean of all views: {share}.")
    return lines


def _sections(dataset: xr.Dataset, table: pd.DataFrame) -> list[Section]:
    names = table["band"].tolist()
    bands = [b for b in _BANDS if b in names] or names[:: max(len(names) - 1, 1)][:2]
    lines = names if len(names) <= _SHOWN else bands
    return [
        Section(
            "",
            [
                Picture(
                    "angles.png",
                    figures.angles_polar(dataset, bands),
                    "reflectance factor over the hemisphere",
                    "Reflectance factor from every direction, seen from above: north is up, the "
                    "rim is a view 75 degrees off the zenith, and the circle is the sun.",
                ),
                Picture(
                    "principal_plane.png",
                    figures.angles_plane(dataset, lines),
                    "reflectance factor in the plane of the sun",
                    "Reflectance factor in the plane of the sun, on its side to the right. The "
                    "dashed line is where the sensor is in front of the sun.",
                ),
                Table(table, "Each band: from above, from where the sun is, and the albedo."),
            ],
        )
    ]

"""What a LiDAR measures of a scene: waveforms, returns, expected structure."""

import dataclasses
from typing import TYPE_CHECKING, Any

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array, Float, Int

from fynjax._core.errors import InputError
from fynjax._core.html import as_html
from fynjax.canopy import Organ
from fynjax.metrics.structure import STRUCTURE_METRICS, StructureSettings
from fynjax.radiation import VoxelScene
from fynjax.scene._parameters import PlotParameters
from fynjax.scene._scene import Scene
from fynjax.scene._structure import fitting_structure, scene_structure
from fynjax.sensors import (
    Lidar,
    LidarBeams,
    LidarReturns,
    Waveforms,
    detect_returns,
    lidar_waveforms,
    received_electrons,
)
from fynjax.sensors.lidar import GROUND, shares_of_returns

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr


@dataclasses.dataclass(frozen=True)
class ReturnTruth:
    """What the light of each discrete return comes from: shares of the light scattered once that
    reaches the receiver in a sample about the return's range. They sum to one, but for returns of
    noise alone, where all are 0."""

    species: Float[np.ndarray, "species return"]
    """Share of any part of each species [-]."""
    ground: Float[np.ndarray, " return"]
    """Share of the ground [-]."""
    taxa: tuple[str, ...]
    """Name of each species."""
    position: Float[np.ndarray, "return 3"]
    """x, y, z of each return [m], as of `LidarReturns`."""

    def leading(self) -> tuple[Int[np.ndarray, " return"], Float[np.ndarray, " return"]]:
        """The species with the largest share of each return as its place in `taxa`, -1 where the
        ground has a larger share or nothing has any; and the largest share of a species [-]."""
        place, share = self.species.argmax(axis=0), self.species.max(axis=0)
        return np.where(share > self.ground, place, -1), share

    def to_xarray(self) -> "xr.Dataset":
        """All shares, the leading species and its share as a dataset with names and units."""
        import xarray as xr  # late: the command line need not wait for it

        place, share = self.leading()
        words = "share of the return's light that is from "
        data: dict[str, Any] = {
            "species_share": (
                ("species", "return"),
                self.species.astype(np.float32),
                {"units": "1", "long_name": words + "any part of a species"},
            ),
            "ground_share": (
                "return",
                self.ground.astype(np.float32),
                {"units": "1", "long_name": words + "the ground"},
            ),
            "leading_species": ("return", place.astype(np.int16), leading_flags(self.taxa)),
            "leading_share": (
                "return",
                share.astype(np.float32),
                {"units": "1", "long_name": words + "the species with the largest share"},
            ),
        }
        coordinates: dict[str, Any] = {
            "species": ("species", list(self.taxa), {"long_name": "taxon"})
        }
        ends = "the plot's west edge", "the plot's south edge", "the bottom of the scene's grid"
        for letter, end, values in zip("xyz", ends, self.position.T, strict=True):
            about = {"units": "m", "long_name": f"distance of the return from {end}"}
            coordinates[letter] = "return", values, about
        return xr.Dataset(data, coordinates, {"title": "what a LiDAR's returns come from"})


def leading_flags(taxa: tuple[str, ...]) -> dict[str, Any]:
    """Attributes of a layer of leading species, -1 for none of `taxa`."""
    return {
        "long_name": "species with the largest share",
        "units": "1",
        "flag_values": np.arange(-1, len(taxa), dtype=np.int16),
        "flag_meanings": " ".join(t.replace(" ", "_") for t in ("none", *taxa)),
    }


class LidarObservation(eqx.Module):
    """What a LiDAR measures of a scene: `cloud.metric("gap_fraction")` is a number of its
    structure. Heights of returns and beams count from the bottom of the scene's grid."""

    scene: Scene
    parameters: PlotParameters
    lidar: Lidar
    voxels: VoxelScene
    """The scene in the laser's line."""
    beams: LidarBeams
    """The pulses."""
    sublayers: int = eqx.field(static=True)
    """Steps in which a pulse crosses a layer of voxels."""
    waveforms: Waveforms
    """Apparent reflectance in each sample of each pulse, without noise [-]."""
    electrons: Float[Array, "beam sample"]
    """Electrons that the receiver counts, its mean background taken off [-]."""
    returns: LidarReturns | None
    """Discrete returns; None inside a transformation, as they are found one by one."""
    leaves: Array
    """JAX key by which the leaves that pulses hit were drawn."""

    def truth(self) -> ReturnTruth:
        """Which species the light of each return comes from, and how much of it from the ground:
        of the very leaves that were drawn for the waveforms. Light that was scattered more than
        once is left out, and where plants of a species have different leaves all are as bright as
        their mean. Not differentiable.

        **Raises:** `InputError` inside a transformation.
        """
        returns, organs = self._returns(), len(Organ)
        voxels = self.scene.voxels_by_organ(self.parameters, self.lidar.bands)
        groups = tuple(
            tuple(range(i * organs, (i + 1) * organs)) for i in range(len(self.scene.taxa))
        )
        species, ground = shares_of_returns(
            voxels, self.lidar, self.beams, returns, groups,
            key=self.leaves, sublayers=self.sublayers,
        )  # fmt: skip
        return ReturnTruth(species, ground, self.scene.taxa, returns.position)

    def metric(self, name: str, *, grain: float | None = None) -> Float[Array, ""]:
        """A number of the structure that first returns of so many pulses are expected to have, by
        the gaps between plants (`scene_structure`): the same with and without noise, inside and
        outside of a transformation. Where a pulse first hits is up to its own length above the
        return that its echo gives. Differentiable in the parameters that were observed.

        **Arguments:**

        - `name`: of `fynjax.metrics.structure.STRUCTURE_METRICS`, or "height_p95" and the like, a
          percentile of the heights above the ground [m].
        - `grain`: side of the cells whose mean a metric is [m]; by default the nearest to 2 m that
          fits the voxels. Percentiles are those of the whole plot.

        **Raises:** `InputError` for another name, and where cells do not fit the voxels.
        """
        side = min(self.scene.grid.extent[:2])
        if name in STRUCTURE_METRICS:
            settings, grains = fitting_structure(self.scene.grid.horizontal_size, side)
            grain = min(grains, key=lambda g: abs(g - 2.0)) if grain is None else grain
        else:
            settings, grain = StructureSettings(), side
        return _structure(
            self.scene, self.parameters, [name], settings, grain=grain, pulses=self._density
        )[0]

    @property
    def _density(self) -> float:
        """Pulses for each square metre [m-2]."""
        return len(self.beams) / self.scene.ground_area

    def to_dataframe(self) -> "pd.DataFrame":
        """A row for each return, in the order of the pulses and then of range: x, y, z [m], and the
        fields of `fynjax.sensors.LidarReturns`."""
        import pandas as pd  # late: the command line need not wait for it

        returns = self._returns()
        places = dict(zip("xyz", returns.position.T, strict=True))
        rest = {f.name: getattr(returns, f.name) for f in dataclasses.fields(returns)}
        del rest["position"]
        return pd.DataFrame(places | rest)

    def to_xarray(self) -> "xr.Dataset":
        """What was recorded of each pulse, and the noise-free return of its ground."""
        import xarray as xr  # late: the command line need not wait for it

        beams, axes = self.beams, {"x": "east", "y": "north", "z": "up"}
        of_pulse: dict[str, tuple[Any, str, str]] = {
            "first_range": (beams.start, "range at which the first sample begins", "m"),
            "irradiance": (beams.irradiance, "of the pulse, relative to the beam's middle", "1"),
            "scan_angle": (beams.scan_angle, "angle from straight down", "degree"),
            "time": (beams.time, "time of the pulse since the start of the flight", "s"),
        }
        for k, (letter, name) in enumerate(axes.items()):
            place = f"place of the sensor, {name} of the south-west bottom corner"
            of_pulse[f"origin_{letter}"] = beams.origin[:, k], place, "m"
            towards = f"direction of the pulse, {name}"
            of_pulse[f"direction_{letter}"] = beams.direction[:, k], towards, "1"
        of_sample = {
            "waveform": (self.electrons, "electrons counted, mean background taken off"),
            "ground_waveform": (
                self.waveforms.ground,
                "apparent reflectance of the ground in the sample",
            ),
        }
        samples = (np.arange(beams.samples) + 0.5) * self.lidar.sample
        beyond = {"long_name": "range of the sample's middle beyond first_range", "units": "m"}
        index = {"long_name": "index of the pulse", "units": "1"}
        return xr.Dataset(
            {
                name: (
                    ("pulse", "sample"),
                    np.asarray(values, np.float32),
                    {"long_name": what, "units": "1"},
                )
                for name, (values, what) in of_sample.items()
            }
            | {
                name: ("pulse", values, {"long_name": what, "units": unit})
                for name, (values, what, unit) in of_pulse.items()
            },
            coords={
                "pulse": ("pulse", np.arange(len(beams)), index),
                "sample": ("sample", samples, beyond),
            },
            attrs={
                "title": f"waveforms of {self.lidar.name}",
                "wavelength_nm": self.lidar.wavelength,
                "pulse_fwhm_ns": self.lidar.pulse_length,
                "sample_m": self.lidar.sample,
                "comment": "single scattering",
            },
        )

    def plot(self, **options: Any) -> Any:
        """Draw the returns from the south, by pandas.

        **Arguments:** `options` of `pandas.DataFrame.plot.scatter`.
        """
        drawn: Any = {"x": "x", "y": "z", "c": "reflectance", "s": 2, "colormap": "viridis"}
        return self.to_dataframe().plot.scatter(**(drawn | options))

    def __str__(self) -> str:
        """Description of the LiDAR and of the heights of its returns, in a sentence."""
        text = f"{self.lidar.name}: {len(self.beams)} pulses, {self._density:.4g} a square metre"
        if self.returns is None or not len(self.returns):
            return f"{text}; no returns."
        low, middle, high = np.percentile(self.returns.position[:, 2], (5.0, 50.0, 95.0))
        ground = 100.0 * float(np.mean(self.returns.classification == GROUND))
        return (
            f"{text}; {len(self.returns)} returns, {ground:.1f} % of them from the ground; heights "
            f"above the lowest ground {low:.2f}, {middle:.2f} and {high:.2f} m (5, 50 and 95 %)."
        )

    _repr_html_ = as_html

    def _returns(self) -> LidarReturns:
        if self.returns is None:
            raise InputError("a transformation has no single returns: observe outside of it")
        return self.returns


_structure = eqx.filter_jit(scene_structure)
_voxels = eqx.filter_jit(Scene.voxels)


def observe_lidar(
    scene: Scene, parameters: PlotParameters, lidar: Lidar, *, noise: bool = False, seed: int = 0
) -> LidarObservation:
    """Fly a LiDAR over a scene: its pulses, their waveforms and returns.

    **Arguments:**

    - `scene`, `parameters`: as of `observe`.
    - `lidar`: from `fynjax.sensors` or a file, which says where it flies.
    - `noise`: whether the receiver is noisy.
    - `seed`: of the places of the pulses, the leaves that they hit, which are always drawn, and the
      noise.

    **Raises:** `InputError` as `Lidar.beams`.

    Which light it has, see `lidar_waveforms`. Waveforms and `LidarObservation.metric` are
    differentiable; returns are not, as they are found one by one.
    """
    voxels = _voxels(scene, parameters, lidar.bands)
    beams = lidar.beams(
        scene.grid.extent[:2], top=voxels.height, ground=scene.ground_level, seed=seed
    )
    # Steps in a layer, so that a pulse moves by at most half a voxel in each.
    slant = np.abs(beams.direction[:, 2]).min()
    run = float(np.sqrt(1.0 - slant**2) / slant)
    sublayers = max(int(np.ceil(2.0 * run * voxels.vertical / voxels.horizontal)), 1)
    # One key for leaves, which are always drawn, one for the noise: with it the same leaves.
    leaves, counting = jax.random.split(jax.random.key(seed))
    waveforms = lidar_waveforms(voxels, lidar, beams, key=leaves, sublayers=sublayers)
    electrons = received_electrons(lidar, beams, waveforms.total, key=counting if noise else None)
    returns = None
    if not isinstance(electrons, jax.core.Tracer):
        clock = jax.random.fold_in(counting, 1) if noise else None
        returns = detect_returns(lidar, beams, np.asarray(electrons), waveforms, key=clock)
    return LidarObservation(
        scene, parameters, lidar, voxels, beams, sublayers, waveforms, electrons, returns, leaves
    )

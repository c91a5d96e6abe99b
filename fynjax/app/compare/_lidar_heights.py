"""Heights of a point cloud against what was planted."""

from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np
import pandas as pd
from jaxtyping import Float

from fynjax.radiation import VoxelScene
from fynjax.scene import PlotParameters, Scene, ground_at, height_profile
from fynjax.sensors import LidarBeams, LidarReturns, expected_returns
from fynjax.sensors.lidar import VEGETATION

LEVELS = np.arange(5, 100, 5)
"""Percentiles that are compared [%]."""
_BEAMS = 8000
PLANTED, FIRST, RETURNED = "planted area", "first hits", "vegetation returns"


@dataclass(frozen=True)
class Heights:
    """Where plants are, where light first meets them, and where returns are."""

    height: Float[np.ndarray, " point"]
    """Height of every return above the ground [m]."""
    edges: Float[np.ndarray, " edge"]
    """Borders of layers above the ground [m]."""
    shares: dict[str, Float[np.ndarray, " layer"]]
    """Share in each layer of planted area (leaf and wood), first hits and vegetation returns."""
    percentiles: dict[str, Float[np.ndarray, " level"]]
    """Percentiles (`LEVELS`) of height of planted area, first hits and vegetation returns [m]."""

    @property
    def rmse(self) -> dict[str, float] | None:
        """Root mean square distance of the returns' percentiles from the others' [m]."""
        if RETURNED not in self.percentiles:
            return None
        returned = self.percentiles[RETURNED]
        return {
            name: float(np.sqrt(np.mean((returned - self.percentiles[name]) ** 2)))
            for name in self.percentiles
            if name != RETURNED
        }

    def table(self) -> pd.DataFrame:
        """Percentiles by row, metres."""
        columns = {f"{k.replace(' ', '_')}_m": v for k, v in self.percentiles.items()}
        return pd.DataFrame({"percentile": LEVELS, **columns})


def compare_heights(
    scene: Scene,
    parameters: PlotParameters,
    voxels: VoxelScene,
    beams: LidarBeams,
    returns: LidarReturns,
    *,
    sublayers: int,
) -> Heights:
    """Heights of returns, planted area and first hits above the ground.

    On sloping ground first hits are left out, as their layers are level.

    **Arguments:**

    - `scene`: of the plot, hard: all its plants stand.
    - `parameters`: of the plot, in its units.
    - `voxels`: of the scene, at the wavelength of the laser.
    - `beams`: of the flight.
    - `returns`: that it recorded; positions [m] in the plot's frame.
    - `sublayers`: steps in a voxel along a beam.

    **Returns:** a `Heights`: shares by layer [-] and percentiles [m].
    """
    step = scene.grid.vertical_size
    edges = np.arange(scene.grid.shape[2] + 1) * step
    place = jnp.asarray(returns.position[:, :2])
    height = returns.position[:, 2] - np.asarray(ground_at(scene, place))
    plants = returns.classification == VEGETATION
    area = height_profile(scene, parameters, edges).sum(axis=(0, 1)) * step
    counts = {PLANTED: area}
    if scene.terrain is None:
        # The mean needs no more of them.
        some = beams.select(np.arange(0, len(beams), max(len(beams) // _BEAMS, 1)))
        first, _ = expected_returns(voxels, some, edges, sublayers=sublayers)
        counts[FIRST] = np.asarray(first, float)
    counts[RETURNED] = np.histogram(height[plants], edges)[0].astype(float)
    shares = {name: c / c.sum() for name, c in counts.items() if c.sum() > 0}
    percentiles = {
        name: np.interp(LEVELS / 100.0, np.r_[0.0, np.cumsum(share)], edges)
        for name, share in shares.items()
        if name != RETURNED
    }
    if plants.any():
        percentiles[RETURNED] = np.percentile(height[plants], LEVELS)
    return Heights(height, edges, shares, percentiles)

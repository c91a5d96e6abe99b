"""What the light of a return comes from."""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from fynjax.radiation import VoxelScene
from fynjax.sensors.lidar._beams import LidarBeams
from fynjax.sensors.lidar._path import PencilPaths, canopy_fields
from fynjax.sensors.lidar._returns import LidarReturns
from fynjax.sensors.lidar._system import Lidar
from fynjax.sensors.lidar._waveform import check_pulse_scene, map_beams, pulse_between


def shares_of_returns(
    scene: VoxelScene,
    lidar: Lidar,
    beams: LidarBeams,
    returns: LidarReturns,
    groups: tuple[tuple[int, ...], ...],
    *,
    key: Array,
    sublayers: int = 2,
) -> tuple[Float[np.ndarray, "group point"], Float[np.ndarray, " point"]]:
    """Shares that groups of classes and the ground have in the light of each return.

    In the sample about the return's range, of light scattered once, from the leaves that the same
    key has drawn for its waveform.

    **Arguments:**

    - `scene`, `lidar`, `beams`, `key`, `sublayers`: as `lidar_waveforms` had them for
      these returns; classes may be parted further, as long as their area is the same.
    - `returns`: of `detect_returns`.
    - `groups`: places of the classes of each group.

    **Returns:** share of each group, and of the ground [-]: they sum to one, but for a return of
    noise alone, where all are 0. Not differentiable.

    **Raises:** `InputError` as `lidar_waveforms`.
    """
    check_pulse_scene(scene, beams)
    dtype = scene.area_density.dtype
    hits = jax.random.exponential(key, (len(beams), len(beams.pencils)), dtype)
    most = int(returns.number.max(initial=1))
    distance = np.full((len(beams), most), np.inf)
    distance[returns.beam, returns.number - 1] = returns.distance
    canopy, ground = map_beams(
        _one_share,
        beams,
        (jnp.asarray(distance, dtype), hits),
        (scene, canopy_fields(scene, groups), (lidar.sample, lidar.pulse_sd)),
        sublayers,
    )
    place = returns.beam, returns.number - 1
    sent = np.asarray(canopy)[place].T, np.asarray(ground)[place]
    total = sent[0].sum(axis=0) + sent[1]
    total = np.where(total > 0.0, total, 1.0)
    return sent[0] / total, sent[1] / total


def _one_share(
    path: PencilPaths,
    beam: tuple[Array, Array],
    common: tuple[VoxelScene, Array, tuple[float, float]],
) -> tuple[Float[Array, "return group"], Float[Array, " return"]]:
    distance, drawn = beam
    sample, pulse_sd = common[2]
    hit, sent, _, leaf = path.hit_by(drawn)
    sent = jnp.atleast_2d(sent)

    def of(points: Float[Array, " pencil"]) -> Float[Array, "return pencil"]:
        edges = distance[:, None] + jnp.array([-0.5, 0.5], distance.dtype) * sample
        return pulse_between(edges, points, pulse_sd)[:, 0]

    canopy = of(hit) @ jnp.where(leaf, sent, 0.0).T
    return canopy, of(path.ground_range) @ jnp.where(leaf, 0.0, path.ground)

"""Waveforms of a LiDAR over a voxel scene, and where its light first meets something.

Light that leaves or ground scatter once comes straight back. Out and back it takes
the same path, so a gap that let it in lets it out: the gap probability exp(-tau) counts once (the
hot spot in full), where two separate directions would have exp(-2 tau). What flat leaves transmit
goes on forward and is lost to single scattering. Light scattered more than once arrives late and
adds to the tail. A flash system lights the whole scene at once: a seventh of its energy comes so,
and is modelled (`_late`). In the narrow footprint of a scanner it has left before it comes back,
and is left out: by Monte Carlo at 1064 nm on 4 m of the plot of 2006 it is 1 % of the energy in a
footprint of 0.1 m, 2 % in one of 0.25 m and 6 % in one of 1 m.
"""

import dataclasses
import math
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.scipy.special import erf
from jaxtyping import Array, Float, Int
from scipy.special import ndtr

from fynjax._core.errors import InputError
from fynjax.radiation import VoxelScene
from fynjax.sensors.lidar._beams import FlashGeometry, LidarBeams
from fynjax.sensors.lidar._late import Delays, LateLight, delays, late_light
from fynjax.sensors.lidar._path import PencilPaths, canopy_fields, trace_pencils
from fynjax.sensors.lidar._system import Lidar

_TAIL = 4.0
_FINE = 6.0  # bins in the pulse's standard deviation


class Waveforms(eqx.Module):
    """What comes back of each pulse, in samples of range.

    In shares of what a white plate at that range sends back that fills the beam and faces it: the
    sum over a waveform is the apparent reflectance of what the beam met.
    """

    canopy: Float[Array, "beam sample"]
    """Light that leaves, wood and flowers send back [-]."""
    ground: Float[Array, "beam sample"]
    """Light that the ground sends back [-]."""

    @property
    def total(self) -> Float[Array, "beam sample"]:
        """What canopy and ground send back [-]."""
        return self.canopy + self.ground


def lidar_waveforms(
    scene: VoxelScene,
    lidar: Lidar,
    beams: LidarBeams,
    *,
    key: Array | None = None,
    sublayers: int = 2,
    batch: int = 1024,
    multiple: bool = True,
) -> Waveforms:
    """Waveforms of all beams: light scattered once and, of a flash system, all other.

    **Arguments:**

    - `scene`: in one band, the laser's. Its sun and sky play no part.
    - `lidar`: pulse, receiver and geometry.
    - `beams`: of `lidar.beams`; known numbers, not traced.
    - `key`: a JAX key. Left out, the result is the mean over all canopies of such leaf area, and
      differentiable in everything of `scene`. With a key each pencil of a beam goes on until it
      hits one leaf, drawn from the gap probability, or the ground: the echo of single leaves (or
      shoots) about as wide as a pencil. The mean over keys is the result without one.
    - `sublayers`: steps in a layer of voxels; more where beams are far from upright.
    - `batch`: beams at a time, which bounds the memory.
    - `multiple`: whether a flash system has its light that is scattered more than once, as if it
      lit all of the scene evenly, from straight above. A scanner never has it.

    **Returns:** `Waveforms`, apparent reflectance in each sample. The receiver integrates over a
    sample; the pulse is Gaussian.

    **Raises:** `InputError` for a scene in several bands, a sensor inside the grid, and beams
    without samples.

    Differentiable, without a key, in every array of `scene`.

    >>> import jax.numpy as jnp
    >>> from fynjax.radiation import voxel_scene
    >>> from fynjax.sensors import detect_returns, lidar_waveforms
    >>> from fynjax.sensors import received_electrons, shipped_lidar
    >>> scene = voxel_scene(
    ...     area_density=jnp.full((1, 2, 4, 4), 1.0),
    ...     reflectance=jnp.array([[0.45]]),  # at the laser's wavelength
    ...     transmittance=jnp.array([[0.45]]),
    ...     voxel=(0.25, 0.25, 0.25),
    ...     ground=jnp.array([0.3]),
    ...     sun_zenith=30.0,
    ... )
    >>> lidar = shipped_lidar("scanning_lidar")
    >>> beams = lidar.beams((1.0, 1.0), top=scene.height)
    >>> waveforms = lidar_waveforms(scene, lidar, beams)
    >>> electrons = received_electrons(lidar, beams, waveforms.total)
    >>> returns = detect_returns(lidar, beams, electrons, waveforms)
    >>> len(beams) > 0, len(returns) > 0
    (True, True)
    """
    check_pulse_scene(scene, beams)
    if beams.samples < 1:
        raise InputError("`beams` must have samples: make them with `Lidar.beams`")
    dtype = scene.area_density.dtype
    hits = None
    if key is not None:
        hits = jax.random.exponential(key, (len(beams), len(beams.pencils)), dtype)
    receiver, first = _Receiver.create(scene, lidar, beams)
    late = None
    if multiple and isinstance(lidar.geometry, FlashGeometry):
        late = late_light(scene)
        found = delays(late, receiver.step, lidar.pulse_sd, 2 * len(receiver.to_samples))
        receiver = dataclasses.replace(receiver, late=_Late.create(found, receiver.to_samples))
    canopy, ground = map_beams(
        _one_waveform,
        beams,
        (jnp.asarray(beams.start, dtype), jnp.asarray(first), hits),
        (scene, canopy_fields(scene), receiver),
        sublayers,
        late,
        batch,
    )
    return Waveforms(canopy, ground)


class _Late(eqx.Module):
    """How late light that was scattered before reaches the samples."""

    heights: Float[Array, " node"]
    leaves: Float[Array, "node bin sample"]
    ground: Float[Array, "bin sample"]

    @classmethod
    def create(cls, delays: Delays, to_samples: Float[Array, "bin sample"]) -> "_Late":
        place = np.arange(len(to_samples))
        # [bin of the last scattering, bin of arrival]: delays repeat themselves.
        later = (place - place[:, None]) % delays.ground.shape[0]

        def delayed(distribution: Array) -> Array:
            return distribution.astype(to_samples.dtype)[later] @ to_samples

        leaves = jax.lax.map(delayed, delays.leaves)
        return cls(delays.heights.astype(to_samples.dtype), leaves, delayed(delays.ground))

    def samples(self, energy: Float[Array, " bin"], height: Float[Array, " bin"]) -> Array:
        """What leaves of such heights sent last, in samples."""
        last = len(self.heights) - 1
        at = jnp.interp(height, self.heights, jnp.arange(last + 1, dtype=height.dtype))
        nodes = jnp.arange(last + 1)[:, None]
        return jnp.einsum(
            "nb,nbs->s", energy * jnp.maximum(1.0 - jnp.abs(at - nodes), 0.0), self.leaves
        )


class _Receiver(eqx.Module):
    """Bins of range, finer than samples, in which a canopy's return is gathered, and how pulse and
    samples blur it.

    Bins are counted from the first sample of each beam; they span the canopy of that beam.
    """

    to_samples: Float[Array, "bin sample"]
    late: _Late | None
    step: float = eqx.field(static=True)
    count: int = eqx.field(static=True)
    tail: int = eqx.field(static=True)
    sample: float = eqx.field(static=True)
    samples: int = eqx.field(static=True)
    pulse_sd: float = eqx.field(static=True)

    @classmethod
    def create(
        cls, scene: VoxelScene, lidar: Lidar, beams: LidarBeams
    ) -> tuple["_Receiver", Int[np.ndarray, " beam"]]:
        """The receiver, and the first bin of each beam that the canopy reaches."""
        sigma = lidar.pulse_sd
        per_sample = max(int(np.ceil(_FINE * lidar.sample / sigma)), 1)
        step = lidar.sample / per_sample
        tail = int(np.ceil(_TAIL * sigma / step))
        slant = -beams.direction[:, 2]
        tilt = np.sqrt(np.maximum(1.0 - slant**2, 0.0)) / slant
        off = np.abs(beams.pencils).max()
        # A pencil's slant range beyond that of the axis, to second order.
        slack = beams.origin[:, 2] / slant * (2.0 * tilt * off + 4.0 * off**2)
        near = (beams.origin[:, 2] - scene.height) / slant - slack
        far = beams.origin[:, 2] / slant + slack
        count = int(np.ceil(np.max(far - near) / step)) + 1
        bins = (np.arange(beams.samples * per_sample + 2 * tail + 1) - tail) * step
        edges = np.arange(beams.samples + 1) * lidar.sample

        def ramp(x: np.ndarray) -> np.ndarray:
            """Integral of the distribution function of the pulse."""
            density = np.exp(-0.5 * (x / sigma) ** 2) / np.sqrt(2.0 * np.pi)
            return x * ndtr(x / sigma) + sigma * density

        # What is even in a bin, blurred by the pulse and integrated over a sample: the second
        # difference of the ramp, over the edges of both.
        blurred = ramp(edges[None, :] - bins[:, None])
        to_samples = np.diff(-np.diff(blurred, axis=0), axis=1) / step
        receiver = cls(
            jnp.asarray(to_samples, scene.area_density.dtype),
            None,
            step,
            count,
            tail,
            lidar.sample,
            beams.samples,
            sigma,
        )
        return receiver, np.floor((near - beams.start) / step).astype(int)

    def points(self, distance: Array, start: Array) -> Float[Array, "sample pencil"]:
        """Share of the return of points that each sample holds."""
        edges = start + jnp.arange(self.samples + 1, dtype=start.dtype) * self.sample
        return pulse_between(edges, distance, self.pulse_sd)

    def spread(
        self, path: PencilPaths, source: Array, start: Array, first: Array
    ) -> Float[Array, " bin"]:
        """What the canopy sends back of a source, of all pencils."""
        bins = jnp.arange(self.count + 1)
        edges = start + (first + bins).astype(start.dtype) * self.step
        energy = jnp.diff(path.returned(edges[:, None], source).sum(axis=1))
        place = first + self.tail + bins[:-1]
        whole = jnp.zeros(self.to_samples.shape[0], energy.dtype)
        place = jnp.where(place < 0, whole.shape[0], place)
        return whole.at[place].add(energy, mode="drop")

    def gather(self, distance: Array, energy: Array, start: Array) -> Float[Array, " bin"]:
        """Points in bins, each shared by the two whose middles are next to it."""
        count = self.to_samples.shape[0]
        place = (distance - start) / self.step + self.tail - 0.5
        low = jnp.floor(jax.lax.stop_gradient(place))
        share = place - low
        index = low.astype(int)
        index = jnp.where(index < 0, count, index)
        whole = jnp.zeros(count, energy.dtype).at[index].add((1.0 - share) * energy, mode="drop")
        return whole.at[index + 1].add(share * energy, mode="drop")

    def heights(self, path: PencilPaths, start: Array, top: float) -> Float[Array, " bin"]:
        """Heights of the bins, along the middle of the pencils [m]."""
        bins = jnp.arange(self.to_samples.shape[0], dtype=start.dtype)
        distance = start + (bins - self.tail + 0.5) * self.step
        fall = path.depth.shape[0] * path.step  # from the grid's top to its bottom
        return top * (1.0 - jnp.mean((distance[:, None] - path.top) / fall, axis=1))


def pulse_between(edges: Array, distance: Array, pulse_sd: float) -> Array:
    """Share of the Gaussian return of points [pencil] that falls between each two of the `edges`
    [..., edge] of range: [..., edge - 1, pencil]."""
    scaled = (edges[..., None] - distance) / (math.sqrt(2.0) * pulse_sd)
    return 0.5 * jnp.diff(erf(scaled), axis=-2)


def _one_waveform(
    path: PencilPaths,
    beam: tuple[Array, Array, Array | None],
    common: tuple[VoxelScene, Array, _Receiver],
) -> tuple[Array, Array]:
    start, first, drawn = beam
    scene, _, receiver = common
    late = receiver.late
    later = None
    if drawn is None:
        # Mean over canopies: each leaf and the ground through the gap above it.
        through = jnp.exp(-path.depth_at(path.ground_range[None])[0])
        canopy = receiver.spread(path, path.source, start, first) @ receiver.to_samples
        if path.late is not None:
            later = receiver.spread(path, path.late, start, first)
    else:
        # One canopy: a pencil ends where its optical depth reaches the number drawn.
        distance, sent, sent_late, leaf = path.hit_by(drawn)
        through = jnp.where(leaf, 0.0, 1.0)
        canopy = receiver.points(distance, start) @ jnp.where(leaf, sent, 0.0)
        if sent_late is not None:
            later = receiver.gather(distance, jnp.where(leaf, sent_late, 0.0), start)
    ground = receiver.points(path.ground_range, start) @ (through * path.ground)
    if late is not None and later is not None and path.late_ground is not None:
        canopy = canopy + late.samples(later, receiver.heights(path, start, scene.height))
        on_ground = receiver.gather(path.ground_range, through * path.late_ground, start)
        ground = ground + on_ground @ late.ground
    pencils = path.top.shape[0]
    return canopy / pencils, ground / pencils


def expected_returns(
    scene: VoxelScene, beams: LidarBeams, edges: Float[np.ndarray, " edge"], *, sublayers: int = 2
) -> tuple[Float[Array, " layer"], Float[Array, ""]]:
    """Expected number of beams whose light first meets the canopy in each layer, and the ground.

    This is the gap law itself, without detector: of a beam whose pencils hit different heights each
    height gets its share.

    **Arguments:**

    - `edges`: borders of the layers above the bottom of the grid, rising [m].
    - `scene`, `beams`, `sublayers`: as for `lidar_waveforms`.

    **Returns:** hits of the canopy in each layer and hits of the ground [-]; with edges from 0 to
    the top they sum to the number of beams.

    **Raises:** `InputError` as `lidar_waveforms`.

    Differentiable in the area density and the inclination of leaves, and in the height of the
    ground.
    """
    check_pulse_scene(scene, beams)
    heights = jnp.asarray(edges, scene.area_density.dtype)
    platform = jnp.asarray(beams.origin[:, 2], heights.dtype)
    canopy, ground = map_beams(
        _one_beam_of_hits, beams, platform, (scene, canopy_fields(scene), heights), sublayers
    )
    return canopy.sum(axis=0), ground.sum()


def _one_beam_of_hits(
    path: PencilPaths, platform: Array, common: tuple[VoxelScene, Array, Array]
) -> tuple[Array, Array]:
    scene, _, heights = common
    cosine = (platform - scene.height) / path.top
    distance = (platform - heights[:, None]) / cosine
    gap = jnp.exp(-path.depth_at(distance)).mean(axis=1)
    return jnp.diff(gap), jnp.exp(-path.depth_at(path.ground_range[None])).mean()


def map_beams(
    function: Callable[..., tuple[Array, Array]],
    beams: LidarBeams,
    per_beam: Any,
    common: tuple[VoxelScene, Array, Any],
    sublayers: int,
    late: LateLight | None = None,
    batch: int = 1024,
) -> tuple[Array, Array]:
    """`function` of each beam's paths, so many beams at a time: two arrays by beam."""
    dtype = common[0].area_density.dtype
    batch = max(min(batch, len(beams)), 1)
    spare = -len(beams) % batch

    def padded(values: Array) -> Array:
        if spare == 0:
            return values
        return values[np.minimum(np.arange(len(values) + spare), len(values) - 1)]

    where = (jnp.asarray(beams.origin, dtype), jnp.asarray(beams.direction, dtype))
    each = jax.tree.map(padded, (*where, per_beam))
    pencils = jnp.asarray(beams.pencils, dtype)
    width, count = beams.pencil_width, len(beams)
    canopy_and_ground = _mapped(function, batch, width, sublayers, each, pencils, common, late)
    return jax.tree.map(lambda a: a[:count], canopy_and_ground)


@eqx.filter_jit
def _mapped(
    function: Callable[..., tuple[Array, Array]],
    batch: int,
    width: float,
    sublayers: int,
    each: Any,
    pencils: Array,
    common: tuple[VoxelScene, Array, Any],
    late: LateLight | None,
) -> tuple[Array, Array]:
    scene, fields, _ = common

    def trace_beam(beam: Any) -> tuple[Array, Array]:
        origin, direction, per_beam = beam
        path = trace_pencils(scene, fields, origin, direction, pencils, width, sublayers, late)
        return function(path, per_beam, common)

    return jax.lax.map(jax.checkpoint(trace_beam), each, batch_size=batch)


def check_pulse_scene(scene: VoxelScene, beams: LidarBeams) -> None:
    """`InputError` for a scene in several bands, and for a sensor inside the grid."""
    bands = scene.classes.reflectance.shape[1]
    if bands != 1:
        raise InputError(
            f"a LiDAR has one band, its laser's, but the scene has {bands}: "
            "take `scene.bands(k, 1)`"
        )
    if float(beams.origin[:, 2].min()) <= scene.height:
        raise InputError(
            f"the LiDAR must be above the grid, which is {scene.height:g} m high, but is at "
            f"{float(beams.origin[:, 2].min()):g} m: pulses begin above the canopy"
        )

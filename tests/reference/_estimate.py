"""The reference's results: reflectance, fluxes and images, with standard errors."""

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any, NamedTuple

import numpy as np

from fynjax._core.errors import InputError
from fynjax.radiation._rays import RayLattice
from fynjax.radiation._scene import VoxelScene
from tests.reference._leaves import Leaves, with_leaves
from tests.reference._paths import FIXED, backward, count_first, forward
from tests.reference._world import World, build_world, plain, towards

_BATCHES = 32
_PIXELS = 256  # that one thread takes at a time


class Estimate(NamedTuple):
    """A Monte Carlo estimate and its standard error, in one unit and of one shape."""

    mean: np.ndarray
    error: np.ndarray


class FluxEstimates(NamedTuple):
    """Where the incident light goes, as shares of the irradiance above the canopy [-].

    Albedo, absorbed, ground_absorbed and sides sum to one.
    """

    albedo: Estimate
    """Upward through the top of the grid."""
    absorbed: Estimate
    """By each optical class: [class]"""
    transmitted: Estimate
    """Downward flux at the ground, light between ground and canopy included."""
    transmitted_direct: Estimate
    """Of it, direct sun."""
    ground_absorbed: Estimate
    """Absorbed by the ground."""
    sides: Estimate
    """What leaves through the sides less what comes in through them; 0 if they are periodic."""


class PixelRays(NamedTuple):
    """Rays of any sensor, one a pixel, in any order: [..., 3]."""

    origin: np.ndarray
    """Where the sensor is [m]."""
    direction: np.ndarray
    """Line of sight of the pixel, away from the sensor; of any length."""
    right: np.ndarray | None = None
    """Vector across a pixel at the distance of `direction`'s length. None: no width."""
    down: np.ndarray | None = None
    """Vector along a pixel's other edge."""


def reflectance(
    scene: VoxelScene, view_zenith: Any, view_azimuth: Any, *, photons: int, seed: int, band: int
) -> Estimate:
    """Mean reflectance factor of the scene for distant views [-], by Monte Carlo.

    Photons are traced from sun and sky; whenever one meets a leaf or the ground, what it scatters
    towards each view is added with its exact transmittance on the way out (local estimate). In an
    open scene the pixels are those whose rays pass the scene's area at the bottom of the grid.
    `directional_reflectance` is the same quantity by discrete ordinates.

    **Arguments:**

    - `scene`: a turbid medium; `classes.leaf_diameter` has no effect here.
    - `view_zenith`, `view_azimuth`: [view] degrees, zenith in [0, 90).
    - `photons`: rounded up to a multiple of 32, the batches that give the standard error.
    - `seed`: the result depends on it alone, whatever the number of processors.
    - `band`: index of the band, from zero.

    **Returns:** an `Estimate`, one value a view.

    **Raises:** `InputError` for a view that does not look down, fewer than one photon, and a scene
    that `check_scene` refuses.

    Not differentiable.
    """
    return _reflectance(build_world(scene, band), view_zenith, view_azimuth, photons, seed)


def disc_reflectance(
    scene: VoxelScene,
    leaves: Leaves,
    view_zenith: Any,
    view_azimuth: Any,
    *,
    photons: int,
    seed: int,
    band: int,
) -> Estimate:
    """`reflectance` with explicit leaves in the place of the turbid medium.

    It has the hot spot of leaves of finite size. The error is that of one layout; layouts differ.

    **Arguments:**

    - `leaves`: from `discs`.
    - `scene`, `view_zenith`, `view_azimuth`, `photons`, `seed`, `band`: as for `reflectance`.
    """
    world = with_leaves(scene, leaves, band)
    return _reflectance(world, view_zenith, view_azimuth, photons, seed)


def fluxes(scene: VoxelScene, *, photons: int, seed: int, band: int) -> FluxEstimates:
    """Albedo, absorption and transmission of a turbid scene, by Monte Carlo.

    **Arguments:** `scene`, `photons`, `seed`, `band` and errors as for `reflectance`.

    **Returns:** `FluxEstimates`, shares of the irradiance above the canopy [-].
    """
    return _fluxes(build_world(scene, band), photons, seed)


def disc_fluxes(
    scene: VoxelScene, leaves: Leaves, *, photons: int, seed: int, band: int
) -> FluxEstimates:
    """`fluxes` with explicit leaves in the place of the turbid medium.

    **Arguments:**

    - `leaves`: from `discs`.
    - `scene`, `photons`, `seed`, `band`: as for `reflectance`.
    """
    return _fluxes(with_leaves(scene, leaves, band), photons, seed)


def image(
    scene: VoxelScene, rays: RayLattice | PixelRays, *, samples: int, seed: int, band: int
) -> Estimate:
    """Reflectance factor of each pixel, by Monte Carlo [-].

    Paths run backward from points drawn evenly over the pixel's footprint (`RayLattice`) or
    solid angle (`PixelRays`); wherever one meets a leaf or the ground the sun is added with its
    exact transmittance, and the sky where one escapes.

    **Arguments:**

    - `scene`, `seed`, `band`: as for `reflectance`.
    - `rays`: the pixels.
    - `samples`: paths for each pixel.

    **Returns:** pi times radiance over the irradiance above the canopy, [row, column], or the shape
    of the rays' arrays less their last axis.
    """
    return _image(build_world(scene, band), rays, samples, seed)


def disc_image(
    scene: VoxelScene,
    leaves: Leaves,
    rays: RayLattice | PixelRays,
    *,
    samples: int,
    seed: int,
    band: int,
) -> Estimate:
    """`image` with explicit leaves in the place of the turbid medium.

    **Arguments:**

    - `leaves`: from `discs`.
    - `scene`, `rays`, `samples`, `seed`, `band`: as for `image`.
    """
    return _image(with_leaves(scene, leaves, band), rays, samples, seed)


def _reflectance(
    world: World, view_zenith: Any, view_azimuth: Any, photons: int, seed: int
) -> Estimate:
    zenith, azimuth = np.broadcast_arrays(
        np.atleast_1d(np.asarray(view_zenith, float)),
        np.atleast_1d(np.asarray(view_azimuth, float)),
    )
    if not ((zenith >= 0) & (zenith < 89.9)).all():
        raise InputError(
            f"`view_zenith` must be in [0, 90) degrees, but runs from {zenith.min():g} to "
            f"{zenith.max():g}: give the side by the azimuth, not by a sign"
        )
    views = np.array([towards(z, a) for z, a in zip(zenith, azimuth)])
    mean, error = _batches(world, views, photons, seed)
    start = FIXED + len(world.medium.rho)
    return Estimate(mean[start:], error[start:])


def _fluxes(world: World, photons: int, seed: int) -> FluxEstimates:
    mean, error = _batches(world, np.zeros((0, 3)), photons, seed)
    fixed = [Estimate(mean[i], error[i]) for i in range(FIXED)]
    absorbed = Estimate(mean[FIXED:], error[FIXED:])
    return FluxEstimates(fixed[0], absorbed, fixed[1], fixed[2], fixed[3], fixed[4])


def _batches(
    world: World, views: np.ndarray, photons: int, seed: int
) -> tuple[np.ndarray, np.ndarray]:
    """Mean of the batches and its standard error."""
    _positive("photons", photons)
    each = -(-photons // _BATCHES)
    seeds = np.random.SeedSequence(seed).generate_state(_BATCHES, np.uint64)
    runs = np.array(_share(lambda s: forward(world, views, each, s), list(seeds)))
    return runs.mean(axis=0), runs.std(axis=0, ddof=1) / np.sqrt(_BATCHES)


def first_met(
    scene: VoxelScene, rays: RayLattice | PixelRays, *, samples: int, seed: int
) -> np.ndarray:
    """What rays meet first, counted: [class + 2, *pixel], at last ground in the sun and in shade.

    **Arguments:** `scene` with level ground, `rays`, `seed` as for `image`; `samples`: rays of each
    pixel, from points drawn evenly over it.
    """
    _positive("samples", samples)
    out, shape = _by_pixel(count_first, build_world(scene, 0), rays, samples, seed)
    return out.reshape(-1, *shape)


def _image(world: World, rays: RayLattice | PixelRays, samples: int, seed: int) -> Estimate:
    _positive("samples", samples)
    out, shape = _by_pixel(backward, world, rays, samples, seed)
    return Estimate(out[0].reshape(shape), out[1].reshape(shape))


def _by_pixel(
    trace: Any, world: World, rays: RayLattice | PixelRays, samples: int, seed: int
) -> tuple[np.ndarray, tuple[int, ...]]:
    """What `trace` gives of each pixel, [result, pixel], and the shape of the pixels."""
    place, place_edges, direction, direction_edges = (
        _lattice_pixels(rays, world.high[2])
        if isinstance(rays, RayLattice)
        else _sensor_pixels(rays)
    )
    shape = place.shape[:-1]
    place, direction = place.reshape(-1, 3), direction.reshape(-1, 3)
    place_edges, direction_edges = (e.reshape(-1, 2, 3) for e in (place_edges, direction_edges))
    seeds = np.random.SeedSequence(seed).generate_state(len(place), np.uint64)

    def part(start: int) -> np.ndarray:
        some = slice(start, start + _PIXELS)
        found: np.ndarray = trace(
            world,
            place[some],
            place_edges[some],
            direction[some],
            direction_edges[some],
            samples,
            seeds[some],
        )
        return found

    parts = _share(part, range(0, len(place), _PIXELS))
    return np.concatenate(parts, axis=1), shape


def _lattice_pixels(rays: RayLattice, top: float) -> tuple[np.ndarray, ...]:
    """Places at the top of the grid, directions, and the edges of both."""
    x, y, slope_x, slope_y = (
        np.asarray(a, np.float64) for a in (rays.x, rays.y, rays.slope_x, rays.slope_y)
    )
    x, y = np.broadcast_arrays(x + top * slope_x, (y + top * slope_y)[:, None])
    slope_x, slope_y = np.broadcast_arrays(slope_x, slope_y[:, None])
    place = np.stack([x, y, np.full_like(x, top)], axis=-1)
    direction = -np.stack([slope_x, slope_y, np.ones_like(x)], axis=-1)
    edges = np.zeros((*x.shape, 2, 3))
    edges[..., 0, 0] = edges[..., 1, 1] = rays.footprint
    return place, edges, direction, np.zeros_like(edges)


def _sensor_pixels(rays: PixelRays) -> tuple[np.ndarray, ...]:
    direction = np.asarray(rays.direction, np.float64)
    if direction.shape[-1:] != (3,) or not np.isfinite(direction).all():
        raise InputError(
            f"`rays.direction` must be finite vectors [..., 3], but has shape {direction.shape}"
        )
    if not (direction != 0).any(axis=-1).all():
        raise InputError("`rays.direction` must not be zero, but some of its vectors are")
    zeros = np.zeros(3)
    origin, right, down = (
        np.broadcast_to(np.asarray(zeros if a is None else a, np.float64), direction.shape)
        for a in (rays.origin, rays.right, rays.down)
    )
    edges = np.stack([right, down], axis=-2)
    return plain(origin), np.zeros_like(edges), plain(direction), edges


def _positive(name: str, value: int) -> None:
    if value < 1:
        raise InputError(f"`{name}` must be at least 1, but is {value}")


def _share(work: Callable[[Any], np.ndarray], jobs: Any) -> list[np.ndarray]:
    """Do the jobs on all processors of this process: compiled code holds no lock."""
    jobs = list(jobs)
    first = work(jobs[0])  # compile once
    processors = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else 1
    with ThreadPoolExecutor(processors) as pool:
        return [first, *pool.map(work, jobs[1:])]

"""Light of a flash LiDAR that is scattered more than once: how much, and how late.

A flash lights the whole scene at once, so what its light comes to in the end is that of a sun
overhead: the diffuse light of `solve_light`, in three dimensions. How late it comes is that of a
plane-parallel canopy of the same mean leaf area and the same gap straight down, whose leaves
scatter evenly in all directions: a path of length s turns the phase of light modulated with the
wavenumber k by k s, as if the extinction along it were larger by ik. So all orders of scattering
are one solve of the integral equation of transfer for each wavenumber, and the distribution of
delays is its Fourier transform.
"""

import dataclasses
import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Complex, Float

from fynjax.canopy import projections
from fynjax.radiation import Illumination, Light, VoxelScene, diffuse_sources, solve_light

_LAYERS = 24  # of the plane-parallel canopy
_TOGETHER = 3  # layers whose delays are averaged
_SLOPES = 6  # zenith angles in a hemisphere
_LONGEST = 16.0  # delays that are distinguished reach so far [m]
_SHARPEST = 6.0  # wavenumbers beyond this over the pulse's standard deviation leave no trace


class LateLight(eqx.Module):
    """What light scattered before sends to a flash LiDAR, in one band, straight up."""

    leaves: Float[Array, "z y x"]
    """Apparent reflectance per length of the way through a voxel, without shade [m-1]."""
    ground: Float[Array, "y x"]
    """Apparent reflectance of the bare ground [-]."""
    light: Light


@eqx.filter_jit
def late_light(scene: VoxelScene) -> LateLight:
    """The light that a flash leaves in a scene of one band; differentiable in all of it."""
    dtype = scene.area_density.dtype
    with jax.ensure_compile_time_eval():  # numbers: of a sun known to be overhead a beam is enough
        none, one = jnp.zeros((), dtype), jnp.ones(1, dtype)
    flash = Illumination(none, none, one, jnp.zeros_like(one))
    light = solve_light(dataclasses.replace(scene, illumination=flash))
    leaves, ground = diffuse_sources(light, jnp.array([0.0, 0.0, 1.0], dtype))
    return LateLight(jnp.pi * leaves[0, : scene.shape[0]], jnp.pi * ground[0], light)


class Delays(eqx.Module):
    """Distribution of the delay in range, by the height where light was scattered last."""

    heights: Float[Array, " node"]
    """Heights above the bottom of the grid, rising [m]."""
    leaves: Float[Array, "node delay"]
    """Share of the light that leaves scatter last in each step of delay [-]."""
    ground: Float[Array, " delay"]
    """Share of the light that the ground scatters last in each step of delay [-]."""


@eqx.filter_jit
def delays(late: LateLight, step: float, pulse_sd: float, least: int) -> Delays:
    """Delays in steps of `step` [m], as many as a power of two that is `least` or more.

    Periodic: the last steps are delays just below zero, where the band limit leaves a trace.
    """
    count = 1 << max(least - 1, math.ceil(_LONGEST / step)).bit_length()
    wavenumber = 2.0 * np.pi * np.fft.rfftfreq(count, step)
    wavenumber = wavenumber[wavenumber < _SHARPEST / pulse_sd]
    heights, leaves, ground = _spectra(late.light, wavenumber)

    def distribution(spectrum: Array) -> Array:
        return jnp.fft.irfft(spectrum, count, axis=0).T

    return Delays(heights, distribution(leaves), distribution(ground))


def _spectra(
    light: Light, wavenumber: np.ndarray
) -> tuple[Float[Array, " node"], Complex[Array, "k node"], Complex[Array, " k"]]:
    """Fourier transforms of the distributions, at wavenumbers of range [m-1]."""
    scene = light.scene
    dtype = scene.area_density.dtype
    level = jnp.zeros((), dtype) if scene.terrain is None else scene.terrain.mean()
    edges = level + (scene.height - level) * jnp.linspace(0.0, 1.0, _LAYERS + 1, dtype=dtype)
    thick = edges[1] - edges[0]
    middle = 0.5 * (edges[1:] + edges[:-1])
    points, halves = np.polynomial.legendre.leggauss(_SLOPES)
    cosine = jnp.asarray(np.r_[0.5 * (points + 1.0), 1.0], dtype)  # the last: straight down
    weights = jnp.asarray(0.5 * halves, dtype)
    extinction, albedo = _mean_canopy(light, edges, cosine)
    # Seen straight down the plants let through more light than their mean area would.
    depth = thick * extinction[-1].sum()
    gap = jnp.clip(light.sun.on_ground.mean(), 1e-6, 1.0)
    clumping = jnp.where(depth > 1e-6, -jnp.log(gap) / jnp.where(depth > 1e-6, depth, 1.0), 1.0)
    extinction = jnp.minimum(clumping, 1.0) * extinction

    # The Fourier transform of a delay is a phase: a complex extinction along the path.
    way = thick / cosine[:, None]  # [direction, 1]
    turn = 0.5j * jnp.asarray(wavenumber, dtype)  # delay in range is half the excess of the path
    x = way * (extinction + turn[:, None, None])  # [k, direction, layer]
    below = jnp.concatenate([jnp.zeros_like(x[..., :1]), jnp.cumsum(x, axis=-1)], axis=-1)
    leaving = _leaving(x)  # from an even layer, or into one

    # Straight down, to the first collision.
    above = below[:, -1, -1:] - below[:, -1]
    depth_here = thick * extinction[-1]
    # Light that meets each layer first, and the ground last.
    first = jnp.concatenate(
        [jnp.exp(-above[:, 1:]) * depth_here * leaving[:, -1], jnp.exp(-above[:, :1])], axis=-1
    )

    # From layer to layer and ground, evenly in all directions: half of it up, half down.
    x, below, leaving, way = x[:, :-1], below[:, :-1], leaving[:, :-1], way[:-1]
    lower = np.arange(_LAYERS)[:, None] < np.arange(_LAYERS)
    between = below[..., None, :-1] - below[..., 1:, None]  # [k, direction, from, to]
    through = jnp.where(lower, jnp.exp(-jnp.where(lower, between, 0.0)), 0.0)
    through = through + jnp.swapaxes(through, -1, -2)
    share = weights * cosine[:-1]
    to_ground = jnp.exp(-below[..., :-1])

    def arriving(received: Array) -> Array:
        """What is received per length of way, [k, to, from]; the ground comes last."""
        # From an even layer (f) through those between into another (t), in each direction (d).
        far = jnp.einsum(
            "d,kdf,kdft,dt,kdt->ktf", 0.5 * weights, leaving, through, received, leaving
        )
        # What a layer receives from itself.
        near = jnp.einsum("d,dt,kdt->kt", weights, received, _staying(x))
        layers = far + near[..., None] * jnp.eye(_LAYERS)
        risen = jnp.einsum("d,kdt,dt,kdt->kt", 2.0 * share, to_ground, received, leaving)
        fallen = jnp.einsum("d,kdf,kdf->kf", 0.5 * weights, leaving, to_ground)
        ground = jnp.concatenate([fallen, jnp.zeros_like(fallen[:, :1])], axis=-1)
        return jnp.concatenate(
            [jnp.concatenate([layers, risen[..., None]], axis=-1), ground[:, None]], axis=1
        )

    met = arriving(way * extinction[:-1]) * albedo
    light_of = arriving(way * jnp.ones_like(extinction[:-1])) * albedo
    # All orders: (1 - met) scattered = first.
    scattered = jnp.linalg.solve(jnp.eye(_LAYERS + 1) - met, first[..., None])
    found = (light_of @ scattered)[..., 0]
    # Relative to light that comes straight.
    depths = jnp.append(scene.height - middle, scene.height - level)
    found = found * jnp.exp(turn[:, None] * depths)
    grouped = found[:, :-1].reshape(len(wavenumber), -1, _TOGETHER).sum(axis=-1)
    return (
        middle.reshape(-1, _TOGETHER).mean(axis=1),
        _normalised(grouped),
        _normalised(found[:, -1]),
    )


def _normalised(found: Array) -> Array:
    """Divided by the whole; where no light was scattered before, all comes without delay."""
    whole = jnp.real(found[0])
    some = whole > 0
    return jnp.where(some, found / jnp.where(some, whole, 1.0), 1.0)


def _mean_canopy(
    light: Light, edges: Float[Array, " edge"], cosine: Float[Array, " direction"]
) -> tuple[Array, Array]:
    """Extinction [direction, layer] [m-1] and the share of the light that layers and, last, the
    ground scatter on [-]."""
    scene, classes = light.scene, light.scene.classes
    dtype = edges.dtype
    bottom = scene.vertical * jnp.arange(scene.shape[0], dtype=dtype)
    covered = jnp.clip((edges[:, None] - bottom) / scene.vertical, 0.0, 1.0)
    overlap = jnp.diff(covered, axis=0) * scene.vertical / (edges[1] - edges[0])
    density = scene.area_density.mean(axis=(2, 3)) @ overlap.T  # [class, layer]
    projection = projections(classes.angles, cosine).astype(dtype)
    projection = projection[jnp.asarray(classes.angle_of_class)]
    area = density.sum(axis=0)
    scattering = classes.reflectance[:, 0] + classes.transmittance[:, 0]
    some = area > 0
    albedo = jnp.where(some, scattering @ density / jnp.where(some, area, 1.0), 0.0)
    ground = scene.ground_map[0].mean()
    return jnp.einsum("cd,cl->dl", projection, density), jnp.append(albedo, ground)


def _leaving(x: Array) -> Array:
    """(1 - exp(-x)) / x: mean transmittance from within an even layer."""
    small = jnp.abs(x) < 1e-3
    safe = jnp.where(small, 1.0, x)
    return jnp.where(small, 1.0 - x / 2.0 + x**2 / 6.0, -jnp.expm1(-safe) / safe)


def _staying(x: Array) -> Array:
    """(1 - (1 - exp(-x)) / x) / x: what an even layer receives from itself, over its depth."""
    small = jnp.abs(x) < 1e-2
    safe = jnp.where(small, 1.0, x)
    series = 0.5 - x / 6.0 + x**2 / 24.0 - x**3 / 120.0
    return jnp.where(small, series, (1.0 - _leaving(safe)) / safe)

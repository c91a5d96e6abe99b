"""Scenes, angles and compiled solvers that the tests of radiation share."""

import dataclasses
from functools import lru_cache
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from fynjax.canopy import AbstractLeafAngle, SphericalLeafAngle, leaf_angle
from fynjax.radiation import (
    Accuracy,
    Illumination,
    Light,
    OpticalClasses,
    VoxelScene,
    directional_reflectance,
    fluxes,
    solve_light,
)

FINE = Accuracy(lattice=1, coarsening=(1, 1), levels=6, azimuths=8, tolerance=1e-9, iterations=200)
"""For a laterally uniform slab of thin layers: only the quadrature of directions is left."""


@lru_cache
def solver(accuracy: Accuracy) -> Any:
    """Compiled `solve_light`; one compilation for all scenes of equal shape."""
    return jax.jit(lambda scene: solve_light(scene, accuracy))


reflectance_of = jax.jit(directional_reflectance)
fluxes_of = jax.jit(fluxes)


def slab(
    lai: float,
    optics: list[tuple[float, float, float]],
    sun_zenith: float,
    *,
    angle: AbstractLeafAngle | None = None,
    sky: float = 0.0,
    layers: int = 20,
    columns: int = 2,
) -> VoxelScene:
    """A uniform canopy of 1 m over uniform soil, one band per (rho, tau, soil)."""
    rho, tau, soil = jnp.asarray(optics, float).T
    ones = jnp.ones(len(optics))
    return VoxelScene(
        jnp.full((1, layers, columns, columns), float(lai)),
        OpticalClasses(
            rho[None], tau[None], (SphericalLeafAngle() if angle is None else angle,), (0,)
        ),
        soil,
        Illumination(jnp.array(float(sun_zenith)), jnp.array(270.0), ones * (1 - sky), ones * sky),
        1.0,
        1.0 / layers,
    )


def patchy(
    boundary: str = "periodic",
    *,
    shape: tuple[int, int, int] = (4, 6, 8),
    sun: tuple[float, float] = (33.0, 50.0),
    sky: tuple[float, float] = (0.2, 0.1),
    seed: int = 0,
    size: float = 0.1,
) -> VoxelScene:
    """Two bands, three classes of two distributions, one of them opaque, over a map of soils.

    Four voxels in ten are empty, so optical depths run from none to several.
    """
    rng = np.random.default_rng(seed)
    full = (3, *shape)
    density = rng.gamma(0.4, 2.0, full) * (rng.random(full) > 0.4)
    rho, tau = rng.uniform(0, 0.5, (3, 2)), rng.uniform(0, 0.45, (3, 2))
    tau[2] = 0.0
    return VoxelScene(
        jnp.asarray(density),
        OpticalClasses(
            jnp.asarray(rho),
            jnp.asarray(tau),
            (leaf_angle("planophile"), leaf_angle("spherical")),
            (0, 1, 1),
        ),
        jnp.asarray(rng.uniform(0.05, 0.3, (2, *shape[1:]))),
        Illumination(jnp.array(sun[0]), jnp.array(sun[1]), 1 - jnp.asarray(sky), jnp.asarray(sky)),
        size,
        size,
        boundary,
    )


def with_shape(scene: VoxelScene, inside: np.ndarray, finer: int, density: float) -> VoxelScene:
    """`scene` with leaves of `density` [m2 m-3] where points, whole numbers of them along the edges
    of its voxels, lie `inside`; and with a structure of `finer` voxels along an edge, or none."""

    def share(shape: tuple[int, ...]) -> jax.Array:
        blocks = [n for size, points in zip(shape, inside.shape) for n in (size, points // size)]
        mean = inside.reshape(blocks).mean(axis=(1, 3, 5))
        return jnp.asarray(density * mean, scene.area_density.dtype)

    structure = share(tuple(n * finer for n in scene.shape)) if finer else None
    return dataclasses.replace(scene, area_density=share(scene.shape)[None], structure=structure)


def towards(vectors_zenith: Any, azimuth: Any) -> np.ndarray:
    """Unit vectors (x east, y north, z up) towards angles in degrees."""
    zenith, azimuth = np.deg2rad(vectors_zenith), np.deg2rad(azimuth)
    return np.stack(
        np.broadcast_arrays(
            np.sin(zenith) * np.sin(azimuth), np.sin(zenith) * np.cos(azimuth), np.cos(zenith)
        ),
        axis=-1,
    )


def views_of_reference(views: Any) -> tuple[np.ndarray, np.ndarray]:
    """Zenith and azimuth of reference views, whose sunlight travels east (sun at 270 degrees).

    They count the zenith angle positive on the forward side and azimuths counter-clockwise.
    """
    signed, offset = np.asarray(views, float).T
    return np.abs(signed), np.where(signed >= 0, 90.0, 270.0) - offset


def spherical_gamma(scattering: np.ndarray, rho: float, tau: float) -> np.ndarray:
    """Area scattering function of spherical leaf angles by scattering angle [rad] (Ross 1981)."""
    b = scattering
    return (rho + tau) / (3 * np.pi) * (np.sin(b) - b * np.cos(b)) + tau / 3 * np.cos(b)


def closure(light: Light) -> np.ndarray:
    """What the canopy and the soil absorb and the sky gets back, per band; one if none is lost."""
    flux = fluxes_of(light)
    return np.asarray(flux.albedo + flux.absorbed.sum(axis=1) + flux.ground_absorbed)

"""An independent Monte Carlo of a voxel canopy, for tests only.

Photons fly through the voxels by delta tracking, meet leaves whose normals are drawn in
proportion to what they show, and leave them by Lambert's law. No quadrature, no lattice, no
coarse grid: it shares nothing with the solver but the meaning of its input.
"""

from typing import Any, NamedTuple

import numba
import numpy as np


class Estimate(NamedTuple):
    """Means over batches and their standard errors."""

    mean: np.ndarray
    error: np.ndarray


@numba.njit
def _inclination(second: float, spherical: bool) -> float:
    """Draw the inclination of a normal by rejection [rad]."""
    while True:
        angle = 0.5 * np.pi * np.random.random()
        wave = (1 + second * np.cos(2 * angle)) / (1 + abs(second))
        keep = np.sin(angle) if spherical else wave
        if np.random.random() < keep:
            return angle


@numba.njit
def _normal(d: np.ndarray, second: float, spherical: bool) -> np.ndarray:
    """A normal that faces the photon, drawn with the leaves' visibility."""
    while True:
        leaf = _inclination(second, spherical)
        turn = 2 * np.pi * np.random.random()
        n = np.array([np.sin(leaf) * np.cos(turn), np.sin(leaf) * np.sin(turn), np.cos(leaf)])
        facing = n @ d
        if np.random.random() < abs(facing):
            return -n if facing > 0 else n


@numba.njit
def _lambert(n: np.ndarray) -> np.ndarray:
    """A direction about `n`: the normal plus a point of the unit sphere."""
    z = 2 * np.random.random() - 1
    turn = 2 * np.pi * np.random.random()
    s = np.sqrt(1 - z * z)
    d = n + np.array([s * np.cos(turn), s * np.sin(turn), z])
    return d / np.sqrt(d @ d)


@numba.njit
def _projection(cosine: float, second: float, spherical: bool) -> float:
    """G by the midpoint rule over inclination and azimuth."""
    if spherical:
        return 0.5
    total = 0.0
    sine = np.sqrt(max(1 - cosine * cosine, 0.0))
    for i in range(90):
        leaf = (i + 0.5) * 0.5 * np.pi / 90
        density = 2 / np.pi * (1 + second * np.cos(2 * leaf))
        for j in range(90):
            turn = (j + 0.5) * np.pi / 90
            facing = cosine * np.cos(leaf) + sine * np.sin(leaf) * np.cos(turn)
            total += density * abs(facing)
    return total * 0.5 * np.pi / 90 / 90


@numba.njit
def _batch(
    seed: int, photons: int, density: np.ndarray, voxel: np.ndarray, projections: np.ndarray,
    second: np.ndarray, spherical: np.ndarray, rho: np.ndarray, tau: np.ndarray,
    soil: np.ndarray, sunward: np.ndarray, sky: float,
) -> np.ndarray:  # fmt: skip
    """[albedo, transmitted, transmitted direct, soil, nadir BRF, absorbed by each class...]"""
    np.random.seed(seed)
    classes, nz, ny, nx = density.shape
    dx, dz = voxel
    top = nz * dz
    bins = projections.shape[1] - 1
    out = np.zeros(5 + classes)
    columns = np.zeros((nz + 1, ny, nx))  # optical depth straight up to the top, per layer's floor
    for k in range(nz - 1, -1, -1):
        for c in range(classes):
            columns[k] += projections[c, bins] * density[c, k] * dz
        columns[k] += columns[k + 1]
    largest = density.sum(axis=0).max()
    for _ in range(photons):
        x, y, z = np.random.random() * nx * dx, np.random.random() * ny * dx, top
        diffuse = np.random.random() < sky
        d = _lambert(np.array([0.0, 0.0, -1.0])) if diffuse else -sunward
        weight, order = 1.0, 0
        while True:
            # No class projects more than its whole area.
            step = -np.log(1 - np.random.random()) / largest
            limit = (top - z) / d[2] if d[2] > 0 else -z / d[2]
            at_edge = step >= limit
            step = min(step, limit)
            x, y, z = (x + d[0] * step) % (nx * dx), (y + d[1] * step) % (ny * dx), z + d[2] * step
            i, j = min(int(x / dx), nx - 1), min(int(y / dx), ny - 1)
            if at_edge and d[2] > 0:
                out[0] += weight
                break
            if at_edge:
                z = 0.0
                out[1] += weight
                if order == 0 and not diffuse:
                    out[2] += weight
                out[3] += weight * (1 - soil[j, i])
                weight *= soil[j, i]
                n = np.array([0.0, 0.0, 1.0])
                above = columns[0, j, i]
            else:
                k = min(int(z / dz), nz - 1)
                u = abs(d[2]) * bins
                low = min(int(u), bins - 1)
                draw = np.random.random() * largest
                met = -1
                for c in range(classes):
                    g = projections[c, low] + (u - low) * (
                        projections[c, low + 1] - projections[c, low]
                    )
                    draw -= g * density[c, k, j, i]
                    if draw < 0:
                        met = c
                        break
                if met < 0:
                    continue
                out[5 + met] += weight * (1 - rho[met] - tau[met])
                n = _normal(d, second[met], spherical[met])
                whole = rho[met] + tau[met]
                if np.random.random() * whole >= rho[met]:
                    n = -n
                weight *= whole
                share = (k + 1) - z / dz
                above = columns[k + 1, j, i] + share * (columns[k, j, i] - columns[k + 1, j, i])
            order += 1
            if n[2] > 0:
                out[4] += weight * n[2] * np.exp(-above)
            if weight < 0.1:
                if np.random.random() > 0.5:
                    break
                weight *= 2
            d = _lambert(n)
            if abs(d[2]) < 1e-9:
                break
    return out / photons


def simulate(scene: Any, band: int, photons: int, batches: int = 20) -> dict[str, Estimate]:
    """Fluxes and the nadir reflectance factor of a periodic `VoxelScene` in one band."""
    light, classes = scene.illumination, scene.classes
    angles = [classes.angles[owner] for owner in classes.angle_of_class]
    spherical = np.array([not hasattr(angle, "second") for angle in angles])
    second = np.array([float(getattr(angle, "second", 0.0)) for angle in angles])
    projections = np.array(
        [
            [_projection(cosine, a, s) for cosine in np.linspace(0, 1, 201)]
            for a, s in zip(second, spherical, strict=True)
        ]
    )
    zenith, azimuth = np.deg2rad([float(light.sun_zenith), float(light.sun_azimuth)])
    sunward = np.array(
        [np.sin(zenith) * np.sin(azimuth), np.sin(zenith) * np.cos(azimuth), np.cos(zenith)]
    )
    sky = float(light.sky[band] / (light.sky[band] + light.sun[band]))
    runs = np.array(
        [
            _batch(
                seed, photons // batches, np.asarray(scene.area_density),
                np.array([scene.horizontal, scene.vertical]), projections, second, spherical,
                np.asarray(classes.reflectance)[:, band],
                np.asarray(classes.transmittance)[:, band],
                np.asarray(scene.ground_map)[band], sunward, sky,
            )
            for seed in range(batches)
        ]
    )  # fmt: skip
    mean, error = runs.mean(axis=0), runs.std(axis=0, ddof=1) / np.sqrt(batches)
    names = ("albedo", "transmitted", "transmitted_direct", "ground_absorbed", "nadir")
    found = {name: Estimate(mean[i], error[i]) for i, name in enumerate(names)}
    return {**found, "absorbed": Estimate(mean[5:], error[5:])}

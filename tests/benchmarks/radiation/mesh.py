"""A shrub of explicit flat leaves against its voxel form."""

import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from fynjax.canopy import SphericalLeafAngle, VoxelGrid, deposit
from fynjax.radiation import (
    Accuracy,
    Illumination,
    OpticalClasses,
    VoxelScene,
    directional_reflectance,
    parallel_rays,
    reflectance_factor,
    solve_light,
)
from tests.benchmarks.radiation.report import Figures, Row, Setting, compare, margin_for
from tests.radiation.scenes import towards

SIDE, DIAMETER, LEAVES = 3.0, 0.04, 3000
SUN = (35.0, 50.0)
SKY = np.array([0.22, 0.17, 0.10])
OPTICS = {
    "rho": np.array([0.10, 0.05, 0.48]),
    "tau": np.array([0.06, 0.02, 0.44]),
    "ground": np.array([0.10, 0.14, 0.28]),
}
VIEWS = np.array([(0.0, 0.0), (25.0, 50.0), (35.0, 50.0), (25.0, 230.0), (30.0, 140.0)])
"""Zenith and azimuth: nadir, beside the hot spot, in it, away from the sun, across."""
BANDS = ("560 nm", "665 nm", "842 nm")


def interpreter() -> str | None:
    """A Python that can import Mitsuba, if one is known."""
    named = os.environ.get("FYNJAX_MITSUBA_PYTHON")
    if named:
        return named
    check = subprocess.run([sys.executable, "-c", "import mitsuba"], capture_output=True)
    return sys.executable if check.returncode == 0 else None


def leaves(seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Centres and normals: evenly in a ball of 1 m, turned every way."""
    rng = np.random.default_rng(seed)
    ball = rng.normal(size=(LEAVES, 3))
    ball *= (0.5 * rng.random(LEAVES) ** (1 / 3) / np.linalg.norm(ball, axis=1))[:, None]
    normal = rng.normal(size=(LEAVES, 3))
    return ball + np.array([1.5, 1.5, 0.6]), normal / np.linalg.norm(normal, axis=1, keepdims=True)


def rendered(python: str, samples: int) -> dict[str, np.ndarray]:
    """Mitsuba's images and scene means of the mesh; two halves with other seeds."""
    centre, normal = leaves()
    return path_traced(
        python, samples, centre=centre, normal=normal, diameter=DIAMETER, side=SIDE, copies=0,
        pixels=120, sun=towards(*SUN), direct=1 - SKY, sky=SKY, views=towards(*VIEWS.T), **OPTICS,
    )  # fmt: skip


def path_traced(python: str, samples: int, **scene_of_discs: Any) -> dict[str, np.ndarray]:
    """What `mesh_peer` makes of a scene of discs: its arrays stand there."""
    with tempfile.TemporaryDirectory() as folder:
        scene, images = Path(folder) / "scene.npz", Path(folder) / "images.npz"
        np.savez(scene, **scene_of_discs)
        peer = Path(__file__).with_name("mesh_peer.py")
        command = [python, str(peer), str(scene), str(images), "--samples", str(samples)]
        subprocess.run(command, check=True)
        with np.load(images) as file:
            return dict(file)


def voxel_form(voxel: float, size: float | None) -> VoxelScene:
    """The same leaves' area on a grid."""
    centre, _ = leaves()
    area = jnp.full(LEAVES, np.pi * DIAMETER**2 / 4, jnp.float32)
    grid = VoxelGrid.cover((SIDE, SIDE), 1.2, voxel)
    density = deposit(
        jnp.asarray(centre, jnp.float32), area, jnp.zeros(LEAVES, jnp.int32), grid, 1,
        boundary="open",
    )  # fmt: skip
    rho, tau, ground, sky = (
        jnp.asarray(a, jnp.float32) for a in (*(OPTICS[k] for k in ("rho", "tau", "ground")), SKY)
    )
    diameter = None if size is None else jnp.full(1, size, jnp.float32)
    return VoxelScene(
        density,
        OpticalClasses(rho[None], tau[None], (SphericalLeafAngle(),), (0,), diameter),
        ground,
        Illumination(jnp.float32(SUN[0]), jnp.float32(SUN[1]), 1 - sky, sky),
        voxel,
        voxel,
        "open",
    )


def figures_of(
    peer: dict[str, np.ndarray],
    voxel: float,
    accuracy: Accuracy,
    size: float | None = DIAMETER,
) -> Figures:
    """Bias of the scene's mean per view and band, error of the image in pixels of 10 cm."""
    scene = voxel_form(voxel, size)
    accuracy = margin_for(scene, accuracy)
    light = jax.jit(lambda s: solve_light(s, accuracy))(scene)
    brf = np.asarray(jax.jit(directional_reflectance)(light, *VIEWS.T))
    x = (jnp.arange(60, dtype=jnp.float32) + 0.5) * 0.05
    rays = parallel_rays(x, x, 0.05, jnp.float32(0.0), jnp.float32(0.0))
    image = np.asarray(jax.jit(reflectance_factor)(light, rays)).reshape(3, 30, 2, 30, 2)
    image = image.mean(axis=(2, 4))
    halves = peer["nadir"].reshape(2, 30, 4, 30, 4, 3).mean(axis=(2, 4)).transpose(0, 3, 1, 2)
    want, noise = halves.mean(axis=0), halves[0] - halves[1]
    middle = (np.arange(30) + 0.5) * 0.1 - 1.5
    crown = middle[:, None] ** 2 + middle**2 < 0.45**2
    figures: Figures = {}
    for band, name in enumerate(BANDS):
        off = (image - want)[band]
        mean = want[band].mean()
        square = max((off**2).mean() - (noise[band] ** 2).mean() / 4, 0.0)
        figures[f"image RMSE {name}"] = 100 * np.sqrt(square) / mean
        figures[f"|image bias| {name}"] = 100 * abs(off.mean()) / mean
        figures[f"|bias| of crown {name}"] = 100 * abs(off[crown].mean()) / want[band][crown].mean()
    for index, view in enumerate(VIEWS):
        peer_mean = peer[f"brf_{index}"].mean(axis=0)
        figures[f"|BRF bias| {view[0]:.0f}, {view[1]:.0f} deg"] = 100 * float(
            np.max(np.abs(brf[index] / peer_mean - 1))
        )
    return figures


def mesh_shrub(setting: Setting) -> Iterator[Row]:
    """Explicit leaves, by a path tracer, and the turbid form of the same leaves."""
    python = interpreter()
    if python is None:
        raise FileNotFoundError("no Python with Mitsuba; name one in FYNJAX_MITSUBA_PYTHON")
    peer = rendered(python, 64 if setting.quick else 512)
    accuracy = Accuracy(sublayers=2, coarsening=(1, 1), levels=4, azimuths=8)
    for voxel in (0.1, 0.05):
        name = f"mesh shrub, {100 * voxel:.0f} cm"
        measure = partial(figures_of, peer, voxel)
        for row in compare(name, measure, accuracy, {}):
            yield replace(row, tolerance=5.0)

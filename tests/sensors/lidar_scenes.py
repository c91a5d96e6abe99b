"""Slabs, slopes and simple LiDARs that the LiDAR tests share."""

import dataclasses
from typing import Any

import jax.numpy as jnp
import numpy as np

from fynjax.radiation import VoxelScene, voxel_scene
from fynjax.sensors import FlashGeometry, Lidar, ScanGeometry, shipped_lidar

VOXEL = 0.1


def slab(
    lai: float = 2.0,
    *,
    layers: int = 10,
    rho: float = 0.45,
    tau: float = 0.4,
    ground: float = 0.3,
    angle: Any = "spherical",
    columns: int = 4,
    **options: Any,
) -> VoxelScene:
    """Leaves spread evenly over `layers` layers of 0.1 m, below two empty ones."""
    density = jnp.zeros((1, layers + 2, columns, columns))
    density = density.at[:, :layers].set(lai / (layers * VOXEL))
    return voxel_scene(
        density,
        jnp.array([[rho]]),
        jnp.array([[tau]]),
        voxel=(VOXEL, VOXEL, VOXEL),
        ground=jnp.array([ground]),
        sun_zenith=30.0,
        leaf_angles=angle,
        **options,
    )


def patchy(seed: int = 0, **options: Any) -> VoxelScene:
    """Two kinds of leaves, denser here than there."""
    draw = np.random.default_rng(seed)
    density = jnp.asarray(draw.gamma(0.5, 4.0, (2, 4, 3, 3)))
    return voxel_scene(
        density,
        jnp.array([[0.45], [0.3]]),
        jnp.array([[0.4], [0.1]]),
        voxel=(VOXEL, VOXEL, VOXEL),
        ground=jnp.asarray(draw.uniform(0.1, 0.4, (1, 3, 3))),
        sun_zenith=30.0,
        leaf_angles=["planophile", "spherical"],
        **options,
    )


def scanner(**changes: Any) -> Lidar:
    """The shipped scanner, with another geometry."""
    lidar = shipped_lidar("scanning_lidar")
    assert isinstance(lidar.geometry, ScanGeometry)
    return dataclasses.replace(lidar, geometry=dataclasses.replace(lidar.geometry, **changes))


def flash(**changes: Any) -> Lidar:
    """The paper's flash camera, with another geometry."""
    lidar = shipped_lidar("flash_lidar_paper")
    assert isinstance(lidar.geometry, FlashGeometry)
    return dataclasses.replace(lidar, geometry=dataclasses.replace(lidar.geometry, **changes))


def mirror(**changes: Any) -> Lidar:
    """The shipped miniVUX, with another geometry."""
    lidar = shipped_lidar("minivux_1uav")
    assert isinstance(lidar.geometry, ScanGeometry)
    return dataclasses.replace(lidar, geometry=dataclasses.replace(lidar.geometry, **changes))

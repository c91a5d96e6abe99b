"""An independent Monte Carlo of a `VoxelScene`: slow, exact within its noise, for checks.

It shares nothing with the deterministic solver but the meaning of its input: no quadrature of
directions, no lattice of beams, no coarse grid. Light is traced path by path through the voxels,
or among explicit round leaves drawn from the same densities (`discs`), which gives the hot spot
of leaves of finite size without a model of it.

Leaves reflect and transmit by Lambert's law. Where a scene has a `terrain`, the ground is bilinear
between the column centres (at an open edge the last height goes on), shines by the normal of its
slope, and hides what lies below it: a voxel's density is that of the part above the ground. The
sides of the ground under an open scene are black, and there is no ground beside it.

Compiled by numba on first use (some seconds), so it stands beside the tests:
`from tests import reference`.
"""

from tests.reference._estimate import (
    Estimate,
    FluxEstimates,
    PixelRays,
    disc_fluxes,
    disc_image,
    disc_reflectance,
    first_met,
    fluxes,
    image,
    reflectance,
)
from tests.reference._leaves import Leaves, discs

__all__ = [
    "Estimate",
    "FluxEstimates",
    "Leaves",
    "PixelRays",
    "disc_fluxes",
    "disc_image",
    "disc_reflectance",
    "discs",
    "first_met",
    "fluxes",
    "image",
    "reflectance",
]

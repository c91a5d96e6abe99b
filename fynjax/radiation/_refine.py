"""The diffuse field on the fine grid, from a solve on the coarse one.

The coarse solve finds the light that has been scattered often, which is smooth. The last
scattering and the last flight to where the light is wanted are then followed on the fine grid:
light from the coarse cells is scattered by the leaves of the voxels, and swept once. What the
fine equation leaves over is solved for on the coarse grid (a two-grid cycle: Brandt 1977).
"""

import math

import jax
import jax.numpy as jnp
from jaxtyping import Array

from fynjax.radiation._blocks import block_mean, spread, upsample
from fynjax.radiation._multiple import Bands, Cells, DiffuseField, prepare_transport, relative_size
from fynjax.radiation._ordinates import Ordinates
from fynjax.radiation._scene import VoxelScene


def solve_refined(
    scene: VoxelScene,
    cells: Cells,
    finer: tuple[int, int],
    factor: tuple[int, int],
    ordinates: Ordinates,
    tolerance: float,
    iterations: int,
) -> DiffuseField:
    """Solve for the diffuse field in each band on the coarse grid, and follow it on a finer one.

    `factor` and `finer` are the voxels (in height and width) in a cell of either; `cells` are the
    finer ones. Memory is that of the finer field of all bands. Differentiable: the derivative is
    that of these very steps.
    """
    times = factor[0] // finer[0], factor[1] // finer[1]
    coarse, coarse_bands = prepare_transport(scene, cells.coarser(times), factor, ordinates)
    fine, fine_bands = prepare_transport(scene, cells, finer, ordinates)
    factor = times

    @jax.checkpoint  # the finer fields of one band are recomputed in its backward pass
    def last_flight(band: Bands, field: Array) -> tuple[Array, ...]:
        source = fine.sent(band, upsample(field, factor, scene.boundary))
        intensity, falling, top = fine.light(source, band.sky, band.sun, band.ground, band.shape)
        left_over = fine.sent(band, intensity) - source
        right = block_mean(left_over, factor)
        return intensity, falling, top, right, relative_size(left_over, source)

    def solve_band(bands: tuple[Bands, Bands]) -> DiffuseField:
        low, high = bands
        flux = jnp.asarray(ordinates.fluxes.ravel(), scene.area_density.dtype)
        # What a loose first solve lacks, the second finds in what is left over.
        start, field = coarse.solve(low, math.sqrt(tolerance), iterations, 10 * tolerance)
        # The last flight on finer cells, and what its leaves send differently than the coarse ones.
        intensity, falling, top, right, residual = last_flight(high, field[0])
        # A tenth, for leaves that lose nothing: an error is scattered on and on.
        # Never looser than that, since a tangent is solved as its value is.
        share = 0.1 * jnp.minimum(relative_size(start, right), 100.0)
        _, (more, more_falling, more_top) = coarse.solve_for(
            low, right, tolerance * share, iterations, 10 * tolerance
        )
        # Cell by cell, so that what the leaves take of it is what the coarse grid has them take:
        # energy closes.
        intensity = intensity + spread(more, factor)
        falling = falling + spread(more_falling[:, None], (1, factor[1]))[:, 0]
        return DiffuseField(
            intensity,
            falling,
            jnp.tensordot(flux, falling, axes=1),
            top.mean() + more_top.mean(),
            residual,
        )

    return jax.lax.map(solve_band, (coarse_bands, fine_bands))

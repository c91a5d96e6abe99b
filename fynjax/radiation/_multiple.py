"""Light scattered more than once, and all light of the sky: a linear solve per band.

With S the source that the leaves emit along each ordinate, A the sweep and P the scattering,
S = P (A S + j) + S_sun. The solve of (1 - P A) S = P j + S_sun is by conjugate residuals, and its
derivative is one solve with the transposed operator (implicit differentiation), never a tape
through the iterations.
"""

from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from fynjax.radiation._ordinates import Ordinates, coarse_grid, sweep
from fynjax.radiation._phase import area_scattering
from fynjax.radiation._scene import OpticalClasses, VoxelScene
from fynjax.radiation._sun import SunField


class DiffuseField(eqx.Module):
    """Everything but the direct sun, on the coarse grid."""

    intensity: Float[Array, "band ordinate z y x"]
    """Mean radiance in each cell along each ordinate."""
    ground: Float[Array, "band y x"]
    """Diffuse irradiance on the ground."""
    top: Float[Array, " band"]
    """Mean upward flux at the top."""
    residual: Float[Array, " band"]
    """What the solve left over, relative to its right-hand side [-]."""


def block_mean(
    field: Float[Array, "*batch z y x"], factor: tuple[int, int]
) -> Float[Array, "*batch Z Y X"]:
    """Average over blocks of `factor` = (layers, columns) voxels."""
    *batch, nz, ny, nx = field.shape
    fz, fh = factor
    blocks = field.reshape(*batch, nz // fz, fz, ny // fh, fh, nx // fh, fh)
    return blocks.mean(axis=(-5, -3, -1))


def scattering_matrices(
    classes: OpticalClasses, ordinates: Ordinates, incoming: Float[Array, "incoming 3"]
) -> tuple[Float[Array, "angle incoming ordinate"], Float[Array, "angle incoming ordinate"]]:
    """Gamma_r and Gamma_t from `incoming` to the ordinates, over pi, normalised.

    Scaled so that the discrete sum over the ordinates is exactly the projection G of the
    incoming direction: whatever the quadrature, a leaf that absorbs nothing loses nothing.
    """
    vectors = jnp.asarray(ordinates.vectors, incoming.dtype)
    weights = jnp.asarray(ordinates.weights, incoming.dtype)
    reflected: list[Array] = []
    transmitted: list[Array] = []
    for angle in classes.angles:
        projection = angle.projection(incoming[:, 2]).astype(incoming.dtype)
        for kind, into in zip(area_scattering(angle, incoming, vectors), (reflected, transmitted)):
            scaled = kind / jnp.pi
            into.append(scaled * (projection / (scaled @ weights))[:, None])
    return jnp.stack(reflected), jnp.stack(transmitted)


def solve_diffuse(
    scene: VoxelScene,
    sun: SunField,
    factor: tuple[int, int],
    ordinates: Ordinates,
    tolerance: float,
    iterations: int,
) -> DiffuseField:
    """Solve for the diffuse field in each band, one band after another.

    Memory is that of one band's intensity times the few directions that the solver keeps.
    """
    dtype = scene.area_density.dtype
    classes = scene.classes
    density = block_mean(scene.area_density, factor)
    coarse = coarse_grid(scene, density, factor, ordinates)
    lit = block_mean(scene.area_density * sun.voxel_transmittance, factor)
    margin = sun.margin
    beams = jnp.exp(-sun.depth[0])
    beams = beams[margin : beams.shape[0] - margin, margin : beams.shape[1] - margin]
    per_cell = sun.per_voxel * factor[1]
    reached = block_mean(beams[None], (1, per_cell))[0]

    travel = -jnp.concatenate([sun.slope, jnp.ones(1, dtype)]) * sun.cosine
    vectors = jnp.asarray(ordinates.vectors, dtype)
    weights = jnp.asarray(ordinates.weights, dtype)
    reflect, transmit = scattering_matrices(classes, ordinates, vectors)
    reflect, transmit = reflect * weights[:, None], transmit * weights[:, None]
    sun_reflect, sun_transmit = scattering_matrices(classes, ordinates, travel[None])
    ground = block_mean(scene.ground_map[:, None], (1, factor[1]))[:, 0]
    shape = (len(ordinates.weights), *density.shape[1:])

    # Matrix products on flat cells: [ordinate, ordinate] x [ordinate, cell].
    cells = density[0].size
    per_angle = [(reflect[a].T, transmit[a].T) for a in range(len(classes.angles))]

    def band(args: tuple[Array, ...]) -> tuple[Array, ...]:
        rho, tau, soil, sun_flux, sky_flux = args

        def weighted(field: Array, optics: Array) -> Array:
            """Area times optics, summed over the classes of each distribution: [angle, cell]."""
            total = classes.total_by_angle(field * optics[:, None, None, None])
            return total.reshape(-1, cells)

        reflecting, transmitting = weighted(density, rho), weighted(density, tau)
        beam = sun_flux / sun.cosine
        from_sun = beam * (
            sun_reflect[:, 0].T @ weighted(lit, rho) + sun_transmit[:, 0].T @ weighted(lit, tau)
        )

        def scatter(intensity: Array) -> Array:
            flat = intensity.reshape(-1, cells)
            total = jnp.zeros_like(flat)
            for index, (mirror, pass_on) in enumerate(per_angle):
                total = total + reflecting[index] * (mirror @ flat)
                total = total + transmitting[index] * (pass_on @ flat)
            return total.reshape(shape)

        nothing, no_sun = jnp.zeros((), dtype), jnp.zeros_like(soil)
        sky = sky_flux / jnp.pi
        first, _, _ = sweep(coarse, jnp.zeros(shape, dtype), sky, soil, sun_flux * reached)
        right = scatter(first) + from_sun.reshape(shape)

        def operator(source: Array) -> Array:
            intensity, _, _ = sweep(coarse, source, nothing, soil, no_sun)
            return source - scatter(intensity)

        source = _solve(operator, right, tolerance, iterations)
        intensity, diffuse, top = sweep(coarse, source, sky, soil, sun_flux * reached)
        left_over = scatter(intensity) + from_sun.reshape(shape) - source
        scale = jnp.linalg.norm(right.ravel())
        residual = jnp.linalg.norm(left_over.ravel()) / jnp.where(scale > 0, scale, 1.0)
        return intensity, diffuse, top.mean(), jax.lax.stop_gradient(residual)

    light = scene.illumination
    arguments = (
        classes.reflectance.T,
        classes.transmittance.T,
        ground,
        light.sun.astype(dtype),
        light.sky.astype(dtype),
    )
    return DiffuseField(*jax.lax.map(band, arguments))


def _solve(
    operator: Callable[[Array], Array], right: Array, tolerance: float, iterations: int
) -> Array:
    """Solve operator(x) = right, differentiably."""

    def solve(matvec: Callable[[Array], Array], right: Array) -> Array:
        return _gcr(matvec, right, tolerance, iterations)

    return jax.lax.custom_linear_solve(operator, right, solve, transpose_solve=solve)


_KEPT = 6


def _gcr(
    matvec: Callable[[Array], Array], right: Array, tolerance: float, iterations: int
) -> Array:
    """Generalised conjugate residuals (Eisenstat, Elman and Schultz 1983), last few directions.

    One product an iteration, and the residual never grows; the operator's symmetric part is
    positive definite here, because scattering loses light.
    """

    State = tuple[Array, Array, Array, Array, Array]

    def going(state: State) -> Array:
        _, residual, _, _, count = state
        return (residual @ residual > goal) & (count < iterations)

    def iterate(state: State) -> State:
        solution, residual, directions, images, count = state
        image = matvec(residual.reshape(right.shape)).ravel()
        # Make the new image orthogonal to the kept ones, which have unit length.
        share = images @ image
        image = image - share @ images
        direction = residual - share @ directions
        length = jnp.sqrt(image @ image)
        scale = jnp.where(length > 0, 1.0 / jnp.where(length > 0, length, 1.0), 0.0)
        image, direction = image * scale, direction * scale
        step = image @ residual
        slot = count % _KEPT
        return (
            solution + step * direction,
            residual - step * image,
            directions.at[slot].set(direction),
            images.at[slot].set(image),
            count + 1,
        )

    flat = right.ravel()
    goal = tolerance**2 * (flat @ flat)
    none = jnp.zeros((_KEPT, flat.size), flat.dtype)
    start = (jnp.zeros_like(flat), flat, none, none, jnp.zeros((), jnp.int32))
    return jax.lax.while_loop(going, iterate, start)[0].reshape(right.shape)


def upsample(
    field: Float[Array, "*batch Z Y X"], factor: tuple[int, int], boundary: str
) -> Float[Array, "*batch z y x"]:
    """Linear interpolation of coarse cell means to the fine voxels' centres."""
    matrices = [
        _linear(field.shape[-3], factor[0], "open"),
        _linear(field.shape[-2], factor[1], boundary),
        _linear(field.shape[-1], factor[1], boundary),
    ]
    z, y, x = (jnp.asarray(m, field.dtype) for m in matrices)
    return jnp.einsum("aZ,bY,cX,...ZYX->...abc", z, y, x, field, optimize="optimal")


def _linear(count: int, factor: int, boundary: str) -> np.ndarray:
    """Weights [count * factor, count] of linear interpolation between cell centres."""
    position = (np.arange(count * factor) + 0.5) / factor - 0.5
    low = np.floor(position).astype(int)
    share = position - low
    weights = np.zeros((count * factor, count))
    for index, weight in ((low, 1 - share), (low + 1, share)):
        cell = index % count if boundary == "periodic" else np.clip(index, 0, count - 1)
        np.add.at(weights, (np.arange(count * factor), cell), weight)
    return weights

"""Light scattered more than once, and all light of the sky: a linear solve per band.

With S the source that the leaves emit along each ordinate, A the sweep and P the scattering,
S = P (A S + j) + S_sun. The solve of (1 - P A) S = P j + S_sun is by conjugate residuals, and its
derivative is one solve with the transposed operator (implicit differentiation), never a tape
through the iterations.
"""

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from fynjax._core.geometry import direction
from fynjax.canopy import projections
from fynjax.radiation._blocks import block_mean
from fynjax.radiation._ordinates import (
    Coarse,
    GroundShape,
    Ordinates,
    coarse_grid,
    sky_radiance,
    sweep,
)
from fynjax.radiation._phase import area_scattering_of
from fynjax.radiation._scene import OpticalClasses, VoxelScene
from fynjax.radiation._sun import SunField

Lit = tuple[
    Float[Array, "ordinate z y x"], Float[Array, "downward y x"], Float[Array, "y x"]
]  # fmt: skip
"""Light of one band as a sweep returns it: mean radiance in each cell, radiance that falls on the
ground, upward flux at the top."""


class DiffuseField(eqx.Module):
    """Everything but the direct sun, on the coarse grid."""

    intensity: Float[Array, "band ordinate z y x"]
    """Mean radiance in each cell along each ordinate."""
    falling: Float[Array, "band downward y x"]
    """Radiance that falls on the ground along each downward ordinate."""
    ground: Float[Array, "band y x"]
    """Diffuse irradiance on the ground, per level area."""
    top: Float[Array, " band"]
    """Mean upward flux at the top."""
    residual: Float[Array, " band"]
    """What the equation of the source leaves over, relative to the source [-]."""

    def factor(self, scene: VoxelScene) -> tuple[int, int]:
        """Voxels in one of its cells, in height and in width."""
        depth, _, width = self.intensity.shape[2:]
        return scene.shape[0] // depth, scene.shape[2] // width

    def bands(self, start: Int[Array, ""] | int, size: int) -> "DiffuseField":
        """The field of `size` bands from `start` on, which may be a traced value."""
        return jax.tree.map(lambda a: jax.lax.dynamic_slice_in_dim(a, start, size), self)


def scattering_matrices(
    classes: OpticalClasses, ordinates: Ordinates, incoming: Float[Array, "incoming 3"]
) -> tuple[Float[Array, "angle incoming ordinate"], Float[Array, "angle incoming ordinate"]]:
    """Gamma_r and Gamma_t from `incoming` to the ordinates, over pi, normalised.

    Scaled so that the discrete sum over the ordinates is exactly the projection G of the
    incoming direction: whatever the quadrature, a leaf that absorbs nothing loses nothing.
    """
    vectors = jnp.asarray(ordinates.vectors, incoming.dtype)
    weights = jnp.asarray(ordinates.weights, incoming.dtype)
    projection = projections(classes.angles, incoming[:, 2]).astype(incoming.dtype)
    scaled = jnp.stack(area_scattering_of(classes.angles, incoming, vectors)) / jnp.pi
    reflected, transmitted = scaled * (projection / (scaled @ weights))[..., None]
    return reflected, transmitted


class Bands(eqx.Module):
    """What differs between bands on the coarse grid: one band, or many along a first axis."""

    reflectance: Float[Array, "*band class"]
    transmittance: Float[Array, "*band class"]
    ground: Float[Array, "*band y x"]
    """Reflectance of the ground [-]."""
    sun: Float[Array, " *band"]
    """Direct irradiance on the horizontal plane."""
    sky: Float[Array, "*band downward"]
    """Radiance of the sky along each downward ordinate."""
    shape: GroundShape | None
    """How the ground departs from Lambert's law."""

    def __getitem__(self, index: Any) -> "Bands":
        """The bands of an index, a slice or an array of indices."""
        return jax.tree.map(lambda a: a[index], self)

    def slice(self, start: Int[Array, ""] | int, size: int) -> "Bands":
        """`size` bands from `start` on; `start` may be a traced value."""
        return jax.tree.map(lambda a: jax.lax.dynamic_slice_in_dim(a, start, size), self)


class Transport(eqx.Module):
    """Sweep and scattering on the coarse grid: what all bands share."""

    coarse: Coarse
    density: Float[Array, "class z y x"]
    """Area density [m2 m-3]."""
    lit: Float[Array, "class z y x"]
    """Area density times the share that the sun reaches, over the cosine of its zenith angle."""
    reached: Float[Array, "y x"]
    """Direct irradiance on the ground's surface over that above the canopy [-]."""
    phase: Float[Array, "kind angle outgoing incoming"]
    """Scattering from ordinate to ordinate by reflection and by transmission (the two kinds), the
    solid angle of the incoming one included."""
    sun_phase: Float[Array, "kind angle outgoing"]
    """Scattering from the sun's direction."""
    classes: OpticalClasses

    @property
    def shape(self) -> tuple[int, ...]:
        """Ordinates, and cells along z, y, x."""
        return self.phase.shape[-1], *self.density.shape[1:]

    def areas(
        self, field: Float[Array, "class z y x"], band: Bands
    ) -> Float[Array, "kind angle cell"]:
        """Area in `field` times its optics, summed over the classes of each distribution."""
        optics = jnp.stack([band.reflectance, band.transmittance], axis=1)
        weighted = field.reshape(field.shape[0], 1, -1) * optics[:, :, None]
        return jnp.swapaxes(self.classes.total_by_angle(weighted), 0, 1)

    def scatter(
        self,
        areas: Float[Array, "kind angle cell"],
        intensity: Float[Array, "ordinate z y x"],
    ) -> Float[Array, "ordinate z y x"]:
        """Light that leaves send along each ordinate, out of the light along all."""
        # Matrix products on flat cells: [ordinate, ordinate] x [ordinate, cell].
        flat = intensity.reshape(intensity.shape[0], -1)
        # Copied to every ordinate by a product, whose derivative is one too: the sum over
        # ordinates that the compiler makes of a plain product's takes as long as all the rest.
        every = jnp.ones((flat.shape[0], 1), flat.dtype)

        def one(total: Array, at: tuple[Array, Array]) -> tuple[Array, None]:
            matrix, area = at
            return total + (every @ area[None]) * (matrix @ flat), None

        pairs = self.phase.reshape(-1, *self.phase.shape[2:]), areas.reshape(-1, flat.shape[1])
        # Recomputed in the backward pass, a product for each pair need not be kept.
        total, _ = jax.lax.scan(jax.checkpoint(one), jnp.zeros_like(flat), pairs)
        return total.reshape(intensity.shape)

    def from_sun(self, band: Bands) -> Float[Array, "ordinate z y x"]:
        """Sunlight scattered once."""
        areas = self.areas(self.lit, band)
        return band.sun * jnp.einsum("kao,kac->oc", self.sun_phase, areas).reshape(self.shape)

    def light(
        self,
        source: Float[Array, "ordinate z y x"],
        sky: Float[Array, " downward"],
        sun: Float[Array, ""],
        ground: Float[Array, "y x"],
        shape: GroundShape | None = None,
    ) -> tuple[Float[Array, "ordinate z y x"], Float[Array, "downward y x"], Float[Array, "y x"]]:
        """One sweep: intensity, radiance that falls on the ground, upward flux at the top.

        Linear in (`source`, `sky`, `sun`) and affine in `ground`.
        """
        return sweep(self.coarse, source, sky, ground, sun * self.reached, shape)

    def respond(self, source: Float[Array, "ordinate z y x"], band: Bands) -> Lit:
        """The light that `source` makes without sun and sky, as `light` returns it."""
        dark = jnp.zeros_like(band.sky), jnp.zeros_like(band.sun)
        return self.light(source, *dark, band.ground, band.shape)

    def sent(
        self, band: Bands, intensity: Float[Array, "ordinate z y x"]
    ) -> Float[Array, "ordinate z y x"]:
        """What leaves send of one band: out of the diffuse light, and of the sun's."""
        return self.scatter(self.areas(self.density, band), intensity) + self.from_sun(band)

    def operator(self, band: Bands) -> Callable[[Array], Array]:
        """What a source leaves over of itself, once the light it makes is scattered."""
        areas = self.areas(self.density, band)
        return lambda source: source - self.scatter(areas, self.respond(source, band)[0])

    def solve(
        self, band: Bands, tolerance: float, iterations: int, transposed: float | None = None
    ) -> tuple[Float[Array, "ordinate z y x"], Lit]:
        """Source of one band, and the light that it makes together with sun and sky; arguments as
        in `solve_for`."""
        fixed, constant = jax.lax.stop_gradient((self, band))
        nothing = jnp.zeros(self.shape, self.density.dtype)
        first, _, _ = fixed.light(
            nothing, constant.sky, constant.sun, constant.ground, constant.shape
        )
        right = fixed.sent(constant, first)
        source = _solve(fixed.operator(constant), right, tolerance, iterations)
        lit = self.light(source, band.sky, band.sun, band.ground, band.shape)
        return self.complete(
            band, source, lit, self.from_sun(band), tolerance, iterations, transposed
        )

    def solve_for(
        self,
        band: Bands,
        right: Float[Array, "ordinate z y x"],
        tolerance: float | Float[Array, ""],
        iterations: int,
        transposed: float,
    ) -> tuple[Float[Array, "ordinate z y x"], Lit]:
        """Source that `right` becomes when its light is scattered on and on, and that light.

        What is left over is `tolerance` times `right` at most; in the solve of the transposed
        equation, which the derivative takes, `transposed` times.
        """
        fixed, constant = jax.lax.stop_gradient((self, band))
        operator = fixed.operator(constant)
        source = _solve(operator, jax.lax.stop_gradient(right), tolerance, iterations)
        lit = self.respond(source, band)
        return self.complete(band, source, lit, right, tolerance, iterations, transposed)

    def complete(
        self,
        band: Bands,
        source: Float[Array, "ordinate z y x"],
        lit: Lit,
        emitted: Float[Array, "ordinate z y x"],
        tolerance: float | Float[Array, ""],
        iterations: int,
        transposed: float | None = None,
    ) -> tuple[Float[Array, "ordinate z y x"], Lit]:
        """A constant solution of source = scattered light + `emitted`, and its light `lit`, with
        the derivative of the equation.

        The derivative takes one sweep at the solution and one solve, whatever the iterations of
        the solution were.
        """
        left_over = self.scatter(self.areas(self.density, band), lit[0]) + emitted - source
        backward = tolerance if transposed is None else transposed
        more, lit_more = _completion(iterations, self, band, left_over, tolerance, backward)
        return source + more, jax.tree.map(jnp.add, lit, lit_more)

    def field(self, band: Bands, source: Float[Array, "ordinate z y x"], lit: Lit) -> DiffuseField:
        """The light of one band, `lit`, that a source makes together with sun and sky."""
        intensity, falling, top = lit
        flux = jnp.asarray(self.coarse.ordinates.fluxes.ravel(), falling.dtype)
        received = jax.lax.stop_gradient(self.sent(band, intensity))
        residual = relative_size(received - jax.lax.stop_gradient(source), received)
        ground = jnp.tensordot(flux, falling, axes=1)
        return DiffuseField(intensity, falling, ground, top.mean(), residual)


def ground_shape(
    scene: VoxelScene, ordinates: Ordinates, sunward: Float[Array, " 3"]
) -> GroundShape | None:
    """The ground's angular shape on the ordinates, with light of the sun along `sunward`."""
    if scene.ground_shape is None:
        return None
    down, up = jnp.split(jnp.asarray(ordinates.vectors, sunward.dtype), 2)
    return GroundShape(
        scene.ground_shape.shape(down, up), scene.ground_shape.shape(sunward[None], up)[:, 0]
    )


class Cells(NamedTuple):
    """What the diffuse light needs of the voxels: their means in the cells of a coarser grid."""

    density: Float[Array, "class z y x"]
    """Area density [m2 m-3]."""
    lit: Float[Array, "class z y x"]
    """Area density times the share that the sun reaches, over the cosine of its zenith angle."""
    reached: Float[Array, "y x"]
    """Direct irradiance on the ground's surface over that above the canopy [-]."""
    ground: Float[Array, "band y x"]
    """Reflectance of the ground [-]."""

    def coarser(self, factor: tuple[int, int]) -> "Cells":
        """Means over blocks of `factor` = (layers, columns) cells."""
        density, lit = (block_mean(field, factor) for field in (self.density, self.lit))
        reached, ground = (
            block_mean(field[:, None], (1, factor[1]))[:, 0]
            for field in (self.reached[None], self.ground)
        )
        return Cells(density, lit, reached[0], ground)


def cells_of(scene: VoxelScene, sun: SunField, factor: tuple[int, int]) -> Cells:
    """The voxels of a scene in cells of `factor` = (layers, columns) of them."""
    lit = scene.area_density * (sun.voxel_transmittance / sun.cosine)
    return Cells(scene.area_density, lit, sun.on_ground, scene.ground_map).coarser(factor)


def prepare_transport(
    scene: VoxelScene, cells: Cells, factor: tuple[int, int], ordinates: Ordinates
) -> tuple[Transport, Bands]:
    """What all bands share, and what each has of its own. Of `scene` all but the voxels counts."""
    dtype = cells.density.dtype
    classes, light = scene.classes, scene.illumination
    travel = -direction(light.sun_zenith, light.sun_azimuth).astype(dtype)
    vectors = jnp.asarray(ordinates.vectors, dtype)
    weights = jnp.asarray(ordinates.weights, dtype)
    incoming = jnp.concatenate([vectors, travel[None]])
    every = jnp.stack(scattering_matrices(classes, ordinates, incoming))
    phase = every[:, :, :-1] * weights[:, None]
    transport = Transport(
        coarse_grid(scene, cells.density, factor, ordinates),
        cells.density,
        cells.lit,
        cells.reached,
        jnp.swapaxes(phase, 2, 3),
        every[:, :, -1],
        classes,
    )
    bands = Bands(
        classes.reflectance.T,
        classes.transmittance.T,
        cells.ground,
        light.sun.astype(dtype),
        sky_radiance(light, ordinates).astype(dtype),
        ground_shape(scene, ordinates, travel),
    )
    return transport, bands


def solve_diffuse(
    scene: VoxelScene,
    cells: Cells,
    factor: tuple[int, int],
    ordinates: Ordinates,
    tolerance: float,
    iterations: int,
) -> DiffuseField:
    """Solve for the diffuse field in each band, one band after another.

    `cells` are of `factor` voxels. Memory is that of some ten times one band's intensity.
    """
    transport, bands = prepare_transport(scene, cells, factor, ordinates)

    def solve_band(band: Bands) -> DiffuseField:
        return transport.field(band, *transport.solve(band, tolerance, iterations))

    return jax.lax.map(solve_band, bands)


@partial(jax.custom_jvp, nondiff_argnums=(0,))
def _completion(
    iterations: int,
    transport: Transport,
    band: Bands,
    left_over: Array,
    tolerance: float | Float[Array, ""],
    transposed: float | Float[Array, ""],
) -> tuple[Array, Lit]:
    """Zero, with the derivative of the source and the light that `left_over` makes."""
    dark = jax.eval_shape(transport.respond, left_over, band)
    return jnp.zeros_like(left_over), jax.tree.map(lambda a: jnp.zeros(a.shape, a.dtype), dark)


@_completion.defjvp
def _completion_derivative(
    iterations: int, at: tuple[Any, ...], change: tuple[Any, ...]
) -> tuple[Any, Any]:
    # Constants here: the derivative is right once, a second one misses terms.
    transport, band, _, tolerance, transposed = jax.lax.stop_gradient(at)
    operator = transport.operator(band)

    def solve_to(tolerance: float | Float[Array, ""]) -> Callable[..., Array]:
        return lambda matvec, right: _solve(matvec, right, tolerance, iterations)

    source = jax.lax.custom_linear_solve(
        operator, change[2], solve_to(tolerance), transpose_solve=solve_to(transposed)
    )
    return _completion(iterations, *at), (source, transport.respond(source, band))


def _solve(
    operator: Callable[[Array], Array],
    right: Array,
    tolerance: float | Float[Array, ""],
    iterations: int,
) -> Array:
    """Solve operator(x) = right. Not differentiable."""
    goal = jnp.asarray(tolerance, right.dtype)
    # Light is in any unit: squares of very large or small numbers would leave the range.
    largest = jnp.max(jnp.abs(right))
    unit = jnp.where(largest > 0, largest, 1.0)
    return unit * _gcr(operator, right / unit, goal, iterations)


def _gcr(
    matvec: Callable[[Array], Array],
    right: Array,
    tolerance: Float[Array, ""],
    iterations: int,
) -> Array:
    """Generalised conjugate residuals (Eisenstat, Elman and Schultz 1983) that keep one direction.

    One product an iteration, and the residual never grows; the operator's symmetric part is
    positive definite here, because scattering loses light. It is nearly symmetric, so that more
    directions save an iteration in six at most, where leaves lose nothing, and take memory.
    """

    State = tuple[Array, Array, Array, Array, Array]

    def going(state: State) -> Array:
        _, residual, _, _, count = state
        return (residual @ residual > goal) & (count < iterations)

    def iterate(state: State) -> State:
        solution, residual, direction, image, count = state
        new = matvec(residual.reshape(right.shape)).ravel()
        # Make the new image orthogonal to the one before, which has unit length.
        share = image @ new
        image, direction = new - share * image, residual - share * direction
        length = jnp.sqrt(image @ image)
        scale = jnp.where(length > 0, 1.0 / jnp.where(length > 0, length, 1.0), 0.0)
        image, direction = image * scale, direction * scale
        step = image @ residual
        return (
            solution + step * direction,
            residual - step * image,
            direction,
            image,
            count + 1,
        )

    flat = right.ravel()
    goal = tolerance**2 * (flat @ flat)
    none = jnp.zeros_like(flat)
    start = (none, flat, none, none, jnp.zeros((), jnp.int32))
    return jax.lax.while_loop(going, iterate, start)[0].reshape(right.shape)


def relative_size(part: Array, whole: Array) -> Float[Array, ""]:
    """Norm of `part` over that of `whole`, for control and report; 0 where there is nothing.

    In units of the largest number, lest squares leave the range. No derivative.
    """
    part, whole = jax.lax.stop_gradient((part, whole))
    largest = jnp.max(jnp.abs(whole))
    unit = jnp.where(largest > 0, largest, 1.0)
    size = jnp.linalg.norm((part / unit).ravel()), jnp.linalg.norm((whole / unit).ravel())
    return jnp.where(largest > 0, size[0] / jnp.where(largest > 0, size[1], 1.0), 0.0)

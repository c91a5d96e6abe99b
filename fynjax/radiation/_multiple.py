"""Light scattered more than once, and all light of the sky: a linear solve per band.

With S the source that the leaves emit along each ordinate, A the sweep and P the scattering,
S = P (A S + j) + S_sun. The solve of (1 - P A) S = P j + S_sun is by conjugate residuals, and its
derivative is one solve with the transposed operator (implicit differentiation), never a tape
through the iterations.
"""

import dataclasses
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

    intensity: Float[Array, "*band ordinate z y x"]
    """Mean radiance in each cell along each ordinate."""
    falling: Float[Array, "*band downward y x"]
    """Radiance that falls on the ground along each downward ordinate."""
    ground: Float[Array, "*band y x"]
    """Diffuse irradiance on the ground, per level area."""
    top: Float[Array, "*band"]
    """Mean upward flux at the top."""
    residual: Float[Array, "*band"]
    """Remainder of the equation of the source, relative to the source [-]."""

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
    # [reflection or transmission, angle, incoming, ordinate]
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
    """Departure of the ground from Lambert's law."""

    def __getitem__(self, index: Any) -> "Bands":
        """The bands of an index, a slice or an array of indices."""
        return jax.tree.map(lambda a: a[index], self)

    def unlit(self) -> "Bands":
        """The same without sun and sky."""
        return dataclasses.replace(self, sun=jnp.zeros_like(self.sun), sky=jnp.zeros_like(self.sky))

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
        self, areas: Float[Array, "kind angle cell"], intensity: Float[Array, "ordinate z y x"]
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

    def solve(
        self, band: Bands, tolerance: float, iterations: int, transposed: float | None = None
    ) -> tuple[Float[Array, "ordinate z y x"], Lit]:
        """Source of one band, and the light that it makes together with sun and sky; arguments as
        in `solve_for`."""
        source, lit = self._constant(band, tolerance, iterations, light=True)
        emitted = self.from_sun(band)
        return self.complete(band, source, lit, emitted, tolerance, iterations, transposed)

    def source(
        self, band: Bands, tolerance: float, iterations: int
    ) -> Float[Array, "ordinate z y x"]:
        """Source of one band. No derivative."""
        return self._constant(band, tolerance, iterations, light=False)[0]

    def _constant(
        self, band: Bands, tolerance: float, iterations: int, *, light: bool
    ) -> tuple[Float[Array, "ordinate z y x"], Any]:
        fixed, constant = jax.lax.stop_gradient((self, band))
        right = fixed.from_sun(constant)
        # Any light may be the largest: that on leaves, of the sky, or of the sun on the ground.
        unit = jnp.maximum(_largest(right), jnp.maximum(_largest(constant.sky), constant.sun))
        send = fixed.sender(constant, right)
        return _solve(send, right, unit, tolerance, iterations, known=False, light=light)

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
        band = band.unlit()
        fixed, constant, emitted = jax.lax.stop_gradient((self, band, right))
        send = fixed.sender(constant, emitted)
        source, lit = _solve(send, emitted, _largest(emitted), tolerance, iterations)
        return self.complete(band, source, lit, right, tolerance, iterations, transposed)

    def sender(self, band: Bands, emitted: Float[Array, "ordinate z y x"]) -> "_Send":
        """What leaves send of the light of a source; `whole`: and of sun and sky, and what they
        emit."""
        areas = self.areas(self.density, band)

        def send(source: Array, whole: Array) -> tuple[Array, Lit]:
            lit = self.light(source, whole * band.sky, whole * band.sun, band.ground, band.shape)
            return self.scatter(areas, lit[0]) + whole * emitted, lit

        return send

    def complete(
        self,
        band: Bands,
        source: Float[Array, "ordinate z y x"],
        lit: Lit | None,
        emitted: Float[Array, "ordinate z y x"],
        tolerance: float | Float[Array, ""],
        iterations: int,
        transposed: float | None = None,
    ) -> tuple[Float[Array, "ordinate z y x"], Any]:
        """A constant solution of source = scattered light + `emitted`, and its light `lit` if that
        is wanted, with the derivative of the equation.

        The derivative takes one sweep at the solution and one solve, whatever the iterations of
        the solution were.
        """
        backward = tolerance if transposed is None else transposed
        return _with_derivative(iterations, self, band, emitted, source, lit, tolerance, backward)

    def field(self, band: Bands, source: Float[Array, "ordinate z y x"], lit: Lit) -> DiffuseField:
        """The light of one band, `lit`, that a source makes together with sun and sky."""
        intensity, falling, top = lit
        flux = jnp.asarray(self.coarse.ordinates.fluxes.ravel(), falling.dtype)
        # What leaves send of this light should be the source that made it.
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
    # Light on leaves goes with the path through a layer, which the cosine lengthens.
    lit = scene.area_density * (sun.voxel_transmittance / sun.cosine)
    return Cells(scene.area_density, lit, sun.on_ground, scene.ground_map).coarser(factor)


def prepare_transport(
    scene: VoxelScene, cells: Cells, factor: tuple[int, int], ordinates: Ordinates
) -> tuple[Transport, Bands]:
    """What all bands share, and what each has of its own. Of `scene` all but the voxels counts."""
    dtype = cells.density.dtype
    classes, light = scene.classes, scene.illumination
    # Scattering from each ordinate and from the sun to each ordinate.
    travel = -direction(light.sun_zenith, light.sun_azimuth).astype(dtype)
    vectors = jnp.asarray(ordinates.vectors, dtype)
    weights = jnp.asarray(ordinates.weights, dtype)
    # The sun is one incoming direction more, the last.
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
def _with_derivative(
    iterations: int,
    transport: Transport,
    band: Bands,
    emitted: Array,
    source: Array,
    lit: Lit | None,
    tolerance: float | Float[Array, ""],
    transposed: float | Float[Array, ""],
) -> tuple[Array, Any]:
    """`source` and `lit`, with the derivative of the equation that they solve."""
    return source, lit


@_with_derivative.defjvp
def _derivative_of_solution(
    iterations: int, at: tuple[Any, ...], change: tuple[Any, ...]
) -> tuple[Any, Any]:
    # Constants here: the derivative is right once, a second one misses terms.
    transport, band, emitted, source, lit, tolerance, transposed = jax.lax.stop_gradient(at)

    def once(transport: Transport, band: Bands, emitted: Array) -> tuple[Array, Lit]:
        made = transport.light(source, band.sky, band.sun, band.ground, band.shape)
        areas = transport.areas(transport.density, band)
        return transport.scatter(areas, made[0]) + emitted, made

    _, (scattered, light) = jax.jvp(once, (transport, band, emitted), change[:3])
    # Where leaf optics alone change, the light on the way does not. JAX can transpose a solve only
    # if each part of its right-hand side depends on the change, by nothing if need be.
    nothing = 0.0 * scattered.ravel()[0]
    left_over = scattered, jax.tree.map(lambda part: part + nothing, light)
    unlit = band.unlit()

    # The unknowns are the source and the light that it makes, so that the last sweep of a solve is
    # one of its loop, and the first one of the transposed solve's.
    def equation(unknown: tuple[Array, Lit]) -> tuple[Array, Lit]:
        source, light = unknown
        made = transport.respond(source, unlit)
        sent = transport.scatter(transport.areas(transport.density, unlit), made[0])
        return source - sent, jax.tree.map(jnp.subtract, light, made)

    def solve(_: Any, right: tuple[Array, Lit]) -> tuple[Array, Lit]:
        send = transport.sender(unlit, right[0])
        more, made = _solve(send, right[0], _largest(right[0]), tolerance, iterations)
        return more, jax.tree.map(jnp.add, right[1], made)

    def solve_transposed(_: Any, right: tuple[Array, Lit]) -> tuple[Array, Lit]:
        areas = transport.areas(transport.density, unlit)
        back = jax.linear_transpose(lambda x: transport.respond(x, unlit), source)
        scatter_back = jax.linear_transpose(lambda x: transport.scatter(areas, x), source)
        emitted, light = right

        def send(x: Array, whole: Array) -> tuple[Array, None]:
            # The transposed equation: what meets the source is what scattering and light send back.
            intensity, *others = jax.tree.map(lambda a: whole * a, light)
            (sent,) = back((intensity + scatter_back(x)[0], *others))
            return sent + whole * emitted, None

        unit = jnp.stack([_largest(a) for a in jax.tree.leaves(right)]).max()
        solution, _ = _solve(send, emitted, unit, transposed, iterations, known=False, light=False)
        return solution, light

    more, made = jax.lax.custom_linear_solve(equation, left_over, solve, solve_transposed)
    return (source, lit), (more, None if lit is None else made)


_Send = Callable[[Array, Array], tuple[Array, Lit | None]]


def _solve(
    send: _Send,
    right: Float[Array, "ordinate z y x"],
    unit: Float[Array, ""],
    tolerance: float | Float[Array, ""],
    iterations: int,
    *,
    known: bool = True,
    light: bool = True,
) -> tuple[Float[Array, "ordinate z y x"], Any]:
    """Solve x - send(x, 0) = `right`, and with `light` send that solution whole. No derivative.

    `send(x, whole)` returns what becomes of `x` and the light on the way, for `whole` = 1 with all
    that does not depend on `x`. Where it is not `known`, `right` gives but the shape, and
    send(0, 1) the value. `unit`: of the light, since squares of very large or small numbers would
    leave the range.

    Generalised conjugate residuals (Eisenstat, Elman and Schultz 1983) that keep one direction. One
    product an iteration, and the residual never grows; the operator's symmetric part is positive
    definite here, because scattering loses light. It is nearly symmetric, so that more directions
    save an iteration in six at most, where leaves lose nothing, and take memory. First and last
    light go through the body of the loop too: compiled once, it is a third of the program.
    """
    dtype = right.dtype
    square = jnp.asarray(tolerance, dtype) ** 2
    unit = jnp.where(unit > 0, unit, 1.0).astype(dtype)
    first, iterating, last, done = range(4)
    end = last if light else done
    _, dark = jax.eval_shape(send, right, unit)

    def stage_of(size: Array, goal: Array, count: Array) -> Array:
        return jnp.where((size > goal) & (count < iterations), iterating, end).astype(jnp.int32)

    def step(state: tuple[Any, ...]) -> tuple[Any, ...]:
        # Send the direction in which the residual points; at the ends, the solution with all light.
        solution, residual, direction, image, _, goal, count, stage = state
        within = stage == iterating
        x = jnp.where(within, residual, unit * solution)
        sent, lit = send(x.reshape(right.shape), jnp.where(within, 0.0, 1.0).astype(dtype))
        new = x - sent.ravel()
        # Make the new image orthogonal to the one before, which has unit length.
        share = image @ new
        image, direction = new - share * image, residual - share * direction
        length = jnp.sqrt(image @ image)
        some = within & (length > 0)
        scale = jnp.where(some, 1.0 / jnp.where(some, length, 1.0), 0.0)
        image, direction = image * scale, direction * scale
        # Go along it as far as the residual falls.
        along = image @ residual
        solution = solution + along * direction
        residual = residual - along * image - jnp.where(stage == first, 1.0 / unit, 0.0) * new
        size = residual @ residual
        goal = jnp.where(stage == first, square * size, goal)
        count = count + within.astype(count.dtype)
        after = jnp.where(stage == last, done, stage_of(size, goal, count)).astype(stage.dtype)
        return solution, residual, direction, image, lit if light else None, goal, count, after

    none, zero = jnp.zeros(right.size, dtype), jnp.zeros((), jnp.int32)
    residual = right.ravel() / unit if known else none
    size = residual @ residual
    goal = square * size
    stage = stage_of(size, goal, zero) if known else zero + first
    lit = jax.tree.map(lambda a: jnp.zeros(a.shape, a.dtype), dark) if light else None
    start = (none, residual, none, none, lit, goal, zero, stage)
    solution, *_, lit, _, _, _ = jax.lax.while_loop(lambda state: state[-1] < done, step, start)
    return (unit * solution).reshape(right.shape), lit


def _largest(values: Array) -> Float[Array, ""]:
    return jnp.max(jnp.abs(values))


def relative_size(part: Array, whole: Array) -> Float[Array, ""]:
    """Norm of `part` over that of `whole`, for control and report; 0 where there is nothing.

    In units of the largest number, lest squares leave the range. No derivative.
    """
    part, whole = jax.lax.stop_gradient((part, whole))
    largest = jnp.max(jnp.abs(whole))
    unit = jnp.where(largest > 0, largest, 1.0)
    size = jnp.linalg.norm((part / unit).ravel()), jnp.linalg.norm((whole / unit).ravel())
    return jnp.where(largest > 0, size[0] / jnp.where(largest > 0, size[1], 1.0), 0.0)

"""The diffuse field of hundreds of bands from a few solves.

Bands share the geometry and differ in a handful of spectra, on which the transport depends
linearly: P_b = sum over classes of rho_cb P_c + tau_cb P'_c, and A_b is affine in the ground. The
source is solved for in a few bands and looked for in all others as a combination of those
solutions, by Galerkin's condition (a reduced basis: Quarteroni, Manzoni and Negri 2016, chapters
3 and 5). The small systems come from inner products made once per class and ground map. One sweep
with the band's own ground and light then gives its field, and what its equation leaves over.
"""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from fynjax._core.errors import InputError
from fynjax.radiation._multiple import Bands, Cells, DiffuseField, Transport, prepare_transport
from fynjax.radiation._ordinates import Ordinates
from fynjax.radiation._scene import VoxelScene

_RECOLLISION = 0.6
"""Rough share of scattered light that meets a leaf again; only the choice of bands uses it."""

_AT_ONCE = 2**16
"""Elements of the fields that are made at once: of small ones several, as the steps of a sweep
cost more than what they do."""


class ReducedField(eqx.Module):
    """The diffuse light of all bands, as combinations of the sources of a few."""

    transport: Transport
    optics: Bands
    basis: Float[Array, "vector ordinate z y x"]
    """Sources, orthonormal; zero where a chosen band added nothing to those before it."""
    coefficients: Float[Array, "band vector"]
    chosen: Int[Array, " vector"]
    """Bands that were solved."""

    @property
    def residual(self) -> Float[Array, " band"]:
        """What the equation of the source leaves over, relative to the source [-]: a sweep for
        each band, when it is asked for."""
        return self._of_bands((self.optics, self.coefficients), lambda field: field.residual)

    def factor(self, scene: VoxelScene) -> tuple[int, int]:
        """Voxels in one cell, in height and in width."""
        _, depth, _, width = self.transport.shape
        return scene.shape[0] // depth, scene.shape[2] // width

    def bands(self, start: Int[Array, ""] | int, size: int) -> DiffuseField:
        """The field of `size` bands from `start` on, which may be a traced value.

        Memory, in both modes of differentiation, is that of these bands' fields.
        """
        coefficients = jax.lax.dynamic_slice_in_dim(self.coefficients, start, size)
        return self._of_bands((self.optics.slice(start, size), coefficients), lambda field: field)

    def _of_bands(
        self, bands: tuple[Bands, Float[Array, "band vector"]], take: Callable[[DiffuseField], Any]
    ) -> Any:
        """What `take` takes of the field of each band; fields are not kept for a derivative."""

        def of_band(at: tuple[Bands, Array]) -> Any:
            band, coefficients = at
            source = jnp.tensordot(coefficients, self.basis, axes=1)
            lit = self.transport.light(source, band.sky, band.sun, band.ground, band.shape)
            return take(self.transport.field(band, source, lit))

        together = min(max(_AT_ONCE // self.basis[0].size, 1), bands[1].shape[0])
        return jax.lax.map(jax.checkpoint(of_band), bands, batch_size=together)


def solve_reduced(
    scene: VoxelScene,
    cells: Cells,
    factor: tuple[int, int],
    ordinates: Ordinates,
    tolerance: float,
    iterations: int,
    solves: int = 20,
    materials: int = 3,
) -> ReducedField:
    """Solve for the diffuse field in `solves` bands, chosen here, and reduce all others to them.

    **Arguments:**

    - `solves`: bands solved; all of them if there are no more.
    - `materials`: patterns of the ground (and of the sky, if each band has its own) of which the
      small systems take every band's to be a combination. What it is not shows in `residual`.

    Solves and sweeps run one after another: memory is that of the basis, whatever the number of
    bands. Differentiable in both modes; which bands are solved counts as constant, so that the
    derivative is that of the reduced model and jumps where the choice changes. The angular shape
    of the ground must be the same in all bands (`check_reducible`).
    """
    transport, bands = prepare_transport(scene, cells, factor, ordinates)
    count = bands.sun.shape[0]
    # Where one pattern does for all bands it is not fitted: a black ground has a derivative too.
    if scene.ground.ndim == 1:
        grounds, soil = jnp.ones_like(bands.ground[:1]), scene.ground[:, None]
    else:
        grounds, soil = _mixture(bands.ground, min(materials, count))
    pattern = scene.illumination.sky_pattern
    if pattern is None:
        skies, sky = jnp.ones_like(bands.sky[:1]), bands.sky[:, :1]
    else:
        skies, sky = _mixture(bands.sky, 1 if pattern.ndim == 2 else min(materials, count))
    lights = jnp.concatenate([sky, bands.sun[:, None]], axis=1)
    # Solve the chosen bands, one after another; their sources span the others'.
    chosen = _choose(transport, bands, soil, lights, min(solves, count))
    constant, solved = jax.lax.stop_gradient((transport, bands[chosen]))
    sources = jax.lax.map(lambda band: constant.source(band, tolerance, iterations), solved)

    def with_derivative(at: tuple[Bands, Array]) -> Array:
        # The sweep at the solution is recomputed, lest it be kept for every band.
        band, source = at
        sun = transport.from_sun(band)
        return transport.complete(band, source, None, sun, tolerance, iterations)[0]

    sources = jax.lax.map(jax.checkpoint(with_derivative), (bands[chosen], sources))
    # Small systems of all bands, from inner products of what leaves send out of each source.
    basis, missing = _orthonormal(sources)
    system = _assemble(transport, bands, basis, missing, grounds, skies)
    coefficients = jax.lax.map(
        jax.checkpoint(lambda at: system.solve(*at)),
        (bands.reflectance, bands.transmittance, soil, lights),
    )
    return ReducedField(transport, bands, basis, coefficients, chosen)


def check_reducible(scene: VoxelScene) -> None:
    """Raise `InputError` where the ground's angular shape is known to differ between bands."""
    for name, values in vars(scene.ground_shape).items() if scene.ground_shape else ():
        if isinstance(values, jax.core.Tracer):
            continue
        array = np.asarray(values)
        if np.ptp(array) > 1e-6 * np.abs(array).max():
            raise InputError(
                "the diffuse light of many bands is reduced to a few solves only where "
                "`ground_shape` is the same in all bands (its amplitude, `ground`, may differ), "
                f"but `{name}` goes from {array.min():g} to {array.max():g}; solve every band, or "
                "give one value"
            )


class _System(eqx.Module):
    """The small Galerkin systems of all bands, before they are weighted with the optics."""

    mass: Float[Array, "vector vector"]
    """Inner products of the basis, with one for a vector that is missing."""
    scattered: Float[Array, "state term kind class vector"]
    """Inner products with what a leaf class sends out of the light of each state: a vector of the
    basis, a sky, or the sun; over a black ground (first term) and over each ground map."""
    from_sun: Float[Array, "kind class vector"]
    """Inner products with sunlight scattered once."""

    def solve(
        self,
        reflectance: Float[Array, " class"],
        transmittance: Float[Array, " class"],
        soil: Float[Array, " ground"],
        lights: Float[Array, " light"],
    ) -> Float[Array, " vector"]:
        optics = jnp.stack([reflectance, transmittance])
        # Light is affine in the ground: so much of that over a black one, so much over each map.
        terms = jnp.concatenate([1.0 - soil.sum(keepdims=True), soil])
        sent = jnp.einsum("smkcv,m,kc->sv", self.scattered, terms, optics)
        # States of the basis make the matrix, those of sky and sun the right-hand side.
        count = self.mass.shape[0]
        right = lights @ sent[count:]
        right = right + lights[-1] * jnp.einsum("kcv,kc->v", self.from_sun, optics)
        return jnp.linalg.solve(self.mass - sent[:count].T, right)


def _assemble(
    transport: Transport,
    bands: Bands,
    basis: Float[Array, "vector ordinate z y x"],
    missing: Float[Array, " vector"],
    grounds: Float[Array, "ground y x"],
    skies: Float[Array, "sky downward"],
) -> _System:
    """A sweep for each vector, sky and sun, over a black ground and over each ground map."""
    dtype = basis.dtype
    owner = np.asarray(transport.classes.angle_of_class)
    flat = basis.reshape(*basis.shape[:2], -1)
    density, lit = (f.reshape(len(owner), -1) for f in (transport.density, transport.lit))
    # The same in all bands (`check_reducible`).
    shape = jax.tree.map(lambda a: a[0], bands.shape)
    # Light is linear in the ground: that of any mixture follows from a black one and the maps.
    over = jnp.concatenate([jnp.zeros_like(grounds[:1]), grounds])

    def with_classes(per_angle: list[Array], area: Array) -> Float[Array, "class vector"]:
        """Sum [vector, cell] of each distribution over the cells, weighted by its classes."""
        return jnp.stack([per_angle[angle] @ area[c] for c, angle in enumerate(owner)])

    def scattered(state: tuple[Array, Array, Array]) -> Float[Array, "term kind class vector"]:
        def term(ground: Array) -> Float[Array, "kind class vector"]:
            intensity, _, _ = transport.light(*state, ground, shape)
            intensity = intensity.reshape(intensity.shape[0], -1)
            return jnp.stack(
                [
                    with_classes([_along(flat, m @ intensity) for m in kind], density)
                    for kind in transport.phase
                ]
            )

        return jax.lax.map(jax.checkpoint(term), over)

    # Source, light from the sky and share of the sun of each sweep: vectors, skies, then the sun.
    count, extra = len(basis), len(skies) + 1
    states = (
        jnp.concatenate([basis, jnp.zeros((extra, *transport.shape), dtype)]),
        jnp.zeros((count + extra, skies.shape[1]), dtype).at[count:-1].set(skies),
        jnp.zeros(count + extra, dtype).at[-1].set(1.0),
    )
    from_sun = jnp.stack(
        [
            with_classes([jnp.einsum("o,voc->vc", m, flat) for m in kind], lit)
            for kind in transport.sun_phase
        ]
    )
    # A vector that is left out has the equation 1 x = 0.
    mass = jnp.einsum("voc,woc->vw", flat, flat) + jnp.diag(missing)
    return _System(mass, jax.lax.map(scattered, states), from_sun)


@jax.custom_jvp
def _along(
    basis: Float[Array, "vector ordinate cell"], field: Float[Array, "ordinate cell"]
) -> Float[Array, "vector cell"]:
    """Sum of the product over the ordinates, in each cell.

    Written out, it is twelve times as fast on a CPU as a reduction over the middle axis; not so
    its transpose, hence the derivative is that of the plain sum.
    """
    return sum(
        (basis[:, i] * field[i] for i in range(field.shape[0])), start=jnp.zeros((), basis.dtype)
    )


@_along.defjvp
def _along_derivative(at: tuple[Array, Array], step: tuple[Array, Array]) -> tuple[Array, Array]:
    (basis, field), (basis_step, field_step) = at, step
    return _along(basis, field), jnp.sum(basis_step * field + basis * field_step, axis=1)


def _choose(
    transport: Transport,
    bands: Bands,
    soil: Float[Array, "band ground"],
    lights: Float[Array, "band light"],
    count: int,
) -> Int[Array, " solve"]:
    """Bands whose light is least like that of the bands chosen before.

    Light scattered n times goes with products of n optical properties: here those of each class
    and of the ground, times powers of the mean albedo of the leaves. Classes count by their area.
    """
    transport, bands, soil, lights = jax.lax.stop_gradient((transport, bands, soil, lights))
    area = transport.density.mean(axis=(1, 2, 3))
    share = area / jnp.maximum(area.sum(), jnp.finfo(area.dtype).tiny)
    optics = jnp.concatenate([bands.reflectance, bands.transmittance], axis=1)
    # Share of light that leaves scatter and that meets a leaf again.
    again = _RECOLLISION * (bands.reflectance + bands.transmittance) @ share
    optics = optics * jnp.sqrt(jnp.tile(share, 2))
    once = jnp.concatenate(
        [
            (optics[:, :, None] * lights[:, None]).reshape(optics.shape[0], -1),
            (soil[:, :, None] * lights[:, None]).reshape(optics.shape[0], -1) * again[:, None],
        ],
        axis=1,
    )
    features = jnp.concatenate([once * (again**order)[:, None] for order in range(3)], axis=1)
    # Dark bands count nearly as much as bright ones: errors are relative. Were the lengths equal,
    # rounding would pick the first.
    length = jnp.linalg.norm(features, axis=1, keepdims=True)
    brightness = length / jnp.maximum(length.max(), jnp.finfo(area.dtype).tiny)
    return _pivots(_unit(features) * (1.0 + 0.2 * brightness), count)


def _pivots(rows: Float[Array, "row column"], count: int) -> Int[Array, " count"]:
    """Rows, each the longest after those before are projected out (pivoted Gram-Schmidt)."""
    rows = jax.lax.stop_gradient(rows)

    def pick(rest: tuple[Array, Array], _: None) -> tuple[tuple[Array, Array], Array]:
        rows, free = rest
        # A row that was picked is never picked again, whatever rounding leaves of it.
        index = jnp.argmax(jnp.where(free, jnp.sum(rows**2, axis=1), -1.0))
        unit = _unit(rows[index])
        return (rows - jnp.outer(rows @ unit, unit), free.at[index].set(False)), index

    _, chosen = jax.lax.scan(pick, (rows, jnp.ones(len(rows), bool)), None, length=count)
    return chosen


def _unit(rows: Float[Array, "*row column"]) -> Float[Array, "*row column"]:
    length = jnp.sqrt(jnp.sum(rows**2, axis=-1, keepdims=True))
    return rows / jnp.where(length > 0, length, 1.0)


def _mixture(
    fields: Float[Array, "band ..."], terms: int
) -> tuple[Float[Array, "term ..."], Float[Array, "band term"]]:
    """A few fields, and every band's as their combination by least squares.

    Exact where the fields are mixtures of no more than `terms`."""
    flat = fields.reshape(len(fields), -1)
    basis, missing = _orthonormal(flat[_pivots(flat, terms)])
    weights = jnp.linalg.solve(basis @ basis.T + jnp.diag(missing), basis @ flat.T).T
    return basis.reshape(terms, *fields.shape[1:]), weights


def _orthonormal(
    rows: Float[Array, "row ..."],
) -> tuple[Float[Array, "row ..."], Float[Array, " row"]]:
    """Orthonormal rows of the same span, and which are missing: `_gram_schmidt`, twice.

    What is left of a row that nearly lies in the span of others is made of small differences of
    large numbers. It has lost digits, and is orthonormal to the others only the second time; as it
    comes out of the first, systems of few spectra were singular in float32.
    """
    return _gram_schmidt(_gram_schmidt(rows)[0])


def _gram_schmidt(
    rows: Float[Array, "row ..."],
) -> tuple[Float[Array, "row ..."], Float[Array, " row"]]:
    """Rows of the same span that are orthonormal but for rounding, and which are missing.

    A row that lies in the span of those before it is left out: it is zero in the result, and one
    in `missing`. The combination counts as constant. Its derivative could not matter: what is
    made of the result depends on the span alone. And it would be badly conditioned.
    """
    flat = rows.reshape(len(rows), -1)
    constant = jax.lax.stop_gradient(flat)
    tiny = jnp.finfo(flat.dtype).eps ** 0.7

    def add(
        state: tuple[Array, Array], row: tuple[Array, Array]
    ) -> tuple[tuple[Array, Array], Array]:
        basis, combination = state
        vector, index = row
        length = jnp.sqrt(vector @ vector)
        scale = 1.0 / jnp.where(length > 0, length, 1.0)
        made = jnp.zeros_like(combination[0]).at[index].set(scale)
        vector = vector * scale
        # Twice: what rounding leaves of the first time is not small beside a short rest.
        for _ in range(2):
            # The combination goes along, so that the result is linear in the rows.
            share = basis @ vector
            vector, made = vector - share @ basis, made - share @ combination
        left = jnp.sqrt(vector @ vector)
        kept = left > tiny
        scale = jnp.where(kept, 1.0 / jnp.where(kept, left, 1.0), 0.0)
        state = basis.at[index].set(vector * scale), combination.at[index].set(made * scale)
        return state, 1.0 - kept

    start = jnp.zeros_like(constant), jnp.zeros((len(rows), len(rows)), flat.dtype)
    (_, combination), missing = jax.lax.scan(add, start, (constant, jnp.arange(len(rows))))
    return (combination @ flat).reshape(rows.shape), missing.astype(flat.dtype)

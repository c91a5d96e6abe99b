"""Discrete ordinates on the coarse grid: the directions, and one sweep of light through it.

A sweep carries the radiance of each ordinate from layer to layer, shifting it sideways by the
ordinate's slope. What a cell takes from a beam is exactly what the beam loses, so energy closes
to rounding whatever the grid (with periodic sides).
"""

import dataclasses
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.extend.core import Primitive
from jax.interpreters import ad, batching, mlir
from jaxtyping import Array, Float

from fynjax._core.math import mean_emission, mean_transmittance
from fynjax.canopy import projections
from fynjax.radiation._scene import Illumination, VoxelScene
from fynjax.radiation._terrain import exposure, ground_in_cells


class Ordinates(eqx.Module):
    """Directions of light travel: Gauss-Legendre levels in the cosine, even azimuths.

    Ordered [hemisphere, level, azimuth], hemisphere 0 downward and 1 upward.
    """

    cosine: tuple[float, ...] = eqx.field(static=True)
    """Cosine of the angle from the vertical, per level [-]."""
    level_weight: tuple[float, ...] = eqx.field(static=True)
    """Solid angle of one ordinate of each level [sr]."""
    azimuths: int = eqx.field(static=True)

    @classmethod
    def create(cls, levels: int, azimuths: int) -> "Ordinates":
        """`levels` zenith angles per hemisphere and `azimuths` directions at each."""
        node, weight = np.polynomial.legendre.leggauss(levels)
        # Gauss-Legendre nodes of [-1, 1], moved to cosines of [0, 1].
        solid = np.pi * weight / azimuths  # the weights of [0, 1] are half as large
        return cls(tuple(float(0.5 * (n + 1)) for n in node), tuple(map(float, solid)), azimuths)

    @property
    def slopes(self) -> np.ndarray:
        """Horizontal distance per height, per level [-]."""
        cosine = np.asarray(self.cosine)
        return np.sqrt(1 - cosine**2) / cosine

    @property
    def vectors(self) -> np.ndarray:
        """Unit vectors of travel, [ordinate, 3]."""
        azimuth = (np.arange(self.azimuths) + 0.5) * (2 * np.pi / self.azimuths)
        cosine = np.asarray(self.cosine)[:, None]
        sine = np.sqrt(1 - cosine**2)
        up = np.stack(
            np.broadcast_arrays(sine * np.sin(azimuth), sine * np.cos(azimuth), cosine), axis=-1
        )
        return np.stack([up * [1, 1, -1], up]).reshape(-1, 3)

    @property
    def fluxes(self) -> np.ndarray:
        """Solid angle times cosine, [level, azimuth]: sums radiance to the flux of a hemisphere."""
        flux = np.multiply(self.level_weight, self.cosine)
        return np.repeat(flux[:, None], self.azimuths, axis=1)

    @property
    def weights(self) -> np.ndarray:
        """Solid angle of each ordinate [sr], [ordinate]; they sum to 4 pi."""
        return np.tile(np.repeat(self.level_weight, self.azimuths), 2)


def sky_radiance(light: Illumination, ordinates: Ordinates) -> Float[Array, "band downward"]:
    """Radiance of the sky along each downward ordinate; the irradiance it makes is `light.sky`."""
    downward = len(ordinates.vectors) // 2
    if light.sky_pattern is None:
        return jnp.broadcast_to(light.sky[:, None] / jnp.pi, (light.sky.shape[0], downward))
    pattern = light.sky_pattern
    pattern = jnp.broadcast_to(pattern, (light.sky.shape[0], *pattern.shape[-2:]))
    zeniths, azimuths = pattern.shape[-2:]
    # The light that travels along an ordinate comes from the opposite point of the sky.
    x, y, z = -ordinates.vectors[:downward].T
    down = np.degrees(np.arccos(z)) / 90.0 * (zeniths - 1)
    around = np.degrees(np.arctan2(x, y)) % 360.0 / 360.0 * azimuths
    # Bilinear on the hemisphere: rows from the zenith to the horizon, columns right round.
    row, column = np.minimum(down.astype(int), zeniths - 2), around.astype(int) % azimuths
    share, turn = down - row, around - np.floor(around)
    corners = (
        (row, column, (1 - share) * (1 - turn)),
        (row, (column + 1) % azimuths, (1 - share) * turn),
        (row + 1, column, share * (1 - turn)),
        (row + 1, (column + 1) % azimuths, share * turn),
    )
    radiance = sum(
        (jnp.asarray(w, pattern.dtype) * pattern[:, r, c] for r, c, w in corners),
        start=jnp.zeros((), pattern.dtype),
    )
    # The pattern is relative: on the ordinates it makes the irradiance of the sky exactly.
    total = radiance @ jnp.asarray(ordinates.fluxes.ravel(), pattern.dtype)
    lit = total > 0
    return jnp.where(lit, light.sky / jnp.where(lit, total, 1.0), 0.0)[:, None] * radiance


class GroundShape(eqx.Module):
    """Angular shape of the ground's reflectance on the ordinates, for one band or each."""

    diffuse: Float[Array, "*band downward upward"]
    """Reflectance factor over its amplitude, from each downward to each upward ordinate [-]."""
    sun: Float[Array, "*band upward"]
    """Reflectance factor over its amplitude, from the sun to each upward ordinate [-]."""


class Coarse(eqx.Module):
    """A grid as the sweeps need it; the same for all bands."""

    attenuation: tuple[Float[Array, "way z kind _ one y x"], ...]
    """Per group of levels: exp(-x), its mean along a step and the mean emission (the three kinds),
    x the depth of a step; in the order in which light meets the layers on its way down, and on its
    way up."""
    ground_share: tuple[Float[Array, "z y x"], Float[Array, "z y x"]] | None
    """Share of the light that falls on a cell's bottom and ends there on the ground, and of that
    which comes in through a side [-]; None: the ground is flat, below the last layer."""
    exposure: Float[Array, "level azimuth y x"] | None
    """Irradiance on the ground's surface over what the sweep lets fall on it, per level area and
    downward ordinate [-]; None where it is flat."""
    ordinates: Ordinates = eqx.field(static=True)
    horizontal: float = eqx.field(static=True)
    vertical: float = eqx.field(static=True)
    boundary: str = eqx.field(static=True)

    @property
    def groups(self) -> tuple[tuple[slice, int], ...]:
        """Levels that cross a layer in as many steps, and that number; each moves at most a cell
        a step."""
        return _groups(self.ordinates, self.vertical / self.horizontal)

    def moves(self, levels: slice, steps: int) -> np.ndarray:
        """Sideways shift before each step of a layer [cells], [xy, level, azimuth]."""
        azimuth = (np.arange(self.ordinates.azimuths) + 0.5) * (2 * np.pi / self.ordinates.azimuths)
        reach = self.vertical * self.ordinates.slopes[levels] / (self.horizontal * steps)
        return np.stack([np.outer(reach, np.sin(azimuth)), np.outer(reach, np.cos(azimuth))])

    def lengths(self, levels: slice, steps: int) -> np.ndarray:
        """Length of a step along the ordinates of each level [m]."""
        return self.vertical / (steps * np.asarray(self.ordinates.cosine[levels]))


def _groups(ordinates: Ordinates, aspect: float) -> tuple[tuple[slice, int], ...]:
    steps = [max(1, int(np.ceil(aspect * slope - 1e-9))) for slope in ordinates.slopes]
    # One step more for some levels costs less than code of their own.
    for i in range(1, len(steps)):
        if steps[i] < steps[i - 1] <= steps[i] + 2:
            steps[i] = steps[i - 1]
    starts = [i for i in range(len(steps)) if i == 0 or steps[i] != steps[i - 1]]
    ends = [*starts[1:], len(steps)]
    return tuple((slice(i, j), steps[i]) for i, j in zip(starts, ends))


def coarse_grid(
    scene: VoxelScene,
    density: Float[Array, "class z y x"],
    factor: tuple[int, int],
    ordinates: Ordinates,
) -> Coarse:
    """Prepare the sweeps over the block-averaged `density`."""
    dx, dz = scene.horizontal * factor[1], scene.vertical * factor[0]
    by_angle = scene.classes.total_by_angle(density)
    every = jnp.asarray(ordinates.cosine, density.dtype)
    projection = projections(scene.classes.angles, every).astype(density.dtype)
    attenuation = []
    for levels, steps in _groups(ordinates, dz / dx):
        # Optical depth of a step through each cell, along the ordinates of each level.
        along = projection[:, levels] * (dz / (steps * every[levels]))
        # [layer, level, azimuth (one for all), y, x]; on the way down from the top layer on.
        depth = jnp.einsum("al,azyx->zlyx", along, by_angle)[:, :, None]
        depth = jnp.stack([depth[::-1], depth])
        kinds = jnp.exp(-depth), mean_transmittance(depth), mean_emission(depth)
        attenuation.append(jnp.stack(kinds, axis=2))
    # The barrier keeps the exponentials out of the sweeps, which would compute them each.
    attenuation = jax.lax.optimization_barrier(attenuation)
    coarse = Coarse(tuple(attenuation), None, None, ordinates, dx, dz, scene.boundary)
    if scene.terrain is None:
        return coarse
    # Steps of cells resolve a slope only roughly: the irradiance of the bare ground is known
    # exactly, and sets the scale.
    bare = dataclasses.replace(
        coarse,
        attenuation=tuple(jnp.ones_like(one).at[:, :, 2].set(0.5) for one in attenuation),
        ground_share=ground_in_cells(scene, factor),
    )
    count = len(ordinates.vectors) // 2
    area = density.shape[2:]
    dark = jnp.zeros((2 * count, *density.shape[1:]), density.dtype)
    none = jnp.zeros(area, density.dtype)
    _, falls, _ = sweep(bare, dark, jnp.ones(count, density.dtype), none, none)
    lit = exposure(scene, ordinates.vectors[:count])
    lit = lit.reshape(count, area[0], factor[1], area[1], factor[1]).mean(axis=(2, 4))
    # Of directions of which hardly any light falls the ratio would be noise.
    scale = jnp.where(falls > 0.05, lit / jnp.maximum(falls, 0.05), 0.0)
    scale = jnp.clip(scale, 0.0, 4.0)
    # Directions in which the cells let nothing fall where some does are made up for by the others.
    flux = jnp.asarray(ordinates.fluxes.ravel(), density.dtype)
    wanted, got = (jnp.tensordot(flux, of, axes=1) for of in (lit, falls * scale))
    scale = scale * jnp.clip(wanted / jnp.maximum(got, 1e-3), 0.5, 2.0)
    scale = scale.reshape(len(ordinates.cosine), ordinates.azimuths, *area)
    return dataclasses.replace(coarse, ground_share=bare.ground_share, exposure=scale)


@jax.jit  # a program sweeps many times: traced once
def sweep(
    coarse: Coarse,
    source: Float[Array, "ordinate z y x"],
    sky: Float[Array, " downward"],
    ground: Float[Array, "y x"],
    sunlit: Float[Array, "y x"],
    shape: GroundShape | None = None,
) -> tuple[Float[Array, "ordinate z y x"], Float[Array, "downward y x"], Float[Array, "y x"]]:
    """Mean intensity in each cell from a given source, sky and sunlit ground (one band).

    **Arguments:**

    - `source`: radiance emitted per length, along each ordinate [radiance m-1].
    - `sky`: radiance that enters from above (and, in an open scene, the sides), per downward
      ordinate.
    - `ground`: reflectance of the ground, or its amplitude [-].
    - `sunlit`: direct irradiance on the ground's surface.
    - `shape`: how the ground departs from Lambert's law.

    **Returns:** mean intensity per ordinate and cell, radiance that falls on the ground along
    each downward ordinate (on terrain scaled so that it makes the irradiance on its surface), and
    the upward flux at the top. Linear in (`source`, `sky`, `sunlit`).
    """
    ordinates = coarse.ordinates
    levels, azimuths = len(ordinates.cosine), ordinates.azimuths
    flux = jnp.asarray(ordinates.fluxes, source.dtype)
    above = sky.astype(source.dtype).reshape(levels, azimuths)
    moves = [coarse.moves(group, steps) for group, steps in coarse.groups]
    move = np.concatenate(moves, axis=1)

    def pass_layers(
        entering: Array, hemisphere: tuple[Any, ...]
    ) -> tuple[Array, tuple[Array, ...]]:
        """Down through all layers, or up; the ground's light enters the way up."""
        outside, emitted, attenuation, shares = hemisphere
        # A step begins with its whole move: half a move back puts its middle on the path.
        below = _shift(entering, -0.5 * move, outside, coarse.boundary)
        passed = []
        for (group, steps), cells in zip(coarse.groups, attenuation):
            of_group = outside[group], entering[group], below[group], emitted[:, group]
            passed.append(_pass_group(coarse, group, steps, of_group, cells, shares))
        means, ends, hits = zip(*passed)
        # Then the other half move, so that what ends is over its own cell.
        leaving = _shift(jnp.concatenate(ends), 0.5 * move, outside, coarse.boundary)
        falling = leaving if hits[0] is None else leaving + jnp.concatenate(hits)
        # The ground sends up what fell on it, and sunlight.
        received = falling if coarse.exposure is None else falling * coarse.exposure
        exitance = _sent_up(received, flux, ground, sunlit, shape)
        return exitance, (jnp.concatenate(means, axis=1), leaving, received)

    # Two passes of one program: down from the top, with the sky's light; up, with the ground's.
    by_layer = jnp.moveaxis(source.reshape(2, levels, azimuths, *source.shape[1:]), 3, 1)
    hemispheres = (
        jnp.stack([above, jnp.zeros_like(above)]),
        _down_and_up(by_layer[0], by_layer[1]),
        coarse.attenuation,
        _ground_shares(coarse),
    )
    entering = jnp.broadcast_to(above[:, :, None, None], (levels, azimuths, *ground.shape))
    _, (mean, leaving, falling) = jax.lax.scan(pass_layers, entering, hemispheres)
    mean = jnp.moveaxis(jnp.stack([mean[0, ::-1], mean[1]]), 1, 3).reshape(source.shape)
    top = jnp.einsum("la,layx->yx", flux, leaving[1])
    return mean, falling[0].reshape(-1, *ground.shape), top


def _down_and_up(down: Any, up: Any) -> Any:
    """Fields of the layers for both passes: from the top down, then from the ground up."""
    return jax.tree.map(lambda d, u: jnp.stack([d[::-1], u]), down, up)


def _ground_shares(coarse: Coarse) -> tuple[Array, ...] | None:
    """What terrain does to the light of each cell, for both passes; None on level ground.

    The share of it that the ground makes at the cell's bottom (up), that ends there (down), that
    ends on ground to the side, and whether that ground shines back (up).
    """
    if coarse.ground_share is None:
        return None
    bottom, side = coarse.ground_share
    none = jnp.zeros_like(bottom)
    shares: tuple[Array, ...] = _down_and_up(
        (none, bottom, side, none), (bottom, none, side, none + 1.0)
    )
    return shares


def _sent_up(
    received: Float[Array, "level azimuth y x"],
    flux: Float[Array, "level azimuth"],
    ground: Float[Array, "y x"],
    sunlit: Float[Array, "y x"],
    shape: GroundShape | None,
) -> Float[Array, "level azimuth y x"]:
    """Radiance of the ground along each upward ordinate, by what it received and by sunlight."""
    if shape is None:  # Lambert's law: alike in all directions
        irradiance = jnp.einsum("la,layx->yx", flux, received)
        return jnp.broadcast_to(ground * (irradiance + sunlit) / jnp.pi, received.shape)
    weighted = (received * flux[:, :, None, None]).reshape(-1, *ground.shape)
    # Into each upward direction its own share of what came from each downward one.
    exitance = jnp.tensordot(shape.diffuse.T, weighted, axes=1)
    exitance = (exitance + shape.sun[:, None, None] * sunlit) * ground / jnp.pi
    return exitance.reshape(received.shape)


class _OnTheWay(NamedTuple):
    """What a step through a cell carries, along each ordinate."""

    radiance: Float[Array, "level azimuth y x"]
    """Radiance that travels."""
    total: Float[Array, "level azimuth y x"]
    """Mean radiance in the cell, summed over the steps."""
    hit: Float[Array, "level azimuth y x"] | None
    """What has ended on ground to the side; None on level ground."""


def _pass_group(
    coarse: Coarse,
    group: slice,
    steps: int,
    of_group: tuple[Array, Array, Array, Array],
    attenuation: Float[Array, "z kind _ one y x"],
    shares: tuple[Array, ...] | None,
) -> tuple[Array, Array, Array | None]:
    """Ordinates that cross a layer in as many `steps`, through all layers of a pass.

    `of_group` is their radiance outside an open scene, what the ground sends, the same half a move
    back, which enters the first layer, and what each layer emits; `attenuation` of each layer the
    share that a step lets through, and the mean of radiance and of emission along it. Returns the
    mean radiance of each layer, what leaves the last one or falls on the ground before half a move
    on, and what falls on hillsides; None on level ground.
    """
    around, from_ground, below, emitted = of_group
    move = coarse.moves(group, steps)
    lengths = jnp.asarray(coarse.lengths(group, steps), from_ground.dtype)[:, None, None, None]
    terrain = coarse.ground_share is not None

    def layer(
        radiance: Array, cell: tuple[Any, ...]
    ) -> tuple[Array, tuple[Array, Array | None, Array | None]]:
        emitted, kinds, share = cell
        emitted = emitted * lengths
        # For every azimuth: the derivative is then summed over them once a layer.
        through, mean, emission = jnp.broadcast_to(kinds, (3, *radiance.shape))
        if terrain:  # on the way up, the ground at the bottom of the cell adds its light
            radiance = radiance + share[0] * (below - radiance)

        def step(carry: _OnTheWay, _: None) -> tuple[_OnTheWay, None]:
            radiance, total, hit = carry
            radiance = _shift(radiance, move, around, coarse.boundary)
            if terrain:  # what runs into a hillside ends there, and is its light from then
                taken = radiance * share[2]
                radiance = radiance - taken + share[2] * share[3] * from_ground
                hit = hit + taken
            total = total + radiance * mean + emitted * emission
            return _OnTheWay(radiance * through + emitted * mean, total, hit), None

        nothing = jnp.zeros_like(radiance)
        start = _OnTheWay(radiance, nothing, nothing if terrain else None)
        (radiance, total, hit), _ = jax.lax.scan(step, start, None, length=steps)
        fell = None
        if terrain:  # on the way down, it takes what falls on it
            fell = radiance * share[1]
            radiance = radiance - fell
        return radiance, (total / steps, hit, fell)

    end, (mean, hit, fell) = jax.lax.scan(
        jax.checkpoint(layer), below, (emitted, attenuation, shares)
    )
    end = end if fell is None else end + fell.sum(axis=0)
    return mean, end, None if hit is None else hit.sum(axis=0)


def _shift(
    radiance: Float[Array, "level azimuth y x"],
    move: np.ndarray,
    outside: Float[Array, "level azimuth"],
    boundary: str,
) -> Float[Array, "level azimuth y x"]:
    """Move each ordinate's layer by `move` (at most one cell) along x and y, linearly.

    `move` [xy, level, azimuth] is known when the program is made: its shares are constants of it.
    """
    periodic = boundary == "periodic"
    shares = tuple(tuple(map(tuple, along.tolist())) for along in move)
    moved: Array = _moved.bind(radiance, move=shares, periodic=periodic)
    if periodic:
        return moved
    # From outside comes what moves out of cells that are all alike.
    left = []
    for share, size in zip(move, radiance.shape[:-3:-1]):
        along = np.ones((*share.shape, size))
        along[..., 0] -= np.maximum(share, 0)
        along[..., -1] -= np.maximum(-share, 0)
        left.append(along.astype(radiance.dtype))
    entered = 1 - left[0][:, :, None, :] * left[1][:, :, :, None]
    return moved + outside[:, :, None, None] * entered


def _move(radiance: Array, move: Any, periodic: bool) -> Array:
    for axis, share in zip((-1, -2), np.asarray(move, radiance.dtype)[..., None, None]):
        size, axis = radiance.shape[axis], radiance.ndim + axis
        part = lambda of, start, size=size, axis=axis: jax.lax.slice_in_dim(  # noqa: E731
            of, start, start + size, axis=axis
        )
        ends = part(radiance, size - 1, 1), part(radiance, 0, 1)
        if not periodic:
            ends = jnp.zeros_like(ends[0]), jnp.zeros_like(ends[1])
        # The barrier has it written once and read three times, instead of pieced together thrice.
        padded = jax.lax.optimization_barrier(
            jnp.concatenate([ends[0], radiance, ends[1]], axis=axis)
        )
        # A move of +0.3 cells: 0.3 of the neighbour before, 0.7 of the cell itself.
        radiance = (
            part(padded, 0) * np.maximum(share, 0)
            + part(padded, 1) * (1 - np.abs(share))
            + part(padded, 2) * np.maximum(-share, 0)
        )
    return radiance


def _move_back(cotangent: Array, radiance: Any, *, move: Any, periodic: bool) -> list[Array]:
    back = tuple(tuple(tuple(-s for s in level) for level in along) for along in move)
    return [_moved.bind(cotangent, move=back, periodic=periodic)]


# An operation of its own, for the sake of its transpose, which is the opposite move: that of its
# parts would be eight loops in place of four.
_moved = Primitive("moved")
_moved.def_impl(jax.jit(_move, static_argnames=("move", "periodic")))
_moved.def_abstract_eval(lambda radiance, **_: radiance)
mlir.register_lowering(_moved, mlir.lower_fun(_move, multiple_results=False))
ad.deflinear2(_moved, _move_back)
batching.primitive_batchers[_moved] = lambda args, dims, **how: (
    _moved.bind(jnp.moveaxis(args[0], dims[0], 0), **how),
    0,
)

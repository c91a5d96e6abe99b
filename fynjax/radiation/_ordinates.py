"""Discrete ordinates on the coarse grid: the directions, and one sweep of light through it.

A sweep carries the radiance of each ordinate from layer to layer, shifting it sideways by the
ordinate's slope. What a cell takes from a beam is exactly what the beam loses, so energy closes
to rounding whatever the grid (with periodic sides).
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from fynjax._core.math import mean_emission, mean_transmittance
from fynjax.radiation._scene import VoxelScene


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
    def weights(self) -> np.ndarray:
        """Solid angle of each ordinate [sr], [ordinate]; they sum to 4 pi."""
        return np.tile(np.repeat(self.level_weight, self.azimuths), 2)


class Coarse(eqx.Module):
    """The coarse grid as the sweeps need it; the same for all bands."""

    attenuation: tuple[Float[Array, "z level one y x"], ...]
    """exp(-x), its mean along a step and the mean emission, x the depth of a step."""
    ordinates: Ordinates = eqx.field(static=True)
    steps: int = eqx.field(static=True)
    """Steps in which a layer is crossed."""
    horizontal: float = eqx.field(static=True)
    vertical: float = eqx.field(static=True)
    boundary: str = eqx.field(static=True)

    @property
    def lengths(self) -> np.ndarray:
        """Length of a step along the ordinates of each level [m]."""
        return self.vertical / (self.steps * np.asarray(self.ordinates.cosine))

    @property
    def moves(self) -> np.ndarray:
        """Sideways shift before each step [cells], [step, xy, level, azimuth]; at most one.

        A level moves only as often as it must, since each linear shift blurs a little. Between
        two moves it stands where it is half-way.
        """
        ordinates = self.ordinates
        azimuth = (np.arange(ordinates.azimuths) + 0.5) * (2 * np.pi / ordinates.azimuths)
        reach = self.vertical * ordinates.slopes / self.horizontal
        moves = np.zeros((self.steps, 2, len(reach), ordinates.azimuths))
        for level, cells in enumerate(reach):
            count = _moves_needed(cells)
            at = np.round(np.arange(count) * self.steps / count).astype(int)
            moves[at, :, level] = np.stack([np.sin(azimuth), np.cos(azimuth)]) * cells / count
        return moves


def _moves_needed(cells: float) -> int:
    return max(1, int(np.ceil(cells - 1e-9)))


def coarse_grid(
    scene: VoxelScene,
    density: Float[Array, "class z y x"],
    factor: tuple[int, int],
    ordinates: Ordinates,
) -> Coarse:
    """Prepare the sweeps over the block-averaged `density`."""
    dx, dz = scene.horizontal * factor[1], scene.vertical * factor[0]
    steps = max(_moves_needed(dz * slope / dx) for slope in ordinates.slopes)
    cosine = jnp.asarray(ordinates.cosine, density.dtype)
    projection = jnp.stack([a.projection(cosine) for a in scene.classes.angles])
    extinction = jnp.einsum(
        "al,azyx->zlyx", projection.astype(density.dtype), scene.classes.total_by_angle(density)
    )
    depth = (extinction * (dz / (steps * cosine))[:, None, None])[:, :, None]
    attenuation = (jnp.exp(-depth), mean_transmittance(depth), mean_emission(depth))
    return Coarse(attenuation, ordinates, steps, dx, dz, scene.boundary)


def sweep(
    coarse: Coarse,
    source: Float[Array, "ordinate z y x"],
    sky: Float[Array, ""],
    ground: Float[Array, "y x"],
    sunlit: Float[Array, "y x"],
) -> tuple[Float[Array, "ordinate z y x"], Float[Array, "y x"], Float[Array, "y x"]]:
    """Mean intensity in each cell from a given source, sky and sunlit ground (one band).

    **Arguments:**

    - `source`: radiance emitted per length, along each ordinate [radiance m-1].
    - `sky`: isotropic radiance that enters from above (and, in an open scene, the sides).
    - `ground`: reflectance of the ground [-].
    - `sunlit`: direct irradiance on the ground.

    **Returns:** mean intensity per ordinate and cell, diffuse irradiance on the ground, and the
    upward flux at the top. Linear in (`source`, `sky`, `sunlit`).
    """
    ordinates = coarse.ordinates
    levels, azimuths = len(ordinates.cosine), ordinates.azimuths
    dtype = source.dtype
    moves = jnp.asarray(coarse.moves, dtype)
    half = jnp.asarray(0.5 * coarse.moves[0], dtype)
    lengths = jnp.asarray(coarse.lengths, dtype)[:, None, None, None]
    flux = jnp.asarray(np.multiply(ordinates.level_weight, ordinates.cosine), dtype)

    def pass_layers(
        entering: Array, hemisphere: tuple[Array, tuple[Array, ...]]
    ) -> tuple[Array, tuple[Array, Array]]:
        """Down through all layers, or up; the ground's light enters the way up."""
        outside, cells = hemisphere

        def layer(radiance: Array, cell: tuple[Array, ...]) -> tuple[Array, Array]:
            emitted, through, mean, emission = cell
            emitted = emitted * lengths

            def step(carry: tuple[Array, Array], move: Array) -> tuple[tuple[Array, Array], None]:
                radiance, total = carry
                radiance = _shift(radiance, move, outside, coarse.boundary)
                total = total + radiance * mean + emitted * emission
                return (radiance * through + emitted * mean, total), None

            start = (radiance, jnp.zeros_like(radiance))
            (radiance, total), _ = jax.lax.scan(step, start, moves)
            return radiance, total / coarse.steps

        start = _shift(entering, -half, outside, coarse.boundary)
        leaving, mean = jax.lax.scan(layer, start, cells)
        leaving = _shift(leaving, half, outside, coarse.boundary)
        irradiance = jnp.einsum("l,layx->yx", flux, leaving)
        exitance = ground * (irradiance + sunlit) / jnp.pi
        return jnp.broadcast_to(exitance, leaving.shape), (mean, irradiance)

    shape = (2, levels, azimuths, *source.shape[1:])
    by_layer = jnp.moveaxis(source.reshape(shape), 3, 1)
    cells = tuple(
        jnp.stack([down[::-1], up])
        for down, up in (tuple(by_layer), *((a, a) for a in coarse.attenuation))
    )
    outside = jnp.stack([sky, jnp.zeros_like(sky)])
    entering = jnp.broadcast_to(sky, (levels, azimuths, *ground.shape))
    _, (mean, irradiance) = jax.lax.scan(pass_layers, entering, (outside, cells))
    mean = jnp.stack([mean[0, ::-1], mean[1]])
    mean = jnp.moveaxis(mean, 1, 3).reshape(source.shape)
    return mean, irradiance[0], irradiance[1]


def _shift(
    radiance: Float[Array, "level azimuth y x"],
    move: Float[Array, "xy level azimuth"],
    outside: Float[Array, ""],
    boundary: str,
) -> Float[Array, "level azimuth y x"]:
    """Move each ordinate's layer by `move` (at most one cell) along x and y, linearly."""
    for axis, share in ((3, move[0]), (2, move[1])):
        first, last = (
            jax.lax.slice_in_dim(radiance, at, at + 1, axis=axis)
            for at in (0, radiance.shape[axis] - 1)
        )
        if boundary == "periodic":
            ends = (last, first)
        else:
            ends = (jnp.broadcast_to(outside, first.shape),) * 2
        padded = jnp.concatenate([ends[0], radiance, ends[1]], axis=axis)
        size = radiance.shape[axis]
        before, after = (
            jax.lax.slice_in_dim(padded, start, start + size, axis=axis) for start in (0, 2)
        )
        share = share[:, :, None, None]
        radiance = (
            before * jnp.maximum(share, 0)
            + radiance * (1 - jnp.abs(share))
            + after * jnp.maximum(-share, 0)
        )
    return radiance

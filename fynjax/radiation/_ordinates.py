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

Radiance = Float[Array, "azimuth y x"]


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

    attenuation: tuple[tuple[Float[Array, "z y x"], ...], ...]
    """Per level: exp(-x), its mean along the step and the mean emission, x the depth of a step."""
    steps: tuple[int, ...] = eqx.field(static=True)
    """Per level: steps a layer is crossed in, so that none shifts by more than a cell."""
    ordinates: Ordinates = eqx.field(static=True)
    horizontal: float = eqx.field(static=True)
    vertical: float = eqx.field(static=True)
    boundary: str = eqx.field(static=True)


def coarse_grid(
    scene: VoxelScene, density: Float[Array, "class z y x"], factor: tuple[int, int], ordinates: Ordinates
) -> Coarse:
    """Prepare the sweeps over the block-averaged `density`."""
    dx, dz = scene.horizontal * factor[1], scene.vertical * factor[0]
    by_angle = scene.classes.total_by_angle(density)
    attenuation, steps = [], []
    for cosine in ordinates.cosine:
        slope = np.sqrt(1 - cosine**2) / cosine
        count = max(1, int(np.ceil(dz * slope / dx - 1e-9)))
        projection = jnp.stack([
            angle.projection(jnp.asarray(cosine, density.dtype)) for angle in scene.classes.angles
        ])
        depth = jnp.einsum("a,azyx->zyx", projection.astype(density.dtype), by_angle)
        depth = depth * (dz / (count * cosine))
        attenuation.append((jnp.exp(-depth), mean_transmittance(depth), mean_emission(depth)))
        steps.append(count)
    return Coarse(tuple(attenuation), tuple(steps), ordinates, dx, dz, scene.boundary)


def sweep(
    coarse: Coarse,
    source: Float[Array, "hemisphere level azimuth z y x"],
    sky: Float[Array, ""],
    ground: Float[Array, "y x"],
    sunlit: Float[Array, "y x"],
) -> tuple[Float[Array, "hemisphere level azimuth z y x"], Float[Array, "y x"], Float[Array, "y x"]]:
    """Mean intensity in each cell from a given source, sky and sunlit ground (one band).

    **Arguments:**

    - `source`: radiance emitted per length, along each ordinate [radiance m-1].
    - `sky`: isotropic radiance that enters from above (and, in an open scene, the sides).
    - `ground`: reflectance of the ground [-].
    - `sunlit`: direct irradiance on the ground.

    **Returns:** mean intensity per ordinate and cell, diffuse irradiance on the ground, and the
    upward flux at the top. Linear in (`source`, `sky`, `sunlit`).
    """
    levels = len(coarse.ordinates.cosine)
    down = [
        _level(coarse, level, source[0, level], jnp.broadcast_to(sky, source.shape[2:3] + ground.shape),
               sky, downward=True)
        for level in range(levels)
    ]
    flux = [
        weight * cosine
        for weight, cosine in zip(coarse.ordinates.level_weight, coarse.ordinates.cosine)
    ]
    diffuse = sum(f * jnp.sum(leaving, axis=0) for f, (leaving, _) in zip(flux, down))
    exitance = ground * (diffuse + sunlit) / jnp.pi
    up = [
        _level(coarse, level, source[1, level], jnp.broadcast_to(exitance, source.shape[2:3] + ground.shape),
               jnp.zeros_like(sky), downward=False)
        for level in range(levels)
    ]
    top = sum(f * jnp.sum(leaving, axis=0) for f, (leaving, _) in zip(flux, up))
    mean = jnp.stack([jnp.stack([m for _, m in down]), jnp.stack([m for _, m in up])])
    return mean, diffuse, top


def _level(
    coarse: Coarse,
    level: int,
    source: Float[Array, "azimuth z y x"],
    entering: Radiance,
    outside: Float[Array, ""],
    *,
    downward: bool,
) -> tuple[Radiance, Float[Array, "azimuth z y x"]]:
    """Carry the ordinates of one level through all layers; leaving radiance, mean intensity."""
    ordinates, steps = coarse.ordinates, coarse.steps[level]
    cosine = ordinates.cosine[level]
    length = coarse.vertical / (steps * cosine)
    slope = np.sqrt(1 - cosine**2) / cosine
    azimuth = (np.arange(ordinates.azimuths) + 0.5) * (2 * np.pi / ordinates.azimuths)
    reach = coarse.vertical / steps * slope / coarse.horizontal  # cells per step
    moves = np.stack([np.sin(azimuth), np.cos(azimuth)]) * reach

    def shift(radiance: Radiance, share: float) -> Radiance:
        for axis, move in ((2, moves[0]), (1, moves[1])):
            radiance = _shift(radiance, move * share, axis, outside, coarse.boundary)
        return radiance

    def layer(radiance: Radiance, cell: tuple[Array, ...]) -> tuple[Radiance, Array]:
        emitted, through, mean, emission = cell
        emitted = emitted * length

        def step(carry: tuple[Array, Array], _: None) -> tuple[tuple[Array, Array], None]:
            radiance, total = carry
            radiance = shift(radiance, 1.0)
            total = total + radiance * mean + emitted * emission
            return (radiance * through + emitted * mean, total), None

        start = (radiance, jnp.zeros_like(radiance))
        (radiance, total), _ = jax.lax.scan(step, start, length=steps)
        return radiance, total / steps

    cells = (jnp.moveaxis(source, 1, 0), *(a[:, None] for a in coarse.attenuation[level]))
    # Steps are crossed at their middles: half a shift back before, half a shift on after.
    leaving, mean = jax.lax.scan(layer, shift(entering, -0.5), cells, reverse=downward)
    return shift(leaving, 0.5), jnp.moveaxis(mean, 0, 1)


def _shift(
    radiance: Radiance, move: np.ndarray, axis: int, outside: Float[Array, ""], boundary: str
) -> Radiance:
    """Move each ordinate's layer by `move` (at most one) cells along `axis`, linearly."""
    widths = [(1, 1) if a == axis else (0, 0) for a in range(3)]
    if boundary == "periodic":
        padded = jnp.pad(radiance, widths, mode="wrap")
    else:
        # `outside` is linear data (the sky), which pad's constant cannot be.
        edge = jnp.broadcast_to(outside, jax.lax.slice_in_dim(radiance, 0, 1, axis=axis).shape)
        padded = jnp.concatenate([edge, radiance, edge], axis=axis)
    size = radiance.shape[axis]
    before, here, after = (
        jax.lax.slice_in_dim(padded, start, start + size, axis=axis) for start in range(3)
    )
    share = jnp.asarray(move, radiance.dtype)[:, None, None]
    return (
        before * jnp.maximum(share, 0)
        + here * (1 - jnp.abs(share))
        + after * jnp.maximum(-share, 0)
    )

"""Scattering by flat leaves: the area scattering function of bi-Lambertian leaves.

Gamma(in, out) = rho Gamma_r + tau Gamma_t; leaves reflect from the lit side and transmit to the
other (Ross 1981, eq. 2.4.3; Shultis and Myneni 1988). It is linear in leaf reflectance and
transmittance, so the two geometric factors are computed once for all bands.
"""

from collections.abc import Sequence

import jax.numpy as jnp
from jaxtyping import Array, Float

from fynjax.canopy import AbstractLeafAngle, SphericalLeafAngle


def area_scattering(
    angle: AbstractLeafAngle,
    incoming: Float[Array, "incoming 3"],
    outgoing: Float[Array, "outgoing 3"],
) -> tuple[Float[Array, "incoming outgoing"], Float[Array, "incoming outgoing"]]:
    """Geometric factors (Gamma_r, Gamma_t) of reflection and transmission by leaves [-].

    **Arguments:**

    - `angle`: distribution of leaf normals.
    - `incoming`, `outgoing`: unit vectors along which the light *travels*.

    **Returns:** one factor for each pair of directions. (1/pi) times the integral of either over
    all outgoing directions is the projection G of the incoming one.

    Differentiable in the directions and in the parameters of `angle`. Ross (1981), eq. 2.4.3;
    Shultis and Myneni (1988).
    """
    reflected, transmitted = area_scattering_of((angle,), incoming, outgoing)
    return reflected[0], transmitted[0]


def area_scattering_of(
    angles: Sequence[AbstractLeafAngle],
    incoming: Float[Array, "incoming 3"],
    outgoing: Float[Array, "outgoing 3"],
) -> tuple[Float[Array, "angle incoming outgoing"], Float[Array, "angle incoming outgoing"]]:
    """`area_scattering` of several distributions at once."""
    dtype = incoming.dtype
    others = [angle for angle in angles if not isinstance(angle, SphericalLeafAngle)]
    pairs = []
    if others:
        normals = others[0].normals()[0].astype(dtype)  # the same of all
        weight = jnp.stack([angle.normals()[1] for angle in others]).astype(dtype)[:, None]
        towards, away = incoming @ normals.T, outgoing @ normals.T
        # |a||b| where a b < 0 is reflection, where a b > 0 transmission; split by sign so that the
        # sum over normals is a matrix product.
        lit = jnp.maximum(jnp.concatenate([towards, -towards], axis=1), 0)
        sides = jnp.concatenate([away, -away])
        sent = jnp.maximum(jnp.concatenate([-sides, sides], axis=1), 0)
        factors = (lit * jnp.concatenate([weight, weight], axis=2)) @ sent.T
        pairs = [*zip(*jnp.split(factors, 2, axis=2))]
    if len(others) < len(angles):
        pairs.append(_by_spheres(incoming, outgoing))
    place = iter(range(len(others)))
    both = [pairs[-1 if isinstance(a, SphericalLeafAngle) else next(place)] for a in angles]
    return jnp.stack([r for r, _ in both]), jnp.stack([t for _, t in both])


def _by_spheres(
    incoming: Float[Array, "incoming 3"], outgoing: Float[Array, "outgoing 3"]
) -> tuple[Float[Array, "incoming outgoing"], Float[Array, "incoming outgoing"]]:
    # Closed form in the scattering angle b (Ross 1981): exact, and cheap per pixel. The
    # arc tangent keeps the slope finite forward and backward, where arccos has none.
    cosine = incoming @ outgoing.T
    cross = jnp.cross(incoming[:, None, :], outgoing[None, :, :])
    square = jnp.sum(cross**2, axis=-1)
    sine = jnp.sqrt(jnp.where(square > 0, square, 1.0)) * (square > 0)
    reflected = (sine - jnp.arctan2(sine, cosine) * cosine) / (3 * jnp.pi)
    return reflected, reflected + cosine / 3.0

"""Directions and their conventions, in one place.

Axes are x east, y north, z up (metres). A direction is given by its zenith angle (0 is up) and
its azimuth, clockwise from north (0 north, 90 east), both in degrees. The unit vector points
*towards* the sun or the sensor; light from the sun travels the other way.
"""

import jax.numpy as jnp
from jaxtyping import Array, Float


def direction(zenith: Float[Array, "*n"], azimuth: Float[Array, "*n"]) -> Float[Array, "*n 3"]:
    """Unit vector towards (zenith, azimuth), both in degrees. Differentiable."""
    theta, phi = jnp.deg2rad(zenith), jnp.deg2rad(azimuth)
    sine = jnp.sin(theta)
    return jnp.stack(
        jnp.broadcast_arrays(sine * jnp.sin(phi), sine * jnp.cos(phi), jnp.cos(theta)), axis=-1
    )

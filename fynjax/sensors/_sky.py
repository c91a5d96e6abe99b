"""How much of the light on the ground comes from the sky: a clear-sky estimate."""

import jax.numpy as jnp
from jaxtyping import Array, Float

_ANGSTROM_EXPONENT = 1.3  # Ångström (1961), rural and continental aerosol
_AEROSOL_ALBEDO = 0.95
_AEROSOL_FORWARD = 0.82  # share of aerosol scattering that goes forward (Bird and Riordan 1986)


def clear_sky_diffuse_fraction(
    wavelength: Float[Array, " wavelength"],
    sun_zenith: Float[Array, ""],
    aerosol_optical_depth: Float[Array, ""],
) -> Float[Array, " wavelength"]:
    """Diffuse over global irradiance on a horizontal plane under a clear sky [-].

    **Arguments:** `wavelength` [nm], 400 to 2500; `sun_zenith` [degrees], below 85;
    `aerosol_optical_depth` at 500 nm [-], 0 to about 0.5.

    Single scattering by air (Rayleigh optical depth of Hansen and Travis 1974, eq. 2.30) and by
    aerosol (Ångström's law); half of what air scatters, and most of what aerosol does, comes down
    (Bird and Riordan 1986, eq. 3-10 to 3-13). Gases absorb direct and diffuse light nearly alike
    and are left out, so the share is meant outside their bands. Differentiable.
    """
    micrometre = jnp.asarray(wavelength) / 1000.0
    cosine = jnp.cos(jnp.deg2rad(sun_zenith))
    # Kasten and Young (1989), eq. 3.
    mass = 1.0 / (cosine + 0.50572 * (96.07995 - sun_zenith) ** -1.6364)
    square = micrometre**-2
    rayleigh = 0.008569 * square**2 * (1.0 + 0.0113 * square + 0.00013 * square**2)
    aerosol = aerosol_optical_depth * (micrometre / 0.5) ** -_ANGSTROM_EXPONENT
    direct = jnp.exp(-(rayleigh + aerosol) * mass)
    through_aerosol = jnp.exp(-aerosol * mass)
    through_air = jnp.exp(-rayleigh * mass)
    from_air = 0.5 * (1.0 - through_air**0.95)
    from_aerosol = through_air**1.5 * (1.0 - through_aerosol) * _AEROSOL_ALBEDO * _AEROSOL_FORWARD
    diffuse = from_air + from_aerosol
    return diffuse / (direct + diffuse)

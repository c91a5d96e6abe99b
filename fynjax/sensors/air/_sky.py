"""How much of the light on the ground comes from the sky: a clear-sky estimate."""

from jaxtyping import Array, Float

from fynjax.sensors.air._spectrl2 import aerosol_depth, rayleigh_depth, scattered_light


def clear_sky_diffuse_fraction(
    wavelength: Float[Array, " wavelength"],
    sun_zenith: Float[Array, ""],
    aerosol_optical_depth: Float[Array, ""],
) -> Float[Array, " wavelength"]:
    """Diffuse over global irradiance on a horizontal plane under a clear sky [-].

    **Arguments:**

    - `wavelength`: [nm], 400 to 2500.
    - `sun_zenith`: zenith angle of the sun [degrees], below 85.
    - `aerosol_optical_depth`: at 500 nm [-], 0 to about 0.5.

    The scattering part of SPCTRL2 (Bird and Riordan 1984) at sea level over a black ground. Gases
    absorb direct and diffuse light alike there, and so leave the share as it is.

    Differentiable in all arguments.
    """
    aerosol = aerosol_depth(wavelength, aerosol_optical_depth, 500.0)
    light = scattered_light(wavelength, sun_zenith, rayleigh_depth(wavelength), aerosol)
    return light.diffuse / (light.direct + light.diffuse)

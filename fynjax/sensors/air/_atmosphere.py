"""The air between sun, ground and sensor, as five curves and a spherical albedo."""

from __future__ import annotations  # so that `help` shows ArrayLike by its name

import dataclasses
import math
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Bool, Float

from fynjax._core.errors import InputError
from fynjax._core.math import real_array
from fynjax._core.spectral import check_wavelength
from fynjax.sensors._bands import BandSet, floats

SPACE = 100_000.0
"""Height of a sensor above all air [m]."""


class Atmosphere(eqx.Module):
    """What the air does to sunlight, per wavelength, for one sun and one sensor.

    The sensor looks straight down. The irradiances are those over a black ground. Wavelengths are
    static, so that bands may be averaged inside `jax.jit`. Raises `InputError` when the fields do
    not match, or when the wavelengths are not in nm.
    """

    wavelength: tuple[float, ...] = eqx.field(static=True, converter=floats)
    """Wavelengths of the curves [nm], increasing; at bands, the band centres."""
    direct: Float[Array, " wavelength"] = eqx.field(converter=real_array)
    """Irradiance of a horizontal plane on the ground by the sun [W m-2 um-1]."""
    diffuse: Float[Array, " wavelength"] = eqx.field(converter=real_array)
    """Irradiance of the ground by the sky [W m-2 um-1]."""
    upward_direct: Float[Array, " wavelength"] = eqx.field(converter=real_array)
    """Share of a pixel's radiance that reaches the sensor unscattered [-]."""
    upward_diffuse: Float[Array, " wavelength"] = eqx.field(converter=real_array)
    """Radiance that a wide ground sends into the line of sight by way of the air's scattering, over
    its own radiance [-]. It comes from the surroundings, within some hundred metres to
    kilometres."""
    path_radiance: Float[Array, " wavelength"] = eqx.field(converter=real_array)
    """Radiance that the air itself sends to the sensor [W m-2 sr-1 um-1]."""
    spherical_albedo: Float[Array, " wavelength"] = eqx.field(converter=real_array)
    """Share of the ground's light that the air sends back to the ground [-]."""

    def __check_init__(self) -> None:
        grid = check_wavelength(self.wavelength, "the wavelengths of an atmosphere")
        for field in dataclasses.fields(self)[1:]:
            if (shape := jnp.shape(getattr(self, field.name))) != grid.shape:
                raise InputError(
                    f"`{field.name}` must have one value for each of the {grid.size} wavelengths, "
                    f"but has shape {shape}. For many atmospheres use `jax.vmap`."
                )

    @property
    def upward_transmittance(self) -> Float[Array, " wavelength"]:
        """Share of a wide ground's radiance that reaches the sensor, direct and diffuse [-]."""
        return self.upward_direct + self.upward_diffuse


class ClearAir(eqx.Module):
    """A cloudless atmosphere and where its sun and sensor are. Scalars; many by `jax.vmap`.

    Raises `InputError` for impossible values, where they are known before tracing.
    """

    sun_zenith: Float[Array, ""] = eqx.field(converter=real_array)
    """Zenith angle of the sun [degrees], 0 to below 90."""
    water_vapour: Float[Array, ""] = eqx.field(converter=real_array, default=1.5)
    """Column of water vapour [g cm-2], the same number as in cm of water."""
    aerosol_optical_depth: Float[Array, ""] = eqx.field(converter=real_array, default=0.1)
    """Optical depth of aerosol at 550 nm, straight up [-]."""
    ozone: Float[Array, ""] = eqx.field(converter=real_array, default=0.3)
    """Column of ozone [cm-atm]; 0.3 are 300 Dobson units."""
    pressure: Float[Array, ""] = eqx.field(converter=real_array, default=1013.25)
    """Air pressure at the ground, not reduced to sea level [hPa]."""
    sensor_height: Float[Array, ""] = eqx.field(converter=real_array, default=SPACE)
    """Height of the sensor above the ground [m]; from 100 km on it is in space."""
    solar_factor: Float[Array, ""] = eqx.field(converter=real_array, default=1.0)
    """Sunlight of the day over that at one astronomical unit [-], 0.966 to 1.035."""

    def __check_init__(self) -> None:
        limits = {
            "water_vapour": (0.0, 12.0, "g cm-2", "was it given in kg m-2, or mm? Divide by 10"),
            "aerosol_optical_depth": (0.0, 5.0, "-", "it is taken at 550 nm"),
            "ozone": (0.0, 1.0, "cm-atm", "was it given in Dobson units? Divide by 1000"),
            "pressure": (300.0, 1100.0, "hPa", "was it given in Pa? Divide by 100"),
            "sensor_height": (0.0, math.inf, "m", "it counts from the ground upward"),
            "solar_factor": (0.9, 1.1, "-", "it is 1 over the squared distance in au"),
        }
        for name in ("sun_zenith", *limits):
            if (shape := jnp.shape(getattr(self, name))) != ():
                raise InputError(
                    f"`{name}` must be one number, but has shape {shape}. For many use `jax.vmap`."
                )
        if not isinstance(self.sun_zenith, jax.core.Tracer):
            check_sun(float(self.sun_zenith))
        for name, (low, high, unit, hint) in limits.items():
            value = getattr(self, name)
            if not isinstance(value, jax.core.Tracer) and not low <= float(value) <= high:
                raise InputError(
                    f"`{name}` must be in {low:g} to {high:g} {unit}, but is {float(value):g}: "
                    f"{hint}."
                )


def check_sun(zenith: float) -> None:
    """Raise `InputError` unless the sun's zenith angle [degrees] is above the horizon."""
    if not 0.0 <= zenith < 90.0:
        raise InputError(
            f"`sun_zenith` must be in [0, 90) degrees, but is {zenith:g}: the sun is at or below "
            "the horizon, or the angle is none of zenith."
        )


def ground_irradiance(
    atmosphere: Atmosphere, reflectance: Float[Array, "*batch wavelength"]
) -> Float[Array, "*batch wavelength"]:
    """Irradiance of a wide ground, (direct + diffuse) / (1 - S rho) [W m-2 um-1].

    Light that the ground sends up and the air sends back is counted to all orders.

    **Arguments:**

    - `atmosphere`: of one sun; its sensor plays no part.
    - `reflectance`: rho of the ground [-], on the atmosphere's wavelengths, its last axis.

    Differentiable, to any order, in both.
    """
    black = atmosphere.direct + atmosphere.diffuse
    return black / (1.0 - atmosphere.spherical_albedo * reflectance)


def at_sensor_radiance(
    atmosphere: Atmosphere,
    reflectance: Float[ArrayLike, "*batch wavelength"],
    surroundings: Float[ArrayLike, "*#batch wavelength"] | None = None,
) -> Float[Array, "*batch wavelength"]:
    """Radiance at the sensor over a ground of given reflectance [W m-2 sr-1 um-1].

    L = path + E / pi (T_direct rho + T_diffuse rho_around) / (1 - S rho_around), E the irradiance
    over a black ground: Vermote et al. (1997), IEEE Transactions on Geoscience and Remote Sensing
    35, 675-686.

    **Arguments:**

    - `atmosphere`: of one sun and one sensor.
    - `reflectance`: rho of the pixel (reflectance factor towards the sensor, fraction) on the
      atmosphere's wavelengths, its last axis.
    - `surroundings`: rho_around, the reflectance of the wide surroundings, which light the pixel
      and the line of sight by way of the air (adjacency), on the same wavelengths. Left out, the
      pixel's own: the ground is uniform. Of a picture, its mean.

    Differentiable, to any order, in all arguments.

    >>> import jax.numpy as jnp
    >>> from fynjax.sensors import Atmosphere, at_sensor_radiance, surface_reflectance
    >>> atmosphere = Atmosphere(
    ...     wavelength=(560.0, 860.0),
    ...     direct=jnp.array([1200.0, 700.0]),
    ...     diffuse=jnp.array([250.0, 60.0]),
    ...     upward_direct=jnp.array([0.75, 0.9]),
    ...     upward_diffuse=jnp.array([0.1, 0.05]),
    ...     path_radiance=jnp.array([25.0, 5.0]),
    ...     spherical_albedo=jnp.array([0.11, 0.05]),
    ... )
    >>> dark = jnp.array([0.06, 0.35])
    >>> at_sensor_radiance(atmosphere, dark).round(1)
    Array([48.7, 86.9], dtype=float32)
    >>> radiance = at_sensor_radiance(atmosphere, dark, jnp.array([0.16, 0.35]))
    >>> radiance.round(1)
    Array([53.7, 86.9], dtype=float32)
    >>> surface_reflectance(atmosphere, radiance, jnp.array([0.16, 0.35])).round(6)
    Array([0.06, 0.35], dtype=float32)
    """
    reflectance = _on_grid(atmosphere, reflectance, "reflectance")
    around = surroundings if surroundings is not None else reflectance
    around = _on_grid(atmosphere, around, "surroundings")
    # The pixel itself shines straight up, its surroundings by way of the air.
    upward = atmosphere.upward_direct * reflectance + atmosphere.upward_diffuse * around
    return atmosphere.path_radiance + upward * ground_irradiance(atmosphere, around) / jnp.pi


def is_transparent(atmosphere: Atmosphere, threshold: float = 0.01) -> Bool[Array, " wavelength"]:
    """Where the air transmits enough light to observe the ground, as true and false [bool].

    True where a white ground would send the sensor at least `threshold` times the largest radiance
    of any wavelength. Water vapour makes the air opaque near 1400 and 1900 nm.

    **Arguments:**

    - `atmosphere`: of one sun and one sensor.
    - `threshold`: share of the largest radiance [-], 0 to 1.
    """
    signal = atmosphere.upward_transmittance * (atmosphere.direct + atmosphere.diffuse)
    return signal >= threshold * jnp.max(signal)


def surface_reflectance(
    atmosphere: Atmosphere,
    radiance: Float[ArrayLike, "*batch wavelength"],
    surroundings: Float[ArrayLike, "*#batch wavelength"] | None = None,
    *,
    threshold: float = 0.01,
    opaque: float = 0.0,
) -> Float[Array, "*batch wavelength"]:
    """Reflectance of the ground from radiance at the sensor [-]: inverts `at_sensor_radiance`.

    With y = pi (L - path) / E: rho = y / (T_direct + T_diffuse + S y) of a uniform ground, or
    (y (1 - S rho_around) - T_diffuse rho_around) / T_direct.

    **Arguments:**

    - `atmosphere`: of one sun and one sensor.
    - `radiance`: L at the sensor [W m-2 sr-1 um-1], wavelengths on the last axis.
    - `surroundings`: rho_around, reflectance of the wide surroundings [-]; the pixel's own if left
      out. With it the direct transmittance must be above zero where the air is not opaque.
    - `threshold`: where the air is opaque, see `is_transparent`.
    - `opaque`: value where the air is opaque and the ground cannot be observed.

    Differentiable in the arrays; the slope is zero where the air is opaque. An example stands at
    `at_sensor_radiance`.
    """
    radiance = _on_grid(atmosphere, radiance, "radiance")
    clear = is_transparent(atmosphere, threshold)
    # The branch not taken must be finite too.
    black = jnp.where(clear, atmosphere.direct + atmosphere.diffuse, 1.0)
    scaled = jnp.pi * (radiance - atmosphere.path_radiance) / black
    scaled = jnp.where(clear, scaled, 0.0)
    if surroundings is None:
        upward = jnp.where(clear, atmosphere.upward_transmittance, 1.0)
        value = scaled / (upward + atmosphere.spherical_albedo * scaled)
    else:
        around = _on_grid(atmosphere, surroundings, "surroundings")
        # Haze that lets no direct light up hides the pixel, though not its surroundings.
        least_direct = threshold * jnp.max(atmosphere.upward_transmittance)
        clear &= atmosphere.upward_direct > least_direct
        scaled = jnp.where(clear, scaled, 0.0)
        coupled = scaled * (1.0 - atmosphere.spherical_albedo * around)
        upward = jnp.where(clear, atmosphere.upward_direct, 1.0)
        value = (coupled - atmosphere.upward_diffuse * around) / upward
    return jnp.where(clear, value, jnp.asarray(opaque, value.dtype))


def band_atmosphere(atmosphere: Atmosphere, bands: BandSet) -> Atmosphere:
    """The atmosphere of a sensor's bands, for ground whose reflectance is even within a band.

    Irradiances and path radiance are band averages; the transmittances are weighted with the light
    they pass on, the spherical albedo with what reaches the sensor. With it, images in bands can
    go to radiance and back without their spectra. Averaging the radiance itself
    (`bands.average(atmosphere.wavelength, radiance)`) is exact and to be preferred where the
    spectrum is known.

    **Arguments:**

    - `atmosphere`: on its own wavelengths, which must cover the bands.
    - `bands`: of the sensor, in increasing order of their centres.

    **Raises:** `InputError` where a band lies outside the atmosphere's wavelengths.

    Differentiable in every curve of `atmosphere`: linear or smooth.
    """

    def average(curve: Float[Array, " wavelength"]) -> Float[Array, " band"]:
        return bands.average(atmosphere.wavelength, curve)

    total = atmosphere.direct + atmosphere.diffuse
    ground_signal = atmosphere.upward_transmittance * total
    # Opaque bands have no light to weight with: then any weight serves.
    tiny = jnp.finfo(total.dtype).tiny ** 0.5
    on_ground = average(total) + tiny
    return Atmosphere(
        bands.centre,
        average(atmosphere.direct),
        average(atmosphere.diffuse),
        average(atmosphere.upward_direct * total) / on_ground,
        average(atmosphere.upward_diffuse * total) / on_ground,
        average(atmosphere.path_radiance),
        average(atmosphere.spherical_albedo * ground_signal) / (average(ground_signal) + tiny),
    )


def _on_grid(atmosphere: Atmosphere, values: Any, what: str) -> Array:
    array = real_array(values)
    count = len(atmosphere.wavelength)
    if array.shape[-1:] != (count,):
        raise InputError(
            f"`{what}` must have the atmosphere's {count} wavelengths on its last axis, but its "
            f"shape is {array.shape}."
        )
    return array

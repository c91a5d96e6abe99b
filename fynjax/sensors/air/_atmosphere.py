"""The air between sun, ground and sensor, as four curves and a spherical albedo."""

import math
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from fynjax._core.errors import InputError
from fynjax._core.math import real_array
from fynjax._core.spectral import check_wavelength
from fynjax.sensors._bands import BandSet

SPACE = 100_000.0
"""Height of a sensor above all air [m]."""

_CURVES = ("direct", "diffuse", "upward_transmittance", "path_radiance", "spherical_albedo")


def _wavelengths(values: Any) -> tuple[float, ...]:
    return tuple(float(v) for v in np.atleast_1d(np.asarray(values, dtype=np.float64)))


class Atmosphere(eqx.Module):
    """What the air does to sunlight, per wavelength, for one sun and one sensor.

    The sensor looks straight down. The irradiances are those over a black ground. Wavelengths are
    static, so that bands may be averaged inside `jax.jit`. Raises `InputError` when the fields do
    not match, or when the wavelengths are not in nm.
    """

    wavelength: tuple[float, ...] = eqx.field(static=True, converter=_wavelengths)
    """Wavelengths of the curves [nm], increasing; at bands, the band centres."""
    direct: Float[Array, " wavelength"] = eqx.field(converter=real_array)
    """Irradiance of a horizontal plane on the ground by the sun [W m-2 um-1]."""
    diffuse: Float[Array, " wavelength"] = eqx.field(converter=real_array)
    """Irradiance of the ground by the sky [W m-2 um-1]."""
    upward_transmittance: Float[Array, " wavelength"] = eqx.field(converter=real_array)
    """Share of the ground's radiance that reaches the sensor, scattered light included [-]."""
    path_radiance: Float[Array, " wavelength"] = eqx.field(converter=real_array)
    """Radiance that the air itself sends to the sensor [W m-2 sr-1 um-1]."""
    spherical_albedo: Float[Array, " wavelength"] = eqx.field(converter=real_array)
    """Share of the ground's light that the air sends back to the ground [-]."""

    def __check_init__(self) -> None:
        grid = check_wavelength(self.wavelength, "the wavelengths of an atmosphere")
        for name in _CURVES:
            if (shape := jnp.shape(getattr(self, name))) != grid.shape:
                raise InputError(
                    f"`{name}` must have one value for each of the {grid.size} wavelengths, but "
                    f"has shape {shape}. For many atmospheres use `jax.vmap`."
                )


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
    reflectance: Float[Array, "*batch wavelength"],
    background: Float[Array, "*batch wavelength"] | None = None,
) -> Float[Array, "*batch wavelength"]:
    """Radiance at the sensor over a ground of given reflectance [W m-2 sr-1 um-1].

    L = path + T_up rho E / (pi (1 - S rho)), for example Vermote et al. (1997), eq. 8 and 16.

    **Arguments:**

    - `atmosphere`: of one sun and one sensor.
    - `reflectance`: of the pixel (reflectance factor towards the sensor, fraction) on the
      atmosphere's wavelengths, its last axis.
    - `background`: reflectance of the wide surroundings that light the pixel by way of the air; the
      pixel's own if left out. Light that the surroundings send into the line of sight (adjacency)
      is not separated from the pixel's.

    Differentiable, to any order, in all arguments.

    >>> import jax.numpy as jnp
    >>> from fynjax.sensors import Atmosphere, at_sensor_radiance, surface_reflectance
    >>> atmosphere = Atmosphere(
    ...     wavelength=(560.0, 860.0),
    ...     direct=jnp.array([1200.0, 700.0]),
    ...     diffuse=jnp.array([250.0, 60.0]),
    ...     upward_transmittance=jnp.array([0.85, 0.95]),
    ...     path_radiance=jnp.array([25.0, 5.0]),
    ...     spherical_albedo=jnp.array([0.11, 0.05]),
    ... )
    >>> radiance = at_sensor_radiance(atmosphere, jnp.array([0.06, 0.35]))
    >>> radiance.round(1)
    Array([48.7, 86.9], dtype=float64)
    >>> surface_reflectance(atmosphere, radiance).round(6)
    Array([0.06, 0.35], dtype=float64)
    """
    reflectance = _on_grid(atmosphere, reflectance, "reflectance")
    around = reflectance if background is None else _on_grid(atmosphere, background, "background")
    lit = ground_irradiance(atmosphere, around) * reflectance / jnp.pi
    return atmosphere.path_radiance + atmosphere.upward_transmittance * lit


def is_transparent(atmosphere: Atmosphere, threshold: float = 0.01) -> Float[Array, " wavelength"]:
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
    radiance: Float[Array, "*batch wavelength"],
    background: Float[Array, "*batch wavelength"] | None = None,
    *,
    threshold: float = 0.01,
    opaque: float = 0.0,
) -> Float[Array, "*batch wavelength"]:
    """Reflectance of the ground from radiance at the sensor [-]: inverts `at_sensor_radiance`.

    y = pi (L - path) / (T_up E), rho = y / (1 + S y), or y (1 - S background).

    **Arguments:**

    - `atmosphere`: of one sun and one sensor.
    - `radiance`: L at the sensor [W m-2 sr-1 um-1], wavelengths on the last axis.
    - `background`: reflectance of the wide surroundings [-]; the pixel's own if left out.
    - `threshold`: where the air is opaque, see `is_transparent`.
    - `opaque`: value where the air is opaque and the ground cannot be observed.

    Differentiable in the arrays; the slope is zero where the air is opaque. An example stands at
    `at_sensor_radiance`.
    """
    radiance = _on_grid(atmosphere, radiance, "radiance")
    clear = is_transparent(atmosphere, threshold)
    signal = atmosphere.upward_transmittance * (atmosphere.direct + atmosphere.diffuse)
    signal = jnp.where(clear, signal, 1.0)  # the branch not taken must be finite too
    scaled = jnp.pi * (radiance - atmosphere.path_radiance) / signal
    scaled = jnp.where(clear, scaled, 0.0)
    if background is None:
        value = scaled / (1.0 + atmosphere.spherical_albedo * scaled)
    else:
        around = _on_grid(atmosphere, background, "background")
        value = scaled * (1.0 - atmosphere.spherical_albedo * around)
    return jnp.where(clear, value, jnp.asarray(opaque, value.dtype))


def band_atmosphere(atmosphere: Atmosphere, bands: BandSet) -> Atmosphere:
    """The atmosphere of a sensor's bands, for ground whose reflectance is even within a band.

    Irradiances and path radiance are band averages; the transmittance is weighted with the light
    it passes on, the spherical albedo with what reaches the sensor. With it, images in bands can
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
    return Atmosphere(
        bands.centre,
        average(atmosphere.direct),
        average(atmosphere.diffuse),
        average(ground_signal) / (average(total) + tiny),
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

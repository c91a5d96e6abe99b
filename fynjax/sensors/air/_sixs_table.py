"""Atmospheres interpolated in a table that 6SV computed (`tools/make_sixs_table.py`).

6SV multiplies a scattering part by a gas part, and so does this. Every axis is a cubic spline in a
variable that makes the tabulated function nearly straight: ln T of gas in the square root of the
water column and of the air mass, scattering in the cosine of the sun's zenith angle, in the
aerosol's optical depth and in the share of the air that lies below the sensor, and in the logarithm
of the wavelength.
"""

from functools import lru_cache, partial
from importlib import resources
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from fynjax._core.errors import InputError
from fynjax.sensors.air._atmosphere import Atmosphere, ClearAir

_AIR_SCALE_HEIGHT = 8.0  # km; aerosol, of 2 km, is then a polynomial of the share of air below
_GAS_SCALE_HEIGHT = 4.0  # between those of water vapour and air
_AEROSOL_SCALE_HEIGHT = 2.0  # km, of 6SV
# Pressure of the standard atmosphere over that of the ground, (1 - height / 44.33 km) ** 5.256.
_TOP = 44.33
_BAROMETRIC_EXPONENT = 5.256
_SMALL = 1e-6  # keeps logarithms finite where 6SV prints zero

Constants = NDArray[np.float64]


class _Spline(NamedTuple):
    """Cubic spline through values not yet known: weights of the nodes at any point."""

    nodes: Constants
    coefficients: Constants
    """Coefficients of the spline [power, interval, node], highest power first."""

    def weights(self, x: Float[Array, ""]) -> Float[Array, " node"]:
        """Weight of each node at x, which is moved to the nodes' range. Differentiable in x."""
        # Arrays of their own: see the last words of `fynjax._core.precision`.
        dtype = jnp.asarray(x).dtype
        return _weights(jnp.asarray(self.nodes, dtype), jnp.asarray(self.coefficients, dtype), x)


@partial(jax.jit, inline=True)
def _weights(nodes: Array, coefficients: Array, x: Array) -> Array:
    x = jnp.clip(x, nodes[0], nodes[-1])
    at = jnp.clip(jnp.searchsorted(nodes, x, side="right") - 1, 0, len(nodes) - 2)
    piece = coefficients[:, at]
    t = x - nodes[at]
    return ((piece[0] * t + piece[1]) * t + piece[2]) * t + piece[3]


def _spline(nodes: Any) -> _Spline:
    nodes = np.asarray(nodes, np.float64)
    spline = CubicSpline(nodes, np.eye(nodes.size))
    return _Spline(nodes, spline.c)


class _Table(NamedTuple):
    """The table's values in the variables that they are interpolated in."""

    wavelength: Constants
    gas: Constants
    """-ln T of gases but ozone, down and up [height, water, sun, wavelength]."""
    gas_axes: tuple[_Spline, _Spline, _Spline]
    """Splines in the share below the sensor, root of water, root of air mass."""
    ozone: Constants
    """Absorption coefficient [1/(cm-atm)]."""
    ozone_below: tuple[Constants, Constants]
    """Heights [km] and the share of ozone below them."""
    solar: Constants
    rayleigh: Constants
    """Optical depth of air at the two pressures [pressure, scattering wavelength]."""
    extinction: Constants
    """Aerosol's optical depth over that at 550 nm."""
    low: dict[str, Constants]
    """Scattering curves at the first pressure [aerosol, ..., scattering wavelength]."""
    step: dict[str, Constants]
    """Without aerosol, the second pressure's curves less the first's."""
    pressure: Constants
    sun: _Spline
    aerosol: _Spline
    height: _Spline
    to_fine: Constants
    """Spline in ln wavelength, from scattering wavelengths to all [wavelength, scattering]."""


@lru_cache(maxsize=1)
def _load() -> _Table:
    import xarray as xr  # takes a quarter of a second

    with (
        resources.as_file(resources.files("fynjax.sensors") / "data") as folder,
        xr.open_dataset(folder / "sixs_continental.nc.gz", engine="scipy") as data,
    ):
        return _prepare(
            {str(k): np.asarray(v.values, np.float64) for k, v in data.variables.items()}
        )


def _prepare(table: dict[str, Constants]) -> _Table:
    cosine = np.cos(np.deg2rad(table["sun"]))
    below = -np.expm1(-table["height"] / _AIR_SCALE_HEIGHT)
    below[-1] = 1.0
    extinction = table["aerosol_extinction"]
    rayleigh = np.stack([table["rayleigh_depth"], table["rayleigh_depth_high"]])
    depth = rayleigh[0] + table["aerosol"][:, None] * extinction

    def curves(suffix: str, depth: Constants) -> dict[str, Constants]:
        # [aerosol, sun, wavelength]: what of the sunbeam neither air nor aerosol scatters.
        beam = np.exp(-depth[..., None, :] / cosine[:, None])
        return {
            # Light that scattering sends to the ground, for one through its top.
            "diffuse": np.maximum(table[f"scattering_down{suffix}"] - beam, 0.0),
            # Per share of air below the sensor, finite for a sensor on the ground.
            "up": -np.log(table[f"scattering_up{suffix}"]) / below[:, None],
            "path": table[f"path_reflectance{suffix}"] / below[:, None, None] * cosine[:, None],
            "albedo": table[f"spherical_albedo{suffix}"],
        }

    low, high = curves("", depth), curves("_high", rayleigh[1])
    gas_below = -np.expm1(-table["gas_height"] / _GAS_SCALE_HEIGHT)
    gas_below[-1] = 1.0
    coarse = np.log(table["scattering_wavelength"])
    return _Table(
        wavelength=table["wavelength"],
        gas=table["gas"],
        gas_axes=(
            _spline(gas_below),
            _spline(np.sqrt(table["water"])),
            _spline(np.cos(np.deg2rad(table["gas_sun"])) ** -0.5),
        ),
        ozone=table["ozone_coefficient"],
        ozone_below=(table["ozone_height"], table["ozone_below"]),
        solar=table["solar"],
        rayleigh=rayleigh,
        extinction=extinction,
        low=low,
        step={name: high[name] - low[name][0] for name in low},
        pressure=table["pressure"],
        sun=_spline(cosine[::-1]),
        aerosol=_spline(table["aerosol"]),
        height=_spline(below),
        to_fine=CubicSpline(coarse, np.eye(coarse.size))(np.log(table["wavelength"])),
    )


def table_limits() -> dict[str, tuple[float, float]]:
    """Lowest and highest value of each field of `ClearAir` that the table covers, by its name."""
    table = _load()
    _, water, mass = table.gas_axes
    zenith = min(
        np.rad2deg(np.arccos(mass.nodes[-1] ** -2)), np.rad2deg(np.arccos(table.sun.nodes[0]))
    )
    return {
        "sun_zenith": (0.0, float(zenith)),
        "water_vapour": (0.0, float(water.nodes[-1] ** 2)),
        "aerosol_optical_depth": (0.0, float(table.aerosol.nodes[-1])),
        "pressure": (600.0, 1080.0),
    }


def check_within_table(air: ClearAir) -> None:
    """Check that an atmosphere lies within the table.

    **Arguments:**

    - `air`: the atmosphere.

    **Raises:** `InputError` for a field outside the table, where it is known before tracing.
    """
    for name, (low, high) in table_limits().items():
        value = getattr(air, name)
        known = not isinstance(value, jax.core.Tracer)
        if known and not low - 1e-4 <= float(value) <= high + 1e-4:
            raise InputError(
                f"`{name}` must be within the table, {low:g} to {high:g}, but is {float(value):g}."
            )


def tabulated_atmosphere(air: ClearAir) -> Atmosphere:
    """Atmosphere interpolated in a table of 6SV, every 2.5 nm from 400 to 2500 nm.

    All curves, for a nadir sensor at any height. Sunlight is that of TSIS-1 times
    `air.solar_factor`. The upward transmittances are the sensor's gain per light on the ground,
    whose absorption lines are dark already, and may exceed that of unfiltered light. Their sum is
    6SV's; direct is what the optical depths below the sensor leave (air as in the standard
    atmosphere, aerosol with 6SV's scale height of 2 km), diffuse the rest, and gas dims both alike,
    as in 6SV. Aerosol is 6SV's continental. Pressure changes scattering by air, and oxygen, carbon
    dioxide and methane in proportion.

    **Arguments:**

    - `air`: the atmosphere, within the table (`check_within_table`).

    **Raises:** `InputError` for a field outside the table, where it is known before tracing; a
    traced one is moved to the nearest end, with slope zero.

    Differentiable in all fields of `air`; twice, but for height in ozone. Vermote et al. (1997),
    IEEE Transactions on Geoscience and Remote Sensing 35, 675-686; Kotchenova et al. (2006),
    Applied Optics 45, 6762-6774.

    >>> from fynjax.sensors import ClearAir, tabulated_atmosphere
    >>> atmosphere = tabulated_atmosphere(ClearAir(sun_zenith=30.0, water_vapour=2.0))
    >>> len(atmosphere.wavelength), atmosphere.wavelength[0], atmosphere.wavelength[-1]
    (841, 400.0, 2500.0)
    """
    check_within_table(air)
    table = _load()
    dtype = jnp.result_type(*vars(air).values())

    def constant(values: Constants) -> Array:
        return jnp.asarray(values, dtype)

    cosine = jnp.cos(jnp.deg2rad(air.sun_zenith)).astype(dtype)
    height = (air.sensor_height / 1000.0).astype(dtype)
    # Gas depths down, and down and up with all, half and none of the water.
    down, both, half, dry = _gas(table, air, cosine, height, dtype)

    # Scattering, at the few wavelengths of the table.
    sea, high = (float(p) for p in table.pressure)
    # Way from the pressure at sea to the second of the table, beyond either too.
    thinner = (air.pressure - sea) / (high - sea)
    share = -jnp.expm1(-height / _AIR_SCALE_HEIGHT)
    sun = table.sun.weights(cosine)[::-1]
    layer = table.height.weights(share)
    haze = table.aerosol.weights(air.aerosol_optical_depth.astype(dtype))
    lower, upper = constant(table.rayleigh)
    particles = air.aerosol_optical_depth * constant(table.extinction)
    depth = lower + thinner * (upper - lower) + particles

    def curve(name: str, *axes: Array, change: Any = thinner) -> tuple[Array, Array]:
        """A curve with and without aerosol; `change` is the way to the second pressure."""
        step, low = constant(table.step[name]), constant(table.low[name])
        for weights in axes:
            step = jnp.tensordot(weights, step, axes=(0, 0))
            low = jnp.tensordot(weights, low, axes=(0, 1))
        return jnp.tensordot(haze, low, axes=(0, 0)) + change * step, low[0] + change * step

    diffuse, diffuse_air = curve("diffuse", sun, change=0.0)
    # Thinner air lets the same factor more of all light through, under any aerosol.
    through = [diffuse_air + jnp.exp(-lower / cosine)]
    step = jnp.tensordot(sun, constant(table.step["diffuse"]), axes=(0, 0))
    through.append(diffuse_air + step + jnp.exp(-upper / cosine))
    gain = jnp.exp(thinner * jnp.log(through[1] / through[0]))
    beam = jnp.exp(-(lower + particles) / cosine)
    diffuse = (diffuse + beam) * gain - jnp.exp(-depth / cosine)

    def fine(values: Array) -> Float[Array, " wavelength"]:
        return jnp.exp(constant(table.to_fine) @ jnp.log(jnp.maximum(values, _SMALL)))

    air_below = 1.0 - jnp.maximum(1.0 - height / _TOP, 0.0) ** _BAROMETRIC_EXPONENT
    haze_below = -jnp.expm1(-height / _AEROSOL_SCALE_HEIGHT)
    extinction = fine(constant(table.extinction)) * air.aerosol_optical_depth
    depth_below = air_below * fine(lower + thinner * (upper - lower)) + haze_below * extinction
    # Lines that are dark on the way down cannot take light away again on the way up.
    upward_direct = jnp.exp(-depth_below - (both - down))
    scattered = depth_below - share * fine(curve("up", layer)[0])
    path_all, path_air = (fine(v) / cosine * share for v in curve("path", layer, sun))
    solar = constant(table.solar) * air.solar_factor
    on_top = solar * cosine
    # Water vapour lies among the aerosol: half of it dims the light that aerosol sends up (6SV).
    reflectance = (path_all - path_air) * jnp.exp(-half) + path_air * jnp.exp(-dry)
    return Atmosphere(
        tuple(table.wavelength),
        on_top * jnp.exp(-fine(depth) / cosine - down),
        on_top * fine(diffuse) * jnp.exp(-down),
        upward_direct,
        upward_direct * jnp.expm1(scattered),
        on_top * reflectance / jnp.pi,
        fine(curve("albedo")[0]),
    )


def _gas(
    table: _Table, air: ClearAir, cosine: Array, height: Array, dtype: Any
) -> tuple[Array, Array, Array, Array]:
    """-ln T of gas: to the ground; and up again with all, half and none of the water."""
    below, root_water, root_mass = table.gas_axes
    mass = root_mass.weights(cosine**-0.5)
    level = below.weights(-jnp.expm1(-height / _GAS_SCALE_HEIGHT))
    # The first height of the table is the ground.
    ground = jnp.zeros_like(level).at[0].set(1.0)
    gas = jnp.tensordot(jnp.asarray(table.gas, dtype), mass, axes=(2, 0))
    gas = jnp.stack([ground, level]) @ gas.transpose(1, 0, 2)  # [water, path, wavelength]
    share = jnp.interp(height, *(jnp.asarray(v, dtype) for v in table.ozone_below))
    ozone = jnp.asarray(table.ozone, dtype) * air.ozone
    # Oxygen and others grow in number and in width of lines with the pressure. Water's lines only
    # grow wider: where they are dark, that is like more water.
    relative = (air.pressure / float(table.pressure[0])).astype(dtype)
    other = gas[0] * (relative - 1.0)

    def at(water: Any, path: int) -> Array:
        column = jnp.maximum(water * relative, 1e-6)  # the root's slope stays finite
        masses = 1.0 / cosine + (share if path else 0.0)
        return root_water.weights(jnp.sqrt(column)) @ gas[:, path] + other[path] + ozone * masses

    water = air.water_vapour
    return at(water, 0), at(water, 1), at(0.5 * water, 1), at(0.0 * water, 1)

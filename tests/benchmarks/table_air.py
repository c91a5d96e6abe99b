"""Radiance of a lawn and a walk through the air, modelled and measured by AVIRIS-NG:
`python -m tests.benchmarks.table_air`.

`FYNJAX_SHARED_DATA` names the folder of references. Prints, in windows of wavelength,

- modelled over measured radiance of the lawn, less one: without surroundings, with them, and with
  one more thing changed at a time;
- what surroundings change over lawn and walk at the same reflectance of the target, and the walk's
  reflectance with and without them (it has no field spectrum);
- the table of atmospheres against a spectrum by 6S itself.

Nothing is fitted but the column of water vapour, to its own bands. Rows marked (not known) are no
measurements of that day: they say how much such a change would do.
"""

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import numpy as np
import pandas as pd

from fynjax.scene import mixed_surroundings
from fynjax.sensors import (
    Atmosphere,
    ClearAir,
    at_sensor_radiance,
    surface_reflectance,
    tabulated_atmosphere,
)
from fynjax.sensors.air import _sixs_table
from tests.pasadena import (
    WAVELENGTH,
    Flight,
    fitted_water,
    half_walk,
    in_windows,
    read_flight,
    window_error,
)

WINDOWS = (
    (430, 500), (500, 560), (560, 600), (600, 650), (650, 700),
    (770, 900), (1000, 1080), (1200, 1300), (1520, 1750), (2100, 2350),
)  # fmt: skip
VISIBILITY_DEPTH = 0.12
"""Optical depth of aerosol at 550 nm of some 50 km of visibility, that of the file for MODTRAN."""
_atmosphere = eqx.filter_jit(tabulated_atmosphere)


def with_depths(flight: Flight, air: ClearAir) -> Atmosphere:
    """Each wavelength with the optical depth that the photometer measured there, in place of the
    table's aerosol through its value at 550 nm: the curves of several depths, interpolated."""
    wavelength, depth = flight.photometer.T
    measured = np.exp(np.interp(np.log(WAVELENGTH), np.log(wavelength), np.log(depth)))
    table = _sixs_table._load(None)
    extinction = np.exp(table.to_fine @ np.log(table.extinction))
    nodes = np.linspace(0.0, 0.12, 13)
    many = jax.vmap(lambda d: tabulated_atmosphere(eqx.tree_at(_depth_of, air, d)))(nodes)
    at = np.minimum(measured / extinction, nodes[-1]) / nodes[1]
    below = np.minimum(at.astype(int), len(nodes) - 2)
    every, share = np.arange(WAVELENGTH.size), at - below
    return jax.tree.map(
        lambda v: (1.0 - share) * v[below, every] + share * v[below + 1, every], many
    )


def _depth_of(air: ClearAir) -> Any:
    return air.aerosol_optical_depth


def photometer_ozone(flight: Flight) -> float:
    """Column of ozone [cm-atm] that absorbs as much at 610 nm as the photometer found there."""
    table = _sixs_table._load(None)
    return flight.ozone_depth / float(np.interp(610.0, WAVELENGTH, table.ozone))


def with_sun_of_6s(atmosphere: Atmosphere) -> Atmosphere:
    """The same air under the solar spectrum of 6S in place of TSIS-1."""
    ratio = solar("solar_6s") / solar("solar")

    def lit(a: Atmosphere) -> tuple[Any, ...]:
        return a.direct, a.diffuse, a.path_radiance

    return eqx.tree_at(lit, atmosphere, tuple(ratio * curve for curve in lit(atmosphere)))


def solar(name: str) -> np.ndarray:
    """A solar spectrum of the shipped table [W m-2 um-1]."""
    import xarray as xr

    file = Path(_sixs_table.__file__).parents[1] / "data" / "sixs_continental.nc"
    with xr.open_dataset(file) as data:
        return np.asarray(data[name].values, np.float64)


def print_row(label: str, values: Sequence[float], form: str = "{:7.1f}") -> None:
    print(f"{label:<52}" + "".join(form.format(v) for v in values), flush=True)


def lawn_table(flight: Flight, water: float) -> None:
    """Modelled over measured radiance of the lawn, less one [%]."""
    air = _atmosphere(flight.air(water))
    around = half_walk(flight, air)

    def errors(
        label: str,
        atmosphere: Atmosphere = air,
        surroundings: np.ndarray | None = around,
        reflectance: np.ndarray = flight.reflectance,
    ) -> None:
        target = flight._replace(reflectance=reflectance)
        model = target.in_bands(atmosphere, surroundings)
        print_row(label, [100.0 * window_error(flight, model, w) for w in WINDOWS])

    print("Lawn: modelled over measured radiance, less one [%]; median of the channels in a window")
    print_row("", [low for low, _ in WINDOWS], "{:7d}")
    print_row("", [high for _, high in WINDOWS], "{:7d}")
    errors("surroundings like the lawn itself", surroundings=None)
    errors("surroundings half lawn, half walk (A)")
    errors(
        "surroundings as mixed_surroundings has them", surroundings=mixed_surroundings(WAVELENGTH)
    )
    print("A, and one thing changed")
    errors("aerosol of the photometer at each wavelength", with_depths(flight, flight.air(water)))
    ozone = photometer_ozone(flight)
    hazy = _atmosphere(flight.air(water, aerosol_optical_depth=VISIBILITY_DEPTH))
    errors(
        f"aerosol {VISIBILITY_DEPTH}, the 50 km of the file for MODTRAN",
        hazy,
        half_walk(flight, hazy),
    )
    errors("solar spectrum of 6S, not TSIS-1", with_sun_of_6s(air))
    errors(
        "sensor 2.3 km above the ground, not 1.95",
        _atmosphere(flight.air(water, sensor_height=2300.0)),
    )
    errors("pressure 1013, not 976 hPa", _atmosphere(flight.air(water, pressure=1013.25)))
    errors("ozone 0.25, not 0.3 cm-atm", _atmosphere(flight.air(water, ozone=0.25)))
    one_error = flight.reflectance + flight.reflectance_sd / np.sqrt(68.0)
    errors("field spectrum one standard error of 68 brighter", reflectance=one_error)
    one_sd = flight.reflectance + flight.reflectance_sd
    errors("one standard deviation brighter (not known)", reflectance=one_sd)
    print("A, and all that the photometer measured")
    measured = with_depths(flight, flight.air(water, ozone=ozone))
    errors("aerosol and ozone of the photometer (B)", measured)
    walk = 2.0 * around - flight.reflectance
    for share in (0.02, 0.04):
        mixed = (1.0 - share) * flight.reflectance + share * walk
        errors(f"B, {share:.0%} of the pixel is walk (not known)", measured, reflectance=mixed)
    print()


def walk_table(flight: Flight, water: float) -> None:
    """What surroundings change, over lawn and walk."""
    air = _atmosphere(flight.air(water))
    around = half_walk(flight, air)
    walk = 2.0 * around - flight.reflectance

    def mean(values: Any) -> list[float]:
        return [float(np.mean(np.asarray(values)[in_windows(WAVELENGTH, (w,))])) for w in WINDOWS]

    print("Radiance amid A over that amid more of the target, less one [%]")
    for label, target in (("lawn", flight.reflectance), ("walk", walk)):
        with_them, without = (at_sensor_radiance(air, target, s) for s in (around, None))
        print_row(label, [100.0 * v for v in mean(with_them / without - 1.0)])
    print("Reflectance of the walk, from its radiance")
    radiance = at_sensor_radiance(air, walk, around)
    print_row("without surroundings", mean(surface_reflectance(air, radiance)), "{:7.3f}")
    print_row("with surroundings (A)", mean(walk), "{:7.3f}")
    print("Of the air: upward transmittances; path radiance over that of the lawn")
    print_row("direct", mean(air.upward_direct), "{:7.3f}")
    print_row("diffuse", mean(air.upward_diffuse), "{:7.3f}")
    share = air.path_radiance / at_sensor_radiance(air, flight.reflectance, around)
    print_row("path radiance [%]", [100.0 * v for v in mean(share)])
    print()


def table_of_6s(shared_data: Path) -> None:
    """The table of atmospheres over 6S itself, less one [%]."""
    file = shared_data / "eco" / "atmosphere" / "sixs_v11_wv2.0_aot0.10_sza30_H3km.csv"
    stored = pd.read_csv(file, comment="#")
    air = _atmosphere(ClearAir(30.0, 2.0, 0.1, 0.3, 1013.0, 3000.0))
    on_top = solar("solar") * np.cos(np.deg2rad(30.0))
    total = stored.E_direct_W_m2_um + stored.E_diffuse_W_m2_um
    of_6s = total / (stored.Tgas_down * stored.Tscat_down)  # at the top, sun of the day
    pairs = {
        "irradiance": ((air.direct + air.diffuse) / on_top, total / of_6s),
        "path radiance": (air.path_radiance / on_top, stored.L_path_W_m2_sr_um / of_6s),
        "upward transmittance, scattering": (
            _scattered_up(air, stored),
            stored.Tscat_up,
        ),
    }
    print("Shipped table over 6S (sun 30 degrees, aerosol 0.1, sensor 3 km), less one [%]; medians")
    for label, (ours, theirs) in pairs.items():
        ratio = np.asarray(ours) / theirs.to_numpy() - 1.0
        print_row(
            label,
            [100.0 * float(np.median(ratio[in_windows(WAVELENGTH, (w,))])) for w in WINDOWS],
            "{:7.2f}",
        )


def _scattered_up(air: Atmosphere, stored: pd.DataFrame) -> Any:
    return air.upward_transmittance / stored.Tgas_up.to_numpy()


def main() -> None:
    default = Path(__file__).parents[3] / "shared" / "data"
    shared_data = Path(os.environ.get("FYNJAX_SHARED_DATA", default))
    flight = read_flight(shared_data)
    water = fitted_water(flight)
    print(f"Column of water vapour {water:.2f} g cm-2, from its bands\n")
    lawn_table(flight, water)
    walk_table(flight, water)
    table_of_6s(shared_data)


if __name__ == "__main__":
    main()

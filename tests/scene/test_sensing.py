"""A sensor over a plot: pixels on the ground, air, noise, calibration, derivatives."""

import dataclasses
import inspect

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from fynjax._core.errors import InputError
from fynjax.radiation import Accuracy, nadir_rays, reflectance_factor, solve_light
from fynjax.scene import AimedSensor, Ground, Placement, PlotAir, Spectrum, aim
from fynjax.scene import observe as observe_scene
from fynjax.scene._lidar import observe_lidar
from fynjax.scene._observe import _air_in_bands
from fynjax.scene._panels import panels_in_picture
from fynjax.scene._pixels import axis_pixels, footprint_shares
from fynjax.sensors import (
    BandSet,
    CameraNoise,
    OrthographicCamera,
    Panel,
    PointSpread,
    Sensor,
    at_sensor_radiance,
    mavic_3m,
    shipped_sensor,
)
from tests.helpers import IMAGE_PROGRAMS, assert_gradients, compilations
from tests.scene.plots import small_parameters, small_plot

FAST = Accuracy(
    lattice=1, sublayers=1, levels=1, azimuths=4, refine=False, tolerance=1e-9, iterations=200
)
NOISE = ((1e14, 0.0), (8000.0, 4.0))
"""Full well and read noise of a camera without noise, and of one with; the same program."""
observe = eqx.filter_jit(lambda a, s, p, key=None, air=None: a.observe(s, p, key=key, air=air))


def over(scene, sensor, placement=None, **options):
    return aim(scene, small_parameters(), sensor, placement, **{"accuracy": FAST} | options)


@pytest.fixture(scope="module")
def model():
    return small_plot()


@pytest.fixture(scope="module")
def drone():
    return dataclasses.replace(shipped_sensor("mavic_3m"), psf=None)


def test_the_blur_of_optics_is_as_wide_on_the_ground_whatever_the_pixel(model):
    """Two pixels of the sensor in one of the image: half as many pixels of it."""
    drone = shipped_sensor("mavic_3m")
    own = float(drone.pixel(50.0))
    for pixel in (own, 2.0 * own):
        aimed = over(model, drone, Placement(50.0, pixel)).sensor
        np.testing.assert_allclose(aimed.psf.width * pixel, drone.psf.width * own, rtol=1e-5)


def test_pixels_lie_in_the_middle_of_the_plot():
    assert axis_pixels(10.0, 0.025, periodic=True) == (400, 0.0)
    assert axis_pixels(10.0, 3.0, periodic=True) == (3, 0.5)
    assert axis_pixels(10.0, 3.0, periodic=False) == (3, 0.5)
    assert axis_pixels(10.0, 60.0, periodic=True) == (1, -25.0)  # the plot goes on for ever
    with pytest.raises(InputError, match=r"pixel of 60 m, but is 10 m wide.*periodic"):
        axis_pixels(10.0, 60.0, periodic=False)


@pytest.mark.parametrize("tilt", [None, 20.0])
def test_pixels_of_a_hill_lie_where_the_map_has_them(model, drone, tilt):
    """A line of sight is over its pixel at the mean height of the ground, not at the lowest."""
    hill = dataclasses.replace(
        model, boundary="open", terrain=np.full(model.grid.shape[1::-1], 0.5)
    )
    level, high = (over(m, drone, Placement(30.0, 0.1, tilt)) for m in (model, hill))
    for axis in ("x", "y"):
        slope = getattr(high.rays, f"slope_{axis}")
        at_ground = getattr(high.rays, axis) + 0.5 * slope
        np.testing.assert_allclose(at_ground, getattr(level.rays, axis), atol=1e-9)
        assert np.abs(slope).max() > 0.01
    assert float(high.sensor.camera.position[2]) == pytest.approx(30.5)


@pytest.mark.parametrize("width", [0.35, 1.0, 2.0, 7.3])
def test_shares_of_a_periodic_axis_are_means_over_its_copies(width):
    """Against the mean of 100 000 points of the tiled axis."""
    cells = np.array([0.3, 1.0, 0.2, 0.8, 0.5])
    centres = np.array([0.4, 0.4 + width])
    points = centres[:, None] + width * ((np.arange(100_000) + 0.5) / 100_000 - 0.5)
    truth = cells[np.floor(points / 0.4).astype(int) % 5].mean(axis=1)
    shares = footprint_shares(centres, width, 5, 2.0, periodic=True)
    np.testing.assert_allclose(shares @ cells, truth, atol=2e-5)
    np.testing.assert_allclose(shares.sum(axis=1), 1.0, rtol=1e-12)


@pytest.mark.parametrize("periodic", [True, False])
def test_point_spread_of_wide_pixels_is_that_of_the_image(periodic):
    psf = PointSpread("gaussian", 1.3)
    cells = np.random.default_rng(0).uniform(size=(12, 12))
    centres = 0.3 * (np.arange(4) + 0.5)
    image = cells.reshape(4, 3, 4, 3).mean((1, 3))
    truth = psf.blur(image, boundary="periodic" if periodic else "edge")
    rows, columns = (
        footprint_shares(centres, 0.3, 12, 1.2, periodic=periodic, kernel=psf.kernel(axis))
        for axis in ("y", "x")
    )
    np.testing.assert_allclose(rows @ cells @ columns.T, truth, rtol=1e-12)


def test_a_nadir_frame_is_the_image_of_render(model, drone):
    """Rays to the camera 50 m over the middle, as `nadir_rays` has them."""
    sensing = over(model, drone, Placement(50.0, 0.1))
    seen = observe(sensing, model, small_parameters())
    at = (jnp.arange(16) + 0.5) * 0.1
    rays = nadir_rays(at, at, 0.1, (0.8, 0.8, 50.0))
    image = eqx.filter_jit(
        lambda s, p: reflectance_factor(solve_light(s.voxels(p, drone.bands), FAST), rays)
    )(model, small_parameters())
    np.testing.assert_allclose(seen.reflectance, image, rtol=1e-12)
    assert seen.radiance is None
    assert sensing.origin == (0.0, 0.0)


def test_a_wide_pixel_is_the_mean_of_small_ones(model, drone):
    """Rays half a voxel apart, against pixels of an eighth: what is left is 0.1 %."""
    fine = over(model, drone, Placement(1000.0, 0.0125))
    seen = eqx.filter_jit(
        lambda a, s, p: reflectance_factor(
            solve_light(s.voxels(p, a.sensor.bands), a.accuracy), a.rays
        )
    )(fine, model, small_parameters())
    small = np.asarray(seen).reshape(4, 4, 32, 4, 32).mean((2, 4))
    wide = over(model, drone, Placement(1000.0, 0.4))
    seen = observe(wide, model, small_parameters()).reflectance
    assert seen.shape == (4, 4, 4)
    np.testing.assert_allclose(seen, small, rtol=5e-3)
    np.testing.assert_allclose(seen.mean((1, 2)), small.mean((1, 2)), rtol=1e-3)
    whole = over(model, drone, Placement(1000.0, 4.8))  # nine copies of the plot
    assert whole.shape == (1, 1)
    shares = footprint_shares(np.array([0.8]), 4.8, 32, 1.6, periodic=True)
    np.testing.assert_allclose(shares, 1 / 32, rtol=1e-12)


PANELS = BandSet(("blue", "red", "nir", "cirrus", "swir"), (450, 660, 860, 1900, 2200), (20,) * 5)


def bare(soil, **changes):
    """A plot without plants over even ground, and its parameters."""
    parameters = small_parameters()
    none = jnp.zeros_like(parameters.species.cover)
    parameters = eqx.tree_at(lambda p: p.species.cover, parameters, none)
    ground = dataclasses.replace(
        parameters.ground, brightness=jnp.asarray(1.0), litter_fraction=jnp.asarray(0.0)
    )
    parameters = dataclasses.replace(parameters, ground=ground)
    ground = Ground(soil=Spectrum.of(np.array([400.0, 2500.0]), np.full(2, soil)))
    return small_plot(ground=ground, **changes), parameters


@pytest.mark.parametrize("kind", ["table", "clear-sky"])
def test_even_panels_come_back_through_the_air(kind):
    """And their radiance is that of the spectrum itself, band by band; with the plot's own mean
    around it, and amid brighter land."""
    camera = OrthographicCamera(0.4)
    sensor = Sensor("panel", PANELS, camera, psf=PointSpread("gaussian", 1.0))
    air = PlotAir(kind, water_vapour=2.0)
    land = None if kind == "table" else jnp.full(5, 0.3)
    curves_of = eqx.filter_jit(lambda light, height: air.atmosphere(light, height))
    run = None
    for soil in (0.05, 0.5):
        model, parameters = bare(soil)
        sensing = over(model, sensor, air=air)
        run = run or eqx.filter_jit(lambda a, s, p, x: a.observe(s, p, surroundings=x))
        seen = run(sensing, model, parameters, land)
        clear = np.asarray(seen.transparent)
        assert clear.tolist() == [True, True, True, False, True]
        assert seen.reflectance.shape == (5, 4, 4)
        np.testing.assert_allclose(seen.reflectance[clear], soil, rtol=1e-3)
        assert np.all(np.asarray(seen.reflectance)[~clear] == 0.0)
        curves = curves_of(parameters.light, sensing.sensor_height)
        grid = (len(curves.wavelength),)
        around = soil if land is None else 0.3
        spectrum = at_sensor_radiance(curves, jnp.full(grid, soil), jnp.full(grid, around))
        truth = PANELS.average(curves.wavelength, spectrum)
        np.testing.assert_allclose(
            seen.radiance, np.broadcast_to(truth[:, None, None], (5, 4, 4)), rtol=1e-3
        )
    with pytest.raises(InputError, match="each of the 5 bands"):
        run(sensing, model, parameters, jnp.ones(4))


@pytest.mark.parametrize(
    ("group", "name", "value", "air", "words"),
    [
        ("leaf", "chlorophyll", jnp.nan, None, "chlorophyll"),
        ("species", "leaf_area_index", -1.0, None, "leaf_area_index"),
        ("light", "sun_zenith", 95.0, None, "sun_zenith"),
        ("light", "sun_zenith", 84.0, PlotAir("table"), "sun"),
        ("light", "sun_zenith", 31.0, PlotAir("clear-sky", water_vapour=40.0), "water_vapour"),
    ],
)
def test_what_is_known_is_checked_outside_transformations(
    model, drone, group, name, value, air, words
):
    aimed, plot = over(model, drone, air=air), small_parameters()
    where = lambda p: getattr(getattr(p, group), name)  # noqa: E731
    wrong = eqx.tree_at(where, plot, jnp.full_like(where(plot), value))
    with pytest.raises(InputError, match=words):
        aimed.observe(model, wrong)


def test_seeds_and_surroundings_compile_nothing_anew(model, drone):
    sensor = dataclasses.replace(drone, noise=CameraNoise(300.0, *NOISE[1], 32))
    aimed, plot, noisy = over(model, sensor, air=PlotAir()), small_parameters(), []
    for seed, land in ((1, 0.2), (2, 0.2), (1, 0.3)):
        with compilations() as compiled:
            seen = aimed.observe(model, plot, key=seed, surroundings=jnp.full(4, land))
        noisy.append(np.asarray(seen.radiance))
        assert bool(IMAGE_PROGRAMS.intersection(compiled)) == (len(noisy) == 1)
    again = aimed.observe(model, plot, key=jax.random.key(1), surroundings=jnp.full(4, 0.2))
    np.testing.assert_array_equal(again.radiance, noisy[0])
    assert (noisy[1] != noisy[0]).any()
    assert (noisy[2] != noisy[0]).any()


def test_bands_in_any_order_see_the_same():
    """Air, noise and surroundings of each band are its own, however the sensor lists its bands."""
    order = [3, 0, 4, 1, 2]  # not undone by itself
    many = BandSet(PANELS.names, (450, 660, 860, 1040, 2200), PANELS.fwhm)
    land = jnp.array([0.05, 0.1, 0.3, 0.35, 0.2])
    scene, parameters = bare([0.1, 0.5])
    camera = OrthographicCamera(0.4)
    wells = {"quiet": np.full(5, 1e14), "loud": np.array([1e7, 1e6, 1e5, 1e4, 1e3])}
    run = eqx.filter_jit(lambda a, s, p, x: a.observe(s, p, surroundings=x, key=jax.random.key(0)))
    seen = []
    for places in ([0, 1, 2, 3, 4], order):
        for well in wells.values():
            noise = CameraNoise(np.full(5, 300.0), well[places], np.zeros(5), 32)
            sensor = Sensor("any", many.select(places), camera, noise=noise)
            sensing = over(scene, sensor, air=PlotAir("clear-sky"))
            seen.append(run(sensing, scene, parameters, land[jnp.array(places)]))
        clean, noisy = (np.asarray(one.radiance) for one in seen[-2:])
        sd = np.sqrt(clean * 300.0 / wells["loud"][places][:, None, None])
        scaled = ((noisy - clean) / sd).std((1, 2))
        assert np.all((scaled > 0.5) & (scaled < 1.65))  # of 16 pixels each
    for what in ("reflectance", "radiance"):
        plain, mixed = (np.asarray(getattr(one, what)) for one in (seen[0], seen[2]))
        np.testing.assert_allclose(mixed, plain[order], rtol=1e-4)
    assert np.ptp(np.asarray(seen[0].radiance)[:, 0, 0]) > 5.0


def test_panels_in_the_picture_calibrate_it():
    """They come back at their reflectance, and so does the ground beside them: without noise to a
    tenth of a per cent, with it within what is told."""
    camera = OrthographicCamera(0.1)
    sensors = [Sensor("panel", PANELS, camera, noise=CameraNoise(200.0, *n, 32)) for n in NOISE]
    dark, bright = (
        Panel(x_m=0.4, y_m=0.4, side_m=0.35, reflectance=0.05, reflectance_sd=0.02),
        Panel(x_m=1.2, y_m=0.4, side_m=0.4, reflectance=0.5, reflectance_sd=0.01),
    )
    model, parameters = bare(0.2)
    quiet, loud = (
        over(model, one, air=PlotAir("clear-sky"), panels=(dark, bright)) for one in sensors
    )
    sensor, sensing = sensors[0], quiet
    truth = np.full(sensing.shape, 0.2)
    truth[3:5, 3:5], truth[2:6, 10:14] = 0.05, 0.5  # pixels that the panels cover wholly
    mixed = np.zeros(sensing.shape, bool)
    mixed[2:6, 2:6] = True
    mixed[3:5, 3:5] = False
    clean, noisy = (observe(s, model, parameters, jax.random.key(3)) for s in (quiet, loud))
    clear = np.asarray(clean.transparent)
    image = np.asarray(clean.reflectance)[clear]
    np.testing.assert_allclose(image[:, ~mixed], np.tile(truth[~mixed], (4, 1)), rtol=1e-3)
    assert np.all((image[:, mixed] > 0.05) & (image[:, mixed] < 0.2))
    # A line through panels that are exact but for 2 and 1 %, at the darker and at the brighter one.
    told = np.asarray(clean.reflectance_sd)[clear]
    np.testing.assert_allclose(told[:, 3, 3], 0.02 * 0.05, rtol=0.01)
    np.testing.assert_allclose(told[:, 3, 11], 0.01 * 0.5, rtol=0.01)
    error = (np.asarray(noisy.reflectance)[clear] - truth)[:, ~mixed]
    scaled = error / np.asarray(noisy.reflectance_sd)[clear][:, ~mixed]
    assert 0.5 < scaled.std() < 1.2  # the line's error is shared by all pixels
    assert np.all(np.asarray(noisy.reflectance_sd)[~clear] == 0.0)

    # One panel cannot tell the light of the air; its zero line says by how much it may be off.
    radiance = jnp.asarray(clean.radiance)
    alone = panels_in_picture((bright,), sensing.shape, sensing.pixel, sensing.origin)
    haze = radiance[:, 0, 0] - 0.2 / 0.45 * (radiance[:, 3, 11] - radiance[:, 3, 3])
    haze = haze * (np.asarray(clean.transparent))
    line = alone.line(radiance, clean.transparent, haze=haze)
    found = np.asarray(line.reflectance(jnp.moveaxis(radiance, 0, -1)))[0, 0, clear]
    sd = np.asarray(line.standard_deviation(jnp.moveaxis(radiance, 0, -1)))[0, 0, clear]
    assert np.all(np.abs(found - 0.2) < 1.5 * sd)

    def with_panels(*panels):
        return over(model, sensor, air=PlotAir("clear-sky"), panels=panels)

    with pytest.raises(InputError, match=r"panel 1 must cover some pixels wholly.* holds none"):
        with_panels(Panel(x_m=0.45, y_m=0.45, side_m=0.05, reflectance=0.5))
    with pytest.raises(InputError, match="panels must not overlap"):
        with_panels(dark, Panel(x_m=0.5, y_m=0.4, side_m=0.4, reflectance=0.5))
    with pytest.raises(InputError, match=r"must differ in reflectance, but all have 0\.05"):
        with_panels(dark, Panel(x_m=1.2, y_m=0.4, side_m=0.4, reflectance=0.05))
    with pytest.raises(InputError, match=r"must lie in the image, 0 to 1\.6 m east"):
        with_panels(dark, Panel(x_m=1.5, y_m=0.4, side_m=0.4, reflectance=0.5))
    with pytest.raises(InputError, match="expected an atmosphere"):
        over(model, sensor, panels=(dark, bright))


def test_noise_is_seeded_and_as_large_as_its_model_says(model, drone):
    none, noise = (CameraNoise(300.0, *n, 32) for n in NOISE)
    quiet, sensing = (
        over(
            model, dataclasses.replace(drone, noise=n), Placement(50.0, 0.1),
            air=PlotAir("clear-sky"),
        )
        for n in (none, noise)
    )  # fmt: skip
    clean = observe(quiet, model, small_parameters(), jax.random.key(0))
    pixels, light = (jnp.moveaxis(v, 0, -1) for v in (clean.reflectance, clean.radiance))
    bands, _ = _air_in_bands(
        quiet.air, small_parameters().light, quiet.sensor.bands, quiet.sensor_height, model.dtype
    )
    around = pixels.mean((0, 1))  # more of the same plot
    np.testing.assert_allclose(light, at_sensor_radiance(bands, pixels, around), rtol=1e-5)
    first, again, other = (
        observe(sensing, model, small_parameters(), jax.random.key(k)) for k in (1, 1, 2)
    )
    np.testing.assert_array_equal(first.radiance, again.radiance)
    assert not np.array_equal(first.radiance, other.radiance)
    own = 50.0 * float(
        1e-3 * drone.camera.pixel_pitch_um / drone.camera.focal_length_mm
    )  # m, of its pixel
    assert 0.02 < own < 0.03
    many = (0.1 / own) ** 2  # which a pixel here is the mean of
    sd = np.moveaxis(noise.standard_deviation(light), -1, 0) / np.sqrt(many)
    scaled = (np.asarray(first.radiance) - clean.radiance) / sd
    assert scaled.std() == pytest.approx(1.0, abs=0.08)  # 1024 draws: 2.2 % is one deviation
    gain = clean.radiance.std((1, 2)) / clean.reflectance.std((1, 2))
    np.testing.assert_allclose(
        (first.reflectance - clean.reflectance) * gain[:, None, None],
        first.radiance - clean.radiance,
        rtol=1e-6,
    )


@pytest.mark.study
def test_radiance_has_the_derivative_of_differences(model, drone):
    """In cover, chlorophyll, the sun and the water in the air; wide pixels, a point spread."""
    psf = PointSpread("gaussian", 1.2)
    sensor = dataclasses.replace(drone, psf=psf)
    stand = model.expected()  # whole plants have the slopes of their expectation
    sensing = over(stand, sensor, Placement(1000.0, 0.4))
    parameters = small_parameters()

    @jax.jit
    def radiance(free):
        cover, chlorophyll, zenith, water = free
        moved = eqx.tree_at(
            lambda p: (p.species.cover, p.leaf.chlorophyll, p.light.sun_zenith),
            parameters,
            (
                parameters.species.cover.at[0].set(cover),
                parameters.leaf.chlorophyll.at[0].set(chlorophyll),
                zenith,
            ),
        )
        return sensing.observe(stand, moved, air=PlotAir("table", water_vapour=water)).radiance

    assert_gradients(radiance, jnp.array([0.25, 55.0, 31.3, 1.7]), step=1e-4, rtol=2e-4)


def test_an_oblique_view_is_followed_voxel_by_voxel(model, drone):
    straight = over(model, drone, Placement(50.0, 0.1))
    tilted = over(model, drone, Placement(50.0, 0.1, 50.0, 90.0))
    assert straight.accuracy.sublayers == 1
    assert tilted.accuracy.sublayers == 2
    # The camera stands west of the plot and looks east at its middle.
    place = np.asarray(tilted.sensor.camera.position)
    np.testing.assert_allclose(place, [0.8 - 50.0 * np.tan(np.deg2rad(50.0)), 0.8, 50.0])
    assert np.all(np.asarray(tilted.rays.slope_x) < -1.0)


def test_a_sweep_over_altitude_and_air_compiles_once(model, drone):
    sensor = dataclasses.replace(drone, noise=CameraNoise(300.0, *NOISE[1], 32))
    images = []
    run = eqx.filter_jit(lambda a, s, p, key: a.observe(s, p, key=key).radiance)  # not compiled yet
    for altitude, water in ((40.0, 0.5), (50.0, 0.5), (50.0, 3.0)):
        air = PlotAir("clear-sky", water_vapour=water)
        aimed = over(model, sensor, Placement(altitude, 0.1), air=air)
        with compilations() as compiled:
            images.append(run(aimed, model, small_parameters(), jax.random.key(0)))
        assert bool(compiled) == (len(images) == 1)
    assert not np.array_equal(images[0], images[1])
    assert not np.array_equal(images[1], images[2])


def test_mean_for_the_light_of_the_neighbourhood_counts_every_pixel_once(model, drone):
    """A point spread takes pixels of the scene's other side; they are in its mean already."""
    sensor = dataclasses.replace(drone, psf=PointSpread("gaussian", 3.0))
    blurred, sharp = (
        over(model, sensor, Placement(50.0, 0.1), point_spread=spread) for spread in (True, False)
    )
    assert blurred.margin > 0
    voxels = model.voxels(small_parameters(), drone.bands)
    image = eqx.filter_jit(AimedSensor.image)
    (_, mean, _), (pixels, other, _) = (image(one, voxels) for one in (blurred, sharp))
    np.testing.assert_allclose(mean, other, rtol=1e-6)  # their angles are interpolated
    np.testing.assert_allclose(other, pixels.mean((1, 2)), rtol=1e-12)


def test_what_must_be_known_is_said_before_tracing(model, drone):
    parameters = small_parameters()
    level = dataclasses.replace(model, boundary="open")
    hill = dataclasses.replace(model, terrain=np.full(model.grid.shape[1::-1], 0.5))

    def brightness(scene, parameters, camera=None):
        sensor = drone if camera is None else dataclasses.replace(drone, camera=camera)
        return observe_scene(
            scene, sensor, parameters=parameters, placement=Placement(50.0, 0.1)
        ).reflectance.mean()

    for scene, names in ((level, "the sun over an open scene"), (hill, "the terrain of a scene")):
        with pytest.raises(InputError, match=f"{names} must be known.*call `aim` before"):
            eqx.filter_jit(brightness)(scene, parameters)
    with pytest.raises(InputError, match="a camera must be known"):
        jax.jit(brightness)(model, parameters, drone.camera)
    # As it says: aimed before, an open scene has derivatives inside.
    aimed = over(level, drone, Placement(50.0, 0.1))
    inside = lambda p: aimed.observe(level, p).reflectance.mean()  # noqa: E731
    assert np.isfinite(eqx.filter_jit(inside)(parameters))


def test_what_cannot_be_simulated_is_refused(model, drone):
    with pytest.raises(InputError, match=r"above the plants.* 0\.8.* but is at 0\.5 m"):
        over(model, drone, Placement(0.5, 0.1))
    with pytest.raises(InputError, match=r"pixel of 5 m, but is 1\.6 m wide"):
        over(dataclasses.replace(model, boundary="open"), drone, Placement(50.0, 5.0))
    with pytest.raises(InputError, match="no air to make radiance of"):
        over(model, drone).observe(model, small_parameters(), key=0)
    with pytest.raises(InputError, match="no noise model"):
        over(model, drone, air=PlotAir()).observe(model, small_parameters(), key=0)
    view = Sensor("view", mavic_3m(), OrthographicCamera(0.1))
    with pytest.raises(InputError, match="no tilt or heading"):
        over(model, view, Placement(tilt=10.0))
    low = eqx.tree_at(lambda p: p.light.sun_zenith, small_parameters(), jnp.asarray(88.0))
    with pytest.raises(InputError, match="`sun_zenith` must be within the table"):
        over(model, drone, air=PlotAir()).check(low)


def test_noise_is_left_out_of_images_and_of_clouds_unless_asked_for():
    defaults = [
        inspect.signature(f).parameters["noise"].default for f in (observe_scene, observe_lidar)
    ]
    assert defaults == [False, False]


@pytest.mark.filterwarnings("ignore:aviris_ng_paper")
def test_images_have_the_pixel_that_the_sensor_s_file_states():
    """The article's spectrometer has pixels of 3 m, of which its optics make 1 m."""
    red_and_near_infrared = (55, 100)
    paper = shipped_sensor("aviris_ng_paper").select(red_and_near_infrared)
    optics = shipped_sensor("aviris_ng").select(red_and_near_infrared)
    parameters = small_parameters()
    for side, shape in ((1.6, (1, 1)), (6.4, (2, 2))):
        scene = small_plot(extent=(side, side), voxel=0.4)
        aimed = over(scene, paper)
        assert aimed.pixel == pytest.approx(3.0, rel=1e-6)
        assert float(aimed.averaged) == pytest.approx(1.0)  # its own pixel, with its own noise
        image = observe(aimed, scene, parameters).reflectance
        assert image.shape[1:] == shape
        # The same as a pixel that is asked for, but for lines of sight beside the middle.
        asked = observe(over(scene, optics, Placement(pixel=3.0)), scene, parameters).reflectance
        np.testing.assert_allclose(image, asked, rtol=1e-3)
    assert over(scene, paper, Placement(2000.0)).pixel == pytest.approx(6.0, rel=1e-6)
    assert over(scene, paper, Placement(pixel=1.6)).shape == (4, 4)
    assert over(scene, optics).pixel == pytest.approx(1.01504, abs=1e-5)

"""Calibration to reflectance: exact lines, Monte Carlo, by hand, panels through the air."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from fynjax._core.errors import InputError
from fynjax.radiation import Accuracy, nadir_rays, reflectance_factor
from fynjax.sensors import (
    CameraRadiometry,
    ClearAir,
    at_sensor_radiance,
    band_atmosphere,
    counts_to_radiance,
    empirical_line,
    irradiance_line,
    mavic_3m,
    one_panel_line,
    panel_coverage,
    panel_reading,
    place_panels,
    tabulated_atmosphere,
)
from tests.helpers import assert_gradients, radiance_to_counts
from tests.radiation.scenes import patchy, solver

GAIN, OFFSET = np.array([0.0031, 0.0042, 0.0058]), np.array([-0.021, -0.009, 0.003])


def on_line(known):
    """Signals [panel, band] of reflectances that lie on the line."""
    return (np.asarray(known)[:, None] - OFFSET) / GAIN


# The line


@pytest.mark.parametrize("known", [[0.05, 0.5], [0.03, 0.11, 0.24, 0.56]])
@pytest.mark.parametrize("sd", [0.0, np.array([[0.002], [0.01], [0.02], [0.004]])])
def test_an_exact_line_comes_back(known, sd):
    sd = sd if np.ndim(sd) == 0 else sd[: len(known)]
    line = empirical_line(
        on_line(known), np.array(known)[:, None], signal_sd=1.5, reflectance_sd=sd
    )
    np.testing.assert_allclose(line.gain, GAIN, rtol=1e-12)
    np.testing.assert_allclose(line.offset, OFFSET, atol=1e-12)
    np.testing.assert_allclose(line.reflectance(on_line([0.3])[0]), 0.3, rtol=1e-12)


def test_without_any_uncertainty_the_line_is_that_of_least_squares():
    """As numpy's polynomial fit has it; the covariance says nothing."""
    rng = np.random.default_rng(0)
    x, y = rng.uniform(5, 100, (6, 3)), rng.uniform(0.02, 0.6, (6, 1)) * np.ones(3)
    y = np.sort(y, axis=0)
    x = np.sort(x, axis=0)
    line = empirical_line(x, y)
    for band in range(3):
        slope, offset = np.polyfit(x[:, band], y[:, band], 1)
        np.testing.assert_allclose([line.gain[band], line.offset[band]], [slope, offset], rtol=1e-9)
    assert np.all(np.abs(line.standard_deviation(x[0])) < 1e-7)


@pytest.mark.parametrize("count", [2, 5])
def test_covariance_against_monte_carlo(count):
    """Panels measured again and again, with errors in signal and in reflectance."""
    known = np.linspace(0.04, 0.55, count)
    signal_sd = np.linspace(0.4, 1.2, count)[:, None] * np.ones(3)
    reflectance_sd = (0.002 + 0.01 * known)[:, None]
    rng = np.random.default_rng(1)
    draws = 40_000
    x = on_line(known) + signal_sd * rng.standard_normal((draws, count, 3))
    y = known[:, None] + reflectance_sd * rng.standard_normal((draws, count, 3))

    def fit(x, y):
        return empirical_line(x, y, signal_sd=signal_sd, reflectance_sd=reflectance_sd)

    lines = jax.jit(jax.vmap(fit))(x, y)
    told = fit(on_line(known), known[:, None])
    pixels = on_line([0.0, 0.2, 0.8])
    for band in range(3):
        seen = np.cov(np.stack([lines.gain[:, band], lines.offset[:, band]]))
        np.testing.assert_allclose(told.covariance[band], seen, rtol=0.04)
    seen = jax.vmap(lambda line: line.reflectance(pixels))(lines)
    np.testing.assert_allclose(told.standard_deviation(pixels), seen.std(axis=0), rtol=0.02)
    # A pixel's own noise comes on top.
    noisy = (seen[:, 1] + GAIN * 2.0 * rng.standard_normal((draws, 3))).std(axis=0)
    np.testing.assert_allclose(told.standard_deviation(pixels[1], 2.0), noisy, rtol=0.02)


def test_one_panel_against_monte_carlo():
    rng = np.random.default_rng(2)
    draws, x, y = 40_000, np.array([100.0, 60.0]), np.array([0.5, 0.45])
    errors = rng.standard_normal((3, draws, 2))
    sd = {"signal_sd": np.array([1.0, 0.5]), "reflectance_sd": 0.01, "offset_sd": 0.004}
    # The true line has an offset, so its gain is that of what is left.
    offset = sd["offset_sd"] * errors[2]
    gain = (y + 0.01 * errors[1] - offset) / (x + sd["signal_sd"] * errors[0])
    told = one_panel_line(x, y, **sd)
    np.testing.assert_allclose(told.gain, y / x, rtol=1e-15)
    for pixel in (0.0, 30.0, 150.0):
        np.testing.assert_allclose(
            told.standard_deviation(jnp.full(2, pixel)), (gain * pixel + offset).std(0), rtol=0.02
        )
    certain = one_panel_line(x, y)
    np.testing.assert_array_equal(certain.standard_deviation(x), 0.0)
    slope = jax.grad(lambda s: jnp.sum(certain.standard_deviation(s)))(jnp.asarray(x))
    np.testing.assert_array_equal(slope, 0.0)


def test_irradiance_and_another_light():
    """pi L / E; twice the light halves the gain; errors of both lights add in squares."""
    light = np.array([1200.0, 900.0])
    line = irradiance_line(light, irradiance_sd=0.03 * light)
    radiance = np.array([80.0, 20.0])
    np.testing.assert_allclose(line.reflectance(radiance), np.pi * radiance / light, rtol=1e-14)
    np.testing.assert_allclose(
        line.standard_deviation(radiance), 0.03 * np.pi * radiance / light, rtol=1e-12
    )
    twice = line.relit(np.full(2, 2.0), 0.08)
    np.testing.assert_allclose(twice.reflectance(2 * radiance), line.reflectance(radiance))
    np.testing.assert_allclose(
        twice.standard_deviation(2 * radiance),
        np.hypot(0.03, 0.04) * np.pi * radiance / light,
        rtol=1e-12,
    )


def test_gradients_of_the_line():
    known = np.array([[0.05], [0.2], [0.5]]) * np.ones(3)
    x = on_line(known[:, 0]) * (1 + 0.02 * np.array([[1.0], [-1.0], [0.5]]))

    @jax.jit
    def products(given):
        x, y, sx, sy, pixel = given
        line = empirical_line(x, y, signal_sd=sx, reflectance_sd=sy)
        relit = line.relit(jnp.full(3, 1.3), 0.1)
        return line, line.reflectance(pixel), relit.standard_deviation(pixel, 0.5)

    at = (x, known, np.full((3, 3), 0.7), 0.02 * known, np.array([3.0, 20.0, 60.0]))
    # The covariance is tiny beside the gain: a larger step keeps rounding out.
    assert_gradients(products, at, step=1e-5, rtol=2e-6)
    one = jax.jit(lambda g: one_panel_line(*g[:2], signal_sd=g[2], offset_sd=g[3]))
    assert_gradients(one, (x[2], known[2], x[2] / 50, np.full(3, 0.01)), step=1e-4)


def test_single_precision():
    known = jnp.array([[0.05], [0.5]], jnp.float32)
    x = jnp.asarray(on_line([0.05, 0.5]), jnp.float32)
    line = empirical_line(x, known, signal_sd=jnp.float32(0.1))
    assert {leaf.dtype for leaf in jax.tree.leaves(line)} == {jnp.dtype("float32")}
    np.testing.assert_allclose(line.reflectance(x), known * np.ones(3), rtol=1e-5)
    assert np.all(np.isfinite(line.standard_deviation(x)))
    missing = line.standard_deviation(jnp.full(x.shape[-1], jnp.nan))
    assert np.all(np.isnan(missing)), "the error of a signal that is missing is not 0"


@pytest.mark.parametrize(
    ("signal", "known", "message"),
    [
        ([[10.0, 5.0], [20.0, 9.0]], [[0.3], [0.3]], "differ in reflectance, but in band 1 all"),
        ([[10.0, 9.0], [20.0, 9.0]], [[0.1], [0.3]], "differ in signal, but in band 2"),
        ([[10.0, 9.0], [20.0, 5.0]], [[0.1], [0.3]], "band 2 they give less. Were panels mixed"),
        ([[10.0, 5.0]], [[0.3]], "two panels or more .* `one_panel_line`"),
        ([[10.0, np.nan], [20.0, 9.0]], [[0.1], [0.3]], "some are none"),
    ],
)
def test_panels_that_make_no_line(signal, known, message):
    with pytest.raises(InputError, match=message):
        empirical_line(np.array(signal), np.array(known))


def test_light_and_panels_that_are_none():
    with pytest.raises(InputError, match=r"signal .* -3 in band 2"):
        one_panel_line(np.array([1.0, -3.0]), 0.5)
    with pytest.raises(InputError, match=r"`irradiance`.*positive"):
        irradiance_line(np.zeros(2))


# Panels in an image


def test_coverage_of_a_polygon():
    """Against areas by hand, in pixels and in a map's metres."""
    whole = panel_coverage([(1, 1), (4, 1), (4, 3), (1, 3)], (5, 6))
    expected = np.zeros((5, 6))
    expected[1:3, 1:4] = 1.0
    np.testing.assert_array_equal(whole, expected)
    # Metres: 0.5 m pixels from (10, 20) on; a rectangle over one pixel and a quarter of the next.
    part = panel_coverage(
        [(10.5, 20.5), (11.125, 20.5), (11.125, 21.0), (10.5, 21.0)],
        (4, 4), pixel_m=0.5, origin_m=(10.0, 20.0),
    )  # fmt: skip
    np.testing.assert_allclose(part[1], [0, 1, 0.25, 0])
    triangle = panel_coverage([(0, 0), (8, 0), (0, 8)], (8, 8))
    np.testing.assert_allclose(triangle.sum(), 32.0, rtol=0.01)
    for corners, message in (
        ([(0, 0), (1, 1)], "three corners"),
        ([(20, 20), (24, 20), (24, 24)], "must lie in the image of 6 x 5"),
        ([(1, 1), (1, 1), (1, 1)], "some size"),
    ):
        with pytest.raises(InputError, match=message):
            panel_coverage(corners, (5, 6))


def test_reading_of_a_panel():
    rng = np.random.default_rng(3)
    image = rng.normal(30.0, 2.0, (2, 40, 50))
    cover = panel_coverage([(10.5, 10), (30, 10), (30, 30), (10.5, 30)], (40, 50))
    reading = panel_reading(image, cover, saturation=60.0)
    inside = image[:, 10:30, 11:30]  # the half pixel is left out
    assert reading.count == 380
    np.testing.assert_allclose(reading.mean, inside.mean(axis=(1, 2)), rtol=1e-14)
    np.testing.assert_allclose(reading.mean_sd, inside.std(axis=(1, 2)) / 380**0.5, rtol=1e-14)
    assert_gradients(lambda i: panel_reading(i, np.ones((2, 3))), image[:, :2, :3])
    image[1, 12, 15] = 60.0
    with pytest.raises(InputError, match=r"saturated.*band 2 0\.26 %"):
        panel_reading(image, cover, saturation=60.0)
    image[0, 12, 15] = np.nan
    with pytest.raises(InputError, match=r"band 1 .*without data"):
        panel_reading(image, cover)
    with pytest.raises(InputError, match="covers none"):
        panel_reading(image, np.full((40, 50), 0.9))
    with pytest.raises(InputError, match="as the panel's area has"):
        panel_reading(image, np.ones((3, 3)))


# The camera


MICASENSE = CameraRadiometry(
    sensitivity=0.146485, exposure=0.0004725, black_level=5071.5, gain=2.0,
    row_gradient=(1.17941e-07, 1.39743e-06), vignetting_centre=(3.0, 4.0),
    vignetting=(-3.2e-5, 1.1e-7, -2.8e-9, 1.0e-11, -1.5e-14, 7.3e-18),
)  # fmt: skip


def test_counts_by_hand():
    """One pixel 3 columns and 4 rows from the centre, the published equation written out."""
    counts = np.zeros((20, 10))
    counts[8, 6] = 23456.0
    r = 5.0
    k = 1 - 3.2e-5 * r + 1.1e-7 * r**2 - 2.8e-9 * r**3
    k += 1e-11 * r**4 - 1.5e-14 * r**5 + 7.3e-18 * r**6
    t, y = 0.0004725, 8.0
    by_hand = (1 / k) * 0.146485 / 2.0 * (23456.0 / 65536 - 5071.5 / 65536)
    by_hand /= t + 1.17941e-07 * y - 1.39743e-06 * t * y
    radiance = counts_to_radiance(counts, MICASENSE)
    np.testing.assert_allclose(radiance[8, 6], by_hand, rtol=1e-12)
    assert radiance[0, 0] < 0.0
    np.testing.assert_allclose(radiance_to_counts(radiance, MICASENSE), counts, atol=1e-9)
    # DJI multiplies by such a polynomial.
    dji = CameraRadiometry(1.0, 1.0, 0.0, vignetting=(0.1, 0.02), vignetting_is="correction")
    np.testing.assert_allclose(
        counts_to_radiance(np.full((1, 4), 65536.0), dji)[0], [1.0, 1.12, 1.28, 1.48], rtol=1e-14
    )


def test_gradients_of_the_camera():
    """Also at the centre of vignetting, where the distance has no slope."""
    counts = np.random.default_rng(4).uniform(6e3, 6e4, (5, 4))
    back = jax.jit(lambda g: counts_to_radiance(*g))
    assert_gradients(back, (counts, MICASENSE), rtol=1e-5)


# From the ground through the air and the camera, and back


@pytest.mark.parametrize("seen", ["map", pytest.param("rendered", marks=pytest.mark.study)])
def test_panels_come_back_through_air_camera_and_line(seen):
    """Four panels on the ground, as a map or rendered in a scene; the darkest and the brightest
    make the line, the others and the soil come back at their reflectance to 0.1 %."""
    known = np.array([0.04, 0.55, 0.12, 0.3])
    scene = patchy("periodic")
    rows, columns = scene.shape[1:]
    corners = [np.array([(x, y), (x + 2, y), (x + 2, y + 2), (x, y + 2)])
               for x, y in ((0, 1), (2, 1), (5, 1), (3, 4))]  # fmt: skip
    on_grid = np.stack([panel_coverage(c, (rows, columns)) for c in corners])
    ground = place_panels(np.full((2, rows, columns), 0.17), on_grid, known[:, None])
    fine, pixel = 5, scene.horizontal / 5
    if seen == "map":
        factor = ground.repeat(fine, axis=1).repeat(fine, axis=2)
    else:
        bare = (jnp.zeros_like(scene.area_density), ground)
        scene = eqx.tree_at(lambda s: (s.area_density, s.ground), scene, bare)
        x, y = ((np.arange(n * fine) + 0.5) * pixel for n in (columns, rows))
        rays = nadir_rays(x, y, pixel, (0.4, 0.3, 1000.0))
        factor = reflectance_factor(solver(Accuracy(levels=2, azimuths=4))(scene), rays)
    factor = np.asarray(factor)[[0, 0, 1, 1]]  # any two bands serve for four
    air = band_atmosphere(tabulated_atmosphere(ClearAir(40.0, sensor_height=120.0)), mavic_3m())
    radiance = at_sensor_radiance(air, np.moveaxis(factor, 0, -1), np.full(4, 0.17))
    lens = eqx.tree_at(lambda c: c.vignetting_centre, MICASENSE, jnp.array([25.0, 14.0]))
    counts = jax.vmap(radiance_to_counts, (0, None))(jnp.moveaxis(radiance, -1, 0), lens)
    read = jax.vmap(counts_to_radiance, (0, None))(counts, lens)
    areas = [panel_coverage(c * scene.horizontal, read.shape[1:], pixel_m=pixel) for c in
             # A pixel's own footprint reaches over the panel's edge.
             (c + 0.3 * (c.mean(axis=0) - c) for c in corners)]  # fmt: skip
    readings = [panel_reading(read, area) for area in areas]
    line = empirical_line(
        np.stack([r.mean for r in readings[:2]]), known[:2, None], reflectance_sd=0.01
    )
    assert np.all(np.asarray(line.offset) < 0.0)  # the air's own light
    for reading, truth in zip(readings, known, strict=True):
        np.testing.assert_allclose(line.reflectance(reading.mean), truth, rtol=1e-3)
    back = np.moveaxis(line.reflectance(jnp.moveaxis(read, 0, -1)), -1, 0)
    np.testing.assert_allclose(back, factor, rtol=1e-3)
    # One panel alone takes the air's light for the ground's: dark panels come out too bright.
    alone = one_panel_line(readings[1].mean, known[1:2])
    assert np.all(alone.reflectance(readings[0].mean) > 1.005 * known[0])

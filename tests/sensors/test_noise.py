"""Noise: formula, statistics of the draws, units, gradients."""

from collections.abc import Callable
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from fynjax._core.errors import InputError
from fynjax.sensors import AbstractNoise, CameraNoise, RadiometricNoise, shipped_sensor
from fynjax.sensors._noise import radiometric_noise
from tests.helpers import assert_gradients

RADIANCE = jnp.array([2.0, 40.0, 180.0])


def spectrometer() -> RadiometricNoise:
    return RadiometricNoise([0.09, 0.02, 0.01], [30.0, 1.0, 2.0], [0.01, -0.002, 0.0], 4)


def camera() -> CameraNoise:
    return CameraNoise([250.0, 250.0, 300.0], 9000.0, 5.0, 10)


def draws(noise: Callable, count: int = 20_000) -> np.ndarray:
    return np.asarray(noise(7, jnp.broadcast_to(RADIANCE, (count, 3))))


@pytest.mark.parametrize("noise", [spectrometer(), camera()], ids=["spectrometer", "camera"])
def test_draws_have_the_stated_mean_and_covariance(noise: AbstractNoise) -> None:
    sample = draws(noise.draw)
    std = np.asarray(noise.standard_deviation(RADIANCE))
    error = std / np.sqrt(len(sample))
    assert np.all(np.abs(sample.mean(axis=0) - RADIANCE) < 4.0 * error)
    np.testing.assert_allclose(np.cov(sample.T) / np.outer(std, std), np.eye(3), atol=0.04)
    # Pixels are independent of their neighbours.
    white = (sample - np.asarray(RADIANCE)) / std
    assert np.abs(np.mean(white[1:] * white[:-1], axis=0)).max() < 0.03
    # Normal: 68.3 % within one standard deviation, 99.7 % within three.
    np.testing.assert_allclose((np.abs(white) < 1.0).mean(axis=0), 0.6827, atol=0.015)
    np.testing.assert_allclose((np.abs(white) < 3.0).mean(axis=0), 0.9973, atol=0.002)


def test_spectrometer_noise_is_the_formula() -> None:
    a, b, c = np.array([0.09, 0.02, 0.01]), np.array([30.0, 1, 2]), np.array([0.01, -0.002, 0])
    expected = np.abs(a * np.sqrt(b + np.asarray(RADIANCE)) + c) / 2.0  # four integrations
    noise = spectrometer()
    np.testing.assert_allclose(noise.standard_deviation(RADIANCE), expected, rtol=1e-14)
    averaged = noise.standard_deviation(RADIANCE, averaged=25)
    np.testing.assert_allclose(averaged, expected / 5.0, rtol=1e-14)


def digitised(radiance: jax.Array) -> jax.Array:
    """What `camera` reads of pixels: electrons drawn, read, rounded and cut off."""
    gain = 9000.0 / jnp.array([250.0, 250.0, 300.0])
    counting, reading = jax.random.split(jax.random.key(7))
    electrons = jax.random.poisson(counting, gain * radiance)
    read = electrons + 5.0 * jax.random.normal(reading, radiance.shape)
    return jnp.clip(jnp.round(read / 9000.0 * 1023), 0, 1023) * (9000.0 / 1023) / gain


def test_digital_numbers_vary_as_stated() -> None:
    """Poisson counts, reading and rounding, simulated one by one, against the closed form."""
    noise = camera()
    sample = np.asarray(digitised(jnp.broadcast_to(RADIANCE, (20_000, 3))))
    std = np.asarray(noise.standard_deviation(RADIANCE))
    np.testing.assert_allclose(sample.std(axis=0), std, rtol=0.02)
    assert np.all(np.abs(sample.mean(axis=0) - RADIANCE) < 4.0 * std / np.sqrt(len(sample)))
    # Shot noise alone: the signal to noise ratio is the root of the electrons.
    shot = CameraNoise(100.0, 10_000.0, 0.0, 24)
    ratio = 25.0 / float(shot.standard_deviation(jnp.array([25.0]))[0])
    assert ratio == pytest.approx(np.sqrt(2500.0), rel=1e-6)


def test_draws_are_seeded_and_smooth() -> None:
    noise = spectrometer()
    once, again = noise.draw(3, RADIANCE), noise.draw(jax.random.key(3), RADIANCE)
    np.testing.assert_array_equal(once, again)
    assert not np.allclose(once, noise.draw(4, RADIANCE))
    for kind in (spectrometer(), camera()):
        functions = (kind.standard_deviation, lambda x, k=kind: k.draw(3, x))
        for function in functions:
            assert_gradients(jax.jit(lambda x, f=function: f(x)), RADIANCE)


def test_dark_and_negative_radiance_give_finite_noise() -> None:
    dark = jnp.array([-40.0, -1.0, 0.0])  # b + L is negative, zero, positive
    std = np.asarray(spectrometer().standard_deviation(dark))
    np.testing.assert_allclose(std[:2], [0.005, 0.001], rtol=1e-12)
    for noise in (spectrometer(), camera()):
        slope = jax.jacrev(noise.standard_deviation)(dark)
        assert np.all(np.isfinite(slope))
        assert np.all(np.asarray(noise.standard_deviation(dark)) > 0.0)
        missing = noise.standard_deviation(jnp.full(3, jnp.nan))
        assert np.all(np.isnan(missing)), "the noise of a radiance that is missing is not known"
    single = spectrometer().draw(0, RADIANCE.astype(jnp.float32))
    assert single.dtype == jnp.float32
    assert camera().standard_deviation(RADIANCE.astype(jnp.float32)).dtype == jnp.float32


def test_units_of_the_table_do_not_matter() -> None:
    """One instrument, its table in two units: 1 µW cm-2 sr-1 nm-1 is 10 W m-2 sr-1 µm-1."""
    grid, centre = [400.0, 500.0, 600.0], [450.0, 500.0]
    a, b, c = np.array([0.02, 0.01, 0.01]), np.array([3.0, 2.0, 2.0]), np.array([1e-3, 0.0, 0.0])
    micro = radiometric_noise(grid, a, b, c, centre=centre)
    radiance = np.array([50.0, 80.0])
    at = [np.interp(centre, grid, v) for v in (a, b, c)]
    expected = 10.0 * np.abs(at[0] * np.sqrt(at[1] + radiance / 10.0) + at[2])
    np.testing.assert_allclose(micro.standard_deviation(radiance), expected, rtol=1e-13)
    si = radiometric_noise(
        grid, np.sqrt(10) * a, 10 * b, 10 * c, centre=centre, unit="W m-2 sr-1 um-1"
    )
    np.testing.assert_allclose(si.standard_deviation(radiance), expected, rtol=1e-13)


def test_aviris_ng_on_a_measured_lawn(shared_data: Path) -> None:
    """Signal to noise of real radiance, from the original coefficient file by hand."""
    folder = shared_data / "eco"
    lawn = np.loadtxt(folder / "avirisng" / "ang20171108t184227_rdn_BeckmanLawn.txt")
    table = np.loadtxt(folder / "noise" / "avirisng_noise.txt")
    wavelength, radiance = lawn[:, 0], lawn[:, 1]
    a, b, c = (np.interp(wavelength, table[:, 0], table[:, k]) for k in (1, 2, 3))
    expected = np.abs(a * np.sqrt(np.maximum(b + radiance, 0.0)) + c)
    sensor = shipped_sensor("aviris_ng")
    np.testing.assert_allclose(sensor.bands.centre, wavelength, atol=0.01)
    assert sensor.noise is not None
    std = np.asarray(sensor.noise.standard_deviation(10.0 * radiance)) / 10.0
    np.testing.assert_allclose(std, expected, rtol=1e-5)
    ratio = np.interp([550.0, 860.0, 1650.0], wavelength, radiance / std)
    np.testing.assert_allclose(ratio, [144.0, 345.0, 326.0], rtol=0.03)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (
            lambda: radiometric_noise([400, 500], [1, 1], [1, 1], [0, 0], centre=[450], unit="nW"),
            "unit of radiance",
        ),
        (lambda: radiometric_noise([0.4, 0.5], [1, 1], [1, 1], [0, 0], centre=[450]), "µm"),
        (lambda: radiometric_noise([400, 500], [1, 1], [1, 1], [0, 0], centre=[650]), "650 nm"),
    ],
)
def test_bad_noise(make: Callable, message: str) -> None:
    with pytest.raises(InputError, match=message):
        make()

"""What the calibration of a sensor's bands may be off by."""

import numpy as np
import pytest

from fynjax.errors import InputError
from fynjax.sensors import Gains, shipped_sensor


def test_gains_have_the_stated_deviations_and_share_in_common():
    """Against draws: the light is off for all bands alike, each band by itself besides."""
    random, sd = np.random.default_rng(4), np.array([0.05, 0.1, 0.2])
    common, own = random.normal(size=(200_000, 1)), random.normal(size=(200_000, 3))
    drawn = sd * (np.sqrt(0.3) * common + np.sqrt(0.7) * own)
    found = Gains(tuple(sd), 0.3).covariance(3)
    np.testing.assert_allclose(found, np.cov(drawn.T), rtol=0.03)
    np.testing.assert_allclose(np.diagonal(found), sd**2)
    np.testing.assert_allclose(Gains(0.1, 1.0).covariance(2), np.full((2, 2), 0.01))


def test_shipped_errors_are_those_of_their_sources():
    """Errors of radiance that Mamaghani and Salvaggio (2019) measured, by band."""
    maker, user = (
        [-0.1098, -0.0043, 0.0359, 0.3281, -0.1708],
        [0.0344, 0.0293, 0.0293, 0.037, 0.0072],
    )
    camera = np.log1p(maker)
    light = 0.07
    assert abs(camera.mean()) < 0.01
    # Of DJI's light sensor one factor of all bands is not defined: 0.30, an assumption.
    for name, factor in {"mavic_3m": 0.3, "phantom_4m": 0.3, "rededge_3": 0.0}.items():
        shared = light**2 + factor**2
        sd = np.sqrt(np.mean(camera**2) + shared)
        alone = shipped_sensor(name).gains("light_sensor")
        assert alone.sd == pytest.approx(sd, rel=0.05)
        assert alone.shared == pytest.approx(shared / sd**2, abs=0.02)
        line = shipped_sensor(name).gains("empirical_line").sd
        assert np.sqrt(np.mean(np.square(user))) < line < shipped_sensor(name).gains("panels").sd
    assert shipped_sensor("mavic_3m").gains().way == "light_sensor"
    assert shipped_sensor("rededge_3").gains().way == "panels"


def test_spectrometer_s_errors_are_those_of_its_source(shared_data):
    path = shared_data / "eco" / "noise" / "avirisng_systematic_error.txt"
    wavelength, sd = np.loadtxt(path).T
    dry = (wavelength > 420.0) & (wavelength < 2430.0)
    for low, high in ((1330.0, 1450.0), (1780.0, 1970.0)):
        dry &= (wavelength < low) | (wavelength > high)
    stated = shipped_sensor("aviris_ng").gains()
    assert stated.sd == pytest.approx(np.sqrt(np.mean(sd[dry] ** 2)), abs=5e-4)
    assert stated.shared == 0.0


@pytest.mark.parametrize(("sd", "shared"), [(-0.1, 0.5), ((0.1, np.nan), 0.5), (0.1, 1.5)])
def test_wrong_gains_are_refused(sd, shared):
    with pytest.raises(InputError, match="expected deviations of gains of at least 0"):
        Gains(sd, shared)


def test_gains_of_other_bands_are_refused():
    with pytest.raises(InputError, match="one for each of 3 bands, but got 2"):
        Gains((0.1, 0.2)).covariance(3)


def test_gains_in_words():
    assert str(Gains(0.18, 0.15, "light_sensor")) == (
        "18 % a band, 15 % of the variance in common (light sensor)"
    )
    assert str(Gains((0.1, 0.05), 0.5)).startswith("5 to 10 % a band")

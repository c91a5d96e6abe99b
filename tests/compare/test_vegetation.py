"""Whether an image is one of shrubland: measured plots are, the article's drone image is not."""

import numpy as np
import pytest

import fynjax as fx
from fynjax.app.compare import _vegetation as module
from fynjax.app.compare import bands_2006, check_vegetation
from fynjax.errors import InputError
from fynjax.sensors import Gains
from tools.make_vegetation_spectra import dry_shrubland, estimate, fynbos, grid

MAVIC = fx.sensor("mavic_3m").bands


@pytest.fixture(scope="module")
def measured(shared_data):
    """Log spectra of fynbos plots, their plots, and log spectra of dry shrubland."""
    folder = shared_data / "eco"
    return *fynbos(folder), dry_shrubland(folder)


def test_the_shipped_table_is_that_of_its_recipe(measured):
    mean, factors, rest = estimate(*measured)
    wavelength, shipped, components, left = module._spectra()
    np.testing.assert_array_equal(wavelength, grid())
    np.testing.assert_allclose(shipped, mean, atol=1e-5)
    # Signs of components are arbitrary.
    np.testing.assert_allclose(components.T @ components, factors.T @ factors, atol=1e-4)
    np.testing.assert_allclose(left, np.sqrt(rest), atol=1e-4)


@pytest.mark.parametrize("name", ["mavic_3m", "rededge_3", "sentinel_2a", "aviris_ng"])
def test_plots_that_were_left_out_are_shrubland(measured, monkeypatch, name):
    """And their chances are spread as chances are: the farthest twentieth is not far."""
    spectra, plots, others = measured
    sensor = fx.sensor(name).bands
    chances = []
    for plot in np.unique(plots):
        out = plots == plot
        mean, factors, rest = estimate(spectra[~out], plots[~out], others)
        monkeypatch.setattr(module, "_spectra", lambda m=mean, f=factors, r=rest: (
            grid(), m, f, np.sqrt(r)
        ))  # fmt: skip
        inside = sensor.select(sensor.covered(grid(), max_loss=0.02))
        # Of many bands one spectrum a plot.
        for values in np.exp(spectra[out])[: 1 if len(inside) > 20 else None]:
            seen = inside.weights(grid(), max_loss=0.02) @ values
            chances.append(check_vegetation(seen, inside).probability)
    assert min(chances) > module.UNLIKE


def test_the_drone_of_the_article_is_not(measured):
    """Its red edge is 0.38 of its near infrared; no measured plot is below 0.6."""
    spectra = measured[0]
    real = {name: row.real_mean for name, row in bands_2006().items()}
    check = check_vegetation(real, MAVIC)
    assert check.unlike
    assert check.probability < 1e-4
    worst = check.pairs.iloc[0]
    assert (worst.numerator, worst.denominator) == ("red_edge", "nir")
    assert worst.ratio == pytest.approx(0.38, abs=0.005)
    seen = MAVIC.weights(grid()) @ np.exp(spectra).T
    assert seen[2].min() / seen[3][seen[2].argmin()] > 0.5
    ratios = seen[2] / seen[3]
    assert worst.low < np.percentile(ratios, 5)
    assert np.percentile(ratios, 95) < worst.high
    assert "red_edge / nir is 0.38; measured plots have 0." in str(check)


def test_the_chance_is_that_of_draws():
    """Images drawn from the envelope itself, with gains: a tenth has a chance below a tenth."""
    wavelength, mean, factors, rest = module._spectra()
    rng = np.random.default_rng(0)
    z = rng.normal(size=(800, len(factors)))
    spectra = np.exp(mean + z @ factors + rng.normal(size=(800, len(mean))) * rest)
    common, own = rng.normal(size=(800, 1)), rng.normal(size=(800, 4))
    gain = np.exp(0.1 * (np.sqrt(0.5) * common + np.sqrt(0.5) * own))
    images = spectra @ MAVIC.weights(wavelength).T * gain
    few = [check_vegetation(image, MAVIC, gains=Gains(0.1)).distance for image in images]
    # Draws have the covariance itself: chi-square of four.
    assert np.mean(few) == pytest.approx(4.0, rel=0.08)
    large = [check_vegetation(image, MAVIC, gains=Gains(0.02)).distance for image in images[:100]]
    assert np.mean(large) > 6.0


@pytest.mark.parametrize("name", ["mavic_3m", "rededge_3", "sentinel_2a", "aviris_ng"])
def test_what_is_no_shrubland_is_found(name):
    """A red edge of two thirds, bands in the wrong order, counts taken for reflectance, a leaf."""
    wavelength, mean, _, _ = module._spectra()
    sensor = fx.sensor(name).bands
    gains = Gains(0.02 if name == "aviris_ng" else 0.05)
    sensor = sensor.select(sensor.covered(wavelength, max_loss=0.02))
    weights, centre = sensor.weights(wavelength, max_loss=0.02), np.asarray(sensor.centre)
    usual = weights @ np.exp(mean)
    assert check_vegetation(usual, sensor).probability > 0.99
    edge = np.where((centre > 700.0) & (centre < 745.0), 0.65, 1.0)
    leaf, _ = fx.prospect(chlorophyll=50.0, wavelength=wavelength)
    for wrong in (usual * edge, usual[::-1], usual * 10_000.0 / 65_535.0, weights @ leaf):
        assert check_vegetation(wrong, sensor, gains=gains).unlike


def test_uncertain_gains_forgive():
    real = {name: row.real_mean for name, row in bands_2006().items()}
    sharp, loose = (check_vegetation(real, MAVIC, gains=Gains(s)).probability for s in (0.05, 0.2))
    assert sharp < module.UNLIKE < loose
    # A gain that all bands share forgives brightness, and no ratio.
    shared = check_vegetation(real, MAVIC, gains=Gains(0.2, 0.99))
    assert shared.unlike


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ([0.1, 0.1], r"one reflectance for each of 4 bands, but got values of shape \(2,\)"),
        ({"blue": 0.1}, "but got 'blue'"),
        ({"red": 0.1, "nir": np.nan}, "expected two bands at least"),
    ],
)
def test_wrong_values_are_refused(values, message):
    with pytest.raises(InputError, match=message):
        check_vegetation(values, MAVIC)

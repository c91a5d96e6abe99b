"""The inversion of a uniform canopy: known truths within their intervals, wrong input refused."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import fynjax as fx
from fynjax.canopy import EllipsoidalLeafAngle
from fynjax.errors import InputError
from fynjax.inversion import fit_canopy
from fynjax.inversion._canopy import _bins, _Model, _parts, _space
from fynjax.leaf import prospect
from fynjax.scene import background_spectrum

WAVELENGTH = np.array([490.0, 560.0, 665.0, 705.0, 783.0, 865.0, 1610.0, 2190.0])
LIGHT = {"sun_zenith": 35.0, "view_zenith": 5.0, "relative_azimuth": 60.0, "sky_share": 0.1}
CANOPIES = 6
TRUTH = jnp.array([45.0, 9.0, 0.012, 0.008, 1.6, 2.5, 55.0, 0.9])


def model(wavelength=WAVELENGTH, weights=None):
    light = jnp.asarray([*LIGHT.values(), 0.01])
    soil = jnp.asarray(background_spectrum("dry_soil", wavelength))
    weights = np.eye(len(wavelength)) if weights is None else weights
    return jax.jit(_Model(tuple(wavelength.tolist()), jnp.asarray(weights), soil, light).__call__)


def noisy(reflectance, rng):
    """With the errors that `fit_canopy` assumes: as large in each band as in all together."""
    alone, together = rng.standard_normal((2, 2, len(reflectance)))
    together = together[:, :1]
    absolute, relative = alone + together
    return np.clip(reflectance + 0.01 * absolute + 0.02 * reflectance * relative, 0.0, 1.0)


@pytest.mark.study  # compiles for 78 wavelengths
def test_bands_of_a_sensor_without_noise_give_the_truth_as_far_as_it_shows():
    sensor = fx.sensor("sentinel_2a")
    measured = np.asarray(model(*_parts(sensor.bands))(TRUTH))
    used = np.arange(13) != 10  # B10 is none of the surface
    found = fit_canopy(sensor, np.where(used, measured, np.nan), sd=1e-4, **LIGHT)
    assert bool(found.result.converged)
    np.testing.assert_allclose(found.result.predicted, measured[used], atol=5e-4)
    for name, truth in zip(found.names, TRUTH):
        low, high = found.interval[name]
        assert low < truth < high
    assert {"leaf_area_index", "chlorophyll"}.isdisjoint(found.unconstrained)
    assert found.estimate["chlorophyll"] == pytest.approx(45.0, rel=0.1)
    text = repr(found)
    assert text.startswith("Converged after")
    assert "in 12 bands" in text
    assert "chlorophyll [ug cm-2]" in text


@pytest.mark.slow  # compiles a fit
def test_nine_of_ten_intervals_hold_the_truth():
    rng, space, predict = np.random.default_rng(3), _space(), model()
    inside = np.zeros(len(space.names))
    for _ in range(CANOPIES):
        truth = np.asarray(space.physical(jnp.asarray(rng.standard_normal(len(space.names)))))
        found = fit_canopy(WAVELENGTH, noisy(np.asarray(predict(truth)), rng), **LIGHT)
        ends = np.array([found.interval[name] for name in found.names])
        inside += (ends[:, 0] < truth) & (truth < ends[:, 1])
    # Intervals of a canopy hang together: 0.9 within two standard errors of so many canopies; and
    # none of the eight far from it.
    assert 0.76 < inside.sum() / (CANOPIES * len(space.names)) < 0.995
    assert inside.min() >= 3
    assert "carotenoids" in found.unconstrained
    assert f"Hardly known from these data: {', '.join(found.unconstrained)}." in repr(found)


def test_parts_of_bands_have_their_means():
    bands = fx.sensor("sentinel_2a").bands
    wavelength, weights = _parts(bands)
    grid = np.arange(400.0, 2501.0)
    np.testing.assert_allclose(weights.sum(axis=1), 1.0, rtol=1e-9)
    mean, square = (bands.weights(grid) @ grid**power for power in (1, 2))
    np.testing.assert_allclose(weights @ wavelength, mean, rtol=1e-9)
    lost = (square - weights @ wavelength**2) / (square - mean**2)
    # The spread inside a part.
    assert lost.min() > 0.0
    assert lost.max() < 0.15


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"reflectance": np.full(5, 0.2)}, "`reflectance` must have one value for each of the 8"),
        ({"reflectance": np.full(8, 25.0)}, "from 0 to 1, but is 25 at 490 nm; is it a percent"),
        ({"reflectance": np.full(8, np.nan)}, "at least three bands must have a reflectance"),
        ({"soil": np.full(8, 1.5)}, "`soil` must be a fraction"),
        ({"soil": np.full(3, 0.2)}, "`soil` must have one value for each of the 8"),
        ({"bands": WAVELENGTH[::-1]}, "must increase"),
        ({"bands": WAVELENGTH / 1000.0}, "µm"),
        ({"bands": "sentinel_2a"}, "`bands` must be a sensor"),
        ({"soil": np.where(WAVELENGTH > 800.0, np.nan, 0.2)}, "`soil` must have a value wherever"),
        ({"sun_zenith": 95.0}, "sun_zenith"),
        ({"hot_spot": -0.1}, "hot_spot"),
        ({"sd": 0.0}, "positive sd"),
    ],
)
def test_wrong_input_is_refused(change, message):
    given = {"bands": WAVELENGTH, "reflectance": np.full(8, 0.2), **LIGHT, **change}
    with pytest.raises(InputError, match=message):
        fit_canopy(given.pop("bands"), given.pop("reflectance"), **given)


def test_a_fine_spectrum_is_averaged_in_bins():
    fine = np.arange(400.0, 2501.0)
    bins = _bins(fine)
    assert bins.shape[0] == 211
    np.testing.assert_allclose(bins.sum(axis=1), 1.0)
    np.testing.assert_allclose((bins @ fine)[:2], [404.5, 414.5])
    np.testing.assert_allclose(_bins(WAVELENGTH), np.eye(8))


@pytest.mark.slow  # compiles a fit
def test_a_fit_to_a_view_to_the_side_is_of_that_side():
    """What it predicts at its estimate is what the canopy reflects there, by its own call with the
    angles named, towards the sun and away from it, which differ much."""
    sides = {}
    for azimuth in (10.0, 170.0):
        light = LIGHT | {"view_zenith": 40.0, "relative_azimuth": azimuth}
        found = fit_canopy(WAVELENGTH, np.full(8, 0.2), max_steps=1, **light)
        traits = dict(found.estimate)
        area, angle = traits.pop("leaf_area_index"), traits.pop("leaf_angle")
        soil = traits.pop("soil_brightness") * np.asarray(
            background_spectrum("dry_soil", WAVELENGTH)
        )
        optics = fx.LeafParameters(**traits)
        leaf = prospect(optics, WAVELENGTH)
        sides[azimuth] = fx.canopy_reflectance(
            leaf.reflectance, leaf.transmittance, area, soil=np.minimum(soil, 1.0),
            leaf_angles=EllipsoidalLeafAngle.from_mean_angle(angle), **light,
        )  # fmt: skip
        np.testing.assert_allclose(found.result.predicted, sides[azimuth], rtol=1e-3)
    assert np.abs(sides[10.0] / sides[170.0] - 1.0).min() > 0.02

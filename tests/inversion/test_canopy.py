"""The inversion of a uniform canopy: known truths within their intervals, wrong input refused."""

from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
import pytest

import fynjax as fx
from fynjax.canopy import EllipsoidalLeafAngle
from fynjax.errors import InputError
from fynjax.inversion import fit_canopies, fit_canopy
from fynjax.inversion._canopy import CanopyTable, CanopyView, _parts, canopy_model, mean_bins
from fynjax.leaf import prospect
from fynjax.scene import background_spectrum, soil_shapes

WAVELENGTH = np.array([490.0, 560.0, 665.0, 705.0, 783.0, 865.0, 1610.0, 2190.0])
AREA_AND_GREEN = ("leaf_area_index", "chlorophyll")
LIGHT = {"sun_zenith": 35.0, "view_zenith": 5.0, "relative_azimuth": 60.0, "sky_share": 0.1}
CANOPIES = 6
TRUTH = jnp.array([45.0, 9.0, 0.012, 0.008, 1.6, 2.5, 55.0, 0.9, 0.3, 0.5, -0.4, 0.3, 0.0])


def model(bands=WAVELENGTH):
    centre = bands if isinstance(bands, np.ndarray) else bands.centre
    predict, space = canopy_model(bands, centre, CanopyView(**LIGHT))
    return jax.jit(predict.__call__), space


def noisy(reflectance, rng):
    """With the errors that `fit_canopy` assumes: as large in each band as in all together."""
    alone, together = rng.standard_normal((2, 2, len(reflectance)))
    together = together[:, :1]
    absolute, relative = alone + together
    return np.clip(reflectance + 0.01 * absolute + 0.02 * reflectance * relative, 0.0, 1.0)


@pytest.mark.study  # compiles for 78 wavelengths
def test_bands_of_a_sensor_without_noise_give_the_truth_as_far_as_it_shows():
    sensor = fx.sensor("sentinel_2a")
    measured = np.asarray(model(sensor.bands)[0](TRUTH))
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
    rng, (predict, space) = np.random.default_rng(3), model()
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
        ({"known": {"lai": 3.0}}, "no parameter 'lai'.*leaf_area_index"),
        ({"known": {"leaf_angl": 3.0}}, "Did you mean 'leaf_angle'"),
        ({"known": {"leaf_angle": 0.9}}, "leaf_angle from 15 to 85 .degrees., but it is 0.9"),
        ({"known": {"soil_moisture": 0.1}, "soil": 0.2}, "only the brightness is free"),
    ],
)
def test_wrong_input_is_refused(change, message):
    given = {"bands": WAVELENGTH, "reflectance": np.full(8, 0.2), **LIGHT, **change}
    with pytest.raises(InputError, match=message):
        fit_canopy(given.pop("bands"), given.pop("reflectance"), **given)


def test_a_gap_in_a_fine_soil_is_named_where_it_is():
    nm = np.arange(400.0, 1000.0, 2.0)
    soil = np.where(nm == 460.0, np.nan, 0.2)
    with pytest.raises(InputError, match=r"has none at 46\d nm"):
        fx.fit_canopy(nm, np.full(nm.size, 0.3), sun_zenith=30.0, soil=soil)
    with pytest.raises(InputError, match=r"has none at 46\d nm"):
        CanopyView(30.0).check(nm, np.full((1, nm.size), 0.3), soil=soil)


def test_a_fine_spectrum_is_averaged_in_bins():
    fine = np.arange(400.0, 2501.0)
    bins = mean_bins(fine)
    assert bins.shape[0] == 211
    np.testing.assert_allclose(bins.sum(axis=1), 1.0)
    np.testing.assert_allclose((bins @ fine)[:2], [404.5, 414.5])
    np.testing.assert_allclose(mean_bins(WAVELENGTH), np.eye(8))


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
        dry, wet = (background_spectrum(f"{name}_soil", WAVELENGTH) for name in ("dry", "wet"))
        share = traits.pop("soil_moisture")
        soil = traits.pop("soil_brightness") * ((1.0 - share) * dry + share * wet)
        shape = [traits.pop(f"soil_shape_{i}") for i in (1, 2, 3, 4)]
        soil = soil * np.exp(shape @ soil_shapes(WAVELENGTH))
        optics = fx.LeafParameters(**traits)
        leaf = prospect(optics, WAVELENGTH)
        sides[azimuth] = fx.canopy_reflectance(
            leaf.reflectance, leaf.transmittance, area, soil=np.minimum(soil, 1.0),
            leaf_angles=EllipsoidalLeafAngle.from_mean_angle(angle), **light,
        )  # fmt: skip
        np.testing.assert_allclose(found.result.predicted, sides[azimuth], rtol=1e-3)
    assert np.abs(sides[10.0] / sides[170.0] - 1.0).min() > 0.01


@pytest.mark.slow  # compiles a fit
def test_what_is_known_is_not_fitted_and_helps():
    """A canopy of other leaves than the prior's: told so, the fit finds the rest more nearly."""
    predict, _ = model()
    truth = TRUTH.at[jnp.array([4, 6])].set(jnp.array([2.2, 30.0]))
    measured = np.asarray(predict(truth))
    free = fit_canopy(WAVELENGTH, measured, **LIGHT)
    told = fit_canopy(WAVELENGTH, measured, known={"structure": 2.2, "leaf_angle": 30.0}, **LIGHT)
    assert {"structure", "leaf_angle"}.isdisjoint(told.names)
    area = [abs(fit.estimate["leaf_area_index"] / 2.5 - 1.0) for fit in (free, told)]
    width = [np.ptp(np.log(fit.interval["leaf_area_index"])) for fit in (free, told)]
    assert area[1] < 0.6 * area[0]
    assert width[1] < 0.95 * width[0]
    assert "Known: structure 2.2, leaf_angle 30." in repr(told)


def test_shapes_are_those_of_soils_of_other_libraries(shared_data):
    """Seven soils of the Sentinel-2 ATBD, 47 of the Open Soil Spectral Library, of which some may
    be those of the shapes, and 40 of Johns Hopkins."""
    table = np.load(shared_data / "leaf" / "soil_spectra.npz")
    grid = np.arange(400.0, 2501.0, 10.0)
    everything = table["refl"][2:, ::10]
    dry, wet = (np.log(background_spectrum(f"{name}_soil", grid)) for name in ("dry", "wet"))
    taken = np.stack([np.ones_like(dry), wet - dry], axis=1)

    def left(vectors, soils):
        logs = np.log(np.maximum(soils, 0.005)) - dry
        found = np.linalg.lstsq(vectors, logs.T)[0]
        return np.sqrt(np.mean((np.exp((vectors @ found).T + dry) - soils) ** 2))

    shaped = np.concatenate([taken, soil_shapes(grid).T], axis=1)
    parts = everything[:54], everything[54:]
    assert [left(shaped, some) for some in parts] == pytest.approx([0.015, 0.026], abs=6e-4)
    assert [left(taken, some) for some in parts] == pytest.approx([0.065, 0.078], abs=6e-4)


PEERS = pd.read_csv(Path(__file__).with_name("canopies_by_prosail.csv"))
"""Eight canopies of prosail 2.0.5 (GPL-3; PROSPECT-D, 4SAIL, its two soils, hot spot 0.01), drawn
evenly: traits, and reflectance at the wavelengths that head its columns [nm], lit as `LIGHT`."""


@pytest.mark.slow  # compiles fits
def test_canopies_of_another_model_are_found_within_their_intervals():
    traits = PEERS.columns[:9].tolist()
    wavelength = PEERS.columns[9:].to_numpy(float)
    light = LIGHT | {"sky_share": 0.0}
    inside, errors = [], []
    for row in PEERS.to_dict("records"):
        truth = {name: row[name] for name in traits}
        measured = np.array(list(row.values())[9:])
        found = fit_canopy(wavelength, measured, known={"leaf_angle": row["leaf_angle"]}, **light)
        assert bool(found.result.converged)
        free = [name for name in traits if name in found.names]
        inside += [found.interval[n][0] < truth[n] < found.interval[n][1] for n in free]
        errors.append([found.estimate[n] / truth[n] - 1 for n in AREA_AND_GREEN])
    assert np.mean(inside) > 0.85
    area, chlorophyll = np.sqrt(np.mean(np.square(errors), axis=0))
    assert chlorophyll < 0.15
    assert area < 0.2


@pytest.mark.slow  # compiles fits
def test_pixels_with_light_from_a_table_are_fitted_as_one_by_one():
    view = CanopyView(35.0, 5.0, 60.0)
    wavelength = PEERS.columns[9:].to_numpy(float)
    measured = PEERS.iloc[:3, 9:].to_numpy(float)
    pixels = np.concatenate([measured, np.full((2, len(wavelength)), np.nan)])
    pixels[3, [1, 5]] = 0.1  # two bands are too few
    pixels[2, 2] = 1.7  # no reflectance
    many = fit_canopies(wavelength, pixels, view, known={"leaf_angle": 50.0})
    assert np.isnan(many.estimate[3:]).all()
    assert not many.converged[3:].any()
    missing = measured.copy()
    missing[2, 2] = np.nan
    for row in (0, 2):
        one = fit_canopy(wavelength, missing[row], known={"leaf_angle": 50.0}, **view._asdict())
        low, high = np.array([one.interval[name] for name in one.names]).T
        width = high - low
        np.testing.assert_allclose(
            (many.estimate[row] - list(one.estimate.values())) / width, 0.0, atol=0.05
        )
        np.testing.assert_allclose((many.upper - many.lower)[row] / width, 1.0, atol=0.1)
    with pytest.raises(InputError, match=r"must be .pixel, 11 bands."):
        fit_canopies(wavelength, pixels[:, :5], view)


def test_pixels_and_soils_that_cannot_be_fitted_are_refused():
    view, pixels = CanopyView(35.0), np.full((2, len(WAVELENGTH)), 0.2)
    for soil in (20.0, np.full(len(WAVELENGTH), 20.0)):
        with pytest.raises(InputError, match=r"`soil` must be a fraction.*percentage"):
            fit_canopies(WAVELENGTH, pixels, view, soil=soil)
    with pytest.raises(InputError, match=r"`soil` must have one value for each of the 8 bands"):
        fit_canopies(WAVELENGTH, pixels, view, soil=np.full(3, 0.2))
    # A number stands for all bands: only what follows it is refused.
    with pytest.raises(InputError, match="no parameter"):
        fit_canopies(WAVELENGTH, pixels, view, soil=0.2, known={"none": 1.0})
    pixels[0, 2:], pixels[1, :-2] = np.nan, np.nan
    with pytest.raises(InputError, match="in three bands, but none has"):
        fit_canopies(WAVELENGTH, pixels, view)


@pytest.mark.slow  # tabulates light
def test_a_table_of_light_is_the_light():
    """At leaves, areas and soils drawn evenly, where none of its points are."""
    view = CanopyView(50.0, 30.0, 120.0, 0.2, 0.05)
    table, rng = CanopyTable.made(view), np.random.default_rng(8)
    for _ in range(6):
        scattered, share = rng.uniform(0.05, 0.95, 12), rng.uniform(0.3, 0.7, 12)
        leaf = jnp.asarray(scattered * share), jnp.asarray(scattered * (1.0 - share))
        soil = jnp.asarray(rng.uniform(0.02, 0.6, 12))
        area, angle = rng.uniform(0.3, 6.0), rng.uniform(25.0, 75.0)
        exact = fx.canopy_reflectance(
            *leaf, area, soil=soil, leaf_angles=EllipsoidalLeafAngle.from_mean_angle(angle),
            **view._asdict(),
        )  # fmt: skip
        error = np.abs(np.asarray(table(leaf, area, angle, soil)) - exact)
        assert (error / np.hypot(0.01, 0.02 * np.asarray(exact))).max() < 0.5

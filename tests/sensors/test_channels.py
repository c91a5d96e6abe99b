"""Bands taken together."""

import numpy as np
import pytest

from fynjax._core.errors import InputError
from fynjax.sensors import BandSet, group_bands, shipped_sensor


def test_hundreds_of_bands_become_some_thirty_outside_the_water_windows():
    channels, bands = group_bands(shipped_sensor("emit").bands)
    assert 20 <= len(bands) <= 36
    assert not ((channels.centre > 1340) & (channels.centre < 1460)).any()
    assert not ((channels.centre > 1790) & (channels.centre < 2100)).any()
    assert channels.centre.min() >= 430
    assert channels.centre.max() <= 2400
    assert (channels.upper > channels.lower).all()


def test_a_channel_of_a_line_is_the_line_at_its_centre():
    sensor = shipped_sensor("aviris_ng").bands
    channels, bands = group_bands(sensor)
    centre = np.asarray(sensor.centre)
    assert channels.weights(centre) @ centre == pytest.approx(channels.centre)
    wavelength = np.arange(400.0, 2500.5)
    assert bands.weights(wavelength) @ wavelength == pytest.approx(channels.centre, abs=0.5)


def test_bands_of_a_camera_stay_as_they_are():
    sensor = shipped_sensor("sentinel_2a").bands
    channels, bands = group_bands(sensor)
    for place, centre in enumerate(channels.centre):
        if centre in sensor.centre:
            own = sensor.select([sensor.centre.index(centre)])
            grid = np.arange(400.0, 2500.5)
            spectrum = 0.3 + 0.2 * np.sin(grid / 40.0)
            found, known = bands.weights(grid)[place] @ spectrum, own.weights(grid)[0] @ spectrum
            assert found == pytest.approx(known, rel=2e-3)


def test_bands_with_more_than_their_widths_between_them_stay_apart():
    near, far = (
        BandSet(tuple("abcd"), (500.0, 500.0 + gap, 700.0, 900.0), (12.0,) * 4) for gap in (20, 30)
    )
    assert [len(group_bands(bands)[1]) for bands in (near, far)] == [3, 4]


def test_bad_bands_are_left_out_and_their_channel_is_missed():
    sensor = shipped_sensor("emit").bands
    channels, _ = group_bands(sensor)
    centre = np.asarray(sensor.centre)
    good = np.ones(len(centre), bool)
    first = np.flatnonzero((centre >= channels.lower[5]) & (centre <= channels.upper[5]))
    good[first[0]] = False
    weights = channels.weights(centre, good)
    assert weights[5, first[0]] == 0.0
    assert weights[5].sum() == pytest.approx(1.0)
    good[first] = False
    with pytest.raises(InputError, match="expected a good band between"):
        channels.weights(centre, good)


def test_micrometres_and_other_bands_are_refused():
    sensor = shipped_sensor("emit").bands
    channels, _ = group_bands(sensor)
    with pytest.raises(InputError, match="micrometres"):
        channels.weights(np.asarray(sensor.centre) / 1000.0)
    camera = shipped_sensor("mavic_3m").bands
    with pytest.raises(InputError, match="fynjax train --like"):
        channels.weights(camera.centre)
    with pytest.raises(InputError, match="three channels or more"):
        group_bands(BandSet(("a", "b"), (550.0, 1400.0), (10.0, 10.0)))

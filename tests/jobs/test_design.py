"""The sensor file of a design."""

import numpy as np

from fynjax.app.io.instruments import load_instrument
from fynjax.app.jobs._design import _sensor_file
from fynjax.inversion import BandDesign
from fynjax.sensors import BandSet, OrthographicCamera
from tests.helpers import stand_in


def test_the_file_of_a_design_is_a_sensor(tmp_path):
    bands = BandSet(("b1", "b2"), (676.44, 1203.26), (10.0, 35.51))
    found = stand_in(BandDesign, bands=bands, pixel=0.25, target="share of the variance removed")
    (tmp_path / "designed.toml").write_text(_sensor_file(found))
    sensor = load_instrument(tmp_path / "designed.toml")
    assert sensor.bands.names == bands.names
    np.testing.assert_allclose(sensor.bands.centre, bands.centre, atol=0.05)
    np.testing.assert_allclose(sensor.bands.fwhm, bands.fwhm, atol=0.05)
    assert isinstance(sensor.camera, OrthographicCamera)
    assert float(sensor.pixel()) == 0.25

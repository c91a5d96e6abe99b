"""Measured spectra of BioSCape's plots: small tables by hand, and the real ones."""

from pathlib import Path

import numpy as np
import pytest

from fynjax._core.errors import InputError
from fynjax.studies.bioscape._spectra import read_plot_spectra, read_spectrometer

WAVES = "BandCenters\n450.0\n650.5\n860.0\n1400.0\n"
HEADER = "BScpPID,X,Y,start_time,Band_1,Band_2,Band_3,Band_4\n"
ROWS = """A1,18.4,-34.2,2023-11-09 13:31:24+00:00,0.03,0.06,0.2,-0.01
A1,18.4,-34.2,2023-11-26 09:15:42+00:00,0.05,0.08,0.3,-0.01
A1,18.4,-34.2,2023-11-27 09:15:42+00:00,-9999,-9999,-9999,-9999
B2,18.5,-34.3,2023-11-09 13:31:24+00:00,0.02,-0.001,0.25,-0.01
"""


@pytest.fixture
def tables(tmp_path: Path) -> Path:
    (tmp_path / "waves.csv").write_text(WAVES)
    (tmp_path / "VegCenters.csv").write_text(HEADER + ROWS)
    return tmp_path


def test_flights_by_plot_without_masked_bands_and_lost_pixels(tables: Path) -> None:
    spectra_by_plot = read_plot_spectra(tables)
    assert list(spectra_by_plot) == ["A1", "B2"]
    np.testing.assert_equal(
        spectra_by_plot["A1"].reflectance, [[0.03, 0.06, 0.2, np.nan], [0.05, 0.08, 0.3, np.nan]]
    )
    assert spectra_by_plot["A1"].left_out == 1
    assert spectra_by_plot["A1"].times[1] == "2023-11-26 09:15:42+00:00"
    assert spectra_by_plot["B2"].reflectance[0, 1] == -0.001  # slightly negative is no mask


def test_centres_and_the_widths_of_the_nearest_shipped_band(tables: Path) -> None:
    spectrometer = read_spectrometer(tables)
    np.testing.assert_array_equal(spectrometer.centre, [450.0, 650.5, 860.0, 1400.0])
    assert np.all((spectrometer.fwhm > 5.5) & (spectrometer.fwhm < 6.1))
    (tables / "waves.csv").unlink()
    assert read_spectrometer(tables).centre.size == 425


def test_no_table_of_spectra_is_no_spectra(tmp_path: Path) -> None:
    assert read_plot_spectra(tmp_path) == {}


@pytest.mark.parametrize(
    ("file", "old", "new", "message"),
    [
        ("waves.csv", "650.5\n", "", "for each of 3 wavelengths"),
        ("waves.csv", "860.0", "600.0", "increasing"),
        ("waves.csv", WAVES, "BandCenters\n0.45\n0.65\n", "Micrometres"),
        ("waves.csv", "860.0", "red", "'red'"),
        ("VegCenters.csv", "0.2,", "20,", "Percent"),
        ("VegCenters.csv", "0.2,", "x,", "'x'"),
        ("VegCenters.csv", "2023-11-09 13", "9 Nov 13", "start_time"),
        ("VegCenters.csv", "start_time", "time", "start_time"),
        ("VegCenters.csv", "0.3,", "", "expected 8 cells"),
    ],
)
def test_bad_tables_say_what_is_wrong(
    tables: Path, file: str, old: str, new: str, message: str
) -> None:
    path = tables / file
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))
    with pytest.raises(InputError, match=message):
        read_plot_spectra(tables)


def test_real_spectra_are_whole_outside_the_water_windows(shared_data: Path) -> None:
    folder = shared_data / "eco" / "bioscape"
    centre = read_spectrometer(folder).centre
    spectra_by_plot = read_plot_spectra(folder)
    assert len(spectra_by_plot) >= 10
    clear = (centre > 410) & (centre < 2450)
    clear &= ~((centre > 1340) & (centre < 1460)) & ~((centre > 1790) & (centre < 2100))
    for spectra in spectra_by_plot.values():
        assert spectra.times
        assert np.isfinite(spectra.reflectance[:, clear]).all()
        assert np.isnan(spectra.reflectance[:, (centre > 1375) & (centre < 1405)]).all()

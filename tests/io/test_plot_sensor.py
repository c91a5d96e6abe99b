"""Sun, sensor and air of a plot file, and the sensor over the plot that they make."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from fynjax._core.errors import InputError
from fynjax.app.assembly import aim_at_plot, build_plot
from fynjax.app.io.instruments import load_sensor
from fynjax.app.io.plot import (
    AtmosphereTable,
    drone_sensor,
    plot_instrument,
    read_plot,
    sensor_place,
)
from fynjax.metrics import BANDS
from fynjax.scene import PlotAir, visible_sensor
from fynjax.sensors import SPACE, Atmosphere, BandSet

HEAD = """
[plot]
size_m = 2.0
voxel_m = 0.2
structure_m = "even"
"""
SPECIES = """taxon,mean_diameter_cm,cover_percent,height_max_m,growth_form
Restio eleocharis,30,15,0.5,tussock
"""
SENSOR = """
name = "mine"
source = "a data sheet"
[geometry]
kind = "frame"
altitude_m = 60
focal_length_mm = 8
pixel_pitch_um = 4
columns = 1200
rows = 800
[bands]
name = ["nir", "red", "red_edge", "green", "thermal"]
any_order = true
centre_nm = [860, 650, 730, 560, 10500]
fwhm_nm = [40, 20, 10, 20, 1000]
[psf]
kind = "gaussian"
width_pixels = 1.2
"""
CURVES = """wavelength [nm],direct [W m-2 um-1],diffuse [W m-2 um-1],upward_transmittance [1],\
path_radiance [W m-2 sr-1 um-1],spherical_albedo [1]
400,900,300,0.8,20,0.2
700,1000,100,0.9,5,0.1
1000,600,40,0.95,1,0.05
"""


def plot(folder: Path, tables: str = "", head: str = HEAD):
    (folder / "plot.toml").write_text(head + tables)
    (folder / "species.csv").write_text(SPECIES)
    (folder / "mine.toml").write_text(SENSOR)
    (folder / "curves.csv").write_text(CURVES)
    return read_plot(folder / "plot.toml")


def test_left_out_sensors_are_the_drone_of_old_files(tmp_path):
    read = plot(tmp_path)
    assert read.sensor.name == "mavic_3m"
    assert sensor_place(read) == (50.0, 0.025)
    assert read.air is None
    assert drone_sensor(read).bands == load_sensor("mavic_3m").bands


@pytest.mark.parametrize(
    ("table", "altitude", "pixel"),
    [
        ('name = "aviris_ng"', 1000.0, 1.0150),
        ('name = "aviris_ng"\naltitude_m = 2000', 2000.0, 2.0301),
        ('name = "emit"', SPACE, 60.0),
        ('path = "mine.toml"', 60.0, 0.03),
        ('name = "rededge_3"\npixel_m = 0.1', 100.0, 0.1),
    ],
)
def test_altitude_and_pixel_come_from_the_sensor(tmp_path, table, altitude, pixel):
    read = plot(tmp_path, f"[sensor]\n{table}\n")
    assert sensor_place(read) == (altitude, pytest.approx(pixel, rel=1e-4))


def test_place_and_time_give_the_sun(tmp_path):
    """The Pasadena lawn of 8 November 2017: zenith 52.49, azimuth 163.69 degrees."""
    where = "latitude_deg = 34.138\nlongitude_deg = -118.126\n"
    read = plot(tmp_path, f"[sun]\n{where}time = 2017-11-08T18:42:29Z\n")
    assert read.sun.zenith == pytest.approx(52.49, abs=0.1)
    assert read.sun.azimuth == pytest.approx(163.69, abs=0.1)
    assert read.sun.solar_factor == pytest.approx(1.019, abs=2e-3)  # near perihelion
    for time, words in (
        ("2017-11-08T08:42:29Z", "above the horizon, but is"),
        ("2017-11-09T00:48:00Z", "at least 1 degree above the horizon, but it is 0"),
        ("2017-11-08T18:42:29", "time zone"),
    ):
        with pytest.raises(InputError, match=words) as caught:
            plot(tmp_path, f"[sun]\n{where}time = {time}\n")
        assert caught.value.column == "sun.time"
        assert caught.value.row == 9
    with pytest.raises(InputError, match="zenith_deg, or place and time, but got both"):
        plot(tmp_path, f"[sun]\nzenith_deg = 20\n{where}time = 2017-11-08T18:42:29Z\n")


SLIPS = [
    ('[sensor]\nname = "avirs_ng"', r"expected a shipped sensor.*Did you mean 'aviris_ng'"),
    ('[sensor]\npath = "mien.toml"', "'mien.toml'"),
    ("[atmosphere]\nwater_vapour_cm = 20", r"In mm\? Divide by 10"),
    ("[atmosphere]\nozone_cm_atm = 300", r"In Dobson units\? Divide by 1000"),
    ("[atmosphere]\npressure_hpa = 101325", r"In Pa\? Divide by 100"),
    ('[atmosphere]\nmodel = "6s"', "one of 'table', 'clear-sky', 'none'"),
    ('[atmosphere]\nfile = "curves.csv"\nmodel = "table"', "no 'model' beside a file"),
]


@pytest.mark.parametrize(("tables", "words"), SLIPS)
def test_a_slip_is_explained(tmp_path, tables, words):
    with pytest.raises(InputError, match=words):
        plot(tmp_path, tables + "\n")


def test_a_satellite_sees_a_plot_that_goes_on_for_ever_only(tmp_path):
    assert sensor_place(plot(tmp_path, '[sensor]\nname = "emit"\n'))[1] == 60.0
    with pytest.raises(
        InputError, match=r"2 m, but got 60 m\. A plot with boundary = \"periodic\""
    ):
        plot(tmp_path, '[sensor]\nname = "emit"\n', HEAD + 'boundary = "open"\n')


def test_the_drone_commands_need_the_drone_bands(tmp_path):
    read = plot(tmp_path, '[sensor]\npath = "mine.toml"\n')
    bands = drone_sensor(read).bands
    assert bands.names == BANDS  # in the order of the indices, whatever the file's
    assert bands.centre == (560.0, 650.0, 730.0, 860.0)
    for name, words in (("aviris_ng", "has no green"), ("emit", "fynjax simulate plot.toml")):
        with pytest.raises(InputError, match=words):
            drone_sensor(plot(tmp_path, f'[sensor]\nname = "{name}"\n'))
    wide = plot(tmp_path, '[sensor]\npath = "mine.toml"\npixel_m = 3.0\n')
    with pytest.raises(InputError, match="2 m, but 'mine' has 3 m"):
        drone_sensor(wide)


def test_a_drone_s_further_bands_come_after_the_four(tmp_path):
    """With the errors of their gains."""
    five = '[sensor]\nname = "rededge_3"\n[calibration]\ngain_sd = {blue = 0.3}\n'
    read = plot(tmp_path, five)
    every = drone_sensor(read)
    assert every.bands.names == (*BANDS, "blue")
    assert every.gains().of_bands(5) == pytest.approx([0.1, 0.1, 0.1, 0.1, 0.3])
    assert drone_sensor(read, {"red", "NDVI"}).bands.names == BANDS


def test_errors_of_calibration_are_the_sensor_s_but_for_what_a_plot_file_states(tmp_path):
    def gains(tables):
        return drone_sensor(plot(tmp_path, tables)).gains()

    errors = load_sensor("mavic_3m")
    assert gains("").of_bands(4) == pytest.approx(0.35)
    assert gains("").way == "light_sensor"
    panels = gains('[sensor]\ncalibrated_by = "panels"\n[calibration]\ngain_shared = 0.9\n')
    assert panels.of_bands(4) == pytest.approx(errors.gains("panels").sd)
    assert (panels.way, panels.shared) == ("panels", 0.9)
    assert gains("[calibration]\ngain_sd = 0.0\n").sd == 0.0
    one = gains("[calibration]\ngain_sd = {red_edge = 0.3}\n")
    assert one.sd == (0.35, 0.35, 0.3, 0.35)
    assert one.shared == errors.gains().shared
    assert gains('[sensor]\npath = "mine.toml"\n').of_bands(4) == pytest.approx(0.05)
    with pytest.raises(InputError, match=r"compared \(green.*\), but got 'blue'") as error:
        gains("[calibration]\ngain_sd = {blue = 0.1}\n")
    assert error.value.column == "calibration.gain_sd"
    with pytest.raises(InputError, match=r"states \(none\), but got 'panels'"):
        gains('[sensor]\npath = "mine.toml"\ncalibrated_by = "panels"\n')
    with pytest.raises(InputError, match="gain_sd"):
        gains("[calibration]\ngain_sd = {red = 2.0}\n")


def test_bands_beyond_the_spectra_are_left_out(tmp_path):
    read = plot(tmp_path, '[sensor]\npath = "mine.toml"\n')
    assert plot_instrument(read).bands.names == ("nir", "red", "red_edge", "green")
    spectrometer = load_sensor("aviris_ng")
    seen = visible_sensor(spectrometer)
    assert 415 < len(seen.bands) < 425
    assert min(seen.bands.centre) > 400.0
    assert max(seen.bands.centre) < 2500.0
    assert seen.noise.a.shape == (len(seen.bands),)
    at = spectrometer.bands.names.index(seen.bands.names[0])
    assert seen.noise.a[0] == spectrometer.noise.a[at]
    hot = dataclasses.replace(load_sensor("mavic_3m"), bands=BandSet(("t",), (10500.0,), (1000.0,)))
    with pytest.raises(InputError, match="no band within 400 to 2500 nm"):
        visible_sensor(hot)


def test_a_sensor_is_built_as_the_files_say(tmp_path):
    read = plot(
        tmp_path,
        '[sensor]\npath = "mine.toml"\naltitude_m = 120\ntilt_deg = 10\nheading_deg = 90\n'
        "[atmosphere]\nwater_vapour_cm = 2.5\naerosol_optical_depth = 0.07\n",
    )
    read = read.replace(sun=read.sun._replace(solar_factor=1.02))
    scene, parameters = build_plot(read)
    sensing = aim_at_plot(read, scene, parameters, plot_instrument(read))
    assert sensing.pixel == pytest.approx(0.06)
    assert sensing.sensor_height == 120.0
    assert float(sensing.sensor.camera.tilt) == 10.0
    assert isinstance(sensing.air, PlotAir)
    assert (sensing.air.water_vapour, sensing.air.aerosol) == (2.5, 0.07)
    assert sensing.air.solar_factor == 1.02
    assert sensing.sensor.psf is not None
    # Another sensor takes nothing from the file's.
    none = AtmosphereTable(model="none")
    other = aim_at_plot(read, scene, parameters, load_sensor("emit"), air=none)
    assert (other.pixel, other.air, other.shape) == (60.0, None, (1, 1))
    air = AtmosphereTable(file=tmp_path / "curves.csv")
    assert (read.air.source, none.source, air.source) == ("table", "none", "file")
    own = aim_at_plot(read, scene, parameters, plot_instrument(read), air=air)
    assert isinstance(own.air, Atmosphere)
    with pytest.raises(InputError, match=r"outside the spectrum's range 400 to 1000 nm"):
        aim_at_plot(read, scene, parameters, load_sensor("emit"), air=air)
    assert np.isfinite(float(parameters.light.aerosol))


def test_a_pixel_that_the_optics_do_not_give_is_told(tmp_path):
    read = plot(tmp_path)
    wide = plot(tmp_path, head=HEAD.replace("2.0", "4.0").replace("0.2", "0.4"))
    with pytest.warns(UserWarning, match=r"pixel of 3 m is used.* has one of 1\.015 m.* 2956 m"):
        aim_at_plot(wide, *build_plot(wide), load_sensor("aviris_ng"), pixel=3.0)
    with pytest.raises(InputError, match="above the plants"):
        aim_at_plot(read, *build_plot(read), load_sensor("mavic_3m"), altitude=0.4)
    (tmp_path / "sky.csv").write_text("wavelength_nm,diffuse_fraction\n400,0.3\n2500,0.05\n")
    both = plot(tmp_path, '[sky]\ntable = "sky.csv"\n[atmosphere]\nmodel = "table"\n')
    with pytest.raises(InputError, match="but got both"):
        aim_at_plot(both, *build_plot(both), load_sensor("mavic_3m"))

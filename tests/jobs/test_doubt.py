"""What jobs say, before their work, of measurements that shrubland cannot make."""

import dataclasses
import logging

import numpy as np
import pytest

import fynjax as fx
from fynjax import jobs
from fynjax.app.assembly import read_targets
from fynjax.app.compare import bands_2006
from fynjax.app.io.plot import read_plot
from fynjax.app.io.raster import write_geotiff
from fynjax.app.jobs import ValidationData, pattern, validate
from fynjax.app.jobs._doubt import doubt_spectrum, doubt_targets
from fynjax.app.jobs._run import Run
from fynjax.inversion import Data
from fynjax.metrics import BANDS
from tests.io.test_crowns import CROWNS, write
from tests.small import write_plot

GOOD = {"green": 0.05, "red": 0.045, "red_edge": 0.15, "nir": 0.22}
BAD = GOOD | {"red_edge": 0.08}
MORE = '[sensor]\npixel_m = 0.1\n[calibration]\nfree = ["species.*.dead_fraction"]\n'
SAID = "These bands are not such as shrubland has"


@pytest.fixture
def run(tmp_path):
    return Run(tmp_path)


@pytest.fixture
def heard(caplog):
    caplog.set_level(logging.WARNING, logger="fynjax")
    return lambda: [record.message for record in caplog.records]


def image_file(path, means, scale=1.0, side=40):
    """An image of reflectance, or of counts, of these means."""
    texture = np.random.default_rng(0).uniform(0.8, 1.2, (side, side))
    values = [scale * mean * texture / texture.mean() for mean in means.values()]
    write_geotiff(path, values, list(means), pixel_m=0.1)
    return path


def test_it_is_said_at_once_and_stays_in_the_result_and_on_the_page(run, heard):
    drone = fx.sensor("mavic_3m")
    doubt_spectrum(run, GOOD, drone.bands, drone)
    doubt_spectrum(run, {"red": 0.05}, drone.bands)  # too few to judge
    assert not run.doubts
    assert not heard()
    doubt_spectrum(run, BAD, drone.bands)
    assert heard() == run.doubts
    assert run.doubts[0].startswith(SAID)
    assert "red_edge / nir is 0.36" in run.doubts[0]
    assert "can explain" not in run.doubts[0]  # of a camera that is not known


def test_what_the_camera_may_be_off_by_is_weighed(run):
    """The article's image: its light sensor explains it, a panel would not have."""
    real = {name: row.real_mean for name, row in bands_2006().items()}
    drone = fx.sensor("mavic_3m")
    doubt_spectrum(run, real, drone.bands, drone)
    assert "Errors of its calibration, 35 % a band" in run.doubts[0]
    assert "can explain them (chance 0.13)" in run.doubts[0]
    panels = fx.sensor("rededge_3").gains("panels")
    doubt_spectrum(run, real, drone.bands, dataclasses.replace(drone, calibrations=(panels,)))
    assert "Not even errors of its calibration, 10 % a band" in run.doubts[1]


def test_targets_of_a_plot_are_judged(run, tmp_path):
    plot = read_plot(write_plot(tmp_path))
    rows = "".join(f"{name}.mean,{value},0.001\n" for name, value in BAD.items())
    (tmp_path / "image.csv").write_text("statistic,value,sd\n" + rows + "NDVI.std,0.1,0.01\n")
    (tmp_path / "spectrum.csv").write_text("wavelength_nm,mean\n550,0.3\n680,0.3\n860,0.02\n")
    for file, count in (("image.csv", 1), ("spectrum.csv", 2)):
        doubt_targets(run, plot, read_targets(plot, [tmp_path / file]))
        assert len(run.doubts) == count
    (tmp_path / "image.csv").write_text("statistic,value,sd\nNDVI.std,0.1,0.01\n")
    doubt_targets(run, plot, read_targets(plot, [tmp_path / "image.csv"]))
    assert len(run.doubts) == 2


def test_a_view_of_another_camera_is_judged_by_its_own(run, tmp_path):
    """Whatever the plot's sensor is, one that makes no drone's image too."""
    plot = read_plot(write_plot(tmp_path))
    plot = plot.replace(sensor=plot.sensor.replace(name="aviris_ng"))
    values = {f"{name}.mean": value for name, value in BAD.items()}
    doubt_targets(run, plot, Data.from_table(values, "rededge_3"))
    assert len(run.doubts) == 1
    assert str(fx.sensor("rededge_3").gains()) in run.doubts[0]


@pytest.mark.parametrize("command", ["calibrate", "posterior", "known plants"])
def test_targets_are_judged_before_the_work(tmp_path, heard, command):
    """Which a dry run leaves out."""
    if command == "known plants":
        plot = write(tmp_path, CROWNS, more=MORE)
    else:
        plot = write_plot(tmp_path, MORE)
    target = image_file(tmp_path / "bad.tif", BAD, side=round(read_plot(plot).size_m[0] / 0.1))
    kept = {"checkpoint": tmp_path / "kept"}
    job = jobs.posterior if command == "posterior" else jobs.calibrate
    with jobs.dry_run(), pytest.raises(jobs.DryRunEnd):
        job(plot, target, tmp_path / "out", **kept)
    assert len(heard()) == 1
    assert heard()[0].startswith(SAID)
    assert "Errors of its calibration" in heard()[0]


def test_of_images_to_be_clustered_reflectance_alone_is_judged(tmp_path):
    for name, means, scale, said in (
        ("good", GOOD, 1.0, False),
        ("bad", BAD, 1.0, True),
        ("counts", BAD, 10_000.0, False),
        ("colours", {"red": 0.6, "green": 0.05, "blue": 0.3}, 1.0, False),
    ):
        path = image_file(tmp_path / f"{name}.tif", means, scale)
        result = pattern([path], tmp_path / name)
        assert any(line.startswith(SAID) for line in result.warnings) == said, name


def test_a_real_image_is_judged_and_a_simulated_one_is_not(tmp_path):
    good, bad = (
        image_file(tmp_path / f"{name}.tif", means) for name, means in (("g", GOOD), ("b", BAD))
    )
    assert not validate(ValidationData(good, bad), tmp_path / "one").warnings
    result = validate(ValidationData(bad, good), tmp_path / "two")
    assert result.warnings[0].startswith(SAID)
    page = (tmp_path / "two" / "report.html").read_text("utf-8")
    assert SAID in page[: page.index("<h2")]
    published = validate(ValidationData("published", good), tmp_path / "three")
    assert "red_edge / nir is 0.38" in published.warnings[0]


def test_the_front_door_takes_whatever_there_is(tmp_path):
    bad = image_file(tmp_path / "bad.tif", BAD)
    array = np.array(list(BAD.values()))
    cube = array[:, None, None] * np.ones((4, 2, 3))
    cube[:, 0, 0] = np.nan
    for one in (BAD, array, cube, bad, str(bad), fx.compare.read_drone_image(bad)):
        check = fx.check_vegetation(one, fx.sensor("mavic_3m"))
        assert check.unlike
        assert check.pairs.iloc[0].ratio == pytest.approx(0.08 / 0.22, rel=1e-3)
    assert not fx.check_vegetation(BAD, gains="light_sensor").unlike
    assert not fx.check_vegetation(dict(zip(BANDS, GOOD.values()))).unlike
    with pytest.raises(fx.errors.InputError, match="expected an imaging sensor"):
        fx.check_vegetation(BAD, "flash_lidar_paper")

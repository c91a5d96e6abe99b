"""`fynjax train` and `fynjax map` on a camera's few bands."""

import dataclasses
import functools
import os
import re
import signal
import subprocess
import sys
import time
import warnings
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import rasterio
import xarray as xr
from rasterio.errors import NotGeoreferencedWarning
from typer.testing import CliRunner

from fynjax import jobs
from fynjax._core import parts
from fynjax._core.errors import InputError
from fynjax.app.assembly import (
    STAND_QUANTITIES,
    StandSettings,
    _pixels,
    sample_pixel,
    simulate_stands,
)
from fynjax.app.assembly import _stands as stands
from fynjax.app.cli import app
from fynjax.app.io.plot import read_prior
from fynjax.app.io.raster import Cube, CubeBlocks, write_cube_envi
from fynjax.app.jobs import _map as job
from fynjax.app.jobs import _map_pixels
from fynjax.app.report.pages import format_number
from fynjax.inversion import PriorChain, estimate_pixels
from fynjax.radiation import render, solve_light
from fynjax.sensors import group_bands, shipped_sensor
from fynjax.studies.bioscape._spectra import read_plot_spectra, read_spectrometer
from tests.benchmarks.map_plots import write_plots
from tests.helpers import unix
from tests.io.emit_files import GEOTRANSFORM, NOWHERE, lookup, write_emit

pytest.importorskip("optax")

SENSOR = "sentinel_2a"
SMALL = functools.partial(StandSettings, size_m=1.5)
SETTINGS = SMALL(sun_zenith=(25.0, 35.0))


@pytest.fixture(scope="module")
def known():
    channels, bands = group_bands(shipped_sensor(SENSOR).bands)
    return channels, bands, read_prior("fynbos_2023")


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    folder = tmp_path_factory.mktemp("train")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("fynjax.app.jobs._train.StandSettings", SMALL)
        result = jobs.train(
            folder / "out", sensor=SENSOR, sun_zenith=(25.0, 35.0), simulations=200, steps=60,
            checkpoint=folder / "checkpoint",
        )  # fmt: skip
    return folder, result


def test_stands_are_those_of_their_number(known):
    _, bands, prior = known
    both = simulate_stands((3, 4), bands, prior, SETTINGS, 1)
    one = simulate_stands((4,), bands, prior, SETTINGS, 1)
    assert np.array_equal(both.reflectance[SETTINGS.together :], one.reflectance)
    assert np.array_equal(both.quantities[SETTINGS.together :], one.quantities)
    names = list(STAND_QUANTITIES)
    covers = [names.index(n) for n in ("live_cover", "dead_cover", "bare_cover")]
    assert both.quantities[:, covers].sum(axis=1) == pytest.approx(1.0)
    assert (both.quantities >= 0.0).all()


def test_spectra_of_sets_taken_together_are_those_of_each_alone(known):
    """Against a solve of every band of one set, on the same voxels."""
    _, bands, prior = known
    scene, planted, imager = stands._planted(stands.stand_forms(prior), bands, SETTINGS)
    rng = np.random.default_rng(2)
    common, own = (rng.normal(size=n) for n in stands.stand_numbers(prior))
    own = rng.normal(size=(SETTINGS.together, own.size))
    drawn = stands._draw(prior, SETTINGS, common, own)
    parameters = dataclasses.replace(planted, species=drawn.species, light=drawn.light)
    together, residual = stands._spectra(imager, scene, parameters, drawn.optics)
    assert float(residual) < 0.01
    alone = jax.tree.map(lambda a: a[1], drawn.optics)
    species = dataclasses.replace(parameters.species, dead_fraction=alone.dead_fraction)
    one = dataclasses.replace(parameters, leaf=alone.leaf, species=species, ground=alone.ground)
    voxels = scene.voxels(one, bands)
    accuracy = dataclasses.replace(imager.accuracy, solves=None)
    image = eqx.filter_jit(lambda v: render(solve_light(v, accuracy), imager.rays).total)(voxels)
    expected = np.pi * np.asarray(image.mean(axis=(1, 2)) / voxels.illumination.incident)
    assert np.asarray(together)[1] == pytest.approx(expected, rel=0.01)


def test_a_training_is_read_back_as_it_was_written(trained, tmp_path):
    folder, result = trained
    assert result.simulations == 204
    assert len(result.scores) == len(STAND_QUANTITIES)
    path = folder / "out" / "training.nc"
    one = jobs.read_training(path)
    jobs.write_training(tmp_path / "again.nc", one)
    again = jobs.read_training(tmp_path / "again.nc")
    for a, b in zip(jax.tree.leaves(one.posterior), jax.tree.leaves(again.posterior), strict=True):
        assert np.array_equal(a, b)
    assert one.record["sensor"] == SENSOR
    assert "fynbos" in one.record["prior"].lower()
    with xr.open_dataset(path) as data:
        data.drop_vars("within").to_netcdf(tmp_path / "earlier.nc")
    with pytest.raises(InputError, match="one of another version"):
        jobs.read_training(tmp_path / "earlier.nc")
    for wrong in ({"sun_zenith_deg": "[30]"}, {"stand_size_m": "wide"}, {"sensor_bands": np.inf}):
        with xr.open_dataset(path) as data:
            data.assign_attrs(wrong).to_netcdf(tmp_path / "wrong.nc")
        with pytest.raises(InputError, match="training"):
            jobs.read_training(tmp_path / "wrong.nc")
    with xr.open_dataset(path) as data:
        data.load()["response"][3, 200] = np.nan
        data.to_netcdf(tmp_path / "wrong.nc")
    with pytest.raises(InputError, match="finite numbers"):
        jobs.read_training(tmp_path / "wrong.nc")
    damaged = tmp_path / "damaged.nc"
    damaged.write_bytes(path.read_bytes()[:3000])
    with pytest.raises(InputError, match="training"):
        jobs.read_training(damaged)
    # A flipped bit is found, or changes nothing.
    whole, found = path.read_bytes(), 0
    for place in np.random.default_rng(0).integers(len(whole), size=24):
        flipped = bytearray(whole)
        flipped[place] ^= 1 << place % 8
        damaged.write_bytes(flipped)
        try:
            again = jobs.read_training(damaged)
        except InputError:
            found += 1
            continue
        left, right = ({k: v for k, v in t.record.items() if k != "history"} for t in (one, again))
        assert left == right
        for a, b in zip(jax.tree.leaves(one.posterior), jax.tree.leaves(again.posterior)):
            assert np.array_equal(a, b)
    assert found > 12
    with xr.open_dataset(path) as data:
        data.load()["weight_0"][0, 0] += 1e-6
        data.to_netcdf(tmp_path / "wrong.nc")
    with pytest.raises(InputError, match="content has changed"):
        jobs.read_training(tmp_path / "wrong.nc")


@functools.cache
def simulated():
    """Reflectance of three sets of stands [stand, band]."""
    _, bands = group_bands(shipped_sensor(SENSOR).bands)
    return simulate_stands((1, 2, 3), bands, read_prior("fynbos_2023"), SETTINGS, 5).reflectance


def cube_of(folder, known, **changes):
    channels, bands, _ = known
    values = simulated()[::3].T.reshape(len(bands), 3, 4).copy()
    values[:, 1, 2] = np.nan
    values[:, 0, 0] = np.linspace(1.5, 0.1, len(bands))  # no vegetation looks like this
    cube = Cube(
        values=values,
        names=bands.names,
        wavelength=np.asarray(channels.centre),
        fwhm=np.asarray(bands.fwhm),
        good=np.ones(len(bands), bool),
        pixel_m=10.0,
        origin_m=(300000.0, 6200000.0),
        crs="EPSG:32734",
    )
    write_cube_envi(folder / "cube.hdr", dataclasses.replace(cube, **changes), {})
    return folder / "cube.hdr"


def test_maps_lie_where_the_cube_lies_and_mask_what_is_unlike(trained, known, tmp_path):
    path = cube_of(tmp_path, known)
    training = trained[0] / "out" / "training.nc"
    result = jobs.map_cube(
        path, training, tmp_path / "out", zarr=True, checkpoint=tmp_path / "work"
    )
    assert result.pixels == 12
    assert result.without_data == 1
    assert result.masked >= 1
    page = (tmp_path / "out" / "report.html").read_text("utf-8")
    assert all(f">{format_number(one.rmse)}<" in page for one in trained[1].scores)
    with rasterio.open(tmp_path / "out" / "maps.tif") as file:
        assert file.crs.to_epsg() == 32734
        assert file.transform.a == 10.0
        maps = dict(zip(file.descriptions, file.read(), strict=True))
    with xr.open_zarr(tmp_path / "out" / "maps.zarr", consolidated=False) as same:
        assert set(same.data_vars) == {*maps, "crs"}
        for name, values in maps.items():
            np.testing.assert_array_equal(same[name], values)
        assert same["leaf_area_sd"].attrs["units"] == "m2 m-2"
        assert "32734" in same["crs"].attrs["crs_wkt"]
        assert same["x"].values.tolist() == [300005.0, 300015.0, 300025.0, 300035.0]
        assert same["y"].values.tolist() == [6200025.0, 6200015.0, 6200005.0]
        for axis in "xy":
            assert same[axis].attrs["standard_name"] == f"projection_{axis}_coordinate"
            assert same[axis].attrs["units"] == "m"
        assert same.attrs["history"].startswith("20")
        assert same["live_cover"].attrs["grid_mapping"] == "crs"
    # North is up: row 2 of the file is the southernmost, row 0 of the cube.
    assert maps["unlikeness"][2, 0] > 1.0
    assert np.isnan(maps["live_cover"][2, 0])
    assert np.isnan(maps["unlikeness"][1, 2])
    assert np.isnan(maps["live_cover"][1, 2])
    shown = np.isfinite(maps["live_cover"])
    assert shown.sum() == 12 - 1 - result.masked
    for name in STAND_QUANTITIES:
        assert (maps[f"{name}_q05"] <= maps[f"{name}_q95"])[shown].all()
        assert (maps[f"{name}_sd"] > 0)[shown].all()
    kept = jobs.map_cube(
        path, training, tmp_path / "kept", keep_unlike=True, checkpoint=tmp_path / "work"
    )
    assert kept.masked == result.masked
    with rasterio.open(tmp_path / "kept" / "maps.tif") as file:
        assert np.isfinite(file.read(1)).sum() == 11


def emit_of(folder, known, name, **changes):
    channels, bands, _ = known
    values = simulated()[:24].reshape(6, 4, len(bands))
    write_emit(folder / name, values, channels.centre, bands.fwhm, **changes)
    return folder / name


def maps_of(folder):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", NotGeoreferencedWarning)
        with rasterio.open(folder / "maps.tif") as file:
            return file.read(), file.transform, file.crs, file.tags()


def test_a_cube_that_is_no_vegetation_is_doubted(trained, known, tmp_path):
    channels, _, _ = known
    bright = 0.05 + 0.1 * (np.asarray(channels.centre) < 700.0)  # darker in the near infrared
    values = np.tile(bright[:, None, None], (1, 3, 4))
    values[:, 0, 0] = np.nan
    path = cube_of(tmp_path, known, values=values)
    training = trained[0] / "out" / "training.nc"
    result = jobs.map_cube(path, training, tmp_path / "out", checkpoint=tmp_path / "work")
    assert result.warnings[0].startswith("These bands are not such as shrubland has")


def test_a_cube_times_32768_is_not_taken_for_ten_thousandths(trained, known, tmp_path):
    values = simulated()[::3].T.reshape(-1, 3, 4)
    shrubs = cube_of(tmp_path, known, values=32768.0 * values)
    training = trained[0] / "out" / "training.nc"
    with pytest.raises(InputError, match="only if 32768 is a reflectance of 1"):
        jobs.map_cube(shrubs, training, tmp_path / "out", checkpoint=tmp_path / "work")


def test_maps_of_emit_lie_on_the_grid_of_its_file(trained, known, tmp_path, monkeypatch):
    """Each pixel is that of the maps of the same swath without a place, also of a run that goes
    on."""
    training = trained[0] / "out" / "training.nc"
    monkeypatch.setattr(CubeBlocks, "rows_at_once", 2)
    swath = emit_of(tmp_path, known, "swath.nc", location=NOWHERE)
    with pytest.warns(UserWarning, match="swath.nc says no place .* rows and columns only"):
        unplaced = jobs.map_cube(
            swath, training, tmp_path / "swath", checkpoint=tmp_path / "work", keep_unlike=True
        )
    on_swath, transform, crs, tags = maps_of(tmp_path / "swath")
    assert transform.is_identity
    assert not crs.is_geographic
    assert not crs.is_projected
    assert unplaced.place == tags["place"] == "rows and columns only"

    path = emit_of(tmp_path, known, "emit.nc")
    began, real = [], job._mapped

    def mapped(part, *shared):
        began.append(part)
        if len(began) == 2:
            raise KeyboardInterrupt
        return real(part, *shared)

    monkeypatch.setattr(job, "_mapped", mapped)
    given = {"checkpoint": tmp_path / "work", "keep_unlike": True, "zarr": True}
    with pytest.raises(KeyboardInterrupt):
        jobs.map_cube(path, training, tmp_path / "out", **given)
    assert not (tmp_path / "out" / "maps.tif").exists()
    result = jobs.map_cube(path, training, tmp_path / "out", **given)
    assert began == [(0, 2), (2, 2), (2, 2), (4, 2)]
    maps, transform, crs, tags = maps_of(tmp_path / "out")
    assert transform.to_gdal() == pytest.approx(GEOTRANSFORM)
    assert crs.to_epsg() == 4326
    glt_x, glt_y = lookup(6, 4)
    there = glt_x > 0
    assert there.sum() > 20
    assert np.isfinite(on_swath).all()
    np.testing.assert_array_equal(maps[:, there], on_swath[:, glt_y[there] - 1, glt_x[there] - 1])
    assert np.isnan(maps[:, ~there]).all()
    with xr.open_zarr(tmp_path / "out" / "maps.zarr", consolidated=False) as same:
        np.testing.assert_array_equal(same["live_cover"], maps[0])
        assert same["x"].attrs["standard_name"] == "longitude"
    # Counts and figures are the swath's: of a pixel that stands in several of the map only one.
    assert result.pixels == 24
    assert result.maps == unplaced.maps
    assert "lookup table" in result.place == tags["place"]
    assert "which its lookup table names" in result.headline[1]
    assert "north is not up" in (tmp_path / "out" / "report.html").read_text("utf-8")
    assert not (tmp_path / "work").exists()


def test_a_damaged_lookup_table_is_refused_before_any_work(trained, known, tmp_path):
    table = lookup(6, 4)[0]
    table[table == 4] = 5
    path = emit_of(tmp_path, known, "emit.nc", location={"glt_x": (("ortho_y", "ortho_x"), table)})
    training = trained[0] / "out" / "training.nc"
    with pytest.raises(InputError, match=r"emit.nc: expected glt_x from 1 to 4"):
        jobs.map_cube(path, training, tmp_path / "out", checkpoint=tmp_path / "work")
    assert not (tmp_path / "work").exists()


def test_a_map_of_a_worker_is_that_of_this_process(trained, known, tmp_path, monkeypatch):
    pytest.importorskip("distributed", reason="the extra `map` is not installed")
    monkeypatch.setattr(parts, "_machine", lambda: (2, 8 * 2**30))
    monkeypatch.setattr(CubeBlocks, "rows_at_once", 1)
    path, training = cube_of(tmp_path, known), trained[0] / "out" / "training.nc"
    for name, workers in (("here", None), ("there", jobs.Workers(1))):
        jobs.map_cube(
            path, training, tmp_path / name, checkpoint=tmp_path / "work", workers=workers
        )
    with (
        rasterio.open(tmp_path / "here" / "maps.tif") as one,
        rasterio.open(tmp_path / "there" / "maps.tif") as other,
    ):
        assert one.read().tobytes() == other.read().tobytes()


COMMAND = """
import sys, time
from pathlib import Path
from fynjax.app.cli import main
from fynjax.app.io.raster import CubeBlocks
from fynjax.app.jobs import _map as job

second, *arguments = sys.argv[1:]
CubeBlocks.rows_at_once, real = 1, job._mapped

def mapped(part, *shared):
    if part[0] == 1:
        Path(second).touch()
        time.sleep(600)
    return real(part, *shared)

job._mapped = mapped
main(arguments)
"""


@unix
def test_a_killed_map_goes_on_and_is_that_of_one_run(trained, known, tmp_path, monkeypatch):
    """SIGKILL of the command in its second block of three; the same command goes on from there."""
    path, second = cube_of(tmp_path, known), tmp_path / "second"
    script = tmp_path / "command.py"
    script.write_text(COMMAND)
    training, output = trained[0] / "out" / "training.nc", tmp_path / "out"
    line = [str(part) for part in ("map", path, "--training", training, "--output", output)]
    run = subprocess.Popen(
        [sys.executable, script, second, *line, "--quiet"],
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
        env={**os.environ, "PYTHONPATH": str(Path(__file__).resolve().parents[2])},
    )  # fmt: skip
    end = time.monotonic() + 120
    while not second.exists():
        assert run.poll() is None, run.communicate()[0]
        assert time.monotonic() < end
        time.sleep(0.05)
    run.kill()
    run.communicate()
    assert run.returncode == -signal.SIGKILL
    assert not output.exists()
    begun, real = [], job._mapped

    def mapped(part, *shared):
        begun.append(part[0])
        return real(part, *shared)

    monkeypatch.setattr(job, "_mapped", mapped)
    monkeypatch.setattr(CubeBlocks, "rows_at_once", 1)
    again = CliRunner().invoke(app, [*line, "--quiet"])
    assert (again.exit_code, again.output) == (0, "")
    assert begun == [1, 2]
    assert not (tmp_path / "out.checkpoint").exists()
    jobs.map_cube(path, training, tmp_path / "whole", checkpoint=tmp_path / "other")
    with (
        rasterio.open(output / "maps.tif") as one,
        rasterio.open(tmp_path / "whole" / "maps.tif") as other,
    ):
        np.testing.assert_array_equal(one.read(), other.read())
        assert one.descriptions == other.descriptions
        own = {"date_created": "", "command": ""}
        assert one.tags() | own == other.tags() | own


@pytest.fixture
def quick_chains(monkeypatch):
    """Chains of pixels that take no render; gives the list of those that were asked for."""
    asked = []

    def chain(reflectance, bands, prior, settings, *, steps, seed):
        asked.append((reflectance, bands, settings, seed))
        random = np.random.default_rng(seed)
        values = random.uniform(size=(steps, 16, len(STAND_QUANTITIES)))
        return PriorChain(values, np.zeros((steps, 16)), 0.25)

    monkeypatch.setattr(_map_pixels, "sample_pixel", chain)
    return asked


# Of a training of a few hundred stands a drawn one may be unlike all others.
@pytest.mark.filterwarnings("ignore:the spectrum of row .* is unlike the simulations")
def test_full_posteriors_of_chosen_pixels_stand_beside_the_map(
    trained, known, tmp_path, quick_chains, monkeypatch
):
    """Of a run that was interrupted in the second of four chains; draws of a pixel are its own,
    whatever others are asked for."""
    path, training = cube_of(tmp_path, known), trained[0] / "out" / "training.nc"
    real = _map_pixels.sample_pixel

    def interrupted(*given, **how):
        if len(quick_chains) == 1:
            raise KeyboardInterrupt
        return real(*given, **how)

    def run(output, pixels):
        return jobs.map_cube(
            path, training, tmp_path / output, pixels=pixels, pixel_steps=120,
            checkpoint=tmp_path / "work",
        )  # fmt: skip

    with monkeypatch.context() as patch:
        patch.setattr(_map_pixels, "sample_pixel", interrupted)
        with pytest.raises(KeyboardInterrupt):
            run("out", [(3, 2), (1, 1)])
    result = run("out", [(3, 2), (1, 1)])
    with rasterio.open(path.with_suffix(".dat")) as file:
        cube = file.read()
    assert len(quick_chains) == 4  # two ensembles of each
    assert len({seed for *_, seed in quick_chains}) == 4
    for (reflectance, bands, settings, _), (row, column) in zip(
        quick_chains, [(3, 2), (3, 2), (1, 1), (1, 1)], strict=True
    ):
        # Each of this sensor's bands is a channel.
        np.testing.assert_allclose(reflectance, cube[:, row - 1, column - 1], rtol=1e-5)
        assert settings.sun_zenith == (25.0, 35.0)
        np.testing.assert_allclose(bands.centre, known[1].centre)
        grid = np.arange(400.0, 2501.0)
        expected = known[1].weights(grid, max_loss=1.0)
        np.testing.assert_allclose(bands.weights(grid, max_loss=1.0), expected, atol=1e-4)
    first = result.posteriors[0]
    assert (first.row, first.column) == (3, 2)
    assert first.converged
    assert first.effective_size > 1000.0
    assert (result.converged, result.status) == (True, "ok")
    with xr.open_dataset(tmp_path / "out" / "pixels.nc") as draws:
        assert "cube" in draws.attrs
    with rasterio.open(tmp_path / "out" / "maps.tif") as file:
        maps = dict(zip(file.descriptions, file.read(), strict=True))
    for one in first.quantities:
        assert one.map_mean == pytest.approx(maps[one.quantity][2, 1], rel=1e-4)
        assert one.map_q95 == pytest.approx(maps[f"{one.quantity}_q95"][2, 1], rel=1e-4)
        # Even from 0 to 1: what was drawn is what is stated.
        assert (one.q05, one.median, one.q95) == pytest.approx((0.05, 0.5, 0.95), abs=0.03)
        assert one.sd == pytest.approx(1 / np.sqrt(12.0), abs=0.02)
    with xr.open_dataset(tmp_path / "out" / "pixels.nc") as draws:
        assert draws.sizes == {"pixel": 2, "draw": 2 * 84 * 16}
        assert draws["row"].values.tolist() == [3, 1]
        assert float(draws["live_cover"][0].mean()) == pytest.approx(first.quantities[0].mean)
    assert len((tmp_path / "out" / "pixels.csv").read_text().splitlines()) == 1 + 2 * 8
    assert "row 3, column 2" in (tmp_path / "out" / "report.html").read_text()
    assert not (tmp_path / "work").exists()
    (alone,) = run("alone", [(3, 2), (3, 2)]).posteriors
    assert alone.effective_size == first.effective_size
    for one, other in zip(alone.quantities, first.quantities, strict=True):
        assert [one.mean, one.sd, one.q05, one.median, one.q95] == [
            other.mean, other.sd, other.q05, other.median, other.q95,
        ]  # fmt: skip


def test_a_pixel_that_did_not_converge_is_said_first(trained, known, tmp_path, monkeypatch):
    def stuck(reflectance, bands, prior, settings, *, steps, seed):
        values = np.random.default_rng(seed).uniform(size=(16, len(STAND_QUANTITIES)))
        return PriorChain(np.tile(values, (steps, 1, 1)), np.zeros((steps, 16)), 0.0)

    monkeypatch.setattr(_map_pixels, "sample_pixel", stuck)
    path, training = cube_of(tmp_path, known), trained[0] / "out" / "training.nc"
    with pytest.warns(UserWarning, match="row 3, column 2 did not converge: 0 effective"):
        result = jobs.map_cube(
            path, training, tmp_path / "out", pixels=[(3, 2)], checkpoint=tmp_path / "work"
        )
    assert result.converged is False
    assert result.headline[0] == "Not converged: the posterior of row 3, column 2."


def test_pixels_without_an_answer_are_refused_before_work(trained, known, tmp_path, quick_chains):
    path, training = cube_of(tmp_path, known), trained[0] / "out" / "training.nc"
    prior = tmp_path / "prior.toml"
    prior.write_text(known[2].path.read_text("utf-8") + "\n", "utf-8")
    for given, message in (
        ({"pixels": [(4, 1)]}, "rows 1 to 3 and columns 1 to 4, but got row 4, column 1"),
        ({"pixels": [(0, 1)]}, "but got row 0"),
        ({"pixels": [(2, 3)]}, "row 2, column 3 has none"),
        ({"pixels": [(1, 1)], "pixel_steps": 5}, "12 steps or more"),
        ({"pixels": [(1, 1)], "prior": prior}, "the prior that the training was made with"),
        ({"pixels": [(1, 1)], "prior": "none"}, "the prior that the training was made with"),
    ):
        with pytest.raises(InputError, match=message):
            jobs.map_cube(path, training, tmp_path / "out", checkpoint=tmp_path / "work", **given)
    assert not quick_chains
    assert not (tmp_path / "out" / "maps.tif").exists()


def test_chains_of_a_pixel_are_of_possible_stands_and_of_their_seed(known, monkeypatch):
    _, bands, prior = known
    monkeypatch.setattr(_pixels, "_WALKERS", 3)
    monkeypatch.setattr(_pixels, "_STANDS", 1)
    measured = simulate_stands((11,), bands, prior, SETTINGS, 3).reflectance[0]
    one, again = (sample_pixel(measured, bands, prior, SETTINGS, steps=3, seed=8) for _ in range(2))
    np.testing.assert_array_equal(one.quantities, again.quantities)
    assert one.quantities.shape == (3, 3, len(STAND_QUANTITIES))
    assert one.quantities[..., :3].sum(axis=2) == pytest.approx(1.0)
    assert (one.quantities >= 0.0).all()
    assert np.isfinite(one.log_likelihood).all()


@pytest.mark.study
def test_the_regression_of_a_map_stands_for_the_full_posterior(known, tmp_path):
    """Four simulated pixels: means within 0.4 standard deviations of emcee's on average, and widths
    within a quarter."""
    _, bands, prior = known
    jobs.train(
        tmp_path, sensor=SENSOR, sun_zenith=(25.0, 35.0), simulations=6000, steps=4000,
        checkpoint=tmp_path / "work",
    )  # fmt: skip
    training = jobs.read_training(tmp_path / "training.nc")
    made = simulate_stands((900, 901, 902, 903), bands, prior, SETTINGS, 5).reflectance
    pixels = made[:: SETTINGS.together]
    by_map = estimate_pixels(training.posterior, jnp.asarray(pixels, jnp.float32))
    off, wide = [], []
    for i, pixel in enumerate(pixels):
        draws = sample_pixel(pixel, bands, prior, SETTINGS, steps=400, seed=i).quantities[120:]
        draws = draws.reshape(-1, len(STAND_QUANTITIES))
        off.append((draws.mean(axis=0) - np.asarray(by_map.mean[i])) / draws.std(axis=0))
        wide.append(np.log(draws.std(axis=0) / np.asarray(by_map.sd[i])))
    assert np.mean(np.abs(off)) < 0.4
    assert np.abs(np.mean(wide)) < 0.25


@pytest.mark.study
def test_plots_of_fynbos_are_like_the_simulations_and_other_surfaces_are_not(shared_data, tmp_path):
    tables = shared_data / "eco" / "bioscape"
    sensor, measured = read_spectrometer(tables), read_plot_spectra(tables)
    plots = np.stack([m.reflectance.mean(axis=0) for m in measured.values()])
    good = np.isfinite(plots).all(axis=0)
    write_plots(tmp_path / "plots.hdr", plots, good)
    jobs.train(
        tmp_path, like=tmp_path / "plots.hdr", simulations=720, steps=2,
        checkpoint=tmp_path / "work",
    )  # fmt: skip
    training = jobs.read_training(tmp_path / "training.nc")
    channels = training.channels.weights(sensor.centre, good).T
    lawn = np.loadtxt(shared_data / "eco" / "avirisng" / "insitu_BeckmanLawn.txt")
    others = [
        np.interp(sensor.centre, *lawn.T[:2]),
        np.interp(sensor.centre, [450, 600, 700, 800], [0.05, 0.03, 0.01, 0.006]),  # water
        np.full(len(good), 0.6),  # cloud
    ]

    def unlikeness(spectra):
        pixels = jnp.asarray(np.nan_to_num(spectra) @ channels, jnp.float32)
        return np.asarray(estimate_pixels(training.posterior, pixels).unlikeness)

    assert len(plots) >= 18
    assert np.mean(unlikeness(plots) > 1.0) < 0.1
    assert (unlikeness(np.stack(others)) > 1.0).all()


def test_cubes_that_do_not_go_with_the_training_are_refused(trained, known, tmp_path):
    training = trained[0] / "out" / "training.nc"
    count = len(known[0].centre)
    for changes, message in (
        ({"good": np.arange(count) != 2}, "expected a good band between"),
        ({"wavelength": np.asarray(known[0].centre) + 150.0}, "fynjax train --like"),
        ({}, "states the wavelengths"),
    ):
        path = cube_of(tmp_path, known, **changes)
        if not changes:  # a header without them
            lines = path.read_text("utf-8")
            path.write_text(re.sub(r"(?ms)^(wavelength|fwhm) = \{.*?\}\n", "", lines), "utf-8")
        with pytest.raises(InputError, match=message):
            jobs.map_cube(path, training, tmp_path / "out", checkpoint=tmp_path / "work")
        assert not (tmp_path / "out" / "maps.tif").exists()


def test_wrong_arguments_are_refused(tmp_path):
    for given, message in (
        ({}, "either a sensor or a cube"),
        ({"sensor": SENSOR, "sun_zenith": (40.0, 30.0)}, "the least first"),
        ({"sensor": SENSOR, "simulations": 10}, "200 simulations or more"),
        ({"sensor": SENSOR, "prior": "none"}, "a learned prior"),
    ):
        with pytest.raises(InputError, match=message):
            jobs.train(tmp_path / "out", checkpoint=tmp_path / "work", **given)

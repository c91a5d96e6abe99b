"""Pictures of a flight laid on the ground, and fitted: against a ground that is a formula."""

import json

import numpy as np
import pandas as pd
import pytest
import rasterio
import xarray as xr

from fynjax import jobs
from fynjax._core.errors import InputError
from fynjax.app.assembly import read_problem
from fynjax.app.io.frames import PICTURE_TAG, TIME_TAG
from fynjax.sensors import sun_position
from tests.io import flight_pictures as pictures
from tests.io import frame_files as made
from tests.io.frame_files import CRS, GROUND, ORIGIN
from tests.small import write_plot

PLACE = {"crs": CRS, "origin": ORIGIN, "ground": GROUND, "pixel": 0.1}


@pytest.fixture(scope="module")
def flight(tmp_path_factory):
    folder = tmp_path_factory.mktemp("flight")
    pictures.write_pictures(folder / "images")
    made.write_odm(folder / "odm")
    return folder


def laid(flight, folder, **more):
    plot = write_plot(folder)
    kind = more.pop("poses", flight / "odm")
    more.setdefault("images", flight / "images")
    return plot, jobs.frames(kind, folder / "out", plot=plot, **PLACE | more)


def test_the_ground_comes_back_where_it_is(flight, tmp_path):
    """A picture's pixels are 7 to 12 cm: between them a wave of 1.3 m is known to a few percent."""
    _, result = laid(flight, tmp_path)
    assert result.flight.used == list(made.SHOTS)
    assert result.flight.left_out == []
    data = xr.load_dataset(tmp_path / "out" / "frames.nc")
    x, y = data["x"].values - ORIGIN[0], data["y"].values - ORIGIN[1]
    expected = pictures.ground(*np.meshgrid(x, y))
    assert data["reflectance"].dims == ("frame", "band", "y", "x")
    for name in made.SHOTS:
        found = data["reflectance"].sel(frame=name).values
        error = found / expected - 1.0
        assert np.abs(error).max() < 0.05, name
        assert abs(error.mean()) < 0.002, name
    with rasterio.open(tmp_path / "out" / "DJI_0002.tif") as file:
        np.testing.assert_allclose(
            file.read()[:, ::-1], data["reflectance"].sel(frame="DJI_0002.TIF").values, rtol=1e-6
        )
        assert file.crs.to_epsg() == 32734
        assert file.bounds.left == pytest.approx(ORIGIN[0])
        assert file.bounds.bottom == pytest.approx(ORIGIN[1])
    assert data["view_zenith"].attrs["standard_name"] == "sensor_zenith_angle"


def test_a_ground_pixel_is_the_mean_of_what_the_picture_has_in_it(flight, tmp_path):
    """Of pixels of half a metre, some twenty of the picture each."""
    laid(flight, tmp_path, pixel=0.5)
    data = xr.load_dataset(tmp_path / "out" / "frames.nc")
    fine = (np.arange(200) + 0.5) * 0.01
    whole = pictures.ground(*np.meshgrid(fine, fine)).reshape(4, 4, 50, 4, 50).mean(axis=(2, 4))
    np.testing.assert_allclose(data["reflectance"].values[0], whole, rtol=0.015)


def test_four_exports_of_one_flight_give_one_picture(flight, tmp_path):
    """Poses of each, to what a fit compares: the same pixels and the same statistics."""
    found = []
    writers = made.write_odm, made.write_pix4d, made.write_metashape, made.write_dji_pictures
    for k, write in enumerate(writers):
        folder = tmp_path / str(k)
        write(folder / "poses")
        plot, _ = laid(flight, folder, poses=folder / "poses")
        plot.write_text(plot.read_text() + '\n[[target]]\nfile = "out/frames.nc"\n')
        problem = read_problem(plot, free=["species.*.cover"])
        found.append((xr.load_dataset(folder / "out" / "frames.nc"), problem))
    (first, known), *others = found
    assert len(known.data.names) > 100
    for data, problem in others:
        np.testing.assert_allclose(data["reflectance"], first["reflectance"], rtol=2e-3)
        assert problem.data.names == known.data.names
        np.testing.assert_allclose(problem.data.value, known.data.value, rtol=2e-3, atol=2e-4)
        for view, other in zip(problem.views, known.views, strict=True):
            np.testing.assert_array_equal(view.camera.seen, other.camera.seen)
            pose, there = (v.camera.sensor.camera.position for v in (view, other))
            np.testing.assert_allclose(pose, there, atol=0.02)

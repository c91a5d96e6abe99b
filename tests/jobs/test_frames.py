"""`frames`: which frames of a flight see a plot, against projections made by hand."""

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from rasterio import Affine

from fynjax import jobs
from fynjax._core.errors import InputError
from fynjax.sensors import shipped_sensor
from tests.helpers import write_raster
from tests.io import frame_files as made
from tests.io.frame_files import CRS, GROUND, ORIGIN
from tests.small import write_plot

PLACE = {"crs": CRS, "origin": ORIGIN, "ground": GROUND}


def test_pixels_of_the_plot_lie_where_each_frame_has_them(tmp_path):
    flight = made.write_metashape(tmp_path / "flight")
    out = tmp_path / "out"
    result = jobs.frames(flight, out, plot=write_plot(tmp_path), pixel=0.5, **PLACE)
    assert (result.flight.frames, result.flight.seeing, result.flight.fewest_frames) == (3, 3, 3)
    data = xr.load_dataset(out / "frames.nc")
    assert list(data["frame"].values) == list(made.SHOTS)
    np.testing.assert_allclose(data["x"], ORIGIN[0] + np.arange(0.25, 2.0, 0.5))
    assert "32734" in data["crs"].attrs["crs_wkt"]
    y, x = np.meshgrid(*[np.arange(0.25, 2.0, 0.5)] * 2, indexing="ij")
    points = np.stack([x.ravel(), y.ravel(), np.zeros(16)], axis=1)
    table = pd.read_csv(out / "frames.csv").set_index("frame")
    for name, (place, _) in made.SHOTS.items():
        one = data.sel(frame=name)
        pixels = np.stack([one["column"].values.ravel(), one["row"].values.ravel()], axis=1)
        np.testing.assert_allclose(pixels, made.truth(name, points), atol=0.02)
        away = np.array(place) - points
        zenith = np.degrees(np.arctan2(np.hypot(away[:, 0], away[:, 1]), away[:, 2]))
        azimuth = np.degrees(np.arctan2(away[:, 0], away[:, 1])) % 360
        np.testing.assert_allclose(one["view_zenith"].values.ravel(), zenith, atol=0.02)
        np.testing.assert_allclose(one["view_azimuth"].values.ravel(), azimuth, atol=0.1)
        assert zenith.min() < table.loc[name, "view_zenith_deg"] < zenith.max()
    assert result.flight.largest_zenith_deg == pytest.approx(float(data["view_zenith"].max()))
    assert (out / "frames.png").is_file()


def test_what_lies_beyond_a_frame_is_not_seen_by_it(tmp_path):
    """Cut to its left half, the nadir frame ends two columns right of that of its axis."""
    flight = made.write_pix4d(tmp_path / "flight")
    for file in (tmp_path / "flight").glob("*camera_parameters.txt"):
        file.write_text(file.read_text().replace("400 300", "206 300"))
    plot = write_plot(tmp_path)
    plot.write_text(plot.read_text().replace("size_m = 2.0", "size_m = 4.0"))
    out = tmp_path / "out"
    result = jobs.frames(flight, out, plot=plot, pixel=0.5, **PLACE)
    data = xr.load_dataset(out / "frames.nc")
    nadir = data["seen"].sel(frame="DJI_0001.TIF").values
    # Its axis meets the ground 2 m east: the west half of the plot is left of it.
    expected = np.zeros((8, 8), bool)
    expected[:, :4] = True
    np.testing.assert_array_equal(nadir, expected)
    for name in ("column", "row", "view_zenith", "view_azimuth"):
        layer = data[name].sel(frame="DJI_0001.TIF").values
        np.testing.assert_array_equal(np.isfinite(layer), expected)
    count = data["seen"].values.sum(axis=0)
    np.testing.assert_array_equal(data["frames_per_pixel"], count)
    assert (result.flight.fewest_frames, result.flight.most_frames) == (count.min(), count.max())
    table = pd.read_csv(out / "frames.csv").set_index("frame")
    assert table.loc["DJI_0001.TIF", "seen"] == 0.5
    assert 270 > table.loc["DJI_0001.TIF", "view_azimuth_deg"] > 0


def test_a_map_of_terrain_says_where_the_plot_lies(tmp_path):
    """A slope of 1 in 2 to the east: pixels are where their own ground is."""
    flight = made.write_odm(tmp_path / "flight")
    east = np.broadcast_to(np.arange(20) * 0.05 - 0.475, (20, 20))
    write_raster(
        tmp_path / "terrain.tif", (GROUND + east)[None].astype(np.float32), crs=CRS,
        transform=Affine(0.1, 0, ORIGIN[0], 0, -0.1, ORIGIN[1] + 2.0),
    )  # fmt: skip
    plot = write_plot(tmp_path)
    plot.write_text(plot.read_text() + 'terrain = "terrain.tif"\nboundary = "open"\n')
    jobs.frames(flight, tmp_path / "out", plot=plot, pixel=0.5)
    data = xr.load_dataset(tmp_path / "out" / "frames.nc").sel(frame="DJI_0003.TIF")
    assert "32734" in data["crs"].attrs["crs_wkt"]
    x = np.array([0.25, 0.75, 1.25, 1.75])
    points = np.stack([x, np.full(4, 0.75), 0.5 * (x - 1.0)], axis=1)
    pixels = np.stack([data["column"].values[1], data["row"].values[1]], axis=1)
    np.testing.assert_allclose(pixels, made.truth("DJI_0003.TIF", points), atol=0.03)


def test_a_frame_without_a_lens_has_that_of_the_plots_sensor(tmp_path):
    (tmp_path / "flight").mkdir()
    longitude, latitude, _ = made.geographic((1.0, 1.0, 0.0))
    made.write_picture(
        tmp_path / "flight" / "DJI_0001.TIF",
        f'xmlns:drone-dji="http://www.dji.com/drone-dji/1.0/" drone-dji:GimbalYawDegree="0" '
        f'drone-dji:GimbalPitchDegree="-90" drone-dji:GimbalRollDegree="0" '
        f'drone-dji:GpsLatitude="{latitude}" drone-dji:GpsLongitude="{longitude}" '
        'drone-dji:RelativeAltitude="30"',
    )
    plot, where = write_plot(tmp_path), {"crs": CRS, "origin": ORIGIN, "pixel": 0.5}
    jobs.frames(tmp_path / "flight", tmp_path / "out", plot=plot, **where)
    column = xr.load_dataset(tmp_path / "out" / "frames.nc")["column"].values[0, 0]
    pixel = float(shipped_sensor("mavic_3m").ground_sample_distance(30.0))
    np.testing.assert_allclose(np.diff(column), 0.5 / pixel, rtol=2e-3)
    plot.write_text(plot.read_text() + '[sensor]\nname = "aviris_ng"\n')
    with pytest.raises(InputError, match=r"plot.toml: expected a lens of DJI_0001.TIF"):
        jobs.frames(tmp_path / "flight", tmp_path / "out2", plot=plot, **where)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            {"origin": (ORIGIN[0] + 500.0, ORIGIN[1])},
            r"none of 3 does: DJI_0001.TIF at -498 m east",
        ),
        ({"pixel": 3.0}, "a positive `pixel`.*2 x 2 m has room for, but got 3 m"),
        ({"pixel": 0.0}, "a positive `pixel`"),
        ({"pixel": 1e-4}, "take a larger `pixel`"),
        ({"ground": None}, "expected `ground`"),
    ],
)
def test_a_flight_that_cannot_be_used_is_refused(tmp_path, change, message):
    flight = made.write_odm(tmp_path / "flight")
    with pytest.raises(InputError, match=message):
        jobs.frames(flight, tmp_path / "out", plot=write_plot(tmp_path), **PLACE | change)

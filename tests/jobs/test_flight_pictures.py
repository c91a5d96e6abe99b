"""Pictures of a flight laid on the ground, and fitted: against a ground that is a formula."""

import json

import numpy as np
import pandas as pd
import pyproj
import pytest
import rasterio
import xarray as xr

from fynjax import jobs
from fynjax._core.errors import InputError
from fynjax.app.assembly import read_problem
from fynjax.app.io.frames import PICTURE_TAG, TIME_TAG
from fynjax.app.io.raster import write_geotiff
from fynjax.metrics import BANDS
from fynjax.sensors import sun_position
from tests.io import flight_pictures as pictures
from tests.io import frame_files as made
from tests.io.dji_files import (
    FOCAL,
    MAVIC,
    OFF_CENTRE,
    OPTICAL_CENTRE,
    PHANTOM,
    SCALE,
    frame_place,
    write_dji,
)
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


def test_what_a_picture_does_not_show_is_missing_in_data_and_model(flight, tmp_path):
    """A hole in one picture, and another cut at its left half, as its tag says."""
    images = tmp_path / "images"
    pictures.write_pictures(images)
    with rasterio.open(images / "DJI_0001_reflectance.tif", "r+") as file:
        values = file.read()
        values[:, 140:160, 190:210] = np.nan  # around the axis, 2 m east and 3 m north
        file.write(values)
    with rasterio.open(images / "DJI_0003_reflectance.tif") as file:
        values, profile = file.read(), file.profile
    row, column = 100, 150
    profile |= {"width": 400 - column, "height": 300 - row}
    with rasterio.open(images / "DJI_0003_reflectance.tif", "w", **profile) as file:
        file.write(values[:, row:, column:])
        file.descriptions = ("green", "red", "red_edge", "nir")
        where = {"size": [400, 300], "corner": [column, row]}
        file.update_tags(**{PICTURE_TAG: json.dumps(where)})
    plot, _ = laid(flight, tmp_path, images=images)
    data = xr.load_dataset(tmp_path / "out" / "frames.nc")
    whole = tmp_path / "whole"
    whole.mkdir()
    laid(flight, whole)
    known = xr.load_dataset(whole / "out" / "frames.nc")
    found, expected = data["reflectance"].values, known["reflectance"].values
    hole = ~np.isfinite(found[0, 0])
    assert 0 < hole.sum() < 250
    assert hole[-1, -1] or hole[:, -1].any()  # east
    for k in range(3):
        there = np.isfinite(found[k])
        np.testing.assert_allclose(found[k][there], expected[k][there], rtol=1e-6)
    np.testing.assert_array_equal(np.isfinite(data["view_zenith"].values[0]), ~hole)
    plot.write_text(plot.read_text() + '\n[[target]]\nfile = "out/frames.nc"\n')
    problem = read_problem(plot, free=["species.*.cover"])
    for view, image in zip(problem.views, found, strict=True):
        np.testing.assert_array_equal(view.camera.seen, np.isfinite(image[0]))
    value = dict(zip(problem.data.names, np.asarray(problem.data.value), strict=True))
    assert value["DJI_0001_reflectance".removesuffix("_reflectance") + ".nir.mean"] == (
        pytest.approx(np.nanmean(found[0, 3]), rel=1e-6)
    )


def textured(x, y):
    """Reflectance of a ground that bands can be aligned by, the same in all bands."""
    waves = ((1.3, 0.2, 1.7), (0.9, 1.1, 0.4), (2.3, -0.7, 2.1), (1.7, 1.5, 0.9))
    return 0.3 + sum(0.04 * np.sin(2 * np.pi * (c * x + s * y) / w + c) for w, c, s in waves)


@pytest.mark.filterwarnings("ignore:.*right up to one factor")
@pytest.mark.parametrize("bands", [MAVIC, PHANTOM])
def test_raw_pictures_of_a_dji_come_to_lie_where_their_ground_is(tmp_path, bands):
    """From counts by way of each lens and the maker's matrix or shift, which move bands by several
    pixels (of 7 cm): with the pose of the band that the others are laid on."""
    pytest.importorskip("skimage", reason="needs the extra `analysis`")
    raw, name = tmp_path / "raw", "DJI_20261122100000_0001" if bands is MAVIC else "DJI_001"
    raw.mkdir()
    longitude, latitude, _ = made.geographic((1.2, 0.8, 0.0))
    convergence = pyproj.Proj(CRS).get_factors(longitude, latitude).meridian_convergence
    middle, scenes = np.add(OPTICAL_CENTRE, OFF_CENTRE), []
    for band in bands:
        column, row = frame_place(band, distorted=True)
        right, down = (column - middle[0]) / FOCAL[0], (row - middle[1]) / FOCAL[1]
        c, s = np.cos(np.radians(30.0)), np.sin(np.radians(30.0))
        scenes.append(
            textured(1.2 + 10 * (c * right - s * down), 0.8 - 10 * (s * right + c * down))
        )
    fix = {
        "GpsLatitude": latitude, "GpsLongtitude": longitude, "RelativeAltitude": "+10.0",
        "GimbalYawDegree": 30.0 + convergence, "GimbalPitchDegree": "-90", "GimbalRollDegree": "0",
    }  # fmt: skip
    write_dji(raw, name, scenes, bands, lens=True, more=fix)
    jobs.reflectance(raw, tmp_path / "images", own_pixels=True)
    place = {"crs": CRS, "origin": ORIGIN, "pixel": 0.1}
    plot = write_plot(tmp_path)
    jobs.frames(raw, tmp_path / "out", plot=plot, images=tmp_path / "images", **place)
    data = xr.load_dataset(tmp_path / "out" / "frames.nc")
    (frame,) = data["frame"].values
    assert frame.endswith("_MS_NIR.TIF" if bands is MAVIC else "5.TIF")
    x, y = data["x"].values - ORIGIN[0], data["y"].values - ORIGIN[1]
    expected = textured(*np.meshgrid(x, y))
    found = data["reflectance"].values[0] * SCALE / np.pi
    assert np.corrcoef(found[-1].ravel(), expected.ravel())[0, 1] > 0.99
    for values in found:
        error = values / expected - 1.0
        assert np.sqrt(np.mean(error**2)) < 0.03
    # Column and row are those of the raw picture.
    at = np.stack([data["column"].values[0], data["row"].values[0]], axis=-1)[5, 7]
    raw_ground = scenes[-1][tuple(np.rint(at[::-1]).astype(int))]
    assert raw_ground == pytest.approx(expected[5, 7], abs=0.02)


def test_each_frame_has_the_sun_of_its_time(flight, tmp_path):
    """Two frames a minute apart share their mean sun; one three hours later has its own."""
    times = "2026:11:22 09:00:00", "2026:11:22 09:01:00", "2026-11-22T14:00:00+02:00"
    images = tmp_path / "images"
    pictures.write_pictures(images, tags=[{TIME_TAG: time} for time in times])
    plot, result = laid(flight, tmp_path, images=images)
    assert result.flight.suns == 2
    table = pd.read_csv(tmp_path / "out" / "frames.csv")
    longitude, latitude, _ = made.geographic((0.0, 0.0, 0.0))
    at = [sun_position(latitude, longitude, f"2026-11-22T{t}Z") for t in ("09:00:30", "12:00:00")]
    turn = pyproj.Proj(CRS).get_factors(longitude, latitude).meridian_convergence
    assert turn > 1.4
    for k, sun in ((0, at[0]), (1, at[0]), (2, at[1])):
        assert table["sun_zenith_deg"][k] == pytest.approx(float(sun.zenith), abs=0.15)
        # The sun's azimuth is from true north, that of the plot's angles from its grid's.
        assert table["sun_azimuth_deg"][k] == pytest.approx(float(sun.azimuth) - turn, abs=0.3)
    assert table["sun_zenith_deg"][0] == table["sun_zenith_deg"][1]
    more = '\n[[target]]\nfile = "out/frames.nc"\nview = "noon"\n'
    text = plot.read_text()
    plot.write_text(text + more)
    views = read_problem(plot, free=["species.*.cover"]).views
    assert [view.view for view in views] == [f"noon_DJI_000{k}" for k in (1, 2, 3)]
    assert views[0].sun == views[1].sun != views[2].sun
    stated = table.loc[0, ["sun_zenith_deg", "sun_azimuth_deg"]].tolist()
    assert views[0].sun == pytest.approx(stated, rel=1e-5)
    # What the plot file states of this view counts instead.
    plot.write_text(text + more + "sun = {zenith_deg = 60, azimuth_deg = 300}\n")
    views = read_problem(plot, free=["species.*.cover"]).views
    assert {view.sun for view in views} == {(60.0, 300.0)}


def test_a_cap_keeps_frames_whose_angles_differ_most(flight, tmp_path):
    """Of one straight down and two from opposite sides the first says least beside the others."""
    _, result = laid(flight, tmp_path, most=2)
    assert result.flight.used == ["DJI_0002.TIF", "DJI_0003.TIF"]
    assert result.flight.left_out == ["DJI_0001.TIF"]
    table = pd.read_csv(tmp_path / "out" / "frames.csv")
    assert list(table["used"]) == ["left out", "yes", "yes"]
    assert "DJI_0001.TIF" in " ".join(result.headline)
    data = xr.load_dataset(tmp_path / "out" / "frames.nc")
    assert list(data["frame"].values) == result.flight.used


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda folder: [path.unlink() for path in folder.glob("*")], "has no GeoTIFF"),
        (lambda folder: [path.rename(folder / f"other{k}.tif") for k, path in
                         enumerate(sorted(folder.glob("*")))], "named after those of the flight"),
        (lambda folder: _rewrite(folder, 1, lambda v, p: (v[:, 5:], p | {"height": 295})),
         "400 x 300 pixels, as the lens of DJI_0001.TIF has, but got 400 x 295"),
        (lambda folder: _rewrite(folder, 1, lambda v, p: (v, p | {"crs": CRS})), "laid on a map"),
        (lambda folder: _rewrite(folder, 1, lambda v, p: (9000.0 * v, p)), "reflectance"),
        (lambda folder: (folder / "DJI_0001_reflectance.tif").write_bytes(b"II*"), "DJI_0001"),
    ],
)  # fmt: skip
def test_pictures_that_cannot_be_used_are_refused(flight, tmp_path, change, message):
    images = tmp_path / "images"
    pictures.write_pictures(images, names=["DJI_0001.TIF"])
    change(images)
    with pytest.raises(InputError, match=message) as caught:
        laid(flight, tmp_path, images=images)
    assert "\n" not in str(caught.value)
    with pytest.raises(InputError, match="expected `images`"):
        jobs.frames(flight / "odm", tmp_path / "o", plot=write_plot(tmp_path), most=2, **PLACE)


def test_pictures_that_cannot_be_used_are_skipped(flight, tmp_path):
    """The others are laid, and the cap has another in their place; where none is left, the error
    names all."""
    images = tmp_path / "images"
    pictures.write_pictures(images)
    broken = images / "DJI_0002_reflectance.tif"
    whole = broken.read_bytes()
    broken.write_bytes(b"II*")
    _, result = laid(flight, tmp_path, images=images)
    assert result.flight.used == ["DJI_0001.TIF", "DJI_0003.TIF"]
    assert result.flight.skipped == ["DJI_0002.TIF"]
    assert any("Skipped, since they cannot be used: 1" in line for line in result.headline)
    assert result.warnings[0].startswith("DJI_0002.TIF is skipped: ")
    table = pd.read_csv(tmp_path / "out" / "frames.csv")
    assert list(table["used"]) == ["yes", "skipped", "yes"]
    assert list(xr.load_dataset(tmp_path / "out" / "frames.nc")["frame"].values) == (
        result.flight.used
    )
    # One that opens, but has counts in it: chosen beside the third as the first would not be.
    broken.write_bytes(whole)
    _rewrite(images, 2, lambda v, p: (9000.0 * v, p))
    _, result = laid(flight, tmp_path, images=images, most=2)
    assert (result.flight.used, result.flight.left_out) == (["DJI_0001.TIF", "DJI_0003.TIF"], [])
    # Of other bands than most have.
    broken.write_bytes(whole)
    for number in (1, 3):
        values = pictures.picture(f"DJI_000{number}.TIF")[:, ::-1]
        write_geotiff(
            images / f"DJI_000{number}_reflectance.tif", np.concatenate([values, 0.5 * values[:1]]),
            [*BANDS, "blue"], pixel_m=1.0, wavelengths=[*pictures.WAVES, 450.0],
        )  # fmt: skip
    plot = write_plot(tmp_path, '\n[sensor]\nname = "phantom_4m"\n')
    result = jobs.frames(flight / "odm", tmp_path / "five", plot=plot, images=images, **PLACE)
    assert result.flight.skipped == ["DJI_0002.TIF"]
    assert "as most pictures have" in result.warnings[0]
    for path in images.glob("*"):
        path.write_bytes(b"II*")
    named = r"none of 3 can \(DJI_0001.TIF, DJI_0002.TIF, DJI_0003.TIF\). The first: .*DJI_0001"
    with pytest.raises(InputError, match=named) as caught:
        laid(flight, tmp_path, images=images)
    assert "\n" not in str(caught.value)


def _rewrite(folder, number, change):
    path = folder / f"DJI_000{number}_reflectance.tif"
    with rasterio.open(path) as file:
        values, profile, names = file.read(), dict(file.profile), file.descriptions
    values, profile = change(values, profile)
    with rasterio.open(path, "w", **profile) as file:
        file.write(values)
        file.descriptions = names


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda data: data.drop_vars("reflectance"), "--images FOLDER"),
        (lambda data: data.drop_vars("roll"), "'roll' is missing"),
        (lambda data: data.assign(yaw=data["yaw"] * np.nan), "a pose of each frame"),
        (lambda data: data.assign_attrs(pixel_m=-1.0), "positive size of a pixel"),
        (lambda data: data.isel(x=slice(0, 5)), "pixels of 0.1 m, but got 5 x 20"),
        (lambda data: data.assign(reflectance=data["reflectance"] * np.nan), "all are missing"),
        (lambda data: data.assign(lens=("frame", ["{"] * 3)), "lens of DJI_0001.TIF as JSON"),
        (lambda data: data.assign_coords(band=["a", "b", "c", "d"]), "bands of"),
        (lambda data: data.assign(yaw=data["yaw"].mean()), "'yaw' by frame"),
        (lambda data: data.isel(y=slice(None, None, -1)), "y from south to north"),
        (lambda data: data.assign(reflectance=data["reflectance"] * 100.0), "In percent"),
        (lambda data: data.assign(solar_zenith=data["camera_height"] * 0.0 + 95.0),
         "sun of DJI_0001.TIF at most"),
        (lambda data: data.assign(camera_height=-data["camera_height"]),
         "DJI_0001.TIF above the ground"),
    ],
)  # fmt: skip
def test_damaged_frames_end_in_one_line(flight, tmp_path, change, message):
    plot, _ = laid(flight, tmp_path)
    path = tmp_path / "out" / "frames.nc"
    data = change(xr.load_dataset(path))
    path.unlink()
    data.to_netcdf(path)
    plot.write_text(plot.read_text() + '\n[[target]]\nfile = "out/frames.nc"\n')
    with pytest.raises(InputError, match=message) as caught:
        read_problem(plot, free=["species.*.cover"])
    assert caught.value.file == path
    assert "\n" not in str(caught.value)


def test_frames_have_their_own_places(flight, tmp_path):
    plot, _ = laid(flight, tmp_path)
    more = '\n[[target]]\nfile = "out/frames.nc"\nposition_m = [1, 1, 30]\n'
    plot.write_text(plot.read_text() + more)
    with pytest.raises(InputError, match="no position_m"):
        read_problem(plot, free=["species.*.cover"])


def test_frames_are_validated_one_by_one(flight, tmp_path):
    """Against the plot itself, simulated here frame by frame."""
    import fynjax as fx
    from fynjax.app.assembly import build_plot
    from fynjax.app.io.frames import read_frame_stack
    from fynjax.app.io.plot import read_plot

    plot, _ = laid(flight, tmp_path)
    real = tmp_path / "out" / "frames.nc"
    data = jobs.ValidationData(real_drone=real, simulated_drone=plot)
    result = jobs.validate(data, tmp_path / "validation")
    table = pd.read_csv(tmp_path / "validation" / "drone_frames.csv")
    assert list(dict.fromkeys(table["frame"])) == list(made.SHOTS)
    scene, parameters = build_plot(read_plot(plot), seed=0, rounding="up")
    stack = read_frame_stack(real)
    for k, frame in enumerate(stack.frames):
        own = fx.observe(scene, "mavic_3m", parameters=parameters, pixel=0.1, pose=frame)
        rows = table[table["frame"] == frame.name].set_index("band")
        for i, band in enumerate(stack.bands):
            found = np.asarray(own[band])[stack.seen[k]].mean()
            assert rows.loc[band, "simulated_mean"] == pytest.approx(found, rel=2e-3)
            known = stack.reflectance[k, i][stack.seen[k]].mean()
            assert rows.loc[band, "real_mean"] == pytest.approx(known, rel=1e-6)
    assert result.drone.frames is not None
    assert "frames the difference of a mean changes" in " ".join(result.headline)
    with pytest.raises(InputError, match="no saturation, pixels or names of bands with frames"):
        jobs.validate(data, tmp_path / "no", saturation=0.9)
    with pytest.raises(InputError, match="the plot file that the frames are simulated by"):
        jobs.validate(jobs.ValidationData(real_drone=real, simulated_drone=real), tmp_path / "no")


def test_one_frame_is_compared_with_no_other(flight, tmp_path):
    plot, _ = laid(flight, tmp_path, most=1)
    data = jobs.ValidationData(real_drone=tmp_path / "out" / "frames.nc", simulated_drone=plot)
    result = jobs.validate(data, tmp_path / "validation")
    assert not any(line.startswith("Between") for line in result.headline)

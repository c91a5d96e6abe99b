"""Raw pictures of DJI's multispectral cameras: radiometry, lenses, names, and what is refused."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from scipy.ndimage import map_coordinates

from fynjax._core.errors import InputError
from fynjax.app.io.captures import aligned_radiance, find_captures, read_capture, usable_captures
from fynjax.app.io.captures._band import Stated
from fynjax.app.io.captures._dji import dji_band
from fynjax.app.io.captures._metadata import read_band
from fynjax.app.io.raster import open_raster
from tests.io.dji_files import MAVIC, PHANTOM, SCALE, SHAPE, Band, frame_place, write_dji

NAME = "DJI_20261122100000_0001"


def scene(column: np.ndarray, row: np.ndarray) -> np.ndarray:
    """A reflectance that is smooth over pixels, so that interpolation shows it, and everywhere
    another."""
    waves = np.sin(column / 4.3 + 0.3 * np.sin(row / 9.0)) + np.cos(row / 5.1 + column / 17.0)
    return 0.25 + 0.06 * waves + 0.05 * np.sin((column + row) / 3.7)


def seen(bands: tuple[Band, ...], *, distorted: bool) -> list[np.ndarray]:
    return [scene(*frame_place(band, distorted=distorted)) for band in bands]


@pytest.mark.parametrize(("bands", "black"), [(MAVIC, 3200), (PHANTOM, 4096)])
def test_counts_become_the_signal_over_the_light(bands, black, tmp_path: Path) -> None:
    """Dark level, gain, exposure, adjustment, vignetting and light, different in every band."""
    rho = scene(*np.indices(SHAPE)[::-1].astype(float))
    name = NAME if bands is MAVIC else "DJI_001"
    found = find_captures(
        [write_dji(tmp_path, name, [rho] * len(bands), bands, black=black)[0].parent]
    )
    capture = read_capture(*next(iter(found.items())))
    assert capture.names == tuple(band.name for band in bands)
    assert [b.wavelength for b in capture.bands] == [band.centre for band in bands]
    assert [b.fwhm for b in capture.bands] == [2 * band.half for band in bands]
    assert not capture.absolute
    relative = capture.radiance() / capture.irradiance[:, None, None] * SCALE
    np.testing.assert_allclose(relative, np.broadcast_to(rho, relative.shape), rtol=2e-3)
    first = capture.bands[0]
    assert (first.capture, first.time) == (f"id of {name}", "2026:11:22 10:00:00.123")
    assert first.utc == first.time
    assert first.sensor == ("mavic_3m" if bands is MAVIC else "phantom_4m")
    assert first.focal_length == 135.0
    assert first.irradiance_tilt == pytest.approx(5.0, abs=0.01)


def test_the_black_level_of_a_phantom_is_a_tag_of_its_tiff(tmp_path: Path) -> None:
    rho = [np.full(SHAPE, 0.3)] * 5
    paths = write_dji(tmp_path, "DJI_001", rho, PHANTOM, black=4096, black_in_tiff=True)
    assert float(read_band(paths[0]).camera.black_level) == 4096.0
    paths = write_dji(tmp_path, "DJI_002", rho, PHANTOM, change=lambda t: t.replace("BlackC", "C"))
    with pytest.raises(InputError, match="'BlackCurrent', but it has none"):
        read_band(paths[0])


@pytest.mark.parametrize(("bands", "name"), [(MAVIC, NAME), (PHANTOM, "DJI_001")])
def test_bands_lie_on_each_other_by_the_calibration_of_their_lenses(
    bands, name, tmp_path: Path
) -> None:
    """Distortion, and the homography of a Mavic or the disparity of a Phantom, without a look at
    the picture; and with it on top."""
    from fynjax.app.io.captures._capture import _on_frame

    paths = write_dji(tmp_path, name, seen(bands, distorted=True), bands, lens=True)
    capture = read_capture(name, paths)
    relative = capture.radiance() / capture.irradiance[:, None, None] * SCALE
    raw_miss = np.abs(relative - relative[-1]).max(axis=(1, 2))[:-1]
    assert (raw_miss > 0.05).all()
    counts, lens = capture.bands[0].counts, capture.bands[0].registration
    np.testing.assert_allclose(lens.on_frame(counts), lens.on_frame(counts.astype(float)))
    (placed,), (low, left) = _on_frame(capture, relative[:, ::-1])
    rows, columns = placed.shape[1:]
    assert rows * columns > 0.7 * relative[0].size
    row, column = np.mgrid[SHAPE[0] - low - rows : SHAPE[0] - low, left : left + columns]
    truth = scene(column.astype(float), row.astype(float))[::-1]
    # Bilinear interpolation cuts the crests of waves of 23 pixels by some 0.004.
    np.testing.assert_allclose(placed, np.broadcast_to(truth, placed.shape), atol=0.008)
    aligned = aligned_radiance(capture)
    assert aligned.alignment is not None
    assert max(np.hypot(*band.shift) for band in aligned.alignment) < 0.3
    assert not aligned.full.any()
    at = map_coordinates(aligned.radiance[0], np.array(aligned.middle[::-1])[:, None], order=1)[0]
    at *= SCALE / bands[0].light
    middle = [np.array([0.5 * (size - 1)]) for size in SHAPE[::-1]]
    assert at == pytest.approx(scene(*middle)[0], abs=0.008)


def test_a_calibration_that_shows_other_ground_is_refused(tmp_path: Path) -> None:
    paths = write_dji(
        tmp_path, NAME, seen(MAVIC, distorted=True), lens=True,
        change=lambda t: t.replace('HMatrix="1.0,0.0,0.0', 'HMatrix="1.0,0.0,99'),
    )  # fmt: skip
    with pytest.raises(InputError, match="bands show different ground"):
        aligned_radiance(read_capture(NAME, paths))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda t: t.replace('SensorGain="', 'Other="'), "expected metadata .* 'SensorGain'"),
        (lambda t: t.replace("SensorGainAdj", "Adj"), "'SensorGainAdjustment'"),
        (lambda t: t.replace('ExposureTime="732"', 'ExposureTime="0"'), "a positive exposure"),
        (lambda t: t.replace('Current="3200"', 'Current="65000"'), "black level, below the counts"),
        (lambda t: t.replace('Current="3200"', 'Current="3,2"'), "one black level, but got 3, 2"),
        (lambda t: t.replace("2026-01-01;135.0,", "2026-01-01;"), "nine numbers as 'DewarpData'"),
        (lambda t: t.replace("2.1e-04", "x").replace("0.00021", "x"), "6 numbers as 'Vignetting"),
        (lambda t: t.replace("CalibratedOpticalCenterY", "Y"), "'CalibratedOpticalCenterY'"),
        (lambda t: t.replace('HMatrix="', 'HMatrix="0,0,0,0,0,0,0,0,0" Camera:x="'), "invertible"),
    ],
)
def test_metadata_that_miss_something(
    change: Callable[[str], str], message: str, tmp_path: Path
) -> None:
    paths = write_dji(tmp_path, NAME, [np.full(SHAPE, 0.3)] * 4, lens=True, change=change)
    with pytest.raises(InputError, match=message) as caught:
        read_band(paths[0])
    assert caught.value.file == paths[0]


def test_other_names_for_the_vignetting(tmp_path: Path) -> None:
    """As Pix4D's part of the metadata has it, where DJI's own lacks it."""

    def renamed(text: str) -> str:
        text = text.replace('drone-dji:CalibratedOpticalCenterX="83.0"', "")
        text = text.replace("drone-dji:VignettingData", "Camera:VignettingPolynomial")
        return text.replace("Camera:Irr", 'Camera:VignettingCenter="83.0, 57.0" Camera:Irr')

    one, other = tmp_path / "one", tmp_path / "other"
    one.mkdir()
    other.mkdir()
    rho = [np.full(SHAPE, 0.3)] * 4
    first = read_band(write_dji(one, NAME, rho)[0])
    second = read_band(write_dji(other, NAME, rho, change=renamed)[0])
    np.testing.assert_allclose(second.camera.response(SHAPE), first.camera.response(SHAPE))


def test_what_a_camera_has_already_corrected_is_left(tmp_path: Path) -> None:
    paths = write_dji(
        tmp_path, NAME, [np.full(SHAPE, 0.3)] * 4, lens=True,
        change=lambda t: t.replace('DewarpFlag="0"', 'DewarpFlag="1" drone-dji:VignettingFlag="1"'),
    )  # fmt: skip
    band = read_band(paths[3])
    assert band.registration is None  # its homography is the identity
    np.testing.assert_array_equal(band.camera.response(SHAPE), 1.0)
    assert band.missing == ()


def test_captures_of_a_flight_by_their_names(tmp_path: Path) -> None:
    """A second may pass between the bands of a Mavic, whose numbers start anew with each flight."""
    rho = [np.full(SHAPE, 0.3)] * 4
    write_dji(tmp_path, NAME, rho)
    (tmp_path / f"{NAME}_MS_NIR.TIF").rename(tmp_path / "DJI_20261122100001_0001_MS_NIR.TIF")
    write_dji(tmp_path, "DJI_20261122113000_0001", rho)
    other_flight = tmp_path / "DJI_20261122140000_0002_MS_G.TIF"  # has one band of each flight
    write_dji(tmp_path, "DJI_20261122100002_0002", rho[:1], MAVIC[1:2])
    write_dji(tmp_path, "DJI_20261122140000_0002", rho[:1], MAVIC[:1])
    assert len(find_captures([tmp_path])) == 4
    other_flight.unlink()
    (tmp_path / "DJI_20261122100002_0002_MS_R.TIF").unlink()
    for other in ("DJI_20261122100000_0001_D.JPG", "notes.MRK"):
        (tmp_path / other).write_bytes(b"x")
    found = find_captures([tmp_path])
    assert list(found) == [NAME, "DJI_20261122113000_0001"]
    assert [path.name.rpartition("_")[2] for path in found[NAME]] == [
        "G.TIF", "R.TIF", "RE.TIF", "NIR.TIF"
    ]  # fmt: skip
    assert read_capture(NAME, found[NAME]).names == ("Green", "Red", "RedEdge", "NIR")


def test_strange_captures_are_found_before_the_work(tmp_path: Path) -> None:
    rho = [np.full(SHAPE, 0.3)] * 4
    for number in range(1, 7):
        write_dji(tmp_path, f"DJI_2026112210000{number}_000{number}", rho)
    (tmp_path / "DJI_20261122100002_0002_MS_R.TIF").unlink()
    cut = tmp_path / "DJI_20261122100003_0003_MS_NIR.TIF"
    cut.write_bytes(cut.read_bytes()[:9000])
    name = "DJI_20261122100004_0004"
    write_dji(
        tmp_path, name, rho, change=lambda t: t.replace('Irradiance="10038.8"', 'Irradiance="0"')
    )
    name, numbers = "DJI_20261122100005_0005", iter("1234")
    write_dji(tmp_path, name, rho, change=lambda t: t.replace("id of", next(numbers)))
    usable, skipped, dark = usable_captures(find_captures([tmp_path]))
    assert [name[-1] for name in usable] == ["1", "4", "6"]
    assert {name[-1]: str(error) for name, error in skipped.items()}.keys() == {"2", "3", "5"}
    assert "Red is missing" in str(skipped["DJI_20261122100002_0002"])
    assert "all files of one capture" in str(skipped["DJI_20261122100005_0005"])
    assert [name[-1] for name in dark] == ["4"]


@pytest.mark.parametrize("rename", ["flight1_{}", "2024-06-01 {}", "{}", "f1_{}.renamed", "P{}x"])
def test_a_phantom_is_known_whatever_its_files_are_called(tmp_path: Path, rename: str) -> None:
    """By DJI's numbers, a prefix before them or not, and else by what the pictures state."""
    rho = [np.full(SHAPE, 0.3)] * len(PHANTOM)
    for name in ("DJI_001", "DJI_002"):
        write_dji(tmp_path, name, rho, PHANTOM)
    for path in list(tmp_path.iterdir()):
        stem = rename.format(path.stem.removeprefix("DJI_") if "x" in rename else path.stem)
        path.rename(path.with_name(f"{stem}.TIF"))
    found = find_captures([tmp_path])
    assert [len(paths) for paths in found.values()] == [len(PHANTOM)] * 2
    for name, paths in found.items():
        assert read_capture(name, paths).names == tuple(band.name for band in PHANTOM)
    assert find_captures([path for paths in found.values() for path in paths]) == found


def test_a_prefix_is_known_where_pictures_state_no_capture(tmp_path: Path) -> None:
    rho = [np.full(SHAPE, 0.3)] * len(PHANTOM)
    for name in ("f1_DJI_001", "f1_DJI_002"):
        change = {"change": lambda text: text.replace("CaptureUUID", "Unused")}
        write_dji(tmp_path, name, rho, PHANTOM, **change)
    assert list(find_captures([tmp_path])) == ["f1_DJI_001", "f1_DJI_002"]


def test_a_mavic_may_have_a_prefix(tmp_path: Path) -> None:
    write_dji(tmp_path, f"flight2_{NAME}", [np.full(SHAPE, 0.3)] * 4)
    ((name, paths),) = find_captures([tmp_path]).items()
    assert read_capture(name, paths).names == ("Green", "Red", "RedEdge", "NIR")


def test_a_phantom_of_the_field_with_a_prefix(shared_data: Path) -> None:
    found = find_captures([shared_data / "field" / "29_p4m-files-with-a-prefix"])
    assert [len(paths) for paths in found.values()] == [5, 5]


def test_time_of_a_dji_without_utc_is_not_taken_for_it(tmp_path: Path) -> None:
    """EXIF has the time of where the drone flies."""
    path = write_dji(tmp_path, NAME, [np.full(SHAPE, 0.3)] * 4)[0]
    with open_raster(path, "a picture") as file:
        xmp, counts = dict(file.xmp), file.stored_band(1)
    del xmp["UTCAtExposure"]
    stated = Stated(xmp, {"EXIF_DateTimeOriginal": "2026:11:22 12:00:00"})
    band = dji_band(path, counts, 16, stated)
    assert (band.time, band.utc) == ("2026:11:22 12:00:00", "")

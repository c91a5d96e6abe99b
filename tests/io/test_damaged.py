"""Damaged files end in one error that names the file; nothing else comes up from the depths."""

import gzip
import os
import shutil
import struct
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import laspy
import netCDF4
import numpy as np
import pytest
import rasterio
from rasterio import Affine
from rasterio.crs import CRS

from fynjax._core.errors import InputError
from fynjax.app.cli import main
from fynjax.app.compare import read_drone_image, read_spectra_sample
from fynjax.app.io.captures import read_capture
from fynjax.app.io.instruments import load_lidar, load_sensor, read_atmosphere
from fynjax.app.io.plot import example_folder, read_plot, read_statistics, read_structure
from fynjax.app.io.raster import (
    _netcdf,
    parse_crs,
    read_band_stack,
    read_probability_map,
    write_geotiff,
)
from fynjax.app.io.spectra import read_spectra_file
from fynjax.app.io.text import NamedFile, Strict, read_toml
from fynjax.app.terrain import read_cloud, read_terrain
from fynjax.canopy import read_plant_mesh
from fynjax.sensors import sensor_folder
from tests.helpers import read_cube, unix


def drone_image(path: Path) -> Any:
    return read_drone_image(path)


def map_of_a_plot(path: Path) -> Any:
    return read_probability_map(path, (10.0, 10.0))


@pytest.mark.parametrize(
    ("name", "read"),
    [
        ("image-914-image.tif", drone_image),
        ("image-914-image.tif", lambda path: read_band_stack([path])),
        ("image-914-image.tif", read_cube),
        ("cubehdr-5-reflectance.hdr", read_cube),
        ("cubehdr-5-reflectance.hdr", lambda p: read_spectra_sample([p])),
        ("cubenc-2-product.nc", read_cube),
        ("rededge-18-IMG_0001_1.tif", lambda path: read_capture("IMG_0001", [path])),
        ("prob-631-prob.tif", map_of_a_plot),
        ("prob-631-prob.tif", read_terrain),
        ("crash-laz-47-cloud.laz", read_cloud),
        ("plymesh-47-mesh.ply", read_plant_mesh),
        ("plymesh-100-mesh.ply", read_plant_mesh),
        ("obj-140-plant.obj", read_plant_mesh),
        ("stats-207-statistics.csv", read_statistics),
        ("cr2.csv", read_atmosphere),
        ("envilib-254-lib.hdr", read_spectra_file),
        ("envilib-1169-lib.hdr", read_spectra_file),
        ("spectxt-18-ribb00001.asd.txt", read_spectra_file),
        ("lidar-63-scanning_lidar.toml", load_lidar),
        ("lidar-1304-flash_lidar_paper.toml", load_lidar),
        ("sensor-118-aviris_ng.toml", load_sensor),
        ("sensor-619-sentinel_2a.toml", load_sensor),
    ],
)
def test_a_damaged_file_is_named(shared_data: Path, name: str, read: Callable[[Path], Any]) -> None:
    with pytest.raises(InputError) as caught:
        read(shared_data / "damaged" / name)
    assert name in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_library_whose_header_took_44_seconds_is_read(shared_data: Path) -> None:
    spectra = read_spectra_file(shared_data / "damaged" / "envilib-214-lib.hdr")
    assert [spectrum.name for spectrum in spectra] == ["a", "b", "c"]


@pytest.mark.parametrize(("number", "missing"), [(96, 51), (897, 61)])
def test_numbers_that_no_instrument_gives_are_missing(shared_data, number, missing):
    """Infinite, or up to 1e286, also in the water bands, where noise may be of any size."""
    (spectrum,) = read_spectra_file(shared_data / "damaged" / f"asd-{number}-ribb00001.asd")
    values = spectrum.reflectance
    assert np.isnan(values).sum() == missing
    assert np.nanmax(np.abs(values)) < 1e4
    assert f"{missing} impossible values of reflectance set to missing" in spectrum.meta["repairs"]


@pytest.mark.parametrize(
    "read", [drone_image, lambda path: read_band_stack([path]), read_cube, read_terrain]
)
def test_an_image_of_more_pixels_than_its_file_can_hold(
    tmp_path: Path, read: Callable[[Path], Any]
) -> None:
    path = tmp_path / "sparse.tif"
    rasterio.open(
        path, "w", driver="GTiff", width=60_000, height=60_000, dtype="uint16",
        count=1 if read is read_terrain else 4, crs="EPSG:32734", sparse_ok=True, tiled=True,
        blockxsize=1024, blockysize=1024, transform=Affine(0.1, 0, 0, 0, -0.1, 0), bigtiff="yes",
    ).close()  # fmt: skip
    with pytest.raises(InputError, match="60000 x 60000 pixels"):
        read(path)


def test_lines_may_end_as_on_old_macs(shared_data: Path) -> None:
    structure = read_structure(shared_data / "damaged" / "structure-93-structure.csv")
    assert [row.metric for row in structure] == ["gap_fraction", "rugosity", "height_cv"]


def test_a_compressed_file_that_unfolds_to_too_much(tmp_path: Path) -> None:
    path = tmp_path / "leaf.csv.gz"
    with gzip.open(path, "wb", compresslevel=9) as file:
        for _ in range(513):
            file.write(bytes(1 << 20))
    assert path.stat().st_size < 1 << 20
    with pytest.raises(InputError, match=r"leaf\.csv\.gz: .* at most 512 MiB, but it unfolds to"):
        read_spectra_file(path)


@pytest.mark.parametrize("text", ["[" * 100_000, "a = " + "9" * 4301, "a = [1e400]"])
def test_toml_that_python_cannot_hold(tmp_path: Path, text: str) -> None:
    path = tmp_path / "own.toml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=r"own\.toml"):
        load_sensor(path)


def test_numbers_beyond_any_measurement(tmp_path: Path) -> None:
    path = tmp_path / "statistics.csv"
    path.write_text("statistic,value,sd\nNDVI.mean,1e400,0.1\n", encoding="utf-8")
    with pytest.raises(InputError, match=r"row 2, column 'value'"):
        read_statistics(path)
    path.write_text("statistic,value,sd\nNDVI.mean,1e266,0.1\n", encoding="utf-8")
    with pytest.raises(InputError, match=r"row 2.*expected value within 1e\+15"):
        read_statistics(path)


def test_impossible_values_of_an_image_are_missing(tmp_path: Path) -> None:
    values = np.full((1, 3, 4), 0.2, np.float32)
    values[0, 1, 2] = 3e38
    path = tmp_path / "image.tif"
    write_geotiff(path, values, ["red"], pixel_m=0.5, crs="EPSG:32734")
    with pytest.warns(UserWarning, match="image.tif: 1 of 12 values .* such as 3e\\+38"):
        cube = read_cube(path)
    assert np.isnan(cube.values).sum() == 1
    assert np.nanmax(cube.values) < 1.0


@unix
@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda path: path.symlink_to("gone.csv"), "a link to 'gone.csv', which is not there"),
        (lambda path: path.symlink_to(path.name), "a link that leads back to itself"),
        (os.mkfifo if hasattr(os, "mkfifo") else Path.mkdir, "a pipe|a folder"),
        (lambda path: (path.parent / "c.csv").touch(), "no such file. Did you mean 'c.csv'"),
    ],
)
def test_what_is_no_file_is_called_by_its_name(tmp_path: Path, make: Any, words: str) -> None:
    path = tmp_path / "b.csv"
    make(path)
    for read in (read_statistics, read_spectra_file, read_cloud):
        with pytest.raises(InputError, match=words):
            read(path)


class NamesTable(Strict):
    """A file that names another."""

    table: Annotated[Path, NamedFile("a table")]


@unix
@pytest.mark.parametrize(
    ("target", "words"),
    [("gone.csv", "a link to 'gone.csv', which is not there"), ("b.csv", "leads back to itself")],
)
def test_a_link_that_a_plot_file_names_is_called_a_link(
    tmp_path: Path, target: str, words: str
) -> None:
    owner = tmp_path / "plot.toml"
    (tmp_path / "b.csv").symlink_to(target)
    (tmp_path / "c.csv").touch()
    owner.write_text('table = "b.csv"\n', "utf-8")
    with pytest.raises(InputError, match=rf"line 1.*'b.csv': expected a table, but .*{words}"):
        read_toml(owner, NamesTable, within=tmp_path)


def test_a_name_that_no_file_can_have() -> None:
    for name, why in (("a" * 300 + ".csv", "at most 255 bytes"), ("a\0b.csv", r"be opened \(")):
        with pytest.raises(InputError, match=why):
            read_statistics(name)


def test_an_error_repeats_a_cell_and_no_page(tmp_path: Path) -> None:
    path = tmp_path / "statistics.csv"
    path.write_text(f"\x1b[2J{'a' * 5000},{','.join('bcdefgh' * 100)}\n1\n", encoding="utf-8")
    with pytest.raises(InputError) as caught:
        read_statistics(path)
    message = str(caught.value).removeprefix(str(path))
    assert message.isprintable()
    assert len(message) < 600


def test_a_netcdf_file_in_which_hdf5_goes_round_for_ever(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    over = threading.Event()

    def goes_round(path: Path) -> None:
        while not over.is_set():
            pass

    at_exit: list[Callable[[], None]] = []
    monkeypatch.setattr(netCDF4, "Dataset", goes_round)
    monkeypatch.setattr(_netcdf, "_OPENS_WITHIN", 0.1)
    monkeypatch.setattr(_netcdf.atexit, "register", at_exit.append)
    (tmp_path / "air.nc").touch()
    with pytest.raises(InputError, match=r"air\.nc: .* do not end"):
        read_atmosphere(tmp_path / "air.nc")
    over.set()
    assert at_exit == [_netcdf._leave]  # or the process would end in a segmentation fault


@unix
def test_a_plot_file_may_not_choose_files_elsewhere(tmp_path: Path) -> None:
    folder = shutil.copytree(example_folder(), tmp_path / "plot")
    path = folder / "plot.toml"
    (folder / "species.csv").rename(tmp_path / "species.csv")
    (folder / "leaves.csv").rename(tmp_path / "leaves.csv")
    (folder / "leaves.csv").symlink_to("../leaves.csv")  # a link leads outside too
    text = path.read_text("utf-8").replace('"species.csv"', '"../species.csv"')
    path.write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=r"'../species.csv': expected .*--allow-outside") as caught:
        read_plot(path)
    assert caught.value.column == "plot.species_table"
    (tmp_path / "species.csv").rename(folder / "species.csv")
    path.write_text(text.replace("../species.csv", "species.csv"), encoding="utf-8")
    with pytest.raises(InputError, match=r"'leaves.csv': expected .* folder or below"):
        read_plot(path)
    assert len(read_plot(path, allow_outside=True).species) == 13
    with pytest.raises(SystemExit) as end:
        main(["render", str(path), "--allow-outside", "--dry-run", "--quiet"])
    assert end.value.code == 0


def test_a_leaf_table_may_not_choose_files_elsewhere(tmp_path: Path) -> None:
    folder = shutil.copytree(example_folder(), tmp_path / "plot")
    (folder / "leaves.csv").write_text("taxon,spectrum\n*,../leaf.csv\n", "utf-8")
    (tmp_path / "leaf.csv").touch()
    with pytest.raises(InputError, match=r"row 2, column 'spectrum': '../leaf.csv': .*or below"):
        read_plot(folder / "plot.toml")
    plot = read_plot(folder / "plot.toml", allow_outside=True)
    assert plot.leaves[0].spectrum == (tmp_path / "leaf.csv").resolve()


def test_a_sensor_file_may_not_choose_files_elsewhere(tmp_path: Path) -> None:
    (tmp_path / "sub").mkdir()
    path = tmp_path / "sub" / "own.toml"
    text = (sensor_folder() / "emit.toml").read_text("utf-8")
    path.write_text(text.replace("emit_bands.csv", "../emit_bands.csv"), encoding="utf-8")
    shutil.copy(sensor_folder() / "emit_bands.csv", tmp_path)
    with pytest.raises(InputError, match="in this file's folder or below"):
        load_sensor(path)


def test_layers_of_a_laz_larger_than_the_file_are_refused_before_they_are_read(
    tmp_path: Path,
) -> None:
    las = laspy.create(point_format=6, file_version="1.4")
    las.x, las.y, las.z = np.arange(30.0).reshape(3, 10)
    path = tmp_path / "cloud.laz"
    las.write(path)
    assert read_cloud(path).x.size == 10
    data = bytearray(path.read_bytes())
    (start,) = struct.unpack_from("<I", data, 96)
    (size,) = struct.unpack_from("<H", data, 105)
    struct.pack_into("<I", data, start + 8 + size + 4, 0xFFFFFFF0)
    path.write_bytes(data)
    with pytest.raises(InputError, match="layers of points"):
        read_cloud(path)


def test_a_reference_system_that_cannot_be_written_is_not_known() -> None:
    text = CRS.from_epsg(32734).to_wkt().replace('UNIT["metre",1', 'UNIT["metre",0')
    with pytest.raises(InputError, match="expected a coordinate reference system"):
        parse_crs(text, Path("cloud.laz"))


_LONG = "a" * 200_000


@pytest.mark.parametrize(
    ("name", "content", "read", "expected"),
    [
        (
            "leaf.csv",
            f'wavelength_nm,"{_LONG}\n400,0.1\n'.encode(),
            read_spectra_file,
            "quotation mark",
        ),
        ("statistics.csv", f"statistic,value,sd\n{_LONG},1,1\n".encode(), read_statistics, "131"),
        ("statistics.csv", b"statistic,value,sd\nn\xe9,1,1\n", read_statistics, "row 2.*'né'"),
        ("cloud.csv", b"x,y,H\xf6he\n1,2,3\n", read_cloud, "row 1.*the header has x, y, Höhe"),
        ("cloud.csv", b"\xc3\xa9\nx,y,\xe9\n1,2,3\n", read_cloud, "row 2.*0xe9 .*CSV UTF-8"),
        ("own.toml", b"name = " + b"1" * 5000, load_sensor, "a number has thousands of digits"),
    ],
)
def test_errors_say_what_was_expected_and_the_likely_slip(tmp_path, name, content, read, expected):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(InputError, match=expected) as error:
        read(tmp_path / name)
    assert name in str(error.value)
    assert not any(raw in str(error.value) for raw in ("field limit", "codec", "set_int_max"))


def test_a_band_name_in_another_encoding_is_said_in_plain_words(tmp_path):
    path = tmp_path / "image.tif"
    write_geotiff(path, np.full((1, 4, 4), 0.1, np.float32), ["gruenes"], transform=Affine.scale(2))
    path.write_bytes(path.read_bytes().replace(b"gruenes", b"gr\xfcn es"))
    with pytest.raises(InputError, match=r"image.tif: .*byte 0xfc.*name its bands in plain") as e:
        read_drone_image(path)
    assert "codec" not in str(e.value)


def test_an_order_of_values_that_there_is_not_is_no_guess(tmp_path: Path) -> None:
    """GDAL takes it for band sequential."""
    header = tmp_path / "cube.hdr"
    header.write_text(
        "ENVI\nsamples = 2\nlines = 2\nbands = 2\ndata type = 4\ninterleave = bsx\n",
        encoding="utf-8",
    )
    (tmp_path / "cube.dat").write_bytes(bytes(32))
    for path in (header, tmp_path / "cube.dat"):
        with pytest.raises(InputError, match=r"cube\.hdr: expected the interleave .* got 'bsx'"):
            read_cube(path)
    header.write_text(header.read_text("utf-8").replace("bsx", "BIL"), encoding="utf-8")
    assert read_cube(header).values.shape == (2, 2, 2)

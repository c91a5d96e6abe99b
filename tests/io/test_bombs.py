"""Small files that unfold to much: one line, before memory or the day is gone."""

import json
import resource
import sqlite3
import struct
import sys
import threading
import time
import tracemalloc
import warnings
import zlib
from collections.abc import Callable
from contextlib import closing, suppress
from pathlib import Path

import laspy
import numpy as np
import openpyxl
import psutil
import pytest
import xarray as xr

from fynjax._core import memory
from fynjax._core.errors import InputError
from fynjax.app.compare import read_spectra_sample
from fynjax.app.io.instruments import load_sensor, read_atmosphere
from fynjax.app.io.plot import read_plot, read_statistics
from fynjax.app.io.raster import _zarr, parse_crs
from fynjax.app.io.spectra import in_nanometres, read_spectra_file
from fynjax.app.io.text import check_geopackage
from fynjax.app.terrain import read_cloud
from fynjax.canopy import read_plant_mesh
from tests.helpers import read_cube
from tests.io.test_crowns import write as write_crowns

pytestmark = pytest.mark.skipif(
    not hasattr(resource, "RLIMIT_DATA"), reason="limits of memory are set as Unix has them"
)


def test_a_second_frame_of_zstd_is_refused(tmp_path: Path) -> None:
    from numcodecs import Zstd

    one, more = (bytes(Zstd().encode(bytes(n))) for n in (4000, 1 << 24))
    path = tmp_path / "0.0"
    skipped = struct.pack("<II", 0x184D2A50, 4) + bytes(4)
    for k, data in enumerate((one, one + more, one + one, one + skipped, one[:-2])):
        path.write_bytes(data)
        assert _zarr._fits(str(path), "zstd", 4000, len(data), k) == (k in (0, 4)), k
    alike = bytes(Zstd().encode(bytes(1 << 20)))  # blocks of one byte, repeated
    path.write_bytes(alike + alike)
    assert not _zarr._fits(str(path), "zstd", 1 << 20, 2 * len(alike), 8)
    checked = bytes(Zstd(checksum=True).encode(np.random.default_rng(0).bytes(300_000)))
    path.write_bytes(checked)
    assert _zarr._fits(str(path), "zstd", 300_000, len(checked), 9)


def test_a_chunk_of_blosc_that_is_cut_short_is_refused(tmp_path: Path) -> None:
    """It would be filled with what stands behind it in memory."""
    from numcodecs import Blosc

    data = bytes(Blosc(clevel=0).encode(np.random.default_rng(0).random(500)))
    path = tmp_path / "0.0"
    for k, one in enumerate((data, data[:33], data[:-1], data + b"\0", data[:8])):
        path.write_bytes(one)
        assert _zarr._fits(str(path), "blosc", 4000, len(one), 100 + k) == (k == 0), k


@pytest.mark.parametrize("wrong", [-np.inf, np.inf, -9999.0, 1e20])
def test_wavelengths_that_are_none(wrong: float) -> None:
    with pytest.raises(InputError, match="wavelengths in Nanometers") as caught:
        in_nanometres(np.array([500.0, np.nan, wrong]), "nm")
    assert f"one is {wrong:g}" in str(caught.value)


@pytest.mark.parametrize(
    ("shape", "chunks", "says"),
    [
        ([100_000, 100_000, 4], [10, 10, 4], "at most 1048576 chunks"),
        ([10_000, 10_000, 4], [1000, 1000, 4], "its .* bytes cannot hold them"),
    ],
)
def test_a_zarr_group_states_no_more_than_it_can_hold(
    tmp_path: Path, shape: list[int], chunks: list[int], says: str
) -> None:
    data = xr.Dataset({"reflectance": (("y", "x", "band"), np.ones((4, 3, 4), np.float32))})
    data.to_zarr(tmp_path / "cube.zarr", zarr_format=2, consolidated=False)
    meta = tmp_path / "cube.zarr" / "reflectance" / ".zarray"
    meta.write_text(json.dumps({**json.loads(meta.read_text()), "shape": shape, "chunks": chunks}))
    with pytest.raises(InputError, match=rf"cube\.zarr.*{says}"):
        _zarr.check_zarr(tmp_path / "cube.zarr")


@pytest.mark.parametrize(
    "statement",
    [
        "CREATE VIEW {} AS WITH RECURSIVE n(x) AS (SELECT 1 UNION ALL SELECT x FROM n) "
        "SELECT x AS fid, NULL AS geom FROM n",
        "CREATE TABLE {} (fid INTEGER PRIMARY KEY, large BLOB AS (zeroblob(1000000000)))",
    ],
)
@pytest.mark.parametrize("name", ["crowns", "gpkg_contents"])
def test_a_geopackage_that_computes_its_rows_is_refused(
    tmp_path: Path, statement: str, name: str
) -> None:
    path = tmp_path / "crowns.gpkg"
    with closing(sqlite3.connect(path)) as base:
        base.execute("CREATE TABLE other (fid INTEGER PRIMARY KEY, taxon TEXT)")
        check_geopackage(path)
        base.execute(statement.format(name))
        base.commit()
    with pytest.raises(InputError, match=rf"crowns\.gpkg.*'{name}.*is computed"):
        read_plot(write_crowns(tmp_path, None, "crowns.gpkg"))


@pytest.mark.parametrize(
    ("reader", "name", "text"),
    [
        (read_plant_mesh, "plant.obj", "v 0 0 0\nv 1 0 0\nv 0 1 1\nusemtl a{}b\nf 1 2 3\n"),
        (read_plant_mesh, "plant.obj", "v 0 0 0\nv 1 0 0\nv 0 1 1\ng leaf\ng wood-{}b\nf 1 2 3\n"),
        (read_spectra_file, "leaf.csv", "{}x1,2\n3,4\n"),
        (read_spectra_file, "leaf.txt", "{}Begin\n3 4\n"),
        (read_spectra_file, "leaf.txt", "SpectraSuite\nW,a{}[nm\n3,4\n"),
        (read_atmosphere, "air.csv", "wavelength{},direct\n3,4\n"),
        (load_sensor, "own.toml", "[sensor]\nname = 1\n{}\n"),
        (load_sensor, "own.toml", "[sensor]\nname = 1\n[other]\na{}b\n"),
    ],
)
@pytest.mark.parametrize("run", ["0", " ", "-", ">", ".", "_", "a", "a "])
def test_a_long_run_of_letters_takes_no_time(
    tmp_path: Path, reader: Callable[[Path], object], name: str, text: str, run: str
) -> None:
    path = tmp_path / name
    path.write_text(text.format(run * 120_000), "utf-8")
    began = time.process_time()
    with warnings.catch_warnings(), suppress(InputError):
        warnings.simplefilter("ignore")
        reader(path)
    assert time.process_time() - began < 5.0  # minutes where the square of the letters is taken


def test_crowns_that_cover_the_plot_very_often(tmp_path: Path) -> None:
    places = np.random.default_rng(0).uniform(0.1, 1.9, (200, 2))
    rows = [f"Erica irregularis,{x:.6f},{y:.6f},190,0.5" for x, y in places]
    table = "\n".join(["taxon,x_m,y_m,diameter_cm,height_m", *rows]) + "\n"
    with pytest.raises(InputError, match=r"crowns\.csv: .* at most 100 times .* 142 times"):
        read_plot(write_crowns(tmp_path, table))


def test_rows_of_one_name_are_numbered_in_one_pass(tmp_path: Path) -> None:
    names = ",".join(map(str, range(400, 1000, 10)))
    row = "leaf," + ",".join(["0.3"] * 60)
    (tmp_path / "leaf.csv").write_text("\n".join([f"name,{names}", *[row] * 3000]), "utf-8")
    began = time.process_time()
    names = [one.name for one in read_spectra_file(tmp_path / "leaf.csv")]
    assert time.process_time() - began < 10.0  # a minute where each row reads the rows before it
    assert names[:2] == ["leaf", "leaf_row3"]
    assert names[-1] == "leaf_row3001"


def test_a_reference_system_of_lists_within_lists(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="coordinate reference system"):
        parse_crs("[" * 60_000)


@pytest.mark.parametrize("part", ['"x y"', "'x.y'", '"a\\"b"', "x "])
def test_keys_of_quoted_parts_are_counted(tmp_path: Path, part: str) -> None:
    path = tmp_path / "own.toml"
    path.write_text("a = 1\n" + ".".join([part] * 1500) + " = 1\n", "utf-8")
    with pytest.raises(InputError, match=r"own\.toml, line 2: .* at most 32 parts"):
        load_sensor(path)


def test_points_that_memory_cannot_hold(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    header = laspy.LasHeader(version="1.4", point_format=6)
    las = laspy.LasData(header)
    las.x = las.y = las.z = np.zeros(400_000)
    path = tmp_path / "cloud.laz"
    las.write(path)
    assert path.stat().st_size < 1 << 16
    monkeypatch.setattr("fynjax.app.io.text._bounds.total_memory", lambda: 1 << 25)
    with pytest.raises(InputError, match=r"cloud\.laz: 400000 points need 0\.0447 GiB, but"):
        read_cloud(path)


def test_a_wide_sheet_takes_memory_for_what_it_holds(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    book = openpyxl.Workbook()
    for column, value in enumerate(("statistic", "value", "sd"), 1):
        book.active.cell(1, column).value = value
    book.active.cell(2, 1).value, book.active.cell(2, 2).value = "NDVI.mean", 0.5
    path = tmp_path / "statistics.xlsx"
    book.save(path)
    assert read_statistics(path)[0].value == 0.5
    book.active.cell(60, 16_384).value = 1
    book.save(path)
    tracemalloc.start()
    with pytest.raises(InputError, match=r"statistics\.xlsx"):
        read_statistics(path)
    assert tracemalloc.get_traced_memory()[1] < 1 << 26  # by cells it was 300 MiB
    tracemalloc.stop()
    book.active.cell(1_048_576, 16_384).value = 1
    book.save(path)
    with pytest.raises(InputError, match=r"cannot be read as an Excel workbook \('Sheet' reaches"):
        read_statistics(path)


def test_cells_that_share_a_long_text_are_not_written_out(tmp_path: Path) -> None:
    import zipfile

    path, bomb = tmp_path / "plain.xlsx", tmp_path / "statistics.xlsx"
    openpyxl.Workbook().save(path)
    space = "http://schemas.openxmlformats.org/spreadsheetml/2006/main"
    rows = "<row><c t='s'><v>0</v></c></row>" * 3000
    kind = "application/vnd.openxmlformats-officedocument.spreadsheetml.sharedStrings+xml"
    part = f'<Override PartName="/xl/sharedStrings.xml" ContentType="{kind}"/></Types>'
    sheet = f"<worksheet xmlns='{space}'><sheetData>{rows}</sheetData></worksheet>"
    with zipfile.ZipFile(path) as old, zipfile.ZipFile(bomb, "w") as new:
        for one in old.infolist():
            text = old.read(one).decode().replace("</Types>", part)
            new.writestr(one, sheet if one.filename == "xl/worksheets/sheet1.xml" else text)
        words = f"<sst xmlns='{space}'><si><t>{'x ' * 15_000}</t></si></sst>"
        new.writestr("xl/sharedStrings.xml", words)
    with pytest.raises(InputError, match=r"statistics\.xlsx: .* holds over 64 MiB of text"):
        read_statistics(bomb)


def test_a_workbook_has_no_entities_that_grow(tmp_path: Path) -> None:
    import zipfile

    path, bomb = tmp_path / "statistics.xlsx", tmp_path / "bomb.xlsx"
    openpyxl.Workbook().save(path)
    lol = "".join(f"<!ENTITY l{k + 1} '{f'&l{k};' * 10}'>" for k in range(9))
    head = f"<?xml version='1.0'?><!DOCTYPE a [<!ENTITY l0 'lol'>{lol}]>"
    with zipfile.ZipFile(path) as old, zipfile.ZipFile(bomb, "w") as new:
        for part in old.infolist():
            text = old.read(part)
            if part.filename == "xl/worksheets/sheet1.xml":
                sheet = "<row r='1'><c r='A1' t='inlineStr'><is><t>&l9;</t></is></c></row>"
                space = "http://schemas.openxmlformats.org/spreadsheetml/2006/main"
                body = f"<worksheet xmlns='{space}'><sheetData>{sheet}</sheetData></worksheet>"
                text = (head + body).encode()
            new.writestr(part, text)
    with pytest.raises(InputError, match=r"bomb\.xlsx"):
        read_statistics(bomb)


def test_a_chunk_of_netcdf_unfolds_within_the_budget(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    h5py = pytest.importorskip("h5py")
    path = tmp_path / "cube.nc"
    sizes = {"band": 4, "y": 8, "x": 8}
    with h5py.File(path, "w") as file:
        values = file.create_dataset(
            "reflectance", (4, 8, 8), "f4", chunks=(4, 8, 8), compression="gzip"
        )
        packer = zlib.compressobj(9)
        parts = [packer.compress(bytes(1 << 20)) for _ in range(512)]
        values.id.write_direct_chunk((0, 0, 0), b"".join(parts) + packer.flush())
        file["wavelength"] = np.array([500.0, 600.0, 700.0, 800.0])
        for i, (name, size) in enumerate(sizes.items()):
            file[name] = np.arange(float(size))
            file[name].make_scale(name)
            values.dims[i].attach_scale(file[name])
        file["wavelength"].dims[0].attach_scale(file["band"])
    assert path.stat().st_size < 1 << 20
    monkeypatch.setattr(memory, "free_memory", lambda: 0)
    monkeypatch.setattr(memory, "_LEAST", 1 << 26)
    before = memory.peak_memory(), psutil.Process().memory_info().rss
    with pytest.raises(InputError, match=r"cube\.nc"):
        read_spectra_sample([path])
    assert memory.peak_memory() <= max(before[0], before[1] + (1 << 28))  # 665 MiB without


def _png(width: int, height: int) -> bytes:
    def part(kind: bytes, data: bytes) -> bytes:
        return (
            struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
        )

    head = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    content = zlib.compress(bytes(1 << 20), 9)
    return b"\x89PNG\r\n\x1a\n" + part(b"IHDR", head) + part(b"IDAT", content) + part(b"IEND", b"")


def test_a_png_that_states_more_than_it_can_hold(tmp_path: Path) -> None:
    (tmp_path / "image.png").write_bytes(_png(60_000, 60_000))
    with pytest.raises(InputError, match=r"image\.png: .*60000 x 60000 pixels"):
        read_cube(tmp_path / "image.png")


def test_a_mesh_that_trimesh_unfolds_keeps_to_the_budget(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "plant.ply"
    path.write_text("ply\n", "utf-8")
    monkeypatch.setattr(memory, "free_memory", lambda: 0)
    monkeypatch.setattr(memory, "_LEAST", 1 << 26)
    monkeypatch.setattr("trimesh.load", lambda *given, **named: np.ones(1 << 28))
    with pytest.raises(InputError, match=r"plant\.ply: it unfolds to more than the 0\.062 GiB"):
        read_plant_mesh(path)
    assert np.ones(1 << 25).sum() > 0  # 256 MiB: the limit is gone


@pytest.mark.parametrize("version", [1, 2])
def test_the_memory_of_a_group_of_processes_is_what_there_is(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, version: int
) -> None:
    own, root = tmp_path / "own", tmp_path / "groups"
    limit, used, line, top = {
        1: ("memory.limit_in_bytes", "memory.usage_in_bytes", "4:cpu:/\n3:memory:/a/b", "memory"),
        2: ("memory.max", "memory.current", "0::/a/b", "."),
    }[version]
    own.write_text(line + "\n", "utf-8")
    for place, most in (("a", str(2**28)), ("a/b", "max")):
        folder = root / top / place
        folder.mkdir(parents=True)
        (folder / limit).write_text(most + "\n", "utf-8")
        (folder / used).write_text(f"{2**27}\n", "utf-8")
    monkeypatch.setattr(memory, "_OWN_GROUPS", own)
    monkeypatch.setattr(memory, "_GROUPS", root)
    assert memory.total_memory() == 2**28
    assert memory.free_memory() == 2**27
    monkeypatch.setattr(memory, "_OWN_GROUPS", tmp_path / "none")
    assert memory.total_memory() > 2**28
    monkeypatch.setattr(memory, "_own_limits", lambda: {"RLIMIT_AS": 2**40, "RLIMIT_DATA": 2**29})
    assert memory.total_memory() == 2**29


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux limits the data of a process")
def test_threads_share_a_limit_and_the_last_takes_it_back(monkeypatch: pytest.MonkeyPatch) -> None:
    kind = resource.RLIMIT_DATA
    before = resource.getrlimit(kind)
    entered, left = threading.Event(), threading.Event()

    def first() -> None:
        with memory.bounded_memory("first"):
            entered.set()
            left.wait(10.0)

    thread = threading.Thread(target=first)
    thread.start()
    entered.wait(10.0)
    with memory.bounded_memory("second"):
        limit = resource.getrlimit(kind)[0]
        left.set()
        thread.join()
        assert resource.getrlimit(kind)[0] == limit != before[0]
        used = psutil.Process().memory_info()
        assert memory.free_memory() == pytest.approx(limit - used.data, rel=0.05)
    assert resource.getrlimit(kind) == before

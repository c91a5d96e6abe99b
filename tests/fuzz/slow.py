"""Small files made to take long, and the seconds of the processor that each reader takes for them.

`python -m tests.fuzz.slow [--reader NAME] [--each N] [--size BYTES]`: valid files of text get a
long run of one letter, or one line very often; of formats that unfold files are made that do so as
much as they are let. Printed for each reader: how many were tried, and the seconds for each
megabyte of the one that took longest.
"""

import argparse
import json
import multiprocessing
import random
import re
import shutil
import struct
import sys
import tempfile
import time
import warnings
import zipfile
import zlib
from collections.abc import Callable, Iterator
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import psutil

from tests.fuzz.mutate import RUNS

SIZE = 1 << 20
"""Bytes of a file, about."""
SECONDS = 60.0
"""Longest that a reader may take for one."""


class Taken(NamedTuple):
    """What a reader took for a file."""

    reader: str
    what: str
    seconds: float
    size: int
    text: str


# -- files of text ------------------------------------------------------------------------------


def _texts(
    files: dict[str, bytes], size: int, chance: random.Random
) -> Iterator[tuple[str, dict[str, bytes]]]:
    """Valid files with a run of letters at one of a few places, or with a line very often."""
    for name, content in files.items():
        if b"\0" in content or len(content) < 2:
            continue
        words = [found.start() for found in re.finditer(rb"\w+|\Z", content[:20_000])]
        ends = [found.start() for found in re.finditer(rb"\n|\Z", content[:20_000])]
        places = {"a word": chance.choice(words), "a line": chance.choice(ends), "all": 0}
        for run in RUNS:
            for where, at in places.items():
                for tail in (b"", b"!x1\n"):
                    long = run * (size // len(run)) + tail
                    change = {name: content[:at] + long + content[at:]}
                    yield f"{name}: {run!r} before {where}", {**files, **change}
        for line in chance.sample(lines := content.split(b"\n"), min(len(lines), 6)):
            often = (line + b"\n") * (size // (len(line) + 1))
            change = {name: content.replace(line, often + line, 1)}
            yield f"{name}: the line {line[:30]!r} often", {**files, **change}
            last = line.split(b",")[-1].strip()[:20]
            wide = b",".join([line, *(b"%s%d" % (last, k) for k in range(size // 24))])
            yield (
                f"{name}: the line {line[:30]!r} wide",
                {**files, name: content.replace(line, wide)},
            )


def _serve(pipe: Connection) -> None:
    import logging

    logging.disable()
    from fynjax._core.errors import InputError
    from tests.fuzz.readers import READERS
    from tests.fuzz.slow import SHARED

    pipe.send(None)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name) / "input"
        while True:
            try:
                reader, files = pipe.recv()
            except EOFError:
                return
            folder.mkdir()
            read: Callable[[Path], Any]
            if isinstance(files, str):
                read = SHARED[reader][files](folder)
            else:
                for part, content in files.items():
                    (folder / part).parent.mkdir(parents=True, exist_ok=True)
                    (folder / part).write_bytes(content)
                read = READERS[reader].read
            size = sum(p.stat().st_size for p in folder.rglob("*") if p.is_file())
            pipe.send(size)
            text = "accepted"
            began = time.process_time()
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                try:
                    read(folder)
                except InputError as error:
                    text = str(error)[:200]
                except BaseException as error:
                    text = f"OTHER {type(error).__name__}: {str(error)[:200]}"
            pipe.send((time.process_time() - began, text))
            shutil.rmtree(folder)


class Child:
    """A process that reads, and another one after it had to be ended."""

    def __init__(self) -> None:
        self._context = multiprocessing.get_context("spawn")
        self._start()

    def _start(self) -> None:
        self._pipe, other = self._context.Pipe()
        self._process = self._context.Process(target=_serve, args=(other,), daemon=True)
        self._process.start()
        other.close()
        self._pipe.recv()

    def close(self) -> None:
        self._process.kill()
        self._process.join()

    def read(self, reader: str, what: str, files: Any) -> Taken:
        self._pipe.send((reader, files))
        size = 0
        try:
            size = self._pipe.recv()
            if self._answers():
                seconds, text = self._pipe.recv()
                return Taken(reader, what, seconds, size, text)
            text = "OTHER not ended"
        except (EOFError, ConnectionError):
            self._process.join()
            text = f"OTHER status {self._process.exitcode}"
        self.close()
        self._start()
        return Taken(reader, what, SECONDS, size, text)

    def _answers(self) -> bool:
        """Whether it answers before it has used its seconds of the processor."""
        one = psutil.Process(self._process.pid)
        end = sum(one.cpu_times()[:2]) + SECONDS
        while not self._pipe.poll(0.5):
            if sum(one.cpu_times()[:2]) > end:
                return False
        return True


# -- files that unfold --------------------------------------------------------------------------


def _glb(folder: Path, nodes: list[dict[str, Any]], triangles: int) -> Callable[[Path], Any]:
    from tests.fuzz.readers import READERS

    corners = np.random.default_rng(0).random((3 * triangles, 3)).astype("<f4")
    data = corners.tobytes()
    head = {
        "asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}], "nodes": nodes,
        "meshes": [{"name": "leaf", "primitives": [{"attributes": {"POSITION": 0}}]}],
        "buffers": [{"byteLength": len(data)}],
        "bufferViews": [{"buffer": 0, "byteOffset": 0, "byteLength": len(data)}],
        "accessors": [{"bufferView": 0, "componentType": 5126, "count": 3 * triangles,
                       "type": "VEC3", "min": [0, 0, 0], "max": [1, 1, 1]}],
    }  # fmt: skip
    text = json.dumps(head, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 4)
    whole = struct.pack("<II", len(text), 0x4E4F534A) + text
    whole += struct.pack("<II", len(data), 0x004E4942) + data
    (folder / "plant.glb").write_bytes(b"glTF" + struct.pack("<II", 2, 12 + len(whole)) + whole)
    return READERS["mesh-glb"].read


def _chain(folder: Path) -> Callable[[Path], Any]:
    count = SIZE // 60
    nodes: list[dict[str, Any]] = [{"children": [i + 1], "mesh": 0} for i in range(count)]
    return _glb(folder, [*nodes, {"mesh": 0}], 1)


def _placings(triangles: int) -> Callable[[Path], Callable[[Path], Any]]:
    def make(folder: Path) -> Callable[[Path], Any]:
        count = min(SIZE // 40, 5_000_000 // triangles)
        nodes = [{"children": list(range(1, count + 1))}, *[{"mesh": 0}] * count]
        return _glb(folder, nodes, triangles)

    return make


def _obj(lines: Callable[[], Iterator[str]]) -> Callable[[Path], Callable[[Path], Any]]:
    def make(folder: Path) -> Callable[[Path], Any]:
        from tests.fuzz.readers import READERS

        corners = "v 0 0 0\nv 1 0 0\nv 0 1 1\nv 1 1 1\n"
        (folder / "plant.obj").write_text(corners + "\n".join(lines()) + "\n", "utf-8")
        return READERS["mesh-obj"].read

    return make


def _long_zarr(folder: Path) -> Callable[[Path], Any]:
    return _stated_zarr(folder, [1_000_000_000, 1, 4], [1, 1, 4])


def _small_chunks(folder: Path) -> Callable[[Path], Any]:
    return _stated_zarr(folder, [100_000, 100_000, 4], [10, 10, 4])


def _stated_zarr(folder: Path, shape: list[int], chunks: list[int]) -> Callable[[Path], Any]:
    from tests.fuzz.readers import READERS

    READERS["blocks-zarr"].write(folder)
    meta = folder / "cube.zarr" / "reflectance" / ".zarray"
    record = json.loads(meta.read_text("utf-8"))
    meta.write_text(json.dumps({**record, "shape": shape, "chunks": chunks}), "utf-8")
    for chunk in meta.parent.glob("[0-9]*"):
        chunk.unlink()
    return lambda folder: _all_rows(folder / "cube.zarr")


def _all_rows(path: Path) -> None:
    from fynjax.app.io.raster import open_blocks

    with open_blocks(path) as cube:
        cube.scale()
        for start in range(0, cube.shape[0], cube.rows_at_once):
            cube.read(start, min(cube.rows_at_once, cube.shape[0] - start))


def _netcdf(filters: int, stored: int, count: int) -> Callable[[Path], Callable[[Path], Any]]:
    """Chunks that unfold, through `filters` times deflate, to more than they state."""

    def make(folder: Path) -> Callable[[Path], Any]:
        import h5py

        from fynjax.app.compare import read_spectra_sample

        sizes = {"band": 4, "y": 8 * count, "x": 8}
        data = bytes(stored)
        for _ in range(filters):
            data = zlib.compress(data, 9)
        with h5py.File(folder / "cube.nc", "w") as file:
            made = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
            made.set_chunk((4, 8, 8))
            for _ in range(filters):
                made.set_filter(h5py.h5z.FILTER_DEFLATE, h5py.h5z.FLAG_OPTIONAL, (4,))
            space = h5py.h5s.create_simple((4, 8 * count, 8))
            one = h5py.h5d.create(file.id, b"reflectance", h5py.h5t.IEEE_F32LE, space, made)
            values = h5py.Dataset(one)
            for k in range(count):
                values.id.write_direct_chunk((0, 8 * k, 0), data)
            file["wavelength"] = np.array([500.0, 600.0, 700.0, 800.0])
            for i, (name, size) in enumerate(sizes.items()):
                file[name] = np.arange(float(size))
                file[name].make_scale(name)
                values.dims[i].attach_scale(file[name])
            file["wavelength"].dims[0].attach_scale(file["band"])
        return lambda folder: read_spectra_sample([folder / "cube.nc"])

    return make


def _tiff(compress: str, side: int) -> Callable[[Path], Callable[[Path], Any]]:
    """An image of zeros."""

    def make(folder: Path) -> Callable[[Path], Any]:
        import rasterio

        with rasterio.open(
            folder / "image.tif",
            "w",
            driver="GTiff",
            height=side,
            width=side,
            count=3,
            dtype="uint16",
            compress=compress,
            tiled=True,
            blockxsize=512,
            blockysize=512,
            transform=rasterio.Affine(0.01, 0, 0, 0, -0.01, 0),
            crs="EPSG:32734",
        ) as file:
            for row in range(0, side, 512):
                rows = min(512, side - row)
                zeros = np.full((3, rows, side), 2000, "u2")
                file.write(zeros, window=rasterio.windows.Window(0, row, side, rows))
        return lambda folder: _all_rows(folder / "image.tif")

    return make


def _png(folder: Path) -> Callable[[Path], Any]:
    from tests.helpers import read_cube

    side = 6_000
    packer = zlib.compressobj(9)
    rows = [packer.compress(bytes(3 * side + 1)) for _ in range(side)]
    content = b"".join(rows) + packer.flush()

    def part(kind: bytes, data: bytes) -> bytes:
        whole = kind + data
        return struct.pack(">I", len(data)) + whole + struct.pack(">I", zlib.crc32(whole))

    head = part(b"IHDR", struct.pack(">IIBBBBB", side, side, 8, 2, 0, 0, 0))
    (folder / "image.png").write_bytes(
        b"\x89PNG\r\n\x1a\n" + head + part(b"IDAT", content) + part(b"IEND", b"")
    )
    return lambda folder: read_cube(folder / "image.png")


def _sheet(row: str, rows: int, strings: str = "") -> Callable[[Path], Callable[[Path], Any]]:
    """A workbook whose one sheet has a row very often, and one long shared text."""

    def make(folder: Path) -> Callable[[Path], Any]:
        import openpyxl

        from tests.fuzz.readers import READERS

        plain = folder / "plain.xlsx"
        book = openpyxl.Workbook()
        book.active["A1"] = "text"
        book.save(plain)
        space = "http://schemas.openxmlformats.org/spreadsheetml/2006/main"
        body = "".join(f"<row r='{i + 1}'>{row}</row>" for i in range(rows))
        new = {
            "xl/worksheets/sheet1.xml": f"<worksheet xmlns='{space}'><sheetData>{body}"
            "</sheetData></worksheet>"
        }
        kind = "application/vnd.openxmlformats-officedocument.spreadsheetml.sharedStrings+xml"
        part = f'<Override PartName="/xl/sharedStrings.xml" ContentType="{kind}"/></Types>'
        with (
            zipfile.ZipFile(plain) as old,
            zipfile.ZipFile(folder / "statistics.xlsx", "w", zipfile.ZIP_DEFLATED) as packed,
        ):
            for one in old.infolist():
                text = new.get(one.filename, old.read(one).decode())
                packed.writestr(one.filename, text.replace("</Types>", part))
            text = f"<sst xmlns='{space}'><si><t>{strings}</t></si></sst>"
            packed.writestr("xl/sharedStrings.xml", text)
        plain.unlink()
        return READERS["workbook"].read

    return make


def _cloud(kind: str, points: int) -> Callable[[Path], Callable[[Path], Any]]:
    def make(folder: Path) -> Callable[[Path], Any]:
        import laspy

        from fynjax.app.terrain import read_cloud

        las = laspy.LasData(laspy.LasHeader(version="1.4", point_format=6))
        las.x = las.y = las.z = np.arange(points) // (points // 4)
        las.write(folder / f"cloud.{kind}")
        return lambda folder: read_cloud(folder / f"cloud.{kind}")

    return make


def _crowns(rows: int, diameter: float) -> Callable[[Path], Callable[[Path], Any]]:
    def make(folder: Path) -> Callable[[Path], Any]:
        from tests.fuzz.readers import READERS

        READERS["crowns"].write(folder)
        plot = folder / "plot.toml"
        plot.write_text(plot.read_text("utf-8").replace('"article"', '"projected"'), "utf-8")
        path = folder / "crowns.csv"
        head, first, *_ = path.read_text("utf-8").splitlines()
        taxon = first.split(",")[0]
        chance = np.random.default_rng(0).uniform(0.01, 1.99, (rows, 2))
        lines = [f"{taxon},{x:.5f},{y:.5f},{diameter},0.5" for x, y in chance]
        path.write_text("\n".join([head, *lines]) + "\n", "utf-8")
        return READERS["crowns"].read

    return make


SHARED: dict[str, dict[str, Callable[[Path], Callable[[Path], Any]]]] = {
    "mesh-glb": {
        "a chain of parts": _chain,
        "one triangle placed often": _placings(1),
        "a mesh placed often": _placings(10_000),
    },
    "mesh-obj": {
        "many materials": _obj(lambda: (f"usemtl {i}\nf 1 2 3" for i in range(SIZE // 20))),
        "many groups": _obj(lambda: (f"g leaf{i}\nf 1 2 3\ng wood" for i in range(SIZE // 24))),
        "one face": _obj(lambda: iter(["f" + " 1 2 3 4" * (SIZE // 8)])),
        "faces of many corners": _obj(lambda: ("f" + " 1 2 3 4" * k for k in range(1, 500))),
        "faces counted from the last": _obj(lambda: ("f -1 -2 -3" for _ in range(SIZE // 11))),
        "spaces": _obj(lambda: iter(["usemtl a" + " " * SIZE + "b", "f 1 2 3"])),
    },
    "blocks-zarr": {"a million rows without data": _long_zarr, "small chunks": _small_chunks},
    "cube-netcdf": {
        "one deflate": _netcdf(1, 100_000_000, 10),
        "two deflates": _netcdf(2, 1_000_000_000, 20),
    },
    "image": {kind: _tiff(kind, 6_000) for kind in ("deflate", "lzw", "zstd", "lzma", "packbits")},
    "cube-png": {"zeros": _png},
    "workbook": {
        "a text shared": _sheet("<c r='A1' t='s'><v>0</v></c>", 1_000_000, "x " * 30_000),
        "rows": _sheet("<c><v>1</v></c>", 1_000_000),
        "a wide row": _sheet("<c><v>1</v></c>" * 1_000_000, 1),
        "empty rows": _sheet("", 1_000_000),
    },
    "laz": {"alike points": _cloud("laz", 5_000_000)},
    "las": {"points": _cloud("las", 30_000)},
    "crowns": {"small": _crowns(30_000, 1.0), "large": _crowns(30_000, 190.0)},
}


def main() -> int:
    from tests.fuzz.readers import READERS
    from tests.fuzz.run import _contents

    parser = argparse.ArgumentParser(prog="python -m tests.fuzz.slow")
    parser.add_argument("--reader", action="append")
    parser.add_argument("--size", type=int, default=SIZE)
    parser.add_argument("--each", type=int, default=60, help="texts for each reader")
    parser.add_argument("--only")
    options = parser.parse_args()
    child = Child()
    chance = random.Random(0)
    for reader in options.reader or [*READERS, *[n for n in SHARED if n not in READERS]]:
        taken = []
        tries: list[tuple[str, Any]] = [(n, n) for n in SHARED.get(reader, {})]
        if reader in READERS and options.only != "shared":
            with tempfile.TemporaryDirectory() as name:
                READERS[reader].write(Path(name))
                files = _contents(Path(name))
            texts = list(_texts(files, options.size, chance))
            tries += chance.sample(texts, min(len(texts), options.each))
        for what, given in tries:
            one = child.read(reader, what, given)
            taken.append(one)
            if one.text.startswith("OTHER"):
                print("  ", one, flush=True)
        if taken:
            one = max(taken, key=lambda t: t.seconds / t.size)
            print(
                f"{reader:<20}{len(taken):>5}{one.size / 1e6:>8.3f} MB{one.seconds:>7.1f} s"
                f"{1e6 * one.seconds / one.size:>8.1f} s/MB  {one.what}: {one.text[:60]}",
                flush=True,
            )
    child.close()
    return 0


if __name__ == "__main__":
    sys.exit(main())

"""Cubes in zarr from somebody else: nothing runs, or unfolds beyond what is stated, and no link is
followed."""

import gzip
import json
import os
import pickle
import shutil
import struct
import zlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from fynjax._core.errors import InputError
from fynjax.app.io.raster import _zarr as zarr_module
from fynjax.app.io.raster import open_blocks
from tests.helpers import unix

pytest.importorskip("zarr")
VALUES = np.random.default_rng(0).uniform(0.05, 0.5, (6, 5, 4)).astype(np.float32)


def write(path: Path, version: int = 2, **encoding: object) -> Path:
    """A cube with a coordinate of texts."""
    data = xr.Dataset(
        {"reflectance": (("y", "x", "band"), VALUES)},
        {"wavelength": ("band", [480.0, 560.0, 660.0, 860.0], {"units": "nm"})},
    ).assign_coords(band=["a", "b", "c", "d"])
    form: dict = {"reflectance": {"chunks": (3, 5, 4), **encoding}}
    data.to_zarr(path, zarr_format=version, consolidated=False, encoding=form, mode="w")
    return path


def edit(path: Path, change: Callable[[dict], None]) -> None:
    meta = json.loads(path.read_text("utf-8"))
    change(meta)
    path.write_text(json.dumps(meta), "utf-8")


def refused(path: Path, words: str) -> None:
    with pytest.raises(InputError, match=words) as caught, open_blocks(path) as cube:
        cube.read(0, 6)
    text = str(caught.value)
    assert str(path) in text
    assert "\n" not in text
    assert "ALLOW" not in text


@pytest.mark.filterwarnings("ignore::Warning")  # zarr's, of texts and its own codecs
def test_what_others_write_is_read(tmp_path: Path) -> None:
    from numcodecs import LZ4, Blosc, GZip, Shuffle, Zlib, Zstd
    from zarr import codecs

    each = [Blosc(), Zstd(), LZ4(), GZip(), Zlib(), None]
    given = [(2, {"compressors": one}) for one in each]
    given += [(2, {"compressors": Zlib(), "filters": [Shuffle(4)]})]
    given += [(3, {}), (3, {"compressors": codecs.BloscCodec()})]
    given += [(3, {"compressors": codecs.GzipCodec()}), (3, {"compressors": None})]
    packed = (codecs.BloscCodec(), codecs.ZstdCodec(), codecs.GzipCodec())
    given += [(3, {"compressors": [one, codecs.Crc32cCodec()]}) for one in packed]
    for version, encoding in given:
        path = write(tmp_path / "cube.zarr", version, **encoding)
        with open_blocks(path) as cube:
            np.testing.assert_array_equal(cube.read(0, 6), VALUES)
            assert "band" not in cube.source.coords  # texts are not opened
            assert cube.wavelength[-1] == 860.0


RAN: list[str] = []


class Runs:
    def __reduce__(self) -> tuple:
        return RAN.append, ("ran",)


@pytest.mark.filterwarnings("ignore::Warning")
def test_no_code_of_a_file_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from numcodecs import pickles

    monkeypatch.setattr(pickles, "ALLOW_UNSAFE_PICKLE_DECODE", True, raising=False)  # as before
    path = write(tmp_path / "cube.zarr")
    for array in ("band", "reflectance", "wavelength"):
        for key in ("compressor", "filters"):
            write(path)
            codec = {"id": "pickle", "protocol": 4}
            value = codec if key == "compressor" else [codec]
            edit(path / array / ".zarray", lambda meta, k=key, v=value: meta.update({k: v}))
            for chunk in zarr_module._files(path / array):
                Path(chunk.path).write_bytes(pickle.dumps(Runs()))
            refused(path, "pickle: others can run code")
    write(path, 3)
    for name in ("numcodecs.pickle", "sharding_indexed", "own"):
        edit(path / "band" / "zarr.json", lambda meta, n=name: meta["codecs"].append({"name": n}))
        refused(path, "others can run code, or hide")
    assert RAN == []


@pytest.mark.filterwarnings("ignore::Warning")
def test_sizes_are_bounded_before_anything_is_read(tmp_path: Path) -> None:
    path = write(tmp_path / "cube.zarr")
    meta = path / "reflectance" / ".zarray"
    for shape, chunks, words in [
        ([1, 2**35, 4], [3, 5, 4], "at most 1048576 chunks"),
        ([6, 5, 4], [2**20, 2**20, 2**20], "need .* GiB, but this machine has"),
        ([6, 5, 4], [0, 5, 4], "whole numbers of 1 or more"),
        ([0, 5, 4], [3, 5, 4], "whole numbers of 1 or more"),
        ([6, -5, 4], [3, 5, 4], "whole numbers of 1 or more"),
        ([6, 5, 10**30], [3, 5, 4], "."),
        ([6, 5, 1e9], [3, 5, 4], "whole numbers of 1 or more"),
        ([6, 5], [3, 5, 4], "whole numbers of 1 or more"),
        ([6, 5 * 2**17, 4], [3, 5, 4], "16384 chunks in a row .* there are 131072"),
        ("abc", "abc", "whole numbers of 1 or more"),
        (None, None, "lack something or are damaged"),
    ]:
        write(path)
        edit(meta, lambda m, s=shape, c=chunks: m.update(shape=s, chunks=c))
        refused(path, words)
    write(path)
    edit(path / "wavelength" / ".zarray", lambda m: m.update(shape=[10**13], chunks=[4]))
    refused(path, "need .* GiB, but this machine has")
    for text in ("", "{", "[]", "7", '{"shape": [1]}', "\0", '{"a":' * 5000):
        write(path)
        meta.write_text(text, "utf-8")
        refused(path, ".")


def test_a_chunk_unfolds_to_no_more_than_is_stated(tmp_path: Path) -> None:
    chunk = tmp_path / "0.0.0"
    plain = b"\0" * 4000
    zstd = b"\x28\xb5\x2f\xfd"
    for codec, held in {
        "gzip": gzip.compress(plain),
        "zlib": zlib.compress(plain),
        "blosc": bytes([2, 1, 1, 4]) + struct.pack("<III", 4000, 4000, 18) + b"\0\0",
        "lz4": struct.pack("<I", 4000) + b"\0" * 20,
        "zstd": zstd + b"\x60" + struct.pack("<H", 4000 - 256) + b"\xa1\0\0" + b"\0" * 20,
    }.items():
        chunk.write_bytes(held)
        for most in (4000, 3999):
            assert zarr_module._fits(str(chunk), codec, most, len(held), 0) == (most == 4000), codec
    chunk.write_bytes(gzip.compress(b"\0" * 2000) + gzip.compress(b"\0" * 2001))
    assert not zarr_module._fits(str(chunk), "gzip", 4000, 1, 1)
    chunk.write_bytes(zstd + b"\x00" + b"\0" * 20)  # its size is not stated
    assert not zarr_module._fits(str(chunk), "zstd", 4000, 1, 1)


@pytest.mark.filterwarnings("ignore::Warning")
def test_a_bomb_is_refused(tmp_path: Path) -> None:
    from numcodecs import GZip

    path = write(tmp_path / "cube.zarr", compressors=GZip())
    chunk = next(p for p in (path / "reflectance").iterdir() if p.name != ".zarray")
    chunk.write_bytes(gzip.compress(bytes(1 << 24)))
    refused(path, "chunks of 240 bytes, but this one unfolds to more")


@pytest.mark.filterwarnings("ignore::Warning")
@unix
def test_links_are_not_followed(tmp_path: Path) -> None:
    outside = write(tmp_path / "outside.zarr")
    path = tmp_path / "cube.zarr"
    for name in ("reflectance", "reflectance/0.0.0", "reflectance/.zarray", ".zgroup"):
        write(path)
        linked = path / name
        shutil.rmtree(linked) if linked.is_dir() else linked.unlink()
        linked.symlink_to(outside / name)
        refused(path, "holds its own values, but this is a link")
        linked.unlink()
    write(path)
    os.mkfifo(path / "reflectance" / "0.0.1")
    refused(path, "this is a pipe")
    (tmp_path / "named.zarr").symlink_to(outside)  # by the user
    with open_blocks(tmp_path / "named.zarr") as cube:
        assert cube.shape == (6, 5)

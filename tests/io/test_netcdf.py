"""Runs open in xarray with CF names and units; a failed write leaves nothing behind."""

import hashlib
import json
import shutil
from datetime import UTC, datetime
from types import SimpleNamespace

import netCDF4
import numpy as np
import pytest
import xarray as xr

from fynjax._core.errors import InputError
from fynjax.app.io.raster import check_netcdf, image_array, provenance, write_run
from fynjax.app.io.text import staged_folder

BANDS = ("green", "nir")


@pytest.fixture
def dataset():
    image = np.random.default_rng(0).uniform(size=(2, 6, 4)).astype(np.float32)
    return xr.Dataset(
        {
            "reflectance": image_array(
                image, BANDS, (560, 860), pixel_m=0.5, long_name="simulated reflectance"
            ),
            "cover": (
                "species",
                np.array([0.1, 0.2]),
                {"units": "1", "long_name": "cover", "standard_name": "area_fraction"},
            ),
        },
        coords={"species": ("species", ["a", "b"], {"long_name": "taxon"})},
    )


def test_xarray_reads_it_with_names_units_and_record(tmp_path, dataset, monkeypatch):
    monkeypatch.setattr("sys.argv", ["/somewhere/bin/fynjax", "render", "plot.toml"])
    source = tmp_path / "plot.toml"
    source.write_text("[plot]")
    record = provenance(seed=4, inputs=[source])
    write_run(tmp_path / "run.nc", dataset, record)
    with xr.open_dataset(tmp_path / "run.nc") as back:
        np.testing.assert_array_equal(back["reflectance"], dataset["reflectance"])
        assert back["reflectance"].attrs["units"] == "1"
        assert back["wavelength"].attrs["units"] == "nm"
        np.testing.assert_array_equal(back["y"], 0.25 + 0.5 * np.arange(6))
        assert back["y"].attrs["standard_name"] == "projection_y_coordinate"
        assert list(back["band"].values) == list(BANDS)
        assert back.attrs["Conventions"] == "CF-1.11"
        assert back.attrs["seed"] == 4
        assert back.attrs["command"] == "fynjax render plot.toml"
        assert back.attrs["history"].endswith("fynjax render plot.toml")
        hashes = json.loads(back.attrs["input_sha256"])
        assert hashes == {"plot.toml": hashlib.sha256(b"[plot]").hexdigest()}
        made = datetime.strptime(back.attrs["date_created"], "%Y-%m-%dT%H:%M:%SZ")
        age = datetime.now(UTC) - made.replace(tzinfo=UTC)
        assert abs(age.total_seconds()) < 60
    with netCDF4.Dataset(tmp_path / "run.nc") as file:
        assert file["reflectance"].filters()["zlib"]
        assert "_FillValue" not in file["x"].ncattrs()  # CF forbids it on coordinates


def test_inputs_of_one_name_are_both_recorded(tmp_path):
    paths = [tmp_path / folder / "plot.csv" for folder in "ab"]
    for path in paths:
        path.parent.mkdir()
        path.write_text(path.parent.name)
    (tmp_path / "c.csv").write_text("c")
    hashes = json.loads(str(provenance(inputs=[*paths, tmp_path / "c.csv"])["input_sha256"]))
    assert list(hashes) == [*(path.as_posix() for path in paths), "c.csv"]
    assert hashes[paths[1].as_posix()] == hashlib.sha256(b"b").hexdigest()


def test_variables_without_units_or_names_are_refused(tmp_path, dataset):
    del dataset["cover"].attrs["units"]
    with pytest.raises(ValueError, match="'cover' must have `units`"):
        write_run(tmp_path / "run.nc", dataset)
    dataset["cover"].attrs = {"units": "1"}
    with pytest.raises(ValueError, match="'cover' must have `long_name`"):
        write_run(tmp_path / "run.nc", dataset)
    assert list(tmp_path.iterdir()) == []


def test_a_failed_write_leaves_the_old_file_and_nothing_else(tmp_path, dataset):
    path = tmp_path / "run.nc"
    write_run(path, dataset)
    before = path.read_bytes()
    dataset["bad"] = ("z", np.array([object()]), {"long_name": "no number"})
    with pytest.raises((ValueError, TypeError)):
        write_run(path, dataset)
    assert path.read_bytes() == before
    assert [p.name for p in tmp_path.iterdir()] == ["run.nc"]


def test_a_staged_folder_arrives_whole_or_not_at_all(tmp_path):
    target = tmp_path / "out" / "run"

    def interrupted():
        with staged_folder(target) as folder:
            (folder / "half.txt").write_text("half")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert not target.exists()
    assert list(tmp_path.iterdir()) == []  # not even the folders that it was to lie in
    target.mkdir(parents=True)
    (target / "mine.txt").write_text("kept")
    (target / "a.txt").write_text("old")

    def write(check=None):
        with staged_folder(target, check) as folder:
            (folder / "deep").mkdir()
            (folder / "deep" / "b.txt").write_text("b")
            (folder / "a.txt").write_text("new")

    target.with_name("run-2").mkdir()  # of the user's, who will put something there
    for number in (3, 4):  # in a new folder each time
        with pytest.raises(InputError, match=f"'a.txt' is there already.*run-{number}, beside it"):
            write()
        beside = target.with_name(f"run-{number}")
        assert (beside / "a.txt").read_text() == "new"
        assert (beside / "deep" / "b.txt").is_file()
        assert (target / "a.txt").read_text() == "old"
    assert [p.name for p in sorted(target.parent.iterdir())] == ["run", "run-2", "run-3", "run-4"]
    assert not list(target.with_name("run-2").iterdir())
    for number in (2, 3, 4):
        shutil.rmtree(target.with_name(f"run-{number}"))
    names = []
    write(names.extend)
    assert names == ["a.txt", "deep/b.txt"]
    assert (target / "a.txt").read_text() == "new"
    assert (target / "mine.txt").read_text() == "kept"
    assert (target / "deep" / "b.txt").read_text() == "b"
    assert [p.name for p in target.parent.iterdir()] == ["run"]


def test_a_full_disk_is_called_so(tmp_path, monkeypatch):
    def run(error):
        with staged_folder(tmp_path / "out") as folder:
            (folder / "run.nc").touch()
            raise error

    errors = (RuntimeError("NetCDF: HDF error"), InputError("cannot write here: HDF error"))
    for error in errors:
        with pytest.raises(type(error), match="HDF error"):
            run(error)
    monkeypatch.setattr(shutil, "disk_usage", lambda path: SimpleNamespace(free=1000))
    for error in errors:
        with pytest.raises(InputError, match="out: the disk is full, so no results were written"):
            run(error)
    with pytest.raises(InputError, match="expected a number"):
        run(InputError("expected a number"))
    assert not list(tmp_path.iterdir())


def test_a_file_that_takes_values_from_others_is_refused(tmp_path):
    h5py = pytest.importorskip("h5py")
    values = np.arange(60, dtype=np.float32).reshape(3, 4, 5)
    secret, raw = tmp_path / "secret.nc", tmp_path / "secret.bin"
    raw.write_bytes(values.tobytes())
    with h5py.File(secret, "w") as file:
        file["x"] = values
    layout = h5py.VirtualLayout(values.shape, "f4")
    layout[:] = h5py.VirtualSource(secret, "x", values.shape)
    makers = [
        lambda group: group.__setitem__("reflectance", h5py.ExternalLink(secret, "/x")),
        lambda group: group.create_virtual_dataset("reflectance", layout),
        lambda group: group.create_dataset(
            "reflectance", values.shape, "f4", external=[(raw, 0, values.nbytes)]
        ),
    ]
    for make in makers:
        path = tmp_path / "outside.nc"
        with h5py.File(path, "w") as file:
            make(file.create_group("a/b"))
        with netCDF4.Dataset(path) as file:  # the library follows it
            np.testing.assert_array_equal(file["a/b/reflectance"], values)
        with pytest.raises(InputError, match=r"links to other files.*nccopy"):
            check_netcdf(path)
    with h5py.File(path, "w") as file:
        file["a/x"], file["y"] = values, h5py.SoftLink("/a/x")
    check_netcdf(path)


def test_a_file_that_states_more_than_it_can_hold_is_refused(tmp_path):
    path = tmp_path / "large.nc"
    with netCDF4.Dataset(path, "w") as file:
        group = file.createGroup("a")
        for name, size in {"y": 2**20, "x": 2**20}.items():
            group.createDimension(name, size)
        group.createVariable("reflectance", "f4", ("y", "x"), chunksizes=(8, 8))
    with pytest.raises(InputError, match=r"states 4398046511104 bytes.* cannot hold them"):
        check_netcdf(path)

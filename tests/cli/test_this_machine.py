"""One clear line for names that are no text, too little memory, and a device that is not there."""

import errno
import io
import os
import subprocess
import sys
from pathlib import Path

import jax
import pytest
from typer.testing import CliRunner

import fynjax.app.cli as cli
from fynjax._core.errors import InputError
from fynjax._core.files import existing_file, how_to_import
from fynjax.app.cli import app
from fynjax.app.cli._runtime import run_job
from fynjax.app.io.raster import open_blocks, open_raster

posix = pytest.mark.skipif(sys.platform in ("win32", "darwin"), reason="names are text there")


@posix
def test_a_name_that_is_no_text_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = tmp_path / os.fsdecode(b"n\xffame")
    folder.mkdir()
    (folder / "a.csv").write_text("a", "utf-8")
    (tmp_path / "fynböš.csv").write_text("a", "utf-8")
    assert existing_file(tmp_path / "fynböš.csv", "a table")
    for attempt in (
        lambda: existing_file(folder / "a.csv", "a table"),
        lambda: open_blocks(folder / "a.zarr").__enter__(),
        lambda: run_job("build", lambda _: None, folder / "out", as_json=False, quiet=True),
    ):
        with pytest.raises(
            InputError, match=r"in utf-8, but the byte 0xff is none.*Rename"
        ) as caught:
            attempt()
        str(caught.value).encode()  # can be printed
    monkeypatch.chdir(folder)
    with pytest.raises(InputError, match="folder that it is in"):
        existing_file("a.csv", "a table")


def test_a_terminal_without_letters_shows_their_numbers(monkeypatch, tmp_path) -> None:
    ascii_only = io.TextIOWrapper(io.BytesIO(), encoding="ascii")
    monkeypatch.setattr(sys, "stderr", ascii_only)
    monkeypatch.setattr(sys, "stdout", io.TextIOWrapper(io.BytesIO(), encoding="ascii"))
    with pytest.raises(SystemExit):
        cli.main(["build", str(tmp_path / "fynböš.toml")])
    ascii_only.seek(0)
    assert r"fynb\xf6\u0161.toml: expected a plot file" in ascii_only.read()


@pytest.mark.parametrize(
    "error",
    [
        MemoryError(),
        OSError(errno.ENOMEM, "Cannot allocate memory"),
        ImportError("libscipy.so: failed to map segment from shared object"),
        RuntimeError("RESOURCE_EXHAUSTED: Out of memory allocating 9 bytes"),
    ],
)
def test_too_little_memory_is_said(error: Exception) -> None:
    assert "too little memory" in cli._of_this_machine(error)
    assert "\n" not in cli._of_this_machine(error)


def test_a_device_that_is_not_there_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    def none() -> None:
        raise AssertionError

    assert cli._of_this_machine(ValueError("other")) == "ValueError: other"
    monkeypatch.setenv("JAX_PLATFORMS", "cuda")
    assert cli._of_this_machine(ValueError("other")) == "ValueError: other"  # JAX works here
    monkeypatch.setattr(jax, "devices", none)
    said = cli._of_this_machine(AssertionError())
    assert "no device of JAX_PLATFORMS=cuda" in said


def test_a_home_that_is_missing_or_a_file_costs_nothing(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("", "utf-8")
    code = (
        "from fynjax._core.compiler import keep_compiled\n"
        "from fynjax.app.cli._runtime import _alone\n"
        "from pathlib import Path\nimport sys\n"
        "keep_compiled()\nwith _alone(Path(sys.argv[1])): print('well')"
    )
    hidden = {"HOME", "XDG_CACHE_HOME", "JAX_COMPILATION_CACHE_DIR"}
    kept = {key: value for key, value in os.environ.items() if key not in hidden}
    home = {"HOME": str(tmp_path / "file")}
    run = subprocess.run(
        [sys.executable, "-c", code, str(tmp_path / "out")],
        env=kept | home, capture_output=True, text=True,
    )  # fmt: skip
    assert run.stdout == "well\n", run.stderr


@pytest.mark.parametrize(
    "line",
    [["convert", "X"], ["fit-leaf", "X"], ["pattern", "X"], ["simulate", "X"], ["terrain", "X"],
     ["validate", "--real-spectra", "X", "--simulated-spectra", "X"]],
)  # fmt: skip
def test_a_product_of_prisma_is_refused_with_what_to_do(line, tmp_path):
    path = tmp_path / "PRS_L2D_STD_20260101.he5"
    path.write_bytes(b"\x89HDF\r\n\x1a\n" + bytes(100))
    arguments = [str(path) if part == "X" else part for part in line]
    result = CliRunner().invoke(app, [*arguments, "--output", str(tmp_path / "out")])
    assert isinstance(result.exception, InputError)
    assert "EnMAP-Box in QGIS, 'Import PRISMA L2D product'" in str(result.exception)


def test_other_products_are_known_by_their_names(tmp_path):
    """Not a file of another name."""
    for name, product in (("ENMAP01-____L2A.TIF", "EnMAP L2A"), ("EMIT_L2A_RFL_001.nc", "EMIT L2A"),
                          ("DESIS-HSI-L2A.tif", "DESIS L2A"), ("orchard.nc", "")):  # fmt: skip
        said = how_to_import(tmp_path / name)
        assert said.endswith(f"'Import {product} product'.") == bool(product)
    path = tmp_path / "EMIT_L2A_RFL_001.nc"
    path.write_bytes(b"\x89HDF\r\n\x1a\n" + bytes(100))
    with pytest.raises(InputError, match=r"HDF5 or NetCDF\. `fynjax map` reads it as it is"):
        open_raster(path, "an image").__enter__()


SPECTRUM = "wavelength,reflectance\n" + "".join(f"{nm},0.1\n" for nm in range(400, 1000, 100))


def ended(*line, folder, before="", **environment):
    """Exit status, stdout and stderr of a command in a process of its own."""
    code = f"{before}\nfrom fynjax.app.cli import main\nmain()"
    hidden = {"HOME", "XDG_CACHE_HOME", "JAX_COMPILATION_CACHE_DIR", "MPLCONFIGDIR"}
    kept = {key: value for key, value in os.environ.items() if key not in hidden}
    paths = os.pathsep.join([str(Path(__file__).parents[2]), kept.get("PYTHONPATH", "")])
    run = subprocess.run(
        [sys.executable, "-c", code, *map(str, line)], cwd=folder, capture_output=True, text=True,
        env=kept | {"PYTHONPATH": paths} | environment,
    )  # fmt: skip
    return run.returncode, run.stdout, run.stderr


@posix
@pytest.mark.parametrize("home", [{}, {"HOME": "/proc/nothing"}])
def test_a_run_without_a_home_says_nothing_of_it(tmp_path, home):
    (tmp_path / "leaf.csv").write_text(SPECTRUM)
    line = ("convert", "leaf.csv", "--output", "out", "--quiet")
    assert ended(*line, folder=tmp_path, **home) == (0, "", "")
    assert {path.name for path in tmp_path.iterdir()} == {"leaf.csv", "out"}


@posix
@pytest.mark.parametrize(
    ("line", "words"),
    [
        (["--output", "o" * 300], "expected names of at most 255 bytes, but 'oooooo"),
        (["--output", "o" * 250], "cannot write here: File name too long"),
        (["l" * 300 + ".csv"], "the name is too long"),
        (["loop"], "loop: expected a file of spectra, but this is a link that leads back"),
        (["--output", "loop"], "loop: cannot write here: links lead back to themselves"),
        (["--output", "loop/x"], "loop/x: cannot write here: links lead back to themselves"),
    ],
)
def test_names_that_are_too_long_and_loops_of_links_are_one_line(
    tmp_path, monkeypatch, capsys, line, words
):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "leaf.csv").write_text(SPECTRUM)
    (tmp_path / "loop").symlink_to("loop")
    line = [*([] if "--output" not in line else ["leaf.csv"]), *line]
    with pytest.raises(SystemExit) as caught:
        cli.main(["convert", *line])
    out, err = capsys.readouterr()
    assert (caught.value.code, out, err.count("\n")) == (2, "", 1)
    assert words in err
    assert {path.name for path in tmp_path.iterdir()} == {"leaf.csv", "loop"}


@posix
def test_a_file_larger_than_the_process_may_write_is_called_so(tmp_path):
    """Also where a library of a format says 'HDF error'."""
    (tmp_path / "leaf.csv").write_text(SPECTRUM)
    limit = "import resource; resource.setrlimit(resource.RLIMIT_FSIZE, ({0}, {0}))"
    for size in (100, 8000):
        status, out, err = ended(
            "convert", "leaf.csv", "--output", "out", folder=tmp_path, before=limit.format(size)
        )
        assert (status, out, err.count("\n")) == (2, "", 1), err
        assert "no results were written: a file would be larger than this disk, or the" in err
        assert [path.name for path in tmp_path.iterdir()] == ["leaf.csv"]


@posix
@pytest.mark.parametrize(
    ("number", "words"),
    [(errno.EDQUOT, "your quota on this disk is used up"),
     (errno.EROFS, "this disk cannot be written"), (errno.ENOSPC, "the disk is full")],
)  # fmt: skip
def test_what_the_system_says_of_a_disk_is_said(number, words, tmp_path, monkeypatch, capsys):
    """While the results are written, and while they are moved: then they are kept beside."""
    monkeypatch.setattr("fynjax.app.cli._doors.check_sums_once", lambda: None)
    monkeypatch.setattr("fynjax.app.cli._runtime.keep_compiled", lambda: None)
    (tmp_path / "leaf.csv").write_text(SPECTRUM)
    line = ["convert", str(tmp_path / "leaf.csv"), "--output", str(tmp_path / "out")]

    def fail(*_: object) -> None:
        raise OSError(number, os.strerror(number))

    def run() -> str:
        with pytest.raises(SystemExit) as caught:
            cli.main(line)
        out, err = capsys.readouterr()
        assert (caught.value.code, out, err.count("\n")) == (2, "", 1)
        return err

    with monkeypatch.context() as patched:
        patched.setattr("fynjax.app.jobs._run.write_text", fail)
        assert f"no results were written: {words}" in run()
    assert [path.name for path in tmp_path.iterdir()] == ["leaf.csv"]
    move = os.replace

    def replace(source, destination):
        return fail() if Path(destination).parent.name == "out" else move(source, destination)

    with monkeypatch.context() as patched:
        patched.setattr(os, "replace", replace)
        err = run()
    assert f"cannot write here: {words}. The results are in out-2, beside it" in err
    assert (tmp_path / "out-2" / "spectra.csv").is_file()


def test_a_clock_that_was_set_back_changes_no_result(tmp_path, monkeypatch, capsys):
    """To before archives and certificates can be of; and then a run into the same folder."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    (tmp_path / "leaf.csv").write_text(SPECTRUM)
    line = ["fit-leaf", str(tmp_path / "leaf.csv"), "--output", str(tmp_path / "out"), "--quiet"]
    tables = []
    for now in (None, 1.0e8, 5.0):
        with monkeypatch.context() as patched:
            if now is not None:
                patched.setattr("time.time", lambda now=now: now)
            with pytest.raises(SystemExit) as caught:
                cli.main(line)
        assert caught.value.code == 0, capsys.readouterr().err
        tables.append((tmp_path / "out" / "traits.csv").read_bytes())
    assert tables[0] == tables[1] == tables[2]

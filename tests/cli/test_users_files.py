"""No run replaces or removes what is the user's: not its input, not what others wrote, not what was
changed since."""

import errno
import hashlib
import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from fynjax import jobs
from fynjax._core.files import existing_file
from fynjax.app.cli import main
from fynjax.app.io.raster import write_geotiff
from fynjax.app.io.text import EarlierRun, sealed
from fynjax.studies import fynbos_2006
from tests.canopy.test_pattern import BANDS as PATTERN_BANDS
from tests.canopy.test_pattern import drawn
from tests.helpers import unix


def call(capsys, *arguments):
    """Exit status, stdout, stderr of `fynjax ...`."""
    capsys.readouterr()
    with pytest.raises(SystemExit) as caught:
        main([str(a) for a in arguments])
    return caught.value.code, *capsys.readouterr()


def refused(capsys, *arguments):
    """The only line of a command that is refused."""
    status, out, err = call(capsys, *arguments)
    assert (status, out, err.count("\n")) == (2, "", 1), err
    return err


def content(folder):
    """What is in a folder, by name: bytes of files, where links lead."""
    return {
        p.relative_to(folder).as_posix(): os.readlink(p) if p.is_symlink() else p.read_bytes()
        for p in sorted(folder.rglob("*"))
        if p.is_symlink() or p.is_file()
    }


@pytest.fixture
def writes(monkeypatch):
    """What `fynjax demo` writes, by name; `input` there is a file that it reads first."""
    files = {"a.csv": "1", "deep/b.csv": "2"}

    def demo(output, **_):
        for name, text in files.items():
            if name == "input":
                existing_file(text, "an input")
                continue
            (output / name).parent.mkdir(exist_ok=True)
            (output / name).write_text(text)
        listed = {name: "what it is" for name in files if name != "input"}
        return jobs.JobResult(output=str(output), command="demo", seed=0, files=listed)

    monkeypatch.setattr(fynbos_2006, "demo", demo)
    monkeypatch.setattr("fynjax.app.cli._runtime.keep_compiled", lambda: None)
    return files


def test_a_run_goes_again_into_its_own_folder_and_removes_what_it_no_longer_writes(
    capsys, writes, tmp_path
):
    out = tmp_path / "out"
    assert call(capsys, "demo", "--output", out)[0] == 0
    (out / "a.csv.aux.xml").write_text("of QGIS")
    del writes["deep/b.csv"]
    writes["a.csv"] = "new"
    assert call(capsys, "demo", "--output", out)[::2] == (0, "")
    assert {*content(out)} == {"a.csv", "a.csv.aux.xml", "summary.json"}
    assert (out / "a.csv").read_text() == "new"
    summary = json.loads((out / "summary.json").read_text("utf-8"))
    assert summary["hashes"] == {"a.csv": hashlib.sha256(b"new").hexdigest()}


def _edit(out):
    (out / "a.csv").write_text("edited by hand")


def _edit_what_is_removed(out):
    (out / "deep" / "b.csv").write_text("edited by hand")


def _edit_the_summary(out):
    path = out / "summary.json"
    path.write_text(path.read_text("utf-8").replace('"seed": 0', '"seed": 7'), "utf-8")


def _another_command(out):
    path = out / "summary.json"
    path.write_text(path.read_text("utf-8").replace('"demo"', '"build"'), "utf-8")


def _no_list(out):
    (out / "summary.json").write_text("the essence of chapter 2")


def _without_hashes(out):
    path = out / "summary.json"
    record = json.loads(path.read_text("utf-8"))
    del record["hashes"]
    path.write_text(json.dumps(record), "utf-8")


def _a_link(out):
    (out / "a.csv").rename(out.parent / "elsewhere.csv")
    (out / "a.csv").symlink_to(out.parent / "elsewhere.csv")


CHANGED = {
    "changed since a run wrote it": _edit,
    "b.csv: this file is kept: it was changed since a run": _edit_what_is_removed,
    "summary.json: this file is kept: it was changed since": _edit_the_summary,
    "belongs to results of `fynjax build`": _another_command,
    "summary.json: this file is kept: it is no list": _no_list,
    "it has no hashes": _without_hashes,
    "a.csv: this file is kept: it is a link": _a_link,
}


@unix
@pytest.mark.parametrize("words", CHANGED)
def test_what_was_changed_since_stays_unless_asked(capsys, writes, tmp_path, words):
    out = tmp_path / "out"
    assert call(capsys, "demo", "--output", out)[0] == 0
    CHANGED[words](out)
    del writes["deep/b.csv"]
    writes["a.csv"] = "new"
    before = content(tmp_path)
    assert words in refused(capsys, "demo", "--output", out)
    assert words in refused(capsys, "demo", "--output", out, "--dry-run")
    assert content(tmp_path) == before
    status, _, err = call(capsys, "demo", "--output", out, "--overwrite")
    assert status == 0
    assert (out / "a.csv").read_text() == "new"
    # What it replaced, or left beside the results, is said; and is no longer strange.
    assert str(out) in err
    assert err.startswith("fynjax: warning: ")
    after = content(tmp_path)
    if "b.csv" in words:
        assert after["out/deep/b.csv"] == b"edited by hand"
        assert "kept" in err
    else:
        assert "replaced" in err
    if "elsewhere.csv" in before:
        assert after["elsewhere.csv"] == before["elsewhere.csv"]
    assert call(capsys, "demo", "--output", out)[0] == 0


def test_an_unpacked_archive_removes_no_file(capsys, writes, tmp_path):
    """A summary that lists files of the user, sealed or not."""
    (tmp_path / "sub").mkdir()
    for name in ("thesis.txt", "sub/data.csv"):
        (tmp_path / name).write_text("mine")
    other = tmp_path.with_name(tmp_path.name + "-other")
    other.write_text("mine")
    lists = {"thesis.txt": "", "sub/data.csv": ""}
    plain = {"command": "demo", "files": lists}
    hashes = {name: hashlib.sha256(b"theirs").hexdigest() for name in lists}
    hashed = plain | {"hashes": hashes}
    out_of = plain | {"hashes": {f"../{other.name}": hashlib.sha256(b"mine").hexdigest()}}
    for record in (plain, hashed, hashed | {"hash": sealed(hashed)}, out_of,
                   out_of | {"hash": sealed(out_of)}):  # fmt: skip
        (tmp_path / "summary.json").write_text(json.dumps(record), "utf-8")
        assert "this file is kept" in refused(capsys, "demo", "--output", tmp_path)
        assert call(capsys, "demo", "--output", tmp_path, "--overwrite")[0] == 0
        assert (tmp_path / "thesis.txt").read_text() == "mine"
        assert (tmp_path / "sub" / "data.csv").read_text() == "mine"
        assert other.read_text() == "mine"


def test_a_file_of_the_user_is_not_replaced_and_the_results_are_kept_beside(
    capsys, writes, tmp_path
):
    """Its name is known only when the run ends: then the work is not lost, either."""
    out = tmp_path / "out"
    out.mkdir()
    (out / "a.csv").write_text("mine")
    (out / "notes.txt").write_text("mine")
    err = refused(capsys, "demo", "--output", out)
    assert "out/a.csv: this file is kept: no earlier run of `fynjax demo` wrote it." in err
    assert "The results are in out-2, beside it" in err
    assert {n: len(c) for n, c in content(tmp_path).items() if "summary" not in n} == {
        "out/a.csv": 4, "out/notes.txt": 4, "out-2/a.csv": 1, "out-2/deep/b.csv": 1,
    }  # fmt: skip
    status, _, err = call(capsys, "demo", "--output", out, "--overwrite")
    assert (status, (out / "a.csv").read_text(), (out / "notes.txt").read_text()) == (
        0,
        "1",
        "mine",
    )
    assert f"replaced {out / 'a.csv'}: no earlier run" in err


@unix
def test_what_stands_in_the_way_is_not_replaced_even_if_asked(capsys, writes, tmp_path):
    out, elsewhere = tmp_path / "out", tmp_path / "elsewhere"
    (out / "a.csv").mkdir(parents=True)
    assert "it is a folder" in refused(capsys, "demo", "--output", out, "--overwrite")
    (out / "a.csv").rmdir()
    elsewhere.mkdir()
    (elsewhere / "b.csv").write_text("mine")
    (out / "deep").symlink_to(elsewhere)
    err = refused(capsys, "demo", "--output", out, "--overwrite")
    assert "the folder 'deep' that it belongs in is a link" in err
    assert (elsewhere / "b.csv").read_text() == "mine"
    # A link to a folder as the output itself leads where it leads.
    (out / "deep").unlink()
    link = tmp_path / "link"
    link.symlink_to(out)
    assert call(capsys, "demo", "--output", link)[0] == 0
    assert (out / "deep" / "b.csv").read_text() == "2"
    assert link.is_symlink()


def test_the_output_may_be_a_disk_of_its_own(capsys, writes, tmp_path, monkeypatch):
    """As a folder is that is mounted: no file can be renamed into it from beside."""
    out, rename = tmp_path / "out", os.replace
    out.mkdir()
    (out / "notes.txt").write_text("mine")

    def within(source, target):
        if Path(source).is_relative_to(out) != Path(target).is_relative_to(out):
            raise OSError(errno.EXDEV, os.strerror(errno.EXDEV), source)
        rename(source, target)

    monkeypatch.setattr(os, "replace", within)
    for text in ("1", "new"):
        writes["a.csv"] = text
        assert call(capsys, "demo", "--output", out)[::2] == (0, "")
        assert {*content(tmp_path)} == {
            f"out/{name}" for name in ("a.csv", "deep/b.csv", "notes.txt", "summary.json")
        }
        assert (out / "a.csv").read_text() == text

    def full(source, target):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), target)

    monkeypatch.setattr("shutil.copyfile", full)
    before = content(out)
    assert "The results are in out-2, beside it" in refused(capsys, "demo", "--output", out)
    assert content(out) == before
    assert (tmp_path / "out-2" / "a.csv").read_text() == "new"


@unix
def test_an_input_of_the_run_is_never_replaced(capsys, writes, tmp_path, monkeypatch):
    """Also where an earlier run wrote it, and where it is named by a link."""
    out = tmp_path / "out"
    assert call(capsys, "demo", "--output", out)[0] == 0
    (tmp_path / "link.csv").symlink_to(out / "a.csv")
    for source in (out / "a.csv", tmp_path / "link.csv"):
        writes["input"] = source
        for more in ((), ("--overwrite",)):
            err = refused(capsys, "demo", "--output", out, *more)
            assert "out/a.csv: this is an input of the run" in err
    (tmp_path / "link.csv").unlink()
    os.link(out / "a.csv", tmp_path / "link.csv")  # the same file by another name
    writes["input"] = tmp_path / "link.csv"
    assert "out/a.csv: this is an input" in refused(capsys, "demo", "--output", out, "--overwrite")
    # Nor is it removed; and what was edited since and is an input is nothing to refuse.
    del writes["a.csv"]
    (tmp_path / "link.csv").unlink()
    writes["input"] = out / "deep" / "b.csv"
    del writes["deep/b.csv"]
    (out / "a.csv").write_text("edited")
    monkeypatch.setattr("sys.argv", ["fynjax", "demo", f"--twin={out / 'a.csv'}"])
    assert call(capsys, "demo", "--output", out)[0] == 0
    assert (out / "a.csv").read_text() == "edited"
    assert (out / "deep" / "b.csv").read_text() == "2"


@pytest.mark.parametrize("text", ["", " "])
def test_an_empty_name_is_no_folder(capsys, writes, tmp_path, monkeypatch, text):
    monkeypatch.chdir(tmp_path)
    for option in ("--output", "--checkpoint"):
        err = refused(capsys, "render", "plot.toml", option, text)
        assert "expected the name of a folder, but got an empty text" in err
    assert not list(tmp_path.iterdir())


def test_the_working_folder_can_be_written_into(capsys, writes, tmp_path, monkeypatch):
    work = tmp_path / "work"
    work.mkdir()
    monkeypatch.chdir(work)
    (work / "notes.txt").write_text("mine")
    for _ in range(2):
        assert call(capsys, "demo", "--output", ".")[0] == 0
    names = ("a.csv", "deep/b.csv", "notes.txt", "summary.json")
    assert {*content(tmp_path)} == {f"work/{name}" for name in names}


def test_an_input_with_the_name_of_a_result_and_a_page_of_the_user_stay(
    capsys, tmp_path, monkeypatch
):
    """Real commands in the folder of their input; refused before their work."""
    heights = np.add.outer(np.arange(20.0), np.arange(20.0)) * 0.01
    work = tmp_path / "work"
    work.mkdir()
    monkeypatch.chdir(work)
    write_geotiff(work / "terrain.tif", heights[None].astype(np.float32), ["height"], pixel_m=0.5,
                  crs="EPSG:32734")  # fmt: skip
    write_geotiff(work / "map.tif", drawn()[0], PATTERN_BANDS, pixel_m=0.1)
    before = content(tmp_path)
    for command in ("terrain", "pattern"):
        source = "terrain.tif" if command == "terrain" else "map.tif"
        for name in (source, work / source):
            err = refused(capsys, command, name, "--output", ".", "--overwrite", "--quiet")
            assert f"error: {source}: this is an input of the run" in err
    (work / "report.html").write_text("mine")
    before["work/report.html"] = b"mine"
    for command, source, name in (("terrain", "terrain.tif", "height.tif"),
                                  ("pattern", "map.tif", "image.tif")):  # fmt: skip
        (work / source).rename(work / name)
        before[f"work/{name}"] = before.pop(f"work/{source}")
        err = refused(capsys, command, name, "--output", ".")
        assert f"report.html: this file is kept: no earlier run of `fynjax {command}`" in err
        assert "The results are in" not in err  # the names are known before the work
    assert content(tmp_path) == before


def test_two_runs_with_two_caches_do_not_write_into_one_folder(tmp_path):
    """What holds the folder lies beside it, not in anybody's home."""
    code = (
        "import sys, time\nfrom pathlib import Path\nfrom fynjax.app.cli._runtime import _alone\n"
        "from fynjax._core.errors import InputError\n"
        "try:\n"
        "    with _alone(Path(sys.argv[1])):\n        print('held', flush=True)\n"
        "        sys.stdin.read()\n"
        "except InputError as error:\n    print(error)\n"
    )

    def begin(cache):
        return subprocess.Popen(
            [sys.executable, "-c", code, str(tmp_path / "a" / "out")], text=True,
            stdin=subprocess.PIPE, stdout=subprocess.PIPE,
            env=os.environ | {"XDG_CACHE_HOME": str(tmp_path / cache)},
        )  # fmt: skip

    first = begin("one")
    try:
        assert first.stdout.readline() == "held\n"
        second, _ = begin("two").communicate("")
        assert "another run is writing into" in second
    finally:
        first.communicate("")
    third, _ = begin("two").communicate("")
    assert third == "held\n"
    assert not (tmp_path / "a").exists()


def test_lists_that_are_no_lists_lead_nowhere(tmp_path):
    assert EarlierRun(tmp_path / "nowhere", "demo").strange(["summary.json"]) == {}
    for text in ("[1]", '{"command": 3}', "{", '{"command": "demo", "hashes": []}', "[" * 5000):
        (tmp_path / "summary.json").write_text(text)
        run = EarlierRun(tmp_path, "demo")
        assert list(run.strange(["summary.json", "a.csv"])) == ["summary.json"]
        assert run.unchanged() == []
    for name in ("../a.csv", "/a.csv", "a/../../b", "", "a\0b", 300 * "a"):
        record = {"command": "demo", "hashes": {name: "0"}}
        record["hash"] = sealed(record)
        (tmp_path / "summary.json").write_text(json.dumps(record), "utf-8")
        assert EarlierRun(tmp_path, "demo").hashes == {}
    (tmp_path / "summary.json").write_bytes(b"\xff\xfe")
    assert EarlierRun(tmp_path, "demo").hashes == {}


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="Windows has no such pipes")
def test_a_pipe_or_a_device_for_a_list_of_results_is_not_read(tmp_path):
    for k, make in enumerate((os.mkfifo, lambda path: path.symlink_to("/dev/zero"))):
        folder = tmp_path / str(k)
        folder.mkdir()
        make(folder / "summary.json")
        assert EarlierRun(folder, "terrain").hashes == {}
        assert EarlierRun(folder, "terrain").strange(["summary.json"])


@pytest.mark.parametrize(
    "name", ["a\x1b[2Jb", "a\nb", "a\rb", "a\u202eb", "a\x9bb", "=1+1", "$\\frac{"]
)
def test_a_name_does_not_control_the_terminal(capsys, writes, tmp_path, name):
    for _ in range(2):
        _, out, err = call(capsys, "demo", "--output", tmp_path / name)
        assert (out + err).replace("\n", "").isprintable()
    (tmp_path / name / "a.csv").write_text("mine") if (tmp_path / name).is_dir() else None
    _, out, err = call(capsys, "demo", "--output", tmp_path / name)
    assert (out + err).replace("\n", "").isprintable()
    assert err.count("\n") <= 1

"""The commands parse, call their job, tell the result, and fail in one line.

The jobs themselves are stood in for: what is tested is the door, not the house.
"""

import gc
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
import warnings

import numpy as np
import pytest
from typer.testing import CliRunner

import fynjax
from fynjax import jobs
from fynjax._core.compiler import known_flags
from fynjax._core.errors import InputError, MissingExtraError
from fynjax.app.cli import app, main
from fynjax.app.cli._runtime import _alone
from fynjax.app.io.plot import as_plot, read_plot
from fynjax.sensors import shipped_lidars, shipped_sensors
from fynjax.studies import fynbos_2006
from tests.helpers import unix


class Fake(jobs.JobResult):
    """The result of a job that computes nothing."""

    array: list[jobs.Number]


COMMANDS = ["demo", "render", "calibrate", "fit-leaf", "init"]


def call(capsys, *arguments):
    """Exit status, stdout, stderr of `fynjax ...`."""
    with pytest.raises(SystemExit) as caught:
        main([str(a) for a in arguments])
    out, err = capsys.readouterr()
    return caught.value.code, out, err


@pytest.fixture
def calls(monkeypatch):
    """Stand-ins for the jobs; the list of what they were called with."""
    made = []

    def job(name):
        def run(*, output, **keywords):
            made.append((name, keywords))
            if name in ("render", "calibrate"):  # a job reads its plot before anything else
                as_plot(keywords["plot"])
            (output / "image.tif").write_text(name)
            return Fake(
                output=str(output),
                command=name,
                seed=keywords.get("seed") or 0,
                headline=[f"{name} is done."],
                files={"image.tif": "the image"},
                array=[1.0, np.nan],
            )

        return run

    of_commands = {"render": "render_plot", "calibrate": "calibrate", "fit_leaf": "fit_leaves"}
    for name, function in of_commands.items():
        monkeypatch.setattr(jobs, function, job(name), raising=False)
    monkeypatch.setattr(fynbos_2006, "demo", job("demo"), raising=False)
    monkeypatch.setattr("fynjax.app.cli._runtime.keep_compiled", lambda: None)
    return made


@pytest.fixture
def plot(tmp_path, capsys):
    assert call(capsys, "init", tmp_path / "plot", "--example", "fynbos")[0] == 0
    return tmp_path / "plot" / "plot.toml"


@pytest.mark.parametrize("command", COMMANDS)
def test_help_has_an_example(command):
    result = CliRunner().invoke(app, [command, "--help"])
    assert result.exit_code == 0
    assert f"Example:  fynjax {command}" in result.output
    for option in ("--output", "--seed", "--json", "--quiet"):
        assert option in result.output


def test_commands_are_shown_by_what_they_are_about(capsys):
    shown = CliRunner().invoke(app, ["--help"]).output
    titles = re.findall(r"─ ([A-Z][a-z ]+) ─", shown)
    panels = ["Plot", "Leaf", "This machine", "Sensors", "Inversion", "Validation", "Many plots"]
    assert titles == ["Options", *panels]
    assert shown.index("─ Inversion ─") < shown.index("posterior") < shown.index("─ Validation ─")
    group = CliRunner().invoke(app, ["bioscape", "--help"]).output
    assert all(re.search(rf"│ {name} ", group) for name in ("plots", "learn", "validate"))
    assert "No such command 'learn'" in one_line(*call(capsys, "learn"))


def test_values_with_commas_are_read_and_a_wrong_one_names_its_option(capsys, calls, tmp_path):
    spectrum = tmp_path / "a.csv"
    line = ["fit-leaf", spectrum, "--output", tmp_path / "o", "--detector-changes"]
    assert call(capsys, *line, "1000, 1830")[0] == 0
    assert calls[0][1]["detector_changes"] == (1000.0, 1830.0)
    for wrong in ("1000;1830", "1000,nan"):
        err = one_line(*call(capsys, *line, wrong))
        assert "`--detector-changes` must be numbers with commas between" in err
        assert "Wavelengths [nm] where detectors change" in err
        assert wrong in err


def test_an_error_of_a_job_names_options(capsys, calls, monkeypatch, tmp_path):
    def plant(source, *, output):
        raise InputError("`n_elements` is too small for `area`", file="a.obj")

    monkeypatch.setattr(jobs, "plant", plant, raising=False)
    err = one_line(*call(capsys, "plant", "a.obj", "--output", tmp_path / "o"))
    assert err == "fynjax: error: a.obj: `--elements` is too small for `area`\n"


def test_help_and_version_are_fast_and_load_no_jax():
    code = (
        "import sys\nfrom fynjax.app.cli import main\n"
        "try: main(['calibrate', '--help'])\nexcept SystemExit: pass\n"
        "heavy = {'jax', 'numpy', 'rasterio', 'xarray', 'matplotlib', 'pandas', 'scipy'}\n"
        "print('LOADED', sorted(heavy & set(sys.modules)))"
    )
    start = time.perf_counter()
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert "LOADED []" in done.stdout
    # The goal is 1 s on an idle machine; a busy one must not make the test fail.
    assert time.perf_counter() - start < 5


def test_without_the_packages_of_the_command_line_a_line_says_how_to_get_them():
    """Those of the library alone are there; as `python -m fynjax`, and as the script."""
    code = (
        "import sys\nsys.modules['typer'] = None\nfrom fynjax.__main__ import main\n"
        "sys.argv = ['fynjax', 'demo']\nmain()"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    line = one_line(done.returncode, done.stdout, done.stderr)
    assert line.endswith("'typer'. Install it with: pip install \"fynjax[all]\"\n")


def test_version(capsys):
    assert call(capsys, "--version") == (0, f"fynjax {fynjax.__version__}\n", "")


def test_demo_writes_moves_and_prints(capsys, calls, tmp_path):
    output = tmp_path / "a" / "b"
    status, out, err = call(capsys, "demo", "--output", output, "--seed", 5)
    assert (status, err) == (0, "")
    kept = tmp_path / "a" / "b.checkpoint"
    assert calls[0][1] == {"seed": 5, "checkpoint": kept}  # all else is as the job has it
    assert sorted(p.name for p in output.iterdir()) == ["image.tif", "summary.json"]
    assert [p.name for p in output.parent.iterdir()] == ["b"]
    assert "demo is done." in out
    assert str(output) in out
    assert "image.tif  the image" in out


def test_json_is_all_that_stdout_has(capsys, calls, tmp_path):
    status, out, err = call(capsys, "demo", "--output", tmp_path / "o", "--json")
    assert (status, err) == (0, "")
    summary = json.loads(out)
    assert summary["command"] == "demo"
    assert summary["version"] == fynjax.__version__
    assert summary["output"] == str(tmp_path / "o")
    assert summary["seed"] == 0
    assert summary["array"] == [1.0, None]  # JSON has no NaN
    assert json.loads((tmp_path / "o" / "summary.json").read_text("utf-8")) == summary


def test_quiet_says_nothing(capsys, calls, tmp_path):
    assert call(capsys, "demo", "--output", tmp_path / "o", "--quiet") == (0, "", "")


@pytest.mark.parametrize("command", ["render", "build", "simulate", "sensitivity"])
def test_a_plot_is_read_once_and_its_seed_taken_unless_given(
    capsys, monkeypatch, plot, tmp_path, command
):
    text = plot.read_text("utf-8")
    plot.write_text(text.replace("seed = 0", "seed = 11"), "utf-8")
    read, built = [], []

    def count(path, **options):
        read.append(path)
        return read_plot(path, **options)

    def build(plot, *, seed=None, **_):
        built.append(seed)
        raise InputError("far enough")

    for module in ("fynjax.app.io.plot", "fynjax.app.io.plot._plot_file"):
        monkeypatch.setattr(f"{module}.read_plot", count)
    for module in ("jobs._render", "jobs._build", "jobs._simulate", "assembly._forward"):
        monkeypatch.setattr(f"fynjax.app.{module}.build_plot", build)
    for seed in ([], ["--seed", 3]):
        done = call(capsys, command, plot, "--output", tmp_path / "o", *seed)
        assert "far enough" in one_line(*done)
    assert read == [plot, plot]
    assert built == [11, 3]


def test_calibrate_and_fit_leaf_pass_their_files(capsys, calls, plot, tmp_path):
    target = plot.parent / "statistics.csv"
    done = call(capsys, "calibrate", plot, "--target", target, "--output", tmp_path / "o")
    assert done[0] == 0
    assert calls[0][0] == "calibrate"
    given = calls[0][1]
    assert (given["plot"].file, given["targets"]) == (plot, [str(target)])
    spectra = [tmp_path / "a.csv", tmp_path / "b.asd"]
    for path in spectra:
        path.write_text("x")
    arguments = ["fit-leaf", *spectra, "--output", tmp_path / "t", "--version", "PRO"]
    assert call(capsys, *arguments)[0] == 0
    assert calls[1][1] == {
        "paths": [str(path) for path in spectra],
        "version": "PRO",
        "checkpoint": tmp_path / "t.checkpoint",
    }


def one_line(status, out, err):
    assert status in (1, 2)
    assert out == ""
    assert err.startswith("fynjax: error: ")
    assert err.count("\n") == 1
    assert "Traceback" not in err
    return err


@pytest.mark.parametrize(
    ("arguments", "word"),
    [
        (["render"], "PLOT.toml"),
        (["renderr"], "render"),
        (["render", "nothing.toml"], "nothing.toml"),
        (["demo", "--seed", "x"], "--seed"),
        (["demo", "--seed", "-1"], "--seed"),
        (["demo", "--frob"], "--frob"),
        (["fit-leaf"], "SPECTRUM"),
        (["posterior", "plot.toml"], "--target"),
    ],
)
def test_wrong_arguments_are_one_line(capsys, calls, tmp_path, monkeypatch, arguments, word):
    monkeypatch.chdir(tmp_path)
    status, out, err = call(capsys, *arguments)
    assert status == 2
    assert word in one_line(status, out, err)
    assert list(tmp_path.iterdir()) == []


def test_a_bad_table_is_one_line_and_no_output(capsys, plot, tmp_path):
    species = plot.parent / "species.csv"
    text = species.read_text("utf-8")
    species.write_text(text.replace("irregularis,40,20", "irregularis,-40,20"))
    err = one_line(*call(capsys, "render", plot, "--output", tmp_path / "o"))
    row = next(
        n for n, line in enumerate(text.splitlines(), 1) if line.startswith("Erica irregularis")
    )
    assert f"species.csv, row {row}, column 'mean_diameter_cm'" in err
    assert "-40" in err
    assert not (tmp_path / "o").exists()


@pytest.mark.parametrize(
    ("error", "status", "words"),
    [
        (InputError("two\nlines", file="a.csv", row=3), 2, "a.csv, row 3: two lines"),
        (MissingExtraError("blackjax", "posterior"), 1, 'pip install "fynjax[posterior]"'),
        (ModuleNotFoundError(name="rasterio.io"), 1, "'rasterio'. Install it with: pip install"),
        (ModuleNotFoundError("no fynjax.x", name="fynjax.x"), 1, "no fynjax.x"),
        (ZeroDivisionError("oh"), 1, "ZeroDivisionError: oh"),
    ],
)
def test_a_failing_job_leaves_nothing(capsys, calls, monkeypatch, tmp_path, error, status, words):
    def demo(output, **_):
        (output / "half.tif").write_text("half")
        warnings.warn("lost with the run", stacklevel=1)
        raise error

    monkeypatch.setattr(fynbos_2006, "demo", demo)
    monkeypatch.delenv("FYNJAX_DEBUG", raising=False)
    done = call(capsys, "demo", "--output", tmp_path / "o")
    assert done[0] == status
    assert words in one_line(*done)
    assert list(tmp_path.iterdir()) == []


def test_debug_shows_the_traceback(calls, monkeypatch, tmp_path):
    def demo(output, **_):
        raise InputError("bad")

    monkeypatch.setattr(fynbos_2006, "demo", demo)
    monkeypatch.setenv("FYNJAX_DEBUG", "1")
    with pytest.raises(InputError):
        main(["demo", "--output", str(tmp_path / "o")])


def test_ctrl_c_is_130_and_leaves_nothing(capsys, calls, monkeypatch, tmp_path):
    def demo(output, **_):
        (output / "half.tif").write_text("half")
        raise KeyboardInterrupt

    monkeypatch.setattr(fynbos_2006, "demo", demo)
    status, out, err = call(capsys, "demo", "--output", tmp_path / "o")
    assert (status, out) == (130, "")
    assert err == "fynjax: interrupted; nothing was written\n"
    assert list(tmp_path.iterdir()) == []


@unix
@pytest.mark.parametrize("dropped", [False, True])
@pytest.mark.parametrize(
    ("number", "status", "word"),
    [(signal.SIGINT, 130, "interrupted"), (signal.SIGTERM, 143, "ended")],
)
def test_a_signal_ends_a_run_also_where_a_library_drops_it(
    capsys, calls, monkeypatch, tmp_path, dropped, number, status, word
):
    reached = []

    def send(phase="", info=None):
        if send in gc.callbacks:
            gc.callbacks.remove(send)
        os.kill(os.getpid(), number)
        for _ in range(1000):  # the exception comes here, where Python drops it
            pass

    def demo(output, **_):
        if dropped:
            gc.callbacks.append(send)
            gc.collect()
        else:
            send()
        end = time.monotonic() + 10.0
        while time.monotonic() < end:
            pass
        reached.append(True)

    before = sys.unraisablehook
    monkeypatch.setattr(fynbos_2006, "demo", demo)
    came, out, err = call(capsys, "demo", "--output", tmp_path / "o")
    assert (came, out) == (status, "")
    assert err == f"fynjax: {word}; nothing was written\n"
    assert reached == []
    assert sys.unraisablehook is before
    assert list(tmp_path.iterdir()) == []


@unix
def test_another_ctrl_c_while_a_run_ends_changes_nothing(capsys, calls, monkeypatch, tmp_path):
    def demo(output, **_):
        (output / "half.tif").write_text("half")
        signal.raise_signal(signal.SIGINT)

    def remove(*arguments, **how):
        signal.raise_signal(signal.SIGINT)
        removed(*arguments, **how)

    removed = shutil.rmtree
    monkeypatch.setattr(fynbos_2006, "demo", demo)
    monkeypatch.setattr(shutil, "rmtree", remove)
    status, _, err = call(capsys, "demo", "--output", tmp_path / "o")
    assert (status, err) == (130, "fynjax: interrupted; nothing was written\n")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("arguments", [("sensors",), ("demo", "--seed", "x")])
def test_a_ctrl_c_while_python_ends_shows_no_traceback(capsys, arguments):
    call(capsys, *arguments)
    signal.raise_signal(signal.SIGINT)


def test_results_that_are_removed_while_others_are_written_end_in_a_line(
    capsys, calls, monkeypatch, tmp_path
):
    def demo(output, **_):
        (output / "two.csv").write_text("2")
        files = {"one.csv": "removed", "two.csv": "there"}
        return Fake(output="", seed=0, command="demo", status="ok", headline=[], array=[],
                    files=files)  # fmt: skip

    monkeypatch.setattr(fynbos_2006, "demo", demo)
    status, _, err = call(capsys, "demo", "--output", tmp_path / "o")
    assert status == 2
    assert "1 of 2 results, such as one.csv, were removed while the run wrote" in err
    assert list(tmp_path.iterdir()) == []


def test_warnings_of_a_run_are_printed_once_and_kept(capsys, calls, monkeypatch, tmp_path):
    def demo(output, **_):
        for _ in range(2):
            warnings.warn("3 of 600 pixels are masked", stacklevel=1)
        warnings.warn("not for users", DeprecationWarning, stacklevel=1)
        return jobs.JobResult(output=str(output), command="demo", seed=0)

    monkeypatch.setattr(fynbos_2006, "demo", demo)
    status, out, err = call(capsys, "demo", "--output", tmp_path / "o", "--json")
    assert status == 0
    assert err == "fynjax: warning: 3 of 600 pixels are masked\n"
    assert json.loads(out)["warnings"] == ["3 of 600 pixels are masked"]


def test_two_runs_do_not_write_into_one_folder(capsys, calls, tmp_path, monkeypatch):
    """The second is refused, and works when the first has ended; another folder is free."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    output = tmp_path / "out"
    with _alone(output):
        status, _, err = call(capsys, "demo", "--output", output)
        assert status == 2
        assert "another run is writing into" in err
        assert call(capsys, "demo", "--output", tmp_path / "else")[0] == 0
    assert call(capsys, "demo", "--output", output)[0] == 0


def test_what_a_killed_run_left_long_ago_is_cleared_away(capsys, calls, tmp_path):
    """Not what is young, and may be of a run on another machine, nor what is the user's."""
    names = (".o.2.0123abcd.partial", ".o.2.89abcdef.partial", ".o.2.mine.partial")
    old, young, own = (tmp_path / name for name in names)
    for each in (old, young, own):
        each.mkdir()
        (each / "half.tif").write_text("half")
    for each in (old, own):
        os.utime(each, (time.time() - 1e6,) * 2)
    assert call(capsys, "demo", "--output", tmp_path / "o.2")[0] == 0
    assert [each.exists() for each in (old, young, own)] == [False, True, True]


def test_a_doubtful_result_says_so_first_and_fails_only_if_asked(
    capsys, calls, monkeypatch, tmp_path
):
    def doubtful(output, **_):
        return Fake(output="", seed=0, command="demo", status="not converged: limit of steps",
                    headline=["Done."], array=[])  # fmt: skip

    monkeypatch.setattr(fynbos_2006, "demo", doubtful)
    status, out, _ = call(capsys, "demo", "--output", tmp_path / "a")
    assert (status, out.splitlines()[0]) == (0, "Status: not converged: limit of steps")
    status, _, _ = call(capsys, "demo", "--output", tmp_path / "b", "--strict")
    assert status == 3
    assert (tmp_path / "b" / "summary.json").is_file()


def test_output_that_is_a_file_is_refused(capsys, calls, tmp_path):
    (tmp_path / "o").write_text("mine")
    err = one_line(*call(capsys, "demo", "--output", tmp_path / "o"))
    assert "this is a file" in err
    assert (tmp_path / "o").read_text() == "mine"


@pytest.mark.parametrize("year", [2016, 2019])
def test_init_writes_a_plot_of_another_fire_and_says_what_is_assumed(capsys, tmp_path, year):
    from fynjax.app.io.plot import read_plot

    target = tmp_path / "plot"
    status, out, _ = call(capsys, "init", target, "--burnt", year, "--json")
    assert status == 0
    assert "assumptions" in json.loads(out)["warnings"][0]
    plot = read_plot(target / "plot.toml")
    assert f"burnt {year} (assumed)" in plot.name
    assert sum(s.cover for s in plot.species) < 0.9
    assert plot.ground.char_fraction > 0.05
    assert "ASSUMED" in (target / "species.csv").read_text()
    assert not (target / "statistics.csv").exists()
    guide = (target / "README.txt").read_text()
    assert "ASSUMED" in guide
    assert "statistics.csv" not in guide
    assert "--burnt" in one_line(*call(capsys, "init", tmp_path / "b", "--burnt", 2022))


@pytest.mark.parametrize(
    ("example", "taxa", "plants"),
    [([], 9, "generic"), (["--example", "heath"], 9, "generic"),
     (["--example", "fynbos"], 13, "fynbos")],
)  # fmt: skip
def test_init_writes_a_plot_that_reads_and_overwrites_nothing(
    capsys, tmp_path, example, taxa, plants
):
    target = tmp_path / "plot"
    status, out, err = call(capsys, "init", target, "--seed", 9, *example)
    assert (status, err) == (0, "")
    assert f"fynjax build {target / 'plot.toml'}" in out
    read = read_plot(target / "plot.toml")
    assert read.seed == 9
    assert len(read.species) == taxa
    assert read.shrubland == plants
    (target / "species.csv").write_text("mine")
    assert "overwrites nothing" in one_line(*call(capsys, "init", target))
    assert (target / "species.csv").read_text() == "mine"
    status, out, _ = call(capsys, "init", "--output", tmp_path / "other", "--json", *example)
    assert status == 0
    assert sorted(json.loads(out)["files"]) == sorted(os.listdir(tmp_path / "other"))
    assert "one folder" in one_line(*call(capsys, "init", "a", "--output", "b"))


def test_init_takes_a_table_of_one_s_own_by_its_words(capsys, tmp_path):
    own = tmp_path / "releve.csv"
    own.write_text("Species,Cover,Height (cm)\nErica arborea,40,120\n", "utf-8")
    options = ("--table", own, "--place", "-34.2,18.9")
    status, out, err = call(capsys, "init", tmp_path / "plot", *options)
    assert (status, err) == (0, "")
    assert "Growth forms by genus: Erica arborea upright_ericoid." in out
    assert read_plot(tmp_path / "plot" / "plot.toml").place_deg == (-34.2, 18.9)
    for arguments, word in (
        (("--place", "1,2"), "expected `--table`"),
        (("--table", own, "--burnt", 2016), "but got both"),
        (("--table", own, "--place", "north"), "2 numbers with commas between"),
        (("--table", own, "--place", "200,1"), "expected `place` as latitude"),
        (("--example", "heath", "--burnt", 2016), "--example fynbos"),
    ):  # fmt: skip
        assert word in one_line(*call(capsys, "init", tmp_path / "other", *arguments))


def test_init_without_a_prior_takes_nothing_that_was_learned(capsys, tmp_path):
    from fynjax.app.io.plot import leaf_factors, read_prior

    for prior in ("none", "fynbos_2023"):
        arguments = ("--example", "fynbos", "--prior", prior)
        assert call(capsys, "init", tmp_path / prior, *arguments)[0] == 0
    none, learned = (read_plot(tmp_path / prior / "plot.toml") for prior in ("none", "fynbos_2023"))
    assert (none.plants, learned.plants) == ("generic", "fynbos")
    assert all(one.leaf_area_index is None for one in none.species)
    factors = leaf_factors(read_prior("fynbos_2023").values())
    for before, after in zip(learned.leaves, none.leaves, strict=True):
        for name in ("chlorophyll", "water", "dry_matter"):
            ratio = getattr(before, name) / getattr(after, name)
            assert ratio == pytest.approx(factors[name], rel=0.01)


@pytest.mark.parametrize("burnt", [2006, 2016])
def test_init_states_means_and_spreads_of_a_prior(capsys, tmp_path, burnt):
    """As plots elsewhere have them; leaves move by the factors of the file over the shipped."""
    from fynjax.app.io.plot import example_folder, read_prior, with_prior, write_prior
    from tests.io.test_prior import prior_file

    write_prior(tmp_path / "prior.toml", prior_file())
    prior, shipped = read_prior(tmp_path / "prior.toml"), read_prior("fynbos_2023")
    arguments = ("--burnt", burnt, "--prior", tmp_path / "prior.toml")  # of the fynbos plot
    assert call(capsys, "init", tmp_path / "plot", *arguments)[0] == 0
    plot = read_plot(tmp_path / "plot" / "plot.toml")
    assert (tmp_path / "plot" / "plot.toml").read_text().count('prior.toml: Plots of "fynbos"') == 1
    for one in plot.species:
        leafy = one.growth_form != "deadwood"
        stated = (one.leaf_area_index, one.dead_fraction, one.shoot_clumping)
        assert stated == ((0.4,) * 3 if leafy else (None,) * 3)
        if leafy:
            for kind in ("leaf_area_index", "dead_fraction", "shoot_clumping"):
                spread = prior.sd(f"{kind}.{one.growth_form}", elsewhere=True) / 0.4
                found = plot.calibration.relative_sd(f"species.{one.taxon}.{kind}")
                assert found == pytest.approx(spread, abs=0.006)
    assert plot.ground.wood_brightness == 0.4
    assert plot.calibration.relative_sd("ground.wood_brightness") == pytest.approx(0.16, abs=0.006)
    leaf, usual = (
        next(row for row in read.leaves if row.taxon == "Restio eleocharis")
        for read in (plot, read_plot(example_folder() / "plot.toml"))
    )
    changed = 0.4 / shipped.values()["chlorophyll"]
    assert leaf.chlorophyll / usual.chlorophyll == pytest.approx(changed, rel=0.01)
    # What is stated is no longer open to a prior.
    assert with_prior(plot, "fynbos_2023").species == plot.species
    assert "wide" in one_line(*call(capsys, "init", tmp_path / "b", "--prior", "wide"))


def test_the_cache_folder_follows_jax_or_xdg_and_the_compiler_xla_flags(tmp_path):
    code = (
        "from fynjax.app.cli._runtime import keep_compiled\nkeep_compiled()\nimport jax, os\n"
        "print(jax.config.jax_compilation_cache_dir, os.environ['XLA_FLAGS'])\n"
        "jax.numpy.ones(3).sum()"  # flags that the compiler does not know would end it
    )
    own, ours = tmp_path / "own", tmp_path / "fynjax" / "jax"
    environment = {**os.environ, "XDG_CACHE_HOME": str(tmp_path)}
    theirs = "--xla_cpu_enable_fast_math=false"
    for stated, shown in (
        ({"JAX_COMPILATION_CACHE_DIR": str(own), "XLA_FLAGS": theirs}, [str(own), theirs]),
        ({}, [str(ours), *known_flags()]),
    ):
        for name in ("JAX_COMPILATION_CACHE_DIR", "XLA_FLAGS"):
            environment.pop(name, None)
        done = subprocess.run(
            [sys.executable, "-c", code], capture_output=True, text=True, check=True,
            env=environment | stated,
        )  # fmt: skip
        assert done.stdout.split() == shown
    assert (tmp_path / "fynjax" / "jax").is_dir()


def test_compiled_programs_that_are_kept_are_read_without_a_word(tmp_path):
    """A compiler's false alarm about its own settings, once for each program, is no news."""
    code = (
        "import sys\nfrom fynjax.app.cli import main\nassert 'jax' not in sys.modules\n"
        "try:\n    main(['--version'])\nexcept SystemExit:\n    pass\n"
        "import jax\nprint(jax.jit(lambda x: jax.numpy.sin(x) @ x)(jax.numpy.ones((9, 9))).sum())"
    )
    environment = {k: v for k, v in os.environ.items() if k != "TF_CPP_MIN_LOG_LEVEL"}
    environment |= {
        "JAX_COMPILATION_CACHE_DIR": str(tmp_path),
        "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0",
        "JAX_PERSISTENT_CACHE_MIN_ENTRY_SIZE_BYTES": "-1",
    }
    for _ in range(2):
        done = subprocess.run(
            [sys.executable, "-c", code], capture_output=True, text=True, check=True,
            env=environment,
        )  # fmt: skip
        assert done.stderr == ""
    assert list(tmp_path.glob("*cache"))


def test_view_opens_the_page_of_a_run_or_prints_its_path(capsys, tmp_path, monkeypatch):
    page = tmp_path / "report.html"
    page.write_text("<p>")
    opened = []
    for works, arguments in ((True, ()), (False, ()), (True, ("--print",))):
        monkeypatch.setattr(
            "webbrowser.open", lambda address, works=works: opened.append(address) or works
        )
        assert call(capsys, "view", tmp_path, *arguments)[:2] == (
            0,
            "" if works and not arguments else f"{page.resolve()}\n",
        )
    assert opened == [page.resolve().as_uri()] * 2
    assert call(capsys, "view", page, "--print")[:2] == (0, f"{page.resolve()}\n")
    page.rename(tmp_path / "traits.csv")
    code, _, err = call(capsys, "view", tmp_path)
    assert (code, err.count("\n")) == (2, 1)
    assert "report.html" in err
    assert "traits.csv" in err


def test_sensors_lists_all_with_their_kind(capsys):
    code, out, _ = call(capsys, "sensors", "--json")
    rows = {row["name"]: row for row in json.loads(out)}
    assert code == 0
    assert set(rows) == {*shipped_sensors(), *shipped_lidars()}
    assert rows["scanning_lidar"]["kind"] == "scanning LiDAR"
    assert rows["aviris_ng"]["kind"] == "spectrometer"
    # Focal length and pitch as the maker states them: 50 m x 2 um / 4.34 mm.
    assert rows["mavic_3m"]["pixel_m"] == pytest.approx(0.02304, abs=1e-4)
    assert rows["flash_lidar_paper"]["pixel_m"] == pytest.approx(0.04, abs=1e-3)
    code, out, _ = call(capsys, "sensors")
    assert code == 0
    assert all(name in out for name in rows)


@pytest.mark.parametrize(
    ("line", "option"),
    [("validate --real-drone a.tif --simulated-drone b.tif --real-drone c.tif", "--real-drone"),
     ("render plot.toml --seed 1 --seed 2", "--seed"),
     ("bioscape learn --seed=1 --seed=1", "--seed"),
     ("reflectance a.tif --align --no-align", "--align")],
)  # fmt: skip
def test_a_second_value_of_an_option_is_refused_and_does_not_replace_the_first(
    capsys, line, option
):
    status, _, err = call(capsys, *line.split())
    assert (status, err) == (2, f"fynjax: error: expected `{option}` once, but got it 2 times\n")
    # Several values, and a flag that says the same twice, are as before.
    twice = ("--target", "a", "--target", "b", "--quiet", "--quiet")
    _, _, err = call(capsys, "calibrate", "a.toml", *twice)
    assert "no such file" in err

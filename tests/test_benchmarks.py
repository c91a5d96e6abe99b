"""Every benchmark runs, as small as it goes, and prints numbers."""

import ast
import importlib
import inspect
import re
from pathlib import Path

import pytest

from tests import benchmarks

FOLDER = Path(benchmarks.__file__).parent
NAMES = sorted(path.stem for path in FOLDER.glob("*.py") if path.stem[0] != "_")
LONG = {"bench_demo", "bench_workers", "flight", "flight_twins", "journeys", "known_plants",
        "map_plots", "other_truths", "pictures", "places", "table_compile", "table_gpu",
        "table_radiation", "table_slopes", "table_solvers", "twins"}  # fmt: skip
"""More than 12 s, run with the studies; imported in the check too."""
FIGURES = {
    "bench_bands": (r"worst mean (\S+) %", 0.0, 0.1),
    "table_canopy": (r"fynjax / 32 streams +nir +\S+ +(\S+)", 0.0, 0.1),
    "table_radiation": (r"depth 4, structure: light stopped +(\S+)", -0.5, 0.5),
}
"""A number that a benchmark prints, and within what bounds it lies however small it is run."""


@pytest.mark.filterwarnings("ignore::UserWarning")  # of what the data themselves lack
@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=[pytest.mark.study] * (n in LONG)) for n in NAMES]
)
def test_it_runs_and_prints_numbers(name, request, tmp_path, monkeypatch, capsys):
    if re.search("data_folder|bioscape_plots", (FOLDER / f"{name}.py").read_text("utf-8")):
        request.getfixturevalue("shared_data")
    monkeypatch.chdir(tmp_path)
    importlib.import_module(f"tests.benchmarks.{name}").main(["--tiny"])
    printed = capsys.readouterr().out
    numbers = re.findall(r"(?<![\w.])[-+]?\d+(?:\.\d+)?(?:e[-+]?\d+)?(?![\w.])", printed)
    assert len(numbers) >= 5, printed
    assert not re.search(r"\b(nan|inf)\b", printed, re.IGNORECASE), printed
    if name in FIGURES:
        pattern, low, high = FIGURES[name]
        (found,) = re.findall(pattern, printed)
        assert low <= float(found) <= high, printed


@pytest.mark.parametrize("name", NAMES)
def test_it_measures_the_package_as_it_is(name):
    """Nothing imported is replaced: what a patch meets may have been renamed since."""
    tree = list(ast.walk(ast.parse((FOLDER / f"{name}.py").read_text("utf-8"))))
    names = {
        alias.asname or alias.name.split(".")[0]
        for node in tree if isinstance(node, (ast.Import, ast.ImportFrom)) for alias in node.names
    }  # fmt: skip
    assert not {"mock", "unittest", "setattr"} & (
        names | {node.id for node in tree if isinstance(node, ast.Name)}
    )
    for node in tree:
        if isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Store):
            assert getattr(node.value, "id", None) not in names, ast.unparse(node)


def test_what_it_is_for_is_said_first():
    """And how to run it: `--help` prints the same."""
    for name in NAMES:
        text = inspect.getdoc(importlib.import_module(f"tests.benchmarks.{name}"))
        assert text is not None, name
        assert f"python -m tests.benchmarks.{name}" in text

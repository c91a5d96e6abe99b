"""The notebooks are scripts and, without outputs, Jupyter files; they run from top to bottom."""

import ast
import io
import re
from functools import partial
from pathlib import Path

import jax
import jupytext
import matplotlib.pyplot as plt
import pytest

import fynjax as fx

ROOT = Path(__file__).resolve().parents[1]
NOTEBOOKS = sorted((ROOT / "notebooks").glob("*.py"))
LONGEST = 70
"""Lines of code that a notebook has at most."""
by_name = pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)


def test_there_are_notebooks_and_nothing_beside_them() -> None:
    assert NOTEBOOKS
    files = {p.name for p in (ROOT / "notebooks").iterdir()}
    assert files - {".ipynb_checkpoints", "__pycache__"} == {
        f"{path.stem}{suffix}" for path in NOTEBOOKS for suffix in (".py", ".ipynb")
    }


@by_name
def test_the_jupyter_file_is_the_script_without_outputs(path: Path) -> None:
    script = jupytext.read(path, fmt="py:percent")
    paired = jupytext.read(path.with_suffix(".ipynb"))
    cells = [[(c.cell_type, c.source) for c in notebook.cells] for notebook in (script, paired)]
    assert cells[0] == cells[1], "`jupytext --sync notebooks/*.py` makes both equal"
    (shown,) = re.findall(r"!\[[^]]+\]\((\S+)\)", cells[0][0][1])  # which GitHub shows
    assert (path.parent / shown).is_file()
    assert not any(c.get("outputs") or c.get("execution_count") for c in paired.cells)


@by_name
def test_files_to_take_are_named_in_the_first_cell(path: Path) -> None:
    first, *rest = [
        c.source for c in jupytext.read(path, fmt="py:percent").cells if c.cell_type == "code"
    ]
    kinds = ("PLOT", "TABLE", "SPECTRUM", "FOLDER", "IMAGE")
    for settings in ("PLOT", "TABLE", "SPECTRUM", "FOLDER"):
        assert not any(f"\n{settings} =" in f"\n{source}" for source in rest)
    assert not any("example_folder()" in source for source in rest)
    assert any(f"\n{settings} =" in f"\n{first}" for settings in kinds)


@by_name
def test_notebook_tells_a_story_in_the_public_interface(path: Path) -> None:
    notebook = jupytext.read(path, fmt="py:percent")
    assert notebook.cells[0].cell_type == "markdown"
    assert notebook.cells[0].source.startswith("# ")
    for node in ast.walk(ast.parse(path.read_text("utf-8"))):
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("fynjax"):
            assert "._" not in (node.module or ""), f"{node.module} is private"
            assert not any(alias.name.startswith("_") for alias in node.names)


@by_name
def test_of_fynjax_a_notebook_imports_the_front_door_alone(path: Path) -> None:
    cells = jupytext.read(path, fmt="py:percent").cells
    code = [c.source for c in cells if c.cell_type == "code"]
    imported = []
    for node in ast.walk(ast.parse("\n".join(code))):
        if isinstance(node, ast.Import):
            imported += [(a.name, a.asname) for a in node.names if a.name.startswith("fynjax")]
        elif isinstance(node, ast.ImportFrom):
            assert not (node.module or "").startswith("fynjax")
    assert set(imported) == {("fynjax", "fx")}
    text = "\n".join(code)  # which asks the compiler for silence before JAX is imported
    assert text.index("import fynjax as fx") < (text + "import jax").index("import jax")
    lines = [line for source in code for line in source.splitlines() if line.strip()]
    assert sum(not line.lstrip().startswith("#") for line in lines) <= LONGEST


@pytest.mark.slow
@by_name
def test_notebook_runs(
    path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    """Here, not in a kernel of its own, which would import and compile everything anew. The
    documentation's build runs the notebooks in kernels."""
    drawn = []

    def show() -> None:
        """Draw all figures, as Jupyter does at the end of a cell."""
        for number in plt.get_fignums():
            plt.figure(number).savefig(io.BytesIO())
            drawn.append(number)
        plt.close("all")

    monkeypatch.setenv("FYNJAX_FAST", "1")
    monkeypatch.setattr(fx, "read_scene", partial(fx.read_scene, voxel=0.25))  # m: quicker
    monkeypatch.setattr(plt, "show", show)
    # Its own folder: a notebook that writes a file does not write it into the checkout.
    monkeypatch.chdir(tmp_path)
    names = {"__name__": "__main__"}
    with jax.enable_x64(False):  # as its reader's process
        for cell in jupytext.read(path, fmt="py:percent").cells:
            if cell.cell_type == "code":
                exec(compile(cell.source, f"{path.name}: {cell.source[:60]!r}", "exec"), names)
    assert not capfd.readouterr().err
    assert len(drawn) == path.read_text("utf-8").count("plt.show()") > 0
    plt.close("all")

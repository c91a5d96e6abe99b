"""The notebooks are plain text without outputs, and run from top to bottom."""

import ast
import os
from pathlib import Path

import jupytext
import pytest
from nbclient import NotebookClient

ROOT = Path(__file__).resolve().parents[1]
NOTEBOOKS = sorted((ROOT / "notebooks").glob("*.py"))
by_name = pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)


def test_there_are_notebooks_and_no_outputs_beside_them() -> None:
    assert NOTEBOOKS
    others = [p.name for p in (ROOT / "notebooks").iterdir() if p.suffix not in {".py", ".ipynb"}]
    assert set(others) <= {".ipynb_checkpoints", "__pycache__"}
    ignored = (ROOT / ".gitignore").read_text("utf-8").splitlines()
    assert "notebooks/*.ipynb" in ignored  # a notebook with outputs cannot slip in


@by_name
def test_notebook_tells_a_story_in_the_public_interface(path: Path) -> None:
    notebook = jupytext.read(path, fmt="py:percent")
    assert notebook.cells[0].cell_type == "markdown"
    assert notebook.cells[0].source.startswith("# ")
    for node in ast.walk(ast.parse(path.read_text("utf-8"))):
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("fynjax"):
            assert "._" not in (node.module or ""), f"{node.module} is private"
            assert not any(alias.name.startswith("_") for alias in node.names)


@pytest.mark.slow
@by_name
def test_notebook_runs(path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("FYNJAX_FAST", "1")
    monkeypatch.setenv("MPLBACKEND", "module://matplotlib_inline.backend_inline")
    monkeypatch.setenv("IPYTHONDIR", str(tmp_path / "ipython"))
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")]))
    notebook = jupytext.read(path, fmt="py:percent")
    # Its own folder: a notebook that writes a file does not write it into the checkout.
    client = NotebookClient(
        notebook,
        timeout=600,
        kernel_name="python3",
        resources={"metadata": {"path": str(tmp_path)}},
    )
    client.execute()  # raises with the cell and its traceback
    outputs = [output for cell in notebook.cells for output in cell.get("outputs", [])]
    complaints = [o.text for o in outputs if o.output_type == "stream" and o.name == "stderr"]
    assert not complaints, "\n".join(complaints)
    figures = [o for o in outputs if "image/png" in o.get("data", {})]
    assert len(figures) == path.read_text("utf-8").count("plt.show()") > 0

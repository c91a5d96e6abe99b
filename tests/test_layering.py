"""The architecture holds: imports point one way, public names exist and are described."""

import ast
import importlib
import inspect
import re
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / "fynjax"

ROAD = (
    "_core",
    "leaf",
    "canopy",
    "radiation",
    "sensors",
    "metrics",
    "scene",
    "inversion",
)
"""The road of a number: each layer may import from those before it."""

BESIDE = ("io", "terrain", "report", "cli")
"""Beside the road: each may import from the road and from those before it."""

LAYERS = ROAD + BESIDE


def imported_modules(tree: ast.AST, module: str, is_package: bool) -> Iterator[tuple[str, int]]:
    """Every `fynjax` module that `module` imports anywhere (functions and type checking too)."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            for alias in node.names:
                yield alias.name, node.lineno
        elif isinstance(node, ast.ImportFrom):
            base = node.module or ""
            if node.level:
                parent = module.split(".")[: None if is_package else -1]
                parent = parent[: len(parent) - node.level + 1]
                base = ".".join([*parent, base]) if base else ".".join(parent)
            yield base, node.lineno
            for alias in node.names:  # `from fynjax import io` names the layer here
                yield f"{base}.{alias.name}", node.lineno
        elif isinstance(node, ast.Constant) and re.fullmatch(r"fynjax(\.\w+)+", str(node.value)):
            # A module named by a string, as `resources.files` and `import_module` take it.
            yield str(node.value), node.lineno


def layer_of(module: str) -> str | None:
    """The layer that a module of this package belongs to; none for the top and other packages."""
    parts = module.split(".")
    return parts[1] if len(parts) > 1 and parts[0] == "fynjax" else None


def wrong_imports(source: str, module: str, is_package: bool) -> list[str]:
    own = layer_of(module)
    wrong = []
    for name, line in imported_modules(ast.parse(source), module, is_package):
        other = layer_of(name)
        if name == "fynjax" and own in ROAD:
            wrong.append(f"{module}:{line} imports the top of the package")
        if own is None and name.split(".")[0] == "fynjax":
            wrong.append(f"{module}:{line} imports {name}; the top of the package imports nothing")
        if own is None or other not in LAYERS or other == own:
            continue
        if LAYERS.index(other) > LAYERS.index(own):
            wrong.append(f"{module}:{line} imports {name}, which is to the right of {own}")
    return wrong


def modules() -> list[tuple[Path, str]]:
    """All source files with their module names."""
    found = []
    for path in sorted(PACKAGE.rglob("*.py")):
        parts = path.relative_to(ROOT).with_suffix("").parts
        found.append((path, ".".join(parts[:-1] if parts[-1] == "__init__" else parts)))
    return found


def test_imports_point_one_way() -> None:
    wrong = []
    for path, module in modules():
        wrong += wrong_imports(path.read_text("utf-8"), module, path.name == "__init__.py")
    assert not wrong, "\n".join(wrong)


def test_every_layer_is_known_and_there() -> None:
    folders = {path.parent.name for path in PACKAGE.glob("*/__init__.py")}
    assert folders == set(LAYERS)
    assert [path.name for path in PACKAGE.glob("*.py")] == ["__init__.py"]


@pytest.mark.parametrize(
    ("module", "source"),
    [
        ("fynjax.leaf._x", "from fynjax.canopy import VoxelGrid"),
        ("fynjax.leaf._x", "import fynjax.scene._model"),
        ("fynjax.leaf._x", "from fynjax import radiation"),
        ("fynjax.leaf._x", "from ..canopy import VoxelGrid"),
        ("fynjax.leaf._x", "from .. import io"),
        ("fynjax.leaf._x", "def f():\n    from fynjax.io import read_plot"),
        ("fynjax.leaf._x", "import importlib\nimportlib.import_module('fynjax.metrics')"),
        ("fynjax.leaf._x", "import fynjax"),
        ("fynjax.inversion._x", "from fynjax.report import Page"),
        ("fynjax.io._x", "from fynjax.cli import app"),
        ("fynjax", "from fynjax.leaf import prospect"),
    ],
)
def test_a_wrong_import_is_seen(module: str, source: str) -> None:
    assert wrong_imports(source, module, is_package=module == "fynjax")


@pytest.mark.parametrize(
    ("module", "source"),
    [
        ("fynjax.canopy._x", "from fynjax.leaf import prospect"),
        ("fynjax.canopy._x", "from ._grid import VoxelGrid"),
        ("fynjax.io._x", "import fynjax\nfrom fynjax.inversion import calibrate"),
    ],
)
def test_a_right_import_is_left_alone(module: str, source: str) -> None:
    assert not wrong_imports(source, module, is_package=False)


@pytest.mark.parametrize("layer", [name for name in LAYERS if not name.startswith("_")])
def test_public_names_exist_and_have_docstrings(layer: str) -> None:
    module = importlib.import_module(f"fynjax.{layer}")
    assert module.__doc__, f"fynjax.{layer} has no docstring"
    names = getattr(module, "__all__", None)
    assert names, f"fynjax.{layer} has no __all__"
    assert len(set(names)) == len(names)
    documented = attribute_docstrings(layer)
    for name in names:
        assert not name.startswith("_"), f"fynjax.{layer}.{name} is private"
        value = getattr(module, name)  # fails where the name does not exist
        if inspect.isroutine(value) or inspect.isclass(value):
            # Not `inspect.getdoc`, which would hand on the docstring of a base class.
            text = value.__doc__
            assert text, f"fynjax.{layer}.{name} has no docstring"
            assert not text.startswith(f"{name}("), f"fynjax.{layer}.{name}: a generated docstring"
        elif type(value).__module__.split(".")[0] in {"fynjax", "builtins", "typing"}:
            assert name in documented, f"fynjax.{layer}.{name} has no docstring below it"


def attribute_docstrings(layer: str) -> set[str]:
    """Module-level names of a layer that are followed by a string, the docstring of a constant."""
    found = set()
    for path in (PACKAGE / layer).rglob("*.py"):
        body = ast.parse(path.read_text("utf-8")).body
        for statement, following in pairwise(body):
            if not (
                isinstance(following, ast.Expr)
                and isinstance(following.value, ast.Constant)
                and isinstance(following.value.value, str)
            ):
                continue
            if isinstance(statement, ast.AnnAssign) and isinstance(statement.target, ast.Name):
                found.add(statement.target.id)
            elif isinstance(statement, ast.Assign):
                found |= {t.id for t in statement.targets if isinstance(t, ast.Name)}
    return found


MACHINE_PATH = re.compile(
    r"""(?<![\w.}:/])(?:/(?:home|root|Users|work|tmp|mnt|opt|srv|scratch)/|[A-Z]:\\\w)"""
)


def project_files() -> Iterator[Path]:
    """The text files of the project, wherever it was unpacked."""
    suffixes = {".py", ".md", ".toml", ".csv", ".json", ".txt", ".cff"}
    tops = ["fynjax", "tests", "notebooks", "data_schemas"]
    for top in tops:
        yield from (p for p in (ROOT / top).rglob("*") if p.suffix in suffixes)
    yield from (p for p in ROOT.iterdir() if p.suffix in suffixes)
    yield ROOT / ".ci" / "run"


def test_no_path_of_one_machine() -> None:
    for path in project_files():
        for number, line in enumerate(path.read_text("utf-8").splitlines(), start=1):
            assert not MACHINE_PATH.search(line), f"{path.relative_to(ROOT)}:{number}: {line}"


def test_a_path_of_one_machine_is_seen() -> None:
    slash = "/"
    assert MACHINE_PATH.search(f"open('{slash}home{slash}me{slash}data.csv')")
    assert MACHINE_PATH.search(f"cd {slash}tmp{slash}x")
    assert not MACHINE_PATH.search("ratio = work / home")
    assert not MACHINE_PATH.search(f"github.com{slash}work{slash}home")

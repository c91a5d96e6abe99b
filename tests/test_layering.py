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
    "metrics",
    "diversity",
    "radiation",
    "sensors",
    "scene",
    "inversion",
)
"""The road of a number: each layer may import from those before it."""

BESIDE = ("io", "terrain", "compare", "assembly", "report", "jobs", "studies", "cli")
"""Beside the road, `studies` apart in `fynjax.app`: each may import from the road and from those
before it."""

LAYERS = ROAD + BESIDE

PACKAGES = sorted(
    ".".join(path.parent.relative_to(ROOT).parts) for path in PACKAGE.rglob("__init__.py")
)
PLOTTING = {"matplotlib", "seaborn", "plotly"}
SOLVING = {"calibration", "fit", "sample_posterior", "laplace_posterior"}
SOLVERS = {"optimistix", "jaxopt", "emcee", "blackjax", "lineax", "SALib"}


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
    room = parts[2:3] if parts[:2] == ["fynjax", "app"] else parts[1:2]
    return room[0] if parts[0] == "fynjax" and room and room[0] in LAYERS else None


def private_owner(name: str) -> str | None:
    """The package that a private module or name belongs to; none for what is public.

    `_core` is private to fynjax, and its modules are open to all of it.
    """
    parts = name.split(".")
    if parts[0] != "fynjax":
        return None
    for place, part in enumerate(parts[1:], start=1):
        if part.startswith("_") and part != "_core" and not part.startswith("__"):
            return ".".join(parts[:place])
    return None


def wrong_imports(source: str, module: str, is_package: bool) -> list[str]:
    own = layer_of(module)
    home = module if is_package else module.rpartition(".")[0]
    wrong = []
    for name, line in imported_modules(ast.parse(source), module, is_package):
        other = layer_of(name)
        owner = private_owner(name)
        if owner is not None and not f"{home}.".startswith(f"{owner}."):
            wrong.append(f"{module}:{line} imports {name}, which is private to {owner}")
        top = name.split(".")[0]
        if top in PLOTTING and own != "report":
            wrong.append(f"{module}:{line} imports {top}; only `report` draws")
        if top in SOLVERS and own in ("io", "terrain", "compare", "assembly", "report"):
            wrong.append(f"{module}:{line} imports {top}; {own} solves nothing")
        if own == "report" and other == "inversion" and name.rpartition(".")[2] in SOLVING:
            wrong.append(f"{module}:{line} imports {name}; `report` solves nothing")
        if name == "fynjax" and own in ROAD:
            wrong.append(f"{module}:{line} imports the top of the package")
        if module == "fynjax" and f"{name}.".startswith("fynjax.") and "_core.errors" not in name:
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


DOORS = {
    "fynjax.inversion._camera_data",  # an image, or a table of its statistics
    "fynjax.inversion._calibrate",  # the report of a fit
    "fynjax.inversion._data",  # what a file holds
    "fynjax.inversion._problem",  # the learned error of the model
    "fynjax.scene._observe",  # a sensor's file
}
"""Modules that go from the road to the app, through `app_room`."""
BY_NAME = {
    "fynjax._core.extras",  # `app_room` itself
    "fynjax._core.saved",  # the class of a record in a file
    "fynjax.canopy.forms",  # one module for each form
}
"""Modules of the road that import others by a name that is no word of theirs."""


def test_the_road_goes_to_the_app_through_one_door() -> None:
    found: dict[str, set[str]] = {"app_room": set(), "import_module": set()}
    for path, module in modules():
        nodes = list(ast.walk(ast.parse(path.read_text("utf-8"))))
        words = {getattr(node, "id", getattr(node, "attr", None)) for node in nodes}
        for word, where in found.items():
            if word in words and layer_of(module) in ROAD:
                where.add(module)
        assert "__import__" not in words
    assert found == {"app_room": DOORS, "import_module": BY_NAME}


def test_every_layer_is_known_and_there() -> None:
    folders = {path.parent.name for path in PACKAGE.glob("*/__init__.py")} - {"app"}
    assert folders == {*ROAD, "studies"}
    assert folders | {path.parent.name for path in PACKAGE.glob("app/*/__init__.py")} == set(LAYERS)
    names = [path.name for path in sorted(PACKAGE.glob("*.py"))]
    assert names == ["__init__.py", "__main__.py", "_cite.py", "_sensor.py", "errors.py"]


@pytest.mark.parametrize(
    ("module", "source"),
    [
        ("fynjax.leaf._x", "from fynjax.canopy import VoxelGrid"),
        ("fynjax.leaf._x", "import fynjax.scene._model"),
        ("fynjax.leaf._x", "from fynjax import radiation"),
        ("fynjax.leaf._x", "from ..canopy import VoxelGrid"),
        ("fynjax.leaf._x", "from .. import io"),
        ("fynjax.leaf._x", "def f():\n    from fynjax.app.io import read_plot"),
        ("fynjax.leaf._x", "import importlib\nimportlib.import_module('fynjax.metrics')"),
        ("fynjax.leaf._x", "import fynjax"),
        ("fynjax.inversion._x", "from fynjax.app.report import Page"),
        ("fynjax.app.io._x", "from fynjax.app.cli import app"),
        ("fynjax", "from fynjax.leaf import prospect"),
        ("fynjax.app.io._x", "from fynjax.scene._scene import Scene"),
        ("fynjax.app.io.plot._x", "from fynjax.app.io.text._tables import read_table"),
        ("fynjax.app.jobs._x", "from fynjax.app.report.pages import _page"),
        ("fynjax.app.jobs._x", "from fynjax.scene import _hidden"),
        ("fynjax.app.jobs._x", "import matplotlib.pyplot as plt"),
        ("fynjax.app.compare._x", "def f():\n    from matplotlib.figure import Figure"),
        ("fynjax.app.report.pages._x", "import optimistix"),
        ("fynjax.app.report.pages._x", "from fynjax.inversion import fit"),
    ],
)
def test_a_wrong_import_is_seen(module: str, source: str) -> None:
    assert wrong_imports(source, module, is_package=module == "fynjax")


@pytest.mark.parametrize(
    ("module", "source"),
    [
        ("fynjax.canopy._x", "from fynjax.leaf import prospect"),
        ("fynjax.canopy._x", "from ._grid import VoxelGrid"),
        ("fynjax.app.io.plot._x", "from fynjax.app.io.plot._rows import SpeciesRow"),
        ("fynjax.app.io.plot._x", "from fynjax._core.errors import InputError"),
        ("fynjax.app.report.figures._x", "from matplotlib.figure import Figure"),
        ("fynjax.inversion._x", "import optimistix"),
        ("fynjax.app.io._x", "import fynjax\nfrom fynjax.inversion import calibrate"),
    ],
)
def test_a_right_import_is_left_alone(module: str, source: str) -> None:
    assert not wrong_imports(source, module, is_package=False)


HOLDERS = {"fynjax.app.io", "fynjax.app.report", "fynjax.studies"}
"""Packages that hold sub-packages and no names of their own."""


@pytest.mark.parametrize("package", [name for name in PACKAGES if "._" not in name])
def test_public_names_exist_and_have_docstrings(package: str) -> None:
    module = importlib.import_module(package)
    assert module.__doc__, f"{package} has no docstring"
    names = getattr(module, "__all__", [])
    assert bool(names) != (package in HOLDERS), f"{package}: __all__ is {names}"
    assert len(set(names)) == len(names)
    documented = attribute_docstrings(module.__path__[0])
    for name in names:
        assert not name.startswith("_"), f"{package}.{name} is private"
        value = getattr(module, name)  # fails where the name does not exist
        if inspect.ismodule(value):
            assert value.__doc__, f"{package}.{name} has no docstring"
            continue
        if inspect.isroutine(value) or inspect.isclass(value):
            # Not `inspect.getdoc`, which would hand on the docstring of a base class.
            text = value.__doc__
            assert text, f"{package}.{name} has no docstring"
            assert not text.startswith(f"{name}("), f"{package}.{name}: a generated docstring"
        elif type(value).__module__.split(".")[0] in {"fynjax", "builtins", "typing"}:
            assert name in documented, f"{package}.{name} has no docstring below it"


LIBRARY = [name for name in PACKAGES if name.split(".")[1:] and name.split(".")[1] in ROAD[1:]]


def names_for_neighbours(package: str) -> set[str]:
    """What a package of the library has for other packages beside what users are promised."""
    module = importlib.import_module(package)
    tree = ast.parse(Path(module.__file__ or "").read_text("utf-8"))
    imports = [node for node in tree.body if isinstance(node, ast.ImportFrom)]
    own = [node for node in imports if layer_of(node.module or "") == layer_of(package)]
    names = {alias.asname or alias.name for node in own for alias in node.names}
    used = {node.id for node in ast.walk(tree) if isinstance(node, ast.Name)}
    return {n for n in names - used if not inspect.ismodule(getattr(module, n))} - {*module.__all__}


def test_what_is_not_promised_is_taken_by_a_neighbour() -> None:
    """`__all__` is what users are promised; a package has beside it what other packages use."""
    taken = set()
    for path in [*PACKAGE.rglob("*.py"), *PACKAGE.rglob("*.pyi"), ROOT / "docs/_site.py"]:
        module = ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")
        names = imported_modules(
            ast.parse(path.read_text("utf-8")), module, path.stem == "__init__"
        )
        home = module if path.stem == "__init__" else module.rpartition(".")[0]
        for name, _ in names:
            package = name.rpartition(".")[0]
            if layer_of(package) != layer_of(module) or f"{package}.".startswith(f"{home}."):
                taken.add(name)
    for package in LIBRARY:
        kept = {f"{package}.{name}" for name in names_for_neighbours(package)}
        assert kept <= taken, f"for nobody: {sorted(kept - taken)}"


def names_shown(text: str) -> Iterator[tuple[str, str]]:
    """Package and name of what a text takes from packages of the library: imports, and dotted names
    such as `fx.radiation.render`."""
    for package, names in re.findall(r"from (fynjax[\w.]*) import (\([^)]*\)|.*)", text):
        yield from ((package, name) for name in re.findall(r"\w+", names.partition("#")[0]))
    for dotted in re.findall(r"\b(?:fx|fynjax)((?:\.\w+)+)", text):
        package, _, rest = "fynjax", "", dotted
        for part in rest.split(".")[1:]:
            yield package, part
            package = f"{package}.{part}"


def test_what_users_are_shown_is_promised() -> None:
    """Each name that README, pages, notebooks and examples of public names take."""
    pages = [ROOT / "README.md", *(ROOT / "docs").rglob("*.md"), *(ROOT / "notebooks").glob("*.py")]
    texts = {page.name: page.read_text("utf-8") for page in pages}
    for package in LIBRARY:
        module = importlib.import_module(package)
        for name in module.__all__:
            text = inspect.getdoc(getattr(module, name)) or ""
            lines = [line for line in text.splitlines() if line.lstrip().startswith((">>>", "..."))]
            texts[f"{package}.{name}"] = "\n".join(lines)
    shown = {(p, n): where for where, text in texts.items() for p, n in names_shown(text)}
    assert len([package for package, _ in shown if package in LIBRARY]) > 50
    missing = {
        (package, name): where
        for (package, name), where in shown.items()
        if package in LIBRARY
        and hasattr(importlib.import_module(package), name)
        and not inspect.ismodule(getattr(importlib.import_module(package), name))
        and name not in importlib.import_module(package).__all__
    }
    assert not missing


def attribute_docstrings(folder: str) -> set[str]:
    """Module-level names of a package with a string below them, the docstring of a constant."""
    found = set()
    for path in Path(folder).rglob("*.py"):
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
                targets = [n for t in statement.targets for n in ast.walk(t)]
                found |= {t.id for t in targets if isinstance(t, ast.Name)}
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


def test_no_two_public_classes_share_a_name() -> None:
    """A class is one thing; a reader who meets its name need not ask which."""
    places: dict[str, list[str]] = {}
    for path in PACKAGE.rglob("*.py"):
        for node in ast.parse(path.read_text("utf-8")).body:
            if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                places.setdefault(node.name, []).append(str(path.relative_to(PACKAGE)))
    assert {name: found for name, found in places.items() if len(found) > 1} == {}

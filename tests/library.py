"""Tests that need the library alone: `python -m tests.library` names their files.

A file is one of them where nothing that it imports, of the tests' own modules too, is of the app,
of the studies, or a package that the library does not need.
"""

import ast
import re
import tomllib
from functools import cache
from pathlib import Path

ROOT = Path(__file__).parents[1]
ROOMS = "leaf", "canopy", "metrics", "diversity", "radiation", "sensors", "scene", "inversion"
_OTHER_NAMES = {"netCDF4": "netCDF4", "pillow": "PIL", "scikit-bio": "skbio"} | {
    "scikit-learn": "sklearn", "scikit-image": "skimage", "lazrs": "lazrs"
}  # fmt: skip


@cache
def foreign() -> frozenset[str]:
    """Modules that the library does not need."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))
    extras = project["project"]["optional-dependencies"]
    more = [*project["dependency-groups"]["test"], *project["dependency-groups"]["docs"]]
    stated = [one for extra in extras.values() for one in extra] + more
    names = {re.split(r"[\[>;<= ]", one)[0] for one in stated} - {"pytest", "fynjax", "jax"}
    return frozenset(_OTHER_NAMES.get(name, name.replace("-", "_")) for name in names)


@cache
def is_alone(path: Path) -> bool:
    """Whether a file of the tests needs the library alone."""
    for node in ast.walk(ast.parse(path.read_text("utf-8"))):
        named: list[str] = []
        if isinstance(node, ast.Import):
            named = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            own = path.relative_to(ROOT).with_suffix("").parts
            base = ".".join([*own[: -node.level or None], *filter(None, [node.module])])
            base = base if node.level else str(node.module)
            named = [f"{base}.{alias.name}" for alias in node.names]
        elif isinstance(node, ast.Attribute) and ast.unparse(node).startswith("fx."):
            named = [f"fynjax.{ast.unparse(node)[3:]}"]
        for name in named:
            top, _, rest = name.partition(".")
            if top in foreign() or (top == "fynjax" and rest.split(".")[0] in _OF_THE_APP):
                return False
            if top != "tests":
                continue
            for module in (rest, rest.rpartition(".")[0]):
                place = ROOT / "tests" / module.replace(".", "/")
                beside = place / "__init__.py" if place.is_dir() else place.with_suffix(".py")
                if beside.is_file() and not is_alone(beside):
                    return False
    return True


@cache
def _names_of_the_app() -> frozenset[str]:
    text = (ROOT / "fynjax" / "__init__.pyi").read_text("utf-8")
    return frozenset(re.findall(r"from \.app[\w.]* import \w+ as (\w+)", text)) | {"app", "studies"}


_OF_THE_APP = _names_of_the_app() | {"sensor"}


def files() -> list[str]:
    """Files of tests that need the library alone."""
    found = (path for room in ROOMS for path in sorted((ROOT / "tests" / room).glob("test_*.py")))
    return [path.relative_to(ROOT).as_posix() for path in found if is_alone(path)]


if __name__ == "__main__":
    print("\n".join(files()))

"""How large and how plain the code is, counted: `python -m tests.measures`.

Each measure has the bound that it may not pass (`tests/test_measures.py`), and what is aimed at. A
measure that has fallen gets the lower bound. `--list` prints what was counted, name by name.
"""

import ast
import importlib
import inspect
import re
import sys
from argparse import ArgumentParser
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / "fynjax"
ROOMS = (*("leaf", "canopy", "metrics", "diversity", "radiation", "sensors", "scene"), "inversion")
"""The library, in the order of the road."""
KEYS = {
    "boundary": "boundary",
    "cover_definition": "cover_definition",
    "size_variation": "size_variation",
    "spacing": "spacing_m",
    "attempts": "attempts",
    "softness": "softness",
    "softness_plants": "softness_plants",
}
"""Rules of planting that a plot file states, with their keys there."""
PLOT_FILE = ("scene", "app/io/plot", "app/assembly")
"""Where the keys of a plot file go."""
LONGEST, MOST_ARGUMENTS = 80, 8
Trees = dict[str, ast.Module]
"""Source of each module, by its file within the package."""


def trees() -> Trees:
    """All of the package, parsed."""
    files = sorted(PACKAGE.rglob("*.py"))
    return {
        file.relative_to(PACKAGE).as_posix(): ast.parse(file.read_text("utf-8")) for file in files
    }


def public_packages() -> list[str]:
    """Packages with an API page, as the documentation lists them."""
    source = (ROOT / "docs/_site.py").read_text("utf-8")
    for node in ast.parse(source).body:
        if isinstance(node, ast.Assign) and getattr(node.targets[0], "id", "") == "PACKAGES":
            return list(ast.literal_eval(node.value))
    raise AssertionError("docs/_site.py has no PACKAGES")


def places_of_keys(modules: Trees) -> list[str]:
    """Fields that declare the key of `KEYS` that most do: of the classes of `PLOT_FILE`, annotated,
    under the key's own name or that of the file."""
    places = defaultdict(list)
    for file, tree in modules.items():
        if not file.startswith(PLOT_FILE):
            continue
        for node in ast.walk(tree):
            for part in node.body if isinstance(node, ast.ClassDef) else ():
                name = getattr(part.target, "id", "") if isinstance(part, ast.AnnAssign) else ""
                for key in (key for key, word in KEYS.items() if name in (key, word)):
                    places[key].append(f"{file}: {node.name}.{name}")  # type: ignore[attr-defined]
    return max(places.values(), key=len)


def public_names(modules: Trees) -> list[str]:
    """Names that the rooms of the library and their public packages export, packages apart; what
    two packages of a room export counts once."""
    names = set()
    for package in public_packages():
        room = package.removeprefix("fynjax.").split(".")[0]
        if room in ROOMS:
            module = importlib.import_module(package)
            exported = (n for n in module.__all__ if not inspect.ismodule(getattr(module, n)))
            names |= {f"{room}.{name}" for name in exported}
    return sorted(names)


def names_between_rooms(modules: Trees) -> list[str]:
    """Names that a room's `__init__` imports beside its `__all__`: for other rooms and the app, and
    no promise to a user."""
    names = []
    for file, tree in modules.items():
        if file.split("/")[0] not in ROOMS or not file.endswith("/__init__.py"):
            continue
        promised: set[str] = set()
        for node in tree.body:
            if isinstance(node, ast.Assign) and getattr(node.targets[0], "id", "") == "__all__":
                promised = set(ast.literal_eval(node.value))
        found = {
            alias.asname or alias.name
            for node in tree.body
            if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("fynjax.")
            for alias in node.names
        }
        names += [f"{file}: {name}" for name in sorted(found - promised) if name[0] != "_"]
    return names


def names_of_two(modules: Trees) -> list[str]:
    """Functions and classes without an underscore that two modules define under one name, at their
    top. Apart is the command line, whose functions have the names of the jobs that they call."""
    places = defaultdict(set)
    for file, tree in modules.items():
        for node in tree.body if not file.startswith("app/cli/") else ():
            if isinstance(node, (ast.FunctionDef, ast.ClassDef)) and node.name[0] != "_":
                places[node.name].add(file)
    return [f"{name}: {', '.join(sorted(p))}" for name, p in sorted(places.items()) if len(p) > 1]


def front_doors(modules: Trees) -> set[str]:
    """What a user calls with many arguments by name: functions and classes at the top of the
    package, jobs and studies."""
    stubs = (PACKAGE / "__init__.pyi", PACKAGE / "app/jobs/__init__.pyi")
    found = [ast.parse(stub.read_text("utf-8")) for stub in stubs]
    found += [tree for file, tree in modules.items() if re.match(r"studies/\w+/__init__", file)]
    nodes = (node for tree in found for node in tree.body if isinstance(node, ast.ImportFrom))
    return {alias.name for node in nodes for alias in node.names}


def _functions(node: ast.AST, owner: str = "") -> Iterator[tuple[str, ast.FunctionDef]]:
    """Every function with its dotted name, those within others too."""
    for part in ast.iter_child_nodes(node):
        if isinstance(part, (ast.ClassDef, ast.FunctionDef)):
            name = f"{owner}{part.name}"
            if isinstance(part, ast.FunctionDef):
                yield name, part
            yield from _functions(part, f"{name}.")
        else:
            yield from _functions(part, owner)


def large_functions(modules: Trees) -> list[str]:
    """Functions with a body of more than `LONGEST` lines, docstring apart, or, front doors and
    commands apart, of more than `MOST_ARGUMENTS` arguments."""
    doors, found = front_doors(modules), []
    for file, tree in modules.items():
        for name, node in _functions(tree):
            body = node.body[ast.get_docstring(node) is not None :]
            lines = (body[-1].end_lineno or 0) - body[0].lineno + 1 if body else 0
            stated = [a.arg for a in (*node.args.posonlyargs, *node.args.args)]
            count = len(stated) - (stated[:1] in (["self"], ["cls"])) + len(node.args.kwonlyargs)
            door = name.split(".")[0] in doors or file.startswith("app/cli/")
            overload = any(getattr(d, "id", "") == "overload" for d in node.decorator_list)
            if lines > LONGEST or (count > MOST_ARGUMENTS and not door and not overload):
                found.append(f"{file}: {name}, {lines} lines, {count} arguments")
    return found


def prediction_modules() -> list[str]:
    """Modules that the prediction of the mean of a band of a scene's image enters, where nothing
    has been compiled in the same process before."""
    import fynjax as fx
    from fynjax.inversion import ImageView
    from fynjax.scene import Placement, aim
    from tests.benchmarks.journeys import entered

    scene = fx.read_scene(size=1.0, voxel=0.25)
    camera = aim(scene, scene.parameters, fx.sensor("mavic_3m"), Placement(pixel=0.25))
    view = ImageView(("red.mean",), camera)
    return sorted({module for module, _ in entered(lambda: view.predict(scene, scene.parameters))})


def _lines(modules: Trees, below: tuple[str, ...]) -> int:
    """Lines of the files below the folders."""
    return sum(
        len((PACKAGE / file).read_text("utf-8").splitlines())
        for file in modules
        if file.startswith(below)
    )


@dataclass(frozen=True)
class Measure:
    """A number of the code that may not rise."""

    bound: int
    """What it may be at most."""
    aim: int | None
    """What it is to be; None: as it comes."""
    counted: Callable[[Trees], list[str] | int]
    """All that is counted, or the number."""

    def value(self, modules: Trees) -> int:
        """The measure of the code as it is."""
        counted = self.counted(modules)
        return counted if isinstance(counted, int) else len(counted)


MEASURES = {
    "places that declare a key": Measure(3, 2, places_of_keys),
    "public names of the library": Measure(265, 250, public_names),
    "names between its rooms": Measure(263, None, names_between_rooms),
    "names of two things": Measure(0, 0, names_of_two),
    "long functions": Measure(16, 15, large_functions),
    "lines of the library": Measure(
        50_150, 40_000, lambda m: _lines(m, tuple(f"{room}/" for room in ("_core", *ROOMS)))
    ),
    "lines of all": Measure(98_400, 78_000, lambda m: _lines(m, ("",))),
}
PREDICTION = 45
"""At most so many modules does a prediction enter; aimed at: 25."""


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the table."""
    parser = ArgumentParser(description=__doc__)
    parser.add_argument("--list", action="store_true", help="print what was counted")
    listed = parser.parse_args(arguments).list
    modules = trees()
    print(f"{'measure':30}{'now':>8}{'bound':>8}{'aim':>8}")
    for name, measure in MEASURES.items():
        print(f"{name:30}{measure.value(modules):8}{measure.bound:8}{measure.aim or '':>8}")
        counted = measure.counted(modules)
        if listed and not isinstance(counted, int):
            print("   ", "\n    ".join(counted))
    entered = prediction_modules()
    print(f"{'modules of a prediction':30}{len(entered):8}{PREDICTION:8}{25:8}")
    if listed:
        print("   ", "\n    ".join(entered))


if __name__ == "__main__":
    main(sys.argv[1:])

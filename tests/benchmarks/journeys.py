"""The way from a plot file to statistics and to a calibration, as the interpreter walks it:
`python -m tests.benchmarks.journeys`.

    modules and functions of fynjax entered in each step, and the modules that each adds
    the fields that hold one species' chlorophyll on the way, by their class
"""

import inspect
import sys
import tempfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from types import FrameType
from typing import Any

import tests.conftest  # isort: skip  # noqa: F401  # compiles as tests do

import jax
import numpy as np
import pandas as pd

import fynjax
from fynjax import jobs
from fynjax.assembly import aim_without_air, build_plot
from fynjax.inversion import ImageView
from fynjax.io.plot import drone_sensor, read_plot
from tests.small import write_plot

STATISTICS = ("red.mean", "nir.mean", "NDVI.std")
MORE = """leaf_table = "leaves.csv"
[sensor]
pixel_m = {edge}
[calibration]
free = ["species.*.cover", "species.Erica*.leaf.chlorophyll"]
max_iterations = 1
"""
CHLOROPHYLL = 55.123
"""Of one species in the leaf table [ug cm-2]; no other number is like it."""
_FORMS = np.array([CHLOROPHYLL * 10.0**k for k in range(-3, 4)] + [np.log(CHLOROPHYLL)])
_ROOT = str(Path(fynjax.__file__).parent)
_MOST, _DEPTH = 3000, 4
"""Numbers of an array, and fields within fields, that are looked at."""


def _files(folder: Path, edge: float) -> Path:
    """A plot in voxels and pixels of `edge` [m]."""
    plot = write_plot(folder, MORE.format(edge=edge))
    plot.write_text(plot.read_text().replace("voxel_m = 0.1", f"voxel_m = {edge}"))
    (folder / "leaves.csv").write_text(
        "taxon,chlorophyll,carotenoids,water,dry_matter\n"
        f"Erica irregularis,{CHLOROPHYLL},9,0.012,0.02\nRestio eleocharis,41,8,0.011,0.03\n"
    )
    (folder / "target.csv").write_text("statistic,value\nred.mean,0.06\nnir.mean,0.22\n")
    return plot


def _walk(plot_file: Path, step: Callable[[str], Any]) -> None:
    with step("read_plot"):
        plot = read_plot(plot_file)
    with step("build_plot"):
        scene, parameters = build_plot(plot)
    with step("aim"):
        camera = aim_without_air(plot, scene, parameters, drone_sensor(plot))
        view = ImageView(STATISTICS, camera)
    with step("statistics"):
        view.predict(scene, parameters)


def _calibrate(plot_file: Path) -> None:
    jobs.calibrate(plot_file, plot_file.parent / "target.csv", plot_file.parent / "out")


@contextmanager
def _profiled(hook: Callable[[FrameType, str, Any], None]) -> Iterator[None]:
    def inside(frame: FrameType, event: str, value: Any) -> None:
        code = frame.f_code
        named = code.co_flags & inspect.CO_OPTIMIZED and code.co_name[0] != "<"
        if event in ("call", "return") and named and code.co_filename.startswith(_ROOT):
            hook(frame, event, value)

    sys.setprofile(inside)
    try:
        yield
    finally:
        sys.setprofile(None)


def print_steps(folder: Path) -> None:
    """Modules and functions entered in each step, and those that none before had entered."""
    seen: set[tuple[str, str]] = set()

    @contextmanager
    def step(name: str) -> Iterator[None]:
        own: set[tuple[str, str]] = set()

        def enter(frame: FrameType, event: str, value: Any) -> None:
            module = frame.f_code.co_filename.removeprefix(_ROOT).strip("/").removesuffix(".py")
            own.add((module.replace("/", "."), frame.f_code.co_qualname))

        with _profiled(enter):
            yield
        before = {module for module, _ in seen}
        seen.update(own)
        modules = {module for module, _ in own}
        print(f"{name}: {len(modules)} modules, {len(own)} functions; so far "
              f"{len(modules | before)} modules, {len(seen)} functions; new modules:")  # fmt: skip
        print("   ", *sorted(modules - before))

    plot = _files(folder, 0.1)
    _walk(plot, step)
    with step("calibrate"):
        _calibrate(plot)


def _holds(value: Any) -> bool:
    """Whether a number, an array or a text is the chlorophyll, or an array has it."""
    if isinstance(value, str):
        return value == str(CHLOROPHYLL)
    while isinstance(value, jax.core.Tracer):  # of `vmap` and of derivatives
        value = getattr(value, "val", getattr(value, "primal", None))
    if isinstance(value, (float, np.ndarray, np.floating, jax.Array)):
        array = np.asarray(value) if np.size(value) <= _MOST else np.zeros(0)
        return array.dtype.kind == "f" and bool(
            (abs(array.ravel()[:, None] / _FORMS - 1.0) < 2e-7).any()
        )
    return False


def _fields(value: Any) -> Mapping[str, Any]:
    """What an object holds, by name; nothing of those that are of no interest."""
    if isinstance(value, pd.DataFrame):
        return {str(name): value[name].to_numpy() for name in value}
    if isinstance(value, dict):
        return {str(key): part for key, part in value.items()}
    if type(value).__module__.startswith("fynjax"):
        return value._asdict() if hasattr(value, "_asdict") else getattr(value, "__dict__", {})
    return {}


def _holders(value: Any, owner: str, depth: int = 0) -> Iterator[tuple[str, str]]:
    """(class, field) of what holds the chlorophyll; a dictionary is named by what holds it."""
    if isinstance(value, (list, tuple)) and not hasattr(value, "_asdict"):
        for part in value[:100]:
            yield from _holders(part, owner, depth)
    elif _holds(value):
        yield owner.rpartition(".")[::2]
    elif depth < _DEPTH:
        for name, part in list(_fields(value).items()):
            named = owner if isinstance(value, (dict, pd.DataFrame)) else type(value).__qualname__
            yield from _holders(part, f"{named}.{name}", depth + 1)


def print_forms(folder: Path) -> None:
    """Where the chlorophyll sits, as objects that functions take and return show."""
    found: dict[tuple[str, str], None] = {}

    @contextmanager
    def step(name: str) -> Iterator[None]:
        known = len(found)

        def look(frame: FrameType, event: str, value: Any) -> None:
            parts = {"return": value} if event == "return" else dict(frame.f_locals)
            for local, part in parts.items():
                found.update(dict.fromkeys(_holders(part, f"{frame.f_code.co_qualname}().{local}")))

        with _profiled(look):
            yield
        new = list(found)[known:]
        fields = [one for one in new if "()" not in one[0]]
        print(f"{name}: {len(fields)} new fields:", *(f"{kind}.{field}" for kind, field in fields))
        print("    by itself in", *(f"{kind}.{field}" for kind, field in new if "()" in kind))

    plot = _files(folder, 0.5)
    with jax.disable_jit():  # a traced value has no number to find
        _walk(plot, step)
    with step("calibrate"):
        _calibrate(plot)
    inside = sum("()" not in kind for kind, _ in found)
    print(f"forms of one chlorophyll: {inside} fields, {len(found) - inside} arguments and results")


if __name__ == "__main__":
    for part in (print_forms, print_steps):
        with tempfile.TemporaryDirectory() as made:
            part(Path(made))

"""The way from a plot file to statistics of its image, as the interpreter walks it:
`python -m tests.benchmarks.journeys`.

Prints how many modules and functions of fynjax each step enters, and the modules that it adds.
What has been compiled before in the same process is not entered again.
"""

import inspect
import sys
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path
from types import FrameType
from typing import Any, TypeVar

import fynjax
from fynjax.app.assembly import aim_without_air, build_plot
from fynjax.app.io.plot import drone_sensor, read_plot
from fynjax.inversion import ImageView
from tests.benchmarks._measure import options
from tests.small import write_plot

T = TypeVar("T")
_ROOT = str(Path(fynjax.__file__).parent)


def entered(call: Callable[[], object]) -> set[tuple[str, str]]:
    """Modules of fynjax, with their functions, that are entered while `call` runs."""
    found: set[tuple[str, str]] = set()

    def enter(frame: FrameType, event: str, value: Any) -> None:
        code = frame.f_code
        named = code.co_flags & inspect.CO_OPTIMIZED and code.co_name[0] != "<"
        if event == "call" and named and code.co_filename.startswith(_ROOT):
            module = code.co_filename.removeprefix(_ROOT).strip("/").removesuffix(".py")
            found.add((module.replace("/", "."), code.co_qualname))

    sys.setprofile(enter)
    try:
        call()
    finally:
        sys.setprofile(None)
    return found


def step(name: str, seen: set[tuple[str, str]], call: Callable[[], T]) -> T:
    """Print what `call` enters, and which of its modules `seen` lacks; then it has. Gives what the
    call does."""
    given: list[T] = []
    own = entered(lambda: given.append(call()))
    before, modules = ({module for module, _ in some} for some in (seen, own))
    seen.update(own)
    print(f"{name}: {len(modules)} modules, {len(own)} functions; so far "
          f"{len(modules | before)} modules, {len(seen)} functions; new modules:")  # fmt: skip
    print("   ", *sorted(modules - before))
    return given[0]


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the table."""
    options(__doc__).parse_args(arguments)  # it is tiny as it is
    seen: set[tuple[str, str]] = set()
    with tempfile.TemporaryDirectory() as made:
        file = write_plot(Path(made), "[sensor]\npixel_m = 0.1\n")
        plot = step("read_plot", seen, lambda: read_plot(file))
        scene, parameters = step("build_plot", seen, lambda: build_plot(plot))

        def aimed() -> ImageView:
            camera = aim_without_air(plot, scene, parameters, drone_sensor(plot))
            return ImageView(("red.mean", "nir.mean", "NDVI.std"), camera)

        view = step("aim", seen, aimed)
        step("statistics", seen, lambda: view.predict(scene, parameters))


if __name__ == "__main__":
    main()

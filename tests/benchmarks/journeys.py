"""The way from a plot file to statistics of its image, as the interpreter walks it:
`python -m tests.benchmarks.journeys`.

Prints how many modules and functions of fynjax each step enters, and the modules that it adds.
What has been compiled before in the same process is not entered again.
"""

import inspect
import sys
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from types import FrameType
from typing import Any

import fynjax
from fynjax.app.assembly import aim_without_air, build_plot
from fynjax.app.io.plot import drone_sensor, read_plot
from fynjax.inversion import ImageView
from tests.benchmarks._measure import options
from tests.small import write_plot

_ROOT = str(Path(fynjax.__file__).parent)


@contextmanager
def step(name: str, seen: set[tuple[str, str]]) -> Iterator[None]:
    """Print what is entered in the meantime, and which of its modules `seen` lacks; then it has."""
    own: set[tuple[str, str]] = set()

    def enter(frame: FrameType, event: str, value: Any) -> None:
        code = frame.f_code
        named = code.co_flags & inspect.CO_OPTIMIZED and code.co_name[0] != "<"
        if event == "call" and named and code.co_filename.startswith(_ROOT):
            module = code.co_filename.removeprefix(_ROOT).strip("/").removesuffix(".py")
            own.add((module.replace("/", "."), code.co_qualname))

    sys.setprofile(enter)
    try:
        yield
    finally:
        sys.setprofile(None)
    before, modules = ({module for module, _ in some} for some in (seen, own))
    seen.update(own)
    print(f"{name}: {len(modules)} modules, {len(own)} functions; so far "
          f"{len(modules | before)} modules, {len(seen)} functions; new modules:")  # fmt: skip
    print("   ", *sorted(modules - before))


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the table."""
    options(__doc__).parse_args(arguments)  # it is tiny as it is
    seen: set[tuple[str, str]] = set()
    with tempfile.TemporaryDirectory() as made:
        file = write_plot(Path(made), "[sensor]\npixel_m = 0.1\n")
        with step("read_plot", seen):
            plot = read_plot(file)
        with step("build_plot", seen):
            scene, parameters = build_plot(plot)
        with step("aim", seen):
            camera = aim_without_air(plot, scene, parameters, drone_sensor(plot))
            view = ImageView(("red.mean", "nir.mean", "NDVI.std"), camera)
        with step("statistics", seen):
            view.predict(scene, parameters)


if __name__ == "__main__":
    main()

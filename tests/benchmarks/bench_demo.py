"""Time and memory of the shipped plot and of the demo: `python -m tests.benchmarks.bench_demo`.

Prints, for the plot that burnt in 2006 (10 m x 10 m, 13 taxa, 400 x 400 pixels, four bands): one
render; one value and gradient of a calibration's objective by all free parameters, its ratio to the
value alone and to that by a few parameters; one step of the search (gradients of all statistics),
in CPU time; and the whole `fynjax demo` as a process of its own, with an empty compilation cache
and again with the filled one, in wall time. `--quick` leaves the last two out.
"""

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from fynjax.app.assembly import build_plot, image_view
from fynjax.app.io.plot import free_parameters
from fynjax.inversion import (
    Data,
    LogPosterior,
    PlotForward,
    free_space,
    predicted_statistics,
    search_form,
    statistics_and_jacobian,
    weigh_targets,
)
from fynjax.metrics import BANDS
from tests.benchmarks._measure import example_plot, options, peak_gib, seconds

STATISTICS = tuple(f"{layer}.{kind}" for layer in (*BANDS, "NDVI") for kind in ("mean", "std"))


@eqx.filter_jit
def objective_and_gradient(density: LogPosterior, u: Any) -> Any:
    return jax.value_and_grad(lambda u: -density(u))(u)


def row(name: str, call: Callable[[], Any], repeats: int = 3) -> tuple[Any, float]:
    """Print times and memory; result, and the least time after compilation [s]."""
    result, first, again = seconds(call, repeats)
    print(f"{name:<48}{first:>8.1f} s{again:>9.2f} s{peak_gib():>8.2f} GiB", flush=True)
    return result, again


def plot_in_this_process(tiny: bool) -> None:
    read = example_plot(1.0 if tiny else 10.0, tiny)
    print(f"{'CPU time, peak memory so far':<48}{'first':>10}{'again':>11}")
    scene, parameters = row("plot file to planted scene", lambda: build_plot(read, seed=0), 1)[0]
    names = STATISTICS[:2] if tiny else STATISTICS
    view = image_view(read, scene, parameters, names)
    render = eqx.filter_jit(lambda v, s, p: v.camera.observe(s, p).reflectance)
    row("render", lambda: render(view, scene, parameters))

    quick, cheap = search_form(scene, parameters, [view])
    space = free_space(scene, parameters, free_parameters(read), read.calibration.relative_sd)
    predict = PlotForward(parameters, space.names, cheap)
    u, none = jnp.zeros(len(space.names)), jnp.zeros(len(names))
    density = LogPosterior(predict, space, Data(names, none, none + 1.0), none, (quick,))
    name = "value, as a search sees it (every 9th pixel)"
    statistics, value = row(name, lambda: predicted_statistics(density, u))
    data = weigh_targets(names, 1.1 * np.asarray(statistics), 0.01)
    density = LogPosterior(predict, space, data, none, (quick,))
    name = f"value and gradient by {len(space.names)} parameters"
    every = row(name, lambda: objective_and_gradient(density, u))[1]
    print(f"{'  over the value alone':<58}{every / value:>9.2f}")
    if not tiny:
        few = free_space(scene, parameters, (f"species.{scene.taxa[0]}.*",), lambda name: 0.2)
        short = LogPosterior(PlotForward(parameters, few.names, cheap), few, data, none, (quick,))
        v = jnp.zeros(len(few.names))
        name = f"value and gradient by {len(few.names)} parameters"
        small = row(name, lambda: objective_and_gradient(short, v))[1]
        print(f"{'  all parameters over these few':<58}{every / small:>9.2f}")
    name = f"value and gradients of {len(names)} statistics"
    row(name, lambda: statistics_and_jacobian(density, u), 1)


def whole_demo() -> None:
    with tempfile.TemporaryDirectory() as folder:
        environment = os.environ | {"XDG_CACHE_HOME": f"{folder}/cache"}
        environment.pop("JAX_COMPILATION_CACHE_DIR", None)
        for name in ("first", "second"):
            out = Path(folder) / name
            fynjax = Path(sys.executable).with_name("fynjax")
            began = time.perf_counter()
            process = subprocess.Popen(
                [str(fynjax), "demo", "--quiet", "--output", str(out)], env=environment
            )
            _, status, usage = os.wait4(process.pid, 0)
            if status:
                raise SystemExit("the demo failed")
            spent, peak = time.perf_counter() - began, usage.ru_maxrss / 2**20
            print(f"{f'whole demo, {name} run':<48}{spent:>8.1f} s{peak:>19.2f} GiB", flush=True)


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the table."""
    parser = options(__doc__)
    parser.add_argument("--quick", action="store_true", help="no whole demo")
    given = parser.parse_args(arguments)
    if not (given.quick or given.tiny):
        whole_demo()
    plot_in_this_process(given.tiny)


if __name__ == "__main__":
    main()

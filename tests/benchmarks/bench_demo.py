"""Time and memory of the shipped plot and of the demo: `python -m tests.benchmarks.bench_demo`.

Prints, for the plot that burnt in 2006 (10 m x 10 m, 13 taxa, 400 x 400 pixels, four bands): one
render; one value and gradient of a calibration's objective by all free parameters, its ratio to the
value alone and to that by a few parameters, and its slope beside a central difference; one step of
the search (gradients of all statistics); and the whole `fynjax demo` as a process of its own, with
an empty compilation cache and again with the filled one. `--quick` leaves the last two out. Peak
memory is that of a process.
"""

import argparse
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from fynjax.assembly import build_plot, image_view
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
from fynjax.io.plot import example_folder, read_plot
from fynjax.metrics import BANDS

STATISTICS = tuple(f"{layer}.{kind}" for layer in (*BANDS, "NDVI") for kind in ("mean", "std"))


def clock(call: Callable[[], Any], repeats: int = 3) -> tuple[float, float]:
    """First time, compilation included, and the best of some more [s]."""
    times = []
    for _ in range(1 + repeats):
        began = time.perf_counter()
        jax.block_until_ready(call())
        times.append(time.perf_counter() - began)
    return times[0], min(times[1:])


@eqx.filter_jit
def objective_and_gradient(density: LogPosterior, u: Any) -> Any:
    return jax.value_and_grad(lambda u: -density(u))(u)


def row(name: str, first: float, again: float) -> None:
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    print(f"{name:<52}{first:>8.1f} s{again:>9.2f} s   peak so far {peak:5.0f} MiB")


def plot_in_this_process() -> None:
    began = time.perf_counter()
    read = read_plot(example_folder() / "plot.toml")
    scene, parameters = build_plot(read, seed=0)
    built = time.perf_counter() - began
    print(f"{'':<52}{'first':>10}{'again':>11}")
    row("plot file to planted scene", built, built)

    view = image_view(read, scene, parameters, STATISTICS)
    render = eqx.filter_jit(lambda v, s, p: v.camera.observe(s, p).reflectance)
    row("render, 400 x 400 pixels", *clock(lambda: render(view, scene, parameters)))

    quick, cheap = search_form(scene, parameters, [view])
    space = free_space(scene, parameters, read.calibration.free, read.calibration.relative_sd)
    predict = PlotForward(parameters, space.names, cheap)
    u, none = jnp.zeros(len(space.names)), jnp.zeros(len(STATISTICS))
    density = LogPosterior(predict, space, Data(STATISTICS, none, none + 1.0), none, (quick,))
    value = clock(lambda: predicted_statistics(density, u))
    data = weigh_targets(STATISTICS, 1.1 * np.asarray(predicted_statistics(density, u)), 0.01)
    density = LogPosterior(predict, space, data, none, (quick,))
    row("value, as a search sees it (every 9th pixel)", *value)
    both = clock(lambda: objective_and_gradient(density, u))
    row(f"value and gradient by {len(space.names)} parameters", *both)
    print(f"{'  ratio to the value alone':<52}{'':>10}{both[1] / value[1]:>9.2f}")
    few = free_space(scene, parameters, (f"species.{scene.taxa[0]}.*",), lambda name: 0.2)
    short = LogPosterior(PlotForward(parameters, few.names, cheap), few, data, none, (quick,))
    v = jnp.zeros(len(few.names))
    small = clock(lambda: objective_and_gradient(short, v))
    row(f"value and gradient by {len(few.names)} parameters", *small)
    print(f"{'  all parameters over these few':<52}{'':>10}{both[1] / small[1]:>9.2f}")
    along = np.random.default_rng(0).normal(size=u.size) / np.sqrt(u.size)
    slope = float(objective_and_gradient(density, u)[1] @ along)
    step = 0.02
    ends = [float(objective_and_gradient(density, u + k * step * along)[0]) for k in (-2, -1, 1, 2)]
    difference = (ends[0] - 8.0 * ends[1] + 8.0 * ends[2] - ends[3]) / (12.0 * step)
    print(
        f"{'  slope along a direction over its difference':<52}{'':>10}{slope / difference:>9.5f}"
    )
    rows = clock(lambda: statistics_and_jacobian(density, u), repeats=1)
    row(f"value and gradients of {len(STATISTICS)} statistics", *rows)


def whole_demo() -> None:
    with tempfile.TemporaryDirectory() as folder:
        environment = os.environ | {"XDG_CACHE_HOME": f"{folder}/cache"}
        environment.pop("JAX_COMPILATION_CACHE_DIR", None)
        for name in ("first", "second"):
            out = Path(folder) / name
            fynjax = Path(sys.executable).with_name("fynjax")
            command = [str(fynjax), "demo", "--quiet", "--output", str(out)]
            began = time.perf_counter()
            process = subprocess.Popen(command, env=environment)
            _, status, usage = os.wait4(process.pid, 0)
            if status:
                raise SystemExit("the demo failed")
            seconds, peak = time.perf_counter() - began, usage.ru_maxrss / 1024
            print(f"whole demo, {name} run{'':<30}{seconds:>10.1f} s   peak {peak:5.0f} MiB")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="no whole demo")
    options = parser.parse_args()
    if not options.quick:
        whole_demo()
    plot_in_this_process()


if __name__ == "__main__":
    main()

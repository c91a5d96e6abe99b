"""Time and memory of building a hard scene: `python -m tests.benchmarks.bench_build [SIDE ...]`.

Each side (5, 10, 20, 50 and 100 m unless given) is built in a process of its own: sites, plants,
area elements, voxels of 10 cm. Processor time of each stage, wall time without imports, peak
memory, and processor time per plant, which is constant where cost is linear in area. Blue noise
of the largest side at 10 cm comes last.
"""

import argparse
import json
import subprocess
import sys
import time
from collections.abc import Callable
from functools import partial
from typing import Any

STAGES = ("import", "plants", "instances", "hard model", "voxels")
SIDES = (5.0, 10.0, 20.0, 50.0, 100.0)


class Watch:
    """Wall and processor time of stages [s]."""

    def __init__(self) -> None:
        self.wall: dict[str, float] = {}
        self.cpu: dict[str, float] = {}

    def __call__(self, stage: str, function: Callable[[], Any]) -> Any:
        wall, cpu = time.perf_counter(), time.process_time()
        result = function()
        self.wall[stage] = time.perf_counter() - wall
        self.cpu[stage] = time.process_time() - cpu
        return result


def imports() -> None:
    import fynjax.scene  # noqa: F401


def build(side: float) -> dict[str, Any]:
    """Build the shipped plot with another side; its figures."""
    watch = Watch()
    watch("import", imports)
    import equinox as eqx

    from fynjax.assembly import build_plot
    from fynjax.cli._runtime import prepare_jax
    from fynjax.io.plot import example_folder, read_plot
    from fynjax.jobs import peak_memory_mib
    from fynjax.scene import hard_instances, hard_scene

    prepare_jax()
    plot = read_plot(example_folder() / "plot.toml").replace(size_m=(side, side))
    both = watch("plants", lambda: build_plot(plot))
    sites, parameters = len(both[0].planting.species), both[1]
    instances = watch("instances", partial(hard_instances, *both))
    hard = watch("hard scene", partial(hard_scene, *both))
    del both  # the spare plants
    fill = eqx.filter_jit(lambda m, p: m.area_density(p))
    density = watch("voxels", lambda: fill(hard, parameters).block_until_ready())
    return {
        "side": side,
        "plants": len(instances),
        "sites": sites,
        "elements": len(hard.planting.plant),
        "values": density.size,
        "wall": watch.wall,
        "cpu": watch.cpu,
        "gib": peak_memory_mib() / 1024.0,
    }


def noise(side: float) -> dict[str, Any]:
    """Blue noise alone, compiled before."""
    from fynjax.canopy import poisson_disk

    poisson_disk((1.0, 1.0), 0.1, seed=0)
    watch = Watch()
    points = watch("noise", lambda: poisson_disk((side, side), 0.1, seed=0))
    return {"points": len(points), "wall": watch.wall["noise"], "cpu": watch.cpu["noise"]}


def apart(what: str, side: float) -> dict[str, Any]:
    """The same in a new process."""
    command = [sys.executable, "-m", "tests.benchmarks.bench_build", "--one", what, str(side)]
    done = subprocess.run(command, check=True, capture_output=True, text=True)
    return dict(json.loads(done.stdout.splitlines()[-1]))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("sides", nargs="*", type=float, help="[m]")
    parser.add_argument("--one", choices=("build", "noise"), help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.one:
        print(json.dumps({"build": build, "noise": noise}[options.one](options.sides[0])))
        return
    sides = options.sides or SIDES
    print(f"{'side m':>7}{'plants':>9}{'elements':>10}", end="")
    print("".join(f"{f'{stage} s':>14}" for stage in STAGES), end="")
    print(f"{'wall s':>9}{'CPU s':>8}{'GiB':>7}{'CPU us/plant':>14}")
    for side in sides:
        found = apart("build", side)
        wall = sum(found["wall"][stage] for stage in STAGES[1:])
        cpu = sum(found["cpu"][stage] for stage in STAGES[1:])
        print(f"{side:>7g}{found['plants']:>9}{found['elements']:>10}", end="")
        print("".join(f"{found['cpu'][stage]:>14.2f}" for stage in STAGES), end="")
        print(
            f"{wall:>9.2f}{cpu:>8.2f}{found['gib']:>7.2f}{1e6 * cpu / found['plants']:>14.0f}",
            flush=True,
        )
    found = apart("noise", max(sides))
    print(
        f"blue noise, {max(sides):g} m, r 0.1 m: {found['points']} points, {found['wall']:.2f} s "
        f"wall, {found['cpu']:.2f} s CPU"
    )


if __name__ == "__main__":
    main()

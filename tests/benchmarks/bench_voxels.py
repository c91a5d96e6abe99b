"""How far an image depends on the voxels: `python -m tests.benchmarks.bench_voxels [--side M]`.

The shipped plot, seen from 50 m in four bands and pixels of 2.5 cm, with leaves that fill the
voxels evenly and with sun and sight on finer ones (`structure_m`). One row a setting: gap to the
sensor, share of the sun that reaches the ground, band means, CPU time of plants, light and image
after compilation, peak memory of the process; the last column is the ratio of time to the first.
"""

import argparse
import json
import resource
import subprocess
import sys
import time
from collections.abc import Callable
from typing import Any

SETTINGS = (
    (0.1, "even"), (0.05, "even"), (0.025, "even"),
    (0.1, 0.025), (0.05, 0.025), (0.025, 0.025), (0.1, 0.0125),
)  # fmt: skip
HEAD = "voxel_m structure_m    gap    sun  green    red   edge    NIR  CPU s  peak GiB  ratio"


def measure(side: float, voxel: float, structure: Any) -> dict[str, Any]:
    import equinox as eqx
    import jax
    import jax.numpy as jnp

    from fynjax.assembly import build_plot
    from fynjax.io.plot import example_folder, read_plot
    from fynjax.radiation import nadir_rays, render, solve_light
    from fynjax.sensors import shipped_sensor

    plot = read_plot(example_folder() / "plot.toml")
    plot = plot.replace(size_m=(side, side), voxel_m=voxel, structure_m=structure)
    scene, parameters = build_plot(plot)
    bands = shipped_sensor("mavic_3m").bands
    x = (jnp.arange(round(side / 0.025), dtype=jnp.float32) + 0.5) * 0.025
    rays = nadir_rays(x, x, 0.025, (side / 2, side / 2, 50.0))
    spent = 0.0

    def timed(function: Callable[..., Any], *arguments: Any) -> Any:
        nonlocal spent
        compiled = eqx.filter_jit(function)
        jax.block_until_ready(compiled(*arguments))
        start = time.process_time()
        result = jax.block_until_ready(compiled(*arguments))
        spent += time.process_time() - start
        return result

    voxels = timed(lambda scene, parameters: scene.voxels(parameters, bands), scene, parameters)
    light = timed(solve_light, voxels)
    image = timed(lambda light: render(light, rays), light)
    return {
        "figures": [
            float(image.gap.mean()),
            float(light.sun.on_ground.mean()),
            *(jnp.pi * image.total.mean(axis=(1, 2))).tolist(),
        ],
        "cpu": spent,
        "peak": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20,
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--side", type=float, default=4.0, help="of the plot [m]")
    parser.add_argument("--one", help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.one is not None:
        print(json.dumps(measure(arguments.side, *json.loads(arguments.one))))
        return
    print(HEAD, flush=True)
    first = None
    for setting in SETTINGS:
        command = [sys.executable, "-m", "tests.benchmarks.bench_voxels"]
        command += ["--side", str(arguments.side), "--one", json.dumps(setting)]
        output = subprocess.run(command, check=True, capture_output=True, text=True).stdout
        row = json.loads(output.splitlines()[-1])
        first = first or row["cpu"]
        figures = " ".join(f"{value:6.4f}" for value in row["figures"])
        print(
            f"{setting[0]:7g} {setting[1]:>11} {figures} {row['cpu']:6.2f} "
            f"{row['peak']:9.2f} {row['cpu'] / first:6.2f}",
            flush=True,
        )


if __name__ == "__main__":
    main()

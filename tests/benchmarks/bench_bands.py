"""Time of a spectrometer's image against that of one of its bands:
`python -m tests.benchmarks.bench_bands [--size 5]`.

More than 25 bands are reduced to few solves of the light. Prints, for the shipped plot, the time of
all bands of AVIRIS-NG, of one band, and their ratio, each after compilation. float32.
"""

import argparse
import dataclasses
import time

import equinox as eqx
import jax

from fynjax.assembly import aim_at_plot, build_plot
from fynjax.io.instruments import load_sensor
from fynjax.io.plot import Air, example_folder, read_plot, visible_sensor

ONE_BAND = 860.0
"""Centre of the band that the time of all is compared with [nm]."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--size", type=float, default=5.0, help="side of the plot [m]")
    size = parser.parse_args().size
    plot = dataclasses.replace(read_plot(example_folder() / "plot.toml"), size_m=(size, size))
    scene, parameters = build_plot(plot)
    every = visible_sensor(load_sensor("aviris_ng"))
    nearest = min(range(len(every.bands)), key=lambda i: abs(every.bands.centre[i] - ONE_BAND))
    observe = eqx.filter_jit(lambda a, s, p: a.observe(s, p))
    seconds = []
    for sensor in (every, every.select([nearest])):
        aimed = aim_at_plot(
            plot, scene, parameters, sensor, pixel=size, air=Air("none"), quiet=True
        )
        jax.block_until_ready(observe(aimed, scene, parameters))
        began = time.perf_counter()
        jax.block_until_ready(observe(aimed, scene, parameters))
        seconds.append(time.perf_counter() - began)
        print(f"{len(sensor.bands):4d} bands {seconds[-1]:8.2f} s", flush=True)
    print(f"ratio {seconds[0] / seconds[1]:.1f}")


if __name__ == "__main__":
    main()

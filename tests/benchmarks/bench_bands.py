"""Time and error of a spectrometer's image against those of single bands:
`python -m tests.benchmarks.bench_bands [--size 5]`.

More than 25 bands are reduced to few solves of the light. Prints, for the shipped plot, CPU seconds
of compilation and of an image of all bands of AVIRIS-NG and of one band, and their ratio; then by
how much the means and pixels (10 cm) of some bands differ where each is solved for. float32.
"""

import argparse
import time

import equinox as eqx
import jax
import numpy as np

from fynjax.assembly import aim_at_plot, build_plot
from fynjax.io.instruments import load_sensor
from fynjax.io.plot import AtmosphereTable, example_folder, read_plot
from fynjax.scene import AimedSensor, PlotParameters, Scene, visible_sensor

ONE_BAND = 860.0
"""Centre of the band that the time of all is compared with [nm]."""
PIXEL, CHECKED = 0.1, 16
"""Edge of a pixel [m], and bands whose light is solved for to be compared with."""


def image(
    aimed: AimedSensor, scene: Scene, parameters: PlotParameters
) -> tuple[np.ndarray, float, float]:
    """The image, and CPU seconds of compilation and of the image."""
    arrays, static = eqx.partition((aimed, scene, parameters), eqx.is_array)

    @jax.jit
    def observe(arrays: tuple[AimedSensor, Scene, PlotParameters]) -> jax.Array:
        aimed, scene, parameters = eqx.combine(arrays, static)
        return aimed.observe(scene, parameters).reflectance

    start = time.process_time()
    compiled = observe.lower(arrays).compile()
    compiling = time.process_time() - start
    made = np.asarray(compiled(arrays))
    start = time.process_time()
    jax.block_until_ready(compiled(arrays))
    return made, compiling, time.process_time() - start


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--size", type=float, default=5.0, help="side of the plot [m]")
    size = parser.parse_args().size
    plot = read_plot(example_folder() / "plot.toml").replace(size_m=(size, size))
    scene, parameters = build_plot(plot)
    every = visible_sensor(load_sensor("aviris_ng"))
    nearest = min(range(len(every.bands)), key=lambda i: abs(every.bands.centre[i] - ONE_BAND))
    some = np.linspace(0, len(every.bands) - 1, CHECKED).round().astype(int).tolist()
    none = AtmosphereTable(model="none")
    whole, one, few = (
        aim_at_plot(plot, scene, parameters, sensor, pixel=PIXEL, air=none, quiet=True)
        for sensor in (every, every.select([nearest]), every.select(some))
    )
    print("bands  compilation CPU s  image CPU s")
    seconds, images = [], []
    for aimed in (whole, one):
        made, compiling, spent = image(aimed, scene, parameters)
        images.append(made)
        seconds.append(spent)
        print(f"{len(aimed.sensor.bands):5d} {compiling:18.1f} {spent:12.2f}", flush=True)
    print(f"ratio {seconds[0] / seconds[1]:.1f}")
    want = image(few, scene, parameters)[0]
    off = np.abs(images[0][some] - want) / want.mean(axis=(1, 2), keepdims=True)
    mean = np.abs(images[0][some].mean(axis=(1, 2)) / want.mean(axis=(1, 2)) - 1)
    print(
        f"{CHECKED} bands solved for: worst mean {100 * mean.max():.3f} %, worst pixel "
        f"{100 * off.max():.2f} % of its band's mean"
    )


if __name__ == "__main__":
    main()

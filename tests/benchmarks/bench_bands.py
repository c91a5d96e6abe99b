"""Time and error of a spectrometer's image against those of single bands:
`python -m tests.benchmarks.bench_bands [--size 5]`.

More than 25 bands are reduced to few solves of the light. Prints, for the shipped plot, CPU seconds
of compilation and of an image of all bands of AVIRIS-NG and of one band, and their ratio; then by
how much the means and pixels (10 cm) of some bands differ where each is solved for. float32.
"""

from collections.abc import Sequence

import numpy as np

from fynjax.app.assembly import aim_at_plot, build_plot
from fynjax.app.io.instruments import load_sensor
from fynjax.app.io.plot import AtmosphereTable
from fynjax.scene import AimedSensor, PlotParameters, Scene, visible_sensor
from tests.benchmarks._measure import compiled, example_plot, options

ONE_BAND = 860.0
"""Centre of the band that the time of all is compared with [nm]."""
PIXEL = 0.1
"""Edge of a pixel [m]."""


def observe(aimed: AimedSensor, scene: Scene, parameters: PlotParameters):
    """Reflectance factors [band, y, x]."""
    return aimed.observe(scene, parameters).reflectance


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the table."""
    parser = options(__doc__)
    parser.add_argument("--size", type=float, default=5.0, help="side of the plot [m]")
    given = parser.parse_args(arguments)
    plot = example_plot(1.0 if given.tiny else given.size, given.tiny)
    scene, parameters = build_plot(plot)
    every = visible_sensor(load_sensor("aviris_ng"))
    if given.tiny:
        every = every.select(range(0, len(every.bands), 12))
    nearest = min(range(len(every.bands)), key=lambda i: abs(every.bands.centre[i] - ONE_BAND))
    checked = 4 if given.tiny else 16
    some = np.linspace(0, len(every.bands) - 1, checked).round().astype(int).tolist()
    none = AtmosphereTable(model="none")
    images, times = [], []
    print("bands  compilation CPU s  image CPU s")
    for sensor in (every, every.select([nearest]), every.select(some)):
        aimed = aim_at_plot(plot, scene, parameters, sensor, pixel=PIXEL, air=none, quiet=True)
        image, compiling, spent, _ = compiled(observe, aimed, scene, parameters)
        images.append(np.asarray(image))
        times.append(spent)
        print(f"{len(sensor.bands):5d} {compiling:18.1f} {spent:12.2f}", flush=True)
    print(f"all over one: {times[0] / times[1]:.1f}")
    ours, want = images[0][some], images[2]
    pixel = np.abs(ours - want) / want.mean(axis=(1, 2), keepdims=True)
    mean = np.abs(ours.mean(axis=(1, 2)) / want.mean(axis=(1, 2)) - 1)
    print(
        f"{checked} bands solved for: worst mean {100 * mean.max():.3f} %, worst pixel "
        f"{100 * pixel.max():.2f} % of its band's mean"
    )


if __name__ == "__main__":
    main()

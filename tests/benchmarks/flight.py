"""Frames of a flight: what many of them cost, and what a mosaic of them is when it is taken for one
picture.

    python -m tests.benchmarks.flight

The first table has, for 1, 5 and 25 frames of one plot under one sun, in the form in which a fit
searches, the processor time of compiling and of computing all statistics, and of their slopes by
the covers, with the memory that XLA plans for these. The second has what means and spreads of a
mosaic are off by when it is simulated as one picture from above the middle of the plot: of the
pixels of the nearest cameras, and of means over all cameras that see a pixel, from 50 m with 80 %
and 70 % of overlap, over where the flight lines happen to lie.
"""

from collections.abc import Sequence

import equinox as eqx
import jax.numpy as jnp
import numpy as np

import fynjax as fx
from fynjax._core.precision import double_precision
from fynjax.app.assembly import build_plot
from fynjax.inversion import COARSE, ImageSight, search_form
from fynjax.inversion._views import FlightView, ImageView, PlotForward, together
from fynjax.metrics import image_statistics
from fynjax.scene import Placement, fitted_accuracy, named_values
from fynjax.sensors import Frame, Gains, Pose, lens_of
from tests.benchmarks._measure import compiled, example_plot, options, peak_gib

HEIGHT, FORWARD, SIDE = 50.0, 0.8, 0.7
"""Of the flight [m], and its overlaps along and between the lines [-]."""
NAMES = tuple(
    f"{layer}.{kind}"
    for layer in ("green", "red", "red_edge", "nir", "NDVI")
    for kind in ("mean", "std", "q05", "q25", "q50", "q75", "q95")
)


def main(arguments: Sequence[str] | None = None) -> None:
    """Run both parts, or one."""
    parser = options(__doc__)
    parser.add_argument("--size", type=float, default=5.0, help="side of the plot [m]")
    parser.add_argument("--phases", type=int, default=4, help="places of the flight lines")
    parser.add_argument("--only", choices=("cost", "mosaic"))
    asked = parser.parse_args(arguments)
    size, phases, counts = (asked.size, asked.phases, (1, 5, 25))
    if asked.tiny:
        size, phases, counts = 1.0, 1, (1, 2)
    if asked.only != "mosaic":
        cost(size, counts, asked.tiny)
    if asked.only != "cost":
        mosaic(size, phases, asked.tiny)


def around(size: float, number: int) -> list[Frame]:
    """Frames that look at the middle of a plot: the first from above, the others from 10 to 30
    degrees aside, all around."""
    frames = []
    for k in range(number):
        zenith = 0.0 if k == 0 else 10.0 * (1 + k % 3)
        azimuth = 360.0 * k / number
        away = HEIGHT * np.tan(np.radians(zenith))
        east, north = (0.5 * size + away * f(np.radians(azimuth)) for f in (np.sin, np.cos))
        pose = Pose(jnp.array([east, north, HEIGHT]), azimuth + 180.0, zenith)
        frames.append(Frame(pose, name=f"frame{k}"))
    return frames


@double_precision
def cost(size: float, counts: Sequence[int], tiny: bool) -> None:
    scene, parameters = build_plot(example_plot(size, tiny), seed=0, rounding="random")
    sensor = fx.sensor("mavic_3m")
    free = [name for name in named_values(parameters, scene.taxa) if name.endswith(".cover")]
    known = named_values(parameters, scene.taxa)
    values = jnp.array([float(known[name]) for name in free])
    print(f"{size:g} m, {len(scene.taxa)} taxa, {len(free)} free, {len(NAMES)} statistics a frame")
    print(f"{'frames':>6} {'compile s':>9} {'values s':>9} {'compile s':>9} {'slopes s':>9} "
          f"{'planned GiB':>11} {'peak GiB':>9}")  # fmt: skip
    for number in counts:
        views = [
            ImageSight(NAMES, sensor, Placement(pixel=0.1, frame=frame), Gains(0.05))(
                scene, parameters
            ).named(frame.name)
            for frame in around(size, number)
        ]
        quick, coarse = search_form(scene, parameters, views)
        (flight,) = together(coarse)
        forward = PlotForward(parameters, free, (flight,))
        stand = quick.expected()
        _, build, run, _ = compiled(lambda v, s, f=forward: f(v, s), values, stand)
        assert isinstance(flight, FlightView | ImageView)
        _, builds, slopes, planned = compiled(
            lambda v, s, f=forward: f.jacobian(lambda u: u, v, s)[1], values, stand
        )
        print(f"{number:6d} {build:9.1f} {run:9.2f} {builds:9.1f} {slopes:9.2f} {planned:11.2f} "
              f"{peak_gib():9.2f}")  # fmt: skip


@double_precision
def mosaic(size: float, phases: int, tiny: bool) -> None:
    scene, parameters = build_plot(example_plot(size, tiny), seed=0, rounding="random")
    sensor = fx.sensor("mavic_3m")
    lens = lens_of(sensor.camera)
    wide, high = (n / lens.focal_length[0] * HEIGHT for n in lens.size)
    steps = (1.0 - SIDE) * wide, (1.0 - FORWARD) * high
    names = tuple(f"{band}.{kind}" for band in sensor.bands.names for kind in ("mean", "std"))
    accuracy = fitted_accuracy(COARSE, scene, parameters) if tiny else None
    one = fx.observe(scene, sensor, pixel=0.1, altitude=HEIGHT, **_accuracy(accuracy))
    usual = _values(one.reflectance, names, sensor.bands)
    found: dict[str, list[np.ndarray]] = {"nearest": [], "mean": []}
    for k in range(phases):
        # Flight lines lie anywhere beside the plot: the worst places are among them.
        shift = [(k % 2 + 0.5 * (k // 2 % 2)) / 2.0, (k // 2 % 2) / 2.0]
        frames = _grid(size, steps, shift, lens)
        whole = Frame(Pose(jnp.array([size / 2, size / 2, HEIGHT])), lens, "mosaic", frames)
        for blend in found:
            sight = ImageSight(
                names,
                sensor,
                Placement(pixel=0.1, frame=whole),
                Gains(0.0),
                blended=blend == "mean",
            )
            view = sight(scene, parameters)
            image = eqx.filter_jit(lambda v, s, p: v.image(s, p))(view, scene, parameters)
            found[blend].append(_values(image, names, sensor.bands) / usual - 1.0)
    print(f"a mosaic of {len(frames)} frames taken for one picture, {phases} places of the lines")
    print(f"{'blend':>8} {'statistic':>14} {'mean %':>8} {'worst %':>8}")
    for blend, values in found.items():
        off = 100.0 * np.array(values)
        for name, column in zip(names, off.T, strict=True):
            worst = column[np.argmax(np.abs(column))]
            print(f"{blend:>8} {name:>14} {column.mean():8.2f} {worst:8.2f}")


def _accuracy(accuracy):
    return {} if accuracy is None else {"accuracy": accuracy}


def _values(image, names, bands) -> np.ndarray:
    return np.asarray(image_statistics(jnp.asarray(image, float), names, pixel=0.1, bands=bands))


def _grid(size: float, steps, shift, lens) -> tuple[Frame, ...]:
    """Frames of parallel lines that see the middle of a plot."""
    middle = np.array([[[size / 2, size / 2, 0.0]]])
    frames = []
    for i in range(-6, 7):
        for j in range(-6, 7):
            east, north = (
                size / 2 + (n + s) * step for n, s, step in zip((i, j), shift, steps, strict=True)
            )
            frame = Frame(Pose(jnp.array([east, north, HEIGHT])), lens, f"camera{i}_{j}")
            if frame.sees(middle).all():
                frames.append(frame)
    return tuple(frames)


if __name__ == "__main__":
    main()

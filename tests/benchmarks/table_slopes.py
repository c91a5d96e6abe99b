"""Whether the slope of a planting is, in the mean, that of the expected stand of whole plants.

    python -m tests.benchmarks.table_slopes [--size 2] [--plantings 48]

Seven species of table 1. For each quantity and kind of parameter (the covers of all species times
one factor, their diameters, leaf areas, heights): the derivative of the mean over plantings by the
logarithm of the factor, as a difference of the means of whole plants of the same plantings, and the
mean and median of the slopes that are taken; then what an image and a gradient cost.
"""

from collections.abc import Sequence
from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
from jaxtyping import Array, Float

from fynjax.canopy import table1_2006
from fynjax.metrics import image_statistics
from fynjax.scene import (
    AimedSensor,
    Placement,
    PlotParameters,
    Scene,
    aim,
    slope_of_fading,
)
from fynjax.sensors import shipped_sensor
from tests.benchmarks._measure import options, seconds

KINDS = {"cover": 0.28, "diameter": 0.28, "leaf_area_index": 0.1, "height": 0.1}
"""Kinds of parameters, and half the step of their differences, of the logarithm."""
STATISTICS = ("red.mean", "nir.mean", "NDVI.mean", "NDVI.std")
QUANTITIES = ("gap", *STATISTICS, "LiDAR height, 95 %")


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the table."""
    parser = options(__doc__)
    parser.add_argument("--size", type=float, default=2.0, help="side of the plot [m]")
    parser.add_argument("--plantings", type=int, default=48)
    given = parser.parse_args(arguments)
    size, plantings, species = (1.0, 2, 2) if given.tiny else (given.size, given.plantings, 7)
    scene = Scene.from_table(table1_2006().iloc[:species], size=size, seed=1)
    parameters = scene.parameters
    camera = aim(scene, parameters, shipped_sensor("mavic_3m"), Placement(pixel=0.05))
    table = pd.DataFrame(slopes(scene, parameters, camera, plantings))
    print(f"{size:g} m, {plantings} plantings")
    print(table.to_string(index=False, float_format=lambda v: f"{v:+.4f}"))
    if not given.tiny:
        print(costs(scene, parameters, camera))


def scaled(parameters: PlotParameters, log_factor: Float[Array, " kind"]) -> PlotParameters:
    """The parameters with those of each kind times a factor."""
    where = lambda p: [getattr(p.species, kind) for kind in KINDS]  # noqa: E731
    values = [v * jnp.exp(x) for v, x in zip(where(parameters), log_factor)]
    return eqx.tree_at(where, parameters, values)


@partial(slope_of_fading, apart=True)
def first_return_height(scene: Scene, parameters: PlotParameters) -> Float[Array, ""]:
    """Height below which 95 % of the first returns of a LiDAR from straight above lie [m]."""
    density = scene.area_density(parameters).sum(axis=0)[::-1]  # from the top down
    layer = scene.grid.vertical_size
    seen = jnp.exp(-0.5 * layer * jnp.cumsum(density, axis=0)).mean(axis=(1, 2))
    below = jnp.append(seen[::-1], 1.0)  # of the ground's height, then each layer's top
    return jnp.interp(0.95, below, jnp.arange(below.size) * layer)


def slopes(
    scene: Scene, parameters: PlotParameters, camera: AimedSensor, plantings: int
) -> list[dict[str, object]]:
    """A row for each kind and quantity."""

    def quantities(x: Array, scene: Scene) -> Array:
        plot = scaled(parameters, x)
        image = camera.observe(scene, plot).reflectance
        return jnp.concatenate(
            [
                scene.gap_fraction(plot)[None],
                image_statistics(image, STATISTICS),
                first_return_height(scene, plot)[None],
            ]
        )

    value = eqx.filter_jit(quantities)

    @eqx.filter_jit
    def jacobian(x: Array, scene: Scene) -> Array:
        _, push = jax.linearize(lambda x: quantities(x, scene), x)
        return jax.lax.map(push, jnp.eye(x.size, dtype=x.dtype))

    none, steps = jnp.zeros(len(KINDS), jnp.float32), list(KINDS.values())
    differences, taken = [], []
    for seed in range(plantings):
        stand = scene.reordered(1000 + seed)
        ends = [
            [np.asarray(value(none.at[i].set(sign * step), stand)) for sign in (1, -1)]
            for i, step in enumerate(steps)
        ]
        differences.append([(up - down) / (2 * step) for (up, down), step in zip(ends, steps)])
        taken.append(np.asarray(jacobian(none, stand)))
    apart, found = np.array(differences, float), np.array(taken, float)
    root = np.sqrt(plantings)
    rows = []
    for i, kind in enumerate(KINDS):
        for k, name in enumerate(QUANTITIES):
            truth, own = apart[:, i, k], found[:, i, k]
            error = np.hypot(truth.std(ddof=1), own.std(ddof=1)) / root
            away = np.array([own.mean(), np.median(own)]) - truth.mean()
            rows.append(
                {
                    "by": kind,
                    "of": name,
                    "expected stand": truth.mean(),
                    "error": truth.std(ddof=1) / root,
                    "slopes, mean": own.mean(),
                    "median": np.median(own),
                    "sd": own.std(ddof=1),
                    "mean off, in errors": away[0] / max(error, 1e-12),
                    "median off": away[1] / max(error, 1e-12),
                }
            )
    return rows


def costs(scene: Scene, parameters: PlotParameters, camera: AimedSensor) -> str:
    """Times of an image, of its gradient, and of the gradient of fading plants alone."""
    mean = lambda p, s: camera.observe(s, p).reflectance.mean()  # noqa: E731
    alone = lambda p, s: camera.image(s.voxels(p, camera.sensor.bands))[0].mean()  # noqa: E731
    times = []
    for function, stand in (
        (mean, scene), (jax.grad(mean), scene), (jax.grad(alone), scene.expected()),
    ):  # fmt: skip
        run = eqx.filter_jit(function)
        times.append(seconds(lambda run=run, stand=stand: run(parameters, stand), 5)[2])
    image, gradient, faded = times
    return (
        f"image {image:.2f} CPU s; gradient {gradient / image:.1f} images, without that of whole "
        f"plants {faded / image:.1f}"
    )


if __name__ == "__main__":
    main()

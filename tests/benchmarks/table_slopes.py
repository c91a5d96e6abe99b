"""Whether the slope of a planting is, in the mean, that of the expected stand of whole plants.

    python -m tests.benchmarks.table_slopes [--plantings 64]

A plot of 2.4 m with few plants (1.3 rounded shrubs of 90 cm, 7.2 upright ericoids of 45 cm, 3.5
tussocks of 50 cm) and one with many smaller ones. For each statistic and kind of parameter (the
cover of the first species, or all of a kind, times one factor): the derivative of the mean over
plantings by the logarithm of the factor, as a difference of the means of whole plants of the same
plantings; the mean of the slopes that are taken; the mean of these over the step of the difference,
which is the difference of stands in expectation and is held against it, since both bend alike; and
the mean of the values of the stands in expectation over that of whole plants. Then slopes of the
gap by the number of plants of one species, from half a plant to 30, over what one plant more makes;
and what an image and a gradient cost.
"""

import dataclasses
from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
from jaxtyping import Array, Float

from fynjax.metrics import image_statistics
from fynjax.scene import AimedSensor, Placement, PlotParameters, Scene, aim
from fynjax.sensors import shipped_sensor
from tests.benchmarks._measure import options, seconds

COLUMNS = "taxon", "growth_form", "mean_diameter_cm", "cover_percent", "height_max_m"
PLOTS = {
    "few plants": (
        ("a", "rounded_shrub", 90, 15, 0.8),
        ("b", "upright_ericoid", 45, 20, 0.6),
        ("c", "tussock", 50, 12, 0.5),
    ),
    "many plants": (
        ("a", "rounded_shrub", 25, 20, 0.5),
        ("b", "upright_ericoid", 18, 20, 0.4),
        ("c", "tussock", 15, 12, 0.35),
    ),
}
"""Species of the plots of 2.4 m, columns as in a species table."""
KINDS = {
    "cover of one": 0.28, "cover": 0.28, "diameter": 0.28, "leaf_area_index": 0.02, "height": 0.02,
    "chlorophyll of one": 0.02,
}  # fmt: skip
"""Kinds of parameters, and half the step of their differences, of the logarithm."""
STATISTICS = ("green.mean", "red.mean", "red_edge.mean", "nir.mean", "NDVI.mean", "NDVI.std")
QUANTITIES = ("gap", *STATISTICS, "LiDAR height, 95 %")
NUMBERS = (0.5, 0.7, 0.85, 1.0, 1.15, 1.3, 1.45, 1.6, 1.75, 1.9, 2.0, 2.15, 2.5, 3.0, 4.0, 5.5, 8.0,
           12.0, 20.0, 30.0)  # fmt: skip


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the tables."""
    parser = options(__doc__)
    parser.add_argument("--plantings", type=int, default=64)
    given = parser.parse_args(arguments)
    plantings = 2 if given.tiny else given.plantings
    size, voxel = (1.0, 0.25) if given.tiny else (2.4, 0.1)
    for name, species in PLOTS.items():
        species = species[:1] if given.tiny else species
        table = [dict(zip(COLUMNS, row)) for row in species]
        scene = Scene.from_table(table, size=size, voxel=voxel, seed=1)
        camera = aim(scene, scene.parameters, shipped_sensor("mavic_3m"), Placement(pixel=0.1))
        counts = ", ".join(f"{n:.1f}" for n in scene.counts(scene.parameters))
        rows, values = slopes(scene, scene.parameters, camera, plantings)
        print(f"{name} ({counts}), {plantings} plantings")
        print(rows.to_string(index=False, float_format=lambda v: f"{v:+.4f}"))
        print(values.to_string(index=False, float_format=lambda v: f"{v:.4f}"))
        if given.tiny:
            break
        print(costs(scene, scene.parameters, camera))
    print(by_number(NUMBERS[:2] if given.tiny else NUMBERS, 2 * plantings).to_string(index=False))


def scaled(parameters: PlotParameters, log_factor: Float[Array, " kind"]) -> PlotParameters:
    """The parameters with those of each kind times a factor."""
    by, species = dict(zip(KINDS, jnp.exp(log_factor))), parameters.species
    first = lambda values, factor: values.at[0].multiply(factor)  # noqa: E731
    return eqx.tree_at(
        lambda p: (
            p.species.cover, p.species.diameter, p.species.leaf_area_index, p.species.height,
            p.leaf.chlorophyll,
        ),
        parameters,
        (
            first(species.cover * by["cover"], by["cover of one"]),
            species.diameter * by["diameter"],
            species.leaf_area_index * by["leaf_area_index"],
            species.height * by["height"],
            first(parameters.leaf.chlorophyll, by["chlorophyll of one"]),
        ),
    )  # fmt: skip


def first_return_height(scene: Scene, parameters: PlotParameters) -> Float[Array, ""]:
    """Height below which 95 % of the first returns of a LiDAR from straight above lie [m]."""
    density = scene.area_density(parameters).sum(axis=0)[::-1]  # from the top down
    layer = scene.grid.vertical_size
    seen = jnp.exp(-0.5 * layer * jnp.cumsum(density, axis=0)).mean(axis=(1, 2))
    below = jnp.append(seen[::-1], 1.0)  # of the ground's height, then each layer's top
    return jnp.interp(0.95, below, jnp.arange(below.size) * layer)


def slopes(
    scene: Scene, parameters: PlotParameters, camera: AimedSensor, plantings: int
) -> tuple[pd.DataFrame, pd.DataFrame]:
    """A row for each kind and quantity; and the values of stands in expectation over those of whole
    plants."""

    def quantities(x: Array, scene: Scene) -> Array:
        plot = scaled(parameters, x)
        image = camera.observe(scene, plot).reflectance
        return jnp.concatenate(
            [
                scene.gap_fraction(plot)[None],
                image_statistics(image, STATISTICS, bands=camera.sensor.bands.names),
                first_return_height(scene, plot)[None],
            ]
        )

    value = eqx.filter_jit(quantities)

    @eqx.filter_jit
    def expected(x: Array, along: Array, scene: Scene) -> tuple[Array, Array]:
        """Value and slope of the stand in expectation."""
        return jax.jvp(lambda x: quantities(x, scene), (x,), (along,))

    none, steps = jnp.zeros(len(KINDS), jnp.float32), list(KINDS.values())
    kinds = jnp.eye(len(KINDS), dtype=jnp.float32)
    values, differences, taken, over = [], [], [], []
    for number in range(1, plantings + 1):
        # Sites for the largest covers that differences take.
        stand = scene.realisation(number, 2.4 * np.asarray(scene.counts(parameters)))
        ends = [
            [np.asarray(value(none.at[i].set(sign * step), stand)) for sign in (1, -1)]
            for i, step in enumerate(steps)
        ]
        differences.append([(up - down) / (2 * step) for (up, down), step in zip(ends, steps)])
        middle = [expected(none, along, stand) for along in kinds]
        values.append([np.asarray(value(none, stand)), np.asarray(middle[0][0])])
        taken.append(np.asarray([slope for _, slope in middle]))
        sides = [
            [np.asarray(expected(sign * step * along, along, stand)[0]) for sign in (1, -1)]
            for along, step in zip(kinds, steps)
        ]
        over.append([(up - down) / (2 * step) for (up, down), step in zip(sides, steps)])
    apart, found, wide, both = (np.array(v, float) for v in (differences, taken, over, values))
    rows = []
    for i, kind in enumerate(KINDS):
        for k, name in enumerate(QUANTITIES):
            truth, own, mean = apart[:, i, k], found[:, i, k], wide[:, i, k]
            paired = (mean - truth).std(ddof=1) / np.sqrt(plantings)
            rows.append(
                {
                    "by": kind,
                    "of": name,
                    "expected stand": truth.mean(),
                    "error": truth.std(ddof=1) / np.sqrt(plantings),
                    "slopes here": own.mean(),
                    "sd": own.std(ddof=1),
                    "over the step": mean.mean(),
                    "ratio": mean.mean() / truth.mean() if truth.mean() else np.nan,
                    "off, in paired errors": (mean - truth).mean() / max(paired, 1e-12),
                }
            )
    whole, expected = both.mean(axis=0)
    error = (both[:, 1] - both[:, 0]).std(axis=0, ddof=1) / np.sqrt(plantings) / whole
    ratios = {"value of": QUANTITIES, "expected over whole": expected / whole, "error": error}
    return pd.DataFrame(rows), pd.DataFrame(ratios)


def by_number(numbers: Sequence[float], plantings: int) -> pd.DataFrame:
    """Mean slope of the gap by the number of rounded shrubs of 60 cm on 3 m, over what one plant
    more makes of the same plantings; a window of one plant about a number is shared between the
    steps that it lies in, as plants in expectation are."""
    row = dict(zip(COLUMNS, ("a", "rounded_shrub", 60, 60, 0.6)))
    scene = Scene.from_table([row], size=3.0, seed=1)

    def gap(number: Array, stand: Scene) -> Array:
        return dataclasses.replace(stand, number=number).gap_fraction(scene.parameters)

    value, slope = eqx.filter_jit(gap), eqx.filter_jit(jax.grad(gap))
    drawn = np.random.default_rng(1).permutation(plantings)
    stands = [scene.reordered(i) for i in range(plantings)]
    # Four rounding numbers for each planting, all of them evenly spread.
    rounding = (drawn[:, None] / plantings + np.arange(4) + 0.5 / plantings) / 4.0
    as_number = lambda n: jnp.array([n], jnp.float32)  # noqa: E731
    most = int(np.ceil(max(numbers))) + 2
    whole = np.array([[value(as_number(n), s) for n in range(most)] for s in stands])
    steps, rows = np.diff(whole, axis=1), []
    for number in numbers:
        low, high = number - 0.5, number + 0.5
        edges = np.arange(most)
        shares = np.clip(np.minimum(high, edges[1:]) - np.maximum(low, edges[:-1]), 0.0, 1.0)
        made = steps @ shares
        own = np.array(
            [
                np.mean(
                    [
                        float(slope(as_number(number), dataclasses.replace(s, rounding=r))[0])
                        for r in jnp.asarray(u[:, None], jnp.float32)
                    ]
                )
                for s, u in zip(stands, rounding)
            ]
        )
        error = (own - made).std(ddof=1) / np.sqrt(plantings) / abs(made.mean())
        rows.append({"plants": number, "ratio": own.mean() / made.mean(), "error": error})
    return pd.DataFrame(rows).round(3)


def costs(scene: Scene, parameters: PlotParameters, camera: AimedSensor) -> str:
    """Times of an image and of its gradient."""
    mean = lambda p, s: camera.observe(s, p).reflectance.mean()  # noqa: E731
    programs = eqx.filter_jit(mean), eqx.filter_jit(jax.grad(mean))
    image, gradient = (seconds(lambda f=f: f(parameters, scene), 5)[2] for f in programs)
    return f"image {image:.2f} CPU s; gradient {gradient / image:.1f} images"


if __name__ == "__main__":
    main()

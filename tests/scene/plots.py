"""A small plot that several tests share."""

import dataclasses
from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array

from fynjax.leaf import LeafParameters
from fynjax.radiation import Accuracy
from fynjax.scene import (
    AimedSensor,
    GroundParameters,
    LightParameters,
    Placement,
    PlantingRules,
    PlotParameters,
    Scene,
    Species,
    SpeciesParameters,
    aim,
    build_scene,
)
from fynjax.sensors import Sensor, shipped_sensor

TAXA = ("Erica irregularis", "Restio eleocharis", "Deadwood")
FORMS = ("rounded_shrub", "tussock", "deadwood")


def small_parameters() -> PlotParameters:
    return PlotParameters(
        SpeciesParameters(
            cover=jnp.array([0.25, 0.15, 0.06]),
            diameter=jnp.array([0.41, 0.33, 0.13]),
            height=jnp.array([0.67, 0.51, 0.43]),
            packing=jnp.array([0.1, 0.05, 0.02]),
            fill=jnp.array([0.9, 0.8, 0.95]),
            leaf_area_index=jnp.array([3.0, 2.0, 0.0]),
            wood_area_index=jnp.array([0.5, 0.05, 0.8]),
            shoot_clumping=jnp.array([0.4, 0.2, 0.0]),
            dead_fraction=jnp.array([0.3, 0.45, 0.0]),
        ),
        LeafParameters.many(
            structure=jnp.array([1.8, 2.1, 1.5]),
            chlorophyll=jnp.array([55.0, 40.0, 30.0]),
            carotenoids=11.0,
            anthocyanins=1.5,
            brown_pigments=0.15,
            water=0.02,
            dry_matter=jnp.array([0.018, 0.03, 0.01]),
        ),
        GroundParameters(*(jnp.asarray(v) for v in (0.8, 0.4, 0.35, 0.0, 0.0, 0.9))),
        LightParameters(*(jnp.asarray(v) for v in (31.0, 17.0, 0.12))),
    )


EXACT = Accuracy(lattice=1, sublayers=1, levels=1, azimuths=4, tolerance=1e-11, iterations=200)
"""Few directions of light, refined and solved tightly: half as long to compile."""


def small_plot(**changes: Any) -> Scene:
    """A scene of 1.6 m; `changes` are arguments of `build_scene`, of its rules, or spreads. Leaves
    fill its voxels evenly, which compiles faster."""
    fields = {f.name for f in dataclasses.fields(PlantingRules)}
    rules = {"structure": "even"} | {n: changes.pop(n) for n in fields & set(changes)}
    spread = changes.pop("rotation_spread", [0.0] * len(TAXA))
    species = [
        Species(taxon, form, rotation_spread=lean)
        for taxon, form, lean in zip(TAXA, FORMS, spread, strict=True)
    ]
    options: dict[str, Any] = {"extent": (1.6, 1.6), "voxel": 0.1, "seed": 3, "dtype": "float64"}
    return build_scene(
        species, small_parameters(), **options | changes, rules=PlantingRules(**rules)
    )


def ruled(scene: Scene, **changes: Any) -> Scene:
    """The same plants with other `PlantingRules`."""
    rules = dataclasses.replace(scene.rules, **changes)
    return dataclasses.replace(scene, recipe=dataclasses.replace(scene.recipe, rules=rules))


def drone(
    scene: Scene, accuracy: Accuracy = EXACT, pixel: float = 0.1, sensor: Sensor | None = None
) -> AimedSensor:
    """The drone's camera 50 m over a scene, by default without blur."""
    if sensor is None:
        sensor = dataclasses.replace(shipped_sensor("mavic_3m"), psf=None)
    return aim(scene, small_parameters(), sensor, Placement(50.0, pixel), accuracy=accuracy)


reflectance = eqx.filter_jit(
    lambda camera, scene, parameters: camera.observe(scene, parameters).reflectance
)


def render(scene: Scene, parameters: PlotParameters, stride: int = 1) -> Array:
    """The drone's image [band, y, x]."""
    return reflectance(drone(scene).sampled(stride), scene, parameters)


densities = eqx.filter_jit(lambda scene, parameters: scene.area_density(parameters))

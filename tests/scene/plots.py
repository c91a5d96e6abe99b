"""A small plot that several tests share."""

from typing import Any

import equinox as eqx
import jax.numpy as jnp

from fynjax.leaf import LeafParameters
from fynjax.radiation import Accuracy
from fynjax.scene import (
    Camera,
    GroundParameters,
    LightParameters,
    PlotModel,
    PlotParameters,
    SpeciesParameters,
    build_model,
)
from fynjax.sensors import mavic_3m

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


def small_plot(**changes: Any) -> PlotModel:
    options: dict[str, Any] = {
        "extent": (1.6, 1.6),
        "voxel": 0.1,
        "camera": Camera(mavic_3m(), 50.0, 0.1),
        "seed": 3,
        "accuracy": Accuracy(tolerance=1e-11, iterations=200),
        "dtype": "float64",
    } | changes
    return build_model(TAXA, FORMS, small_parameters(), **options)


render = eqx.filter_jit(lambda model, parameters, stride=1: model.image(parameters, stride))
densities = eqx.filter_jit(lambda model, parameters: model.area_density(parameters))

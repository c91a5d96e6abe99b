"""How a scene's area lies in height, species by species."""

import numpy as np
from jaxtyping import Float

from fynjax.canopy import Organ
from fynjax.scene._parameters import PlotParameters
from fynjax.scene._scene import Scene


def height_profile(
    hard: Scene, parameters: PlotParameters, edges: Float[np.ndarray, " edge"]
) -> Float[np.ndarray, "organ species layer"]:
    """Mean area density of leaves and of wood of each species in layers of height [m2 m-3].

    **Arguments:**

    - `hard`: a scene whose plants all stand, as `hard_scene` gives.
    - `parameters`: of the plot.
    - `edges`: borders of the layers, rising [m]. What lies outside counts for the nearest layer.

    **Returns:** leaves, then wood; one-sided area that is visible from outside the shoots, as in
    `Scene.area_density`, per volume of the plot's layer. Not differentiable.
    """
    planting = hard.planting
    species, own = np.asarray(planting.species), parameters.species
    size, stature = np.asarray(planting.size, float), np.asarray(planting.stature, float)
    diameter = np.asarray(own.diameter, float)[species] * size
    height = np.asarray(own.height, float)[species] * stature
    lean = np.deg2rad(np.asarray(planting.tilt, float))
    # Height of an element: along the leaning axis, and what a lean lowers of its front.
    across, along = -diameter * np.sin(lean), height * np.cos(lean)
    position = np.asarray(planting.shapes.position, float)
    plant, part = np.asarray(planting.plant), np.asarray(planting.part)
    z = across[plant] * position[part, 1] + along[plant] * position[part, 2]
    layer = np.clip(np.searchsorted(edges, z, side="right") - 1, 0, len(edges) - 2)
    cell = species[plant] * (len(edges) - 1) + layer
    crown = np.asarray(hard.crown_areas(parameters), float) * float(hard.crown_share(parameters))
    over = np.asarray(hard.organ_index(parameters), float)
    volume = hard.ground_area * np.diff(edges)
    profiles = []
    fraction = np.asarray(planting.shapes.area_fraction)[part]
    for organ in (Organ.LEAF, Organ.WOOD):
        area = (crown * over[species, organ])[plant] * fraction
        area[np.asarray(planting.shapes.organ)[part] != organ] = 0.0
        sums = np.bincount(cell, area, len(hard.taxa) * (len(edges) - 1))
        profiles.append(sums.reshape(len(hard.taxa), -1) / volume)
    return np.stack(profiles)

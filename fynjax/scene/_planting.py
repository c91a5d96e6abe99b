"""Where plants may stand, how they are turned and how large each is: drawn once.

Turn and lean of a plant are fixed, so each of its area elements lies at site + diameter a +
height b with fixed vectors a and b: all plants of all species are placed in one expression.
"""

from collections.abc import Sequence

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from fynjax.canopy import (
    FORM_DEFAULTS,
    Organ,
    assign_sites,
    plant_model,
    poisson_disk,
    random_orientation,
    unit_shapes,
)


class Planting(eqx.Module):
    """All plants that may stand on a plot and their area elements."""

    species: Int[Array, " plant"]
    """Which species each plant belongs to."""
    place: Float[Array, " plant"]
    """Its place in the order in which its species fills the sites, from 0."""
    size: Float[Array, " plant"]
    """Crown diameter relative to the species' mean; the mean of its square is 1 [-]."""
    stature: Float[Array, " plant"]
    """Height relative to the species' greatest [-]."""
    plant: Int[Array, " element"]
    """Which plant each element belongs to."""
    site: Float[Array, "element 3"]
    """Foot of the plant [m]."""
    per_diameter: Float[Array, "element 3"]
    """Shift of the element per crown diameter [-]."""
    per_height: Float[Array, "element 3"]
    """Shift of the element per plant height [-]."""
    fraction: Float[Array, " element"]
    """Share of its organ's area on the plant [-]."""
    organ: Int[Array, " element"]
    optical_class: Int[Array, " element"]


def draw_planting(
    forms: Sequence[str],
    wanted: Float[np.ndarray, " species"],
    diameter: Float[np.ndarray, " species"],
    height: Float[np.ndarray, " species"],
    rotation_spread: Sequence[float],
    *,
    extent: tuple[float, float],
    voxel: float,
    periodic: bool,
    probability: Float[np.ndarray, "y x"] | None,
    room: float,
    size_variation: float,
    seed: int,
    dtype: str,
) -> Planting:
    """Draw sites, orientations and sizes; see `build_model` for the arguments.

    Raises `InputError` where a species finds no room on the plot.
    """
    needed = np.ceil(room * wanted).astype(int) + np.where(wanted > 0, 4, 0)
    # A disk radius that leaves a tenth more points than plants; Bridson packs 0.6 / r2 of them.
    crowd = max(1.1 * float(needed.sum()), 1.0)
    radius = min(0.1, float(np.sqrt(0.55 * extent[0] * extent[1] / crowd)))
    points = poisson_disk(extent, radius, seed=seed, periodic=periodic)
    sites = assign_sites(points, needed.tolist(), probability=probability, extent=extent, seed=seed)
    leafy = leafy_species(forms)
    wood = len(leafy)
    plants: list[dict[str, np.ndarray]] = []
    elements: list[dict[str, np.ndarray]] = []
    first = 0
    for i, (form, places) in enumerate(zip(forms, sites)):
        n = len(places)
        if n == 0:
            continue
        rng = np.random.default_rng([seed, 101, i])
        azimuth, tilt = random_orientation(
            n, seed=seed + 1000 * (i + 1), rotation_spread=rotation_spread[i]
        )
        size = np.exp(np.sqrt(np.log1p(size_variation**2)) * rng.standard_normal(n))
        plants.append(
            {
                "species": np.full(n, i),
                "place": np.arange(n),
                "size": size / np.sqrt(np.mean(size**2)),
                "stature": 0.6 + 0.4 * rng.random(n),
            }
        )
        plant = plant_model(form, _elements(diameter[i], height[i], voxel), seed=seed + i)
        k = len(plant.organ)
        per_diameter, per_height = unit_shapes(np.asarray(plant.position), azimuth, tilt)
        organ = np.tile(np.asarray(plant.organ), n)
        of_organ = np.array([leafy.get(i, 0), wood, wood + 1])
        elements.append(
            {
                "plant": first + np.repeat(np.arange(n), k),
                "site": np.repeat(np.pad(places, ((0, 0), (0, 1))), k, axis=0),
                "per_diameter": per_diameter.reshape(n * k, 3),
                "per_height": per_height.reshape(n * k, 3),
                "fraction": np.tile(np.asarray(plant.area_fraction), n),
                "organ": organ,
                "optical_class": of_organ[organ],
            }
        )
        first += n
    whole = {"species", "plant", "organ", "optical_class"}

    def joined(parts: list[dict[str, np.ndarray]]) -> dict[str, Array]:
        names = parts[0] if parts else {}
        return {
            name: jnp.asarray(
                np.concatenate([part[name] for part in parts]),
                jnp.int32 if name in whole else dtype,
            )
            for name in names
        }

    if not plants:
        return no_plants(dtype)
    return Planting(**joined(plants), **joined(elements))


def leafy_species(forms: Sequence[str]) -> dict[int, int]:
    """Optical class of the leaves of each species that has leaves."""
    with_leaves = [i for i, form in enumerate(forms) if FORM_DEFAULTS[form].leaf_area_index > 0]
    return {species: index for index, species in enumerate(with_leaves)}


def no_plants(dtype: str) -> Planting:
    none, vectors = jnp.zeros(0, dtype), jnp.zeros((0, 3), dtype)
    index = jnp.zeros(0, jnp.int32)
    return Planting(
        index, none, none, none, index, vectors, vectors, vectors, none, index + Organ.LEAF, index
    )


def _elements(diameter: float, height: float, voxel: float) -> int:
    """Area elements of a plant: about one for every two voxels that its crown touches, since
    thousands of plants stand on a plot."""
    touched = (diameter / voxel + 0.5) ** 2 * (height / voxel + 0.5)
    return int(np.clip(np.ceil(touched / 2), 16, 3000))

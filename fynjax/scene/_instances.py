"""The plants that stand on a plot: how many, and the place and size of each."""

import dataclasses
from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from fynjax._core.errors import InputError
from fynjax.canopy import clark_evans
from fynjax.scene._parameters import PlotParameters
from fynjax.scene._scene import Scene, ground_at


@dataclass(frozen=True)
class Instances:
    """Plants that stand on a plot: species by species, in the order in which each fills it."""

    taxa: tuple[str, ...]
    """Names of the species."""
    extent: tuple[float, float]
    """East-west and north-south side of the plot [m]."""
    species: Int[np.ndarray, " plant"]
    """Index into `taxa`."""
    x: Float[np.ndarray, " plant"]
    """Foot, eastward [m]."""
    y: Float[np.ndarray, " plant"]
    """Foot, northward [m]."""
    z: Float[np.ndarray, " plant"]
    """Foot, upward from the lowest ground [m]."""
    azimuth: Float[np.ndarray, " plant"]
    """Turn about the vertical, clockwise from above [degrees]."""
    tilt: Float[np.ndarray, " plant"]
    """Lean of the axis from the vertical, towards the azimuth [degrees]."""
    diameter: Float[np.ndarray, " plant"]
    """Diameter of the crown [m]."""
    height: Float[np.ndarray, " plant"]
    """Length of the axis [m]."""
    leaf: Int[np.ndarray, " plant"] | None = None
    """Place of each plant's leaf among the leaves of its species, from 0; None: every species has
    one leaf."""

    def __len__(self) -> int:
        return len(self.species)

    @property
    def counts(self) -> Int[np.ndarray, " species"]:
        """Plants of each species [-]."""
        return np.bincount(self.species, minlength=len(self.taxa))


def clark_evans_indices(instances: Instances, *, periodic: bool) -> Float[np.ndarray, " index"]:
    """Index of Clark and Evans of the plants of each species, and of all together at the end [-].

    **Arguments:** `instances`, the plants; `periodic`, whether their plot repeats itself.

    **Returns:** `fynjax.canopy.clark_evans`, NaN of fewer than two plants.
    """
    feet = np.stack([instances.x, instances.y], axis=1)
    of_each = [feet[instances.species == i] for i in range(len(instances.taxa))]
    extent = instances.extent
    return np.array([clark_evans(f, extent, periodic=periodic) for f in (*of_each, feet)])


def hard_counts(scene: Scene, parameters: PlotParameters) -> Int[np.ndarray, " species"]:
    """Whole number of plants of each species that stand, as `Scene.rounding` has it [-].

    **Arguments:**

    - `scene`: whose extent counts, and what it fixes about the species.
    - `parameters`: of the plot.

    Not differentiable; `Scene.counts` is.
    """
    return np.asarray(scene.whole_counts(parameters)).astype(np.int64)


def hard_instances(scene: Scene, parameters: PlotParameters) -> Instances:
    """The plants that stand: those that every sensor sees.

    **Arguments:**

    - `scene`: in which the plants are chosen.
    - `parameters`: of the plot: covers and sizes.

    **Raises:** `InputError` where a species has fewer sites held ready than plants.

    Not differentiable.
    """
    planting = scene.planting
    chosen = np.flatnonzero(standing_plants(scene, parameters))
    species, place = np.asarray(planting.species)[chosen], np.asarray(planting.place)[chosen]
    # By species, then by the order in which the species fills its sites.
    order = np.lexsort((place, species))
    species, chosen = species[order], chosen[order]
    foot = np.asarray(planting.foot, float)[chosen]
    own = {
        name: np.asarray(getattr(parameters.species, name), float)[species]
        for name in ("diameter", "height")
    }
    return Instances(
        scene.taxa,
        scene.grid.extent[:2],
        species,
        foot[:, 0],
        foot[:, 1],
        np.asarray(ground_at(scene, planting.foot[chosen]), float),
        np.asarray(planting.azimuth, float)[chosen],
        np.asarray(planting.tilt, float)[chosen],
        own["diameter"] * np.asarray(planting.size, float)[chosen],
        own["height"] * np.asarray(planting.stature, float)[chosen],
        None if planting.leaf is None else np.asarray(planting.leaf)[chosen],
    )


def hard_scene(scene: Scene, parameters: PlotParameters) -> Scene:
    """The plot with the plants of `hard_instances` and no spare ones, as every sensor sees it.

    These plants stand whatever a cover is later set to; everything else follows the parameters as
    before. A fraction of the area elements is left, and the memory with it. Their number has no
    slope.

    **Arguments:**

    - `scene`: with the plants held ready.
    - `parameters`: of the plot, by which plants are chosen.

    **Raises:** `InputError` as `hard_instances`.
    """
    return dataclasses.replace(
        scene.expected(False),
        planting=scene.planting.only(standing_plants(scene, parameters)),
        number=jnp.asarray(hard_counts(scene, parameters), scene.dtype),
        rounding=jnp.zeros_like(scene.rounding),
        recipe=dataclasses.replace(
            scene.recipe, rules=dataclasses.replace(scene.rules, softness=0.0, softness_plants=0.0)
        ),
        planted=None,
    )


def standing_plants(scene: Scene, parameters: PlotParameters) -> np.ndarray:
    """Mask of the plants that stand. Raises `InputError` as `hard_instances`."""
    count = hard_counts(scene, parameters)
    species = np.asarray(scene.planting.species)
    ready = np.bincount(species, minlength=len(count))
    short = np.flatnonzero(ready < count)
    if short.size:
        one = short[0]
        raise InputError(
            f"{scene.taxa[one]!r} is to have {count[one]} plants, but {ready[one]} sites are held "
            "ready: build the scene with these parameters, or with more `room`"
        )
    return np.asarray(scene.planting.place) < count[species]

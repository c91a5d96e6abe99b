"""How much area and leaf mass stands on a plot, and how much of its ground is seen from above."""

from dataclasses import dataclass

import equinox as eqx
import numpy as np
from jaxtyping import Float

from fynjax.canopy import Organ
from fynjax.scene._optics import mean_trait
from fynjax.scene._parameters import PlotParameters
from fynjax.scene._scene import Scene

SPARSEST, DENSEST = 0.4, 5.1
"""Stand leaf area of shrublands lies between [m2 m-2]: that of deserts, 1.3, less its standard
deviation, and that of temperate evergreen forest, 5.1 to 6.7 (Asner, Scurlock and Hicke 2003,
Global Ecology and Biogeography 12:191)."""
HEAVIEST = 1100.0
"""All dry mass above ground of mature fynbos is 1100 to 1500 g m-2 (Kruger 1977, Bothalia
12:301; Rutherford 1978: at most 1431); its leaves weigh less."""


_gap_fraction = eqx.filter_jit(Scene.gap_fraction)


@dataclass(frozen=True)
class StandArea:
    """One-sided areas over the ground of a whole plot."""

    leaf: Float[np.ndarray, " species"]
    """Live leaf area index of the stand, of each species [m2 m-2]."""
    dead: Float[np.ndarray, " species"]
    """Area index of the dead tissue in live shoots, of each species [m2 m-2]."""
    wood: Float[np.ndarray, " species"]
    """Wood area index, of each species [m2 m-2]."""
    leaf_mass: Float[np.ndarray, " species"]
    """Dry mass of leaves and dead tissue, both at the leaf mass per area of leaves [g m-2]."""
    gap: float
    """Share of the ground that is seen from straight above [-]."""

    def warnings(self) -> list[str]:
        """What lies outside shrublands' usual ranges, in sentences; nothing of a bare plot."""
        leaf, mass = float((self.leaf + self.dead).sum()), float(self.leaf_mass.sum())
        messages = []
        if leaf > 0.0 and not SPARSEST <= leaf <= DENSEST:
            messages.append(
                f"the area of leaves, live and dead, of {leaf:.2f} m2 m-2 over the plot is outside "
                f"{SPARSEST:g} to {DENSEST:g}, between deserts (1.3, sd 0.9) and temperate "
                "evergreen forests (5.1 to 6.7; Asner et al. 2003)"
            )
        if mass > HEAVIEST:
            messages.append(
                f"leaves of {mass:.0f} g m-2 weigh as much as all that stands above ground in "
                "mature fynbos, 1100 to 1500 g m-2 (Kruger 1977; Rutherford 1978)"
            )
        return messages


def stand_area(scene: Scene, parameters: PlotParameters) -> StandArea:
    """Areas, leaf mass and gap of a plot.

    **Arguments:**

    - `scene`: with the plants.
    - `parameters`: of the plot.

    Not differentiable; `Scene.area_density` and `Scene.gap_fraction` are.
    """
    species, planting = parameters.species, scene.planting
    plot = scene.ground_area
    crowns = np.asarray(scene.crown_areas(parameters), float) * float(scene.crown_share(parameters))
    # Only organs that a plant's shape has carry area.
    plant, organ = np.asarray(planting.plant), np.asarray(planting.organ)
    bears = np.bincount(
        np.asarray(planting.species)[plant] * len(Organ) + organ,
        np.asarray(planting.fraction, float) * crowns[plant] / plot,
        len(scene.taxa) * len(Organ),
    ).reshape(-1, len(Organ))
    shoots = bears[:, Organ.LEAF] * np.asarray(species.leaf_area_index, float)
    dead = shoots * np.asarray(species.dead_fraction, float)
    # Contents are per half the surface [g cm-2]; areas are one-sided too.
    dry = mean_trait(scene.species, parameters, "dry_matter")
    mass = shoots * np.asarray(dry, float) * 1e4
    wood = bears[:, Organ.WOOD] * np.asarray(species.wood_area_index, float)
    return StandArea(shoots - dead, dead, wood, mass, float(_gap_fraction(scene, parameters)))

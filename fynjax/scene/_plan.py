"""What a scene will have, counted before anything is planted."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Int

from fynjax.canopy import thin_plant
from fynjax.scene._planting import Stand, element_count

_MOST_FINEST = 1e8
"""Finest voxels beyond which a picture is rendered in tiles."""
_BYTES, _SITE_BYTES = 0.9e9, 700.0
_VOXEL_BYTES, _FINEST_BYTES = 380.0, 30.0
_TILED_BYTES, _TILED_VOXEL_BYTES = 1e9, 190.0
_SECONDS, _SITE_SECONDS, _VOXEL_SECONDS, _FINEST_SECONDS = 14.0, 5e-5, 1e-5, 1.2e-7
"""What a run takes at least, and for each site, voxel and finest voxel: measured of `fynjax render`
in 4 bands on plots of 5 to 40 m, and of the planting of 100 m."""


@dataclass(frozen=True)
class ScenePlan:
    """What a scene will have, and what a picture of it will take."""

    taxa: tuple[str, ...]
    """Names of the species."""
    plants: Int[np.ndarray, " species"]
    """Plants of each species that stand."""
    sites: Int[np.ndarray, " species"]
    """Sites held ready for each species."""
    each: Int[np.ndarray, " species"]
    """Area elements of a plant of each species."""
    voxels: tuple[int, int, int]
    """Voxels along x, y and z."""
    finer: int
    """Finest voxels along the edge of a voxel; 0: leaves fill it evenly."""

    @classmethod
    def of(
        cls,
        stand: Stand,
        plants: np.ndarray,
        sites: np.ndarray,
        *,
        voxels: tuple[int, int, int],
        finer: int,
    ) -> "ScenePlan":
        """The plan of a stand of so many plants of each species on so many sites."""
        each = np.array([_elements(stand, i) for i in range(len(stand.species))])
        taxa = tuple(one.taxon for one in stand.species)
        return cls(taxa, plants.astype(int), sites.astype(int), each, voxels, finer)

    @property
    def elements(self) -> int:
        """Area elements of the plants that stand."""
        return int(self.plants @ self.each)

    @property
    def memory(self) -> float:
        """Memory of a picture in a few bands [bytes], by order of magnitude."""
        voxels, finest = self._voxels
        light = _VOXEL_BYTES * voxels + _FINEST_BYTES * finest
        if finest > _MOST_FINEST:
            light = _TILED_BYTES + _TILED_VOXEL_BYTES * voxels
        return _BYTES + _SITE_BYTES * float(self.sites.sum()) + light

    @property
    def seconds(self) -> float:
        """Processor time of planting and one picture in a few bands [s], by order of magnitude."""
        voxels, finest = self._voxels
        picture = _VOXEL_SECONDS * voxels + _FINEST_SECONDS * finest
        return _SECONDS + _SITE_SECONDS * float(self.sites.sum()) + picture

    @property
    def _voxels(self) -> tuple[int, int]:
        voxels = math.prod(self.voxels)
        return voxels, voxels * self.finer**3

    def record(self) -> dict[str, Any]:
        """The plan as numbers with their units in the names, for programs."""
        return {
            "plants": dict(zip(self.taxa, self.plants.tolist(), strict=True)),
            "elements": self.elements,
            "voxels": self.voxels,
            "finest_voxels": self._voxels[1],
            "memory_gib": round(self.memory / 2**30, 1),
            "seconds": round(self.seconds),
        }

    def __str__(self) -> str:
        finest = f" of {self.finer}³ finest voxels each" if self.finer else ""
        minutes = self.seconds / 60.0
        time = f"{minutes:.0f} min" if minutes >= 2 else f"{self.seconds:.0f} s"
        return (
            f"{self.plants.sum()} plants of {len(self.taxa)} species with "
            f"{self.elements} area elements, on {' x '.join(map(str, self.voxels))} voxels{finest}."
            f"\nA picture of a few bands takes about {self.memory / 2**30:.1f} GiB of memory and "
            f"{time} of a processor, planting included."
        )


def _elements(stand: Stand, species: int) -> int:
    """Area elements of a plant of a species."""
    size = stand.diameter[species], stand.height[species], stand.resolved
    number = element_count(*size, structured=stand.structured)
    model = stand.models[species]
    if model is None:
        return number
    return len(thin_plant(model, number, seed=stand.seed + species).organ)

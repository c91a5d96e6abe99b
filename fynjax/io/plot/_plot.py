"""A plot and its species as its files describe them: lengths in m, shares as fractions."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pydantic import ConfigDict, InstanceOf

from fynjax.io.plot._calibration import CalibrationTable
from fynjax.io.plot._plot_tables import (
    AtmosphereTable,
    GroundTable,
    PlotTable,
    SceneTable,
    SensorTable,
    SkyTable,
)
from fynjax.scene import Crowns
from fynjax.sensors import SunPosition

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class LeafSource:
    """Where the optics of a taxon's leaves come from: exactly one of the two is set."""

    parameters: dict[str, float] | None
    """PROSPECT-D parameters by column name, in PROSPECT's units (`fynjax.scene.LEAF_FIELDS`)."""
    spectrum: Path | None
    """File of a measured reflectance spectrum, to be fitted."""


@dataclass(frozen=True)
class Species:
    """One taxon of the plot. `None` means: take the default of the growth form."""

    taxon: str
    diameter_m: float
    """Mean crown diameter [m]."""
    cover: float
    """Share of the ground under the crowns [-], 0 to 1."""
    height_m: float
    """Greatest height [m]."""
    growth_form: str
    """A key of `fynjax.canopy.FORMS`."""
    leaf: LeafSource | None
    """Leaf optics; `None` where the plot has no leaf table, and for deadwood."""
    packing: float
    """Share of a crown over its neighbours, PE/100 of equation (8) [-]."""
    fill: float
    """Share of the crown circle filled, FF/100 of equation (9) [-]."""
    branches: int | None
    """Branch models of one plant [-]."""
    rotation_spread_deg: float | None
    """Spread of the branches' tilt, sigma_rot [degree]."""
    minimum_object_area_m2: float | None
    """Least ground area that one plant counts for [m2]."""
    leaf_area_index: float | None
    """One-sided leaf area over the area of the crowns as seen from above [m2 m-2]."""
    wood_area_index: float | None
    """One-sided wood area over the area of the crowns as seen from above [m2 m-2]."""
    plant: Path | None
    """Mesh or area elements of one plant; `None` takes the shape of the growth form."""
    shoot_clumping: float | None
    """Probability that scattered light meets another leaf of the same shoot [-]."""
    dead_fraction: float | None
    """Share of the area of live shoots that is dead or woody tissue [-]."""


class Plot(PlotTable, SceneTable):
    """A plot as its files describe it: lengths in m, shares as fractions, paths absolute.

    The keys of [plot] and [scene], the other tables of the plot file, and the species.
    """

    model_config = ConfigDict(arbitrary_types_allowed=True)

    file: Path
    """The plot file."""
    species: tuple[InstanceOf[Species], ...]
    """In the order of the species table."""
    sun: SunPosition
    """Direction to the sun and sunlight of the day, from its angles or from place and time."""
    sky: SkyTable
    ground: GroundTable
    sensor: SensorTable
    """Of a sensor file of the user, with the sensor's own name."""
    air: AtmosphereTable | None
    """The plot file's [atmosphere]; `None` where it has none."""
    calibration: CalibrationTable
    inputs: tuple[Path, ...]
    """Every file that was read or is named, for the provenance record."""
    known_crowns: InstanceOf[Crowns] | None = None
    """The plants, where they are known; `None`: as the species table has them, by chance."""
    crowns_note: str | None = None
    """How far covers and sizes that follow from the crowns are from the species table's."""

    @property
    def taxa(self) -> tuple[str, ...]:
        """Names, in the order of the species table."""
        return tuple(s.taxon for s in self.species)

    @property
    def cover(self) -> Floats:
        """Cover of each species [-]."""
        return np.array([s.cover for s in self.species])

    @property
    def diameter_m(self) -> Floats:
        """Mean crown diameter of each species [m]."""
        return np.array([s.diameter_m for s in self.species])

    @property
    def height_m(self) -> Floats:
        """Greatest height of each species [m]."""
        return np.array([s.height_m for s in self.species])

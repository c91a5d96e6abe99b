"""A plot and its species as its files describe them: lengths in m, shares as fractions."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pydantic import ConfigDict, Field, InstanceOf

from fynjax.app.io.plot._calibration import CalibrationTable
from fynjax.app.io.plot._plot_tables import (
    AtmosphereTable,
    GroundTable,
    PlotTable,
    SceneTable,
    SensorTable,
    SkyTable,
    SunTable,
    TargetTable,
)
from fynjax.app.io.plot._prior import LearnedPrior
from fynjax.canopy import Shrubland
from fynjax.scene import CoverDefinition, Crowns, LeafRow, SpeciesRow
from fynjax.sensors import SunPosition

Floats = NDArray[np.float64]


def in_the_cape(latitude: float, longitude: float) -> bool:
    """Whether a place is in the Cape, of whose shrubland the shipped prior is.

    **Arguments:** `latitude` and `longitude` [degree], south and west negative.
    """
    return -35.0 <= latitude <= -31.0 and 17.5 <= longitude <= 27.0


class Plot(PlotTable, SceneTable):
    """A plot as its files describe it: lengths in m, shares as fractions, paths absolute.

    The keys of [plot] and [scene], the other tables of the plot file, and the species.
    """

    model_config = ConfigDict(arbitrary_types_allowed=True)

    file: Path
    """The plot file."""
    cover_definition: CoverDefinition = "projected"
    """Meaning of the covers, see `PlantingRules`."""
    species: tuple[SpeciesRow, ...]
    """Rows of the species table, in its order."""
    leaves: tuple[LeafRow, ...]
    """Rows of the leaf table; empty where the plot has none."""
    sun: SunPosition
    """Direction to the sun, from the plot's north, and sunlight of the day."""
    sun_table: SunTable
    """The plot file's [sun]."""
    grid_north_deg: float | None = None
    """Direction of the plot's north, the grid north of its maps or of an image of it, clockwise
    from true north [degree]; `None` where nothing says: true north."""
    place_deg: tuple[float, float] | None = None
    """Latitude and longitude [degree], as the plot file states them or its maps, or an image of it,
    lie; `None` where nothing says."""
    sky: SkyTable
    ground: GroundTable
    sensor: SensorTable
    """The plot file's [sensor], with the sensor's own name where it is a file of the user's."""
    air: AtmosphereTable | None
    """The plot file's [atmosphere]; `None` where it has none."""
    calibration: CalibrationTable
    targets: tuple[TargetTable, ...] = ()
    """What was measured, view by view: the plot file's [[target]]."""
    inputs: tuple[Path, ...]
    """Every file that was read or is named, for the provenance record."""
    leaf_files: dict[str, tuple[Path, ...]] = Field(default_factory=dict)
    """Files of leaf spectra of each taxon that `leaf_spectra` has some of."""
    known_crowns: InstanceOf[Crowns] | None = None
    """The plants, where they are known; `None`: as the species table has them, by chance."""
    crowns_note: str | None = None
    """A sentence on how far covers and sizes that follow from the crowns are from the species
    table's; `None` where the plants are not known."""
    prior: InstanceOf[LearnedPrior] | None = None
    """The learned population that filled in what the tables leave open; `None`: none did."""
    plant_sources: str | None = None
    """A line on where the values of the plants are from, written before a learned population filled
    in what the tables leave open; `None`: `plant_sources` says it of the tables as they are."""

    @property
    def shrubland(self) -> Shrubland:
        """Source of what tables leave open about plants: as the plot file says, else by place."""
        if self.plants is not None or self.place_deg is None:
            return self.plants or "fynbos"
        return "fynbos" if self.in_the_cape else "generic"

    @property
    def in_the_cape(self) -> bool:
        """Whether its place is known and in the Cape."""
        return self.place_deg is not None and in_the_cape(*self.place_deg)

    @property
    def maps(self) -> dict[str, Path]:
        """Maps of the plot by kind: ground heights, probability and ground covers."""
        maps = {
            "a raster of heights": self.terrain,
            "a probability map": self.probability_map,
            "a map of ground covers": self.ground.map,
        }
        return {what: path for what, path in maps.items() if path is not None}

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
        return np.array([s.diameter for s in self.species])

    @property
    def height_m(self) -> Floats:
        """Greatest height of each species [m]."""
        return np.array([s.height for s in self.species])

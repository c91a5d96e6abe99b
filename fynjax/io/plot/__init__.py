"""A plot as its files describe it: plot file, species and leaf tables, statistics."""

from fynjax.io.plot._parameter_values import with_parameter_table
from fynjax.io.plot._place import Place, plot_place
from fynjax.io.plot._plot import (
    Air,
    Calibration,
    Ground,
    LeafSource,
    Plot,
    Sensor,
    Sky,
    Species,
    Sun,
)
from fynjax.io.plot._plot_file import as_plot, example_folder, read_plot
from fynjax.io.plot._plot_tables import PlotFile
from fynjax.io.plot._rows import (
    LeafRow,
    ParameterRow,
    SkyPatternRow,
    SkyRow,
    SpeciesRow,
    StatisticRow,
    StructureRow,
)
from fynjax.io.plot._sensor import (
    drone_sensor,
    optical_pixel,
    plot_instrument,
    sensor_altitude,
    visible_sensor,
)
from fynjax.io.plot._statistics import TargetStatistics, read_statistics, read_structure

__all__ = [
    "Air",
    "Calibration",
    "Ground",
    "LeafRow",
    "LeafSource",
    "ParameterRow",
    "Place",
    "Plot",
    "PlotFile",
    "Sensor",
    "Sky",
    "SkyPatternRow",
    "SkyRow",
    "Species",
    "SpeciesRow",
    "StatisticRow",
    "StructureRow",
    "Sun",
    "TargetStatistics",
    "as_plot",
    "drone_sensor",
    "example_folder",
    "optical_pixel",
    "plot_instrument",
    "plot_place",
    "read_plot",
    "read_statistics",
    "read_structure",
    "sensor_altitude",
    "visible_sensor",
    "with_parameter_table",
]

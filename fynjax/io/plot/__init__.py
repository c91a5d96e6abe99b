"""A plot as its files describe it: plot file, species and leaf tables, statistics."""

from fynjax.io.plot._calibration import CalibrationTable
from fynjax.io.plot._leaf_spectra import LeafFileRow
from fynjax.io.plot._parameter_values import with_parameter_table
from fynjax.io.plot._place import Place, placed_by, plot_place
from fynjax.io.plot._plants import plant_sources, plot_spreads, with_prior
from fynjax.io.plot._plot import Plot
from fynjax.io.plot._plot_file import as_plot, example_folder, read_plot
from fynjax.io.plot._plot_tables import AtmosphereTable, PlotFile
from fynjax.io.plot._prior import (
    BY_FORM,
    DEFAULT_PRIOR,
    FACTORS,
    LEAFY_FORMS,
    NO_PRIOR,
    PRIOR_PARAMETERS,
    SHIPPED_PRIORS,
    LearnedPrior,
    LeftOutPlot,
    ModelError,
    PriorFile,
    PriorParameter,
    assumed_by_form,
    leaf_factors,
    read_prior,
    write_prior,
)
from fynjax.io.plot._rows import (
    CrownRow,
    ParameterRow,
    SkyPatternRow,
    SkyRow,
    StatisticRow,
    StructureRow,
)
from fynjax.io.plot._sensor import (
    drone_sensor,
    plot_instrument,
    sensor_place,
)
from fynjax.io.plot._sky import read_sky, read_sky_pattern
from fynjax.io.plot._statistics import read_statistics, read_structure

__all__ = [
    "BY_FORM",
    "DEFAULT_PRIOR",
    "FACTORS",
    "LEAFY_FORMS",
    "NO_PRIOR",
    "PRIOR_PARAMETERS",
    "SHIPPED_PRIORS",
    "AtmosphereTable",
    "CalibrationTable",
    "CrownRow",
    "LeafFileRow",
    "LearnedPrior",
    "LeftOutPlot",
    "ModelError",
    "ParameterRow",
    "Place",
    "Plot",
    "PlotFile",
    "PriorFile",
    "PriorParameter",
    "SkyPatternRow",
    "SkyRow",
    "StatisticRow",
    "StructureRow",
    "as_plot",
    "assumed_by_form",
    "drone_sensor",
    "example_folder",
    "leaf_factors",
    "placed_by",
    "plant_sources",
    "plot_instrument",
    "plot_place",
    "plot_spreads",
    "read_plot",
    "read_prior",
    "read_sky",
    "read_sky_pattern",
    "read_statistics",
    "read_structure",
    "sensor_place",
    "with_parameter_table",
    "with_prior",
    "write_prior",
]

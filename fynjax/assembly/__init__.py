"""From files to a scene: what turns a plot file and its tables into a model and parameters."""

from fynjax.assembly._build import USUAL_LEAF, build_plot, plot_parameters
from fynjax.assembly._forward import (
    STRIDE,
    Prepared,
    batch_for_device,
    parameter_columns,
    prepare,
    shown_unit,
)
from fynjax.assembly._ground import cover_spectra, soil_spectra
from fynjax.assembly._sensing import build_sensing
from fynjax.assembly._targets import Measured, read_targets

__all__ = [
    "STRIDE",
    "USUAL_LEAF",
    "Measured",
    "Prepared",
    "batch_for_device",
    "build_plot",
    "build_sensing",
    "cover_spectra",
    "parameter_columns",
    "plot_parameters",
    "prepare",
    "read_targets",
    "shown_unit",
    "soil_spectra",
]

"""Scene: a plot put together from leaves, plants, light and a sensor."""

from fynjax.scene._model import Camera, PlotModel, band_wavelengths, build_model, replant
from fynjax.scene._parameters import (
    LEAF_FIELDS,
    GroundParameters,
    LightParameters,
    PlotParameters,
    SpeciesParameters,
    named_values,
    parameter_units,
    with_values,
)
from fynjax.scene._planting import Planting, draw_planting
from fynjax.scene._spectra import background_spectrum

__all__ = [
    "LEAF_FIELDS",
    "Camera",
    "GroundParameters",
    "LightParameters",
    "Planting",
    "PlotModel",
    "PlotParameters",
    "SpeciesParameters",
    "background_spectrum",
    "band_wavelengths",
    "build_model",
    "draw_planting",
    "named_values",
    "parameter_units",
    "replant",
    "with_values",
]

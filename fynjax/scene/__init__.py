"""Scene: a plot put together from leaves, plants, light and a sensor."""

from fynjax.scene._cover import ProjectedCover, crown_centres, projected_cover
from fynjax.scene._ground import COVERS, ground_shares, random_patches
from fynjax.scene._instances import Instances, hard_counts, hard_instances, hard_model
from fynjax.scene._observe import Observation, PlotAir, PlotSensing, plot_sensing
from fynjax.scene._parameters import (
    LEAF_FIELDS,
    PARAMETERS,
    GroundParameters,
    LightParameters,
    PlotParameters,
    SpeciesParameters,
    named_values,
    parameter_kind,
    parameter_reference,
    with_values,
)
from fynjax.scene._planting import Planting, draw_planting, element_count, leafy_species
from fynjax.scene._profile import height_profile
from fynjax.scene._scene import Camera, PlotModel, band_wavelengths, build_model, ground_at, replant
from fynjax.scene._spectra import background_spectrum, shipped_covers

__all__ = [
    "COVERS",
    "LEAF_FIELDS",
    "PARAMETERS",
    "Camera",
    "GroundParameters",
    "Instances",
    "LightParameters",
    "Observation",
    "Planting",
    "PlotAir",
    "PlotModel",
    "PlotParameters",
    "PlotSensing",
    "ProjectedCover",
    "SpeciesParameters",
    "background_spectrum",
    "band_wavelengths",
    "build_model",
    "crown_centres",
    "draw_planting",
    "element_count",
    "ground_at",
    "ground_shares",
    "hard_counts",
    "hard_instances",
    "hard_model",
    "height_profile",
    "leafy_species",
    "named_values",
    "parameter_kind",
    "parameter_reference",
    "plot_sensing",
    "projected_cover",
    "random_patches",
    "replant",
    "shipped_covers",
    "with_values",
]

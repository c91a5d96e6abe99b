"""Leaf optics: PROSPECT, forward and backward."""

from fynjax.leaf._area import FLAT, ROUND, LeafArea, LeafShape, area_factors
from fynjax.leaf._coefficients import ProspectVersion
from fynjax.leaf._detectors import DARKEST_JUMP, LARGEST_JUMP, correct_detector_jumps
from fynjax.leaf._error_model import (
    ErrorModel,
    ErrorName,
    bin_centres,
    default_error_model,
    to_bins,
    to_nanometres,
)
from fynjax.leaf._fit import LeafChunks, fit_leaf
from fynjax.leaf._groups import LeafGroups, fit_leaf_groups
from fynjax.leaf._measurement import (
    MEASUREMENT_PARAMETERS,
    MEASUREMENTS,
    AbstractMeasurement,
    IntegratingSphere,
    LeafClip,
    LeafOverBackground,
    LeafStack,
    recollided,
    resolved_by_two_readings,
    transmittance_from_two_readings,
    usual_measurement,
)
from fynjax.leaf._parameters import (
    LEAF_PARAMETERS,
    Leaf,
    LeafParameters,
    structure_from_dry_matter,
)
from fynjax.leaf._posterior import LeafPosterior, sample_leaf_posterior
from fynjax.leaf._problem import FitDomain, LeafSettings
from fynjax.leaf._prospect import (
    LeafOptics,
    cylinder_transmissivity,
    interface_transmissivity,
    prospect,
)
from fynjax.leaf._result import LeafFit, LeafStatus
from fynjax.leaf._species_prior import species_prior
from fynjax.leaf._transmissivity import exponential_integral, layer_absorptance

__all__ = [
    "DARKEST_JUMP",
    "FLAT",
    "LARGEST_JUMP",
    "LEAF_PARAMETERS",
    "MEASUREMENTS",
    "MEASUREMENT_PARAMETERS",
    "ROUND",
    "AbstractMeasurement",
    "ErrorModel",
    "ErrorName",
    "FitDomain",
    "IntegratingSphere",
    "Leaf",
    "LeafArea",
    "LeafChunks",
    "LeafClip",
    "LeafFit",
    "LeafGroups",
    "LeafOptics",
    "LeafOverBackground",
    "LeafParameters",
    "LeafPosterior",
    "LeafSettings",
    "LeafShape",
    "LeafStack",
    "LeafStatus",
    "ProspectVersion",
    "area_factors",
    "bin_centres",
    "correct_detector_jumps",
    "cylinder_transmissivity",
    "default_error_model",
    "exponential_integral",
    "fit_leaf",
    "fit_leaf_groups",
    "interface_transmissivity",
    "layer_absorptance",
    "prospect",
    "recollided",
    "resolved_by_two_readings",
    "sample_leaf_posterior",
    "species_prior",
    "structure_from_dry_matter",
    "to_bins",
    "to_nanometres",
    "transmittance_from_two_readings",
    "usual_measurement",
]

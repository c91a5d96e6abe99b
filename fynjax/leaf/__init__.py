"""Leaf optics: PROSPECT, forward and backward."""

from fynjax.leaf._area import FLAT, ROUND, LeafArea, LeafShape, area_factors
from fynjax.leaf._coefficients import ProspectVersion
from fynjax.leaf._detectors import DARKEST_JUMP, LARGEST_JUMP, correct_detector_jumps
from fynjax.leaf._error_model import ErrorModel, ErrorName, bin_centres, to_bins, to_nanometres
from fynjax.leaf._fit import LeafChunks, fit_leaf
from fynjax.leaf._groups import LeafGroups, fit_leaf_groups
from fynjax.leaf._measurement import (
    MEASUREMENTS,
    AbstractMeasurement,
    IntegratingSphere,
    LeafClip,
    LeafOverBackground,
    LeafStack,
    resolved_by_two_readings,
    transmittance_from_two_readings,
    usual_measurement,
)
from fynjax.leaf._parameters import LEAF_PARAMETERS, Leaf, LeafParameters, structure_from_dry_matter
from fynjax.leaf._posterior import LeafPosterior, sample_leaf_posterior
from fynjax.leaf._problem import FitDomain, LeafSettings
from fynjax.leaf._prospect import LeafOptics, prospect
from fynjax.leaf._result import LeafFit, LeafStatus
from fynjax.leaf._species_prior import species_prior

__all__ = [
    "LEAF_PARAMETERS",
    "AbstractMeasurement",
    "ErrorModel",
    "IntegratingSphere",
    "Leaf",
    "LeafClip",
    "LeafFit",
    "LeafGroups",
    "LeafOptics",
    "LeafOverBackground",
    "LeafParameters",
    "LeafPosterior",
    "LeafSettings",
    "LeafStack",
    "LeafStatus",
    "ProspectVersion",
    "fit_leaf",
    "fit_leaf_groups",
    "prospect",
    "sample_leaf_posterior",
    "species_prior",
]

"""Inversion: from measured statistics back to the parameters of a plot."""

from fynjax.inversion._calibrate import COARSE, Calibration, calibrate_plot, free_space
from fynjax.inversion._fit import Data, FitResult, Forward, fit
from fynjax.inversion._space import PLAUSIBLE, ParameterSpace, make_space, match_names

__all__ = [
    "COARSE",
    "PLAUSIBLE",
    "Calibration",
    "Data",
    "FitResult",
    "Forward",
    "ParameterSpace",
    "calibrate_plot",
    "fit",
    "free_space",
    "make_space",
    "match_names",
]

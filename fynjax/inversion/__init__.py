"""Inversion: from measured statistics back to the parameters of a plot."""

from fynjax.inversion._calibrate import COARSE, Calibration, calibrate_plot, free_space
from fynjax.inversion._fit import Forward, fit
from fynjax.inversion._fit_result import SEEN, Data, FitResult
from fynjax.inversion._space import PLAUSIBLE, ParameterSpace, make_space, match_names
from fynjax.inversion._targets import IMAGE_STATISTICS, weigh_targets

__all__ = [
    "COARSE",
    "IMAGE_STATISTICS",
    "PLAUSIBLE",
    "SEEN",
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
    "weigh_targets",
]

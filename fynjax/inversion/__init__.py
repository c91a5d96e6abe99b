"""Inversion: from measured statistics back to the parameters of a plot."""

from fynjax.inversion._calibrate import (
    COARSE,
    Calibration,
    calibrate_plot,
    coarser,
    free_space,
    plot_statistics,
)
from fynjax.inversion._fit import Forward, fit
from fynjax.inversion._fit_result import SEEN, Data, FitResult
from fynjax.inversion._information import Information, fisher_information
from fynjax.inversion._posterior import LogPosterior, sample_posterior
from fynjax.inversion._posterior_result import Posterior
from fynjax.inversion._sensitivity import (
    DerivativeMeasures,
    LocalSensitivity,
    SobolIndices,
    derivative_measures,
    local_sensitivity,
    sobol_indices,
)
from fynjax.inversion._sensor_sweep import SensorSetting, even_bands, sweep_sensors
from fynjax.inversion._space import PLAUSIBLE, ParameterSpace, make_space, match_names
from fynjax.inversion._targets import IMAGE_STATISTICS, weigh_targets

__all__ = [
    "COARSE",
    "IMAGE_STATISTICS",
    "PLAUSIBLE",
    "SEEN",
    "Calibration",
    "Data",
    "DerivativeMeasures",
    "FitResult",
    "Forward",
    "Information",
    "LocalSensitivity",
    "LogPosterior",
    "ParameterSpace",
    "Posterior",
    "SensorSetting",
    "SobolIndices",
    "calibrate_plot",
    "coarser",
    "derivative_measures",
    "even_bands",
    "fisher_information",
    "fit",
    "free_space",
    "local_sensitivity",
    "make_space",
    "match_names",
    "plot_statistics",
    "sample_posterior",
    "sobol_indices",
    "sweep_sensors",
    "weigh_targets",
]

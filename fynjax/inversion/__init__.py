"""Inversion: from measured statistics back to the parameters of a plot.

Importing it lets JAX compute in 64 bits, unless `JAX_ENABLE_X64=0` is in the environment.
"""

from fynjax._core.least_squares import BroydenLM, descend
from fynjax._core.precision import enable_double_precision
from fynjax.inversion._amortised import (
    INTERVALS,
    AmortisedPosterior,
    HeldOut,
    PixelEstimates,
    estimate_pixels,
    train_posterior,
)
from fynjax.inversion._calibrate import (
    Calibration,
    Ends,
    calibrate_plot,
    calibration,
    coarser,
    free_space,
    plot_search,
    search_form,
    search_starts,
)
from fynjax.inversion._canopy import CanopyFit, fit_canopy
from fynjax.inversion._expected import Expected
from fynjax.inversion._fit import (
    fit,
    predicted_statistics,
    statistics_and_jacobian,
    whitened_residual,
)
from fynjax.inversion._fit_result import WELL_CONSTRAINED, Data, FitResult, FitStatus
from fynjax.inversion._functionals import (
    STAND_FUNCTIONALS,
    Functional,
    stand_sentence,
    stand_table,
)
from fynjax.inversion._information import Information, fisher_information
from fynjax.inversion._known_plants import (
    PIXEL_SD,
    KnownPlants,
    PixelSearch,
    PixelState,
    block_of,
    calibrate_known_plants,
    known_plants_search,
)
from fynjax.inversion._log_posterior import LogPosterior
from fynjax.inversion._population import (
    Hyperprior,
    LinearPlots,
    Population,
    fit_population,
    log_marginal,
)
from fynjax.inversion._posterior import PosteriorSampler, SamplingMethod, sample_posterior
from fynjax.inversion._posterior_result import Posterior
from fynjax.inversion._prior_sampler import (
    PriorChain,
    draws_like,
    sample_prior,
    spectrum_likelihood,
)
from fynjax.inversion._search import (
    COARSE,
    CalibrationSettings,
    PlotSearch,
    SearchState,
    search_states,
)
from fynjax.inversion._sensitivity import (
    LEADING_ELASTICITIES,
    DerivativeMeasures,
    ExpectedSensitivity,
    LocalSensitivity,
    SobolIndices,
    check_samples,
    derivative_measures,
    expected_sensitivity,
    local_sensitivity,
    sobol_indices,
)
from fynjax.inversion._sensor_sweep import SensorSetting, even_bands, sweep_sensors
from fynjax.inversion._space import ParameterSpace, make_space, match_names
from fynjax.inversion._surrogate import (
    FittedSurrogate,
    Surrogate,
    fit_surrogate,
    surrogate_renders,
)
from fynjax.inversion._targets import (
    GAIN,
    IMAGE_STATISTICS,
    OFFSET,
    join_data,
    weigh_spectrum,
    weigh_structure,
    weigh_targets,
)
from fynjax.inversion._views import (
    AbstractView,
    ImageView,
    PlotForward,
    SpectrumView,
    StructureView,
    look,
    nadir_imager,
    spectrum_names,
    spectrum_view,
    structure_view,
)

enable_double_precision()

__all__ = [
    "COARSE",
    "GAIN",
    "IMAGE_STATISTICS",
    "INTERVALS",
    "LEADING_ELASTICITIES",
    "OFFSET",
    "PIXEL_SD",
    "STAND_FUNCTIONALS",
    "WELL_CONSTRAINED",
    "AbstractView",
    "AmortisedPosterior",
    "BroydenLM",
    "Calibration",
    "CalibrationSettings",
    "CanopyFit",
    "Data",
    "DerivativeMeasures",
    "Ends",
    "Expected",
    "ExpectedSensitivity",
    "FitResult",
    "FitStatus",
    "FittedSurrogate",
    "Functional",
    "HeldOut",
    "Hyperprior",
    "ImageView",
    "Information",
    "KnownPlants",
    "LinearPlots",
    "LocalSensitivity",
    "LogPosterior",
    "ParameterSpace",
    "PixelEstimates",
    "PixelSearch",
    "PixelState",
    "PlotForward",
    "PlotSearch",
    "Population",
    "Posterior",
    "PosteriorSampler",
    "PriorChain",
    "SamplingMethod",
    "SearchState",
    "SensorSetting",
    "SobolIndices",
    "SpectrumView",
    "StructureView",
    "Surrogate",
    "block_of",
    "calibrate_known_plants",
    "calibrate_plot",
    "calibration",
    "check_samples",
    "coarser",
    "derivative_measures",
    "descend",
    "draws_like",
    "estimate_pixels",
    "even_bands",
    "expected_sensitivity",
    "fisher_information",
    "fit",
    "fit_canopy",
    "fit_population",
    "fit_surrogate",
    "free_space",
    "join_data",
    "known_plants_search",
    "local_sensitivity",
    "log_marginal",
    "look",
    "make_space",
    "match_names",
    "nadir_imager",
    "plot_search",
    "predicted_statistics",
    "sample_posterior",
    "sample_prior",
    "search_form",
    "search_starts",
    "search_states",
    "sobol_indices",
    "spectrum_likelihood",
    "spectrum_names",
    "spectrum_view",
    "stand_sentence",
    "stand_table",
    "statistics_and_jacobian",
    "structure_view",
    "surrogate_renders",
    "sweep_sensors",
    "train_posterior",
    "weigh_spectrum",
    "weigh_structure",
    "weigh_targets",
    "whitened_residual",
]

"""Inversion: from measured statistics back to the parameters of a plot."""

from fynjax._core.least_squares import BroydenLM
from fynjax.inversion._amortised import (
    INTERVALS,
    AmortisedPosterior,
    HeldOut,
    NetworkSettings,
    PixelEstimates,
    estimate_pixels,
    train_posterior,
)
from fynjax.inversion._ask import fit, free, information, sample
from fynjax.inversion._calibrate import (
    Calibration,
    Ends,
    Plantings,
    calibration,
    free_space,
    plot_search,
    search_starts,
)
from fynjax.inversion._camera_data import TargetRules, imager_of, weighed_statistics
from fynjax.inversion._canopy import CanopyFit, fit_canopy
from fynjax.inversion._canopy import CanopyView as CanopyView
from fynjax.inversion._canopy import canopy_units as canopy_units
from fynjax.inversion._canopy_pixels import CanopyFits as CanopyFits
from fynjax.inversion._canopy_pixels import fit_canopies as fit_canopies
from fynjax.inversion._data import (
    Data,
    Kind,
    Pixels,
    Source,
    block_means,
    block_of,
    join_data,
    pixel_data,
)
from fynjax.inversion._design import (
    CAMERAS,
    DESIGN_FREE,
    DESIGN_TARGET,
    BandDesign,
    check_design,
    design,
)
from fynjax.inversion._emulate import Emulated, emulate
from fynjax.inversion._expected import Expected, other_plantings
from fynjax.inversion._factors import BandFactors, Known, PlotSpace
from fynjax.inversion._fit import predicted_statistics, statistics_and_jacobian, whitened_residual
from fynjax.inversion._fit_result import (
    WELL_CONSTRAINED,
    FitResult,
    FitStatus,
    scatter_covariance,
    scatter_of_views,
)
from fynjax.inversion._found import FoundMaps, FoundPlants, find_places
from fynjax.inversion._functionals import (
    Functional,
    stand_functionals,
    stand_sentence,
    stand_table,
    stand_values,
)
from fynjax.inversion._information import Information, fisher_information, shared_slopes
from fynjax.inversion._known_plants import PixelSearch, PixelState
from fynjax.inversion._log_posterior import LogPosterior
from fynjax.inversion._places import PlacesSettings
from fynjax.inversion._population import Hyperprior, LinearPlots, Population, fit_population
from fynjax.inversion._posterior import PosteriorSampler, SamplingMethod
from fynjax.inversion._posterior_result import Posterior
from fynjax.inversion._prior_sampler import (
    PriorChain,
    draws_like,
    sample_prior,
    spectrum_likelihood,
)
from fynjax.inversion._problem import COARSE, CalibrationSettings, Problem, believed
from fynjax.inversion._search import PlotSearch, SearchState, coarser, search_form, search_states
from fynjax.inversion._sensitivity import (
    LEADING_ELASTICITIES,
    DerivativeMeasures,
    ExpectedSensitivity,
    SobolIndices,
    check_samples,
    derivative_measures,
    expected_sensitivity,
    sobol_indices,
)
from fynjax.inversion._sensor_sweep import SensorSetting, check_sweep, even_bands, sweep_sensors
from fynjax.inversion._space import ParameterSpace, parameter_columns, shown_unit
from fynjax.inversion._surrogate import fit_surrogate, surrogate_renders
from fynjax.inversion._targets import (
    GAIN,
    OFFSET,
    compared_statistics,
    weigh_spectrum,
    weigh_structure,
    weigh_targets,
)
from fynjax.inversion._vectorised import value_and_jacobian
from fynjax.inversion._views import (
    AbstractView,
    BandView,
    FactorAt,
    ImageSight,
    ImageView,
    PlotForward,
    SpectrumSight,
    SpectrumView,
    StructureSight,
    factors_by_view,
    look,
    nadir_imager,
    spectrum_names,
    spectrum_view,
    structure_view,
)

__all__ = [
    "AbstractView",
    "BandDesign",
    "BandFactors",
    "BandView",
    "BroydenLM",
    "Calibration",
    "CalibrationSettings",
    "CanopyFit",
    "Data",
    "Emulated",
    "Ends",
    "Expected",
    "FitResult",
    "FitStatus",
    "FoundMaps",
    "FoundPlants",
    "Functional",
    "ImageView",
    "Information",
    "Known",
    "LogPosterior",
    "ParameterSpace",
    "PixelSearch",
    "PixelState",
    "Pixels",
    "PlacesSettings",
    "Plantings",
    "PlotForward",
    "PlotSearch",
    "PlotSpace",
    "Posterior",
    "PosteriorSampler",
    "Problem",
    "SamplingMethod",
    "SearchState",
    "SobolIndices",
    "Source",
    "SpectrumView",
    "calibration",
    "design",
    "emulate",
    "find_places",
    "fit",
    "fit_canopy",
    "fit_surrogate",
    "free",
    "information",
    "join_data",
    "sample",
    "search_form",
    "search_states",
    "sobol_indices",
    "stand_functionals",
    "stand_values",
    "whitened_residual",
]

"""Metrics: vegetation indices, distributions, agreement of spectra, published references."""

from fynjax.metrics import structure as structure
from fynjax.metrics._distribution import (
    histogram_intersection,
    mean,
    quantiles,
    standard_deviation,
)
from fynjax.metrics._indices import (
    BANDS,
    VEGETATION_INDICES,
    VegetationIndex,
    of_indices,
    smooth_vegetation_indices,
    vegetation_indices,
)
from fynjax.metrics._matching import (
    MatchingMethod,
    WavelengthMatch,
    match_wavelengths,
)
from fynjax.metrics._misfit import Misfit, misfit_decomposition
from fynjax.metrics._spectral import (
    SPECTRAL_REGIONS,
    WATER_WINDOWS,
    SpectralAgreement,
    spectral_agreement,
    spectral_angle,
    spectral_mask,
)
from fynjax.metrics._spectrometer_indices import (
    SPECTROMETER_BANDS,
    SPECTROMETER_INDICES,
    SpectrometerIndex,
    spectrometer_indices,
)
from fynjax.metrics._statistics import (
    check_statistics,
    fitting_statistics,
    image_statistics,
)

__all__ = [
    "BANDS",
    "SPECTRAL_REGIONS",
    "SPECTROMETER_BANDS",
    "SPECTROMETER_INDICES",
    "VEGETATION_INDICES",
    "WATER_WINDOWS",
    "MatchingMethod",
    "Misfit",
    "SpectralAgreement",
    "SpectrometerIndex",
    "VegetationIndex",
    "WavelengthMatch",
    "check_statistics",
    "fitting_statistics",
    "histogram_intersection",
    "image_statistics",
    "match_wavelengths",
    "mean",
    "misfit_decomposition",
    "of_indices",
    "quantiles",
    "smooth_vegetation_indices",
    "spectral_agreement",
    "spectral_angle",
    "spectral_mask",
    "spectrometer_indices",
    "standard_deviation",
    "vegetation_indices",
]

"""Metrics: vegetation indices, distributions, agreement of spectra, published references."""

from fynjax.metrics import structure as structure
from fynjax.metrics._distribution import (
    histogram_intersection,
    mean,
    quantiles,
    standard_deviation,
)
from fynjax.metrics._indices import (
    BAND_TERMS,
    BANDS,
    VEGETATION_INDICES,
    VegetationIndex,
    index_bands,
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
from fynjax.metrics._statistics import (
    bands_needed,
    check_statistics,
    fitting_statistics,
    image_statistics,
    without_view,
)

__all__ = [
    "BANDS",
    "BAND_TERMS",
    "SPECTRAL_REGIONS",
    "VEGETATION_INDICES",
    "WATER_WINDOWS",
    "MatchingMethod",
    "Misfit",
    "SpectralAgreement",
    "VegetationIndex",
    "WavelengthMatch",
    "bands_needed",
    "check_statistics",
    "fitting_statistics",
    "histogram_intersection",
    "image_statistics",
    "index_bands",
    "match_wavelengths",
    "mean",
    "misfit_decomposition",
    "quantiles",
    "smooth_vegetation_indices",
    "spectral_agreement",
    "spectral_angle",
    "spectral_mask",
    "standard_deviation",
    "vegetation_indices",
    "without_view",
]

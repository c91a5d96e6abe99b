"""Metrics: vegetation indices, distributions, agreement of spectra, published references."""

from fynjax.metrics import structure as structure
from fynjax.metrics._distribution import histogram_intersection, mean, quantiles, standard_deviation
from fynjax.metrics._indices import (
    BAND_TERMS,
    BANDS,
    VEGETATION_INDICES,
    VegetationIndex,
    index_bands,
    vegetation_indices,
)
from fynjax.metrics._matching import MatchingMethod, WavelengthMatch, match_wavelengths
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
    "VEGETATION_INDICES",
    "Misfit",
    "SpectralAgreement",
    "VegetationIndex",
    "histogram_intersection",
    "image_statistics",
    "index_bands",
    "mean",
    "misfit_decomposition",
    "quantiles",
    "spectral_agreement",
    "spectral_angle",
    "standard_deviation",
    "vegetation_indices",
]

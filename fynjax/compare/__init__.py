"""Real beside simulated, as numbers: drone images, spectra, many plots, published tables."""

from fynjax.compare._dataset import unit_of, validation_dataset
from fynjax.compare._drone import DroneComparison, compare_drone_images
from fynjax.compare._footprint import pixel_footprint
from fynjax.compare._images import DroneImage, OtherBands, read_drone_image, shared_bands
from fynjax.compare._lidar_heights import LEVELS, Heights, compare_heights
from fynjax.compare._plot_diversity import DISTANCE, REGRESSION, plot_diversity_table
from fynjax.compare._plots import (
    FEATURES,
    FLIGHT,
    MEASURES,
    MODEL,
    OTHERS,
    PREDICTORS,
    PlotSpectraPair,
    agreement_table,
    band_table,
    chance_correlation,
    feature_table,
    feature_values,
    leave_one_out,
    mean_agreement,
    misfit_table,
)
from fynjax.compare._published import PublishedComparison, compare_with_published, wins
from fynjax.compare._published_tables import (
    BandReference,
    Figure12Row,
    Table4Row,
    Table5Row,
    Target,
    bands_2006,
    consistent_targets,
    figure12_2006,
    table4_2006,
    table5_2006,
)
from fynjax.compare._spectra import read_spectra_sample
from fynjax.compare._spectral import LEFT_OUT, SpectralComparison, compare_spectra
from fynjax.compare._vegetation import VegetationCheck, check_vegetation

__all__ = [
    "DISTANCE",
    "FEATURES",
    "FLIGHT",
    "LEFT_OUT",
    "LEVELS",
    "MEASURES",
    "MODEL",
    "OTHERS",
    "PREDICTORS",
    "REGRESSION",
    "BandReference",
    "DroneComparison",
    "DroneImage",
    "Figure12Row",
    "Heights",
    "OtherBands",
    "PlotSpectraPair",
    "PublishedComparison",
    "SpectralComparison",
    "Table4Row",
    "Table5Row",
    "Target",
    "VegetationCheck",
    "agreement_table",
    "band_table",
    "bands_2006",
    "chance_correlation",
    "check_vegetation",
    "compare_drone_images",
    "compare_heights",
    "compare_spectra",
    "compare_with_published",
    "consistent_targets",
    "feature_table",
    "feature_values",
    "figure12_2006",
    "leave_one_out",
    "mean_agreement",
    "misfit_table",
    "pixel_footprint",
    "plot_diversity_table",
    "read_drone_image",
    "read_spectra_sample",
    "shared_bands",
    "table4_2006",
    "table5_2006",
    "unit_of",
    "validation_dataset",
    "wins",
]

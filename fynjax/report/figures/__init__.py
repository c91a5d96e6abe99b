"""Figures, from arrays and typed results."""

from fynjax.report.figures._communities import agreement_plot, recognition_plot
from fynjax.report.figures._fit import (
    constraint_plot,
    convergence_plot,
    error_bars,
    interval_plot,
    metric_plot,
    parameter_plot,
    spectrum_plot,
)
from fynjax.report.figures._image import (
    composites,
    index_histograms,
    layer_map,
    photo,
    residual_maps,
    species_map,
)
from fynjax.report.figures._leaf import leaf_fit_figure
from fynjax.report.figures._lidar import height_profiles, side_view
from fynjax.report.figures._maps import maps_figure, pixels_figure
from fynjax.report.figures._pattern import pattern_figure
from fynjax.report.figures._plant import plant_figure
from fynjax.report.figures._plots import feature_plot, misfit_of_plots, residual_plot, spectra_plot
from fynjax.report.figures._plots_inferred import estimates_plot, residuals_plot, shifts_plot
from fynjax.report.figures._population import population_plot
from fynjax.report.figures._posterior import (
    bound_plot,
    corner,
    corner_plot,
    indices_plot,
    predictive_plot,
    short_name,
    tornado_plot,
)
from fynjax.report.figures._products import quick_looks, spectrum_figure
from fynjax.report.figures._reflectance import capture_figure, panel_figure
from fynjax.report.figures._scene import (
    DrawnPlants,
    plan_view,
    profile_view,
    rgb,
    species_colours,
)
from fynjax.report.figures._scene_lit import lit_view
from fynjax.report.figures._scene_oblique import oblique_view
from fynjax.report.figures._scene_view import check_view, mesh_image
from fynjax.report.figures._structure import structure_figure, structure_maps
from fynjax.report.figures._style import FIGURE_DPI, REAL, named_rows, save_figure, style, words
from fynjax.report.figures._terrain import terrain_figure
from fynjax.report.figures._validation import band_box_plot, index_pair_histograms
from fynjax.report.figures._validation_spectra import (
    mean_spectra_plot,
    misfit_plot,
    spectrometer_index_bars,
)

__all__ = [
    "FIGURE_DPI",
    "REAL",
    "DrawnPlants",
    "agreement_plot",
    "band_box_plot",
    "bound_plot",
    "capture_figure",
    "check_view",
    "composites",
    "constraint_plot",
    "convergence_plot",
    "corner",
    "corner_plot",
    "error_bars",
    "estimates_plot",
    "feature_plot",
    "height_profiles",
    "index_histograms",
    "index_pair_histograms",
    "indices_plot",
    "interval_plot",
    "layer_map",
    "leaf_fit_figure",
    "lit_view",
    "maps_figure",
    "mean_spectra_plot",
    "mesh_image",
    "metric_plot",
    "misfit_of_plots",
    "misfit_plot",
    "named_rows",
    "oblique_view",
    "panel_figure",
    "parameter_plot",
    "pattern_figure",
    "photo",
    "pixels_figure",
    "plan_view",
    "plant_figure",
    "population_plot",
    "predictive_plot",
    "profile_view",
    "quick_looks",
    "recognition_plot",
    "residual_maps",
    "residual_plot",
    "residuals_plot",
    "rgb",
    "save_figure",
    "shifts_plot",
    "short_name",
    "side_view",
    "species_colours",
    "species_map",
    "spectra_plot",
    "spectrometer_index_bars",
    "spectrum_figure",
    "spectrum_plot",
    "structure_figure",
    "structure_maps",
    "style",
    "terrain_figure",
    "tornado_plot",
    "words",
]

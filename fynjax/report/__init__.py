"""What a person looks at after a run: figures, and one page that holds them."""

from fynjax.report._figure_style import save_figure
from fynjax.report._figures_fit import (
    constraint_plot,
    convergence_plot,
    error_bars,
    parameter_plot,
)
from fynjax.report._figures_image import composites, index_histograms
from fynjax.report._page import Page, format_number

__all__ = [
    "Page",
    "composites",
    "constraint_plot",
    "convergence_plot",
    "error_bars",
    "format_number",
    "index_histograms",
    "parameter_plot",
    "save_figure",
]

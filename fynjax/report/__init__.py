"""What a person looks at after a run: figures, and one page that holds them."""

from fynjax.report._figures import (
    composites,
    constraint_plot,
    convergence_plot,
    error_bars,
    index_histograms,
    parameter_plot,
    save_figure,
)
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

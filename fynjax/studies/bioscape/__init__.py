"""BioSCape's plots: field tables to plot files, spectra simulated and inverted."""

from fynjax.studies.bioscape._calibrate import calibrate_plots
from fynjax.studies.bioscape._learn import learn
from fynjax.studies.bioscape._plot_files import run_bioscape, write_plot_files
from fynjax.studies.bioscape._plots import BioscapePlot, BioscapeSpecies, read_bioscape
from fynjax.studies.bioscape._scenes import Resolution
from fynjax.studies.bioscape._validate import validate_plots

__all__ = [
    "BioscapePlot",
    "BioscapeSpecies",
    "Resolution",
    "calibrate_plots",
    "learn",
    "read_bioscape",
    "run_bioscape",
    "validate_plots",
    "write_plot_files",
]

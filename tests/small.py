"""Files of a plot so small that whole jobs run on it."""

from pathlib import Path

PLOT = """
[plot]
name = "small"
size_m = 2.0
voxel_m = 0.1
structure_m = "even"
species_table = "species.csv"
"""
SPECIES = """taxon,mean_diameter_cm,cover_percent,height_max_m,growth_form
Erica irregularis,40,30,0.6,rounded_shrub
Restio eleocharis,30,15,0.5,tussock
"""


def write_plot(folder: Path, more: str = "") -> Path:
    """The plot file, with `more` at its end, in `folder`."""
    path = folder / "plot.toml"
    path.write_text(PLOT + more)
    (folder / "species.csv").write_text(SPECIES)
    return path

"""Files of a plot so small that whole jobs run on it."""

from functools import partial
from pathlib import Path

import pytest

from fynjax.inversion import CalibrationSettings

PLOT = """
[plot]
name = "small"
size_m = 2.0
voxel_m = 0.1
structure_m = "even"
species_table = "species.csv"
cover_definition = "article"
"""
SPECIES = """taxon,mean_diameter_cm,cover_percent,height_max_m,growth_form
Erica irregularis,40,30,0.6,rounded_shrub
Restio eleocharis,30,15,0.5,tussock
"""


def write_plot(folder: Path, more: str = "", voxel: float = 0.1) -> Path:
    """The plot file, with `more` at its end, in `folder`, with voxels of `voxel` [m]."""
    path = folder / "plot.toml"
    path.write_text(PLOT.replace("voxel_m = 0.1", f"voxel_m = {voxel}") + more)
    (folder / "species.csv").write_text(SPECIES)
    return path


def search_quickly(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let commands search with fewer draws of plants than they do: an expectation over half as
    many, and chance from a third."""
    few = partial(CalibrationSettings, stand_realisations=4, scatter_draws=16, full_renders=1)
    monkeypatch.setattr("fynjax.app.assembly._forward.CalibrationSettings", few)

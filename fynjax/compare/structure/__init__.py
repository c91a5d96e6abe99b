"""Two point clouds compared: heights above ground, cells, structure metrics with intervals."""

from fynjax.compare.structure._compare import cloud_structure, compare_clouds
from fynjax.compare.structure._grain import cut_off
from fynjax.compare.structure._published import PublishedStructure, structure_2006
from fynjax.compare.structure._result import StructureComparison
from fynjax.compare.structure._settings import ComparisonSettings, cloud_settings

__all__ = [
    "ComparisonSettings",
    "PublishedStructure",
    "StructureComparison",
    "cloud_settings",
    "cloud_structure",
    "compare_clouds",
    "cut_off",
    "structure_2006",
]

"""Structure of vegetation from heights of returns or from voxels, exact and smooth."""

from fynjax.metrics.structure._metrics import (
    BinnedReturns,
    CellGrid,
    CellStructure,
    bin_returns,
    cell_grid,
    cell_structure,
)
from fynjax.metrics.structure._profile import foliage_height_diversity
from fynjax.metrics.structure._settings import (
    STRUCTURE_METRICS,
    STRUCTURE_PRESETS,
    StructureSettings,
)
from fynjax.metrics.structure._smooth import (
    SmoothStructure,
    voxel_height_percentiles,
    voxel_structure,
)

__all__ = [
    "STRUCTURE_METRICS",
    "SmoothStructure",
    "StructureSettings",
    "foliage_height_diversity",
    "voxel_structure",
]

"""Structure of vegetation from heights of returns or from voxels, exact and smooth."""

from fynjax.metrics.structure._compare import (
    LARGEST_CHANGE,
    GrainCheck,
    bootstrap_interval,
    central_interval,
    check_grains,
    choose_grain,
    height_intersection,
    height_percentiles,
    height_shares,
    thinnings,
)
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
    height_percentile_rmse,
    smooth_cell_structure,
    smooth_height_intersection,
    voxel_height_percentiles,
    voxel_structure,
)

__all__ = [
    "LARGEST_CHANGE",
    "STRUCTURE_METRICS",
    "STRUCTURE_PRESETS",
    "BinnedReturns",
    "CellGrid",
    "CellStructure",
    "GrainCheck",
    "SmoothStructure",
    "StructureSettings",
    "bin_returns",
    "bootstrap_interval",
    "cell_grid",
    "cell_structure",
    "central_interval",
    "check_grains",
    "choose_grain",
    "foliage_height_diversity",
    "height_intersection",
    "height_percentile_rmse",
    "height_percentiles",
    "height_shares",
    "smooth_cell_structure",
    "smooth_height_intersection",
    "thinnings",
    "voxel_height_percentiles",
    "voxel_structure",
]

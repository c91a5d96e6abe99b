"""How structure is measured: layers, thresholds and conventions, and those of known tools."""

from dataclasses import dataclass, replace
from typing import Literal, get_args, get_type_hints

import numpy as np

from fynjax._core.errors import InputError

STRUCTURE_METRICS: dict[str, str] = {
    "foliage_height_diversity": "1",
    "gap_fraction": "1",
    "leaf_area_density_mean": "m2 m-3",
    "leaf_area_density_std": "m2 m-3",
    "rugosity": "m",
    "height_cv": "1",
}
"""Unit of each structure metric, in the order of the paper's figure 13; "1" has none."""


_POSITIVE = ("layer", "extinction", "ground_weight", "gap_extinction", "canopy_cell")


def _name_and_option(name: str) -> str:
    """A setting's name, and its option where `fynjax validate` has one."""
    hidden = ("ground_weight", "gap_extinction", "diversity_least_share", "degrees_lost")
    return f"`{name}`" if name in hidden else f"`{name}` (--{name.replace('_', '-')})"


@dataclass(frozen=True)
class StructureSettings:
    """All that a structure metric depends on besides the returns.

    Metrics of low plants are decided by these numbers: on one cloud of fynbos-like heights the
    foliage height diversity grows from 0.4 to 2.4 as layers shrink from 1 m to 0.1 m. Forest
    defaults (layers of 1 m from 2 m up) say nothing of plants of half a metre. So every result
    carries its settings. `STRUCTURE_PRESETS` has those of known tools.

    Raises `InputError` for a number out of range or a name that is not known.
    """

    layer: float = 0.25
    """Thickness of a layer [m]."""
    lowest: float = 0.25
    """Height at which the layers of leaf area density begin [m]; a return on the edge between
    two layers is in the upper one. Whole layers from `diversity_lowest`."""
    extinction: float = 0.5
    """Extinction coefficient k of the law of Beer and Lambert [-]: leaf area projected along the
    beam, per leaf area; 0.5 for leaves of all directions alike, 1 for effective area."""
    top: Literal["cell", "plot"] = "cell"
    """Up to where layers count: the highest return of the cell, or of the whole plot, so that
    what is empty above a low cell counts as zero."""
    ground_height: float = 0.0
    """Returns below this are ground [m], which lies under all layers. At 0 the returns on the
    ground are just the lowest of all."""
    ground_weight: float = 1.0
    """Returns that one on the ground stands for [-]: reflectance of leaves over that of the
    ground, in the law for waveforms (Ni-Meister et al. 2001)."""
    diversity_of: Literal["returns", "leaf_area"] = "returns"
    """Quantity that is shared out among layers for the foliage height diversity."""
    diversity_lowest: float = 0.25
    """Height at which the layers of the foliage height diversity begin [m]."""
    diversity_least_share: float = 0.0
    """Layers with less than this over the number of layers are left out, and the rest is not
    scaled up [-]."""
    diversity_normalised: bool = False
    """Divided by the logarithm of the number of layers (evenness, 0 to 1); undefined for two
    layers or less."""
    gap_of: Literal["returns", "canopy", "leaf_area"] = "returns"
    """Gap fraction as the share of returns below `gap_height` (Morsdorf et al. 2006), the share of
    canopy cells whose highest return is below it, or exp(-`gap_extinction` times the leaf area
    index above it)."""
    gap_height: float = 0.1
    """Threshold of the gap fraction [m]."""
    gap_extinction: float = 0.5
    """Extinction coefficient of the gap fraction from leaf area [-]."""
    rugosity_of: Literal["canopy", "columns"] = "canopy"
    """Rugosity as the standard deviation of the canopy's height (highest return in each canopy
    cell; Atkins et al. 2018, top rugosity), or of the columns' standard deviations of height
    (Hardiman et al. 2011)."""
    canopy_cell: float = 0.5
    """Side of a cell of the canopy's surface [m]; the nearest size that divides the grain is
    taken."""
    cv_lowest: float = 0.0
    """Returns below this do not count for the coefficient of variation of height [m]."""
    degrees_lost: Literal[0, 1] = 1
    """1 divides squared deviations by n - 1, as R does; 0 by n, as NumPy does."""
    source: str = "fynjax"
    """Source of the conventions."""

    def __post_init__(self) -> None:
        for name, kind in get_type_hints(type(self)).items():
            value, known = getattr(self, name), get_args(kind)
            if known and value not in known:
                raise InputError(
                    f"{_name_and_option(name)} must be one of {', '.join(map(repr, known))}, but "
                    f"is {value!r}"
                )
            if kind is float:
                number = isinstance(value, int | float) and np.isfinite(value) and value >= 0.0
                if not number or (name in _POSITIVE and value == 0.0):
                    least = "positive" if name in _POSITIVE else "at least 0"
                    raise InputError(f"{_name_and_option(name)} must be {least}, but is {value!r}")
        apart = (self.lowest - self.diversity_lowest) / self.layer
        if abs(apart - round(apart)) > 1e-6:
            raise InputError(
                f"{_name_and_option('lowest')} and {_name_and_option('diversity_lowest')} must be "
                f"whole layers apart, but are {self.lowest:g} and {self.diversity_lowest:g} m "
                f"with layers of {self.layer:g} m"
            )

    @property
    def base(self) -> float:
        """Height at which the lowest layer begins [m]."""
        return min(self.lowest, self.diversity_lowest)

    def first_layer(self, height: float) -> int:
        """Number of whole layers between `base` and a height that is an edge."""
        return round((height - self.base) / self.layer)


_SHRUB = StructureSettings()

STRUCTURE_PRESETS: dict[str, StructureSettings] = {
    "fynjax": _SHRUB,
    "lidR": replace(
        _SHRUB,
        layer=1.0,
        lowest=2.0,
        diversity_lowest=0.0,
        diversity_normalised=True,
        gap_height=2.0,
        source="lidR 4 (entropy, LAD; Bouvier et al. 2015)",
    ),
    "leafR": replace(
        _SHRUB,
        layer=1.0,
        lowest=1.0,
        extinction=1.0,
        top="plot",
        diversity_of="leaf_area",
        diversity_lowest=1.0,
        diversity_least_share=0.01,
        gap_height=1.0,
        source="leafR 0.3 (lad.voxels, FHD; Almeida et al. 2019)",
    ),
    "PyForestScan": replace(
        _SHRUB,
        layer=1.0,
        lowest=1.0,
        extinction=1.0,
        top="plot",
        diversity_lowest=0.0,
        gap_of="leaf_area",
        gap_height=2.0,
        source="PyForestScan 0.5 (calculate_pad, calculate_fhd, calculate_canopy_cover)",
    ),
    "GEDI L2B": replace(
        _SHRUB,
        layer=5.0,
        lowest=0.0,
        ground_height=0.1,
        ground_weight=1.5,
        diversity_of="leaf_area",
        diversity_lowest=0.0,
        gap_height=0.1,
        source="GEDI L2B (Tang and Armston 2019), with returns in place of the waveform",
    ),
}
"""Conventions of known tools. What a tool does not compute is as in "fynjax":

- "lidR": entropy of returns over the logarithm of the number of layers, from the ground up; leaf
  area density from 2 m up (`LAD` puts a return on an edge in the lower layer, here the upper).
- "leafR": effective leaf area (k = 1) from 1 m up; diversity of leaf area, without layers of less
  than 1 % over their number. leafR takes the diversity of the plot's mean profile, for which see
  `foliage_height_diversity`; here each cell has its own.
- "PyForestScan": effective plant area without the lowest metre; diversity of returns with the
  ground among them; cover from the plant area above 2 m.
- "GEDI L2B": plant area from the gap probability in layers of 5 m, a return from the ground
  counting 1.5-fold (the product's reflectances are 0.6 and 0.4). What lies below `ground_height`
  stands for the waveform's ground peak.
"""

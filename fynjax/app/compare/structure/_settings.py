"""What a comparison of two clouds takes: grain, plot, thinning, how each cloud is read."""

from dataclasses import dataclass, field, fields, replace
from typing import Any, Literal, TypedDict

import numpy as np

from fynjax._core.errors import InputError
from fynjax.app.compare.structure._cloud import CloudSettings, GroundSource
from fynjax.app.terrain import Bounds
from fynjax.metrics.structure import STRUCTURE_PRESETS, StructureSettings


@dataclass(frozen=True)
class ComparisonSettings:
    """How clouds are compared; the paper's numbers unless given."""

    structure: StructureSettings = field(default_factory=StructureSettings)
    """Definitions of the metrics; see `STRUCTURE_PRESETS` for those of known tools."""
    grain: float | None = None
    """Side of a cell [m]; by the paper's rule unless given."""
    grains: tuple[float, ...] = (1.0, 2.0, 3.0, 4.0, 5.0)
    """Grains that the rule chooses from [m]; those wider than the plot are passed over."""
    least_returns: int = 5
    """Returns with which a cell counts."""
    least_cells: float = 0.9
    """Share of cells that must count, for a grain to fit [-]."""
    median_returns: float = 30.0
    """Median of the returns of cells, for a grain to fit."""
    largest_change: float | None = 0.1
    """The smallest grain that fits and whose metrics change no more than this, in the median over
    metrics, to the next larger one is taken [-]; `None` takes that of least change. The paper
    prints no limit; it took 2 m at 6.1 % and not 1 m at 17.9 %, and this lies between."""
    repetitions: int = 100
    """Thinnings of the denser cloud, without replacement, to the returns of the sparser."""
    resamples: int = 1000
    """Resamples of the cells for the bootstrap intervals."""
    confidence: float = 0.95
    """Share inside intervals [-]."""
    percents: tuple[float, ...] = tuple(float(p) for p in range(5, 100, 5))
    """Percentiles of height that are compared [%]."""
    histogram_bin: float = 0.1
    """Width of the bins of the height histograms [m]."""
    bounds: Bounds | None = None
    """The plot, in the real cloud's coordinates [m]; what both clouds cover unless given."""
    simulated_shift: tuple[float, float] | tuple[float, float, float] | None = None
    """Added to x and y, and z where stated, of the simulated cloud [m]; z matters only to heights
    that are given, since others are above the cloud's own ground. Unless stated: nothing where the
    clouds overlap; else, if one has no reference system, its middle is put on the middle of the
    plot."""
    real: CloudSettings = field(default_factory=CloudSettings)
    simulated: CloudSettings = field(default_factory=CloudSettings)

    def __post_init__(self) -> None:
        if self.grain is not None and not (np.isfinite(self.grain) and self.grain > 0.0):
            raise InputError(f"`grain` (--grain) must be positive, but is {self.grain:g}")
        if self.largest_change is not None and not self.largest_change >= 0.0:
            raise InputError(
                f"`largest_change` (--largest-change) must be at least 0, but is "
                f"{self.largest_change:g}"
            )
        if self.bounds is not None:
            west, south, east, north = self.bounds
            if not (np.isfinite(self.bounds).all() and west < east and south < north):
                raise InputError(
                    f"`bounds` (--bounds) must be xmin,ymin,xmax,ymax in metres, but are "
                    f"{west:g}, {south:g}, {east:g}, {north:g}"
                )
        for name in ("repetitions", "resamples", "least_returns"):
            if getattr(self, name) < 1:
                raise InputError(f"`{name}` must be at least 1, but is {getattr(self, name)}")
        if not 0.0 < self.confidence < 1.0:
            raise InputError(f"`confidence` must be between 0 and 1, but is {self.confidence:g}")
        if not self.histogram_bin > 0.0:
            raise InputError(f"`histogram_bin` must be positive, but is {self.histogram_bin:g}")
        if not self.percents or min(self.percents) < 0.0 or max(self.percents) > 100.0:
            raise InputError(f"`percents` must be between 0 and 100, but are {self.percents}")

    def options(self) -> dict[str, Any]:
        """All but the definitions of metrics, by name, as outputs carry them."""
        plain: dict[str, Any] = {}
        for setting in fields(self):
            value = getattr(self, setting.name)
            if isinstance(value, CloudSettings):
                plain |= {f"{setting.name}_{f.name}": getattr(value, f.name) for f in fields(value)}
            elif not isinstance(value, StructureSettings) and setting.name != "grain":
                plain[setting.name] = list(value) if isinstance(value, tuple) else value
        return plain


_BOTH = ("tallest", "deepest", "tolerance")
"""Settings of how a cloud is read that are stated for both at once."""


class CloudOptions(TypedDict, total=False):
    """Settings of a comparison of clouds that are stated one by one; what is not stated the preset
    says, or the comparison."""

    grain: float
    """Side of a cell [m]; by the paper's rule, of 1 to 5 m, if left out."""
    largest_change: float
    """Change of the metrics to the next larger grain, in their median, up to which a grain is taken
    [-]; 0.1 if left out."""
    bounds: Bounds
    """The plot, XMIN,YMIN,XMAX,YMAX, in the real cloud's coordinates [m]; what both cover if left
    out."""
    shift: tuple[float, float] | tuple[float, float, float]
    """What to add to the simulated cloud's coordinates [m], DX,DY[,DZ]."""
    real_ground: GroundSource
    """How the real cloud's ground is found: its classes, a filter, or none where heights are above
    the ground already; auto takes classes where there are some, else smrf."""
    simulated_ground: GroundSource
    """The same of the simulated cloud."""
    tolerance: float
    """Largest distance from the lowest surface at which a filter takes returns for ground [m]; 0.1
    if left out."""
    deepest: float
    """Returns farther below the ground are noise [m]; 0.5 if left out."""
    tallest: float
    """Returns higher above the ground are left out: birds, wires [m]."""
    layer: float
    """Thickness of a layer [m]."""
    lowest: float
    """Height at which layers begin [m]; those of the diversity too, where the preset has one height
    for both."""
    diversity_lowest: float
    """Height at which the layers of the foliage height diversity begin [m]."""
    diversity_of: Literal["returns", "leaf_area"]
    """What is shared out among layers for the foliage height diversity: returns are counted, or
    their leaf area."""
    top: Literal["cell", "plot"]
    """Up to where layers count: the highest return of the cell or of the plot."""
    ground_height: float
    """Returns below this are ground, under all layers [m]."""
    extinction: float
    """Extinction coefficient k of leaf area density [-]."""
    gap_height: float
    """Threshold of the gap fraction [m]."""
    gap_of: Literal["returns", "canopy", "leaf_area"]
    """Gap fraction by the count of returns, of canopy cells, or from leaf area."""
    rugosity_of: Literal["canopy", "columns"]
    """Rugosity of the canopy's surface, or of the columns."""
    canopy_cell: float
    """Side of a cell of the canopy's surface [m]."""
    cv_lowest: float
    """Returns below this do not count for the variation of height [m]."""
    least_returns: int
    """Returns with which a cell counts; 5 if left out."""
    repetitions: int
    """Thinnings of the denser cloud; 100 if left out."""
    histogram_bin: float
    """Width of the bins of the height histogram [m]; 0.1 if left out."""


def cloud_settings(preset: str | None, options: CloudOptions) -> ComparisonSettings:
    """Settings by the name of a preset and single options, which override it.

    **Arguments:**

    - `preset`: its name; `None` is not stated.
    - `options`: by the names of `StructureSettings` and `ComparisonSettings`, besides `shift`,
      `real_ground`, `simulated_ground`, and those of reading that hold for both clouds.
    """
    if preset is not None and preset not in STRUCTURE_PRESETS:
        raise InputError(
            f"a preset of structure metrics (--structure-preset) must be one of "
            f"{', '.join(STRUCTURE_PRESETS)}, but is {preset!r}"
        )
    stated: dict[str, Any] = {**options}
    structure = STRUCTURE_PRESETS["fynjax" if preset is None else preset]
    names = {field.name for field in fields(StructureSettings)}
    changed = {name: stated.pop(name) for name in sorted(names & set(stated))}
    if changed:
        if structure.lowest == structure.diversity_lowest and "lowest" in changed:
            changed.setdefault("diversity_lowest", changed["lowest"])
        departures = ", ".join(f"{name} {value}" for name, value in changed.items())
        structure = replace(structure, **changed, source=f"{structure.source}, but {departures}")
    both = {name: stated.pop(name) for name in _BOTH if name in stated}
    settings = ComparisonSettings()
    reading = {
        side: replace(getattr(settings, side), ground=stated.pop(f"{side}_ground", "auto"), **both)
        for side in ("real", "simulated")
    }
    if "shift" in stated:
        stated["simulated_shift"] = stated.pop("shift")
    return replace(settings, structure=structure, **reading, **stated)

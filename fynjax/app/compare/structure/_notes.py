"""What a reader should know of a comparison of two clouds, in sentences."""

from pathlib import Path

import numpy as np

from fynjax.app.compare.structure._cloud import MUCH_NOISE
from fynjax.app.compare.structure._grain import cut_off
from fynjax.app.compare.structure._result import CloudSide, StructureComparison

_MOST_CUT_OFF = 0.05
_FEW_CELLS = 10
_FEET = (2.6, 4.1)
"""Ratio of heights between which one cloud may be in feet."""
_FAR_ABOVE = 3.0
_FAR_ABOVE_M = 1.0


def nearly_highest(height: np.ndarray) -> float:
    """The 99.9th percentile of heights [m]; in small clouds what ten returns are above."""
    share = max(0.001, min(10.0 / len(height), 0.1))
    return float(np.quantile(height, 1.0 - share))


def comparison_notes(comparison: StructureComparison) -> tuple[str, ...]:
    """How ground, cells and density came about, where numbers may be wrong for it."""
    notes = []
    if comparison.real.ground != comparison.simulated.ground:
        notes.append(
            f"the ground was found in two ways ({comparison.real.ground} in the real cloud, "
            f"{comparison.simulated.ground} in the simulated one), which may shift heights by "
            "centimetres against each other; `ground` (--real-ground, --simulated-ground) states "
            "one for each"
        )
    tall = [side.nearly_highest for side in comparison.sides.values()]
    if _FEET[0] < max(tall) / max(min(tall), 1e-6) < _FEET[1]:
        which = list(comparison.sides)[tall.index(max(tall))]
        notes.append(
            f"plants of the {which} cloud are {max(tall) / min(tall):.1f} times as tall as those "
            "of the other. Is it in feet, 3.28 to a metre? Then convert it, or state its `unit`"
        )
    for side in comparison.sides.values():
        notes += _side_notes(side)
    notes += _grain_notes(comparison)
    for which, side in comparison.sides.items():
        notes += _undefined_notes(comparison, which, side)
    return tuple(notes)


def _side_notes(side: CloudSide) -> list[str]:
    notes, name = [], Path(side.file).name
    if side.below_ground:
        share = side.below_ground_share
        doubt = (
            ": so many that the ground itself is to be doubted. Clean the cloud first"
            if share > MUCH_NOISE
            else ""
        )
        notes.append(
            f"{name}: {side.below_ground} returns ({100.0 * share:.2g} %) more than the stated "
            f"depth (`deepest`; --deepest) below the ground were left out as noise{doubt}"
        )
    if side.too_high:
        notes.append(
            f"{name}: {side.too_high} returns higher than `tallest` (--tallest) were left out"
        )
    usual = side.nearly_highest
    if side.highest > max(_FAR_ABOVE * usual, usual + _FAR_ABOVE_M):
        notes.append(
            f"{name}: the highest return is at {side.highest:.2f} m, but nearly all are below "
            f"{usual:.2f} m. Birds, wires or noise decide rugosity, leaf area density and the "
            "variation of height: `tallest` (--tallest) leaves out what is higher than plants"
        )
    return notes


def _grain_notes(comparison: StructureComparison) -> list[str]:
    notes = []
    rows, columns = next(iter(comparison.real.cells.values())).shape
    lost = cut_off(comparison.plot, comparison.bounds)
    if lost > _MOST_CUT_OFF:
        west, south, east, north = comparison.plot
        notes.append(
            f"{100.0 * lost:.0f} % of the plot is in no cell: {columns} x {rows} cells of "
            f"{comparison.grain:g} m do not fill its {east - west:.2f} x {north - south:.2f} m. A "
            "grain that divides its sides (`grain`; --grain) uses all of it"
        )
    if rows * columns < _FEW_CELLS:
        notes.append(
            f"means over {rows * columns} cells, and intervals by resampling them, say little; "
            "take a smaller grain (`grain`; --grain) where there are returns enough, or a larger "
            "plot"
        )
    taken = comparison.grains[comparison.grains["taken"] == "yes"].iloc[0]
    limit = comparison.options.get("largest_change")
    if limit is not None and taken["median_change_percent"] > 100.0 * limit:
        notes.append(
            f"metrics change by {taken['median_change_percent']:.0f} % in their median from cells "
            f"of {comparison.grain:g} m to the next larger, more than {100.0 * limit:g} % "
            "(`largest_change`; --largest-change)"
        )
    return notes


def _undefined_notes(comparison: StructureComparison, which: str, side: CloudSide) -> list[str]:
    value = side.metrics["value"]
    lost = list(value.index[value.isna()])
    layered = [n for n in lost if n.startswith(("foliage", "leaf_area"))]
    notes, s = [], comparison.settings
    if value["foliage_height_diversity"] == 0.0:
        notes.append(
            f"foliage height diversity is 0 in the {which} cloud because one layer of {s.layer:g} "
            f"m from {s.diversity_lowest:g} m holds all that is above it in each cell, up to "
            f"{side.highest:.2f} m: that tells of the layers, not of the plants (`layer`; --layer)"
        )
    if layered:
        notes.append(
            f"{_listed(layered)} undefined in the {which} cloud: with layers of {s.layer:g} m from "
            f"{s.lowest:g} m (diversity from {s.diversity_lowest:g} m) and returns up to "
            f"{side.highest:.2f} m, no cell has layers enough. Thinner or lower ones (`layer`, "
            "`lowest`; --layer, --lowest) may define them"
        )
    other = [n for n in lost if n not in layered]
    if other:
        notes.append(
            f"{_listed(other)} undefined in the {which} cloud: no cell has two returns that count, "
            "or all of them lie on the ground"
        )
    return notes


def _listed(names: list[str]) -> str:
    shown = [name.replace("_", " ") for name in names]
    return f"{', '.join(shown)} {'is' if len(shown) == 1 else 'are'}"

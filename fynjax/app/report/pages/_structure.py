"""The section of a validation that is about point clouds."""

from fynjax.app.compare.structure import StructureComparison, cut_off
from fynjax.app.report.figures import structure_figure, structure_maps
from fynjax.app.report.pages._page import Picture, Section, Table

_SHOWN = [
    "metric", "unit", "real", "real_bootstrap_low", "real_bootstrap_high", "simulated",
    "simulated_bootstrap_low", "simulated_bootstrap_high", "difference_percent",
]  # fmt: skip
"""Columns of the metrics that fit on a page."""
_EDGES = ("west_m", "south_m", "east_m", "north_m")


def structure_section(structure: StructureComparison) -> Section:
    """Section of the point clouds: figure 13 and its numbers.

    **Arguments:** `structure`, the comparison of the point clouds.
    """
    table, grains = structure.table(), structure.grains
    tried = [c for c in grains.columns if not str(c).startswith("paper") and c not in _EDGES]
    west, south, east, north = structure.bounds
    rows, columns = next(iter(structure.real.cells.values())).shape
    return Section(
        "Structure",
        [
            *structure.notes,
            Picture(
                "structure.png",
                structure_figure(structure),
                "structure metrics and heights (fig. 13)",
                "Structure metrics and distributions of heights, as figure 13.",
            ),
            Picture(
                "structure_maps.png", structure_maps(structure), "structure metrics in each cell"
            ),
            Table(
                table[_SHOWN],
                "Structure metrics: means over cells at one density of returns, with the bootstrap "
                "interval over cells.",
            ),
            Table(
                table,
                "Every number of the structure metrics, with the central part over thinnings; "
                "'full' is of all returns. The paper's are of its plot burnt in 2006; it does not "
                "print its layer thickness or conventions, so they need not compare.",
                folded=True,
            ),
            f"{columns} x {rows} = {rows * columns} cells of {structure.grain:g} m, from "
            f"({west:.2f}, {south:.2f}) to ({east:.2f}, {north:.2f}) m, {(east - west):.4g} x "
            f"{(north - south):.4g} m = {(east - west) * (north - south):.4g} m²; "
            f"{100.0 * cut_off(structure.plot, structure.bounds):.1f} % of the plot is in no cell.",
            Table(
                grains[tried],
                "Grains that were tried, on the sparser cloud. 'median change' is how much the "
                "metrics change to the next larger grain, in their median; the smallest grain is "
                "taken that has returns enough and changes little.",
            ),
            Table(
                grains,
                "The same with their edges, and with what the paper has of its plot, for which it "
                "took 2 m, with 6.1 % against 17.9 % at 1 m.",
                folded=True,
            ),
            Table(
                structure.settings_table().astype(str),
                "Settings of all these numbers.",
                folded=True,
            ),
        ],
    )

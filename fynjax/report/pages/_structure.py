"""The section of a validation that is about point clouds."""

import re

from fynjax.compare.structure import StructureComparison, cut_off, grain_table
from fynjax.report.figures import structure_figure, structure_maps
from fynjax.report.pages._page import Picture, Section, Table


def structure_section(structure: StructureComparison) -> Section:
    """Section of the point clouds: figure 13 and its numbers.

    **Arguments:** `structure`, the comparison of the point clouds.
    """
    table = structure.table()
    numbers = table.columns.drop(["metric", "unit"])
    table[numbers] = table[numbers].astype(float)
    grains = grain_table(structure.grains, structure.grain, structure.plot)
    named = [str(c) for c in grains.columns if str(c).endswith(("_percent", "_m", "_m2"))]
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
                table,
                "Structure metrics: means over cells at one density of returns, with the central "
                "part over thinnings and the bootstrap interval over cells; 'full' is of all "
                "returns. The paper does not print its layer thickness or conventions, so its "
                "numbers need not compare.",
            ),
            f"{columns} x {rows} = {rows * columns} cells of {structure.grain:g} m, from "
            f"({west:.2f}, {south:.2f}) to ({east:.2f}, {north:.2f}) m, {(east - west):.4g} x "
            f"{(north - south):.4g} m = {(east - west) * (north - south):.4g} m²; "
            f"{100.0 * cut_off(structure.plot, structure.bounds):.1f} % of the plot is in no cell.",
            Table(
                grains,
                "Grains that were tried, on the sparser cloud. 'median change' is how much the "
                "metrics change to the next larger grain, in their median; the smallest grain is "
                "taken that has returns enough and changes little. The paper took 2 m, with 6.1 % "
                "against 17.9 % at 1 m.",
                units={
                    c: "%" if c.endswith("_percent") else c.rsplit("_", 1)[1].replace("m2", "m²")
                    for c in named
                },
                headers={c: re.sub("_(percent|m2?)$", "", c).replace("_", " ") for c in named},
            ),
            Table(
                structure.settings_table().astype(str),
                "Settings of all these numbers.",
                folded=True,
            ),
        ],
    )

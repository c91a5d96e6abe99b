"""The part of a validation that is about point clouds: tables, figures and files of it."""

import re
from pathlib import Path

import numpy as np
import xarray as xr

from fynjax.compare.structure import StructureComparison, cut_off, grain_table
from fynjax.io.raster import write_run
from fynjax.io.text import write_text
from fynjax.report.figures import save_figure, structure_figure, structure_maps
from fynjax.report.pages._page import Page
from fynjax.report.pages._validation import Files


def structure_section(
    page: Page, folder: Path, structure: StructureComparison, record: dict[str, str | int]
) -> Files:
    """Figure 13 and its numbers."""
    page.section("Structure")
    for note in structure.notes:
        page.paragraph(note)
    for name, figure, caption in (
        (
            "structure.png",
            structure_figure(structure),
            "Structure metrics and distributions of heights, as figure 13.",
        ),
        ("structure_maps.png", structure_maps(structure), "Each metric in each cell."),
    ):
        save_figure(figure, folder / name)
        page.figure(folder / name, caption)
    table, settings = structure.table(), structure.settings_table()
    numbers = table.columns.drop(["metric", "unit"])
    table[numbers] = table[numbers].astype(float)
    page.table(
        table,
        caption="Structure metrics: means over cells at one density of returns, with the central "
        "part over thinnings and the bootstrap interval over cells; 'full' is of all returns. The "
        "paper does not print its layer thickness or conventions, so its numbers need not compare.",
    )
    grains = grain_table(structure.grains, structure.grain, structure.plot)
    west, south, east, north = structure.bounds
    rows, columns = next(iter(structure.real.cells.values())).shape
    page.paragraph(
        f"{columns} x {rows} = {rows * columns} cells of {structure.grain:g} m, from "
        f"({west:.2f}, {south:.2f}) to ({east:.2f}, {north:.2f}) m, {(east - west):.4g} x "
        f"{(north - south):.4g} m = {(east - west) * (north - south):.4g} m²; "
        f"{100.0 * cut_off(structure.plot, structure.bounds):.1f} % of the plot is in no cell."
    )
    page.table(
        grains,
        caption="Grains that were tried, on the sparser cloud. 'median change' is how much the "
        "metrics change to the next larger grain, in their median; the smallest grain is taken "
        "that has returns enough and changes little. The paper took 2 m, with 6.1 % against 17.9 % "
        "at 1 m.",
        units={c: "%" if c.endswith("_percent") else c.rsplit("_", 1)[1].replace("m2", "m²")
               for c in map(str, grains.columns) if c.endswith(("_percent", "_m", "_m2"))},
        headers={c: re.sub("_(percent|m2?)$", "", c).replace("_", " ")
                 for c in map(str, grains.columns)},
    )  # fmt: skip
    page.table(settings.astype(str), caption="Settings of all these numbers.", folded=True)
    write_text(folder / "structure.csv", table.to_csv(index=False, float_format="%.9g"))
    write_text(folder / "structure_settings.csv", settings.to_csv(index=False))
    for name, one in {"grains": grains, **structure.curves()}.items():
        text = one.to_csv(index=False, float_format="%.9g")
        write_text(folder / f"structure_{name}.csv", text)
    write_run(folder / "structure.nc", _named(structure.dataset()), record)
    return {
        "structure.png": "structure metrics and heights (fig. 13)",
        "structure_maps.png": "structure metrics in each cell",
        "structure.csv": "structure metrics with their intervals",
        "structure_settings.csv": "what the structure metrics depend on",
        "structure_grains.csv": "grains that were tried, with their cells, area and bounds",
        "structure_profile.csv": "leaf area density by layer of both clouds [m2 m-3]",
        "structure_percentiles.csv": "percentiles of height of both clouds [m]",
        "structure_histogram.csv": "share of returns by height of both clouds",
        "structure.nc": "every number of both clouds, with maps by cell, NetCDF",
    }


def structure_headline(structure: StructureComparison) -> list[str]:
    """The result in a sentence."""
    found = [
        f"{one.name.replace('_', ' ')} {one.difference_percent:+.0f} %"
        for one in structure.metrics
        if one.difference_percent is not None and np.isfinite(one.difference_percent)
    ]
    changes = ", ".join(found) or "no metric is defined in both"
    return [
        f"Structure at {structure.grain:g} m, simulated against real: {changes}; heights "
        f"overlap by {structure.height_intersection.value:.2f}, their percentiles differ by "
        f"{structure.percentile_rmse.value:.3f} m RMSE."
    ]


def _named(dataset: xr.Dataset) -> xr.Dataset:
    """With a name and a unit for every variable, as the run files of fynjax have them."""
    for name, variable in dataset.variables.items():
        variable.attrs.setdefault("long_name", str(name).replace("_", " "))
        if variable.dtype.kind in "fiu":
            variable.attrs.setdefault("units", "1")
    return dataset

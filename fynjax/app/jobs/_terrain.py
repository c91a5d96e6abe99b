"""The job of `fynjax terrain`: the ground of a plot from a point cloud or a height raster."""

import warnings
from pathlib import Path
from typing import Any, Literal

import numpy as np
from jaxtyping import Bool, Float

from fynjax._core.dry_run import begin_work
from fynjax._core.errors import InputError, in_file
from fynjax._core.precision import double_precision
from fynjax.app.io.raster import write_geotiff
from fynjax.app.jobs._result import JobResult, Record
from fynjax.app.jobs._run import Run
from fynjax.app.report import figures
from fynjax.app.report.pages import Picture
from fynjax.app.terrain import (
    TOLERANCE,
    WINDOW,
    Bounds,
    GroundMethod,
    PointCloud,
    Terrain,
    canopy_height,
    check_bounds,
    check_covered,
    check_positive,
    find_ground,
    heights_above_ground,
    is_normalised,
    labelled_ground,
    middle_of_raster,
    read_cloud,
    read_terrain,
    terrain_from_points,
    whole_cells,
    write_mesh,
    write_terrain,
)

_RASTERS = (".tif", ".tiff", ".img", ".asc", ".vrt")  # of the last, that it names others
# Points all through a layer as thick as the tolerance scatter by 0.29 of it about their mean.
_ROUGH = 0.27
_LARGEST_GAP = 10.0
_CELL = 0.25
"""Side of the cells of a cloud's terrain [m], unless stated."""
_DOUBTED_RELIEF = 1.0
"""Relief of the ground [m] from which a cloud of heights above the ground is doubted."""
_BELOW = 0.01
"""Share of the points that may lie below the ground by more than the tolerance: noise."""
_AROUND = 10.0
"""Points this far around the plot [m] are kept: the filter is worst at the edge of its points."""


class TerrainSummary(Record):
    """The terrain in numbers. `None` is what the file cannot say."""

    bounds_m: tuple[float, float, float, float]
    """West, south, east and north edge of the terrain [m]."""
    cell_m: float
    lowest_m: float
    relief_m: float
    median_slope_deg: float
    interpolated_to_m: float | None = None
    """Largest distance of interpolated ground from measured [m]."""
    cells_filled: float | None = None
    """Share of a raster's cells that had no height [-]."""
    points: int | None = None
    ground_share: float | None = None
    """Share of a cloud's points that are ground [-]."""
    cells_with_ground: float | None = None
    """Share of the cells with ground points [-]."""
    ground_scatter_m: float | None = None
    ground_by: GroundMethod | None = None
    """Way in which the ground of a cloud was found."""
    labels_apart_m: float | None = None
    """Median distance of the points that the file labels as ground from the terrain."""
    points_below: float | None = None
    """Share of the points that lie below the terrain by more than the tolerance [-]."""
    canopy_height_median_m: float | None = None
    canopy_height_99_m: float | None = None


class TerrainResult(JobResult):
    """What `terrain` made."""

    command: Literal["terrain"] = "terrain"
    terrain: TerrainSummary


@double_precision
def terrain(
    path: str | Path,
    output: str | Path,
    *,
    cell: float | None = None,
    bounds: Bounds | None = None,
    size: float | None = None,
    method: GroundMethod | None = None,
    tolerance: float | None = None,
    slope: float | None = None,
    window: float | None = None,
    largest_gap: float | None = None,
    unit: str | None = None,
    height_unit: str | None = None,
    crs: str | None = None,
    fill_gaps: bool = False,
    band: int | None = None,
) -> TerrainResult:
    """Make the ground of a plot from a point cloud or a height raster.

    **Arguments:**

    - `path`: point cloud (LAS, LAZ, PLY, E57, PTX, XYZ, CSV) or height raster (GeoTIFF, .img,
      .asc).
    - `output`: folder of the results, made if missing.
    - `cell`: side of a cell [m]; 0.25 for a cloud and a raster's own if left out.
    - `bounds`: edges of the plot, west, south, east and north, in the file's coordinates [m].
    - `size`: side of a square plot in the middle of the file [m] instead; of a raster, its corner
      is that of a cell, and cells must divide it.
    - `method`: ground by the file's labels (the usual, where it has them and nothing is said of a
      filter), or by a filter; see `find_ground`.
    - `tolerance`: largest distance of ground from the lowest points [m]; 0.3 if left out.
    - `slope`: SMRF slope threshold [m/m]; 0.15 if left out.
    - `window`: radius of the widest closed stand [m] (smrf); 5, or half of a smaller cloud, if left
      out.
    - `largest_gap`: largest distance of a cell from the nearest ground point [m]; 10 if left out.
    - `unit`: unit of a cloud's coordinates, if not metres: metre, centimetre, millimetre, foot or
      us_survey_foot.
    - `height_unit`: unit of heights, if another.
    - `crs`: reference system of a file that states none, such as EPSG:32734.
    - `fill_gaps`: interpolate cells of a raster without height.
    - `band`: band of a raster that has the heights, from 1.

    **Returns:** `TerrainResult`. Writes `terrain.tif` [m], `terrain.obj`, a picture, a page,
    from a cloud `canopy_height.tif` [m], and where ground is interpolated `ground_distance.tif` [m]
    into `output`. Warns where the ground is so rough that it may be the inside of plants, where it
    lies off the points that the file labels as ground, where many points lie below it, and where a
    cloud on the map has neither a stated unit nor a reference system.

    **Raises:** as these functions, and `InputError` for settings that the file or the method does
    not use.

    Example: `jobs.terrain("flight.laz", "results", size=40.0)`.
    """
    run = Run(output)
    path = Path(path)
    is_raster = path.suffix.lower() in _RASTERS
    lengths = {"tolerance": tolerance, "slope": slope, "window": window}
    filtering = {"method": method, **lengths}
    lengths |= {"cell": cell, "size": size, "largest_gap": largest_gap}
    _check(
        is_raster, bounds, lengths,
        {"method": method, "unit": unit, "fill_gaps": fill_gaps or None, "band": band},
    )  # fmt: skip
    gap = largest_gap or _LARGEST_GAP
    with in_file(path):
        if is_raster:
            with run.stage("Read the raster"):
                plot = bounds if size is None else middle_of_raster(path, size)
                terrain = read_terrain(
                    path, plot, crs=crs, height_unit=height_unit, fill_gaps=fill_gaps,
                    largest_gap=gap, band=band,
                )  # fmt: skip
                if cell is not None:
                    terrain = terrain.resample(cell, plot)
                elif size is not None and plot is not None:
                    whole_cells(plot, terrain.cell)  # else it would be wider than asked for
            canopy, numbers = None, {"cells_filled": terrain.filled}
        else:
            with run.stage("Read the cloud"):
                cloud = read_cloud(path, unit=unit, height_unit=height_unit, crs=crs)
            plot = bounds if size is None else _middle(cloud.bounds, size)
            stated = {k: v for k, v in filtering.items() if v is not None}
            terrain, canopy, numbers = _from_cloud(cloud, plot, cell or _CELL, gap, run, **stated)
    if not is_raster:
        _doubt_place(path, terrain, unit)
    size_of_map = "{} rows and {} columns of cells".format(*terrain.heights.shape)
    begin_work({"terrain.tif": size_of_map, "terrain.obj": "", "report.html": ""})
    with run.stage("Write"):
        _write(run, terrain, canopy)
    summary = _summary(terrain, numbers)
    headline = _headline(summary)
    picture = Picture("terrain.png", figures.terrain_figure(terrain, canopy), "picture of it")
    run.pictures("terrain", f"Terrain of {path.name}", headline, [picture], [path])
    return run.result(TerrainResult, headline=headline, terrain=summary)


def _check(
    is_raster: bool, bounds: Bounds | None, lengths: dict[str, float | None], others: dict[str, Any]
) -> None:
    """Refuse a plot that is stated twice, lengths that are not positive, and settings that do
    nothing: who gives one believes that it does something."""
    if bounds is not None:
        if lengths["size"] is not None:
            raise InputError("expected `bounds` or `size` of the plot, but got both")
        check_bounds(bounds)
    for name, value in lengths.items():
        if value is not None:
            check_positive(name, value)
    settings = lengths | others
    method = settings["method"]
    unused = {
        "point clouds": ("method", "tolerance", "slope", "window", "unit") if is_raster else (),
        "rasters": () if is_raster else ("fill_gaps", "band"),
        "rasters whose gaps are filled (`fill_gaps`)": (
            ("largest_gap",) if is_raster and not settings["fill_gaps"] else ()
        ),
        "the method 'smrf'": ("slope", "window") if method in ("cloth", "labels") else (),
        "methods that filter": ("tolerance",) if method == "labels" else (),
    }
    for kind, names in unused.items():
        for name in names:
            if settings[name] is not None:
                raise InputError(f"`{name}` is for {kind} and does nothing here: leave it out")


def _doubt_place(path: Path, terrain: Terrain, unit: str | None) -> None:
    """Warn of a cloud on the map whose file states no reference system and no unit."""
    if terrain.crs is not None or terrain.origin == (0.0, 0.0):
        return
    if path.suffix.lower() in (".las", ".laz"):  # text and PLY cannot state one
        warnings.warn(
            f"{path}: no coordinate reference system is known. The maps keep the coordinates "
            "and call their system unknown; state it if you know it: --crs EPSG:... (`crs`).",
            stacklevel=3,
        )
    if unit is None:
        warnings.warn(
            f"{path}: the file states no unit, so all is taken for metres; of feet, plants "
            "would seem 3.3 times as tall. State which: --unit foot or metre (`unit`).",
            stacklevel=3,
        )


def _write(run: Run, terrain: Terrain, canopy: Float[np.ndarray, "y x"] | None) -> None:
    """Write the terrain, the height of the canopy and the distance from measured ground."""

    def write_map(path: Path, name: str, values: Float[np.ndarray, "y x"], quantity: str) -> None:
        write_geotiff(
            path,
            values[None],
            [name],
            pixel_m=terrain.cell,
            origin_m=terrain.origin,
            crs=terrain.crs,
            tags={"quantity": quantity, "unit": "m"},
        )

    write_terrain(run.path("terrain.tif", "height of the ground [m]"), terrain)
    write_mesh(run.path("terrain.obj", "the same as a mesh, in the plot's frame"), terrain)
    if canopy is not None:
        path = run.path("canopy_height.tif", "highest point above ground in each cell [m]")
        write_map(path, "canopy_height", canopy, "height of the canopy above ground")
    if terrain.gap is not None and terrain.gap.any():
        path = run.path("ground_distance.tif", "how far cells are from measured ground [m]")
        quantity = "distance of interpolated ground from measured"
        write_map(path, "ground_distance", terrain.gap, quantity)


def _middle(bounds: Bounds, size: float) -> Bounds:
    """A square in the middle of a cloud, its corner on whole decimetres."""
    west, south, east, north = check_bounds(bounds)
    x = round((west + east - size) / 2.0, 1)
    y = round((south + north - size) / 2.0, 1)
    return x, y, x + size, y + size


def _from_cloud(
    cloud: PointCloud,
    bounds: Bounds | None,
    cell: float,
    largest_gap: float,
    run: Run,
    **options: Any,
) -> tuple[Terrain, Float[np.ndarray, "y x"], dict[str, Any]]:
    if bounds is not None:
        check_covered(cloud.bounds, bounds, cell)
        cloud = cloud.crop(bounds, max(_AROUND, options.get("window", WINDOW), largest_gap))
    labelled = labelled_ground(cloud)
    if "method" not in options:
        options["method"] = "smrf" if labelled is None or options else "labels"
    others = dict.fromkeys(("terrain.obj", "canopy_height.tif", "report.html"), "")
    begin_work({"terrain.tif": f"cells of {cell:g} m"} | others)
    with run.stage("Find the ground"):
        ground = find_ground(cloud, **options)
    with run.stage("Fill the surface"):
        terrain = terrain_from_points(
            cloud, ground, cell=cell, bounds=bounds, largest_gap=largest_gap
        )
        canopy = canopy_height(cloud, terrain)
    if is_normalised(cloud):
        lost = "the shape of the ground is lost"
        if terrain.relief > _DOUBTED_RELIEF:
            lost = f"a relief of {terrain.relief:.1f} m is that of plants"
        warnings.warn(
            f"heights of the cloud seem to be above its ground already (most begin at 0), so that "
            f"{lost}. Take the cloud before it was normalised",
            stacklevel=3,
        )
    assert terrain.gap is not None  # of a cloud it is known
    numbers: dict[str, Any] = {
        **_judged(cloud, ground, labelled, terrain, options),
        "ground_by": options["method"],
        "points": len(cloud),
        "ground_share": float(ground.mean()),
        "cells_with_ground": float((terrain.gap == 0.0).mean()),
        "canopy_height_median_m": float(np.nanmedian(canopy)),
        "canopy_height_99_m": float(np.nanpercentile(canopy, 99)),
    }
    return terrain, canopy, numbers


def _judged(
    cloud: PointCloud,
    ground: Bool[np.ndarray, " point"],
    labelled: Bool[np.ndarray, " point"] | None,
    terrain: Terrain,
    options: dict[str, Any],
) -> dict[str, float]:
    """Distances of points from the terrain, in numbers; warns where they speak against it."""
    tolerance = options.get("tolerance", TOLERANCE)
    points = cloud.select(ground).crop(terrain.bounds)
    scatter = float(np.sqrt(np.mean(heights_above_ground(points, terrain) ** 2)))
    if scatter > _ROUGH * tolerance:
        warnings.warn(
            f"the ground scatters by {100 * scatter:.0f} cm about its surface, nearly as "
            "much as the tolerance allows: the cloud may have no points on the ground there. Look "
            "at terrain.png.",
            stacklevel=4,
        )
    numbers = {"ground_scatter_m": scatter}
    own = None if labelled is None else cloud.select(labelled).crop(terrain.bounds)
    if own is not None and len(own):
        off = float(np.median(np.abs(heights_above_ground(own, terrain))))
        numbers["labels_apart_m"] = off
        if off > tolerance:
            warnings.warn(
                f"the file's own ground points lie {off:.2f} m from the ground that the method "
                f"{options['method']!r} found, in the median: try the method 'labels', or look "
                "at terrain.png",
                stacklevel=4,
            )
    inside = cloud.crop(terrain.bounds)
    below = float(np.mean(heights_above_ground(inside, terrain) < -tolerance))
    if below > _BELOW:
        warnings.warn(
            f"{100 * below:.0f} % of the points lie more than {tolerance:g} m below the ground: "
            "look at terrain.png",
            stacklevel=4,
        )
    return numbers | {"points_below": below}


def _summary(terrain: Terrain, numbers: dict[str, Any]) -> TerrainSummary:
    gx, gy = terrain.gradient()
    return TerrainSummary(
        bounds_m=terrain.bounds,
        cell_m=terrain.cell,
        lowest_m=float(terrain.heights.min()),
        relief_m=terrain.relief,
        interpolated_to_m=None if terrain.gap is None else float(terrain.gap.max()),
        median_slope_deg=float(np.degrees(np.arctan(np.median(np.hypot(gx, gy))))),
        **numbers,
    )


def _headline(summary: TerrainSummary) -> list[str]:
    west, south, east, north = summary.bounds_m
    headline = [
        f"{east - west:g} m x {north - south:g} m in cells of {summary.cell_m:g} m; the ground "
        f"spans {summary.relief_m:.2f} m, slope {summary.median_slope_deg:.1f} degrees in the "
        "median."
    ]
    if summary.cells_filled:
        headline.append(
            f"{100 * summary.cells_filled:.1f} % of the cells had no height and were filled."
        )
    if summary.ground_share is not None:
        by = "the file's own labels" if summary.ground_by == "labels" else summary.ground_by
        headline.append(
            f"Ground by {by}: "
            f"{100 * summary.ground_share:.0f} % of the points, in "
            f"{100 * (summary.cells_with_ground or 0.0):.0f} % of the cells; they scatter by "
            f"{100 * (summary.ground_scatter_m or 0.0):.1f} cm about the surface."
        )
    if summary.interpolated_to_m:
        headline.append(
            f"Elsewhere the ground is interpolated, up to {summary.interpolated_to_m:.1f} m from "
            "any that was measured: see ground_distance.tif."
        )
    return headline

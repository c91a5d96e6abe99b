"""From a file to terrain, in one call: what `fynjax terrain` does."""

import warnings
from pathlib import Path
from typing import Any

import numpy as np

from fynjax._core.errors import InputError
from fynjax._core.progress import NullProgress, Progress
from fynjax.io._rasters import write_geotiff
from fynjax.terrain._cloud import PointCloud, read_cloud
from fynjax.terrain._files import raster_bounds, read_terrain, write_mesh, write_terrain
from fynjax.terrain._filter import GroundMethod, find_ground
from fynjax.terrain._picture import write_picture
from fynjax.terrain._raster import Terrain
from fynjax.terrain._surface import canopy_height, heights_above_ground, terrain_from_points
from fynjax.terrain._units import Bounds, check_bounds

_RASTERS = (".tif", ".tiff", ".img", ".vrt", ".asc")
# Points all through a layer as thick as the tolerance scatter by 0.29 of it about their mean.
_ROUGH = 0.27
_AROUND = 10.0
"""Points this far around the plot [m] are kept: the filter is worst at the edge of what it sees."""


def run_terrain(
    path: str | Path,
    output: str | Path,
    *,
    cell: float | None = None,
    bounds: Bounds | None = None,
    size: float | None = None,
    method: GroundMethod = "smrf",
    tolerance: float = 0.3,
    slope: float = 0.15,
    window: float = 5.0,
    largest_gap: float = 10.0,
    unit: str | None = None,
    height_unit: str | None = None,
    crs: str | None = None,
    fill_gaps: bool = False,
    progress: Progress | None = None,
) -> dict[str, Any]:
    """Write the terrain of a plot from a point cloud or a height raster.

    Into the folder `output`: `terrain.tif`, `terrain.obj`, `terrain.png` and, from a cloud,
    `canopy_height.tif`.

    **Arguments:**

    - `path`: a raster (.tif, .tiff, .img, .vrt, .asc), or a cloud as `read_cloud` takes it.
    - `cell`: side of a cell [m]; 0.25 for a cloud and the raster's own unless given.
    - `bounds`: west, south, east, north of the plot in the file's coordinates [m].
    - `size`: instead, the side of a square plot in the middle of the file [m].
    - `method`, `tolerance`, `slope`, `window`: see `find_ground`.
    - `largest_gap`: see `terrain_from_points`.
    - `unit`, `height_unit`, `crs`: see `read_cloud`; `fill_gaps`: see `read_terrain`.

    **Returns:** the summary: headline, files, and figures of the terrain in metres. Warns where
    the ground found is so rough that it may be the inside of plants.

    **Raises:** what these functions raise.
    """
    progress = NullProgress() if progress is None else progress
    path, output = Path(path), Path(output)
    if bounds is not None and size is not None:
        raise InputError("expected `bounds` or `size` of the plot, but got both")
    if size is not None and not (np.isfinite(size) and size > 0.0):
        raise InputError(f"`size` must be positive [m], but is {size}")
    files = {
        "terrain.tif": "height of the ground [m]",
        "terrain.obj": "the same as a mesh, in the plot's frame",
        "terrain.png": "picture of it",
    }
    figures: dict[str, float] = {}
    canopy = None
    if path.suffix.lower() in _RASTERS:
        if unit is not None:
            raise InputError(
                "`unit` is for point clouds; a raster's cells must be in metres. Reproject it, or "
                "state `height_unit` if heights alone are in another unit.",
                file=path,
            )
        with progress.stage("Read the raster"):
            plot = _middle(raster_bounds(path), size) if size is not None else bounds
            terrain = read_terrain(
                path, plot, crs=crs, height_unit=height_unit, fill_gaps=fill_gaps
            )
            if cell is not None:
                terrain = terrain.resample(cell, plot)
    else:
        with progress.stage("Read the cloud"):
            cloud = read_cloud(path, unit=unit, height_unit=height_unit, crs=crs)
        terrain, canopy, figures = _from_cloud(
            cloud,
            bounds if size is None else _middle(cloud.bounds, size),
            0.25 if cell is None else cell,
            largest_gap,
            progress,
            method=method,
            tolerance=tolerance,
            slope=slope,
            window=window,
        )
    with progress.stage("Write"):
        write_terrain(output / "terrain.tif", terrain)
        write_mesh(output / "terrain.obj", terrain)
        write_picture(output / "terrain.png", terrain, canopy)
        if canopy is not None:
            files["canopy_height.tif"] = "highest point above ground in each cell [m]"
            write_geotiff(
                output / "canopy_height.tif",
                canopy[None],
                ["canopy_height"],
                pixel_m=terrain.cell,
                origin_m=terrain.origin,
                crs=terrain.crs,
                tags={"quantity": "height of the canopy above ground", "unit": "m"},
            )
    return _summary(terrain, files, figures)


def _middle(bounds: Bounds, size: float) -> Bounds:
    """A square in the middle of `bounds`, its corner on whole decimetres."""
    west, south, east, north = check_bounds(bounds)
    x = round((west + east - size) / 2.0, 1)
    y = round((south + north - size) / 2.0, 1)
    return x, y, x + size, y + size


def _from_cloud(
    cloud: PointCloud,
    bounds: Bounds | None,
    cell: float,
    largest_gap: float,
    progress: Progress,
    **options: Any,
) -> tuple[Terrain, Any, dict[str, float]]:
    if bounds is not None:
        cloud = cloud.crop(bounds, max(_AROUND, options["window"]))
    with progress.stage("Find the ground"):
        ground = find_ground(cloud, **options)
    with progress.stage("Fill the surface"):
        terrain = terrain_from_points(
            cloud, ground, cell=cell, bounds=bounds, largest_gap=largest_gap
        )
        canopy = canopy_height(cloud, terrain)
    points = cloud.select(ground).crop(terrain.bounds)
    rows, columns = terrain.heights.shape
    west, south, _, _ = terrain.bounds
    i = np.minimum(((points.x - west) / cell).astype(int), columns - 1)
    j = np.minimum(((points.y - south) / cell).astype(int), rows - 1)
    seen = len(np.unique(j * columns + i)) / (rows * columns)
    scatter = float(np.sqrt(np.mean(heights_above_ground(points, terrain) ** 2)))
    if scatter > _ROUGH * options["tolerance"]:
        warnings.warn(
            f"the ground found scatters by {100 * scatter:.0f} cm about its surface, nearly as "
            "much as the tolerance allows: the cloud may have no points on the ground there. Look "
            "at terrain.png.",
            stacklevel=3,
        )
    figures = {
        "points": float(len(cloud)),
        "ground_share": float(ground.mean()),
        "cells_with_ground": seen,
        "ground_scatter_m": scatter,
        "canopy_height_median_m": float(np.nanmedian(canopy)),
        "canopy_height_99_m": float(np.nanpercentile(canopy, 99)),
    }
    return terrain, canopy, figures


def _summary(terrain: Terrain, files: dict[str, str], figures: dict[str, float]) -> dict[str, Any]:
    west, south, east, north = terrain.bounds
    gx, gy = terrain.gradient()
    slope = float(np.degrees(np.arctan(np.median(np.hypot(gx, gy)))))
    headline = [
        f"{east - west:g} m x {north - south:g} m in cells of {terrain.cell:g} m; the ground spans "
        f"{terrain.relief:.2f} m, slope {slope:.1f} degrees in the median."
    ]
    if figures:
        headline.append(
            f"Ground is {100 * figures['ground_share']:.0f} % of the points and seen in "
            f"{100 * figures['cells_with_ground']:.0f} % of the cells; it scatters by "
            f"{100 * figures['ground_scatter_m']:.1f} cm about the surface."
        )
    return {
        "headline": headline,
        "files": files,
        "terrain": {
            "bounds_m": [west, south, east, north],
            "cell_m": terrain.cell,
            "lowest_m": float(terrain.heights.min()),
            "relief_m": terrain.relief,
            "median_slope_deg": slope,
            **figures,
        },
    }

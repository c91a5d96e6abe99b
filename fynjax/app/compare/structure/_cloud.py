"""Read a file's cloud into heights of returns above the ground of a plot."""

import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, get_args

import numpy as np
from jaxtyping import Float
from rasterio.crs import CRS

from fynjax._core.errors import InputError, names_file
from fynjax.app.compare.structure._pits import sunk, without_pits
from fynjax.app.terrain import (
    Bounds,
    PointCloud,
    find_ground,
    heights_above_ground,
    read_cloud,
    terrain_from_points,
)
from fynjax.metrics.structure import BinnedReturns, CellGrid, StructureSettings, bin_returns

_AROUND = 10.0
"""Points this far around the plot [m] help the ground filter, which is worst at edges."""
_FEWEST_LABELLED = 10
_MOST_TERRAIN_CELLS = 1_000_000
_FINEST_TERRAIN = 0.25
# Heights above the ground begin near 0 m; elevations above the sea hardly ever do.
_NOT_GROUND = 5.0
_ROUNDING = 1.5e-3
"""Heights below this are those of the ground itself [m]: files keep millimetres."""
MUCH_NOISE = 0.005
"""Share of returns far below the ground from which on the ground itself is to be doubted [-]."""
_MOST_ROUNDS = 4
"""Rounds of looking for ground again without the noise below it."""
GroundSource = Literal["auto", "labels", "smrf", "cloth", "none"]
"""Where the ground of a cloud comes from."""
_OPTIONS = ("tolerance", "deepest", "tallest")
"""Settings that are options of `fynjax validate` under the same name."""


@dataclass(frozen=True)
class CloudSettings:
    """Settings by which a cloud is read and its ground found."""

    ground: GroundSource = "auto"
    """"labels" takes the file's ground classes, "smrf" and "cloth" filter (see
    `fynjax.app.terrain.find_ground`), "auto" takes labels where there are some and filters else;
    "none" is for heights that are above the ground already."""
    window: float | None = None
    """Radius of the widest closed stand of plants without ground inside it [m], for the filters
    (`fynjax.app.terrain.find_ground`); their own unless given."""
    slope: float | None = None
    """Slope allowed to the ground beyond that of the cloud as a whole [-], for the ground filters
    (`fynjax.app.terrain.find_ground`); the filter's own unless given."""
    tolerance: float = 0.1
    """Tolerance of the ground filters [m]. Their own of 0.3 m takes the lower parts of low plants
    for ground, which in sparse clouds lowers all heights by 5 to 10 cm; 0.1 m leaves less than 1 cm
    (on synthetic shrubland with returns that scatter by 2 cm). Rougher ground, or noisier returns,
    need more."""
    terrain_cell: float | None = None
    """Side of a cell of the terrain [m]; unless given 0.25, or more in large or sparse clouds."""
    largest_gap: float = 10.0
    """Largest distance of a cell of the terrain from a ground point [m]."""
    deepest: float = 0.5
    """Returns farther below the ground than this are noise, and left out [m]; those in between
    count as on the ground."""
    tallest: float | None = None
    """Returns higher above the ground than this are left out [m]: birds, wires."""
    unit: str | None = None
    """Unit of the coordinates, as `fynjax.app.terrain.read_cloud` takes it."""
    height_unit: str | None = None
    """Unit of the heights, as `fynjax.app.terrain.read_cloud` takes it."""
    crs: str | None = None
    """Reference system of the coordinates, as `fynjax.app.terrain.read_cloud` takes it."""

    def __post_init__(self) -> None:
        if self.ground not in (known := get_args(GroundSource)):
            raise InputError(
                f"`ground` (--real-ground, --simulated-ground) must be one of {', '.join(known)}, "
                f"but is {self.ground!r}"
            )
        for name in ("tolerance", "terrain_cell", "largest_gap", "deepest", "tallest"):
            value = getattr(self, name)
            if value is not None and not (np.isfinite(value) and value > 0.0):
                said = f"`{name}` (--{name})" if name in _OPTIONS else f"`{name}`"
                raise InputError(f"{said} must be positive, but is {value:g}")


@dataclass(frozen=True)
class HeightCloud:
    """Returns of a plot, by their height above its ground."""

    file: Path
    x: Float[np.ndarray, " return"]
    """Easting of each return [m]."""
    y: Float[np.ndarray, " return"]
    """Northing of each return [m]."""
    height: Float[np.ndarray, " return"]
    """Height of each return above the ground [m], at least 0."""
    ground: str
    """Way in which the ground was found."""
    ground_share: float | None
    """Share of returns that are ground [-]; none where heights were given."""
    below_ground: int
    """Returns so far below the ground that they were left out as noise."""
    too_high: int
    """Returns left out as higher than plants."""

    def __len__(self) -> int:
        return len(self.height)

    def binned(self, grid: CellGrid, settings: StructureSettings) -> BinnedReturns:
        """The returns in the cells of a plot."""
        return bin_returns(self.x, self.y, self.height, grid, settings)


def open_cloud(path: str | Path, settings: CloudSettings) -> PointCloud:
    """Read a cloud as the settings say."""
    return read_cloud(path, unit=settings.unit, height_unit=settings.height_unit, crs=settings.crs)


@names_file
def height_cloud(
    cloud: PointCloud, path: Path, settings: CloudSettings, bounds: Bounds, slack: float = 0.0
) -> HeightCloud:
    """Heights above the ground of the returns in a plot and up to `slack` [m] around it.

    Raises `InputError`, with the file, for a plot that the cloud does not cover, a cloud without
    ground, or heights that are elevations above the sea.
    """
    if settings.ground == "none":
        inside = cloud.crop(bounds, slack)
        height, share, how = inside.z, None, "heights as given"
        if abs(low := float(np.percentile(height, 1.0))) > _NOT_GROUND:
            raise InputError(
                f"expected heights above the ground (`ground` 'none'; --real-ground, "
                f"--simulated-ground), but the lowest are at {low:.1f} m. Are they above the sea? "
                "Let a filter find the ground: 'smrf'."
            )
    else:
        near = cloud.crop(bounds, max(_AROUND, settings.largest_gap, settings.window or 0.0))
        method = _method(near, settings)
        options = {
            name: value
            for name in ("window", "slope", "tolerance")
            if (value := getattr(settings, name)) is not None
        }
        ground = _ground(near, method, options, settings.deepest)
        cell = settings.terrain_cell or _terrain_cell(near, bounds)
        wide = _overlap(_grown(bounds, slack), cloud.bounds) if slack else bounds
        west, south, east, north = wide or bounds
        across, along = (int(np.ceil(side / cell - 1e-9)) for side in (east - west, north - south))
        wide = (west, south, west + max(across, 2) * cell, south + max(along, 2) * cell)
        terrain = terrain_from_points(
            near, ground, cell=cell, bounds=wide, largest_gap=settings.largest_gap
        )
        keep = near.select(_inside(near, terrain.bounds) & _inside(near, _grown(bounds, slack)))
        share = float(ground[_inside(near, bounds)].mean()) if _inside(near, bounds).any() else None
        height = heights_above_ground(keep, terrain)
        inside, how = keep, method
    noise = height < -settings.deepest
    high = np.zeros(len(height), bool) if settings.tallest is None else height > settings.tallest
    good = ~noise & ~high
    if not good.any():
        raise InputError("expected returns on and above the ground of the plot, but none is left")
    if noise.mean() > MUCH_NOISE:
        warnings.warn(
            f"{path}: {noise.sum()} of {len(height)} returns are more than {settings.deepest:g} m "
            "below the ground. They are left out as noise, but are so many that the ground itself "
            "is to be doubted; clean the cloud first, or state another depth (`deepest`; "
            "--deepest).",
            stacklevel=4,
        )
    return HeightCloud(
        file=path,
        x=inside.x[good],
        y=inside.y[good],
        height=np.where(height[good] < _ROUNDING, 0.0, height[good]),
        ground=how,
        ground_share=share,
        below_ground=int(noise.sum()),
        too_high=int(high.sum()),
    )


def _method(cloud: PointCloud, settings: CloudSettings) -> Literal["labels", "smrf", "cloth"]:
    if settings.ground in ("labels", "smrf", "cloth"):
        return settings.ground
    labelled = cloud.classification is not None and (
        (cloud.classification == 2).sum() >= _FEWEST_LABELLED
    )
    return "labels" if labelled else "smrf"


def _ground(
    cloud: PointCloud,
    method: Literal["labels", "smrf", "cloth"],
    options: dict[str, float],
    depth: float,
) -> np.ndarray:
    """Which points are ground, without noise below it.

    A filter takes the lowest points for ground, so what lies far below the ground that it found is
    taken away and the filter used again.
    """
    use = np.ones(len(cloud), bool)
    for _ in range(_MOST_ROUNDS):
        part = cloud.select(use)
        ground = without_pits(part, find_ground(part, method, **options), depth)
        if method == "labels":
            return ground
        which = np.flatnonzero(use)
        low = sunk(part, ground, depth)
        if not low.any():
            break
        use[which[low]] = False
    is_ground = np.zeros(len(cloud), bool)
    is_ground[which[ground]] = True
    return is_ground


def _terrain_cell(cloud: PointCloud, bounds: Bounds) -> float:
    area = (bounds[2] - bounds[0]) * (bounds[3] - bounds[1])
    west, south, east, north = cloud.bounds
    spacing = np.sqrt((east - west) * (north - south) / len(cloud))
    return float(max(_FINEST_TERRAIN, spacing, np.sqrt(area / _MOST_TERRAIN_CELLS)))


def _grown(bounds: Bounds, by: float) -> Bounds:
    west, south, east, north = bounds
    return west - by, south - by, east + by, north + by


def _inside(cloud: PointCloud, bounds: Bounds) -> np.ndarray:
    west, south, east, north = bounds
    inside = (cloud.x >= west) & (cloud.x <= east)
    return inside & (cloud.y >= south) & (cloud.y <= north)


def common_plot(
    real: PointCloud,
    simulated: PointCloud,
    bounds: Bounds | None,
    shift: tuple[float, float] | None,
) -> tuple[Bounds, tuple[float, float], list[str]]:
    """The plot in the real cloud's coordinates, what to add to the simulated ones, and remarks.

    Raises `InputError` for clouds in different reference systems, or apart in the same one.
    """
    notes: list[str] = []
    if shift is None:
        _check_same_system(real, simulated)
        shift = (0.0, 0.0)
        if _overlap(real.bounds, simulated.bounds) is None:
            if real.crs is not None and simulated.crs is not None:
                raise InputError(
                    f"expected both clouds over the same plot, but the simulated one covers "
                    f"{_words(simulated.bounds)} and the real one {_words(real.bounds)}. State "
                    "what to add to its coordinates (`simulated_shift`; --shift)."
                )
            r, s = real.bounds if bounds is None else bounds, simulated.bounds
            shift = (0.5 * (r[0] + r[2] - s[0] - s[2]), 0.5 * (r[1] + r[3] - s[1] - s[3]))
            notes.append(
                "the clouds have no coordinates in common: the middle of the simulated one was "
                f"put on the middle of the plot, by adding ({shift[0]:.2f}, {shift[1]:.2f}) m; "
                "`simulated_shift` (--shift) states another"
            )
    s = simulated.bounds
    moved = (s[0] + shift[0], s[1] + shift[1], s[2] + shift[0], s[3] + shift[1])
    if bounds is not None:
        return bounds, shift, notes
    common = _overlap(real.bounds, moved)
    if common is None:
        raise InputError(
            f"expected both clouds over the same plot, but with the shift the simulated one covers "
            f"{_words(moved)} and the real one {_words(real.bounds)}"
        )
    return common, shift, notes


def _overlap(a: Bounds, b: Bounds) -> Bounds | None:
    west, south = max(a[0], b[0]), max(a[1], b[1])
    east, north = min(a[2], b[2]), min(a[3], b[3])
    return (west, south, east, north) if west < east and south < north else None


def _words(bounds: Bounds) -> str:
    return "({:.1f}, {:.1f}) to ({:.1f}, {:.1f})".format(*bounds)


def _check_same_system(real: PointCloud, simulated: PointCloud) -> None:
    if real.crs is None or simulated.crs is None:
        return
    real_crs, simulated_crs = CRS.from_wkt(real.crs), CRS.from_wkt(simulated.crs)
    codes = real_crs.to_epsg(), simulated_crs.to_epsg()
    same = codes[0] == codes[1] if None not in codes else real_crs == simulated_crs
    if not same:
        names = [
            f"EPSG:{c}" if c else s.to_string()[:60]
            for c, s in zip(codes, (real_crs, simulated_crs))
        ]
        raise InputError(
            f"expected both clouds in the same coordinate reference system, but the real one is "
            f"in {names[0]} and this one in {names[1]}. Reproject one of them, or state what to "
            "add to its coordinates (`simulated_shift`; --shift)."
        )

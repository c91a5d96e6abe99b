"""Which points of a cloud are ground."""

import ctypes
import os
import sys
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from fynjax._core.errors import InputError
from fynjax._core.extras import require
from fynjax.app.terrain._cloud import GROUND_CLASSES, PointCloud
from fynjax.app.terrain._units import check_positive

GroundMethod = Literal["smrf", "cloth", "labels"]
"""How ground returns are recognised: two filters, or the labels of the file."""

WINDOW, TOLERANCE = 5.0, 0.3
"""Defaults of `find_ground`: width of the largest plant, and height above the ground surface up
to which a return is ground [m]."""

_FEWEST = 10
"""Ground points below which there is no ground to speak of."""

_HALF_DIAGONAL = 2.0**-0.5


def find_ground(
    cloud: PointCloud,
    method: GroundMethod = "smrf",
    *,
    cell: float | None = None,
    window: float | None = None,
    slope: float = 0.15,
    tolerance: float = TOLERANCE,
) -> NDArray[np.bool_]:
    """Separate the points on the ground from those on plants.

    **Arguments:**

    - `cloud`: points in metres.
    - `method`: "smrf" is the simple morphological filter (Pingel et al. 2013): a surface of the
      lowest points, opened with ever larger windows. "cloth" lets a stiff cloth fall on the cloud
      turned upside down (Zhang et al. 2016). "labels" takes `GROUND_CLASSES` of the file.
    - `cell`: side of the filter's cells [m]; about a point in every cell is enough. `None` is
      twice the mean distance of points, and 0.5 to 2 m.
    - `window`: radius [m] of the widest closed stand of plants without a point on the ground
      inside it, at most half of the cloud's diagonal, since no stand in it is wider; `None` is 5
      or, in a smaller cloud, that half; "smrf" only.
    - `slope`: how much steeper than the cloud as a whole the ground may be over a window's radius,
      as rise over run [-]; "smrf" only. 0.15 is what Pingel et al. use for all scenes alike.
    - `tolerance`: how far above or below the surface of the lowest points ground may lie [m]; for
      "smrf" plus what the ground rises over half a cell's diagonal, from the lowest corner of a
      cell to its centre. "smrf" then leaves out points more than three times the ground's own
      scatter above it (as its lower half shows), which are the feet of plants.

    The cloud is levelled first (heights above the plane through its lowest points), so that a
    hillside is filtered like a plain.

    **Returns:** true for each point that is ground.

    **Raises:** `InputError` for a cloud without labels or without ground, an unknown method, or a
    setting out of range; `MissingExtraError` without the extra `terrain`.
    """
    if method not in ("smrf", "cloth", "labels"):
        raise InputError(f"`method` must be 'smrf', 'cloth' or 'labels', but is {method!r}")
    west, south, east, north = cloud.bounds
    widest = 0.5 * float(np.hypot(east - west, north - south))
    window = min(WINDOW, widest) if window is None else window
    for name, value in (("window", window), ("slope", slope), ("tolerance", tolerance)):
        check_positive(name, value)
    if method == "labels":
        return _labelled(cloud)
    spacing = np.sqrt((east - west) * (north - south) / len(cloud))
    size = float(np.clip(2.0 * spacing, 0.5, 2.0) if cell is None else cell)
    check_positive("cell", size)
    if window > 1.01 * widest:  # points never reach the very corners of their plot
        raise InputError(
            f"`window` must be at most half of the cloud's diagonal, {widest:.2f} m, but is "
            f"{window:g} m: it is the radius of the widest closed stand of plants"
        )
    if min(east - west, north - south) < 3.0 * size:
        raise InputError(
            f"expected a cloud wider than three cells of {size:g} m, but it is "
            f"{east - west:.2f} by {north - south:.2f} m. The filter needs more points, or "
            "smaller cells."
        )
    points = _levelled(cloud, window)
    if method == "smrf":
        ground = _morphological(points, size, window, slope, tolerance)
    else:
        ground = _cloth(points, size, tolerance)
    if ground.sum() < _FEWEST:
        raise InputError(
            f"found ground at {int(ground.sum())} of {len(cloud)} points: is this a cloud of "
            "plants only, cut off below, or are the heights upside down?"
        )
    return ground


def labelled_ground(cloud: PointCloud) -> NDArray[np.bool_] | None:
    """The points that a file itself says are ground.

    **Arguments:** `cloud`, points with or without classes.

    **Returns:** true for each point of `GROUND_CLASSES`; None where they are too few for a ground.
    """
    if cloud.classification is None:
        return None
    ground = np.isin(cloud.classification, GROUND_CLASSES)
    return ground if ground.sum() >= _FEWEST else None


def _labelled(cloud: PointCloud) -> NDArray[np.bool_]:
    if cloud.classification is None:
        raise InputError(
            "expected points with classes, but the cloud has none. Let a filter find the ground: "
            "method 'smrf'."
        )
    ground = labelled_ground(cloud)
    if ground is None:
        present = ", ".join(str(label) for label in np.unique(cloud.classification))
        few = int(np.isin(cloud.classification, GROUND_CLASSES).sum())
        raise InputError(
            f"expected points of class 2 (ground), but {few} of {len(cloud)} points "
            f"have it; the cloud has {present}. Let a filter find the ground: method 'smrf'."
        )
    return ground


def _morphological(
    points: NDArray[np.float64], cell: float, window: float, slope: float, tolerance: float
) -> NDArray[np.bool_]:
    pysmrf = require("pysmrf", "terrain")
    with warnings.catch_warnings():
        # It multiplies transforms in a way that its raster library will give up.
        warnings.simplefilter("ignore", PendingDeprecationWarning)
        result = pysmrf.classify(
            *points.T,
            cellsize=cell,
            windows=max(1, round(window / cell)),
            slope_threshold=slope,
            elevation_threshold=tolerance,
            elevation_scaler=_HALF_DIAGONAL * cell,
            low_outlier_fill=True,
            workers=1,
        )
    ground = np.asarray(result.is_ground, bool)
    if not ground.any():
        return ground
    # Low parts of plants lie above the ground's own scatter, which its lower half shows.
    above = np.asarray(result.above_ground_height, np.float64)
    middle = np.median(above[ground])
    scatter = 1.4826 * np.median(middle - above[ground & (above <= middle)])
    return ground & (above <= middle + 3.0 * scatter)


def _levelled(cloud: PointCloud, window: float) -> NDArray[np.float64]:
    """x and y from the south-west corner, z above the plane that the lowest points lie on [m].

    Windows are level, so that on a hillside they hold less of a plant the steeper it is; and
    heights above the sea would make the relative error large at which the filter's solver stops.
    """
    west, south, _, _ = cloud.bounds
    x, y = cloud.x - west, cloud.y - south
    # As wide as the widest stand, so that most blocks hold ground; enough of them for a plane.
    side = min(2.0 * window, x.max() / 3.0, y.max() / 3.0)
    block = np.floor(y / side).astype(np.int64) * (int(x.max() / side) + 1)
    block += np.floor(x / side).astype(np.int64)
    order = np.lexsort((cloud.z, block))
    lowest = order[np.unique(block[order], return_index=True)[1]]
    places = np.stack([x, y], axis=1)[lowest]
    use = np.ones(len(lowest), bool)
    for _ in range(5):  # without blocks of plants only, and without points below the ground
        middle, height = places[use].mean(axis=0), cloud.z[lowest][use].mean()
        # Centred, so that too few blocks for a plane give a level one.
        fit = np.linalg.lstsq(places[use] - middle, cloud.z[lowest][use] - height, rcond=0.05)[0]
        rest = cloud.z[lowest] - height - (places - middle) @ fit
        rest -= np.median(rest)
        use = np.abs(rest) <= 2.5 * 1.4826 * np.median(np.abs(rest)) + 1e-9
    z = cloud.z - height - (x - middle[0]) * fit[0] - (y - middle[1]) * fit[1]
    return np.stack([x, y, z], axis=1)


def _cloth(points: NDArray[np.float64], cell: float, tolerance: float) -> NDArray[np.bool_]:
    csf_module = require("CSF", "terrain", "cloth-simulation-filter")
    csf = csf_module.CSF()
    csf.params.bSloopSmooth = True
    csf.params.cloth_resolution = cell
    csf.params.class_threshold = tolerance
    csf.params.rigidness = 2
    ground, rest = csf_module.VecInt(), csf_module.VecInt()
    with _silent_stdout():
        csf.setPointCloud(points)
        csf.do_filtering(ground, rest, False)
    is_ground = np.zeros(len(points), bool)
    is_ground[np.array(ground, dtype=np.int64)] = True
    return is_ground


@contextmanager
def _silent_stdout() -> Iterator[None]:
    """Send what compiled code prints nowhere: on stdout only a command's own summary may stand."""
    sys.stdout.flush()
    kept = os.dup(1)
    nowhere = os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, 1)
        yield
    finally:
        if os.name == "posix":
            ctypes.CDLL(None).fflush(None)  # the C library buffers what goes to a pipe
        os.dup2(kept, 1)
        os.close(nowhere)
        os.close(kept)

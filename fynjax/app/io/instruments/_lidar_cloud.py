"""Discrete returns of a LiDAR as LAS 1.4."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike
from rasterio.crs import CRS
from rasterio.errors import CRSError

from fynjax._core.errors import InputError, names_file, refusing
from fynjax._core.extras import require
from fynjax.app.io.text import atomic_path
from fynjax.sensors import LidarReturns

INTENSITY_SCALE = 20000.0
"""Intensity of an echo of apparent reflectance 1; the largest, 65535, is above 3."""
_STEP = 0.0005
_ANGLE_STEP = 0.006
_DIMENSIONS = (
    ("reflectance", "f4", "apparent reflectance [-]"),
    ("echo_width", "f4", "full width at half height [ns]"),
    ("pulse", "u4", "index of the pulse"),
)
"""Name, type and description of what a point has besides the fields of its format."""
_OF_SPECIES = (
    ("species", "u2", "from 1 on; 0: ground or none"),
    ("species_share", "f4", "share of its light [-]"),
)


@names_file
def write_cloud(
    path: str | Path,
    returns: LidarReturns,
    *,
    origin_m: tuple[float, float, float] = (0.0, 0.0, 0.0),
    crs: str | None = None,
    attributes: Mapping[str, str | int] | None = None,
    leading: tuple[ArrayLike, ArrayLike] | None = None,
) -> None:
    """Write returns as LAS 1.4, point format 6, whole or not at all; a name in .laz compresses.

    `intensity` is apparent reflectance times 20 000; `classification` 2 is ground and 3 low
    vegetation; `gps_time` counts from the start of the flight, and `point_source_id` the flight
    lines from 1 on. Extra bytes: `reflectance`,
    `echo_width` [ns], `pulse` (its index); where known `species` (from 1 on, 0 for ground or
    none) and `species_share` [-]. Steps of 0.5 mm.

    **Arguments:**

    - `path`: the file to write, .las or .laz.
    - `returns`: as of `fynjax.sensors.detect_returns`, at least one.
    - `origin_m`: (x, y, z) that is added to the coordinates [m], such as the plot's corner on a
      map.
    - `crs`: reference system, such as "EPSG:32734"; written as WKT. `None`: not known.
    - `attributes`: such as those of `provenance`; `source` becomes the generating software.
    - `leading`: species of each return as its place from 0 on, -1 for none, and its share [-], as
      of `ReturnTruth.leading`.

    **Raises:** `InputError` for another suffix than .las and .laz, for no returns, for a `crs` that
    is not known, and where the file cannot be written; `MissingExtraError` without laspy (and lazrs
    for .laz).

    >>> import pathlib, tempfile
    >>> import numpy as np
    >>> from fynjax.app.io.instruments import write_cloud
    >>> from fynjax.sensors import LidarReturns
    >>> from fynjax.app.terrain import read_cloud
    >>> first, zero = np.ones(4, int), np.zeros(4)
    >>> returns = LidarReturns(
    ...     beam=np.arange(4), position=np.array([[0, 0, 0], [0, 2, 0.5], [3, 0, 0.5], [3, 2, 0]]),
    ...     distance=50.0 + zero, reflectance=0.4 + zero, width=4.0 + zero,
    ...     number=first, of=first, classification=2 * first, time=zero, scan_angle=zero,
    ...     line=first,
    ... )
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = pathlib.Path(folder) / "flight.las"
    ...     write_cloud(path, returns, crs="EPSG:32734", origin_m=(300000.0, 6200000.0, 80.0))
    ...     cloud = read_cloud(path)
    >>> cloud.z.round(1)
    array([80. , 80.5, 80.5, 80. ])
    """
    path = Path(path)
    kind = path.suffix.lower()
    if kind not in (".las", ".laz"):
        raise InputError(f"expected a name in .las or .laz, but got {path.name!r}")
    laspy = require("laspy", "terrain")
    if kind == ".laz":
        require("lazrs", "terrain")
    if len(returns) == 0:
        raise InputError(
            "no pulse has a return to write: does the range gate hold the ground, and is the "
            "signal above the noise?"
        )
    place = returns.position + np.asarray(origin_m)
    header = laspy.LasHeader(point_format=6, version="1.4")
    header.scales = np.full(3, _STEP)
    header.offsets = np.floor(place.min(axis=0))
    header.generating_software = str((attributes or {}).get("source", "fynjax"))[:32]
    header.system_identifier = "SIMULATION"
    header.global_encoding.synthetic_return_numbers = False
    more = _DIMENSIONS if leading is None else _DIMENSIONS + _OF_SPECIES
    header.add_extra_dims([laspy.ExtraBytesParams(*dimension) for dimension in more])
    if crs is not None:
        words = f"`crs` must be a reference system such as 'EPSG:32734', but is {crs!r}"
        with refusing(CRSError, words=words):
            # WKT 1, which the LAS specification asks for.
            wkt = CRS.from_user_input(crs).to_wkt(version="WKT1_GDAL")
        header.vlrs.append(laspy.vlrs.known.WktCoordinateSystemVlr(wkt))
    header.global_encoding.wkt = True
    cloud = laspy.LasData(header)
    cloud.x, cloud.y, cloud.z = place.T
    scaled = np.rint(returns.reflectance * INTENSITY_SCALE)
    cloud.intensity = np.clip(scaled, 0, 65535).astype(np.uint16)
    cloud.return_number = returns.number.astype(np.uint8)
    cloud.number_of_returns = returns.of.astype(np.uint8)
    cloud.classification = returns.classification.astype(np.uint8)
    cloud.scan_angle = np.rint(returns.scan_angle / _ANGLE_STEP).astype(np.int16)
    cloud.gps_time = returns.time
    cloud.point_source_id = (returns.line + 1).astype(np.uint16)
    cloud.reflectance = returns.reflectance.astype(np.float32)
    cloud.echo_width = returns.width.astype(np.float32)
    cloud.pulse = returns.beam.astype(np.uint32)
    if leading is not None:
        place, share = map(np.asarray, leading)
        cloud.species = (place + 1).astype(np.uint16)
        cloud.species_share = share.astype(np.float32)
    with atomic_path(path) as partial, refusing(OSError, words="cannot write here: {error}"):
        cloud.write(partial)

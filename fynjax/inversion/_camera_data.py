"""What was measured by a camera, as data of a fit: images and tables in memory; files through the
app."""

import dataclasses
from collections.abc import Mapping, Sequence
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
import pandas as pd
from jaxtyping import Bool, Float

from fynjax._core.errors import InputError
from fynjax._core.extras import app_room
from fynjax.inversion._data import Data, Pixels, Source, block_of, pixel_data
from fynjax.inversion._targets import compared_statistics, weigh_targets
from fynjax.inversion._views import ImageSight
from fynjax.metrics import (
    BANDS,
    bands_needed,
    check_statistics,
    fitting_statistics,
    image_statistics,
)
from fynjax.scene import Observation, Placement, sensor_of
from fynjax.sensors import BandSet, Frame, Gains, Lidar, Pose, Sensor


class TargetRules(NamedTuple):
    """Which statistics of a measurement count, and how far they are trusted."""

    relative_sd: float = 0.01
    """Standard deviation of a statistic over its value, where none is stated [-]."""
    statistics: tuple[str, ...] = ("*",)
    """Patterns of the names of the statistics that count."""
    file: Path | None = None
    """File that states these rules, which errors name."""

    def used(self, names: Sequence[str], what: str) -> list[int]:
        """Places of the names that count. Raises `InputError` where none does."""
        keep = [i for i, n in enumerate(names) if any(fnmatchcase(n, p) for p in self.statistics)]
        if not keep:
            whose = "`statistics`" if self.file is None else "`calibration.targets`"
            raise InputError(f"{whose} fits none of {what}, such as {names[0]!r}", file=self.file)
        return keep


def imager_of(camera: str | Path | Sensor | Lidar) -> Sensor:
    """An imaging sensor.

    **Arguments:** `camera`, which may be its name or file too.

    **Raises:** `InputError` for a LiDAR, and another type.
    """
    sensor: Any = sensor_of(camera)
    if not isinstance(sensor, Sensor):
        what = f"the LiDAR {sensor.name!r}" if isinstance(sensor, Lidar) else repr(sensor)
        raise InputError(f"expected an imaging sensor, but got {what}")
    return sensor


def weighed_statistics(
    values: Float[np.ndarray, "band y x"],
    bands: BandSet,
    mask: Bool[np.ndarray, "y x"],
    pixel: float,
    rules: TargetRules,
    *,
    side: float = np.inf,
) -> Data:
    """Statistics of an image in memory as targets.

    **Arguments:**

    - `values`: reflectance [-].
    - `bands`: of the camera, in their order.
    - `mask`: pixels that count.
    - `pixel`: edge of a pixel on the ground [m].
    - `rules`: which statistics count.
    - `side`: of the plot [m]: means over squares wider than it are left out.
    """
    # No square of several pixels may be wider than image or plot.
    side = min(side, pixel * min(mask.shape))
    every = fitting_statistics(compared_statistics(bands), side, pixel)
    names = [every[i] for i in rules.used(every, "the statistics")]
    # Numbers in place of NaN, which a mask does not keep out of slopes and sums.
    clean = jnp.asarray(np.where(mask, values, 0.0))
    found = np.asarray(image_statistics(clean, names, jnp.asarray(mask), pixel=pixel, bands=bands))
    return weigh_targets(names, found, rules.relative_sd)


def image_of_camera(
    image: Any,
    camera: str | Path | Sensor | Lidar,
    *,
    pixel: float | None,
    footprint: float | None,
    altitude: float | None,
    bands: Sequence[str] | None,
    statistics: Sequence[str],
    relative_sd: float,
    gains: Gains | str | None,
    pose: Pose | Frame | None,
) -> Data:
    """What `Data.from_image` returns, of its arguments."""
    rules, sensor = TargetRules(relative_sd, tuple(statistics)), _camera(camera)
    edge: float | None
    if isinstance(image, Observation):
        seen = [band for band in sensor.bands.names if band in image.bands or band in BANDS]
        values, edge = np.stack([np.asarray(image[band]) for band in seen]), image.pixel
        own = sensor.bands.select([sensor.bands.names.index(band) for band in seen])
        counts = np.ones(values.shape[1:], bool) if image.seen is None else np.asarray(image.seen)
        data = weighed_statistics(values, own, counts, edge, rules)
    elif isinstance(image, str | Path):
        read_image = app_room("assembly", "image_data")
        read = read_image(Path(image), rules, sensor.bands, pixel=pixel, bands=bands)
        data, edge = read.data, read.pixel
    else:
        raise InputError(
            "expected the path of an image or what `observe` gives, but got "
            f"{type(image).__name__}; statistics of an image go through `Data.from_table`"
        )
    if footprint is not None and not footprint > 0:
        raise InputError(f"expected a `footprint` above 0 m, but got {footprint}")
    place = Placement(altitude, edge if footprint is None else footprint)
    if pose is not None:
        frame = pose if isinstance(pose, Frame) else Frame(pose)
        place = dataclasses.replace(place, altitude=None, frame=frame)
    return _seen_by(data, sensor, place, gains)


def table_of_camera(
    table: Any,
    camera: str | Path | Sensor | Lidar,
    *,
    pixel: float | None,
    altitude: float | None,
    relative_sd: float,
    gains: Gains | str | None,
) -> Data:
    """What `Data.from_table` returns, of its arguments."""
    sensor = _camera(camera)
    if isinstance(table, str | Path):
        read = app_room("assembly", "image_data")(
            Path(table), TargetRules(relative_sd), sensor.bands
        )
        data = read.data
    else:
        if isinstance(table, Mapping) and "statistic" not in table:
            table = {"statistic": list(table), "value": list(table.values())}
        try:
            frame = pd.DataFrame(table)
        except (ValueError, TypeError) as error:
            raise InputError(
                "expected a table of statistics, as columns or a mapping of names to values, but "
                f"got {type(table).__name__}: {error}"
            ) from error
        if missing := [name for name in ("statistic", "value") if name not in frame]:
            raise InputError(
                f"expected columns statistic and value, but {missing[0]} is missing",
                column=missing[0],
            )
        names = [str(name) for name in frame["statistic"]]
        if repeated := [name for k, name in enumerate(names) if name in names[:k]]:
            raise InputError(f"expected each statistic once, but {repeated[0]} is there again")
        if not names:
            raise InputError("expected statistics, but the table has none")
        check_statistics(names, sensor.bands)
        sd = _numbers(frame, "sd") if "sd" in frame else None
        data = weigh_targets(names, _numbers(frame, "value"), relative_sd, sd=sd)
    return _seen_by(data, sensor, Placement(altitude, pixel), gains)


def _numbers(frame: pd.DataFrame, column: str) -> Float[np.ndarray, " row"]:
    """A column of numbers; NaN where there is none."""
    found = pd.to_numeric(frame[column], errors="coerce")
    wrong = frame[found.isna() & frame[column].notna()]
    if len(wrong):
        name, value = wrong.iloc[0][["statistic", column]]
        raise InputError(f"expected a number for {name}, but got {value!r}", column=column)
    return found.to_numpy(float)


def pixels_of_camera(
    image: Any,
    camera: str | Path | Sensor | Lidar,
    *,
    pixel: float | None,
    altitude: float | None,
    bands: Sequence[str] | None,
    block: int | None,
    pixel_sd: float | None,
    gains: Gains | str | None,
) -> Data:
    """What `Data.from_pixels` returns, of its arguments."""
    sensor, file = imager_of(camera), None
    if isinstance(image, str | Path):
        file = Path(image)
        read_image = app_room("compare", "read_drone_image")
        read = read_image(file, bands=bands, camera=sensor.bands, most_pixels=None)
        pixel = read.pixel_m if pixel is None else pixel
        order = [name for name in sensor.bands.names if name in read.bands]
        values = read.values[[read.bands.index(name) for name in order]]
        sensor = sensor.select([sensor.bands.names.index(name) for name in order])
    else:
        if isinstance(image, Observation):
            pixel = image.pixel if pixel is None else pixel
            image = np.stack([np.asarray(image[band]) for band in sensor.bands.names])
        values = np.asarray(image, float)
        if values.ndim != 3 or len(values) != len(sensor.bands):
            raise InputError(
                f"expected an image of the {len(sensor.bands)} bands of {sensor.name!r}, rows and "
                f"columns, but got an array of shape {values.shape}"
            )
    rows, columns = values.shape[1:]
    size = block_of(len(values), (rows, columns)) if block is None else block
    names = sensor.bands.names
    own = gains if isinstance(gains, Gains) else sensor.gains(gains)
    every = tuple(f"{n}.mean" for n in names)
    sight = ImageSight(every, sensor, Placement(altitude, pixel), own)
    return pixel_data(Pixels(values, size, pixel_sd), names, sight, file=file)


def _seen_by(data: Data, camera: Sensor, placement: Placement, gains: Gains | str | None) -> Data:
    used = bands_needed({*BANDS, *(name.split(".")[0] for name in data.names)}, camera.bands)
    camera = camera.select([i for i, n in enumerate(camera.bands.names) if n in used])
    found = gains if isinstance(gains, Gains) else camera.gains(gains)
    sight = ImageSight(data.names, camera, placement, found)
    return dataclasses.replace(data, source=Source("image", sight))


def _camera(camera: str | Path | Sensor | Lidar) -> Sensor:
    """A camera with green, red, red edge and near infrared first, then its other bands."""
    sensor = imager_of(camera)
    names = sensor.bands.names
    if missing := [name for name in BANDS if name not in names]:
        raise InputError(
            f"expected a camera with bands {', '.join(BANDS)}, but {sensor.name!r} has no "
            f"{missing[0]}"
        )
    others = [name for name in names if name not in BANDS]
    return sensor.select([names.index(name) for name in (*BANDS, *others)])

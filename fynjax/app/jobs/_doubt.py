"""Doubts, before any long work, of measurements that shrubland cannot make."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike

from fynjax._core.errors import InputError
from fynjax.app.compare import check_shrubland
from fynjax.app.io.plot import Plot, drone_sensor
from fynjax.app.jobs._run import Run
from fynjax.inversion import Data, ImageSight
from fynjax.metrics import without_view
from fynjax.sensors import BandSet, Sensor


def doubt_spectrum(
    run: Run,
    reflectance: Mapping[str, float] | ArrayLike,
    bands: BandSet,
    sensor: Sensor | None = None,
) -> None:
    """Say where the mean of an image, or a spectrum, is none of shrubland (`check_shrubland`).

    It is judged as if well calibrated, and the sentence says whether the errors of a camera's
    calibration explain it. Nothing is said where fewer than two bands can be judged.

    **Arguments:**

    - `run`: of the job, which says it at once, and in its result and on its page (`Run.doubt`).
    - `reflectance`, `bands`: as of `check_shrubland`.
    - `sensor`: the camera, with the errors of its calibration; None where it is not known.
    """
    try:
        check = check_shrubland(reflectance, bands)
    except InputError:
        return
    if not check.unlike:
        return
    text = str(check)
    if sensor is not None:
        gains = sensor.gains()
        loose = check_shrubland(reflectance, bands, gains=gains)
        errors = f"errors of its calibration, {gains}"
        text += (
            f" Not even {errors}, explain them."
            if loose.unlike
            else f" {errors.capitalize()}, can explain them (chance {loose.probability:.2g})."
        )
    run.doubt(text)


def doubt_targets(run: Run, plot: Plot, data: Data) -> None:
    """`doubt_spectrum` of the means of the bands of an image, and of a spectrum, among the targets
    of a plot."""
    for one in data.parts:
        source = one.source
        assert source is not None
        if source.pixels is not None and isinstance(source.view_of, ImageSight):
            camera = source.view_of.sensor
            seen = source.pixels.image
            mean = seen[:, np.isfinite(seen).all(axis=0)].mean(axis=1)
            doubt_spectrum(run, mean, camera.bands, camera)
        elif source.kind == "image":
            sight = source.view_of
            drone = sight.sensor if isinstance(sight, ImageSight) else drone_sensor(plot)
            names = map(without_view, one.names)
            values = dict(zip(names, map(float, one.value), strict=True))
            means = {n: values.get(f"{n}.mean", float("nan")) for n in drone.bands.names}
            doubt_spectrum(run, means, drone.bands, drone)
        elif source.bands is not None:
            doubt_spectrum(run, one.value, source.bands)

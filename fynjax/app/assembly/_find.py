"""Plants of a scene found in an image of it, in a few lines and without a plot file."""

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import Literal

import numpy as np
from jaxtyping import Float

from fynjax._core.errors import InputError
from fynjax.app.compare import read_drone_image
from fynjax.inversion import (
    FoundPlants,
    PlacesSettings,
    believed,
    block_means,
    find_places,
    imager_of,
)
from fynjax.inversion import free as free_of
from fynjax.scene import ModelError, Observation, Placement, Scene, aim
from fynjax.sensors import Gains, Lidar, Sensor

FREE_OF_PLANTS = (
    *(f"species.*.{name}" for name in ("diameter", "height", "leaf_area_index", "dead_fraction")),
    *(f"species.*.leaf.{name}" for name in ("chlorophyll", "water", "dry_matter", "structure")),
    "ground.brightness",
)
"""Patterns of the parameters that are found beside the plants."""
_BLOCK = 0.05
"""Edge of the blocks that are compared, about [m]: below it shapes of single plants would count,
which are not known."""


def blocks_of(
    image: Float[np.ndarray, "band row column"], pixel: float
) -> tuple[Float[np.ndarray, "band y x"], float]:
    """Means of an image over whole blocks of about 5 cm, and their edge [m].

    **Arguments:** `image`, NaN where there is none; `pixel`, its edge [m].
    """
    rows, columns = image.shape[1:]
    most = max(1, round(_BLOCK / pixel))
    block = max(k for k in range(1, most + 1) if not (rows % k or columns % k))
    return block_means(image, block), block * pixel


def find_plants(
    scene: Scene,
    image: str | Path | Observation,
    camera: str | Path | Sensor | Lidar = "mavic_3m",
    *,
    pixel: float | None = None,
    altitude: float | None = None,
    bands: Sequence[str] | None = None,
    height: Float[np.ndarray, "y x"] | None = None,
    free: Sequence[str] = FREE_OF_PLANTS,
    gains: Gains | str | None = None,
    error: ModelError | Literal["learned", "none"] = "learned",
    settings: PlacesSettings | None = None,
    seed: int = 0,
) -> FoundPlants:
    """Find the plants of a plot in an orthophoto: where they stand, of which species and how large.

    **Arguments:**

    - `scene`: of the species table; one whose structure is 5 cm takes half the time.
    - `image`: GeoTIFF of reflectance of the whole plot and nothing else, or what `observe` gives.
    - `camera`: that took it; a name, a sensor file or an object.
    - `pixel`: edge of a pixel [m], where the image states none; below 2 m.
    - `altitude`: of the camera above the ground [m]; as its file has it by default.
    - `bands`: names of the image's bands in their order, where the file does not name them.
    - `height`: of the canopy above the ground, rows from the south, in the voxel columns of the
      scene [m]; NaN where it is not known. None: the image alone counts.
    - `free`: patterns of what is found beside the plants, with the priors of `fx.free`.
    - `gains`: what the calibration of its bands to reflectance may be off by, or how they were
      calibrated; the usual of the camera by default.
    - `error`: what the model is off by over wavelength, as of `fx.fit`.
    - `settings`: of the search; `seed` then is theirs.
    - `seed`: of everything drawn.

    **Returns:** `FoundPlants`, which prints as a sentence: `crowns()` and `table()` are frames,
    `maps()` probabilities over the plot.

    **Raises:** `InputError` for an image that cannot be used or is of another size than the plot;
    `MissingExtraError` without optax.

    Not differentiable.

    >>> import fynjax as fx
    >>> from fynjax.canopy import table1_2006
    >>> from fynjax.inversion import PlacesSettings
    >>> table = table1_2006()[2:4]
    >>> stand = {"size": 0.8, "voxel": 0.1, "structure": 0.05}
    >>> image = fx.observe(fx.Scene.from_table(table, seed=1, **stand), "mavic_3m", pixel=0.05)
    >>> few = PlacesSettings(steps=4, rounds=2, jumps=2, chains=1)
    >>> found = fx.find_plants(fx.Scene.from_table(table, seed=2, **stand), image, settings=few)
    >>> found.maps(cell=0.1).crown.shape
    (8, 8)
    """
    sensor = imager_of(camera)
    if isinstance(image, Observation):
        names, values = image.bands, np.asarray(image.reflectance, float)
        if image.seen is not None:  # what lies outside its frame does not count
            values = np.where(np.asarray(image.seen), values, np.nan)
        edge: float | None = image.pixel
    else:
        read = read_drone_image(Path(image), bands=bands, camera=sensor.bands, most_pixels=None)
        names, values, edge = read.bands, read.values, read.pixel_m
    edge = pixel if edge is None else edge
    if edge is None:
        raise InputError("expected the `pixel` of an image that does not state its own [m]")
    own = [i for i, name in enumerate(sensor.bands.names) if name in names]
    if not own:
        raise InputError(
            f"expected bands of {sensor.name!r} ({', '.join(sensor.bands.names)}), but the image "
            f"has {', '.join(names)}"
        )
    sensor = sensor.select(own)
    means, block = blocks_of(values[[names.index(n) for n in sensor.bands.names]], edge)
    view = aim(scene, scene.parameters, sensor, Placement(altitude, block))
    if view.shape != means.shape[1:]:
        (rows, columns), (north, east) = values.shape[1:], scene.grid.extent[1::-1]
        raise InputError(
            f"expected an image of the whole plot and nothing else, {east:g} m x {north:g} m, but "
            f"it has {columns} x {rows} pixels of {edge:g} m"
        )
    settings = PlacesSettings(seed=seed) if settings is None else settings
    if gains is not None:
        known = gains if isinstance(gains, Gains) else sensor.gains(gains)
        settings = dataclasses.replace(settings, gains=known)
    return find_places(
        scene, means, view, free_of(scene, *free), settings, height=height, error=believed(error)
    )

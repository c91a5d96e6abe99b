"""From a name or a file to a scene, and what is known of shrubland before any fit."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from fynjax._core.errors import InputError
from fynjax._core.precision import double_precision
from fynjax._core.saved import load
from fynjax.app.assembly._build import build_plot
from fynjax.app.compare import DroneImage, VegetationCheck, check_shrubland, read_drone_image
from fynjax.app.io.plot import LearnedPrior, example_folder, read_plot, read_prior
from fynjax.app.io.text import read_rows
from fynjax.inversion import Calibration, Problem, calibration, imager_of, plot_search
from fynjax.scene import Scene, SpeciesRow
from fynjax.sensors import ASSUMED, Gains, Lidar, Sensor

_OF_A_TABLE = "size", "voxel", "structure"
"""Options of `Scene.from_table` that a plot file has with their unit in the name (`size_m`)."""


def read_scene(
    path: str | Path | None = None,
    *,
    seed: int | None = None,
    rounding: Literal["random", "up"] = "random",
    dtype: str = "float32",
    **options: Any,
) -> Scene:
    """A scene with its parameters from a file: of a plot file, or of a species table.

    **Arguments:**

    - `path`: a plot file, the folder of one (`plot.toml`), or a species table (CSV); left out, the
      shipped plot burnt in 2006.
    - `seed`: of everything random; that of the plot file by default, of a table 0.
    - `rounding`: of the numbers of plants, see `PlantingRules`; the commands `render`, `build` and
      `simulate` round "up".
    - `dtype`: floating type that the scene is computed in, "float32" or "float64".
    - `options`: `size`, `voxel` and `structure` as of `Scene.from_table`; of a table `size` is
      needed, and the others there may be given too; of a plot file they are in place of its own, as
      any field of `fynjax.app.io.plot.Plot`.

    **Raises:** `InputError` as `fynjax.app.io.plot.read_plot`, `build_plot` and `Scene.from_table`,
    and for a table without `size`; `TypeError` for an option that there is not.

    >>> import fynjax as fx
    >>> scene = fx.read_scene(size=2.0, structure="even")  # or "species.csv", "plot.toml"
    >>> len(scene.taxa), scene.grid.shape[:2]
    (13, (20, 20))
    """
    path = example_folder() if path is None else Path(path)
    if path.is_dir() or path.suffix.lower() == ".toml":
        if isinstance(side := options.get("size"), int | float):
            options["size"] = side, side
        fields = {f"{k}_m" if k in _OF_A_TABLE else k: value for k, value in options.items()}
        plot = read_plot(path / "plot.toml" if path.is_dir() else path).replace(**fields)
        return build_plot(plot, seed=seed, rounding=rounding, dtype=dtype)[0]
    if "size" not in options:
        raise InputError("expected the `size` of the plot [m] with a species table", file=path)
    rows = [row for _, row in read_rows(path, SpeciesRow, "a species table")]
    seed = 0 if seed is None else seed
    return Scene.from_table(rows, seed=seed, rounding=rounding, dtype=dtype, **options)


def check_vegetation(
    measured: Mapping[str, float] | ArrayLike | DroneImage | str | Path,
    sensor: str | Path | Sensor | Lidar = "mavic_3m",
    *,
    gains: Gains | str | None = None,
) -> VegetationCheck:
    """Whether an image, or a spectrum, is one that shrubland can have: before anything is fitted.

    **Arguments:**

    - `measured`: reflectance of bands by their names, of any of them, or of all in order, of an
      image [band, y, x] too, whose mean counts [-]; or a drone's image, or the path of one.
    - `sensor`: that measured it; a name, a sensor file or an object.
    - `gains`: what its calibration may be off by, or how it was calibrated, such as "panels"
      (`Sensor.gains`); by default that of a good calibration, 5 % a band.

    **Returns:** a `fynjax.app.compare.VegetationCheck`, which prints as a sentence.

    **Raises:** `InputError` as `fynjax.app.compare.check_shrubland`, `read_drone_image` and
    `Sensor.gains`.

    >>> import fynjax as fx
    >>> fx.check_vegetation({"red": 0.045, "red_edge": 0.15, "nir": 0.22}, "mavic_3m").unlike
    False
    >>> bad = {"red": 0.045, "red_edge": 0.08, "nir": 0.22}
    >>> fx.check_vegetation(bad).unlike, fx.check_vegetation(bad, gains="light_sensor").unlike
    (True, False)
    """
    camera = imager_of(sensor)
    if isinstance(measured, str | Path):
        measured = read_drone_image(measured, camera=camera.bands)
    if isinstance(measured, DroneImage):
        means = zip(measured.bands, measured.pixels.mean(axis=1), strict=True)
        measured = {name: mean for name, mean in means if name in camera.bands.names}
    elif not isinstance(measured, Mapping):
        values = np.asarray(measured, dtype=float)
        measured = np.nanmean(values, axis=(1, 2)) if values.ndim == 3 else values
    if not isinstance(gains, Gains):
        gains = ASSUMED if gains is None else camera.gains(gains)
    return check_shrubland(measured, camera.bands, gains=gains)


def prior(name: str | Path = "fynbos_2023") -> LearnedPrior:
    """What a population of plots says of leaf area, dead tissue and clumping of growth forms.

    **Arguments:** `name` of a shipped prior, or the path of a prior file.

    **Raises:** `InputError` for another name, and for a file that cannot be used.
    """
    found = read_prior(name)
    if found is None:
        raise InputError(f"expected the name of a prior or a prior file, but got {name!r}")
    return found


@double_precision
def read_fit(path: str | Path) -> Calibration:
    """A calibration that a command or `Calibration.report` wrote, opened again.

    Its search is not repeated: what follows from where it ended is computed anew, with the plants
    of its seeds, in some seconds a square metre.

    **Arguments:** `path` of the folder, or of its `fit.npz`.

    **Raises:** `InputError` for a folder without one, and for a file that is none of this version.

    **Example:** `fx.read_fit("results").stand()`.
    """
    path = Path(path)
    path = path / "fit.npz" if path.is_dir() else path
    found = load(path)
    if not (isinstance(found, tuple) and len(found) == 2 and isinstance(found[0], Problem)):
        raise InputError("expected the fit of a plot", file=path)
    problem, states = found
    search = plot_search(problem)
    if not (states and all(isinstance(one, search.state) for one in states)):
        raise InputError("expected the fit of a plot", file=path)
    return calibration(search, states)

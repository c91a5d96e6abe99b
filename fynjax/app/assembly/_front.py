"""A scene fitted to what sensors measured of it, in a few lines and without a plot file."""

from collections.abc import Callable, Mapping, Sequence
from fnmatch import fnmatchcase
from inspect import signature
from pathlib import Path
from typing import Any, Literal

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pandas as pd
from jaxtyping import Array, Float
from numpy.typing import ArrayLike

from fynjax._core.errors import InputError, did_you_mean
from fynjax._core.precision import double_precision
from fynjax._core.progress import stage, track
from fynjax._core.seeds import generator
from fynjax.app.assembly._build import build_plot
from fynjax.app.assembly._targets import (
    TargetRules,
    image_data,
    spectrum_data,
    structure_data,
    weighed_statistics,
)
from fynjax.app.compare import DroneImage, VegetationCheck, read_drone_image
from fynjax.app.compare import check_vegetation as check_spectrum
from fynjax.app.io.instruments import load_instrument
from fynjax.app.io.plot import BY_FORM, LearnedPrior, example_folder, read_plot, read_prior
from fynjax.app.io.text import read_rows
from fynjax.inversion import (
    DESIGN_TARGET,
    AbstractView,
    BandDesign,
    Calibration,
    CalibrationSettings,
    Data,
    FitResult,
    ImageView,
    ParameterSpace,
    Posterior,
    PosteriorSampler,
    SamplingMethod,
    calibrate_plot,
    fit_surrogate,
    free_space,
    join_data,
    sample_posterior,
    sweep_sensors,
    weigh_targets,
)
from fynjax.inversion import design as design_bands
from fynjax.inversion import fit as fit_function
from fynjax.metrics import BANDS, bands_needed, check_statistics
from fynjax.scene import (
    ModelError,
    Observation,
    Placement,
    PlotParameters,
    Scene,
    SpeciesRow,
    aim,
    fitting_structure,
    named_values,
    own_spread,
)
from fynjax.sensors import ASSUMED, Gains, Lidar, Sensor

_OF_A_TABLE = "size", "voxel", "structure"
"""Options of `Scene.from_table` that a plot file has with their unit in the name (`size_m`)."""
View = Callable[[Scene, PlotParameters], AbstractView]
"""Makes a sensor's view of a scene."""


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


class PlotData(Data):
    """What sensors measured of a plot, with the errors of that, and how each sensor sees a scene.

    `from_image`, `from_table`, `from_spectrum` and `from_cloud` read one measurement each; their
    sum is all of them together, whose errors are independent. Any statistics of one's own are
    `Data(names, value, sd)`, for a fit of one's own function.
    """

    sensors: tuple[View, ...] = eqx.field(static=True, default=())
    """Views of a scene, one for each sensor, in the order of the statistics."""

    @classmethod
    @double_precision
    def from_image(
        cls,
        image: str | Path | Observation,
        camera: str | Path | Sensor | Lidar = "mavic_3m",
        *,
        pixel: float | None = None,
        footprint: float | None = None,
        altitude: float | None = None,
        bands: Sequence[str] | None = None,
        statistics: Sequence[str] = ("*",),
        relative_sd: float = 0.01,
        gains: Gains | str | None = None,
    ) -> "PlotData":
        """Statistics of a drone's image of the plot.

        **Arguments:**

        - `image`: GeoTIFF of reflectance, or what `observe` gives of such a camera.
        - `camera`: that took it; a name, a sensor file or an object, with bands green, red, red
          edge and near infrared; others are used too where the image has them.
        - `pixel`: edge of a pixel [m], where the image states none.
        - `footprint`: side of the square that a pixel averages over [m], where resampling,
          mosaicking or blur make it another than its edge.
        - `altitude`: of the camera above the ground [m]; as its file has it by default.
        - `bands`: names of the image's bands in their order, where the file does not name them.
        - `statistics`: patterns of those that count, such as "*.mean".
        - `relative_sd`: error of a mean or quantile as a share of it [-].
        - `gains`: what the calibration of its bands to reflectance may be off by, or how they were
          calibrated, such as "panels" (`Sensor.gains`); the usual of the camera by default.

        **Raises:** `InputError` for an image or camera that cannot be used.
        """
        rules, sensor = TargetRules(relative_sd, tuple(statistics)), _camera(camera)
        edge: float | None
        if isinstance(image, Observation):
            seen = [band for band in sensor.bands.names if band in image.bands or band in BANDS]
            values, edge = np.stack([np.asarray(image[band]) for band in seen]), image.pixel
            own = sensor.bands.select([sensor.bands.names.index(band) for band in seen])
            every = np.ones(values.shape[1:], bool)
            data = weighed_statistics(values, own, every, edge, rules)
        elif isinstance(image, str | Path):
            read = image_data(Path(image), rules, sensor.bands, pixel=pixel, bands=bands)
            data, edge = read.data, read.pixel
        else:
            raise InputError(
                "expected the path of an image or what `observe` gives, but got "
                f"{type(image).__name__}; statistics of an image go through `Data.from_table`"
            )
        return cls._seen(data, sensor, Placement(altitude, footprint or edge), gains)

    @classmethod
    @double_precision
    def from_table(
        cls,
        table: Any,
        camera: str | Path | Sensor | Lidar = "mavic_3m",
        *,
        pixel: float | None = None,
        altitude: float | None = None,
        relative_sd: float = 0.01,
        gains: Gains | str | None = None,
    ) -> "PlotData":
        """Statistics of a drone's image from a table.

        **Arguments:**

        - `table`: path of a CSV, a pandas frame, or a mapping of names to values; with columns
          statistic, value and, where they are known, sd. Names such as `NDVI.mean`.
        - `camera`, `pixel`, `altitude`, `relative_sd`, `gains`: as of `from_image`.

        **Raises:** `InputError` for a table or camera that cannot be used.
        """
        sensor = _camera(camera)
        if isinstance(table, str | Path):
            rules = TargetRules(relative_sd)
            data = image_data(Path(table), rules, sensor.bands).data
        else:
            if isinstance(table, Mapping) and "statistic" not in table:
                table = {"statistic": list(table), "value": list(table.values())}
            frame = pd.DataFrame(table)
            if missing := [name for name in ("statistic", "value") if name not in frame]:
                raise InputError(
                    f"expected columns statistic and value, but {missing[0]} is missing",
                    column=missing[0],
                )
            sd = frame["sd"].to_numpy(float) if "sd" in frame else None
            names = [str(name) for name in frame["statistic"]]
            check_statistics(names, sensor.bands)
            data = weigh_targets(names, frame["value"].to_numpy(float), relative_sd, sd=sd)
        return cls._seen(data, sensor, Placement(altitude, pixel), gains)

    @classmethod
    @double_precision
    def from_spectrum(
        cls,
        path: str | Path,
        *,
        sun_zenith: float = 30.0,
        statistics: Sequence[str] = ("*",),
        relative_sd: float = 0.01,
    ) -> "PlotData":
        """The mean spectrum of a plot from above, such as of pixels of AVIRIS-NG.

        **Arguments:**

        - `path`: of spectra, or of an image of many bands.
        - `sun_zenith`: of the sun, for the noise [degrees].
        - `statistics`: patterns of the bands that count, such as "spectrum.5*".
        - `relative_sd`: error of a band for itself, as a share of it [-].

        **Raises:** `InputError` for spectra that cannot be used.
        """
        found = spectrum_data(Path(path), TargetRules(relative_sd, tuple(statistics)), sun_zenith)
        return cls._of(found.data, (found.view_of,))

    @classmethod
    @double_precision
    def from_cloud(
        cls,
        path: str | Path,
        scene: Scene,
        *,
        statistics: Sequence[str] = ("*",),
        relative_sd: float = 0.01,
        seed: int = 0,
    ) -> "PlotData":
        """Structure of a LiDAR's point cloud of the plot.

        **Arguments:**

        - `path`: LAS, LAZ, PLY or text; or a table of metrics.
        - `scene`: whose voxels the metrics must fit.
        - `statistics`: patterns of the metrics that count.
        - `relative_sd`: error of the model as a share of a metric [-].
        - `seed`: of the resampling of cells.

        **Raises:** `InputError` for a cloud that cannot be used.
        """
        voxel, side = scene.grid.horizontal_size, min(scene.grid.extent[:2])
        settings, grains = fitting_structure(voxel, side)
        rules = TargetRules(relative_sd, tuple(statistics))
        found = structure_data(Path(path), rules, settings, grains, seed)
        return cls._of(found.data, (found.view_of,))

    @double_precision
    def __add__(self, other: "PlotData") -> "PlotData":
        """Both measurements of the same plot."""
        if not isinstance(other, PlotData):
            return NotImplemented
        twice = sorted(set(self.names) & set(other.names))
        if twice:
            raise InputError(f"expected each statistic once, but {twice[0]!r} is in both data")
        return self._of(join_data([self, other]), (*self.sensors, *other.sensors))

    @classmethod
    def _of(cls, data: Data, sensors: tuple[View, ...]) -> "PlotData":
        return cls(data.names, data.value, data.sd, data.whitener, sensors)

    @classmethod
    def _seen(
        cls, data: Data, camera: Sensor, placement: Placement, gains: Gains | str | None
    ) -> "PlotData":
        used = bands_needed({*BANDS, *(name.split(".")[0] for name in data.names)}, camera.bands)
        camera = camera.select([i for i, n in enumerate(camera.bands.names) if n in used])
        found = gains if isinstance(gains, Gains) else camera.gains(gains)

        def view(scene: Scene, parameters: PlotParameters) -> AbstractView:
            aimed = aim(scene, parameters, camera, placement)
            return ImageView(data.names, aimed, found)

        return cls._of(data, (view,))


def imager(camera: str | Path | Sensor | Lidar) -> Sensor:
    """An imaging sensor, from its name or file too."""
    sensor = load_instrument(camera) if isinstance(camera, str | Path) else camera
    if not isinstance(sensor, Sensor):
        what = f"the LiDAR {sensor.name!r}" if isinstance(sensor, Lidar) else repr(sensor)
        raise InputError(f"expected an imaging sensor, but got {what}")
    return sensor


def _camera(camera: str | Path | Sensor | Lidar) -> Sensor:
    """A camera with green, red, red edge and near infrared first, then its other bands."""
    sensor = imager(camera)
    names = sensor.bands.names
    if missing := [name for name in BANDS if name not in names]:
        raise InputError(
            f"expected a camera with bands {', '.join(BANDS)}, but {sensor.name!r} has no "
            f"{missing[0]}"
        )
    others = [name for name in names if name not in BANDS]
    return sensor.select([names.index(name) for name in (*BANDS, *others)])


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

    **Raises:** `InputError` as `fynjax.app.compare.check_vegetation`, `read_drone_image` and
    `Sensor.gains`.

    >>> import fynjax as fx
    >>> fx.check_vegetation({"red": 0.045, "red_edge": 0.15, "nir": 0.22}, "mavic_3m").unlike
    False
    >>> bad = {"red": 0.045, "red_edge": 0.08, "nir": 0.22}
    >>> fx.check_vegetation(bad).unlike, fx.check_vegetation(bad, gains="light_sensor").unlike
    (True, False)
    """
    camera = imager(sensor)
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
    return check_spectrum(measured, camera.bands, gains=gains)


def prior(name: str | Path = "fynbos_2023") -> LearnedPrior:
    """What a population of plots says of leaf area, dead tissue and clumping of growth forms.

    **Arguments:** `name` of a shipped prior, or the path of a prior file.

    **Raises:** `InputError` for another name, and for a file that cannot be used.
    """
    found = read_prior(name)
    if found is None:
        raise InputError(f"expected the name of a prior or a prior file, but got {name!r}")
    return found


def free(
    scene: Scene,
    *patterns: str,
    prior: LearnedPrior | Mapping[str, float] | None = None,
    common: float | None = None,
) -> ParameterSpace:
    """The parameters of a scene that a fit may change, with priors about their present values.

    **Arguments:**

    - `scene`: with its parameters. Those without effect are left out (`free_space`).
    - `patterns`: of names, such as "species.*.cover" or "species.Erica*.leaf.chlorophyll".
    - `prior`: relative standard deviations by pattern [-], the first that fits a name, or a learned
      population (`fx.prior`), which says how leaf area, dead tissue and clumping vary; of others
      as the scene's species table says (`Scene.spreads`: covers that are classes or ranges, which a
      pattern with "*" does not replace, and generic plants), else that of the parameter's record.
    - `common`: how far what the table is off by is common to all species, as the correlation of
      their priors of one kind, 0 to below 1 [-]: near 1 where one eye guessed all covers. Left out,
      as the parameters' records have it: none of covers.

    **Raises:** `InputError` for a pattern that fits no name, and a parameter that cannot be free.

    >>> import fynjax as fx
    >>> from fynjax.canopy import table1_2006
    >>> scene = fx.Scene.from_table(table1_2006()[:2], size=1.0, voxel=0.5)
    >>> fx.free(scene, "species.*.cover").names
    ('species.Metalasia muricata.cover', 'species.Passerina corymbosa.cover')
    """
    if not patterns:
        raise InputError('expected patterns of parameters, such as "species.*.cover"')
    forms = dict(zip(scene.taxa, scene.forms, strict=True))
    values = named_values(scene.parameters, scene.taxa)
    known = list(values)
    stated = prior if isinstance(prior, Mapping) else {}
    for pattern in (*patterns, *stated):
        if not any(fnmatchcase(name, pattern) for name in known):
            raise InputError(
                f"{pattern!r} fits none of the scene's parameters.{did_you_mean(pattern, known)}"
            )

    def relative_sd(name: str) -> float | None:
        kind = name.rsplit(".", 1)[-1]
        if isinstance(prior, LearnedPrior) and kind in BY_FORM:
            form = forms[name.split(".", 1)[1].rsplit(".", 1)[0]]
            return prior.sd(f"{kind}.{form}", elsewhere=True) / float(values[name])
        # What is stated goes before what the table says of itself, but a cover must be named.
        own = own_spread(name, dict(scene.spreads), stated)
        stated_sd = (sd for pattern, sd in stated.items() if fnmatchcase(name, pattern))
        return next(stated_sd, None) if own is None else own

    return free_space(scene, scene.parameters, patterns, relative_sd, common=common)


def information(
    scene: Scene,
    free: ParameterSpace,
    sensor: str | Path | Sensor | Lidar = "mavic_3m",
    *,
    gsd: Sequence[float],
    error: ModelError | Literal["learned", "none"] = "learned",
    plantings: int = 15,
    seed: int = 0,
) -> pd.DataFrame:
    """How well an image can tell parameters at best: Cramér-Rao bounds for each size of pixel.

    **Arguments:**

    - `scene`: with its parameters.
    - `free`: the parameters that are not known, with their priors (`fx.free`).
    - `sensor`: an imaging one, by name, file or as an object.
    - `gsd`: sides of a pixel [m], multiples of the smallest.
    - `error`: what the model is off by over wavelength, as of `fit`.
    - `plantings`: other plantings of the table, by which chance is known; at least 2.
    - `seed`: of the noise of pixels.

    **Returns:** a row for each parameter, a column for each pixel: the bound on its standard
    deviation from the image, where the others are known as well as their priors, over its value.
    It never falls from a pixel to a larger one; how it is computed, see
    `fynjax.inversion.sweep_sensors`.

    **Raises:** `InputError` as `sweep_sensors`, and for a LiDAR.
    """
    camera = imager(sensor)
    found = sweep_sensors(
        scene, scene.parameters, free, camera,
        gsd=gsd, bands=(len(camera.bands),), model_error=_believed(error),
        stand_realisations=plantings, seed=seed,
    )  # fmt: skip
    value = np.abs(np.asarray(free.prior))
    table = {setting.gsd: known.bound / value for setting, known in found}
    return (
        pd.DataFrame(table, list(free.names)).rename_axis("parameter").rename_axis(columns="gsd_m")
    )


def design(
    scenes: Scene | Sequence[Scene],
    bands: int = 4,
    target: str | Sequence[str] = DESIGN_TARGET,
    *,
    error: ModelError | Literal["learned", "none"] = "learned",
    **options: Any,
) -> BandDesign:
    """The most informative bands of a camera on a stand, beside those of sensors that there are.

    **Arguments:**

    - `scenes`: one, of which other plantings are made; or several of the same species.
    - `bands`: their number.
    - `target`: what they should tell: names or patterns of numbers of the stand and of free
      parameters, "information" or "separability".
    - `error`: what the model is off by over wavelength, as of `fit`.
    - `options`: `free`, `pixel`, `spectrum`, `widths`, `snr`, `relative_sd`, `plantings`,
      `compare`, `starts` and `seed`, as `fynjax.inversion.design` takes them, which says how it is
      computed.

    **Returns:** `BandDesign`, which prints what the bands gain over other sensors.

    **Raises:** `InputError` as that function, and for an option that it does not have.
    """
    own = {"scenes", "bands", "target", "model_error"}
    _check_options("design", design_bands, own, options)
    return design_bands(scenes, bands, target, model_error=_believed(error), **options)


@double_precision
def fit(
    model: Scene | Callable[..., Float[Array, " statistic"]],
    data: Data,
    free: ParameterSpace,
    *,
    solver: Any = None,
    max_steps: int = 30,
    settings: CalibrationSettings | None = None,
    error: ModelError | Literal["learned", "none"] = "learned",
    start: Calibration | FitResult | Float[Array, " free"] | None = None,
    **options: Any,
) -> Any:
    """The most probable parameters of a scene, or of any function, given what was measured.

    **Arguments:**

    - `model`: a scene, or a traceable function of the free parameters in their own units.
    - `data`: of a scene with the sensors that measured it (`Data.from_image` and the like).
    - `free`: the free parameters with their priors (`fx.free`, or a `ParameterSpace`).
    - `solver`: `fx.BroydenLM()` by default; or a solver object of optimistix or jaxopt.
    - `max_steps`: most steps of the solver, of a scene in the first round.
    - `settings`: of a scene: plantings, rounds and light of the search, with its own `max_steps`.
    - `error`: what the model of a scene is off by over wavelength: "learned" from 18 plots of
      fynbos, 12 to 15 % from 450 to 1100 nm; that of another population or a wider one, such as
      `fx.prior().model_error.wider(1.4)` for shrubland elsewhere; or "none", right only where the
      model itself made the data.
    - `start`: what an earlier fit found, to go on from there: parameters that it did not have start
      at their priors. Or whitened coordinates. By default the prior's centre.
    - `options`: of a function as `fynjax.inversion.fit` takes them: `tolerance`, `offset`,
      `context`.

    **Returns:** `Calibration` of a scene, `FitResult` of a function; both print what they found.

    **Raises:** `InputError` for an argument of another type, for data of a scene without sensors,
    and as those functions.
    """
    if not isinstance(model, Scene):
        if not callable(model):
            raise InputError(f"expected a scene or a function, but got {model!r:.60}")
        _check_problem(data, free)
        if settings is not None:
            raise InputError("expected `settings` with a scene, not with a function")
        with stage("Fit"):
            return fit_function(
                model, data, free, solver=solver, max_steps=max_steps,
                start=_place(start, free), **options,
            )  # fmt: skip
    sensors = data.sensors if isinstance(data, PlotData) else ()
    if not sensors:
        raise InputError(
            "expected data with the sensors that measured them, of Data.from_image, from_table, "
            "from_spectrum or from_cloud"
        )
    _check_problem(data, free)
    views = [view(model, model.parameters) for view in sensors]
    settings = CalibrationSettings(max_steps=max_steps) if settings is None else settings
    return calibrate_plot(
        model, model.parameters, data, free, views, settings, error=_believed(error),
        solver=solver, start=_place(start, free), **options,
    )  # fmt: skip


def _believed(error: ModelError | Literal["learned", "none"]) -> ModelError | None:
    """The error of the model that an argument `error` means; None for "none"."""
    if isinstance(error, ModelError):
        return error
    if error not in ("learned", "none"):
        raise InputError(
            f'expected `error` as "learned", "none" or a `ModelError`, but got {error!r}'
        )
    return prior().model_error if error == "learned" else None


_FARTHEST = 4.0
"""Farthest start from the prior [standard deviations]: beyond, a parameter at its bound is flat."""


def _place(start: Any, space: ParameterSpace) -> Float[Array, " free"] | None:
    """Whitened coordinates of an earlier fit's estimate, or as they were given."""
    found = start.fit if isinstance(start, Calibration) else start
    if not isinstance(found, FitResult):
        if found is not None and np.shape(found) != (len(space.names),):
            raise InputError(
                f"expected `start` as an earlier fit or {len(space.names)} whitened coordinates, "
                f"one for each free parameter, but got {found!r:.60}"
            )
        return found
    if bool(eqx.tree_equal(found.space, space)):
        return found.whitened
    # Of an earlier fit of other parameters those that are free here again.
    known = dict(zip(found.names, found.estimate))
    values = [known.get(name, prior) for name, prior in zip(space.names, space.prior)]
    return jnp.clip(space.whitened(jnp.stack(values)), -_FARTHEST, _FARTHEST)


def _check_problem(data: Any, free: Any) -> None:
    if not isinstance(data, Data):
        raise InputError(f"expected `data` as `fx.Data`, but got {data!r:.60}")
    if not isinstance(free, ParameterSpace):
        raise InputError(
            f"expected `free` as of `fx.free` or `fx.ParameterSpace`, but got {free!r:.60}"
        )


@double_precision
def sample(
    fitted: Calibration | FitResult,
    method: SamplingMethod = "emcee",
    *,
    predict: Callable[..., Float[Array, " statistic"]] | None = None,
    target: float = 400.0,
    max_steps: int = 10_000,
    chains: int | None = None,
    seed: int = 0,
    **options: Any,
) -> Posterior:
    """Draws from the posterior about a fit.

    **Arguments:**

    - `fitted`: from `fx.fit`. Statistics of a scene are then those of a quadratic surrogate, fitted
      to renders at draws of one and a half times the Laplace posterior.
    - `method`: "emcee", "nuts" or "laplace".
    - `predict`: the function that was fitted, where `fitted` is not of a scene.
    - `target`: effective draws to reach, on a chain longer than 50 autocorrelation times.
    - `max_steps`: of the chain, where to give up.
    - `chains`: walkers of the ensemble (32, or four a parameter) or chains of NUTS (4).
    - `seed`: of all random numbers.
    - `options`: of a function the `offset`, `context` and `log_prior` of its fit; `moves`,
      `warmup`, `batch` and `predictive`, as `fynjax.inversion.PosteriorSampler` has them.

    **Returns:** `Posterior`; its `inference_data()` is arviz'.

    **Raises:** `InputError` as `PosteriorSampler`, for an option that it does not have, and for a
    fit of a function without that function.
    """
    options |= {"method": method, "target": target, "max_steps": max_steps, "chains": chains}
    own = {"predict", "data", "space", "start"}
    _check_options("sample", PosteriorSampler, own, options)
    if isinstance(fitted, FitResult):
        if predict is None:
            raise InputError(
                "expected the function that was fitted too: fx.sample(fit, predict=function)"
            )
        return sample_posterior(
            predict, fitted.data, fitted.space, start=fitted, seed=seed, **options
        )
    if not isinstance(fitted, Calibration):
        raise InputError(f"expected what `fx.fit` returns, but got {fitted!r:.60}")
    found = fit_surrogate(fitted, seed=seed)
    start = fitted.fit
    return sample_posterior(
        found.surrogate, fitted.data, start.space, start=start, seed=seed, **options
    )


def _check_options(
    name: str, called: Callable[..., Any], own: set[str], options: Mapping[str, Any]
) -> None:
    """Raise `InputError` for an option that `called` has not, or that is one of its `own`."""
    known = [option for option in signature(called).parameters if option not in own]
    for option in options:
        if option not in known:
            raise InputError(f"`{name}` has no option {option!r}.{did_you_mean(option, known)}")


class Emulated(eqx.Module):
    """A polynomial of second degree that stands in for a costly function; `emulate` makes one."""

    centre: Float[np.ndarray, " free"]
    """Middle of the range in which it stands in for the function."""
    scale: Float[np.ndarray, " free"]
    """Half the width of that range."""
    coefficients: Float[np.ndarray, "term output"]
    """Coefficients of the constant, the coordinates and their products; the range is -1 to 1."""
    error: Float[np.ndarray, " output"]
    """Root mean square error at points that were left out of its fit."""

    def __call__(self, values: Float[Array, " free"]) -> Float[Array, " output"]:
        """The function's value; differentiable; jit and vmap work."""
        unit = (jnp.asarray(values) - self.centre) / self.scale
        return _terms(unit) @ jnp.asarray(self.coefficients)


def _terms(unit: Float[Array, "*point free"]) -> Float[Array, "*point term"]:
    first, second = np.triu_indices(unit.shape[-1])
    one = jnp.ones((*unit.shape[:-1], 1))
    return jnp.concatenate([one, unit, unit[..., first] * unit[..., second]], axis=-1)


@double_precision
def emulate(
    function: Callable[[Float[Array, " free"]], Float[Array, " output"]],
    lower: Any,
    upper: Any,
    *,
    points: int | None = None,
    seed: int = 0,
) -> Emulated:
    """A polynomial of second degree in place of a costly function of a few numbers.

    **Arguments:**

    - `function`: of an array [free], such as of a cover and a leaf area; gives an array [output].
    - `lower`, `upper`: ends of the range in which it is needed [free].
    - `points`: where the function is evaluated, in a Sobol sequence; three times the terms of the
      polynomial by default. A fifth of them are left out, to say its error.
    - `seed`: of the sequence.

    **Returns:** `Emulated`, differentiable. Outside the range it is a guess.

    **Raises:** `InputError` for bounds that are no ranges, too few points, and values that are not
    finite.

    >>> import jax.numpy as jnp
    >>> import fynjax as fx
    >>> quick = fx.emulate(lambda x: jnp.array([x[0] * x[1]]), [0.0, 0.0], [1.0, 2.0])
    >>> quick(jnp.array([0.5, 1.0])).round(3).tolist()
    [0.5]
    """
    from scipy.stats import qmc  # late: it takes half of the package's import time

    low, high = np.atleast_1d(np.asarray(lower, float)), np.atleast_1d(np.asarray(upper, float))
    if low.shape != high.shape or low.ndim != 1 or not (high > low).all():
        raise InputError(f"expected `lower` below `upper`, but got {lower} and {upper}")
    terms = _terms(jnp.zeros(low.size)).size
    count = 3 * terms if points is None else points
    if count < 1.25 * terms + 2:
        raise InputError(f"expected at least {int(np.ceil(1.25 * terms)) + 2} points, got {count}")
    # Whole powers of two keep a Sobol sequence even; the first of them are taken.
    sequence = qmc.Sobol(low.size, rng=generator(seed))
    unit = 2.0 * sequence.random(1 << (count - 1).bit_length())[:count] - 1.0
    centre, scale = 0.5 * (low + high), 0.5 * (high - low)
    found = np.stack(
        [np.ravel(function(jnp.asarray(centre + scale * u))) for u in track(unit, "Emulate")]
    )
    if not np.isfinite(found).all():
        at = centre + scale * unit[int(np.argmin(np.isfinite(found).all(axis=1)))]
        raise InputError(f"the function is not finite at {at.tolist()}")
    rows = np.asarray(_terms(jnp.asarray(unit)))
    # Each fifth point is left out, for the error; the polynomial that is used has them all.
    kept = np.arange(count) % 5 != 0
    partial = np.linalg.lstsq(rows[kept], found[kept])[0]
    error = np.sqrt(np.mean((rows[~kept] @ partial - found[~kept]) ** 2, axis=0))
    whole = np.linalg.lstsq(rows, found)[0]
    return Emulated(centre, scale, whole, error)

"""The arrow backwards, of a scene or of any function: what is free, the fit, the draws."""

from collections.abc import Callable, Mapping, Sequence
from fnmatch import fnmatchcase
from inspect import signature
from pathlib import Path
from typing import Any, Literal, Protocol, runtime_checkable

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pandas as pd
from jaxtyping import Array, Float

from fynjax._core.errors import InputError, did_you_mean
from fynjax._core.precision import double_precision
from fynjax._core.progress import stage
from fynjax.inversion._calibrate import Calibration, fit_plot, free_space
from fynjax.inversion._camera_data import imager_of
from fynjax.inversion._data import Data
from fynjax.inversion._fit import fit_function
from fynjax.inversion._fit_result import FitResult
from fynjax.inversion._posterior import PosteriorSampler, SamplingMethod, sample_posterior
from fynjax.inversion._posterior_result import Posterior
from fynjax.inversion._problem import CalibrationSettings, Problem, believed, check_asked
from fynjax.inversion._sensor_sweep import sweep_sensors
from fynjax.inversion._space import ParameterSpace
from fynjax.inversion._surrogate import fit_surrogate
from fynjax.scene import ModelError, Scene, named_values, own_spread
from fynjax.sensors import Lidar, Sensor


@runtime_checkable
class PlotsPrior(Protocol):
    """What a population of plots says of some kinds of parameters of each growth form, as `prior`
    reads it from a file."""

    @property
    def kinds(self) -> tuple[str, ...]:
        """Kinds of parameters that it says."""

    def sd(self, name: str, *, elsewhere: bool = False) -> float:
        """Standard deviation of a parameter, of a plot `elsewhere` too; "dead_fraction.mound"."""


def free(
    scene: Scene,
    *patterns: str,
    prior: PlotsPrior | Mapping[str, float] | None = None,
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
            unstated = pattern.endswith(".leaf_angle") and not any(
                name.endswith(".leaf_angle") for name in known
            )
            hint = " State leaf_angle_deg in the species table: then it is one." if unstated else ""
            raise InputError(
                f"{pattern!r} fits none of the scene's parameters."
                f"{hint or did_you_mean(pattern, known)}"
            )

    def relative_sd(name: str) -> float | None:
        kind = name.rsplit(".", 1)[-1]
        learned = None if isinstance(prior, Mapping) else prior
        # Of nothing no share is known.
        if learned is not None and kind in learned.kinds and float(values[name]) != 0.0:
            form = forms[name.split(".", 1)[1].rsplit(".", 1)[0]]
            return learned.sd(f"{kind}.{form}", elsewhere=True) / float(values[name])
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
    gsd: float | Sequence[float],
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
    camera = imager_of(sensor)
    found = sweep_sensors(
        scene, scene.parameters, free, camera,
        gsd=np.atleast_1d(gsd).tolist(), bands=(len(camera.bands),), model_error=believed(error),
        stand_realisations=plantings, seed=seed,
    )  # fmt: skip
    value = np.abs(np.asarray(free.prior))
    table = {setting.gsd: known.bound / value for setting, known in found}
    return (
        pd.DataFrame(table, list(free.names)).rename_axis("parameter").rename_axis(columns="gsd_m")
    )


@double_precision
def fit(
    model: Problem | Scene | Callable[..., Float[Array, " statistic"]],
    data: Data | None = None,
    free: ParameterSpace | None = None,
    *,
    solver: Any = None,
    max_steps: int | None = None,
    settings: CalibrationSettings | None = None,
    error: ModelError | Literal["learned", "none"] | None = None,
    start: Calibration | FitResult | Float[Array, " free"] | None = None,
    **options: Any,
) -> Any:
    """The most probable parameters of a scene, or of any function, given what was measured.

    Where exactly each plant stands nobody measured: it is chance. So the data of a scene count as
    one draw of a normal distribution of the statistics over plantings (synthetic likelihood: Wood
    2010, Price et al. 2018). Statistics bend over what is unknown of the parameters, and the slope
    at one place is that of the few plants about a species' number there. So expectation and slopes
    are means over `stand_realisations` draws of plants and of the parameters about the estimate,
    the same at every step (statistical linearisation: Garcia-Fernandez et al. 2015): of the prior
    in the first round, then of the posterior. What such a line leaves of `scatter_draws` is the
    covariance; the stated errors of the data add to it. All sensors observe the same plants. Where
    plants are known every pixel counts (`Data.from_pixels`).

    Each band of a sensor is off by a factor, its gain times the model's error at its wavelength,
    whose logarithms have normal priors. They are parameters of the search beside those of the plot,
    with slopes in closed form, and the same model's error for all sensors; views of one camera
    share its gains, but for their drift. What the data ask beyond that is one number,
    `Calibration.excess`: after each round the variances of all errors are made so many times as
    large, so that intervals say what is known.

    The search looks at some of the pixels, with coarse light in layers twice as thick. What that
    lacks against full scenes at their own accuracy is measured at the start of each of the rounds,
    on the same plants, and added to its statistics; the covariances are renewed there too. Rounds
    after the first only correct; more than those of the settings follow while the last still moved.
    The estimate is the end of the last; of known plants the best of the start and the rounds by the
    full scenes.

    **Arguments:**

    - `model`: a problem, which has all that follows but `solver` and `start`; a scene; or a
      traceable function of the free parameters in their own units.
    - `data`: of a scene with the sensors that measured it (`Data.from_image` and the like).
    - `free`: the free parameters with their priors (`fx.free`, or a `ParameterSpace`).
    - `solver`: by default `fx.BroydenLM()` of a scene, one Jacobian a round, and with `renew=True`
      of a function; or a solver object of optimistix or jaxopt, which take one at each step, or as
      many gradients.
    - `max_steps`: most steps of the solver, of a scene in the first round; 30 by default.
    - `settings`: of a scene: plantings, rounds and light of the search, and its `max_steps`.
    - `error`: what the model of a scene is off by over wavelength, as of `Problem`; "learned" by
      default.
    - `start`: what an earlier fit found, to go on from there: parameters that it did not have start
      at their priors. Or whitened coordinates. By default the prior's centre.
    - `options`: of a function as `fit_function` takes them: `tolerance`, `offset`, `context`.

    **Returns:** `Calibration` of a scene, `FitResult` of a function; both print what they found.

    **Raises:** `InputError` for an argument of another type, for data of a scene without sensors,
    and for a start at which statistics are not finite.

    **Example:** a line through three points, whose offset and slope have wide priors.

    >>> import jax.numpy as jnp
    >>> import fynjax as fx
    >>> at = jnp.array([0.0, 1.0, 2.0])
    >>> data = fx.Data(("a", "b", "c"), jnp.array([1.0, 2.0, 3.0]), jnp.full(3, 0.1))
    >>> low, high, prior, sd = (jnp.full(2, v) for v in (-100.0, 100.0, 0.5, 10.0))
    >>> space = fx.ParameterSpace(("offset", "slope"), low, high, prior, sd)
    >>> line = fx.fit(lambda x: x[0] + x[1] * at, data, space)
    >>> line.estimate.round(2).tolist(), bool(line.converged)
    ([1.0, 1.0], True)
    """
    if isinstance(model, Problem):
        given = (data, free, max_steps, settings, error, options or None)
        if any(one is not None for one in given):
            raise InputError(
                "expected a problem alone: it has data, free parameters, error and settings"
            )
        return fit_plot(model, solver=solver, start=_place(start, model.free))
    if not isinstance(model, Scene) and not callable(model):
        raise InputError(f"expected a problem, a scene or a function, but got {model!r:.60}")
    check_asked(data, free)
    assert data is not None
    assert free is not None
    if not isinstance(model, Scene):
        if settings is not None or error is not None:
            raise InputError("expected `settings` or `error` with a scene, not with a function")
        steps = 30 if max_steps is None else max_steps
        with stage("Fit"):
            return fit_function(
                model, data, free, solver=solver, max_steps=steps,
                start=_place(start, free), **options,
            )  # fmt: skip
    if options:
        _check_options("fit", Problem, {"scene", "data", "free", "views"}, options)
    if settings is not None and max_steps is not None:
        raise InputError("expected `max_steps` or `settings`, which have their own, but got both")
    if settings is None:
        settings = CalibrationSettings(max_steps=30 if max_steps is None else max_steps)
    problem = Problem(
        model, data, free, error="learned" if error is None else error, settings=settings
    )
    return fit_plot(problem, solver=solver, start=_place(start, free))


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
        if found is not None and not np.isfinite(np.asarray(found)).all():
            raise InputError(f"expected a `start` of finite numbers, but got {found!r:.60}")
        return found
    if bool(eqx.tree_equal(found.space, space)):
        return found.whitened
    # Of an earlier fit of other parameters those that are free here again.
    known = dict(zip(found.names, found.estimate))
    values = [known.get(name, prior) for name, prior in zip(space.names, space.prior)]
    return jnp.clip(space.whitened(jnp.stack(values)), -_FARTHEST, _FARTHEST)


@double_precision
def sample(
    fitted: Calibration | FitResult | Problem,
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

    - `fitted`: from `fx.fit`; a problem is fitted first. Statistics of a scene are those of a
      quadratic surrogate, fitted to renders at draws of one and a half times the Laplace posterior.
    - `method`: "emcee", "nuts" or "laplace".
    - `predict`: the function that was fitted, where `fitted` is not of a scene.
    - `target`: effective draws to reach, on a chain longer than 50 autocorrelation times.
    - `max_steps`: of the chain, where to give up.
    - `chains`: walkers of the ensemble (32, or four a parameter) or chains of NUTS (4).
    - `seed`: of all random numbers.
    - `options`: as `fynjax.inversion.PosteriorSampler` has them: of emcee `moves`, and `backend`,
      such as "chain.h5", from which the same call goes on; of NUTS `warmup`; `batch`, `predictive`;
      of a function the `offset`, `context` and `log_prior` of its fit.

    **Returns:** `Posterior`; `inference_data()` is arviz', `sampler` emcee's.

    **Raises:** `InputError` as `PosteriorSampler`, for an option that it does not have, and for a
    fit of a function without that function.
    """
    options |= {"method": method, "target": target, "max_steps": max_steps, "chains": chains}
    own = {"predict", "data", "space", "start"}
    _check_options("sample", PosteriorSampler, own, options)
    if isinstance(fitted, Problem):
        fitted = fit(fitted)
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
    if predict is not None:
        raise InputError("expected `predict` with the fit of a function, not of a scene")
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

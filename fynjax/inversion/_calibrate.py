"""Calibrate a plot to what sensors measured of it."""

import dataclasses
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from fynjax._core.checkpoint import Journal, keep_nothing
from fynjax._core.errors import InputError
from fynjax.canopy import VoxelGrid
from fynjax.inversion._fit_result import Data, FitResult
from fynjax.inversion._log_posterior import Predict
from fynjax.inversion._search import End, Search, signature
from fynjax.inversion._space import ParameterSpace, make_space, match_names
from fynjax.inversion._views import AbstractView, ImageView, PlotForward
from fynjax.radiation import Accuracy
from fynjax.scene import PlotModel, PlotParameters, named_values, replant

COARSE = Accuracy(
    lattice=1,
    sublayers=1,
    coarsening=(3, 5),
    levels=2,
    azimuths=4,
    tolerance=1e-2,
    refine=False,
)
"""Accuracy of the light while a fit searches; what it lacks is corrected (`calibrate_plot`)."""


class Calibration(eqx.Module):
    """A calibrated plot."""

    fit: FitResult
    before: PlotParameters
    after: PlotParameters
    views: tuple[AbstractView, ...]
    """What each sensor yields, in the order of the statistics."""
    image_before: Float[Array, "band y x"] | None
    """None where no sensor is a drone's camera."""
    image_after: Float[Array, "band y x"] | None
    statistics_before: Float[Array, " statistic"]
    """Of the full model at full accuracy."""
    statistics_after: Float[Array, " statistic"]
    offset: Float[Array, " statistic"]
    """What the search's cheap model lacks against the full one, at the estimate."""
    data: Data
    """The targets, their errors grown by what other plantings change."""
    ends: "Ends"
    """Where the search ended from each start."""
    seconds: dict[str, float] = eqx.field(static=True)
    """Wall time of a full render, of a step of the search (a value and the gradient of every
    statistic, for least squares) and of the whole search, compilation included [s]."""


class Ends(eqx.Module):
    """Where a search ended from each of its starts, the first of which is the prior's centre."""

    objective: Float[np.ndarray, " start"]
    """Of the full model."""
    whitened: Float[np.ndarray, "start free"]
    apart: Float[np.ndarray, " start"]
    """Largest distance of a parameter from the best end [posterior sd]."""
    minima: int = eqx.field(static=True)
    """Ends that differ: in some parameter by more than its posterior standard deviation."""


def free_space(
    model: PlotModel,
    parameters: PlotParameters,
    free: Sequence[str],
    relative_sd: Callable[[str], float],
) -> ParameterSpace:
    """The free parameters of a plot by name pattern, such as `species.*.cover`.

    Parameters without effect (leaves of deadwood, the moisture of a soil and the aerosol of a sky
    that were given) and covers of zero, of species, char or rock, are left out. `relative_sd`
    gives the prior's standard deviation over its centre.
    """
    values = {k: float(v) for k, v in named_values(parameters, model.taxa).items()}
    chosen = [
        name
        for name in match_names(list(values), free)
        if not _without_effect(name, model, parameters)
    ]
    return make_space({n: values[n] for n in chosen}, {n: relative_sd(n) for n in chosen})


def _without_effect(name: str, model: PlotModel, parameters: PlotParameters) -> bool:
    for i, taxon in enumerate(model.taxa):
        if not name.startswith(f"species.{taxon}."):
            continue
        if float(parameters.species.cover[i]) == 0.0:
            return True
        leafless = float(parameters.species.leaf_area_index[i]) == 0.0
        of_leaves = (".leaf." in name, name.endswith(("leaf_area_index", "shoot_clumping")))
        return leafless and any(of_leaves)
    if name in ("ground.char_fraction", "ground.rock_fraction"):
        return float(getattr(parameters.ground, name.split(".")[1])) == 0.0
    given = {"ground.moisture": model.soil, "light.aerosol": model.diffuse}
    return given.get(name) is not None


def calibrate_plot(
    model: PlotModel,
    parameters: PlotParameters,
    data: Data,
    space: ParameterSpace,
    *,
    views: Sequence[AbstractView] | None = None,
    stride: int = 9,
    coarse: Accuracy = COARSE,
    rounds: int = 2,
    replants: int = 4,
    max_steps: int = 7,
    tolerance: float = 0.02,
    method: str = "least_squares",
    start: Float[Array, " free"] | None = None,
    starts: int = 1,
    seed: int = 0,
    checkpoint: str | Path | None = None,
    report: Callable[[str, float, float], None] | None = None,
) -> Calibration:
    """Calibrate the free parameters of a plot to what one or several sensors measured.

    The search looks at every `stride`-th pixel, with `coarse` light in layers twice as thick. What
    that lacks against the full model at its own accuracy is measured at the start of each
    of the `rounds` and added to its statistics, so that the estimate is one of the full model;
    rounds after the first only correct, in half as many steps. The estimate is the best of the
    start and the rounds by the full model's objective.

    Where exactly each plant stands nobody measured, and the model leaves it to chance. What that
    does to the statistics and their slopes is measured at the estimate on `replants` other
    plantings, and the uncertainty allows for it (`FitResult.marginal`); with 0 the image's plants
    count as standing where the model's do. All sensors see the same plants.

    **Arguments:**

    - `data`: the statistics of all views, one after the other (`join_data`).
    - `views`: what each sensor yields; left out, those statistics of a drone's image.
    - `method`, `max_steps`, `tolerance` and `start` are those of `fit`.
    - `starts`: searches, the others from draws of the prior (by `seed`); the best is kept, and
      `Calibration.ends` says how far they lie apart.
    - `checkpoint`: a folder that keeps every step. The same call goes on from it, and ends as if
      it had not been interrupted; `forget_journal` removes it.
    - `report`: called with the stage, the objective and its gradient's norm.

    Raises `InputError` for views that do not yield the data's statistics, a start at which these
    are not finite, and a checkpoint of another calibration.
    """
    for name, count in (("rounds", rounds), ("starts", starts)):
        if count < 1:
            raise InputError(f"`{name}` must be at least 1, but is {count}")
    views = (ImageView(data.names),) if views is None else tuple(views)
    yielded = tuple(name for view in views for name in view.names)
    if yielded != data.names:
        raise InputError(
            f"`views` must yield the statistics of `data` in their order, {data.names[:3]}..., but "
            f"yield {yielded[:3]}..."
        )
    free = len(space.names)
    first = jnp.zeros(free) if start is None else jnp.asarray(start, float)
    drawn = np.random.default_rng([seed, 61]).normal(size=(starts - 1, free)).clip(-2.0, 2.0)
    settings = (stride, rounds, replants, max_steps, tolerance, method, starts)
    journal = None
    if checkpoint is not None:
        signed = (model, parameters, data, space, views, coarse, first, drawn)
        journal = Journal(checkpoint, signature(signed, settings))
    search = Search(
        model, parameters, data, space, views, coarser(model, coarse), stride,
        journal or keep_nothing, report,
    )  # fmt: skip
    began = time.perf_counter()
    ends = [
        search.run(
            u, rounds, max_steps, tolerance, method, f"start {i + 1}, " if drawn.size else ""
        )
        for i, u in enumerate([first, *map(jnp.asarray, drawn)])
    ]
    best = min(ends, key=lambda end: end.objective)
    seconds = {"search_s": time.perf_counter() - began, "render_s": float("nan")}
    result, grown = best.fit, data
    if replants and np.isfinite(np.asarray(result.jacobian)).all():
        plantings = [replant(model, s) for s in range(1, replants + 1)]
        clock, done = time.perf_counter(), search.done
        looked = [search.look(best.plot, planted)[0] for planted in plantings]
        if search.done > done:
            seconds["render_s"] = (time.perf_counter() - clock) / (search.done - done)
        slopes = [search.slopes(best.u, replant(search.quick, s)) for s in range(1, replants + 1)]
        deviations = jnp.stack(looked) - best.statistics
        grown = data.with_scatter(deviations)
        result = result.marginal(deviations, jnp.stack(slopes))
    result = dataclasses.replace(
        result, loss=np.concatenate(best.losses), gradient_norm=np.concatenate(best.norms)
    )
    seconds["step_s"] = float(np.median(np.diff(search.times))) if len(search.times) > 1 else np.nan
    origin = ends[0]
    return Calibration(
        fit=result,
        before=origin.before,
        after=best.plot,
        views=views,
        image_before=origin.image_before,
        image_after=best.image,
        statistics_before=origin.statistics_before,
        statistics_after=best.statistics,
        offset=best.offset,
        data=grown,
        ends=_ends(ends, best, result),
        seconds=seconds,
    )


def _ends(ends: Sequence[End], best: End, result: FitResult) -> Ends:
    """How far the ends of a search lie apart, and how many are distinct."""
    sd = np.sqrt(np.diagonal(np.asarray(result.covariance)))
    places = np.stack([np.asarray(end.u) for end in ends])
    kept: list[np.ndarray] = []
    for i in np.argsort([end.objective for end in ends], kind="stable"):
        if all(np.max(np.abs(places[i] - other) / sd) > 1.0 for other in kept):
            kept.append(places[i])
    return Ends(
        objective=np.array([end.objective for end in ends]),
        whitened=places,
        apart=np.max(np.abs(places - np.asarray(best.u)) / sd, axis=1),
        minima=len(kept),
    )


def plot_statistics(
    parameters: PlotParameters,
    free: tuple[str, ...],
    statistics: tuple[str, ...],
    stride: int = 1,
) -> Predict:
    """The forward model of a plot: statistics of its image from the values of the parameters that
    `free` names, in their own units, and a `PlotModel`. The others are those of `parameters`.

    Every `stride`-th pixel is rendered. Differentiable; `model` is the `context` of `fit`.
    """
    return PlotForward(parameters, free, (ImageView(statistics, stride),))


def coarser(model: PlotModel, accuracy: Accuracy) -> PlotModel:
    """The model that a fit searches with: thick layers, blocks that divide the grid."""
    grid = model.grid
    nx, ny, nz = grid.shape
    thick = 2 if nz % 2 == 0 else 1
    high, wide = accuracy.coarsening or (2, 2)
    while nx % wide or ny % wide:
        wide -= 1
    while nz // thick % high:
        high -= 1
    return dataclasses.replace(
        model,
        grid=VoxelGrid((nx, ny, nz // thick), grid.horizontal_size, thick * grid.vertical_size),
        accuracy=dataclasses.replace(accuracy, coarsening=(high, wide)),
    )

"""Calibrate a plot to the statistics of an image."""

import dataclasses
import time
from collections.abc import Callable, Sequence
from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from fynjax._core.errors import InputError
from fynjax.canopy import VoxelGrid
from fynjax.inversion._fit import Forward, Predict, evaluate, fit
from fynjax.inversion._fit_result import Data, FitResult
from fynjax.inversion._space import ParameterSpace, make_space, match_names
from fynjax.metrics import image_statistics
from fynjax.radiation import Accuracy
from fynjax.scene import PlotModel, PlotParameters, named_values, replant, with_values

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
    image_before: Float[Array, "band y x"]
    image_after: Float[Array, "band y x"]
    statistics_before: Float[Array, " statistic"]
    """Of the full image at full accuracy."""
    statistics_after: Float[Array, " statistic"]
    offset: Float[Array, " statistic"]
    """What the search's cheap model lacks against the full one, at the estimate."""
    data: Data
    """The targets, their errors grown by what other plantings change."""
    seconds: dict[str, float] = eqx.field(static=True)
    """Wall time of a full render, of a step of the search (a value and the gradient of every
    statistic, for least squares) and of the whole search, compilation included [s]."""


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
    stride: int = 9,
    coarse: Accuracy = COARSE,
    rounds: int = 2,
    replants: int = 4,
    max_steps: int = 7,
    tolerance: float = 0.02,
    method: str = "least_squares",
    start: Float[Array, " free"] | None = None,
    report: Callable[[str, float, float], None] | None = None,
) -> Calibration:
    """Calibrate the free parameters of a plot to statistics of an image.

    The search renders every `stride`-th pixel, with `coarse` light in layers twice as thick. What
    that lacks against the full image at the model's own accuracy is measured at the start of each
    of the `rounds` and added to its statistics, so that the estimate is one of the full model;
    rounds after the first only correct, in half as many steps. The estimate is the best of the
    start and the rounds by the full model's objective.

    Where exactly each plant stands nobody measured, and the model leaves it to chance. What that
    does to the statistics and their slopes is measured at the estimate on `replants` other
    plantings, and the uncertainty allows for it (`FitResult.marginal`); with 0 the image's plants
    count as standing where the model's do.

    `method`, `max_steps`, `tolerance` and `start` are those of `fit`; `report` is called with the
    stage, the objective and its gradient's norm.
    """
    if rounds < 1:
        raise InputError(f"`rounds` must be at least 1, but is {rounds}")
    names = data.names
    quick = coarser(model, coarse)
    render = eqx.filter_jit(lambda m, p: _image_and_statistics(m, p, names))

    def full(values: PlotParameters, planted: PlotModel = model) -> tuple[Array, Array]:
        return jax.block_until_ready(render(planted, values))

    predict = plot_statistics(parameters, space.names, names, stride)
    forward = Forward(predict, space)
    u = jnp.zeros(len(space.names)) if start is None else start
    before = with_values(parameters, model.taxa, space.named(u))
    image_before, statistics_before = full(before)
    statistics = statistics_before
    seconds: dict[str, float] = {}
    losses, norms, times = [], [], []
    began = time.perf_counter()

    def note(turn: int, loss: float, norm: float) -> None:
        times.append(time.perf_counter())
        if report is not None:
            report(f"round {turn + 1}", loss, norm)

    def objective(u: Array, statistics: Array) -> float:
        rest = data.whiten(statistics - data.value)
        return 0.5 * float(rest @ rest + u @ u)

    best, chosen = objective(u, statistics), u
    result: FitResult | None = None
    after, image_after, statistics_after = before, image_before, statistics
    predicted, _ = evaluate(forward, data, u, (quick,))
    offset_chosen = offset_before = statistics - predicted
    for turn in range(rounds):
        offset = statistics - predicted
        found = fit(
            predict,
            data,
            space,
            method=method,
            max_steps=max_steps if turn == 0 else (max_steps + 1) // 2,
            tolerance=tolerance,
            start=u,
            offset=offset,
            forward=forward,
            context=(quick,),
            report=partial(note, turn),
        )
        u, predicted = found.whitened, found.predicted - offset
        plot = with_values(parameters, model.taxa, space.named(u))
        image, statistics = full(plot)
        losses.append(found.loss)
        norms.append(found.gradient_norm)
        # The quick model's best need not be the full model's.
        if objective(u, statistics) < best:
            best, result, after = objective(u, statistics), found, plot
            image_after, statistics_after, chosen = image, statistics, u
            offset_chosen = statistics - predicted
    if result is None:
        result = fit(
            predict, data, space, start=chosen, max_steps=1, offset=offset_before,
            forward=forward, context=(quick,),
        )  # fmt: skip
        status = "No step improved on the start; the estimate is the start."
        result = dataclasses.replace(result, status=status, converged=False)
    seconds["search_s"] = time.perf_counter() - began
    seconds["render_s"] = float("nan")
    grown = data
    if replants:
        plantings = range(1, replants + 1)
        clock = time.perf_counter()
        drawn = [full(after, replant(model, seed))[1] for seed in plantings]
        seconds["render_s"] = (time.perf_counter() - clock) / replants
        slopes = [evaluate(forward, data, chosen, (replant(quick, s),))[1] for s in plantings]
        deviations = jnp.stack(drawn) - statistics_after
        grown = data.with_scatter(deviations)
        result = result.marginal(deviations, jnp.stack(slopes))
    result = dataclasses.replace(
        result, loss=np.concatenate(losses), gradient_norm=np.concatenate(norms)
    )
    seconds["step_s"] = float(np.median(np.diff(times))) if len(times) > 1 else float("nan")
    return Calibration(
        result,
        before,
        after,
        image_before,
        image_after,
        statistics_before,
        statistics_after,
        offset_chosen,
        grown,
        seconds,
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

    def predict(values: Array, model: PlotModel) -> Array:
        named = {name: values[i] for i, name in enumerate(free)}
        plot = with_values(parameters, model.taxa, named)
        return image_statistics(model.image(plot, stride), statistics).astype(values.dtype)

    return predict


def _image_and_statistics(
    model: PlotModel, parameters: PlotParameters, names: tuple[str, ...]
) -> tuple[Array, Array]:
    image = model.image(parameters)
    return image, image_statistics(image, names).astype(float)


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

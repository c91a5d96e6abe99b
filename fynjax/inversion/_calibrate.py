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

from fynjax.inversion._fit import Data, FitResult, Forward, fit
from fynjax.inversion._space import ParameterSpace, make_space, match_names
from fynjax.metrics import image_statistics
from fynjax.radiation import Accuracy
from fynjax.scene import PlotModel, PlotParameters, named_values, with_values

COARSE = Accuracy(coarsening=(2, 4), tolerance=1e-3)
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
    seconds: dict[str, float] = eqx.field(static=True)
    """Wall time of a render, of a value and gradient, and of the search [s]."""


def free_space(
    model: PlotModel,
    parameters: PlotParameters,
    free: Sequence[str],
    relative_sd: Callable[[str], float],
) -> ParameterSpace:
    """The free parameters of a plot by name pattern, such as `species.*.cover`.

    Parameters without effect (leaves of deadwood, covers of zero) are left out. `relative_sd`
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
        return leafless and (".leaf." in name or name.endswith("leaf_area_index"))
    return name == "ground.moisture" and model.soil is not None


def calibrate_plot(
    model: PlotModel,
    parameters: PlotParameters,
    data: Data,
    space: ParameterSpace,
    *,
    stride: int = 4,
    coarse: Accuracy = COARSE,
    rounds: int = 2,
    max_steps: int = 5,
    tolerance: float = 0.02,
    method: str = "least_squares",
    start: Float[Array, " free"] | None = None,
    report: Callable[[str, float, float], None] | None = None,
) -> Calibration:
    """Calibrate the free parameters of a plot to statistics of an image.

    The search renders every `stride`-th pixel with `coarse` light. What that lacks against the
    full image at the model's own accuracy is measured at the start of each of the `rounds` and
    added to its statistics, so that the estimate is one of the full model; rounds after the first
    only correct, in two steps. `method`, `max_steps`, `tolerance` and `start` are those of
    `fit`; `report` is called with the stage, the objective and its gradient's norm.
    """
    names = data.names
    quick = dataclasses.replace(model, accuracy=_dividing(coarse, model))
    render = eqx.filter_jit(lambda m, p: _image_and_statistics(m, p, names))

    def full(values: PlotParameters) -> tuple[Array, Array]:
        return jax.block_until_ready(render(model, values))

    def predict(values: Array) -> Array:
        named = {name: values[i] for i, name in enumerate(space.names)}
        plot = with_values(parameters, model.taxa, named)
        return image_statistics(quick.image(plot, stride), names).astype(values.dtype)

    forward = Forward(predict, space)
    u = jnp.zeros(len(space.names)) if start is None else start
    before = with_values(parameters, model.taxa, space.named(u))
    image_before, statistics_before = full(before)
    seconds: dict[str, float] = {}
    statistics = statistics_before
    losses, norms = [], []
    began = time.perf_counter()
    result = None
    for turn in range(rounds):
        offset = statistics - forward.values(u)
        result = fit(
            predict,
            data,
            space,
            method=method,
            max_steps=max_steps if turn == 0 else 2,
            tolerance=tolerance,
            start=u,
            offset=offset,
            forward=forward,
            report=None if report is None else partial(report, f"round {turn + 1}"),
        )
        u = result.whitened
        after = with_values(parameters, model.taxa, space.named(u))
        image_after, statistics = full(after)
        losses.append(result.loss)
        norms.append(result.gradient_norm)
    seconds["search_s"] = time.perf_counter() - began
    assert result is not None
    result = dataclasses.replace(
        result, loss=np.concatenate(losses), gradient_norm=np.concatenate(norms)
    )
    seconds["render_s"] = _seconds(lambda: full(after))
    jax.block_until_ready(forward.misfit(u, data, offset))  # compiled, before it is timed
    seconds["value_and_gradient_s"] = _seconds(
        lambda: jax.block_until_ready(forward.misfit(u, data, offset))
    )
    seconds["search_render_s"] = _seconds(lambda: jax.block_until_ready(forward.values(u)))
    return Calibration(
        result, before, after, image_before, image_after, statistics_before, statistics, seconds
    )


def _image_and_statistics(
    model: PlotModel, parameters: PlotParameters, names: tuple[str, ...]
) -> tuple[Array, Array]:
    image = model.image(parameters)
    return image, image_statistics(image, names).astype(float)


def _dividing(accuracy: Accuracy, model: PlotModel) -> Accuracy:
    """The coarse accuracy with blocks that divide the model's grid."""
    nx, ny, nz = model.grid.shape
    high, wide = accuracy.coarsening
    while nx % wide or ny % wide:
        wide -= 1
    while nz % high:
        high -= 1
    return dataclasses.replace(accuracy, coarsening=(high, wide))


def _seconds(work: Callable[[], object]) -> float:
    began = time.perf_counter()
    work()
    return time.perf_counter() - began

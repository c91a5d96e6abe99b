"""The search of a calibration, from one start: a cheap scene, corrected by the full one."""

import dataclasses
import hashlib
import time
from collections.abc import Callable, Sequence
from functools import partial
from importlib.metadata import version
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from fynjax._core.checkpoint import Keep
from fynjax._core.errors import InputError
from fynjax.inversion._fit import evaluate, fit
from fynjax.inversion._fit_result import Data, FitResult, FitStatus
from fynjax.inversion._log_posterior import LogPosterior
from fynjax.inversion._space import ParameterSpace
from fynjax.inversion._views import AbstractView, PlotForward, look
from fynjax.radiation import Accuracy
from fynjax.scene import PlotParameters, Scene, with_values

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


@dataclasses.dataclass(frozen=True)
class CalibrationSettings:
    """How a calibration searches, and how far it allows for chance."""

    stride: int = 9
    """A search renders every so many pixels of a drone's image along each axis."""
    accuracy: Accuracy = COARSE
    """Of the light in a search."""
    rounds: int = 2
    """Searches one after the other, each corrected by the full scene."""
    stand_realisations: int = 4
    """Other plantings on which the effect of chance is measured; 0: the image's plants count as
    standing where the scene's do."""
    max_steps: int = 7
    """Most steps of the first round; those after have half as many."""
    tolerance: float = 0.02
    """As `fit` has it."""
    solver: Any = "least_squares"
    """As `fit` has it."""
    starts: int = 1
    """Searches, the others from draws of the prior; the best is kept."""
    seed: int = 0
    """Of those draws."""

    def __post_init__(self) -> None:
        for name in ("rounds", "starts"):
            if getattr(self, name) < 1:
                raise InputError(f"`{name}` must be at least 1, but is {getattr(self, name)}")


@dataclasses.dataclass
class End:
    """Where a search from one start ended, and what the full scene says there."""

    objective: float
    """Half the squared whitened misfit and distance from the prior."""
    u: Float[Array, " free"]
    fit: FitResult
    plot: PlotParameters
    image: Float[Array, "band y x"] | None
    statistics: Float[Array, " statistic"]
    offset: Float[Array, " statistic"]
    before: PlotParameters
    image_before: Float[Array, "band y x"] | None
    statistics_before: Float[Array, " statistic"]
    losses: list[np.ndarray]
    norms: list[np.ndarray]


class Search:
    """What the searches from all starts share: everything is compiled once."""

    def __init__(
        self,
        scene: Scene,
        parameters: PlotParameters,
        data: Data,
        space: ParameterSpace,
        views: Sequence[AbstractView],
        cheap: tuple[Scene, tuple[AbstractView, ...]],
        keep: Keep,
        report: Callable[[str, float, float], None] | None,
    ) -> None:
        self._scene, self._parameters, self._data, self._space = scene, parameters, data, space
        self._keep, self._report, self._views = keep, report, tuple(views)
        self.quick, cheap_views = cheap
        self._predict = PlotForward(parameters, space.names, cheap_views)
        self.times: list[float] = []
        """When each step ended that was not one of an earlier run [s]."""
        self.done = 0
        """Looks of the full scene that were not those of an earlier run."""

    def look(self, plot: PlotParameters, planted: Scene | None = None) -> tuple[Array, ...]:
        """Statistics of the full scene; and, without other plants, the images."""
        scene = self._scene if planted is None else planted

        def step() -> tuple[Array, ...]:
            found = jax.block_until_ready(look(self._views, scene, plot))
            return found if planted is None else found[:1]

        found = self._keep(step)
        self.done += not getattr(self._keep, "repeating", False)
        return found

    def slopes(self, u: Array, quick: Scene) -> Float[Array, "statistic free"]:
        """Derivatives of the cheap form's statistics, of the plot `quick`."""
        return self._evaluate(u, quick)[1]

    def _evaluate(self, u: Array, quick: Scene) -> tuple[Array, Array]:
        none = jnp.zeros_like(self._data.value)
        density = LogPosterior(self._predict, self._space, self._data, none, (quick,))
        return evaluate(density, u, self._keep)

    def _objective(self, u: Array, statistics: Array) -> float:
        rest = self._data.whiten(statistics - self._data.value)
        return 0.5 * float(rest @ rest + u @ u)

    def _plot(self, u: Array) -> PlotParameters:
        return with_values(self._parameters, self._scene.taxa, self._space.named(u))

    def _note(self, stage: str, loss: float, norm: float) -> None:
        if not getattr(self._keep, "repeating", False):
            self.times.append(time.perf_counter())
        if self._report is not None:
            self._report(stage, loss, norm)

    def run(self, u: Array, settings: CalibrationSettings, stage: str) -> End:
        """Search from `u`; `stage` begins the name of each round."""
        before = self._plot(u)
        statistics, *images = self.look(before)
        finite = np.isfinite(np.asarray(statistics))
        if not finite.all():
            raise InputError(
                f"the statistic {self._data.names[int(np.argmin(finite))]} is not finite at the "
                "start. Is the sun near the horizon, or a parameter at the end of its range?"
            )
        image = images[0] if images else None
        predicted = self._evaluate(u, self.quick)[0]
        losses: list[np.ndarray] = []
        norms: list[np.ndarray] = []
        best: dict[str, Any] = {
            "objective": self._objective(u, statistics), "u": u, "plot": before, "image": image,
            "statistics": statistics, "offset": statistics - predicted,
        }  # fmt: skip
        origin: dict[str, Any] = {
            "before": before,
            "image_before": image,
            "statistics_before": statistics,
        }
        offset_before, result = statistics - predicted, None
        common: dict[str, Any] = {"context": (self.quick,), "keep": self._keep}
        for turn in range(settings.rounds):
            offset = statistics - predicted
            found = fit(
                self._predict,
                self._data,
                self._space,
                solver=settings.solver,
                max_steps=settings.max_steps if turn == 0 else (settings.max_steps + 1) // 2,
                tolerance=settings.tolerance,
                start=u,
                offset=offset,
                report=partial(self._note, f"{stage}round {turn + 1}"),
                **common,
            )
            losses.append(np.asarray(found.loss))
            norms.append(np.asarray(found.gradient_norm))
            if not _finite(found):
                if result is not None:
                    found = dataclasses.replace(result, status=found.status)
                result = found
                break
            u, predicted = found.whitened, found.predicted - offset
            plot = self._plot(u)
            statistics, *images = self.look(plot)
            reached = self._objective(u, statistics)
            # The quick scene's best need not be the full scene's.
            if reached < best["objective"]:
                result = found
                best = {
                    "objective": reached, "u": u, "plot": plot,
                    "image": images[0] if images else None, "statistics": statistics,
                    "offset": statistics - predicted,
                }  # fmt: skip
        if result is None:
            result = fit(
                self._predict, self._data, self._space, start=best["u"], max_steps=1,
                offset=offset_before, **common,
            )  # fmt: skip
            result = dataclasses.replace(result, status=FitStatus.no_gain)
        return End(**best, **origin, fit=result, losses=losses, norms=norms)


def _finite(found: FitResult) -> bool:
    return all(np.isfinite(a).all() for a in (found.loss, found.predicted, found.jacobian))


def signature(signed: Any, settings: tuple[Any, ...]) -> str:
    """Differs where anything differs that a calibration follows from."""
    total = hashlib.sha256(f"{version('fynjax')} {settings}".encode())
    leaves, structure = jax.tree.flatten(signed)
    total.update(str(structure).encode())
    for leaf in leaves:
        total.update(np.ascontiguousarray(leaf).tobytes())
    return total.hexdigest()

"""The search of a calibration, from one start: a cheap scene, corrected by the full one."""

import dataclasses
import hashlib
import itertools
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
from fynjax.inversion._fit_result import Data, FitResult, FitStatus, fit_result
from fynjax.inversion._log_posterior import LogPosterior
from fynjax.inversion._space import ParameterSpace
from fynjax.inversion._views import AbstractView, PlotForward, look
from fynjax.radiation import Accuracy
from fynjax.scene import PlotParameters, Scene, room_needed, with_values

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


_SPARE = 1.5
"""Plants for which sites are made where a species has too few, as a factor on those asked for."""
_MOST_GROWTHS = 1
"""Rounds added to a search because its plants needed more sites. Each is compiled anew."""


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
        form: Callable[[Scene], tuple[Scene, tuple[AbstractView, ...]]],
        grow: Callable[[Float[np.ndarray, " species"]], Scene] | None,
        keep: Keep,
        report: Callable[[str, float, float], None] | None,
    ) -> None:
        self.scene, self._parameters, self._data, self._space = scene, parameters, data, space
        self._keep, self._report, self._views = keep, report, tuple(views)
        self._form, self._grow = form, grow
        self.quick, cheap_views = form(scene)
        self._predict = PlotForward(parameters, space.names, cheap_views)
        self.times: list[float] = []
        """When each step ended that was not one of an earlier run [s]."""
        self.done = 0
        """Looks of the full scene that were not those of an earlier run."""

    def look(self, plot: PlotParameters, planted: Scene | None = None) -> tuple[Array, ...]:
        """Statistics of the full scene; and, without other plants, the images."""
        scene = self.scene if planted is None else planted

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
        none = jnp.zeros(self._data.value.shape)
        density = LogPosterior(self._predict, self._space, self._data, none, (quick,))
        return evaluate(density, u, self._keep)

    def _objective(self, u: Array, statistics: Array) -> float:
        rest = self._data.whiten(statistics - self._data.value)
        return 0.5 * float(rest @ rest + u @ u)

    def _plot(self, u: Array) -> PlotParameters:
        return with_values(self._parameters, self.scene.taxa, self._space.named(u))

    def _short(self, counts: Float[np.ndarray, " species"]) -> bool:
        """Whether some species has fewer sites than `counts` of its plants need."""
        return bool(room_needed(self.scene, self._parameters, counts).any())

    def _grown(self, plot: PlotParameters) -> bool:
        """Whether more sites had to be made for the plants of `plot`, and could be."""
        counts = np.asarray(self.scene.counts(plot))
        short = room_needed(self.scene, self._parameters, counts) > 0.0
        if self._grow is None or not short.any():
            return False
        try:
            larger = self._grow(np.where(short, _SPARE * counts, counts))
        except InputError:  # no room on the plot, or in memory
            return False
        self.scene = larger
        self.quick, _ = self._form(larger)
        return True

    def _note(self, stage: str, loss: float, norm: float) -> None:
        if not getattr(self._keep, "repeating", False):
            self.times.append(time.perf_counter())
        if self._report is not None:
            self._report(stage, loss, norm)

    def run(self, u: Array, settings: CalibrationSettings, stage: str) -> End:
        """Search from `u`; `stage` begins the name of each round."""
        before = self._plot(u)
        self._grown(before)
        statistics, *images = self.look(before)
        finite = np.isfinite(np.asarray(statistics))
        if not finite.all():
            raise InputError(
                f"the statistic {self._data.names[int(np.argmin(finite))]} is not finite at the "
                "start. Is the sun near the horizon, or a parameter at the end of its range?"
            )
        image = images[0] if images else None
        predicted, jacobian = self._evaluate(u, self.quick)
        begin = fit_result(
            self._space, self._data, u, statistics, jacobian, FitStatus.no_gain, 0, np.empty((0, 2))
        )
        origin: dict[str, Any] = {
            "before": before,
            "image_before": image,
            "statistics_before": statistics,
        }
        best: dict[str, Any] = {
            "objective": self._objective(u, statistics), "u": u, "plot": before, "image": image,
            "statistics": statistics, "offset": statistics - predicted, "fit": begin,
        }  # fmt: skip
        losses: list[np.ndarray] = []
        norms: list[np.ndarray] = []
        turns = settings.rounds
        for turn in itertools.count():
            if turn == turns:
                break
            offset = statistics - predicted
            result = fit(
                self._predict,
                self._data,
                self._space,
                solver=settings.solver,
                max_steps=settings.max_steps if turn == 0 else (settings.max_steps + 1) // 2,
                tolerance=settings.tolerance,
                start=u,
                offset=offset,
                report=partial(self._note, f"{stage}round {turn + 1}"),
                context=(self.quick,),
                keep=self._keep,
                known=(statistics, jacobian),
            )
            losses.append(np.asarray(result.loss))
            norms.append(np.asarray(result.gradient_norm))
            if bool(result.status == FitStatus.not_finite):
                break
            u, predicted, jacobian = result.whitened, result.predicted - offset, result.jacobian
            plot = self._plot(u)
            statistics, *images = self.look(plot)
            best_was_short = self._short(np.asarray(self.scene.counts(best["plot"])))
            if turns < settings.rounds + _MOST_GROWTHS and self._grown(plot):
                # What was reached may have had fewer plants than it asked for: go on from there.
                turns += 1
                statistics, *images = self.look(plot)
                predicted, jacobian = self._evaluate(u, self.quick)
                result = fit_result(
                    self._space, self._data, u, statistics, jacobian, FitStatus.no_gain, 0,
                    np.empty((0, 2)),
                )  # fmt: skip
                if best_was_short:
                    best["objective"] = np.inf
            reached = self._objective(u, statistics)
            # The quick scene's best need not be the full scene's.
            if reached < best["objective"]:
                best = {
                    "objective": reached, "u": u, "plot": plot,
                    "image": images[0] if images else None, "statistics": statistics,
                    "offset": statistics - predicted, "fit": result,
                }  # fmt: skip
            elif bool(result.converged) and _same(u, best["u"], settings.tolerance):
                best["fit"] = dataclasses.replace(best["fit"], status=result.status)
        return End(**best, **origin, losses=losses, norms=norms)


def _same(u: Array, other: Array, tolerance: float) -> bool:
    """Whether coordinates agree to the tolerance at which a search ends."""
    return bool(jnp.all(jnp.abs(u - other) <= tolerance * (1.0 + jnp.abs(other))))


def signature(*signed: Any) -> str:
    """A hash of all that a calibration follows from.

    It is the same in every process, and differs where a type, an array, a number, a text or a
    function within `signed` does. Functions are known by their names and what they close over.

    **Arguments:** `signed`, any values; modules, dataclasses and containers are taken apart.

    **Returns:** 64 hexadecimal digits.
    """
    total = hashlib.sha256()
    entered: set[int] = set()

    def add(value: Any) -> None:
        total.update(f"|{type(value).__module__}.{type(value).__qualname__}:".encode())
        if isinstance(value, jax.Array | np.ndarray):
            array = np.ascontiguousarray(value)
            total.update(f"{array.dtype}{array.shape}".encode() + array.tobytes())
            return
        parts = _parts(value)
        if parts is None:
            total.update(repr(value).encode())
        elif id(value) not in entered:  # a function may close over itself
            entered.add(id(value))
            total.update(f"{len(parts)}".encode())
            for part in parts:
                add(part)
            entered.remove(id(value))

    add((version("fynjax"), signed))
    return total.hexdigest()


def _parts(value: Any) -> Sequence[Any] | None:
    """What a value is made of; None for a number, a text and the like, which `repr` shows whole."""
    if isinstance(value, list | tuple):
        return value
    if isinstance(value, set | frozenset):
        return sorted(value, key=repr)
    if isinstance(value, dict):
        return [*value.keys(), *value.values()]
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return [getattr(value, field.name, None) for field in dataclasses.fields(value)]
    if isinstance(value, partial):
        return [value.func, value.args, value.keywords]
    if callable(value):
        cells = getattr(value, "__closure__", None) or ()
        names = [getattr(value, name, "") for name in ("__module__", "__qualname__")]
        return [*names, *(cell.cell_contents for cell in cells)]
    return list(vars(value).items()) if hasattr(value, "__dict__") else None

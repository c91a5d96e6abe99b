"""The search of a calibration: rounds over coarse scenes, each corrected by whole ones."""

import dataclasses
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import optimistix as optx
import scipy.linalg
from jaxtyping import Array, Float, Int

from fynjax._core.errors import InputError
from fynjax._core.least_squares import NO_TAGS, BroydenLM, BroydenState, figures_of
from fynjax._core.math import symmetric_power
from fynjax._core.precision import double_precision
from fynjax._core.progress import advance
from fynjax.canopy import VoxelGrid
from fynjax.inversion._data import Data
from fynjax.inversion._expected import (
    Expected,
    chance_covariance,
    is_new,
    mean_information,
    of_thread,
    other_plantings,
    plants_wanted,
    unit_draw,
    with_error,
)
from fynjax.inversion._factors import BandFactors, PlotSpace
from fynjax.inversion._fit_result import FitStatus, number_of
from fynjax.inversion._problem import COARSE, Problem
from fynjax.inversion._solvers import run_solver, solver_kind
from fynjax.inversion._views import (
    AbstractView,
    BandView,
    Directions,
    FlightView,
    ImagesView,
    PlotForward,
    informative_directions,
    look,
    together,
    under_sun,
)
from fynjax.radiation import Accuracy
from fynjax.scene import (
    PlotParameters,
    Scene,
    element_count,
    fitted_accuracy,
    room_needed,
    with_values,
)

_SPARE = 1.5
"""Plants for which sites are made where a species has too few, as a factor on those asked for."""
_MOST_ROWS = 24
"""Slopes of an image's statistics are taken along so many directions of the parameters at most, of
the frames of a flight together along twice as many; and along those of factors."""
_FEW = 100
"""Coordinates by which slopes of all statistics of a flight are taken, at most."""
_PRIOR_DRAWS = 60
"""Draws of the prior by which these are chosen."""
_SETTLED = 0.6
"""Further rounds follow while a round moved farther than this along a principal direction, or a
step still would [posterior standard deviations]; one that moved less keeps the errors of its
start."""
_FURTHER = 5
"""Rounds beyond those of the settings, at most."""


_TRUSTED = 10.0
"""Data from which the stated errors count as found, when the data ask for larger ones."""


def excess_of(misfit: float, degrees: int) -> float:
    """Factor on the variances of all errors that a chi-square `misfit` of so many `degrees` asks
    for, at least 1 [-]: the scale of an inverse chi-square distribution whose prior is the stated
    errors, as if they had been found from `_TRUSTED` data (Gelman et al. 2013, Bayesian Data
    Analysis, section 2.6)."""
    if not np.isfinite(misfit):
        return 1.0
    return max(1.0, (misfit + _TRUSTED) / (degrees + _TRUSTED))


class SearchPlace(eqx.Module):
    """What full and coarse scenes say about one place, over plantings and what is unknown of the
    parameters."""

    u: Float[Array, " coordinate"]
    """Whitened coordinates of the parameters, then of the factors of the bands."""
    spread: Float[Array, "coordinate coordinate"]
    """Root of the covariance of what is unknown of the parameters where factors are given, in
    whitened coordinates; zeros for the factors, which are multiplied exactly: what statistics do
    about them is no chance."""
    statistics: Float[Array, " statistic"]
    """Expected statistics of the full scene."""
    covariance: Float[Array, "statistic statistic"]
    """Covariance of the errors of statistics by plantings, and by how statistics bend with the
    parameters."""
    excess: Float[Array, ""]
    """Factor on the variances of all errors of statistics: what the data ask beyond those that were
    stated, 1 or more [-]."""
    offset: Float[Array, " statistic"]
    """Expected statistics of the full scene less those of the coarse form."""
    slopes: Float[Array, "member statistic coordinate"]
    """Derivatives of the statistics by the coordinates, of each member of the search."""
    whole: Float[Array, "planting statistic"]
    """Statistics of the full form of some plantings, at `u` itself; of a round that has settled,
    where it began."""
    lack: Float[Array, "planting statistic"]
    """Statistics `whole` less those of the coarse form of the same plants."""
    images: tuple[Float[Array, "band y x"], ...]
    """Images of the scene's own plants in the full form, without factors, and spectra as images of
    one pixel: of each sensor with bands."""

    @property
    def slope(self) -> Float[np.ndarray, "statistic coordinate"]:
        """Mean of the slopes over the members."""
        return np.asarray(self.slopes).mean(axis=0)


class Subspace(eqx.Module):
    """Directions along which slopes are taken, of the statistics of each view (`Directions`)."""

    rows: tuple[Float[Array, "_direction _statistic"], ...]
    back: tuple[Float[Array, "_statistic _direction"], ...]

    @property
    def parts(self) -> list[Directions]:
        """The directions of each view."""
        return [*map(Directions, self.rows, self.back)]


class Progress(eqx.Module):
    """Progress of a search: the state of its present round, and records of all rounds."""

    u: Float[Array, " coordinate"]
    """Whitened coordinates that the round has come to."""
    descent: BroydenState
    """State of the solver at `u`, with the errors of this round."""
    trace: Float[Array, "evaluation 2"]
    """Objective and norm of its gradient where each round began and after each of its steps."""
    rounds: Int[Array, " evaluation"]
    """The round of each, from 1."""
    steps: Int[Array, ""]
    """Steps of all rounds."""
    status: Int[Array, ""]
    """Number of the `FitStatus`."""
    turn: Int[Array, ""]
    """Rounds that have ended."""
    step: Int[Array, ""]
    """Steps of this round."""
    ended: Int[Array, ""]
    """1 where the search has ended."""


class SearchState(Progress):
    """Where a search stands: all that another process needs to go on from here."""

    place: SearchPlace
    """The place where the round began, whose errors and offset hold all through the round."""
    origin: SearchPlace
    """The place of the start itself, with nothing unknown of the parameters."""
    best: SearchPlace
    """The place that is kept, of which `status` is: the end of the last round, or without
    expectation over plantings the best of start and rounds."""
    subspace: Subspace
    """Informative subspace of the statistics."""
    wanted: Float[Array, " species"]
    """Plants for which sites were made; zeros: those of the scene suffice."""
    turns: Int[Array, ""]
    """Rounds that are to be done."""


class Expectation(eqx.Module):
    """The density that a round of a search climbs, for a solver that goes through it by itself: as
    a `LogPosterior`, of expected statistics, with the factors of the bands after the parameters."""

    expected: Expected
    """Statistics of the coarse form over the plantings of the search."""
    spread: Float[Array, "coordinate coordinate"]
    """Root of the covariance of what is unknown of parameters and factors, in whitened
    coordinates."""
    offset: Float[Array, " statistic"]
    """Statistics of full scenes less those of the coarse form, which are added to the latter."""
    data: Data
    """The targets, with the errors at the start of the round."""

    def statistics(self, u: Float[Array, " coordinate"]) -> Float[Array, " statistic"]:
        """Expected statistics at whitened coordinates."""
        return self.expected.members(u, self.spread) + self.offset

    def jacobian(
        self, u: Float[Array, " coordinate"]
    ) -> tuple[Float[Array, " statistic"], Float[Array, "statistic coordinate"]]:
        """Expected statistics and their mean slopes."""
        return self.statistics(u), self.expected.slopes(u, self.spread).mean(axis=0)

    def __call__(self, u: Float[Array, " coordinate"]) -> Float[Array, ""]:
        """Logarithm of the density, up to a constant."""
        rest = self.data.whiten(self.statistics(u) - self.data.value)
        return -0.5 * (rest @ rest + u @ u)


_run_compiled = eqx.filter_jit(run_solver)


def search_states(search: Any, state: Any, name: str = "") -> Iterator[Any]:
    """The states of a search from one of them, which is the first, to its end.

    Each evaluation is a step of the open stage of `fynjax.progress`.

    **Arguments:**

    - `search`: a `PlotSearch` or a `PixelSearch`.
    - `state`: as its `begin` or an earlier `step` gave it.
    - `name`: stands before the round where progress is shown.
    """
    shown = 0
    while True:
        for loss, norm in np.asarray(state.trace)[shown:]:
            where = f"{name}round {int(state.turn) + 1}"
            advance(stage=where, loss=f"{loss:.1f}", gradient=f"{norm:.1f}")
        shown = len(state.trace)
        yield state
        if state.ended:
            return
        state = search.step(state)


class PlotSearch:
    """Search of a calibration from one start, step by step.

    `begin` gives the state at a start, `step` the next one until `state.ended`; `fit` runs it. Who
    watches, keeps or stops a search does so between the steps (`search_states`). What is compiled
    is shared by all starts.

    **Arguments:** `problem`, and `solver` as of `fit`. One of optimistix or jaxopt goes through a
    whole round at once; the default, `BroydenLM`, takes a step at a time.

    **Raises:** `InputError` for what is no solver.
    """

    state = SearchState

    @double_precision
    def __init__(self, problem: Problem, solver: Any = None) -> None:
        scene, parameters, space = problem.scene, problem.scene.parameters, problem.free
        settings, data, error = problem.settings, problem.measured.bare(), problem.error
        if scene.known_plants:
            settings = dataclasses.replace(settings, stand_realisations=0)
        self.problem = problem
        self.data, self.views, self.settings = data, problem.views, settings
        self.space = PlotSpace(space, BandFactors.of(self.views, error))
        self.signed = (
            scene, parameters, data, self.space, self.views, settings, solver,
        )  # fmt: skip
        """All that its steps follow from, besides where it starts."""
        # A Broyden solver, which needs no slopes at its steps, goes step by step; any other
        # (`_solver`) through a round at once.
        self._own, self._solver = BroydenLM(atol=settings.tolerance), solver
        if solver is not None and solver_kind(solver) == "broyden":
            least = min(float(solver.atol), settings.tolerance)
            self._own, self._solver = dataclasses.replace(solver, atol=least), None
        self._scene, self._parameters = scene, parameters
        form = search_form(
            scene, parameters, self.views, stride=settings.stride, accuracy=settings.accuracy
        )
        self._predict = PlotForward(parameters, space.names, together(form[1]))
        self._planted: tuple[bytes, tuple[Scene, ...], tuple[Scene, ...]] | None = None

    # -- plantings --------------------------------------------------------------------------

    def _stands(
        self, wanted: Array | np.ndarray, *, ahead: bool = False
    ) -> tuple[tuple[Scene, ...], tuple[Scene, ...]]:
        """Plantings with sites for so many plants of each species, in full and in coarse form.
        Where a search goes on from here (`ahead`), its programs are compiled meanwhile."""
        wanted = np.asarray(wanted)
        if self._planted is None or self._planted[0] != wanted.tobytes():
            counts = wanted if wanted.any() else None
            own = self._scene if counts is None else self._scene.realisation(0, counts)
            first = coarser(own, self._parameters)
            pool = ThreadPoolExecutor(2)  # XLA compiles without Python's lock
            try:
                for call in self._first_calls(own, first) if ahead else ():
                    pool.submit(*call)
                numbers = range(1, max(self.settings.stand_realisations, 1))
                others = other_plantings(self._scene, numbers, counts)
            except BaseException:
                pool.shutdown(wait=False, cancel_futures=True)
                raise
            pool.shutdown()
            coarse = (first, *(coarser(stand, self._parameters) for stand in others))
            self._planted = wanted.tobytes(), (own, *others), coarse
        return self._planted[1], self._planted[2]

    def _first_calls(self, own: Scene, coarse: Scene) -> Iterator[tuple[Any, ...]]:
        """Calls by which the programs of a search that are new are compiled."""
        u = jnp.zeros(self.space.size)
        one = Expected(self._predict, self._predict, self.space, (coarse,), 0, 1)
        calls: list[tuple[Any, ...]] = [(self._look, own, u), (one.at, coarse, u)]
        if len(self.data.names) <= _MOST_ROWS:
            calls.append((one.slope_at, coarse.expected(), u))
        for function, *args in calls:
            if is_new(function, *args):
                yield of_thread(function), *args

    @double_precision
    def scene(self, state: SearchState) -> Scene:
        """The scene, with the sites that the search needed."""
        return self._stands(state.wanted)[0][0]

    @double_precision
    def stands(self, state: SearchState) -> tuple[Scene, ...]:
        """The plantings of the search, in the coarse form."""
        return self._stands(state.wanted)[1]

    @property
    @double_precision
    def coarse_views(self) -> tuple[AbstractView, ...]:
        """What each sensor yields of the plantings of the search."""
        return self._predict.views

    @double_precision
    def expected(self, state: SearchState) -> Expected:
        """Statistics over the plantings of a state."""
        return self._expected(state.wanted, state.subspace)

    def _expected(self, wanted: Array | np.ndarray, subspace: Subspace | None = None) -> Expected:
        """Statistics over plantings, whose slopes are taken along a `subspace`, if one is known."""
        _, coarse = self._stands(wanted)
        settings = self.settings
        count = settings.stand_realisations
        number = max(settings.scatter_draws, count) if count else 1
        along = self._predict
        if subspace is not None:
            views = tuple(
                view.along(own)
                if isinstance(view, ImagesView) and len(own.rows) < len(view.names)
                else view
                for view, own in zip(along.views, subspace.parts, strict=True)
            )
            along = dataclasses.replace(along, views=views)
        return Expected(self._predict, along, self.space, coarse, settings.seed, number)

    def _short(self, u: Array, wanted: np.ndarray, draws: int) -> np.ndarray:
        """Plants for which sites must be made at `u` and at draws of the prior about it; `wanted`
        where there are enough, or where no more can be made."""
        normals = [unit_draw(self.settings.seed, i, self.space) for i in range(draws)]
        # The place itself first, then where the search may come to.
        places = jnp.stack([u, *(u + jnp.asarray(normal) for normal in normals)])
        counts = np.asarray(plants_wanted(self._scene, self._parameters, self.space, places))
        scene = self._stands(wanted)[0][0] if wanted.any() else self._scene
        short = room_needed(scene, self._parameters, counts) > 0.0
        if not short.any():
            return wanted
        most = counts.max(axis=0)
        # Some to spare, lest the next steps ask for new sites again.
        more = np.where(short, np.maximum(_SPARE * counts[0], most), most)
        more = np.maximum(more, wanted)  # what has grown stays
        try:
            self._stands(more, ahead=True)
        except InputError:  # no room on the plot, or in memory
            return wanted
        return more

    # -- the informative subspace -----------------------------------------------------------

    def _subspace(self, expected: Expected, origin: SearchPlace) -> Subspace:
        """The directions along which slopes of the many statistics of an image are taken, by their
        errors at `origin`, what factors change there, and draws of the prior; else the statistics
        themselves."""
        most = [_MOST_ROWS * (1 + isinstance(v, FlightView)) for v in self._predict.views]
        # Of a flight all slopes are known where parameters are few: one pass for each of these.
        many = [
            isinstance(v, ImagesView)
            and len(v.names) > own
            and not (isinstance(v, FlightView) and self.space.size <= _FEW)
            for v, own in zip(self._predict.views, most, strict=True)
        ]
        draws = expected.prior_draws(_PRIOR_DRAWS) if any(many) else np.empty(0)
        covariance, parts, start = np.asarray(self.data_at(origin).covariance), [], 0
        by_factors = self._by_factors(origin) if any(many) else np.empty(0)
        for view, own, reduced in zip(self._predict.views, most, many, strict=True):
            part = slice(start, start := start + len(view.names))
            every = jnp.eye(len(view.names))
            parts.append(
                informative_directions(
                    draws[:, part], covariance[part, part], by_factors[part], own
                )
                if reduced
                else Directions(every, every)
            )
        return Subspace(tuple(own.rows for own in parts), tuple(own.back for own in parts))

    def _by_factors(self, place: SearchPlace) -> Float[np.ndarray, "statistic coordinate"]:
        """Slopes of all statistics at `place` by whitened coordinates of the factors of bands."""
        slopes, images = [], iter(place.images)
        for view in self.views:
            if isinstance(view, BandView):
                slopes.append(np.asarray(_factor_slopes(view, next(images)), float))
            else:
                slopes.append(np.zeros((len(view.names), 0)))
        return np.asarray(scipy.linalg.block_diag(*slopes) @ self.space.factors.root)

    # -- what a place says ------------------------------------------------------------------

    @double_precision
    def plot(self, u: Array) -> PlotParameters:
        """The parameters at whitened coordinates."""
        return with_values(self._parameters, self._scene.taxa, self.space.named(u))

    def _look(self, stand: Scene, u: Array) -> tuple[Array, ...]:
        """Statistics and images of a stand in its full form."""
        factors = self.space.factors
        free = len(self.space.plot.names)
        logarithms = factors.logarithms(u[free:]) if factors.coordinates else None
        return look(self.views, stand, self.plot(u), logarithms)

    def _observe(
        self,
        expected: Expected,
        wanted: np.ndarray,
        u: Array,
        spread: np.ndarray,
        slopes: Float[np.ndarray, "member statistic coordinate"],
        rendered: SearchPlace | None = None,
        draws: int | None = None,
    ) -> SearchPlace:
        """The full scene about `u`: expectation over plantings and `spread`, and the errors there.

        What the mean `slopes` do not explain of draws is their error and how statistics bend. It
        counts with the plants' chance. Full renders at the same `u` are taken over from `rendered`.
        `draws` are fewer than those of the settings.
        """
        u = jnp.asarray(u)
        if rendered is None:
            stands = self._stands(wanted)[0][: self.settings.full_renders]
            every = [self._look(stand, u) for stand in stands]
            # What coarse renders lack, of the same plants: chance cancels in the difference.
            whole = np.stack([np.asarray(one[0]) for one in every])
            images = tuple(every[0][1:])
            lack = whole - expected.plain(u, expected.stands[: len(whole)])
        else:
            whole, lack = np.asarray(rendered.whole), np.asarray(rendered.lack)
            images = rendered.images
        rest = expected.residues(u, spread, slopes.mean(axis=0), draws)
        statistics = rest.mean(axis=0) + lack.mean(axis=0)
        covariance = np.zeros((len(self.data.names),) * 2)
        if self.settings.stand_realisations:
            kinds = [name for view in self.views for name in view.names]
            chance = chance_covariance(rest, lack, len(expected.stands), kinds)
            covariance = covariance + chance
        # Steps of a round see stands in expectation, of few draws; the offset makes up for both.
        offset = statistics - np.asarray(expected.members(u, spread))
        array = jnp.asarray
        return SearchPlace(
            u, array(spread), array(statistics), array(covariance), array(1.0),
            array(offset), array(slopes), array(whole), array(lack), images,
        )  # fmt: skip

    @double_precision
    def data_at(self, place: SearchPlace) -> Data:
        """The targets with the errors at a place."""
        found = with_error(self.data, np.asarray(place.covariance))
        return found.widened(float(place.excess))

    @double_precision
    def weights(
        self, place: SearchPlace, subspace: Subspace
    ) -> Float[np.ndarray, "direction statistic"]:
        """Makes of misfits independent ones of unit size, along the directions of the subspace."""
        rows = scipy.linalg.block_diag(*map(np.asarray, subspace.rows))
        # Errors of the combinations that count; their inverse Cholesky factor whitens them.
        covariance = rows @ np.asarray(self.data_at(place).covariance) @ rows.T
        return np.asarray(np.linalg.solve(np.linalg.cholesky(covariance), rows))

    @double_precision
    def objective(self, place: SearchPlace, weights: np.ndarray) -> float:
        """Half the squared whitened misfit and distance from the prior at a place."""
        rest = self._whitened(weights, np.asarray(place.statistics), place.u)
        return 0.5 * float(rest @ rest)

    def _whitened(self, weights: np.ndarray, statistics: np.ndarray, u: Array) -> np.ndarray:
        misfit = weights @ (statistics - np.asarray(self.data.value))
        return np.concatenate([misfit, np.asarray(u)])

    # -- the search -------------------------------------------------------------------------

    @double_precision
    def begin(self, u: Float[Array, " some"], after: SearchState | None = None) -> SearchState:
        """The state at whitened coordinates `u`.

        **Arguments:** `u`, of the parameters alone, whose factors are then one, or of both; and the
        end of another start, whose sites and informative subspace this one shares.

        **Raises:** `InputError` where a statistic is not finite there.
        """
        u, free = self.space.whole(u), self.space.size
        none = np.zeros((free, free))
        chance = self.settings.stand_realisations
        draws = max(self.settings.scatter_draws, chance) if chance else 0
        sites = np.zeros(len(self._scene.taxa)) if after is None else np.asarray(after.wanted)
        wanted = self._short(u, sites, draws)
        self._stands(wanted, ahead=True)
        expected = self._expected(wanted)
        # First with parameters as they are, and without slopes: its errors choose the subspace,
        # which needs fewer draws where all statistics are kept.
        flat = np.zeros((1, len(self.data.names), free))
        few = min(2 * chance, draws) if chance and len(self.data.names) <= _MOST_ROWS else None
        origin = self._observe(expected, wanted, u, none, flat, draws=few)
        finite = np.isfinite(np.asarray(origin.statistics))
        if not finite.all():
            raise InputError(
                f"the statistic {self.data.names[int(np.argmin(finite))]} is not finite at the "
                "start. Is the sun near the horizon, or a parameter at the end of its range?"
            )
        subspace = self._subspace(expected, origin) if after is None else after.subspace
        expected = self._expected(wanted, subspace)
        # Then over the prior, whose covariance is one in whitened coordinates.
        spread = np.diag(np.arange(free) < len(self.space.plot.names)).astype(float)
        spread = spread if chance else none
        slopes = np.asarray(expected.slopes(u, spread))
        place = self._observe(expected, wanted, u, spread, slopes, origin)
        descent = self._descent(place, subspace)
        whole = lambda number: jnp.asarray(number, int)  # noqa: E731
        return SearchState(
            place=place, u=u, descent=descent, origin=origin, best=place, subspace=subspace,
            wanted=jnp.asarray(wanted), trace=figures_of(descent)[None], rounds=whole([1]),
            steps=whole(0), status=number_of(FitStatus.no_gain), turn=whole(0),
            turns=whole(self.settings.rounds), step=whole(0), ended=whole(0),
        )  # fmt: skip

    def _descent(self, place: SearchPlace, subspace: Subspace) -> BroydenState:
        """State of the solver at the start of a round, with the slopes and errors there."""
        weights = self.weights(place, subspace)
        residual = self._whitened(weights, np.asarray(place.statistics), place.u)
        jacobian = np.concatenate([weights @ place.slope, np.eye(place.u.size)])
        return begun(self._own, place.u, residual, jacobian)

    @double_precision
    def step(self, state: SearchState) -> SearchState:
        """The next state: one step of the solver, or the end of a round and the full scenes there.

        Each step corrects the slopes by what it changed: new ones cost as much as twenty renders of
        each draw.
        """
        solver = self._own
        done, result = solver.terminate(None, state.u, None, None, state.descent, NO_TAGS)
        most = self.settings.max_steps
        # Rounds after the first only correct.
        most = most if state.turn == 0 else (most + 1) // 2
        # A number is not finite: the place before this step is the last of use.
        if result != optx.RESULTS.successful:
            failed = number_of(FitStatus.not_finite)
            return dataclasses.replace(state, status=failed, ended=state.ended + 1)
        if done or state.step >= most:
            status = FitStatus.successful if done else FitStatus.max_steps
            return self._next_round(state, status)
        if self._solver is not None:
            weights = self.weights(state.place, state.subspace)
            expectation = Expectation(
                self.expected(state), state.place.spread, state.place.offset,
                self.data.along(weights),
            )  # fmt: skip
            most = self.settings.max_steps  # the same program in every round
            u, reason, steps = _run_compiled(self._solver, expectation, state.u, most)
            reached = dataclasses.replace(state, u=u, steps=state.steps + steps)
            return self._next_round(reached, reason)
        expected, place = self.expected(state), state.place
        weights = self.weights(place, state.subspace)

        def whitened(u: Array, _: Any) -> tuple[Array, None]:
            reached = expected.members(u, place.spread) + place.offset
            return jnp.asarray(self._whitened(weights, np.asarray(reached), u)), None

        return stepped(solver, state, whitened)

    def _next_round(self, state: SearchState, status: Any) -> SearchState:
        """The place that a round has come to, and whether another one follows."""
        settings, before = self.settings, state.place
        u, turn, turns = state.u, int(state.turn) + 1, int(state.turns)
        spread = np.zeros_like(before.spread)
        if settings.stand_realisations:
            # Over the posterior that the slopes of this round say, about the new place.
            weights = self.weights(before, state.subspace)
            free = len(self.space.plot.names)
            spread[:free, :free] = posterior_root(weights, np.asarray(before.slopes)[..., :free])
        wanted = self._short(u, np.asarray(state.wanted), 0)
        grown = not np.array_equal(wanted, np.asarray(state.wanted))
        if grown:  # it had fewer plants than it asked for: go on from there, once more at most
            turns = min(max(turns, turn + 1), settings.rounds + 1)
        expected = self._expected(wanted, state.subspace)
        slopes = np.asarray(before.slopes)
        moved = np.asarray(u - before.u)
        # The last round moves little: its end keeps the slopes of its start, and where it has
        # settled the errors and the offset too.
        settled = turn == turns and not grown and self._settled(state, moved, status)
        if settled:
            reached = expected.members(u, before.spread) + before.offset
            images = self._look(self._stands(wanted)[0][0], u)[1:]
            place = dataclasses.replace(before, u=u, statistics=reached, images=images)
        else:
            if turn < turns or grown:
                slopes = np.asarray(expected.slopes(u, spread))
            place = self._observe(expected, wanted, u, spread, slopes)
        if not np.isfinite(np.asarray(place.statistics)).all():  # what was found before stays
            return dataclasses.replace(state, u=before.u, ended=state.ended + 1)
        place = self._asked(place, state.subspace)
        descent = self._descent(place, state.subspace)
        # The round kept its slopes, and the expectation is now over another spread.
        left = unsettled(np.asarray(descent.residual), np.asarray(descent.jacobian), moved)
        if turn == turns and left > _SETTLED:
            if turns < settings.rounds + _FURTHER:
                turns += 1
                slopes = np.asarray(expected.slopes(u, spread))
                rendered = None if settled else place
                place = self._observe(expected, wanted, u, spread, slopes, rendered)
                place = self._asked(place, state.subspace)
                descent = self._descent(place, state.subspace)
            elif bool(status == FitStatus.successful):
                status = FitStatus.max_rounds
        best, reason = self._better(state, place, status, fresh=grown)
        goes_on = turn < turns
        whole = lambda number: jnp.asarray(number, int)  # noqa: E731
        ended = dataclasses.replace(
            state, place=place, u=u, descent=descent, best=best, wanted=jnp.asarray(wanted),
            status=jnp.asarray(reason), turn=whole(turn), turns=whole(turns),
            step=whole(0), ended=whole(not goes_on),
        )  # fmt: skip
        return recorded(ended) if goes_on else ended

    @double_precision
    def misfit(self, state: SearchState) -> float:
        """Squared misfit by the stated errors, along the directions that count, and squared
        distance from the prior, at the place that is kept."""
        stated = dataclasses.replace(state.place, excess=jnp.asarray(1.0))
        return 2.0 * self.objective(state.best, self.weights(stated, state.subspace))

    def _least_misfit(self, place: SearchPlace, subspace: Subspace) -> float:
        """The same where a Gauss-Newton step from a place would end: what another step would still
        take away is no error of the data. NaN where a slope is."""
        stated = dataclasses.replace(place, excess=jnp.asarray(1.0))
        weights = self.weights(stated, subspace)
        rest = self._whitened(weights, np.asarray(place.statistics), place.u)
        rows = np.concatenate([weights @ place.slope, np.eye(place.u.size)])
        if not (np.isfinite(rest).all() and np.isfinite(rows).all()):
            return float("nan")
        basis, _ = np.linalg.qr(rows)
        return float(rest @ rest - np.sum((basis.T @ rest) ** 2))

    def _asked(self, place: SearchPlace, subspace: Subspace) -> SearchPlace:
        """A place with the `excess` of its errors (`excess_of`)."""
        found = excess_of(self._least_misfit(place, subspace), sum(map(len, subspace.rows)))
        return dataclasses.replace(place, excess=jnp.asarray(found))

    def _settled(self, state: SearchState, moved: np.ndarray, status: Any) -> bool:
        """Whether a round after the first has converged and moved so little that expectations over
        plantings have the errors of its start."""
        if self._solver is not None or not self.settings.stand_realisations or state.turn == 0:
            return False
        descent = state.descent
        left = unsettled(np.asarray(descent.residual), np.asarray(descent.jacobian), moved)
        return bool(status == FitStatus.successful) and left <= _SETTLED

    def _better(
        self, state: SearchState, place: SearchPlace, status: Any, *, fresh: bool
    ) -> tuple[SearchPlace, Array]:
        """The place that is kept, and the number of its status."""
        reason = number_of(status)
        if fresh or self.settings.stand_realisations:
            # An expectation over a spread of its own compares with no other.
            return place, reason
        weights = self.weights(place, state.subspace)
        if self.objective(place, weights) < self.objective(state.best, weights):
            return place, reason
        same = np.abs(np.asarray(place.u - state.best.u)) <= self.settings.tolerance * (
            1.0 + np.abs(np.asarray(state.best.u))
        )
        settled = same.all() and bool(status == FitStatus.successful)
        return state.best, reason if settled else state.status


_factor_slopes = eqx.filter_jit(lambda view, image: view.factor_slopes(image))


def begun(
    solver: BroydenLM, u: Array, residual: Array | np.ndarray, jacobian: Array | np.ndarray
) -> BroydenState:
    """State of the solver at `u`, where residual and Jacobian are known."""
    known = jnp.asarray(residual), jnp.asarray(jacobian)
    return solver.init(None, u, None, {"jacobian": lambda *_: known}, None, None, NO_TAGS)


def stepped(solver: BroydenLM, state: Any, residual: Callable[[Array, Any], Any]) -> Any:
    """The state of a search after one step of the solver on a function of whitened coordinates."""
    u, descent, _ = solver.step(residual, state.u, None, None, state.descent, NO_TAGS)
    return recorded(
        dataclasses.replace(state, u=u, descent=descent, step=state.step + 1, steps=state.steps + 1)
    )


def recorded(state: Any) -> Any:
    """The state of a search, with its objective in the trace."""
    return dataclasses.replace(
        state,
        trace=jnp.concatenate([state.trace, figures_of(state.descent)[None]]),
        rounds=jnp.concatenate([state.rounds, state.turn[None] + 1]),
    )


def posterior_root(
    weights: Float[np.ndarray, "direction statistic"],
    slopes: Float[np.ndarray, "member statistic coordinate"],
) -> Float[np.ndarray, "coordinate coordinate"]:
    """Root of the covariance of the posterior in whitened coordinates, by what the mean of the
    slopes of several draws says. `weights` make of misfits independent ones of unit size."""
    # Data and prior add their information, the prior one in every direction.
    return symmetric_power(np.eye(slopes.shape[-1]) + mean_information(weights, slopes), -0.5)


def unsettled(residual: np.ndarray, jacobian: np.ndarray, moved: np.ndarray) -> float:
    """The distance that a round `moved`, or that a Gauss-Newton step from where it ended would
    move, along the principal direction where it is largest [posterior standard deviations]."""
    hessian = jacobian.T @ jacobian
    if not np.isfinite(hessian).all():
        return np.inf
    values, vectors = np.linalg.eigh(hessian)
    # Along an eigenvector a posterior standard deviation is 1 / sqrt(eigenvalue).
    moves = np.stack([moved, np.linalg.solve(hessian, jacobian.T @ residual)])
    return float(np.max(np.abs(moves @ vectors) * np.sqrt(values)))


@double_precision
def search_form(
    scene: Scene,
    parameters: PlotParameters,
    views: Sequence[AbstractView],
    *,
    stride: int | None = None,
    accuracy: Accuracy = COARSE,
) -> tuple[Scene, tuple[AbstractView, ...]]:
    """Scene and views that a fit searches with: thick layers, and coarse forms of the views.

    **Arguments:**

    - `scene`, `parameters`: the plot.
    - `views`: what each sensor yields of `scene`.
    - `stride`: every so many pixels of a drone's image are rendered along each axis; None: pixels
      a voxel apart.
    - `accuracy`: of the light.

    **Returns:** the scene, and the views of it.
    """
    quick = coarser(scene, parameters)
    fitted = [
        fitted_accuracy(accuracy, quick, under_sun(parameters, getattr(view, "sun", None)))
        for view in views
    ]
    each = zip(views, fitted, strict=True)
    return quick, tuple(view.for_search(scene, own, stride) for view, own in each)


@double_precision
def coarser(scene: Scene, parameters: PlotParameters) -> Scene:
    """The `scene` in layers of twice the thickness, where their number is even, evenly filled.

    Its plants have no more area elements than such voxels resolve, in `parameters` of the plot.
    """
    grid = scene.grid
    nx, ny, nz = grid.shape
    thick = 2 if nz % 2 == 0 else 1
    sizes = zip(
        np.asarray(parameters.species.diameter), np.asarray(parameters.species.height), strict=True
    )
    layer = thick * grid.vertical_size
    most = [element_count(d, h, grid.horizontal_size, layer=layer) for d, h in sizes]
    return dataclasses.replace(
        scene,
        planting=scene.planting.thinned(most) if scene.finer else scene.planting,
        planted=None,
        grid=VoxelGrid((nx, ny, nz // thick), grid.horizontal_size, layer),
        finer=0,
    )

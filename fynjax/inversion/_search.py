"""The search of a calibration, from one start: cheap scenes of several plantings and draws of the
parameters, corrected by whole ones."""

import dataclasses
import hashlib
import time
from collections.abc import Callable, Sequence
from functools import partial
from importlib.metadata import version
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import scipy.linalg
from jaxtyping import Array, Float

from fynjax._core.checkpoint import Keep
from fynjax._core.errors import InputError
from fynjax.inversion._descent import Descended, descend, objective_of, unsettled
from fynjax.inversion._fit import predicted_statistics, statistics_and_jacobian
from fynjax.inversion._fit_result import (
    Data,
    FitResult,
    FitStatus,
    fit_result,
    repeated_information,
    scatter_covariance,
)
from fynjax.inversion._log_posterior import LogPosterior
from fynjax.inversion._space import ParameterSpace
from fynjax.inversion._views import (
    AbstractView,
    ImageView,
    PlotForward,
    informative_directions,
    look,
    radiometric_covariance,
)
from fynjax.radiation import Accuracy
from fynjax.scene import PlotParameters, Scene, room_needed, stand_realisation, with_values

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

    stride: int | None = None
    """A search renders every so many pixels of a drone's image along each axis; None: pixels that
    lie a voxel apart."""
    accuracy: Accuracy = COARSE
    """Of the light in a search."""
    rounds: int = 2
    """Searches one after the other, each corrected by the full scene; up to three more follow while
    the last still moved."""
    stand_realisations: int = 8
    """Draws of the plants and of what is unknown of the parameters over which statistics and slopes
    are expectations, better an even number; 0: the image's plants count as standing where the
    scene's do, and slopes are those at one place."""
    scatter_draws: int = 48
    """Such draws from which the covariance of the statistics is estimated; those after the first
    `stand_realisations` fill the sites of these in another order."""
    full_renders: int = 2
    """Plantings on which what the cheap form lacks is measured, at most `stand_realisations`."""
    max_steps: int = 30
    """Most steps of the first round; those after have half as many."""
    tolerance: float = 0.05
    """A round ends where another step would lower the objective by less than this, which is half a
    squared distance in posterior standard deviations."""
    starts: int = 1
    """Searches, the others from draws of the prior; the best is kept."""
    seed: int = 0
    """Of those draws, and of those that choose directions of many statistics."""

    def __post_init__(self) -> None:
        for name in ("rounds", "starts", "max_steps", "full_renders"):
            if getattr(self, name) < 1:
                raise InputError(f"`{name}` must be at least 1, but is {getattr(self, name)}")
        if self.stand_realisations < 0 or self.stand_realisations == 1:
            raise InputError(
                f"`stand_realisations` must be 0 or at least 2, but is {self.stand_realisations}"
            )
        if self.stand_realisations and self.scatter_draws < 3:
            raise InputError(
                f"`scatter_draws` must be at least 3, but is {self.scatter_draws}: a covariance "
                "needs some"
            )


_SPARE = 1.5
"""Plants for which sites are made where a species has too few, as a factor on those asked for."""
_MOST_ROWS = 24
"""Slopes of an image's statistics are taken along so many directions at most."""
_PRIOR_DRAWS = 60
"""Draws of the prior by which these are chosen."""
_SETTLED = 0.6
"""Further rounds follow while a round moved farther than this along a principal direction, or a
step still would [posterior standard deviations]."""
_FURTHER = 3
"""Rounds beyond those of the settings, at most."""
FARTHEST = 2.2
"""Of a draw of a parameter from its mean [standard deviations]."""

Replant = Callable[[int, Float[np.ndarray, " species"] | None], Scene]
"""Makes the scene with the plants of a number's chance, 0 being the scene's own, and sites for so
many plants of each species, or as many as the scene has."""


class Draw(NamedTuple):
    """Plants, and a place of the parameters."""

    stand: Scene
    """In the cheap form."""
    normal: Float[np.ndarray, " free"]
    """Independent unit normal numbers, from which the place is made."""


@dataclasses.dataclass
class Observed:
    """What the full scene says about one place, over plantings and what is unknown of the
    parameters."""

    u: Float[Array, " free"]
    plot: PlotParameters
    image: Float[Array, "band y x"] | None
    """Of the scene's own plants."""
    statistics: Float[np.ndarray, " statistic"]
    """Their expectation."""
    spread: Float[np.ndarray, "free free"]
    """Makes what is unknown of the parameters of unit normal numbers."""
    offset: Float[np.ndarray, " statistic"]
    """What the cheap form's mean over the draws of the search lacks."""
    data: Data
    """With the errors of plantings, of slopes and of the camera's gains about this place."""
    weights: Float[np.ndarray, "direction statistic"]
    """Makes of misfits independent ones of unit size, along the directions that count."""
    rendered: tuple[np.ndarray, list[Array], np.ndarray]
    """Statistics of the full form of some stands at the place itself, the images of the first,
    and what the cheap form of the same plants lacks."""


@dataclasses.dataclass
class End:
    """Where a search from one start ended, and what the full scene says there."""

    objective: float
    """Half the squared whitened misfit and distance from the prior."""
    fit: FitResult
    reached: Observed
    origin: Observed
    stands: list[Scene]
    """Those of the search, in the cheap form."""
    cheap: Float[np.ndarray, "stand statistic"]
    """Their statistics there, of plants that fade."""
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
        replant: Replant | None,
        settings: CalibrationSettings,
        keep: Keep,
        report: Callable[[str, float, float], None] | None,
    ) -> None:
        self.scene, self._parameters, self._data, self._space = scene, parameters, data, space
        self._keep, self._report, self._views = keep, report, tuple(views)
        self._form, self._replant, self._settings = form, replant, settings
        _, cheap_views = form(scene)
        self._predict = PlotForward(parameters, space.names, cheap_views)
        self._none = jnp.zeros(data.value.shape)
        """No offset of the statistics."""
        self._along: PlotForward | None = None
        """The same with slopes along the most informative directions of many statistics."""
        self.rows: Float[np.ndarray, "direction statistic"] | None = None
        """These directions, of all views; None: every statistic counts for itself."""
        self.projector = np.eye(len(data.names))
        """Keeps of statistics what lies along them."""
        self._wanted: Float[np.ndarray, " species"] | float = 0.0
        """Plants for which sites were made."""
        self.times: list[float] = []
        """When each step ended that was not one of an earlier run [s]."""
        self.cheap: list[Scene] = []
        """The stands in the cheap form."""

    def plant(self, u: Array) -> None:
        """Plant the stands of the search, with sites for what `u` and the draws of the prior about
        it need."""
        drawn = self._settings.stand_realisations
        normals = [self._normal(i) for i in range(self._most)] if drawn else []
        if self._grown(u, normals) or self.cheap:
            return
        try:
            self._stand(None)
        except InputError:  # another chance finds no room: the same sites in another order
            self._replant = None
            self._stand(None)

    @property
    def _most(self) -> int:
        """Draws in all."""
        settings = self._settings
        count = settings.stand_realisations
        return max(settings.scatter_draws, count) if count else 1

    def _stand(self, counts: Float[np.ndarray, " species"] | None) -> None:
        """Plant the stands over which expectations are taken."""
        settings = self._settings
        count = max(settings.stand_realisations, 1)
        if self._replant is None:
            others = [stand_realisation(self.scene, i) for i in range(1, count)]
        else:
            others = [self._replant(i, counts) for i in range(1, count)]
        stands = [self.scene, *others]
        self._stands = stands[: settings.full_renders]
        self.cheap = [self._form(stand)[0] for stand in stands]
        self._draws = [self._draw(i) for i in range(self._most)]
        self._members = [d._replace(stand=d.stand.faded()) for d in self._draws[:count]]
        """Those that each step of the search and its slopes are means over. Their plants fade, so
        that the mean is smooth; what it differs by from that of whole plants is in the offset."""

    def _draw(self, number: int) -> Draw:
        """A draw of plants and parameters."""
        count = len(self.cheap)
        stand = self.cheap[number % count]
        if number >= count:
            stand = stand_realisation(stand, number)  # no number of a stand of the search
        return Draw(stand, self._normal(number))

    def _normal(self, number: int) -> Float[np.ndarray, " free"]:
        """Where a draw's parameters are. Two in a row are opposite, so that what is linear in these
        leaves a mean as it is."""
        random = np.random.default_rng([self._settings.seed, 83, number // 2])
        normal = random.normal(size=len(self._space.names)).clip(-FARTHEST, FARTHEST)
        return normal if number % 2 == 0 else -normal

    # -- evaluations ------------------------------------------------------------------------

    def _density(self, cheap: Scene, predict: PlotForward | None = None) -> LogPosterior:
        predict = self._predict if predict is None else predict
        return LogPosterior(predict, self._space, self._data, self._none, (cheap,))

    def _cheap(
        self, u: Array, spread: np.ndarray, draws: Sequence[Draw]
    ) -> Float[np.ndarray, "draw statistic"]:
        """Statistics of the cheap form of each draw about `u`."""

        def step() -> tuple[Array, ...]:
            every = [
                predicted_statistics(self._density(d.stand), u + jnp.asarray(spread @ d.normal))
                for d in draws
            ]
            return (jnp.stack(every),)

        return np.asarray(self._keep(step)[0])

    def _slopes(self, u: Array, spread: np.ndarray) -> Float[np.ndarray, "member statistic free"]:
        """Derivatives of the cheap form's statistics, of each member about `u`.

        Their mean is the slope of the linear model that is best for all of `spread`, not only at
        `u` (statistical linearisation): which plants come next at `u` is chance, and over what is
        unknown beforehand statistics bend.
        """

        def step() -> tuple[Array, ...]:
            every = [
                statistics_and_jacobian(
                    self._density(d.stand, self._along), u + jnp.asarray(spread @ d.normal)
                )[1]
                for d in self._members
            ]
            return (jnp.stack(every),)

        return np.asarray(self._keep(step)[0])

    def _whole(self, plot: PlotParameters) -> tuple[np.ndarray, list[Array]]:
        """Statistics of the full form of some stands [stand, statistic]; images of the first."""

        def step() -> tuple[Array, ...]:
            every = [look(self._views, stand, plot) for stand in self._stands]
            return jax.block_until_ready((jnp.stack([one[0] for one in every]), *every[0][1:]))

        began = time.perf_counter()
        statistics, *images = self._keep(step)
        if not getattr(self._keep, "repeating", False):
            self.render_s = (time.perf_counter() - began) / len(self._stands)
        return np.asarray(statistics), images

    render_s = float("nan")
    """Wall time of the last full render [s]."""

    def _plot(self, u: Array) -> PlotParameters:
        return with_values(self._parameters, self.scene.taxa, self._space.named(u))

    def observe(
        self,
        u: Array,
        spread: np.ndarray,
        slopes: Float[np.ndarray, "statistic free"],
        rendered: tuple[np.ndarray, list[Array], np.ndarray] | None = None,
    ) -> Observed:
        """The full scene about `u`: expectation over plantings and `spread`, and the errors there.

        What the mean `slopes` do not explain of draws is their error and how statistics bend. It
        counts with the plants' chance.
        """
        u, plot = jnp.asarray(u), self._plot(u)
        own = len(self._members)
        if rendered is None:
            whole, images = self._whole(plot)
            rendered = whole, images, whole - self._plain(u, self.cheap[: len(whole)])
        whole, images, lack = rendered
        drawn = self._cheap(u, spread, self._draws)
        moves = np.stack([spread @ d.normal for d in self._draws])
        rest = drawn - moves @ slopes.T if np.isfinite(slopes).all() else drawn
        finite = np.isfinite(rest).all(axis=1)
        if finite.sum() >= own:  # of some draws a statistic may be undefined
            rest = rest[finite | (np.arange(len(rest)) < own)]
        statistics = rest.mean(axis=0) + lack.mean(axis=0)
        covariance = radiometric_covariance(self._views, images)
        if self._settings.stand_realisations:
            covariance = covariance + chance_covariance(rest, lack, len(self.cheap))
        data = with_error(self._data, covariance)
        offset = statistics - self._cheap(u, spread, self._members).mean(axis=0)
        image = images[0] if images else None
        weights = self._weights(data)
        return Observed(u, plot, image, statistics, spread, offset, data, weights, rendered)

    def _plain(self, u: Array, stands: Sequence[Scene]) -> Float[np.ndarray, "stand statistic"]:
        """Statistics of `stands` in the cheap form at `u` itself."""
        free = len(self._space.names)
        draws = [Draw(stand, np.zeros(free)) for stand in stands]
        return self._cheap(u, np.eye(free), draws)

    def _weights(self, data: Data) -> Float[np.ndarray, "direction statistic"]:
        rows = np.eye(len(data.names)) if self.rows is None else self.rows
        covariance = rows @ np.asarray(data.covariance) @ rows.T
        return np.asarray(np.linalg.solve(np.linalg.cholesky(covariance), rows))

    def choose_directions(self, data: Data) -> None:
        """Choose the directions of many statistics along which slopes are taken, by the errors of
        `data` and draws of the prior."""
        views: list[AbstractView] = []
        rows: list[np.ndarray] = []
        kept: list[np.ndarray] = []
        draws = covariance = None
        start = 0
        for view in self._predict.views:
            part = slice(start, start + len(view.names))
            start = part.stop
            if isinstance(view, ImageView) and len(view.names) > _MOST_ROWS:
                if draws is None or covariance is None:
                    draws, covariance = self._prior_draws(), np.asarray(data.covariance)
                chosen = informative_directions(draws[:, part], covariance[part, part], _MOST_ROWS)
                view = dataclasses.replace(view, directions=chosen)
                rows.append(np.asarray(chosen.rows))
                kept.append(np.asarray(chosen.back @ chosen.rows))
            else:
                rows.append(np.eye(len(view.names)))
                kept.append(np.eye(len(view.names)))
            views.append(view)
        self._along = dataclasses.replace(self._predict, views=tuple(views))
        if draws is not None:
            self.rows = scipy.linalg.block_diag(*rows)
            self.projector = scipy.linalg.block_diag(*kept)

    def _prior_draws(self) -> Float[np.ndarray, "draw statistic"]:
        """Statistics of the cheap form at draws of the prior, each with other plants."""
        draws = [self._draw(1000 + i) for i in range(_PRIOR_DRAWS)]
        free = len(self._space.names)
        drawn = self._cheap(jnp.zeros(free), np.eye(free), draws)
        return drawn[np.isfinite(drawn).all(axis=1)]

    # -- the descent ------------------------------------------------------------------------

    def _descend(
        self, begin: Observed, slopes: np.ndarray, most: int, stage: str
    ) -> tuple[np.ndarray, Any, list[tuple[float, float]]]:
        """Levenberg-Marquardt from `begin` with the errors and the mean `slopes` there.

        Each step corrects the slopes by what it changed (Broyden 1965): new ones cost as much as
        twenty renders of each draw.

        **Returns:** the end, why it ended, and the objective and its gradient's norm after each
        step.
        """
        trace: list[tuple[float, float]] = []

        def expected(u: np.ndarray) -> np.ndarray:
            reached = self._cheap(jnp.asarray(u), begin.spread, self._members)
            return reached.mean(axis=0) + begin.offset

        end = descend(
            expected,
            # The statistics at the start are those of the full scene: the mean over all draws.
            Descended(
                np.asarray(begin.u, float),
                np.asarray(begin.statistics),
                np.array(slopes),
                FitStatus.max_steps,
            ),
            np.asarray(begin.data.value),
            begin.weights,
            most=most,
            tolerance=self._settings.tolerance,
            note=lambda loss, norm: self._note(trace, stage, loss, norm),
        )
        return end.u, end.status, trace

    def _note(self, trace: list[tuple[float, float]], stage: str, loss: float, norm: float) -> None:
        trace.append((loss, norm))
        if not getattr(self._keep, "repeating", False):
            self.times.append(time.perf_counter())
        if self._report is not None:
            self._report(stage, loss, norm)

    def _grown(self, u: Array, normals: Sequence[np.ndarray] = ()) -> bool:
        """Whether more sites had to be made for the plants at `u` and of draws of the prior about
        it, and could be."""
        places = jnp.stack([u, *(u + jnp.asarray(normal) for normal in normals)])
        counts = np.asarray(plants_wanted(self.scene, self._parameters, self._space, places))
        before = self.scene
        short = room_needed(self.scene, self._parameters, counts) > 0.0
        if self._replant is None or not short.any():
            return False
        most = counts.max(axis=0)
        wanted = np.where(short, np.maximum(_SPARE * counts[0], most), most)
        wanted = np.maximum(wanted, self._wanted)  # what has grown stays
        try:
            self.scene = self._replant(0, wanted)
            self._stand(wanted)
            self._wanted = wanted
        except InputError:  # no room on the plot, or in memory
            self.scene = before
            return False
        return True

    def _spread(self, place: Observed, slopes: np.ndarray) -> np.ndarray:
        """Makes draws of the posterior, by the errors and slopes of the `place`, of unit normal
        numbers; none where the plants are known."""
        if not self._settings.stand_realisations:
            return np.zeros_like(place.spread)
        information = _information(place.weights, slopes)
        values, vectors = np.linalg.eigh(information)
        return np.asarray((vectors / np.sqrt(1.0 + np.maximum(values, 0.0))) @ vectors.T)

    def run(self, u: Array, stage: str) -> End:
        """Search from `u`; `stage` begins the name of each round."""
        settings = self._settings
        free = len(self._space.names)
        none = np.zeros((free, free))
        prior = np.eye(free) if settings.stand_realisations else none
        self.plant(u)
        origin = self.observe(u, none, np.zeros((len(self._data.names), free)))
        finite = np.isfinite(origin.statistics)
        if not finite.all():
            raise InputError(
                f"the statistic {self._data.names[int(np.argmin(finite))]} is not finite at the "
                "start. Is the sun near the horizon, or a parameter at the end of its range?"
            )
        if self._along is None:
            self.choose_directions(origin.data)
        slopes = self._slopes(u, prior)
        places = [self.observe(u, prior, slopes.mean(axis=0), origin.rendered)]
        ends = [(slopes, FitStatus.no_gain)]
        losses: list[np.ndarray] = []
        norms: list[np.ndarray] = []
        turn, turns = 0, settings.rounds
        target = np.asarray(self._data.value)
        while turn < turns:
            most = settings.max_steps if turn == 0 else (settings.max_steps + 1) // 2
            reached, status, trace = self._descend(
                places[-1], slopes.mean(axis=0), most, f"{stage}round {turn + 1}"
            )
            losses.append(np.array([loss for loss, _ in trace]))
            norms.append(np.array([norm for _, norm in trace]))
            if status == FitStatus.not_finite:
                ends[-1] = (ends[-1][0], status)
                break
            begun = u
            u, spread = jnp.asarray(reached), self._spread(places[-1], slopes)
            grown = self._grown(u)
            if grown:
                places, ends = [], []  # what was of other stands compares with nothing
                # It had fewer plants than it asked for: go on from there, once more at most.
                turns = min(max(turns, turn + 2), settings.rounds + 1)
            turn += 1
            # The last round moves little: its end keeps the slopes of its start.
            if turn < turns or grown:
                slopes = self._slopes(u, spread)
            place = self.observe(u, spread, slopes.mean(axis=0))
            # The round kept its slopes, and the expectation is now over another spread.
            end, misfit = np.asarray(u), place.statistics - target
            left = unsettled(
                place.weights, end, end - np.asarray(begun), misfit, slopes.mean(axis=0)
            )
            if turn == turns and left > _SETTLED:
                if turns < settings.rounds + _FURTHER:
                    turns += 1
                    slopes = self._slopes(u, spread)
                    place = self.observe(u, spread, slopes.mean(axis=0), place.rendered)
                else:
                    status = FitStatus.max_steps
            places.append(place)
            ends.append((slopes, status))
        if settings.stand_realisations:
            # Each is an expectation over a spread of its own, which compares with no other.
            sound = [i for i, place in enumerate(places) if np.isfinite(place.statistics).all()]
            places, ends = [places[sound[-1]]], [ends[sound[-1]]]
        return self._end(origin, places, ends, losses, norms)

    def _end(
        self,
        origin: Observed,
        places: list[Observed],
        ends: list[tuple[np.ndarray, Any]],
        losses: list[np.ndarray],
        norms: list[np.ndarray],
    ) -> End:
        """The best of the places, which are of one spread, by the errors at the last."""
        data, weights = places[-1].data, places[-1].weights
        # The same likelihood for whoever goes on with these data: along the directions alone.
        counted = data.along(weights)
        objective = [
            objective_of(weights, np.asarray(p.u), p.statistics - np.asarray(data.value))
            for p in places
        ]
        best = int(np.argmin(np.nan_to_num(objective, nan=np.inf)))
        slopes, status = ends[best]
        last, final = places[-1], ends[-1][1]
        if bool(final == FitStatus.successful) and _same(
            last.u, places[best].u, self._settings.tolerance
        ):
            status = final
        place = places[best]
        trace = np.stack([np.concatenate(losses), np.concatenate(norms)], axis=1)
        result = fit_result(
            self._space, counted, place.u, jnp.asarray(place.statistics),
            jnp.asarray(slopes.mean(axis=0)), status, len(trace), trace,
        )  # fmt: skip
        if np.isfinite(slopes).all():
            result = result.with_information(jnp.asarray(_information(weights, slopes)))
        place = dataclasses.replace(place, data=counted, weights=weights)
        cheap = self._plain(place.u, [stand.faded() for stand in self.cheap])
        return End(objective[best], result, place, origin, self.cheap, cheap, losses, norms)


def chance_covariance(
    draws: Float[np.ndarray, "draw statistic"],
    lack: Float[np.ndarray, "planting statistic"],
    stands: int,
) -> Float[np.ndarray, "statistic statistic"]:
    """Covariance of what statistics of one plot differ by from their estimated expectation.

    Chance counts twice: as that of the plot, and as the error of the expectation, which is a mean
    over few draws and over what full and cheap renders of few plantings differ by.

    **Arguments:**

    - `draws`: statistics of the cheap renders of draws of plants and parameters; their mean is the
      expectation.
    - `lack`: full less cheap render of some plantings; its mean is added to the expectation.
    - `stands`: sets of sites that the draws fill. Draws on the same sites are alike, so a set of
      sites counts as one draw.

    **Returns:** the covariance of `scatter_covariance`, grown by 1 / `stands` and by the mean
    variance of `lack` over that of the draws, divided by the number of plantings.

    NumPy in and out; not differentiable.
    """
    chance = scatter_covariance(draws)
    share = 1.0 / stands
    if len(lack) > 1:
        variance = np.diagonal(chance)
        some = variance > 0
        differ = lack.var(axis=0, ddof=1)[some] / variance[some]
        share += float(differ.mean()) / len(lack) if some.any() else 0.0
    return (1.0 + share) * chance


def _information(weights: np.ndarray, slopes: np.ndarray) -> Float[np.ndarray, "free free"]:
    """Fisher information of the mean of the `slopes` of several draws.

    Two in a row are opposite, so that slopes that change with the parameters hang together: only
    the means of such pairs are independent.
    """
    pairs = len(slopes) // 2
    if pairs >= 2:
        slopes = slopes[: 2 * pairs].reshape(pairs, 2, *slopes.shape[1:]).mean(axis=1)
    if len(slopes) == 1:
        return np.asarray((weights @ slopes[0]).T @ (weights @ slopes[0]))
    return np.asarray(repeated_information(jnp.asarray(weights @ slopes), confidence=0.5))


@eqx.filter_jit
def plants_wanted(
    scene: Scene, parameters: PlotParameters, space: ParameterSpace, places: Array
) -> Float[Array, "place species"]:
    """Plants of each species at several places of the whitened coordinates."""

    def at(u: Array) -> Array:
        return scene.counts(with_values(parameters, scene.taxa, space.named(u)))

    return jax.lax.map(at, places)


def with_error(data: Data, covariance: Float[np.ndarray, "statistic statistic"]) -> Data:
    """The data with an error of this covariance added; as they are where it is none or unknown."""
    sound = np.isfinite(covariance).all() and covariance.any()
    return data.with_covariance(covariance) if sound else data


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

"""Calibrate a plot to what sensors measured of it."""

from collections import deque
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import scipy.linalg
from jaxtyping import Array, Float
from scipy.special import chdtrc

from fynjax._core.html import as_html
from fynjax._core.precision import double_precision
from fynjax._core.progress import stage
from fynjax.inversion._expected import mean_information, with_error
from fynjax.inversion._fit_result import Data, Ended, FitResult, fit_result, status_of
from fynjax.inversion._functionals import Functional, stand_sentence, stand_table
from fynjax.inversion._search import CalibrationSettings, PlotSearch, SearchState, search_states
from fynjax.inversion._space import ParameterSpace, make_space, match_names
from fynjax.inversion._views import AbstractView, ImageView, radiometric_covariance
from fynjax.scene import AimedSensor, PlotParameters, Scene, named_values, parameter_kind

if TYPE_CHECKING:
    import pandas as pd


class Calibration(eqx.Module):
    """A calibrated plot."""

    scene: Scene
    """The scene, with more sites held ready where the search needed them."""
    stands: tuple[Scene, ...]
    """Plantings over which the search took expectations, in its coarse form."""
    stand_statistics: Float[np.ndarray, "stand statistic"]
    """Statistics of each planting of `stands` at the estimate."""
    fit: FitResult
    """The estimate, with its uncertainty."""
    before: PlotParameters
    """The plot's parameters where the search started, those that are not free among them."""
    after: PlotParameters
    """The plot's parameters at the estimate, those that are not free among them."""
    views: tuple[AbstractView, ...]
    """Views of the full scene, one for each sensor, in the order of the statistics."""
    coarse_views: tuple[AbstractView, ...]
    """Views of the `stands`, one for each sensor, which are in the coarse form of the search."""
    image_before: Float[Array, "band y x"] | None
    """The drone's image of the full scene where the search started; None without such a camera."""
    image_after: Float[Array, "band y x"] | None
    """The drone's image of the full scene at the estimate, before the camera's `gain`."""
    statistics_before: Float[Array, " statistic"]
    """Statistics where the search started, of full scenes, expected over plantings."""
    statistics_after: Float[Array, " statistic"]
    """Statistics at the estimate, of full scenes, expected over plantings and over what is unknown
    of the parameters."""
    spread: Float[np.ndarray, "free free"]
    """Root of the covariance of what is unknown of the parameters, over which statistics are
    expected, in whitened coordinates."""
    data: Data
    """The targets, their errors grown by what plantings and the camera's gains change."""
    measured: Data
    """The targets with the errors of data, model and gains, but not of where plants stand."""
    lack: Float[np.ndarray, " statistic"]
    """Statistics of full less those of coarse scenes of the same plants, at the estimate or, where
    the last round hardly moved, where it began."""
    degrees: int = eqx.field(static=True)
    """Statistics, or directions of many, that the likelihood counts."""
    projector: Float[np.ndarray, "statistic statistic"]
    """Projects statistics onto the directions that the likelihood counts."""
    gain: Float[np.ndarray, " band"] | None
    """Estimated factor by which each band of the drone's camera is off [-]: what simulated bands
    are to be multiplied by. None without such a camera."""
    gain_sd: Float[np.ndarray, " band"] | None
    """Standard deviation of the logarithm of each `gain` [-]."""
    statistics_with_gain: Float[np.ndarray, " statistic"]
    """Statistics at the estimate, as a camera with these gains measures them."""
    ends: "Ends"
    """The ends of the searches, one from each start."""

    def __str__(self) -> str:
        """What was found, in sentences: of the stand first."""
        return "\n".join(
            [
                self.fit.explanation,
                stand_sentence(self.stand()),
                f"Chi-square {self.misfit:.1f} of {self.degrees} "
                f"(probability {self.probability:.3g}).",
                str(self.fit).partition("\n")[2],
            ]
        )

    _repr_html_ = as_html

    @double_precision
    def stand(self, functionals: Mapping[str, Functional] | None = None) -> "pd.DataFrame":
        """Numbers of the whole stand before and after the data: `functionals` by name, of which any
        may be one's own (`stand_table`)."""
        return stand_table(self.scene, self.before, self.fit, functionals=functionals)

    @double_precision
    def table(self) -> "pd.DataFrame":
        """Every parameter before and after the data (`FitResult.table`)."""
        return self.fit.table()

    @property
    @double_precision
    def misfit(self) -> float:
        """Squared whitened misfit and distance from the prior, at the estimate: of data that the
        model and the prior explain a chi-square of `degrees`."""
        rest = self.data.whiten(self.fit.predicted - self.data.value)
        return float(rest @ rest + self.fit.whitened @ self.fit.whitened)

    @property
    @double_precision
    def probability(self) -> float:
        """That the model and its prior would give data so far from its expectation [-], were it
        linear in the parameters: below some 0.01 it does not explain them."""
        return float(chdtrc(self.degrees, self.misfit))

    @property
    def camera(self) -> AimedSensor | None:
        """The drone's camera; None where no sensor is one."""
        views = (view for view in self.views if isinstance(view, ImageView))
        return next((view.camera for view in views), None)


class Ends(eqx.Module):
    """Where a search ended from each of its starts, the first of which is the prior's centre."""

    objective: Float[np.ndarray, " start"]
    """Half the squared whitened misfit and distance from the prior, of the full scene [-]."""
    whitened: Float[np.ndarray, "start free"]
    """Whitened coordinates of the parameters."""
    apart: Float[np.ndarray, " start"]
    """Largest distance of a parameter from the best end [posterior sd]."""
    minima: int = eqx.field(static=True)
    """Ends that differ: in some parameter by more than its posterior standard deviation."""


_OF_COUNTS = (".cover", ".packing", ".fill")
"""Parameters of a species that have no effect but on how many plants there are."""
_OF_THE_ARTICLE = (".packing", ".fill")
"""Parameters of a species that have no effect where covers are projected."""
_OF_LEAVES = ("leaf_area_index", "shoot_clumping", "dead_fraction", "leaf_spread")
"""Parameters of a species that have no effect without leaves."""


@double_precision
def free_space(
    scene: Scene,
    parameters: PlotParameters,
    free: Sequence[str],
    relative_sd: Callable[[str], float | None],
    *,
    common: float | None = None,
) -> ParameterSpace:
    """The free parameters of a plot by name pattern, with priors about their present values.

    Parameters without effect are left out (leaves of deadwood, the moisture of a soil and the
    aerosol of a sky that were given, covers, packing and fill of known plants, whose number they
    would give, packing and fill where covers are projected), and covers of zero, of species, char
    or rock. A prior that does not lie between its bounds is moved or narrowed, with a warning
    (`make_space`).

    **Arguments:**

    - `scene`, `parameters`: the plot.
    - `free`: patterns of names, such as "species.*.cover".
    - `relative_sd`: gives the prior's standard deviation over its centre by name [-], or None for
      that of the parameter's record.
    - `common`: correlation of the priors of parameters of one kind, such as the covers of all
      species [-]; left out, that of the parameters' records (`make_space`).

    **Returns:** `ParameterSpace`.

    **Raises:** `InputError` for a pattern that fits no name, a parameter that cannot be free, a
    value outside its bounds, and a `common` of 1 or more.
    """
    values = {k: float(v) for k, v in named_values(parameters, scene.taxa).items()}
    chosen = [
        name
        for name in match_names(list(values), free)
        if not _without_effect(name, scene, parameters)
    ]
    correlation = None
    if common is not None:
        kinds = np.array([parameter_kind(name) for name in chosen])
        correlation = np.where(np.equal.outer(kinds, kinds), common, 0.0)
        np.fill_diagonal(correlation, 1.0)
    relative = {n: relative_sd(n) for n in chosen}
    return make_space({n: values[n] for n in chosen}, relative, correlation)


def _without_effect(name: str, scene: Scene, parameters: PlotParameters) -> bool:
    for i, taxon in enumerate(scene.taxa):
        if not name.startswith(f"species.{taxon}."):
            continue
        if float(parameters.species.cover[i]) == 0.0:
            return True
        if scene.known_plants and name.endswith(_OF_COUNTS):
            return True
        if scene.rules.cover_definition == "projected" and name.endswith(_OF_THE_ARTICLE):
            return True
        if name.endswith(".leaf_spread") and scene.species[i].leaves <= 1:
            return True
        if ".leaf." in name and scene.species[i].leaves == 0:
            return True
        leafless = float(parameters.species.leaf_area_index[i]) == 0.0
        of_leaves = (".leaf." in name, name.endswith(_OF_LEAVES))
        return leafless and any(of_leaves)
    if name in ("ground.char_fraction", "ground.rock_fraction"):
        return float(getattr(parameters.ground, name.split(".")[1])) == 0.0
    given = {"ground.moisture": scene.ground.soil, "light.aerosol": scene.sky}
    return given.get(name) is not None


@double_precision
def calibrate_plot(
    scene: Scene,
    parameters: PlotParameters,
    data: Data,
    space: ParameterSpace,
    views: Sequence[AbstractView],
    settings: CalibrationSettings | None = None,
    *,
    solver: Any = None,
    start: Float[Array, " free"] | None = None,
) -> Calibration:
    """Calibrate the free parameters of a plot to what one or several sensors measured.

    Where exactly each plant stands nobody measured: it is chance. So the data count as one draw of
    a normal distribution of the statistics over plantings (synthetic likelihood: Wood 2010, Price
    et al. 2018). Statistics bend over what is unknown of the parameters, and the slope at one place
    is that of the few plants about a species' number there. So expectation and slopes are means
    over `stand_realisations` draws of plants and of the parameters about the estimate, the same at
    every step (statistical linearisation: Garcia-Fernandez et al. 2015): of the prior in the first
    round, then of the posterior. What such a line leaves of `scatter_draws` is the covariance;
    errors of the data, of the model and of the camera's gains add to it. All sensors observe the
    same plants.

    The search looks at some of the pixels, with coarse light in layers twice as thick
    (`search_form`). What that lacks against full scenes at their own accuracy is measured at the
    start of each of the rounds, on the same plants, and added to its statistics; the covariances
    are renewed there too. Rounds after the first only correct; more than those of the settings
    follow while the last still moved. The estimate is the end of the last; of known plants the
    best of the start and the rounds by the full scenes.

    **Arguments:**

    - `scene`, `parameters`: the plot; parameters that are not free keep these values.
    - `data`: the statistics of all views, one after the other (`join_data`).
    - `space`: the free parameters with their priors.
    - `views`: what each sensor yields of `scene`.
    - `settings`: of the search. Of known plants there is one planting.
    - `solver`: of a round, of optimistix or jaxopt as of `fit`; `BroydenLM` by default, which takes
      one Jacobian a round. Others take one at each step, or as many gradients; of their rounds
      `fit.loss` has the beginnings alone.
    - `start`: whitened coordinates to start from; the prior's centre by default.

    Plantings are `Scene.realisation`s; where another seed finds no room for plants they fill the
    same sites in another order. Plants for which there are too few sites get more.

    To watch, keep or stop it go through a `PlotSearch` step by step, as this function does.

    **Returns:** `Calibration`. Its `fit` is that of the best start, `loss`, `gradient_norm` and
    `steps` those of all its rounds. Its `predicted` are expectations over plantings and the
    posterior. Where plants are known and no round improves on a start, that is the estimate:
    converged if a round ended there within the tolerance, `FitStatus.no_gain` if not.

    **Raises:** `InputError` for views that do not yield the data's statistics, and a start at
    which these are not finite.
    """
    search = PlotSearch(scene, parameters, data, space, views, settings, solver=solver)
    ends: list[SearchState] = []
    with stage("Calibrate", search.settings.evaluations):
        for u in search_starts(search, start):
            ends += deque(search_states(search, search.begin(u, *ends[:1])), maxlen=1)
    return calibration(search, ends)


@double_precision
def search_starts(
    search: PlotSearch, start: Float[Array, " free"] | None = None
) -> list[Float[Array, " free"]]:
    """Where the searches of a calibration start, in whitened coordinates.

    **Arguments:**

    - `search`: of the calibration.
    - `start`: of the first; the prior's centre by default. The others start at draws of the prior.
    """
    free, settings = len(search.space.names), search.settings
    first = jnp.zeros(free) if start is None else jnp.asarray(start, float)
    drawn = np.random.default_rng([settings.seed, 61]).normal(size=(settings.starts - 1, free))
    return [first, *map(jnp.asarray, drawn.clip(-2.0, 2.0))]


@double_precision
def calibration(search: PlotSearch, ends: Sequence[SearchState]) -> Calibration:
    """What the searches from all starts found.

    **Arguments:**

    - `search`: of the calibration.
    - `ends`: its state at the end from each start, the first that of the prior's centre.
    """
    # By one likelihood: errors differ between the ends.
    judge = search.weights(ends[0].place, ends[0].subspace)
    number = int(np.argmin([search.objective(end.best, judge) for end in ends]))
    fits = [_fit_of(search, end) for end in ends]
    won, fit, origin = ends[number], fits[number], ends[0].origin
    place, weights = won.best, search.weights(won.place, won.subspace)
    images = place.images
    with_image = any(isinstance(view, ImageView) for view in search.views)
    image = images[0] if with_image else None
    gain, gain_sd, with_gain = _gains(search.views, image, fit, weights)
    stands = search.stands(won)
    objective = [search.objective(e.best, search.weights(e.place, e.subspace)) for e in ends]
    return Calibration(
        scene=search.scene(won),
        stands=stands,
        stand_statistics=search.expected(won).plain(place.u, [s.expected() for s in stands]),
        fit=fit,
        before=search.plot(origin.u),
        after=search.plot(place.u),
        views=search.views,
        coarse_views=search.coarse_views,
        image_before=origin.images[0] if with_image else None,
        image_after=image,
        statistics_before=origin.statistics,
        statistics_after=place.statistics,
        spread=np.asarray(place.spread),
        data=fit.data,
        measured=with_error(search.data, radiometric_covariance(search.views, images)),
        lack=np.asarray(place.lack).mean(axis=0),
        degrees=len(weights),
        projector=scipy.linalg.block_diag(*(own.back @ own.rows for own in won.subspace.parts)),
        gain=gain,
        gain_sd=gain_sd,
        statistics_with_gain=with_gain,
        ends=_ends(objective, fits, fit),
    )


def _fit_of(search: PlotSearch, end: SearchState) -> FitResult:
    """The estimate of a search, with the errors at the last place it came to."""
    place, weights = end.best, search.weights(end.place, end.subspace)
    # The same likelihood for whoever goes on with these data: along the directions alone.
    counted = search.data_at(end.place).along(weights)
    slopes = np.asarray(place.slopes)
    reached = Ended(
        place.u, place.statistics, jnp.asarray(place.slope), status_of(end.status), end.steps,
        end.trace, end.rounds,
    )  # fmt: skip
    result = fit_result(search.space, counted, reached)
    if np.isfinite(slopes).all():
        result = result.with_information(jnp.asarray(mean_information(weights, slopes)))
    return result


def _gains(
    views: Sequence[AbstractView],
    image: Array | None,
    fit: FitResult,
    weights: Float[np.ndarray, "direction statistic"],
) -> tuple[np.ndarray | None, np.ndarray | None, np.ndarray]:
    """The gains of the drone's camera, the sd of their logarithms, and the statistics with them.

    Of the linear model about the estimate, in which gains and parameters are normal beforehand.
    """
    number = next((i for i, view in enumerate(views) if isinstance(view, ImageView)), None)
    if number is None or image is None:
        return None, None, np.asarray(fit.predicted)
    view: Any = views[number]  # the image is that of the first camera
    prior = view.gains.covariance(len(image))
    first = sum(len(before.names) for before in views[:number])
    slopes = np.zeros((len(fit.data.names), len(image)))
    slopes[first : first + len(view.names)] = view.gain_slopes(image)
    jacobian, by_gain = weights @ np.asarray(fit.jacobian), weights @ slopes
    # Errors of the gains are in the weights already: whitened data have the covariance 1 + JJ'.
    total = np.eye(len(weights)) + jacobian @ jacobian.T
    # Data less what the linear model predicts at the centre of the prior.
    rest = weights @ np.asarray(fit.data.value - fit.predicted)
    rest = rest + jacobian @ np.asarray(fit.whitened)
    # The gain of a Kalman filter, and what it leaves of the prior covariance.
    share = np.linalg.solve(total, by_gain @ prior).T
    left = prior - share @ by_gain @ prior
    off = share @ rest
    sd = np.sqrt(np.maximum(np.diagonal(left), 0.0))
    # As the line has it, for means exactly: a factor, and not the exponential of a logarithm.
    gain = 1.0 + off
    return gain, sd / gain, np.asarray(fit.predicted) + slopes @ off


def _ends(objective: Sequence[float], fits: Sequence[FitResult], best: FitResult) -> Ends:
    """How far the ends of a search lie apart, and how many are distinct."""
    sd = np.sqrt(np.diagonal(np.asarray(best.covariance)))
    places = np.stack([np.asarray(fit.whitened) for fit in fits])
    kept: list[np.ndarray] = []
    # From the best on: what lies near none that is kept is a minimum of its own.
    for i in np.argsort(objective, kind="stable"):
        if all(np.max(np.abs(places[i] - other) / sd) > 1.0 for other in kept):
            kept.append(places[i])
    return Ends(
        objective=np.array(objective),
        whitened=places,
        apart=np.max(np.abs(places - np.asarray(best.whitened)) / sd, axis=1),
        minima=len(kept),
    )

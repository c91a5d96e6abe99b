"""Calibrate a plot to what sensors measured of it."""

import dataclasses
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import scipy.linalg
from jaxtyping import Array, Float
from scipy.special import chdtrc

from fynjax._core.errors import InputError
from fynjax._core.extras import app_room
from fynjax._core.html import as_html
from fynjax._core.precision import double_precision
from fynjax._core.progress import stage
from fynjax.inversion._data import Data
from fynjax.inversion._expected import mean_information
from fynjax.inversion._factors import Known, PlotSpace
from fynjax.inversion._fit_result import Ended, FitResult, fit_result, status_of
from fynjax.inversion._functionals import Functional, stand_sentence, stand_table
from fynjax.inversion._known_plants import PixelSearch, PixelState
from fynjax.inversion._problem import Problem
from fynjax.inversion._search import (
    PlotSearch,
    SearchPlace,
    SearchState,
    excess_of,
    posterior_root,
    search_states,
)
from fynjax.inversion._space import ParameterSpace, make_space, match_names
from fynjax.inversion._verdict import (
    GROUPS,
    compare_means,
    gain_sentences,
    group_of,
    is_worse,
    misfit_without,
    worse_sentence,
)
from fynjax.inversion._views import AbstractView, BandView, ImageView, factors_by_view
from fynjax.scene import (
    AimedSensor,
    PlotParameters,
    Scene,
    named_values,
    parameter_kind,
    with_values,
)

if TYPE_CHECKING:
    import pandas as pd


class Plantings(eqx.Module):
    """Plantings over which a calibration took expectations, where plants stand by chance."""

    stands: tuple[Scene, ...]
    """Each of them, in the coarse form of the search."""
    statistics: Float[np.ndarray, "stand statistic"]
    """Statistics of each at the estimate."""
    views: tuple[AbstractView, ...]
    """Views of these stands, one for each sensor."""
    spread: Float[np.ndarray, "free coordinate"]
    """Root of the covariance of what is unknown of the parameters where factors of bands are given,
    over which statistics are expected, in whitened coordinates."""
    stated: Float[np.ndarray, "direction statistic"]
    """Makes misfits of statistics without factors independent and of unit size, by the stated
    errors, of which there is no `excess`, and by what the factors of the bands change."""
    lack: Float[np.ndarray, " statistic"]
    """Statistics of full less those of coarse scenes of the same plants, at the estimate or, where
    the last round hardly moved, where it began."""
    projector: Float[np.ndarray, "statistic statistic"]
    """Projects statistics onto the directions that the likelihood counts."""


class Blocks(eqx.Module):
    """Means of blocks of pixels that a calibration compared, where plants are known."""

    size: int = eqx.field(static=True)
    """Pixels along the edge of a block."""
    measured: Float[np.ndarray, "band y x"]
    """Reflectance of the blocks [-]; NaN where they are not compared."""
    before: Float[np.ndarray, "band y x"]
    """Simulated reflectance where the search started [-]."""
    after: Float[np.ndarray, "band y x"]
    """Simulated reflectance at the estimate: of the plot alone [-]."""
    with_error: Float[np.ndarray, "band y x"]
    """The same times the estimated gains and the model's error: what is compared [-]."""


class Calibration(eqx.Module):
    """A calibrated plot, whether plants were drawn or are known."""

    problem: Problem
    """What was asked."""
    scene: Scene
    """The scene, with more sites held ready where the search needed them."""
    fit: FitResult
    """The estimate of the plot's parameters, with its uncertainty. Its `predicted` are statistics
    without the factors of the bands, on the line through the estimate (`statistics_after` are not),
    and its data have these factors among their errors, to first
    order about the estimate: so it is that of parameters and factors together, the factors
    integrated over."""
    before: PlotParameters
    """The plot's parameters where the search started, those that are not free among them: the field
    table's, unless a `start` was given, with which `worse` and `offered` are about that."""
    after: PlotParameters
    """The plot's parameters at the estimate, those that are not free among them."""
    images_before: tuple[Float[Array | np.ndarray, "_band _y _x"], ...]
    """What each sensor with bands sees of the full scene where the search started, a spectrum as
    an image of one pixel; of known plants the blocks that are compared."""
    images_after: tuple[Float[Array | np.ndarray, "_band _y _x"], ...]
    """The same at the estimate, before the `gains`."""
    statistics_before: Float[Array | np.ndarray, " statistic"]
    """Statistics where the search started, of full scenes, expected over plantings."""
    statistics_after: Float[np.ndarray, " statistic"]
    """Statistics at the estimate, of full scenes, expected over plantings and over what is unknown
    of the parameters: of the plot alone, without gains and the model's error."""
    statistics_with_gain: Float[np.ndarray, " statistic"]
    """The same as cameras with the estimated gains measure them."""
    statistics_with_error: Float[np.ndarray, " statistic"]
    """The same with gains and with what the model is estimated to be off by: what is compared with
    the data."""
    space: PlotSpace
    """Parameters and factors of the bands, with what was known of them beforehand."""
    coordinates: Float[np.ndarray, " coordinate"]
    """Whitened coordinates of both at the estimate."""
    excess: float = eqx.field(static=True)
    """What the data ask beyond the stated errors, at least 1: the variances of all errors of
    statistics are so many times as large. By the `misfit` over `degrees` where it is least, and
    nearer to 1 where these are few [-]."""
    misfit: float = eqx.field(static=True)
    """Squared misfit in units of the stated errors, and squared distance of parameters and factors
    from their priors, at the estimate: of data that the model and its priors explain
    a chi-square of `degrees`."""
    degrees: int = eqx.field(static=True)
    """Statistics, or directions of many, that the likelihood counts."""
    gains: tuple[Float[np.ndarray, " _band"], ...]
    """Estimated factor by which each band of each view with bands is off [-]: what simulated bands
    are to be multiplied by."""
    gains_covariance: tuple[Float[np.ndarray, "_band _band"], ...]
    """Covariance of the logarithms of the `gains` of each view [-]."""
    model_error: tuple[Float[np.ndarray, " _band"], ...]
    """Estimated factor by which reality is off from the model in each band of each view with bands
    [-], beside the gains."""
    model_error_sd: tuple[Float[np.ndarray, " _band"], ...]
    """Standard deviations of the logarithms of `model_error` [-]."""
    ends: "Ends"
    """The ends of the searches, one from each start."""
    states: tuple[Any, ...]
    """The searches at their ends, from which all else here follows (`calibration`)."""
    plantings: Plantings | None = None
    """Plantings over which expectations were taken; None where plants are known."""
    blocks: Blocks | None = None
    """Blocks of pixels that were compared; None where plants stand by chance."""

    def __str__(self) -> str:
        """What was found, in sentences: of the stand first."""
        return "\n".join(
            [
                *self.doubts(),
                self.fit.explanation,
                stand_sentence(self.stand()),
                self.misfit_sentence(),
                str(self.fit).partition("\n")[2],
            ]
        )

    _repr_html_ = as_html

    @double_precision
    def means(self) -> "pd.DataFrame":
        """The mean of every band and index against what was measured: errors before and after, and
        with the cameras' gains [%], and whether each came nearer (`moved`)."""
        names = self.data.names
        values = [
            np.asarray(one, float)
            for one in (
                self.data.value, self.statistics_before, self.statistics_after,
                self.statistics_with_gain,
            )
        ]  # fmt: skip
        if self.blocks is not None and self.camera is not None:  # of all blocks of a band
            bands = self.camera.sensor.bands.names
            names = tuple(f"{band}.mean" for band in bands)
            values = [one.reshape(len(bands), -1).mean(axis=1) for one in values]
        return compare_means(names, *values)

    @property
    @double_precision
    def data(self) -> Data:
        """The targets, their errors grown by what plantings and the factors of the bands change,
        and by the `excess`."""
        return self.fit.data

    @property
    def views(self) -> tuple[AbstractView, ...]:
        """Views of the full scene, one for each sensor, in the order of the statistics."""
        return self.problem.views

    @property
    def image_before(self) -> Float[Array | np.ndarray, "band y x"] | None:
        """The first drone's image of the full scene where the search started; None without a
        drone."""
        return self._of_drone(self.images_before)

    @property
    def image_after(self) -> Float[Array | np.ndarray, "band y x"] | None:
        """The same at the estimate, before the camera's `gain`."""
        return self._of_drone(self.images_after)

    @property
    def worse(self) -> bool:
        """Whether more bands moved away from what was measured than nearer. Then the values to use
        are those of the field table."""
        return is_worse(self.means())

    @property
    def offered(self) -> PlotParameters:
        """The plot's parameters to go on with: those `after`, or where the estimate is `worse`
        those `before`."""
        return self.before if self.worse else self.after

    def report(self, folder: str | Path, name: str = "plot") -> Any:
        """Write the page, tables and images of the command `calibrate` into a `folder`, of a plot
        of this `name`; `fynjax.read_fit` opens it again.

        **Returns:** `fynjax.app.jobs.CalibrateResult`. **Raises:** `MissingExtraError` without the
        packages of the app.
        """
        return app_room("jobs", "fit_report")(self, folder, name)

    @double_precision
    def misfit_by_group(self) -> "pd.DataFrame":
        """What the misfit would be without each group of statistics, by the linear model about the
        estimate: group, statistics, chi-square and degrees without it, and `times`, the ratio of
        the two. First row: with all. Empty of single pixels, which are of one kind."""
        import pandas as pd  # late: the command line need not wait for it

        columns = ["left_out", "statistics", "misfit", "degrees", "times"]
        if self.plantings is None:
            return pd.DataFrame(columns=columns)

        jacobian = np.asarray(self.fit.jacobian)
        rest = np.asarray(self.data.value - self.fit.predicted)
        rest = rest + jacobian @ np.asarray(self.fit.whitened)
        groups = np.array([group_of(name) for name in self.data.names])
        rows = []
        for name in ("", *dict.fromkeys(groups)):
            misfit, degrees = misfit_without(self.plantings.stated, rest, jacobian, groups == name)
            if degrees > 0:
                left = int(np.sum(groups == name))
                rows.append((name or "none", left, misfit, degrees, misfit / degrees))
        return pd.DataFrame(rows, columns=columns)

    @double_precision
    def misfit_sentence(self) -> str:
        """The misfit in words: how many times what was expected, and where it is much, by which
        group of statistics."""
        times = self.misfit / self.degrees
        sentence = f"The misfit is {times:.2g} times what was expected"
        if self.plantings is None or times < UNDESCRIBED:
            return f"{sentence}."
        table = self.misfit_by_group()
        ratio = dict(zip(table["left_out"], map(float, table["times"]), strict=True))
        every = ratio.pop("none")
        if len(ratio) > 1:
            least = min(ratio, key=lambda group: ratio[group])
            sentence += f"; on a line {every:.2g}, and {ratio[least]:.2g} without {GROUPS[least]}"
        return f"{sentence}: intervals are widened by it."

    def doubts(self) -> list[str]:
        """Sentences that stand before all others, where the estimate is worse than the field table
        or the model does not describe the plot; none where neither is so."""
        found = [worse_sentence(self.means())] if self.worse else []
        if self.misfit >= UNDESCRIBED * self.degrees:
            found.append(f"The model does not describe this plot. {self.misfit_sentence()}")
        return found

    @double_precision
    def stand(self, functionals: Mapping[str, Functional] | None = None) -> "pd.DataFrame":
        """Numbers of the whole stand before and after the data: `functionals` by name, of which any
        may be one's own (`stand_table`)."""
        return stand_table(self.scene, self.before, self.fit, functionals=functionals)

    @double_precision
    def table(self) -> "pd.DataFrame":
        """Every parameter before and after the data (`FitResult.table`), and `offered`, the value
        to use: the estimate, or where the fit is worse than the field table the prior."""
        table, worse = self.fit.table(), self.worse
        offered = table["prior"] if worse else table["estimate"]
        return table.assign(offered=offered, worse_than_table=worse)

    @property
    @double_precision
    def probability(self) -> float:
        """That the model and its prior would give data so far from its expectation [-], were it
        linear in the parameters: below some 0.01 it does not explain them."""
        return float(chdtrc(self.degrees, self.misfit))

    @property
    def gains_sd(self) -> tuple[Float[np.ndarray, " _band"], ...]:
        """Standard deviations of the logarithms of `gains` [-]."""
        variances = (np.diagonal(one) for one in self.gains_covariance)
        return tuple(np.sqrt(np.maximum(one, 0.0)) for one in variances)

    @property
    def gain(self) -> Float[np.ndarray, " band"] | None:
        """The `gains` of the drone's camera; None where no sensor is one."""
        return self._of_drone(self.gains)

    @property
    def gain_sd(self) -> Float[np.ndarray, " band"] | None:
        """Standard deviation of the logarithm of each `gain` [-]."""
        return self._of_drone(self.gains_sd)

    def gain_sentences(self) -> list[str]:
        """What is known of the gains of the drone's camera, in words; none without a camera."""
        if self.gain is None or self.camera is None:
            return []
        covariance = self._of_drone(self.gains_covariance)
        return gain_sentences(self.camera.sensor.bands.names, self.gain, np.asarray(covariance))

    def _of_drone(self, values: Sequence[Any]) -> Any:
        with_bands = (view for view in self.views if isinstance(view, BandView))
        of = (one for one, view in zip(values, with_bands) if isinstance(view, ImageView))
        return next(of, None)

    def factors(self) -> "pd.DataFrame":
        """What each band of each sensor is off by, the gain of the sensor and the error of the
        model apart: the number of the sensor from 1, band, wavelength [nm], factors, and standard
        deviations of their logarithms before and after the data [-]."""
        import pandas as pd  # late: the command line need not wait for it

        prior = self.space.factors
        rows: list[tuple[Any, ...]] = []
        sd = [np.sqrt(np.diagonal(np.asarray(one))) for one in (prior.of_gains, prior.of_model)]
        known = zip(self.gains, self.gains_sd, self.model_error, self.model_error_sd, strict=True)
        seen = [(i, v.bands) for i, v in enumerate(self.views, 1) if isinstance(v, BandView)]
        for (number, bands), own in zip(seen, known, strict=True):
            for i, (name, centre) in enumerate(zip(bands.names, bands.centre, strict=True)):
                gain, gain_sd, error, error_sd = (float(values[i]) for values in own)
                before = (float(one[len(rows)]) for one in sd)
                rows.append((number, name, centre, gain, gain_sd, error, error_sd, *before))
        columns = ["sensor", "band", "wavelength_nm", "gain", "gain_sd", "model_error"]
        columns += ["model_error_sd", "gain_prior_sd", "model_error_prior_sd"]
        return pd.DataFrame(rows, columns=columns)

    @property
    def camera(self) -> AimedSensor | None:
        """The drone's camera; None where no sensor is one."""
        views = (view for view in self.views if isinstance(view, ImageView))
        return next((view.camera for view in views), None)


UNDESCRIBED = 3.0
"""Misfit over what was expected from which on a model is said not to describe a plot [-]."""


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
_OF_LEAVES = ("leaf_area_index", "shoot_clumping", "dead_fraction", "leaf_spread", "leaf_angle")
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
def fit_plot(
    problem: Problem, *, solver: Any = None, start: Float[Array, " free"] | None = None
) -> Calibration:
    """Calibrate a plot to what one or several sensors measured, as `fit` says; `start` in whitened
    coordinates."""
    search = plot_search(problem, solver)
    ends: list[Any] = []
    with stage("Calibrate", search.settings.evaluations):
        for u in search_starts(search, start):
            ends += deque(search_states(search, search.begin(u, *ends[:1])), maxlen=1)
    return calibration(search, ends)


def plot_search(problem: Problem, solver: Any = None) -> PlotSearch | PixelSearch:
    """The search of a problem, to be gone through step by step (`search_states`).

    **Arguments:** `problem`; `solver`, as of `fit`, where plants stand by chance.

    **Raises:** `InputError` for single pixels of a plot whose plants are not known.
    """
    if problem.measured.pixels is not None:
        if solver is not None:
            raise InputError("expected no `solver`: single pixels are fitted by `BroydenLM`")
        return PixelSearch(problem)
    return PlotSearch(problem, solver)


@double_precision
def search_starts(
    search: PlotSearch | PixelSearch, start: Float[Array, " free"] | None = None
) -> list[Float[Array, " free"]]:
    """Where the searches of a calibration start, in whitened coordinates.

    **Arguments:**

    - `search`: of the calibration.
    - `start`: of the first; the prior's centre by default. The others start at draws of the prior.
    """
    free, settings = len(search.space.plot.names), search.settings
    first = jnp.zeros(free) if start is None else jnp.asarray(start, float)
    drawn = np.random.default_rng([settings.seed, 61]).normal(size=(settings.starts - 1, free))
    return [first, *map(jnp.asarray, drawn.clip(-2.0, 2.0))]


@double_precision
def calibration(search: PlotSearch | PixelSearch, ends: Sequence[Any]) -> Calibration:
    """What the searches from all starts found.

    **Arguments:**

    - `search`: of the calibration.
    - `ends`: its state at the end from each start, the first that of the prior's centre.
    """
    if isinstance(search, PixelSearch):
        rest = [float(jnp.sum(end.descent.residual**2)) for end in ends]
        return _of_known_plants(search, ends[int(np.argmin(rest))])
    # By one likelihood: errors differ between the ends.
    judge = search.weights(ends[0].place, ends[0].subspace)
    number = int(np.argmin([search.objective(end.best, judge) for end in ends]))
    fits = [_fit_of(search, end) for end in ends]
    won, fit, origin = ends[number], fits[number], ends[0].origin
    place, images = won.best, won.best.images
    gains, errors = _factors_of(search, won)
    with_bands = [view for view in search.views if isinstance(view, BandView)]
    log_factors = np.zeros(len(gains.mean)), gains.mean, gains.mean + errors.mean
    shown = [_with_factors(search, place, one) for one in log_factors]
    stands = search.stands(won)
    objective = [search.objective(e.best, search.weights(e.place, e.subspace)) for e in ends]
    plantings = Plantings(
        stands=stands,
        statistics=search.expected(won).plain(place.u, [s.expected() for s in stands]),
        views=search.coarse_views,
        spread=np.asarray(place.spread)[: len(search.space.plot.names)],
        stated=_without_factors(search, _stated(won)),
        lack=np.asarray(place.lack).mean(axis=0),
        projector=scipy.linalg.block_diag(*(own.back @ own.rows for own in won.subspace.parts)),
    )
    return Calibration(
        problem=search.problem,
        scene=search.scene(won),
        fit=fit,
        before=search.plot(origin.u),
        after=search.plot(place.u),
        images_before=origin.images,
        images_after=images,
        statistics_before=origin.statistics,
        statistics_after=shown[0],
        statistics_with_gain=shown[1],
        statistics_with_error=shown[2],
        space=search.space,
        coordinates=np.asarray(place.u),
        excess=float(won.place.excess),
        misfit=search.misfit(won),
        degrees=len(judge),
        **_by_view(with_bands, gains, errors),
        ends=_ends(objective, fits, fit),
        states=tuple(ends),
        plantings=plantings,
    )


def _by_view(views: Sequence[BandView], gains: Known, errors: Known) -> dict[str, Any]:
    """What is known of gains and of the model's error, by views with bands."""
    ends = np.cumsum([len(view.bands) for view in views], dtype=int)
    parts = [slice(a, b) for a, b in zip([0, *ends[:-1]], ends)]
    return {
        "gains": tuple(gains.factor[part] for part in parts),
        "gains_covariance": tuple(gains.covariance[part, part] for part in parts),
        "model_error": tuple(errors.factor[part] for part in parts),
        "model_error_sd": tuple(errors.sd[part] for part in parts),
    }


def _of_known_plants(search: PixelSearch, state: PixelState) -> Calibration:
    """What a search pixel by pixel found."""
    model, plot, problem = search.model, search.problem.free, search.problem
    free, sd, u = len(plot.names), np.asarray(state.sd), np.asarray(state.u)
    # At the end residuals and slopes are those of this very place.
    rest, rows = np.asarray(state.descent.residual), np.asarray(state.descent.jacobian)
    measured, own, misfit = problem.measured, sd.size, float(rest @ rest)
    degrees = round(own / float(search.errors.together))
    excess = excess_of(misfit, degrees)
    scaled = rows[:own] / np.sqrt(excess)
    # Back from whitened residuals and rows to values and their slopes.
    value = np.asarray(measured.value)
    values = value + sd * search.errors.whiten(rest[:own], back=True)
    slopes = sd[:, None] * search.errors.whiten(rows[:own], back=True)
    alike = np.sqrt(float(search.errors.together))  # how bands err together is left out
    sd = sd * np.repeat(alike * search.errors.sd, own // len(search.errors.sd))
    data = Data(measured.names, jnp.asarray(value), jnp.asarray(sd)).widened(excess)
    end = Ended(
        jnp.asarray(u[:free]), jnp.asarray(values), jnp.asarray(slopes[:, :free]),
        status_of(state.status), state.steps, state.trace, state.rounds,
    )  # fmt: skip
    # Of parameters and factors together; the prior of both is one.
    covariance = np.linalg.inv(scaled.T @ scaled + np.eye(len(u)))
    # Of the parameters alone, the factors integrated over.
    alone = np.linalg.inv(covariance[:free, :free]) - np.eye(free)
    information = np.linalg.solve(np.eye(free) + alone @ search.outlines(u), alone)
    factors = search.space.factors.known(u[free:], covariance[free:, free:])
    gains, errors = search.space.factors.gains(factors), search.space.factors.errors(factors)
    image, before = search.image(state.u), np.asarray(state.before)
    after = image / factors.factor[:, None, None]
    compared = search.compared
    found = fit_result(plot, data, end)
    found = found.with_information(jnp.asarray(0.5 * (information + information.T)))

    def at(u: Array) -> PlotParameters:
        return with_values(model.parameters, model.scene.taxa, plot.named(u))

    def of(image: np.ndarray) -> np.ndarray:
        return image[:, compared].ravel()

    return Calibration(
        problem=problem,
        scene=model.scene,
        fit=found,
        before=at(state.start[:free]),
        after=at(jnp.asarray(u[:free])),
        images_before=(before,),
        images_after=(after,),
        statistics_before=of(before),
        statistics_after=of(after),
        statistics_with_gain=of(after * gains.factor[:, None, None]),
        statistics_with_error=of(image),
        space=search.space,
        coordinates=u,
        excess=excess,
        misfit=misfit,
        degrees=degrees,
        **_by_view([view for view in problem.views if isinstance(view, BandView)], gains, errors),
        ends=Ends(np.array([0.5 * misfit]), u[None, :free], np.zeros(1), 1),
        states=(state,),
        blocks=Blocks(model.block, search.measured, before, after, image),
    )


def _fit_of(search: PlotSearch, end: SearchState) -> FitResult:
    """The estimate of the parameters, the factors integrated over, with the errors at the last
    place that a search came to."""
    place, weights = end.best, _without_factors(search, end)
    free, slopes = len(search.space.plot.names), np.asarray(place.slopes)
    own, by_factor = slopes[..., :free], place.slope[:, free:]
    # The same likelihood for whoever goes on with these data: along the directions alone.
    data = search.data_at(end.place)
    counted = (
        data.with_covariance(by_factor @ by_factor.T)
        if by_factor.any() and np.isfinite(by_factor).all()
        else data
    ).along(weights)
    # On the line through the estimate, where factors are one.
    without = np.asarray(place.statistics) - by_factor @ np.asarray(place.u)[free:]
    reached = Ended(
        place.u[:free], jnp.asarray(without), jnp.asarray(own.mean(axis=0)), status_of(end.status),
        end.steps, end.trace, end.rounds,
    )  # fmt: skip
    result = fit_result(search.space.plot, counted, reached)
    if np.isfinite(slopes).all():
        result = result.with_information(jnp.asarray(mean_information(weights, own)))
    return result


def _without_factors(
    search: PlotSearch, end: SearchState
) -> Float[np.ndarray, "direction statistic"]:
    """Makes misfits of statistics in which factors are one independent and of unit size, along the
    directions that count."""
    weights = search.weights(end.place, end.subspace)
    # Errors are independent of unit size along the directions, to which factors add.
    moved = weights @ end.best.slope[:, len(search.space.plot.names) :]
    if not np.isfinite(moved).all():
        return weights
    root = np.linalg.cholesky(np.eye(len(moved)) + moved @ moved.T)
    return np.asarray(np.linalg.solve(root, weights))


def _stated(end: SearchState) -> SearchState:
    """The end of a search with the stated errors, whatever the data ask beyond them."""
    place = dataclasses.replace(end.place, excess=jnp.ones(()))
    return dataclasses.replace(end, place=place)


def _factors_of(search: PlotSearch, end: SearchState) -> tuple[Known, Known]:
    """What is known of the gains of all bands and of the model's error in them at the end of a
    search."""
    free, factors = len(search.space.plot.names), search.space.factors
    slopes = np.asarray(end.best.slopes)
    covariance = np.eye(factors.coordinates)
    if np.isfinite(slopes).all():
        known = posterior_root(search.weights(end.place, end.subspace), slopes)
        covariance = (known @ known.T)[free:, free:]
    found = factors.known(np.asarray(end.best.u)[free:], covariance)
    return factors.gains(found), factors.errors(found)


def _with_factors(
    search: PlotSearch, place: SearchPlace, factors: Float[np.ndarray, " factor"]
) -> Float[np.ndarray, " statistic"]:
    """Statistics at a place with other factors, given by their logarithms: expectations change with
    them as the image of the scene's own plants does."""
    own = search.space.factors.logarithms(place.u[len(search.space.plot.names) :])
    images, parts = iter(place.images), []
    for view, by, to in zip(
        search.views,
        factors_by_view(search.views, own),
        factors_by_view(search.views, jnp.asarray(factors)),
    ):
        if by is None or to is None or not isinstance(view, BandView):
            parts.append(np.zeros(len(view.names)))
        else:
            image = jnp.asarray(next(images))
            parts.append(np.asarray(view.statistics(image, to) - view.statistics(image, by), float))
    return np.asarray(place.statistics) + np.concatenate(parts)


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

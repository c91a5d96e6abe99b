"""What was measured, and what a fit made of it: the estimate and how far to trust it."""

import dataclasses
from collections.abc import Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Array, Bool, Float, Int
from scipy.special import stdtrit

from fynjax._core.html import as_html
from fynjax._core.precision import double_precision
from fynjax._core.seeds import generator
from fynjax.inversion._data import Data
from fynjax.inversion._space import ParameterSpace, parameter_columns
from fynjax.scene import PARAMETERS, parameter_kind

if TYPE_CHECKING:
    import pandas as pd

WELL_CONSTRAINED = 0.75
"""Share of its prior variance that data must remove for a parameter to be well constrained [-]."""

_FEWEST = 6
"""Draws of which some can be left out, at least."""


def scatter_covariance(
    draws: Float[np.ndarray, "draw statistic"],
    target: Float[np.ndarray, "statistic statistic"] | None = None,
) -> Float[np.ndarray, "statistic statistic"]:
    """Covariance of statistics over draws, few as they are.

    Variances are those of the draws. Correlations are drawn towards those of a target as far as
    few draws ask for: the oracle-approximating shrinkage of Chen, Wiesel, Eldar & Hero (2010, eq.
    23), in coordinates in which the target is the identity.

    **Arguments:** `draws`, at least two; `target`, a positive definite correlation matrix, by
    default the identity: none are correlated.
    """
    count = len(draws)
    deviation = draws - draws.mean(axis=0)
    sd = deviation.std(axis=0, ddof=1)
    unit = deviation / np.where(sd > 0, sd, 1.0)
    correlation = unit.T @ unit / (count - 1)
    return np.asarray(_shrunk(correlation, count, target) * sd * sd[:, None])


def _shrunk(
    correlation: Float[np.ndarray, "statistic statistic"],
    count: int,
    target: Float[np.ndarray, "statistic statistic"] | None = None,
) -> Float[np.ndarray, "statistic statistic"]:
    """Correlations of `count` draws, drawn towards those of a target (`scatter_covariance`)."""
    size = len(correlation)
    if target is None:
        target, apart = np.diag(np.diagonal(correlation)), correlation
    else:
        root = np.linalg.inv(np.linalg.cholesky(target))
        apart = root @ correlation @ root.T
    square, total = np.sum(apart**2), np.trace(apart)
    # The fewer draws and the nearer to the target, the more is taken from it.
    above = (1.0 - 2.0 / size) * square + total**2
    below = (count - 2.0 / size) * (square - total**2 / size)
    share = 1.0 if below <= 0 else min(1.0, above / below)
    return np.asarray((1.0 - share) * correlation + share * target)


def _correlation(drawn: Float[np.ndarray, "draw row column"]) -> Float[np.ndarray, "row row"]:
    """Correlations of rows over draws and over the columns that two rows have in common, drawn to
    none by a hundredth so that they have an inverse; what is 0 in all draws is missing."""
    product = np.einsum("nik,njk->ij", drawn, drawn)
    square = np.sum(drawn**2, axis=0)
    there = (square > 0).astype(float)
    common = np.sqrt((square @ there.T) * (there @ square.T))
    values, vectors = np.linalg.eigh(product / np.maximum(common, 1e-300))
    found = (vectors * np.maximum(values, 0.0)) @ vectors.T
    sd = np.sqrt(np.diagonal(found))
    found /= np.maximum(np.outer(sd, sd), 1e-300)
    np.fill_diagonal(found, 1.0)
    return np.asarray(0.99 * found + 0.01 * np.eye(len(found)))


def scatter_of_views(
    draws: Float[np.ndarray, "draw statistic"], kinds: Sequence[str]
) -> Float[np.ndarray, "statistic statistic"]:
    """`scatter_covariance` of statistics of several views of one stand, which see the same plants.

    What differs from draw to draw is then much the same in all views. The target has correlations
    of kinds of statistics, such as the mean of a band, which all views share, times those of views,
    which all kinds share. And by as much as few draws ask for (James & Stein 1961) standard
    deviations of a kind are drawn to their geometric mean: where views seem to differ in what they
    share, the difference of two would tell without it. What is left of the chance that few draws
    lead to is measured on draws that are left out: each is looked for among the others as if it
    were a change by a parameter, and the covariance is larger by the mean square of what is found
    over the variance stated for it, at least 1. Of fewer than six draws too few are left for that,
    and no correlation is known: as many times the variance of each statistic, on the mean over its
    kind, as there are statistics, which no correlations of such variances exceed.

    **Arguments:** `draws`, at least two; `kinds`, of each statistic what it is in its view, one
    view after the other.

    **Returns:** the covariance, NaN where a statistic is not finite.
    """
    kind = np.unique(kinds, return_inverse=True)[1]
    if len(kinds) == kind.max() + 1 or not np.isfinite(draws).all():
        return scatter_covariance(draws)
    if len(draws) < _FEWEST:
        mean = np.bincount(kind, draws.var(axis=0, ddof=1)) / np.bincount(kind)
        return np.diag(len(kinds) * mean[kind])
    same = kind == kind[:, None]
    view = np.tril(same, -1).sum(axis=1)  # how often its kind came before
    found = _of_views(draws, kind, view)
    folds = np.arange(len(draws)) % min(8, len(draws) // 2)
    squares = []
    for fold in range(folds.max() + 1):
        known, left = draws[folds != fold], draws[folds == fold]
        away = left - known.mean(axis=0)
        inverse = np.linalg.pinv(_of_views(known, kind, view), hermitian=True)
        product = away @ inverse @ away.T
        stated = np.maximum(np.diagonal(product), 1e-300)[:, None]
        squares.append((product**2 / stated)[~np.eye(len(left), dtype=bool)])
    return np.asarray(found * max(np.mean(np.concatenate(squares)), 1.0))


def _of_views(
    draws: Float[np.ndarray, "draw statistic"],
    kind: Int[np.ndarray, " statistic"],
    view: Int[np.ndarray, " statistic"],
) -> Float[np.ndarray, "statistic statistic"]:
    """Covariance of statistics of views of one stand, by their kinds and views, before what few
    draws make of its inverse."""
    count = len(draws)
    unit = draws - draws.mean(axis=0)
    unit /= np.maximum(unit.std(axis=0, ddof=1), 1e-12)
    laid = np.zeros((count, view.max() + 1, kind.max() + 1))
    laid[:, view, kind] = unit
    of_views = _correlation(laid)
    of_kinds = _shrunk(_correlation(laid.swapaxes(1, 2)), count)
    found = scatter_covariance(draws, of_views[view][:, view] * of_kinds[kind][:, kind])
    pairs = (kind == kind[:, None]) & ~np.eye(len(kind), dtype=bool)
    mean = np.clip((unit.T @ unit)[pairs].mean() / (count - 1), 0.0, 0.99)
    log = 0.5 * np.log(np.maximum(np.diagonal(found), 1e-300))
    views = np.bincount(kind)
    away = log - (np.bincount(kind, log) / views)[kind]
    # Of correlated normal draws logarithms of two deviations differ by chance as much as this.
    chance = (1.0 - mean**2) / (2.0 * (count - 1))
    seen = np.bincount(kind, away**2) / np.maximum(views - 1, 1)
    factor = np.exp(-away * np.minimum(chance / np.maximum(seen, 1e-300), 1.0)[kind])
    return np.asarray(found * np.outer(factor, factor))


def well_constrained(
    names: Sequence[str], constrained: Float[np.ndarray, " free"], least: float = WELL_CONSTRAINED
) -> tuple[str, ...]:
    """Parameters whose variance the data cut by the share `least` or more; by default those whose
    standard deviation they at least halve."""
    return tuple(n for n, c in zip(names, constrained) if c >= least)


class FitStatus(optx.RESULTS):
    """Why a fit stopped. `FitStatus[status]` is the sentence, `FitResult.explanation` says more."""

    at_bound = "Converged with a parameter at its bound: widen the bound, or look at the posterior."
    flat = "Converged; no statistic depends on some of the parameters, which stay at their priors."
    max_steps = "Stopped at the limit of steps, before it converged."
    max_rounds = "Stopped at the limit of rounds, of which the last still moved the estimate."
    not_finite = "The objective, a statistic or a slope is not finite; the estimate is of no use."
    no_gain = "Stopped before it converged: no step improved on the estimate any more."


def number_of(status: Any) -> Int[Array, ""]:
    """The number of a `FitStatus`, as it is kept between runs."""
    return jnp.asarray(status._value)


def status_of(number: Int[Array, ""]) -> Any:
    """The `FitStatus` of a number, as `number_of` has it."""
    return eqx.tree_at(lambda s: s._value, FitStatus.max_steps, jnp.asarray(number))


class FitResult(eqx.Module):
    """What a fit found, and how far to trust it. A pytree of arrays, so that fits can be mapped."""

    space: ParameterSpace
    data: Data
    whitened: Float[Array, " free"]
    """The estimate in whitened coordinates."""
    estimate: Float[Array, " free"]
    """The estimate in the parameters' own units."""
    sd: Float[Array, " free"]
    """Standard deviation of the estimate in the parameters' own units, by the Laplace
    approximation, which is normal in the whitened coordinates."""
    constrained: Float[Array, " free"]
    """1 - posterior over prior variance, in whitened coordinates [-]: 0, the data say nothing; 1,
    they say all."""
    covariance: Float[Array, "free free"]
    """Posterior covariance in whitened coordinates, where the prior's is one."""
    predicted: Float[Array, " statistic"]
    """Statistics at the estimate."""
    jacobian: Float[Array, "statistic free"]
    """Derivative of the statistics by the whitened coordinates there."""
    information: Float[Array, " mode"]
    """Eigenvalues of the data's Fisher information in prior units, largest first: a direction
    with less than one is known from the prior rather than from the data."""
    modes: Float[Array, "mode free"]
    """Eigenvectors of the data's Fisher information, in whitened coordinates."""
    loss: Float[Array | np.ndarray, " evaluation"]
    """The objective: at the start and at the end of a fit; of a calibration where each round begins
    and after each of its steps. A round begins with new errors, so that objectives of different
    rounds do not compare."""
    gradient_norm: Float[Array | np.ndarray, " evaluation"]
    """Norm of the gradient of the objective by the whitened coordinates, at each `loss`."""
    status: Any
    """Why the fit stopped, a `FitStatus`."""
    steps: Int[Array, ""]
    """Steps that the solver took: those of all rounds in a calibration."""
    rounds: Int[Array | np.ndarray, " evaluation"] | None = None
    """Round of each `loss` of a calibration, from 1; None of another fit."""

    @property
    def names(self) -> tuple[str, ...]:
        return self.space.names

    @property
    def converged(self) -> Bool[Array, "*fit"]:
        """Whether the fit reached its tolerance."""
        good = (FitStatus.successful, FitStatus.at_bound, FitStatus.flat)
        return jnp.any(jnp.stack([self.status == status for status in good]), axis=0)

    @property
    @double_precision
    def moved(self) -> Float[Array, " free"]:
        """How far each estimate lies from the centre of its prior [prior standard deviations], as
        quantiles of a normal: what data hardly constrain may move far with what they do."""
        return self.space.together(self.whitened)

    def __str__(self) -> str:
        """What was found, in sentences."""
        if self.whitened.ndim > 1:
            return f"{len(self.whitened)} fits of {len(self.names)} parameters."
        interval = np.stack([self.estimate, *self.quantiles(0.05, 0.95)])
        return f"{self.explanation}\n{known_lines(self.names, self.well_constrained(), interval)}"

    _repr_html_ = as_html

    def table(self) -> "pd.DataFrame":
        """Every parameter, in the unit of field crews: name, kind, unit, median, standard deviation
        and 90 % interval of the prior, estimate, standard deviation and 90 % interval, bounds; how
        far the estimate moved from the prior's centre, in standard deviations of the prior; and the
        share of the prior variance that the data removed [-]."""
        low, high = self.quantiles(0.05, 0.95)
        table = parameter_columns(
            self.names,
            {
                **self.space.prior_columns(),
                "estimate": self.estimate,
                "sd": self.sd,
                "q05": low,
                "q95": high,
                "lower": self.space.lower,
                "upper": self.space.upper,
            },
        )
        moved, constrained = np.asarray(self.moved, float), np.asarray(self.constrained, float)
        return table.assign(moved=moved, constrained=constrained)

    @double_precision
    def draws(self, number: int, *, seed: int = 0) -> Float[np.ndarray, "draw free"]:
        """Draws from the Laplace approximation of the posterior, in the parameters' own units.

        **Arguments:** `number` of draws, and the `seed` of these.
        """
        random = generator(seed, 29)
        centre, covariance = np.asarray(self.whitened, float), np.asarray(self.covariance, float)
        u = random.multivariate_normal(centre, covariance, number, method="eigh")
        return np.asarray(jax.vmap(self.space.physical)(jnp.asarray(u)))

    @property
    @double_precision
    def explanation(self) -> str:
        """Why the fit stopped, with the parameters and statistics concerned; of one fit."""
        predicted, jacobian = np.asarray(self.predicted), np.asarray(self.jacobian)
        if not np.isfinite(predicted).all():
            name = self.data.names[int(np.argmin(np.isfinite(predicted)))]
            return f"A predicted statistic is not finite ({name}); the estimate is of no use."
        if not np.isfinite(jacobian).all():
            row, column = np.argwhere(~np.isfinite(jacobian))[0]
            slope = f"The slope of {self.data.names[row]} by {self.names[column]}"
            return f"{slope} is not finite; the estimate is of no use."
        count = f"{int(self.steps)} step" + ("s" if int(self.steps) != 1 else "")
        if self.rounds is not None:
            number = int(self.rounds[-1])
            count += f" in {number} round" + ("s" if number != 1 else "")
        if bool(self.status == FitStatus.max_steps):
            of = "" if self.rounds is None else " of a round"
            sentence = f"Stopped at the limit of steps{of} (`max_steps`), after {count}."
        elif bool(self.status == FitStatus.max_rounds):
            sentence = f"Stopped at the limit of rounds, the last of which still moved: {count}."
        elif bool(self.converged):
            sentence = f"Converged after {count}."
        else:
            sentence = FitStatus[self.status]  # type: ignore[misc]
        for found, what in (
            (self.space.at_bound(self.estimate), "At a bound: {}."),
            (
                _flat(self.space, self.jacobian),
                "No statistic depends on {}: flat, left at the prior.",
            ),
        ):
            named = [name for name, at in zip(self.names, np.asarray(found)) if at]
            more = f" and {len(named) - 3} more" if len(named) > 3 else ""
            sentence += f" {what.format(', '.join(named[:3]) + more)}" if named else ""
        return sentence

    @double_precision
    def quantiles(self, *shares: float) -> Float[Array, "share free"]:
        """Quantiles of each parameter by the Laplace approximation, in its own unit.

        Within the bounds, as a standard deviation on either side need not be.
        """
        sd = jnp.sqrt(self.space.own_variance(self.covariance))
        return self.space.quantiles_about(self.whitened, sd, *shares)

    def well_constrained(self, least: float = WELL_CONSTRAINED) -> tuple[str, ...]:
        """Parameters whose variance the data cut by the share `least` or more; by default those
        whose standard deviation they at least halve."""
        return well_constrained(self.names, np.asarray(self.constrained), least)

    @double_precision
    def marginal(
        self,
        deviations: Float[Array, "draw statistic"],
        jacobians: Float[Array, "draw statistic free"],
    ) -> "FitResult":
        """The same estimate, with the uncertainty that chance in the model leaves.

        What a model draws at random is not what the data were drawn from, so only what another
        draw would repeat is information (`repeated_information`). Errors of the data grow by the
        scatter of the statistics (`Data.with_scatter`).

        **Arguments:** `deviations`, how far the statistics at the estimate lie from the model's in
        other draws; `jacobians`, their derivatives there, as in `jacobian`.
        """
        data = self.data.with_scatter(deviations)
        draws = jax.vmap(data.whiten)(jnp.concatenate([self.jacobian[None], jacobians]))
        return self.with_information(repeated_information(draws))

    @double_precision
    def with_information(self, information: Float[Array, "free free"]) -> "FitResult":
        """The same estimate, with the uncertainty that this information about the whitened
        coordinates leaves."""
        return dataclasses.replace(self, **_posterior(self.space, self.whitened, information))

    def weakly_constrained_directions(self, count: int = 3) -> list[dict[str, float]]:
        """The combinations of parameters that the data say least about, main members only."""
        return main_members(self.names, np.asarray(self.modes)[::-1][:count])


_SHOWN = 10
"""Most parameters that a fit prints."""


def known_lines(
    names: Sequence[str], known: Sequence[str], interval: Float[np.ndarray, "3 free"]
) -> str:
    """Which of the parameters are `known` twice as well as before, or all of a few, in lines: the
    `interval` of middle, 5 and 95 % quantile, here in the unit of field crews."""
    free = len(names)
    if not known:
        line = f"Of {free} free parameters none is known twice as well as before"
        if free > _SHOWN:
            return f"{line}."
        lines, known = [f"{line}:"], names
    else:
        shown = "" if len(known) <= _SHOWN else f", of which {_SHOWN} are"
        lines = [
            f"Of {free} free parameters {len(known)} are known twice as well as before{shown}:"
        ]
    for name in known[:_SHOWN]:
        record = PARAMETERS.get(parameter_kind(name))
        factor = 1.0 if record is None else record.shown_factor
        unit = "" if record is None or record.shown_unit == "-" else f" {record.shown_unit}"
        middle, low, high = factor * interval[:, names.index(name)]
        lines.append(f"  {name} {middle:.4g} [{low:.4g}, {high:.4g}]{unit}")
    return "\n".join(lines)


_SLIGHT = 0.05
"""A smaller weight is no member of a direction of length one."""


def main_members(
    names: tuple[str, ...], modes: Float[np.ndarray, "mode free"]
) -> list[dict[str, float]]:
    """The four parameters at most that each direction is mostly made of, with their weights."""
    return [
        {names[i]: float(mode[i]) for i in np.argsort(-np.abs(mode))[:4] if abs(mode[i]) >= _SLIGHT}
        for mode in modes
    ]


@partial(jax.jit, static_argnames="confidence")
def repeated_information(
    draws: Float[Array, "draw statistic free"], *, confidence: float = 0.975
) -> Float[Array, "free free"]:
    """Fisher information of what every draw of a random model repeats.

    The mean of the products of two *different* draws' derivatives, since in the product of one
    with itself the chance part of a slope counts as knowledge. That mean may have negative
    eigenvalues. They are set to zero with each parameter in units of its slopes' size, lest one
    whose slopes are all chance drown the others. Each is then scaled to its own mean, less what
    chance alone exceeds in one case of forty: so many standard errors of the mean over the pairs
    (Student's t). Two draws make one pair, which says nothing of its error: then nothing counts as
    known, unless the mean itself is asked for.

    **Arguments:** `draws`, derivatives of the whitened statistics in each draw; `confidence`, that
    what counts as known is no chance [-]: at 0.5 it is the mean itself.
    """
    total, count = draws.sum(axis=0), draws.shape[0]
    same = jnp.einsum("dsi,dsj->ij", draws, draws)
    # Products of all pairs less those of a draw with itself.
    shared = (total.T @ total - same) / (count * (count - 1))
    size = jnp.sqrt(jnp.diagonal(same) / count)
    unit = jnp.where(size > 0, 1.0 / jnp.where(size > 0, size, 1.0), 0.0)
    values, vectors = jnp.linalg.eigh(shared * unit * unit[:, None])
    # The nearest matrix that can be an information: no negative eigenvalues.
    kept = (vectors * jnp.maximum(values, 0.0)) @ vectors.T
    first, second = jnp.triu_indices(count, 1)
    pairs = jnp.sum(draws[first] * draws[second], axis=1)  # [pair, free]
    if confidence == 0.5:
        own = jnp.maximum(jnp.diagonal(shared), 0.0)
    elif count < 3:
        own = jnp.zeros_like(size)
    else:
        error = jnp.std(pairs, axis=0, ddof=1) / np.sqrt(len(pairs))
        own = jnp.maximum(jnp.diagonal(shared) - stdtrit(count - 1, confidence) * error, 0.0)
    # Without them the diagonal has grown: each parameter goes back to its own mean.
    raised = jnp.diagonal(kept)
    scale = jnp.sqrt(own / jnp.where(raised > 0, raised, 1.0)) * (raised > 0)
    return kept * scale * scale[:, None]


def _flat(space: ParameterSpace, jacobian: Array) -> Bool[Array, " free"]:
    """Parameters on which no statistic depends."""
    size = jnp.max(jnp.abs(jacobian), axis=0, initial=0.0)
    if space.mixing is None:
        return size == 0.0
    # Of its own slopes, which those by shared coordinates mix; to the rounding of the solution.
    own = jnp.linalg.solve(space.mixing, jacobian.T).T
    return jnp.max(jnp.abs(own), axis=0, initial=0.0) <= 1e-9 * jnp.max(size, initial=0.0)


class Ended(eqx.Module):
    """Where a solver ended, and what the model says there."""

    u: Float[Array, " free"]
    """Whitened coordinates."""
    predicted: Float[Array, " statistic"]
    """Statistics there."""
    jacobian: Float[Array, "statistic free"]
    """Derivatives of the statistics by the whitened coordinates there."""
    status: Any
    """Why it ended, a `FitStatus`."""
    steps: Int[Array, ""]
    """Steps that it took."""
    trace: Float[Array | np.ndarray, "evaluation 2"]
    """Objective and norm of its gradient, as `FitResult` has them."""
    rounds: Int[Array | np.ndarray, " evaluation"] | None = None
    """Round of each evaluation of a calibration, from 1."""


def fit_result(space: ParameterSpace, data: Data, end: Ended) -> FitResult:
    """The result of a fit that ended: uncertainty, and what there is to doubt."""
    u, predicted, jacobian, status = end.u, end.predicted, end.jacobian, end.status
    estimate = space.physical(u)
    for found, doubt in (
        (_flat(space, jacobian), FitStatus.flat),
        (space.at_bound(estimate), FitStatus.at_bound),
    ):
        # Bounds go before what is flat: they are set last.
        doubtful = jnp.any(found) & ((status == FitStatus.successful) | (status == FitStatus.flat))
        status = FitStatus.where(doubtful, doubt, status)
    finite = jnp.isfinite(predicted).all() & jnp.isfinite(jacobian).all()
    status = FitStatus.where(finite, status, FitStatus.not_finite)
    scaled = jnp.where(finite, data.whiten(jacobian), 0.0)
    return FitResult(
        space=space,
        data=data,
        whitened=u,
        estimate=estimate,
        predicted=predicted,
        jacobian=jacobian,
        loss=end.trace[:, 0],
        gradient_norm=end.trace[:, 1],
        status=status,
        steps=end.steps,
        rounds=end.rounds,
        **_posterior(space, u, scaled.T @ scaled),
    )


@eqx.filter_jit
def _posterior(space: ParameterSpace, u: Array, information: Array) -> dict[str, Any]:
    """Laplace approximation, from the data's information in whitened coordinates."""
    values, vectors = jnp.linalg.eigh(information)
    values, vectors = jnp.maximum(values[::-1], 0.0), vectors[:, ::-1]
    # The prior has the information one in every direction.
    covariance = (vectors / (1.0 + values)) @ vectors.T
    variance = space.own_variance(covariance)
    return {
        "sd": space.spread(u, jnp.sqrt(variance)),
        # Data never widen this; below zero it is rounding.
        "constrained": jnp.maximum(1.0 - variance, 0.0),
        "covariance": covariance,
        "information": values,
        "modes": vectors.T,
    }

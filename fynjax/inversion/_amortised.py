"""Amortised posteriors: a regression from spectra to what made them, with uncertainty.

Trained once on simulations, applied to any number of pixels. Quantities are regressed as normal
scores of the prior, so that no interval leaves the range of the prior; a small network gives
their mean and covariance (a density network, Bishop 1994; as posterior estimation from simulations,
Papamakarios and Murray 2016, arXiv:1605.06376).

How unlike the simulations a spectrum is, two distances measure. Along the few directions in
which simulations spread more than the errors, it is that to the nearest of them in units of the
errors (as the area of applicability of Meyer and Pebesma 2021, doi:10.1111/2041-210X.13650):
simulations fill no ellipsoid there, and one around them all would hold much that none is like.
Along all others it is the Mahalanobis distance of what is left (the Q statistic of Jackson and
Mudholkar 1979, doi:10.1080/00401706.1979.10489779): in a sum of both, the long tail of the few
would hide it.
"""

from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int
from scipy.special import ndtr

from fynjax._core.extras import require
from fynjax._core.precision import double_precision
from fynjax._core.progress import track
from fynjax._core.seeds import generator

DARKEST = 0.005
"""Reflectance below which its logarithm says nothing [-]."""
OWN_SD, OFFSET_SD = 0.01, 0.003
"""Error of each channel for itself, as a factor, and of all together, as a reflectance [-]."""
_SCORES = np.linspace(-4.0, 4.0, 161)
_PROBABILITY = np.linspace(0.0, 0.9995, 2000)
_FOLDS = 7
"""Parts of the stands, each left out once to see how far what is not trained with lies."""
_POINTS = 512
"""Simulations that stand for all: more do not change what is masked, and cost time."""
_NODES, _WEIGHTS = np.polynomial.hermite_e.hermegauss(9)
_STEADY = 1e-3
"""Least standard deviation of a normal score."""


class AmortisedPosterior(eqx.Module):
    """Posterior of quantities, given a spectrum. `train_posterior` makes one."""

    middle: Float[Array, " channel"]
    """Mean logarithm of reflectance of the simulations."""
    rows: Float[Array, "feature channel"]
    """Makes features of deviations from that."""
    within: Float[Array, "direction channel"]
    """Makes coordinates of these deviations, in units of the errors, along the directions in which
    simulations spread more than the errors."""
    points: Float[Array, "point direction"]
    """Simulations there: every other is near one of them."""
    outside: Float[Array, "rest channel"]
    """Makes coordinates along all other directions, of unit covariance for simulations."""
    layers: tuple[tuple[Float[Array, "in out"], Float[Array, " out"]], ...]
    """Weights and offsets of the network."""
    values: Float[Array, "quantity score"]
    """Quantities at even steps of their normal scores from -4 to 4."""
    distance: Float[Array, "2 probability"]
    """Quantiles of both distances of simulations from those of the other folds, 0 to 0.9995 in
    steps of 0.0005 [-]."""

    def scores(
        self, log_reflectance: Float[Array, "pixel channel"]
    ) -> tuple[Float[Array, "pixel quantity"], Float[Array, "pixel quantity quantity"]]:
        """Mean of the normal scores, and a factor L of their covariance L L'."""
        x = (log_reflectance - self.middle) @ self.rows.T
        for weight, offset in self.layers[:-1]:
            x = jax.nn.silu(x @ weight + offset)
        weight, offset = self.layers[-1]
        out = x @ weight + offset
        count = self.values.shape[0]
        mean, lower = out[:, :count], out[:, count:]
        factor = jnp.zeros((len(out), count, count), out.dtype)
        # The network gives a Cholesky factor: its diagonal positive, below it anything.
        factor = factor.at[:, *np.tril_indices(count, -1)].set(lower[:, count:])
        diagonal = jax.nn.softplus(lower[:, :count]) + _STEADY
        return mean, factor + diagonal[:, :, None] * jnp.eye(count, dtype=out.dtype)

    def unlikeness(
        self, log_reflectance: Float[Array, "pixel channel"], probability: float | Array = 0.99
    ) -> Float[Array, " pixel"]:
        """The larger of both distances, each over its limit [-]: above 1 a spectrum is unlike
        nearly all simulations. Limits are such that the share `probability` of simulations is below
        1, each left out with its fold of the stands, if both distances are independent."""
        # Two independent distances are both within their limits with the product of probabilities.
        share = jnp.sqrt(jnp.asarray(probability, self.distance.dtype))
        limits = jax.vmap(lambda row: jnp.interp(share, jnp.asarray(_PROBABILITY, float), row))(
            self.distance
        )
        return jnp.max(self.distances(log_reflectance) / limits, axis=1)

    def distances(self, log_reflectance: Float[Array, "pixel channel"]) -> Float[Array, "pixel 2"]:
        """From the nearest simulation within the directions of all, and outside of these [-]."""
        return _distances(log_reflectance - self.middle, self.within, self.points, self.outside)


class PixelEstimates(eqx.Module):
    """Posterior of the quantities of pixels, each in its unit."""

    mean: Float[Array, "pixel quantity"]
    sd: Float[Array, "pixel quantity"]
    lower: Float[Array, "pixel quantity"]
    """5 % quantile."""
    upper: Float[Array, "pixel quantity"]
    """95 % quantile."""
    unlikeness: Float[Array, " pixel"]
    """See `AmortisedPosterior.unlikeness`."""


@eqx.filter_jit
@double_precision
def estimate_pixels(
    posterior: AmortisedPosterior,
    reflectance: Float[Array, "pixel channel"],
    probability: float | Array = 0.99,
    interval: float | Array = 0.9,
) -> PixelEstimates:
    """Quantities of pixels from their channels.

    **Arguments:**

    - `posterior`: from `train_posterior`.
    - `reflectance`: mean of each channel [-]; NaN in gives NaN out.
    - `probability`: of the limit of `unlikeness`.
    - `interval`: share of the posterior between `lower` and `upper`.
    """
    spectrum = jnp.log(jnp.maximum(reflectance, DARKEST))
    mean, factor = posterior.scores(spectrum)
    sd = jnp.sqrt(jnp.sum(factor**2, axis=2))
    reach = jax.scipy.stats.norm.ppf(0.5 + 0.5 * jnp.asarray(interval, mean.dtype))
    # Mean and deviation in the quantity's own unit by Gauss-Hermite quadrature of its scores.
    at = [mean + sd * float(node) for node in _NODES] + [mean - reach * sd, mean + reach * sd]
    *nodes, lower, upper = (_value(posterior.values, z) for z in at)
    weights = _WEIGHTS / _WEIGHTS.sum()
    share = jnp.asarray(weights, mean.dtype)
    first = jnp.tensordot(share, jnp.stack(nodes), axes=1)
    second = jnp.tensordot(share, (jnp.stack(nodes) - first) ** 2, axes=1)
    return PixelEstimates(
        first, jnp.sqrt(second), lower, upper, posterior.unlikeness(spectrum, probability)
    )


def _value(
    values: Float[Array, "quantity score"], z: Float[Array, "pixel quantity"]
) -> Float[Array, "pixel quantity"]:
    """Quantities at normal scores."""
    step = float(_SCORES[1] - _SCORES[0])
    place = jnp.clip((z - _SCORES[0]) / step, 0.0, len(_SCORES) - 1.0)
    # NaN stays NaN through `place`; its index must be a number all the same.
    below = jnp.clip(jnp.nan_to_num(jnp.floor(place)).astype(jnp.int32), 0, len(_SCORES) - 2)
    which = jnp.arange(values.shape[0])
    low, high = values[which, below], values[which, below + 1]
    return low + (high - low) * (place - below)


@dataclass(frozen=True)
class HeldOut:
    """How the regression does on simulations that it was not trained with."""

    count: int
    coverage: Float[np.ndarray, "interval quantity"]
    """Share of the truths inside the central intervals of `INTERVALS` [-]."""
    rmse: Float[np.ndarray, " quantity"]
    explained: Float[np.ndarray, " quantity"]
    """Share of the variance of the simulations [-]."""


INTERVALS = (0.5, 0.68, 0.9)
"""Central intervals whose coverage is held against the truth."""


_HELD_OUT = 0.15
"""Share of the simulations, the last, that is kept for the test [-]."""


@dataclass(frozen=True)
class NetworkSettings:
    """Size of the network, and how long it is trained."""

    features: int = 16
    """Combinations of channels that the network sees, at most."""
    width: int = 96
    """Width of its two hidden layers."""
    steps: int = 6000
    """Steps of the optimisation; errors are drawn anew in each."""
    batch: int = 1024
    """Simulations in a step."""


@double_precision
def train_posterior(
    reflectance: Float[np.ndarray, "stand channel"],
    quantities: Float[np.ndarray, "stand quantity"],
    error: Float[np.ndarray, "channel channel"],
    *,
    together: int = 1,
    training: NetworkSettings | None = None,
    seed: int = 0,
) -> tuple[AmortisedPosterior, HeldOut]:
    """Train a regression from spectra to what made them.

    **Arguments:**

    - `reflectance`: of the simulations, without errors [-].
    - `quantities`: what made them, each in its unit.
    - `error`: covariance of the logarithm of reflectance by which real spectra differ from
      simulated ones.
    - `together`: each so many simulations that follow each other share a stand, and are held out
      together.
    - `training`: size of the network and steps; as `NetworkSettings` has them by default.
    - `seed`: of the errors and the start.

    **Returns:** the posterior, and how it does on the last 15 % of the simulations, held out.

    **Raises:** `MissingExtraError` without optax.
    """
    optax: Any = require("optax", "map")
    training = NetworkSettings() if training is None else training
    rng = generator(seed, 7)
    groups = len(reflectance) // together
    train = together * max(groups - max(round(_HELD_OUT * groups), 1), 1)
    root = np.linalg.cholesky(error + OWN_SD**2 * np.eye(len(error)))
    values = _tables(quantities[:train])
    target = np.stack([np.interp(q, t, _SCORES) for q, t in zip(quantities.T, values)], axis=1)
    logs = _with_errors(reflectance, root, rng)
    middle = logs[:train].mean(axis=0)
    clean = np.log(np.maximum(reflectance, DARKEST))
    rows = _directions(clean[:train] - clean[:train].mean(axis=0), root)[1][: training.features]
    # Features of unit scale, as the network is started for.
    rows = rows / np.std((logs[:train] - middle) @ rows.T, axis=0)[:, None]
    single = lambda a: jnp.asarray(a, jnp.float32)  # noqa: E731
    count = quantities.shape[1]
    sizes = [len(rows), training.width, training.width, count + count * (count + 1) // 2]
    layers = tuple(
        (single(rng.normal(size=(a, b)) / np.sqrt(a) * (0.1 if b == sizes[-1] else 1.0)),
         single(np.zeros(b)))
        for a, b in pairwise(sizes)
    )  # fmt: skip
    # Limits are set by the few farthest stands: of those held out alone they would be chance.
    fold = np.arange(len(logs)) // together * _FOLDS // groups
    apart = _left_out(root, clean - middle, logs - middle, fold)
    known = _known(root, clean[:train] - middle, logs[:train] - middle)
    within, points, outside = map(single, known)
    posterior = AmortisedPosterior(
        single(middle), single(rows), within, points, outside, layers,
        single(values), single(np.quantile(apart, _PROBABILITY, axis=0).T),
    )  # fmt: skip
    data = single(reflectance[:train]), single(target[:train])
    posterior = _optimised(optax, posterior, data, single(root), training, seed)
    return posterior, _held_out(posterior, np.exp(logs[train:]), quantities[train:])


def _tables(quantities: Float[np.ndarray, "stand quantity"]) -> Float[np.ndarray, "quantity score"]:
    """Quantities at even steps of their normal scores; strictly rising."""
    share = ndtr(_SCORES)
    tables = np.quantile(quantities, share, axis=0).T
    scale = np.ptp(tables, axis=1, keepdims=True)
    # Where many simulations have one value, a table would be flat and have no inverse.
    return tables + 1e-6 * scale * np.linspace(0.0, 1.0, len(_SCORES))


def _with_errors(
    reflectance: Float[np.ndarray, "stand channel"], root: np.ndarray, rng: np.random.Generator
) -> Float[np.ndarray, "stand channel"]:
    apart = rng.normal(size=reflectance.shape) @ root.T
    offset = OFFSET_SD * rng.normal(size=(len(reflectance), 1))
    return np.log(np.maximum(reflectance * np.exp(apart) + offset, DARKEST))


def _directions(
    apart: Float[np.ndarray, "stand channel"], root: np.ndarray
) -> tuple[Float[np.ndarray, " direction"], Float[np.ndarray, "direction channel"]]:
    """Combinations of channels with errors of unit covariance, and the variance of simulations in
    each, the largest first."""
    # Principal components in units of the errors: a variance above one stands out from them.
    whitened = np.linalg.solve(root, apart.T)
    vectors, spread, _ = np.linalg.svd(whitened @ whitened.T / len(apart))
    return spread, np.linalg.solve(root.T, vectors).T


def _known(
    root: np.ndarray,
    clean: Float[np.ndarray, "stand channel"],
    logs: Float[np.ndarray, "stand channel"],
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """`within`, `points` and `outside` of simulations, as deviations without and with errors."""
    spread, directions = _directions(clean - clean.mean(axis=0), root)
    few = int(np.clip(np.sum(spread > 1.0), 1, len(spread) - 1))
    within, outside = directions[:few], directions[few:]
    left = np.atleast_2d(np.cov(logs @ outside.T, rowvar=False))
    # To unit covariance of simulations, errors included.
    outside = np.linalg.solve(np.linalg.cholesky(left), outside)
    return within, _spread_out(clean @ within.T), outside


def _left_out(
    root: np.ndarray,
    clean: Float[np.ndarray, "stand channel"],
    logs: Float[np.ndarray, "stand channel"],
    fold: Int[np.ndarray, " stand"],
) -> Float[np.ndarray, "stand 2"]:
    """Both distances of each simulation from those of the other folds."""
    apart = np.empty((len(logs), 2))
    for one in np.unique(fold):
        others = fold != one
        apart[~others] = _distances(logs[~others], *_known(root, clean[others], logs[others]))
    return apart


def _distances(apart: Any, within: Any, points: Any, outside: Any) -> Float[Array, "pixel 2"]:
    at = apart @ within.T
    # |a - p|^2 = |p|^2 - 2 a p + |a|^2, without an array over pixels, points and directions.
    squares = jnp.sum(points**2, axis=1) - 2.0 * at @ points.T
    nearest = jnp.min(squares, axis=1) + jnp.sum(at**2, axis=1)
    left = jnp.sum((apart @ outside.T) ** 2, axis=1)
    return jnp.sqrt(jnp.maximum(jnp.stack([nearest, left], axis=1), 0.0))


def _spread_out(
    points: Float[np.ndarray, "stand direction"],
) -> Float[np.ndarray, "point direction"]:
    """Some of the points, each the farthest from those before it (Gonzalez 1985,
    doi:10.1016/0304-3975(85)90224-5), so that no point is far from them."""
    squares = lambda i: np.sum((points - points[i]) ** 2, axis=1)  # noqa: E731
    chosen = [int(np.argmin(np.sum((points - points.mean(axis=0)) ** 2, axis=1)))]
    nearest = squares(chosen[0])
    for _ in range(min(_POINTS, len(points)) - 1):
        chosen.append(int(np.argmax(nearest)))
        nearest = np.minimum(nearest, squares(chosen[-1]))
    return points[chosen]


def _optimised(
    optax: Any,
    posterior: AmortisedPosterior,
    data: tuple[Array, Array],
    root: Array,
    training: NetworkSettings,
    seed: int,
) -> AmortisedPosterior:
    schedule = optax.cosine_decay_schedule(3e-3, training.steps)
    optimiser = optax.chain(optax.clip_by_global_norm(1.0), optax.adamw(schedule))
    size = min(training.batch, len(data[0]))

    def loss(layers: Any, key: Array) -> Array:
        which, own, common = jax.random.split(key, 3)
        place = jax.random.randint(which, (size,), 0, len(data[0]))
        reflectance, target = data[0][place], data[1][place]
        # As a sensor might have it: wrong by the error model, and offset alike in all bands.
        apart = jax.random.normal(own, reflectance.shape, reflectance.dtype) @ root.T
        offset = OFFSET_SD * jax.random.normal(common, (size, 1), reflectance.dtype)
        spectrum = jnp.log(jnp.maximum(reflectance * jnp.exp(apart) + offset, DARKEST))
        mean, factor = eqx.tree_at(lambda p: p.layers, posterior, layers).scores(spectrum)
        # Minus the logarithm of a Gaussian density whose covariance has the Cholesky factor.
        left = jax.scipy.linalg.solve_triangular(factor, (target - mean)[..., None], lower=True)
        diagonal = jnp.diagonal(factor, axis1=1, axis2=2)
        return jnp.mean(0.5 * jnp.sum(left**2, axis=(1, 2)) + jnp.sum(jnp.log(diagonal), axis=1))

    @jax.jit
    def some(state: Any, keys: Array) -> Any:
        def one(state: Any, key: Array) -> tuple[Any, None]:
            layers, memory = state
            change, memory = optimiser.update(jax.grad(loss)(layers, key), memory, layers)
            return (optax.apply_updates(layers, change), memory), None

        return jax.lax.scan(one, state, keys)[0]

    state = posterior.layers, optimiser.init(posterior.layers)
    # In parts of one length, between which progress is shown: one program serves them all.
    parts = min(100, training.steps)
    keys = jax.random.split(jax.random.key(seed), (parts, -(-training.steps // parts)))
    for some_keys in track([*keys], "Train"):
        state = some(state, some_keys)
    return eqx.tree_at(lambda p: p.layers, posterior, state[0])


def _held_out(
    posterior: AmortisedPosterior,
    reflectance: Float[np.ndarray, "stand channel"],
    truth: Float[np.ndarray, "stand quantity"],
) -> HeldOut:
    spectra = jnp.asarray(reflectance, jnp.float32)
    coverage = []
    for interval in INTERVALS:
        found = estimate_pixels(posterior, spectra, 0.99, interval)
        inside = (truth >= np.asarray(found.lower)) & (truth <= np.asarray(found.upper))
        coverage.append(inside.mean(axis=0))
    rmse = np.sqrt(np.mean((np.asarray(found.mean) - truth) ** 2, axis=0))
    explained = 1.0 - rmse**2 / np.var(truth, axis=0)
    return HeldOut(len(truth), np.stack(coverage), rmse, explained)

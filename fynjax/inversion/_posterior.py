"""The posterior of parameters by sampling, or by the Gaussian about the best fit."""

import hashlib
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from fynjax._core.errors import InputError
from fynjax._core.extras import require
from fynjax._core.precision import require_double_precision
from fynjax._core.progress import advance, stage
from fynjax._core.sampling import Draws, ensemble, hamiltonian
from fynjax.inversion._fit import fit
from fynjax.inversion._fit_result import Data, FitResult
from fynjax.inversion._log_posterior import LogPosterior, Predict
from fynjax.inversion._posterior_result import Posterior
from fynjax.inversion._space import ParameterSpace
from fynjax.inversion._vectorised import evaluate_batches, evaluate_many, memory_batch

SamplingMethod = Literal["emcee", "nuts", "laplace"]
"""How draws from a posterior are made."""
_WALKERS, _CHAINS = 32, 4
_FLAT = 0.01
"""Information, in units of the prior's, below which a direction counts as flat."""
_NAMED = 3
"""Most flat directions that are named one by one."""


def sample_posterior(
    predict: Predict,
    data: Data,
    space: ParameterSpace,
    *,
    method: SamplingMethod = "emcee",
    start: FitResult | None = None,
    offset: Float[Array, " statistic"] | None = None,
    context: tuple[Any, ...] = (),
    log_prior: Callable[[Float[Array, " free"]], Array] | None = None,
    target: float = 400.0,
    max_steps: int = 10_000,
    chains: int | None = None,
    warmup: int = 200,
    seed: int = 0,
    batch: int | None = None,
    predictive: int = 100,
    checkpoint: str | Path | None = None,
) -> Posterior:
    """Sample the posterior of the free parameters.

    Works in whitened coordinates (`LogPosterior`), from draws of the Gaussian about the best fit.

    **Arguments:**

    - `predict`, `data`, `space`, `offset`, `context`: as `fit` has them; `log_prior` as
      `LogPosterior` has it.
    - `method`: "emcee", an ensemble of walkers (Foreman-Mackey et al. 2013), for up to some ten
      parameters; "nuts", Hamiltonian (Hoffman & Gelman 2014; extra `nuts`), which needs a
      gradient and stands many; "laplace", the Gaussian about the fit, no sampling.
    - `start`: a fit of the same problem; made here if left out.
    - `target`: effective draws to reach, on a chain longer than 50 autocorrelation times;
      `max_steps`: where to give up.
    - `chains`: walkers of the ensemble (32, or four a parameter) or chains of NUTS (4); `warmup`:
      steps in which NUTS tunes its step size.
    - `seed`: of all random numbers. The same seed gives the same draws.
    - `batch`: parameter sets computed at once; what the memory holds if left out.
    - `predictive`: draws whose statistics are computed.
    - `checkpoint`: file that keeps the chain (HDF5 for "emcee", extra `posterior`). A run that was
      interrupted or killed goes on from it, and ends as if it had not been.

    **Returns:** `Posterior`. Its `status` says whether the chain converged, and names directions
    that the data say nothing about. A posterior that is not finite gives no draws and the reason.

    **Raises:** `InputError` for wrong arguments, or a checkpoint of another problem;
    `MissingExtraError` without the packages of the method.
    """
    require_double_precision("`sample_posterior`")
    if method not in ("emcee", "nuts", "laplace"):
        raise InputError(f"`method` must be 'emcee', 'nuts' or 'laplace', but is {method!r}")
    if max_steps < 1 or warmup < 1 or predictive < 1 or not target > 0:
        raise InputError("`max_steps`, `warmup`, `predictive` and `target` must be positive")
    if method == "laplace" and log_prior is not None:
        raise InputError("the Gaussian about the fit is that of the space's prior: no `log_prior`")
    if method == "nuts":
        require("blackjax", "nuts")
    shift = jnp.zeros_like(data.value) if offset is None else jnp.asarray(offset)
    density = LogPosterior(predict, space, data, shift, context, log_prior)
    if start is None:
        with stage("Fit"):
            start = fit(predict, data, space, offset=shift, context=context)
    centre, covariance = np.asarray(start.whitened, float), np.asarray(start.covariance, float)
    parts = (centre, covariance, start.predicted, start.jacobian)
    if not all(np.isfinite(np.asarray(part)).all() for part in parts):
        return _result(density, method, start, _none("the fit to start from is not finite", space))
    if batch is None:
        batch = memory_batch(density, centre)
    random = np.random.default_rng(seed)
    if method == "laplace":
        count = max(int(np.ceil(target)), 2)
        found = _gaussian(centre, covariance, count, random, start)
    else:
        size = _chain_count(method, chains, centre.size)
        begin = random.multivariate_normal(centre, covariance, size, method="eigh")
        path = None if checkpoint is None else Path(checkpoint)
        mark = _signature(density, begin, f"{method} {seed} {warmup}")
        limits: dict[str, Any] = {
            "target": target, "steps": max_steps, "seed": seed, "checkpoint": path,
            "signature": mark,
        }  # fmt: skip
        total = max_steps + (warmup if method == "nuts" else 0)
        with stage(f"Sample by {method}", total):
            limits["report"] = _reporter()
            if method == "emcee":
                found = ensemble(lambda u: evaluate_many(density, u, batch=batch), begin, **limits)
            else:
                found = hamiltonian(density, begin, covariance, warmup=warmup, **limits)
    if not len(found.chain):
        return _result(density, method, start, found)
    flat = found.chain.reshape(-1, centre.size)
    picked = flat[random.integers(0, len(flat), predictive)]
    with stage("Predict", predictive):
        predicted = []
        for some in evaluate_batches(eqx.Partial(_statistics, density), picked, batch=batch):
            predicted.append(some)
            advance(len(some))
    return _result(density, method, start, found, np.concatenate(predicted))


def _statistics(density: LogPosterior, u: Array) -> Array:
    return density.statistics(u)


def _reporter() -> Callable[[int, dict[str, float]], None]:
    done = 0

    def report(steps: int, figures: dict[str, float]) -> None:
        nonlocal done
        advance(steps - done, **figures)  # after a resumption, all that was done before
        done = steps

    return report


def _chain_count(method: str, chains: int | None, free: int) -> int:
    if chains is None:
        return max(_WALKERS, 4 * free) if method == "emcee" else _CHAINS
    if method == "emcee" and chains < 2 * free + 2:
        raise InputError(
            f"an ensemble for {free} parameters needs at least {2 * free + 2} walkers, but "
            f"`chains` is {chains}"
        )
    if chains < 1:
        raise InputError(f"`chains` must be at least 1, but is {chains}")
    return chains


def _signature(density: LogPosterior, begin: np.ndarray, settings: str) -> str:
    """Differs where the problem, the start or the settings do."""
    total = hashlib.sha256(settings.encode())
    total.update("\n".join(density.space.names + density.data.names).encode())
    for leaf in (*jax.tree.leaves(eqx.filter(density, eqx.is_array_like)), begin):
        total.update(np.ascontiguousarray(leaf).tobytes())
    return total.hexdigest()


def _gaussian(
    centre: np.ndarray, covariance: np.ndarray, count: int, random: Any, start: FitResult
) -> Draws:
    chain = random.multivariate_normal(centre, covariance, count, method="eigh")[:, None]
    off = chain[:, 0] - centre
    level = -0.5 * np.einsum("di,di->d", off, np.linalg.solve(covariance, off.T).T)[:, None]
    status = "converged" if start.converged else f"not converged: {start.explanation}"
    return Draws(chain, level, float(count), 1.0, 1.0, status)


def _none(why: str, space: ParameterSpace) -> Draws:
    chain = np.empty((0, 1, len(space.names)))
    return Draws(chain, np.empty((0, 1)), 0.0, np.inf, 0.0, f"failed: {why}")


def _flatness(flat: Sequence[Mapping[str, float]], count: int) -> str:
    """Along which of `count` directions the data say nothing: a few by their largest members."""
    along = "; ".join(", ".join(f"{n} {w:+.2f}" for n, w in one.items()) for one in flat)
    if len(flat) > _NAMED:
        along = f"{len(flat)} of {count} combinations of the parameters"
    return f"flat, the data say nothing along {along}"


def _result(
    density: LogPosterior,
    method: str,
    start: FitResult,
    found: Draws,
    predicted: np.ndarray | None = None,
) -> Posterior:
    # What lies closer than half an autocorrelation time repeats its neighbour.
    thin = max(1, int(found.autocorrelation / 2)) if np.isfinite(found.autocorrelation) else 1
    information = np.asarray(start.information)
    flat = start.weakly_constrained_directions(int((information < _FLAT).sum()))
    status = found.status
    if flat and len(found.chain):
        status = f"{status.rstrip('.')}; {_flatness(flat, len(density.space.names))}"
    return Posterior(
        space=density.space,
        data=density.data,
        whitened=np.swapaxes(found.chain[::thin], 0, 1),
        log_density=found.log_density[::thin].T,
        predicted=np.empty((0, density.data.value.size)) if predicted is None else predicted,
        flat=tuple(tuple(one.items()) for one in flat),
        method=method,
        effective_size=found.effective_size,
        acceptance=found.acceptance,
        converged=found.converged,
        status=status,
    )

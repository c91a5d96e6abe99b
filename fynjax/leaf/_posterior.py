"""The posterior of a leaf by sampling, where the Gaussian about the best fit is in doubt."""

import warnings
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, Literal

import emcee
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from fynjax._core.errors import MissingExtraError
from fynjax._core.progress import NullProgress, Progress
from fynjax.leaf import _levenberg as lm
from fynjax.leaf._coefficients import ProspectVersion
from fynjax.leaf._error_model import ErrorModel
from fynjax.leaf._fit import describe, solve_leaves, trait_variance
from fynjax.leaf._measurement import AbstractMeasurement
from fynjax.leaf._problem import (
    FitDomain,
    Setup,
    binned_data,
    leaf_priors,
    make_setup,
    usable_bins,
)

_STRETCH_WALKERS = 32
_CHECK_EVERY = 200
# A chain shorter than this many autocorrelation times does not know its own autocorrelation time
# (Goodman & Weare 2010; the emcee documentation asks for 50).
_TIMES_TAU = 50.0


class LeafPosterior(eqx.Module):
    """Draws from the posterior of each leaf."""

    names: tuple[str, ...] = eqx.field(static=True)
    """Names of the sampled parameters."""
    samples: Float[np.ndarray, "leaf draw parameter"]
    """Draws in the parameters' units, of the trait a laboratory would measure."""
    transmittance: Float[np.ndarray, "leaf draw bin"]
    """T of the leaf at each draw, with a draw of the model's error that the data leave [-]."""
    effective_size: Float[np.ndarray, " leaf"]
    """Effective number of draws behind the least mixed parameter."""
    status: tuple[str, ...] = eqx.field(static=True)
    """`converged`, or why the draws may not be the posterior."""


@eqx.filter_jit
def _log_density(
    z: Array, free: Array, problem: lm.Problem, system: Array, factors: Any, optics: lm.Optics
) -> Array:
    """Log posterior density at z [walker, free parameter]; fixed parameters keep their prior."""

    def one(z: Array) -> Array:
        whole = problem.prior_mean.at[free].set(z)
        return -lm.cost(whole, problem, factors, system, optics)

    return jax.vmap(one)(z)


def _emcee(
    density: Callable[[Any], Array], start: np.ndarray, target: float, steps: int, seed: int
) -> tuple[np.ndarray, float, str]:
    """Chain [step, walker, parameter] without burn-in, its effective size, and a status."""
    # Differential evolution and snooker moves (ter Braak & Vrugt 2008) instead of the stretch move,
    # which mixes slowly where parameters are correlated.
    moves = [(emcee.moves.DEMove(), 0.8), (emcee.moves.DESnookerMove(), 0.2)]
    sampler = emcee.EnsembleSampler(
        *start.shape, lambda z: np.asarray(density(z)), vectorize=True, moves=moves
    )
    sampler.random_state = np.random.RandomState(seed).get_state()
    state: Any = start
    size, long_enough = 0.0, False
    while sampler.iteration < steps:
        state = sampler.run_mcmc(state, _CHECK_EVERY, skip_initial_state_check=True)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            tau = float(np.max(sampler.get_autocorr_time(tol=0, discard=_CHECK_EVERY // 2)))
        kept = sampler.iteration - _CHECK_EVERY // 2
        size = kept * len(start) / tau if np.isfinite(tau) else 0.0
        long_enough = kept > _TIMES_TAU * tau
        if long_enough and size >= target:
            break
    done = long_enough and size >= target
    status = "converged" if done else "not converged: chain shorter than 50 autocorrelation times"
    return sampler.get_chain(discard=_CHECK_EVERY // 2), size, status


def _nuts(
    density: Callable[[Any], Array], start: np.ndarray, target: float, steps: int, seed: int
) -> tuple[np.ndarray, float, str]:
    """The same by blackjax's NUTS, one chain; needs the extra `nuts`."""
    try:
        import blackjax
    except ImportError as error:
        raise MissingExtraError("blackjax", "nuts") from error

    def one(z: Array) -> Array:
        return density(z[None])[0]

    warm_key, run_key = jax.random.split(jax.random.key(seed))
    draws = int(min(steps, max(200, 2 * target)))
    warmup = blackjax.window_adaptation(blackjax.nuts, one)
    (state, tuned), _ = warmup.run(warm_key, jnp.asarray(start[0]), num_steps=300)
    kernel = blackjax.nuts(one, **tuned)

    def step(state: Any, key: Array) -> tuple[Any, Array]:
        state, _ = kernel.step(key, state)
        return state, state.position

    _, positions = jax.lax.scan(step, state, jax.random.split(run_key, draws))
    chain = np.asarray(positions)[:, None]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        tau = float(np.max(emcee.autocorr.integrated_time(chain, tol=0)))
    size = draws / tau
    status = "converged" if size >= 0.5 * target else "not converged: few effective draws"
    return chain, size, status


def sample_leaf_posterior(
    wavelength: Float[np.ndarray, " band"],
    reflectance: Float[np.ndarray, "leaf band"] | None = None,
    transmittance: Float[np.ndarray, "leaf band"] | None = None,
    *,
    version: ProspectVersion = "D",
    measurement: AbstractMeasurement | None = None,
    domain: FitDomain = "full",
    free: Sequence[str] | None = None,
    outdoor: bool | None = None,
    detector_changes: Sequence[float] = (),
    error_model: ErrorModel | None = None,
    sampler: Literal["emcee", "nuts"] = "emcee",
    draws: int = 400,
    target: float = 400.0,
    max_steps: int = 10_000,
    seed: int = 0,
    progress: Progress | None = None,
) -> LeafPosterior:
    """Sample the posterior that `fit_leaf` approximates by a Gaussian.

    The same likelihood (correlated error of the model, inflated for a leaf that fits badly) and
    priors, in the same unconstrained coordinates. The ensemble starts as draws from that Gaussian
    and stops when it is longer than 50 autocorrelation times and holds `target` effective draws.
    Each draw then receives its share of what measured traits differ by (`TRAIT_DISCREPANCY`).

    **Arguments:** those of `fit_leaf`, and

    - `sampler`: "emcee" (Foreman-Mackey et al. 2013), or "nuts" (Hoffman & Gelman 2014), which
      needs the extra `nuts`.
    - `draws`: how many draws to return for each leaf.
    - `target`: effective draws to reach; `max_steps`: most steps of the ensemble.
    - `seed`: seed of the random numbers.

    **Returns:** `LeafPosterior`. A leaf with less than ten usable bins has NaN.

    **Raises:** `ValueError` as `fit_leaf`; `MissingExtraError` without the sampler's package.
    """
    if sampler not in ("emcee", "nuts"):
        raise ValueError(f'`sampler` must be "emcee" or "nuts", but is {sampler!r}')
    run = _emcee if sampler == "emcee" else _nuts
    progress = NullProgress() if progress is None else progress
    data = binned_data(wavelength, reflectance, transmittance, detector_changes)
    use = usable_bins(data, domain, outdoor)
    random = np.random.default_rng(seed)
    with jax.enable_x64(True), progress.stage("sampling leaves", len(data)):
        setup = make_setup(version, measurement, free, error_model)
        state, problems, _ = solve_leaves(setup, data, use, leaf_priors(setup, data, use))
        columns = np.flatnonzero(np.isin(setup.names, setup.free))
        samples = np.full((len(data), draws, columns.size), np.nan)
        spectra = np.full((len(data), draws, data.shape[2]), np.nan)
        sizes, status = np.zeros(len(data)), []
        for i in range(len(data)):
            if use[i].sum() < 10:
                status.append("failed: fewer than ten usable bands within 450-2400 nm")
                continue
            problem = lm.Problem(*(jnp.asarray(part[i]) for part in problems))
            system = lm.factor_system(jnp.asarray(setup.factors), problem.precision)
            density = partial(
                _log_density, free=jnp.asarray(columns), problem=problem, system=system,
                factors=jnp.asarray(setup.factors), optics=setup.optics,
            )  # fmt: skip
            covariance = np.linalg.inv(state.hessian[i])[np.ix_(columns, columns)]
            walkers = max(_STRETCH_WALKERS, 4 * columns.size)
            start = random.multivariate_normal(state.z[i, columns], covariance, walkers)
            chain, sizes[i], said = run(density, start, target, max_steps, seed + i)
            status.append(said)
            flat = chain.reshape(-1, columns.size)
            picked = flat[random.integers(0, len(flat), draws)]
            samples[i], spectra[i] = _finish(setup, problems, i, columns, picked, random)
            progress.advance(1)
    return LeafPosterior(setup.free, samples, spectra, sizes, tuple(status))


def _finish(
    setup: Setup, problems: lm.Problem, leaf: int, columns: np.ndarray, z: np.ndarray, random: Any
) -> tuple[np.ndarray, np.ndarray]:
    """Draws in their units with the traits' discrepancy, and T with the model's error."""
    count, parameters = len(z), len(setup.names)
    whole = np.tile(problems.prior_mean[leaf], (count, 1))
    whole[:, columns] = z
    many = lm.Problem(*(np.repeat(part[leaf : leaf + 1], count, 0) for part in problems))
    found = describe(setup, many, whole, np.zeros((count, parameters, parameters)))
    inflation = problems.inflation[leaf : leaf + 1]
    moved = whole + np.sqrt(trait_variance(setup, inflation)) * random.normal(size=whole.shape)
    x = np.asarray(lm.to_physical(jnp.asarray(moved), setup.optics))[:, columns]
    # One number for all bands: the error that remains is as good as wholly correlated over a
    # detector, and each band's own distribution is what an interval needs.
    error = random.normal(size=(count, 1)) * np.sqrt(found["variance"])
    return x, np.clip(found["corrected"][:, 1] + error, 0.0, 1.0)

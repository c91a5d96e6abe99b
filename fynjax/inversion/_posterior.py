"""The posterior of parameters by sampling, or by the Gaussian about the best fit."""

import copy
import os
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from fynjax._core.errors import InputError
from fynjax._core.extras import require
from fynjax._core.precision import double_precision
from fynjax._core.progress import advance, stage
from fynjax._core.sampling import ChainState, Draws, Ensemble, Hamiltonian
from fynjax._core.seeds import generator
from fynjax.inversion._data import Data
from fynjax.inversion._fit import fit_function
from fynjax.inversion._fit_result import FitResult
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


@double_precision
def sample_posterior(
    predict: Predict, data: Data, space: ParameterSpace, **options: Any
) -> Posterior:
    """Sample the posterior of the free parameters.

    To watch, keep or stop it go through the states of a `PosteriorSampler`, as this function does.

    **Arguments:** `predict`, `data`, `space` and `options`: those of `PosteriorSampler`.

    **Returns:** `Posterior`. Its `status` says whether the chain converged, and names directions
    that the data say nothing about. A posterior that is not finite gives no draws and the reason.

    **Raises:** as `PosteriorSampler`.
    """
    return PosteriorSampler(predict, data, space, **options).posterior()


class PosteriorSampler:
    """Sampling of the posterior of free parameters, from state to state.

    Works in whitened coordinates (`LogPosterior`), from draws of the Gaussian about the best fit.
    `states` gives a state every 50 steps; from one that was kept the same sampler goes on, and ends
    as if nothing had happened. `posterior` is what a state holds.

    >>> import jax.numpy as jnp
    >>> from fynjax.inversion import Data, ParameterSpace, PosteriorSampler
    >>> data = Data(("sum",), jnp.array([1.0]), jnp.array([0.1]))
    >>> space = ParameterSpace(
    ...     ("x", "y"), jnp.zeros(2), jnp.ones(2), jnp.array([0.4, 0.6]), jnp.full(2, 0.1)
    ... )
    >>> sampler = PosteriorSampler(lambda x: x.sum()[None], data, space, max_steps=150)
    >>> for state in sampler.states():
    ...     last = state  # keep it, or stop here
    >>> len(last.chain), sampler.posterior(last).names
    (150, ('x', 'y'))

    **Arguments:**

    - `predict`, `data`, `space`, `offset`, `context`: as `fit` has them; `log_prior` as
      `LogPosterior` has it.
    - `method`: "emcee", an ensemble of walkers (Foreman-Mackey et al. 2013), for up to some ten
      parameters; "nuts", Hamiltonian (Hoffman & Gelman 2014; extra `posterior`), which needs a
      gradient and stands many; "laplace", the Gaussian about the fit, no sampling.
    - `start`: a fit of the same problem; made here if left out.
    - `target`: effective draws to reach, on a chain longer than 50 autocorrelation times;
      `max_steps`: where to give up.
    - `chains`: walkers of the ensemble (32, or four a parameter) or chains of NUTS (4); `warmup`:
      steps in which NUTS tunes its step size.
    - `seed`: of all random numbers. The same seed gives the same draws.
    - `batch`: parameter sets computed at once; what the memory holds if left out.
    - `predictive`: draws whose statistics are computed.
    - `moves`: proposals of the ensemble, of `emcee.moves`: one, or pairs of one and its weight; by
      default four of differential evolution to one stretch.
    - `backend`: where the ensemble writes every step: of `emcee.backends`, or the path of an HDF5
      file as `emcee.backends.HDFBackend` has it (extra `posterior`). From a chain that is there it
      goes on, with the same draws as if it had not been stopped.

    **Raises:** `InputError` for wrong arguments, and for a `backend` with the chain of another
    posterior; `MissingExtraError` without the packages of the method.
    """

    _draws: Draws
    """Draws where nothing has to be sampled."""
    _sampler: Ensemble | Hamiltonian | None

    @double_precision
    def __init__(
        self,
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
        moves: Any = None,
        backend: Any = None,
    ) -> None:
        if method not in ("emcee", "nuts", "laplace"):
            raise InputError(f"`method` must be 'emcee', 'nuts' or 'laplace', but is {method!r}")
        if max_steps < 1 or warmup < 1 or predictive < 1 or not target > 0:
            raise InputError("`max_steps`, `warmup`, `predictive` and `target` must be positive")
        if method == "laplace" and log_prior is not None:
            raise InputError(
                "the Gaussian about the fit is that of the space's prior: no `log_prior`"
            )
        for name, given in (("moves", moves), ("backend", backend)):
            if given is not None and method != "emcee":
                raise InputError(f"`{name}` is of an ensemble by emcee, not of {method!r}")
        if moves is not None:
            _check_moves(moves)
        if backend is not None:
            backend = _backend_of(backend)
        if method == "nuts":
            require("blackjax", "posterior")
        shift = jnp.zeros_like(data.value) if offset is None else jnp.asarray(offset)
        self._random, self._sampler = generator(seed), None
        self._density = density = LogPosterior(predict, space, data, shift, context, log_prior)
        if start is None:
            with stage("Fit"):
                start = fit_function(predict, data, space, offset=shift, context=context)
        self._method, self._start, self._predictive = method, start, predictive
        self._steps = max_steps + (warmup if method == "nuts" else 0)
        centre, covariance = np.asarray(start.whitened, float), np.asarray(start.covariance, float)
        parts = (centre, covariance, start.predicted, start.jacobian)
        if not all(np.isfinite(np.asarray(part)).all() for part in parts):
            none, why = np.empty((0, 1, centre.size)), "the fit to start from is not finite"
            self._draws = Draws(none, none[..., 0], 0.0, np.inf, 0.0, f"failed: {why}")
            return
        self._batch = memory_batch(density, centre) if batch is None else batch
        if method == "laplace":
            count = max(int(np.ceil(target)), 2)
            self._draws = _gaussian(centre, covariance, count, self._random, start)
            return
        size = _chain_count(method, chains, centre.size)
        # Walkers start scattered as the posterior is: a chain from one place takes long to spread.
        begin = self._random.multivariate_normal(centre, covariance, size, method="eigh")
        of_moves = () if moves is None else (_words_of(moves),)
        self.signed = density, begin, method, seed, warmup, *of_moves
        limits: dict[str, Any] = {"target": target, "steps": max_steps, "seed": seed}
        if method == "emcee":
            # In 64 bits also for who goes on with emcee's sampler.
            many = double_precision(lambda u: evaluate_many(density, u, batch=self._batch))
            self._sampler = Ensemble(many, begin, moves=moves, backend=backend, **limits)
        else:
            self._sampler = Hamiltonian(density, begin, covariance, warmup=warmup, **limits)

    @double_precision
    def states(self, state: ChainState | None = None) -> Iterator[ChainState]:
        """The states from a kept one, which is the first, or else from the start, to the end; none
        where nothing has to be sampled."""
        if self._sampler is None:
            return
        shown = 0
        with stage(f"Sample by {self._method}", self._steps):
            for now in self._sampler.states(state):
                known = np.isfinite(now.effective_size)
                info = {"effective": float(now.effective_size)} if known else {}
                advance(len(now.chain) - shown, **info)
                shown = len(now.chain)
                yield now

    @double_precision
    def posterior(self, state: ChainState | None = None) -> Posterior:
        """What is known at a state; by default at the end, to which it then goes."""
        sampler = None
        if self._sampler is None:
            found = self._draws
        else:
            (end,) = [state] if state is not None else deque(self.states(), maxlen=1)
            found = self._sampler.draws(end)
            if isinstance(self._sampler, Ensemble):
                sampler = self._sampler.emcee(end)
        density, start = self._density, self._start
        if not len(found.chain):
            return _result(density, self._method, start, found, sampler)
        flat = found.chain.reshape(-1, found.chain.shape[-1])
        random = copy.deepcopy(self._random)  # the same figures whenever it is asked
        picked = flat[random.integers(0, len(flat), self._predictive)]
        predicted = []
        with stage("Predict", self._predictive):
            for some in evaluate_batches(density.statistics, picked, batch=self._batch):
                predicted.append(some)
                advance(len(some))
        return _result(density, self._method, start, found, sampler, np.concatenate(predicted))


def _listed(moves: Any) -> list[tuple[Any, float]]:
    """Moves with their weights."""
    each = moves if isinstance(moves, list | tuple) else [moves]
    return [(one[0], one[1]) if isinstance(one, list | tuple) else (one, 1.0) for one in each]


def _words_of(moves: Any) -> str:
    """What tells moves from others, for states that are kept."""
    said = []
    for move, weight in _listed(moves):
        plain = {k: v for k, v in vars(move).items() if isinstance(v, int | float | str)}
        said.append(f"{type(move).__name__} {sorted(plain.items())} {weight:g}")
    return "; ".join(said)


def _check_moves(moves: Any) -> None:
    import emcee  # late: it takes half a second

    for move, _ in _listed(moves):
        if not isinstance(move, emcee.moves.Move):
            raise InputError(
                "`moves` must be of emcee.moves, such as emcee.moves.StretchMove(), or pairs of "
                f"one and its weight, but got {move!r:.60}"
            )


def _backend_of(given: Any) -> Any:
    """A backend of emcee, of an HDF5 file if a path is given."""
    import emcee  # late: it takes half a second

    if isinstance(given, emcee.backends.Backend):
        return given
    if not isinstance(given, str | os.PathLike):
        raise InputError(
            "expected `backend` as the path of an HDF5 file or as of emcee.backends, but got "
            f"{given!r:.60}"
        )
    h5py = require("h5py", "posterior")
    path = Path(given)
    if not path.parent.is_dir():
        raise InputError(f"there is no folder {path.parent} for the chain", file=path)
    if path.exists() and not h5py.is_hdf5(path):
        raise InputError("expected an HDF5 file, or none yet, to keep the chain in", file=path)
    return emcee.backends.HDFBackend(str(path))


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


def _gaussian(
    centre: np.ndarray, covariance: np.ndarray, count: int, random: Any, start: FitResult
) -> Draws:
    chain = random.multivariate_normal(centre, covariance, count, method="eigh")[:, None]
    off = chain[:, 0] - centre
    # Log density of the normal that was drawn from, up to a constant.
    level = -0.5 * np.einsum("di,di->d", off, np.linalg.solve(covariance, off.T).T)[:, None]
    status = "converged" if start.converged else f"not converged: {start.explanation}"
    return Draws(chain, level, float(count), 1.0, 1.0, status)


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
    sampler: Any,
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
        sampler=sampler,
    )

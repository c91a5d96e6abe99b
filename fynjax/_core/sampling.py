"""Two samplers of a posterior: emcee's ensemble and blackjax's NUTS, watched and resumable.

Neither knows what it samples. Both stop when the chain is long against its own autocorrelation
time, say why they stopped, and go on from a checkpoint exactly as if nothing had happened.
"""

import os
import shutil
import time
import warnings
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import emcee
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from fynjax._core.errors import InputError
from fynjax._core.extras import require

Report = Callable[[int, dict[str, float]], None]
"""Called after each step with the steps done so far, and figures to show beside them."""

_CHECK_EVERY = 200
_BURN_IN = 100
# Below this many autocorrelation times the chain is too short to estimate the autocorrelation time
# (Goodman & Weare 2010; the emcee documentation asks for 50).
_TIMES_TAU = 50.0
_R_HAT = 1.1
"""Largest disagreement of chains that count as converged."""
_SAVE_SECONDS = 20.0
"""A kill loses at most so much work (and the step under way); a resumed chain is the same."""
_DIVERGENT = 0.01
_ACCEPTANCE = 0.85


class Draws(NamedTuple):
    """What a sampler returns."""

    chain: Float[np.ndarray, "step chain parameter"]
    """Positions, without burn-in; walkers of an ensemble count as chains."""
    log_density: Float[np.ndarray, "step chain"]
    effective_size: float
    """Effective number of draws behind the least mixed parameter."""
    autocorrelation: float
    """Integrated autocorrelation time of that parameter [steps]."""
    acceptance: float
    """Share of the proposals that were accepted [-]."""
    status: str
    """`converged`, or why the draws may not be the density's."""

    @property
    def converged(self) -> bool:
        """Whether the draws count as the density's."""
        return self.status == "converged"


def ensemble(
    density: Callable[[np.ndarray], np.ndarray],
    start: Float[np.ndarray, "walker parameter"],
    *,
    target: float,
    steps: int,
    seed: int,
    checkpoint: Path | None = None,
    signature: str = "",
    report: Report | None = None,
) -> Draws:
    """Sample by an ensemble of walkers (Foreman-Mackey et al. 2013).

    **Arguments:**

    - `density`: log density of many positions at once, [walker, parameter] to [walker]. Where it
      is not finite the proposal is refused.
    - `start`: positions of the walkers, at least twice as many as parameters.
    - `target`: effective draws to reach, on a chain of 50 autocorrelation times or more.
    - `steps`: most steps, those of an earlier run included.
    - `checkpoint`: HDF5 file of emcee's backend, which the run keeps up to date and starts from
      if it is there; needs h5py. `signature` names what is sampled.

    **Raises:** `InputError` for a checkpoint of something else, or that cannot be read.
    """
    refused = _Refused(density)
    saved = None if checkpoint is None else _EnsembleFile(checkpoint, signature)
    # Differential evolution (ter Braak 2006) mixes well where parameters are correlated, stretches
    # keep the walkers from sharing a subspace. Not emcee's snooker move: up to its version 3.1.6
    # that is no correct step, and leaves standard deviations 5 to 10 % small.
    moves = [(emcee.moves.DEMove(), 0.8), (emcee.moves.StretchMove(), 0.2)]
    backend = None if saved is None else saved.backend
    sampler = emcee.EnsembleSampler(
        *start.shape, refused, vectorize=True, moves=moves, backend=backend
    )
    sampler.log_prob_fn = refused  # emcee's wrapper prints a traceback at an interruption
    if sampler.iteration:
        assert saved is not None
        state, refused.count = sampler.get_last_sample(), saved.refused
    else:
        alive = np.isfinite(refused(start))
        if not alive.any():
            return _nothing(start, "the log density is finite at none of the starting points")
        # A walker that starts where the density is zero takes the place of one that does not.
        place = np.where(alive, np.arange(len(start)), np.argmax(alive))
        state, refused.count = emcee.State(start[place]), 0
        sampler.random_state = np.random.RandomState(seed).get_state()
    judged = None
    while True:
        done = sampler.iteration
        if done >= steps or (done and done % _CHECK_EVERY == 0):
            judged = _judge(_without_burn_in(sampler.get_chain()), target)
            if judged.converged or done >= steps:
                break
        block = min(_CHECK_EVERY - done % _CHECK_EVERY, steps - done)
        for _ in sampler.sample(state, iterations=block, skip_initial_state_check=True):
            done += 1
            if saved is not None:
                saved.keep_up(refused.count)
            if report is not None:
                report(done, {} if judged is None else {"effective": judged.effective_size})
        state = sampler.get_last_sample()
    if saved is not None:
        saved.save(refused.count)
    status = judged.status
    if refused.count:
        status += f"; {refused.count} proposals had a log density that is not a number"
    return judged._replace(
        log_density=sampler.get_log_prob()[-len(judged.chain) :],
        acceptance=float(np.mean(sampler.backend.accepted) / sampler.iteration),
        status=status,
    )


class _Refused:
    """A log density that is minus infinity where the given one is not a number, and a count."""

    def __init__(self, density: Callable[[np.ndarray], np.ndarray]) -> None:
        self._density, self.count = density, 0

    def __call__(self, z: np.ndarray) -> np.ndarray:
        value = np.array(self._density(z), float)
        bad = np.isnan(value) | (value == np.inf)
        self.count += int(bad.sum())
        value[bad] = -np.inf
        return value


class _EnsembleFile:
    """emcee's HDF5 file, worked on in a copy: what is killed while writing is only the copy."""

    def __init__(self, path: Path, signature: str) -> None:
        self._h5py = require("h5py", "posterior")
        self._path = Path(path)
        self._work = self._path.with_name(self._path.name + ".work")
        self._path.parent.mkdir(parents=True, exist_ok=True)
        self._work.unlink(missing_ok=True)
        if self._path.exists():
            shutil.copyfile(self._path, self._work)
        try:
            with self._h5py.File(self._work, "a") as file:
                if not self._path.exists():
                    file.attrs["signature"] = signature
                known = file.attrs.get("signature")
        except OSError as error:
            raise _unreadable(self._path) from error
        if known != signature:
            self._work.unlink(missing_ok=True)
            raise _foreign(self._path)
        self.backend = emcee.backends.HDFBackend(str(self._work))
        self._last = time.monotonic()

    @property
    def refused(self) -> int:
        """Proposals refused so far, earlier runs included."""
        with self._h5py.File(self.backend.filename, "r") as file:
            return int(file.attrs.get("refused", 0))

    def keep_up(self, refused: int) -> None:
        """Save now and then."""
        if time.monotonic() - self._last > _SAVE_SECONDS:
            self._note(refused)
            copy = self._path.with_name(self._path.name + ".copy")
            shutil.copyfile(self._work, copy)
            os.replace(copy, self._path)
            self._last = time.monotonic()

    def save(self, refused: int) -> None:
        """Save for good."""
        self._note(refused)
        os.replace(self._work, self._path)
        self.backend.filename = str(self._path)  # which it opens anew each time

    def _note(self, refused: int) -> None:
        with self._h5py.File(self._work, "a") as file:
            file.attrs["refused"] = refused


def _foreign(path: Path) -> InputError:
    return InputError(
        "this checkpoint is of another problem: other data, parameters, priors, walkers or seed. "
        "Choose another, or remove it to start again",
        file=path,
    )


def _unreadable(path: Path) -> InputError:
    return InputError(
        "this is no checkpoint that can be read. Is it another file, or cut short by a full disk? "
        "Remove it to start again",
        file=path,
    )


def _without_burn_in(chain: np.ndarray) -> np.ndarray:
    """The first steps go, more of them where the chain is slow to forget its start."""
    kept = chain[min(_BURN_IN, len(chain) // 2) :]
    tau = _autocorrelation(kept)
    if np.isfinite(tau) and _BURN_IN < 5 * tau < len(chain) / 2:
        return chain[int(5 * tau) :]
    return kept


def _judge(chain: np.ndarray, target: float) -> Draws:
    """Measures the autocorrelation time, and says whether the chain is long enough."""
    tau = _autocorrelation(chain)
    size = chain.shape[0] * chain.shape[1] / tau
    status = "converged"
    if not len(chain) > _TIMES_TAU * tau:
        status = "not converged: chain shorter than 50 autocorrelation times"
    elif size < target:
        status = f"not converged: {size:.0f} effective draws of {target:.0f}"
    elif (apart := _split_r_hat(chain)) > _R_HAT:
        status = f"not converged: chains disagree, R-hat {apart:.2f}"
    return Draws(chain, np.empty(chain.shape[:2]), size, tau, np.nan, status)


def _split_r_hat(chain: np.ndarray) -> float:
    """Of the worst parameter, chains cut in halves (Gelman et al. 2013, section 11.4)."""
    half = len(chain) // 2
    parts = np.concatenate([chain[:half], chain[half : 2 * half]], axis=1)
    within = parts.var(axis=0, ddof=1).mean(axis=0)
    between = parts.mean(axis=0).var(axis=0, ddof=1)
    return float(np.max(np.sqrt((half - 1) / half + between / within)))


def effective_size(chain: np.ndarray) -> float:
    """Effective number of draws behind the least mixed parameter.

    The smaller of two: by the autocorrelation time, and by how far the means of chains lie apart.
    Chains that are short against their autocorrelation time look as if they had none; their means
    show it. Of chains that never mix it is about their number.

    **Arguments:** `chain`, [step, chain, parameter].
    """
    steps, chains, _ = chain.shape
    apart = chain.mean(axis=0).var(axis=0, ddof=1)
    by_means = chains * chain.var(axis=(0, 1)) / np.maximum(apart, np.finfo(float).tiny)
    return min(steps * chains / _autocorrelation(chain), float(by_means.min()))


def _autocorrelation(chain: np.ndarray) -> float:
    """Of the slowest parameter; infinite where it cannot be estimated or a parameter never
    moved."""
    with warnings.catch_warnings(), np.errstate(invalid="ignore", divide="ignore"):
        warnings.simplefilter("ignore")
        tau = np.asarray(emcee.autocorr.integrated_time(chain, tol=0, quiet=True))
    # Draws that alternate can make it nothing, or less.
    return max(float(np.max(tau)), 0.1) if np.all(np.isfinite(tau)) else np.inf


def _nothing(start: np.ndarray, why: str) -> Draws:
    count, size = start.shape
    return Draws(
        np.empty((0, count, size)), np.empty((0, count)), 0.0, np.inf, 0.0, f"failed: {why}"
    )


# -- Hamiltonian ----------------------------------------------------------------------------


@eqx.filter_jit
def _transitions(
    density: Callable[[Array], Array], mass: Array, key: Array, carry: Any, tuning: Array
) -> tuple[Any, tuple[Array, Array]]:
    """One NUTS transition of every chain, which tunes its step size while `tuning`."""
    import blackjax
    from blackjax.adaptation.step_size import dual_averaging_adaptation

    _, adapt, _ = dual_averaging_adaptation(_ACCEPTANCE)
    kernel = blackjax.nuts.build_kernel()

    def step_chain(chain: tuple[Array, Any, Any]) -> tuple[Any, tuple[Array, Array]]:
        key, state, scale = chain
        log_step = jnp.where(tuning, scale.log_step_size, scale.log_step_size_avg)
        state, info = kernel(key, state, density, jnp.exp(log_step), mass)
        adapted = adapt(scale, info.acceptance_rate)
        scale = jax.tree.map(lambda new, old: jnp.where(tuning, new, old), adapted, scale)
        return (state, scale), (info.acceptance_rate, info.is_divergent)

    states, scales = carry
    keys = jax.random.split(key, states.logdensity.size)
    return jax.lax.map(step_chain, (keys, states, scales))


def hamiltonian(
    density: Callable[[Array], Array],
    start: Float[np.ndarray, "chain parameter"],
    covariance: Float[np.ndarray, "parameter parameter"],
    *,
    target: float,
    steps: int,
    seed: int,
    warmup: int = 200,
    checkpoint: Path | None = None,
    signature: str = "",
    report: Report | None = None,
) -> Draws:
    """Sample by NUTS (Hoffman & Gelman 2014), chain by chain; needs the extra `nuts`.

    **Arguments:** those of `ensemble`, and

    - `density`: differentiable log density of one position. A pytree (an equinox module, or
      `jax.tree_util.Partial`) compiles once for all densities of its structure.
    - `covariance`: about that of the density; its inverse is the mass. Only the step size is
      tuned, by dual averaging (Nesterov 2009) in `warmup` steps, which are left out of the chain.
    - `checkpoint`: a NumPy archive here.
    """
    require("blackjax", "nuts")
    import blackjax
    from blackjax.adaptation.step_size import dual_averaging_adaptation

    position = jnp.asarray(start)
    states = eqx.filter_jit(
        lambda d, z: jax.lax.map(lambda start: blackjax.nuts.init(start, d), z)
    )(density, position)
    finite = np.isfinite(np.asarray(states.logdensity))
    slope = np.isfinite(np.asarray(states.logdensity_grad)).all(axis=1)
    if not (finite & slope).all():
        return _nothing(start, "the log density or its gradient is not finite at a starting point")
    initial, _, _ = dual_averaging_adaptation(_ACCEPTANCE)
    scales = jax.tree.map(
        lambda x: jnp.full(len(start), x), initial(jnp.asarray(0.5, position.dtype))
    )
    carry: Any = (states, scales)
    rows: list[np.ndarray] = []  # [chain, position, log density, acceptance, divergent] of a step
    saved = None if checkpoint is None else _ChainFile(checkpoint, signature)
    if saved is not None and saved.path.exists():
        rows, carry = saved.load(carry)
    key, mass = jax.random.key(seed), jnp.asarray(covariance)
    judged = None
    while True:
        done = len(rows) - warmup
        if done >= steps or (done > 0 and done % _CHECK_EVERY == 0):
            judged = _judge_hamiltonian(rows[warmup:], target)
            if judged.converged or done >= steps:
                break
        carry, (accepted, diverged) = _transitions(
            density, mass, jax.random.fold_in(key, len(rows)), carry, jnp.asarray(done < 0)
        )
        statistics = (carry[0].logdensity, accepted, diverged)
        rows.append(np.column_stack([carry[0].position, *statistics]))
        if saved is not None:
            saved.keep_up(rows, carry)
        if report is not None:
            report(len(rows), {} if judged is None else {"effective": judged.effective_size})
    if saved is not None:
        saved.save(rows, carry)
    return judged


def _judge_hamiltonian(rows: list[np.ndarray], target: float) -> Draws:
    every = np.stack(rows)
    judged = _judge(every[:, :, :-3], target)
    diverged = float(np.mean(every[:, :, -1]))
    if diverged > _DIVERGENT:
        why = "the density has a kink, an edge, or a scale that the covariance lacks"
        status = f"not converged: {100 * diverged:.0f} % of the trajectories diverged; {why}"
        judged = judged._replace(status=status)
    return judged._replace(log_density=every[:, :, -3], acceptance=float(np.mean(every[:, :, -2])))


class _ChainFile:
    """The rows of a chain and what its next step needs, in a NumPy archive."""

    def __init__(self, path: Path, signature: str) -> None:
        self.path, self._signature = Path(path), signature
        self.path.parent.mkdir(parents=True, exist_ok=True)
        self._last = time.monotonic()

    def load(self, like: Any) -> tuple[list[np.ndarray], Any]:
        try:
            with np.load(self.path) as file:
                parts = dict(file)
        except (OSError, ValueError, EOFError, zipfile.BadZipFile) as error:
            raise _unreadable(self.path) from error
        if parts.get("signature") != self._signature:
            raise _foreign(self.path)
        leaves, structure = jax.tree.flatten(like)
        arrays = [jnp.asarray(parts[f"leaf{i}"], leaf.dtype) for i, leaf in enumerate(leaves)]
        return list(parts["rows"]), jax.tree.unflatten(structure, arrays)

    def keep_up(self, rows: list[np.ndarray], carry: Any) -> None:
        if time.monotonic() - self._last > _SAVE_SECONDS:
            self.save(rows, carry)

    def save(self, rows: list[np.ndarray], carry: Any) -> None:
        parts: dict[str, Any] = {
            f"leaf{i}": np.asarray(leaf) for i, leaf in enumerate(jax.tree.leaves(carry))
        }
        parts |= {"rows": np.stack(rows), "signature": np.array(self._signature)}
        work = self.path.with_name(self.path.name + ".work")
        with open(work, "wb") as file:
            np.savez(file, **parts)
        os.replace(work, self.path)
        self._last = time.monotonic()

"""Two samplers of a posterior: emcee's ensemble and blackjax's NUTS.

Neither knows what it samples. Both stop when the chain is long against its own autocorrelation
time, and say why they stopped. They go from state to state: from one that was kept a sampler goes
on exactly as if nothing had happened.
"""

import abc
import dataclasses
import warnings
from collections import deque
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from fynjax._core.errors import InputError
from fynjax._core.extras import require

_BLOCK = 50
"""Steps from one state to the next."""
_CHECK_EVERY = 200
_BURN_IN = 100
# Below this many autocorrelation times the chain is too short to estimate the autocorrelation time
# (Goodman & Weare 2010; the emcee documentation asks for 50).
_TIMES_TAU = 50.0
_R_HAT = 1.1
"""Largest disagreement of chains that count as converged."""
_DIVERGENT = 0.01
_ACCEPTANCE = 0.85


class Draws(NamedTuple):
    """What a sampler returns."""

    chain: Float[np.ndarray, "step chain parameter"]
    """Positions, without burn-in; walkers of an ensemble count as chains."""
    log_density: Float[np.ndarray, "step chain"]
    """Log density at each of the positions."""
    effective_size: float
    """Effective number of draws behind the least mixed parameter."""
    autocorrelation: float
    """Integrated autocorrelation time of the least mixed parameter [steps]."""
    acceptance: float
    """Share of the proposals that were accepted [-]."""
    status: str
    """`converged`, or why the draws may not be the density's."""

    @property
    def converged(self) -> bool:
        """Whether the draws count as the density's."""
        return self.status == "converged"


class ChainState(eqx.Module):
    """Where a sampler is: what it did, and what its next step follows from."""

    chain: Float[np.ndarray, "step chain parameter"]
    """Positions, with those that the draws leave out."""
    log_density: Float[np.ndarray, "step chain"]
    """Log density at each of the positions."""
    accepted: Float[np.ndarray, " chain"]
    """Number of proposals of each chain that were accepted, or the sum of their chances."""
    faulty: Int[np.ndarray, ""]
    """Number of proposals whose log density was not a number, or of trajectories that diverged."""
    effective_size: Float[np.ndarray, ""]
    """Effective number of draws when the chain was last looked at; NaN before."""
    ahead: tuple[Array, ...]
    """Positions, log densities, random numbers or step sizes from which the next step starts; empty
    where there can be no step."""


class _Sampler(abc.ABC):
    """Goes from state to state until a chain is long enough; arguments as of `Hamiltonian`."""

    def __init__(
        self,
        start: Float[np.ndarray, "chain parameter"],
        target: float,
        steps: int,
        warmup: int = 0,
    ) -> None:
        self._start, self._target, self._steps, self._warmup = start, target, steps, warmup

    def states(self, state: ChainState | None = None) -> Iterator[ChainState]:
        """The states from one of them, else from the start, to the end; that one is the first."""
        state = self._first() if state is None else state
        yield state
        while state.ahead:
            done = len(state.chain) - self._warmup
            if done >= self._steps:
                return
            # Looked at a second time only where it may be the end.
            large = done % _CHECK_EVERY == 0 and state.effective_size >= self._target
            if large and self.draws(state).status.startswith("converged"):
                return
            state = self._after(state, min(_BLOCK - done % _BLOCK, self._steps - done))
            done = len(state.chain) - self._warmup
            if done > 0 and done % _CHECK_EVERY == 0:
                size = np.asarray(self.draws(state).effective_size)
                state = dataclasses.replace(state, effective_size=size)
            yield state

    def run(self) -> Draws:
        """The draws at the end."""
        (end,) = deque(self.states(), maxlen=1)
        return self.draws(end)

    def draws(self, state: ChainState) -> Draws:
        """What the chain of a state holds, and whether that is enough."""
        chain = np.asarray(state.chain)[self._warmup :]
        if not len(chain):
            failed = "failed: the log density or its slope is not finite at the starting points"
            status = "not converged: no steps" if state.ahead else failed
            return Draws(chain, chain[..., 0], 0.0, np.inf, 0.0, status)
        kept = self._settled(chain)
        tau = _autocorrelation(kept)
        size = kept.shape[0] * kept.shape[1] / tau
        status = "converged"
        if not len(kept) > _TIMES_TAU * tau:
            status = "not converged: chain shorter than 50 autocorrelation times"
        elif size < self._target:
            status = f"not converged: {size:.0f} effective draws of {self._target:.0f}"
        elif (apart := _split_r_hat(kept)) > _R_HAT:
            status = f"not converged: chains disagree, R-hat {apart:.2f}"
        status = self._doubted(status, int(state.faulty), chain.shape[0] * chain.shape[1])
        level = np.asarray(state.log_density)[-len(kept) :]
        accepted = float(np.mean(state.accepted) / len(chain))
        return Draws(kept, level, size, tau, accepted, status)

    def _begun(self, start: np.ndarray, *ahead: Any) -> ChainState:
        """The state at the start; without what is ahead no step can follow."""
        empty, none = np.zeros((0, *start.shape)), np.zeros(len(start))
        later = tuple(map(jnp.asarray, ahead))
        return ChainState(empty, empty[..., 0], none, np.asarray(0), np.asarray(np.nan), later)

    @abc.abstractmethod
    def _first(self) -> ChainState:
        """The state at the start."""

    @abc.abstractmethod
    def _after(self, state: ChainState, steps: int) -> ChainState:
        """The state so many steps on."""

    def _settled(self, chain: np.ndarray) -> np.ndarray:
        return chain

    @abc.abstractmethod
    def _doubted(self, status: str, faulty: int, proposals: int) -> str:
        """The status of a chain, with what its proposals, some of them faulty, say against it."""


class Ensemble(_Sampler):
    """An ensemble of walkers (Foreman-Mackey et al. 2013), by emcee.

    **Arguments:**

    - `density`: log density of many positions at once, [walker, parameter] to [walker]. Where it
      is not finite the proposal is refused.
    - `start`: positions of the walkers, at least twice as many as parameters.
    - `target`: effective draws to reach, on a chain of 50 autocorrelation times or more.
    - `steps`: most steps.
    - `seed`: of the random numbers.
    - `moves`: of `emcee.moves`, one or pairs of one and its weight; by default four of differential
      evolution to one stretch.
    - `backend`: of `emcee.backends`, which takes every step; in memory by default. The sampler goes
      on from the steps that it holds.

    **Raises:** `InputError` when it begins, for a `backend` of another density or of another number
    of walkers or parameters.
    """

    def __init__(
        self,
        density: Callable[[np.ndarray], np.ndarray],
        start: Float[np.ndarray, "walker parameter"],
        *,
        target: float,
        steps: int,
        seed: int,
        moves: Any = None,
        backend: Any = None,
    ) -> None:
        super().__init__(start, target, steps)
        self._density, self._seed, self._moves = density, seed, moves
        self._backend = backend

    def emcee(self, state: ChainState) -> Any:
        """emcee's sampler after the steps of `state`, from which its `run_mcmc(None, steps)` goes
        on; None where there can be no step."""
        if not state.ahead:
            return None
        import emcee  # late: it takes half a second

        if (backend := self._backend) is None or _steps_of(backend) != len(state.chain):
            backend = emcee.backends.Backend()
            backend.reset(*self._start.shape)
            backend.chain, backend.log_prob = np.asarray(state.chain), np.asarray(state.log_density)
            backend.accepted, backend.iteration = np.array(state.accepted), len(state.chain)
            backend.random_state = _random_of(state)
        # Differential evolution (ter Braak 2006) mixes well where parameters are correlated,
        # stretches keep the walkers from sharing a subspace. Not emcee's snooker move: up to its
        # version 3.1.6 that is no correct step, and leaves standard deviations 5 to 10 % small.
        usual = [(emcee.moves.DEMove(), 0.8), (emcee.moves.StretchMove(), 0.2)]
        moves = usual if self._moves is None else self._moves
        refused = _Refused(self._density)
        sampler = emcee.EnsembleSampler(
            *self._start.shape, refused, vectorize=True, moves=moves, backend=backend
        )
        sampler.log_prob_fn = refused  # emcee's wrapper prints a traceback at an interruption
        return sampler

    def _first(self) -> ChainState:
        if self._backend is not None and self._backend.initialized:
            if self._backend.shape != self._start.shape:
                walkers, parameters = self._backend.shape
                raise InputError(
                    f"the chain in {_said(self._backend)} has {walkers} walkers of {parameters} "
                    f"parameters, but {self._start.shape[0]} of {self._start.shape[1]} go on with "
                    "it: take another file, or state `chains`"
                )
            if self._backend.iteration:
                return self._kept()
        level = _Refused(self._density)(self._start)
        alive = np.isfinite(level)
        if not alive.any():
            return self._begun(self._start)
        # A walker that starts where the density is zero takes the place of one that does not.
        place = np.where(alive, np.arange(len(alive)), np.argmax(alive))
        random: Any = np.random.RandomState(self._seed).get_state()
        return self._begun(self._start, self._start[place], level[place], *random[1:])

    def _kept(self) -> ChainState:
        """The state after the steps that the backend holds."""
        backend = self._backend
        last = backend.get_last_sample()
        again = _Refused(self._density)(last.coords)
        if not np.allclose(again, last.log_prob, rtol=1e-3, atol=1e-2):
            off = np.abs(again - last.log_prob).max()
            raise InputError(
                f"the chain in {_said(backend)} is of another posterior: where its walkers stand "
                f"the log density differs by up to {off:.3g}. Take another file for other data, "
                "priors or free parameters"
            )
        state = ChainState(
            backend.get_chain(),
            backend.get_log_prob(),
            np.array(backend.accepted),
            np.asarray(0),
            np.asarray(np.nan),
            tuple(map(jnp.asarray, (last.coords, last.log_prob, *last.random_state[1:]))),
        )
        return dataclasses.replace(
            state, effective_size=np.asarray(self.draws(state).effective_size)
        )

    def _after(self, state: ChainState, steps: int) -> ChainState:
        import emcee  # late: it takes half a second

        sampler, before = self.emcee(state), len(state.chain)
        if self._backend is not None and sampler.backend is not self._backend:
            raise InputError(
                f"the chain in {_said(self._backend)} has {_steps_of(self._backend)} steps, but it "
                f"was to go on from {before}"
            )
        position, level = map(np.asarray, state.ahead[:2])
        begin = emcee.State(position, log_prob=level, random_state=_random_of(state))
        now = sampler.run_mcmc(begin, steps, skip_initial_state_check=True)
        return ChainState(
            np.concatenate([state.chain, sampler.get_chain(discard=before)]),
            np.concatenate([state.log_density, sampler.get_log_prob(discard=before)]),
            np.array(sampler.backend.accepted),
            np.asarray(state.faulty + sampler.log_prob_fn.count),
            state.effective_size,
            tuple(map(jnp.asarray, (now.coords, now.log_prob, *now.random_state[1:]))),
        )

    def _settled(self, chain: np.ndarray) -> np.ndarray:
        """The first steps go, more of them where the chain is slow to forget its start."""
        kept = chain[min(_BURN_IN, len(chain) // 2) :]
        tau = _autocorrelation(kept)
        if np.isfinite(tau) and _BURN_IN < 5 * tau < len(chain) / 2:
            return chain[int(5 * tau) :]
        return kept

    def _doubted(self, status: str, faulty: int, proposals: int) -> str:
        why = f"; {faulty} proposals had a log density that is not a number"
        return status + why if faulty else status


def _random_of(state: ChainState) -> tuple[Any, ...]:
    """State of NumPy's generator from which the next step of an ensemble starts."""
    key, *rest = map(np.asarray, state.ahead[2:])
    return "MT19937", key, *(one.item() for one in rest)


def _steps_of(backend: Any) -> int:
    return int(backend.iteration) if backend.initialized else 0


def _said(backend: Any) -> str:
    return str(getattr(backend, "filename", "`backend`"))


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


def _split_r_hat(chain: np.ndarray) -> float:
    """R-hat of the worst parameter, chains cut in halves (Gelman et al. 2013, section 11.4)."""
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
    """Autocorrelation time [steps] of the slowest parameter; infinite where it cannot be
    estimated or a parameter never moved."""
    import emcee  # late: it takes half a second

    with warnings.catch_warnings(), np.errstate(invalid="ignore", divide="ignore"):
        warnings.simplefilter("ignore")
        tau = np.asarray(emcee.autocorr.integrated_time(chain, tol=0, quiet=True))
    # Draws that alternate can make it nothing, or less.
    return max(float(np.max(tau)), 0.1) if np.all(np.isfinite(tau)) else np.inf


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


class Hamiltonian(_Sampler):
    """NUTS (Hoffman & Gelman 2014), chain by chain; needs the extra `posterior`.

    **Arguments:** those of `Ensemble`, and

    - `density`: differentiable log density of one position. A pytree (an equinox module, or
      `jax.tree_util.Partial`) compiles once for all densities of its structure.
    - `covariance`: about that of the density; its inverse is the mass. Only the step size is
      tuned, by dual averaging (Nesterov 2009) in `warmup` steps, which are left out of the chain.
    """

    def __init__(
        self,
        density: Callable[[Array], Array],
        start: Float[np.ndarray, "chain parameter"],
        covariance: Float[np.ndarray, "parameter parameter"],
        *,
        target: float,
        steps: int,
        seed: int,
        warmup: int = 200,
    ) -> None:
        require("blackjax", "posterior")
        import blackjax
        from blackjax.adaptation.step_size import dual_averaging_adaptation

        super().__init__(start, target, steps, warmup)
        self._density, self._mass = density, jnp.asarray(covariance)
        self._key = jax.random.key(seed)
        states = eqx.filter_jit(
            lambda d, z: jax.lax.map(lambda start: blackjax.nuts.init(start, d), z)
        )(density, jnp.asarray(start))
        initial, _, _ = dual_averaging_adaptation(_ACCEPTANCE)
        scales = jax.tree.map(
            lambda x: jnp.full(len(start), x), initial(jnp.asarray(0.5, states.position.dtype))
        )
        self._carry: Any = (states, scales)

    def _first(self) -> ChainState:
        states, _ = self._carry
        finite = np.isfinite(np.column_stack([states.logdensity, states.logdensity_grad])).all()
        return self._begun(self._start, *(jax.tree.leaves(self._carry) if finite else ()))

    def _after(self, state: ChainState, steps: int) -> ChainState:
        carry = jax.tree.unflatten(jax.tree.structure(self._carry), state.ahead)
        first, rows = len(state.chain), []
        tuning = first < self._warmup
        for number in range(first, first + steps):
            key = jax.random.fold_in(self._key, number)
            given = self._density, self._mass, key, carry, jnp.asarray(tuning)
            carry, figures = _transitions(*given)
            now = carry[0].position, carry[0].logdensity, *figures
            rows.append([np.asarray(one) for one in now])
        chain, level, accepted, diverged = (np.stack(one) for one in zip(*rows, strict=True))
        return ChainState(
            np.concatenate([state.chain, chain]),
            np.concatenate([state.log_density, level]),
            sum(() if tuning else accepted, start=state.accepted),
            np.asarray(state.faulty + (0 if tuning else diverged.sum())),
            state.effective_size,
            tuple(jax.tree.leaves(carry)),
        )

    def _doubted(self, status: str, faulty: int, proposals: int) -> str:
        share = faulty / proposals
        if not share > _DIVERGENT:
            return status
        why = "the density has a kink, an edge, or a scale that the covariance lacks"
        return f"not converged: {100 * share:.0f} % of the trajectories diverged; {why}"

"""Posteriors of what was drawn from a prior, by emcee: no regression, no derivative between.

A draw of the prior is made of unit normal numbers, some of which stand for mere chance, such as
where the plants stand: whatever changes of these changes all. Proposals are drawn from the prior
about the walker (Neal 1999; preconditioned Crank-Nicolson of Cotter et al. 2013,
doi:10.1214/13-STS421), so that many numbers of which a spectrum says nothing cost no acceptance.
Chance is kept in two of three proposals, and drawn anew in the third.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from fynjax._core.errors import InputError
from fynjax._core.precision import double_precision
from fynjax.inversion._amortised import DARKEST, OFFSET_SD, OWN_SD

Simulate = Callable[
    [Float[np.ndarray, "walker number"]],
    tuple[Float[np.ndarray, " walker"], Float[np.ndarray, "walker quantity"]],
]
"""Log likelihood and quantities of draws of the prior."""

_SHORT, _LONG = 0.25, 0.6
"""Lengths of proposals, in standard deviations of the prior [-]."""


class PriorChain(NamedTuple):
    """An ensemble of walkers about draws of the prior."""

    quantities: Float[np.ndarray, "step walker quantity"]
    log_likelihood: Float[np.ndarray, "step walker"]
    acceptance: float
    """Share of the proposals that were accepted [-]."""


@double_precision
def sample_prior(
    simulate: Simulate,
    start: Float[np.ndarray, "walker number"],
    *,
    chance: int = 0,
    steps: int,
    seed: int,
) -> PriorChain:
    """Sample a posterior whose prior is that of independent unit normal numbers.

    **Arguments:**

    - `simulate`: gives log likelihood and two or more quantities of as many draws as asked for;
      draws whose log likelihood is not finite are refused.
    - `start`: where the walkers begin, such as from `draws_like`.
    - `chance`: the last so many numbers stand for mere chance.
    - `steps`: of each walker.
    - `seed`: of everything random.

    **Returns:** `PriorChain`, from the first step on.

    **Raises:** `InputError` where no start has a finite likelihood.
    """
    import emcee  # late: it takes half a second

    walkers, numbers = start.shape

    def density(z: np.ndarray) -> np.ndarray:
        likelihood, quantities = simulate(z)
        likelihood = np.where(np.isfinite(likelihood), likelihood, -np.inf)
        return np.column_stack([likelihood - 0.5 * np.sum(z**2, axis=1), quantities])

    kept, drawn = np.zeros(chance), np.ones(chance)
    lengths = [
        np.append(np.full(numbers - chance, length), of_chance)
        for length, of_chance in ((_SHORT, kept), (_LONG, kept), (_SHORT, drawn))
    ]
    moves = [emcee.moves.MHMove(_Proposal(each)) for each in lengths]
    sampler = emcee.EnsembleSampler(walkers, numbers, density, vectorize=True, moves=moves)
    sampler.log_prob_fn = density  # emcee's wrapper prints a traceback at an interruption
    first = density(start)
    alive = np.isfinite(first[:, 0])
    if not alive.any():
        raise InputError("the likelihood is finite at none of the starts")
    # A walker that starts where there is no density takes the place of one that does not.
    place = np.where(alive, np.arange(walkers), np.argmax(alive))
    start, first = start[place], first[place]
    state = emcee.State(start, log_prob=first[:, 0], blobs=first[:, 1:])
    state.random_state = np.random.RandomState(seed).get_state()
    sampler.run_mcmc(state, steps, skip_initial_state_check=True)
    z, density_at = sampler.get_chain(), sampler.get_log_prob()
    return PriorChain(
        np.asarray(sampler.get_blobs()).reshape(steps, walkers, -1),
        density_at + 0.5 * np.sum(z**2, axis=2),
        float(np.mean(sampler.acceptance_fraction)),
    )


class _Proposal:
    """Draws of the prior, correlated with where the walkers are: not at all in numbers of length
    1, and the same in those of length 0."""

    def __init__(self, length: Float[np.ndarray, " number"]) -> None:
        self._length = length

    def __call__(
        self, z: Float[np.ndarray, "walker number"], random: np.random.RandomState
    ) -> tuple[np.ndarray, np.ndarray]:
        kept = np.sqrt(1.0 - self._length**2)
        moved = kept * z + self._length * random.normal(size=z.shape)
        # The prior's density over that of the proposal is the same both ways.
        return moved, 0.5 * (np.sum(moved**2, axis=1) - np.sum(z**2, axis=1))


@double_precision
def draws_like(
    candidates: Float[np.ndarray, "candidate number"],
    log_likelihood: Float[np.ndarray, " candidate"],
    count: int,
    seed: int,
) -> Float[np.ndarray, "draw number"]:
    """Some of the draws of a prior, by their likelihood and without repetition: where walkers may
    begin.

    **Arguments:** `candidates`, with `log_likelihood`; `count` of them, by `seed`.
    """
    random = np.random.default_rng([seed, 2])
    order = np.argsort(-(log_likelihood + random.gumbel(size=len(log_likelihood))))
    return candidates[order[:count]]


@double_precision
def spectrum_likelihood(
    observed: Float[np.ndarray, " channel"],
    reflectance: Float[np.ndarray, "draw channel"],
    error: Float[np.ndarray, "channel channel"],
) -> Float[np.ndarray, " draw"]:
    """Log likelihood of a spectrum given simulated ones, with the errors that `train_posterior`
    trains with: of the model, of each channel for itself, and of all together.

    **Arguments:** `observed` and `reflectance` [-]; `error`, covariance of the logarithm of
    reflectance by which real spectra differ from simulated ones. Errors as a reflectance are
    linear in the logarithm here, which holds above some 0.01.
    """
    level = np.maximum(reflectance, DARKEST)
    apart = np.log(np.maximum(observed, DARKEST)) - np.log(level)
    offset = OFFSET_SD / level  # of the logarithm, to first order
    covariance = error + OWN_SD**2 * np.eye(len(error)) + offset[:, :, None] * offset[:, None, :]
    root = np.linalg.cholesky(covariance)
    left = np.linalg.solve(root, apart[..., None])[..., 0]
    size = np.sum(np.log(np.diagonal(root, axis1=1, axis2=2)), axis=1)
    return np.asarray(-0.5 * np.sum(left**2, axis=1) - size - 0.5 * len(error) * _LOG_2_PI)


_LOG_2_PI = float(np.log(2.0 * np.pi))

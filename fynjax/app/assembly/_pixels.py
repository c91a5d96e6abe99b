"""The posterior of a stand by one spectrum: stands of the learned prior, lit at each step."""

from dataclasses import replace

import numpy as np
from jaxtyping import Float

from fynjax._core.precision import double_precision
from fynjax._core.seeds import generator
from fynjax.app.assembly._stands import StandSettings, make_stand, stand_numbers
from fynjax.app.io.plot import LearnedPrior
from fynjax.inversion import PriorChain, draws_like, sample_prior, spectrum_likelihood
from fynjax.sensors import BandSet

_WALKERS = 8
_STANDS = 40
"""Planted stands from whose sets of leaves the walkers' starts are chosen."""
_SOLVES = 12
"""Solves of the diffuse light of a stand with one set: the rest is some 0.1 % of the light."""


@double_precision
def sample_pixel(
    reflectance: Float[np.ndarray, " channel"],
    bands: BandSet,
    prior: LearnedPrior,
    settings: StandSettings,
    *,
    steps: int,
    seed: int,
) -> PriorChain:
    """Sample the posterior of the stand of a pixel by emcee, with a render at each step.

    Prior, plants and errors are those that `train` simulates with: the regression of a map stands
    for this posterior. Where the plants stand is chance, of which one number decides.

    **Arguments:**

    - `reflectance`: of the pixel, in `bands` [-].
    - `bands`, `prior`, `settings`: as for `simulate_stands`.
    - `steps`: of each of 8 walkers.
    - `seed`: of everything random.

    **Returns:** `PriorChain` of `STAND_QUANTITIES`; its first steps still depend on the start.

    **Raises:** `InputError` where no stand of the prior makes a finite spectrum.
    """
    common, own = stand_numbers(prior)
    error = prior.model_error.covariance(np.asarray(bands.centre))
    random = generator(seed, 0)
    candidates, likelihood = [], []
    for _ in range(_STANDS):
        # One planted stand with many sets of leaves gives many candidates for one render.
        of_stand, of_sets = random.normal(size=common), random.normal(size=(settings.together, own))
        chance = random.normal()
        made = make_stand(of_stand, of_sets, _planting(chance), bands, prior, settings)
        alike = np.broadcast_to(of_stand, (len(of_sets), common))
        candidates.append(np.column_stack([alike, of_sets, np.full(len(of_sets), chance)]))
        likelihood.append(spectrum_likelihood(reflectance, made.reflectance, error))
    one = replace(settings, together=1, solves=_SOLVES)

    def simulate(z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        made = [
            make_stand(row[:common], row[None, common:-1], _planting(row[-1]), bands, prior, one)
            for row in z
        ]
        spectra = np.concatenate([stand.reflectance for stand in made])
        quantities = np.concatenate([stand.quantities for stand in made])
        return spectrum_likelihood(reflectance, spectra, error), quantities

    # Walkers start where they would end, but for the few stands that there are to draw from.
    start = draws_like(np.concatenate(candidates), np.concatenate(likelihood), _WALKERS, seed)
    return sample_prior(simulate, start, chance=1, steps=steps, seed=seed)


def _planting(normal: float) -> int:
    """Number of a planting: as good as independent of that of a number nearby."""
    return int(np.float64(normal).view(np.uint64) % (2**31 - 1))

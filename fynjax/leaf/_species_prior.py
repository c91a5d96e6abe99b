"""What spectra of some leaves say of the mean leaf of their species."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Int

from fynjax._core.errors import InputError
from fynjax.leaf._error_model import POPULATION_TRAITS, default_error_model
from fynjax.leaf._result import LeafFit

BETWEEN_PLANTS = {
    "structure": 0.23,
    "chlorophyll": 0.25,
    "carotenoids": 0.23,
    "anthocyanins": 0.48,
    "water": 0.27,
    "dry_matter": 0.26,
}
"""Standard deviation of the logarithm of traits between plants of a species [-]: pooled over the
replicates of the same species and leaf age of 12 broad-leaved shrubs and trees of "Fresh Leaf
Spectra to Estimate Leaf Traits for California Ecosystems" (EcoSIS), the half of it that was used
here. Of water and dry matter as measured (69 degrees of freedom), of the others as `fit_leaf` finds
them from R (76). In broad leaves of NASA FFT (Serbin et al. 2014) dry matter and water have 0.23
and 0.21; within a site dry matter has as much as over all."""
GUESS_COUNTS = 5.0
"""How many leaves `BETWEEN_PLANTS` counts as beside those of a species, as within the species of
`fit_leaf_groups`."""


def species_prior(
    fit: LeafFit,
    leaves: Sequence[int] | Bool[np.ndarray, " leaf"] | Int[np.ndarray, " chosen"] | None = None,
) -> dict[str, float]:
    """How well the mean of some fitted leaves is known to be that of their species on a plot.

    The variance of the mean of n leaves is

        sd^2 = c e^2 + ((1 - c) e^2 + s^2) / n,
        s^2 = (k b^2 + max(0, S - (n - 1) (1 - c) e^2)) / (k + n - 1),

    all over the square of the mean. e^2 is the mean square of the fits' errors in PROSPECT's own
    trait (`LeafFit.prospect_deviation`), since it is PROSPECT that the trait goes into. The part c
    of it is common to leaves of a species (`ErrorModel.species_share`, learned for the trait of a
    laboratory and taken here too) and is averaged out by no number of them. S is the sum of squared
    departures from the mean; less what the errors add to it, it is the spread s^2 between plants,
    which a guess b counted as k = 5 leaves keeps from none (`BETWEEN_PLANTS`; with one spectrum it
    is all there is). The variance of a mean under a common error and the scaled inverse chi-square
    prior of a variance are textbook (Gelman et al. 2013, Bayesian Data Analysis, 2.6 and 5.4).

    Each spectrum counts as a leaf of another plant of the plot, since no file says else: several of
    one plant say less.

    **Arguments:**

    - `fit`: as `fit_leaf` gives it.
    - `leaves`: which of its leaves are of the species, a mask or their places; all if left out.

    **Returns:** the relative standard deviation of the mean of each fitted trait whose mean is not
    zero [-]. NumPy; not differentiable.

    **Raises:** `InputError` where no leaf is chosen or one was not fitted.

    >>> import fynjax as fx
    >>> from fynjax.leaf import species_prior
    >>> leaf = fx.prospect(chlorophyll=[45.0, 45.0, 45.0])
    >>> fit = fx.fit_leaf(range(400, 2501), leaf.reflectance)
    >>> [round(species_prior(fit, [0])["chlorophyll"], 1), species_prior(fit)["chlorophyll"] < 0.2]
    [0.3, True]
    """
    chosen = np.arange(len(fit.labels))[slice(None) if leaves is None else list(leaves)]
    count = chosen.size
    if not count or np.isnan(fit.prospect_deviation[chosen]).any():
        raise InputError(f"expected leaves that were fitted, but got {chosen.tolist()}")
    model = default_error_model()
    shares = dict(zip(POPULATION_TRAITS, model.species_share.tolist()))
    found = {}
    for i, name in enumerate(fit.names):
        values = np.asarray(getattr(fit.parameters, name), float)[chosen]
        mean = values.mean()
        if not mean > 0.0:
            continue
        common = shares.get(name, np.nan)
        common = float(np.nanmean(model.species_share)) if np.isnan(common) else common
        error = np.mean(fit.prospect_deviation[chosen, i] ** 2) / mean**2
        own = (1.0 - common) * error
        apart = max(np.sum((values / mean - 1.0) ** 2) - (count - 1) * own, 0.0)
        guess = BETWEEN_PLANTS.get(name, BETWEEN_PLANTS["dry_matter"])
        between = (GUESS_COUNTS * guess**2 + apart) / (GUESS_COUNTS + count - 1)
        found[name] = float(np.sqrt(common * error + (own + between) / count))
    return found

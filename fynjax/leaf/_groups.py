"""Leaves of several species fitted together: species means and the variation within a species."""

from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from fynjax._core.errors import InputError
from fynjax._core.precision import require_double_precision
from fynjax.leaf import _levenberg as lm
from fynjax.leaf._coefficients import ProspectVersion
from fynjax.leaf._error_model import ErrorModel
from fynjax.leaf._fit import LeafFit, assemble, fit_chunk, solve_leaves
from fynjax.leaf._measurement import AbstractMeasurement
from fynjax.leaf._parameters import LEAF_PARAMETERS, LeafParameters
from fynjax.leaf._problem import (
    FitDomain,
    binned_data,
    leaf_bounds,
    leaf_priors,
    make_setup,
    usable_bins,
)

# Prior standard deviation of leaves within a species in the logit of each parameter (about the
# relative one), and the number of leaves that this prior counts as.
_WITHIN, _GUESS_COUNTS = 0.2, 5.0
_ROUNDS = 4


class LeafGroups(eqx.Module):
    """Species means, variation within a species, and the leaves fitted under them."""

    groups: tuple[str, ...] = eqx.field(static=True)
    """Names of the groups, in order of first appearance."""
    mean: LeafParameters
    """Typical leaf of each group, each field a vector [group]."""
    logit_mean: Float[np.ndarray, "group parameter"]
    """The same in the unconstrained coordinates of the fit."""
    logit_covariance: Float[np.ndarray, "parameter parameter"]
    """Covariance of leaves within a species, shared by all, in those coordinates."""
    names: tuple[str, ...] = eqx.field(static=True)
    """Parameters, in the order of the arrays above."""
    leaves: LeafFit
    """Every leaf, fitted with its species as the prior."""

    def variants(self, count: int, seed: int = 0) -> LeafParameters:
        """Leaves drawn from each species: `count` materials for each, fields [group, variant].

        The departures from the mean are the same for all species, and repeatable by `seed`.
        """
        root = np.linalg.cholesky(self.logit_covariance + 1e-12 * np.eye(len(self.names)))
        steps = np.random.default_rng(seed).normal(size=(count, len(self.names))) @ root.T
        return _parameters(self.logit_mean[:, None] + steps, self.names)


def _parameters(z: np.ndarray, names: Sequence[str]) -> LeafParameters:
    bounds = leaf_bounds(names)
    x = bounds[:, 0] + (bounds[:, 1] - bounds[:, 0]) / (1.0 + np.exp(-z))
    values = dict(zip(names, np.moveaxis(x, -1, 0)))
    filled: dict[str, Any] = {n: values.get(n, np.zeros(z.shape[:-1])) for n in LEAF_PARAMETERS}
    make = LeafParameters
    for _ in range(z.ndim - 1):
        make = jax.vmap(make)
    return make(*(jnp.asarray(filled[name]) for name in LEAF_PARAMETERS))


def fit_leaf_groups(
    wavelength: Float[np.ndarray, " band"],
    reflectance: Float[np.ndarray, "leaf band"] | None = None,
    transmittance: Float[np.ndarray, "leaf band"] | None = None,
    *,
    groups: Sequence[str],
    version: ProspectVersion = "D",
    measurement: AbstractMeasurement | None = None,
    domain: FitDomain = "full",
    free: Sequence[str] | None = None,
    outdoor: bool | None = None,
    detector_changes: Sequence[float] = (),
    error_model: ErrorModel | None = None,
) -> LeafGroups:
    """Fit leaves of several species, each leaf informed by the others of its species.

    A hierarchical model: leaves of a species are Gaussian about its mean in the logit of each
    parameter, with a covariance that all species share; means have the wide priors of `fit_leaf`.
    Mean and covariance are estimated by expectation-maximisation over the Gaussian approximations
    of the leaves; each leaf is then fitted with its species as prior (Gelman et al. 2013, Bayesian
    Data Analysis, chapters 5 and 13).

    **Arguments:**

    - `wavelength`, `reflectance`, `transmittance`: the measured spectra, as for `fit_leaf`.
    - `groups`: name of the species of each leaf, in the order of the spectra.
    - `version`, `measurement`, `domain`, `free`, `outdoor`, `detector_changes`, `error_model`: as
      for `fit_leaf`.

    **Returns:** `LeafGroups`: the mean of each species, the covariance within species, and a
    `LeafFit` of all leaves. Leaves with fewer than ten usable bins do not count for the means.

    **Raises:** `InputError` as `fit_leaf`, or if `groups` does not have a name for each leaf.

    NumPy in and out; not differentiable.

    >>> import jax
    >>> import numpy as np
    >>> import fynjax as fx
    >>> from fynjax.leaf import fit_leaf_groups
    >>> leaves = fx.LeafParameters.many(chlorophyll=np.array([30.0, 33.0, 60.0, 64.0]))
    >>> optics = jax.vmap(fx.prospect)(leaves)
    >>> species = fit_leaf_groups(
    ...     np.asarray(optics.wavelength[0]),
    ...     np.asarray(optics.reflectance),
    ...     np.asarray(optics.transmittance),
    ...     groups=["Protea", "Protea", "Erica", "Erica"],
    ... )
    >>> species.groups
    ('Protea', 'Erica')
    >>> bool(species.mean.chlorophyll[0] < 45.0 < species.mean.chlorophyll[1])
    True
    """
    require_double_precision("`fit_leaf_groups`")
    data = binned_data(wavelength, reflectance, transmittance, detector_changes)
    if len(groups) != len(data):
        raise InputError(f"`groups` must name {len(data)} leaves, but has {len(groups)} names")
    labels = tuple(dict.fromkeys(str(g) for g in groups))
    member = np.array([labels.index(str(g)) for g in groups])
    use = usable_bins(data, domain, outdoor)
    setup = make_setup(version, measurement, free, error_model)
    leaf_mean, leaf_precision = leaf_priors(setup, data, use)
    # N estimated from the near-infrared plateau is evidence about the leaf, not its species.
    line = leaf_precision - setup.prior_precision
    pull = (leaf_precision @ leaf_mean[:, :, None])[:, :, 0]
    pull = pull - setup.prior_precision @ setup.prior_mean
    loose = np.isin(setup.names, setup.free)
    guess = np.diag(np.where(loose, _WITHIN**2, 1e-6))
    within, prior = guess, (leaf_mean, leaf_precision)
    means = np.tile(setup.prior_mean, (len(labels), 1))
    good = use.sum((1, 2)) >= 10
    for _ in range(_ROUNDS):
        state, _, _ = solve_leaves(setup, data, use, prior)
        means, within = _update(state, member, good, means, within, guess, setup.prior_mean,
                                setup.prior_precision)  # fmt: skip
        inverse = np.linalg.inv(within)
        precision = inverse + line
        mean = np.linalg.solve(precision, ((means @ inverse)[member] + pull)[:, :, None])
        prior = (mean[:, :, 0], precision)
    leaves = assemble(setup, [fit_chunk(setup, data, use, prior)], data, use)
    return LeafGroups(labels, _parameters(means, setup.names), means, within, setup.names, leaves)


def _update(
    state: lm.State,
    member: np.ndarray,
    good: np.ndarray,
    means: np.ndarray,
    within: np.ndarray,
    guess: np.ndarray,
    prior_mean: np.ndarray,
    prior_precision: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Means of the groups and the covariance within them, given the fitted leaves."""
    inverse = np.linalg.inv(within)
    means = means.copy()
    scatter, count = _GUESS_COUNTS * guess, _GUESS_COUNTS
    for group in range(len(means)):
        rows = np.flatnonzero((member == group) & good)
        precision = rows.size * inverse + prior_precision
        right = inverse @ state.z[rows].sum(0) + prior_precision @ prior_mean
        means[group] = np.linalg.solve(precision, right)
        if rows.size < 2:
            continue
        offset = state.z[rows] - means[group]
        spread = np.linalg.inv(state.hessian[rows]).sum(0)
        scatter = scatter + offset.T @ offset + spread + rows.size * np.linalg.inv(precision)
        count += rows.size
    return means, scatter / count

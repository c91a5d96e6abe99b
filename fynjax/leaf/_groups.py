"""Leaves of several species fitted together: species means and the variation within a species."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
from jaxtyping import Float

from fynjax._core.errors import InputError
from fynjax._core.precision import double_precision
from fynjax._core.seeds import generator
from fynjax.leaf._area import LeafArea, area_factors
from fynjax.leaf._error_model import ErrorModel, default_error_model
from fynjax.leaf._fit import assemble, describe_chunk, solve_leaves
from fynjax.leaf._parameters import LEAF_PARAMETERS, LeafParameters
from fynjax.leaf._problem import USUAL_SETTINGS, LeafSettings, Setup, leaf_bounds, prepare
from fynjax.leaf._result import LeafFit

# Prior standard deviation of leaves within a species in the logit of each parameter (about the
# relative one), and the number of leaves that this prior counts as.
_WITHIN, _GUESS_COUNTS = 0.2, 5.0
_ROUNDS = 4
_VARIANTS = 5


class LeafGroups(eqx.Module):
    """Species means, variation within a species, and the leaves fitted under them."""

    groups: tuple[str, ...] = eqx.field(static=True)
    """Names of the groups, in order of first appearance."""
    mean: LeafParameters
    """Typical leaf of each group, each field a vector [group]."""
    logit_mean: Float[np.ndarray, "group parameter"]
    """Typical leaf of each group in the unconstrained coordinates of the fit."""
    logit_covariance: Float[np.ndarray, "parameter parameter"]
    """Covariance of leaves within a species, shared by all, in those coordinates."""
    names: tuple[str, ...] = eqx.field(static=True)
    """Parameters, in the order of the arrays above."""
    leaves: LeafFit
    """Every leaf, fitted with its species as the prior."""

    @double_precision
    def variants(self, count: int, seed: int = 0) -> LeafParameters:
        """Leaves drawn from each species: `count` materials for each, fields [group, variant].

        The departures from the mean are the same for all species, and repeatable by `seed`.
        """
        # A ridge against rounding: parameters that are not free vary next to nothing.
        root = np.linalg.cholesky(self.logit_covariance + 1e-12 * np.eye(len(self.names)))
        steps = generator(seed).normal(size=(count, len(self.names))) @ root.T
        return _parameters(self.logit_mean[:, None] + steps, self.names)

    def table(self, seed: int = 0, area: LeafArea = "projected") -> pd.DataFrame:
        """The mean leaf of each species (variant 0), and five material variants of it.

        **Arguments:** `seed` of the variants; `area` that contents are stated per, as of
        `LeafFit.table`.

        **Returns:** species, variant, parameters in the units of `LeafParameters`, and the area.
        """
        drawn, factors = self.variants(_VARIANTS, seed), area_factors(area, self.leaves.leaf_shape)
        names = [name for name in self.names if name in LEAF_PARAMETERS]
        rows = [
            {"species": species, "variant": variant}
            | {n: factors[n] * float(np.asarray(getattr(leaf, n))[at]) for n in names}
            | {"area": area}
            for g, species in enumerate(self.groups)
            for variant, leaf, at in [
                (0, self.mean, (g,)), *((v + 1, drawn, (g, v)) for v in range(_VARIANTS))
            ]
        ]  # fmt: skip
        return pd.DataFrame(rows)


def _parameters(z: np.ndarray, names: Sequence[str]) -> LeafParameters:
    bounds = leaf_bounds(names)
    x = bounds[:, 0] + (bounds[:, 1] - bounds[:, 0]) / (1.0 + np.exp(-z))
    values = dict(zip(names, np.moveaxis(x, -1, 0)))
    filled: dict[str, Any] = {n: values.get(n, np.zeros(z.shape[:-1])) for n in LEAF_PARAMETERS}
    make = LeafParameters
    for _ in range(z.ndim - 1):
        make = jax.vmap(make)
    return make(*(jnp.asarray(filled[name]) for name in LEAF_PARAMETERS))


@double_precision
def fit_leaf_groups(
    wavelength: Any,
    reflectance: Any = None,
    transmittance: Any = None,
    *,
    groups: Sequence[str] | np.ndarray,
    settings: LeafSettings = USUAL_SETTINGS,
) -> LeafGroups:
    """Fit leaves of several species, each leaf informed by the others of its species.

    A hierarchical model: leaves of a species are Gaussian about its mean in the logit of each
    parameter, with a covariance that all species share; means have the wide priors of `fit_leaf`.
    Leaves of a species also share a part of what the model is wrong by
    (`ErrorModel.species_share`), which more leaves do not average out and by which they are not
    drawn to their mean. The covariance is estimated by expectation-maximisation over the Gaussian
    approximations of the leaves; intervals hold the uncertainty of the mean and the common error
    (Gelman et al. 2013, Bayesian Data Analysis, chapters 5 and 13). Dry matter is that of R and T
    together: no mean with that of R alone is taken, as `fit_leaf` does.

    **Arguments:**

    - `wavelength`, `reflectance`, `transmittance`: the measured spectra, as for `fit_leaf`.
    - `groups`: name of the species of each leaf, in the order of the spectra.
    - `settings`: what `fit_leaf` takes one by one.

    **Returns:** `LeafGroups`: the mean of each species, the covariance within species, and a
    `LeafFit` of all leaves. Leaves with fewer than ten usable bins do not count for the means.

    **Raises:** `InputError` as `fit_leaf`, if `groups` does not have a name for each leaf, or for
    the error model "exact".

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
    if settings.error_model == "exact":
        raise InputError(
            'expected `error_model` "laboratory" or "field", but got "exact": where PROSPECT is '
            "exact each leaf is known from its own spectrum, so fit them without groups"
        )
    setup, data, use, prior, source = prepare(wavelength, reflectance, transmittance, settings)
    if len(groups) != len(data):
        raise InputError(f"`groups` must name {len(data)} leaves, but has {len(groups)} names")
    labels = tuple(dict.fromkeys(str(g) for g in groups))
    member = np.array([labels.index(str(g)) for g in groups])
    stated = settings.error_model
    model = stated if isinstance(stated, ErrorModel) else default_error_model()
    shared = float(np.nanmean(model.species_share))
    # N estimated from the near-infrared plateau is evidence about the leaf, not its species.
    line = prior[1] - setup.prior_precision
    pull = np.einsum("npq,nq->np", *prior[::-1]) - setup.prior_precision @ setup.prior_mean
    loose = np.isin(setup.names, setup.free)
    within = guess = np.diag(np.where(loose, _WITHIN**2, 1e-6))
    good = use.sum((1, 2)) >= 10
    rows = [np.flatnonzero((member == group) & good) for group in range(len(labels))]
    for _ in range(_ROUNDS):
        found, problems = solve_leaves(setup, data, use, prior)
        # What the spectrum says of its leaf, to first order: a Gaussian of this precision, and
        # that times its mean.
        said = found.hessian - prior[1] + line
        weighted = np.einsum("npq,nq->np", found.hessian, found.z) + pull
        weighted -= np.einsum("npq,nq->np", *prior[::-1])
        species = [_species(said[at], weighted[at], within, shared, setup) for at in rows]
        scatter = sum((s.scatter.sum(0) for s in species if len(s.scatter) > 1), 0.0 * guess)
        count = sum(len(s.scatter) for s in species if len(s.scatter) > 1)
        # The covariance that maximises the expected likelihood, with the guess as so many leaves.
        within = (_GUESS_COUNTS * guess + scatter) / (_GUESS_COUNTS + count)
        means = np.stack([s.mean for s in species])
        inverse = np.linalg.inv(within)
        precision = inverse + line
        mean = np.linalg.solve(precision, ((means @ inverse)[member] + pull)[:, :, None])
        prior = (mean[:, :, 0], precision)
    z, covariance = found.z.copy(), np.linalg.inv(found.hessian)
    for at, group in zip(rows, species):
        z[at], covariance[at] = group.leaves, group.covariance
    found = found._replace(z=z)
    parts = [describe_chunk(setup, found, problems, covariance, use)]
    leaves = assemble(setup, parts, data, use, source)
    return LeafGroups(labels, _parameters(means, setup.names), means, within, setup.names, leaves)


class _Species(NamedTuple):
    """What the spectra of one species say together, in the unconstrained coordinates."""

    mean: Float[np.ndarray, " parameter"]
    leaves: Float[np.ndarray, "leaf parameter"]
    covariance: Float[np.ndarray, "leaf parameter parameter"]
    """Posterior covariance of each leaf."""
    scatter: Float[np.ndarray, "leaf parameter parameter"]
    """Expected squares and products of what leaves depart from the mean by."""


def _species(
    precision: np.ndarray, weighted: np.ndarray, within: np.ndarray, shared: float, setup: Setup
) -> _Species:
    """Mean and leaves of a species from what each spectrum says, a Gaussian of this precision.

    Of the error of each leaf the part s is common to the species, with the share `shared` of its
    variance: z_i = mean + d_i and what the spectrum says is z_i + s + w_i. Given mean and s the
    leaves are independent; both are integrated over with their joint Gaussian.
    """
    size = len(setup.prior_mean)
    start = setup.prior_precision
    if len(precision) == 0:
        none = np.zeros((0, size, size))
        return _Species(setup.prior_mean, none[:, 0], none, none)
    # Directions of which spectra say nothing have the common error of the wide prior.
    common = np.linalg.inv(precision.mean(0) / shared + start)
    own, pulled = precision / (1.0 - shared), weighted / (1.0 - shared)
    inverse = np.linalg.inv(within)
    spread = np.linalg.inv(own + inverse)
    # Precision and weighted mean of mean + s from each leaf, the leaf itself integrated over.
    # own - own (own + within^-1)^-1 own is the precision of the mean with the leaf unknown.
    about = own - own @ spread @ own
    right = (np.einsum("npq,nq->np", np.eye(size) - own @ spread, pulled)).sum(0)
    total = about.sum(0)
    joint = np.block([[start + total, total], [total, np.linalg.inv(common) + total]])
    both = np.linalg.inv(joint)
    mean, error = np.split(both @ np.concatenate([start @ setup.prior_mean + right, right]), 2)
    # z_i - mean = spread (own (said - s) - own mean), and what remains of it.
    gain = spread @ own
    departure = np.einsum("npq,nq->np", spread, pulled) - gain @ (mean + error)
    sums = both[:size, :size] + both[:size, size:] + both[size:, :size] + both[size:, size:]
    way = np.concatenate([np.eye(size) - gain, -gain], axis=2)
    return _Species(
        mean,
        mean + departure,
        spread + way @ both @ way.transpose(0, 2, 1),
        departure[:, :, None] * departure[:, None, :]
        + spread
        + gain @ sums @ gain.transpose(0, 2, 1),
    )

"""What data can tell about parameters at best: Fisher information and Cramér-Rao bounds."""

from collections.abc import Sequence

import equinox as eqx
import numpy as np
from jaxtyping import Float

from fynjax._core.errors import InputError
from fynjax._core.precision import double_precision
from fynjax.inversion._fit_result import main_members

_NOTHING = 1e-10
"""Information below this, in units of the prior's, counts as none. It is no share of the largest,
which grows with what is measured."""
_ROUNDING = 1e-14
"""Share of the largest information that rounding leaves where there is none."""


class Information(eqx.Module):
    """Bounds on the standard deviation of any unbiased estimate, parameter by parameter."""

    names: tuple[str, ...] = eqx.field(static=True)
    prior_sd: Float[np.ndarray, " free"]
    """Standard deviation of each prior, in the parameters' own units, as are the bounds."""
    fisher: Float[np.ndarray, "free free"]
    """Fisher information, per product of the parameters' units."""
    conditional: Float[np.ndarray, " free"]
    """Bound where every other parameter is known; infinite where the data say nothing."""
    joint: Float[np.ndarray, " free"]
    """Cramér-Rao bound where nothing is known of any parameter; infinite for one that takes part
    in a direction to which the data are not sensitive."""
    bound: Float[np.ndarray, " free"]
    """Cramér-Rao bound from the data where the others are known as well as their priors: what the
    data add on this one."""
    bayesian: Float[np.ndarray, " free"]
    """Bound with the priors of all (van Trees 1968); at most the prior's standard deviation."""
    information: Float[np.ndarray, " mode"]
    """Eigenvalues of the information in prior units, largest first: below one, a direction is
    known from the prior rather than from the data."""
    modes: Float[np.ndarray, "mode free"]
    """Eigenvectors of the information, in prior units."""

    @property
    def constrained(self) -> Float[np.ndarray, " free"]:
        """1 - variance with the data over that of the prior [-]."""
        return 1.0 - (self.bayesian / self.prior_sd) ** 2

    def weakly_constrained_directions(self, below: float = 0.01) -> list[dict[str, float]]:
        """Directions with less information than `below`, in prior units; least first, main members
        only."""
        hidden = self.modes[self.information < below][::-1]
        return main_members(self.names, hidden)


@double_precision
def fisher_information(
    names: tuple[str, ...],
    jacobian: Float[np.ndarray, "observation free"],
    covariance: Float[np.ndarray, " observation *observation"],
    prior_sd: Float[np.ndarray, " free"],
) -> Information:
    """Information of data with normal errors about parameters: J^T C^-1 J.

    **Arguments:**

    - `names` of the parameters.
    - `jacobian`: derivatives of what is observed by the parameters, in their own units.
    - `covariance` of its errors; or, where they are independent, their variances [observation].
    - `prior_sd`: standard deviations of the parameters' priors, in their own units.

    **Returns:** `Information`.

    **Raises:** `InputError` for shapes that do not match, and a covariance that is not positive.
    """
    slopes, noise = np.asarray(jacobian, float), np.asarray(covariance, float)
    count = slopes.shape[0]
    if slopes.ndim != 2 or slopes.shape[1] != len(names) or np.shape(prior_sd) != (len(names),):
        raise InputError(
            f"{len(names)} parameters are named, but `jacobian` has shape {slopes.shape} and "
            f"`prior_sd` {np.shape(prior_sd)}"
        )
    if noise.shape not in ((count,), (count, count)):
        raise InputError(f"{count} observations need as many errors, but got {noise.shape}")
    try:
        if noise.ndim == 1:
            if not np.all(noise > 0):
                raise np.linalg.LinAlgError
            whitened = slopes / np.sqrt(noise)[:, None]
        else:
            whitened = np.linalg.solve(np.linalg.cholesky(noise), slopes)
    except np.linalg.LinAlgError as error:
        raise InputError("the covariance of the errors must be positive definite") from error
    scaled = whitened * prior_sd
    return bounds_of(names, scaled.T @ scaled, np.asarray(prior_sd, float))


def bounds_of(
    names: tuple[str, ...],
    matrix: Float[np.ndarray, "free free"],
    prior_sd: Float[np.ndarray, " free"],
) -> Information:
    """Bounds from a Fisher information in prior units (each parameter counted in `prior_sd`)."""
    values, vectors = np.linalg.eigh(np.asarray(matrix, float))
    values = np.maximum(values[::-1], 0.0)
    modes = vectors[:, ::-1].T
    # Directions of which the data say nothing make the bound of whatever takes part infinite.
    hidden = values <= max(_NOTHING, _ROUNDING * values[0])
    # Share of each parameter in each mode: marginal variances are sums over the modes.
    share = modes**2
    variance = share[~hidden].T @ (1.0 / values[~hidden])
    touched = share[hidden].sum(axis=0) > 1e-9
    known = share.T @ (1.0 / (1.0 + values))  # posterior over prior variance
    with np.errstate(divide="ignore"):
        # Precision beyond the prior's own, which is one.
        added = np.maximum(1.0 / known - 1.0, 0.0)
        added[added < _NOTHING] = 0.0
        diagonal = np.diagonal(matrix)
        return Information(
            names=tuple(names),
            prior_sd=prior_sd,
            fisher=matrix / np.outer(prior_sd, prior_sd),
            conditional=prior_sd / np.sqrt(np.maximum(diagonal, 0.0)),
            joint=np.where(touched, np.inf, prior_sd * np.sqrt(variance)),
            bound=prior_sd / np.sqrt(added),
            bayesian=prior_sd * np.sqrt(known),
            information=values,
            modes=modes,
        )


def shared_slopes(
    slopes: Float[np.ndarray, "draw statistic free"],
    covariance: Float[np.ndarray, "statistic statistic"],
    blocks: Sequence[np.ndarray],
) -> Float[np.ndarray, "statistic free"]:
    """Slopes that draws of a random model share: their mean, without what chance adds to it.

    The mean over few draws keeps some of their chance, and in a Fisher information its square
    would count as knowledge. So each block of statistics, given those before it, is made smaller.
    Of its whitened slopes, by parameters in units of their standard errors, the singular value s
    becomes s - e^2 / s, and nothing below e, as James & Stein (1961) make a mean smaller: e is
    the largest that chance alone makes on average at most, by Chevet's inequality (Vershynin
    2018, High-dimensional probability, section 8.7). A block whose slopes are all chance then
    tells no more than those before it.

    Any selection of these slopes has, with the same part of `covariance`, at most the information
    of all.

    **Arguments:**

    - `slopes` in each draw, at least two, by parameters in units of their priors.
    - `covariance` of the statistics, positive definite.
    - `blocks`: places of the statistics, block by block; all statistics are in one.
    """
    order = np.concatenate(blocks)
    root = np.linalg.cholesky(covariance[np.ix_(order, order)])
    # A triangular factor leaves of each block what those before it do not say.
    white = np.linalg.solve(root, slopes[:, order])
    mean = white.mean(axis=0)
    chance = (white - mean) / np.sqrt(len(slopes) * (len(slopes) - 1.0))
    shrunk = np.zeros_like(mean)
    start = 0
    for block in blocks:
        part = slice(start, start + len(block))
        shrunk[part] = _less_chance(mean[part], chance[:, part])
        start += len(block)
    shared = np.empty_like(mean)
    # Back to the statistics, in their own order.
    shared[order] = root @ shrunk
    return shared


def _less_chance(
    mean: Float[np.ndarray, "statistic free"], chance: Float[np.ndarray, "draw statistic free"]
) -> Float[np.ndarray, "statistic free"]:
    """The mean without the singular values that its error, the sum of `chance`, may have made."""
    unit = np.sqrt((chance**2).sum(axis=(0, 1)))
    # Slopes that no draw changes have no error.
    unit = np.maximum(unit, 1e-9 * np.abs(mean).max(axis=0) + np.finfo(float).tiny)
    chance = chance / unit
    rows = np.einsum("dsi,dti->st", chance, chance)
    columns = np.einsum("dsi,dsj->ij", chance, chance)
    # Chevet: the largest singular value of chance is at most the sum of these two norms.
    edge = sum(np.sqrt(max(np.linalg.eigvalsh(m)[-1], 0.0)) for m in (rows, columns))
    left, size, right = np.linalg.svd(mean / unit, full_matrices=False)
    kept = np.where(size > edge, size - edge**2 / np.where(size > 0, size, 1.0), 0.0)
    return np.asarray((left * kept) @ right * unit)

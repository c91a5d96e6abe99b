"""The posterior of a leaf by sampling, where the Gaussian about the best fit is in doubt."""

from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, Any, Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.tree_util import Partial
from jaxtyping import Array, Float

from fynjax._core.errors import InputError
from fynjax._core.precision import double_precision
from fynjax._core.progress import track
from fynjax._core.sampling import Ensemble, Hamiltonian
from fynjax._core.seeds import generator
from fynjax.leaf._area import LeafArea, LeafShape, area_factors
from fynjax.leaf._fit import describe, solve_leaves, towards_reflectance, trait_variance
from fynjax.leaf._parameters import LEAF_PARAMETERS
from fynjax.leaf._problem import USUAL_SETTINGS, LeafSettings, Setup, prepare
from fynjax.leaf._residual import Given, LeafProblem, residual, to_physical, whitening
from fynjax.leaf._result import cf_unit, leaf_dataset
from fynjax.leaf._spectra import SpectraSource

if TYPE_CHECKING:
    import xarray as xr

_WALKERS, _CHAINS = 32, 4


class LeafPosterior(eqx.Module):
    """Draws from the posterior of each leaf."""

    names: tuple[str, ...] = eqx.field(static=True)
    """Names of the sampled parameters."""
    samples: Float[np.ndarray, "leaf draw parameter"]
    """Draws in the parameters' units, of the trait a laboratory would measure."""
    wavelength: Float[np.ndarray, " bin"]
    """Bins of `transmittance` [nm]."""
    transmittance: Float[np.ndarray, "leaf draw bin"]
    """T of the leaf at each draw, with a draw of the model's error that the data leave [-]."""
    effective_size: Float[np.ndarray, " leaf"]
    """Effective number of draws behind the least mixed parameter."""
    status: np.ndarray
    """Text [leaf]: `converged`, or why the draws may not be the posterior."""
    leaf_shape: LeafShape = eqx.field(static=True)
    """Shape that the leaves were taken to have."""
    source: SpectraSource = eqx.field(static=True)
    """Label of each leaf, and of spectra from files the file and what was repaired."""

    def to_xarray(self, area: LeafArea = "projected") -> "xr.Dataset":
        """The draws, after the CF conventions.

        **Arguments:** `area` that contents are stated per, as of `LeafFit.table`.

        **Returns:** parameters [leaf, draw] in the units of `LeafParameters`, transmittance [leaf,
        draw, wavelength] as fractions [-], effective number of draws and status of each leaf.
        """
        factors = area_factors(area, self.leaf_shape)
        variables: dict[str, Any] = {}
        for i, name in enumerate(self.names):
            attributes = {"units": cf_unit(name), "long_name": name.replace("_", " ")}
            values = factors[name] * self.samples[:, :, i]
            variables[name] = (("leaf", "draw"), values, attributes)
        variables["transmittance"] = (
            ("leaf", "draw", "wavelength"),
            self.transmittance,
            {"units": "1", "long_name": "leaf transmittance"},
        )
        variables["effective_size"] = ("leaf", self.effective_size, {"units": "1"})
        return leaf_dataset(
            variables, self.wavelength, self.source, self.status,
            "Posterior of leaf traits and transmittance under PROSPECT",
            leaf_shape=self.leaf_shape, area=area,
        )  # fmt: skip


def _log_density(z: Array, free: Array, given: Given) -> Array:
    """Log posterior density at z [free parameter]; fixed parameters keep their prior."""
    white = residual(given[0].prior_mean.at[free].set(z), given)
    return -0.5 * white @ white


def leaf_density(setup: Setup, problem: LeafProblem) -> Callable[[Array], Array]:
    """The log posterior density of a leaf over z [free parameter], as a pytree."""
    problem = LeafProblem(*(jnp.asarray(part) for part in problem))
    factors = jnp.asarray(setup.factors)
    given = problem, whitening(problem, factors), factors, setup.optics
    return Partial(_log_density, free=jnp.asarray(free_columns(setup)), given=given)


def free_columns(setup: Setup) -> np.ndarray:
    """Which of the parameters are free."""
    return np.flatnonzero(np.isin(setup.names, setup.free))


@eqx.filter_jit
def of_many(density: Callable[[Array], Array], z: Array) -> Array:
    return jax.vmap(density)(z)


@double_precision
def sample_leaf_posterior(
    wavelength: Any,
    reflectance: Any = None,
    transmittance: Any = None,
    *,
    settings: LeafSettings = USUAL_SETTINGS,
    sampler: Literal["emcee", "nuts"] = "emcee",
    draws: int = 400,
    target: float = 400.0,
    max_steps: int = 10_000,
    seed: int = 0,
) -> LeafPosterior:
    """Sample the posterior that `fit_leaf` approximates by a Gaussian.

    The same likelihood (correlated error of the model, inflated for a leaf that fits badly) and
    priors, in the same unconstrained coordinates. The ensemble starts as draws from that Gaussian
    and stops when it is longer than 50 autocorrelation times and holds `target` effective draws.
    To each draw a random part of the discrepancy of measured traits is added
    (`ErrorModel.trait_discrepancy`), and dry matter is moved as in `fit_leaf`.

    **Arguments:**

    - `wavelength`, `reflectance`, `transmittance`: the measured spectra, as for `fit_leaf`.
    - `settings`: what `fit_leaf` takes one by one.
    - `sampler`: "emcee" (Foreman-Mackey et al. 2013), or "nuts" (Hoffman & Gelman 2014), which
      needs the extra `posterior`.
    - `draws`: how many draws to return for each leaf.
    - `target`: effective draws to reach; `max_steps`: most steps of the ensemble.
    - `seed`: seed of the random numbers.

    **Returns:** `LeafPosterior`. A leaf with fewer than ten usable bins has NaN.

    **Raises:** `InputError` as `fit_leaf` and for an unknown sampler; `MissingExtraError` without
    the sampler's package.

    NumPy in and out, in float64; not differentiable.
    """
    if sampler not in ("emcee", "nuts"):
        raise InputError(f'`sampler` must be "emcee" or "nuts", but is {sampler!r}')
    setup, data, use, prior, source = prepare(wavelength, reflectance, transmittance, settings)
    random = generator(seed)
    found, problems = solve_leaves(setup, data, use, prior)
    moved = towards_reflectance(setup, data, use, found.z)
    columns = free_columns(setup)
    samples = np.full((len(data), draws, columns.size), np.nan)
    spectra = np.full((len(data), draws, data.shape[2]), np.nan)
    sizes, status = np.zeros(len(data)), []
    for i in track(range(len(data)), "Sample leaves"):
        if use[i].sum() < 10:
            status.append("failed: fewer than ten usable bands within 450-2400 nm")
            continue
        density = leaf_density(setup, LeafProblem(*(part[i] for part in problems)))
        covariance = np.linalg.inv(found.hessian[i])[np.ix_(columns, columns)]
        # Walkers start as draws from the Gaussian of the fit.
        count = max(_WALKERS, 4 * columns.size) if sampler == "emcee" else _CHAINS
        start = random.multivariate_normal(found.z[i, columns], covariance, count)
        limits: dict[str, Any] = {"target": target, "steps": max_steps, "seed": seed + i}
        if sampler == "emcee":
            many: Any = partial(of_many, density)
            chains = Ensemble(many, start, **limits).run()
        else:
            chains = Hamiltonian(density, start, covariance, **limits).run()
        sizes[i] = chains.effective_size
        status.append(chains.status)
        if not len(chains.chain):
            continue
        flat = chains.chain.reshape(-1, columns.size)
        picked = flat[random.integers(0, len(flat), draws)]
        samples[i], spectra[i] = _finish(setup, problems, i, columns, picked, moved[i], random)
    leaf = [i for i, name in enumerate(setup.free) if name in LEAF_PARAMETERS]
    names = tuple(setup.free[i] for i in leaf)
    return LeafPosterior(
        names,
        samples[:, :, leaf],
        setup.wavelength,
        spectra,
        sizes,
        np.array(status),
        setup.shape,
        source,
    )


def _finish(
    setup: Setup,
    problems: LeafProblem,
    leaf: int,
    columns: np.ndarray,
    z: np.ndarray,
    change: np.ndarray,
    random: Any,
) -> tuple[np.ndarray, np.ndarray]:
    """Draws in their units, changed as the fit is and with the traits' discrepancy, and T with the
    model's error."""
    count, parameters = len(z), len(setup.names)
    whole = np.tile(problems.prior_mean[leaf], (count, 1))
    whole[:, columns] = z
    many = LeafProblem(*(np.repeat(part[leaf : leaf + 1], count, 0) for part in problems))
    description = describe(setup, many, whole, np.zeros((count, parameters, parameters)))
    inflation = problems.inflation[leaf : leaf + 1]
    extra = np.sqrt(trait_variance(setup, inflation, whole))
    moved = whole + change + extra * random.normal(size=whole.shape)
    x = np.asarray(to_physical(jnp.asarray(moved), setup.optics))[:, columns]
    # The same draw for all bands: the remaining error is nearly fully correlated over a detector,
    # and an interval needs only the distribution at its band.
    error = random.normal(size=(count, 1)) * np.sqrt(description["variance"])
    return x, np.clip(description["corrected"][:, 1] + error, 0.0, 1.0)

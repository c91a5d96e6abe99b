"""Draws from a posterior, what they say, and how they mix."""

import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from fynjax._core.extras import require
from fynjax._core.html import as_html
from fynjax._core.precision import double_precision
from fynjax.inversion._data import Data
from fynjax.inversion._fit_result import WELL_CONSTRAINED, known_lines, well_constrained
from fynjax.inversion._space import ParameterSpace, parameter_columns
from fynjax.scene import LEAF_FIELDS, parameter_kind

if TYPE_CHECKING:
    import pandas as pd


class Posterior(eqx.Module):
    """Draws from the posterior of the free parameters."""

    space: ParameterSpace
    data: Data
    whitened: Float[np.ndarray, "chain draw free"]
    """Draws in whitened coordinates, where the prior is a unit normal."""
    log_density: Float[np.ndarray, "chain draw"]
    """Logarithm of the posterior density there, up to a constant."""
    predicted: Float[np.ndarray, "sample statistic"]
    """Statistics that the model predicts at some of the draws, without the data's error."""
    flat: tuple[tuple[tuple[str, float], ...], ...] = eqx.field(static=True)
    """Directions in whitened coordinates along which the data say nothing, main members only."""
    method: str = eqx.field(static=True)
    effective_size: float = eqx.field(static=True)
    """Effective number of draws behind the least mixed parameter, by its autocorrelation time."""
    acceptance: float = eqx.field(static=True)
    """Share of accepted proposals [-]."""
    converged: bool = eqx.field(static=True)
    status: str = eqx.field(static=True)
    """`converged`, or why the draws may not be the posterior; and what is flat."""
    sampler: Any = eqx.field(static=True, default=None)
    """emcee's `EnsembleSampler` that ran, over whitened coordinates, with every step of its chain;
    None of other methods."""

    def __str__(self) -> str:
        """What was drawn, and what is known, in sentences."""
        status = self.status.rstrip(".")
        text = f"{self.effective_size:.0f} effective draws by {self.method}: {status}."
        interval = self.quantiles(0.5, 0.05, 0.95)
        return f"{text}\n{known_lines(self.names, self.well_constrained(), interval)}"

    _repr_html_ = as_html

    @property
    def names(self) -> tuple[str, ...]:
        return self.space.names

    @property
    @double_precision
    def values(self) -> Float[np.ndarray, "chain draw free"]:
        """Draws in the parameters' own units."""
        every = jax.vmap(jax.vmap(self.space.physical))
        return np.asarray(every(jnp.asarray(self.whitened)))

    @double_precision
    def table(self) -> "pd.DataFrame":
        """Every parameter, in the unit of field crews: name, kind, unit, prior, mean of the draws
        (estimate), sd, quantiles, share of the prior variance that the data removed [-], and of
        chains effective draws and R-hat (`diagnostics`)."""
        values = self.values.reshape(-1, len(self.names))
        low, middle, high = self.quantiles(0.05, 0.5, 0.95)
        mean = {"estimate": values.mean(axis=0), "sd": values.std(axis=0)}
        columns = {**self.space.prior_columns(), **mean, "q05": low, "median": middle, "q95": high}
        table = parameter_columns(self.names, columns).assign(constrained=self.constrained)
        if self.method == "laplace":
            return table
        found = self.diagnostics()
        kinds = ("ess_bulk", "ess_tail", "r_hat")
        return table.assign(**{kind: [found[n][kind] for n in self.names] for kind in kinds})

    @double_precision
    def get_chain(
        self, *, discard: int = 0, thin: int = 1, flat: bool = False
    ) -> Float[np.ndarray, "..."]:
        """Draws as emcee's `get_chain` gives them, [step, walker, parameter] in the parameters' own
        units. Steps before the chain settled, and those closer than half an autocorrelation time,
        are left out already; `sampler.get_chain()` has them all.

        **Arguments:** `discard`, first steps that are left out; `thin`, the last of every so many
        steps; `flat`, all walkers as one, [draw, parameter].
        """
        return _as_emcee(self.values, discard, thin, flat)

    @double_precision
    def get_log_prob(
        self, *, discard: int = 0, thin: int = 1, flat: bool = False
    ) -> Float[np.ndarray, "..."]:
        """Logarithm of the posterior density of each draw of `get_chain`, up to a constant, [step,
        walker].

        **Arguments:** as of `get_chain`.
        """
        return _as_emcee(self.log_density, discard, thin, flat)

    @property
    @double_precision
    def own(self) -> Float[np.ndarray, "chain draw free"]:
        """Draws in the normal coordinate of each parameter's own prior (`ParameterSpace.together`),
        which is a unit normal there."""
        mixing = self.space.mixing
        return self.whitened if mixing is None else self.whitened @ np.asarray(mixing).T

    @property
    @double_precision
    def constrained(self) -> Float[np.ndarray, " free"]:
        """1 - posterior over prior variance, in whitened coordinates [-]: 0, the data say
        nothing; 1, they say all."""
        return 1.0 - self.own.reshape(-1, len(self.names)).var(axis=0)

    def well_constrained(self, least: float = WELL_CONSTRAINED) -> tuple[str, ...]:
        """As `FitResult.well_constrained`."""
        return well_constrained(self.names, self.constrained, least)

    @property
    @double_precision
    def misfit(self) -> Float[np.ndarray, " statistic"]:
        """Predicted median less measured value of each statistic [standard errors of that]."""
        off = np.median(self.predicted, axis=0) - np.asarray(self.data.value)
        return off / np.asarray(self.data.sd)

    @double_precision
    def quantiles(self, *shares: float) -> Float[np.ndarray, "share free"]:
        """Quantiles of each parameter, in its own unit."""
        return np.quantile(self.values.reshape(-1, len(self.names)), shares, axis=0)

    @double_precision
    def diagnostics(self) -> dict[str, dict[str, float]]:
        """Effective sample size (bulk and tail) and split R-hat of each parameter, by arviz.

        After Vehtari et al. (2021). The walkers of an ensemble count as chains; they hear of each
        other, so `effective_size` is the stricter figure there. Needs the extra `posterior`.
        """
        arviz = _arviz()
        with _many_chains():
            draws = arviz.convert_to_dataset({"u": self.own})
        found = {
            "ess_bulk": arviz.ess(draws, method="bulk"),
            "ess_tail": arviz.ess(draws, method="tail"),
            "r_hat": arviz.rhat(draws),
        }
        return {
            name: {kind: float(value["u"].values[i]) for kind, value in found.items()}
            for i, name in enumerate(self.names)
        }

    @double_precision
    def inference_data(self, attributes: dict[str, Any] | None = None) -> Any:
        """The draws as arviz's `InferenceData`: `to_netcdf` writes it, `arviz.from_netcdf` reads.

        Group `posterior` has a variable for each parameter, by its name and in its own unit; those
        of species are one variable, as `cover` or `leaf.chlorophyll`, over the coordinate
        `species` (`species_leaf.chlorophyll` where not of all). `unconstrained_posterior` holds the
        draws in `whitened` coordinates; `sample_stats` the log density; `posterior_predictive` and
        `observed_data` the `statistics`; `constant_data` their errors, prior and bounds. Needs the
        extra `posterior`.

        **Arguments:** `attributes`, further ones of the group `posterior`.
        """
        arviz = _arviz()
        coords = {"statistic": list(self.data.names), "parameter": list(self.names)}
        constant = {
            "statistics_sd": np.asarray(self.data.sd),
            **{
                name: np.asarray(getattr(self.space, name))
                for name in ("prior", "prior_sd", "lower", "upper")
            },
        }
        dims = {name: ["parameter"] for name in (*constant, "whitened")}
        dims |= {name: ["statistic"] for name in ("statistics", "statistics_sd")}
        values, (variables, taxa) = self.values, _variables(self.names)
        draws = {}
        for name, place in variables.items():
            if isinstance(place, int):
                draws[name] = values[..., place]
                continue
            whole = place.keys() == taxa.keys()
            dims[name] = ["species" if whole else f"species_{name}"]
            coords[dims[name][0]] = own = list(taxa if whole else place)
            draws[name] = values[..., [place[taxon] for taxon in own]]
        with _many_chains():
            found = arviz.from_dict(
                posterior=draws,
                posterior_predictive={"statistics": self.predicted[None]},
                sample_stats={"lp": self.log_density},
                observed_data={"statistics": np.asarray(self.data.value)},
                constant_data=constant,
                coords=coords,
                dims=dims,
            )
            whitened = {"whitened": self.whitened}
            found.add_groups(unconstrained_posterior=whitened, coords=coords, dims=dims)
        found.posterior.attrs |= {
            "method": self.method,
            "status": self.status,
            "effective_size": self.effective_size,
            "acceptance": self.acceptance,
            **(attributes or {}),
        }
        return found


def _as_emcee(draws: np.ndarray, discard: int, thin: int, flat: bool) -> np.ndarray:
    """Draws [chain, draw, ...] in emcee's order and by its choice of steps."""
    found = np.swapaxes(draws, 0, 1)[discard + thin - 1 :: thin]
    return found.reshape(-1, *found.shape[2:]) if flat else found


def _variables(names: Sequence[str]) -> tuple[dict[str, int | dict[str, int]], dict[str, None]]:
    """Which parameters each variable holds, those of species by their taxon; and all taxa."""
    found: dict[str, Any] = {}
    taxa: dict[str, None] = {}
    for place, name in enumerate(names):
        # The traits of a leaf have its name, or that of another material, before theirs.
        words = 2 if parameter_kind(name) in LEAF_FIELDS else 1
        taxon, *kind = name.removeprefix("species.").rsplit(".", words)
        if name.startswith("species.") and kind:
            found.setdefault(".".join(kind), {})[taxon] = place
            taxa[taxon] = None
        else:
            found[name] = place
    return found, taxa


@contextmanager
def _many_chains() -> Iterator[None]:
    """Walkers count as chains, of which there are often more than draws of each."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "More chains", UserWarning)
        yield


def _arviz() -> Any:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", FutureWarning)  # of its own next version
        return require("arviz", "posterior")

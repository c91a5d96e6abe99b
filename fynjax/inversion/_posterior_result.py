"""Draws from a posterior, what they say, and how they mix."""

import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

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
from fynjax.inversion._space import ParameterSpace


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
    def get_chain(
        self, *, discard: int = 0, thin: int = 1, flat: bool = False
    ) -> Float[np.ndarray, "..."]:
        """Draws as emcee's `get_chain` gives them, [step, walker, parameter] in the parameters' own
        units. Steps before the chain settled, and those closer than half an autocorrelation time,
        are left out already.

        **Arguments:** `discard`, first steps that are left out; `thin`, every so many steps;
        `flat`, all walkers as one, [draw, parameter].
        """
        found = np.swapaxes(self.values, 0, 1)[discard::thin]
        return found.reshape(-1, found.shape[-1]) if flat else found

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

        Group `posterior` holds `value` in the parameters' own units and `whitened`;
        `sample_stats` the log density; `posterior_predictive` and `observed_data` the statistics;
        `constant_data` prior and bounds. Needs the extra `posterior`.
        """
        arviz = _arviz()
        parameter, statistic = ["parameter"], ["statistic"]
        with _many_chains():
            found = arviz.from_dict(
                posterior={"value": self.values, "whitened": self.whitened},
                posterior_predictive={"prediction": self.predicted[None]},
                sample_stats={"lp": self.log_density},
                observed_data={"observation": np.asarray(self.data.value)},
                constant_data={
                    "observation_sd": np.asarray(self.data.sd),
                    "prior": np.asarray(self.space.prior),
                    "prior_sd": np.asarray(self.space.prior_sd),
                    "lower": np.asarray(self.space.lower),
                    "upper": np.asarray(self.space.upper),
                },
                coords={"parameter": list(self.names), "statistic": list(self.data.names)},
                dims={
                    **dict.fromkeys(("value", "whitened"), parameter),
                    **dict.fromkeys(("prior", "prior_sd", "lower", "upper"), parameter),
                    **dict.fromkeys(("prediction", "observation", "observation_sd"), statistic),
                },
            )
        found.posterior.attrs |= {
            "method": self.method,
            "status": self.status,
            "effective_size": self.effective_size,
            "acceptance": self.acceptance,
            **(attributes or {}),
        }
        return found


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

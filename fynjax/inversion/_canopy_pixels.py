"""The traits of a uniform canopy in many pixels, each fitted with light from a table."""

from collections.abc import Mapping
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from fynjax._core.precision import double_precision
from fynjax._core.progress import track
from fynjax.inversion._canopy import ABSOLUTE_SD, RELATIVE_SD, CanopyTable, CanopyView, ready_pixels
from fynjax.inversion._data import Data
from fynjax.inversion._fit import fit_function
from fynjax.inversion._space import ParameterSpace
from fynjax.inversion._vectorised import evaluate_batches
from fynjax.sensors import BandSet, Sensor

_AT_ONCE = 64
_UNSEEN_SD = 1e3
"""Deviation of a band that a pixel has no value of [-]."""


class CanopyFits(eqx.Module):
    """What `fit_canopies` found, a row a pixel; NaN of pixels with fewer than three bands."""

    names: tuple[str, ...] = eqx.field(static=True)
    """Of the parameters that were fitted."""
    estimate: Float[np.ndarray, "pixel parameter"]
    lower: Float[np.ndarray, "pixel parameter"]
    """5 % quantile."""
    upper: Float[np.ndarray, "pixel parameter"]
    """95 % quantile."""
    constrained: Float[np.ndarray, "pixel parameter"]
    """Share of the prior variance that the data take away [-]."""
    converged: Bool[np.ndarray, " pixel"]
    misfit: Float[np.ndarray, " pixel"]
    """Root mean square of what is left, in errors: beyond 2 a pixel is unlike any such canopy."""


@double_precision
def fit_canopies(
    bands: Sensor | BandSet | Float[np.ndarray, " band"],
    reflectance: Float[np.ndarray, "pixel band"],
    view: CanopyView,
    *,
    soil: Float[np.ndarray, " band"] | float | None = None,
    known: Mapping[str, float] | None = None,
    max_steps: int = 40,
) -> CanopyFits:
    """What `fit_canopy` finds, in many pixels that are lit and seen alike.

    The light of canopies is tabulated once, in some 20 s of a processor. Pixels then take some
    milliseconds each.

    **Arguments:**

    - `bands`, `soil`, `known`, `max_steps`: as `fit_canopy` takes them.
    - `reflectance`: of each pixel in each band [-]; NaN where there is none. Values outside 0 to 1
      count as none.
    - `view`: how they are lit and seen.

    **Returns:** `CanopyFits`, with intervals as of `fit_canopy` and its default errors. The table
    adds 0.1 of these as root mean square, 0.5 at most. Not differentiable.

    **Raises:** `InputError` as `fit_canopy`, but for values outside 0 to 1.

    **Source:** as `fit_canopy`.

    **Example:**

        image = xr.open_dataset("s2.nc").reflectance.stack(pixel=("y", "x")).values.T
        fits = fit_canopies(fx.sensor("sentinel_2a"), image, CanopyView(35.0))
    """
    (model, space), values, seen = ready_pixels(bands, reflectance, view, soil, known)
    model = eqx.tree_at(
        lambda m: m.light, model, CanopyTable.made(view), is_leaf=lambda leaf: leaf is None
    )
    count = len(space.names)
    rows = np.full((len(values), 4 * count + 2), np.nan)
    filled = seen.sum(axis=1) >= 3
    points = np.concatenate([np.where(seen, values, 0.0), seen], axis=1)[filled]
    fit = _Fit(model, space, max_steps)
    batches = evaluate_batches(fit, points, batch=min(_AT_ONCE, len(points)))
    total = -(-len(points) // _AT_ONCE)
    rows[filled] = np.concatenate([*track(batches, "Fit pixels", total=total)])
    estimate, lower, upper, constrained = np.split(rows[:, : 4 * count], 4, axis=1)
    return CanopyFits(
        space.names, estimate, lower, upper, constrained, rows[:, -2] == 1.0, rows[:, -1]
    )


class _Fit(eqx.Module):
    """The fit of a pixel: its values, and which of them there are, in; numbers out."""

    model: Any
    space: ParameterSpace
    steps: int = eqx.field(static=True)

    def __call__(self, point: Float[Array, " twice"]) -> Float[Array, " number"]:
        value, there = jnp.split(point, 2)
        alone = jnp.hypot(ABSOLUTE_SD, RELATIVE_SD * value)
        alone = jnp.where(there > 0.0, alone, _UNSEEN_SD)
        shared = (ABSOLUTE_SD**2 + RELATIVE_SD**2 * jnp.outer(value, value)) * jnp.outer(
            there, there
        )
        names = tuple(f"{i}" for i in range(value.size))
        data = Data(names, value, alone).with_covariance(shared)
        found = fit_function(self.model, data, self.space, max_steps=self.steps)
        left = data.whiten(found.predicted - value)
        misfit = jnp.sqrt(jnp.sum(left**2) / jnp.sum(there))
        lower, upper = found.quantiles(0.05, 0.95)
        ends = jnp.stack([found.converged.astype(float), misfit])
        return jnp.concatenate([found.estimate, lower, upper, found.constrained, ends])

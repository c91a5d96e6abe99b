"""Numbers of a whole stand, of which images say more than of any single species' parameter."""

from collections.abc import Callable, Mapping
from functools import cache
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
from jaxtyping import Array, Float

from fynjax._core.precision import double_precision
from fynjax._core.seeds import generator
from fynjax.inversion._fit_result import FitResult
from fynjax.inversion._space import ParameterSpace
from fynjax.scene import PlotParameters, Scene, mean_trait, with_values


class Functional(NamedTuple):
    """A number that follows from a scene and its parameters."""

    words: str
    """Name of the number in sentences, such as "green leaf area"."""
    unit: str
    """Unit of the number, such as `m2 m-2`; "-" for a share."""
    value: Callable[[Scene, PlotParameters], Float[Array, ""]]
    """Differentiable in the parameters; of the stand in expectation (`Scene.expected`) it is the
    expectation over the number of plants."""


_crowns = eqx.filter_jit(Scene.visible_crowns)
"""Traced once for all numbers of a stand, each of which asks for it."""


def _shoots(scene: Scene, parameters: PlotParameters) -> Float[Array, " species"]:
    """Area index of the live shoots of each species over the ground of the plot [m2 m-2]."""
    of_species = jax.ops.segment_sum(
        _crowns(scene, parameters), scene.planting.species, len(scene.taxa)
    )
    return of_species / scene.ground_area * parameters.species.leaf_area_index


def _green(scene: Scene, parameters: PlotParameters) -> Float[Array, " species"]:
    return _shoots(scene, parameters) * (1.0 - parameters.species.dead_fraction)


def _ratio(above: Array, below: Array) -> Array:
    """A ratio, which is 0 with slope 0 where the denominator is."""
    some = below > 0.0
    return jnp.where(some, above / jnp.where(some, below, 1.0), 0.0)


def _dead(scene: Scene, parameters: PlotParameters) -> Float[Array, ""]:
    return jnp.sum(_shoots(scene, parameters) * parameters.species.dead_fraction)


def _dead_share(scene: Scene, parameters: PlotParameters) -> Float[Array, ""]:
    return _ratio(_dead(scene, parameters), jnp.sum(_shoots(scene, parameters)))


def _in_leaves(trait: str, factor: float) -> Callable[[Scene, PlotParameters], Float[Array, ""]]:
    """What green leaves hold of a substance over the ground [g m-2]: `trait` per leaf area, times
    the `factor` to g m-2."""

    def value(scene: Scene, parameters: PlotParameters) -> Float[Array, ""]:
        content = mean_trait(scene.species, parameters, trait)
        return factor * jnp.sum(_green(scene, parameters) * content)

    return value


def _cover(scene: Scene, parameters: PlotParameters) -> Float[Array, ""]:
    return jnp.sum(_crowns(scene, parameters)) / scene.ground_area


def _height(scene: Scene, parameters: PlotParameters) -> Float[Array, ""]:
    crowns = _crowns(scene, parameters)
    tall = parameters.species.height[scene.planting.species] * scene.planting.stature
    return _ratio(jnp.sum(crowns * tall), jnp.sum(crowns))


STAND_FUNCTIONALS: Mapping[str, Functional] = {
    "green_leaf_area": Functional(
        "green leaf area", "m2 m-2", lambda scene, plot: jnp.sum(_green(scene, plot))
    ),
    "dead_share": Functional("dead share of the shoots", "-", _dead_share),
    "canopy_chlorophyll": Functional(
        "canopy chlorophyll", "g m-2", _in_leaves("chlorophyll", 0.01)
    ),
    "crown_cover": Functional("ground under crowns", "-", _cover),
    "dead_area": Functional("dead area", "m2 m-2", _dead),
    "canopy_water": Functional("water in green leaves", "g m-2", _in_leaves("water", 1e4)),
    "leaf_mass": Functional("dry mass of green leaves", "g m-2", _in_leaves("dry_matter", 1e4)),
    "canopy_height": Functional("mean height of the crowns", "m", _height),
}
"""Numbers of a stand, over its ground: one-sided area of green leaves; share of the area of shoots
that is dead or woody; chlorophyll of the green leaves; share of the ground under crowns as seen
from above, dead plants included, of which the rest is gap between crowns; area of dead shoots;
water and dry mass of the green leaves; mean height of the plants, weighted by the areas of their
crowns."""

_LEADING = "green_leaf_area", "dead_share", "canopy_chlorophyll", "crown_cover"
"""Numbers of a stand that a headline names."""


@cache  # one object a form: what is compiled for it serves again
def _cover_of(form: str) -> Functional:
    def value(scene: Scene, parameters: PlotParameters) -> Float[Array, ""]:
        mine = jnp.array([one == form for one in scene.forms])[scene.planting.species]
        crowns = jnp.sum(jnp.where(mine, _crowns(scene, parameters), 0.0))
        return crowns / scene.ground_area

    return Functional(f"ground under crowns of the form {form}", "-", value)


def stand_functionals(scene: Scene) -> dict[str, Functional]:
    """Numbers of a stand by name: `STAND_FUNCTIONALS`, and of several growth forms the share of the
    ground under the crowns of each, as seen from above (`cover.<form>`).

    **Arguments:** `scene`, whose growth forms count.
    """
    forms = list(dict.fromkeys(scene.forms))
    covers = {f"cover.{form}": _cover_of(form) for form in forms} if len(forms) > 1 else {}
    return {**STAND_FUNCTIONALS, **covers}


_TINY = 1e-12
"""Distance from the ends of its range up to which a functional has a logarithm or logit."""
_DRAWS = 400
"""Draws from the prior for the spread of the stand's numbers before the data."""
_NINETY = 1.6449
"""Half of a normal's central 90 % [standard deviations]."""
_ROUNDING = 1e-12
"""Variance up to which a functional is the same but for the rounding of light."""


def stand_values(
    scene: Scene, parameters: PlotParameters | None = None
) -> dict[str, Float[Array, ""]]:
    """Each of `stand_functionals` by name, in its unit. Differentiable in the parameters.

    **Arguments:** `scene`; `parameters` in place of its own.
    """
    plot = scene.parameters if parameters is None else parameters
    return {name: one.value(scene, plot) for name, one in stand_functionals(scene).items()}


class StandNumbers(eqx.Module):
    """Numbers of a stand as functions of whitened coordinates."""

    scene: Scene
    parameters: PlotParameters
    """All parameters of the plot, also those that are not free."""
    space: ParameterSpace
    """The free parameters."""
    values: tuple[Callable[[Scene, PlotParameters], Float[Array, ""]], ...] = eqx.field(static=True)
    """The functionals."""

    def __call__(self, u: Float[Array, " free"]) -> Float[Array, " functional"]:
        """Each functional at `u`, of the stand in expectation."""
        plot = with_values(self.parameters, self.scene.taxa, self.space.named(u))
        stand = self.scene.expected()
        return jnp.stack([jnp.asarray(value(stand, plot), float) for value in self.values])

    @eqx.filter_jit
    def at(self, draws: Float[Array, "draw free"]) -> Float[Array, "draw functional"]:
        """Each functional at each of the `draws`."""
        return jax.lax.map(self, draws)

    @eqx.filter_jit
    def linear(
        self, u: Float[Array, " free"]
    ) -> tuple[Float[Array, " functional"], Float[Array, "functional free"]]:
        """Each functional at `u`, and its slopes."""
        return self(u), jax.jacrev(self)(u)


@double_precision
def stand_table(
    scene: Scene,
    parameters: PlotParameters,
    fit: FitResult,
    *,
    functionals: Mapping[str, Functional] | None = None,
    draws: Float[np.ndarray, "draw free"] | None = None,
) -> pd.DataFrame:
    """What a fit says of the stand: each functional before and after the data.

    The posterior is normal in the functional's logarithm, of a share between 0 and 1 in its logit,
    and of what may be zero or less in itself, linear about the estimate: draws of single
    parameters, each of which data leave wide, would bend a sum that they know.

    **Arguments:**

    - `scene`: that was fitted.
    - `parameters`: of the plot; those that are not free count.
    - `fit`: the estimate with its covariance.
    - `functionals`: by name, in place of `stand_functionals`; `Functional`s of one's own may be
      among them.
    - `draws`: of a posterior in whitened coordinates, whose medians and quantiles are to be given;
      those of the fit's covariance by default.

    **Returns:** a row for each of `functionals`: name, unit, median and quantiles of 5 and
    95 % of the prior (`prior`, `prior_q05`, `prior_q95`) and of the posterior (`estimate`, `q05`,
    `q95`), and `constrained`, the share of the prior variance, of the logarithm or logit where it
    is that, that the data removed [-]. What is the same whatever is free has no interval.
    """
    functionals = stand_functionals(scene) if functionals is None else functionals
    values = tuple(one.value for one in functionals.values())
    numbers = StandNumbers(scene, parameters, fit.space, values)
    normal = generator(0, 53).normal(size=(_DRAWS, len(fit.names)))
    prior = np.asarray(numbers.at(jnp.asarray(normal.clip(-3.0, 3.0))), float)
    value, slopes = (np.asarray(x, float) for x in numbers.linear(fit.whitened))
    shares = np.array([one.unit == "-" for one in functionals.values()])
    # A scale on which a normal stays within range, if all draws have one.
    low, high = (f(np.concatenate([prior, value[None]]), axis=0) for f in (np.min, np.max))
    kind = np.where(shares & (low > 0.0) & (high < 1.0), "logit", np.where(low > 0.0, "log", ""))
    # The delta method, on that scale.
    relative = slopes * _slope_of_normal(value, kind)[:, None]
    variance = np.einsum("fi,ij,fj->f", relative, np.asarray(fit.covariance, float), relative)
    before = _normal(prior, kind).var(axis=0)
    # What no free parameter changes differs by rounding alone, and has no interval.
    known = before > _ROUNDING
    quantiles = (0.05, 0.5, 0.95)
    low, middle, high = np.quantile(prior, quantiles, axis=0)
    if draws is None:
        centre, half = _normal(value, kind), _NINETY * np.sqrt(np.where(known, variance, 0.0))
        after = [_from_normal(place, kind) for place in (centre - half, centre, centre + half)]
    else:
        found = np.asarray(numbers.at(jnp.asarray(draws)), float)
        after, variance = [*np.quantile(found, quantiles, axis=0)], _normal(found, kind).var(axis=0)
    removed = 1.0 - variance / np.where(known, before, 1.0)
    return pd.DataFrame(
        {
            "name": list(functionals),
            "unit": [one.unit for one in functionals.values()],
            "prior": middle,
            "prior_q05": low,
            "prior_q95": high,
            "estimate": after[1],
            "q05": after[0],
            "q95": after[2],
            "constrained": np.where(known, np.maximum(removed, 0.0), 0.0),
        }
    )


def _normal(value: np.ndarray, kind: np.ndarray) -> np.ndarray:
    """The coordinate in which the posterior of each functional is taken as normal."""
    inside = np.clip(value, _TINY, None)
    odds = inside / np.clip(1.0 - value, _TINY, None)
    return np.select([kind == "logit", kind == "log"], [np.log(odds), np.log(inside)], value)


def _slope_of_normal(value: np.ndarray, kind: np.ndarray) -> np.ndarray:
    """Slope of that coordinate by the functional."""
    inside = np.clip(value, _TINY, None)
    of_share = 1.0 / (inside * np.clip(1.0 - value, _TINY, None))
    return np.select([kind == "logit", kind == "log"], [of_share, 1.0 / inside], 1.0)


def _from_normal(place: np.ndarray, kind: np.ndarray) -> np.ndarray:
    """The functional at that coordinate."""
    small = np.clip(place, -500.0, 500.0)
    share = 1.0 / (1.0 + np.exp(-small))
    return np.select([kind == "logit", kind == "log"], [share, np.exp(small)], place)


def stand_sentence(table: pd.DataFrame, functionals: Mapping[str, Functional] | None = None) -> str:
    """The stand in one sentence.

    **Arguments:** `table`, from `stand_table`; the `functionals` to be named, by default the four
    that lead `STAND_FUNCTIONALS`, or the first four of a table that has none of these.
    """
    rows = table.set_index("name")
    known = {name: STAND_FUNCTIONALS[name] for name in _LEADING if name in rows.index}
    named = functionals or known or dict.fromkeys(rows.index[:4])
    parts = []
    for name, functional in named.items():
        row = rows.loc[name]
        middle, low, high = (f"{row[column]:.3g}" for column in ("estimate", "q05", "q95"))
        unit = "" if row["unit"] == "-" else f" {row['unit']}"
        parts.append(f"{functional.words if functional else name} {middle} [{low}, {high}]{unit}")
    return f"The stand: {', '.join(parts)} (5 to 95 %)."

"""Cover and leaf traits of a plot from its measured spectrum: parameters, priors, the fit.

The parameters are those of a whole plot. A mean spectrum cannot separate species, so each
parameter moves all species of a plot together, by a factor on what its tables say.
"""

import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple, Self

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from fynjax.app.io.plot import BY_FORM, FACTORS, LearnedPrior
from fynjax.inversion import (
    GAIN,
    Data,
    FitResult,
    LogPosterior,
    ParameterSpace,
    SpectrumView,
    fit,
    predicted_statistics,
    statistics_and_jacobian,
    weigh_spectrum,
)
from fynjax.leaf import LeafParameters
from fynjax.scene import PARAMETERS, PlotParameters, Scene
from fynjax.studies.bioscape._plot_files import leaf_parameters
from fynjax.studies.bioscape._plots import BioscapePlot

MODEL_SD = 0.05
"""Relative error of the model in each band for itself, assumed [-]."""
LEAST_SD = 0.01
"""Relative error of a band for itself on top of a learned error, for rounding [-]."""
MOST_BANDS = 24
ROOM, SOFTNESS = 2.6, 0.25


@dataclass(frozen=True)
class Free:
    """A free parameter of a plot: where it may lie, and how wide its prior is."""

    what: str
    lower: float
    upper: float
    centre: float
    sd: float


def _of_the_ground(kind: str, centre: float, sd: float) -> Free:
    record = PARAMETERS[kind]
    return Free(f"{record.name.lower()} [-]", record.lower, record.upper, centre, sd)


FREE: dict[str, Free] = {
    "cover": Free("factor on the crowns' cover of all live species", 0.2, 2.5, 1.0, 0.25),
    "standing_dead": Free("factor on the cover of dead plants that stand", 0.05, 2.2, 1.0, 0.5),
    "leaf_area_index": Free("factor on the leaf area of a crown", 0.2, 2.5, 1.0, 0.3),
    "dead_fraction": Free("factor on the dead tissue of live shoots", 0.02, 2.2, 1.0, 0.6),
    "leaf_mass_per_area": Free("factor on dry matter, water in proportion", 0.2, 3.0, 1.0, 0.3),
    "water_per_dry_matter": Free("factor on water, dry matter as it is", 0.2, 3.0, 1.0, 0.3),
    "chlorophyll": Free("factor on chlorophyll and carotenoids", 0.1, 2.0, 1.0, 0.3),
    "structure": Free("factor on PROSPECT's N", 0.6, 1.5, 1.0, 0.1),
    "soil_brightness": _of_the_ground("brightness", 1.0, 0.3),
    "soil_moisture": _of_the_ground("moisture", 0.2, 0.15),
    "litter": _of_the_ground("litter_fraction", 0.5, 0.2),
}
"""Priors where the tables are the prior: covers to a quarter, as a crew sees them; the rest wide,
assumed. Dead tissue, at most all of a shoot, has the absolute sd of its record, 0.25, at 0.42."""


@dataclass(frozen=True)
class ReferencePlot:
    """Reference values of a plot, on which its parameters are factors."""

    plot: BioscapePlot
    """The plot, with the traits that its scene was built with."""

    @property
    def crowns(self) -> float:
        """Crown area of the live species over ground [-], set at random."""
        live = self.plot.listed_cover + self.plot.other_cover
        return live / (1.0 - self.plot.packing)

    def live(self, factor: Any) -> Any:
        """Live cover seen from above [-] at a factor on the cover: the table's at 1, and the law
        of crowns set at random elsewhere."""
        whole = 1.0 - np.exp(-self.crowns)
        return np.minimum(self.plot.live * (1.0 - np.exp(-self.crowns * factor)) / whole, 1.0)

    def factor(self, live: float) -> float:
        """Inverse of `live`; infinite where no number of crowns covers so much."""
        share = live / self.plot.live * (1.0 - np.exp(-self.crowns))
        return float(-np.log1p(-share) / self.crowns) if share < 1.0 else np.inf

    def dead(self, values: Mapping[str, Any]) -> Any:
        """Dead cover seen from above [-]: plants that stand dead, and litter where neither they
        nor live ones cover the ground."""
        standing = self._standing(values)
        return standing + values["litter"] * self._open(values)

    def bare(self, values: Mapping[str, Any]) -> Any:
        """Soil and rock seen from above [-]."""
        return (1.0 - values["litter"]) * self._open(values)

    def _standing(self, values: Mapping[str, Any]) -> Any:
        noted = self.plot.standing_dead * values["standing_dead"]
        noted = noted + self.plot.dead_in_crowns * values["cover"]
        return np.minimum(noted, 1.0 - self.live(values["cover"]))

    def _open(self, values: Mapping[str, Any]) -> Any:
        return 1.0 - self.live(values["cover"]) - self._standing(values)

    def leaf_mass(self, factor: Any) -> Any:
        """Leaf mass per projected area, weighted with cover [g m-2]."""
        mean = self.plot.weighted_mean("leaf_mass_per_area")
        assert mean is not None
        return mean * factor

    def water(self, factor: Any) -> Any:
        """Water of the leaves, weighted with cover [% of fresh mass]: of leaves as planted, whose
        water is at most what PROSPECT can mean."""
        total: Any = 0.0
        for s in self.plot.species:
            leaf = leaf_parameters(s)
            water = factor * leaf["water"]
            total += s.cover / self.plot.listed_cover * water / (water + leaf["dry_matter"])
        return 100.0 * total


QUANTITIES: dict[str, tuple[str, str, str]] = {
    "live_cover": ("cover", "live cover", "%"),
    "leaf_mass_per_area": ("leaf_mass_per_area", "leaf mass per area", "g m-2"),
    "water_content": ("water_per_dry_matter", "water content", "% of fresh mass"),
}
"""Quantities of a plot that follow from one parameter, of which other plots are a prior: the
parameter, words, unit."""
COVERS = {"dead_cover": ("dead cover", "%"), "bare_cover": ("bare cover", "%")}
"""Quantities that follow from several parameters: words, unit."""
STAND = {
    "leaf_area_index": ("leaf area of the stand, live", "m2 m-2"),
    "dead_fraction": ("dead tissue of the shoots", "-"),
    "gap": ("ground seen from above", "%"),
}
"""Quantities of the planted scene: words, unit."""
WORDS = {name: words for name, (_, *words) in QUANTITIES.items()} | COVERS | STAND
"""Words and unit of each quantity that is estimated."""


def quantity(reference: ReferencePlot, name: str, factor: Any) -> Any:
    """One of `QUANTITIES` at a factor."""
    if name == "live_cover":
        return 100.0 * reference.live(factor)
    return (reference.leaf_mass if name == "leaf_mass_per_area" else reference.water)(factor)


def scaled_leaf(leaf: LeafParameters, factors: Mapping[str, Array]) -> LeafParameters:
    """Leaves with some parameters times a factor."""
    return eqx.tree_at(
        lambda l: [getattr(l, name) for name in factors],
        leaf,
        [getattr(leaf, name) * factor for name, factor in factors.items()],
    )


class PlotSpectrumForward(eqx.Module):
    """The forward model: a plot's mean spectrum at values of `FREE`.

    Called with a scene and the parameters as the tables have them, so that all plots share one
    compilation. Differentiable.
    """

    view: SpectrumView
    dead: tuple[bool, ...] = eqx.field(static=True, converter=tuple)
    """Mask of the species that are standing dead plants."""

    def __call__(
        self, values: Float[Array, " free"], scene: Scene, parameters: PlotParameters
    ) -> Float[Array, " band"]:
        return self.view.predict(scene, self._plot(values, parameters))

    def jacobian(
        self,
        values_at: Callable[[Array], Array],
        u: Float[Array, " free"],
        scene: Scene,
        parameters: PlotParameters,
    ) -> tuple[Float[Array, " band"], Float[Array, "band free"]]:
        return self.view.jacobian(scene, lambda u: self._plot(values_at(u), parameters), u)

    def stand(
        self, values: Float[Array, " free"], scene: Scene, parameters: PlotParameters
    ) -> Float[Array, " quantity"]:
        """Quantities of the planted scene, in the order of `STAND`. Differentiable."""
        plot = self._plot(values, parameters)
        crowns = scene.crown_areas(plot) * scene.crown_share(plot)
        ground = scene.grid.extent[0] * scene.grid.extent[1]
        share = jnp.zeros(len(self.dead)).at[scene.planting.species].add(crowns / ground)
        shoots = share * plot.species.leaf_area_index
        dead = jnp.sum(shoots * plot.species.dead_fraction)
        gap = scene.gap_fraction(plot)
        return jnp.stack([shoots.sum() - dead, dead / shoots.sum(), 100.0 * gap]).astype(
            values.dtype
        )

    def _plot(self, values: Array, parameters: PlotParameters) -> PlotParameters:
        dead = np.asarray(self.dead)
        at = {name: values[i] for i, name in enumerate(FREE)}
        species, ground = parameters.species, parameters.ground
        mass = at["leaf_mass_per_area"]
        factors = {
            "structure": at["structure"],
            "chlorophyll": at["chlorophyll"],
            "carotenoids": at["chlorophyll"],
            "dry_matter": mass,
            "water": mass * at["water_per_dry_matter"],
        }
        return replace(
            parameters,
            species=replace(
                species,
                cover=species.cover * jnp.where(dead, at["standing_dead"], at["cover"]),
                leaf_area_index=species.leaf_area_index * at["leaf_area_index"],
                dead_fraction=jnp.minimum(species.dead_fraction * at["dead_fraction"], 1.0),
            ),
            leaf=scaled_leaf(parameters.leaf, factors),
            ground=replace(
                ground,
                brightness=at["soil_brightness"],
                moisture=at["soil_moisture"],
                litter_fraction=at["litter"],
            ),
        )


def prior_space(
    plot: BioscapePlot,
    elsewhere: dict[str, tuple[float, float]] | None = None,
    learned: LearnedPrior | None = None,
) -> ParameterSpace:
    """Priors of a plot's parameters: those of `FREE`, about the plot's own tables.

    A `learned` population has the spreads of what it knows, with leaf area and dead tissue as in
    the plot's dominant growth form, and the soil's brightness. The plot's files have its means.

    `elsewhere`, mean and standard deviation of some of `QUANTITIES` over other plots, replaces
    what the plot's tables say of them. Warns where their mean cover asks for more or fewer crowns
    than the plot has room for: the centre is then a twentieth of the range inside that bound.
    """
    centre, sd = ({n: getattr(f, k) for n, f in FREE.items()} for k in ("centre", "sd"))
    # Field crews cannot distinguish 0 from 5 %, nor 95 from 100. The spread is half-way between
    # certain and unknown, in the coordinate of a share.
    centre["litter"] = float(np.clip(plot.litter_fraction, 0.05, 0.95))
    sd["litter"] = centre["litter"] * (1.0 - centre["litter"])
    if learned is not None:
        values, form = learned.values(plot.name), plot.dominant.shape.growth_form
        centre["soil_brightness"] = values["soil_brightness"]
        sd["soil_brightness"] = learned.sd("soil_brightness")
        for name in ("leaf_area_index", "dead_fraction", *set(FREE) & set(FACTORS)):
            if name != "soil_brightness":  # the others are factors on the population's means
                known = f"{name}.{form}" if name in BY_FORM else name
                sd[name] = learned.sd(known) / values[known]
    reference = ReferencePlot(plot)
    for name, (mean, spread) in ({} if elsewhere is None else elsewhere).items():
        free = QUANTITIES[name][0]
        if name == "live_cover":  # the scene's traits are already that mean, its cover is not
            centre[free] = _crowns_for(reference, mean)
        near = [quantity(reference, name, centre[free] + d) for d in (-0.01, 0.01)]
        sd[free] = spread * 0.02 / (near[1] - near[0])
    return logit_space({n: (f.lower, f.upper, centre[n], sd[n]) for n, f in FREE.items()})


def logit_space(priors: Mapping[str, tuple[float, float, float, float]]) -> ParameterSpace:
    """Space of parameters whose lower and upper bound, median and standard deviation are given.

    What plots share is learned in the logit between the bounds, where the standard deviation is
    that over the logit's slope at the median.
    """
    lower, upper, centre, sd = np.array(list(priors.values()), float).T
    slope = (centre - lower) * (upper - centre) / (upper - lower)
    return ParameterSpace(tuple(priors), lower, upper, centre, width=sd / slope)


def _crowns_for(reference: ReferencePlot, live_percent: float) -> float:
    """Factor on the crowns that gives a live cover, within what a plot has room for."""
    wanted, free = reference.factor(live_percent / 100.0), FREE["cover"]
    if free.lower < wanted < free.upper:
        return wanted
    margin = 0.05 * (free.upper - free.lower)
    used = free.lower + margin if wanted <= free.lower else free.upper - margin
    warnings.warn(
        f"{reference.plot.name}: the mean live cover of other plots, {live_percent:.0f} %, asks "
        f"for {wanted:.3g} times its crowns, outside {free.lower:g} to {free.upper:g}; the prior "
        f"is centred on {used:.3g}",
        stacklevel=3,
    )
    return used


def plot_data(
    names: Sequence[str],
    flights: Float[np.ndarray, "flight band"],
    repeatability: Float[np.ndarray, "band band"] | None,
    error: Float[np.ndarray, "band band"] | None = None,
) -> Data:
    """A plot's mean spectrum with its errors: `MODEL_SD`, what a plot's flights differ by, and the
    gain and offset of `weigh_spectrum`; or instead of all but the offset a learned `error`, the
    covariance of the logarithm of reflectance."""
    mean = flights.mean(axis=0)
    if error is not None:
        # What learned plots were off by holds what flights differ by.
        shared = error * np.outer(mean, mean)
        return weigh_spectrum(names, mean, LEAST_SD, sampling=shared)
    sampling = None if repeatability is None else repeatability / len(flights)
    return weigh_spectrum(names, mean, MODEL_SD, sampling=sampling, gain=GAIN)


def flight_covariance(
    plots: Sequence[Float[np.ndarray, "flight band"]],
) -> Float[np.ndarray, "band band"] | None:
    """Covariance of one flight about the mean of its plot, pooled over the plots; None where no
    plot was flown over twice."""
    repeated = [flights for flights in plots if len(flights) > 1]
    if not repeated:
        return None
    freedom = sum(len(flights) - 1 for flights in repeated)
    apart = np.concatenate([flights - flights.mean(axis=0) for flights in repeated])
    return apart.T @ apart / freedom


def bias_corrected_data(
    names: Sequence[str],
    flights: Float[np.ndarray, "flight band"],
    residuals: Float[np.ndarray, "plot band"],
) -> tuple[Data, Float[np.ndarray, " band"]]:
    """Leave-one-out bias correction: a plot's mean spectrum with the errors that the model made
    on other plots, and the mean of these.

    **Arguments:** `residuals`, measured less simulated spectra of other plots, simulated from
    their own tables. They hold all there is: errors of the model and of the tables, and what
    flights and stand realisations differ by. Their covariance, shrunk half-way to the diagonal
    because plots are few, grows by that of their mean.
    """
    count = len(residuals)
    covariance = np.cov(residuals, rowvar=False)
    covariance = 0.5 * (covariance + np.diag(np.diagonal(covariance))) * (1.0 + 1.0 / count)
    covariance += 1e-8 * np.eye(len(covariance))
    whitener = np.linalg.inv(np.linalg.cholesky(covariance))
    parts = (flights.mean(axis=0), np.sqrt(np.diagonal(covariance)), whitener)
    found = [jnp.asarray(part) for part in parts]
    return Data(tuple(names), found[0], found[1], found[2]), residuals.mean(axis=0)


@dataclass(frozen=True)
class PlotEstimate:
    """Posterior of a plot, given its spectrum and a prior."""

    space: ParameterSpace
    whitened: np.ndarray
    """Estimate of each free parameter in prior standard deviations from the prior's centre."""
    covariance: np.ndarray
    """Posterior covariance of the whitened parameters [free, free]."""
    before: np.ndarray
    """Spectrum at the prior's centre, as the model has it."""
    after: np.ndarray
    """Spectrum at the estimate, with the bias correction added."""
    misfit: tuple[float, float]
    """Root mean square of the whitened misfit before and after [-]."""
    converged: bool
    stand: np.ndarray
    """Quantities of the stand (`STAND`) at the estimate."""
    stand_slope: np.ndarray
    """Derivatives of the quantities of the stand by the whitened parameters [quantity, free]."""

    @classmethod
    def of(cls, space: ParameterSpace, arrays: Sequence[Array | np.ndarray]) -> Self:
        """From what `infer_plot` gives."""
        u, covariance, before, after, misfit, converged, stand, slope = map(np.asarray, arrays)
        return cls(
            space, u, covariance, before, after, (float(misfit[0]), float(misfit[1])),
            bool(converged), stand, slope,
        )  # fmt: skip

    @property
    def constrained(self) -> np.ndarray:
        """1 less posterior over prior variance [-]."""
        return 1.0 - np.diagonal(self.covariance)

    def draws(self, count: int = 4000) -> Float[np.ndarray, "draw free"]:
        """Draws from the Gaussian about the estimate, whitened."""
        random = np.random.default_rng(61)
        return random.multivariate_normal(self.whitened, self.covariance, count, method="cholesky")

    def quantity(
        self, reference: ReferencePlot, name: str, u: Float[np.ndarray, "draw free"]
    ) -> Float[np.ndarray, " draw"]:
        """One of `WORDS` at whitened parameters; those of `STAND` linear about the estimate."""
        if name in STAND:
            k = list(STAND).index(name)
            value = self.stand[k] + (u - self.whitened) @ self.stand_slope[k]
            return np.clip(value, 0.0, {"gap": 100.0, "dead_fraction": 1.0}.get(name, np.inf))
        at = np.asarray(jax.vmap(self.space.physical)(jnp.asarray(u)))
        values = dict(zip(self.space.names, at.T, strict=True))
        if name in QUANTITIES:
            return quantity(reference, name, values[QUANTITIES[name][0]])
        return 100.0 * (reference.dead if name == "dead_cover" else reference.bare)(values)

    def removed(self, reference: ReferencePlot, name: str) -> float:
        """Share of the prior variance of a quantity that the spectrum removes [-], linear about
        the estimate; 0 where no free parameter moves it."""
        step = 1e-3 * np.eye(len(self.whitened))
        ends = [self.quantity(reference, name, self.whitened + sign * step) for sign in (1, -1)]
        slope = ends[0] - ends[1]
        prior = float(slope @ slope)
        return 1.0 - float(slope @ self.covariance @ slope) / prior if prior > 0 else 0.0


class PlotCase(NamedTuple):
    """One plot with its spectrum and what is known before."""

    data: Data
    space: ParameterSpace
    parameters: PlotParameters
    scenes: tuple[Scene, ...]
    """Stand realisations; the first is fitted, the others estimate the variance over them."""
    bias: Float[np.ndarray, " band"] | None = None
    """Added to the model's spectrum; `data` then hold the errors of all that, those of realisations
    too (`bias_corrected_data`)."""


def infer_plot(case: PlotCase, predict: PlotSpectrumForward) -> tuple[Array, ...]:
    """Fit one plot: the arrays of a `PlotEstimate`."""
    data, space, parameters, scenes, bias = case
    none = jnp.zeros_like(data.value)
    offset = none if bias is None else jnp.asarray(bias)
    densities = [LogPosterior(predict, space, data, none, (scene, parameters)) for scene in scenes]
    start = jnp.zeros(len(space.names))
    prior_spectra = jnp.stack([predicted_statistics(density, start) for density in densities])
    grown = data.with_scatter(prior_spectra[1:] - prior_spectra[0]) if bias is None else data
    result: FitResult = fit(
        predict,
        grown,
        space,
        max_steps=20,
        tolerance=0.02,
        context=densities[0].context,
        offset=offset,
    )
    others = [statistics_and_jacobian(density, result.whitened) for density in densities[1:]]
    deviations = jnp.stack([value for value, _ in others]) + offset - result.predicted
    if bias is not None:
        deviations = jnp.zeros_like(deviations)
    scattered = replace(result, data=data).marginal(
        deviations, jnp.stack([slope for _, slope in others])
    )
    spectra = (prior_spectra[0] + offset, result.predicted)
    rest = [grown.whiten(spectrum - grown.value) for spectrum in spectra]
    return (
        result.whitened, scattered.covariance, prior_spectra[0], result.predicted,
        jnp.stack([jnp.sqrt(jnp.mean(r**2)) for r in rest]), jnp.asarray(result.converged),
        *_stand(predict, space, result.whitened, scenes[0], parameters),
    )  # fmt: skip


@eqx.filter_jit
def _stand(
    predict: PlotSpectrumForward,
    space: ParameterSpace,
    u: Float[Array, " free"],
    scene: Scene,
    parameters: PlotParameters,
) -> tuple[Float[Array, " quantity"], Float[Array, "quantity free"]]:
    """Quantities of `STAND`, and their derivatives by the whitened parameters."""

    def at(u: Array) -> Array:
        return predict.stand(space.physical(u), scene, parameters)

    return at(u), jax.jacrev(at)(u)

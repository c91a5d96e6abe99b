"""What plots of fynbos share, and how they vary: parameters that `fynjax bioscape learn` estimates.

By growth form: dead tissue and clumping of live shoots, and leaf area index. Shared: leaf chemistry
as factors on what tables and traits say, brightness of soil and of dead tissue. All but clumping
was chosen before any left-out score was read, clumping before any with it: less of it closes crowns
of the same leaf area, and brightens them. Dead tissue in shoots does not follow the dead cover of a
plot: a slope for it lowered the marginal density of the 18 plots, and was dropped after scores were
read.
"""

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from fynjax.app.io.plot import (
    BY_FORM,
    FACTORS,
    LEAFY_FORMS,
    PRIOR_PARAMETERS,
    assumed_by_form,
    leaf_factors,
)
from fynjax.inversion import Hyperprior, ParameterSpace, SpectrumView
from fynjax.scene import PARAMETERS, PlotParameters, Scene
from fynjax.studies.bioscape._assumed import ASSUMED_POPULATION
from fynjax.studies.bioscape._inversion import FREE, logit_space, scaled_leaf
from fynjax.studies.bioscape._plots import BioscapePlot

PER_PLOT = tuple(PRIOR_PARAMETERS)
"""Parameters of a plot."""
COVER_ERROR = "ground seen less bare cover"
MEANS = (*PER_PLOT, COVER_ERROR)
"""Means of the population: those of the parameters of a plot, and by how much more ground is seen
from above between leaves and stems than crews note as bare or dead [-]."""
_SHARED = ("shoot_clumping", "structure")
"""Properties of shoots and leaves that are the same in every plot."""
EFFECTS = tuple(name for name in (*BY_FORM, *FACTORS) if name not in _SHARED)
"""Random effects of plots: dead tissue and leaf area of all forms alike, and the others."""

_ALIKE = 0.7
"""Correlation of the errors of assumed values between growth forms."""
_COVER_ERROR_SD, _CREW_SD = 0.15, 0.10
"""Crews judge covers to a tenth of the plot, and count as covered what a crown's outline encloses:
how much ground is seen through crowns is known to 0.15 only, the same in all plots."""
_EFFECT_SD, _EFFECT_WEIGHT = 0.5, 4.0
_ERROR_SD, _ERROR_REACH_NM, _ERROR_OWN, _ERROR_WEIGHT = 0.10, 200.0, 0.1, 10.0
_DARKEST = 0.005
"""Reflectance below which a logarithm says nothing; spectrometers are that uncertain [-]."""


def population_space() -> ParameterSpace:
    """Parameters of a plot with what is assumed of their means: by the growth forms themselves
    (`GrowthForm.prior`), and the records' priors for the rest."""
    priors, by_form = {}, assumed_by_form()
    for name in PER_PLOT:
        centre = ASSUMED_POPULATION[name]
        if name in by_form:
            record = PARAMETERS[name.split(".")[0]]
            priors[name] = (record.lower, record.upper, *by_form[name])
        elif name == "wood_brightness":
            record = PARAMETERS[name]
            assert record.relative_sd is not None
            priors[name] = (record.lower, record.upper, centre, record.relative_sd)
        else:
            free = FREE[name]
            priors[name] = (free.lower, free.upper, centre, free.sd)
    return logit_space(priors)


def effect_matrix() -> Float[np.ndarray, "parameter effect"]:
    """1 where a random effect moves a parameter of a plot, else 0."""
    return np.array([[float(n.split(".")[0] == e) for e in EFFECTS] for n in PER_PLOT])


def hyperprior(wavelength: Float[np.ndarray, " band"]) -> Hyperprior:
    """What is assumed of the population before any spectrum: `population_space`, alike errors of
    growth forms, effects of half of that, errors of a tenth that neighbouring bands share. The
    last statistic is the share of ground seen from above, as sure as crews are of covers."""
    count = len(MEANS)
    covariance = np.eye(count)
    kinds = [n.split(".")[0] if "." in n else "" for n in MEANS]
    for i in range(count):
        for j in range(count):
            if i != j and kinds[i] and kinds[i] == kinds[j]:
                covariance[i, j] = _ALIKE
    covariance[-1, -1] = _COVER_ERROR_SD**2
    apart = np.abs(wavelength[:, None] - wavelength) / _ERROR_REACH_NM
    bands = len(wavelength)
    error = np.zeros((bands + 1, bands + 1))
    error[:bands, :bands] = (1.0 - _ERROR_OWN) * np.exp(-apart) + _ERROR_OWN * np.eye(bands)
    error *= _ERROR_SD**2
    error[-1, -1] = _CREW_SD**2
    return Hyperprior(
        np.zeros(count), covariance, np.full(len(EFFECTS), _EFFECT_SD), _EFFECT_WEIGHT,
        error, _ERROR_WEIGHT, known=1,
    )  # fmt: skip


def uncovered(plot: BioscapePlot) -> float:
    """Share of a plot that its tables leave to the ground: neither live nor standing dead [-]."""
    return 1.0 - min(plot.live + plot.standing_dead, 1.0)


def log_reflectance(reflectance: Array) -> Array:
    """Logarithm of a reflectance, which falls no further below the darkest that means something."""
    return jnp.log(jnp.maximum(reflectance, _DARKEST))


class PopulationForward(eqx.Module):
    """Logarithm of a plot's mean spectrum and the share of ground seen, at values of `PER_PLOT`."""

    view: SpectrumView
    forms: tuple[str, ...] = eqx.field(static=True)
    """Growth form of each species of the scene."""

    def __call__(
        self, values: Float[Array, " parameter"], scene: Scene, parameters: PlotParameters
    ) -> Float[Array, " statistic"]:
        plot = self.plot(values, parameters)
        spectrum = self.view.predict(scene, plot).astype(values.dtype)
        gap = scene.gap_fraction(plot).astype(values.dtype)
        return jnp.append(log_reflectance(spectrum), gap)

    def linearised(
        self,
        space: ParameterSpace,
        u: Float[Array, " parameter"],
        scene: Scene,
        parameters: PlotParameters,
    ) -> tuple[Float[Array, " statistic"], Float[Array, "statistic parameter"]]:
        """Statistics and their derivatives by the whitened parameters."""

        def at(u: Array) -> PlotParameters:
            return self.plot(space.physical(u), parameters)

        spectrum, slope = self.view.jacobian(scene, at, u)
        gap, gap_slope = jax.value_and_grad(lambda u: scene.gap_fraction(at(u)).astype(u.dtype))(u)
        return (
            jnp.append(log_reflectance(spectrum), gap),
            jnp.vstack([slope / jnp.maximum(spectrum, _DARKEST)[:, None], gap_slope]),
        )

    def plot(self, values: Array, parameters: PlotParameters) -> PlotParameters:
        """The parameters of a plot with those of the population in place of its own."""
        at = {name: values[i] for i, name in enumerate(PER_PLOT)}
        species = parameters.species

        def by_form(kind: str) -> Array:
            own = getattr(species, kind)
            here = [at.get(f"{kind}.{form}", own[i]) for i, form in enumerate(self.forms)]
            return jnp.stack(here)

        # Where tables state the dead cover of a species, its live part is that much less.
        usual = np.array(
            [ASSUMED_POPULATION.get(f"dead_fraction.{form}", 0.0) for form in self.forms]
        )
        live = (1.0 - by_form("dead_fraction")) * (1.0 - species.dead_fraction) / (1.0 - usual)
        leafy = np.isin(self.forms, LEAFY_FORMS)
        return replace(
            parameters,
            species=replace(
                species,
                leaf_area_index=by_form("leaf_area_index"),
                shoot_clumping=by_form("shoot_clumping"),
                dead_fraction=jnp.where(leafy, 1.0 - live, species.dead_fraction),
            ),
            leaf=scaled_leaf(parameters.leaf, leaf_factors(at)),
            ground=replace(
                parameters.ground,
                brightness=at["soil_brightness"],
                wood_brightness=at["wood_brightness"],
            ),
        )

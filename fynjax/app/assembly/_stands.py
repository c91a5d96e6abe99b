"""Stands drawn from a learned prior, and their spectra: what a regression from spectra to covers
and leaves is trained with.

Nobody knows which species grow in a pixel. A stand has a species of each growth form, whose covers,
sizes and leaves are drawn. One planted stand is lit with many sets of leaves, dead tissue and soil:
all of them are bands of one scene, whose diffuse light is reduced to a few solves.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import scipy.special
from jaxtyping import Array, Float

from fynjax._core.precision import double_precision, drawn_in_double
from fynjax._core.seeds import generator
from fynjax.app.io.plot import BY_FORM, LearnedPrior, leaf_factors
from fynjax.canopy import FORMS, GrowthForm
from fynjax.inversion import nadir_imager
from fynjax.leaf import FLAT, ROUND, LeafParameters, structure_from_dry_matter
from fynjax.radiation import Accuracy, render, solve_light
from fynjax.scene import (
    PARAMETERS,
    USUAL_LEAF,
    AimedSensor,
    GroundParameters,
    LightParameters,
    PlantingRules,
    PlotParameters,
    Scene,
    Species,
    SpeciesParameters,
    build_scene,
    leaf_parameters,
)
from fynjax.sensors import BandSet


@dataclass(frozen=True)
class StandQuantity:
    """A quantity of a stand that is estimated from its spectrum."""

    words: str
    unit: str
    description: str


STAND_QUANTITIES: dict[str, StandQuantity] = {
    "live_cover": StandQuantity(
        "live cover", "1", "Share of the ground under crowns of live plants, seen from above."
    ),
    "dead_cover": StandQuantity(
        "dead cover",
        "1",
        "Share of the ground, seen from above and not under live crowns, with dead plants that "
        "stand or with litter.",
    ),
    "bare_cover": StandQuantity(
        "bare ground", "1", "Share of the ground, seen from above, that is soil or rock."
    ),
    "dead_fraction": StandQuantity(
        "dead tissue of live shoots",
        "1",
        "Share of the area of the shoots of live plants that is dead, brown or woody.",
    ),
    "leaf_area": StandQuantity(
        "live leaf area", "m2 m-2", "One-sided area of live leaves over the ground."
    ),
    "leaf_mass_per_area": StandQuantity(
        "leaf mass per area",
        "g m-2",
        "Dry mass over projected area of live leaves as crews measure it, mean over the crowns.",
    ),
    "water_content": StandQuantity(
        "leaf water content", "%", "Water over fresh mass of live leaves, mean over the crowns."
    ),
    "chlorophyll": StandQuantity(
        "leaf chlorophyll", "ug cm-2", "Chlorophyll over area of live leaves, mean over the crowns."
    ),
}
"""What is known of every simulated stand, in the order of its columns."""

_COVERED, _DEAD = (6.5, 1.3), (0.55, 0.5)
"""Beta distributions of the share of the ground under live crowns, and of the share of the rest
that is dead: those of 18 plots of the Cape Peninsula (CleanPeninsulaCoverData.csv,
doi:10.5281/zenodo.14198989), by their moments. Shares of the growth forms are their own
(`GrowthForm.stand_share`), of the same plots."""
_ELSEWHERE = 0.2
"""Share of stands whose covers are as good as any, for burnt, cleared and closed ground."""
_STANDING = (2.0, 2.0)
"""Beta distribution of the share of dead cover that stands: the rest is litter."""
_MOST_CROWNS = 3.0
"""Crowns over ground, at most [-]: crowns at random then leave a twentieth free."""
_LEAF_MASS_SD, _WATER_SD = (0.15, 0.27), (0.12, 0.25)
"""Standard deviations of the logarithm of leaf mass per area, and of the logit of water over fresh
mass, about those of the growth form: between stands and between forms of a stand. Together those
of the same species within their forms, 0.31 and 0.27."""
_PIGMENT_SD = (0.2, 0.2)
"""Standard deviations of the logarithm of chlorophyll between stands and forms: an assumption."""
_MOST_WATER = 0.05
"""[cm] What PROSPECT was made with (LOPEX, Jacquemoud et al. 1996)."""
_SIZE_SD = 0.3
"""Standard deviation of the logarithm of crown diameters and of heights: an assumption."""
_TALLEST = 2.0
"""Heights above are cut [m], lest the grid be mostly air."""
_PACKING = 0.75
"""Planted with this overlap, so that covers of a form stay below 1; no more than a way to state
them (equation 8)."""
_CELL = 0.1
"""Side of the cells in which the cover of crowns is counted [m]."""
_EDGE = 1e-9
"""Least share, and what the largest lacks of 1."""
_GEOMETRY = ("leaf_area_index", "shoot_clumping")
"""What the stand is planted with, so that all its sets of leaves share it."""


@dataclass(frozen=True)
class StandSettings:
    """How stands are simulated."""

    sun_zenith: tuple[float, float] = (30.0, 30.0)
    """Least and greatest zenith angle of the sun; drawn evenly between [degrees]."""
    size_m: float = 3.0
    """Side of a stand [m]; it repeats itself without end."""
    voxel_m: float = 0.25
    """Edge of a voxel [m]."""
    structure_m: float = 0.125
    """Edge of the voxels on which sun and sight follow the plants [m]: within 1 % of the spectra
    of voxels of 10 cm, in which the shipped prior was learned; without it, 7 % darker in red."""
    together: int = 12
    """Sets of leaves, dead tissue and soil of each planted stand."""
    solves: int = 25
    """Bands, of all sets together, that the diffuse light is solved in."""


@dataclass(frozen=True)
class Stands:
    """Stands and their spectra."""

    quantities: Float[np.ndarray, "stand quantity"]
    """`STAND_QUANTITIES`."""
    reflectance: Float[np.ndarray, "stand band"]
    """Mean reflectance factor from straight above [-]."""
    residual: float
    """Largest share of the source of diffuse light that the reduced solution leaves over in the
    first set of a stand [-]."""


@double_precision
def simulate_stands(
    numbers: tuple[int, ...],
    bands: BandSet,
    prior: LearnedPrior,
    settings: StandSettings,
    seed: int,
) -> Stands:
    """Simulate stands by their numbers. The same number and seed give the same stands, whatever
    other numbers are asked for.

    **Arguments:**

    - `numbers`: of the planted stands; each gives `settings.together` rows.
    - `bands`: of the spectra.
    - `prior`: growth forms, leaves, dead tissue and soil.
    - `settings`: see `StandSettings`.
    - `seed`: of everything random.

    **Returns:** `Stands`, row after row in the order of `numbers`.
    """
    common, own = stand_numbers(prior)
    made = []
    for number in numbers:
        rng = generator(seed, number)
        # A generator for each stand: it is the same whichever others are asked for.
        of_stand, of_sets = rng.normal(size=common), rng.normal(size=(settings.together, own))
        planting = int(rng.integers(2**31))
        made.append(make_stand(of_stand, of_sets, planting, bands, prior, settings))
    return Stands(
        np.concatenate([one.quantities for one in made]),
        np.concatenate([one.reflectance for one in made]),
        max(one.residual for one in made),
    )


@drawn_in_double
def make_stand(
    common: Float[np.ndarray, " common"],
    own: Float[np.ndarray, "set own"],
    planting: int,
    bands: BandSet,
    prior: LearnedPrior,
    settings: StandSettings,
) -> Stands:
    """A planted stand of unit normal numbers, and its spectra: of draws of these, a draw of the
    prior.

    **Arguments:**

    - `common`, `own`: numbers of the stand, and of each of its sets of leaves and ground; so many
      as `stand_numbers` has it.
    - `planting`: its number: where the plants stand.
    - `bands`, `prior`, `settings`: as for `simulate_stands`.

    **Returns:** `Stands`, a row a set.
    """
    scene, planted, imager = _planted(stand_forms(prior), bands, settings)
    drawn = _draw(prior, settings, common, own)
    parameters = replace(planted, species=drawn.species, light=drawn.light)
    stand = scene.reordered(planting, np.asarray(scene.counts(parameters), float))
    spectra, left = _spectra(imager, stand, parameters, drawn.optics)
    quantities = _quantities(stand, parameters, drawn)
    return Stands(quantities, np.asarray(spectra, float), float(left))


@lru_cache(maxsize=2)
def _planted(
    names: tuple[str, ...], bands: BandSet, settings: StandSettings
) -> tuple[Scene, PlotParameters, AimedSensor]:
    """The scene that all stands are realisations of: sites for as many plants as any may have."""
    forms = [FORMS[name] for name in names]
    diameter = np.array([form.diameter for form in forms])
    species = SpeciesParameters(
        # As many and as small plants as any stand has, so that all find their sites.
        cover=jnp.full(len(forms), _MOST_CROWNS * (1.0 - _PACKING)),
        diameter=diameter * np.exp(-_SIZE_SD),
        height=jnp.full(len(forms), _TALLEST),
        packing=jnp.full(len(forms), _PACKING),
        fill=jnp.ones(len(forms)),
        **{
            name: jnp.asarray([getattr(form, name) for form in forms])
            for name in ("wood_area_index", *BY_FORM)
        },
    )
    leaf = leaf_parameters([[USUAL_LEAF]] * len(forms))
    parameters = PlotParameters(species, leaf, GroundParameters(), LightParameters())
    scene = build_scene(
        [Species(name, name) for name in names],
        parameters,
        extent=(settings.size_m, settings.size_m),
        voxel=settings.voxel_m,
        seed=0,
        rules=PlantingRules(
            structure=settings.structure_m, room=1.0, softness=0.0, softness_plants=0.0
        ),
    )
    accuracy = Accuracy(
        lattice=1, sublayers=1, coarsening=(2, 2), levels=2, refine=False, solves=settings.solves
    )
    return scene, parameters, nadir_imager(bands, scene, parameters, accuracy)


class _Optics(eqx.Module):
    """What the sets of a stand differ by: a first axis of sets everywhere."""

    leaf: LeafParameters
    dead_fraction: Float[Array, "set form"]
    ground: GroundParameters


@dataclass(frozen=True)
class _Drawn:
    species: Any
    light: LightParameters
    optics: _Optics
    leaf_mass: Float[np.ndarray, "set form"]
    """Leaf mass per area, as crews measure it [g m-2]."""
    water: Float[np.ndarray, "set form"]
    """Share of water in the fresh mass of leaves [-]."""


class _Numbers:
    """Unit normal numbers, taken one after the other."""

    def __init__(self, values: Float[np.ndarray, "*set number"]) -> None:
        self._values, self._next = values, 0

    def take(self, count: int) -> Float[np.ndarray, "*set count"]:
        """The next `count` of them."""
        self._next += count
        return self._values[..., self._next - count : self._next]


def _uniform(normal: Any) -> Any:
    """Numbers of even density between 0 and 1, short of both."""
    return np.clip(scipy.special.ndtr(normal), _EDGE, 1.0 - _EDGE)


def _beta(normal: Any, a: Any, b: Any) -> Any:
    return np.clip(scipy.special.betaincinv(a, b, _uniform(normal)), _EDGE, 1.0 - _EDGE)


def stand_forms(prior: LearnedPrior) -> tuple[str, ...]:
    """Growth forms of stands, a species each: those that the prior was learned with, and deadwood.

    **Arguments:** `prior`, which the stands are drawn from.
    """
    return (*(form for form in prior.forms if FORMS[form].stand_share > 0.0), "deadwood")


def stand_numbers(prior: LearnedPrior) -> tuple[int, int]:
    """How many unit normal numbers make a stand, and each set of its leaves and ground.

    **Arguments:** `prior`, which the stand is drawn from.
    """
    common, own = prior.numbers(_GEOMETRY)
    forms = len(stand_forms(prior))
    return common + 6 + 2 * forms, own + 5 + 3 * forms


def _draw(
    prior: LearnedPrior,
    settings: StandSettings,
    common: Float[np.ndarray, " common"],
    own: Float[np.ndarray, "set own"],
) -> _Drawn:
    """A stand of unit normal numbers, those that all its sets have in common and those of each."""
    names, count = stand_forms(prior), len(own)
    records = [FORMS[name] for name in names]
    forms = len(names)
    first, each = prior.numbers(_GEOMETRY)
    at = prior.drawn(common[:first], own[:, :each], _GEOMETRY)
    stand, of_set = _Numbers(common[first:]), _Numbers(own[:, each:])

    def by_form(kind: str) -> Float[np.ndarray, "set form"]:
        values = [at[f"{kind}.{form}"] for form in names[:-1]]
        return np.stack([*values, np.zeros(count)], axis=1)

    crowns, dead, standing = _draw_crowns(records, stand)
    diameter, height = np.array([(form.diameter, form.height) for form in records]).T
    # Not below the size for which sites are held ready: smaller crowns would need more.
    diameter = diameter * np.exp(np.clip(_SIZE_SD * stand.take(forms), -_SIZE_SD, None))
    height = height * np.exp(_SIZE_SD * stand.take(1))
    species = SpeciesParameters(
        cover=jnp.asarray(crowns * (1.0 - _PACKING)),
        diameter=diameter,
        height=np.clip(height, 0.1, _TALLEST),
        packing=jnp.full(forms, _PACKING),
        fill=jnp.ones(forms),
        wood_area_index=jnp.asarray([form.wood_area_index for form in records]),
        **{kind: by_form(kind)[0] for kind in BY_FORM},
    )
    low, high = settings.sun_zenith
    light = LightParameters(
        sun_zenith=jnp.asarray(low + (high - low) * _uniform(stand.take(1)[0])),
        sun_azimuth=jnp.asarray(360.0 * _uniform(stand.take(1)[0])),
    )
    leaves, leaf_mass, water = _draw_leaves(prior, records, leaf_factors(at), of_set)
    # Of the ground that standing dead plants leave free.
    litter = (dead - standing) / (1.0 - standing)
    ground = GroundParameters(
        brightness=jnp.asarray(at["soil_brightness"]),
        moisture=jnp.asarray(_beta(of_set.take(1)[:, 0], 1.0, 3.0)),
        litter_fraction=jnp.asarray(
            _beta(of_set.take(1)[:, 0], 2.0 * litter + 0.05, 2.05 - 2.0 * litter)
        ),
        char_fraction=jnp.zeros(count),
        rock_fraction=jnp.zeros(count),
        wood_brightness=jnp.asarray(at["wood_brightness"]),
    )
    optics = _Optics(leaves, jnp.asarray(by_form("dead_fraction")), ground)
    return _Drawn(species, light, optics, leaf_mass, water)


def _draw_crowns(
    records: Sequence[GrowthForm], stand: _Numbers
) -> tuple[Float[np.ndarray, " form"], float, float]:
    """Area of the crowns of each form over that of the stand, the last form standing dead plants;
    and the shares of the stand under dead plants, lying or standing, and standing ones [-]."""
    usual = bool(_uniform(stand.take(1)[0]) >= _ELSEWHERE)
    live, dead = (
        float(_beta(stand.take(1)[0], *(of if usual else (1.0, 1.0)))) for of in (_COVERED, _DEAD)
    )
    standing = dead * float(_beta(stand.take(1)[0], *_STANDING))
    # A Dirichlet distribution is that of the shares of gamma variates.
    parts = scipy.special.gammaincinv(
        [form.stand_share for form in records[:-1]], _uniform(stand.take(len(records) - 1))
    )
    shares = np.append(parts / parts.sum(), 1.0)
    # Crowns that lie at random, one on another, cover 1 - exp(-area).
    covered = np.append(live * np.ones(len(parts)), standing)
    return np.minimum(-np.log1p(-covered), _MOST_CROWNS) * shares, dead, standing


def _draw_leaves(
    prior: LearnedPrior,
    records: Sequence[GrowthForm],
    factors: Mapping[str, Float[np.ndarray, " set"]],
    of_set: _Numbers,
) -> tuple[LeafParameters, Float[np.ndarray, "set form"], Float[np.ndarray, "set form"]]:
    """Leaves of each set and form, by `factors` more than the usual of each content; their mass per
    area [g m-2], and the share of water in their fresh mass [-]."""

    def around(
        median: float | Float[np.ndarray, " form"], sds: tuple[float, float]
    ) -> Float[np.ndarray, "set form"]:
        return median * np.exp(sds[0] * of_set.take(1) + sds[1] * of_set.take(len(records)))

    mass, water = np.array([(f.leaf_mass_per_area, f.water_content) for f in records]).T
    leaf_mass = around(mass, _LEAF_MASS_SD)
    # Water over dry mass, whose logarithm is the logit of water over fresh mass.
    odds = around(water / (1.0 - water), _WATER_SD)
    # Crews measure per area that is seen, PROSPECT counts per half of the surface.
    ratio = np.array([ROUND if form.round_leaves else FLAT for form in records])
    dry = np.minimum(leaf_mass / ratio / 1e4, PARAMETERS["dry_matter"].upper)
    pigment = around(1.0, _PIGMENT_SD)
    average = prior.values()["chlorophyll"]  # which the usual leaf is already times
    usual = USUAL_LEAF.model_dump()
    leaf: dict[str, Any] = {
        "structure": np.asarray(structure_from_dry_matter(dry)),
        **{name: usual[name] / average * pigment for name in ("chlorophyll", "carotenoids")},
        **{name: np.full_like(dry, usual[name]) for name in ("anthocyanins", "brown_pigments")},
        "water": np.minimum(dry * odds, _MOST_WATER),
        "dry_matter": dry,
    }
    for name, factor in factors.items():
        record = PARAMETERS[name]
        leaf[name] = np.clip(leaf[name] * factor[:, None], record.lower, record.upper)
    leaves = LeafParameters.many(**{name: value.ravel() for name, value in leaf.items()})
    return jax.tree.map(lambda a: a.reshape(dry.shape), leaves), leaf_mass, odds / (1.0 + odds)


@eqx.filter_jit
def _spectra(
    imager: AimedSensor, scene: Scene, parameters: PlotParameters, optics: _Optics
) -> tuple[Float[Array, "set band"], Float[Array, ""]]:
    """Spectra of all sets, as bands of one scene."""
    bands = imager.sensor.bands

    def of(one: _Optics) -> Any:
        species = replace(parameters.species, dead_fraction=one.dead_fraction)
        return scene.voxels(
            replace(parameters, leaf=one.leaf, species=species, ground=one.ground), bands
        )

    varying = lambda v: (  # noqa: E731
        v.classes.reflectance,
        v.classes.transmittance,
        v.ground,
        v.illumination.sun,
        v.illumination.sky,
    )
    # Area is common to all sets: only what has bands gets an axis of sets.
    rho, tau, *rest = jax.vmap(lambda one: varying(of(one)))(optics)
    sets = rho.shape[0]
    # Class first, then the bands of all sets one after the other.
    joined = [jnp.moveaxis(a, 0, 1).reshape(a.shape[1], -1) for a in (rho, tau)]
    joined += [a.reshape(-1) for a in rest]
    voxels = eqx.tree_at(varying, of(jax.tree.map(lambda a: a[0], optics)), tuple(joined))
    light = solve_light(voxels, imager.accuracy)
    image = render(light, imager.rays, chunk=len(bands))
    # Radiance of the plot over that of a white ground: a reflectance factor.
    mean = jnp.pi * image.total.mean(axis=(1, 2)) / voxels.illumination.incident
    return mean.reshape(sets, -1), jnp.max(light.diffuse.bands(0, len(bands)).residual)


def _quantities(
    scene: Scene, parameters: PlotParameters, drawn: _Drawn
) -> Float[np.ndarray, "set quantity"]:
    """`STAND_QUANTITIES` of each set of a planted stand."""
    species, planting, forms = parameters.species, scene.planting, drawn.leaf_mass.shape[1]
    area = np.asarray(scene.crown_areas(parameters), float)
    owner = np.asarray(planting.species)
    size = np.asarray(species.diameter)[owner] * np.asarray(planting.size)
    # Plants that do not stand have crowns of zero area.
    stands = area > 1e-3 * size**2
    weight = area[stands] / (0.25 * np.pi * size[stands] ** 2)
    side = scene.grid.extent[0]
    middle = (np.arange(round(side / _CELL)) + 0.5) * _CELL
    away = np.abs(np.asarray(planting.foot)[stands][:, None, :] - middle[None, :, None])
    # The nearest copy of the plant, as the stand repeats itself.
    squared = np.minimum(away, side - away) ** 2
    under = squared[:, :, None, 0] + squared[:, None, :, 1] <= 0.25 * size[stands, None, None] ** 2
    # Share of a cell that each crown leaves free; areas are rounded.
    free = np.maximum(1.0 - weight[:, None, None] * under, 0.0)
    is_live = owner[stands] < forms - 1
    not_live = np.prod(free[is_live], axis=0)
    open_ground = float((not_live * np.prod(free[~is_live], axis=0)).mean())
    live = 1.0 - float(not_live.mean())
    litter = np.asarray(drawn.optics.ground.litter_fraction, float)
    shown = np.asarray(scene.crown_share(parameters), float)
    crowns = np.bincount(owner, area, forms)[:-1] / side**2 * float(shown)
    shoots = crowns * np.asarray(species.leaf_area_index, float)[:-1]
    dead = np.asarray(drawn.optics.dead_fraction, float)[:, :-1]
    bare = np.full(forms - 1, 1.0 / (forms - 1))  # where nothing stands, forms count alike
    share = crowns / max(crowns.sum(), 1e-12) if crowns.sum() > 0 else bare
    # Dead tissue is a share of shoots, other traits means over crowns.
    leafy = shoots / shoots.sum() if shoots.sum() > 0 else share
    chlorophyll = np.asarray(drawn.optics.leaf.chlorophyll, float)
    count = len(litter)
    return np.stack(
        [
            np.full(count, live),
            1.0 - live - (1.0 - litter) * open_ground,
            (1.0 - litter) * open_ground,
            dead @ leafy,
            (1.0 - dead) @ shoots,
            drawn.leaf_mass[:, :-1] @ share,
            100.0 * drawn.water[:, :-1] @ share,
            chlorophyll[:, :-1] @ share,
        ],
        axis=1,
    )

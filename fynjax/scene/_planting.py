"""Where plants may stand, how they are turned and how large each is: drawn once, or known.

Turn and lean of a plant are fixed, so each of its area elements lies at site + diameter a +
height b with fixed vectors a and b: all plants of all species are placed in one expression.
Each plant has one of a few shapes of its species. Only which part of it an element is gets stored;
the vectors are computed where they are used, so that a plot of a million plants fits in memory. Of
a larger plot the elements are listed window by window.
"""

import dataclasses
import math
from collections.abc import Callable, Sequence
from typing import Any, Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, Real
from scipy.special import ndtr, ndtri

from fynjax._core.checkpoint import ByContent
from fynjax._core.errors import InputError
from fynjax._core.memory import total_memory
from fynjax._core.seeds import generator
from fynjax.canopy import (
    FORMS,
    SITES,
    Organ,
    PlantModel,
    assign_sites,
    plant_model,
    poisson_disk,
    random_orientation,
    rounded_count,
    thin_plant,
    unit_shapes,
)
from fynjax.scene._species import CoverDefinition, Material, Species

INDIVIDUALS = 8
"""Shapes of a growth form among the plants of a species: their outlines, lobes and shoots differ,
and each plant is turned besides. Few, because memory holds them all."""
SHORTEST = 0.6
"""Height of the lowest plants of a species over that of its highest [-]; heights lie evenly
between. An assumption."""
HEIGHT_WITH_WIDTH = 0.6
"""Correlation of the heights of a species' plants with the diameters of their crowns [-], of normal
numbers (Gaussian copula). That of log height and log diameter within 15 populations of Protea of
the Cape, 109 plants: 0.60, standard error 0.07 (from measurements of Mitchell et al. 2015, American
Naturalist 185:525)."""
MOST_LISTED = 2**26
"""Area elements that are listed for a whole plot, at most."""


class Planting(eqx.Module):
    """All plants that may stand on a plot and their area elements."""

    species: Int[Array | np.ndarray, " plant"]
    """Species of each plant."""
    place: Float[Array | np.ndarray, " plant"]
    """Place of each plant in the order in which its species fills the sites, from 0."""
    lot: Int[Array | np.ndarray, " plant"]
    """Lot of sites that each plant's is of: 0 those of the whole plants, spare ones after them; -1
    for plants that stand where they are known to be."""
    foot: Float[Array | np.ndarray, "plant 2"]
    """x and y of the foot of each plant [m]."""
    azimuth: Float[Array | np.ndarray, " plant"]
    """Turn about the vertical, clockwise from above [degrees]."""
    tilt: Float[Array | np.ndarray, " plant"]
    """Lean of its axis from the vertical towards its azimuth [degrees]."""
    size: Float[Array | np.ndarray, " plant"]
    """Crown diameter relative to the species' mean; the mean of its square is 1 [-]."""
    stature: Float[Array | np.ndarray, " plant"]
    """Height relative to the species' greatest [-]."""
    leaf: Int[Array | np.ndarray, " plant"] | None
    """Place of each plant's leaf among the leaves of its species, from 0; None: every species has
    one leaf."""
    first: Int[Array | np.ndarray, " plant"]
    """First element of the shape of each plant in `shapes`."""
    count: Int[Array | np.ndarray, " plant"]
    """Elements of the shape of each plant."""
    plant: Int[Array | np.ndarray, " element"]
    """Plant of each element; empty where there are too many to be listed."""
    part: Int[Array | np.ndarray, " element"]
    """Place of each element in `shapes`."""
    shapes: PlantModel
    """The elements of the individuals of each species that has plants, one after the other."""
    shape_class: Int[Array | np.ndarray, " part"]
    """Optical class of the elements of `shapes`, on a plant with the first leaf of its species."""
    materials_from: int | None = eqx.field(static=True, default=None)
    """First optical class of the materials of species, which all plants have alike; None: there are
    none."""

    @property
    def fraction(self) -> Float[Array, " element"]:
        """Share of its organ's area on the plant [-]."""
        return self.shapes.area_fraction[self.part]

    @property
    def organ(self) -> Int[Array, " element"]:
        """`Organ` of each element."""
        return self.shapes.organ[self.part]

    @property
    def optical_class(self) -> Int[Array, " element"]:
        """Optical class of each element."""
        kind = self.shape_class[self.part]  # with the first leaf of its species
        if self.leaf is None:
            return kind
        varies = self.organ == Organ.LEAF
        if self.materials_from is not None:
            varies &= kind < self.materials_from
        return kind + jnp.where(varies, self.leaf[self.plant], 0)

    def unit_shapes(self) -> tuple[Float[Array, "element 3"], Float[Array, "element 3"]]:
        """Shifts of the elements from their plants' feet, per crown diameter and per height [-]."""
        # A plant here is one element: it has the turn and lean of the plant it belongs to.
        position = self.shapes.position[self.part][:, None]
        azimuth, tilt = self.azimuth[self.plant], self.tilt[self.plant]
        per_diameter, per_height = unit_shapes(position, azimuth, tilt, jnp)
        return per_diameter[:, 0], per_height[:, 0]

    @property
    def listed(self) -> bool:
        """Whether the elements are listed, not only the plants."""
        return len(self.plant) > 0 or len(self.first) == 0

    def only(self, standing: np.ndarray) -> "Planting":
        """The same with the plants of the mask `standing` alone, whatever their number is.

        They get the place 0, so that each stands as long as its species has any plant.
        """
        plants = self.plants(np.flatnonzero(standing))
        place, lot = jnp.zeros_like(plants.place), jnp.full_like(plants.lot, -1)
        return dataclasses.replace(plants, place=place, lot=lot).with_elements()

    def plants(self, index: Int[np.ndarray, " plant"]) -> "Planting":
        """The plants of an index, without their elements."""
        none = jnp.zeros(0, jnp.int32)
        return dataclasses.replace(self.of_plants(lambda v: v[index]), plant=none, part=none)

    def of_plants(self, change: Callable[[Any], Any]) -> "Planting":
        """The same with what it has of each plant changed, each array by itself."""
        plants = {name: getattr(self, name) for name in OF_PLANTS}
        return dataclasses.replace(self, **jax.tree.map(change, plants))

    def with_elements(self) -> "Planting":
        """The same with the elements of all plants listed."""
        first, count = np.asarray(self.first), np.asarray(self.count)
        plant = np.repeat(np.arange(len(count), dtype=np.int32), count)
        before = np.cumsum(count, dtype=np.int32) - count
        # Running number within the plant, from where its shape begins.
        part = np.arange(len(plant), dtype=np.int32) + (first - before)[plant]
        return dataclasses.replace(self, plant=jnp.asarray(plant), part=jnp.asarray(part))

    @property
    def sizes(self) -> tuple[int, int, int]:
        """Numbers of plants, of their elements and of the elements of shapes."""
        return len(self.species), len(self.plant), len(self.shape_class)

    def room(self, steps: Literal[2, 4] = 4) -> tuple[int, int, int]:
        """Numbers as of `sizes` that hold these plants and one more, the next of few: there are
        `steps` of them from a power of two to the next."""
        most = max(*self.sizes[1:], 32 * (self.sizes[0] + 1))
        step = 1 << max(most.bit_length() - 1 - steps // 2, 0)
        size = -(-most // step) * step
        return size // 32, size, size

    def padded(self, sizes: tuple[int, int, int] | None = None) -> "Planting":
        """These plants, and others that never stand, with area elements that count nothing: plots
        of about as many plants then have arrays of one shape and share compiled programs.

        **Arguments:** `sizes`, as the property, of the arrays that are made, with a plant more than
        there are at least; left out, those of `room`. Raises `InputError` for smaller ones. Plants
        whose elements are too many to be listed stay as they are.
        """
        if not self.listed:
            return self
        sizes = plants, elements, parts = self.room() if sizes is None else sizes
        least = self.sizes[0] + 1, *self.sizes[1:]
        if any(size < own for size, own in zip(sizes, least, strict=True)):
            raise InputError(
                f"expected room for at least {least[0]} plants, {least[1]} elements and "
                f"{least[2]} of shapes, but got {sizes}"
            )

        def more(values: Array | np.ndarray, count: int, fill: float) -> Array:
            missing = jnp.full((count - len(values), *values.shape[1:]), fill, values.dtype)
            return jnp.concatenate([values, missing])

        # A place beyond every number of plants; sizes of one, lest a zero divide.
        never = {"place": 1e9, "lot": -1, "size": 1.0, "stature": 1.0}
        return dataclasses.replace(
            self.of_plants(lambda values: more(values, plants, 0.0)),
            **{n: more(getattr(self, n), plants, fill) for n, fill in never.items()},  # type: ignore[arg-type]
            plant=more(self.plant, elements, plants - 1),
            part=more(self.part, elements, 0),
            shapes=jax.tree.map(lambda values: more(values, parts, 0), self.shapes),
            shape_class=more(self.shape_class, parts, 0),
        )

    def thinned(self, most: Sequence[int]) -> "Planting":
        """The same plants with fewer area elements, which carry the same area.

        **Arguments:**

        - `most`: elements of a plant of each species, at most.

        Not differentiable.
        """
        if not len(self.species):
            return self
        count, begin = np.asarray(self.count), np.asarray(self.first)
        owner, classes = np.asarray(self.species), np.asarray(self.shape_class)
        whole = jax.tree.map(np.asarray, self.shapes)
        # Plants that begin at the same element have one shape, which is thinned once.
        starts, one, which = np.unique(begin, return_index=True, return_inverse=True)
        shapes: list[PlantModel] = []
        of_class: list[np.ndarray] = []
        for start, example in zip(starts, one, strict=True):
            old = slice(start, start + count[example])
            shape = jax.tree.map(lambda values, old=old: values[old], whole)
            # Thinning keeps materials apart, and so classes.
            none = lambda x: x is None  # noqa: E731
            shape = eqx.tree_at(lambda s: s.material, shape, classes[old], is_leaf=none)
            thin = thin_plant(shape, most[owner[example]], seed=int(start))
            shapes.append(eqx.tree_at(lambda s: s.material, thin, None))
            of_class.append(np.asarray(thin.material))
        size = np.array([len(c) for c in of_class], np.int32)
        few = dataclasses.replace(
            self,
            first=jnp.asarray((np.cumsum(size, dtype=np.int32) - size)[which]),
            count=jnp.asarray(size[which]),
            shapes=jax.tree.map(lambda *parts: jnp.concatenate(parts), *shapes),
            shape_class=jnp.asarray(np.concatenate(of_class)),
        )
        return few.with_elements()


OF_PLANTS = (
    "species", "place", "lot", "foot", "azimuth", "tilt", "size", "stature", "leaf", "first",
    "count",
)  # fmt: skip
"""What a `Planting` has of each plant."""


@dataclasses.dataclass(frozen=True)
class Crowns:
    """Plants that are known, such as those of a crown map."""

    species: Int[np.ndarray, " plant"]
    """Species of each crown."""
    foot: Float[np.ndarray, "plant 2"]
    """East and north of the plot's south-west corner [m]."""
    diameter: Float[np.ndarray, " plant"]
    """Diameter of each crown [m]."""
    height: Float[np.ndarray, " plant"]
    """Height of each plant [m]."""

    def sizes(self, species: int) -> tuple[float, float]:
        """Diameter [m] whose square is the mean of the squares of a species' crowns, and the height
        of its highest plant [m]. Not of a species without crowns."""
        mine = self.species == species
        mean = np.sqrt(np.mean(self.diameter[mine] ** 2))
        return float(mean), float(self.height[mine].max())

    def counts(self, branches: Sequence[float]) -> Int[np.ndarray, " species"]:
        """Plants of each species, of which so many make one crown."""
        return np.bincount(self.species, minlength=len(branches)) * np.round(branches).astype(int)


@dataclasses.dataclass(frozen=True)
class Stand:
    """What the plants of a scene are, wherever they stand."""

    species: Sequence[Species]
    """Fixed properties of each species."""
    diameter: Float[np.ndarray, " species"]
    """Mean crown diameter of each [m]."""
    height: Float[np.ndarray, " species"]
    """Greatest height of each [m]."""
    models: Sequence[PlantModel | None]
    """Shape of the plants of each; None is up to `INDIVIDUALS` of the growth form."""
    resolved: float
    """Edge of the boxes in which leaf area is resolved [m], as `element_count` has it."""
    structured: bool
    """Whether sun and sight follow the plants on voxels finer than the plot's."""
    seed: int
    """Seed of everything random."""
    dtype: str
    """Floating type of the planting."""


def known_planting(stand: Stand, crowns: Crowns) -> Planting:
    """The planting of known plants, all of which stand.

    Sizes are relative to `Crowns.sizes`: parameters of these diameters and heights give the crowns
    as they are, and others scale them. How plants are turned and lean and which individuals they
    are follows from the seed of `stand`.
    """
    individuals: list[dict[str, np.ndarray]] = []
    for i, one in enumerate(stand.species):
        mine = np.repeat(np.flatnonzero(crowns.species == i), round(one.branches))
        drawn = _individuals(crowns.foot[mine], i, one.rotation_spread, 0.0, stand.seed)
        # Branches of a plant have the same leaf.
        plants, branch = np.unique(mine, return_inverse=True)
        drawn["leaf"] = _drawn_leaves(len(plants), i, one.leaves, stand.seed)[branch]
        drawn["lot"] = np.full(len(mine), -1, np.int32)
        if len(mine):
            mean, greatest = crowns.sizes(i)
            # Relative to the species, so that its diameter and height scale known plants too.
            drawn["size"] = crowns.diameter[mine] / mean
            drawn["stature"] = crowns.height[mine] / greatest
        individuals.append(drawn)
    planting = _of_individuals(stand, individuals)
    return dataclasses.replace(planting, place=jnp.zeros_like(planting.place))


SPARE_SITES = 4
"""Sites that a species has beyond those of its plants times the room."""


def sites_ready(
    wanted: Float[np.ndarray, " species"], room: float | Float[np.ndarray, " species"]
) -> Int[np.ndarray, " species"]:
    """Sites held ready for each species: `room` for each of its `wanted` plants, and a few more."""
    return np.ceil(room * wanted).astype(int) + np.where(wanted > 0, SPARE_SITES, 0)


_ELEMENT_BYTES, _PLANT_BYTES = 80, 700
"""Memory that an area element takes while it is listed and placed, and a plant while a plot is
built: measured at 100 m x 100 m."""


def planting_memory(plants: float, listed: float) -> float:
    """Memory that so many `plants` take, of whom so many area elements are `listed` [GiB]."""
    return (_ELEMENT_BYTES * listed + _PLANT_BYTES * plants) / 2**30


def _check_memory(stand: Stand, needed: Int[np.ndarray, " species"]) -> None:
    """Raise `InputError` where so many sites of each species do not fit in memory."""
    of_plant = [
        element_count(*size, stand.resolved, structured=stand.structured)
        for size in zip(stand.diameter, stand.height, strict=True)
    ]
    listed = min(float(needed @ np.array(of_plant)), float(MOST_LISTED))
    asked, there = planting_memory(int(needed.sum()), listed), total_memory() / 2**30
    if asked > there:
        raise InputError(
            f"the sites of {needed.sum()} plants need about {asked:.0f} GiB of memory, but this "
            f"machine has {there:.0f} GiB: take a smaller plot, larger voxels, or less cover"
        )


@dataclasses.dataclass(frozen=True, eq=False)
class PlantingRules(ByContent):
    """How plants are drawn, and how one more of them appears."""

    room: float | Float[np.ndarray, " species"] = 2.5
    """Sites held ready, as a multiple of the plants that the parameters ask for [-], at least; of
    all species or of each: first those of the whole plants, then spare ones between these. A
    parameter that later asks for more gets no more. A scene of more room has the plants of one of
    2.5 where they are, and others besides."""
    size_variation: float = 0.2
    """Coefficient of variation of the crown diameters of a species [-]. An assumption, as it is
    that heights lie evenly between 0.6 and 1 times the greatest; they go with the diameters."""
    spacing: float | None = None
    """Least distance of the plants, r of Bridson [m]. None: the largest with which there are as
    many sites as plants; by a map twice as many as it leaves to choose from. Beyond the number
    that the scene was built for plants stand nearer, between others."""
    attempts: int = 30
    """Candidates in a row that fail before a site has no more neighbours, k of Bridson [-]."""
    probability: Real[np.ndarray, "y x"] | None = None
    """Map of 0-255 over the plot of where plants are likely to stand, row 0 south; None: even."""
    rounding: Literal["random", "up"] = "random"
    """Rule by which a real number of plants becomes a whole one. "random": up or down by a number
    drawn for each species, so that the mean over plantings is the real number. "up": the ceiling of
    eq. (10), which on average adds half a plant to every species."""
    softness: float = 0.1
    """Share of a species' plants over which one more of them is spread where a slope is taken [-];
    see `site_weight`. What is observed has whole plants whatever it is."""
    softness_plants: float = 1.0
    """Plants over which one more is spread besides the share `softness` of them, and one [-], see
    `site_weight`; 0 with `softness` 0: plants whose number has no slope."""
    cover_definition: CoverDefinition = "article"
    """Meaning of a species' cover, by which its plants are counted. "projected": the share of the
    ground below its crowns, overlap among them counted once, as a relevé notes it, see
    `fynjax.canopy.projected_count`. "article": the sum of its crowns' areas over the ground, less
    packing and gaps, eq. (10)."""
    flowering: float = 0.0
    """Share of full bloom [-]."""
    tuft: float = 0.05
    """Edge of the smallest clump of foliage that is resolved [m]: within it leaves lie at random.
    An assumption, about the length of a fynbos shoot's leafy tip."""
    structure: float | Literal["even"] | None = None
    """Edge of the voxels on which sun and sight follow the plants [m], at most. None: a quarter of
    the scene's, but not below 2.5 cm: gaps are then alike in all voxels of up to 10 cm. "even":
    leaves fill the scene's voxels evenly, which hides gaps (of voxels of 10 cm, 3 to 4 %) and takes
    two thirds of the time, and a fifth of the area elements."""

    def finer(self, voxel: float) -> int:
        """Finest voxels along the edge of one of `voxel` [m]; 0 where leaves fill these evenly.
        Raises `InputError` for lengths that are not positive."""
        if self.structure == "even":
            return 0
        structure = max(_FINEST, voxel / 4.0) if self.structure is None else self.structure
        if not (structure > 0 and self.tuft > 0):
            raise InputError(
                f"`structure` and `tuft` must be positive lengths [m], but are {structure} and "
                f"{self.tuft}"
            )
        return max(1, math.ceil(voxel / structure - 1e-6))

    def resolved(self, voxel: float) -> float:
        """Edge of the boxes in which leaves lie at random, in voxels of `voxel` [m]."""
        finer = self.finer(voxel)
        return max(self.tuft, voxel / finer) if finer else voxel


@dataclasses.dataclass(frozen=True)
class SiteRules:
    """How the sites of plants are drawn."""

    extent: tuple[float, float]
    """(east-west, north-south) sides of the plot [m]."""
    periodic: bool
    """Whether the plot repeats itself."""
    rules: PlantingRules
    seed: int
    """Seed of everything random."""

    def assigned(
        self,
        points: Float[np.ndarray, "n 2"],
        needed: Int[np.ndarray, " species"],
        species: Sequence[Species],
        spare: bool,
    ) -> list[Float[np.ndarray, "site 2"]]:
        """Sites of each species among points, as `assign_sites` shares them out."""
        return assign_sites(
            points,
            needed.tolist(),
            probability=self.rules.probability,
            extent=self.extent,
            names=[one.taxon for one in species],
            groups=[one.groups for one in species],
            spare=spare,
            periodic=self.periodic,
            seed=self.seed,
        )

    @property
    def _choice(self) -> float:
        """Sites for each plant: with a map there is room to choose, lest the last species take what
        is left."""
        if self.rules.probability is None:
            return 1.0
        return 2.0 * 255.0 / max(float(np.mean(self.rules.probability)), 1.0)

    def spacing_for(self, plants: float) -> float:
        """Least distance of the sites of so many whole plants [m]: as stated, or about that which
        makes as many sites."""
        if self.rules.spacing is not None:
            return self.rules.spacing
        return self._radius(plants)

    def _radius(self, plants: float) -> float:
        lx, ly = self.extent
        crowd = max(plants, 1.0) * self._choice
        return float(min(np.sqrt(SITES * lx * ly / crowd), 0.5 * min(lx, ly)))

    def whole(self, plants: int) -> tuple[Float[np.ndarray, "n 2"], float]:
        """Sites of so many whole plants, all that Bridson's steps make of one distance, and that:
        the largest with which there are enough, up to two per cent. Raises `InputError` where a
        stated distance leaves too few."""
        if (radius := self.rules.spacing) is not None:
            most = 0.5 * min(self.extent)
            if self.periodic and radius > most:
                raise InputError(
                    f"expected plants at most {most:g} m apart, half of the shorter side of a plot "
                    f"that repeats itself, but got a spacing (`spacing_m`) of {radius:g} m"
                )
            points = self._disk(radius)
            if len(points) < plants:
                raise InputError(
                    f"expected sites for {plants} plants, but at least {radius:g} m apart there "
                    f"are {len(points)}: take a spacing (`spacing_m`) of at most "
                    f"{0.98 * radius * np.sqrt(len(points) / plants):.2g} m, or leave it out, or "
                    "take a lower cover"
                )
            return points, radius
        # A few more than are wanted, lest they be drawn again.
        radius, wanted, widened = self._radius(1.005 * plants), plants * self._choice, False
        while True:
            points = self._disk(radius)
            share = len(points) / wanted
            if share < 1.0:
                radius *= min(np.sqrt(share), 0.995)
            elif share > 1.02 and len(points) > wanted + 2 and not widened:
                radius, widened = min(0.998 * radius * np.sqrt(share), self._radius(1.0)), True
            else:
                return points, radius

    def spare(
        self, feet: Float[np.ndarray, "n 2"], plants: int, radius: float, more: int
    ) -> tuple[Float[np.ndarray, "m 2"], float]:
        """Sites between those at `feet` for so many `plants` in all, `more` of them new, at a
        distance below `radius`; and that distance."""
        radius = min(radius, self._radius(1.05 * plants))
        while True:
            points = self._disk(radius, feet)[len(feet) :]
            if len(points) >= more * self._choice:
                return points, radius
            radius *= 0.95

    def _disk(
        self, radius: float, start: Float[np.ndarray, "given 2"] | None = None
    ) -> Float[np.ndarray, "n 2"]:
        return poisson_disk(
            self.extent,
            radius,
            attempts=self.rules.attempts,
            seed=self.seed,
            periodic=self.periodic,
            start=start,
        )


def draw_planting(
    stand: Stand, wanted: Float[np.ndarray, " species"], rules: SiteRules
) -> Planting:
    """Draw sites, orientations and sizes of the plants of a scene.

    The sites of the whole plants come first; spare ones are drawn between them, less and less far
    from others.

    **Arguments:**

    - `stand`: what they are.
    - `wanted`: real number of plants of each species [-], 0 or more.
    - `rules`: of the sites.

    **Raises:** `InputError` where a species finds no room on the plot, or plants in memory.

    Not differentiable: the scene is, in the parameters.
    """
    species, seed = stand.species, stand.seed
    variation = rules.rules.size_variation
    individuals: list[dict[str, np.ndarray]] = [{} for _ in species]
    lots = _lots(wanted, np.broadcast_to(np.asarray(rules.rules.room, float), len(species)))
    _check_memory(stand, lots[-1])
    radius = np.inf
    feet: list[list[np.ndarray]] = [[] for _ in species]
    # Lot by lot, so that a scene of more room has the plants of one of less where they are.
    for lot, needed in enumerate(lots):
        there = lots[lot - 1] if lot else np.zeros_like(needed)
        more = needed - there
        if not more.any():
            points = np.empty((0, 2))
        elif lot == 0:
            points, radius = rules.whole(int(needed.sum()))
        else:
            old = np.concatenate([places for one in feet for places in one])
            points, radius = rules.spare(old, int(needed.sum()), radius, int(more.sum()))
        for one, places in zip(feet, rules.assigned(points, more, species, lot > 0), strict=True):
            one.append(places)
        if lot < min(_WHOLE_STEPS, len(lots) - 1):
            continue
        for i, of_lots in enumerate(feet):
            before, where = individuals[i], np.concatenate(of_lots)
            drawn = _individuals(where, i, species[i].rotation_spread, variation, seed)
            drawn["leaf"] = _drawn_leaves(len(where), i, species[i].leaves, seed)
            drawn["lot"] = np.repeat(np.arange(lot + 1, dtype=np.int32), [*map(len, of_lots)])
            for name, values in before.items():  # who was there stays
                drawn[name] = np.concatenate([values, drawn[name][len(values) :]])
            individuals[i] = drawn
    return _of_individuals(stand, individuals)


def shared_anew(
    planting: Planting,
    species: Sequence[Species],
    rules: SiteRules,
    counts: Float[np.ndarray, " species"] | None = None,
) -> tuple[Float[np.ndarray, " plant"], Int[np.ndarray, " plant"], Float[np.ndarray, "plant 2"]]:
    """Place, lot and foot of the plants of a planting, whose sites are shared out anew among the
    species, lot by lot, and among the plants of each. Known plants stay. With `counts` the first of
    each species, so many as these, have sites drawn for them alone."""
    owner, lot = np.asarray(planting.species), np.array(planting.lot)
    place, foot = np.array(planting.place), np.array(planting.foot)
    rng = generator(rules.seed, 211)
    members = [np.flatnonzero((owner == i) & (lot >= 0)) for i in range(len(species))]
    members = [one[np.argsort(place[one], kind="stable")] for one in members]
    if counts is None:
        lots = [[one[lot[one] == number] for one in members] for number in np.unique(lot[lot >= 0])]
    else:
        lots = [[one[:n] for one, n in zip(members, whole_plants(counts), strict=True)]]
    # Feet in single precision may have been rounded to the border.
    inside = np.minimum(foot.astype(float), np.nextafter(rules.extent, 0.0))
    for number, mine in enumerate(lots):
        needed = np.array([len(one) for one in mine])
        points = inside[np.concatenate(mine)]
        if counts is not None and needed.any():
            points, _ = rules.whole(int(needed.sum()))
        for one, sites in zip(mine, rules.assigned(points, needed, species, number > 0)):
            foot[one] = sites
    for one in members:
        # Other plants of the species stand: each gets the place of another, and its site.
        order = rng.permutation(len(one))
        place[one], lot[one], foot[one] = place[one][order], lot[one][order], foot[one][order]
    return place, lot, foot


def _of_individuals(stand: Stand, individuals: Sequence[dict[str, np.ndarray]]) -> Planting:
    """The planting of the plants of each species, with the shapes of these."""
    species, seed, dtype = stand.species, stand.seed, stand.dtype
    shapes: list[PlantModel] = []
    plants: list[dict[str, np.ndarray]] = []
    own: list[int] = []
    parts = 0
    for i, (one, these) in enumerate(zip(species, individuals)):
        n = len(these["foot"])
        if n == 0:
            continue
        size = stand.diameter[i], stand.height[i], stand.resolved
        number = element_count(*size, structured=stand.structured)
        # A few individuals of the form, which the plants have in turn; or the one model given.
        if (model := stand.models[i]) is None:
            seeds = individual_seeds(seed, i)[:n]
            several = [
                _with_outer_leaves(plant_model(one.form, number, seed=s), one) for s in seeds
            ]
        else:
            several = [thin_plant(model, number, seed=seed + i)]
        k = len(several[0].organ)
        plants.append(
            {
                "species": np.full(n, i, np.int32),
                "place": np.arange(n, dtype=dtype),
                **{
                    name: values if name in ("leaf", "lot") else values.astype(dtype)
                    for name, values in these.items()
                },
                "first": parts + k * (np.arange(n, dtype=np.int32) % len(several)),
                "count": np.full(n, k, np.int32),
            }
        )
        shapes += several
        own += [i] * len(several)
        parts += k * len(several)
    if not plants:
        return no_plants(dtype)
    # The elements of all shapes in one list, each in the optical class of its species and organ.
    classes = np.concatenate([_classes_of(species, *shape) for shape in zip(own, shapes)])
    shapes = [dataclasses.replace(shape, material=None) for shape in shapes]
    types = {"f": dtype, "i": "int32"}
    whole = jax.tree.map(
        lambda *parts: jnp.asarray(np.concatenate(parts), types[parts[0].dtype.kind]), *shapes
    )
    none = jnp.zeros(0, jnp.int32)
    joined: dict[str, Any] = {
        name: jnp.asarray(np.concatenate([part[name] for part in plants])) for name in plants[0]
    }
    if all(one.leaves == 1 for one in species):
        joined["leaf"] = None
    planting = Planting(
        **joined,
        plant=none,
        part=none,
        shapes=whole,
        shape_class=jnp.asarray(classes, jnp.int32),
        materials_from=_first_material(species) if material_classes(species) else None,
    )
    few = sum(int(part["count"].sum(dtype=np.int64)) for part in plants) <= MOST_LISTED
    return planting.with_elements() if few else planting


_ROOM, _WHOLE_STEPS = 2.5, 4
_FINEST = 0.025
"""Edge of the finest voxels, unless others are asked for [m]."""
_MORE_ROOM = _ROOM ** (1.0 / _WHOLE_STEPS)
"""By what factor sites become more from lot to lot: those that are filled first are about as far
from others as the whole plants are."""


def whole_plants(wanted: Float[np.ndarray, " species"]) -> Int[np.ndarray, " species"]:
    """Plants of each species that may stand whole, of real numbers of them."""
    return np.asarray(rounded_count(np.asarray(wanted, float))).astype(int)


def _lots(
    wanted: Float[np.ndarray, " species"], room: Float[np.ndarray, " species"]
) -> list[Int[np.ndarray, " species"]]:
    """Sites of each species in the first lots: of the whole plants, and then up to at least `room`
    times its plants."""
    steps = np.ceil(np.log(np.maximum(room, 1.0)) / np.log(_MORE_ROOM) - 1e-6)
    most = np.where(room <= _ROOM, room, _MORE_ROOM**steps)
    lots = [whole_plants(wanted)]
    for step in range(1, 1 + max(1, int(steps.max(initial=0.0)))):
        ready = sites_ready(wanted, np.minimum(_MORE_ROOM**step, most))
        lots.append(np.maximum(lots[-1], ready))
    return lots


def _individuals(
    places: Float[np.ndarray, "plant 2"], species: int, spread: float, variation: float, seed: int
) -> dict[str, np.ndarray]:
    """Place, turn and size of the plants of a species."""
    n, rng = len(places), generator(seed, 101, species)
    azimuth, tilt = random_orientation(n, seed=seed + 1000 * (species + 1), rotation_spread=spread)
    width = rng.standard_normal(n)
    size, stature = relative_sizes(width, ndtri(rng.random(n)), variation, np)
    return {
        "foot": places,
        "azimuth": azimuth,
        "tilt": tilt,
        # Mean area of the crowns, not mean diameter, is what covers count plants by.
        "size": size / np.sqrt(np.mean(size**2)) if n else size,
        "stature": stature,
    }


def relative_sizes(width: Any, tall: Any, variation: float, library: Any) -> tuple[Any, Any]:
    """Crown diameter over that of a middling plant, and height over the species' greatest [-].

    **Arguments:** `width`, a normal number of each plant; `tall`, another, of its height beside
    what goes with its diameter; `variation`, coefficient of variation of the diameters [-];
    `library`, `numpy` or `jax.numpy`. Differentiable in `width` and `tall`.
    """
    # Log-normal with this coefficient of variation.
    size = library.exp(np.sqrt(np.log1p(variation**2)) * width)
    # A normal number that goes with that of the crown, as its quantile among heights.
    own = HEIGHT_WITH_WIDTH * width + np.sqrt(1.0 - HEIGHT_WITH_WIDTH**2) * tall
    below = ndtr(own) if library is np else jax.scipy.special.ndtr(own)
    return size, SHORTEST + (1.0 - SHORTEST) * below


def _drawn_leaves(plants: int, species: int, leaves: int, seed: int) -> Int[np.ndarray, " plant"]:
    """Which of so many leaves each plant of a species has: every one is as likely, and a plant
    keeps its own where there are more plants."""
    drawn = generator(seed, 109, species).random(plants)
    return (leaves * drawn).astype(np.int32)


def _with_outer_leaves(plant: PlantModel, species: Species) -> PlantModel:
    """A generated plant whose leaves farthest from its foot, in units of the crown's radius and
    height, are of the leaf materials of its species, from the outermost inwards. Each has at least
    one element, and its share of the area."""
    kinds = [i for i, one in enumerate(species.materials) if one.organ == Organ.LEAF]
    if not kinds:
        return plant
    share = [species.materials[i].share for i in kinds]
    if (left := species.share_without_material(Organ.LEAF)) > 0.0:
        kinds, share = [*kinds, -1], [*share, left]
    organ, area = np.asarray(plant.organ), np.array(plant.area_fraction, float)
    leaves = np.flatnonzero(organ == Organ.LEAF)
    x, y, z = np.asarray(plant.position, float)[leaves].T
    order = leaves[np.argsort(-(4.0 * (x**2 + y**2) + z**2), kind="stable")]
    # Each leaf by where the middle of its area lies in the sum from the outermost inwards.
    middle, number = np.cumsum(area[order]) - 0.5 * area[order], np.arange(len(kinds))
    ends = np.maximum(np.searchsorted(middle, np.cumsum(share)) - number, 1)
    ends = np.minimum(np.maximum.accumulate(ends) + number, len(order) - number[::-1])
    ends[-1] = len(order)
    material = np.full(len(organ), -1, np.int32)
    for kind, part, mine in zip(kinds, share, np.split(order, ends[:-1]), strict=True):
        material[mine] = kind
        area[mine] *= part / area[mine].sum()
    fraction = jnp.asarray(area, plant.area_fraction.dtype)
    return dataclasses.replace(plant, material=material, area_fraction=fraction)


def _classes_of(species: Sequence[Species], i: int, shape: PlantModel) -> np.ndarray:
    """Optical class of each element of the shape of a species' plants."""
    of_organ = np.array(organ_classes(species)[i])[np.asarray(shape.organ)]
    if shape.material is None:
        return of_organ
    every = material_classes(species)
    of_material = np.array([every[_optics_key(i, one)][0] for one in species[i].materials])
    material = np.asarray(shape.material)
    return np.where(material < 0, of_organ, of_material[material])


def seed_of_planting(seed: int, number: int) -> int:
    """Seed of the plants of another planting of a scene.

    **Arguments:** `seed`, of the scene; `number`, of the planting, 0 for the scene's own.
    """
    if number == 0:
        return seed
    return int(np.random.SeedSequence([seed, 83, number]).generate_state(1)[0] >> 1)


def individual_seeds(seed: int, species: int) -> list[int]:
    """Seeds of the shapes that the plants of a species have by turns, as they fill the sites.

    **Arguments:** `seed`, of the scene; `species`, its number among the species.
    """
    return generator(seed, 103, species).integers(2**31, size=INDIVIDUALS).tolist()


def leaf_classes(species: Sequence[Species]) -> dict[int, range]:
    """Optical classes of the leaves of each species that has leaves, by its number among
    `species`: one for each different leaf, none where materials are all of its leaves. Wood and
    flowers have the two classes after them, and `material_classes` are the last."""
    classes, first = {}, 0
    for i, one in enumerate(species):
        if FORMS[one.form].leafy:
            classes[i] = range(first, first := first + one.leaves)
    return classes


def _first_material(species: Sequence[Species]) -> int:
    return sum(map(len, leaf_classes(species).values())) + 2


def _optics_key(i: int, material: Material) -> tuple[int, bool, int]:
    """What tells the optics of a material of species `i` from others: leaves also by the shoots of
    their species."""
    leaf = i if material.organ == Organ.LEAF else -1
    return leaf, material.reflectance is None, material.number


def material_classes(
    species: Sequence[Species],
) -> dict[tuple[int, bool, int], tuple[int, int, Material]]:
    """Optical classes of the materials of `species`, those of equal optics once: by what tells them
    apart the class, the species that has it first and its material."""
    found: dict[tuple[int, bool, int], tuple[int, int, Material]] = {}
    first = _first_material(species)
    for i, one in enumerate(species):
        for material in one.materials:
            found.setdefault(_optics_key(i, material), (first + len(found), i, material))
    return found


def class_count(species: Sequence[Species]) -> int:
    """Number of optical classes of a plot of such `species`."""
    return _first_material(species) + len(material_classes(species))


def organ_classes(species: Sequence[Species]) -> list[list[int]]:
    """Optical class of the first leaf, of wood and flower of each of the `species`: of its elements
    that are of no material, or else of the first material of the organ."""
    leaves, every = leaf_classes(species), material_classes(species)
    wood = _first_material(species) - 2
    classes = []
    for i, one in enumerate(species):
        own = [leaves[i].start if i in leaves else 0, wood, wood + 1]
        for organ in Organ:
            mine = [m for m in one.materials if m.organ == organ]
            named = [m for m in mine if m.name == organ.name.lower()]
            if named or (mine and one.share_without_material(organ) == 0.0):
                own[organ] = every[_optics_key(i, (named or mine)[0])][0]
        classes.append(own)
    return classes


def class_shares(species: Sequence[Species]) -> Float[np.ndarray, "species organ class"]:
    """Part of the area of each organ of each species that is of each optical class, its leaves
    alike [-]. A species without leaves has those of wood in their place."""
    leaves, every = leaf_classes(species), material_classes(species)
    shares = np.zeros((len(species), len(Organ), class_count(species)))
    wood = _first_material(species) - 2
    for i, one in enumerate(species):
        own = [leaves.get(i, [wood]), [wood], [wood + 1]]
        for organ, kinds in zip(Organ, own, strict=True):
            for kind in kinds:
                shares[i, organ, kind] = one.share_without_material(organ) / len(kinds)
        for material in one.materials:
            shares[i, material.organ, every[_optics_key(i, material)][0]] += material.share
    return shares


def no_plants(dtype: str) -> Planting:
    """A planting without plants."""
    none, index = jnp.zeros(0, dtype), jnp.zeros(0, jnp.int32)
    shapes = PlantModel(jnp.zeros((0, 3), dtype), none, jnp.zeros((0, 3), dtype), index)
    return Planting(
        species=index,
        place=none,
        lot=index,
        foot=jnp.zeros((0, 2), dtype),
        azimuth=none,
        tilt=none,
        size=none,
        stature=none,
        leaf=None,
        first=index,
        count=index,
        plant=index,
        part=index,
        shapes=shapes,
        shape_class=index,
    )


def element_count(
    diameter: float,
    height: float,
    resolved: float,
    *,
    layer: float | None = None,
    structured: bool = False,
) -> int:
    """Area elements of a plant.

    **Arguments:**

    - `diameter`, `height`: of its crown [m].
    - `resolved`: edge of the boxes in which its leaf area is resolved [m].
    - `layer`: their height, if they are no cubes [m].
    - `structured`: whether sun and sight follow it on voxels finer than the plot's.

    **Returns:** about one for every two boxes that its crown touches, since thousands of plants
    stand on a plot; 16 to 3000, with a structure to 20 000.
    """
    layer = resolved if layer is None else layer
    # A crown lies anywhere on the boxes, and touches more of them than it fills.
    touched = (diameter / resolved + 0.5) ** 2 * (height / layer + 0.5)
    return int(np.clip(np.ceil(touched / 2), 16, 20_000 if structured else 3000))

"""Plants found in the pixels of an image by gradient: sites with weights.

At each of many sites every species that could stand there has a weight, and so has nothing; the
plant has a place, a diameter and a height of its own. The stand that is rendered has each plant in
part: as large as it would be, but as thin as its weight says. Pixels decide by their slopes.
"""

import dataclasses
from collections.abc import Callable
from functools import cache
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int
from scipy.spatial import cKDTree

from fynjax._core.errors import InputError
from fynjax._core.extras import require
from fynjax._core.seeds import generator
from fynjax.canopy import SITES, poisson_disk
from fynjax.inversion._data import PIXEL_SD
from fynjax.inversion._factors import BandFactors
from fynjax.inversion._shapes import scale_of, shape_error
from fynjax.inversion._space import ParameterSpace
from fynjax.radiation import VoxelScene
from fynjax.scene import (
    AimedSensor,
    Crowns,
    ModelError,
    Scene,
    parameter_kind,
    relative_sizes,
    with_values,
)
from fynjax.sensors import Gains

_WIDER = 1.6
"""Crowns of the species that share sites are at most so many times as wide as the narrowest [-]."""
_CROWD = 3.0
"""Sites for each plant that is expected, at least [-]."""
MOVED = 0.4
"""Standard deviation of a plant's distance from its site, along each axis [distance of sites]."""
_LATE = ("diameter", "height", "leaf_area_index")
"""Parameters that stay as they are while plants stand in part: a plant in part is one of fewer
leaves, so that no image distinguishes its weight from these."""
_TINY = 1e-9


@dataclasses.dataclass(frozen=True)
class PlacesSettings:
    """Settings of a search for plants.

    **Raises:** `InputError` for a value that is not positive.
    """

    steps: int = 100
    """Steps of the search with plants in part."""
    rounds: int = 48
    """Rounds of each chain of whole stands; those after the first half are kept."""
    chains: int = 3
    """Chains of whole stands, each from a search down the slopes of its own."""
    jumps: int = 10
    """Images of each round in which plants come, go, move or become of another species."""
    spacing: float = 0.4
    """Distance of sites over the diameter of the narrowest crowns that may stand there [-]."""
    elements: int = 300
    """Area elements of a plant in the search, at most, or a quarter of its own where that is more.
    Fewer make plants clumpier than they are, and those that are found smaller: of 120 elements by
    7 %, of 300 by 4 %, of all by 3 %. A large crown has twenty times as many."""
    rate: float = 0.2
    """Largest step of a coordinate [prior standard deviations]."""
    pixel_sd: float = PIXEL_SD
    """Error of a pixel beside what plants of the same species differ in shape, as a share of it
    [-]."""
    height_sd: float = 0.05
    """Error of the height of the canopy [m]."""
    cover_sd: float = 0.25
    """Relative standard deviation of the sum of the crowns of a species, as the table has it [-]:
    that of its cover. How many plants make it follows from their diameters."""
    gains: Gains | None = None
    """Errors of the calibration of the bands; None: those of the camera's sensor."""
    seed: int = 0
    """Seed of sites, of the plants' shapes, and of everything drawn."""

    def __post_init__(self) -> None:
        for field in dataclasses.fields(self):
            value = getattr(self, field.name)
            if field.name not in ("seed", "gains") and not value > 0:
                raise InputError(f"`{field.name}` must be positive, but is {value}")


class Candidates(eqx.Module):
    """What may stand where: plants of several species at each of many sites."""

    scene: Scene
    """The plot with every plant that may stand, at its site."""
    owner: Int[Array, " part"]
    """Candidate that each plant of `scene` is, or is a branch of; beyond the last: of none."""
    species: Int[Array, " candidate"]
    """Species of each candidate."""
    site: Int[Array, " candidate"]
    """Site of each candidate."""
    place: Float[Array, "site 2"]
    """Each site [m]."""
    reach: Float[Array, " site"]
    """Distance of the sites of its kind [m]."""
    chance: Float[Array, " candidate"]
    """Share of such sites at which such a plant stands, by the table [-]."""
    occupied: Float[Array, " site"]
    """Share of such sites at which any plant stands, by the table [-]."""
    number: Float[Array, " species"]
    """Plants of each species, by the table [-]."""
    near: Int[Array, "pair 2"]
    """Pairs of sites whose plants may come too near."""
    apart: Float[Array, ""]
    """Distance that plants keep [m]."""

    @property
    def side(self) -> Float[np.ndarray, " 2"]:
        """Sides after which the plot repeats itself; infinite where it does not [m]."""
        extent = np.asarray(self.scene.grid.extent[:2])
        return extent if self.scene.boundary == "periodic" else np.full(2, np.inf)

    def only(self, chosen: Int[np.ndarray, " candidate"]) -> "Candidates":
        """Some of the candidates, at the same sites: a stand of few of many takes a third of the
        time. Arrays of as many are mostly of the same size, so that one compiled program serves."""
        place = np.full(len(self.species), -1)
        place[chosen] = np.arange(len(chosen))
        mine = place[np.asarray(self.owner)]
        index = np.flatnonzero(mine >= 0)
        planting = self.scene.planting.plants(index).with_elements()
        planting = planting.padded(planting.room(2))  # few: each compiles much
        # Plants that fill up the shapes are of no candidate.
        owner = np.full(len(planting.species), len(chosen))
        owner[: len(index)] = mine[index]
        return dataclasses.replace(
            self, scene=dataclasses.replace(self.scene, planting=planting),
            owner=jnp.asarray(owner), species=self.species[chosen], site=self.site[chosen],
            chance=self.chance[chosen],
        )  # fmt: skip


def crowns_of_table(scene: Scene) -> Float[np.ndarray, " species"]:
    """Real number of whole plants of each species by the table, of all their branches [-]."""
    return np.asarray(scene.counts(scene.parameters), float) / np.asarray(scene.branches)


def candidates(scene: Scene, settings: PlacesSettings, chain: int = 0) -> Candidates:
    """Sites over the plot of a scene, and the plants that may stand there.

    Species whose crowns are about as wide share sites, which are the denser the narrower these are.

    **Arguments:** `scene`, as it was built; `settings`; `chain`, each of which has plants of other
    shapes at the same sites.

    **Raises:** `InputError` for a scene without plants, or of other plants than were drawn.
    """
    diameter = np.asarray(scene.parameters.species.diameter, float)
    height = np.asarray(scene.parameters.species.height, float)
    number = crowns_of_table(scene)
    extent, periodic = scene.grid.extent[:2], scene.boundary == "periodic"
    groups: list[list[int]] = []
    for i in np.argsort(diameter, kind="stable"):
        if number[i] <= 0.0:
            continue
        if groups and diameter[i] <= _WIDER * diameter[groups[-1][0]]:
            groups[-1].append(i)
        else:
            groups.append([i])
    if not groups:
        raise InputError("expected a species with a cover above 0: there is no plant to be found")
    places, reach, species, site, chance, sites = [], [], [], [], [], 0
    for g, group in enumerate(groups):
        crowd = np.sqrt(SITES * np.prod(extent) / (_CROWD * number[group].sum()))
        radius = min(settings.spacing * diameter[group[0]], crowd, 0.5 * min(extent))
        points = poisson_disk(extent, radius, seed=settings.seed + g, periodic=periodic)
        for k in group:
            species.append(np.full(len(points), k))
            site.append(sites + np.arange(len(points)))
            chance.append(np.full(len(points), min(number[k] / len(points), 0.9 / len(group))))
        places.append(points)
        reach.append(np.full(len(points), radius))
        sites += len(points)
    order = np.argsort(np.concatenate(species), kind="stable")
    owner, at, likely = (np.concatenate(v)[order] for v in (species, site, chance))
    place, far = np.concatenate(places), np.concatenate(reach)
    crowns = Crowns(owner, place[at], diameter[owner], height[owner])
    many = scene.with_plants(crowns, seed=settings.seed + 1000 * chain)
    own = np.zeros(len(scene.species), int)
    np.maximum.at(own, np.asarray(many.planting.species), np.asarray(many.planting.count))
    thin = many.planting.thinned(np.maximum(settings.elements, own // 4).tolist())
    copies = np.round([scene.branches[i] for i in owner]).astype(int)
    apart = scene.spacing_of(float(number.sum()))
    tree = cKDTree(place, boxsize=extent if periodic else None)
    single = lambda v: jnp.asarray(v, scene.dtype)  # noqa: E731
    return Candidates(
        dataclasses.replace(many, planting=thin),
        jnp.asarray(np.repeat(np.arange(len(copies)), copies)),
        jnp.asarray(owner), jnp.asarray(at), single(place), single(far), single(likely),
        single(np.bincount(at, likely, len(place))), single(number),
        jnp.asarray(tree.query_pairs(apart + far.max(), output_type="ndarray")), single(apart),
    )  # fmt: skip


class Places(eqx.Module):
    """What is unknown of a stand, in coordinates that are about unit normal beforehand."""

    logit: Float[Array, " candidate"]
    """Logarithm of the weight of each candidate over that of nothing at its site."""
    shift: Float[Array, "site 2"]
    """How far the plant is from its site, over `MOVED` times the distance of sites."""
    width: Float[Array, " site"]
    """Crown diameter of the plant, as a normal number."""
    tall: Float[Array, " site"]
    """Height of the plant beside what goes with its diameter, as a normal number."""
    u: Float[Array, " free"]
    """Whitened coordinates of the free parameters."""
    band: Float[Array, " coordinate"]
    """Coordinates of the factors of the bands."""


class PlacesModel(eqx.Module):
    """From what is unknown of a stand to its image, and to how likely that is."""

    candidates: Candidates
    camera: AimedSensor
    """Of the compared blocks of pixels."""
    space: ParameterSpace
    """The free parameters."""
    root: Float[Array, "band coordinate"]
    """`BandFactors.root`."""
    target: Float[Array, "band y x"]
    """Measured reflectance of the blocks [-]; NaN where they are not compared."""
    whiten: Float[Array, "band band"]
    """Makes of relative errors of the bands of a block independent ones of unit variance."""
    together: Float[Array, ""]
    """Values whose errors are as one, because neighbours err alike [-]."""
    height: Float[Array, "y x"] | None
    """Measured height of the canopy in the voxel columns [m]; NaN where it is not known."""
    settings: PlacesSettings = eqx.field(static=True)

    def weights(self, logit: Array) -> tuple[Float[Array, " candidate"], Float[Array, " site"]]:
        """Weight of each candidate, and of nothing at each site; those of a site sum to one."""
        site, count = self.candidates.site, len(self.candidates.place)
        top = jax.lax.stop_gradient(jnp.maximum(jax.ops.segment_max(logit, site, count), 0.0))
        part, none = jnp.exp(logit - top[site]), jnp.exp(-top)
        total = none + jax.ops.segment_sum(part, site, count)
        return part / total[site], none / total

    def foot(self, v: Places) -> Float[Array, "site 2"]:
        """Where each plant stands [m]."""
        return self.candidates.place + MOVED * self.candidates.reach[:, None] * v.shift

    def sizes(self, v: Places) -> tuple[Float[Array, " site"], Float[Array, " site"]]:
        """Crown diameter over the species' mean, and height over its greatest [-]."""
        variation = self.candidates.scene.rules.size_variation
        size, stature = relative_sizes(v.width, v.tall, variation, jnp)
        # The mean of the squares of a species' sizes is one.
        return size / (1.0 + variation**2), stature

    def stand(self, v: Places, weight: Array) -> Scene:
        """The plot with each candidate in part."""
        known = self.candidates
        at = known.site[known.owner]
        size, stature = (one[at] for one in self.sizes(v))
        share = weight.at[known.owner].get(mode="fill", fill_value=0.0)
        return known.scene.standing_in_part(share, self.foot(v)[at], size, stature)

    def image(
        self, v: Places, weight: Float[Array, " candidate"]
    ) -> tuple[Float[Array, "band y x"], Float[Array, "y x"]]:
        """Reflectance of the blocks times the factors of the bands [-], and the height of the
        canopy [m]. Differentiable."""
        scene = self.stand(v, weight)
        named = dict(zip(self.space.names, self.space.physical(v.u), strict=True))
        voxels = scene.voxels(
            with_values(scene.parameters, scene.taxa, named), self.camera.sensor.bands
        )
        factor = jnp.exp(self.root @ v.band)[:, None, None]
        return factor * self.camera.image(voxels)[0], standing_height(voxels)

    def misfits(
        self, image: Float[Array, "band y x"], height: Float[Array, "y x"]
    ) -> tuple[Float[Array, "y x"], Float[Array, "y x"]]:
        """Squared whitened misfit of each block, and of the height of each voxel column [-]."""
        off = (image - self.target) / scale_of(self.target)
        white = jnp.einsum("ab,byx->ayx", self.whiten, jnp.where(jnp.isnan(off), 0.0, off))
        pixels = jnp.sum(white**2, axis=0)
        if self.height is None:
            return pixels, jnp.zeros((1, 1), pixels.dtype)
        rest = (height - self.height) / self.settings.height_sd
        return pixels, jnp.where(jnp.isnan(rest), 0.0, rest) ** 2

    @property
    def values(self) -> Float[Array, ""]:
        """Compared values of the image."""
        return jnp.sum(~jnp.isnan(self.target)).astype(self.target.dtype)

    def excess(self, pixels: Array) -> Float[Array, ""]:
        """How many times as large as stated the variances of all errors are, at least 1 [-]."""
        return jax.lax.stop_gradient(jnp.maximum(jnp.sum(pixels) / self.values, 1.0))

    def _diameters(self, v: Places) -> Float[Array, " species"]:
        """Mean crown diameter of each species over the table's [-]."""
        scene = self.candidates.scene
        named = dict(zip(self.space.names, self.space.physical(v.u), strict=True))
        mine = with_values(scene.parameters, scene.taxa, named).species.diameter
        return mine / jnp.asarray(scene.parameters.species.diameter, mine.dtype)

    def crowding(self, v: Places, full: Float[Array, " site"]) -> Float[Array, ""]:
        """How much plants are nearer to each other than they keep [plants]."""
        (a, b), known = self.candidates.near.T, self.candidates
        feet = self.foot(v)
        gap = _shortest(feet[a] - feet[b], jnp.asarray(known.side, feet.dtype))
        distance = jnp.sqrt(jnp.sum(gap**2, axis=1) + 1e-8)
        return jnp.sum(full[a] * full[b] * jnp.maximum(1.0 - distance / known.apart, 0.0))

    def prior(self, v: Places, weight: Array, none: Array) -> Float[Array, ""]:
        """Minus the logarithm of the prior density of covers, places and sizes: by the table's
        covers, chance sites, and the distance that plants keep."""
        known, sd = self.candidates, self.settings.cover_sd
        # Crowns in those that the table has on average.
        each = weight * self.sizes(v)[0][known.site] ** 2
        crowns = jax.ops.segment_sum(each, known.species, len(known.number))
        crowns = crowns * self._diameters(v) ** 2
        off = (crowns - known.number) / jnp.sqrt((sd * known.number) ** 2 + 0.25)
        sites = jnp.sum(weight * jnp.log(known.chance)) + jnp.sum(none * jnp.log1p(-known.occupied))
        normal = sum(jnp.sum(x**2) for x in (v.shift, v.width, v.tall, v.u, v.band))
        return (
            0.5 * jnp.sum(off**2) + 0.5 * normal - sites + CROWDING * self.crowding(v, 1.0 - none)
        )

    def loss(self, v: Places) -> tuple[Float[Array, ""], Float[Array, ""]]:
        """What the search with plants in part makes small, and the misfit of a value [-]: data and
        prior in the mean over what the weights draw, less the entropy of these."""
        weight, none = self.weights(v.logit)
        pixels, heights = self.misfits(*self.image(v, weight))
        excess = self.excess(pixels)
        data = 0.5 * (jnp.sum(pixels) / self.together + jnp.sum(heights)) / excess
        entropy = -sum(jnp.sum(w * jnp.log(w + _TINY)) for w in (weight, none))
        return data + self.prior(v, weight, none) - entropy, jnp.sum(pixels) / self.values

    def start(self, chain: int = 0) -> Places:
        """The table's weights everywhere and the middle of the priors; of later chains leaves,
        ground and gains drawn from theirs."""
        known, zero = self.candidates, jnp.zeros_like(self.candidates.reach)
        random = generator(self.settings.seed + chain, 307)
        drawn = random.normal(size=len(known.chance))
        early = np.asarray(free_early(self.space).u) * (chain > 0)
        u = jnp.asarray(early * random.normal(size=len(early)).clip(-2.0, 2.0), zero.dtype)
        band = (chain > 0) * random.normal(size=self.root.shape[1]).clip(-2.0, 2.0)
        logit = jnp.log(known.chance / (1.0 - known.occupied)[known.site])
        return Places(
            logit + jnp.asarray(0.1 * drawn, zero.dtype), jnp.zeros_like(known.place), zero, zero,
            u, jnp.asarray(band, zero.dtype),
        )  # fmt: skip


CROWDING = 10.0
"""What two plants at the same place cost, as minus the logarithm of a density. An assumption: sites
of a drawn stand are never nearer than they keep, plants of a real one seldom."""


def _shortest(gap: Array, side: Array) -> Array:
    return gap - jnp.where(jnp.isinf(side), 0.0, side * jnp.round(gap / side))


_NOTHING = 1e-12
"""Area per volume that counts as none [m2 m-3]."""


def standing_height(voxels: VoxelScene) -> Float[Array, "y x"]:
    """Mean height over the lowest ground at which a line of sight from straight above meets leaves,
    wood or level ground, over the voxel columns [m]. Differentiable."""
    classes = voxels.classes
    angles = [classes.angles[i].projection(jnp.ones(())) for i in classes.angle_of_class]
    shown = jnp.stack(angles).astype(voxels.area_density.dtype)
    density = jnp.tensordot(shown, voxels.area_density, axes=1)
    high, times = voxels.structure_factor
    if voxels.structure is not None:
        inside = density / (voxels.area_density.sum(axis=0) + _NOTHING)
        for axis, number in enumerate((high, times, times)):
            inside = jnp.repeat(inside, number, axis=axis)
        density = inside * voxels.structure
    edge = voxels.vertical / high
    above = edge * jnp.cumsum(density[::-1], axis=0)
    height = edge * jnp.sum(-jnp.expm1(-above), axis=0)
    ny, nx = (n // times for n in height.shape)
    return height.reshape(ny, times, nx, times).mean(axis=(1, 3))


def places_model(
    scene: Scene,
    image: Float[np.ndarray, "band row column"],
    camera: AimedSensor,
    space: ParameterSpace,
    settings: PlacesSettings,
    *,
    height: Float[np.ndarray, "y x"] | None = None,
    error: ModelError | None = None,
) -> PlacesModel:
    """The model of a search for plants.

    **Arguments:**

    - `scene`: of the species table, as it was built.
    - `image`: reflectance factor of the compared blocks [-], rows from the south, as `camera` has
      them; NaN where there is none.
    - `camera`: from `aim`, without air.
    - `space`: the free parameters with their priors; covers have no effect.
    - `settings`: of the search.
    - `height`: of the canopy over the ground in the voxel columns of `Scene.class_grid` [m].
    - `error`: what the model is off by, over wavelength.

    **Raises:** `InputError` for arrays of other shapes, and as `candidates`.
    """
    bands = camera.sensor.bands
    if np.shape(image) != (len(bands), *camera.shape):
        raise InputError(
            f"expected an image of {len(bands)} bands, {camera.shape[0]} rows and "
            f"{camera.shape[1]} columns, as the camera's, but got one of shape {np.shape(image)}"
        )
    seen = np.isfinite(np.asarray(image, float)).all(axis=0)
    if not seen.any():
        raise InputError("no block of the image has all its values")
    columns = scene.class_grid.shape[1::-1]
    if height is not None and scene.terrain is not None:
        raise InputError("expected level ground with heights of a canopy, but there is a terrain")
    if height is not None and np.shape(height) != columns:
        raise InputError(
            f"expected heights of {columns[0]} x {columns[1]} voxel columns, but got an array of "
            f"shape {np.shape(height)}"
        )
    gains = camera.sensor.gains() if settings.gains is None else settings.gains
    factors = BandFactors.of_bands([(bands, gains)], error)
    shape, together = shape_error(scene, camera, seed=settings.seed)
    covariance = shape + settings.pixel_sd**2 * np.eye(len(bands))
    single = lambda v: jnp.asarray(v, scene.dtype)  # noqa: E731
    return PlacesModel(
        candidates(scene, settings), camera, jax.tree.map(single, space), single(factors.root),
        single(np.where(seen, image, np.nan)),
        single(np.linalg.inv(np.linalg.cholesky(covariance))), single(together),
        None if height is None else single(height), settings,
    )  # fmt: skip


def free_early(space: ParameterSpace) -> Places:
    """1 for what may change while plants stand in part, 0 for the rest."""
    early = [float(parameter_kind(name) not in _LATE) for name in space.names]
    return _masks(1.0, np.array(early))


def free_late() -> Places:
    """As `free_early`, while plants are whole and which stand is given."""
    return _masks(0.0, 1.0)


def _masks(logit: float, u: float | np.ndarray) -> Places:
    return Places(*(jnp.asarray(mask) for mask in (logit, 1.0, 1.0, 1.0, u, 1.0)))


@cache
def _adam() -> Any:
    # Adam (Kingma and Ba 2015)
    return require("optax", "map").scale_by_adam(b1=0.9, b2=0.99)


@eqx.filter_jit
def _advance(
    model: PlacesModel, v: Places, state: Any, rate: Array, free: Places
) -> tuple[Places, Any, Array]:
    slope = eqx.filter_grad(lambda v, model: model.loss(v), has_aux=True)
    by_v, misfit = slope(v, model)
    step, state = _adam().update(by_v, state)
    step = jax.tree.map(lambda s, may: (-rate * may * s).astype(s.dtype), step, free)
    return eqx.apply_updates(v, step), state, misfit


def descend(
    model: PlacesModel,
    v: Places,
    steps: int,
    free: Places,
    rate: float = 1.0,
    watch: Callable[[Places, float], None] | None = None,
) -> Places:
    """Steps of Adam down the slopes of `PlacesModel.loss`, short at first and at the end.

    **Arguments:** `model`; `v`, where to start; `steps`; `free`, 1 for what may change, else 0;
    `rate`, of the settings' own; `watch`, called with each place and its misfit.

    **Raises:** `MissingExtraError` without optax.
    """
    state, free = _adam().init(v), jax.tree.map(lambda x: jnp.asarray(x, v.u.dtype), free)
    for i in range(steps):
        size = rate * model.settings.rate * min(1.0, (i + 1) / 5.0, 3.0 * (1.0 - i / steps))
        v, state, misfit = _advance(model, v, state, jnp.asarray(size, v.u.dtype), free)
        if watch is not None:
            watch(v, float(misfit))
    return v

"""Calibrations of images that another model made: path tracing among explicit leaves.

    python -m tests.benchmarks.other_truths --number 20

Each truth is a plot of its own: plants where a process of its own has put them, crowns of shapes
that no growth form has, shoots of single leaves of a size, density and inclination that are drawn,
dead leaves among them, bark, soil and sky of other colours than the shipped ones, in an image with
drawn gains and noise (`BEYOND`). The values of the species table are what the model is told; the
truth lies about them as their priors have it. It is fitted blind, as `fx.fit` does by default.

Printed are how many truths lie in the 90 % intervals of the stand's numbers, which are counted in
the explicit plants: areas and contents of their leaves, ground below their crowns, gap among their
leaves. Results are kept in `--keep` as they come, and a second run goes on with them.

    python -m tests.benchmarks.other_truths --same clumping

takes one kind of what is `BEYOND` the model back, all else as it was; `--error none` believes the
model.
"""

import time
from pathlib import Path
from typing import Any, Literal, NamedTuple

import jax.numpy as jnp
import numpy as np
import pandas as pd
from scipy.optimize import brentq

import fynjax as fx
from fynjax.canopy import FORMS, leaf_angle
from fynjax.inversion import CalibrationSettings, Functional, ParameterSpace, stand_functionals
from fynjax.radiation import Illumination, OpticalClasses, VoxelScene, parallel_rays
from fynjax.scene import (
    LEAF_FIELDS,
    AimedSensor,
    LightParameters,
    Observation,
    Placement,
    PlotParameters,
    Scene,
    aim,
    mean_trait,
    with_values,
)
from fynjax.sensors import Gains, Sensor
from tests import reference
from tests.benchmarks._measure import options

TABLE = pd.DataFrame(
    [
        ("Erica", "rounded_shrub", 45.0, 22.0, 0.6),
        ("Phylica", "upright_ericoid", 35.0, 14.0, 0.9),
        ("Searsia", "broad_leaved", 60.0, 12.0, 1.0),
        ("Restio", "tussock", 40.0, 15.0, 0.6),
    ],
    columns=["taxon", "growth_form", "mean_diameter_cm", "cover_percent", "height_max_m"],
)
SIZE, VOXEL, PIXEL, ALTITUDE = 2.4, 0.1, 0.05, 50.0
FREE = (
    *(f"species.*.{kind}" for kind in ("cover", "diameter", "height", "dead_fraction")),
    *("species.*.leaf_area_index", "species.*.shoot_clumping"),
    *(f"species.*.leaf.{trait}" for trait in LEAF_FIELDS if trait != "brown_pigments"),
    *("ground.brightness", "ground.moisture", "ground.*_fraction"),
)
"""What a plot without measured leaves frees by default, and heights, which tables seldom know."""
BEYOND = ("angles", "crowns", "clumping", "bark", "soil", "air", "gains")
"""What truths have otherwise than the model: inclination of leaves; shapes of crowns and where
plants stand; size, density and grouping of shoots; colour of dead tissue and wood; colour and
patches of the ground; aerosol and brightness of the sky; gains of the camera."""
PIXEL_NOISE = 0.01
BLADES = {"broad_leaved": (0.012, 0.02)}
"""Diameters of leaves of a form, least and largest [m]; of the others `FINE`."""
FINE = (0.006, 0.012)
QUICK = CalibrationSettings(stand_realisations=4, scatter_draws=12, full_renders=1, max_steps=8)
GAP = Functional("gap", "-", lambda scene, plot: scene.gap_fraction(plot))


class Known(NamedTuple):
    """What the model is told of a plot."""

    scene: Scene
    space: ParameterSpace
    camera: Sensor
    aimed: AimedSensor


class Truth(NamedTuple):
    """What there is of a plot of explicit leaves, and what a camera measures of it."""

    stand: dict[str, float]
    """Numbers of the stand, counted."""
    plants: list["Plants"]
    """Of each species."""
    image: Observation | None


class Plants(NamedTuple):
    """Plants of one species."""

    foot: np.ndarray
    diameter: np.ndarray
    height: np.ndarray


def known(
    number: int,
    size: float = SIZE,
    table: pd.DataFrame = TABLE,
    structure: Literal["even"] | None = None,
) -> Known:
    """The plot as the table has it, under the sun of a truth."""
    random = np.random.default_rng([number, 1])
    sun = LightParameters(
        sun_zenith=jnp.asarray(random.uniform(20.0, 50.0)),
        sun_azimuth=jnp.asarray(random.uniform(0.0, 360.0)),
    )
    scene = Scene.from_table(table, size=size, voxel=VOXEL, structure=structure, light=sun)
    camera = fx.sensor("mavic_3m")
    aimed = aim(scene, scene.parameters, camera, Placement(ALTITUDE, PIXEL))
    return Known(scene, fx.free(scene, *FREE, prior=fx.prior()), camera, aimed)


def plant(
    cover: float, diameter: float, height: float, size: float, random: Any, alike: bool
) -> Plants:
    """Plants of a species until they cover the ground as they should, with room that is drawn."""
    room, variation = random.uniform([0.0, 0.1], [0.9, 0.4])
    if alike:
        room, variation = 0.5, 0.2
    foot, wide, covered = np.zeros((0, 2)), np.zeros(0), 0.0
    while True:
        one = diameter * np.exp(variation * random.normal() - 0.5 * variation**2)
        for _ in range(30):
            place = random.uniform(0.0, size, 2)
            away = np.abs(foot - place)
            distance = np.linalg.norm(np.minimum(away, size - away), axis=1)
            if (distance > 0.5 * room * (wide + one)).all():
                break
        more = np.mean(crowns(np.vstack([foot, place]), np.append(wide, one), size) > 0)
        # The plant that goes beyond stands where that is nearer to the cover, and the first one.
        if len(wide) and more > cover and more - cover > cover - covered:
            break
        foot, wide, covered = np.vstack([foot, place]), np.append(wide, one), more
        if covered >= cover:
            break
    low = random.uniform(0.6, 1.0, len(wide))
    return Plants(foot, wide, height * (low if alike else low**0.5))


def crowns(foot: np.ndarray, diameter: np.ndarray, size: float, cells: int = 240) -> np.ndarray:
    """How many crowns lie over each cell of the ground."""
    at = (np.arange(cells) + 0.5) * size / cells
    count = np.zeros((cells, cells), int)
    for (x, y), wide in zip(foot, diameter):
        across, along = (np.abs(at - one) for one in (x, y))
        across, along = np.minimum(across, size - across), np.minimum(along, size - along)
        count += across[None] ** 2 + along[:, None] ** 2 < 0.25 * wide**2
    return count


def escape(x: float) -> float:
    """1 - p of a ball of leaves at random that faces all ways, of optical radius `x`: twice its
    silhouette over the area of its leaves."""
    through = 2.0 * (1.0 - (1.0 + x) * np.exp(-x)) / x**2
    return float(1.5 * (1.0 - through) / x)


class Foliage(NamedTuple):
    """How the leaves of a species lie, drawn for one truth."""

    base: float
    widest: float
    power: tuple[float, float]
    shell: float
    arch: float
    branches: int
    apart: float
    shoot: float
    """Radius of a shoot [m]."""
    long: float
    """Length of a shoot over its width."""
    depth: float
    """Optical radius of a shoot."""
    leaf: float
    """Diameter of a leaf [m]."""
    inclined: float
    """Power of the inclination over 90 degrees: below 1 leaves are more upright."""

    @classmethod
    def draw(cls, form: str, clumping: float, random: Any, same: frozenset[str]) -> "Foliage":
        low, high = BLADES.get(form, FINE)
        crown, shoot = (0.0 if n in same else 1.0 for n in ("crowns", "clumping"))
        depth = brentq(lambda x: escape(x) - (1.0 - min(clumping, 0.75)), 1e-3, 30.0)
        return cls(
            0.1 + crown * random.uniform(-0.1, 0.15),
            0.45 + crown * random.uniform(-0.25, 0.3),
            tuple(2.0 * np.exp(crown * random.normal(0.0, 0.4, 2))),
            1.5 + crown * random.uniform(-1.5, 3.0),
            1.6 * np.exp(crown * random.normal(0, 0.3)),
            round(40 * np.exp(shoot * random.normal(0, 0.7))),
            0.08 * np.exp(shoot * random.normal(0, 0.5)),
            0.025 * np.exp(shoot * random.normal(0, 0.3)),
            1.0 + shoot * random.uniform(0.0, 2.0),
            depth * np.exp(shoot * random.normal(0, 0.3)),
            np.sqrt(low * high) * (high / low) ** (shoot * random.uniform(-0.5, 0.5)),
            np.exp((0.0 if "angles" in same else 0.4) * random.normal()),
        )  # fmt: skip

    def reach(self, t: np.ndarray) -> np.ndarray:
        """Half width of the crown at parts of its height, over the largest."""
        below = (self.widest - t) / max(self.widest - self.base, 0.05)
        above = (t - self.widest) / (1.0 - self.widest)
        away = np.where(t < self.widest, below, above).clip(0.0, 1.0)
        power = np.where(t < self.widest, *self.power)
        return (1.0 - away**power) ** (1.0 / power)

    def shoots(self, form: str, count: int, random: Any) -> tuple[np.ndarray, np.ndarray]:
        """Middles of shoots and ends of branches of one plant, in crown radii and heights."""
        few = self.branches
        turn = 2.0 * np.pi * random.random(few)
        if form == "tussock":
            tip, top = np.sqrt(random.random(few)), random.uniform(0.6, 1.0, few)
            of, s = random.integers(few, size=count), random.uniform(0.05, 1.0, count)
            out, z = 0.2 * tip[of] + 0.8 * tip[of] * s**self.arch, top[of] * s
            ends = np.stack([tip * np.cos(turn), tip * np.sin(turn), top], axis=1)
            return np.stack([out * np.cos(turn[of]), out * np.sin(turn[of]), z], axis=1), ends
        t = np.linspace(self.base, 1.0, 201)[1:-1]
        mass = np.cumsum(self.reach(t) ** 2)
        z = np.interp(random.random(few), mass / mass[-1], t)
        out = self.reach(z) * random.random(few) ** (1.0 / (2.0 + self.shell))
        ends = np.stack([out * np.cos(turn), out * np.sin(turn), z], axis=1)
        weight = np.exp(0.3 * random.normal(size=few))
        of = random.choice(few, count, p=weight / weight.sum())
        middle = ends[of] + self.apart * random.normal(size=(count, 3)) * [2.0, 2.0, 1.5]
        wide = np.linalg.norm(middle[:, :2], axis=1)
        middle[:, :2] /= np.maximum(wide, 1.0)[:, None]  # all within the crown
        middle[:, 2] = np.clip(middle[:, 2], 0.02, 1.0)
        return middle, ends

    def normals(self, form: str, count: int, random: Any) -> np.ndarray:
        """Normals of leaves: inclinations of the form, bent to flatter or more upright ones."""
        at = np.linspace(0.0, 0.5 * np.pi, 400)
        angle = leaf_angle(FORMS[form].leaf_angle)
        density = np.asarray(angle.inclination_density(jnp.asarray(at)))
        mass = np.concatenate([[0.0], np.cumsum(0.5 * (density[1:] + density[:-1]))])
        tilt = np.interp(random.random(count), mass / mass[-1], at / at[-1])
        return towards(0.5 * np.pi * tilt**self.inclined, 2.0 * np.pi * random.random(count))


def towards(tilt: np.ndarray, turn: np.ndarray) -> np.ndarray:
    """Unit vectors."""
    x, y = np.sin(tilt) * np.cos(turn), np.sin(tilt) * np.sin(turn)
    return np.stack([x, y, np.cos(tilt)], axis=1)


def grow(
    species: int, form: str, plants: Plants, area: np.ndarray, wood: np.ndarray, dead: float,
    foliage: Foliage, classes: int, random: Any,
) -> reference.Leaves:  # fmt: skip
    """Leaves and wood of all plants of a species, as discs: `area` of shoots and `wood` [m2]."""
    made = []
    volume = foliage.shoot**3 * foliage.long
    density = foliage.depth / foliage.shoot  # area of leaves in a shoot over its volume
    for foot, wide, tall, leaf, bark in zip(*plants, area, wood):
        count = round(leaf / (np.pi / 4.0 * foliage.leaf**2))
        bearing = max(1, round(leaf / (density * 4.0 / 3.0 * np.pi * volume)))
        size = np.array([0.5 * wide, 0.5 * wide, tall])
        middle, ends = foliage.shoots(form, bearing, random)
        # Shoots lie along the way from the foot of the plant.
        along = middle * size
        along /= np.linalg.norm(along, axis=1, keepdims=True)
        inside = np.maximum(1.0 - foliage.shoot / (0.5 * wide), 0.3)
        middle = middle * size * [inside, inside, 1.0]
        of = random.integers(bearing, size=count)
        ball = random.normal(size=(count, 3))
        ball *= (random.random(count) ** (1 / 3) / np.linalg.norm(ball, axis=1))[:, None]
        ball += (foliage.long - 1.0) * np.sum(ball * along[of], axis=1)[:, None] * along[of]
        place = middle[of] + foliage.shoot * ball
        alive = np.where(random.random(count) < dead, classes - 2, species)
        made.append((place, foliage.normals(form, count, random), foliage.leaf, alive, foot))
        twigs = round(bark / (np.pi / 4.0 * 0.006**2))
        end = ends[random.integers(len(ends), size=twigs)] * size * [inside, inside, 1.0]
        way = end * random.random((twigs, 1))
        aside = np.arccos(random.uniform(0.0, 0.5, twigs))
        bark_normal = towards(aside, 2.0 * np.pi * random.random(twigs))
        made.append((way, bark_normal, 0.006, np.full(twigs, classes - 1), foot))
    place = np.concatenate([p + np.append(foot, 0.0) for p, *_, foot in made])
    place[:, 2] = np.maximum(place[:, 2], 0.005)
    diameter = np.concatenate([np.full(len(p), d) for p, _, d, *_ in made])
    normal, owner = (np.concatenate([one[i] for one in made]) for i in (1, 3))
    return reference.Leaves(place, normal, 0.5 * diameter, owner)


def optics(
    what: Known, plot: PlotParameters, random: Any, same: frozenset[str]
) -> tuple[OpticalClasses, np.ndarray]:
    """Optics of the live leaves of each species, of dead tissue and wood, and the sky's share."""
    scene, bands = what.scene, what.aimed.sensor.bands
    none = "shoot_clumping", "dead_fraction"
    bare = {f"species.{taxon}.{kind}": 0.0 for taxon in scene.taxa for kind in none}
    air = 0.0 if "air" in same else 1.0
    bare["light.aerosol"] = 0.1 * np.exp(air * random.normal(0.0, 0.6))
    found, sky = scene.optics(with_values(plot, scene.taxa, bare), bands)
    leaves = len(scene.taxa)
    rho, tau = (np.asarray(v, float)[:leaves] for v in (found.reflectance, found.transmittance))
    bark = np.asarray(found.reflectance, float)[leaves]
    # Brighter or darker, redder or less so, and dead tissue lets a little light through.
    off = 0.0 if "bark" in same else 1.0
    slope = (np.asarray(bands.centre) - 700.0) / 300.0
    level, tilt = off * random.normal(0.0, 0.2, (2, 2, 1))
    dead, wood = np.clip(bark * np.exp(level + tilt * slope), 0.0, 0.9)
    through = off * random.uniform(0.0, 0.25)
    rho = np.vstack([rho, (1.0 - through) * dead, wood])
    tau = np.vstack([tau, through * dead, 0.0 * wood])
    classes = OpticalClasses(
        jnp.asarray(rho), jnp.asarray(tau), (leaf_angle("spherical"),), (0,) * len(rho)
    )
    share = np.clip(np.asarray(sky, float) * np.exp(air * random.normal(0.0, 0.15)), 0.01, 0.95)
    return classes, share


def ground(what: Known, plot: PlotParameters, random: Any, same: frozenset[str]) -> np.ndarray:
    """Reflectance of the ground in each voxel column: soil of another colour, litter in patches."""
    scene, centre = what.scene, np.asarray(what.aimed.sensor.bands.centre)
    soil, litter, *_ = np.asarray(scene.ground_spectra(plot, np.round(centre)), float)
    off, cells = 0.0 if "soil" in same else 1.0, scene.grid.shape[0]
    slope = (centre - 700.0) / 300.0
    soil, litter = (one * np.exp(off * random.normal(0, 0.12) * slope) for one in (soil, litter))
    wave = np.fft.fftfreq(cells)
    smooth = np.exp(-20.0 * (wave[:, None] ** 2 + wave**2) * random.uniform(0.5, 10.0))
    patches = np.fft.ifft2(smooth * np.fft.fft2(random.normal(size=(cells, cells)))).real
    rank = patches.ravel().argsort().argsort().reshape(cells, cells) / cells**2
    share = float(plot.ground.litter_fraction)
    cover = np.where(rank < share, 1.0, 0.0) if off else np.full((cells, cells), share)
    return soil[:, None, None] * (1.0 - cover) + litter[:, None, None] * cover


def grow_plot(
    what: Known, number: int, same: frozenset[str]
) -> tuple[reference.Leaves, VoxelScene, Truth]:
    """The leaves of a truth, the optics, ground and light about them, and the truth without its
    image."""
    scene, space = what.scene, what.space
    random = np.random.default_rng([number, 2])
    u = random.normal(size=len(space.names)).clip(-2.2, 2.2)
    plot = with_values(scene.parameters, scene.taxa, space.named(jnp.asarray(u)))
    of = {k: np.asarray(getattr(plot.species, k), float) for k in (
        "cover", "diameter", "height", "leaf_area_index", "wood_area_index", "shoot_clumping",
        "dead_fraction",
    )}  # fmt: skip
    side, forms = scene.grid.extent[0], scene.forms

    def stream(*key: int) -> np.random.Generator:
        # Of each thing its own, so that one that is taken back leaves the others as they are.
        return np.random.default_rng([number, 3, *key])

    stand = [
        plant(*of_plants, side, stream(0, i), "crowns" in same)
        for i, of_plants in enumerate(zip(of["cover"], of["diameter"], of["height"]))
    ]
    over = np.array([crowns(p.foot, p.diameter, side) for p in stand])
    every = over.sum(axis=0)
    discs = [0.25 * np.pi * p.diameter**2 for p in stand]
    # Areas are stated of crowns as seen from above.
    seen = float(np.mean(every > 0)) * side**2 / sum(d.sum() for d in discs)
    classes, sky = optics(what, plot, stream(1), same)
    count = len(classes.reflectance)
    made = []
    for i, form in enumerate(forms):
        foliage = Foliage.draw(form, of["shoot_clumping"][i], stream(2, i), same)
        area, wood = (of[k][i] * seen * discs[i] for k in ("leaf_area_index", "wood_area_index"))
        dead = of["dead_fraction"][i]
        made.append(grow(i, form, stand[i], area, wood, dead, foliage, count, stream(3, i)))
    leaves = reference.Leaves(*(np.concatenate(parts) for parts in zip(*made)))
    light = plot.light
    pattern = None
    if "air" not in same:  # brighter about the sun
        zenith, azimuth = np.meshgrid(
            np.linspace(0, np.pi / 2, 19), np.arange(36) * np.pi / 18, indexing="ij"
        )
        sun = np.deg2rad([float(light.sun_zenith), float(light.sun_azimuth)])
        near = np.cos(zenith) * np.cos(sun[0]) + np.sin(zenith) * np.sin(sun[0]) * np.cos(
            azimuth - sun[1]
        )
        away = np.arccos(np.clip(near, -1.0, 1.0)) / np.deg2rad(25.0)
        pattern = jnp.asarray(1.0 + stream(4).uniform(0.0, 5.0) * np.exp(-0.5 * away**2))
    cells = scene.grid.shape
    high = float(leaves.centre[:, 2].max()) + 0.05
    empty = jnp.zeros((count, max(1, int(np.ceil(high / VOXEL))), cells[1], cells[0]))
    sun = Illumination(
        light.sun_zenith, light.sun_azimuth, jnp.asarray(1.0 - sky), jnp.asarray(sky), pattern
    )
    soil = jnp.asarray(ground(what, plot, stream(5), same))
    world = VoxelScene(empty, classes, soil, sun, VOXEL, VOXEL)
    return leaves, world, Truth(counted(what, plot, leaves, stand, over, world), stand, None)


def counted(
    what: Known, plot: PlotParameters, leaves: reference.Leaves, stand: list[Plants],
    over: np.ndarray, world: VoxelScene,
) -> dict[str, float]:  # fmt: skip
    """Numbers of the stand, of the explicit plants."""
    scene = what.scene
    side, number = scene.grid.extent[0], len(scene.taxa)
    area = np.pi * leaves.radius**2 / side**2
    of = np.bincount(leaves.optical_class, area, number + 2)
    green, dead = of[:number], of[number]
    contents = {
        name: factor * float(green @ np.asarray(mean_trait(scene.species, plot, trait)))
        for name, trait, factor in (
            ("canopy_chlorophyll", "chlorophyll", 0.01),
            ("canopy_water", "water", 1e4),
            ("leaf_mass", "dry_matter", 1e4),
        )
    }
    every = over.sum(axis=0)
    shares = np.where(every > 0, over / np.maximum(every, 1), 0.0).mean(axis=(1, 2))
    tall = np.concatenate([p.height for p in stand])
    discs = np.concatenate([p.diameter**2 for p in stand])
    covers = {f"cover.{form}": float(one) for form, one in zip(scene.forms, shares)}
    return {
        "green_leaf_area": float(green.sum()),
        "dead_share": float(dead / (dead + green.sum())),
        "dead_area": float(dead),
        "crown_cover": float(np.mean(every > 0)),
        "canopy_height": float(np.sum(tall * discs) / discs.sum()),
        "gap": gap(leaves, world),
        **contents,
        **covers,
    }


def gap(leaves: reference.Leaves, world: VoxelScene) -> float:
    """Share of the ground seen from straight above: black leaves over white ground, lit from
    there."""
    black = np.zeros((len(world.classes.reflectance), 1))
    classes = OpticalClasses(
        jnp.asarray(black), jnp.asarray(black), world.classes.angles, world.classes.angle_of_class
    )
    zero, one = jnp.zeros(1), jnp.ones(1)
    lit = Illumination(jnp.asarray(0.0), jnp.asarray(0.0), one, zero)
    scene = VoxelScene(world.area_density, classes, one, lit, VOXEL, VOXEL)
    x = (jnp.arange(world.shape[2]) + 0.5) * VOXEL
    rays = parallel_rays(x, x, VOXEL, 0.0, 0.0)
    return float(reference.disc_image(scene, leaves, rays, samples=20, seed=0, band=0).mean.mean())


def photograph(
    what: Known, leaves: reference.Leaves, world: VoxelScene, number: int,
    same: frozenset[str], samples: int,
) -> Observation:  # fmt: skip
    """The image that the camera makes of explicit leaves, with its blur, gains and noise."""
    aimed, random = what.aimed, np.random.default_rng([number, 4])
    bands = aimed.sensor.bands
    seen = [
        reference.disc_image(world, leaves, aimed.rays, samples=samples, seed=number, band=i).mean
        for i in range(len(bands))
    ]
    pixels = np.asarray(aimed.averages(jnp.asarray(np.stack(seen)), world)[0], float)
    if "gains" not in same:
        covariance = what.camera.gains().covariance(len(bands))
        gain = np.exp(random.multivariate_normal(np.zeros(len(bands)), covariance))
        pixels = pixels * gain[:, None, None]
    pixels = pixels * (1.0 + PIXEL_NOISE * random.normal(size=pixels.shape))
    return Observation(
        jnp.asarray(pixels), None, jnp.ones(len(bands), bool), None, jnp.zeros(len(bands)),
        sensor=what.camera.name, bands=bands.names, wavelength=tuple(map(float, bands.centre)),
        width=tuple(map(float, bands.fwhm)), pixel=PIXEL,
    )  # fmt: skip


def truth(what: Known, number: int, *, same: tuple[str, ...] = (), samples: int = 16) -> Truth:
    """A truth by its number, all that is random by it."""
    alike = frozenset(same)
    leaves, world, grown = grow_plot(what, number, alike)
    return grown._replace(image=photograph(what, leaves, world, number, alike, samples))


def fit(what: Known, image: Observation, gains: Gains | None = None, **options: Any) -> Any:
    """The calibration to an image by the default road."""
    data = fx.Data.from_image(image, what.camera, altitude=ALTITUDE, gains=gains)
    return fx.fit(what.scene, data, what.space, **options)


def held(what: Known, found: Any, stand: dict[str, float]) -> pd.DataFrame:
    """Numbers of the stand beside the true ones; `inside`: whether the 90 % interval holds it."""
    functionals = {**stand_functionals(what.scene), "gap": GAP}
    table = found.stand(functionals).set_index("name")
    table["truth"] = pd.Series(stand)
    table["inside"] = (table.q05 <= table.truth) & (table.truth <= table.q95)
    return table


def twin(number: int, chosen: Any) -> pd.DataFrame:
    """A truth, its image and the calibration to it: `held`, and the CPU seconds of both."""
    began = time.process_time()
    what = known(number, chosen.size)
    one = truth(what, number, same=tuple(chosen.same), samples=chosen.samples)
    made = time.process_time()
    found = fit(what, one.image, error=chosen.error, settings=chosen.settings)
    table = held(what, found, one.stand)
    return table.assign(
        misfit=found.misfit / found.degrees,
        converged=float(found.fit.converged),
        seconds_truth=made - began,
        seconds_fit=time.process_time() - made,
    )


def report(tables: list[pd.DataFrame]) -> None:
    """Print the share of truths that intervals hold, of each number and of all."""
    print(f"{len(tables)} truths, {np.mean([t.converged.iloc[0] for t in tables]):.2f} converged")
    for name in ("seconds_truth", "seconds_fit", "misfit"):
        print(f"{name}, median {np.median([t[name].iloc[0] for t in tables]):.3g}")
    print(f"{'in the 90 % interval':24s} held  prior's   off [%]  removed")
    for name in tables[0].index:
        rows = pd.DataFrame([t.loc[name] for t in tables])
        prior = (rows.prior_q05 <= rows.truth) & (rows.truth <= rows.prior_q95)
        off = 100.0 * np.expm1(np.median(np.log((rows.estimate / rows.truth).astype(float))))
        print(
            f"{name:24s} {rows.inside.mean():4.2f}  {prior.mean():7.2f}  {off:+8.1f}  "
            f"{rows.constrained.mean():7.2f}"
        )
    shares = np.array([t.inside.astype(float).mean() for t in tables])
    # Numbers of one stand hang together: the error is that of the mean over truths.
    error = shares.std(ddof=1) / np.sqrt(len(shares)) if len(shares) > 1 else 0.5
    print(f"all numbers {shares.mean():.3f} +- {error:.3f}")


def main(arguments: Any = None) -> None:
    """Print the table."""
    parser = options(__doc__)
    parser.add_argument("--number", type=int, default=20)
    parser.add_argument("--size", type=float, default=SIZE)
    parser.add_argument("--samples", type=int, default=16)
    parser.add_argument("--same", nargs="+", choices=BEYOND, default=())
    parser.add_argument("--error", choices=("learned", "none"), default="learned")
    parser.add_argument("--keep", type=Path, default=Path("other_truths"))
    chosen = parser.parse_args(arguments)
    chosen.settings = None
    if chosen.tiny:
        chosen.number, chosen.size, chosen.samples = 1, 1.2, 2
        chosen.settings = QUICK
    chosen.keep.mkdir(parents=True, exist_ok=True)
    tables = []
    for number in range(chosen.number):
        path = chosen.keep / f"truth_{number:03d}.csv"
        if not path.is_file():
            twin(number, chosen).to_csv(path)
        tables.append(pd.read_csv(path, index_col="name"))
        one = tables[-1]
        print(
            f"{number}: {one.inside.mean():.2f} in the intervals, "
            f"{one.seconds_truth.iloc[0]:.0f} + {one.seconds_fit.iloc[0]:.0f} CPU s",
            flush=True,
        )
    report(tables)


if __name__ == "__main__":
    main()

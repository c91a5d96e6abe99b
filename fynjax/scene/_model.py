"""A plot that can be rendered: from its parameters to an image, differentiably.

What is random (where plants may stand, how they are turned, which are large) is drawn once, when
the model is built. The same plants then stand in the same places whatever the parameters are, so
that an image is a smooth, repeatable function of the parameters.
"""

import dataclasses
from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from fynjax._core.errors import InputError
from fynjax.canopy import (
    FORM_DEFAULTS,
    CrownPacking,
    Organ,
    PlantModel,
    VoxelGrid,
    assign_sites,
    deposit,
    instance_area,
    instantiate,
    leaf_angle,
    plant_model,
    poisson_disk,
    random_orientation,
    soft_count,
    soft_weights,
    target_area,
)
from fynjax.leaf import LeafParameters, prospect
from fynjax.radiation import (
    Accuracy,
    Illumination,
    OpticalClasses,
    VoxelScene,
    nadir_rays,
    reflectance_factor,
    solve_light,
)
from fynjax.scene._parameters import PlotParameters
from fynjax.scene._spectra import background_spectrum
from fynjax.sensors import BandSet
from fynjax.sensors._sky import clear_sky_diffuse_fraction

# Petals as leaves without chlorophyll: an assumption, for want of measured fynbos petals.
_PETAL = LeafParameters(
    structure=2.0, chlorophyll=0.0, carotenoids=0.5, anthocyanins=1.0, water=0.008, dry_matter=0.003
)


class Stand(eqx.Module):
    """The plants of one species: their shape, and where each may stand."""

    plant: PlantModel
    sites: Float[Array, "plant 2"]
    """Ordered places; the first n of them are taken [m]."""
    azimuth: Float[Array, " plant"]
    """[degrees]"""
    tilt: Float[Array, " plant"]
    """[degrees]"""
    size: Float[Array, " plant"]
    """Crown diameter relative to the species' mean; the mean of its square is 1 [-]."""
    stature: Float[Array, " plant"]
    """Height relative to the species' greatest [-]."""
    branches: float = eqx.field(static=True)
    rotation_spread: float = eqx.field(static=True)
    form: str = eqx.field(static=True)


class Camera(eqx.Module):
    """A frame camera that looks straight down on the middle of the plot."""

    bands: BandSet = eqx.field(static=True)
    altitude: float = eqx.field(static=True)
    """Above the ground [m]."""
    pixel: float = eqx.field(static=True)
    """Edge of a pixel on the ground [m]."""


class PlotModel(eqx.Module):
    """A plot: its fixed part. Call `image` with parameters to render it."""

    stands: tuple[Stand, ...]
    camera: Camera
    grid: VoxelGrid
    taxa: tuple[str, ...] = eqx.field(static=True)
    boundary: str = eqx.field(static=True)
    softness: float = eqx.field(static=True)
    """Share of a species' plants over which the last ones fade in [-]; see `soft_weights`."""
    width: float = eqx.field(static=True)
    """The same in plants, added to it; 0 with `softness` 0 is the hard scene of eq. (10)."""
    flowering: float = eqx.field(static=True)
    """Share of full bloom [-]."""
    accuracy: Accuracy = eqx.field(static=True)
    soil: Float[np.ndarray, "2 wavelength"] | None
    """A user's soil instead of the shipped dry and wet one (both rows), on `wavelength`."""
    diffuse: Float[np.ndarray, " wavelength"] | None
    """A user's diffuse fraction instead of the clear-sky model."""
    dtype: str = eqx.field(static=True)

    @property
    def wavelength(self) -> Float[np.ndarray, " wavelength"]:
        """Grid of the spectra behind the bands [nm]."""
        return band_wavelengths(self.camera.bands)

    @property
    def leafy(self) -> tuple[int, ...]:
        """Species that have leaves."""
        return tuple(
            i for i, stand in enumerate(self.stands) if bool(FORM_DEFAULTS[stand.form].leaf_area_index)
        )

    def counts(self, parameters: PlotParameters) -> Float[Array, " species"]:
        """Real number of plants of each species, eq. (10) without its ceiling [-]."""
        area = float(np.prod(self.grid.extent[:2]))
        species = parameters.species
        numbers = []
        for i, stand in enumerate(self.stands):
            packing = CrownPacking(
                100.0 * species.packing[i],
                100.0 * species.fill[i],
                stand.branches,
                stand.rotation_spread,
            )
            each = instance_area(species.diameter[i], species.height[i], packing)
            numbers.append(
                soft_count(target_area(area, 100.0 * species.cover[i]), each, stand.branches)
            )
        return jnp.stack(numbers)

    def area_density(self, parameters: PlotParameters) -> Float[Array, "class z y x"]:
        """Area per volume of each optical class: the species' leaves, then wood, then flowers."""
        species = parameters.species
        counts = self.counts(parameters)
        leaf_class = {s: c for c, s in enumerate(self.leafy)}
        wood = len(leaf_class)
        positions, areas, classes = [], [], []
        for i, stand in enumerate(self.stands):
            weight = soft_weights(
                counts[i], len(stand.sites), width=self.width, softness=self.softness
            )
            diameter = species.diameter[i] * stand.size
            crown = jnp.pi / 4.0 * diameter**2 / stand.branches
            leaf_area = species.leaf_area_index[i] * crown
            bloom = self.flowering * FORM_DEFAULTS[stand.form].flower_fraction
            place, area, organ = instantiate(
                stand.plant,
                stand.sites,
                stand.azimuth,
                weight.astype(self.dtype),
                diameter,
                species.height[i] * stand.stature,
                leaf_area,
                species.wood_area_index[i] * crown,
                bloom * leaf_area,
                stand.tilt,
            )
            of_organ = jnp.array([leaf_class.get(i, 0), wood, wood + 1])
            positions.append(place)
            areas.append(area)
            classes.append(of_organ[organ])
        return deposit(
            jnp.concatenate(positions),
            jnp.concatenate(areas),
            jnp.concatenate(classes),
            self.grid,
            wood + 2,
            boundary=self.boundary,  # type: ignore[arg-type]
        )

    def scene(self, parameters: PlotParameters) -> VoxelScene:
        """The voxel scene of `parameters`: what the radiation layer renders."""
        parameters = jax.tree.map(lambda x: jnp.asarray(x, self.dtype), parameters)
        average = jnp.asarray(self.camera.bands.weights(self.wavelength), self.dtype)
        leafy = np.array(self.leafy, int)
        leaves = jax.tree.map(lambda x: x[leafy], parameters.leaf)
        petal = jax.tree.map(lambda x: jnp.asarray(x, self.dtype)[None], _PETAL)
        leaves = jax.tree.map(lambda a, b: jnp.concatenate([a, b]), leaves, petal)
        optics = jax.vmap(lambda leaf: prospect(leaf, self.wavelength))(leaves)
        reflectance = optics.reflectance @ average.T
        transmittance = optics.transmittance @ average.T
        ground = parameters.ground
        bark = average @ jnp.asarray(background_spectrum("bark", self.wavelength), self.dtype)
        bark = jnp.clip(ground.wood_brightness * bark, 0.0, 1.0)
        # Class order: leaves of the species, wood, flowers.
        reflectance = jnp.concatenate([reflectance[:-1], bark[None], reflectance[-1:]])
        transmittance = jnp.concatenate(
            [transmittance[:-1], jnp.zeros_like(bark)[None], transmittance[-1:]]
        )
        names = [FORM_DEFAULTS[self.stands[i].form].leaf_angle for i in self.leafy]
        names += ["spherical", "spherical"]
        distinct = tuple(dict.fromkeys(names))
        classes = OpticalClasses(
            reflectance,
            transmittance,
            tuple(leaf_angle(name) for name in distinct),
            tuple(distinct.index(name) for name in names),
        )
        light = parameters.light
        if self.diffuse is None:
            share = clear_sky_diffuse_fraction(
                jnp.asarray(self.wavelength, self.dtype), light.sun_zenith, light.aerosol
            )
        else:
            share = jnp.asarray(self.diffuse, self.dtype)
        sky = average @ share
        return VoxelScene(
            self.area_density(parameters),
            classes,
            jnp.clip(average @ self.ground_spectrum(parameters), 0.0, 1.0),
            Illumination(light.sun_zenith, light.sun_azimuth, 1.0 - sky, sky),
            self.grid.horizontal_size,
            self.grid.vertical_size,
            self.boundary,
        )

    def ground_spectrum(self, parameters: PlotParameters) -> Float[Array, " wavelength"]:
        """Mixed reflectance of soil and litter on `wavelength` [-]."""
        if self.soil is None:
            names = ("dry_soil", "wet_soil")
            soil = np.stack([background_spectrum(name, self.wavelength) for name in names])
        else:
            soil = self.soil
        dry, wet = jnp.asarray(soil, self.dtype)
        litter = jnp.asarray(background_spectrum("litter", self.wavelength), self.dtype)
        ground = parameters.ground
        mixed = ground.brightness * ((1 - ground.moisture) * dry + ground.moisture * wet)
        return (1 - ground.litter_fraction) * mixed + ground.litter_fraction * litter

    def image(self, parameters: PlotParameters, stride: int = 1) -> Float[Array, "band y x"]:
        """Reflectance factor of the camera's pixels over the plot [-], y to the north.

        `stride` renders every so many pixels along each axis: a fair sample of the image at a
        fraction of its cost. Differentiable in `parameters`.
        """
        light = solve_light(self.scene(parameters), self.accuracy)
        lx, ly, _ = self.grid.extent
        x, y = (
            ((jnp.arange(0, round(length / self.camera.pixel), stride) + 0.5) * self.camera.pixel)
            .astype(self.dtype)
            for length in (lx, ly)
        )
        rays = nadir_rays(x, y, self.camera.pixel, (lx / 2, ly / 2, self.camera.altitude))
        return reflectance_factor(light, rays)


def band_wavelengths(bands: BandSet) -> Float[np.ndarray, " wavelength"]:
    """A grid fine enough for the responses of `bands`, inside 400-2500 nm [nm]."""
    centre, width = np.asarray(bands.centre), np.asarray(bands.fwhm)
    low, high = (centre - 2.2 * width).min(), (centre + 2.2 * width).max()
    step = max(1.0, round(float(width.min()) / 10))
    return np.arange(max(400.0, np.floor(low)), min(2500.0, np.ceil(high)) + step / 2, step)


def build_model(
    taxa: Sequence[str],
    forms: Sequence[str],
    parameters: PlotParameters,
    *,
    extent: tuple[float, float],
    voxel: float,
    camera: Camera,
    seed: int,
    boundary: str = "periodic",
    branches: Sequence[float] | None = None,
    rotation_spread: Sequence[float] | None = None,
    probability: Float[np.ndarray, "y x"] | None = None,
    room: float = 2.5,
    size_variation: float = 0.2,
    softness: float = 0.25,
    width: float = 1.0,
    flowering: float = 0.0,
    accuracy: Accuracy | None = None,
    soil: Float[np.ndarray, "2 wavelength"] | None = None,
    diffuse: Float[np.ndarray, " wavelength"] | None = None,
    dtype: str = "float32",
) -> PlotModel:
    """Draw what is random about a plot, once.

    **Arguments:**

    - `taxa`, `forms`: names and growth forms of the species.
    - `parameters`: the plot as described; gives the number of sites to hold ready.
    - `extent`: (east-west, north-south) sides of the plot [m].
    - `voxel`: edge of a voxel [m]; must divide the sides.
    - `room`: sites held ready, as a multiple of the plants that `parameters` ask for. A parameter
      that asks for more gets no more.
    - `size_variation`: coefficient of variation of the crown diameters of a species [-]. An
      assumption, as is the stature: heights lie evenly between 0.6 and 1 times the greatest.
    - `probability`: map of 0-255 over the plot, row 0 south, or none.
    - `softness`, `width`, `flowering`: see `PlotModel`.

    Raises `InputError` where the plants do not fit.
    """
    lx, ly = extent
    count = len(taxa)
    branches = [1.0] * count if branches is None else branches
    spread = [0.0] * count if rotation_spread is None else rotation_spread
    top = 1.1 * float(np.max(np.asarray(parameters.species.height)))
    accuracy = Accuracy() if accuracy is None else accuracy
    grid = VoxelGrid.cover(extent, top, voxel)
    accuracy, layers = _fitting(accuracy, grid)
    grid = VoxelGrid((grid.shape[0], grid.shape[1], layers), voxel, voxel)
    bare = [
        Stand(_EMPTY, jnp.zeros((0, 2)), *[jnp.zeros(0)] * 4, float(b), float(s), form)
        for b, s, form in zip(branches, spread, forms)
    ]
    model = PlotModel(
        tuple(bare), camera, grid, tuple(taxa), boundary, softness, width, flowering, accuracy,
        soil, diffuse, dtype,
    )
    wanted = np.asarray(model.counts(parameters))
    needed = np.ceil(room * wanted).astype(int) + np.where(wanted > 0, 4, 0)
    # A disk radius that leaves a tenth more points than plants; Bridson packs 0.6 / r2 of them.
    radius = min(0.1, np.sqrt(0.55 * lx * ly / max(1.1 * needed.sum(), 1)))
    points = poisson_disk((lx, ly), radius, seed=seed, periodic=boundary == "periodic")
    sites = assign_sites(points, needed.tolist(), probability=probability, extent=extent, seed=seed)
    stands = []
    for i, (stand, places) in enumerate(zip(bare, sites)):
        rng = np.random.default_rng([seed, 101, i])
        n = len(places)
        azimuth, tilt = random_orientation(n, seed=seed + 1000 * (i + 1), rotation_spread=spread[i])
        size = np.exp(np.sqrt(np.log1p(size_variation**2)) * rng.standard_normal(n))
        size = size / np.sqrt(np.mean(size**2)) if n else size
        stature = 0.6 + 0.4 * rng.random(n)
        form = stand.form
        elements = _elements(
            float(parameters.species.diameter[i]), float(parameters.species.height[i]), voxel
        )
        plant = plant_model(form, elements, seed=seed + i)
        arrays = (jnp.asarray(a, dtype) for a in (places, azimuth, tilt, size, stature))
        plant = jax.tree.map(
            lambda a: a.astype(dtype) if jnp.issubdtype(a.dtype, jnp.floating) else a, plant
        )
        stands.append(Stand(plant, *arrays, stand.branches, stand.rotation_spread, form))
    return eqx.tree_at(lambda m: m.stands, model, tuple(stands))


_EMPTY = PlantModel(jnp.zeros((0, 3)), jnp.zeros(0), jnp.zeros((0, 3)), jnp.zeros(0, int))


def _elements(diameter: float, height: float, voxel: float) -> int:
    """Area elements of a plant: a few for each voxel that its crown touches."""
    across = diameter / voxel + 0.5
    touched = across**2 * (height / voxel + 0.5)
    return int(np.clip(np.ceil(2.0 * touched), 24, 3000))


def _fitting(accuracy: Accuracy, grid: VoxelGrid) -> tuple[Accuracy, int]:
    """Coarsening that divides the plot's sides, and layers padded to a multiple of it."""
    nx, ny, nz = grid.shape
    high, wide = accuracy.coarsening
    while nx % wide or ny % wide:
        wide -= 1
    layers = -(-nz // high) * high
    return dataclasses.replace(accuracy, coarsening=(high, wide)), layers

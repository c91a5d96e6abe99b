"""A plot that can be rendered: from its parameters to an image, differentiably.

What is random (where plants may stand, how they are turned, which are large) is drawn once, when
the model is built. The same plants then stand in the same places whatever the parameters are, so
that an image is a smooth, repeatable function of the parameters.
"""

import dataclasses
from collections.abc import Sequence
from typing import Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from fynjax.canopy import (
    FORM_DEFAULTS,
    AbstractLeafAngle,
    CrownPacking,
    PlantModel,
    VoxelGrid,
    deposit,
    instance_area,
    site_weight,
    soft_count,
    target_area,
)
from fynjax.radiation import (
    Accuracy,
    Illumination,
    VoxelScene,
    nadir_rays,
    reflectance_factor,
    solve_light,
)
from fynjax.scene._ground import COVERS, ground_shares
from fynjax.scene._optics import inclination, optical_classes
from fynjax.scene._parameters import PlotParameters
from fynjax.scene._planting import Planting, draw_planting, leafy_species, no_plants
from fynjax.scene._spectra import background_spectrum, shipped_covers
from fynjax.sensors import BandSet
from fynjax.sensors.air import clear_sky_diffuse_fraction

DRONE = Accuracy(sublayers=1, coarsening=(2, 2), levels=2, refine=False)
"""Accuracy of a drone's image, seen from close to nadir under a high sun."""


class Camera(eqx.Module):
    """A frame camera that looks straight down on the middle of the plot."""

    bands: BandSet = eqx.field(static=True)
    altitude: float = eqx.field(static=True)
    """Above the ground, in a `PlotModel` above its lowest [m]."""
    pixel: float = eqx.field(static=True)
    """Edge of a pixel on the ground [m]."""


class PlotModel(eqx.Module):
    """A plot: its fixed part. Call `image` with parameters to render it."""

    planting: Planting
    camera: Camera
    grid: VoxelGrid
    taxa: tuple[str, ...] = eqx.field(static=True)
    forms: tuple[str, ...] = eqx.field(static=True)
    branches: tuple[float, ...] = eqx.field(static=True)
    """Copies of the plant model that make one plant [-]."""
    rotation_spread: tuple[float, ...] = eqx.field(static=True)
    """Standard deviation of the plants' lean [degrees]."""
    minimum_area: tuple[float, ...] = eqx.field(static=True)
    """Least ground area that a plant may count for [m2]."""
    leaf_angles: tuple[AbstractLeafAngle | None, ...]
    """How the leaves of each species are inclined; None: as its form has it."""
    boundary: Literal["periodic", "open"] = eqx.field(static=True)
    softness: float = eqx.field(static=True)
    """Share of a species' plants over which the last ones fade in [-]; see `site_weight`."""
    width: float = eqx.field(static=True)
    """The same in plants, added to it; 0 with `softness` 0 is the hard scene of eq. (10)."""
    flowering: float = eqx.field(static=True)
    """Share of full bloom [-]."""
    accuracy: Accuracy = eqx.field(static=True)
    soil: Float[np.ndarray, "2 wavelength"] | None
    """A user's soil instead of the shipped dry and wet one (both rows), on `wavelength`."""
    covers: Float[np.ndarray, "cover wavelength"]
    """Reflectance of litter, char and rock on `wavelength` [-]."""
    patches: Float[np.ndarray, "kind y x"] | None
    """Relative density of soil, litter, char and rock in the voxel columns; None: mixed alike."""
    terrain: Float[np.ndarray, "y x"] | None
    """Height of the ground in the voxel columns above the bottom of the grid [m]; None: level."""
    diffuse: Float[np.ndarray, " wavelength"] | None
    """A user's diffuse fraction instead of the clear-sky model."""
    dtype: str = eqx.field(static=True)

    @property
    def wavelength(self) -> Float[np.ndarray, " wavelength"]:
        """Grid of the spectra behind the bands [nm]."""
        return band_wavelengths(self.camera.bands)

    def counts(self, parameters: PlotParameters) -> Float[Array, " species"]:
        """Real number of plants of each species, eq. (10) without its ceiling [-]."""
        species = parameters.species
        packing = CrownPacking(
            species.packing,
            species.fill,
            jnp.asarray(self.branches),
            jnp.asarray(self.rotation_spread),
            jnp.asarray(self.minimum_area),
        )
        each = instance_area(species.diameter, species.height, packing)
        plot = float(np.prod(self.grid.extent[:2]))
        return soft_count(target_area(plot, species.cover), each, np.asarray(self.branches))

    def area_density(self, parameters: PlotParameters) -> Float[Array, "class z y x"]:
        """Area per volume of each optical class: the species' leaves, then wood, then flowers."""
        parameters = jax.tree.map(lambda x: jnp.asarray(x, self.dtype), parameters)
        species, planting = parameters.species, self.planting
        owner = planting.species
        weight = site_weight(
            self.counts(parameters).astype(self.dtype)[owner],
            planting.place,
            width=self.width,
            softness=self.softness,
        )
        diameter = species.diameter[owner] * planting.size
        height = species.height[owner] * planting.stature
        crown = weight * jnp.pi / 4.0 * diameter**2
        crown = crown / jnp.asarray(self.branches, self.dtype)[owner]
        leaf = crown * species.leaf_area_index[owner]
        bloom = np.array([FORM_DEFAULTS[form].flower_fraction for form in self.forms])
        flower = leaf * jnp.asarray(self.flowering * bloom, self.dtype)[owner]
        # Leaves of a shoot shade each other: this share of their area is seen from outside it.
        leaf = leaf * (1.0 - species.shoot_clumping)[owner]
        area = jnp.stack([leaf, crown * species.wood_area_index[owner], flower], axis=-1)
        plant = planting.plant
        foot = jnp.pad(ground_at(self, planting.foot)[:, None], ((0, 0), (2, 0)))
        return deposit(
            planting.site
            + foot[plant]
            + diameter[plant][:, None] * planting.per_diameter
            + height[plant][:, None] * planting.per_height,
            area[plant, planting.organ] * planting.fraction,
            planting.optical_class,
            self.grid,
            len(leafy_species(self.forms)) + 2,
            boundary=self.boundary,
        )

    def scene(self, parameters: PlotParameters) -> VoxelScene:
        """The voxel scene of `parameters`: what the radiation layer renders."""
        parameters = jax.tree.map(lambda x: jnp.asarray(x, self.dtype), parameters)
        average = jnp.asarray(self.camera.bands.weights(self.wavelength), self.dtype)
        classes = optical_classes(
            self.forms, parameters, average, self.wavelength, self.leaf_angles
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
            self.ground_map(parameters),
            Illumination(light.sun_zenith, light.sun_azimuth, 1.0 - sky, sky),
            self.grid.horizontal_size,
            self.grid.vertical_size,
            self.boundary,
            terrain=None if self.terrain is None else jnp.asarray(self.terrain, self.dtype),
        )

    def ground_map(self, parameters: PlotParameters) -> Float[Array, " band *yx"]:
        """Reflectance of the ground in the camera's bands [-]: of all of it, or of each voxel
        column where its covers lie in patches."""
        average = jnp.asarray(self.camera.bands.weights(self.wavelength), self.dtype)
        ground = parameters.ground
        fractions = jnp.stack([ground.litter_fraction, ground.char_fraction, ground.rock_fraction])
        fractions = fractions.astype(self.dtype)
        patches = np.ones((len(COVERS) + 1, 1, 1)) if self.patches is None else self.patches
        shares = ground_shares(fractions, jnp.asarray(patches, self.dtype))
        mixed = jnp.tensordot(average @ self.ground_spectra(parameters).T, shares, axes=1)
        mixed = jnp.clip(mixed, 0.0, 1.0)
        return mixed[:, 0, 0] if self.patches is None else mixed

    def ground_spectra(self, parameters: PlotParameters) -> Float[Array, "kind wavelength"]:
        """Reflectance of soil, litter, char and rock on `wavelength` [-]."""
        if self.soil is None:
            names = ("dry_soil", "wet_soil")
            soil = np.stack([background_spectrum(name, self.wavelength) for name in names])
        else:
            soil = self.soil
        dry, wet = jnp.asarray(soil, self.dtype)
        ground = parameters.ground
        mixed = ground.brightness * ((1 - ground.moisture) * dry + ground.moisture * wet)
        return jnp.concatenate([mixed[None], jnp.asarray(self.covers, self.dtype)])

    def image(self, parameters: PlotParameters, stride: int = 1) -> Float[Array, "band y x"]:
        """Reflectance factor of the camera's pixels over the plot [-], y to the north.

        `stride` renders every so many pixels along each axis: a fair sample of the image at a
        fraction of its cost. Differentiable in `parameters`.
        """
        light = solve_light(self.scene(parameters), self.accuracy)
        lx, ly, _ = self.grid.extent
        x, y = (
            (
                (jnp.arange(0, round(length / self.camera.pixel), stride) + 0.5) * self.camera.pixel
            ).astype(self.dtype)
            for length in (lx, ly)
        )
        rays = nadir_rays(x, y, self.camera.pixel, (lx / 2, ly / 2, self.camera.altitude))
        return reflectance_factor(light, rays)


def ground_at(model: PlotModel, foot: Float[Array, "plant 2"]) -> Float[Array, " plant"]:
    """Height of the ground under plants at `foot` [m]."""
    if model.terrain is None:
        return jnp.zeros(foot.shape[0], foot.dtype)
    ny, nx = model.terrain.shape
    at = jnp.floor(foot / model.grid.horizontal_size).astype(jnp.int32)
    heights = jnp.asarray(model.terrain, foot.dtype)
    return heights[jnp.clip(at[:, 1], 0, ny - 1), jnp.clip(at[:, 0], 0, nx - 1)]


def band_wavelengths(bands: BandSet) -> Float[np.ndarray, " wavelength"]:
    """A grid fine enough for the responses of `bands`, inside 400-2500 nm [nm]."""
    centre, width = np.asarray(bands.centre), np.asarray(bands.fwhm)
    low, high = (centre - 2.2 * width).min(), (centre + 2.2 * width).max()
    if bands.curves is not None:
        low = min(points[0] for points, _ in bands.curves)
        high = max(points[-1] for points, _ in bands.curves)
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
    boundary: Literal["periodic", "open"] = "periodic",
    branches: Sequence[float] | None = None,
    rotation_spread: Sequence[float] | None = None,
    minimum_area: Sequence[float] | None = None,
    plants: Sequence[PlantModel | None] | None = None,
    probability: Float[np.ndarray, "y x"] | None = None,
    room: float = 2.5,
    size_variation: float = 0.2,
    softness: float = 0.25,
    width: float = 1.0,
    flowering: float = 0.0,
    accuracy: Accuracy | None = None,
    soil: Float[np.ndarray, "2 wavelength"] | None = None,
    covers: Float[np.ndarray, "cover wavelength"] | None = None,
    patches: Float[np.ndarray, "kind y x"] | None = None,
    terrain: Float[np.ndarray, "y x"] | None = None,
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
    - `plants`: shape of the plants of each species, for instance of a mesh; None, or without any,
      that of its form. Their leaves then are inclined as the shape's.
    - `probability`: map of 0-255 over the plot, row 0 south, or none.
    - `softness`, `width`, `flowering`, `soil`, `covers`, `patches`, `terrain`, `diffuse`: see
      `PlotModel`;
      without them litter and char are the shipped spectra and rock is as the dry soil.

    Raises `InputError` where the plants do not fit.
    """
    count = len(taxa)
    species = parameters.species
    top = 1.1 * float(np.max(np.asarray(species.height)))
    if terrain is not None:
        top += float(np.max(terrain))
        camera = dataclasses.replace(camera, altitude=camera.altitude + float(np.mean(terrain)))
    grid = VoxelGrid.cover(extent, top, voxel)
    accuracy, layers = _fitting(DRONE if accuracy is None else accuracy, grid)
    if boundary == "open" and accuracy.margin is None:
        # Room for the sun to stand a little lower than it does.
        lowest = min(float(parameters.light.sun_zenith) + 5.0, 85.0)
        reach = float(np.ceil(layers * np.tan(np.deg2rad(lowest))))
        accuracy = dataclasses.replace(accuracy, margin=int(reach))
    spread = tuple(rotation_spread or [0.0] * count)
    shapes = tuple(plants or [None] * count)
    model = PlotModel(
        planting=no_plants(dtype),
        camera=camera,
        grid=VoxelGrid((*grid.shape[:2], layers), voxel, voxel),
        taxa=tuple(taxa),
        forms=tuple(forms),
        branches=tuple(branches or [1.0] * count),
        rotation_spread=spread,
        minimum_area=tuple(minimum_area or [0.0] * count),
        leaf_angles=tuple(None if p is None else inclination(p) for p in shapes),
        boundary=boundary,
        softness=softness,
        width=width,
        flowering=flowering,
        accuracy=accuracy,
        soil=soil,
        covers=shipped_covers(band_wavelengths(camera.bands)) if covers is None else covers,
        patches=patches,
        terrain=terrain,
        diffuse=diffuse,
        dtype=dtype,
    )
    planting = draw_planting(
        forms,
        np.asarray(model.counts(parameters)),
        np.asarray(species.diameter),
        np.asarray(species.height),
        spread,
        shapes,
        taxa=taxa,
        extent=extent,
        voxel=voxel,
        periodic=boundary == "periodic",
        probability=probability,
        room=room,
        size_variation=size_variation,
        seed=seed,
        dtype=dtype,
    )
    return eqx.tree_at(lambda m: m.planting, model, planting)


def replant(model: PlotModel, seed: int) -> PlotModel:
    """The same plot with other plants standing: each species fills its sites in another order.

    The sites held ready stay, and with them the pattern of a probability map.
    """
    planting = model.planting
    species, place = np.asarray(planting.species), np.array(planting.place)
    rng = np.random.default_rng([seed, 211])
    for one in np.unique(species):
        mine = species == one
        place[mine] = rng.permutation(place[mine])
    return eqx.tree_at(lambda m: m.planting.place, model, jnp.asarray(place, planting.place.dtype))


def _fitting(accuracy: Accuracy, grid: VoxelGrid) -> tuple[Accuracy, int]:
    """Coarsening that divides the plot's sides, and layers padded to a multiple of it."""
    nx, ny, nz = grid.shape
    high, wide = accuracy.coarsening or (2, 2)
    while nx % wide or ny % wide:
        wide -= 1
    layers = -(-nz // high) * high
    return dataclasses.replace(accuracy, coarsening=(high, wide)), layers

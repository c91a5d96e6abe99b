"""Views of a plot: the numbers that a sensor yields of it, differentiable.

A calibration compares a plot with measurements of several sensors. Each is a view, and the
statistics of all views make one vector.
"""

import abc
import dataclasses
from collections.abc import Callable, Sequence
from typing import Any, Self

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from fynjax.canopy import FORM_DEFAULTS, VoxelGrid, leaf_angle
from fynjax.inversion._log_posterior import jacobian_by_rows
from fynjax.metrics import STRUCTURE_METRICS, StructureSettings, image_statistics, voxel_structure
from fynjax.radiation import VoxelScene, parallel_rays, reflectance_factor, solve_light
from fynjax.scene import (
    Camera,
    PlotModel,
    PlotParameters,
    band_wavelengths,
    leafy_species,
    shipped_covers,
    with_values,
)
from fynjax.sensors import BandSet

SPECTRUM = "spectrum"
"""Statistics of a mean spectrum are called '<SPECTRUM>.<centre>nm'."""
LIDAR = "lidar"
"""Those of a cloud are called '<LIDAR>.<metric>'."""


class AbstractView(eqx.Module):
    """What one sensor yields of a plot."""

    names: eqx.AbstractVar[tuple[str, ...]]
    """Of the statistics."""

    @abc.abstractmethod
    def observe(
        self, model: PlotModel, parameters: PlotParameters
    ) -> tuple[Float[Array, "band y x"] | None, Float[Array, " statistic"]]:
        """The image, of a sensor that makes one, and the statistics. Differentiable."""

    @abc.abstractmethod
    def for_search(self, model: PlotModel, stride: int) -> Self:
        """A cheaper form of the view of `model`, for its coarser form; one of `stride` of a
        drone's pixels along each axis is rendered."""

    def predict(self, model: PlotModel, parameters: PlotParameters) -> Float[Array, " statistic"]:
        """The statistics. Differentiable in `parameters`."""
        return self.observe(model, parameters)[1]

    def jacobian(
        self, model: PlotModel, plot_at: Callable[[Array], PlotParameters], u: Float[Array, " free"]
    ) -> tuple[Float[Array, " statistic"], Float[Array, "statistic free"]]:
        """Statistics of the plot at `u`, and their derivatives."""
        return jacobian_by_rows(lambda u: self.predict(model, plot_at(u)).astype(u.dtype), u)


class ImageView(AbstractView):
    """Statistics of a drone's image (`image_statistics`), in the bands of the plot's camera."""

    names: tuple[str, ...] = eqx.field(static=True, converter=tuple)
    stride: int = eqx.field(static=True, default=1)
    """Every so many pixels are rendered."""

    def observe(
        self, model: PlotModel, parameters: PlotParameters
    ) -> tuple[Float[Array, "band y x"], Float[Array, " statistic"]]:
        image = model.image(parameters, self.stride)
        return image, image_statistics(image, self.names)

    def for_search(self, model: PlotModel, stride: int) -> "ImageView":
        return dataclasses.replace(self, stride=stride)


class SpectrumView(AbstractView):
    """Mean reflectance factor of a plot from straight above in the bands of a spectrometer.

    The light is solved for band by band, so that the derivatives of one band cost those of one
    band. `spectrum_view` makes one.
    """

    names: tuple[str, ...] = eqx.field(static=True)
    bands: BandSet = eqx.field(static=True)
    soil: Float[np.ndarray, "2 wavelength"] | None
    covers: Float[np.ndarray, "cover wavelength"]
    diffuse: Float[np.ndarray, " wavelength"] | None
    """As `PlotModel` has them, on the wavelengths of `bands`."""
    stride: int = eqx.field(static=True, default=1)
    """Every so many voxel columns are looked at."""

    def tuned(self, model: PlotModel) -> PlotModel:
        """The same plot, with the same plants, in the spectrometer's bands."""
        camera = Camera(self.bands, model.camera.altitude, model.camera.pixel)
        return dataclasses.replace(
            model, camera=camera, soil=self.soil, covers=self.covers, diffuse=self.diffuse
        )

    def observe(
        self, model: PlotModel, parameters: PlotParameters
    ) -> tuple[None, Float[Array, " statistic"]]:
        scene = self.tuned(model).scene(parameters)
        every = jnp.arange(len(self.bands))
        return None, jax.lax.map(lambda band: self._mean(model, scene, band), every)

    def for_search(self, model: PlotModel, stride: int) -> "SpectrumView":
        return dataclasses.replace(self, stride=_SEARCH_COLUMNS)

    def jacobian(
        self, model: PlotModel, plot_at: Callable[[Array], PlotParameters], u: Float[Array, " free"]
    ) -> tuple[Float[Array, " statistic"], Float[Array, "statistic free"]]:
        tuned = self.tuned(model)
        scene, backward = eqx.filter_vjp(lambda u: tuned.scene(plot_at(u)), u)

        def one(band: Array) -> tuple[Array, Array]:
            value, slope = eqx.filter_value_and_grad(lambda s: self._mean(model, s, band))(scene)
            return value.astype(u.dtype), backward(slope)[0]

        value, rows = jax.lax.map(one, jnp.arange(len(self.bands)))
        return value, rows

    def _mean(self, model: PlotModel, scene: VoxelScene, band: Array) -> Float[Array, ""]:
        light = solve_light(scene.bands(band, 1), model.accuracy)
        width, dtype = scene.horizontal, scene.area_density.dtype
        y, x = (
            ((jnp.arange(0, n, self.stride) + 0.5) * width).astype(dtype) for n in scene.shape[1:]
        )
        down = jnp.zeros((), dtype)
        return jnp.mean(reflectance_factor(light, parallel_rays(x, y, width, down, down)))


_SEARCH_COLUMNS = 3


def spectrum_view(
    bands: BandSet,
    *,
    soil: Float[np.ndarray, "2 wavelength"] | None = None,
    covers: Float[np.ndarray, "cover wavelength"] | None = None,
    diffuse: Float[np.ndarray, " wavelength"] | None = None,
) -> SpectrumView:
    """The view of a spectrometer with `bands`; the rest as `build_model` takes it.

    Spectra are on `fynjax.scene.band_wavelengths(bands)`.
    """
    own = shipped_covers(band_wavelengths(bands)) if covers is None else covers
    names = tuple(f"{SPECTRUM}.{centre:.10g}nm" for centre in bands.centre)
    return SpectrumView(names, bands, soil, own, diffuse)


class StructureView(AbstractView):
    """Structure metrics that a LiDAR from above is expected to see (`voxel_structure`).

    Means over the cells of the plot. What a leaf hides of a beam is by the inclination of its
    species' leaves. `structure_view` makes one.
    """

    names: tuple[str, ...] = eqx.field(static=True)
    settings: StructureSettings = eqx.field(static=True)
    grain: float = eqx.field(static=True)
    """Side of a cell [m]; whole canopy cells, and these whole voxels."""
    pulses: float = eqx.field(static=True)
    """[m-2]"""
    grid: VoxelGrid | None = None
    """Voxels instead of the model's: structure depends on their height, and needs no light."""

    def observe(
        self, model: PlotModel, parameters: PlotParameters
    ) -> tuple[None, Float[Array, " statistic"]]:
        if self.grid is not None:
            model = dataclasses.replace(model, grid=self.grid)
        density = model.area_density(parameters)
        projected = jnp.asarray(_projections(model), density.dtype) / _EVEN
        settings, top = self.settings, model.grid.extent[2]
        layers = int(np.ceil((top - settings.base) / settings.layer - 1e-9))
        terrain = None if model.terrain is None else jnp.asarray(model.terrain, density.dtype)
        found = voxel_structure(
            jnp.tensordot(projected, density, axes=1),
            settings,
            voxel=(model.grid.horizontal_size, model.grid.vertical_size),
            grain=self.grain,
            pulses=self.pulses,
            layers=max(layers, settings.first_layer(settings.lowest) + 1),
            projection=_EVEN,
            ground=terrain,
        ).means()
        return None, jnp.stack([found[name.split(".", 1)[1]] for name in self.names])

    def for_search(self, model: PlotModel, stride: int) -> "StructureView":
        return dataclasses.replace(self, grid=model.grid)


def structure_view(
    metrics: Sequence[str] = tuple(STRUCTURE_METRICS),
    settings: StructureSettings | None = None,
    *,
    grain: float = 2.0,
    pulses: float = 100.0,
) -> StructureView:
    """The view of a LiDAR: some of `STRUCTURE_METRICS`, in cells of `grain` [m], by `pulses` for
    each square metre [m-2]."""
    names = tuple(f"{LIDAR}.{metric}" for metric in metrics)
    return StructureView(names, settings or StructureSettings(), grain, pulses)


_EVEN = 0.5
"""Area projected over area of surfaces that face all directions alike [-]."""


def _projections(model: PlotModel) -> Float[Array, " class"]:
    """Area seen from above over area, of each optical class: leaves, then wood, then flowers."""
    found = []
    for i in leafy_species(model.forms):
        own = model.leaf_angles[i]
        angle = leaf_angle(FORM_DEFAULTS[model.forms[i]].leaf_angle) if own is None else own
        found.append(angle.projection(jnp.ones(())))
    return jnp.stack([*found, *(jnp.asarray(_EVEN),) * 2])


def look(
    views: Sequence[AbstractView], model: PlotModel, parameters: PlotParameters
) -> tuple[Array, ...]:
    """The statistics of all views, then the images of those that make one."""
    seen = [view.observe(model, parameters) for view in views]
    images = [image for image, _ in seen if image is not None]
    return joined([values.astype(float) for _, values in seen]), *images


def joined(parts: Sequence[Array]) -> Array:
    """Arrays one after the other."""
    return parts[0] if len(parts) == 1 else jnp.concatenate(parts)


class PlotForward:
    """The forward model of a plot: statistics from the values of the parameters that `free`
    names, in their own units, and a `PlotModel`. The others are those of `parameters`."""

    def __init__(
        self, parameters: PlotParameters, free: Sequence[str], views: Sequence[AbstractView]
    ) -> None:
        self._parameters, self._free, self._views = parameters, tuple(free), tuple(views)

    def __call__(self, values: Float[Array, " free"], model: PlotModel) -> Array:
        plot = self._plot(values, model)
        return joined([view.predict(model, plot).astype(values.dtype) for view in self._views])

    def jacobian(
        self, values_at: Callable[[Array], Array], u: Float[Array, " free"], model: PlotModel
    ) -> tuple[Float[Array, " statistic"], Float[Array, "statistic free"]]:
        """Statistics and their derivatives by `u`, of which `values_at` makes the values."""

        def plot_at(u: Array) -> PlotParameters:
            return self._plot(values_at(u), model)

        parts = [view.jacobian(model, plot_at, u) for view in self._views]
        return joined([value for value, _ in parts]), joined([rows for _, rows in parts])

    def _plot(self, values: Array, model: PlotModel) -> PlotParameters:
        named: dict[str, Any] = {name: values[i] for i, name in enumerate(self._free)}
        return with_values(self._parameters, model.taxa, named)

"""Views of a plot: the numbers that a sensor yields of it, differentiable.

A calibration compares a plot with measurements of several sensors. Each is a view, and the
statistics of all views make one vector.
"""

import abc
import dataclasses
import math
from collections.abc import Callable, Sequence
from contextlib import nullcontext
from pathlib import Path
from typing import Any, Self

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from fynjax._core.errors import in_file
from fynjax._core.programs import unfolded
from fynjax.canopy import VoxelGrid
from fynjax.inversion._log_posterior import jacobian_by_rows
from fynjax.metrics import image_statistics
from fynjax.metrics.structure import STRUCTURE_METRICS, StructureSettings
from fynjax.radiation import Accuracy, VoxelScene, solve_light
from fynjax.scene import (
    AimedSensor,
    Placement,
    PlotParameters,
    Scene,
    aim,
    scene_structure,
    with_values,
)
from fynjax.sensors import BandSet, Gains, OrthographicCamera, Sensor

SPECTRUM = "spectrum"
"""Statistics of a mean spectrum are called '<SPECTRUM>.<centre>nm'."""
LIDAR = "lidar"
"""Statistics of a cloud are called '<LIDAR>.<metric>'."""


def multiplied(
    image: Float[Array, "band y x"], log_factor: Float[Array, " band"] | None
) -> Float[Array, "band y x"]:
    """An image times factors of its bands, given by their logarithms; None: as it is."""
    if log_factor is None:
        return image
    return image * jnp.exp(log_factor).astype(image.dtype)[:, None, None]


FactorAt = Callable[[Array], Float[Array, " band"]]
"""Logarithms of the factors of a view's bands from the coordinates of a search."""


class AbstractView(eqx.Module):
    """What one sensor yields of a scene."""

    names: eqx.AbstractVar[tuple[str, ...]]
    """Name of each statistic, without that of the view."""

    @property
    def statistic_names(self) -> tuple[str, ...]:
        """Name of each statistic, behind the name of the view where it has one (`view`)."""
        view = getattr(self, "view", "")
        return tuple(f"{view}.{name}" for name in self.names) if view else self.names

    def named(self, view: str) -> Self:
        """The same under the name of a view, for which it has a field `view`."""
        known: Any = self
        return dataclasses.replace(known, view=view)

    @abc.abstractmethod
    def observe(
        self, scene: Scene, parameters: PlotParameters
    ) -> tuple[Float[Array, "band y x"] | None, Float[Array, " statistic"]]:
        """The image, or a spectrum as that of one pixel, and its statistics; of a sensor without
        bands None and the statistics. Differentiable."""

    @abc.abstractmethod
    def for_search(self, scene: Scene, accuracy: Accuracy, stride: int | None) -> Self:
        """The coarse form of the view, for a `scene` of thicker layers (`search_form`): light of
        `accuracy`, and of a drone's image every `stride`-th pixel along each axis, or those a voxel
        apart. `scene` is that of the full form."""

    def predict(
        self,
        scene: Scene,
        parameters: PlotParameters,
        log_factor: Float[Array, " band"] | None = None,
    ) -> Float[Array, " statistic"]:
        """The statistics, with factors of the bands, if it has any, given by their logarithms.
        Differentiable in `parameters` and `log_factor`."""
        return self.look(scene, parameters, log_factor)[1]

    def look(
        self,
        scene: Scene,
        parameters: PlotParameters,
        log_factor: Float[Array, " band"] | None = None,
    ) -> tuple[Float[Array, "band y x"] | None, Float[Array, " statistic"]]:
        """The image of a view with bands, else None, and the statistics with factors of these."""
        return None, self.observe(scene, parameters)[1]

    def jacobian(
        self,
        scene: Scene,
        plot_at: Callable[[Array], PlotParameters],
        u: Float[Array, " free"],
        factor_at: FactorAt | None = None,
    ) -> tuple[Float[Array, " statistic"], Float[Array, "statistic free"]]:
        """Statistics of the plot at `u`, with the factors of the bands there (`factor_at` gives
        their logarithms), and their derivatives."""
        return jacobian_by_rows(
            lambda u: self.predict(scene, plot_at(u), _factor(factor_at, u)).astype(u.dtype), u
        )


class BandView(AbstractView):
    """What a sensor with bands yields of a scene, each of which may be off by a factor."""

    @property
    @abc.abstractmethod
    def bands(self) -> BandSet:
        """The bands."""

    @property
    @abc.abstractmethod
    def gains(self) -> Gains:
        """What the gains of the `bands` may be off by."""

    @property
    def instrument(self) -> str:
        """Name of the camera, whose views share gains; "" of a sensor that shares none."""
        return ""

    @abc.abstractmethod
    def statistics(
        self, image: Float[Array, "band y x"], log_factor: Float[Array, " band"] | None = None
    ) -> Float[Array, " statistic"]:
        """The statistics of an image that `observe` made, times factors of its bands, given by
        their logarithms. Differentiable."""

    @property
    def factor_count(self) -> int:
        """Number of the factors of its bands."""
        return len(self.bands)

    def factor_slopes(
        self, image: Float[Array, "band y x"], log_factor: Float[Array, " band"] | None = None
    ) -> Float[Array, "statistic band"]:
        """Derivatives of the statistics of `image` by the logarithm of each band's factor, at the
        factors `log_factor`, one by default."""
        at = jnp.zeros(image.shape[0]) if log_factor is None else log_factor
        return jax.jacfwd(lambda log: self.statistics(image, log))(at.astype(image.dtype))

    def look(
        self,
        scene: Scene,
        parameters: PlotParameters,
        log_factor: Float[Array, " band"] | None = None,
    ) -> tuple[Float[Array, "band y x"] | None, Float[Array, " statistic"]]:
        image, plain = self.observe(scene, parameters)
        if image is None:
            raise TypeError(
                f"{type(self).__name__} has bands, but `observe` gives no image of them"
            )
        return image, plain if log_factor is None else self.statistics(image, log_factor)


def _factor(factor_at: FactorAt | None, u: Array) -> Array | None:
    return None if factor_at is None else factor_at(u)


class Directions(eqx.Module):
    """Combinations of statistics that tell most of the parameters, and of the factors of bands, so
    that derivatives need not be taken of every statistic."""

    rows: Float[Array, "direction statistic"]
    back: Float[Array, "statistic direction"]
    """Change of the statistics by a unit of each combination."""


_TOLD = 0.3
"""Least standard deviation of a factor's effect, over that with the errors, at which a direction is
kept for it: of what is known ten times as well beforehand a view tells nothing."""


def informative_directions(
    draws: Float[np.ndarray, "draw statistic"],
    covariance: Float[np.ndarray, "statistic statistic"],
    by_factors: Float[np.ndarray, "statistic factor"],
    most: int,
) -> Directions:
    """The directions of statistics in which draws of the prior spread most against the errors, and
    those that tell of the factors of bands.

    Where statistics are linear in the parameters these are the directions of most expected
    information; what the others hold is left out, which costs information and no truth. Those of
    the parameters avoid what factors change, so that by them alone gains would be at will.

    **Arguments:** `draws`, statistics of draws of the prior of the parameters; `covariance` of the
    errors, without factors; `by_factors`, what statistics change by a unit of each factor; `most`
    directions of the parameters, to which come those of the factors of which the statistics tell.
    """
    # Whitened by the errors, so that the leading singular vectors tell most against noise.
    root = np.linalg.cholesky(covariance + by_factors @ by_factors.T)
    of_factors, size, _ = np.linalg.svd(np.linalg.solve(root, by_factors), full_matrices=False)
    of_factors = of_factors[:, size > _TOLD]
    whitened = np.linalg.solve(root, (draws - draws.mean(axis=0)).T)
    whitened = whitened - of_factors @ (of_factors.T @ whitened)
    vectors, _, _ = np.linalg.svd(whitened, full_matrices=False)
    chosen, _ = np.linalg.qr(np.concatenate([of_factors, vectors[:, :most]], axis=1))
    # rows @ back is the identity; rows @ covariance @ rows.T too, with that by factors.
    rows = np.linalg.solve(root.T, chosen).T
    return Directions(jnp.asarray(rows), jnp.asarray(root @ chosen))


class ImagesView(BandView):
    """Statistics of images, whose slopes are those by the pixels times those of the pixels."""

    def along(self, directions: Directions) -> Self:
        """The view whose slopes are taken along directions."""
        changed: dict[str, Any] = {"directions": directions}
        return dataclasses.replace(self, **changed)

    @abc.abstractmethod
    def image(self, scene: Scene, parameters: PlotParameters) -> Float[Array, "*frame band y x"]:
        """Reflectance factor of the pixels [-]. Differentiable in `parameters`."""

    def observe(
        self, scene: Scene, parameters: PlotParameters
    ) -> tuple[Float[Array, "*frame band y x"], Float[Array, " statistic"]]:
        image = self.image(scene, parameters)
        return image, self.statistics(image)

    def jacobian(
        self,
        scene: Scene,
        plot_at: Callable[[Array], PlotParameters],
        u: Float[Array, " free"],
        factor_at: FactorAt | None = None,
    ) -> tuple[Float[Array, " statistic"], Float[Array, "statistic free"]]:
        # By the chain rule: statistics by pixels, which costs little, then pixels by parameters.
        image, to_parameters = jax.vjp(lambda u: self.image(scene, plot_at(u)), u)
        factor = _factor(factor_at, u)
        value, to_image = jax.vjp(lambda image: self.statistics(image, factor), image)
        known: Any = self
        chosen: Directions | None = known.directions
        rows = jnp.eye(value.size) if chosen is None else chosen.rows
        # All slopes by the image at once, so that the loop holds the renderer alone.
        by_image = jax.vmap(lambda row: to_image(row)[0])(rows.astype(value.dtype))
        slopes = jax.lax.map(lambda one: to_parameters(one)[0], by_image, batch_size=1)
        slopes = slopes.astype(u.dtype)
        if factor_at is not None:  # of the image that there is: no render
            by_factor = self.factor_slopes(image, factor).astype(u.dtype)
            slopes = slopes + rows.astype(u.dtype) @ by_factor @ jax.jacfwd(factor_at)(u)
        return value.astype(u.dtype), slopes if chosen is None else chosen.back @ slopes


class ImageView(ImagesView):
    """Statistics of a drone's image (`image_statistics`)."""

    names: tuple[str, ...] = eqx.field(static=True, converter=tuple)
    camera: AimedSensor
    """The drone's camera over the scene, from `aim`; of bands those that the statistics and the
    indices need."""
    gains: Gains = eqx.field(static=True, default=Gains(0.0))
    """Errors of the gains of the camera's bands; by default none."""
    spacing: float | None = eqx.field(static=True, default=None)
    """Distance of neighbouring pixels [m]; None: their edge."""
    window: float | None = eqx.field(static=True, default=None)
    """Share of the pixels that a quantile is the mean of, as `image_statistics` has it [-]."""
    directions: Directions | None = None
    """Combinations of the statistics along which slopes are taken; None: every statistic."""
    view: str = eqx.field(static=True, default="")
    """Name of the view, where there are several."""
    sun: tuple[float, float] | None = eqx.field(static=True, default=None)
    """Zenith and azimuth of the sun [degrees]; None: those of the parameters."""

    @property
    def bands(self) -> BandSet:
        return self.camera.sensor.bands

    @property
    def instrument(self) -> str:
        return self.camera.sensor.name

    def image(self, scene: Scene, parameters: PlotParameters) -> Float[Array, "band y x"]:
        return self.camera.observe(scene, under_sun(parameters, self.sun)).reflectance

    def statistics(
        self, image: Float[Array, "band y x"], log_factor: Float[Array, " band"] | None = None
    ) -> Float[Array, " statistic"]:
        image = multiplied(image, log_factor)
        pixel = self.camera.pixel if self.spacing is None else self.spacing
        bands = self.camera.sensor.bands
        return image_statistics(
            image, self.names, self.camera.seen, pixel=pixel, window=self.window, bands=bands
        )

    def for_search(self, scene: Scene, accuracy: Accuracy, stride: int | None) -> Self:
        if stride is None:
            stride = max(round(scene.grid.horizontal_size / self.camera.pixel), 1)
        camera = dataclasses.replace(self.camera.sampled(stride), accuracy=accuracy)
        # The distance of the pixels that are left, by which squares of several are made.
        every = camera.pixel * (stride if camera.fine is None else 1)
        return dataclasses.replace(self, camera=camera, spacing=every, window=_WINDOW)


_AT_ONCE = 4
"""Coordinates whose slopes are computed together, which share the light: memory grows with them."""


class FlightView(ImagesView):
    """Frames under one sun, whose plants and light are computed once; what grows with their number
    is their rays. `together` makes them of views, whose statistics and factors it has one view
    after the other."""

    names: tuple[str, ...] = eqx.field(static=True)
    frames: tuple[ImageView, ...]
    directions: Directions | None = None

    @property
    def bands(self) -> BandSet:
        return self.frames[0].bands

    @property
    def gains(self) -> Gains:
        return self.frames[0].gains

    @property
    def factor_count(self) -> int:
        return len(self.frames) * len(self.bands)

    def image(self, scene: Scene, parameters: PlotParameters) -> Float[Array, "frame band y x"]:
        first = self.frames[0]
        own = jax.tree.map(lambda x: jnp.asarray(x, scene.dtype), parameters)
        voxels = unfolded(scene.voxels(under_sun(own, first.sun), first.bands))
        light = solve_light(voxels, first.camera.accuracy)
        images: list[Array] = [jnp.zeros(0)] * len(self.frames)
        # Few programs serve all frames where their steepest rays count in whole steps.
        every = [
            dataclasses.replace(c, steepest=_STEEP * math.ceil(c.steepest / _STEEP - 1e-6))
            for c in (frame.camera for frame in self.frames)
        ]
        for places in _alike(every):
            cameras = [every[i] for i in places]
            still = eqx.filter(cameras[0], eqx.is_array, inverse=True)
            arrays = [eqx.filter(camera, eqx.is_array) for camera in cameras]
            stacked = jax.tree.map(lambda *leaves: jnp.stack(leaves), *arrays)

            # What a frame needs for its slope is computed again, lest memory grow with frames.
            @jax.checkpoint
            def seen(own: Any, still: Any = still) -> Array:
                return eqx.combine(own, still).lit(light, voxels)[0]

            for i, image in zip(places, jax.lax.map(seen, unfolded(stacked)), strict=True):
                images[i] = image
        return jnp.stack(images)

    def statistics(
        self,
        image: Float[Array, "frame band y x"],
        log_factor: Float[Array, " factor"] | None = None,
    ) -> Float[Array, " statistic"]:
        first = self.frames[0]
        seen = jnp.stack([jnp.asarray(frame.camera.seen) for frame in self.frames])
        each = jnp.zeros((len(self.frames), len(self.bands)), image.dtype)
        if log_factor is not None:
            each = log_factor.reshape(each.shape).astype(image.dtype)

        def of_one(image: Array, seen: Array, log: Array) -> Array:
            camera = dataclasses.replace(first.camera, seen=seen)
            return dataclasses.replace(first, camera=camera).statistics(image, log)

        return jax.vmap(of_one)(image, seen, each).ravel()

    def jacobian(
        self,
        scene: Scene,
        plot_at: Callable[[Array], PlotParameters],
        u: Float[Array, " free"],
        factor_at: FactorAt | None = None,
    ) -> tuple[Float[Array, " statistic"], Float[Array, "statistic free"]]:
        if self.directions is not None or u.size >= len(self.names):
            return super().jacobian(scene, plot_at, u, factor_at)
        factor = _factor(factor_at, u)

        # Frames have more statistics than there are coordinates: a pass forward for each of these.
        def along(way: Array) -> tuple[Array, tuple[Array, Array]]:
            image, moved = jax.jvp(lambda u: self.image(scene, plot_at(u)), (u,), (way,))
            return image, jax.jvp(lambda image: self.statistics(image, factor), (image,), (moved,))

        every = jnp.eye(u.size, dtype=u.dtype)
        images, (values, columns) = jax.lax.map(along, every, batch_size=_AT_ONCE)
        slopes = columns.T.astype(u.dtype)
        if factor_at is not None:  # of the image that there is: no render
            by_factor = self.factor_slopes(images[0], factor).astype(u.dtype)
            slopes = slopes + by_factor @ jax.jacfwd(factor_at)(u)
        return values[0].astype(u.dtype), slopes

    def for_search(self, scene: Scene, accuracy: Accuracy, stride: int | None) -> "FlightView":
        frames = tuple(frame.for_search(scene, accuracy, stride) for frame in self.frames)
        return dataclasses.replace(self, frames=frames)


class BlendView(ImageView):
    """Statistics of a mosaic whose pixels are means over the frames that saw them."""

    frames: tuple[ImageView, ...] = ()
    """Views of these; `camera` has the pixels of the mosaic."""

    def image(self, scene: Scene, parameters: PlotParameters) -> Float[Array, "band y x"]:
        images = FlightView((), self.frames).image(scene, parameters)
        seen = jnp.stack([jnp.asarray(frame.camera.seen) for frame in self.frames])[:, None]
        total = jnp.sum(jnp.where(seen, images, 0.0), axis=0)
        return total / jnp.maximum(jnp.sum(seen, axis=0), 1)

    def for_search(self, scene: Scene, accuracy: Accuracy, stride: int | None) -> "BlendView":
        frames = tuple(frame.for_search(scene, accuracy, stride) for frame in self.frames)
        return dataclasses.replace(super().for_search(scene, accuracy, stride), frames=frames)


def together(views: Sequence[AbstractView]) -> tuple[AbstractView, ...]:
    """The same views, in their order, those of frames that share sun and light as one."""
    groups: list[list[AbstractView]] = []
    for view in views:
        if groups and isinstance(view, ImageView) and _share_light(groups[-1][0], view):
            groups[-1].append(view)
        else:
            groups.append([view])
    return tuple(
        group[0]
        if len(group) == 1
        else FlightView(
            tuple(name for view in group for name in view.statistic_names),
            tuple(view for view in group if isinstance(view, ImageView)),
        )
        for group in groups
    )


def _share_light(one: AbstractView, other: ImageView) -> bool:
    def shared(view: ImageView) -> tuple[Any, ...]:
        camera = view.camera
        same = camera.accuracy, camera.pixel, camera.shape, camera.origin, view.bands
        return (view.names, view.sun, view.spacing, view.window, camera.sensor.name, *same)

    if type(one) is not ImageView or type(other) is not ImageView or one.directions is not None:
        return False
    bare = all(v.camera.air is None and v.camera.panels is None for v in (one, other))
    framed = one.camera.seen is not None and other.camera.seen is not None
    return bare and framed and shared(one) == shared(other)


def _alike(cameras: Sequence[AimedSensor]) -> list[list[int]]:
    """Places of cameras that differ in numbers alone, which one program serves."""
    groups: list[tuple[AimedSensor, list[int]]] = []
    for i, camera in enumerate(cameras):
        for first, places in groups:
            shapes = [[np.shape(x) for x in jax.tree.leaves(one)] for one in (first, camera)]
            forms = [str(jax.tree.structure(one)) for one in (first, camera)]
            if forms[0] == forms[1] and shapes[0] == shapes[1]:
                places.append(i)
                break
        else:
            groups.append((camera, [i]))
    return [places for _, places in groups]


class ImageSight(eqx.Module):
    """How a drone's camera sees any scene of a plot: its view of one, when that is there."""

    names: tuple[str, ...] = eqx.field(static=True, converter=tuple)
    """Statistics of its image."""
    sensor: Sensor
    """The camera, of bands that the statistics and the indices need."""
    placement: Placement
    """Where it looks from, and its pixels on the ground."""
    gains: Gains = eqx.field(static=True)
    """Errors of the gains of its bands."""
    point_spread: bool = eqx.field(static=True, default=True)
    """Whether its optics blur."""
    file: Path | None = eqx.field(static=True, default=None)
    """File that says so, which errors name."""
    sun: tuple[float, float] | None = eqx.field(static=True, default=None)
    """Zenith and azimuth of the sun [degrees]; None: those of the parameters."""
    mask: Bool[Array, "y x"] | None = None
    """Pixels that count, of those in the frame of a known pose; None: all."""
    blended: bool = eqx.field(static=True, default=False)
    """Whether the pixels of a mosaic are means over the frames that saw them, and not what the
    nearest camera saw."""

    def __call__(self, scene: Scene, parameters: PlotParameters) -> ImageView:
        """The view of a scene. **Raises:** `InputError` as `fynjax.scene.aim`."""
        parameters, frame = under_sun(parameters, self.sun), self.placement.frame
        with in_file(self.file) if self.file is not None else nullcontext():
            aimed = aim(
                scene, parameters, self.sensor, self.placement, point_spread=self.point_spread
            )
            aimed.check(parameters)
            if self.blended and frame is not None and frame.mosaic:
                own = dataclasses.replace(self, blended=False)
                frames = [
                    dataclasses.replace(own, placement=Placement(pixel=aimed.pixel, frame=one))
                    for one in frame.mosaic
                ]
                each = tuple(one(scene, parameters) for one in frames)
                return BlendView(self.names, aimed, self.gains, sun=self.sun, frames=each)
        if self.mask is not None and aimed.seen is not None:
            aimed = dataclasses.replace(aimed, seen=aimed.seen & self.mask)
        return ImageView(self.names, aimed, self.gains, sun=self.sun)


class SpectrumSight(eqx.Module):
    """How a spectrometer sees any scene of a plot from straight above."""

    bands: BandSet
    gains: Gains = eqx.field(static=True)
    sun: tuple[float, float] | None = eqx.field(static=True, default=None)
    """Zenith and azimuth of the sun [degrees]; None: those of the parameters."""

    def __call__(self, scene: Scene, parameters: PlotParameters) -> "SpectrumView":
        """The view of a scene."""
        parameters = under_sun(parameters, self.sun)
        view = spectrum_view(self.bands, scene, parameters, gains=self.gains)
        return dataclasses.replace(view, sun=self.sun)


class SpectrumView(BandView):
    """Mean reflectance factor of a scene from straight above in the bands of a spectrometer.

    The light is solved for few bands at once, which share what depends on plants alone; memory
    does not grow with the number of bands. `spectrum_view` makes one.
    """

    names: tuple[str, ...] = eqx.field(static=True)
    imager: AimedSensor
    """Looks straight down, a pixel a voxel column."""
    gains: Gains = eqx.field(static=True, default=Gains(0.0))
    """Errors of the gains of the bands; by default none."""
    view: str = eqx.field(static=True, default="")
    """Name of the view, where there are several."""
    sun: tuple[float, float] | None = eqx.field(static=True, default=None)
    """Zenith and azimuth of the sun [degrees]; None: those of the parameters."""

    @property
    def bands(self) -> BandSet:
        return self.imager.sensor.bands

    def observe(
        self, scene: Scene, parameters: PlotParameters
    ) -> tuple[Float[Array, "band 1 1"], Float[Array, " statistic"]]:
        image = _mean_spectrum(scene, parameters, self)[:, None, None]
        return image, self.statistics(image)

    def statistics(
        self, image: Float[Array, "band y x"], log_factor: Float[Array, " band"] | None = None
    ) -> Float[Array, " statistic"]:
        return multiplied(image, log_factor)[:, 0, 0]

    def for_search(self, scene: Scene, accuracy: Accuracy, stride: int | None) -> "SpectrumView":
        imager = dataclasses.replace(self.imager.sampled(_SEARCH_COLUMNS), accuracy=accuracy)
        return dataclasses.replace(self, imager=imager)

    def jacobian(
        self,
        scene: Scene,
        plot_at: Callable[[Array], PlotParameters],
        u: Float[Array, " free"],
        factor_at: FactorAt | None = None,
    ) -> tuple[Float[Array, " statistic"], Float[Array, "statistic free"]]:
        bands = self.imager.sensor.bands
        # Voxels by the parameters once, for all bands; then the light by the voxels, whose slopes
        # of one band cost those of one band.
        voxels, backward = eqx.filter_vjp(
            lambda u: scene.voxels(under_sun(plot_at(u), self.sun), bands), u
        )

        def of_group(first: Array) -> tuple[Array, Array]:
            def mean(voxels: VoxelScene, band: Array) -> Array:
                return self._means(voxels, first + band, 1)[0]

            members = jnp.arange(self._together)
            slope = jax.vmap(eqx.filter_value_and_grad(mean), in_axes=(None, 0))
            value, by_voxels = slope(voxels, members)
            return value, jax.lax.map(lambda one: backward(one)[0], by_voxels)

        value, rows = map(self._by_band, jax.lax.map(of_group, self._firsts))
        value = value.astype(u.dtype)
        if factor_at is None:
            return value, rows
        factor = jnp.exp(factor_at(u))
        value = value * factor
        return value, factor[:, None] * rows + value[:, None] * jax.jacfwd(factor_at)(u)

    @property
    def _together(self) -> int:
        """Bands whose light is solved for at once."""
        count = len(self.bands)
        return -(-count // -(-count // _TOGETHER))

    @property
    def _firsts(self) -> Int[np.ndarray, " group"]:
        """The first band of each group; the last group may repeat bands of the one before."""
        count, together = len(self.bands), self._together
        return np.minimum(np.arange(0, count, together), count - together)

    def _by_band(self, groups: Float[Array, "group band ..."]) -> Float[Array, "bands ..."]:
        """What was computed group by group, each band once."""
        group = np.arange(len(self.bands)) // self._together
        return groups[group, np.arange(len(self.bands)) - self._firsts[group]]

    def _means(self, voxels: VoxelScene, first: Array, number: int) -> Float[Array, " band"]:
        return self.imager.image(voxels.bands(first, number))[1]


def _mean_spectrum(
    scene: Scene, parameters: PlotParameters, view: SpectrumView
) -> Float[Array, " band"]:
    voxels = scene.voxels(under_sun(parameters, view.sun), view.imager.sensor.bands)
    groups = jax.lax.map(lambda first: view._means(voxels, first, view._together), view._firsts)
    return view._by_band(groups)


_STEEP = 15.0
"""Step of the zenith angles that no ray of some frames exceeds [degrees]."""
_TOGETHER = 6
"""Bands of a spectrum whose light is solved for at once, at most: a 10 m plot in a third of the
time of band by band; with twice as many it is a little less, of twice the memory."""
_WINDOW = 0.05
"""Width of the window over which a search smooths quantiles, as a share of all values [-]."""
_SEARCH_COLUMNS = 3
"""Every so many voxel columns are looked at in a search."""


def under_sun(parameters: PlotParameters, sun: tuple[float, float] | None) -> PlotParameters:
    """The parameters under a sun of this zenith and azimuth [degrees]; None: as they are."""
    if sun is None:
        return parameters
    light = parameters.light
    zenith = jnp.asarray(sun[0], jnp.asarray(light.sun_zenith).dtype)
    azimuth = jnp.asarray(sun[1] % 360.0, jnp.asarray(light.sun_azimuth).dtype)
    light = dataclasses.replace(light, sun_zenith=zenith, sun_azimuth=azimuth)
    return dataclasses.replace(parameters, light=light)


def spectrum_names(bands: BandSet) -> tuple[str, ...]:
    """Names of the statistics of a mean spectrum in `bands`, such as "spectrum.550nm"."""
    return tuple(f"{SPECTRUM}.{centre:.10g}nm" for centre in bands.centre)


def nadir_imager(
    bands: BandSet, scene: Scene, parameters: PlotParameters, accuracy: Accuracy | None = None
) -> AimedSensor:
    """A sensor that looks straight down on a plot, a pixel a voxel column.

    **Arguments:**

    - `bands`: of the sensor.
    - `scene`, `parameters`: the plot.
    - `accuracy`: of the light; as `aim` has it by default.

    **Returns:** `AimedSensor`.
    """
    sensor = Sensor("nadir", bands, OrthographicCamera(scene.grid.horizontal_size))
    return aim(scene, parameters, sensor, accuracy=accuracy)


def spectrum_view(
    bands: BandSet,
    scene: Scene,
    parameters: PlotParameters,
    accuracy: Accuracy | None = None,
    *,
    gains: Gains | None = None,
) -> SpectrumView:
    """The view that a spectrometer has of a plot from straight above: its mean spectrum.

    **Arguments:**

    - `bands`: of the spectrometer.
    - `scene`, `parameters`: the plot.
    - `accuracy`: of the light; as `aim` has it by default.
    - `gains`: what the gains of the bands may be off by; none by default.

    **Returns:** `SpectrumView`.
    """
    imager = nadir_imager(bands, scene, parameters, accuracy)
    return SpectrumView(spectrum_names(bands), imager, Gains(0.0) if gains is None else gains)


class StructureSight(eqx.Module):
    """How a LiDAR sees any scene of a plot."""

    seen: "StructureView"

    def __call__(self, scene: Scene, parameters: PlotParameters) -> "StructureView":
        """The view of a scene."""
        return self.seen


class StructureView(AbstractView):
    """Structure metrics that a LiDAR from above is expected to measure (`scene_structure`).

    `structure_view` makes one.
    """

    names: tuple[str, ...] = eqx.field(static=True)
    settings: StructureSettings = eqx.field(static=True)
    grain: float = eqx.field(static=True)
    """Side of a cell [m]; whole canopy cells, and these whole voxels."""
    pulses: float = eqx.field(static=True)
    """[m-2]"""
    grid: VoxelGrid | None = None
    """Voxels instead of the scene's: structure depends on their height, and needs no light."""
    view: str = eqx.field(static=True, default="")
    """Name of the view, where there are several."""

    def observe(
        self, scene: Scene, parameters: PlotParameters
    ) -> tuple[None, Float[Array, " statistic"]]:
        names = [name.split(".", 1)[1] for name in self.names]
        return None, scene_structure(
            scene, parameters, names, self.settings,
            grain=self.grain, pulses=self.pulses, grid=self.grid,
        )  # fmt: skip

    def for_search(self, scene: Scene, accuracy: Accuracy, stride: int | None) -> "StructureView":
        return dataclasses.replace(self, grid=scene.grid)


def structure_view(
    metrics: Sequence[str] = tuple(STRUCTURE_METRICS),
    settings: StructureSettings | None = None,
    *,
    grain: float = 2.0,
    pulses: float = 100.0,
) -> StructureView:
    """The view that a LiDAR has of a plot: metrics of its structure.

    **Arguments:**

    - `metrics`: some of `STRUCTURE_METRICS`.
    - `settings`: what the metrics are; the defaults of `StructureSettings` if left out.
    - `grain`: side of a cell [m]; whole canopy cells, and these whole voxels.
    - `pulses`: for each square metre [m-2].

    **Returns:** `StructureView`.
    """
    names = tuple(f"{LIDAR}.{metric}" for metric in metrics)
    return StructureView(names, settings or StructureSettings(), grain, pulses)


@eqx.filter_jit
def look(
    views: Sequence[AbstractView],
    scene: Scene,
    parameters: PlotParameters,
    log_factors: Float[Array, " factor"] | None = None,
) -> tuple[Array, ...]:
    """The statistics of all views, then the images, without factors, of those that make one.

    **Arguments:** `views` of a `scene` with `parameters`; `log_factors`, logarithms of the factors
    of the bands of all views, one after the other; all one by default. Differentiable in these.
    """
    shared = together(views)
    parts = factors_by_view(shared, log_factors)
    observed = [view.look(scene, parameters, own) for view, own in zip(shared, parts, strict=True)]
    images = [
        one
        for image, _ in observed
        if image is not None
        for one in (image if image.ndim == 4 else (image,))
    ]
    return joined([values.astype(float) for _, values in observed]), *images


def factors_by_view(
    views: Sequence[AbstractView], log_factors: Float[Array, " factor"] | None
) -> list[Float[Array, " _band"] | None]:
    """The factors of each view, of those of all; None of a view without any.

    **Arguments:**

    - `views`: some of which have bands.
    - `log_factors`: logarithms of the factors of all bands, view by view [-]; None: none of any.
    """
    if log_factors is None:
        return [None] * len(views)
    sizes = [view.factor_count if isinstance(view, BandView) else 0 for view in views]
    ends = np.cumsum(sizes)
    return [log_factors[end - n : end] if n else None for n, end in zip(sizes, ends)]


def joined(parts: Sequence[Array]) -> Array:
    """Arrays one after the other."""
    return parts[0] if len(parts) == 1 else jnp.concatenate(parts)


def _of_fixed_type(parameters: PlotParameters) -> PlotParameters:
    """The same with types that JAX does not promote: a Python number's array would be another
    program than one that was computed."""
    return jax.tree.map(lambda x: jnp.asarray(x, jnp.asarray(x).dtype), parameters)


class PlotForward(eqx.Module):
    """The forward model of a plot: statistics from the values of the parameters that `free`
    names, in their own units, and a `Scene`. The others are those of `parameters`. Logarithms of
    the factors of the bands of all views may follow the values (`look`)."""

    parameters: PlotParameters = eqx.field(converter=_of_fixed_type)
    free: tuple[str, ...] = eqx.field(static=True, converter=tuple)
    views: tuple[AbstractView, ...] = eqx.field(converter=tuple)

    def __call__(self, values: Float[Array, " value"], scene: Scene) -> Array:
        plot = self._plot(values, scene)
        parts = zip(self.views, self._factors(values), strict=True)
        return joined([v.predict(scene, plot, own).astype(values.dtype) for v, own in parts])

    def jacobian(
        self, values_at: Callable[[Array], Array], u: Float[Array, " coordinate"], scene: Scene
    ) -> tuple[Float[Array, " statistic"], Float[Array, "statistic coordinate"]]:
        """Statistics and their derivatives by `u`, of which `values_at` makes the values."""

        def plot_at(u: Array) -> PlotParameters:
            return self._plot(values_at(u), scene)

        def factors_of(number: int) -> FactorAt | None:
            if self._factors(values_at(u))[number] is None:
                return None
            return lambda u: jnp.asarray(self._factors(values_at(u))[number])

        parts = [
            view.jacobian(scene, plot_at, u, factors_of(i)) for i, view in enumerate(self.views)
        ]
        return joined([value for value, _ in parts]), joined([rows for _, rows in parts])

    def _factors(self, values: Array) -> list[Array | None]:
        given = values[len(self.free) :]
        return factors_by_view(self.views, given if given.size else None)

    def _plot(self, values: Array, scene: Scene) -> PlotParameters:
        named: dict[str, Any] = {name: values[i] for i, name in enumerate(self.free)}
        return with_values(self.parameters, scene.taxa, named)

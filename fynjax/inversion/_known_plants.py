"""Calibrate a plot whose plants are known to an image, pixel by pixel.

Nothing of the plants is chance, so that each pixel says what stands in it. Pixels are many and
parameters few: slopes are taken forward, a direction at a time. Bands scatter apart, so that one
direction serves all of them: slopes by the reflectance and by the transmittance of each class and
by the ground's reflectance, chained with the derivatives of these by the traits, serve every
parameter that acts through optics alone.
"""

import time
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import scipy.sparse
from jaxtyping import Array, Bool, Float
from scipy.stats import chi2

from fynjax._core.errors import InputError
from fynjax._core.precision import require_double_precision
from fynjax.inversion._calibrate import Ends
from fynjax.inversion._descent import Descended, descend, objective_of
from fynjax.inversion._fit_result import Data, FitResult, FitStatus, fit_result
from fynjax.inversion._space import ParameterSpace
from fynjax.inversion._views import gain_covariance
from fynjax.radiation import VoxelScene
from fynjax.scene import AimedSensor, PlotParameters, Scene, with_values

PIXEL_SD = 0.05
"""What the model's pixel is off by, as a share of it [-]: against a path tracer 1 to 2 % where both
have the same voxels of 10 cm, and where leaves are single ones the spread of pixels of 2.5 cm is 5
to 8 % less (`python -m tests.benchmarks.table_radiation --only head-to-head plants`)."""
MOST_VALUES = 40_000
"""Values of an image that are compared, at most, unless a block is asked for."""
_DARKEST = 0.002
"""Reflectance below which the error of a pixel is that of this one [-]."""
_ROUNDS = 4
"""Slopes are computed anew so many times at most."""


def block_of(bands: int, shape: tuple[int, int]) -> int:
    """Pixels along the edge of the blocks whose means are compared: as many as make at most
    `MOST_VALUES` values of `bands` of an image of `shape`."""
    block = 1
    while bands * (shape[0] // block) * (shape[1] // block) > MOST_VALUES:
        block += 1
    return block


class KnownPlants(eqx.Module):
    """A plot calibrated to an image, pixel by pixel."""

    scene: Scene
    camera: AimedSensor
    block: int = eqx.field(static=True)
    """Pixels along the edge of the blocks whose means are compared."""
    fit: FitResult
    """Its data are the compared values, band by band; its sd are those of pixels and model."""
    before: PlotParameters
    after: PlotParameters
    measured: Float[np.ndarray, "band y x"]
    """Means of blocks; NaN where they are not compared."""
    image_before: Float[np.ndarray, "band y x"]
    image_after: Float[np.ndarray, "band y x"]
    """As the camera measures it with the estimated gains."""
    gain: Float[np.ndarray, " band"]
    """By what factor each band of the camera is off [-]: what simulated bands are multiplied by."""
    gain_sd: Float[np.ndarray, " band"]
    """Standard deviation of its logarithm [-]."""
    misfit: float
    """Squared whitened misfit and distance from the prior, at the estimate: of data that the model
    and the prior explain a chi-square of `degrees`."""
    seconds: dict[str, float]
    """Wall time of an image, of the slopes and of the whole search, compilation included [s]."""

    @property
    def data(self) -> Data:
        return self.fit.data

    @property
    def degrees(self) -> int:
        """Values that the likelihood counts."""
        return len(self.fit.data.names)

    @property
    def probability(self) -> float:
        """That the model and its prior would give data so far from its expectation [-]."""
        return float(chi2.sf(self.misfit, self.degrees))

    @property
    def ends(self) -> Ends:
        """The search has one start."""
        u = np.asarray(self.fit.whitened)[None]
        return Ends(np.array([0.5 * self.misfit]), u, np.zeros(1), 1)


def calibrate_known_plants(
    scene: Scene,
    parameters: PlotParameters,
    image: Float[np.ndarray, "band row column"],
    space: ParameterSpace,
    camera: AimedSensor,
    *,
    block: int | None = None,
    pixel_sd: float = PIXEL_SD,
    gain_sd: float = 0.05,
    max_steps: int = 30,
    tolerance: float = 0.05,
    report: Callable[[str, float, float], None] | None = None,
) -> KnownPlants:
    """Calibrate the free parameters of a plot whose plants are known to an image of it.

    Every compared value, the mean of a block of pixels in one band, has an error of its own. The
    gains of the bands are estimated beside the parameters, with a normal prior of their logarithms.
    The search is that of `calibrate_plot` (Levenberg-Marquardt whose slopes each step corrects), on
    the whole scene at the camera's own accuracy; slopes are computed anew, and errors renewed by
    the simulated image, until these would lower the objective no more.

    **Arguments:**

    - `scene`, `parameters`: the plot, with `Scene.known_plants`.
    - `image`: reflectance factor [-], rows from the south, as `camera` has them; a pixel that is
      NaN in any band is not compared.
    - `space`: the free parameters with their priors (`free_space`).
    - `camera`: from `aim`, without air.
    - `block`: pixels along the edge of the blocks whose means are compared, at least 1; `block_of`
      by default. Rows and columns beyond the last whole block are not compared.
    - `pixel_sd`: error of a block's mean, of camera and model, as a share of it [-], positive.
      Errors of different blocks and bands are independent: give errors that hang together over the
      plot to the gains, or widen this.
    - `gain_sd`: what a band's calibration may be off by, as a factor [-], positive; half of its
      variance is common to all bands.
    - `max_steps`: most steps between two computations of the slopes.
    - `tolerance`: the search ends where another step would lower the objective by less than this,
      half a squared distance in posterior standard deviations.
    - `report`: called with the stage, the objective and its gradient's norm.

    **Returns:** `KnownPlants`.

    **Raises:** `InputError` for an image of another shape or without a whole block of pixels, a
    `block` or error that is not positive, plants that are not known, and where JAX is limited to 32
    bits.

    Not differentiable.
    """
    require_double_precision("`calibrate_known_plants`")
    bands = len(camera.sensor.bands)
    if np.shape(image) != (bands, *camera.shape):
        raise InputError(
            f"expected an image of {bands} bands, {camera.shape[0]} rows and {camera.shape[1]} "
            f"columns, as the camera's, but got one of shape {np.shape(image)}"
        )
    if not scene.known_plants:
        raise InputError(
            "expected a plot whose plants are known (`crowns`): where plants stand by "
            "chance no pixel says what stands in it"
        )
    block = block_of(bands, camera.shape) if block is None else block
    if block < 1 or not pixel_sd > 0.0 or not gain_sd > 0.0:
        raise InputError(
            f"`block`, `pixel_sd` and `gain_sd` must be positive, but are {block}, {pixel_sd:g} "
            f"and {gain_sd:g}"
        )
    measured = np.asarray(_blocks(jnp.asarray(np.asarray(image, float)), block))
    compared = np.isfinite(measured).all(axis=0)
    if not compared.any():
        raise InputError(f"no block of {block} x {block} pixels of the image has all its values")
    model = PixelModel(scene, parameters, space.names, camera, block)
    search = _Search(model, space, measured, compared, pixel_sd, gain_sd, report)
    return search.run(max_steps, tolerance)


class PixelModel(eqx.Module):
    """Blocks of pixels of a scene, from the values of free parameters in their own units."""

    scene: Scene
    parameters: PlotParameters
    free: tuple[str, ...] = eqx.field(static=True)
    camera: AimedSensor
    block: int = eqx.field(static=True)

    @eqx.filter_jit
    def image(self, values: Float[Array, " free"]) -> Float[Array, "band y x"]:
        """Reflectance factor of the blocks [-]."""
        return self._blocks_of(self._voxels(values))

    def slopes(
        self, values: Float[Array, " free"]
    ) -> tuple[Float[np.ndarray, "band y x"], Float[np.ndarray, "free band y x"]]:
        """The blocks and their derivatives by each value. Forward, so that a direction costs about
        as much as the image; values that act through optics alone share directions."""
        optics = np.asarray(self._optics_slopes(values), float)
        shared = self._through_optics()
        slopes = np.zeros((len(self.free), *self._shape), np.float32)
        image = None
        # Of each class and of the ground one direction for all bands.
        moved = np.flatnonzero(optics[:, :, shared].any(axis=(1, 2)))
        if len(moved):
            image, rows = self._along_optics(values, jnp.asarray(np.eye(len(optics))[moved]))
            for place, row in zip(moved, np.asarray(rows)):
                slopes[shared] += optics[place].T[shared][:, :, None, None] * row
        if not shared.all():
            own = jnp.asarray(np.eye(len(self.free))[~shared])
            image, rows = self._along_values(values, own)
            slopes[~shared] = rows
        assert image is not None  # some parameter is free
        return np.asarray(image, float), slopes

    def _through_optics(self) -> Bool[np.ndarray, " free"]:
        """Which values change nothing but the optics of classes and of an even ground."""
        even = self.scene.ground.patches is None
        return np.array(
            [
                ".leaf." in name
                or name.endswith((".dead_fraction", ".wood_brightness"))
                or (even and name.startswith("ground."))
                for name in self.free
            ],
            bool,
        )

    def _voxels(self, values: Array) -> VoxelScene:
        named = {name: values[i] for i, name in enumerate(self.free)}
        plot = with_values(self.parameters, self.scene.taxa, named)
        return self.scene.voxels(plot, self.camera.sensor.bands)

    def _blocks_of(self, voxels: VoxelScene) -> Float[Array, "band y x"]:
        return _blocks(self.camera.image(voxels)[0], self.block)

    @eqx.filter_jit
    def _optics_slopes(self, values: Array) -> Float[Array, "optics band free"]:
        """Derivatives of the reflectance of each class, of its transmittance, and of the ground's
        reflectance by the values; zeros for a ground in patches."""

        def optics(values: Array) -> Array:
            voxels = self._voxels(values)
            ground = voxels.ground if voxels.ground.ndim == 1 else jnp.zeros(len(voxels.ground))
            classes = voxels.classes
            return jnp.concatenate([classes.reflectance, classes.transmittance, ground[None]])

        return jax.jacfwd(optics)(values)

    @eqx.filter_jit
    def _along_optics(
        self, values: Array, directions: Float[Array, "direction optics"]
    ) -> tuple[Float[Array, "band y x"], Float[Array, "direction band y x"]]:
        """The blocks, and their derivatives along directions of optics, as `_optics_slopes` has
        them but alike in all bands. Where light passes does not change: only what it meets."""
        voxels = self._voxels(values)
        classes = voxels.classes

        def blocks(moved: Array) -> Array:
            reflectance, transmittance = jnp.split(moved[:-1, None], 2)
            return self._blocks_of(
                eqx.tree_at(
                    lambda v: (v.classes.reflectance, v.classes.transmittance, v.ground),
                    voxels,
                    (
                        classes.reflectance + reflectance,
                        classes.transmittance + transmittance,
                        voxels.ground + moved[-1],
                    ),
                )
            )

        none = jnp.zeros(directions.shape[1], voxels.ground.dtype)
        image, push = jax.linearize(blocks, none)
        return image, jax.lax.map(push, directions.astype(none.dtype))

    @eqx.filter_jit
    def _along_values(
        self, values: Array, directions: Float[Array, "direction free"]
    ) -> tuple[Float[Array, "band y x"], Float[Array, "direction band y x"]]:
        """The blocks, and their derivatives along directions of the values."""
        image, push = jax.linearize(lambda v: self._blocks_of(self._voxels(v)), values)
        return image, jax.lax.map(push, directions.astype(values.dtype))

    @property
    def _shape(self) -> tuple[int, int, int]:
        rows, columns = self.camera.shape
        return len(self.camera.sensor.bands), rows // self.block, columns // self.block


class _Search:
    """The search: coordinates of the parameters, then of the gains."""

    def __init__(
        self,
        model: PixelModel,
        space: ParameterSpace,
        measured: Float[np.ndarray, "band y x"],
        compared: Bool[np.ndarray, "y x"],
        pixel_sd: float,
        gain_sd: float,
        report: Callable[[str, float, float], None] | None,
    ) -> None:
        self._model, self._space, self._report = model, space, report
        self._measured, self._compared, self._pixel_sd = measured, compared, pixel_sd
        self._free = len(space.names)
        self._gain_root = np.linalg.cholesky(gain_covariance(len(measured), gain_sd))
        self._target = measured[:, compared].ravel()
        self.trace: list[tuple[float, float]] = []
        self.seconds = {"render_s": np.nan, "slopes_s": np.nan}

    def _values(self, u: np.ndarray) -> Array:
        return self._space.physical(jnp.asarray(u[: self._free]))

    def _gain(self, u: np.ndarray) -> np.ndarray:
        return np.exp(self._gain_root @ u[self._free :])

    def image(self, u: np.ndarray) -> Float[np.ndarray, "band y x"]:
        """The blocks as the camera measures them."""
        began = time.perf_counter()
        image = np.asarray(self._model.image(self._values(u)), float)
        self.seconds["render_s"] = time.perf_counter() - began
        return image * self._gain(u)[:, None, None]

    def _evaluate(self, u: np.ndarray) -> Float[np.ndarray, " value"]:
        return self.image(u)[:, self._compared].ravel()

    def linear(self, u: np.ndarray) -> Descended:
        """Compared values at `u` and their slopes."""
        began = time.perf_counter()
        image, by_value = self._model.slopes(self._values(u))
        self.seconds["slopes_s"] = time.perf_counter() - began
        gain, bands = self._gain(u), len(image)
        image = (image * gain[:, None, None])[:, self._compared]
        by_value = (by_value * gain[:, None, None])[:, :, self._compared]
        to_values = np.asarray(jax.jacfwd(self._space.physical)(jnp.asarray(u[: self._free])))
        own = by_value.reshape(self._free, -1).T @ to_values
        # The logarithm of a gain scales its band.
        by_gain = np.eye(bands)[:, None, :] * image[:, :, None]
        by_gain = by_gain.reshape(-1, bands) @ self._gain_root
        return Descended(
            u, image.ravel(), np.concatenate([own, by_gain], axis=1), FitStatus.max_steps
        )

    def run(self, max_steps: int, tolerance: float) -> KnownPlants:
        began = time.perf_counter()
        place = np.zeros(self._free + len(self._measured))
        before = self.image(place)
        status = FitStatus.max_steps
        for turn in range(_ROUNDS):
            point = self.linear(place)
            sd = self._pixel_sd * np.maximum(point.value, _DARKEST)
            weights = scipy.sparse.diags_array(1.0 / sd)

            def note(loss: float, norm: float, stage: str = f"round {turn + 1}") -> None:
                self.trace.append((loss, norm))
                if self._report is not None:
                    self._report(stage, loss, norm)

            steps = len(self.trace)
            end = descend(
                self._evaluate, point, self._target, weights,
                most=max_steps, tolerance=tolerance, note=note,
            )  # fmt: skip
            status = end.status
            if len(self.trace) == steps + 1 or bool(status == FitStatus.not_finite):
                break  # with slopes and errors of this very place no step is left
            place = end.u
        else:
            point, status = self.linear(place), FitStatus.max_steps
        return self._result(point, sd, before, status, time.perf_counter() - began)

    def _result(
        self,
        point: Descended,
        sd: Float[np.ndarray, " value"],
        before: Float[np.ndarray, "band y x"],
        status: Any,
        seconds: float,
    ) -> KnownPlants:
        model, free = self._model, self._free
        bands = model.camera.sensor.bands.names
        places = np.argwhere(self._compared)
        names = tuple(f"{band} {y},{x}" for band in bands for y, x in places)
        data = Data(names, jnp.asarray(self._target), jnp.asarray(sd))
        u = point.u[:free]
        result = fit_result(
            self._space, data, jnp.asarray(u), jnp.asarray(point.value),
            jnp.asarray(point.jacobian[:, :free]), status, len(self.trace), np.array(self.trace),
        )  # fmt: skip
        scaled = point.jacobian / sd[:, None]
        covariance = np.linalg.inv(scaled.T @ scaled + np.eye(len(point.u)))
        # Of the parameters alone, the gains integrated over.
        information = np.linalg.inv(covariance[:free, :free]) - np.eye(free)
        gains = self._gain_root @ covariance[free:, free:] @ self._gain_root.T
        weights = scipy.sparse.diags_array(1.0 / sd)
        named = dict(zip(self._space.names, self._values(point.u)))
        return KnownPlants(
            scene=model.scene,
            camera=model.camera,
            block=model.block,
            fit=result.with_information(jnp.asarray(0.5 * (information + information.T))),
            before=with_values(
                model.parameters, model.scene.taxa, self._space.named(jnp.zeros(free))
            ),
            after=with_values(model.parameters, model.scene.taxa, named),
            measured=np.where(self._compared, self._measured, np.nan),
            image_before=before,
            image_after=self.image(point.u),
            gain=self._gain(point.u),
            gain_sd=np.sqrt(np.diagonal(gains)),
            misfit=2.0 * objective_of(weights, point.u, point.value - self._target),
            seconds=self.seconds | {"search_s": seconds},
        )


def _blocks(image: Float[Array, "band row column"], block: int) -> Float[Array, "band y x"]:
    """Means over whole blocks of pixels."""
    bands, rows, columns = image.shape
    ny, nx = rows // block, columns // block
    cut = image[:, : ny * block, : nx * block].reshape(bands, ny, block, nx, block)
    return cut.mean(axis=(2, 4))

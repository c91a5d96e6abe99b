"""Calibrate a plot whose plants are known to an image, pixel by pixel.

Nothing of the plants is chance, so that each pixel says what stands in it. Pixels are many and
parameters few: slopes are taken forward, a direction at a time. Bands scatter apart, so that one
direction serves all of them: slopes by the reflectance and by the transmittance of each class and
by the ground's reflectance, chained with the derivatives of these by the traits, serve every
parameter that acts through optics alone.
"""

import dataclasses
from collections import deque
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Array, Bool, Float
from scipy.special import chdtrc

from fynjax._core.errors import InputError
from fynjax._core.least_squares import NO_TAGS, BroydenLM, BroydenState, figures_of
from fynjax._core.precision import double_precision
from fynjax._core.progress import stage
from fynjax.inversion._calibrate import UNDESCRIBED, Ends
from fynjax.inversion._data import Data
from fynjax.inversion._factors import BandFactors
from fynjax.inversion._fit_result import (
    Ended,
    FitResult,
    FitStatus,
    fit_result,
    number_of,
    status_of,
)
from fynjax.inversion._functionals import Functional, stand_table
from fynjax.inversion._search import (
    Progress,
    begun,
    excess_of,
    recorded,
    search_states,
    stepped,
)
from fynjax.inversion._space import ParameterSpace
from fynjax.inversion._verdict import (
    compare_means,
    gain_sentences,
    is_worse,
    worse_sentence,
)
from fynjax.radiation import VoxelScene
from fynjax.scene import (
    LEAF_FIELDS,
    AimedSensor,
    ModelError,
    PlotParameters,
    Scene,
    parameter_kind,
    with_values,
)
from fynjax.sensors import Gains

if TYPE_CHECKING:
    import pandas as pd

PIXEL_SD = 0.05
"""What the model's pixel is off by, as a share of it [-]: against a path tracer 1 to 2 % where both
have the same voxels of 10 cm (`tests/radiation/test_reference_scenes.py`), and where leaves are
single ones the spread of pixels of 2.5 cm is 5 to 8 % less (`python -m
tests.benchmarks.table_radiation --only plants`)."""
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
    """The plot, with known plants."""
    camera: AimedSensor
    """The camera that took the image, of single pixels."""
    block: int = eqx.field(static=True)
    """Pixels along the edge of the blocks whose means are compared."""
    fit: FitResult
    """The estimate. Its data are the compared values, band by band, with the errors of pixels and
    model."""
    before: PlotParameters
    """The plot's parameters with the free ones at the prior's centre."""
    after: PlotParameters
    """The plot's parameters at the estimate."""
    measured: Float[np.ndarray, "band y x"]
    """Reflectance of the blocks [-]; NaN where they are not compared."""
    image_before: Float[np.ndarray, "band y x"]
    """Simulated reflectance of the blocks with the parameters `before` [-]."""
    image_after: Float[np.ndarray, "band y x"]
    """Simulated reflectance of the blocks with the parameters `after`: of the plot alone [-]."""
    image_with_error: Float[np.ndarray, "band y x"]
    """The same times the estimated gains and the model's error: what is compared [-]."""
    gain: Float[np.ndarray, " band"]
    """Estimated factor by which each band of the camera is off [-]: what simulated bands are
    multiplied by."""
    gain_covariance: Float[np.ndarray, "band band"]
    """Covariance of the logarithms of `gain` [-]."""
    model_error: Float[np.ndarray, " band"]
    """Estimated factor by which reality is off from the model in each band, beside `gain` [-]."""
    model_error_sd: Float[np.ndarray, " band"]
    """Standard deviation of the logarithm of each `model_error` [-]."""
    excess: float
    """What the data ask beyond the stated errors, at least 1: the variances of all errors of values
    are so many times as large [-]."""
    misfit: float
    """Squared whitened misfit and distance from the prior, at the estimate: of data that the model
    and the prior explain a chi-square of `degrees`."""

    @double_precision
    def stand(self, functionals: Mapping[str, Functional] | None = None) -> "pd.DataFrame":
        """Numbers of the whole stand before and after the data: `functionals` by name, of which any
        may be one's own (`stand_table`)."""
        return stand_table(self.scene, self.before, self.fit, functionals=functionals)

    @double_precision
    def means(self) -> "pd.DataFrame":
        """The mean of every band over what is compared, as `Calibration.means` has them."""
        seen = np.isfinite(self.measured)
        images = (
            self.measured,
            self.image_before,
            self.image_after,
            self.image_after * self.gain[:, None, None],
        )
        values = [np.nanmean(np.where(seen, image, np.nan), axis=(1, 2)) for image in images]
        return compare_means([f"{n}.mean" for n in self.camera.sensor.bands.names], *values)

    @property
    def gain_sd(self) -> Float[np.ndarray, " band"]:
        """Standard deviation of the logarithm of each `gain` [-]."""
        return np.asarray(np.sqrt(np.maximum(np.diagonal(self.gain_covariance), 0.0)))

    def gain_sentences(self) -> list[str]:
        """As of `Calibration`."""
        return gain_sentences(self.camera.sensor.bands.names, self.gain, self.gain_covariance)

    @property
    def worse(self) -> bool:
        """As of `Calibration`."""
        return is_worse(self.means())

    @property
    def offered(self) -> PlotParameters:
        """As of `Calibration`."""
        return self.before if self.worse else self.after

    def misfit_sentence(self) -> str:
        """The misfit in words."""
        return f"The misfit is {self.misfit / self.degrees:.2g} times what was expected."

    def doubts(self) -> list[str]:
        """As of `Calibration`."""
        found = [worse_sentence(self.means())] if self.worse else []
        if self.misfit >= UNDESCRIBED * self.degrees:
            found.append(f"The model does not describe this plot. {self.misfit_sentence()}")
        return found

    @property
    @double_precision
    def data(self) -> Data:
        return self.fit.data

    @property
    def degrees(self) -> int:
        """Values that the likelihood counts."""
        return len(self.fit.data.names)

    @property
    @double_precision
    def probability(self) -> float:
        """That the model and its prior would give data so far from its expectation [-]."""
        return float(chdtrc(self.degrees, self.misfit))

    @property
    @double_precision
    def ends(self) -> Ends:
        """The search has one start."""
        u = np.asarray(self.fit.whitened)[None]
        return Ends(np.array([0.5 * self.misfit]), u, np.zeros(1), 1)


@dataclasses.dataclass(frozen=True)
class PixelSettings:
    """Settings of a calibration with known plants: blocks of pixels that are compared, and steps.

    **Raises:** `InputError` for a `block` or `pixel_sd` that is not positive.
    """

    block: int | None = None
    """Pixels along the edge of the blocks whose means are compared; None: `block_of`. Rows and
    columns beyond the last whole block are not compared."""
    pixel_sd: float = PIXEL_SD
    """Error of a block's mean, of camera and model, as a share of it [-]. Errors of different
    blocks and bands are independent: give errors that the whole plot shares to the gains, or widen
    this."""
    gains: Gains | None = None
    """Errors of the calibration of the bands; None: those of the camera's sensor."""
    max_steps: int = 30
    """Most steps between two computations of the slopes."""
    tolerance: float = 0.05
    """The search ends where another step would lower the objective by less than this, half a
    squared distance in posterior standard deviations."""

    def __post_init__(self) -> None:
        if (self.block is not None and self.block < 1) or not self.pixel_sd > 0.0:
            raise InputError(
                f"`block` and `pixel_sd` must be positive, but are {self.block} and "
                f"{self.pixel_sd:g}"
            )


@double_precision
def calibrate_known_plants(
    scene: Scene,
    parameters: PlotParameters,
    image: Float[np.ndarray, "band row column"],
    space: ParameterSpace,
    camera: AimedSensor,
    settings: PixelSettings | None = None,
    *,
    error: ModelError | None = None,
) -> KnownPlants:
    """Calibrate the free parameters of a plot whose plants are known to an image of it.

    Every compared value, the mean of a block of pixels in one band, has an error of its own. The
    gains of the bands, and what the model is off by in each, are estimated beside the parameters,
    with normal priors of their logarithms.
    The search is that of `calibrate_plot` (`BroydenLM`), on the whole scene at the camera's own
    accuracy; slopes are computed anew, and errors renewed by the simulated image, until these would
    lower the objective no more.

    **Arguments:**

    - `scene`, `parameters`: the plot, with `Scene.known_plants`.
    - `image`: reflectance factor [-], rows from the south, as `camera` has them; a pixel that is
      NaN in any band is not compared.
    - `space`: the free parameters with their priors (`free_space`).
    - `camera`: from `aim`, without air.
    - `settings`: which pixels are compared, with what errors, and how long the search is.
    - `error`: what the model is off by, over wavelength, as of `calibrate_plot`.

    To watch, keep or stop it go through `known_plants_search` step by step, as this function does.

    **Returns:** `KnownPlants`.

    **Raises:** `InputError` for an image of another shape or without a whole block of pixels,
    plants that are not known, and where JAX is limited to 32 bits.

    Not differentiable.
    """
    search = known_plants_search(scene, parameters, image, space, camera, settings, error=error)
    with stage("Calibrate", search.settings.max_steps):
        (end,) = deque(search_states(search, search.begin()), maxlen=1)
    return search.result(end)


@double_precision
def known_plants_search(
    scene: Scene,
    parameters: PlotParameters,
    image: Float[np.ndarray, "band row column"],
    space: ParameterSpace,
    camera: AimedSensor,
    settings: PixelSettings | None = None,
    *,
    error: ModelError | None = None,
) -> "PixelSearch":
    """The search of `calibrate_known_plants`, to be gone through step by step.

    **Arguments:** `scene`, `parameters`, `image`, `space`, `camera`, `settings` and `error`: as of
    `calibrate_known_plants`.

    **Raises:** `InputError` as `calibrate_known_plants`.
    """
    settings = PixelSettings() if settings is None else settings
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
    block = block_of(bands, camera.shape) if settings.block is None else settings.block
    measured = np.asarray(_blocks(jnp.asarray(np.asarray(image, float)), block))
    compared = np.isfinite(measured).all(axis=0)
    if not compared.any():
        raise InputError(f"no block of {block} x {block} pixels of the image has all its values")
    model = PixelModel(scene, parameters, space.names, camera, block)
    return PixelSearch(model, space, measured, compared, settings, error)


class PixelModel(eqx.Module):
    """Blocks of pixels of a scene, from the values of free parameters in their own units."""

    scene: Scene
    """The plot."""
    parameters: PlotParameters
    """The plot's parameters; those that are not free keep these values."""
    free: tuple[str, ...] = eqx.field(static=True)
    """Names of the free parameters."""
    camera: AimedSensor
    """The camera, without air between it and the plot."""
    block: int = eqx.field(static=True)
    """Pixels along the edge of a block."""

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
                # Bands do not mix: an optic's effect on a band times its slope in that band.
                slopes[shared] += optics[place].T[shared][:, :, None, None] * row
        if not shared.all():
            own = jnp.asarray(np.eye(len(self.free))[~shared])
            image, rows = self._along_values(values, own)
            slopes[~shared] = rows
        if image is None:  # no value changes anything
            image = self.image(values)
        return np.asarray(image, float), slopes

    def _through_optics(self) -> Bool[np.ndarray, " free"]:
        """Which values change nothing but the optics of classes and of an even ground."""
        even = self.scene.ground.patches is None
        return np.array(
            [
                parameter_kind(name) in LEAF_FIELDS
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
            # Added, not multiplied: what reflects nothing has a slope too.
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


class PixelState(Progress):
    """Where the search of known plants stands: all that another process needs to go on. Coordinates
    are those of the parameters, then of the factors of the bands."""

    sd: Float[Array, " value"]
    """Errors of the compared values in this round [-]."""
    before: Float[Array, "band y x"]
    """The blocks at the prior's centre, as the camera measures them."""


class PixelSearch:
    """Search of a calibration of known plants, step by step, as `PlotSearch`: coordinates of the
    parameters, then of the factors of the bands.

    **Arguments:** `space`, `settings` and `error` of `calibrate_known_plants`; `model` of the
    blocks, whose means are `measured`, of which those that are `compared` count.
    """

    state = PixelState

    @double_precision
    def __init__(
        self,
        model: PixelModel,
        space: ParameterSpace,
        measured: Float[np.ndarray, "band y x"],
        compared: Bool[np.ndarray, "y x"],
        settings: PixelSettings,
        error: ModelError | None = None,
    ) -> None:
        if settings.gains is None:
            settings = dataclasses.replace(settings, gains=model.camera.sensor.gains())
        assert settings.gains is not None
        self.model, self.space, self.settings = model, space, settings
        self._measured, self._compared = measured, compared
        self._free = len(space.names)
        self._factors = BandFactors.of_bands([(model.camera.sensor.bands, settings.gains)], error)
        self._root = np.asarray(self._factors.root)
        self._target = measured[:, compared].ravel()
        self._solver = BroydenLM(atol=settings.tolerance)
        self.signed = (model, space, measured, compared, settings, error)
        """All that its steps follow from, besides where it starts."""

    def _values(self, u: Array) -> Array:
        return self.space.physical(jnp.asarray(u[: self._free]))

    def _factor(self, u: Array) -> np.ndarray:
        return np.exp(self._root @ np.asarray(u)[self._free :])

    @double_precision
    def image(self, u: Array) -> Float[np.ndarray, "band y x"]:
        """The blocks times the factors of the bands."""
        image = np.asarray(self.model.image(self._values(u)), float)
        return image * self._factor(u)[:, None, None]

    @double_precision
    def linear(
        self, u: Array
    ) -> tuple[Float[np.ndarray, " value"], Float[np.ndarray, "value coordinate"]]:
        """Compared values at `u` and their slopes."""
        image, by_value = self.model.slopes(self._values(u))
        factor, bands = self._factor(u), len(image)
        image = (image * factor[:, None, None])[:, self._compared]
        by_value = (by_value * factor[:, None, None])[:, :, self._compared]
        to_values = np.asarray(jax.jacfwd(self.space.physical)(jnp.asarray(u[: self._free])))
        # By whitened coordinates, whose priors may be correlated: a full matrix.
        own = by_value.reshape(self._free, -1).T @ to_values
        # The logarithm of a factor scales its band.
        by_factor = np.eye(bands)[:, None, :] * image[:, :, None]
        by_factor = by_factor.reshape(-1, bands) @ self._root
        return image.ravel(), np.concatenate([own, by_factor], axis=1)

    def _whitened(self, values: np.ndarray, u: Array | np.ndarray, sd: np.ndarray) -> Array:
        return jnp.asarray(np.concatenate([(values - self._target) / sd, np.asarray(u)]))

    def _descent(
        self, u: Array, sd: np.ndarray | None = None
    ) -> tuple[BroydenState, Float[Array, " value"]]:
        """State of the solver with slopes of this very place, and errors: by default its own."""
        values, slopes = self.linear(u)
        if sd is None:
            # A share of what is simulated: of the measured, noise that darkens would weigh more.
            sd = self.settings.pixel_sd * np.maximum(values, _DARKEST)
        rows = np.concatenate([slopes / sd[:, None], np.eye(len(u))])
        return begun(self._solver, u, self._whitened(values, u, sd), rows), jnp.asarray(sd)

    @double_precision
    def begin(self, u: Float[Array, " free"] | None = None) -> PixelState:
        """The state at whitened coordinates of the parameters, by default the prior's centre."""
        own = np.zeros(self._free) if u is None else np.asarray(u)
        place = jnp.asarray(np.concatenate([own, np.zeros(self._factors.coordinates)]))
        descent, sd = self._descent(place)
        whole = lambda number: jnp.asarray(number, int)  # noqa: E731
        return PixelState(
            u=place, descent=descent, trace=figures_of(descent)[None], rounds=whole([1]),
            steps=whole(0), status=number_of(FitStatus.max_steps), turn=whole(0), step=whole(0),
            ended=whole(0), sd=sd, before=jnp.asarray(self.image(place)),
        )  # fmt: skip

    @double_precision
    def step(self, state: PixelState) -> PixelState:
        """The next state: one step of the solver, or slopes and errors anew."""
        solver = self._solver
        done, result = solver.terminate(None, state.u, None, None, state.descent, NO_TAGS)
        finite = bool(result == optx.RESULTS.successful)
        if not finite or (done and state.step == 0):
            # With slopes and errors of this very place no step is left: the end.
            status = number_of(FitStatus.successful if finite else FitStatus.not_finite)
            return dataclasses.replace(state, status=status, ended=state.ended + 1)
        if done or state.step >= self.settings.max_steps:
            last = int(state.turn) + 1 == _ROUNDS
            # The last slopes are for the result alone, with the errors it was found by.
            descent, sd = self._descent(state.u, np.asarray(state.sd) if last else None)
            renewed = dataclasses.replace(
                state, descent=descent, sd=sd, turn=state.turn + 1,
                step=jnp.asarray(0), ended=state.ended + int(last),
            )  # fmt: skip
            return renewed if last else recorded(renewed)
        errors = np.asarray(state.sd)

        def whitened(u: Array, _: Any) -> tuple[Array, None]:
            return self._whitened(self.image(u)[:, self._compared].ravel(), u, errors), None

        return stepped(solver, state, whitened)

    @double_precision
    def result(self, state: PixelState) -> KnownPlants:
        """What a search that has ended found."""
        model, free, sd, u = self.model, self._free, np.asarray(state.sd), np.asarray(state.u)
        # At the end residuals and slopes are those of this very place.
        rest, rows = np.asarray(state.descent.residual), np.asarray(state.descent.jacobian)
        excess = excess_of(float(rest @ rest), len(sd))
        scaled = rows[: len(sd)] / np.sqrt(excess)
        # Back from whitened residuals and rows to values and their slopes.
        values, slopes = self._target + sd * rest[: len(sd)], sd[:, None] * rows[: len(sd)]
        places = np.argwhere(self._compared)
        bands = model.camera.sensor.bands.names
        names = tuple(f"{band} {y},{x}" for band in bands for y, x in places)
        data = Data(names, jnp.asarray(self._target), jnp.asarray(sd)).widened(excess)
        end = Ended(
            jnp.asarray(u[:free]), jnp.asarray(values), jnp.asarray(slopes[:, :free]),
            status_of(state.status), state.steps, state.trace, state.rounds,
        )  # fmt: skip
        result = fit_result(self.space, data, end)
        # Of parameters and factors together; the prior of both is one.
        covariance = np.linalg.inv(scaled.T @ scaled + np.eye(len(u)))
        # Of the parameters alone, the factors integrated over.
        information = np.linalg.inv(covariance[:free, :free]) - np.eye(free)
        factors = self._factors.known(u[free:], covariance[free:, free:])
        gains, errors = self._factors.gains(factors), self._factors.errors(factors)
        centre = self.space.named(jnp.zeros(free))
        named = dict(zip(self.space.names, self._values(state.u)))
        image = self.image(state.u)
        return KnownPlants(
            scene=model.scene,
            camera=model.camera,
            block=model.block,
            fit=result.with_information(jnp.asarray(0.5 * (information + information.T))),
            before=with_values(model.parameters, model.scene.taxa, centre),
            after=with_values(model.parameters, model.scene.taxa, named),
            measured=np.where(self._compared, self._measured, np.nan),
            image_before=np.asarray(state.before),
            image_after=image / factors.factor[:, None, None],
            image_with_error=image,
            gain=gains.factor,
            gain_covariance=gains.covariance,
            model_error=errors.factor,
            model_error_sd=errors.sd,
            misfit=float(rest @ rest),
            excess=excess,
        )


def _blocks(image: Float[Array, "band row column"], block: int) -> Float[Array, "band y x"]:
    """Means over whole blocks of pixels."""
    bands, rows, columns = image.shape
    ny, nx = rows // block, columns // block
    cut = image[:, : ny * block, : nx * block].reshape(bands, ny, block, nx, block)
    return cut.mean(axis=(2, 4))

"""Calibrate a plot whose plants are known to an image, pixel by pixel.

Nothing of the plants is chance, so that each pixel says what stands in it. Pixels are many and
parameters few: slopes are taken forward, a direction at a time. Bands scatter apart, so that one
direction serves all of them: slopes by the reflectance and by the transmittance of each class and
by the ground's reflectance, chained with the derivatives of these by the traits, serve every
parameter that acts through optics alone.
"""

import dataclasses
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Array, Bool, Float

from fynjax._core.errors import InputError
from fynjax._core.least_squares import NO_TAGS, BroydenLM, BroydenState, figures_of
from fynjax._core.precision import double_precision
from fynjax.inversion._data import DARKEST, Pixels, block_means
from fynjax.inversion._factors import BandFactors, PlotSpace
from fynjax.inversion._fit_result import FitStatus, number_of
from fynjax.inversion._problem import Problem
from fynjax.inversion._search import Progress, begun, recorded, stepped
from fynjax.inversion._shapes import OUTLINE, scale_of, shape_error
from fynjax.inversion._views import ImageView
from fynjax.radiation import VoxelScene
from fynjax.scene import (
    LEAF_FIELDS,
    AimedSensor,
    PlotParameters,
    Scene,
    hard_counts,
    parameter_kind,
    with_values,
)

_ROUNDS = 4
"""Slopes are computed anew so many times at most."""


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
        return block_means(self.camera.image(voxels)[0], self.block)

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


class PixelErrors(eqx.Module):
    """What blocks of pixels are off by, as shares of a scale."""

    covariance: Float[Array, "band band"]
    """Of the bands of a block."""
    together: Float[Array, ""]
    """Blocks that err as one, because neighbours err alike [-]."""
    shapes: bool = eqx.field(static=True)
    """Whether errors are of the plants' shapes too."""

    @classmethod
    def of(cls, scene: Scene, camera: AimedSensor, pixels: Pixels) -> "PixelErrors":
        """As `Pixels.sd` states them."""
        own = pixels.own_sd**2 * np.eye(len(camera.sensor.bands))
        if pixels.sd is not None:
            return cls(jnp.asarray(own), jnp.asarray(1.0), False)
        shape, together = shape_error(scene, camera, block=pixels.block, widest=16)
        shape = 2.0 * shape  # the plot has shapes of its own, and the model others
        # What is a block's own is not shared with its neighbours.
        shared = 1.0 + (together - 1.0) * np.trace(shape) / np.trace(shape + own)
        return cls(jnp.asarray(shape + own), jnp.asarray(shared), True)

    def whiten(self, off: np.ndarray, *, back: bool = False) -> np.ndarray:
        """Errors of the values over their scale, band by band along the first axis, as independent
        ones of unit variance, each of as many blocks as err as one; or `back` from these."""
        root = np.linalg.cholesky(np.asarray(self.covariance, float) * float(self.together))
        white = (root if back else np.linalg.inv(root)) @ off.reshape(len(root), -1)
        return np.asarray(white.reshape(off.shape))

    def scale(self, values: Float[np.ndarray, " value"]) -> Float[np.ndarray, " value"]:
        """What errors are shares of [-]."""
        if not self.shapes:
            return np.maximum(values, DARKEST)
        return np.asarray(
            scale_of(jnp.asarray(values.reshape(len(self.covariance), -1, 1)))
        ).ravel()

    @property
    def sd(self) -> Float[np.ndarray, " band"]:
        """Error of a block in each band, over the scale [-]."""
        return np.sqrt(np.diagonal(np.asarray(self.covariance, float)))


class PixelState(Progress):
    """Where the search of known plants stands: all that another process needs to go on. Coordinates
    are those of the parameters, then of the factors of the bands."""

    sd: Float[Array, " value"]
    """Scale of the errors of the compared values in this round [-]: of which `PixelErrors` are
    shares."""
    before: Float[Array, "band y x"]
    """The blocks where the search started, as the camera measures them."""
    start: Float[Array, " coordinate"]
    """Coordinates where it started."""


class PixelSearch:
    """Search of a calibration of known plants, step by step, as `PlotSearch`: coordinates of the
    parameters, then of the factors of the bands.

    Every compared value, the mean of a block of pixels in one band, has an error of its own, and
    every block one that its bands and neighbours share, since the shapes of its plants are not
    known (`PixelErrors`). The gains of the bands, and what the model is off by in each, are
    estimated beside the parameters, with normal priors of their logarithms. The search is on the
    whole scene at the camera's own accuracy; slopes are computed anew, and errors renewed by the
    simulated image, until these would lower the objective no more.

    **Arguments:** `problem`, whose data are of `Data.from_pixels`, and whose camera has no air.

    **Raises:** `InputError` for an image of another shape than the camera's, and plants that are
    not known.
    """

    state = PixelState

    @double_precision
    def __init__(self, problem: Problem) -> None:
        scene, (view,), pixels = problem.scene, problem.views, problem.measured.pixels
        assert isinstance(view, ImageView)
        assert pixels is not None
        camera = view.camera
        if view.sun is not None or camera.seen is not None:
            raise InputError(
                "expected an image from above, under the sun of the scene, where every pixel counts"
            )
        bands = len(camera.sensor.bands)
        if np.shape(pixels.image) != (bands, *camera.shape):
            raise InputError(
                f"expected an image of {bands} bands, {camera.shape[0]} rows and "
                f"{camera.shape[1]} columns, as the camera's, but got one of shape "
                f"{np.shape(pixels.image)}"
            )
        if not scene.known_plants:
            raise InputError(
                "expected a plot whose plants are known (`crowns`): where plants stand by "
                "chance no pixel says what stands in it"
            )
        self.problem, self.settings = problem, problem.settings
        self.space = PlotSpace(problem.free, BandFactors.of((view,), problem.error))
        self._plot = problem.free
        self.model = PixelModel(scene, scene.parameters, problem.free.names, camera, pixels.block)
        self._measured, self.compared = pixels.means, pixels.compared
        self.errors = PixelErrors.of(scene, camera, pixels)
        self._free = len(problem.free.names)
        self._factors = self.space.factors
        self._root = np.asarray(self._factors.root)
        self._target = self._measured[:, self.compared].ravel()
        self._solver = BroydenLM(atol=self.settings.tolerance)
        self.signed = (
            self.model, problem.free, self._measured, self.compared, view.gains, self.errors,
            self.settings, problem.error,
        )  # fmt: skip
        """All that its steps follow from, besides where it starts."""

    def outlines(self, u: np.ndarray) -> Float[np.ndarray, "free free"]:
        """Covariance of the parameters at `u` by the outlines of the plants, whose shapes are not
        known: of a species' mean size the variance of one plant (`OUTLINE`) over their number, in
        prior standard deviations."""
        at, scene = jnp.asarray(u[: self._free]), self.model.scene
        number = dict(zip(scene.taxa, hard_counts(scene, self.model.parameters), strict=True))
        of = np.zeros(self._free)
        for i, name in enumerate(self._plot.names):
            error = OUTLINE.get(parameter_kind(name), 0.0) if self.errors.shapes else 0.0
            if error:
                of[i] = error / np.sqrt(max(int(number[name.split(".")[1]]), 1))
        sizes = np.diag(of * np.asarray(self._plot.physical(at)))
        root = np.linalg.solve(np.asarray(jax.jacfwd(self._plot.physical)(at), float), sizes)
        return np.asarray(root @ root.T)

    @property
    def measured(self) -> Float[np.ndarray, "band y x"]:
        """Measured means of the blocks [-]; NaN where they are not compared."""
        return np.where(self.compared, self._measured, np.nan)

    def _values(self, u: Array) -> Array:
        return self._plot.physical(jnp.asarray(u[: self._free]))

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
        image = (image * factor[:, None, None])[:, self.compared]
        by_value = (by_value * factor[:, None, None])[:, :, self.compared]
        to_values = np.asarray(jax.jacfwd(self._plot.physical)(jnp.asarray(u[: self._free])))
        # By whitened coordinates, whose priors may be correlated: a full matrix.
        own = by_value.reshape(self._free, -1).T @ to_values
        # The logarithm of a factor scales its band.
        by_factor = np.eye(bands)[:, None, :] * image[:, :, None]
        by_factor = by_factor.reshape(-1, bands) @ self._root
        return image.ravel(), np.concatenate([own, by_factor], axis=1)

    def _whitened(self, values: np.ndarray, u: Array | np.ndarray, sd: np.ndarray) -> Array:
        off = self.errors.whiten((values - self._target) / sd)
        return jnp.asarray(np.concatenate([off, np.asarray(u)]))

    def _descent(
        self, u: Array, sd: np.ndarray | None = None
    ) -> tuple[BroydenState, Float[Array, " value"]]:
        """State of the solver with slopes of this very place, and errors: by default its own."""
        values, slopes = self.linear(u)
        if sd is None:
            # A share of what is simulated: of the measured, noise that darkens would weigh more.
            sd = self.errors.scale(values)
        rows = np.concatenate([self.errors.whiten(slopes / sd[:, None]), np.eye(len(u))])
        return begun(self._solver, u, self._whitened(values, u, sd), rows), jnp.asarray(sd)

    @double_precision
    def begin(self, u: Float[Array, " some"], after: PixelState | None = None) -> PixelState:
        """The state at whitened coordinates `u`, of the parameters alone, whose factors are then
        one, or of both; `after` the end of another start, of which nothing is needed."""
        place = self.space.whole(u)
        descent, sd = self._descent(place)
        whole = lambda number: jnp.asarray(number, int)  # noqa: E731
        return PixelState(
            u=place, descent=descent, trace=figures_of(descent)[None], rounds=whole([1]),
            steps=whole(0), status=number_of(FitStatus.max_steps), turn=whole(0), step=whole(0),
            ended=whole(0), sd=sd, before=jnp.asarray(self.image(place)), start=place,
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
            return self._whitened(self.image(u)[:, self.compared].ravel(), u, errors), None

        return stepped(solver, state, whitened)

"""What a fit is asked: a scene, what was measured of it, and what may change."""

import dataclasses
from collections.abc import Sequence
from typing import Any, Literal

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array, Float

from fynjax._core.errors import InputError, whole_number
from fynjax._core.extras import app_room
from fynjax._core.precision import double_precision
from fynjax.inversion._data import Data
from fynjax.inversion._space import ParameterSpace
from fynjax.inversion._views import AbstractView
from fynjax.radiation import Accuracy
from fynjax.scene import ModelError, PlotParameters, Scene, room_needed, with_values

COARSE = Accuracy(
    lattice=1, sublayers=1, coarsening=(3, 5), levels=2, azimuths=4, tolerance=1e-2, refine=False
)
"""Accuracy of the light while a fit searches; what it lacks is corrected (`fit`)."""


@dataclasses.dataclass(frozen=True)
class CalibrationSettings:
    """How a calibration searches, and how far it allows for chance."""

    stride: int | None = None
    """A search renders every so many pixels of a drone's image along each axis; None: pixels that
    lie a voxel apart."""
    accuracy: Accuracy = COARSE
    """Accuracy of the light in a search."""
    rounds: int = 2
    """Searches one after the other, each corrected by the full scene; up to five more follow while
    the last still moved."""
    stand_realisations: int = 8
    """Draws of the plants and of what is unknown of the parameters over which statistics and slopes
    are expectations, better an even number; 0: the image's plants count as standing where the
    scene's do, and slopes are those at one place."""
    scatter_draws: int = 48
    """Draws of plants and parameters from which the covariance of the statistics is estimated;
    those after the first `stand_realisations` fill the sites of these in another order."""
    full_renders: int = 2
    """Plantings on which what the coarse form lacks is measured, at most `stand_realisations`."""
    max_steps: int = 30
    """Most steps of the first round; those after have half as many. Of a `solver` that goes through
    a round by itself, those of each round."""
    tolerance: float = 0.05
    """A round ends where another step would lower the objective by less than this, which is half a
    squared distance in posterior standard deviations."""
    starts: int = 1
    """Searches, the others from draws of the prior; the best is kept."""
    seed: int = 0
    """Seed of the further starts, and of the draws that choose directions of many statistics."""

    @property
    def evaluations(self) -> int:
        """Evaluations of the objective in two rounds from each start, about how long a search is:
        where a round begins and after each of its steps."""
        return self.starts * (2 + self.max_steps + (self.max_steps + 1) // 2)

    def __post_init__(self) -> None:
        whole_number("seed", self.seed)
        for name in ("rounds", "starts", "max_steps", "full_renders"):
            if getattr(self, name) < 1:
                raise InputError(f"`{name}` must be at least 1, but is {getattr(self, name)}")
        if self.stand_realisations < 0 or self.stand_realisations == 1:
            raise InputError(
                f"`stand_realisations` must be 0 or at least 2, but is {self.stand_realisations}"
            )
        if self.stand_realisations and self.scatter_draws < 3:
            raise InputError(
                f"`scatter_draws` must be at least 3, but is {self.scatter_draws}: a covariance "
                "needs some"
            )


_DRAWS, _LIKELY = 500, 0.99


class Problem(eqx.Module):
    """A scene, what sensors measured of it, and its parameters that are free, with their priors:
    what `fit` solves, and what the commands make of a plot file (`read_problem`).

    As many sites are held ready for plants as 99 of 100 draws of the prior need.

    >>> import fynjax as fx
    >>> from fynjax.canopy import table1_2006
    >>> scene = fx.Scene.from_table(table1_2006()[:2], size=1.0, voxel=0.5)
    >>> data = fx.Data.from_table({"nir.mean": 0.3, "red.mean": 0.05})
    >>> problem = fx.Problem(scene, data, fx.free(scene, "species.*.cover"), error="none")
    >>> problem.views[0].names
    ('nir.mean', 'red.mean')
    """

    scene: Scene
    """The plot; parameters that are not free keep the values of `scene.parameters`."""
    data: Data | None
    """What was measured, with how each sensor sees the scene; None where nothing was."""
    free: ParameterSpace
    """The free parameters with their priors."""
    error: ModelError | None
    """What the model is off by over wavelength; None: it is believed."""
    settings: CalibrationSettings = eqx.field(static=True)
    """How a fit searches."""
    views: tuple[AbstractView, ...]
    """What each sensor yields of the scene, in the order of the data."""

    def __init__(
        self,
        scene: Scene,
        data: Data | None,
        free: ParameterSpace,
        *,
        error: ModelError | Literal["learned", "none"] | None = "learned",
        settings: CalibrationSettings | None = None,
        views: Sequence[AbstractView] | None = None,
    ) -> None:
        """**Arguments:**

        - `scene`, `data`, `free`: as the fields; `free` of `fx.free`.
        - `error`: what the model is off by over wavelength: "learned" from 18 plots of fynbos, 12
          to 15 % from 450 to 1100 nm; that of another population or a wider one, such as
          `fx.prior().model_error.wider(1.4)` for shrubland elsewhere; or "none", right only where
          the model itself made the data.
        - `settings`: how a fit searches; the usual by default.
        - `views`: what each sensor yields of the scene; by default as the data say.

        **Raises:** `InputError` for an argument of another type, for data without the sensors that
        measured them, and for views that do not yield the data's statistics.
        """
        check_asked(data, free, measured=views is not None)
        if not isinstance(scene, Scene):
            raise InputError(f"expected a scene, but got {scene!r:.60}")
        scene, views = _ready(scene, data, free, views)
        yielded = tuple(name for view in views for name in view.statistic_names)
        if data is not None and data.pixels is None and yielded != data.names:
            raise InputError(
                f"`views` must yield the statistics of `data` in their order, {data.names[:3]}..., "
                f"but yield {yielded[:3]}..."
            )
        self.scene, self.data, self.free = scene, data, free
        self.error = believed(error)
        self.settings = CalibrationSettings() if settings is None else settings
        self.views = tuple(views)

    @property
    def measured(self) -> Data:
        """The data. **Raises:** `InputError` where nothing was measured."""
        if self.data is None:
            raise InputError("expected a problem with data of what was measured")
        return self.data

    def with_data(self, data: Data) -> "Problem":
        """The same of other data of the same sensors."""
        return Problem(
            self.scene, data, self.free, error=self.error, settings=self.settings, views=self.views
        )


@double_precision
def _ready(
    scene: Scene, data: Data | None, free: ParameterSpace, views: Sequence[AbstractView] | None
) -> tuple[Scene, Sequence[AbstractView]]:
    """A scene with sites for what may be asked of it, and its views, as the data say if none are
    given."""
    parameters = scene.parameters
    counts = _likely_counts(scene, parameters, free)
    if room_needed(scene, parameters, counts).any():
        scene = scene.realisation(0, counts)
    if views is not None:
        return scene, views
    parts = () if data is None else data.parts
    if data is not None and not parts:
        raise InputError(
            "expected data with the sensors that measured them, of Data.from_image, from_table, "
            "from_spectrum or from_cloud"
        )
    return scene, [part.source.view(scene, parameters) for part in parts if part.source]


def check_asked(data: Any, free: Any, *, measured: bool = True) -> None:
    """Raise `InputError` for data and free parameters of another type; None are no data unless
    there is something `measured`."""
    if not isinstance(data, Data) and (measured or data is not None):
        raise InputError(f"expected `data` as `fx.Data`, but got {data!r:.60}")
    if not isinstance(free, ParameterSpace):
        raise InputError(
            f"expected `free` as of `fx.free` or `fx.ParameterSpace`, but got {free!r:.60}"
        )


def believed(error: ModelError | Literal["learned", "none"] | None) -> ModelError | None:
    """The error of the model that an argument `error` means; None for "none"."""
    if error is None or isinstance(error, ModelError):
        return error
    if error not in ("learned", "none"):
        raise InputError(
            f'expected `error` as "learned", "none" or a `ModelError`, but got {error!r}'
        )
    if error == "none":
        return None
    return app_room("io.plot", "read_prior")(app_room("io.plot", "DEFAULT_PRIOR")).model_error


def _likely_counts(
    scene: Scene, parameters: PlotParameters, space: ParameterSpace
) -> Float[np.ndarray, " species"]:
    """Plants of each species that 99 of 100 draws of the prior do not exceed."""

    def counts(u: Float[Array, " free"]) -> Float[Array, " species"]:
        return scene.counts(with_values(parameters, scene.taxa, space.named(u)))

    # A seed of its own: how many sites there are must not depend on who draws plants.
    normal = np.random.default_rng(0).normal(size=(_DRAWS, len(space.names)))
    return np.quantile(np.asarray(jax.jit(jax.vmap(counts))(normal)), _LIKELY, axis=0)

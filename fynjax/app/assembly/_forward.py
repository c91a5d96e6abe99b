"""What the jobs on a plot's parameters share: the plot, its free parameters, a forward model."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import jax
import numpy as np
import pandas as pd
from jaxtyping import Array, Float

from fynjax._core.precision import double_precision
from fynjax.app.assembly._build import build_plot
from fynjax.app.assembly._sensing import aim_without_air
from fynjax.app.io.plot import Plot, drone_sensor, free_parameters, plot_error
from fynjax.inversion import (
    CalibrationSettings,
    ImageView,
    ParameterSpace,
    free_space,
)
from fynjax.scene import (
    PARAMETERS,
    ModelError,
    PlotParameters,
    Scene,
    own_spread,
    parameter_kind,
    room_needed,
    with_values,
)


class Prepared(NamedTuple):
    """A plot as a scene, with its free parameters."""

    plot: Plot
    scene: Scene
    parameters: PlotParameters
    space: ParameterSpace
    seed: int
    """Seed of everything random."""
    error: ModelError | None = None
    """Error of the model over wavelength that a calibration of the plot allows for (`plot_error`);
    None: the model is believed."""

    @property
    def settings(self) -> CalibrationSettings:
        """How `calibrate_plot` searches, by the plot's [calibration]."""
        table = self.plot.calibration
        return CalibrationSettings(
            rounds=table.rounds,
            max_steps=table.max_iterations,
            starts=table.starts,
            seed=self.seed,
        )


@double_precision
def prepare(plot: Plot, free: Sequence[str] | None, *, seed: int) -> Prepared:
    """Build a plot and its free parameters.

    **Arguments:**

    - `plot`: as `read_plot` gives it.
    - `free`: patterns of the names of the parameters to be free; those of the plot file if `None`
      (`free_parameters`).
    - `seed`: of everything random.

    As many sites are held ready for plants as 99 of 100 draws of the prior need. The number of
    plants is rounded at random, so that its mean over plantings is that of the covers.

    **Raises:** `InputError` as `build_plot`, and as `free_space`.
    """
    scene, parameters = build_plot(plot, seed=seed, rounding="random")
    patterns = free_parameters(plot) if free is None else tuple(free)
    space = free_space(
        scene, parameters, patterns, lambda name: _prior_sd(plot, name, dict(scene.spreads))
    )
    counts = _likely_counts(scene, parameters, space)
    if room_needed(scene, parameters, counts).any():
        scene = scene.realisation(0, counts)
    return Prepared(plot, scene, parameters, space, seed, plot_error(plot))


def _prior_sd(plot: Plot, name: str, spreads: Mapping[str, float]) -> float | None:
    """Relative standard deviation of a parameter's prior: that of the tables and spectra themselves
    (`spreads`, as of `Scene.spreads`), unless `calibration.priors` has another (`own_spread`)."""
    own = own_spread(name, spreads, plot.calibration.priors)
    return plot.calibration.relative_sd(name) if own is None else own


_DRAWS, _LIKELY = 500, 0.99


def _likely_counts(
    scene: Scene, parameters: PlotParameters, space: ParameterSpace
) -> Float[np.ndarray, " species"]:
    """Plants of each species that 99 of 100 draws of the prior do not exceed."""

    def counts(u: Float[Array, " free"]) -> Float[Array, " species"]:
        return scene.counts(with_values(parameters, scene.taxa, space.named(u)))

    # A seed of its own: how many sites there are must not depend on who draws plants.
    normal = np.random.default_rng(0).normal(size=(_DRAWS, len(space.names)))
    return np.quantile(np.asarray(jax.jit(jax.vmap(counts))(normal)), _LIKELY, axis=0)


def image_view(
    plot: Plot, scene: Scene, parameters: PlotParameters, statistics: Sequence[str]
) -> ImageView:
    """Statistics of the image that a plot's drone takes, from where its file has it.

    **Arguments:**

    - `plot`: as `read_plot` gives it.
    - `scene`, `parameters`: of the plot, from `build_plot`.
    - `statistics`: names such as `nir.mean` or `NDVI.std`.

    **Raises:** `InputError` as `drone_sensor` and `aim_without_air`.
    """
    sensor = drone_sensor(plot, {name.split(".")[0] for name in statistics})
    camera = aim_without_air(plot, scene, parameters, sensor)
    return ImageView(tuple(statistics), camera, sensor.gains())


def batch_for_device() -> int | None:
    """Renders at once: as many as fit on an accelerator; on a processor one fills it."""
    return 1 if jax.default_backend() == "cpu" else None


def shown_unit(name: str) -> tuple[str, str, float]:
    """Kind, unit as field crews write it, and the factor to it, of the parameter called `name`."""
    kind = parameter_kind(name)
    return kind, PARAMETERS[kind].shown_unit, PARAMETERS[kind].shown_factor


def parameter_columns(names: Sequence[str], columns: dict[str, Any]) -> pd.DataFrame:
    """A table of parameters: name, kind, unit, and columns converted to that unit.

    **Arguments:**

    - `names`: of the parameters.
    - `columns`: values of the parameters, in their own units, by the name of the column.
    """
    units = [shown_unit(name) for name in names]
    factor = np.array([f for _, _, f in units])
    return pd.DataFrame(
        {
            "name": list(names),
            "kind": [kind for kind, _, _ in units],
            "unit": [unit for _, unit, _ in units],
            **{key: factor * np.asarray(value, float) for key, value in columns.items()},
        }
    )

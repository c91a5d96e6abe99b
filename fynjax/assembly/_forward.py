"""What the jobs on a plot's parameters share: the plot, its free parameters, a forward model."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import numpy as np
import pandas as pd

from fynjax.assembly._build import build_plot
from fynjax.inversion import COARSE, ParameterSpace, coarser, free_space
from fynjax.io.plot import Plot, drone_bands
from fynjax.scene import PARAMETERS, PlotModel, PlotParameters, parameter_kind
from fynjax.sensors import BandSet

STRIDE = 9
"""Every so many pixels are rendered, as in a calibration's search."""


class Prepared(NamedTuple):
    """A plot, ready to be asked."""

    plot: Plot
    model: PlotModel
    quick: PlotModel
    """The model that a search uses: coarse light, thick layers."""
    parameters: PlotParameters
    space: ParameterSpace


def prepare(
    plot: Plot,
    free: Sequence[str] | None,
    *,
    seed: int,
    bands: BandSet | None = None,
    drone: bool = True,
) -> Prepared:
    """Build a plot and its free parameters; `free` patterns replace those of its file.

    In `bands`; left out, those of its drone's camera, or of whatever its sensor is if no drone's
    image is asked for.
    """
    if bands is None and drone:
        bands = drone_bands(plot)
    model, parameters = build_plot(plot, seed=seed, bands=bands)
    patterns = plot.calibration.free if free is None else tuple(free)
    space = free_space(model, parameters, patterns, plot.calibration.relative_sd)
    return Prepared(plot, model, coarser(model, COARSE), parameters, space)


def batch_for_device() -> int | None:
    """Renders at once: as many as fit on an accelerator; on a processor one fills it."""
    return 1 if jax.default_backend() == "cpu" else None


def shown_unit(name: str) -> tuple[str, str, float]:
    """Kind, unit as field crews write it, and the factor to it, of a parameter."""
    kind = parameter_kind(name)
    return kind, PARAMETERS[kind].shown_unit, PARAMETERS[kind].shown_factor


def parameter_columns(names: Sequence[str], columns: dict[str, Any]) -> pd.DataFrame:
    """A table of parameters: name, kind, unit, and columns converted to that unit."""
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

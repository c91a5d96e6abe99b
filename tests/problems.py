"""Problems of tests: of parameters, data and views that no file states."""

import dataclasses
from collections.abc import Sequence
from typing import Any

from fynjax.inversion import (
    AbstractView,
    Calibration,
    CalibrationSettings,
    Data,
    ParameterSpace,
    PlotSearch,
    Problem,
    fit,
)
from fynjax.scene import ModelError, PlotParameters, Scene


def problem(
    scene: Scene,
    parameters: PlotParameters,
    data: Data | None,
    space: ParameterSpace,
    views: Sequence[AbstractView] | None,
    settings: CalibrationSettings | None = None,
    *,
    error: ModelError | None = None,
) -> Problem:
    """The problem of a scene with other `parameters`, as these views see it."""
    scene = dataclasses.replace(scene, parameters=parameters)
    return Problem(scene, data, space, views=views, settings=settings, error=error)


def calibrate_plot(*args: Any, error: Any = None, **options: Any) -> Calibration:
    """The calibration of such a problem; `options` of `fit`."""
    return fit(problem(*args, error=error), **options)


def search_of(*args: Any, solver: Any = None, error: Any = None) -> PlotSearch:
    """The search of such a problem."""
    return PlotSearch(problem(*args, error=error), solver)

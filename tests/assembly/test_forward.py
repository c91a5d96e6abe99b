"""What the jobs on a plot's parameters share."""

from types import SimpleNamespace
from typing import Any

from fynjax.app.assembly import Prepared
from fynjax.app.io.plot import CalibrationTable
from fynjax.inversion import CalibrationSettings


def test_a_search_has_the_steps_and_starts_of_the_plot_file():
    plot: Any = SimpleNamespace(calibration=CalibrationTable(max_iterations=7, starts=2))
    nothing: Any = None
    settings = Prepared(plot, nothing, nothing, nothing, 3).settings
    assert settings == CalibrationSettings(max_steps=7, starts=2, seed=3)

"""What the jobs on a plot's parameters share."""

from fynjax.app.assembly import plot_problem
from fynjax.app.io.plot import read_plot
from fynjax.inversion import CalibrationSettings
from tests.small import write_plot

MORE = """
[calibration]
free = ["ground.brightness"]
max_iterations = 7
starts = 2
"""


def test_a_search_has_the_steps_and_starts_of_the_plot_file(tmp_path):
    problem = plot_problem(read_plot(write_plot(tmp_path, MORE)), None, seed=3)
    assert problem.settings == CalibrationSettings(max_steps=7, starts=2, seed=3)

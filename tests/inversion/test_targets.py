"""Errors of the targets, and the jobs that read them."""

import numpy as np
import pytest

from fynjax._core.errors import InputError
from fynjax.assembly._targets import image_target
from fynjax.inversion import weigh_targets
from fynjax.io.plot import example_folder, read_plot


def test_spreads_and_repeated_ratios_weigh_less():
    names = ("green.mean", "green.std", "NDVI.mean", "SR.mean", "GNDVI.mean")
    data = weigh_targets(names, np.array([0.05, 0.02, 0.7, 6.0, -0.6]), 0.01)
    share = [0.01, 0.25, 0.01 * 2**0.5, 0.01 * 2**0.5, 0.01]
    np.testing.assert_allclose(data.sd, np.array(share) * [0.05, 0.02, 0.7, 6.0, 0.6])


def test_a_stated_error_is_kept():
    data = weigh_targets(("NDVI.mean", "SR.mean"), np.ones(2), 0.01, sd=np.array([0.3, np.nan]))
    np.testing.assert_allclose(data.sd, [0.3, 0.01 * 2**0.5])
    with pytest.raises(InputError, match="relative_sd"):
        weigh_targets(("NDVI.mean",), np.ones(1), 0.0)


def test_the_example_table_is_a_target_of_the_example_plot():
    """What the README has a new user type."""
    plot = read_plot(example_folder() / "plot.toml")
    data = image_target(plot, example_folder() / "statistics.csv").data
    assert data.names[:2] == ("green.mean", "red.mean")
    assert float(data.sd[0]) == pytest.approx(0.0003)

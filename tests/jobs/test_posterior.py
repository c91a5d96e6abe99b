"""The posterior of a small plot by chains, from end to end."""

import pandas as pd
import pytest

from fynjax.app.jobs import posterior
from tests.small import search_quickly, write_plot

pytestmark = pytest.mark.slow

MORE = """
[sensor]
pixel_m = 0.1
[calibration]
free = ["species.*.cover", "ground.brightness"]
max_iterations = 4
gain_sd = 0.05
gain_shared = 0.5
"""
TARGET = "statistic,value,sd\nred.mean,0.14,0.005\nnir.mean,0.27,0.008\n"


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    """Results and tables of a chain of a few steps, and of the same that went on."""
    pytest.importorskip("arviz", reason="the extra `posterior` is not installed")
    folder = tmp_path_factory.mktemp("posterior")
    path = write_plot(folder, MORE, voxel=0.2)
    target = folder / "target.csv"
    target.write_text(TARGET)
    found = []
    with pytest.MonkeyPatch.context() as patch:
        search_quickly(patch)
        for name, steps in (("few", 10), ("many", 6000)):
            (folder / name).mkdir()
            result = posterior(
                path, target, folder / name, method="emcee", target_size=400.0, max_steps=steps,
                checkpoint=folder / "kept", seed=0,
            )  # fmt: skip
            found.append((result, pd.read_csv(folder / name / "parameters.csv")))
    return found


def test_a_chain_says_honestly_whether_it_converged(runs):
    """Ten steps are too few, and the chain that went on from them is long enough."""
    (few, _), (many, table) = runs
    assert not few.converged
    assert few.status.startswith("not converged: chain shorter than 50 autocorrelation times")
    assert few.headline[-2].startswith("The chain is kept in")
    assert many.converged
    assert many.status == "ok"
    assert table["ess_bulk"].min() > 400.0
    assert table["r_hat"].max() < 1.05
    assert not any("chain is kept" in line for line in many.headline)


def test_intervals_of_a_chain_are_those_of_laplace_where_it_is_gaussian(runs):
    """Of a plot whose statistics are nearly linear over the posterior, in the units of the table:
    what the data know, and what they leave to the prior."""
    _, (many, table) = runs
    table = table.set_index("name")
    assert [row.name for row in many.parameters] == table.index.tolist()
    wide = table["laplace_q95"] - table["laplace_q05"]
    for end in ("q05", "q95"):
        assert ((table[end] - table[f"laplace_{end}"]).abs() < 0.1 * wide).all(), end
    brightness = table.loc["ground.brightness"]
    # Gains and the model's error of each band leave some of it open.
    assert brightness["constrained"] > 0.5
    assert wide["ground.brightness"] < 0.7 * (brightness["prior_q95"] - brightness["prior_q05"])
    cover = table.loc["species.Restio eleocharis.cover"]
    assert cover["constrained"] < 0.2
    assert cover["prior_q05"] == pytest.approx(cover["q05"], rel=0.15)

"""The jobs behind the commands, whole: a small plot rendered, and calibrated to its own image."""

import dataclasses
import json

import jax.numpy as jnp
import jsonschema
import numpy as np
import pytest

from fynjax._core.errors import InputError
from fynjax.io import example_folder, read_plot
from fynjax.report._jobs import _check_finite, _short_of_sites, run_calibrate, run_render
from tests.report.small import write_plot
from tests.scene.plots import small_parameters, small_plot

MORE = """
[sensor]
pixel_m = 0.1
[calibration]
free = ["species.*.cover", "ground.brightness"]
max_iterations = 3
"""


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    """(rendered summary, calibrated to that very image, calibrated to a table), and the folder."""
    folder = tmp_path_factory.mktemp("jobs")
    write_plot(folder, MORE)
    for name in ("render", "same", "table"):
        (folder / name).mkdir()
    rendered = run_render(folder / "plot.toml", folder / "render", seed=0)
    image = folder / "render" / "image.tif"
    same = run_calibrate(folder / "plot.toml", image, folder / "same", seed=0)
    # The statistics that the image was fitted to, so that nothing compiles again; two count.
    rows = []
    for s in same["statistics"]:
        if s["fitted"]:
            factor = {"nir.mean": 1.02, "red.mean": 1.1}.get(s["statistic"])
            sd = "" if factor else 1e3
            rows.append(f"{s['statistic']},{(factor or 1.0) * s['before']},{sd}")
    table = folder / "table.csv"
    table.write_text("statistic,value,sd\n" + "\n".join(rows) + "\n")
    other = run_calibrate(folder / "plot.toml", table, folder / "table", seed=0)
    return rendered, same, other, folder


def misfit(summary, when):
    rows = [s for s in summary["statistics"] if s["fitted"]]
    return sum(((s[when] - s["target"]) / s["target_sd"]) ** 2 for s in rows)


@pytest.mark.slow
def test_an_image_that_the_plot_explains_already_is_not_made_worse(runs):
    _, same, _, _ = runs
    assert misfit(same, "before") < 1e-3
    assert misfit(same, "after") <= misfit(same, "before") + 1e-9
    assert not same["converged"]
    assert "No step improved" in same["status"]


@pytest.mark.slow
def test_a_table_of_statistics_is_approached(runs):
    _, _, other, folder = runs
    assert misfit(other, "after") < 0.2 * misfit(other, "before")
    assert {"report.html", "parameters.csv", "run.nc"} <= set(other["files"])
    assert all((folder / "table" / name).stat().st_size for name in other["files"])
    schema = json.loads(
        (example_folder().parents[3] / "data_schemas" / "fit_result.schema.json").read_text("utf-8")
    )
    row = schema["$defs"]["StatisticSummary"]
    for statistic in json.loads(json.dumps(other["statistics"], default=float)):
        if np.isfinite(statistic["reference"] or 0.0):
            jsonschema.validate(statistic, row | {"$defs": schema["$defs"]})


def test_no_product_holds_nan():
    plot = read_plot(example_folder() / "plot.toml")
    _check_finite(jnp.ones((4, 2, 2)), plot)
    with pytest.raises(InputError, match="1 values of the rendered image are not finite"):
        _check_finite(jnp.ones((4, 2, 2)).at[1, 0, 1].set(jnp.nan), plot)


def test_plants_without_a_site_are_a_warning():
    model, parameters = small_plot(), small_parameters()
    assert _short_of_sites(model, parameters) == []
    species = dataclasses.replace(parameters.species, diameter=parameters.species.diameter * 0.5)
    crowded = dataclasses.replace(parameters, species=species)
    (first, *_) = _short_of_sites(model, crowded)
    assert first.startswith("Erica irregularis: the estimate asks for")

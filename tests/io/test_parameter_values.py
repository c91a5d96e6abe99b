"""A calibration's estimates, read back into a plot."""

import shutil

import pytest

from fynjax._core.errors import InputError
from fynjax.app.assembly._build import plot_parameters
from fynjax.app.io.plot import example_folder, read_plot
from fynjax.app.io.plot._parameter_values import with_parameter_table
from fynjax.scene import named_values

TABLE = """name,kind,unit,prior,prior_sd,estimate,sd,lower,upper,constrained
species.Erica irregularis.cover,cover,%,20,5,23.5,4,0,100,0.2
species.Erica irregularis.diameter,diameter,cm,40,10,36,8,1,90,0.1
species.Restio eleocharis.leaf.water,water,cm,0.02,0.01,0.03,0.01,0,0.1,0.3
ground.litter_fraction,litter_fraction,-,0.5,0.1,0.25,0.1,0,1,0.9
"""


@pytest.fixture(scope="module")
def plot():
    return read_plot(example_folder() / "plot.toml")


def test_estimates_replace_the_tables_numbers_and_nothing_else(plot, tmp_path):
    path = tmp_path / "parameters.csv"
    path.write_text(TABLE)
    before = plot_parameters(plot)
    after = named_values(with_parameter_table(before, plot.taxa, path), plot.taxa)
    changed = {
        name: float(after[name])
        for name, value in named_values(before, plot.taxa).items()
        if float(value) != float(after[name])
    }
    assert changed == pytest.approx(
        {
            "species.Erica irregularis.cover": 0.235,
            "species.Erica irregularis.diameter": 0.36,
            "species.Restio eleocharis.leaf.water": 0.03,
            "ground.litter_fraction": 0.25,
        }
    )


SLIPS = [
    ("name,estimate\nspecies.Erica.cover,1\n", "no parameter 'species.Erica.cover'.* Did you mean"),
    ("name,unit,estimate\nground.moisture,m,1\n", "expected moisture in - or %, but got 'm'"),
    ("name,estimate\nground.moisture,-0.1\n", "moisture from 0 to 1, but got -0.1"),
    ("name,unit,estimate\nspecies.Erica irregularis.cover,%,350\n", "cover from 0 to 100 %"),
    ("name,estimate\nspecies.Erica irregularis.cover,35\n", "expected the unit of cover, - or %"),
    ("name,estimate\nlight.sun_zenith,95\n", "sun_zenith from 0 to 89 "),
    ("name,estimate\nground.litter_fraction,.9\nground.char_fraction,.9\n", "sum to 1.8"),
    ("name,estimate\nground.moisture,nan\n", "estimate"),
    ("name,estimate\nground.moisture,1\nground.moisture,1\n", "is there twice"),
    ("name,value\nground.moisture,1\n", "expected a column 'estimate'"),
]


@pytest.mark.parametrize(("text", "words"), SLIPS)
def test_a_slip_is_explained(plot, tmp_path, text, words):
    path = tmp_path / "parameters.csv"
    path.write_text(text)
    with pytest.raises(InputError, match=words) as caught:
        with_parameter_table(plot_parameters(plot), plot.taxa, path)
    assert caught.value.file == path


def test_the_plot_file_names_the_table(tmp_path):
    folder = tmp_path / "plot"
    shutil.copytree(example_folder(), folder)
    path = folder / "plot.toml"
    path.write_text(path.read_text().replace("[scene]\n", '[scene]\nparameters = "p.csv"\n'))
    with pytest.raises(InputError, match="expected a table of parameters") as caught:
        read_plot(path)
    assert caught.value.column == "scene.parameters"
    (folder / "p.csv").write_text(TABLE)
    read = read_plot(path)
    assert read.parameters == folder / "p.csv"
    assert folder / "p.csv" in read.inputs

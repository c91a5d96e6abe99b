"""The line on where values of plants are from: the user's, learned, or assumed."""

from pathlib import Path

from fynjax.io.plot import plant_sources, read_plot, with_prior, write_prior
from tests.io.test_prior import prior_file
from tests.small import write_plot

SIZES = "Species, covers, diameters, heights: species.csv. "


def test_what_a_table_leaves_open_is_of_the_fynbos_plots(tmp_path: Path) -> None:
    plot = read_plot(write_plot(tmp_path))
    assert plant_sources(plot) == SIZES + (
        "Leaf area, dead tissue, clumping, leaf traits, bark: learned from 18 fynbos plots. "
        "Wood area: assumed by growth form."
    )


def test_what_is_stated_is_the_users_by_the_name_of_its_file(tmp_path: Path) -> None:
    """A species of two states its leaf area, a form was not in any of the 18 plots."""
    path = write_plot(tmp_path, '[ground]\nwood_brightness = 1.0\n[scene]\nparameters = "p.csv"\n')
    (tmp_path / "p.csv").write_text("name,estimate\n")
    path.write_text(path.read_text().replace("[ground]", 'leaf_table = "leaves.csv"\n[ground]', 1))
    (tmp_path / "leaves.csv").write_text(
        "taxon,chlorophyll,carotenoids,water,dry_matter\n*,40,8,0.01,0.01\n"
    )
    (tmp_path / "species.csv").write_text(
        "taxon,mean_diameter_cm,cover_percent,height_max_m,growth_form,leaf_area_index,"
        "wood_area_index\n"
        "Erica irregularis,40,30,0.6,rounded_shrub,3,0.2\n"
        "Azorella selago,30,15,0.2,cushion,,0.1\n"
    )
    assert plant_sources(read_plot(path)) == (
        "Species, covers, diameters, heights, leaf area (1 of 2 species), wood area: species.csv. "
        "Leaf area (1 of 2 species), dead tissue (1 of 2 species), clumping (1 of 2 species): "
        "assumed by growth form. Dead tissue (1 of 2 species), clumping (1 of 2 species): learned "
        "from 18 fynbos plots. Leaf traits: leaves.csv. Bark: plot.toml. Where p.csv has a value, "
        "it counts."
    )


def test_a_prior_of_ones_own_is_named(tmp_path: Path) -> None:
    write_prior(tmp_path / "heath.toml", prior_file())
    plot = with_prior(read_plot(write_plot(tmp_path)), tmp_path / "heath.toml")
    assert plant_sources(plot) == SIZES + (
        "Leaf area, dead tissue, clumping, bark: learned by heath.toml. Wood area: assumed by "
        "growth form. Leaf traits: learned from 18 fynbos plots."
    )

"""The line on where values of plants are from: the user's, learned, or assumed."""

from contextlib import nullcontext
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pandas as pd
import pytest
from rasterio import Affine

import fynjax as fx
from fynjax._core.errors import InputError
from fynjax.app.assembly import placed_by_image, plot_parameters
from fynjax.app.assembly._forward import _prior_sd
from fynjax.app.io.plot import (
    DEFAULT_PRIOR,
    plant_sources,
    plot_spreads,
    read_plot,
    read_prior,
    with_prior,
    write_prior,
)
from fynjax.canopy import FORMS
from fynjax.scene import USUAL_LEAF, GroundParameters
from fynjax.scene._species import SHRUB_LEAF, SHRUB_LEAF_SD, usual_leaf
from tests.helpers import write_raster
from tests.io.test_prior import prior_file
from tests.small import SPECIES, write_plot

OF_FYNBOS = 'plants = "fynbos"\n'
SIZES = "Species, covers, diameters, heights: species.csv. "


def test_what_a_table_leaves_open_is_of_the_fynbos_plots(tmp_path: Path) -> None:
    plot = read_plot(write_plot(tmp_path))
    assert plant_sources(plot) == SIZES + (
        "Leaf area, dead tissue, clumping, leaf traits, bark: learned from 18 fynbos plots. "
        "Wood area: assumed by growth form. No place is stated, so the plot is taken for fynbos: "
        'of another shrubland write plants = "generic" under [plot].'
    )


def test_what_is_stated_is_the_users_by_the_name_of_its_file(tmp_path: Path) -> None:
    """A species of two states its leaf area, a form was not in any of the 18 plots."""
    path = write_plot(
        tmp_path, OF_FYNBOS + '[ground]\nwood_brightness = 1.0\n[scene]\nparameters = "p.csv"\n'
    )
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
    plot = with_prior(read_plot(write_plot(tmp_path, OF_FYNBOS)), tmp_path / "heath.toml")
    assert plant_sources(plot) == SIZES + (
        "Leaf area, dead tissue, clumping, bark: learned by heath.toml. Wood area: assumed by "
        "growth form. Leaf traits: learned from 18 fynbos plots."
    )


PLACE = "[sun]\nlatitude_deg = {}\nlongitude_deg = {}\ntime = 2024-09-15T12:00:00+{:02d}:00\n"


@pytest.mark.parametrize(
    ("north", "east", "hours", "plants"),
    [
        (53.0, 10.0, 1, "generic"),  # a German heath
        (-34.5, 19.4, 1, "fynbos"),  # Grootbos
        (-33.9, 151.2, 10, "generic"),  # Sydney
        (-29.0, 20.0, 1, "generic"),  # north of the Cape
    ],
)
def test_place_says_of_what_shrubland_plants_are(
    tmp_path: Path, north: float, east: float, hours: int, plants: str
) -> None:
    plot = read_plot(write_plot(tmp_path, PLACE.format(north, east, hours)))
    assert plot.shrubland == plants
    line, at_large = plant_sources(plot), "Leaf area, dead tissue, leaf traits: medians of shrubl"
    assert (at_large in line) == ("lies outside the Cape" in line) == (plants == "generic")
    assert "No place is stated" not in line


@pytest.mark.parametrize(
    ("crs", "corner", "plants"),
    [("EPSG:32632", (5.7e5, 5.87e6), "generic"), ("EPSG:32734", (3.5e5, 6.18e6), "fynbos"),
     ("EPSG:4326", (10.0, 53.0), "generic"), (None, (0.0, 0.0), "fynbos")],
)  # fmt: skip
def test_maps_and_the_image_say_where_a_plot_is(tmp_path, crs, corner, plants):
    side = 1e-6 if crs == "EPSG:4326" else 0.1
    place = Affine(side, 0, corner[0], 0, -side, corner[1] + 20 * side)
    image = np.ones((1, 20, 20), np.uint8)
    write_raster(tmp_path / "map.tif", image, crs=crs, transform=place)
    path = write_plot(tmp_path)
    assert read_plot(path).place_deg is None
    with_map = placed_by_image(read_plot(path), [tmp_path / "a.csv", tmp_path / "map.tif"])
    assert with_map.shrubland == plants
    map_key = f'probability_map = "map.tif"\nmap_origin_m = [{corner[0]}, {corner[1]}]\n'
    assert read_plot(write_plot(tmp_path, map_key)).place_deg == with_map.place_deg
    if crs == "EPSG:32632":  # (53.0, 10.0) by the formulas of UTM
        assert with_map.place_deg == pytest.approx((52.98, 10.04), abs=0.01)
    said = read_plot(write_plot(tmp_path, "latitude_deg = 53.0\nlongitude_deg = 10.0\n"))
    assert (said.shrubland, said.place_deg) == ("generic", (53.0, 10.0))
    far = crs == "EPSG:32734"
    with (
        pytest.warns(UserWarning, match=r"map\.tif lies at -34\.5.*km from the plot")
        if far
        else (nullcontext())
    ):
        assert placed_by_image(said, [tmp_path / "map.tif"]).place_deg == said.place_deg
    for keys, word in (("latitude_deg = 53.0\n", "longitude_deg is missing"),
                       ("latitude_deg = 1.0\nlongitude_deg = 2.0\n" + PLACE.format(1, 2, 0),
                        "but got both")):  # fmt: skip
        with pytest.raises(InputError, match=word):
            read_plot(write_plot(tmp_path, keys))


def test_the_users_word_comes_before_the_place(tmp_path: Path) -> None:
    path = write_plot(tmp_path, 'plants = "fynbos"\n' + PLACE.format(53.0, 10.0, 1))
    with pytest.warns(UserWarning, match=r"outside the Cape, at 53\.00, 10\.00"):
        stated = read_plot(path)
    assert stated.shrubland == "fynbos"
    assert plant_sources(stated).endswith("Wood area: assumed by growth form.")
    plot = read_plot(write_plot(tmp_path, 'plants = "generic"\n'))
    assert plot.shrubland == "generic"
    assert plant_sources(plot) == SIZES + (
        "Leaf area, dead tissue, leaf traits: medians of shrublands at large, published where "
        "known. Clumping: assumed as in fynbos. Wood area: assumed by growth form. Bark: the "
        "shipped spectrum."
    )
    with pytest.raises(InputError, match="fynbos"):
        read_plot(write_plot(tmp_path, 'plants = "heath"\n'))


def test_generic_plants_are_those_of_their_sources(tmp_path: Path) -> None:
    """Green leaf area over a ground three quarters under crowns: 2.08 of shrublands, 1.71 of
    grasslands (Asner et al. 2003). Dead share between 5 years at average mortality and 40 at severe
    (Rothermel and Philpot 1973). What is stated stays."""
    path = write_plot(tmp_path, 'plants = "generic"\n')
    table = SPECIES.replace("form\n", "form,shoot_clumping\n").replace("shrub\n", "shrub,0.33\n")
    (tmp_path / "species.csv").write_text(table.replace("tussock\n", "tussock,\n"))
    plot = read_plot(path)
    species, leaf = (p := plot_parameters(plot)).species, p.leaf
    green = 0.75 * np.asarray(species.leaf_area_index * (1.0 - species.dead_fraction))
    np.testing.assert_allclose(green, [2.08, 1.71], rtol=0.05)
    assert species.shoot_clumping[0] == pytest.approx(0.33)
    assert p.ground.wood_brightness == 1.0
    assert leaf.dry_matter[0] == pytest.approx(SHRUB_LEAF.dry_matter)
    least, most = 0.0694 * np.exp(0.0402 * 5), 0.1094 * np.exp(0.0385 * 40)
    median, sd = FORMS["rounded_shrub"].generic.dead_fraction
    spread = sd / (median * (1.0 - median)) * np.array([-1.645, 1.645])
    interval = 1.0 / (1.0 + np.exp(-spread) * (1.0 / median - 1.0))
    np.testing.assert_allclose(interval, [least, most], atol=0.035)
    names = "leaf_area_index", "shoot_clumping", "leaf.dry_matter"
    found = [
        _prior_sd(plot, f"species.Erica irregularis.{name}", plot_spreads(plot)) for name in names
    ]
    assert found == pytest.approx([2.6 / 3.5, 0.3, 0.6])  # stated clumping has its record's
    assert _prior_sd(
        plot, "species.Restio eleocharis.shoot_clumping", plot_spreads(plot)
    ) == pytest.approx(0.9)
    calm = plot.replace(calibration=plot.calibration.replace(priors={"*.leaf_area_index": 0.1}))
    assert _prior_sd(calm, "species.Erica irregularis.leaf_area_index", plot_spreads(calm)) == 0.1


def test_generic_priors_are_wider_than_those_of_fynbos() -> None:
    fynbos = read_prior(DEFAULT_PRIOR)
    for name in fynbos.forms:
        for kind in ("dead_fraction", "leaf_area_index", "shoot_clumping"):
            median, sd = getattr(FORMS[name].generic, kind)
            learned = fynbos.values()[f"{kind}.{name}"]
            stretch = [m * (1.0 - m) if kind == "dead_fraction" else m for m in (median, learned)]
            narrow = fynbos.sd(f"{kind}.{name}", elsewhere=True) / stretch[1]
            assert sd / stretch[0] > narrow, (name, kind)
    assert FORMS["column"].generic is None


def test_the_leaf_of_shrubs_at_large_is_the_median_of_measured_species(shared_data: Path) -> None:
    shrubs = (
        "Arctostaphylos|Baccharis|Callicarpa|Ceanothus|Chamaerops|Cornus|Corylus|Cotinus|Euonymus|"
        "Heteromeles|Hydrangea|Ilex|Prunus laurocerasus|Rhododendron|Salvia|Viburnum"
    )
    tables = [
        pd.read_csv(shared_data / "leaf" / f"{name}_chemistry.csv.gz").rename(
            columns={"species_guess": "species"}
        )
        for name in ("california_asd", "angers", "lopex")
    ]
    leaves = pd.concat(tables)
    leaves = leaves[leaves["species"].str.contains(shrubs)]
    taxon = leaves["species"].str.split().str[:2].str.join(" ")
    species = leaves.groupby(taxon)[["cab", "car", "ewt", "lma"]].median()
    assert len(species) == 22
    names = ["chlorophyll", "carotenoids", "water", "dry_matter"]
    stated = [getattr(SHRUB_LEAF, name) for name in names]
    np.testing.assert_allclose(species.median(), stated, rtol=0.01)
    green = species.where(~(species["cab"] < 15.0))
    np.testing.assert_allclose(
        np.log(green).std(), [SHRUB_LEAF_SD[name] for name in names], atol=0.06
    )


def test_a_heath_is_as_green_as_heaths_are() -> None:
    """Projected covers of 82 and 20 %, together 86 % of the ground, on dark, littered sand: an NDVI
    of 0.6 to 0.8, as heaths commonly have in summer."""
    table = {
        "taxon": ["Calluna vulgaris", "Deschampsia flexuosa"],
        "growth_form": ["upright_ericoid", "tussock"],
        "mean_diameter_cm": [40, 20],
        "cover_percent": [82, 20],
        "height_max_m": [0.5, 0.4],
    }
    ground = GroundParameters(
        wood_brightness=jnp.asarray(1.0),
        brightness=jnp.asarray(0.6),
        litter_fraction=jnp.asarray(0.6),
    )
    found = {}
    for plants in ("fynbos", "generic"):
        scene = fx.Scene.from_table(
            table, size=2.0, voxel=0.1, structure="even", plants=plants, ground=ground
        )
        seen = fx.observe(scene, "mavic_3m")
        red, nir = (float(np.mean(seen[band])) for band in ("red", "nir"))
        found[plants] = (nir - red) / (nir + red)
    assert 0.6 < found["generic"] < 0.8
    assert found["generic"] - found["fynbos"] > 0.1


@pytest.mark.parametrize("plants", ["fynbos", "generic"])
def test_a_form_that_no_plot_had_has_a_leaf_of_its_own(plants: str) -> None:
    """Area, mass and water of what it states: a leaf of 2 mm of water is that thick, less its
    roundness; moss is thin and pale."""
    thick, thin = (usual_leaf(form, plants) for form in ("succulent", "moss_layer"))
    assert 1e4 * thick.dry_matter * np.pi / 2 == pytest.approx(150.0)
    assert thick.water / (thick.water + thick.dry_matter) == pytest.approx(0.91)
    assert pytest.approx(2 * thick.water, rel=0.05) == 0.2
    assert thin.dry_matter == pytest.approx(0.004)
    assert thin.chlorophyll == 15.0
    assert usual_leaf("tussock", plants) == (SHRUB_LEAF if plants == "generic" else USUAL_LEAF)

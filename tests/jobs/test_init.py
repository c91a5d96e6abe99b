"""A plot file from a table of one's own, a place, an image and leaf spectra."""

import csv
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pytest
import rasterio
from rasterio import Affine

from fynjax._core.errors import InputError
from fynjax.app.io.plot import HEATH_PLACE, HEATH_TABLE, read_plot
from fynjax.app.jobs import init_from_table
from fynjax.sensors import sun_position

GARRIGUE = (43.75, 3.70)
BANDS = ("Blue", "Green", "Red", "NIR", "RedEdge")


def table(folder: Path) -> Path:
    path = folder / "releve.csv"
    path.write_text(
        "Espèce;Recouvrement (%);Hauteur (cm);Remarque\nQuercus coccifera;45;90;dense, clair\n"
        "Thymus vulgaris;+;20;\nsol nu;30;;\nlitière;10;;\n",
        "utf-8",
    )
    return path


def image(folder: Path, names=BANDS, pixel=0.04, **tags: str) -> Path:
    """An orthophoto near Montpellier, in UTM zone 31."""
    path = folder / "ortho.tif"
    transform = Affine(pixel, 0, 556370.0, 0, -pixel, 4844330.0)
    profile = {
        "driver": "GTiff",
        "width": 30,
        "height": 30,
        "count": len(names),
        "dtype": "float32",
    }
    with rasterio.open(path, "w", crs="EPSG:32631", transform=transform, **profile) as file:
        file.write(np.full((len(names), 30, 30), 0.2, np.float32))
        file.descriptions = names
        file.update_tags(**tags)
    return path


def test_table_place_image_and_leaves_make_a_plot(tmp_path: Path) -> None:
    (tmp_path / "mine").mkdir()
    for taxon in ("Quercus coccifera", "thymus_vulgaris"):
        leaf = "wavelength_nm,reflectance\n400,0.05\n800,0.45\n"
        (tmp_path / "mine" / f"{taxon} 01.csv").write_text(leaf)
    ortho = image(tmp_path, TIFFTAG_DATETIME="2024:06:01 10:30:00")
    made = init_from_table(
        tmp_path / "plot", table(tmp_path), image=ortho, leaves=tmp_path / "mine", seed=4
    )
    said = " ".join(made.headline)
    plot = read_plot(tmp_path / "plot" / "plot.toml")
    assert (plot.shrubland, plot.plants, plot.cover_definition) == (
        "generic",
        "generic",
        "projected",
    )
    assert plot.place_deg == pytest.approx(GARRIGUE, abs=0.01)
    assert (plot.sensor.name, plot.sensor.pixel_m) == ("rededge_3", 0.04)
    assert plot.sensor.altitude_m == pytest.approx(58.7, abs=0.2)  # 5.5 mm, 3.75 um: 0.04 m
    assert "whose zone is not stated" in said
    (time,) = [line for line in (tmp_path / "plot/plot.toml").read_text("utf-8").splitlines()
               if line.startswith("time = ")]  # fmt: skip
    assert time.split()[2] == "2024-06-01T10:30:00+00:00"
    assert plot.sun.zenith == pytest.approx(26.4, abs=0.3)  # hour angle -18.3 degrees
    assert set(plot.leaf_files) == {"Quercus coccifera", "Thymus vulgaris"}
    assert plot.ground.litter_fraction == 0.25  # of what is no plant
    assert plot.seed == 4
    assert "FYNBOS" not in (tmp_path / "plot" / "plot.toml").read_text("utf-8").splitlines()[0]
    lines = (tmp_path / "plot" / "species.csv").read_text("utf-8").splitlines()
    rows = list(csv.DictReader(line for line in lines if not line.startswith("#")))
    assert rows[0]["note_Remarque"] == "dense, clair"
    assert rows[1]["cover_percent"] == "+"
    assert rows[1]["note_growth_form_by"] == "genus"
    assert rows[1]["note_assumed"] == "mean_diameter_cm"


def test_covers_of_a_table_with_packing_are_those_of_the_article(tmp_path) -> None:
    """As of any species table; the table's packing is kept, and the plot file reads."""
    path = tmp_path / "packed.csv"
    path.write_text(
        "taxon;Recouvrement (%);Diamètre (cm);Hauteur (cm);growth_form;packing_percent\n"
        "Erica arborea;60;80;120;upright_ericoid;40\n",
        "utf-8",
    )
    made = init_from_table(tmp_path / "plot", path, place=GARRIGUE)
    plot = read_plot(tmp_path / "plot" / "plot.toml")
    assert plot.cover_definition == "article"
    assert plot.species[0].packing == pytest.approx(0.4)
    assert "those of the article" in " ".join(made.headline)


@pytest.mark.parametrize(
    ("names", "tags", "sensor"),
    [(("green", "red", "red_edge", "nir"), {}, "mavic_3m"), (BANDS, {}, "rededge_3"),
     (("B1 475", "B2 560", "B3 668", "B4 717", "B5 840"), {}, "rededge_3"),
     (("a", "b", "c"), {}, None)],
)  # fmt: skip
def test_the_camera_is_that_with_the_bands_of_the_image(tmp_path, names, tags, sensor) -> None:
    made = init_from_table(tmp_path / "p", table(tmp_path), image=image(tmp_path, names, **tags))
    said = " ".join(made.headline)
    assert (f"Camera: {sensor}" if sensor else "No shipped sensor has the bands") in said
    assert read_plot(tmp_path / "p/plot.toml").sensor.name == (sensor or "mavic_3m")


@pytest.mark.parametrize(
    ("tag", "time", "is_one"),
    [("acquisition_time", "2024:06:01 12:00:00+02:00", True),
     ("acquisition_time", "2024-06-01T10:00:00Z", True),
     ("TIFFTAG_DATETIME", "2024:06:01 10:00:00", True),
     ("TIFFTAG_DATETIME", "2024:06:01 23:30:00", False),
     ("TIFFTAG_DATETIME", "2024:06:01 00:00:00", False),
     ("TIFFTAG_DATETIME", "yesterday", False)],
)  # fmt: skip
def test_the_time_of_an_image(tmp_path: Path, tag: str, time: str, is_one: bool) -> None:
    """The sun of 1 June at 10 h UTC by spherical trigonometry: declination 22, hour angle -25.7
    degrees; without a time that of the equinox's noon."""
    ortho = image(tmp_path, **{tag: time})
    made = init_from_table(tmp_path / "p", table(tmp_path), image=ortho)
    plot = read_plot(tmp_path / "p" / "plot.toml")
    noon = sun_position(*GARRIGUE, _equinox())
    assert plot.sun.zenith == pytest.approx(30.5 if is_one else noon.zenith, abs=0.5)
    assert plot.place_deg == pytest.approx(GARRIGUE, abs=0.01)
    assert any("time" in line.lower() for line in made.headline)


def _equinox() -> datetime:
    return datetime(2024, 3, 20, 12, tzinfo=UTC) - timedelta(hours=GARRIGUE[1] / 15.0)


def test_the_place_says_whose_plants_they_are(tmp_path: Path) -> None:
    for name, place, prior, plants in (
        ("a", (-34.0, 19.0), None, "fynbos"), ("b", (-34.0, 19.0), "none", "generic"),
        ("c", GARRIGUE, None, "generic"), ("d", None, None, "generic"),
    ):  # fmt: skip
        init_from_table(tmp_path / name, HEATH_TABLE, place=place, prior=prior)
        plot = read_plot(tmp_path / name / "plot.toml")
        assert (plot.plants, plot.shrubland) == (plants, plants)
        assert plot.species[0].leaf_area_index is None
    made = init_from_table(tmp_path / "e", HEATH_TABLE, place=HEATH_PLACE, prior="fynbos_2023")
    assert any("outside the Cape" in one for one in made.warnings)
    assert read_plot_quietly(tmp_path / "e").species[0].leaf_area_index == pytest.approx(3.69)


def read_plot_quietly(folder: Path):
    with pytest.warns(UserWarning, match="outside the Cape"):
        return read_plot(folder / "plot.toml")


def test_what_cannot_be_is_refused(tmp_path: Path) -> None:
    for place, words in (
        ((3.70, 143.75), "143.75"), ((143.75, 3.70), r"Longitude first\? Write 3.7,143.75"),
        ((3.70, 43.75), "Longitude first"), ((48.2, -3.4), "Give that, or another image"),
    ):  # fmt: skip
        with pytest.raises(InputError, match=words):
            init_from_table(tmp_path / "p", table(tmp_path), place=place, image=image(tmp_path))
    with pytest.raises(InputError, match="expected a folder of leaf spectra, but this is a file"):
        init_from_table(tmp_path / "p", table(tmp_path), leaves=HEATH_TABLE)
    assert not (tmp_path / "p").exists()
    init_from_table(tmp_path / "p", table(tmp_path))
    with pytest.raises(InputError, match="overwrites nothing"):
        init_from_table(tmp_path / "p", table(tmp_path))


def test_doubts_of_the_table_are_told_with_those_of_the_plot(tmp_path: Path) -> None:
    plants = tmp_path / "table.csv"
    plants.write_text("taxon,cover\nErica a,3\nErica b,2\nErica c,1\n", "utf-8")
    made = init_from_table(tmp_path / "plot", plants)  # a warning would be an error here
    assert any("covers of 3, 2, 1 are taken for percent" in one for one in made.warnings)


def test_leaves_of_taxa_with_authors_and_the_way_to_an_image_of_integers(tmp_path: Path) -> None:
    plants = tmp_path / "matorral.csv"
    plants.write_text(
        "Especie;Cobertura (%)\nLithraea caustica (Molina) Hook. & Arn.;40\n"
        "Puya chilensis Molina;5\nErica sp. 1;3\n",
        "utf-8",
    )
    (tmp_path / "hojas").mkdir()
    for name in ("Lithraea_caustica_001", "Erica_sp_2_001"):
        leaf = "wavelength_nm,reflectance\n400,0.05\n800,0.45\n"
        (tmp_path / "hojas" / f"{name}.csv").write_text(leaf)
    ortho = image(tmp_path)
    made = init_from_table(tmp_path / "plot", plants, image=ortho, leaves=tmp_path / "hojas")
    with pytest.warns(UserWarning, match="Erica_sp_2_001"):
        leaf_files = read_plot(tmp_path / "plot" / "plot.toml").leaf_files
    assert list(leaf_files) == ["Lithraea caustica (Molina) Hook. & Arn."]
    assert "such as 'Erica_sp_2_001.csv'" in " ".join(made.warnings)
    assert "integers" not in " ".join(made.headline)
    for name in ("README.txt", "plot.toml"):
        assert "--target ../ortho.tif" in (tmp_path / "plot" / name).read_text("utf-8")
    (tmp_path / "hojas" / "Lithraea_caustica_001.csv").unlink()
    with pytest.raises(InputError, match="begin with a taxon") as caught:
        init_from_table(tmp_path / "other", plants, leaves=tmp_path / "hojas")
    assert caught.value.file == tmp_path / "hojas"
    with rasterio.open(ortho) as file:
        profile = {**file.profile, "dtype": "uint16"}
    with rasterio.open(ortho, "w", **profile) as file:
        file.write(np.full((profile["count"], 30, 30), 2000, np.uint16))
    again = init_from_table(tmp_path / "again", plants, image=ortho)
    assert "The image holds integers and states no scale" in " ".join(again.headline)

"""Tables of crowns: the plants that they give, and what is wrong with them."""

import numpy as np
import pytest

from fynjax._core.errors import InputError, MissingExtraError
from fynjax.app.io.plot import read_plot
from tests.small import PLOT, SPECIES

CROWNS = """taxon,x_m,y_m,diameter_cm,height_m
Erica irregularis,0.5,0.5,40,0.6
Erica irregularis,1.5,0.6,30,0.4
Restio eleocharis,1.0,1.5,30,0.5
"""


def write(folder, crowns=CROWNS, name="crowns.csv", more=""):
    path = folder / "plot.toml"
    path.write_text(f'{PLOT}crowns = "{name}"\n{more}')
    (folder / "species.csv").write_text(SPECIES)
    if isinstance(crowns, str):
        (folder / name).write_text(crowns)
    return path


def test_crowns_replace_covers_and_sizes_of_the_species_table(tmp_path):
    plot = read_plot(write(tmp_path, CROWNS.rsplit("Restio", 1)[0]))
    erica, restio = plot.species
    assert erica.cover == pytest.approx(np.pi / 4 * (0.4**2 + 0.3**2) / 4.0)
    assert erica.diameter == pytest.approx(np.sqrt((0.4**2 + 0.3**2) / 2))
    assert erica.height == 0.6
    assert (restio.cover, restio.diameter) == (0.0, 0.3)
    assert plot.crowns_note is not None
    assert "by up to 25 percentage points, 12 and 0 %" in plot.crowns_note
    assert "without plants: Restio eleocharis" in plot.crowns_note
    assert tmp_path / "crowns.csv" in plot.inputs


def test_projected_covers_of_crowns_count_overlap_once(tmp_path):
    """Two crowns of 40 cm with their middles 20 cm apart: a lens of 0.39 of a disc counts once."""
    crowns = "\n".join(
        [CROWNS.splitlines()[0], *(f"Erica irregularis,{x},0.5,40,0.6" for x in (0.5, 0.7))]
    )
    path = write(tmp_path, crowns + "\n")
    path.write_text(path.read_text().replace('"article"', '"projected"'))
    lens = 2 * 0.2**2 * np.arccos(0.5) - 0.1 * np.sqrt(4 * 0.2**2 - 0.2**2)
    covered = (2 * np.pi * 0.2**2 - lens) / 4.0
    assert read_plot(path).species[0].cover == pytest.approx(covered, rel=0.02)


def test_map_coordinates_count_from_the_corner_that_the_plot_file_states(tmp_path):
    on_map = CROWNS.replace("x_m,y_m", "easting_m,northing_m")
    for x in ("0.5", "1.5", "1.0"):
        on_map = on_map.replace(f",{x},", f",{500000 + float(x)},", 1)
    stated = read_plot(write(tmp_path, on_map, more="map_origin_m = [500000.0, 0.0]\n"))
    np.testing.assert_allclose(stated.known_crowns.foot[:, 0], [0.5, 1.5, 1.0])
    with pytest.raises(InputError, match="map_origin_m of the plot file"):
        read_plot(write(tmp_path, on_map))


DAMAGED = {
    "another taxon": ("Restio eleocharis,", "Restio elocharis,", 4, "taxon", "Did you mean"),
    "outside": (",1.0,1.5,", ",1.0,2.5,", 4, "y_m", "0 to below 2 m"),
    "no size": (",30,0.4", ",0,0.4", 3, "diameter_cm", "from 1 to 1000 cm, but got 0"),
    "negative height": (",0.5\n", ",-0.5\n", 4, "height_m", "0.01 to 20 m"),
    "metres": (",40,", ",0.4,", 2, "diameter_cm", "Metres"),
    "wider than the plot": (",40,", ",400,", 2, "diameter_cm", "smaller than the plot"),
    "above the sensor": (",40,0.6", ",40,19", 2, "height_m", "below the sensor"),
    "a cell of text": (",40,0.6", ",wide,0.6", 2, "diameter_cm", "but got 'wide'"),
    "no place": (",0.5,0.5,", ",0.5,,", 2, None, "x_m and y_m"),
    "twice": ("1.5,0.6,30,0.4", "0.5,0.5,30,0.4", 3, None, "in row 2 already"),
    "map coordinates": (",0.5,0.5,", ",500000.5,0.5,", 2, "x_m", "easting_m"),
}


@pytest.mark.parametrize("damage", DAMAGED)
def test_a_damaged_table_ends_with_the_cell(tmp_path, damage):
    before, after, row, column, says = DAMAGED[damage]
    assert before in CROWNS
    sensor = "[sensor]\naltitude_m = 15.0\n"
    with pytest.raises(InputError, match=says) as caught:
        read_plot(write(tmp_path, CROWNS.replace(before, after, 1), more=sensor))
    assert (caught.value.row, caught.value.column) == (row, column)
    assert caught.value.file == tmp_path / "crowns.csv"


def geopackage(path, shapes, crs=None, **columns):
    import pyogrio
    import shapely

    pyogrio.raw.write(
        path,
        shapely.to_wkb(np.array(shapes, object)),
        [np.array(values) for values in columns.values()],
        list(columns),
        geometry_type="Unknown",
        crs=crs,
        driver="GPKG",
    )


@pytest.mark.filterwarnings("ignore:'crs' was not provided:UserWarning")
def test_a_geopackage_of_polygons_and_points(tmp_path):
    pyogrio = pytest.importorskip("pyogrio")
    shapely = pytest.importorskip("shapely")
    square = shapely.box(500000.3, 6000000.3, 500000.7, 6000000.7)
    taxon, height = ["Erica irregularis"], [0.5]
    place = "map_origin_m = [500000.0, 6000000.0]\n"
    geopackage(tmp_path / "map.gpkg", [square], "EPSG:32734", taxon=taxon, height_m=height)
    crowns = read_plot(write(tmp_path, None, "map.gpkg", place)).known_crowns
    np.testing.assert_allclose(crowns.foot, [[0.5, 0.5]], atol=1e-6)
    np.testing.assert_allclose(crowns.diameter, 2 * np.sqrt(0.16 / np.pi))
    columns = {"taxon": taxon, "height_m": height, "diameter_cm": [35.0], "note": ["old"]}
    geopackage(tmp_path / "own.gpkg", [shapely.Point(1.5, 0.25)], **columns)
    crowns = read_plot(write(tmp_path, None, "own.gpkg")).known_crowns
    np.testing.assert_allclose([*crowns.foot[0], *crowns.diameter], [1.5, 0.25, 0.35])
    geopackage(tmp_path / "bad.gpkg", [shapely.Point(9, 9)], **columns)
    with pytest.raises(InputError, match="0 to below 2 m"):
        read_plot(write(tmp_path, None, "bad.gpkg"))
    geopackage(tmp_path / "degrees.gpkg", [shapely.Point(19, -34)], "EPSG:4326", **columns)
    with pytest.raises(InputError, match="degrees"):
        read_plot(write(tmp_path, None, "degrees.gpkg"))
    (tmp_path / "none.gpkg").write_bytes(b"no database")
    with pytest.raises(InputError, match="GeoPackage") as caught:
        read_plot(write(tmp_path, None, "none.gpkg"))
    assert "DRIVER" not in str(caught.value)  # advice of the library, which has none for a user
    (tmp_path / "none.gpkg").write_text(
        f"<OGRVRTDataSource><OGRVRTLayer name='own'><SrcDataSource>{tmp_path / 'own.gpkg'}"
        "</SrcDataSource></OGRVRTLayer></OGRVRTDataSource>"
    )
    assert len(pyogrio.list_layers(tmp_path / "none.gpkg")) == 1  # GDAL follows it
    with pytest.raises(InputError, match="GeoPackage, but it is none"):
        read_plot(write(tmp_path, None, "none.gpkg"))


def test_a_geopackage_asks_for_the_packages_that_read_it(tmp_path, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "pyogrio", None)
    with pytest.raises(MissingExtraError, match=r"fynjax\[tables\]"):
        read_plot(write(tmp_path, "", "crowns.gpkg"))

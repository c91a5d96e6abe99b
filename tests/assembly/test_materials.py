"""Materials of meshes and of the leaf table of a plot, from files."""

import gzip
import shutil
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from fynjax.app.assembly import build_plot
from fynjax.app.io.plot import read_plot
from fynjax.app.io.spectra import read_spectra_file
from fynjax.app.jobs._build import voxel_dataset
from fynjax.app.jobs._plant import plant
from fynjax.canopy import PlantMesh, generate_plant
from fynjax.errors import InputError
from fynjax.leaf import LeafParameters, prospect
from fynjax.scene import USUAL_LEAF, material_classes
from fynjax.sensors import shipped_sensor

BANDS = shipped_sensor("mavic_3m").bands
TOML = '[plot]\nsize_m = 1.0\nvoxel_m = 0.25\nstructure_m = "even"\nleaf_table = "leaves.csv"\n'
SPECIES = """taxon,mean_diameter_cm,cover_percent,height_max_m,growth_form,plant
Erica,60,40,0.7,rounded_shrub,elements.csv
Protea,40,20,0.6,broad_leaved,
"""
MATERIALS = """material,organ,optics
upper,leaf,young
lower,leaf,old
stems,wood,
petals,flower,petal
"""
LEAVES = """taxon,material,chlorophyll,water
*,,40,
Erica,young,15,0.01
*,old,80,
Erica,petal,2,
"""


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The area elements of a shrub with young and old leaves, made by the command."""
    folder = tmp_path_factory.mktemp("shrub")
    grown = generate_plant(
        "rounded_shrub", 3, diameter=0.6, height=0.7, flowering=1.0, max_triangles=4000
    ).mesh
    kind = np.array([{"leaf": 1, "wood": 2, "flower": 3}[n] for n in grown.materials])
    kind = kind[grown.material]
    kind = np.where((kind == 1) & (grown.triangles[..., 2].mean(axis=1) > 0.45), 0, kind)
    names = ("upper", "lower", "stems", "petals")
    mesh = PlantMesh(grown.vertices, grown.faces, kind, names)
    for name, text in zip(("shrub.obj", "shrub.mtl"), mesh.obj("shrub.mtl"), strict=True):
        (folder / name).write_text(text)
    (folder / "materials.csv").write_text(MATERIALS)
    plant(str(folder / "shrub.obj"), folder, materials=folder / "materials.csv", n_elements=300)
    return folder


def write(folder: Path, made: Path, leaves: str = LEAVES, species: str = SPECIES) -> Path:
    for name in ("elements.csv", "shrub.obj", "shrub.mtl"):
        shutil.copy(made / name, folder)
    (folder / "species.csv").write_text(species)
    (folder / "leaves.csv").write_text(leaves)
    (folder / "plot.toml").write_text(TOML)
    return folder / "plot.toml"


def image_of(path: Path) -> np.ndarray:
    scene, parameters = build_plot(read_plot(path))
    voxels = scene.voxels(parameters, BANDS)
    # Green of the plot's leaves and stems: what a class reflects times its area.
    area = np.asarray(voxels.area_density).sum(axis=(1, 2, 3))
    return area @ np.asarray(voxels.classes.reflectance)


def test_optics_of_materials_are_those_of_the_leaf_table(made: Path, tmp_path: Path) -> None:
    scene, parameters = build_plot(read_plot(write(tmp_path, made)))
    assert parameters.materials is not None
    names = ("species.Erica.young", "species.Erica.old", "species.Erica.petal")
    assert set(parameters.materials.names) == set(names)
    leaf = dict(zip(parameters.materials.names, zip(*(
        np.asarray(getattr(parameters.materials.leaf, n)).tolist()
        for n in ("chlorophyll", "water", "dry_matter")
    ), strict=True), strict=True))  # fmt: skip
    assert leaf["species.Erica.young"] == (15.0, 0.01, USUAL_LEAF.dry_matter)
    assert leaf["species.Erica.old"] == (80.0, USUAL_LEAF.water, USUAL_LEAF.dry_matter)
    assert leaf["species.Erica.petal"] == (2.0, 0.008, 0.003)  # what is left out: shipped petals
    elements = pd.read_csv(made / "elements.csv")
    area = elements[elements.organ == "leaf"].groupby("optics").area_m2.sum()
    shares = {one.name: one.share for one in scene.species[0].materials}
    assert shares["young"] == pytest.approx(area["young"] / area.sum(), rel=1e-6)
    assert shares["old"] == pytest.approx(area["old"] / area.sum(), rel=1e-6)
    assert scene.species[1].materials == ()
    voxels = voxel_dataset(scene, scene.area_density(parameters))
    assert voxels["class"].values.tolist() == [
        "Protea, leaf", "wood", "flower", "Erica, old", "Erica, young", "Erica, petal"
    ]  # fmt: skip


def test_optics_that_are_renamed_change_the_image_or_are_refused(
    made: Path, tmp_path: Path
) -> None:
    path = write(tmp_path, made)
    image = image_of(path)
    elements = tmp_path / "elements.csv"
    text = elements.read_text()
    elements.write_text(text.replace(",young,", ",yuong,"))
    line = next(i for i, row in enumerate(elements.read_text().splitlines(), 1) if "yuong" in row)
    match = "optics 'yuong': there is 'leaf', 'old', 'petal', 'young'. Did you mean 'young'"
    with pytest.raises(InputError, match=match) as caught:
        build_plot(read_plot(path))
    assert caught.value.file == elements.resolve()
    assert (caught.value.row, caught.value.column) == (line, "optics")
    # Named as the others the leaves are others; without a name they are the taxon's.
    for name in ("old", "leaf", ""):
        elements.write_text(text.replace(",young,", f",{name},"))
        (tmp_path / "leaves.csv").write_text(LEAVES.replace("Erica,young,15,0.01\n", ""))
        assert np.abs(image_of(path) / image - 1.0).max() > 0.02
    elements.write_text(text)
    (tmp_path / "leaves.csv").write_text(LEAVES + "Erica,fruit,30,\n")
    match = "'fruit' of 'Erica' is no material of its plants, which have 'old', 'petal', 'wood'"
    with pytest.raises(InputError, match=match) as caught:
        build_plot(read_plot(path))
    assert Path(str(caught.value.file)).name == "leaves.csv"


def test_a_mesh_in_the_species_table_has_the_materials_that_the_leaf_table_names(
    made: Path, tmp_path: Path
) -> None:
    leaves = "taxon,material,chlorophyll\n*,,40\nErica,leaves_young,15\n"
    text = (made / "shrub.obj").read_text()
    path = write(tmp_path, made, leaves, SPECIES.replace("elements.csv", "shrub.obj"))
    for old, new in (("upper", "leaves_young"), ("lower", "leaves_old")):
        text = text.replace(f"usemtl {old}", f"usemtl {new}")
    (tmp_path / "shrub.obj").write_text(text)
    scene, parameters = build_plot(read_plot(path))
    assert parameters.materials is not None
    assert parameters.materials.names == ("species.Erica.leaves_young",)
    (young,) = scene.species[0].materials
    assert 0.05 < young.share < 0.95


def test_measured_spectra_are_bark_and_petals(
    made: Path, tmp_path: Path, shared_data: Path
) -> None:
    """An ASD binary as bark of two species, an ASD text as the reflectance of petals."""
    asd = shared_data / "leaf" / "asd" / "enmap_ribb00001.asd"
    shutil.copy(asd, tmp_path / "bark.asd")
    with gzip.open(f"{asd}.txt.gz") as packed:
        (tmp_path / "petal.txt").write_bytes(packed.read())
    leaves = (
        "taxon,material,chlorophyll,reflectance,transmittance\n*,,40,,\n*,wood,,bark.asd,\n"
        "*,young,15,,\n*,old,80,,\nErica,petal,,petal.txt,through.csv\nProtea,flower,,char,\n"
    )
    (tmp_path / "through.csv").write_text("wavelength,petal\n350,0.01\n2500,0.01\n")
    scene, parameters = build_plot(read_plot(write(tmp_path, made, leaves)))
    found = {(i, one.name): k for k, i, one in material_classes(scene.species).values()}
    assert set(found) == {(0, "young"), (0, "old"), (0, "wood"), (0, "petal"), (1, "flower")}
    (measured,) = read_spectra_file(asd)
    wave = np.arange(400.0, 2501.0)
    want = np.asarray(BANDS.weights(wave)) @ np.interp(
        wave, measured.wavelength, np.asarray(measured.reflectance)
    )  # whose noise where water takes the sunlight is outside of these bands
    optics = scene.optics(parameters, BANDS)[0]
    np.testing.assert_allclose(optics.reflectance[found[0, "wood"]], want, rtol=2e-3)
    np.testing.assert_allclose(optics.reflectance[found[0, "petal"]], want, rtol=2e-3)
    np.testing.assert_allclose(optics.transmittance[found[0, "petal"]], 0.01, rtol=1e-5)
    assert float(optics.transmittance[found[0, "wood"]].max()) == 0.0


def test_a_spectrum_to_fit_makes_a_material_of_traits(made: Path, tmp_path: Path) -> None:
    leaf = prospect(LeafParameters.many(chlorophyll=np.array([30.0])), np.arange(400.0, 2501.0))
    table = pd.DataFrame({"wavelength": np.arange(400, 2501), "leaf": leaf.reflectance[0]})
    table.to_csv(tmp_path / "young.csv", index=False)
    leaves = "taxon,material,chlorophyll,spectrum\n*,,40,\n*,young,,young.csv\n*,old,80,\n"
    path = write(tmp_path, made, leaves + "*,petal,1,\n")
    _, parameters = build_plot(read_plot(path))
    assert parameters.materials is not None
    young = parameters.materials.names.index("species.Erica.young")
    assert float(parameters.materials.leaf.chlorophyll[young]) == pytest.approx(30.0, rel=0.1)


@pytest.mark.parametrize(
    ("row", "words", "column"),
    [
        ("Erica,young,15,0.02", "'young' of 'Erica' is there twice", "material"),
        ("Erica,fruit,,", "all are empty", None),
        ("Eric,young,15,", "unknown taxon 'Eric'", "taxon"),
        ("*,old,,200", "from 0 to 0.2", "water"),
    ],
)
def test_a_wrong_row_of_a_material_is_named(
    made: Path, tmp_path: Path, row: str, words: str, column: str | None
) -> None:
    path = write(tmp_path, made, LEAVES + row + "\n")
    with pytest.raises(InputError, match=words) as caught:
        read_plot(path)
    assert (caught.value.row, caught.value.column) == (6, column)

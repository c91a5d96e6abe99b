"""Plants of a plot's species from meshes and elements."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

from fynjax._core.errors import InputError
from fynjax.app.assembly import build_plot, plot_parameters
from fynjax.app.assembly._plants import read_plant
from fynjax.app.io.plot import read_plot
from fynjax.app.jobs._plant import plant
from fynjax.canopy import (
    Organ,
    PlantModel,
    TabulatedLeafAngle,
    generate_plant,
    plant_model_from_mesh,
    thin_plant,
)

TOML = "[plot]\nsize_m = 2.0\n[scene]\nsoftness = 0.0\nsoftness_plants = 0.0\n"
COLUMNS = "taxon,mean_diameter_cm,cover_percent,height_max_m,growth_form,plant\n"


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A generated plant as a mesh and as elements, with the generator's own record."""
    folder = tmp_path_factory.mktemp("plant")
    plant("Pterocelastrus tricuspidatus", folder, n_elements=1500, seed=0)
    return folder, generate_plant("Pterocelastrus tricuspidatus", 0)


@pytest.mark.parametrize("name", ["plant.obj", "elements.csv"])
def test_area_and_angles_of_a_plot_are_those_of_the_plant(made, tmp_path, name):
    folder, grown = made
    whole = plant_model_from_mesh(grown.mesh, None, solid_materials="closed")
    crown = np.pi / 4 * whole.modelled_diameter**2
    (tmp_path / "species.csv").write_text(
        COLUMNS + f"Pterocelastrus tricuspidatus,60,40,1.2,broad_leaved,{folder / name}\n"
    )
    (tmp_path / "plot.toml").write_text(TOML)
    model, parameters = build_plot(read_plot(tmp_path / "plot.toml", allow_outside=True))
    index = float(whole.organ_area[Organ.LEAF]) / crown
    assert float(parameters.species.leaf_area_index[0]) == pytest.approx(index, rel=0.05)
    angle = model.species[0].leaf_angle
    leaf = np.asarray(whole.plant.organ) == Organ.LEAF
    want = TabulatedLeafAngle.from_normals(
        whole.plant.normal[leaf], whole.plant.area_fraction[leaf]
    )
    for cosine in (0.2, 0.6, 1.0):
        got = float(angle.projection(np.array(cosine)))
        assert got == pytest.approx(float(want.projection(np.array(cosine))), rel=0.02)
    density = np.asarray(eqx.filter_jit(lambda m, p: m.area_density(p))(model, parameters))
    # Leaf area of the voxels: the index over the crowns of whole plants as seen from above, less
    # what shoots hide.
    count = int(np.ceil(float(model.counts(parameters)[0])))
    crowns = np.pi / 4 * 0.6**2 * (np.asarray(model.planting.size)[:count] ** 2).sum()
    crowns = 4.0 * (1 - np.exp(-crowns / 4.0))
    seen = 1 - float(parameters.species.shoot_clumping[0])
    assert density[0].sum() * 1e-3 == pytest.approx(index * crowns * seen, rel=0.05)


def test_an_area_that_the_table_states_is_not_that_of_the_plant(made, tmp_path):
    path = made[0] / "elements.csv"
    (tmp_path / "species.csv").write_text(
        COLUMNS.replace("plant", "plant,leaf_area_index")
        + f"Pterocelastrus tricuspidatus,60,40,1.2,broad_leaved,{path},1.5\n"
    )
    (tmp_path / "plot.toml").write_text(TOML)
    plot = read_plot(tmp_path / "plot.toml", allow_outside=True)
    model = read_plant(path, "broad_leaved")
    species = plot_parameters(plot, None, [model]).species
    crown = np.pi / 4 * model.modelled_diameter**2
    assert float(species.leaf_area_index[0]) == 1.5
    wood = float(model.organ_area[Organ.WOOD]) / crown
    assert float(species.wood_area_index[0]) == pytest.approx(wood)


def test_fewer_elements_keep_areas_places_and_angles(made):
    plant = plant_model_from_mesh(made[1].mesh, 4000, solid_materials="closed").plant
    thin = thin_plant(plant, 480, seed=1)  # of which 30 or so are wood
    assert abs(len(thin.organ) - 480) <= 2
    for organ in np.unique(plant.organ):
        few, many = (np.asarray(p.organ) == organ for p in (thin, plant))
        assert float(thin.area_fraction[few].sum()) == pytest.approx(1.0, rel=1e-6)
        for name in ("position", "normal"):
            of_few, of_many = (
                np.asarray(p.area_fraction)[mine] @ np.abs(np.asarray(getattr(p, name))[mine])
                for p, mine in ((thin, few), (plant, many))
            )
            np.testing.assert_allclose(of_few, of_many, atol=0.05)
    assert thin_plant(plant, 10**6, seed=1) is plant


def test_fewer_elements_are_drawn_by_their_areas():
    """A few large level leaves carry as much area as many small upright ones, and each half keeps
    its area to one element's: so G is a half of that straight down. The foliage comes first, as
    in no mesh of the generator; wood of no area stays of none."""
    level, upright, wood = 7, 900, 20
    normal = np.concatenate(
        [np.tile([0.0, 0.0, 1.0], (level, 1)), np.tile([1.0, 0.0, 0.0], (upright + wood, 1))]
    )
    fraction = np.concatenate(
        [np.full(level, 0.5 / level), np.full(upright, 0.5 / upright), np.zeros(wood)]
    )
    organ = np.concatenate([np.full(level + upright, Organ.LEAF), np.full(wood, Organ.WOOD)])
    parts = map(jnp.asarray, (np.zeros((len(organ), 3)), fraction, normal, organ))
    thin = thin_plant(PlantModel(*parts), 100, seed=3)
    leaf = np.asarray(thin.organ) == Organ.LEAF
    down = np.asarray(thin.area_fraction)[leaf] @ np.abs(thin.normal[leaf, 2])
    assert down == pytest.approx(0.5, abs=1.01 / leaf.sum())
    assert np.all(np.asarray(thin.area_fraction)[~leaf] == 0.0)
    assert (~leaf).any()


def split(line):
    return line.split(",")


def test_a_plant_that_cannot_serve_is_refused(made, tmp_path):
    folder, _ = made
    with pytest.raises(InputError, match="without leaves"):
        read_plant(folder / "plant.obj", "deadwood")
    text = (folder / "elements.csv").read_text().splitlines()
    bad = tmp_path / "elements.csv"
    cells = split(text[1])
    bad.write_text("\n".join([text[0], ",".join([*cells[:6], "-1", *cells[7:]])]) + "\n")
    with pytest.raises(InputError, match="area_m2"):
        read_plant(bad, "broad_leaved")
    bad.write_text("\n".join([text[0], *(line.replace("leaf", "twig") for line in text[1:])]))
    with pytest.raises(InputError, match="organ"):
        read_plant(bad, "broad_leaved")
    far = [",".join([str(100 * float(cells[0])), *cells[1:]]) for cells in map(split, text[1:])]
    bad.write_text("\n".join([text[0], *far]) + "\n")
    with pytest.raises(InputError, match=r"within the plant.*x = .*Other units"):
        read_plant(bad, "broad_leaved")
    two = [text[1], ",".join([*split(text[2])[:-1], "9.5"])]
    bad.write_text("\n".join([text[0], *two]) + "\n")
    with pytest.raises(InputError, match=r"one crown diameter and one height.* 2 pairs"):
        read_plant(bad, "broad_leaved")
    (tmp_path / "plant.obj").write_text("# nothing\n")
    with pytest.raises(InputError) as caught:
        read_plant(tmp_path / "plant.obj", "broad_leaved")
    assert "plant.obj" in str(caught.value)

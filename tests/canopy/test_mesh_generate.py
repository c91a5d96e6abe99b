"""Generated plants: areas, sizes and angles against the tables, and through a mesh file."""

from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import trimesh
from scipy.spatial import KDTree

from fynjax._core.errors import InputError
from fynjax.canopy import (
    FORMS,
    Organ,
    TabulatedLeafAngle,
    VoxelGrid,
    deposit,
    leaf_angle,
    plant_model,
    table1_2006,
)
from fynjax.canopy._table import leaf_sizes
from fynjax.canopy.mesh._generate import GeneratedPlant, generate_plant
from fynjax.canopy.mesh._generate_parts import OUTLINES, blades, outline_area, tubes_of_area
from fynjax.canopy.mesh._model import plant_model_from_mesh
from fynjax.canopy.mesh._plant_mesh import PlantMaterial, PlantMesh

TABLE = table1_2006().set_index("taxon")
TAXA = list(TABLE.index)
SMALL = 20_000
_made: dict[str, GeneratedPlant] = {}


def plant(taxon: str) -> GeneratedPlant:
    """Made once for all tests, with few triangles."""
    if taxon not in _made:
        _made[taxon] = generate_plant(taxon, 3, max_triangles=SMALL)
    return _made[taxon]


def file_of(mesh: PlantMesh, folder: Path) -> Path:
    obj, mtl = mesh.obj("plant.mtl")
    (folder / "plant.obj").write_text(obj)
    (folder / "plant.mtl").write_text(mtl)
    return folder / "plant.obj"


def parts_of(path: Path) -> dict[str, trimesh.Trimesh]:
    """The geometries of a mesh file as trimesh reads them, by material."""
    loaded = trimesh.load(path, process=False)
    pieces = loaded.geometry.values() if isinstance(loaded, trimesh.Scene) else [loaded]
    return {piece.visual.material.name: piece for piece in pieces}


@pytest.mark.parametrize("form", FORMS)
def test_a_plant_of_a_form_has_its_usual_size_and_areas(form: str) -> None:
    """Closed areas, for forms of which table 1 has no taxon too."""
    made, usual = plant(form), FORMS[form]
    assert (made.form, made.taxon) == (form, form)
    low, high = made.mesh.vertices.min(axis=0), made.mesh.vertices.max(axis=0)
    assert (high - low)[:2].mean() == pytest.approx(usual.diameter, rel=1e-3)
    assert (high - low)[2] == pytest.approx(usual.height, rel=1e-3)
    disc = np.pi * usual.diameter**2 / 4.0
    model = plant_model_from_mesh(made.mesh, 60, solid_materials="closed")
    wanted = [usual.leaf_area_index * disc, usual.wood_area_index * disc, 0.0]
    np.testing.assert_allclose(model.organ_area, wanted, rtol=1e-9)


@pytest.mark.parametrize("form", ["column", "rosette"])
def test_stems_and_thick_leaves_have_the_thickness_of_their_leaf(form: str) -> None:
    """Fourteen stems of 38 mm make a column's area: an independent count of what it states."""
    made = plant(form)
    assert made.n_leaves == FORMS[form].shoots.number
    assert made.leaf_scale == pytest.approx(1.0, abs=0.1)


@pytest.mark.parametrize("taxon", TAXA)
def test_size_and_areas_are_those_of_the_tables(taxon: str) -> None:
    generated, row = plant(taxon), TABLE.loc[taxon]
    defaults = FORMS[row.growth_form]
    low, high = generated.mesh.vertices.min(axis=0), generated.mesh.vertices.max(axis=0)
    assert (high - low)[:2].mean() == pytest.approx(row.mean_diameter_cm / 100, rel=1e-3)
    assert (high - low)[2] == pytest.approx(row.height_max_m, rel=1e-3)
    np.testing.assert_allclose([*(low + high)[:2], low[2]], 0.0, atol=1e-12)
    assert 500 < len(generated.mesh.faces) <= 1.2 * SMALL

    model = plant_model_from_mesh(generated.mesh, 60, solid_materials="closed")
    disc = np.pi * (row.mean_diameter_cm / 200) ** 2
    wanted = [defaults.leaf_area_index * disc, defaults.wood_area_index * disc, 0.0]
    np.testing.assert_allclose(model.organ_area, wanted, rtol=1e-9)
    triangles = generated.mesh.triangles
    cross = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    assert np.linalg.norm(cross, axis=1).min() > 0.0


@pytest.mark.parametrize("taxon", [*TAXA, "cushion", "column", "mat", "rosette"])
def test_organs_stand_where_the_growth_form_has_them(taxon: str) -> None:
    """Mean height and reach of leaves (of wood without them) as in the parametric form.

    The forms are clouds without twigs; a tenth of the height and of the diameter is alike, on the
    mean of individuals.
    """
    generated = plant(taxon)
    organ = Organ.WOOD if generated.form == "deadwood" else Organ.LEAF
    mesh = plant_model_from_mesh(generated.mesh, None, solid_materials="closed").plant
    moments = []
    for model in (mesh, *(plant_model(generated.form, 2000, seed=seed) for seed in range(6))):
        mine = np.asarray(model.organ) == organ
        x, y, z = np.asarray(model.position)[mine].T
        share = np.asarray(model.area_fraction)[mine]
        moments.append([share @ z, np.sqrt(share @ (z - share @ z) ** 2), share @ np.hypot(x, y)])
    np.testing.assert_allclose(moments[0], np.mean(moments[1:], axis=0), atol=0.13)


def facets_of(mesh: PlantMesh, organ: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Middles, vertical parts of the normals and shares of the area of an organ's triangles."""
    corners = mesh.triangles[mesh.material == mesh.materials.index(organ)]
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    double = np.linalg.norm(cross, axis=1)
    return corners.mean(axis=1), np.abs(cross[:, 2]) / double, double / double.sum()


def apart(one: tuple[np.ndarray, np.ndarray], other: tuple[np.ndarray, np.ndarray]) -> float:
    """Largest difference of two cumulative distributions, of values with weights."""
    places = np.sort(np.concatenate([one[0], other[0]]))
    curves = []
    for value, weight in (one, other):
        order = np.argsort(value)
        mass = np.concatenate([[0.0], np.cumsum(weight[order])])
        curves.append(mass[np.searchsorted(value[order], places, side="right")])
    return float(np.abs(curves[0] - curves[1]).max())


@pytest.mark.parametrize(
    ("form", "organ", "largest"),
    [
        ("upright_ericoid", "leaf", (0.03, 0.04, 0.01)),
        ("rounded_shrub", "leaf", (0.03, 0.04, 0.01)),
        ("broad_leaved", "leaf", (0.03, 0.06, 0.02)),
        ("cushion", "leaf", (0.11, 0.04, 0.01)),  # its bunches are flat, its leaves long
        ("tussock", "leaf", (0.05, 0.04, 0.09)),
        ("tussock", "wood", (0.05, 0.04, 0.09)),
        ("tussock", "flower", (0.05, 0.08, 0.19)),
        ("rounded_shrub", "flower", (0.17, 0.12, 0.02)),  # some hundred, each on a twig
        ("climber", "leaf", (0.08, 0.04, None)),  # see the next test
        ("column", "leaf", (0.04, 0.08, 0.20)),  # thick, with two ends each
        ("mat", "leaf", (0.13, 0.04, 0.02)),  # as of the cushion
        ("rosette", "leaf", (0.11, 0.08, 0.20)),
        ("succulent", "leaf", (0.11, 0.04, 0.01)),
        ("moss_layer", "leaf", (0.11, 0.04, 0.01)),
        ("deadwood", "wood", (0.18, 0.06, 0.28)),  # widened a fifth to its stated diameter
    ],
)
def test_a_mesh_has_its_area_where_the_light_meets_the_form(
    form: str, organ: str, largest: tuple[float, float, float | None]
) -> None:
    """Area by height, by distance from the middle, by inclination, of the mesh and of the elements
    of the same individual, as it stands on the mean of all its elements (a mesh is fitted to its
    extents). As wide as tall where the elements take their stems' slopes from such a plant."""
    usual = FORMS[form]
    size = {} if usual.leaf.kind == "blade" else {"diameter": 0.5, "height": 0.5}
    for seed in (3, 4):
        made = generate_plant(form, seed, flowering=1.0, max_triangles=40_000, **size)
        elements = plant_model(form, 8000, seed=seed)
        mine = np.asarray(elements.organ) == Organ[organ.upper()]
        place = np.asarray(elements.position)[mine] * [made.diameter, made.diameter, made.height]
        steep = np.abs(np.asarray(elements.normal)[mine, 2])
        of_elements = place, steep, np.full(len(place), 1.0 / len(place))
        found = []
        for point, upright, share in (facets_of(made.mesh, organ), of_elements):
            reach = np.hypot(*(point[:, :2] - share @ point[:, :2]).T)
            found.append((point[:, 2], reach, upright, share))
        for which, most in enumerate(largest):
            if most is None:
                continue
            (first, second), share = (f[which] for f in found), [f[3] for f in found]
            means = share[0] @ first, share[1] @ second
            if which < 2:
                first, second = first / means[0], second / means[1]
                assert means[0] == pytest.approx(means[1], rel=(0.12, 0.25)[which])
            assert apart((first, share[0]), (second, share[1])) < most, (seed, which)


def test_threads_have_the_normals_of_level_cylinders() -> None:
    """Mean vertical part 2 / pi, less what hangs or slopes; the light has planophile elements."""
    _, upright, share = facets_of(plant("climber").mesh, "leaf")
    assert share @ upright == pytest.approx(2.0 / np.pi, abs=0.08)


@pytest.mark.parametrize("form", [name for name in FORMS if FORMS[name].leaf.kind == "blade"])
def test_no_leaf_floats_beside_its_twig(form: str) -> None:
    mesh = plant(form).mesh
    wood = mesh.triangles[mesh.material == mesh.materials.index("wood")]
    corner = np.random.default_rng(0).dirichlet(np.ones(3), (len(wood), 60))
    surface = KDTree(np.einsum("fnc,fcd->fnd", corner, wood).reshape(-1, 3))
    leaves = mesh.faces[mesh.material == 0]
    per_leaf = len(np.unique(leaves)) // plant(form).n_leaves
    leaf = mesh.vertices[np.unique(leaves)].reshape(-1, per_leaf, 3)
    # A linear leaf begins in two corners, the others in one.
    base = leaf[:, :2].mean(axis=1) if per_leaf == 4 else leaf[:, 0]
    deepest, most = surface.query(base)[0].max(), 0.009 * FORMS[form].diameter
    assert deepest < most, (
        f"a leaf begins {deepest:.4f} m from the surface of stems and twigs, more than {most:.4f}: "
        "it floats, or is in the middle of a thick stem, which more `shoots.number` or a smaller "
        "`wood_area_index` makes thinner"
    )


@pytest.mark.parametrize(
    "taxon",
    ["Passerina corymbosa", "Erica irregularis", "Pterocelastrus tricuspidatus",
     "Cassytha ciliolata"],
)  # fmt: skip
def test_a_mesh_is_the_individual_that_the_form_has(taxon: str) -> None:
    """Leaf area in sectors and rings of the crown: alike for one seed, not for another."""
    generated = generate_plant(taxon, 3, max_triangles=20_000)
    mesh = plant_model_from_mesh(generated.mesh, None, solid_materials="closed").plant
    forms = [plant_model(generated.form, 8000, seed=seed) for seed in (3, 4)]
    shares = []
    for model in (mesh, *forms):
        mine = np.asarray(model.organ) == Organ.LEAF
        x, y, _ = np.asarray(model.position)[mine].T
        x, y = x - np.mean([x.min(), x.max()]), y - np.mean([y.min(), y.max()])
        bins = (np.linspace(-np.pi, np.pi, 13), [0.0, 0.3, 1.0])
        weight = np.asarray(model.area_fraction)[mine]
        shares.append(
            np.histogram2d(np.arctan2(y, x), np.hypot(x, y), bins, weights=weight)[0].T.ravel()
        )
    outer = [share[12:] for share in shares]
    own, other = (np.corrcoef(outer[0], outer[k])[0, 1] for k in (1, 2))
    assert own > 0.5, (own, other)
    assert own > other + 0.2, (own, other)


def test_every_taxon_has_a_leaf_size_with_a_source() -> None:
    sizes = leaf_sizes().set_index("taxon")
    assert list(sizes.index) == TAXA
    assert set(sizes.basis) <= {"species", "genus", "assumed"}
    assert (sizes.source.str.len() > 5).all()
    blade = sizes[sizes.organ_form == "blade"]
    assert set(blade.outline) <= set(OUTLINES)
    assert (blade.length_mm.astype(float) > blade.width_mm.astype(float)).all()


@pytest.mark.parametrize("taxon", ["Euclea racemosa", "Clutia alaternoides"])
def test_leaves_are_individual_and_of_their_size(taxon: str) -> None:
    generated = generate_plant(taxon, 0)
    row = leaf_sizes().set_index("taxon").loc[taxon]
    leaves = generated.mesh.faces[generated.mesh.material == 0]
    pieces = trimesh.graph.connected_components(trimesh.graph.face_adjacency(leaves), min_len=1)
    assert len(pieces) == generated.n_leaves
    # Base and tip are the points of an outline that begins and ends in one.
    per_leaf = generated.mesh.vertices[: 6 * len(pieces)].reshape(len(pieces), 6, 3)
    length = np.linalg.norm(per_leaf[:, 5] - per_leaf[:, 0], axis=1)
    assert np.median(length) == pytest.approx(float(row.length_mm) / 1000, rel=0.04)
    assert np.std(np.log(length)) == pytest.approx(0.15, abs=0.01)
    assert generated.leaf_scale == pytest.approx(1.0, abs=0.04)


def test_area_index_size_flowers_and_seed_are_the_users() -> None:
    taxon = "Hermannia ternifolia"
    options = {"diameter": 0.6, "height": 0.4, "leaf_area_index": 1.1, "wood_area_index": 0.2}
    first = generate_plant(taxon, 5, flowering=0.5, max_triangles=SMALL, **options)
    model = plant_model_from_mesh(first.mesh, None, solid_materials="closed")
    disc = np.pi * 0.09
    flower = 0.5 * FORMS["rounded_shrub"].flower_fraction * 1.1 * disc
    np.testing.assert_allclose(model.organ_area, [1.1 * disc, 0.2 * disc, flower], rtol=1e-9)
    assert (model.modelled_diameter, model.depth) == pytest.approx((0.6, 0.4), rel=1e-3)

    again = generate_plant(taxon, 5, flowering=0.5, max_triangles=SMALL, **options)
    np.testing.assert_array_equal(again.mesh.vertices, first.mesh.vertices)
    assert again.mesh.obj("a.mtl") == first.mesh.obj("a.mtl")
    other = generate_plant(taxon, 6, flowering=0.5, max_triangles=SMALL, **options)
    shared = min(len(other.mesh.vertices), len(first.mesh.vertices))
    assert np.abs(other.mesh.vertices[:shared] - first.mesh.vertices[:shared]).max() > 0.05

    restio = generate_plant("Restio eleocharis", 0, flowering=1.0, max_triangles=SMALL)
    assert restio.mesh.is_closed("leaf")
    assert restio.mesh.is_closed("flower")
    assert not first.mesh.is_closed("leaf")


def test_a_blade_and_a_tube_have_their_closed_form_areas() -> None:
    """A blade that is not arched; a prism, whose half surface is by hand."""
    east, up = np.array([[1.0, 0, 0]]), np.array([[0.0, 0, 1]])
    leaf = blades(np.zeros((1, 3)), east, up, np.array([2.0]), np.array([0.5]), OUTLINES["linear"])
    assert leaf.area == pytest.approx(0.7 * 2.0 * 0.5)
    assert outline_area(OUTLINES["obovate"]) == pytest.approx(0.45 * 0.38 + 0.35 * 0.88 + 0.1)
    for outline in OUTLINES.values():
        sheet = blades(np.zeros((1, 3)), east, up, np.array([2.0]), np.array([0.5]), outline)
        mesh = trimesh.Trimesh(sheet.vertices, sheet.faces, process=False)
        normal = mesh.face_normals.T @ mesh.area_faces / mesh.area
        np.testing.assert_allclose(normal[:2], 0.0, atol=0.03)
        assert normal[2] > 0.97
        assert mesh.area == pytest.approx(outline_area(outline), rel=0.03)

    line = np.array([[[0.0, 0, 0], [0.1, 0.2, 0.7], [0.2, 0.4, 1.4]]])
    length, hexagon = np.sqrt(0.04 + 0.16 + 1.96), 1.5 * np.sqrt(3) * 0.01**2
    area = 0.5 * (6 * 0.01 * length + 2 * hexagon)
    tube, radius = tubes_of_area([(line, np.ones((1, 3)))], [6], area)
    assert radius == pytest.approx(0.01)
    solid = trimesh.Trimesh(tube.vertices, tube.faces, process=False)
    assert solid.is_watertight
    assert solid.volume == pytest.approx(hexagon * length)
    assert solid.area == pytest.approx(2.0 * area)


GRID = VoxelGrid((5, 4, 9), 0.3, 0.3, (-0.7, -0.6, 0.0))


@jax.jit
def organs_on_grid(position: jax.Array, area: jax.Array, organ: jax.Array) -> jax.Array:
    """Sum over the voxels of the area density of each organ."""
    return deposit(position, area, organ, GRID, 3).sum(axis=(1, 2, 3))


@jax.jit
def areas_on_grid(position: jax.Array, areas: jax.Array) -> jax.Array:
    """The same for several areas of each element, of one organ."""
    one_class = jnp.zeros(len(position), int)
    return jax.vmap(lambda one: deposit(position, one, one_class, GRID, 1).sum())(areas)


@pytest.mark.parametrize("taxon", ["Restio eleocharis", "Euclea racemosa"])
def test_mesh_file_cloud_and_grid_have_one_area(taxon: str, tmp_path: Path) -> None:
    path = file_of(plant(taxon).mesh, tmp_path)
    parts = parts_of(path)
    half = {name: 0.5 if piece.is_watertight else 1.0 for name, piece in parts.items()}
    assert half["wood"] == 0.5
    of_file = half["leaf"] * parts["leaf"].area
    for n_elements, dtype in ((500, jnp.float64), (500, jnp.float32), (None, jnp.float64)):
        model = plant_model_from_mesh(path, n_elements, solid_materials="closed")
        cloud = np.asarray(model.area)[np.asarray(model.plant.organ) == Organ.LEAF].sum()
        assert cloud == pytest.approx(of_file, rel=1e-5)
        elements = model.position.astype(dtype), model.area.astype(dtype), model.plant.organ
        deposited = np.asarray(organs_on_grid(*elements), float) * GRID.voxel_volume
        np.testing.assert_allclose(deposited, model.organ_area, rtol=1e-5, atol=1e-9)
        assert deposited[0] == pytest.approx(of_file, rel=1e-5)


def directions(count: int = 40) -> np.ndarray:
    """Unit vectors all over the sphere."""
    drawn = np.random.default_rng(1).normal(size=(count, 3))
    return np.vstack([drawn / np.linalg.norm(drawn, axis=1, keepdims=True), np.eye(3)])


def facet_projection(piece: trimesh.Trimesh, towards: np.ndarray) -> np.ndarray:
    """G of a geometry's facets: mean |cosine| by area, for each direction."""
    return np.abs(towards @ piece.face_normals.T) @ piece.area_faces / piece.area_faces.sum()


@pytest.mark.parametrize("taxon", TAXA)
def test_projection_of_leaves_and_wood_is_that_of_the_facets(taxon: str, tmp_path: Path) -> None:
    """G of the drawn leaves within 1 %, of few drawn pieces of wood within 2 % and 0.003, of all
    facets."""
    path = file_of(plant(taxon).mesh, tmp_path)
    towards = directions()
    every = plant_model_from_mesh(path, None, solid_materials="closed").plant
    # Wood is a hundredth of a tussock's area.
    sampled = plant_model_from_mesh(path, 20000, solid_materials="closed").plant
    for name, piece in parts_of(path).items():
        facets = facet_projection(piece, towards)
        few = (0.01, 0.0) if name == "leaf" else (0.02, 0.003)
        for model, (rtol, atol) in ((every, (1e-6, 0.0)), (sampled, few)):
            mine = np.asarray(model.organ) == Organ[name.upper()]
            cosine = np.abs(towards @ np.asarray(model.normal)[mine].T)
            share = np.asarray(model.area_fraction)[mine]
            np.testing.assert_allclose(cosine @ share, facets, rtol=rtol, atol=atol)


def test_depositing_keeps_the_projection_of_the_elements() -> None:
    """Projected area over area, summed over the voxels: nothing falls beside the grid."""
    model = plant_model_from_mesh(plant("Euclea racemosa").mesh, 2000, solid_materials="closed")
    cosine = jnp.abs(jnp.asarray(directions()) @ model.plant.normal.T)
    mine = jnp.where(model.plant.organ == Organ.LEAF, model.area, 0.0)
    sums = np.asarray(areas_on_grid(model.position, jnp.vstack([cosine * mine, mine])))
    wanted = np.asarray(cosine @ mine) / float(mine.sum())
    np.testing.assert_allclose(sums[:-1] / sums[-1], wanted, rtol=1e-9)


@pytest.mark.parametrize("taxon", ["Clutia alaternoides", "Chironia baccifera", "Euclea racemosa"])
def test_leaf_angles_are_those_of_the_form_and_fit_a_tabulated_distribution(taxon: str) -> None:
    generated = plant(taxon)
    leaves = generated.mesh.triangles[generated.mesh.material == 0]
    piece = trimesh.Trimesh(
        leaves.reshape(-1, 3), np.arange(3 * len(leaves)).reshape(-1, 3), process=False
    )
    cos_zenith = np.linspace(0.1, 1.0, 7)
    azimuth = np.arange(36) * np.pi / 18
    sin_zenith = np.sqrt(1 - cos_zenith**2)
    around = np.stack(
        [
            np.outer(sin_zenith, np.cos(azimuth)),
            np.outer(sin_zenith, np.sin(azimuth)),
            np.outer(cos_zenith, np.ones(36)),
        ],
        axis=-1,
    )
    facets = facet_projection(piece, around.reshape(-1, 3)).reshape(7, 36).mean(axis=1)
    table = TabulatedLeafAngle.from_normals(piece.face_normals, piece.area_faces)
    np.testing.assert_allclose(table.projection(jnp.asarray(cos_zenith)), facets, rtol=0.01)
    # The arch of a blade spreads its normals by a few degrees about that of the form.
    form = leaf_angle(FORMS[generated.form].leaf_angle)
    np.testing.assert_allclose(form.projection(jnp.asarray(cos_zenith)), facets, rtol=0.02)


def test_materials_of_the_file_map_to_organs_and_optics(tmp_path: Path) -> None:
    mesh = generate_plant("Hermannia ternifolia", 2, flowering=1.0, max_triangles=SMALL).mesh
    path = file_of(mesh, tmp_path)
    direct = plant_model_from_mesh(path, 500, solid_materials="closed")
    assert set(direct.materials) == {"leaf", "wood", "flower"} == set(direct.optics)
    known: dict[str, Organ | str | PlantMaterial] = {
        "leaf": PlantMaterial("leaf", "Hermannia ternifolia"),
        "wood": PlantMaterial(Organ.WOOD, "bark", solid=True),
        "flower": "flower",
    }
    mapped = plant_model_from_mesh(path, 500, known)
    np.testing.assert_allclose(mapped.organ_area, direct.organ_area)
    np.testing.assert_array_equal(mapped.plant.position, direct.plant.position)
    optics = np.array(mapped.optics)[np.asarray(mapped.material)]
    organ = np.asarray(mapped.plant.organ)
    assert set(optics[organ == Organ.LEAF]) == {"Hermannia ternifolia"}
    assert set(optics[organ == Organ.WOOD]) == {"bark"}
    assert set(optics[organ == Organ.FLOWER]) == {"flower"}
    del known["flower"]
    with pytest.raises(InputError, match=r"plant.obj: .*'flower'"):
        plant_model_from_mesh(path, 500, known)
    # Names speak for themselves, but then all of them must.
    (tmp_path / "plant.mtl").write_text((tmp_path / "plant.mtl").read_text().replace("wood", "x"))
    path.write_text(path.read_text().replace("usemtl wood", "usemtl x"))
    with pytest.raises(InputError, match="'x'"):
        plant_model_from_mesh(path, 500)


@pytest.mark.parametrize("suffix", [".glb", ".ply", ".stl"])
def test_other_formats_keep_the_area(suffix: str, tmp_path: Path) -> None:
    mesh = plant("Chironia baccifera").mesh
    scene = trimesh.Scene()
    for index, name in enumerate(mesh.materials):
        faces = mesh.faces[mesh.material == index]
        piece = trimesh.Trimesh(mesh.vertices, faces, process=False)
        piece.remove_unreferenced_vertices()
        material = trimesh.visual.material.PBRMaterial(name=name)
        piece.visual = trimesh.visual.TextureVisuals(material=material)
        scene.add_geometry(piece, geom_name=name)
    path = tmp_path / f"plant{suffix}"
    (scene if suffix == ".glb" else scene.to_mesh()).export(path)
    model = plant_model_from_mesh(path, 300, up="z", solid_materials="closed")
    direct = plant_model_from_mesh(mesh, 300, solid_materials="closed")
    if suffix == ".glb":
        np.testing.assert_allclose(model.organ_area, direct.organ_area, rtol=1e-5)
    else:  # these know no materials: all of it is leaf, but the stems are closed still
        np.testing.assert_allclose(model.organ_area, [direct.organ_area.sum(), 0.0, 0.0], rtol=1e-5)
    assert model.depth == pytest.approx(0.5, rel=1e-3)


def obj_of(vertex_normal: str) -> str:
    """Two blades and a vertex normal on all their corners."""
    corners = ["0 0 0", "1 0 0", "0 1 0", "0 0 1", "1 0 1", "0 1 1.2"]
    lines = [f"v {corner}" for corner in corners] + [f"vn {vertex_normal}"]
    return "\n".join([*lines, "f 1//1 2//1 3//1", "f 4//1 5//1 6//1"]) + "\n"


def test_stored_normals_and_surfaces_inside_out_change_nothing(tmp_path: Path) -> None:
    """Elements have the normals of their facets, whose sign does not matter."""
    path = tmp_path / "leaf.obj"
    for normal in ("0 0 1", "0 0 -1", "0 0 0"):
        path.write_text(obj_of(normal))
        plant = plant_model_from_mesh(path, 10, up="z")
        assert float(plant.organ_area[0]) == pytest.approx(1.0099, abs=1e-4)
        assert float(plant.plant.normal[:, 2].min()) > 0.0
    ball = trimesh.creation.icosphere(subdivisions=2)
    plants = []
    for _ in range(2):
        plants.append(plant_model_from_mesh(ball, 100, solid_materials="closed"))
        assert float(plants[-1].organ_area[0]) == pytest.approx(0.5 * ball.area)
        ball.invert()
    upright = [float(jnp.abs(plant.plant.normal[:, 2]).mean()) for plant in plants]
    assert upright[0] == pytest.approx(upright[1], rel=0.02)
    # A leaf as two sheets back to back is no slip.
    back = trimesh.Trimesh(
        [[0, 0, 0], [1, 0, 0], [0, 1, 0.1]], [[0, 1, 2], [0, 2, 1]], process=False
    )
    assert float(plant_model_from_mesh(back, 4).organ_area[0]) == pytest.approx(1.005, rel=1e-3)


@pytest.mark.parametrize(
    ("options", "word"),
    [
        ({"taxon": "Protea repens"}, "must be one of Metalasia muricata"),
        ({"diameter": 40.0}, "centimetres"),
        ({"height": 0.0}, "`height`"),
        ({"leaf_area_index": -1.0}, "`leaf_area_index`"),
        ({"leaf_area_index": 0.0, "wood_area_index": 0.0}, "both area indices"),
        ({"flowering": 1.2}, "`flowering`"),
        ({"max_triangles": 10}, "`max_triangles`"),
        (
            {"taxon": "Pterocelastrus tricuspidatus", "diameter": 0.05},
            "no room for its leaf area: with .* m tall. Take a lower",
        ),
        ({"taxon": "Deadwood", "diameter": 10.0}, "no room for its wood area.*m tall"),
        (
            {"taxon": "Erica irregularis", "height": 0.01, "max_triangles": 3000},
            "no room .*leaves are [0-9.]+ times as large as usual, .*more `max_triangles`",
        ),
    ],
)
def test_bad_input(options: dict[str, object], word: str) -> None:
    with pytest.raises(InputError, match=word):
        generate_plant(**{"taxon": "Euclea racemosa", **options})  # type: ignore[arg-type]

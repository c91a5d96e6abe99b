"""Facets of plants with the optics of their material: leaves of several kinds, petals, bark."""

import dataclasses
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import fynjax as fx
from fynjax.canopy import (
    FORMS,
    MeshPlant,
    Organ,
    PlantMaterial,
    PlantMesh,
    generate_plant,
    leaf_angle,
    plant_model_from_mesh,
    table1_2006,
)
from fynjax.errors import InputError
from fynjax.leaf import LeafParameters, prospect
from fynjax.radiation import Accuracy, OpticalClasses, directional_reflectance, solve_light
from fynjax.scene import (
    GroundParameters,
    Scene,
    Spectrum,
    background_spectrum,
    leaf_classes,
    material_classes,
    named_values,
    stand_area,
)
from fynjax.scene._species import SHRUB_LEAF, SHRUB_LEAF_SD
from fynjax.sensors import shipped_sensor
from tests import reference
from tests.scene.plots import ruled

BANDS = shipped_sensor("mavic_3m").bands
WAVE = np.arange(400.0, 2501.0)
AVERAGE = np.asarray(BANDS.weights(WAVE))
YOUNG = {
    "chlorophyll": 12.0, "carotenoids": 4.0, "water": 0.01, "dry_matter": 0.005, "structure": 1.4
}  # fmt: skip
OLD = {
    "chlorophyll": 85.0, "carotenoids": 16.0, "water": 0.02, "dry_matter": 0.025, "structure": 2.2
}  # fmt: skip
PETAL = {"chlorophyll": 0.0, "carotenoids": 4.0, "anthocyanins": 8.0, "water": 0.008,
         "dry_matter": 0.003, "structure": 2.0}  # fmt: skip
BARK = Spectrum.of(WAVE, np.linspace(0.15, 0.6, len(WAVE)), "bark")
NAMES = ("young", "old", "stems", "petals")
ROW = {
    "taxon": "Erica", "growth_form": "rounded_shrub", "mean_diameter_cm": 60, "height_max_m": 0.7,
    "cover_percent": 60, "leaf_area_index": 4, "wood_area_index": 1.5, "shoot_clumping": 0,
    "dead_fraction": 0,
}  # fmt: skip
LEAVES: dict[Any, Any] = {
    ("Erica", "young"): YOUNG,
    ("Erica", "old"): OLD,
    ("Erica", "bark"): {"reflectance": BARK},
    ("Erica", "petal"): PETAL,
}


def shrub(elements: int = 150, **names: str) -> MeshPlant:
    """A shrub whose upper leaves are young, with the optics of `names` by material."""
    grown = generate_plant(
        "rounded_shrub", 3, diameter=0.6, height=0.7, flowering=1.0, max_triangles=6000
    ).mesh
    high = grown.triangles[..., 2].mean(axis=1) > 0.45
    kind = np.array([{"leaf": 1, "wood": 2, "flower": 3}[n] for n in grown.materials])
    kind = np.where((kind[grown.material] == 1) & high, 0, kind[grown.material])
    optics = {"young": "young", "old": "old", "stems": "bark", "petals": "petal"} | names
    organs = dict(zip(NAMES, ("leaf", "leaf", "wood", "flower"), strict=True))
    known = {name: PlantMaterial(organ, optics[name]) for name, organ in organs.items()}
    mesh = PlantMesh(grown.vertices, grown.faces, kind, NAMES)
    return plant_model_from_mesh(mesh, elements, known, solid_materials="closed")


@pytest.fixture(scope="module")
def mesh() -> MeshPlant:
    return shrub()


def scene_of(mesh: MeshPlant, leaves: Any = None, **options: Any) -> Scene:
    given: dict[str, Any] = {
        "size": 1.2, "voxel": 0.1, "structure": "even", "seed": 4, "dtype": "float64",
        "ground": GroundParameters(brightness=jnp.asarray(0.4), litter_fraction=jnp.asarray(0.0)),
    }  # fmt: skip
    scene = Scene.from_table(
        options.pop("table", [ROW]),
        meshes={"Erica": mesh},
        leaves=LEAVES if leaves is None else leaves,
        **given | options,
    )
    return ruled(scene, flowering=1.0)


def leaf_optics(traits: dict[str, float]) -> tuple[np.ndarray, np.ndarray]:
    leaf = prospect(LeafParameters.many(**{k: np.array([v]) for k, v in traits.items()}), WAVE)
    return AVERAGE @ np.asarray(leaf.reflectance)[0], AVERAGE @ np.asarray(leaf.transmittance)[0]


def own_voxels(scene: Scene, mesh: MeshPlant) -> Any:
    """The scene's voxels made anew from the mesh: every facet turned, placed and shared among the
    voxels by hand, under the number of its own material in the mesh."""
    parameters, plants = scene.parameters, scene.planting
    voxels = scene.voxels(parameters, BANDS)
    edge, (nz, ny, nx) = scene.grid.horizontal_size, voxels.area_density.shape[1:]
    density = np.zeros((len(NAMES), nz, ny, nx))
    organ, material = np.asarray(mesh.plant.organ), np.asarray(mesh.material)
    index = np.asarray(scene.organ_index(parameters))[0]
    crowns = np.asarray(scene.visible_crowns(parameters))
    for plant in np.flatnonzero(np.asarray(scene.standing(parameters)) > 0.5):
        turn = np.deg2rad(float(plants.azimuth[plant]))  # clockwise
        matrix = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
        place = np.asarray(mesh.plant.position, float) @ np.pad(matrix.T, ((0, 1), (0, 1)))
        place[:, :2] *= 0.6 * float(plants.size[plant])
        place[:, :2] += np.asarray(plants.foot[plant])
        place[:, 2] = mesh.plant.position[:, 2] * 0.7 * float(plants.stature[plant])
        area = crowns[plant] * index[organ] * np.asarray(mesh.plant.area_fraction, float)
        at = place / edge - 0.5
        low = np.floor(at).astype(int)
        for corner in np.ndindex(2, 2, 2):
            share = np.prod(np.where(corner, at - low, 1.0 - (at - low)), axis=1)
            x, y, z = (low + np.array(corner)).T
            np.add.at(
                density, (material, np.clip(z, 0, nz - 1), y % ny, x % nx), area * share / edge**3
            )
    optics = [leaf_optics(YOUNG), leaf_optics(OLD), (AVERAGE @ BARK.values, np.zeros(len(BANDS)))]
    reflectance, transmittance = (
        jnp.asarray(np.stack(values)) for values in zip(*optics, leaf_optics(PETAL), strict=True)
    )
    leaf = mesh.plant.organ == Organ.LEAF
    assert bool(leaf.any())
    angles = (scene.species[0].leaf_angle, leaf_angle("spherical"))
    classes = OpticalClasses(reflectance, transmittance, angles, (0, 0, 1, 1))
    return dataclasses.replace(voxels, area_density=jnp.asarray(density), classes=classes)


def test_a_shrub_of_several_materials_is_that_of_a_monte_carlo() -> None:
    """Nadir and oblique reflectance of a dense stand within 1 %; with young leaves for old ones,
    and bark for petals, it would be off by up to a tenth."""
    mesh = shrub(900)
    thinner = ROW | {"leaf_area_index": 3, "wood_area_index": 0.6}
    scene = scene_of(mesh, voxel=0.05, table=[thinner])
    own, views = own_voxels(scene, mesh), (jnp.array([0.0, 30.0]), jnp.array([90.0, 200.0]))
    fine = Accuracy(lattice=4, sublayers=4, coarsening=(1, 1))
    light = eqx.filter_jit(lambda v: solve_light(v, fine))(scene.voxels(scene.parameters, BANDS))
    found = np.asarray(directional_reflectance(light, *views))
    swapped = dataclasses.replace(own, area_density=own.area_density[jnp.array([1, 0, 3, 2])])
    off, others = np.zeros((2, len(BANDS), 2))
    for band in range(len(BANDS)):
        run = reference.reflectance(own, *views, photons=120_000, seed=band, band=band)
        off[band] = found[:, band] / run.mean - 1.0
        run = reference.reflectance(swapped, *views, photons=10_000, seed=band, band=band)
        others[band] = found[:, band] / run.mean - 1.0
    print("off %", np.round(100 * off, 2), "swapped %", np.round(100 * others))
    assert np.abs(off).max() < 0.01
    assert np.abs(others).max() > 0.08


def test_area_of_each_material_lies_where_its_facets_are(mesh: MeshPlant) -> None:
    scene = scene_of(mesh)
    density = np.asarray(scene.area_density(scene.parameters))
    classes = {one.name: k for k, _, one in material_classes(scene.species).values()}
    assert list(classes) == ["young", "old", "bark", "petal"]
    assert len(density) == 6  # no leaf of another kind, but the shipped bark and petals
    assert density[:2].max() == 0.0
    own = np.asarray(own_voxels(scene, mesh).area_density)
    for number, name in enumerate(classes):
        np.testing.assert_allclose(density[classes[name]], own[number], atol=1e-9)


def test_fewer_elements_keep_the_area_of_each_material(mesh: MeshPlant) -> None:
    scene = scene_of(shrub(3000))  # more than the scene's voxels ask for
    assert len(scene.planting.shapes.organ) < 200
    few = dataclasses.replace(scene, planting=scene.planting.thinned([40]))
    assert len(few.planting.shapes.organ) <= 44
    whole, thin = (
        np.asarray(one.area_density(one.parameters)).sum(axis=(1, 2, 3)) for one in (scene, few)
    )
    exact = np.asarray(own_voxels(scene_of(mesh), mesh).area_density).sum(axis=(1, 2, 3))
    np.testing.assert_allclose(whole[2:], exact, rtol=2e-3)
    np.testing.assert_allclose(thin[2:], exact, rtol=2e-3)


def test_slopes_by_the_chlorophyll_of_each_material_are_differences(mesh: MeshPlant) -> None:
    leaves = LEAVES | {("Erica", "petal"): PETAL | {"chlorophyll": 3.0}}
    scene = scene_of(mesh, leaves)
    names = [f"species.Erica.{name}.chlorophyll" for name in ("young", "old", "petal")]
    assert set(names) <= set(named_values(scene.parameters, scene.taxa))
    fine = Accuracy(lattice=1, sublayers=1, levels=1, azimuths=4, tolerance=1e-11, iterations=200)

    @eqx.filter_jit
    def red(changes: Any) -> Any:
        changed = scene.with_values(dict(zip(names, changes, strict=True)))
        light = solve_light(changed.voxels(changed.parameters, BANDS), fine)
        return directional_reflectance(light, 0.0, 0.0)[0, 1]

    at = jnp.array([12.0, 85.0, 3.0])
    slope = jax.grad(lambda x: red(x))(at)
    for k, step in enumerate((0.02, 0.2, 0.005)):
        move = jnp.zeros(3).at[k].set(step)
        difference = (red(at + move) - red(at - move)) / (2.0 * step)
        assert float(slope[k]) == pytest.approx(float(difference), rel=1e-4)
    assert float(jnp.abs(slope).min()) > 1e-6
    free = fx.free(scene, "species.*.young.chlorophyll", "species.*.chlorophyll")
    assert set(free.names) == set(names)  # no facet has the leaf's


def test_slopes_reach_a_stated_spectrum(mesh: MeshPlant) -> None:
    scene = scene_of(mesh)
    where = lambda s: s.species[0].materials[2].reflectance.values  # noqa: E731

    def nir(values: Any) -> Any:
        changed = eqx.tree_at(where, scene, values)
        return changed.optics(scene.parameters, BANDS)[0].reflectance[4, 3]

    slope = jax.grad(nir)(jnp.asarray(where(scene)))
    np.testing.assert_allclose(slope.sum(), 1.0, rtol=1e-6)  # the weights of a band


ROWS = [ROW, ROW | {"taxon": "Protea", "growth_form": "broad_leaved"}]


def test_equal_optics_are_one_class() -> None:
    """Classes are as many as there are different optics, whatever the number of names."""

    def count(leaves: Any) -> int:
        scene = Scene.from_table(ROWS, size=1.2, voxel=0.2, structure="even", leaves=leaves)
        voxels = scene.voxels(scene.parameters, BANDS)
        assert len(voxels.area_density) == len(voxels.classes.reflectance)
        return len(voxels.area_density) - 4  # two leaves, shipped bark, petals

    same = Spectrum.of(WAVE, BARK.values.copy(), "another bark")
    assert count({}) == 0
    assert count({("Erica", "wood"): {"reflectance": BARK}}) == 1
    both = {("Erica", "wood"): {"reflectance": BARK}, ("Protea", "wood"): {"reflectance": same}}
    assert count(both) == 1
    assert count(both | {("Protea", "wood"): {"reflectance": "bark"}}) == 2
    clear = {"reflectance": BARK, "transmittance": Spectrum.of(WAVE, 0.1 * BARK.values)}
    assert count(both | {("Erica", "flower"): clear}) == 2
    assert count({("*", "flower"): PETAL}) == 1
    assert count({("Erica", "flower"): PETAL, ("Protea", "flower"): PETAL}) == 2  # own parameters


def test_facets_of_one_optics_are_one_class_and_plain_names_are_their_organ() -> None:
    alike = shrub(young="old", stems="", petals="flower")
    leaves = {("Erica", "old"): OLD, ("*", "flower"): PETAL}
    shoots = [ROW | {"shoot_clumping": 0.4, "dead_fraction": 0.3}]
    scene = scene_of(alike, leaves, table=shoots)
    (old, petal) = scene.species[0].materials
    assert (old.name, petal.name) == ("old", "flower")
    assert (old.share, petal.share) == pytest.approx((1.0, 1.0))
    assert list(leaf_classes(scene.species)[0]) == []
    assert scene.parameters.materials.names == ("species.Erica.old", "material.flower")
    # Its leaves are as those of a plot whose leaf this is.
    plain = scene_of(shrub(young="", old="", stems="", petals=""), {"Erica": OLD}, table=shoots)
    optics, own = (one.optics(one.parameters, BANDS)[0] for one in (scene, plain))
    for name in ("reflectance", "transmittance"):
        got, want = getattr(optics, name), getattr(own, name)
        np.testing.assert_allclose(got[2], want[0], rtol=1e-12)
    # Of petals no shoot hides a part, and none is dead.
    np.testing.assert_allclose(optics.reflectance[3], leaf_optics(PETAL)[0], atol=2e-4)
    np.testing.assert_allclose(optics.transmittance[3], leaf_optics(PETAL)[1], atol=2e-4)


def test_leaves_of_one_row_differ_where_the_shoots_of_species_do(mesh: MeshPlant) -> None:
    other = ROW | {"taxon": "Protea", "shoot_clumping": 0.5, "growth_form": "broad_leaved"}
    leaves = {("*", name): values for (_, name), values in LEAVES.items()}
    leaves["*", "old"] = leaves["*", "bark"]
    scene = Scene.from_table(
        [ROW, other], size=1.2, voxel=0.2, structure="even", leaves=leaves,
        meshes={"Erica": mesh, "Protea": mesh}, hot_spot=True,
    )  # fmt: skip
    names = [(i, one.name) for _, i, one in material_classes(scene.species).values()]
    shared = [(0, "bark"), (0, "petal")]
    assert names == [(0, "young"), (0, "old"), *shared, (1, "young"), (1, "old")]
    of = ("species.Erica.young", "material.petal", "species.Protea.young")
    assert scene.parameters.materials.names == of
    optics = scene.optics(scene.parameters, BANDS)[0]
    for one, other in ((2, 6), (3, 7)):  # shoots of the second hide more of themselves
        assert float((optics.reflectance[other] / optics.reflectance[one]).max()) < 0.97
    np.testing.assert_allclose(optics.reflectance[3], optics.reflectance[4], rtol=1e-6)
    angles = [optics.angles[k] for k in optics.angle_of_class]
    for k, species in ((2, 0), (3, 0), (6, 1), (7, 1)):
        assert angles[k] is scene.species[species].leaf_angle
    assert angles[4] is angles[5] is angles[0]
    forms = ("rounded_shrub", "broad_leaved")
    small, *sizes = (0.005, *(FORMS[form].leaf_diameter for form in forms))
    want = [small, small, sizes[0], sizes[0], small, small, sizes[1], sizes[1]]
    np.testing.assert_allclose(optics.leaf_diameter[jnp.array(optics.size_of_class)], want)


def test_a_row_of_the_taxon_comes_before_one_of_any(mesh: MeshPlant) -> None:
    leaves = LEAVES | {("*", "young"): OLD, ("*", "old"): YOUNG}
    with pytest.raises(InputError, match=r"'young' of '\*' is no material of its plants"):
        scene_of(mesh, leaves)  # which all have their own
    leaves.pop(("Erica", "old"))
    leaves.pop(("*", "young"))
    scene = scene_of(mesh, leaves)
    assert scene.parameters.materials.leaf.chlorophyll[:2].tolist() == [12.0, 12.0]


def test_the_names_of_a_mesh_itself_count_where_a_row_describes_them() -> None:
    plain = shrub(young="", old="", stems="", petals="")
    scene = scene_of(plain, {("*", "young"): YOUNG})
    (young,) = scene.species[0].materials
    share = np.asarray(plain.area)[np.asarray(plain.material) == 0].sum() / plain.organ_area[0]
    assert young.share == pytest.approx(float(share), rel=1e-5)
    assert len(leaf_classes(scene.species)[0]) == 1
    assert scene.parameters.materials.names == ("species.Erica.young",)


def test_generated_plants_have_flowers_and_wood_of_their_own() -> None:
    options: dict[str, Any] = {"size": 1.2, "voxel": 0.2, "structure": "even"}
    char = background_spectrum("char", WAVE)
    leaves = {
        ("Erica", "flower"): {"anthocyanins": 9.0}, ("Erica", "wood"): {"reflectance": "char"}
    }  # fmt: skip
    scene = Scene.from_table(ROWS, leaves=leaves, **options)
    scene = ruled(scene, flowering=1.0)
    optics = scene.optics(scene.parameters, BANDS)[0]
    density = scene.area_density(scene.parameters).sum(axis=(1, 2, 3))
    names = {one.name: k for k, _, one in material_classes(scene.species).values()}
    np.testing.assert_allclose(optics.reflectance[names["wood"]], AVERAGE @ char, atol=2e-4)
    np.testing.assert_array_equal(optics.transmittance[names["wood"]], 0.0)
    petal = leaf_optics(PETAL | {"carotenoids": 0.5, "anthocyanins": 9.0})  # as shipped, but red
    np.testing.assert_allclose(optics.reflectance[names["flower"]], petal[0], atol=2e-4)
    whole = ruled(Scene.from_table(ROWS, **options), flowering=1.0)
    before = whole.area_density(whole.parameters).sum(axis=(1, 2, 3))
    np.testing.assert_allclose(density[:2], before[:2], rtol=1e-5)
    for k, name in ((2, "wood"), (3, "flower")):
        assert float(density[names[name]]) > 0.0
        np.testing.assert_allclose(density[k] + density[names[name]], before[k], rtol=1e-4)


def outer_scene(leaves: Any, **options: Any) -> Scene:
    """The shrubs of `scene_of` as the form's own plants."""
    given = {"size": 1.2, "voxel": 0.1, "structure": "even", "seed": 4, "dtype": "float64"}
    return ruled(Scene.from_table([ROW], leaves=leaves, **given | options), flowering=1.0)


def test_outer_leaves_of_generated_plants_are_of_their_material() -> None:
    """A quarter of the leaf area, farthest from the foot: each shape by hand from its elements."""
    leaves = {"Erica": OLD, ("Erica", "young"): YOUNG | {"outer_fraction": 0.25}}
    scene = outer_scene(leaves)
    young = next(iter(material_classes(scene.species).values()))[0]
    shapes, classes = scene.planting.shapes, np.asarray(scene.planting.shape_class)
    count, position = int(scene.planting.count[0]), np.asarray(shapes.position, float)
    for start in np.unique(np.asarray(scene.planting.first)):
        mine = slice(start, start + count)
        leaf = np.asarray(shapes.organ[mine]) == Organ.LEAF
        is_young = classes[mine] == young
        assert not is_young[~leaf].any()
        area = np.asarray(shapes.area_fraction[mine], float)
        assert area[is_young].sum() == pytest.approx(0.25, rel=1e-6)
        assert area[leaf].sum() == pytest.approx(1.0, rel=1e-6)
        far = np.linalg.norm(position[mine] * [2.0, 2.0, 1.0], axis=1)
        assert far[is_young].min() >= far[leaf & ~is_young].max()


def test_outer_leaves_of_coarse_plants_have_their_share_of_the_area() -> None:
    """Of 12 leaf elements none ends at 3 %, 4 % or 98 %: the area is theirs all the same."""
    for shares in ((0.03,), (0.03, 0.01), (0.5, 0.01, 0.48)):
        rows = {("*", f"m{i}"): YOUNG | {"outer_fraction": q, "chlorophyll": 10.0 + i}
                for i, q in enumerate(shares)}  # fmt: skip
        scene = Scene.from_table([ROW], leaves=rows, size=1.2, voxel=0.4, structure="even", seed=4)
        planting = scene.planting
        part = slice(0, int(planting.count[0]))
        area = np.asarray(planting.shapes.area_fraction[part], float)
        classes = np.asarray(planting.shape_class[part])
        assert np.sum(np.asarray(planting.shapes.organ[part]) == Organ.LEAF) < 20
        found = [area[classes == k].sum() for k, _, _ in material_classes(scene.species).values()]
        np.testing.assert_allclose(found, shares, rtol=1e-5)
        assert area[classes == 0].sum() == pytest.approx(1.0 - sum(shares), rel=1e-5)


def test_outer_leaves_are_seen_first_and_slopes_reach_them() -> None:
    """Pale young leaves brighten red by more than their share of the way from old to young ones;
    all leaves young, stated as outer ones, are a plot of young leaves."""
    red = BANDS.names.index("red")

    def red_of(leaves: Any) -> float:
        scene = outer_scene(leaves)
        image = fx.observe(scene, "mavic_3m", pixel=0.1).reflectance
        return float(np.mean(image[red]))

    outer = lambda share: {"Erica": OLD, ("*", "young"): YOUNG | {"outer_fraction": share}}  # noqa: E731
    old, young = red_of({"Erica": OLD}), red_of({"Erica": YOUNG})
    assert red_of(outer(1.0)) == pytest.approx(young, rel=1e-6)
    assert (red_of(outer(0.2)) - old) / (young - old) > 0.25
    scene = outer_scene(outer(0.2))
    name = "species.Erica.young.chlorophyll"
    assert name in named_values(scene.parameters, scene.taxa)

    def observed(parameters: Any) -> Any:
        return (
            fx.observe(scene, "mavic_3m", pixel=0.1, parameters=parameters).reflectance[red].mean()
        )

    slope = jax.grad(observed)(scene.parameters).materials.leaf.chlorophyll
    assert float(slope[0]) < 0.0


def test_leaves_that_differ_between_plants_stand_beside_materials(mesh: MeshPlant) -> None:
    part = shrub(old="")
    leaves = {k: v for k, v in LEAVES.items() if k != ("Erica", "old")}
    scene = scene_of(part, leaves | {"Erica": [OLD, OLD | {"chlorophyll": 30.0}]})
    assert [list(own) for own in leaf_classes(scene.species).values()] == [[0, 1]]
    density = scene.area_density(scene.parameters).sum(axis=(1, 2, 3))
    one = scene_of(part, leaves | {"Erica": OLD})
    single = one.area_density(one.parameters).sum(axis=(1, 2, 3))
    assert float(density[:2].min()) > 0.0
    np.testing.assert_allclose(density[:2].sum(), single[0], rtol=1e-9)
    np.testing.assert_allclose(density[2:], single[1:], rtol=1e-9)


def test_voxels_by_organ_and_stand_have_the_mean_of_the_materials(mesh: MeshPlant) -> None:
    scene = scene_of(mesh)
    shares = [one.share for one in scene.species[0].materials[:2]]
    assert sum(shares) == pytest.approx(1.0)
    by_organ = scene.voxels_by_organ(scene.parameters, BANDS).classes.reflectance
    by_class = scene.voxels(scene.parameters, BANDS).classes.reflectance
    np.testing.assert_allclose(by_organ[0], np.array(shares) @ by_class[2:4], rtol=1e-9)
    np.testing.assert_allclose(by_organ[1:], by_class[4:], rtol=1e-12)
    dry = shares[0] * YOUNG["dry_matter"] + shares[1] * OLD["dry_matter"]
    areas = stand_area(scene, scene.parameters)
    assert areas.leaf_mass.sum() == pytest.approx(1e4 * dry * areas.leaf.sum(), rel=1e-6)


def test_plants_without_leaves_are_not_asked_for_an_outer_fraction() -> None:
    dead = ROW | {"taxon": "Dead", "growth_form": "deadwood"}
    leaves = {("Dead", "young"): YOUNG | {"outer_fraction": 0.2}}
    with pytest.raises(InputError, match=r"no material of its plants, which have .*'wood'\.$"):
        Scene.from_table([ROW, dead], leaves=leaves, size=1.2, voxel=0.4, structure="even")


def test_a_plot_that_names_no_material_has_none() -> None:
    scene = Scene.from_table(table1_2006()[:2], size=1.0, voxel=0.5)
    assert scene.parameters.materials is None
    assert scene.planting.materials_from is None
    assert material_classes(scene.species) == {}
    assert len(scene.area_density(scene.parameters)) == 4


def test_traits_that_are_left_out_are_those_of_the_usual_leaf() -> None:
    usual = Scene.from_table(ROWS, size=1.2, voxel=0.2, structure="even").parameters.leaf
    stated = Scene.from_table(
        ROWS, size=1.2, voxel=0.2, structure="even", leaves={"Erica": {"chlorophyll": 20.0}}
    ).parameters.leaf
    assert stated.chlorophyll.tolist()[0] == 20.0
    for name in ("structure", "carotenoids", "water", "dry_matter"):
        assert getattr(stated, name).tolist() == getattr(usual, name).tolist()


def test_traits_that_a_leaf_leaves_open_stay_as_uncertain_as_those_of_shrubs() -> None:
    scene = Scene.from_table(
        ROWS, size=1.2, voxel=0.2, structure="even", plants="generic",
        leaves={"Erica": {"chlorophyll": 20.0}, ("Protea", "flower"): {"anthocyanins": 8.0}},
    )  # fmt: skip
    own = {name for name, _ in scene.spreads if ".leaf." in name}
    of_protea = {f"species.Protea.leaf.{name}" for name in SHRUB_LEAF_SD}
    of_erica = {f"species.Erica.leaf.{name}" for name in SHRUB_LEAF_SD if name != "chlorophyll"}
    assert own == of_protea | of_erica
    assert scene.parameters.leaf.water.tolist()[0] == pytest.approx(SHRUB_LEAF.water)


BRIGHT = Spectrum.of(WAVE, np.full(len(WAVE), 0.7), "bright")


@pytest.mark.parametrize(
    ("leaves", "words"),
    [
        ({k: v for k, v in LEAVES.items() if "old" not in k}, "optics 'old': there is 'leaf', 'b"),
        ({("Erica", "youngs" if "young" in k else k[1]): v for k, v in LEAVES.items()},
         "optics 'young'.*Did you mean 'youngs'"),
        (LEAVES | {("Erica", "fruit"): PETAL}, "'fruit' of 'Erica' is no material of its plants"),
        (LEAVES | {("*", "flwer"): PETAL}, "'flwer'.*mean 'flower'"),
        (LEAVES | {("Erica", "petals"): PETAL}, "which have 'bark', 'old', 'petal', 'young'"),
        (LEAVES | {("Erca", "young"): YOUNG}, "unknown taxon 'Erca'"),
        (LEAVES | {("Erica", "young"): [YOUNG, OLD]}, "'young' of 'Erica' is there twice"),
        (LEAVES | {("Erica", "young"): {}}, "expected a leaf of 'Erica'"),
        (LEAVES | {"Erica": {"reflectance": BARK}}, "expected a material beside a reflectance"),
        (LEAVES | {("Erica", "old"): {"transmittance": BARK}}, "all are empty"),
        (LEAVES | {("Erica", "old"): OLD | {"transmittance": BARK}}, "beside a transmittance"),
        (LEAVES | {("Erica", "bark"): {"reflectance": "oak.csv"}}, "but got a file"),
        (LEAVES | {("Erica", "bark"): OLD | {"reflectance": BARK}}, "got both"),
        (LEAVES | {("Erica", "bark"): {"reflectance": BRIGHT, "transmittance": BRIGHT}},
         "'bark'.* at most 1, but at 100 % of the wavelengths"),
        (LEAVES | {("Protea", "young"): YOUNG}, "Leaves of plants without a mesh need its outer"),
        (LEAVES | {("Protea", k): YOUNG | {"outer_fraction": 0.6} for k in ("young", "pale")},
         "of young, pale of 'Protea' are 1.2 together"),
        (LEAVES | {("Protea", "wood"): YOUNG | {"outer_fraction": 0.6}}, "a material of leaves"),
        (LEAVES | {("Erica", "young"): YOUNG | {"outer_fraction": 0.6}}, "its mesh says where"),
    ],
)  # fmt: skip
def test_materials_that_describe_nothing_or_too_much_are_refused(
    mesh: MeshPlant, leaves: Any, words: str
) -> None:
    table = [ROW, ROW | {"taxon": "Protea"}]
    with pytest.raises(InputError, match=words):
        scene_of(mesh, leaves, table=table)


def test_a_mesh_of_an_unknown_taxon_is_refused(mesh: MeshPlant) -> None:
    with pytest.raises(InputError, match=r"unknown taxon of a mesh: 'Eric'.*mean 'Erica'"):
        Scene.from_table([ROW], size=1.2, meshes={"Eric": mesh})


def test_a_mesh_with_leaves_of_a_form_without_is_refused(mesh: MeshPlant) -> None:
    dead = ROW | {"growth_form": "deadwood"}
    with pytest.raises(InputError, match="without leaves for the growth form 'deadwood'"):
        Scene.from_table([dead], size=1.2, meshes={"Erica": mesh})

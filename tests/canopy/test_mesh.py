"""Meshes to plant models: areas kept, frames and units right, errors that help."""

import bz2
import contextlib
import json
import math
import struct
import tarfile
import time
import zipfile
from pathlib import Path

import numpy as np
import pytest
import trimesh

from fynjax._core.errors import InputError
from fynjax.canopy import Organ, PlantMaterial, plant_model_from_mesh, read_plant_mesh
from fynjax.canopy._plant import organ_of_name
from fynjax.canopy.mesh import _bounds, find_up
from fynjax.canopy.mesh._plant_mesh import PlantMesh


def bush() -> trimesh.Trimesh:
    """An ellipsoid 0.4 m x 0.6 m x 1 m, standing on the ground at (3, 4)."""
    mesh = trimesh.creation.icosphere(subdivisions=3)
    mesh.apply_scale([0.2, 0.3, 0.5])
    mesh.apply_translation([3.0, 4.0, 0.5])
    return mesh


@pytest.mark.parametrize("n_elements", [5, 500])
def test_area_and_extents_are_kept(n_elements: int) -> None:
    mesh = bush()
    result = plant_model_from_mesh(mesh, n_elements, seed=1)
    np.testing.assert_allclose(result.organ_area, [mesh.area, 0, 0], rtol=1e-12)
    assert (result.width, result.height, result.depth) == pytest.approx((0.4, 0.6, 1.0), rel=0.01)
    assert result.modelled_diameter == pytest.approx(0.5, rel=0.01)
    position = np.asarray(result.plant.position)
    assert position.shape == (n_elements, 3)
    np.testing.assert_allclose(np.abs(position[:, :2]).max(0) <= [0.4001, 0.6001], True)
    assert 0 <= position[:, 2].min() < position[:, 2].max() <= 1
    assert float(result.plant.area_fraction.sum()) == pytest.approx(1.0, rel=1e-12)


def test_elements_lie_on_the_surface_and_project_as_the_facets() -> None:
    mesh = bush()
    result = plant_model_from_mesh(mesh, 3000, seed=0)
    d = result.modelled_diameter
    metres = np.asarray(result.plant.position) * [d, d, result.depth] + [3.0, 4.0, 0.0]
    metres[:, 2] += mesh.bounds[0, 2]
    level = (metres - [3, 4, 0.5]) / [0.2, 0.3, 0.5]
    np.testing.assert_allclose((level**2).sum(1), 1.0, atol=0.03)
    fraction = np.asarray(result.plant.area_fraction)
    for direction in [*np.eye(3).tolist(), [0.6, 0.0, 0.8], [0.48, 0.64, 0.6]]:
        facets = np.abs(mesh.face_normals @ direction) @ mesh.area_faces / mesh.area
        sampled = np.abs(np.asarray(result.plant.normal) @ direction) @ fraction
        assert sampled == pytest.approx(facets, rel=0.01)


def test_points_are_uniform_in_a_facet_and_parts_stand_in_their_frame() -> None:
    """First and second moments of two unit boxes, one lifted and shifted by the scene graph."""
    scene = trimesh.Scene()
    box = trimesh.creation.box([1.0, 1.0, 1.0])
    scene.add_geometry(box, geom_name="leaf a")
    scene.add_geometry(
        box, geom_name="leaf b", transform=trimesh.transformations.translation_matrix([4, 0, 2])
    )
    result = plant_model_from_mesh(scene, 6000, seed=0)
    assert (result.width, result.height, result.depth) == pytest.approx((5.0, 1.0, 3.0))
    d = result.modelled_diameter
    metres = np.asarray(result.plant.position) * [d, d, 3.0] + [2.0, 0.0, -0.5]
    upper = metres[:, 2] > 1.0
    assert np.mean(upper) == pytest.approx(0.5, abs=0.01)
    for part, centre in ((metres[~upper], [0, 0, 0]), (metres[upper], [4, 0, 2])):
        np.testing.assert_allclose(part.mean(0), centre, atol=0.02)
        # Two faces at +-1/2, four with the variance 1/12: (2 / 4 + 4 / 12) / 6.
        np.testing.assert_allclose(part.var(0), 5 / 36, rtol=0.03)


def test_materials_become_organs(tmp_path: Path) -> None:
    scene = trimesh.Scene()
    parts = (("leaves", 0.4, 0.8), ("bark", 0.1, 0.3), ("petals", 0.05, 1.2))
    for grey, (name, side, at) in enumerate(parts):
        box = trimesh.creation.box([side, side, side])
        box.apply_translation([0, 0, at])
        material = trimesh.visual.material.SimpleMaterial(name=name, diffuse=[grey, 9, 9])
        box.visual = trimesh.visual.TextureVisuals(material=material)
        scene.add_geometry(box, node_name=name, geom_name=name)
    organs = {"leaves": "leaf", "bark": Organ.WOOD, "petals": "flower"}
    direct = plant_model_from_mesh(scene, 100, organs, solid_materials=("bark",))
    np.testing.assert_allclose(direct.organ_area, [6 * 0.16, 0.5 * 6 * 0.01, 6 * 0.0025])
    # Elements are shared out by these areas, though each part has twelve triangles.
    assert np.bincount(direct.plant.organ).tolist() == [96, 3, 1]
    z = np.asarray(direct.plant.position)[:, 2] * direct.depth + 0.25
    assert z[np.asarray(direct.plant.organ) == Organ.FLOWER].min() > 1.17
    assert z[np.asarray(direct.plant.organ) == Organ.WOOD].max() < 0.36

    path = tmp_path / "plant.obj"
    scene.export(path)
    read = plant_model_from_mesh(path, 100, organs, solid_materials=("bark",))
    np.testing.assert_allclose(read.organ_area, direct.organ_area, rtol=1e-6)
    with pytest.raises(InputError, match=r"plant.obj: .*'petals'"):
        plant_model_from_mesh(path, 100, {"leaves": "leaf", "bark": "wood"})
    # The names stand in the OBJ, and say the same without the MTL and without a mapping.
    (tmp_path / "material.mtl").unlink()
    for given in (organs, None):
        bare = plant_model_from_mesh(path, 100, given, solid_materials=("bark",))
        np.testing.assert_allclose(bare.organ_area, direct.organ_area, rtol=1e-6)
    path.write_text(path.read_text().replace("petals", "oddity"))
    with pytest.raises(InputError, match="'oddity'"):
        plant_model_from_mesh(path, 100)
    for name in ("leaves", "bark"):
        path.write_text(path.read_text().replace(name, f"my {name[:2]}"))
    with pytest.raises(InputError, match=r"plant.obj: .*'my ba'.*`organ_of_material`"):
        plant_model_from_mesh(path, 100)
    with pytest.raises(InputError, match=r"leaf.*wood.*flower"):
        plant_model_from_mesh(scene, 100, organs | {"bark": "stem"})


def test_a_mesh_with_y_upwards() -> None:
    mesh = bush()
    upright = plant_model_from_mesh(mesh, 200)
    turned = mesh.copy()
    turned.vertices = np.stack(
        [mesh.vertices[:, 0], mesh.vertices[:, 2], -mesh.vertices[:, 1]], axis=1
    )
    same = plant_model_from_mesh(turned, 200, up="y")
    assert (same.width, same.height, same.depth) == pytest.approx(
        (upright.width, upright.height, upright.depth)
    )
    np.testing.assert_allclose(same.plant.position, upright.plant.position, atol=1e-12)


@pytest.mark.parametrize(
    ("name", "organ"),
    [
        *((name, Organ.LEAF) for name in ("leaf", "Leaves", "LEAVES_02", "oak.foliage", "Needles")),
        *(
            (name, Organ.WOOD)
            for name in ("Bark", "Twigs", "OakBarkMat", "wood.001", "branch_dead")
        ),
        *((name, Organ.FLOWER) for name in ("petals", "Blossom", "FlowerMaterial")),
        *((name, None) for name in ("", "Material.001", "leaf_stem", "believable", "None")),
    ],
)
def test_names_tell_of_organs(name: str, organ: Organ | None) -> None:
    assert organ_of_name(name) is organ


def named(**parts: trimesh.Trimesh) -> trimesh.Scene:
    scene = trimesh.Scene()
    for name, part in parts.items():
        scene.add_geometry(part, geom_name=name)
    return scene


def test_each_connected_surface_is_closed_or_not() -> None:
    """Two boxes and a triangle of wood: the boxes count half, whatever stands beside them."""
    box = trimesh.creation.box([0.1, 0.1, 0.5])
    other = box.copy()
    other.apply_translation([0.1, 0.1, 0.5])  # touches the first in a corner
    stray = trimesh.Trimesh([[0, 0, 1], [0.2, 0, 1], [0, 0.2, 1]], [[0, 1, 2]])
    wood = trimesh.util.concatenate([box, other, stray])
    with pytest.warns(UserWarning, match="4% .*'wood'"):
        model = plant_model_from_mesh(named(wood=wood), None, solid_materials="closed")
    assert float(model.organ_area[1]) == pytest.approx(0.5 * 2 * box.area + 0.02)
    assert model.solid_share == pytest.approx([2 * box.area / (2 * box.area + 0.02)])
    # A box that lacks a triangle is open, all of it; leaves may be.
    lacking = trimesh.Trimesh(box.vertices, box.faces[1:], process=False)
    model = plant_model_from_mesh(named(leaf=lacking, wood=other), 50, solid_materials="closed")
    np.testing.assert_allclose(model.organ_area[:2], [lacking.area, 0.5 * box.area])
    assert model.solid_share == (0.0, 1.0)
    # What the user says of a material holds for all of it.
    for solid, part in ((True, 0.5), (False, 1.0)):
        said = {"wood": PlantMaterial("wood", solid=solid)}
        model = plant_model_from_mesh(named(wood=wood), None, said, solid_materials="closed")
        assert float(model.organ_area[1]) == pytest.approx(part * wood.area)
        assert model.solid_share == (float(solid),)


def test_a_mirroring_frame_turns_the_faces_over(tmp_path: Path) -> None:
    """Else the mirrored closed body would be inside out in a file that is written of it."""
    scene = trimesh.Scene()
    mirror = np.diag([-1.0, 1.0, 1.0, 1.0])
    scene.add_geometry(bush(), geom_name="wood", transform=mirror)
    mesh = read_plant_mesh(scene)
    triangles = mesh.triangles
    a, b, c = np.moveaxis(triangles - triangles.mean(axis=(0, 1)), 1, 0)
    assert np.einsum("fi,fi->", a, np.cross(b, c)) / 6.0 == pytest.approx(bush().volume)
    assert mesh.vertices[:, 0].mean() == pytest.approx(-3.0)
    model = plant_model_from_mesh(scene, 50, solid_materials="closed")
    assert float(model.organ_area[1]) == pytest.approx(0.5 * bush().area)


def test_a_gltf_reads_no_file_outside_of_its_folder(tmp_path: Path) -> None:
    (tmp_path / "here").mkdir()
    box = trimesh.creation.box()
    for name, data in trimesh.exchange.gltf.export_gltf(box).items():
        (tmp_path / "here" / name).write_bytes(data)
    path = tmp_path / "here" / "model.gltf"
    assert len(read_plant_mesh(path).faces) == len(box.faces)
    for name in ("gltf_buffer_0.bin", "gltf_buffer_1.bin"):
        (path.parent / name).rename(tmp_path / name)
        path.write_text(path.read_text("utf-8").replace(name, f"../{name}"), "utf-8")
    with pytest.raises(InputError, match=r"outside of its folder.*GLB") as caught:
        read_plant_mesh(path)
    assert "allow_" not in str(caught.value)


def test_gltf_has_y_upwards(tmp_path: Path) -> None:
    tall = trimesh.creation.box([0.2, 0.9, 0.3])
    tall.export(tmp_path / "plant.glb")
    tall.export(tmp_path / "plant.ply")
    assert plant_model_from_mesh(tmp_path / "plant.glb", 20).depth == pytest.approx(0.9)
    assert plant_model_from_mesh(tmp_path / "plant.glb", 20, up="z").depth == pytest.approx(0.3)
    assert plant_model_from_mesh(tmp_path / "plant.ply", 20).depth == pytest.approx(0.3)


def test_bad_meshes(tmp_path: Path) -> None:
    big = bush()
    big.apply_scale(100.0)
    tiny = bush()
    tiny.apply_scale(0.001)
    flat = trimesh.Trimesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])
    lines = trimesh.Trimesh(
        [[0, 0, 0], [1, 1, 1], [2, 2, 2]], [[0, 1, 2]], process=False, validate=False
    )
    broken = bush()
    broken.vertices[0] = np.nan
    for mesh, word in (
        (trimesh.Trimesh(), "must have faces"),
        (trimesh.Scene(), "must have faces"),
        (trimesh.PointCloud(np.eye(3)), "point cloud"),
        (big, "centimetres"),
        (tiny, "kilometres"),
        (flat, "flat"),
        (lines, "degenerate"),
        (broken, "finite"),
    ):
        with pytest.raises(InputError, match=word):
            plant_model_from_mesh(mesh, 10)
    with pytest.raises(InputError, match="`up`"):
        plant_model_from_mesh(bush(), 10, up="x")  # type: ignore[arg-type]
    with pytest.raises(InputError, match="n_elements"):
        plant_model_from_mesh(bush(), 0)
    path = tmp_path / "cut.ply"
    path.write_bytes(b"ply\nformat binary_little_endian 1.0\nelement vertex 9\n")
    with pytest.raises(InputError, match=r"cut.ply.*cannot be read"):
        plant_model_from_mesh(path, 10)
    with pytest.raises(InputError, match=r"none\.obj: expected a mesh, but there is no such file"):
        plant_model_from_mesh(tmp_path / "none.obj", 10)


def test_an_obj_names_the_line_of_its_slip_and_may_be_utf_16(tmp_path: Path) -> None:
    path, points = tmp_path / "a.obj", "v 0 5 0\nv 0.1 5 0\nv 0 5.1 0.2\n"
    for text, row, said in (
        (points.replace("0.1 5 0", "0,1 5,0 0,0"), 2, "a decimal point, but got 0,1"),
        (points + "# v 0\nf 1 2 3\nf 1/9 2/9 4/9\n", 6, "among 3 points, but a face has 4"),
    ):
        path.write_text(text)
        with pytest.raises(InputError, match=said) as caught:
            read_plant_mesh(path)
        assert caught.value.row == row
    path.write_text(points + "f 1 2 3\n", encoding="utf-16")
    assert len(read_plant_mesh(path).faces) == 1


def test_meshes_of_the_field_have_their_area(shared_data: Path) -> None:
    """Corners counted back from the face, quads behind all vertices, and y upwards."""
    folder = shared_data / "field" / "13_obj-negative-indices-quads-yup-mm"
    height = {}
    for name in ("batched_quads", "negative_interleaved", "y_up"):
        taken = "y is taken" if name == "y_up" else "z is taken .* stands on 0 in y too"
        with pytest.warns(UserWarning, match=rf"{name}\.obj: {taken}"):
            plant = plant_model_from_mesh(folder / f"{name}.obj", None)
        assert float(plant.organ_area.sum()) == pytest.approx(0.03554, rel=1e-3)
        height[name] = plant.depth
    assert height["negative_interleaved"] == pytest.approx(height["batched_quads"], rel=1e-5)
    assert height["y_up"] == pytest.approx(height["batched_quads"], rel=1e-3)


@pytest.mark.parametrize(
    ("turn", "shift", "up", "said"),
    [
        ((0, 1, 2), (0, 0, 0), "z", ""),
        ((0, 1, 2), (3e5, 6e6, 100), "z", ""),
        ((0, 2, 1), (0, 0, 0), "y", "y is taken .* below 0 in z and not in y"),
        ((0, 2, 1), (0, 0, 0.5), "z", r"z is taken .* stands on 0 in y too\. Is it y\? .*--up"),
        ((0, 1, 2), (0, 0, -1), "z", "z is taken .* hangs from 0 in z"),
        ((2, 1, 0), (0, 0, 0), "z", "z is taken .* stands on 0 in x"),
    ],
)
def test_the_axis_that_is_taken_to_be_vertical_is_named(turn, shift, up, said, tmp_path) -> None:
    mesh = bush()
    mesh.vertices = (mesh.vertices - [3.0, 4.0, 0.0])[:, turn] + shift
    plant = PlantMesh(mesh.vertices, mesh.faces, np.zeros(len(mesh.faces), int), ("",))
    with pytest.warns(UserWarning, match=said) if said else contextlib.nullcontext():
        assert find_up(tmp_path / "bush.obj", plant) == up


def test_corners_that_count_back_with_normals_and_textures(tmp_path: Path) -> None:
    path = tmp_path / "leaf.obj"
    square = "v {0} 0 0\nv {0} 1 0\nv {0} 1 1\nv {0} 0 1\nvt 0 0\nvt 1 1\nvn 1 0 0\nvn 0 1 0\n"
    faces = (
        "f -4/-2/-2 -3/-1/-1 -2/-1/-1 -1/-1/-1\n",
        "f -4//-1 -3//-1 -2//-1\n",
        "f -1 -2 -4 # a-2\n",
    )
    for face, area in zip(faces, (1.0, 0.5, 0.5), strict=True):
        path.write_text(square.format(0) + face + square.format(0.1) + face)
        triangles = read_plant_mesh(path, up="z").triangles
        sides = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
        assert 0.5 * np.linalg.norm(sides, axis=1).sum() == pytest.approx(2 * area)
        assert set(np.round(triangles[..., 0].ravel(), 3)) == {0.0, 0.1}
    for wrong in ("f -9 -2 -1", "f 1 -0 2"):
        path.write_text(square.format(0) + wrong)
        with pytest.raises(InputError, match=r"leaf\.obj, row 9: expected a corner among the 4"):
            read_plant_mesh(path)
    path.write_text(square.format(0) + "f 1 2 3 # a leaf\nf 1/0 2 3")
    assert read_plant_mesh(path, up="z").triangles.shape[0] == 2
    path.write_text(square.format(0) + "f 1 2 3\nf 3 0 1")
    with pytest.raises(InputError, match=r"leaf\.obj, row 10: expected corners counted from 1"):
        read_plant_mesh(path)


def test_a_mesh_that_is_packed_is_refused_before_it_unfolds(tmp_path: Path) -> None:
    """Some hundred kB would be hundreds of MB, as a stranger's table may name them."""
    line = b"v 0 0 0\n" * 1_000_000
    with zipfile.ZipFile(tmp_path / "a.zip", "w", zipfile.ZIP_DEFLATED) as file:
        file.writestr("a.obj", line)
    with tarfile.open(tmp_path / "a.tar.gz", "w:gz") as file:
        (tmp_path / "a.obj").write_bytes(line)
        file.add(tmp_path / "a.obj", "a.obj")
    (tmp_path / "a.obj.bz2").write_bytes(bz2.compress(line))
    for name in ("a.zip", "a.tar.gz", "a.obj.bz2"):
        assert (tmp_path / name).stat().st_size < 100_000
        with pytest.raises(InputError, match=r"got an archive \(\.(zip|gz|bz2)\): unpack it first"):
            read_plant_mesh(tmp_path / name)


def gltf(path: Path, nodes: list[dict], **accessor: object) -> Path:
    """A triangle, and one more accessor, in a scene of these nodes."""
    data = np.eye(3, dtype="<f4").tobytes()
    record = {
        "asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}], "nodes": nodes,
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"} | accessor
        ],
        "bufferViews": [{"buffer": 0, "byteLength": len(data)}],
        "buffers": [{"byteLength": len(data)}],
    }  # fmt: skip
    if "count" in accessor:
        del record["accessors"][0]["bufferView"]
    text = json.dumps(record).encode()
    text += b" " * (-len(text) % 4)
    parts = struct.pack("<II", len(text), 0x4E4F534A) + text
    parts += struct.pack("<II", len(data), 0x004E4942) + data
    path.write_bytes(b"glTF" + struct.pack("<II", 2, 12 + len(parts)) + parts)
    return path


def test_a_glb_has_no_more_numbers_or_copies_than_it_can_hold(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "a.glb"
    assert len(read_plant_mesh(gltf(path, [{"mesh": 0}])).faces) == 1
    with pytest.raises(InputError, match=r"states 12\d+ MiB of arrays without data, but its"):
        read_plant_mesh(gltf(path, [{"mesh": 0}], count=10**7))
    with pytest.raises(InputError, match="stands below two others, or itself"):
        read_plant_mesh(gltf(path, [{"children": [1, 1]}, {"mesh": 0}]))
    # Each level twice below the one above: 2^40 copies of one triangle.
    deep = [{"children": [k + 1, k + 1]} for k in range(40)]
    with pytest.raises(InputError, match="stands below two others, or itself"):
        read_plant_mesh(gltf(path, [*deep, {"mesh": 0}]))
    many = [{"children": list(range(1, 31))}, *({"mesh": 0} for _ in range(30))]
    assert len(read_plant_mesh(gltf(path, many)).faces) == 30
    monkeypatch.setattr(_bounds, "MOST_TRIANGLES", 29)
    with pytest.raises(InputError, match="at most 29 triangles, but the mesh has 30, each copy"):
        read_plant_mesh(gltf(path, many))
    monkeypatch.setattr(_bounds, "LARGEST_FILE", 100)
    with pytest.raises(InputError, match="Make the mesh coarser first"):
        read_plant_mesh(path)
    monkeypatch.undo()
    path.write_bytes(path.read_bytes()[:60])
    with pytest.raises(InputError, match="damaged or cut short"):
        read_plant_mesh(path)


def test_parts_of_a_scene_may_stand_deep_but_not_below_themselves(tmp_path: Path) -> None:
    """A chain of bones, each turned by one degree about y and 0.01 m along its own z."""
    count, half = 3000, math.radians(0.5)
    bone = {"rotation": [0.0, math.sin(half), 0.0, math.cos(half)], "translation": [0, 0, 0.01]}
    nodes = [bone | {"children": [k + 1]} for k in range(count - 1)] + [bone | {"mesh": 0}]
    began = time.process_time()
    mesh = read_plant_mesh(gltf(tmp_path / "a.glb", nodes), up="z")
    assert time.process_time() - began < 5.0  # hours where the frames of each are multiplied anew
    angle = math.radians(1.0) * np.arange(count + 1)
    foot = 0.01 * np.array([np.sin(angle[:-1]).sum(), 0.0, np.cos(angle[:-1]).sum()])
    turn = [[np.cos(angle[-1]), 0, np.sin(angle[-1])], [0, 1, 0],
            [-np.sin(angle[-1]), 0, np.cos(angle[-1])]]  # fmt: skip
    np.testing.assert_allclose(mesh.vertices, foot + np.eye(3) @ np.transpose(turn), atol=1e-9)
    for ends in ([0], [1]):  # the last leads back to the first, or to the second
        circle = [{"children": [1]}, {"children": [2]}, {"mesh": 0, "children": ends}]
        with pytest.raises(InputError, match=r"stands below two others, or itself|below itself"):
            read_plant_mesh(gltf(tmp_path / "a.glb", circle))


@pytest.mark.parametrize(
    ("names", "materials"),
    [(("leaf.001", "leaf 2", "stem_3"), ("leaf", "stem")),
     (("leaf1.2", "leaf2.1", "stem"), ("leaf1", "leaf2", "stem")),
     (("old leaf", "stem_", "12"), ("old leaf", "stem_", "12"))],
)  # fmt: skip
def test_groups_of_an_obj_lose_the_number_at_their_end(tmp_path: Path, names, materials) -> None:
    faces = "".join(f"g  {name} \r\nf 1 2 3\r\n" for name in names)
    (tmp_path / "a.obj").write_bytes(f"v 0 0 0\r\nv 1 0 0\r\nv 0 0 1\r\n{faces}".encode())
    assert {*read_plant_mesh(tmp_path / "a.obj", up="z").materials} == {*materials}


def tube(radius: float, length: float, tip: float, sides: int = 8) -> trimesh.Trimesh:
    """A stem of rings without caps, its upper ring `tip` times as wide."""
    angle = 2.0 * np.pi * np.arange(sides) / sides
    ring = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    low = np.column_stack([radius * ring, np.zeros(sides)])
    high = np.column_stack([tip * radius * ring, np.full(sides, length)])
    k, n = np.arange(sides), (np.arange(sides) + 1) % sides
    faces = np.concatenate([np.stack([k, n, n + sides], 1), np.stack([k, n + sides, k + sides], 1)])
    return trimesh.Trimesh(np.concatenate([low, high]), faces, process=False)


@pytest.mark.parametrize(
    ("shape", "share"),
    [(tube(0.01, 0.3, 0.8), 0.5), (tube(0.01, 0.3, 1e-14), 0.5), (tube(0.1, 0.25, 1.0), 0.5),
     (tube(0.2, 0.05, 1.0), 1.0), (tube(0.2, 0.01, 0.3), 1.0)],
)  # fmt: skip
def test_a_ring_of_open_edges_at_the_end_of_a_stem_is_no_sheet(shape, share) -> None:
    """A tube, one that tapers to a point, a stout one; a hoop and a flat ring are sheets."""
    with (
        contextlib.nullcontext()
        if share < 1.0
        else pytest.warns(UserWarning, match="count as sheets")
    ):
        model = plant_model_from_mesh(named(wood=shape), 40, solid_materials="closed")
    assert float(model.organ_area[1]) == pytest.approx(share * shape.area, rel=1e-3)


def test_tubes_of_the_field_count_half(shared_data) -> None:
    """Three tubes of 0.0389 m2 of surface, and 30 leaves, which are sheets."""
    path = shared_data / "field" / "27_open-tubes-of-a-generator" / "shrub.obj"
    model = plant_model_from_mesh(read_plant_mesh(path), 500, solid_materials="closed")
    assert float(model.organ_area[1]) == pytest.approx(0.01947, rel=1e-3)
    assert float(model.organ_area[0]) == pytest.approx(0.0144, rel=1e-3)


@pytest.mark.parametrize("kind", ["o", "g"])
@pytest.mark.parametrize("material", ["", "usemtl default\n"])
def test_groups_and_objects_are_organs_where_materials_are_not(
    kind: str, material: str, tmp_path: Path
) -> None:
    corners = [(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)]
    lines = [f"v {x} {y} {z}" for x, y, z in corners]
    lines += [f"{kind} trunk", f"{material}f 1 2 4", f"{kind} leaf_1", f"{material}f 1 3 4"]
    lines += [f"{kind} leaf_2", f"{material}f 2 3 4"]
    (tmp_path / "a.obj").write_text("\n".join(lines) + "\n")
    mesh = read_plant_mesh(tmp_path / "a.obj", up="z")
    assert set(mesh.materials) == {"trunk", "leaf"}
    area = dict(zip(mesh.materials, mesh.material_area))
    assert area["trunk"] == pytest.approx(0.5)
    assert area["leaf"] == pytest.approx(0.5 + 0.75**0.5)
    stated = (tmp_path / "a.obj").read_text().replace("f 2 3 4", "usemtl bark\nf 2 3 4")
    (tmp_path / "b.obj").write_text(stated)
    assert "bark" in read_plant_mesh(tmp_path / "b.obj", up="z").materials
    one = "\n".join(lines).replace(f"{kind} trunk", f"{kind} 12")  # of leaves alone no group says
    (tmp_path / "c.obj").write_text(one.replace("\nf", "\nusemtl skin\nf") + "\n")
    assert "skin" in read_plant_mesh(tmp_path / "c.obj", up="z").materials
    numbered = [*lines, f"{kind} 12", "f 1 2 3"]
    (tmp_path / "d.obj").write_text("\n".join(numbered) + "\n")
    assert set(read_plant_mesh(tmp_path / "d.obj", up="z").materials) == {"trunk", "leaf", "12"}

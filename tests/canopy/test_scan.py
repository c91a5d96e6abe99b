"""Scanned plants: areas from the spacing of points, organs, files, and errors."""

from pathlib import Path

import numpy as np
import pytest
import trimesh

from fynjax._core.errors import InputError
from fynjax.canopy import Organ
from fynjax.canopy.mesh._model import plant_model_from_mesh
from fynjax.canopy.mesh._scan import plant_model_from_points, read_scan
from tests.helpers import write_ply


def ball(count: int = 3000, radius: float = 0.3) -> tuple[np.ndarray, np.ndarray]:
    """Random points on a sphere that stands on the ground, and their normals."""
    drawn = np.random.default_rng(0).normal(size=(count, 3))
    normals = drawn / np.linalg.norm(drawn, axis=1, keepdims=True)
    return radius * normals + [1.0, 2.0, radius], normals


def test_area_of_a_sphere_from_the_spacing_of_its_points() -> None:
    points, normals = ball()
    for neighbours in (6, 12, 20):
        model = plant_model_from_points(points, normals, neighbours=neighbours)
        assert float(model.organ_area[0]) == pytest.approx(4 * np.pi * 0.09, rel=0.04)
    assert model.modelled_diameter == pytest.approx(0.6, rel=0.01)
    assert model.depth == pytest.approx(0.6, rel=0.01)
    # Denser on one side: as many points there, and no more area.
    dense = points[:, 0] > 1.0
    twice = np.concatenate([points[~dense][::4], points[dense]])
    model = plant_model_from_points(twice, np.concatenate([normals[~dense][::4], normals[dense]]))
    east = np.asarray(model.position)[:, 0] > 0.0
    assert np.asarray(model.area)[east].sum() == pytest.approx(2 * np.pi * 0.09, rel=0.06)


def test_thinned_points_keep_area_and_projection() -> None:
    points, normals = ball(8000)
    model = plant_model_from_points(points, normals, 1500, organ_area={"leaf": 0.5}, seed=2)
    assert len(model.area) == 1500
    assert float(model.area.sum()) == pytest.approx(0.5, rel=1e-9)
    for direction in [*np.eye(3), [0.6, 0.0, 0.8]]:
        seen = np.abs(np.asarray(model.plant.normal) @ direction) @ np.asarray(model.area)
        assert seen == pytest.approx(0.25, rel=0.01)


def test_a_scan_of_a_mesh_has_its_projection() -> None:
    """Points sampled on an ellipsoid's facets, against the facets themselves."""
    mesh = trimesh.creation.icosphere(subdivisions=4)
    mesh.apply_scale([0.2, 0.3, 0.5])
    points, face = trimesh.sample.sample_surface(mesh, 6000, seed=4)
    model = plant_model_from_points(np.asarray(points), mesh.face_normals[face])
    direct = plant_model_from_mesh(mesh, None)
    assert float(model.organ_area[0]) == pytest.approx(mesh.area, rel=0.03)
    for direction in np.eye(3):
        seen = [
            np.abs(np.asarray(one.plant.normal) @ direction) @ np.asarray(one.plant.area_fraction)
            for one in (model, direct)
        ]
        assert seen[0] == pytest.approx(seen[1], rel=0.03)


def test_roughness_along_the_normal_adds_no_area() -> None:
    """Noise across a level sheet of 1 m2, nearly as large as the points' spacing of 3 cm."""
    rng = np.random.default_rng(3)
    points = np.column_stack([rng.random((1000, 2)), rng.normal(0.0, 0.02, 1000)])
    inner = (np.abs(points[:, :2] - 0.5) < 0.4).all(axis=1)
    model = plant_model_from_points(points, np.tile([0.0, 0.0, 1.0], (1000, 1)))
    area = np.asarray(model.area)[inner].sum()
    assert area == pytest.approx(0.64, rel=0.03)


def test_points_all_at_one_place_have_no_area() -> None:
    points, normals = ball(100)
    points[:20] = points[0]
    organ = np.r_[np.ones(20, int), np.zeros(80, int)]
    areas: tuple[dict[Organ | str, float], ...] = ({}, {"wood": 0.1})
    for known in areas:
        with pytest.raises(InputError, match=r"wood .*duplicate points"):
            plant_model_from_points(points, normals, organ=organ, organ_area=known)


def test_organs_and_upright_turn() -> None:
    points, normals = ball(2000)
    organ = (points[:, 2] < 0.15).astype(int)
    model = plant_model_from_points(points, normals, 300, organ, organ_area={Organ.WOOD: 0.02})
    assert model.materials == ("leaf", "wood")
    assert float(model.organ_area[1]) == pytest.approx(0.02)
    assert float(model.organ_area[0]) == pytest.approx(4 * np.pi * 0.09 * 0.75, rel=0.05)
    wood = np.asarray(model.plant.organ) == Organ.WOOD
    assert np.asarray(model.position)[wood, 2].max() < 0.16
    turned = np.stack([points[:, 0], points[:, 2], -points[:, 1]], axis=1)
    same = plant_model_from_points(
        turned,
        np.stack([normals[:, 0], normals[:, 2], -normals[:, 1]], axis=1),
        300,
        organ,
        organ_area={Organ.WOOD: 0.02},
        up="y",
    )
    np.testing.assert_allclose(same.plant.position, model.plant.position, atol=1e-12)


def test_files(tmp_path: Path) -> None:
    points, normals = ball(200)
    organ = np.arange(200) % 3
    table = np.column_stack([points, normals, organ])
    plain, named = tmp_path / "scan.xyz", tmp_path / "scan.csv"
    np.savetxt(plain, table, fmt="%.9g")
    np.savetxt(named, table[:, ::-1], "%.9g", ",", header="organ,nz,ny,nx,z,y,x", comments="")
    names = ("x", "y", "z", "nx", "ny", "nz")
    ply = write_ply(tmp_path / "scan.ply", [f"float {name}" for name in names], table[:, :6])
    for path in (plain, named, ply):
        read_points, read_normals, read_organ = read_scan(path)
        np.testing.assert_allclose(read_points, points, rtol=1e-6)
        np.testing.assert_allclose(read_normals, normals, atol=1e-6)
        if path is ply:
            assert read_organ is None
        else:
            assert read_organ is not None
            np.testing.assert_array_equal(read_organ, organ)
    bare = tmp_path / "bare.xyz"
    np.savetxt(bare, points)
    with pytest.raises(InputError, match=r"bare.xyz: .*nx, ny, nz"):
        read_scan(bare)
    bare.write_text("0 0 0 0 0 1\n0 0 x 0 0 1\n")
    with pytest.raises(InputError, match=r"bare.xyz, row 2"):
        read_scan(bare)
    bare.write_text("")
    with pytest.raises(InputError, match="empty"):
        read_scan(bare)
    with pytest.raises(InputError, match="a scan with normals, but there is no such file"):
        read_scan(tmp_path / "none.ply")
    with pytest.raises(InputError, match="no such file"):
        read_scan(tmp_path / "none.xyz")


POINT = "1 2 3 0 0 1"


@pytest.mark.parametrize(
    "text",
    [
        "//X Y Z R G B Nx Ny Nz\n1 2 3 90 80 70 0 0 1\n4 5 6 90 80 70 0 1 0\n",
        "//X Y Z R G B Nx Ny Nz\n2\n1 2 3 90 80 70 0 0 1\n4 5 6 nan 80 70 0 1 0\n",
        "x;y;z;nx;ny;nz\n1;2;3;0;0;1\n4;5;6;0;1;0\n",
        "\ufeff# a scan\nX,Y,Z,NX,NY,NZ,\r\n1,2,3,0,0,1,\r\n\r\n4,5,6,0,1,0,\r\n",
        "x (m), y (m), z (m), nx, ny, nz, h\n1, 2, 3, 0, 0, 1, a\n4, 5, 6, 0, 1, 0,\n",
        "normal_z\tnormal_y\tnormal_x\tz\ty\tx\n1\t0\t0\t3\t2\t1\n0\t1\t0\t6\t5\t4\n",
        "  1  2 3 0 0 1\n  4 5 6 0 1 0",
        "1,0 2 3 0,0 0 1\n4 5,0 6 0 1 0",
        "x;y;z;nx;ny;nz\n1,0;2;3;0;0;1\n4;5;6,0;0;1;0\n",
    ],
)
def test_text_as_other_programs_write_it(text: str, tmp_path: Path) -> None:
    path = tmp_path / "scan.txt"
    path.write_text(text, encoding="utf-8")
    points, normals, organ = read_scan(path)
    np.testing.assert_array_equal(points, [[1, 2, 3], [4, 5, 6]])
    np.testing.assert_array_equal(normals, [[0, 0, 1], [0, 1, 0]])
    assert organ is None


def test_organs_as_words(tmp_path: Path) -> None:
    path = tmp_path / "scan.csv"
    path.write_text("x,y,z,nx,ny,nz,organ\n0,0,0,0,0,1,Leaf\n0,0,0,0,0,1,bark\n0,0,0,0,0,1,2\n")
    organ = read_scan(path)[2]
    assert organ is not None
    assert organ.tolist() == [0, 1, 2]


@pytest.mark.parametrize(
    ("text", "word"),
    [
        (f"{POINT}\n{POINT}\n0 0 1\n", r"row 3: expected 6 cells .* has 3: '0 0 1'"),
        (f"{POINT}\n\n5\n", r"row 3: expected 6 cells .* has 1"),
        (f"{POINT}\n{POINT} 1\n", "row 2: expected 6 cells .* has 7"),
        ("x;y;z;nx;ny;nz\n1;2;3,5;0;0;1\n1;2.5;3;0;0;1\n", r"row 3, column 'y': .*2\.5.*3,5.*2"),
        ("x,y,z,nx,ny,nz,organ\n0,0,0,0,0,1,0\n0,0,0,0,0,1,sky\n", r"row 3, column 'organ'.*sky"),
        ("x,y,z,nx,ny,nz\n", "only a header"),
        ("a,b\n1,2\n", "has no x, y, z, nx"),
        ("x,y,z,nx,ny,nz,organ\n0,0,0,0,0,1,\n0,0,0,0,0,1\n", "row 3: expected 7 cells .* has 6"),
        (f"{POINT}\n{POINT}\n1,5 2,5 3.5 0 0 1\n", r"row 3, column 'z': .*3\.5.*1,5"),
        ("x [cm],y,z,nx,ny,nz\n1,2,3,0,0,1\n", r"row 1, column 'x \[cm\]': expected metres"),
        ("1 2 3 9 9 9 0 0 1\n", "9 columns must name them in a header"),
    ],
)
def test_wrong_rows_are_named(text: str, word: str, tmp_path: Path) -> None:
    path = tmp_path / "scan.xyz"
    path.write_text(text)
    with pytest.raises(InputError, match=f"scan.xyz.*{word}"):
        read_scan(path)


def test_bad_clouds() -> None:
    points, normals = ball(100)
    zero, longer = normals.copy(), normals.copy()
    zero[:3] = 0.0
    longer[0] *= 2.0
    for bad, word in ((zero, "3 of 100 are zero"), (longer, "lengths"), (zero * np.nan, "finite")):
        with pytest.raises(InputError, match=word):
            plant_model_from_points(points, bad)
    with pytest.raises(InputError, match="centimetres"):
        plant_model_from_points(100.0 * points, normals)
    with pytest.raises(InputError, match="finite"):
        plant_model_from_points(points * np.inf, normals)
    with pytest.raises(InputError, match="flat"):
        plant_model_from_points(points * [1, 1, 0], normals)
    with pytest.raises(InputError, match="more points"):
        plant_model_from_points(points[:8], normals[:8])
    with pytest.raises(InputError, match="`points` and `normals`"):
        plant_model_from_points(points, normals[:8])
    with pytest.raises(InputError, match="`organ`"):
        plant_model_from_points(points, normals, organ=np.full(100, 5))
    with pytest.raises(InputError, match=r"leaf.*wood.*flower"):
        plant_model_from_points(points, normals, organ="root")
    with pytest.raises(InputError, match="`organ_area` of wood"):
        plant_model_from_points(points, normals, organ_area={"wood": 0.1})
    with pytest.raises(InputError, match="`up`"):
        plant_model_from_points(points, normals, up="x")  # type: ignore[arg-type]

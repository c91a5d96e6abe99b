"""Point clouds are read in metres, or refused with the reason."""

import struct
import sys
import warnings
from contextlib import nullcontext

import laspy
import numpy as np
import pytest
import trimesh
from rasterio.crs import CRS

from fynjax._core.errors import InputError, MissingExtraError
from fynjax._core.tables import open_points
from fynjax.app.terrain import PointCloud, read_cloud
from tests.helpers import write_ply
from tests.terrain.synthetic import CORNER

RNG = np.random.default_rng(1)
POINTS = np.column_stack(
    [
        CORNER[0] + RNG.uniform(0.0, 10.0, 400),
        CORNER[1] + RNG.uniform(0.0, 10.0, 400),
        350.0 + RNG.uniform(0.0, 2.0, 400),
    ]
)


def write_las(path, points=POINTS, *, labels=None, version="1.4", point_format=6, wkt=None):
    header = laspy.LasHeader(version=version, point_format=point_format)
    header.offsets, header.scales = points.min(axis=0).round(), [0.001] * 3
    if wkt is not None:
        header.vlrs.append(laspy.vlrs.known.WktCoordinateSystemVlr(wkt))
        header.global_encoding.wkt = True
    las = laspy.LasData(header)
    las.x, las.y, las.z = points.T
    if labels is not None:
        las.classification = labels
    return las, path


def written(path, *arguments, **keywords):
    las, path = write_las(path, *arguments, **keywords)
    las.write(path)
    return path


@pytest.mark.parametrize("suffix", ["las", "laz"])
def test_las_and_laz_come_back(tmp_path, suffix):
    labels = np.where(np.arange(400) % 3, 2, 5).astype(np.uint8)
    wkt = CRS.from_epsg(32734).to_wkt()
    cloud = read_cloud(written(tmp_path / f"a.{suffix}", labels=labels, wkt=wkt))
    assert np.abs(np.stack([cloud.x, cloud.y, cloud.z], axis=1) - POINTS).max() <= 0.00051
    assert (cloud.classification == labels).all()
    assert CRS.from_wkt(cloud.crs).to_epsg() == 32734


def test_unclassified_las_has_no_classes_and_the_users_crs(tmp_path):
    path = written(tmp_path / "a.las", version="1.2", point_format=0)
    assert read_cloud(path).classification is None
    assert read_cloud(path).crs is None
    assert CRS.from_wkt(read_cloud(path, crs="EPSG:32734").crs).to_epsg() == 32734


def test_noise_and_withheld_points_are_left_out(tmp_path):
    labels = np.full(400, 2, np.uint8)
    labels[:7], labels[7:10] = 7, 18
    las, path = write_las(tmp_path / "a.las", labels=labels)
    withheld = np.zeros(400, bool)
    withheld[9:15] = True
    las.withheld = withheld
    las.write(path)
    cloud = read_cloud(path)
    assert len(cloud) == 385
    np.testing.assert_allclose(cloud.x, POINTS[15:, 0], atol=0.00051)


def key_directory(keys):
    """A GeoKeyDirectoryTag as GeoTIFF 1.1 lays it out: version, then (key, 0, 1, value)."""
    record = laspy.vlrs.known.GeoKeyDirectoryVlr()
    values = [1, 1, 0, len(keys)]
    doubles, texts = b"", b""
    for key, value in keys.items():
        if isinstance(value, float):
            values += [key, 34736, 1, len(doubles) // 8]
            doubles += struct.pack("<d", value)
        elif isinstance(value, str):
            values += [key, 34737, len(value), len(texts)]
            texts += value.encode()
        else:
            values += [key, 0, 1, value]
    record.parse_record_data(struct.pack(f"<{len(values)}H", *values))
    others = [(34736, doubles), (34737, texts + b"\0")]
    return [record, *(laspy.VLR("LASF_Projection", tag, "", data) for tag, data in others)]


def las_with_keys(path, keys):
    las, path = write_las(path, version="1.2", point_format=0)
    las.header.vlrs.extend(key_directory(keys))
    las.write(path)
    return path


def test_crs_of_geotiff_keys(tmp_path):
    cloud = read_cloud(las_with_keys(tmp_path / "a.las", {1024: 1, 3072: 32734}))
    assert CRS.from_wkt(cloud.crs).to_epsg() == 32734


@pytest.mark.parametrize(
    ("keys", "said"),
    [
        ({2048: 4326}, "degrees"),
        ({3072: 2227}, "us_survey_foot"),  # NAD83 / California zone 3 (ftUS)
        ({3072: 32767, 3076: 9002}, "coordinates in metres, but the file says foot"),
        ({3072: 32734, 4099: 9003}, "heights in metres, but the file says us_survey_foot"),
        ({3072: 26910, 4096: 6360}, "heights in metres, but the file says us_survey_foot"),
        ({3072: 32767, 3076: 32767, 3077: 0.3048}, "coordinates in metres, but .* says foot"),
        ({3072: 32767, 3076: 9005}, "the file says units of 0.304797 m"),
        ({3072: 32767, 1026: "California zone 3 (ftUS)|"}, "coordinates .* us_survey_foot"),
        ({3072: 26910, 1026: "UTM 10N + NAVD88 (ftUS)|"}, "heights .* us_survey_foot"),
        ({3072: 3857}, r"lengths are 1\.\d+ times as long .* to EPSG:326"),
    ],
)
def test_degrees_and_feet_that_the_file_states(tmp_path, keys, said):
    with pytest.raises(InputError, match=said):
        read_cloud(las_with_keys(tmp_path / "a.las", keys))


def test_feet_that_the_user_states_become_metres(tmp_path):
    path = las_with_keys(tmp_path / "a.las", {3072: 2227})
    cloud = read_cloud(path, unit="us_survey_foot")
    np.testing.assert_allclose(cloud.x, POINTS[:, 0] * 0.3048006096, rtol=1e-8)
    np.testing.assert_allclose(cloud.z, POINTS[:, 2] * 0.3048006096, atol=0.001)
    assert cloud.crs is None
    heights = las_with_keys(tmp_path / "b.las", {3072: 32734, 4099: 9002})
    cloud = read_cloud(heights, height_unit="foot")
    np.testing.assert_allclose(cloud.x, POINTS[:, 0], atol=0.001)
    np.testing.assert_allclose(cloud.z, POINTS[:, 2] * 0.3048, atol=0.001)
    assert CRS.from_wkt(cloud.crs).to_epsg() == 32734


def test_vertical_feet_of_a_compound_system(tmp_path):
    wkt = CRS.from_user_input("EPSG:32734+6360").to_wkt()  # NAVD88 height (ftUS)
    with pytest.raises(InputError, match=r"heights in metres.*us_survey_foot"):
        read_cloud(written(tmp_path / "a.las", wkt=wkt))


@pytest.mark.parametrize(("version", "kind"), [("1.2", 0), ("1.4", 6)])
def test_points_beyond_the_count_of_the_header_are_told(tmp_path, version, kind):
    path = written(tmp_path / "a.las", version=version, point_format=kind)
    held = bytearray(path.read_bytes())
    with warnings.catch_warnings(action="error"):
        assert len(read_cloud(path)) == 400
    if version == "1.4":
        struct.pack_into("<Q", held, 247, 350)
    else:
        struct.pack_into("<I", held, 107, 350)
    path.write_bytes(held)
    with pytest.warns(UserWarning, match="header counts 350 points, but the file has room for 400"):
        assert len(read_cloud(path)) == 350


def test_columns_without_names_that_are_no_x_and_y(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text(text([(k, *row) for k, row in enumerate(POINTS.tolist())]))
    with pytest.raises(InputError, match="the first counts the points from 0 to 399"):
        read_cloud(path)
    path.write_text(text(POINTS[:, [1, 0, 2]].tolist()))
    with pytest.warns(UserWarning, match="Northing first"):
        read_cloud(path)


def test_properties_of_ply_in_capitals(tmp_path):
    path = tmp_path / "a.ply"
    names = "".join(f"property float {axis}\n" for axis in "XYZ")
    head = f"ply\nformat ascii 1.0\nelement vertex 3\n{names}end_header\n"
    path.write_text(head + "0 0 1\n5 0 1\n0 5 1\n")
    with pytest.raises(InputError, match=r"no property 'x'\).*in small letters"):
        read_cloud(path)


def test_geocentric_coordinates(tmp_path):
    wkt = CRS.from_epsg(4978).to_wkt()
    with pytest.raises(InputError, match="geocentric"):
        read_cloud(written(tmp_path / "a.las", wkt=wkt))


@pytest.mark.parametrize("suffix", ["las", "laz"])
@pytest.mark.parametrize("share", [0.01, 0.5, 0.9])
def test_las_cut_short(tmp_path, suffix, share):
    path = written(tmp_path / f"a.{suffix}")
    whole = path.read_bytes()
    path.write_bytes(whole[: int(len(whole) * share)])
    with pytest.raises(InputError, match="cut short"):
        read_cloud(path)


def test_las_cut_between_two_points(tmp_path):
    path = written(tmp_path / "a.las")
    with laspy.open(path) as file:
        size, start = file.header.point_format.size, file.header.offset_to_point_data
    path.write_bytes(path.read_bytes()[: start + 100 * size])
    with pytest.raises(InputError, match="cut short"):
        read_cloud(path)


def test_ply_with_classes(tmp_path):
    kinds = ["double x", "double y", "double z", "float scalar_Classification"]
    table = np.column_stack([POINTS, np.arange(400) % 3])
    cloud = read_cloud(write_ply(tmp_path / "a.ply", kinds, table))
    np.testing.assert_array_equal(np.stack([cloud.x, cloud.y, cloud.z], axis=1), POINTS)
    np.testing.assert_array_equal(cloud.classification, np.arange(400) % 3)


def test_binary_ply_in_single_precision(tmp_path):
    path = tmp_path / "a.ply"
    trimesh.PointCloud(POINTS - POINTS.min(axis=0)).export(path)
    assert np.ptp(read_cloud(path).x) == pytest.approx(np.ptp(POINTS[:, 0]), abs=1e-5)
    trimesh.PointCloud(POINTS).export(path)
    with pytest.raises(InputError, match=r"single precision.*steps of 0.5 m"):
        read_cloud(path)
    path.write_bytes(path.read_bytes()[:3000])
    with pytest.raises(InputError, match="cut short"):
        read_cloud(path)


def assert_read(cloud):
    np.testing.assert_array_equal(np.stack([cloud.x, cloud.y, cloud.z], axis=1), POINTS)


@pytest.mark.parametrize(
    ("name", "head", "separator"),
    [
        ("a.xyz", "", " "),
        ("a.txt", "", "\t"),
        ("a.csv", "x,y,z\n", ","),
        ("a.csv", "Easting (m),Northing (m),Elevation (m)\n", ","),
        ("a.txt", "# a comment\n//X Y Z\n", " "),
        ("a.csv", "X;Y;Z\n", ";"),
        ("a.csv", "\ufeffx,y,z\n", ","),
        ("a.xyz", "400\n", " "),
        ("a.txt", "//X Y Z\n\n400\n", "\t"),
        ("a.txt", "# x y z\n", ";"),
        ("a.txt", "sep=;\nX;Y;Z\n", ";"),
    ],
)
def test_text_clouds(tmp_path, name, head, separator):
    rows = [separator.join(repr(v) for v in row) for row in POINTS.tolist()]
    (tmp_path / name).write_text(head + "\n".join(rows) + "\n", encoding="utf-8")
    cloud = read_cloud(tmp_path / name)
    assert_read(cloud)
    assert cloud.classification is None


def test_text_columns_go_by_name(tmp_path):
    rows = [f"9,{k % 4},{z!r},{y!r},{x!r}" for k, (x, y, z) in enumerate(POINTS.tolist())]
    path = tmp_path / "a.csv"
    for header in ("450,Classification,Z,Y,X", "#450 Classification Z Y X"):
        path.write_text(header + "\n" + "\n".join(rows) + "\n")
        cloud = read_cloud(path)
        assert_read(cloud)
        np.testing.assert_array_equal(cloud.classification, np.arange(400) % 4)


def test_text_with_words_and_gaps_beside_the_numbers(tmp_path):
    """Labels with a separator, empty or missing numbers; separators that end rows; blank rows."""
    labels = [' "a, b"', "", "nan", " # said", "7,", "tree\n\n,,,,\n \n  # said"]
    rows = [
        f"{k},{x!r}, {y!r},{z!r},{labels[k % len(labels)]}\n"
        for k, (x, y, z) in enumerate(POINTS.tolist())
    ]
    path = tmp_path / "a.csv"
    path.write_text(",Easting,Northing,Height,Tree,\n" + "".join(rows))
    cloud = read_cloud(path)
    assert_read(cloud)
    for bad, said in (
        ("1,2,3,4", "expected 5 cells .* has 4"),
        ("1,2,?,4,5", "'Northing': .*got '.'"),
    ):
        path.write_text(",Easting,Northing,Height,Tree,\n" + "".join([*rows, bad]))
        with pytest.raises(InputError, match=said) as caught:
            read_cloud(path)
        assert caught.value.row == path.read_text().count("\n") + 1


def test_text_columns_of_words_stay_as_written(tmp_path):
    (tmp_path / "a.csv").write_text("tree,x,y,z\n007,1,2,3\n012, 4,5,6\n")
    found = open_points(tmp_path / "a.csv", "a cloud", "xyz").columns([3], [0])
    assert found[0].tolist() == ["007", "012"]
    assert found[3].tolist() == [3.0, 6.0]


GRID = [(x, y, 0.1 * x) for x in range(5) for y in range(5)]


def text(rows, head="", separator=","):
    return head + "\n".join(separator.join(str(v) for v in row) for row in rows) + "\n"


@pytest.mark.parametrize(
    ("content", "said", "row"),
    [
        (
            text([*GRID[:3], (1, 2, "nan"), *GRID[3:]]),
            "got 'nan'. Not measured. Leave it, or its row, out",
            4,
        ),
        (text([*GRID[:3], (1, 2, "tree"), *GRID], "x,y,z\n"), "number, but got 'tree'", 5),
        (text([*GRID[:3], (1, 2), *GRID]), "expected 3 cells .* has 2: '1,2'", 4),
        (text([*GRID[:3], (1, 2, ""), *GRID]), "column 'z': expected a number, but got ''", 4),
        (text([*GRID[:3], (1, "", 2), *GRID]), "column 'y': expected a number, but got ''", 4),
        (text([*GRID, (5,)], "", " "), "expected 3 cells .* has 1: '5'", 26),
        (text([*GRID, (1, 2, 3, 4)]), "expected 3 cells .* has 4", 26),
        (text([*GRID, (1, 2, 3, "", 4)]), "expected 3 cells .* has 5", 26),
        (text([(*row, "", 4) for row in GRID], "x,y,z\n"), "expected 3 cells .* has 5", 2),
        (text([(*row, 4, "") for row in GRID], "x,y,z\n"), "expected 3 cells .* has 4", 2),
        (text([(1, 2, 3, "p"), (1, 2, 3, ""), (1, 2)], "x,y,z,name\n"), "4 cells .* has 2", 4),
        ("25\n" + text([*GRID, (5,)], "", " "), "expected 3 cells .* has 1", 27),
        (text([*GRID, (1, 2, "tree")], "1,tree,3\n"), "column 'y': .* got 'tree'", 1),
        ("x,y,z\n1,2,3\n,,\n  # b\n1,2,tree\n", "got 'tree'", 5),
        (text([("1,5", "2,5", "3.5")] * 9, "", " "), r"'3.5' here and '1,5' in row 1", 1),
        (text([(1, 5, 2, 5, 3, 5)] * 9), r"'1,5,2,5,3,5' can be read with commas between", 1),
        ("x,y,z\n", "only a header", None),
        ("# a\nx y z\n\n1 2 3\n# b\n\n1 2 tree\n" + text(GRID, "", " "), "got 'tree'", 7),
        (text(GRID, "a,b,c\n"), "columns x, y and z, but the header has a, b, c", 1),
        (text(GRID, "longitude,latitude,z\n"), "Longitude and latitude", 1),
        (text(GRID, "x [cm],y [cm],z [cm]\n"), "header says 'cm'. State the unit", 1),
        (text(GRID, "x_ft,y_ft,z_ft\n"), "header says 'ft'", 1),
        (text([(1, 2), (3, 4), (5, 6)]), "x, y and z in each row", 1),
        (text([("1,5", "2,5", "1.234,5")], separator=";"), "'1.234,5'. Marks between thousands", 1),
        (text([(*row, 1) for row in GRID], "x,y,z,z\n"), "column 'z': .* there twice", 1),
        (text(GRID) + '"1,2,3\n', "a quotation mark opens .* none closes", 26),
        ('x,y,z\n1,2,3\n1,2,"3', "a quotation mark opens .* none closes", 3),
        ("# nothing\n", "empty", None),
        ("// nothing\n", "no numbers", None),
        ("", "empty", None),
        (text(GRID[:2]), "has 2 points", None),
        (text([(1, y, z) for _, y, z in GRID]), "extend 0 by 4", None),
    ],
)
def test_text_that_is_wrong(tmp_path, content, said, row):
    path = tmp_path / "a.csv"
    path.write_text(content)
    with pytest.raises(InputError, match=said) as caught:
        read_cloud(path)
    assert str(path) in str(caught.value)
    assert caught.value.row == row


def test_other_files(tmp_path):
    (tmp_path / "a.xyz").write_bytes(bytes(range(256)) * 9)
    (tmp_path / "a.docx").write_text("x")
    (tmp_path / "a.las").write_text("no cloud")
    with pytest.raises(InputError, match="binary"):
        read_cloud(tmp_path / "a.xyz")
    with pytest.raises(InputError, match="expected a point cloud"):
        read_cloud(tmp_path / "a.docx")
    with pytest.raises(InputError, match="cannot be read as LAS"):
        read_cloud(tmp_path / "a.las")
    with pytest.raises(InputError, match=r"no such file.*'a\.las'"):
        read_cloud(tmp_path / "b.las")


def saved(path, points):
    np.savetxt(path, points, fmt="%.9f")
    return path


def test_numbers_that_are_no_metres(tmp_path):
    path = tmp_path / "a.xyz"
    local = POINTS - [*CORNER, 0.0]
    degrees = local * [1e-5, 1e-5, 1.0] + [19.4, -34.4, 0.0]
    with pytest.raises(InputError, match="degrees of longitude"):
        read_cloud(saved(path, degrees))
    centimetres = local * 100.0
    with pytest.raises(InputError, match="centimetres"):
        read_cloud(saved(path, centimetres))
    cloud = read_cloud(path, unit="centimetre")
    np.testing.assert_allclose(np.stack([cloud.x, cloud.y, cloud.z], axis=1), local, atol=1e-9)
    with pytest.warns(UserWarning, match="no height above the sea"):
        assert len(read_cloud(path, unit="metre")) == 400
    mixed = local * [1.0, 1.0, 100.0]
    with pytest.raises(InputError, match="Are heights in another unit"):
        read_cloud(saved(path, mixed))
    np.testing.assert_allclose(read_cloud(path, height_unit="centimetre").z, local[:, 2])
    with pytest.raises(InputError, match=r"`unit` .*metre"):
        read_cloud(path, unit="cm")
    with pytest.raises(InputError, match="EPSG:32734"):
        read_cloud(saved(path, local), crs="EPSG:1")


def test_a_height_that_stands_for_missing_data(tmp_path):
    points = POINTS.copy()
    points[7, 2] = -9999.0
    with pytest.raises(InputError, match=r"a\.xyz: .*-9999 .*351"):
        read_cloud(saved(tmp_path / "a.xyz", points))


def test_crop_keeps_what_is_inside():
    cloud = PointCloud(*POINTS.T, classification=np.arange(400, dtype=np.uint8))
    west, south = CORNER
    part = cloud.crop((west, south, west + 5.0, south + 4.0), margin=1.0)
    inside = (POINTS[:, 0] <= west + 6.0) & (POINTS[:, 1] <= south + 5.0)
    np.testing.assert_array_equal(part.z, POINTS[inside, 2])
    np.testing.assert_array_equal(part.classification, np.flatnonzero(inside).astype(np.uint8))
    with pytest.raises(InputError, match="no point of the cloud"):
        cloud.crop((0.0, 0.0, 10.0, 10.0))
    with pytest.raises(InputError, match=r"\(6191200\.25, 412300\.50\) to"):
        cloud.crop((6191200.25, 412300.5, 6191210.25, 412310.5))
    with pytest.raises(InputError, match="west < east"):
        cloud.crop((1.0, 0.0, 0.0, 1.0))


@pytest.mark.parametrize("missing", ["laspy", "lazrs"])
def test_without_the_extra_the_command_is_named(tmp_path, monkeypatch, missing):
    path = written(tmp_path / "a.laz")
    monkeypatch.setitem(sys.modules, missing, None)
    with pytest.raises(MissingExtraError, match=r'pip install "fynjax\[terrain\]"'):
        read_cloud(path)


@pytest.mark.parametrize(
    ("far", "distance", "left"), [(2, 90.0, 3000), (60, 90.0, 3060), (2, 25.0, 3002)]
)
def test_only_a_few_points_far_away_are_strays(far, distance, left, tmp_path):
    rng = np.random.default_rng(0)
    near = rng.uniform(0.0, 20.0, (3000, 3)) * (1.0, 1.0, 0.1)
    away = np.tile([distance, 5.0, 1.0], (far, 1)) + rng.uniform(0.0, 1.0, (far, 3))
    path = tmp_path / "cloud.ply"
    write_ply(path, ["double x", "double y", "double z"], np.concatenate([near, away]))
    few = pytest.warns(UserWarning, match="2 of 3002 points lie far from all others")
    with few if left == 3000 else nullcontext():
        cloud = read_cloud(path)
    assert len(cloud) == left


@pytest.mark.parametrize("text", ["''", '""', "  ", "unknown", "None"])
def test_a_record_that_states_no_system_is_none(tmp_path, text):
    """Points are in metres by their numbers; no word is needed."""
    cloud = read_cloud(written(tmp_path / "a.las", wkt=text))
    assert cloud.crs is None
    assert len(cloud) == len(POINTS)


def test_a_system_that_is_not_known_can_be_stated(tmp_path):
    path = written(tmp_path / "a.las", wkt="LOCAL OF MINE")
    with pytest.raises(InputError, match=r"'LOCAL OF MINE', which is not known.*--crs EPSG"):
        read_cloud(path)
    assert CRS.from_wkt(read_cloud(path, crs="EPSG:32734").crs).to_epsg() == 32734


def test_a_cloud_of_the_field_without_a_system(shared_data):
    (path,) = (shared_data / "field" / "26_las-wkt-of-two-quotes").glob("*.las")
    assert (len(read_cloud(path)), read_cloud(path).crs) == (600, None)


def text_file(path, text):
    path.write_text(text)
    return path


def ptx(points, matrix, shape):
    head = [*map(str, shape), "0 0 0", "1 0 0", "0 1 0", "0 0 1"]
    rows = [" ".join(f"{n:g}" for n in row) for row in matrix]
    return "\n".join([*head, *rows, *(f"{x} {y} {z} 0.5 9 9 9" for x, y, z in points)]) + "\n"


def test_stations_of_ptx_are_put_together(tmp_path):
    turned = np.array([[0, 1, 0, 0], [-1, 0, 0, 0], [0, 0, 1, 0], [10, 20, 1, 1.0]])
    still = np.eye(4)
    first = np.random.default_rng(0).uniform(1.0, 3.0, (6, 3)).round(3)
    first[4] = 0.0  # nothing came back
    text = ptx(first, still, (2, 3)) + ptx(first, turned, (3, 2))
    cloud = read_cloud(text_file(tmp_path / "two.ptx", text))
    kept = np.delete(first, 4, axis=0)
    moved = np.stack([10.0 - kept[:, 1], 20.0 + kept[:, 0], 1.0 + kept[:, 2]], axis=1)
    np.testing.assert_allclose(
        np.stack([cloud.x, cloud.y, cloud.z], axis=1), np.concatenate([kept, moved])
    )
    cut = text[: int(0.8 * len(text))].rsplit("\n", 1)[0] + "\n"
    with pytest.raises(InputError, match="cut short"):
        read_cloud(text_file(tmp_path / "cut.ptx", cut))
    with pytest.raises(InputError, match="ten lines of numbers"):
        read_cloud(text_file(tmp_path / "none.ptx", "x y z\n1 2 3\n"))
    with pytest.raises(InputError, match="ten lines of numbers"):
        read_cloud(text_file(tmp_path / "one.ptx", "2\n"))


def test_pts_begins_with_its_number_of_points(tmp_path):
    text = "3\n" + "".join(f"{i} {2 * i} {0.1 * i} -5 10 20 30\n" for i in range(1, 4))
    cloud = read_cloud(text_file(tmp_path / "a.pts", text))
    assert cloud.y.tolist() == [2.0, 4.0, 6.0]


def test_stations_of_e57_are_put_together(tmp_path):
    pye57 = pytest.importorskip("pye57")
    points = np.random.default_rng(1).uniform(0.0, 2.0, (5, 3))
    file = pye57.E57(str(tmp_path / "a.e57"), mode="w")
    for shift in (0.0, 10.0):
        axes = {f"cartesian{a}": points[:, i] for i, a in enumerate("XYZ")}
        file.write_scan_raw(
            axes, rotation=np.array([1.0, 0, 0, 0]), translation=np.array([shift, 0, 0])
        )
    file.close()
    cloud = read_cloud(tmp_path / "a.e57")
    np.testing.assert_allclose(cloud.x, np.concatenate([points[:, 0], points[:, 0] + 10.0]))
    (tmp_path / "cut.e57").write_bytes((tmp_path / "a.e57").read_bytes()[:700])
    with pytest.raises(InputError, match="cannot be read as E57"):
        read_cloud(tmp_path / "cut.e57")


def test_e57_without_its_package_says_which(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "pye57", None)
    (tmp_path / "a.e57").write_bytes(b"ASTM-E57")
    with pytest.raises(MissingExtraError, match="e57"):
        read_cloud(tmp_path / "a.e57")

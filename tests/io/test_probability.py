"""Probability maps as GeoTIFF: seen by another reader, cut and averaged onto the plot, refused."""

import shutil
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
from rasterio import Affine
from rasterio.crs import CRS
from rasterio.errors import NotGeoreferencedWarning

from fynjax._core.errors import InputError
from fynjax.app.assembly._build import _probability
from fynjax.app.io.plot import example_folder, read_plot
from fynjax.app.io.raster import read_probability_map, write_geotiff
from fynjax.app.io.raster._writer import LOCAL_FRAME

UTM = "EPSG:32734"
CORNER = (310_000.0, 6_180_000.0)
GREY = np.random.default_rng(3).integers(2, 256, (40, 60), dtype=np.uint8)  # row 0 south


def frame(cell: float = 0.5, corner: tuple[float, float] = CORNER, rows: int = 40) -> Affine:
    return Affine(cell, 0.0, corner[0], 0.0, -cell, corner[1] + rows * cell)


def write_map(path: Path, grey: np.ndarray, transform: Affine, **options: Any) -> None:
    """As `pattern` writes it."""
    options = {"nodata": None, **options}
    write_geotiff(path, grey[None], ["probability"], transform=transform, **options)


def raster(path: Path, values: np.ndarray, transform: Affine | None = None, **options: Any) -> Path:
    """A file as any other program would write it; `values` [y, x] or [band, y, x], row 0 south."""
    values = np.atleast_3d(values.T).T[:, ::-1]
    profile: dict[str, Any] = {"crs": UTM, "transform": transform or frame(rows=values.shape[1])}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", NotGeoreferencedWarning)
        file = rasterio.open(
            path,
            "w",
            driver="GTiff",
            dtype=values.dtype,
            count=len(values),
            height=values.shape[1],
            width=values.shape[2],
            **(profile | options),
        )
    with file:
        file.write(values)
    return path


def test_another_reader_sees_the_map_where_it_lies(tmp_path: Path) -> None:
    tifffile = pytest.importorskip("tifffile", reason="needs the extra `analysis`")
    path = tmp_path / "new" / "map.tif"
    write_map(path, GREY, frame(), crs=UTM, nodata=0, tags={"levels": [85, 255]})
    assert [p.name for p in path.parent.iterdir()] == ["map.tif"]
    with tifffile.TiffFile(path) as file:
        page = file.pages[0]
        disk, tags = page.asarray(), page.geotiff_tags
    assert disk.dtype == np.uint8
    np.testing.assert_array_equal(disk, GREY[::-1])
    assert tags["ProjectedCSTypeGeoKey"] == 32734
    np.testing.assert_array_equal(tags["ModelPixelScale"][:2], [0.5, 0.5])
    np.testing.assert_array_equal(tags["ModelTiepoint"][3:5], [CORNER[0], CORNER[1] + 20.0])
    with rasterio.open(path) as file:
        assert file.nodata == 0
        assert file.tags()["levels"] == "[85, 255]"
        assert next(file.sample([(CORNER[0] + 0.1, CORNER[1] + 0.1)]))[0] == GREY[0, 0]


def test_what_is_written_is_read(tmp_path: Path) -> None:
    write_map(tmp_path / "utm.tif", GREY, frame(), crs=UTM)
    write_map(tmp_path / "local.tif", GREY, frame(corner=(0.0, 0.0)))
    for name in ("utm.tif", "local.tif"):
        np.testing.assert_array_equal(read_probability_map(tmp_path / name, (30, 20)), GREY)


@pytest.mark.parametrize("dtype", ["uint8", "int16", "float32", "float64"])
def test_the_plot_is_cut_out_exactly(tmp_path: Path, dtype: str) -> None:
    path = raster(tmp_path / "m.tif", GREY.astype(dtype))
    origin = (CORNER[0] + 4.5, CORNER[1] + 3.0)
    got = read_probability_map(path, (10.0, 8.0), origin_m=origin)
    np.testing.assert_array_equal(got, GREY[6:22, 9:29])


def test_a_local_raster_lies_on_the_plots_corner(tmp_path: Path) -> None:
    local = {"crs": CRS.from_wkt(LOCAL_FRAME)}
    path = raster(tmp_path / "m.tif", GREY, frame(corner=(-1.0, -2.0)), **local)
    np.testing.assert_array_equal(read_probability_map(path, (5.0, 5.0)), GREY[4:14, 2:12])
    got = read_probability_map(path, (5.0, 5.0), origin_m=(0.0, 1.0))
    np.testing.assert_array_equal(got, GREY[6:16, 2:12])


def test_cells_that_do_not_fit_are_averaged_by_area(tmp_path: Path) -> None:
    """Against the same raster split into cells so fine that every edge is one of theirs."""
    path = raster(tmp_path / "m.tif", GREY)
    origin, size = (CORNER[0] + 1.3, CORNER[1] + 0.7), (7.2, 9.0)
    got = read_probability_map(path, size, origin_m=origin)
    assert got.shape == (18, 15)  # no larger than 0.5 m: 15 x 0.48, 18 x 0.5
    fine = np.kron(GREY.astype(float), np.ones((50, 50)))  # cells of 1 cm
    part = fine[70 : 70 + 900, 130 : 130 + 720]
    expected = part.reshape(18, 50, 15, 48).mean(axis=(1, 3))
    np.testing.assert_allclose(got, expected, atol=1e-6)  # of coordinates in the millions
    assert got.mean() == pytest.approx(part.mean(), abs=1e-6)


def test_a_raster_cut_to_whole_cells_is_stretched_a_little(tmp_path: Path) -> None:
    path = raster(tmp_path / "m.tif", GREY)
    np.testing.assert_array_equal(read_probability_map(path, (30.2, 20.2)), GREY)
    with pytest.raises(InputError, match="as large as the plot"):
        read_probability_map(path, (30.3, 20.0))
    with pytest.raises(InputError, match="covers the plot"):
        read_probability_map(path, (30.3, 20.0), origin_m=CORNER)


def test_a_scale_that_the_file_states_is_applied(tmp_path: Path) -> None:
    path = raster(tmp_path / "m.tif", GREY)
    with rasterio.open(path, "r+") as file:
        file.scales, file.offsets = (0.5,), (10.0,)
    np.testing.assert_allclose(read_probability_map(path, (30, 20)), 0.5 * GREY + 10.0)


def test_an_alpha_band_says_where_data_are(tmp_path: Path) -> None:
    opaque = np.full_like(GREY, 255)
    path = raster(
        tmp_path / "m.tif", np.stack([GREY, opaque]), photometric="minisblack", alpha="yes"
    )
    np.testing.assert_array_equal(read_probability_map(path, (30, 20)), GREY)


def with_value(value: float, row: int = 6, column: int = 9) -> np.ndarray:
    values = GREY.astype(np.float32)
    values[row, column] = value
    return values


TURNED = frame() @ Affine.rotation(20.0)
PLOT = {"size_m": (10.0, 8.0), "origin_m": (CORNER[0] + 4.5, CORNER[1] + 3.0)}


@pytest.mark.parametrize(
    ("values", "options", "word"),
    [
        (GREY, {"crs": None}, "no system.*gdal_edit.py -a_srs"),
        (GREY, {"transform": Affine.identity()}, "no place"),
        (GREY, {"crs": "EPSG:4326", "transform": Affine(1e-5, 0, 19, 0, -1e-5, -34)}, "degree"),
        (GREY, {"crs": "EPSG:2225"}, "foot"),
        (GREY, {"crs": "EPSG:2048"}, "grow to the west and south"),  # South Africa, Lo 19
        (GREY, {"transform": TURNED}, "rotated"),
        (GREY, {"transform": Affine(0.5, 0, CORNER[0], 0, 0.5, CORNER[1])}, "upside down"),
        (np.stack([GREY] * 5), {}, r"one band .* it has 5 .*fynjax pattern"),
        (GREY[:20], {}, "covers the plot"),
        (with_value(np.nan), {}, rf"1 of 320 have none .* \({CORNER[0] + 4.75:.2f}"),
        (with_value(-9999.0), {"nodata": -9999.0}, "1 of 320 have none"),
        (with_value(-9999.0), {}, "range from -9999"),
        (with_value(256.0), {}, "to 256"),
        (np.zeros_like(GREY), {}, "0 all over the plot"),
        (GREY / 255.0, {}, "0 to 1.*255"),
        ((GREY > 128).astype(np.uint8), {}, "a mask"),
    ],
)
def test_bad_maps(values: np.ndarray, options: dict[str, Any], word: str, tmp_path: Path) -> None:
    path = raster(tmp_path / "m.tif", values, **options)
    with pytest.raises(InputError, match=word) as caught:
        read_probability_map(path, **PLOT)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_what_lies_beside_the_plot_does_no_harm(tmp_path: Path) -> None:
    values = with_value(np.nan, 0, 0)
    values[:, -1] = -9999.0
    got = read_probability_map(raster(tmp_path / "m.tif", values), **PLOT)
    np.testing.assert_array_equal(got, GREY[6:22, 9:29])


def test_a_larger_map_asks_for_the_place(tmp_path: Path) -> None:
    path = raster(tmp_path / "m.tif", GREY)
    with pytest.raises(InputError, match=r"`map_origin` is the plot's south-west corner"):
        read_probability_map(path, (10.0, 10.0), option="map_origin")
    with pytest.raises(InputError, match="two numbers"):
        read_probability_map(path, (10.0, 10.0), origin_m=(0.0, np.nan))
    with pytest.raises(InputError, match="`size_m` must be positive"):
        read_probability_map(path, (10.0, 0.0))


def test_files_that_are_no_maps(tmp_path: Path) -> None:
    raster(tmp_path / "map.tif", GREY)
    with pytest.raises(InputError, match=r"no such file.*Did you mean 'map\.tif'"):
        read_probability_map(tmp_path / "mab.tif", (30, 20))
    whole = (tmp_path / "map.tif").read_bytes()
    (tmp_path / "cut.tif").write_bytes(whole[: len(whole) // 2])
    (tmp_path / "text.tif").write_text("0 128 255")
    for name in ("cut.tif", "text.tif"):
        with pytest.raises(InputError, match="cannot be read as a probability map"):
            read_probability_map(tmp_path / name, (30, 20))


def test_a_map_without_a_pattern_is_told(tmp_path: Path) -> None:
    path = raster(tmp_path / "m.tif", np.full_like(GREY, 170))
    with pytest.warns(UserWarning, match="170 all over the plot"):
        read_probability_map(path, (30, 20))


def test_a_map_of_classes_or_percent_is_doubted(tmp_path: Path) -> None:
    for largest, words in ((2, "in classes"), (100, "in percent")):
        path = raster(tmp_path / "m.tif", np.where(GREY > 100, largest, 1).astype(np.uint8))
        with pytest.warns(UserWarning, match=f"{largest}/255. Is the map {words}"):
            read_probability_map(path, (30, 20))
    for colour, grey in (((200, 0, 0, 255), False), ((200, 200, 200, 255), True)):
        with rasterio.open(path := raster(tmp_path / "p.tif", GREY), "r+") as file:
            file.write_colormap(1, {k: (k, k, k, 255) for k in range(256)} | {200: colour})
        if grey:
            assert read_probability_map(path, (30, 20)).shape == GREY.shape
        else:
            with pytest.raises(InputError, match="band 1 has a palette"):
                read_probability_map(path, (30, 20))


def test_a_plot_file_reads_its_map(tmp_path: Path) -> None:
    folder = tmp_path / "plot"
    shutil.copytree(example_folder(), folder)
    text = (folder / "plot.toml").read_text("utf-8")
    assert '# probability_map = "map.tif"' in text
    (folder / "plot.toml").write_text(text.replace("# probability_map", "probability_map"))
    values = np.full((20, 20), 200, np.uint8)
    values[3, 5] = 7
    write_map(folder / "map.tif", values, frame(0.5, (0.0, 0.0), 20))
    plot = read_plot(folder / "plot.toml")
    assert plot.size_m == (10.0, 10.0)
    np.testing.assert_array_equal(_probability(plot), values)

"""GeoTIFFs, checked by rasterio alone; what comes back is what went in."""

import shutil
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
import rasterio
from rasterio import Affine

from fynjax._core.errors import InputError
from fynjax.app.compare import DroneImage, read_drone_image
from fynjax.app.io.raster import open_raster, write_geotiff
from tests.helpers import read_cube, unix, write_raster

BANDS = ("green", "red", "red_edge", "nir")
CENTRES = (560.0, 650.0, 730.0, 860.0)


@pytest.fixture
def image():
    """4 bands, 30 x 20 pixels; brighter to the north, one bright pixel in the south-west corner."""
    values = np.full((4, 30, 20), 0.1) + np.linspace(0, 0.1, 30)[None, :, None]
    values[:, 0, 0] = 0.6
    return values.astype(np.float32)


def write(path, image, **options):
    write_geotiff(path, image, BANDS, pixel_m=0.5, wavelengths=CENTRES, **options)


def read_image(path, bands=None) -> DroneImage:
    return read_drone_image(path, bands=bands)


def test_rasterio_sees_north_up_places_names_and_tags(tmp_path, image):
    path = tmp_path / "out" / "image.tif"
    write(path, image, origin_m=(100.0, 200.0), tags={"seed": 3, "command": "fynjax render"})
    assert [p.name for p in path.parent.iterdir()] == ["image.tif"]  # no temporary, no sidecar
    with rasterio.open(path) as file:
        assert file.count == 4
        assert file.dtypes[0] == "float32"
        assert file.compression.name == "deflate"
        assert file.transform == Affine(0.5, 0, 100.0, 0, -0.5, 215.0)
        assert tuple(file.bounds) == (100.0, 200.0, 110.0, 215.0)
        disk = file.read()
        np.testing.assert_array_equal(disk, image[:, ::-1, :])
        # The south-west corner, asked for by its place on the ground.
        assert next(file.sample([(100.1, 200.1)]))[0] == np.float32(0.6)
        assert next(file.sample([(100.1, 214.9)]))[0] == image[0, -1, 0]
        assert file.descriptions == BANDS
        assert file.tags(4)["wavelength"] == "860"
        assert file.tags(4)["wavelength_units"] == "Nanometers"
        assert file.tags(4, ns="IMAGERY")["CENTRAL_WAVELENGTH_UM"] == "0.86"
        assert file.tags()["seed"] == "3"
        assert file.tags()["command"] == "fynjax render"
        assert np.isnan(file.nodata)
        assert not file.crs.is_geographic
        assert "metre" in file.crs.to_wkt()


def test_a_real_crs_is_kept(tmp_path, image):
    write(tmp_path / "i.tif", image, crs="EPSG:32734", origin_m=(6e5, 6.2e6))
    with rasterio.open(tmp_path / "i.tif") as file:
        assert file.crs.to_epsg() == 32734


def test_round_trip(tmp_path, image):
    write(tmp_path / "i.tif", image, origin_m=(3.0, 4.0))
    back = read_cube(tmp_path / "i.tif")
    np.testing.assert_array_equal(back.values, image.astype(float))
    assert back.names == BANDS
    assert back.pixel_m == 0.5
    assert back.origin_m == (3.0, 4.0)
    found = read_image(tmp_path / "i.tif")
    np.testing.assert_array_equal(found.values, image.astype(float))
    assert found.mask.all()
    assert found.mask.shape == (30, 20)
    assert found.without_data == 0


def test_bands_are_taken_by_name(tmp_path, image):
    shuffled = [3, 0, 2, 1]
    names = ["NIR", "Green", "Red edge", "Red"]
    scaled = image * np.array([1.0, 1.1, 1.2, 1.3])[:, None, None]
    write_geotiff(tmp_path / "i.tif", scaled[shuffled], names, pixel_m=0.5)
    np.testing.assert_allclose(read_image(tmp_path / "i.tif").values, scaled, rtol=1e-6)


def test_masked_pixels_are_counted(tmp_path, image):
    image[2, 5, 7] = np.nan  # one band is enough
    image[:, 6, 7] = 0.0  # undeclared border of a mosaic
    image[0, 8, 9] = np.inf
    write(tmp_path / "i.tif", image)
    back = read_image(tmp_path / "i.tif")
    assert back.without_data == 3
    assert "3 without data left out" in back.description()
    assert sorted(zip(*np.nonzero(~back.mask), strict=True)) == [(5, 7), (6, 7), (8, 9)]
    assert np.isnan(back.values[:, 5, 7]).all()
    assert np.isfinite(back.pixels).all()


def test_declared_nodata_is_masked(tmp_path, image):
    image[:, 1, 2] = -10000
    write(tmp_path / "i.tif", image, nodata=-10000.0)
    assert not read_image(tmp_path / "i.tif").mask[1, 2]


NORTH_UP = Affine(0.5, 0, 0, 0, -0.5, 10)


def raw(path, values, dtype, *, transform=NORTH_UP, **options):
    write_raster(path, values.astype(dtype), transform=transform, **options)


def test_south_up_files_are_not_flipped_twice(tmp_path, image):
    raw(tmp_path / "i.tif", image, "float32", transform=Affine(0.5, 0, 0, 0, 0.5, 20.0))
    back = read_cube(tmp_path / "i.tif")
    np.testing.assert_array_equal(back.values, image.astype(float))
    np.testing.assert_array_equal(read_image(tmp_path / "i.tif", BANDS).values, image.astype(float))
    assert back.origin_m == (0.0, 20.0)


def test_a_stated_scale_is_applied_and_an_unstated_one_refused(tmp_path, image):
    stored = np.round(image[:, ::-1] * 1e4)
    raw(tmp_path / "stated.tif", stored, "uint16", scale=1e-4)
    np.testing.assert_allclose(read_image(tmp_path / "stated.tif", BANDS).values, image, atol=1e-4)
    raw(tmp_path / "unstated.tif", stored, "uint16")
    with pytest.raises(InputError, match=r"0 to 10000.*-scale 0.0001"):
        read_image(tmp_path / "unstated.tif")
    raw(tmp_path / "percent.tif", image * 100, "float32")
    with pytest.raises(InputError, match=r"percent.*-scale 0.01"):
        read_image(tmp_path / "percent.tif")


def test_undeclared_nodata_is_named(tmp_path, image):
    image[:, 3, 3] = -10000
    raw(tmp_path / "i.tif", image, "float32")
    with pytest.raises(InputError, match=r"-10000 \(in 1 pixels\).*-a_nodata -10000"):
        read_image(tmp_path / "i.tif")


def test_a_band_below_zero_is_named(tmp_path, image):
    image[2] -= 0.3
    write(tmp_path / "dark.tif", np.maximum(image, -0.4))
    with pytest.raises(InputError, match=r"at least 0, but the median of a band is -0\."):
        read_image(tmp_path / "dark.tif")


@pytest.mark.parametrize("keep", [0.9, 0.5, 0.1, 0.01])
def test_a_truncated_file_is_named(tmp_path, keep):
    noise = np.random.default_rng(0).uniform(0.05, 0.3, (4, 300, 300))
    write(tmp_path / "i.tif", noise)
    whole = (tmp_path / "i.tif").read_bytes()
    (tmp_path / "i.tif").write_bytes(whole[: int(len(whole) * keep)])
    with pytest.raises(InputError, match="cut short") as caught:
        read_image(tmp_path / "i.tif")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("keep", [0.9, 0.3])
def test_a_truncated_file_with_its_directory_first_is_named(tmp_path, keep):
    # Uncompressed files begin with the directory: they open, and fail only on reading.
    raw(tmp_path / "i.tif", np.full((4, 300, 300), 0.2), "float32")
    whole = (tmp_path / "i.tif").read_bytes()
    (tmp_path / "i.tif").write_bytes(whole[: int(len(whole) * keep)])
    with pytest.raises(InputError, match="cut short"):
        read_image(tmp_path / "i.tif")


def test_other_slips_are_named(tmp_path, image):
    raw(tmp_path / "rgb.tif", image[:3], "float32")
    with pytest.raises(InputError, match="no single band is known as green"):
        read_image(tmp_path / "rgb.tif")
    names = ("green", "red", "blue", "nir")
    write_geotiff(tmp_path / "names.tif", image, names, pixel_m=0.5)
    with pytest.raises(InputError, match=r"known as red_edge among green, red, blue, nir"):
        read_image(tmp_path / "names.tif")
    write(tmp_path / "empty.tif", np.full_like(image, np.nan))
    with pytest.raises(InputError, match="of 600 pixels 600 are without data"):
        read_image(tmp_path / "empty.tif")
    (tmp_path / "text.tif").write_text("not an image")
    with pytest.raises(InputError, match="cannot be read"):
        read_image(tmp_path / "text.tif")
    with pytest.raises(InputError, match=r"Did you mean 'names.tif'"):
        read_image(tmp_path / "name.tif")
    turned = NORTH_UP @ Affine.rotation(20)
    raw(tmp_path / "turned.tif", image, "float32", transform=turned)
    with pytest.raises(InputError, match="rotated"):
        read_cube(tmp_path / "turned.tif")


def test_a_file_without_georeference_has_no_pixel_size(tmp_path, image):
    with pytest.warns(rasterio.errors.NotGeoreferencedWarning):
        raw(tmp_path / "i.tif", image, "float32", transform=Affine.identity())
    assert read_image(tmp_path / "i.tif", BANDS).pixel_m is None
    assert read_cube(tmp_path / "i.tif").pixel_m == 0.0  # of the tests' own reader


def test_a_failed_write_leaves_the_old_file_and_nothing_else(tmp_path, image):
    path = tmp_path / "i.tif"
    write(path, image)
    before = path.read_bytes()
    with pytest.raises(TypeError):
        write(path, image, tags={"bad": object()})  # fails after the pixels are written
    assert path.read_bytes() == before
    assert [p.name for p in tmp_path.iterdir()] == ["i.tif"]
    with pytest.raises(ValueError, match="4 bands"):
        write(path, image[:3])


VRT = """<VRTDataset rasterXSize="20" rasterYSize="30"><VRTRasterBand dataType="Float32" band="1">
<SimpleSource><SourceFilename relativeToVRT="{}">{}</SourceFilename><SourceBand>1</SourceBand>
</SimpleSource></VRTRasterBand></VRTDataset>"""


REFUSED = r"holds its own values, but .* names other files.*gdal_translate"


def pam(key: str) -> str:
    """A file of GDAL beside a raster, with where its overviews are."""
    item = f'<MDI key="{key}">{{}}</MDI>'
    return f'<PAMDataset><Metadata domain="overviews">{item}</Metadata></PAMDataset>'


def without_word(path: Path, network: socket.socket) -> None:
    """That a raster is refused in one line, and nobody was asked on the network."""
    with pytest.raises(InputError, match=REFUSED) as caught, open_raster(path, "a map") as file:
        file.read()
    assert "\n" not in str(caught.value)
    with pytest.raises(BlockingIOError):
        network.accept()


@pytest.fixture
def network() -> Iterator[socket.socket]:
    with socket.socket() as listening:
        listening.bind(("127.0.0.1", 0))
        listening.listen()
        listening.setblocking(False)
        yield listening


def test_a_raster_of_other_files_is_refused_and_asks_no_network(tmp_path, image, network):
    write(tmp_path / "image.tif", image)
    write(tmp_path / "secret.tif", image)
    secret = tmp_path / "secret.tif"
    port = network.getsockname()[1]
    places = [str(secret), f"/vsicurl/http://127.0.0.1:{port}/a.tif", f"/vsizip/{secret}",
              f"http://127.0.0.1:{port}/a.tif", f'NETCDF:"{secret}":x']  # fmt: skip
    for place in places:
        virtual = VRT.format(0, place)
        for name in ("map.vrt", "map.tif", "map"):
            for before in ("", "II ", "MM", "<?xml version='1.0'?>\n<!-- -->"):
                (tmp_path / name).write_text(before + virtual.replace("VRTDataset", "vrtdataset"))
                without_word(tmp_path / name, network)
                (tmp_path / name).write_text(before + virtual)
                without_word(tmp_path / name, network)
        for name in ("map.vrt", "map.tif", "map"):
            (tmp_path / name).unlink()
        key = "OVERVIEW&#95;FILE"
        for name, text in [
            ("image.tif.msk", virtual), ("image.tif.OVR", virtual), ("image.aux", virtual),
            ("image.tif.ovr", "EHFA_HEADER_TAG" + virtual), ("image.rrd", virtual),
            ("image.tif.aux.xml", pam("OVERVIEW_FILE").format(place)),
            ("image.tif.aux.xml", pam(key).format(place)),
        ]:  # fmt: skip
            (tmp_path / name).write_text(text)
            without_word(tmp_path / "image.tif", network)
            (tmp_path / name).unlink()
        # A mask that is a TIFF, whose overviews are elsewhere by its own or another file.
        shutil.copy(secret, tmp_path / "image.tif.msk")
        (tmp_path / "image.tif.msk.aux.xml").write_text(pam(key).format(place))
        without_word(tmp_path / "image.tif", network)
        (tmp_path / "image.tif.msk.aux.xml").unlink()
        (tmp_path / "image.tif.msk").unlink()
        inside = tmp_path / "inside.tif"
        shutil.copy(secret, inside)
        with rasterio.open(inside, "r+") as file:
            file.update_tags(ns="OVERVIEWS", OVERVIEW_FILE=place)
        without_word(inside, network)
    service = tmp_path / "service.tif"
    service.write_text(f"<GDAL_WMS><Service name='TMS'><ServerUrl>http://127.0.0.1:{port}/"
                       "</ServerUrl></Service></GDAL_WMS>")  # fmt: skip
    without_word(service, network)
    for other in [
        VRT.format(0, secret).replace("<VRTDataset", "<VRTDataset xmlns='urn:a'"),
        VRT.format(0, secret).replace("VRTDataset", "VrtDataset"),
        VRT.format(0, tmp_path / "nested.vrt"),
        f"<GDALTileIndexDataset><IndexDataset>{secret}</IndexDataset></GDALTileIndexDataset>",
        f"<MRF_META><Raster><Size x='20' y='30'/><DataFile>{secret}</DataFile></Raster></MRF_META>",
        f"<GDAL_WMTS><GetCapabilitiesUrl>http://127.0.0.1:{port}/</GetCapabilitiesUrl></GDAL_WMTS>",
    ]:
        for name in ("map.tif", "map.vrt", "map.gti", "map.mrf"):
            (tmp_path / name).write_text(other)
            without_word(tmp_path / name, network)
    with pytest.raises(InputError), open_raster(places[1], "a map"):
        pass
    with pytest.raises(BlockingIOError):
        network.accept()


def test_an_erdas_file_keeps_its_values_beside_it_only(tmp_path, image):
    path, outside = tmp_path / "here" / "image.img", tmp_path / "values"
    path.parent.mkdir()
    how = {"driver": "HFA", "dtype": "float32", "count": 1, "width": 20, "height": 30,
           "transform": Affine(1, 0, 0, 0, -1, 30)}  # fmt: skip
    with rasterio.open(path, "w", USE_SPILL="YES", **how) as file:
        file.write(image[:1])
    with open_raster(path, "a map") as raster:
        np.testing.assert_array_equal(raster.read().values[:, ::-1], image[:1])
    path.with_suffix(".ige").rename(outside)
    path.write_bytes(path.read_bytes().replace(b"image.ige", b"../values"))
    with rasterio.open(path) as file:  # GDAL follows it
        np.testing.assert_array_equal(file.read(1), image[0])
    with pytest.raises(InputError, match=REFUSED), open_raster(path, "a map"):
        pass


@unix
def test_links_beside_a_raster_lead_to_no_other_folder(tmp_path, image):
    here, there = tmp_path / "here", tmp_path / "there"
    for folder in (here, there):
        folder.mkdir()
        write(folder / "image.tif", image)
        np.full((1, 30, 20), 0.2, np.float32).tofile(folder / "cube.dat")
        (folder / "cube.hdr").write_text(
            "ENVI\nsamples = 20\nlines = 30\nbands = 1\ndata type = 4\ninterleave = bsq\n"
        )
    shutil.copy(there / "image.tif", there / "image.tif.msk")
    (there / "image.tif.aux.xml").write_text("<PAMDataset></PAMDataset>")
    for name in ("image.tif.msk", "image.tif.ovr", "image.tif.aux.xml"):
        (here / name).symlink_to(there / name.replace("ovr", "msk"))
        with (
            pytest.raises(InputError, match=REFUSED) as caught,
            open_raster(here / "image.tif", "a map"),
        ):
            pass
        assert name.endswith(".xml") or name in str(caught.value)  # it was not opened
        (here / name).unlink()
    (here / "cube.dat").unlink()
    (here / "cube.dat").symlink_to(there / "cube.dat")
    with pytest.raises(InputError, match="in one folder"), open_raster(here / "cube.hdr", "a map"):
        pass
    for name in ("mine.hdr", "mine.dat", "mine.tif"):  # that the user made of a whole raster
        (here / name).symlink_to(
            there / name.replace("mine", "cube" if name[-1] != "f" else "image")
        )
    for name in ("mine.hdr", "mine.tif"):
        with open_raster(here / name, "a map") as file:
            assert file.shape == (30, 20)


def test_a_raster_of_any_kind_holds_what_it_states(tmp_path):
    path = tmp_path / "map.asc"
    path.write_text("ncols 20000\nnrows 20000\nxllcorner 0\nyllcorner 0\ncellsize 1\n1 2 3\n")
    refused = pytest.raises(InputError, match=r"20000 x 20000 pixels.*cannot hold them")
    with refused, open_raster(path, "a map") as raster:
        raster.read()


def test_a_file_of_a_name_like_an_address_is_read_as_a_file(tmp_path, image, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name in ("http:/127.0.0.1:9/image.tif", "GTIFF_DIR:1:secret.tif", 'NETCDF:"image.tif"'):
        Path(name).parent.mkdir(parents=True, exist_ok=True)
        write(tmp_path / "secret.tif", 2 * image)
        write(tmp_path / name, image)
        with open_raster(name, "a map") as file:
            np.testing.assert_array_equal(file.dataset.read(1)[::-1], image[0])


def test_overviews_and_masks_beside_a_raster_are_used(tmp_path, image):
    path = tmp_path / "image.tif"
    write(path, image)
    with rasterio.Env(TIFF_USE_OVR=True), rasterio.open(path, "r+") as file:
        file.build_overviews([2])
    there = np.zeros(image.shape[1:], np.uint8)
    there[:5] = 255
    with rasterio.Env(GDAL_TIFF_INTERNAL_MASK=False), rasterio.open(path, "r+") as file:
        file.write_mask(there)
    assert {p.name for p in tmp_path.iterdir()} >= {"image.tif.ovr", "image.tif.msk"}
    with open_raster(path, "a map") as file:
        assert file.dataset.overviews(1) == [2]
        np.testing.assert_array_equal(file.read().mask[::-1], there > 0)


def test_the_first_raster_of_a_process_is_read(tmp_path, image):
    write(tmp_path / "image.tif", image)
    code = (
        "import sys; from fynjax.app.io.raster import open_raster\n"
        "with open_raster(sys.argv[1], 'an image') as raster: print(raster.shape)"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, tmp_path / "image.tif"], capture_output=True, text=True
    )
    assert done.stdout == "(30, 20)\n", done.stderr


def test_words_of_gdal_that_are_no_text_print_nothing(tmp_path, monkeypatch):
    path = tmp_path / "image.tif"
    place = Affine(1.0, 0.0, 4e5, 0.0, -1.0, 6e6)
    write_raster(path, np.ones((1, 4, 4), np.float32), transform=place, crs="EPSG:32734")
    with rasterio.open(path, "r+") as file:
        file.update_tags(area="plot")
    content = path.read_bytes()
    assert content.count(b"<GDALMetadata>") == 1
    path.write_bytes(content.replace(b"<GDALMetadata>", b"<GDAL\xc2etadata>"))
    said = []
    monkeypatch.setattr(sys, "unraisablehook", said.append)
    with suppress(InputError), open_raster(path, "an image"):
        pass
    assert not said


def test_a_mark_of_missing_data_that_the_data_cannot_hold_is_passed_over(tmp_path):
    np.full((1, 4, 4), 0.2, np.float32).tofile(tmp_path / "cube.dat")
    (tmp_path / "cube.hdr").write_text(
        "ENVI\nsamples = 4\nlines = 4\nbands = 1\ndata type = 4\ninterleave = bsq\n"
        "byte order = 0\nheader offset = 0\ndata ignore value = 1e266\n"
    )
    with open_raster(tmp_path / "cube.hdr", "an image") as file:
        assert file.read([1]).values.min() == np.float32(0.2)

"""Damaged files end in one error that names the file; nothing else comes up from the depths."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
from rasterio import Affine

from fynjax._core.errors import InputError
from fynjax.compare import read_drone_image, read_spectra_sample
from fynjax.io.instruments import load_lidar, load_sensor
from fynjax.io.micasense import read_capture
from fynjax.io.raster import read_band_stack, read_cube, read_probability_map
from fynjax.io.spectra import read_spectra
from fynjax.terrain import read_terrain


def drone_image(path: Path) -> Any:
    return read_drone_image(path)


def map_of_a_plot(path: Path) -> Any:
    return read_probability_map(path, (10.0, 10.0))


@pytest.mark.parametrize(
    ("name", "read"),
    [
        ("image-914-image.tif", drone_image),
        ("image-914-image.tif", lambda path: read_band_stack([path])),
        ("image-914-image.tif", read_cube),
        ("cubehdr-5-reflectance.hdr", read_cube),
        ("cubehdr-5-reflectance.hdr", lambda p: read_spectra_sample([p])),
        ("cubenc-2-product.nc", read_cube),
        ("rededge-18-IMG_0001_1.tif", lambda path: read_capture("IMG_0001", [path])),
        ("prob-631-prob.tif", map_of_a_plot),
        ("prob-631-prob.tif", read_terrain),
        ("envilib-254-lib.hdr", read_spectra),
        ("envilib-1169-lib.hdr", read_spectra),
        ("spectxt-18-ribb00001.asd.txt", read_spectra),
        ("lidar-63-scanning_lidar.toml", load_lidar),
        ("lidar-1304-flash_lidar_paper.toml", load_lidar),
        ("sensor-118-aviris_ng.toml", load_sensor),
        ("sensor-619-sentinel_2a.toml", load_sensor),
    ],
)
def test_a_damaged_file_is_named(shared_data: Path, name: str, read: Callable[[Path], Any]) -> None:
    with pytest.raises(InputError) as caught:
        read(shared_data / "damaged" / name)
    assert name in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_library_whose_header_took_44_seconds_is_read(shared_data: Path) -> None:
    spectra = read_spectra(shared_data / "damaged" / "envilib-214-lib.hdr")
    assert [spectrum.name for spectrum in spectra] == ["a", "b", "c"]


@pytest.mark.parametrize(("number", "missing"), [(96, 51), (897, 61)])
def test_numbers_that_no_instrument_gives_are_missing(shared_data, number, missing):
    """Infinite, or up to 1e286, also in the water bands, where noise may be of any size."""
    (spectrum,) = read_spectra(shared_data / "damaged" / f"asd-{number}-ribb00001.asd")
    values = spectrum.reflectance
    assert np.isnan(values).sum() == missing
    assert np.nanmax(np.abs(values)) < 1e4
    assert f"{missing} impossible values of reflectance set to missing" in spectrum.meta["repairs"]


@pytest.mark.parametrize(
    "read", [drone_image, lambda path: read_band_stack([path]), read_cube, read_terrain]
)
def test_an_image_of_more_pixels_than_its_file_can_hold(
    tmp_path: Path, read: Callable[[Path], Any]
) -> None:
    path = tmp_path / "sparse.tif"
    rasterio.open(
        path, "w", driver="GTiff", width=60_000, height=60_000, dtype="uint16",
        count=1 if read is read_terrain else 4, crs="EPSG:32734", sparse_ok=True, tiled=True,
        blockxsize=1024, blockysize=1024, transform=Affine(0.1, 0, 0, 0, -0.1, 0), bigtiff="yes",
    ).close()  # fmt: skip
    with pytest.raises(InputError, match="60000 x 60000 pixels"):
        read(path)

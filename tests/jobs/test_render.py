"""`fynjax render`: what it writes, and that one process compiles its programs once."""

import re

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import rasterio
import xarray as xr

from fynjax._core.errors import InputError
from fynjax.app.assembly import build_plot
from fynjax.app.io.plot import read_plot
from fynjax.app.jobs import render_plot, simulate
from fynjax.scene import TiledPicture
from tests.helpers import compilations
from tests.jobs import test_simulate


@pytest.mark.parametrize("job", [render_plot, simulate])
def test_another_seed_compiles_nothing(job, tmp_path):
    jax.clear_caches()  # other tests compile the same programs
    plot, images, programs = test_simulate.write_plot(tmp_path), [], []
    for number in range(2):
        out = tmp_path / f"out_{number}"
        out.mkdir()
        with compilations() as compiled:
            job(plot, out, seed=number)
        programs.append(compiled)
        name = "image.tif" if job is render_plot else "reflectance.tif"
        with rasterio.open(out / name) as file:
            images.append(file.read(1))
    assert programs[0]
    assert programs[1] == []
    assert not np.array_equal(*images)


def test_an_interrupted_large_image_goes_on(tmp_path, monkeypatch):
    """Tiles that the checkpoint keeps are not made again; it is of one plot and seed."""
    plot, made = test_simulate.write_plot(tmp_path), []

    class Picture(TiledPicture):
        tiles = ((0, 0), (0, 1))

        def __init__(self, camera, scene, parameters):
            self.half = np.full((len(camera.sensor.bands), *camera.shape), 0.1)

        def render(self, tile):
            made.append(tile)
            return self.half

        def image(self, rendered):
            return jnp.asarray(sum(rendered))

    monkeypatch.setattr("fynjax.app.jobs._render.is_large", lambda *_: True)
    monkeypatch.setattr("fynjax.app.jobs._render.TiledPicture", Picture)
    for _ in range(2):
        result = render_plot(plot, tmp_path / "out", checkpoint=tmp_path / "kept")
        assert result.statistics[0].before == pytest.approx(0.2)
    assert made == [(0, 0), (0, 1)]
    with pytest.raises(InputError, match="of another run"):
        render_plot(plot, tmp_path / "out", seed=1, checkpoint=tmp_path / "kept")


def test_the_page_of_a_render_counts_whole_plants(tmp_path):
    """As many as stand on the image, the whole number below or above what the cover asks for."""
    plot = test_simulate.write_plot(tmp_path)
    render_plot(plot, tmp_path / "out")
    with xr.open_dataset(tmp_path / "out" / "run.nc") as run:
        count = run["plants"].item()
    scene, parameters = build_plot(read_plot(plot))
    assert count in (np.floor(asked := float(scene.counts(parameters)[0])), np.ceil(asked))
    page = (tmp_path / "out" / "report.html").read_text("utf-8")
    shown = re.search(r"Erica irregularis</td><td>([^<]*)<", page)
    assert shown is not None
    assert shown[1] == str(int(count))


def test_the_truth_of_the_pixels_is_written_beside_the_image(tmp_path, monkeypatch):
    plot = test_simulate.write_plot(tmp_path)
    render_plot(plot, tmp_path / "out", truth=True)
    with xr.open_dataset(tmp_path / "out" / "truth.nc") as seen:
        organs = sum(seen[name] for name in ("live", "dead", "wood", "flowers")).sum("species")
        np.testing.assert_allclose(organs + seen.sunlit_ground + seen.shaded_ground, 1, atol=1e-5)
        first = str(seen.species[0].item())
        expected, shade = np.flipud(seen["live"][0]), seen.shaded_ground.values
    with rasterio.open(tmp_path / "out" / "truth.tif") as file:
        assert file.descriptions[0] == f"live: {first}"
        assert file.descriptions[-2:] == ("ground in the sun", "ground in shade")
        np.testing.assert_allclose(file.read(1), expected, atol=1e-6)
    with rasterio.open(tmp_path / "out" / "image.tif") as image:
        assert image.shape == file.shape
        assert image.transform == file.transform
    monkeypatch.setattr("fynjax.app.jobs._render.is_large", lambda *_: True)
    render_plot(plot, tmp_path / "again", truth=True)  # in tiles
    with xr.open_dataset(tmp_path / "again" / "truth.nc") as tiles:
        np.testing.assert_allclose(tiles["live"][0], np.flipud(expected), atol=1e-5)
        np.testing.assert_allclose(tiles.shaded_ground, shade, atol=1e-5)
    simulate(plot, tmp_path / "measured", truth=True)
    with rasterio.open(tmp_path / "measured" / "truth.tif") as measured:
        np.testing.assert_allclose(measured.read(1), expected, atol=1e-5)
    assert (tmp_path / "measured" / "species.png").is_file()

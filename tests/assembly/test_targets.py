"""Files of any sensor as targets of a calibration: what they are, and what is taken of them."""

import jax.numpy as jnp
import numpy as np
import pytest

from fynjax._core.errors import InputError
from fynjax.app.assembly import build_plot
from fynjax.app.assembly._targets import (
    read_targets,
    reflectance_noise,
    structure_settings,
    target_kind,
)
from fynjax.app.io.plot import read_plot
from fynjax.app.io.plot._rows import StructureRow, read_structure
from fynjax.app.io.raster import Cube, write_cube_geotiff
from fynjax.inversion import SpectrumView, StructureView
from fynjax.metrics.structure import STRUCTURE_METRICS
from fynjax.sensors import BandSet, RadiometricNoise, at_sensor_radiance, shipped_sensor
from fynjax.sensors.air import ClearAir, band_atmosphere, clear_sky_atmosphere
from tests.small import write_plot

WAVELENGTH = np.arange(380.0, 2501.0, 5.0)


@pytest.fixture(scope="module")
def plot(tmp_path_factory):
    return read_plot(write_plot(tmp_path_factory.mktemp("targets")))


def curve(wavelength):
    """A reflectance that is linear, so that any symmetric band has the value at its centre."""
    return 0.05 + 1e-4 * (wavelength - 380.0)


def spectrum_file(path, wavelength=WAVELENGTH):
    rows = [f"{w:g},{curve(w):.8f}" for w in wavelength]
    path.write_text("wavelength_nm,leafy\n" + "\n".join(rows) + "\n")
    return path


def cube_file(path, bands=12):
    centre = np.linspace(500.0, 900.0, bands)
    values = np.random.default_rng(1).normal(0.3, 0.02, (bands, 4, 5))
    cube = Cube(
        values, tuple(f"b{i}" for i in range(bands)), centre, np.full(bands, 30.0),
        np.ones(bands, bool), 1.0, (0.0, 0.0),
    )  # fmt: skip
    write_cube_geotiff(path, cube, {})
    return path, values


def structure_file(path, rows=("gap_fraction,0.3,0.05,1,80", "rugosity,0.2,,1,80")):
    path.write_text("\n".join(["metric,value,sd,grain_m,returns_m2", *rows]) + "\n")
    return path


def test_a_file_is_known_by_what_is_in_it(tmp_path):
    table = tmp_path / "a.csv"
    for text, kind in (
        ("statistic,value\nnir.mean,0.3\n", "image"),
        ("statisticks,value\nnir.mean,0.3\n", "image"),  # whose reader says what is wrong
        ("# a remark\nmetric,value\nrugosity,0.3\n", "structure"),
        ("Wavelength;one\n400;0.1\n", "spectrum"),
        ("name,400,410,420\none,0.1,0.1,0.1\n", "spectrum"),
    ):
        table.write_text(text)
        assert target_kind(table) == kind
    for name, kind in (("a.las", "structure"), ("a.LAZ", "structure"), ("a.asd", "spectrum")):
        assert target_kind(tmp_path / name) == kind
    for bands, kind in ((4, "image"), (12, "spectrum")):
        assert target_kind(cube_file(tmp_path / f"{bands}.tif", bands)[0]) == kind
    (tmp_path / "cube").write_bytes(b"")
    assert target_kind(tmp_path / "cube") == "spectrum"


def test_a_spectrum_is_compared_in_some_bands_outside_the_water_windows(plot, tmp_path):
    one = read_targets(plot, [spectrum_file(tmp_path / "s.csv")])
    assert one.source.kind == "spectrum"
    view = one.source.view(*build_plot(plot))
    assert isinstance(view, SpectrumView)
    assert view.names == one.names
    centre = np.array(one.source.bands.centre)
    assert 25 <= centre.size <= 30
    assert not ((centre >= 1340) & (centre <= 1460)).any()
    assert not ((centre >= 1790) & (centre <= 2100)).any()
    assert centre.min() < 450
    assert centre.max() > 2400
    np.testing.assert_allclose(one.value, curve(centre), atol=2e-6)
    covariance = np.linalg.inv(np.asarray(one.whitener.T @ one.whitener))
    value = curve(centre)
    noise = reflectance_noise(one.source.bands, value, plot.sun.zenith)
    share = plot.calibration.target_sd
    extra = np.diagonal(covariance) - 0.003**2 - (share * value) ** 2
    np.testing.assert_allclose(extra, noise**2, rtol=1e-6)
    assert np.all((noise > 1e-5) & (noise < 0.02))
    assert covariance[0, 1] == pytest.approx(0.003**2)


def test_a_finer_spectrum_is_averaged_to_bands(plot, tmp_path):
    grid = np.arange(350.0, 2501.0)
    path = spectrum_file(tmp_path / "asd.csv", grid)
    text = path.read_text().splitlines()
    # A sawtooth from one nanometre to the next, which is noise.
    rough = [f"{w:g},{curve(w) + 0.02 * (-1) ** i:.8f}" for i, w in enumerate(grid)]
    path.write_text("\n".join([text[0], *rough]) + "\n")
    one = read_targets(plot, [path])
    off = np.asarray(one.value) - curve(np.array(one.source.bands.centre))
    assert np.abs(off).max() < 0.003


def test_of_a_cube_the_mean_counts_and_its_error_is_that_of_its_pixels(plot, tmp_path):
    path, values = cube_file(tmp_path / "cube.tif")
    one = read_targets(plot, [path])
    pixels = values.reshape(12, -1)
    np.testing.assert_allclose(one.value, pixels.mean(axis=1), rtol=1e-6)
    assert one.source.extra["spectra"] == 20
    covariance = np.linalg.inv(np.asarray(one.whitener.T @ one.whitener))
    shared = covariance[0, 1] - 0.003**2
    assert shared == pytest.approx(np.cov(pixels)[0, 1] / 20, rel=1e-4, abs=1e-12)


def test_a_table_of_structure(plot, tmp_path):
    one = read_targets(plot, [structure_file(tmp_path / "t.csv")])
    view = one.source.view(*build_plot(plot))
    assert isinstance(view, StructureView)
    assert one.names == ("lidar.gap_fraction", "lidar.rugosity")
    assert (view.grain, view.pulses) == (1.0, 80.0)
    np.testing.assert_allclose(one.sd, [np.hypot(0.05, 0.015), 0.01])
    assert set(StructureRow.model_fields["metric"].annotation.__args__) == set(STRUCTURE_METRICS)
    for rows, message in (
        (("gap_fraction,0.3,0.05,3,80",), "expected a grain of 1, 2 m"),
        (("gap_fraction,0.3,,1,80", "gap_fraction,0.4,,1,80"), "row 3.*twice"),
        (("gap_fraction,0.3,,1,80", "rugosity,0.2,,2,80"), "column 'grain_m': expected the same"),
        (("gap,0.3,,1,80",), "row 2, column 'metric'"),
    ):
        with pytest.raises(InputError, match=message):
            read_targets(plot, [structure_file(tmp_path / "t.csv", rows)])


def test_a_cloud_has_the_structure_of_its_cells(plot, tmp_path):
    """Half of the plot bare, half 0.6 m high: what the metrics must be is known."""
    random = np.random.default_rng(2)
    x, y = random.uniform(0.0, 2.0, (2, 4000))
    height = np.where(x < 1.0, 0.0, 0.6 * random.uniform(size=x.size))
    path = tmp_path / "c.xyz"
    path.write_text("\n".join(f"{a:.3f} {b:.3f} {c:.3f}" for a, b, c in zip(x, y, height)) + "\n")
    one = read_targets(plot, [path])
    value = dict(zip(one.names, np.asarray(one.value)))
    assert one.source.kind == "structure"
    view = one.source.view(*build_plot(plot))
    assert view.grain == 1.0
    assert view.pulses == pytest.approx(1000.0, rel=0.02)
    sd = dict(zip(one.names, np.asarray(one.sd)))
    # Two cells are all gap, two have a sixth of their returns below 0.1 m.
    gap = value["lidar.gap_fraction"]
    assert gap == pytest.approx(0.5 * (1.0 + 1.0 / 6.0), abs=0.08)
    # Means of four such cells, drawn again, reach from 1/6 to 1 in 95 of 100 draws.
    of_cells = (1.0 - 1.0 / 6.0) / (2.0 * 1.96)
    assert sd["lidar.gap_fraction"] == pytest.approx(np.hypot(of_cells, 0.05 * gap), rel=0.1)


def test_an_image_s_errors_are_those_of_how_it_was_calibrated(plot, tmp_path):
    (tmp_path / "image.csv").write_text("statistic,value,sd\nred.mean,0.05,0.001\n")
    panels = plot.replace(sensor=plot.sensor.replace(calibrated_by="panels"))
    for of, way in ((plot, "light_sensor"), (panels, "panels")):
        one = read_targets(of, [tmp_path / "image.csv"])
        view = one.source.view(*build_plot(of))
        np.testing.assert_allclose(
            view.gains.covariance(4), shipped_sensor("mavic_3m").gains(way).covariance(4)
        )


def test_one_target_of_each_kind_in_the_same_order(plot, tmp_path):
    table = tmp_path / "s.csv"
    table.write_text("statistic,value,sd\nnir.mean,0.3,\n")
    cloud = structure_file(tmp_path / "c.csv")
    found = read_targets(plot, [cloud, table])
    assert [one.source.kind for one in found.parts] == ["image", "structure"]
    with pytest.raises(InputError, match="one target of each kind"):
        read_targets(plot, [cloud, table, structure_file(tmp_path / "d.csv")])
    with pytest.raises(InputError, match=r"no such file. Did you mean 'c.csv'"):
        read_targets(plot, [tmp_path / "cc.csv"])
    fewer = plot.calibration.replace(targets=("*.mean",))
    with pytest.raises(InputError, match="fits none of the metrics of the cloud"):
        read_targets(plot.replace(calibration=fewer), [cloud])


def test_cells_are_whole_voxels(plot):
    for voxel, size in ((0.1, 2.0), (0.25, 10.0), (0.2, 10.0)):
        sized = plot.replace(voxel_m=voxel, size_m=(size, size))
        settings, grains = structure_settings(sized)
        for grain in grains:
            across = grain / max(1, round(grain / settings.canopy_cell)) / voxel
            assert across == pytest.approx(round(across))
            assert grain <= size
    with pytest.raises(InputError, match="has no cells of whole voxels"):
        structure_settings(plot.replace(size_m=(0.8, 0.8)))


def test_noise_falls_with_the_number_of_pixels():
    bands = BandSet(("a", "b"), (550.0, 2200.0), (6.0, 6.0))
    one, many = (reflectance_noise(bands, np.array([0.1, 0.2]), 30.0, averaged=n) for n in (1, 25))
    np.testing.assert_allclose(many, one / 5.0)


def test_noise_of_a_pixel_leaves_its_surroundings_as_they_are():
    """The step in reflectance that moves the pixel's radiance by its noise, the rest held."""
    bands = BandSet(("a", "b"), (450.0, 2200.0), (6.0, 6.0))
    value = jnp.array([0.3, 0.2])
    noise = reflectance_noise(bands, np.asarray(value), 50.0)
    air = band_atmosphere(clear_sky_atmosphere(ClearAir(jnp.asarray(50.0))), bands)
    moved = at_sensor_radiance(air, value + noise, value) - at_sensor_radiance(air, value)
    sensor = shipped_sensor("aviris_ng")
    nearest = [np.abs(np.subtract(sensor.bands.centre, centre)).argmin() for centre in bands.centre]
    a, b, c = (getattr(sensor.noise, name)[np.array(nearest)] for name in "abc")
    instrument = RadiometricNoise(a, b, c, integrations=sensor.noise.integrations)
    deviation = instrument.standard_deviation(at_sensor_radiance(air, value))
    np.testing.assert_allclose(moved, deviation, rtol=1e-6)


def test_read_structure_fills_in(tmp_path):
    path = tmp_path / "t.csv"
    path.write_text("metric,value\nrugosity,0.2\n")
    (read,) = read_structure(path)
    assert (read.grain_m, read.returns_m2, read.sd) == (2.0, 100.0, None)

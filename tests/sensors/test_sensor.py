"""Sensors as a whole: responses, geometry, rays and point spread."""

import itertools
import json
import warnings
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import quad
from scipy.ndimage import gaussian_filter

from fynjax._core.errors import InputError
from fynjax.sensors import BandSet, PointSpread, Sensor, mavic_3m, shipped_sensor, shipped_sensors
from fynjax.sensors._bands import band_set_of_curves
from fynjax.sensors._reference import sensor_reference
from tests.helpers import assert_gradients

COARSE = np.arange(400.0, 2520.0, 10.0)  # wider than an AVIRIS-NG channel


def sensor(name: str) -> Sensor:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the paper's pixel; its warning has a test of its own
        return shipped_sensor(name)


@pytest.mark.parametrize("name", shipped_sensors())
def test_every_shipped_sensor_returns_lines_and_constants(name: str) -> None:
    """A linear spectrum comes back at the response's mean wavelength, however narrow the band."""
    assert name in set(sensor_reference().name)
    bands = sensor(name).bands
    grid = np.arange(350.0, 2560.0, 10.0)
    weights = np.asarray(bands.weights(grid))
    np.testing.assert_allclose(weights.sum(axis=1), 1.0, rtol=1e-12)
    np.testing.assert_allclose(weights @ (0.2 + grid / 5000), 0.2 + np.array(bands.centre) / 5000)
    assert min(bands.fwhm) > 0.0


def test_box_over_a_parabola() -> None:
    grid, width = np.arange(600.0, 700.0, 0.05), 24.0
    row = BandSet(("red",), (650.0,), (width,), "box").weights(grid)[0]
    assert row @ (grid - 650.0) ** 2 == pytest.approx(width**2 / 12.0, rel=1e-4)


def test_shipped_curve_equals_quadrature() -> None:
    """The narrowest Sentinel-2 band on a coarse spectrum: both are piecewise linear."""
    bands = sensor("sentinel_2a").bands
    index = bands.names.index("B6")
    assert bands.curves is not None
    u, r = (np.array(v) for v in bands.curves[index])
    values = np.random.default_rng(5).uniform(size=COARSE.size)

    def integral(function) -> float:
        inside = COARSE.searchsorted(u[0]), COARSE.searchsorted(u[-1])
        knots = np.unique(np.concatenate([u, COARSE[slice(*inside)]]))
        return sum(quad(function, a, b)[0] for a, b in itertools.pairwise(knots))

    top = integral(lambda x: np.interp(x, u, r) * np.interp(x, COARSE, values))
    bottom = integral(lambda x: np.interp(x, u, r))
    assert bands.weights(COARSE)[index] @ values == pytest.approx(top / bottom, rel=1e-10)


def test_centres_and_widths_of_published_curves() -> None:
    # ESA, COPE-GSEG-EOPG-TN-15-0007 v3.0, and Barsi et al. (2014), Remote Sensing 6, table 1.
    for name, centres in (
        ("sentinel_2a", [442.7, 492.4, 559.8, 664.6, 704.1, 740.5, 782.8, 832.8, 864.7, 945.1]),
        ("sentinel_2b", [442.2, 492.1, 559.0, 664.9, 703.8, 739.1, 779.7, 832.9, 864.0, 943.2]),
    ):
        bands = sensor(name).bands
        np.testing.assert_allclose(bands.centre[:10], centres, atol=0.11)
    oli = sensor("landsat_8").bands
    assert oli.names == tuple(f"B{n}" for n in range(1, 10))
    widths = [15.98, 60.04, 57.33, 37.47, 28.25, 84.72, 186.66, 172.4, 20.39]
    np.testing.assert_allclose(oli.fwhm, widths, rtol=0.005)


def test_width_of_a_curve_by_hand() -> None:
    triangle = band_set_of_curves({"t": ([600.0, 620.0, 680.0], [0.0, 2.0, 0.0])})
    assert triangle.centre[0] == pytest.approx((600 + 620 + 680) / 3)
    assert triangle.fwhm[0] == pytest.approx(40.0)
    box = band_set_of_curves({"b": ([600.0, 640.0], [1.0, 1.0])})
    assert (box.centre[0], box.fwhm[0]) == pytest.approx((620.0, 40.0))


def test_aviris_ng_has_its_real_channels(shared_data: Path) -> None:
    table = np.loadtxt(shared_data / "eco" / "avirisng" / "wavelength_fit.txt")
    for name in ("aviris_ng", "aviris_ng_paper"):
        bands = sensor(name).bands
        assert len(bands) == 425
        np.testing.assert_allclose(bands.centre, 1000.0 * table[:, 1], atol=1e-6)
        np.testing.assert_allclose(bands.fwhm, 1000.0 * table[:, 2], atol=1e-6)
    assert (min(bands.fwhm), max(bands.fwhm)) == (5.57, 6.03)


def test_response_curves_of_another_source(shared_data: Path) -> None:
    """EnMAP's Gaussians, Sentinel-2 and Landsat against the curves of EnMAP-Box, on a lawn.

    Those have three decimals (EnMAP, Landsat) and end at about half a per cent of the peak.
    """
    lawn = np.loadtxt(shared_data / "eco" / "avirisng" / "insitu_BeckmanLawn.txt")
    wavelength, reflectance = lawn[:, 0], lawn[:, 1]
    folder = shared_data / "eco" / "srf"
    for name, file, key, tolerance in (
        ("enmap", "enmap_potsdam_srf", "profiles", 8e-5),
        ("sentinel_2a", "sentinel2a_msi", "response", 5e-6),
        ("sentinel_2b", "sentinel2b_msi", "response", 1e-7),
        ("landsat_8", "landsat_oli", "response", 1e-5),
    ):
        features = json.loads((folder / f"{file}.geojson").read_text())["features"]
        curves = [feature["properties"][key] for feature in features]
        curves = {
            str(i): (np.array(c["x"], float), np.clip(np.array(c["y"], float), 0, None))
            for i, c in enumerate(curves)
        }
        expected = band_set_of_curves(curves).weights(wavelength, max_loss=2.0) @ reflectance
        bands = sensor(name).bands
        got = bands.weights(wavelength) @ reflectance
        if name == "landsat_8":  # six of the nine bands
            got = got[[bands.names.index(f"B{n}") for n in (2, 3, 4, 5, 6, 7)]]
        np.testing.assert_allclose(got, expected, atol=tolerance)


def test_spectra_to_bands_is_differentiable_and_linear() -> None:
    bands, blur = mavic_3m(), PointSpread("gaussian", 1.3).blur
    grid = np.arange(400.0, 1001.0, 25.0)
    spectra = jnp.asarray(np.random.default_rng(0).uniform(size=(3, 4, grid.size)))

    def image(spectra):
        return blur(jnp.moveaxis(bands.average(grid, spectra, max_loss=0.01), -1, -3))

    assert_gradients(jax.jit(lambda x: image(spectra.at[..., 12].set(x))), spectra[..., 12])
    one = image(spectra)
    assert one.shape == (4, 3, 4)
    batch = jax.jit(image)(jnp.stack([spectra] * 2))
    np.testing.assert_allclose(batch, jnp.stack([one, one]), rtol=1e-12)
    single = image(spectra.astype(jnp.float32))
    assert single.dtype == jnp.float32
    np.testing.assert_allclose(single, one, rtol=1e-5)
    with pytest.raises(InputError, match="outside the spectrum"):
        sensor("aviris_ng").bands.average(grid, spectra)


def test_pixels_of_the_paper() -> None:
    assert float(sensor("mavic_3m_paper").ground_sample_distance()) == pytest.approx(0.025)
    maker = sensor("mavic_3m")
    assert float(maker.ground_sample_distance()) == pytest.approx(0.0230415, abs=1e-7)
    assert float(maker.ground_sample_distance(100.0)) == pytest.approx(0.046083, abs=1e-6)
    with pytest.warns(UserWarning, match=r"aviris_ng_paper: .* 3 m .* 1\.015 m"):
        spectrometer = shipped_sensor("aviris_ng_paper")
    assert float(spectrometer.ground_sample_distance()) == pytest.approx(1.01504, abs=1e-5)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert shipped_sensor("aviris_ng").camera.line.shape == (1, 640)
        shipped_sensor("mavic_3m_paper")
    # 266.667 pixels per mm.
    assert float(sensor("rededge_3").ground_sample_distance(120.0)) == pytest.approx(
        120.0 / 5.5 / 266.667, rel=1e-5
    )
    assert sensor("sentinel_2a").band_pixel == (60, 10, 10, 10, 20, 20, 20, 10, 20, 60, 60, 20, 20)


def test_gaussian_blur_is_gaussian() -> None:
    """Variance and additivity are exact; a smooth image blurs as the continuum says."""
    for width in (0.3, 1.0, 4.0):
        kernel = np.asarray(PointSpread("gaussian", width).kernel("x"))
        place = np.arange(kernel.size) - kernel.size // 2
        assert kernel.sum() == pytest.approx(1.0, rel=1e-14)
        variance = (width / np.sqrt(8.0 * np.log(2.0))) ** 2
        assert kernel @ place**2 == pytest.approx(variance, rel=1e-6)
        assert kernel @ place == pytest.approx(0.0, abs=1e-14)
    wave = np.cos(2 * np.pi * np.arange(40) / 20.0)
    image = jnp.asarray(np.outer(np.ones(8), wave))
    blurred = PointSpread("gaussian", 4.0).blur(image, boundary="periodic")
    sigma = 4.0 / np.sqrt(8.0 * np.log(2.0))
    damped = np.exp(-0.5 * (2 * np.pi * sigma / 20.0) ** 2)
    np.testing.assert_allclose(blurred[3], damped * wave, atol=0.002)
    noise = np.random.default_rng(1).uniform(size=(12, 15))
    twice = PointSpread("gaussian", 3.0).blur(PointSpread("gaussian", 4.0).blur(noise))
    assert twice.shape == (12, 15)
    once = PointSpread("gaussian", 5.0).blur(noise)
    np.testing.assert_allclose(twice[5:7, 6:9], once[5:7, 6:9], atol=1e-3)
    wide = PointSpread("gaussian", 9.0).blur(noise)
    other = gaussian_filter(noise, 9.0 / np.sqrt(8.0 * np.log(2.0)), mode="nearest", truncate=6)
    np.testing.assert_allclose(wide, other, atol=0.002)


def test_a_blur_keeps_its_width_on_the_ground() -> None:
    """Pixels of four of an image that was blurred finely have the variance of blurred pixels of
    four; of a box what goes beyond a pixel is kept."""
    psf = PointSpread("gaussian", 3.0)
    line = np.zeros((1, 400))
    line[:, 202] = 1.0
    place = np.arange(400) - 202.0
    fine = np.asarray(psf.blur(line))[0] @ place**2
    wide = np.asarray(psf.on_pixels(4.0).blur(line[:, ::4] + line[:, 2::4]))[0]
    assert 4.0**2 * (wide @ (np.arange(100) - 50.0) ** 2) == pytest.approx(fine, rel=1e-5)
    box = PointSpread("box", (4.0, 1.0))
    np.testing.assert_allclose(box.on_pixels(4.0).width, [1.75, 1.0])
    np.testing.assert_allclose(box.on_pixels(0.5).width, [7.0, 1.0])


def test_blur_axes_edges_and_box() -> None:
    spike = jnp.zeros((9, 11)).at[4, 5].set(1.0)
    across = PointSpread("box", (3.0, 1.0)).blur(spike)
    np.testing.assert_allclose(across[4, 3:8], [0, 1 / 3, 1 / 3, 1 / 3, 0], atol=1e-15)
    np.testing.assert_allclose(across.sum(axis=1), spike.sum(axis=1), atol=1e-15)
    half = PointSpread("box", (1.0, 2.0)).blur(spike)
    np.testing.assert_allclose(half[2:7, 5], [0, 0.25, 0.5, 0.25, 0], atol=1e-15)
    sharp = PointSpread("gaussian", 0.0).blur(spike)
    np.testing.assert_allclose(sharp, spike, atol=1e-15)
    flat = jnp.full((2, 4, 5), 0.3)
    for boundary in ("edge", "periodic"):
        np.testing.assert_allclose(PointSpread("gaussian", 2.0).blur(flat, boundary=boundary), 0.3)
    corner = jnp.zeros((6, 6)).at[0, 0].set(1.0)
    periodic = PointSpread("gaussian", 2.0).blur(corner, boundary="periodic")
    assert float(periodic.sum()) == pytest.approx(1.0)
    assert float(periodic[-1, 0]) == pytest.approx(float(periodic[1, 0]))


def test_blur_has_gradients_in_image_and_width() -> None:
    image = jnp.asarray(np.random.default_rng(2).uniform(size=(2, 3)))
    for kind, width in (("gaussian", [1.4, 0.8]), ("box", [2.4, 1.7])):
        blur = jax.jit(lambda p, kind=kind: PointSpread(kind, p["width"], 3).blur(p["image"]))
        assert_gradients(blur, {"image": image, "width": jnp.array(width)})
    slope = jax.grad(lambda w: PointSpread("gaussian", w, radius=3).blur(image).sum())(jnp.zeros(2))
    np.testing.assert_allclose(slope, 0.0, atol=1e-12)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("gaussian", -1.0), "from 0"),
        (("box", 0.5), "from 1"),
        pytest.param(("disc", 1.0), "'gaussian' or 'box'", marks=pytest.mark.untyped),
        (("gaussian", float("nan")), "from 0"),
    ],
)
def test_bad_point_spreads(arguments: tuple, message: str) -> None:
    with pytest.raises(InputError, match=message):
        PointSpread(*arguments)


def test_unknown_sensor_and_band_pixels() -> None:
    with pytest.raises(InputError, match="mavic_3m"):
        shipped_sensor("mavic")
    with pytest.raises(InputError, match="band_pixel"):
        Sensor("s", mavic_3m(), sensor("mavic_3m").camera, band_pixel=(1.0,))

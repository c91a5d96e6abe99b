"""Band averages: closed forms, quadrature, and what a spectrum may not be."""

import itertools
import json
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import quad

from fynjax._core.errors import InputError
from fynjax._core.spectral import box_matrix, check_wavelength, gaussian_matrix, tabulated_matrix
from fynjax.sensors import BandSet, mavic_3m

GRIDS = {
    "1 nm": np.arange(400.0, 2501.0),
    "AVIRIS-NG": np.linspace(377.2, 2500.9, 425),
    "uneven": np.sort(np.random.default_rng(3).uniform(400.0, 1200.0, 300)),
    "coarse": np.arange(400.0, 1300.0, 35.0),
}
TRIANGLE = (np.array([620.0, 650.0, 680.0]), np.array([0.0, 3.0, 0.0]))


def matrices(grid: np.ndarray) -> dict[str, np.ndarray]:
    return {
        "gaussian": gaussian_matrix(grid, [560, 650, 730, 860], [32, 32, 32, 52]),
        "box": box_matrix(grid, [560, 650, 730, 860], [32, 32, 32, 52]),
        "tabulated": tabulated_matrix(grid, [TRIANGLE]),
    }


@pytest.mark.parametrize("grid", GRIDS.values(), ids=GRIDS.keys())
def test_constant_and_linear_spectra_come_back(grid: np.ndarray) -> None:
    for kind, matrix in matrices(grid).items():
        centre = np.array([650.0]) if kind == "tabulated" else np.array([560.0, 650, 730, 860])
        np.testing.assert_allclose(matrix @ np.full(grid.size, 0.37), 0.37, rtol=1e-14)
        np.testing.assert_allclose(matrix @ (grid / 1000), centre / 1000, atol=1e-6)


def test_gaussian_mean_of_a_parabola_and_of_a_line() -> None:
    # On a fine grid: E[(λ - c)²] is the variance, E[exp(iλ/L)] the characteristic function.
    grid, sigma = np.arange(400.0, 1000.0, 0.25), 32.0 / np.sqrt(8.0 * np.log(2.0))
    row = gaussian_matrix(grid, 650.0, 32.0)[0]
    assert row @ (grid - 650.0) ** 2 == pytest.approx(sigma**2, rel=1e-4)
    expected = np.exp(-((sigma / 20.0) ** 2) / 2.0)
    assert row @ np.cos((grid - 650.0) / 20.0) == pytest.approx(expected, abs=1e-4)


def test_half_maximum_lies_half_the_width_away() -> None:
    row = gaussian_matrix(np.arange(500.0, 800.0, 1.0), 650.0, 52.0)[0]
    assert row[150 + 26] / row[150] == pytest.approx(0.5, abs=2e-4)


def test_mavic_bands_fall_to_half_at_the_stated_half_widths() -> None:
    bands = mavic_3m()
    assert bands.names == ("green", "red", "red_edge", "nir")
    weights = bands.weights(np.arange(400.0, 1001.0))
    for row, centre, half_width in zip(weights, (560, 650, 730, 860), (16, 16, 16, 26)):
        assert int(np.argmax(row)) == centre - 400
        for side in (-half_width, half_width):
            assert row[centre - 400 + side] / row.max() == pytest.approx(0.5, abs=2e-3)


def test_asymmetric_curve_equals_quadrature() -> None:
    grid = np.sort(np.random.default_rng(1).uniform(500.0, 700.0, 41))
    values = np.random.default_rng(2).uniform(size=41)
    u, r = np.array([540.0, 551.0, 580.0, 633.0, 640.0]), np.array([0.2, 2.0, 1.3, 0.4, 0.0])

    def response(x: float) -> float:
        return float(np.interp(x, u, r))

    knots = np.unique(np.concatenate([u, grid[(grid > u[0]) & (grid < u[-1])]]))
    pieces = list(itertools.pairwise(knots))
    top = sum(quad(lambda x: response(x) * np.interp(x, grid, values), a, b)[0] for a, b in pieces)
    bottom = sum(quad(response, a, b)[0] for a, b in pieces)
    row = tabulated_matrix(grid, [(u, r)])[0]
    assert row @ values == pytest.approx(top / bottom, rel=1e-10)
    # A box and a Gaussian given as curves are the box and the Gaussian.
    box = tabulated_matrix(grid, [(np.array([560.0, 600.0]), np.ones(2))])
    np.testing.assert_allclose(box, box_matrix(grid, 580.0, 40.0), atol=1e-12)
    fine = np.arange(520.0, 680.0, 0.05)
    curve = np.exp(-4.0 * np.log(2.0) * ((fine - 600.0) / 20.0) ** 2)
    gauss = tabulated_matrix(grid, [(fine, curve)])
    np.testing.assert_allclose(gauss, gaussian_matrix(grid, 600.0, 20.0), atol=1e-6)


def test_measured_response_curves_on_a_measured_spectrum(shared_data: Path) -> None:
    """Sentinel-2A's curves on a lawn: equal to a plain sum over both, interpolated to 0.02 nm."""
    lawn = np.loadtxt(shared_data / "eco" / "avirisng" / "insitu_BeckmanLawn.txt")
    wavelength, reflectance = lawn[:, 0], lawn[:, 1]
    fine = np.linspace(wavelength[0], wavelength[-1], 50 * (wavelength.size - 1) + 1)
    text = (shared_data / "eco" / "srf" / "sentinel2a_msi.geojson").read_text()
    checked = 0
    for feature in json.loads(text)["features"]:
        curve = feature["properties"]["response"]
        x, y = np.array(curve["x"], float), np.clip(np.array(curve["y"], float), 0.0, None)
        if x[y > 0].min() < wavelength[0] or x[y > 0].max() > wavelength[-1]:
            continue
        response = np.interp(fine, x, y)
        expected = response @ np.interp(fine, wavelength, reflectance) / response.sum()
        row = tabulated_matrix(wavelength, [(x, y)])[0]
        assert row @ reflectance == pytest.approx(expected, rel=1e-6)
        checked += 1
    assert checked >= 10


@pytest.mark.parametrize(
    ("grid", "message"),
    [
        (np.arange(0.4, 2.5, 0.01), "µm"),
        (np.arange(2500.0, 399.0, -1.0), "descending"),
        ([400.0, 500.0, 500.0, 600.0], "duplicate"),
        ([400.0, 600.0, 500.0, 700.0], "step back"),
        ([400.0, np.nan, 600.0], "finite"),
        ([[400.0, 500.0]], "shape"),
        ([], "shape"),
        ([-400.0, 500.0], "positive"),
    ],
)
def test_bad_grids(grid: object, message: str) -> None:
    with pytest.raises(InputError, match=message):
        check_wavelength(grid)  # type: ignore[arg-type]
    with pytest.raises(InputError, match=message):
        mavic_3m().average(grid, jnp.ones(4))  # type: ignore[arg-type]


def test_response_outside_the_spectrum_says_how_much() -> None:
    with pytest.raises(InputError, match=r"'nir' .*50 % .*400 to 860 nm"):
        mavic_3m().weights(np.arange(400.0, 861.0))
    with pytest.raises(InputError, match="100 %"):
        box_matrix(np.arange(400.0, 500.0), 700.0, 10.0)
    half = mavic_3m().weights(np.arange(400.0, 861.0), max_loss=0.6)
    np.testing.assert_allclose(half.sum(axis=1), 1.0, rtol=1e-14)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"centre": (0.56, 0.65)}, "µm"),
        ({"fwhm": (32.0, 0.0)}, "positive"),
        ({"fwhm": (32.0,)}, "`fwhm` has 1"),
        ({"names": ("a", "a")}, "differ"),
        pytest.param({"response": "triangle"}, "gaussian", marks=pytest.mark.untyped),
        ({"curves": [TRIANGLE]}, "`curves` has 1"),
    ],
)
def test_bad_band_sets(arguments: dict, message: str) -> None:
    good = {"names": ("green", "red"), "centre": (560.0, 650.0), "fwhm": (32.0, 32.0)}
    with pytest.raises(InputError, match=message):
        BandSet(**{**good, **arguments})


def test_bad_curves() -> None:
    grid = GRIDS["1 nm"]
    for curve, message in (
        (([600.0, 700.0], [1.0, -1.0]), "non-negative"),
        (([600.0, 700.0], [0.0, 0.0]), "positive"),
        (([600.0, 700.0], [1.0, 1.0, 1.0]), "one response"),
        (([0.6, 0.7], [1.0, 1.0]), "µm"),
    ):
        with pytest.raises(InputError, match=message):
            tabulated_matrix(grid, [curve])


def test_average_traces_keeps_precision_and_batches() -> None:
    bands, grid = mavic_3m(), GRIDS["1 nm"]
    spectra = np.random.default_rng(0).uniform(size=(3, 2, grid.size))
    expected = spectra @ bands.weights(grid).T
    got = jax.jit(lambda b, s: b.average(grid, s))(bands, jnp.asarray(spectra))
    assert got.shape == (3, 2, 4)
    np.testing.assert_allclose(got, expected, rtol=1e-12)
    single = bands.average(grid, jnp.asarray(spectra, jnp.float32))
    assert single.dtype == jnp.float32
    np.testing.assert_allclose(single, expected, rtol=3e-6)
    # Linear: the Jacobian is the weights, whatever the spectrum.
    jacobian = jax.jacrev(lambda s: bands.average(GRIDS["coarse"], s))(spectra[0, 0, :26])
    np.testing.assert_allclose(jacobian, bands.weights(GRIDS["coarse"]), atol=1e-16)
    with pytest.raises(InputError, match="last axis"):
        bands.average(grid, jnp.ones(7))


def test_band_set_of_boxes_and_curves() -> None:
    grid = GRIDS["uneven"]
    box = BandSet(("red",), [650.0], [60.0], "box")
    np.testing.assert_array_equal(box.weights(grid), box_matrix(grid, 650.0, 60.0))
    curve = BandSet(("red",), [650.0], [30.0], curves=[TRIANGLE])
    np.testing.assert_array_equal(curve.weights(grid), tabulated_matrix(grid, [TRIANGLE]))
    assert hash(curve) == hash(BandSet(("red",), [650.0], [30.0], curves=[TRIANGLE]))

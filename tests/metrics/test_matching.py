"""Two grids of wavelengths brought together, against NumPy and numerical integration."""

import numpy as np
import pytest

from fynjax._core.errors import InputError
from fynjax.metrics import match_wavelengths

FINE = np.arange(400.0, 1001.0, 1.0)
COARSE = np.arange(410.0, 990.0, 5.3)


def spectrum(wave: np.ndarray) -> np.ndarray:
    return 0.2 + 0.1 * np.sin(wave / 60.0) + 0.05 * np.cos(wave / 9.0)


def test_one_grid_stays() -> None:
    match = match_wavelengths(COARSE, COARSE + 0.05)
    assert match.method == "same"
    np.testing.assert_array_equal(match.wavelength, COARSE)
    np.testing.assert_array_equal(match.real, np.eye(COARSE.size))
    np.testing.assert_array_equal(match.simulated, match.real)
    assert match_wavelengths(COARSE, COARSE + 0.2, method="linear").method == "linear"


@pytest.mark.parametrize("real_is_coarse", [True, False])
def test_the_finer_follows_the_coarser(real_is_coarse: bool) -> None:
    grids = (COARSE, FINE) if real_is_coarse else (FINE, COARSE)
    for method in ("nearest", "linear", "response"):
        match = match_wavelengths(*grids, method=method)
        still, moved = (
            (match.real, match.simulated) if real_is_coarse else (match.simulated, match.real)
        )
        assert match.method == method
        assert set(match.wavelength) <= set(COARSE)
        np.testing.assert_array_equal(still @ COARSE, match.wavelength)
        np.testing.assert_allclose(moved.sum(axis=1), 1.0, rtol=1e-12)
        values = spectrum(FINE)
        if method == "linear":
            expected = np.interp(match.wavelength, FINE, values)
        elif method == "nearest":
            expected = np.array([values[np.abs(FINE - w).argmin()] for w in match.wavelength])
        else:
            step = np.linspace(-40, 40, 40001)
            response = np.exp(-4 * np.log(2) * (step / 5.3) ** 2)
            inside = (match.wavelength > 445) & (match.wavelength < 955)
            expected = np.array(
                [
                    np.sum(response * np.interp(w + step, FINE, values)) / response.sum()
                    for w in match.wavelength
                ]
            )
            np.testing.assert_allclose((moved @ values)[inside], expected[inside], rtol=1e-6)
            continue
        np.testing.assert_allclose(moved @ values, expected, rtol=1e-12)
        assert ("simulated" if real_is_coarse else "real") in match.statement[:14]


def test_auto_averages_only_where_the_finer_grid_resolves_a_band() -> None:
    assert match_wavelengths(COARSE, FINE).method == "response"
    half = np.arange(400.0, 1000.0, 4.0)
    assert match_wavelengths(COARSE, half).method == "linear"
    assert match_wavelengths(COARSE, half, real_fwhm=12.0).method == "response"
    assert "stated widths" in match_wavelengths(COARSE, half, real_fwhm=12.0).statement
    # Of almost equal steps the real grid stays.
    assert set(match_wavelengths(half, half + 1.3).wavelength) <= set(half)


def test_bands_outside_and_in_gaps_are_left_out() -> None:
    holed = FINE[(FINE < 600) | (FINE > 650)]
    match = match_wavelengths(COARSE, holed[holed > 500], method="linear")
    assert match.wavelength[0] > 500
    assert not np.any((match.wavelength > 601) & (match.wavelength < 649))
    assert np.any((match.wavelength > 590) & (match.wavelength < 600))
    kept = np.sum((COARSE >= 501) & ~((COARSE > 600) & (COARSE < 650)))
    assert abs(match.wavelength.size - kept) <= 1
    assert f"{COARSE.size - match.wavelength.size} bands" in match.statement


def test_bad_input() -> None:
    for arguments, options, word in (
        ((COARSE / 1000, FINE), {}, "µm"),
        ((COARSE, FINE), {"method": "spline"}, "nearest, linear"),
        ((COARSE, FINE + 2000.0), {}, "in common"),
        ((COARSE, FINE[:1]), {}, "two bands"),
        ((COARSE, FINE), {"real_fwhm": -1.0}, "positive"),
    ):
        with pytest.raises(InputError, match=word):
            match_wavelengths(*arguments, **options)

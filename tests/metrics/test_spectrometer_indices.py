"""The spectrometer's indices: spyndex, the formulas as written, and the bands by integration."""

import re

import jax.numpy as jnp
import numpy as np
import pytest
import spyndex

from fynjax.compare import figure12_2006, table5_2006
from fynjax.metrics import (
    SPECTRAL_REGIONS,
    SPECTROMETER_BANDS,
    SPECTROMETER_INDICES,
    spectrometer_indices,
)
from fynjax.sensors import mavic_3m
from tests.helpers import assert_gradients

GRID = np.arange(400.0, 1000.0, 5.0)

# fynjax name -> spyndex name and constants.
SPYNDEX: dict[str, tuple[str, dict[str, float]]] = {
    "NDVI": ("NDVI", {}),
    "NDRE": ("NDREI", {}),
    "GNDVI": ("GNDVI", {}),
    "NormNIR": ("NormNIR", {}),
    "EVI": ("EVI", {"g": 2.5, "C1": 6.0, "C2": 7.5, "L": 1.0}),
    "SAVI": ("SAVI", {"L": 0.5}),
    "ARVI": ("ARVI", {"gamma": -1.0}),  # spyndex has gamma with the other sign than its source
    "RENDVI": ("RENDVI", {}),
    "ReCI": ("CIRE", {}),
    "TVI": ("TVI", {}),
    "GDVI": ("GDVI", {"nexp": 2.0}),
    "IPVI": ("IPVI", {}),
}


def leaf(seed: int = 0, count: int = 6) -> np.ndarray:
    """Vegetation-like spectra [spectrum, wavelength]."""
    rng = np.random.default_rng(seed)
    edge = 1 / (1 + np.exp(-(GRID - 715 - 8 * rng.normal(size=(count, 1))) / 14))
    green = 0.05 * np.exp(-(((GRID - 552) / 30) ** 2))
    return 0.03 + green + (0.2 + 0.1 * rng.random((count, 1))) * edge


def averages(spectra: np.ndarray) -> dict[str, np.ndarray]:
    found = {}
    for name, (low, high) in SPECTROMETER_BANDS.items():
        dense = np.linspace(low, high, 4001)
        rows = np.stack([np.interp(dense, GRID, s) for s in spectra])
        found[name] = np.trapezoid(rows, dense, axis=1) / (high - low)
    return found


def test_equal_to_spyndex_and_to_the_written_formula() -> None:
    spectra = leaf()
    got = spectrometer_indices(GRID, jnp.asarray(spectra))
    assert list(got) == list(SPECTROMETER_INDICES)
    b = averages(spectra)
    for name, (theirs, constants) in SPYNDEX.items():
        narrow = name == "RENDVI"
        bands = {
            "B": b["B"], "G": b["G"], "R": b["R"], "N": b["N"],
            "RE1": b["R705"] if narrow else b["RE"], "RE2": b["R750"], **constants,
        }  # fmt: skip
        np.testing.assert_allclose(
            got[name], spyndex.computeIndex(theirs, bands), rtol=1e-6, err_msg=name
        )
    for name, index in SPECTROMETER_INDICES.items():
        written = eval(
            index.formula.replace("^", "**"), {"__builtins__": {}}, {**b, "sqrt": np.sqrt}
        )
        np.testing.assert_allclose(got[name], written, rtol=1e-6, err_msg=name)
        letters = set(re.findall(r"R705|R750|RE|[BGRN]", index.formula))
        assert set(index.bands) == letters, name


def test_what_the_spectra_do_not_reach_is_left_out() -> None:
    short = GRID[GRID < 800]
    assert not spectrometer_indices(short, jnp.asarray(leaf()[:, GRID < 800])).keys() & {"NDVI"}
    no_blue = GRID > 500
    got = spectrometer_indices(GRID[no_blue], jnp.asarray(leaf()[:, no_blue]))
    assert set(SPECTROMETER_INDICES) - set(got) == {"EVI", "ARVI"}
    holed = np.where((GRID > 900) | (GRID < 450), np.nan, leaf())
    got = spectrometer_indices(GRID, jnp.asarray(holed))
    assert all(np.isfinite(v).all() for v in got.values())
    dark = spectrometer_indices(GRID, jnp.zeros((1, GRID.size)))
    assert np.isnan(dark["NDVI"]).all()


def test_slopes() -> None:
    def some(spectrum: jnp.ndarray) -> list[jnp.ndarray]:
        return list(spectrometer_indices(GRID[::3], spectrum).values())

    assert_gradients(some, jnp.asarray(leaf()[0, ::3] + 0.01))


def test_published_facts_equal_the_transcription(shared_data) -> None:  # type: ignore[no-untyped-def]
    import json

    reference = json.loads((shared_data / "paper" / "reference_values.json").read_text())
    scopes = reference["table5_avirisng"]["scopes"]
    for (name, row), (key, theirs) in zip(table5_2006().items(), scopes.items(), strict=True):
        assert key.startswith(name)
        assert row.spectral_angle == theirs["sam_deg"]
        assert row.rmse == theirs["rmse"]
        assert row.nrmse == pytest.approx(theirs["nrmse_percent"] / 100)
        assert row.correlation == theirs["pearson_r"]
        low, high = SPECTRAL_REGIONS[name]
        assert key == f"{name}_{low:.0f}_{high:.0f}"
    figure = reference["fig12_avirisng_indices"]
    for name, row in figure12_2006().items():
        single = figure["percent_differences"].get(name)
        low, high = figure["ranges"].get(name, (single, single))
        assert (row.lower, row.upper) == pytest.approx((low / 100, high / 100))
        assert (row.simulated_higher is True) == (name in figure["percent_differences"])
    assert set(SPECTROMETER_INDICES) == set(figure["named"]) - {"MEVI", "SARE"}


def test_bands_of_the_drone_camera_are_those_of_its_file():
    drone = mavic_3m()
    for letter, centre, width in zip(("G", "R", "RE", "N"), drone.centre, drone.fwhm, strict=True):
        assert SPECTROMETER_BANDS[letter] == (centre - width / 2, centre + width / 2)

"""Vegetation indices: spyndex, values by hand, bands taken, edges, slopes, and the article."""

import json
import re
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import spyndex

from fynjax._core.errors import InputError
from fynjax.app.compare import (
    bands_2006,
    consistent_targets,
    figure12_2006,
    table4_2006,
    table5_2006,
)
from fynjax.metrics import (
    BAND_TERMS,
    BANDS,
    SPECTRAL_REGIONS,
    VEGETATION_INDICES,
    _indices,
    index_bands,
    vegetation_indices,
)
from fynjax.metrics._indices import smooth_vegetation_indices
from fynjax.sensors import BandSet, mavic_3m, shipped_sensor
from tests.helpers import assert_gradients

EVERY = sorted(VEGETATION_INDICES)
NAMES = list(table4_2006())
GRID = np.arange(400.0, 2450.0, 5.0)

# Where spyndex has a formula under another name, or has another formula under this one.
THEIRS = {
    "DVI_green": None, "EVI_green": None, "GCI": "CIG", "LCI": None, "MSR_Chen": None,
    "NDRE": "NDREI", "NDWI_Gao": None, "OSAVI_Rondeaux": None, "RDVI_root": None, "RESR": None,
    "ReCI": "CIRE", "WDRVI_005": None,
}  # fmt: skip
CONSTANTS = {
    "g": 2.5, "C1": 6.0, "C2": 7.5, "nexp": 2.0, "alpha": 0.1,
    "gamma": -1.0,  # spyndex has gamma with the other sign than its source
}  # fmt: skip


def of_spyndex(name: str) -> str | None:
    theirs = THEIRS.get(name, name)
    return theirs if theirs in spyndex.indices else None


def random_terms(name: str, count: int = 40) -> dict[str, np.ndarray]:
    """Reflectance of plants by term, brighter towards the near infrared as they are."""
    rng = np.random.default_rng(3)
    usual = {"B": 0.03, "G": 0.06, "R": 0.04, "RE": 0.1, "N": 0.3, "S1": 0.2, "S2": 0.1}
    shine = lambda at: float(np.interp(at, [550, 680, 700, 740, 800], [0.06, 0.04, 0.09, 0.2, 0.3]))  # noqa: E731
    return {
        term: (usual[term] if term in usual else shine(float(term[1:])))
        * np.exp(0.15 * rng.normal(size=count))
        for term in VEGETATION_INDICES[name].terms
    }


@pytest.fixture(scope="module")
def image() -> np.ndarray:
    """Plants, soil and shade: lognormal bands about the real image's means, [band, y, x]."""
    rng = np.random.default_rng(5)
    common = rng.normal(size=(1, 30, 40))
    own = rng.normal(size=(4, 30, 40))
    means = np.array([row.real_mean for row in bands_2006().values()])[:, None, None]
    return means * np.exp(0.3 * common + 0.2 * own)


def leaf(grid: np.ndarray = GRID, count: int = 6) -> np.ndarray:
    """Vegetation-like spectra [wavelength, spectrum]."""
    rng = np.random.default_rng(0)
    at = grid[:, None]
    edge = 1 / (1 + np.exp(-(at - 715 - 8 * rng.normal(size=count)) / 14))
    green = 0.05 * np.exp(-(((at - 552) / 30) ** 2))
    dry = 1 - 0.4 * np.exp(-(((at - 1450) / 60) ** 2)) - 0.5 * np.exp(-(((at - 1950) / 150) ** 2))
    return 0.03 + green + (0.2 + 0.1 * rng.random(count)) * edge * dry


def table4(image: Any) -> dict[str, np.ndarray]:
    return dict(zip(NAMES, np.asarray(exact(jnp.asarray(image)))))


exact = jax.jit(lambda x: vegetation_indices(x, NAMES))  # compiled once for a shape


# -- formulas ---------------------------------------------------------------------------------


@pytest.mark.parametrize("name", EVERY)
def test_formula_is_spyndex_and_what_it_says(name: str) -> None:
    """What both have is equal; the formula is what Python makes of its text."""
    index, terms = VEGETATION_INDICES[name], random_terms(name)
    value = np.asarray(index({k: jnp.asarray(v) for k, v in terms.items()}))
    written = eval(
        index.formula.replace("^", "**"), {"__builtins__": {}}, {**terms, "sqrt": np.sqrt}
    )
    np.testing.assert_allclose(value, written, rtol=1e-9)
    assert np.isfinite(value).all()
    assert index.source
    assert re.fullmatch(r"[A-Za-z]\w*", name), "statistics are named after it"
    if (theirs := of_spyndex(name)) is None:
        return
    bands = dict(CONSTANTS, L=1.0 if name in ("EVI", "EVI2") else 0.5)
    for term, values in terms.items():
        bands[spyndex_band(theirs, term)] = values
    np.testing.assert_allclose(value, spyndex.computeIndex(theirs, bands), rtol=1e-9)


def spyndex_band(index: str, term: str) -> str:
    """The band of spyndex that a term is: of those that its index has, by wavelength."""
    if term in BAND_TERMS:
        return "RE1" if term == "RE" else term

    def away(band: str) -> float:
        found, at = spyndex.bands[band], float(term[1:])
        return max(found.min_wavelength - at, at - found.max_wavelength, 0.0)

    return min((b for b in spyndex.indices[index].bands if b in spyndex.bands), key=away)


BY_HAND = {
    "CAI": ({"R2031": 0.2, "R2101": 0.14, "R2211": 0.16}, 4.0),
    "DVI_green": ({"N": 0.3, "G": 0.1}, 0.2),
    "EVI_green": ({"N": 0.4, "R": 0.05, "G": 0.08}, 0.875 / 1.1),
    "LCI": ({"N": 0.4, "RE": 0.2, "R": 0.1}, 0.4),
    "MSR_Chen": ({"N": 0.36, "R": 0.04}, 2.0),
    "MTCI": ({"R754": 0.3, "R709": 0.1, "R681": 0.05}, 4.0),
    "NDWI_Gao": ({"R860": 0.3, "R1240": 0.2}, 0.2),
    "OSAVI_Rondeaux": ({"N": 0.4, "R": 0.04}, 0.696),
    "PRI": ({"R531": 0.06, "R570": 0.04}, 0.2),
    "RDVI_root": ({"N": 0.34, "R": 0.16}, 0.6),
    "REP": ({"R670": 0.05, "R780": 0.35, "R700": 0.1, "R740": 0.3}, 720.0),
    "RESR": ({"RE": 0.2, "R": 0.1}, 2.0),
    "WBI": ({"R900": 0.4, "R970": 0.32}, 1.25),
    "WDRVI_005": ({"N": 0.4, "R": 0.08}, -0.6),
}


@pytest.mark.parametrize("name", BY_HAND)
def test_those_that_spyndex_lacks_by_hand(name: str) -> None:
    terms, value = BY_HAND[name]
    assert VEGETATION_INDICES[name](terms) == pytest.approx(value)


def test_most_are_compared_with_spyndex() -> None:
    assert sum(of_spyndex(name) is not None for name in EVERY) > 40


@pytest.mark.parametrize("name", EVERY)
def test_bands_of_a_formula_fit_its_letters(name: str) -> None:
    """Every letter is known, and a spectrometer gives the index: its bands in the right order."""
    index = VEGETATION_INDICES[name]
    spectra = leaf()
    (got,) = np.asarray(vegetation_indices(spectra, [name], GRID))
    means = {}
    for term in index.terms:
        low, high = window(term)
        dense = np.linspace(low, high, 4001)
        rows = np.stack([np.interp(dense, GRID, s) for s in spectra.T])
        means[term] = np.trapezoid(rows, dense, axis=1) / (high - low)
    written = eval(
        index.formula.replace("^", "**"), {"__builtins__": {}}, {**means, "sqrt": np.sqrt}
    )
    np.testing.assert_allclose(got, written, rtol=2e-4, atol=1e-5)


def window(term: str) -> tuple[float, float]:
    if term in BAND_TERMS:
        return BAND_TERMS[term].window
    return float(term[1:]) - 5.0, float(term[1:]) + 5.0


@pytest.mark.parametrize("name", EVERY)
def test_same_ratio_follows_from_the_formula(name: str) -> None:
    """By slopes: `measures` are its bands where light on all of them alike changes nothing."""
    index, terms = VEGETATION_INDICES[name], random_terms(name, 1)
    slope = jax.grad(lambda log: index({k: jnp.exp(v)[0] for k, v in log.items()}))
    slopes = slope({k: jnp.log(jnp.asarray(v)) for k, v in terms.items()})
    sizes = np.array([float(v[0]) for v in slopes.values()])
    assert (abs(sizes) > 1e-9).all(), "a band that does not count"
    ratio = abs(sizes.sum()) < 1e-6 * abs(sizes).max()
    assert index.measures == (frozenset(terms) if ratio else name)


def test_groups_of_one_ratio() -> None:
    def group(name: str) -> set[str]:
        same = VEGETATION_INDICES[name].measures
        return {one for one in EVERY if VEGETATION_INDICES[one].measures == same}

    assert group("GCI") >= {"GNDVI", "GCI", "GRVI", "NDWI"}
    assert group("NormG") >= {"NormNIR", "NormR", "NormG", "GRNDVI"}
    assert group("NDVI") >= {"SR", "MSR", "MSR_Chen", "WDRVI", "GDVI", "TVI", "RDVI_root", "IPVI"}
    assert not group("NDVI") & {"RDVI", "SAVI", "OSAVI", "EVI2", "DVI", "NIRv", "NDRE"}
    assert not group("GCI") & (group("NDVI") | group("NormG") | {"GSAVI", "DVI_green"})


# -- bands ------------------------------------------------------------------------------------

SENTINEL = dict(
    zip(
        ("B1", "B2", "B3", "B4", "B5", "B6", "B7", "B8", "B8A", "B9", "B10", "B11", "B12"),
        (0.02, 0.03, 0.06, 0.08, 0.13, 0.21, 0.24, 0.27, 0.28, 0.26, 0.01, 0.21, 0.13),
        strict=True,
    )
)


@pytest.mark.parametrize("sensor", ["sentinel_2a", "sentinel_2b"])
def test_sentinel_2_by_hand(sensor: str) -> None:
    bands = shipped_sensor(sensor).bands
    taken = index_bands(bands)
    assert taken["NDVI"] == {"N": ("B8",), "R": ("B4",)}
    assert taken["NDRE"] == {"N": ("B8",), "RE": ("B5",)}
    assert taken["EVI"] == {"N": ("B8",), "R": ("B4",), "B": ("B2",)}
    assert taken["S2REP"] == {"R783": ("B7",), "R665": ("B4",), "R705": ("B5",), "R740": ("B6",)}
    assert taken["NDMI"] == {"N": ("B8",), "S1": ("B11",)}
    assert taken["NBR"]["S2"] == ("B12",)
    assert taken["RENDVI"] == {"R750": ("B6",), "R705": ("B5",)}
    assert not {"PRI", "WBI", "CAI", "NDWI_Gao", "MTCI"} & set(taken)
    values = np.array([SENTINEL[name] for name in bands.names])
    found = {name: float(vegetation_indices(values, [name], bands)[0]) for name in taken}
    by_hand = {
        "NDVI": 0.19 / 0.35, "NDRE": 0.14 / 0.40, "NDMI": 0.06 / 0.48, "NBR": 0.14 / 0.40,
        "EVI": 2.5 * 0.19 / (0.27 + 0.48 - 0.225 + 1.0), "NDWI": -0.21 / 0.33,
        "ReCI": 0.27 / 0.13 - 1.0, "SAVI": 1.5 * 0.19 / 0.85, "RENDVI": 0.08 / 0.34,
        "S2REP": 705 + 35 * (0.16 - 0.13) / 0.08, "IRECI": 0.16 / (0.13 / 0.21),
    }  # fmt: skip
    assert {name: found[name] for name in by_hand} == pytest.approx(by_hand, rel=1e-5)
    # Whatever the order and the names.
    order = np.random.default_rng(1).permutation(len(bands))
    other = bands.select(order.tolist())
    other = BandSet([f"x{i}" for i in range(13)], other.centre, other.fwhm)
    names = list(taken)
    np.testing.assert_array_equal(
        vegetation_indices(values[order], names, other), vegetation_indices(values, names, bands)
    )


def test_rededge_by_hand() -> None:
    """Blue, green, red, near infrared, red edge: in this order."""
    bands, values = shipped_sensor("rededge_3").bands, np.array([0.02, 0.05, 0.04, 0.3, 0.12])
    (evi, green, ndre, ndvi, arvi) = vegetation_indices(
        values, ["EVI", "EVI_green", "NDRE", "NDVI", "ARVI"], bands
    )
    assert float(evi) == pytest.approx(2.5 * 0.26 / (0.3 + 0.24 - 0.15 + 1))
    assert float(green) == pytest.approx(2.5 * 0.26 / (0.3 + 0.24 - 0.375 + 1))
    assert float(ndre) == pytest.approx(0.18 / 0.42)
    assert float(ndvi) == pytest.approx(0.26 / 0.34)
    assert float(arvi) == pytest.approx((0.3 - 0.08 + 0.02) / (0.3 + 0.08 - 0.02))


def test_drone_by_hand_and_by_names() -> None:
    values, bands = np.array([0.06, 0.05, 0.15, 0.35]), shipped_sensor("mavic_3m").bands
    assert set(index_bands()) == set(index_bands(bands))
    names = list(index_bands())
    np.testing.assert_array_equal(
        vegetation_indices(values, names), vegetation_indices(values, names, bands)
    )
    found = dict(zip(names, vegetation_indices(values, names).tolist(), strict=True))
    assert found["NDRE"] == pytest.approx(0.2 / 0.5)
    assert found["EVI2"] == pytest.approx(2.5 * 0.3 / (0.35 + 0.12 + 1))
    assert not {"EVI", "REP", "NDMI", "RENDVI", "PRI"} & set(found)
    assert set(index_bands(("blue", *BANDS))) - set(names) == {
        "EVI",
        "ARVI",
        "BNDVI",
        "TGI",
        "VARI",
    } & set(EVERY)
    assert index_bands(("a", "b")) == {}
    # Three red edges: that nearest to 705 nm.
    three = BandSet(("a", "b", "c", "d"), (740.0, 717.0, 705.0, 842.0), (18.0, 12.0, 10.0, 57.0))
    assert index_bands(three)["NDRE"] == {"N": ("d",), "RE": ("c",)}
    # A panchromatic band is no green one; a wide infrared one is taken.
    wide = BandSet(("pan", "red", "nir"), (590.0, 660.0, 830.0), (172.0, 60.0, 140.0))
    assert "GNDVI" not in index_bands(wide)
    assert index_bands(wide)["NDVI"] == {"N": ("nir",), "R": ("red",)}


@pytest.mark.parametrize("name", ["aviris_ng", "emit", "enmap"])
def test_spectrometers_have_every_index(name: str) -> None:
    """Of smooth spectra, as of the same spectra in steps of 1 nm."""
    bands = shipped_sensor(name).bands
    assert set(index_bands(bands)) == set(EVERY)
    assert len(index_bands(bands)["NDVI"]["N"]) > 5
    fine = np.arange(350.0, 2600.0)
    seen = leaf(np.array(bands.centre))
    found = dict(zip(EVERY, np.asarray(vegetation_indices(seen, EVERY, bands)), strict=True))
    true = dict(zip(EVERY, np.asarray(vegetation_indices(leaf(fine), EVERY, fine)), strict=True))
    for index in EVERY:
        scale = 3.0 if "REP" in index else 0.05 * abs(true[index]).max() + 0.01
        assert abs(found[index] - true[index]).max() < scale, index
    order = np.random.default_rng(1).permutation(len(bands))
    again = vegetation_indices(seen[order], EVERY, bands.select(order.tolist()))
    np.testing.assert_allclose(again, np.stack([found[index] for index in EVERY]), rtol=1e-9)


def test_bands_of_the_drone_camera_are_those_of_its_file() -> None:
    drone = mavic_3m()
    for letter, centre, width in zip(("G", "R", "RE", "N"), drone.centre, drone.fwhm, strict=True):
        assert BAND_TERMS[letter].window == (centre - width / 2, centre + width / 2)


def test_what_spectra_do_not_reach_is_missing() -> None:
    short = GRID[GRID < 760]
    assert "NDVI" not in index_bands(short)
    with pytest.raises(InputError, match=r"760 to 900 nm.*\(nir\)"):
        vegetation_indices(leaf(short), ["NDVI"], short)
    no_blue = GRID[GRID > 530]
    gone = {name for name in EVERY if name not in index_bands(no_blue)}
    assert {"EVI", "ARVI", "PSRI", "SIPI"} <= gone
    assert not gone & {"NDVI", "NDRE", "GNDVI"}
    holed = np.where((GRID > 900) | (GRID < 450), np.nan, leaf().T).T
    assert np.isfinite(vegetation_indices(holed, ["NDVI", "EVI", "RENDVI"], GRID)).all()
    assert np.isnan(vegetation_indices(holed, ["NBR"], GRID)).all()


def test_messages() -> None:
    four = np.full(4, 0.1)
    with pytest.raises(
        InputError, match=r"EVI needs .* 450 to 530 nm .*blue.*green, red.*EVI_green"
    ):
        vegetation_indices(four, ["EVI"])
    with pytest.raises(InputError, match=r"these bands give \(ARI, .*'NDVX'. Did you mean 'NDVI'"):
        vegetation_indices(four, ["NDVX"])
    with pytest.raises(InputError, match="1550 to 1750 nm"):
        vegetation_indices(four, ["NDMI"])
    for names, message in (([], "got none"), ("NDVI", "list")):
        with pytest.raises(InputError, match=message):
            vegetation_indices(four, names)
    with pytest.raises(InputError, match="last axis"):
        vegetation_indices(np.ones((5, 4)), ["NDVI"])
    with pytest.raises(InputError, match="list of names"):
        vegetation_indices(four, ["NDVI"], "green")
    with pytest.raises(InputError, match="µm"):
        vegetation_indices(four, ["NDVI"], [0.55, 0.65, 0.72, 0.84])
    with pytest.raises(InputError, match="floor"):
        smooth_vegetation_indices(four, ["NDVI"], floor=0.0)


# -- edges and slopes -------------------------------------------------------------------------


def test_undefined_pixels_are_nan_with_no_slope() -> None:
    # black, black red, black green, no nir, bare (N = R), N < R, N << R, one band NaN
    green = jnp.array([0.0, 0.03, 0.0, 0.03, 0.05, 0.05, 0.05, 0.03])
    red = jnp.array([0.0, 0.0, 0.03, 0.03, 0.07, 0.09, 0.30, 0.03])
    edge = jnp.array([0.0, 0.08, 0.08, 0.08, 0.08, 0.08, 0.08, np.nan])
    nir = jnp.array([0.0, 0.20, 0.20, 0.0, 0.07, 0.07, 0.05, 0.20])
    image = jnp.stack([green, red, edge, nir])
    value = table4(image)
    undefined = {name: np.flatnonzero(~np.isfinite(v)).tolist() for name, v in value.items()}
    assert undefined.pop("RDVI_root") == [0, 3, 5, 6]
    assert undefined.pop("TVI") == [0, 3, 6]
    assert undefined.pop("ARI2") == [0, 2, 7]
    assert undefined.pop("GCI") == undefined.pop("GRVI") == [0, 2]
    assert undefined.pop("SR") == undefined.pop("MSR") == [0, 1]
    for name in ("EVI_green", "GSAVI", "OSAVI"):  # the constant in the denominator defines black
        assert undefined.pop(name) == []
    assert all(where == [0] for where in undefined.values()), undefined
    assert not any(np.any(np.isinf(v)) for v in value.values())
    assert value["RDVI_root"][4] == 0.0

    def defined_sum(x: jax.Array) -> jax.Array:
        v = vegetation_indices(x, list(index_bands()))
        return jnp.sum(jnp.where(jnp.isfinite(v), v, 0.0))

    assert bool(jnp.all(jnp.isfinite(jax.jit(jax.grad(defined_sum))(image[:, :7]))))
    smooth_indices = jax.jit(
        lambda x, floor: smooth_vegetation_indices(x, NAMES, floor=floor), static_argnums=1
    )
    for floor in (1e-4, 1e-3):
        smooth, mask = smooth_indices(image, floor)
        assert bool(jnp.all(jnp.isfinite(smooth)))
        lost = {n: np.flatnonzero(~np.asarray(m)).tolist() for n, m in zip(NAMES, mask)}
        assert lost.pop("RDVI_root") == [3, 5, 6]
        assert lost.pop("TVI") == [3, 6]
        assert lost.pop("ARI2") == [7]  # alone has the red edge
        assert all(where == [] for where in lost.values())

        def smooth_sum(x: jax.Array, floor: float = floor) -> jax.Array:
            v, m = smooth_indices(x, floor)
            return jnp.sum(jnp.where(m, v, 0.0))

        slope = jax.jit(jax.grad(smooth_sum))(image)
        assert bool(jnp.all(jnp.isfinite(slope)))
        assert float(jnp.abs(slope).max()) < 10 * 0.3 / floor**2
        np.testing.assert_array_equal(slope[2, 7], 0.0)


@pytest.mark.parametrize("level", [0.0, 0.4])
def test_flat_spectra_without_a_value_have_no_slope(level: float) -> None:
    grid = np.arange(400.0, 2501.0, 10.0)
    at = jnp.full(grid.size, level)
    slopes = jax.jacrev(lambda s: vegetation_indices(s, EVERY, grid))(at)
    assert np.isfinite(slopes).all()
    found = dict(zip(EVERY, np.asarray(vegetation_indices(at, EVERY, grid)), strict=True))
    assert np.isnan(found["NDVI"]) == (level == 0.0)
    assert np.abs(slopes[EVERY.index("SAVI")]).max() > 0.0


@pytest.mark.parametrize("function", [vegetation_indices, smooth_vegetation_indices])
def test_slopes(function: Callable, image: np.ndarray) -> None:
    """Every index's derivative in every band, one by one, at ordinary and at dark pixels."""

    def values(x: jax.Array) -> jax.Array:
        out = function(x, NAMES)
        return out[0] if isinstance(out, tuple) else out

    values = jax.jit(values)
    for pixel in (image[:, 0, 0], image[:, 3, 7], np.array([2e-4, 1e-4, 3e-4, 9e-4])):
        reverse = jax.jacrev(values)(jnp.asarray(pixel))
        np.testing.assert_allclose(jax.jacfwd(values)(jnp.asarray(pixel)), reverse, rtol=1e-9)
        for band in range(4):
            h = 1e-5 * pixel[band] * np.eye(4)[band]
            difference = (values(pixel + h) - values(pixel - h)) / (2e-5 * pixel[band])
            np.testing.assert_allclose(reverse[:, band], difference, rtol=1e-6, atol=1e-7)


@pytest.mark.parametrize("grid", [GRID[::3], np.array(shipped_sensor("sentinel_2a").bands.centre)])
def test_slopes_of_every_index(grid: np.ndarray) -> None:
    bands = shipped_sensor("sentinel_2a").bands if grid.size == 13 else grid
    spectrum = np.array(list(SENTINEL.values())) if grid.size == 13 else leaf(grid)[:, 0]
    names = list(index_bands(bands))
    values = lambda s: list(vegetation_indices(s, names, bands))  # noqa: E731
    assert_gradients(values, jnp.asarray(spectrum), rtol=1e-3)  # beside positions of 700 nm


def test_smooth_is_the_exact_within_its_stated_distance(image: np.ndarray) -> None:
    every = list(index_bands())
    value = vegetation_indices(jnp.asarray(image), every)
    smooth, mask = smooth_vegetation_indices(jnp.asarray(image), every)
    assert bool(jnp.all(mask))
    # floor²/x² = 1.1e-5 at a reflectance of 0.03, up to 1e-4 in the image's darkest pixels.
    np.testing.assert_allclose(smooth.mean(axis=(1, 2)), value.mean(axis=(1, 2)), rtol=3e-4)
    close, _ = smooth_vegetation_indices(jnp.asarray(image), every, floor=1e-7)
    rest = [i for i, name in enumerate(every) if "sqrt" not in VEGETATION_INDICES[name].formula]
    np.testing.assert_allclose(close[rest, ...], value[rest, ...], rtol=1e-8, atol=1e-9)


def test_shapes_and_precision(image: np.ndarray) -> None:
    single = jnp.asarray(image, jnp.float32)
    assert vegetation_indices(single, NAMES).shape == (20, 30, 40)
    assert vegetation_indices(single, NAMES).dtype == jnp.float32
    assert smooth_vegetation_indices(single, NAMES)[0].dtype == jnp.float32
    two = jax.jit(lambda x: vegetation_indices(x, ["SR", "NDVI"]))(jnp.asarray(image))
    np.testing.assert_allclose(two[1], table4(image)["NDVI"], rtol=1e-12)
    np.testing.assert_allclose(vegetation_indices(image[:, 0, 0], ["SR"])[0], two[0, 0, 0])


def test_a_formula_runs_nothing_else() -> None:
    index = type(VEGETATION_INDICES["NDVI"])
    for formula in ("N.real", "exit(N)", "N[0]", "(lambda: N)()", "'N'", "N if R else N"):
        with pytest.raises(InputError, match="formula"):
            index("X", formula, "")({"N": 0.3, "R": 0.1})


# -- the article ------------------------------------------------------------------------------


def test_identities_between_indices(image: np.ndarray) -> None:
    v = table4(image)
    for left, right in (
        (v["IPVI"], (v["NDVI"] + 1) / 2),
        (v["NDWI"], -v["GNDVI"]),
        (v["GRVI"], v["GCI"] + 1),
        (v["GRNDVI"], 2 * v["NormNIR"] - 1),
        (v["NormG"] + v["NormR"] + v["NormNIR"], np.ones((30, 40))),
        (v["TVI"] ** 2, v["NDVI"] + 0.5),
        (v["RDVI_root"] ** 2, v["NDVI"]),
        (v["GDVI"], (v["SR"] ** 2 - 1) / (v["SR"] ** 2 + 1)),
        (v["MSR"] * np.sqrt(v["SR"] + 1), v["SR"] - 1),
        (v["WDRVI_005"], (0.05 * v["SR"] - 1) / (0.05 * v["SR"] + 1)),
        (v["NDVI"], (v["SR"] - 1) / (v["SR"] + 1)),
    ):
        np.testing.assert_allclose(left, right, rtol=1e-12, atol=1e-14)
    green, red, red_edge, nir = image
    np.testing.assert_allclose(v["ARI2"], nir / green - nir / red_edge, rtol=1e-12)
    np.testing.assert_allclose(
        v["EVI_green"], 2.5 * (nir - red) / (nir + 6 * red - 7.5 * green + 1), rtol=1e-12
    )


def test_names_of_the_article_where_they_mean_another_form(image: np.ndarray) -> None:
    assert len(NAMES) == 20
    renamed = {row.printed: name for name, row in table4_2006().items() if row.printed != name}
    assert renamed == {"EVI": "EVI_green", "RDVI": "RDVI_root", "RVI": "GRVI", "WDRVI": "WDRVI_005"}
    for name, row in table4_2006().items():
        assert (row.literature == "") == (row.departure == ""), name
        if row.literature:
            both = vegetation_indices(image, [name, row.literature])
            assert not np.allclose(both[0], both[1], rtol=0.02)


def test_tables_equal_the_transcription(shared_data) -> None:  # type: ignore[no-untyped-def]
    reference = json.loads((shared_data / "paper" / "reference_values.json").read_text())
    ours = {row.printed: row for row in table4_2006().values()}
    assert list(ours) == list(reference["table4_vegetation_indices"])
    for name, row in reference["table4_vegetation_indices"].items():
        for field in ("real_mean", "real_std", "sim_mean", "sim_std", "histogram_intersection"):
            assert getattr(ours[name], field) == row[field]
        assert ours[name].ks == row["ks"]
        assert ours[name].formula_confidence == row["formula_confidence"]
    derived = reference["table4_implied_real_band_means_derived"]
    figure9 = reference["fig9_msi_mean_reflectance_abs_percent_difference"]
    for (band, one), letter in zip(bands_2006().items(), ("G", "R", "RE", "N")):
        assert one.real_mean == derived[letter]
        assert one.sim_abs_difference == pytest.approx(figure9[band] / 100.0)
    scopes = reference["table5_avirisng"]["scopes"]
    for (name, found), (key, theirs) in zip(table5_2006().items(), scopes.items(), strict=True):
        assert key.startswith(name)
        assert found.spectral_angle == theirs["sam_deg"]
        assert found.rmse == theirs["rmse"]
        assert found.nrmse == pytest.approx(theirs["nrmse_percent"] / 100)
        assert found.correlation == theirs["pearson_r"]
        low, high = SPECTRAL_REGIONS[name]
        assert key == f"{name}_{low:.0f}_{high:.0f}"
    figure = reference["fig12_avirisng_indices"]
    for name, one in figure12_2006().items():
        single = figure["percent_differences"].get(name)
        low, high = figure["ranges"].get(name, (single, single))
        assert (one.lower, one.upper) == pytest.approx((low / 100, high / 100))
        assert (one.simulated_higher is True) == (name in figure["percent_differences"])
    assert set(figure["named"]) - set(EVERY) == {"MEVI", "SARE"}


def test_flags_of_the_table_follow_from_its_own_numbers() -> None:
    """An affine or smooth function of another row must carry its spread; printed digits: 5e-5."""
    table = table4_2006()
    spread = {
        "IPVI": ("NDVI", 0.5),
        "NDWI": ("GNDVI", 1.0),
        "GRVI": ("GCI", 1.0),
        "NormNIR": ("GRNDVI", 0.5),
    }
    for name, (source, factor) in spread.items():
        row = table[name]
        assert row.affine_of == source
        needed = factor * table[source].real_std
        assert row.std_consistent == (abs(row.real_std - needed) < 1e-4)
        assert row.sim_std == pytest.approx(factor * table[source].sim_std, abs=1.5e-4)
    # First order: sd(sqrt(x + c)) is about sd(x) / (2 mean).
    for name in ("TVI", "RDVI_root"):
        row = table[name]
        needed = table["NDVI"].real_std / (2 * row.real_mean)
        assert row.real_std > 2 * needed
        assert row.std_consistent is False
    assert sum(row.std_consistent is False for row in table.values()) == 5
    assert [n for n, row in table.items() if row.std_consistent is None] == ["EVI_green"]


def test_targets() -> None:
    targets = {target.key: target for target in consistent_targets()}
    assert len(targets) == 4 + 19 + 14
    assert targets["nir.mean"].derived
    assert not targets["NDVI.mean"].derived
    assert targets["NDVI.std"].value == 0.0738
    assert "EVI_green.mean" not in targets
    assert "IPVI.mean" in targets
    assert "IPVI.std" not in targets
    independent = {target.key for target in consistent_targets(independent=True)}
    assert set(targets) - independent == {
        "IPVI.mean", "NDWI.mean", "NDWI.std", "NormNIR.mean", "GRVI.mean",
    }  # fmt: skip


def test_derived_bands_give_the_printed_means_to_first_order() -> None:
    """Ratios of means are near the means of ratios, within Jensen's second-order terms."""
    bands = jnp.array([row.real_mean for row in bands_2006().values()])
    value = table4(bands)
    for name in ("NDVI", "GNDVI", "IPVI", "NormNIR", "OSAVI", "GSAVI", "TVI", "RDVI_root", "GDVI"):
        assert float(value[name]) == pytest.approx(table4_2006()[name].real_mean, rel=0.03)
    for name in ("SR", "GCI", "GRVI", "MSR", "ARI2"):
        assert float(value[name]) == pytest.approx(table4_2006()[name].real_mean, rel=0.10)


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("mine,(nir-R)/(nir+R),Me (2026)", "expected letters B, G, R, RE, N, S1, S2 or R and"),
        ("mine,(N-Q)/(N+Q),Me (2026)", "but got 'Q'"),
        ("mine,(N-RE)/(N+RE,Me (2026)", "expected a formula"),
        ("mine,N+[R],Me (2026)", "expected a formula"),
        ("nir,N/R,Me (2026)", "no band's and no other index's, but got 'nir'"),
        ("mine,N/R,Me (2026)\nmine,R/N,Me (2026)", "row 3.*no other index's"),
        ("mine,N/R,Me, 2026", "quotes about a text with commas"),
        ("mine,N/R", "name, formula and source"),
    ],
)
def test_a_line_that_is_no_index_is_refused(line: str, words: str) -> None:
    with pytest.raises(InputError, match=words):
        list(_indices._read(f"name,formula,source\n{line}"))

"""The twenty indices: spyndex, identities, edges, slopes, and the paper's own table."""

from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import spyndex

from fynjax._core.errors import InputError
from fynjax.compare import bands_2006, consistent_targets, table4_2006
from fynjax.metrics import VEGETATION_INDICES, smooth_vegetation_indices, vegetation_indices

# fynjax name -> spyndex name and the constants it needs to be the paper's form.
SPYNDEX: dict[str, tuple[str, dict[str, float]]] = {
    "ARI2": ("ARI2", {}),
    "GCI": ("CIG", {}),
    "GDVI": ("GDVI", {"nexp": 2.0}),
    "GNDVI": ("GNDVI", {}),
    "GRNDVI": ("GRNDVI", {}),
    "GSAVI": ("GSAVI", {"L": 0.5}),
    "IPVI": ("IPVI", {}),
    "MSR": ("MSR", {}),
    "NDVI": ("NDVI", {}),
    "NDWI": ("NDWI", {}),
    "NormG": ("NormG", {}),
    "NormNIR": ("NormNIR", {}),
    "NormR": ("NormR", {}),
    "OSAVI": ("OSAVI", {}),
    "SR": ("SR", {}),
    "TVI": ("TVI", {}),
    "WDRVI": ("WDRVI", {"alpha": 0.05}),
}
NAMES = list(VEGETATION_INDICES)
exact_indices = jax.jit(vegetation_indices)  # compiled once for a shape


@pytest.fixture(scope="module")
def image() -> np.ndarray:
    """Plants, soil and shade: lognormal bands about the real image's means, [band, y, x]."""
    rng = np.random.default_rng(5)
    common = rng.normal(size=(1, 30, 40))
    own = rng.normal(size=(4, 30, 40))
    means = np.array([row.real_mean for row in bands_2006().values()])[:, None, None]
    return means * np.exp(0.3 * common + 0.2 * own)


def by_name(image: np.ndarray) -> dict[str, np.ndarray]:
    return dict(zip(NAMES, np.asarray(exact_indices(jnp.asarray(image)))))


def test_all_twenty_of_table_4() -> None:
    assert list(table4_2006()) == NAMES
    assert len(NAMES) == 20


@pytest.mark.parametrize("name", SPYNDEX)
def test_equal_to_spyndex(name: str, image: np.ndarray) -> None:
    theirs, constants = SPYNDEX[name]
    green, red, red_edge, nir = image
    bands = {"G": green, "R": red, "RE1": red_edge, "N": nir, **constants}
    np.testing.assert_allclose(
        by_name(image)[name], spyndex.computeIndex(theirs, bands), rtol=1e-12, atol=1e-15
    )


def test_literature_forms_are_spyndex_own(image: np.ndarray) -> None:
    """Where the paper departs and spyndex has the literature's form, that is the other one."""
    green, red, red_edge, nir = image
    evi2 = spyndex.computeIndex("EVI2", {"N": nir, "R": red, "g": 2.5, "L": 1.0})
    rdvi = spyndex.computeIndex("RDVI", {"N": nir, "R": red})
    wdrvi = spyndex.computeIndex("WDRVI", {"N": nir, "R": red, "alpha": 0.1})
    for name, expected in (("EVI", evi2), ("RDVI", rdvi), ("WDRVI", wdrvi)):
        form = VEGETATION_INDICES[name].literature
        assert form is not None
        np.testing.assert_allclose(form(green, red, red_edge, nir), expected, rtol=1e-12)
    for index in VEGETATION_INDICES.values():
        assert (index.literature is None) == (not index.departure), index.name
        if index.literature is not None:
            other = index.literature(green, red, red_edge, nir)
            assert not np.allclose(other, by_name(image)[index.name], rtol=0.02)
            space = {"G": green, "R": red, "RE": red_edge, "N": nir, "sqrt": np.sqrt}
            text = index.literature_formula.replace("^", "**")
            written = eval(text, {"__builtins__": {}}, space)
            np.testing.assert_allclose(other, written, rtol=1e-12)


def test_identities_between_indices(image: np.ndarray) -> None:
    v = by_name(image)
    for left, right in (
        (v["IPVI"], (v["NDVI"] + 1) / 2),
        (v["NDWI"], -v["GNDVI"]),
        (v["RVI"], v["GCI"] + 1),
        (v["GRNDVI"], 2 * v["NormNIR"] - 1),
        (v["NormG"] + v["NormR"] + v["NormNIR"], np.ones((30, 40))),
        (v["TVI"] ** 2, v["NDVI"] + 0.5),
        (v["RDVI"] ** 2, v["NDVI"]),
        (v["GDVI"], (v["SR"] ** 2 - 1) / (v["SR"] ** 2 + 1)),
        (v["MSR"] * np.sqrt(v["SR"] + 1), v["SR"] - 1),
        (v["WDRVI"], (0.05 * v["SR"] - 1) / (0.05 * v["SR"] + 1)),
        (v["NDVI"], (v["SR"] - 1) / (v["SR"] + 1)),
    ):
        np.testing.assert_allclose(left, right, rtol=1e-12, atol=1e-14)
    green, red, red_edge, nir = image
    np.testing.assert_allclose(v["ARI2"], nir / green - nir / red_edge, rtol=1e-12)
    np.testing.assert_allclose(
        v["EVI"], 2.5 * (nir - red) / (nir + 6 * red - 7.5 * green + 1), rtol=1e-12
    )


def test_formula_text_is_the_code_and_the_table(image: np.ndarray) -> None:
    green, red, red_edge, nir = image
    space = {"G": green, "R": red, "RE": red_edge, "N": nir, "sqrt": np.sqrt}
    for name, value in by_name(image).items():
        formula = VEGETATION_INDICES[name].formula
        written = eval(formula.replace("^", "**"), {"__builtins__": {}}, space)
        np.testing.assert_allclose(value, written, rtol=1e-12, atol=1e-14, err_msg=name)
        published = table4_2006()[name].formula
        if published != "open":
            read = eval(published.replace("^", "**"), {"__builtins__": {}}, space)
            np.testing.assert_allclose(value, read, rtol=1e-12, atol=1e-14, err_msg=name)


def test_undefined_pixels_are_nan_with_no_slope() -> None:
    # black, black red, black green, no nir, bare (N = R), N < R, N << R, one band NaN
    green = jnp.array([0.0, 0.03, 0.0, 0.03, 0.05, 0.05, 0.05, 0.03])
    red = jnp.array([0.0, 0.0, 0.03, 0.03, 0.07, 0.09, 0.30, 0.03])
    edge = jnp.array([0.0, 0.08, 0.08, 0.08, 0.08, 0.08, 0.08, np.nan])
    nir = jnp.array([0.0, 0.20, 0.20, 0.0, 0.07, 0.07, 0.05, 0.20])
    image = jnp.stack([green, red, edge, nir])
    value = by_name(image)
    undefined = {name: np.flatnonzero(~np.isfinite(v)).tolist() for name, v in value.items()}
    assert undefined.pop("RDVI") == [0, 3, 5, 6]
    assert undefined.pop("TVI") == [0, 3, 6]
    assert undefined.pop("ARI2") == [0, 2, 7]
    assert undefined.pop("GCI") == undefined.pop("RVI") == [0, 2]
    assert undefined.pop("SR") == undefined.pop("MSR") == [0, 1]
    for name in ("EVI", "GSAVI", "OSAVI"):  # the constant in the denominator defines black
        assert undefined.pop(name) == []
    assert all(where == [0] for where in undefined.values()), undefined
    assert not any(np.any(np.isinf(v)) for v in value.values())
    assert value["RDVI"][4] == 0.0

    def defined_sum(x: jax.Array) -> jax.Array:
        v = vegetation_indices(x)
        return jnp.sum(jnp.where(jnp.isfinite(v), v, 0.0))

    assert bool(jnp.all(jnp.isfinite(jax.jit(jax.grad(defined_sum))(image[:, :7]))))
    smooth_indices = jax.jit(
        lambda x, floor: smooth_vegetation_indices(x, floor=floor), static_argnums=1
    )
    for floor in (1e-4, 1e-3):
        smooth, mask = smooth_indices(image, floor)
        assert bool(jnp.all(jnp.isfinite(smooth)))
        lost = {n: np.flatnonzero(~np.asarray(m)).tolist() for n, m in zip(NAMES, mask)}
        assert lost.pop("RDVI") == [3, 5, 6, 7]
        assert lost.pop("TVI") == [3, 6, 7]
        assert all(where == [7] for where in lost.values())

        def smooth_sum(x: jax.Array, floor: float = floor) -> jax.Array:
            v, m = smooth_indices(x, floor)
            return jnp.sum(jnp.where(m, v, 0.0))

        slope = jax.jit(jax.grad(smooth_sum))(image)
        assert bool(jnp.all(jnp.isfinite(slope)))
        assert float(jnp.abs(slope).max()) < 10 * 0.3 / floor**2
        np.testing.assert_array_equal(slope[:, 7], 0.0)


@pytest.mark.parametrize("function", [vegetation_indices, smooth_vegetation_indices])
def test_slopes(function: Callable, image: np.ndarray) -> None:
    """Every index's derivative in every band, one by one, at ordinary and at dark pixels."""

    def values(x: jax.Array) -> jax.Array:
        out = function(x)
        return out[0] if isinstance(out, tuple) else out

    values = jax.jit(values)
    for pixel in (image[:, 0, 0], image[:, 3, 7], np.array([2e-4, 1e-4, 3e-4, 9e-4])):
        reverse = jax.jacrev(values)(jnp.asarray(pixel))
        np.testing.assert_allclose(jax.jacfwd(values)(jnp.asarray(pixel)), reverse, rtol=1e-9)
        for band in range(4):
            h = 1e-5 * pixel[band] * np.eye(4)[band]
            difference = (values(pixel + h) - values(pixel - h)) / (2e-5 * pixel[band])
            np.testing.assert_allclose(reverse[:, band], difference, rtol=1e-6, atol=1e-7)


def test_smooth_is_the_exact_within_its_stated_distance(image: np.ndarray) -> None:
    exact = exact_indices(jnp.asarray(image))
    smooth, mask = smooth_vegetation_indices(jnp.asarray(image))
    assert bool(jnp.all(mask))
    # floor²/x² = 1.1e-5 at a reflectance of 0.03, up to 1e-4 in the image's darkest pixels.
    np.testing.assert_allclose(smooth.mean(axis=(1, 2)), exact.mean(axis=(1, 2)), rtol=1e-4)
    close, _ = smooth_vegetation_indices(jnp.asarray(image), floor=1e-7)
    rest = [i for i, name in enumerate(NAMES) if name not in ("RDVI", "TVI")]
    np.testing.assert_allclose(close[rest, ...], exact[rest, ...], rtol=1e-8, atol=1e-9)


def test_shapes_names_and_precision(image: np.ndarray) -> None:
    single = jnp.asarray(image, jnp.float32)
    assert vegetation_indices(single).shape == (20, 30, 40)
    assert vegetation_indices(single).dtype == jnp.float32
    assert smooth_vegetation_indices(single)[0].dtype == jnp.float32
    two = jax.jit(lambda x: vegetation_indices(x, ["SR", "NDVI"]))(jnp.asarray(image))
    np.testing.assert_allclose(two[1], by_name(image)["NDVI"], rtol=1e-12)
    np.testing.assert_allclose(vegetation_indices(image[:, 0, 0], ["SR"])[0], two[0, 0, 0])
    for names, message in ((["NDVI", "SAVI"], "'SAVI'"), ([], "none"), ("NDVI", "list")):
        with pytest.raises(InputError, match=message):
            vegetation_indices(image, names)
    with pytest.raises(InputError, match="last axis"):
        vegetation_indices(np.moveaxis(image, 0, -1))
    with pytest.raises(InputError, match="floor"):
        smooth_vegetation_indices(image, floor=0.0)


def test_table_4_equals_the_transcription(shared_data) -> None:  # type: ignore[no-untyped-def]
    import json

    reference = json.loads((shared_data / "paper" / "reference_values.json").read_text())
    for name, row in reference["table4_vegetation_indices"].items():
        ours = table4_2006()[name]
        for field in ("real_mean", "real_std", "sim_mean", "sim_std", "histogram_intersection"):
            assert getattr(ours, field) == row[field]
        assert (ours.ks, ours.formula_confidence) == (row["ks"], row["formula_confidence"])
    derived = reference["table4_implied_real_band_means_derived"]
    figure9 = reference["fig9_msi_mean_reflectance_abs_percent_difference"]
    for (band, row), letter in zip(bands_2006().items(), ("G", "R", "RE", "N")):
        assert row.real_mean == derived[letter]
        assert row.sim_abs_difference == pytest.approx(figure9[band] / 100.0)


def test_flags_of_the_table_follow_from_its_own_numbers() -> None:
    """An affine or smooth function of another row must carry its spread; printed digits: 5e-5."""
    table = table4_2006()
    spread = {
        "IPVI": ("NDVI", 0.5),
        "NDWI": ("GNDVI", 1.0),
        "RVI": ("GCI", 1.0),
        "NormNIR": ("GRNDVI", 0.5),
    }
    for name, (source, factor) in spread.items():
        row = table[name]
        assert row.affine_of == source
        needed = factor * table[source].real_std
        assert row.std_consistent == (abs(row.real_std - needed) < 1e-4)
        assert row.sim_std == pytest.approx(factor * table[source].sim_std, abs=1.5e-4)
    # First order: sd(sqrt(x + c)) is about sd(x) / (2 mean).
    for name in ("TVI", "RDVI"):
        row = table[name]
        needed = table["NDVI"].real_std / (2 * row.real_mean)
        assert row.real_std > 2 * needed
        assert row.std_consistent is False
    assert sum(row.std_consistent is False for row in table.values()) == 5
    assert [n for n, row in table.items() if row.std_consistent is None] == ["EVI"]


def test_targets() -> None:
    targets = {target.key: target for target in consistent_targets()}
    assert len(targets) == 4 + 19 + 14
    assert targets["nir.mean"].derived
    assert not targets["NDVI.mean"].derived
    assert targets["NDVI.std"].value == 0.0738
    assert "EVI.mean" not in targets
    assert "IPVI.mean" in targets
    assert "IPVI.std" not in targets
    independent = {target.key for target in consistent_targets(independent=True)}
    assert set(targets) - independent == {
        "IPVI.mean", "NDWI.mean", "NDWI.std", "NormNIR.mean", "RVI.mean",
    }  # fmt: skip


def test_derived_bands_give_the_printed_means_to_first_order() -> None:
    """Ratios of means are near the means of ratios, within Jensen's second-order terms."""
    bands = jnp.array([row.real_mean for row in bands_2006().values()])
    value = by_name(bands)
    for name in ("NDVI", "GNDVI", "IPVI", "NormNIR", "OSAVI", "GSAVI", "TVI", "RDVI", "GDVI"):
        assert float(value[name]) == pytest.approx(table4_2006()[name].real_mean, rel=0.03)
    for name in ("SR", "GCI", "RVI", "MSR", "ARI2"):
        assert float(value[name]) == pytest.approx(table4_2006()[name].real_mean, rel=0.10)

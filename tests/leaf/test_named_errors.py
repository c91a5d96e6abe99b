"""What spectra depart from PROSPECT by, by name: values, intervals and pictures that follow."""

import jax
import numpy as np
import pandas as pd
import pytest

import fynjax as fx
from fynjax import jobs
from fynjax._core.errors import InputError
from fynjax._core.precision import double_precision
from fynjax.leaf import (
    IntegratingSphere,
    LeafClip,
    LeafParameters,
    LeafSettings,
    fit_leaf,
    fit_leaf_groups,
    prospect,
)

GRID = np.arange(400.0, 2501.0)
REFERENCE = {
    "structure": "n", "chlorophyll": "cab", "carotenoids": "car", "anthocyanins": "ant",
    "brown_pigments": "brown", "water": "ewt", "dry_matter": "lma", "proteins": "prot",
    "carbon_constituents": "cbc",
}  # fmt: skip


@double_precision
def simulated(version="D", count=40, seed=0, wavelength=GRID):
    """Traits of leaves, and their R and T to all digits."""
    draw = np.random.default_rng(seed)
    ranges = {
        "structure": (1.1, 2.6), "chlorophyll": (10, 90), "carotenoids": (3, 20),
        "anthocyanins": (0.5, 8), "water": (0.004, 0.04), "dry_matter": (0.002, 0.03),
        "proteins": (0.0003, 0.002), "carbon_constituents": (0.002, 0.02),
    }  # fmt: skip
    lacks = {"5": ("anthocyanins", "proteins", "carbon_constituents"),
             "D": ("proteins", "carbon_constituents"), "PRO": ("dry_matter",)}  # fmt: skip
    truth = {k: draw.uniform(*ends, count) for k, ends in ranges.items() if k not in lacks[version]}
    optics = jax.vmap(lambda leaf: prospect(leaf, wavelength=wavelength, version=version))(
        LeafParameters.many(**truth)
    )
    return truth, np.asarray(optics.reflectance), np.asarray(optics.transmittance)


def off(fit, truth):
    """Largest relative error of each trait."""
    found = {k: np.asarray(getattr(fit.parameters, k)) for k in truth}
    return {k: np.abs(found[k] / v - 1.0).max() for k, v in truth.items()}


@pytest.mark.parametrize("version", ["D", "PRO"])
@pytest.mark.parametrize("given", ["RT", "R"])
def test_spectra_of_the_authors_own_code_give_back_all_traits(shared_data, version, given):
    """40 leaves of the R package prospect, brown pigments among their traits."""
    with np.load(shared_data / "leaf" / "reference_prospect_R.npz") as stored:
        lacks = ("proteins", "carbon_constituents") if version == "D" else ("dry_matter",)
        truth = {k: stored[f"par_{v}"] for k, v in REFERENCE.items() if k not in lacks}
        grid, r, t = stored["wl"], stored[f"refl_{version}"], stored[f"tran_{version}"]
    t = t if "T" in given else None
    fit = fit_leaf(grid, r, t, version=version, free=tuple(truth), error_model="exact")
    assert set(fit.status) == {"converged"}
    assert max(off(fit, truth).values()) < 1e-5


@pytest.mark.parametrize(
    ("version", "given", "bands", "shine"),
    [("5", "RT", GRID, 0.0), ("5", "R", GRID, 0.0), ("D", "T", GRID, 0.0),
     ("D", "R", GRID, 0.03), ("D", "RT", np.arange(403.5, 2400.0, 7.0), 0.0)],
)  # fmt: skip
def test_exact_spectra_give_back_all_traits(version, given, bands, shine):
    """By R, by T, under a clip's shine, on other bands; of a trait that is zero none comes out."""
    truth, r, t = simulated(version, wavelength=bands)
    clip = LeafClip() if shine else None
    parts = r + shine if "R" in given else None, t if "T" in given else None
    fit = fit_leaf(bands, *parts, version=version, measurement=clip, error_model="exact")
    assert set(fit.status) == {"converged"}
    assert max(off(fit, truth).values()) < 1e-4
    np.testing.assert_allclose(fit.offset, shine, atol=1e-6)
    assert fit.rmse.max() < 1e-6
    green = fx.prospect(wavelength=bands, anthocyanins=[0.0], chlorophyll=[40.0])
    fit = fit_leaf(bands, *map(np.asarray, green), error_model="exact")
    assert abs(fit.parameters.chlorophyll[0] / 40.0 - 1.0) < 1e-4
    assert fit.parameters.anthocyanins[0] < 1e-3


def test_the_command_fits_exact_spectra_over_a_bright_face(tmp_path):
    """R + T^2 B / (1 - R B) of a face of 0.9, from a table."""
    truth, r, t = simulated(count=3)
    table = pd.DataFrame((r + t**2 * 0.9 / (1.0 - r * 0.9)).T, columns=["a", "b", "c"])
    table.insert(0, "wavelength", GRID)
    table.to_csv(tmp_path / "over.csv", index=False)
    options = {"measurement": "leaf-clip", "background": 0.9, "error_model": "exact"}
    assert jobs.fit_leaves([tmp_path / "over.csv"], tmp_path / "out", **options).converged
    found = pd.read_csv(tmp_path / "out" / "traits.csv")
    assert (found["error_model"] == "exact").all()
    for name, values in truth.items():
        np.testing.assert_allclose(found[name], values, rtol=1e-4)
        assert (found[f"{name}_prospect_lower90"] <= found[name]).all()


def test_with_noise_exact_intervals_hold_nine_of_ten_and_find_the_noise():
    truth, r, t = simulated(count=300, seed=1)
    draw = np.random.default_rng(2)
    noisy = [part + 0.002 * draw.normal(size=part.shape) for part in (r, t)]
    fit = fit_leaf(GRID, *noisy, error_model="exact")
    np.testing.assert_allclose(1e-6 * np.sqrt(fit.inflation), 0.002, rtol=0.1)
    for i, name in enumerate(fit.names):
        held = (fit.lower[:, i] <= truth[name]) & (truth[name] <= fit.upper[:, i])
        assert 0.85 <= held.mean() <= 0.95, name
    np.testing.assert_array_equal(fit.lower, fit.prospect_lower)
    soil = fit_leaf(GRID, np.linspace(0.1, 0.4, GRID.size), error_model="exact")
    assert soil.status == ("converged, poor fit: no spectrum of PROSPECT",)


def test_names_are_the_errors_of_an_instrument():
    """The default is "field" of a clip and "laboratory" of a sphere; the other can be asked."""
    _, r, _ = simulated(count=3)
    for name, instrument, other in (
        ("field", LeafClip(), "laboratory"), ("laboratory", IntegratingSphere(), "field"),
    ):  # fmt: skip
        usual, named, wrong = (
            fit_leaf(GRID, r, measurement=instrument, error_model=model)
            for model in (None, name, other)
        )
        assert usual.error_model == named.error_model == name
        np.testing.assert_array_equal(usual.lower, named.lower)
        assert not np.allclose(usual.lower, wrong.lower, rtol=1e-3)
        assert (usual.table()["error_model"] == name).all()
        assert usual.to_xarray().attrs["error_model"] == name
    assert fit_leaf(GRID, r, measurement=LeafClip(0.03)).error_model == "stated"
    with pytest.raises(InputError, match="Did you mean 'exact'"):
        LeafSettings(error_model="exakt")
    with pytest.raises(InputError, match="without groups"):
        fit_leaf_groups(GRID, r, groups="abc", settings=LeafSettings(error_model="exact"))


def test_the_fit_that_is_drawn_has_the_clips_offset():
    """Shine of 0.03: what the picture leaves, and rmse, hold none of it."""
    _, r, _ = simulated(count=20)
    fit = fit_leaf(GRID, r + 0.03, measurement=LeafClip())
    plain = fit_leaf(GRID, r, measurement=LeafClip())
    np.testing.assert_allclose(fit.offset - plain.offset, 0.03, atol=0.01)
    assert np.all(np.abs(fit.offset - 0.03) < 3.0 * fit.offset_deviation)
    left = fit.measured[:, 0] - fit.fitted[:, 0]
    assert np.abs(np.nanmean(left, axis=1)).max() < 0.006
    np.testing.assert_allclose(np.sqrt(np.nanmean(left**2, axis=1)), fit.rmse, rtol=1e-6)
    assert np.median(fit.rmse) < 0.008
    top, bottom = fit.plot(0)
    drawn = {line.get_label(): line.get_ydata() for line in top.lines}
    above = drawn["R of model, with offset"] - drawn["R measured"]
    assert abs(np.nanmean(above)) < 0.006
    assert abs(np.nanmean(bottom.lines[-1].get_ydata())) < 0.006
    table = fit.table()
    np.testing.assert_array_equal(table["offset"], fit.offset)
    # Over black the leaf itself is not brighter by it.
    assert np.abs(fit.reflectance - plain.reflectance)[:, 20:200].mean() < 0.01


def test_two_intervals_stand_in_the_table_and_in_words():
    _, r, t = simulated(count=5)
    fit = fit_leaf(GRID, r, t)
    table = fit.table()
    i = fit.names.index("chlorophyll")
    for end in ("lower", "upper"):
        own = getattr(fit, f"prospect_{end}")[:, i]
        np.testing.assert_array_equal(table[f"chlorophyll_prospect_{end}90"], own)
    assert table.attrs["units"]["chlorophyll_prospect_lower90"] == "ug cm-2"
    wide = (table["chlorophyll_upper90"] - table["chlorophyll_lower90"]).to_numpy()
    own = fit.prospect_upper[:, i] - fit.prospect_lower[:, i]
    assert np.all(own < 0.8 * wide)
    np.testing.assert_allclose(own, 3.29 * fit.prospect_deviation[:, i], rtol=0.05)
    assert "as a laboratory measures it, " in str(fit)
    assert "chlorophyll_prospect_sd" in fit.to_xarray()

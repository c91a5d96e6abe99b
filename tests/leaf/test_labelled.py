"""Leaf spectra with labels: files, tables and datasets in, tables, datasets and figures out."""

import json
import shutil

import jax
import numpy as np
import pandas as pd
import pytest
import xarray as xr

import fynjax as fx
from fynjax import jobs
from fynjax.errors import InputError
from fynjax.leaf import LeafClip, LeafOverBackground, bin_centres, to_bins, to_nanometres
from fynjax.leaf._spectra import as_spectra

GRID = np.arange(400.0, 2501.0, 3.0)
NAMES = ["protea 1", "restio 2"]
ASD = "serbin_PM01_TIAM_B_LC_REFL00005.asd", "enmap_ribb00001.asd"


@pytest.fixture(scope="module")
def spectra():
    """Reflectance and transmittance [leaf, band] of two leaves with noise."""
    draw = np.random.default_rng(0)
    both = fx.prospect(chlorophyll=[30.0, 55.0], water=[0.008, 0.015], wavelength=GRID)
    return [np.asarray(part) + draw.normal(0.0, 0.001, part.shape) for part in both]


@pytest.fixture(scope="module")
def tables(spectra):
    return [pd.DataFrame(part, NAMES, GRID) for part in spectra]


@pytest.fixture(scope="module")
def plain(spectra):
    return fx.fit_leaf(GRID, *spectra)


def same(fit, other):
    """Whether all arrays of two fits are equal to the bit."""
    pairs = zip(jax.tree.leaves(fit), jax.tree.leaves(other), strict=True)
    return all(np.array_equal(a, b, equal_nan=a.dtype.kind == "f") for a, b in pairs)


def dataset_of(tables):
    parts = {
        name: (("spectrum", "wavelength"), table.to_numpy())
        for name, table in zip(("reflectance", "transmittance"), tables)
    }
    return xr.Dataset(parts, {"spectrum": NAMES, "wavelength": GRID})


def test_numbers_are_those_of_arrays_by_every_road_and_labels_survive(tables, plain, tmp_path):
    """pandas either way up, as texts, unsorted and in another order; xarray; files; the command."""
    r, t = tables
    data = dataset_of(tables)
    pairs = {f"{n}_{mark}": table.loc[n] for mark, table in zip("RT", tables) for n in NAMES}
    pd.DataFrame(pairs).rename_axis("wavelength_nm").to_csv(tmp_path / "both.csv")
    files = fx.read_spectra(tmp_path)
    assert files["reflectance"].dtype == float
    for fit in (
        fx.fit_leaf(r, transmittance=t),
        fx.fit_leaf(r.T, transmittance=t.iloc[::-1, ::-1]),
        fx.fit_leaf(r.set_axis([f"{w:g}" for w in GRID], axis=1), transmittance=t),
        fx.fit_leaf(data),
        fx.fit_leaf(data.isel(wavelength=slice(None, None, -1)).transpose()),
        fx.fit_leaf(data["reflectance"], transmittance=data["transmittance"]),
        fx.fit_leaf(files),
    ):
        assert fit.labels == tuple(NAMES)
        assert same(fit, plain)
    assert plain.labels == ("leaf_1", "leaf_2")
    jobs.fit_leaves([tmp_path / "both.csv"], tmp_path / "out")
    written = pd.read_csv(tmp_path / "out" / "traits.csv", keep_default_na=False)
    fit.table().to_csv(tmp_path / "own.csv", index=False, float_format="%.6g")
    own = pd.read_csv(tmp_path / "own.csv", keep_default_na=False)
    pd.testing.assert_frame_equal(written, own)
    with xr.open_dataset(tmp_path / "out" / "spectra.nc") as kept:
        for name in ("chlorophyll", "water_sd"):  # 64 bit numbers
            np.testing.assert_array_equal(kept[name], fit.to_xarray()[name])
        np.testing.assert_array_equal(
            kept["fitted_reflectance"], plain.fitted[:, 0].astype(np.float32)
        )


def test_three_lines_from_a_folder_of_real_files_to_a_table(shared_data, tmp_path):
    """Two ASD files: the fit is that of the arrays, with jumps of detectors taken out."""
    folder = tmp_path / "leaves"
    folder.mkdir()
    for name in ASD:
        shutil.copy(shared_data / "leaf" / "asd" / name, folder)
    with pytest.warns(UserWarning, match=r"ASD spectra is relative to a white panel.*`panel`"):
        spectra = fx.read_spectra(folder)
    fit = fx.fit_leaf(spectra, measurement=LeafClip())
    table = fit.table()
    assert table["name"].tolist() == sorted(name.removesuffix(".asd") for name in ASD)
    assert table["file"].tolist() == [str(folder / name) for name in sorted(ASD)]
    lime = table.set_index("name").loc[ASD[0].removesuffix(".asd")]
    assert lime["status"] == "converged"
    assert 20.0 < lime["chlorophyll_lower90"] < lime["chlorophyll"] < 80.0
    assert table["repairs"].tolist() == spectra["repairs"].values.tolist()
    assert spectra.attrs["input_sha256"].count(".asd") == 2
    assert spectra["wavelength"].attrs["units"] == "nm"
    arrays = fx.fit_leaf(
        spectra["wavelength"].values, spectra["reflectance"].values, measurement=LeafClip()
    )
    assert same(fit, arrays)
    with pytest.warns(UserWarning, match="panel"):
        raw = fx.read_spectra(folder, detector_changes=())
    at = fit.labels.index(lime.name)
    changes = json.loads(raw["header"].values[at])["splices"]
    by_fit = fx.fit_leaf(raw, measurement=LeafClip(), detector_changes=changes)
    np.testing.assert_allclose(by_fit.measured[at], fit.measured[at], rtol=1e-12)
    assert not np.array_equal(
        raw["reflectance"].sel(spectrum=lime.name), spectra["reflectance"].sel(spectrum=lime.name)
    )


def test_folders_without_spectra_and_files_that_are_none(tmp_path):
    with pytest.raises(InputError, match="the folder has none"):
        fx.read_spectra(tmp_path)
    (tmp_path / "notes.txt").write_text("rain after noon\n")
    with pytest.raises(InputError, match=r"notes\.txt: unknown format"):
        fx.read_spectra(tmp_path)
    with pytest.raises(InputError, match=r"none\.asd"):
        fx.read_spectra(tmp_path / "none.asd")
    with pytest.raises(InputError, match="no file of spectra"):
        fx.read_spectra([])
    for name in "ab":
        folder = tmp_path / name
        folder.mkdir()
        pd.DataFrame({"nm": GRID, "leaf": 0.3, name: 0.4}).to_csv(folder / "both.csv", index=False)
    with pytest.warns(UserWarning, match=r"^Refused: .*notes\.txt"):
        read = fx.read_spectra(tmp_path)
    assert read["spectrum"].values.tolist() == ["leaf", "a", "leaf_2", "b"]
    one = fx.read_spectra(tmp_path / "b" / "both.csv")
    assert one["spectrum"].values.tolist() == ["leaf", "b"]
    assert "transmittance" not in one


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda r: 100.0 * r, "median of 'protea 1' is .* in percent"),
        (lambda r: r.set_axis(GRID / 1000.0, axis=1), "0.4 to 2.5 in µm"),
        (lambda r: r.set_axis(GRID / 1000.0, axis=1).rename_axis(columns="wavelength"), "in µm"),
        (lambda r: pd.concat([r, r[[700.0]]], axis=1), "wavelength 700.0 is there twice"),
        (lambda r: pd.concat([r, r]), "label protea 1 is there twice"),
        (lambda r: pd.concat([r, r]).T, "label protea 1 is there twice"),
        (lambda r: r.iloc[:0], r"empty: \(0, 701\)"),
        (lambda r: r.iloc[:, :0], r"empty: \(2, 0\)"),
        (lambda r: r.set_axis([401, 402]), "both columns and index .* could be wavelengths"),
        (lambda r: r.reset_index(), r"set_index\('index'\)"),
        (lambda r: r.T.rename_axis("wavelength").reset_index(), r"set_index\('wavelength'\)"),
        (lambda r: r.set_axis(range(r.shape[1]), axis=1), "wavelengths .* as columns or as index"),
        (lambda r: r.astype(str) + "x", "expected numbers in the table"),
        (lambda r: xr.DataArray(r, dims=("spectrum", "band")), "a coordinate `wavelength`"),
        (lambda r: dataset_of([r]).expand_dims("day"), "over spectra and a coordinate"),
        (lambda r: dataset_of([r]).rename(reflectance="rho"), "but the dataset has rho"),
        (lambda r: "both.csv", "got str. Files are read by `fx.read_spectra`"),
        (lambda r: {"a": 1}, "expected wavelengths"),
        (lambda r: None, "an ascending vector"),
    ],
)
def test_spectra_that_cannot_be_used_are_one_clear_error(tables, change, message):
    wrong = change(tables[0])
    labelled = isinstance(wrong, pd.DataFrame | xr.DataArray | xr.Dataset)
    with pytest.raises(InputError, match=message):
        fx.fit_leaf(wrong, *(() if labelled else ([[0.1]],)))


def test_arrays_that_cannot_be_used_are_one_clear_error(spectra, tables):
    r, _ = spectra
    for arrays, message in (
        ((GRID, 100.0 * r), "percent"),
        ((GRID / 1000.0, r), "run from 0.4 to 2.5; are they in µm"),
        ((GRID, r.astype(str) + np.array("x")), "an array of reflectance"),
        ((GRID, r[:0]), "got 0 of 701 bands"),
        ((tables[0], r), "as the only argument"),
        ((tables[0], None, r), "with labels, as the other"),
        ((tables[0], None, tables[0].set_axis(["a", "b"])), "same labels and wavelengths"),
        ((tables[0], None, tables[0].iloc[:, 1:]), "same labels and wavelengths"),
        ((dataset_of(tables), None, tables[1]), "of a dataset transmittance too"),
    ):
        with pytest.raises(InputError, match=message):
            fx.fit_leaf(*arrays)
    with pytest.raises(InputError, match="within JAX's transformations"):
        jax.jit(lambda x: fx.fit_leaf(GRID, x).rmse)(r)


def test_one_spectrum_and_named_axes():
    """A row of a dataset keeps its name; an axis named wavelength is one, whatever else is."""
    table = pd.DataFrame(0.3, [500, 501], pd.Index([600, 700, 800], name="wavelength_nm"))
    spectra = as_spectra(table, None, None)
    assert spectra.source.labels == ("500", "501")
    assert spectra.wavelength.tolist() == [600, 700, 800]
    one = dataset_of([pd.DataFrame(0.3, NAMES, GRID)]).isel(spectrum=1)
    assert as_spectra(one, None, None).source.labels == ("restio 2",)
    bands = one["reflectance"].drop_vars("spectrum").rename(wavelength="band")
    bands = bands.assign_coords(wavelength=("band", GRID))
    spectra = as_spectra(bands, None, None)
    assert spectra.source.labels == ("leaf_1",)
    assert spectra.reflectance.shape == (1, GRID.size)


def test_a_table_states_units_and_intervals(plain):
    table = plain.table()
    units = table.attrs["units"]
    assert (units["chlorophyll"], units["water_lower90"]) == ("ug cm-2", "cm")
    assert (table["chlorophyll_lower90"] < table["chlorophyll"]).all()
    np.testing.assert_array_equal(table["water_sd"], plain.standard_deviation[:, 4])
    assert plain.names[4] == "water"
    assert table["status"].tolist() == list(plain.status)
    assert "file" not in table


def test_what_is_printed_says_what_was_found(spectra, plain):
    text = str(plain)
    assert text.startswith("2 leaves fitted with PROSPECT-D: 2 converged.")
    low, high = sorted(plain.parameters.chlorophyll.tolist())
    assert f"chlorophyll {low:.3g} to {high:.3g} ug cm-2, standard deviation" in text
    assert "prior" not in text
    r = np.where(GRID < 1000.0, spectra[0], np.nan)
    r[1] = np.nan
    text = str(fx.fit_leaf(GRID, r))
    assert "1 converged; 1 failed: fewer than ten usable bands" in text
    assert "The prior says more than the spectrum of water (1), dry_matter (1)." in text
    assert str(fx.fit_leaf(GRID, r[0])).startswith("The leaf 'leaf_1' fitted with PROSPECT-D: conv")


def test_a_plot_shows_what_was_measured_fitted_and_left(tables, plain):
    fit = fx.fit_leaf(dataset_of(tables), measurement=LeafOverBackground(gap_fraction=None))
    top, bottom = fit.plot("restio 2")
    shown = {line.get_label(): line for line in top.lines}
    assert "1 - T of model, with gaps" in shown
    inside = np.isin(fit.wavelength, shown["R measured"].get_xdata())
    np.testing.assert_array_equal(shown["R measured"].get_ydata(), fit.measured[1, 0, inside])
    np.testing.assert_array_equal(
        shown["R of model, with offset"].get_ydata(), fit.fitted[1, 0, inside]
    )
    left = {line.get_label(): line.get_ydata() for line in bottom.lines}
    np.testing.assert_array_equal(left["T"], (fit.measured - fit.fitted)[1, 1, inside])
    assert top.get_title() == "restio 2"
    (own,) = plain.plot(-1, axes=bottom)
    assert own is bottom
    for wrong in ("restio", 2, 0.0):
        with pytest.raises(InputError, match="label of a leaf"):
            fit.plot(wrong)
    with pytest.raises(InputError, match="Did you mean 'restio 2'"):
        fit.plot("restio2")


def test_bins_of_sparse_bands_are_nearer_by_lines_between_them(spectra):
    """Of a leaf in steps of 5 nm, against its bins in steps of 1 nm; bands far apart stay."""
    fine = np.arange(400.0, 2501.0)
    whole = np.asarray(fx.prospect(wavelength=fine).reflectance)
    truth = to_bins(fine, whole)
    grid = fine[::5]
    error = [
        np.abs(bins - truth)[5:-5].max()
        for bins in (to_bins(*to_nanometres(grid, whole[::5])), to_bins(grid, whole[::5]))
    ]
    assert error[0] < 0.8 * error[1]
    measured = fx.fit_leaf(grid, whole[::5]).measured[0, 0]
    have = np.isfinite(measured)
    assert np.abs(measured - truth)[have].max() < 0.8 * error[1]
    far, values = np.array([500.0, 560.4, 1000.0]), np.array([0.1, 0.2, 0.4])
    at, found = to_nanometres(far, values)
    np.testing.assert_array_equal(at[np.isfinite(found)], [500.0, 560.0, 1000.0])
    np.testing.assert_allclose(found[np.isfinite(found)], values, atol=0.001)
    spectrum = np.linspace(0.1, 0.3, bin_centres().size)
    fit = fx.fit_leaf(bin_centres(), spectrum)
    have = np.isfinite(fit.measured[0, 0])
    np.testing.assert_array_equal(fit.measured[0, 0, have], spectrum[have])


def test_the_example_leaves_agree_with_their_laboratory():
    """Six ASD files, their panel and transmittance; most of the laboratory's values lie within 90 %
    intervals, whose number the titles say."""
    folder = fx.io.spectra.example_leaves()
    spectra = fx.read_spectra(folder / "reflectance", panel=folder / "panel.csv")
    through = fx.read_spectra(folder / "transmittance.csv")[["transmittance"]]
    fit = fx.fit_leaf(spectra.merge(through, join="outer"))
    assert set(fit.status) == {"converged"}
    known = pd.read_csv(folder / "laboratory.csv", index_col="name")
    axes = fit.plot_traits(known)
    table, inside = fit.table().set_index("name").loc[known.index], {}
    for name in known:
        within = known[name].between(table[f"{name}_lower90"], table[f"{name}_upper90"])
        inside[name] = int(within.sum())
        assert known[name].corr(table[name], method="spearman") > 0.5
    assert sum(inside.values()) >= 20
    titles = [ax.get_title() for ax in axes]
    assert titles == [f"{n.replace('_', ' ')}\n{k} of 6 within 90 %" for n, k in inside.items()]
    assert [ax.get_xlabel() for ax in axes][2] == "laboratory [cm]"
    with pytest.raises(InputError, match=r"rows such as 'pale' .* rows \['leaf'\]"):
        fit.plot_traits(pd.DataFrame({"chlorophyll": [1.0]}, ["leaf"]))

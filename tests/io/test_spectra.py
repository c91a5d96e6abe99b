"""Readers of spectra: real files, each stated layout, and each kind of bad input."""

import re
import shutil
import struct
from contextlib import nullcontext

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
import pytest
import xarray as xr

import fynjax as fx
from fynjax import leaf
from fynjax._core.errors import InputError
from fynjax.app.cli import main
from fynjax.app.io.spectra import read_spectra_file
from fynjax.app.jobs._convert import convert
from fynjax.app.jobs._fit_leaf import fit_leaves
from fynjax.leaf import LeafParameters, area_factors, correct_detector_jumps, prospect
from tests.helpers import assert_valid_summary

WAVELENGTH = np.arange(400.0, 2501.0)
LEAF = prospect(LeafParameters())
R, T = np.asarray(LEAF.reflectance), np.asarray(LEAF.transmittance)


def table(path, columns, sep=","):
    pd.DataFrame(columns).to_csv(path, index=False, sep=sep)
    return path


def asd(count=2151, kind=1, version=b"as7", white=1000.0, start=350.0):
    header = bytearray(484)
    header[:3], header[186], header[199] = version, kind, 2
    struct.pack_into("<ff", header, 191, start, 1.0)
    struct.pack_into("<H", header, 204, count)
    target = np.linspace(100.0, 500.0, count)
    return (
        bytes(header) + target.tobytes() + bytes(18) + struct.pack("<H", 3) + b"abc"
        + np.full(count, white).tobytes()
    )  # fmt: skip


def test_binary_asd_equals_the_makers_own_export(shared_data):
    exports = sorted((shared_data / "leaf" / "asd").glob("*.asd.txt.gz"))
    assert len(exports) >= 8
    for export in exports:
        binary, text = (
            read_spectra_file(export.with_suffix("").with_suffix(""))[0],
            read_spectra_file(export)[0],
        )
        np.testing.assert_array_equal(binary.wavelength, text.wavelength)
        np.testing.assert_allclose(binary.reflectance, text.reflectance, rtol=1e-11, atol=1e-9)
        assert binary.meta["splices"] == [1000.0, 1830.0]


def test_every_real_asd_file_with_a_white_reference_gives_reflectance(shared_data):
    files = sorted((shared_data / "leaf" / "asd").glob("*.asd"))
    refused = []
    for file in files:
        try:
            (spectrum,) = read_spectra_file(file)
            assert spectrum.reflectance.size in (751, 2151)
        except InputError as error:
            refused.append((file.name, str(error)))
    assert [name for name, _ in refused] == ["kai_v7sample__v7sample00000.asd"]
    assert "radiance" in refused[0][1]
    assert len(files) == 20


def test_a_panel_calibration_in_an_asd_file_makes_reflectance_absolute(shared_data):
    """Real files: target over white, times the series ABS, where the format's layout puts it."""
    absolute = {}
    for file in sorted((shared_data / "leaf" / "asd").glob("*.asd")):
        data = file.read_bytes()
        if data[186] == 2:  # radiance
            continue
        (spectrum,) = read_spectra_file(file)
        if spectrum.meta["panel"] == "unknown":
            continue
        body = 8 * 2151
        target, white = (np.frombuffer(data, "<f8", 2151, at) for at in (484, 484 + body + 20))
        panel = np.frombuffer(data, "<f8", 2151, 484 + 2 * body + 20 + 54 + 1 + 29)
        whole = np.isfinite(spectrum.reflectance)
        np.testing.assert_allclose(
            spectrum.reflectance[whole], (target / white * panel)[whole], rtol=1e-12
        )
        assert any("white panel's own" in sentence for sentence in spectrum.meta["repairs"])
        absolute[file.name] = panel[500]
    assert len(absolute) == 3
    np.testing.assert_allclose(list(absolute.values()), 0.99, atol=1e-3)


def calibrated(kind=1, series=(0,), panel=0.98, end=None):
    """`asd`, and behind it a material report, a dependent variable and series of calibrations."""
    report = bytes(2) + 20 * (struct.pack("<H", 2) + b"ab") + struct.pack("<H", 1) + bytes(10)
    report += 2 * (struct.pack("<H", 1) + b"c") + bytes(92)
    variables = struct.pack("<HH", 0xFFFF, 1) + bytes(10) + struct.pack("<H", 3) + b"lma"
    variables += bytes(10) + struct.pack("<f", 2.0)
    heads = b"".join(struct.pack("<b20sihh", kind, b"panel", 0, 0, 0) for kind in series)
    values = b"".join(np.full(2151, panel if kind == 0 else 7.0).tobytes() for kind in series)
    whole = asd(kind=kind) + report + variables + bytes([len(series)]) + heads + values
    return whole[:end]


@pytest.mark.parametrize(
    ("content", "factor"),
    [
        (calibrated(), 0.98),
        (calibrated(series=(1, 0, 2)), 0.98),
        (calibrated(kind=6), 1.0),
        (calibrated(series=(1, 2, 3)), 1.0),
        (calibrated(panel=np.nan), 1.0),
        (calibrated(end=-100), 1.0),
        (calibrated(end=-17300), 1.0),
    ],
    ids=["ABS", "among others", "transmittance", "no ABS", "damaged", "cut short", "no series"],
)
def test_the_panel_is_found_behind_reports_and_variables(tmp_path, content, factor):
    (tmp_path / "leaf.asd").write_bytes(content)
    (spectrum,) = read_spectra_file(tmp_path / "leaf.asd")
    values = spectrum.transmittance if spectrum.reflectance is None else spectrum.reflectance
    np.testing.assert_allclose(values, factor * np.linspace(0.1, 0.5, 2151), rtol=1e-12)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (asd(kind=2), "radiance"),
        (asd(white=0.0), "white reference is zero"),
        (asd()[:9000], "cut short"),
        (asd()[:300], "cut short"),
        (asd()[: 484 + 2151 * 8 + 2000], "cut short inside its white"),
        (asd()[: 484 + 2151 * 8], "no white reference"),
        (asd(version=b"as3"), "version 6, 7 or 8"),
        (b"Wavelength;a\n350;0.1\n351;0.2\n", "content is text"),
        (b"", "empty"),
    ],
)
def test_bad_asd_files_say_what_is_wrong(tmp_path, content, message):
    path = tmp_path / "leaf.asd"
    path.write_bytes(content)
    with pytest.raises(InputError, match=message) as caught:
        read_spectra_file(path)
    assert str(path) in str(caught.value)


def test_a_short_detector_and_raw_counts(tmp_path):
    path = tmp_path / "hand.asd"
    path.write_bytes(asd(count=751, kind=0, version=b"as8", start=325.0))
    (spectrum,) = read_spectra_file(path)
    np.testing.assert_allclose(spectrum.reflectance, np.linspace(0.1, 0.5, 751))
    assert spectrum.wavelength[[0, -1]].tolist() == [325.0, 1075.0]
    assert "raw" in spectrum.meta["repairs"][0]


@pytest.mark.parametrize("sep", [",", "\t", ";"])
def test_columns_pair_reflectance_with_transmittance(tmp_path, sep):
    columns = {"wavelength_nm": WAVELENGTH, "oak_R": R, "oak_T": T, "pine": R / 2}
    oak, pine = read_spectra_file(table(tmp_path / "a.csv", columns, sep))
    assert (oak.name, pine.name) == ("oak", "pine")
    np.testing.assert_allclose(oak.reflectance, R)
    np.testing.assert_allclose(oak.transmittance, T)
    assert pine.transmittance is None


def test_a_last_letter_is_a_mark_where_its_counterpart_stands_beside_it(tmp_path):
    columns = {"nm": WAVELENGTH, "3R": R, "3T": T, "4T": R / 2}
    pair, alone = read_spectra_file(table(tmp_path / "a.csv", columns))
    assert (pair.name, alone.name) == ("3", "4T")
    np.testing.assert_allclose(pair.transmittance, T)
    np.testing.assert_allclose(alone.reflectance, R / 2)


def test_a_leaf_a_hundred_times_too_dark_is_refused(tmp_path):
    path = table(tmp_path / "a.csv", {"nm": WAVELENGTH, "leaf (%)": R})
    with pytest.raises(InputError, match=r"darker than any leaf.*header say '%'"):
        read_spectra_file(path)
    (leaf,) = read_spectra_file(table(tmp_path / "b.csv", {"nm": WAVELENGTH, "tar": 0.04 + 0 * R}))
    assert leaf.name == "tar"
    (thick,) = read_spectra_file(table(tmp_path / "c.csv", {"nm": WAVELENGTH, "T": R / 100}))
    assert thick.reflectance is None


def test_a_column_called_spectrum_says_nothing_of_micrometres(tmp_path):
    (leaf,) = read_spectra_file(table(tmp_path / "a.csv", {"Spectrum": WAVELENGTH, "leaf": R}))
    np.testing.assert_array_equal(leaf.wavelength, WAVELENGTH)
    assert not leaf.meta["repairs"]


def test_micrometres_percent_and_descending_order_are_repaired_and_said(tmp_path):
    columns = {"wavelength_um": WAVELENGTH[::-1] / 1000, "leaf reflectance (%)": 100 * R[::-1]}
    (spectrum,) = read_spectra_file(table(tmp_path / "a.csv", columns))
    np.testing.assert_allclose(spectrum.wavelength, WAVELENGTH)
    np.testing.assert_allclose(spectrum.reflectance, R)
    said = " ".join(spectrum.meta["repairs"])
    assert "µm" in said
    assert "percent" in said
    assert "sorted" in said


def test_wide_table_with_wavelengths_as_names(tmp_path):
    wide = pd.DataFrame([R, R / 2], columns=[f"{w:.0f}" for w in WAVELENGTH])
    wide.insert(0, "Sample_ID", ["a", "b"])
    wide.insert(1, "species", ["x", "y"])
    wide.to_csv(tmp_path / "wide.csv", index=False)
    first, second = read_spectra_file(tmp_path / "wide.csv")
    assert (first.name, second.name) == ("a", "b")
    np.testing.assert_allclose(second.reflectance, R / 2)
    assert first.meta["columns"]["species"] == "x"


def test_ecostress_text(tmp_path):
    head = "Name: Oak\nType: vegetation\nFirst Column: X\nX Units: Wavelength (micrometers)\n"
    head += f"Y Units: Reflectance (percent)\nNumber of X Values: {WAVELENGTH.size}\n\n"
    body = "\n".join(f"{w / 1000:.4f}\t{100 * r:.6f}" for w, r in zip(WAVELENGTH[::-1], R[::-1]))
    path = tmp_path / "oak.spectrum.txt"
    path.write_text(head + body)
    (spectrum,) = read_spectra_file(path)
    assert spectrum.name == "Oak"
    np.testing.assert_allclose(spectrum.reflectance, R, atol=1e-7)
    path.write_text(head + body[: len(body) // 2].rsplit("\n", 1)[0])
    with pytest.raises(InputError, match="cut short"):
        read_spectra_file(path)
    path.write_text(head.replace(f"Values: {WAVELENGTH.size}", "Values: " + "9" * 4301) + body)
    with pytest.raises(InputError, match=r"expected 9{20} values as the header says"):
        read_spectra_file(path)


def test_envi_library(tmp_path):
    np.stack([R, R / 2]).astype(">f4").tofile(tmp_path / "lib.sli")
    wavelengths = ", ".join(str(w / 1000) for w in WAVELENGTH)
    header = (
        f"ENVI\nsamples = {R.size}\nlines = 2\nbands = 1\nheader offset = 0\ndata type = 4\n"
        "file type = ENVI Spectral Library\nbyte order = 1\nwavelength units = Micrometers\n"
        f"spectra names = {{ oak, pine }}\nwavelength = {{ {wavelengths} }}\n"
    )
    (tmp_path / "lib.hdr").write_text(header)
    for name in ("lib.sli", "lib.hdr"):
        oak, pine = read_spectra_file(tmp_path / name)
        assert pine.name == "pine"
        np.testing.assert_allclose(oak.wavelength, WAVELENGTH)
        np.testing.assert_allclose(pine.reflectance, R / 2, rtol=1e-6)
    (tmp_path / "lib.sli").write_bytes(b"1234")
    with pytest.raises(InputError, match="cut short"):
        read_spectra_file(tmp_path / "lib.sli")


@pytest.mark.parametrize(
    ("columns", "message"),
    [
        ({"wavelength": WAVELENGTH, "r": 1000 * R}, "percent"),
        ({"wavelength": WAVELENGTH, "r": 100 * R, "s": R}, "percent"),
        ({"wavelength_nm": WAVELENGTH / 1000, "r": R}, "stated in 'nm'.*they µm"),
        ({"wavelength_um": WAVELENGTH, "r": R}, "stated in 'µm'.*they nm"),
        ({"wavelength": WAVELENGTH, "r": np.nan * R}, "only NaN"),
        ({"wavelength": WAVELENGTH, "r": R - 0.3}, "negative"),
        ({"wavelength": WAVELENGTH, "r": R + 0.9}, "above one"),
        ({"wavelength": np.round(WAVELENGTH / 2), "r": R}, "twice"),
        ({"wavelength": WAVELENGTH, "r": ["x"] * R.size}, "expected a number"),
    ],
)
def test_impossible_tables_are_refused_with_the_files_name(tmp_path, columns, message):
    path = table(tmp_path / "bad.csv", columns)
    with pytest.raises(InputError, match=message) as caught:
        read_spectra_file(path)
    assert "bad.csv" in str(caught.value)


def test_a_table_all_in_percent_is_known_by_its_numbers(tmp_path):
    """A column or a row a spectrum, and Avantes' text of two columns; where one spectrum has
    fractions all stay as they are."""
    columns = {"Wellenlaenge": WAVELENGTH, "a": 100 * R, "b": 50 * R}
    table(tmp_path / "columns.csv", columns)
    rows = pd.DataFrame([100 * R, 50 * R], columns=[f"{w:g}" for w in WAVELENGTH])
    rows.insert(0, "id", ["a", "b"])
    rows.to_csv(tmp_path / "rows.csv", index=False)
    for name in ("columns.csv", "rows.csv"):
        a, b = read_spectra_file(tmp_path / name)
        np.testing.assert_allclose(a.reflectance, R)
        np.testing.assert_allclose(b.reflectance, R / 2)
        assert "converted from percent" in " ".join(a.meta["repairs"])
    lines = "".join(f"{w:8.2f};{100 * t:9.4f}\n" for w, t in zip(WAVELENGTH, T))
    head = "Integration time: 50.00 ms\nWave   ;Transmittance\n[nm]   ;[%]\n\n"
    (tmp_path / "leaf.ttt").write_text(head + lines)
    (leaf,) = read_spectra_file(tmp_path / "leaf.ttt")
    np.testing.assert_allclose(leaf.transmittance, T, atol=1e-6)


def test_missing_values_among_plain_numbers_of_a_row(tmp_path):
    """-999 is one, an empty cell and a word are not numbers; exponents are."""
    more = ",".join(str(900 + 10 * i) for i in range(8))
    path, last = tmp_path / "rows.csv", ",0.5" * 8
    text = f"id,500,600,700,800,{more}\na,0.1,-999,0.2,3e-1{last}\nb,0.1,,.2,1E-1{last}\n"
    path.write_text(text)
    values = [s.reflectance[:4] for s in read_spectra_file(path)]
    np.testing.assert_array_equal(values, [[0.1, np.nan, 0.2, 0.3], [0.1, np.nan, 0.2, 0.1]])
    path.write_text(text.replace("b,0.1,", "b,0.1,0.2.1"))
    with pytest.raises(InputError, match="row 3") as caught:
        read_spectra_file(path)
    assert "0.2.1" in str(caught.value)


def test_slightly_negative_transmittance_is_masked_with_a_note(tmp_path):
    """As of needles whose gaps were overcorrected; far below zero it is no such thing."""
    visible = WAVELENGTH < 700
    through = np.where(visible, -0.04, 0.4)
    path = table(tmp_path / "t.csv", {"wavelength": WAVELENGTH, "a_R": R, "a_T": through})
    (needle,) = read_spectra_file(path)
    assert np.isnan(needle.transmittance[visible]).all()
    np.testing.assert_array_equal(needle.transmittance[~visible], 0.4)
    np.testing.assert_array_equal(needle.reflectance, R)
    assert "down to -0.040) masked" in needle.meta["repairs"][0]
    for wrong, message in (
        (np.where(visible, -0.2, 0.4), "is negative in"),
        (0.0 * R - 0.05, "negative throughout"),
    ):
        table(path, {"wavelength": WAVELENGTH, "a_R": R, "a_T": wrong})
        with pytest.raises(InputError, match=message):
            read_spectra_file(path)


def test_unknown_and_missing_files(tmp_path):
    (tmp_path / "a.bin").write_bytes(bytes(range(32)) * 10)
    with pytest.raises(InputError, match="unknown format"):
        read_spectra_file(tmp_path / "a.bin")
    (tmp_path / "a.txt").write_text("hello world\nnothing here\n")
    with pytest.raises(InputError, match="unknown format"):
        read_spectra_file(tmp_path / "a.txt")
    with pytest.raises(InputError, match="no such file"):
        read_spectra_file(tmp_path / "gone.csv")


def test_one_bad_spectrum_does_not_stop_its_file(tmp_path):
    """Row by row: the good are fitted, the bad named, repairs stand beside the traits."""
    rows = [R, np.nan * R, 100 * R, R]
    wide = pd.DataFrame(rows, columns=[f"{w / 1000:.3f}" for w in WAVELENGTH])
    wide.iloc[3, 500] = 4.0
    wide.insert(0, "id", ["fine", "void", "percent", "spike"])
    wide.to_csv(tmp_path / "wide.csv", index=False)
    with pytest.raises(InputError, match="only NaN"):
        read_spectra_file(tmp_path / "wide.csv")
    summary = fit_leaves([tmp_path / "wide.csv"], tmp_path / "out")
    assert (summary.spectra, summary.converged_spectra) == (2, 2)
    assert [r.name for r in summary.refused] == ["void", "percent"]
    traits = pd.read_csv(tmp_path / "out" / "traits.csv").set_index("name")
    assert "only NaN" in traits.loc["void", "status"]
    assert "wide.csv" in traits.loc["percent", "status"]
    assert "µm" in traits.loc["fine", "repairs"]
    assert "1 impossible" in traits.loc["spike", "repairs"]
    np.testing.assert_allclose(
        traits.loc["spike", "chlorophyll"], traits.loc["fine", "chlorophyll"], rtol=0.02
    )


@pytest.mark.parametrize("sep", [";", "\t"])
def test_decimal_commas(tmp_path, sep):
    lines = "\n".join(f"{w:.1f}{sep}{r:.9f}".replace(".", ",") for w, r in zip(WAVELENGTH, R))
    (tmp_path / "a.csv").write_text(f"Wellenlänge nm{sep}Blatt\n" + lines, encoding="utf-8")
    (spectrum,) = read_spectra_file(tmp_path / "a.csv")
    np.testing.assert_allclose(spectrum.wavelength, WAVELENGTH)
    np.testing.assert_allclose(spectrum.reflectance, R, atol=1e-8)


def test_text_as_a_spreadsheet_saves_it(tmp_path):
    lines = "\n".join(f"{w:.0f}\t{r:.9f}" for w, r in zip(WAVELENGTH, R))
    (tmp_path / "a.txt").write_text("wavelength\tleaf\n" + lines, encoding="utf-16")
    (spectrum,) = read_spectra_file(tmp_path / "a.txt")
    assert spectrum.name == "leaf"
    np.testing.assert_allclose(spectrum.reflectance, R, atol=1e-8)


def test_run_writes_traits_and_spectra_and_keeps_going_past_a_bad_file(tmp_path):
    good = table(tmp_path / "good.csv", {"wavelength": WAVELENGTH, "a_R": R, "a_T": T, "b": R})
    bad = table(tmp_path / "bad.csv", {"wavelength": WAVELENGTH, "r": 1000 * R})
    summary = fit_leaves([good, bad], tmp_path / "out")
    assert (summary.spectra, len(summary.refused)) == (2, 1)
    traits = pd.read_csv(tmp_path / "out" / "traits.csv")
    assert traits["name"].tolist()[:2] == ["a", "b"]
    assert "percent" in traits["status"][2]
    assert traits["chlorophyll_lower90"][0] < 40.0 < traits["chlorophyll_upper90"][0]
    with xr.open_dataset(tmp_path / "out" / "spectra.nc") as data:
        assert data["wavelength"].attrs["units"] == "nm"
        inside = slice(450, 2400)
        error = data["transmittance"].sel(wavelength=inside)[1].values
        at = np.interp(data["wavelength"].sel(wavelength=inside), WAVELENGTH, T)
        assert np.abs(error - at).max() < 0.05
        assert np.isnan(data["measured_transmittance"][1]).all()
    assert set(summary.files) == {p.name for p in (tmp_path / "out").iterdir()}
    assert_valid_summary(summary)
    image = plt.imread(tmp_path / "out" / "spectra.png")
    assert 0.01 < (image[..., :3].min(-1) < 0.5).mean() < 0.5  # ink, on a page mostly white
    shutil.rmtree(tmp_path / "out")
    with pytest.raises(InputError, match=r"bad\.csv"):
        fit_leaves([bad], tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_the_command_fits_groups_and_samples_the_posterior(tmp_path, capsys):
    """Through the door: what is printed, every file named, species and draws in them."""
    good = table(tmp_path / "good.csv", {"wavelength": WAVELENGTH, "a": R, "c": 0.9 * R})
    groups = tmp_path / "groups.csv"
    groups.write_text("name,species\na,Erica\nc,Protea\n")
    out = tmp_path / "out"
    with pytest.raises(SystemExit) as caught:
        main(["fit-leaf", str(good), "--output", str(out), "--groups", str(groups),
              "--posterior", "emcee"])  # fmt: skip
    assert not caught.value.code
    said = capsys.readouterr().out
    for name in ("traits.csv", "spectra.nc", "spectra.png", "species.csv", "posterior.nc"):
        assert name in said
        assert (out / name).stat().st_size > 100
    assert "2 of 2 spectra" in said
    species = pd.read_csv(out / "species.csv")
    assert species.groupby("species").size().to_dict() == {"Erica": 6, "Protea": 6}
    assert species["chlorophyll"].between(20, 70).all()
    assert set(species["area"]) == {"projected"}
    with xr.open_dataset(out / "posterior.nc") as data:
        assert data["water"].shape == (2, 400)
        assert 0.005 < float(data["water"][0].median()) < 0.02
        assert (data["status"] == "converged").all()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("name,kind\na,x\n", "expected a column 'species'"),
        ("name,species\na,x\na,y\n", "'a' is there twice"),
        ("name,species\nother,x\n", "no species for 1 spectra"),
        ("", "table of names and species"),
    ],
)
def test_a_wrong_table_of_groups_is_refused(tmp_path, text, message):
    good = table(tmp_path / "good.csv", {"wavelength": WAVELENGTH, "a": R})
    groups = tmp_path / "groups.csv"
    groups.write_text(text)
    with pytest.raises(InputError, match=message) as caught:
        fit_leaves([good], tmp_path / "out", groups=groups)
    assert "groups.csv" in str(caught.value)


def test_jumps_of_an_asd_are_taken_out_and_said(tmp_path):
    """An ASD whose first detector reads 4 % low gives the traits of one that does not."""
    grid = np.arange(350.0, 2501.0)
    flat = np.interp(grid, WAVELENGTH, R)
    for name, gain in (("plain", 1.0), ("drift", 0.96)):
        header = bytearray(484)
        header[:3], header[186], header[199] = b"as8", 1, 2
        struct.pack_into("<ff", header, 191, 350.0, 1.0)
        struct.pack_into("<H", header, 204, 2151)
        struct.pack_into("<ff", header, 444, 1000.0, 1830.0)
        target = np.where(grid <= 1000, gain, 1.0) * flat * 1000
        body = target.tobytes() + bytes(18) + struct.pack("<H", 0) + np.full(2151, 1e3).tobytes()
        (tmp_path / f"{name}.asd").write_bytes(bytes(header) + body)
    summary = fit_leaves([tmp_path / "plain.asd", tmp_path / "drift.asd"], tmp_path / "out")
    said = [r.repair for r in summary.repairs if r.name == "drift"]
    assert any("1000 nm: +4" in sentence and "taken out" in sentence for sentence in said)
    traits = pd.read_csv(tmp_path / "out" / "traits.csv")
    for trait in ("chlorophyll", "water", "dry_matter"):
        np.testing.assert_allclose(traits[trait][1], traits[trait][0], rtol=0.03)


def test_panel_and_detectors_of_a_table_are_stated_on_the_command_line(tmp_path, capsys):
    """A panel of 0.98 and a first detector 4 % low undone: the traits of the true spectrum."""
    edge = 1000.0
    relative = np.where(edge >= WAVELENGTH, 0.96, 1.0) * R / 0.98
    panel = table(tmp_path / "panel.csv", {"wavelength": [400, 2500], "panel": [0.98, 0.98]})
    plain = table(tmp_path / "plain.csv", {"wavelength": WAVELENGTH, "a": R})
    drift = table(tmp_path / "drift.csv", {"wavelength": WAVELENGTH, "a": relative})
    traits = {}
    for path, options in (
        (plain, []),
        (drift, ["--panel", str(panel), "--detector-changes", f"{edge:g},3000"]),
    ):
        out = tmp_path / path.stem
        with pytest.raises(SystemExit) as caught:
            main(["fit-leaf", str(path), "--output", str(out), *options])
        assert not caught.value.code, capsys.readouterr().err
        traits[path.stem] = pd.read_csv(out / "traits.csv").iloc[0]
    for trait in ("chlorophyll", "water", "dry_matter"):
        np.testing.assert_allclose(traits["drift"][trait], traits["plain"][trait], rtol=0.03)
    said = traits["drift"]["repairs"]
    for sentence in ("reflectance, 0.980 to 0.980", "1000 nm: +4", "3000 nm: too few bands"):
        assert sentence in said
    for option, value, word in (
        ("--detector-changes", "1000;1830", "1000,1830"),
        ("--detector-changes", "1830,1000", "ascend"),
        ("--panel", str(tmp_path / "none.csv"), "none.csv"),
    ):
        capsys.readouterr()
        with pytest.raises(SystemExit) as caught:
            main(["fit-leaf", str(plain), "--output", str(tmp_path / "o"), option, value])
        assert caught.value.code
        assert word in capsys.readouterr().err


def over(background):
    """Reading of `LEAF` over a background (the series of light to and fro)."""
    return R + T**2 * background / (1 - R * background)


def test_readings_over_black_and_white_give_transmittance(tmp_path):
    """Two readings of a clip identify T as a sphere does, but where the leaf is opaque."""
    dark = prospect(LeafParameters(chlorophyll=90.0))
    r, t = np.asarray(dark.reflectance), np.asarray(dark.transmittance)
    white = 0.95 - 1e-4 * (WAVELENGTH - 400) / 3
    back = table(tmp_path / "white.csv", {"wavelength": WAVELENGTH, "white": white})
    black = table(tmp_path / "b.csv", {"wavelength": WAVELENGTH, "leaf": R, "dark": r})
    bright = r + t**2 * white / (1 - r * white)
    second = table(
        tmp_path / "w.csv", {"wavelength": WAVELENGTH, "dark": bright, "leaf": over(white)}
    )
    with pytest.raises(SystemExit) as caught:
        main(["fit-leaf", str(black), "--over-background", str(second), "--background", str(back),
              "--measurement", "leaf-clip", "--output", str(tmp_path / "out")])  # fmt: skip
    assert not caught.value.code
    with xr.open_dataset(tmp_path / "out" / "spectra.nc") as data:
        got = data["measured_transmittance"].sel(wavelength=slice(450, 2390)).values
        grid = data["wavelength"].sel(wavelength=slice(450, 2390)).values
    for values, truth in zip(got, (T, t)):
        known = np.isfinite(values)
        np.testing.assert_allclose(
            values[known], np.interp(grid[known], WAVELENGTH, truth), atol=5e-3
        )
        assert np.interp(grid[~known], WAVELENGTH, truth).max(initial=0) < 0.05
    assert np.isnan(got[1]).sum() > 5
    traits = pd.read_csv(tmp_path / "out" / "traits.csv").set_index("name")
    np.testing.assert_allclose(traits.loc["leaf", "structure"], 1.5, atol=0.05)
    np.testing.assert_allclose(traits["chlorophyll"], [40.0, 90.0], rtol=0.1)
    assert "opaque for it at 8 %" in traits.loc["leaf", "repairs"]


def test_what_lies_behind_a_clip_is_told_from_the_leaf(tmp_path):
    """Over a known white face chlorophyll and water come out; taken for black they do not."""
    reading = table(tmp_path / "a.csv", {"wavelength": WAVELENGTH, "a": over(0.9)})
    fits = {}
    for behind in (0.9, None):
        fit_leaves([reading], tmp_path / "out", measurement="leaf-clip", background=behind)
        fits[behind] = pd.read_csv(tmp_path / "out" / "traits.csv").iloc[0]
    for trait, truth in (("chlorophyll", 40.0), ("water", 0.01)):
        assert abs(np.log(fits[0.9][trait] / truth)) < 0.1
        assert abs(np.log(fits[None][trait] / truth)) > 0.3
        assert fits[0.9][f"{trait}_lower90"] < truth < fits[0.9][f"{trait}_upper90"]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"background": 0.9}, "`measurement` is 'sphere'"),
        ({"background": 90, "measurement": "probe"}, "0 to 1"),
        ({"over_background": ["w.csv"], "measurement": "probe"}, "need its reflectance"),
        ({"over_background": ["w.csv"], "background": 0.9, "measurement": "probe"}, "there are 1"),
        ({"over_background": ["t.csv"], "background": 0.9, "measurement": "probe"}, "too many"),
        ({"area": "surface"}, "`area` must be one of projected, half_total"),
    ],
)
def test_options_that_do_not_go_together(tmp_path, monkeypatch, options, message):
    monkeypatch.chdir(tmp_path)
    table(tmp_path / "w.csv", {"wavelength": WAVELENGTH, "a": R})
    paths = [table(tmp_path / "t.csv", {"wavelength": WAVELENGTH, "a_R": R, "a_T": T, "b": R})]
    if options.get("over_background") == ["t.csv"]:
        options = options | {"over_background": paths}
    with pytest.raises(InputError, match=message):
        fit_leaves(paths, tmp_path / "out", **options)
    assert not (tmp_path / "out").exists()


def test_every_table_states_its_area(tmp_path):
    """Contents of round leaves per half of the surface are 2 / pi of those per projected area."""
    assert area_factors("half_total", "broad") == area_factors("projected", "needle")
    fit = leaf.fit_leaf(WAVELENGTH, np.stack([R, 0.9 * R]), leaf_shape="culm")
    flat, round_ = fit.table(), fit.table("half_total")
    assert set(flat["area"]) == {"projected"}
    assert set(round_["area"]) == {"half_total"}
    for name in ("chlorophyll", "dry_matter_sd", "water_lower90"):
        np.testing.assert_allclose(round_[name], 2 / np.pi * flat[name])
    np.testing.assert_array_equal(round_["structure_sd"], flat["structure_sd"])
    data = fit.to_xarray("half_total")
    np.testing.assert_allclose(data["carotenoids_sd"], round_["carotenoids_sd"])
    assert data.attrs["area"] == "half_total"


def test_an_unknown_panel_is_said_once(tmp_path):
    for name in "ab":
        (tmp_path / f"{name}.asd").write_bytes(asd())
    result = fit_leaves([tmp_path / "a.asd", tmp_path / "b.asd"], tmp_path / "out")
    (said,) = [warning for warning in result.warnings if "panel" in warning]
    assert "2 ASD spectra" in said
    curve = table(tmp_path / "panel.csv", {"wavelength": [500, 2500], "panel": [0.9, 0.9]})
    result = fit_leaves([tmp_path / "a.asd"], tmp_path / "out", panel=curve)
    assert not result.warnings
    assert any("150 bands beyond" in repair.repair for repair in result.repairs)


def test_water_in_milligrams_is_named_as_the_likely_slip():
    with pytest.raises(ValueError, match="mg/cm2"):
        LeafParameters(water=12.0)


SIG = """/*** Spectra Vista SIG Data ***/
name= leaf.sig
instrument= HI: 1162060 (HR-1024i)
units= Radiance, Radiance
data=
 980.0  1000.00  400.00  40.00
 990.0  1000.00  410.00  41.00
 1000.0  1000.00  900.00  90.00
 984.0  1000.00  900.00  90.00
 994.0  1000.00  420.00  42.00
 1004.0  1000.00  430.00  43.00
"""
SED = """Comment: leaf
Instrument: PSR-3500_SN1566060 [3]
Measurement: REFLECTANCE
Columns [4]:
Data:
Wvl\tNorm. DN (Ref.)\tNorm. DN (Target)\tReflect. %
 350.0\t7.5E+0\t3.0E-1\t4.0
 351.0\t7.5E+0\t3.0E-1\t5.0
"""


def test_overlapping_detectors_of_svc_are_cut_in_the_middle(tmp_path):
    (tmp_path / "leaf.sig").write_text(SIG)
    (spectrum,) = read_spectra_file(tmp_path / "leaf.sig")
    np.testing.assert_allclose(spectrum.wavelength, [980.0, 990.0, 994.0, 1004.0])
    np.testing.assert_allclose(spectrum.reflectance, [0.40, 0.41, 0.42, 0.43])
    assert spectrum.meta["splices"] == [992.0]
    assert "overlap" in spectrum.meta["repairs"][1]


def test_spectral_evolution_gives_its_reflectance(tmp_path):
    (tmp_path / "leaf.sed").write_text(SED)
    (spectrum,) = read_spectra_file(tmp_path / "leaf.sed")
    np.testing.assert_allclose(spectrum.reflectance, [0.04, 0.05])
    (tmp_path / "leaf.sed").write_text(SED.replace("Reflect. %", "Rad. (Other)"))
    (spectrum,) = read_spectra_file(tmp_path / "leaf.sed")
    np.testing.assert_allclose(spectrum.reflectance, 0.3 / 7.5)
    assert spectrum.meta["repairs"] == ["reflectance formed as target over white reference"]
    (tmp_path / "leaf.sed").write_text(
        SED.replace("Reflect. %", "Rad. (Other)").replace("DN (Ref.)", "DN (Sky)")
    )
    with pytest.raises(InputError, match="no column of reflectance"):
        read_spectra_file(tmp_path / "leaf.sed")
    (tmp_path / "short.sig").write_text(SIG.replace("  43.00", ""))
    with pytest.raises(InputError, match=r"short\.sig, row 11: expected 4 cells"):
        read_spectra_file(tmp_path / "short.sig")


def test_conversion_keeps_every_value_and_says_what_was_refused(tmp_path):
    folder = tmp_path / "campaign" / "day 1"
    folder.mkdir(parents=True)
    (folder / "50% shade.asd").write_bytes(asd(count=3, start=978.0))
    for name in ("leaf.sig", "leaf.txt"):
        (folder / name).write_text(SIG)
    (folder / "notes.txt").write_text("rain after noon\n")
    table(folder / "pair.csv", {"nm": [980, 990], "oak R 3_T": [0.2, 0.3], "oak R 3_R": [0.5, 0.4]})
    result = convert([tmp_path / "campaign"], tmp_path / "out")
    assert (result.spectra, result.bands) == (4, 6)
    assert [r.file for r in result.refused] == [str(folder / "notes.txt")]
    nc = xr.load_dataset(tmp_path / "out" / "spectra.nc")
    assert list(nc.spectrum.values) == ["50% shade", "leaf", "leaf_2", "oak R 3"]
    assert nc.reflectance.attrs["units"] == "1"
    assert nc.wavelength.attrs["standard_name"] == "radiation_wavelength"
    assert "HR-1024i" in nc.header.values[1]
    again = read_spectra_file(tmp_path / "out" / "spectra.csv")
    assert [s.name for s in again] == ["50pct shade", "leaf", "leaf_2", "oak R 3"]
    for spectrum, reflectance in zip(again, nc.reflectance.values, strict=True):
        np.testing.assert_allclose(spectrum.reflectance, reflectance, rtol=1e-6)
    np.testing.assert_allclose(again[3].transmittance, nc.transmittance.values[3], rtol=1e-6)


def test_reflectance_and_transmittance_in_two_files_are_one_leaf(shared_data, tmp_path):
    folder = shared_data / "field" / "07_sphere-R-and-T-as-two-files"
    with pytest.warns(UserWarning, match="white panel"):
        spectra = fx.read_spectra([folder / "oak01_R.asd", folder / "oak01_T.asd"])
    pair = pd.read_csv(folder / "pair.csv")
    for quantity, mark in (("reflectance", "R"), ("transmittance", "T")):
        np.testing.assert_allclose(spectra[quantity].values[0], pair[f"oak01_{mark}"], atol=1e-3)
    assert spectra["spectrum"].values.tolist() == ["oak01"]
    assert "transmittance from oak01_T.asd" in spectra["repairs"].item()


@pytest.mark.parametrize(
    ("first", "second", "through"),
    [
        ("oak_R.csv", "oak_T.csv", True),
        ("R_oak.csv", "T_oak.csv", True),
        ("oak-refl-3.csv", "oak-trans-3.csv", True),
        ("oak_R00004.csv", "oak_T00004.csv", True),
        ("oak reflectance.csv", "OAK transmittance.csv", True),
        ("reflectance/oak.csv", "transmittance/oak.csv", True),
        ("oak.csv", "oak_tran.csv", True),
        ("oak_R.csv", "elm_T.csv", False),
        ("oak_R1.csv", "oak_T2.csv", False),
        ("LEAF01R.csv", "LEAF01T.csv", True),
        ("leaf1r.csv", "leaf1t.csv", True),
        ("leaf1R.csv", "leaf2T.csv", False),
        ("oar.csv", "oat.csv", False),
        ("oakR.csv", "oakT.csv", True),
        ("oak_R1.csv", "oak_T1.csv", True),
        ("oak_rfl_1.csv", "oak_trn_1.csv", True),
        ("oak_réflexion.csv", "oak_transmission.csv", True),
        ("oak_Rs.csv", "oak_Ts.csv", True),
        ("Rs_oak.csv", "Ts_oak.csv", True),
        ("oak_R.csv", "oak_T2.csv", True),
        ("oak_R2.csv", "oak_T.csv", True),
        ("oak_Res.csv", "oak_Tes.csv", False),
    ],
)
def test_names_that_make_a_pair(first, second, through, tmp_path):
    for name, level in ((first, 0.4), (second, 0.3)):
        path = tmp_path / "leaves" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(f"500,{level}\n600,{level}\n")
    doubted = second == "oak_T2.csv" and not through
    with pytest.warns(UserWarning, match="beside 'oak_R1'") if doubted else nullcontext():
        spectra = fx.read_spectra(tmp_path / "leaves")
    assert spectra.sizes["spectrum"] == (1 if through else 2)
    if through:
        np.testing.assert_allclose(spectra["reflectance"], 0.4)
        np.testing.assert_allclose(spectra["transmittance"], 0.3)


def test_a_transmittance_without_its_reflectance_is_doubted(tmp_path):
    (tmp_path / "elm_T.sed").write_text(SED)
    with pytest.warns(UserWarning, match=r"elm_T\.sed: the name is that of a transmittance"):
        assert "transmittance" not in fx.read_spectra(tmp_path)
    (tmp_path / "elm_T.sed").rename(tmp_path / "elm_trans.sed")
    assert "reflectance" not in fx.read_spectra(tmp_path)


def test_leaves_called_r1_and_t1_are_doubted(tmp_path):
    (tmp_path / "leaves.csv").write_text("nm,R1,T1,T2\n500,0.4,0.3,0.2\n600,0.4,0.3,0.2\n")
    with pytest.warns(
        UserWarning, match=r"leaves\.csv: .*the transmittance of R1, end names in _T"
    ):
        assert fx.read_spectra(tmp_path).sizes["spectrum"] == 3


@pytest.mark.parametrize(
    ("names", "count", "said"),
    [
        (("oak_Rs", "oak_Ts"), 1, ""),
        (("oak_R", "oak_T2"), 1, ""),
        (("oak_R1", "oak_T2"), 2, "'oak_T2' beside 'oak_R1' may be a transmittance"),
        (("oak_R", "oak_T2", "oak_T3"), 3, r"'oak_T\d' beside 'oak' may be a transmittance"),
        (("oak_T1", "oak_T2"), 2, ""),
        (("oak 1", "oak_2", "oak mean"), 3, "'oak mean' is a mean of 'oak 1', 'oak_2'"),
        (("oakley 1", "oak mean"), 2, ""),
    ],
)
def test_columns_are_paired_or_doubted_by_their_names(names, count, said, tmp_path):
    table(tmp_path / "a.csv", {"nm": [500, 600], **{name: [0.4, 0.3] for name in names}})
    with pytest.warns(UserWarning, match=said) if said else nullcontext():
        assert fx.read_spectra(tmp_path).sizes["spectrum"] == count


def test_values_tell_transmittance_and_absorptance_that_no_name_tells(shared_data, tmp_path):
    with np.load(shared_data / "leaf" / "lopex_spectra.npz") as leaves:
        waves, through, back = leaves["wl"], leaves["tran"][4, 0], leaves["refl"][4, 0]
    for name, values in (("00012", back), ("00013", through)):
        table(tmp_path / f"{name}.csv", {"wavelength": waves, name: values})
    with pytest.warns(UserWarning, match="of '00013' is 0.009 at 450 nm") as said:
        fx.read_spectra(tmp_path)
    assert len(said) == 1
    path = table(tmp_path / "a.csv", {"nm": waves, "oak_A": 1 - through - back})
    with pytest.raises(InputError, match=r"'oak_A' is another quantity: .*as absorptance"):
        fx.read_spectra(path)


@pytest.mark.parametrize("waves", [np.arange(4000, 25001, 500), np.arange(3500, 25001, 500)])
def test_wavelengths_in_no_unit_beyond_all_sensors_are_refused(waves, tmp_path):
    path = table(tmp_path / "a.csv", {"wavelength": waves, "oak": np.full(len(waves), 0.3)})
    with pytest.raises(InputError, match=r"a\.csv.*wave numbers or ångström\? Write 'cm-1'"):
        fx.read_spectra(path)
    with pytest.raises(InputError, match="a fit needs bands within 450-2400 nm"):
        fx.fit_leaf(waves.astype(float), np.full(len(waves), 0.3))


def test_transmittance_is_stated(tmp_path):
    for name, level in (("a.csv", 0.4), ("b.csv", 0.5), ("x.csv", 0.3), ("y.csv", 0.2)):
        (tmp_path / name).write_text(f"500,{level}\n600,{level}\n")
    paths = [[tmp_path / f"{name}.csv" for name in pair] for pair in ("ab", "xy")]
    spectra = fx.read_spectra(paths[0], transmittance=paths[1])
    np.testing.assert_allclose(spectra["transmittance"].values[:, 0], [0.3, 0.2])
    np.testing.assert_allclose(spectra["reflectance"].values[:, 0], [0.4, 0.5])
    with pytest.raises(InputError, match="of 2 leaves there are 1"):
        fx.read_spectra(paths[0], transmittance=paths[1][:1])


def test_bands_of_a_saturated_detector_are_missing(shared_data, tmp_path):
    path = shared_data / "field" / "06_saturated-scan" / "asd_swir1_saturated.asd"
    (spectrum,) = read_spectra_file(path)
    missing = spectrum.wavelength[np.isnan(spectrum.reflectance)]
    assert (missing.min(), missing.max()) == (1001.0, 1800.0)
    content = bytearray(path.read_bytes())
    for flag, low, high in ((1, 350.0, 1000.0), (4, 1801.0, 2500.0), (5, 350.0, 2500.0), (0, 0, 0)):
        content[422] = flag
        (tmp_path / "a.asd").write_bytes(content)
        (spectrum,) = read_spectra_file(tmp_path / "a.asd")
        missing = spectrum.wavelength[np.isnan(spectrum.reflectance)]
        assert not flag or (missing.min(), missing.max()) == (low, high)
        assert bool(missing.size) == bool(flag)
    content[422] = 16
    (tmp_path / "a.asd").write_bytes(content)
    (spectrum,) = read_spectra_file(tmp_path / "a.asd")
    assert np.isfinite(spectrum.reflectance).all()
    assert "cooling of the SWIR 2" in spectrum.meta["repairs"][-1]


@pytest.mark.parametrize(("error", "said"), [("7, 0", False), ("6, 2", True), ("0,7", True)])
def test_svc_errors_of_the_target_are_said(error, said, tmp_path):
    (tmp_path / "leaf.sig").write_text(SIG.replace("units=", f"error= {error}\nunits="))
    (spectrum,) = read_spectra_file(tmp_path / "leaf.sig")
    assert any("error" in sentence for sentence in spectrum.meta["repairs"]) == said


def test_the_overlap_of_detectors_tells_their_jump(shared_data):
    folder = shared_data / "field" / "02_svc-overlap-vs-maker"
    got = {}
    for name in ("syn_clean", "syn_clean_nooverlap", "syn_swir2_offset_+0.003"):
        spectra = fx.read_spectra(folder / f"{name}.sig")
        got[name] = spectra["reflectance"].values[0], spectra["repairs"].item()
        assert "taken out" not in got[name][1]
    assert "since an offset would look like it" in got["syn_swir2_offset_+0.003"][1]
    # What was measured stays: only the third detector is above the clean leaf, by the offset.
    above = got["syn_swir2_offset_+0.003"][0] - got["syn_clean"][0]
    assert set(np.round(above[np.isfinite(above)], 4)) == {0.0, 0.003}


def test_a_measured_jump_goes_before_that_of_the_lines():
    grid = np.arange(900.0, 1201.0)
    values, jumps = correct_detector_jumps(grid, np.full(grid.size, 0.4), [1000.0], [0.05])
    assert jumps == pytest.approx([0.05])
    np.testing.assert_allclose(values, np.where(grid <= 1000.0, 0.42, 0.4))


def test_a_gain_of_the_overlap_is_taken_out(tmp_path):
    """A leaf with a slope and a gain of 5 % of its second detector: the lines beside the cut would
    give another one."""
    first, second = np.arange(900.0, 1011.0, 1.5), np.arange(970.0, 1200.0, 4.0)
    level = lambda w: 40.0 + 0.05 * (w - 990.0) + 4e-4 * (w - 990.0) ** 2  # noqa: E731
    rows = [(w, level(w)) for w in first] + [(w, 1.05 * level(w)) for w in second]
    lines = SIG.splitlines()[:5] + [f"{w:.1f}  100.0  100.0  {v:.4f}" for w, v in rows]
    (tmp_path / "leaf.sig").write_text("\n".join(lines))
    spectra = fx.read_spectra(tmp_path / "leaf.sig")
    assert "+5.0 %, taken out" in spectra["repairs"].item()
    grid, values = spectra["wavelength"].values, spectra["reflectance"].values[0]
    gain = values / (level(grid) / 100.0)
    assert np.ptp(gain) < 1e-3


def test_a_text_export_is_treated_as_its_binary_is(shared_data, tmp_path):
    names = ("enmap_ribb00005", "kai_v7sample__v7sample00004", "serbin_PM01_TIAM_B_LC_REFL00005")
    for name in names:
        path = shared_data / "leaf" / "asd" / f"{name}.asd"
        (spectrum,) = read_spectra_file(path)
        values = spectrum.reflectance
        if name.startswith("serbin"):  # a jump of 8 % of the first detector
            values = np.where(spectrum.wavelength <= 1000.0, 0.92 * values, values)
        text = tmp_path / f"{name}.txt"
        rows = (f"{w:g}\t{v:.8f}\n" for w, v in zip(spectrum.wavelength, values, strict=True))
        text.write_text("Wavelength\tleaf\n" + "".join(rows))
        out = fx.read_spectra(text)["reflectance"].values[0]
        binary, _ = correct_detector_jumps(spectrum.wavelength, values, spectrum.meta["splices"])
        good = np.isfinite(out) & np.isfinite(binary) & (spectrum.wavelength > 420.0)
        np.testing.assert_allclose(out[good], binary[good], rtol=0.012, atol=1e-3)


@pytest.mark.parametrize(
    ("steps", "found"),
    [
        ({1000.0: 1.04}, "at 1000 nm"),
        ({1830.0: 1.04}, "at 1830 nm"),
        ({1800.0: 1.04, 1830.0: 1.01}, "at 1800 nm"),
        ({1000.0: 1.3}, ""),
        ({1000.0: 1.02, 976.0: 1.03}, ""),
        ({1000.0: 1.02, 964.0: 0.98}, ""),
        ({1000.0: 1.04, 976.0: 1.02}, ""),
    ],
)
def test_only_a_step_that_stands_out_is_one_of_detectors(steps, found, tmp_path):
    grid = np.arange(350.0, 2501.0)
    values = np.full(grid.size, 0.4) - 1e-5 * (grid - 350.0)
    for last, factor in steps.items():
        values[grid > last] *= factor
    table(tmp_path / "leaf.csv", {"wavelength": grid, "leaf": values})
    repairs = fx.read_spectra(tmp_path / "leaf.csv")["repairs"].item()
    assert found in repairs
    assert ("step of its detectors" in repairs) == bool(found)


def test_a_smooth_leaf_on_the_bands_of_an_asd_has_no_jump(shared_data):
    pair = shared_data / "field" / "07_sphere-R-and-T-as-two-files" / "pair.csv"
    assert fx.read_spectra(pair)["repairs"].item() == ""


def test_plants_numbered_like_percentiles_are_leaves(tmp_path):
    waves = [500.0, 600.0, 700.0]
    leaf = [0.1, 0.2, 0.3]
    path = tmp_path / "plants.csv"
    for names, left_out in (
        (("P1", "P2", "P3", "E1"), ()),
        (("P1", "P2", "mean"), ("mean",)),
        (("oak", "P5", "P50", "P95"), ("P5", "P50", "P95")),
    ):
        table(path, {"wavelength": waves} | dict.fromkeys(names, leaf))
        with pytest.warns(UserWarning, match="no leaves") if left_out else nullcontext():
            spectra = fx.read_spectra(path)
        assert spectra["spectrum"].values.tolist() == [n for n in names if n not in left_out]


@pytest.mark.parametrize("column", ["value", "oak"])
def test_files_marked_for_columns_without_marks_make_a_pair(column, tmp_path):
    waves = [500.0, 600.0, 700.0]
    files = tmp_path / "oak01refl.csv", tmp_path / "oak01trans.csv"
    table(files[0], {"wavelength": waves, column: [0.1, 0.2, 0.3]})
    table(files[1], {"wavelength": waves, column: [0.2, 0.3, 0.4]})
    spectra = fx.read_spectra(files)
    np.testing.assert_allclose(spectra["transmittance"], [[0.2, 0.3, 0.4]])
    np.testing.assert_allclose(spectra["reflectance"], [[0.1, 0.2, 0.3]])


def test_wave_numbers_and_angstrom_become_nanometres(tmp_path):
    for name, waves in (("Wavenumber [cm-1]", [2e4, 1e4]), ("wavelength (Å)", [5e3, 1e4])):
        table(tmp_path / "leaves.csv", {name: waves, "oak": [0.1, 0.2]})
        spectra = fx.read_spectra(tmp_path)
        np.testing.assert_allclose(spectra["wavelength"], [500.0, 1000.0])
        np.testing.assert_allclose(spectra["reflectance"], [[0.1, 0.2]])


def test_other_quantities_are_no_reflectance(tmp_path):
    path, waves, leaf = tmp_path / "leaves.csv", [500.0, 600.0], [0.1, 0.2]
    for name in ("Absorptance", "radiance", "oak log(1/R)"):
        table(path, {"wavelength": waves, name: leaf})
        with pytest.raises(InputError, match=rf"leaves\.csv.*{re.escape(repr(name))} is another"):
            fx.read_spectra(path)
    table(path, {"wavelength": waves, "oak R": leaf, "oak T": leaf, "oak A": [0.8, 0.6]})
    with pytest.warns(UserWarning, match="no leaves: 'oak A'"):
        assert fx.read_spectra(path)["spectrum"].values.tolist() == ["oak"]


@pytest.mark.parametrize(("column", "words", "count"), [
    ("quantity", ("Reflectance", "Transmittance"), 1), ("type", ("tree", "tussock"), 2),
])  # fmt: skip
def test_cells_say_whether_a_row_is_transmittance(column, words, count, tmp_path):
    waves = [str(wave) for wave in range(500, 600, 10)]
    rows = [["oak", words[0], *["0.1"] * 10], ["oak", words[1], *["0.2"] * 10]]
    pd.DataFrame(rows, columns=["name", column, *waves]).to_csv(tmp_path / "a.csv", index=False)
    spectra = fx.read_spectra(tmp_path)
    assert spectra.sizes["spectrum"] == count
    assert ("transmittance" in spectra) == (count == 1)


def test_columns_that_are_no_leaves_are_left_out_with_a_word(tmp_path):
    path = tmp_path / "leaves.csv"
    waves = [500.0, 600.0, 700.0]
    for name in (
        "Standard Deviation", "mean", "leaf SD", "oak_std", "SE", "Std. Error", "median", "Max",
        "n", "Mean ± SD", "CV", "variance", "q95", "Standardabweichung", "écart-type", "σ",
        "SE(mean)", "white reference", "uncertainty",
    ):  # fmt: skip
        table(path, {"wavelength": waves, "oak": [0.1, 0.2, 0.3], name: [0.01, 0.01, 0.02]})
        with pytest.warns(UserWarning, match=f"no leaves: '{re.escape(name)}'"):
            spectra = fx.read_spectra(path)
        assert spectra["spectrum"].values.tolist() == ["oak"]
    for copy in (waves, [w / 1e3 for w in waves]):
        table(path, {"wavelength": waves, "oak": [0.1, 0.2, 0.3], "lambda 2": copy})
        with pytest.warns(UserWarning, match="no leaves: 'lambda 2'"):
            fx.read_spectra(path)
    for name in ("mean", "Seriphium", "Standardia", "max_height_oak", "Nsd1"):
        table(path, {"wavelength": waves, name: [0.1, 0.2, 0.3]})
        assert fx.read_spectra(path).sizes["spectrum"] == 1

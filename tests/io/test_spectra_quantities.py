"""What a file of spectra says that its numbers are: quantity, scale, unit, gaps and layout."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import fynjax as fx
from fynjax._core.errors import InputError
from fynjax.app.io.spectra import read_spectra_file
from fynjax.app.io.spectra._record import MeasuredSpectrum
from tests.io.test_spectra import SED, SIG
from tests.io.test_spectra_layout import LEAVES, WAVES, check, columns, rows

LEAF = LEAVES[0]
LINES = [f"{w:g}\t{v:.6f}" for w, v in zip(WAVES, LEAF, strict=True)]


def table(path: Path, named: dict[str, np.ndarray], first: str = "wavelength") -> Path:
    pd.DataFrame({first: WAVES, **named}).to_csv(path, index=False)
    return path


def read(path: Path, text: str | bytes, name: str = "leaf.txt") -> MeasuredSpectrum:
    (path / name).write_bytes(text if isinstance(text, bytes) else text.encode())
    (spectrum,) = read_spectra_file(path / name)
    return spectrum


def of(spectrum: MeasuredSpectrum) -> np.ndarray:
    assert spectrum.reflectance is not None
    return spectrum.reflectance


def is_leaf(spectrum: MeasuredSpectrum, through: bool = False, atol: float = 1e-6) -> None:
    found, other = spectrum.reflectance, spectrum.transmittance
    found, other = (other, found) if through else (found, other)
    assert other is None
    assert found is not None
    np.testing.assert_allclose(found, LEAF, atol=atol)


# -- layout --------------------------------------------------------------------------------------


@pytest.mark.parametrize("first", ["Leaf", "Sample", "ID", ""])
@pytest.mark.parametrize("numbers", [(300, 5), (400, 100)])
def test_a_word_in_the_corner_turns_no_table_over(
    tmp_path: Path, first: str, numbers: tuple[int, int]
) -> None:
    """Leaves are numbered 300 to 355, or 400 to 1500, and wavelengths run from 400 to 2400."""
    start, step = numbers
    names = [str(start + step * k) for k in range(12)]
    path = columns(tmp_path / "a.csv", names, first)
    check(path)
    assert "not 12 names of columns" in read_spectra_file(path)[0].meta["repairs"][0]


def test_rows_whose_numbers_may_be_wavelengths_are_said(tmp_path: Path) -> None:
    path = rows(tmp_path / "a.csv", names=list(range(401, 413)))
    check(path)
    (said,) = read_spectra_file(path)[0].meta["repairs"]
    assert said.startswith("taken as a row a spectrum: 101 names")
    assert said.endswith("numbers of samples")


def test_reflectance_and_transmittance_of_a_row(tmp_path: Path) -> None:
    both = {f"R{w:g}": 100 * LEAVES[:2, k] for k, w in enumerate(WAVES)}
    both |= {f"T{w:g}": 10 * LEAVES[:2, k] for k, w in enumerate(WAVES)}
    pd.DataFrame({"ID": ["oak", "elm"], **both}).to_csv(tmp_path / "a.csv", index=False)
    for spectrum, leaf in zip(read_spectra_file(tmp_path / "a.csv"), LEAVES, strict=False):
        np.testing.assert_allclose(of(spectrum), leaf)
        np.testing.assert_allclose(np.array(spectrum.transmittance), 0.1 * leaf)

    alone = pd.DataFrame(LEAVES[:1], columns=[f"T{w:g}" for w in WAVES])
    alone.to_csv(tmp_path / "b.csv", index=False)
    is_leaf(read_spectra_file(tmp_path / "b.csv")[0], through=True)
    other = pd.DataFrame(LEAVES[:1], columns=[f"R{w + 1:g}" for w in WAVES])
    alone.join(other).to_csv(tmp_path / "b.csv", index=False)
    with pytest.raises(InputError, match="at the same wavelengths, but of 202 only 101"):
        read_spectra_file(tmp_path / "b.csv")


@pytest.mark.parametrize("order", ["sample", "wavelength"])
@pytest.mark.parametrize("through", [False, True])
def test_long_tables(tmp_path: Path, order: str, through: bool) -> None:
    wide = pd.DataFrame(LEAVES[:3].T, columns=["oak", "elm", "ash"], index=WAVES)
    long = wide.rename_axis("wavelength").reset_index()
    long = long.melt("wavelength", var_name="sample", value_name="reflectance")
    if through:
        long["transmittance"] = 0.5 * long["reflectance"]
    long = long.sort_values(order, kind="stable")
    long.to_csv(tmp_path / "a.csv", index=False)
    found = {one.name: one for one in read_spectra_file(tmp_path / "a.csv")}
    assert set(found) == set(wide)
    for name, one in found.items():
        np.testing.assert_allclose(of(one), wide[name])
        if through:
            np.testing.assert_allclose(np.array(one.transmittance), 0.5 * wide[name])
    long[long["sample"] == "oak"].to_csv(tmp_path / "a.csv", index=False)
    assert [one.name for one in read_spectra_file(tmp_path / "a.csv")] == ["oak"]
    pd.concat([long, long[:1]]).to_csv(tmp_path / "a.csv", index=False)
    with pytest.raises(
        InputError, match=r"one value of each sample at each wavelength.*is there twice"
    ):
        read_spectra_file(tmp_path / "a.csv")


def test_a_row_of_numbers_below_the_header_takes_no_names_away(tmp_path: Path) -> None:
    cells = "\n".join(line.replace("\t", ",") + ",0.5" for line in LINES)
    (tmp_path / "a.csv").write_text(f"wavelength,oak,panel 2\nplot,1,2\n{cells}\n")
    assert [one.name for one in read_spectra_file(tmp_path / "a.csv")] == ["oak", "panel 2"]


# -- quantity ------------------------------------------------------------------------------------

OCEAN = "Data from leaf_{}_0_0001.txt Node\n\nDate: x\n>>>>>Begin Spectral Data<<<<<\n"


@pytest.mark.parametrize(
    ("name", "head"),
    [
        ("a.txt", "Wavelength\tleaf00001.asd.rad\n"),
        ("a.txt", "Text of a.000\nSpectrum file is radiance data\n\nWavelength\ta\n"),
        ("a.txt", "Name: Leaf\nX Units: Wavelength (nanometers)\nY Units: Emissivity\n\n"),
        ("a.txt", OCEAN.format("Absorbance")),
        ("a.txt", OCEAN.format("AbsoluteIrradiance")),
        ("a.irr", "wavelength\tleaf\n"),
        ("a.txt", "TITLE\tleaf\nYUNITS\tABSORBANCE\nXYDATA\n"),
        ("a.jdx", "##TITLE=leaf\n##XUNITS=NANOMETERS\n##YUNITS=ABSORBANCE\n##XYPOINTS=(XY..XY)\n"),
        ("a.txt", "Wavelength\tL_target\n"),
        ("a.txt", "Wavelength\tleaf continuum removed\n"),
    ],
)  # fmt: skip
def test_other_quantities_are_refused(tmp_path: Path, name: str, head: str) -> None:
    with pytest.raises(
        InputError, match=r"expected reflectance or transmittance.*another quantity"
    ):
        read(tmp_path, head + "\n".join(LINES) + "\n", name)


@pytest.mark.parametrize(
    ("name", "head"),
    [
        ("a.txt", OCEAN.format("Transmission")),
        ("a.trm", "wavelength\tleaf\n"),
        ("a.txt", '"EPP2000C UV-VIS transmission"\nInt:10ms Avg:5\n'),
        ("a.txt", "Transmittance of leaf A (integrating sphere)\nwavelength\tvalue\n"),
        ("a.txt", "Name: Leaf\nX Units: Wavelength (nanometers)\nY Units: Transmittance\n\n"),
        ("a.jdx", "##TITLE=a\n##XUNITS=NM\n##YUNITS=TRANSMITTANCE\n##XYPOINTS=(XY..XY)\n"),
    ],
)  # fmt: skip
def test_transmittance_is_known_by_what_the_file_says(tmp_path: Path, name: str, head: str) -> None:
    is_leaf(read(tmp_path, head + "\n".join(LINES) + "\n", name), through=True)


def test_a_statement_of_transmittance_goes_before_the_name_of_a_column(tmp_path: Path) -> None:
    stated = SED.replace("REFLECTANCE", "TRANSMITTANCE")
    assert read(tmp_path, stated, "leaf.sed").reflectance is None


@pytest.mark.parametrize(
    "names", [["fwhm_um"], ["oak_lower", "oak_upper"], ["L_target", "E_down"],
              ["continuum removed", "first derivative"], ["oak R+T"], ["oak_min", "oak_max"]],
)  # fmt: skip
def test_columns_beside_a_leaf_are_left_out(tmp_path: Path, names: list[str]) -> None:
    path = table(tmp_path / "stderr.csv", {"oak": LEAF, **dict.fromkeys(names, 0.3 + 0.1 * LEAF)})
    with pytest.warns(UserWarning, match="no leaves: .*" + names[-1].replace("+", ".")):
        assert fx.read_spectra(path)["spectrum"].values.tolist() == ["oak"]


def test_a_files_name_is_that_of_no_column(tmp_path: Path) -> None:
    path = table(tmp_path / "leaf_stderr.csv", {"Réflectance": LEAF, "Écart-type": 0.1 * LEAF})
    is_leaf(read_spectra_file(path)[0])
    assert len(read_spectra_file(path)) == 1


def test_bounds_beside_a_mean_are_left_out(tmp_path: Path) -> None:
    named = {"mean": LEAF, "min": 0.9 * LEAF, "max": 1.1 * LEAF}
    assert [s.name for s in read_spectra_file(table(tmp_path / "a.csv", named))] == ["mean"]
    assert len(read_spectra_file(table(tmp_path / "a.csv", {"oak_upper": LEAF}))) == 1


def test_target_and_white_reference_are_no_leaves_but_their_ratio(tmp_path: Path) -> None:
    raw = {"target": 0.2 * LEAF + 0.01, "White reference": np.full(WAVES.shape, 0.21)}
    (spectrum,) = read_spectra_file(table(tmp_path / "a.csv", {**raw, "dark": 0.01 + 0 * LEAF}))
    is_leaf(spectrum)
    assert any("over the white reference" in said for said in spectrum.meta["repairs"])
    (spectrum,) = read_spectra_file(table(tmp_path / "a.csv", {**raw, "reflectance": LEAF}))
    is_leaf(spectrum)


def test_leaves_called_as_raw_columns_or_signs_are(tmp_path: Path) -> None:
    for names in (["Sample", "Reference site"], ["Pinus rad", "E oak"], ["emission", "hull A"]):
        path = table(tmp_path / "a.csv", dict(zip(names, LEAVES, strict=False)))
        assert [one.name for one in read_spectra_file(path)] == names


def test_a_files_name_of_another_quantity_is_a_doubt(tmp_path: Path) -> None:
    table(tmp_path / "leaf_radiance.csv", {"oak": LEAF})
    with pytest.warns(UserWarning, match="name of the file says 'radiance'"):
        fx.read_spectra(tmp_path / "leaf_radiance.csv")


@pytest.mark.parametrize(
    ("first", "of"),
    [("THz", 299_792.458), ("Frequency (THz)", 299_792.458), ("Energy (eV)", 1239.841984)],
)
def test_frequencies_become_wavelengths(tmp_path: Path, first: str, of: float) -> None:
    pd.DataFrame({first: of / WAVES, "oak": LEAF}).to_csv(tmp_path / "a.csv", index=False)
    (spectrum,) = read_spectra_file(tmp_path / "a.csv")
    np.testing.assert_allclose(spectrum.wavelength, WAVES)
    is_leaf(spectrum)
    with pytest.raises(InputError, match="but the header says 'Frequency'"):
        read_spectra_file(table(tmp_path / "a.csv", {"oak": LEAF}, "Frequency"))


# -- gaps and scales -------------------------------------------------------------------------------


def library(path: Path, values: np.ndarray, more: str = "") -> MeasuredSpectrum:
    values.astype("<f4").tofile(path / "lib.sli")
    (path / "lib.hdr").write_text(
        f"ENVI\nsamples = {WAVES.size}\nlines = 1\nbands = 1\ndata type = 4\nbyte order = 0\n"
        "file type = ENVI Spectral Library\nwavelength units = Nanometers\n"
        f"wavelength = {{{', '.join(map(str, WAVES))}}}\n{more}"
    )
    (spectrum,) = read_spectra_file(path / "lib.hdr")
    return spectrum


@pytest.mark.parametrize(
    ("mark", "scale"),
    [
        (-32768, 1.0),
        (-1, 1.0),
        (-99, 1.0),
        (-999.9, 1.0),
        (65535, 1.0),
        (-999, 100.0),
        (-9999, 1e4),
    ],
)
def test_marks_of_no_value_are_missing_in_water_bands_too(
    tmp_path: Path, mark: float, scale: float
) -> None:
    wet = (WAVES >= 1340.0) & (WAVES <= 1420.0)
    for made in (np.where(wet, mark, np.round(scale * LEAF, 0 if scale > 100.0 else 6)),):
        wide = pd.DataFrame([made], columns=[f"{w:g}" for w in WAVES])
        wide.insert(0, "ID", ["oak"])
        wide.to_csv(tmp_path / "wide.csv", index=False)
        for spectrum in (
            read_spectra_file(table(tmp_path / "a.csv", {"oak": made}))[0],
            read_spectra_file(tmp_path / "wide.csv")[0],
            library(tmp_path, made),
        ):
            expected = np.where(wet, np.nan, LEAF)
            np.testing.assert_allclose(of(spectrum), expected, atol=1e-4)
    if mark not in (-999, -9999):  # words of a table that always stood for none
        assert f"5 values of {mark} taken for missing, which they mark" in spectrum.meta["repairs"]


def test_percent_below_zero_is_no_mark(tmp_path: Path) -> None:
    made = np.where(WAVES == 1400.0, -1.0, 100.0 * LEAF)
    (spectrum,) = read_spectra_file(table(tmp_path / "a.csv", {"oak": made}))
    assert of(spectrum)[WAVES == 1400.0] == pytest.approx(-0.01)


def test_bad_bands_of_a_library_are_missing(tmp_path: Path) -> None:
    wet = (WAVES >= 1340.0) & (WAVES <= 1420.0)
    more = f"bbl = {{{', '.join(str(int(not bad)) for bad in wet)}}}\n"
    found = library(tmp_path, np.where(wet, 0.0, LEAF), more)
    np.testing.assert_allclose(of(found), np.where(wet, np.nan, LEAF), rtol=1e-6)
    more = "z plot titles = {Wavelength, Transmittance}\n"
    assert library(tmp_path, LEAF, more).reflectance is None


@pytest.mark.parametrize(("scale", "said"), [(100.0, "percent"), (1e4, "reflectance times 10000")])
def test_one_rule_of_scales(tmp_path: Path, scale: float, said: str) -> None:
    made = np.round(scale * LEAF)
    wide = pd.DataFrame([made], columns=[f"{w:g}" for w in WAVES])
    wide.to_csv(tmp_path / "wide.csv", index=False)
    for spectrum in (
        read_spectra_file(table(tmp_path / "a.csv", {"oak": made}))[0],
        read_spectra_file(tmp_path / "wide.csv")[0],
        library(tmp_path, made),
    ):
        is_leaf(spectrum, atol=0.51 / scale)
        assert any(f"converted from {said}" in one for one in spectrum.meta["repairs"])
    named = {"oak (x10000)": 1e4 * LEAF}
    is_leaf(read_spectra_file(table(tmp_path / "a.csv", named))[0])


@pytest.mark.parametrize("factor", [255.0, 1000.0, 3e4, 4096.5])
def test_no_other_scale_is_guessed(tmp_path: Path, factor: float) -> None:
    counts = np.round(factor * LEAF) if factor != 4096.5 else factor * LEAF
    with pytest.raises(InputError, match="is it in percent, or times 10000"):
        read_spectra_file(table(tmp_path / "a.csv", {"oak": counts}))
    with pytest.raises(InputError, match="is it in percent, or times 10000"):
        read_spectra_file(table(tmp_path / "a.csv", {"oak.asd": np.round(9000 * LEAF)}))


# -- instruments ---------------------------------------------------------------------------------


@pytest.mark.parametrize("before", [b"\xef\xbb\xbf", b"\n", b"\n\n", "utf-16"])
@pytest.mark.parametrize(("text", "name"), [(SIG, "leaf.sig"), (SED, "leaf.sed")])
def test_marks_and_blank_lines_before_a_file(
    tmp_path: Path, before: bytes | str, text: str, name: str
) -> None:
    plain = read(tmp_path, text, name)
    data = text.encode(before) if isinstance(before, str) else before + text.encode()
    np.testing.assert_array_equal(of(read(tmp_path, data, name)), of(plain))


def test_cary_has_a_title_over_each_pair_and_a_log(tmp_path: Path) -> None:
    cells = [f"{w:g},{100 * a:.6f},{w + 5:g},{100 * b:.6f}," for w, a, b in zip(WAVES, *LEAVES[:2])]
    head = "oak,,elm,\nWavelength (nm),%R,Wavelength (nm),%R\n"
    log = "\n\noak\nCollection Time: noon\nScan software version: 5.1\n"
    (tmp_path / "a.csv").write_text(head + "\n".join(reversed(cells)) + log)
    found = read_spectra_file(tmp_path / "a.csv")
    assert [one.name for one in found] == ["oak", "elm"]
    for one, leaf, shift in zip(found, LEAVES, (0.0, 5.0), strict=False):
        np.testing.assert_allclose(one.wavelength, WAVES + shift)
        np.testing.assert_allclose(of(one), leaf, atol=1e-7)
    assert "lines below the numbers left out, the first of them 'oak'" in found[0].meta["repairs"]


def test_jasco_and_polypen(tmp_path: Path) -> None:
    head = "TITLE\toak\nORIGIN\tJASCO\nXUNITS\tNANOMETERS\nYUNITS\tREFLECTANCE\nXYDATA\n"
    spectrum = read(tmp_path, head + "\n".join(LINES) + "\n\n[Comments]\nSample name\tleaf\n")
    is_leaf(spectrum)
    assert spectrum.name == "oak"
    head = "PolyPen RP410\nSW ver: 1.0.0.5\n\nindex\toak\nwavelength [nm]\t\nNDVI\t0.72\n"
    spectrum = read(tmp_path, head + "\n".join(LINES) + "\n")
    is_leaf(spectrum)
    assert spectrum.name == "oak"


@pytest.mark.parametrize("form", ["XYPOINTS=(XY..XY)", "XYDATA=(X++(Y..Y))"])
def test_jcamp(tmp_path: Path, form: str) -> None:
    made = np.round(2e3 * LEAF).astype(int)
    if "++" in form:
        lines = [f"{WAVES[k]:g} {' '.join(map(str, made[k : k + 5]))}" for k in range(0, 101, 5)]
    else:
        lines = [f"{w / 2:g}, {v}" for w, v in zip(WAVES, made, strict=True)]
    head = (
        "##TITLE=oak\n##JCAMP-DX=4.24 $$ a remark\n##XUNITS=NANOMETERS\n##YUNITS=REFLECTANCE\n"
        f"##FIRSTX=400\n##LASTX=2400\n##XFACTOR=2.0\n##YFACTOR=0.0005\n##NPOINTS=101\n##{form}\n"
    )
    text = head + "\n".join(lines) + "\n##END=\n"
    spectrum = read(tmp_path, text, "a.jdx")
    is_leaf(spectrum, atol=3e-4)
    np.testing.assert_allclose(spectrum.wavelength, WAVES)
    for wrong, words in (
        (text.replace("POINTS=101", "POINTS=102"), "expected 102 values"),
        (text.replace("FACTOR=0.0005", "FACTOR=a"), "expected a number in the head"),
        (head + "400A43B2%\n##END=\n", "plain numbers, but they are compressed"),
    ):
        with pytest.raises(InputError, match=words):
            read(tmp_path, wrong, "a.jdx")

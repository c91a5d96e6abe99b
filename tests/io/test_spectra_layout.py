"""Layout and quantity of spectra by their numbers and the header's words; text of small
spectrometers and of the USGS library."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import fynjax as fx
from fynjax._core.errors import InputError
from fynjax.app.io.plot import read_plot
from fynjax.app.io.spectra import read_spectra_file
from fynjax.leaf import LeafParameters, prospect
from tests.io.test_spectra import SED
from tests.small import PLOT, SPECIES

WAVES = np.arange(400.0, 2401.0, 20.0)
_NM = np.arange(400.0, 2501.0)
LEAVES = np.stack(
    [
        np.interp(WAVES, _NM, np.asarray(prospect(LeafParameters(chlorophyll=c)).reflectance))
        for c in np.linspace(20.0, 66.8, 12)
    ]
)


def columns(path: Path, names: Sequence[str], first: str = "wavelength", **how) -> Path:
    frame = pd.DataFrame(LEAVES[: len(names)].T, columns=list(names))
    frame.insert(0, first, WAVES)
    frame.to_csv(path, index=False, **how)
    return path


def rows(path: Path, before: str = "", first: str = "sample", names: Sequence[object] = ()) -> Path:
    names = names or [f"oak{k}" for k in range(12)]
    frame = pd.DataFrame(LEAVES[: len(names)], columns=[f"{before}{w:g}" for w in WAVES])
    frame.insert(0, first, list(names))
    frame.to_csv(path, index=False)
    return path


def check(path: Path, count: int = 12) -> None:
    spectra = read_spectra_file(path)
    assert len(spectra) == count
    for spectrum, leaf in zip(spectra, LEAVES, strict=False):
        np.testing.assert_allclose(spectrum.wavelength, WAVES)
        np.testing.assert_allclose(spectrum.reflectance, leaf, atol=1e-9)


@pytest.mark.parametrize("first", ["wavelength", "wavelength_nm", "nm", "", "Wvl", "lambda (nm)"])
@pytest.mark.parametrize("name", ["plot14{:02d}", "PCA{:d}5", "S{:d}00", "d{:04d}", "20240{:03d}"])
def test_digits_of_names_turn_no_table_over(tmp_path: Path, name: str, first: str) -> None:
    check(columns(tmp_path / "a.csv", [name.format(k + 4) for k in range(12)], first))


@pytest.mark.parametrize("first", ["sample", "", "wavelength", "ID"])
@pytest.mark.parametrize("before", ["", "X", "wl_", "Refl."])
def test_a_row_a_spectrum_stays_one(tmp_path: Path, before: str, first: str) -> None:
    check(rows(tmp_path / "a.csv", before, first))
    numbers = list(range(401, 401 + 12))  # samples whose numbers may be wavelengths
    if first != "wavelength":
        check(rows(tmp_path / "b.csv", before, first, numbers))


def test_what_was_taken_is_said_in_a_line(tmp_path: Path) -> None:
    path = columns(tmp_path / "a.csv", [f"PCA{500 + 20 * k}" for k in range(12)])
    (said,) = read_spectra_file(path)[0].meta["repairs"]
    assert said.startswith("taken as a column a spectrum: column 1 ('wavelength')")
    assert "not 12 names of columns with numbers, 500 to 720: names of samples" in said


@pytest.mark.parametrize("numbering", ["pandas", "R", "write.table"])
def test_numbers_of_rows_are_no_column(tmp_path: Path, numbering: str) -> None:
    frame = pd.DataFrame({"wavelength": WAVES, "oak1": LEAVES[0], "oak2": LEAVES[1]})
    wide = pd.DataFrame(LEAVES[:2], columns=[f"X{w:g}" for w in WAVES])
    wide.insert(0, "sample", ["a", "b"])
    (tmp_path / "plot.toml").write_text(PLOT)
    species = [line.split(",") for line in SPECIES.splitlines()]
    plants = pd.DataFrame(species[1:], columns=species[0])
    for table, name in ((frame, "columns.csv"), (wide, "rows.csv"), (plants, "species.csv")):
        table.index += numbering != "pandas"
        table.to_csv(tmp_path / name)
        text = (tmp_path / name).read_text()
        if numbering == "write.table":
            (tmp_path / name).write_text(text.removeprefix(","))
    check(tmp_path / "columns.csv", 2)
    check(tmp_path / "rows.csv", 2)
    assert len(read_plot(tmp_path / "plot.toml").species) == 2


def test_a_treatment_t_is_no_transmittance(tmp_path: Path) -> None:
    path = columns(tmp_path / "a.csv", ["C101", "C102", "T101", "T102"])
    with pytest.warns(UserWarning, match="name is that of a transmittance.*taken for reflectance"):
        spectra = fx.read_spectra(path)
    assert spectra.sizes["spectrum"] == 4
    assert "transmittance" not in spectra
    for names, through in ((("R101", "T101"), 1), (("oak_R", "oak_T", "elm_T"), 2)):
        spectra = fx.read_spectra(columns(tmp_path / "a.csv", names))
        assert int(np.isfinite(spectra["transmittance"]).all("wavelength").sum()) == through


@pytest.mark.parametrize("name", ["Standard Deviation", "SD", "std", "leaf_sd", "SE"])
def test_an_error_beside_a_mean_is_no_leaf(tmp_path: Path, name: str) -> None:
    frame = pd.DataFrame({"nm": WAVES, "Mean": LEAVES[0], name: 0.05 * LEAVES[0]})
    frame.to_csv(tmp_path / "a.csv", index=False)
    with pytest.warns(UserWarning, match=f"no leaves: '{name}'"):
        assert fx.read_spectra(tmp_path / "a.csv")["spectrum"].values.tolist() == ["Mean"]


# -- small spectrometers ---------------------------------------------------------------------

BETWEEN = (WAVES >= 400) & (WAVES <= 1000)
OCEAN = """{program} Data File
++++++++++++++++++++++++++++++++++++
Date: Mon Jan 01 10:00:00 GMT 2024
Spectrometers: USB4A00000
Reference Spectrum Present: Yes
>>>>>Begin {kind}Spectral Data<<<<<
"""


def values(factor: float, mark: str = "\t") -> str:
    pairs = zip(WAVES[BETWEEN], factor * LEAVES[0][BETWEEN], strict=True)
    return "\n".join(f"{wave:.4E}{mark}{value:.6E}" for wave, value in pairs)


def text(tmp_path: Path, content: str) -> np.ndarray:
    (tmp_path / "leaf.txt").write_text(content)
    (spectrum,) = read_spectra_file(tmp_path / "leaf.txt")
    np.testing.assert_allclose(spectrum.wavelength, WAVES[BETWEEN])
    return spectrum.reflectance if spectrum.reflectance is not None else spectrum.transmittance


@pytest.mark.parametrize(("program", "kind"), [("SpectraSuite", "Processed "), ("OceanView", "")])
@pytest.mark.parametrize("factor", [1.0, 100.0])
def test_ocean_optics(tmp_path: Path, program: str, kind: str, factor: float) -> None:
    end = f"\n>>>>>End {kind}Spectral Data<<<<<\n" if kind else "\n"
    found = text(tmp_path, OCEAN.format(program=program, kind=kind) + values(factor) + end)
    np.testing.assert_allclose(found, LEAVES[0][BETWEEN], rtol=1e-5)
    with pytest.raises(InputError, match="the values are counts"):
        text(tmp_path, OCEAN.format(program=program, kind=kind) + values(1e5) + end)


@pytest.mark.parametrize("before", ["", "\ufeff", " ", "# "])
def test_ocean_optics_without_its_head(tmp_path: Path, before: str) -> None:
    begin = OCEAN.format(program="", kind="").splitlines()[-1]
    found = text(tmp_path, f"{before}{begin}\n{values(100.0)}\n")
    np.testing.assert_allclose(found, LEAVES[0][BETWEEN], rtol=1e-5)


def test_a_long_title_may_stand_above_a_table(tmp_path: Path) -> None:
    rows = f"wavelength,a\n{values(1.0, ',')}\n"
    (tmp_path / "long.csv").write_text("Measured on the mountain. " * 60 + f"\n{rows}")
    (spectrum,) = read_spectra_file(tmp_path / "long.csv")
    np.testing.assert_allclose(spectrum.reflectance, LEAVES[0][BETWEEN], rtol=1e-5)
    (tmp_path / "long.csv").write_text("Measured on the mountain. " * 2000 + f"\n{rows}")
    with pytest.raises(InputError, match=r"row 1: .* of at most 32768 characters"):
        read_spectra_file(tmp_path / "long.csv")


@pytest.mark.parametrize("processed", [True, False])
def test_jaz_and_what_it_is_formed_of(tmp_path: Path, processed: bool) -> None:
    """Dark 1000, white 5000: the sample says the same as the processed column."""
    leaf = LEAVES[0][BETWEEN]
    cells = [
        f"{wave:.6f}\t1000.0\t5000.0\t{1000.0 + 4000.0 * value:.4f}\t{100 * value * processed:.5f}"
        for wave, value in zip(WAVES[BETWEEN], leaf, strict=True)
    ]
    head = OCEAN.format(program="Jaz", kind="Processed ") + "W\tD\tR\tS\tP\n"
    end = "\n>>>>>End Processed Spectral Data<<<<<\n"
    np.testing.assert_allclose(text(tmp_path, head + "\n".join(cells) + end), leaf, rtol=1e-4)


@pytest.mark.parametrize("decimal", [".", ","])
@pytest.mark.parametrize("quantity", ["Reflectance", "Transmittance", ""])
def test_avantes(tmp_path: Path, quantity: str, decimal: str) -> None:
    leaf = LEAVES[0][BETWEEN]
    head = ["Integration time [ms]:  95,00", "Averaging Nr. [scans]: 20"]
    names, units = "Wave   ;Sample   ;Dark     ;Reference", "[nm]   ;[counts] ;[counts] ;[counts]"
    cells = [
        f" {wave:.3f}; {1000 + 4000 * v:.3f}; 1000.000; 5000.000"
        + f"; {100 * v:.3f}" * bool(quantity)
        for wave, v in zip(WAVES[BETWEEN], leaf, strict=True)
    ]
    if quantity:
        names, units = f"{names};{quantity}", f"{units};[%]"
    cells = [cell.replace(".", decimal) for cell in cells]
    found = text(tmp_path, "\n".join([*head, names, units, "", *cells, ""]))
    np.testing.assert_allclose(found, leaf, atol=1e-5)
    (spectrum,) = read_spectra_file(tmp_path / "leaf.txt")
    assert (spectrum.reflectance is None) == (quantity == "Transmittance")
    if not quantity:
        only = [cell.rsplit(";", 2)[0] for cell in [names, units, *cells]]
        with pytest.raises(InputError, match=r"counts of sample, dark only|counts of sample"):
            text(tmp_path, "\n".join([*head, *only]))


def test_the_usgs_library_with_its_wavelengths_beside_it(tmp_path: Path) -> None:
    leaf = LEAVES[0].copy()
    column = [f"  {v:.7E}" for v in leaf]
    column[3] = " -1.2300000E+34"
    leaf[3] = np.nan
    path = tmp_path / "ChapterV" / "splib07a_Oak.txt"
    path.parent.mkdir()
    path.write_text("\n".join([" splib07a Record=12: Oak leaf  ASDFRa AREF", *column, ""]))
    with pytest.raises(InputError, match=r"101 values without their wavelengths.*paste wave"):
        read_spectra_file(path)
    title = " splib07a Record=1: Wavelengths ASD 0.35-2.5 microns"
    waves = tmp_path / "splib07a_Wavelengths_ASD.txt"
    waves.write_text("\n".join([title, *(f" {w / 1000:.6E}" for w in WAVES), ""]))
    (spectrum,) = read_spectra_file(path)
    np.testing.assert_allclose(spectrum.wavelength, WAVES)
    np.testing.assert_allclose(spectrum.reflectance, leaf, rtol=1e-5)
    assert spectrum.name == "Oak leaf ASDFRa AREF"
    with pytest.raises(InputError, match="is what others of the library need"):
        read_spectra_file(waves)
    waves.write_text("\n".join([title, *(f" {w / 1000:.6E}" for w in WAVES[1:]), ""]))
    with pytest.raises(InputError, match="101 values without"):
        read_spectra_file(path)


def test_spectral_evolution_may_hold_transmittance(tmp_path: Path) -> None:
    (tmp_path / "leaf.sed").write_text(SED.replace("Reflect. %", "Trans. %"))
    (spectrum,) = read_spectra_file(tmp_path / "leaf.sed")
    np.testing.assert_allclose(spectrum.transmittance, [0.04, 0.05])
    assert spectrum.reflectance is None


@pytest.mark.parametrize(
    ("file", "count", "ends", "level"),
    [("21_table-of-spectra-with-numbered-names/table_pca40.csv", 40, (400, 2400), 0.455),
     ("22_control-C-and-treatment-T-names/control_treatment.csv", 4, (400, 2400), 0.455),
     ("23_small-spectrometers-text/leaf.jaz", 1, (400, 1000), 0.455),
     ("23_small-spectrometers-text/oceanview_leaf.txt", 1, (400, 1000), 0.455),
     ("30_r-write-csv-row-names/spectra_columns.csv", 4, (400, 2400), 0.455),
     ("30_r-write-csv-row-names/spectra_rows.csv", 4, (400, 2400), 0.455)],
)  # fmt: skip
def test_files_of_the_field(shared_data: Path, file: str, count: int, ends, level) -> None:
    spectra = read_spectra_file(shared_data / "field" / file)
    assert len(spectra) == count
    for spectrum in spectra:
        assert (spectrum.wavelength[0], spectrum.wavelength[-1]) == ends
        assert float(np.nanmax(spectrum.reflectance)) == pytest.approx(level, abs=0.002)

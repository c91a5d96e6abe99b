"""The numbers of a validation against SciPy and NumPy, and the files of a run."""

import dataclasses
import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from scipy import stats

from fynjax._core.errors import InputError
from fynjax.app.compare import table4_2006
from fynjax.app.compare._drone import DroneComparison, compare_drone_images
from fynjax.app.compare._images import read_drone_image
from fynjax.app.compare._spectra import SpectraSample, read_spectra_sample
from fynjax.app.compare._spectral import SpectralComparison, compare_spectra
from fynjax.app.io.raster import write_geotiff
from fynjax.app.jobs._validate import ValidationData, validate
from fynjax.app.report.pages import Picture, Table, drone_section, spectral_section
from fynjax.metrics import BANDS, VEGETATION_INDICES, spectral_mask
from tests.compare.test_spectra import WAVE, cube, write_csv, write_envi
from tests.helpers import assert_valid_summary


def drawn(seed: int, rows: int, columns: int, spread: float = 0.3) -> np.ndarray:
    """Lognormal bands; a few pixels have more red than near infrared, one no red at all."""
    rng = np.random.default_rng(seed)
    means = np.array([0.033, 0.032, 0.086, 0.226])[:, None, None]
    image = means * np.exp(spread * rng.normal(size=(4, rows, columns)))
    image[1, 0, :5] = 2.0 * image[3, 0, :5]
    image[1, 1, 1] = 0.0
    return image.astype(np.float32)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two images that differ in size, place, pixel and order of bands; and two sets of spectra."""
    path = tmp_path_factory.mktemp("pair")
    write_geotiff(path / "real.tif", drawn(1, 40, 50), BANDS, pixel_m=0.05, crs="EPSG:32734")
    write_geotiff(
        path / "simulated.tif", drawn(2, 30, 30, 0.2)[::-1], BANDS[::-1], pixel_m=0.1,
        origin_m=(5e5, 6e6), crs="EPSG:32735",
    )  # fmt: skip
    write_csv(path / "real.csv", cube().reshape(len(WAVE), -1).T)
    write_envi(path / "simulated", (0.8 * cube() + 0.01)[:, :2])
    return path


@pytest.fixture(scope="module")
def drone(folder: Path) -> DroneComparison:
    real, simulated = (read_drone_image(folder / f"{n}.tif") for n in ("real", "simulated"))
    return compare_drone_images(real, simulated)


def written(name: str, image: np.ndarray) -> np.ndarray:
    """An index by its formula as the table prints it; NaN where it is not finite."""
    green, red, edge, nir = image.astype(float)
    space = {"G": green, "R": red, "RE": edge, "N": nir, "sqrt": np.sqrt}
    with np.errstate(all="ignore"):
        value = eval(
            VEGETATION_INDICES[name].formula.replace("^", "**"), {"__builtins__": {}}, space
        )
    value = value.ravel()
    return value[np.isfinite(value)]


def test_bands_that_both_images_have_are_compared(tmp_path: Path) -> None:
    """By name or wavelength; not what is no reflected light, or only one of them has."""
    other = [0.01 * drawn(3, 30, 30)[0], *(level * drawn(3, 30, 30)[0] for level in (1, 2, 3))]
    thermal = np.full((30, 30), 300.0)
    for name, seed, names, waves in (
        ("a", 1, ["Coastal", "Blue", "Red edge 2", "Green 2"], [444, 475, 740, 531]),
        ("b", 2, ["yellow", "475", "red_edge_2", "band 9"], [600, 478, 760, 535]),
    ):
        image = [*drawn(seed, 30, 30), *other, thermal]
        write_geotiff(
            tmp_path / f"{name}.tif", image, [*BANDS, *names, "LWIR"], pixel_m=0.05,
            wavelengths=[560, 650, 717, 860, *waves, 11000],
        )  # fmt: skip
    table = validate(
        ValidationData(real_drone=tmp_path / "a.tif", simulated_drone=tmp_path / "b.tif"),
        tmp_path / "out",
    ).drone.bands
    assert [row["band"] for row in table] == [*BANDS, "blue", "red_edge_2", "535 nm"]
    for row, values in zip(table[4:], other[1:], strict=True):
        assert row["real_mean"] == pytest.approx(values.mean())
        assert row["ks"] == 0.0


def test_a_band_of_one_image_alone_leaves_out_no_pixel(tmp_path: Path) -> None:
    image = np.concatenate([drawn(3, 30, 30)[:1], drawn(1, 30, 30)])
    write_geotiff(tmp_path / "b.tif", image[1:], list(BANDS), pixel_m=0.05)
    image[0, :10] = np.nan
    write_geotiff(tmp_path / "a.tif", image, ["Blue", *BANDS], pixel_m=0.05)
    files = {"real_drone": tmp_path / "a.tif", "simulated_drone": tmp_path / "b.tif"}
    table = validate(ValidationData(**files), tmp_path / "out").drone.bands
    assert [row["band"] for row in table] == list(BANDS)
    assert [row["ks"] for row in table] == [0.0] * 4


def test_every_number_of_table_4_by_scipy_and_numpy(drone: DroneComparison) -> None:
    images = drawn(1, 40, 50), drawn(2, 30, 30, 0.2)
    table = drone.indices.set_index("index")
    assert list(table.index) == list(table4_2006())
    for name, row in table.iterrows():
        x, y = (written(str(name), image) for image in images)
        assert row["real_mean"] == pytest.approx(x.mean(), rel=1e-5)
        assert row["simulated_std"] == pytest.approx(y.std(), rel=1e-5)
        assert row["ks"] == pytest.approx(stats.ks_2samp(x, y).statistic, abs=1e-12)
        edges = np.histogram_bin_edges(np.concatenate([x, y]), 256)
        shares = [np.histogram(v, edges)[0] / v.size for v in (x, y)]
        overlap = np.minimum(*shares).sum()
        assert row["histogram_intersection"] == pytest.approx(overlap, abs=0.003), name
        assert row["histogram_intersection"] <= 1.0 - row["ks"] + 1e-9
        k = list(table.index).index(name)
        np.testing.assert_allclose(drone.shares[:, k].sum(axis=1), 1.0)
        assert np.minimum(*drone.shares[:, k]).sum() == pytest.approx(overlap, abs=0.003)
        change = 100 * (y.mean() - x.mean()) / abs(x.mean())
        assert row["difference_percent"] == pytest.approx(change, rel=1e-4)
        lost = 100 * (1 - x.size / 2000)
        assert row["real_undefined_percent"] == pytest.approx(lost, abs=1e-9)
    assert table.loc["RDVI_root", "real_undefined_percent"] == pytest.approx(0.25)
    assert table.loc["SR", "simulated_undefined_percent"] == pytest.approx(100 / 900)
    assert np.isfinite(table.loc["EVI_green", ["literature_real_mean"]].astype(float)).all()
    assert "Roujean" in table.loc["RDVI_root", "departure"]


def test_bands_and_what_a_reader_must_know(drone: DroneComparison) -> None:
    images = drawn(1, 40, 50), drawn(2, 30, 30, 0.2)
    for k, row in drone.bands.iterrows():
        x, y = (image[k].astype(float).ravel() for image in images)  # type: ignore[index]
        assert row["difference_percent"] == pytest.approx(100 * (y.mean() / x.mean() - 1))
        assert row["real_p75"] == pytest.approx(np.percentile(x, 75))
        assert row["simulated_p5"] == pytest.approx(np.percentile(y, 5))
        assert row["ks"] == pytest.approx(stats.ks_2samp(x, y).statistic)
    said = " ".join(drone.notes)
    assert "differ in size (0.05 m and 0.1 m)" in said
    assert "different coordinate systems" in said
    assert "50 x 40 pixels" in said


def sample(values: np.ndarray, wave: np.ndarray = WAVE) -> SpectraSample:
    return SpectraSample((), wave, values, None, 0, 0)


def test_spectra_by_hand() -> None:
    rng = np.random.default_rng(4)
    spectra = cube().reshape(len(WAVE), -1).T
    other = 0.7 * spectra[:5] + 0.02 + 0.003 * rng.normal(size=(5, len(WAVE)))
    got = compare_spectra(sample(spectra), sample(other), windows=[(1340, 1460), (1790, 2100)])
    x, y = spectra.mean(axis=0), other.mean(axis=0)
    used = ~(((WAVE >= 1340) & (WAVE <= 1460)) | ((WAVE >= 1790) & (WAVE <= 2100)))
    used &= WAVE <= 2450
    limits = {"full": (400, 2450), "vnir": (400, 1000), "swir1": (1000, 1790)}
    limits["swir2"] = (2100, 2450)
    misfit = got.misfit.set_index("region")
    for name, row in got.regions.set_index("region").iterrows():
        low, high = limits[str(name)]
        keep = used & (low <= WAVE) & (high >= WAVE)
        a, b = x[keep], y[keep]
        angle = np.degrees(np.arccos(a @ b / np.linalg.norm(a) / np.linalg.norm(b)))
        rmse = np.sqrt(np.mean((a - b) ** 2))
        assert row["bands"] == keep.sum()
        assert row["spectral_angle_deg"] == pytest.approx(angle, rel=1e-6)
        assert row["rmse"] == pytest.approx(rmse)
        assert row["nrmse_percent"] == pytest.approx(100 * rmse / np.ptp(a))
        assert row["correlation"] == pytest.approx(np.corrcoef(a, b)[0, 1])
        parts = misfit.loc[name, ["level_percent", "contrast_percent", "shape_percent"]]
        assert parts.astype(float).sum() == pytest.approx(100.0)
        assert misfit.loc[name, "gain"] == pytest.approx(np.polyfit(a, b, 1)[0], rel=1e-6)
    np.testing.assert_allclose(got.spectra["simulated_std"], other.std(axis=0), rtol=1e-9)
    np.testing.assert_array_equal(got.spectra["used"], used)
    narrower = compare_spectra(sample(spectra), sample(other), windows=[(800, 900)])
    assert not narrower.spectra["used"][(WAVE >= 800) & (WAVE <= 900)].any()


def test_readings_name_the_cause() -> None:
    spectra = cube().reshape(len(WAVE), -1).T
    rng = np.random.default_rng(0)

    def reading(other: np.ndarray) -> dict[str, str]:
        got: SpectralComparison = compare_spectra(sample(spectra), sample(other))
        return dict(zip(got.misfit["region"], got.misfit["reading"], strict=True))

    assert reading(spectra)["full"] == "no error"
    assert "an offset" in reading(spectra - 0.03)["full"]
    assert "a gain" in reading(0.6 * spectra)["full"]
    assert "together" in reading(2.0 * spectra - 0.18)["full"]
    assert "shape" in reading(spectra + 0.03 * rng.normal(size=(1, len(WAVE))))["full"]
    assert reading(spectra[:1] - 0.05)["swir2"].startswith("an offset")


def test_only_a_part_of_the_range(tmp_path: Path) -> None:
    spectra = cube().reshape(len(WAVE), -1).T
    short = WAVE < 1000
    got = compare_spectra(sample(spectra), sample(spectra[:1, short], WAVE[short]))
    assert list(got.regions["region"]) == ["full", "vnir"]
    said = " ".join(got.notes)
    assert "Not covered: swir1, swir2" in said
    assert "less than the paper's" in said
    assert got.spectra["simulated_std"].isna().all()


@pytest.mark.parametrize("wave", [np.arange(1600.0, 2460.0, 10.0), np.array([500.0, 600.0])])
def test_spectra_that_reach_no_index(wave: np.ndarray, folder: Path, tmp_path: Path) -> None:
    short = tmp_path / "short.csv"
    rows = [f"{w:g},{v:g}" for w, v in zip(wave, np.linspace(0.1, 0.2, wave.size), strict=True)]
    short.write_text("\n".join(["wavelength,reflectance", *rows]) + "\n")
    data = ValidationData(real_spectra=[short], simulated_spectra=[folder / "real.csv"])
    summary = validate(data, tmp_path / "out")
    assert summary.spectra.indices == []
    assert "No index: the spectra do not reach its bands." in summary.spectra.notes
    assert "spectral_indices.png" not in summary.files
    assert pd.read_csv(tmp_path / "out" / "spectral_indices.csv").columns[0] == "index"
    with xr.open_dataset(tmp_path / "out" / "validation.nc") as file:
        assert "spectrometer_index" not in file.dims


def test_a_constant_spectrum_has_no_line(folder: Path, tmp_path: Path) -> None:
    """Also where bringing it onto other bands has rounded it."""
    fine = np.arange(390.0, 2470.0, 3.0)
    x = read_spectra_sample([folder / "real.csv"]).values.mean(axis=0)
    x = x[spectral_mask(WAVE)]
    degrees = np.degrees(np.arccos(x.sum() / np.sqrt(x.size) / np.linalg.norm(x)))
    flat = write_csv(tmp_path / "flat.csv", np.full((1, fine.size), 0.3), fine)
    data = ValidationData(real_spectra=[flat], simulated_spectra=[folder / "real.csv"])
    summary = validate(data, tmp_path / "out", matching="response")
    full, misfit = summary.spectra.regions[0], summary.spectra.misfit[0]
    for value in (full["nrmse_percent"], full["correlation"], misfit["gain"], misfit["offset"]):
        assert value is None  # JSON has no NaN
    assert "constant" in misfit["reading"]
    assert f"angle {degrees:.1f}°, RMSE" in summary.headline[0]
    assert "r undefined" in summary.headline[0]
    assert "nan" not in " ".join(summary.headline)
    assert "constant in a region" in " ".join(summary.spectra.notes)
    assert "nan°" not in (tmp_path / "out" / "report.html").read_text("utf-8")


def test_a_run_writes_every_number_once(folder: Path, tmp_path: Path) -> None:
    data = ValidationData(
        real_drone=folder / "real.tif",
        simulated_drone=folder / "simulated.tif",
        real_spectra=[folder / "real.csv"],
        simulated_spectra=[folder / "simulated"],
    )
    summary = validate(data, tmp_path)
    assert sorted(summary.files) == sorted(p.name for p in tmp_path.iterdir())
    assert_valid_summary(summary)
    table = pd.read_csv(tmp_path / "drone_indices.csv")
    with xr.open_dataset(tmp_path / "validation.nc") as file:
        np.testing.assert_allclose(file["index_ks"], table["ks"], rtol=1e-8)
        np.testing.assert_allclose(file["histogram"].sum("bin"), 1.0)
        assert list(file["index_formula"].values) == list(table["formula"])
        agreement = pd.read_csv(tmp_path / "spectral_agreement.csv")
        np.testing.assert_allclose(file["agreement_rmse"], agreement["rmse"], rtol=1e-8)
        assert file["agreement_spectral_angle_deg"].attrs["units"] == "degree"
        assert "real.tif" in json.loads(file.attrs["input_sha256"])
    assert summary.drone.indices[9]["ks"] == pytest.approx(table["ks"][9])
    for row, name in zip(summary.drone.diversity, ("real", "simulated"), strict=True):
        pixels = read_drone_image(folder / f"{name}.tif").pixels
        cv = np.mean(pixels.std(axis=1, ddof=1) / pixels.mean(axis=1))
        assert row["sample"] == name
        assert row["cv"] == pytest.approx(cv)
        assert row["variance"] == pytest.approx(pixels.var(axis=1, ddof=1).sum())
    assert summary.spectra.matching == "same"
    html = (tmp_path / "report.html").read_text("utf-8")
    assert html.count("<figure") == 6
    for words in ("0.885", "48.31", "sqrt((N-R)/(N+R))", "Gauch", "MEVI"):
        assert words in html, words
    assert any("a gain" in line or "gain" in line for line in summary.headline)


def test_against_the_published_statistics(folder: Path, tmp_path: Path) -> None:
    data = ValidationData(real_drone="published", simulated_drone=folder / "simulated.tif")
    summary = validate(data, tmp_path)
    table = pd.read_csv(tmp_path / "drone_published.csv").set_index("statistic")
    ndvi = written("NDVI", drawn(2, 30, 30, 0.2))
    row = table.loc["NDVI.mean"]
    assert (row["real"], row["dirsig"]) == (0.7462, 0.7198)
    assert row["simulated"] == pytest.approx(ndvi.mean(), rel=1e-5)
    assert row["simulated_error_percent"] == pytest.approx(100 * (ndvi.mean() / 0.7462 - 1))
    assert table.loc["IPVI.std", "status"] == "contradicts its formula"
    assert table.loc["EVI_green.mean", "status"] == "form not known"
    assert table.loc["nir.mean", "dirsig_abs_error_percent"] == pytest.approx(22.19)
    assert len(table) == 44
    assert "of 37" in summary.headline[0]


def test_pairs_must_be_pairs() -> None:
    for given, word in (
        ({}, "at least one pair"),
        ({"simulated_drone": "a.tif"}, "--real-drone published"),
        ({"real_spectra": ["a.csv"]}, "needs --simulated-spectra"),
        ({"real_cloud": "a.laz"}, "needs --simulated-cloud"),
    ):
        with pytest.raises(InputError, match=word):
            ValidationData(**given)  # type: ignore[arg-type]


def test_pixels_of_other_scales_are_warned_of(folder: Path, tmp_path: Path) -> None:
    """A satellite's pixels beside a drone's; and the article's figures stay out of the summary."""
    path = tmp_path / "satellite.tif"
    write_geotiff(path, drawn(3, 12, 12), BANDS, pixel_m=30.0, crs="EPSG:32734")
    data = ValidationData(real_drone=path, simulated_drone=folder / "simulated.tif")
    with pytest.warns(UserWarning, match=r"differ in size \(30 m and 0.1 m\).*gdalwarp -tr 30 30"):
        result = validate(data, tmp_path / "out")
    assert "DIRSIG" not in " ".join(result.headline)


def test_tables_that_are_open_quote_no_other_plot(drone: DroneComparison) -> None:
    """The paper's numbers are of its own plot: they are there for whoever opens the tables."""
    own = sample(cube().reshape(len(WAVE), -1).T)
    parts = [*drone_section(drone).parts, *spectral_section(compare_spectra(own, own)).parts]
    tables = [part for part in parts if isinstance(part, Table)]
    shown = [str(c) for table in tables if not table.folded for c in table.rows]
    folded = [str(c) for table in tables if table.folded for c in table.rows]
    assert not any(c.startswith("paper") for c in shown)
    assert {"paper_real_mean_derived", "paper_real_mean", "real_p5", "paper_sign"} <= set(folded)
    of_drone = [part for part in drone_section(drone).parts if isinstance(part, Table)]
    assert max(len(table.rows.columns) for table in of_drone if not table.folded) <= 9


def test_images_of_which_one_would_be_a_dot_are_not_shown_side_by_side(
    drone: DroneComparison,
) -> None:
    """A plot of 4 m on the scale of a satellite's image is four pixels."""

    def pictures(of):
        return {part.file for part in drone_section(of).parts if isinstance(part, Picture)}

    assert "drone_images.png" in pictures(drone)
    far = dataclasses.replace(drone, real=dataclasses.replace(drone.real, pixel_m=30.0))
    assert "drone_images.png" not in pictures(far)

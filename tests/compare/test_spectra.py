"""Spectra as `fynjax validate` reads them: the same ones from every format."""

from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from rasterio import Affine

from fynjax._core.errors import InputError
from fynjax.app.compare import compare_spectra
from fynjax.app.compare._spectra import SpectraSample, read_spectra_sample
from fynjax.app.io.raster import image_array, write_geotiff, write_run
from tests.helpers import write_raster

WAVE = np.arange(400.0, 2460.0, 20.0)


def cube() -> np.ndarray:
    """Reflectance [band, row, column], all spectra different."""
    scale = np.linspace(0.5, 1.0, 12).reshape(3, 4)
    return (0.1 + 0.2 * np.sin(WAVE / 700.0) ** 2)[:, None, None] * scale


def read(*paths: Path, **options) -> SpectraSample:  # type: ignore[no-untyped-def]
    return read_spectra_sample(paths, **options)


def write_envi(path: Path, values: np.ndarray, **header: str) -> Path:
    """An ENVI cube in band-sequential order, as other programs write it."""
    values.astype("<f4").tofile(path)
    lines = {
        "samples": values.shape[2], "lines": values.shape[1], "bands": values.shape[0],
        "header offset": 0, "file type": "ENVI Standard", "data type": 4, "interleave": "bsq",
        "byte order": 0, "wavelength units": "Nanometers",
        "wavelength": "{" + ", ".join(f"{w:g}" for w in WAVE) + "}", **header,
    }  # fmt: skip
    text = "ENVI\n" + "\n".join(f"{k} = {v}" for k, v in lines.items()) + "\n"
    path.with_name(path.name + ".hdr").write_text(text)
    return path


def write_csv(path: Path, spectra: np.ndarray, wave: np.ndarray = WAVE) -> Path:
    rows = [",".join(["name", *(f"{w:.3f}" for w in wave)])]
    rows += [",".join([f"s{k}", *(f"{v:.9g}" for v in s)]) for k, s in enumerate(spectra)]
    path.write_text("\n".join(rows) + "\n", encoding="utf-8")
    return path


def test_the_same_spectra_from_every_format(tmp_path: Path) -> None:
    values = cube()
    spectra = values.reshape(len(WAVE), -1).T
    names = [f"b{k}" for k in range(len(WAVE))]
    write_geotiff(
        tmp_path / "a.tif", values[:, ::-1], names, pixel_m=1.0, wavelengths=list(WAVE),
        widths=[22.0] * len(WAVE),
    )  # fmt: skip
    array = image_array(values, names, list(WAVE), pixel_m=1.0, long_name="reflectance")
    write_run(tmp_path / "a.nc", xr.Dataset({"reflectance": array}))
    fwhm = "{" + ", ".join(["22.0"] * len(WAVE)) + "}"
    files = {
        "csv": write_csv(tmp_path / "a.csv", spectra),
        "envi": write_envi(tmp_path / "a", values, fwhm=fwhm),
        "micro": write_envi(
            tmp_path / "um", values, fwhm="{" + ", ".join(["0.022"] * len(WAVE)) + "}",
            **{"wavelength units": "Micrometers",
               "wavelength": "{" + ", ".join(f"{w / 1000:.5g}" for w in WAVE) + "}"},
        ),
        "tif": tmp_path / "a.tif",
        "nc": tmp_path / "a.nc",
    }  # fmt: skip
    for name, path in files.items():
        got = read(path)
        np.testing.assert_allclose(got.wavelength, WAVE, rtol=1e-6, err_msg=name)
        np.testing.assert_allclose(got.values, spectra, rtol=1e-6, err_msg=name)
        if name in ("envi", "micro", "tif"):
            assert got.fwhm is not None
            np.testing.assert_allclose(got.fwhm, 22.0, rtol=1e-5)
    np.testing.assert_allclose(read(tmp_path / "a.hdr").values, spectra, rtol=1e-6)
    assert len(read(files["csv"], files["csv"]).values) == 24
    thinned = read(files["envi"], most_spectra=4)
    assert thinned.step == 2
    np.testing.assert_allclose(thinned.values, values[:, ::2, ::2].reshape(len(WAVE), -1).T)


def test_what_is_missing_is_left_out_and_counted(tmp_path: Path) -> None:
    values = cube()
    values[[45, 46]] = -0.01  # filled by the product
    values[:, 0, 0] = -9999.0
    values[70, 2, 2] = -9999.0
    good = np.ones(len(WAVE), int)
    good[60] = 0
    path = write_envi(
        tmp_path / "a", values,
        **{"data ignore value": "-9999", "bbl": "{" + ", ".join(map(str, good)) + "}"},
    )  # fmt: skip
    got = read(path)
    assert got.dead == 3
    assert not set(WAVE[[45, 46, 60]]) & set(got.wavelength)
    assert (len(got.values), got.left_out) == (10, 1)
    assert "3 bands without values left out" in got.description()
    scaled = write_envi(tmp_path / "b", 1e4 * cube(), **{"reflectance scale factor": "10000"})
    np.testing.assert_allclose(read(scaled).values, cube().reshape(len(WAVE), -1).T, rtol=1e-6)
    spectra = cube().reshape(len(WAVE), -1).T
    spectra[3] = -9999.0
    with pytest.warns(UserWarning, match="1 of 12 spectra cannot be used"):
        assert len(read(write_csv(tmp_path / "c.csv", spectra)).values) == 11


def test_flags_and_errors_before_the_reflectance_are_not_taken_for_it(tmp_path: Path) -> None:
    spectra = cube().reshape(len(WAVE), -1).T
    for name, others in (
        ("surface_reflectance", ("surface_reflectance_uncertainty", "reflectance_good")),
        ("reflectance", ("path_reflectance",)),
    ):
        data = xr.Dataset(dict.fromkeys(others, (("y", "band"), 0.1 * spectra)))
        data[name] = ("y", "band"), spectra
        data["wavelength"] = ("band", WAVE)
        data.to_netcdf(tmp_path / f"{name}.nc")
        np.testing.assert_allclose(read(tmp_path / f"{name}.nc").values, spectra)


def test_bad_input(tmp_path: Path) -> None:
    spectra = cube().reshape(len(WAVE), -1).T
    other = write_csv(tmp_path / "other.csv", spectra, WAVE + 3.0)
    first = write_csv(tmp_path / "first.csv", spectra)
    plain = write_raster(tmp_path / "plain.tif", cube(), transform=Affine(1, 0, 0, 0, -1, 9))
    wrong = xr.Dataset({"a": (("y", "band"), spectra), "b": (("y", "band"), spectra)})
    wrong["wavelength"] = ("band", WAVE)
    wrong.to_netcdf(tmp_path / "two.nc")
    wrong.drop_vars("wavelength").to_netcdf(tmp_path / "none.nc")
    (tmp_path / "cut.nc").write_bytes((tmp_path / "two.nc").read_bytes()[:500])
    for paths, word in (
        ([first, other], "one instrument at a time"),
        ([plain], "wavelength for each of 103"),
        ([write_envi(tmp_path / "percent", 100 * cube())], "percent"),
        ([write_envi(tmp_path / "fill", np.full_like(cube(), -50.0) * cube())], "no-data"),
        ([tmp_path / "two.nc"], "called reflectance.*a, b"),
        ([tmp_path / "none.nc"], "variable `wavelength`"),
        ([tmp_path / "cut.nc"], "NetCDF"),
        ([tmp_path / "lost.csv"], "no such file"),
    ):
        with pytest.raises(InputError, match=word):
            read(*paths)


def test_widths_of_bands_are_of_the_spectrum_that_they_belong_to(tmp_path: Path) -> None:
    """Real bands 60 nm wide every 20 nm, simulated ones 2 nm wide every 2 nm, of one surface with a
    narrow peak: brought to the wide bands both agree, by an average over the Gaussian written out
    here. With the widths exchanged the peak would stay as it is."""
    fine = np.arange(450.0, 951.0, 2.0)
    surface = 0.2 + 0.3 * np.exp(-0.5 * ((fine - 700.0) / 8.0) ** 2)
    wide = np.arange(500.0, 901.0, 20.0)
    response = np.exp(-4.0 * np.log(2.0) * ((fine - wide[:, None]) / 60.0) ** 2)
    seen = response @ surface / response.sum(axis=1)
    samples = []
    for name, wave, values, width in (
        ("real", wide, seen, 60.0),
        ("simulated", fine, surface, 2.0),
    ):
        many = "{" + ", ".join([f"{width}"] * len(wave)) + "}"
        waves = "{" + ", ".join(f"{w:g}" for w in wave) + "}"
        image = np.repeat(values, 4).reshape(len(wave), 2, 2)
        samples.append(read(write_envi(tmp_path / name, image, fwhm=many, wavelength=waves)))
    spectra = compare_spectra(*samples).spectra
    assert list(spectra["wavelength_nm"]) == list(wide)
    np.testing.assert_allclose(spectra["simulated_mean"], seen, atol=2e-3)
    np.testing.assert_allclose(spectra["real_mean"], seen, atol=1e-6)
    assert surface.max() - seen.max() > 0.1

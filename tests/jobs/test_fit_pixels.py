"""`fynjax fit-canopy`: bands by any name, numbers on any scale, tables and images."""

import re
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import rasterio
import xarray as xr

import fynjax as fx
from fynjax import jobs
from fynjax.app.io.raster import RELATIVE_TAG, write_geotiff
from fynjax.app.jobs._canopy_input import ANGLES, read_canopy_pixels
from fynjax.app.jobs._fit_pixels import _views
from fynjax.errors import InputError
from fynjax.inversion import CanopyView
from fynjax.inversion._canopy import CanopyTable

PEERS = pd.read_csv(Path(__file__).parents[1] / "inversion/canopies_by_prosail.csv")
"""Canopies of prosail at the middles of Sentinel-2's bands (`tests/inversion/test_canopy.py`)."""
NAMES = ["B01", "B02", "B03", "B04", "B05", "B06", "B07", "B08", "B8A", "B11", "B12"]
SPECTRA = PEERS.iloc[:, 9:].to_numpy(float)


def table(values=SPECTRA, names=NAMES, **notes):
    return pd.DataFrame(notes | dict(zip(names, values.T)))


@pytest.mark.parametrize(
    ("names", "factor", "said"),
    [
        (NAMES, 1.0, ""),
        (NAMES, 100.0, "Percent"),
        (["B1", "b2", "Band_3", "band 4", "B5", "SR_B6", "B7", "B8", "B8A", "B11", "B12"], 1e4,
         "Ten thousandths"),
        (["B01", "blue", "green", "red", "B5", "B6", "B7", "nir", "B8A", "swir1", "SWIR_2"], 1.0,
         "red as B4"),
    ],
)  # fmt: skip
def test_bands_and_scales_are_told(names, factor, said, tmp_path):
    table(SPECTRA * factor, names, site="a").to_csv(tmp_path / "p.csv", index=False)
    read = read_canopy_pixels(tmp_path / "p.csv", fx.sensor("sentinel_2a"))
    assert read.bands.names == ("B1", "B2", "B3", "B4", "B5", "B6", "B7", "B8", "B8A", "B11", "B12")
    np.testing.assert_allclose(read.reflectance, SPECTRA, rtol=1e-6)
    assert said in " ".join(read.said)
    assert list(read.notes) == ["site"]


def test_wavelengths_with_decimal_commas_and_a_missing_value(tmp_path):
    names = [f"R{name}" for name in PEERS.columns[9:]]
    frame = table(names=names)
    frame.loc[2, "R560"] = np.nan
    frame.to_csv(tmp_path / "p.csv", sep=";", decimal=",", index=False)
    read = read_canopy_pixels(tmp_path / "p.csv", None)
    assert read.bands.tolist() == PEERS.columns[9:].astype(float).tolist()
    assert np.isnan(read.reflectance[2, 2])
    assert np.isfinite(read.reflectance).sum() == SPECTRA.size - 1


def test_collection_2_of_landsat(tmp_path):
    names = [f"SR_B{i}" for i in range(1, 8)]
    seen = SPECTRA[:, [0, 1, 2, 3, 8, 9, 10]]
    table(np.round((seen + 0.2) / 2.75e-5), names).to_csv(tmp_path / "p.csv", index=False)
    read = read_canopy_pixels(tmp_path / "p.csv", fx.sensor("landsat_8"))
    np.testing.assert_allclose(read.reflectance, seen, atol=2e-5)

    plain = [f"B{i}" for i in range(1, 8)]
    frame = table(np.round((seen + 0.2) / 2.75e-5), plain)
    frame.loc[0] = 0.0  # fill
    frame.to_csv(tmp_path / "b.csv", index=False)
    found = read_canopy_pixels(tmp_path / "b.csv", fx.sensor("landsat_8")).reflectance
    np.testing.assert_allclose(found[1:], seen[1:], atol=2e-5)
    assert np.isnan(found[0]).all()
    with pytest.raises(InputError, match=r"no ground reflects 0\.6 in all bands.*SR_B1"):
        read_canopy_pixels(tmp_path / "b.csv", fx.sensor("sentinel_2a"))


@pytest.mark.parametrize("scale", [1.0, 100.0, 1e4])
@pytest.mark.parametrize("sensor", ["sentinel_2a", None])
@pytest.mark.parametrize("offset", [0.0, 0.1])
def test_an_offset_of_sentinel_2_is_told(offset, sensor, scale, tmp_path):
    names = NAMES if sensor else list(PEERS.columns[9:])
    table(scale * (SPECTRA + offset), names).to_csv(tmp_path / "p.csv", index=False)
    words = read_canopy_pixels(tmp_path / "p.csv", sensor and fx.sensor(sensor)).said
    assert ("offset of 1000" in " ".join(words)) == (offset > 0.0)


@pytest.mark.parametrize("unit", [1.0, 1e-3])
def test_wavelengths_of_a_file_count_more_than_names_that_only_count(unit, tmp_path):
    seen, middle = SPECTRA[:4, 1:].reshape(2, 2, 10), PEERS.columns[10:].astype(float)
    image = xr.Dataset(
        {"reflectance": (("y", "x", "band"), seen)},
        {"band": [f"Band {i + 1}" for i in range(10)],
         "wavelength": ("band", unit * middle, {"units": "nm" if unit == 1.0 else "um"})},
    )  # fmt: skip
    image.to_netcdf(tmp_path / "i.nc")
    read = read_canopy_pixels(tmp_path / "i.nc", fx.sensor("sentinel_2a"))
    assert read.bands.names == ("B2", "B3", "B4", "B5", "B6", "B7", "B8", "B8A", "B11", "B12")
    np.testing.assert_allclose(read.reflectance, SPECTRA[:4, 1:], rtol=1e-6)
    image.drop_vars("wavelength").to_netcdf(tmp_path / "n.nc")
    with pytest.raises(InputError, match="Band 1 to Band 10 only count"):
        read_canopy_pixels(tmp_path / "n.nc", fx.sensor("sentinel_2a"))


def test_the_wavelength_nearest_to_a_band_is_taken_and_a_spectrum_is_refused(tmp_path):
    names = ["652", "663", "560", "865"]
    table(SPECTRA[:, :4], names).to_csv(tmp_path / "p.csv", index=False)
    read = read_canopy_pixels(tmp_path / "p.csv", fx.sensor("sentinel_2a"))
    assert read.bands.names == ("B3", "B4", "B8A")
    np.testing.assert_allclose(read.reflectance, SPECTRA[:, [2, 1, 3]])
    table(SPECTRA[:, :4], ["B2", "blue", "560", "865"]).to_csv(tmp_path / "b.csv", index=False)
    read = read_canopy_pixels(tmp_path / "b.csv", fx.sensor("sentinel_2a"))
    np.testing.assert_allclose(read.reflectance, SPECTRA[:, [0, 2, 3]])  # of two the first
    fine = [str(nm) for nm in range(400, 1000, 10)]
    table(np.repeat(SPECTRA[:, :1], 60, axis=1), fine).to_csv(tmp_path / "s.csv", index=False)
    with pytest.raises(InputError, match=r"wavelengths are within one of them.*Leave the sensor"):
        read_canopy_pixels(tmp_path / "s.csv", fx.sensor("sentinel_2a"))


def test_radiance_is_refused_by_its_line_of_oxygen_and_by_what_the_file_says(tmp_path):
    nm = np.arange(400.0, 1000.0, 5.0)
    seen = np.where(nm > 700.0, 30.0, 3.0) * np.where(np.abs(nm - 761.0) < 3.0, 0.5, 1.0)
    names = [f"{at:g}" for at in nm]
    for scale in (1.0, 0.01):
        table(scale * seen[None], names).to_csv(tmp_path / "p.csv", index=False)
        with pytest.raises(InputError, match=r"at 761 nm, where oxygen absorbs, there is 0\.50"):
            read_canopy_pixels(tmp_path / "p.csv", None)
    level = np.where(nm > 700.0, 30.0, 3.0)
    table(level[None], names).to_csv(tmp_path / "q.csv", index=False)
    assert "Percent, by their numbers." in read_canopy_pixels(tmp_path / "q.csv", None).said
    cube = {"reflectance": (("y", "x", "band"), seen[None, None])}
    image = xr.Dataset(cube, {"wavelength": ("band", nm)})
    image["reflectance"].attrs["units"] = "W m-2 sr-1 um-1"
    image.to_netcdf(tmp_path / "i.nc")
    with pytest.raises(InputError, match="says that it is radiance: W m-2"):
        read_canopy_pixels(tmp_path / "i.nc", None)


def test_reflectance_that_only_looks_like_radiance_is_read(tmp_path):
    """Where the line of oxygen is masked, over dark water, and in a folder of that name."""
    nm = np.arange(400.0, 1000.0, 5.0)
    canopy, line = np.where(nm > 700.0, 0.4, 0.05), np.abs(nm - 761.0) < 3.0
    water = np.where(line, 0.003, 0.004)
    names = [f"{at:g}" for at in nm]
    for seen in (np.where(line, -9999.0, canopy)[None], np.where(line, 0.0, canopy)[None],
                 np.stack([water] * 6 + [canopy] * 4)):  # fmt: skip
        table(seen, names).to_csv(tmp_path / "p.csv", index=False)
        assert read_canopy_pixels(tmp_path / "p.csv", None).bands.size == nm.size
    shape = {"width": 4, "height": 2, "count": 11, "dtype": "float32"}
    shape["transform"] = rasterio.Affine(1.0, 0.0, 5.0, 0.0, -1.0, 9.0)
    for folder in ("sr", "radiance"):
        path = tmp_path / folder / "radiance_to_refl.dat"
        path.parent.mkdir()
        with rasterio.open(path, "w", driver="ENVI", **shape) as file:
            file.write(SPECTRA.T.reshape(11, 2, 4).astype(np.float32))
            file.descriptions = NAMES
        assert read_canopy_pixels(path, fx.sensor("sentinel_2a")).shape == (2, 4)
    header = path.with_suffix(".hdr")
    header.write_text(re.sub(r"(?<=description = ){[^}]*}", "{A radiance}", header.read_text()))
    with pytest.raises(InputError, match="says that it is radiance: A radiance"):
        read_canopy_pixels(path, fx.sensor("sentinel_2a"))


@pytest.mark.parametrize("name", ["enmap", "emit", "aviris_ng"])
def test_names_of_a_sensor_s_own_are_no_wavelengths(name, tmp_path):
    sensor = fx.sensor(name)
    seen = np.full((1, len(sensor.bands.names)), 0.2)
    table(seen, sensor.bands.names).to_csv(tmp_path / "p.csv", index=False)
    assert read_canopy_pixels(tmp_path / "p.csv", sensor).bands.names == sensor.bands.names


@pytest.mark.parametrize(
    ("names", "refused"),
    [
        ([f"b{i}" for i in range(1, 11)], "b1 to b10 only count"),
        (["plot", *(f"band_{i}" for i in range(1, 5))], "band_1 to band_4 only count"),
        ([*(f"band_{i}" for i in range(1, 9)), "band_8A", "band_9"], None),
        (["B2", "B3", "B4", "B8"], None),
    ],
)
def test_bands_of_sentinel_2_that_are_only_counted_are_refused(names, refused, tmp_path):
    table(SPECTRA[:, : len(names)], names).to_csv(tmp_path / "p.csv", index=False)
    if refused is None:
        read = read_canopy_pixels(tmp_path / "p.csv", fx.sensor("sentinel_2a"))
        assert len(read.bands.names) == len(names)
    else:
        with pytest.raises(InputError, match=refused):
            read_canopy_pixels(tmp_path / "p.csv", fx.sensor("sentinel_2a"))


def test_views_that_are_alike_are_one(tmp_path):
    """Straight down, where an azimuth says nothing, and left and right of the sun."""
    frame = table(
        sun_zenith=30.0, view_zenith=[0.4, 0.0, 0.3, 0.0, 9.0, 9.0, 9.0, 9.0],
        sun_azimuth=50.0, view_azimuth=[0, 12, np.nan, 70, 80, 20, 440, -340],
    )  # fmt: skip
    frame.to_csv(tmp_path / "p.csv", index=False)
    read = read_canopy_pixels(tmp_path / "p.csv", fx.sensor("sentinel_2a"))
    views = _views(read, dict.fromkeys(ANGLES), 0.0)
    assert [(v.view_zenith, v.relative_azimuth, len(rows)) for v, rows in views] == [
        (0.0, 0.0, 4), (9.0, 30.0, 4)
    ]  # fmt: skip


def test_azimuths_of_sun_and_view_are_those_of_one_another(tmp_path):
    frame = table(sun_zenith=30.0, sun_azimuth=300.0, view_azimuth=100.0)
    frame.to_csv(tmp_path / "p.csv", index=False)
    read = read_canopy_pixels(tmp_path / "p.csv", fx.sensor("sentinel_2a"))
    assert (read.angles["relative_azimuth"] == -200.0).all()
    assert "azimuth" not in " ".join(read.said)


def test_reflectance_up_to_a_factor_is_doubted(tmp_path):
    path = tmp_path / "i.tif"
    write_geotiff(
        path, SPECTRA.T.reshape(11, 2, 4), NAMES, pixel_m=10.0,
        tags={RELATIVE_TAG: "Reflectance up to one factor"},
    )  # fmt: skip
    said = read_canopy_pixels(path, fx.sensor("sentinel_2a")).said
    assert said[-1].startswith("Reflectance up to one factor. Traits")


@pytest.mark.parametrize(
    ("factor", "doubt"),
    [(1.0, False), (100.0, False), (1e4, False), (1000.0, True), (200.0, True), (255.0, True)],
)
def test_a_near_infrared_that_no_canopies_have_is_doubted(factor, doubt, tmp_path):
    table(np.round(factor * SPECTRA, 3)).to_csv(tmp_path / "p.csv", index=False)
    read = read_canopy_pixels(tmp_path / "p.csv", fx.sensor("sentinel_2a"))
    assert ("in another scale" in " ".join(read.said)) == doubt


def test_bands_of_a_sensor_may_be_named_by_wavelengths(tmp_path):
    names = ["x2190", "1610", "R865", "842 nm", "665"]
    seen = SPECTRA[:, [10, 9, 8, 7, 3]]
    table(seen, names).to_csv(tmp_path / "p.csv", index=False)
    read = read_canopy_pixels(tmp_path / "p.csv", fx.sensor("sentinel_2a"))
    assert read.bands.names == ("B4", "B8", "B8A", "B11", "B12")
    np.testing.assert_allclose(read.reflectance, seen[:, ::-1])


def test_bands_by_colours_and_names_of_catalogues(tmp_path):
    names = ["coastal", "blue", "green", "red", "nir", "swir16", "swir22", "qa_2021"]
    seen = SPECTRA[:, [0, 1, 2, 3, 8, 9, 10, 0]]
    table(seen, names).to_csv(tmp_path / "p.csv", index=False)
    read = read_canopy_pixels(tmp_path / "p.csv", fx.sensor("landsat_8"))
    assert read.bands.names == tuple(f"B{i}" for i in range(1, 8))
    assert read.said[0].endswith("swir22 as B7. Not used as bands: qa_2021.")
    both = table(seen[:, :5], ["blue", "green", "red", "nir", "nir08"])
    both.to_csv(tmp_path / "s.csv", index=False)
    read = read_canopy_pixels(tmp_path / "s.csv", fx.sensor("sentinel_2a"))
    assert read.bands.names == ("B2", "B3", "B4", "B8", "B8A")


def test_wavelengths_are_no_other_numbers_and_none_stands_twice(tmp_path):
    names = ["R560", "sd_665", "665", "year2021", "elevation_1000", "rho 705 nm"]
    table(SPECTRA[:, :6], names).to_csv(tmp_path / "p.csv", index=False)
    read = read_canopy_pixels(tmp_path / "p.csv", None)
    assert read.bands.tolist() == [560.0, 665.0, 705.0]
    assert read.said[0].startswith("Bands: 3 from 560 to 705 nm, R560, 665, rho 705 nm. Not used")
    twice = ["R560", "R665", "x665", "705"]
    table(SPECTRA[:, :4], twice).to_csv(tmp_path / "t.csv", index=False)
    with pytest.raises(InputError, match="R665 and x665 are both of 665 nm"):
        read_canopy_pixels(tmp_path / "t.csv", None)


def test_a_stack_of_xarray_with_a_time(tmp_path):
    cube = SPECTRA.reshape(2, 4, 11).transpose(2, 0, 1)[None]
    where = {"time": [0], "band": NAMES, "y": [20.0, 10.0], "x": [5.0, 15.0, 25.0, 35.0]}
    image = xr.DataArray(cube, where, ("time", "band", "y", "x"), "stackstac")
    image.to_netcdf(tmp_path / "s.nc")
    read = read_canopy_pixels(tmp_path / "s.nc", fx.sensor("sentinel_2a"))
    np.testing.assert_allclose(read.reflectance, SPECTRA, rtol=1e-6)
    assert read.shape == (2, 4)
    twice = xr.concat([image, image.assign_coords(time=[1])], "time")
    twice.to_netcdf(tmp_path / "t.nc")
    with pytest.raises(InputError, match=r"2 along 'time'. Take one"):
        read_canopy_pixels(tmp_path / "t.nc", fx.sensor("sentinel_2a"))


@pytest.fixture
def quick(monkeypatch):
    """Light of a table that is made once, of a small part of its points."""
    monkeypatch.setattr("fynjax.inversion._canopy._POINTS", (4, 2, 3, 2, 2))
    made = CanopyTable.made(CanopyView(35.0))
    monkeypatch.setattr(CanopyTable, "made", lambda view: made)


@pytest.mark.slow  # compiles fits
def test_traits_of_a_table_and_of_an_image(quick, tmp_path):
    pytest.importorskip("rioxarray", reason="the extra `map` is not installed")
    frame = table(
        site=[f"s{i}" for i in range(8)], sun_zenith=[35.0, 35.4, *[50.0] * 4, 60.0, np.nan],
        chlorophyll=np.arange(8.0),
    )  # fmt: skip
    frame.loc[6, NAMES[2:]] = np.nan  # the only one of its sun
    frame.loc[7, NAMES] = np.nan
    frame.to_csv(tmp_path / "p.csv", index=False)
    result = jobs.fit_pixels(
        tmp_path / "p.csv", tmp_path / "t", sensor="sentinel_2a", known=["leaf_angle=50"]
    )
    traits = pd.read_csv(tmp_path / "t" / "traits.csv")
    assert traits["site"].tolist() == frame["site"].tolist()
    assert traits["chlorophyll_given"].tolist() == frame["chlorophyll"].tolist()
    assert traits["status"].eq("fewer than three bands").tolist() == [False] * 6 + [True] * 2
    assert traits["leaf_area_index"].isna().tolist() == [False] * 6 + [True] * 2
    assert (traits["leaf_area_index_q05"] < traits["leaf_area_index"])[:6].all()
    assert "leaf_angle" not in traits
    assert (result.pixels, result.without_data) == (8, 2)
    assert [row.trait for row in result.traits][:2] == ["chlorophyll", "carotenoids"]
    where = {"y": [6200015.0, 6200005.0], "x": 300005.0 + 10.0 * np.arange(4)}
    image = xr.Dataset(
        {name: (("y", "x"), seen.reshape(2, 4)) for name, seen in zip(NAMES, SPECTRA.T)}, where
    )
    image.rio.write_crs(32634).to_netcdf(tmp_path / "i.nc")
    jobs.fit_pixels(
        tmp_path / "i.nc", tmp_path / "m", sensor="sentinel_2a", sun_zenith=35.0,
        known=["leaf_angle=50"],
    )  # fmt: skip
    with xr.open_dataset(tmp_path / "m" / "traits.nc") as maps:
        assert maps["leaf_area_index"].shape == (2, 4)
        assert maps["y"].values.tolist() == where["y"]
        assert maps["chlorophyll"].attrs["units"] == "ug cm-2"
        first = maps["leaf_area_index"].values
    assert first[0, :2] == pytest.approx(traits["leaf_area_index"][:2], rel=1e-3)
    with rasterio.open(tmp_path / "m" / "traits.tif") as file:
        assert file.crs.to_epsg() == 32634
        assert file.transform @ (0, 0) == (300000.0, 6200020.0)
        band = file.descriptions.index("leaf_area_index") + 1
        np.testing.assert_allclose(file.read(band), first, rtol=1e-5)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"sensor": None}, "--sensor sentinel_2a"),
        ({"sensor": "mavic_3m", "names": [f"x{i}" for i in range(11)]}, "three bands of mavic_3m"),
        ({"sun_zenith": None}, "zenith angle of the sun"),
        ({"sun_zenith": 0.61}, "0.61 looks like radians"),
        ({"names": ["sun_zenith [rad]", *NAMES[1:]], "sun_zenith": None}, "zenith in degrees"),
        ({"relative_azimuth": np.inf, "view_zenith": 9.0}, "finite angles of every pixel"),
        ({"known": ["leaf_angle"]}, "NAME=NUMBER"),
        ({"known": ["leaf_angle=57", "leaf_angle=40"]}, "one value of leaf_angle"),
        ({"known": ["lai=3"]}, "no parameter 'lai'"),
        ({"factor": 1e6}, "radiance, or counts"),
    ],
)
def test_wrong_input_is_refused(change, message, quick, tmp_path):
    given = {"sensor": "sentinel_2a", "sun_zenith": 35.0} | change
    names, factor = given.pop("names", NAMES), given.pop("factor", 1.0)
    table(SPECTRA * factor, names).to_csv(tmp_path / "p.csv", index=False)
    with pytest.raises(InputError, match=message):
        jobs.fit_pixels(tmp_path / "p.csv", tmp_path / "o", **given)


def test_soils_that_do_not_cover_the_bands_and_empty_pixels_are_refused(tmp_path):
    frame = table()
    frame.to_csv(tmp_path / "p.csv", index=False)
    given = {"sensor": "sentinel_2a", "sun_zenith": 35.0}
    with jobs.dry_run(), pytest.raises(InputError, match="no parameter 'lai'"):
        jobs.fit_pixels(tmp_path / "p.csv", tmp_path / "o", known=["lai=3"], **given)
    pd.DataFrame({"wavelength": [400, 700, 1000], "soil": [0.1, 0.2, 0.3]}).to_csv(
        tmp_path / "soil.csv", index=False
    )
    with pytest.raises(InputError, match="has none at 16"):
        jobs.fit_pixels(tmp_path / "p.csv", tmp_path / "o", soil=tmp_path / "soil.csv", **given)
    for i in range(8):  # two bands each, and all bands in some pixel
        frame.loc[i, [name for j, name in enumerate(NAMES) if j not in (i, i + 3)]] = np.nan
    frame.to_csv(tmp_path / "e.csv", index=False)
    with pytest.raises(InputError, match="three bands, but none has"):
        jobs.fit_pixels(tmp_path / "e.csv", tmp_path / "o", **given)


def test_a_table_of_many_suns_is_refused(tmp_path):
    frame = pd.concat([table()] * 4).assign(sun_zenith=np.arange(32.0))
    frame.to_csv(tmp_path / "p.csv", index=False)
    with pytest.raises(InputError, match="at most 20 ways"):
        jobs.fit_pixels(tmp_path / "p.csv", tmp_path / "o", sensor="sentinel_2a")

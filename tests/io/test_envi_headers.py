"""Headers of ENVI files, beside Spectral Python."""

import numpy as np
import pytest
from spectral.io import envi

from fynjax._core.errors import InputError
from fynjax.app.io.spectra._envi import read_envi_library, read_header

WHOLE = """ENVI
description = {A flight, over 2 = two plots
 of fynbos}
; bands = 7, a remark
samples = 3
Lines   = 2
bands = 4
header offset = 16
data type = {kind}
byte order = {order}
interleave = bil
wavelength = {{ 450.5,
  550 , 650,
; another remark
  850.25 }}
band names = {{blue, green (cut}}, red, nir}}
reflectance scale factor = 10000
map info = {{UTM, 1, 1, 200000, 6200000, 1, 1, 34, South, WGS-84, units=Meters}}
"""


def written(path, kind=4, order=0, text=WHOLE):
    body = text.replace("{A flight", "{{A flight").replace("fynbos}", "fynbos}}")
    path.write_text(body.format(kind=kind, order=order), "utf-8")
    return path


@pytest.mark.parametrize("order", [0, 1])
@pytest.mark.parametrize("kind", sorted(map(int, envi.envi_to_dtype)))
def test_fields_and_layout_are_those_of_spectral_python(tmp_path, kind, order):
    path = written(tmp_path / "a.hdr", kind, order)
    found = read_header(path)
    with pytest.warns(UserWarning, match="lowercase"):
        theirs = envi.read_envi_header(str(path))
    layout = found.pop("layout")
    assert found == theirs
    assert found["description"].startswith("A flight, over 2")
    assert found["wavelength"] == ["450.5", "550", "650", "850.25"]
    expected = envi.gen_params(theirs)
    for name in ("nrows", "ncols", "nbands", "offset"):
        assert getattr(layout, name) == getattr(expected, name)
    assert layout.dtype == np.dtype(expected.dtype)


@pytest.mark.parametrize("place", ["none, unknown", "", "{{}}", "{{Arbitrary, 1, 1, 0, 0,}}"])
def test_a_place_that_is_no_whole_list_is_left_to_gdal(tmp_path, place):
    text = WHOLE[: WHOLE.index("map info")] + f"map info = {place}\n"
    assert read_header(written(tmp_path / "a.hdr", text=text))["layout"].nbands == 4


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("ENVI\n", "EVNI\n", "starts otherwise"),
        ("samples = 3\n", "", "'samples' is missing"),
        ("samples = 3\n", "samples = three\n", "three"),
        ("samples = 3\n", "samples = -3\n", "negative"),
        ("{kind}", "7", "data type 7"),
        ("{order}", "2", "byte order 2"),
        ("850.25 }}", "850.25", "brace of wavelength is never closed"),
        ("interleave = bil", "interleave = bli", "expected the interleave"),
        ("200000", "2.0D+05", "map info.*'2.0D[+]05'"),
    ],
)
def test_what_is_no_header_is_refused_with_the_reason(tmp_path, old, new, words):
    assert old in WHOLE
    text = WHOLE.replace(old, new)
    if words.startswith("brace"):  # nothing after it may close it either
        text = text[: text.index("band names")]
    with pytest.raises(InputError, match=words):
        read_header(written(tmp_path / "a.hdr", text=text))


def test_a_library_s_value_for_nothing_is_that_of_the_file_and_not_of_its_reflectance(tmp_path):
    """Before the scale is taken off, as Spectral Python has the numbers; 1 and -1 are reflectance
    there, whatever the value for nothing is after scaling."""
    stored = np.array([[500, -9999, 2500, 1], [-1, 600, -9999, 10000]], "<i2")
    (tmp_path / "a.sli").write_bytes(stored.tobytes())
    header = tmp_path / "a.hdr"
    header.write_text(
        "ENVI\nsamples = 4\nlines = 2\nbands = 1\nheader offset = 0\n"
        "file type = ENVI Spectral Library\ndata type = 2\ninterleave = bsq\nbyte order = 0\n"
        "wavelength = {500, 600, 700, 800}\nreflectance scale factor = 10000\n"
        "data ignore value = -9999\nspectra names = {a, b}\n"
    )
    theirs = envi.open(str(header), str(tmp_path / "a.sli")).spectra
    np.testing.assert_array_equal(theirs * 10_000 if theirs.max() <= 1 else theirs, stored)
    expected = np.where(stored == -9999, np.nan, stored / 1e4)
    for one, row in zip(read_envi_library(header), expected, strict=True):
        np.testing.assert_allclose(one.reflectance, row, atol=1e-9)


@pytest.mark.parametrize("key", ["samples", "lines", "bands", "header offset", "byte order"])
def test_a_list_where_a_number_is_to_be_is_refused(tmp_path, key):
    path = written(tmp_path / "a.hdr", text=WHOLE + f"{key} = {{{{ 1, 2 }}}}\n")
    with pytest.raises(InputError, match="no number"):
        read_header(path)


def test_a_list_of_scales_of_a_library_is_refused(tmp_path):
    np.full((2, 3), 0.3, np.float32).tofile(tmp_path / "a.sli")
    text = "ENVI\nsamples = 3\nlines = 2\nbands = 1\ndata type = 4\nbyte order = 0\n"
    text += "wavelength = { 450, 550, 650 }\nspectra names = { a, b }\n"
    for key in ("reflectance scale factor", "data ignore value"):
        (tmp_path / "a.hdr").write_text(text + f"{key} = {{ 1, 2 }}\n")
        with pytest.raises(InputError, match="expected a number"):
            read_envi_library(tmp_path / "a.hdr")

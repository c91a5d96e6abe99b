"""Spectra from a file: `read_spectra_file` recognises the format by the content; and those that are
relative to a white panel made absolute."""

import codecs
from pathlib import Path

import numpy as np

from fynjax._core.errors import InputError, in_file, names_file
from fynjax._core.tables import as_utf8
from fynjax.app.io.spectra._asd import is_asd, read_asd
from fynjax.app.io.spectra._envi import read_envi_library
from fynjax.app.io.spectra._field import read_field_spectrum
from fynjax.app.io.spectra._names import SUFFIXES, another, as_transmittance
from fynjax.app.io.spectra._record import MeasuredSpectrum, check_spectrum
from fynjax.app.io.spectra._small import read_jcamp, read_small_spectrometer, read_usgs
from fynjax.app.io.spectra._text import read_text_spectra
from fynjax.app.io.text import existing_file, read_bytes


def read_spectra_file(path: str | Path) -> list[MeasuredSpectrum]:
    r"""Read every spectrum of a file.

    Recognised by content, not by name: ASD binary (versions 6, 7, 8); ASD's ASCII export;
    reflectance of SVC (`.sig`) and Spectral Evolution (`.sed`); text of Ocean Optics, Jaz and
    Avantes; JCAMP-DX in plain numbers; the USGS library, with its wavelengths beside it; ECOSTRESS
    and older ASTER library text; tables as `open_table` takes them (CSV, TSV, Excel) with a
    wavelength column and one column a spectrum, long with a row for each sample and wavelength, or
    wide with one row a spectrum and wavelengths as column names (EcoSIS, SPECCHIO); ENVI
    spectral libraries (give the `.sli` or its `.hdr`). A `.gz` ending is unpacked.

    **Arguments:** `path`, the file.

    **Returns:** a list of `MeasuredSpectrum`, wavelengths in nm and ascending, fractions 0 to 1.
    What was repaired on the way (unit conversion, sorting, single impossible values set to NaN) is
    written in `meta["repairs"]`.

    **Raises:** `InputError` naming the file, for an unknown format, a file cut short, an ASD file
    that holds radiance or has no usable white reference, another quantity than reflectance or
    transmittance, reflectance of another scale than percent or times 10000, that is negative
    or above 1, wavelengths in µm under a nm header, or a spectrum of NaN only.

    >>> import pathlib, tempfile
    >>> from fynjax.app.io.spectra import read_spectra_file
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = pathlib.Path(folder) / "leaves.csv"
    ...     _ = path.write_text("wavelength,protea,restio\n500,0.05,0.08\n800,0.48,0.40\n")
    ...     protea, restio = read_spectra_file(path)
    >>> restio.name, restio.reflectance
    ('restio', array([0.08, 0.4 ]))
    """
    spectra, refused = read_usable_spectra(path)
    if refused:
        raise refused[0][1]
    return spectra


@names_file
def read_usable_spectra(
    path: str | Path,
) -> tuple[list[MeasuredSpectrum], list[tuple[str, InputError]]]:
    """The spectra of a file that can be used, and name and reason of those that cannot.

    As `read_spectra_file`, but one bad spectrum among many does not stop the others.

    **Arguments:** `path`, the file.

    **Returns:** usable spectra; name and error of each other.

    **Raises:** `InputError` if the file as a whole cannot be read.
    """
    path = existing_file(path, "a file of spectra")
    data = read_bytes(path)
    suffixes = [suffix.lower() for suffix in path.suffixes]
    suffixes = suffixes[:-1] if suffixes[-1:] == [".gz"] else suffixes
    if not data.strip():
        raise InputError("the file is empty")
    if is_asd(data):
        spectra = [read_asd(path, data)]
    elif suffixes[-1:] == [".asd"]:
        kind = "text" if _is_text(data) else "no ASD file"
        raise InputError(
            f"expected an ASD binary of version 6, 7 or 8, but the content is {kind}; "
            "an ASCII export must end in .txt or .csv"
        )
    elif suffixes[-1:] in ([".hdr"], [".sli"], [".slb"]):
        spectra = read_envi_library(path)
    elif _is_text(data) or data[:4] == b"PK\3\4":  # an Excel workbook
        spectra = _of_quantity(_text_spectra(data, path), suffixes)
    else:
        raise InputError(
            "unknown format: neither ASD binary (as6, as7, as8), ENVI spectral library, nor text"
        )
    usable, refused = [], []
    for spectrum in spectra:
        try:
            with in_file(path):
                usable.append(check_spectrum(spectrum))
        except InputError as error:
            refused.append((spectrum.name, error))
    return usable, refused


def _text_spectra(data: bytes, path: Path) -> list[MeasuredSpectrum]:
    """Spectra of a file of text, whose letters are decoded once for all its readers."""
    if data[:4] != b"PK\3\4":
        data = as_utf8(data, path)
        for read in (read_field_spectrum, read_usgs, read_small_spectrometer, read_jcamp):
            if (alone := read(data, path)) is not None:
                return [alone]
    return read_text_spectra(data, path)


def _of_quantity(spectra: list[MeasuredSpectrum], suffixes: list[str]) -> list[MeasuredSpectrum]:
    """The spectra as of the quantity that the file's ending states, such as `.trm`.

    **Raises:** `InputError` for an ending of another quantity, such as `.irr`.
    """
    for suffix in set(suffixes) & set(SUFFIXES):
        if SUFFIXES[suffix] != "transmittance":
            raise another(SUFFIXES[suffix], f"the file ends in {suffix}")
        spectra = [
            one if one.transmittance is not None else as_transmittance(one) for one in spectra
        ]
    return spectra


def _is_text(data: bytes) -> bool:
    if data[:2] in (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE):  # spreadsheets' "Unicode text"
        return True
    sample = np.frombuffer(data[:4096], np.uint8)
    return not bool(np.any((sample < 9) | ((sample > 13) & (sample < 32))))


@names_file
def reflectances(path: Path) -> list[tuple[np.ndarray, np.ndarray]]:
    """Reflectance spectra of a file.

    **Arguments:** `path`, the file, as `read_spectra_file` reads it.

    **Returns:** for each spectrum wavelengths [nm] and reflectance [-], both of shape (band,).

    **Raises:** `InputError` as `read_spectra_file`, and where the file has no reflectance.
    """
    spectra = [
        (s.wavelength, s.reflectance) for s in read_spectra_file(path) if s.reflectance is not None
    ]
    if not spectra:
        raise InputError("a reflectance spectrum was expected, but the file has none")
    return spectra


@names_file
def read_curve(path: str | Path, what: str) -> tuple[np.ndarray, np.ndarray]:
    """The one reflectance spectrum of a file, such as of a panel.

    **Arguments:** `path`, the file, of any format that `read_spectra_file` takes; `what` it is of,
    for the error.

    **Returns:** wavelength [nm] and reflectance [-], both of shape (band,), without missing bands.

    **Raises:** `InputError` as `read_spectra_file`, and if the file has none or several.
    """
    curves = reflectances(Path(path))
    if len(curves) > 1:
        raise InputError(f"expected one spectrum of {what}, but found {len(curves)}")
    wavelength, values = curves[0]
    have = np.isfinite(values)
    return wavelength[have], values[have]


def with_panel(
    spectrum: MeasuredSpectrum, wavelength: np.ndarray, panel: np.ndarray
) -> MeasuredSpectrum:
    """The spectrum with its reflectance multiplied by that of the white panel.

    **Arguments:**

    - `spectrum`: reflectance relative to a panel; one whose file held the panel's calibration is
      left as it is, and so is transmittance.
    - `wavelength` [nm], `panel` [-]: reflectance of the panel, of shape (band,), ascending.

    **Returns:** the spectrum, with a note; bands beyond the panel's are missing. NumPy; not
    differentiable.

    **Raises:** `InputError` where the panel has none of the spectrum's bands.
    """
    if spectrum.reflectance is None or spectrum.meta.get("panel") == "applied":
        return spectrum
    at = np.interp(spectrum.wavelength, wavelength, panel, left=np.nan, right=np.nan)
    if not np.isfinite(at).any():
        raise InputError(
            f"the panel's reflectance, {wavelength[0]:g} to {wavelength[-1]:g} nm, has none of the "
            f"bands of spectrum {spectrum.name!r}"
        )
    notes = [f"multiplied by the panel's reflectance, {np.nanmin(at):.3f} to {np.nanmax(at):.3f}"]
    if beyond := int((np.isnan(at) & np.isfinite(spectrum.reflectance)).sum()):
        notes.append(f"{beyond} bands beyond the panel's table set to missing")
    values = spectrum.reflectance * at
    return spectrum.noted(*notes, meta={"panel": "applied"}, reflectance=values)

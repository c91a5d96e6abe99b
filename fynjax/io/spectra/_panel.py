"""Reflectance relative to a white panel made absolute by the panel's own reflectance."""

from pathlib import Path

import numpy as np

from fynjax._core.errors import InputError, names_file
from fynjax.io.spectra._read import reflectances
from fynjax.io.spectra._record import MeasuredSpectrum


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

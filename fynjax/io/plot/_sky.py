"""Tables of the sky that a plot file names."""

from pathlib import Path

import numpy as np

from fynjax._core.errors import InputError, names_file
from fynjax.io.plot._plot import Floats
from fynjax.io.plot._rows import SkyPatternRow, SkyRow
from fynjax.io.text import read_rows


@names_file
def read_sky(path: Path) -> tuple[Floats, Floats]:
    """Read how much of the light is diffuse.

    **Arguments:** `path`, a CSV file with the columns of `SkyRow`.

    **Returns:** wavelengths [nm], rising, and diffuse over global irradiance at each [-].

    **Raises:** `InputError` for wavelengths that do not rise, and as `fynjax.io.text.read_rows`.
    """
    rows = read_rows(path, SkyRow, "a sky table")
    wavelength = np.array([row.wavelength_nm for _, row in rows])
    if (falls := np.flatnonzero(np.diff(wavelength) <= 0)).size:
        raise InputError(
            f"expected rising wavelengths, but {wavelength[falls[0] + 1]:g} follows "
            f"{wavelength[falls[0]]:g}",
            row=rows[falls[0] + 1][0],
            column="wavelength_nm",
        )
    return wavelength, np.array([row.diffuse_fraction for _, row in rows])


@names_file
def read_sky_pattern(path: Path) -> Floats:
    """Read where the sky is bright.

    **Arguments:** `path`, a CSV file with the columns of `SkyPatternRow`.

    **Returns:** relative radiance [zenith, azimuth] at even steps from 0 to 90 degrees and from
    north round clockwise.

    **Raises:** `InputError` for places that are no even grid, and a sky without light.
    """
    rows = [row for _, row in read_rows(path, SkyPatternRow, "a pattern of the sky")]
    zenith = np.unique([row.zenith_deg for row in rows])
    azimuth = np.unique([row.azimuth_deg for row in rows])
    even = len(zenith) > 1 and np.allclose(zenith, np.linspace(0.0, 90.0, len(zenith)), atol=1e-3)
    around = np.allclose(azimuth, np.arange(len(azimuth)) * 360.0 / len(azimuth), atol=1e-3)
    places = {(row.zenith_deg, row.azimuth_deg) for row in rows}
    if not (even and around and len(places) == len(rows) == len(zenith) * len(azimuth)):
        raise InputError(
            "expected every pair of even zenith angles from 0 to 90 degrees and even azimuths from "
            f"0 on once, 360 left out, but got {len(rows)} rows with {len(zenith)} zenith angles "
            f"and {len(azimuth)} azimuths"
        )
    if not any(row.radiance > 0 for row in rows):
        raise InputError("expected some light, but every radiance is 0")
    ordered = sorted(rows, key=lambda row: (row.zenith_deg, row.azimuth_deg))
    return np.array([row.radiance for row in ordered]).reshape(len(zenith), len(azimuth))

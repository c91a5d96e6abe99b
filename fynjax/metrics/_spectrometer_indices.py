"""The indices of the imaging-spectrometer comparison (figure 12 of the fynbos scene paper).

The paper names sixteen and prints no formula. Here are the fourteen that have one in the
literature, over stated wavelengths; MEVI and SARE are left out, since no published formula of that
name was found.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from numpy.typing import ArrayLike

from fynjax._core.spectral import box_matrix, check_wavelength

Values = Float[Array, "*spectrum"]

SPECTROMETER_BANDS: dict[str, tuple[float, float]] = {
    "B": (465.0, 485.0),
    "G": (544.0, 576.0),
    "R": (634.0, 666.0),
    "RE": (714.0, 746.0),
    "N": (834.0, 886.0),
    "R705": (700.0, 710.0),
    "R750": (745.0, 755.0),
}
"""Wavelengths that a spectrum is averaged over [nm]: those of the drone camera `mavic_3m`, so that
its indices and the spectrometer's are the same quantities; blue as RedEdge-3 has it; and two narrow
bands."""


@dataclass(frozen=True)
class SpectrometerIndex:
    """One index: its formula as code and as text, its source, and which bands it takes."""

    name: str
    function: Callable[[Mapping[str, Values]], Values]
    """Index of the averages over `SPECTROMETER_BANDS`, by name."""
    formula: str
    """Formula of the index in the bands' letters."""
    bands: tuple[str, ...]
    source: str
    """Author and year; and where the name means something else elsewhere."""


def _index(
    name: str, function: Callable[..., Values], formula: str, letters: str, source: str
) -> SpectrometerIndex:
    names = tuple(letters.split())
    return SpectrometerIndex(
        name, lambda b: function(*(b[k] for k in names)), formula, names, source
    )


_ALL = (
    _index("NDVI", lambda r, n: (n - r) / (n + r), "(N-R)/(N+R)", "R N", "Rouse et al. (1974)"),
    _index("NDRE", lambda e, n: (n - e) / (n + e), "(N-RE)/(N+RE)", "RE N", "Barnes et al. (2000)"),
    _index("GNDVI", lambda g, n: (n - g) / (n + g), "(N-G)/(N+G)", "G N", "Gitelson et al. (1996)"),
    _index(
        "NormNIR",
        lambda g, r, n: n / (n + r + g),
        "N/(N+R+G)",
        "G R N",
        "Sripada et al. (2006)",
    ),
    _index(
        "LCI",
        lambda r, e, n: (n - e) / (n + r),
        "(N-RE)/(N+R)",
        "R RE N",
        "Datt (1999), who has the wavelengths 850, 710 and 680 nm",
    ),
    _index(
        "EVI",
        lambda b, r, n: 2.5 * (n - r) / (n + 6.0 * r - 7.5 * b + 1.0),
        "2.5*(N-R)/(N+6*R-7.5*B+1)",
        "B R N",
        "Huete et al. (2002)",
    ),
    _index(
        "SAVI",
        lambda r, n: 1.5 * (n - r) / (n + r + 0.5),
        "1.5*(N-R)/(N+R+0.5)",
        "R N",
        "Huete (1988), L = 0.5",
    ),
    _index(
        "ARVI",
        lambda b, r, n: (n - 2.0 * r + b) / (n + 2.0 * r - b),
        "(N-2*R+B)/(N+2*R-B)",
        "B R N",
        "Kaufman and Tanre (1992), gamma = 1: red replaced by R - (B - R)",
    ),
    _index(
        "RENDVI",
        lambda low, high: (high - low) / (high + low),
        "(R750-R705)/(R750+R705)",
        "R705 R750",
        "Gitelson and Merzlyak (1994)",
    ),
    _index("ReCI", lambda e, n: n / e - 1.0, "N/RE-1", "RE N", "Gitelson et al. (2003)"),
    _index(
        "TVI",
        lambda r, n: jnp.sqrt((n - r) / (n + r) + 0.5),
        "sqrt((N-R)/(N+R)+0.5)",
        "R N",
        "Rouse et al. (1974), as in table 4",
    ),
    _index(
        "RESR",
        lambda r, e: e / r,
        "RE/R",
        "R RE",
        "Red edge over red; others call N/RE the red-edge simple ratio, which is ReCI + 1",
    ),
    _index(
        "GDVI",
        lambda r, n: (n**2 - r**2) / (n**2 + r**2),
        "(N^2-R^2)/(N^2+R^2)",
        "R N",
        "Wu (2014), exponent 2, as in table 4; N-G elsewhere",
    ),
    _index("IPVI", lambda r, n: n / (n + r), "N/(N+R)", "R N", "Crippen (1990)"),
)

_PLAIN = (0.05, 0.1, 0.4)
"""Reflectance of bands of which every index is defined."""

SPECTROMETER_INDICES: dict[str, SpectrometerIndex] = {index.name: index for index in _ALL}
"""Indices of figure 12 that have a published formula, by name, in the paper's order."""


def spectrometer_indices(
    wavelength: ArrayLike, spectra: Float[Array | np.ndarray, "*spectrum wavelength"]
) -> dict[str, Float[Array, "*spectrum"]]:
    """Indices of figure 12 from reflectance spectra [-], by name.

    **Arguments:**

    - `wavelength`: of the spectra [nm], increasing and concrete (not traced).
    - `spectra`: reflectance fractions, wavelengths on the last axis.

    A band is the mean of the spectrum, linear between its wavelengths, over `SPECTROMETER_BANDS`.

    **Returns:** each index by its name. An index is left out where the spectra do not reach one of
    its bands or have no wavelength within a band's width of its middle. Values are NaN where they
    are undefined (0/0, the root of a negative number).

    **Raises:** `InputError` for a grid that is none in nm.

    Differentiable in `spectra` where defined; elsewhere the gradient is 0.

    >>> import numpy as np
    >>> from fynjax.metrics import spectrometer_indices
    >>> wavelength = np.arange(400.0, 1001.0, 10.0)
    >>> index = spectrometer_indices(wavelength, np.where(wavelength < 700.0, 0.05, 0.45))
    >>> round(float(index["NDVI"]), 3), len(index)
    (0.8, 14)
    """
    grid = check_wavelength(wavelength)
    values = jnp.asarray(spectra)
    values = values.astype(jnp.result_type(values.dtype, jnp.float32))
    bands: dict[str, Values] = {}
    for name, (low, high) in SPECTROMETER_BANDS.items():
        centre, width = 0.5 * (low + high), high - low
        if grid[0] > low or grid[-1] < high or np.abs(grid - centre).min() > width:
            continue
        weights = jnp.asarray(box_matrix(grid, centre, width)[0], values.dtype)
        used = weights != 0.0  # a NaN elsewhere in the spectrum must not reach this band
        bands[name] = jnp.sum(jnp.where(used, values, 0.0) * weights, axis=-1)
    values_by_name = {}
    for index in _ALL:
        if set(index.bands) <= set(bands):
            # Ordinary bands stand in where an index is undefined, so that its slope there is 0.
            defined = jnp.isfinite(index.function(bands))
            safe = {k: jnp.where(defined, bands[k], plain) for k, plain in zip(index.bands, _PLAIN)}
            values_by_name[index.name] = jnp.where(defined, index.function(safe), jnp.nan)
    return values_by_name

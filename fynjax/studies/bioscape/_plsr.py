"""The published regression from a plot's spectrum to its mean leaf mass per area."""

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from fynjax._core.errors import InputError
from fynjax.studies.bioscape._tables import find_table

LEAF_MASS_MODEL = "*LMA*model*.json", "a regression of leaf mass per area on reflectance"


@dataclass(frozen=True)
class SpectralRegression:
    """Partial least squares regressions of a trait, whose mean counts.

    They take spectra of length one: reflectance over the root of its summed squares in the
    model's bands.
    """

    wavelength: Float[np.ndarray, " band"]
    """Centres of the bands [nm]."""
    coefficients: Float[np.ndarray, "member band"]
    intercepts: Float[np.ndarray, " member"]

    def predict(
        self,
        wavelength: Float[np.ndarray, " input"],
        reflectance: Float[np.ndarray, "spectrum input"],
    ) -> Float[np.ndarray, " spectrum"]:
        """The trait of each spectrum; NaN where a band of the model has no value.

        Raises `ValueError` for wavelengths that do not have the model's bands within 1 nm.
        """
        near = np.abs(np.subtract.outer(self.wavelength, wavelength)).argmin(axis=1)
        apart = np.abs(wavelength[near] - self.wavelength)
        if apart.max() > 1.0:
            raise ValueError(
                f"the regression has a band at {self.wavelength[apart.argmax()]:g} nm, which the "
                "spectra do not have within 1 nm"
            )
        spectra = reflectance[:, near]
        unit = spectra / np.linalg.norm(spectra, axis=1, keepdims=True)
        return (unit @ self.coefficients.T + self.intercepts).mean(axis=1)


def read_leaf_mass_model(folder: str | Path) -> SpectralRegression | None:
    """The regression of leaf mass per area [g m-2] in a folder of BioSCape's tables, or `None`.

    Raises `InputError` for a file that is no such regression.
    """
    path = find_table(Path(folder), LEAF_MASS_MODEL)
    if path is None:
        return None
    try:
        read = json.loads(path.read_text("utf-8"))
        wavelength = np.asarray(read["wavelengths"], float)
        coefficients = np.asarray(read["coefficients"], float).reshape(-1, wavelength.size)
        intercepts = np.asarray(read["intercepts"], float).ravel()
    except (OSError, UnicodeDecodeError, ValueError, KeyError, TypeError) as error:
        raise InputError(
            "expected a regression: JSON with `wavelengths`, and `coefficients` and `intercepts` "
            f"of each member, but {type(error).__name__}: {error}",
            file=path,
        ) from error
    if intercepts.size != len(coefficients) or not wavelength.size:
        raise InputError(
            f"expected as many intercepts as members, but got {intercepts.size} and "
            f"{len(coefficients)}",
            file=path,
        )
    return SpectralRegression(wavelength, coefficients, intercepts)

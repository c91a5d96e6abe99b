"""Recipe of `fynjax/scene/data/soil_shapes.csv`: how spectra of soils differ in shape.

Run `python -m tools.make_soil_shapes LIBRARY.csv` with the spectral library of the package earthlib
1.1.0 as a table (columns class, type and wavelengths in nm). Of the logarithm of each of its soils
over that of the shipped dry soil, brightness (a constant) and moisture (wet over dry) are taken
out; what is left has the shape vectors as its leading principal components about zero. One unit of
each is what soils have as root mean square.
"""

import sys
from pathlib import Path

import numpy as np
import pandas as pd

SHAPES = 4
FOLDER = Path(__file__).parents[1] / "fynjax/scene/data"


def shapes(soils: np.ndarray, dry: np.ndarray, wet: np.ndarray) -> np.ndarray:
    """Shape vectors [vector, wavelength] of soils [soil, wavelength]."""
    rest = np.log(soils) - np.log(dry)
    taken = np.stack([np.ones_like(dry), np.log(wet / dry)], axis=1)
    rest = rest - (taken @ np.linalg.lstsq(taken, rest.T)[0]).T
    _, size, vectors = np.linalg.svd(rest, full_matrices=False)
    unit = size[:SHAPES, None] * vectors[:SHAPES] / np.sqrt(len(soils))
    # Upwards in the short-wave infrared: the sign of a component is arbitrary.
    return unit * np.where(unit[:, -40:].mean(axis=1) < 0.0, -1.0, 1.0)[:, None]


def main(library: str) -> None:
    """Write the shape vectors of the soils of a library."""
    ground, table = pd.read_csv(FOLDER / "background.csv"), pd.read_csv(library)
    soils = table[(table["class"] == "bare") & (table["type"] == "soil")].iloc[:, 6:]
    grid, own = ground["wavelength_nm"].to_numpy(float), soils.columns.to_numpy(float)
    # The library ends at 2450 nm; its last value is repeated.
    spectra = np.stack([np.interp(grid, own, row) for row in soils.to_numpy(float)])
    found = shapes(spectra, ground["dry_soil"].to_numpy(), ground["wet_soil"].to_numpy())
    columns = {f"shape_{i + 1}": vector.round(5) for i, vector in enumerate(found)}
    pd.DataFrame({"wavelength_nm": grid.astype(int), **columns}).to_csv(
        FOLDER / "soil_shapes.csv", index=False
    )


if __name__ == "__main__":
    main(sys.argv[1])

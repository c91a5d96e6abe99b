"""Recipe of `fynjax/app/compare/data/vegetation_spectra.csv`: how shrubland reflects, as measured.

Run `python -m tools.make_vegetation_spectra FOLDER` with the folder that holds `bioscape` and
`satellite` of the reference data. Mean and covariance of the logarithm of reflectance on 10 nm,
without the water bands: AVIRIS-NG spectra of BioSCape's fynbos plots (each plot counts one, however
often it was flown over), and the pixels of one EMIT tile of dry shrubland (together `TILE` plots).
The covariance is kept as factors, its leading principal components, and what they leave at each
wavelength.
"""

import sys
from pathlib import Path

import numpy as np
import pandas as pd
import spectral

TILE = 5.0
FACTORS = 8
OUTPUT = Path(__file__).parents[1] / "fynjax/app/compare/data/vegetation_spectra.csv"
WINDOWS = ((420.0, 1310.0), (1450.0, 1760.0), (1980.0, 2430.0))
"""Ends of the wavelengths that are kept [nm]."""


def grid() -> np.ndarray:
    """Wavelengths of the table [nm]."""
    return np.concatenate([np.arange(low, high + 1.0, 10.0) for low, high in WINDOWS])


def averaged(wavelength: np.ndarray, spectra: np.ndarray) -> np.ndarray:
    """Logarithms of spectra [spectrum, band], averaged within 5 nm of each wavelength kept."""
    near = [abs(wavelength - at) <= max(5.0, abs(wavelength - at).min()) for at in grid()]
    return np.log(np.stack([spectra[:, bands].mean(axis=1) for bands in near], axis=1))


def fynbos(folder: Path) -> tuple[np.ndarray, np.ndarray]:
    """Log spectra of the BioSCape plots, and the name of each one's plot."""
    table = pd.read_csv(folder / "bioscape/ANG_RFL_CapePeninsulaVegCenters.csv")
    wavelength = pd.read_csv(folder / "bioscape/ANG_waves.csv").iloc[:, 0].to_numpy()
    values = table.filter(like="Band_").to_numpy()
    kept = (values[:, (wavelength > 415.0) & (wavelength < 1335.0)] > 0.0).all(axis=1)
    return averaged(wavelength, values[kept]), table["Name"].to_numpy()[kept]


def dry_shrubland(folder: Path) -> np.ndarray:
    """Log spectra of the EMIT tile."""
    name = folder / "satellite/emit20250324t221005_jpl_unmix_ex"
    image = spectral.envi.open(f"{name}.hdr", str(name))
    values = np.asarray(image.load()).reshape(-1, image.nbands)
    return averaged(np.asarray(image.bands.centers), values)


def estimate(
    spectra: np.ndarray, plots: np.ndarray, others: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Mean [wavelength], factors [factor, wavelength] and remaining variance [wavelength]."""
    _, place, count = np.unique(plots, return_inverse=True, return_counts=True)
    weight = np.concatenate([1.0 / count[place], np.full(len(others), TILE / len(others))])
    weight /= weight.sum()
    values = np.concatenate([spectra, others])
    mean = weight @ values
    centred = (values - mean) * np.sqrt(weight)[:, None]
    _, size, vectors = np.linalg.svd(centred, full_matrices=False)
    factors = vectors[:FACTORS] * size[:FACTORS, None]
    return mean, factors, (centred**2).sum(axis=0) - (factors**2).sum(axis=0)


def main(folder: Path) -> None:
    """Write the table."""
    mean, factors, rest = estimate(*fynbos(folder), dry_shrubland(folder))
    table = pd.DataFrame({"wavelength_nm": grid(), "mean_log": mean, "rest_sd": np.sqrt(rest)})
    for place, factor in enumerate(factors, 1):
        table[f"factor_{place}"] = factor
    table.round(5).to_csv(OUTPUT, index=False)


if __name__ == "__main__":
    main(Path(sys.argv[1]))

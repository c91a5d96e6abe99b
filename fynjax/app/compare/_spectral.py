"""Two sets of spectra in numbers: figure 11, table 5 and figure 12 of the fynbos scene paper."""

from collections.abc import Sequence
from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np
import pandas as pd
from jaxtyping import Float

from fynjax._core.errors import InputError
from fynjax.app.compare._published import figure12_2006, table5_2006
from fynjax.app.compare._spectra import SpectraSample
from fynjax.metrics import (
    SPECTRAL_REGIONS,
    VEGETATION_INDICES,
    WATER_WINDOWS,
    MatchingMethod,
    WavelengthMatch,
    index_bands,
    match_wavelengths,
    misfit_decomposition,
    spectral_agreement,
    spectral_mask,
    vegetation_indices,
)

PAPER_SWIR2_MEANS = (0.063, 0.008)
"""Mean reflectance in SWIR2, real and of the paper's simulation, as its text gives them [-]."""

_INDEX_COLUMNS = (
    "index", "formula", "source", "real", "simulated", "difference_percent", "real_std",
    "simulated_std", "paper_lower_percent", "paper_upper_percent", "paper_sign",
)  # fmt: skip
_CONSTANT = 1e-6
"""Range over largest value below which a spectrum is constant, but for rounding."""

FIGURE_12 = (
    "NDVI", "NDRE", "GNDVI", "NormNIR", "LCI", "EVI", "SAVI", "ARVI", "RENDVI", "ReCI", "TVI",
    "RESR", "GDVI", "IPVI",
)  # fmt: skip
"""Indices that the paper's figure 12 names and a published formula is known of, in its order."""

LEFT_OUT = "MEVI and SARE are left out: no published formula of these names was found."
"""Indices that a table of a spectrometer's does not hold, in a sentence."""


@dataclass(frozen=True)
class SpectralComparison:
    """All numbers of a pair of sets of spectra."""

    real: SpectraSample
    simulated: SpectraSample
    match: WavelengthMatch
    windows: tuple[tuple[float, float], ...]
    """Wavelengths that are left out [nm]."""
    spectra: pd.DataFrame
    """A row for each common band: means and standard deviations, and whether it is used."""
    regions: pd.DataFrame
    """A row for each region that both cover: table 5."""
    misfit: pd.DataFrame
    """A row for each of them: what the error is made of."""
    indices: pd.DataFrame
    """A row for each index of figure 12."""
    notes: tuple[str, ...]


def compare_spectra(
    real: SpectraSample,
    simulated: SpectraSample,
    *,
    method: MatchingMethod = "auto",
    windows: Sequence[tuple[float, float]] = WATER_WINDOWS,
) -> SpectralComparison:
    r"""Compare the mean spectra of two sets, by region, and their indices.

    **Arguments:**

    - `real`, `simulated`: reflectance [spectrum, wavelength] [-], as of `read_spectra_sample`.
    - `method`: how the grids are brought together, as `fynjax.metrics.match_wavelengths` has it.
    - `windows`: wavelengths to leave out [nm]. The edges of the sensor (below 400 and above 2450
      nm) always are.

    **Returns:** a `SpectralComparison`: tables of bands, regions, misfit and indices, and notes.

    **Raises:** `InputError` where the grids have too little in common.

    >>> import pathlib, tempfile
    >>> import numpy as np
    >>> from fynjax.app.compare import compare_spectra, read_spectra_sample
    >>> header = "wavelength,a,b\n"
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     samples = []
    ...     for name, offset in (("real", 0.0), ("simulated", 0.02)):
    ...         rows = [f"{w},{w / 5e3 + offset},{w / 4e3 + offset}" for w in range(450, 1001, 10)]
    ...         path = pathlib.Path(folder) / f"{name}.csv"
    ...         _ = path.write_text(header + "\n".join(rows))
    ...         samples.append(read_spectra_sample([path]))
    >>> comparison = compare_spectra(*samples)
    >>> comparison.regions.set_index("region")["rmse"].round(3).to_dict()
    {'full': 0.02, 'vnir': 0.02}
    """
    match = match_wavelengths(
        real.wavelength,
        simulated.wavelength,
        real_fwhm=real.fwhm,
        simulated_fwhm=simulated.fwhm,
        method=method,
    )
    x, y = real.values @ match.real.T, simulated.values @ match.simulated.T
    means = x.mean(axis=0), y.mean(axis=0)
    grid = match.wavelength
    used = spectral_mask(grid, "full", windows)
    spectra = pd.DataFrame(
        {
            "wavelength_nm": grid,
            "used": used,
            "real_mean": means[0],
            "real_std": _spread(x),
            "simulated_mean": means[1],
            "simulated_std": _spread(y),
        }
    )
    regions, misfits, uncovered = [], [], []
    constant = False
    for name in SPECTRAL_REGIONS:
        try:
            mask = spectral_mask(grid, name, windows)
        except InputError:
            uncovered.append(name)
            continue
        regions.append(_region_row(name, means, mask, grid))
        flat = is_constant(means[0][mask])
        misfits.append(_misfit_row(name, means, mask, flat))
        constant |= flat
    indices = _index_table(grid, x, y)
    return SpectralComparison(
        real=real,
        simulated=simulated,
        match=match,
        windows=tuple((float(a), float(b)) for a, b in windows),
        spectra=spectra,
        regions=pd.DataFrame(regions),
        misfit=pd.DataFrame(misfits),
        indices=indices,
        notes=(
            f"Real: {real.description()}",
            f"Simulated: {simulated.description()}",
            match.statement,
            *_range_notes(grid, int(used.sum()), windows, uncovered),
            *(["No index: the spectra do not reach its bands."] if indices.empty else []),
            *([_UNDEFINED] if constant else []),
        ),
    )


_UNDEFINED = (
    "The real spectrum is constant in a region: its correlation, its NRMSE and the line through it "
    "are undefined there."
)


def _range_notes(
    grid: Float[np.ndarray, " band"],
    used: int,
    windows: Sequence[tuple[float, float]],
    uncovered: Sequence[str],
) -> list[str]:
    """Bands and regions that are compared and left out, in sentences."""
    left_out = "".join(f", {low:g} to {high:g} nm" for low, high in windows)
    notes = [f"Left out: below 400 and above 2450 nm{left_out}; {used} bands are compared."]
    full = SPECTRAL_REGIONS["full"]
    if grid[0] > full[0] + 50.0 or grid[-1] < full[1] - 50.0:
        notes.append(
            f"Both cover {grid[0]:.0f} to {grid[-1]:.0f} nm only, so 'full' here is less than the "
            "paper's 400 to 2450 nm."
        )
    if uncovered:
        notes.append(f"Not covered: {', '.join(uncovered)}.")
    return notes


def is_constant(values: np.ndarray) -> bool:
    """Whether values are equal but for rounding, so that nothing can be correlated with them."""
    return bool(np.ptp(values) <= _CONSTANT * np.abs(values).max())


def _spread(values: np.ndarray) -> np.ndarray:
    """Standard deviation over the spectra; of a single one there is none."""
    if len(values) < 2:
        return np.full(values.shape[1], np.nan)
    return np.asarray(values.std(axis=0))


def _region_row(
    name: str, means: tuple[np.ndarray, np.ndarray], mask: np.ndarray, grid: np.ndarray
) -> dict[str, object]:
    agreement = spectral_agreement(jnp.asarray(means[0]), jnp.asarray(means[1]), mask)
    paper = table5_2006()[name]
    real = means[0][mask]
    flat = is_constant(real)
    alike = flat or is_constant(means[1][mask])
    swir2 = name == "swir2"
    return {
        "region": name,
        "lower_nm": float(grid[mask][0]),
        "upper_nm": float(grid[mask][-1]),
        "bands": int(mask.sum()),
        "real_mean": real.mean(),
        "simulated_mean": means[1][mask].mean(),
        "difference_percent": (
            100.0 * float(agreement.relative_mean_difference) if real.any() else np.nan
        ),
        "spectral_angle_deg": float(agreement.spectral_angle),
        "rmse": float(agreement.rmse),
        "nrmse_percent": np.nan if flat else 100.0 * float(agreement.nrmse),
        "correlation": np.nan if alike else float(agreement.correlation),
        "paper_spectral_angle_deg": paper.spectral_angle,
        "paper_rmse": paper.rmse,
        "paper_nrmse_percent": 100.0 * paper.nrmse,
        "paper_correlation": paper.correlation,
        "paper_real_mean": PAPER_SWIR2_MEANS[0] if swir2 else np.nan,
        "paper_simulated_mean": PAPER_SWIR2_MEANS[1] if swir2 else np.nan,
    }


def _misfit_row(
    name: str, means: tuple[np.ndarray, np.ndarray], mask: np.ndarray, flat: bool
) -> dict[str, object]:
    """The misfit in a region; through a constant (`flat`) real spectrum there is no line."""
    misfit = misfit_decomposition(jnp.asarray(means[0]), jnp.asarray(means[1]), mask)
    shares = zip(("level", "contrast", "shape"), misfit.shares, strict=True)
    row = {
        "rmse": float(misfit.mean_squared_error) ** 0.5,
        **{f"{part}_percent": 100.0 * float(share) for part, share in shares},
        "gain": float(misfit.gain),
        "offset": float(misfit.offset),
        "mean_by_offset": float(misfit.offset),
        "mean_by_gain": float(misfit.mean_by_gain),
        "rmse_without_offset": float(misfit.rmse_without_offset),
        "rmse_without_gain": float(misfit.rmse_without_gain),
        "rmse_without_both": float(misfit.rmse_without_both),
    }
    if flat:
        kept = ("rmse", "rmse_without_offset")
        row = {name: value if name in kept else np.nan for name, value in row.items()}
    return {"region": name, **row, "reading": _reading(row)}


def _reading(row: dict[str, float]) -> str:
    """In words: which single correction explains the error, if one does."""
    corrections = ("offset", "gain", "both")
    rmse, (offset, gain, both) = row["rmse"], (row[f"rmse_without_{c}"] for c in corrections)
    if not np.isfinite([rmse, offset, gain, both]).all():
        return "not defined: the real spectrum is constant"
    if rmse < 1e-6:
        return "no error"
    if both > 0.7 * rmse:
        return "shape: neither offset nor gain repairs it"
    if min(offset, gain) > 1.5 * both and min(offset, gain) > 0.5 * rmse:
        return "offset and gain together"
    if offset < 0.67 * gain:
        return "an offset explains it better than a gain"
    if gain < 0.67 * offset:
        return "a gain explains it better than an offset"
    return "offset or gain: these spectra do not tell which"


def _index_table(grid: np.ndarray, x: np.ndarray, y: np.ndarray) -> pd.DataFrame:
    """Indices of the mean spectra, and mean and spread of the single ones."""
    names = [name for name in FIGURE_12 if name in index_bands(grid)]
    if not names:
        return pd.DataFrame(columns=list(_INDEX_COLUMNS))
    real, simulated = (
        np.asarray(vegetation_indices(np.vstack([v.mean(axis=0), v]).T, names, grid))
        for v in (x, y)
    )
    published = figure12_2006()
    rows = []
    for name, a, b in zip(names, real, simulated, strict=True):
        index = VEGETATION_INDICES[name]
        paper = published.get(name)
        sign = {None: np.nan, True: 1.0, False: -1.0}[paper.simulated_higher if paper else None]
        rows.append(
            {
                "index": name,
                "formula": index.formula,
                "source": index.source,
                "real": a[0],
                "simulated": b[0],
                "difference_percent": 100.0 * (b[0] - a[0]) / abs(a[0]) if a[0] else np.nan,
                "real_std": _finite_std(a[1:]),
                "simulated_std": _finite_std(b[1:]),
                "paper_lower_percent": 100.0 * paper.lower if paper else np.nan,
                "paper_upper_percent": 100.0 * paper.upper if paper else np.nan,
                "paper_sign": sign,
            }
        )
    return pd.DataFrame(rows, columns=list(_INDEX_COLUMNS))


def _finite_std(values: np.ndarray) -> float:
    finite = values[np.isfinite(values)]
    return float(finite.std()) if finite.size > 1 else float("nan")

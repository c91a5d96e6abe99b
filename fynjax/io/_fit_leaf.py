"""The job behind `fynjax fit-leaf`: files of spectra in, traits and spectra out."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from fynjax._core.errors import InputError
from fynjax._core.progress import Progress
from fynjax.io._leaf_results import (
    spectra_dataset,
    traits_table,
    write_leaf_netcdf,
    write_traits_csv,
)
from fynjax.io._spectra import read_spectra
from fynjax.io._spectra_record import Spectrum
from fynjax.leaf import (
    AbstractMeasurement,
    FitDomain,
    IntegratingSphere,
    LeafClip,
    LeafStack,
    ProspectVersion,
    fit_leaf,
)

MEASUREMENTS: dict[str, Callable[[], AbstractMeasurement]] = {
    "sphere": IntegratingSphere,
    "leaf-clip": LeafClip,
    "stack": LeafStack,
}
_GRID = np.arange(350.0, 2501.0)


def _on_grid(spectrum: Spectrum, values: np.ndarray | None) -> np.ndarray:
    """The spectrum on 1 nm steps; a band wider than that is spread no further than 25 nm."""
    if values is None:
        return np.full(_GRID.shape, np.nan)
    have = np.isfinite(values)
    if have.sum() < 2:
        return np.full(_GRID.shape, np.nan)
    at = spectrum.wavelength[have]
    result = np.interp(_GRID, at, values[have], left=np.nan, right=np.nan)
    right = np.clip(np.searchsorted(at, _GRID), 1, at.size - 1)
    gap = at[right] - at[right - 1]
    return np.where(gap <= 25.0, result, np.nan)


def run_fit_leaf(
    paths: Sequence[str | Path],
    output: str | Path,
    *,
    version: ProspectVersion = "D",
    measurement: str = "sphere",
    domain: FitDomain = "full",
    seed: int = 0,
    progress: Progress | None = None,
) -> dict[str, Any]:
    """Fit every spectrum of every file; write `traits.csv` and `spectra.nc` into `output`.

    A file that cannot be read does not stop the others: it becomes a row of `traits.csv` with the
    reason as status. If none can be read the first reason is raised.

    **Arguments:**

    - `paths`: files that `read_spectra` takes.
    - `output`: folder, made if missing.
    - `version`: "5", "D" or "PRO".
    - `measurement`: "sphere", "leaf-clip" or "stack".
    - `domain`: "full" or "optimal".
    - `seed`: recorded for provenance; the fit draws no random numbers.
    - `progress`: told of every chunk of leaves.

    **Returns:** a summary: `spectra`, `converged`, `doubtful`, `refused` (file and reason),
    `repairs` (file, spectrum and sentence), `files` written.

    **Raises:** `InputError` if no file holds a usable spectrum; `ValueError` for an unknown
    measurement.
    """
    if measurement not in MEASUREMENTS:
        raise ValueError(
            f"`measurement` must be one of {', '.join(MEASUREMENTS)}, but is {measurement!r}"
        )
    refused: list[tuple[str, InputError]] = []
    spectra: list[tuple[str, Spectrum]] = []
    for path in paths:
        try:
            spectra += [(str(path), spectrum) for spectrum in read_spectra(path)]
        except InputError as error:
            refused.append((str(path), error))
    if not spectra:
        raise refused[0][1] if refused else InputError("no file of spectra was given")
    r = np.stack([_on_grid(s, s.reflectance) for _, s in spectra])
    t = np.stack([_on_grid(s, s.transmittance) for _, s in spectra])
    fit = fit_leaf(
        _GRID, r, t, version=version, measurement=MEASUREMENTS[measurement](), domain=domain,
        progress=progress,
    )  # fmt: skip
    files, names = [f for f, _ in spectra], [s.name for _, s in spectra]
    settings = {
        "prospect_version": version,
        "measurement": measurement,
        "domain": domain,
        "seed": str(seed),
    }
    folder = Path(output)
    table = traits_table(fit, files, names)
    if refused:
        rows = [{"file": f, "name": "", "status": f"refused: {e}"} for f, e in refused]
        table = pd.concat([table, pd.DataFrame(rows)], ignore_index=True)
    write_leaf_netcdf(spectra_dataset(fit, files, names, settings), folder / "spectra.nc")
    write_traits_csv(table, folder / "traits.csv")
    good = sum(status == "converged" for status in fit.status)
    return {
        "spectra": len(spectra),
        "converged": good,
        "doubtful": len(spectra) - good,
        "refused": [{"file": f, "reason": str(e)} for f, e in refused],
        "repairs": [
            {"file": f, "name": s.name, "repair": sentence}
            for f, s in spectra
            for sentence in s.meta["repairs"]
        ],
        "files": [str(folder / "traits.csv"), str(folder / "spectra.nc")],
    }

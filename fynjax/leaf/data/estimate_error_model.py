"""Recipe of `error_model.csv.gz`: residuals of PROSPECT-D on ANGERS, LOPEX and NASA FFT.

Run `python estimate_error_model.py FOLDER [OUTPUT [SET ...]]` with the folder that holds
`angers_spectra.npz`, `angers_chemistry.csv.gz` and the same of the others. For each leaf the
measured pigments, water and dry matter are put into PROSPECT-D, N, the anthocyanins and what was
not measured (the pigments of NASA FFT) are fitted to R and T, and what remains is the model's
error. LOPEX enters with the mean of its five spectra a sample, NASA FFT as two sets, broad leaves
and mats of needles.
"""

import sys
from collections.abc import Sequence
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd

from fynjax.leaf import _levenberg as lm
from fynjax.leaf._coefficients import CONSTITUENTS
from fynjax.leaf._error_model import (
    ErrorModel,
    bin_centres,
    estimate_error_model,
    independent_error_model,
    to_bins,
)
from fynjax.leaf._measurement import IntegratingSphere
from fynjax.leaf._problem import leaf_problems, make_setup

NAMES = ("structure", *CONSTITUENTS["D"])
SETS = ("angers", "lopex", "nasa_fft")
MEASURED = {1: "cab", 2: "car", 5: "ewt", 6: "lma"}


def residuals(folder: Path, name: str) -> list[np.ndarray]:
    """Measured minus modelled R and T [leaf, 2, bin] at the measured chemistry.

    One array, or two of a set that marks its conifers.
    """
    with np.load(folder / f"{name}_spectra.npz") as stored:
        ids, wavelength = stored["id"], stored["wl"].astype(float)
        spectra = [stored["refl"].astype(float), stored["tran"].astype(float)]
    spectra = [s.mean(1) if s.ndim == 3 else s for s in spectra]
    data = np.stack([to_bins(wavelength, s) for s in spectra], axis=1)
    chemistry = pd.read_csv(folder / f"{name}_chemistry.csv.gz").set_index("id").loc[ids]
    setup = make_setup("D", IntegratingSphere(), NAMES, independent_error_model(0.015))
    known = np.tile([1.5, 40.0, 8.0, 1.0, 1e-3, 0.01, 0.009], (len(ids), 1))
    precision = np.tile([0.1, 0.1, 0.1, 0.5, 1e3, 0.1, 0.1], (len(ids), 1))
    for column, key in MEASURED.items():
        if key not in chemistry:
            continue
        values = chemistry[key].to_numpy(float)
        have = np.isfinite(values)
        known[have, column] = np.maximum(values[have], 1e-4 if column > 4 else 0.05)
        precision[have, column] = 1e6
    optics = setup.optics
    z = np.asarray(lm.to_unconstrained(jnp.asarray(known), optics))
    use = np.isfinite(data) & (bin_centres() >= 445) & (bin_centres() <= 2405)
    prior = (z, precision[:, :, None] * np.eye(len(NAMES)))
    problems = leaf_problems(setup, data, use, prior, np.ones(len(ids)))
    none = np.zeros_like(setup.factors)
    logits = np.concatenate([
        lm.solve(z[at], lm.Problem(*(part[at] for part in problems)), none, optics).z
        for at in (slice(i, i + 128) for i in range(0, len(ids), 128))
    ])  # fmt: skip
    fitted = jax.vmap(lambda z: lm.spectra(lm.to_physical(z, optics), optics))(logits)
    rest = data - np.asarray(fitted)
    if "conifer" not in chemistry:
        return [rest]
    needles = chemistry["conifer"].to_numpy() == 1
    return [rest[~needles], rest[needles]]


def estimate(folder: Path, names: Sequence[str] = SETS) -> ErrorModel:
    """The error model of some sets, such as all but the set it is tested on."""
    return estimate_error_model([part for name in names for part in residuals(folder, name)])


def write(model: ErrorModel, output: Path) -> None:
    """Write the table, a row for each bin."""
    columns = {"wavelength_nm": bin_centres()}
    columns |= {"r_noise": model.reflectance_noise, "t_noise": model.transmittance_noise}
    for i, (r, t) in enumerate(zip(model.reflectance_factors, model.transmittance_factors)):
        columns |= {f"r_factor{i}": r, f"t_factor{i}": t}
    table = pd.DataFrame(columns)
    table.to_csv(
        output, index=False, float_format="%.5g", compression={"method": "gzip", "mtime": 1}
    )


if __name__ == "__main__":
    place = Path(sys.argv[1])
    target = Path(
        sys.argv[2] if len(sys.argv) > 2 else Path(__file__).with_name("error_model.csv.gz")
    )
    write(estimate(place, sys.argv[3:] or SETS), target)

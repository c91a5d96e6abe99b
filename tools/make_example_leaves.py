"""Make the example folder of leaf spectra that `fynjax.app.io.spectra.example_folder` names.

No measured leaves can be shipped: those of ANGERS, LOPEX and NASA FFT state no licence. These six
are PROSPECT-D's with what real leaves differ from it by: a draw of the error that was learned on
those collections (`fynjax.leaf.default_error_model`), and an instrument's noise. What the
laboratory found differs from the leaf's own trait by a draw of what spectra do not explain of it.

    python tools/make_example_leaves.py
"""

import struct
from pathlib import Path

import numpy as np
import pandas as pd
from scipy.ndimage import gaussian_filter1d

import fynjax as fx
from fynjax.leaf import bin_centres, default_error_model

FOLDER = Path(fx.__file__).parent / "io" / "spectra" / "data" / "leaves"
TRAITS = ("structure", "chlorophyll", "carotenoids", "water", "dry_matter")
"""Rows of an error model's `trait_discrepancy`."""
LEAVES = pd.DataFrame(
    {  # layers [-], pigments [ug cm-2], water and dry matter [g cm-2]
        "soft": (1.4, 42.0, 8.5, 1.2, 0.0105, 0.0042),
        "usual": (1.6, 50.0, 10.0, 1.0, 0.0120, 0.0078),
        "pale": (1.5, 14.0, 5.0, 1.4, 0.0095, 0.0060),
        "thick": (1.9, 62.0, 12.5, 1.0, 0.0230, 0.0120),
        "tough": (2.1, 38.0, 9.0, 2.0, 0.0160, 0.0185),
        "reddish": (1.7, 26.0, 7.0, 6.0, 0.0130, 0.0098),
    },
    ["structure", "chlorophyll", "carotenoids", "anthocyanins", "water", "dry_matter"],
)
MEASURED = ("chlorophyll", "carotenoids", "water", "dry_matter")
"""What the laboratory measured."""
NOISE = 0.001
"""Standard deviation of a band for itself [-]."""


def asd(reflectance: np.ndarray) -> bytes:
    """An ASD file, version 7, of bands from 350 nm on, a nm apart: target and white reference."""
    header = bytearray(484)
    header[:3] = b"as7"
    header[186] = 1  # reflectance
    header[199] = 0  # float32
    struct.pack_into("<ff", header, 191, 350.0, 1.0)
    struct.pack_into("<H", header, 204, reflectance.size)
    struct.pack_into("<I", header, 390, 17)  # integration time [ms]
    header[431] = 4  # FieldSpec FR
    struct.pack_into("<ff", header, 444, 1000.0, 1800.0)  # where detectors change
    white = np.ones(reflectance.size, "<f4")
    between = struct.pack("<hddH", 1, 0.0, 0.0, 0)
    return bytes(header) + reflectance.astype("<f4").tobytes() + between + white.tobytes()


def main() -> None:
    """Write the folder."""
    random = np.random.default_rng(2023)
    error, bins = default_error_model(), bin_centres()
    wavelength = np.arange(350.0, 2501.0)
    r, t = (np.array(part, float) for part in fx.prospect(**LEAVES.T))
    count = len(LEAVES.columns)
    common = random.normal(size=(count, len(error.reflectance_factors)))
    spectra = []
    for own, factors, rest in (
        (r, error.reflectance_factors, error.reflectance_noise),
        (t, error.transmittance_factors, error.transmittance_noise),
    ):
        off = common @ factors + rest * random.normal(size=(count, bins.size))
        # Half of that error is of any leaf, from 15 nm on; a leaf's own is smoother.
        off = gaussian_filter1d(off, 4.0, axis=1)
        # PROSPECT begins at 400 nm, the instrument at 350.
        whole = np.stack(
            [
                np.interp(wavelength, np.arange(400.0, 2501.0), spectrum)
                + np.interp(wavelength, bins, deviation)
                for spectrum, deviation in zip(own, off)
            ]
        )
        spectra.append((whole + NOISE * random.normal(size=whole.shape)).clip(0.001, 1.0))
    reflectance, transmittance = spectra
    at = np.arange(350, 2501, 50)
    white = pd.Series(0.99 - 0.03 * ((at - 350) / 2150) ** 3, at).round(4)
    white.to_csv(FOLDER / "panel.csv", header=["reflectance"], index_label="wavelength")
    panel = np.interp(wavelength, at, white)
    for name, values in zip(LEAVES.columns, reflectance):
        (FOLDER / "reflectance" / f"{name}.asd").write_bytes(asd(values / panel))
    columns = [f"{name}_T" for name in LEAVES.columns]
    table = pd.DataFrame(transmittance[:, ::5].T, wavelength[::5].astype(int), columns)
    table.round(4).to_csv(FOLDER / "transmittance.csv", index_label="wavelength")
    sd = np.exp(error.trait_discrepancy[:, 0])
    sd = pd.Series(sd, TRAITS)[list(MEASURED)].to_numpy()[:, None]
    found = LEAVES.loc[list(MEASURED)] * np.exp(sd * random.normal(size=(len(MEASURED), count)))
    decimals = {"chlorophyll": 1, "carotenoids": 1, "water": 4, "dry_matter": 4}
    found.T.round(decimals).to_csv(FOLDER / "laboratory.csv", index_label="name")


if __name__ == "__main__":
    main()

"""The numbers of the article beside those of a scene of its plot."""

from typing import Any

import equinox as eqx
import numpy as np
import pandas as pd
from jaxtyping import Array

from fynjax.compare import bands_2006, table4_2006, table5_2006
from fynjax.compare.structure import structure_2006
from fynjax.metrics import spectral_mask
from fynjax.scene import Scene, observe
from fynjax.sensors import shipped_lidar, shipped_sensor

SWIR2_MEAN = {"real": 0.063, "dirsig": 0.008}
"""Mean reflectance at 2100 to 2450 nm, from the article's text on AVIRIS-NG [-]."""
_OPTICS = {
    "pixel of the drone's camera [m]": (0.025, 2e-6 / 4e-3 * 50.0),
    "pixel of AVIRIS-NG [m]": (3.0, 27e-6 / 26.6e-3 * 1000.0),
    "pixel of the LiDAR [m]": (0.04, 100e-6 / 0.128 * 50.0),
    "width of its beam on the ground [m]": (7.11, 2.0 * 50.0 * float(np.tan(0.071))),
}
"""As tables 2 and 3 print them, and by the pitch, focal length, divergence and height there."""


def article_tables(scene: Scene, *, pixel: float = 0.025, channels: int = 425) -> pd.DataFrame:
    """What the article prints of its plot and sensors, what its DIRSIG made of it, and what a
    scene gives.

    **Arguments:**

    - `scene`: of the plot burnt in 2006 (`fx.read_scene()`), as it is or calibrated.
    - `pixel`: of the drone's image [m]; the article's by default.
    - `channels`: about so many of the spectrometer's are simulated.

    **Returns:** a row for each number, with the columns table, quantity, real, dirsig and fynjax.
    Of tables 2 and 3 the printed value stands in `real`, and in `fynjax` what the printed optics
    give. Means of bands and ranges of spectra are derived from printed numbers (see
    `fynjax/compare/data/README.md`). NaN where nothing is printed. Numbers that contradict the
    article's own formulas, and EVI, whose form is not known, are left out.
    """
    rows: list[tuple[Any, ...]] = [
        ("tables 2, 3", k, real, np.nan, ours) for k, (real, ours) in _OPTICS.items()
    ]
    image = observe(scene, "mavic_3m", pixel=pixel)
    for name, band in bands_2006().items():
        rows.append(("figure 9", f"{name}.mean", band.real_mean, np.nan, image[name].mean()))
    for name, row in table4_2006().items():
        values = np.asarray(image.index(name))
        if row.formula_confidence != "open":
            rows.append(
                ("table 4", f"{name}.mean", row.real_mean, row.sim_mean, np.nanmean(values))
            )
        if row.std_consistent:
            rows.append(("table 4", f"{name}.std", row.real_std, row.sim_std, np.nanstd(values)))
    aviris = shipped_sensor("aviris_ng")
    step = max(1, len(aviris.bands) // channels)
    spectrum = observe(scene, aviris.select(list(range(4, len(aviris.bands) - 4, step))), pixel=3.0)
    mean, wavelength = spectrum.reflectance.mean(axis=(1, 2)), np.array(spectrum.wavelength)
    for region, agreement in table5_2006().items():
        inside = np.asarray(mean)[spectral_mask(wavelength, region)]
        real = agreement.rmse / agreement.nrmse
        rows.append(("table 5", f"range of reflectance, {region}", real, np.nan, np.ptp(inside)))
    rows.append(("table 5", "mean reflectance, swir2", *SWIR2_MEAN.values(), inside.mean()))
    printed_structure = {k: v for k, v in structure_2006().items() if v.real is not None}
    found = _structure(scene, shipped_lidar("flash_lidar_paper"), tuple(printed_structure))
    for (name, structure), ours in zip(printed_structure.items(), found, strict=True):
        rows.append(("section 4.4", name, structure.real, structure.simulated, ours))
    table = pd.DataFrame(rows, columns=["table", "quantity", "real", "dirsig", "fynjax"])
    return table.astype({"real": float, "dirsig": float, "fynjax": float})


@eqx.filter_jit
def _structure(scene: Scene, lidar: Any, names: tuple[str, ...]) -> list[Array]:
    cloud = observe(scene, lidar)
    return [cloud.metric(name) for name in names]

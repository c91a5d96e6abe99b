"""A simulated drone image against the published statistics of the real one of the 2006 plot."""

from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np
import pandas as pd

from fynjax.compare._images import DroneImage
from fynjax.compare._published_tables import bands_2006, table4_2006
from fynjax.metrics import BANDS, vegetation_indices


@dataclass(frozen=True)
class PublishedComparison:
    """A simulated image beside what the paper prints of the real one and of its own simulation."""

    simulated: DroneImage
    statistics: pd.DataFrame
    """A row for each mean and standard deviation."""
    notes: tuple[str, ...]


def compare_with_published(image: DroneImage) -> PublishedComparison:
    """Means of bands, means and standard deviations of indices: real, DIRSIG's, and these.

    The real band means are derived (see `fynjax/compare/data/README.md`), and of DIRSIG's only the
    absolute difference is printed. A printed standard deviation that contradicts the formulas is
    marked, and EVI, whose form is not known.

    **Arguments:** `image`: simulated reflectance in four bands [-], as of `read_drone_image`.

    **Returns:** a `PublishedComparison`.
    """
    rows = []
    published = bands_2006()
    pixels = image.pixels[: len(BANDS)]
    for name, values in zip(BANDS, pixels, strict=True):
        row = published[name]
        rows.append(
            _row(f"{name}.mean", "derived", row.real_mean, np.nan, float(values.mean()))
            | {"dirsig_abs_error_percent": 100.0 * row.sim_abs_difference}
        )
    for name, paper in table4_2006().items():
        values = np.asarray(vegetation_indices(jnp.asarray(pixels), [name])[0])
        values = values[np.isfinite(values)]
        mean, std = (values.mean(), values.std()) if values.size else (np.nan, np.nan)
        known = "printed" if paper.formula_confidence != "open" else "form not known"
        rows.append(_row(f"{name}.mean", known, paper.real_mean, paper.sim_mean, float(mean)))
        sound = "printed" if paper.std_consistent else "contradicts its formula"
        sound = known if paper.std_consistent is None else sound
        rows.append(_row(f"{name}.std", sound, paper.real_std, paper.sim_std, float(std)))
    assert len(rows) == len(BANDS) + 2 * len(table4_2006())
    notes = [
        f"Simulated image: {image.description()}",
        "The real image itself is not published: only means and standard deviations can be "
        "compared, no histograms.",
    ]
    return PublishedComparison(image, pd.DataFrame(rows), tuple(notes))


def _row(
    statistic: str, status: str, real: float, dirsig: float, simulated: float
) -> dict[str, object]:
    error = 100.0 * (dirsig - real) / abs(real)
    return {
        "statistic": statistic,
        "status": status,
        "real": real,
        "dirsig": dirsig,
        "simulated": simulated,
        "dirsig_abs_error_percent": abs(error),
        "simulated_error_percent": 100.0 * (simulated - real) / abs(real),
    }


def wins(statistics: pd.DataFrame) -> tuple[int, int]:
    """In how many statistics the simulated image is nearer to the real one than DIRSIG's.

    **Arguments:** `statistics`: the table of a `PublishedComparison`.

    **Returns:** that number, and the number of statistics that are consistent and have both errors.
    """
    sound = statistics[statistics["status"].isin(["derived", "printed"])]
    both = sound.dropna(subset=["dirsig_abs_error_percent", "simulated_error_percent"])
    nearer = both["simulated_error_percent"].abs() < both["dirsig_abs_error_percent"]
    return int(nearer.sum()), len(both)

"""Whether the spectra of plots, measured and simulated, follow the diversity of their species."""

from collections.abc import Mapping
from itertools import combinations

import numpy as np
import pandas as pd
from jaxtyping import Float
from numpy.typing import ArrayLike

from fynjax.app.compare._plots import PlotSpectraPair, feature_values
from fynjax.diversity import (
    VARIETY,
    bray_curtis,
    diversity_indices,
    mantel,
    metric_agreement,
    normalise_brightness,
    regression_agreement,
    spectral_variety,
)

REGRESSION, DISTANCE = "regression", "distance"
"""Names, beside those of metrics, of the skill of a regression and of Mantel's correlation."""


def plot_diversity_table(
    pair: PlotSpectraPair, cover: ArrayLike, variety: Mapping[str, ArrayLike], *, seed: int = 0
) -> pd.DataFrame:
    """Agreement of measured and simulated spectra of plots with the diversity of their species.

    **Arguments:**

    - `pair`: plots that were all measured, at least five.
    - `cover`: [plot, species] covers of the species.
    - `variety`: `fynjax.diversity.spectral_variety` of the pixels of each simulated plot, by name,
      [plot] each; that of the measured ones is taken of each two of their flights.
    - `seed`: of bootstrapped and exchanged plots.

    **Returns:** a row for each `source` (measured or simulated), `diversity` and `metric`, with
    `value`, `q05`, `q95`, `p_value` and `p_of_all` as `metric_agreement` has them. Metrics are
    `FEATURES` of the mean spectrum, and `variety`. Of the metric "regression" the value is the
    skill of `regression_agreement`, by spectra without their brightness, of the diversity
    "composition" it is `mantel`'s correlation of the distance of such spectra with the Bray-Curtis
    dissimilarity of the covers.

    **Raises:** `InputError` as `metric_agreement` and `bray_curtis`.
    """
    asked = diversity_indices(cover)
    parts = []
    for source, spectra, varied in (
        ("measured", pair.measured, _of_flights(pair)),
        ("simulated", pair.simulated, variety),
    ):
        metrics = feature_values(pair.wavelength, spectra) | dict(varied)
        shape = np.asarray(normalise_brightness(spectra[:, np.isfinite(spectra).all(axis=0)]))
        regression = regression_agreement(shape, asked, seed=seed).assign(metric=REGRESSION)
        apart = np.linalg.norm(shape[:, None] - shape, axis=-1)
        composition = {"diversity": "composition", "metric": DISTANCE}
        rows = [metric_agreement(metrics, asked, seed=seed), regression]
        rows.append(pd.DataFrame([composition | mantel(apart, bray_curtis(cover), seed=seed)]))
        parts.append(pd.concat(rows).assign(source=source))
    table = pd.concat(parts, ignore_index=True)
    return table[["source", *(name for name in table if name != "source")]]


def _of_flights(pair: PlotSpectraPair) -> dict[str, Float[np.ndarray, " plot"]]:
    """The variety of each two flights over a plot, on the mean: whatever the number of flights; in
    bands that are positive in all. NaN of a plot with one flight."""
    used = np.concatenate([flights > 0.0 for flights in pair.flights]).all(axis=0)
    found = []
    for flights in pair.flights:
        pairs = [spectral_variety(np.stack(two)) for two in combinations(flights[:, used], 2)]
        found.append({name: np.mean([one[name] for one in pairs] or np.nan) for name in VARIETY})
    return {name: np.array([one[name] for one in found]) for name in VARIETY}

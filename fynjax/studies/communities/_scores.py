"""How well spectra tell of diversity, at which pixel that is lost, and how species separate."""

from collections.abc import Sequence

import numpy as np
import pandas as pd
from jaxtyping import Float, Int

from fynjax.diversity import classify, separability
from fynjax.studies.communities._observe import DIVERSITIES, METRICS, Design

_BOOTSTRAPS = 1000
_INTERVAL = (0.05, 0.95)
_SPLITS = 10
"""Times that communities are parted into those that train and those that judge."""
_LEAST = 5
"""Pixels of a species in each part, at least, for it to take part."""


def agreement(
    diversity: Float[np.ndarray, "community diversity"],
    metrics: Float[np.ndarray, "community sensor pixel noise metric"],
    design: Design,
    threshold: float,
) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Squared correlation over communities of each spectral metric with each diversity.

    **Returns:** two tables. One has a row for each sensor, pixel, noise, metric and diversity: `r2`
    with its interval of 5 to 95 % over bootstrapped communities. The other has a row for each but
    the pixel: the pixel of the greatest `r2`, and the pixel `lost_from_m` from which on `r2` stays
    below `threshold`, with its interval over the same communities; infinite where it never does.
    """
    count = len(diversity)
    random = np.random.default_rng([design.seed, 73])
    some = np.concatenate([np.arange(count)[None], random.integers(0, count, (_BOOTSTRAPS, count))])
    pixels = np.array(design.pixels)
    rows, lost = [], []
    for s, sensor in enumerate(design.sensors):
        for n, noise in enumerate(design.noise):
            for m, metric in enumerate(METRICS):
                for d, what in enumerate(DIVERSITIES):
                    keys = {
                        "sensor": sensor.name, "noise": noise, "metric": metric, "diversity": what
                    }  # fmt: skip
                    asked = diversity[:, d][some]
                    r2 = np.stack(
                        [
                            _squared_correlation(metrics[:, s, p, n, m][some], asked)
                            for p in range(len(pixels))
                        ],
                        axis=1,
                    )
                    low, high = np.nanquantile(np.nan_to_num(r2[1:]), _INTERVAL, axis=0)
                    for p, pixel in enumerate(pixels):
                        known = {"pixel_m": pixel, "r2": r2[0, p], "q05": low[p], "q95": high[p]}
                        rows.append(keys | known)
                    gone = _lost_from(r2, pixels, threshold)
                    best = int(np.argmax(np.nan_to_num(r2[0])))
                    ends = np.quantile(gone[1:], _INTERVAL, method="nearest")
                    lost.append(
                        keys
                        | {"best_r2": r2[0, best], "best_pixel_m": pixels[best]}
                        | {"lost_from_m": gone[0], "q05": ends[0], "q95": ends[1]}
                    )
    return pd.DataFrame(rows), pd.DataFrame(lost)


def _squared_correlation(
    x: Float[np.ndarray, "draw community"], y: Float[np.ndarray, "draw community"]
) -> Float[np.ndarray, " draw"]:
    """Of each draw, over the communities that have both values; NaN where one does not vary."""
    known = np.isfinite(x) & np.isfinite(y)
    number = known.sum(axis=1, keepdims=True)
    x, y = (np.where(known, v, 0.0) for v in (x, y))
    with np.errstate(invalid="ignore", divide="ignore"):
        x, y = (np.where(known, v - v.sum(axis=1, keepdims=True) / number, 0.0) for v in (x, y))
        found = (x * y).sum(axis=1) ** 2 / ((x**2).sum(axis=1) * (y**2).sum(axis=1))
    return np.where(number[:, 0] > 2, found, np.nan)


def _lost_from(
    r2: Float[np.ndarray, "draw pixel"], pixels: Float[np.ndarray, " pixel"], threshold: float
) -> Float[np.ndarray, " draw"]:
    """The pixel from which on `r2` stays below the threshold; infinite where it does not."""
    there = np.nan_to_num(r2) >= threshold
    after = np.where(there.any(axis=1), there.shape[1] - np.argmax(there[:, ::-1], axis=1), 0)
    return np.append(pixels, np.inf)[after]


def recognition(
    species: Int[np.ndarray, "community pixel sample"],
    spectra: Sequence[Float[np.ndarray, "community pixel noise sample band"]],
    taxa: Sequence[str],
    design: Design,
) -> pd.DataFrame:
    """How well species are recognised by their spectra in other communities, and their distance.

    A linear discriminant is trained on half of the communities and judged on the others, in
    several partings.

    **Returns:** a row for each sensor, pixel and noise: `species` that have enough pixels that are
    mostly theirs, `accuracy` with its interval of 5 to 95 % over partings, that `by_chance`, and
    the mean `jeffries_matusita` distance of two species, at most 2. NaN of fewer than two.
    """
    names, rows = np.array(taxa), []
    for s, sensor in enumerate(design.sensors):
        for p, pixel in enumerate(design.pixels):
            there = species[:, p] >= 0
            community, sample = np.nonzero(there)
            kinds = species[:, p][there]
            for n, noise in enumerate(design.noise):
                seen = spectra[s][community, p, n, sample].astype(float)
                found = _recognised(seen, names[kinds], community, design.seed)
                rows.append({"sensor": sensor.name, "pixel_m": pixel, "noise": noise} | found)
    return pd.DataFrame(rows)


def _recognised(
    spectra: np.ndarray, names: np.ndarray, community: np.ndarray, seed: int
) -> dict[str, float]:
    random = np.random.default_rng([seed, 79])
    every = np.unique(community)
    accuracies, most = [], 0
    for _ in range(_SPLITS):
        trains = np.isin(community, random.permutation(every)[: len(every) // 2])
        enough = [
            kind
            for kind in np.unique(names)
            if min(((names == kind) & part).sum() for part in (trains, ~trains)) >= _LEAST
        ]
        if len(enough) < 2:
            continue
        used = np.isin(names, enough)
        found = classify(spectra[used], names[used].tolist(), trains[used].tolist())
        accuracies += list(found.by_group.values())
        most = max(most, len(enough))
    if not accuracies:
        none = dict.fromkeys(["accuracy", "q05", "q95", "by_chance", "jeffries_matusita"], np.nan)
        return {"species": 0, **none}
    kept = np.isin(names, [k for k in np.unique(names) if (names == k).sum() >= 2 * _LEAST])
    distance = separability(spectra[kept], names[kept].tolist())["jeffries_matusita"].mean()
    low, high = np.quantile(accuracies, _INTERVAL)
    return {
        "species": most, "accuracy": float(np.mean(accuracies)), "q05": float(low),
        "q95": float(high), "by_chance": 1.0 / most, "jeffries_matusita": float(distance),
    }  # fmt: skip

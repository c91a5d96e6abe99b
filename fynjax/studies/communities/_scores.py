"""Agreement of spectra with diversity, the pixel that loses it, and recognition of species."""

import warnings
from collections.abc import Sequence
from contextlib import suppress
from itertools import product
from typing import Any

import numpy as np
import pandas as pd
from jaxtyping import Float, Int

from fynjax._core.errors import InputError
from fynjax._core.resampling import INTERVAL, correlation_over, plot_draws
from fynjax.diversity import bray_curtis, classify, mantel, separability, spectral_species
from fynjax.studies.communities._observe import OF_IMAGE, Design, hull

METRICS = (*OF_IMAGE, "spectral_species")
"""Spectral metrics of a community: `OF_IMAGE`, and the Shannon entropy of its spectral species."""

_SPLITS = 10
"""Times that communities are parted into those that train and those that judge."""
_LEAST = 5
"""Pixels of a species in each part, at least, for it to take part."""
_CLUSTERS, _PER_CLUSTER, _COMPONENTS = 50, 10, 3
"""Spectral species at most, pixels that each needs on average, and principal components in which
they are found."""
_FEWEST_KNOWN = 10
"""Communities at least that a correlation with a metric is taken over."""
_FEWEST = 5
"""Communities at least of which dissimilarities are compared."""
_ENOUGH = 10
"""Pixels that a community needs for a hull and spectral species where others have as many."""


def correlations(
    diversity: Float[np.ndarray, "community diversity"],
    metrics: Float[np.ndarray, "community sensor pixel noise metric"],
    design: Design,
    threshold: float,
) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Squared correlation over communities of each spectral metric with each diversity.

    **Returns:** two tables. One has a row for each sensor, pixel, noise, metric and diversity: `r2`
    with its interval of 5 to 95 % over bootstrapped communities. The other has a row for each but
    the pixel, and for "any", the greatest `r2` of all metrics at each pixel: the pixel of the
    greatest `r2`, what that is at most in 95 % of cases by chance, with communities exchanged, and
    the pixel `lost_from_m` from which on `r2` stays below `threshold`, with its interval over the
    same communities; infinite where it does so at no known pixel. `unknown_beyond_m` is the widest
    pixel of which `r2` is known where wider ones are not. NaN of what does not vary, or is known
    of fewer than ten communities.
    """
    count = len(diversity)
    few = np.isfinite(metrics).sum(axis=0) < min(_FEWEST_KNOWN, count)
    metrics = np.where(few, np.nan, metrics)
    some, exchanged = plot_draws(count, design.seed, 73)
    pixels = np.array(design.pixels)
    rows, lost = [], []
    for (s, sensor), (n, noise), (d, what) in product(
        enumerate(design.sensors), enumerate(design.noise), enumerate(design.diversities)
    ):
        found, chance = (
            np.stack([
                np.stack([correlation_over(metrics[:, s, p, n, m][x], diversity[:, d][y]) ** 2
                          for p in range(len(pixels))], axis=1)
                for m in range(len(METRICS))
            ])
            for x, y in ((some, some), (np.arange(count), exchanged))
        )  # fmt: skip
        for metric, r2, by_chance in zip(
            (*METRICS, "any"), [*found, _greatest(found)], [*chance, _greatest(chance)], strict=True
        ):
            keys = {"sensor": sensor.name, "noise": noise, "metric": metric, "diversity": what}
            low, high = _quantiles(r2[1:], INTERVAL)
            if metric != "any":
                for p, pixel in enumerate(pixels):
                    at_pixel = {"pixel_m": pixel, "r2": r2[0, p], "q05": low[p], "q95": high[p]}
                    rows.append(keys | at_pixel)
            gone = _lost_from(r2, pixels, threshold)
            known = np.isfinite(r2[0])
            best = int(np.argmax(np.where(known, r2[0], -1.0)))
            widest = pixels[known].max(initial=0.0)
            ends = _quantiles(gone[1:], INTERVAL, method="nearest")
            lost.append(keys | {
                "best_r2": r2[0, best],
                "best_pixel_m": pixels[best] if known.any() else np.nan,
                "by_chance": float(_quantiles(_greatest(by_chance.T), [INTERVAL[1]])[0]),
                "lost_from_m": gone[0], "q05": ends[0], "q95": ends[1],
                "unknown_beyond_m": widest if 0.0 < widest < pixels[-1] else np.nan,
            })  # fmt: skip
    return pd.DataFrame(rows), pd.DataFrame(lost)


def _greatest(values: Float[np.ndarray, "row ..."]) -> Float[np.ndarray, "..."]:
    """The greatest of the rows; NaN where all are."""
    known = np.where(np.isnan(values), -np.inf, values).max(axis=0)
    return np.where(np.isinf(known), np.nan, known)


def _quantiles(
    values: Float[np.ndarray, "draw ..."], shares: Sequence[float], **how: Any
) -> Float[np.ndarray, "share ..."]:
    """Quantiles over draws, without those that are NaN; NaN where all are."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # all are NaN
        return np.asarray(np.nanquantile(values, shares, axis=0, **how))


def _lost_from(
    r2: Float[np.ndarray, "draw pixel"], pixels: Float[np.ndarray, " pixel"], threshold: float
) -> Float[np.ndarray, " draw"]:
    """The narrowest pixel of which `r2` is known and below the threshold, as in every wider one
    that is known; infinite where there is none; NaN where nothing is known."""
    known = np.isfinite(r2)
    kept = np.logical_or.accumulate((r2 >= threshold)[:, ::-1], axis=1)[:, ::-1]
    lost = np.where(known & ~kept, pixels, np.inf).min(axis=1)
    return np.where(known.any(axis=1), lost, np.nan)


def composition(
    cover: Float[np.ndarray, "community species"],
    metrics: Float[np.ndarray, "community sensor pixel noise of_image"],
    pixels: Sequence[Float[np.ndarray, "community pixel noise drawn band"]],
    design: Design,
) -> tuple[Float[np.ndarray, "community sensor pixel noise metric"], pd.DataFrame]:
    """Spectral species of all communities together, and how their composition follows that of the
    plants.

    At each sensor, pixel size and noise all communities have as many pixels as the one with the
    fewest, as entropy grows with their number; one with fewer than ten, where others have more, is
    left out. They are clustered once (`spectral_species`): 50 clusters, or one for ten pixels where
    there are fewer than 500. With a `greenness` the hull is that of these pixels too.

    **Arguments:** `cover` of each species; `metrics` of images (`OF_IMAGE`); `pixels`, for each
    sensor spectra drawn from a community in random order, NaN where there are fewer.

    **Returns:** `METRICS`, with the Shannon entropy of the clusters of each community, NaN where it
    is left out; and a table with a row for each sensor, pixel and noise: the number of `pixels` of
    each community and of `spectral_species`; and Mantel's correlation (`mantel`) of the Bray-Curtis
    dissimilarity of their shares in each two communities with that of the shares of plant species
    in the cover, with its interval over bootstrapped communities and its `p_value`.
    """
    metrics = np.concatenate([metrics, np.full((*metrics.shape[:-1], 1), np.nan)], axis=-1)
    rows = []
    with np.errstate(invalid="ignore"):
        share = cover / cover.sum(axis=1, keepdims=True)
    for (s, sensor), (p, pixel), (n, noise) in product(
        enumerate(design.sensors), enumerate(design.pixels), enumerate(design.noise)
    ):
        spectra = pixels[s][:, p, n].astype(float)
        valid = np.isfinite(spectra).all(axis=-1)
        number = valid.sum(axis=1)
        enough = number >= (_ENOUGH if number.max() >= _ENOUGH else 1)
        known = np.flatnonzero(enough & np.isfinite(share).all(axis=1))
        least = int(number[known].min()) if len(known) else 0
        valid &= valid.cumsum(axis=1) <= least
        if design.greenness is not None:
            metrics[:, s, p, n, -2] = [
                hull(spectra[i][valid[i]]) if i in known else np.nan for i in range(len(cover))
            ]
        clusters = min(_CLUSTERS, int(valid[known].sum()) // _PER_CLUSTER)
        tie = dict.fromkeys(("value", "q05", "q95", "p_value"), np.nan)
        kinds = np.nan
        if clusters >= 2 and len(known) >= _FEWEST:
            with suppress(InputError):  # a band that does not vary: the other rows stand
                found = spectral_species(
                    spectra[known], valid[known], clusters=clusters, seed=design.seed,
                    components=min(_COMPONENTS, spectra.shape[-1]),
                )  # fmt: skip
                metrics[known, s, p, n, -1] = found.shannon
                kinds = clusters
                tie = mantel(found.bray_curtis, bray_curtis(share[known]), seed=design.seed)
        row = {"sensor": sensor.name, "pixel_m": pixel, "noise": noise}
        row |= {"pixels": least, "spectral_species": kinds, "mantel": tie.pop("value")}
        rows.append(row | tie)
    return metrics, pd.DataFrame(rows)


def recognition(
    species: Int[np.ndarray, "community sensor pixel sample"],
    spectra: Sequence[Float[np.ndarray, "community pixel noise sample band"]],
    taxa: Sequence[str],
    design: Design,
) -> pd.DataFrame:
    """Accuracy with which species are recognised in other communities, and their distance.

    A linear discriminant is trained on half of the communities and judged on the others, in
    several partings.

    **Returns:** a row for each sensor, pixel and noise: `species` that have enough pixels that are
    mostly theirs, on the mean of the partings; `accuracy` with its 5 to 95 % over 20 trainings (ten
    partings, each half trains once) on the same communities, which is no interval over communities;
    accuracy `by_chance`; and the mean `jeffries_matusita` distance of two species, at most 2. NaN
    of fewer than two species, and a distance of pixels that are all alike.
    """
    names, rows = np.array(taxa), []
    for s, sensor in enumerate(design.sensors):
        for p, pixel in enumerate(design.pixels):
            there = species[:, s, p] >= 0
            community, sample = np.nonzero(there)
            kinds = species[:, s, p][there]
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
    accuracies, parted = [], []
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
        parted.append(enough)
    if not accuracies:
        none = dict.fromkeys(["accuracy", "q05", "q95", "by_chance", "jeffries_matusita"], np.nan)
        return {"species": 0.0, **none}
    kept = np.isin(names, [kind for enough in parted for kind in enough])
    distance = np.nan
    with suppress(InputError, np.linalg.LinAlgError):  # species whose pixels are all alike
        distance = separability(spectra[kept], names[kept].tolist())["jeffries_matusita"].mean()
    low, high = np.quantile(accuracies, INTERVAL)
    counts = np.array([len(enough) for enough in parted])
    return {
        "species": float(counts.mean()), "accuracy": float(np.mean(accuracies)), "q05": float(low),
        "q95": float(high), "by_chance": float(np.mean(1.0 / counts)),
        "jeffries_matusita": float(distance),
    }  # fmt: skip

"""Principal components of spectra, and what is made of them: hulls and spectral species."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import ConvexHull

from fynjax._core.errors import InputError
from fynjax._core.extras import require
from fynjax._core.seeds import generator
from fynjax.diversity._species import bray_curtis, shannon


@dataclass(frozen=True)
class PrincipalComponents:
    """Axes along which spectra vary most."""

    mean: Float[np.ndarray, " band"]
    """Mean spectrum, in the spectra's unit."""
    scale: Float[np.ndarray, " band"]
    """Divisor of each band before components are taken: its standard deviation, or 1."""
    axes: Float[np.ndarray, "component band"]
    """Unit vectors; the largest entry of each is positive."""
    variance: Float[np.ndarray, " component"]
    """Variance along each axis, with the number of pixels less 1."""
    share: Float[np.ndarray, " component"]
    """Share of each in the variance of all bands [-]."""

    def scores(self, spectra: ArrayLike) -> Float[np.ndarray, "*pixel component"]:
        """Place of spectra [..., band] along the axes, 0 for the mean spectrum."""
        return ((np.asarray(spectra, np.float64) - self.mean) / self.scale) @ self.axes.T


def finite_pixels(values: ArrayLike, what: str = "spectra") -> NDArray[np.float64]:
    """Spectra, or points made of them, as numbers; `InputError` where some are not finite."""
    data = np.asarray(values, np.float64)
    if not np.isfinite(data).all():
        raise InputError(f"expected finite {what}, but some have NaN or infinity: leave them out")
    return data


def principal_components(
    spectra: ArrayLike, count: int = 3, *, standardise: bool = False
) -> PrincipalComponents:
    """Principal components of the pixels of an image.

    **Arguments:**

    - `spectra`: [pixel, band] of any unit, finite.
    - `count`: how many components, at most bands, and fewer than pixels.
    - `standardise`: divide each band by its standard deviation first, as biodivMapR does by
      default; raw bands are those of specdiv.

    **Returns:** `PrincipalComponents`. Not differentiable.

    **Raises:** `InputError` for NaN or infinity, for more components than there can be, and where
    all pixels (or, to be standardised, those of one band) are equal.
    """
    data = finite_pixels(spectra)
    if data.ndim != 2 or not 1 <= count <= min(data.shape[1], data.shape[0] - 1):
        raise InputError(
            f"`count` must be from 1 to the number of bands, and less than that of pixels, but is "
            f"{count} for spectra [pixel, band] of shape {data.shape}"
        )
    mean, spread = data.mean(axis=0), data.std(axis=0, ddof=1)
    flat = spread <= 1e-12 * np.abs(data).max()
    if flat.all() or (standardise and flat.any()):
        raise InputError("expected bands that vary, but in some all pixels are equal")
    scale = spread if standardise else np.ones_like(mean)
    _, singular, axes = np.linalg.svd((data - mean) / scale, full_matrices=False)
    variance = singular**2 / (len(data) - 1)
    axes = axes[:count]
    # A component has no sign of its own: that of its largest entry is positive.
    largest = np.take_along_axis(axes, np.abs(axes).argmax(axis=1)[:, None], axis=1)
    axes = axes * np.sign(largest)
    share = variance / variance.sum()
    return PrincipalComponents(mean, scale, axes, variance[:count], share[:count])


def hull_volume(points: ArrayLike) -> float:
    """Volume of the convex hull of points, in the unit of their axes to the power of their number.

    Grows with the number of pixels and rests on the outermost ones; compare equal numbers.

    **Arguments:** `points`: [pixel, component], the scores of `principal_components` that were
    found for all windows together.

    **Returns:** the volume; an area for two components, the range for one; 0 for points in a plane.
    Not differentiable (which points are on the hull steps).

    **Raises:** `InputError` for NaN, and for fewer points than components and one more.

    Source: Dahlin (2016), Ecological Applications 26, 2758; Qhull (Barber et al. 1996) by SciPy.

    >>> from fynjax.diversity import hull_volume
    >>> round(hull_volume([[0, 0], [2, 0], [0, 2], [0.5, 0.5]]), 6)
    2.0
    """
    data = finite_pixels(points, "points")
    if data.ndim != 2 or data.shape[1] == 0 or len(data) <= data.shape[1]:
        raise InputError(
            f"a hull needs points [pixel, component], more than components, but they have shape "
            f"{data.shape}"
        )
    if data.shape[1] == 1:
        return float(np.ptp(data))
    # Qhull refuses points that lie in a plane.
    if np.linalg.matrix_rank(data - data.mean(axis=0)) < data.shape[1]:
        return 0.0
    return float(ConvexHull(data).volume)


@dataclass(frozen=True)
class SpectralSpecies:
    """Clusters of spectra in windows, and the diversity that they make."""

    label: Int[np.ndarray, "*window pixel"]
    """Cluster of each pixel, from 0, in the first repeat; -1 where a pixel does not count."""
    share: Float[np.ndarray, "repeat window cluster"]
    """Share of each cluster in the pixels of a window [-]; windows in one row."""
    shannon: Float[np.ndarray, "*window"]
    """Shannon's entropy of the clusters in a window, mean over repeats [-]."""
    bray_curtis: Float[np.ndarray, "window window"]
    """Bray-Curtis dissimilarity of the windows, mean over repeats [-]."""


def spectral_species(
    spectra: ArrayLike,
    valid: ArrayLike | None = None,
    *,
    clusters: int = 50,
    components: int = 3,
    repeats: int = 1,
    least_share: float = 0.02,
    seed: int = 0,
) -> SpectralSpecies:
    """Spectral species: clusters of pixels in place of species, and their diversity.

    Bands are standardised; the first principal components, each brought to variance 1, are
    clustered by k-means; clusters with a smaller share of a window's pixels than `least_share` are
    left out of it; Shannon's entropy is that of the others, and Bray-Curtis dissimilarity compares
    their shares. With repeats the pixels are parted at random, and each part's clusters are those
    of one repeat. biodivMapR does the same, but lets its user pick the components, removes the
    continuum before, and scales components by their range without outliers.

    **Arguments:**

    - `spectra`: [..., pixel, band]; all axes before the pixels are windows (`windows`).
    - `valid`: [..., pixel] true where a pixel counts; all unless given. Others may be NaN.
    - `clusters`: how many, at least 2.
    - `components`: how many of the first are used.
    - `repeats`: how often clusters are found anew.
    - `least_share`: of a window's pixels [-], from 0 to below 1.
    - `seed`: the same seed gives the same clusters.

    **Returns:** `SpectralSpecies`. Not differentiable.

    **Raises:** `InputError` for values out of range, one window only, a window without pixels,
    fewer pixels than clusters, and as `principal_components`; `MissingExtraError` without
    scikit-learn (extra `analysis`).

    Source: Féret and Asner (2014), Ecological Applications 24, 1289; Féret and de Boissieu (2020),
    Methods in Ecology and Evolution 11, 64.
    """
    k_means = require("sklearn.cluster", "analysis", "scikit-learn").KMeans
    limits = require("threadpoolctl", "analysis").threadpool_limits
    data = np.asarray(spectra, np.float64)
    if data.ndim < 3 or data.size < 2 * data.shape[-1] * data.shape[-2]:
        raise InputError(
            "`spectra` must be [..., pixel, band] of two windows or more, but has shape "
            f"{data.shape}"
        )
    keep = np.ones(data.shape[:-1], bool) if valid is None else np.asarray(valid, bool)
    if keep.shape != data.shape[:-1]:
        raise InputError(f"`valid` must have shape {data.shape[:-1]}, but has {keep.shape}")
    if not keep.any(axis=-1).all():
        raise InputError("expected pixels that count in every window, but one has none")
    if not (repeats >= 1 and 0.0 <= least_share < 1.0):
        raise InputError("`repeats` must be at least 1, and `least_share` from 0 to below 1")
    pixels = data[keep]
    if not 2 <= clusters <= len(pixels) // repeats:
        raise InputError(
            f"`clusters` must be from 2 to the {len(pixels) // repeats} pixels of a repeat, but is "
            f"{clusters}"
        )
    # Components of all pixels, each at variance 1, so that each counts alike for the clusters.
    axes = principal_components(pixels, components, standardise=True)
    points = axes.scores(pixels) / np.sqrt(axes.variance)
    rows = keep[..., 0].size
    window = np.repeat(np.arange(rows), keep.shape[-1]).reshape(keep.shape)[keep]
    random = generator(seed)
    parts = np.array_split(random.permutation(len(points)), repeats)
    labels, shares = [], []
    for part in parts:
        with limits(limits=1):  # several threads add up in an order that differs from run to run
            model = k_means(clusters, n_init=10, random_state=int(random.integers(2**31)))
            labels.append(model.fit(points[part]).predict(points))
        shares.append(_window_shares(window, labels[-1], rows, clusters, least_share))
    label = np.full(keep.shape, -1)
    label[keep] = labels[0]
    return SpectralSpecies(
        label=label,
        share=np.stack(shares),
        shannon=np.mean([shannon(s) for s in shares], axis=0).reshape(keep.shape[:-1]),
        bray_curtis=np.mean([bray_curtis(s) for s in shares], axis=0),
    )


def _window_shares(
    window: Int[np.ndarray, " pixel"],
    label: Int[np.ndarray, " pixel"],
    rows: int,
    clusters: int,
    least: float,
) -> NDArray[np.float64]:
    """Share of each cluster among the pixels of a window, without those that are rare in it."""
    count = np.zeros((rows, clusters))
    np.add.at(count, (window, label), 1.0)
    # Rare clusters are dropped window by window, and the rest shared out anew.
    count = np.where(count >= least * count.sum(axis=1, keepdims=True), count, 0.0)
    total = count.sum(axis=1, keepdims=True)
    if not total.all():
        raise InputError(
            f"no cluster has {least:g} of the pixels of window {int(total.argmin()) + 1}: lower "
            "`least_share`, or take fewer clusters"
        )
    return count / total

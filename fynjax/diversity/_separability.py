"""Separability of species by their spectra: distances and classifications."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import pandas as pd
from jaxtyping import Int, Shaped
from numpy.typing import ArrayLike, NDArray

from fynjax._core.errors import InputError, listed, whole_number
from fynjax._core.extras import require
from fynjax.diversity._components import finite_pixels

Method = Literal["discriminant", "forest"]
_DRAWS = 10
"""Draws of two classes that are alike."""


def bhattacharyya_distance(
    first: ArrayLike, second: ArrayLike, *, shrinkage: float | None = None
) -> float:
    """Bhattacharyya distance of two normal classes, with their means and covariances [-].

    B = d' S^-1 d / 8 + ln(|S| / sqrt(|S1| |S2|)) / 2, with d the difference of the means and S the
    mean of the covariances S1 and S2.

    A covariance of few pixels in many bands is singular or nearly so. Each is therefore shrunk
    towards one with the same variance m (its mean) in all bands and none between them, (1 - s) S1 +
    s m I, by default with the s that Ledoit and Wolf (2004) estimate from the pixels. B would still
    be too large, the more so the fewer pixels a band. So by default B is made smaller by the mean B
    of 10 draws of classes that are alike: normal, with as many pixels and the covariance of all
    pixels about the means of their classes. Pixels count as independent. Of 20 pixels of each of
    two classes that are alike, in 4 to 50 bands without correlation, the Jeffries-Matusita distance
    is then 0.01 to 0.14 on average (0.15 to 1.1 without), and of classes at 0.79 0.67 to 0.84.

    **Arguments:**

    - `first`, `second`: [pixel, band] spectra of the classes, in one unit.
    - `shrinkage`: s, from 0 to 1, for B as the formula has it of the pixels; estimated for each
      class, and B made smaller, unless given.

    **Returns:** the distance, at least 0 and without bound. Not differentiable.

    **Raises:** `InputError` for NaN or infinity, other bands, fewer than two pixels, and a
    covariance that stays singular (all pixels equal, or no more pixels than bands with shrinkage
    0); `MissingExtraError` without scikit-learn (extra `analysis`), unless shrinkage is given.

    Source: Bhattacharyya (1943), Bulletin of the Calcutta Mathematical Society 35, 99; Kailath
    (1967), IEEE Transactions on Communication Technology 15, 52; Ledoit and Wolf (2004), Journal of
    Multivariate Analysis 88, 365.

    >>> from fynjax.diversity import bhattacharyya_distance
    >>> a = [[0.0], [2.0]]  # variance 2 with the number of pixels less 1
    >>> round(bhattacharyya_distance(a, [[4.0], [6.0]], shrinkage=0.0), 6)  # 4^2 / 2 / 8
    1.0
    """
    if shrinkage is not None and not 0.0 <= shrinkage <= 1.0:
        raise InputError(f"`shrinkage` must be from 0 to 1, but is {shrinkage:g}")
    classes = [finite_pixels(x) for x in (first, second)]
    shapes = [x.shape for x in classes]
    if any(len(s) != 2 or s[0] < 2 or s[1] < 1 for s in shapes) or shapes[0][1] != shapes[1][1]:
        raise InputError(
            "expected spectra [pixel, band] of two pixels or more in the same bands, but they have "
            f"the shapes {shapes[0]} and {shapes[1]}"
        )
    found = _distance(classes, shrinkage)
    if shrinkage is not None:
        return found
    # How large B comes out of so few pixels where classes are alike is taken off.
    away = np.concatenate([x - x.mean(axis=0) for x in classes])
    root = np.linalg.cholesky(_covariance(away, None))
    random, alike = np.random.default_rng(0), []
    for _ in range(_DRAWS):
        pixels = random.normal(size=away.shape) @ root.T
        alike.append(_distance(np.split(pixels, [len(classes[0])]), None))
    return max(found - float(np.mean(alike)), 0.0)


def _distance(classes: Sequence[NDArray[np.float64]], shrinkage: float | None) -> float:
    one, two = (_covariance(x, shrinkage) for x in classes)
    off = classes[0].mean(axis=0) - classes[1].mean(axis=0)
    # By logarithms of the determinants, which leave the range of numbers in many bands.
    both = 0.5 * (one + two)
    log = [_log_determinant(c) for c in (both, one, two)]
    distance = off @ np.linalg.solve(both, off) / 8.0 + 0.5 * (log[0] - 0.5 * (log[1] + log[2]))
    return float(distance)


def _covariance(pixels: NDArray[np.float64], shrinkage: float | None) -> NDArray[np.float64]:
    """Covariance of pixels [pixel, band], with their number less 1, shrunk to equal variances."""
    bands = pixels.shape[1]
    found = np.cov(pixels, rowvar=False).reshape(bands, bands)
    if shrinkage is None:
        sklearn = require("sklearn.covariance", "analysis", "scikit-learn")
        shrinkage = float(sklearn.ledoit_wolf_shrinkage(pixels)) if bands > 1 else 0.0
    return (1.0 - shrinkage) * found + shrinkage * np.trace(found) / bands * np.eye(bands)


def _log_determinant(covariance: NDArray[np.float64]) -> float:
    spread = np.sqrt(np.diag(covariance))
    # Of the correlations: the rank must not depend on the unit.
    if (spread > 0.0).all():
        correlation = covariance / np.outer(spread, spread)
        if np.linalg.matrix_rank(correlation, hermitian=True) == len(spread):
            return float(np.linalg.slogdet(correlation)[1] + 2.0 * np.log(spread).sum())
    raise InputError(
        "the covariance of a class is singular: give more pixels than bands that vary, or a "
        "`shrinkage` above 0"
    )


def jeffries_matusita_distance(bhattacharyya: ArrayLike) -> np.float64 | NDArray[np.float64]:
    """Jeffries-Matusita distance, 2 (1 - exp(-B)) [-], from 0 to 2, where classes are apart.

    Tools differ: some have the root of this, up to 1.414.

    **Arguments:** `bhattacharyya`: distances B, at least 0.

    **Raises:** `InputError` for a distance that is negative or NaN.

    Not differentiable (NumPy); its slope is 2 exp(-B).

    Source: Richards (2013), Remote Sensing Digital Image Analysis, section 10.2.
    """
    distance = np.asarray(bhattacharyya, np.float64)
    if not (distance >= 0.0).all():
        raise InputError("a Bhattacharyya distance must be at least 0")
    return -2.0 * np.expm1(-distance)


def separability(spectra: ArrayLike, species: Sequence[str] | np.ndarray) -> pd.DataFrame:
    """Distances of each two species by their spectra.

    **Arguments:**

    - `spectra`: [pixel, band].
    - `species`: name of the species of each pixel.

    **Returns:** a row for each pair, in alphabetical order: `first`, `second`, `bhattacharyya` and
    `jeffries_matusita`. Not differentiable.

    **Raises:** `InputError` as `bhattacharyya_distance`, for as many names as pixels not given, and
    for one species only.
    """
    data, names = _pixels(spectra, species)
    kinds = np.unique(names)
    rows = []
    for i, first in enumerate(kinds):
        for second in kinds[i + 1 :]:
            classes = data[names == first], data[names == second]
            rows.append((first, second, bhattacharyya_distance(*classes)))
    table = pd.DataFrame(rows, columns=["first", "second", "bhattacharyya"])
    table["jeffries_matusita"] = jeffries_matusita_distance(table["bhattacharyya"])
    return table


@dataclass(frozen=True)
class Classification:
    """How often the species of pixels is recognised by their spectra."""

    classes: tuple[str, ...]
    """Species or growth forms, in alphabetical order."""
    confusion: Int[np.ndarray, "true judged"]
    """Pixels of each class (rows) by what they were taken for (columns)."""
    by_group: dict[str, float]
    """Accuracy on all other groups of what was trained on a group [-]."""

    @property
    def accuracy(self) -> float:
        """Share of pixels that were recognised [-]."""
        return float(np.trace(self.confusion) / self.confusion.sum())

    def merged(self, of: Mapping[str, str]) -> "Classification":
        """The same by growth form, or any other class that species belong to.

        **Arguments:** `of`: the new class of each species.

        Accuracies by group stay those of species.

        **Raises:** `InputError` for a species that has none.
        """
        if missing := [name for name in self.classes if name not in of]:
            raise InputError(f"expected a class for every species, but {listed(missing)} has none")
        kinds = tuple(sorted({of[name] for name in self.classes}))
        place = [kinds.index(of[name]) for name in self.classes]
        merged = np.zeros((len(kinds), len(kinds)), self.confusion.dtype)
        np.add.at(merged, np.ix_(place, place), self.confusion)
        return Classification(kinds, merged, self.by_group)


def classify(
    spectra: ArrayLike,
    species: Sequence[str] | np.ndarray,
    group: Sequence[Any] | np.ndarray,
    *,
    method: Method = "discriminant",
    seed: int = 0,
) -> Classification:
    """Recognise species by their spectra: trained on one group of pixels, judged on all others.

    Each group, such as one planting, trains in turn, so that what is only true of one stand does
    not count as skill. A pixel is thus judged as often as there are other groups.

    **Arguments:**

    - `spectra`: [pixel, band].
    - `species`: name of the species of each pixel. Of a simulated image it is the one that leads in
      the pixel, and pixels without any that has enough are left out (`PixelTruth.leading`).
    - `group`: name or number of the group of each pixel; each group must have every species.
    - `method`: "discriminant", linear discriminant analysis with a covariance shrunk after Ledoit
      and Wolf, all species alike beforehand; or "forest", a random forest of 200 trees in which
      species have equal weight.
    - `seed`: the same seed gives the same forest.

    **Returns:** a `Classification`. Not differentiable.

    **Raises:** `InputError` for arrays that do not fit, NaN, one species, one group, a group that
    lacks a species, or has fewer pixels than species and one more; `MissingExtraError` without
    scikit-learn (extra `analysis`).

    Source: Fisher (1936), Annals of Eugenics 7, 179; Breiman (2001), Machine Learning 45, 5; both
    by scikit-learn.
    """
    data, names = _pixels(spectra, species)
    groups = np.array([str(g) for g in group])
    if groups.shape != names.shape:
        raise InputError(f"expected a group for each of {len(names)} pixels, but got {len(groups)}")
    kinds, number = np.unique(names, return_inverse=True)
    every = [str(name) for name in np.unique(groups)]
    if len(every) < 2:
        raise InputError("expected two groups or more, one to train and others to judge")
    for name in every:
        lacking = set(kinds) - set(names[groups == name])
        if lacking:
            raise InputError(f"group {name!r} has no pixel of {listed(sorted(lacking))}")
        if (groups == name).sum() <= len(kinds):
            raise InputError(f"group {name!r} has no more pixels than there are species")
    confusion = np.zeros((len(kinds), len(kinds)), np.int64)
    by_group = {}
    for name in every:
        model = _classifier(method, len(kinds), seed)
        model.fit(data[groups == name], number[groups == name])
        judged = model.predict(data[groups != name])
        # Trained on one group, judged on all others.
        true = number[groups != name]
        np.add.at(confusion, (true, judged), 1)
        by_group[name] = float(np.mean(true == judged))
    return Classification(tuple(str(kind) for kind in kinds), confusion, by_group)


def _classifier(method: Method, kinds: int, seed: int) -> Any:
    if method == "discriminant":
        module = require("sklearn.discriminant_analysis", "analysis", "scikit-learn")
        return module.LinearDiscriminantAnalysis(
            solver="lsqr", shrinkage="auto", priors=np.full(kinds, 1.0 / kinds)
        )
    if method == "forest":
        module = require("sklearn.ensemble", "analysis", "scikit-learn")
        seed = whole_number("seed", seed, most=2**32 - 1)
        return module.RandomForestClassifier(200, class_weight="balanced", random_state=seed)
    raise InputError(f"`method` must be 'discriminant' or 'forest', but is {method!r}")


def _pixels(
    spectra: ArrayLike, species: Sequence[str] | np.ndarray
) -> tuple[NDArray[np.float64], Shaped[np.ndarray, " pixel"]]:
    data, names = finite_pixels(spectra), np.array([str(name) for name in species])
    if data.ndim != 2 or data.shape[1] == 0 or len(data) != len(names):
        raise InputError(
            f"expected spectra [pixel, band] and a species for each pixel, but got shape "
            f"{data.shape} and {len(names)} names"
        )
    if len(set(names)) < 2:
        raise InputError("expected two species or more to tell apart, but there is one or none")
    return data, names

"""Communities of plants along gradients of richness, evenness, cover and years since fire."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import brentq

from fynjax._core.errors import InputError, listed
from fynjax.app.io.plot import Plot
from fynjax.canopy import FORMS, table1_2006
from fynjax.diversity import pielou_evenness
from fynjax.studies.fynbos_2006 import table_after_fire

_SETS = 200
"""Sets of species of which one is taken by how related they are."""
_STEEPEST = 1e-4
"""Cover of a species over that of the next more abundant one, at least [-]."""


@dataclass(frozen=True)
class Gradients:
    """Ranges within which communities differ, each drawn evenly.

    **Raises:** `InputError` for a range that is not in order or beyond its limits.
    """

    richness: tuple[int, int] = (2, 12)
    """Fewest and most species of a community."""
    evenness: tuple[float, float] = (0.4, 1.0)
    """Least and greatest evenness of the covers after Pielou, above 0 and at most 1 [-]."""
    cover: tuple[float, float] = (0.3, 0.9)
    """Least and greatest sum of the covers, above 0 and at most 1 [-]."""
    age: tuple[float, float] | None = None
    """Fewest and most years since fire, by which the article's taxa grow; sizes as in the species
    table if left out."""

    def __post_init__(self) -> None:
        limits = {"richness": (1.0, math.inf), "evenness": (1e-2, 1.0), "cover": (1e-3, 1.0)}
        limits["age"] = (1.0, 40.0)
        for name, (least, most) in limits.items():
            given = getattr(self, name)
            if given is None and name == "age":
                continue
            try:
                low, high = (number + 0.0 for number in given)
            except (TypeError, ValueError):
                low = high = math.nan
            whole = name != "richness" or low % 1 == high % 1 == 0.0  # infinity and NaN leave NaN
            if not whole or not least <= low <= high <= most:
                raise InputError(
                    f"expected `{name}` as two numbers in order, from {least:g} to {most:g}, but "
                    f"got {given!r:.60}"
                )


def check_pool(pool: Plot, gradients: Gradients) -> None:
    """**Raises:** `InputError` for a pool from which no such communities can be drawn."""
    leafy = alive(pool)
    if pool.known_crowns is not None or pool.parameters is not None:
        raise InputError("expected a plot without known crowns and without a table of parameters")
    if len(leafy) < gradients.richness[1]:
        raise InputError(
            f"the species table has {len(leafy)} species with leaves, but communities are to have "
            f"up to {gradients.richness[1]}: write at most {len(leafy)} (`richness`)"
        )
    if gradients.age is not None:
        known = set(table1_2006()["taxon"])
        if strange := [pool.taxa[i] for i in leafy if pool.taxa[i] not in known]:
            raise InputError(
                f"years since fire are known of the article's taxa alone, not of {listed(strange)}"
            )


def draw_community(
    pool: Plot, gradients: Gradients, random: np.random.Generator, related: ArrayLike = ()
) -> Plot:
    """A plot whose species are some of a pool's; the others have no cover.

    Covers of the species fall by a common factor from each to the next rarer one, the factor that
    gives the evenness.

    **Arguments:**

    - `pool`: a plot with the species, their sizes and leaves.
    - `gradients`: within which the community lies.
    - `random`: of its numbers.
    - `related`: path between each two species in a tree of descent. With it communities are drawn
      along a gradient of the mean path between their species as well: of 200 sets of species the
      one that is nearest to a number drawn evenly between their least and greatest.
    """
    count = int(random.integers(gradients.richness[0], gradients.richness[1] + 1))
    cover = random.uniform(*gradients.cover) * shares_of(random.uniform(*gradients.evenness), count)
    apart = np.asarray(related)
    sets = [random.permutation(alive(pool))[:count] for _ in range(_SETS if apart.size else 1)]
    chosen = sets[0]
    if apart.size:
        paths = np.array([apart[np.ix_(one, one)].mean() for one in sets])
        chosen = sets[np.argmin(np.abs(paths - random.uniform(paths.min(), paths.max())))]
    covers = dict(zip(chosen.tolist(), cover.tolist(), strict=True))
    grown = np.ones((len(pool.species), 2))
    if gradients.age is not None:
        sizes = ["mean_diameter_cm", "height_max_m"]
        now, then = (
            table.set_index("taxon")[sizes]
            for table in (table1_2006(), table_after_fire(random.uniform(*gradients.age)))
        )
        for i in chosen:
            grown[i] = (then.loc[pool.taxa[i]] / now.loc[pool.taxa[i]]).to_numpy(float)
    rows = [
        row.replace(
            cover=covers.get(i, 0.0), diameter=row.diameter * wide, height=row.height * tall
        )
        for i, (row, (wide, tall)) in enumerate(zip(pool.species, grown, strict=True))
    ]
    return pool.replace(species=tuple(rows))


def shares_of(evenness: float, count: int) -> np.ndarray:
    """Shares of `count` species, a geometric series, with an `evenness` after Pielou [-]."""

    def series(ratio: float) -> np.ndarray:
        shares = ratio ** np.arange(count)
        return shares / shares.sum()

    if count == 1:
        return np.ones(1)
    lacking = lambda ratio: float(pielou_evenness(series(ratio))) - evenness  # noqa: E731
    if lacking(_STEEPEST) >= 0.0 or lacking(1.0) <= 0.0:
        return series(_STEEPEST if lacking(_STEEPEST) >= 0.0 else 1.0)
    return series(float(brentq(lacking, _STEEPEST, 1.0)))


def alive(pool: Plot) -> np.ndarray:
    """Places in the species table of those with leaves."""
    return np.flatnonzero([FORMS[row.growth_form].leafy for row in pool.species])

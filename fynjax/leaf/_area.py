"""Shapes of leaves, and the area that contents of a leaf are stated per."""

import math
from typing import Any, Literal, get_args

from fynjax._core.errors import InputError
from fynjax.leaf._parameters import LEAF_PARAMETERS

LeafShape = Literal["broad", "needle", "mat", "culm"]
"""Shape of leaves: broad leaves are flat and fill a field of view; of round ones needles are single
or apart, a mat is needles side by side, and culms lie side by side too."""
SIDE_BY_SIDE = ("mat", "culm")
"""Shapes between which light goes to and fro."""
LeafArea = Literal["projected", "half_total"]
"""Area that contents of a leaf are stated per: what a scanner sees, or half of its surface."""

FLAT, ROUND = 1.0, math.pi / 2
"""Half of a leaf's surface over its projected area [-]. A spectrum and most trait libraries refer
to the area that is seen; light meets half of the surface (Chen and Black 1992, Plant, Cell and
Environment 15, 421). The surface of a long convex solid is pi times its mean plan area (Lang 1991,
Agricultural and Forest Meteorology 54, 191): needles, rolled leaves, culms, succulent fingers."""

_HALF_OVER_PROJECTED = {"broad": FLAT, "needle": ROUND, "mat": ROUND, "culm": ROUND}
_NOT_PER_AREA = ("structure", "brown_pigments")


def check_leaf_shape(shape: str) -> None:
    """Raise `InputError` for an unknown shape."""
    _check(shape, LeafShape, "leaf_shape")


def _check(given: str, kinds: Any, what: str) -> None:
    if given not in get_args(kinds):
        raise InputError(f"`{what}` must be one of {', '.join(get_args(kinds))}, but is {given!r}")


def area_factors(area: LeafArea, shape: LeafShape) -> dict[str, float]:
    """Factor of each parameter from per projected area, as spectra give it, to another area [-].

    **Arguments:**

    - `area`: "projected" or "half_total".
    - `shape`: "broad", or "needle", "mat" or "culm", which count as round.

    **Returns:** by the names of `LeafParameters`: 1, or 2 / pi for the contents of round leaves per
    half of their surface.

    **Raises:** `InputError` for an unknown area or shape.

    >>> from fynjax.leaf import area_factors
    >>> round(area_factors("half_total", "needle")["dry_matter"], 4)
    0.6366
    """
    _check(area, LeafArea, "area")
    check_leaf_shape(shape)
    content = 1.0 if area == "projected" else 1.0 / _HALF_OVER_PROJECTED[shape]
    return {name: 1.0 if name in _NOT_PER_AREA else content for name in LEAF_PARAMETERS}

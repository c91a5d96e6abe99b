"""Which frames of a flight say most of how a plot looks from different sides."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

_ALIKE = 15.0
"""Degrees between two views at which what they say is alike by 0.6, as assumed."""
_NOISE = 0.3
"""Error of what a frame of the whole plot says over how much views differ, as assumed [-]."""


_SWEEPS = 5
"""Times that every chosen frame may be exchanged for one that says more, at most."""


def direction_features(
    zenith: Float[np.ndarray, " frame"],
    azimuth: Float[np.ndarray, " frame"],
    sun: Sequence[tuple[float, float] | None],
) -> Float[np.ndarray, "frame 4"]:
    """Views and suns as points of which near ones look alike: zenith angles along east and north
    [degrees].

    **Arguments:** `zenith`, `azimuth` of each camera [degrees]; `sun`, the same of each sun, None
    for that of the plot, which all without one share.
    """
    suns = np.array([(0.0, 0.0) if one is None else one for one in sun], float).reshape(-1, 2)
    angles = np.column_stack([zenith, azimuth]), suns
    return np.concatenate(
        [
            one[:, :1] * np.stack([np.sin(a := np.radians(one[:, 1])), np.cos(a)], axis=-1)
            for one in angles
        ],
        axis=1,
    )


def choose_frames(
    features: Float[np.ndarray, "frame feature"], seen: Float[np.ndarray, " frame"], most: int
) -> list[int]:
    """The `most` frames that together say most of reflectance as a smooth function of the angles.

    Of a Gaussian process over the angles, whose errors are as much larger as a frame sees less of
    the plot, each next frame is the one of most information gain (Krause, Singh & Guestrin 2008,
    near-optimal sensor placements); then each is exchanged while that adds to it.

    **Arguments:** `features`, as of `direction_features`; `seen`, share of the plot that each sees
    [-]; `most`, at least one.

    **Returns:** places of the frames in their order.
    """
    apart = np.sum((features[:, None] - features[None]) ** 2, axis=-1)
    kernel = np.exp(-0.5 * apart / _ALIKE**2)
    noise = _NOISE**2 / np.maximum(seen, 1e-6)
    able = np.flatnonzero(seen > 0.0).tolist()

    def information(places: list[int]) -> float:
        whitened = kernel[np.ix_(places, places)] / np.sqrt(np.outer(noise[places], noise[places]))
        return float(np.linalg.slogdet(np.eye(len(places)) + whitened)[1])

    chosen: list[int] = []
    while len(chosen) < min(most, len(able)):
        left = [k for k in able if k not in chosen]
        chosen.append(max(left, key=lambda k: information([*chosen, k])))
    for _ in range(_SWEEPS):  # the first of them was chosen without the others
        before = list(chosen)
        for i in range(len(chosen)):
            rest = chosen[:i] + chosen[i + 1 :]
            chosen[i] = max(
                [chosen[i], *(k for k in able if k not in chosen)],
                key=lambda k: information([*rest, k]),
            )
        if chosen == before:
            break
    return sorted(chosen)

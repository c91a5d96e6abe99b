"""Twigs from the stems of a generated plant to its leaves."""

import numpy as np

from fynjax.canopy.mesh._generate_parts import tangents, unit

_POINTS = 6
_RISE = 0.7
"""Least slope at which a twig leaves its bearer: height gained over sideways reach."""
_FLOW_POWER = 1.0 / 2.2
"""A twig's radius grows with the number of tips that it carries to this power (1/3 in Murray's law,
1/2 in the pipe model)."""


def twigs(stems: np.ndarray, tips: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Twigs to all `tips` [tip, 3], each from the nearest place on `stems` [stem, point, 3] or on
    an earlier twig.

    A twig begins `_RISE` times its sideways reach below its tip, or lower, where it can (greedy
    trees after Cuntz et al. 2010). Returns paths [tip, point, 3] and radii [tip, point], those of
    a stem being 1.
    """
    first = stems.shape[0] * stems.shape[1]
    points = np.empty((first + len(tips) * _POINTS, 3))
    ahead = np.empty_like(points)
    points[:first], ahead[:first] = stems.reshape(-1, 3), tangents(stems).reshape(-1, 3)
    near = np.array([np.linalg.norm(points[:first] - tip, axis=1).min() for tip in tips])
    part = np.linspace(0.0, 1.0, _POINTS)[:, None]
    bearer = np.empty(len(tips), int)
    # Tips near the stems first: their twigs bear those farther out.
    for index, tip in enumerate(tips[np.argsort(near, kind="stable")]):
        used = first + index * _POINTS
        reach = tip - points[:used]
        # A joint that lies too high for the rise counts as farther away by twice as much.
        low = np.maximum(_RISE * np.hypot(reach[:, 0], reach[:, 1]) - reach[:, 2], 0.0)
        joint = bearer[index] = np.argmin(np.linalg.norm(reach, axis=1) + 2.0 * low)
        start = points[joint]
        span = np.linalg.norm(tip - start)
        bend = start + 0.4 * span * unit(ahead[joint] + 0.8 * unit(tip - start))
        # A Bezier curve that leaves its bearer partly along it.
        path = (1 - part) ** 2 * start + 2 * part * (1 - part) * bend + part**2 * tip
        points[used : used + _POINTS] = path
        ahead[used : used + _POINTS] = tangents(path[None])[0]

    # Tips carried beyond each point of a twig, summed from the last twig to the first.
    carried = np.zeros(len(points))
    for index in range(len(tips) - 1, -1, -1):
        twig = slice(first + index * _POINTS, first + (index + 1) * _POINTS)
        carried[twig] = 1.0 + np.cumsum(carried[twig][::-1])[::-1]
        carried[bearer[index]] += carried[twig][0]
    radii = (carried[first:].reshape(-1, _POINTS) * len(stems) / len(tips)) ** _FLOW_POWER
    return points[first:].reshape(-1, _POINTS, 3), np.minimum(radii, 1.0)

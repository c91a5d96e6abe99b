"""Neighbouring bands taken together: a spectrometer's hundreds say what some twenty do."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, Float
from numpy.typing import ArrayLike

from fynjax._core.errors import InputError
from fynjax.metrics import WATER_WINDOWS
from fynjax.sensors._bands import BandSet

_LOWEST, _HIGHEST = 430.0, 2400.0
"""Beyond, spectrometers see little but noise and atmosphere [nm]."""
_TURN = 1000.0
_WIDTH = (40.0, 80.0)
"""Width of a channel below and above `_TURN` [nm]: leaf pigments change faster than water."""
_SHIFT = 0.35
"""Bands of a cube may lie so far off a channel's, in channel widths [-]."""


@dataclass(frozen=True)
class Channels:
    """Groups of neighbouring bands, each of which is taken as one: the mean of its bands."""

    lower: Float[np.ndarray, " channel"]
    """Wavelength at which a group begins [nm]."""
    upper: Float[np.ndarray, " channel"]
    """Wavelength at which a group ends [nm]."""
    centre: Float[np.ndarray, " channel"]
    """Mean of the centres of its bands [nm]."""

    def weights(
        self, centre: ArrayLike, good: Bool[np.ndarray, " band"] | None = None
    ) -> Float[np.ndarray, "channel band"]:
        """Weights that make channels of the bands of a cube [-]; rows sum to one.

        **Arguments:**

        - `centre`: of the cube's bands [nm].
        - `good`: which of them are to be used; all by default.

        **Raises:** `InputError` where a channel has no band, or has others than it was made of.
        """
        bands = np.asarray(centre, float)
        use = np.isfinite(bands) if good is None else np.isfinite(bands) & good
        if use.any() and bands[use].max() < 10.0:
            raise InputError(
                f"expected wavelengths in nanometres, but they end at {bands[use].max():g}. Are "
                "these micrometres?"
            )
        rows = []
        for low, high, middle in zip(self.lower, self.upper, self.centre, strict=True):
            inside = use & (bands >= low) & (bands <= high)
            if not inside.any():
                raise InputError(
                    f"expected a good band between {low:.0f} and {high:.0f} nm, but there is none. "
                    "Train for the bands that this cube has: fynjax train --like CUBE"
                )
            row = inside / inside.sum()
            if abs(bands[inside].mean() - middle) > _SHIFT * (high - low):
                raise InputError(
                    f"expected bands around {middle:.0f} nm from {low:.0f} to {high:.0f} nm, but "
                    f"the good ones lie around {bands[inside].mean():.0f} nm. Train for the bands "
                    "that this cube has: fynjax train --like CUBE"
                )
            rows.append(row)
        return np.stack(rows)


def group_bands(
    bands: BandSet, good: Sequence[bool] | Bool[np.ndarray, " band"] | None = None
) -> tuple[Channels, BandSet]:
    """Group the bands of a sensor for vegetation from above, without the water windows.

    **Arguments:**

    - `bands`: of the sensor.
    - `good`: which of them are to be used; all by default.

    **Returns:** the channels, and the bands that they make: each the mean of the responses of its
    own.

    **Raises:** `InputError` where less than three channels are left.
    """
    centre, width = np.asarray(bands.centre), np.asarray(bands.fwhm)
    use = np.ones(len(bands), bool) if good is None else np.asarray(good, bool).copy()
    use &= (centre >= _LOWEST) & (centre <= _HIGHEST)
    for low, high in WATER_WINDOWS:
        # A band of a wide-band sensor that begins in a window still sees the ground.
        use &= (centre < low) | (centre > high)
    order = np.flatnonzero(use)[np.argsort(centre[use])]
    groups: list[list[int]] = []
    for place in order.tolist():
        last = groups[-1] if groups else []
        wide = _WIDTH[int(centre[place] > _TURN)]
        # Neighbours that leave more than their widths between them stay apart.
        if (
            last
            and centre[place] - centre[last[0]] < wide
            and centre[place] - centre[last[-1]] <= width[last[-1]] + width[place]
        ):
            last.append(place)
        else:
            groups.append([place])
    if len(groups) < 3:
        raise InputError(
            f"expected bands for three channels or more from {_LOWEST:g} to {_HIGHEST:g} nm "
            f"outside the water windows, but got {len(groups)}"
        )
    # A channel ends half a band's width beyond the middles of its outermost bands.
    half = [max(0.5 * float(width[group].mean()), 1.0) for group in groups]
    lower = np.array([centre[g[0]] - h for g, h in zip(groups, half)])
    upper = np.array([centre[g[-1]] + h for g, h in zip(groups, half)])
    middle = np.array([centre[g].mean() for g in groups])
    names = tuple(f"{value:.0f}nm" for value in middle)
    if len(set(names)) < len(names):
        names = tuple(f"{value:.6g}nm" for value in middle)
    curves: Any = [_response(bands.select(group)) for group in groups]
    joined = BandSet(names, tuple(middle), tuple(upper - lower), curves=curves)
    return Channels(lower, upper, middle), joined


def _response(bands: BandSet) -> tuple[Float[np.ndarray, " w"], Float[np.ndarray, " w"]]:
    """Mean response of some bands."""
    if bands.curves is not None:
        low = min(points[0] for points, _ in bands.curves)
        high = max(points[-1] for points, _ in bands.curves)
    else:
        # A Gaussian has next to nothing beyond 2.2 of its widths.
        reach = 2.2 * np.asarray(bands.fwhm)
        low, high = float((bands.centre - reach).min()), float((bands.centre + reach).max())
    grid = np.arange(max(np.floor(low), 400.0), min(np.ceil(high), 2500.0) + 0.5)
    return grid, bands.weights(grid, max_loss=0.2).mean(axis=0)

"""Plots drawn anew and exchanged, and correlations over them."""

import numpy as np
from jaxtyping import Float, Int

from fynjax._core.seeds import generator

DRAWS = 1000
"""How often plots are drawn anew, and exchanged."""
INTERVAL = (0.05, 0.95)
"""Shares between which an interval lies."""


def plot_draws(
    count: int, seed: int, *parts: int
) -> tuple[Int[np.ndarray, "draw plot"], Int[np.ndarray, "exchange plot"]]:
    """Places of `count` plots: first all of them and then drawn with replacement (bootstrap); and
    exchanged, each once (permutation)."""
    random = generator(seed, *parts)
    drawn = random.integers(0, count, (DRAWS, count))
    every = np.arange(count)
    exchanged = random.permuted(np.tile(every, (DRAWS, 1)), axis=1)
    return np.concatenate([every[None], drawn]), exchanged


def correlation_over(
    x: Float[np.ndarray, "*draw plot"], y: Float[np.ndarray, "draw plot"]
) -> Float[np.ndarray, " draw"]:
    """Correlation of each draw over the plots that have both values [-]; NaN where one does not
    vary, and of fewer than three."""
    known = np.isfinite(x) & np.isfinite(y)
    number = np.maximum(known.sum(axis=-1, keepdims=True), 1)

    def away(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        values = np.where(known, values, 0.0)
        rest = np.where(known, values - values.sum(axis=-1, keepdims=True) / number, 0.0)
        square = (rest**2).sum(axis=-1)
        return rest, np.where(square > 1e-20 * (values**2).sum(axis=-1), square, np.nan)

    (x, of_x), (y, of_y) = away(x), away(y)
    return np.where(number[..., 0] > 2, (x * y).sum(axis=-1) / np.sqrt(of_x * of_y), np.nan)

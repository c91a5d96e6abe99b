"""Clouds of returns that the tests of structure share."""

from dataclasses import replace

import numpy as np

from fynjax.metrics.structure import (
    STRUCTURE_PRESETS,
    BinnedReturns,
    StructureSettings,
    bin_returns,
    cell_grid,
)


def low(settings: StructureSettings) -> StructureSettings:
    """The same conventions with the lengths of shrubs: layers of a fifth where they are a metre."""
    if settings.layer < 1.0:
        return settings
    names = ("layer", "lowest", "diversity_lowest")
    shorter = {name: getattr(settings, name) / 5.0 for name in names}
    return replace(settings, **shorter, gap_height=max(0.1, settings.gap_height / 5.0))


LOW_PRESETS = {name: low(settings) for name, settings in STRUCTURE_PRESETS.items()}


def fynbos_returns(number: int = 1317, seed: int = 0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """x, y and height of returns on 10 m x 10 m: a tenth from the ground, the rest as gamma."""
    rng = np.random.default_rng(seed)
    x, y = rng.uniform(0.0, 10.0, (2, number))
    return x, y, np.where(rng.random(number) < 0.1, 0.0, rng.gamma(4.0, 0.16, number))


def fynbos_cells(
    settings: StructureSettings, number: int = 1317, grain: float = 2.0
) -> BinnedReturns:
    return bin_returns(*fynbos_returns(number), cell_grid((0, 0, 10, 10), 2.0), settings)

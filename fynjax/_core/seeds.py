"""Random numbers from a seed that a user states."""

from typing import SupportsIndex

import numpy as np

from fynjax._core.errors import whole_number


def generator(seed: SupportsIndex, *parts: SupportsIndex) -> np.random.Generator:
    """Random numbers that `seed` gives, and `parts` that tell uses of one seed from each other.

    **Raises:** `InputError` for a `seed` that is no whole number of at least 0.
    """
    return np.random.default_rng([whole_number("seed", seed), *map(int, parts)])

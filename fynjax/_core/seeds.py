"""Random numbers from a seed that a user states."""

import numpy as np

from fynjax._core.errors import whole_number


def generator(seed: int, *parts: int) -> np.random.Generator:
    """Random numbers that `seed` gives, and `parts` that tell uses of one seed from each other.

    **Raises:** `InputError` for a `seed` that is no whole number from 0 to 2147483647.
    """
    return np.random.default_rng([whole_number("seed", seed, most=2**31 - 1), *parts])

"""Structure from leaf mass: against N that others fitted, and its limits."""

import gzip

import numpy as np
import pandas as pd

from fynjax.leaf import LEAF_PARAMETERS, structure_from_dry_matter


def test_structure_follows_mass_as_in_published_fits(shared_data):
    """N of ANGERS and LOPEX as Feret et al. (2008) fitted it, not as this code does."""
    folder = shared_data / "leaf"
    leaves = []
    for name in ("angers", "lopex"):
        with gzip.open(folder / f"{name}_chemistry.csv.gz", "rt") as table:
            leaves.append(pd.read_csv(table)[["N_feret", "lma"]].dropna())
    both = pd.concat(leaves)
    error = np.log(structure_from_dry_matter(both.lma.to_numpy()) / both.N_feret)
    assert abs(error.mean()) < 0.1  # fits of two codes to the same leaves differ by some per cent
    assert error.std() < 0.9 * np.log(both.N_feret).std()  # mass says something of structure


def test_structure_stays_within_its_bounds():
    record = LEAF_PARAMETERS["structure"]
    light, usual, heavy = structure_from_dry_matter([0.0, 0.01, 10.0])
    assert (light, heavy) == (record.lower, record.upper)
    np.testing.assert_allclose(usual, np.exp(0.275 * np.log(100.0) - 0.689))

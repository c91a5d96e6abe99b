"""The hierarchical fit against simulated species."""

import jax
import numpy as np
import pytest

from fynjax.leaf import LeafParameters, default_error_model, fit_leaf, fit_leaf_groups, prospect
from fynjax.leaf._error_model import bin_centres, to_bins

GRID = np.arange(400.0, 2501.0)


def species(seed=0, leaves=5):
    """Three species of five leaves with the error of real leaves; dry matter varies by 12 %."""
    draw = np.random.default_rng(seed)
    centre = np.repeat([0.004, 0.009, 0.018], leaves)
    truth = {
        "structure": np.repeat([1.4, 1.7, 2.1], leaves) * np.exp(draw.normal(0, 0.04, 3 * leaves)),
        "chlorophyll": np.repeat([30.0, 45.0, 55.0], leaves)
        * np.exp(draw.normal(0, 0.15, 3 * leaves)),
        "water": np.repeat([0.008, 0.012, 0.016], leaves) * np.exp(draw.normal(0, 0.1, 3 * leaves)),
        "dry_matter": centre * np.exp(draw.normal(0, 0.12, 3 * leaves)),
    }
    optics = jax.vmap(prospect)(LeafParameters.many(**truth))
    model = default_error_model()
    r = to_bins(GRID, np.asarray(optics.reflectance))
    r += (
        0.7 * draw.normal(size=(len(r), len(model.reflectance_factors))) @ model.reflectance_factors
    )
    return truth, np.clip(r, 0.0, 1.0), np.repeat(["soft", "middle", "tough"], leaves)


def test_leaves_of_a_species_help_each_other():
    truth, r, names = species()
    together = fit_leaf_groups(bin_centres(), r, groups=names)
    alone = fit_leaf(bin_centres(), r)
    assert together.groups == ("soft", "middle", "tough")
    for trait in ("dry_matter", "water", "chlorophyll"):  # ratios of 0.67 to 0.93 over eight seeds
        error = [
            np.sqrt(np.mean(np.log(np.asarray(getattr(f.parameters, trait)) / truth[trait]) ** 2))
            for f in (together.leaves, alone)
        ]
        assert error[0] < 0.95 * error[1], trait
    assert np.all(np.diff(np.asarray(together.mean.dry_matter)) > 0)
    i = alone.names.index("dry_matter")
    assert np.median(together.leaves.standard_deviation[:, i] / alone.standard_deviation[:, i]) < 1

    drawn = together.variants(200, seed=3)
    assert drawn.water.shape == (3, 200)
    np.testing.assert_allclose(
        np.median(np.asarray(drawn.water), 1), np.asarray(together.mean.water), rtol=0.1
    )
    np.testing.assert_array_equal(drawn.water, together.variants(200, seed=3).water)
    assert np.all(np.std(np.log(np.asarray(drawn.dry_matter)), axis=1) > 0.05)


def test_a_group_of_one_and_a_wrong_number_of_names():
    _, r, names = species(1, 2)
    fitted = fit_leaf_groups(bin_centres(), r[:3], groups=["a", "a", "b"])
    assert fitted.leaves.converged.all()
    with pytest.raises(ValueError, match="groups"):
        fit_leaf_groups(bin_centres(), r, groups=names[:2])

"""The hierarchical fit against simulated species."""

import equinox as eqx
import jax
import numpy as np
import pytest
from scipy.linalg import block_diag

from fynjax.leaf import IntegratingSphere, LeafParameters, fit_leaf, fit_leaf_groups, prospect
from fynjax.leaf._error_model import bin_centres, default_error_model, to_bins
from fynjax.leaf._groups import _species
from fynjax.leaf._problem import LeafSettings, make_setup

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


def test_a_species_is_the_conditional_of_the_joint_gaussian():
    """Mean, leaves and common error as one vector, conditioned on what three spectra say."""
    draw = np.random.default_rng(0)
    size, count, shared = 2, 3, 0.4

    def covariance(scale, shape=()):
        root = draw.normal(size=(*shape, size, size))
        return scale * (root @ root.swapaxes(-1, -2) + 0.3 * np.eye(size))

    prior, within = covariance(1.0), covariance(0.3)
    errors = covariance(0.5, (count,))
    setup = make_setup(LeafSettings("D", IntegratingSphere(), "broad"))
    setup = setup._replace(prior_mean=draw.normal(size=size), prior_precision=np.linalg.inv(prior))
    said = draw.normal(size=(count, size))
    precision = np.linalg.inv(errors)
    weighted = np.einsum("npq,nq->np", precision, said)
    result = _species(precision, weighted, within, shared, setup)

    common = np.linalg.inv(precision.mean(0) / shared + setup.prior_precision)
    eye, none = np.eye(size), np.zeros((size, size))
    # The unknowns are the mean, the common error, and what each leaf departs from the mean by.
    leaf = [
        np.hstack([eye, none, *(eye if i == j else none for j in range(count))])
        for i in range(count)
    ]
    reading = np.vstack([row + np.hstack([none, eye] + [none] * count) for row in leaf])
    start = block_diag(prior, common, *[within] * count)
    noise = block_diag(*((1 - shared) * errors))
    expected = np.concatenate([setup.prior_mean, np.zeros(size * (1 + count))])
    gain = start @ reading.T @ np.linalg.inv(reading @ start @ reading.T + noise)
    unknowns = expected + gain @ (said.ravel() - reading @ expected)
    remains = start - gain @ reading @ start
    np.testing.assert_allclose(result.mean, unknowns[:size], rtol=1e-9)
    for i, row in enumerate(leaf):
        np.testing.assert_allclose(result.leaves[i], row @ unknowns, rtol=1e-9)
        np.testing.assert_allclose(result.covariance[i], row @ remains @ row.T, rtol=1e-9)
        at = slice(size * (2 + i), size * (3 + i))
        square = np.outer(unknowns[at], unknowns[at]) + remains[at, at]
        np.testing.assert_allclose(result.scatter[i], square, rtol=1e-9)


def test_a_common_error_of_a_species_is_in_its_intervals():
    """Five leaves with one error: their mean is no better known than a leaf, and says so."""
    _, r, names = species(2)
    model = default_error_model()
    errors = np.random.default_rng(5).normal(size=(3, len(model.reflectance_factors)))
    r = np.clip(r + 0.7 * np.repeat(errors, 5, axis=0) @ model.reflectance_factors, 0.0, 1.0)
    # Without what spectra never say of a trait, which is the same in both.
    spectral = np.tile([-np.inf, 0.0], (5, 1))
    width = {}
    for share in (0.05, 0.9):
        stated = eqx.tree_at(
            lambda m: (m.species_share, m.trait_discrepancy), model, (np.full(5, share), spectral)
        )
        fit = fit_leaf_groups(
            bin_centres(), r, groups=names, settings=LeafSettings(error_model=stated)
        ).leaves
        i = fit.names.index("dry_matter")
        width[share] = np.median(fit.upper[:, i] - fit.lower[:, i])
    assert width[0.9] > 1.2 * width[0.05]


def test_a_group_of_one_and_a_wrong_number_of_names():
    _, r, names = species(1, 2)
    fitted = fit_leaf_groups(bin_centres(), r[:3], groups=["a", "a", "b"])
    assert fitted.leaves.converged.all()
    with pytest.raises(ValueError, match="groups"):
        fit_leaf_groups(bin_centres(), r, groups=names[:2])

"""Water corrected by what fits leave in spectra: the recipe on made-up campaigns, and its use."""

import equinox as eqx
import jax
import numpy as np
import pytest
from scipy.optimize import approx_fprime

import fynjax as fx
from fynjax.errors import InputError
from fynjax.leaf import LEAF_PARAMETERS, fit_leaf, regress_water
from fynjax.leaf._regression import remains, water_regressions, window_bins
from tools.estimate_error_model import read
from tools.estimate_regression import Case, Process, fitted, process, rms

CAMPAIGNS, LEAVES, INPUTS = 6, 60, 5


def _process(shared: float, own: float) -> tuple[Process, np.ndarray]:
    """Of errors with slopes that all campaigns share and slopes of their own, and the former."""
    draw = np.random.default_rng(0)
    common = shared * draw.normal(size=INPUTS)
    x, y = [], []
    for _ in range(CAMPAIGNS):
        x.append(draw.normal(size=(LEAVES, INPUTS)) / np.sqrt(INPUTS))
        slopes = common + own * draw.normal(size=INPUTS)
        y.append(0.1 * draw.normal() + x[-1] @ slopes + 0.05 * draw.normal(size=LEAVES))
    campaign = np.repeat([f"c{i}" for i in range(CAMPAIGNS)], LEAVES)
    species = np.tile([f"s{i}" for i in range(LEAVES // 2)], 2 * CAMPAIGNS)
    return Process(np.concatenate(y), np.concatenate(x), campaign, species, campaign), common


def test_only_what_campaigns_share_reaches_a_new_one():
    """Shared slopes are found; those of single campaigns widen the interval of a new one."""
    x = np.random.default_rng(1).normal(size=(200, INPUTS)) / np.sqrt(INPUTS)
    process, common = _process(0.5, 0.05)
    np.testing.assert_allclose(process.predict(x).log, x @ common, atol=0.1)
    process, _ = _process(0.0, 0.5)
    assert process.deviation[3] == pytest.approx(0.5, rel=0.3)
    assert process.predict(x).log.std() < 0.15
    draw = np.random.default_rng(2)
    slopes = 0.5 * draw.normal(size=(INPUTS, 500))
    new = x @ slopes + 0.1 * draw.normal(size=500) + 0.05 * draw.normal(size=(200, 500))
    held = np.abs(new) < process.predict(x).half[:, None]
    assert 0.88 < held.mean() < 0.97


def test_the_slope_of_the_marginal_likelihood():
    """Against differences."""
    process, _ = _process(0.3, 0.2)
    at = process.guess + 0.1
    _, slope = process._surprise(at)
    by_differences = approx_fprime(at, lambda log: process._surprise(log)[0], 1e-6)
    np.testing.assert_allclose(slope, by_differences, rtol=1e-3, atol=1e-3)


@pytest.fixture(scope="module")
def fit():
    """Of seven leaves, two with T, whose R differs from PROSPECT's by a band of water."""
    leaves = fx.LeafParameters.many(water=np.linspace(0.006, 0.024, 7))
    optics = jax.vmap(fx.prospect)(leaves)
    wavelength = np.asarray(optics.wavelength[0])
    size = np.array([0.0, 0.01, 0.02, 0.03, 0.04, 0.05, 0.06])[:, None]
    wrong = 1.0 + size * np.exp(-0.5 * ((wavelength - 1150.0) / 30.0) ** 2)
    through = np.asarray(optics.transmittance).copy()
    through[:5] = np.nan
    return fit_leaf(wavelength, np.asarray(optics.reflectance) * wrong, through)


def test_remains_are_slopes_of_a_logarithm(fit):
    """Of a ratio that bends as a parabola, whatever the brightness; R before T."""
    inside = window_bins(fit, "water")
    at = fit.wavelength[inside]
    known = fit.fitted.copy()
    for part, bend in ((0, 1e-7), (1, 3e-7)):
        known[:, part] *= 0.7 * np.exp(bend * (fit.wavelength - 1500.0) ** 2)
    bent = eqx.tree_at(lambda of: of.measured, fit, known)
    found = remains(bent, "water", (0, 1)).reshape(len(known), 2, -1)
    for part, bend in ((0, 1e-7), (1, 3e-7)):
        # The wettest leaf is too dark for a logarithm at 1930 nm.
        expected = np.broadcast_to(2 * bend * (at - 1500.0), found[:6, part].shape)
        np.testing.assert_allclose(found[:6, part, 10:-10], expected[:, 10:-10], atol=1e-8)


def test_water_changes_by_what_a_leaf_has_beyond_the_median(fit):
    """The linear function of the table; intervals keep their width in the logit, all else stays."""
    corrected = regress_water(fit)
    at = fit.names.index("water")
    before, after = (np.asarray(of.parameters.water) for of in (fit, corrected))
    for given, rows, parts in (("R", slice(0, 5), (0,)), ("RT", slice(5, 7), (0, 1))):
        coefficients, limit = water_regressions()[given]
        x = remains(fit, "water", parts)[rows]
        x = x - np.median(x, axis=0)
        assert np.linalg.norm(x, axis=1).max() < limit
        np.testing.assert_allclose(np.log(after / before)[rows], x @ coefficients, atol=1e-12)
    assert np.abs(np.log(after / before)).max() > 0.005
    record, logits = LEAF_PARAMETERS["water"], []
    for of, value in ((fit, before), (corrected, after)):
        three = np.stack([of.lower[:, at], value, of.upper[:, at]])
        logits.append(np.log((three - record.lower) / (record.upper - three)))
    moved = logits[1] - logits[0]
    np.testing.assert_allclose(moved, np.broadcast_to(moved[1], moved.shape), atol=1e-9)
    assert np.all((corrected.lower[:, at] < after) & (after < corrected.upper[:, at]))
    np.testing.assert_allclose(
        corrected.covariance[:, at, at], corrected.standard_deviation[:, at] ** 2, rtol=1e-9
    )
    others = np.arange(len(fit.names)) != at
    np.testing.assert_array_equal(corrected.lower[:, others], fit.lower[:, others])
    np.testing.assert_array_equal(corrected.parameters.dry_matter, fit.parameters.dry_matter)


def test_what_leaves_share_changes_none(fit):
    """A single leaf stays, and leaves of which a tenth of the window is missing."""
    one = fit_leaf(fit.wavelength, fit.reflectance[:1], None)
    np.testing.assert_array_equal(regress_water(one).parameters.water, one.parameters.water)
    gap = fit.measured.copy()
    gap[:, :, (fit.wavelength > 1800) & (fit.wavelength < 2000)] = np.nan
    few = eqx.tree_at(lambda of: of.measured, fit, gap)
    np.testing.assert_array_equal(regress_water(few).parameters.water, fit.parameters.water)
    np.testing.assert_array_equal(regress_water(few).upper, fit.upper)


def test_water_that_was_not_fitted_is_refused(fit):
    """Said with what was fitted."""
    other = fit_leaf(fit.wavelength, fit.reflectance[:1], None, free=("structure", "chlorophyll"))
    with pytest.raises(InputError, match="'structure', 'chlorophyll'"):
        regress_water(other)


@pytest.mark.study
def test_water_of_a_campaign_left_out(shared_data):
    """Californian shrubs and trees, of which nothing was learned: water from R is nearer."""
    (leaves,) = read(shared_data / "leaf", "california_asd")
    case = Case(shared_data / "leaf", "water", False)
    found = process(case, leaves, True)
    truth = leaves.measured("water")
    value = np.asarray(fitted(case, leaves, ("california_asd",)).parameters.water)
    have = np.isfinite(truth)
    before, after = (rms((v - truth)[have]) for v in (value, value * np.exp(found.log)))
    assert 0.0060 < after < 0.95 * before

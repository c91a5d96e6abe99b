"""How well the mean of measured leaves is known, against draws and against measured leaves."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pandas as pd
import pytest

from fynjax._core.errors import InputError
from fynjax.leaf import bin_centres, fit_leaf, prospect, species_prior
from fynjax.leaf._error_model import default_error_model
from fynjax.leaf._species_prior import BETWEEN_PLANTS
from tools.estimate_error_model import read

GRID = np.arange(400.0, 2501.0)
BY_R = ("structure", "chlorophyll", "carotenoids", "anthocyanins")


@pytest.mark.parametrize(
    ("count", "error", "between"),
    [(1, 0.2, 0.27), (3, 0.1, 0.27), (10, 0.15, 0.27), (60, 0.05, 0.6), (60, 0.3, 0.1)],
)
def test_nine_of_ten_species_means_lie_within(count, error, between):
    """Species drawn with an error that their leaves partly share, and with plants that differ."""
    share = default_error_model().species_share[3]
    fit = fit_leaf(GRID, np.tile(np.asarray(prospect().reflectance), (count, 1)))
    at = fit.names.index("water")
    draw, inside, widths = np.random.default_rng(0), [], []
    for _ in range(400):
        shared = np.sqrt(share) * error * draw.normal()
        own = np.sqrt(1.0 - share) * error * draw.normal(size=count)
        found = 0.01 * (1.0 + shared + own + between * draw.normal(size=count))
        found = np.maximum(found, 0.001)
        deviation = fit.prospect_deviation.copy()
        deviation[:, at] = error * found.mean()
        drawn = eqx.tree_at(
            lambda f: (f.parameters.water, f.prospect_deviation),
            fit,
            (jnp.asarray(found), deviation),
        )
        widths.append(species_prior(drawn)["water"])
        inside.append(abs(found.mean() / 0.01 - 1.0) < 1.645 * widths[-1] * found.mean() / 0.01)
    assert 0.84 <= np.mean(inside) <= 0.96
    # No number of leaves tells what they share, and one tells nothing of the others.
    assert np.median(widths) > np.sqrt(share) * error
    if count == 1:
        assert np.allclose(widths, np.hypot(0.2, BETWEEN_PLANTS["water"]))


def test_plants_of_a_species_differ_as_measured(shared_data):
    """The guess is the pooled spread of Californian leaves of one species and leaf age."""
    (leaves,) = (s for s in read(shared_data / "leaf", "california_asd") if s.shape == "broad")
    fit = fit_leaf(bin_centres(), leaves.spectra[:, 0])
    ages = leaves.chemistry["leaf_age"].astype(str).to_numpy()
    group = pd.Series(leaves.species()) + ages
    for name, guess in BETWEEN_PLANTS.items():
        values = getattr(fit.parameters, name) if name in BY_R else leaves.measured(name)
        log = pd.Series(np.where(ages == "Senesced", np.nan, np.log(np.asarray(values))))
        kept = log[log.notna() & (log.groupby(group).transform("count") > 1)]
        of = group[kept.index]
        apart = kept - kept.groupby(of).transform("mean")
        pooled = np.sqrt((apart**2).sum() / (len(kept) - of.nunique()))
        assert pooled == pytest.approx(guess, abs=0.01), name


def test_leaves_that_were_not_fitted_say_nothing():
    fit = fit_leaf(GRID, np.stack([np.asarray(prospect().reflectance), np.full(GRID.size, np.nan)]))
    assert set(species_prior(fit, [True, False])) == set(fit.names)
    for chosen in ([], [1], None):
        with pytest.raises(InputError, match="leaves that were fitted"):
            species_prior(fit, chosen)

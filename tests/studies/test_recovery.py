"""The plot at other ages: the published one at 16 years, and what no recovery could break."""

import numpy as np
import pytest

from fynjax._core.errors import InputError
from fynjax.canopy import table1_2006
from fynjax.studies.fynbos_2006 import ground_after_fire, table_after_fire

NUMBERS = ["mean_diameter_cm", "cover_percent", "height_max_m"]


def test_at_sixteen_years_the_table_is_the_published_one():
    got, want = table_after_fire(16), table1_2006()
    assert list(got.taxon) == list(want.taxon)
    np.testing.assert_allclose(got[NUMBERS], want[NUMBERS], rtol=1e-12)
    assert ground_after_fire(16, 0.5)[0] == pytest.approx(0.5)


def test_everything_grows_and_sprouters_lead():
    young, middle, old = (table_after_fire(age) for age in (3, 6, 16))
    assert np.all(young[NUMBERS] < middle[NUMBERS] + 1e-12)
    assert np.all(middle[NUMBERS] < old[NUMBERS] + 1e-12)
    share = (young.height_max_m / old.height_max_m).groupby(young.after_fire).mean()
    # (1 - exp(-3 / t)) / (1 - exp(-16 / t)) with t of 3 and of 6 years.
    assert share["sprout"] == pytest.approx(0.63212 / 0.99517, rel=1e-4)
    assert share["seed"] == pytest.approx(0.39347 / 0.93052, rel=1e-4)
    assert share["dead"] == 1.0
    char = [ground_after_fire(age, 0.5)[1] for age in (1, 3, 6, 16)]
    assert np.all(np.diff(char) < 0)


@pytest.mark.parametrize("age", [0, 2016, float("nan")])
def test_an_age_that_is_none_is_refused(age):
    with pytest.raises(InputError, match="1 to 40 years"):
        table_after_fire(age)

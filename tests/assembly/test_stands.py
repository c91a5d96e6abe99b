"""Stands have the growth forms that their prior was learned with."""

import numpy as np
import pytest

from fynjax.app.assembly import STAND_QUANTITIES, StandSettings, simulate_stands, stand_forms
from fynjax.app.assembly._stands import _draw, stand_numbers
from fynjax.app.io.plot import LEAFY_FORMS, read_prior, write_prior
from fynjax.canopy import FORMS
from fynjax.sensors import shipped_sensor
from tests.io.test_prior import prior_file


@pytest.fixture
def prior(tmp_path):
    write_prior(tmp_path / "prior.toml", prior_file())
    return read_prior(tmp_path / "prior.toml")


def test_a_stand_has_the_forms_of_its_prior_and_deadwood(prior) -> None:
    assert stand_forms(prior) == (*LEAFY_FORMS, "deadwood")
    assert stand_forms(read_prior("fynbos_2023")) == (
        "broad_leaved",
        "rounded_shrub",
        "tussock",
        "upright_ericoid",
        "deadwood",
    )


def test_drawn_leaves_and_sizes_scatter_about_those_of_their_form(prior) -> None:
    """Medians over stands against the records; water and mass as crews measure them."""
    common, own = stand_numbers(prior)
    rng = np.random.default_rng(5)
    drawn = [
        _draw(prior, StandSettings(), rng.normal(size=common), rng.normal(size=(8, own)))
        for _ in range(60)
    ]
    forms = [FORMS[name] for name in stand_forms(prior)]
    mass = np.median(np.concatenate([one.leaf_mass for one in drawn]), axis=0)
    np.testing.assert_allclose(mass, [form.leaf_mass_per_area for form in forms], rtol=0.12)
    water = np.median(np.concatenate([one.water for one in drawn]), axis=0)
    np.testing.assert_allclose(water, [form.water_content for form in forms], atol=0.04)
    wide = np.median([one.species.diameter for one in drawn], axis=0)
    np.testing.assert_allclose(wide, [form.diameter for form in forms], rtol=0.2)


@pytest.mark.study
def test_a_stand_with_cushions_and_columns_is_lit(prior) -> None:
    bands = shipped_sensor("mavic_3m").bands
    made = simulate_stands((0,), bands, prior, StandSettings(together=2), 1)
    assert np.isfinite(made.reflectance).all()
    assert ((made.reflectance > 0.0) & (made.reflectance < 1.0)).all()
    covers = [list(STAND_QUANTITIES).index(n) for n in ("live_cover", "dead_cover", "bare_cover")]
    assert made.quantities[:, covers].sum(axis=1) == pytest.approx(1.0)

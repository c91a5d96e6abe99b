"""Equations (1)-(10) against numbers worked by hand, and their derivatives."""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from fynjax._core.errors import InputError
from fynjax.canopy import (
    CrownPacking,
    crown_scale,
    hard_count,
    instance_area,
    modelled_diameter,
    projected_area,
    share_from_above,
    soft_count,
    table1_2006,
    target_area,
)
from tests.helpers import assert_gradients

# 100 m2 of plot; discs of 15, 40, 100 and 50 cm; by hand: cover / (pi d^2 / 4).
BY_HAND = {
    "Metalasia muricata": (679.06, 680),  # 12 / 0.0176715
    "Erica irregularis": (159.15, 160),  # 20 / 0.1256637
    "Pterocelastrus tricuspidatus": (6.366, 7),  # 5 / 0.7853982
    "Restio eleocharis": (25.46, 26),  # 5 / 0.1963495
    "Deadwood": (1273.24, 1274),  # 10 / 0.0078540
    "Chironia baccifera": (28.29, 29),  # 0.5 / 0.0176715
}


@pytest.mark.parametrize("taxon", BY_HAND)
def test_counts_of_table_1(taxon: str) -> None:
    row = table1_2006().set_index("taxon").loc[taxon]
    area = instance_area(row.mean_diameter_cm / 100.0, row.height_max_m)
    wanted = target_area(100.0, row.cover_percent / 100.0)
    soft, hard = BY_HAND[taxon]
    assert float(soft_count(wanted, area)) == pytest.approx(soft, abs=0.006)
    assert hard_count(wanted, area) == hard


def test_every_term_of_the_projected_area() -> None:
    # A model 0.4 m x 0.6 m wide and 0.8 m tall, scaled to a crown of 1 m: D = 0.5, s = 2.
    diameter = modelled_diameter(0.4, 0.6)
    scale = crown_scale(1.0, diameter)
    assert diameter == pytest.approx(0.5)
    assert scale == pytest.approx(2.0)
    # sin 30 degrees = 1/2: radius 0.5 + 1.6 / 2 = 1.3; PE 20 %, FF 50 %.
    area = projected_area(scale, diameter, 0.8, 30.0, 0.2, 0.5)
    assert float(area) == pytest.approx(math.pi * 1.3**2 * 0.8 * 0.5)
    assert float(soft_count(target_area(50.0, 0.04), area, branches=3)) == pytest.approx(
        3 * 2.0 / (math.pi * 1.69 * 0.4)
    )


def test_packing_record_and_minimum_area() -> None:
    packing = CrownPacking(packing=0.25, fill=0.8, rotation_spread=90.0)
    assert float(instance_area(0.2, 0.3, packing)) == pytest.approx(math.pi * 0.4**2 * 0.6)
    least = CrownPacking(minimum_object_area=0.5)
    assert float(instance_area(0.2, 0.3, least)) == 0.5
    assert float(instance_area(1.0, 0.3, least)) == pytest.approx(math.pi / 4)


def test_no_cover_no_plants() -> None:
    assert hard_count(0.0, 0.1) == 0
    slope = jax.grad(lambda cover: soft_count(target_area(100.0, cover), 0.1))(0.0)
    assert float(soft_count(0.0, 0.1)) == 0.0
    assert float(slope) == pytest.approx(1000.0)


def test_a_whole_count_is_not_lifted_by_rounding() -> None:
    assert 3 * 0.1 / 0.1 > 3.0  # what the slack is for
    assert hard_count(3 * 0.1, 0.1) == 3
    np.testing.assert_array_equal(hard_count(np.array([0.3, 0.31]), 0.1), [3, 4])


def test_counts_are_differentiable() -> None:
    def count(x: jax.Array) -> jax.Array:
        cover, diameter, height, spread, packing, fill, branches = x
        area = projected_area(1.0, diameter, height, spread, packing, fill)
        return soft_count(target_area(100.0, cover), area, branches)

    assert_gradients(count, jnp.array([0.12, 0.35, 1.3, 8.0, 0.15, 0.85, 2.0]))


@pytest.mark.parametrize(
    ("target", "area", "word"),
    [(1.0, 0.0, "positive"), (1.0, math.nan, "positive"), (-1, 1, "neg")],
)
def test_impossible_areas(target: float, area: float, word: str) -> None:
    with pytest.raises(InputError, match=word):
        hard_count(target, area)


def test_share_of_crowns_seen_from_above() -> None:
    """(1 - exp(-t)) / t with its limit, in one piece where the series takes over."""
    crowns = np.array([1e-9, 9.99e-4, 1.001e-3, 0.3, 2.0, 30.0])
    np.testing.assert_allclose(share_from_above(crowns), -np.expm1(-crowns) / crowns, rtol=1e-13)
    slope = jax.grad(lambda t: share_from_above(t))
    assert float(share_from_above(0.0)) == 1.0
    assert float(slope(0.0)) == -0.5
    assert float(slope(9.99e-4)) == pytest.approx(float(slope(1.001e-3)), abs=1e-6)
    assert_gradients(share_from_above, jnp.array([0.3, 2.0, 10.0]), rtol=1e-7)

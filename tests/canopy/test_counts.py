"""Equations (1)-(10) against numbers worked by hand, and their derivatives."""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from fynjax.canopy import (
    instance_area,
    modelled_diameter,
    projected_count,
    rounded_count,
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
    assert int(rounded_count(soft_count(wanted, area))) == hard


def test_every_term_of_the_projected_area() -> None:
    # A model 0.4 m x 0.6 m wide and 0.8 m tall, scaled to a crown of 1 m: D = 0.5, s = 2.
    diameter = modelled_diameter(0.4, 0.6)
    assert diameter == pytest.approx(0.5)
    # sin 30 degrees = 1/2: radius 0.5 + 1.6 / 2 = 1.3; PE 20 %, FF 50 %.
    area = instance_area(2.0 * diameter, 2.0 * 0.8, 30.0, 0.2, 0.5)
    assert float(area) == pytest.approx(math.pi * 1.3**2 * 0.8 * 0.5)
    assert float(soft_count(target_area(50.0, 0.04), area, branches=3)) == pytest.approx(
        3 * 2.0 / (math.pi * 1.69 * 0.4)
    )


def test_packing_and_minimum_area() -> None:
    area = instance_area(0.2, 0.3, rotation_spread=90.0, packing=0.25, fill=0.8)
    assert float(area) == pytest.approx(math.pi * 0.4**2 * 0.6)
    assert float(instance_area(0.2, 0.3, minimum_area=0.5)) == 0.5
    assert float(instance_area(1.0, 0.3, minimum_area=0.5)) == pytest.approx(math.pi / 4)


def test_no_cover_no_plants() -> None:
    assert float(rounded_count(soft_count(0.0, 0.1))) == 0.0
    slope = jax.grad(lambda cover: soft_count(target_area(100.0, cover), 0.1))(0.0)
    assert float(soft_count(0.0, 0.1)) == 0.0
    assert float(slope) == pytest.approx(1000.0)


def test_a_whole_count_is_not_lifted_by_rounding() -> None:
    assert 3 * 0.1 / 0.1 > 3.0  # what the slack is for
    count = soft_count(np.array([3 * 0.1, 0.3, 0.31]), 0.1)
    np.testing.assert_array_equal(rounded_count(count), [3, 3, 4])


def test_counts_are_differentiable() -> None:
    def count(x: jax.Array) -> jax.Array:
        cover, diameter, height, spread, packing, fill, branches = x
        area = instance_area(diameter, height, spread, packing, fill)
        return soft_count(target_area(100.0, cover), area, branches)

    assert_gradients(count, jnp.array([0.12, 0.35, 1.3, 8.0, 0.15, 0.85, 2.0]))


def covered_by_discs(area, throws, points, rng):
    """Mean and standard error of the share of a periodic unit square under discs at random."""
    places = rng.uniform(size=(throws, 1, len(area), 2))
    apart = np.abs(rng.uniform(size=(throws, points, 1, 2)) - places)
    apart = np.minimum(apart, 1.0 - apart)
    inside = ((apart**2).sum(axis=-1) < area / np.pi).any(axis=-1).mean(axis=1)
    return inside.mean(), inside.std() / np.sqrt(throws)


def test_share_of_crowns_seen_from_above() -> None:
    """A few large crowns against discs thrown on a torus, many small ones against their limit."""
    area = np.array([0.2, 0.35, 0.1, 0.4, 0.05])
    cover, error = covered_by_discs(area, 3000, 60, np.random.default_rng(0))
    assert error < 0.003
    assert float(share_from_above(area)) * area.sum() == pytest.approx(cover, abs=3 * error)
    assert 1 - np.exp(-area.sum()) < cover - 6 * error  # what many small ones would cover
    assert float(share_from_above(np.full(50_000, 4e-5))) == pytest.approx(-np.expm1(-2) / 2, 1e-4)
    assert float(share_from_above(np.array([0.2, 0.0]))) == pytest.approx(1.0, rel=1e-12)


def test_share_of_crowns_has_slopes_up_to_crowns_as_large_as_the_ground() -> None:
    assert float(share_from_above(jnp.zeros(3))) == 1.0
    assert_gradients(share_from_above, jnp.array([0.3, 0.02, 0.7]), rtol=1e-7)
    for edge in ([0.0, 0.0], [1.0, 0.3], [2.5, 0.0]):
        value, slope = jax.value_and_grad(share_from_above)(jnp.array(edge))
        assert float(value) * sum(edge) == pytest.approx(min(sum(edge), 1.0))
        assert np.isfinite(slope).all()


@pytest.mark.parametrize(("spacing", "crown"), [(0.35, 0.12), (0.4, 0.1), (0.3, 0.15)])
def test_numbers_of_a_growing_cover_do_not_jump_where_they_are_whole(spacing, crown):
    """From one whole number to the next is a line in the cover: lines meet at their ends, so that
    a step of the cover is one of the number there as before and after."""
    cover = np.linspace(0.1, 0.75, 6501)
    number = np.asarray(projected_count(cover, crown, 1.0, spacing=spacing), float)
    step = np.diff(number)
    assert (step > 0.0).all()
    at = np.flatnonzero(np.floor(number[1:]) > np.floor(number[:-1]))
    assert len(at) >= 5
    both = np.stack([step[at - 2], step[at + 2]])
    assert (step[at] > 0.9 * both.min(axis=0)).all()
    assert (step[at] < 1.1 * both.max(axis=0)).all()

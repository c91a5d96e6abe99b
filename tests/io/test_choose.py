"""Which frames of a flight are used: against every choice that there is."""

from itertools import combinations

import numpy as np
import pytest

from fynjax.app.io.frames import choose_frames, direction_features


def spread(places, features):
    """Least distance of two of some frames [degrees]."""
    return min(np.linalg.norm(features[i] - features[j]) for i, j in combinations(places, 2))


def test_views_are_points_whose_distance_is_their_angle():
    found = direction_features(np.array([30.0, 10.0]), np.array([0.0, 90.0]), [None, (40.0, 270.0)])
    np.testing.assert_allclose(found[0], [0.0, 30.0, 0.0, 0.0], atol=1e-9)
    np.testing.assert_allclose(found[1], [10.0, 0.0, -40.0, 0.0], atol=1e-9)


@pytest.mark.parametrize("seed", range(5))
def test_what_is_chosen_lies_apart_as_hardly_another_choice(seed):
    random = np.random.default_rng(seed)
    features = direction_features(
        35.0 * np.sqrt(random.uniform(size=9)), random.uniform(0, 360, 9), [None] * 9
    )
    chosen = choose_frames(features, np.ones(9), 4)
    every = sorted(spread(c, features) for c in combinations(range(9), 4))
    assert len(chosen) == 4
    assert np.searchsorted(every, spread(chosen, features) + 1e-9) > 0.9 * len(every)


def test_a_frame_that_sees_little_gives_way_to_its_neighbour():
    features = direction_features(
        np.array([0.0, 30.0, 30.0]), np.array([0.0, 100.0, 101.0]), [None] * 3
    )
    assert choose_frames(features, np.array([1.0, 0.1, 0.9]), 2) == [0, 2]
    assert choose_frames(features, np.array([1.0, 0.9, 0.1]), 2) == [0, 1]
    assert choose_frames(features, np.array([1.0, 0.0, 0.0]), 2) == [0]

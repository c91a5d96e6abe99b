"""Blue noise against the printed steps; sharing of sites; soft weights and their hard limit."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial import cKDTree

from fynjax._core.errors import InputError
from fynjax.canopy import assign_sites, clumping, poisson_disk, site_weight
from fynjax.canopy._sites import SITES
from tests.helpers import assert_gradients
from tests.reference.bridson import bridson

SIDE, RADIUS, SEEDS = 6.0, 0.2, 5


def nearest(points: np.ndarray, box: float | np.ndarray | None = None) -> np.ndarray:
    return cKDTree(points, boxsize=box).query(points, k=2)[0][:, 1]


@pytest.mark.parametrize("periodic", [False, True])
@pytest.mark.parametrize("extent", [(5.0, 3.0), (1.0, 1.0), (0.9, 7.3)])
def test_the_least_distance_is_exact(extent: tuple[float, float], periodic: bool) -> None:
    points = poisson_disk(extent, 0.1, seed=3, periodic=periodic)
    assert points.dtype == np.float64
    assert points.min() >= 0.0
    assert np.all(points < np.array(extent))
    box = np.array(extent) if periodic else None
    assert cKDTree(points, boxsize=box).query(points, k=2)[0][:, 1].min() >= 0.1


def test_the_plot_is_full() -> None:
    """Few gaps are left: no place much farther than r from a point (a maximal packing has r)."""
    points = poisson_disk((5.0, 5.0), 0.1, seed=0, periodic=True)
    probe = np.random.default_rng(0).uniform(0, 5.0, (20000, 2))
    distance = cKDTree(points, boxsize=5.0).query(probe)[0]
    assert distance.max() < 0.2
    assert np.mean(distance > 0.1) < 0.01


def test_seed_and_attempts() -> None:
    first = poisson_disk((2.0, 2.0), 0.1, seed=1)
    np.testing.assert_array_equal(first, poisson_disk((2.0, 2.0), 0.1, seed=1))
    assert not np.array_equal(first, poisson_disk((2.0, 2.0), 0.1, seed=2))
    counts = [len(poisson_disk((5.0, 5.0), 0.1, seed=1, attempts=k)) for k in (2, 10, 60)]
    assert counts == sorted(counts)
    assert counts[0] < 0.9 * counts[2]


def radial_spectrum(points: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """Periodogram of the points at the plot's own frequencies, averaged in rings."""
    order = np.arange(-30, 31)
    wave_x, wave_y = np.meshgrid(order, order)
    vectors = np.stack([wave_x.ravel(), wave_y.ravel()], -1) / SIDE
    size = np.hypot(*vectors.T) * RADIUS
    power = np.abs(np.exp(-2j * np.pi * vectors @ points.T).sum(1)) ** 2 / len(points)
    ring = np.digitize(size, edges) - 1
    inside = (ring >= 0) & (ring < len(edges) - 1) & (size > 0)
    total = np.bincount(ring[inside], power[inside], len(edges) - 1)
    return total / np.bincount(ring[inside], minlength=len(edges) - 1)


def test_blue_noise_like_the_printed_steps() -> None:
    edges = np.linspace(0.05, 0.95, 10)
    own, peer = [], []
    for seed in range(SEEDS):
        own.append(radial_spectrum(poisson_disk((SIDE, SIDE), RADIUS, seed=seed), edges))
        peer.append(radial_spectrum(bridson(SIDE, RADIUS, 30, seed, False), edges))
    ours, theirs = np.mean(own, 0), np.mean(peer, 0)
    # A ring of m independent frequencies has a relative scatter of 1 / sqrt(m seeds) (times
    # sqrt 2 for the difference): 40 frequencies at least beyond the first ring.
    np.testing.assert_allclose(ours[1:], theirs[1:], rtol=3 * np.sqrt(2 / (40 * SEEDS)), atol=0.02)
    assert ours[:3].max() < 0.2  # no large clumps; white noise has 1
    assert ours.max() > 1.2  # the ring at 1 / r


@pytest.mark.parametrize("periodic", [False, True])
@pytest.mark.parametrize("attempts", [5, 30])
def test_as_many_points_as_the_printed_steps(attempts: int, periodic: bool) -> None:
    """To one per cent; numbers of 3400 scatter by 0.2 % between seeds."""
    own = [
        poisson_disk((3.0, 3.0), 0.04, attempts=attempts, seed=seed, periodic=periodic)
        for seed in range(6)
    ]
    printed = [bridson(3.0, 0.04, attempts, seed, periodic) for seed in range(6)]
    assert np.mean([*map(len, own)]) == pytest.approx(np.mean([*map(len, printed)]), rel=0.01)
    # And as evenly: how far the nearest is.
    box = 3.0 if periodic else None
    near = [np.mean([nearest(points, box).mean() for points in sets]) for sets in (own, printed)]
    assert near[0] == pytest.approx(near[1], rel=0.005)


def test_points_between_those_that_are_there() -> None:
    start = poisson_disk((4.0, 3.0), 0.2, seed=1, periodic=True)
    points = poisson_disk((4.0, 3.0), 0.1, seed=2, periodic=True, start=start)
    np.testing.assert_array_equal(points[: len(start)], start)
    assert nearest(points, np.array([4.0, 3.0])).min() >= 0.1
    assert len(points) > 0.98 * SITES * 12.0 / 0.01  # as full as without them
    with pytest.raises(InputError, match=r"at least 0\.3 m apart"):
        poisson_disk((4.0, 3.0), 0.3, seed=0, periodic=True, start=start)


@pytest.mark.parametrize(
    ("extent", "radius", "options", "word"),
    [
        ((0.0, 1.0), 0.1, {}, "positive"),
        ((1.0, 1.0), float("nan"), {}, "positive"),
        ((1.0, 1.0), 0.1, {"attempts": 0}, "attempts"),
        ((1.0, 1.0), 0.6, {"periodic": True}, "own image"),
        ((1e4, 1e4), 0.1, {}, "metres"),
    ],
)
def test_bad_discs(extent: tuple[float, float], radius: float, options: dict, word: str) -> None:
    with pytest.raises(InputError, match=word):
        poisson_disk(extent, radius, seed=0, **options)


POINTS = poisson_disk((10.0, 10.0), 0.1, seed=7)


def as_set(sites: np.ndarray) -> set[tuple[float, float]]:
    return {tuple(site) for site in sites.tolist()}


def test_sites_are_disjoint_and_drawn_from_the_points() -> None:
    sites = assign_sites(POINTS, [500, 0, 1500, 300], seed=1)
    assert [len(s) for s in sites] == [500, 0, 1500, 300]
    together = as_set(np.concatenate(sites))
    assert len(together) == 2300
    assert together <= as_set(POINTS)


def test_sites_of_a_species_are_spread_evenly() -> None:
    (sites,) = assign_sites(POINTS, [1000], seed=2)
    quadrant, *_ = np.histogram2d(*sites.T, bins=2, range=[[0, 10], [0, 10]])
    # Binomial scatter 14 of 250; the blue noise only makes it smaller.
    assert np.all(np.abs(quadrant - 250) < 4 * 14)


def test_a_longer_list_begins_the_same_and_hardly_moves_the_others() -> None:
    grey = np.full((4, 4), 100, np.uint8)
    short = assign_sites(POINTS, [400, 500, 600], seed=3, probability=grey, extent=(10, 10))
    longer = assign_sites(POINTS, [440, 500, 600], seed=3, probability=grey, extent=(10, 10))
    np.testing.assert_array_equal(longer[0][:400], short[0])
    for before, after in zip(short[1:], longer[1:], strict=True):
        # Only sites that the 40 new plants took: about 40 * 500 / 6000 of them.
        assert len(as_set(before) - as_set(after)) < 20


def test_the_map_sets_the_pattern_and_not_the_abundance() -> None:
    grey = np.array([[255, 85], [0, 85]], np.uint8)  # row 0 is the south
    (sites,) = assign_sites(POINTS, [600], seed=5, probability=grey, extent=(10.0, 10.0))
    assert len(sites) == 600
    east, north = sites.T
    assert not np.any((east < 5) & (north > 5))
    strong = np.mean((east < 5) & (north < 5))
    # 255 : 85 : 85 among equal areas: 3/5 of few plants; a little less as the best places go.
    assert 0.5 < strong < 0.64


def test_a_target_out_of_reach_is_said_with_numbers() -> None:
    few = POINTS[:50]
    with pytest.raises(InputError, match=r"species 1 .*30.* 20"):
        assign_sites(few, [30, 30], seed=0)
    with pytest.raises(InputError, match=r"1 sites.* 0"):
        assign_sites(few, [1], seed=0, probability=np.zeros((3, 3)), extent=(10, 10))


@pytest.mark.parametrize(
    ("grey", "extent", "word"),
    [
        (np.full((2, 2), 300.0), (10, 10), "0-255"),
        (np.full((2, 2), np.nan), (10, 10), "NaN"),
        (np.full((2, 2), 0.5), (10, 10), "fractions"),
        (np.full((2, 2), 9), None, "extent"),
        (np.full((2, 2), 9), (5, 5), "outside"),
        (np.full((3, 2, 2), 9), (10, 10), "axes"),
    ],
)
def test_bad_maps(grey: np.ndarray, extent: tuple[float, float] | None, word: str) -> None:
    with pytest.raises(InputError, match=word):
        assign_sites(POINTS, [5], seed=0, probability=grey, extent=extent)


def test_no_plant_stands_where_a_map_is_zero_all_over() -> None:
    for empty in (0.0, np.nan):
        with pytest.raises(InputError, match="above 0 somewhere"):
            clumping(np.full((4, 4), empty), (2.0, 2.0), 0.4, periodic=True)


COUNTS = np.concatenate([[0.0], np.geomspace(0.05, 10_000, 300), np.arange(1.0, 30.0)])
"""Numbers of plants, those among them that are whole, where weights without a ramp have kinks."""


@pytest.mark.parametrize("softness", [0.0, 0.02, 1.0, 3.0])
@pytest.mark.parametrize("width", [0.5, 5.0])
def test_the_sum_of_weights_is_the_count_with_slope_one(width: float, softness: float) -> None:
    weights = jax.jit(lambda n: site_weight(n, np.arange(21_000), width=width, softness=softness))
    total, slope = jax.lax.map(jax.value_and_grad(lambda n: weights(n).sum()), jnp.asarray(COUNTS))
    np.testing.assert_allclose(total, COUNTS, rtol=1e-9)
    np.testing.assert_allclose(slope, 1.0, atol=1e-9)
    for count in COUNTS[::37]:
        weight = np.asarray(weights(count))
        assert weight.min() >= 0.0
        assert weight.max() <= 1.0
        assert np.all(np.diff(weight) <= 1e-12)


def test_the_sum_holds_in_single_precision() -> None:
    weights = lambda n: site_weight(n, np.arange(12_000), softness=0.25)  # noqa: E731
    counts = jnp.asarray(COUNTS[1:], jnp.float32)
    total, slope = jax.lax.map(jax.value_and_grad(lambda n: weights(n).sum()), counts)
    assert total.dtype == jnp.float32
    np.testing.assert_allclose(total, counts, rtol=1e-6)
    np.testing.assert_allclose(slope, 1.0, atol=1e-4)


def test_a_weight_is_the_mean_of_the_ramp_over_its_unit() -> None:
    """Against a quadrature: 1 up to N - S/2, 0 from N + S/2 on, a straight line between."""
    count, softness = 7.3, 0.6
    ramp = softness * count
    places = (np.arange(200_000) + 0.5) / 10_000
    line = np.clip((count - places) / ramp + 0.5, 0.0, 1.0)
    expected = line.reshape(20, -1).mean(axis=1)
    np.testing.assert_allclose(
        site_weight(count, np.arange(20), softness=softness), expected, atol=1e-7
    )


@pytest.mark.parametrize("width", [1.0, 2.0, 5.0])
def test_slopes_of_single_weights_are_continuous(width: float) -> None:
    """No jump of a weight's slope by the count, whichever limit holds the ramp."""
    slope = jax.vmap(
        jax.jacfwd(lambda n: site_weight(n, np.arange(12), width=width, softness=0.25))
    )
    counts = np.linspace(0.1, 8.0, 4001)
    change = np.abs(np.diff(slope(counts), axis=0)).max()
    twice = np.abs(np.diff(slope(counts[::2]), axis=0)).max()
    assert change < 0.7 * twice  # half as far apart, half the change


@pytest.mark.parametrize("count", [0.0, 0.4, 3.0, 3.2, 7.99])
def test_without_width_plants_are_whole(count: float) -> None:
    hard = np.arange(12) < np.ceil(count)
    np.testing.assert_array_equal(site_weight(count, np.arange(12), width=0.0), hard)


def test_without_a_ramp_the_last_plant_is_the_fraction() -> None:
    np.testing.assert_allclose(site_weight(2.3, np.arange(4)), [1.0, 1.0, 0.3, 0.0], atol=1e-12)


def test_no_plants_have_no_weight_and_a_finite_slope() -> None:
    width = jnp.array([1.0, 0.25, 4.0, 1.0, 0.0])
    softness = jnp.array([0.0, 0.0, 0.0, 0.5, 0.0])

    def soft(x: tuple[jax.Array, ...]) -> jax.Array:
        count, w, s = (part[:, None] for part in x)
        return site_weight(count, np.arange(4), width=w, softness=s)

    none = jnp.zeros(5)
    np.testing.assert_array_equal(soft((none, width, softness)), np.zeros((5, 4)))
    for slopes in (jax.jacfwd, jax.jacrev):
        by_input = jax.jit(slopes(soft))((none, width, softness))
        assert all(np.all(np.isfinite(slope)) for slope in by_input)
    assert float(jax.grad(lambda n: site_weight(n, np.arange(5)).sum())(0.0)) == 1.0


def test_weights_are_differentiable() -> None:
    assert_gradients(
        jax.jit(lambda x: site_weight(x[0], np.arange(30), width=x[1], softness=x[2])),
        jnp.array([11.3, 1.7, 0.21]),
    )


def test_weights_keep_single_precision_and_broadcast() -> None:
    count = jnp.asarray([3.5, 0.2], jnp.float32)
    weight = site_weight(count[:, None], np.arange(5), softness=0.1)
    assert weight.dtype == jnp.float32
    np.testing.assert_array_equal(weight[0], site_weight(count[0], np.arange(5), softness=0.1))


@pytest.mark.study
def test_radial_spectrum_of_a_whole_plot_is_that_of_the_oracle() -> None:
    """10 m x 10 m at 10 cm, as a scene has it: packing and every ring from 0.1 to 2.5 / r.

    At the plot's own frequencies a ring of m has a relative scatter of 1 / sqrt(m); half of the
    plane is independent. Both sides scatter, over six seeds each. All active points that draw in
    turn put 4 % more power on the steep flank below 1 / r, by 12 seeds, and 3 % less beneath it.
    """
    side, radius, seeds = 10.0, 0.1, 6
    order = np.arange(-250, 251)
    wave = np.stack(np.meshgrid(order[250:], order, indexing="ij"), -1).reshape(-1, 2)
    size = np.hypot(*wave.T) * radius / side
    edges = np.linspace(0.1, 2.5, 17)
    ring = np.digitize(size, edges) - 1
    own, peer, counts = [], [], []
    for seed in range(seeds):
        pair = poisson_disk((side, side), radius, seed=seed), bridson(side, radius, 30, seed, False)
        assert nearest(pair[0]).min() >= radius
        counts.append([len(points) * radius**2 / side**2 for points in pair])
        for points, rings in zip(pair, (own, peer)):
            # The sum over points is a product of waves along x and along y.
            east = np.exp(-2j * np.pi / side * np.outer(order[250:], points[:, 0]))
            north = np.exp(-2j * np.pi / side * np.outer(order, points[:, 1]))
            power = np.abs(east @ north.T).ravel() ** 2 / len(points)
            inside = (ring >= 0) & (ring < 16)
            total = np.bincount(ring[inside], power[inside], 16)
            rings.append(total / np.bincount(ring[inside], minlength=16))
    packing = np.mean(counts, axis=0)
    # One plot's packing scatters by 0.3 %.
    assert packing[0] == pytest.approx(packing[1], rel=0.01)
    ours, theirs = np.mean(own, axis=0), np.mean(peer, axis=0)
    scatter = np.sqrt(2.0 / (seeds * np.bincount(ring[(ring >= 0) & (ring < 16)], minlength=16)))
    assert np.all(np.abs(ours / theirs - 1.0) < 0.04 + 3.0 * scatter), ours / theirs

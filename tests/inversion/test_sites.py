"""Sites for plants: more are made where a search asks for them, and who stands stays."""

import dataclasses

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

from fynjax.app.assembly import build_plot, plot_problem
from fynjax.app.io.plot import read_plot
from fynjax.canopy import expected_count, site_weight
from fynjax.inversion import (
    CalibrationSettings,
    Data,
    FitStatus,
    _problem,
    _search,
    coarser,
    free_space,
    search_starts,
)
from fynjax.inversion._views import AbstractView, BandView, multiplied
from fynjax.scene import Scene, element_count, room_needed
from fynjax.sensors import BandSet, Gains
from tests.problems import calibrate_plot, search_of
from tests.scene.plots import small_parameters, small_plot
from tests.small import write_plot


def planted(room):
    return small_plot(room=room, extent=(3.0, 3.0), dtype="float32"), small_parameters()


class CrownCover(AbstractView):
    """Crown area over that of the plot: all that the sites decide, without any light."""

    names: tuple[str, ...] = eqx.field(static=True, default=("crown cover",))

    def observe(self, scene, parameters):
        return None, jnp.sum(scene.crown_areas(parameters))[None] / 9.0

    def for_search(self, scene, accuracy, stride):
        return self


class CrownSquares(BandView):
    """An image of one pixel: the squares of the crowns' areas, which plants that fade change."""

    names: tuple[str, ...] = eqx.field(static=True, default=("crown cover",))
    gains: Gains = eqx.field(static=True, default=Gains(0.0))

    @property
    def bands(self):
        return BandSet(("a",), (550.0,), (10.0,))

    def statistics(self, image, log_factor=None):
        return multiplied(image, log_factor)[:, 0, 0]

    def for_search(self, scene, accuracy, stride):
        return self

    def observe(self, scene, parameters):
        value = jnp.sum(scene.crown_areas(parameters) ** 2)
        return value[None, None, None], value[None]


@pytest.fixture(scope="module")
def plot():
    return planted(2.5)


@pytest.fixture
def as_planted(monkeypatch):
    """Problems hold no more sites ready than the scene does, whatever the prior makes likely."""
    monkeypatch.setattr(_problem, "_LIKELY", 0.0)


@pytest.fixture
def asked(monkeypatch):
    """Realisations that were asked for: their numbers and counts."""
    realise, calls = Scene.realisation, []

    def counted(scene, number, counts=None):
        calls.append((number, counts))
        return realise(scene, number, counts)

    monkeypatch.setattr(Scene, "realisation", counted)
    return calls


def test_a_scene_with_more_room_has_the_same_plants_and_others(plot):
    few, many = plot[0].planting, planted(5.0)[0].planting
    for kind in (0, 1):
        mine, theirs = (np.flatnonzero(np.asarray(p.species) == kind) for p in (few, many))
        assert len(theirs) > 1.9 * len(mine)
        for name in ("place", "foot", "azimuth", "tilt", "size", "stature", "count"):
            np.testing.assert_array_equal(
                getattr(few, name)[mine], getattr(many, name)[theirs][: len(mine)], err_msg=name
            )
    feet = np.asarray(many.foot, float)
    assert len(np.unique(feet, axis=0)) == len(feet)  # nobody stands on another
    only = planted(np.array([2.5, 5.0, 2.5]))[0].planting
    grown, before = (np.bincount(np.asarray(p.species)) for p in (only, few))
    assert grown[1] > 1.9 * before[1]
    np.testing.assert_array_equal(grown[[0, 2]], before[[0, 2]])
    # Steps of which each keeps the one before: whoever asks for more finds the same plants.
    more = planted(7.0)[0].planting
    np.testing.assert_array_equal(
        np.asarray(more.foot)[np.asarray(more.species) == 0][:20],
        np.asarray(many.foot)[np.asarray(many.species) == 0][:20],
    )


def test_the_room_that_counts_need(plot):
    scene, parameters = plot
    stated = np.asarray(scene.counts(parameters))
    assert not room_needed(scene, parameters, stated).any()
    draws = np.stack([stated, stated * np.array([1.0, 6.0, 1.0])])
    needed = room_needed(scene, parameters, draws)
    assert needed[1] > 6.0
    assert not needed[[0, 2]].any()


def test_room_is_needed_where_a_stand_in_expectation_would_lack_sites(plot):
    """It has up to half a plant more, and one more is spread over sites beyond the number."""
    scene, parameters = plot
    stated = np.asarray(scene.counts(parameters))
    place = np.asarray(scene.planting.place)[np.asarray(scene.planting.species) == 1]
    needed, missing = [], []
    for count in len(place) * np.array([0.7, 0.85, 0.97, 0.99]):
        counts = np.where([False, True, False], count, stated)
        needed.append(room_needed(scene, parameters, counts)[1])
        some = float(expected_count(count, 0.0))
        weight = site_weight(
            some, place, width=scene.rules.softness_plants, softness=scene.rules.softness
        )
        missing.append(1.0 - float(np.sum(weight)) / some)
    short = np.array(needed) > 0
    assert short.tolist() == [False, False, True, True]
    assert np.all((np.array(missing) > 1e-3) == short)


def test_a_search_gets_the_sites_that_it_asks_for(plot, asked, as_planted):
    """Data of four times the table's crowns, where there are sites for 2.5 times as many."""
    scene, parameters = plot
    space = free_space(scene, parameters, ["*.cover"], lambda _: 1.0)
    start = np.asarray(CrownCover().observe(scene, parameters)[1])
    data = Data(("crown cover",), jnp.asarray(4.0 * start), jnp.array([0.01]))
    settings = CalibrationSettings(stand_realisations=0, rounds=1)
    found = calibrate_plot(scene, parameters, data, space, [CrownCover()], settings)
    assert {number for number, _ in asked} == {0}  # no other plantings were asked for
    np.testing.assert_allclose(found.statistics_after, data.value, rtol=0.06)
    assert len(found.scene.planting.species) > len(scene.planting.species)
    fixed = dataclasses.replace(scene, planted=None)
    without = calibrate_plot(fixed, parameters, data, space, [CrownCover()], settings)
    assert float(without.statistics_after[0]) < 0.85 * float(data.value[0])


def test_a_table_of_parameters_gets_its_sites_and_growth_counts_from_the_species_table(tmp_path):
    """Covers of twice the table's, then four times the plants of these."""
    path = write_plot(tmp_path, '[scene]\nparameters = "p.csv"\n')
    rows = ["Erica irregularis.cover,%,60", "Restio eleocharis.cover,%,30"]
    (tmp_path / "p.csv").write_text(
        "\n".join(["name,unit,estimate", *(f"species.{row}" for row in rows)])
    )
    plot = read_plot(path)
    scene, parameters = build_plot(plot)
    counts = 2.0 * np.asarray(scene.counts(parameters))
    grown = scene.realisation(0, counts)
    sites = np.bincount(np.asarray(grown.planting.species))
    assert (sites >= 1.1 * counts).all()
    assert (sites > np.bincount(np.asarray(scene.planting.species))).all()


def test_a_prior_finds_sites_for_what_it_makes_likely(tmp_path):
    """Diameters that may be half: four times as many plants."""
    plot = read_plot(write_plot(tmp_path))
    wide = plot.calibration.replace(free=("*.diameter",), priors={"*": 0.5})
    ready = plot_problem(plot.replace(calibration=wide), None, seed=0)
    narrow = plot.calibration.replace(free=("*.leaf_area_index",))
    usual = plot_problem(plot.replace(calibration=narrow), None, seed=0)
    assert len(ready.scene.planting.species) > 1.5 * len(usual.scene.planting.species)


def test_a_search_has_an_element_for_every_two_of_its_own_thick_boxes():
    """As much area as the whole scene. A plant of 1 m in cubes of 10 cm touches 10.5 layers, in
    boxes of 20 cm 5.5."""
    parameters = small_parameters()
    scene = small_plot(extent=(3.0, 3.0), structure=0.025, dtype="float32")
    quick = coarser(scene, parameters)
    assert quick.grid.vertical_size == pytest.approx(2.0 * scene.grid.vertical_size)
    areas = [
        float(np.asarray(s.area_density(parameters)).sum()) * s.grid.voxel_volume
        for s in (scene, quick)
    ]
    assert areas[1] == pytest.approx(areas[0], rel=1e-3)
    most = [element_count(d, 1.0, 0.1, layer=layer) for d in (0.5, 1.0) for layer in (0.1, 0.2)]
    # (d / 0.1 + 0.5)^2 boxes across, in 10.5 and 5.5 layers, half of them.
    assert most == [159, 84, 579, 304]
    counts, owner = np.asarray(quick.planting.count), np.asarray(quick.planting.species)
    for i, (d, h) in enumerate(
        zip(np.asarray(parameters.species.diameter), np.asarray(parameters.species.height))
    ):
        assert counts[owner == i].max() <= element_count(d, h, 0.1, layer=0.2)


def test_a_round_follows_where_plants_got_more_sites(plot, asked, monkeypatch):
    """However little it moved; with slopes of the plants that there are now, and sites for a half
    more than asked for."""
    monkeypatch.setattr(_search, "_SETTLED", np.inf)
    scene, parameters = plot
    space = free_space(scene, parameters, ["*.cover"], lambda _: 1.0)
    start = np.asarray(CrownCover().observe(scene, parameters)[1])
    data = Data(("crown cover",), jnp.asarray(4.0 * start), jnp.array([0.01]))
    settings = CalibrationSettings(stand_realisations=0, rounds=1)
    search = search_of(scene, parameters, data, space, [CrownCover()], settings)
    (u,) = search_starts(search)
    state = search.begin(u)
    assert not np.asarray(state.wanted).any()
    while int(state.turn) == 0:
        state = search.step(state)
    wanted = np.asarray(state.wanted)
    counts = np.asarray(scene.counts(search.plot(state.u)))
    assert wanted.max() == pytest.approx(1.5 * counts[wanted.argmax()], rel=1e-5)
    assert not state.ended
    assert int(state.turns) == 2
    slopes = search.expected(state).slopes(state.u, np.zeros((len(u), len(u))))
    np.testing.assert_allclose(state.place.slopes, slopes, rtol=1e-9)
    worse = dataclasses.replace(state.place, statistics=100.0 * state.place.statistics)
    for fresh in (True, False):  # nothing before compares with it
        kept, _ = search._better(state, worse, FitStatus.successful, fresh=fresh)
        assert (kept is worse) == fresh
    seen = len(asked)
    search.begin(u, state)  # another start has the same sites, without asking
    assert len(asked) == seen


def squares_search(plot, settings, times=1.0, sd=0.05):
    """A search for `times` the squares of the crowns that the plot has."""
    scene, parameters = plot
    space = free_space(scene, parameters, ["*.cover", "*.diameter"], lambda _: 0.2)
    value = times * np.asarray(CrownSquares().observe(scene, parameters)[1])
    data = Data(("crown cover",), jnp.asarray(value), jnp.asarray(sd * value))
    return search_of(scene, parameters, data, space, [CrownSquares()], settings)


def test_without_an_expectation_a_search_starts_at_the_scene_as_it_stands(plot):
    search = squares_search(plot, CalibrationSettings(stand_realisations=0))
    state = search.begin(jnp.zeros(len(search.space.plot.names)))
    np.testing.assert_allclose(state.origin.statistics, state.origin.whole[0], rtol=1e-6)


def test_a_last_round_that_has_settled_keeps_errors_and_renders_the_estimate(plot):
    """The image is that of the estimate, statistics are the coarse form's there with the offset of
    where the round began, and spread is the posterior's. Made anew all are about the same."""
    settings = CalibrationSettings(stand_realisations=2, scatter_draws=6, tolerance=1e-4)
    search = squares_search(plot, settings, times=1.3)
    state = search.begin(jnp.zeros(len(search.space.plot.names)))
    while not state.ended:
        before, state = state.place, search.step(state)
    found, expected = state.best, search.expected(state)
    assert np.abs(np.asarray(found.u - before.u)).max() > 1e-6
    np.testing.assert_array_equal(found.covariance, before.covariance)
    image, _ = CrownSquares().observe(search.scene(state), search.plot(found.u))
    np.testing.assert_allclose(found.images[0], image, rtol=1e-5)
    reached = expected.members(found.u, np.asarray(found.spread)) + found.offset
    np.testing.assert_allclose(found.statistics, reached, rtol=1e-9)
    assert np.diagonal(found.spread).min() < 0.9
    again = search._observe(
        expected, np.asarray(state.wanted), found.u, np.asarray(found.spread),
        np.asarray(found.slopes),
    )  # fmt: skip
    sd = np.sqrt(np.diagonal(found.covariance))
    np.testing.assert_array_less(np.abs(again.statistics - found.statistics), 0.5 * sd)
    np.testing.assert_allclose(np.sqrt(np.diagonal(again.covariance)), sd, rtol=0.3)
    # A first round has expectations over the prior: its end has others.
    first = squares_search(plot, dataclasses.replace(settings, rounds=1), times=1.1)
    state = first.begin(jnp.zeros(len(first.space.plot.names)))
    while not state.ended:
        state = first.step(state)
    assert np.diagonal(state.best.spread).min() < 0.9


def test_sites_are_made_for_all_draws_of_the_prior_at_the_start(plot, asked, as_planted):
    scene, parameters = plot
    space = free_space(scene, parameters, ["*.cover"], lambda _: 1.0)
    start = np.asarray(CrownCover().observe(scene, parameters)[1])
    data = Data(("crown cover",), jnp.asarray(start), jnp.array([0.01]))
    settings = CalibrationSettings(stand_realisations=2, scatter_draws=6)
    search = search_of(scene, parameters, data, space, [CrownCover()], settings)
    state = search.begin(jnp.zeros(len(space.names)))
    expected = search.expected(state)
    drawn = [scene.counts(search.plot(jnp.asarray(expected.draw(i)[1]))) for i in range(6)]
    most = np.max(drawn, axis=0)
    assert room_needed(scene, parameters, most).any()  # those of the table do not suffice
    np.testing.assert_array_less(most * (1 - 1e-6), np.asarray(state.wanted))
    grown = state.wanted
    assert not room_needed(search.scene(state), parameters, np.asarray(most)).any()
    assert len(asked) == 2  # the scene's own plants and one other planting
    np.testing.assert_array_equal(search.step(state).wanted, grown)

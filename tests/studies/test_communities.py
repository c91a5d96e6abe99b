"""Communities along gradients, and their scores: against known correlations and classes."""

import numpy as np
import pytest

import fynjax as fx
from fynjax.diversity import pielou_evenness
from fynjax.errors import InputError
from fynjax.io.plot import example_folder, read_plot
from fynjax.studies.communities import Gradients, diversity, draw_community
from fynjax.studies.communities._draw import shares_of
from fynjax.studies.communities._observe import Design, _coarser, _sample
from fynjax.studies.communities._scores import _lost_from, agreement, recognition

POOL = read_plot(example_folder() / "plot.toml")
CAMERA = fx.sensor("mavic_3m")


@pytest.mark.parametrize("count", [2, 5, 12])
@pytest.mark.parametrize("evenness", [0.4, 0.8, 1.0])
def test_shares_have_the_evenness(count, evenness):
    shares = shares_of(evenness, count)
    assert shares.sum() == pytest.approx(1.0)
    assert float(pielou_evenness(shares)) == pytest.approx(evenness, abs=1e-9)
    np.testing.assert_allclose(shares[1:] / shares[:-1], shares[1] / shares[0])


def test_a_community_lies_within_its_gradients():
    within = Gradients(richness=(3, 5), evenness=(0.6, 0.8), cover=(0.4, 0.5), age=(3.0, 4.0))
    random = np.random.default_rng(1)
    numbers = set()
    for _ in range(20):
        plot = draw_community(POOL, within, random)
        cover = plot.cover[plot.cover > 0.0]
        numbers.add(len(cover))
        assert 0.4 <= cover.sum() <= 0.5
        assert 0.6 - 1e-9 <= float(pielou_evenness(cover)) <= 0.8 + 1e-9
        grown = np.array(plot.diameter_m) / np.array(POOL.diameter_m)
        assert (grown[plot.cover > 0.0] < 0.9).all()  # a stand of 3 years, not of 16
        assert (grown[plot.cover == 0.0] == 1.0).all()
        assert all(
            form.growth_form != "deadwood"
            for form, has in zip(plot.species, plot.cover, strict=True)
            if has
        )
    assert numbers == {3, 4, 5}


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"richness": (3, 2)}, "expected `richness` as two numbers in order"),
        ({"evenness": (0.5, 1.5)}, "from 0.01 to 1, but got 0.5, 1.5"),
        ({"cover": (0.5,)}, "expected `cover` as two numbers"),
        ({"age": (0.0, 3.0)}, "from 1 to 40"),
    ],
)
def test_gradients_that_are_none_are_refused(settings, message):
    with pytest.raises(InputError, match=message):
        Gradients(**settings)


def test_coarser_pixels_are_means_and_blurred_ones_keep_them():
    image = np.random.default_rng(0).random((2, 8, 8))
    plain = _coarser(image, None, 4.0)
    np.testing.assert_allclose(plain[1, 0, 1], image[1, :4, 4:].mean())
    psf = fx.sensor("mavic_3m").psf
    blurred = _coarser(image, psf, 2.0)
    np.testing.assert_allclose(blurred.mean(axis=(1, 2)), image.mean(axis=(1, 2)), rtol=1e-6)
    assert blurred.std() < _coarser(image, None, 2.0).std()


def test_pixels_of_a_species_are_mostly_of_it():
    shares = np.array([[[0.6, 0.2, 0.1]], [[0.3, 0.3, 0.9]]])
    kinds, places = _sample(shares, 2, np.random.default_rng(0))
    assert kinds.tolist() == [0, -1, 1, -1]
    assert places[[0, 2]].tolist() == [0, 2]


def test_the_pixel_of_loss_is_where_the_signal_stays_below_the_threshold():
    pixels = np.array([0.1, 1.0, 10.0])
    r2 = np.array([[0.5, 0.3, 0.1], [0.1, 0.3, np.nan], [0.1, 0.1, 0.1], [0.0, 0.0, 0.9]])
    assert _lost_from(r2, pixels, 0.25).tolist() == [10.0, 10.0, 0.1, np.inf]


def _design(pixels=(0.1, 1.0)):
    return Design((CAMERA,), pixels, (0.0,), samples=20, seed=0)


def test_squared_correlations_are_those_of_numpy_and_their_intervals_hold_them():
    random = np.random.default_rng(3)
    truth = random.normal(size=(200, 5))
    metrics = np.full((200, 1, 2, 1, 4), np.nan)
    metrics[:, 0, 0, 0] = truth[:, :4] + 0.5 * random.normal(size=(200, 4))
    metrics[7, 0, 0, 0, 0] = np.nan  # a community of which a metric is not known
    table, lost = agreement(truth, metrics, _design(), 0.25)
    rows = table.set_index(["pixel_m", "metric", "diversity"])
    known = np.arange(200) != 7
    expected = np.corrcoef(metrics[known, 0, 0, 0, 0], truth[known, 0])[0, 1] ** 2
    row = rows.loc[(0.1, "cv", "richness")]
    assert row.r2 == pytest.approx(expected)
    assert row.q05 < 0.8 < row.q95  # 1 / (1 + 0.25), the correlation of the population
    assert np.isnan(rows.loc[(1.0, "cv", "richness")].r2)
    gone = lost.set_index(["metric", "diversity"])
    assert gone.loc[("cv", "richness")].lost_from_m == 1.0
    assert gone.loc[("cv", "cover")].lost_from_m == 0.1  # of which nothing is known
    assert (gone.loc[("cv", "richness")][["q05", "q95"]] == 1.0).all()


def test_species_are_recognised_where_spectra_differ_and_by_chance_where_they_do_not():
    random = np.random.default_rng(0)
    species = np.tile(np.repeat([0, 1, -1], 10), (12, 2, 1))
    far = random.normal(size=(12, 2, 1, 30, 3))
    far[:, 0] += 20.0 * species[:, 0, None, :, None]  # at the finer pixel alone
    found = recognition(species, [far], ("a", "b"), _design()).set_index("pixel_m")
    assert found.loc[0.1, "accuracy"] == 1.0
    assert found.loc[0.1, "jeffries_matusita"] == pytest.approx(2.0, abs=1e-3)
    assert found.loc[1.0, "accuracy"] == pytest.approx(0.5, abs=0.1)
    assert found.loc[1.0, "jeffries_matusita"] < 0.3
    assert (found["by_chance"] == 0.5).all()
    none = recognition(np.minimum(species, 0), [far], ("a", "b"), _design())
    assert none["species"].tolist() == [0, 0]


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"pixels": (0.1, 0.25)}, "a multiple of the smallest, but got 0.25 m"),
        ({"pixels": (0.3,)}, "a whole part of the side of 1 m, but got 0.3 m"),
        ({"communities": 2}, "at least 4 `communities`"),
        ({"noise": ()}, "at least one `noise`"),
        ({"sensors": ("flash_lidar_paper",)}, "an imaging sensor"),
        ({"gradients": Gradients(richness=(2, 40))}, "12 species with leaves"),
    ],
)
def test_settings_that_do_not_fit_are_refused(settings, message, tmp_path):
    with pytest.raises(InputError, match=message):
        diversity(tmp_path, **({"size": 1.0, "pixels": (0.5,)} | settings))


@pytest.mark.slow
def test_the_experiment_is_resumed_without_loss(tmp_path):
    """Tiny, of two species: the same numbers from a run that was interrupted."""
    pool = POOL.replace(voxel_m=0.25, structure_m="even")
    few = {"communities": 4, "size": 1.0, "pixels": (0.125, 0.25), "bands": 4}
    few |= {"sensors": ("mavic_3m",), "gradients": Gradients(richness=(2, 3))}
    kept = tmp_path / "kept"
    first = diversity(tmp_path / "a", pool, checkpoint=kept, **few)
    parts = sorted(path for path in kept.rglob("*") if path.is_file())
    again = diversity(tmp_path / "b", pool, checkpoint=kept, **few)
    assert parts
    assert again.lost == first.lost
    tables = ("communities", "agreement", "lost", "recognition")
    for name in tables:
        one, two = ((tmp_path / folder / f"{name}.csv").read_bytes() for folder in "ab")
        assert one == two
    assert first.headline[0].startswith("mavic_3m: of shannon the ")
    assert (tmp_path / "a" / "report.html").is_file()
    with pytest.raises(InputError, match="another run"):
        diversity(tmp_path / "c", pool, checkpoint=kept, **(few | {"communities": 4, "seed": 1}))

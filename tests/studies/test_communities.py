"""Communities along gradients, and their scores: against known correlations and classes."""

import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
import pytest
from scipy.spatial import ConvexHull

import fynjax as fx
from fynjax import jobs
from fynjax.app.assembly import build_plot
from fynjax.app.io.plot import example_folder, read_plot
from fynjax.diversity import pielou_evenness, rao_entropy, read_phylogeny
from fynjax.errors import InputError
from fynjax.inversion import COARSE, nadir_imager
from fynjax.radiation import Accuracy
from fynjax.scene import truth_of_pixels
from fynjax.sensors import PointSpread
from fynjax.studies.communities import Gradients, diversity, draw_community
from fynjax.studies.communities._draw import shares_of
from fynjax.studies.communities._job import TREE_2006, _few_bands, _headline, _pool, _related
from fynjax.studies.communities._observe import (
    Design,
    _coarser,
    _sample,
    functional_distance,
    green,
    hull,
    observe_community,
)
from fynjax.studies.communities._scores import (
    METRICS,
    _lost_from,
    composition,
    correlations,
    recognition,
)
from fynjax.studies.fynbos_2006 import table_after_fire

POOL = read_plot(example_folder() / "plot.toml")
CAMERA = fx.sensor("mavic_3m")


@pytest.mark.parametrize("count", [2, 5, 12])
@pytest.mark.parametrize("evenness", [0.4, 0.8, 1.0])
def test_shares_have_the_evenness(count, evenness):
    shares = shares_of(evenness, count)
    assert shares.sum() == pytest.approx(1.0)
    assert float(pielou_evenness(shares)) == pytest.approx(evenness, abs=1e-9)
    np.testing.assert_allclose(shares[1:] / shares[:-1], shares[1] / shares[0])


def test_relatives_by_the_shipped_tree_spread_further_and_have_slopes():
    """Ages of splits by hand; all tips as old as the root; slopes by differences."""
    path = np.array(_related("fynbos", POOL))
    row = {taxon: i for i, taxon in enumerate(POOL.taxa)}
    assert path[row["Erica irregularis"], row["Euclea racemosa"]] == pytest.approx(2 * 94.9)
    assert path[row["Cassytha ciliolata"], row["Restio eleocharis"]] == pytest.approx(2 * 135.9)
    assert not path[row["Deadwood"]].any()
    phylogeny = read_phylogeny(TREE_2006, [t for t in POOL.taxa if t != "Deadwood"])
    np.testing.assert_allclose(phylogeny.length @ phylogeny.carries, 135.9)
    assert _related(None, POOL) == ()
    random, within = np.random.default_rng(2), Gradients(richness=(4, 4))
    means = []
    for tree in ((), path):
        covers = [draw_community(POOL, within, random, tree).cover > 0 for _ in range(60)]
        means.append([path[np.ix_(c, c)].mean() for c in covers])
    assert np.std(means[1]) > 1.2 * np.std(means[0])
    cover, step = jnp.array(POOL.cover), 1e-4
    slope = jax.grad(lambda c: rao_entropy(c, path))(cover)
    ahead, back = (rao_entropy(cover.at[3].add(d), path) for d in (step, -step))
    assert slope[3] == pytest.approx(float(ahead - back) / (2 * step), rel=1e-5)
    share = cover / cover.sum()
    assert rao_entropy(cover, path) == pytest.approx(float(share @ path @ share))


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
        ({"richness": None}, "expected `richness` as two numbers in order"),
        ({"richness": (2, np.inf)}, "`richness` as two numbers in order"),
        ({"richness": (np.nan, 3)}, "`richness` as two numbers in order"),
        ({"richness": 5}, "`richness` as two numbers in order, from 1 to inf, but got 5"),
        ({"richness": (2.5, 3)}, "`richness` as two numbers in order"),
        ({"evenness": (0.5, 1.5)}, r"from 0.01 to 1, but got \(0.5, 1.5\)"),
        ({"evenness": "01"}, "`evenness` as two numbers in order"),
        ({"cover": (0.5,)}, "expected `cover` as two numbers"),
        ({"age": (0.0, 3.0)}, "from 1 to 40"),
    ],
)
def test_gradients_that_are_none_are_refused(settings, message):
    with pytest.raises(InputError, match=message):
        Gradients(**settings)


def test_species_and_heights_of_communities_are_those_of_the_pool_grown():
    within = Gradients(richness=(3, 3), age=(3.0, 3.0))
    random = np.random.default_rng(2)
    plots = [draw_community(POOL, within, random) for _ in range(50)]
    assert {t for p in plots for t, c in zip(p.taxa, p.cover, strict=True) if c} == {
        row.taxon for row in POOL.species if row.growth_form != "deadwood"
    }
    then = table_after_fire(3.0).set_index("taxon")["height_max_m"]
    for row in plots[0].species:
        if row.cover:
            assert row.height == pytest.approx(then[row.taxon])


def test_coarser_pixels_are_means_and_blurred_ones_keep_them():
    image = np.random.default_rng(0).random((2, 8, 8))
    plain = _coarser(image, 4, None, "open")
    np.testing.assert_allclose(plain[1, 0, 1], image[1, :4, 4:].mean())
    psf = PointSpread("gaussian", 2.0)
    point = np.zeros((1, 256, 256))
    point[0, 128, 128] = 1.0
    for times in (1, 4):  # as wide in pixels of any size
        blurred = _coarser(point, times, psf, "periodic")[0]
        assert blurred.sum() == pytest.approx(times**-2)
        x = np.arange(256 // times) - 128 // times - (times > 1) * (0.5 / times - 0.5)
        width = np.sqrt((blurred.sum(axis=0) * x**2).sum() * times**2)
        assert width == pytest.approx(2.0 / 2.3548, rel=0.1)
    west = np.zeros((1, 64, 64))
    west[0, :, 0] = 1.0
    assert _coarser(west, 2, psf, "periodic")[0, :, -1].max() > 0.05
    assert _coarser(west, 2, psf, "open")[0, :, -1].max() < 1e-6


def test_pixels_of_a_species_are_mostly_of_it():
    shares = np.array([[[0.6, 0.2, 0.1]], [[0.3, 0.3, 0.9]]])
    kinds, places = _sample(shares, 2, np.random.default_rng(0))
    assert kinds.tolist() == [0, -1, 1, -1]
    assert places[[0, 2]].tolist() == [0, 2]


def test_the_pixel_of_loss_is_where_the_signal_stays_below_the_threshold():
    pixels = np.array([0.1, 1.0, 10.0])
    r2 = np.array([[0.5, 0.3, 0.1], [0.1, 0.1, 0.1], [0.0, 0.0, 0.9]])
    assert _lost_from(r2, pixels, 0.25).tolist() == [10.0, 0.1, np.inf]
    unknown = np.array([[0.1, 0.3, np.nan], [0.5, np.nan, 0.1], [np.nan, 0.1, 0.1]])
    assert _lost_from(unknown, pixels, 0.25).tolist() == [np.inf, 10.0, 1.0]
    assert np.isnan(_lost_from(np.full((1, 3), np.nan), pixels, 0.25)).all()


def test_a_community_is_seen_as_its_image_and_its_plants_are():
    """Against metrics of what `observe` gives, and the truth of its pixels."""
    pool = POOL.replace(voxel_m=0.25, structure_m="even", size_m=(1.0, 1.0))
    design = Design((CAMERA,), (0.125, 0.25), (0.0, 0.2), samples=4, seed=5)
    within = Gradients(richness=(2, 2), cover=(0.8, 0.9))
    found, shown, metrics, species, spectra, drawn = observe_community(3, pool, within, design)
    random = np.random.default_rng([5, 71, 3])
    plot = draw_community(pool, within, random)
    scene, _ = build_plot(plot, seed=int(random.integers(2**31)), rounding="random")
    scene = scene.padded()  # no other plants, but the programs of `observe_community`
    image, exact = (
        np.asarray(
            fx.observe(scene, CAMERA, pixel=0.125, point_spread=False, accuracy=light).reflectance
        )
        for light in (COARSE, Accuracy())
    )
    np.testing.assert_allclose(image.mean(axis=(1, 2)), exact.mean(axis=(1, 2)), rtol=0.02)
    np.testing.assert_allclose(image.std(axis=(1, 2)), exact.std(axis=(1, 2)), rtol=0.08)
    wide = _coarser(image, 2, CAMERA.psf, "periodic").reshape(4, -1).T
    expected = [fx.diversity.coefficient_of_variation(wide), fx.diversity.mean_spectral_angle(wide)]
    expected += [fx.diversity.spectral_rao(wide), wide.var(axis=0, ddof=1).sum()]
    turned = np.linalg.svd(wide - wide.mean(axis=0), full_matrices=False)[0:2]
    expected.append(ConvexHull((turned[0] * turned[1])[:, :3]).volume)
    np.testing.assert_allclose(metrics[0, 1, 0], np.array(expected, float), rtol=1e-4)
    noisy = metrics[0, 1, 1, 0] ** 2 - metrics[0, 1, 0, 0] ** 2
    assert 0.3 < noisy / 0.2**2 < 3.0  # of 16 pixels
    above = nadir_imager(CAMERA.bands.select([0]), scene, scene.parameters)
    cover = np.asarray(truth_of_pixels(above, scene, scene.parameters).species).mean(axis=(1, 2))
    known = [(cover > 0).sum(), fx.diversity.shannon(cover), fx.diversity.simpson(cover)]
    known += [pielou_evenness(cover), cover.sum()]
    apart = functional_distance(pool, scene)
    share = cover / cover.sum()
    known.append(sum(share[i] * share[j] * apart[i, j] for i, j in np.ndindex(apart.shape)))
    np.testing.assert_allclose(found, np.array(known, float), rtol=1e-4)
    np.testing.assert_allclose(shown, cover, rtol=1e-6)
    truth = fx.pixel_truth(scene, CAMERA, pixel=0.125, point_spread=False)
    shares = _coarser(np.asarray(truth.species), 1, CAMERA.psf, "periodic")
    fine = _coarser(image, 1, CAMERA.psf, "periodic").reshape(4, -1)
    for kind, spectrum in zip(species[0, 0], spectra[0, 0], strict=True):
        if kind >= 0:
            place = np.argmin(((fine.T - spectrum) ** 2).sum(axis=1))
            np.testing.assert_allclose(fine[:, place], spectrum, rtol=1e-4)
            assert shares.reshape(len(shares), -1)[kind, place] >= 0.5
    assert np.isnan(drawn[:, :, 64:]).all()
    np.testing.assert_allclose(
        np.sort(drawn[0, 0, :64], axis=0), np.sort(fine.T, axis=0), rtol=1e-4
    )


def test_species_differ_in_function_by_form_height_and_leaves():
    """By hand: the mean over six traits of the difference over the range of the pool."""
    scene, _ = build_plot(POOL.replace(voxel_m=0.25, structure_m="even", size_m=(1.0, 1.0)))
    apart = functional_distance(POOL, scene)
    first, second = POOL.species[:2]
    height = np.array([row.height for row in POOL.species], float)
    expected = float(first.growth_form != second.growth_form)
    expected += abs(height[0] - height[1]) / np.ptp(height)
    for name in ("chlorophyll", "carotenoids", "water", "dry_matter"):
        trait = np.asarray(getattr(scene.parameters.leaf, name), float)
        expected += abs(trait[0] - trait[1]) / np.ptp(trait)
    assert apart[0, 1] == pytest.approx(expected / 6)


def test_the_hull_of_pixels_that_are_few_or_alike():
    assert np.isnan(hull(np.ones((4, 4))))
    assert hull(np.ones((5, 4))) == 0.0


def test_pixels_that_are_not_green_do_not_count():
    red, nir = CAMERA.bands.names.index("red"), CAMERA.bands.names.index("nir")
    spectra = np.full((3, 4), 0.1)
    spectra[:, red], spectra[:, nir] = 0.1, [0.1, 0.2, 0.3]
    assert green(spectra, CAMERA, 0.4).tolist() == [False, False, True]
    assert green(spectra, CAMERA, None).all()
    with pytest.raises(InputError, match=r"670 and 860 nm, but the 2 of mavic_3m .* \(`bands`\)"):
        green(spectra[:, :2], CAMERA.select([0, 1]), 0.4)


def _design(pixels=(0.1, 1.0)):
    return Design((CAMERA,), pixels, (0.0,), samples=20, seed=0)


def test_squared_correlations_are_those_of_numpy_and_their_intervals_hold_them():
    random = np.random.default_rng(3)
    truth = random.normal(size=(200, 6))
    metrics = np.full((200, 1, 2, 1, len(METRICS)), np.nan)
    metrics[:, 0, 0, 0, :5] = truth[:, :5] + 0.5 * random.normal(size=(200, 5))
    metrics[7, 0, 0, 0, 0] = np.nan  # a community of which a metric is not known
    table, lost = correlations(truth, metrics, _design(), 0.25)
    rows = table.set_index(["pixel_m", "metric", "diversity"])
    known = np.arange(200) != 7
    expected = np.corrcoef(metrics[known, 0, 0, 0, 0], truth[known, 0])[0, 1] ** 2
    row = rows.loc[(0.1, "cv", "richness")]
    assert row.r2 == pytest.approx(expected)
    assert row.q05 < 0.8 < row.q95  # 1 / (1 + 0.25), the correlation of the population
    assert np.isnan(rows.loc[(1.0, "cv", "richness")].r2)
    gone = lost.set_index(["metric", "diversity"])
    assert (gone.loc[("cv", "richness")][["lost_from_m", "q05", "q95"]] == np.inf).all()
    assert gone.loc[("cv", "richness")].unknown_beyond_m == 0.1
    of = "functional"  # of which nothing is known
    assert gone.loc[("cv", of)].lost_from_m == 0.1
    # Of 200 communities that have nothing to do with each other, the greatest by chance.
    assert 0.01 < gone.loc[("cv", of)].by_chance < 0.03
    assert gone.loc[("any", of)].by_chance > gone.loc[("cv", of)].by_chance
    few = np.where(np.arange(200)[:, None, None, None, None] < 9, metrics, np.nan)
    assert correlations(truth, few, _design(), 0.25)[0].r2.isna().all()  # of nine nothing is said
    # The best metric holds where that of the greatest peak is gone.
    metrics[:, 0, 1, 0, :2] = random.normal(size=(200, 2))
    metrics[:, 0, 1, 0, 1] = truth[:, 0] + 0.9 * metrics[:, 0, 1, 0, 1]
    _, lost = correlations(truth, metrics, _design(), 0.25)
    gone = lost.set_index(["metric", "diversity"])
    assert gone.loc[("cv", "richness")].lost_from_m == 1.0
    assert np.isinf(gone.loc[("any", "richness")].lost_from_m)
    assert np.isnan(gone.loc[("any", "richness")].unknown_beyond_m)
    truth[:, 0] = 3.0  # all alike
    _, lost = correlations(truth, metrics, _design(), 0.25)
    alike = lost.set_index(["metric", "diversity"]).loc[("any", "richness")]
    assert alike.drop(["sensor", "noise"]).isna().all()
    known = pd.DataFrame(
        {"sensor": [CAMERA.name], "noise": 0.0, "pixel_m": 0.1, "species": 0.0, "accuracy": np.nan,
         "by_chance": np.nan}
    )  # fmt: skip
    unknown = lost.assign(best_r2=0.9, best_pixel_m=0.1, lost_from_m=np.inf, unknown_beyond_m=0.1)
    assert _headline(unknown, known, 0.25)[0].endswith("at the widest pixel that is known, 0.1 m.")
    lines = _headline(pd.concat([lost.assign(noise=0.1, best_r2=0.01), lost]), known, 0.25)
    assert lines[1] == f"{CAMERA.name}: richness does not vary over the communities."
    assert "every metric is below 25 % from 1 m on [1, 1]" in lines[0]
    assert lines[3].endswith("no two species lead in enough pixels of 0.1 m.")
    low = lost.assign(best_r2=0.2)
    assert "every metric is below 25 % at every pixel" in _headline(low, known, 0.25)[0]


def test_spectral_species_are_those_of_all_communities_together():
    """Ten communities of six pixels in six spots: six clusters, one of ten pixels. Plants are those
    of the spots at the finer pixel, and have nothing to do with them at the coarser one."""
    random = np.random.default_rng(4)
    spots = 10.0 * random.normal(size=(6, 4))
    kinds = np.stack([random.choice(6, 6, p=p) for p in random.dirichlet(np.full(6, 0.5), 10)])
    other = random.permutation(kinds.ravel()).reshape(10, 6)
    pixels = spots[np.stack([kinds, other], axis=1)[:, :, None]]
    pixels = np.pad(pixels, ((0, 0),) * 3 + ((0, 2), (0, 0)), constant_values=np.nan)
    pixels += 0.01 * random.normal(size=pixels.shape)
    count = np.stack([np.bincount(one, minlength=6) for one in kinds])
    cover = count * random.uniform(0.05, 0.15, (10, 1))  # more plants of the same kinds
    of_image = random.random((10, 1, 2, 1, 5))
    found, table = composition(cover, of_image, [pixels], _design())
    np.testing.assert_allclose(found[:, 0, 0, 0, -1], fx.diversity.shannon(count), atol=1e-6)
    assert (found[..., :-1] == of_image).all()
    assert table["spectral_species"].tolist() == [6, 6]
    assert table["mantel"][0] == pytest.approx(1.0)
    assert abs(table["mantel"][1]) < 0.5
    assert table["p_value"][0] < 0.01 < table["p_value"][1]
    # A community without pixels that count is left out; of too few pixels nothing is known.
    pixels[3, 0], pixels[:, 1, 0, 1:] = np.nan, np.nan
    found, table = composition(cover, of_image, [pixels], _design())
    assert np.isnan(found[:, 0, 0, 0, -1]).tolist() == [i == 3 for i in range(10)]
    assert table["mantel"][0] > 0.8
    assert np.isnan(found[:, 0, 1, 0, -1]).all()
    assert np.isnan(table["mantel"][1])
    assert table["pixels"].tolist() == [6, 1]


def test_communities_have_as_many_pixels_for_hull_and_clusters():
    """Spectra of one distribution, ten to sixty pixels: of all of them the metrics grow with the
    number. A community of nine pixels is left out."""
    random = np.random.default_rng(6)
    number = np.arange(9, 60, 5)
    pixels = random.normal(size=(len(number), 1, 1, 60, 4))
    pixels[np.arange(60)[None] >= number[:, None, None, None]] = np.nan
    design = Design((CAMERA,), (0.1,), (0.0,), samples=20, seed=0, greenness=0.4)
    of_image = np.ones((len(number), 1, 1, 1, 5))
    cover = random.random((len(number), 3)) + 0.1
    found, table = composition(cover, of_image, [pixels], design)
    assert table["pixels"].tolist() == [14]
    assert np.isnan(found[0, 0, 0, 0, 4:]).all()
    for metric in found[1:, 0, 0, 0, 4:].T:
        assert abs(np.corrcoef(metric, number[1:])[0, 1]) < 0.6
    np.testing.assert_allclose(found[-1, 0, 0, 0, 4], hull(pixels[-1, 0, 0, :14]))


def test_what_does_not_vary_is_not_known_and_loses_no_other_row():
    """A band that is the same in all pixels, and species whose pixels are all alike."""
    random = np.random.default_rng(0)
    species = np.tile(np.repeat([0, 1], 10), (10, 1, 2, 1))
    pixels = random.random((10, 2, 1, 20, 4))
    pixels[:, 0, :, :, 1], pixels[:, 0, :, :10], pixels[:, 0, :, 10:] = 0.3, 0.3, 0.5
    pixels[:, 0, 0, :, 1] = 0.3
    cover = random.random((10, 2)) + 0.1
    _, table = composition(cover, np.ones((10, 1, 2, 1, 5)), [pixels], _design())
    assert np.isfinite(table["mantel"]).tolist() == [False, True]
    known = recognition(species, [pixels], ("a", "b"), _design())
    assert np.isfinite(known["accuracy"]).all()
    assert np.isfinite(known["jeffries_matusita"]).tolist() == [False, True]


def test_species_are_recognised_where_spectra_differ_and_by_chance_where_they_do_not():
    random = np.random.default_rng(0)
    species = np.tile(np.repeat([0, 1, -1], 10), (12, 1, 2, 1))
    far = random.normal(size=(12, 2, 1, 30, 3))
    far[:, 0] += 20.0 * species[:, 0, 0, None, :, None]  # at the finer pixel alone
    found = recognition(species, [far], ("a", "b"), _design()).set_index("pixel_m")
    assert found.loc[0.1, "accuracy"] == 1.0
    assert found.loc[0.1, "jeffries_matusita"] == pytest.approx(2.0, abs=1e-3)
    assert found.loc[1.0, "accuracy"] == pytest.approx(0.5, abs=0.1)
    assert found.loc[1.0, "jeffries_matusita"] < 0.3
    assert (found["by_chance"] == 0.5).all()
    none = recognition(np.minimum(species, 0), [far], ("a", "b"), _design())
    assert none["species"].tolist() == [0, 0]


def test_what_is_true_of_one_community_alone_is_no_skill():
    """Species that differ in each community in another way; and one that is too rare."""
    random = np.random.default_rng(0)
    species = np.tile(np.repeat([0, 1, -1], 10), (12, 1, 1, 1))
    species[:4, 0, 0, -1] = 2
    own = random.normal(size=(12, 1, 1, 30, 12))
    for number in range(12):  # of each community another band
        own[number, 0, 0, :, number] += 20.0 * (species[number, 0, 0] == 1)
    found = recognition(species, [own], ("a", "b", "c"), _design((0.1,))).iloc[0]
    assert found["species"] == 2.0
    assert found["accuracy"] < 0.8


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"pixels": (0.1, 0.25)}, "a multiple of the smallest, but got 0.25 m"),
        ({"pixels": (0.3,)}, "a part of the side of 1 m, but got 0.3 m"),
        ({"pixels": (0.5, 1.0)}, "at most half the side of 1 m, but got 0.5, 1"),
        ({"pixels": (float("nan"),)}, "above 0 and at most half"),
        ({"size": 1.05, "pixels": (0.05,)}, "whole voxels of 0.1 m, but got 1.05 m"),
        ({"communities": 4}, "`communities` as a whole number of at least 10, but got 4"),
        ({"bands": 2.5}, "`bands` as a whole number"),
        ({"threshold": 1.0}, "above 0 and below 1, but got 1"),
        ({"seed": -1}, "`seed` as a whole number from 0 to 2147483647, but got -1"),
        ({"sensors": "aviris_ng", "bands": 3, "greenness": 0.4}, "the 3 of aviris_ng"),
        ({"greenness": 1.0}, "from -1 to below 1, but got 1"),
        ({"noise": ()}, "at least one `noise`"),
        ({"noise": (float("nan"),)}, "each from 0 to 0.3"),
        ({"noise": (0.1, 0.1)}, "each noise once"),
        ({"sensors": "mavic_3"}, "Did you mean 'mavic_3m'"),
        ({"sensors": ("flash_lidar_paper",)}, "an imaging sensor"),
        ({"gradients": Gradients(richness=(2, 40))}, "12 species with leaves"),
    ],
)
def test_settings_that_do_not_fit_are_refused(settings, message, tmp_path):
    with pytest.raises(InputError, match=message):
        diversity(tmp_path, **({"size": 1.0, "pixels": (0.5,)} | settings))


@pytest.mark.slow
def test_the_experiment_is_resumed_without_loss(tmp_path):
    """Tiny, of two or three species, so alike that all communities compile one program: the same
    numbers from a run that was interrupted."""
    alike = ("Indigofera brachystachya", "Restio eleocharis", "Cassytha ciliolata")
    species = tuple(row for row in POOL.species if row.taxon in alike)
    pool = POOL.replace(voxel_m=0.25, structure_m="even", species=species)
    few = {"communities": 10, "size": 1.0, "pixels": (0.125, 0.25), "bands": 4}
    within = Gradients(richness=(2, 3), cover=(0.5, 0.55), age=(10.0, 16.0))
    few |= {"sensors": ("mavic_3m",), "gradients": within}
    kept = tmp_path / "kept"
    first = diversity(tmp_path / "a", pool, checkpoint=kept, **few)
    parts = sorted(path for path in kept.rglob("*") if path.is_file())
    again = diversity(tmp_path / "b", pool, checkpoint=kept, **few)
    assert parts
    assert again.lost == first.lost
    tables = ("communities", "agreement", "lost", "recognition", "composition")
    for name in tables:
        one, two = ((tmp_path / folder / f"{name}.csv").read_bytes() for folder in "ab")
        assert one == two
    assert first.headline[0].startswith("mavic_3m: of shannon the ")
    assert (tmp_path / "a" / "report.html").is_file()
    with pytest.raises(InputError, match="another run"):
        diversity(
            tmp_path / "c",
            pool,
            checkpoint=kept,
            **(few | {"gradients": Gradients(richness=(2, 2))}),
        )


def test_a_species_table_alone_is_a_pool(tmp_path, shared_data):
    """A field's table with semicolons and decimal commas, in the light of the shipped plot."""
    table = shared_data / "field/16_species-tables/bom_semicolon_decimalcomma/species.csv"
    pool = _pool(table)
    assert pool.taxa == POOL.taxa
    assert table.resolve() in pool.inputs  # whose hash the checkpoint holds
    assert pool.leaves == ()
    assert pool.sun == POOL.sun
    with jobs.dry_run(), pytest.raises(jobs.DryRunEnd):
        diversity(tmp_path, table, size=1.0, pixels=(0.5,))
    with pytest.raises(InputError, match="no such file"):
        diversity(tmp_path, tmp_path / "species.csv")


def test_bands_are_chosen_evenly():
    every = fx.sensor("aviris_ng")
    few = _few_bands("aviris_ng", 5).bands.centre
    np.testing.assert_allclose(np.diff(few), np.diff(few).mean(), rtol=0.02)
    assert few[0] < 420.0 < 2400.0 < few[-1]
    assert len(_few_bands(CAMERA, 9).bands) == 4 < len(every.bands)

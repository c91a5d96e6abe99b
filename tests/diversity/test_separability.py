"""Telling species apart: closed forms of normal classes, spots that are apart, noise."""

import sys

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.stats import norm
from sklearn.covariance import ledoit_wolf

from fynjax.diversity import (
    bhattacharyya_distance,
    classify,
    jeffries_matusita_distance,
    separability,
)
from fynjax.errors import InputError, MissingExtraError

NAMES = ["Erica", "Protea", "Restio"]


def with_moments(mean: np.ndarray, covariance: np.ndarray, count: int = 30) -> np.ndarray:
    """Pixels whose sample mean and covariance are exactly these."""
    noise = np.random.default_rng(0).normal(size=(count, len(mean)))
    noise -= noise.mean(axis=0)
    noise = noise @ np.linalg.inv(np.linalg.cholesky(np.cov(noise.T).reshape(len(mean), -1))).T
    return mean + noise @ np.linalg.cholesky(covariance).T


def test_bhattacharyya_is_the_overlap_of_two_normal_densities() -> None:
    """exp(-B) is the integral of sqrt(p1 p2), here by quadrature."""
    one, two = norm(0.3, 0.05), norm(0.38, 0.11)
    overlap = quad(lambda x: np.sqrt(one.pdf(x) * two.pdf(x)), -1.0, 2.0, points=[0.3, 0.38])[0]
    first, second = (with_moments(np.array([n.mean()]), np.array([[n.var()]])) for n in (one, two))
    got = bhattacharyya_distance(first, second, shrinkage=0.0)
    assert np.exp(-got) == pytest.approx(overlap, rel=1e-6)
    assert float(jeffries_matusita_distance(got)) == pytest.approx(2.0 * (1.0 - overlap), rel=1e-6)


def test_bhattacharyya_of_correlated_bands() -> None:
    """Formula with an explicit inverse and determinants; blind to unit and order."""
    s1 = np.array([[0.04, 0.03], [0.03, 0.05]])
    s2 = np.array([[0.02, -0.01], [-0.01, 0.06]])
    off, both = np.array([0.2, -0.1]), 0.5 * (s1 + s2)
    expected = off @ np.linalg.inv(both) @ off / 8.0 + 0.5 * np.log(
        np.linalg.det(both) / np.sqrt(np.linalg.det(s1) * np.linalg.det(s2))
    )
    first, second = with_moments(off, s1), with_moments(np.zeros(2), s2)
    assert bhattacharyya_distance(first, second, shrinkage=0.0) == pytest.approx(expected)
    scaled = bhattacharyya_distance(1e4 * second, 1e4 * first, shrinkage=0.0)
    assert scaled == pytest.approx(expected)
    assert bhattacharyya_distance(first, first, shrinkage=0.3) == pytest.approx(0.0, abs=1e-12)


def distances(off: np.ndarray, spread: float = 1.0, count: int = 20) -> np.ndarray:
    """Jeffries-Matusita distances of 20 draws of two classes of `count` normal pixels each."""
    rng, bands = np.random.default_rng(1), len(off)
    classes = rng.normal(size=(20, 2, count, bands))
    classes[:, 1] = off + spread * classes[:, 1]
    return jeffries_matusita_distance([bhattacharyya_distance(*two) for two in classes])


@pytest.mark.parametrize(("bands", "without"), [(4, 0.1), (10, 0.15), (50, 0.9)])
def test_classes_that_are_alike_have_hardly_any_distance(bands: int, without: float) -> None:
    """Twenty pixels each; shrunk alone they had `without` and more."""
    assert 0.0 <= distances(np.zeros(bands)).mean() < 0.18
    one, two = np.random.default_rng(1).normal(size=(2, 20, bands))
    logs = [np.linalg.slogdet(c)[1] for c in covariances(one, two)]
    off = one.mean(axis=0) - two.mean(axis=0)
    square = off @ np.linalg.solve(covariances(one, two)[0], off)
    formula = square / 8.0 + 0.5 * (logs[0] - 0.5 * (logs[1] + logs[2]))
    assert jeffries_matusita_distance(formula) > without


def covariances(one: np.ndarray, two: np.ndarray) -> list[np.ndarray]:
    """Mean of the shrunk matrices, and each: those of scikit-learn's `ledoit_wolf` but for the
    factor n / (n - 1)."""
    first, second = (ledoit_wolf(x)[0] * len(x) / (len(x) - 1.0) for x in (one, two))
    return [0.5 * (first + second), first, second]


@pytest.mark.parametrize("bands", [4, 10, 50])
def test_distances_of_few_pixels_are_about_those_of_their_classes(bands: int) -> None:
    """Means apart, of which B = 1/2; and a spread twice as large in variance."""
    expected = 2.0 - 2.0 * np.exp(-0.5)
    got = distances(np.sqrt(4.0 / bands) * np.ones(bands))
    assert got.mean() == pytest.approx(expected, abs=0.15)
    overlap = (1.5 / np.sqrt(2.0)) ** (-0.5 * bands)
    assert distances(np.zeros(bands), np.sqrt(2.0)).mean() == pytest.approx(
        2.0 * (1.0 - overlap), abs=0.15
    )


def test_distances_of_many_pixels_are_those_of_the_shrunk_covariances() -> None:
    """But for a correction of 0.3 %."""
    one, two = np.random.default_rng(2).normal(size=(2, 5000, 3))
    two += 1.2
    both, first, second = covariances(one, two)
    off = one.mean(axis=0) - two.mean(axis=0)
    logs = [np.linalg.slogdet(c)[1] for c in (both, first, second)]
    expected = off @ np.linalg.inv(both) @ off / 8.0 + 0.5 * (logs[0] - 0.5 * (logs[1] + logs[2]))
    assert bhattacharyya_distance(one, two) == pytest.approx(expected, rel=3e-3)
    assert np.isfinite(bhattacharyya_distance(one[:3], two[:3]))  # fewer pixels than bands


def test_jeffries_matusita_ends_at_two() -> None:
    got = jeffries_matusita_distance([0.0, np.log(2.0), 1e-12, np.inf])
    np.testing.assert_allclose(got, [0.0, 1.0, 2e-12, 2.0], rtol=1e-10)


def plantings(apart: float, count: int = 40) -> tuple[np.ndarray, list[str], list[int]]:
    rng = np.random.default_rng(2)
    place = apart * np.eye(3, 5)
    kind = np.tile(np.arange(3), count)
    return (
        rng.normal(size=(3 * count, 5)) + place[kind],
        [NAMES[k] for k in kind],
        [i * 2 // (3 * count) for i in range(3 * count)],
    )


def test_pairs_of_species_are_in_a_table() -> None:
    spectra, species, _ = plantings(3.0)
    table = separability(spectra, species)
    assert list(zip(table["first"], table["second"])) == [
        ("Erica", "Protea"),
        ("Erica", "Restio"),
        ("Protea", "Restio"),
    ]
    name = np.array(species)
    expected = bhattacharyya_distance(spectra[name == "Erica"], spectra[name == "Restio"])
    assert table["bhattacharyya"][1] == pytest.approx(expected)
    assert table["jeffries_matusita"][1] == pytest.approx(2.0 - 2.0 * np.exp(-expected))


@pytest.mark.parametrize("method", ["discriminant", "forest"])
def test_species_apart_are_recognised_in_other_plantings_and_noise_is_not(method: str) -> None:
    spectra, species, group = plantings(12.0)
    got = classify(spectra, species, group, method=method)
    assert got.classes == ("Erica", "Protea", "Restio")
    assert got.confusion.sum() == 120  # two groups: each pixel is judged once
    assert got.accuracy == 1.0
    assert got.by_group == {"0": 1.0, "1": 1.0}
    spectra, species, group = plantings(0.0)
    noise = classify(spectra, species, group, method=method)
    assert 0.15 < noise.accuracy < 0.52  # a third by chance
    again = classify(spectra, species, group, method=method)
    np.testing.assert_array_equal(noise.confusion, again.confusion)


def test_a_group_is_never_judged_by_itself() -> None:
    """In the second planting two species have changed places: what was learned there misleads."""
    spectra, species, group = plantings(12.0)
    swap = {"Erica": "Protea", "Protea": "Erica", "Restio": "Restio"}
    species = [swap[s] if g else s for s, g in zip(species, group)]
    got = classify(spectra, species, group)
    np.testing.assert_array_equal(got.confusion, [[0, 40, 0], [40, 0, 0], [0, 0, 40]])
    forms = got.merged({"Erica": "shrub", "Protea": "shrub", "Restio": "tussock"})
    assert forms.classes == ("shrub", "tussock")
    np.testing.assert_array_equal(forms.confusion, [[80, 0], [0, 40]])
    assert forms.accuracy == 1.0
    with pytest.raises(InputError, match="Restio has none"):
        got.merged({"Erica": "shrub", "Protea": "shrub"})


class Absent:
    """An environment without scikit-learn."""

    @staticmethod
    def find_spec(name, path=None, target=None):
        if name == "sklearn":
            raise ModuleNotFoundError("not installed", name=name)


def test_without_scikit_learn_the_install_line_is_named(monkeypatch) -> None:
    spectra, species, group = plantings(1.0)
    for module in [name for name in sys.modules if name.split(".")[0] == "sklearn"]:
        monkeypatch.delitem(sys.modules, module)
    monkeypatch.setattr(sys, "meta_path", [Absent(), *sys.meta_path])
    for call in (lambda: separability(spectra, species), lambda: classify(spectra, species, group)):
        with pytest.raises(MissingExtraError, match=r'pip install "fynjax\[analysis\]"'):
            call()


SPECTRA, SPECIES, GROUP = plantings(1.0)


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: bhattacharyya_distance(SPECTRA, SPECTRA[:, :3]), "in the same bands"),
        (lambda: bhattacharyya_distance(SPECTRA, SPECTRA[:1]), "two pixels or more"),
        (lambda: bhattacharyya_distance(SPECTRA, SPECTRA * np.nan), "finite spectra"),
        (lambda: bhattacharyya_distance(SPECTRA, SPECTRA[:4], shrinkage=0.0), "singular"),
        (lambda: bhattacharyya_distance(SPECTRA, 0 * SPECTRA, shrinkage=0.5), "singular"),
        (lambda: bhattacharyya_distance(SPECTRA, SPECTRA, shrinkage=2.0), "from 0 to 1"),
        (lambda: jeffries_matusita_distance(-0.1), "at least 0"),
        (lambda: separability(SPECTRA, ["Erica"] * 120), "two species or more"),
        (lambda: separability(SPECTRA, SPECIES[:-1]), "a species for each pixel"),
        (lambda: classify(SPECTRA, SPECIES, [0] * 120), "two groups or more"),
        (lambda: classify(SPECTRA, SPECIES, GROUP[:-1]), "a group for each of 120 pixels"),
        (lambda: classify(SPECTRA * np.inf, SPECIES, GROUP), "finite spectra"),
        (lambda: classify(SPECTRA, SPECIES, [2, *GROUP[1:]]), "'2' has no pixel of Protea, Restio"),
        (lambda: classify(SPECTRA, SPECIES, [2] * 3 + GROUP[3:]), "no more pixels than"),
        (lambda: classify(SPECTRA, SPECIES, GROUP, method="tree"), "'discriminant' or 'forest'"),
    ],
)
def test_wrong_classes_are_refused(call, words: str) -> None:
    with np.errstate(invalid="ignore"), pytest.raises(InputError, match=words):
        call()

"""Distances between species: loops, principal coordinates, scikit-bio, closed forms."""

import io
import sys
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
import pytest
import skbio

from fynjax.diversity import (
    faith_diversity,
    functional_dispersion,
    gower_distance,
    mean_pairwise_distance,
    rao_entropy,
    read_phylogeny,
    simpson,
)
from fynjax.errors import InputError, MissingExtraError

TRAITS = pd.DataFrame(
    {
        "height": [0.4, 1.2, np.nan, 2.0],
        "leaf_mass": [120.0, 300.0, 210.0, 180.0],
        "form": ["shrub", "shrub", "tussock", None],
    },
    index=["Erica", "Protea", "Restio", "Leucadendron"],
)
COVER = np.array([[30.0, 10.0, 5.0, 0.0], [1.0, 1.0, 1.0, 1.0], [0.0, 8.0, 0.0, 0.0]])
NEWICK = "(((Erica_one:1,Erica_two:2):0.5,Protea:3):1,(Restio:4,'Far away':9):2);"
TAXA = ["Protea", "Erica one", "Restio", "Erica_two"]


@pytest.fixture
def tree(tmp_path: Path) -> Path:
    path = tmp_path / "tree.nwk"
    path.write_text(NEWICK, "utf-8")
    return path


def test_gower_by_hand() -> None:
    """Gower (1971) pair by pair: numbers over their range, categories 0 or 1, unknown left out."""
    got = gower_distance(TRAITS)
    assert got[0, 1] == pytest.approx((0.8 / 1.6 + 180.0 / 180.0 + 0.0) / 3)
    assert got[0, 2] == pytest.approx((90.0 / 180.0 + 1.0) / 2)
    assert got[2, 3] == pytest.approx(30.0 / 180.0)
    assert got[1, 3] == pytest.approx((0.8 / 1.6 + 120.0 / 180.0) / 2)
    np.testing.assert_array_equal(got, got.T)


def test_rao_is_its_double_sum_and_simpson_for_equal_distances() -> None:
    distance = gower_distance(TRAITS)
    for cover in COVER:
        share = cover / cover.sum()
        expected = sum(share[i] * share[j] * distance[i, j] for i in range(4) for j in range(4))
        assert float(rao_entropy(cover, distance)) == pytest.approx(expected, rel=1e-12)
    np.testing.assert_allclose(rao_entropy(COVER, 1.0 - np.eye(4)), simpson(COVER), atol=1e-15)


def dispersion_by_coordinates(cover: np.ndarray, distance: np.ndarray) -> float:
    """Laliberté and Legendre (2010) step by step: principal coordinates, centroid, distances.

    What FD::fdisp of R states: axes with negative eigenvalues count against the others.
    """
    count = len(distance)
    centring = np.eye(count) - 1.0 / count
    value, vector = np.linalg.eigh(-0.5 * centring @ distance**2 @ centring)
    place = vector * np.sqrt(np.abs(value))
    weight = cover / cover.sum()
    square = (place - weight @ place) ** 2
    z = np.sqrt(np.abs(square[:, value > 0].sum(axis=1) - square[:, value <= 0].sum(axis=1)))
    return float(weight @ z)


@pytest.mark.parametrize("euclidean", [True, False])
def test_dispersion_is_that_of_principal_coordinates(euclidean: bool) -> None:
    rng = np.random.default_rng(0)
    traits = rng.normal(size=(6, 3))
    distance = np.linalg.norm(traits[:, None] - traits, axis=-1)
    if not euclidean:  # far from any Euclidean space
        distance = distance**3
    cover = rng.gamma(1.0, 5.0, size=(4, 6))
    cover[0, 1:3] = 0.0
    got = functional_dispersion(cover, distance)
    for row, value in zip(cover, got):
        assert float(value) == pytest.approx(dispersion_by_coordinates(row, distance), rel=1e-9)
    if euclidean:  # and straight from the traits
        share = cover[1] / cover[1].sum()
        apart = np.linalg.norm(traits - share @ traits, axis=1)
        assert float(got[1]) == pytest.approx(float(share @ apart), rel=1e-12)


def test_one_species_has_no_dispersion_and_finite_slopes() -> None:
    distance = gower_distance(TRAITS)
    assert float(functional_dispersion(COVER[2], distance)) == 0.0
    slope = jax.grad(lambda c: functional_dispersion(c, distance))(jnp.asarray(COVER[2]))
    assert bool(jnp.isfinite(slope).all())
    assert float(functional_dispersion([1.0, 1.0], [[0.0, 0.6], [0.6, 0.0]])) == pytest.approx(0.3)


@pytest.mark.parametrize("function", [rao_entropy, functional_dispersion])
def test_slopes_by_cover_and_distance(function) -> None:
    distance = jnp.asarray(gower_distance(TRAITS))
    cover = jnp.array([30.0, 10.0, 5.0, 2.0])
    by_cover, by_distance = jax.grad(function, (0, 1))(cover, distance)
    step = jnp.array([0.0, 1e-4, 0.0, 0.0])
    quotient = (function(cover + step, distance) - function(cover - step, distance)) / 2e-4
    assert float(by_cover[1]) == pytest.approx(float(quotient), rel=1e-6)
    step = 1e-5 * (jnp.eye(4)[0][:, None] * jnp.eye(4)[1] + jnp.eye(4)[1][:, None] * jnp.eye(4)[0])
    quotient = (function(cover, distance + step) - function(cover, distance - step)) / 2e-5
    total = float(by_distance[0, 1] + by_distance[1, 0])
    assert total == pytest.approx(float(quotient), rel=1e-6)


def test_descent_is_that_of_scikit_bio(tree: Path) -> None:
    """Faith's PD and path lengths against scikit-bio's own, on all subsets of the taxa."""
    phylogeny = read_phylogeny(tree, TAXA)
    whole = skbio.TreeNode.read(io.StringIO(NEWICK))
    names = ["Protea", "Erica one", "Restio", "Erica two"]
    distance = whole.cophenet().filter(names).data
    np.testing.assert_allclose(phylogeny.distance, distance, rtol=1e-12)
    subsets = [[(k >> i) & 1 for i in range(4)] for k in range(1, 16)]
    for there in subsets:
        expected = skbio.diversity.alpha.faith_pd(there, taxa=names, tree=whole)
        assert faith_diversity(there, phylogeny) == pytest.approx(expected, rel=1e-12)
        if sum(there) > 1:
            pairs = [distance[i, j] for i in range(4) for j in range(i) if there[i] and there[j]]
            assert mean_pairwise_distance(there, phylogeny) == pytest.approx(np.mean(pairs))
    assert faith_diversity([0.0, 1.0, 0.0, 0.0], phylogeny) == 2.5  # 1 + 0.5 + 1 to the root
    assert faith_diversity(subsets, phylogeny).shape == (15,)


def test_without_scikit_bio_the_install_line_is_named(tree: Path, monkeypatch) -> None:
    monkeypatch.setitem(sys.modules, "skbio", None)
    with pytest.raises(MissingExtraError, match=r'pip install "fynjax\[analysis\]"'):
        read_phylogeny(tree, TAXA)


@pytest.mark.parametrize(
    ("text", "taxa", "words"),
    [
        (NEWICK, ["Protea", "Erica on"], "the taxon 'Erica on' is not in the tree.*'Erica one'"),
        (NEWICK, ["Protea", "Protea"], "the taxon 'Protea' is there twice"),
        ("(A:1,A:2);", ["A"], "the taxon 'A' is there twice"),
        ("((A,B:1):1,C:2);", ["A", "C"], "one above 'A' has none"),
        ("((A:-1,B:1):1,C:2);", ["B", "A"], "one above 'A' has -1"),
        ("((A:1,B:1", ["A"], "expected a tree in Newick form"),
    ],
)
def test_wrong_trees_are_refused(tmp_path: Path, text: str, taxa: list[str], words: str) -> None:
    path = tmp_path / "tree.nwk"
    path.write_text(text, "utf-8")
    with pytest.raises(InputError, match=rf"tree\.nwk: .*{words}"):
        read_phylogeny(path, taxa)


def test_wrong_input_is_refused(tree: Path) -> None:
    phylogeny = read_phylogeny(tree, TAXA)
    same = pd.DataFrame({"height": [1.0, 1.0]})
    unknown = pd.DataFrame({"a": [1.0, np.nan, 2.0], "b": [None, "x", "y"]}, index=list("pqr"))
    for call, words in (
        (lambda: read_phylogeny(tree / "none", TAXA), "but there is none"),
        (lambda: faith_diversity([1.0, 2.0], phylogeny), "of the 4 taxa of the tree, but got 2"),
        (lambda: mean_pairwise_distance([0, 0, 1, 0], phylogeny), "two taxa or more"),
        (lambda: gower_distance(TRAITS.iloc[:1]), "two species or more"),
        (lambda: gower_distance(same), "'height' is the same for all species"),
        (lambda: gower_distance([[1.0], [np.inf]]), "infinite"),
        (lambda: gower_distance(unknown), "'p' and 'q' have no known trait in common"),
        (lambda: rao_entropy([1.0, 1.0], np.eye(3)), r"of the 2 species.*\(3, 3\)"),
        (lambda: rao_entropy([1.0, 1.0], np.eye(2)), "0 on its diagonal"),
        (lambda: rao_entropy([1.0, 1.0], [[0.0, 1.0], [2.0, 0.0]]), "symmetric"),
        (lambda: rao_entropy([1.0, 1.0], [[0.0, -1.0], [-1.0, 0.0]]), "not negative"),
    ):
        with pytest.raises(InputError, match=words):
            call()

"""Outside `jit` a derivative by any of the parameters runs one and the same program."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import fynjax as fx
from fynjax.scene._observe import _nothing
from fynjax.sensors import BandSet
from tests.helpers import IMAGE_PROGRAMS, compilations
from tests.scene.plots import EXACT, small_plot

PARTS = {
    "cover": lambda p: p.species.cover,
    "height": lambda p: p.species.height,
    "chlorophyll": lambda p: p.leaf.chlorophyll,
    "sun": lambda p: p.light.sun_zenith,
}


@pytest.fixture(scope="module")
def red():
    """Mean of a band as a function of parameters and scene, after its gradient by all."""
    scene = small_plot(voxel=0.4)

    def value(parameters, scene=scene, pixel=0.4):
        image = fx.observe(
            scene,
            "mavic_3m",
            pixel=pixel,
            parameters=parameters,
            accuracy=EXACT,
            point_spread=False,
        )
        return image["red"].mean()

    value(scene.parameters)
    return value, scene, jax.grad(value)(scene.parameters)


def by(name, value, scene):
    where = PARTS[name]
    part = lambda v: eqx.tree_at(where, scene.parameters, v)  # noqa: E731
    return (lambda v: value(part(v))), where(scene.parameters)


@pytest.mark.parametrize("name", PARTS)
def test_a_part_of_the_parameters_compiles_nothing_large(red, name):
    value, scene, whole = red
    function, at = by(name, value, scene)
    with compilations() as compiled:
        seen, slope = jax.value_and_grad(function)(at)
    assert not IMAGE_PROGRAMS.intersection(compiled)
    # Where the number of plants moves, value and slope are those of the stand in expectation.
    moves = name in ("cover", "height")  # by the article's definition of cover
    stand = scene.expected() if moves else scene
    with compilations() as compiled:
        one = lambda x: float(value(eqx.tree_at(PARTS[name], scene.parameters, x), stand))  # noqa: E731
        difference = (one(1.00001 * at) - one(0.99999 * at)) / 2e-5
    assert not IMAGE_PROGRAMS.intersection(compiled)
    assert float(seen) == pytest.approx(one(at), rel=1e-12)
    assert float(jnp.sum(slope * at)) == pytest.approx(difference, rel=1e-5)
    if moves:
        np.testing.assert_allclose(slope, PARTS[name](whole), rtol=1e-12)


def test_another_metric_and_another_scene_of_the_parameters_compile_nothing_large(red):
    value, scene, whole = red
    with compilations() as compiled:
        factor = jax.grad(lambda x: value(None, scene.scaled({"species.*.cover": x})) ** 2)(1.0)
    assert not IMAGE_PROGRAMS.intersection(compiled)
    stand = float(value(scene.parameters, scene.expected()))
    by_cover = float(whole.species.cover @ scene.parameters.species.cover)
    assert float(factor) == pytest.approx(2.0 * stand * by_cover, rel=1e-9)


def test_a_second_gradient_compiles_nothing(red):
    value, scene, _ = red
    with compilations() as compiled:
        jax.grad(value)(scene.parameters)
    assert not compiled


def large(function, at):
    """Names of the large programs that a gradient compiles, and the gradient."""
    with compilations() as compiled:
        slope = jax.grad(function)(at)
    return IMAGE_PROGRAMS.intersection(compiled), slope


def test_pixels_of_another_size_compile_only_what_depends_on_them(red):
    value, scene, _ = red
    compiled, slope = large(lambda p: value(p, pixel=0.8), scene.parameters)
    assert compiled == {"jit(_measured)"}
    assert jnp.abs(slope.leaf.chlorophyll).max() > 0.0


TABLE = (
    {"growth_form": "rounded_shrub", "mean_diameter_cm": 40, "height_max_m": 0.6},
    {"growth_form": "tussock", "mean_diameter_cm": 30, "height_max_m": 0.5},
)


def planted(names, covers):
    """A plot of the table."""
    rows = [
        row | {"taxon": name, "cover_percent": cover}
        for row, name, cover in zip(TABLE, names, covers, strict=True)
    ]
    return fx.Scene.from_table(rows, size=1.6, voxel=0.4, structure="even")


def test_other_taxa_and_covers_compile_nothing_and_other_numbers_of_plants_their_voxels():
    def value(scene):
        return lambda p: fx.observe(scene, "mavic_3m", pixel=0.4, parameters=p)["red"].mean()

    bare = planted("cd", (28, 14))
    one, like, few = planted("ab", (30, 15)).padded(), bare.padded(), planted("ab", (3, 1)).padded()
    assert large(value(one), one.parameters)[0] == IMAGE_PROGRAMS
    compiled, slope = large(value(like), like.parameters)
    assert not compiled
    alone = jax.grad(value(bare))(bare.parameters)
    np.testing.assert_allclose(slope.species.cover, alone.species.cover, rtol=1e-4)
    assert like.taxa == ("c", "d")
    assert large(value(few), few.parameters)[0] == {"jit(_voxels_under)"}


@pytest.mark.parametrize("expected", [False, True])
def test_all_that_an_image_follows_from_is_kept(expected):
    scene = small_plot(voxel=0.4, flowering=0.5, rounding="up", softness=0.3, softness_plants=2.0)
    scene = scene.expected(expected)
    bands = BandSet(("nir",), (860.0,), (52.0,))
    voxels = (one.voxels(scene.parameters, bands) for one in (scene, scene.unnamed()))
    for one, other in zip(*map(jax.tree.leaves, voxels), strict=True):
        np.testing.assert_array_equal(one, other)


def test_forward_mode_agrees_and_has_one_program_for_all(red):
    value, scene, _ = red
    slopes = []
    for name in ("chlorophyll", "sun"):
        function, at = by(name, value, scene)
        with compilations() as compiled:
            slopes.append(jax.jvp(function, (at,), (jnp.ones_like(at),))[1])
        assert IMAGE_PROGRAMS.intersection(compiled) == (
            IMAGE_PROGRAMS if name == "chlorophyll" else set()
        )
        assert float(slopes[-1]) == pytest.approx(float(jnp.sum(jax.grad(function)(at))), rel=1e-8)


@pytest.mark.parametrize("definition", ["article", "projected"])
def test_what_moves_the_number_of_plants_is_known(definition):
    if definition == "article":  # leaning branches reach as far as they are high
        scene = small_plot(rotation_spread=[10.0] * 3)
    else:
        row = {"taxon": "Erica", "growth_form": "rounded_shrub", "mean_diameter_cm": 50.0}
        row |= {"cover_percent": 10.0, "height_max_m": 0.6}
        scene = fx.Scene.from_table([row], size=1.6, structure="even")
    none = jax.tree.map(lambda _: None, scene.parameters)
    slopes = jax.jacrev(lambda p: scene.counts(p).sum())(scene.parameters)
    for name, slope in vars(slopes.species).items():
        if slope is not None:
            change = eqx.tree_at(
                lambda p, name=name: getattr(p.species, name),
                none,
                slope,
                is_leaf=lambda x: x is None,
            )
            assert scene.counts_move(change) == bool(jnp.any(slope != 0.0)), name
    assert not dataclasses.replace(scene, known_plants=True).counts_move(slopes)


def test_nothing_stays_nothing_beside_an_infinite_slope():
    def function(x):
        return x.sum() + (jnp.inf * _nothing(jnp.ones((2, 2)), x)).sum()

    np.testing.assert_array_equal(jax.grad(function)(jnp.ones(3)), 1.0)
    zeros = _nothing(jnp.ones((2, 2)), jnp.asarray(3.0))
    np.testing.assert_array_equal(zeros, np.zeros((2, 2)))


def test_numbers_of_plants_keep_their_slope_beside_a_parameter(red):
    value, scene, _ = red
    number, at = scene.counts(scene.parameters), scene.parameters.leaf.chlorophyll

    def both(number, chlorophyll):
        plot = eqx.tree_at(PARTS["chlorophyll"], scene.parameters, chlorophyll)
        return value(plot, dataclasses.replace(scene, number=number))

    alone = jax.grad(lambda n: both(n, at))(number)
    assert jnp.abs(alone).min() > 0.0
    np.testing.assert_allclose(jax.grad(both, (0, 1))(number, at)[0], alone, rtol=1e-6)

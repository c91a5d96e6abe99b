"""Derivatives of images and fluxes against central differences, in double precision.

All outputs are contracted to one number with fixed weights. The solve is tightened until its own
error is far below that of the differences.
"""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from fynjax.radiation import (
    Accuracy,
    RahmanPintyVerstraete,
    directional_reflectance,
    fluxes,
    nadir_rays,
    reflectance_factor,
    solve_light,
)
from tests.radiation.scenes import patchy

ACCURACY = Accuracy(levels=2, refine=False, margin=6, tolerance=1e-12, iterations=400)
RAYS = nadir_rays(jnp.linspace(0.05, 0.75, 7), jnp.linspace(0.05, 0.55, 5), 0.05, (0.4, 0.3, 5.0))
IMAGE_WEIGHTS = np.random.default_rng(1).normal(size=(2, 5, 7))


def outcome(scene):
    """The fluxes, and an image or (of periodic scenes) a distant view, as one number."""
    light = solve_light(scene, ACCURACY)
    flux = fluxes(light)
    if scene.boundary == "periodic":
        view = directional_reflectance(light, jnp.array([40.0]), jnp.array([100.0]))
        seen = view[0] @ jnp.array([20.0, -15.0])
    else:
        seen = jnp.sum(IMAGE_WEIGHTS * reflectance_factor(light, RAYS))
    return (
        seen
        + flux.albedo @ jnp.array([1.0, -2.0])
        + jnp.sum(flux.absorbed * jnp.arange(6.0).reshape(2, 3))
        + flux.transmitted @ jnp.array([0.3, 0.7])
    )


both = jax.jit(jax.value_and_grad(outcome))
push = jax.jit(lambda at, along: jax.jvp(outcome, (at,), (along,))[1])


def value(scene):
    return both(scene)[0]


def slope(scene):
    return both(scene)[1]


def with_options(boundary):
    """Leaves of finite size; a sky and a ground with patterns, or hills."""
    scene = patchy(boundary)
    classes = dataclasses.replace(
        scene.classes, leaf_diameter=jnp.array([0.04, 0.08]), size_of_class=(0, 1, 0)
    )
    scene = dataclasses.replace(scene, classes=classes)
    rng = np.random.default_rng(5)
    if boundary == "open":
        x, y = np.meshgrid(np.arange(8), np.arange(6))
        hills = 0.12 + 0.03 * np.sin(0.9 * x + 0.4) * np.cos(0.7 * y)
        return dataclasses.replace(scene, terrain=jnp.asarray(hills))
    light = dataclasses.replace(
        scene.illumination, sky_pattern=jnp.asarray(rng.uniform(0.5, 2.0, (2, 4, 8)))
    )
    shape = RahmanPintyVerstraete(
        jnp.array([0.8, 1.1]), jnp.array([-0.1, 0.05]), jnp.array([0.3, 0.9])
    )
    return dataclasses.replace(scene, illumination=light, ground_shape=shape)


@pytest.mark.study
def test_derivatives_at_the_default_tolerance():
    """Of the refined solve, whose parts are loose: forward and backward, against a tight one."""
    scene = patchy(shape=(4, 8, 8))
    # Area moved from voxel to voxel, much of it within the cells of the coarse grid.
    step = jnp.asarray(np.random.default_rng(3).normal(size=scene.area_density.shape))
    along = eqx.tree_at(
        lambda s: s.area_density,
        jax.tree.map(jnp.zeros_like, scene),
        (step - step.mean()) * scene.area_density,
    )
    found = []
    for accuracy in (Accuracy(levels=2), Accuracy(levels=2, tolerance=1e-11, iterations=400)):

        def albedo(scene, accuracy=accuracy):
            return fluxes(solve_light(scene, accuracy)).albedo @ jnp.array([1.0, 2.0])

        value, forward = jax.jit(lambda at, d: jax.jvp(albedo, (at,), (d,)))(scene, along)
        back = jax.jit(jax.grad(albedo))(scene)
        backward = sum(
            jnp.sum(a * b) for a, b in zip(jax.tree.leaves(back), jax.tree.leaves(along))
        )
        found.append((float(value), float(forward), float(backward)))
    print(found)
    for got, want, near in zip(*found, (1e-4, 2e-3, 2e-3)):
        assert got == pytest.approx(want, rel=near)


@pytest.fixture(scope="module", params=["periodic", pytest.param("open", marks=pytest.mark.study)])
def scene(request):
    return with_options(request.param)


@pytest.fixture(scope="module")
def gradient(scene):
    return slope(scene)


def directions(scene):
    rng = np.random.default_rng(2)

    def noise(shape):
        return jnp.asarray(rng.normal(size=shape))

    return {
        # Proportional to the density: a step must not make an empty voxel negative.
        "density": (lambda s: s.area_density, noise(scene.area_density.shape) * scene.area_density),
        "reflectance": (lambda s: s.classes.reflectance, noise((3, 2))),
        "transmittance": (lambda s: s.classes.transmittance, noise((3, 2))),
        "soil map": (lambda s: s.ground, noise((2, 6, 8))),
        "sun zenith": (lambda s: s.illumination.sun_zenith, jnp.array(1.0)),
        "sun azimuth": (lambda s: s.illumination.sun_azimuth, jnp.array(1.0)),
        "sun": (lambda s: s.illumination.sun, jnp.array([0.3, -0.5])),
        "sky": (lambda s: s.illumination.sky, jnp.array([0.3, -0.5])),
        "leaf angles": (lambda s: s.classes.angles[0].second, jnp.array(1.0)),
    }


@pytest.mark.parametrize("what", directions(patchy()))
def test_derivative_along(what, scene, gradient):
    select, step = directions(scene)[what]
    along = eqx.tree_at(select, jax.tree.map(jnp.zeros_like, scene), step)
    h = 1e-5
    forth = jax.tree.map(lambda a, d: a + h * d, scene, along)
    back = jax.tree.map(lambda a, d: a - h * d, scene, along)
    difference = float(value(forth) - value(back)) / (2 * h)
    backward = float(jnp.sum(select(gradient) * step))
    assert backward == pytest.approx(difference, rel=1e-6)


def test_derivative_along_what_a_scene_may_have(scene, gradient):
    rng = np.random.default_rng(6)
    options = {"leaf diameter": lambda s: s.classes.leaf_diameter}
    if scene.terrain is not None:
        options["terrain"] = lambda s: s.terrain
    else:
        options["sky pattern"] = lambda s: s.illumination.sky_pattern
        for name in ("k", "theta", "rho_c"):
            options[name] = lambda s, name=name: getattr(s.ground_shape, name)
    for what, select in options.items():
        step = jnp.asarray(rng.normal(size=select(scene).shape)) * 0.1
        h = 1e-5
        values = [
            float(value(eqx.tree_at(select, scene, select(scene) + k * h * step))) for k in (1, -1)
        ]
        difference = (values[0] - values[1]) / (2 * h)
        assert abs(difference) > 1e-6, what
        got = float(jnp.sum(select(gradient) * step))
        assert got == pytest.approx(difference, rel=1e-5), what


@pytest.mark.study
@pytest.mark.parametrize("scene", ["open"], indirect=True)
@pytest.mark.parametrize("what", directions(patchy()))
def test_forward_mode_agrees_with_reverse(what, scene, gradient):
    select, step = directions(scene)[what]
    along = eqx.tree_at(select, jax.tree.map(jnp.zeros_like, scene), step)
    assert float(push(scene, along)) == pytest.approx(
        float(jnp.sum(select(gradient) * step)), rel=1e-8
    )


def test_derivative_where_nothing_grows(scene, gradient):
    """The slope at density zero is the one-sided difference, not zero and not undefined."""
    rng = np.random.default_rng(4)
    empty = np.asarray(scene.area_density) == 0
    step = jnp.asarray(rng.normal(size=empty.shape) ** 2 * empty)
    assert empty.mean() > 0.3
    h = 1e-4
    values = [
        float(
            value(eqx.tree_at(lambda s: s.area_density, scene, scene.area_density + k * h * step))
        )
        for k in range(4)
    ]
    difference = (-11 * values[0] + 18 * values[1] - 9 * values[2] + 2 * values[3]) / (6 * h)
    assert float(jnp.sum(gradient.area_density * step)) == pytest.approx(difference, rel=1e-6)


EDGES = {
    "an empty scene": (lambda s: s.area_density, lambda a: 0 * a),
    "black leaves": (lambda s: (s.classes.reflectance, s.classes.transmittance), lambda a: 0 * a),
    "leaves that lose nothing": (
        lambda s: (s.classes.reflectance, s.classes.transmittance),
        lambda a: 0 * a + 0.5,
    ),
    "black ground": (lambda s: s.ground, lambda a: 0 * a),
    "black sky": (lambda s: s.illumination.sky, lambda a: 0 * a),
    "no sun": (lambda s: s.illumination.sun, lambda a: 0 * a),
    "sun overhead": (lambda s: s.illumination.sun_zenith, lambda a: 0 * a),
    "an impenetrable thicket": (lambda s: s.area_density, lambda a: 1e3 * a),
}


@pytest.mark.parametrize("what", EDGES)
def test_finite_at_the_edge(what, scene):
    select, edge = EDGES[what]
    at = eqx.tree_at(select, scene, jax.tree.map(edge, select(scene)))
    assert np.isfinite(value(at))
    for leaf in jax.tree.leaves(slope(at)):
        assert np.all(np.isfinite(leaf))


@pytest.mark.study
def test_the_memory_of_a_gradient_is_some_twice_that_of_its_image():
    """In refined light: what the compiled programs say that they need."""
    scene = patchy(shape=(16, 48, 48))
    rays = nadir_rays(
        jnp.linspace(0.1, 4.7, 64), jnp.linspace(0.1, 4.7, 64), 0.07, (2.0, 2.0, 50.0)
    )

    def mean(density):
        at = dataclasses.replace(scene, area_density=density)
        return jnp.mean(reflectance_factor(solve_light(at), rays))

    image, gradient = (
        jax.jit(of).lower(scene.area_density).compile().memory_analysis().temp_size_in_bytes
        for of in (mean, jax.value_and_grad(mean))
    )
    assert gradient < 2.5 * image  # 2.1 measured, 2.9 without recomputing the finer fields

"""Leaves of finite size: what they change of the light scattered once, near the sun's direction."""

import json

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from fynjax._core.geometry import direction
from fynjax.canopy import leaf_angle
from fynjax.radiation import Accuracy, nadir_rays, parallel_rays, render
from fynjax.radiation._hotspot import overlaps
from tests import reference
from tests.radiation.scenes import (
    FINE,
    patchy,
    reflectance_of,
    slab,
    solver,
    spherical_gamma,
    views_of_reference,
)
from tests.radiation.test_monte_carlo import clumps
from tests.radiation.test_monte_carlo_reference import SIGMA, with_fields

DARK = (4e-3, 1e-3)
ACCURACY = Accuracy(
    sublayers=2, coarsening=(1, 1), levels=2, azimuths=4, tolerance=1e-12, iterations=400
)


def leafy(lai, optics, zenith, diameter, height=1.0, **options):
    """A slab of `height` metres with the sun in the west (270 degrees)."""
    scene = slab(lai / height, optics, zenith, **options)
    size = None if diameter is None else jnp.array([diameter])
    scene = with_fields(scene, classes__leaf_diameter=size)
    return with_fields(scene, vertical=scene.vertical * height)


def seen(scene, zenith, azimuth, accuracy=FINE):
    """Reflectance, [view, band]; as many views as in the largest case, to compile it once."""
    views = (jnp.resize(jnp.asarray(a, float), 11) for a in (zenith, azimuth))
    return np.asarray(reflectance_of(solver(accuracy)(scene), *views))[: len(zenith)]


@pytest.mark.parametrize("index", [0, 1], ids=["near infrared, sun at 20", "red, sun at 50"])
def test_disc_slab_of_a_path_tracer(shared_data, index):
    """240,000 leaves traced one by one by the Eradiate kernel (0.2-0.7 % noise, one layout)."""
    with open(shared_data / "rt" / "disc_canopies.json", encoding="utf-8") as file:
        case = json.load(file)["cases"][index]
    optics = tuple(case["optics"][name] for name in ("rho", "tau", "soil"))
    scene = leafy(3.0, [optics], case["sza"], 0.1, height=2.0)
    zenith, azimuth = views_of_reference([(v, 0) for v in case["vz"]])
    off = seen(scene, zenith, azimuth)[:, 0] / np.array(case["brf"]) - 1
    print("off %", np.round(100 * off, 2))
    assert np.abs(off).max() < 0.03
    assert abs(off[case["vz"].index(0)]) < 0.015
    # Without leaf size the backward side is far too dark: the data do tell the two apart.
    turbid = seen(with_fields(scene, classes__leaf_diameter=None), zenith, azimuth)[:, 0]
    assert (turbid / np.array(case["brf"]) - 1).min() < -0.08


@pytest.mark.parametrize("diameter", [1e-3, 0.1, 3.0])
@pytest.mark.parametrize("name", ["spherical", "planophile", "erectophile"])
def test_along_the_sun_the_gap_counts_once(name, diameter):
    """What the sun reaches the sensor sees, whatever the size of leaves: the soil through the gap
    exp(-k L), and (1 - exp(-k L)) / k of leaf area in place of that with 2 k."""
    lai, zenith, soil = 2.0, 30.0, 0.2
    angle = leaf_angle(name)
    cosine = np.cos(np.deg2rad(zenith))
    k = float(angle.projection(jnp.array(cosine))) / cosine
    scene = leafy(lai, [(0.0, 0.0, soil)], zenith, diameter, angle=angle)
    got = seen(scene, [zenith], [270.0])[0, 0]
    np.testing.assert_allclose(got, soil * np.exp(-k * lai), rtol=2e-3)
    if name == "spherical":
        scene = leafy(lai, [(*DARK, 0.0)], zenith, diameter)
        got = seen(scene, [zenith], [270.0])[0, 0]
        want = spherical_gamma(np.pi, *DARK) / cosine**2 * -np.expm1(-k * lai) / k
        np.testing.assert_allclose(got, want, rtol=4e-3)  # of it 0.3 % scattered twice


def test_far_from_the_sun_small_leaves_are_points():
    """And none at all, or points, are the same everywhere."""
    optics = [(0.1, 0.05, 0.2)]
    zenith, azimuth = [0.0, 30.0, 35.0, 60.0], [0.0, 90.0, 250.0, 180.0]
    turbid, points, small, large = (
        seen(leafy(2.0, optics, 30.0, d), zenith, azimuth) for d in (None, 0.0, 1e-3, 0.2)
    )
    np.testing.assert_allclose(points, turbid, rtol=1e-4)
    np.testing.assert_allclose(small, turbid, rtol=0.02)
    assert np.all(large > turbid * 1.01)
    # Above the hot spot's peak nothing goes: it is the same for leaves of any size.
    assert np.all(large < seen(leafy(2.0, optics, 30.0, 1e3), zenith, azimuth))


def test_each_class_has_its_own_leaf_size():
    """Two equal classes of two sizes: each size alone is met if only its class is there."""
    scene = patchy()
    two = with_fields(
        scene, classes__leaf_diameter=jnp.array([0.2, 0.03]), classes__size_of_class=(0, 1, 0)
    )
    view = [40.0], [60.0]
    for only, diameter in ((0, 0.2), (1, 0.03), (2, 0.2)):
        alone = jnp.zeros_like(scene.area_density).at[only].set(scene.area_density[only])
        one = with_fields(scene, classes__leaf_diameter=jnp.array([diameter]), area_density=alone)
        got = seen(with_fields(two, area_density=alone), *view, ACCURACY)
        np.testing.assert_allclose(got, seen(one, *view, ACCURACY), rtol=1e-9)
    both = seen(two, *view, ACCURACY)
    sizes = [
        seen(with_fields(scene, classes__leaf_diameter=jnp.array([d])), *view, ACCURACY)
        for d in (0.03, 0.2)
    ]
    assert np.all((sizes[0] < both) & (both < sizes[1]))


def blocked_by_both(angle, sun, view, diameter, height, count=400_000, seed=0):
    """Leaf area that blocks both of two rays from a point up to `height`, per leaf area per volume
    [m]: discs are thrown at the sun's ray, and those that the other ray meets too are counted."""
    random = np.random.default_rng(seed)
    normals, weight = (np.asarray(a) for a in angle.normals())
    normal = normals[random.choice(len(weight), size=count, p=weight / weight.sum())]
    to_sun, to_view = normal @ sun, normal @ view
    # A disc's centre from where its plane meets the sun's ray, along two axes in the plane.
    level = height * random.uniform(size=count)
    met = sun * (level / sun[2])[:, None]
    one = np.cross(normal, [0.6, 0.0, 0.8])
    one /= np.linalg.norm(one, axis=1, keepdims=True)
    two = np.cross(normal, one)
    away = 0.5 * diameter * np.sqrt(random.uniform(size=count))
    turn = 2.0 * np.pi * random.uniform(size=count)
    centre = met + away[:, None] * (np.cos(turn)[:, None] * one + np.sin(turn)[:, None] * two)
    same_side = to_sun * to_view > 0
    reach = np.sum(normal * centre, axis=1) / np.where(same_side, to_view, 1.0)
    distance = np.linalg.norm(view * reach[:, None] - centre, axis=1)
    hit = same_side & (distance < 0.5 * diameter) & (reach * view[2] < height)
    # Discs met per length of the ray: their area per volume times the cosine to their normal.
    return height / sun[2] * np.mean(np.abs(to_sun) * hit)


@pytest.mark.parametrize("height", [0.3, 5.0])
@pytest.mark.parametrize(("zenith", "azimuth"), [(38.0, 270.0), (30.0, 290.0)])
@pytest.mark.parametrize("name", ["spherical", "planophile"])
def test_the_overlap_of_discs_is_that_of_discs_thrown_at_random(name, zenith, azimuth, height):
    """Leaf area common to both rays, near the sun's direction: in a canopy lower than the overlap
    reaches, and in one so high that all of it counts."""
    diameter, angle = 0.1, leaf_angle(name)
    sun, view = (
        np.asarray(direction(*map(jnp.asarray, at))) for at in ((30.0, 270.0), (zenith, azimuth))
    )
    classes = slab(1.0, [(0.1, 0.1, 0.1)], 30.0, angle=angle).classes
    classes = with_fields(classes, leaf_diameter=jnp.array([diameter]))
    rays = parallel_rays(jnp.zeros(1), jnp.zeros(1), 0.01, zenith, azimuth)
    (overlap,) = overlaps(classes, rays, jnp.asarray(sun), height)
    common = overlap.at_points(overlap.start((1, 1)), jnp.ones((1, 1)))[-1]
    want = blocked_by_both(angle, sun, view, diameter, height)
    assert float(common[0, 0]) == pytest.approx(want, rel=0.04)


@pytest.mark.study
def test_a_frame_camera_sees_its_own_hot_spot():
    """Over a uniform slab each pixel is the distant view from its own direction."""
    scene = leafy(2.0, [(0.1, 0.05, 0.2)], 30.0, 0.1)
    light = solver(FINE)(scene)
    slopes = -np.tan(np.deg2rad(30.0)) * np.array([0.0, 0.5, 0.9, 1.0, 1.1, 1.5])
    altitude = 4.0
    rays = nadir_rays(jnp.asarray(-altitude * slopes[::-1]), jnp.zeros(1), 0.01, (0.0, 0.0, 4.0))
    image = render(light, rays)
    both = np.asarray(image.sunlit_leaves + image.ground)[0, 0, ::-1]
    one = [
        render(
            light,
            parallel_rays(jnp.zeros(1), jnp.zeros(1), 0.01, np.rad2deg(np.arctan(-slope)), 270.0),
        )
        for slope in slopes
    ]
    want = np.array([float((r.sunlit_leaves + r.ground)[0, 0, 0]) for r in one])
    np.testing.assert_allclose(both, want, rtol=3e-3)
    assert want.argmax() == 3


@pytest.mark.study
@pytest.mark.slow
@pytest.mark.parametrize(
    "name", ["planophile", pytest.param("erectophile", marks=pytest.mark.study)]
)
def test_clumps_of_discs(name):
    """Leaves of 6 cm in clumps of 30 cm, traced one by one. Layouts differ, so the noise is that
    of their mean; the turbid solver and its voxels leave 1 %, hot spot included."""
    scene = clumps(name, name)
    size = jnp.array([0.06])
    scene = with_fields(scene, classes__leaf_diameter=size)
    zenith, azimuth = np.array([40.0, 30.0, 40.0, 0.0, 45.0]), np.array([65.0, 65, 90, 0, 245])
    layouts = np.array(
        [
            [
                reference.disc_reflectance(
                    scene,
                    reference.discs(scene, s),
                    zenith,
                    azimuth,
                    photons=20_000,
                    seed=s,
                    band=band,
                ).mean
                for band in range(2)
            ]
            for s in range(12)
        ]
    )
    want, error = layouts.mean(axis=0).T, layouts.std(axis=0, ddof=1).T / np.sqrt(len(layouts))
    fine = with_fields(clumps(name, name, parts=4), classes__leaf_diameter=size)
    accuracy = Accuracy(lattice=2, sublayers=4, coarsening=(2, 2), levels=4, azimuths=12)
    got = seen(fine, zenith, azimuth, accuracy)
    print("off %", np.round(100 * (got / want - 1), 2), "noise %", np.round(100 * error / want, 2))
    assert np.all(np.abs(got - want) < SIGMA * error + 0.02 * want)


WEIGHTS = jnp.asarray(np.random.default_rng(3).normal(size=(3, 2)))


def outcome(at):
    """Three views near the sun as one number."""
    scene, zenith, azimuth = at
    light = solver(ACCURACY)(scene)
    return jnp.sum(WEIGHTS * reflectance_of(light, zenith, azimuth))


value, slope = jax.jit(outcome), jax.jit(jax.grad(outcome))


def near_the_sun(zenith, azimuth):
    scene = with_fields(
        patchy(), classes__leaf_diameter=jnp.array([0.05, 0.12]), classes__size_of_class=(0, 1, 0)
    )
    return scene, jnp.array(zenith), jnp.array(azimuth)


VARIABLES = {
    "leaf diameter": (lambda a: a[0].classes.leaf_diameter, jnp.array([0.02, -0.05])),
    "density": (lambda a: a[0].area_density, None),
    "sun zenith": (lambda a: a[0].illumination.sun_zenith, jnp.array(1.0)),
    "sun azimuth": (lambda a: a[0].illumination.sun_azimuth, jnp.array(1.0)),
    "view zenith": (lambda a: a[1], jnp.array([1.0, -2.0, 1.5])),
    "view azimuth": (lambda a: a[2], jnp.array([1.0, -2.0, 1.5])),
    "leaf angles": (lambda a: a[0].classes.angles[0].second, jnp.array(1.0)),
}


@pytest.mark.study
@pytest.mark.parametrize("what", VARIABLES)
def test_derivative(what):
    at = near_the_sun([36.0, 20.0, 50.0], [60.0, 40.0, 200.0])
    select, step = VARIABLES[what]
    step = 0.5 * select(at) if step is None else step
    along = eqx.tree_at(select, jax.tree.map(jnp.zeros_like, at), step)
    h = 1e-5
    forth, back = (jax.tree.map(lambda a, d, s=s: a + s * h * d, at, along) for s in (1, -1))
    difference = float(value(forth) - value(back)) / (2 * h)
    assert float(jnp.sum(select(slope(at)) * step)) == pytest.approx(difference, rel=1e-6)


@pytest.mark.study
@pytest.mark.parametrize("diameter", [0.05, 0.0])
def test_finite_in_the_hot_spot(diameter):
    """There the peak has no slope of its own, but no number is undefined; and the peak does not
    depend on the size of leaves."""
    at = near_the_sun([33.0] * 3, [50.0] * 3)
    at = (with_fields(at[0], classes__leaf_diameter=jnp.full(2, diameter, float)), *at[1:])
    gradient = slope(at)
    for leaf in jax.tree.leaves(gradient):
        assert np.all(np.isfinite(leaf))
    np.testing.assert_allclose(gradient[0].classes.leaf_diameter, 0.0, atol=1e-9)


@pytest.mark.study
def test_finite_with_sun_and_view_overhead():
    at = near_the_sun([0.0] * 3, [0.0] * 3)
    at = (with_fields(at[0], illumination__sun_zenith=jnp.array(0.0)), *at[1:])
    for leaf in jax.tree.leaves(slope(at)):
        assert np.all(np.isfinite(leaf))

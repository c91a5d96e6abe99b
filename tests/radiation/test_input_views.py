"""Options, views, cameras and tiles that cannot be are refused with a sentence that says why."""

import math
import re

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from fynjax._core.errors import InputError
from fynjax.radiation import (
    Accuracy,
    Light,
    directional_reflectance,
    nadir_rays,
    parallel_rays,
    perspective_rays,
    reflectance_factor,
    render,
)
from tests.radiation.scenes import patchy
from tests.radiation.test_input import centres, plain

pytestmark = pytest.mark.untyped
ACCURACIES = {
    **dict.fromkeys(
        ("lattice", "levels", "azimuths", "iterations", "solves", "sublayers"),
        (0, -1, 1.5, math.nan, "2", True),
    ),
    "margin": (-1, 0.5),
    "coarsening": (0, 2, (2, 0), (0, 2), (2, 1.5), (2,), [2, 2]),
    "tolerance": (0.0, -1e-4, 1.0, math.nan, math.inf, "small", None),
    "refine": ("no", None, 0),
    "cell": (0.0, -0.1, math.nan, math.inf, "small", None),
}


@pytest.mark.parametrize(
    ("name", "value"), [(name, value) for name, values in ACCURACIES.items() for value in values]
)
def test_accuracy_refused(name, value):
    with pytest.raises(InputError, match=rf"`accuracy.{name}` must be .* but is "):
        Accuracy(**{name: value})


def test_accuracy_accepted():
    Accuracy(1, 1, (1, 1), 1, 1, 1e-12, 1, False, 1, 0, 0.5)
    Accuracy(solves=None, sublayers=None, coarsening=None, margin=None)


def unlit(boundary="periodic"):
    """A light whose inputs can be refused: nothing is solved."""
    return Light(patchy(boundary), None, None, Accuracy())


VIEWS = {
    "on the horizon": (
        90.0,
        0.0,
        r"`view_zenith` must be finite and in \[0, 90\).* 90.* elevation",
    ),
    "from below": (120.0, 0.0, r"`view_zenith` must be finite and in \[0, 90\)"),
    "signed": (-20.0, 0.0, r"`view_zenith` must be finite and in \[0, 90\)"),
    "without zenith": (math.nan, 0.0, "`view_zenith` must be finite"),
    "without azimuth": (10.0, math.nan, "`view_azimuth` must be finite"),
    "endless": (10.0, math.inf, "`view_azimuth` must be finite"),
    "text": ("10", 0.0, "`view_zenith` must be a number"),
    "none": (10.0, None, "`view_azimuth` must be a number"),
}


@pytest.mark.parametrize("name", VIEWS)
def test_views_refused(name):
    zenith, azimuth, message = VIEWS[name]
    with pytest.raises(InputError, match=message):
        directional_reflectance(unlit(), [zenith], [azimuth])
    with pytest.raises(InputError, match=message):
        parallel_rays(centres(2), centres(3), 0.1, zenith, azimuth)


@pytest.mark.parametrize(
    ("zenith", "azimuth"),
    [(np.zeros(2), np.zeros(3)), (np.zeros(1), np.zeros(3)), (np.zeros((2, 2)), np.zeros((2, 2)))],
)
def test_views_that_do_not_pair(zenith, azimuth):
    message = rf"lists of equal length.*{re.escape(f'{zenith.shape} and {azimuth.shape}')}"
    with pytest.raises(InputError, match=message):
        directional_reflectance(unlit(), zenith, azimuth)
    with pytest.raises(InputError, match=message):  # shapes are known under jit too
        jax.eval_shape(lambda z, a: directional_reflectance(unlit(), z, a), zenith, azimuth)
    with pytest.raises(InputError, match=r"`view_zenith` .*one view"):
        parallel_rays(centres(2), centres(3), 0.1, zenith, 0.0)


ANY = np.array([1, 3])


@pytest.mark.parametrize("given", [ANY, list(ANY), tuple(ANY), jnp.asarray(ANY), ANY.astype("f4")])
def test_rays_of_any_numbers(given):
    """Whole numbers and lists are the same places as their floating array."""
    floats = jnp.asarray(ANY, float)
    for make in (
        lambda x: parallel_rays(x, x, 1, 30, 100),
        lambda x: nadir_rays(x, x, 1, (2, 2, 5)),
    ):
        got, want = jax.tree.leaves(make(given)), jax.tree.leaves(make(floats))
        for a, b in zip(got, want, strict=True):
            assert jnp.issubdtype(a.dtype, jnp.floating)
            np.testing.assert_allclose(a, b, rtol=1e-6)
    slope = math.tan(math.radians(30.0))
    east = parallel_rays(given, given, 1, 30, 90).slope_x
    np.testing.assert_allclose(east, [slope, slope], rtol=1e-6)


def test_rays_stay_traceable():
    """Values are not checked where they are traced: zenith 100 passes, as it must."""
    x = jnp.asarray(centres(2))
    slopes = jax.vmap(lambda z, a: parallel_rays(x, x, 0.1, z, a).slope_x)
    assert slopes(jnp.array([0.0, 100.0]), jnp.zeros(2)).shape == (2, 2)
    moved = jax.jit(lambda place: nadir_rays(x, x, 0.1, (place, place, 5.0)).slope_x)(0.2)
    np.testing.assert_allclose(moved, (0.2 - x) / 5.0)
    # What is known stays known within a transformation.
    with pytest.raises(InputError, match="must be finite and in"):
        jax.jit(lambda z: parallel_rays(x, x, 0.1, 95.0, z))(0.0)
    still = jax.jit(lambda d: plain(area_density=d).area_density + frame().x.sum())
    assert still(np.ones((1, 2, 3, 4))).shape == (1, 2, 3, 4)


X = centres(2)


@pytest.mark.parametrize(
    ("x", "y", "footprint", "message"),
    [
        ([], X, 0.1, r"`x` must be a list of the centres of pixels .* shape \(0,\)"),
        (X, 0.5, 0.1, r"`y` must be a list of the centres of pixels .* shape \(\)"),
        (X[None], X, 0.1, "`x` must be a list of the centres"),
        ([0.1, math.nan], X, 0.1, r"`x \[m\]` must be finite, .* nan at index \(1,\)"),
        ("12", X, 0.1, "`x` must be a number or"),
        (X, X, 0.0, "`footprint` must be a positive length in m, but is 0"),
        (X, X, -0.1, "`footprint` must be a positive length in m, but is -0.1"),
        (X, X, math.nan, "`footprint` must be a positive length in m, but is nan"),
        (X, X, [0.1, 0.1], "`footprint` must be a single number"),
    ],
)
def test_pixels_refused(x, y, footprint, message):
    for make in (
        lambda: parallel_rays(x, y, footprint, 10.0, 20.0),
        lambda: nadir_rays(x, y, footprint, (0.0, 0.0, 5.0)),
    ):
        with pytest.raises(InputError, match=message):
            make()


def frame(camera=(0.0, 0.0, 5.0), target=(0.1, 0.0, 0.0), **options):
    arguments = {"rows": 2, "columns": 3, "field_of_view": 20.0} | options
    return perspective_rays(camera, target, **arguments)


@pytest.mark.parametrize(
    ("camera", "message"),
    [
        ((0.0, 5.0), r"`camera` must be 3 numbers, but has shape \(2,\): it is \(x, y, altitude\)"),
        (5.0, r"`camera` must be 3 numbers, but has shape \(\)"),
        ((math.nan, 0.0, 5.0), "`camera .* must be finite"),
        ((0.0, math.inf, 5.0), "`camera .* must be finite"),
        ((0.0, 0.0, -5.0), "`camera` must be .*above the ground"),
        ((0.0, 0.0, math.nan), "`camera` must be .*above the ground"),
        (("a", "b", "c"), "`camera` must be a number or"),
    ],
)
def test_cameras_refused(camera, message):
    for make in (lambda: nadir_rays(X, X, 0.1, camera), lambda: frame(camera)):
        with pytest.raises(InputError, match=message):
            make()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({name: value}, f"`{name}` must be a whole number of at least 1, but is {value}")
        for name in ("rows", "columns")
        for value in (0, -2, 2.5)
    ]
    + [
        ({"target": (0.0, 1.0)}, r"`target` must be 3 numbers, but has shape \(2,\)"),
        ({"target": (0.0, 1.0, math.nan)}, "other than `camera`.*nan"),
        ({"field_of_view": math.nan}, "`field_of_view` must be in"),
        ({"field_of_view": "wide"}, "`field_of_view` must be a number"),
    ],
)
def test_frames_refused(options, message):
    with pytest.raises(InputError, match=message):
        frame(**options)


def test_the_lowest_sight_line_decides_on_the_horizon():
    """The upper corners must look down by 1.15 degrees (a sine of 0.02): 1.2 pass, 0.9 do not."""
    half = math.radians(20.0)
    tall = 2 * math.degrees(math.atan(math.tan(half) / 100))  # 200 square pixels, 2 columns

    def towards(depression):
        aim = (0.0, math.cos(depression), 5.0 - math.sin(depression))
        return frame(target=aim, rows=200, columns=2, field_of_view=tall)

    lowest = math.degrees(math.asin(float(towards(half + math.radians(1.2)).cosine.min())))
    assert 1.15 < lowest < 1.5
    with pytest.raises(InputError, match="horizon"):
        towards(half + math.radians(0.9))


OVER = parallel_rays(X, X, 0.1, 10.0, 40.0)


@pytest.mark.parametrize("chunk", [0, -1, 1.5])
def test_chunks_refused(chunk):
    for show in (render, reflectance_factor):
        with pytest.raises(InputError, match=r"`chunk`.* 1"):
            show(unlit(), OVER, chunk=chunk)


def test_a_camera_in_the_canopy_is_refused():
    with pytest.raises(InputError, match=r"0\.4 m .*0\.15 m"):
        reflectance_factor(unlit(), nadir_rays(X, X, 0.1, (0.1, 0.1, 0.15)))

"""What cannot be rendered is refused with a sentence that says why."""

import dataclasses
import math
import re

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from fynjax._core.errors import InputError
from fynjax.radiation import (
    Accuracy,
    OpticalClasses,
    RahmanPintyVerstraete,
    nadir_rays,
    parallel_rays,
    reflectance_factor,
    render,
    solve_light,
    voxel_scene,
)
from fynjax.radiation._check import check_scene
from fynjax.radiation._render import check_fit
from tests.radiation.scenes import patchy, solver

pytestmark = pytest.mark.untyped


def change(select, value, boundary="periodic"):
    return eqx.tree_at(select, patchy(boundary), value)


def with_static(**fields):
    scene = patchy()
    return type(scene)(
        **{name: fields.get(name, getattr(scene, name)) for name in scene.__dataclass_fields__}
    )


def with_owners(*owners):
    """The scene whose classes have other owners of their leaf angles (and leaf diameters)."""
    classes = patchy().classes
    return with_static(
        classes=OpticalClasses(classes.reflectance, classes.transmittance, classes.angles, *owners)
    )


def with_pattern(pattern):
    return dataclasses.replace(patchy().illumination, sky_pattern=pattern)


def rahman(k=0.9, theta=-0.1, rho_c=0.3):
    return RahmanPintyVerstraete(*([value, value] for value in (k, theta, rho_c)))


DENSITY = patchy().area_density
CASES = {
    "negative density": (
        lambda: change(lambda s: s.area_density, DENSITY.at[1, 2, 3, 4].set(-0.5)),
        r"area_density \[m2 m-3\]` must be finite and in \[0, inf\], but 1 values are not; "
        r"the first is -0.5 at index \(1, 2, 3, 4\)",
    ),
    "density not a number": (
        lambda: change(lambda s: s.area_density, DENSITY.at[0, 0, 0, 1].set(jnp.nan)),
        r"must be finite .* nan at index \(0, 0, 0, 1\)",
    ),
    "density infinite": (
        lambda: change(lambda s: s.area_density, DENSITY.at[0, 0, 0, 1].set(jnp.inf)),
        "must be finite",
    ),
    "density without classes": (
        lambda: change(lambda s: s.area_density, DENSITY[0]),
        r"axes \[class, z, y, x\]",
    ),
    "one class too few": (
        lambda: change(lambda s: s.area_density, DENSITY[:2]),
        r"classes.reflectance` must have shape \(class, band\) = \(2, 2\).*has \(3, 2\)",
    ),
    "transmittance of other bands": (
        lambda: change(lambda s: s.classes.transmittance, jnp.zeros((3, 4))),
        r"classes.transmittance` must have shape .*\(3, 2\).*has \(3, 4\)",
    ),
    "owners missing": (
        lambda: with_owners((0, 1)),
        r"angle_of_class` must have .* for each of the 3 classes, but is \(0, 1\)",
    ),
    "owner beyond the end": (
        lambda: with_owners((0, 1, 2)),
        r"angle_of_class` must have one of the places 0 to 1 for each .* but is \(0, 1, 2\)",
    ),
    "leaves that gain": (
        lambda: change(lambda s: s.classes.reflectance, jnp.full((3, 2), 0.9)),
        "must not exceed 1, but reaches 1.275.*in percent",
    ),
    "reflectance in percent": (
        lambda: change(lambda s: s.classes.reflectance, jnp.full((3, 2), 45.0)),
        r"classes.reflectance` must be finite and in \[0, 1\]",
    ),
    "negative transmittance": (
        lambda: change(lambda s: s.classes.transmittance, jnp.full((3, 2), -0.1)),
        r"classes.transmittance` must be finite and in \[0, 1\]",
    ),
    "soil in percent": (
        lambda: change(lambda s: s.ground, jnp.array([20.0, 30.0])),
        r"ground` must be finite and in \[0, 1\]",
    ),
    "soil of other bands": (
        lambda: change(lambda s: s.ground, jnp.ones(3)),
        r"ground` must have shape \(band,\) or \(band, y, x\)",
    ),
    "soil with x and y exchanged": (
        lambda: change(lambda s: s.ground, jnp.ones((2, 8, 6))),
        r"\(2, 6, 8\).* but has \(2, 8, 6\)",
    ),
    "sun on the horizon": (
        lambda: change(lambda s: s.illumination.sun_zenith, jnp.array(90.0)),
        r"sun_zenith` must be in \[0, 89.5\) degrees, but is 90.*horizon",
    ),
    "sun below the horizon": (
        lambda: change(lambda s: s.illumination.sun_zenith, jnp.array(120.0)),
        "at or below the horizon",
    ),
    "sun below zero": (
        lambda: change(lambda s: s.illumination.sun_zenith, jnp.array(-10.0)),
        "but is -10",
    ),
    "sun not a number": (
        lambda: change(lambda s: s.illumination.sun_zenith, jnp.array(jnp.nan)),
        "but is nan",
    ),
    "sun of two zeniths": (
        lambda: change(lambda s: s.illumination.sun_zenith, jnp.array([30.0, 40.0])),
        r"sun_zenith` must be a single number, but has shape \(2,\): a scene has one sun",
    ),
    "sun of one azimuth in a list": (
        lambda: change(lambda s: s.illumination.sun_azimuth, jnp.array([30.0])),
        r"sun_azimuth` must be a single number, but has shape \(1,\)",
    ),
    "sun of no azimuth": (
        lambda: change(lambda s: s.illumination.sun_azimuth, jnp.array(jnp.nan)),
        "`sun_azimuth` must be finite, but is nan",
    ),
    "sun of endless azimuth": (
        lambda: change(lambda s: s.illumination.sun_azimuth, jnp.array(jnp.inf)),
        "`sun_azimuth` must be finite, but is inf",
    ),
    "no bands": (
        lambda: change(lambda s: s.classes.reflectance, jnp.zeros((3, 0))),
        r"with one band or more, but has shape \(3, 0\)",
    ),
    "leaf diameters without owners": (
        lambda: with_owners((0, 0, 0), jnp.array([0.01, 0.02]), (0, 2, 1)),
        r"size_of_class` must have one of the places 0 to 1 for each .* but is \(0, 2, 1\)",
    ),
    "a sky of one ring": (
        lambda: with_static(illumination=with_pattern(jnp.ones((1, 8)))),
        r"two zeniths or more, but has shape \(1, 8\)",
    ),
    "a sky of other bands": (
        lambda: with_static(illumination=with_pattern(jnp.ones((3, 4, 8)))),
        r"sky_pattern` must have the axes .*\(3, 4, 8\)",
    ),
    "a sky without azimuths": (
        lambda: with_static(illumination=with_pattern(jnp.ones((4, 0)))),
        r"an azimuth and two zeniths or more, but has shape \(4, 0\)",
    ),
    "a sky of no light": (
        lambda: with_static(illumination=with_pattern(jnp.zeros((4, 8)))),
        "sky_pattern` must be bright somewhere.*set `sky` to zero",
    ),
    "a sky of no light in one band": (
        lambda: with_static(illumination=with_pattern(jnp.ones((2, 4, 8)).at[1].set(0.0))),
        "sky_pattern` must be bright somewhere in every band",
    ),
    "a sky of negative light": (
        lambda: with_static(illumination=with_pattern(-jnp.ones((4, 8)))),
        "sky_pattern` must be finite",
    ),
    "terrain of another grid": (
        lambda: with_static(terrain=jnp.zeros((8, 6))),
        r"`terrain` must have shape \(y, x\) = \(6, 8\).* but has \(8, 6\)",
    ),
    "terrain above the grid": (
        lambda: with_static(terrain=jnp.full((6, 8), 99.0)),
        r"terrain \[m\]` must be finite and in \[0, 0.4\]",
    ),
    "ground shape of other bands": (
        lambda: with_static(ground_shape=RahmanPintyVerstraete([1.0], [0.0], [1.0])),
        r"`ground_shape.k` must have shape \(band,\) = \(2,\)",
    ),
    **{
        f"ground shape of {name} = {value}": (
            lambda name=name, value=value: with_static(ground_shape=rahman(**{name: value})),
            f"`ground_shape.{name}` must be finite.*the first is {value}",
        )
        for name, value in (
            ("k", math.nan),
            ("theta", -1.0),
            ("theta", 1.0),
            ("rho_c", math.inf),
            ("rho_c", 2.5),
        )
    },
    "ground shape of another type": (
        lambda: with_static(ground_shape="lambert"),
        "`ground_shape` must be a `RahmanPintyVerstraete` or None, but is 'lambert'",
    ),
    "no light": (
        lambda: change(
            lambda s: (s.illumination.sun, s.illumination.sky), (jnp.zeros(2), jnp.zeros(2))
        ),
        "must have light, of sun or sky, in every band",
    ),
    "unknown boundary": (
        lambda: with_static(boundary="mirror"),
        "`boundary` must be 'periodic' or 'open', but is 'mirror'",
    ),
    "boundary of another type": (
        lambda: with_static(boundary=["open"]),
        r"`boundary` must be 'periodic' or 'open', but is \['open'\]",
    ),
    "voxel without end": (
        lambda: with_static(vertical=math.inf),
        "`vertical` must be a positive length in m, but is inf",
    ),
    "voxel without width": (
        lambda: with_static(horizontal=0.0),
        "`horizontal` must be a positive length in m, but is 0",
    ),
}


@pytest.mark.parametrize("name", CASES)
def test_refused(name):
    make, message = CASES[name]
    with pytest.raises(InputError, match=message):
        check_scene(make())


def test_solve_light_checks_its_scene():
    with pytest.raises(InputError, match="must be finite"):
        solve_light(change(lambda s: s.area_density, -DENSITY - 1))


def test_a_good_scene_passes():
    for boundary in ("periodic", "open"):
        check_scene(patchy(boundary))


@pytest.mark.parametrize(
    ("coarsening", "message"),
    [
        ((2, 5), "5 does not divide the 6 voxels along y"),
        ((2, 4), "4 does not divide the 6 voxels along y"),
    ],
)
def test_a_coarsening_that_does_not_divide_the_grid(coarsening, message):
    with pytest.raises(InputError, match=message + ".*pad the scene"):
        solve_light(patchy(), Accuracy(coarsening=coarsening))


def test_an_open_scene_with_a_traced_sun_needs_a_margin():
    with pytest.raises(InputError, match=r"`accuracy\.margin`"):
        jax.eval_shape(solve_light, patchy("open"))


def test_a_sky_bright_only_between_the_directions_of_the_light():
    pattern = jnp.zeros((91, 36)).at[0].set(1.0)
    scene = with_static(illumination=with_pattern(pattern))
    check_scene(scene)  # it has light
    with pytest.raises(InputError, match="3 zeniths and 6 azimuths"):
        solve_light(scene)


def test_shapes_are_checked_under_jit_too():
    with pytest.raises(InputError, match=r"`classes\.reflectance` .*shape"):
        jax.eval_shape(solve_light, change(lambda s: s.area_density, DENSITY[:2]))


def plain(**changes):
    """A small scene from plain arrays, as a user writes it."""
    arguments = {
        "area_density": np.ones((1, 2, 3, 4)),
        "reflectance": [[0.1, 0.4]],
        "transmittance": [[0.1, 0.4]],
        "voxel": (0.1, 0.1, 0.1),
        "ground": [0.2, 0.3],
        "sun_zenith": 30.0,
    }
    return voxel_scene(**(arguments | changes))


def test_a_scene_from_plain_arrays():
    scene = plain(area_density=np.ones((1, 2, 3, 4), int), leaf_angles="planophile", sky=0.2)
    assert jnp.issubdtype(scene.area_density.dtype, jnp.floating)
    assert scene.shape == (2, 3, 4)
    assert scene.illumination.sky.shape == (2,)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"voxel": (0.1, 0.2, 0.1)}, "the first two equal.*resample the grid to square columns"),
        ({"voxel": 0.1}, r"`voxel` must be 3 numbers.*edges in x, y and z"),
        ({"voxel": ("0.1", "0.1", "0.1")}, "`voxel` must be a number or an array of numbers"),
        ({"voxel": (0.1, 0.1, math.inf)}, r"`voxel \[m\]` must be finite .* \(0, inf\).* is inf"),
        ({"voxel": (0.1, 0.1, 0.0)}, r"`voxel \[m\]` must be finite .* first is 0.0 at"),
        ({"area_density": "dense"}, "`area_density` must be a number or.*'dense': is it text"),
        ({"area_density": [[1.0], [1.0, 2.0]]}, "`area_density`.*in rows of equal length"),
        ({"area_density": np.ones((1, 2, 3, 4), complex)}, "must be real numbers.*complex128"),
        ({"reflectance": np.zeros((1, 0))}, r"one band or more, but has shape \(1, 0\)"),
        ({"sun_zenith": [30.0]}, r"sun_zenith` must be a single number, but has shape \(1,\)"),
        ({"sun_zenith": None}, "`sun_zenith` must be a number .* but is None"),
        ({"sun_zenith": "30"}, "`sun_zenith` must be a number .* but is '30': is it text"),
        ({"sun_azimuth": "west"}, "`sun_azimuth` must be a number .* but is 'west'"),
        ({"sun_azimuth": [180.0]}, "sun_azimuth` must be a single number"),
        ({"sun_azimuth": math.nan}, "`sun_azimuth` must be finite, but is nan"),
        ({"sky": "blue"}, "`sky` must be a number or"),
        ({"sky_pattern": "clear"}, "`sky_pattern` must be a number or"),
        ({"sky": 0.2, "sky_pattern": np.zeros((4, 8))}, "must be bright somewhere"),
        ({"terrain": "hill"}, "`terrain` must be a number or"),
        ({"leaf_diameter": [0.01, 0.02]}, r"one value for each of the 1 classes.* shape \(2,\)"),
        ({"leaf_diameter": "small"}, "`leaf_diameter` must be a number or"),
        ({"leaf_angles": [3]}, r"`leaf_angles` must be a name or a distribution .* is \[3\]"),
        ({"leaf_angles": None}, "`leaf_angles` must be a name or a distribution .* is None"),
        ({"leaf_angles": 57.0}, "`leaf_angles` must be a name or a distribution .* is 57"),
        ({"leaf_angles": []}, r"each of the 1 classes, but is \(\)"),
        ({"ground_shape": 0.9}, "`ground_shape` must be a `RahmanPintyVerstraete` or None"),
        ({"area_density": np.ones((2, 3, 4))}, r"axes \[class, z, y, x\].*\(2, 3, 4\)"),
        ({"reflectance": [0.1, 0.4]}, r"`reflectance` \[class, band\]"),
        ({"transmittance": [[0.9, 0.9]]}, "must not exceed 1"),
        ({"leaf_angles": "upright"}, "upright"),
        ({"leaf_angles": ["spherical", "planophile"]}, r"each of the 1 classes, but is \(0, 1\)"),
        ({"sky": [0.1, 0.2, 0.3]}, "one value for each of the 2 bands"),
        ({"sun_zenith": 95.0}, "at or below the horizon"),
        ({"ground": [20.0, 30.0]}, r"ground` must be finite and in \[0, 1\]"),
    ],
)
def test_plain_arrays_refused(changes, message):
    with pytest.raises(InputError, match=message):
        plain(**changes)


def centres(count, pixel=0.1):
    return (np.arange(count) + 0.5) * pixel


@pytest.mark.parametrize(
    ("memory", "advice"),
    [
        (2**27, r"with cells of .*`Accuracy\(cell=(\S+), refine=False\)`\) it would fit"),
        (2**25, "voxels 3 times as large it would fit"),
        (2**14, "take larger voxels, a smaller scene or fewer bands"),
    ],
)
def test_a_grid_too_large_is_refused_before_it_is_tried(monkeypatch, memory, advice):
    monkeypatch.setattr("fynjax.radiation._check._memory", lambda: memory)
    scene = plain(area_density=np.ones((1, 10, 240, 240)))
    with pytest.raises(
        InputError, match=rf"10 x 240 x 240 voxels in 2 bands needs about .* GiB.*{advice}"
    ) as error:
        solve_light(scene)
    if advised := re.search(r"cell=([0-9.]+)", str(error.value)):
        check_fit(scene, Accuracy(cell=float(advised[1]), refine=False))
        check_fit(plain(area_density=np.ones((1, 4, 80, 80))), Accuracy())


def test_a_picture_too_large_is_refused(monkeypatch):
    scene = plain(area_density=np.zeros((1, 2, 4, 4)), sky=0.3)
    light = solver(Accuracy(levels=1, azimuths=2))(scene)
    monkeypatch.setattr("fynjax.radiation._check._memory", lambda: 2**24)
    with pytest.raises(InputError, match=r"1000000 pixels.*fewer bands"):
        render(light, parallel_rays(*[centres(1000, 0.01)] * 2, 0.01, 0.0, 0.0))


def test_an_empty_grid_is_the_bare_ground():
    scene = plain(area_density=np.zeros((1, 2, 4, 4)), sky=0.3)
    x = (jnp.arange(4) + 0.5) * 0.1
    light = solver(Accuracy(levels=1, azimuths=2))(scene)
    image = jax.jit(reflectance_factor)(light, nadir_rays(x, x, 0.1, (0.2, 0.2, math.inf)))
    np.testing.assert_allclose(image, np.broadcast_to([[[0.2]], [[0.3]]], (2, 4, 4)), rtol=1e-12)

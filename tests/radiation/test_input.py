"""What cannot be rendered is refused with a sentence that says why."""

import equinox as eqx
import jax
import jax.numpy as jnp
import pytest

from fynjax._core.errors import InputError
from fynjax.radiation import Accuracy, OpticalClasses, check_scene, solve_light
from tests.radiation.scenes import patchy


def change(select, value, boundary="periodic"):
    return eqx.tree_at(select, patchy(boundary), value)


def with_static(**fields):
    scene = patchy()
    return type(scene)(
        **{name: fields.get(name, getattr(scene, name)) for name in scene.__dataclass_fields__}
    )


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
        lambda: with_static(
            classes=OpticalClasses(
                patchy().classes.reflectance,
                patchy().classes.transmittance,
                patchy().classes.angles,
                (0, 1),
            )
        ),
        "a distribution for each of the 3 classes, but has 2",
    ),
    "owner beyond the end": (
        lambda: with_static(
            classes=OpticalClasses(
                patchy().classes.reflectance,
                patchy().classes.transmittance,
                patchy().classes.angles,
                (0, 1, 2),
            )
        ),
        "beyond the end",
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
        r"\(2, 6, 8\), but has \(2, 8, 6\)",
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
    "unknown boundary": (
        lambda: with_static(boundary="mirror"),
        "`boundary` must be 'periodic' or 'open', but is 'mirror'",
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
    with pytest.raises(InputError, match=r"`accuracy.margin` must be given"):
        jax.eval_shape(solve_light, patchy("open"))


def test_shapes_are_checked_under_jit_too():
    with pytest.raises(InputError, match=r"`classes.reflectance` must have shape"):
        jax.eval_shape(solve_light, change(lambda s: s.area_density, DENSITY[:2]))

"""Frame cameras in any attitude, against parallel rays and paths traced backward."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from fynjax._core.errors import InputError
from fynjax.radiation import (
    Accuracy,
    RayField,
    nadir_rays,
    parallel_rays,
    perspective_rays,
    reflectance_factor,
    render,
    voxel_scene,
)
from fynjax.radiation._rays import Lattice
from tests import reference
from tests.radiation.scenes import patchy, solver
from tests.radiation.test_monte_carlo_reference import with_fields

ACCURACY = Accuracy(
    sublayers=3, margin=6, coarsening=(1, 1), levels=4, azimuths=8, tolerance=1e-10, iterations=200
)
CAMERA, TARGET = (-0.3, 0.1, 1.6), (0.4, 0.35, 0.1)
pixels = jax.jit(reflectance_factor)
parts = jax.jit(lambda light, rays: render(light, rays))


def tilted(rows=5, columns=6, field_of_view=20.0):
    return perspective_rays(
        CAMERA, TARGET, rows=rows, columns=columns, field_of_view=field_of_view, dtype=jnp.float64
    )


@pytest.fixture(scope="module", params=["periodic", pytest.param("open", marks=pytest.mark.study)])
def scene(request):
    return patchy(request.param)


@pytest.fixture(scope="module")
def light(scene):
    return solver(ACCURACY)(scene)


def test_every_pixel_looks_from_the_camera():
    """Rays pass the camera, the middle one the target; the columns span the field of view; up in
    the picture is up, and right is right."""
    rays = tilted(5, 7)
    x, y = (np.asarray(a) for a in (rays.x, rays.y))
    sx, sy = np.asarray(rays.slope_x), np.asarray(rays.slope_y)
    np.testing.assert_allclose(x + CAMERA[2] * sx, CAMERA[0], atol=1e-12)
    np.testing.assert_allclose(y + CAMERA[2] * sy, CAMERA[1], atol=1e-12)
    np.testing.assert_allclose(x[2, 3] + TARGET[2] * sx[2, 3], TARGET[0], rtol=1e-12)
    np.testing.assert_allclose(y[2, 3] + TARGET[2] * sy[2, 3], TARGET[1], rtol=1e-12)
    towards = np.asarray(rays.towards)
    np.testing.assert_allclose(np.linalg.norm(towards, axis=-1), 1.0)
    pitch = 2 * np.tan(np.deg2rad(10.0)) / 7
    half = np.rad2deg(np.arccos(towards[2, 0] @ towards[2, 6]) / 2)
    assert half == pytest.approx(np.rad2deg(np.arctan(3 * pitch)))
    ahead = np.subtract(TARGET, CAMERA)[:2]
    assert np.all(np.diff(x @ np.eye(7), axis=0) * ahead[0] > 0)  # farther off towards the top
    right = np.array([ahead[1], -ahead[0]])
    assert np.all(np.diff(x, axis=1) * right[0] + np.diff(y, axis=1) * right[1] > 0)
    # What a pixel covers across the line of sight, on the ground.
    distance = np.linalg.norm([x - CAMERA[0], y - CAMERA[1], 0 * x + CAMERA[2]], axis=0)
    tilt = np.hypot((np.arange(5) - 2)[:, None], np.arange(7) - 3) * pitch
    np.testing.assert_allclose(rays.width, pitch * distance / np.hypot(1.0, tilt), rtol=1e-9)


def test_straight_down_it_is_the_nadir_camera(light):
    camera, field_of_view, rows, columns = (0.35, 0.28, 2.0), 12.0, 5, 7
    pitch = 2 * np.tan(np.deg2rad(field_of_view) / 2) / columns * camera[2]
    x = camera[0] + (np.arange(columns) - 3) * pitch
    y = camera[1] + (np.arange(rows) - 2) * pitch
    # Pixels stay within half a voxel: wider ones are averaged over a voxel at most.
    width = 0.04
    lattice = nadir_rays(jnp.asarray(x), jnp.asarray(y), width, camera)
    down = perspective_rays(
        camera,
        (*camera[:2], 0.0),
        rows=rows,
        columns=columns,
        field_of_view=field_of_view,
        dtype=jnp.float64,
    )
    np.testing.assert_allclose(down.width, pitch, rtol=1e-12)
    np.testing.assert_allclose(down.x, np.broadcast_to(x, (rows, columns)), rtol=1e-12)
    np.testing.assert_allclose(down.y, np.broadcast_to(y[:, None], (rows, columns)), rtol=1e-12)
    down = dataclasses.replace(down, width=jnp.full((rows, columns), width))
    want = np.asarray(pixels(light, lattice))
    np.testing.assert_allclose(pixels(light, down), want, rtol=1e-4)


@pytest.mark.study
def test_each_pixel_is_a_parallel_view_of_one_point(light):
    """The light scattered once and the ground; what was scattered more is taken towards the
    middle of the picture."""
    rays = tilted()
    width = 0.03
    rays = dataclasses.replace(rays, width=jnp.full(rays.shape, width))

    @jax.jit
    def alone(at):
        x, y, sx, sy = at
        zenith = jnp.rad2deg(jnp.arctan(jnp.hypot(sx, sy)))
        azimuth = jnp.rad2deg(jnp.arctan2(sx, sy))
        return render(light, parallel_rays(x[None], y[None], width, zenith, azimuth))

    flat = [jnp.ravel(a) for a in (rays.x, rays.y, rays.slope_x, rays.slope_y)]
    want = jax.lax.map(alone, tuple(flat))
    got = parts(light, rays)
    for name, tolerance in (("sunlit_leaves", 1e-3), ("diffuse_leaves", 0.06), ("ground", 1e-4)):
        expected = np.moveaxis(np.asarray(getattr(want, name))[..., 0, 0], 0, -1)
        value = np.asarray(getattr(got, name)).reshape(expected.shape)
        off = np.abs(value - expected).max() / expected.max()
        print(name, off)
        assert off < tolerance, name
    np.testing.assert_allclose(got.gap.ravel(), want.gap.ravel(), rtol=1e-4)


@pytest.mark.study
@pytest.mark.parametrize(
    ("parts", "tolerance"), [(1, 0.06), pytest.param(4, 0.025, marks=pytest.mark.slow)]
)
def test_tilted_image_against_paths_traced_backward(scene, parts, tolerance):
    """Pixels of no width: the paths meet the very rays. In voxels of up to several optical depths
    a pixel is off by 4 %; in voxels and beams a quarter as wide by 1.5 % (noise 1 % taken off)."""
    rays = tilted(4, 5)
    ground = np.stack([rays.x, rays.y, np.zeros(rays.shape)], axis=-1)
    sight = reference.PixelRays(np.array(CAMERA), ground - np.array(CAMERA))
    found = reference.image(scene, sight, samples=5_000, seed=2, band=1)
    thin = dataclasses.replace(rays, width=jnp.full(rays.shape, 1e-6, float))
    accuracy = ACCURACY
    if parts > 1:
        density, ground = scene.area_density, scene.ground
        for axis in (1, 2, 3):
            density = density.repeat(parts, axis)
        scene = with_fields(
            scene,
            area_density=density,
            ground=ground.repeat(parts, 1).repeat(parts, 2),
            horizontal=0.1 / parts,
            vertical=0.1 / parts,
        )
        accuracy = Accuracy(lattice=4, sublayers=2, levels=3, azimuths=8, margin=6 * parts)
    got = np.asarray(pixels(solver(accuracy)(scene), thin))[1]
    off, noise = got / found.mean - 1, found.error / found.mean
    print("off %", np.round(100 * off, 1), "noise %", np.round(100 * noise, 1))
    assert np.sqrt(np.mean(noise**2)) < 0.03
    assert np.sqrt(np.mean(off**2) - np.mean(noise**2)) < tolerance
    assert abs(got.mean() / found.mean.mean() - 1) < 0.015


def image_sum(scene):
    rays = tilted()
    weights = np.random.default_rng(1).normal(size=(2, *rays.shape))
    return jnp.sum(weights * reflectance_factor(solver(ACCURACY)(scene), rays))


@pytest.mark.study
def test_derivative_of_a_tilted_image(scene):
    """With respect to the density and to the sun, in one random direction."""
    value, slope = jax.jit(image_sum), jax.jit(jax.grad(image_sum))
    rng = np.random.default_rng(2)
    along = eqx.tree_at(
        lambda s: (s.area_density, s.illumination.sun_zenith),
        jax.tree.map(jnp.zeros_like, scene),
        (jnp.asarray(rng.normal(size=scene.area_density.shape)) * scene.area_density, jnp.ones(())),
    )
    h = 1e-5
    forth, back = (jax.tree.map(lambda a, d, s=s: a + s * h * d, scene, along) for s in (1, -1))
    difference = float(value(forth) - value(back)) / (2 * h)
    products = jax.tree.map(lambda g, d: jnp.sum(g * d), slope(scene), along)
    assert float(sum(jax.tree.leaves(products))) == pytest.approx(difference, rel=1e-6)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"target": (5.0, 0.0, 1.5)}, "at or above the horizon"),
        ({"target": (0.0, 0.0, 3.0)}, "at or above the horizon"),
        ({"field_of_view": 150.0, "rows": 6}, "at or above the horizon"),
        ({"target": CAMERA}, "other than `camera`"),
        ({"target": (np.nan, 0.0, 0.0)}, "other than `camera`"),
        ({"field_of_view": 0.0}, "`field_of_view` must be in"),
        ({"field_of_view": 175.0}, "`field_of_view` must be in"),
    ],
)
def test_cameras_that_cannot_be(options, message):
    given = {"target": TARGET, "rows": 4, "columns": 6, "field_of_view": 20.0} | options
    with pytest.raises(InputError, match=message):
        perspective_rays(CAMERA, given.pop("target"), **given)


def test_a_sensor_inside_the_canopy_is_refused(light):
    for camera in ((0.4, 0.3, 0.3), (0.4, 0.3, 0.0)):
        rays = perspective_rays(camera, (0.5, 0.3, -0.1), rows=2, columns=2, field_of_view=5.0)
        with pytest.raises(InputError, match="above the grid"):
            render(light, rays)
    with pytest.raises(InputError, match="above the grid"):
        render(light, nadir_rays(jnp.zeros(1), jnp.zeros(1), 0.1, (0.0, 0.0, 0.2)))


@pytest.mark.parametrize("boundary", ["periodic", "open"])
def test_rays_one_by_one_average_several_small_cells_as_a_lattice_does(boundary):
    """Beams of the sun are mostly half as wide as a voxel, and so as a pixel."""
    at = (jnp.arange(4) + 0.4) * 0.25
    lattice = nadir_rays(at, at, 0.25, (0.3, 0.1, 5.0))
    x, y = jnp.meshgrid(lattice.x, lattice.y)
    slopes = jnp.meshgrid(lattice.slope_x, lattice.slope_y)
    field = RayField(x, y, *slopes, jnp.full_like(x, 0.25), widest=0.25)
    cells = jnp.asarray(np.random.default_rng(1).random((10, 10)))
    for smooth in (False, True):
        few, others = (
            rays.sampler(jnp.asarray(0.7), Lattice(10, 10, 0.1, boundary), smooth=smooth)(cells)
            for rays in (lattice, field)
        )
        np.testing.assert_allclose(others, few, rtol=1e-12)
    assert field.together(2).widest == 0.5


def test_blocks_of_rays_have_their_middle():
    """Of a frame camera that looks straight down, as a lattice and ray by ray."""
    at = (jnp.arange(4) + 0.5) * 0.1
    lattice = nadir_rays(at, at + 0.05, 0.1, (0.3, 0.1, 5.0))
    width, height = jnp.full((4, 4), 0.1), lattice.altitude
    y, x = jnp.meshgrid(lattice.y, lattice.x, indexing="ij")
    slope_y, slope_x = jnp.meshgrid(lattice.slope_y, lattice.slope_x, indexing="ij")
    field = RayField(x, y, slope_x, slope_y, width, height)
    few, others = lattice.together(2), field.together(2)
    np.testing.assert_allclose(few.x, [0.1, 0.3], rtol=1e-12)
    np.testing.assert_allclose(few.towards, others.towards, rtol=1e-12)
    np.testing.assert_allclose(others.y, jnp.meshgrid(few.y, few.x, indexing="ij")[0], rtol=1e-12)
    np.testing.assert_allclose((few.footprint, *others.width.ravel()), 0.2, rtol=1e-12)
    np.testing.assert_allclose(few.central, lattice.central, rtol=1e-12)


def test_a_distant_frame_camera_sees_every_band_as_parallel_rays_do():
    """Many bands, distributions of leaf normals and pixels at once, in float32 as plots have them:
    here a compiler gave the third band and those after it the values of the first two."""
    bands, angles = 4, ("spherical", "planophile", "erectophile", "plagiophile")
    density = jnp.asarray(np.random.default_rng(3).gamma(0.3, 3.0, (4, 4, 10, 10)), jnp.float32)
    scene = voxel_scene(
        density,
        reflectance=jnp.linspace(0.05, 0.45, bands)[None].repeat(4, 0),
        transmittance=jnp.linspace(0.03, 0.40, bands)[None].repeat(4, 0),
        voxel=(0.1, 0.1, 0.1),
        leaf_angles=angles,
        ground=jnp.linspace(0.1, 0.3, bands),
        sun_zenith=30.0,
    )
    light = solver(Accuracy(refine=False))(scene)
    centres = ((jnp.arange(120) + 0.5) / 120).astype(jnp.float32)
    nadir = jnp.float32(0.0)
    parallel = parts(light, parallel_rays(centres, centres, 1 / 120, nadir, nadir))
    frame = parts(light, nadir_rays(centres, centres, 1 / 120, (0.5, 0.5, 1e6)))
    for name in ("sunlit_leaves", "diffuse_leaves", "ground"):
        want, found = (np.asarray(getattr(one, name)) for one in (parallel, frame))
        np.testing.assert_allclose(found.mean((1, 2)), want.mean((1, 2)), rtol=1e-4)
        np.testing.assert_allclose(found, want, atol=2e-3 * want.max())


@pytest.mark.parametrize(("of_scene", "of_rays"), [("float32", "float64"), ("float64", "float32")])
def test_rays_take_the_floating_type_of_the_scene(of_scene, of_rays):
    """Scenes are mostly in single precision, while places of pixels come from maps in double."""
    scene = voxel_scene(
        jnp.full((1, 2, 4, 4), 2.0, of_scene),
        reflectance=jnp.full((1, 1), 0.05, of_scene),
        transmittance=jnp.full((1, 1), 0.03, of_scene),
        voxel=(0.25, 0.25, 0.25),
        ground=jnp.full(1, 0.2, of_scene),
        sun_zenith=jnp.asarray(30.0, of_scene),
    )
    light = solver(Accuracy(refine=False))(scene)
    centres = (jnp.arange(4, dtype=of_rays) + 0.5) * 0.25
    kinds = {
        "parallel": parallel_rays(centres, centres, 0.25, 10.0, 20.0),
        "nadir": nadir_rays(centres, centres, 0.25, (0.5, 0.5, 30.0)),
        "perspective": perspective_rays(
            (0.5, 0.5, 30.0), (0.5, 0.5, 0.0), rows=4, columns=4, field_of_view=1.9, dtype=of_rays
        ),
    }
    for rays in kinds.values():
        same = jax.tree.map(lambda numbers: jnp.asarray(numbers, of_scene), rays)
        image, expected = pixels(light, rays), pixels(light, same)
        assert image.dtype == of_scene
        np.testing.assert_allclose(image, expected, rtol=1e-5)

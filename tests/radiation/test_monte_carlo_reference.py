"""The Monte Carlo itself: closed forms, conservation, its two directions, and other codes."""

import dataclasses
import json
import os

import jax.numpy as jnp
import numpy as np
import pytest

from fynjax._core.errors import InputError
from fynjax.canopy import TabulatedLeafAngle, leaf_angle
from fynjax.radiation import (
    Illumination,
    OpticalClasses,
    RahmanPintyVerstraete,
    VoxelScene,
    nadir_rays,
    parallel_rays,
)
from tests import reference
from tests.radiation.scenes import patchy, slab, spherical_gamma, towards, views_of_reference
from tests.radiation.test_reference_scenes import floating_spheres

SIGMA = 3.5  # about one false alarm in 2,000 comparisons; the seeds are fixed


def assert_close(estimate, want, rtol=0.0, atol=0.0):
    """Within the noise, and a share of the value where the reference itself is not exact."""
    allowed = SIGMA * estimate.error + rtol * np.abs(want) + atol
    off = np.abs(estimate.mean - want)
    assert np.all(off <= allowed), f"{estimate.mean} is not {want}, error {estimate.error}"


def with_fields(scene, **fields):
    """The scene with other values of fields, those of its parts as `part__field`."""
    own, parts = {}, {}
    for name, value in fields.items():
        part, _, name = name.rpartition("__")
        (parts.setdefault(part, {}) if part else own)[name] = value
    for part, values in parts.items():
        own[part] = dataclasses.replace(getattr(scene, part), **values)
    return dataclasses.replace(scene, **own)


def bare(size=4, boundary="periodic", sun=(40.0, 90.0), sky=0.0, soil=0.3, **fields):
    """No leaves, one band, voxels of 1 m, three layers."""
    scene = VoxelScene(
        jnp.zeros((1, 3, size, size)),
        OpticalClasses(jnp.array([[0.4]]), jnp.array([[0.3]]), (leaf_angle("spherical"),), (0,)),
        jnp.array([soil]),
        Illumination(jnp.array(sun[0]), jnp.array(sun[1]), jnp.array([1 - sky]), jnp.array([sky])),
        1.0,
        1.0,
        boundary,
    )
    return with_fields(scene, **fields)


def hilly(scene, amplitude):
    """The scene on ground that waves along x and y, and twists between the column centres."""
    _, ny, nx = scene.shape
    y, x = np.meshgrid(np.arange(ny) / ny, np.arange(nx) / nx, indexing="ij")
    wave = 0.5 * (1 + np.sin(2 * np.pi * x) * np.cos(2 * np.pi * y))
    return with_fields(scene, terrain=jnp.asarray(amplitude * wave))


def everything(boundary):
    """All that a scene can hold at once, in two bands."""
    scene = hilly(patchy(boundary, sky=(0.4, 0.6)), 0.15)
    return with_fields(
        scene,
        ground_shape=RahmanPintyVerstraete([0.8, 0.9], [-0.1, 0.05], [0.2, 1.0]),
        illumination__sky_pattern=jnp.asarray(np.random.default_rng(3).uniform(0.2, 3, (2, 5, 8))),
    )


STEEP = TabulatedLeafAngle(np.repeat([0.0, 0.2, 1.0, 3.0, 0.5, 0.1], 3))


@pytest.mark.parametrize(
    "angle",
    [*(leaf_angle(n) for n in ("spherical", "planophile", "erectophile")), STEEP],
    ids=["spherical", "planophile", "erectophile", "table"],
)
@pytest.mark.parametrize("zenith", [0.0, 55.0])
def test_direct_transmittance(angle, zenith):
    scene = slab(1.5, [(0.0, 0.0, 0.2)], zenith, angle=angle)
    found = reference.fluxes(scene, photons=100_000, seed=5, band=0)
    cosine = np.cos(np.deg2rad(zenith))
    want = np.exp(-1.5 * float(angle.projection(jnp.array(cosine))) / cosine)
    assert_close(found.transmitted_direct, want)
    assert_close(found.transmitted, want)
    assert_close(found.ground_absorbed, 0.8 * want)
    assert_close(found.albedo, 0.2 * want * two_way(angle))
    assert found.sides.mean == 0


def two_way(angle, lai=1.5):
    """Share of the light of a Lambertian ground that gets out of the slab."""
    cosine = (np.arange(2000) + 0.5) / 2000
    gap = np.exp(-lai * np.asarray(angle.projection(jnp.asarray(cosine))) / cosine)
    return float((2 * cosine * gap).mean())


def test_single_scattering():
    """Leaves so dark that light scattered twice is 0.1 % of that scattered once (Ross 1981)."""
    rho, tau, lai = 1.2e-3, 0.4e-3, 2.0
    scene = slab(lai, [(rho, tau, 0.0)], 35.0)
    zenith, azimuth = np.array([0.0, 35.0, 60.0]), np.array([0.0, 90.0, 200.0])
    found = reference.reflectance(scene, zenith, azimuth, photons=200_000, seed=2, band=0)
    view, sun = towards(zenith, azimuth), towards(35.0, 270.0)
    k = 0.5 / sun[2] + 0.5 / view[:, 2]
    gamma = spherical_gamma(np.arccos(-view @ sun), rho, tau)
    assert_close(found, gamma / (sun[2] * view[:, 2]) * -np.expm1(-k * lai) / k, rtol=1.5e-3)


@pytest.mark.parametrize("boundary", ["periodic", "open"])
@pytest.mark.parametrize("band", [0, 1])
def test_no_light_is_lost(boundary, band):
    found = reference.fluxes(everything(boundary), photons=100_000, seed=1, band=band)
    parts = (found.albedo, found.absorbed, found.ground_absorbed, found.sides)
    total = sum(np.sum(part.mean) for part in parts)
    noise = np.sqrt(sum(np.sum(part.error**2) for part in parts))
    assert noise < 0.01
    np.testing.assert_allclose(total, 1.0, atol=SIGMA * noise)
    assert (found.sides.mean == 0) == (boundary == "periodic")


@pytest.mark.parametrize("terrain", [0.0, 0.2])
def test_white_furnace(terrain):
    """Nothing absorbs: every photon comes back, and under an even sky all looks like the sky."""
    scene = patchy(sky=(1.0, 1.0), shape=(4, 6, 6))
    scene = with_fields(
        scene,
        classes__reflectance=jnp.full((3, 2), 0.6),
        classes__transmittance=jnp.full((3, 2), 0.4),
        ground=jnp.ones(2),
    )
    scene = hilly(scene, terrain) if terrain else scene
    found = reference.fluxes(scene, photons=3_200, seed=0, band=0)
    np.testing.assert_allclose(found.albedo.mean, 1.0, rtol=1e-12)
    x = jnp.arange(3) * 0.2
    pixels = reference.image(
        scene, parallel_rays(x, x, 0.1, 50.0, 20.0), samples=50, seed=0, band=0
    )
    np.testing.assert_allclose(pixels.mean, 1.0, rtol=1e-12)


def rahman(zenith_in, zenith_out, turn, k, theta, rho_c):
    """The formula of Rahman, Pinty and Verstraete (1993) in angles; turn 0 is the hot spot."""
    one, two, turn = np.deg2rad(zenith_in), np.deg2rad(zenith_out), np.deg2rad(turn)
    bowl = (np.cos(one) * np.cos(two) * (np.cos(one) + np.cos(two))) ** (k - 1)
    cos_g = np.cos(one) * np.cos(two) + np.sin(one) * np.sin(two) * np.cos(turn)
    lobe = (1 - theta**2) / (1 + theta**2 - 2 * theta * np.cos(np.pi - np.arccos(cos_g))) ** 1.5
    t1, t2 = np.tan(one), np.tan(two)
    apart = np.sqrt(t1**2 + t2**2 - 2 * t1 * t2 * np.cos(turn))
    return bowl * lobe * (1 + (1 - rho_c) / (1 + apart))


def test_ground_of_rahman_pinty_verstraete():
    """On bare ground each photon gives the exact value; paths from the sensor give it too."""
    zenith, azimuth = np.array([0.0, 40.0, 25.0, 60.0]), np.array([0.0, 90.0, 150.0, 270.0])
    shape = RahmanPintyVerstraete([0.75], [-0.12], [0.3])
    scene = bare(ground_shape=shape)
    want = 0.3 * rahman(40.0, zenith, azimuth - 90.0, 0.75, -0.12, 0.3)
    found = reference.reflectance(scene, zenith, azimuth, photons=320, seed=0, band=0)
    np.testing.assert_allclose(found.mean, want, rtol=1e-9)
    x = jnp.array([0.5, 2.5])
    for view, value in zip(zip(zenith, azimuth), want):
        pixels = reference.image(scene, parallel_rays(x, x, 1.0, *view), samples=4, seed=0, band=0)
        np.testing.assert_allclose(pixels.mean, value, rtol=1e-9)
    flux = reference.fluxes(bare(ground_shape=shape), photons=100_000, seed=0, band=0)
    mean = [
        2 * z / 400 / 90 * rahman(40.0, np.arccos(z / 400) * 180 / np.pi, a, 0.75, -0.12, 0.3)
        for z in np.arange(0.5, 400)
        for a in np.arange(2.0, 360, 4)
    ]
    assert_close(flux.albedo, 0.3 * np.sum(mean) / 400, rtol=1e-3)


def test_lambert_is_a_case_of_rahman_pinty_verstraete():
    plain = hilly(patchy(), 0.2)
    shaped = with_fields(
        plain, ground_shape=RahmanPintyVerstraete([1.0, 1.0], [0.0, 0.0], [1.0, 1.0])
    )
    one, two = (
        reference.reflectance(s, [30.0], [70.0], photons=3_200, seed=4, band=1)
        for s in (plain, shaped)
    )
    np.testing.assert_allclose(one.mean, two.mean, rtol=1e-9)


@pytest.mark.parametrize(("azimuth", "rise"), [(270.0, 0.5), (270.0, -0.5), (90.0, 1.5)])
def test_slope(azimuth, rise):
    """A plane that rises to the east: r cos(incidence) / cos(sun zenith), dark when turned away."""
    size, zenith = 20, 50.0
    heights = (jnp.arange(size) - size / 2) * rise * 0.1 + 1.6
    scene = bare(
        size,
        "open",
        (zenith, azimuth),
        terrain=jnp.broadcast_to(heights, (size, size)),
        horizontal=0.1,
    )
    x = jnp.array([0.9, 1.1])
    facing = towards(zenith, azimuth) @ np.array([-rise, 0.0, 1.0]) / np.hypot(rise, 1.0)
    want = 0.3 * max(facing, 0.0) / np.cos(np.deg2rad(zenith))
    rays = parallel_rays(x, x, 0.1, 0.0, 0.0)
    pixels = reference.image(scene, rays, samples=8, seed=0, band=0)
    np.testing.assert_allclose(pixels.mean, want, rtol=1e-6, atol=1e-12)
    # Half a column at either end is level: the height of the edge goes on.
    found = reference.reflectance(scene, 0.0, 0.0, photons=50_000, seed=0, band=0)
    share = 1 / size
    level = 0.3 * share * (0.5 if want == 0 else 1.0)
    assert_close(found, want * (1 - share) + level, atol=0.3**2 * share)


def test_level_ground_higher_up():
    scene = with_fields(slab(1.5, [(0.3, 0.3, 0.2)], 30.0), terrain=jnp.full((2, 2), 0.33))
    found = reference.fluxes(scene, photons=50_000, seed=1, band=0)
    thinner = reference.fluxes(slab(1.005, [(0.3, 0.3, 0.2)], 30.0), photons=50_000, seed=2, band=0)
    want = np.exp(-0.5 * 1.5 * 0.67 / np.cos(np.deg2rad(30.0)))
    assert_close(found.transmitted_direct, want)
    for name in ("albedo", "absorbed", "transmitted"):
        other = getattr(thinner, name)
        assert_close(getattr(found, name), other.mean, atol=SIGMA * other.error)


def test_hills_hide_what_is_behind():
    """Bilinear ground against its own heights, followed in short steps."""
    scene = hilly(bare(8, sun=(70.0, 35.0), soil=1e-4), 2.5)
    heights = np.asarray(scene.terrain)

    def height(x, y):
        u, v = x - 0.5, y - 0.5
        i, j = np.floor(u).astype(int), np.floor(v).astype(int)
        u, v = u - i, v - j
        corner = lambda a, b: heights[(j + b) % 8, (i + a) % 8]  # noqa: E731
        return (1 - v) * ((1 - u) * corner(0, 0) + u * corner(1, 0)) + v * (
            (1 - u) * corner(0, 1) + u * corner(1, 1)
        )

    points = (np.arange(24) + 0.5) / 3 + 0.01
    x, y = np.meshgrid(points, points)
    sun, small = towards(70.0, 35.0), 1e-6
    slope_x = (height(x + small, y) - height(x - small, y)) / (2 * small)
    slope_y = (height(x, y + small) - height(x, y - small)) / (2 * small)
    facing = (sun[2] - slope_x * sun[0] - slope_y * sun[1]) / np.sqrt(1 + slope_x**2 + slope_y**2)
    steps = np.arange(1e-3, 9.0, 1e-3)[:, None, None]
    over = height(x, y) + steps * sun[2] - height(x + steps * sun[0], y + steps * sun[1])
    # What grazes a hill may fall on either side of it.
    clear, sure = over.min(axis=0), np.abs(over[20:].min(axis=0)) > 2e-3
    want = 1e-4 * np.where((clear > 0) & (facing > 0), facing, 0.0) / sun[2]
    rays = parallel_rays(jnp.asarray(points), jnp.asarray(points), 1e-9, 0.0, 0.0)
    pixels = reference.image(scene, rays, samples=20, seed=0, band=0)
    assert 0.2 < (want[sure] == 0).mean() < 0.8
    assert sure.mean() > 0.9
    np.testing.assert_allclose(pixels.mean[sure], want[sure], rtol=1e-3, atol=3e-8)


def test_sky_pattern():
    """Its irradiance is `sky` whatever its shape, and each part stands where it is said to."""
    pattern = np.random.default_rng(0).uniform(0.1, 4.0, (4, 6))
    scene = bare(sky=1.0, illumination__sky_pattern=jnp.asarray(pattern), soil=0.25)
    found = reference.fluxes(scene, photons=100_000, seed=0, band=0)
    assert_close(found.transmitted, 1.0)
    zenith, azimuth = np.meshgrid([30.0, 60.0], np.arange(6) * 60.0, indexing="ij")
    up = reference.PixelRays(np.zeros(3) + 0.5, towards(zenith, azimuth))
    seen = reference.image(scene, up, samples=1, seed=0, band=0).mean
    np.testing.assert_allclose(seen / seen[0, 2], pattern[1:3] / pattern[1, 2], rtol=1e-9)
    even = with_fields(scene, illumination__sky_pattern=jnp.full((4, 6), 7.0))
    seen = reference.image(even, up, samples=1, seed=0, band=0).mean
    np.testing.assert_allclose(seen, 1.0, rtol=1e-6)


@pytest.mark.parametrize("boundary", ["periodic", "open"])
@pytest.mark.parametrize("view", [(0.0, 0.0), (45.0, 130.0)])
def test_forward_and_backward_agree(boundary, view):
    """Two estimators with no sampling in common, over all that a scene can hold."""
    scene = everything(boundary)
    _, ny, nx = scene.shape
    x, y = (np.arange(nx) + 0.5) * 0.1, (np.arange(ny) + 0.5) * 0.1
    for band in range(2):
        forward = reference.reflectance(scene, *view, photons=150_000, seed=7, band=band)
        rays = parallel_rays(jnp.asarray(x), jnp.asarray(y), 0.1, *view)
        pixels = reference.image(scene, rays, samples=2_000, seed=8, band=band)
        noise = np.sqrt((pixels.error**2).sum()) / pixels.mean.size
        assert noise < 0.01 * forward.mean[0]
        assert_close(forward, pixels.mean.mean(), atol=SIGMA * noise)


def test_pixels_of_a_camera():
    """A frame camera's lattice, and the same rays given one by one."""
    scene = patchy()
    x, y = jnp.array([0.25, 0.45]), jnp.array([0.15, 0.35])
    lattice = nadir_rays(x, y, 1e-9, (0.3, 0.2, 2.0))
    one = reference.image(scene, lattice, samples=4_000, seed=0, band=1)
    camera = np.array([0.3, 0.2, 2.0])
    ground = np.stack([*np.meshgrid(x, y), np.zeros((2, 2))], axis=-1)
    rays = reference.PixelRays(camera, ground - camera)
    two = reference.image(scene, rays, samples=4_000, seed=1, band=1)
    assert_close(one, two.mean, atol=SIGMA * two.error)
    # A pixel as wide as the whole scene sees the mean of it: from far off, the distant view.
    camera = np.array([0.4, 0.3, 1e4])
    wide = reference.PixelRays(camera, np.array([0, 0, -1e4]), [0.8, 0, 0], [0, 0.6, 0])
    whole = reference.image(scene, wide, samples=100_000, seed=1, band=1)
    distant = reference.reflectance(scene, 0.0, 0.0, photons=100_000, seed=2, band=1)
    assert_close(distant, whole.mean, atol=SIGMA * whole.error)


@pytest.mark.parametrize("index", range(0, 15, 2))
def test_slab_of_discrete_ordinates(shared_data, index):
    with open(shared_data / "rt" / "slab_uniform_turbid.json", encoding="utf-8") as file:
        compare_slab(json.load(file)["cases"][index], leaf_angle("spherical"))


@pytest.mark.parametrize("index", range(4))
def test_slab_of_other_leaf_angles(shared_data, index):
    with open(shared_data / "rt" / "slab_lad_turbid.json", encoding="utf-8") as file:
        case = json.load(file)["cases"][index]
    compare_slab(case, leaf_angle(case["scene"]["lad"]))


def compare_slab(case, angle):
    optics, want = case["optics"], case["result"]
    scene = slab(
        case["scene"]["lai"],
        [tuple(optics[n] for n in ("rho", "tau", "soil"))],
        case["sza"],
        angle=angle,
        layers=4,
    )
    views = views_of_reference(case["views"])
    found = reference.reflectance(scene, *views, photons=60_000, seed=3, band=0)
    assert_close(found, want["brf"], atol=SIGMA * np.array(want.get("brf_se", 0.0)))
    flux = reference.fluxes(scene, photons=60_000, seed=4, band=0)
    assert_close(flux.albedo, want["albedo"], atol=SIGMA * want.get("albedo_se", 0.0))
    assert_close(flux.transmitted, want["transmission_total"], rtol=2e-3)


@pytest.mark.study
def test_floating_spheres(shared_data):
    """Half-metre voxels on turbid spheres of 10 m: 0.5 % is allowed for their steps."""
    with open(shared_data / "rt" / "het01_turbid.json", encoding="utf-8") as file:
        case = json.load(file)["cases"][0]
    some = [1, 3, 4, 5, 8, 11]
    zenith, azimuth = views_of_reference(np.array(case["views"], float)[some])
    found = reference.reflectance(
        floating_spheres(case), zenith, azimuth, photons=300_000, seed=0, band=0
    )
    want, noise = (np.array(case["result"][n])[some] for n in ("brf", "brf_se"))
    assert_close(found, want, rtol=5e-3, atol=2 * noise)


def test_seed_alone_decides(monkeypatch):
    scene = patchy("open")
    one = reference.reflectance(scene, 10.0, 0.0, photons=3_200, seed=1, band=0)
    monkeypatch.setattr(os, "sched_getaffinity", lambda pid: set(range(5)), raising=False)
    two = reference.reflectance(scene, 10.0, 0.0, photons=3_200, seed=1, band=0)
    other = reference.reflectance(scene, 10.0, 0.0, photons=3_200, seed=2, band=0)
    assert (one.mean, one.error) == (two.mean, two.error)
    assert one.mean != other.mean


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda s: reference.fluxes(s, photons=10, seed=0, band=2), "`band` must be in"),
        (lambda s: reference.fluxes(s, photons=0, seed=0, band=0), "`photons` must be at least"),
        (
            lambda s: reference.reflectance(s, -30.0, 0.0, photons=10, seed=0, band=0),
            "`view_zenith` must be in",
        ),
        (lambda s: reference.discs(s, 0), "`classes.leaf_diameter` must be given"),
        (
            lambda s: reference.fluxes(
                with_fields(s, terrain=jnp.full((6, 8), 350.0)), photons=10, seed=0, band=0
            ),
            "above sea level",
        ),
        (
            lambda s: reference.image(
                s, reference.PixelRays(np.zeros(3), np.zeros((4, 3))), samples=1, seed=0, band=0
            ),
            "`rays.direction` must not be zero",
        ),
    ],
    ids=["band", "photons", "view", "no leaves", "terrain", "no direction"],
)
def test_input_that_cannot_be_used(call, message):
    with pytest.raises(InputError, match=message):
        call(patchy())

"""Plots too large to be rendered in one piece."""

import dataclasses
import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from fynjax._core.checkpoint import Journal
from fynjax.errors import InputError
from fynjax.radiation import Accuracy, Tiling
from fynjax.radiation._tiles import Axis
from fynjax.scene import TiledPicture, hard_scene, is_large, truth_of_layers, truth_of_pixels
from fynjax.scene._large import _Plants
from tests.scene.plots import drone, reflectance, small_parameters, small_plot

LIGHT = Accuracy(lattice=1, sublayers=1, levels=1, azimuths=4, refine=False)


def test_an_interrupted_image_in_tiles_goes_on_and_is_that_of_the_whole(tmp_path, monkeypatch):
    scene, parameters = small_plot(), small_parameters()
    aimed = drone(scene, LIGHT)
    assert not is_large(aimed, scene)
    monkeypatch.setattr("fynjax.scene._large._MOST_RAYS", 16 * 16 - 1)
    assert is_large(aimed, scene)
    monkeypatch.setattr("fynjax.scene._large._MOST_RAYS", 16 * 16)
    monkeypatch.setattr("fynjax.scene._large._MOST_VOXELS", 16 * 16)
    assert is_large(aimed, scene)
    whole = reflectance(aimed, scene, parameters)
    picture, journal = TiledPicture(aimed, scene, parameters, tile=10), Journal(tmp_path, "s")
    assert picture.tiles == [(0, 0), (0, 1), (1, 0), (1, 1)]
    for tile in picture.tiles[:3]:
        journal(picture.render, tile)
    picture, journal = TiledPicture(aimed, scene, parameters, tile=10), Journal(tmp_path, "s")
    made = []

    def render(tile):
        made.append(tile)
        return picture.render(tile)

    image = picture.image(journal(render, tile) for tile in picture.tiles)
    assert made == [(1, 1)]
    np.testing.assert_allclose(image, whole, rtol=1e-9)
    with pytest.raises(ValueError, match="shorter"):
        picture.image([])


def test_shares_in_tiles_are_those_of_the_whole(monkeypatch):
    """Under a low sun, whose shade reaches beyond a tile."""
    low = jnp.asarray(50.0)
    parameters = eqx.tree_at(lambda p: p.light.sun_zenith, small_parameters(), low)
    scene = small_plot()
    aimed = drone(scene, LIGHT)
    expected = truth_of_pixels(aimed, scene, parameters)
    picture = TiledPicture(aimed, scene, parameters, tile=10)
    found = truth_of_layers(picture.sight(), aimed, scene, parameters)
    assert float(expected.sunlit_ground.max()) > 0.1
    for name in ("live", "dead", "wood", "flowers", "sunlit_ground", "shaded_ground"):
        np.testing.assert_allclose(getattr(found, name), getattr(expected, name), atol=2e-6)
    total = found.species.sum(axis=0) + found.sunlit_ground + found.shaded_ground
    np.testing.assert_allclose(total, 1.0, atol=1e-5)


def test_a_light_that_does_not_fit_is_refused_before_plants_are_placed(monkeypatch):
    scene = small_plot()
    aimed = drone(scene, LIGHT)
    monkeypatch.setattr("fynjax.radiation._check._memory", lambda: 2**16)
    monkeypatch.setattr("fynjax.scene._large._voxels", None)
    with pytest.raises(InputError, match="GiB"):
        TiledPicture(aimed, scene, small_parameters())


def test_elements_placed_part_by_part_make_the_same_voxels(monkeypatch):
    """Whatever their number; so does what stands alone. The derivative of the stand in
    expectation is that of differences."""
    scene, parameters = small_plot(), small_parameters()

    def square(by, scene):
        cover = parameters.species.cover * (1.0 + by)
        moved = eqx.tree_at(lambda p: p.species.cover, parameters, cover)
        density = scene.area_density(moved)
        return jnp.sum(density**2), density

    _, whole = jax.jit(square)(0.0, scene)
    few = hard_scene(scene, parameters)
    assert 0.2 < few.planting.plant.size / scene.planting.plant.size < 0.7
    np.testing.assert_allclose(few.area_density(parameters), whole, rtol=1e-9, atol=1e-12)
    monkeypatch.setattr("fynjax.scene._scene._AT_ONCE", scene.planting.plant.size // 3)
    # Another static field, lest the program that was traced before the limit serve again.
    scene = dataclasses.replace(scene, spreads=(("none", 0.0),))
    np.testing.assert_allclose(jax.jit(square)(0.0, scene)[1], whole, rtol=1e-9, atol=1e-12)
    parts = jax.jit(jax.value_and_grad(square, has_aux=True))
    (_, _), slope = parts(0.0, scene.expected())
    up, down = (parts(by, scene.expected())[0][0] for by in (1e-6, -1e-6))
    difference = (up - down) / 2e-6
    assert float(slope) == pytest.approx(float(difference), rel=1e-4)


@pytest.mark.parametrize("boundary", ["periodic", pytest.param("open", marks=pytest.mark.study)])
def test_windows_make_the_picture_of_the_whole(monkeypatch, boundary):
    """Leaves finer than the voxels, and area elements that are not listed for the whole plot."""
    plot = {"extent": (3.2, 4.8), "voxel": 0.2, "structure": 0.1, "boundary": boundary}
    # A low sun, whose beams cross more than the cell that a window has beside its tile anyway.
    low = jnp.asarray(50.0)
    parameters = eqx.tree_at(lambda p: p.light.sun_zenith, small_parameters(), low)
    whole = small_plot(**plot)
    aimed = drone(whole, dataclasses.replace(LIGHT, margin=10), pixel=0.1)
    expected = reflectance(aimed, whole, parameters)  # whose layers are cut as those of tiles are
    monkeypatch.setattr("fynjax.scene._planting.MOST_LISTED", 0)
    scene = small_plot(**plot)
    with pytest.raises(InputError, match="render the plot in tiles"):
        scene.area_density(parameters)
    monkeypatch.setattr("fynjax.scene._large._HELD", 2**16)
    held = []
    monkeypatch.setattr(
        "fynjax.scene._large._Plants.window",
        lambda self, *at, make=_Plants.window: held.append(make(self, *at)) or held[-1],
    )
    image = TiledPicture(aimed, scene, parameters, tile=20).image()
    assert len(held) > 20
    assert max(len(window.planting.plant) for window in held) < 0.8 * whole.planting.plant.size
    np.testing.assert_allclose(image, expected, rtol=1e-9)


def test_windows_of_bare_ground_have_nothing_to_place():
    scene, parameters = small_plot(extent=(3.2, 4.8), voxel=0.2), small_parameters()
    bare = eqx.tree_at(lambda p: p.species.cover, parameters, jnp.zeros(3))
    bands = drone(scene, LIGHT, pixel=0.2).sensor.bands
    whole = jax.eval_shape(lambda: scene.voxels(bare, bands))
    plants = _Plants(scene, bare, 0.2)
    tiling = Tiling(*(2 * (Axis(4, (0, 4), 6, (-1, 3)),)), 2)
    room = plants.room(tiling)
    assert room == (0, 0)
    window = plants.window(tiling, room, 1, 1)
    voxels = jax.eval_shape(lambda: scene.voxels(bare, bands, window))
    assert voxels.shape == (*whole.shape[:1], 12, 12)


def test_windows_under_a_low_sun_stay_wider_than_their_rims(monkeypatch):
    """However little is to be held: a tile of one cell would need almost the rim of the whole."""
    scene, parameters = small_plot(extent=(3.2, 4.8), voxel=0.2), small_parameters()
    low = eqx.tree_at(lambda p: p.light.sun_zenith, parameters, jnp.asarray(85.0))
    monkeypatch.setattr("fynjax.scene._large._HELD", 1)
    cut = []

    def room(self, tiling):
        cut.append(tiling)
        raise InterruptedError

    monkeypatch.setattr("fynjax.scene._large._Plants.room", room)
    with pytest.raises(InterruptedError):
        TiledPicture(drone(scene, LIGHT, pixel=0.2), scene, low)
    (tiling,) = cut
    assert math.prod(tiling.shape) < 10
    voxels = scene.voxels(low, drone(scene, LIGHT).sensor.bands)
    assert tiling.voxels(voxels) > voxels.area_density[0].size
    monkeypatch.setattr("fynjax.radiation._check._memory", lambda: 4 * tiling.voxels(voxels))
    with pytest.raises(InputError, match="GiB"):
        TiledPicture(drone(scene, LIGHT, pixel=0.2), scene, low)

"""Deposition against a slow loop, conservation laws, and derivatives."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from fynjax._core.errors import InputError
from fynjax.canopy import TabulatedLeafAngle, VoxelGrid, deposit, plant_model, unit_shapes
from tests.helpers import assert_gradients

EXTENT = (4.0, 6.0)


def elements(n: int, seed: int = 0, dtype: type = np.float64) -> tuple[np.ndarray, ...]:
    rng = np.random.default_rng(seed)
    # Some stand over the sides, below the ground and above the top.
    positions = rng.uniform((-0.5, -0.5, -0.1), (4.5, 6.5, 2.3), (n, 3))
    return positions.astype(dtype), rng.uniform(0, 1e-2, n).astype(dtype), rng.integers(0, 3, n)


def slow_deposit(
    positions: np.ndarray, area: np.ndarray, classes: np.ndarray, grid: VoxelGrid, boundary: str
) -> np.ndarray:
    """Overlap of a voxel-sized box around each element with every voxel, one axis at a time."""
    nx, ny, nz = grid.shape
    out = np.zeros((3, nz, ny, nx))
    sizes = (grid.horizontal_size, grid.horizontal_size, grid.vertical_size)
    for point, amount, c in zip(positions, area, classes, strict=True):
        shares: list[np.ndarray] = []
        for axis, (n, size) in enumerate(zip(grid.shape, sizes, strict=True)):
            centre = (point[axis] - grid.origin[axis]) / size
            share = np.zeros(n)
            for cell in range(int(np.floor(centre - 0.5)), int(np.floor(centre + 0.5)) + 1):
                overlap = min(cell + 1, centre + 0.5) - max(cell, centre - 0.5)
                if axis == 2:
                    share[min(max(cell, 0), n - 1)] += overlap
                elif boundary == "periodic":
                    share[cell % n] += overlap
                elif 0 <= cell < n:
                    share[cell] += overlap
            shares.append(share)
        out[c] += amount * np.einsum("z,y,x->zyx", shares[2], shares[1], shares[0])
    return out / grid.voxel_volume


@pytest.mark.parametrize("boundary", ["periodic", "open"])
@pytest.mark.parametrize(("horizontal", "vertical"), [(0.5, 0.25), (2.0, 3.0), (1.0, 0.7)])
def test_deposit_equals_the_slow_loop(boundary: str, horizontal: float, vertical: float) -> None:
    grid = VoxelGrid.cover(EXTENT, 2.0, horizontal, vertical)
    positions, area, classes = elements(300)
    density = deposit(positions, area, classes, grid, 3, boundary=boundary)  # type: ignore[arg-type]
    slow = slow_deposit(positions, area, classes, grid, boundary)
    np.testing.assert_allclose(density, slow, rtol=1e-10, atol=1e-13)


def test_a_shifted_origin_shifts_the_grid() -> None:
    positions, area, classes = elements(200)
    grid = VoxelGrid((8, 12, 5), 0.5, 0.5, (1.0, -2.0, 0.5))
    density = deposit(positions, area, classes, grid, 3)
    np.testing.assert_allclose(
        density, slow_deposit(positions, area, classes, grid, "periodic"), atol=1e-12
    )


@pytest.mark.parametrize("horizontal", [0.05, 0.1, 0.4, 2.0])
@pytest.mark.parametrize(("dtype", "tolerance"), [(np.float32, 1e-5), (np.float64, 1e-12)])
def test_area_is_conserved_at_every_resolution(
    horizontal: float, dtype: type, tolerance: float
) -> None:
    """Plants of 15 cm, thinner than most of the voxels."""
    plant = plant_model("upright_ericoid", 60, seed=0)
    sites = np.random.default_rng(1).uniform(0, 4.0, (200, 1, 2))
    across, along = unit_shapes(np.asarray(plant.position), np.linspace(0, 700, 200), np.zeros(200))
    places = 0.15 * across + 1.78 * along
    places[..., :2] += sites
    positions = places.reshape(-1, 3).astype(dtype)
    organ = np.tile(plant.organ, 200)
    of_plant = np.array([0.03, 0.006, 0.002])[np.asarray(plant.organ)]
    area = np.tile(np.asarray(plant.area_fraction) * of_plant, 200).astype(dtype)
    grid = VoxelGrid.cover(EXTENT, 1.8, horizontal)
    density = deposit(positions, area, organ, grid, 3)
    assert density.dtype == dtype
    planted = 200 * np.array([0.03, 0.006, 0.002])
    on_grid = np.asarray(density, np.float64).sum((1, 2, 3)) * grid.voxel_volume
    np.testing.assert_allclose(on_grid, planted, rtol=tolerance)


def test_the_centre_of_mass_stays() -> None:
    rng = np.random.default_rng(3)
    positions = rng.uniform((0.5, 0.5, 0.5), (3.5, 5.5, 1.5), (400, 3))
    area = rng.uniform(0, 1, 400)
    grid = VoxelGrid.cover(EXTENT, 2.0, 0.5)
    density = np.asarray(deposit(positions, area, np.zeros(400, int), grid, 1))[0]
    x, y, z = grid.centres
    centre = [
        np.einsum("zyx,x->", density, x),
        np.einsum("zyx,y->", density, y),
        np.einsum("zyx,z->", density, z),
    ] / density.sum()
    np.testing.assert_allclose(centre, area @ positions / area.sum(), rtol=1e-12)


def test_a_step_of_one_voxel_rolls_a_periodic_grid() -> None:
    positions, area, classes = elements(200)
    grid = VoxelGrid.cover(EXTENT, 2.0, 0.5)
    moved = deposit(positions + np.array([0.5, -1.0, 0.0]), area, classes, grid, 3)
    still = deposit(positions, area, classes, grid, 3)
    np.testing.assert_allclose(moved, jnp.roll(still, (1, -2), (3, 2)), atol=1e-12)


def test_open_windows_add_up_to_the_whole() -> None:
    """Area near a seam is shared by both windows and lost by neither."""
    positions, area, classes = elements(300)
    whole = deposit(positions, area, classes, VoxelGrid((10, 14, 5), 0.5, 0.5, (-0.5, -0.5, 0)), 3)
    parts = [
        deposit(
            positions, area, classes, VoxelGrid((5, 14, 5), 0.5, 0.5, (west, -0.5, 0)), 3,
            boundary="open",
        )
        for west in (-0.5, 2.0)
    ]  # fmt: skip
    inner = np.s_[:, :, 1:-1, 1:-1]  # the whole grid is periodic at its own sides
    together = jnp.concatenate(parts, axis=3)
    np.testing.assert_allclose(together[inner], np.asarray(whole)[inner], atol=1e-12)
    far = deposit(
        positions + 100.0, area, classes, VoxelGrid((5, 5, 5), 0.5, 0.5), 3, boundary="open"
    )
    np.testing.assert_array_equal(far, 0.0)


@pytest.mark.parametrize("boundary", ["periodic", "open"])
def test_gradients(boundary: str) -> None:
    rng = np.random.default_rng(4)
    positions = rng.uniform((-0.5, -0.5, 0.3), (4.5, 6.5, 1.7), (12, 3))
    area, classes = rng.uniform(0.5, 1.0, 12), rng.integers(0, 3, 12)
    grid = VoxelGrid.cover(EXTENT, 2.0, 1.0, 0.5)
    # Linear along each axis between voxel centres: a long step has no truncation error.
    assert_gradients(
        jax.jit(lambda x: deposit(x[0], x[1], classes, grid, 3, boundary=boundary)),  # type: ignore[arg-type]
        (positions, area),
        step=1e-5,
    )


def test_elements_beyond_the_top_and_bottom_have_no_vertical_slope() -> None:
    positions = np.array([[1.0, 1.0, -0.2], [1.0, 1.0, 0.2], [1.0, 1.0, 2.6], [1.0, 1.0, 0.8]])
    grid = VoxelGrid.cover(EXTENT, 2.0, 1.0, 0.5)
    height = np.arange(4.0)[:, None, None]

    def first_moment(z: jax.Array) -> jax.Array:
        placed = jnp.asarray(positions).at[:, 2].set(z)
        return jnp.sum(deposit(placed, jnp.ones(4), jnp.zeros(4, int), grid, 1)[0] * height)

    slope = jax.grad(first_moment)(jnp.asarray(positions[:, 2]))
    np.testing.assert_allclose(slope, np.array([0, 0, 0, 1 / 0.5]) / grid.voxel_volume, atol=1e-12)


def test_nothing_planted_gives_an_empty_grid_with_finite_slopes() -> None:
    positions, area, classes = elements(10)
    grid = VoxelGrid.cover(EXTENT, 2.0, 0.5)
    total = lambda p, a: jnp.sum(deposit(p, a, classes, grid, 3) ** 2)  # noqa: E731
    slopes = jax.grad(total, (0, 1))(positions, 0.0 * area)
    assert all(np.all(np.isfinite(s)) for s in slopes)
    empty = deposit(jnp.zeros((0, 3)), jnp.zeros(0), jnp.zeros(0, int), grid, 2)
    assert empty.shape == (2, 4, 12, 8)
    np.testing.assert_array_equal(empty, 0.0)


def test_jit_and_vmap() -> None:
    positions, area, classes = elements(50)
    grid = VoxelGrid.cover(EXTENT, 2.0, 1.0)
    compiled = jax.jit(lambda p, a, c, g: deposit(p, a, c, g, 3))
    plain = deposit(positions, area, classes, grid, 3)
    np.testing.assert_allclose(compiled(positions, area, classes, grid), plain, rtol=1e-12)
    many = jax.vmap(lambda a: deposit(positions, a, classes, grid, 3))(np.stack([area, 2 * area]))
    np.testing.assert_allclose(many[1], 2 * plain, rtol=1e-12)


def test_projection_of_deposited_normals_equals_that_of_the_facets() -> None:
    """Leaf angle bins as classes: what arrives on the grid projects as the elements did."""
    bins = 45
    plant = plant_model("broad_leaved", 4000, seed=2)
    leaf = np.asarray(plant.organ) == 0
    normal = np.asarray(plant.normal)[leaf]
    # Turned all round, so that the azimuths are even, as a distribution of inclination assumes.
    turn = 2 * np.pi * np.arange(24) / 24
    level = np.hypot(normal[:, 0], normal[:, 1])[:, None]
    start = np.arctan2(normal[:, 1], normal[:, 0])[:, None]
    area = np.full(leaf.sum(), 1e-4)
    inclination = np.degrees(np.arccos(normal[:, 2]))
    classes = np.minimum(inclination / (90 / bins), bins - 1).astype(int)
    grid = VoxelGrid.cover((2.0, 2.0), 1.0, 0.25)
    density = deposit(
        np.asarray(plant.position)[leaf] + np.array([1.0, 1.0, 0.0]), area, classes, grid, bins
    )
    tabulated = TabulatedLeafAngle(np.asarray(density).sum((1, 2, 3)))
    for zenith in (0.0, 30.0, 60.0, 85.0):
        view = np.radians(zenith)
        along = level * np.cos(start + turn) * np.sin(view) + normal[:, 2:] * np.cos(view)
        facets = np.mean(np.abs(along))
        assert float(tabulated.projection(jnp.cos(view))) == pytest.approx(facets, rel=0.01)


def test_grid_properties() -> None:
    grid = VoxelGrid.cover((10.0, 5.0), 2.67, 0.1)
    assert grid.shape == (100, 50, 27)
    assert grid.extent == pytest.approx((10.0, 5.0, 2.7))
    assert grid.voxel_volume == pytest.approx(1e-3)
    x, y, z = grid.centres
    assert (len(x), len(y), len(z)) == (100, 50, 27)
    assert (x[0], x[-1], z[0]) == pytest.approx((0.05, 9.95, 0.05))
    assert VoxelGrid.cover((1.0, 1.0), 0.3, 0.1).shape == (10, 10, 3)
    assert jax.tree.leaves(grid) == []


@pytest.mark.parametrize(
    ("make", "word"),
    [
        (lambda: VoxelGrid((0, 2, 2), 0.1, 0.1), "shape"),
        (lambda: VoxelGrid((2, 2), 0.1, 0.1), "shape"),  # type: ignore[arg-type]
        (lambda: VoxelGrid((2, 2, 2), -0.1, 0.1), "horizontal_size"),
        (lambda: VoxelGrid((2, 2, 2), 0.1, float("nan")), "vertical_size"),
        (lambda: VoxelGrid((2, 2, 2), 0.1, 0.1, (0, 0)), "origin"),
        (lambda: VoxelGrid.cover((10.0, 10.0), 2.0, 0.3), "divide"),
        (lambda: VoxelGrid.cover((10.0, 10.0), 2.0, 0.0), "divide"),
        (lambda: VoxelGrid.cover((10.0, 10.0), 0.0, 0.1), "top"),
    ],
)
@pytest.mark.untyped
def test_bad_grids(make: object, word: str) -> None:
    with pytest.raises(InputError, match=word):
        make()  # type: ignore[operator]


def test_bad_deposits() -> None:
    positions, area, classes = elements(10)
    grid = VoxelGrid.cover(EXTENT, 2.0, 0.5)
    with pytest.raises(InputError, match="boundary"):
        deposit(positions, area, classes, grid, 3, boundary="closed")  # type: ignore[arg-type]
    with pytest.raises(InputError, match="class_index"):
        deposit(positions, area, classes, grid, 2)
    with pytest.raises(InputError, match="larger voxels"):
        deposit(positions, area, classes, VoxelGrid((9999, 9999, 99), 0.1, 0.1), 3)


@pytest.mark.parametrize("boundary", ["periodic", "open"])
def test_boxes_of_one_width_give_coarse_grids_the_means_of_fine_ones(boundary: str) -> None:
    rng = np.random.default_rng(4)
    positions = jnp.asarray(rng.random((200, 3)) * [1.0, 0.8, 0.4])
    area, classes = jnp.asarray(rng.random(200)), jnp.asarray(rng.integers(0, 2, 200))
    fine, coarse = (
        deposit(
            positions,
            area,
            classes,
            VoxelGrid((round(1.0 / size), round(0.8 / size), round(0.4 / size)), size, size),
            2,
            width=0.1,
            boundary=boundary,
        )
        for size in (0.05, 0.2)
    )
    blocks = fine.reshape(2, 2, 4, 4, 4, 5, 4).mean(axis=(2, 4, 6))
    np.testing.assert_allclose(blocks, coarse, atol=1e-12)
    if boundary == "periodic":
        assert float(coarse.sum() * 0.2**3) == pytest.approx(float(area.sum()), rel=1e-12)


def test_a_box_spreads_over_the_voxels_that_it_covers() -> None:
    grid = VoxelGrid((6, 6, 6), 0.1, 0.1)
    density = deposit(
        jnp.array([[0.33, 0.25, 0.3]]), jnp.ones(1), jnp.zeros(1, int), grid, 1, width=0.3
    )[0]
    share = density * 0.1**3
    np.testing.assert_allclose(
        share.sum(axis=(0, 1)), [0, 0.2 / 3, 1 / 3, 1 / 3, 0.8 / 3, 0], atol=1e-12
    )
    np.testing.assert_allclose(share.sum(axis=(0, 2)), [0, 1 / 3, 1 / 3, 1 / 3, 0, 0], atol=1e-12)


@pytest.mark.parametrize(("height", "layer"), [(3.0, 3), (2.2, 3), (-1.0, 0), (-0.6, 0)])
def test_a_wide_box_beyond_an_end_stays_at_that_end(height: float, layer: int) -> None:
    grid = VoxelGrid((4, 4, 4), 0.5, 0.5)
    positions = jnp.array([[1.0, 1.0, height]])
    density = deposit(positions, jnp.ones(1), jnp.zeros(1, int), grid, 1, width=1.0)[0]
    share = np.asarray(density.sum(axis=(1, 2)) * grid.voxel_volume)
    assert share[layer] == pytest.approx(1.0 if abs(height - 1.0) > 1.5 else share[layer])
    assert share.sum() == pytest.approx(1.0)
    assert share[3 - layer] == 0.0


def test_slopes_of_wide_and_narrow_boxes() -> None:
    rng = np.random.default_rng(6)
    positions, area = jnp.asarray(rng.random((40, 3)) * 0.8), jnp.asarray(rng.random(40))
    towards, weights = jnp.asarray(rng.standard_normal((40, 3))), rng.random((1, 4, 4, 4))
    for width in (0.08, 0.4):

        def loss(by: float, width: float = width) -> jax.Array:
            field = deposit(
                positions + by * towards,
                area,
                jnp.zeros(40, int),
                VoxelGrid((4, 4, 4), 0.2, 0.2),
                1,
                width=width,
            )
            return (weights * field).sum()

        step = 1e-7
        difference = (loss(step) - loss(-step)) / (2 * step)
        assert float(jax.grad(loss)(0.0)) == pytest.approx(float(difference), rel=1e-4)


def test_a_width_that_does_not_go_with_the_voxels_is_refused() -> None:
    for width in (0.15, 0.0, -1.0):
        with pytest.raises(InputError, match="whole multiple"):
            deposit(
                jnp.zeros((1, 3)), jnp.ones(1), jnp.zeros(1, int), VoxelGrid((4, 4, 4), 0.1, 0.1),
                1, width=width,
            )  # fmt: skip

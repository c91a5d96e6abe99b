"""Moves of light from layer to layer, and their transposes."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from fynjax.radiation._multiple import cells_of, prepare_transport
from fynjax.radiation._ordinates import Ordinates, _shift
from fynjax.radiation._render import Accuracy, follow_sun
from tests.radiation.scenes import patchy

SIZE = 2, 3, 4, 5
MOVE = np.random.default_rng(0).uniform(-1.0, 1.0, (2, *SIZE[:2]))


def matrix(share, size, periodic):
    """Matrix of a move along one axis, and what comes in from outside."""
    inside, entering = np.zeros((size, size)), np.zeros(size)
    step = 1 if share > 0.0 else -1
    for cell in range(size):
        inside[cell, cell] += 1.0 - abs(share)
        before = cell - step
        if periodic or 0 <= before < size:
            inside[cell, before % size] += abs(share)
        else:
            entering[cell] += abs(share)
    return inside, entering


@pytest.mark.parametrize("boundary", ["periodic", "open"])
def test_a_move_is_a_product_and_its_transpose_that_of_the_matrix(boundary):
    chance = np.random.default_rng(1)
    field, back = (jnp.asarray(chance.normal(size=SIZE)) for _ in range(2))
    outside = jnp.asarray(chance.normal(size=SIZE[:2]))
    move = lambda x, o: _shift(x, MOVE, o, boundary)  # noqa: E731
    moved = jax.jit(move)(field, outside)
    transposed, around = jax.linear_transpose(move, field, outside)(back)
    many = jax.vmap(move, (3, 0))(jnp.stack([0.0 * field, field], 3), jnp.stack([outside] * 2))
    for i, j in np.ndindex(SIZE[:2]):
        (x, from_x), (y, from_y) = (
            matrix(MOVE[axis, i, j], size, boundary == "periodic")
            for axis, size in ((0, SIZE[3]), (1, SIZE[2]))
        )
        entered = y @ np.broadcast_to(from_x, SIZE[2:]) + from_y[:, None]
        expected = y @ np.asarray(field[i, j]) @ x.T + outside[i, j] * entered
        np.testing.assert_allclose(moved[i, j], expected, atol=1e-14)
        np.testing.assert_allclose(many[1, i, j], expected, atol=1e-14)
        np.testing.assert_allclose(transposed[i, j], y.T @ np.asarray(back[i, j]) @ x, atol=1e-14)
        assert float(around[i, j]) == pytest.approx(float(np.sum(entered * back[i, j])), abs=1e-13)


@pytest.mark.parametrize("boundary", ["periodic", "open"])
def test_a_sweep_and_its_transpose_are_one_form(boundary):
    """<y, A x> = <A' y, x>, and A' as the columns of A, one by one, have it."""
    scene, ordinates, factor = patchy(boundary), Ordinates.create(2, 4), (2, 2)
    accuracy = Accuracy(lattice=1, sublayers=1, margin=4)
    cells = cells_of(scene, follow_sun(scene, accuracy, 4 * (boundary == "open")), factor)
    transport, bands = prepare_transport(scene, cells, factor, ordinates)
    band = jax.tree.map(lambda of_bands: of_bands[0], bands)

    def swept(source, sky, sun):
        return transport.light(source, sky, sun, band.ground, band.shape)

    chance = np.random.default_rng(2)
    draw = lambda like: jnp.asarray(chance.normal(size=like.shape), like.dtype)  # noqa: E731
    x = draw(jnp.zeros(transport.shape, band.sky.dtype)), draw(band.sky), draw(band.sun)
    seen = jax.jit(swept)(*x)
    y = jax.tree.map(draw, seen)
    back = jax.jit(lambda y: jax.linear_transpose(swept, *x)(y))(y)
    product = lambda a, b: sum(map(jnp.vdot, jax.tree.leaves(a), jax.tree.leaves(b)))  # noqa: E731
    assert float(product(y, seen)) == pytest.approx(float(product(back, x)), rel=1e-12)
    for place in (0, 7, transport.shape[0] * 3 + 1):
        unit = jnp.zeros(transport.shape, x[0].dtype).ravel().at[place].set(1.0)
        column = jax.jit(swept)(unit.reshape(transport.shape), 0.0 * x[1], 0.0 * x[2])
        assert float(product(y, column)) == pytest.approx(float(back[0].ravel()[place]), rel=1e-10)

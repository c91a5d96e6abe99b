"""Checks that several test files share."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree


def assert_gradients(
    function: Callable[[Any], Any],
    at: Any,
    *,
    step: float = 1e-6,
    rtol: float = 1e-6,
    seed: int = 0,
) -> None:
    """Compare reverse- and forward-mode AD of `function` with central differences.

    The outputs are contracted to one scalar first, and the comparison is made along each
    coordinate axis of `at` with a step relative to the coordinate's size, so that a single
    wrong derivative cannot hide behind many right ones.
    """
    flat, unravel = ravel_pytree(at)
    flat = np.asarray(flat, float)
    out, _ = ravel_pytree(function(at))
    weight = np.random.default_rng(seed).normal(size=out.shape)

    def scalar(vector: Any) -> Any:
        return jnp.asarray(weight) @ ravel_pytree(function(unravel(jnp.asarray(vector))))[0]

    reverse = np.asarray(jax.grad(scalar)(flat))
    forward = np.asarray(jax.jacfwd(scalar)(flat))
    assert np.all(np.isfinite(reverse)), "a reverse-mode derivative is not finite"
    differences = np.empty_like(flat)
    for index in range(flat.size):
        h = step * max(abs(flat[index]), 1e-3)
        up, down = flat.copy(), flat.copy()
        up[index] += h
        down[index] -= h
        differences[index] = (scalar(up) - scalar(down)) / (2 * h)
    scale = np.abs(differences) + 1e-9 * np.abs(differences).max()
    worst = np.abs(reverse - differences) / scale
    assert worst.max() < rtol, (
        f"AD and differences disagree by {worst.max():.2e} at {worst.argmax()}"
    )
    np.testing.assert_allclose(forward, reverse, rtol=1e-8, atol=1e-12 * np.abs(reverse).max())

"""A linear model with a normal prior, whose posterior is known in closed form."""

import jax.numpy as jnp
import numpy as np

from fynjax.inversion import Data, ParameterSpace

# Bounds so wide that they cut nothing.
SPACE = ParameterSpace(
    ("a.cover", "b.cover", "c.cover"),
    jnp.full(3, -1e4),
    jnp.full(3, 1e4),
    jnp.array([1.0, 2.0, 3.0]),
    jnp.array([0.5, 1.0, 2.0]),
    distribution="normal",
)
MATRIX = jnp.array([[1.0, 1.0, 0.0], [0.0, 2.0, 0.0], [1.0, -1.0, 0.0], [3.0, 0.0, 0.0]])
DATA = Data(tuple("stuv"), jnp.array([3.5, 5.0, -1.2, 3.6]), jnp.array([0.1, 0.3, 0.2, 0.5]))


def predict(x):
    """Nothing depends on the third parameter."""
    return MATRIX @ x


def posterior():
    """Mean and covariance by the normal equations."""
    prior = np.diag(1.0 / np.asarray(SPACE.prior_sd) ** 2)
    weight = np.diag(1.0 / np.asarray(DATA.sd) ** 2)
    a = np.asarray(MATRIX)
    covariance = np.linalg.inv(prior + a.T @ weight @ a)
    right = prior @ np.asarray(SPACE.prior) + a.T @ weight @ np.asarray(DATA.value)
    return covariance @ right, covariance

"""From cells to voxels: linear interpolation against scipy's, and what must be kept."""

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.interpolate import RegularGridInterpolator

from fynjax.radiation._blocks import block_mean, spread, upsample


@pytest.mark.parametrize("boundary", ["periodic", "open"])
@pytest.mark.parametrize("factor", [(1, 2), (2, 1), (3, 4)])
def test_upsampling_is_linear_between_the_centres(boundary, factor):
    field = np.random.default_rng(0).normal(size=(3, 4, 5))
    mode = "wrap" if boundary == "periodic" else "edge"
    wide = np.pad(np.pad(field, [(1, 1), (0, 0), (0, 0)], "edge"), [(0, 0), (1, 1), (1, 1)], mode)
    cells = tuple(np.arange(n) - 0.5 for n in wide.shape)
    fine = [
        (np.arange(n * f) + 0.5) / f for n, f in zip(field.shape, (factor[0], factor[1], factor[1]))
    ]
    want = RegularGridInterpolator(cells, wide)(np.stack(np.meshgrid(*fine, indexing="ij"), -1))
    got = upsample(jnp.asarray(field)[None], factor, boundary)[0]
    np.testing.assert_allclose(got, want, atol=1e-12)


def test_means_of_blocks_undo_spreading():
    field = jnp.asarray(np.random.default_rng(1).normal(size=(2, 3, 4, 5)))
    np.testing.assert_allclose(block_mean(spread(field, (2, 3)), (2, 3)), field, rtol=1e-12)

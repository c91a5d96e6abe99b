"""What pixels of a plot are off by because shapes of its plants are not known."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from fynjax._core.errors import InputError
from fynjax.inversion._data import DARKEST, block_means
from fynjax.scene import AimedSensor, Crowns, Scene, hard_instances

OUTLINE = {"diameter": 0.07, "height": 0.12}
"""What sizes of a plant whose place and species are right are off by, since lobes and shoots of its
like differ: standard deviations of their logarithms [-]. An assumption, after twins of the search
for plants."""


def scale_of(target: Float[Array, "band y x"]) -> Float[Array, "band y x"]:
    """What errors of reflectance are shares of: half of it is the block's and half the band's mean,
    since shade in which little is reflected is as uncertain as what throws it."""
    mean = jnp.nanmean(target, axis=(1, 2), keepdims=True)
    return jnp.maximum(0.5 * (target + mean), DARKEST)


@eqx.filter_jit
def _plain_image(scene: Scene, camera: AimedSensor) -> Float[Array, "band y x"]:
    return camera.image(scene.voxels(scene.parameters, camera.sensor.bands))[0]


def shape_error(
    scene: Scene, camera: AimedSensor, *, block: int = 1, widest: int = 4, seed: int = 0
) -> tuple[Float[np.ndarray, "band band"], float]:
    """What pixels of a plot differ by where its plants have other shapes of their growth forms.

    Lobes and shoots of a plant are not known though its crown is: this, not the camera's noise, is
    the error of most pixels. Bands have most of it in common.

    **Arguments:** `scene`, as it was built; `camera`; `block`, pixels along the edge of the
    blocks that are compared; `widest`, blocks over which these may err alike; `seed` of shapes.

    **Returns:** covariance of the relative errors of the bands (shares of `scale_of`), and how
    many blocks err as one [-]. Not differentiable.
    """
    stand = hard_instances(scene, scene.parameters)
    feet = np.stack([stand.x, stand.y], axis=1)
    crowns = Crowns(stand.species, feet, stand.diameter, stand.height)
    each = (_plain_image(scene.with_plants(crowns, seed=seed + i), camera) for i in (1, 2))
    pair = [block_means(image, block) for image in each]
    off = np.asarray((pair[0] - pair[1]) / scale_of(0.5 * (pair[0] + pair[1])), float)
    off /= np.sqrt(2.0)
    if off[0].size < 2:
        raise InputError(
            "expected two blocks of pixels or more, by which errors of shapes are known: take a "
            "smaller `block`, or state `pixel_sd`"
        )
    covariance = np.cov(off.reshape(len(off), -1))
    wide = max(1, min(widest, min(off.shape[1:]) // 4))
    ny, nx = (n // wide for n in off.shape[1:])
    means = off[:, : ny * wide, : nx * wide].reshape(len(off), ny, wide, nx, wide).mean(axis=(2, 4))
    ratio = wide**2 * means.var(axis=(1, 2)).sum() / max(off.var(axis=(1, 2)).sum(), 1e-12)
    return np.atleast_2d(covariance), float(np.clip(ratio, 1.0, wide**2))

"""Statistics of an image by name: what a calibration compares."""

import re
from collections.abc import Sequence

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from fynjax._core.errors import InputError
from fynjax.metrics._distribution import mean, quantiles, standard_deviation
from fynjax.metrics._indices import BANDS, VEGETATION_INDICES, smooth_vegetation_indices

_NAME = re.compile(r"^(?P<layer>[A-Za-z]\w*)\.(?P<kind>mean|std|q(?P<percent>\d{1,2}))$")


def check_statistics(names: Sequence[str]) -> None:
    """Check the names of image statistics.

    **Arguments:**

    - `names`: such as "nir.mean" (see `image_statistics`).

    **Raises:** `InputError` for a name that is no statistic of a band or an index.
    """
    for name in names:
        match = _NAME.match(name)
        if match is None or match["layer"] not in (*BANDS, *VEGETATION_INDICES):
            raise InputError(
                "a statistic must be '<band or index>.<mean|std|qNN>' with a band of "
                f"{', '.join(BANDS)} or an index of table 4, but is {name!r}"
            )


def image_statistics(
    image: Float[Array, "band y x"],
    names: Sequence[str],
    valid: Bool[Array, "y x"] | None = None,
) -> Float[Array, " statistic"]:
    """Statistics of bands and vegetation indices over the pixels of an image.

    **Arguments:**

    - `image`: reflectance [-] of the bands green, red, red_edge, nir, in this order.
    - `names`: "band or index", a dot, and "mean", "std" or "qNN" (a percentile, 00 to 99), such as
      "nir.mean", "NDVI.std", "GCI.q25".
    - `valid`: true where a pixel counts; all unless given.

    **Returns:** one value for each name, in the unit of its band or index.

    **Raises:** `InputError` for an unknown name.

    Indices are the smooth ones, which are finite in black pixels; pixels where an index is
    undefined are left out of its statistics. Differentiable in `image`.

    >>> import jax.numpy as jnp
    >>> from fynjax.metrics import image_statistics
    >>> image = jnp.array([0.06, 0.05, 0.15, 0.35])[:, None, None] * jnp.ones((4, 3, 3))
    >>> image_statistics(image, ["nir.mean", "NDVI.q50"]).round(3)
    Array([0.35, 0.75], dtype=float64)
    """
    check_statistics(names)
    indices = list(
        dict.fromkeys(
            layer for layer in (name.split(".")[0] for name in names) if layer not in BANDS
        )
    )
    every = jnp.ones(image.shape[1:], bool) if valid is None else valid
    layers = {band: (image[i], every) for i, band in enumerate(BANDS)}
    if indices:
        values, defined = smooth_vegetation_indices(image, indices)
        for i, index in enumerate(indices):
            layers[index] = (values[i], defined[i] & every)
    statistics = []
    for name in names:
        match = _NAME.match(name)
        assert match is not None  # by check_statistics
        layer, mask = layers[match["layer"]]
        if match["kind"] == "mean":
            statistics.append(mean(layer, mask))
        elif match["kind"] == "std":
            statistics.append(standard_deviation(layer, mask))
        else:
            share = jnp.asarray([int(match["percent"]) / 100.0], layer.dtype)
            statistics.append(quantiles(layer, share, mask)[0])
    return jnp.stack(statistics)

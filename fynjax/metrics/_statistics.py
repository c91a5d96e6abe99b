"""Statistics of an image by name: what a calibration compares."""

import re
from collections.abc import Iterable, Sequence

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from fynjax._core.errors import InputError, did_you_mean, listed
from fynjax.metrics._distribution import mean, quantiles, standard_deviation
from fynjax.metrics._indices import BANDS, Bands, band_names, index_bands, smooth_vegetation_indices

_NAME = re.compile(
    r"^(?P<layer>[A-Za-z]\w*)\.(?P<kind>mean|std(?P<block>\d{1,4}cm)?|q(?P<percent>\d{1,2}))$"
)


def check_statistics(names: Sequence[str], bands: Bands = BANDS) -> None:
    """Check the names of image statistics.

    **Arguments:**

    - `names`: such as "nir.mean" (see `image_statistics`).
    - `bands`: of the image, as `vegetation_indices` takes them.

    **Raises:** `InputError` for a name that is no statistic of a band or of an index of the bands.
    """
    own, indices = band_names(bands), index_bands(bands)
    for name in names:
        match = _NAME.match(name)
        if match is None or match["layer"] not in (*own, *indices):
            layer, _, kind = name.partition(".")
            alike = [f"{one}.{kind or 'mean'}" for one in (*own, *indices)]
            raise InputError(
                "a statistic must be '<band or index>.<mean|std|stdNNcm|qNN>' with a band of "
                f"{', '.join(own)} or an index that these give ({listed(indices) or 'none'}), but "
                f"is {name!r}.{did_you_mean(name, alike) if layer else ''}"
            )


def bands_needed(layers: Iterable[str], bands: Bands = BANDS) -> set[str]:
    """Names of those of `bands` that are among `layers`, or that an index among `layers` takes."""
    own, indices = band_names(bands), index_bands(bands)
    taken = (name for one in layers for names in indices.get(one, {}).values() for name in names)
    return set(own) & {*layers, *taken}


def fitting_statistics(names: Sequence[str], side: float, pixel: float) -> list[str]:
    """Statistics among `names` that an image with the shorter `side` and pixels of `pixel` has [m]:
    squares of a standard deviation are at least a pixel wide, and four fit along the side."""
    blocks = {name: match["block"] for name in names if (match := _NAME.match(name))}
    width = {n: 0.01 * float(b.removesuffix("cm")) for n, b in blocks.items() if b}
    return [n for n in names if n not in width or pixel <= width[n] <= 0.25 * side]


def image_statistics(
    image: Float[Array, "band y x"],
    names: Sequence[str],
    valid: Bool[Array, "y x"] | None = None,
    *,
    pixel: float | None = None,
    window: float | None = None,
    bands: Bands = BANDS,
) -> Float[Array, " statistic"]:
    """Statistics of bands and vegetation indices over the pixels of an image.

    **Arguments:**

    - `image`: reflectance [-] of `bands`.
    - `names`: "band or index", a dot, and "mean", "std", "qNN" (a percentile, 00 to 99) or
      "stdNNcm" (the standard deviation of means over squares of NN cm), such as "nir.mean",
      "NDVI.std", "GCI.q25", "nir.std40cm".
    - `valid`: true where a pixel counts; all unless given.
    - `pixel`: edge of a pixel [m], for standard deviations over squares. These are as many whole
      pixels wide as come nearest; squares that the image's edge cuts are left out.
    - `window`: of percentiles, as `quantiles` has it [-]; left out, values are exact and
      derivatives those of means over a twentieth of the pixels.
    - `bands`: of the image, in their order, as `vegetation_indices` takes them; of a sensor, or
      by their names.

    **Returns:** one value for each name, in the unit of its band or index.

    **Raises:** `InputError` for an unknown name, and for squares without `pixel` or of which fewer
    than two lie along a side of the image.

    How the standard deviation falls from square to larger square is the image's spatial covariance,
    by which crowns and gaps of different width differ (Woodcock & Strahler 1987).

    Indices are the smooth ones, which are finite in black pixels; pixels where an index is
    undefined are left out of its statistics.

    Differentiable in `image`. Means and standard deviations are sums over all pixels and have their
    own derivative. A percentile lies on one or two pixels, whose slope by a parameter is chance: it
    alone needs the window. For the 95th percentile of NDVI by the diameter of the plants of a plot
    of 2 m with 1600 pixels the slope of one planting has a standard deviation of 0.12 with it, 0.16
    without, and for the median 0.17 and 0.22; what is left is the planting's own.

    >>> import jax.numpy as jnp
    >>> from fynjax.metrics import image_statistics
    >>> image = jnp.array([0.06, 0.05, 0.15, 0.35])[:, None, None] * jnp.ones((4, 3, 3))
    >>> image_statistics(image, ["nir.mean", "NDVI.q50"]).round(3)
    Array([0.35, 0.75], dtype=float32)
    """
    check_statistics(names, bands)
    own = band_names(bands)
    named = dict.fromkeys(name.split(".")[0] for name in names)
    indices = [layer for layer in named if layer not in own]
    every = jnp.ones(image.shape[1:], bool) if valid is None else valid
    layers = {band: (image[i], every) for i, band in enumerate(own)}
    if indices:
        values, defined = smooth_vegetation_indices(image, indices, bands)
        for i, index in enumerate(indices):
            layers[index] = (values[i], defined[i] & every)
    statistics = []
    for name in names:
        match = _NAME.match(name)
        assert match is not None  # by check_statistics
        layer, mask = layers[match["layer"]]
        if match["kind"] == "mean":
            statistics.append(mean(layer, mask))
        elif match["block"]:
            side = _side(match["block"], pixel, layer.shape)
            statistics.append(standard_deviation(*_square_means(layer, mask, side)))
        elif match["kind"] == "std":
            statistics.append(standard_deviation(layer, mask))
        else:
            share = jnp.asarray([int(match["percent"]) / 100.0], layer.dtype)
            statistics.append(quantiles(layer, share, mask, window=window)[0])
    return jnp.stack(statistics)


def _side(block: str, pixel: float | None, shape: tuple[int, ...]) -> int:
    """Pixels along the edge of a square."""
    if pixel is None:
        raise InputError(f"`pixel` must be known for a standard deviation over squares of {block}")
    side = max(round(0.01 * float(block.removesuffix("cm")) / pixel), 1)
    if side > min(shape) // 2:
        raise InputError(
            f"fewer than two squares of {block} lie along a side of an image of "
            f"{shape[1]} x {shape[0]} pixels of {pixel:g} m: take smaller squares"
        )
    return side


def _square_means(
    layer: Float[Array, "y x"], valid: Bool[Array, "y x"], side: int
) -> tuple[Float[Array, "row column"], Bool[Array, "row column"]]:
    """Means over squares of `side` pixels, and whether at least half of their pixels count: the
    mean of fewer scatters more."""
    rows, columns = (n // side for n in layer.shape)
    # Squares that the edge cuts are left out.
    cut = (slice(rows * side), slice(columns * side))
    shape = (rows, side, columns, side)
    weight = valid[cut].reshape(shape)
    total = jnp.sum(jnp.where(weight, layer[cut].reshape(shape), 0.0), axis=(1, 3))
    count = weight.sum(axis=(1, 3))
    return total / jnp.maximum(count, 1), 2 * count >= side**2


def without_view(name: str) -> str:
    """The `name` of a statistic without that of its view: "nir.mean" of "flight1.nir.mean"."""
    first, _, rest = name.partition(".")
    return rest if "." in rest and first not in ("spectrum", "lidar") else name

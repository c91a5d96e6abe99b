"""Spectral diversity: how much the pixels of an image, or of each of its windows, differ."""

from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import xarray as xr
from jaxtyping import Array, Bool, Float, Shaped
from numpy.typing import ArrayLike

from fynjax._core.errors import InputError
from fynjax._core.math import square_root
from fynjax._core.seeds import generator
from fynjax.diversity._components import hull_volume, principal_components
from fynjax.metrics import spectral_angle

Spectra = Float[Array, "*window pixel band"]
PerWindow = Float[Array, "*window"]
VARIETY = ("cv", "angle", "rao", "variance")
"""Names of what `spectral_variety` gives."""
_RAO_PIXELS = 1000
"""Pixels of which `spectral_variety` takes Rao's Q, at most: it compares each with each."""


def windows(image: ArrayLike, size: int) -> Shaped[Array, "row column pixel band"]:
    """Cut an image into square windows, so that each is a set of pixels.

    Maps of covers, [species, y, x], too: `windows(cover, 10).mean(axis=2)` has the covers of each
    window, for `hill_partition` and its like.

    **Arguments:**

    - `image`: [band, y, x].
    - `size`: side of a window [pixels]. What is left over at the far edges belongs to none.

    **Returns:** windows and their pixels in the order of the image's axes.

    **Raises:** `InputError` for an array that is no image, and for a window larger than it.

    Differentiable.

    >>> import jax.numpy as jnp
    >>> from fynjax.diversity import windows
    >>> windows(jnp.zeros((5, 9, 6)), 3).shape
    (3, 2, 9, 5)
    """
    data = jnp.asarray(image)
    if data.ndim != 3 or data.size == 0:
        raise InputError(f"`image` must be [band, y, x], but has shape {data.shape}")
    if int(size) != size or not 1 <= size <= min(data.shape[1:]):
        raise InputError(
            f"`size` must be a whole number from 1 to {min(data.shape[1:])} pixels, the image's "
            f"shorter side, but is {size}"
        )
    size, bands = int(size), data.shape[0]
    rows, columns = (side // size for side in data.shape[1:])
    data = data[:, : rows * size, : columns * size].reshape(bands, rows, size, columns, size)
    return jnp.transpose(data, (1, 3, 2, 4, 0)).reshape(rows, columns, size * size, bands)


def lit_pixels(spectra: ArrayLike, least: float) -> Bool[Array, "*pixel"]:
    """Which pixels are data and not in shade: those of a mean over bands of at least `least`.

    **Arguments:**

    - `spectra`: [..., band] reflectance [-]; give only the near infrared bands to judge by those.
    - `least`: of their mean [-], at least 0.

    **Returns:** true where a pixel counts; false for NaN and infinity. Not differentiable.

    **Raises:** `InputError` for a limit below 0, and where there are no bands.
    """
    data = _with_bands(spectra)
    if not least >= 0.0:
        raise InputError(f"`least` must be a reflectance of at least 0, but is {least:g}")
    return jnp.isfinite(data).all(axis=-1) & (jnp.mean(data, axis=-1) >= least)


def normalise_brightness(spectra: ArrayLike) -> Float[Array, "*pixel band"]:
    """Spectra over their length as vectors, so that their brightness no longer counts [-].

    **Arguments:** `spectra`: [..., band] of any unit.

    **Raises:** `InputError` for a spectrum that is zero in all bands, or without bands.

    Differentiable. NaN stays NaN.

    Source: Feilhauer et al. (2010), Journal of Applied Remote Sensing 4, 041514.
    """
    data = _with_bands(spectra)
    square = jnp.sum(data**2, axis=-1, keepdims=True)
    if not isinstance(data, jax.core.Tracer) and (square == 0.0).any():
        raise InputError("a spectrum that is zero in all bands has no shape: mask such pixels")
    return data / jnp.sqrt(square)


def coefficient_of_variation(
    spectra: ArrayLike, valid: ArrayLike | None = None, *, freedom: int = 1
) -> PerWindow:
    """Coefficient of variation among pixels, mean over bands [-].

    CV = mean_b(sd_b / mean_b). Tools differ in the standard deviation: R divides by the number of
    pixels less 1 (the default here), NumPy by the number (`freedom=0`).

    **Arguments:**

    - `spectra`: [..., pixel, band] reflectance or radiance.
    - `valid`: [..., pixel] true where a pixel counts; all unless given. Others may be NaN.
    - `freedom`: what is taken off the number of pixels, 0 or 1.

    **Returns:** [...] for each window.

    **Raises:** `InputError` for arrays that do not fit, for a window with fewer than two pixels
    that count, for NaN or infinity in one, and for a band whose mean is not positive. Inside
    `jax.jit` and `jax.grad` values cannot be looked at.

    Differentiable in `spectra`; a band that is the same in all pixels has the slope 0.

    Source: Wang et al. (2018), Ecological Applications 28, 541.

    >>> from fynjax.diversity import coefficient_of_variation
    >>> round(float(coefficient_of_variation([[0.1, 0.3], [0.3, 0.3]])), 4)  # sqrt(1 / 2) / 2
    0.3536
    """
    data, keep, count = _checked(spectra, valid)
    mean = jnp.sum(data, axis=-2) / count[..., None]
    if not isinstance(mean, jax.core.Tracer) and not (mean > 0.0).all():
        raise InputError("a coefficient of variation needs bands whose mean is positive")
    off = jnp.where(keep[..., None], data - mean[..., None, :], 0.0)
    variance = jnp.sum(off**2, axis=-2) / (count[..., None] - freedom)
    return jnp.mean(square_root(variance) / mean, axis=-1)


def mean_spectral_angle(spectra: ArrayLike, valid: ArrayLike | None = None) -> PerWindow:
    """Mean angle between each pixel's spectrum and the mean spectrum [degree].

    **Arguments:** `spectra`, `valid`, and errors, as for `coefficient_of_variation`, but that band
    means may be negative.

    **Returns:** [...] for each window; NaN where a spectrum is zero in all bands.

    Differentiable in `spectra`; a pixel that is the mean itself has the slope 0.

    Source: the angle of Kruse et al. (1993), Remote Sensing of Environment 44, 145.
    """
    data, keep, count = _checked(spectra, valid)

    def one(x: Array, counts: Array, number: Array) -> Array:
        # Pixels that do not count take the mean, whose angle is 0, lest theirs be undefined.
        mean = jnp.sum(x, axis=0) / number
        angle = jax.vmap(spectral_angle, (0, None))(jnp.where(counts[:, None], x, mean), mean)
        return jnp.sum(jnp.where(counts, angle, 0.0)) / number

    return _each(one, data, keep, count)


def spectral_rao(spectra: ArrayLike, valid: ArrayLike | None = None) -> PerWindow:
    """Rao's Q of spectra: mean Euclidean distance of two pixels, in the spectra's unit.

    Q = sum_ij d_ij / n^2 over all ordered pairs, a pixel with itself too, d_ij^2 = sum_b (x_ib -
    x_jb)^2. It is `paRao` of rasterdiv in several dimensions with alpha 1, but that masked pixels
    do not enter n here. More bands make it larger: compare only what has the same bands.

    **Arguments:** `spectra`, `valid`, and errors, as for `mean_spectral_angle`.

    **Returns:** [...] for each window.

    Differentiable in `spectra`; two equal pixels have the slope 0 in their distance.

    Source: Rocchini et al. (2017), Ecological Indicators 72, 234.

    >>> from fynjax.diversity import spectral_rao
    >>> float(spectral_rao([[0.0, 0.0], [3.0, 4.0]]))  # 2 * 5 / 4
    2.5
    """
    data, keep, count = _checked(spectra, valid)

    def one(x: Array, counts: Array, number: Array) -> Array:
        @jax.checkpoint  # else a gradient holds every difference of two pixels in memory
        def from_one(pixel: Array) -> Array:
            return jnp.sum(jnp.where(counts, square_root(jnp.sum((x - pixel) ** 2, axis=-1)), 0.0))

        return jnp.sum(jnp.where(counts, jax.lax.map(from_one, x), 0.0)) / number**2

    return _each(one, data, keep, count)


def spectral_variety(
    spectra: ArrayLike, *, seed: int | np.random.Generator = 0
) -> dict[str, float]:
    """Usual metrics of the spectra of a plot: `cv`, the coefficient of variation [-];
    `angle`, the mean angle to the mean spectrum [degree]; `rao`, Rao's Q, of at most a thousand
    pixels; and `variance`, summed over bands.

    **Arguments:** `spectra`: [pixel, band], finite; `seed`: of the choice of pixels for Rao's Q.

    **Returns:** by name; NaN of fewer than two pixels. Not differentiable.

    **Raises:** `InputError` as `coefficient_of_variation`.
    """
    data = np.asarray(spectra)
    if len(data) < 2:
        return dict.fromkeys(VARIETY, np.nan)
    random = seed if isinstance(seed, np.random.Generator) else generator(seed)
    some = random.permutation(len(data))[:_RAO_PIXELS]
    return {
        "cv": float(coefficient_of_variation(data)),
        "angle": float(mean_spectral_angle(data)),
        "rao": float(spectral_rao(data[some])),
        "variance": float(data.var(axis=0, ddof=1).sum()),
    }


class SpectralPartition(eqx.Module):
    """Sums of squares of spectra within sites, between them and of all: gamma = alpha + beta.

    In the squared unit of the spectra, but for what is a share.
    """

    alpha: PerWindow
    """[site] Sum of squares within each site."""
    beta: Float[Array, ""]
    """Sum of squares between sites."""
    gamma: Float[Array, ""]
    """Sum of squares of all pixels."""
    alpha_diversity: PerWindow
    """[site] Alpha over the site's number of pixels less 1, its variance summed over bands."""
    beta_diversity: Float[Array, ""]
    """Beta over the number of all pixels less 1."""
    gamma_diversity: Float[Array, ""]
    """Gamma over the number of all pixels less 1."""
    site_share: PerWindow
    """[site] Share of each site in beta (LCSD): how far its mean is from that of all."""
    alpha_band_share: Float[Array, "*site band"]
    """[site, band] Share of each band in a site's alpha (FCSD)."""
    beta_band_share: Float[Array, " band"]
    """Share of each band in beta (FCSD)."""
    gamma_band_share: Float[Array, " band"]
    """Share of each band in gamma (FCSD)."""


def spectral_partition(spectra: ArrayLike, valid: ArrayLike | None = None) -> SpectralPartition:
    """Part the spectral diversity of an image into that within sites and that between them.

    With the spectra x_ij of pixel i in site j, the mean m_j of n_j pixels, and the mean m of all:
    alpha_j = sum_i |x_ij - m_j|^2, beta = sum_j n_j |m_j - m|^2, and gamma = sum_ij |x_ij - m|^2 is
    their sum. The authors' R functions draw as many pixels in every site as the poorest has; here
    all pixels count, so that sites with more weigh more unless `valid` says otherwise.

    **Arguments:**

    - `spectra`: [..., pixel, band]; all axes before the pixels are sites (`windows`). Raw,
      `normalise_brightness`, or the scores of `principal_components`.
    - `valid`: [..., pixel] true where a pixel counts; all unless given. Others may be NaN.

    **Returns:** a `SpectralPartition`; a share of nothing is NaN.

    **Raises:** `InputError` as `mean_spectral_angle`, and for one site only.

    Differentiable in `spectra`.

    Source: Laliberté, Schweiger and Legendre (2020), Ecology Letters 23, 370.
    """
    data, keep, count = _checked(spectra, valid)
    if count.size < 2:
        raise InputError(f"expected spectra of two sites or more, but got shape {data.shape}")
    # Sums of squares: within sites, of their means about that of all, of all pixels about it.
    sites = tuple(range(count.ndim))
    mean = jnp.sum(data, axis=-2) / count[..., None]
    all_pixels = jnp.sum(count)
    centre = jnp.sum(count[..., None] * mean, axis=sites) / all_pixels
    off = jnp.where(keep[..., None], data - mean[..., None, :], 0.0)
    within = jnp.sum(off**2, axis=-2)
    between = count[..., None] * (mean - centre) ** 2
    of_all = jnp.sum(jnp.where(keep[..., None], data - centre, 0.0) ** 2, axis=(*sites, -2))
    alpha, beta, gamma = jnp.sum(within, axis=-1), jnp.sum(between), jnp.sum(of_all)
    return SpectralPartition(
        alpha=alpha,
        beta=beta,
        gamma=gamma,
        alpha_diversity=alpha / (count - 1.0),
        beta_diversity=beta / (all_pixels - 1.0),
        gamma_diversity=gamma / (all_pixels - 1.0),
        site_share=jnp.sum(between, axis=-1) / beta,
        alpha_band_share=within / alpha[..., None],
        beta_band_share=jnp.sum(between, axis=sites) / beta,
        gamma_band_share=of_all / gamma,
    )


def diversity_map(
    image: ArrayLike,
    size: int,
    *,
    valid: ArrayLike | None = None,
    least_share: float = 0.5,
    components: int = 3,
    pixel: float = 1.0,
) -> xr.Dataset:
    """Spectral diversity of an image, window by window.

    **Arguments:**

    - `image`: [band, y, x] reflectance, or brightness-normalised spectra.
    - `size`: side of a window [pixels].
    - `valid`: [y, x] true where a pixel counts (`lit_pixels`); all unless given. Others may be NaN.
    - `least_share`: windows in which a smaller share of pixels counts are NaN; above 0 to 1.
    - `components`: principal components of all pixels, in which the hull is taken.
    - `pixel`: side of a pixel [m], for the coordinates.

    **Returns:** `coefficient_of_variation`, `spectral_variance` (alpha diversity of
    `spectral_partition`), `spectral_rao`, `mean_spectral_angle`, `hull_volume` and the number of
    `pixels`, over y and x, the centres of windows from the edges of row and column 0 [m]. Not
    differentiable; the functions that it calls are, but for the hull.

    **Raises:** `InputError` as those, for values out of range, and where no window has enough
    pixels.
    """
    cut = np.asarray(windows(image, size))
    if not 0.0 < least_share <= 1.0:
        raise InputError(f"`least_share` must be above 0 and at most 1, but is {least_share:g}")
    shape = np.shape(image)[1:]
    mask = np.ones(shape, bool) if valid is None else np.asarray(valid, bool)
    if mask.shape != shape:
        raise InputError(f"`valid` must have the image's shape {shape}, but has {mask.shape}")
    keep = np.asarray(windows(mask[None], size))[..., 0]
    count = keep.sum(axis=-1)
    # A hull needs a pixel more than components.
    used = count >= max(least_share * keep.shape[-1], components + 1)
    if not used.any():
        raise InputError(
            f"expected windows with at least {least_share:g} of their pixels and {components + 1} "
            f"in number, but the fullest has {count.max()} of {keep.shape[-1]}"
        )
    spectra, keep = cut[used], keep[used]
    some = principal_components(spectra[keep], components)
    hulls = [hull_volume(some.scores(x[k])) for x, k in zip(spectra, keep, strict=True)]
    data, counts, number = _checked(spectra, keep)
    # Alpha diversity of `spectral_partition`, which one window has too.
    mean = jnp.sum(data, axis=-2, keepdims=True) / number[:, None, None]
    square = jnp.sum(jnp.where(counts[..., None], data - mean, 0.0) ** 2, axis=(-2, -1))
    found = {
        "coefficient_of_variation": (
            coefficient_of_variation(spectra, keep),
            "coefficient of variation among pixels, mean over bands",
        ),
        "spectral_variance": (square / (number - 1.0), "variance among pixels, sum over bands"),
        "spectral_rao": (spectral_rao(spectra, keep), "mean distance of two pixels' spectra"),
        "mean_spectral_angle": (
            mean_spectral_angle(spectra, keep),
            "mean angle between a pixel's spectrum and the mean spectrum",
        ),
        "hull_volume": (hulls, f"volume of the convex hull in {components} principal components"),
    }
    variables = {}
    for name, (values, words) in found.items():
        layer = np.full(used.shape, np.nan)
        layer[used] = np.asarray(values)
        units = "degree" if name == "mean_spectral_angle" else "1"
        variables[name] = (("y", "x"), layer, {"long_name": words, "units": units})
    variables["pixels"] = (("y", "x"), count, {"long_name": "pixels that count", "units": "1"})
    centres = {
        name: (name, (np.arange(n) + 0.5) * size * pixel, {"long_name": words, "units": "m"})
        for name, n, words in zip(
            ("y", "x"),
            used.shape,
            ("distance from the first row's edge", "distance from the west edge"),
        )
    }
    return xr.Dataset(variables, coords=centres)


def _with_bands(spectra: ArrayLike) -> Float[Array, "*pixel band"]:
    data = jnp.asarray(spectra)
    if data.ndim == 0 or data.shape[-1] == 0:
        raise InputError(f"`spectra` must have bands on its last axis, but has shape {data.shape}")
    return data


def _checked(
    spectra: ArrayLike, valid: ArrayLike | None
) -> tuple[Spectra, Bool[Array, "*window pixel"], PerWindow]:
    """Spectra with 0 where a pixel does not count, where it does, and how many do."""
    data = jnp.asarray(spectra)
    data = data.astype(jnp.result_type(data.dtype, jnp.float32))
    if data.ndim < 2 or data.size == 0:
        raise InputError(f"`spectra` must be [..., pixel, band], but has shape {data.shape}")
    keep = jnp.ones(data.shape[:-1], bool) if valid is None else jnp.asarray(valid, bool)
    if keep.shape != data.shape[:-1]:
        raise InputError(f"`valid` must have shape {data.shape[:-1]}, but has {keep.shape}")
    count = jnp.sum(keep, axis=-1)
    if not isinstance(keep, jax.core.Tracer) and (few := np.asarray(count)).min() < 2:
        place = tuple(int(i) + 1 for i in np.unravel_index(few.argmin(), few.shape))
        where = f" in window {', '.join(map(str, place))}" if place else ""
        raise InputError(f"expected two pixels or more that count, but there is {few.min()}{where}")
    if not isinstance(data, jax.core.Tracer) and not isinstance(keep, jax.core.Tracer):
        wrong = ~np.isfinite(np.asarray(data)) & np.asarray(keep)[..., None]
        if wrong.any():
            raise InputError(
                f"expected finite spectra, but {int(wrong.any(axis=-1).sum())} pixels that count "
                "have NaN or infinity: mask them by `valid`"
            )
    return jnp.where(keep[..., None], data, 0.0), keep, count.astype(data.dtype)


def _each(function: Callable[..., Array], data: Spectra, keep: Array, count: Array) -> PerWindow:
    """A function of one window for each, one after the other to save memory."""
    flat = (data.reshape(-1, *data.shape[-2:]), keep.reshape(-1, keep.shape[-1]), count.ravel())
    return jax.lax.map(lambda window: function(*window), flat).reshape(count.shape)

"""The twenty vegetation indices of the drone comparison (table 4 of the fynbos scene paper).

Several of the paper's indices are not what the literature means by the same name; the forms here
are those that reproduce the paper's printed means (`fynjax/compare/data/README.md`), and each
departure is recorded beside its formula.
"""

from __future__ import annotations  # so that `help` shows ArrayLike by its name

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import jax
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Bool, Float

from fynjax._core.errors import InputError, did_you_mean

Band = Float[Array, "*pixel"]
IndexFunction = Callable[[Band, Band, Band, Band], Band]

BANDS = ("green", "red", "red_edge", "nir")
"""Order of the band axis that the indices expect."""

_NEUTRAL = (0.05, 0.04, 0.1, 0.25)
"""Bands of an ordinary plant pixel: stands in where a value is undefined and will be masked."""


@dataclass(frozen=True)
class VegetationIndex:
    """One index: its formula as code and as text, and how it differs from the literature."""

    name: str
    function: IndexFunction
    """Index of (green, red, red_edge, nir) reflectance."""
    formula: str
    """Formula of the index in the bands' letters G, R, RE, N."""
    departure: str = ""
    """Meaning of the name in the literature, where the paper's form differs; else empty."""
    literature: IndexFunction | None = None
    """The literature's form, where it differs and the four bands allow it."""
    literature_formula: str = ""
    """Formula of the literature's form in the bands' letters."""
    root_of: IndexFunction | None = None
    """Quantity that the root is taken of, for an index that is a square root."""


def _ndvi(r: Band, n: Band) -> Band:
    return (n - r) / (n + r)


_ALL = (
    VegetationIndex("ARI2", lambda g, r, e, n: n * (1.0 / g - 1.0 / e), "N*(1/G-1/RE)"),
    VegetationIndex(
        "EVI",
        lambda g, r, e, n: 2.5 * (n - r) / (n + 6.0 * r - 7.5 * g + 1.0),
        "2.5*(N-R)/(N+6*R-7.5*G+1)",
        "EVI needs a blue band, which the sensor lacks. Green stands in for it, the nearest of the "
        "tried forms to the paper's real mean (0.412 for 0.419); how the paper did it is not "
        "stated, so EVI is no calibration target. The literature's two-band form is EVI2.",
        lambda g, r, e, n: 2.5 * (n - r) / (n + 2.4 * r + 1.0),
        "2.5*(N-R)/(N+2.4*R+1)",
    ),
    VegetationIndex("GCI", lambda g, r, e, n: n / g - 1.0, "N/G-1"),
    VegetationIndex(
        "GDVI",
        lambda g, r, e, n: (n**2 - r**2) / (n**2 + r**2),
        "(N^2-R^2)/(N^2+R^2)",
        "The generalized difference index with exponent 2 (Wu 2014); the paper's caption says "
        "green difference index, which is N-G.",
        lambda g, r, e, n: n - g,
        "N-G",
    ),
    VegetationIndex("GNDVI", lambda g, r, e, n: (n - g) / (n + g), "(N-G)/(N+G)"),
    VegetationIndex("GRNDVI", lambda g, r, e, n: (n - g - r) / (n + g + r), "(N-G-R)/(N+G+R)"),
    VegetationIndex(
        "GSAVI",
        lambda g, r, e, n: 1.5 * (n - g) / (n + g + 0.5),
        "1.5*(N-G)/(N+G+0.5)",
    ),
    VegetationIndex("IPVI", lambda g, r, e, n: n / (n + r), "N/(N+R)"),
    VegetationIndex(
        "MSR",
        lambda g, r, e, n: (n / r - 1.0) / jnp.sqrt(n / r + 1.0),
        "(N/R-1)/sqrt(N/R+1)",
        "As the index databases have it; Chen (1996) printed (N/R-1)/(sqrt(N/R)+1).",
        lambda g, r, e, n: (n / r - 1.0) / (jnp.sqrt(n / r) + 1.0),
        "(N/R-1)/(sqrt(N/R)+1)",
    ),
    VegetationIndex("NDVI", lambda g, r, e, n: _ndvi(r, n), "(N-R)/(N+R)"),
    VegetationIndex("NDWI", lambda g, r, e, n: (g - n) / (g + n), "(G-N)/(G+N)"),
    VegetationIndex("NormG", lambda g, r, e, n: g / (n + r + g), "G/(N+R+G)"),
    VegetationIndex("NormNIR", lambda g, r, e, n: n / (n + r + g), "N/(N+R+G)"),
    VegetationIndex("NormR", lambda g, r, e, n: r / (n + r + g), "R/(N+R+G)"),
    VegetationIndex(
        "OSAVI",
        lambda g, r, e, n: (n - r) / (n + r + 0.16),
        "(N-R)/(N+R+0.16)",
        "Without the factor 1.16 that some tools apply (Rondeaux 1996 has both).",
        lambda g, r, e, n: 1.16 * (n - r) / (n + r + 0.16),
        "1.16*(N-R)/(N+R+0.16)",
    ),
    VegetationIndex(
        "RDVI",
        lambda g, r, e, n: jnp.sqrt(_ndvi(r, n)),
        "sqrt((N-R)/(N+R))",
        "The square root of NDVI, undefined where NDVI < 0 (such pixels are dropped); Roujean and "
        "Breon (1995) have (N-R)/sqrt(N+R).",
        lambda g, r, e, n: (n - r) / jnp.sqrt(n + r),
        "(N-R)/sqrt(N+R)",
        root_of=lambda g, r, e, n: _ndvi(r, n),
    ),
    VegetationIndex(
        "RVI",
        lambda g, r, e, n: n / g,
        "N/G",
        "Near infrared over green, GCI + 1; the literature's ratio index is N/R.",
        lambda g, r, e, n: n / r,
        "N/R",
    ),
    VegetationIndex("SR", lambda g, r, e, n: n / r, "N/R"),
    VegetationIndex(
        "TVI",
        lambda g, r, e, n: jnp.sqrt(_ndvi(r, n) + 0.5),
        "sqrt((N-R)/(N+R)+0.5)",
        root_of=lambda g, r, e, n: _ndvi(r, n) + 0.5,
    ),
    VegetationIndex(
        "WDRVI",
        lambda g, r, e, n: (0.05 * n - r) / (0.05 * n + r),
        "(0.05*N-R)/(0.05*N+R)",
        "With the coefficient 0.05; Gitelson (2004) uses 0.1 to 0.2.",
        lambda g, r, e, n: (0.1 * n - r) / (0.1 * n + r),
        "(0.1*N-R)/(0.1*N+R)",
    ),
)

VEGETATION_INDICES: dict[str, VegetationIndex] = {index.name: index for index in _ALL}
"""The twenty indices of table 4 by name, in alphabetical order."""


def vegetation_indices(
    image: Float[ArrayLike, "band ..."], names: Sequence[str] | None = None
) -> Float[Array, "index ..."]:
    """Vegetation indices of a four-band reflectance image, in the paper's forms [-].

    **Arguments:**

    - `image`: reflectance fractions [-] of the bands green, red, red edge, near infrared, on the
      first axis.
    - `names`: from `VEGETATION_INDICES`; all twenty if not given.

    **Returns:** one image for each index. A value that is undefined (0/0, x/0, the root of a
    negative NDVI, a NaN in a band the index uses) is NaN; statistics take `jnp.isfinite` of it as
    their mask.

    **Raises:** `InputError` for an unknown name or an image without four bands.

    Differentiable in `image` wherever the value is defined, and an undefined value has the gradient
    zero, not NaN. The slope is the index's own and grows without limit towards black bands and, for
    RDVI, towards NDVI = 0: an objective is better built on `smooth_vegetation_indices`.

    >>> import jax.numpy as jnp
    >>> from fynjax.metrics import vegetation_indices
    >>> pixel = jnp.array([0.06, 0.05, 0.15, 0.35])  # green, red, red edge, near infrared
    >>> vegetation_indices(pixel, ["NDVI", "GNDVI"]).round(3)
    Array([0.75 , 0.707], dtype=float32)
    """
    chosen, bands = _chosen(names), _bands(image)
    values = []
    for index in chosen:
        # Evaluated twice: where it is undefined at ordinary bands, so that its slope is 0, not NaN.
        raw = index.function(*(jax.lax.stop_gradient(band) for band in bands))
        valid = jnp.isfinite(raw)
        # A root at zero has a value but no slope: it is defined, with no gradient.
        slope_exists = valid if index.root_of is None else valid & (raw > 0.0)
        safe = [
            jnp.where(slope_exists, band, jnp.asarray(neutral, band.dtype))
            for band, neutral in zip(bands, _NEUTRAL)
        ]
        values.append(
            jnp.where(slope_exists, index.function(*safe), jnp.where(valid, raw, jnp.nan))
        )
    return jnp.stack(values)


def smooth_vegetation_indices(
    image: Float[ArrayLike, "band ..."],
    names: Sequence[str] | None = None,
    *,
    floor: float = 1e-4,
) -> tuple[Float[Array, "index ..."], Bool[Array, "index ..."]]:
    """Vegetation indices with bounded slopes at black bands, and where they count [-].

    Each band x is replaced by (x + sqrt(x^2 + 4 floor^2)) / 2, which is smooth, never below zero,
    equals `floor` at black and departs from x by less than floor^2 / x above it: 1e-5 of a
    reflectance of 0.03 at the default. Every value is then defined but that of the two roots, RDVI
    and TVI, where NDVI < 0 and < -1/2: the paper dropped such pixels, and they are false in the
    second array. Their value, and that of pixels with a NaN, is a finite stand-in with the
    gradient zero: give the mask to the statistic. What a root is taken of is lifted off zero in
    the same way, by 1e-3.

    **Arguments:**

    - `image`, `names`: as in `vegetation_indices`.
    - `floor`: reflectance that a black band is lifted to [-], positive.

    **Returns:** values and mask, one for each index.

    **Raises:** `InputError` as `vegetation_indices`, and for a floor that is not positive.

    Infinitely differentiable in `image` (at fixed mask), with finite slopes of at most about
    max(band) / floor^2. EVI alone, which is no target, keeps a pole where G = (1 + N + 6 R) / 7.5.
    """
    if not floor > 0.0:
        raise InputError(f"`floor` must be a positive reflectance, but is {floor:g}.")
    chosen, bands = _chosen(names), _bands(image)
    known = jnp.all(jnp.stack([jnp.isfinite(band) for band in bands]), axis=0)
    safe = []
    for band, neutral in zip(bands, _NEUTRAL):
        finite = jnp.where(known, band, jnp.asarray(neutral, band.dtype))
        safe.append(_lift(finite, floor))
    values, masks = [], []
    for index in chosen:
        if index.root_of is None:
            values.append(index.function(*safe))
            masks.append(known)
        else:
            # Lifted before the root, whose slope at 0 is infinite.
            square = index.root_of(*safe)
            positive = known & (square >= 0.0)
            values.append(jnp.sqrt(_lift(jnp.where(positive, square, 0.5), 1e-3)))
            masks.append(positive)
    return jnp.stack(values), jnp.stack(masks)


def of_indices(
    image: Float[ArrayLike, "band ..."], bands: Sequence[str]
) -> Float[Array, "four ..."]:
    """The four bands of an image that indices are made of, in their order.

    **Arguments:**

    - `image`: reflectance, its bands on the first axis.
    - `bands`: their names; `BANDS` are among them.
    """
    return jnp.stack([jnp.asarray(image)[tuple(bands).index(name)] for name in BANDS])


def _lift(x: Band, floor: float) -> Band:
    return 0.5 * (x + jnp.sqrt(x**2 + 4.0 * floor**2))


def _chosen(names: Sequence[str] | None) -> list[VegetationIndex]:
    if names is None:
        return list(_ALL)
    if isinstance(names, str):
        raise InputError(f"`names` must be a list of names; write [{names!r}].")
    unknown = [name for name in names if name not in VEGETATION_INDICES]
    if unknown or not names:
        near = did_you_mean(unknown[0], VEGETATION_INDICES) if unknown else ""
        raise InputError(
            f"vegetation indices must be among {', '.join(VEGETATION_INDICES)}, but "
            f"{', '.join(map(repr, unknown)) or 'none'} was given.{near}"
        )
    return [VEGETATION_INDICES[name] for name in names]


def _bands(image: Float[ArrayLike, "band ..."]) -> list[Band]:
    image = jnp.asarray(image)
    if image.ndim == 0 or image.shape[0] != len(BANDS):
        raise InputError(
            f"an image must have the {len(BANDS)} bands {', '.join(BANDS)} on its first axis, but "
            f"has shape {image.shape}. Were the bands on the last axis?"
        )
    return list(image.astype(jnp.result_type(image.dtype, jnp.float32)))

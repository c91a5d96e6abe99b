"""Vegetation indices of any sensor: each formula once, its bands chosen by wavelength and width."""

from __future__ import annotations  # so that `help` shows ArrayLike by its name

import ast
import csv
import operator
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from importlib.resources import files
from pathlib import Path
from typing import Any, NamedTuple, Protocol, runtime_checkable

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Bool, Float

from fynjax._core.errors import InputError, did_you_mean, listed
from fynjax._core.spectral import box_matrix, check_wavelength

BANDS = ("green", "red", "red_edge", "nir")
"""Bands of the drone camera, in the order of its images."""


@dataclass(frozen=True)
class BandTerm:
    """A letter of a formula: which band of a camera, or which wavelengths of a spectrum, it is."""

    word: str
    """Name of a band that is known by its name alone."""
    shortest: float
    """Shortest centre of a band that fits [nm]."""
    longest: float
    """Longest centre of a band that fits [nm]."""
    usual: float
    """Usual centre of such a band [nm]. Where a sensor has several bands that fit, that with the
    nearest centre is taken."""
    widest: float
    """Full width at half maximum that a band may have [nm]."""
    window: tuple[float, float]
    """Wavelengths that a spectrum is averaged over [nm]."""


BAND_TERMS: dict[str, BandTerm] = {
    "B": BandTerm("blue", 450.0, 530.0, 490.0, 100.0, (465.0, 485.0)),
    "G": BandTerm("green", 510.0, 600.0, 560.0, 100.0, (544.0, 576.0)),
    "R": BandTerm("red", 620.0, 690.0, 665.0, 100.0, (634.0, 666.0)),
    "RE": BandTerm("red_edge", 695.0, 750.0, 705.0, 50.0, (714.0, 746.0)),
    "N": BandTerm("nir", 760.0, 900.0, 842.0, 200.0, (834.0, 886.0)),
    "S1": BandTerm("swir_1", 1550.0, 1750.0, 1610.0, 250.0, (1565.0, 1655.0)),
    "S2": BandTerm("swir_2", 2080.0, 2350.0, 2190.0, 250.0, (2100.0, 2280.0)),
}
"""Letters of formulas. Ranges of centres are those of the catalogue Awesome Spectral Indices, the
red edge's all of it; usual centres those of Sentinel-2, whose near infrared is B8 and whose red
edge is B5. Spectra are averaged over the bands of `mavic_3m`, the blue of RedEdge-3 and the
short-wave infrared of Sentinel-2, so that a spectrum and a camera give the same quantity.

R and a number, such as R705, is the reflectance at a wavelength [nm]: the mean of a spectrum over
10 nm, or a band whose centre is within 12 nm and which is at most 40 nm wide."""


@dataclass(frozen=True)
class VegetationIndex:
    """A vegetation index: a formula of the reflectance of its bands.

    Called with these by letter it gives its value, NaN or infinity where it has none.

    >>> from fynjax.metrics import VEGETATION_INDICES
    >>> ndvi = VEGETATION_INDICES["NDVI"]
    >>> ndvi.terms, round(float(ndvi({"N": 0.4, "R": 0.1})), 3)
    (('N', 'R'), 0.6)
    """

    name: str
    formula: str
    """The index as text, such as "(N - R) / (N + R)": letters of `BAND_TERMS`, each the reflectance
    of that band [-], with numbers, + - * / ^ and sqrt."""
    source: str
    """Author and year; and what else the name is used for."""

    @cached_property
    def terms(self) -> tuple[str, ...]:
        """Letters of the formula, in its order."""
        return tuple(dict.fromkeys(re.findall(r"[A-Z]\w*", self.formula)))

    def __call__(self, terms: Mapping[str, Any], root: Callable[[Any], Any] = jnp.sqrt) -> Any:
        """The value at the reflectance [-] of each of `terms`; `root` is what takes roots."""
        formula = ast.parse(self.formula.replace("^", "**"), mode="eval").body
        return _value(formula, terms, root)

    @cached_property
    def measures(self) -> frozenset[str] | str:
        """What it measures: its bands' shares, if it is the same however bright they are together,
        which of two bands is one ratio; else itself."""
        plants = {term: usual(term) for term in self.terms}
        shade = {term: 0.6 * value for term, value in plants.items()}
        bright, dark = (float(self(terms, np.sqrt)) for terms in (plants, shade))
        return frozenset(self.terms) if np.isclose(bright, dark, rtol=1e-9) else self.name


_OPERATORS: dict[type[ast.operator], Callable[[Any, Any], Any]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.Pow: operator.pow,
}


def _value(node: ast.expr, terms: Mapping[str, Any], root: Callable[[Any], Any]) -> Any:
    """Value of a formula. Python's `eval` would run whatever a formula holds."""
    match node:
        case ast.Constant(value=int() | float() as number):
            return number
        case ast.Name(id=name):
            return terms[name]
        case ast.UnaryOp(op=ast.USub(), operand=operand):
            return -_value(operand, terms, root)
        case ast.BinOp(left=left, op=operation, right=right):
            both = _value(left, terms, root), _value(right, terms, root)
            return _OPERATORS[type(operation)](*both)
        case ast.Call(func=ast.Name(id="sqrt"), args=[operand], keywords=[]):
            return root(_value(operand, terms, root))
    raise InputError(f"expected a formula of bands, numbers, + - * / ^ and sqrt, but got {node}")


def _read(text: str) -> Iterator[VegetationIndex]:
    seen = {term.word for term in BAND_TERMS.values()}
    for line, row in enumerate(csv.DictReader(text.splitlines()), 2):

        def refuse(wanted: str, got: Any, line: int = line) -> InputError:
            return InputError(f"expected {wanted}, but got {got!r}", file=_TABLE, row=line)

        if None in row or not all(row.values()):
            raise refuse("name, formula and source, with quotes about a text with commas", row)
        index = VegetationIndex(**row)
        if index.name in seen or not re.fullmatch(r"\w+", index.name):
            raise refuse("a name that is no band's and no other index's", index.name)
        seen.add(index.name)
        words = set(re.findall(r"[A-Za-z_]\w*", index.formula)) - {"sqrt", *BAND_TERMS}
        if odd := sorted(word for word in words if not re.fullmatch(r"R\d+(\.\d+)?", word)):
            raise refuse(f"letters {', '.join(BAND_TERMS)} or R and a wavelength", odd[0])
        try:
            with np.errstate(all="ignore"):
                index({term: np.float64(0.3) for term in index.terms}, np.sqrt)
        except (SyntaxError, InputError) as error:
            raise refuse("a formula", index.formula) from error
        yield index


_TABLE = Path(str(files("fynjax.metrics"))) / "data" / "vegetation_indices.csv"
VEGETATION_INDICES: dict[str, VegetationIndex] = {
    index.name: index for index in _read(_TABLE.read_text("utf-8"))
}
"""Every vegetation index by name, in the form of its source: `data/vegetation_indices.csv`."""

_PLAIN = (
    (400.0, 480.0, 550.0, 670.0, 700.0, 740.0, 780.0, 1300.0, 1450.0, 1650.0, 1930.0, 2200.0),
    (0.025, 0.03, 0.06, 0.04, 0.09, 0.2, 0.27, 0.25, 0.1, 0.18, 0.06, 0.1),
)
"""Wavelengths [nm] and reflectance [-] of ordinary plants, which stand in where an index is
undefined, lest its slope be NaN."""


@lru_cache
def _term(name: str) -> BandTerm:
    if name in BAND_TERMS:
        return BAND_TERMS[name]
    at = float(name.removeprefix("R"))
    return BandTerm(f"{at:g} nm", at - 12.0, at + 12.0, at, 40.0, (at - 5.0, at + 5.0))


def usual(term: str) -> float:
    """Reflectance of ordinary plants in a term of a formula [-]."""
    return float(np.interp(_term(term).usual, *_PLAIN))


@runtime_checkable
class SensorBands(Protocol):
    """Bands of a sensor, such as a `fynjax.sensors.BandSet`."""

    @property
    def names(self) -> tuple[str, ...]: ...
    @property
    def centre(self) -> tuple[float, ...]:
        """Centre of each band [nm]; NaN where not known."""

    @property
    def fwhm(self) -> tuple[float, ...]:
        """Full width at half maximum of each band [nm]."""


Bands = SensorBands | Sequence[str] | Sequence[float] | ArrayLike
"""Bands of an image: of a sensor; by their names alone, blue, green, red, red_edge, nir, swir_1 and
swir_2 among them; or the wavelengths of spectra [nm], increasing."""


def band_names(bands: Bands) -> tuple[str, ...]:
    """Names of `bands`."""
    return _described(bands).names


class _Described(NamedTuple):
    names: tuple[str, ...]
    centre: tuple[float, ...]
    fwhm: tuple[float, ...]


def _described(bands: Bands) -> _Described:
    if isinstance(bands, SensorBands):
        return _Described(tuple(bands.names), tuple(bands.centre), tuple(bands.fwhm))
    if isinstance(bands, str):
        raise InputError(f"`bands` must be a list of names; write [{bands!r}].")
    each: list[Any] = list(np.atleast_1d(bands)) if not isinstance(bands, Sequence) else [*bands]
    if all(isinstance(name, str) for name in each):
        # As wide as a band may be: it is none at a stated wavelength.
        words = {term.word: (term.usual, term.widest) for term in BAND_TERMS.values()}
        places = [words.get(name, (np.nan, np.nan)) for name in each]
        return _Described(tuple(each), *(tuple(p[i] for p in places) for i in (0, 1)))
    grid = check_wavelength(np.asarray(bands))
    gaps = np.diff(grid, prepend=-np.inf, append=np.inf)
    widths = np.minimum(gaps[:-1], gaps[1:])  # a sample stands for what is nearest to it
    return _Described(tuple(f"{w:g} nm" for w in grid), tuple(grid), tuple(widths))


@lru_cache(maxsize=4096)
def _weights(
    name: str, centre: tuple[float, ...], fwhm: tuple[float, ...]
) -> tuple[tuple[int, ...], tuple[float, ...]] | None:
    """Places of the bands that a term is made of, and their weights; None where there are none."""
    term = _term(name)
    low, high = term.window
    place, width = np.array(centre), np.array(fwhm)
    # A spectrometer's channels side by side: their mean over the window.
    fine = np.flatnonzero((width <= 2.0 * (high - low)) & np.isfinite(place))
    grid, first = np.unique(place[fine], return_index=True)
    fine = fine[first]
    start, end = np.searchsorted(grid, low, "right") - 1, np.searchsorted(grid, high)
    if start >= 0 and end < grid.size:
        narrower = np.minimum(width[fine[start:end]], width[fine[start + 1 : end + 1]])
        if np.all(np.diff(grid[start : end + 1]) <= 1.5 * narrower):
            row = box_matrix(grid, 0.5 * (low + high), high - low)[0]
            used = np.flatnonzero(row)
            return tuple(fine[used].tolist()), tuple(row[used].tolist())
    # A camera's band, or the one that is nearest to the usual centre.
    fits = (term.shortest <= place) & (place <= term.longest) & (width <= term.widest)
    if not fits.any():
        return None
    return (int(np.argmin(np.where(fits, abs(place - term.usual), np.inf))),), (1.0,)


def index_bands(bands: Bands = BANDS) -> dict[str, dict[str, tuple[str, ...]]]:
    """The vegetation indices that some bands give, and of which of them each is made.

    **Arguments:** `bands` as in `vegetation_indices`.

    **Returns:** for each index of `VEGETATION_INDICES` whose bands there are: by letter of its
    formula the name of the band, or of the channels of a spectrometer, that are taken.

    **Raises:** `InputError` for wavelengths that are none in nm.

    >>> from fynjax.metrics import index_bands
    >>> from fynjax.sensors import shipped_sensor
    >>> index_bands(shipped_sensor("sentinel_2a").bands)["NDRE"]
    {'N': ('B8',), 'RE': ('B5',)}
    """
    names, centre, fwhm = _described(bands)
    found = {}
    for index in VEGETATION_INDICES.values():
        weights = {term: _weights(term, centre, fwhm) for term in index.terms}
        if None not in weights.values():
            found[index.name] = {k: tuple(names[i] for i in w[0]) for k, w in weights.items() if w}
    return found


def vegetation_indices(
    image: Float[ArrayLike, "band ..."], names: Sequence[str], bands: Bands = BANDS
) -> Float[Array, "index ..."]:
    """Vegetation indices of reflectance [-], of a camera's image or of spectra.

    **Arguments:**

    - `image`: reflectance fractions [-], bands on the first axis.
    - `names`: from `VEGETATION_INDICES`.
    - `bands`: of the image, in its order: a `fynjax.sensors.BandSet`; or names, of which blue,
      green, red, red_edge, nir, swir_1 and swir_2 are known; or the wavelengths of spectra [nm].

    Bands are taken by wavelength and width (`BAND_TERMS`), whatever they are called. Where channels
    lie side by side, as a spectrometer's do, it is the mean of the spectrum, linear between them,
    over the term's window; else the band whose centre is in the term's range, not wider than it
    allows, and nearest to the usual centre. `index_bands` says which they are.

    **Returns:** one image for each index [-], of red edge positions [nm]. A value that is undefined
    (0/0, x/0, the root of a negative NDVI, a NaN in a band the index uses) is NaN; statistics take
    `jnp.isfinite` of it as their mask.

    **Raises:** `InputError` for an unknown name, an index of which there is no band, with its
    wavelengths, and an image with another number of bands.

    Differentiable in `image` wherever the value is defined, and an undefined value has the gradient
    zero, not NaN. The slope is the index's own and grows without limit towards black bands and
    where a root is taken of zero: an objective is better built on `smooth_vegetation_indices`.

    >>> import jax.numpy as jnp
    >>> from fynjax.metrics import vegetation_indices
    >>> pixel = jnp.array([0.06, 0.05, 0.15, 0.35])  # green, red, red edge, near infrared
    >>> vegetation_indices(pixel, ["NDVI", "GNDVI"]).round(3)
    Array([0.75 , 0.707], dtype=float32)
    """
    values = []
    for index, terms in _chosen(image, names, bands):
        # Evaluated twice: where it is undefined at ordinary bands, so that its slope is 0, not NaN.
        positive: list[Array] = []

        def root(x: Array, positive: list[Array] = positive) -> Array:
            positive.append(x > 0.0)
            return jnp.sqrt(x)

        raw = index(jax.lax.stop_gradient(terms), root)
        valid = jnp.isfinite(raw)
        # A root at zero has a value but no slope: it is defined, with no gradient.
        slope = jnp.all(jnp.stack([valid, *positive]), axis=0)
        safe = {name: jnp.where(slope, band, usual(name)) for name, band in terms.items()}
        values.append(jnp.where(slope, index(safe), jnp.where(valid, raw, jnp.nan)))
    return jnp.stack(values)


def smooth_vegetation_indices(
    image: Float[ArrayLike, "band ..."],
    names: Sequence[str],
    bands: Bands = BANDS,
    *,
    floor: float = 1e-4,
) -> tuple[Float[Array, "index ..."], Bool[Array, "index ..."]]:
    """Vegetation indices with bounded slopes at black bands, and where they count.

    Each band x is replaced by (x + sqrt(x^2 + 4 floor^2)) / 2, which is smooth, never below zero,
    equals `floor` at black and departs from x by less than floor^2 / x above it: 1e-5 of a
    reflectance of 0.03 at the default. Every ratio of sums is then defined. What a root is taken of
    is lifted off zero in the same way, by 1e-3; where it is below zero, and in pixels with a NaN in
    a band of the index, the second array is false, and the value a finite stand-in with the
    gradient zero: give the mask to the statistic.

    **Arguments:**

    - `image`, `names`, `bands`: as in `vegetation_indices`.
    - `floor`: reflectance that a black band is lifted to [-], positive.

    **Returns:** values and mask, one for each index.

    **Raises:** `InputError` as `vegetation_indices`, and for a floor that is not positive.

    Infinitely differentiable in `image` (at fixed mask). Ratios of sums have finite slopes of at
    most about max(band) / floor^2; an index with a difference in its denominator keeps its pole,
    such as EVI_green where G = (1 + N + 6 R) / 7.5.
    """
    if not floor > 0.0:
        raise InputError(f"`floor` must be a positive reflectance, but is {floor:g}.")
    values, masks = [], []
    for index, terms in _chosen(image, names, bands):
        mask = [jnp.all(jnp.stack([jnp.isfinite(x) for x in terms.values()]), axis=0)]

        def root(x: Array, mask: list[Array] = mask) -> Array:
            mask.append(x >= 0.0)
            # Lifted before the root, whose slope at 0 is infinite.
            return jnp.sqrt(_lift(jnp.where(mask[-1], x, 0.5), 1e-3))

        lifted = {
            name: _lift(jnp.where(mask[0], band, usual(name)), floor)
            for name, band in terms.items()
        }
        values.append(index(lifted, root))
        masks.append(jnp.all(jnp.stack(mask), axis=0))
    return jnp.stack(values), jnp.stack(masks)


def _lift(x: Array, floor: float) -> Array:
    return 0.5 * (x + jnp.sqrt(x**2 + 4.0 * floor**2))


def _chosen(
    image: Float[ArrayLike, "band ..."], names: Sequence[str], bands: Bands
) -> Iterator[tuple[VegetationIndex, dict[str, Array]]]:
    """Each index of `names`, with the reflectance of its terms [-]."""
    if isinstance(names, str):
        raise InputError(f"`names` must be a list of names; write [{names!r}].")
    image, (own, centre, fwhm) = jnp.asarray(image), _described(bands)
    if image.ndim == 0 or image.shape[0] != len(own):
        raise InputError(
            f"an image must have the {len(own)} bands {listed(own)} on its first axis, but has "
            f"shape {image.shape}. Were the bands on the last axis?"
        )
    image = image.astype(jnp.result_type(image.dtype, jnp.float32))
    if not names:
        raise InputError(f"expected the name of an index ({listed(index_bands(bands))}), got none")
    for name in names:
        terms = {}
        for term in (index := _known(name, bands)).terms:
            weights = _weights(term, centre, fwhm)
            if weights is None:
                raise InputError(_missing(index, _term(term), bands))
            # Others are not touched: a NaN elsewhere in a spectrum must not reach this band.
            parts = [image[i] if w == 1.0 else w * image[i] for i, w in zip(*weights)]
            terms[term] = sum(parts[1:], parts[0])
        yield index, terms


def _known(name: str, bands: Bands) -> VegetationIndex:
    if name in VEGETATION_INDICES:
        return VEGETATION_INDICES[name]
    found = index_bands(bands)
    raise InputError(
        f"expected an index that these bands give ({listed(found) or 'none'}), but got {name!r}."
        f"{did_you_mean(str(name), found)}"
    )


def _missing(index: VegetationIndex, term: BandTerm, bands: Bands) -> str:
    own, found = band_names(bands), index_bands(bands)
    near = did_you_mean(index.name, found)
    return (
        f"{index.name} needs a band with its centre from {term.shortest:g} to {term.longest:g} nm "
        f"and at most {term.widest:g} nm wide ({term.word.replace('_', ' ')}), which is not among "
        f"{listed(own)}. These give {listed(found) or 'no index'}.{near}"
    )

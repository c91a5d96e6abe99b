"""From the spectrum or the bands of a uniform canopy to its leaves, leaf area and soil."""

from collections.abc import Mapping
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from fynjax._core.errors import InputError, did_you_mean
from fynjax._core.precision import double_precision
from fynjax._core.progress import track
from fynjax._core.spectral import check_wavelength
from fynjax.canopy import EllipsoidalLeafAngle
from fynjax.inversion._data import Data
from fynjax.inversion._fit import fit_function
from fynjax.inversion._fit_result import FitResult
from fynjax.inversion._space import ParameterSpace
from fynjax.leaf import LEAF_PARAMETERS, LeafParameters, prospect
from fynjax.radiation import canopy_reflectance
from fynjax.scene import PARAMETERS, background_spectrum, soil_shapes
from fynjax.sensors import BandSet, Sensor

_LEAF = ("chlorophyll", "carotenoids", "water", "dry_matter", "structure")
_PARTS = 6
"""Wavelengths in a band: means of Sentinel-2 are within 0.6 % of those of a whole spectrum."""
_STEP = 10.0
"""A finer spectrum is averaged in bins as wide [nm]."""
RELATIVE_SD, ABSOLUTE_SD = 0.02, 0.01
"""Errors of each band for itself, and as much again of all together [-]."""
_HIGHEST = {"sun_zenith": 89.0, "view_zenith": 89.0, "sky_share": 1.0, "hot_spot": 100.0}


class CanopyFit(eqx.Module):
    """What `fit_canopy` found; printed, a table with 90 % intervals."""

    result: FitResult
    """The whole result: covariance, predicted reflectance, status."""
    known: dict[str, float]
    """Values of the parameters that were not fitted, in their units."""

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters, in the order of the arrays."""
        return self.result.names

    @property
    def estimate(self) -> dict[str, float]:
        """Most probable value of each parameter, in its unit (`fit_canopy`)."""
        return dict(zip(self.names, np.asarray(self.result.estimate).tolist()))

    @property
    @double_precision
    def interval(self) -> dict[str, tuple[float, float]]:
        """90 % interval of each parameter, by name."""
        ends = np.asarray(self.result.quantiles(0.05, 0.95)).T
        return {name: (low, high) for name, (low, high) in zip(self.names, ends.tolist())}

    @property
    @double_precision
    def unconstrained(self) -> tuple[str, ...]:
        """Parameters of which the data say little: their prior's deviation is not even halved."""
        return tuple(n for n in self.names if n not in self.result.well_constrained())

    def __repr__(self) -> str:
        data, found, ends = self.result.data, self.estimate, self.interval
        rest = np.asarray(data.whiten(self.result.predicted - data.value))
        lines = [
            f"{self.result.explanation} Misfit {np.sqrt(np.mean(rest**2)):.1f} errors in "
            f"{rest.size} bands.",
            f"{'':24}{'estimate':>10}{'90 % interval':>20}{'prior':>20}",
        ]
        for name, low, high in zip(
            self.names, *np.asarray(self.result.space.quantiles(0.05, 0.95))
        ):
            unit = "" if _UNITS[name] == "-" else f" [{_UNITS[name]}]"
            own, usual = (f"{a:.3g} to {b:.3g}" for a, b in (ends[name], (low, high)))
            lines.append(f"{name + unit:24}{found[name]:>10.3g}{own:>20}{usual:>20}")
        if self.known:
            lines.append("Known: " + ", ".join(f"{n} {v:g}" for n, v in self.known.items()) + ".")
        if self.unconstrained:
            lines.append(f"Hardly known from these data: {', '.join(self.unconstrained)}.")
        return "\n".join(lines)


class CanopyView(NamedTuple):
    """How a canopy is lit and seen, as `canopy_reflectance` takes it."""

    sun_zenith: float
    view_zenith: float = 0.0
    relative_azimuth: float = 0.0
    sky_share: float = 0.0
    hot_spot: float = 0.01

    def check(
        self,
        bands: Sensor | BandSet | Float[np.ndarray, " band"],
        reflectance: Float[np.ndarray, "pixel band"],
        *,
        soil: Float[np.ndarray, " band"] | float | None = None,
        known: Mapping[str, float] | None = None,
    ) -> None:
        """Refuse at once what `fit_canopies` refuses, as it takes them, of pixels seen so."""
        ready_pixels(bands, reflectance, self, soil, known)


@double_precision
def fit_canopy(
    bands: Sensor | BandSet | Float[np.ndarray, " band"],
    reflectance: Float[np.ndarray, " band"],
    *,
    sun_zenith: float,
    view_zenith: float = 0.0,
    relative_azimuth: float = 0.0,
    sky_share: float = 0.0,
    hot_spot: float = 0.01,
    soil: Float[np.ndarray, " band"] | float | None = None,
    known: Mapping[str, float] | None = None,
    sd: Float[np.ndarray, " band"] | float | None = None,
    max_steps: int = 40,
) -> CanopyFit:
    """Leaves, leaf area, leaf angle and soil of a uniform canopy from its reflectance.

    PROSPECT-D, `canopy_reflectance` and the bands, fitted by `fit`. The free parameters, with their
    priors and bounds:

    | name | unit | prior |
    | --- | --- | --- |
    | the leaf's `chlorophyll`, `carotenoids`, `water`, `dry_matter`, `structure` | PROSPECT's | \
leaves at large (`LEAF_PARAMETERS`) |
    | `leaf_area_index` | m2 m-2 | lognormal, median 2, sd 3, up to 15 |
    | `leaf_angle`, mean inclination | degrees | logit-normal, median 57, sd 12, from 15 to 85 |
    | `soil_brightness`, factor on the soil | - | that of a plot's soil (`PARAMETERS`) |
    | `soil_moisture`, share of wet in dry and wet soil | - | logit-normal, median 0.2, sd 0.2 |
    | `soil_shape_1` to `soil_shape_4` (`fynjax.scene.soil_shapes`) | - | normal, 0 and 1, to 4 |

    **Arguments:**

    - `bands`: a sensor (`fx.sensor("sentinel_2a")`), its bands, or wavelengths [nm, 400 to 2500,
      rising]; a spectrum finer than 10 nm is averaged in bins of 10 nm.
    - `reflectance`: of the canopy in each [-]; NaN where there is none, such as Sentinel-2's B10,
      or where water vapour absorbs.
    - `sun_zenith`, `view_zenith`, `relative_azimuth`, `sky_share`, `hot_spot`: as
      `canopy_reflectance` takes them.
    - `soil`: reflectance of the soil in each band [-]; only its brightness is fitted then. By
      default moisture and shape are fitted too, about the shipped dry soil.
    - `known`: values of parameters that are not to be fitted, in their units, within their bounds:
      `{"leaf_angle": 57.0}`; also `anthocyanins` and `brown_pigments`, which are 0 otherwise.
    - `sd`: standard deviation of each reflectance, the model's error included [-], independent
      between bands; those of a spectrum that is averaged count as common to each bin. By default
      0.01 and 2 % of the reflectance independent in each band, and as
      much again that all bands have in common.
    - `max_steps`: of the fit, at most.

    **Returns:** `CanopyFit`, with 90 % intervals by the Laplace approximation; of 40 canopies drawn
    from the prior they held 91 % of the truths. Several canopies may have one spectrum: where
    intervals are wide, look at `unconstrained`. Not differentiable. The first call compiles for
    half a minute or so; further ones with the same bands and names of what is known take seconds.

    **Raises:** `InputError` for lengths that do not match, reflectance outside 0 to 1, fewer than
    three bands with a value, names and values of what is known that are none, and wavelengths and
    angles out of range.

    **Source:** leaf area, leaf angle and errors after the range and noise of Weiss and Baret (2016,
    S2ToolBox level 2 products, ATBD 1.1), as to form and width assumed; soil after Jiang and Fang
    (2019, International Journal of Applied Earth Observation and Geoinformation 83, 101932).

    **Example:**

        sensor = fx.sensor("sentinel_2a")
        print(fx.fit_canopy(sensor, measured, sun_zenith=35.0, known={"leaf_angle": 57.0}))
    """
    own, centre = bands_and_centres(bands)
    value, ground, error = given_by_band(centre, reflectance=reflectance, soil=soil, sd=sd)
    use = np.isfinite(value)
    if use.sum() < 3:
        raise InputError(f"at least three bands must have a reflectance, but {use.sum()} have")
    if isinstance(own, BandSet):
        centre, value, ground, error = (a[use] for a in (centre, value, ground, error))
        own = own.select(np.flatnonzero(use).tolist())
    else:
        bins = mean_bins(centre[use])
        centre, value, ground, error = (
            binned(bins, a[use]) for a in (centre, value, ground, error)
        )
    view = CanopyView(sun_zenith, view_zenith, relative_azimuth, sky_share, hot_spot)
    model, space = canopy_model(own, centre, view, None if soil is None else ground, known)
    names = tuple(f"{at:.0f} nm" for at in centre)
    if sd is not None:
        data = Data(names, jnp.asarray(value), jnp.asarray(error))
    else:
        alone = jnp.asarray(np.hypot(ABSOLUTE_SD, RELATIVE_SD * value))
        # As much again that all bands share: an offset and a factor.
        together = ABSOLUTE_SD**2 + RELATIVE_SD**2 * np.outer(value, value)
        data = Data(names, jnp.asarray(value), alone).with_covariance(together)
    found = fit_function(model, data, space, max_steps=max_steps)
    return CanopyFit(found, {name: float(number) for name, number in (known or {}).items()})


def ready_pixels(
    bands: Any, reflectance: Any, view: CanopyView, soil: Any, known: Mapping[str, float] | None
) -> tuple[tuple["_Model", ParameterSpace], np.ndarray, np.ndarray]:
    """The model of a pixel and its space, the values that are fitted, and which of them there
    are."""
    own, centre = bands_and_centres(bands)
    values = np.asarray(reflectance, float)
    if values.ndim != 2 or values.shape[1] != centre.size:
        raise InputError(
            f"`reflectance` must be [pixel, {centre.size} bands], but has the shape {values.shape}"
        )
    seen = np.isfinite(values) & (values >= 0.0) & (values <= 1.0)
    used = seen.any(axis=0)
    if used.sum() < 3:
        raise InputError(f"at least three bands must have a reflectance, but {used.sum()} have")
    if isinstance(own, BandSet):
        own = own.select(np.flatnonzero(used).tolist())
    ground = None if soil is None else given_by_band(centre, soil=soil)[0][used]
    centre, values, seen = centre[used], values[:, used], seen[:, used]
    if not isinstance(own, BandSet):  # each bin the mean of what there is
        bins = mean_bins(centre)
        share = seen @ bins.T
        with np.errstate(invalid="ignore", divide="ignore"):
            values = np.where(seen, values, 0.0) @ bins.T / share
        centre, seen = bins @ centre, share > 0.0
        ground = None if ground is None else binned(bins, ground)
    if not (seen.sum(axis=1) >= 3).any():
        raise InputError("some pixel must have a reflectance in three bands, but none has")
    return canopy_model(own, centre, view, ground, known), values, seen


def canopy_model(
    bands: BandSet | Float[np.ndarray, " band"],
    centre: Float[np.ndarray, " band"],
    view: CanopyView,
    soil: Float[np.ndarray, " band"] | None = None,
    known: Mapping[str, float] | None = None,
    *,
    light: "CanopyTable | None" = None,
) -> tuple["_Model", ParameterSpace]:
    """The bands of a canopy as a function of its free parameters, and the space of these, as
    `fit_canopy` takes them; `centre` of each band [nm], `light` by a table of this view."""
    if isinstance(bands, BandSet):
        wavelength, weights = _parts(bands)
    else:
        wavelength, weights = centre, np.eye(centre.size)
    if soil is None:
        names = ("dry_soil", "wet_soil")
        below = np.stack([background_spectrum(name, wavelength) for name in names])
    else:
        order = np.argsort(centre)
        own = np.interp(wavelength, centre[order], soil[order])
        if np.isnan(own).any():
            at = centre[np.isnan(soil)][0]
            raise InputError(
                "`soil` must have a value wherever `reflectance` has one, but has none at "
                f"{at:g} nm"
            )
        below = np.stack([own, own])
    # In the fit all of it is traced, and not checked.
    for name, high in _HIGHEST.items():
        number = getattr(view, name)
        if not 0.0 <= number <= high:
            raise InputError(f"`{name}` must be from 0 to {high:g}, but is {number:g}")
    fixed = _FIXED | (dict.fromkeys(_OF_SOIL, 0.0) if soil is not None else {})
    fixed |= _checked(known or {}, () if soil is None else _OF_SOIL)
    free = tuple(name for name in _UNITS if name not in fixed)
    if not free:
        raise InputError("nothing is left to fit: all parameters are in `known`")
    values = jnp.asarray([fixed.get(name, 0.0) for name in _UNITS], float)
    model = _Model(
        tuple(wavelength.tolist()), jnp.asarray(weights), jnp.asarray(below),
        jnp.asarray(soil_shapes(wavelength)), jnp.asarray(view, float), values,
        tuple(list(_UNITS).index(name) for name in free), light,
    )  # fmt: skip
    return model, _space(free)


def bands_and_centres(bands: Any) -> tuple[Any, Float[np.ndarray, " band"]]:
    """Bands without their sensor, and their middles."""
    bands = bands.bands if isinstance(bands, Sensor) else bands
    try:
        centre = np.asarray(bands.centre if isinstance(bands, BandSet) else bands, float)
    except (TypeError, ValueError):
        raise InputError(
            f"`bands` must be a sensor, its bands or wavelengths in nm, but is {bands!r}"
        ) from None
    if not isinstance(bands, BandSet):
        check_wavelength(centre)
    return bands, centre


def _checked(known: Mapping[str, float], refused: tuple[str, ...]) -> dict[str, float]:
    """Values of what is known, each within its bounds."""
    found = {}
    for name, number in known.items():
        if name not in _UNITS or name in refused:
            own = [other for other in _UNITS if other not in refused]
            hint = "; of a soil that is given only the brightness is free" if refused else ""
            raise InputError(
                f"`known` has no parameter {name!r}.{did_you_mean(name, own)} Parameters are "
                f"{', '.join(own)}{hint}"
            )
        low, high = _bounds(name)
        try:
            found[name] = number = float(number)
        except (TypeError, ValueError):
            raise InputError(f"`known` must have numbers, but {name} is {number!r}") from None
        if not low <= number <= high:
            raise InputError(
                f"`known` must have {name} from {low:g} to {high:g} [{_UNITS[name]}], but it is "
                f"{number:g}"
            )
    return found


def _bounds(name: str) -> tuple[float, float]:
    if name in LEAF_PARAMETERS:
        return LEAF_PARAMETERS[name].lower, LEAF_PARAMETERS[name].upper
    return _PRIORS[name][:2]


def given_by_band(centre: np.ndarray, **given: Any) -> list[np.ndarray]:
    """Each a value for each band, NaN where not given."""
    arrays = []
    for name, values in given.items():
        array = np.asarray(np.nan if values is None else values, float)
        if array.shape != centre.shape and (name == "reflectance" or array.shape):
            raise InputError(
                f"`{name}` must have one value for each of the {centre.size} bands, but has the "
                f"shape {array.shape}"
            )
        array = np.broadcast_to(array, centre.shape)
        wrong = (array < 0) | (array > 1)
        if wrong.any():
            raise InputError(
                f"`{name}` must be a fraction from 0 to 1, but is {array[wrong][0]:g} at "
                f"{centre[wrong][0]:g} nm; is it a percentage or a scaled integer?"
            )
        arrays.append(array)
    return arrays


def binned(bins: np.ndarray, values: np.ndarray) -> Float[np.ndarray, " bin"]:
    """Means of values in bins; NaN where one of its own is."""
    return np.where(bins > 0.0, bins * values, 0.0).sum(axis=1)


def mean_bins(wavelength: np.ndarray) -> Float[np.ndarray, "bin wavelength"]:
    """Weights that average a fine spectrum; of a coarse one each value is kept."""
    step = _STEP if np.median(np.diff(wavelength)) < _STEP else 1e-6
    # A step that is finer than any spectrum keeps every value by itself.
    member = np.unique(np.floor(wavelength / step), return_inverse=True)[1]
    mean = np.equal.outer(np.arange(member.max() + 1), member).astype(float)
    return mean / mean.sum(axis=1, keepdims=True)


_SOIL = PARAMETERS["brightness"]
_PRIORS: dict[str, tuple[float, float, float, float, Any]] = {
    "leaf_area_index": (0.0, 15.0, 2.0, 3.0, "lognormal"),
    "leaf_angle": (15.0, 85.0, 57.0, 12.0, "logit-normal"),
    "soil_brightness": (
        *(_SOIL.lower, _SOIL.upper, 1.0, _SOIL.prior_sd(1.0) or 0.3),
        _SOIL.distribution,
    ),
    "soil_moisture": (0.0, 1.0, 0.2, 0.2, "logit-normal"),
} | {f"soil_shape_{i + 1}": (-4.0, 4.0, 0.0, 1.0, "normal") for i in range(4)}
"""Bounds, median, standard deviation and kind of the prior of what is not of leaves."""
_OF_SOIL = tuple(_PRIORS)[3:]
"""What the shipped soil has beside its brightness."""
_FIXED = {"anthocyanins": 0.0, "brown_pigments": 0.0}
_UNITS = {name: LEAF_PARAMETERS[name].unit for name in (*_LEAF, *_FIXED)} | {
    name: {"leaf_area_index": "m2 m-2", "leaf_angle": "degrees"}.get(name, "-") for name in _PRIORS
}


def canopy_units() -> dict[str, str]:
    """Units of all parameters of `fit_canopy`, by name."""
    return dict(_UNITS)


def _space(free: tuple[str, ...]) -> ParameterSpace:
    rows = []
    for name in free:
        if name in _PRIORS:
            rows.append(_PRIORS[name])
            continue
        own = LEAF_PARAMETERS[name]
        assert own.population is not None  # of all that a leaf has free
        median, relative = own.population
        rows.append((own.lower, own.upper, median, median * relative, own.distribution))
    lower, upper, prior, sd, kinds = zip(*rows)
    return ParameterSpace(free, lower, upper, prior, sd, distribution=kinds)


def _parts(bands: BandSet) -> tuple[np.ndarray, np.ndarray]:
    """Wavelengths that stand for equal parts of each band's response, and their weights."""
    grid = np.arange(400.0, 2501.0)
    places, weights = [], np.zeros((len(bands), len(bands), _PARTS))
    for band, row in enumerate(bands.weights(grid)):
        # Each wavelength goes to the part in which the middle of its share of the response lies.
        share = (np.cumsum(row) - 0.5 * row)[:, None] * _PARTS - np.arange(_PARTS)
        part = row[:, None] * ((share >= 0) & (share < 1))
        weights[band, band] = part.sum(axis=0)
        places.append(grid @ part / weights[band, band])
    return np.concatenate(places), weights.reshape(len(bands), -1)


def _reflectance(
    leaf: tuple[Any, Any], area: Any, angle: Any, soil: Array, view: Any
) -> Float[Array, " wavelength"]:
    return canopy_reflectance(
        *leaf,
        area,
        soil=soil,
        leaf_angles=EllipsoidalLeafAngle.from_mean_angle(angle),
        **dict(zip(CanopyView._fields, view)),
    )


_POINTS = (8, 5, 7, 5, 4)
"""Points of a `CanopyTable` along its coordinates: with these a root mean square of 0.1 of the
errors that `fit_canopy` assumes is left, at most 0.5."""


class CanopyTable(eqx.Module):
    """Reflectance of a canopy for one view, as a polynomial in its leaf area and leaf angle, the
    leaf's absorption, the share of what it scatters that it reflects, and the soil (Chebyshev).

    `made` computes it, in some 20 s; after that a spectrum takes microseconds.
    """

    coefficients: Float[np.ndarray, "area angle absorbed reflected soil"]

    @classmethod
    def made(cls, view: CanopyView) -> "CanopyTable":
        """The table of a view."""
        nodes = [np.cos(np.pi * (np.arange(n) + 0.5) / n) for n in _POINTS]
        areas = -3.0 * np.log(1.0 - 0.5 * (nodes[0] + 1.0) * _FULL)
        angles = 50.0 + 35.0 * nodes[1]
        absorbed, share, soil = np.meshgrid(
            0.5 * (nodes[2] + 1.0), 0.5 + 0.45 * nodes[3], 0.5 * (nodes[4] + 1.0), indexing="ij"
        )
        scattered = 1.0 - absorbed.ravel() ** 2
        leaf: Any = tuple(jnp.asarray(scattered * part.ravel()) for part in (share, 1 - share))
        at = jax.jit(lambda a, b: _reflectance(leaf, a, b, jnp.asarray(soil.ravel()), view))
        pairs = track([(a, b) for a in areas for b in angles], "Light of canopies")
        table = np.stack([at(a, b) for a, b in pairs]).reshape(_POINTS)
        for axis, n in enumerate(_POINTS):
            order, place = np.arange(n)[:, None], np.pi * (np.arange(n) + 0.5) / n
            forms = np.where(order == 0, 1.0, 2.0) / n * np.cos(order * place)
            table = np.moveaxis(np.tensordot(forms, table, axes=(1, axis)), 0, axis)
        return cls(table)

    def __call__(
        self, leaf: tuple[Any, Any], area: Any, angle: Any, soil: Array, view: Any = None
    ) -> Float[Array, " wavelength"]:
        """Reflectance factor at each wavelength; `leaf` is its reflectance and transmittance."""
        scattered = leaf[0] + leaf[1]
        absorbed = jnp.sqrt(jnp.maximum(1.0 - scattered, 1e-9))
        x = (
            2.0 * (1.0 - jnp.exp(-area / 3.0)) / _FULL - 1.0,
            (angle - 50.0) / 35.0,
            2.0 * absorbed - 1.0,
            (leaf[0] / scattered - 0.5) / 0.45,
            2.0 * soil - 1.0,
        )
        a, b, u, s, g = (_chebyshev(one, n) for one, n in zip(x, _POINTS))
        whole = jnp.einsum("a,b,abusg->usg", a, b, jnp.asarray(self.coefficients))
        return jnp.einsum("usg,wu,ws,wg->w", whole, u, s, g)


_FULL = 1.0 - np.exp(-5.0)


def _chebyshev(x: Array, count: int) -> Float[Array, "*x count"]:
    """Chebyshev polynomials by their recurrence, whose slopes are finite at the ends."""
    x = jnp.clip(x, -1.0, 1.0)
    forms = [jnp.ones_like(x), x]
    while len(forms) < count:
        forms.append(2.0 * x * forms[-1] - forms[-2])
    return jnp.stack(forms, axis=-1)


class _Model(eqx.Module):
    """Bands of a canopy; other numbers for the same bands compile nothing."""

    wavelength: tuple[float, ...] = eqx.field(static=True)
    weights: Float[Array, "band wavelength"]
    soil: Float[Array, "2 wavelength"]
    """Dry and wet."""
    shapes: Float[Array, "shape wavelength"]
    view: Float[Array, " five"]
    fixed: Float[Array, " parameter"]
    free: tuple[int, ...] = eqx.field(static=True)
    """Places of the free ones among all parameters."""
    light: "CanopyTable | None"

    def __call__(self, values: Float[Array, " free"]) -> Float[Array, " band"]:
        everything = self.fixed.at[jnp.asarray(self.free)].set(values)
        named = dict(zip(_UNITS, everything))
        fields: dict[str, Any] = {name: named[name] for name in (*_LEAF, *_FIXED)}
        optics = prospect(LeafParameters(**fields), np.asarray(self.wavelength))
        wet = named["soil_moisture"]
        mixed = (1.0 - wet) * self.soil[0] + wet * self.soil[1]
        shape = jnp.exp(everything[-len(self.shapes) :] @ self.shapes)
        soil = jnp.minimum(named["soil_brightness"] * mixed * shape, 1.0)
        of = _reflectance if self.light is None else self.light
        leaf = optics.reflectance, optics.transmittance
        spectrum = of(leaf, named["leaf_area_index"], named["leaf_angle"], soil, self.view)
        return self.weights @ spectrum

    def jacobian(self, values_at: Any, u: Array) -> tuple[Array, Array]:
        """By forward mode: there are fewer parameters than bands."""
        value, push = jax.linearize(lambda u: self(values_at(u)), u)
        return value, jax.vmap(push)(jnp.eye(u.size, dtype=u.dtype)).T

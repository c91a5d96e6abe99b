"""From the spectrum or the bands of a uniform canopy to its leaves, leaf area and soil."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from fynjax._core.errors import InputError
from fynjax._core.precision import double_precision
from fynjax._core.spectral import check_wavelength
from fynjax.canopy import EllipsoidalLeafAngle
from fynjax.inversion._data import Data
from fynjax.inversion._fit import fit_function
from fynjax.inversion._fit_result import FitResult
from fynjax.inversion._space import ParameterSpace
from fynjax.leaf import LEAF_PARAMETERS, LeafParameters, prospect
from fynjax.radiation import canopy_reflectance
from fynjax.scene import PARAMETERS, background_spectrum
from fynjax.sensors import BandSet, Sensor

_LEAF = ("chlorophyll", "carotenoids", "water", "dry_matter", "structure")
_PARTS = 6
"""Wavelengths in a band: means of Sentinel-2 are within 0.6 % of those of a whole spectrum."""
_STEP = 10.0
"""A finer spectrum is averaged in bins as wide [nm]."""
_RELATIVE, _ABSOLUTE = 0.02, 0.01


class CanopyFit(eqx.Module):
    """What `fit_canopy` found; printed, a table with 90 % intervals."""

    result: FitResult
    """The whole result: covariance, predicted reflectance, status."""

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
        if self.unconstrained:
            lines.append(f"Hardly known from these data: {', '.join(self.unconstrained)}.")
        return "\n".join(lines)


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
    | `soil_brightness`, factor on `soil` | - | that of a plot's soil (`PARAMETERS`) |

    **Arguments:**

    - `bands`: a sensor (`fx.sensor("sentinel_2a")`), its bands, or wavelengths [nm, 400 to 2500,
      rising]; a spectrum finer than 10 nm is averaged in bins of 10 nm.
    - `reflectance`: of the canopy in each [-]; NaN where there is none, such as Sentinel-2's B10,
      or where water vapour absorbs.
    - `sun_zenith`, `view_zenith`, `relative_azimuth`, `sky_share`, `hot_spot`: as
      `canopy_reflectance` takes them.
    - `soil`: reflectance of the soil in each band [-]; by default the shipped dry soil.
    - `sd`: standard deviation of each reflectance, the model's error included [-], independent
      between bands; those of a spectrum that is averaged count as common to each bin. By default
      0.01 and 2 % of the reflectance independent in each band, and as
      much again that all bands have in common.
    - `max_steps`: of the fit, at most.

    **Returns:** `CanopyFit`, with 90 % intervals by the Laplace approximation; of 40 canopies drawn
    from the prior they held 87.5 % of the truths. Several canopies may have one spectrum: where
    intervals are wide, look at `unconstrained`. Anthocyanins and brown
    pigments are 0. Not differentiable. The first call compiles for half a minute or so;
    further ones with the same bands take seconds.

    **Raises:** `InputError` for lengths that do not match, reflectance outside 0 to 1, fewer than
    three bands with a value, and wavelengths and angles out of range.

    **Source:** leaf area, leaf angle and errors after the range and noise of Weiss and Baret (2016,
    S2ToolBox level 2 products, ATBD 1.1), as to form and width assumed.

    **Example:**

        sensor = fx.sensor("sentinel_2a")
        print(fx.fit_canopy(sensor, measured, sun_zenith=35.0))
    """
    bands = bands.bands if isinstance(bands, Sensor) else bands
    try:
        centre = np.asarray(bands.centre if isinstance(bands, BandSet) else bands, float)
    except (TypeError, ValueError):
        raise InputError(
            f"`bands` must be a sensor, its bands or wavelengths in nm, but is {bands!r}"
        ) from None
    value, ground, error = _given(centre, reflectance=reflectance, soil=soil, sd=sd)
    use = np.isfinite(value)
    if use.sum() < 3:
        raise InputError(f"at least three bands must have a reflectance, but {use.sum()} have")
    if isinstance(bands, BandSet):
        wavelength, weights = _parts(bands.select(np.flatnonzero(use).tolist()))
        centre, value, ground, error = (a[use] for a in (centre, value, ground, error))
    else:
        check_wavelength(centre)
        bins = _bins(centre[use])
        centre, value, ground, error = (bins @ a[use] for a in (centre, value, ground, error))
        wavelength, weights = centre, np.eye(centre.size)
    if soil is None:
        below = background_spectrum("dry_soil", wavelength)
    else:
        order = np.argsort(centre)
        below = np.interp(wavelength, centre[order], ground[order])
        if np.isnan(below).any():
            raise InputError("`soil` must have a value wherever `reflectance` has one")
    # In the fit all of it is traced, and not checked.
    for name, number, high in (
        ("sun_zenith", sun_zenith, 89.0),
        ("view_zenith", view_zenith, 89.0),
        ("sky_share", sky_share, 1.0),
        ("hot_spot", hot_spot, 100.0),
    ):
        if not 0.0 <= number <= high:
            raise InputError(f"`{name}` must be from 0 to {high:g}, but is {number:g}")
    names = tuple(f"{at:.0f} nm" for at in centre)
    if sd is not None:
        data = Data(names, jnp.asarray(value), jnp.asarray(error))
    else:
        alone = jnp.asarray(np.hypot(_ABSOLUTE, _RELATIVE * value))
        # As much again that all bands share: an offset and a factor.
        together = _ABSOLUTE**2 + _RELATIVE**2 * np.outer(value, value)
        data = Data(names, jnp.asarray(value), alone).with_covariance(together)
    light = jnp.asarray([sun_zenith, view_zenith, relative_azimuth, sky_share, hot_spot], float)
    model = _Model(tuple(wavelength.tolist()), jnp.asarray(weights), jnp.asarray(below), light)
    return CanopyFit(fit_function(model, data, _space(), max_steps=max_steps))


def _given(centre: np.ndarray, **given: Any) -> list[np.ndarray]:
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


def _bins(wavelength: np.ndarray) -> Float[np.ndarray, "bin wavelength"]:
    """Weights that average a fine spectrum; of a coarse one each value is kept."""
    step = _STEP if np.median(np.diff(wavelength)) < _STEP else 1e-6
    # A step that is finer than any spectrum keeps every value by itself.
    member = np.unique(np.floor(wavelength / step), return_inverse=True)[1]
    mean = np.equal.outer(np.arange(member.max() + 1), member).astype(float)
    return mean / mean.sum(axis=1, keepdims=True)


def _space() -> ParameterSpace:
    leaf = [LEAF_PARAMETERS[name] for name in _LEAF]
    soil = PARAMETERS["brightness"]
    rows = [
        (p.lower, p.upper, p.population[0], p.population[0] * p.population[1], p.distribution)
        for p in leaf
        if p.population is not None
    ]
    rows += [
        (0.0, 15.0, 2.0, 3.0, "lognormal"),
        (15.0, 85.0, 57.0, 12.0, "logit-normal"),
        (soil.lower, soil.upper, 1.0, soil.prior_sd(1.0) or 0.3, soil.distribution),
    ]
    lower, upper, prior, sd, kinds = zip(*rows)
    return ParameterSpace(tuple(_UNITS), lower, upper, prior, sd, distribution=kinds)


_UNITS = {name: LEAF_PARAMETERS[name].unit for name in _LEAF} | {
    "leaf_area_index": "m2 m-2",
    "leaf_angle": "degrees",
    "soil_brightness": "-",
}


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


class _Model(eqx.Module):
    """Bands of a canopy; other numbers for the same bands compile nothing."""

    wavelength: tuple[float, ...] = eqx.field(static=True)
    weights: Float[Array, "band wavelength"]
    soil: Float[Array, " wavelength"]
    light: Float[Array, " five"]

    def __call__(self, values: Float[Array, " free"]) -> Float[Array, " band"]:
        *leaf, area, angle, brightness = values
        fields: dict[str, Any] = dict(zip(_LEAF, leaf))
        optics = prospect(LeafParameters(**fields), np.asarray(self.wavelength))
        ground = jnp.minimum(brightness * self.soil, 1.0)
        sun, view, azimuth, share, size = self.light
        spectrum = canopy_reflectance(
            optics.reflectance,
            optics.transmittance,
            area,
            soil=ground,
            leaf_angles=EllipsoidalLeafAngle.from_mean_angle(angle),
            sun_zenith=sun,
            view_zenith=view,
            relative_azimuth=azimuth,
            sky_share=share,
            hot_spot=size,
        )
        return self.weights @ spectrum

    def jacobian(self, values_at: Any, u: Array) -> tuple[Array, Array]:
        """By forward mode: there are fewer parameters than bands."""
        value, push = jax.linearize(lambda u: self(values_at(u)), u)
        return value, jax.vmap(push)(jnp.eye(u.size, dtype=u.dtype)).T

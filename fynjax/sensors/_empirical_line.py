"""From radiance or counts to reflectance by a straight line per band, and how sure it is.

Bands are on the last axis, as elsewhere in this package; images of panels are [band, y, x].
"""

from __future__ import annotations  # so that `help` shows ArrayLike by its name

from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float

from fynjax._core.errors import InputError
from fynjax._core.extras import require
from fynjax._core.math import real_array, square_root
from fynjax._core.records import Slip, Strict, in_unit

_SAMPLES = 16  # points along each edge of a pixel that a panel covers in part
_ROUNDS = 4
"""Times the weights are computed again with the slope: the last changes it by less than 1e-6 of its
standard deviation where panels are known to 10 %."""


class EmpiricalLine(eqx.Module):
    """Reflectance = gain x signal + offset, for each band (Smith and Milton 1999, eq. 1).

    All methods are differentiable in the line and in the signal.
    """

    gain: Float[Array, " band"] = eqx.field(converter=real_array)
    """Reflectance per unit of signal [1 / the signal's unit]."""
    offset: Float[Array, " band"] = eqx.field(converter=real_array)
    """Reflectance where the signal is zero [-]; haze makes it negative."""
    covariance: Float[Array, "band 2 2"] = eqx.field(converter=real_array)
    """Covariance of gain and offset, in this order."""

    def reflectance(self, signal: Float[ArrayLike, "*batch band"]) -> Float[Array, "*batch band"]:
        """Reflectance factor [-] of pixels with this signal."""
        return self.gain * real_array(signal) + self.offset

    def standard_deviation(
        self,
        signal: Float[ArrayLike, "*batch band"],
        signal_sd: Float[ArrayLike, "*#batch #band"] | Float[ArrayLike, ""] = 0.0,
    ) -> Float[Array, "*batch band"]:
        """Standard deviation of that reflectance [-].

        The uncertainty of the line is shared by all pixels of an image; `signal_sd` is that of the
        pixel itself, in the signal's unit, independent of it.
        """
        signal, noise = real_array(signal), real_array(signal_sd)
        c = self.covariance
        variance = signal**2 * c[:, 0, 0] + 2.0 * signal * c[:, 0, 1] + c[:, 1, 1]
        # Rounding may leave a line without uncertainty a negative variance.
        return square_root(jnp.maximum(variance + (self.gain * noise) ** 2, 0.0))

    def relit(
        self, ratio: Float[ArrayLike, " band"], ratio_sd: Float[ArrayLike, " band"] | float = 0.0
    ) -> EmpiricalLine:
        """The line under `ratio` times the light under which it was measured [-]."""
        ratio, sd = real_array(ratio), real_array(ratio_sd)
        _positive(ratio, "`ratio` of the light")
        gain = self.gain / ratio
        scale = jnp.stack([1.0 / ratio, jnp.ones_like(ratio)], axis=-1)
        covariance = self.covariance * scale[:, :, None] * scale[:, None, :]
        covariance = covariance.at[:, 0, 0].add((gain * sd / ratio) ** 2)
        return EmpiricalLine(gain, self.offset, covariance)


def empirical_line(
    signal: Float[ArrayLike, "panel band"],
    reflectance: Float[ArrayLike, " panel #band"],
    *,
    signal_sd: Float[ArrayLike, "#panel #band"] | Float[ArrayLike, ""] = 0.0,
    reflectance_sd: Float[ArrayLike, "#panel #band"] | Float[ArrayLike, ""] = 0.0,
) -> EmpiricalLine:
    """The line through panels of known reflectance, by weighted least squares.

    Weights are the effective variances s_rho^2 + (gain s_signal)^2 of each panel (York 1966),
    computed again with each estimate of the gain. Two panels are met exactly whatever the weights
    are, which still give the covariance.

    **Arguments:**

    - `signal`: mean signal of each panel, two panels or more, in any unit linear in radiance.
    - `reflectance`: their reflectance factors [-], for each band or the same in all.
    - `signal_sd`, `reflectance_sd`: standard deviations of these means (not of pixels); errors of
      different panels are independent. Where both are zero the panels count alike and the
      covariance is zero but for rounding: their uncertainty was not given.

    **Returns:** an `EmpiricalLine`: gain, offset and their covariance, for each band.

    **Raises:** `InputError`, where values are known before tracing, for fewer than two panels,
    panels of equal reflectance or equal signal, and brighter panels with less signal.

    Differentiable in all arguments. Smith and Milton (1999).

    >>> import jax.numpy as jnp
    >>> from fynjax.sensors import empirical_line
    >>> line = empirical_line(
    ...     signal=jnp.array([[20.0], [120.0]]),  # counts of two panels in one band
    ...     reflectance=jnp.array([[0.05], [0.55]]),
    ...     signal_sd=1.0,
    ...     reflectance_sd=0.01,
    ... )
    >>> pixel = jnp.array([60.0])
    >>> line.reflectance(pixel).round(3), line.standard_deviation(pixel, signal_sd=1.0).round(3)
    (Array([0.25], dtype=float32), Array([0.009], dtype=float32))
    """
    x, y = real_array(signal), real_array(reflectance)
    if x.ndim != 2 or x.shape[0] < 2 or y.shape not in {x.shape, (x.shape[0], 1)}:
        raise InputError(
            "expected the signal [panel, band] of two panels or more and as many reflectances, but "
            f"got shapes {x.shape} and {y.shape}. One panel: `one_panel_line`."
        )
    y = jnp.broadcast_to(y, x.shape)
    _check_panels(x, y)
    sx, sy = (jnp.broadcast_to(real_array(sd), x.shape) for sd in (signal_sd, reflectance_sd))
    # Less than this is no difference in the numbers' own precision, and 1 / 0 is no weight.
    least = jnp.finfo(y.dtype).eps * jnp.ptp(y, axis=0) ** 2

    def weighted(variance: Array) -> tuple[Array, ...]:
        weight = 1.0 / (variance + least)
        # A regression line about the weighted middle of the panels.
        total = jnp.sum(weight, axis=0)
        xc, yc = (jnp.sum(weight * v, axis=0) / total for v in (x, y))
        spread = jnp.sum(weight * (x - xc) ** 2, axis=0)
        return jnp.sum(weight * (x - xc) * (y - yc), axis=0) / spread, xc, yc, spread, total

    gain = weighted(jnp.zeros_like(x))[0]
    for _ in range(_ROUNDS):
        gain, xc, yc, spread, total = weighted(sy**2 + (gain * sx) ** 2)
    slope = 1.0 / spread
    covariance = _covariance(slope, -xc * slope, 1.0 / total + xc**2 * slope)
    return EmpiricalLine(gain, yc - gain * xc, covariance)


def one_panel_line(
    signal: Float[ArrayLike, " band"],
    reflectance: Float[ArrayLike, "#band"],
    *,
    signal_sd: Float[ArrayLike, "#band"] | Float[ArrayLike, ""] = 0.0,
    reflectance_sd: Float[ArrayLike, "#band"] | Float[ArrayLike, ""] = 0.0,
    offset_sd: Float[ArrayLike, "#band"] | Float[ArrayLike, ""] = 0.0,
) -> EmpiricalLine:
    """The line through one panel and zero: for a signal without dark level or haze.

    **Arguments:**

    - `signal`: mean signal of the panel, positive, in any unit linear in radiance.
    - `reflectance`: its reflectance factor [-], positive, for each band or the same in all.
    - `signal_sd`, `reflectance_sd`: standard deviations of these means.
    - `offset_sd`: how far from zero the reflectance of no signal may be [-], which one panel cannot
      determine.

    **Returns:** an `EmpiricalLine`.

    **Raises:** `InputError` unless signal and reflectance are positive, where they are known before
    tracing.

    Differentiable in all arguments.
    """
    x, y = real_array(signal), real_array(reflectance)
    y = jnp.broadcast_to(y, x.shape)
    _positive(x, "the panel's signal")
    _positive(y, "the panel's reflectance")
    sx, sy, so = (
        jnp.broadcast_to(real_array(sd), x.shape) for sd in (signal_sd, reflectance_sd, offset_sd)
    )
    gain = y / x
    covariance = _covariance((sy**2 + (gain * sx) ** 2 + so**2) / x**2, 0.0 - so**2 / x, so**2)
    return EmpiricalLine(gain, jnp.zeros_like(gain), covariance)


def irradiance_line(
    irradiance: Float[ArrayLike, " band"],
    *,
    irradiance_sd: Float[ArrayLike, "#band"] | Float[ArrayLike, ""] = 0.0,
) -> EmpiricalLine:
    """Reflectance pi L / E from measured irradiance, as a line over radiance.

    **Arguments:**

    - `irradiance`: of the horizontal plane, positive, in the unit of the radiance times sr, such as
      W m-2 um-1.
    - `irradiance_sd`: its standard deviation, in that unit.

    **Returns:** an `EmpiricalLine`.

    **Raises:** `InputError` unless the irradiance is positive, where it is known before tracing.

    Differentiable in both arguments.
    """
    light = real_array(irradiance)
    _positive(light, "`irradiance`")
    return one_panel_line(
        light / jnp.pi, jnp.ones_like(light), signal_sd=real_array(irradiance_sd) / jnp.pi
    )


class Panel(Strict):
    """A square reference panel in the picture, flat and above the plants."""

    slips: ClassVar[dict[str, Slip]] = {
        "reflectance": lambda v: "In percent? Divide by 100." if v > 1.2 else None
    }
    x_m: float = in_unit("m", of="Middle of the panel, east of the plot's south-west corner", ge=0)
    y_m: float = in_unit("m", of="Middle of the panel, north of it", ge=0)
    side_m: float = in_unit("m", of="Its side", default=0.5, gt=0, le=1000)
    reflectance: float = in_unit("-", of="Reflectance factor in all bands", gt=0, le=1.2)
    reflectance_sd: float = in_unit(
        "-", of="Standard deviation of that, relative to it", default=0.01, ge=0, le=1
    )


class PanelReading(eqx.Module):
    """What a camera saw of one panel."""

    mean: Float[Array, " band"]
    """Mean of its pixels [unit of the image]."""
    spread: Float[Array, " band"]
    """Standard deviation between its pixels [same unit]."""
    count: int = eqx.field(static=True)
    """Pixels that lie wholly inside the area."""

    @property
    def mean_sd(self) -> Float[Array, " band"]:
        """Standard deviation of the mean, if pixels are independent [unit of the image]."""
        return self.spread / self.count**0.5


def panel_coverage(
    corners: Any,
    shape: tuple[int, int],
    *,
    pixel_m: float = 1.0,
    origin_m: tuple[float, float] = (0.0, 0.0),
) -> Float[np.ndarray, "y x"]:
    """Share of each pixel that a polygon covers [-], to 1/16 in each direction.

    **Arguments:**

    - `corners`: (x, y) of three corners or more, in order around [m]. With the defaults of
      `pixel_m` and `origin_m` they are in pixels: 0 is the outer edge of the first one, 0.5 its
      middle. A rectangle is its four corners.
    - `shape`: (y, x) of the image. y grows with its row.
    - `pixel_m`: edge of a pixel [m].
    - `origin_m`: (x, y) of the outer corner of the first pixel [m].

    **Raises:** `InputError` for a polygon of fewer corners, without area, or outside the image.

    Not differentiable.
    """
    affine = require("rasterio", "app").Affine
    rasterize = require("rasterio.features", "app").rasterize

    points = np.asarray(corners, dtype=np.float64)
    if points.ndim != 2 or points.shape[1] != 2 or len(points) < 3 or not np.isfinite(points).all():
        raise InputError(
            f"a panel's area needs three corners (x, y) or more, but is {np.asarray(corners)}"
        )
    points = (points - np.asarray(origin_m)) / pixel_m
    # Only the part around the polygon is drawn finely.
    low = np.clip(np.floor(points.min(axis=0)).astype(int), 0, shape[::-1])
    high = np.clip(np.ceil(points.max(axis=0)).astype(int), 0, shape[::-1])
    size = high - low
    covered = np.zeros(shape)
    if (size > 0).all():
        fine = rasterize(
            [({"type": "Polygon", "coordinates": [[*points.tolist(), points[0].tolist()]]}, 1)],
            out_shape=(int(size[1]) * _SAMPLES, int(size[0]) * _SAMPLES),
            transform=affine(1.0 / _SAMPLES, 0, low[0], 0, 1.0 / _SAMPLES, low[1]),
            dtype="uint8",
        )
        coarse = fine.reshape(size[1], _SAMPLES, size[0], _SAMPLES).mean(axis=(1, 3))
        covered[low[1] : high[1], low[0] : high[0]] = coarse
    if not covered.any():
        raise InputError(
            f"a panel's area must lie in the image of {shape[1]} x {shape[0]} pixels and have some "
            f"size, but its corners are at {points.round(1).tolist()} [pixel]"
        )
    return covered


def panel_reading(
    image: Float[ArrayLike, "band y x"],
    coverage: Float[ArrayLike, "y x"],
    *,
    saturation: Float[ArrayLike, " band"] | float | None = None,
) -> PanelReading:
    """Mean and spread of the pixels that a panel covers wholly.

    **Arguments:**

    - `image`: signal of the pixels, in any unit.
    - `coverage`: as from `panel_coverage` [-], known before tracing.
    - `saturation`: signal from which on a band's pixels are full, in the image's unit; None: no
      limit.

    **Returns:** a `PanelReading`, in the image's unit.

    **Raises:** `InputError` where no pixel lies wholly inside, and, where the image is known before
    tracing, for pixels that are saturated or no numbers.

    Differentiable in `image`.
    """
    image = real_array(image)
    inside = np.asarray(coverage) >= 1.0 - 1e-9
    if image.ndim != 3 or image.shape[1:] != inside.shape:
        raise InputError(
            f"expected an image [band, y, x] of {inside.shape} pixels as the panel's area has, but "
            f"its shape is {image.shape}"
        )
    if not inside.any():
        raise InputError(
            "a panel must cover some pixels wholly, but this one covers none: it is too small for "
            "the picture, or outside"
        )
    pixels = image[:, inside]
    if not isinstance(pixels, jax.core.Tracer):
        values = np.asarray(pixels)
        bad = ~np.isfinite(values).all(axis=1)
        if bad.any():
            raise InputError(
                f"a panel must be numbers in every pixel, but band {int(bad.argmax()) + 1} has "
                "pixels without data"
            )
        if saturation is not None:
            limit = np.broadcast_to(np.asarray(saturation, float), values.shape[:1])
            full = (values >= limit[:, None]).mean(axis=1)
            if full.any():
                raise InputError(
                    f"a panel must not be saturated, but in band {int(full.argmax()) + 1} "
                    f"{100 * full.max():.2g} % of its pixels are. Choose a picture of it with a "
                    "shorter exposure, or a darker panel."
                )
    return PanelReading(pixels.mean(axis=1), pixels.std(axis=1), int(inside.sum()))


def place_panels(
    reflectance: Float[ArrayLike, "band y x"],
    coverage: Float[ArrayLike, "panel y x"],
    panels: Float[ArrayLike, " panel #band"],
) -> Float[Array, "band y x"]:
    """A map of ground reflectance with flat panels laid on it [-].

    **Arguments:**

    - `reflectance`: of the ground [-].
    - `coverage`: share of each pixel under each panel [-] (`panel_coverage`), which do not overlap.
    - `panels`: their reflectance [-].

    Differentiable in `reflectance` and `panels`.
    """
    ground, cover, panel = real_array(reflectance), real_array(coverage), real_array(panels)
    under = jnp.sum(cover, axis=0)
    panel = jnp.broadcast_to(panel, (cover.shape[0], ground.shape[0]))
    return ground * (1.0 - under) + jnp.einsum("pyx,pb->byx", cover, panel)


def _covariance(gain: Array, both: Array, offset: Array) -> Float[Array, "band 2 2"]:
    """Covariance of gain and offset from their variances and what they share."""
    return jnp.stack(
        [jnp.stack([gain, both], axis=-1), jnp.stack([both, offset], axis=-1)], axis=-2
    )


def _positive(values: Array, what: str) -> None:
    if isinstance(values, jax.core.Tracer):
        return
    numbers = np.asarray(values)
    wrong = ~(np.isfinite(numbers) & (numbers > 0.0))
    if wrong.any():
        band = int(np.argmax(wrong.ravel()))
        raise InputError(
            f"{what} must be positive in every band, but is {numbers.ravel()[band]:g} in band "
            f"{band + 1}. Is the panel in the picture, and the dark level right?"
        )


def _check_panels(x: Array, y: Array) -> None:
    if isinstance(x, jax.core.Tracer) or isinstance(y, jax.core.Tracer):
        return
    signal, known = np.asarray(x), np.asarray(y)
    if not (np.isfinite(signal).all() and np.isfinite(known).all()):
        raise InputError("panels must have numbers for signal and reflectance, but some are none")
    for what, values, hint in (
        ("reflectance", known, "A line needs a dark and a bright one."),
        ("signal", signal, "Are they the same panel, or saturated?"),
    ):
        close = np.ptp(values, axis=0) <= 1e-4 * np.abs(values).max(axis=0)
        if close.any():
            band = int(close.argmax())
            raise InputError(
                f"panels must differ in {what}, but in band {band + 1} all have "
                f"{values[0, band]:.4g}. {hint}"
            )
    slope = np.sum((signal - signal.mean(0)) * (known - known.mean(0)), axis=0)
    if (slope <= 0.0).any():
        raise InputError(
            f"brighter panels must give more signal, but in band {int((slope <= 0).argmax()) + 1} "
            "they give less. Were panels mixed up?"
        )

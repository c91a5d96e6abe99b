"""Signal that an instrument records of a leaf, from PROSPECT's R and T."""

import abc
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from fynjax._core.errors import InputError
from fynjax._core.parameters import Parameter
from fynjax.leaf._area import SIDE_BY_SIDE, LeafShape, check_leaf_shape

MEASUREMENT_PARAMETERS = {
    "gap_fraction": Parameter(
        symbol="g",
        name="Gap fraction",
        unit="-",
        lower=-0.1,
        upper=0.6,
        usual=(0.0, 0.2),
        population=(0.03, 1.7),
        source="Mesarch et al. 1999. Bounds and prior assumed.",
        description="Part of the field of view without leaf. Below zero where a correction for "
        "gaps took off too much. Needles laid side by side leave 0.02 to 0.2 (Mesarch et al. 1999, "
        "Remote Sensing of Environment 68, 177).",
    ),
    "background": Parameter(
        symbol="B",
        name="Reflectance behind the leaves",
        unit="-",
        lower=0.0,
        upper=1.0,
        usual=(0.0, 0.5),
        population=(0.05, 1.5),
        source="Bounds by definition. Prior assumed.",
        description="The same at all bands: near zero of a black face or a light trap.",
    ),
    "recollision": Parameter(
        symbol="p",
        name="Recollision probability",
        unit="-",
        lower=0.0,
        upper=0.6,
        usual=(0.0, 0.4),
        population=(0.25, 1.0),
        source="Smolander and Stenberg 2003. Bounds and prior assumed, about what touching "
        "cylinders have.",
        description="Part of the light scattered by a needle that meets another (Smolander and "
        "Stenberg 2003, Remote Sensing of Environment 88, 363). Of touching parallel cylinders "
        "0.20 of what was scattered once, 0.36 of what leaves evenly over the surface, 0.2 (dark) "
        "to 0.4 (bright) over all orders.",
    ),
}
"""What a fit can estimate of a measurement with each leaf, with wide priors."""

# Behind a leaf: moves its R at 1130 nm by less than 0.01.
_DARK = 0.05
# Repeatability of a field spectrometer's reflectance, and the error of a transmittance from two
# readings beyond which it says less than the model of the leaf [-].
_REPEATABILITY, _TOLERATED = 0.002, 0.03


class AbstractMeasurement(eqx.Module):
    """How the recorded reflectance and transmittance follow from those of a leaf."""

    offset_deviation: eqx.AbstractVar[float]
    """Prior standard deviation of an additive offset of R, the same at all bands [-]."""

    @property
    def estimated(self) -> tuple[str, ...]:
        """Names of `MEASUREMENT_PARAMETERS` that a fit estimates with each leaf."""
        return ()

    @property
    def shines(self) -> bool:
        """Whether the offset of R is light from the surface, which a leaf has in any case, and not
        an error of the calibration."""
        return False

    @property
    def leaf_alone(self) -> bool:
        """Whether R is that of one leaf with nothing bright behind it, so that its level in the
        near infrared says something of N."""
        return True

    @abc.abstractmethod
    def observe(
        self,
        reflectance: Float[Array, " band"],
        transmittance: Float[Array, " band"],
        *estimated: Float[Array, ""],
    ) -> tuple[Float[Array, " band"], Float[Array, " band"]]:
        """Recorded R and T [-] of a leaf with these optics; differentiable.

        `estimated` holds a value for each of the names of that property.
        """


class IntegratingSphere(AbstractMeasurement):
    """Directional-hemispherical R and T of a single leaf: what PROSPECT computes.

    R and T together identify all parameters. From R alone N and the absorbers trade off against
    each other; the fit then adds a prior for N from R at 1131 nm (Spafford et al. 2021, Remote
    Sensing of Environment 252, 112176).
    """

    offset_deviation: float = 0.02
    """Prior standard deviation of a calibration offset of R [-]."""

    def observe(
        self, reflectance: Array, transmittance: Array, *estimated: Array
    ) -> tuple[Array, Array]:
        """R and T unchanged."""
        return reflectance, transmittance


class LeafClip(AbstractMeasurement):
    """A leaf clip or contact probe over a black face: R + b, with b from specular reflection.

    R alone, so N and the absorbers trade off as of a sphere's R, and with b as well: pigments and
    water are identified better than N, dry matter least. A face that is not black counts as b.

    COSINE with equal angles of light and view (Jay et al. 2016, Remote Sensing of Environment 177,
    220-236). The offset b is marginalised under its prior: as a free parameter it lowers the misfit
    and doubles the error of the water content, because the data do not identify it apart from N.
    """

    offset_deviation: float = 0.04
    """Prior standard deviation of b [-]."""

    @property
    def shines(self) -> bool:
        """Yes, by b."""
        return True

    def observe(
        self, reflectance: Array, transmittance: Array, *estimated: Array
    ) -> tuple[Array, Array]:
        """R and T unchanged; b enters as a Gaussian nuisance with mean 0."""
        return reflectance, transmittance


def recollided(
    reflectance: Float[Array, "*band"],
    transmittance: Float[Array, "*band"],
    recollision: float | Float[Array, "*#band"],
) -> tuple[Float[Array, "*band"], Float[Array, "*band"]]:
    """R and T of needles side by side from those of one needle [-].

    With w = R + T a part p of scattered light meets a neighbour, which scatters w of it, as much up
    as down: R' = (1 - p) R + p (1 - p) w^2 / (2 (1 - p w)), T' the same with T. All scattering
    orders escape as (1 - p) w / (1 - p w) (Smolander and Stenberg 2003, Remote Sensing of
    Environment 88, 363). Within 0.016 of rays traced through a row of touching cylinders with the
    p that they have at each w, 0.20 to 0.40; with one p of 0.3 for all within 0.025.

    **Arguments:** `reflectance`, `transmittance`: of one needle [-], at most 1 together;
    `recollision`: p, 0 to below 1 [-].

    **Returns:** R' and T' [-]. Differentiable.
    """
    p, w = recollision, reflectance + transmittance
    more = 0.5 * p * (1.0 - p) * w**2 / (1.0 - p * w)
    return (1.0 - p) * reflectance + more, (1.0 - p) * transmittance + more


class LeafOverBackground(AbstractMeasurement):
    """Leaves with gaps over a Lambertian background of reflectance B.

    R_obs = (1 - g) (R + T^2 B / (1 - R B)) + g B and T_obs = (1 - g) T + g: the light that crosses
    the leaf, meets the background and returns (a geometric series), and the part g of the field of
    view without leaf. Of needles side by side R and T are those of `recollided`. What is `None` is
    estimated with each leaf. T where leaves are opaque (red, 1940 nm) identifies g, absorption
    where no substance absorbs (near infrared) the recollision. R alone identifies none of them: a
    leaf without T counts as a single one over black without gaps. Over a known bright background R
    holds R + T^2 B, which identifies what is absorbed, water and dry matter better than R over
    black does, but not N, whose prior decides, nor therefore T.
    """

    background: float | Float[Array | np.ndarray, "*band"] | None = 0.0
    """Reflectance of the background [-], a number or a value per bin of the fit; `None`: estimated,
    the same at all bands."""
    gap_fraction: float | None = 0.0
    """Part of the field of view without leaf, 0 to 1 [-]; `None`: estimated."""
    recollision: float | None = 0.0
    """Part of the light scattered by a needle that meets another, 0 to below 1 [-]; `None`:
    estimated."""
    offset_deviation: float = 0.02
    """Prior standard deviation of an offset of R [-]."""

    def __check_init__(self) -> None:
        p = self.recollision
        if isinstance(p, int | float) and not 0.0 <= p < 1.0:
            raise InputError(f"`recollision` must be a share of 0 to below 1, but is {p:g}")

    @property
    def estimated(self) -> tuple[str, ...]:
        """Names among gap fraction, background and recollision that are `None`."""
        names = ("gap_fraction", "background", "recollision")
        return tuple(name for name in names if getattr(self, name) is None)

    @property
    def leaf_alone(self) -> bool:
        """Without neighbours over a black background; what is estimated counts as that where there
        is no transmittance."""
        dark = self.background is None or not np.any(np.asarray(self.background) > _DARK)
        return dark and (self.recollision is None or not np.any(np.asarray(self.recollision) > 0))

    def observe(
        self, reflectance: Array, transmittance: Array, *estimated: Array
    ) -> tuple[Array, Array]:
        """Signal of leaf and background."""
        known: dict[str, Any] = {name: getattr(self, name) for name in MEASUREMENT_PARAMETERS}
        known |= dict(zip(self.estimated, estimated, strict=True))
        g, b, p = (jnp.asarray(known[n]) for n in ("gap_fraction", "background", "recollision"))
        r, t = recollided(reflectance, transmittance, p)
        through = t**2 * b / (1.0 - r * b)
        return (1.0 - g) * (r + through) + g * b, (1.0 - g) * t + g


def usual_measurement(
    shape: LeafShape, background: Any = 0.0, offset_deviation: float = 0.02
) -> AbstractMeasurement:
    """What an integrating sphere records of leaves of a shape, or a clip over a background.

    Of round leaves gaps are estimated, of those side by side the recollision too.

    **Arguments:** `shape`: "broad", "needle", "mat" or "culm"; `background`, `offset_deviation`:
    see `LeafOverBackground`.

    **Returns:** `IntegratingSphere` of broad leaves over black, else `LeafOverBackground`.

    **Raises:** `InputError` for an unknown shape.
    """
    check_leaf_shape(shape)
    black = background is not None and not np.any(np.asarray(background))
    if shape == "broad" and black:
        return IntegratingSphere(offset_deviation)
    return LeafOverBackground(
        background=background,
        gap_fraction=0.0 if shape == "broad" else None,
        recollision=None if shape in SIDE_BY_SIDE else 0.0,
        offset_deviation=offset_deviation,
    )


class LeafStack(AbstractMeasurement):
    """An optically thick pile of leaves, as a contact probe measures a mat of needles.

    R of infinitely many leaves, Stokes 1862: ((1 + R^2 - T^2) - D) / (2 R), written as
    2 R / (1 + R^2 - T^2 + D) with D^2 = (1 + R + T)(1 + R - T)(1 - R + T)(1 - R - T). The pile
    transmits nothing. N is hardly identified; its prior decides.
    """

    offset_deviation: float = 0.02
    """Prior standard deviation of an offset of R [-]."""

    @property
    def leaf_alone(self) -> bool:
        """Many leaves."""
        return False

    def observe(
        self, reflectance: Array, transmittance: Array, *estimated: Array
    ) -> tuple[Array, Array]:
        """R of the pile; T is zero."""
        r, t = reflectance, transmittance
        d2 = (1.0 + r + t) * (1.0 + r - t) * (1.0 - r + t) * (1.0 - r - t)
        # Where nothing is absorbed D has no slope; a leaf absorbs at least this much.
        d = jnp.sqrt(jnp.maximum(d2, 1e-12))
        return 2.0 * r / (1.0 + r**2 - t**2 + d), jnp.zeros_like(t)


def transmittance_from_two_readings(
    over_black: float | Float[Array | np.ndarray, "*#band"],
    over_white: float | Float[Array | np.ndarray, "*#band"],
    white: float | Float[Array | np.ndarray, "*#band"],
) -> Float[Array, "*band"]:
    """Leaf transmittance from a clip's readings over its black and its white face [-].

    T^2 = (R_w - R)(1 / B - R), from R_w = R + T^2 B / (1 - R B) for a Lambertian leaf over a black
    face that reflects nothing and a white face of reflectance B.

    An offset common to both readings, such as shine, nearly cancels. A relative error of B of 2 %
    is one of some 1 % / (1 - R B) of T, at all bands. Not identified: T where the leaf is nearly
    opaque (`resolved_by_two_readings`), and light that leaves a thick leaf sideways, which counts
    as absorbed.

    **Arguments:** `over_black`, `over_white`: reflectance of the leaf over the black and the white
    face, R and R_w [-]; `white`: reflectance B of the white face [-]. Shape [band], or a number.

    **Returns:** transmittance [band], 0 where noise makes the product negative, as it does for an
    opaque leaf. Differentiable where T > 0.
    """
    r, w, b = jnp.asarray(over_black), jnp.asarray(over_white), jnp.asarray(white)
    square = (w - r) * (1.0 / b - r)
    return jnp.where(square > 0.0, jnp.sqrt(jnp.where(square > 0.0, square, 1.0)), 0.0)


def resolved_by_two_readings(
    over_black: float | Float[Array | np.ndarray, "*#band"],
    through: float | Float[Array | np.ndarray, "*#band"],
    white: float | Float[Array | np.ndarray, "*#band"],
) -> Bool[np.ndarray, "*band"]:
    """Where `transmittance_from_two_readings` is better known than to 0.03.

    Its error by two readings that repeat within 0.002 is 0.002 sqrt(2) (1 / B - R) / (2 T): a leaf
    of T below some 0.03 to 0.05 is opaque to this method.

    **Arguments:** `over_black`: R [-]; `through`: T [-]; `white`: B [-]; shape [band].

    **Returns:** a mask [band]. NumPy.
    """
    r, t, b = (np.asarray(a, float) for a in (over_black, through, white))
    with np.errstate(divide="ignore", invalid="ignore"):
        error = _REPEATABILITY * (1.0 / b - r) / (np.sqrt(2.0) * t)
        return error < _TOLERATED


MEASUREMENTS: dict[str, Callable[[], AbstractMeasurement]] = {
    "sphere": IntegratingSphere,
    "leaf-clip": LeafClip,
    "probe": LeafClip,
    "stack": LeafStack,
}
"""Ways of measuring a leaf by their names in files and on the command line."""

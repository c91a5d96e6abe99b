"""How leaf normals are distributed, and the Ross-Nilson projection function G.

Every distribution is symmetric in azimuth and given by the density g of the inclination of the
normal from the vertical, with the integral of g over [0, 90°] equal to one.
"""

import abc
from collections.abc import Sequence
from functools import partial
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from fynjax._core.errors import InputError
from fynjax._core.programs import concrete

# Gauss-Legendre nodes of the inclination and the half turn of azimuths. A normal and its
# opposite are the same leaf, so inclinations up to 90 degrees cover all of them.
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(32)
_INCLINATION = 0.25 * np.pi * (_NODES + 1.0)
_INCLINATION_WEIGHT = 0.25 * np.pi * _WEIGHTS
_AZIMUTHS = 96
# The same, finer.
_FINE = 0.25 * np.pi * (np.polynomial.legendre.leggauss(256)[0] + 1.0)
_FINE_WEIGHT = np.polynomial.legendre.leggauss(256)[1]


def _unit_normals() -> np.ndarray:
    azimuth = (np.arange(_AZIMUTHS) + 0.5) * (2 * np.pi / _AZIMUTHS)
    sine, cosine = np.sin(_INCLINATION)[:, None], np.cos(_INCLINATION)[:, None]
    around = sine * np.sin(azimuth), sine * np.cos(azimuth)
    return np.stack([*around, np.broadcast_to(cosine, around[0].shape)], axis=-1).reshape(-1, 3)


_NORMALS = _unit_normals()


class AbstractLeafAngle(eqx.Module):
    """Distribution of leaf normals, symmetric in azimuth.

    Abstract: `SphericalLeafAngle`, `TrigonometricLeafAngle`, `VerhoefLeafAngle`,
    `EllipsoidalLeafAngle`, `TabulatedLeafAngle` and `TiltedLeafAngle` are the kinds,
    `leaf_angle` makes one by its name. A kind of your own states its `inclination_density` and
    nothing else: `projection` and `normals` follow from it, and are computed for many kinds at
    once. A class that defines either is refused (`TypeError`).
    """

    def __init_subclass__(cls, **options: Any) -> None:
        super().__init_subclass__(**options)
        anew = sorted({"projection", "normals"} & vars(cls).keys())
        if anew and cls.__module__ != __name__:
            raise TypeError(
                f"`{cls.__name__}` must not define {' and '.join(anew)}: these follow from "
                "`inclination_density`, from which many distributions are computed at once"
            )

    @abc.abstractmethod
    def inclination_density(self, inclination: Float[Array, "*n"]) -> Float[Array, "*n"]:
        """Density g of the inclination [1/rad] at `inclination` [rad, 0 to pi/2]."""

    def projection(self, cos_zenith: float | Float[Array | np.ndarray, "*n"]) -> Float[Array, "*n"]:
        """G: leaf area projected along a direction, per unit of leaf area [-].

        `cos_zenith` in [-1, 1]; a direction and its opposite give the same value.
        Differentiable in `cos_zenith` and in the parameters of the distribution. Ross (1981),
        with Nilson's (1971) closed form of the integral over the leaf's azimuth.
        """
        return _projection(self._weights()[None], jnp.asarray(cos_zenith))[0]

    def _weights(self) -> Float[Array, " node"]:
        """Share of the leaf area at each node of the inclination."""
        nodes, share = (jnp.asarray(a, float) for a in (_INCLINATION, _INCLINATION_WEIGHT))
        weight = self.inclination_density(nodes) * share
        return weight / jnp.sum(weight)

    @property
    def mean_angle(self) -> Float[Array, ""]:
        """Mean inclination of the leaf area [degrees]. Differentiable."""
        return jnp.rad2deg(self._weights() @ jnp.asarray(_INCLINATION, float))

    def normals(self) -> tuple[Float[Array, "normal 3"], Float[Array, " normal"]]:
        """Quadrature over the leaf normals of the upper hemisphere: unit vectors, weights.

        The weights sum to one.
        """
        return jnp.asarray(_NORMALS, float), jnp.repeat(self._weights() / _AZIMUTHS, _AZIMUTHS)


def projections(
    angles: Sequence[AbstractLeafAngle], cos_zenith: Float[Array, "*n"]
) -> Float[Array, " angle *n"]:
    """`AbstractLeafAngle.projection` of several distributions at once [-].

    **Arguments:** `angles`, the distributions; `cos_zenith`, as there.
    """
    cos_zenith = jnp.asarray(cos_zenith)
    # Of spherical leaves G is known; those of all others are one product with their weights.
    spherical = [isinstance(angle, SphericalLeafAngle) for angle in angles]
    weights = [angle._weights() for angle, even in zip(angles, spherical) if not even]
    each = iter(_projection(jnp.stack(weights), cos_zenith) if weights else ())
    return jnp.stack([jnp.full_like(cos_zenith, 0.5) if even else next(each) for even in spherical])


@partial(jax.jit, inline=True)
def _projection(
    weights: Float[Array, " angle node"], cos_zenith: Float[Array, "*n"]
) -> Float[Array, " angle *n"]:
    # The mean of |cosine| between ray and normal over the azimuths of normals that lean by `leaf`
    # (Nilson 1971): up to a lean of 90 degrees less the zenith angle the ray meets one side of all.
    mu = jnp.abs(cos_zenith)[..., None]
    leaf = jnp.asarray(_INCLINATION, mu.dtype)
    straight = mu * jnp.cos(leaf)
    # |sin| through a guarded root: its slope is infinite at the zenith.
    sine = jnp.sqrt(jnp.maximum(1.0 - mu**2, 1e-12)) * jnp.sin(leaf)
    partly = sine > straight  # both sides face the ray as the azimuth turns
    ratio = jnp.where(partly, straight / jnp.where(partly, sine, 1.0), 0.0)
    root = jnp.sqrt(1.0 - ratio**2)
    turned = 2.0 / jnp.pi * (sine * root + straight * jnp.arcsin(ratio))
    kernel = jnp.where(partly, turned, straight)
    return jnp.tensordot(weights.astype(mu.dtype), kernel, axes=((1,), (kernel.ndim - 1,)))


class SphericalLeafAngle(AbstractLeafAngle):
    """Normals as on a sphere: g = sin(inclination), G = 1/2 in every direction."""

    def inclination_density(self, inclination: Float[Array, "*n"]) -> Float[Array, "*n"]:
        """g = sin(t) [1/rad] at the `inclination` t [rad, 0 to pi/2]."""
        return jnp.sin(inclination)

    def projection(self, cos_zenith: float | Float[Array | np.ndarray, "*n"]) -> Float[Array, "*n"]:
        """1/2 [-] in every direction `cos_zenith`."""
        return jnp.full_like(jnp.asarray(cos_zenith), 0.5)


class TrigonometricLeafAngle(AbstractLeafAngle):
    """g = (2/pi) (1 + a cos 2t + b cos 4t), t the inclination (Bunnik 1978).

    (a, b) = (1, 0) is planophile, (-1, 0) erectophile, (0, -1) plagiophile, (0, 1)
    extremophile and (0, 0) uniform in inclination, with mean inclinations of 26.8, 63.2, 45, 45 and
    45 degrees. PROSAIL has distributions of the same names and coefficients that are steeper: see
    `VerhoefLeafAngle`.
    """

    second: Float[Array, ""] = eqx.field(converter=jnp.asarray)
    """Coefficient a of cos 2t [-]."""
    fourth: Float[Array, ""] = eqx.field(converter=jnp.asarray)
    """Coefficient b of cos 4t [-]."""

    def inclination_density(self, inclination: Float[Array, "*n"]) -> Float[Array, "*n"]:
        """g [1/rad] at the `inclination` t [rad, 0 to pi/2]. Differentiable in t, a and b."""
        second = self.second.astype(inclination.dtype)
        fourth = self.fourth.astype(inclination.dtype)
        wave = second * jnp.cos(2 * inclination) + fourth * jnp.cos(4 * inclination)
        return 2.0 / jnp.pi * (1.0 + wave)


class VerhoefLeafAngle(AbstractLeafAngle):
    """Verhoef's (1998) two-parameter distribution: that of PROSAIL, `TypeLidf=1`.

    | name in PROSAIL | LIDFa | LIDFb | mean inclination [degrees] |
    | --- | --- | --- | --- |
    | planophile | 1 | 0 | 8.5 |
    | erectophile | -1 | 0 | 81.5 |
    | plagiophile | 0 | -1 | 45 |
    | extremophile | 0 | 1 | 45 |
    | spherical, nearly | -0.35 | -0.15 | 57.8 |
    | uniform | 0 | 0 | 45 |

    These are other distributions than those that `leaf_angle` has by the same names: its
    erectophile is Bunnik's, of mean 63.2 degrees. In PROSAIL all leaves of a class of 5 degrees
    have the middle of it, so that the first two have means of 9.4 and 80.6 there.

    With x the root of x - a sin x - b/2 sin 2x = 2t, t the inclination, the share of leaves below t
    is 2 (x - t) / pi (Verhoef 1998, Theory of radiative transfer models applied in optical remote
    sensing of vegetation canopies, thesis, Wageningen). Hence, by the derivative of the root,
    g = (2/pi) (1 + q) / (1 - q) with q = a cos x + b cos 2x.

    **Raises:** `InputError` where |a| + |b| exceeds 1, of known values.

    >>> from fynjax.canopy import VerhoefLeafAngle
    >>> import jax.numpy as jnp
    >>> VerhoefLeafAngle(-1.0, 0.0).projection(jnp.array([1.0, 0.5])).round(3)  # G at 0, 60 degrees
    Array([0.141, 0.541], dtype=float32)
    """

    first: Float[Array, ""] = eqx.field(converter=jnp.asarray)
    """Coefficient a, LIDFa [-]: the mean slope."""
    second: Float[Array, ""] = eqx.field(converter=jnp.asarray)
    """Coefficient b, LIDFb [-]: how far it has two peaks."""

    def __check_init__(self) -> None:
        if not concrete(self.first, self.second):
            return
        a, b = float(self.first), float(self.second)
        if not abs(a) + abs(b) <= 1.0 + 1e-6:
            raise InputError(
                "the coefficients of `VerhoefLeafAngle` must have |first| + |second| <= 1, but are "
                f"{a:g} and {b:g}"
            )

    def inclination_density(self, inclination: Float[Array, "*n"]) -> Float[Array, "*n"]:
        """g [1/rad] at the `inclination` t [rad, 0 to pi/2]. Differentiable in t, a and b.

        At |a| + |b| = 1 it has an end without bound, of finite area; there it is cut off.
        """
        a, b = (value.astype(inclination.dtype) for value in (self.first, self.second))

        def halve(_: Array, ends: tuple[Array, Array]) -> tuple[Array, Array]:
            middle = 0.5 * (ends[0] + ends[1])
            above = middle - a * jnp.sin(middle) - 0.5 * b * jnp.sin(2 * middle) > 2 * inclination
            return jnp.where(above, ends[0], middle), jnp.where(above, middle, ends[1])

        # The left-hand side rises with x where |a| + |b| <= 1, so that halving finds its one root.
        ends = jnp.zeros_like(inclination), jnp.full_like(inclination, jnp.pi)
        x = jax.lax.stop_gradient(jax.lax.fori_loop(0, 50, halve, ends)[0])
        # A step of Newton's, of which the derivative is that of the root.
        excess = x - a * jnp.sin(x) - 0.5 * b * jnp.sin(2 * x) - 2 * inclination
        slope = jnp.maximum(1.0 - a * jnp.cos(x) - b * jnp.cos(2 * x), 1e-3)
        x = x - excess / jax.lax.stop_gradient(slope)
        wave = a * jnp.cos(x) + b * jnp.cos(2 * x)
        return 2.0 / jnp.pi * (1.0 + wave) / jnp.maximum(1.0 - wave, 1e-3)

    def _weights(self) -> Float[Array, " node"]:
        # By x, in which shares and inclinations are explicit and nothing is without bound: each
        # share goes to the nodes on either side, so that the mean is kept.
        a, b = self.first, self.second
        x = 2.0 * jnp.asarray(_FINE, jnp.result_type(a, float))
        inclination = 0.5 * (x - a * jnp.sin(x) - 0.5 * b * jnp.sin(2 * x))
        share = jnp.asarray(_FINE_WEIGHT, x.dtype) * (1.0 + a * jnp.cos(x) + b * jnp.cos(2 * x))
        nodes = jnp.asarray(_INCLINATION, x.dtype)
        above = jnp.clip(jnp.searchsorted(nodes, inclination), 1, len(_INCLINATION) - 1)
        low, high = nodes[above - 1], nodes[above]
        upper = jnp.clip((inclination - low) / (high - low), 0.0, 1.0)
        weight = jnp.zeros(len(_INCLINATION), x.dtype)
        weight = weight.at[above - 1].add(share * (1.0 - upper)).at[above].add(share * upper)
        return weight / jnp.sum(weight)


class EllipsoidalLeafAngle(AbstractLeafAngle):
    """Normals as on an ellipsoid of revolution (Campbell 1990, eq. 13, normalised here)."""

    ratio: Float[Array, ""] = eqx.field(converter=jnp.asarray)
    """Horizontal to vertical axis, chi [-], positive; 1 is spherical, large is flat leaves."""

    @classmethod
    def from_mean_angle(cls, mean: Float[Array, ""] | float) -> "EllipsoidalLeafAngle":
        """The distribution that PROSAIL has by a mean leaf angle, `TypeLidf=2`.

        **Arguments:** `mean`, average inclination [degrees], 0 to 90; spherical near 58.

        **Returns:** that of the ratio exp(3.2491 - 0.1239 m + 2.1145e-3 m^2 - 1.6184e-5 m^3), the
        fit of 4SAIL's `campbell` function: its mean inclination is within 1.3 degrees of
        `mean` from 5 to 85. Differentiable.
        """
        ratio = 3.2491 + mean * (-0.12390 + mean * (2.1145e-3 - 1.6184e-5 * mean))
        return cls(jnp.exp(ratio))

    def inclination_density(self, inclination: Float[Array, "*n"]) -> Float[Array, "*n"]:
        """g [1/rad] at the `inclination` [rad, 0 to pi/2]. Differentiable in it and in chi."""
        chi = self.ratio.astype(inclination.dtype)
        shape = jnp.cos(inclination) ** 2 + chi**2 * jnp.sin(inclination) ** 2
        density = chi**3 * jnp.sin(inclination) / shape**2
        # Normalised by the quadrature that makes G: the closed constant has a branch at chi = 1.
        nodes = jnp.asarray(_INCLINATION, inclination.dtype)
        weight = jnp.asarray(_INCLINATION_WEIGHT, inclination.dtype)
        at_nodes = jnp.cos(nodes) ** 2 + chi**2 * jnp.sin(nodes) ** 2
        return density / jnp.sum(weight * chi**3 * jnp.sin(nodes) / at_nodes**2)


class TabulatedLeafAngle(AbstractLeafAngle):
    """A histogram of inclinations, for instance of the normals of a plant model."""

    density: Float[Array, " bin"] = eqx.field(converter=jnp.asarray)
    """Density in equal bins of inclination from 0 to 90 degrees [1/rad]; normalised on use."""

    @classmethod
    def from_normals(
        cls,
        normals: Float[Array | np.ndarray, "n 3"],
        area: Float[Array | np.ndarray, " n"],
        bins: int = 18,
    ) -> "TabulatedLeafAngle":
        """Area-weighted histogram of the inclinations of a plant's normals.

        **Arguments:**

        - `normals`: unit vectors; their sign does not matter.
        - `area`: weight of each [m2], positive in sum.
        - `bins`: number of equal bins from 0 to 90 degrees.

        Not differentiable.
        """
        inclination = np.arccos(np.clip(np.abs(np.asarray(normals)[:, 2]), 0.0, 1.0))
        # A normal and its opposite are one leaf: only the size of the vertical part counts.
        counts, _ = np.histogram(
            inclination, bins=bins, range=(0.0, 0.5 * np.pi), weights=np.asarray(area)
        )
        return cls(counts / counts.sum() / (0.5 * np.pi / bins))

    def inclination_density(self, inclination: Float[Array, "*n"]) -> Float[Array, "*n"]:
        """g [1/rad] of the bin that holds `inclination` [rad, 0 to pi/2]; its slope is zero."""
        bins = self.density.shape[0]
        index = jnp.clip((inclination * (2 * bins / jnp.pi)).astype(int), 0, bins - 1)
        return self.density.astype(inclination.dtype)[index]


class TiltedLeafAngle(AbstractLeafAngle):
    """Another distribution times exp(tilt x inclination): of all that have its mean inclination the
    one that differs least from the other, by relative entropy (Kullback 1959)."""

    base: AbstractLeafAngle
    """The other, whose mean inclination a tilt of 0 leaves as it is."""
    tilt: Float[Array, ""] = eqx.field(converter=jnp.asarray)
    """[1/rad]; above 0 leaves stand more upright."""

    @classmethod
    def to_means(
        cls, angles: Sequence[AbstractLeafAngle], means: Float[Array | np.ndarray, " angle"]
    ) -> tuple["TiltedLeafAngle", ...]:
        """Distributions tilted to mean inclinations.

        **Arguments:** `angles`, the distributions; `means` [degrees], above 0 and below 90. To one
        that a histogram without leaves beyond some inclination cannot have a tilt of 60 comes
        nearest.

        First derivatives by `means` and by the parameters of `angles` are exact.
        """
        weight = jnp.stack([angle._weights() for angle in angles])
        wanted = jnp.deg2rad(jnp.asarray(means, weight.dtype))
        tilt = _tilts(weight, wanted)
        return tuple(cls(*pair) for pair in zip(angles, jnp.unstack(tilt), strict=True))

    def inclination_density(self, inclination: Float[Array, "*n"]) -> Float[Array, "*n"]:
        """g [1/rad] at the `inclination` [rad, 0 to pi/2]. Differentiable in it, the tilt and the
        parameters of the other distribution."""
        tilt, nodes = self.tilt, jnp.asarray(_INCLINATION, float)
        top = jnp.where(tilt > 0, 0.5 * jnp.pi, 0.0)  # nothing overflows
        total = self.base._weights() @ jnp.exp(tilt * (nodes - top))
        more = jnp.exp(tilt * (inclination - top)) / total
        return self.base.inclination_density(inclination) * more.astype(inclination.dtype)

    def _weights(self) -> Float[Array, " node"]:
        return _tilted(self.base._weights(), self.tilt)


_STEEPEST_TILT = 60.0
"""Largest tilt [1/rad]: of spherical leaves it makes the mean inclination 2 or 89 degrees."""


def _tilted(weight: Float[Array, "*n node"], tilt: Float[Array, "*n"]) -> Float[Array, "*n node"]:
    powers = tilt[..., None] * jnp.asarray(_INCLINATION, weight.dtype)
    powers = jnp.where(weight > 0, powers, -jnp.inf)  # lest all that is there underflows
    more = weight * jnp.exp(powers - powers.max(axis=-1, keepdims=True))
    return more / more.sum(axis=-1, keepdims=True)


def _tilts(
    weight: Float[Array, "angle node"], wanted: Float[Array, " angle"]
) -> Float[Array, " angle"]:
    """Tilts by which leaves have the mean inclinations `wanted` [rad]."""
    nodes = jnp.asarray(_INCLINATION, weight.dtype)
    known, target = jax.lax.stop_gradient((weight, wanted))

    def halved(_: Array, ends: tuple[Array, Array]) -> tuple[Array, Array]:
        middle = 0.5 * (ends[0] + ends[1])
        low = _tilted(known, middle) @ nodes < target
        return jnp.where(low, middle, ends[0]), jnp.where(low, ends[1], middle)

    ends = jnp.full_like(target, -_STEEPEST_TILT), jnp.full_like(target, _STEEPEST_TILT)
    ends = jax.lax.fori_loop(0, 40, halved, ends)
    tilt = 0.5 * (ends[0] + ends[1])
    # A step of Newton's, whose derivative is that of the solution: the mean grows by the variance.
    share = _tilted(known, tilt)
    variance = share @ nodes**2 - (share @ nodes) ** 2
    step = (wanted - _tilted(weight, tilt) @ nodes) / jnp.maximum(variance, 1e-6)
    return tilt + jnp.where(jnp.abs(tilt) < 0.999 * _STEEPEST_TILT, step, 0.0)


_TRIGONOMETRIC = {
    "uniform": (0.0, 0.0),
    "planophile": (1.0, 0.0),
    "erectophile": (-1.0, 0.0),
    "plagiophile": (0.0, -1.0),
    "extremophile": (0.0, 1.0),
}


def leaf_angle(name: str) -> AbstractLeafAngle:
    """The leaf angle distribution of a given name.

    **Arguments:**

    - `name`: spherical, uniform (in inclination), planophile, erectophile, plagiophile or
      extremophile (de Wit 1965; Bunnik 1978). RAMI's "uniform" means normals uniform on the
      sphere: that is `spherical` here. PROSAIL's distributions of these names are others
      (`VerhoefLeafAngle`): its erectophile leaves have the mean inclination 81 degrees, those
      here 63.

    **Returns:** an `AbstractLeafAngle`.

    **Raises:** `InputError` for any other name.

    >>> import jax.numpy as jnp
    >>> from fynjax.canopy import leaf_angle
    >>> flat = leaf_angle("planophile")
    >>> flat.projection(jnp.array([1.0, 0.5])).round(3)  # G at zenith angles 0 and 60 degrees
    Array([0.849, 0.473], dtype=float32)
    """
    if name == "spherical":
        return SphericalLeafAngle()
    if name not in _TRIGONOMETRIC:
        known = ", ".join(["spherical", *_TRIGONOMETRIC])
        raise InputError(
            f"`name` of a leaf angle distribution must be one of {known}, but is {name!r}"
        )
    second, fourth = (jnp.asarray(value) for value in _TRIGONOMETRIC[name])
    return TrigonometricLeafAngle(second, fourth)

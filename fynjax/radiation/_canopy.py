"""A canopy without sides: the same everywhere, described by its leaf area index alone."""

from __future__ import annotations  # so that `help` shows ArrayLike by its name

import math
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float

from fynjax._core.errors import InputError
from fynjax.canopy import AbstractLeafAngle
from fynjax.radiation._arrays import voxel_scene
from fynjax.radiation._check import as_floats, check_range
from fynjax.radiation._fluxes import fluxes
from fynjax.radiation._phase import area_scattering
from fynjax.radiation._render import Accuracy, directional_reflectance, solve_light
from fynjax.radiation._scene import VoxelScene

_ACCURACY = Accuracy(
    lattice=1, coarsening=(1, 1), levels=6, azimuths=8, tolerance=1e-7, solves=None
)
# Depths of the canopy, as shares, and their weights: closer to the top, where leaves that the sun
# and the sensor meet together are the same.
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(32)
_DEPTHS = (0.5 * (_NODES + 1.0)) ** 3
_DEPTH_WEIGHTS = 0.5 * _WEIGHTS * 3.0 * (0.5 * (_NODES + 1.0)) ** 2


def canopy_reflectance(
    leaf_reflectance: Float[ArrayLike, " band"],
    leaf_transmittance: Float[ArrayLike, " band"],
    leaf_area_index: Float[ArrayLike, ""] = 3.0,
    *,
    soil: Float[ArrayLike, " band"] | float = 0.15,
    leaf_angles: str | AbstractLeafAngle = "spherical",
    sun_zenith: Float[ArrayLike, ""] = 30.0,
    view_zenith: Float[ArrayLike, ""] = 0.0,
    relative_azimuth: Float[ArrayLike, ""] = 0.0,
    sky_share: Float[ArrayLike, " band"] | Float[ArrayLike, ""] = 0.0,
    hot_spot: Float[ArrayLike, ""] = 0.01,
    layers: int = 20,
) -> Float[Array, " band"]:
    """Reflectance factor of a horizontally uniform canopy: PROSAIL's 4SAIL, its fluxes exact.

    Light scattered once is in closed form, with the hot spot of 4SAIL (Kuusk 1991; Verhoef 1998;
    Verhoef et al. 2007). The rest is that of plots (`solve_light`), by discrete ordinates with all
    orders in place of 4SAIL's two diffuse streams.

    **Arguments:**

    - `leaf_reflectance`, `leaf_transmittance`: hemispherical, of one side [-], in [0, 1] and
      together at most 1.
    - `leaf_area_index`: one-sided leaf area over ground area [m2 m-2], at least 0.
    - `soil`: reflectance of the ground, Lambertian [-].
    - `leaf_angles`: a name (`fynjax.canopy.leaf_angle`) or a distribution; PROSAIL's are
      `fynjax.canopy.VerhoefLeafAngle` and `EllipsoidalLeafAngle.from_mean_angle`.
    - `sun_zenith`, `view_zenith`: [degrees], from 0 to less than 89.5.
    - `relative_azimuth`: azimuth of the view less that of the sun [degrees]; at 0 the sun is
      behind the sensor.
    - `sky_share`: diffuse over total irradiance [-].
    - `hot_spot`: leaf size over canopy height [-], PROSAIL's `hspot`, at least 0; 0 makes points of
      the leaves. The default is that of the examples of PROSAIL. A round leaf counts with
      0.42 (horizontal) to 0.67 (spherical) of its diameter, by which the area that both ways have
      in common is the same. Scenes of voxels take the diameter, and the overlap of discs in place
      of an exponential one: up to 5 % brighter beside the hot spot in the red, the same in it.
    - `layers`: the canopy is cut into as many; below 0.5 % of error with 20.

    **Returns:** the bidirectional reflectance factor [-], with a sky the hemispherical-directional.
    Differentiable in every argument but `layers`. In the hot spot itself reflectance has a peak, as
    a cone has: there its derivative by the angles is that of a rounded one.

    **Raises:** `InputError` for shapes that do not go together and values out of range.

    **Source:** Kuusk, A. (1991), The hot spot effect in plant canopy reflectance, in Photon-
    Vegetation Interactions, Springer, 139-159; Verhoef, W. (1998), thesis, Wageningen; Verhoef, W.
    et al. (2007), IEEE TGRS 45, 1808-1822. Tested against 4SAIL (`prosail` 2.0.5), 32-stream
    discrete ordinates and a Monte Carlo.

    >>> import jax.numpy as jnp
    >>> from fynjax.radiation import canopy_reflectance
    >>> leaf = jnp.array([0.06, 0.45]), jnp.array([0.03, 0.45])  # red, near infrared
    >>> [round(float(value), 3) for value in canopy_reflectance(*leaf, 2.0)]
    [0.036, 0.297]
    >>> [round(float(value), 3) for value in canopy_reflectance(*leaf, 2.0, view_zenith=30.0)]
    [0.08, 0.447]
    """
    share = as_floats("sky_share", sky_share)
    check_range("sky_share", share, 0.0, 1.0)
    size = as_floats("hot_spot", hot_spot)
    check_range("hot_spot", size, 0.0, math.inf, ends="[)")
    scene, area = _uniform(
        leaf_reflectance,
        leaf_transmittance,
        leaf_area_index,
        soil,
        leaf_angles,
        sun_zenith,
        layers,
        (1.0 - share, share),
    )
    zenith, azimuth = (
        as_floats(name, value, area.dtype)
        for name, value in (("view_zenith", view_zenith), ("relative_azimuth", relative_azimuth))
    )
    check_range("view_zenith [degrees]", zenith, 0.0, 89.5, ends="[)")
    return _solve_and_look(scene, area, zenith, azimuth, size.astype(area.dtype))


class CanopyAlbedo(NamedTuple):
    """What a canopy reflects in all directions together, over what it receives [-]."""

    black_sky: Float[Array, " band"]
    """Directional-hemispherical reflectance (DHR): of the sun alone."""
    white_sky: Float[Array, " band"]
    """Bihemispherical reflectance (BHR): of a sky of even radiance alone."""


def canopy_albedo(
    leaf_reflectance: Float[ArrayLike, " band"],
    leaf_transmittance: Float[ArrayLike, " band"],
    leaf_area_index: Float[ArrayLike, ""] = 3.0,
    *,
    soil: Float[ArrayLike, " band"] | float = 0.15,
    leaf_angles: str | AbstractLeafAngle = "spherical",
    sun_zenith: Float[ArrayLike, ""] = 30.0,
    layers: int = 20,
) -> CanopyAlbedo:
    """Black-sky and white-sky albedo of a horizontally uniform canopy (DHR and BHR).

    **Arguments:**

    - `leaf_reflectance`, `leaf_transmittance`, `leaf_area_index`, `soil`, `leaf_angles`,
      `sun_zenith`, `layers`: as `canopy_reflectance` takes them.

    **Returns:** `CanopyAlbedo`, the directional-hemispherical and the bihemispherical reflectance
    in each band [-]; of light that is a share d from the sky, (1 - d) DHR + d BHR. The hot spot
    does not count, as in 4SAIL: light is conserved, and DHR is the mean over the upper hemisphere
    of `canopy_reflectance` with `hot_spot=0`. Differentiable in every argument but `layers`.

    **Raises:** `InputError` for shapes that do not go together and values out of range.

    **Source:** terms of Schaepman-Strub et al. (2006), RSE 103, 27-42. Tested against 32-stream
    discrete ordinates.

    >>> import jax.numpy as jnp
    >>> from fynjax.radiation import canopy_albedo
    >>> albedo = canopy_albedo(jnp.array([0.06, 0.45]), jnp.array([0.03, 0.45]), 2.0)
    >>> albedo.black_sky.round(3), albedo.white_sky.round(3)
    (Array([0.03 , 0.335], dtype=float32), Array([0.029, 0.388], dtype=float32))
    """
    rho, tau = (
        jnp.atleast_1d(as_floats(name, value))
        for name, value in (
            ("leaf_reflectance", leaf_reflectance),
            ("leaf_transmittance", leaf_transmittance),
        )
    )
    bands = rho.shape
    ground = jnp.broadcast_to(as_floats("soil", soil, rho.dtype), bands)
    twice = lambda values: jnp.concatenate([values, values])  # noqa: E731
    sun = jnp.concatenate([jnp.ones(bands), jnp.zeros(bands)])
    scene, _ = _uniform(
        twice(rho),
        twice(tau),
        leaf_area_index,
        twice(ground),
        leaf_angles,
        sun_zenith,
        layers,
        (sun, 1.0 - sun),
    )
    return CanopyAlbedo(*jnp.split(_solve_and_sum(scene), 2))


def _uniform(
    leaf_reflectance: Any,
    leaf_transmittance: Any,
    leaf_area_index: Any,
    soil: Any,
    leaf_angles: str | AbstractLeafAngle,
    sun_zenith: Any,
    layers: int,
    light: tuple[Array, Array],
) -> tuple[VoxelScene, Float[Array, ""]]:
    """One column of voxels, a metre high, sides periodic, and its leaf area; `light`: sun, sky."""
    if not isinstance(layers, int | np.integer) or layers < 1:
        raise InputError(f"`layers` must be a whole number of 1 or more, but is {layers!r}")
    rho = as_floats("leaf_reflectance", leaf_reflectance)
    area = as_floats("leaf_area_index", leaf_area_index, rho.dtype)
    check_range("leaf_area_index", area, 0.0, 100.0)
    if area.ndim:
        raise InputError(
            f"`leaf_area_index` must be one number, but has shape {area.shape}: for many canopies "
            "take jax.vmap"
        )
    rho = jnp.atleast_1d(rho)
    below = as_floats("soil", soil, rho.dtype)
    if below.shape not in ((), (1,), rho.shape):
        raise InputError(
            f"`soil` must be a number, or one for each of {rho.size} bands, but has shape "
            f"{below.shape}"
        )
    tau = jnp.atleast_1d(as_floats("leaf_transmittance", leaf_transmittance, rho.dtype))
    sun, sky = (jnp.broadcast_to(part, rho.shape).astype(rho.dtype) for part in light)
    scene = voxel_scene(
        jnp.broadcast_to(area, (1, layers, 1, 1)),
        rho[None],
        tau[None],
        voxel=(1.0, 1.0, 1.0 / layers),
        ground=jnp.broadcast_to(below, rho.shape),
        sun_zenith=sun_zenith,
        sun_azimuth=0.0,
        sun=sun,
        sky=sky,
        leaf_angles=leaf_angles,
    )
    return scene, area


@eqx.filter_jit
def _solve_and_look(
    scene: VoxelScene, area: Array, zenith: Array, azimuth: Array, size: Array
) -> Float[Array, " band"]:
    """Compiled once for all canopies of as many bands and layers."""
    light = solve_light(scene, _ACCURACY)
    points = directional_reflectance(light, zenith[None], azimuth[None])[0]
    return points + scene.illumination.sun * _hot_spot(scene, area, zenith, azimuth, size)


@eqx.filter_jit
def _solve_and_sum(scene: VoxelScene) -> Float[Array, " band"]:
    return fluxes(solve_light(scene, _ACCURACY)).albedo


def _hot_spot(
    scene: VoxelScene, area: Array, zenith: Array, azimuth: Array, size: Array
) -> Float[Array, " band"]:
    """What leaves of a `size`, over the height, add to the reflectance factor of points [-].

    A point at the depth x is seen and lit with the probability exp(-(k + K) L x + C), k and K the
    extinction of both ways and C = sqrt(k K) L s (1 - exp(-x / s)), where s = (k + K) q / (2 D),
    q the size and D the distance at which both ways leave a canopy of unit height (Verhoef et al.
    2007, of Kuusk 1991, with the factor (k + K) / 2 of Breon).
    """
    angle, classes = scene.classes.angles[0], scene.classes
    angles = jnp.deg2rad(jnp.stack([scene.illumination.sun_zenith, zenith]))
    turn = jnp.deg2rad(azimuth)
    sine, cosine = jnp.sin(angles), jnp.cos(angles)
    to_sun = jnp.stack([jnp.zeros_like(turn), sine[0], cosine[0]])
    to_view = jnp.stack([sine[1] * jnp.sin(turn), sine[1] * jnp.cos(turn), cosine[1]])
    k, big_k = angle.projection(cosine) / cosine
    slope = sine / cosine
    # Written without a difference of large numbers, and rounded by a millionth, lest its derivative
    # has no value in the hot spot.
    apart = (slope[0] - slope[1]) ** 2 + 4.0 * slope[0] * slope[1] * jnp.sin(0.5 * turn) ** 2
    distance = jnp.sqrt(apart + 1e-12)
    reach = jnp.maximum(0.5 * (k + big_k) * size / distance, 1e-9)

    def added(depth: Array) -> Array:
        both = -jnp.sqrt(k * big_k) * area * reach * jnp.expm1(-depth / reach)
        # exp(both) alone would overflow; its exponent here is at most 0.
        return -jnp.exp(both - (k + big_k) * area * depth) * jnp.expm1(-both)

    depths, weights = (jnp.asarray(a, area.dtype) for a in (_DEPTHS, _DEPTH_WEIGHTS))
    reflected, transmitted = area_scattering(angle, -to_sun[None], to_view[None])
    scattered = classes.reflectance[0] * reflected + classes.transmittance[0] * transmitted
    leaves = area * (weights @ added(depths)) / (cosine[0] * cosine[1])
    return scattered[0] * leaves + scene.ground * added(jnp.ones_like(area))

"""A scene from plain arrays."""

from __future__ import annotations  # so that `help` shows ArrayLike by its name

import math
from collections.abc import Iterable, Sequence
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float

from fynjax._core.errors import InputError
from fynjax.canopy import AbstractLeafAngle, leaf_angle
from fynjax.radiation._check import as_floats, check_range, check_scene, check_shape, short
from fynjax.radiation._ground import RahmanPintyVerstraete
from fynjax.radiation._scene import Illumination, OpticalClasses, VoxelScene


def voxel_scene(
    area_density: Float[ArrayLike, "class z y x"],
    reflectance: Float[ArrayLike, "class band"],
    transmittance: Float[ArrayLike, "class band"],
    *,
    voxel: tuple[float, float, float],
    ground: Float[ArrayLike, " band *yx"],
    sun_zenith: Float[ArrayLike, ""],
    sun_azimuth: Float[ArrayLike, ""] = 180.0,
    sun: Float[ArrayLike, " band"] | float = 1.0,
    sky: Float[ArrayLike, " band"] | float = 0.0,
    sky_pattern: Float[ArrayLike, "*band zenith azimuth"] | None = None,
    leaf_angles: str | AbstractLeafAngle | Sequence[str | AbstractLeafAngle] = "spherical",
    leaf_diameter: float | Sequence[float] | None = None,
    ground_shape: RahmanPintyVerstraete | None = None,
    terrain: Float[ArrayLike, "y x"] | None = None,
    boundary: str = "periodic",
) -> VoxelScene:
    """A scene from plain arrays, checked.

    **Arguments:**

    - `area_density`: one-sided area per volume of each class [m2 m-3], not negative; layers from
      the ground up, rows from the south, columns from the west.
    - `reflectance`, `transmittance`: of one side of a leaf [-], at least 0 and at most 1 in sum.
    - `voxel`: edges of a voxel in x, y and z [m]; the first two must be equal.
    - `ground`: reflectance [-], one value a band or a map for each, 0 to 1.
    - `sun_zenith`: zenith angle of the sun [degrees], in [0, 89.5).
    - `sun_azimuth`: azimuth of the sun, clockwise from north [degrees].
    - `sun`, `sky`: direct and diffuse irradiance on the horizontal plane [any unit], one value or
      one a band, not negative.
    - `sky_pattern`: relative radiance of the sky, see `Illumination`.
    - `leaf_angles`: a name (see `fynjax.canopy.leaf_angle`) or a distribution, for all classes or
      each.
    - `leaf_diameter`: of round leaves [m], for all classes or each; makes the hot spot.
    - `ground_shape`, `terrain`, `boundary`: see `VoxelScene`. Terrain together with `ground_shape`
      is refused by `solve_light`: ground of a shape of its own must be level.

    **Returns:** a `VoxelScene`, in the floating type of `area_density`. Differentiable: the arrays
    become its leaves.

    **Raises:** `InputError` for shapes that do not go together, for what is not numbers, and for
    values out of range (where they are known, that is outside a transformation).

    >>> import jax.numpy as jnp
    >>> from fynjax.radiation import voxel_scene
    >>> scene = voxel_scene(
    ...     area_density=jnp.full((1, 2, 4, 4), 2.0),  # one class, 2 layers, 4 x 4 columns
    ...     reflectance=jnp.array([[0.05, 0.45]]),  # red, near infrared
    ...     transmittance=jnp.array([[0.03, 0.45]]),
    ...     voxel=(0.25, 0.25, 0.25),
    ...     ground=jnp.array([0.2, 0.3]),
    ...     sun_zenith=30.0,
    ... )
    >>> scene.shape, scene.height
    ((2, 4, 4), 0.5)
    """
    density = as_floats("area_density", area_density)
    dtype = density.dtype
    rho = as_floats("reflectance", reflectance, dtype)
    tau = as_floats("transmittance", transmittance, dtype)
    edges = np.asarray(check_shape("voxel", voxel, (3,), ": they are its edges in x, y and z [m]"))
    check_range("voxel [m]", edges, 0.0, math.inf, ends="()")
    if not np.isclose(edges[0], edges[1], rtol=1e-6):
        raise InputError(
            "`voxel` must be the edges in x, y and z [m], with the first two equal, but is "
            f"{voxel}: resample the grid to square columns"
        )
    if density.ndim != 4 or rho.ndim != 2:
        raise InputError(
            "`area_density` must have the axes [class, z, y, x] and `reflectance` [class, band], "
            f"but they have shapes {density.shape} and {rho.shape}"
        )
    classes, bands = density.shape[0], rho.shape[1]
    single = isinstance(leaf_angles, str | AbstractLeafAngle)
    given = _leaf_angles(leaf_angles)
    distinct = list({id(a) if not isinstance(a, str) else a: a for a in given}.values())
    owner = [next(i for i, d in enumerate(distinct) if d is a or d == a) for a in given]
    sizes = None if leaf_diameter is None else as_floats("leaf_diameter", leaf_diameter, dtype)
    if sizes is not None:
        _check_each("leaf_diameter", sizes, classes, "classes")
        sizes = jnp.atleast_1d(sizes)
    scene = VoxelScene(
        density,
        OpticalClasses(
            rho,
            tau,
            tuple(leaf_angle(a) if isinstance(a, str) else a for a in distinct),
            tuple(owner * classes if single else owner),
            sizes,
            tuple(range(classes)) if sizes is not None and len(sizes) > 1 else None,
        ),
        as_floats("ground", ground, dtype),
        Illumination(
            as_floats("sun_zenith", sun_zenith, dtype),
            as_floats("sun_azimuth", sun_azimuth, dtype),
            _per_band("sun", sun, bands, dtype),
            _per_band("sky", sky, bands, dtype),
            None if sky_pattern is None else as_floats("sky_pattern", sky_pattern, dtype),
        ),
        voxel[0],
        voxel[2],
        boundary,
        ground_shape,
        None if terrain is None else as_floats("terrain", terrain, dtype),
    )
    check_scene(scene)
    return scene


def _leaf_angles(given: Any) -> list[str | AbstractLeafAngle]:
    """One distribution for all classes, or each class's."""
    single = isinstance(given, str | AbstractLeafAngle) or not isinstance(given, Iterable)
    several = [given] if single else list(given)
    if not all(isinstance(angle, str | AbstractLeafAngle) for angle in several):
        raise InputError(
            "`leaf_angles` must be a name or a distribution (see `fynjax.canopy.leaf_angle`), or a "
            f"list of one for each class, but is {short(given)}"
        )
    return several


def _check_each(name: str, array: Array, count: int, what: str) -> None:
    if array.shape not in {(), (1,), (count,)}:
        raise InputError(
            f"`{name}` must be one value or one value for each of the {count} {what}, but has "
            f"shape {array.shape}"
        )


def _per_band(name: str, value: Any, bands: int, dtype: Any) -> Float[Array, " band"]:
    array = as_floats(name, value, dtype)
    _check_each(name, array, bands, "bands")
    return jnp.broadcast_to(array, (bands,))

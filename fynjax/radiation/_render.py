"""The public entry point of the radiation layer."""

from __future__ import annotations  # so that `help` shows ArrayLike by its name

import contextlib
import dataclasses
import math
from numbers import Real
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float

from fynjax._core.errors import InputError
from fynjax._core.programs import concrete
from fynjax.radiation._check import (
    as_floats,
    check_light_memory,
    check_scene,
    check_view,
    check_whole,
    short,
)
from fynjax.radiation._image import Radiance, Sight, render_rays, sight_of_rays
from fynjax.radiation._multiple import Cells, DiffuseField, cells_of, solve_diffuse
from fynjax.radiation._ordinates import Ordinates, sky_radiance
from fynjax.radiation._rays import AbstractRays, parallel_rays
from fynjax.radiation._reduced import ReducedField, check_reducible, solve_reduced
from fynjax.radiation._refine import solve_refined
from fynjax.radiation._scene import VoxelScene
from fynjax.radiation._sun import SunField, trace_sun
from fynjax.radiation._terrain import with_adjacent_ground


class Accuracy(eqx.Module):
    """How finely the light is resolved. All fields are static; each may be refined alone."""

    lattice: int | None = eqx.field(static=True, default=None)
    """Sunbeams along the edge of a voxel. By default 2, and 1 where voxels are 5 cm or less."""
    sublayers: int | None = eqx.field(static=True, default=None)
    """Pieces a layer is cut in along beams and rays. By default so many that a beam or ray stays
    within a voxel; two where its direction is a traced value."""
    coarsening: tuple[int, int] | None = eqx.field(static=True, default=None)
    """Voxels (in height, in width) in such a cell, in place of `cell`; the second must divide the
    grid."""
    levels: int = eqx.field(static=True, default=3)
    """Zenith angles of the diffuse light per hemisphere."""
    azimuths: int = eqx.field(static=True, default=6)
    """Azimuths of the diffuse light."""
    tolerance: float = eqx.field(static=True, default=1e-4)
    """Residual of the diffuse solve, relative to its right-hand side."""
    iterations: int = eqx.field(static=True, default=100)
    """Most iterations of the diffuse solve."""
    refine: bool = eqx.field(static=True, default=True)
    """Follow the last flight of the diffuse light on finer cells: mostly half as wide."""
    solves: int | None = eqx.field(static=True, default=25)
    """Most bands that are solved for. The light of more is reduced to that of so many (and not
    refined). None: solve every band."""
    margin: int | None = eqx.field(static=True, default=None)
    """Voxels by which the sunbeams' lattice exceeds an open scene. By default from the sun's
    zenith; must be given where the sun is a traced value."""
    cell: float = eqx.field(static=True, default=0.2)
    """Edge of the cells of the coarse grid, on which the diffuse light is solved for [m]; two
    voxels at least, where they fit. Finer voxels do not buy finer diffuse light."""

    def __check_init__(self) -> None:
        for name in ("levels", "azimuths", "iterations"):
            check_whole(f"accuracy.{name}", getattr(self, name))
        for name, least in (("lattice", 1), ("sublayers", 1), ("solves", 1), ("margin", 0)):
            if getattr(self, name) is not None:
                check_whole(f"accuracy.{name}", getattr(self, name), least)
        if self.coarsening is not None:
            if not isinstance(self.coarsening, tuple) or len(self.coarsening) != 2:
                raise InputError(
                    "`accuracy.coarsening` must be a tuple of two whole numbers, in height and in "
                    f"width, but is {short(self.coarsening)}"
                )
            for factor in self.coarsening:
                check_whole("accuracy.coarsening", factor)
        if not (isinstance(self.cell, Real) and 0 < self.cell < math.inf):
            raise InputError(
                f"`accuracy.cell` must be a positive length [m], but is {short(self.cell)}"
            )
        if not (isinstance(self.tolerance, Real) and 0 < self.tolerance < 1):
            raise InputError(
                "`accuracy.tolerance` must be a number in (0, 1), a share of the source, but is "
                f"{short(self.tolerance)}"
            )
        if not isinstance(self.refine, bool):
            raise InputError(f"`accuracy.refine` must be True or False, but is {self.refine!r}")

    @property
    def ordinates(self) -> Ordinates:
        """Directions of the diffuse light."""
        return Ordinates.create(self.levels, self.azimuths)


class Light(eqx.Module):
    """The light in a scene: solved once, rendered for any number of sensors."""

    scene: VoxelScene
    """The scene, with empty layers on top if the coarse grid needed any, and on terrain with what
    ground sends to ground in its reflectance."""
    sun: SunField
    diffuse: DiffuseField | ReducedField
    accuracy: Accuracy

    @property
    def residual(self) -> Float[Array, " band"]:
        """What the equation of the diffuse light leaves over in each band, relative to its
        source [-]: an estimate of the relative error of what was scattered more than once."""
        return self.diffuse.residual


def solve_light(scene: VoxelScene, accuracy: Accuracy | None = None) -> Light:
    """Solve for the light in a scene: direct sun on voxels, diffuse light by discrete ordinates.

    **Arguments:**

    - `scene`: the canopy, its optics, its ground and its illumination.
    - `accuracy`: how finely; the defaults suit voxels of 10 cm.

    **Returns:** the `Light`, from which `render`, `directional_reflectance`, `fluxes` and
    `absorption` take what they need.

    **Raises:** `InputError` for shapes that do not go together and, outside `jit`, for values out
    of range.

    Differentiable once, in forward and reverse mode, in every array of `scene`; the derivative of
    the diffuse field is one solve with the transposed operator. A second derivative
    (`jax.hessian`) would miss terms: take Gauss-Newton steps, or differences of the gradient.

    >>> import jax.numpy as jnp
    >>> from fynjax.radiation import solve_light, voxel_scene
    >>> scene = voxel_scene(
    ...     area_density=jnp.full((1, 2, 4, 4), 2.0),
    ...     reflectance=jnp.array([[0.05, 0.45]]),
    ...     transmittance=jnp.array([[0.03, 0.45]]),
    ...     voxel=(0.25, 0.25, 0.25),
    ...     ground=jnp.array([0.2, 0.3]),
    ...     sun_zenith=30.0,
    ... )
    >>> light = solve_light(scene)
    >>> bool((light.residual < 0.05).all())
    True
    """
    accuracy = Accuracy() if accuracy is None else accuracy
    check_scene(scene)
    if scene.terrain is not None and scene.ground_shape is not None:
        raise InputError(
            "`terrain` and `ground_shape` do not go together yet: ground of a shape of its own "
            "must be level"
        )
    _check_sky(scene, accuracy)
    fit = check_fit(scene, accuracy)
    scene = in_whole_cells(scene, fit.factor)
    if scene.terrain is not None:
        ordinates = accuracy.ordinates
        down, flux = ordinates.vectors[: len(ordinates.vectors) // 2], ordinates.fluxes.ravel()
        ground = with_adjacent_ground(scene, down, flux)
        scene = eqx.tree_at(lambda s: s.ground, scene, ground)
    sun = follow_sun(scene, accuracy, sun_margin(scene, accuracy))
    diffuse = diffuse_light(scene, cells_of(scene, sun, fit.finest), fit, accuracy)
    return Light(scene, sun, diffuse, accuracy)


def in_whole_cells(scene: VoxelScene, factor: tuple[int, int]) -> VoxelScene:
    """The scene with empty layers on top, so that cells of `factor` voxels fill its height."""
    missing = -scene.shape[0] % factor[0]
    if not missing:
        return scene
    above = [(0, missing), (0, 0), (0, 0)]
    fine = scene.structure
    if fine is not None:
        fine = jnp.pad(fine, [(0, missing * scene.structure_factor[0]), *above[1:]])
    density = jnp.pad(scene.area_density, [(0, 0), *above])
    return dataclasses.replace(scene, area_density=density, structure=fine)


def follow_sun(scene: VoxelScene, accuracy: Accuracy, margin: int) -> SunField:
    """`trace_sun` as finely as asked for."""
    sublayers = accuracy.sublayers or pieces(scene.illumination.sun_zenith, aspect(scene))
    lattice = accuracy.lattice or (
        1 if scene.horizontal / scene.structure_factor[1] <= _FINE else 2
    )
    return trace_sun(scene, lattice, sublayers, margin)


def diffuse_light(
    scene: VoxelScene, cells: Cells, fit: Fit, accuracy: Accuracy
) -> DiffuseField | ReducedField:
    """The diffuse light from the finest cells of `fit`. Of `scene` all but the voxels counts."""
    how = (fit.factor, accuracy.ordinates, accuracy.tolerance, accuracy.iterations)
    if fit.reduced:
        check_reducible(scene)
        return solve_reduced(scene, cells, *how, solves=accuracy.solves or 0)
    if fit.finer is not None:
        return solve_refined(scene, cells, fit.finer, *how)
    return solve_diffuse(scene, cells, *how)


def _check_sky(scene: VoxelScene, accuracy: Accuracy) -> None:
    """Raise `InputError` where the sky is bright only between the directions of the light."""
    light = scene.illumination
    if light.sky_pattern is None or not concrete(light):
        return
    with jax.ensure_compile_time_eval():
        radiance = np.asarray(sky_radiance(light, accuracy.ordinates))
    if np.any((np.asarray(light.sky) > 0) & ~(radiance > 0).any(axis=1)):
        raise InputError(
            "`illumination.sky_pattern` must be bright where the diffuse light comes from, but is "
            f"zero in all directions of {accuracy.levels} zeniths and {accuracy.azimuths} "
            "azimuths: raise `accuracy.levels` and `accuracy.azimuths`, or count so narrow a light "
            "as the sun's"
        )


_FINE = 0.05
"""Edge of a voxel whose sunbeams need not be closer than the voxels [m]."""


def check_light(
    scene: VoxelScene, accuracy: Accuracy | None = None, held: float = math.inf
) -> None:
    """Raise `InputError` where the light of a scene would not fit in the memory of this machine.

    **Arguments:**

    - `scene`: of which the shapes count; from `jax.eval_shape` it costs nothing.
    - `accuracy`: as for `solve_light`, which checks the same before it begins.
    - `held`: voxels that are in memory at once, of a scene that is made window by window.

    **Raises:** `InputError`, with what would fit.
    """
    check_fit(scene, Accuracy() if accuracy is None else accuracy, held)


class Fit(NamedTuple):
    """The grids of the diffuse light of a scene."""

    factor: tuple[int, int]
    """Voxels in a cell of the coarse grid, in height and in width."""
    reduced: bool
    """Whether bands are reduced to few solves."""
    finer: tuple[int, int] | None
    """Voxels in a cell on which the light is refined; None: nowhere."""

    @property
    def finest(self) -> tuple[int, int]:
        """Voxels in a cell of the finest of these grids."""
        return self.finer or self.factor


def fit_grids(scene: VoxelScene, accuracy: Accuracy) -> Fit:
    """Grids that suit a scene. Raises `InputError` where its grid cannot be coarsened so."""
    factor = _coarsening(scene, accuracy)
    reduced = accuracy.solves is not None and scene.illumination.sun.shape[0] > accuracy.solves
    finer = None
    if accuracy.refine and factor != (1, 1) and not reduced:
        finer = factor[0] // _least_divisor(factor[0]), factor[1] // _least_divisor(factor[1])
    return Fit(factor, reduced, finer)


def check_fit(scene: VoxelScene, accuracy: Accuracy, held: float = math.inf) -> Fit:
    """`fit_grids` of a scene of which `held` voxels at most are in memory at once.

    Raises `InputError` where its light does not fit in memory, too.
    """
    fit = fit_grids(scene, accuracy)
    check_light_memory(scene, len(accuracy.ordinates.weights), fit.factor, fit.finer, held)
    return fit


def _least_divisor(number: int) -> int:
    """The least divisor above 1; of 1 itself, 1."""
    return next((n for n in range(2, number + 1) if number % n == 0), 1)


def _coarsening(scene: VoxelScene, accuracy: Accuracy) -> tuple[int, int]:
    _, ny, nx = scene.shape
    if accuracy.coarsening is None:
        high, wide = (
            max(2, 2 * round(accuracy.cell / (2 * size) + 1e-6))
            for size in (scene.vertical, scene.horizontal)
        )
        # A low canopy keeps its profile.
        high = min(high, max(2, 2 * round(scene.shape[0] / 16)))
        # Layers are added on top as they are needed; columns must fit.
        fitting = [n for n in range(1, wide + 1) if ny % n == nx % n == 0]
        even = [n for n in fitting if n % 2 == 0]
        return high, max(even or fitting)
    for size, axis in ((ny, "y"), (nx, "x")):
        if size % accuracy.coarsening[1]:
            raise InputError(
                "`accuracy.coarsening` must divide the grid, but "
                f"{accuracy.coarsening[1]} does not divide the {size} voxels along {axis}; pad "
                "the scene or choose another factor"
            )
    return accuracy.coarsening


def aspect(scene: VoxelScene) -> float:
    """Height over width of the finest voxels."""
    high, wide = scene.structure_factor
    return scene.vertical / high / (scene.horizontal / wide)


def pieces(zenith: Array | float, aspect: float) -> int:
    """Pieces of a layer in each of which a ray moves sideways by no more than a voxel."""
    if isinstance(zenith, jax.core.Tracer):
        return 2
    return max(1, min(8, math.ceil(_lean(zenith, aspect) - 1e-6)))


def _lean(zenith: Array | float, aspect: float) -> float:
    """Voxels that the most slanted ray crosses sideways in a layer."""
    steepest = float(np.max(np.asarray(zenith), initial=0.0))
    return aspect * math.tan(math.radians(min(steepest, 89.0)))


def sun_margin(scene: VoxelScene, accuracy: Accuracy) -> int:
    """Voxels by which the lattice of the sun's beams exceeds an open scene."""
    if scene.boundary == "periodic":
        return 0
    if accuracy.margin is not None:
        return accuracy.margin
    zenith = scene.illumination.sun_zenith
    if isinstance(zenith, jax.core.Tracer):
        raise InputError(
            "`accuracy.margin` must be given for an open scene whose sun is a traced value: the "
            "height of the grid times tan(largest sun zenith), in voxels"
        )
    return math.ceil(scene.height * math.tan(math.radians(float(zenith))) / scene.horizontal)


def render(light: Light, rays: AbstractRays, *, chunk: int = 8) -> Radiance:
    """Radiance along each ray of a sensor, per band [irradiance unit sr-1].

    **Arguments:**

    - `light`: from `solve_light`.
    - `rays`: `parallel_rays`, `nadir_rays` or `perspective_rays`.
    - `chunk`: bands rendered at once where they were reduced to few solves; bounds the memory.

    **Returns:** `Radiance`, with its parts. Multiple scattering is taken towards the middle of the
    field of view and scaled by the leaf area within each pixel; direct sun, scattered once, is
    taken towards each pixel.

    **Raises:** `InputError` for a sensor inside the canopy, or a `chunk` that is no number of
    bands.

    Differentiable in every array of the scene and of the rays.

    >>> import jax.numpy as jnp
    >>> from fynjax.radiation import nadir_rays, render, solve_light, voxel_scene
    >>> scene = voxel_scene(
    ...     area_density=jnp.full((1, 2, 4, 4), 2.0),
    ...     reflectance=jnp.array([[0.05, 0.45]]),
    ...     transmittance=jnp.array([[0.03, 0.45]]),
    ...     voxel=(0.25, 0.25, 0.25),
    ...     ground=jnp.array([0.2, 0.3]),
    ...     sun_zenith=30.0,
    ... )
    >>> centres = (jnp.arange(8) + 0.5) * 0.125
    >>> rays = nadir_rays(centres, centres, footprint=0.125, camera=(0.5, 0.5, 30.0))
    >>> radiance = render(solve_light(scene), rays)
    >>> radiance.total.shape, round(float(radiance.gap.mean()), 2)  # exp(-G LAI) = exp(-0.5)
    ((2, 8, 8), 0.61)
    """
    return render_up_to(light, rays, _steepest(rays), chunk)


def _steepest(rays: AbstractRays) -> Array:
    # Rays that are known stay so inside `jit`, lest all layers be cut as for slanted ones.
    with jax.ensure_compile_time_eval() if concrete(rays) else contextlib.nullcontext():
        return jnp.rad2deg(jnp.arccos(jnp.min(rays.cosine)))


def render_up_to(
    light: Light, rays: AbstractRays, steepest: Array | float, chunk: int = 8, together: int = 1
) -> Radiance:
    """`render` for rays whose zenith angle is `steepest` at most [degrees]; means of blocks of
    `together` x `together` rays."""
    check_whole("chunk", chunk)
    sublayers, lean = _pieces_along(light.scene, light.accuracy, rays, steepest)
    field = light.scene, light.sun, light.diffuse
    return render_rays(*field, rays, light.accuracy.ordinates, sublayers, lean, chunk, together)


def _pieces_along(
    scene: VoxelScene, accuracy: Accuracy, rays: AbstractRays, steepest: Array | float
) -> tuple[int, float]:
    """Pieces of a layer that rays above the grid are followed in, and how many voxels they cross
    sideways in a layer at most."""
    if rays.sensor_height < scene.height:
        raise InputError(
            f"the sensor must stand above the grid, which is {scene.height:g} m high, but "
            f"is at {rays.sensor_height:g} m: rays begin above the canopy"
        )
    across = aspect(scene)
    sublayers = accuracy.sublayers or pieces(steepest, across)
    known = not isinstance(steepest, jax.core.Tracer)
    return sublayers, _lean(steepest, across) if known else float(sublayers)


def first_met(
    scene: VoxelScene,
    rays: AbstractRays,
    accuracy: Accuracy | None = None,
    *,
    steepest: float | None = None,
    together: int = 1,
) -> Sight:
    """What each ray of a sensor meets first: a class of the canopy, ground in the sun or in shade.

    **Arguments:**

    - `scene`: the canopy, its ground and its sun; no optics count.
    - `rays`, `steepest`, `together`: as for `reflectance_factor`.
    - `accuracy`: how finely the sun is followed; the defaults suit voxels of 10 cm.

    **Returns:** `Sight`, shares that sum to one along each ray: by Beer's law along the ray, in the
    voxels and slabs that the image is made of.

    **Raises:** `InputError` as `solve_light` and `render`.

    Differentiable in every array of the scene and of the rays.

    >>> import jax.numpy as jnp
    >>> from fynjax.radiation import first_met, nadir_rays, voxel_scene
    >>> scene = voxel_scene(
    ...     area_density=jnp.stack([jnp.full((2, 4, 4), 2.0), jnp.full((2, 4, 4), 1.0)]),
    ...     reflectance=jnp.array([[0.05], [0.3]]),
    ...     transmittance=jnp.array([[0.03], [0.0]]),
    ...     voxel=(0.25, 0.25, 0.25),
    ...     ground=jnp.array([0.2]),
    ...     sun_zenith=30.0,
    ... )
    >>> centres = (jnp.arange(8) + 0.5) * 0.125
    >>> sight = first_met(scene, nadir_rays(centres, centres, 0.125, camera=(0.5, 0.5, 30.0)))
    >>> ground = sight.sunlit_ground + sight.shaded_ground
    >>> sight.canopy.mean(axis=(1, 2)).round(2), round(float(ground.mean()), 2)  # exp(-0.75)
    (Array([0.35, 0.18], dtype=float32), 0.47)
    """
    accuracy = Accuracy() if accuracy is None else accuracy
    check_scene(scene)
    _check_blocks(rays, together)
    most = _steepest(rays) if steepest is None else steepest
    sun = follow_sun(scene, accuracy, sun_margin(scene, accuracy))
    return look_up_to(scene, sun, accuracy, rays, most, together)


def look_up_to(
    scene: VoxelScene,
    sun: SunField,
    accuracy: Accuracy,
    rays: AbstractRays,
    steepest: Array | float,
    together: int = 1,
) -> Sight:
    """`first_met` in a known sun, for rays whose zenith angle is `steepest` at most [degrees]."""
    sublayers, lean = _pieces_along(scene, accuracy, rays, steepest)
    return sight_of_rays(scene, sun, rays, sublayers, lean, together)


def _check_blocks(rays: AbstractRays, together: int) -> None:
    check_whole("together", together)
    if any(size % together for size in rays.shape):
        raise InputError(
            f"`together` must divide the rows and columns of rays, but {together} does not divide "
            f"{rays.shape[0]} x {rays.shape[1]}"
        )


def reflectance_factor(
    light: Light,
    rays: AbstractRays,
    *,
    chunk: int = 8,
    steepest: float | None = None,
    together: int = 1,
) -> Float[Array, "band row column"]:
    """Reflectance factor along each ray [-]: pi times radiance over the incident irradiance.

    **Arguments:** `light`, `rays`, `chunk`, errors and derivatives as for `render`.

    - `steepest`: zenith angle that no ray exceeds [degrees], for rays that are traced values; left
      out, layers are then cut as for rays that cross a voxel in each.
    - `together`: rays along an edge of the blocks whose means are returned; must divide rows and
      columns. Of many bands (`Accuracy.solves`) a block costs little more than a ray.

    It is what an image holds after calibration with a panel.

    >>> import jax.numpy as jnp
    >>> from fynjax.radiation import nadir_rays, reflectance_factor, solve_light, voxel_scene
    >>> scene = voxel_scene(
    ...     area_density=jnp.full((1, 2, 4, 4), 2.0),
    ...     reflectance=jnp.array([[0.05, 0.45]]),
    ...     transmittance=jnp.array([[0.03, 0.45]]),
    ...     voxel=(0.25, 0.25, 0.25),
    ...     ground=jnp.array([0.2, 0.3]),
    ...     sun_zenith=30.0,
    ... )
    >>> centres = (jnp.arange(8) + 0.5) * 0.125
    >>> rays = nadir_rays(centres, centres, footprint=0.125, camera=(0.5, 0.5, 30.0))
    >>> image = reflectance_factor(solve_light(scene), rays)
    >>> image.mean(axis=(1, 2)).round(2)  # red, near infrared
    Array([0.08, 0.33], dtype=float32)
    """
    incident = light.scene.illumination.incident[:, None, None]
    _check_blocks(rays, together)
    most = _steepest(rays) if steepest is None else steepest
    radiance = render_up_to(light, rays, most, chunk, together)
    return jnp.pi * radiance.total / incident


def directional_reflectance(
    light: Light, view_zenith: Float[ArrayLike, "*#view"], view_azimuth: Float[ArrayLike, "*#view"]
) -> Float[Array, "view band"]:
    """Mean reflectance factor of the whole scene for distant views [-].

    **Arguments:**

    - `light`: from `solve_light`.
    - `view_zenith`: zenith angles of the views [degrees], in [0, 90).
    - `view_azimuth`: their azimuths, clockwise from north [degrees]. One of the two may be a single
      number for all views.

    **Returns:** one value a view and band. With no sky light this is the bidirectional reflectance
    factor (BRF), else the hemispherical-directional one (HDRF).

    **Raises:** `InputError` for views that do not pair and, outside a transformation, for views
    that do not look down.

    Differentiable in the views and in every array of the scene.

    >>> import jax.numpy as jnp
    >>> from fynjax.radiation import directional_reflectance, solve_light, voxel_scene
    >>> scene = voxel_scene(
    ...     area_density=jnp.full((1, 2, 4, 4), 2.0),
    ...     reflectance=jnp.array([[0.05, 0.45]]),
    ...     transmittance=jnp.array([[0.03, 0.45]]),
    ...     voxel=(0.25, 0.25, 0.25),
    ...     ground=jnp.array([0.2, 0.3]),
    ...     sun_zenith=30.0,
    ... )
    >>> directional_reflectance(solve_light(scene), jnp.array([0.0, 45.0]), 180.0).round(2)
    Array([[0.08, 0.33],
           [0.07, 0.37]], dtype=float32)
    """
    zenith, azimuth = _views(view_zenith, view_azimuth, light.scene.area_density.dtype)
    scene, lattice = light.scene, light.sun.per_voxel
    width = scene.horizontal / lattice
    _, ny, nx = scene.shape
    dtype = scene.area_density.dtype
    x = ((jnp.arange(nx * lattice) + 0.5) * width).astype(dtype)
    y = ((jnp.arange(ny * lattice) + 0.5) * width).astype(dtype)
    incident = scene.illumination.incident

    def mean_reflectance(angles: tuple[Array, Array]) -> Array:
        rays = parallel_rays(x, y, width, *angles)
        radiance = render_up_to(light, rays, zenith)
        return jnp.pi * radiance.total.mean(axis=(1, 2)) / incident

    return jax.lax.map(mean_reflectance, (zenith, azimuth))


def _views(
    zenith: Any, azimuth: Any, dtype: Any
) -> tuple[Float[Array, " view"], Float[Array, " view"]]:
    zenith = as_floats("view_zenith", zenith, dtype)
    azimuth = as_floats("view_azimuth", azimuth, dtype)
    shapes = zenith.shape, azimuth.shape
    if max(map(len, shapes)) > 1 or len(set(shapes) - {()}) > 1:
        raise InputError(
            "`view_zenith` and `view_azimuth` must be lists of equal length, or single numbers, "
            f"but have shapes {shapes[0]} and {shapes[1]}: they are pairs, not the axes of a grid"
        )
    check_view(zenith, azimuth)
    zenith, azimuth = jnp.broadcast_arrays(jnp.atleast_1d(zenith), jnp.atleast_1d(azimuth))
    return zenith, azimuth

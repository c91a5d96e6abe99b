"""What a scene must be to be rendered, said before it is tried."""

import math
import os

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from fynjax._core.errors import InputError
from fynjax.radiation._scene import VoxelScene


def check_scene(scene: VoxelScene) -> None:
    """Raise `InputError` for what cannot be rendered: shapes always, values where known."""
    density, classes, sun = scene.area_density, scene.classes, scene.illumination
    if density.ndim != 4 or 0 in density.shape:
        raise InputError(
            "`area_density` must have the axes [class, z, y, x], none of them empty, but has "
            f"shape {density.shape}"
        )
    n_class, n_band = density.shape[0], classes.reflectance.shape[-1]
    for name in ("reflectance", "transmittance"):
        shape = getattr(classes, name).shape
        if shape != (n_class, n_band):
            raise InputError(
                f"`classes.{name}` must have shape (class, band) = {(n_class, n_band)} to go with "
                f"`area_density`, but has {shape}"
            )
    if len(classes.angle_of_class) != n_class:
        raise InputError(
            f"`classes.angle_of_class` must name a distribution for each of the {n_class} classes, "
            f"but has {len(classes.angle_of_class)} entries"
        )
    if max(classes.angle_of_class) >= len(classes.angles):
        raise InputError("`classes.angle_of_class` points beyond the end of `classes.angles`")
    if scene.ground.shape not in {(n_band,), (n_band, *density.shape[2:])}:
        raise InputError(
            f"`ground` must have shape (band,) or (band, y, x) = {(n_band, *density.shape[2:])}, "
            f"but has {scene.ground.shape}"
        )
    if sun.sun.shape != (n_band,) or sun.sky.shape != (n_band,):
        raise InputError(
            f"`illumination.sun` and `illumination.sky` must have one value for each of the "
            f"{n_band} bands, but have shapes {sun.sun.shape} and {sun.sky.shape}"
        )
    _check_options(scene, n_band)
    if scene.boundary not in {"periodic", "open"}:
        raise InputError(f"`boundary` must be 'periodic' or 'open', but is {scene.boundary!r}")
    for name in ("horizontal", "vertical"):
        if not getattr(scene, name) > 0:
            raise InputError(
                f"`{name}` must be a positive length in m, but is {getattr(scene, name)}"
            )
    if any(isinstance(leaf, jax.core.Tracer) for leaf in jax.tree.leaves(scene)):
        return
    _check_range("area_density [m2 m-3]", density, 0.0, math.inf)
    _check_range("ground", scene.ground, 0.0, 1.0)
    for name in ("reflectance", "transmittance"):
        _check_range(f"classes.{name}", getattr(classes, name), 0.0, 1.0)
    for name in ("sun", "sky"):
        _check_range(f"illumination.{name}", getattr(sun, name), 0.0, math.inf)
    if not np.all(np.asarray(sun.sun) + np.asarray(sun.sky) > 0):
        raise InputError("`illumination` must have light, of sun or sky, in every band")
    if classes.leaf_diameter is not None:
        _check_range("classes.leaf_diameter [m]", classes.leaf_diameter, 0.0, 10.0)
    if scene.terrain is not None:
        _check_range(
            "terrain [m]",
            scene.terrain,
            0.0,
            scene.height,
            ": heights count from the bottom of the grid, are they above sea level?",
        )
    if sun.sky_pattern is not None:
        _check_range("illumination.sky_pattern", sun.sky_pattern, 0.0, math.inf)
    total = float(jnp.max(classes.reflectance + classes.transmittance))
    if total > 1 + 1e-5:
        raise InputError(
            f"reflectance + transmittance of a class must not exceed 1, but reaches {total:.4g}: "
            "are they in percent, or was absorptance passed?"
        )
    zenith = float(sun.sun_zenith)
    if not 0 <= zenith < 89.5:
        raise InputError(
            f"`sun_zenith` must be in [0, 89.5) degrees, but is {zenith:g}: the sun is at or below "
            "the horizon, or an elevation was passed"
        )


def _check_options(scene: VoxelScene, n_band: int) -> None:
    """Shapes of what a scene may have."""
    classes, pattern, terrain = scene.classes, scene.illumination.sky_pattern, scene.terrain
    if classes.leaf_diameter is not None:
        count = len(classes.angle_of_class)
        if classes.leaf_diameter.ndim != 1 or len(classes.sizes) != count:
            raise InputError(
                "`classes.leaf_diameter` must be a list of diameters and `classes.size_of_class` "
                f"name one for each of the {count} classes, but they have shape "
                f"{classes.leaf_diameter.shape} and {len(classes.sizes)} entries"
            )
        if max(classes.sizes) >= len(classes.leaf_diameter):
            raise InputError("`classes.size_of_class` points beyond the end of `leaf_diameter`")
    if pattern is not None:
        short = pattern.ndim not in (2, 3) or pattern.shape[-2] < 2
        if short or (pattern.ndim == 3 and pattern.shape[0] != n_band):
            raise InputError(
                "`illumination.sky_pattern` must have the axes [zenith, azimuth] or [band, zenith, "
                f"azimuth], with two zeniths or more, but has shape {pattern.shape}"
            )
    if scene.ground_shape is not None:
        for name, value in vars(scene.ground_shape).items():
            if value.shape != (n_band,):
                raise InputError(
                    f"`ground_shape.{name}` must have one value for each of the {n_band} bands, "
                    f"but has shape {value.shape}"
                )
    if terrain is not None and terrain.shape != scene.shape[1:]:
        raise InputError(
            f"`terrain` must have one height for each voxel column, {scene.shape[1:]}, but has "
            f"shape {terrain.shape}"
        )


def _check_range(
    name: str, values: Float[Array, "*any"], low: float, high: float, slip: str = ""
) -> None:
    array = np.asarray(values)
    bad = ~(np.isfinite(array) & (array >= low) & (array <= high))
    if bad.any():
        first = tuple(int(i) for i in np.argwhere(bad)[0])
        raise InputError(
            f"`{name}` must be finite and in [{low:g}, {high:g}], but {int(bad.sum())} values are "
            f"not; the first is {array[first]} at index {first}{slip}"
        )


def check_memory(scene: VoxelScene, ordinates: int, factor: tuple[int, int], refine: bool) -> None:
    """Raise `InputError` where the diffuse light would not fit in the memory of this machine.

    Counts what grows with the grid: the scene, the radiance along each ordinate in each band, and
    the directions that the solver keeps.
    """
    available = _memory()
    if available is None:
        return
    voxels = math.prod(scene.shape)
    cells = voxels // (factor[0] * factor[1] ** 2)
    bands, size = scene.illumination.sun.shape[0], scene.area_density.dtype.itemsize
    field = ordinates * size
    needed = 3 * scene.area_density.size * size + _COARSE_FIELDS * field * cells
    needed += (bands + _FINE_FIELDS) * field * voxels if refine else bands * field * cells
    if needed > available:
        side = math.sqrt(available / needed) * min(scene.shape[1:])
        raise InputError(
            f"a grid of {' x '.join(map(str, scene.shape))} voxels in {bands} bands needs about "
            f"{needed / 2**30:.1f} GiB, but this machine has {available / 2**30:.1f}: render it in "
            f"tiles (`render_tiles`), of at most {int(side)} voxels a side, or take larger voxels"
        )


_COARSE_FIELDS, _FINE_FIELDS = 18, 8
"""Fields of one band that the solver, and the refinement, hold at once."""


def _memory() -> int | None:
    """Bytes of memory of the device, or of the machine where that is the device."""
    stats = jax.devices()[0].memory_stats() or {}
    if "bytes_limit" in stats:
        return int(stats["bytes_limit"])
    try:
        return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    except (AttributeError, ValueError, OSError):
        return None

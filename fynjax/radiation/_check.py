"""Checks of scenes and views before they are rendered."""

import math
import os
from collections.abc import Callable
from numbers import Integral
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from fynjax._core.errors import InputError
from fynjax.radiation._blocks import block_mean
from fynjax.radiation._ground import RahmanPintyVerstraete
from fynjax.radiation._scene import VoxelScene


def concrete(*values: Any) -> bool:
    """Whether all values are known, that is outside a transformation."""
    return not any(isinstance(leaf, jax.core.Tracer) for leaf in jax.tree.leaves(values))


def as_floats(name: str, value: Any, dtype: Any = None) -> Float[Array, "*any"]:
    """`value` as a floating array: of `dtype`, or of its own type where that is floating.

    What is known stays known, also under `jit`.
    """
    if not concrete(value):
        return _floating(name, jnp.asarray(value), dtype)
    try:
        array = value if isinstance(value, jax.Array) else np.asarray(value)
    except ValueError as error:
        raise InputError(
            f"`{name}` must be numbers in rows of equal length, but is {short(value)}"
        ) from error
    with jax.ensure_compile_time_eval():
        return _floating(name, array, dtype)


def _floating(name: str, array: Any, dtype: Any) -> Float[Array, "*any"]:
    if array.dtype != bool and not jnp.issubdtype(array.dtype, jnp.number):
        raise InputError(
            f"`{name}` must be a number or an array of numbers, but is {short(array.tolist())}: is "
            "it text, or missing?"
        )
    if jnp.issubdtype(array.dtype, jnp.complexfloating):
        raise InputError(f"`{name}` must be real numbers, but is of type {array.dtype}")
    array = jnp.asarray(array)
    if dtype is None and jnp.issubdtype(array.dtype, jnp.floating):
        return array
    return array.astype(float if dtype is None else dtype)


def short(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 60 else f"{text[:57]}..."


def check_whole(name: str, value: Any, least: int = 1) -> None:
    """Raise `InputError` unless `value` is a whole number of at least `least`."""
    if not isinstance(value, Integral) or isinstance(value, bool) or value < least:
        raise InputError(
            f"`{name}` must be a whole number of at least {least}, but is {short(value)}"
        )


def check_length(name: str, value: Any) -> None:
    """Raise `InputError` unless `value` is one positive length, where it is known."""
    array = check_shape(name, value, ())
    if concrete(array) and not 0 < float(array) < math.inf:
        raise InputError(f"`{name}` must be a positive length in m, but is {float(array):g}")


def check_shape(
    name: str, value: Any, shape: tuple[int, ...], slip: str = ""
) -> Float[Array, "*any"]:
    """`value` as a floating array, with an `InputError` where it has another shape."""
    array = as_floats(name, value)
    if array.shape != shape:
        wanted = "a single number" if shape == () else f"{math.prod(shape)} numbers"
        raise InputError(f"`{name}` must be {wanted}, but has shape {array.shape}{slip}")
    return array


def check_range(
    name: str,
    values: Float[Array | np.ndarray, "*any"],
    low: float,
    high: float,
    slip: str = "",
    *,
    ends: str = "[]",
) -> None:
    """Raise `InputError` unless all values, where known, are finite and between the two ends,
    which are part of the range ("[" and "]") or not ("(" and ")")."""
    if not concrete(values):
        return
    array = np.asarray(values)
    above = array > low if ends[0] == "(" else array >= low
    below = array < high if ends[1] == ")" else array <= high
    bad = ~(np.isfinite(array) & above & below)
    if not bad.any():
        return
    wanted = f"`{name}` must be finite"
    if math.isfinite(low) or math.isfinite(high):
        wanted += f" and in {ends[0]}{low:g}, {high:g}{ends[1]}"
    if array.ndim == 0:
        raise InputError(f"{wanted}, but is {array:g}{slip}")
    first = tuple(int(i) for i in np.argwhere(bad)[0])
    raise InputError(
        f"{wanted}, but {int(bad.sum())} values are not; the first is {array[first]} at index "
        f"{first}{slip}"
    )


def check_view(zenith: Float[Array, "*view"], azimuth: Float[Array, "*view"]) -> None:
    """Raise `InputError` for views, where known, that do not look down on the scene."""
    slip = " degrees from the vertical: was an elevation or a signed angle passed?"
    check_range("view_zenith", zenith, 0.0, 90.0, slip, ends="[)")
    check_range("view_azimuth", azimuth, -math.inf, math.inf)


def check_pixels(x: Any, y: Any, footprint: Any) -> tuple[Array, Array, float]:
    """Centres of columns and rows as floating arrays of one type, and their footprint."""
    check_length("footprint", footprint)
    x, y = as_floats("x", x), as_floats("y", y)
    for name, centres in (("x", x), ("y", y)):
        if centres.ndim != 1 or centres.shape[0] == 0:
            raise InputError(
                f"`{name}` must be a list of the centres of pixels [m], one or more, but has shape "
                f"{centres.shape}: `x` has one for each column and `y` one for each row"
            )
        check_range(f"{name} [m]", centres, -math.inf, math.inf)
    dtype = jnp.result_type(x, y)
    known = float(footprint) if concrete(footprint) else footprint
    return x.astype(dtype), y.astype(dtype), known


def check_camera(camera: Any) -> tuple[Any, Any, Any]:
    """The three numbers that place a camera, as they came."""
    check_shape("camera", camera, (3,), ": it is (x, y, altitude) in m")
    cx, cy, altitude = camera
    check_range("camera [m]", as_floats("camera", (cx, cy)), -math.inf, math.inf)
    return cx, cy, altitude


def check_attitude(
    camera: Any, target: Any, field_of_view: Any
) -> tuple[Float[np.ndarray, " 3"], Float[np.ndarray, " 3"]]:
    """Place of a frame camera, and what lies from there to its target."""
    place = np.asarray(check_camera(camera), float)
    aim = np.asarray(check_shape("target", target, (3,), ": it is (x, y, z) in m"), float)
    if not 0 <= place[2] < math.inf:
        raise InputError(
            f"`camera` must be above the ground, but is at {place[2]:g} m: heights count from the "
            "bottom of the grid"
        )
    forward = aim - place
    if not (np.isfinite(forward).all() and np.linalg.norm(forward) > 0):
        raise InputError(f"`target` must be a point other than `camera`, {camera}, but is {target}")
    if not 0 < float(check_shape("field_of_view", field_of_view, ())) < 170:
        raise InputError(f"`field_of_view` must be in (0, 170) degrees, but is {field_of_view}")
    return place, forward


def check_scene(scene: VoxelScene) -> None:
    """Check a scene before it is rendered.

    **Arguments:**

    - `scene`: the canopy, its optics, its ground and its illumination.

    **Raises:** `InputError` for what cannot be rendered: shapes that do not go together, and values
    out of range where they are known, that is outside a transformation.
    """
    density, classes, sun = scene.area_density, scene.classes, scene.illumination
    if density.ndim != 4 or 0 in density.shape:
        raise InputError(
            "`area_density` must have the axes [class, z, y, x], none of them empty, but has "
            f"shape {density.shape}"
        )
    n_class, n_band = density.shape[0], (0, *classes.reflectance.shape)[-1]
    if n_band == 0:
        raise InputError(
            "`classes.reflectance` must have the axes [class, band], with one band or more, but "
            f"has shape {classes.reflectance.shape}"
        )
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
    for name in ("sun_zenith", "sun_azimuth"):
        check_shape(f"illumination.{name}", getattr(sun, name), (), ": a scene has one sun")
    _check_options(scene, n_band)
    if scene.boundary not in ("periodic", "open"):
        raise InputError(f"`boundary` must be 'periodic' or 'open', but is {scene.boundary!r}")
    for name in ("horizontal", "vertical"):
        check_length(name, getattr(scene, name))
    if concrete(scene):
        _check_values(scene)


def _check_values(scene: VoxelScene) -> None:
    """Values of a scene that is known."""
    density, classes, sun = scene.area_density, scene.classes, scene.illumination
    check_range("area_density [m2 m-3]", density, 0.0, math.inf)
    check_range("ground", scene.ground, 0.0, 1.0)
    for name in ("reflectance", "transmittance"):
        check_range(f"classes.{name}", getattr(classes, name), 0.0, 1.0)
    if scene.structure is not None:
        check_range("structure [m2 m-3]", scene.structure, 0.0, math.inf)
        mean = np.asarray(block_mean(scene.structure, scene.structure_factor))
        total = np.asarray(scene.area_density).sum(axis=0)
        if np.abs(mean - total).max() > 1e-3 * max(total.max(), 1e-3):
            raise InputError(
                "the mean of `structure` over a voxel must be the sum of `area_density` over the "
                f"classes, but they differ by up to {np.abs(mean - total).max():.3g} m2 m-3: was "
                "one of them changed alone?"
            )
    for name in ("sun", "sky"):
        check_range(f"illumination.{name}", getattr(sun, name), 0.0, math.inf)
    if not np.all(np.asarray(sun.sun) + np.asarray(sun.sky) > 0):
        raise InputError("`illumination` must have light, of sun or sky, in every band")
    if classes.leaf_diameter is not None:
        check_range("classes.leaf_diameter [m]", classes.leaf_diameter, 0.0, 10.0)
    if scene.terrain is not None:
        check_range(
            "terrain [m]",
            scene.terrain,
            0.0,
            scene.height,
            ": heights count from the bottom of the grid, are they above sea level?",
        )
    if sun.sky_pattern is not None:
        check_range("illumination.sky_pattern", sun.sky_pattern, 0.0, math.inf)
        dark = np.asarray(sun.sky_pattern).sum(axis=(-2, -1)) == 0
        if np.any(dark & (np.asarray(sun.sky) > 0)):
            raise InputError(
                "`illumination.sky_pattern` must be bright somewhere in every band that has light "
                "of the sky, but is zero everywhere: for no sky light set `sky` to zero"
            )
    if scene.ground_shape is not None:
        for name, low, high in (
            ("k", -math.inf, math.inf),
            ("theta", -1.0, 1.0),
            # Beyond 2 the reflectance is negative away from the hot spot.
            ("rho_c", -math.inf, 2.0),
        ):
            values = getattr(scene.ground_shape, name)
            check_range(f"ground_shape.{name}", values, low, high, ends="()")
    total = np.max(np.asarray(classes.reflectance) + np.asarray(classes.transmittance))
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
    check_range("sun_azimuth", sun.sun_azimuth, -math.inf, math.inf)


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
        few = pattern.ndim not in (2, 3) or pattern.shape[-2] < 2 or pattern.shape[-1] < 1
        if few or (pattern.ndim == 3 and pattern.shape[0] != n_band):
            raise InputError(
                "`illumination.sky_pattern` must have the axes [zenith, azimuth] or [band, zenith, "
                f"azimuth], with an azimuth and two zeniths or more, but has shape {pattern.shape}"
            )
    if scene.ground_shape is not None:
        if not isinstance(scene.ground_shape, RahmanPintyVerstraete):
            raise InputError(
                "`ground_shape` must be a `RahmanPintyVerstraete` or None, but is "
                f"{short(scene.ground_shape)}"
            )
        for name, value in vars(scene.ground_shape).items():
            if value.shape != (n_band,):
                raise InputError(
                    f"`ground_shape.{name}` must have one value for each of the {n_band} bands, "
                    f"but has shape {value.shape}"
                )
    if scene.structure is not None:
        fine = scene.structure.shape
        times = [n / m for n, m in zip(fine, scene.shape)] if len(fine) == 3 else [0.5]
        if any(n < 1 or n != int(n) for n in times) or times[1] != times[2]:
            raise InputError(
                "`structure` must have a whole number of finer voxels to each of the grid's "
                f"{scene.shape}, as many along y as along x, but has shape {fine}"
            )
    if terrain is not None and terrain.shape != scene.shape[1:]:
        raise InputError(
            f"`terrain` must have one height for each voxel column, {scene.shape[1:]}, but has "
            f"shape {terrain.shape}"
        )


def default_rim(scene: VoxelScene, steepest: float) -> int:
    """Voxels that the most slanted ray or beam crosses, and twice the height of the scene."""
    rim = math.ceil(scene.height * (steepest + 2.0) / scene.horizontal)
    return rim + rim % 2  # the coarse grid and a tile's own must start together


def check_memory(
    scene: VoxelScene,
    ordinates: int,
    factor: tuple[int, int],
    finer: tuple[int, int] | None,
    width: int | None = None,
) -> None:
    """Raise `InputError` where the diffuse light would not fit in the memory of this machine.

    Counts what grows with the grid: the scene, the radiance along each ordinate in each band, and
    the directions that the solver keeps. `width` [voxels]: of the square that is solved at once,
    a tile with its rim; by default the whole scene.
    """
    available = _memory()
    if available is None:
        return
    layers, ny, nx = scene.shape
    bands, size = scene.illumination.sun.shape[0], scene.area_density.dtype.itemsize
    field = ordinates * size

    def needed(columns: int) -> float:
        voxels = layers * columns
        cells = voxels / (factor[0] * factor[1] ** 2)
        densities = 3 * scene.area_density.shape[0] * voxels * size
        high, wide = scene.structure_factor
        densities += _SUN_FIELDS * high * wide**2 * voxels * size
        finest = bands * field * cells
        if finer is not None:
            finest = (bands + _FINE_FIELDS) * field * voxels / (finer[0] * finer[1] ** 2)
        return densities + _COARSE_FIELDS * field * cells + finest

    rows, columns = (ny, nx) if width is None else (width, width)
    need = needed(rows * columns)
    if need > available:
        advice = _smaller(scene, factor[1], lambda edge: needed(edge**2) <= available)
        raise InputError(
            f"a grid of {layers} x {rows} x {columns} voxels in {bands} bands needs about "
            f"{need / 2**30:.1f} GiB, but this machine has {available / 2**30:.1f}: {advice}"
        )


def _smaller(scene: VoxelScene, coarsening: int, fits: Callable[[int], bool]) -> str:
    """What to do about a scene too large to solve in one; `fits` says so of a square's edge."""
    _, ny, nx = scene.shape
    zenith = scene.illumination.sun_zenith
    slant = math.tan(math.radians(float(zenith))) if concrete(zenith) else 1.0
    rim, common = default_rim(scene, slant), math.gcd(ny, nx)
    # A tile far narrower than its rim would solve the same voxels many times over.
    for tile in range(common, max(rim // 2, 1) - 1, -1):
        edge = tile + 2 * rim
        if common % tile == 0 and edge % coarsening == 0 and fits(edge):
            return (
                f"render it in tiles that divide it, `render_tiles` with `tile={tile}` and "
                f"`rim={rim}` (the rim on both sides counts: {edge} x {edge} voxels are solved at "
                "once), or take larger voxels"
            )
    widest = max((edge for edge in range(1, max(ny, nx) + 1) if fits(edge)), default=0) - 2 * rim
    if widest > 0:
        return (
            f"no tile that divides its {ny} x {nx} columns fits. With a rim of {rim} voxels on "
            f"both sides a tile may be {widest} voxels wide: crop the scene to a multiple of such "
            "a side for `render_tiles`, or take larger voxels"
        )
    return (
        f"not even a tile with its rim of {rim} voxels fits, so take larger voxels or fewer bands"
    )


_COARSE_FIELDS, _FINE_FIELDS, _SUN_FIELDS = 18, 8, 5
"""Fields of one band that the solver, and the refinement, hold at once; and of the finest voxels
along the sun's beams."""


def _memory() -> int | None:
    """Bytes of memory of the device, or of the machine where that is the device."""
    stats = jax.devices()[0].memory_stats() or {}
    if "bytes_limit" in stats:
        return int(stats["bytes_limit"])
    try:
        return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    except (AttributeError, ValueError, OSError):
        return None

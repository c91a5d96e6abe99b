"""Checks of scenes and views before they are rendered."""

import math
from numbers import Integral
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from fynjax._core.errors import InputError
from fynjax._core.memory import total_memory
from fynjax._core.programs import concrete
from fynjax.radiation._blocks import block_mean
from fynjax.radiation._ground import RahmanPintyVerstraete
from fynjax.radiation._scene import VoxelScene


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
    if not slip and high == 1.0 and array[bad].max() > 1.0:
        ten_thousandths = array[bad].max() > 100.0
        slip = f": is it in {'ten thousandths' if ten_thousandths else 'percent'}? Divide first"
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


def check_view(zenith: Float[Array, "*#view"], azimuth: Float[Array, "*#view"]) -> None:
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
    pattern, soil = sun.sky_pattern, scene.ground_shape
    if density.ndim != 4 or 0 in density.shape:
        raise InputError(
            "`area_density` must have the axes [class, z, y, x], none of them empty, but has "
            f"shape {density.shape}"
        )
    if classes.reflectance.ndim != 2 or classes.reflectance.shape[1] == 0:
        raise InputError(
            "`classes.reflectance` must have the axes [class, band], with one band or more, but "
            f"has shape {classes.reflectance.shape}"
        )
    if not isinstance(soil, RahmanPintyVerstraete | None):
        raise InputError(
            f"`ground_shape` must be a `RahmanPintyVerstraete` or None, but is {short(soil)}"
        )
    optics, columns = (density.shape[0], classes.reflectance.shape[1]), density.shape[2:]
    n_class, *band = optics
    of_band = tuple(band)
    shapes: list[tuple[str, Any, str, tuple[int, ...]]] = [
        ("classes.reflectance", classes.reflectance, "(class, band)", optics),
        ("classes.transmittance", classes.transmittance, "(class, band)", optics),
        ("illumination.sun", sun.sun, "(band,)", of_band),
        ("illumination.sky", sun.sky, "(band,)", of_band),
        ("terrain", scene.terrain, "(y, x)", columns),
    ]
    if scene.ground.shape != of_band:
        shapes.append(("ground", scene.ground, "(band,) or (band, y, x)", (*band, *columns)))
    if soil is not None:
        shapes += [(f"ground_shape.{n}", v, "(band,)", of_band) for n, v in vars(soil).items()]
    for name, array, axes, shape in shapes:
        if array is not None and array.shape != shape:
            raise InputError(
                f"`{name}` must have shape {axes} = {shape} to go with `area_density` and the "
                f"bands, but has {array.shape}"
            )
    owners = {"angle_of_class": (classes.angle_of_class, len(classes.angles))}
    if classes.leaf_diameter is not None:
        owners["size_of_class"] = classes.sizes, len(classes.leaf_diameter)
    for name, (places, count) in owners.items():
        if len(places) != n_class or max(places) >= count:
            raise InputError(
                f"`classes.{name}` must have one of the places 0 to {count - 1} for each of the "
                f"{n_class} classes, but is {places}"
            )
    for name in ("sun_zenith", "sun_azimuth"):
        check_shape(f"illumination.{name}", getattr(sun, name), (), ": a scene has one sun")
    if pattern is not None:
        few = pattern.ndim not in (2, 3) or pattern.shape[-2] < 2 or pattern.shape[-1] < 1
        if few or (pattern.ndim == 3 and pattern.shape[:1] != of_band):
            raise InputError(
                "`illumination.sky_pattern` must have the axes [zenith, azimuth] or [band, zenith, "
                f"azimuth], with an azimuth and two zeniths or more, but has shape {pattern.shape}"
            )
    if scene.structure is not None:
        fine = scene.structure.shape
        times = [n / m for n, m in zip(fine, scene.shape)] if len(fine) == 3 else [0.5]
        if any(n < 1 or n != int(n) for n in times) or times[1] != times[2]:
            raise InputError(
                "`structure` must have a whole number of finer voxels to each of the grid's "
                f"{scene.shape}, as many along y as along x, but has shape {fine}"
            )
    if scene.boundary not in ("periodic", "open"):
        raise InputError(f"`boundary` must be 'periodic' or 'open', but is {scene.boundary!r}")
    for name in ("horizontal", "vertical"):
        check_length(name, getattr(scene, name))
    if concrete(scene):
        _check_values(scene)


def _check_values(scene: VoxelScene) -> None:
    """Values of a scene that is known."""
    density, classes, sun = scene.area_density, scene.classes, scene.illumination
    for name, values, high in (
        ("area_density [m2 m-3]", density, math.inf),
        ("structure [m2 m-3]", scene.structure, math.inf),
        ("ground", scene.ground, 1.0),
        ("classes.reflectance", classes.reflectance, 1.0),
        ("classes.transmittance", classes.transmittance, 1.0),
        ("classes.leaf_diameter [m]", classes.leaf_diameter, 10.0),
        ("illumination.sun", sun.sun, math.inf),
        ("illumination.sky", sun.sky, math.inf),
        ("illumination.sky_pattern", sun.sky_pattern, math.inf),
    ):
        if values is not None:
            check_range(name, values, 0.0, high)
    check_range("sun_azimuth", sun.sun_azimuth, -math.inf, math.inf)
    zenith = float(sun.sun_zenith)
    if not 0 <= zenith < 89.5:
        raise InputError(
            f"`sun_zenith` must be in [0, 89.5) degrees, but is {zenith:g}: the sun is at or below "
            "the horizon, or an elevation was passed"
        )
    if scene.terrain is not None:
        slip = ": heights count from the bottom of the grid, are they above sea level?"
        check_range("terrain [m]", scene.terrain, 0.0, scene.height, slip)
    if scene.ground_shape is not None:
        for name, low, high in (
            ("k", -math.inf, math.inf),
            ("theta", -1.0, 1.0),
            # Beyond 2 the reflectance is negative away from the hot spot.
            ("rho_c", -math.inf, 2.0),
        ):
            values = getattr(scene.ground_shape, name)
            check_range(f"ground_shape.{name}", values, low, high, ends="()")
    if scene.structure is not None:
        mean = np.asarray(block_mean(scene.structure, scene.structure_factor))
        total = np.asarray(density).sum(axis=0)
        if np.abs(mean - total).max() > 1e-3 * max(total.max(), 1e-3):
            raise InputError(
                "the mean of `structure` over a voxel must be the sum of `area_density` over the "
                f"classes, but they differ by up to {np.abs(mean - total).max():.3g} m2 m-3: was "
                "one of them changed alone?"
            )
    if not np.all(np.asarray(sun.sun) + np.asarray(sun.sky) > 0):
        raise InputError("`illumination` must have light, of sun or sky, in every band")
    if sun.sky_pattern is not None:
        dark = np.asarray(sun.sky_pattern).sum(axis=(-2, -1)) == 0
        if np.any(dark & (np.asarray(sun.sky) > 0)):
            raise InputError(
                "`illumination.sky_pattern` must be bright somewhere in every band that has light "
                "of the sky, but is zero everywhere: for no sky light set `sky` to zero"
            )
    total = np.max(np.asarray(classes.reflectance) + np.asarray(classes.transmittance))
    if total > 1 + 1e-5:
        raise InputError(
            f"reflectance + transmittance of a class must not exceed 1, but reaches {total:.4g}: "
            "are they in percent, or was absorptance passed?"
        )


def check_light_memory(
    scene: VoxelScene,
    ordinates: int,
    factor: tuple[int, int],
    finer: tuple[int, int] | None,
    held: float = math.inf,
) -> None:
    """Raise `InputError` where the light of a scene would not fit in the memory of this machine.

    Counts what grows with the grid: the scene, of which `held` voxels at most are in memory at
    once, the radiance along each ordinate in each band, and what the solver holds of one band.
    """
    available = _memory()
    bands, size = scene.illumination.sun.shape[0], scene.area_density.dtype.itemsize
    high, wide = scene.structure_factor
    field = ordinates * size

    def needed(voxels: float, cell: int, fine: int | None = None, times: int = 1) -> float:
        """With `times` less fine a structure."""
        light = (_COARSE_FIELDS + bands) / cell
        if fine is not None:
            light = _COARSE_FIELDS / cell + (bands + _FINE_FIELDS) / fine
        values = voxel_values(scene) - _SUN_FIELDS * high * wide**2 * (1 - 1 / times**3)
        return min(voxels, held) * values * size + voxels * field * light

    voxels = math.prod(scene.shape)
    cell = factor[0] * factor[1] ** 2
    fine = None if finer is None else finer[0] * finer[1] ** 2
    need = needed(voxels, cell, fine)
    if need <= available:
        return
    layers, rows, columns = scene.shape
    length = factor[1] * scene.horizontal
    # The first of these that fits is advised.
    remedies = [
        *((f"a structure of {n * scene.horizontal / wide:g} m", needed(voxels, cell, fine, n))
          for n in range(2, wide + 1)),
        *((f"cells of {n * length:g} m for its diffuse light (`Accuracy(cell={n * length:g}, "
           "refine=False)`)", needed(voxels, cell * n**2)) for n in range(1, 5)),
        *((f"voxels {n} times as large", needed(voxels / n**3, cell)) for n in range(2, 9)),
    ]  # fmt: skip
    fits = next((remedy for remedy, less in remedies if less <= available), None)
    advice = "take larger voxels, a smaller scene or fewer bands"
    raise InputError(
        f"a grid of {layers} x {rows} x {columns} voxels in {bands} bands needs about "
        f"{need / 2**30:.1f} GiB, but this machine has {available / 2**30:.1f}: "
        f"{advice if fits is None else f'with {fits} it would fit'}"
    )


def voxel_values(scene: VoxelScene) -> int:
    """Numbers in memory at once for each voxel of `scene`, while the sun is followed."""
    high, wide = scene.structure_factor
    return 3 * scene.area_density.shape[0] + _SUN_FIELDS * high * wide**2


def check_picture(scene: VoxelScene, pixels: int, slabs: int, together: int = 1) -> None:
    """Raise `InputError` where a picture of so many pixels would not fit in this machine's memory,
    if it is rendered in one piece, through `slabs` layers in each of which leaves scatter alike;
    where blocks of `together` x `together` pixels are one in the bands."""
    available = _memory()
    size = scene.area_density.dtype.itemsize
    classes, bands = scene.area_density.shape[0], scene.illumination.sun.shape[0]
    each = _PIXEL_FIELDS + 3 * classes + 4 * bands / together**2
    columns = math.prod(scene.shape[1:])
    need = size * (pixels * each + slabs * columns * (classes + bands * len(scene.classes.angles)))
    if need > available:
        raise InputError(
            f"a picture of {pixels} pixels in {bands} bands needs about {need / 2**30:.1f} GiB, "
            f"but this machine has {available / 2**30:.1f}: take larger pixels or fewer bands"
        )


_COARSE_FIELDS, _FINE_FIELDS, _SUN_FIELDS, _PIXEL_FIELDS = 10, 8, 5, 12
"""Fields of one band that the solver, and the refinement, hold at once; those of the finest voxels
along the sun's beams; and those of a picture."""


def _memory() -> int:
    """Bytes of memory of the device, or of the machine where that is the device."""
    stats = jax.devices()[0].memory_stats() or {}
    if "bytes_limit" in stats:
        return int(stats["bytes_limit"])
    return total_memory()

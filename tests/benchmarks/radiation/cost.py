"""Time and memory: the image, its gradient, many bands, large areas."""

import math
import time
from collections.abc import Callable, Iterator
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp

from fynjax._core.memory import peak_memory
from fynjax.assembly import aim_at_plot, aim_without_air, build_plot
from fynjax.io.plot import AtmosphereTable, example_folder, read_plot
from fynjax.radiation import (
    Accuracy,
    VoxelScene,
    nadir_rays,
    reflectance_factor,
    solve_light,
)
from fynjax.scene import TiledPicture
from fynjax.sensors import shipped_sensor
from tests.benchmarks import bench_radiation
from tests.benchmarks.radiation.head_to_head import IMAGE
from tests.benchmarks.radiation.report import Row, Setting, describe, planned_mib, with_fields

MOST_MIB = 8192.0
"""Programs that plan for more memory are compiled and not run."""


def four_bands(side: float) -> VoxelScene:
    """The shrubs of `bench_radiation` with a band at the red edge."""
    scene = bench_radiation.shrubs(side)
    edge = jnp.array([0.58, 0.46, 0.64, 0.40], jnp.float32) / 2

    def insert(values: jax.Array, fourth: Any) -> jax.Array:
        extra = jnp.asarray(fourth, jnp.float32)
        return jnp.concatenate([values, extra[..., None]], axis=-1)

    classes, light = scene.classes, scene.illumination
    return eqx.tree_at(
        lambda s: (
            s.classes.reflectance, s.classes.transmittance, s.ground,
            s.illumination.sun, s.illumination.sky,
        ),
        scene,
        (
            insert(classes.reflectance, edge), insert(classes.transmittance, edge),
            insert(scene.ground, 0.20), insert(light.sun, 0.87), insert(light.sky, 0.13),
        ),
    )  # fmt: skip


def clock(function: Callable[..., Any], scene: Any, repeats: int) -> tuple[float, float, float]:
    """Compile time [s], least CPU time [s] (not a number where the plan is too large to be run),
    planned memory [MiB]."""
    start = time.process_time()
    compiled = jax.jit(function).lower(scene).compile()
    compiling = time.process_time() - start
    memory, times = planned_mib(compiled), []
    if memory > MOST_MIB:
        return compiling, math.nan, memory
    for _ in range(repeats):
        start = time.process_time()
        jax.block_until_ready(compiled(scene))
        times.append(time.process_time() - start)
    return compiling, min(times), memory


def camera_image(side: float, pixels: int, accuracy: Accuracy) -> Callable[[VoxelScene], Any]:
    x = (jnp.arange(pixels, dtype=jnp.float32) + 0.5) * (side / pixels)
    rays = nadir_rays(x, x, side / pixels, (side / 2, side / 2, 50.0))
    accuracy = with_fields(accuracy, margin=19)
    return lambda scene: reflectance_factor(solve_light(scene, accuracy), rays)


def image(setting: Setting) -> Iterator[Row]:
    """400 x 400 pixels, four bands, 10 m; CPU time of all threads."""
    scene, pixels = four_bands(10.0), 100 if setting.quick else 400
    repeats = 1 if setting.quick else 3
    chosen = camera_image(10.0, pixels, IMAGE)
    plain = camera_image(10.0, pixels, Accuracy())
    first, seconds, memory = clock(chosen, scene, repeats)
    _, plain_seconds, plain_memory = clock(plain, scene, repeats)
    note = describe(IMAGE)
    yield Row("image 400 x 400, 4 bands", "CPU s", seconds, 4.0, plain_seconds, "s", note)
    yield Row("image 400 x 400, 4 bands", "memory", memory, 1024.0, plain_memory, "MiB", note)
    yield Row("image 400 x 400, 4 bands", "compilation", first, 20.0, unit="s", note=note)


def value_and_gradient(setting: Setting) -> Iterator[Row]:
    """With respect to everything, the density grid foremost."""
    scene, pixels = four_bands(10.0), 100 if setting.quick else 400
    ratios, memories = [], []
    for accuracy in (IMAGE, Accuracy()):
        function = camera_image(10.0, pixels, accuracy)

        def loss(s: VoxelScene, function: Any = function) -> jax.Array:
            return jnp.mean(function(s))

        def both(s: VoxelScene, loss: Any = loss) -> Any:
            return jax.value_and_grad(
                lambda density: loss(eqx.tree_at(lambda t: t.area_density, s, density))
            )(s.area_density)

        forward = clock(loss, scene, 1)[1]
        _, backward, memory = clock(both, scene, 1)
        ratios.append(backward / forward)
        memories.append(memory)
    note = describe(IMAGE)
    yield Row("value and gradient", "over the forward", ratios[0], 4.0, ratios[1], "x", note)
    yield Row("value and gradient", "memory", memories[0], None, memories[1], "MiB", note)


PLOTS = ((10.0, 0.1, None, None), (10.0, 0.05, 3.0, 1024.0), (20.0, 0.1, None, None))
"""Side and voxel of the example plot [m]; CPU s and MiB that its image may take."""


def example_plot(setting: Setting) -> Iterator[Row]:
    """From plants to pixels of 2.5 cm in four bands, with its structure; value and gradient of the
    mean square by all parameters, against the image."""
    for side, voxel, most_seconds, most_memory in (
        ((2.0, 0.1, None, None),) if setting.quick else PLOTS
    ):
        plot = read_plot(example_folder() / "plot.toml")
        plot = plot.replace(size_m=(side, side), voxel_m=voxel)
        scene, parameters = build_plot(plot)
        aimed = aim_without_air(plot, scene, parameters, shipped_sensor("mavic_3m"))
        numbers, rest = eqx.partition((aimed, scene), eqx.is_array)

        def observed(at: Any, rest: Any = rest) -> jax.Array:
            aimed, scene = eqx.combine(at[0], rest)
            return aimed.observe(scene, at[1]).reflectance

        def slopes(at: Any, observed: Any = observed) -> Any:
            return jax.value_and_grad(lambda p: jnp.mean(observed((at[0], p)) ** 2))(at[1])

        test, what = f"example plot, {side:g} m", f"voxels of {100 * voxel:g} cm"
        image = clock(observed, (numbers, parameters), 1)
        yield Row(test, "image: CPU s", image[1], most_seconds, unit="s", note=what)
        yield Row(test, "image: memory", image[2], most_memory, unit="MiB", note=what)
        yield Row(test, "image: compilation", image[0], 5.0, unit="s", note=what)
        gradient = clock(slopes, (numbers, parameters), 1)
        yield Row(
            test, "value and gradient: images", gradient[1] / image[1], 4.0, unit="x", note=what
        )
        yield Row(
            test, "value and gradient: memory", gradient[2] / image[2], 3.0, unit="x", note=what
        )
        yield Row(test, "value and gradient: compilation", gradient[0], 12.0, unit="s", note=what)


def cost_against_area(setting: Setting) -> Iterator[Row]:
    """Two rays a voxel's edge, four bands, at the defaults."""
    sides = (5.0, 10.0) if setting.quick else (5.0, 10.0, 20.0, 50.0)
    each = []
    for side in sides:
        function = camera_image(side, round(20 * side), Accuracy())
        _, seconds, memory = clock(function, four_bands(side), 1)
        each.append(seconds / side**2)
        yield Row("cost against area", f"{side:.0f} m: CPU s", seconds, unit="s")
        yield Row("cost against area", f"{side:.0f} m: memory", memory, unit="MiB")
    spread = each[-1] / each[0]
    yield Row("cost against area", "per m2, largest over least area", spread, 1.5, unit="x")


def hectare(setting: Setting) -> Iterator[Row]:
    """The example plot as 100 m x 100 m in voxels of 10 cm, evenly filled, as `fynjax render` does
    it: light solved once, plants, voxels and image in windows. From the plot to the image."""
    if setting.quick:
        return
    plot = read_plot(example_folder() / "plot.toml")
    plot = plot.replace(size_m=(100.0, 100.0), structure_m="even")
    start = time.process_time()
    scene, parameters = build_plot(plot)
    aimed = aim_at_plot(
        plot, scene, parameters, shipped_sensor("mavic_3m"),
        pixel=0.1, altitude=200.0, air=AtmosphereTable(model="none"), quiet=True,
    )  # fmt: skip
    TiledPicture(aimed, scene, parameters).image()
    test, what = "100 m x 100 m, 4 bands", "and compilation"
    seconds = time.process_time() - start
    yield Row(test, "CPU s, two cores in 3 min", seconds, 360.0, unit="s", note=what)
    peak = peak_memory() / 2**30
    yield Row(test, "most memory of the process so far", peak, 8.0, unit="GiB")

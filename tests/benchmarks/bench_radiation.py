"""Time and memory of light and image: `python -m tests.benchmarks.bench_radiation [--quick]`.

Prints, for a shrub scene of 10 m x 10 m in voxels of 10 cm (100 x 100 x 26, four species, three
bands), the time of an image and of its value and gradient, the error against the path tracer's
image where that is found, and how cost grows with area. float32, after compilation.

Memory is what XLA plans for a compiled function (arguments, results and temporaries).
"""

import argparse
import os
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import fynjax.radiation._image as image_module
import fynjax.radiation._multiple as multiple_module
from fynjax.canopy import SphericalLeafAngle
from fynjax.radiation import (
    Accuracy,
    Illumination,
    OpticalClasses,
    VoxelScene,
    nadir_rays,
    parallel_rays,
    reflectance_factor,
    solve_light,
)

BANDS = 3
REFERENCE = (
    Path(os.environ.get("FYNJAX_SHARED_DATA", Path(__file__).parents[3] / "shared" / "data")).parent
    / "bench" / "rt" / "results" / "ref100_open.npz"
)  # fmt: skip
ACCURACY = Accuracy(margin=19)


def shrubs(side: float, seed: int = 7) -> VoxelScene:
    """Ellipsoid shrubs of four species, 0.6 a square metre, over even soil; open sides."""
    rng = np.random.default_rng(seed)
    n, layers = round(side / 0.1), 26
    density = np.zeros((4, layers, n, n), np.float32)
    for _ in range(round(0.6 * side**2)):
        radius, top = rng.uniform(0.25, 0.95), rng.uniform(0.5, 2.4)
        cx, cy = rng.uniform(0, side, 2)
        low, high = (np.array([cx, cy]) - radius) / 0.1, (np.array([cx, cy]) + radius) / 0.1
        columns, rows = (
            np.arange(max(0, int(a)), min(n, int(b) + 1)) for a, b in zip(low, high, strict=True)
        )
        x, y, z = ((i + 0.5) * 0.1 for i in (columns, rows, np.arange(layers)))
        inside = (
            ((z - top / 2) / (top / 2))[:, None, None] ** 2
            + (((y - cy) / radius) ** 2)[:, None]
            + ((x - cx) / radius) ** 2
        ) < 1
        density[rng.integers(4), :, rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1] += (
            inside * rng.uniform(1.0, 4.0)
        )
    albedo = np.array(
        [[0.22, 0.10, 0.90], [0.16, 0.08, 0.82], [0.28, 0.16, 0.93], [0.19, 0.13, 0.72]]
    )
    half = jnp.asarray(albedo / 2, jnp.float32)
    sky = jnp.array([0.22, 0.17, 0.10], jnp.float32)
    return VoxelScene(
        jnp.asarray(np.minimum(density, 8.0)),
        OpticalClasses(half, half, (SphericalLeafAngle(),), (0,) * 4),
        jnp.array([0.10, 0.14, 0.28], jnp.float32),
        Illumination(jnp.float32(35.0), jnp.float32(50.0), 1 - sky, sky),
        0.1,
        0.1,
        "open",
    )


def clock(
    function: Callable[..., Any], *arguments: Any, repeats: int = 3
) -> tuple[float, float, float]:
    """Compile time [s], best time [s] and planned memory [MiB] of a jitted function."""
    start = time.perf_counter()
    compiled = jax.jit(function).lower(*arguments).compile()
    compiling = time.perf_counter() - start
    plan = compiled.memory_analysis()
    memory = (
        plan.argument_size_in_bytes + plan.output_size_in_bytes + plan.temp_size_in_bytes
    ) / 2**20
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        jax.block_until_ready(compiled(*arguments))
        times.append(time.perf_counter() - start)
    return compiling, min(times), memory


def time_image(scene: VoxelScene, side: float, pixels: int, repeats: int) -> float:
    """Print a row; return the forward time."""
    width = side / pixels
    x = (jnp.arange(pixels, dtype=jnp.float32) + 0.5) * width
    rays = nadir_rays(x, x, width, (side / 2, side / 2, 50.0))

    def image(scene: VoxelScene) -> jax.Array:
        return reflectance_factor(solve_light(scene, ACCURACY), rays)

    first, forward, memory = clock(image, scene, repeats=repeats)
    both = jax.value_and_grad(lambda scene: jnp.mean(image(scene)))
    second, backward, memory_both = clock(both, scene, repeats=repeats)
    print(
        f"{side:4.0f} m {pixels:5d}^2 {first:8.1f} {forward:8.2f} {memory:8.0f} {second:9.1f} "
        f"{backward:8.2f} {memory_both:8.0f} {backward / forward:7.2f}",
        flush=True,
    )
    return forward


def compare_with_path_tracer() -> None:
    """Error against the stored image; its medium scatters evenly, which is imposed here."""
    if not REFERENCE.is_file():
        print(f"no reference image at {REFERENCE}: comparison left out")
        return
    from tests.radiation.test_reference_scenes import comparison
    from tests.radiation.test_reference_scenes import shrubs as reference_shrubs

    def even(angle: Any, incoming: jax.Array, outgoing: jax.Array) -> tuple[jax.Array, jax.Array]:
        value = jnp.full((incoming.shape[0], outgoing.shape[0]), 0.125, incoming.dtype)
        return value, value

    module, want, _ = comparison(REFERENCE.parents[3] / "data")
    scene = reference_shrubs(module)
    kept = multiple_module.area_scattering, image_module.area_scattering
    multiple_module.area_scattering = image_module.area_scattering = even
    mean = want.mean(axis=(0, 1))
    print("\nagainst the path tracer, 560, 665, 842 nm        RMSE %              bias %")
    try:
        for pixels in (200, 400):
            x = (jnp.arange(pixels, dtype=jnp.float32) + 0.5) * (10 / pixels)
            rays = parallel_rays(x, x, 10 / pixels, 0.0, 0.0)
            image = jax.jit(lambda s, r=rays: reflectance_factor(solve_light(s, ACCURACY), r))(
                scene
            )
            parts = pixels // 100
            means = np.asarray(image).reshape(BANDS, 100, parts, 100, parts).mean(axis=(2, 4))
            error = (means - want.transpose(2, 0, 1)) / mean[:, None, None]
            noise = np.array([0.0057, 0.0061, 0.0075])
            rms = 100 * np.sqrt((error**2).mean(axis=(1, 2)) - noise**2)
            bias = 100 * error.mean(axis=(1, 2))
            print(f"{pixels:5d}^2 rays{'':28s}", np.round(rms, 2), np.round(bias, 2), flush=True)
    finally:
        multiple_module.area_scattering, image_module.area_scattering = kept


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="5 m only, one repeat")
    quick = parser.parse_args().quick
    print(f"{jax.devices()[0].device_kind}, {os.cpu_count()} cores, {BANDS} bands, float32")
    print(" side   rays   compile  image s     MiB   compile  + grad s     MiB   ratio")
    if quick:
        time_image(shrubs(5.0), 5.0, 100, 1)
        return
    small = shrubs(10.0)
    for pixels in (200, 400):
        time_image(small, 10.0, pixels, 3)
    print("\ncost against area, two rays a voxel edge")
    forward = [time_image(shrubs(side), side, round(20 * side), 1) for side in (5.0, 10.0, 20.0)]
    print(
        "seconds a square metre:",
        [f"{t / s**2:.4f}" for t, s in zip(forward, (5, 10, 20), strict=True)],
    )
    compare_with_path_tracer()


if __name__ == "__main__":
    main()

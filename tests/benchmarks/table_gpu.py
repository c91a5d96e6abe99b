"""Radiation on an accelerator and on the CPU: `python -m tests.benchmarks.table_gpu [--quick]`.

Shrubs in voxels of 10 cm, in float32: an image of 10 m, its value and gradient, a hectare in tiles,
and 416 bands. A row each: wall time after compilation, largest memory of the device, and by how
much the result differs from the CPU's, over its largest value (at most 1e-4 is asked for). Where
there is no accelerator the table is that of the CPU, and says so. `--quick` takes small plots.
"""

import argparse
import time
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from fynjax.radiation import (
    Accuracy,
    VoxelScene,
    nadir_rays,
    reflectance_factor,
    render_tiles,
    solve_light,
    tile_picture,
)
from tests.benchmarks.radiation.cost import four_bands

ACCURACY = Accuracy(sublayers=1, levels=2, refine=False, margin=19)


def many_bands(scene: VoxelScene, count: int) -> VoxelScene:
    """The four bands, and mixtures of neighbours between them."""
    place = jnp.linspace(0.0, 3.0, count)
    low = jnp.clip(jnp.floor(place).astype(int), 0, 2)
    share = (place - low).astype(jnp.float32)

    def mixed(values: jax.Array) -> jax.Array:
        return (1.0 - share) * values[..., low] + share * values[..., low + 1]

    where = lambda s: (  # noqa: E731
        s.classes.reflectance, s.classes.transmittance, s.ground,
        s.illumination.sun, s.illumination.sky,
    )  # fmt: skip
    return eqx.tree_at(where, scene, tuple(map(mixed, where(scene))))


def rays_over(side: float, pixel: float, height: float) -> Any:
    x = (np.arange(round(side / pixel), dtype=np.float32) + 0.5) * np.float32(pixel)
    return nadir_rays(x, x, pixel, (side / 2, side / 2, height))


def image(side: float, bands: int = 4) -> tuple[Callable[..., Any], VoxelScene]:
    scene, rays = four_bands(side), rays_over(side, 0.025 if bands == 4 else 0.1, 50.0)
    scene = scene if bands == 4 else many_bands(scene, bands)
    return lambda s: reflectance_factor(solve_light(s, ACCURACY), rays), scene


def gradient(side: float) -> tuple[Callable[..., Any], VoxelScene]:
    show, scene = image(side)

    def both(s: VoxelScene) -> Any:
        loss = lambda d: jnp.mean(show(eqx.tree_at(lambda t: t.area_density, s, d)))  # noqa: E731
        return jax.value_and_grad(loss)(s.area_density)[1]

    return both, scene


def tiled(side: float) -> tuple[Callable[..., Any], VoxelScene]:
    scene, rays = four_bands(side), rays_over(side, 0.1, 500.0)
    known = jax.eval_shape(lambda s: solve_light(s, ACCURACY), scene)
    # Of the light only shapes and the sun's slope count for the tiles.
    slope = solve_light(four_bands(1.0), ACCURACY).sun.slope
    tiling = tile_picture(eqx.tree_at(lambda at: at.sun.slope, known, slope), rays)
    return lambda s: render_tiles(solve_light(s, ACCURACY), rays, tiling).total, scene


def on(device: Any, function: Callable[..., Any], scene: VoxelScene) -> tuple[float, np.ndarray]:
    """Wall time after compilation [s], and the result."""
    with jax.default_device(device):
        placed = jax.device_put(scene, device)
        compiled = jax.jit(function).lower(placed).compile()
        jax.block_until_ready(compiled(placed))
        began = time.perf_counter()
        result = jax.block_until_ready(compiled(placed))
        return time.perf_counter() - began, np.asarray(result)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true")
    quick = parser.parse_args().quick
    device, cpu = jax.devices()[0], jax.devices("cpu")[0]
    print(f"on {device.device_kind}" + ("" if device != cpu else ": no accelerator was found"))
    side, large, bands = (2.0, 4.0, 40) if quick else (10.0, 100.0, 416)
    rows = (
        (f"image, {side:g} m", image(side)),
        (f"value and gradient, {side:g} m", gradient(side)),
        (f"{large:g} m in tiles", tiled(large)),
        (f"{bands} bands, {side:g} m", image(side, bands)),
    )
    print(f"{'':28s} {'s':>8s} {'GiB':>7s} {'CPU s':>8s} {'difference':>11s}")
    for name, (function, scene) in rows:
        seconds, result = on(device, function, scene)
        peak = (device.memory_stats() or {}).get("peak_bytes_in_use", float("nan")) / 2**30
        beside, truth = on(cpu, function, scene) if device != cpu else (seconds, result)
        difference = np.abs(result - truth).max() / np.abs(truth).max()
        print(f"{name:28s} {seconds:8.2f} {peak:7.2f} {beside:8.2f} {difference:11.1e}", flush=True)


if __name__ == "__main__":
    main()

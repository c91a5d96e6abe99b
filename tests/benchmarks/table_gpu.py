"""Radiation on an accelerator and on the CPU: `python -m tests.benchmarks.table_gpu [--quick]`.

Shrubs in voxels of 10 cm, in float32: an image of 10 m, its value and gradient, and
416 bands. A row each: wall time after compilation, largest memory of the device, and by how
much the result differs from the CPU's, over its largest value (at most 1e-4 is asked for). Where
there is no accelerator the table is that of the CPU, and says so. `--quick` takes small plots.
"""

import time
from collections.abc import Callable, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from fynjax.canopy import SphericalLeafAngle
from fynjax.radiation import (
    Accuracy,
    Illumination,
    OpticalClasses,
    VoxelScene,
    nadir_rays,
    reflectance_factor,
    solve_light,
)
from tests.benchmarks._measure import options

ACCURACY = Accuracy(sublayers=1, levels=2, refine=False, margin=19)
SPECTRA = np.array(
    [
        [0.22, 0.10, 0.58, 0.90], [0.16, 0.08, 0.46, 0.82],
        [0.28, 0.16, 0.64, 0.93], [0.19, 0.13, 0.40, 0.72],
        [0.10, 0.14, 0.20, 0.28], [0.22, 0.17, 0.13, 0.10],
    ]
)  # fmt: skip
"""Green, red, red edge and near infrared: albedo of the leaves of four species, reflectance of the
ground, diffuse share of the light [-]."""


def shrubs(side: float, bands: int = 4) -> VoxelScene:
    """Ellipsoid shrubs of four species, 0.6 a square metre, over even soil; open sides. More bands
    than four are mixtures of neighbours."""
    rng = np.random.default_rng(7)
    n, layers = round(side / 0.1), 26
    density = np.zeros((4, layers, n, n), np.float32)
    for _ in range(round(0.6 * side**2)):
        radius, top = rng.uniform(0.25, 0.95), rng.uniform(0.5, 2.4)
        middle = rng.uniform(0, side, 2)
        low = np.maximum((middle - radius) / 0.1, 0).astype(int)
        high = np.minimum((middle + radius) / 0.1 + 1, n).astype(int)
        x, y = ((np.arange(a, b) + 0.5) * 0.1 - m for a, b, m in zip(low, high, middle))
        z = (np.arange(layers) + 0.5) * 0.1 / (top / 2) - 1
        inside = z[:, None, None] ** 2 + ((y / radius) ** 2)[:, None] + (x / radius) ** 2 < 1
        place = rng.integers(4), slice(None), slice(low[1], high[1]), slice(low[0], high[0])
        density[place] += inside * rng.uniform(1.0, 4.0)
    at = np.linspace(0.0, 3.0, bands)
    *albedo, ground, sky = (
        jnp.asarray(np.interp(at, np.arange(4.0), row), jnp.float32) for row in SPECTRA
    )
    half = jnp.stack(albedo) / 2
    light = Illumination(jnp.float32(35.0), jnp.float32(50.0), 1 - sky, sky)
    classes = OpticalClasses(half, half, (SphericalLeafAngle(),), (0,) * 4)
    crowded = jnp.asarray(np.minimum(density, 8.0))
    return VoxelScene(crowded, classes, ground, light, 0.1, 0.1, "open")


def rays_over(side: float, pixel: float, height: float) -> Any:
    x = (np.arange(round(side / pixel), dtype=np.float32) + 0.5) * np.float32(pixel)
    return nadir_rays(x, x, pixel, (side / 2, side / 2, height))


def image(side: float, bands: int = 4) -> tuple[Callable[..., Any], VoxelScene]:
    rays = rays_over(side, 0.025 if bands == 4 else 0.1, 50.0)
    return lambda s: reflectance_factor(solve_light(s, ACCURACY), rays), shrubs(side, bands)


def gradient(side: float) -> tuple[Callable[..., Any], VoxelScene]:
    show, scene = image(side)

    def both(s: VoxelScene) -> Any:
        loss = lambda d: jnp.mean(show(eqx.tree_at(lambda t: t.area_density, s, d)))  # noqa: E731
        return jax.value_and_grad(loss)(s.area_density)[1]

    return both, scene


def on(device: Any, function: Callable[..., Any], scene: VoxelScene) -> tuple[float, np.ndarray]:
    """Wall time after compilation [s], and the result."""
    with jax.default_device(device):
        placed = jax.device_put(scene, device)
        compiled = jax.jit(function).lower(placed).compile()
        jax.block_until_ready(compiled(placed))
        began = time.perf_counter()
        result = jax.block_until_ready(compiled(placed))
        return time.perf_counter() - began, np.asarray(result)


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the table."""
    parser = options(__doc__)
    parser.add_argument("--quick", action="store_true")
    given = parser.parse_args(arguments)
    device, cpu = jax.devices()[0], jax.devices("cpu")[0]
    print(f"on {device.device_kind}" + ("" if device != cpu else ": no accelerator was found"))
    side, bands = (2.0, 40) if given.quick or given.tiny else (10.0, 416)
    rows = (
        (f"image, {side:g} m", lambda: image(side)),
        (f"value and gradient, {side:g} m", lambda: gradient(side)),
        (f"{bands} bands, {side:g} m", lambda: image(side, bands)),
    )
    print(f"{'':28s} {'s':>8s} {'GiB':>7s} {'CPU s':>8s} {'difference':>11s}")
    for name, make in rows:
        function, scene = make()
        seconds, result = on(device, function, scene)
        peak = (device.memory_stats() or {}).get("peak_bytes_in_use")
        held = "-" if peak is None else f"{peak / 2**30:.2f}"
        beside, truth = on(cpu, function, scene) if device != cpu else (seconds, result)
        difference = np.abs(result - truth).max() / np.abs(truth).max()
        print(f"{name:28s} {seconds:8.2f} {held:>7s} {beside:8.2f} {difference:11.1e}", flush=True)


if __name__ == "__main__":
    main()

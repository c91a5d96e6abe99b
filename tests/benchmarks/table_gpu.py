"""What an accelerator gains: `python -m tests.benchmarks.table_gpu [--quick]`.

Shrubs in voxels of 10 cm, in float32: an image of 10 m, its value and gradient, and 416 bands; then
plots of 13 taxa as `fx.observe` makes them, of 2, 10 and 20 m. A row each: wall time to trace, to
compile (in brackets CPU time of all cores) and to run, largest memory of the device so far, wall
time of the CPU, and by how much the result differs from the CPU's, over its largest value (at most
1e-4 is asked for). Last the leaves of 100 000 spectra, fitted. Where there is no accelerator the
table is that of the CPU, and says so. `--quick` takes small plots.
"""

import time
from collections.abc import Callable, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

import fynjax as fx
from fynjax.canopy import SphericalLeafAngle, table1_2006
from fynjax.leaf import fit_leaf, prospect
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
from tests.benchmarks.bench_leaf import leaves

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


def plot(side: float, *, slope: bool) -> tuple[Callable[..., Any], Any]:
    """The drone's image of a plot of 13 taxa, or the slopes of its mean by all parameters; of less
    than 2 m of one taxon, in voxels filled evenly."""
    few = {"voxel": 0.25, "structure": "even"} if side < 2.0 else {}
    scene = fx.Scene.from_table(table1_2006()[: 1 if few else 13], size=side, **few)
    arrays, rest = eqx.partition(scene, eqx.is_array)

    def show(arrays: Any) -> Any:
        return fx.observe(eqx.combine(arrays, rest), "mavic_3m", pixel=0.025).reflectance

    def slopes(arrays: Any) -> Any:
        def value(parameters: Any) -> Any:
            return jnp.mean(show(eqx.tree_at(lambda s: s.parameters, arrays, parameters)))

        found = jax.value_and_grad(value)(arrays.parameters)
        return jnp.concatenate([jnp.ravel(leaf) for leaf in jax.tree.leaves(found)])

    return slopes if slope else show, arrays


def on(device: Any, function: Callable[..., Any], scene: Any) -> tuple[str, float, np.ndarray]:
    """Seconds to trace and compile as text, wall time of a run [s], and the result."""
    with jax.default_device(device):
        placed = jax.device_put(scene, device)
        times = [(time.perf_counter(), time.process_time())]
        stage: Any = jax.jit(function)
        for step in ("lower", "compile"):
            stage = getattr(stage, step)(*[placed] * (step == "lower"))
            times.append((time.perf_counter(), time.process_time()))
        jax.block_until_ready(stage(placed))
        began = time.perf_counter()
        result = jax.block_until_ready(stage(placed))
        took = time.perf_counter() - began
    (traced, _), (compiled, busy) = np.diff(times, axis=0)
    return f"{traced:6.1f} {compiled:6.1f} ({busy:4.0f})", took, np.asarray(result)


def fits(device: Any, count: int) -> float:
    """Wall time of the fits of `count` spectra, compiled before [s]."""
    with jax.default_device(device):
        spectra = np.asarray(jax.jit(jax.vmap(prospect))(leaves(count)).reflectance)
        noise = np.random.default_rng(1).normal(1.0, 0.03, (count, 1)).astype(np.float32)
        for _ in range(2):
            began = time.perf_counter()
            fit_leaf(np.arange(400.0, 2501.0), spectra * noise)
    return time.perf_counter() - began


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the table."""
    parser = options(__doc__)
    parser.add_argument("--quick", action="store_true")
    given = parser.parse_args(arguments)
    device, cpu = jax.devices()[0], jax.devices("cpu")[0]
    print(f"on {device.device_kind}" + ("" if device != cpu else ": no accelerator was found"))
    side, bands = (2.0, 40) if given.quick or given.tiny else (10.0, 416)
    rows = [
        (f"image, {side:g} m", lambda: image(side)),
        (f"value and gradient, {side:g} m", lambda: gradient(side)),
        (f"{bands} bands, {side:g} m", lambda: image(side, bands)),
    ]
    for wide in (1.0,) if given.tiny else (2.0,) if given.quick else (2.0, 10.0, 20.0):
        rows += [
            (f"{what}, {wide:g} m", lambda wide=wide, slope=slope: plot(wide, slope=slope))
            for what, slope in (("plot's image", False), ("its value and gradient", True))
        ]
    print(
        f"{'':28s} {'trace':>6s} {'compile (CPU)':>13s} {'run':>8s} {'GiB':>7s} {'CPU runs':>8s} "
        f"{'difference':>11s}"
    )
    for name, make in rows:
        function, scene = make()
        making, seconds, result = on(device, function, scene)
        peak = (device.memory_stats() or {}).get("peak_bytes_in_use")
        held = "-" if peak is None else f"{peak / 2**30:.2f}"
        beside, truth = on(cpu, function, scene)[1:] if device != cpu else (seconds, result)
        difference = np.abs(result - truth).max() / np.abs(truth).max()
        print(
            f"{name:28s} {making} {seconds:8.3f} {held:>7s} {beside:8.3f} {difference:11.1e}",
            flush=True,
        )
    count = 50 if given.tiny else 1000 if given.quick else 100_000
    print(f"leaves of {count} spectra fitted in {fits(device, count):.1f} s")


if __name__ == "__main__":
    main()

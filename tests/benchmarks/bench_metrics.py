"""Time of the metrics on a drone image, value and gradient.

Run as `python -m tests.benchmarks.bench_metrics [ROWS COLUMNS]`; not collected by pytest.
"""

import sys
import time
from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np

from fynjax.compare import bands_2006
from fynjax.metrics import (
    histogram_intersection,
    ks_distance,
    mean,
    smooth_histogram_intersection,
    smooth_ks_distance,
    smooth_vegetation_indices,
    standard_deviation,
    vegetation_indices,
    wasserstein_distance,
)
from fynjax.sensors import mavic_3m, mavic_3m_paper_camera


def seconds(function: Callable, *arguments: object, repeats: int = 5) -> tuple[float, float]:
    """Time of the first call, compilation included, and the best of the later ones [s]."""
    times = []
    for _ in range(repeats + 1):
        start = time.perf_counter()
        jax.block_until_ready(function(*arguments))
        times.append(time.perf_counter() - start)
    return times[0], min(times[1:])


def index_statistics(image: jax.Array) -> jax.Array:
    """Mean and standard deviation of the smooth indices: what a calibration compares."""
    values, valid = smooth_vegetation_indices(image)
    return jnp.stack([jax.vmap(mean)(values, valid), jax.vmap(standard_deviation)(values, valid)])


def main(shape: tuple[int, int] = (400, 400)) -> None:
    """Print one line for each metric."""
    rng = np.random.default_rng(0)
    means = np.array([row.real_mean for row in bands_2006().values()])[:, None, None]
    real, simulated = (
        jnp.asarray(means * np.exp(0.3 * rng.normal(size=(4, *shape))), jnp.float32)
        for _ in range(2)
    )
    weights = jnp.linspace(0.1, 1.0, 40, dtype=jnp.float32).reshape(2, 20)
    cases: dict[str, tuple[Callable, tuple]] = {
        "20 indices": (jax.jit(vegetation_indices), (real,)),
        "20 smooth indices, mean and std": (jax.jit(index_statistics), (real,)),
        "  and gradient": (
            jax.jit(jax.value_and_grad(lambda x: jnp.sum(weights * index_statistics(x)))),
            (real,),
        ),
    }
    x, y = real[3], simulated[3] * 1.05
    for distance in (histogram_intersection, ks_distance):
        cases[distance.__name__] = (jax.jit(distance), (x, y))
    for distance in (wasserstein_distance, smooth_histogram_intersection, smooth_ks_distance):
        cases[distance.__name__] = (jax.jit(distance), (x, y))
        gradient = jax.jit(jax.value_and_grad(distance, argnums=1))
        cases[f"{distance.__name__} and gradient"] = (gradient, (x, y))
    camera = mavic_3m_paper_camera(jnp.array([5.0, 5.0, 50.0], jnp.float32))
    cases["view directions, 640 x 480"] = (jax.jit(lambda: camera.view_directions()), ())
    grid = np.arange(400.0, 2501.0)
    cases["band weights, 4 x 2101"] = (lambda: mavic_3m().weights(grid), ())
    print(f"{shape[0]} x {shape[1]} pixels, float32, {jax.devices()[0].device_kind}")
    for name, (function, arguments) in cases.items():
        first, later = seconds(function, *arguments)
        print(f"{name:50s} first {first:7.2f} s   then {1e3 * later:9.2f} ms")


if __name__ == "__main__":
    sizes = [int(argument) for argument in sys.argv[1:3]]
    main((sizes[0], sizes[1]) if len(sizes) == 2 else (400, 400))

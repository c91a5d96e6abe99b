"""Time and memory of building a scene: `python -m tests.benchmarks.bench_canopy [--large]`.

Prints blue noise, sharing of sites, deposition (compile, forward, value and gradient) and the
formulations of the scatter that were tried for it. `--large` adds 100 m x 100 m.
"""

import argparse
import resource
import time
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from fynjax.canopy import (
    FORMS,
    VoxelGrid,
    assign_sites,
    deposit,
    hard_count,
    instance_area,
    instantiate,
    plant_model,
    poisson_disk,
    random_orientation,
    site_weight,
    soft_count,
    stack_plants,
    table1_2006,
    target_area,
)


def clock(function: Callable[..., Any], *arguments: Any, repeats: int = 5) -> tuple[float, float]:
    """(first, best later) time of a call [s]."""
    times = []
    for _ in range(repeats + 1):
        start = time.perf_counter()
        jax.block_until_ready(function(*arguments))
        times.append(time.perf_counter() - start)
    return times[0], min(times[1:])


def report(name: str, first: float, later: float | None = None, note: str = "") -> None:
    then = "        " if later is None else f"{later:8.3f}"
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    print(f"{name:<46}{first:8.3f}{then}   {peak:5.2f} GiB  {note}", flush=True)


def build_and_time(side: float, radius: float, n_elements: int) -> None:
    table = table1_2006()
    cover = table.cover_percent.to_numpy() / 100.0
    size = table.mean_diameter_cm.to_numpy() / 100.0, table.height_max_m.to_numpy()
    single = [jnp.asarray(values, jnp.float32) for values in (cover, *size)]
    start = time.perf_counter()
    points = poisson_disk((side, side), radius, seed=0, periodic=True)
    report(
        f"blue noise {side:g} m, r {radius:g} m",
        time.perf_counter() - start,
        note=f"{len(points)} points",
    )
    crowns = np.array([float(instance_area(d, h)) for d, h in zip(*size, strict=True)])
    counts = hard_count(target_area(side**2, cover), crowns)
    start = time.perf_counter()
    sites = assign_sites(points, list(counts), seed=0)
    report("sites of 13 species", time.perf_counter() - start, note=f"{counts.sum()} plants")

    species = np.repeat(np.arange(len(table)), counts)
    place = np.concatenate([np.arange(n) for n in counts])
    models = [plant_model(form, n_elements, seed=i) for i, form in enumerate(table.growth_form)]
    plants = stack_plants(models, species)
    organ = np.asarray(plants.organ)
    classes = np.where(organ > 0, len(table) - 1 + organ, species[:, None]).ravel()
    defaults = [FORMS[form] for form in table.growth_form]
    leaf, wood, flower = np.array(
        [
            [d.leaf_area_index, d.wood_area_index, d.flower_fraction * d.leaf_area_index]
            for d in defaults
        ],
        np.float32,
    ).T
    ground = np.concatenate(sites).astype(np.float32)
    azimuth = random_orientation(len(species), seed=0)[0].astype(np.float32)
    grid = VoxelGrid.cover((side, side), float(size[1].max()), 0.1)
    n_classes = len(table) + 2

    # What does not move goes in as an argument: closed over, XLA would fold it for minutes.
    fixed = (plants, ground, azimuth, species, place, classes)

    def scene(cover: jax.Array, diameter: jax.Array, height: jax.Array, fixed: Any) -> jax.Array:
        plants, ground, azimuth, species, place, classes = fixed
        count = soft_count(target_area(side**2, cover), instance_area(diameter, height))
        weight = site_weight(count[species], place, softness=0.02)
        disc = (jnp.pi / 4 * diameter**2)[species]
        at, area, _ = instantiate(
            plants, ground, azimuth, weight, diameter[species], height[species],
            jnp.asarray(leaf)[species] * disc,
            jnp.asarray(wood)[species] * disc,
            jnp.asarray(flower)[species] * disc,
        )  # fmt: skip
        return deposit(at, area, classes, grid, n_classes)

    slope = jax.value_and_grad(lambda *p: jnp.sum(scene(*p) ** 2), (0, 1, 2))
    note = f"{len(classes)} elements on {n_classes} x {grid.shape}"
    repeats = 5 if side < 50 else 1
    report(
        "scene to grid, float32", *clock(jax.jit(scene), *single, fixed, repeats=repeats), note=note
    )
    report("  value and gradient", *clock(jax.jit(slope), *single, fixed, repeats=repeats))


def compare_scatters(n: int = 500_000) -> None:
    """Same grid and elements, other ways to add them up."""
    rng = np.random.default_rng(0)
    classes, shape = 17, (27, 100, 100)
    size = classes * int(np.prod(shape))
    site = np.repeat(rng.uniform(0, 100, (n // 100, 2)), 100, axis=0)
    place = np.concatenate([site + rng.uniform(-2, 2, (n, 2)), rng.uniform(0, 10, (n, 1))], 1)
    low = np.floor(place).astype(np.int32)
    share = jnp.asarray(place - low, jnp.float32)
    of_class = np.repeat(np.sort(rng.integers(0, classes, n // 100)), 100)
    corners = [(a, b, c) for a in (0, 1) for b in (0, 1) for c in (0, 1)]
    rows = [
        ((of_class * 27 + np.minimum(low[:, 2] + a, 26)) * 100 + (low[:, 1] + b) % 100) * 100
        + (low[:, 0] + c) % 100
        for a, b, c in corners
    ]
    order = np.argsort(np.stack(rows, -1).ravel(), kind="stable")

    def parts(share: jax.Array) -> list[jax.Array]:
        pairs = [(1 - share[:, i], share[:, i]) for i in range(3)]
        return [pairs[2][a] * pairs[1][b] * pairs[0][c] for a, b, c in corners]

    def one_flat(share: jax.Array) -> jax.Array:
        flat = jnp.stack(parts(share), -1).ravel()
        return jnp.zeros(size, share.dtype).at[np.stack(rows, -1).ravel()].add(flat, mode="drop")

    def per_corner(share: jax.Array) -> jax.Array:
        grid = jnp.zeros(size, share.dtype)
        for row, part in zip(rows, parts(share), strict=True):
            grid = grid.at[row].add(part, mode="drop")
        return grid

    def presorted(share: jax.Array) -> jax.Array:
        flat = jnp.stack(parts(share), -1).ravel()[order]
        index = np.stack(rows, -1).ravel()[order]
        return jax.ops.segment_sum(flat, index, size, indices_are_sorted=True)

    for function in (one_flat, per_corner, presorted):
        name = f"scatter {n}, {function.__name__}"
        report(name, *clock(jax.jit(function), share))
        slope = jax.jit(jax.value_and_grad(lambda s, f=function: jnp.sum(f(s) ** 2)))
        report("  value and gradient", *clock(slope, share))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--large", action="store_true", help="also 100 m x 100 m")
    large = parser.parse_args().large
    print(f"{'':<46}{'first s':>8}{'later s':>8}   peak")
    poisson_disk((1.0, 1.0), 0.1, seed=0)  # numba compiles once, then keeps it on disk
    compare_scatters()
    build_and_time(10.0, 0.05, 180)
    if large:
        build_and_time(100.0, 0.1, 12)


if __name__ == "__main__":
    main()

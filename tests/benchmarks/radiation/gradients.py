"""Derivatives against central differences in double precision, and a peer's beside them."""

import os
import re
import subprocess
from collections.abc import Callable, Iterator
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from fynjax.radiation import (
    Accuracy,
    RahmanPintyVerstraete,
    VoxelScene,
    directional_reflectance,
    fluxes,
    nadir_rays,
    parallel_rays,
    reflectance_factor,
    solve_light,
)
from tests.benchmarks.radiation.head_to_head import even_scattering, path_traced
from tests.benchmarks.radiation.mesh import interpreter
from tests.benchmarks.radiation.report import Row, Setting
from tests.radiation.scenes import patchy
from tests.radiation.test_reference_scenes import shrubs

TIGHT = Accuracy(margin=6, tolerance=1e-12, iterations=400)
RAYS = nadir_rays(jnp.linspace(0.05, 0.75, 7), jnp.linspace(0.05, 0.55, 5), 0.05, (0.4, 0.3, 5.0))


def whole_scene(boundary: str, ground: str) -> VoxelScene:
    """Every optional field filled; the ground has a `shape` of its own or `terrain`, not both."""
    plain = patchy(boundary)
    filled: dict[str, Any] = {
        "classes.leaf_diameter": jnp.array([0.03]),
        "illumination.sky_pattern": jnp.asarray(np.random.default_rng(5).uniform(0.5, 1.5, (4, 6))),
    }
    if ground == "terrain":
        filled["terrain"] = 0.05 * jnp.asarray(np.random.default_rng(6).random((6, 8)))
    else:
        filled["ground_shape"] = RahmanPintyVerstraete(
            jnp.array([0.8, 0.9]), jnp.array([-0.1, -0.05]), jnp.array([0.9, 0.8])
        )
    scene = plain
    for path, value in filled.items():
        *parents, name = path.split(".")

        def place(s: Any, parents: list[str] = parents, name: str = name) -> Any:
            for parent in parents:
                s = getattr(s, parent)
            return getattr(s, name)

        scene = eqx.tree_at(place, scene, value, is_leaf=lambda leaf: leaf is None)
    return scene


def outcome(scene: VoxelScene) -> jax.Array:
    """An image, fluxes and a distant view, as one number."""
    light = solve_light(scene, TIGHT)
    flux = fluxes(light)
    weights = np.random.default_rng(1).normal(size=(2, 5, 7))
    view = directional_reflectance(light, jnp.array([40.0]), jnp.array([100.0]))
    return (
        jnp.sum(weights * reflectance_factor(light, RAYS))
        + flux.albedo @ jnp.array([1.0, -2.0])
        + jnp.sum(flux.absorbed * jnp.arange(6.0).reshape(2, 3))
        + flux.transmitted @ jnp.array([0.3, 0.7])
        + jnp.sum(view)
    )


def slopes(boundary: str, ground: str) -> Iterator[tuple[str, float, float]]:
    """Name, derivative and central difference: each entry of a small array, three random
    directions of a large one."""
    scene = whole_scene(boundary, ground)
    value, gradient = jax.jit(outcome), jax.jit(jax.grad(outcome))(scene)
    leaves = jax.tree_util.tree_flatten_with_path(scene)[0]
    slope = jax.tree.leaves(gradient)
    rng = np.random.default_rng(2)

    def along(index: int, step: np.ndarray, h: float) -> float:
        values = []
        for sign in (1, -1):
            moved = [leaf for _, leaf in leaves]
            moved[index] = moved[index] + sign * h * step
            values.append(float(value(jax.tree.unflatten(jax.tree.structure(scene), moved))))
        return (values[0] - values[1]) / (2 * h)

    for index, (path, leaf) in enumerate(leaves):
        name = jax.tree_util.keystr(path).lstrip(".")
        if leaf.size <= 8:
            steps = list(np.eye(leaf.size).reshape(-1, *leaf.shape))
        elif "density" in name:
            # Proportional to the density: a step must not make an empty voxel negative.
            steps = [rng.normal(size=leaf.shape) * np.asarray(leaf) for _ in range(3)]
        else:
            steps = [rng.normal(size=leaf.shape) for _ in range(2)]
        for step in steps:
            # One step must suit degrees and fractions of a metre alike.
            size = 1e-5 * max(1e-2, float(np.abs(np.asarray(leaf)).max()))
            yield name, float(jnp.sum(slope[index] * step)), along(index, step, size)


def gradients(setting: Setting) -> Iterator[Row]:
    """Every array of the scene, then the shrubs' density beside a peer's derivative."""
    kinds = [("periodic", "shape"), ("open", "terrain")]
    kinds += [] if setting.quick else [("open", "shape"), ("periodic", "terrain")]
    for boundary, ground in kinds:
        case = f"gradient, {boundary}, {ground}"
        found: dict[str, list[tuple[float, float]]] = {}
        for name, got, want in slopes(boundary, ground):
            found.setdefault(name, []).append((got, want))
        for name, pairs in found.items():
            largest = max(abs(want) for _, want in pairs)
            if largest < 1e-12 and all(abs(got) < 1e-12 for got, _ in pairs):
                yield Row(case, name, 0.0, unit="rel", note="no effect")
                continue
            # An entry without effect of its own is measured by its neighbours.
            off = max(abs(got - want) / max(abs(want), 1e-3 * largest) for got, want in pairs)
            yield Row(case, name, off, 1e-4, unit="rel")
    yield from density_beside_peer(setting)


def density_beside_peer(setting: Setting) -> Iterator[Row]:
    """d mean(image) / d log(density) of the sixty shrubs, with even scattering."""
    module, _ = path_traced(setting)
    scene = jax.tree.map(lambda a: a.astype(jnp.float64), shrubs(module))
    accuracy = Accuracy(margin=19, tolerance=1e-9, iterations=200)
    x = (jnp.arange(100) + 0.5) * 0.1
    rays = parallel_rays(x, x, 0.1, jnp.array(0.0), jnp.array(0.0))

    def means(density: jax.Array) -> jax.Array:
        changed = eqx.tree_at(lambda s: s.area_density, scene, density)
        return reflectance_factor(solve_light(changed, accuracy), rays).mean(axis=(1, 2))

    with even_scattering():
        density = scene.area_density
        value = jax.jit(means)
        pull: Callable[[jax.Array], jax.Array] = jax.jit(
            lambda d: jnp.stack([jnp.sum(g * d) for g in jax.jacrev(means)(d)])
        )
        backward = np.asarray(pull(density))
        difference = np.asarray(value(density * (1 + 1e-5)) - value(density * (1 - 1e-5))) / 2e-5
    ours = ", ".join(f"{v:+.5f}" for v in backward)
    off = float(np.max(np.abs(backward / difference - 1)))
    yield Row("gradient, shrubs", "d mean / d log density", off, 1e-4, unit="rel", note=ours)
    python = interpreter()
    if python is None or setting.quick:
        return
    command = [python, str(setting.peers / "mitsuba_gradcheck.py"), "--res", "50"]
    command += ["--spp-fd", "256", "--spp-ad", "64", "--seeds", "3"]
    printed = subprocess.run(
        command, check=True, capture_output=True, text=True, cwd=setting.peers, env=os.environ
    ).stdout
    numbers = [
        [float(v) for v in re.findall(r"-?\d+\.\d+(?:e-?\d+)?|-?\d+e-?\d+", line)]
        for line in printed.splitlines()
        if line.startswith(("FD", "AD"))
    ]
    text = printed.replace("\n", "; ")
    finite = np.array(numbers[0][:3])
    adjoint = np.array([row[0] for row in numbers[1:4]])
    for band, name in enumerate(("560 nm", "665 nm", "842 nm")):
        yield Row(
            "gradient, peer", f"its adjoint off its own differences, {name}",
            100 * float(abs(adjoint[band] / finite[band] - 1)), note=text if band == 0 else "",
        )  # fmt: skip
        yield Row(
            "gradient, peer", f"ours off its differences, {name}",
            100 * float(abs(backward[band] / finite[band] - 1)),
        )  # fmt: skip

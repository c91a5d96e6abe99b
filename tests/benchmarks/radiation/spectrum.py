"""Hundreds of bands from a few solves, against a solve for each."""

import time
from collections.abc import Iterator

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from fynjax.leaf import LeafParameters, prospect
from fynjax.radiation import Accuracy, OpticalClasses, VoxelScene, nadir_rays, render, solve_light
from tests.benchmarks import bench_radiation
from tests.benchmarks.radiation.report import Row, Setting, margin_for, with_fields

SPECIES, BANDS = 13, 425
RANGE = {
    "structure": (1.3, 2.4),
    "chlorophyll": (15.0, 70.0),
    "carotenoids": (4.0, 14.0),
    "anthocyanins": (0.0, 4.0),
    "water": (0.006, 0.03),
    "dry_matter": (0.005, 0.025),
}
"""Of the leaves of a species, in PROSPECT's units."""


def thirteen_species(side: float, bands: int) -> VoxelScene:
    """Shrubs whose leaves differ in everything that PROSPECT knows, over soil of two kinds."""
    rng = np.random.default_rng(3)
    scene = bench_radiation.shrubs(side)
    wavelength = np.linspace(400.0, 2500.0, bands)
    spectra = [
        prospect(
            LeafParameters(
                **{name: jnp.asarray(rng.uniform(*ends)) for name, ends in RANGE.items()}
            ),
            wavelength,
        )
        for _ in range(SPECIES)
    ]
    rho, tau = (
        jnp.stack([jnp.asarray(getattr(s, name), jnp.float32) for s in spectra])
        for name in ("reflectance", "transmittance")
    )
    n = scene.area_density.shape[-1]
    owner = rng.integers(SPECIES, size=(n // 5, n // 5)).repeat(5, 0).repeat(5, 1)
    total = np.asarray(scene.area_density.sum(axis=0))
    density = np.stack([total * (owner == s) for s in range(SPECIES)])
    bright = 0.08 + 0.35 * (1 - np.exp(-(wavelength - 380) / 900))
    wet = bright * (0.55 - 0.1 * np.sin(wavelength / 300))
    share = np.clip(rng.normal(0.5, 0.25, (n // 5, n // 5)), 0, 1).repeat(5, 0).repeat(5, 1)
    ground = bright[:, None, None] * share + wet[:, None, None] * (1 - share)
    sky = jnp.asarray(0.05 + 0.5 * (400 / wavelength) ** 2, jnp.float32)
    angles = scene.classes.angles
    return eqx.tree_at(
        lambda s: (s.area_density, s.classes, s.ground, s.illumination.sun, s.illumination.sky),
        scene,
        (
            jnp.asarray(density, jnp.float32),
            OpticalClasses(rho, tau, angles, (0,) * SPECIES),
            jnp.asarray(ground, jnp.float32),
            1 - sky,
            sky,
        ),
    )


def some_bands(scene: VoxelScene, start: int, size: int) -> VoxelScene:
    """The scene in `size` bands."""
    chosen = slice(start, start + size)
    return eqx.tree_at(
        lambda s: (
            s.classes.reflectance,
            s.classes.transmittance,
            s.ground,
            s.illumination.sun,
            s.illumination.sky,
        ),
        scene,
        (
            scene.classes.reflectance[:, chosen],
            scene.classes.transmittance[:, chosen],
            scene.ground[chosen],
            scene.illumination.sun[chosen],
            scene.illumination.sky[chosen],
        ),
    )


def many_bands(setting: Setting) -> Iterator[Row]:
    """Error of every band's image over its mean, solves made, CPU time of both ways."""
    side, bands, size = (2.0, 60, 20) if setting.quick else (5.0, BANDS, 25)
    scene = thirteen_species(side, bands)
    # The reduced light is not refined; neither is what it is compared with.
    few = margin_for(scene, Accuracy(refine=False))
    every = with_fields(few, solves=None)
    x = (jnp.arange(round(10 * side), dtype=jnp.float32) + 0.5) * 0.1
    rays = nadir_rays(x, x, 0.1, (side / 2, side / 2, 50.0))

    start = time.process_time()
    got = np.asarray(jax.jit(lambda s: render(solve_light(s, few), rays).total)(scene))
    seconds = time.process_time() - start

    separately = jax.jit(lambda part: render(solve_light(part, every), rays).total)
    start = time.process_time()
    parts = [separately(some_bands(scene, first, size)) for first in range(0, bands, size)]
    want = np.concatenate([np.asarray(part) for part in parts])
    spent = time.process_time() - start

    mean = want.mean(axis=(1, 2))
    pixels = np.abs(got - want).max(axis=(1, 2)) / mean
    means = np.abs(got.mean(axis=(1, 2)) / mean - 1)
    yield Row(f"{bands} bands", "band's mean, worst band", 100 * float(means.max()), 0.1)
    yield Row(f"{bands} bands", "worst pixel over its band's mean", 100 * float(pixels.max()), 0.1)
    yield Row(f"{bands} bands", "solves", float(few.solves or bands), 25.0, unit="")
    yield Row(
        f"{bands} bands", "CPU s, compilation too", seconds, None, spent, "s",
        "beside it: a solve for each band",
    )  # fmt: skip

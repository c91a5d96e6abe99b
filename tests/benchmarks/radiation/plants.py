"""Plants of the example plot: their own area elements as discs, by a path tracer, and in voxels."""

import dataclasses
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from fynjax.assembly import build_plot
from fynjax.canopy import VoxelGrid, unit_shapes
from fynjax.io.plot import example_folder, read_plot
from fynjax.radiation import parallel_rays, reflectance_factor, solve_light
from fynjax.scene import PlotParameters, Scene
from fynjax.sensors import BandSet, shipped_sensor
from tests.benchmarks.radiation.mesh import interpreter, path_traced
from tests.benchmarks.radiation.report import Row, Setting
from tests.radiation.scenes import towards

SIDE, PIXEL = 3.0, 0.025
STRUCTURE = 0.025
BANDS = ("green", "red", "NIR")
VOXELS = ((0.1, "even"), (0.1, "structure"), (0.05, "structure"), (0.025, "structure"))


def plot(structure: float = STRUCTURE) -> tuple[Scene, PlotParameters, BandSet]:
    """The shipped plot, smaller, with its plants resolved to `structure` [m]."""
    whole = read_plot(example_folder() / "plot.toml")
    small = dataclasses.replace(whole, size_m=(SIDE, SIDE), voxel_m=0.1, structure_m=structure)
    scene, parameters = build_plot(small)
    bands = shipped_sensor("mavic_3m").bands
    return scene, parameters, bands.select([0, 1, 3])


def on_voxels(scene: Scene, voxel: float, kind: str) -> Scene:
    """The same plants on voxels of `voxel` [m]."""
    times = round(scene.grid.horizontal_size / voxel)
    nx, ny, nz = (n * times for n in scene.grid.shape)
    finer = 0 if kind == "even" else round(voxel / STRUCTURE)
    return dataclasses.replace(scene, grid=VoxelGrid((nx, ny, nz), voxel, voxel), finer=finer)


def discs(scene: Scene, parameters: PlotParameters, bands: BandSet, leaves: int) -> dict[str, Any]:
    """The area elements as discs: the arrays that `mesh_peer` takes.

    An element is one disc, or as many as `leaves`, anywhere in the box of its tuft.
    """
    planting = scene.planting
    crowns, standing = scene.visible_crowns(parameters), scene.standing(parameters)
    elements = scene._elements(parameters, planting, crowns, standing)
    position, area = (np.asarray(a, float) for a in elements)
    normal = np.asarray(planting.shapes.normal)[np.asarray(planting.part)][:, None]
    plant = np.asarray(planting.plant)
    azimuth, tilt = (np.asarray(a)[plant] for a in (planting.azimuth, planting.tilt))
    level, up = (part[:, 0] for part in unit_shapes(normal, azimuth, tilt))
    voxels = scene.voxels(parameters, bands)
    kind = np.asarray(planting.optical_class)
    rho, tau = (
        np.asarray(a)[kind] for a in (voxels.classes.reflectance, voxels.classes.transmittance)
    )
    there = area > 1e-9
    light = voxels.illumination
    each = np.repeat(np.flatnonzero(there), leaves)
    rng = np.random.default_rng(0)
    apart = scene.tuft * (rng.random((len(each), 3)) - 0.5) * (leaves > 1)
    return {
        "centre": position[each] + apart,
        "normal": (level + up)[each],
        "diameter": np.sqrt(4.0 / np.pi * area[each] / leaves),
        "rho": rho[each],
        "tau": tau[each],
        "ground": np.asarray(voxels.ground).reshape(len(BANDS), -1).mean(axis=1),
        "side": SIDE,
        "copies": 2,
        "pixels": round(SIDE / PIXEL),
        "sun": towards(float(light.sun_zenith), float(light.sun_azimuth)),
        "direct": np.asarray(light.sun),
        "sky": np.asarray(light.sky),
        "views": np.array([[0.0, 0.0, 1.0]]),
    }


def image(scene: Scene, parameters: PlotParameters, bands: BandSet) -> tuple[np.ndarray, float]:
    """Image [band, y, x] from straight above, and CPU seconds after compilation."""
    x = (jnp.arange(round(SIDE / PIXEL), dtype=jnp.float32) + 0.5) * PIXEL
    rays = parallel_rays(x, x, PIXEL, jnp.float32(0.0), jnp.float32(0.0))

    @eqx.filter_jit
    def run(scene: Scene, parameters: PlotParameters) -> jax.Array:
        return reflectance_factor(solve_light(scene.voxels(parameters, bands)), rays)

    jax.block_until_ready(run(scene, parameters))
    start = time.process_time()
    return np.asarray(run(scene, parameters)), time.process_time() - start


def indices(image: np.ndarray) -> dict[str, np.ndarray]:
    """NDVI and GNDVI of an image [band, y, x]."""
    green, red, nir = image
    return {"NDVI": (nir - red) / (nir + red), "GNDVI": (nir - green) / (nir + green)}


def figures_of(halves: np.ndarray, ours: np.ndarray) -> dict[str, float]:
    """How an image [band, y, x] differs from the path tracer's two [half, band, y, x]: band means
    and spreads [%], means and spreads of indices, and the mean distance of their quantiles."""
    whole = halves.mean(axis=0)
    figures: dict[str, float] = {}

    def spread(pair: np.ndarray, both: np.ndarray) -> float:
        noise = np.var(pair[0] - pair[1]) / 4.0  # of the mean of two halves
        return float(np.sqrt(max(np.var(both) - noise, 0.0)))

    for i, name in enumerate(BANDS):
        figures[f"{name} mean"] = 100 * (ours[i].mean() / whole[i].mean() - 1)
        figures[f"{name} sd"] = 100 * (ours[i].std() / spread(halves[:, i], whole[i]) - 1)
    pairs = [indices(half) for half in halves]
    for name, values in indices(ours).items():
        both = indices(whole)[name]
        pair = np.stack([one[name] for one in pairs])
        figures[f"{name} mean"] = 100 * (values.mean() / both.mean() - 1)
        figures[f"{name} sd"] = 100 * (values.std() / spread(pair, both) - 1)
        apart = np.abs(np.sort(values.ravel()) - np.sort(both.ravel())).mean()
        figures[f"{name} quantiles apart"] = 100 * apart / both.std()
    return figures


def plants(setting: Setting) -> Iterator[Row]:
    """Discs and tufts of discs by a path tracer, and the same elements in voxels."""
    python = interpreter()
    if python is None:
        raise FileNotFoundError("no Python with Mitsuba; name one in FYNJAX_MITSUBA_PYTHON")
    scene, parameters, bands = plot()
    images: dict[str, np.ndarray] = {}
    ours: dict[str, np.ndarray] = {}
    for voxel, kind in VOXELS:
        name = f"{100 * voxel:g} cm, {kind}"
        ours[name], seconds = image(on_voxels(scene, voxel, kind), parameters, bands)
        yield Row(f"plants, {name}", "time", seconds, unit="CPU s")
    for form, leaves in (("discs", 1), ("tufts", 8)):
        arrays = discs(scene, parameters, bands, leaves)
        peer = path_traced(python, 64 if setting.quick else 512, **arrays)
        halves = peer["nadir"].transpose(0, 3, 1, 2)
        images[f"path tracer, {form}"] = halves.mean(axis=0)
        yield Row(f"path tracer, {form}", "time", float(peer["cpu_s"]), unit="CPU s")
        for name, one in ours.items():
            for figure, value in figures_of(halves, one).items():
                yield Row(f"{form}, {name}", figure, value)
    if setting.plots is not None:
        shown = [name for name in ours if not name.startswith("5 ")]
        draw(images | {name: ours[name] for name in shown}, setting.plots / "plants.png")


def draw(images: dict[str, np.ndarray], path: Path) -> None:
    """The images in false colour (near infrared, red, green) and the distribution of NDVI."""
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(2, 3, figsize=(15, 10), layout="constrained")
    top = np.percentile(next(iter(images.values())), 99, axis=(1, 2))[[2, 1, 0]]
    for axis, (name, image) in zip(axes.flat, images.items(), strict=False):
        shown = (image[[2, 1, 0]].transpose(1, 2, 0) / top).clip(0, 1) ** 0.6
        axis.imshow(shown, origin="lower", extent=(0, SIDE, 0, SIDE), interpolation="nearest")
        axis.set(title=name, xlabel="x [m]", ylabel="y [m]")
        axes.flat[-1].hist(
            indices(image)["NDVI"].ravel(), bins=80, range=(0, 1), histtype="step", label=name
        )
    axes.flat[-1].set(xlabel="NDVI", ylabel="pixels")
    axes.flat[-1].legend(fontsize=7)
    figure.savefig(path, dpi=100)
    plt.close(figure)

"""Light against what is known, and what an image costs:
`python -m tests.benchmarks.table_radiation`.

    ball          light that a ball stops, against the formula; even voxels and finer structure
    het01         RAMI's floating spheres in the red, even voxels and finer structure
    plants        plants of the example plot, their elements as discs by a path tracer
    example-plot  image of the example plot, and value and gradient by all its parameters

Other comparisons are tests: `tests/radiation/test_reference_scenes.py` (a path tracer's image of
turbid shrubs) and those beside it. `plants` needs Mitsuba 3 in the running interpreter or in that
named by `FYNJAX_MITSUBA_PYTHON`.
"""

import dataclasses
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from fynjax.app.assembly import aim_without_air, build_plot
from fynjax.canopy import VoxelGrid, unit_shapes
from fynjax.radiation import Accuracy, VoxelScene, parallel_rays, reflectance_factor, solve_light
from fynjax.scene import PlotParameters, Scene
from fynjax.sensors import BandSet, shipped_sensor
from tests.benchmarks._measure import compiled, data_folder, example_plot, options, seconds
from tests.radiation.scenes import (
    fluxes_of,
    reflectance_of,
    slab,
    solver,
    towards,
    views_of_reference,
    with_shape,
)
from tests.radiation.test_reference_scenes import floating_spheres

Rows = Iterator[tuple[str, float, str]]
"""Figure, its value and unit."""
SIDE, PIXEL, STRUCTURE = 3.0, 0.025, 0.025
"""Of the plot of `plants`: side, pixel and finest voxel [m]."""
BANDS = ("green", "red", "NIR")


def ball(tiny: bool) -> Rows:
    """Ten voxels a radius; mean gap of a ball of depth t: 2 [1 - (1 + t) exp(-t)] / t^2."""
    radius = 5 if tiny else 10
    columns = 2 * radius + 4
    made = slab(1.0, [(0.0, 0.0, 1.0)], 0.0, layers=columns, columns=columns)  # sun overhead
    made = VoxelScene(made.area_density, made.classes, made.ground, made.illumination, 0.1, 0.1)
    for finer in (4,) if tiny else (0, 4):
        parts = max(4, 2 * finer)
        x = (np.arange(columns * parts) + 0.5) / parts - columns / 2
        inside = (x[:, None, None] ** 2 + x[:, None] ** 2 + x**2) < radius**2
        for density in (4.0,) if tiny else (4.0, 16.0):
            scene = with_shape(made, inside, finer, density * 10 / radius)
            light = solver(Accuracy(lattice=2, sublayers=2))(scene)
            got = 1 - float(fluxes_of(light).transmitted_direct[0])
            gap = 2 * (1 - (1 + density) * np.exp(-density)) / density**2
            off = 100 * (got / ((1 - gap) * np.pi * (radius / columns) ** 2) - 1)
            yield f"depth {density:g}, {'structure' if finer else 'even'}: light stopped", off, "%"


def het01(tiny: bool) -> Rows:
    """Fluxes, and the view that is farthest off beyond two standard errors."""
    with open(data_folder() / "rt" / "het01_turbid.json", encoding="utf-8") as file:
        case = json.load(file)["cases"][2]
    want, voxel = case["result"], 5.0 if tiny else 1.0
    accuracy = Accuracy() if tiny else Accuracy(sublayers=2, levels=4, azimuths=8)
    for finer in (0,) if tiny else (0, 4):
        light = solver(accuracy)(floating_spheres(case, voxel, finer))
        flux, form = fluxes_of(light), "structure" if finer else "even"
        pairs = (("transmission_direct", flux.transmitted_direct), ("albedo", flux.albedo))
        for name, got in pairs:
            yield f"{form}: {name.replace('_', ' ')}", 100 * (float(got[0]) / want[name] - 1), "%"
        views = views_of_reference(np.array(case["views"], float))
        brf = np.asarray(reflectance_of(light, *views))[:, 0]
        off = np.abs(brf / want["brf"] - 1) - 2 * np.array(want["brf_se"]) / want["brf"]
        yield f"{form}: farthest of {len(off)} views", 100 * max(float(off.max()), 0.0), "%"


def image_and_slopes(tiny: bool) -> Rows:
    """From plants to pixels of 2.5 cm in four bands, with structure; value and gradient of the mean
    square by all parameters."""
    for side, voxel in ((1.0, 0.1),) if tiny else ((10.0, 0.1), (10.0, 0.05), (20.0, 0.1)):
        plot = example_plot(side, tiny, voxel_m=voxel)
        scene, parameters = build_plot(plot)
        aimed = aim_without_air(plot, scene, parameters, shipped_sensor("mavic_3m"))

        def observed(parameters: Any, aimed: Any, scene: Any) -> jax.Array:
            return aimed.observe(scene, parameters).reflectance

        def slopes(parameters: Any, *rest: Any) -> Any:
            return jax.value_and_grad(lambda p: jnp.mean(observed(p, *rest) ** 2))(parameters)

        what, image = f"{side:g} m, voxels of {100 * voxel:g} cm", np.nan
        for name, function in (("image", observed), ("value and gradient", slopes)):
            _, compiling, spent, memory = compiled(function, parameters, aimed, scene)
            yield f"{what}, {name}: compilation", compiling, "CPU s"
            yield f"{what}, {name}: time", spent, "CPU s"
            yield f"{what}, {name}: memory", memory, "GiB"
            if name == "image":
                image = spent
        yield f"{what}, value and gradient over image", spent / image, ""


def interpreter() -> str:
    """A Python that can import Mitsuba."""
    named = os.environ.get("FYNJAX_MITSUBA_PYTHON")
    if named:
        return named
    if subprocess.run([sys.executable, "-c", "import mitsuba"], capture_output=True).returncode:
        raise FileNotFoundError("no Python with Mitsuba; name one in FYNJAX_MITSUBA_PYTHON")
    return sys.executable


def path_traced(samples: int, **scene_of_discs: Any) -> dict[str, np.ndarray]:
    """What `_mesh_peer` makes of a scene of discs: its arrays stand there."""
    with tempfile.TemporaryDirectory() as folder:
        scene, images = Path(folder) / "scene.npz", Path(folder) / "images.npz"
        np.savez(scene, **scene_of_discs)
        peer = Path(__file__).with_name("_mesh_peer.py")
        command = [interpreter(), str(peer), str(scene), str(images), "--samples", str(samples)]
        subprocess.run(command, check=True)
        with np.load(images) as file:
            return dict(file)


def discs(scene: Scene, parameters: PlotParameters, bands: BandSet, leaves: int) -> dict[str, Any]:
    """The area elements as discs: the arrays that `_mesh_peer` takes.

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
    light = voxels.illumination
    each = np.repeat(np.flatnonzero(area > 1e-9), leaves)
    rng = np.random.default_rng(0)
    apart = scene.tuft * (rng.random((len(each), 3)) - 0.5) * (leaves > 1)
    return {
        "centre": position[each] + apart,
        "normal": (level + up)[each],
        "diameter": np.sqrt(4.0 / np.pi * area[each] / leaves),
        "rho": rho[each],
        "tau": tau[each],
        "ground": np.asarray(voxels.ground).reshape(len(BANDS), -1).mean(axis=1),
        "side": scene.grid.extent[0],
        "copies": 2,
        "pixels": round(scene.grid.extent[0] / PIXEL),
        "sun": towards(float(light.sun_zenith), float(light.sun_azimuth)),
        "direct": np.asarray(light.sun),
        "sky": np.asarray(light.sky),
        "views": np.array([[0.0, 0.0, 1.0]]),
    }


def from_above(scene: Scene, parameters: PlotParameters, bands: BandSet) -> tuple[Any, float]:
    """Image [band, y, x] from straight above, and CPU seconds after compilation."""
    x = (jnp.arange(round(scene.grid.extent[0] / PIXEL), dtype=jnp.float32) + 0.5) * PIXEL
    rays = parallel_rays(x, x, PIXEL, jnp.float32(0.0), jnp.float32(0.0))

    @eqx.filter_jit
    def run(scene: Scene, parameters: PlotParameters) -> jax.Array:
        return reflectance_factor(solve_light(scene.voxels(parameters, bands)), rays)

    image, _, spent = seconds(lambda: run(scene, parameters), 1)
    return np.asarray(image), spent


def apart(halves: np.ndarray, ours: np.ndarray) -> Iterator[tuple[str, float]]:
    """By how much means and spreads of bands and NDVI of an image [band, y, x] differ from those of
    the path tracer's two [half, band, y, x], whose noise is taken off [%]."""

    def layers(image: np.ndarray) -> np.ndarray:
        return np.stack([*image, (image[2] - image[1]) / (image[2] + image[1])])

    whole, pair = layers(halves.mean(axis=0)), [layers(half) for half in halves]
    for name, own, both, noise in zip((*BANDS, "NDVI"), layers(ours), whole, pair[0] - pair[1]):
        yield f"{name} mean", 100 * (own.mean() / both.mean() - 1)
        spread = np.sqrt(max(both.var() - noise.var() / 4.0, 0.0))  # of the mean of two halves
        yield f"{name} sd", 100 * (own.std() / spread - 1)


def plants(tiny: bool) -> Rows:
    """Voxels evenly filled and with structure, against discs and tufts of discs."""
    interpreter()  # nothing to do without
    scene, parameters = build_plot(
        example_plot(1.0 if tiny else SIDE, tiny, voxel_m=0.1, structure_m=STRUCTURE)
    )
    bands = shipped_sensor("mavic_3m").bands.select([0, 1, 3])
    ours = {}
    voxels = ((0.1, "even"), (0.1, "structure"), (0.05, "structure"), (0.025, "structure"))
    for voxel, kind in voxels[: 1 if tiny else None]:
        times = round(scene.grid.horizontal_size / voxel)
        nx, ny, nz = (n * times for n in scene.grid.shape)
        finer = 0 if kind == "even" else round(voxel / STRUCTURE)
        grid = VoxelGrid((nx, ny, nz), voxel, voxel)
        on_voxels = dataclasses.replace(scene, grid=grid, finer=finer)
        name = f"{100 * voxel:g} cm, {kind}"
        ours[name], spent = from_above(on_voxels, parameters, bands)
        yield f"{name}: time", spent, "CPU s"
    for form, leaves in (("discs", 1), ("tufts", 8)):
        peer = path_traced(8 if tiny else 512, **discs(scene, parameters, bands, leaves))
        halves = peer["nadir"].transpose(0, 3, 1, 2)
        yield f"path tracer, {form}: time", float(peer["cpu_s"]), "CPU s"
        for name, image in ours.items():
            for figure, off in apart(halves, image):
                yield f"{name} over {form}: {figure}", off, "%"


TABLES = {"ball": ball, "het01": het01, "plants": plants, "example-plot": image_and_slopes}


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the tables; what lacks its reference or peer is left out, and said so."""
    parser = options(__doc__)
    parser.add_argument("--only", nargs="+", choices=TABLES, default=list(TABLES))
    given = parser.parse_args(arguments)
    for name in given.only:
        start = time.process_time()
        try:
            for figure, value, unit in TABLES[name](given.tiny):
                print(f"{name:14s}{figure:56s}{value:10.3g} {unit}", flush=True)
        except FileNotFoundError as missing:
            print(f"{name}: left out, {missing}", flush=True)
        print(f"{name}: {time.process_time() - start:.0f} CPU s", flush=True)


if __name__ == "__main__":
    main()

"""How errors fall with each way of resolving the light finer; plotted where asked."""

import json
from collections.abc import Callable, Iterator
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

from fynjax.radiation import Accuracy, VoxelScene, directional_reflectance, solve_light
from tests.benchmarks.radiation.head_to_head import BANDS, curve, path_traced
from tests.benchmarks.radiation.references import het01_figures, slab_figures
from tests.benchmarks.radiation.report import Row, Setting
from tests.radiation.test_reference_scenes import shrubs

Curve = list[tuple[float, float]]


def against_voxel(setting: Setting) -> dict[str, Curve]:
    """Crowns of 10 m radius: largest BRF error, by the voxels along a radius."""
    sizes = (5.0, 2.5, 1.25, 1.0) + (() if setting.quick else (0.5,))
    found: dict[str, Curve] = {}
    for case, name in zip(setting.cases("het01_turbid.json"), ("NIR", "lossless", "red")):
        accuracy = Accuracy(levels=4, azimuths=8, coarsening=(1, 1))
        found[name] = [
            # 30 m and 100 m are whole numbers of each of these, and of twice 0.5 m.
            (10.0 / size, het01_figures(
                [case], accuracy if size > 1 else Accuracy(levels=4, azimuths=8), size
            )["BRF"])
            for size in sizes
        ]  # fmt: skip
    return found


def against_ordinates(setting: Setting) -> dict[str, Curve]:
    """Slabs: largest BRF error by zenith angles per hemisphere."""
    cases = setting.cases("slab_uniform_turbid.json")[:: 3 if setting.quick else 1]
    return {
        f"{layers} layers": [
            (levels, slab_figures(
                cases, Accuracy(coarsening=(1, 2), levels=levels, azimuths=4), layers
            )["BRF"])
            for levels in (1, 2, 3, 4, 6, 8)
        ]
        for layers in (10, 20, 40)
    }  # fmt: skip


def against_itself(
    setting: Setting, change: Callable[[float], Accuracy], values: tuple[float, ...], best: Accuracy
) -> dict[str, Curve]:
    """Shrubs under sun and views aslant: largest difference to the finest, per zenith angle."""
    module, _ = path_traced(setting)
    scene = shrubs(module)
    periodic = VoxelScene(
        scene.area_density, scene.classes, scene.ground, scene.illumination, 0.1, 0.1
    )
    views = np.array([0.0, 30.0, 45.0, 60.0, 75.0])
    found: dict[str, Curve] = {}
    for sun in (30.0, 60.0, 83.0):
        light_from = jax.tree.map(lambda a: a, periodic)
        turned = type(scene.illumination)(
            jnp.float32(sun),
            *(getattr(scene.illumination, n) for n in ("sun_azimuth", "sun", "sky")),
        )
        at = VoxelScene(light_from.area_density, scene.classes, scene.ground, turned, 0.1, 0.1)

        def brf(accuracy: Accuracy, at: VoxelScene = at) -> np.ndarray:
            light = jax.jit(lambda s: solve_light(s, accuracy))(at)
            both = np.concatenate([views, views])
            turn = np.repeat([50.0, 140.0], len(views))
            return np.asarray(jax.jit(directional_reflectance)(light, both, turn))

        want = brf(best)
        off = [np.abs(brf(change(value)) / want - 1).max(axis=1) for value in values]
        for place, view in enumerate(views):
            pair = [100 * float(max(o[place], o[place + len(views)])) for o in off]
            found[f"sun {sun:g}, view {view:g}"] = list(zip(map(float, values), pair))
    return found


def studies(setting: Setting) -> dict[str, Callable[[], dict[str, Curve]]]:
    return {
        "voxels along a radius": lambda: against_voxel(setting),
        "zenith angles per hemisphere": lambda: against_ordinates(setting),
        "sub-layers": lambda: against_itself(
            setting,
            lambda value: Accuracy(lattice=1, sublayers=int(value)),
            (1, 2, 4),
            Accuracy(lattice=1, sublayers=8),
        ),
        "tolerance": lambda: against_itself(
            setting,
            lambda value: Accuracy(lattice=1, tolerance=value),
            (1e-1, 1e-2, 1e-3, 1e-4),
            Accuracy(lattice=1, tolerance=1e-6),
        ),
    }


def convergence(setting: Setting) -> Iterator[Row]:
    """One row per curve: the error at the finest step; the whole curve in its note."""
    for title, study in studies(setting).items():
        curves = study()
        for name, points in curves.items():
            text = ", ".join(f"{x:g}: {y:.3g}" for x, y in points)
            yield Row(f"by {title}", name, points[-1][1], note=text)
        draw(setting.plots, title, curves, title, "largest BRF error [%]")
    module, want = path_traced(setting)
    pixels = 100 if setting.quick else 200
    ladder = curve(shrubs(module), want, pixels)
    timed: dict[str, Curve] = {band: [] for band in BANDS}
    for settings, figures, seconds in ladder:
        for band in BANDS:
            timed[band].append((seconds, figures[f"RMSE {band}"]))
        text = ", ".join(f"{key} {value:.2f}" for key, value in figures.items())
        yield Row("error against time", settings, seconds, unit="CPU s", note=text)
    draw(setting.plots, "error against time", timed, "CPU time [s]", "RMSE at 10 cm [%]")


def draw(folder: Path | None, title: str, curves: dict[str, Curve], x: str, y: str) -> None:
    """A chart and its numbers."""
    if folder is None:
        return
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    folder.mkdir(parents=True, exist_ok=True)
    figure, axes = plt.subplots(figsize=(7, 4.5), layout="constrained")
    # More curves than colours: the second ten are dashed.
    axes.set_prop_cycle(plt.cycler(linestyle=["-", "--"]) * plt.rcParams["axes.prop_cycle"])
    for name, points in curves.items():
        axes.loglog(*zip(*[(a, max(b, 1e-4)) for a, b in points]), marker="o", label=name)
    axes.set(xlabel=x, ylabel=y, title=title)
    axes.grid(visible=True, which="both", alpha=0.3)
    axes.legend(fontsize="x-small", ncols=2)
    stem = folder / title.replace(" ", "_")
    figure.savefig(stem.with_suffix(".png"), dpi=150)
    plt.close(figure)
    stem.with_suffix(".json").write_text(json.dumps(curves, indent=1) + "\n")

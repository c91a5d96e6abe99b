"""Pictures of how well it agrees, for the pages of the documentation.

    python -m tests.benchmarks.pictures [--output docs/images]

`agreement.png`: RAMI's floating spheres in the red by all views beside the reference, and means of
an image of the example plot beside Mitsuba's, as `docs/validation.md` has them; `slopes.png`: the
slopes by number of `table_slopes` in `docs/model.md`; `feet.png`: slopes by places, as in
`docs/python.md`. Prints what is drawn.
"""

import json
import re
from collections.abc import Sequence
from pathlib import Path

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array

from fynjax.app.report.figures import save_figure
from fynjax.app.report.figures._style import AFTER, GREY, REAL, Figure, style
from fynjax.radiation import Accuracy
from fynjax.scene import Scene, observe
from tests.benchmarks._measure import data_folder, options
from tests.radiation.scenes import reflectance_of, solver, views_of_reference
from tests.radiation.test_reference_scenes import floating_spheres

DOCS = Path(__file__).parents[2] / "docs"
MITSUBA = {
    "leaves in tufts of 5 cm": r"path traced by Mitsuba 3 .*\| (.*?) %",
    "a leaf for each element": r"each area element as one leaf.*\| (.*?) %",
    "even voxels of 10 cm": r"each area element as one leaf.*\| .*?; (.*?) %",
}


def main(arguments: Sequence[str] | None = None) -> None:
    """Draw the pictures."""
    parser = options(__doc__)
    parser.add_argument("--output", type=Path, default=DOCS / "images")
    given = parser.parse_args(arguments)
    folder = Path() if given.tiny else given.output
    with style():
        figure = Figure(figsize=(5.0, 6.0))
        spheres, means = figure.subplots(2)
        _spheres(spheres, given.tiny)
        _means(means)
        save_figure(figure, folder / "agreement.png", dpi=110)
        figure = Figure(figsize=(5.0, 4.2))
        _slopes(figure.subplots())
        save_figure(figure, folder / "slopes.png", dpi=110)
        figure = Figure(figsize=(4.2, 4.4))
        _feet(figure.subplots())
        save_figure(figure, folder / "feet.png", dpi=110)


def _spheres(axes, tiny: bool) -> None:
    with open(data_folder() / "rt" / "het01_turbid.json", encoding="utf-8") as file:
        case = json.load(file)["cases"][2]
    views, want = np.array(case["views"], float), np.array(case["result"]["brf"])
    plane = views[:, 1] == 0
    axes.plot(views[plane, 0], want[plane], "o", color=REAL, label="reference, photons")
    for finer, line, label in ((0, "--", "even voxels of 1 m"), (4, "-", "structure of 25 cm")):
        accuracy = Accuracy() if tiny else Accuracy(sublayers=2, levels=4, azimuths=8)
        light = solver(accuracy)(floating_spheres(case, 5.0 if tiny else 1.0, finer))
        brf = np.asarray(reflectance_of(light, *views_of_reference(views)))[:, 0]
        print(label, *np.round(100 * (brf / want - 1), 2), "%")
        axes.plot(views[plane, 0], brf[plane], line, color=AFTER, label=label)
    axes.set(title="Floating spheres (RAMI), sun at 50°, red", ylabel="Reflectance factor [-]",
             xlabel="Zenith angle of the view [°], the sun's plane", ylim=(0.0, None))  # fmt: skip
    axes.legend(fontsize=8)


def _means(axes) -> None:
    text = (DOCS / "validation.md").read_text("utf-8")
    names = ("green", "red", "near infrared", "NDVI")
    for k, (label, pattern) in enumerate(MITSUBA.items()):
        off = _numbers(re.search(pattern, text)[1])[:4]
        print(label, *off, "%")
        axes.bar(np.arange(4) + 0.27 * (k - 1), off, 0.25, label=label,
                 color=(AFTER, REAL, GREY)[k])  # fmt: skip
    axes.axhline(0.0, color="#444444", lw=0.7)
    axes.set_xticks(np.arange(4), names)
    axes.set(title="Means of an image, against Mitsuba 3", ylabel="Difference [%]")
    axes.legend(fontsize=8)


def _slopes(axes) -> None:
    text = (DOCS / "model.md").read_text("utf-8")
    rows = re.search(r"\| plants \| .*?\n\n", text, re.S)
    table = np.array([_numbers(row) for row in rows[0].strip().splitlines()[2:]])
    print(table)
    plants, before, after, error = table.T
    axes.axhline(1.0, color=GREY, lw=0.8, zorder=0)
    axes.plot(plants, before, "o-", color=GREY, mfc="none", lw=0.8, label="before")
    axes.errorbar(plants, after, 2.0 * error, fmt="o-", color=AFTER, lw=0.8, label="now")
    axes.set_xscale("log")
    ticks = (0.5, 1, 2, 3, 5, 10, 20, 30)
    axes.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
    axes.set_xticks([], minor=True)
    axes.set(title="Slope of the gap by the number of plants",
             xlabel="Plants of the species", ylabel="Over what one plant more makes")  # fmt: skip
    axes.legend(fontsize=8)


def _feet(axes) -> None:
    """The plot of `docs/python.md` in the near infrared, and slopes by the feet of its plants."""
    taxa = ("a", "rounded_shrub", 40, 30, 0.6), ("b", "tussock", 30, 15, 0.5)
    columns = "taxon", "growth_form", "mean_diameter_cm", "cover_percent", "height_max_m"
    scene = Scene.from_table([dict(zip(columns, row)) for row in taxa], size=2.0, seed=1)

    def bright(foot: Array) -> tuple[Array, Array]:
        moved = eqx.tree_at(lambda s: s.planting.foot, scene, foot)
        image = observe(moved, "mavic_3m", pixel=0.02)["nir"]
        return image.mean(), image

    foot = scene.planting.foot
    slope, image = eqx.filter_jit(jax.grad(bright, has_aux=True))(foot)
    standing = np.asarray(scene.standing(scene.parameters)) > 0.0
    axes.imshow(image, origin="lower", extent=(0, 2, 0, 2), cmap="gray")
    arrows = np.asarray(slope)[standing]
    arrows = 0.25 * arrows / np.hypot(*arrows.T).max()
    axes.quiver(*np.asarray(foot)[standing].T, *arrows.T, color=AFTER, angles="xy",
                scale_units="xy", scale=1.0, width=0.008)  # fmt: skip
    axes.set(title="Which way each plant would move\nto brighten the near infrared",
             xlabel="East [m]", ylabel="North [m]")  # fmt: skip


def _numbers(text: str) -> list[float]:
    return [float(n) for n in re.findall(r"[-+]?\d+\.\d+", text.replace("−", "-"))]


if __name__ == "__main__":
    main()

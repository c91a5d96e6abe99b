"""Pictures of how well it agrees, for the pages of the documentation.

    python -m tests.benchmarks.pictures [--output docs/images]

`agreement.png`: RAMI's floating spheres in the red by all views beside the reference, and means of
an image of the example plot beside Mitsuba's, as `docs/validation.md` has them; `slopes.png`: the
table of `table_slopes` in `docs/model.md`. Prints what is drawn.
"""

import json
import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from fynjax.radiation import Accuracy
from fynjax.report.figures import save_figure
from fynjax.report.figures._style import AFTER, GREY, REAL, Figure, style
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
    rows = re.search(r"\| \| by cover [^\n]* by height \|\n.*?\n\n", text, re.S)
    table = rows[0].strip().splitlines()
    kinds = [cell.strip() for cell in table[0].split("|")[2:-1]]
    for mark, row in zip("os^D", table[2:], strict=True):
        name, *cells = (cell.strip() for cell in row.split("|")[1:-1])
        pairs = np.array([_numbers(cell)[:2] for cell in cells])
        print(name, *pairs.ravel())
        axes.plot(*pairs.T, mark, color=AFTER, mfc="none", label=name)
        if name == "NDVI, mean":
            for pair, kind in zip(pairs, kinds, strict=True):
                axes.annotate(kind, pair, (6, -9), textcoords="offset points", fontsize=8)
    axes.axline((0.0, 0.0), slope=1.0, color=GREY, lw=0.8, zorder=0)
    axes.set(title="Slopes of an image by the logarithm of a factor",
             xlabel="Difference of means over plantings",
             ylabel="Mean of the slopes that are taken")  # fmt: skip
    axes.legend(fontsize=8)


def _numbers(text: str) -> list[float]:
    return [float(n) for n in re.findall(r"[-+]?\d+\.\d+", text.replace("−", "-"))]


if __name__ == "__main__":
    main()

"""Recipe of `docs/images/form_*.png`: growth forms from the side and from above, meshes in light.

Run `python -m tools.make_form_pictures`. Plants are of the form's usual size; the bar is 10 cm, or
1 m of what is larger than 1.5 m.
"""

import io
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from PIL import Image

from fynjax.canopy import FORMS, PlantMesh, generate_plant

FOLDER = Path(__file__).parents[1] / "docs/images"
COLOURS = {"leaf": (0.32, 0.50, 0.20), "wood": (0.42, 0.31, 0.22), "flower": (0.80, 0.47, 0.65)}
SUN = np.array([0.4, -0.5, 0.77])


def draw(axes: Axes, mesh: PlantMesh, up: int, depth: int, towards: float) -> None:
    """Triangles seen along an axis, the nearest last, lit by the sun."""
    corners = mesh.triangles
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal = across / np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-30)
    height = corners[:, :, 2].mean(axis=1) / mesh.vertices[:, 2].max()
    light = (0.45 + 0.55 * np.abs(normal @ SUN)) * (0.55 + 0.45 * height)
    colours = np.array([COLOURS[name] for name in mesh.materials])[mesh.material]
    order = np.argsort(towards * corners[:, :, depth].mean(axis=1), kind="stable")
    axes.add_collection(
        PolyCollection(
            list(corners[order][:, :, [0, up]]), facecolors=(colours * light[:, None])[order],
            edgecolors="face", linewidths=0.15,
        )
    )  # fmt: skip
    axes.autoscale_view()
    axes.set(aspect="equal")
    axes.set_axis_off()


def picture(form: str) -> None:
    """Write the picture of a form."""
    made = generate_plant(form, seed=3, max_triangles=60_000)
    figure, (side, above) = plt.subplots(1, 2, figsize=(6.0, 2.9), layout="constrained")
    draw(side, made.mesh, 2, 1, -1.0)
    draw(above, made.mesh, 1, 2, 1.0)
    low, high = made.mesh.vertices.min(axis=0), made.mesh.vertices.max(axis=0)
    side.axhline(0.0, color="#9a8b73", lw=1.0, zorder=-1)
    bar = 1.0 if (high - low).max() > 1.5 else 0.1
    margin = 0.06 * (high - low).max()
    for axes, foot in ((side, -margin), (above, low[1] - margin)):
        left = 0.5 * (low[0] + high[0]) - 0.5 * bar
        axes.plot([left, left + bar], [foot, foot], color="black", lw=2.0)
        words = "1 m" if bar == 1.0 else "10 cm"
        axes.text(left + 0.5 * bar, foot - 0.4 * margin, words, ha="center", va="top", fontsize=8)
    drawn = io.BytesIO()
    figure.savefig(drawn, dpi=80)
    plt.close(figure)
    few = Image.open(drawn).convert("RGB").quantize(12, dither=Image.Dither.NONE)
    few.save(FOLDER / f"form_{form}.png", optimize=True)


if __name__ == "__main__":
    for name in FORMS:
        picture(name)

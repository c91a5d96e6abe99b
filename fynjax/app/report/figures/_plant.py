"""A plant's area elements as a picture."""

from typing import Any

import matplotlib.collections
import numpy as np
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator

from fynjax.app.report.figures._style import Figure, style
from fynjax.canopy import MeshPlant, Organ

_COLOURS = {Organ.LEAF: "#3F7D2B", Organ.WOOD: "#6B4A2F", Organ.FLOWER: "#CC79A7"}
_MOST_DRAWN = 20_000
_THINNEST = 0.12
"""Least width of a disc in the picture over its length, so that an edge-on disc is visible [-]."""
_SLENDER = 0.16
"""Least half of the width shown, as a share of the height."""


@style()
def plant_figure(model: MeshPlant) -> Figure:
    """The elements from the south and from above, as discs of their area and tilt.

    **Arguments:** `model`, the plant. Of very many elements a sample is drawn, with more area each.
    """
    step = max(1, -(-len(model.area) // _MOST_DRAWN))
    place = np.asarray(model.position)[::step]
    normal = np.asarray(model.plant.normal)[::step]
    organ = np.asarray(model.plant.organ)[::step]
    length = np.sqrt(4.0 / np.pi * step * np.asarray(model.area)[::step])
    views = (
        ("From the south", 0, 2, 1, -1.0, "East [m]", "Height [m]"),
        ("From above", 0, 1, 2, 1.0, "East [m]", "North [m]"),
    )
    figure = Figure(figsize=(9.0, 4.8))
    for axes, view in zip(figure.subplots(1, 2), views):
        title, right, up, depth, towards, xlabel, ylabel = view
        order = np.argsort(towards * place[:, depth], kind="stable")  # the nearest last
        facing = np.maximum(np.abs(normal[:, depth]), _THINNEST)
        turn = np.degrees(np.arctan2(normal[:, up], normal[:, right])) + 90.0
        colours = np.array([_COLOURS[kind] for kind in Organ])[organ]
        discs: Any = matplotlib.collections.EllipseCollection(
            length[order],
            (length * facing)[order],
            turn[order],
            units="xy",
            offsets=place[order][:, [right, up]],
            offset_transform=axes.transData,
            facecolors=list(colours[order]),
            edgecolors="face",
            linewidths=0.3,  # the smallest stay visible
            alpha=0.8,
        )
        axes.add_collection(discs)
        axes.set(title=title, xlabel=xlabel, ylabel=ylabel, aspect="equal")
        low, high = place[:, [right, up]].min(axis=0), place[:, [right, up]].max(axis=0)
        margin = 0.5 * length.max() + 0.03 * (high - low).max()
        # A slender plant has room for the numbers below it.
        half = max(0.5 * (high[0] - low[0]) + margin, _SLENDER * (high[1] - low[1]))
        axes.set_xlim(0.5 * (low[0] + high[0]) - half, 0.5 * (low[0] + high[0]) + half)
        axes.set_ylim(low[1] - margin, high[1] + margin)
        axes.grid()
        axes.xaxis.set_major_locator(
            MaxNLocator(2 if high[1] - low[1] > 2.0 * (high[0] - low[0]) else 6)
        )
    handles = [
        Patch(color=_COLOURS[kind], label=f"{kind.name.lower()} {model.organ_area[kind]:.3g} m2")
        for kind in Organ
        if model.organ_area[kind] > 0.0
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=3)
    return figure

"""Figures of a comparison of two drone images, after figures 9 and 10 of the fynbos scene paper."""

import numpy as np
import pandas as pd
from jaxtyping import Float
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from fynjax.app.report.figures._style import AFTER, REAL, Figure, note, panel_grid, style, words

SAMPLES = (("real", REAL), ("simulated", AFTER))
"""The two sides of a comparison, and their colours."""


@style()
def band_box_plot(bands: pd.DataFrame) -> Figure:
    """Reflectance of each band as boxes, and the relative difference of the means (figure 9).

    **Arguments:** `bands`, the band table of a drone comparison: columns `band`,
    `real_p5` ... `simulated_p95`, `real_mean`, `simulated_mean`, `difference_percent`.
    """
    figure = Figure(figsize=(8.6, 3.4))
    left, right = figure.subplots(1, 2, width_ratios=(1.5, 1))
    place = np.arange(len(bands), dtype=float)
    handles = []
    for shift, (side, colour) in zip((-0.19, 0.19), SAMPLES, strict=True):
        boxes = [
            {
                "whislo": row[f"{side}_p5"],
                "q1": row[f"{side}_p25"],
                "med": row[f"{side}_p50"],
                "q3": row[f"{side}_p75"],
                "whishi": row[f"{side}_p95"],
                "mean": row[f"{side}_mean"],
            }
            for row in bands.to_dict("records")
        ]
        line = {"color": colour, "lw": 1.0}
        left.bxp(
            boxes,
            positions=place + shift,
            widths=0.32,
            showfliers=False,
            showmeans=True,
            patch_artist=True,
            boxprops={"facecolor": colour, "alpha": 0.3, "edgecolor": colour},
            whiskerprops=line,
            capprops=line,
            medianprops={"color": colour, "lw": 1.8},
            meanprops={"marker": "D", "ms": 4, "mfc": "white", "mec": colour},
            manage_ticks=False,
        )
        handles.append(Patch(color=colour, alpha=0.5, label=side))
    left.set_xticks(place, [words(band) for band in bands["band"]])
    left.set(title="Pixels of each band", ylabel="Reflectance [-]")
    left.set_ylim(bottom=min(0.0, left.get_ylim()[0]))
    left.grid(axis="y")
    left.legend(handles=handles, loc="upper left")
    difference_bars(right, [words(b) for b in bands["band"]], bands["difference_percent"])
    right.set_title("Means")
    note(figure, "Box: quartiles; line: median; diamond: mean; whiskers: 5th and 95th percentile.")
    return figure


def difference_bars(axes: Axes, labels: list[str], percent: pd.Series) -> None:
    """Bars of (simulated - real) / |real| [%]."""
    values = np.asarray(percent, float)
    place = np.arange(len(labels), dtype=float)
    most = min(1.2 * float(np.abs(values[np.isfinite(values)]).max(initial=1.0)), 150.0)
    axes.bar(place, np.clip(values, -most, most), width=0.62, color=AFTER)
    for x, value in zip(place, values, strict=True):
        if not np.isfinite(value):
            axes.text(x, 0, "–", ha="center", va="bottom", fontsize=8)
            continue
        inside = float(np.clip(value, -0.9 * most, 0.9 * most))
        axes.annotate(
            f"{value:+.0f}".replace("-", "−"),
            (x, inside),
            (0, 3 if value >= 0 else -3),
            textcoords="offset points",
            ha="center",
            va="bottom" if value >= 0 else "top",
            fontsize=7.5,
        )
    axes.axhline(0.0, color="#444444", lw=0.7)
    axes.set_xticks(place, labels)
    axes.set(ylim=(-most, most), ylabel="(simulated − real) / real [%]")
    axes.grid(axis="y")


@style()
def index_pair_histograms(
    indices: pd.DataFrame,
    edges: Float[np.ndarray, "index edge"],
    density: Float[np.ndarray, "sample index bin"],
) -> Figure:
    """Histogram of each index over the pixels of both images (figure 10).

    **Arguments:** `indices` with the columns `index`, `histogram_intersection`,
    `central_intersection`, `ks`, `real_mean`, `simulated_mean`; `edges` and `density` of the real
    and the simulated image's histogram.
    """
    names = list(indices["index"])
    figure, panels = panel_grid(len(names), 5, (1.9, 1.62), (0.0, 0.5))
    for k, (axes, name) in enumerate(zip(panels, names, strict=True)):
        row = indices.iloc[k]
        axes.set(yticks=[])
        axes.spines["left"].set_visible(False)
        whole, central = row["histogram_intersection"], row["central_intersection"]
        label = f"HI {whole:.2f}, KS {row['ks']:.2f}"
        if abs(whole - central) > 0.05:
            label = f"HI {whole:.2f} (central {central:.2f}), KS {row['ks']:.2f}"
        axes.set_title(f"{name}\n", fontsize=9)
        axes.text(0.0, 1.03, label, transform=axes.transAxes, fontsize=7, color="#55554f")
        if not np.isfinite(edges[k]).all():
            axes.text(0.5, 0.5, "not defined", transform=axes.transAxes, ha="center")
            continue
        axes.stairs(density[0, k], edges[k], color=REAL, fill=True, alpha=0.35)
        axes.stairs(density[1, k], edges[k], color=AFTER, lw=1.3)
        axes.set_xlim(edges[k][0], edges[k][-1])
        for side, colour in SAMPLES:
            axes.axvline(row[f"{side}_mean"], color=colour, lw=1.0, ls=(0, (4, 2)))
        axes.locator_params(axis="x", nbins=4)
    handles: list[Artist] = [Patch(color=REAL, alpha=0.35, label="real")]
    handles.append(Line2D([], [], color=AFTER, label="simulated"))
    figure.legend(handles=handles, loc="outside upper left", ncols=2)
    note(
        figure,
        "Index value [-]; height is the density of pixels; dashed: means. HI: histogram "
        "intersection (central: without the outermost percent); KS: Kolmogorov-Smirnov "
        "distance.",
    )
    return figure

"""What the paper prints of the structure of its 2006 plot."""

from dataclasses import dataclass


@dataclass(frozen=True)
class PublishedStructure:
    """One structure metric of the 2006 burn plot (10 m x 10 m, grain 2 m), where it is printed."""

    real: float | None = None
    """Real LiDAR, mean over 25 cells."""
    simulated: float | None = None
    """The paper's simulation, median of 100 thinnings to the real number of returns."""
    difference_percent: float | None = None
    """Simulated minus real over real, as printed or from the two [%]."""
    remark: str = ""
    """Assumption that is not printed and decides the value."""


_LAYER = "layer thickness, lowest height and what counts as leaf area are not printed"

_PUBLISHED = {
    "foliage_height_diversity": PublishedStructure(
        0.097, 1.23, None, f"{_LAYER}; the two contradict the agreement of the heights: no target"
    ),
    "gap_fraction": PublishedStructure(
        0.0625, 0.0672, 100.0 * (0.0672 / 0.0625 - 1.0), "the height threshold is not printed"
    ),
    "leaf_area_density_mean": PublishedStructure(None, None, -18.9, _LAYER),
    "leaf_area_density_std": PublishedStructure(None, None, -22.1, _LAYER),
    "rugosity": PublishedStructure(None, None, 35.8, "which rugosity is not printed"),
    "height_cv": PublishedStructure(None, None, 22.8, "which returns count is not printed"),
    "height_percentile_rmse": PublishedStructure(
        None, 0.079, None, "which percentiles is not printed"
    ),
    "height_intersection": PublishedStructure(None, 0.768, None, "the bins are not printed"),
}


def structure_2006() -> dict[str, PublishedStructure]:
    """The paper's numbers of section 4 on structure, by metric.

    Those of `STRUCTURE_METRICS`, "height_percentile_rmse" [m] and "height_intersection" [-].
    Source: "Construction and Validation of a High-Fidelity Virtual Scene for Low-Stature and
    High-Biodiversity Ecosystems" (Remote Sensing), facts transcribed by hand.
    """
    return dict(_PUBLISHED)

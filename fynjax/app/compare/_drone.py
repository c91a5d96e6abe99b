"""Two drone images in numbers: figure 9, table 4 and figure 10 of the fynbos scene paper."""

import warnings
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from jaxtyping import Float

from fynjax._core.progress import advance, stage
from fynjax.app.compare._images import FEW_PIXELS, DroneImage
from fynjax.app.compare._published import bands_2006, table4_2006
from fynjax.diversity import VARIETY, spectral_variety
from fynjax.metrics import BANDS, VEGETATION_INDICES, histogram_intersection, vegetation_indices

BINS = 256
"""Bins of a histogram, on the pooled range of both images."""

PERCENTILES = (5, 25, 50, 75, 95)
_CENTRAL = (0.5, 99.5)
"""Percentiles of the pooled pixels between which the second histogram intersection is taken."""

_SHOWN_BINS = 60
_OTHER_SCALE = 2.5
"""Ratio of pixels' sides from which on spreads and histograms are of different things [-]."""

_KNOWN = {True: "yes", False: "no", None: "open"}
"""Words of what a published table marks as so, as not so, or as known to nobody."""
_Real = Float[np.ndarray, " real"]
_Simulated = Float[np.ndarray, " simulated"]


@dataclass(frozen=True)
class DroneComparison:
    """All numbers of a pair of drone images."""

    real: DroneImage
    simulated: DroneImage
    bands: pd.DataFrame
    """A row for each band: means, spreads, percentiles, differences, and the paper's."""
    indices: pd.DataFrame
    """A row for each index of table 4."""
    variety: pd.DataFrame
    """A row for the `sample` real and one for simulated: how much the spectra of the pixels differ
    (`fynjax.diversity.spectral_variety`), `cv` [-], `angle_deg`, `rao` and `variance` [-]; NaN for
    an image of which a band is not above 0 on average."""
    edges: Float[np.ndarray, "index edge"]
    """Edges of each index's histogram."""
    shares: Float[np.ndarray, "sample index bin"]
    """Share of the pixels in each bin [-], of the real and the simulated image."""
    shown_edges: Float[np.ndarray, "index shown_edge"]
    """Edges of fewer bins, without the outermost half percent of either image, for a picture."""
    shown: Float[np.ndarray, "sample index shown_bin"]
    """Density of the pixels in these."""
    notes: tuple[str, ...]
    """Sentences that a reader needs to judge the numbers."""


def compare_drone_images(real: DroneImage, simulated: DroneImage) -> DroneComparison:
    """Compare bands and vegetation indices of two images by the distributions of their pixels.

    A pixel where an index is undefined (a black band, the root of a negative NDVI) is left out of
    that index alone, and counted.

    **Arguments:**

    - `real`, `simulated`: reflectance [band, y, x] [-], as of `read_drone_image`; they may
      differ in size and place. Bands that both have are compared, of the pixels that have data in
      every band of their own image (read both with the same `camera`).

    **Returns:** a `DroneComparison`: means, standard deviations, histogram intersections and
    Kolmogorov-Smirnov distances beside those of the paper, and notes.
    """
    # The four that indices are made of come first.
    names = [name for name in real.bands if name in simulated.bands]
    samples = tuple(one.pixels[[one.bands.index(n) for n in names]] for one in (real, simulated))
    four = [sample[: len(BANDS)] for sample in samples]
    published = table4_2006()
    rows, full, shown = [], [], []
    with stage("Compare the drone images", len(published)):
        bands = _band_table(names, *samples)
        for name, paper in published.items():
            (x, y), other = (
                [np.asarray(vegetation_indices(s, [one])[0]) for s in four] if one else []
                for one in (name, paper.literature)
            )
            formulas = [
                VEGETATION_INDICES[n].formula if n else "" for n in (name, paper.literature)
            ]
            row = {"index": name, "formula": formulas[0], **_pair_row(x, y)}
            called = "" if paper.printed == name else f"{paper.printed} in the paper. "
            row |= {"departure": f"{called}{paper.departure}", "literature_formula": formulas[1]}
            for side, values in zip(("real", "simulated"), other):
                known = values[np.isfinite(values)]
                row[f"literature_{side}_mean"] = known.mean() if known.size else np.nan
            row |= {
                "paper_real_mean": paper.real_mean,
                "paper_simulated_mean": paper.sim_mean,
                "paper_real_std": paper.real_std,
                "paper_real_std_consistent": _KNOWN[paper.std_consistent],
                "paper_simulated_std": paper.sim_std,
                "paper_histogram_intersection": paper.histogram_intersection,
                "paper_ks": paper.ks,
                "paper_formula_confidence": paper.formula_confidence,
            }
            rows.append(row)
            full.append(_histograms(x, y, BINS, 0.0))
            shown.append(_histograms(x, y, _SHOWN_BINS, _CENTRAL[0]))
            advance()
    return DroneComparison(
        real=real,
        simulated=simulated,
        bands=bands,
        indices=pd.DataFrame(rows),
        variety=_variety_table(*samples),
        edges=np.stack([edges for edges, _ in full]),
        shares=np.stack([shares for _, shares in full], axis=1),
        shown_edges=np.stack([edges for edges, _ in shown]),
        shown=np.stack([shares / np.diff(edges) for edges, shares in shown], axis=1),
        notes=tuple(_notes(real, simulated)),
    )


def _variety_table(
    real: Float[np.ndarray, "band real"], simulated: Float[np.ndarray, "band simulated"]
) -> pd.DataFrame:
    unknown = dict.fromkeys(VARIETY, np.nan)
    lit = [(one.mean(axis=1) > 0.0).all() for one in (real, simulated)]
    rows = [spectral_variety(one.T) if ok else unknown for one, ok in zip((real, simulated), lit)]
    table = pd.DataFrame(rows).rename(columns={"angle": "angle_deg"})
    table.insert(0, "sample", ["real", "simulated"])
    return table


def _band_table(
    names: Sequence[str],
    real: Float[np.ndarray, "band real"],
    simulated: Float[np.ndarray, "band simulated"],
) -> pd.DataFrame:
    published = bands_2006()
    rows = []
    for k, band in enumerate(names):
        row = {"band": band, **_pair_row(real[k], simulated[k])}
        for side, values in (("real", real[k]), ("simulated", simulated[k])):
            levels = np.percentile(values, PERCENTILES)
            row |= {f"{side}_p{p}": v for p, v in zip(PERCENTILES, levels, strict=True)}
        paper = published.get(band)  # of four bands
        row["paper_real_mean_derived"] = paper.real_mean if paper else np.nan
        row["paper_abs_difference_percent"] = 100.0 * paper.sim_abs_difference if paper else np.nan
        rows.append(row)
    return pd.DataFrame(rows)


def _pair_row(x: _Real, y: _Simulated) -> dict[str, object]:
    """Means, spreads and distances of two samples; NaN is left out and counted."""
    a, b = x[np.isfinite(x)], y[np.isfinite(y)]
    row: dict[str, object] = {}
    for side, part in (("real", a), ("simulated", b)):
        row[f"{side}_mean"] = part.mean() if part.size else np.nan
        row[f"{side}_std"] = part.std() if part.size else np.nan
    names = ("difference_percent", "histogram_intersection", "ks", "central_intersection")
    row |= dict.fromkeys(names, np.nan)
    if a.size and b.size:
        from scipy.stats import ks_2samp  # late: it takes half a second

        if start := a.mean():
            row["difference_percent"] = 100.0 * (b.mean() - start) / abs(start)
        row["histogram_intersection"] = histogram_intersection(a, b, bins=BINS)
        row["ks"] = float(ks_2samp(a, b, method="asymp").statistic)
        low, high = np.percentile(np.concatenate([a, b]), _CENTRAL)
        if high > low:
            limits = (low, high)
            row["central_intersection"] = histogram_intersection(a, b, bins=BINS, limits=limits)
    for side, whole, part in (("real", x, a), ("simulated", y, b)):
        row[f"{side}_undefined_percent"] = 100.0 * (1.0 - part.size / whole.size)
    return row


def _histograms(
    x: _Real, y: _Simulated, bins: int, tail: float
) -> tuple[Float[np.ndarray, " edge"], Float[np.ndarray, "2 bin"]]:
    """Edges, and shares of both samples, without `tail` percent at each end of either."""
    a, b = x[np.isfinite(x)], y[np.isfinite(y)]
    if not (a.size and b.size):
        return np.full(bins + 1, np.nan), np.zeros((2, bins))
    ends = np.percentile(a, [tail, 100.0 - tail]), np.percentile(b, [tail, 100.0 - tail])
    limits = np.array([min(e[0] for e in ends), max(e[1] for e in ends)])
    edges = np.histogram_bin_edges(limits, bins)
    return edges, np.stack([np.histogram(v, edges)[0] / v.size for v in (a, b)])


def _notes(real: DroneImage, simulated: DroneImage) -> list[str]:
    notes = [f"Real image: {real.description()}", f"Simulated image: {simulated.description()}"]
    p, q = real.pixel_m, simulated.pixel_m
    if p is not None and q is not None:
        if max(p, q) > 1.2 * min(p, q):
            notes.append(
                f"The pixels differ in size ({p:g} m and {q:g} m): smaller ones see deeper shadows "
                "and brighter tops, so spreads and histograms differ for that alone. Means do not."
            )
            if max(p, q) > _OTHER_SCALE * min(p, q):
                coarse = f"gdalwarp -tr {max(p, q):g} {max(p, q):g} -r average"
                warnings.warn(f"{notes[-1]} Bring both to one size: {coarse}", stacklevel=3)
        areas = [i.shape[0] * i.shape[1] * s**2 for i, s in ((real, p), (simulated, q))]
        if max(areas) > 4.0 * min(areas):
            notes.append(
                f"The images cover {areas[0]:.4g} and {areas[1]:.4g} m²: is the larger one all of "
                "the same vegetation? Cut it to the plot first (gdalwarp -te)."
            )
    elif (p is None) != (q is None):
        notes.append(
            "One image does not say how large its pixels are; spreads and histograms can only be "
            "compared between pixels of one size."
        )
    if real.crs is not None and simulated.crs is not None and real.crs != simulated.crs:
        notes.append(
            "The images are in different coordinate systems, which does not matter: distributions "
            "are compared, not places."
        )
    for which, image in (("real", real), ("simulated", simulated)):
        if (number := int(image.mask.sum())) < FEW_PIXELS:
            notes.append(
                f"Only {number} pixels of the {which} image are compared, which is too few for "
                "distributions: means alone can be compared, if at all."
            )
    return notes

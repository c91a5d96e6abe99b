"""The page of a validation: every figure and table, with the paper's values beside them."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pandas as pd

from fynjax.compare import (
    LEFT_OUT,
    DroneComparison,
    DroneImage,
    PublishedComparison,
    SpectralComparison,
    unit_of,
)
from fynjax.metrics import BANDS
from fynjax.report.figures import (
    band_box_plot,
    composites,
    index_pair_histograms,
    mean_spectra_plot,
    misfit_plot,
    save_figure,
    spectrometer_index_bars,
    words,
)
from fynjax.report.pages._page import Page

Files = dict[str, str]
"""File names with what they hold."""

_THUMBNAIL = 320
"""Pixels of a picture's longer side."""

_PAPER = (
    "Columns called 'paper' hold what the fynbos scene paper prints for its plot burnt in 2006, "
    "real and as simulated with DIRSIG. They are another plot's numbers unless yours is that one."
)


def _units(table: pd.DataFrame) -> Mapping[str, str]:
    short = {"percent": "%", "degree": "°"}
    units = {str(c): unit_of(str(c)) for c in table.columns}
    return {c: short.get(u, u) for c, u in units.items() if u != "1"}


def _headers(table: pd.DataFrame) -> Mapping[str, str]:
    """Names of columns without their units, which stand below them."""
    ends = ("_percent", "_deg", "_nm", "_m")
    found = {}
    for column in map(str, table.columns):
        name = next((column.removesuffix(e) for e in ends if column.endswith(e)), column)
        found[column] = name.replace("_", " ")
    return found


def _add_table(page: Page, table: pd.DataFrame, caption: str, *, folded: bool = False) -> None:
    page.table(table, caption=caption, units=_units(table), headers=_headers(table), folded=folded)


def drone_section(page: Page, folder: Path, drone: DroneComparison) -> Files:
    """Figures 9 and 10 and table 4."""
    files: Files = {}
    page.section("Drone images")
    for note in drone.notes:
        page.paragraph(note)
    picture = _pictures(drone.real, drone.simulated)
    if picture is not None:
        save_figure(composites(*picture[:2], pixel_m=picture[2]), folder / "drone_images.png")
        page.figure(
            folder / "drone_images.png", "Both images, false colour, one stretch and one scale."
        )
        files["drone_images.png"] = "both drone images, near infrared as red"
    save_figure(band_box_plot(drone.bands), folder / "drone_bands.png")
    files["drone_bands.png"] = "box plots of the bands and differences of their means (fig. 9)"
    page.figure(
        folder / "drone_bands.png",
        "Reflectance of the pixels by band, and difference of the means, as figure 9. The paper "
        "prints its differences without sign, so grey marks are on both sides.",
    )
    bands = drone.bands.drop(columns=[c for c in drone.bands if "_undefined_" in str(c)])
    _add_table(page, bands, f"Bands. {_PAPER} Its real band means are derived, not printed.")
    names = [
        "index", "formula", "real_mean", "simulated_mean", "difference_percent", "real_std",
        "simulated_std", "histogram_intersection", "ks", "paper_real_mean",
        "paper_simulated_mean", "paper_histogram_intersection", "paper_ks",
    ]  # fmt: skip
    _add_table(
        page,
        drone.indices[names],
        "Vegetation indices, as table 4: in the forms that reproduce the paper's printed means. "
        "Histogram intersection in 256 bins on the pooled range (1 is equal); KS is the "
        "Kolmogorov-Smirnov distance (0 is equal).",
    )
    save_figure(
        index_pair_histograms(drone.indices, drone.shown_edges, drone.shown),
        folder / "drone_indices.png",
    )
    files["drone_indices.png"] = "histograms of the twenty indices (fig. 10)"
    page.figure(folder / "drone_indices.png", "Indices over the pixels, as figure 10.")
    _add_table(
        page,
        drone.indices.drop(columns=["departure", "literature_formula"]),
        "Everything of the indices. 'central intersection' is taken between the 0.5th and 99.5th "
        "percentile of the pooled pixels, so that a few extreme ratios do not leave all pixels in "
        "one bin. 'undefined' is the share of pixels where the index has no value. Where the "
        "paper's real standard deviation contradicts its formula, 'consistent' says no.",
        folded=True,
    )
    other = drone.indices[drone.indices["departure"] != ""]
    forms = ["index", "formula", "real_mean", "simulated_mean", "literature_formula"]
    forms += ["literature_real_mean", "literature_simulated_mean"]
    _add_table(page, other[forms], "Where the paper's form is not the literature's: both.")
    for row in other.to_dict("records"):
        page.paragraph(f"{row['index']}: {row['departure']}")
    return files


def published_section(page: Page, published: PublishedComparison) -> Files:
    """A simulated image beside the paper's printed statistics."""
    page.section("Drone image against the published statistics")
    for note in published.notes:
        page.paragraph(note)
    _add_table(
        page,
        published.statistics,
        "Real and DIRSIG are the paper's; of DIRSIG's bands only absolute differences are printed. "
        "Rows whose printed number contradicts its own formula, or whose formula is not known, are "
        "marked and prove nothing.",
    )
    return {}


def spectral_section(page: Page, folder: Path, spectra: SpectralComparison) -> Files:
    """Figures 11 and 12, table 5, and what the misfit is made of."""
    page.section("Spectra")
    for note in spectra.notes:
        page.paragraph(note)
    figures = {
        "spectra.png": (
            mean_spectra_plot(spectra.spectra, spectra.windows),
            "mean spectra (fig. 11)",
            "Mean spectra and their difference, as figure 11.",
        ),
        "misfit.png": (
            misfit_plot(spectra.spectra, spectra.misfit),
            "simulated against real by region",
            "Simulated against real, by region. Dashed: no error. Solid: the regression line.",
        ),
    }
    if not spectra.indices.empty:
        figures["spectral_indices.png"] = (
            spectrometer_index_bars(spectra.indices),
            "indices of the spectra (fig. 12)",
            "Indices of the mean spectra, as figure 12; whiskers: standard deviation over the "
            f"spectra. {LEFT_OUT}",
        )
    for name, (figure, _, _) in figures.items():
        save_figure(figure, folder / name)
    page.figure(folder / "spectra.png", figures["spectra.png"][2])
    _add_table(
        page,
        spectra.regions,
        "Agreement by region, as table 5. The angle is blind to a common factor, the correlation "
        f"to factor and offset. NRMSE is the RMSE over the range of the real spectrum. {_PAPER}",
    )
    page.figure(folder / "misfit.png", figures["misfit.png"][2])
    _add_table(
        page,
        spectra.misfit,
        "What the error is made of. The squared error is level (what an offset can repair) plus "
        "contrast (what a gain about the mean then repairs) plus shape (what neither can), by the "
        "regression simulated = offset + gain x real (Gauch, Hwang and Fick 2003). The line moves "
        "the mean by the offset and by the gain. 'Without' is the RMSE left when that one "
        "correction alone is fitted: whichever leaves much less explains the error.",
    )
    if not spectra.indices.empty:
        page.figure(folder / "spectral_indices.png", figures["spectral_indices.png"][2])
        _add_table(
            page,
            spectra.indices,
            "Indices, as figure 12. The paper prints absolute differences or ranges of them; a "
            "sign of 1 where it says that the simulated value is higher.",
        )
    return {name: what for name, (_, what, _) in figures.items()}


def _pictures(
    real: DroneImage, simulated: DroneImage
) -> tuple[dict[str, np.ndarray], tuple[str, ...], float] | None:
    """Both images on pixels of one size, for `composites`; none where a pixel size is unknown."""
    sizes = [image.pixel_m for image in (real, simulated)]
    if None in sizes:
        return None
    own = [float(size or 0.0) * i.step for size, i in zip(sizes, (real, simulated), strict=True)]
    extents = [
        np.array(i.values.shape[1:]) * s for i, s in zip((real, simulated), own, strict=True)
    ]
    pixel = float(max(e.max() for e in extents)) / _THUMBNAIL
    pictures = {}
    for title, image, size, extent in zip(
        ("Real", "Simulated"), (real, simulated), own, extents, strict=True
    ):
        y, x = (
            np.minimum(
                ((np.arange(max(int(e / pixel), 1)) + 0.5) * pixel / size).astype(int), n - 1
            )
            for e, n in zip(extent, image.values.shape[1:], strict=True)
        )
        pictures[title] = image.values[:, y[:, None], x[None, :]]
    if any(np.isnan(p).all() for p in pictures.values()):
        return None
    return pictures, BANDS, pixel


def drone_headline(drone: DroneComparison) -> list[str]:
    """The result in two sentences."""
    bands = ", ".join(
        f"{words(r['band'])} {r['difference_percent']:+.1f} %"
        for r in drone.bands.to_dict("records")
    )
    table = drone.indices
    worst = max(
        table.dropna(subset="difference_percent").to_dict("records"),
        key=lambda row: abs(row["difference_percent"]),
    )
    return [
        f"Drone, simulated against real means: {bands} (the paper's DIRSIG: 12 to 24 %).",
        f"Twenty indices: median histogram intersection "
        f"{table['histogram_intersection'].median():.2f}, median KS {table['ks'].median():.2f}, "
        f"largest difference of a mean {worst['index']} {worst['difference_percent']:+.0f} %.",
    ]


def told(value: float, form: str, unit: str = "") -> str:
    """A number with its unit, or that it is undefined."""
    return f"{value:{form}}{unit}" if np.isfinite(value) else "undefined"


def spectral_headline(spectra: SpectralComparison) -> list[str]:
    """The result in a sentence a region."""
    lines = []
    reading = dict(zip(spectra.misfit["region"], spectra.misfit["reading"], strict=True))
    for row in spectra.regions.to_dict("records"):
        lines.append(
            f"Spectra, {row['region']}: angle {told(row['spectral_angle_deg'], '.1f', '°')}, RMSE "
            f"{row['rmse']:.4f}, r {told(row['correlation'], '.3f')}, mean {row['real_mean']:.3f} "
            f"real and {row['simulated_mean']:.3f} simulated; {reading[row['region']]}."
        )
    return lines

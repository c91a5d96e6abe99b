"""The sections of a validation: figures and tables, with the paper's values beside them."""

import numpy as np
import pandas as pd

from fynjax.app.compare import (
    LEFT_OUT,
    DroneComparison,
    DroneImage,
    PublishedComparison,
    SpectralComparison,
)
from fynjax.app.report.figures import (
    band_box_plot,
    composites,
    index_pair_histograms,
    mean_spectra_plot,
    misfit_plot,
    spectrometer_index_bars,
)
from fynjax.app.report.pages._page import Part, Picture, Section, Table
from fynjax.metrics import BANDS

_THUMBNAIL = 320
"""Pixels of a picture's longer side."""
_SMALLEST = 16
"""Pixels of a side below which a picture on the other's scale shows nothing."""

_PAPER = (
    "Columns called 'paper' hold what the fynbos scene paper prints for its plot burnt in 2006, "
    "real and as simulated with DIRSIG. They are another plot's numbers unless yours is that one."
)


def drone_section(drone: DroneComparison) -> Section:
    """Section of the drone images: figures 9 and 10 and table 4.

    **Arguments:** `drone`, the comparison of the drone images.
    """
    parts: list[Part] = list(drone.notes)
    images = _pictures(drone.real, drone.simulated)
    if images is not None:
        parts.append(
            Picture(
                "drone_images.png",
                composites(*images[:2], pixel_m=images[2]),
                "both drone images, near infrared as red",
                "Both images, false colour, one stretch and one scale.",
            )
        )
    return Section("Drone images", [*parts, *_of_bands(drone), *_of_indices(drone)])


_NUMBERS = [
    "real_mean", "simulated_mean", "difference_percent", "real_std", "simulated_std",
    "histogram_intersection", "ks",
]  # fmt: skip
"""Columns that fit on a page; all numbers, the paper's among them, are in the folded tables."""


def _of_bands(drone: DroneComparison) -> list[Part]:
    bands = drone.bands.drop(columns=[c for c in drone.bands if "_undefined_" in str(c)])
    return [
        Picture(
            "drone_bands.png",
            band_box_plot(drone.bands),
            "box plots of the bands and differences of their means (fig. 9)",
            "Reflectance of the pixels by band, and difference of the means, as figure 9.",
        ),
        Table(
            bands[["band", *_NUMBERS]],
            "Bands. Histogram intersection in 256 bins on the pooled range (1 is equal); KS is the "
            "Kolmogorov-Smirnov distance (0 is equal).",
        ),
        Table(
            bands,
            f"Every number of the bands. {_PAPER} Its real band means are derived, not printed.",
            folded=True,
        ),
    ]


def _of_indices(drone: DroneComparison) -> list[Part]:
    other = drone.indices[drone.indices["departure"] != ""]
    forms = ["index", "formula", "real_mean", "simulated_mean", "literature_formula"]
    forms += ["literature_real_mean", "literature_simulated_mean"]
    return [
        Table(
            drone.indices[["index", "formula", *_NUMBERS]],
            "Vegetation indices, in the forms that reproduce the printed means of the fynbos scene "
            "paper (table 4).",
        ),
        Table(
            drone.variety,
            "Spectral diversity: coefficient of variation, mean angle to the mean spectrum, Rao's "
            "Q (of a thousand pixels) and variance of the pixels. Compare pixels of one size.",
        ),
        Picture(
            "drone_indices.png",
            index_pair_histograms(drone.indices, drone.shown_edges, drone.shown),
            "histograms of the twenty indices (fig. 10)",
            "Indices over the pixels, as figure 10.",
        ),
        Table(
            drone.indices.drop(columns=["departure", "literature_formula"]),
            "Every number of the indices. 'central intersection' is taken between the 0.5th and "
            "99.5th percentile of the pooled pixels, so that a few extreme ratios do not leave all "
            "pixels in one bin. 'undefined' is the share of pixels where the index has no value. "
            "Where the paper's real standard deviation contradicts its formula, 'consistent' says "
            f"no. {_PAPER}",
            folded=True,
        ),
        Table(other[forms], "Where the paper's form is not the literature's: both."),
        *(f"{row['index']}: {row['departure']}" for row in other.to_dict("records")),
    ]


def published_section(published: PublishedComparison) -> Section:
    """Section of a simulated image beside the published statistics.

    **Arguments:** `published`, the comparison with those statistics.
    """
    table = Table(
        published.statistics,
        "Real and DIRSIG are the paper's; of DIRSIG's bands only absolute differences are printed. "
        "Rows whose printed number contradicts its own formula, or whose formula is not known, are "
        "marked and prove nothing.",
    )
    return Section("Drone image against the published statistics", [*published.notes, table])


def spectral_section(spectra: SpectralComparison) -> Section:
    """Section of the spectra: figures 11 and 12, table 5, and the parts of the misfit.

    **Arguments:** `spectra`, the comparison of the spectra.
    """
    parts: list[Part] = [
        *spectra.notes,
        Picture(
            "spectra.png",
            mean_spectra_plot(spectra.spectra, spectra.windows),
            "mean spectra (fig. 11)",
            "Mean spectra and their difference, as figure 11.",
        ),
        Table(
            _own(spectra.regions),
            "Agreement by region, as table 5. The angle is blind to a common factor, the "
            "correlation to factor and offset. NRMSE is the RMSE over the range of the real "
            "spectrum.",
        ),
        Table(spectra.regions, f"The same beside the paper's. {_PAPER}", folded=True),
        Picture(
            "misfit.png",
            misfit_plot(spectra.spectra, spectra.misfit),
            "simulated against real by region",
            "Simulated against real, by region. Dashed: no error. Solid: the regression line.",
        ),
        Table(
            spectra.misfit,
            "What the error is made of. The squared error is level (what an offset can repair) "
            "plus contrast (what a gain about the mean then repairs) plus shape (what neither "
            "can), by the regression simulated = offset + gain x real (Gauch, Hwang and Fick "
            "2003). The line moves the mean by the offset and by the gain. 'Without' is the RMSE "
            "left when that one correction alone is fitted: whichever leaves much less explains "
            "the error.",
        ),
    ]
    if not spectra.indices.empty:
        parts += [
            Picture(
                "spectral_indices.png",
                spectrometer_index_bars(spectra.indices),
                "indices of the spectra (fig. 12)",
                "Indices of the mean spectra, as figure 12; whiskers: standard deviation over the "
                f"spectra. {LEFT_OUT}",
            ),
            Table(_own(spectra.indices), "Indices, as figure 12."),
            Table(
                spectra.indices,
                f"The same beside the paper's. {_PAPER} The paper prints absolute "
                "differences or ranges of them; a sign of 1 where it says that the simulated value "
                "is higher.",
                folded=True,
            ),
        ]
    return Section("Spectra", parts)


def _own(rows: pd.DataFrame) -> pd.DataFrame:
    """A table without the paper's columns."""
    return rows[[c for c in rows if not str(c).startswith("paper")]]


def _pictures(
    real: DroneImage, simulated: DroneImage
) -> tuple[dict[str, np.ndarray], tuple[str, ...], float] | None:
    """Both images on pixels of one size, for `composites`; none where a pixel size is unknown, or
    one of them would be a few pixels beside the other."""
    sizes = [image.pixel_m for image in (real, simulated)]
    if None in sizes:
        return None
    step = [float(size or 0.0) * i.step for size, i in zip(sizes, (real, simulated), strict=True)]
    extents = [
        np.array(i.values.shape[1:]) * s for i, s in zip((real, simulated), step, strict=True)
    ]
    pixel = float(max(e.max() for e in extents)) / _THUMBNAIL
    pictures = {}
    for title, image, size, extent in zip(
        ("Real", "Simulated"), (real, simulated), step, extents, strict=True
    ):
        y, x = (
            np.minimum(
                ((np.arange(max(int(e / pixel), 1)) + 0.5) * pixel / size).astype(int), n - 1
            )
            for e, n in zip(extent, image.values.shape[1:], strict=True)
        )
        pictures[title] = image.values[: len(BANDS), y[:, None], x[None, :]]
    if any(min(p.shape[1:]) < _SMALLEST or np.isnan(p).all() for p in pictures.values()):
        return None
    return pictures, BANDS, pixel

"""The published statistics of the 2006 burn plot, and a simulated drone image against them."""

import csv
from dataclasses import dataclass
from importlib.resources import files
from typing import Annotated, Literal

import numpy as np
import pandas as pd
from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field

from fynjax.app.compare._images import DroneImage
from fynjax.metrics import BANDS, vegetation_indices


@dataclass(frozen=True)
class PublishedComparison:
    """A simulated image beside what the paper prints of the real one and of its own simulation."""

    simulated: DroneImage
    statistics: pd.DataFrame
    """A row for each mean and standard deviation."""
    notes: tuple[str, ...]


def compare_with_published(image: DroneImage) -> PublishedComparison:
    """Means of bands, means and standard deviations of indices: real, DIRSIG's, and these.

    The real band means are derived (see `fynjax/app/compare/data/README.md`), and of DIRSIG's only
    the absolute difference is printed. A printed standard deviation that contradicts the formulas
    is marked, and EVI, whose form is not known.

    **Arguments:** `image`: simulated reflectance in four bands [-], as of `read_drone_image`.

    **Returns:** a `PublishedComparison`.
    """
    rows = []
    published = bands_2006()
    pixels = image.pixels[: len(BANDS)]
    for name, values in zip(BANDS, pixels, strict=True):
        row = published[name]
        rows.append(
            _row(f"{name}.mean", "derived", row.real_mean, np.nan, float(values.mean()))
            | {"dirsig_abs_error_percent": 100.0 * row.sim_abs_difference}
        )
    for name, paper in table4_2006().items():
        values = np.asarray(vegetation_indices(pixels, [name])[0])
        values = values[np.isfinite(values)]
        mean, std = (values.mean(), values.std()) if values.size else (np.nan, np.nan)
        known = "printed" if paper.formula_confidence != "open" else "form not known"
        rows.append(_row(f"{name}.mean", known, paper.real_mean, paper.sim_mean, float(mean)))
        sound = "printed" if paper.std_consistent else "contradicts its formula"
        sound = known if paper.std_consistent is None else sound
        rows.append(_row(f"{name}.std", sound, paper.real_std, paper.sim_std, float(std)))
    assert len(rows) == len(BANDS) + 2 * len(table4_2006())
    notes = [
        f"Simulated image: {image.description()}",
        "The real image itself is not published: only means and standard deviations can be "
        "compared, no histograms.",
    ]
    return PublishedComparison(image, pd.DataFrame(rows), tuple(notes))


def _row(
    statistic: str, status: str, real: float, dirsig: float, simulated: float
) -> dict[str, object]:
    error = 100.0 * (dirsig - real) / abs(real)
    return {
        "statistic": statistic,
        "status": status,
        "real": real,
        "dirsig": dirsig,
        "simulated": simulated,
        "dirsig_abs_error_percent": abs(error),
        "simulated_error_percent": 100.0 * (simulated - real) / abs(real),
    }


def wins(statistics: pd.DataFrame) -> tuple[int, int]:
    """In how many statistics the simulated image is nearer to the real one than DIRSIG's.

    **Arguments:** `statistics`: the table of a `PublishedComparison`.

    **Returns:** that number, and the number of statistics that are consistent and have both errors.
    """
    sound = statistics[statistics["status"].isin(["derived", "printed"])]
    both = sound.dropna(subset=["dirsig_abs_error_percent", "simulated_error_percent"])
    nearer = both["simulated_error_percent"].abs() < both["dirsig_abs_error_percent"]
    return int(nearer.sum()), len(both)


Percent = Annotated[float, AfterValidator(lambda percent: percent / 100.0)]
"""A number that a table states in percent, as a fraction."""
Known = Annotated[bool | None, BeforeValidator({"true": True, "false": False}.get)]
"""Whether something is so; None where no one knows."""


class _Published(BaseModel):
    model_config = ConfigDict(frozen=True, extra="ignore")


class Table4Row(_Published):
    """One row of the paper's table 4: an index over the real and the paper's simulated image."""

    index: str
    """Name in `fynjax.metrics.VEGETATION_INDICES` of the form that reproduces the printed means; of
    EVI, whose form is not known, of one that the camera's bands allow."""
    printed: str
    """Name in the paper."""
    real_mean: float
    """Mean of the real image [-]."""
    real_std: float
    """Standard deviation of the real image [-]."""
    sim_mean: float
    """Mean of the paper's simulated image [-]."""
    sim_std: float
    """Standard deviation of the paper's simulated image [-]."""
    histogram_intersection: float
    """Overlap of the two histograms [-]."""
    ks: float
    """Kolmogorov-Smirnov distance of the two [-]."""
    formula_confidence: Literal["exact", "firm", "open"]
    std_consistent: Known
    """Whether the printed real std obeys the formula and the other rows; None if no one knows."""
    affine_of: str
    """Row of which this one is an exact affine function, so that it adds no information; empty
    where there is none."""
    literature: str
    """Name in `fynjax.metrics.VEGETATION_INDICES` of what the literature means by the printed name,
    where that is another form; else empty."""
    departure: str
    """In a sentence, how the formula of `index` differs from that which the literature means by the
    printed name; empty where it is the same."""


class BandReference(_Published):
    """Published comparison of one drone band."""

    band: str
    real_mean: float = Field(alias="real_mean_derived")
    """Mean reflectance of the real image [-]: derived from table 4, not printed."""
    sim_abs_difference: Percent = Field(alias="sim_abs_difference_percent")
    """Difference of the paper's simulated from the real mean, over the latter [-]; no sign."""


class Table5Row(_Published):
    """Published agreement of the simulated with the real spectrometer spectrum in one region."""

    region: str
    """Name in `SPECTRAL_REGIONS`."""
    spectral_angle: float = Field(alias="spectral_angle_deg")
    """Angle between the spectra [degrees]."""
    rmse: float
    """Root mean square error of reflectance [-]."""
    nrmse: Percent = Field(alias="nrmse_percent")
    """RMSE over the range of the real spectrum [-]."""
    correlation: float
    """Pearson correlation of the spectra [-]."""


class Figure12Row(_Published):
    """Published difference of one index between the real and the simulated mean spectrum."""

    index: str
    lower: Percent = Field(alias="lower_percent")
    """Smallest absolute difference that the text allows, over the real value [-]."""
    upper: Percent = Field(alias="upper_percent")
    """Largest one; equal to `lower` where the text gives one number."""
    simulated_higher: Known
    """None where the text gives no sign."""


@dataclass(frozen=True)
class Target:
    """One number of the real image that a simulation can be calibrated against."""

    name: str
    """A band (`green`, ...) or an index (`NDVI`, ...)."""
    statistic: Literal["mean", "std"]
    value: float
    """Value of the statistic in the real image [-]."""
    derived: bool
    """True if the number is inferred from the printed ones."""

    @property
    def key(self) -> str:
        """'<band or index>.<statistic>', as statistics tables name it."""
        return f"{self.name}.{self.statistic}"


def table4_2006() -> dict[str, Table4Row]:
    """Table 4 of the paper (2006 burn plot), by the names of `fynjax.metrics.VEGETATION_INDICES`,
    in its order. Source: `data/README.md`.

    >>> from fynjax.app.compare import table4_2006
    >>> len(table4_2006())
    20
    """
    return {row["index"]: Table4Row.model_validate(row) for row in _read("table4_2006.csv")}


def bands_2006() -> dict[str, BandReference]:
    """Band means of the real image and figure 9's differences, by band name."""
    return {row["band"]: BandReference.model_validate(row) for row in _read("bands_2006.csv")}


def table5_2006() -> dict[str, Table5Row]:
    """Table 5 of the paper (AVIRIS-NG over the 2006 burn plot), by region."""
    return {row["region"]: Table5Row.model_validate(row) for row in _read("table5_2006.csv")}


def figure12_2006() -> dict[str, Figure12Row]:
    """Differences of figure 12's indices as the text states them, by index."""
    return {row["index"]: Figure12Row.model_validate(row) for row in _read("figure12_2006.csv")}


def consistent_targets(*, independent: bool = False) -> tuple[Target, ...]:
    """Numbers of the real 2006 image that are fit to calibrate against.

    The four derived band means, the means of the nineteen indices whose formula is known, and
    those of their standard deviations that do not contradict the formulas.

    **Arguments:** `independent`: leave out rows that are exact affine functions of another one
    (IPVI, NDWI, NormNIR, GRVI), which would count the same measurement twice.

    **Returns:** a `Target` for each number, reflectance and indices [-].
    """
    bands, table = bands_2006(), table4_2006()
    targets = [Target(name, "mean", bands[name].real_mean, derived=True) for name in BANDS]
    for name, row in table.items():
        if row.formula_confidence == "open" or (independent and row.affine_of):
            continue
        targets.append(Target(name, "mean", row.real_mean, derived=False))
        if row.std_consistent:
            targets.append(Target(name, "std", row.real_std, derived=False))
    return tuple(targets)


def _read(name: str) -> list[dict[str, str]]:
    text = (files("fynjax.app.compare") / "data" / name).read_text(encoding="utf-8")
    return list(csv.DictReader(text.splitlines()))

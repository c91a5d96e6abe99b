"""The published statistics of the 2006 burn plot, and which of them a calibration may use."""

import csv
from dataclasses import dataclass
from importlib.resources import files
from typing import Literal

from fynjax.metrics import BANDS, VEGETATION_INDICES


@dataclass(frozen=True)
class Table4Row:
    """One row of the paper's table 4: an index over the real and the paper's simulated image."""

    index: str
    real_mean: float
    real_std: float
    sim_mean: float
    sim_std: float
    histogram_intersection: float
    ks: float
    formula: str
    """Inferred form; G, R, RE, N are the bands."""
    formula_confidence: Literal["exact", "firm", "open"]
    std_consistent: bool | None
    """Whether the printed real std obeys the formula and the other rows; None if no one knows."""
    affine_of: str | None
    """Row of which this one is an exact affine function, so that it adds no information."""


@dataclass(frozen=True)
class BandReference:
    """Published comparison of one drone band."""

    band: str
    real_mean: float
    """Mean reflectance of the real image [-]: derived from table 4, not printed."""
    sim_abs_difference: float
    """Difference of the paper's simulated from the real mean, over the latter [-]; no sign."""


@dataclass(frozen=True)
class Table5Row:
    """Published agreement of the simulated with the real spectrometer spectrum in one region."""

    region: str
    """Name in `SPECTRAL_REGIONS`."""
    spectral_angle: float
    """[degrees]"""
    rmse: float
    """[-]"""
    nrmse: float
    """RMSE over the range of the real spectrum [-]."""
    correlation: float
    """[-]"""


@dataclass(frozen=True)
class Figure12Row:
    """Published difference of one index between the real and the simulated mean spectrum."""

    index: str
    lower: float
    """Smallest absolute difference that the text allows, over the real value [-]."""
    upper: float
    """Largest one; equal to `lower` where the text gives one number."""
    simulated_higher: bool | None
    """None where the text gives no sign."""


@dataclass(frozen=True)
class Target:
    """One number of the real image that a simulation can be calibrated against."""

    name: str
    """A band (`green`, ...) or an index (`NDVI`, ...)."""
    statistic: Literal["mean", "std"]
    value: float
    """[-]"""
    derived: bool
    """True if the number is inferred from the printed ones."""

    @property
    def key(self) -> str:
        """'<band or index>.<statistic>', as statistics tables name it."""
        return f"{self.name}.{self.statistic}"


def table4_2006() -> dict[str, Table4Row]:
    """Table 4 of the paper (2006 burn plot), by index name. Source: `data/README.md`.

    >>> from fynjax.compare import table4_2006
    >>> len(table4_2006())
    20
    """
    consistent = {"true": True, "false": False, "open": None}
    rows = {}
    for row in _read("table4_2006.csv"):
        rows[row["index"]] = Table4Row(
            index=row["index"],
            real_mean=float(row["real_mean"]),
            real_std=float(row["real_std"]),
            sim_mean=float(row["sim_mean"]),
            sim_std=float(row["sim_std"]),
            histogram_intersection=float(row["histogram_intersection"]),
            ks=float(row["ks"]),
            formula=row["formula"],
            formula_confidence=row["formula_confidence"],  # type: ignore[arg-type]
            std_consistent=consistent[row["std_consistent"]],
            affine_of=row["affine_of"] or None,
        )
    return rows


def bands_2006() -> dict[str, BandReference]:
    """Band means of the real image and figure 9's differences, by band name."""
    return {
        row["band"]: BandReference(
            band=row["band"],
            real_mean=float(row["real_mean_derived"]),
            sim_abs_difference=float(row["sim_abs_difference_percent"]) / 100.0,
        )
        for row in _read("bands_2006.csv")
    }


def table5_2006() -> dict[str, Table5Row]:
    """Table 5 of the paper (AVIRIS-NG over the 2006 burn plot), by region."""
    return {
        row["region"]: Table5Row(
            region=row["region"],
            spectral_angle=float(row["spectral_angle_deg"]),
            rmse=float(row["rmse"]),
            nrmse=float(row["nrmse_percent"]) / 100.0,
            correlation=float(row["correlation"]),
        )
        for row in _read("table5_2006.csv")
    }


def figure12_2006() -> dict[str, Figure12Row]:
    """What the text says of figure 12's index differences, by index."""
    return {
        row["index"]: Figure12Row(
            index=row["index"],
            lower=float(row["lower_percent"]) / 100.0,
            upper=float(row["upper_percent"]) / 100.0,
            simulated_higher={"true": True, "": None}[row["simulated_higher"]],
        )
        for row in _read("figure12_2006.csv")
    }


def consistent_targets(*, independent: bool = False) -> tuple[Target, ...]:
    """Numbers of the real 2006 image that are fit to calibrate against.

    The four derived band means, the means of the nineteen indices whose formula is known, and
    those of their standard deviations that do not contradict the formulas.

    **Arguments:**

    - `independent`: leave out rows that are exact affine functions of another one (IPVI, NDWI,
      NormNIR, RVI), which would count the same measurement twice.

    **Returns:** a `Target` for each number, reflectance and indices [-].
    """
    bands, table = bands_2006(), table4_2006()
    targets = [Target(name, "mean", bands[name].real_mean, derived=True) for name in BANDS]
    for name in VEGETATION_INDICES:
        row = table[name]
        if row.formula_confidence == "open" or (independent and row.affine_of):
            continue
        targets.append(Target(name, "mean", row.real_mean, derived=False))
        if row.std_consistent:
            targets.append(Target(name, "std", row.real_std, derived=False))
    return tuple(targets)


def _read(name: str) -> list[dict[str, str]]:
    text = (files("fynjax.compare") / "data" / name).read_text(encoding="utf-8")
    return list(csv.DictReader(text.splitlines()))

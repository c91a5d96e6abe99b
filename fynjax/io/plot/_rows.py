"""Rows of the tables a user writes, as pydantic models: crowns, statistics, sky; `fynjax.scene` has
those of species and leaves."""

from typing import ClassVar, Literal

from pydantic import Field, ValidationInfo, field_validator, model_validator

from fynjax.io.text import Slip, Strict, number, quantity
from fynjax.scene import PARAMETERS, SpeciesRow


class CrownRow(Strict):
    """One row of the table of crowns: one plant whose place and size are known."""

    slips: ClassVar[dict[str, Slip]] = {
        "diameter_cm": SpeciesRow.slips["mean_diameter_cm"],
        "height_m": SpeciesRow.slips["height_max_m"],
    }

    taxon: str = Field(
        description="Name as in the species table. For the leaves of one crown alone give it a "
        "name and a row of its own there.",
        min_length=1,
    )
    x_m: float | None = number("Foot, east of the plot's south-west corner", "m", default=None)
    y_m: float | None = number("Foot, north of the plot's south-west corner", "m", default=None)
    easting_m: float | None = number(
        "Foot, easting in the coordinates of the plot's maps, instead of x_m and y_m",
        "m",
        default=None,
    )
    northing_m: float | None = number(
        "Foot, northing in the coordinates of the plot's maps, instead of x_m and y_m",
        "m",
        default=None,
    )
    diameter_cm: float = quantity(
        PARAMETERS["diameter"], note="of this crown, the mean of its two extents"
    )
    height_m: float = quantity(PARAMETERS["height"], note="of this plant")

    @model_validator(mode="after")
    def _one_place(self) -> "CrownRow":
        own, on_map = (self.x_m, self.y_m), (self.easting_m, self.northing_m)
        if (None in own) == (None in on_map) or own.count(None) == 1 or on_map.count(None) == 1:
            raise ValueError(
                "expected either x_m and y_m, from the plot's south-west corner, or easting_m and "
                "northing_m, in the coordinates of its maps"
            )
        return self


class StatisticRow(Strict):
    """One row of a target file: a statistic of a real image."""

    unique = "statistic"

    statistic: str = Field(
        description="'<band or index>.<mean|std|qNN|stdNNcm>', such as 'nir.mean', 'NDVI.std', "
        "'GCI.q25', 'nir.std40cm' (of means over squares of 40 cm).",
        pattern=r"^[A-Za-z][A-Za-z0-9_]*\.(mean|std(\d{1,4}cm)?|q\d{1,2})$",
    )
    value: float = number("Value of the statistic; a reflectance is a fraction", "-")
    sd: float | None = number(
        "Standard deviation of the value; empty takes calibration.target_sd (ten times that for a "
        "std)",
        "-",
        default=None,
        gt=0,
    )

    @property
    def subject(self) -> str:
        """The band or index that the statistic is of."""
        return self.statistic.rpartition(".")[0]

    @field_validator("value")
    @classmethod
    def _possible(cls, value: float, info: ValidationInfo) -> float:
        if info.data.get("statistic", "").endswith(".std") and value < 0:
            raise ValueError(f"expected a standard deviation of at least 0, but got {value:g}")
        return value


class ParameterRow(Strict):
    """One row of the parameters that `calibrate` and `posterior` write; name and estimate, and the
    unit of covers and lengths, are enough to be read as `scene.parameters`."""

    unique = "name"

    name: str = Field(description="Such as 'species.Erica irregularis.cover'.", min_length=1)
    kind: str | None = Field(default=None, description="Last word of the name.")
    unit: str | None = Field(
        default=None,
        description="Unit of the numbers; '%' of a cover, 'cm' of a length. Empty: '-', m.",
    )
    prior: float | None = number("Median of the prior", "as stated", default=None)
    prior_sd: float | None = number("Standard deviation of the prior", "as stated", default=None)
    prior_q05: float | None = number("Quantile of 5 % of the prior", "as stated", default=None)
    prior_q95: float | None = number("Quantile of 95 % of the prior", "as stated", default=None)
    estimate: float = number("Value that is used", "as stated")
    sd: float | None = number("Standard deviation of the estimate", "as stated", default=None)
    lower: float | None = number("Least plausible value", "as stated", default=None)
    upper: float | None = number("Largest plausible value", "as stated", default=None)
    q05: float | None = number("Quantile of 5 % of the estimate", "as stated", default=None)
    median: float | None = number("Median of draws", "as stated", default=None)
    q95: float | None = number("Quantile of 95 % of the estimate", "as stated", default=None)
    constrained: float | None = number(
        "Share of the prior variance that the data removed", "-", default=None
    )
    ess_bulk: float | None = number("Effective draws, of the bulk", "-", default=None)
    ess_tail: float | None = number("Effective draws, of the tails", "-", default=None)
    r_hat: float | None = number("Disagreement of chains", "-", default=None)


class StructureRow(Strict):
    """One row of a target file: a structure metric of a real point cloud."""

    unique = "metric"

    metric: Literal[
        "foliage_height_diversity",
        "gap_fraction",
        "leaf_area_density_mean",
        "leaf_area_density_std",
        "rugosity",
        "height_cv",
    ] = Field(description="A metric of `fynjax validate`, mean over the cells of the plot.")
    value: float = number("Value of the metric, in its unit", "-", ge=0)
    sd: float | None = number(
        "Standard deviation of the value; empty: not known", "-", default=None, gt=0
    )
    grain_m: float = number("Side of a cell; the same in all rows", "m", default=2.0, gt=0)
    returns_m2: float = number(
        "Returns for each square metre; the same in all rows", "m-2", default=100.0, gt=0
    )


class SkyPatternRow(Strict):
    """One direction of a pattern of the sky."""

    slips: ClassVar[dict[str, Slip]] = {
        "zenith_deg": lambda v: "Is it the elevation?" if v > 90 else None
    }
    zenith_deg: float = number("Zenith angle of the direction", "degree", ge=0, le=90)
    azimuth_deg: float = number(
        "Azimuth of the direction, clockwise from north", "degree", ge=0, lt=360
    )
    radiance: float = number("Radiance of the sky there, in any unit", "-", ge=0)


class SkyRow(Strict):
    """One row of a sky table."""

    slips: ClassVar[dict[str, Slip]] = {
        "wavelength_nm": lambda v: f"Micrometres? In nm this is {v * 1e3:g}." if v < 100 else None,
        "diffuse_fraction": lambda v: f"Percent? This is {v / 100:g}." if v > 1 else None,
    }
    wavelength_nm: float = number("Wavelength", "nm", ge=300, le=2600)
    diffuse_fraction: float = number(
        "Diffuse over global irradiance on the ground", "-", ge=0, le=1
    )

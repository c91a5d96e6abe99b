"""Rows of the tables a user writes, as pydantic models: species, leaves, statistics, sky."""

from typing import TYPE_CHECKING, ClassVar, Literal

from pydantic import ConfigDict, Field, model_validator

from fynjax.canopy import FORMS
from fynjax.io.text import Slip, Strict, number, optional_quantity, quantity
from fynjax.scene import FIXED_PARAMETERS, PARAMETERS

if TYPE_CHECKING:
    FormName = str
else:  # the names as a choice: in errors, and as an enumeration of the schema
    FormName = Literal[tuple(FORMS)]

_BRANCHES = FIXED_PARAMETERS["branches"]
_OF_THE_FORM = "that of the growth form if left out"


def _diameter_slip(value: float) -> str | None:
    if 0 < value < 1:
        return f"Metres? In cm this is {value * 100:g}."
    return "Millimetres?" if value > 1000 else None


class SpeciesRow(Strict):
    """One row of the species table: what a field crew notes of one taxon in one plot."""

    slips: ClassVar[dict[str, Slip]] = {
        "mean_diameter_cm": _diameter_slip,
        "height_max_m": lambda v: f"Centimetres? In m this is {v / 100:g}." if v > 20 else None,
        "fill_percent": lambda v: "A crown must hold some plant." if v == 0 else None,
    }

    taxon: str = Field(description="Scientific name, or 'Deadwood'.", min_length=1)
    mean_diameter_cm: float = quantity(PARAMETERS["diameter"])
    cover_percent: float = quantity(PARAMETERS["cover"])
    height_max_m: float = quantity(PARAMETERS["height"])
    growth_form: FormName | None = Field(
        default=None,
        description="Shape of the plant. May be left out for a taxon of the shipped table.",
    )
    packing_percent: float | None = optional_quantity(PARAMETERS["packing"])
    fill_percent: float | None = optional_quantity(PARAMETERS["fill"])
    branches: int | None = Field(
        default=None,
        description=f"{_BRANCHES.name} [-]. {_BRANCHES.description}",
        ge=int(_BRANCHES.lower),
        le=int(_BRANCHES.upper),
        json_schema_extra={"unit": "-"},
    )
    rotation_spread_deg: float | None = quantity(FIXED_PARAMETERS["rotation_spread"], default=None)
    leaf_area_index: float | None = quantity(
        PARAMETERS["leaf_area_index"], default=None, note=_OF_THE_FORM
    )
    minimum_object_area_m2: float | None = quantity(FIXED_PARAMETERS["minimum_area"], default=None)
    wood_area_index: float | None = quantity(
        PARAMETERS["wood_area_index"], default=None, note=_OF_THE_FORM
    )
    plant: str | None = Field(
        default=None,
        description="Mesh of one plant (OBJ, PLY, STL, GLB; metres), or the elements.csv that "
        "`fynjax plant` writes; a path from the table's folder. Its areas over its crown are "
        "the area indices where the table leaves these out, and count once where crowns overlap, "
        "as these do. Left out: the growth form's shape.",
    )
    shoot_clumping: float | None = quantity(
        PARAMETERS["shoot_clumping"], default=None, note=_OF_THE_FORM
    )
    dead_fraction: float | None = quantity(
        PARAMETERS["dead_fraction"], default=None, note=_OF_THE_FORM
    )


class CrownRow(Strict):
    """One row of the table of crowns: one plant whose place and size are known."""

    slips: ClassVar[dict[str, Slip]] = {
        "diameter_cm": _diameter_slip,
        "height_m": lambda v: f"Centimetres? In m this is {v / 100:g}." if v > 20 else None,
    }

    taxon: str = Field(
        description="Name as in the species table. For the leaves of one crown alone give it a "
        "name and a row of its own there.",
        min_length=1,
    )
    x_m: float | None = number("Foot, east of the plot's south-west corner", "m", default=None)
    y_m: float | None = number("Foot, north of it", "m", default=None)
    easting_m: float | None = number(
        "Foot in the coordinates of the plot's maps, instead of x_m and y_m", "m", default=None
    )
    northing_m: float | None = number("The same, northward", "m", default=None)
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


def _per_area_slip(value: float) -> str | None:
    if value >= 5:
        return f"g m-2? In g cm-2 (or cm of water) this is {value / 1e4:g}."
    return f"mg cm-2 or mm? Here it would be {value / 1000:g}." if value > 0 else None


PROSPECT_REQUIRED = ("chlorophyll", "carotenoids", "water", "dry_matter")
"""PROSPECT columns that a row has all of, or a spectrum."""


class LeafRow(Strict):
    """One row of the leaf table: PROSPECT parameters of a taxon, or a spectrum to fit."""

    model_config = ConfigDict(
        extra="forbid",
        frozen=True,
        json_schema_extra={
            "oneOf": [
                {"required": ["spectrum"], "properties": {"spectrum": {"type": "string"}}},
                {
                    "required": list(PROSPECT_REQUIRED),
                    "properties": {name: {"type": "number"} for name in PROSPECT_REQUIRED},
                },
            ]
        },
    )
    slips: ClassVar[dict[str, Slip]] = {"water": _per_area_slip, "dry_matter": _per_area_slip}

    taxon: str = Field(
        description="Name as in the species table; '*' is every taxon without a row of its own.",
        min_length=1,
    )
    structure: float | None = quantity(
        PARAMETERS["structure"], default=None, note="computed from dry matter if left out"
    )
    chlorophyll: float | None = quantity(PARAMETERS["chlorophyll"], default=None)
    carotenoids: float | None = quantity(PARAMETERS["carotenoids"], default=None)
    anthocyanins: float | None = optional_quantity(PARAMETERS["anthocyanins"])
    brown_pigments: float | None = optional_quantity(PARAMETERS["brown_pigments"])
    water: float | None = quantity(PARAMETERS["water"], default=None)
    dry_matter: float | None = quantity(PARAMETERS["dry_matter"], default=None)
    spectrum: str | None = Field(
        default=None, description="Measured reflectance to fit; a path from the table's folder."
    )

    @model_validator(mode="after")
    def _one_source(self) -> "LeafRow":
        given = [n for n in ("structure", *PROSPECT_REQUIRED) if getattr(self, n) is not None]
        if self.spectrum is not None and given:
            raise ValueError(
                f"expected PROSPECT parameters or a spectrum, but got both ({given[0]!r} and "
                "'spectrum'). Leave one empty."
            )
        if self.spectrum is None and (missing := [n for n in PROSPECT_REQUIRED if n not in given]):
            raise ValueError(
                f"expected {', '.join(PROSPECT_REQUIRED)}, or a spectrum, but "
                f"{', '.join(missing)} is empty"
            )
        return self


class StatisticRow(Strict):
    """One row of a target file: a statistic of a real image."""

    statistic: str = Field(
        description="'<band or index>.<mean|std|qNN|stdNNcm>', such as 'nir.mean', 'NDVI.std', "
        "'GCI.q25', 'nir.std40cm' (of means over squares of 40 cm).",
        pattern=r"^[A-Za-z][A-Za-z0-9_]*\.(mean|std(\d{1,4}cm)?|q\d{1,2})$",
    )
    value: float = number("Its value; a reflectance is a fraction", "-")
    sd: float | None = number(
        "Its standard deviation; empty takes calibration.target_sd (ten times that for a std)",
        "-",
        default=None,
        gt=0,
    )


class ParameterRow(Strict):
    """One row of the parameters that `calibrate` and `posterior` write; name and estimate, and the
    unit of covers and lengths, are enough to be read as `scene.parameters`."""

    name: str = Field(description="Such as 'species.Erica irregularis.cover'.", min_length=1)
    kind: str | None = Field(default=None, description="Last word of the name.")
    unit: str | None = Field(
        default=None, description="Of the numbers; '%' of a cover, 'cm' of a length. Empty: '-', m."
    )
    prior: float | None = number("Median of the prior", "as stated", default=None)
    prior_sd: float | None = number("Its standard deviation", "as stated", default=None)
    prior_q05: float | None = number("Its quantile of 5 %", "as stated", default=None)
    prior_q95: float | None = number("Its quantile of 95 %", "as stated", default=None)
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

    metric: Literal[
        "foliage_height_diversity",
        "gap_fraction",
        "leaf_area_density_mean",
        "leaf_area_density_std",
        "rugosity",
        "height_cv",
    ] = Field(description="A metric of `fynjax validate`, mean over the cells of the plot.")
    value: float = number("Its value, in the metric's unit", "-", ge=0)
    sd: float | None = number("Its standard deviation; empty: not known", "-", default=None, gt=0)
    grain_m: float = number("Side of a cell; the same in all rows", "m", default=2.0, gt=0)
    returns_m2: float = number(
        "Returns for each square metre; the same in all rows", "m-2", default=100.0, gt=0
    )


class SkyPatternRow(Strict):
    """One direction of a pattern of the sky."""

    slips: ClassVar[dict[str, Slip]] = {
        "zenith_deg": lambda v: "Is it the elevation?" if v > 90 else None
    }
    zenith_deg: float = number("From straight up", "degree", ge=0, le=90)
    azimuth_deg: float = number("Clockwise from north", "degree", ge=0, lt=360)
    radiance: float = number("Of the sky, in any unit", "-", ge=0)


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

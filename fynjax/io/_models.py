"""The files a user writes and the summary a run returns, as pydantic models.

The JSON Schemas in `data_schemas/` are made from these classes; `unit` and `slip` feed the
sentences of `InputError`.
"""

from collections.abc import Callable
from typing import Annotated, Any, ClassVar, Literal

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, model_validator

GrowthForm = Literal[
    "upright_ericoid", "rounded_shrub", "tussock", "broad_leaved", "climber", "deadwood"
]
"""Shapes a plant can have."""

Slip = Callable[[float], str | None]


def number(
    description: str,
    unit: str,
    *,
    default: Any = ...,
    gt: float | None = None,
    ge: float | None = None,
    lt: float | None = None,
    le: float | None = None,
) -> Any:
    """A finite number with a range and a unit, both told to the user when missed."""
    return Field(
        default,
        description=f"{description} [{unit}].",
        gt=gt,
        ge=ge,
        lt=lt,
        le=le,
        allow_inf_nan=False,
        json_schema_extra={"unit": unit},
    )


class Strict(BaseModel):
    """A record that takes no unknown names and cannot be changed."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    slips: ClassVar[dict[str, Slip]] = {}
    """For a field, what a value outside its range was probably meant to be."""


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
    mean_diameter_cm: float = number("Mean crown diameter", "cm", ge=1, le=1000)
    cover_percent: float = number("Share of the ground under the crowns", "%", ge=0, le=100)
    height_max_m: float = number("Greatest height in the plot", "m", gt=0, le=20)
    growth_form: GrowthForm | None = Field(
        default=None,
        description="Shape of the plant. May be left out for a taxon of the shipped table.",
    )
    packing_percent: float | None = number(
        "Share of a crown that lies over its neighbours, PE of equation (8)",
        "%",
        default=None,
        ge=0,
        lt=100,
    )
    fill_percent: float | None = number(
        "Share of the crown circle that the plant fills, FF of equation (9)",
        "%",
        default=None,
        gt=0,
        le=100,
    )
    branches: int | None = Field(
        default=None,
        description="Branch models that make up one plant [-].",
        ge=1,
        le=1000,
        json_schema_extra={"unit": "-"},
    )
    rotation_spread_deg: float | None = number(
        "Spread of the tilt of the branches, sigma_rot of equation (5)",
        "degree",
        default=None,
        ge=0,
        le=90,
    )
    leaf_area_index: float | None = number(
        "One-sided leaf area over the crown's own ground area", "m2 m-2", default=None, ge=0, le=20
    )
    minimum_object_area_m2: float | None = number(
        "Least ground area that one plant counts for", "m2", default=None, ge=0, le=100
    )
    wood_area_index: float | None = number(
        "One-sided wood area over the crown's own ground area", "m2 m-2", default=None, ge=0, le=20
    )
    shoot_clumping: float | None = number(
        "Probability that light which a leaf scatters meets another leaf of its shoot",
        "-",
        default=None,
        ge=0,
        le=0.8,
    )


def _per_area_slip(value: float) -> str | None:
    if value >= 5:
        return f"g m-2? In g cm-2 (or cm of water) this is {value / 1e4:g}."
    return f"mg cm-2 or mm? Here it would be {value / 1000:g}." if value > 0 else None


PROSPECT_REQUIRED = ("structure", "chlorophyll", "carotenoids", "water", "dry_matter")
"""PROSPECT columns without a default: a row has all of them, or a spectrum."""


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
    structure: float | None = number("Structure parameter N", "-", default=None, ge=1, le=5)
    chlorophyll: float | None = number("Chlorophyll a+b", "ug cm-2", default=None, ge=0, le=150)
    carotenoids: float | None = number("Carotenoids", "ug cm-2", default=None, ge=0, le=50)
    anthocyanins: float | None = number(
        "Anthocyanins; 0 if left out", "ug cm-2", default=None, ge=0, le=50
    )
    brown_pigments: float | None = number(
        "Brown pigments; 0 if left out", "-", default=None, ge=0, le=5
    )
    water: float | None = number("Equivalent water thickness", "cm", default=None, ge=0, le=0.2)
    dry_matter: float | None = number(
        "Dry matter, leaf mass per area", "g cm-2", default=None, ge=0, le=0.1
    )
    spectrum: str | None = Field(
        default=None, description="Measured reflectance to fit; a path from the table's folder."
    )

    @model_validator(mode="after")
    def _one_source(self) -> "LeafRow":
        given = [n for n in PROSPECT_REQUIRED if getattr(self, n) is not None]
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
        description="'<band or index>.<mean|std|qNN>', such as 'nir.mean', 'NDVI.std', 'GCI.q25'.",
        pattern=r"^[A-Za-z][A-Za-z0-9_]*\.(mean|std|q\d{1,2})$",
    )
    value: float = number("Its value; a reflectance is a fraction", "-")
    sd: float | None = number(
        "Its standard deviation; empty takes calibration.target_sd (25 times that for a std)",
        "-",
        default=None,
        gt=0,
    )


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


def _size_is_positive(value: float | tuple[float, float]) -> float | tuple[float, float]:
    for side in value if isinstance(value, tuple) else (value,):
        if not 0.5 <= side <= 1000:
            raise ValueError(f"expected sides of 0.5 to 1000 m, but got {side:g}")
    return value


Size = Annotated[float | tuple[float, float], AfterValidator(_size_is_positive)]


class PlotTable(Strict):
    """The plot and the files that describe it."""

    name: str = Field(
        default="plot", description="Name in titles and file attributes.", min_length=1
    )
    size_m: Size = Field(
        description="Side of the square plot, or [east-west, north-south] [m]; 0.5 to 1000.",
        json_schema_extra={"unit": "m"},
    )
    voxel_m: float = number("Side of a voxel", "m", default=0.1, ge=0.01, le=2)
    boundary: Literal["periodic", "open"] = Field(
        default="periodic",
        description="'periodic' repeats the plot for ever; 'open' stands alone on bare ground.",
    )
    species_table: str = Field(
        default="species.csv", description="Species table; a path from this file's folder."
    )
    leaf_table: str | None = Field(
        default=None,
        description="Leaf table; a path from this file's folder. Left out: usual leaves.",
    )
    probability_map: str | None = Field(
        default=None, description="GeoTIFF, 0 to 255: where plants are likely to stand."
    )


class SunTable(Strict):
    """Where the sun stands."""

    slips: ClassVar[dict[str, Slip]] = {
        "zenith_deg": lambda v: "At or below the horizon. Is it the elevation?" if v >= 89 else None
    }
    zenith_deg: float = number("Angle from straight up", "degree", default=30.0, ge=0, lt=89)
    azimuth_deg: float = number(
        "Direction to the sun, clockwise from north (90 is east)",
        "degree",
        default=0.0,
        ge=0,
        le=360,
    )


class SkyTable(Strict):
    """What the sky adds to the sun."""

    aerosol_optical_depth: float = number(
        "Aerosol optical depth at 500 nm of the clear-sky model", "-", default=0.1, ge=0, le=2
    )
    table: str | None = Field(
        default=None, description="CSV with wavelength_nm, diffuse_fraction; replaces the model."
    )


class GroundTable(Strict):
    """Soil and litter."""

    soil: str = Field(
        default="dry",
        description="'dry', 'wet', or the path of a spectrum (wavelength_nm, reflectance).",
    )
    brightness: float = number("Factor on the soil's reflectance", "-", default=1.0, ge=0.2, le=2)
    moisture: float | None = number(
        "Share of the wet in the mixed dry and wet soil; not with a spectrum of your own",
        "-",
        default=None,
        ge=0,
        le=1,
    )
    litter_fraction: float = number(
        "Share of the ground under litter", "-", default=0.2, ge=0, le=1
    )

    @model_validator(mode="after")
    def _moisture_is_of_shipped_soil(self) -> "GroundTable":
        if self.moisture is not None and self.soil not in ("dry", "wet"):
            raise ValueError(
                "expected no 'moisture' beside a soil spectrum of your own: it mixes the shipped "
                'dry and wet soil. Leave it out, or set soil = "dry".'
            )
        return self


class SensorTable(Strict):
    """The camera."""

    name: Literal["mavic_3m"] = Field(default="mavic_3m", description="Which sensor.")
    altitude_m: float = number("Height above the ground", "m", default=50.0, ge=5, le=500)
    pixel_m: float = number("Side of a pixel on the ground", "m", default=0.025, ge=0.001, le=5)


class SceneTable(Strict):
    """How the random part of the scene is drawn."""

    seed: int = Field(default=0, description="Seed of everything random [-].", ge=0, lt=2**31)
    softness: float = number(
        "Width over which a new plant of a species fades in, as a share of their number",
        "-",
        default=0.25,
        ge=0,
        le=1,
    )
    softness_plants: float = number(
        "The same in plants, added to it; with both 0 plants appear at once (hard scene)",
        "plants",
        default=1.0,
        ge=0,
        le=10,
    )


DEFAULT_FREE = ("species.*.cover", "species.*.diameter", "species.*.leaf.*", "ground.*")
"""Patterns of parameters that a calibration frees unless told otherwise."""

DEFAULT_RELATIVE_SD = {
    "*.cover": 0.25,
    "*.diameter": 0.25,
    "*.height": 0.15,
    "*.structure": 0.15,
    "*.anthocyanins": 0.5,
    "*.brown_pigments": 0.5,
    "*": 0.3,
}
"""Relative standard deviation of the prior, by pattern; the first that fits is taken. Covers
seen by eye are uncertain by about a quarter."""


class CalibrationTable(Strict):
    """What a calibration may move, and how far it trusts the field table."""

    free: list[str] = Field(
        default_factory=lambda: list(DEFAULT_FREE),
        description="Patterns of the parameters to calibrate, such as 'species.*.cover'.",
        min_length=1,
    )
    targets: list[str] = Field(
        default_factory=lambda: ["*"],
        description="Patterns of the target's statistics to use, such as '*.mean'.",
        min_length=1,
    )
    target_sd: float = number(
        "Relative standard deviation of a mean or quantile that states none",
        "-",
        default=0.02,
        gt=0,
        le=1,
    )
    priors: dict[str, Annotated[float, Field(gt=0, le=10)]] = Field(
        default_factory=dict,
        description="Relative standard deviation of the prior, by pattern [-].",
    )
    max_iterations: int = Field(
        default=7, description="Most steps of the optimiser in a round [-].", ge=1, le=10000
    )


class PlotFile(Strict):
    """`plot.toml`: one plot, its light, its sensor, and what to calibrate."""

    plot: PlotTable
    sun: SunTable = SunTable()
    sky: SkyTable = SkyTable()
    ground: GroundTable = GroundTable()
    sensor: SensorTable = SensorTable()
    scene: SceneTable = SceneTable()
    calibration: CalibrationTable = CalibrationTable()


class ParameterSummary(BaseModel):
    """One parameter, before and after."""

    name: str = Field(description="Name as patterns see it, such as 'species.Restio.cover'.")
    kind: str = Field(description="What it is, such as 'cover'.")
    unit: str
    prior: float
    prior_sd: float | None
    estimate: float
    sd: float | None = Field(description="Standard deviation after the fit.")
    constrained: float | None = Field(
        default=None,
        description="1 - (sd / prior_sd)^2: 0, the data said nothing; 1, they said all [-].",
    )


class StatisticSummary(BaseModel):
    """One statistic of the image, before and after."""

    statistic: str
    fitted: bool | None = Field(default=None, description="Whether the calibration fitted it.")
    target: float | None
    target_sd: float | None = None
    before: float | None
    after: float | None
    reference: float | None = Field(
        default=None, description="Another simulation of the same plot."
    )


class RunSummary(BaseModel):
    """What `--json` prints and `summary.json` holds."""

    model_config = ConfigDict(extra="allow")

    command: str = Field(description="Which command made it, such as 'calibrate'.")
    version: str = Field(description="Version of fynjax.")
    output: str = Field(description="Folder of the files.")
    seed: int
    status: str = Field(description="'ok', or why the answer is to be doubted.")
    converged: bool | None = Field(default=None, description="Null where nothing was fitted.")
    headline: list[str] = Field(
        default_factory=list, description="The result in sentences, as the terminal shows it."
    )
    files: dict[str, str] = Field(
        default_factory=dict, description="What each file is, by its name in the folder."
    )
    timings_s: dict[str, float] = Field(default_factory=dict, description="Seconds by stage [s].")
    parameters: list[ParameterSummary] = Field(default_factory=list)
    statistics: list[StatisticSummary] = Field(default_factory=list)
    warnings: list[str] = Field(default_factory=list)

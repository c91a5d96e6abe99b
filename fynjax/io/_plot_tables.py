"""`plot.toml` and its tables, as pydantic models."""

from typing import Annotated, ClassVar, Literal

from pydantic import AfterValidator, Field, model_validator

from fynjax.io._strict import Slip, Strict, number


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
    terrain: str | None = Field(
        default=None,
        description="GeoTIFF of the height of the ground [m], such as `fynjax terrain` makes; for "
        "a plot with an open boundary.",
    )
    map_origin_m: tuple[float, float] | None = Field(
        default=None,
        description="South-west corner of the plot (x, y) in the coordinates of its maps [m]. Left "
        "out: that of a map as large as the plot.",
        json_schema_extra={"unit": "m"},
    )

    @model_validator(mode="after")
    def _hills_do_not_repeat(self) -> "PlotTable":
        if self.terrain is not None and self.boundary == "periodic":
            raise ValueError(
                'expected boundary = "open" with a terrain, but it is "periodic": hills that '
                "repeat themselves would meet in cliffs"
            )
        return self


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


COVER_FRACTIONS = ("litter_fraction", "char_fraction", "rock_fraction")


class GroundTable(Strict):
    """Soil and what lies on it."""

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
    litter_fraction: float | None = number(
        "Share of the ground under litter; 0.2 if left out", "-", default=None, ge=0, le=1
    )
    char_fraction: float | None = number(
        "Share of the ground under ash and charcoal; 0 if left out", "-", default=None, ge=0, le=1
    )
    rock_fraction: float | None = number(
        "Share of the ground that is rock; 0 if left out", "-", default=None, ge=0, le=1
    )
    litter: str | None = Field(
        default=None, description="Spectrum of the litter (wavelength_nm, reflectance)."
    )
    char: str | None = Field(default=None, description="Spectrum of ash and charcoal.")
    rock: str | None = Field(
        default=None, description="Spectrum of the rock. Left out: as the dry soil."
    )
    patch_m: float = number(
        "Width of the patches in which soil and covers lie; 0 mixes them alike everywhere",
        "m",
        default=0.0,
        ge=0,
        le=100,
    )
    map: str | None = Field(
        default=None,
        description="GeoTIFF with bands litter, char, rock (any of them): shares of 0 to 1 in "
        "their places, instead of fractions and patches.",
    )

    @model_validator(mode="after")
    def _covers_fit(self) -> "GroundTable":
        given = [n for n in COVER_FRACTIONS if getattr(self, n) is not None]
        total = sum(getattr(self, n) for n in given)
        if total > 1:
            raise ValueError(
                f"expected covers of the ground that sum to at most 1, but {', '.join(given)} sum "
                f"to {total:g}. Percent?"
            )
        if self.map is not None and (given or self.patch_m > 0):
            raise ValueError(
                f"expected a map or {(given or ['patch_m'])[0]}, but got both: the map says how "
                "much there is of each cover. Leave one out."
            )
        return self

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

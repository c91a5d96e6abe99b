"""`plot.toml` and its tables, as pydantic models."""

from collections.abc import Iterator
from datetime import datetime
from pathlib import Path
from typing import Annotated, ClassVar, Literal

import jax.numpy as jnp
from pydantic import (
    AfterValidator,
    BeforeValidator,
    Field,
    ValidationInfo,
    field_validator,
    model_validator,
)

from fynjax.app.io.instruments import WayOfCalibration
from fynjax.app.io.plot._calibration import CalibrationTable
from fynjax.app.io.text import NamedFile, Slip, Strict, did_you_mean, in_unit, quantity
from fynjax.canopy import Shrubland
from fynjax.scene import PARAMETERS, CoverDefinition, Placement, PlantingRules
from fynjax.sensors import Frame, Panel, Pose, SunPosition, shipped_sensors, sun_position


def _sides_fit(value: tuple[float, float]) -> tuple[float, float]:
    for side in value:
        if not 0.5 <= side <= 1000:
            raise ValueError(f"expected sides of 0.5 to 1000 m, but got {side:g}")
    return value


Size = Annotated[
    tuple[float, float],
    AfterValidator(_sides_fit),
    BeforeValidator(
        lambda side: side if isinstance(side, list | tuple) else (side, side),
        json_schema_input_type=float | tuple[float, float],
    ),
]
Raster = Annotated[Path, NamedFile("a GeoTIFF")]


class PlotTable(Strict):
    """The plot and the files that describe it."""

    name: str = Field(default="plot", min_length=1)
    """Name in titles and file attributes."""
    size_m: Size = in_unit("m", several=True)
    """Side of the square plot, or [east-west, north-south] [m]; 0.5 to 1000."""
    voxel_m: float = in_unit("m", default=0.1, ge=0.01, le=2)
    """Side of a voxel [m]."""
    structure_m: Annotated[float, Field(ge=0.005, le=2)] | Literal["even"] | None = in_unit(
        "m", default=None, several=True
    )
    """Largest side of the voxels on which sun and sight follow the plants [m]; left out: a quarter
    of voxel_m, but not below 0.025; 'even': leaves fill the voxels of voxel_m evenly, which hides
    gaps."""
    boundary: Literal["periodic", "open"] = "periodic"
    """'periodic' repeats the plot for ever; 'open' stands alone on bare ground."""
    species_table: Annotated[Path, NamedFile("a species table")] = Field(
        default="species.csv", validate_default=True
    )
    """Species table; a path from this file's folder."""
    plants: Shrubland | None = None
    """Whose leaf area, dead tissue, clumping, bark and leaves plants have that the tables leave
    open: 'fynbos', learned from 18 plots, or 'generic', of published shrublands at large, with
    wider priors. Left out: 'generic' where the plot lies outside the Cape (31 to 35 S, 17.5 to 27
    E) by latitude and longitude here or of [sun], by its maps, or by the image that it is
    calibrated to, else 'fynbos'."""
    latitude_deg: float | None = in_unit("degree", default=None, ge=-90, le=90)
    """Latitude of the plot, north; left out, that of [sun] or of the plot's maps [degree]."""
    longitude_deg: float | None = in_unit("degree", default=None, ge=-180, le=180)
    """Longitude of the plot, east; west is negative [degree]."""
    cover_definition: CoverDefinition | None = None
    """Meaning of cover_percent of the species table. 'projected': the share of the ground below the
    crowns of a species, overlap among them counted once, as a relevé notes it; plants are as many
    as have it on average. 'article': crowns are counted in full, less packing and gaps, by equation
    (10) of the article on the example plot. Left out: projected, but for a table with packing,
    fill, branches or a least area, which only equation (10) has."""
    crowns: Annotated[Path, NamedFile("a table of crowns")] | None = None
    """Crowns of the plants, where these are known: a CSV table, or a GeoPackage of points or
    polygons; a path from this file's folder. They replace what is drawn, and give cover, diameter
    and height of each species in place of the species table. Left out: the plants stand by
    chance."""
    leaf_table: Annotated[Path, NamedFile("a leaf table")] | None = None
    """Leaf table; a path from this file's folder. Left out: usual leaves."""
    leaf_spectra: Annotated[Path, NamedFile("a folder of leaf spectra", folder=True)] | None = None
    """Folder of measured leaf spectra (ASD, SVC, CSV ...), whose names or folders begin with the
    taxon, as 'Calluna_vulgaris_001.asd', or a table of file and taxon; a path from this file's
    folder. PROSPECT is fitted once, and kept in the cache of programs. Each taxon has the mean of
    its leaves; others have those of the leaf table."""
    leaf_measurement: Literal["sphere", "leaf-clip", "probe", "stack"] = "sphere"
    """How the spectra of leaf_spectra and of the leaf table were measured: 'sphere', reflectance of
    an integrating sphere, 'leaf-clip' or 'probe' (contact probe), whose lamp shines on the leaf
    over black or over leaf_background, 'stack', an optically thick pile."""
    leaf_background: float | None = in_unit("-", default=None, gt=0, le=1)
    """Reflectance of the face behind the leaf of a clip or probe, such as 0.9 of a white one; left
    out, black [-]."""
    leaf_variants: int = Field(default=1, ge=1, le=50)
    """Different leaves of a taxon of which one leaf is stated, of which each plant has one: drawn
    about it with the spread within species that Californian shrubs have. 1: all plants of a taxon
    have the same leaf."""
    dead_tissue: Annotated[Path, NamedFile("a spectrum of dead tissue")] | None = None
    """Spectrum of dead tissue in live shoots; a CSV file as for soil, a path from this file's
    folder. Left out: bark."""
    hot_spot: bool = False
    """Whether leaves have the size of their growth form, which brightens the plot where sensor and
    sun are in the same direction; takes longer."""
    probability_map: Raster | None = None
    """GeoTIFF, 0 to 255: where plants are likely to stand."""
    terrain: Raster | None = None
    """GeoTIFF of the height of the ground [m], such as `fynjax terrain` makes; for a plot with an
    open boundary."""
    map_origin_m: tuple[float, float] | None = in_unit("m", default=None, several=True)
    """South-west corner of the plot (x, y) in the coordinates of its maps [m]. Left out: that of a
    map as large as the plot."""

    @model_validator(mode="after")
    def _background_of_a_clip(self) -> "PlotTable":
        if self.leaf_background is not None and self.leaf_measurement not in ("leaf-clip", "probe"):
            raise ValueError(
                "expected leaf_background with leaf_measurement = 'leaf-clip' or 'probe', but "
                f"it is {self.leaf_measurement!r}"
            )
        return self

    @model_validator(mode="after")
    def _latitude_and_longitude(self) -> "PlotTable":
        if (self.latitude_deg is None) != (self.longitude_deg is None):
            missing = "latitude_deg" if self.latitude_deg is None else "longitude_deg"
            raise ValueError(
                f"expected latitude_deg and longitude_deg together, but {missing} is missing"
            )
        return self

    @model_validator(mode="after")
    def _hills_do_not_repeat(self) -> "PlotTable":
        if self.terrain is not None and self.boundary == "periodic":
            raise ValueError(
                'expected boundary = "open" with a terrain, but it is "periodic": hills that '
                "repeat themselves would meet in cliffs"
            )
        return self


PLACE_AND_TIME = ("latitude_deg", "longitude_deg", "time")


class SunTable(Strict):
    """Where the sun stands: its angles, or a place and a time."""

    slips: ClassVar[dict[str, Slip]] = {
        "zenith_deg": lambda v: "At or below the horizon. Is it the elevation?" if v >= 89 else None
    }
    zenith_deg: float = quantity(PARAMETERS["sun_zenith"], default=PARAMETERS["sun_zenith"].default)
    azimuth_deg: float = quantity(
        PARAMETERS["sun_azimuth"], default=PARAMETERS["sun_azimuth"].default
    )
    latitude_deg: float | None = in_unit("degree", default=None, ge=-90, le=90)
    """Latitude of the plot, north; with longitude_deg and time instead of the angles [degree]."""
    longitude_deg: float | None = in_unit("degree", default=None, ge=-180, le=180)
    """Longitude of the plot, east; west is negative [degree]."""
    time: datetime | None = None
    """Date and time with its zone, such as 2024-10-30T11:00:00+02:00."""

    @field_validator("time")
    @classmethod
    def _sun_is_up(cls, time: datetime | None, info: ValidationInfo) -> datetime | None:
        north, east = (info.data.get(name) for name in PLACE_AND_TIME[:2])
        lowest = PARAMETERS["sun_zenith"].upper
        if time is not None and north is not None and east is not None:
            zenith = sun_position(north, east, time).zenith
            if zenith > lowest:
                raise ValueError(
                    f"expected the sun at least {90.0 - lowest:g} degree above the horizon, but it "
                    f"is {90.0 - zenith:.2f} degrees above it at that time"
                )
        return time

    @model_validator(mode="after")
    def _angles_or_place_and_time(self) -> "SunTable":
        missing = [name for name in PLACE_AND_TIME if getattr(self, name) is None]
        if 0 < len(missing) < len(PLACE_AND_TIME):
            raise ValueError(
                f"expected {', '.join(PLACE_AND_TIME)} together, but {missing[0]} is missing"
            )
        angles = [n for n in ("zenith_deg", "azimuth_deg") if n in self.model_fields_set]
        if not missing and angles:
            raise ValueError(
                f"expected {angles[0]}, or place and time, but got both: they give the sun. Leave "
                "one out."
            )
        return self

    @property
    def place(self) -> tuple[float, float] | None:
        """Latitude and longitude [degree]; None where the angles are given."""
        north, east = self.latitude_deg, self.longitude_deg
        return None if north is None or east is None else (north, east)

    def position(self, grid_north_deg: float | None = None) -> SunPosition:
        """Where the sun stands, by its angles or by place and time; with the sunlight of the day,
        that at one astronomical unit where no time is given.

        Azimuths count from the plot's north. `grid_north_deg`: its direction, clockwise from true
        north, for those by place and time; `None`: true north.
        """
        if self.time is None or self.latitude_deg is None or self.longitude_deg is None:
            return SunPosition(self.zenith_deg, self.azimuth_deg, 1.0)
        sun = sun_position(self.latitude_deg, self.longitude_deg, self.time)
        return sun._replace(azimuth=(sun.azimuth - (grid_north_deg or 0.0)) % 360.0)


class SkyTable(Strict):
    """What the sky adds to the sun."""

    aerosol_optical_depth: float = quantity(
        PARAMETERS["aerosol"], default=PARAMETERS["aerosol"].default
    )
    table: Annotated[Path, NamedFile("a sky table")] | None = None
    """CSV with wavelength_nm, diffuse_fraction; replaces the model."""
    pattern: Annotated[Path, NamedFile("a pattern of the sky")] | None = None
    """CSV with zenith_deg, azimuth_deg, radiance: where the sky is bright, in any unit, on an even
    grid. Left out: the same from everywhere."""


COVER_FRACTIONS = ("litter_fraction", "char_fraction", "rock_fraction")


def _is_a_shape(value: tuple[float, float, float]) -> tuple[float, float, float]:
    k, theta, rho_c = value
    if not (0.1 <= k <= 2 and -0.9 <= theta <= 0.9 and 0 <= rho_c <= 2):
        raise ValueError(
            "expected k of 0.1 to 2, theta of -0.9 to 0.9 and rho_c of 0 to 2, but got "
            f"{k:g}, {theta:g}, {rho_c:g}"
        )
    return value


Shape = Annotated[tuple[float, float, float], AfterValidator(_is_a_shape)]


class GroundTable(Strict):
    """Soil and what lies on it."""

    soil: Annotated[
        Path | str, NamedFile("'dry', 'wet' or a soil spectrum", words=("dry", "wet"))
    ] = "dry"
    """'dry', 'wet', or the path of a spectrum (wavelength_nm, reflectance)."""
    brightness: float = quantity(PARAMETERS["brightness"], default=PARAMETERS["brightness"].default)
    wood_brightness: float | None = quantity(PARAMETERS["wood_brightness"], optional=True)
    moisture: float | None = quantity(
        PARAMETERS["moisture"],
        default=None,
        note="that of `soil` if left out; not with a spectrum of your own",
    )
    litter_fraction: float | None = quantity(PARAMETERS["litter_fraction"], optional=True)
    char_fraction: float | None = quantity(PARAMETERS["char_fraction"], optional=True)
    rock_fraction: float | None = quantity(PARAMETERS["rock_fraction"], optional=True)
    litter: Annotated[Path, NamedFile("a spectrum of litter")] | None = None
    """Spectrum of the litter (wavelength_nm, reflectance)."""
    char: Annotated[Path, NamedFile("a spectrum of char")] | None = None
    """Spectrum of ash and charcoal."""
    rock: Annotated[Path, NamedFile("a spectrum of rock")] | None = None
    """Spectrum of the rock. Left out: as the dry soil."""
    patch_m: float = in_unit("m", default=0.0, ge=0, le=100)
    """Width of the patches in which soil and covers lie; 0 mixes them alike everywhere [m]."""
    map: Raster | None = None
    """GeoTIFF with bands litter, char, rock (any of them): shares of 0 to 1 in their places,
    instead of fractions and patches."""

    rpv: Shape | None = None
    """k, theta and rho_c of Rahman, Pinty and Verstraete (1993): how the ground reflects more in
    some directions. The spectra are what is measured from above under light from 45 degrees. Not
    with a terrain. Left out: alike in all directions."""

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
    """The sensor, and from where it looks."""

    slips: ClassVar[dict[str, Slip]] = {
        "tilt_deg": lambda v: "A gimbal pitch? Straight down is 0 here." if v == -90 else None
    }

    name: str = "mavic_3m"
    """A shipped sensor, such as 'mavic_3m' or 'aviris_ng'."""
    path: Annotated[Path, NamedFile("a sensor file")] | None = None
    """Sensor file of your own, instead of a name; a path from this file's folder."""
    altitude_m: float | None = in_unit("m", default=None, ge=1, le=1e6)
    """Height above the ground; left out, that of the sensor (mavic_3m: 50) [m]."""
    pixel_m: float | None = in_unit("m", default=None, ge=0.001, le=1e5)
    """Side of a pixel on the ground; left out, that of the sensor (mavic_3m: 0.025) [m]."""
    footprint_m: float | None = in_unit("m", default=None, ge=0.001, le=1e5)
    """Side of the square that a pixel of a measured image averages over, where resampling,
    mosaicking or blur make it another than the pixel's own; left out, that [m]."""
    tilt_deg: float | None = in_unit("degree", default=None, gt=-90, lt=90)
    """Angle of the optical axis from straight down, towards the heading [degree]."""
    heading_deg: float | None = in_unit("degree", default=None, ge=-360, le=360)
    """Direction of flight or of the image's upper edge, clockwise from north [degree]."""
    calibrated_by: WayOfCalibration | None = None
    """How its images became reflectance, which says how far the gains of bands may be off; left
    out, the usual way of the sensor."""
    noise: bool | None = None
    """Whether to draw noise; left out, if the sensor has a model."""
    point_spread: bool = True
    """Whether the optics blur, if the sensor says how."""
    panels: list[Panel] = Field(default=[])
    """Reference panels in the picture; `simulate` then calibrates by them."""

    @field_validator("name")
    @classmethod
    def _is_shipped(cls, name: str) -> str:
        if name not in (known := shipped_sensors()):
            raise ValueError(
                f"expected a shipped sensor ({', '.join(known)}) or a path, but got {name!r}."
                f"{did_you_mean(name, known)}"
            )
        return name

    @model_validator(mode="after")
    def _a_name_or_a_path(self) -> "SensorTable":
        if self.path is not None and "name" in self.model_fields_set:
            raise ValueError("expected name or path, but got both: leave one out")
        return self

    @property
    def placement(self) -> Placement:
        """What is stated of where the sensor is."""
        return Placement(self.altitude_m, self.pixel_m, self.tilt_deg, self.heading_deg)


class TargetTable(SensorTable):
    """What one sensor measured of the plot, and from where: one view of it. Keys of [sensor] that
    are stated here count in place of the plot's; another `name` or `path` has none of them."""

    file: Annotated[Path, NamedFile("a target")]
    """Image (GeoTIFF) or its statistics (CSV), frames of a flight on the ground (the frames.nc of
    `fynjax frames --images`), spectrum, or point cloud or its structure."""
    view: str = ""
    """Name of the view, which stands before its statistics, such as 'dusk' in 'dusk.nir.mean';
    needed where there are two of one kind."""
    position_m: tuple[float, float, float] | None = in_unit("m", default=None, several=True)
    """Where the camera hung, of a single frame that was laid on the map of the plot: east and north
    of the plot's south-west corner, and height above its ground; left out, above its middle [m]."""
    yaw_deg: float = in_unit("degree", default=0.0, ge=-360, le=360)
    """Direction that the frame's upper edge points to, clockwise from north [degree]."""
    pitch_deg: float = in_unit("degree", default=0.0, ge=-90, le=90)
    """Angle by which the camera looked ahead, to the upper edge, from straight down [degree]."""
    roll_deg: float = in_unit("degree", default=0.0, ge=-90, le=90)
    """Angle by which its right side was down [degree]."""
    cameras: Annotated[Path, NamedFile("a table of cameras")] | None = None
    """Table of where the cameras of an orthomosaic were (east_m, north_m, height_m, and where they
    did not look straight down yaw_deg, pitch_deg, roll_deg), such as the frames.csv of `fynjax
    frames`, or a flight plan. Left out, the mosaic is taken for one picture."""
    blend: Literal["nearest", "mean"] = "nearest"
    """What a pixel of the mosaic is: of the nearest camera that saw it, or the mean of all that
    did."""
    sun: SunTable | None = None
    """The sun of this view; left out, that of the plot."""

    def of_sensor(self, own: SensorTable) -> SensorTable:
        """The sensor of the view: `own`, that of the plot, with what is stated here in its
        place. Another sensor has none of the keys of the plot's."""
        names = self.model_fields_set & set(SensorTable.model_fields)
        stated = {name: getattr(self, name) for name in names}
        if not {"name", "path"} & names:
            return own.replace(**stated)
        return SensorTable.model_construct(names, **(dict(SensorTable()) | stated))

    @property
    def frame(self) -> Frame | None:
        """Pose of the frame; None of a camera that looked from above the plot's middle."""
        if self.position_m is None:
            return None
        angles = map(jnp.asarray, (self.yaw_deg, self.pitch_deg, self.roll_deg))
        return Frame(Pose(jnp.asarray(self.position_m), *angles))

    @field_validator("view")
    @classmethod
    def _is_a_word(cls, view: str) -> str:
        if view and (not view.isidentifier() or view in ("spectrum", "lidar")):
            raise ValueError(f"expected one word as the name of a view, but got {view!r}")
        return view

    @model_validator(mode="after")
    def _a_pose_has_a_position(self) -> "TargetTable":
        angles = {"yaw_deg", "pitch_deg", "roll_deg"} & self.model_fields_set
        if angles and self.position_m is None:
            raise ValueError(f"expected position_m with {min(angles)}")
        placed = {"altitude_m", "tilt_deg", "heading_deg", "cameras"} & self.model_fields_set
        if self.position_m is not None and placed:
            raise ValueError(f"expected position_m or {min(placed)}, but got both: leave one out")
        placed -= {"cameras"}
        if self.cameras is not None and placed:
            raise ValueError(f"expected cameras or {min(placed)}, but got both: leave one out")
        if self.cameras is None and "blend" in self.model_fields_set:
            raise ValueError("expected cameras with blend: where those of the mosaic were")
        return self


class AtmosphereTable(Strict):
    """The air between sun, plot and sensor; `render` and `calibrate` do not use it."""

    slips: ClassVar[dict[str, Slip]] = {
        "water_vapour_cm": lambda v: "In mm? Divide by 10." if v > 12 else None,
        "ozone_cm_atm": lambda v: "In Dobson units? Divide by 1000." if v > 1 else None,
        "pressure_hpa": lambda v: "In Pa? Divide by 100." if v > 1100 else None,
    }

    model: Literal["table", "clear-sky", "none"] = "table"
    """'table', computed with 6S; 'clear-sky', the simple model SPCTRL2; 'none', reflectance without
    air."""
    file: Annotated[Path, NamedFile("curves of the air")] | None = None
    """Curves of your own (CSV or NetCDF, such as of MODTRAN), instead of a model; a path from this
    file's folder."""
    water_vapour_cm: float = in_unit("cm", default=1.5, ge=0, le=12)
    """Column of water vapour [cm]."""
    aerosol_optical_depth: float | None = in_unit(
        "-", default=None, ge=PARAMETERS["aerosol"].lower, le=PARAMETERS["aerosol"].upper
    )
    """Optical depth of aerosols at 550 nm; left out, that of [sky] [-]."""
    ozone_cm_atm: float = in_unit("cm-atm", default=0.3, ge=0, le=1)
    """Column of ozone [cm-atm]."""
    pressure_hpa: float = in_unit("hPa", default=1013.25, ge=300, le=1100)
    """Air pressure at the ground, not reduced to sea level [hPa]."""

    @model_validator(mode="after")
    def _a_model_or_a_file(self) -> "AtmosphereTable":
        if self.file is not None and (others := sorted(self.model_fields_set - {"file"})):
            raise ValueError(
                f"expected no {others[0]!r} beside a file of curves, which says all of the air"
            )
        return self

    @property
    def source(self) -> Literal["table", "clear-sky", "none", "file"]:
        """The model, or 'file' where there are curves of the user's."""
        return self.model if self.file is None else "file"


class SceneTable(Strict):
    """How the random part of the scene is drawn."""

    seed: int = Field(default=0, ge=0, lt=2**31)
    """Seed of everything random [-]."""
    size_variation: float = in_unit("-", default=PlantingRules.size_variation, ge=0, le=2)
    """Coefficient of variation of the crown diameters of a species; plants that are wider are
    higher too. With 0 all crowns of a species are alike [-]."""
    spacing_m: float | None = in_unit("m", default=None, gt=0, le=100)
    """Least distance of the plants, r of Bridson's Poisson discs; left out, the largest with which
    there are as many sites as plants [m]."""
    attempts: int = Field(default=PlantingRules.attempts, ge=1, le=1000)
    """Candidates in a row that fail before a site has no more neighbours, k of Bridson [-]."""
    softness: float = in_unit("-", default=0.1, ge=0, le=1)
    """Share of a species' plants over which one more is spread where a slope is taken [-]."""
    softness_plants: float = in_unit("plants", default=1.0, ge=0, le=10)
    """Plants, less one, over which one more is spread besides; with `softness` 0 too, their number
    has no slope [plants]."""
    parameters: Annotated[Path, NamedFile("a table of parameters")] | None = None
    """Table of values that replace those of the other files, such as the parameters.csv of `fynjax
    calibrate`; a path from this file's folder."""


class PlotFile(Strict):
    """`plot.toml`: one plot, its light, its sensor, and what to calibrate."""

    plot: PlotTable
    sun: SunTable = SunTable()
    sky: SkyTable = SkyTable()
    ground: GroundTable = GroundTable()
    sensor: SensorTable = SensorTable()
    atmosphere: AtmosphereTable | None = None
    """The air; left out, a clear one computed with 6S."""
    scene: SceneTable = SceneTable()
    calibration: CalibrationTable = CalibrationTable()
    target: list[TargetTable] = Field(default=[])
    """What was measured of the plot, view by view, where no target is named to the command."""

    @field_validator("target")
    @classmethod
    def _views_differ(cls, targets: list[TargetTable]) -> list[TargetTable]:
        names = [one.view for one in targets if one.view]
        if twice := next((name for name in names if names.count(name) > 1), None):
            raise ValueError(f"expected each view once, but {twice!r} is named twice")
        return targets

    @property
    def named_files(self) -> Iterator[Path]:
        """Files that the tables name."""
        tables = [*(table for _, table in self if isinstance(table, Strict)), *self.target]
        return (value for table in tables for _, value in table if isinstance(value, Path))

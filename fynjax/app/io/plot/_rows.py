"""Tables that a user writes, with their rows as pydantic models: crowns, statistics, sky;
`fynjax.scene` has those of species and leaves."""

import re
from collections.abc import Collection
from pathlib import Path
from typing import ClassVar, Literal

import jax.numpy as jnp
import numpy as np
from pydantic import ConfigDict, Field, ValidationInfo, field_validator, model_validator

from fynjax._core.errors import InputError, names_file
from fynjax._core.tables import open_table
from fynjax.app.io.plot._plot import Floats
from fynjax.app.io.text import Slip, Strict, did_you_mean, in_unit, quantity, read_rows
from fynjax.metrics import VEGETATION_INDICES
from fynjax.scene import PARAMETERS, SpeciesRow
from fynjax.sensors import Pose


class CrownRow(Strict):
    """One row of the table of crowns: one plant whose place and size are known."""

    slips: ClassVar[dict[str, Slip]] = {
        "diameter_cm": SpeciesRow.slips["mean_diameter_cm"],
        "height_m": SpeciesRow.slips["height_max_m"],
    }

    taxon: str = Field(min_length=1)
    """Name as in the species table. For the leaves of one crown alone give it a name and a row of
    its own there."""
    x_m: float | None = in_unit("m", default=None)
    """Foot, east of the plot's south-west corner [m]."""
    y_m: float | None = in_unit("m", default=None)
    """Foot, north of the plot's south-west corner [m]."""
    easting_m: float | None = in_unit("m", default=None)
    """Foot, easting in the coordinates of the plot's maps, instead of x_m and y_m [m]."""
    northing_m: float | None = in_unit("m", default=None)
    """Foot, northing in the coordinates of the plot's maps, instead of x_m and y_m [m]."""
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


_ANGLE = re.compile("yaw|pitch|roll|heading|tilt", re.IGNORECASE)


class CameraRow(Strict):
    """One row of the table of cameras: where a frame of a mosaic was taken. Other columns, such as
    those of `fynjax frames`, are not used, but for angles by other names, which are refused."""

    model_config = ConfigDict(extra="ignore")

    east_m: float = in_unit("m", ge=-1e5, le=1e5)
    """East of the plot's south-west corner [m]."""
    north_m: float = in_unit("m", ge=-1e5, le=1e5)
    """North of the plot's south-west corner [m]."""
    height_m: float = in_unit("m", gt=0, le=1e4)
    """Height above the mean level of the plot's ground [m]."""
    yaw_deg: float = in_unit("degree", default=0.0, ge=-360, le=360)
    """Direction of the picture's upper edge, clockwise from north [degree]."""
    pitch_deg: float = in_unit("degree", default=0.0, ge=-90, le=90)
    """Angle of looking ahead from straight down [degree]."""
    roll_deg: float = in_unit("degree", default=0.0, ge=-180, le=180)
    """Angle by which the camera's right side was down [degree]."""


@names_file
def read_cameras(path: str | Path) -> tuple[Pose, ...]:
    """Poses of the cameras of a mosaic.

    **Arguments:** `path`: table of `CameraRow`.

    **Raises:** `InputError` for a table that cannot be read, with row and column, and for angles
    under other names.
    """
    poses = []
    for name in open_table(path, "a table of cameras").names:
        if name not in CameraRow.model_fields and _ANGLE.search(name):
            raise InputError(
                f"unknown column {name!r}. Did you mean pitch_deg, counted from straight down (a "
                "gimbal's + 90)?"
            )
    for _, row in read_rows(path, CameraRow, "a table of cameras"):
        angles = map(jnp.asarray, (row.yaw_deg, row.pitch_deg, row.roll_deg))
        poses.append(Pose(jnp.asarray([row.east_m, row.north_m, row.height_m]), *angles))
    return tuple(poses)


class StatisticRow(Strict):
    """One row of a target file: a statistic of a real image."""

    unique = "statistic"

    statistic: str = Field(pattern=r"^[A-Za-z][A-Za-z0-9_]*\.(mean|std(\d{1,4}cm)?|q\d{1,2})$")
    """'<band or index>.<mean|std|qNN|stdNNcm>', such as 'nir.mean', 'NDVI.std', 'GCI.q25',
    'nir.std40cm' (of means over squares of 40 cm)."""
    value: float = in_unit("-")
    """Value of the statistic; a reflectance is a fraction [-]."""
    sd: float | None = in_unit("-", default=None, gt=0)
    """Standard deviation of the value; empty takes calibration.target_sd, and of
    spreads what the model's are off by (`SPREAD_SD`) [-]."""

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

    name: str = Field(min_length=1)
    """Such as 'species.Erica irregularis.cover'."""
    kind: str | None = None
    """Last word of the name."""
    unit: str | None = None
    """Unit of the numbers; '%' of a cover, 'cm' of a length. Empty: '-', m."""
    prior: float | None = in_unit("as stated", default=None)
    """Median of the prior [as stated]."""
    prior_sd: float | None = in_unit("as stated", default=None)
    """Standard deviation of the prior [as stated]."""
    prior_q05: float | None = in_unit("as stated", default=None)
    """Quantile of 5 % of the prior [as stated]."""
    prior_q95: float | None = in_unit("as stated", default=None)
    """Quantile of 95 % of the prior [as stated]."""
    estimate: float = in_unit("as stated")
    """Value that is used, unless another is `offered` [as stated]."""
    sd: float | None = in_unit("as stated", default=None)
    """Standard deviation of the estimate [as stated]."""
    lower: float | None = in_unit("as stated", default=None)
    """Least plausible value [as stated]."""
    upper: float | None = in_unit("as stated", default=None)
    """Largest plausible value [as stated]."""
    q05: float | None = in_unit("as stated", default=None)
    """Quantile of 5 % of the estimate [as stated]."""
    median: float | None = in_unit("as stated", default=None)
    """Median of draws [as stated]."""
    q95: float | None = in_unit("as stated", default=None)
    """Quantile of 95 % of the estimate [as stated]."""
    moved: float | None = in_unit("-", default=None)
    """Distance of the estimate from the prior's centre [prior standard deviations]."""
    constrained: float | None = in_unit("-", default=None)
    """Share of the prior variance that the data removed [-]."""
    offered: float | None = in_unit("as stated", default=None)
    """Value that is used in place of the estimate: of a calibration that is worse than the field
    table the prior's [as stated]."""
    worse_than_table: bool | None = None
    """Whether more bands moved away from what was measured than nearer."""
    ess_bulk: float | None = in_unit("-", default=None)
    """Effective draws, of the bulk [-]."""
    ess_tail: float | None = in_unit("-", default=None)
    """Effective draws, of the tails [-]."""
    r_hat: float | None = in_unit("-", default=None)
    """Disagreement of chains [-]."""


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
    ]
    """A metric of `fynjax validate`, mean over the cells of the plot."""
    value: float = in_unit("-", ge=0)
    """Value of the metric, in its unit [-]."""
    sd: float | None = in_unit("-", default=None, gt=0)
    """Standard deviation of the value; empty: not known [-]."""
    grain_m: float = in_unit("m", default=2.0, gt=0)
    """Side of a cell; the same in all rows [m]."""
    returns_m2: float = in_unit("m-2", default=100.0, gt=0)
    """Returns for each square metre; the same in all rows [m-2]."""


class SkyPatternRow(Strict):
    """One direction of a pattern of the sky."""

    slips: ClassVar[dict[str, Slip]] = {
        "zenith_deg": lambda v: "Is it the elevation?" if v > 90 else None
    }
    zenith_deg: float = in_unit("degree", ge=0, le=90)
    """Zenith angle of the direction [degree]."""
    azimuth_deg: float = in_unit("degree", ge=0, lt=360)
    """Azimuth of the direction, clockwise from north [degree]."""
    radiance: float = in_unit("-", ge=0)
    """Radiance of the sky there, in any unit [-]."""


class SkyRow(Strict):
    """One row of a sky table."""

    slips: ClassVar[dict[str, Slip]] = {
        "wavelength_nm": lambda v: f"Micrometres? In nm this is {v * 1e3:g}." if v < 100 else None,
        "diffuse_fraction": lambda v: f"Percent? This is {v / 100:g}." if v > 1 else None,
    }
    wavelength_nm: float = in_unit("nm", ge=300, le=2600)
    """Wavelength [nm]."""
    diffuse_fraction: float = in_unit("-", ge=0, le=1)
    """Diffuse over global irradiance on the ground [-]."""


@names_file
def read_sky(path: Path) -> tuple[Floats, Floats]:
    """Read how much of the light is diffuse.

    **Arguments:** `path`, a CSV file with the columns of `SkyRow`.

    **Returns:** wavelengths [nm], rising, and diffuse over global irradiance at each [-].

    **Raises:** `InputError` for wavelengths that do not rise, and as
    `fynjax.app.io.text.read_rows`.
    """
    rows = read_rows(path, SkyRow, "a sky table")
    wavelength = np.array([row.wavelength_nm for _, row in rows])
    if (falls := np.flatnonzero(np.diff(wavelength) <= 0)).size:
        raise InputError(
            f"expected rising wavelengths, but {wavelength[falls[0] + 1]:g} follows "
            f"{wavelength[falls[0]]:g}",
            row=rows[falls[0] + 1][0],
            column="wavelength_nm",
        )
    return wavelength, np.array([row.diffuse_fraction for _, row in rows])


@names_file
def read_sky_pattern(path: Path) -> Floats:
    """Read where the sky is bright.

    **Arguments:** `path`, a CSV file with the columns of `SkyPatternRow`.

    **Returns:** relative radiance [zenith, azimuth] at even steps from 0 to 90 degrees and from
    north round clockwise.

    **Raises:** `InputError` for places that are no even grid, and a sky without light.
    """
    rows = [row for _, row in read_rows(path, SkyPatternRow, "a pattern of the sky")]
    zenith = np.unique([row.zenith_deg for row in rows])
    azimuth = np.unique([row.azimuth_deg for row in rows])
    even = len(zenith) > 1 and np.allclose(zenith, np.linspace(0.0, 90.0, len(zenith)), atol=1e-3)
    around = np.allclose(azimuth, np.arange(len(azimuth)) * 360.0 / len(azimuth), atol=1e-3)
    places = {(row.zenith_deg, row.azimuth_deg) for row in rows}
    if not (even and around and len(places) == len(rows) == len(zenith) * len(azimuth)):
        raise InputError(
            "expected every pair of even zenith angles from 0 to 90 degrees and even azimuths from "
            f"0 on once, 360 left out, but got {len(rows)} rows with {len(zenith)} zenith angles "
            f"and {len(azimuth)} azimuths"
        )
    if not any(row.radiance > 0 for row in rows):
        raise InputError("expected some light, but every radiance is 0")
    ordered = sorted(rows, key=lambda row: (row.zenith_deg, row.azimuth_deg))
    return np.array([row.radiance for row in ordered]).reshape(len(zenith), len(azimuth))


@names_file
def read_statistics(path: str | Path, known: Collection[str] | None = None) -> list[StatisticRow]:
    """Read a table of statistics with the columns statistic, value, sd.

    **Arguments:**

    - `path`: a CSV file.
    - `known`: names of bands and indices that can be computed; `None` takes any.

    **Returns:** the rows, in the order of the file.

    **Raises:** `InputError` for an unknown name, a statistic given twice, a standard deviation
    that is not above 0, or a band's reflectance above 1.5 (percent, not a fraction).
    """
    rows = read_rows(path, StatisticRow, "a table of statistics")
    for line, row in rows:
        if known is not None and row.subject not in known:
            words = f"unknown band or index {row.subject!r}.{did_you_mean(row.subject, known)}"
            raise InputError(words, row=line, column="statistic")
        if row.subject not in VEGETATION_INDICES and not 0 <= row.value <= 1.5:
            hint = f" Percent? This is {row.value / 100:g}." if row.value > 1.5 else ""
            raise InputError(
                f"expected a reflectance as a fraction from 0 to 1.5, but got {row.value:g}.{hint}",
                row=line,
                column="value",
            )
    return [row for _, row in rows]


@names_file
def read_structure(path: str | Path) -> list[StructureRow]:
    """Read a table of structure metrics of a point cloud.

    **Arguments:** `path`, a CSV file with the columns metric and value, and, if need be, sd,
    grain_m [m] and returns_m2 [m-2].

    **Returns:** the rows, in the order of the file; at least one, all of one grain and of as many
    returns.

    **Raises:** `InputError` for an unknown metric, one given twice, or rows that differ in grain or
    returns.
    """
    rows = read_rows(path, StructureRow, "a table of structure metrics")
    first = rows[0][1]
    for line, row in rows:
        for column in ("grain_m", "returns_m2"):
            value, known = getattr(row, column), getattr(first, column)
            if value != known:
                words = f"expected the same in all rows, {known:g}, but got {value:g}"
                raise InputError(words, row=line, column=column)
    return [row for _, row in rows]

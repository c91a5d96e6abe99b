"""LiDAR files, read into LiDAR systems."""

from pathlib import Path
from typing import Annotated, ClassVar, Literal

from pydantic import Field, model_validator

from fynjax.app.io.instruments._sensor_tables import InstrumentFile, _nanometre_slip
from fynjax.app.io.text import Slip, Strict, in_unit, read_toml, shipped_or_own
from fynjax.sensors import Lidar, build_lidar, lidar_folder, shipped_lidars

_Finite = Annotated[float, Field(allow_inf_nan=False)]
_Divergence = Annotated[float, Field(ge=0.01, le=100)]
_Range = Annotated[float, Field(ge=0, le=1e6, allow_inf_nan=False)]


class LaserTable(Strict):
    """The light that goes out."""

    slips: ClassVar[dict[str, Slip]] = {
        "wavelength_nm": _nanometre_slip,
        "pulse_fwhm_ns": lambda v: (
            f"Picoseconds? In ns this is {v / 1000:g}." if 100 < v < 1e6 else None
        ),
    }

    wavelength_nm: float = in_unit("nm", ge=400, le=2500)
    """Wavelength [nm]."""
    line_width_nm: float = in_unit("nm", default=1.0, gt=0, le=100)
    """Full width of the line at half maximum [nm]."""
    pulse_fwhm_ns: float = in_unit("ns", ge=0.1, le=100)
    """Full width of the Gaussian pulse at half maximum [ns]."""


class LidarGeometryTable(Strict):
    """What the lines of sight of a flash and of a scanner have in common."""

    kind: Literal["flash", "scan", "mirror"]
    altitude_m: float = in_unit("m", gt=0, le=1e6)
    """Usual height above the ground [m]."""
    pulse_rate_hz: float = in_unit("Hz", gt=0, le=1e8)
    """Pulses (of a flash: frames) in a second [Hz]."""
    pencils: int = Field(default=3, ge=1, le=32)
    """Pencils of light along each side of a pixel or footprint; where single leaves are drawn, each
    pencil hits one [-]."""


class FlashGeometryTable(LidarGeometryTable):
    """Lines of sight of a flash LiDAR: a camera of which each pixel times its own return."""

    slips: ClassVar[dict[str, Slip]] = {
        "half_divergence_rad": lambda v: (
            f"Milliradians? In rad this is {v / 1000:g}." if 1.5 <= v < 1500 else None
        ),
        "focal_length_mm": lambda v: (
            f"Metres? In mm this is {v * 1000:g}." if 0 < v < 0.5 else None
        ),
    }

    kind: Literal["flash"]
    """A camera whose pixels time their own returns."""
    columns: int = Field(ge=1, le=4096)
    """Pixels across [-]."""
    rows: int = Field(ge=1, le=4096)
    """Pixels along [-]."""
    pixel_pitch_um: float = in_unit("um", ge=0.1, le=1000)
    """Distance between pixels on the array [um]."""
    focal_length_mm: float = in_unit("mm", ge=0.5, le=1e4)
    """Focal length [mm]."""
    half_divergence_rad: float = in_unit("rad", gt=0, lt=1.5)
    """From the beam's axis to 1/e2 of the irradiance [rad]."""
    frame_step_m: float = in_unit("m", gt=0, le=1e5)
    """Distance between frames, as many as cover the plot [m]."""


class FlightLinesTable(LidarGeometryTable):
    """Keys of every scanner that flies straight lines."""

    slips: ClassVar[dict[str, Slip]] = {
        "divergence_mrad": lambda v: (
            f"Radians? In mrad this is {v * 1000:g}." if 0 < v < 0.01 else None
        )
    }

    half_scan_angle_deg: float = in_unit("degree", gt=0, le=60)
    """Largest angle from straight down [degree]."""
    line_offsets_m: list[_Finite] | None = in_unit("m", default=None, min_length=1, several=True)
    """Distance of each flight line from the plot's middle, to the right of the heading; left out,
    one line over the middle [m]."""
    heading_deg: float = in_unit("degree", default=0.0, ge=-360, le=360)
    """Direction of the flight, clockwise from north [degree]."""
    speed_m_s: float = in_unit("m s-1", gt=0, le=1000)
    """Speed of the flight [m s-1]."""


class ScanGeometryTable(FlightLinesTable):
    """Lines of sight of a scanner of no known pattern: single pulses, spread evenly."""

    kind: Literal["scan"]
    """Single pulses on straight flight lines, spread evenly over the ground."""
    pulse_density_m2: float = in_unit("m-2", gt=0, le=1e5)
    """Pulses of all flight lines together on level ground [m-2]."""
    divergence_mrad: float = in_unit("mrad", ge=0.01, le=100)
    """Full angle of the beam at 1/e2 of the irradiance [mrad]."""


class MirrorGeometryTable(FlightLinesTable):
    """Lines of sight of a scanner with a mirror: lines across the flight, even in angle."""

    kind: Literal["mirror"]
    """Single pulses in lines across straight flight lines, even in angle and time."""
    scan_rate_hz: float = in_unit("Hz", gt=0, le=1e5)
    """Lines in a second of each channel [Hz]."""
    used_share: float = Field(default=1.0, gt=0, le=1)
    """Share of the pulses that falls into the swath, such as a quarter of a full circle [-]."""
    channel_turns_deg: list[Annotated[float, Field(gt=-60, lt=60)]] | None = in_unit(
        "degree", default=None, min_length=1, several=True
    )
    """Angle by which each channel's lines are turned against straight across the flight, clockwise
    from above; left out, one channel that is not [degree]."""
    divergence_mrad: tuple[_Divergence, _Divergence] = in_unit("mrad", several=True)
    """Full angles of the beam at 1/e2 of the irradiance, across and along the flight [mrad]."""


class ReceiverTable(Strict):
    """What is recorded of the light that comes back, and what counts as a return."""

    slips: ClassVar[dict[str, Slip]] = {
        "sample_m": lambda v: f"Centimetres? In m this is {v / 100:g}." if 5 < v <= 500 else None
    }

    sample_m: float = in_unit("m", ge=0.001, le=5)
    """Length of a sample in range [m]."""
    range_gate_m: tuple[_Range, _Range] | None = in_unit("m", default=None, several=True)
    """Nearest and farthest range that is recorded; left out, from above the canopy to below the
    ground of each pulse [m]."""
    gate_margin_m: float = in_unit("m", default=0.0, ge=0, le=1000)
    """Distance that the record goes on beyond the end of the gate [m]."""
    threshold: float = in_unit("-", default=5.0, gt=0, le=1000)
    """Least height of a return over the noise, in standard deviations of that [-]."""
    max_returns: int = Field(default=5, ge=1, le=15)
    """Most returns that are kept of one pulse [-]."""

    @model_validator(mode="after")
    def _gate_rises(self) -> "ReceiverTable":
        gate = self.range_gate_m
        if gate is not None and gate[1] - gate[0] < self.sample_m:
            raise ValueError(
                f"expected range_gate_m = [nearest, farthest] at least one sample apart, but got "
                f"[{gate[0]:g}, {gate[1]:g}]"
            )
        if gate is None and "gate_margin_m" in self.model_fields_set:
            raise ValueError("gate_margin_m needs range_gate_m: give both or neither")
        return self


class LidarNoiseTable(Strict):
    """Noise of the receiver."""

    signal_electrons: float = in_unit("-", gt=0, le=1e12)
    """Electrons, over all samples, of a white plate that fills the middle beam and faces it at the
    usual altitude [-]."""
    background_electrons: float = in_unit("-", default=0.0, ge=0, le=1e9)
    """Electrons of daylight and dark current in a sample [-]."""
    read_noise_electrons: float = in_unit("electrons", gt=0, le=1e6)
    """Standard deviation of the reading of a sample [electrons]."""
    range_sd_m: float = in_unit("m", default=0.0, ge=0, le=10)
    """Standard deviation of a return's range beside what counting does, such as of the clock
    [m]."""


class LidarFile(InstrumentFile):
    """A LiDAR file: laser, lines of sight, receiver and noise."""

    laser: LaserTable
    geometry: FlashGeometryTable | ScanGeometryTable | MirrorGeometryTable = Field(
        discriminator="kind"
    )
    """A table of lines of sight."""
    receiver: ReceiverTable
    noise: LidarNoiseTable


def load_lidar(name_or_path: str | Path) -> Lidar:
    """A shipped LiDAR by its name, or a LiDAR from a file.

    **Arguments:**

    - `name_or_path`: a name such as 'flash_lidar_paper' (see `fynjax.sensors.shipped_lidars`), or
      the path of a LiDAR file (TOML; `data_schemas/lidar.schema.json`).

    **Returns:** a `fynjax.sensors.Lidar`.

    **Raises:** `InputError` with file, row and key for what cannot be used: unknown keys and
    units, values out of range, keys of another kind of LiDAR.

    >>> from fynjax.app.io.instruments import load_lidar
    >>> load_lidar("scanning_lidar").name
    'scanning_lidar'
    """
    path = shipped_or_own(name_or_path, "LiDAR", shipped_lidars(), lidar_folder())
    description, _ = read_toml(path, LidarFile)
    return build_lidar(description.model_dump(exclude_none=True))

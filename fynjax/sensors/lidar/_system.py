"""Laser scanners and flash cameras: what they send out, record and detect."""

import dataclasses
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import equinox as eqx
import numpy as np

from fynjax._core.errors import InputError
from fynjax.sensors._bands import BandSet
from fynjax.sensors._shipped import sensor_folder
from fynjax.sensors.lidar._beams import (
    FlashGeometry,
    LidarBeams,
    ScanGeometry,
    flash_beams,
    scan_beams,
)

SPEED_OF_LIGHT = 0.299792458
"""Speed of light in vacuum [m ns-1]; air slows it by 0.03 %."""
_FIELDS = {
    "altitude_m": "altitude",
    "frame_step_m": "frame_step",
    "pulse_rate_hz": "rate",
    "pulse_density_m2": "pulse_density",
    "half_scan_angle_deg": "half_scan_angle",
    "line_offsets_m": "line_offsets",
    "heading_deg": "heading",
    "speed_m_s": "speed",
    "scan_rate_hz": "scan_rate",
    "channel_turns_deg": "channel_turns",
}
"""Fields of the geometries by their keys in a file, where these state the unit."""
_TAIL = 4.0
FWHM = float(2.0 * np.sqrt(2.0 * np.log(2.0)))


class LidarNoise(eqx.Module):
    """Counting noise of the receiver: what each sample holds beside the return."""

    signal_electrons: float = eqx.field(static=True, converter=float)
    """Electrons, over all samples, of a white plate that fills the middle beam and faces it at the
    usual altitude [-]."""
    background_electrons: float = eqx.field(static=True, converter=float)
    """Electrons of daylight and dark current in a sample [-]."""
    read_noise_electrons: float = eqx.field(static=True, converter=float)
    """Standard deviation of the reading of a sample [electrons]."""
    range_sd_m: float = eqx.field(static=True, converter=float, default=0.0)
    """Standard deviation of a return's range beside what counting does, such as of the clock
    [m]."""

    @property
    def floor(self) -> float:
        """Standard deviation of a sample without a return [electrons]."""
        return float(np.sqrt(self.background_electrons + self.read_noise_electrons**2))


class Lidar(eqx.Module):
    """A LiDAR: pulse, receiver, lines of sight. All of it is static: it has no gradient.

    `fynjax.sensor` reads one from a file or takes a shipped one by name.
    """

    name: str = eqx.field(static=True)
    """Short name, such as 'flash_lidar_paper'."""
    wavelength: float = eqx.field(static=True)
    """Wavelength of the laser [nm]."""
    line_width: float = eqx.field(static=True)
    """Full width at half maximum of its line [nm]."""
    pulse_length: float = eqx.field(static=True)
    """Full width at half maximum of the Gaussian pulse [ns]."""
    sample: float = eqx.field(static=True)
    """Length of a sample in range [m]; the receiver integrates over it."""
    geometry: FlashGeometry | ScanGeometry
    noise: LidarNoise
    threshold: float = eqx.field(static=True)
    """Least height of a return over the noise, in standard deviations of the noise [-]."""
    max_returns: int = eqx.field(static=True)
    """Most returns that are kept of one pulse."""
    gate: tuple[float, float] | None = eqx.field(static=True, default=None)
    """Nearest and farthest range that is recorded [m]; None: from the canopy's top to the ground
    of each pulse."""
    source: str = eqx.field(static=True, default="")
    """Source of the numbers."""

    @property
    def pulse_sd(self) -> float:
        """Standard deviation of the pulse in range, half its length in space [m]."""
        return 0.5 * SPEED_OF_LIGHT * self.pulse_length / FWHM

    @property
    def bands(self) -> BandSet:
        """The laser's line as a band, to average spectra over."""
        return BandSet(("laser",), (self.wavelength,), (self.line_width,))

    @property
    def pulse_peak(self) -> float:
        """Share of a point's return that its highest sample holds, with the point in its middle."""
        from scipy.special import erf

        return float(erf(0.5 * self.sample / (np.sqrt(2.0) * self.pulse_sd)))

    def at(self, altitude: float) -> "Lidar":
        """The same system at another altitude above the ground [m]; its gate moves along."""
        if not (np.isfinite(altitude) and altitude > 0.0):
            raise InputError(f"`altitude` must be positive [m], but is {altitude}")
        rise = altitude - self.geometry.altitude
        gate = self.gate
        if gate is not None:
            gate = (max(gate[0] + rise, 0.0), gate[1] + rise)
        geometry = dataclasses.replace(self.geometry, altitude=float(altitude))
        # `signal_electrons` is of a plate at the altitude: less of the same pulse comes back.
        signal = (self.geometry.altitude / altitude) ** 2 * self.noise.signal_electrons
        noise = dataclasses.replace(self.noise, signal_electrons=signal)
        return dataclasses.replace(self, geometry=geometry, gate=gate, noise=noise)

    def beams(
        self, extent: tuple[float, float], *, top: float, ground: float = 0.0, seed: int = 0
    ) -> LidarBeams:
        """The pulses of a flight over a plot that is `extent` = (east-west, north-south) [m].

        **Arguments:**

        - `top`: of the voxel grid above its bottom [m], `VoxelScene.height`.
        - `ground`: mean height of the ground above the bottom of the grid [m]; the platform flies
          at the altitude above it.
        - `seed`: where in its cell of the scan pattern each pulse of a scanner goes; of a mirror,
          where in its turn it is at first.

        Raises `InputError` for a sensor below `top`, and where no pulse falls on the plot.
        """
        platform = self.geometry.altitude + ground
        if platform <= top:
            raise InputError(
                f"the LiDAR must fly above the canopy, whose voxels reach to {top:g} m, but is at "
                f"{platform:g} m: pulses begin above the canopy"
            )
        if isinstance(self.geometry, FlashGeometry):
            beams = flash_beams(self.geometry, extent, platform)
        else:
            beams = scan_beams(self.geometry, extent, platform, seed)
        near, far = self._recorded(beams, platform, top)
        samples = int(np.ceil(np.max(far - near) / self.sample - 1e-6))
        return dataclasses.replace(beams, start=near, samples=samples)

    def _recorded(
        self, beams: LidarBeams, platform: float, top: float
    ) -> tuple[np.ndarray, np.ndarray]:
        if self.gate is not None:
            near, far = self.gate
            return np.full(len(beams), near), np.full(len(beams), far)
        # The footprint's edge is farther than its middle.
        slack = _TAIL * self.pulse_sd + self.sample
        slant = np.abs(beams.direction[:, 2])
        tilt = np.sqrt(1.0 - slant**2) / slant
        slack = slack + platform / slant * tilt * np.abs(beams.pencils).max()
        near = np.maximum((platform - top) / slant - slack, 0.0)
        return near, platform / slant + slack


def lidar_folder() -> Path:
    """Folder of the shipped LiDAR files."""
    return sensor_folder() / "lidar"


def shipped_lidars() -> tuple[str, ...]:
    """Names of the shipped LiDAR systems, sorted."""
    return tuple(sorted(path.stem for path in lidar_folder().glob("*.toml")))


def shipped_lidar(name: str) -> Lidar:
    """A shipped LiDAR by name.

    **Arguments:**

    - `name`: one of `shipped_lidars()`, such as "flash_lidar_paper".

    **Raises:** `InputError` for an unknown name.
    """
    if name not in shipped_lidars():
        raise InputError(
            f"expected a shipped LiDAR ({', '.join(shipped_lidars())}), but got {name!r}."
        )
    return build_lidar(tomllib.loads((lidar_folder() / f"{name}.toml").read_text("utf-8")))


def build_lidar(description: Mapping[str, Any]) -> Lidar:
    """A LiDAR from the contents of its file.

    **Arguments:**

    - `description`: tables and keys of the file (`data_schemas/lidar.schema.json`), valid.
    """
    laser, receiver = description["laser"], description["receiver"]
    where = {_FIELDS.get(key, key): value for key, value in description["geometry"].items()}
    kind = where.pop("kind")
    if kind == "flash":
        where["array"] = (where.pop("columns"), where.pop("rows"))
        geometry: FlashGeometry | ScanGeometry = FlashGeometry(**where)
    else:
        geometry = ScanGeometry(**{"line_offsets": 0.0, "heading": 0.0, **where})
    gate = receiver.get("range_gate_m")
    if gate is not None:
        margin = float(receiver.get("gate_margin_m", 0.0))
        gate = (float(gate[0]), float(gate[1]) + margin)
    return Lidar(
        name=description["name"],
        wavelength=float(laser["wavelength_nm"]),
        line_width=float(laser.get("line_width_nm", 1.0)),
        pulse_length=float(laser["pulse_fwhm_ns"]),
        sample=float(receiver["sample_m"]),
        geometry=geometry,
        noise=LidarNoise(**description["noise"]),
        threshold=float(receiver.get("threshold", 5.0)),
        max_returns=int(receiver.get("max_returns", 5)),
        gate=gate,
        source=description["source"],
    )

"""Where the pulses of a LiDAR go: each pulse (or pixel of a flash) is a bundle of pencils."""

import dataclasses

import equinox as eqx
import numpy as np
from jaxtyping import Float
from scipy.special import ndtri

from fynjax._core.errors import InputError
from fynjax._core.seeds import generator
from fynjax.sensors._bands import floats

_TURN_S = 60.0  # between the flight lines


class FlashGeometry(eqx.Module):
    """A flash camera that looks straight down: each pixel times its own return.

    Frames stand in a square pattern, as many as cover the plot, about its middle.
    """

    altitude: float = eqx.field(static=True, converter=float)
    """Height of the platform above the ground [m]."""
    array: tuple[int, int] = eqx.field(static=True, converter=tuple)
    """Pixels across (x) and along (y)."""
    pixel_pitch_um: float = eqx.field(static=True, converter=float)
    """Distance of the pixels on the array [µm]."""
    focal_length_mm: float = eqx.field(static=True, converter=float)
    """Focal length of the camera [mm]."""
    half_divergence_rad: float = eqx.field(static=True, converter=float)
    """Angle of the Gaussian beam from its axis to 1/e² of the irradiance [rad]."""
    frame_step: float = eqx.field(static=True, converter=float)
    """Distance between frames [m]."""
    rate: float = eqx.field(static=True, converter=float)
    """Pulses, and so frames, in a second [Hz]."""
    pencils: int = eqx.field(static=True, default=3)
    """Pencils along each side of a pixel."""


class ScanGeometry(eqx.Module):
    """A scanner on straight flight lines that sweeps across them."""

    altitude: float = eqx.field(static=True, converter=float)
    """Height of the platform above the ground [m]."""
    pulse_density: float = eqx.field(static=True, converter=float)
    """Pulses per level ground of all flight lines together [m-2]."""
    divergence_mrad: float = eqx.field(static=True, converter=float)
    """Full angle of the Gaussian beam at 1/e² of the irradiance [mrad]."""
    half_scan_angle: float = eqx.field(static=True, converter=float)
    """Largest angle from straight down [degrees]."""
    line_offsets: tuple[float, ...] = eqx.field(static=True, converter=floats)
    """Distance of each flight line from the plot's middle, to the right of the heading [m]."""
    heading: float = eqx.field(static=True, converter=float)
    """Direction of the flight, clockwise from north [degrees]."""
    speed: float = eqx.field(static=True, converter=float)
    """Speed of the flight [m s-1]."""
    rate: float = eqx.field(static=True, converter=float)
    """Pulses in a second [Hz]."""
    pencils: int = eqx.field(static=True, default=3)
    """Pencils along each side of the footprint."""


class LidarBeams(eqx.Module):
    """Pulses of a scanner, or pixels of flash frames. Plain numbers, without a gradient."""

    origin: Float[np.ndarray, "beam 3"]
    """Place of the sensor [m]; z above the bottom of the grid."""
    direction: Float[np.ndarray, "beam 3"]
    """Unit vectors along which the light travels, downward."""
    irradiance: Float[np.ndarray, " beam"]
    """Irradiance of each pulse, relative to the middle of the beam [-]."""
    time: Float[np.ndarray, " beam"]
    """When the pulse left, from the start of the first line or frame [s]."""
    scan_angle: Float[np.ndarray, " beam"]
    """Angle from straight down, positive to the right of the flight [degrees]; 0 for a flash."""
    pencils: Float[np.ndarray, "pencil 2"]
    """Directions of the pencils of every beam, eastward and northward from its axis [rad]."""
    pencil_width: float = eqx.field(static=True)
    """Side of a pencil's square [rad]."""
    start: Float[np.ndarray, " gate"] = eqx.field(default_factory=lambda: np.zeros(0))
    """Range at which the first sample of each beam begins [m]; empty while none is recorded."""
    samples: int = eqx.field(static=True, default=0)
    """Samples that are recorded."""

    def __len__(self) -> int:
        return len(self.origin)

    @property
    def on_ground(self) -> Float[np.ndarray, "beam 2"]:
        """Where the axes meet the bottom of the grid, (x, y) [m]."""
        return self.at_height(0.0)

    def at_height(self, height: float) -> Float[np.ndarray, "beam 2"]:
        """Where the axes are at `height` above the bottom of the grid [m], (x, y) [m]."""
        slope = self.direction[:, :2] / self.direction[:, 2:]
        return self.origin[:, :2] - slope * (self.origin[:, 2:] - height)

    def select(self, which: np.ndarray) -> "LidarBeams":
        """Some of the beams: indices or a mask."""
        return dataclasses.replace(
            self,
            origin=self.origin[which],
            direction=self.direction[which],
            irradiance=self.irradiance[which],
            time=self.time[which],
            scan_angle=self.scan_angle[which],
            start=self.start[which] if len(self.start) else self.start,
        )


def flash_beams(
    geometry: FlashGeometry, extent: tuple[float, float], platform: float
) -> LidarBeams:
    """One beam for each pixel of each frame whose axis falls on the plot."""
    step = geometry.frame_step
    places = []
    for side in extent:
        count = max(int(np.ceil(side / step - 1e-6)), 1)
        places.append(side / 2.0 + (np.arange(count) - (count - 1) / 2.0) * step)
    y0, x0 = (a.ravel() for a in np.meshgrid(places[1], places[0], indexing="ij"))
    pixel = 1e-3 * geometry.pixel_pitch_um / geometry.focal_length_mm
    columns, rows = geometry.array
    tan_x = (np.arange(columns) + 0.5 - columns / 2.0) * pixel
    tan_y = (np.arange(rows) + 0.5 - rows / 2.0) * pixel
    ty, tx = (a.ravel() for a in np.meshgrid(tan_y, tan_x, indexing="ij"))
    # Frames follow each other; within one, pixels run along x first.
    down = np.stack([tx, ty, -np.ones_like(tx)], axis=-1)
    angle = np.arctan(np.hypot(tx, ty))
    lit = np.exp(-2.0 * (angle / geometry.half_divergence_rad) ** 2)
    frames, pixels = len(x0), len(tx)
    origin = np.stack([x0, y0, np.full(frames, platform)], axis=-1)
    cell = (np.arange(geometry.pencils) + 0.5) / geometry.pencils - 0.5
    beams = LidarBeams(
        np.repeat(origin, pixels, axis=0),
        np.tile(down / np.linalg.norm(down, axis=-1, keepdims=True), (frames, 1)),
        np.tile(lit, frames),
        np.repeat(np.arange(frames) / geometry.rate, pixels),
        np.zeros(frames * pixels),
        _square(cell * pixel),
        pixel / geometry.pencils,
    )
    return _over_plot(beams, extent, platform - geometry.altitude)


def scan_beams(
    geometry: ScanGeometry, extent: tuple[float, float], platform: float, seed: int
) -> LidarBeams:
    """One beam in each cell of a square pattern, at a random place in it, on each flight line."""
    lines = geometry.line_offsets
    step = float(np.sqrt(len(lines) / geometry.pulse_density))
    reach = 0.5 * float(np.hypot(*extent)) + step
    cells = (np.arange(int(np.ceil(2.0 * reach / step))) + 0.5) * step - reach
    rng = generator(seed, 613)
    turn = np.deg2rad(geometry.heading)
    right, ahead = np.array([np.cos(turn), -np.sin(turn)]), np.array([np.sin(turn), np.cos(turn)])
    middle = 0.5 * np.asarray(extent)
    parts: list[tuple[np.ndarray, ...]] = []
    for number, offset in enumerate(lines):
        v, u = (a.ravel() for a in np.meshgrid(cells, cells, indexing="ij"))
        u = u + (rng.random(u.size) - 0.5) * step
        v = v + (rng.random(v.size) - 0.5) * step
        across = u - offset
        angle = np.rad2deg(np.arctan2(across, geometry.altitude))
        in_scan = np.abs(angle) <= geometry.half_scan_angle
        u, v, across, angle = u[in_scan], v[in_scan], across[in_scan], angle[in_scan]
        # The platform is on its line; the pulse goes across the flight.
        foot = middle + offset * right + v[:, None] * ahead
        down = np.column_stack([across[:, None] * right, np.full(len(u), -geometry.altitude)])
        # The sweep takes the time that its pulses take, whatever the flight does.
        sweep = (u + reach) / step / geometry.rate
        time = number * _TURN_S + np.floor((v + reach) / step) * step / geometry.speed + sweep
        origin = np.column_stack([foot, np.full(len(u), platform)])
        parts.append((origin, down / np.linalg.norm(down, axis=1, keepdims=True), time, angle))
    origin, direction, time, angle = (np.concatenate(part) for part in zip(*parts))
    # Equal shares of the Gaussian along each axis, their variance that of the whole.
    sigma = 1e-3 * geometry.divergence_mrad / 4.0
    cell = ndtri((np.arange(geometry.pencils) + 0.5) / geometry.pencils)
    if geometry.pencils > 1:
        cell = cell / np.sqrt(np.mean(cell**2))
    beams = LidarBeams(
        origin,
        direction,
        np.ones(len(origin)),
        time,
        angle,
        _square(cell * sigma),
        1e-3 * geometry.divergence_mrad / max(2 * geometry.pencils, 2),
    )
    return _over_plot(beams, extent, platform - geometry.altitude)


def _square(cell: np.ndarray) -> np.ndarray:
    return np.stack([a.ravel() for a in np.meshgrid(cell, cell, indexing="xy")], axis=-1)


def _over_plot(beams: LidarBeams, extent: tuple[float, float], ground: float) -> LidarBeams:
    """Beams that meet the plot, at the mean height of its ground."""
    x, y = beams.at_height(ground).T
    inside = (x >= 0.0) & (x < extent[0]) & (y >= 0.0) & (y < extent[1])
    if not inside.any():
        raise InputError(
            "no pulse falls on the plot: is `half_scan_angle_deg` too small for the "
            "`line_offsets_m`, or `pulse_density_m2` too low for the plot?"
        )
    return beams.select(inside)

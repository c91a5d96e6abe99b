"""Where the pulses of a LiDAR go: each pulse (or pixel of a flash) is a bundle of pencils."""

import dataclasses

import equinox as eqx
import numpy as np
from jaxtyping import Float, Int
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
    """A scanner on straight flight lines that sweeps across them: with a `scan_rate` in lines even
    in angle, of which the pulses' density follows, or else spread evenly in no known pattern."""

    altitude: float = eqx.field(static=True, converter=float)
    """Height of the platform above the ground [m]."""
    divergence_mrad: tuple[float, ...] = eqx.field(static=True, converter=floats)
    """Full angle of the Gaussian beam at 1/e² of the irradiance; one, or one across and one along
    the flight [mrad]."""
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
    pulse_density: float = eqx.field(static=True, default=0.0)
    """Pulses per level ground of all flight lines together, where no `scan_rate` is known [m-2]."""
    scan_rate: float = eqx.field(static=True, default=0.0)
    """Lines in a second of each channel [Hz]."""
    used_share: float = eqx.field(static=True, default=1.0)
    """Share of a mirror's turn, and so of the pulses, that falls into the swath [-]."""
    channel_turns: tuple[float, ...] = eqx.field(static=True, converter=floats, default=(0.0,))
    """Angle by which each channel's lines are turned against straight across the flight, clockwise
    from above [degrees]."""


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
    line: Int[np.ndarray, " beam"]
    """Flight line, from 0; 0 for a flash."""
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
            line=self.line[which],
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
        np.zeros(frames * pixels, int),
        _square(cell * pixel),
        pixel / geometry.pencils,
    )
    return _over_plot(beams, extent, platform - geometry.altitude)


def scan_beams(
    geometry: ScanGeometry, extent: tuple[float, float], platform: float, seed: int
) -> LidarBeams:
    """The pulses of each flight line, one line after the other."""
    rng = generator(seed, 613)
    pulses = _swept if geometry.scan_rate else _spread
    lines = [pulses(geometry, offset, extent, rng) for offset in geometry.line_offsets]
    line = np.repeat(np.arange(len(lines)), [part.shape[1] for part in lines])
    flown, across, along, time, angle = np.concatenate(lines, axis=1)
    turn = np.deg2rad(geometry.heading)
    right, ahead = np.array([np.cos(turn), -np.sin(turn)]), np.array([np.sin(turn), np.cos(turn)])
    # The platform is on its line; the pulse goes across the flight.
    offset = np.asarray(geometry.line_offsets)[line]
    foot = 0.5 * np.asarray(extent) + offset[:, None] * right + flown[:, None] * ahead
    level = across[:, None] * right + along[:, None] * ahead
    down = np.column_stack([level, np.full(len(line), -geometry.altitude)])
    # Equal shares of the Gaussian along each axis, their variance that of the whole.
    divergence = 1e-3 * np.broadcast_to(geometry.divergence_mrad, 2)
    cell = ndtri((np.arange(geometry.pencils) + 0.5) / geometry.pencils)
    if geometry.pencils > 1:
        cell = cell / np.sqrt(np.mean(cell**2))
    beams = LidarBeams(
        np.column_stack([foot, np.full(len(line), platform)]),
        down / np.linalg.norm(down, axis=1, keepdims=True),
        np.ones(len(line)),
        time + line * _TURN_S,
        angle,
        line,
        _square(cell) * divergence / 4.0 @ np.stack([right, ahead]),
        float(np.sqrt(np.prod(divergence))) / max(2 * geometry.pencils, 2),
    )
    return _over_plot(beams, extent, platform - geometry.altitude)


def _spread(
    geometry: ScanGeometry, offset: float, extent: tuple[float, float], rng: np.random.Generator
) -> Float[np.ndarray, "5 pulse"]:
    """Pulses of a line, one in each cell of a square pattern, at a random place in it: place along
    the flight, run of the axis to the right and ahead [m], time [s], scan angle [degrees]."""
    step = float(np.sqrt(len(geometry.line_offsets) / geometry.pulse_density))
    reach = 0.5 * float(np.hypot(*extent)) + step
    cells = (np.arange(int(np.ceil(2.0 * reach / step))) + 0.5) * step - reach
    v, u = (a.ravel() for a in np.meshgrid(cells, cells, indexing="ij"))
    u = u + (rng.random(u.size) - 0.5) * step
    v = v + (rng.random(v.size) - 0.5) * step
    angle = np.rad2deg(np.arctan2(u - offset, geometry.altitude))
    # The sweep takes the time that its pulses take, whatever the flight does.
    time = np.floor((v + reach) / step) * step / geometry.speed + (u + reach) / step / geometry.rate
    pulses = np.stack([v, u - offset, np.zeros_like(u), time, angle])
    return pulses[:, np.abs(angle) <= geometry.half_scan_angle]


def _swept(
    geometry: ScanGeometry, offset: float, extent: tuple[float, float], rng: np.random.Generator
) -> Float[np.ndarray, "5 pulse"]:
    """As `_spread`, by a mirror and while the plot is in reach; where both begin is random."""
    radius, channels = 0.5 * float(np.hypot(*extent)), len(geometry.channel_turns)
    parts, first = [], rng.random()
    for channel, turn in enumerate(np.deg2rad(geometry.channel_turns)):
        reach = radius + (abs(offset) + radius) * abs(float(np.tan(turn)))
        count = int(np.ceil(2.0 * reach / geometry.speed * geometry.rate / channels))
        time = (np.arange(count) + rng.random()) * channels / geometry.rate
        mirror = np.modf(time * geometry.scan_rate + channel / channels + first)[0]
        angle = (2.0 * mirror / geometry.used_share - 1.0) * geometry.half_scan_angle
        # Angles are across the flight, however far a turned line looks ahead or back.
        across = geometry.altitude * np.tan(np.deg2rad(angle))
        flown = geometry.speed * time - reach
        part = np.stack([flown, across, -across * np.tan(turn), time, angle])
        near = (mirror < geometry.used_share) & (np.abs(across + offset) <= radius)
        parts.append(part[:, near])
    pulses = np.concatenate(parts, axis=1)
    return pulses[:, np.argsort(pulses[3], kind="stable")]


def _square(cell: np.ndarray) -> np.ndarray:
    return np.stack([a.ravel() for a in np.meshgrid(cell, cell, indexing="xy")], axis=-1)


def _over_plot(beams: LidarBeams, extent: tuple[float, float], ground: float) -> LidarBeams:
    """Beams that meet the plot, at the mean height of its ground."""
    x, y = beams.at_height(ground).T
    inside = (x >= 0.0) & (x < extent[0]) & (y >= 0.0) & (y < extent[1])
    if not inside.any():
        raise InputError(
            "no pulse falls on the plot: is `half_scan_angle_deg` too small for the "
            "`line_offsets_m`, or the density of pulses too low for the plot?"
        )
    return beams.select(inside)

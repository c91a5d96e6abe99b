"""From waveforms to what the receiver counts, and to discrete returns."""

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from fynjax._core.errors import InputError
from fynjax.sensors.lidar._beams import LidarBeams
from fynjax.sensors.lidar._system import FWHM, SPEED_OF_LIGHT, Lidar
from fynjax.sensors.lidar._waveform import Waveforms

GROUND, VEGETATION = 2, 3
"""Classes of returns, as LAS 1.4 numbers them: ground, low vegetation."""


@dataclass(frozen=True)
class LidarReturns:
    """Discrete returns, in the order of the pulses and then of range."""

    beam: Int[np.ndarray, " point"]
    """Index of the pulse."""
    position: Float[np.ndarray, "point 3"]
    """x, y, z [m]."""
    distance: Float[np.ndarray, " point"]
    """Range [m]."""
    reflectance: Float[np.ndarray, " point"]
    """Apparent reflectance: the height of the echo over that of a white plate there [-]."""
    width: Float[np.ndarray, " point"]
    """Full width of the echo at half its height [ns]."""
    number: Int[np.ndarray, " point"]
    """Number of the return in its pulse, from 1."""
    of: Int[np.ndarray, " point"]
    """Number of returns of the pulse."""
    classification: Int[np.ndarray, " point"]
    """`GROUND` or `VEGETATION`: which of them sent more light to the echo's highest sample."""
    time: Float[np.ndarray, " point"]
    """When the pulse left [s]."""
    scan_angle: Float[np.ndarray, " point"]
    """Scan angle of the pulse [degrees]."""
    line: Int[np.ndarray, " point"]
    """Flight line of the pulse, from 0."""

    def __len__(self) -> int:
        return len(self.beam)


def received_electrons(
    lidar: Lidar,
    beams: LidarBeams,
    waveform: Float[Array, "beam sample"],
    *,
    key: Array | None = None,
) -> Float[Array, "beam sample"]:
    """Electrons that a receiver counts, its mean background taken off [-].

    **Arguments:**

    - `lidar`: the system, with its noise.
    - `beams`: of `lidar.beams`.
    - `waveform`: apparent reflectance as of `Waveforms.total` [-].
    - `key`: a JAX key of the noise: Poisson in return and background, Gaussian in reading. Without
      it the mean is returned, which is differentiable in `waveform`.

    The return falls with the square of range and with the irradiance of the beam: a white plate
    in the middle beam, facing it at the usual altitude, gives `LidarNoise.signal_electrons`. Air
    is left out (below 1 km and at 1064 nm it takes less than some per cent of clear air's light).
    """
    noise = lidar.noise
    mean = waveform * jnp.asarray(_per_reflectance(lidar, beams), waveform.dtype)
    if key is None:
        return mean
    counted, read = jax.random.split(key)
    level = jnp.maximum(mean + noise.background_electrons, 0.0)
    drawn = jax.random.poisson(counted, level).astype(mean.dtype)
    reading = jax.random.normal(read, mean.shape, mean.dtype) * noise.read_noise_electrons
    return drawn + reading - noise.background_electrons


def detect_returns(
    lidar: Lidar,
    beams: LidarBeams,
    electrons: Float[Array | np.ndarray, "beam sample"],
    truth: Waveforms,
    *,
    key: Array | None = None,
) -> LidarReturns:
    """Discrete returns of recorded waveforms.

    **Arguments:**

    - `lidar`: threshold, noise and most returns of the system.
    - `beams`: of `lidar.beams`.
    - `electrons`: as of `received_electrons`.
    - `truth`: the noise-free waveforms, which separate ground from vegetation.
    - `key`: a JAX key of the noise of range, `LidarNoise.range_sd_m`; without it there is none.

    **Returns:** `LidarReturns`. A return is a local maximum that stands out by `lidar.threshold`
    standard deviations of the noise, both above an empty record and above the dip towards a higher
    neighbour (its prominence). Counted in standard deviations, v = 2 sqrt(electrons + background +
    read²), weak and strong echoes have the same noise (Anscombe 1948). Range and width are those of
    the Gaussian through the three highest samples (as in Wagner et al. 2006, without their fit). Of
    more than `lidar.max_returns` in a pulse the strongest stay. Two surfaces closer than about the
    pulse's length in range are one return.

    **Raises:** `InputError` for electrons that are not finite.

    Not differentiable; `expected_returns` is. An example stands at `lidar_waveforms`.
    """
    counts = np.asarray(electrons, float)
    if not np.isfinite(counts).all():
        raise InputError("`electrons` must be finite, but some are not: are all inputs?")
    beam, sample = _peaks(lidar, counts)
    strength = counts[beam, sample]
    beam, sample, number, of = _strongest(beam, sample, strength, lidar.max_returns)

    floor = 0.1 * lidar.noise.floor
    before, at, after = (
        np.log(np.maximum(counts[beam, sample + shift], floor)) for shift in (-1, 0, 1)
    )
    # The parabola through the logarithms of three samples is the logarithm of a Gaussian: its
    # vertex is the range, its second difference minus (sample / standard deviation)^2.
    bend = np.minimum(before - 2.0 * at + after, -1e-6)
    shift = np.clip(0.5 * (before - after) / bend, -0.5, 0.5)
    distance = beams.start[beam] + (sample + 0.5 + shift) * lidar.sample
    if key is not None:
        drawn = jax.random.normal(key, distance.shape, distance.dtype)
        distance = distance + lidar.noise.range_sd_m * np.asarray(drawn)
    peak = np.exp(at - 0.25 * (before - after) * shift)
    white = _per_reflectance(lidar, beams)[beam, sample] * lidar.pulse_peak
    fwhm = FWHM * lidar.sample * np.sqrt(-1.0 / bend) / (0.5 * SPEED_OF_LIGHT)
    ground = np.asarray(truth.ground)[beam, sample] >= np.asarray(truth.canopy)[beam, sample]
    return LidarReturns(
        beam=beam,
        position=beams.origin[beam] + distance[:, None] * beams.direction[beam],
        distance=distance,
        reflectance=peak / white,
        width=fwhm,
        number=number,
        of=of,
        classification=np.where(ground, GROUND, VEGETATION),
        time=beams.time[beam],
        scan_angle=beams.scan_angle[beam],
        line=beams.line[beam],
    )


def _per_reflectance(lidar: Lidar, beams: LidarBeams) -> Float[np.ndarray, "beam sample"]:
    """Electrons that reflectance 1 in a sample gives."""
    middle = (np.arange(beams.samples) + 0.5) * lidar.sample
    distance = beams.start[:, None] + middle
    usual = lidar.geometry.altitude
    falling = (usual / np.maximum(distance, 0.1 * usual)) ** 2
    return lidar.noise.signal_electrons * beams.irradiance[:, None] * falling


def _peaks(lidar: Lidar, counts: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Beam and sample of every echo, in order; none at the ends of a record."""
    from scipy.signal import find_peaks  # late: it takes half a second

    # In v = 2 sqrt(electrons + variance) noise has the standard deviation 1 at all levels.
    variance = lidar.noise.floor**2
    empty = 2.0 * np.sqrt(variance)
    scaled = 2.0 * np.sqrt(np.maximum(counts + variance, 0.0))
    # One row after the other, an empty sample between: one call finds the peaks of all.
    rows = np.pad(scaled, [(0, 0), (1, 1)], constant_values=empty)
    peaks, _ = find_peaks(
        rows.ravel(),
        height=empty + lidar.threshold,
        prominence=lidar.threshold,
        wlen=2 * rows.shape[1] + 1,
    )
    beam, sample = np.divmod(peaks, rows.shape[1])
    sample = sample - 1
    inside = (sample > 0) & (sample < counts.shape[1] - 1)
    return beam[inside], sample[inside]


def _strongest(
    beam: np.ndarray, sample: np.ndarray, strength: np.ndarray, most: int
) -> tuple[np.ndarray, ...]:
    """The `most` strongest echoes of each pulse, with number and count."""
    # By pulse, and within it by strength.
    order = np.lexsort((-strength, beam))
    rank = _within(beam[order])
    keep = np.sort(order[rank < most])
    beam, sample = beam[keep], sample[keep]
    counts = np.bincount(beam, minlength=beam.max(initial=0) + 1)
    return beam, sample, _within(beam) + 1, counts[beam]


def _within(sorted_beam: np.ndarray) -> np.ndarray:
    """Place of each entry among those of its pulse, from 0."""
    if len(sorted_beam) == 0:
        return np.zeros(0, int)
    first = np.r_[True, np.diff(sorted_beam) > 0]
    starts = np.flatnonzero(first)
    return np.arange(len(sorted_beam)) - np.repeat(starts, np.diff(np.r_[starts, len(first)]))

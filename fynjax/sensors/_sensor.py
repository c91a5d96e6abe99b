"""A sensor as a whole: bands, geometry, point spread and noise."""

import dataclasses
from collections.abc import Sequence

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array, Float

from fynjax._core.errors import InputError, did_you_mean
from fynjax.sensors._bands import BandSet
from fynjax.sensors._camera import AbstractCamera, Real, frame_of
from fynjax.sensors._gains import ASSUMED, Gains
from fynjax.sensors._noise import AbstractNoise
from fynjax.sensors._psf import PointSpread
from fynjax.sensors.air import SPACE


class Sensor(eqx.Module):
    """What measures: spectral bands, lines of sight, point spread and noise.

    `fynjax.sensor` reads one from a file or takes a shipped one by name.
    """

    name: str = eqx.field(static=True)
    """Short name, such as 'mavic_3m'."""
    bands: BandSet
    """Names and spectral responses of the bands."""
    camera: AbstractCamera
    """Geometry, above the point (0, 0) at the altitude of the file."""
    psf: PointSpread | None = None
    """Blur on top of the pixels' footprints; none if not known."""
    noise: AbstractNoise | None = None
    """Noise of the radiance; none if not known."""
    band_pixel: tuple[float, ...] | None = eqx.field(static=True, default=None)
    """Pixel of each band on the ground where the bands of a product differ [m]."""
    pixel_factor: float = eqx.field(static=True, default=1.0)
    """Pixel of its images over that of its optics [-]: not 1 where the source states another."""
    calibrations: tuple[Gains, ...] = eqx.field(static=True, default=())
    """Errors of its bands for each way of calibration to reflectance, the usual one first; empty if
    not known. See `gains`."""
    source: str = eqx.field(static=True, default="")
    """Source of the numbers."""

    def __check_init__(self) -> None:
        if self.band_pixel is not None and len(self.band_pixel) != len(self.bands):
            raise InputError(
                f"`band_pixel` needs one value for each of {len(self.bands)} bands, but has "
                f"{len(self.band_pixel)}."
            )
        for one in self.calibrations:
            one.of_bands(len(self.bands))

    def gains(self, way: str | None = None) -> Gains:
        """What the calibration of its bands to reflectance may be off by.

        `way` of calibration, such as 'panels'; left out, the usual one, or an assumption where its
        file states none. Raises `InputError` for a way that its file does not state.
        """
        ways = {one.way: one for one in self.calibrations}
        if way is None:
            return next(iter(self.calibrations), ASSUMED)
        if way not in ways:
            raise InputError(
                f"expected a way of calibration that the file of {self.name!r} states "
                f"({', '.join(ways) or 'none'}), but got {way!r}.{did_you_mean(way, list(ways))}"
            )
        return ways[way]

    @property
    def altitude(self) -> float:
        """Usual height above the ground [m]; in space where its file has none."""
        frame = frame_of(self.camera)
        return SPACE if frame is None else float(frame.position[2])

    def ground_sample_distance(self, altitude: Real | None = None) -> Float[Array, ""]:
        """Pixel spacing on the ground straight below, from the optics [m].

        `altitude` above the ground [m], without effect on parallel lines of sight; left out, that
        of the file.
        """
        frame = frame_of(self.camera)
        if altitude is None or frame is None:
            return self.camera.ground_sample_distance
        return frame.pixel_at(altitude)

    def pixel(self, altitude: Real | None = None) -> Float[Array, ""]:
        """Edge of a pixel of its images on the ground [m]: what the sensor's source states, else
        from the optics.

        `altitude` above the ground [m], with which a stated pixel grows too; left out, that of the
        file.
        """
        return self.ground_sample_distance(altitude) * self.pixel_factor

    def select(self, places: Sequence[int]) -> "Sensor":
        """The same sensor with the bands at `places` alone, in that order."""
        count, at = len(self.bands), np.asarray(places, int)
        # A noise model's values per band must be as many as the bands.
        noise = jax.tree.map(lambda v: v[at] if np.shape(v) == (count,) else v, self.noise)
        pixel = None if self.band_pixel is None else tuple(self.band_pixel[i] for i in at)
        return dataclasses.replace(
            self,
            bands=self.bands.select(at.tolist()),
            noise=noise,
            band_pixel=pixel,
            calibrations=tuple(one.select(at.tolist()) for one in self.calibrations),
        )

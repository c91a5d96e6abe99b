"""What a sensor measures over a plot: from its parameters to radiance and calibrated reflectance.

The image lies on a map: pixels are squares on the ground, rows north, as in an orthorectified
product, and each is seen along the line of sight that the sensor has of it. Pixels wider than a
voxel average rays a voxel apart, because the light that escapes a clumped canopy is not that of
its mean density.
"""

import dataclasses
from typing import Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from fynjax._core.errors import InputError
from fynjax.radiation import AbstractRays, VoxelScene, reflectance_factor, solve_light
from fynjax.scene._panels import PanelsInPicture, panels_in_picture
from fynjax.scene._parameters import LightParameters, PlotParameters
from fynjax.scene._pixels import axis_pixels, footprint_shares
from fynjax.scene._scene import PlotModel
from fynjax.sensors import (
    SPACE,
    AbstractCamera,
    Atmosphere,
    ClearAir,
    Panel,
    PushbroomCamera,
    Sensor,
    at_sensor_radiance,
    band_atmosphere,
    check_within_table,
    clear_sky_atmosphere,
    frame_of,
    is_transparent,
    map_rays,
    surface_reflectance,
    tabulated_atmosphere,
)

_AT_550 = (550.0 / 500.0) ** -1.14
"""Optical depth of aerosol at 550 nm over that at 500 nm, by Ångström's law as SPCTRL2 has it."""
SAMPLES = 2
"""Rays along the edge of a voxel where pixels are wider than voxels."""
_VOXELS = 20_000_000  # times bands that are rendered at once


class PlotAir(eqx.Module):
    """A clear atmosphere over a plot; the sun and the aerosol are those of its parameters."""

    model: Literal["table", "clear-sky"] = eqx.field(static=True, default="table")
    """'table': `tabulated_atmosphere` (6S); 'clear-sky': `clear_sky_atmosphere` (SPCTRL2)."""
    water_vapour: float | Float[Array, ""] = 1.5
    """[g cm-2]"""
    ozone: float | Float[Array, ""] = 0.3
    """[cm-atm]"""
    pressure: float | Float[Array, ""] = 1013.25
    """[hPa]"""
    solar_factor: float | Float[Array, ""] = 1.0
    """Sunlight of the day over that at one astronomical unit [-]."""
    aerosol: float | Float[Array, ""] | None = None
    """Optical depth of aerosol at 550 nm [-]; None: that of the plot's parameters."""

    def clear_air(self, light: LightParameters, sensor_height: float) -> ClearAir:
        """The model's parameters for a sensor `sensor_height` over the ground [m]."""
        zenith = jnp.asarray(light.sun_zenith)
        values = (
            zenith,
            self.water_vapour,
            _AT_550 * light.aerosol if self.aerosol is None else self.aerosol,
            self.ozone,
            self.pressure,
            sensor_height,
            self.solar_factor,
        )
        return ClearAir(*(jnp.asarray(v, zenith.dtype) for v in values))

    def atmosphere(self, light: LightParameters, sensor_height: float) -> Atmosphere:
        """The air below and above a sensor `sensor_height` over the ground [m]."""
        air = self.clear_air(light, sensor_height)
        return tabulated_atmosphere(air) if self.model == "table" else clear_sky_atmosphere(air)


class Observation(eqx.Module):
    """What a sensor measures of a plot."""

    reflectance: Float[Array, "band y x"]
    """Reflectance factor of the pixels: without air that of the scene, else what calibration makes
    of the radiance, by the panels if there are any, or with the air known; zero where the air is
    opaque [-]."""
    radiance: Float[Array, "band y x"] | None
    """At the sensor, with its noise if that was drawn [W m-2 sr-1 um-1]; None without air."""
    transparent: Bool[Array, " band"]
    """Where the air lets the ground be seen."""
    reflectance_sd: Float[Array, "band y x"] | None
    """Standard deviation of a reflectance by panels, of line and noise; None without panels [-]."""
    residual: Float[Array, " band"]
    """Estimated error of light scattered more than once, see `fynjax.radiation.Light` [-]."""


class PlotSensing(eqx.Module):
    """A sensor over a plot; `plot_sensing` makes one. Call `observe` with parameters."""

    model: PlotModel
    sensor: Sensor
    air: PlotAir | Atmosphere | None
    """None: reflectance alone, under the plot's own sky."""
    rays: AbstractRays
    pixel: float = eqx.field(static=True)
    """Edge of a pixel on the ground [m]."""
    shape: tuple[int, int] = eqx.field(static=True)
    """Rows and columns of the image."""
    origin: tuple[float, float] = eqx.field(static=True)
    """South-west corner of the image from that of the plot [m]."""
    sensor_height: float = eqx.field(static=True)
    """Of the sensor above the ground, for the air [m]."""
    margin: int = eqx.field(static=True)
    """Pixels around the image that `rays` has on top, for the point spread."""
    fine: tuple[int, int] | None = eqx.field(static=True)
    """Rows and columns of rays over the plot where pixels are wider than voxels; else None."""
    averaged: float = eqx.field(static=True)
    """The sensor's own pixels, by its optics, that a pixel is the mean of; at least 1. Its noise is
    as much lower."""
    panels: PanelsInPicture | None = None
    """Panels in the picture; None: none."""

    def observe(
        self,
        parameters: PlotParameters,
        *,
        key: Array | int | None = None,
        air: PlotAir | Atmosphere | None = None,
    ) -> Observation:
        """What the sensor measures. Differentiable in `parameters` and `air`.

        **Arguments:** `key`, JAX key or seed of the noise, none if left out; `air`, instead of the
        object's own. Raises `InputError` for noise without air or without a noise model, and for
        air that does not cover the bands.
        """
        air = self.air if air is None else air
        if key is not None and (air is None or self.sensor.noise is None):
            lack = "no noise model" if air is not None else "no air to make radiance of"
            raise InputError(f"noise was asked for, but {self.sensor.name!r} has {lack}")
        parameters = jax.tree.map(lambda x: jnp.asarray(x, self.model.dtype), parameters)
        scene = self.model.scene(parameters)
        if air is None:
            every = jnp.ones(len(self.sensor.bands), bool)
            image, _, residual = self._image(scene)
            return Observation(image, None, every, None, residual)
        by_band = self._air_of_bands(air, parameters.light)
        order, back = _sorting(self.sensor)
        total = by_band.direct + by_band.diffuse
        sky = (by_band.diffuse / jnp.maximum(total, jnp.finfo(total.dtype).tiny))[back]
        scene = eqx.tree_at(
            lambda s: (s.illumination.sun, s.illumination.sky), scene, (1.0 - sky, sky)
        )
        image, mean, residual = self._image(scene)
        if self.panels is not None:
            image = self.panels.laid_on(image)
        pixels = jnp.moveaxis(image, 0, -1)[..., order]
        radiance = at_sensor_radiance(by_band, pixels, mean[order])
        if key is not None and self.sensor.noise is not None:
            noise = self.sensor.noise
            radiance = noise.draw(key, radiance[..., back], averaged=self.averaged)[..., order]
        transparent, measured, doubt = is_transparent(by_band)[back], radiance[..., back], None
        if self.panels is None:
            calibrated = surface_reflectance(by_band, radiance, mean[order])[..., back]
        else:
            noise_sd: Array | float = 0.0
            if key is not None and self.sensor.noise is not None:
                noise_sd = self.sensor.noise.standard_deviation(measured, averaged=self.averaged)
            line = self.panels.line(
                jnp.moveaxis(measured, -1, 0),
                transparent,
                noise_sd=jnp.moveaxis(jnp.broadcast_to(noise_sd, measured.shape), -1, 0),
                haze=at_sensor_radiance(by_band, jnp.zeros_like(mean))[back],
            )
            calibrated = jnp.where(transparent, line.reflectance(measured), 0.0)
            sd = jnp.where(transparent, line.standard_deviation(measured, noise_sd), 0.0)
            doubt = jnp.moveaxis(sd, -1, 0)
        return Observation(
            jnp.moveaxis(calibrated, -1, 0),
            jnp.moveaxis(measured, -1, 0),
            transparent,
            doubt,
            residual,
        )

    def check(self, parameters: PlotParameters) -> Atmosphere | None:
        """The air's curves under the sun and with the aerosol of `parameters`; None without air.

        Raises `InputError` where they do not cover the bands, or the air's model does not reach to
        that sun or has values out of range, which `observe` cannot inside a transformation.
        """
        if self.air is None:
            return None
        found = self.air
        if isinstance(self.air, PlotAir):
            known = self.air.clear_air(parameters.light, self.sensor_height)
            if self.air.model == "table":
                check_within_table(known)
            make = eqx.filter_jit(PlotAir.atmosphere)
            found = make(self.air, parameters.light, self.sensor_height)
        assert isinstance(found, Atmosphere)
        self.sensor.bands.weights(found.wavelength)
        return found

    def _air_of_bands(self, air: PlotAir | Atmosphere, light: LightParameters) -> Atmosphere:
        curves = air
        if isinstance(air, PlotAir):
            curves = air.atmosphere(light, self.sensor_height)
        assert isinstance(curves, Atmosphere)
        bands = self.sensor.bands.select(_sorting(self.sensor)[0].tolist())
        found = band_atmosphere(curves, bands)
        return jax.tree.map(lambda v: v.astype(self.model.dtype), found)

    def _image(
        self, scene: VoxelScene
    ) -> tuple[Float[Array, "band y x"], Float[Array, " band"], Float[Array, " band"]]:
        """Reflectance factor of the pixels, its mean over the plot, and the light's residual."""
        light = solve_light(scene, self.model.accuracy)
        chunk = min(max(_VOXELS // int(np.prod(scene.shape)), 8), 32)
        seen = reflectance_factor(light, self.rays, chunk=chunk)
        mean = seen.mean(axis=(1, 2))
        psf, periodic = self.sensor.psf, self.model.boundary == "periodic"
        if self.fine is None:
            if psf is not None:
                edge = slice(self.margin, -self.margin or None)
                seen = psf.blur(seen)[:, edge, edge]
            return seen, mean, light.residual
        shares = []
        for axis, count, start, cells, length in zip(
            ("y", "x"), self.shape, self.origin[::-1], self.fine, self.model.grid.extent[1::-1]
        ):
            centres = start + (np.arange(count) + 0.5) * self.pixel
            kernel = None if psf is None else psf.kernel(axis, seen.dtype)  # type: ignore[arg-type]
            share = footprint_shares(
                centres, self.pixel, cells, length, periodic=periodic, kernel=kernel
            )
            shares.append(share.astype(seen.dtype))
        image = jnp.einsum("pr,brc,qc->bpq", shares[0], seen, shares[1], optimize="optimal")
        return image, mean, light.residual


def plot_sensing(
    model: PlotModel,
    sensor: Sensor,
    *,
    altitude: float | None = None,
    pixel: float | None = None,
    tilt: float | None = None,
    heading: float | None = None,
    air: PlotAir | Atmosphere | None = None,
    point_spread: bool = True,
    panels: tuple[Panel, ...] = (),
) -> PlotSensing:
    """Aim a sensor at the middle of a plot.

    **Arguments:**

    - `model`: built with the bands of `sensor` (`Camera(sensor.bands, ...)`), so that its spectra
      are on their wavelengths.
    - `altitude`: of the sensor above the ground [m]; left out, that of its file. A sensor without
      one, such as an orthographic view, is taken to be in space where the air asks for it.
    - `pixel`: edge of a pixel on the ground [m]; left out, from the optics.
    - `tilt`: of the optical axis from straight down towards the heading; `heading`: clockwise from
      north [degrees]. Left out, those of the sensor's file. Not of an orthographic view.
    - `air`: between plot and sensor; None for reflectance alone.
    - `point_spread`: whether the optics blur.
    - `panels`: to be seen in the picture and to calibrate by, with sharp edges. For a sensor in
      air.

    As many whole pixels as the plot holds lie in its middle; a periodic plot smaller than a pixel
    fills one, for it goes on for ever. Raises `InputError` for an open plot smaller than a pixel,
    a sensor that is not above the plants, and values out of range.
    """
    if panels and air is None:
        raise InputError("expected an atmosphere: panels calibrate radiance")
    if model.camera.bands != sensor.bands:
        raise InputError(
            "`model` must be built with the sensor's bands, `Camera(sensor.bands, ...)`, but its "
            f"bands are {', '.join(model.camera.bands.names[:4])}..."
        )
    lx, ly, top = model.grid.extent
    base = 0.0 if model.terrain is None else float(np.mean(model.terrain))
    frame = frame_of(sensor.camera)
    if frame is None and (tilt is not None or heading is not None):
        raise InputError("an orthographic view has no tilt or heading: set its view angles instead")
    height = SPACE if frame is None else float(frame.position[2])
    height = height if altitude is None else altitude
    if not height + base > top:
        raise InputError(
            f"the sensor must be above the plants, which reach {top - base:.2f} m, but is at "
            f"{height:g} m above the ground"
        )
    optics = sensor.ground_sample_distance(None if frame is None else height)
    pixel = float(optics) if pixel is None else pixel
    if not 0.0 < pixel < np.inf:
        raise InputError(f"`pixel` must be a positive number of m, but is {pixel:g}.")
    periodic = model.boundary == "periodic"
    (columns, west), (rows, south) = (axis_pixels(s, pixel, periodic=periodic) for s in (lx, ly))
    psf = sensor.psf if point_spread else None
    if psf is not None:  # its reach must be known inside transformations
        psf = dataclasses.replace(psf, radius=psf.reach())
    wide = pixel > max(model.grid.horizontal_size, 1e-9) * (1.0 + 1e-6)
    margin = psf.reach() if psf is not None and periodic and not wide else 0
    if wide:
        ny, nx = (SAMPLES * n for n in model.grid.shape[1::-1])
        spacing = model.grid.horizontal_size / SAMPLES
        axes = [(np.arange(n) + 0.5) * spacing for n in (nx, ny)]
    else:
        spacing = pixel
        axes = [
            start + (np.arange(-margin, n + margin) + 0.5) * pixel
            for start, n in ((west, columns), (south, rows))
        ]
    x, y = (jnp.asarray(axis, model.dtype) for axis in axes)
    middle = (lx / 2, ly / 2)
    camera = _aimed(sensor.camera, middle, height, base, tilt, heading)
    # The map is at the mean height of the ground: laid out there, then moved to the zero level.
    rays = map_rays(_aimed(sensor.camera, middle, height, 0.0, tilt, heading), x, y, spacing)
    rays = dataclasses.replace(
        rays,
        x=rays.x - base * rays.slope_x,
        y=rays.y - base * rays.slope_y,
        altitude=rays.altitude + base,
    )
    # Rays that cross several voxels in a layer are cut into as many pieces.
    slope = float(jnp.tan(jnp.arccos(jnp.min(rays.cosine))))
    pieces = min(8, int(np.ceil(slope - 1e-6)))
    if model.accuracy.sublayers is not None and model.accuracy.sublayers < pieces:
        accuracy = dataclasses.replace(model.accuracy, sublayers=pieces)
        model = dataclasses.replace(model, accuracy=accuracy)
    return PlotSensing(
        model=model,
        sensor=dataclasses.replace(sensor, camera=camera, psf=psf),
        air=air,
        rays=rays,
        pixel=pixel,
        shape=(rows, columns),
        origin=(west, south),
        sensor_height=float(height),
        margin=margin,
        fine=(ny, nx) if wide else None,
        averaged=max(1.0, (pixel / float(optics)) ** 2),
        panels=panels_in_picture(panels, (rows, columns), pixel, (west, south)) if panels else None,
    )


def _aimed(
    camera: AbstractCamera,
    middle: tuple[float, float],
    height: float,
    base: float,
    tilt: float | None,
    heading: float | None,
) -> AbstractCamera:
    """The camera where its optical axis meets the ground, at `base` [m], in the `middle` [m]."""
    frame = frame_of(camera)
    if frame is None:
        return camera.over(*middle)
    tilt = float(frame.tilt) if tilt is None else tilt
    heading = float(frame.heading) if heading is None else heading
    back = height * np.tan(np.deg2rad(tilt))
    ahead = np.deg2rad(heading)
    x, y = middle[0] - back * np.sin(ahead), middle[1] - back * np.cos(ahead)
    placed = dataclasses.replace(
        frame,
        position=jnp.asarray([x, y, height + base]),
        tilt=jnp.asarray(tilt),
        heading=jnp.asarray(heading),
    )
    if isinstance(camera, PushbroomCamera):
        return dataclasses.replace(camera, line=placed)
    return placed


def _sorting(sensor: Sensor) -> tuple[np.ndarray, np.ndarray]:
    """Places of the bands by rising wavelength, and the way back."""
    order = np.argsort(sensor.bands.centre)
    return order, np.argsort(order)

"""What any sensor measures of a scene: the one road from a scene to a measurement.

`aim` lays the lines of sight of a sensor out over a scene, once; `AimedSensor.observe` then gives
what it measures, as a differentiable function of the scene's parameters. `observe` does both, and
sends a LiDAR's pulses instead where the sensor is one.

An image lies on a map: pixels are squares on the ground, rows north, as in an orthorectified
product, and each is seen along the line of sight that the sensor has of it: from the place where a
camera hung, if its `Pose` is known. Pixels wider than a voxel average rays a voxel apart, because
the light that escapes a clumped canopy is not that of its mean density.
"""

import dataclasses
import math
from collections.abc import Sequence
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, overload

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Bool, Float
from scipy.ndimage import map_coordinates as interpolated

from fynjax._core.errors import InputError, did_you_mean, listed
from fynjax._core.extras import app_room
from fynjax._core.html import as_html
from fynjax._core.math import real_array
from fynjax._core.programs import as_one, check_known, concrete, unfolded
from fynjax.metrics import index_bands, vegetation_indices
from fynjax.radiation import (
    AbstractRays,
    Accuracy,
    Light,
    RayField,
    RayLattice,
    VoxelScene,
    reflectance_factor,
    solve_light,
)
from fynjax.scene._lidar import LidarObservation, observe_lidar
from fynjax.scene._panels import PanelsInPicture, panels_in_picture
from fynjax.scene._parameters import LightParameters, PlotParameters, within_bounds
from fynjax.scene._pixels import axis_pixels, footprint_shares
from fynjax.scene._scene import Scene
from fynjax.scene._spectra import visible_sensor
from fynjax.sensors import (
    AbstractCamera,
    Atmosphere,
    BandSet,
    ClearAir,
    Frame,
    FrameCamera,
    Lens,
    Lidar,
    Panel,
    Pose,
    PushbroomCamera,
    Sensor,
    at_sensor_radiance,
    band_atmosphere,
    check_within_table,
    clear_sky_atmosphere,
    frame_of,
    is_transparent,
    lens_of,
    map_rays,
    shipped_lidar,
    shipped_lidars,
    shipped_sensor,
    shipped_sensors,
    surface_reflectance,
    tabulated_atmosphere,
)

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr

DRONE = Accuracy(sublayers=1, levels=2, refine=False)
"""Accuracy of a drone's image, seen from close to nadir under a high sun: the default."""
_AT_550 = (550.0 / 500.0) ** -1.14
"""Optical depth of aerosol at 550 nm over that at 500 nm, by Ångström's law as SPCTRL2 has it."""
SAMPLES = 2
"""Rays along the edge of a voxel where pixels are wider than voxels. With a finer structure there
is one to each of its own; in hundreds of bands they are followed once, and the light of a band is
taken along the middle of blocks of them, this many along the edge of a voxel."""
_ASIDE = 1e-3
"""Share of a pixel by which rays of another pose are moved off the edges of voxels."""
_VOXELS = 20_000_000  # times bands that are rendered at once


def _number(value: Any) -> Array | None:
    return None if value is None else real_array(value)


class PlotAir(eqx.Module):
    """A clear atmosphere over a plot; the sun and the aerosol are those of its parameters.

    Numbers are leaves: another value of one compiles nothing anew.
    """

    model: Literal["table", "clear-sky"] = eqx.field(static=True, default="table")
    """'table': `tabulated_atmosphere` (6S); 'clear-sky': `clear_sky_atmosphere` (SPCTRL2)."""
    water_vapour: float | Float[Array, ""] = eqx.field(converter=real_array, default=1.5)
    """Column of water vapour [g cm-2]."""
    ozone: float | Float[Array, ""] = eqx.field(converter=real_array, default=0.3)
    """Column of ozone [cm-atm]."""
    pressure: float | Float[Array, ""] = eqx.field(converter=real_array, default=1013.25)
    """Air pressure at the ground [hPa]."""
    solar_factor: float | Float[Array, ""] = eqx.field(converter=real_array, default=1.0)
    """Sunlight of the day over that at one astronomical unit [-]."""
    aerosol: float | Float[Array, ""] | None = eqx.field(converter=_number, default=None)
    """Optical depth of aerosol at 550 nm [-]; None: that of the plot's parameters."""

    def clear_air(
        self, light: LightParameters, sensor_height: float | Float[Array, ""]
    ) -> ClearAir:
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

    def atmosphere(
        self, light: LightParameters, sensor_height: float | Float[Array, ""]
    ) -> Atmosphere:
        """The air below and above a sensor `sensor_height` over the ground [m]."""
        air = self.clear_air(light, sensor_height)
        return tabulated_atmosphere(air) if self.model == "table" else clear_sky_atmosphere(air)


def map_coordinates(
    shape: Sequence[int], pixel: float, origin: tuple[float, float]
) -> dict[str, Any]:
    """CF coordinates y and x of the pixels of an image of `shape` (rows, columns), from the scene's
    south-west corner [m]."""
    coordinates = {}
    for name, count, start, edge in zip("yx", shape, origin[::-1], ("south", "west"), strict=True):
        about = {"units": "m", "axis": name.upper(), "long_name": f"distance from the {edge} edge"}
        coordinates[name] = (name, start + (np.arange(count) + 0.5) * pixel, about)
    return coordinates


def map_attributes(title: str, pixel: float) -> dict[str, Any]:
    """CF attributes of a dataset of images with pixels of an edge [m]."""
    source = f"fynjax {version('fynjax')}"
    return {"Conventions": "CF-1.11", "title": title, "source": source, "pixel_m": pixel}


class Observation(eqx.Module):
    """What a sensor measures of a plot: `image["nir"]` is a band, `image.index("NDVI")` an
    index."""

    reflectance: Float[Array, "band y x"]
    """Reflectance factor of the pixels: without air that of the scene, else what calibration makes
    of the radiance, by the panels if there are any, or with the air known; zero where the air is
    opaque [-]."""
    radiance: Float[Array, "band y x"] | None
    """At the sensor, with its noise if that was drawn [W m-2 sr-1 um-1]; None without air."""
    transparent: Bool[Array, " band"]
    """Whether the air lets the ground's light through in each band."""
    reflectance_sd: Float[Array, "band y x"] | None
    """Standard deviation of a reflectance by panels, of line and noise; None without panels [-]."""
    residual: Float[Array, " band"]
    """Estimated error of light scattered more than once, see `fynjax.radiation.Light` [-]."""
    seen: Bool[Array, "y x"] | None = None
    """Pixels that lie wholly in the frame of a camera of known pose; the others have what a wider
    frame would show. None: all."""
    sensor: str = eqx.field(static=True, default="")
    """Name of the sensor."""
    bands: tuple[str, ...] = eqx.field(static=True, default=())
    """Names of the bands."""
    wavelength: tuple[float, ...] = eqx.field(static=True, default=())
    """Centre of each band [nm]."""
    width: tuple[float, ...] = eqx.field(static=True, default=())
    """Full width at half maximum of each band [nm]."""
    pixel: float = eqx.field(static=True, default=1.0)
    """Edge of a pixel on the ground [m]."""
    origin: tuple[float, float] = eqx.field(static=True, default=(0.0, 0.0))
    """South-west corner of the image from that of the scene [m]; row 0 is the southernmost."""

    def __getitem__(self, band: str) -> Float[Array, "y x"]:
        """Reflectance factor of a band [-]. Raises `InputError` for a band that there is not."""
        if band not in self.bands:
            known = zip(self.bands, self.wavelength, strict=True)
            raise InputError(
                f"expected a band of {self.sensor}, but got {band!r}. Its bands are "
                f"{listed(f'{name} ({centre:.4g} nm)' for name, centre in known)}."
                f"{did_you_mean(str(band), self.bands)}"
            )
        return self.reflectance[self.bands.index(band)]

    def index(self, name: str) -> Float[Array, "y x"]:
        """A vegetation index of each pixel, mostly [-]; NaN where it is undefined. Differentiable.

        **Arguments:** `name` of `fynjax.metrics.VEGETATION_INDICES`. Its bands are chosen by their
        wavelengths and widths; `index_bands` says which they are.

        **Raises:** `InputError` for another name, and for an index of which the sensor lacks a
        band, with the wavelengths that it would have.
        """
        return vegetation_indices(self.reflectance, [name], self._spectral)[0]

    @property
    def index_bands(self) -> dict[str, dict[str, tuple[str, ...]]]:
        """Every vegetation index that the sensor gives, and the bands that it is made of, by letter
        of its formula: those of NDVI are {'N': ('B8',), 'R': ('B4',)} with Sentinel-2."""
        return index_bands(self._spectral)

    @property
    def _spectral(self) -> BandSet:
        return BandSet(self.bands, self.wavelength, self.width)

    def to_xarray(self) -> "xr.Dataset":
        """The image as a dataset with CF names, units and coordinates from the scene's south-west
        corner [m]."""
        import xarray as xr  # late: the command line need not wait for it

        light = {"units": "nm", "standard_name": "radiation_wavelength"}
        coordinates = {
            "band": ("band", list(self.bands), {"long_name": "band"}),
            "wavelength": ("band", np.array(self.wavelength), light),
            **map_coordinates(self.reflectance.shape[1:], self.pixel, self.origin),
        }
        dims = ("band", "y", "x")
        factor = {"units": "1", "long_name": "reflectance factor"}
        light = {"units": "W m-2 sr-1 um-1", "long_name": "radiance at the sensor"}
        deviation = {"units": "1", "long_name": "standard deviation of the reflectance factor"}
        data: dict[str, Any] = {"reflectance": (dims, np.asarray(self.reflectance), factor)}
        if self.radiance is not None:
            data["radiance"] = (dims, np.asarray(self.radiance), light)
        if self.reflectance_sd is not None:
            data["reflectance_sd"] = (dims, np.asarray(self.reflectance_sd), deviation)
        if self.seen is not None:
            data["seen"] = (dims[1:], np.asarray(self.seen), {"long_name": "in the camera's frame"})
        title = f"{self.sensor} over a simulated plot"
        return xr.Dataset(data, coordinates, map_attributes(title, self.pixel))

    def to_dataframe(self) -> "pd.DataFrame":
        """A row for each pixel: x and y of its middle [m], a column for each band [-], and of a
        camera of known pose whether it is in the frame (`seen`)."""
        import pandas as pd  # late: the command line need not wait for it

        rows, columns = self.reflectance.shape[1:]
        y, x = np.mgrid[0:rows, 0:columns] + 0.5
        places = {
            "x": self.origin[0] + self.pixel * x.ravel(),
            "y": self.origin[1] + self.pixel * y.ravel(),
        }
        values = np.asarray(self.reflectance).reshape(len(self.bands), -1)
        table = pd.DataFrame(places | dict(zip(self.bands, values, strict=True)))
        return table if self.seen is None else table.assign(seen=np.asarray(self.seen).ravel())

    def plot(self, bands: Sequence[str] | None = None, **options: Any) -> Any:
        """Draw bands of the image side by side, by xarray.

        **Arguments:** `bands`, all that a camera has by default, six of a spectrometer; `options`
        of `xarray.plot.imshow`.
        """
        if bands is None:
            every = -(-len(self.bands) // 6) if len(self.bands) > 6 else 1
            bands = self.bands[::every]
        chosen = self.to_xarray()["reflectance"].sel(band=list(bands))
        draw: Any = chosen.plot.imshow
        return draw(**({"col": "band", "col_wrap": min(len(bands), 4)} | options))

    def __str__(self) -> str:
        """Description of the sensor, and the mean of each band, in a sentence."""
        shape = " x ".join(map(str, self.reflectance.shape[-2:]))
        text = f"{self.sensor}: {shape} pixels of {self.pixel:g} m in {len(self.bands)} bands"
        if isinstance(self.reflectance, jax.core.Tracer) or self.reflectance.ndim != 3:
            return f"{text}."
        seen = np.ones(self.reflectance.shape[1:], bool) if self.seen is None else self.seen
        mean = np.asarray(self.reflectance)[:, np.asarray(seen)].mean(axis=1)
        some = range(0, len(self.bands), -(-len(self.bands) // 8))
        shown = ", ".join(f"{self.bands[i]} {mean[i]:.3f}" for i in some)
        where = "" if self.seen is None else f" of the {np.mean(seen):.0%} in the frame"
        return f"{text}; mean reflectance{where} {shown}."

    _repr_html_ = as_html


class Placement(eqx.Module):
    """Where an imaging sensor is, and how large its pixels are. None: as its file has it."""

    altitude: float | None = eqx.field(static=True, default=None)
    """Height of the sensor above the ground [m]. A sensor without one, such as an orthographic
    view, is taken to be in space where the air asks for it."""
    pixel: float | None = eqx.field(static=True, default=None)
    """Edge of a pixel on the ground [m]; None: that of the sensor (`Sensor.pixel`)."""
    tilt: float | None = eqx.field(static=True, default=None)
    """Angle of the optical axis from straight down towards the heading [degrees]. An orthographic
    view has neither."""
    heading: float | None = eqx.field(static=True, default=None)
    """Direction of the heading, clockwise from north [degrees]."""
    frame: Frame | None = None
    """Where a frame camera hung and how it was turned, in place of altitude, tilt and heading: it
    then need not look at the middle of the plot."""


class AimedSensor(eqx.Module):
    """An imaging sensor over a scene; `aim` makes one. Call `observe` with scene and parameters.

    It serves every scene of the same extent, boundary and mean height of the ground, such as the
    same one with other plants.
    """

    sensor: Sensor
    air: PlotAir | Atmosphere | None
    """None: reflectance alone, under the scene's own sky."""
    rays: AbstractRays
    accuracy: Accuracy = eqx.field(static=True)
    """Accuracy to which the light is solved."""
    pixel: float = eqx.field(static=True)
    """Edge of a pixel on the ground [m]."""
    shape: tuple[int, int] = eqx.field(static=True)
    """Rows and columns of the image."""
    origin: tuple[float, float] = eqx.field(static=True)
    """South-west corner of the image from that of the scene [m]."""
    sensor_height: Float[Array, ""]
    """Height of the sensor above the ground, for the air [m]."""
    margin: int = eqx.field(static=True)
    """Pixels around the image that `rays` has on top, for the point spread."""
    fine: tuple[int, int] | None = eqx.field(static=True)
    """Rows and columns of rays over the scene where pixels are wider than voxels; else None."""
    samples: int = eqx.field(static=True)
    """Rays along the edge of a voxel where pixels are wider than voxels."""
    together: int = eqx.field(static=True)
    """Rays along an edge of the blocks that share the light of many bands."""
    steepest: float = eqx.field(static=True)
    """Zenith angle that no ray exceeds, in whole steps of 5, lest each height of the sensor compile
    anew [degrees]."""
    averaged: Float[Array, ""]
    """The sensor's own pixels (`Sensor.pixel`) that a pixel is the mean of; at least 1. Its noise
    is as much lower."""
    panels: PanelsInPicture | None = None
    """Panels in the picture; None: none."""
    sight: Float[Array, "row column 2"] | None = None
    """Lines of sight of `rays` in the frame of a camera of known pose, as of `Frame.sight`; None
    without one."""
    seen: Bool[Array, "y x"] | None = None
    """Pixels that lie wholly in that frame."""

    def observe(
        self,
        scene: Scene,
        parameters: PlotParameters,
        *,
        key: Array | int | None = None,
        air: PlotAir | Atmosphere | None = None,
        surroundings: Float[Array, " band"] | None = None,
        pose: Pose | None = None,
    ) -> Observation:
        """What the sensor measures of whole plants. Differentiable in `scene`, `parameters`, `air`,
        `surroundings`, `pose`. Where the number of plants moves, value and derivative are those of
        the stand in expectation (`Scene.expected`). Light has first derivatives.

        **Arguments:** `key`, JAX key or seed of the noise, none if left out; `air`, instead of the
        object's own; `surroundings`, reflectance in the sensor's bands of the land beyond the
        plot, whose light air scatters into the picture [-], left out the mean of the plot (the
        neighbourhood is more of the same); `pose`, of a camera that was not quite where it was
        aimed from: the picture was laid on the map by the pose that was known, so that each pixel
        shows the ground that the same place in the frame sees from here.

        Raises `InputError` for noise without air or without a noise model, for air that does not
        cover the bands, for a `pose` of a sensor that was aimed without one, and where parameters
        and air are known for parameters out of bounds, and as `check`.
        """
        if pose is not None:
            return self.from_pose(pose).observe(
                scene, parameters, key=key, air=air, surroundings=surroundings
            )
        air = self.air if air is None else air
        if key is not None and (air is None or self.sensor.noise is None):
            lack = "no noise model" if air is not None else "no air to make radiance of"
            raise InputError(f"noise was asked for, but {self.sensor.name!r} has {lack}")
        surroundings = None if surroundings is None else jnp.asarray(surroundings)
        if surroundings is not None and surroundings.shape != (len(self.sensor.bands),):
            raise InputError(
                f"`surroundings` must have one value for each of the {len(self.sensor.bands)} "
                f"bands, but has shape {surroundings.shape}."
            )
        parameters = jax.tree.map(lambda x: jnp.asarray(x, scene.dtype), parameters)
        bands, by_band, sky = self.sensor.bands, None, None
        if concrete(parameters, air):
            within_bounds(parameters, scene.taxa)
            _check_air(air, parameters.light, self.sensor_height)
        if air is not None:
            by_band, sky = _air_and_sky(
                air, parameters.light, bands, self.sensor_height, scene.dtype
            )
        # Three programs, not one, where this is called alone: pixels of another size then share two
        # of them, and another planting all but the first.
        voxels = _voxels(scene.unnamed(), parameters, bands, sky)
        light = _light(voxels, self.accuracy)
        key = jax.random.key(key) if isinstance(key, int | np.integer) else key
        return _measured(self, light, voxels, by_band, surroundings, key)

    def _measured(
        self,
        light: Light,
        voxels: VoxelScene,
        by_band: Atmosphere | None,
        surroundings: Float[Array, " band"] | None,
        key: Array | None,
    ) -> Observation:
        """The image that a sensor measures in the `light` of `voxels`, and through the air as it is
        in the bands (`by_band`, by rising wavelength; None: without air): reflectance factor [-],
        and with air radiance with its noise [W m-2 sr-1 um-1]."""
        image, mean = self.lit(light, voxels)
        residual = light.residual
        if by_band is None:
            every = jnp.ones(len(self.sensor.bands), bool)
            return Observation(image, None, every, None, residual, self.seen, **self._described)
        order, back = _sorting(self.sensor.bands)
        if self.panels is not None:
            image = self.panels.laid_on(image)
        # From reflectance to radiance at the sensor, with its noise.
        pixels = jnp.moveaxis(image, 0, -1)[..., order]
        around = (mean if surroundings is None else jnp.asarray(surroundings, mean.dtype))[order]
        radiance = at_sensor_radiance(by_band, pixels, around)
        if key is not None and self.sensor.noise is not None:
            noise = self.sensor.noise
            radiance = noise.draw(key, radiance[..., back], averaged=self.averaged)[..., order]
        transparent, measured = is_transparent(by_band)[back], radiance[..., back]
        # And back, by what calibration knows: the air, or panels in the picture.
        reflectance_sd = None
        if self.panels is None:
            calibrated = surface_reflectance(by_band, radiance, around)[..., back]
        else:
            noise_sd: Array | float = 0.0
            if key is not None and self.sensor.noise is not None:
                noise_sd = self.sensor.noise.standard_deviation(measured, averaged=self.averaged)
            line = self.panels.line(
                jnp.moveaxis(measured, -1, 0),
                transparent,
                noise_sd=jnp.moveaxis(jnp.broadcast_to(noise_sd, measured.shape), -1, 0),
                haze=at_sensor_radiance(by_band, jnp.zeros_like(around), around)[back],
            )
            calibrated = jnp.where(transparent, line.reflectance(measured), 0.0)
            sd = jnp.where(transparent, line.standard_deviation(measured, noise_sd), 0.0)
            reflectance_sd = jnp.moveaxis(sd, -1, 0)
        return Observation(
            jnp.moveaxis(calibrated, -1, 0),
            jnp.moveaxis(measured, -1, 0),
            transparent,
            reflectance_sd,
            residual,
            self.seen,
            **self._described,
        )

    @property
    def _described(self) -> dict[str, Any]:
        bands = self.sensor.bands
        return {
            "sensor": self.sensor.name,
            "bands": bands.names,
            "wavelength": tuple(map(float, bands.centre)),
            "width": tuple(map(float, bands.fwhm)),
            "pixel": self.pixel,
            "origin": self.origin,
        }

    def from_pose(self, pose: Pose) -> "AimedSensor":
        """The same frame from another pose. Differentiable in `pose`.

        **Arguments:** `pose`, near the one that it was aimed from: what is seen stays the same, and
        layers are cut as for that.

        **Raises:** `InputError` where the sensor was aimed without a pose.
        """
        frame = frame_of(self.sensor.camera)
        if self.sight is None or frame is None:
            raise InputError("expected a sensor that was aimed with a pose, to take another one")
        sight = self.sight
        east, north, height = jnp.asarray(pose.position, sight.dtype)
        # Heights of rays count from the zero level, that of a pose from the mean of the ground.
        altitude = height + (frame.position[2] - self.sensor_height).astype(sight.dtype)
        slope_x, slope_y = jnp.moveaxis(pose.slopes(sight), -1, 0)
        rays = self.rays
        assert isinstance(rays, RayLattice | RayField)
        spacing = rays.footprint if isinstance(rays, RayLattice) else rays.widest
        # Pixels often end where voxels do, and have another slope on either side. They are moved
        # away by a thousandth, lest half of them have none.
        away = _ASIDE * spacing
        moved = RayField(
            east - altitude * slope_x + away,
            north - altitude * slope_y + away,
            slope_x,
            slope_y,
            jnp.full_like(slope_x, spacing),
            widest=spacing,
        )
        return dataclasses.replace(self, rays=moved)

    def check(self, parameters: PlotParameters) -> Atmosphere | None:
        """The air's curves under the sun and with the aerosol of `parameters`; None without air.

        Raises `InputError` where they do not cover the bands, or the air's model does not reach to
        that sun or has values out of range, which `observe` cannot inside a transformation.
        """
        if self.air is None:
            return None
        curves = self.air
        _check_air(curves, parameters.light, self.sensor_height)
        if isinstance(curves, PlotAir):
            curves = _atmosphere(curves, parameters.light, self.sensor_height)
        self.sensor.bands.weights(curves.wavelength)
        return curves

    def image(
        self, voxels: VoxelScene
    ) -> tuple[Float[Array, "band y x"], Float[Array, " band"], Float[Array, " band"]]:
        """Reflectance factor of the pixels, its mean over the scene, and the light's residual [-].

        Without air, panels and noise; in whatever bands `voxels` has. Differentiable in `voxels`.
        """
        voxels, rays = unfolded((voxels, self.rays))
        light = solve_light(voxels, self.accuracy)
        return *dataclasses.replace(self, rays=rays).lit(light, voxels), light.residual

    def lit(
        self, light: Light, voxels: VoxelScene
    ) -> tuple[Float[Array, "band y x"], Float[Array, " band"]]:
        """Reflectance factor of the pixels, and its mean over the scene [-], in the `light` of
        `voxels`, which sensors of one accuracy share. Differentiable in both."""
        # As many bands at once as voxels leave memory for.
        chunk = min(max(_VOXELS // int(np.prod(voxels.shape)), 8), 32)
        factor = reflectance_factor(
            light, self.rays, chunk=chunk, steepest=self.steepest, together=self.together
        )
        return self.averages(factor, voxels)

    def averages(
        self, factor: Float[Array, "band row column"], voxels: VoxelScene
    ) -> tuple[Float[Array, "band y x"], Float[Array, " band"]]:
        """Pixels of the image, and its mean over the scene, from the reflectance factor along each
        of `rays`, or of their blocks [-]. Of `voxels` the sides and the boundary count."""
        edge = slice(self.margin, -self.margin or None)
        within = factor[:, edge, edge]  # the margin repeats pixels of the scene's other side
        mean = within.mean(axis=(1, 2))
        psf = self.sensor.psf
        if self.fine is None:
            return within if psf is None else psf.blur(factor)[:, edge, edge], mean
        sides = tuple(n * voxels.horizontal for n in voxels.shape[1:])
        shares = []
        for axis, count, start, cells, length in zip(
            ("y", "x"), self.shape, self.origin[::-1], within.shape[1:], sides, strict=True
        ):
            # How much of each row, or column, of rays lies in each pixel, blur included.
            centres = start + (np.arange(count) + 0.5) * self.pixel
            kernel = None if psf is None else psf.kernel(axis, factor.dtype)  # type: ignore[arg-type]
            share = footprint_shares(
                centres,
                self.pixel,
                cells,
                length,
                periodic=voxels.boundary == "periodic",
                kernel=kernel,
            )
            shares.append(share.astype(factor.dtype))
        # Shares of a pixel along both axes multiply, since pixels lie along them.
        image = jnp.einsum("pr,brc,qc->bpq", shares[0], factor, shares[1], optimize="optimal")
        return image, mean

    def sampled(self, stride: int) -> "AimedSensor":
        """The same with every `stride`-th pixel along each axis, without blur: a fair sample of the
        image at a fraction of its cost. Where pixels are wider than voxels, all of them, from one
        ray a voxel. Panels are left out."""
        step = stride if self.fine is None else self.samples
        rows, columns = (
            slice(self.margin, self.margin + n if self.fine is None else None, step)
            for n in self.shape
        )
        rays: AbstractRays = self.rays
        view: dict[str, Any] = {}
        if isinstance(rays, RayLattice):  # a number for each column, or each row
            rays = dataclasses.replace(
                rays, x=rays.x[columns], slope_x=rays.slope_x[columns],
                y=rays.y[rows], slope_y=rays.slope_y[rows],
            )  # fmt: skip
        else:
            rays = jax.tree.map(lambda v: v[rows, columns], rays)
        if self.seen is not None:
            view["seen"] = self.seen[::step, ::step] if self.fine is None else self.seen
        if self.sight is not None:
            view["sight"] = self.sight[rows, columns]
        shape, fine = (rays.shape, None) if self.fine is None else (self.shape, rays.shape)
        return dataclasses.replace(
            self,
            sensor=dataclasses.replace(self.sensor, psf=None),
            rays=rays,
            shape=shape,
            margin=0,
            fine=fine,
            samples=1,
            together=1,
            panels=None,
            **view,
        )


def fitted_accuracy(accuracy: Accuracy, scene: Scene, parameters: PlotParameters) -> Accuracy:
    """Accuracy of the light that fits the grid of a scene.

    **Arguments:**

    - `accuracy`: as asked for.
    - `scene`: whose grid the blocks of `accuracy.coarsening` are to divide.
    - `parameters`: of which the sun counts, where the scene is open.

    **Returns:** `accuracy` with blocks that divide the grid and, of an open scene without a stated
    margin, room for the sun to stand 5 degrees lower than it does.

    **Raises:** `InputError` where that sun is traced.
    """
    grid = scene.class_grid
    nx, ny, nz = grid.shape
    blocks = accuracy.coarsening
    if blocks is not None:
        high, wide = blocks
        while nx % wide or ny % wide:
            wide -= 1
        while nz % high:
            high -= 1
        blocks = high, wide
    margin = accuracy.margin
    if scene.boundary == "open" and margin is None:
        _check_known("the sun over an open scene", parameters.light.sun_zenith)
        # The sun may move after aiming; the margin, which is static, does not.
        columns = grid.extent[2] / grid.horizontal_size
        margin = int(np.ceil(columns * np.tan(np.deg2rad(lowest_sun(parameters)))))
    return dataclasses.replace(accuracy, coarsening=blocks, margin=margin)


def lowest_sun(parameters: PlotParameters) -> float:
    """Zenith angle of the sun for which there is room beside an open scene [degrees]."""
    return min(float(parameters.light.sun_zenith) + 5.0, 85.0)


def _check_known(what: str, values: Any) -> None:
    """Raise `InputError` where any of `values` is traced."""
    if not concrete(values):
        raise InputError(
            f"{what} must be known, but is traced: call `aim` before the transformation, and "
            "`observe` of the sensor that it aims inside"
        )


@jax.ensure_compile_time_eval()
def aim(
    scene: Scene,
    parameters: PlotParameters,
    sensor: Sensor,
    placement: Placement | None = None,
    *,
    air: PlotAir | Atmosphere | None = None,
    panels: Sequence[Panel] = (),
    point_spread: bool = True,
    accuracy: Accuracy | None = None,
) -> AimedSensor:
    """Aim an imaging sensor at the middle of a scene.

    **Arguments:**

    - `scene`: whose extent, heights and boundary count.
    - `parameters`: of which the sun counts, where the scene is open.
    - `sensor`: from `fynjax.sensors.shipped_sensor` or a file.
    - `placement`: of the sensor and its pixels; left out, as its file has them. With a `frame` it
      looks where that looked, and `seen` says which pixels lie in it.
    - `air`: between scene and sensor; None for reflectance alone.
    - `panels`: that lie in the picture and calibrate it, with sharp edges. For a sensor in air.
    - `point_spread`: whether the optics blur, as much on the ground whatever the image's pixel.
    - `accuracy`: of the light; left out, that of a drone's image.

    As many whole pixels as the scene holds lie in its middle; a periodic scene smaller than a pixel
    fills one, for it goes on for ever. Over terrain a pixel is seen along the line of sight that
    meets the mean height of the ground there, and of a `frame` along that which meets the ground
    itself, as in a picture that was laid on a map with a model of the terrain.

    Camera, terrain and, of an open scene, the sun must be known: aim before a transformation,
    observe inside.

    **Raises:** `InputError` for an open scene smaller than a pixel, a sensor that is not above the
    plants, a frame that shows nothing of the plot, by its name, values out of range, and what is
    traced but must be known.
    """
    _check_known("a camera", sensor.camera)
    _check_known("the terrain of a scene", scene.terrain)
    placement = Placement() if placement is None else placement
    if panels and air is None:
        raise InputError("expected an atmosphere: panels calibrate radiance")
    accuracy = fitted_accuracy(DRONE if accuracy is None else accuracy, scene, parameters)
    known = None if placement.frame is None else _known_frame(placement, sensor.camera)
    height, own, pixel = _height_and_pixel(scene, sensor, placement, known)
    lx, ly, _ = scene.grid.extent
    periodic = scene.boundary == "periodic"
    (columns, west), (rows, south) = (axis_pixels(s, pixel, periodic=periodic) for s in (lx, ly))
    shape, origin = (rows, columns), (west, south)
    psf = sensor.psf if point_spread else None
    if psf is not None:  # its reach must be known inside transformations
        # The optics blur as much on the ground whatever pixels the image is resampled to.
        psf = psf.on_pixels(pixel / own)
        psf = dataclasses.replace(psf, radius=psf.reach())
    # Rays: one a pixel, or where pixels are wider than voxels several a voxel, for their means.
    # In many bands light is followed along the middle of blocks of rays, which share it.
    few = accuracy.solves is None or len(sensor.bands) <= accuracy.solves
    samples = max(scene.finer, SAMPLES)
    together = 1 if few or samples % SAMPLES else samples // SAMPLES
    resolved = scene.grid.horizontal_size / max(scene.finer, 1)
    wide = pixel > max(resolved, 1e-9) * (1.0 + 1e-6)
    # Blur needs neighbours beyond the edge: of a periodic scene those of its other side.
    margin = psf.reach() if psf is not None and periodic and not wide else 0
    fine = None
    if wide:
        fine = samples * scene.grid.shape[1], samples * scene.grid.shape[0]
        spacing = scene.grid.horizontal_size / samples
        axes = [(np.arange(n) + 0.5) * spacing for n in fine[::-1]]
    else:
        spacing = pixel
        axes = [
            start + (np.arange(-margin, n + margin) + 0.5) * pixel
            for start, n in ((west, columns), (south, rows))
        ]
    x, y = (jnp.asarray(axis, scene.dtype) for axis in axes)
    # First, since it refuses an attitude that no camera can have.
    camera = _aimed(sensor.camera, (lx / 2, ly / 2), height, scene.ground_level, placement)
    sight = seen = None
    if known is not None:
        sight, seen = _in_frame(known, scene, (x, y), shape, origin, pixel)
        sight = None if known.mosaic else sight  # it was taken from no single pose
    rays = _rays_to_ground(scene, sensor.camera, placement, known, height, (x, y), spacing)
    # Rays that cross several voxels in a layer are cut into as many pieces.
    slope = float(jnp.tan(jnp.arccos(jnp.min(rays.cosine))))
    pieces = min(8, int(np.ceil(slope - 1e-6)))
    if accuracy.sublayers is not None and accuracy.sublayers < pieces:
        accuracy = dataclasses.replace(accuracy, sublayers=pieces)
    return AimedSensor(
        sensor=dataclasses.replace(sensor, camera=camera, psf=psf),
        air=air,
        rays=rays,
        accuracy=accuracy,
        pixel=pixel,
        shape=shape,
        origin=origin,
        sensor_height=real_array(height),
        margin=margin,
        fine=fine,
        samples=samples,
        together=together if wide else 1,
        steepest=5.0 * math.ceil(math.degrees(math.atan(slope)) / 5.0 - 1e-6),
        averaged=real_array(max(1.0, (pixel / own) ** 2)),
        panels=panels_in_picture(panels, shape, pixel, origin) if panels else None,
        sight=sight,
        seen=seen,
    )


def _height_and_pixel(
    scene: Scene, sensor: Sensor, placement: Placement, known: Frame | None
) -> tuple[float, float, float]:
    """Height of the sensor above the ground, its own pixels there, and those of the image [m]."""
    top, base = scene.grid.extent[2], scene.ground_level
    if frame_of(sensor.camera) is None and (
        placement.tilt is not None or placement.heading is not None
    ):
        raise InputError("an orthographic view has no tilt or heading: set its view angles instead")
    height = sensor.altitude if placement.altitude is None else placement.altitude
    if known is not None:
        height = float(known.pose.position[2])
    if not height + base > top:
        raise InputError(
            f"the sensor must be above the plants, which reach {top - base:.2f} m, but is at "
            f"{height:g} m above the ground"
        )
    own = float(sensor.pixel(height))
    if known is not None and known.lens is not None:
        own = height / math.sqrt(math.prod(known.lens.focal_length)) * sensor.pixel_factor
    pixel = own if placement.pixel is None else placement.pixel
    if not 0.0 < pixel < np.inf:
        raise InputError(f"`pixel` must be a positive number of m, but is {pixel:g}.")
    return height, own, pixel


def _rays_to_ground(
    scene: Scene,
    camera: AbstractCamera,
    placement: Placement,
    known: Frame | None,
    height: float,
    points: tuple[Array, Array],
    spacing: float,
) -> AbstractRays:
    """Lines of sight to `points` of the map, columns and rows [m]."""
    lx, ly, _ = scene.grid.extent
    base, (x, y) = scene.ground_level, points
    if known is not None and (scene.terrain is not None or known.mosaic):
        return _rays_over_terrain(known, scene, x, y, spacing)
    # The map is at the mean height of the ground: laid out there, then moved to the zero level.
    level = map_rays(_aimed(camera, (lx / 2, ly / 2), height, 0.0, placement), x, y, spacing)
    return dataclasses.replace(
        level,
        x=level.x - base * level.slope_x,
        y=level.y - base * level.slope_y,
        altitude=np.inf,  # checked above; static, it would compile anew for each height
    )


def _known_frame(placement: Placement, camera: AbstractCamera) -> Frame:
    """The frame of a placement, with the lens of the camera where it has none of its own."""
    frame = placement.frame
    assert frame is not None
    _check_known("a pose", frame)
    if not isinstance(camera, FrameCamera):
        raise InputError(f"expected a frame camera for a pose, but got a {type(camera).__name__}")
    if any(v is not None for v in (placement.altitude, placement.tilt, placement.heading)):
        raise InputError("expected a pose, or altitude, tilt and heading, but got both")
    lens = lens_of(camera) if frame.lens is None else frame.lens
    parts = tuple(one if one.lens else dataclasses.replace(one, lens=lens) for one in frame.mosaic)
    return dataclasses.replace(frame, lens=lens, mosaic=parts)


def _on_ground(
    scene: Scene, x: Float[ArrayLike, " column"], y: Float[ArrayLike, " row"]
) -> Float[np.ndarray, "row column 3"]:
    """Points of the ground at eastings and northings: height above its mean level [m]."""
    east, north = np.meshgrid(np.asarray(x, float), np.asarray(y, float))
    height = np.zeros_like(east)
    if scene.terrain is not None:
        at = [axis / scene.grid.horizontal_size - 0.5 for axis in (north, east)]
        mode = "grid-wrap" if scene.boundary == "periodic" else "nearest"
        terrain = np.asarray(scene.terrain, float) - scene.ground_level
        height = interpolated(terrain, at, order=1, mode=mode)
    return np.stack([east, north, height], axis=-1)


def _in_frame(
    frame: Frame,
    scene: Scene,
    axes: tuple[Array, Array],
    shape: tuple[int, int],
    origin: tuple[float, float],
    pixel: float,
) -> tuple[Float[Array, "row column 2"], Bool[Array, "y x"]]:
    """Lines of sight of rays at the crossings of `axes` (x, y), and which pixels of the map lie
    wholly in the frame. Raises `InputError` where none does."""
    edges = (start + np.arange(n + 1) * pixel for start, n in zip(origin, shape[::-1], strict=True))
    seen = frame.sees_cells(_on_ground(scene, *edges))
    if not seen.any():
        east, north, height = (float(v) for v in frame.pose.position)
        at = np.array([east, north]) - height * np.asarray(frame.pose.slopes(jnp.zeros(2)))
        lx, ly, _ = scene.grid.extent
        raise InputError(
            f"expected a frame that shows some of the plot of {lx:g} x {ly:g} m, but "
            f"{frame.name or 'this one'}, from {east:.1f} m east and {north:.1f} m north of its "
            f"corner and {height:.1f} m above it, looks at {at[0]:.1f} m east and {at[1]:.1f} m "
            "north. Are position and height counted from the plot's corner and ground, and the "
            "pitch from straight down?"
        )
    # What lies behind the camera is seen by no pixel: any line of sight will do.
    sight = np.nan_to_num(frame.sight(_on_ground(scene, *axes)))
    return jnp.asarray(sight, scene.dtype), jnp.asarray(seen)


def _rays_over_terrain(frame: Frame, scene: Scene, x: Array, y: Array, spacing: float) -> RayField:
    """Rays from the ground at the crossings of `x` and `y` to a camera."""
    points = _on_ground(scene, x, y)
    away = frame.camera_over(points) - points
    if not (away[..., 2] > 0.0).all():
        raise InputError(
            f"expected a camera above all of the terrain, but {frame.name or 'it'} hangs "
            f"{float(frame.pose.position[2]):.1f} m above its mean height"
        )
    slope = away[..., :2] / away[..., 2:]
    foot = points[..., :2] - (points[..., 2:] + scene.ground_level) * slope
    of_rays = jnp.asarray(np.concatenate([foot, slope], axis=-1), scene.dtype)
    east, north, slope_x, slope_y = jnp.moveaxis(of_rays, -1, 0)
    width = jnp.full_like(east, spacing)
    return RayField(east, north, slope_x, slope_y, width, widest=spacing)


def _check_air(
    air: PlotAir | Atmosphere | None, light: LightParameters, height: Float[Array, ""]
) -> None:
    """Raise `InputError` where a model does not reach to known air, or to the sun."""
    if isinstance(air, PlotAir):
        known = air.clear_air(light, height)
        if air.model == "table":
            check_within_table(known)


def _air_in_bands(
    air: PlotAir | Atmosphere,
    light: LightParameters,
    bands: BandSet,
    height: Float[Array, ""],
    dtype: str,
) -> tuple[Atmosphere, Float[Array, " band"]]:
    """Air below and above a sensor at a `height` [m] in the bands, by rising wavelength, and the
    share of its light that is diffuse in each, in their own order [-]."""
    curves = air.atmosphere(light, height) if isinstance(air, PlotAir) else air
    order, back = _sorting(bands)
    averages = band_atmosphere(curves, bands.select(order.tolist()))
    by_band = jax.tree.map(lambda v: v.astype(dtype), averages)
    # Opaque bands have no light to share: no 0 / 0 there.
    total = by_band.direct + by_band.diffuse
    return by_band, (by_band.diffuse / jnp.maximum(total, jnp.finfo(total.dtype).tiny))[back]


def _voxels_under(
    scene: Scene, parameters: PlotParameters, bands: BandSet, sky: Float[Array, " band"] | None
) -> VoxelScene:
    """`Scene.voxels` under its own sky, or with a share `sky` of diffuse light in each band [-]."""
    voxels = scene.voxels(parameters, bands)
    if sky is None:
        return voxels
    where = lambda s: (s.illumination.sun, s.illumination.sky)  # noqa: E731
    return eqx.tree_at(where, voxels, (1.0 - sky, sky))


_atmosphere = eqx.filter_jit(PlotAir.atmosphere)
_air_and_sky = as_one(_air_in_bands, inline=False)
_voxels = as_one(_voxels_under, inline=False)
_light = as_one(solve_light, inline=False)
_measured = as_one(AimedSensor._measured, inline=False)


def _observe(
    aimed: AimedSensor, scene: Scene, parameters: PlotParameters, *, key: Array | None = None
) -> Observation:
    """`AimedSensor.observe`, and its derivative by any of the parameters by the same programs."""
    if concrete(scene, parameters):
        return aimed.observe(scene, parameters, key=key)
    # Of one type, weak ones too, lest another choice of parameters be another program.
    parameters = jax.tree.map(lambda x: jnp.asarray(x, scene.dtype), parameters)
    return _differentiable(aimed, scene.unnamed(), parameters, key)


def _observe_with(
    aimed: AimedSensor, scene: Scene, parameters: PlotParameters, key: Array | None
) -> Observation:
    return aimed.observe(scene, parameters, key=key)


_differentiable = eqx.filter_custom_jvp(_observe_with)


@_differentiable.def_jvp
def _by_all_parameters(primals: Any, tangents: Any) -> Any:
    """A derivative by some parameters outside `jit` as that by all, lest each choice of them be
    compiled anew: the others change too, by nothing."""
    aimed, scene, parameters, key = primals
    change = tangents[2]
    if concrete(primals) and (some := jax.tree.leaves(change)):
        change = jax.tree.map(
            lambda value, own: _nothing(value, some[0]) if own is None else own, parameters, change
        )
        own = (getattr(tangents[1], name) for name in ("number", "rounding", "whole", "clumping"))
        moves = scene.counts_move(tangents[2]) or bool(jax.tree.leaves([*own]))
        scene = eqx.tree_at(lambda s: s.held, scene, jnp.asarray(not moves))

    observed = partial(_observe_with, key=key)
    return eqx.filter_jvp(observed, (aimed, scene, parameters), (*tangents[:2], change))


def _nothing(like: Array, change: Array) -> Array:
    """Zeros as `like` that to JAX depend on `change`: not by a product, whose zero times an
    infinite slope would be NaN, but as what surrounds none of its numbers."""
    none = jax.lax.slice(jnp.ravel(change), (0,), (0,))
    return jax.lax.pad(none, jnp.zeros((), none.dtype), [(0, like.size, 0)]).reshape(like.shape)


@overload
def observe(
    scene: Scene,
    sensor: Lidar,
    *,
    parameters: PlotParameters | None = ...,
    noise: bool = ...,
    seed: int = ...,
) -> LidarObservation: ...


@overload
def observe(
    scene: Scene,
    sensor: Sensor,
    *,
    parameters: PlotParameters | None = ...,
    pixel: float | None = ...,
    altitude: float | None = ...,
    placement: Placement | None = ...,
    pose: Pose | Frame | None = ...,
    lens: Lens | None = ...,
    noise: bool = ...,
    seed: int = ...,
    **options: Any,
) -> Observation: ...


@overload
def observe(scene: Scene, sensor: str | Path | Sensor | Lidar, **options: Any) -> Any: ...


def observe(
    scene: Scene,
    sensor: str | Path | Sensor | Lidar,
    *,
    parameters: PlotParameters | None = None,
    pixel: float | None = None,
    altitude: float | None = None,
    placement: Placement | None = None,
    pose: Pose | Frame | None = None,
    lens: Lens | None = None,
    noise: bool = False,
    seed: int = 0,
    **options: Any,
) -> Observation | LidarObservation:
    """What a sensor measures of a scene: an image, or a LiDAR's waveforms and returns.

    **Arguments:**

    - `scene`: from `Scene.from_table`, `build_scene` or a plot file.
    - `sensor`: name of a shipped one, path of a sensor file (.toml), or an object. Bands beyond the
      spectra of leaves and ground are left out (`visible_sensor`).
    - `parameters`: instead of the scene's own; of the same species, within their bounds.
    - `pixel`, `altitude`: edge of a pixel on the ground, and height of an imaging sensor above the
      ground [m]; left out, as the sensor's file has them.
    - `placement`: instead of these two, with tilt and heading. A LiDAR's file says where it flies.
    - `pose`, `lens`: of a frame camera where it hung, in place of an altitude; a `Frame`, as
      `fx.read_frames` gives it, has both and a name. Left out, the lens is the sensor's own. The
      image is the frame laid on the map; its `seen` says which pixels lie in it. A pose as an
      argument of a transformation goes to `AimedSensor.observe`, of a sensor aimed from near it.
    - `noise`: whether to draw noise; of an imaging sensor in air.
    - `seed`: of the noise, and of a LiDAR's pulses.
    - `options`: of an imaging sensor, as `aim` takes them: `air`, `panels`, `point_spread`,
      `accuracy`.

    **Returns:** an `Observation`, or a `LidarObservation`, of the same whole plants. Both are
    differentiable in `parameters`, and in the scene's own arrays, such as the feet of its plants. A
    derivative by what moves the number of plants (cover, diameter) is that of the stand in
    expectation, and the value that comes with it too: the mean over plantings is that of whole
    plants. A loop that compares values with and without a derivative takes `scene.expected()`, of
    which both are the same. A second call with the same shapes compiles nothing.

    Parameters out of their bounds are refused; inside a transformation, where values are not known,
    they count as the bound, with the slope zero, and NaN stays NaN.

    **Raises:** `InputError` for a name that no sensor has, with the nearest, for what is no scene,
    sensor or parameters, for parameters of another length or out of bounds, and for a traced pixel
    or altitude; as `aim`, `AimedSensor.observe` and `observe_lidar`; and for a
    placement, a pose or options of a LiDAR.

    >>> import fynjax as fx
    >>> from fynjax.canopy import table1_2006
    >>> scene = fx.Scene.from_table(table1_2006()[:2], size=1.0, voxel=0.25, structure="even")
    >>> image = fx.observe(scene, "mavic_3m", pixel=0.25)
    >>> image.bands, image["nir"].shape
    (('green', 'red', 'red_edge', 'nir'), (4, 4))
    """
    sensor = sensor_of(sensor)
    if isinstance(sensor, Lidar):
        parameters = _checked(scene, parameters)
        placed = any(v is not None for v in (placement, pixel, altitude, pose, lens))
        if placed or options:
            raise InputError(f"expected no placement or options of the LiDAR {sensor.name!r}")
        return observe_lidar(scene, parameters, sensor, noise=noise, seed=seed)
    options |= {"pixel": pixel, "altitude": altitude, "placement": placement}
    options |= {"pose": pose, "lens": lens}
    aimed, parameters = aimed_at(scene, sensor, parameters, **options)
    return _observe(aimed, scene, parameters, key=jax.random.key(seed) if noise else None)


def aimed_at(
    scene: Scene,
    sensor: str | Path | Sensor | Lidar,
    parameters: PlotParameters | None = None,
    *,
    pixel: float | None = None,
    altitude: float | None = None,
    placement: Placement | None = None,
    pose: Pose | Frame | None = None,
    lens: Lens | None = None,
    **options: Any,
) -> tuple[AimedSensor, PlotParameters]:
    """An imaging sensor over a scene, and the parameters that it sees: arguments and errors as of
    `observe`."""
    parameters = _checked(scene, parameters)
    imager = sensor_of(sensor)
    if not isinstance(imager, Sensor):
        raise InputError(f"expected a sensor or the name of one, but got {type(imager).__name__}")
    check_known(pixel=pixel, altitude=altitude, placement=placement)
    if placement is None:
        placement = Placement(altitude, pixel, frame=_frame(pose, lens))
    elif any(v is not None for v in (pixel, altitude, pose, lens)):
        raise InputError(
            "expected `placement`, or `pixel`, `altitude`, `pose` and `lens`, but got both"
        )
    # Of an open scene the sun must be known, which is traced in a slope by it.
    traced = isinstance(parameters.light.sun_zenith, jax.core.Tracer)
    of_sun = scene.parameters if traced else parameters
    aimed = aim(scene, of_sun, visible_sensor(imager), placement, **options)
    return aimed, parameters


def _frame(pose: Pose | Frame | None, lens: Lens | None) -> Frame | None:
    if isinstance(pose, Frame) and lens is None:
        return pose
    if isinstance(pose, Pose) and isinstance(lens, Lens | None):
        return Frame(pose, lens)
    if pose is None and lens is None:
        return None
    raise InputError(
        "expected a pose and a lens, or a frame, which has both, but got "
        f"{type(pose).__name__} and {type(lens).__name__}"
    )


def _checked(scene: Scene, parameters: PlotParameters | None) -> PlotParameters:
    """`parameters`, or those of `scene`. Raises `InputError` where one is of another type."""
    if not isinstance(scene, Scene):
        raise InputError(f"expected a scene, but got {type(scene).__name__}")
    parameters = scene.parameters if parameters is None else parameters
    if not isinstance(parameters, PlotParameters):
        raise InputError(
            f"expected `parameters` as `scene.parameters`, but got {type(parameters).__name__}"
        )
    return within_bounds(parameters, scene.taxa)


def sensor_of(sensor: str | Path | Sensor | Lidar) -> Sensor | Lidar:
    """A `sensor` by its shipped name or its file (.toml); an object as it is.

    **Raises:** `InputError` for another name, with the nearest, and as the reader of the file.
    """
    if not isinstance(sensor, str | Path):
        return sensor
    name = str(sensor)
    with jax.ensure_compile_time_eval():  # known inside transformations too, as `aim` needs it
        if name in shipped_sensors():
            return shipped_sensor(name)
        if name in shipped_lidars():
            return shipped_lidar(name)
        if name.endswith(".toml"):
            return app_room("io.instruments", "load_instrument")(sensor)
    every = (*shipped_sensors(), *shipped_lidars())
    raise InputError(
        f"expected a shipped sensor ({', '.join(every)}), a sensor file (.toml) or an object, but "
        f"got {name!r}.{did_you_mean(name, every)}"
    )


def _aimed(
    camera: AbstractCamera,
    middle: tuple[float, float],
    height: float,
    base: float,
    placement: Placement,
) -> AbstractCamera:
    """The camera where its optical axis meets the ground, at `base` [m], in the `middle` [m]."""
    frame = frame_of(camera)
    if frame is None:
        return camera
    if placement.frame is not None:
        pose = placement.frame.pose
        return dataclasses.replace(
            frame,
            position=pose.position + jnp.asarray([0.0, 0.0, base]),
            tilt=pose.tilt,
            heading=pose.yaw,
        )
    tilt = float(frame.tilt) if placement.tilt is None else placement.tilt
    heading = float(frame.heading) if placement.heading is None else placement.heading
    # A tilted sensor looks ahead: it stands behind the place that its axis meets.
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


def _sorting(bands: BandSet) -> tuple[np.ndarray, np.ndarray]:
    """Places of the bands by rising wavelength, and the way back."""
    order = np.argsort(bands.centre)
    return order, np.argsort(order)

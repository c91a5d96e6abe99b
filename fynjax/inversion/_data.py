"""What was measured: statistics with their errors, and how each sensor sees a scene."""

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from fynjax._core.errors import InputError, listed
from fynjax._core.extras import app_room
from fynjax._core.precision import double_precision, drawn_in_double, in_double
from fynjax._core.programs import concrete
from fynjax.metrics import without_view
from fynjax.scene import Observation, PlotParameters, Scene, fitting_structure
from fynjax.sensors import BandSet, Frame, Gains, Lidar, Pose, Sensor

if TYPE_CHECKING:
    from fynjax.inversion._views import AbstractView

Kind = Literal["image", "pixels", "spectrum", "structure"]
"""What a sensor's statistics are of: a drone's image, its single pixels, a spectrum, a cloud."""
PIXEL_SD = 0.05
"""What the model's pixel is off by, as a share of it [-]: against a path tracer 1 to 2 % where both
have the same voxels of 10 cm (`tests/radiation/test_reference_scenes.py`), and where leaves are
single ones the spread of pixels of 2.5 cm is 5 to 8 % less (`python -m
tests.benchmarks.table_radiation --only plants`)."""
DARKEST = 0.002
"""Reflectance below which the error of a pixel is that of this one [-]."""
MOST_VALUES = 40_000
"""Values of an image that are compared pixel by pixel, at most, unless a block is asked for."""


@dataclasses.dataclass(frozen=True, eq=False)
class Pixels:
    """An image of which pixels count one by one, as means of blocks of them.

    **Raises:** `InputError` for a `block` or `sd` that is not positive, and an image without a
    whole block of pixels.
    """

    image: Float[np.ndarray, "band row column"]
    """Reflectance factor [-], rows from the south; a pixel that is NaN in any band does not
    count."""
    block: int
    """Pixels along the edge of the blocks whose means are compared. Rows and columns beyond the
    last whole block are not compared."""
    sd: float | None = None
    """Error of a block's mean, of camera and model, as a share of it, independent of other blocks
    and bands [-]; errors that the whole plot shares are the gains'. None: `PIXEL_SD`, and besides
    what lobes and shoots of the plants make of it, which no crown tells (`shape_error`)."""

    def __post_init__(self) -> None:
        if self.block < 1 or not self.own_sd > 0.0:
            raise InputError(
                f"`block` and `pixel_sd` must be positive, but are {self.block} and {self.own_sd:g}"
            )
        if not self.compared.any():
            raise InputError(
                f"no block of {self.block} x {self.block} pixels of the image has all its values"
            )

    @property
    def own_sd(self) -> float:
        """Error of a block's mean that it shares with no other, as a share of it [-]."""
        return PIXEL_SD if self.sd is None else self.sd

    @property
    def means(self) -> Float[np.ndarray, "band y x"]:
        """Means over the blocks [-]."""
        return np.asarray(block_means(np.asarray(self.image, float), self.block))

    @property
    def compared(self) -> Bool[np.ndarray, "y x"]:
        """Blocks that count: those whose pixels have all their values."""
        return np.isfinite(self.means).all(axis=0)


def block_means(image: Any, block: int) -> Any:
    """Means of an `image` [band, row, column] over whole blocks of `block` x `block` pixels
    [band, y, x]; rows and columns beyond the last whole block are left out."""
    bands, rows, columns = image.shape
    ny, nx = rows // block, columns // block
    cut = image[:, : ny * block, : nx * block].reshape(bands, ny, block, nx, block)
    return cut.mean(axis=(2, 4))


def block_of(bands: int, shape: tuple[int, int]) -> int:
    """Pixels along the edge of the blocks whose means are compared: as many as make at most
    `MOST_VALUES` values of `bands` of an image of `shape`."""
    block = 1
    while bands * (shape[0] // block) * (shape[1] // block) > MOST_VALUES:
        block += 1
    return block


@dataclasses.dataclass(frozen=True, eq=False)
class Source:
    """Where the statistics of one sensor are from, and how that sensor sees a scene."""

    kind: Kind
    view_of: "Callable[[Scene, PlotParameters], AbstractView]"
    """The sensor's view of a scene."""
    description: str = ""
    """Sentences on what was read and how it is weighed."""
    file: Path | None = None
    extra: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    """Further numbers for a summary, by name."""
    spectrum: tuple[np.ndarray, np.ndarray] | None = None
    """Wavelengths [nm] and reflectance of the whole measured spectrum."""
    bands: BandSet | None = None
    """Bands in which a spectrum is compared; None of another measurement."""
    image: Any = None
    """What is shown of a drone's image; None of a table of its statistics, and of other sensors."""
    pixels: Pixels | None = None
    """The image whose pixels count one by one."""
    name: str = ""
    """Name of the view, which stands before its statistics: "flight1.nir.mean"; "" of the only
    view of its kind."""

    @drawn_in_double
    def view(self, scene: Scene, parameters: PlotParameters) -> "AbstractView":
        """The sensor's view of a `scene` with `parameters`, under its name."""
        view = self.view_of(scene, parameters)
        return view.named(self.name) if self.name else view


def _array(values: Any) -> Any:
    """Numbers as an array; what is one already as it is, of whatever precision."""
    return values if isinstance(values, jax.Array | np.ndarray) else in_double(values)


def _names(names: str | Sequence[str]) -> tuple[str, ...]:
    return (names,) if isinstance(names, str) else tuple(names)


class Data(eqx.Module):
    """What was measured: statistics, each with a name, a value and an error.

    `from_image`, `from_table`, `from_spectrum` and `from_cloud` read what one sensor measured of a
    plot; their sum is all of them together, whose errors are independent. Two views of one kind
    have names, which stand before their statistics: "flight1.nir.mean". Statistics of one's own,
    for a fit of any function, are `Data(names, value, sd)`.

    >>> import fynjax as fx
    >>> nadir = fx.Data.from_table({"nir.mean": 0.3, "red.mean": 0.05}, name="nadir")
    >>> both = nadir + fx.Data.from_table({"nir.mean": 0.28}, name="dusk")
    >>> both.names
    ('nadir.nir.mean', 'nadir.red.mean', 'dusk.nir.mean')

    **Raises:** `InputError` for another number of values or errors than of names, a whitener of
    another shape, a value that is not finite, and an error that is not positive.
    """

    names: tuple[str, ...] = eqx.field(static=True, converter=_names)
    """Name of each statistic, such as NDVI.mean."""
    value: Float[Array, " statistic"] = eqx.field(converter=_array)
    """Measured value of each statistic, in its own unit."""
    sd: Float[Array, " statistic"] = eqx.field(converter=_array)
    """Standard deviation, model error included, of each statistic."""
    whitener: Float[Array, "statistic statistic"] | None = None
    """Makes correlated errors independent, of unit size; None: they are independent."""
    source: Source | None = eqx.field(static=True, default=None)
    """Where the statistics of one sensor are from; None of one's own, and of several sensors."""
    together: tuple["Data", ...] = ()
    """Data of each sensor, of several."""

    @property
    def parts(self) -> tuple["Data", ...]:
        """Data of each sensor, in the order of the statistics; none of statistics of one's own."""
        return self.together or ((self,) if self.source is not None else ())

    @property
    def pixels(self) -> Pixels | None:
        """The image whose pixels count one by one; None of statistics."""
        return None if self.source is None else self.source.pixels

    def bare(self) -> "Data":
        """The numbers alone."""
        return Data(self.names, self.value, self.sd, self.whitener)

    def renamed(self, name: str) -> "Data":
        """The same of a view of this `name`; "" is none.

        **Raises:** `InputError` for a name that is not one word, and for data without a sensor.
        """
        if not name:
            return self
        if not name.isidentifier() or name in ("spectrum", "lidar"):
            raise InputError(
                f"expected a word as the name of a view, such as 'dusk', but got {name!r}"
            )
        if self.source is None:
            raise InputError("expected data of one sensor, of Data.from_image and the like")
        source = dataclasses.replace(self.source, name=name)
        names = tuple(f"{name}.{without_view(own)}" for own in self.names)
        return dataclasses.replace(self, names=names, source=source)

    def under(self, sun: tuple[float, float] | None) -> "Data":
        """The same of an image or a spectrum that was taken under a `sun` of this zenith and
        azimuth [degrees]; None: as it is."""
        if sun is None or self.source is None:
            return self
        zenith, azimuth = map(float, sun)
        if not (0.0 <= zenith < 90.0 and np.isfinite(azimuth)):
            raise InputError(f"expected the sun's zenith and azimuth in degrees, but got {sun}")
        sight: Any = self.source.view_of
        source = dataclasses.replace(
            self.source, view_of=dataclasses.replace(sight, sun=(zenith, azimuth))
        )
        return dataclasses.replace(self, source=source)

    @double_precision
    def __add__(self, other: "Data") -> "Data":
        """Both measurements of the same plot, whose errors are independent."""
        return join_data([self, other]) if isinstance(other, Data) else NotImplemented

    @classmethod
    @double_precision
    def from_image(
        cls,
        image: str | Path | Observation,
        camera: str | Path | Sensor | Lidar = "mavic_3m",
        *,
        pixel: float | None = None,
        footprint: float | None = None,
        altitude: float | None = None,
        bands: Sequence[str] | None = None,
        statistics: Sequence[str] = ("*",),
        relative_sd: float = 0.01,
        gains: Gains | str | None = None,
        pose: Pose | Frame | None = None,
        sun: tuple[float, float] | None = None,
        name: str = "",
    ) -> "Data":
        """Statistics of a drone's image of the plot.

        **Arguments:**

        - `image`: GeoTIFF of reflectance, or what `observe` gives of such a camera.
        - `camera`: that took it; a name, a sensor file or an object, with bands green, red, red
          edge and near infrared; others are used too where the image has them.
        - `pixel`: edge of a pixel [m], where the image states none.
        - `footprint`: side of the square that a pixel averages over [m], where resampling,
          mosaicking or blur make it another than its edge.
        - `altitude`: of the camera above the ground [m]; as its file has it by default.
        - `bands`: names of the image's bands in their order, where the file does not name them.
        - `statistics`: patterns of those that count, such as "*.mean".
        - `relative_sd`: error of a mean or quantile as a share of it [-].
        - `gains`: what the calibration of its bands to reflectance may be off by, or how they were
          calibrated, such as "panels" (`Sensor.gains`); the usual of the camera by default. Images
          of one camera share them, but for their drift (`Gains.drift`).
        - `pose`: where the camera hung and how it looked, of a single frame that was laid on the
          map of the plot, from its south-west corner; a `Frame` has its lens too. Pixels outside
          the frame do not count. Left out, the camera looks straight down from above the middle.
        - `sun`: zenith and azimuth when it was taken, clockwise from north [degrees]; that of the
          scene by default.
        - `name`: of the view, where there are several.

        **Raises:** `InputError` for an image or camera that cannot be used.
        """
        from fynjax.inversion._camera_data import image_of_camera  # late: it makes data

        found = image_of_camera(
            image, camera, pixel=pixel, footprint=footprint, altitude=altitude, bands=bands,
            statistics=statistics, relative_sd=relative_sd, gains=gains, pose=pose,
        )  # fmt: skip
        return found.under(sun).renamed(name)

    @classmethod
    @double_precision
    def from_table(
        cls,
        table: Any,
        camera: str | Path | Sensor | Lidar = "mavic_3m",
        *,
        pixel: float | None = None,
        altitude: float | None = None,
        relative_sd: float = 0.01,
        gains: Gains | str | None = None,
        sun: tuple[float, float] | None = None,
        name: str = "",
    ) -> "Data":
        """Statistics of a drone's image from a table.

        **Arguments:**

        - `table`: path of a CSV, a pandas frame, or a mapping of names to values; with columns
          statistic, value and, where they are known, sd. Names such as `NDVI.mean`.
        - `camera`, `pixel`, `altitude`, `relative_sd`, `gains`, `sun`, `name`: as of `from_image`.

        **Raises:** `InputError` for a table or camera that cannot be used.
        """
        from fynjax.inversion._camera_data import table_of_camera  # late: it makes data

        found = table_of_camera(
            table, camera, pixel=pixel, altitude=altitude, relative_sd=relative_sd, gains=gains
        )
        return found.under(sun).renamed(name)

    @classmethod
    @double_precision
    def from_spectrum(
        cls,
        path: str | Path,
        *,
        sun_zenith: float = 30.0,
        statistics: Sequence[str] = ("*",),
        relative_sd: float = 0.01,
        name: str = "",
    ) -> "Data":
        """The mean spectrum of a plot from above, such as of pixels of AVIRIS-NG.

        **Arguments:**

        - `path`: of spectra, or of an image of many bands.
        - `sun_zenith`: of the sun, for the noise [degrees].
        - `statistics`: patterns of the bands that count, such as "spectrum.5*".
        - `relative_sd`: error of a band for itself, as a share of it [-].
        - `name`: of the view, where there are several.

        **Raises:** `InputError` for spectra that cannot be used.
        """
        from fynjax.inversion._camera_data import TargetRules  # late: it makes data

        rules = TargetRules(relative_sd, tuple(statistics))
        found = app_room("assembly", "spectrum_data")(Path(path), rules, sun_zenith)
        return found.renamed(name)

    @classmethod
    @double_precision
    def from_cloud(
        cls,
        path: str | Path,
        scene: Scene,
        *,
        statistics: Sequence[str] = ("*",),
        relative_sd: float = 0.01,
        seed: int = 0,
        name: str = "",
    ) -> "Data":
        """Structure of a LiDAR's point cloud of the plot.

        **Arguments:**

        - `path`: LAS, LAZ, PLY or text; or a table of metrics.
        - `scene`: whose voxels the metrics must fit.
        - `statistics`: patterns of the metrics that count.
        - `relative_sd`: error of the model as a share of a metric [-].
        - `seed`: of the resampling of cells.
        - `name`: of the view, where there are several.

        **Raises:** `InputError` for a cloud that cannot be used.
        """
        from fynjax.inversion._camera_data import TargetRules  # late: it makes data

        voxel, side = scene.grid.horizontal_size, min(scene.grid.extent[:2])
        settings, grains = fitting_structure(voxel, side)
        rules = TargetRules(relative_sd, tuple(statistics))
        read = app_room("assembly", "structure_data")
        found = read(Path(path), rules, settings, grains, seed)
        return found.renamed(name)

    @classmethod
    @double_precision
    def from_pixels(
        cls,
        image: str | Path | Observation | Float[np.ndarray, "band row column"],
        camera: str | Path | Sensor | Lidar = "mavic_3m",
        *,
        pixel: float | None = None,
        altitude: float | None = None,
        bands: Sequence[str] | None = None,
        block: int | None = None,
        pixel_sd: float | None = None,
        gains: Gains | str | None = None,
    ) -> "Data":
        """A drone's image of a plot whose plants are known (`Scene.known_plants`): every pixel
        counts, since nothing of the plants is chance.

        **Arguments:**

        - `image`: GeoTIFF of reflectance of the whole plot and nothing else; what `observe` gives;
          or an array of the camera's bands in their order, rows from the south, NaN where a pixel
          does not count.
        - `camera`, `pixel`, `altitude`, `bands`, `gains`: as of `from_image`.
        - `block`: pixels along the edge of the blocks whose means are compared; as many as make
          some 40 000 values by default.
        - `pixel_sd`: error of a block's mean, of camera and model, as a share of it [-]; by default
          of the shapes of plants too, as `Pixels.sd` has it.

        **Raises:** `InputError` for an image or camera that cannot be used.
        """
        from fynjax.inversion._camera_data import pixels_of_camera  # late: it makes data

        return pixels_of_camera(
            image, camera, pixel=pixel, altitude=altitude, bands=bands, block=block,
            pixel_sd=pixel_sd, gains=gains,
        )  # fmt: skip

    @double_precision
    def with_scatter(self, deviations: Float[Array, "draw statistic"]) -> "Data":
        """The data with an error of the model added that moves all statistics together.

        **Arguments:** `deviations`, how far the statistics lie from the model's in draws of what
        it leaves to chance. Their second moments, shrunk half-way to the diagonal because
        draws are few, add to the variances.
        """
        moments = deviations.T @ deviations / deviations.shape[0]
        return self.with_covariance(0.5 * (moments + jnp.diag(jnp.diagonal(moments))))

    @double_precision
    def with_covariance(
        self, covariance: Float[Array | np.ndarray, "statistic statistic"]
    ) -> "Data":
        """The data with an error added that moves the statistics together, of this covariance."""
        total = self.covariance + jnp.asarray(covariance)
        # Of errors with this covariance the inverse Cholesky factor makes independent unit ones.
        whitener = jnp.linalg.inv(jnp.linalg.cholesky(total))
        return Data(self.names, self.value, jnp.sqrt(jnp.diagonal(total)), whitener)

    @double_precision
    def widened(self, excess: float) -> "Data":
        """The same data, the variances of whose errors are `excess` times as large."""
        if excess == 1.0:
            return self
        root = excess**0.5
        whitener = None if self.whitener is None else self.whitener / root
        return Data(self.names, self.value, self.sd * root, whitener)

    @double_precision
    def along(self, weights: Float[np.ndarray, "direction statistic"]) -> "Data":
        """The same data, of which only directions count: `weights` makes of misfits independent
        ones of unit size, as many as there are statistics, or fewer."""
        whitener = np.zeros((len(self.names),) * 2)
        whitener[: len(weights)] = weights
        return Data(self.names, self.value, self.sd, jnp.asarray(whitener))

    @property
    @double_precision
    def covariance(self) -> Float[Array, "statistic statistic"]:
        """Covariance of the errors; not of data of which only directions count."""
        if self.whitener is None:
            return jnp.diag(self.sd**2)
        return jnp.linalg.inv(self.whitener.T @ self.whitener)

    def whiten(self, misfit: Float[Array, " statistic *free"]) -> Float[Array, " statistic *free"]:
        """Misfits in units of the errors, independent of each other."""
        if self.whitener is not None:
            return self.whitener @ misfit
        return misfit / (self.sd[:, None] if misfit.ndim == 2 else self.sd)

    def __check_init__(self) -> None:
        for what, given in (("value", self.value), ("sd", self.sd)):
            if jnp.shape(given)[-1:] != (len(self.names),):
                raise InputError(
                    f"expected a `{what}` for each of the {len(self.names)} statistics "
                    f"({listed(self.names)}), but got an array of shape {jnp.shape(given)}"
                )
        if self.whitener is not None and jnp.shape(self.whitener)[-2:] != (len(self.names),) * 2:
            raise InputError(
                f"expected a `whitener` of {len(self.names)} x {len(self.names)} for as many "
                f"statistics, but got an array of shape {jnp.shape(self.whitener)}"
            )
        if not concrete(self.value, self.sd):
            return
        bad = ~(np.isfinite(np.asarray(self.value)) & (np.asarray(self.sd) > 0))
        if bad.any():
            name = self.names[int(np.argmax(bad)) % len(self.names)]
            raise InputError(f"the target {name} must be finite and have a positive sd")


@double_precision
def join_data(parts: Sequence[Data]) -> Data:
    """Data of several sensors, `parts`, as one; errors of different sensors are independent.

    **Raises:** `InputError` for a statistic that is in two of them: their views need names.
    """
    if len(parts) == 1:
        return parts[0]
    names = tuple(name for part in parts for name in part.names)
    if len(set(names)) < len(names):
        twice = next(name for name in names if names.count(name) > 1)
        raise InputError(
            f"expected each statistic once, but {twice!r} is in both data: give two views of one "
            'kind names, such as Data.from_image(..., name="dusk")'
        )
    value, sd = (
        jnp.concatenate([getattr(part, field) for part in parts]) for field in ("value", "sd")
    )
    each = tuple(one for part in parts for one in part.parts)
    if sum(len(one.names) for one in each) < len(names):  # some are of no sensor
        each = ()
    if all(part.whitener is None for part in parts):
        return Data(names, value, sd, together=each)
    blocks = [jnp.diag(1.0 / p.sd) if p.whitener is None else p.whitener for p in parts]
    return Data(names, value, sd, jax.scipy.linalg.block_diag(*blocks), together=each)


@double_precision
def pixel_data(
    pixels: Pixels, names: Sequence[str], view_of: "Callable[..., AbstractView]", **fields: Any
) -> Data:
    """Data of an image whose pixels count one by one.

    **Arguments:** `pixels`; `names` of its bands; `view_of`, the camera's view of a scene; further
    `fields` of the `Source`. Errors are those by the measured values; a fit takes them of what it
    simulates.
    """
    places, means = np.argwhere(pixels.compared), pixels.means
    value = means[:, pixels.compared].ravel()
    every = tuple(f"{band} {y},{x}" for band in names for y, x in places)
    sd = pixels.own_sd * np.maximum(value, DARKEST)
    source = Source("pixels", view_of, pixels=pixels, **fields)
    return Data(every, jnp.asarray(value), jnp.asarray(sd), source=source)

"""What a calibration is to reach, from files of any sensor: statistics, their errors, a view."""

import dataclasses
import math
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from fynjax._core.errors import InputError, in_file
from fynjax._core.precision import double_precision
from fynjax.app.compare import DroneImage, pixel_footprint, read_drone_image, read_spectra_sample
from fynjax.app.compare.structure import ComparisonSettings, cloud_structure
from fynjax.app.io.frames import is_frame_stack
from fynjax.app.io.plot import (
    Plot,
    TargetTable,
    drone_sensor,
    named_sensor,
    placed_by,
    read_statistics,
    read_structure,
    sensor_place,
)
from fynjax.app.io.raster import open_raster
from fynjax.app.io.text import existing_file, open_table
from fynjax.app.terrain import CLOUD_SUFFIXES
from fynjax.inversion import (
    GAIN,
    OFFSET,
    Data,
    ImageSight,
    Kind,
    Pixels,
    Source,
    SpectrumSight,
    StructureSight,
    TargetRules,
    block_of,
    join_data,
    pixel_data,
    spectrum_names,
    structure_view,
    weigh_spectrum,
    weigh_structure,
    weigh_targets,
    weighed_statistics,
)
from fynjax.metrics import index_bands, match_wavelengths, spectral_mask
from fynjax.metrics.structure import STRUCTURE_METRICS, StructureSettings
from fynjax.scene import Placement, PlantingRules, fitting_structure, visible_sensor
from fynjax.sensors import (
    BandSet,
    ClearAir,
    Gains,
    RadiometricNoise,
    at_sensor_radiance,
    band_atmosphere,
    clear_sky_atmosphere,
    shipped_sensor,
)

KINDS: dict[Kind, str] = {
    "image": "a drone image, or a table of its statistics",
    "spectrum": "a spectrum, or an image of many bands",
    "structure": "a point cloud, or a table of its structure",
}
_SPECTRA = (
    *(".asd", ".sli", ".slb", ".hdr", ".img", ".bil", ".bip", ".bsq", ".dat"),
    *(".nc", ".nc4", ".h5", ".hdf5", ".txt"),
)
_DRONE_BANDS = 10
"""A GeoTIFF of more bands than this is a spectrometer's."""
_PIXEL_TOLERANCE = 0.01
"""By how much an image's pixel may differ from the sensor's and count as the same, relative [-]."""
_MOST_SHOWN = 640_000
"""Most pixels of an image that are kept to be shown; a larger one is shown by blocks of pixels."""
_MOST_SAMPLED = 100_000
"""Most pixels of an image that its distributions are drawn of."""
_MOST_BANDS = 30
_NARROWEST, _WIDEST = 5.0, 15.0  # nm; finer spectra are averaged to bands of the first
_RANGE = (405.0, 2450.0)


@dataclass(frozen=True)
class RealImage:
    """The real image of a plot, reduced to what the page of a calibration shows of it."""

    values: Float[np.ndarray, "band y x"]
    """Reflectance [-], y to the north, of the middle of the image, which is no larger than the
    plot; means of `block` x `block` pixels; NaN where none of them counts."""
    bands: tuple[str, ...]
    pixel: float
    """Edge of a pixel of `values` on the ground [m]."""
    size: tuple[float, float]
    """Width and height of the whole image on the ground [m]."""
    block: int
    """Pixels of the image along an edge of one of `values`."""
    pixels: Float[np.ndarray, "band sample"]
    """Reflectance of pixels of the whole image that count, every so many where these are many."""

    @classmethod
    def of(
        cls, image: DroneImage, pixel: float, plot: tuple[float, float] | None = None
    ) -> "RealImage":
        """What to show of an image.

        **Arguments:** the `image`; `pixel`, edge of one of its pixels [m]; `plot`, width and height
        of the plot, to which the image is cut from its middle; by default it is not cut [m].
        """
        rows, columns = image.mask.shape
        wide, high = (np.inf, np.inf) if plot is None else plot
        high, wide = (
            int(np.clip(np.round(np.minimum(edge / pixel, count)), 1, count))
            for edge, count in ((high, rows), (wide, columns))
        )
        y, x = (rows - high) // 2, (columns - wide) // 2
        values = image.values[:, y : y + high, x : x + wide]
        block = min(math.ceil(math.sqrt(high * wide / _MOST_SHOWN)), high, wide)
        seen = np.flatnonzero(image.mask)
        seen = seen[:: -(-seen.size // _MOST_SAMPLED)]
        return cls(
            np.stack([_block_means(band, block) for band in values]),
            image.bands,
            pixel * block,
            (columns * pixel, rows * pixel),
            block,
            image.values.reshape(len(image.bands), -1)[:, seen],
        )


def _block_means(values: Float[np.ndarray, "y x"], block: int) -> Float[np.ndarray, "row column"]:
    """Means over the numbers in whole blocks of pixels; NaN in those that have none."""
    rows, columns = (count // block for count in values.shape)
    blocks = values[: rows * block, : columns * block].reshape(rows, block, columns, block)
    known = np.isfinite(blocks)
    count = known.sum(axis=(1, 3))
    total = np.where(known, blocks, 0.0).sum(axis=(1, 3))
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)


def target_kind(path: Path) -> Kind:
    """What kind of measurement a file holds, by its ending and its content."""
    suffix = path.suffix.lower()
    if suffix in CLOUD_SUFFIXES:
        return "structure"
    if is_frame_stack(path):
        return "image"
    if suffix in (".tif", ".tiff"):
        return "spectrum" if _band_count(path) > _DRONE_BANDS else "image"
    beside = path.with_name(path.name + ".hdr")
    if suffix in _SPECTRA or beside.is_file() or suffix == "":
        return "spectrum"
    header = _header(path)
    if "metric" in header:
        return "structure"
    numbers = sum(_is_number(cell) for cell in header)
    if any(cell.lower().startswith("wave") for cell in header) or numbers >= 3:
        return "spectrum"
    return "image"


def _band_count(path: Path) -> int:
    try:
        with open_raster(path, "an image") as file:
            return int(file.dataset.count)
    except InputError:  # whoever reads it next says what is wrong
        return 0


def _header(path: Path) -> Sequence[str]:
    """Cells of the first row of a table; none of a file that is none."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # whoever reads it says so
            return open_table(path, "a table").names
    except InputError:
        return ()


def _is_number(text: str) -> bool:
    try:
        return bool(np.isfinite(float(text)))
    except ValueError:
        return False


def placed_by_image(plot: Plot, paths: Sequence[Path]) -> Plot:
    """A plot, placed on Earth by the first image among the files that it is calibrated to, where
    nothing else says where it lies (`placed_by`).

    **Arguments:** `plot`, as `read_plot` gives it; `paths`, of the files.
    """
    files = [*map(Path, paths)] or [target.file for target in plot.targets]
    return placed_by(plot, [path for path in files if path.suffix.lower() in (".tif", ".tiff")])


@double_precision
def read_targets(
    plot: Plot,
    paths: Sequence[Path],
    *,
    bands: Sequence[str] | None = None,
    seed: int = 0,
    by_pixel: bool = False,
) -> Data | None:
    """Read what a plot is to be calibrated to: one measurement of each kind at most, or the views
    that the plot file states (`Plot.targets`) where no files are given.

    **Arguments:**

    - `plot`: as `read_plot` gives it.
    - `paths`: files of images, spectra, point clouds, or tables of their statistics.
    - `bands`: of a drone's image, as `read_drone_image` has them.
    - `seed`: of the resampling of a cloud's cells.
    - `by_pixel`: whether every pixel counts of an image of a plot whose crowns are known.

    **Returns:** what was measured: image, spectrum, structure, those that there are; None without
    files.

    **Raises:** `InputError` for two of a kind, for bands without an image, and as the readers.
    """
    found: dict[Kind, Data] = {}
    files = [*map(Path, paths)] or [target.file for target in plot.targets]
    if by_pixel and plot.known_crowns is not None and any(map(_is_image, files)):
        if not paths:
            plot = _of_known_plants(plot)
        return _pixels_of_plot(plot, files, bands)
    if not paths and plot.targets:
        return join_data([_view_of(plot, one, bands, seed) for one in plot.targets])
    for path in map(Path, paths):
        existing_file(path, "an image, a spectrum, a point cloud or a table of their statistics")
        kind = target_kind(path)
        if kind in found:
            raise InputError(
                f"expected one target of each kind, but this and {_file(found[kind])} are both "
                f"{KINDS[kind]}",
                file=path,
            )
        found[kind] = _read_target(plot, path, kind, bands, seed)
    if bands is not None and "image" not in found:
        raise InputError("expected `bands` with a drone image, but no target is one")
    each = [found[kind] for kind in KINDS if kind in found]
    return join_data(each) if each else None


def _read_target(
    plot: Plot, path: Path, kind: Kind, bands: Sequence[str] | None, seed: int
) -> Data:
    """The statistics of one target, which one sensor measured, with their errors; of a flight those
    of each frame."""
    if is_frame_stack(path):
        return _flight_of(plot, path)
    if kind == "image":
        return image_target(plot, path, bands)
    if kind == "spectrum":
        return spectrum_data(path, target_rules(plot), plot.sun.zenith)
    return structure_data(path, target_rules(plot), *structure_settings(plot), seed)


def _view_of(plot: Plot, target: TargetTable, bands: Sequence[str] | None, seed: int) -> Data:
    """One view of a plot, as its file states it: from where it was taken, and under which sun."""
    plot = plot.replace(sensor=named_sensor(target.of_sensor(plot.sensor)))
    if target.sun is not None:
        plot = plot.replace(sun=target.sun.position(plot.grid_north_deg))
    existing_file(target.file, "an image, a spectrum, a point cloud or a table of their statistics")
    if is_frame_stack(target.file):
        return _flight_of(plot, target.file, target)
    data = _read_target(plot, target.file, target_kind(target.file), bands, seed)
    source = data.source
    assert source is not None
    sight = source.view_of
    sun = None if target.sun is None else (plot.sun.zenith, plot.sun.azimuth)
    if sun is not None and isinstance(sight, ImageSight | SpectrumSight):
        sight = dataclasses.replace(sight, sun=sun)
    frame = target.frame
    if target.cameras is not None:
        from fynjax.app.assembly._flights import mosaic_of

        frame = mosaic_of(plot, target.cameras)
        blend = "the mean of those" if target.blend == "mean" else "of the nearest"
        words = f" Each pixel is {blend} of {len(frame.mosaic)} cameras that see it."
        source = dataclasses.replace(source, description=source.description + words)
    if frame is not None:
        text = source.description.replace(ONE_PICTURE, "")
        source = dataclasses.replace(source, description=text)
        if not isinstance(sight, ImageSight):
            raise InputError("expected a place of cameras of an image alone", file=target.file)
        known = _is_image(target.file) or target.pixel_m or target.footprint_m
        pixel = sight.placement.pixel if known else None  # else that from where the frame hung
        place, blended = Placement(pixel=pixel, frame=frame), target.blend == "mean"
        sight = dataclasses.replace(sight, placement=place, blended=blended)
    data = dataclasses.replace(data, source=dataclasses.replace(source, view_of=sight))
    return data.renamed(target.view) if target.view else data


def _flight_of(plot: Plot, path: Path, target: TargetTable | None = None) -> Data:
    """Data of the frames of a flight; a sun that is stated counts for all of them."""
    from fynjax.app.assembly._flights import flight_data  # which takes statistics from here

    if target is not None and (target.frame is not None or target.cameras is not None):
        raise InputError(
            "expected no position_m and no cameras of frames, which have one each",
            file=plot.file,
            column="target",
        )
    data = flight_data(plot, path, "" if target is None else target.view)
    if target is None or target.sun is None:
        return data
    return join_data([one.under((plot.sun.zenith, plot.sun.azimuth)) for one in data.parts])


def _of_known_plants(plot: Plot) -> Plot:
    """A plot with known crowns, with the sensor of the view that its file states: of one that looks
    straight down under the plot's sun, since other pixels are no map."""
    for target in plot.targets:
        placed = target.frame is not None or target.cameras is not None
        if placed or target.sun is not None:
            raise InputError(
                "expected an image from above, under the plot's sun, where every pixel counts: "
                "leave out position_m, cameras and sun, or crowns",
                file=plot.file,
            )
    return plot.replace(sensor=named_sensor(plot.targets[0].of_sensor(plot.sensor)))


def _is_image(path: Path) -> bool:
    return path.suffix.lower() in (".tif", ".tiff")


def _file(data: Data) -> Path | None:
    return data.parts[0].source.file if data.parts and data.parts[0].source else None


def _pixels_of_plot(plot: Plot, paths: Sequence[Path], bands: Sequence[str] | None) -> Data:
    """The image of a plot with known crowns, of which every pixel counts."""
    if len(paths) > 1:
        raise InputError(
            "expected the image alone: where plants are known it counts pixel by pixel, beside "
            "which other targets would say nothing",
            file=paths[1],
        )
    path, table = paths[0], plot.calibration
    existing_file(path, "an image")
    drone = drone_sensor(plot)
    image = read_drone_image(path, bands=bands, camera=drone.bands, most_pixels=None)
    pixel = sensor_place(plot)[1] if image.pixel_m is None else image.pixel_m
    sight = image_sight(plot, [f"{band}.mean" for band in image.bands], pixel=pixel)
    sensor = sight.sensor
    rows, columns = (round(side / pixel) for side in (plot.size_m[1], plot.size_m[0]))
    if (rows, columns) != image.mask.shape:
        raise InputError(
            f"expected an image of the whole plot and nothing else, {rows} rows and {columns} "
            f"columns of {pixel:g} m, but it has {image.mask.shape[0]} and "
            f"{image.mask.shape[1]}. Cut it: gdal_translate -projwin",
            file=path,
        )
    order = [image.bands.index(name) for name in sensor.bands.names]
    values = image.values[order]
    block = _block(plot, len(values), (rows, columns), pixel)
    pixels = Pixels(values, block, table.pixel_sd)
    counted = int(pixels.compared.sum()) * len(values)
    return pixel_data(
        pixels, sensor.bands.names, sight, file=path,
        description=f"{path.name}: {counted} means of blocks of pixels.",
        extra={"target_valid_share": float(pixels.compared.mean())},
    )  # fmt: skip


def _block(plot: Plot, bands: int, shape: tuple[int, int], pixel: float) -> int:
    """Pixels along the edge of a block."""
    stated = plot.calibration.block_m
    if stated is None:
        return block_of(bands, shape)
    block = round(stated / pixel)
    if not 1 <= block <= min(shape) or abs(stated - block * pixel) > 1e-3 * pixel:
        raise InputError(
            f"expected blocks of a whole number of pixels of {pixel:g} m, no larger than the plot, "
            f"but got {stated:g} m",
            file=plot.file,
            column="calibration.block_m",
        )
    return block


def target_rules(plot: Plot) -> TargetRules:
    """The rules that a plot file states."""
    settings = plot.calibration
    targets = tuple(settings.targets)
    return TargetRules(settings.target_sd, targets, plot.file)


def image_target(plot: Plot, path: Path, bands: Sequence[str] | None = None) -> Data:
    """The statistics of a drone's image (GeoTIFF), with its `bands`, or of a table (CSV)."""
    (altitude, pixel), sensor = sensor_place(plot), drone_sensor(plot)
    camera = sensor.bands
    blur = None
    resolved = PlantingRules(structure=plot.structure_m).resolved(plot.voxel_m)
    if plot.sensor.footprint_m is None:
        blur = 0.0
        if sensor.psf is not None and sensor.psf.kind == "gaussian":
            blur = float(np.mean(np.asarray(sensor.psf.width)) * sensor.pixel(altitude))
    data, extra, found, image = image_data(
        path,
        target_rules(plot),
        camera,
        pixel=pixel,
        plot=plot.size_m,
        bands=bands,
        blur=blur,
        resolved=resolved,
    )
    layers = {name.split(".")[0] for name in data.names}
    of = ", ".join(name for name in camera.names if name in layers)
    description = f"{path.name}: {len(data.names)} statistics of a drone's image"
    description += f" in {of} and indices." if of else " in indices."
    seen = plot.sensor.footprint_m or found
    if seen is not None and abs(seen / pixel - 1.0) > _PIXEL_TOLERANCE:
        # The spread between pixels depends on what each averages over.
        own = plot.sensor.model_copy(update={"pixel_m": seen})
        plot = plot.model_copy(update={"sensor": own})
        what = "Its pixels of" if seen == found else "Pixels that average over"
        description += (
            f" {what} {seen:.4g} m are simulated, not those of {pixel:.4g} m of the plot's sensor."
        )
    if image is not None:
        description += ONE_PICTURE
    sight = image_sight(plot, data.names)
    return dataclasses.replace(
        data, source=Source("image", sight, description, path, extra, image=image)
    )


ONE_PICTURE = (
    " It is taken for one picture from above the middle of the plot. From 50 m, with overlaps of "
    "80 and 70 %, a mosaic of the nearest cameras differs from that by up to 1 % in means and 8 % "
    "in spreads between pixels, one of means over cameras by up to 4.5 % and by 24 to 46 % on "
    "average, 48 % at most: `cameras` under [[target]] says where these were."
)
"""What is said of an image without positions of cameras; of a fynbos plot of 4 m, by `python -m
tests.benchmarks.flight --only mosaic --size 4`."""


class ImageData(NamedTuple):
    """A drone's image, or a table of its statistics, as targets."""

    data: Data
    extra: dict[str, Any]
    """What the summary says of the targets."""
    pixel: float | None
    """Edge of a pixel [m]."""
    image: RealImage | None
    """The image, to be shown; None of a table."""


def image_data(
    path: Path,
    rules: TargetRules,
    camera: BandSet,
    *,
    pixel: float | None = None,
    plot: tuple[float, float] | None = None,
    bands: Sequence[str] | None = None,
    blur: float | None = None,
    resolved: float = 0.0,
) -> ImageData:
    """Statistics of a drone's image, or of a table of them, as targets.

    **Arguments:**

    - `path`: GeoTIFF, or CSV with statistic, value and sd.
    - `rules`: which statistics count.
    - `camera`: bands of the camera. Those that the image has are used.
    - `pixel`: edge of a pixel on the ground where the image does not state it [m].
    - `plot`: its width and height [m]: means over squares wider than it are left out.
    - `bands`: of the image, as `read_drone_image` has them.
    - `blur`: full width at half maximum of the camera's own blur on the ground [m]. Where it is
      given, an image that is much more blurred gets a warning.
    - `resolved`: edge of the smallest voxels of the plot, than which no simulated image is sharper
      [m].

    **Raises:** `InputError` as the readers, for `bands` of a table, and where no pixel is known.
    """
    extra: dict[str, Any] = {}
    shown = None
    if path.suffix.lower() in (".tif", ".tiff"):
        image = read_drone_image(path, bands=bands, camera=camera, most_pixels=None)
        pixel = pixel if image.pixel_m is None else image.pixel_m
        if pixel is None:
            raise InputError("expected `pixel`: the image states none in metres", file=path)
        extra = {"target_valid_share": float(image.mask.mean())}
        if blur is not None:
            _doubt_focus(path, image, pixel, blur, resolved)
        seen = camera.select([camera.names.index(name) for name in image.bands])
        side = np.inf if plot is None else min(plot)
        shown = RealImage.of(image, pixel, plot)
        data = weighed_statistics(image.values, seen, image.mask, pixel, rules, side=side)
    else:
        if bands is not None:
            raise InputError("expected `bands` with a drone image, but this is a table", file=path)
        read = read_statistics(path, {*camera.names, *index_bands(camera)})
        keep = rules.used([row.statistic for row in read], "the target's rows")
        names = [read[i].statistic for i in keep]
        value = np.array([read[i].value for i in keep])
        sd = np.array([read[i].sd for i in keep], float)  # NaN where the table states none
        data = weigh_targets(names, value, rules.relative_sd, sd=sd)
    return ImageData(data, extra, pixel, shown)


_BLURRED = 2.5
"""Width of the square that a pixel averages over from which an image is called blurred [pixels]."""


def _doubt_focus(path: Path, image: DroneImage, pixel: float, blur: float, resolved: float) -> None:
    """Warn of an image whose power spectrum says that its pixels average over more than they are
    wide, beyond the camera's `blur` [m], and than the `resolved` voxels are [m]."""
    wide = pixel_footprint(image.values, image.mask, blur=blur / pixel)
    if wide is not None and wide * pixel > _BLURRED * max(pixel, resolved):
        warnings.warn(
            f"{path}: its pixels of {pixel:.3g} m look blurred, as if each averaged over a square "
            f"of some {wide * pixel:.2g} m. Resampled to finer pixels, blended or out of focus? "
            f"`footprint_m = {wide * pixel:.2g}` under [sensor] of the plot file simulates it so; "
            f"`footprint_m = {pixel:.3g}` says that it is sharp",
            stacklevel=4,
        )


def image_sight(plot: Plot, statistics: Sequence[str], *, pixel: float | None = None) -> ImageSight:
    """How a plot's drone sees a scene of it, from where its file has it, for reflectance under the
    plot's own sky.

    **Arguments:**

    - `plot`: as `read_plot` gives it.
    - `statistics`: names such as `nir.mean` or `NDVI.std`.
    - `pixel`: on the ground [m], instead of the plot file's.

    **Raises:** `InputError` for a sensor that makes no drone's image.
    """
    sensor = drone_sensor(plot, {name.split(".")[0] for name in statistics})
    altitude, usual = sensor_place(plot)
    place = plot.sensor.placement if plot.sensor.name == sensor.name else Placement()
    place = dataclasses.replace(place, altitude=altitude, pixel=usual if pixel is None else pixel)
    gains, spread = sensor.gains(), plot.sensor.point_spread
    return ImageSight(tuple(statistics), visible_sensor(sensor), place, gains, spread, plot.file)


# -- spectra ----------------------------------------------------------------------------------


def spectrum_data(path: Path, rules: TargetRules, sun_zenith: float) -> Data:
    """The mean of a file's spectra or pixels, in some thirty bands outside the water windows.

    **Arguments:**

    - `path`: of spectra or of an image of many bands.
    - `rules`: which bands count.
    - `sun_zenith`: of the sun, for the sensor's noise in reflectance [degrees].

    **Raises:** `InputError` as the readers, and for spectra without usable bands.
    """
    sample = read_spectra_sample([path])
    grid = sample.wavelength
    count, mean = len(sample.values), sample.values.mean(axis=0)
    with in_file(path):
        bands, weights = _bands_to_compare(grid, sample.fwhm)
    keep = rules.used(spectrum_names(bands), "the bands of the spectrum")
    if len(keep) < len(bands):
        bands, weights = bands.select(keep), weights[keep]
    names = spectrum_names(bands)
    value = weights @ mean
    sampling = None
    if count > 1:
        # Covariance of the mean of so many pixels.
        sampling = np.atleast_2d(np.cov(sample.values @ weights.T, rowvar=False)) / count
    noise = reflectance_noise(bands, value, sun_zenith, averaged=count)
    share = rules.relative_sd
    with in_file(path):
        data = weigh_spectrum(names, value, share, noise=noise, sampling=sampling)
    description = (
        f"{path.name}: {sample.description()} Their mean is compared in {len(bands)} bands, "
        f"{bands.centre[0]:.0f} to {bands.centre[-1]:.0f} nm outside the water windows, at the "
        "full width of the bands. Errors: "
        f"{100 * share:.2g} % and the noise of AVIRIS-NG in each band for itself; a factor of "
        f"1 ± {GAIN:g} and a reflectance of ± {OFFSET:g} that are the same in all bands"
        + (f"; and the covariance of {count} pixels over their number." if count > 1 else ".")
    )
    extra = {"spectra": count, "spectrum_bands": len(bands)}

    sight = SpectrumSight(bands, Gains(GAIN, 1.0))
    source = Source("spectrum", sight, description, path, extra, (grid, mean), bands)
    return dataclasses.replace(data, source=source)


def _bands_to_compare(
    grid: Float[np.ndarray, " wavelength"], fwhm: Float[np.ndarray, " wavelength"] | None
) -> tuple[BandSet, Float[np.ndarray, "band wavelength"]]:
    """Some thirty bands outside the water windows, and the weights that make them of a spectrum."""
    clear = np.flatnonzero(spectral_mask(grid, _RANGE))
    # A table states no widths: neighbours are as far apart, unless it lists some bands only.
    width = np.clip(np.gradient(grid), _NARROWEST, _WIDEST) if fwhm is None else fwhm
    width = np.maximum(width, _NARROWEST)
    every = -(-clear.size // _MOST_BANDS)
    # Every so many bands, from the middle of the first group on.
    place = clear[every // 2 :: every]
    match = match_wavelengths(grid[clear], grid[place], simulated_fwhm=width[place])
    centre = match.wavelength
    weights = np.zeros((centre.size, grid.size))
    weights[:, clear] = match.real
    bands = BandSet(
        tuple(f"{c:.10g}nm" for c in centre), tuple(centre), tuple(np.interp(centre, grid, width))
    )
    bands = bands.select(bands.covered(np.arange(400.0, 2501.0)))
    return bands, weights[np.isin(centre, bands.centre)]


def reflectance_noise(
    bands: BandSet, reflectance: np.ndarray, sun_zenith: float, *, averaged: int = 1
) -> np.ndarray:
    """Noise of AVIRIS-NG in reflectance [-], of the mean of `averaged` pixels, in a clear sky.

    Each of `bands` has the noise of the instrument's nearest one, as files of spectra have none.
    The surroundings have the same reflectance and no noise of their own: they are the mean of many
    pixels.
    """
    with warnings.catch_warnings():  # on its pixel, which does not matter here
        warnings.simplefilter("ignore", UserWarning)
        sensor = shipped_sensor("aviris_ng")
    assert isinstance(sensor.noise, RadiometricNoise)
    apart = np.abs(np.subtract.outer(bands.centre, sensor.bands.centre))
    nearest = apart.argmin(axis=1)
    a, b, c = (np.asarray(getattr(sensor.noise, name))[nearest] for name in "abc")
    noise = RadiometricNoise(a, b, c, integrations=sensor.noise.integrations)
    air = band_atmosphere(clear_sky_atmosphere(ClearAir(jnp.asarray(min(sun_zenith, 85.0)))), bands)
    at = jnp.asarray(reflectance)
    # Radiance by reflectance, band by band: the noise of radiance over it is that of reflectance.
    slope = jax.grad(lambda r: jnp.sum(at_sensor_radiance(air, r, at)))(at)
    deviation = noise.standard_deviation(at_sensor_radiance(air, at), averaged=averaged)
    return np.asarray(deviation / slope)


# -- clouds -----------------------------------------------------------------------------------


def structure_data(
    path: Path,
    rules: TargetRules,
    settings: StructureSettings,
    grains: tuple[float, ...],
    seed: int,
) -> Data:
    """Structure metrics of a point cloud, or of a table of them, as targets.

    **Arguments:**

    - `path`: LAS, LAZ, PLY or text, or CSV with metric, value and sd.
    - `rules`: which metrics count.
    - `settings`, `grains`: of structure that fits the scene's voxels (`structure_settings`).
    - `seed`: of the resampling of cells.

    **Raises:** `InputError` as the readers, and for a table of another grain.
    """
    extra: dict[str, Any]
    values: dict[str, tuple[float, float]]
    if path.suffix.lower() == ".csv":
        read = read_structure(path)
        grain, pulses, how = read[0].grain_m, read[0].returns_m2, "a table"
        if grain not in grains:
            raise InputError(
                f"expected a grain of {', '.join(f'{g:g}' for g in grains)} m, whole cells of the "
                f"canopy's surface of {settings.canopy_cell:g} m, but got {grain:g} m",
                file=path,
                column="grain_m",
            )
        values = {row.metric: (row.value, row.sd or 0.0) for row in read}
        extra = {}
    else:
        how = "resampling of the cells"
        compared = ComparisonSettings(structure=settings, grains=grains)
        found = cloud_structure(path, compared, seed=seed)
        metrics = found.side.metrics.dropna(subset="value")
        # The interval holds 95 % of a normal.
        width = (metrics["bootstrap_high"] - metrics["bootstrap_low"]).fillna(0.0)
        values = dict(zip(metrics.index, zip(metrics["value"], width / (2.0 * 1.959964))))
        grain, pulses = found.grain, found.side.density
        extra = {"returns": found.side.returns, "ground": found.side.ground}
    known = [name for name in STRUCTURE_METRICS if name in values]
    keep = rules.used(structure_view(known).names, "the metrics of the cloud")
    names = [known[i] for i in keep]
    view = structure_view(names, settings, grain=grain, pulses=pulses)
    value, sd = (np.array([values[name][k] for name in names]) for k in (0, 1))
    data = weigh_structure(view.names, value, rules.relative_sd, sd=np.nan_to_num(sd))
    description = (
        f"{path.name}: {len(names)} structure metrics in cells of {grain:g} m, {pulses:.3g} "
        f"returns a square metre. Errors: of sampling by {how}, and what the smooth metrics of "
        "the voxels are off by."
    )
    extra["grain_m"] = grain
    return dataclasses.replace(
        data, source=Source("structure", StructureSight(view), description, path, extra)
    )


def structure_settings(plot: Plot) -> tuple[StructureSettings, tuple[float, ...]]:
    """Settings and grains [m] of structure that fit a plot's voxels."""
    with in_file(plot.file):
        return fitting_structure(plot.voxel_m, min(plot.size_m))

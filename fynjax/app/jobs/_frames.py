"""The job of `fynjax frames`: which frames of a flight see a plot, from where, and what they show
of it."""

from collections import Counter
from collections.abc import Sequence
from datetime import datetime
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
import pandas as pd
import xarray as xr
from jaxtyping import Bool, Float
from pydantic import Field
from rasterio.warp import transform
from scipy.ndimage import map_coordinates

from fynjax._core.arguments import Names
from fynjax._core.dry_run import begin_work
from fynjax._core.errors import InputError, listed
from fynjax._core.precision import double_precision
from fynjax._core.progress import track
from fynjax.app.assembly import ground_heights
from fynjax.app.compare import read_drone_image
from fynjax.app.io.frames import (
    FrameStack,
    choose_frames,
    direction_features,
    grid_north,
    lay_picture,
    picture_place,
    picture_time,
    pictures_of,
    points_wanted,
    read_frames,
)
from fynjax.app.io.instruments import load_instrument
from fynjax.app.io.plot import Place, Plot, as_plot, drone_sensor, plot_place
from fynjax.app.io.raster import (
    RELATIVE_TAG,
    grid_mapping,
    image_array,
    open_raster,
    write_geotiff,
    write_run,
)
from fynjax.app.jobs._result import JobResult, Record
from fynjax.app.jobs._run import Run
from fynjax.app.report import figures
from fynjax.app.report.pages import Picture, Table
from fynjax.sensors import BandSet, Frame, FrameCamera, Sensor, lens_of, sun_position

_MOST = 100_000_000
"""Pixels of all frames, at most."""
_TOGETHER = 1_000_000
"""Points of the ground that are looked up in a picture at once."""
_SAME_SUN = 2.0
"""Degrees within which suns of frames count as one, their mean: light is simulated once for each
sun. Reflectance of shrubland changes by some tenths of a percent within it."""


class FramesSummary(Record):
    """A flight over a plot in numbers."""

    frames: int
    """Frames whose poses were read."""
    seeing: int
    """Of these, frames that show some of the plot."""
    fewest_frames: int
    median_frames: float
    most_frames: int
    """Frames that see a pixel of the plot: fewest, median and most."""
    smallest_zenith_deg: float
    largest_zenith_deg: float
    """Zenith angles from which pixels are seen."""
    used: list[str] | None = None
    """Frames whose pictures were laid on the ground."""
    left_out: list[str] | None = None
    """Frames with pictures that the cap left out."""
    skipped: list[str] | None = None
    """Frames whose pictures cannot be used; the warnings say why."""
    suns: int | None = None
    """Suns of the frames that are used, by their times; 0: their pictures state none."""


class FramesResult(JobResult):
    """What `frames` found."""

    command: Literal["frames"] = "frames"
    flight: FramesSummary


@double_precision
def frames(
    path: str | Path,
    output: str | Path,
    *,
    plot: Plot | str | Path,
    crs: str | None = None,
    origin: tuple[float, float] | None = None,
    ground: float | None = None,
    pixel: Annotated[float, Field(ge=0.005)] = 0.1,
    images: str | Path | None = None,
    bands: Names | None = None,
    most: Annotated[int, Field(ge=1)] | None = None,
) -> FramesResult:
    """Find which frames of a flight see a plot, from which angles, and what they show of it.

    Pictures of reflectance are laid on the ground of the plot, which makes of each a view that
    `calibrate` and `posterior` take. One that cannot be used is skipped, with a warning.

    **Arguments:**

    - `path`: poses of the frames: OpenDroneMap's shots.geojson, Pix4D's
      *_calibrated_external_camera_parameters.txt, Metashape's cameras.xml, or a folder of one of
      these or of pictures of a DJI or MicaSense camera.
    - `output`: folder of the results, made if missing.
    - `plot`: plot file of the plot that was flown over, or a plot that was read. A frame without a
      lens of its own has that of the plot's sensor.
    - `crs`: reference system of the plot, such as EPSG:32734, if its file names no map.
    - `origin`: south-west corner of the plot in that system, east and north [m].
    - `ground`: mean height of the plot's ground in the system of the frames' heights [m]; if left
      out, that of its terrain, or of pictures of a DJI their point of take-off.
    - `pixel`: side of a pixel on the ground [m].
    - `images`: folder of pictures of reflectance (GeoTIFF), each on the pixels of its camera and
      named after its frame, to be laid on the ground.
    - `bands`: what each band of a picture is, names with commas between, where the file does not
      say.
    - `most`: pictures to use at most: those that together say most of how the plot looks from
      different sides.

    **Returns:** `FramesResult`. Writes `frames.csv` (poses, and how much of the plot each frame
    sees from where), `frames.nc` (of each frame that sees some of the plot, or whose picture is
    used, the pixels that lie in it, their view zenith and azimuth, their column and row in the
    picture, and reflectance), a GeoTIFF of each picture on the ground, a figure and a page into
    `output`.

    **Raises:** `InputError` as `read_plot`, `read_frames` and `read_drone_image`, for a pixel that
    the plot has no room for, too many pixels, where no frame shows any of the plot, for pictures
    of which none is of a frame and can be used, and for a cap or bands without pictures.

    Example: `jobs.frames("odm_report/shots.geojson", "results", plot="plot.toml", ground=312.4)`.
    """
    read = as_plot(plot)
    run = Run(output)
    known = plot_place(read)
    place = Place(known.origin_m if origin is None else origin, known.crs if crs is None else crs)
    if images is None and not (most is None and bands is None):
        raise InputError("expected `images` beside `most` or `bands`, which are of pictures")
    ground_of = _Ground.of(read, pixel)
    if ground_of.heights is not None and ground is None:
        ground = float(ground_of.heights.mean())
    with run.stage("Read the poses"):
        found = read_frames(path, crs=place.crs, origin=place.origin_m, ground=ground)
    rows, columns = ground_of.shape
    if len(found) * rows * columns > _MOST:
        raise InputError(
            f"expected {_MOST:.0e} pixels of all frames at most, but {len(found)} frames of "
            f"{columns} x {rows} pixels have more: take a larger `pixel`"
        )
    found = [_with_lens(frame, read) for frame in found]
    begin_work(
        {"frames.csv": f"{len(found)} frames", "frames.nc": f"{columns} x {rows} pixels"}
        | {"report.html": ""}
    )
    with run.stage("Find the plot"):
        seen = np.stack([frame.sees_cells(ground_of.corners) for frame in found])
        view = [frame.view(ground_of.points(1)) for frame in found]
    if not seen.any():
        raise InputError(
            f"expected frames that show some of the plot of {read.size_m[0]:g} x "
            f"{read.size_m[1]:g} m, but none of {len(found)} does: {_where(found[0])}. "
            "Are corner and height of the plot in the frames' system?"
        )
    flight = _Flight(found, seen, np.where(seen[..., None], view, np.nan))
    summary, table = _summary(flight), _table(flight)
    record = run.record([read.file, _file(Path(path))])
    laid = None
    if images is not None:
        laid = _lay(run, flight, table, Path(images), bands, most, (read, place, ground_of))
        table, summary = laid.table, summary.model_copy(update=laid.summary)
    with run.stage("Write"):
        run.table("frames.csv", table, "poses, and what each frame sees of the plot")
        dataset = _dataset(flight, laid, ground_of, place)
        where = run.path("frames.nc", "of each frame pixels of the plot, their views and places")
        write_run(where, dataset, record)
    headline = _headline(summary, read)
    picture = Picture(
        "frames.png",
        figures.frames_figure(table, seen.sum(axis=0), pixel),
        "from where the frames see the plot, and how many see each pixel",
    )
    shown = Table(table, "Frames, in metres from the plot's corner.", folded=True)
    inputs = [read.file, *([] if laid is None else laid.files)]
    run.pictures("frames", f"Frames over {read.name}", headline, [picture, shown], inputs)
    warnings = [] if laid is None else laid.warnings
    return run.result(FramesResult, headline=headline, warnings=warnings, flight=summary)


class _Ground(NamedTuple):
    """The ground of a plot and the grid that frames are laid on: that of a simulated image."""

    pixel: float
    shape: tuple[int, int]
    start: tuple[float, float]
    """North and east of the grid's first corner from that of the plot [m]."""
    heights: Float[np.ndarray, "row column"] | None
    """Heights of the middles of the voxel columns [m]; None: level."""
    voxel: float

    @classmethod
    def of(cls, plot: Plot, pixel: float) -> "_Ground":
        if not (pixel > 0.0 and pixel <= min(plot.size_m) * (1.0 + 1e-6)):
            raise InputError(
                f"expected a positive `pixel` that the plot of {plot.size_m[0]:g} x "
                f"{plot.size_m[1]:g} m has room for, but got {pixel:g} m"
            )
        # Whole pixels in the middle of each side, as those of a simulated image.
        wide, high = plot.size_m
        rows, columns = (int(side / pixel + 1e-6) for side in (high, wide))
        start = 0.5 * (high - rows * pixel), 0.5 * (wide - columns * pixel)
        return cls(pixel, (rows, columns), start, ground_heights(plot), plot.voxel_m)

    @property
    def corners(self) -> Float[np.ndarray, "row column 3"]:
        """Corners of the pixels, one row and one column more than there are of them."""
        return self._at(*(np.arange(n + 1.0) for n in self.shape))

    def points(self, along: int, rows: slice = slice(None)) -> Float[np.ndarray, "y x 3"]:
        """Points `along` each edge of the pixels of some rows."""
        high, wide = (np.arange(n)[s] for n, s in zip(self.shape, (rows, slice(None)), strict=True))
        inside = (np.arange(along) + 0.5) / along
        return self._at(*((axis[:, None] + inside).ravel() for axis in (high, wide)))

    def _at(
        self, row: Float[np.ndarray, " y"], column: Float[np.ndarray, " x"]
    ) -> Float[np.ndarray, "y x 3"]:
        """East, north and height above the mean of the ground, at places in pixels."""
        north, east = (s + self.pixel * at for s, at in zip(self.start, (row, column), strict=True))
        y, x = np.meshgrid(north, east, indexing="ij")
        z = np.zeros(y.shape)
        if self.heights is not None:
            at = [axis / self.voxel - 0.5 for axis in (y, x)]
            z = map_coordinates(self.heights - self.heights.mean(), at, order=1, mode="nearest")
        return np.stack([x, y, z], axis=-1)


class _Flight(NamedTuple):
    """Frames of a flight, and what they see of the plot."""

    frames: list[Frame]
    seen: Bool[np.ndarray, "frame y x"]
    """Pixels that lie wholly in each."""
    view: Float[np.ndarray, "frame y x 2"]
    """Zenith and azimuth of each frame as seen from these [degrees]; NaN from others."""

    def some(self, places: Sequence[int]) -> "_Flight":
        return _Flight([self.frames[k] for k in places], self.seen[places], self.view[places])


class _Laid(NamedTuple):
    """Pictures that were laid on the ground."""

    places: list[int]
    """Places of their frames in the flight."""
    stack: FrameStack
    table: pd.DataFrame
    summary: dict[str, Any]
    files: list[Path]
    warnings: list[str]
    """Why pictures were skipped."""


class _Picture(NamedTuple):
    """A picture on the ground."""

    bands: tuple[str, ...]
    values: Float[np.ndarray, "band y x"]
    relative: str


def _lay(
    run: Run,
    flight: _Flight,
    table: pd.DataFrame,
    images: Path,
    bands: Sequence[str] | None,
    most: int | None,
    known: tuple[Plot, Place, _Ground],
) -> _Laid:
    """Lay the pictures of a flight on the ground, and write each as a GeoTIFF. One that cannot be
    used is skipped; `InputError` where none can."""
    plot, place, ground = known
    camera = drone_sensor(plot).bands
    seeing = np.flatnonzero(flight.seen.any(axis=(1, 2)))
    every = pictures_of([flight.frames[k] for k in seeing], images)
    names = [frame.name for frame in flight.frames]
    skipped: dict[int, InputError] = {}
    times, laid = _times(every, names, skipped), dict[int, _Picture]()
    while True:
        if not (able := [k for k in times if k not in skipped]):
            raise _none_left(names, skipped)
        suns = _suns([times[k] for k in able], plot, place)
        places = _chosen(table.loc[able], suns, most)
        with run.stage("Lay the pictures on the ground", total=len(places)):
            for k in track([k for k in places if k not in laid], "Lay"):
                try:
                    laid[k] = _picture(flight.frames[k], every[names[k]], bands, camera, ground)
                except InputError as error:
                    skipped[k] = error
        _skip_others(laid, every, names, skipped)
        if skipped.keys().isdisjoint(places):
            break
    sun_of = dict(zip(able, suns, strict=True))
    seen_bands = laid[places[0]].bands
    centre = dict(zip(camera.names, camera.centre, strict=True))
    stack = FrameStack(
        tuple(flight.frames[k] for k in places),
        seen_bands,
        tuple(centre[name] for name in seen_bands),
        np.stack([laid[k].values for k in places]),
        ground.pixel,
        tuple(sun_of[k] for k in places),
        next((laid[k].relative for k in places if laid[k].relative), ""),
    )
    _write_pictures(run, stack, place, ground)
    use = ["left out" if name in every else "no picture" for name in names]
    for k, how in {**dict.fromkeys(places, "yes"), **dict.fromkeys(skipped, "skipped")}.items():
        use[k] = how
    table = table.assign(used=use)
    at = [np.full(len(names), np.nan) for _ in range(2)]
    for k in places:
        if (sun := sun_of[k]) is not None:
            at[0][k], at[1][k] = sun
    table["sun_zenith_deg"], table["sun_azimuth_deg"] = np.round(at, 6)
    summary = {
        "used": [names[k] for k in places],
        "left_out": [names[k] for k in able if k not in places],
        "skipped": [names[k] for k in sorted(skipped)],
        "suns": len({sun_of[k] for k in places} - {None}),
    }
    warnings = [f"{names[k]} is skipped: {error}" for k, error in sorted(skipped.items())]
    return _Laid(places, stack, table, summary, [every[names[k]] for k in places], warnings)


def _times(
    every: dict[str, Path], names: Sequence[str], skipped: dict[int, InputError]
) -> dict[int, datetime | None]:
    """When the picture of each frame was taken, by the frame's place; those that cannot be opened
    are noted as `skipped`."""
    times: dict[int, datetime | None] = {}
    for k, name in enumerate(names):
        if name not in every:
            continue
        times[k] = None
        try:
            times[k] = picture_time(every[name])
        except InputError as error:
            skipped[k] = error
    return times


def _chosen(
    table: pd.DataFrame, suns: Sequence[tuple[float, float] | None], most: int | None
) -> list[int]:
    """Places of the frames to use, of those that the rows of a table are of."""
    if most is None:
        return list(table.index)
    zenith, azimuth = table[["view_zenith_deg", "view_azimuth_deg"]].to_numpy().T
    features = direction_features(zenith, azimuth, suns)
    share = table["seen"].to_numpy()
    return [table.index[k] for k in choose_frames(features, share, most)]


def _picture(
    frame: Frame, file: Path, bands: Sequence[str] | None, camera: BandSet, ground: _Ground
) -> _Picture:
    """The picture of a frame on the ground, rows from the south."""
    at = picture_place(file, frame)
    image = read_drone_image(file, bands=bands, camera=camera, most_pixels=None)
    with open_raster(file, "a frame of reflectance") as opened:
        relative = opened.tags.get(RELATIVE_TAG, "")
    along, (rows, columns) = points_wanted(frame, ground.pixel), ground.shape
    step = max(_TOGETHER // (columns * along**2), 1)
    parts = []
    for r in range(0, rows, step):
        pixels = frame.pixels(ground.points(along, slice(r, r + step)))
        parts.append(lay_picture(image.values[:, ::-1], at.of_frame(frame.name, pixels), along))
    values = np.where(frame.sees_cells(ground.corners), np.concatenate(parts, axis=1), np.nan)
    if not np.isfinite(values).all(axis=0).any():
        raise InputError(
            f"expected data of the plot in the picture of {frame.name}, but it has none there",
            file=file,
        )
    return _Picture(image.bands, values, relative)


def _skip_others(
    laid: dict[int, _Picture],
    every: dict[str, Path],
    names: Sequence[str],
    skipped: dict[int, InputError],
) -> None:
    """Note as `skipped` the pictures of other bands than most have."""
    if not laid:
        return
    often = Counter(one.bands for one in laid.values())
    usual = max(often, key=lambda bands: (often[bands], len(bands)))
    for k in [k for k, one in laid.items() if one.bands != usual]:
        words = f"{', '.join(usual)} as most pictures have, but got {', '.join(laid.pop(k).bands)}"
        skipped[k] = InputError(f"expected the bands {words}", file=every[names[k]])


def _none_left(names: Sequence[str], skipped: dict[int, InputError]) -> InputError:
    """The error where no picture of a flight can be used: it names each, the first with why."""
    first, *others = (error for _, error in sorted(skipped.items()))
    if not others:
        return first
    return InputError(
        f"expected pictures that can be used, but none of {len(skipped)} can "
        f"({listed(names[k] for k in sorted(skipped))}). The first: {first}"
    )


def _write_pictures(run: Run, stack: FrameStack, place: Place, ground: _Ground) -> None:
    corner = place.corner(ground.start[::-1])
    for view, image in zip(stack.views, stack.reflectance, strict=True):
        where = run.path(f"{view}.tif", "its picture on the ground, reflectance")
        write_geotiff(
            where, image, stack.bands, pixel_m=ground.pixel, origin_m=corner,
            wavelengths=stack.wavelength, crs=place.crs,
        )  # fmt: skip


def _suns(
    times: Sequence[datetime | None], plot: Plot, place: Place
) -> list[tuple[float, float] | None]:
    """Zenith and azimuth of the sun at each time [degrees], those that are alike as their mean;
    None where the time or the plot's place is not known. Azimuths count from grid north of the
    plot, as those of its frames."""
    where, turn = plot.place_deg, 0.0
    if place.crs is not None:
        (east,), (north,) = ([v] for v in place.origin_m)
        (longitude,), (latitude,) = transform(place.crs, "EPSG:4326", [east], [north])[:2]
        where = (latitude, longitude) if where is None else where
        turn = grid_north(place.crs, longitude, latitude)
    known = sorted((time, k) for k, time in enumerate(times) if time is not None)
    found: list[tuple[float, float] | None] = [None] * len(times)
    if where is None or not known:
        return found
    at = {k: sun_position(*where, time) for time, k in known}
    rays = {k: _direction(float(sun.zenith), float(sun.azimuth) - turn) for k, sun in at.items()}
    groups: list[list[int]] = []
    for _, k in known:
        first = rays[groups[-1][0]] if groups else -rays[k]
        near = np.degrees(np.arccos(np.clip(first @ rays[k], -1.0, 1.0))) <= _SAME_SUN
        groups[-1].append(k) if near else groups.append([k])
    for group in groups:
        x, y, z = np.mean([rays[k] for k in group], axis=0)
        azimuth = float(np.degrees(np.arctan2(x, y)) % 360.0)
        zenith = float(np.degrees(np.arctan2(np.hypot(x, y), z)))
        for k in group:
            found[k] = round(zenith, 6), round(azimuth, 6)
    return found


def _direction(zenith: float, azimuth: float) -> Float[np.ndarray, " 3"]:
    """East, north and up of a direction of these angles [degrees]."""
    z, a = np.radians([zenith, azimuth])
    return np.array([np.sin(z) * np.sin(a), np.sin(z) * np.cos(a), np.cos(z)])


def _file(path: Path) -> Path | None:
    return path if path.is_file() else None


def _with_lens(frame: Frame, plot: Plot) -> Frame:
    """The frame with the lens of the plot's sensor, if it has none of its own."""
    if frame.lens is not None:
        return frame
    sensor = load_instrument(plot.sensor.path or plot.sensor.name)
    if not (isinstance(sensor, Sensor) and isinstance(sensor.camera, FrameCamera)):
        raise InputError(
            f"expected a lens of {frame.name}, or a frame camera as sensor of the plot, but "
            f"{sensor.name!r} is none",
            file=plot.file,
        )
    return Frame(frame.pose, lens_of(sensor.camera), frame.name)


def _where(frame: Frame) -> str:
    east, north, height = (float(v) for v in frame.pose.position)
    return f"{frame.name} at {east:.0f} m east, {north:.0f} m north, {height:.0f} m up"


def _summary(flight: _Flight) -> FramesSummary:
    count = flight.seen.sum(axis=0)
    return FramesSummary(
        frames=len(flight.frames),
        seeing=int(flight.seen.any(axis=(1, 2)).sum()),
        fewest_frames=int(count.min()),
        median_frames=float(np.median(count)),
        most_frames=int(count.max()),
        smallest_zenith_deg=float(np.nanmin(flight.view[..., 0])),
        largest_zenith_deg=float(np.nanmax(flight.view[..., 0])),
    )


def _table(flight: _Flight) -> pd.DataFrame:
    """A row a frame: its pose, and how much of the plot it sees from where."""
    found = flight.frames
    poses = [[*frame.pose.position, frame.pose.yaw, frame.pose.pitch, frame.pose.roll]
             for frame in found]  # fmt: skip
    names = ["east_m", "north_m", "height_m", "yaw_deg", "pitch_deg", "roll_deg"]
    table = pd.DataFrame(np.asarray(poses, float), columns=names)
    table.insert(0, "frame", [frame.name for frame in found])
    table["seen"] = flight.seen.mean(axis=(1, 2))
    angles = np.full((len(found), 2), np.nan)
    for k in np.flatnonzero(flight.seen.any(axis=(1, 2))):
        zenith, azimuth = np.radians(flight.view[k][flight.seen[k]]).T
        x, y = np.mean(np.tan(zenith) * [np.sin(azimuth), np.cos(azimuth)], axis=1)
        angles[k] = np.degrees([np.arctan(np.hypot(x, y)), np.arctan2(x, y) % (2 * np.pi)])
    table["view_zenith_deg"], table["view_azimuth_deg"] = angles.T
    return table.round(6)


def _dataset(flight: _Flight, laid: _Laid | None, ground: _Ground, place: Place) -> xr.Dataset:
    """What frames see of the plot: all that do, or those whose pictures were laid on the ground."""
    some = np.flatnonzero(flight.seen.any(axis=(1, 2))).tolist()
    found, seen, view = flight.some(some if laid is None else laid.places)
    middles = ground.points(1)
    if laid is not None:
        found, seen = list(laid.stack.frames), laid.stack.seen
        view = np.stack([frame.view(middles) for frame in found])
        view = np.where(seen[..., None], view, np.nan)
    places = np.stack([frame.pixels(middles) for frame in found])
    places = np.where(seen[..., None], places, np.nan)
    at = image_array(
        seen[:1], ["seen"], [np.nan], pixel_m=ground.pixel,
        origin_m=place.corner(ground.start[::-1]), crs=place.crs, long_name="seen",
    )  # fmt: skip
    named = {"frame": ("frame", [f.name for f in found], {"long_name": "name of the frame"})}
    coordinates: dict[str, Any] = {"y": at["y"], "x": at["x"], **named}
    about = {} if place.crs is None else {"grid_mapping": "crs"}
    layers: dict[str, tuple[Any, str, str]] = {
        "seen": (seen.astype(np.uint8), "1", "whether the pixel lies wholly in the frame"),
        "view_zenith": (view[..., 0], "degree", "zenith angle of the camera"),
        "view_azimuth": (view[..., 1], "degree", "azimuth of the camera, clockwise from north"),
        "column": (places[..., 0], "1", "column of the raw picture, from the middle of the first"),
        "row": (places[..., 1], "1", "row of the raw picture, from the middle of the top one"),
    }
    standard = {"view_zenith": "sensor_zenith_angle", "view_azimuth": "sensor_azimuth_angle"}
    variables: dict[str, Any] = {
        name: (
            ("frame", "y", "x"),
            values if values.dtype == np.uint8 else values.astype(np.float32),
            {"units": unit, "long_name": what, **about}
            | ({"standard_name": standard[name]} if name in standard else {}),
        )
        for name, (values, unit, what) in layers.items()
    }
    count = {"units": "1", "long_name": "frames that see the pixel", **about}
    variables["frames_per_pixel"] = (("y", "x"), seen.sum(axis=0).astype(np.int32), count)
    attributes: dict[str, Any] = {"pixel_m": ground.pixel}
    if laid is not None:
        variables |= laid.stack.variables(about)
        coordinates["band"] = ("band", list(laid.stack.bands), {"long_name": "band name"})
        if laid.stack.relative:
            attributes["relative_reflectance"] = laid.stack.relative
    dataset = xr.Dataset(variables, coordinates, attributes)
    return dataset if place.crs is None else dataset.assign(crs=grid_mapping(place.crs))


def _headline(summary: FramesSummary, plot: Plot) -> list[str]:
    s = summary
    lines = [
        f"{s.seeing} of {s.frames} frames show some of {plot.name}: each pixel is in "
        f"{s.fewest_frames} to {s.most_frames} of them, {s.median_frames:g} by the median.",
        f"It is seen from {s.smallest_zenith_deg:.0f} to {s.largest_zenith_deg:.0f} degrees off "
        "the vertical.",
    ]
    if s.fewest_frames == 0:
        lines.append("Some of the plot is in no frame.")
    if s.used is None:
        return lines
    left, bad = s.left_out or [], s.skipped or []
    lines.append(
        f"Laid on the ground: {len(s.used)} of {len(s.used) + len(left) + len(bad)} pictures."
    )
    if bad:
        lines.append(f"Skipped, since they cannot be used: {len(bad)}, {listed(bad)}.")
    if left:
        lines.append(f"Left out, since they say least beside these: {listed(left)}.")
    lines.append(
        f"Suns by their times: {s.suns}, those within {_SAME_SUN:g} degrees as one."
        if s.suns
        else "Their times are not known: the sun of each is that of the plot file."
    )
    return lines

"""The job of `fynjax frames`: which frames of a flight see a plot, and from where."""

from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import pandas as pd
import xarray as xr
from jaxtyping import Bool, Float
from pydantic import Field
from scipy.ndimage import map_coordinates

from fynjax._core.dry_run import begin_work
from fynjax._core.errors import InputError
from fynjax._core.precision import double_precision
from fynjax.app.assembly import ground_heights
from fynjax.app.io.frames import read_frames
from fynjax.app.io.instruments import load_instrument
from fynjax.app.io.plot import Plot, as_plot, plot_place
from fynjax.app.io.raster import grid_mapping, image_array, write_run
from fynjax.app.jobs._result import JobResult, Record
from fynjax.app.jobs._run import Run
from fynjax.app.report import figures
from fynjax.app.report.pages import Picture, Table
from fynjax.sensors import Frame, FrameCamera, Sensor, lens_of

_MOST = 100_000_000
"""Pixels of all frames, at most."""


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
) -> FramesResult:
    """Find which frames of a flight see a plot, and from which angles.

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

    **Returns:** `FramesResult`. Writes `frames.csv` (poses, and how much of the plot each frame
    sees from where), `frames.nc` (of each frame that sees some of the plot the pixels that lie in
    it, their view zenith and azimuth, and their column and row in the picture), a figure and a
    page into `output`.

    **Raises:** `InputError` as `read_plot` and `read_frames`, for a pixel that the plot has no room
    for, too many pixels, and where no frame shows any of the plot.

    Example: `jobs.frames("odm_report/shots.geojson", "results", plot="plot.toml", ground=312.4)`.
    """
    read = as_plot(plot)
    run = Run(output)
    place = plot_place(read)
    crs = place.crs if crs is None else crs
    corner = place.origin_m if origin is None else origin
    columns, rows = (int(side / pixel + 1e-6) if pixel > 0 else 0 for side in read.size_m)
    if min(columns, rows) < 1:
        raise InputError(
            f"expected a positive `pixel` that the plot of {read.size_m[0]:g} x "
            f"{read.size_m[1]:g} m has room for, but got {pixel:g} m"
        )
    heights = ground_heights(read)
    if heights is not None and ground is None:
        ground = float(heights.mean())
    with run.stage("Read the poses"):
        found = read_frames(path, crs=crs, origin=corner, ground=ground)
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
        corners = _ground(read, heights, pixel, (rows + 1, columns + 1), 0.0)
        middles = _ground(read, heights, pixel, (rows, columns), 0.5)
        seen = np.stack([frame.sees_cells(corners) for frame in found])
    some = np.flatnonzero(seen.any(axis=(1, 2)))
    if not some.size:
        raise InputError(
            f"expected frames that show some of the plot of {read.size_m[0]:g} x "
            f"{read.size_m[1]:g} m, but none of {len(found)} does: {_where(found[0])}. "
            "Are corner and height of the plot in the frames' system?"
        )
    view = np.stack([found[k].view(middles) for k in some])
    view = np.where(seen[some][..., None], view, np.nan)
    table = _table(found, seen, some, view)
    count = seen.sum(axis=0)
    summary = FramesSummary(
        frames=len(found),
        seeing=some.size,
        fewest_frames=int(count.min()),
        median_frames=float(np.median(count)),
        most_frames=int(count.max()),
        smallest_zenith_deg=float(np.nanmin(view[..., 0])),
        largest_zenith_deg=float(np.nanmax(view[..., 0])),
    )
    record = run.record([read.file, _file(Path(path))])
    with run.stage("Write"):
        run.table("frames.csv", table, "poses, and what each frame sees of the plot")
        dataset = _dataset([found[k] for k in some], seen[some], view, middles, pixel, corner, crs)
        where = run.path("frames.nc", "of each frame pixels of the plot, their views and places")
        write_run(where, dataset, record)
    headline = _headline(summary, read)
    picture = Picture(
        "frames.png",
        figures.frames_figure(table, count, pixel),
        "from where the frames see the plot, and how many see each pixel",
    )
    shown = Table(table, "Frames, in metres from the plot's corner.", folded=True)
    run.pictures(f"Frames over {read.name}", headline, [picture, shown], [read.file])
    return run.result(FramesResult, headline=headline, flight=summary)


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


def _ground(
    plot: Plot,
    heights: Float[np.ndarray, "row column"] | None,
    pixel: float,
    shape: tuple[int, int],
    first: float,
) -> Float[np.ndarray, "y x 3"]:
    """Points of the plot's ground, `pixel` apart from `first` of it on, above its mean height."""
    north, east = ((np.arange(n) + first) * pixel for n in shape)
    y, x = np.meshgrid(north, east, indexing="ij")
    z = np.zeros(shape)
    if heights is not None:
        at = [axis / plot.voxel_m - 0.5 for axis in (y, x)]
        z = map_coordinates(heights - heights.mean(), at, order=1, mode="nearest")
    return np.stack([x, y, z], axis=-1)


def _where(frame: Frame) -> str:
    east, north, height = (float(v) for v in frame.pose.position)
    return f"{frame.name} at {east:.0f} m east, {north:.0f} m north, {height:.0f} m up"


def _table(
    found: list[Frame],
    seen: Bool[np.ndarray, "frame y x"],
    some: Any,
    view: Float[np.ndarray, "seeing y x 2"],
) -> pd.DataFrame:
    """A row a frame: its pose, and how much of the plot it sees from where."""
    poses = [[*frame.pose.position, frame.pose.yaw, frame.pose.pitch, frame.pose.roll]
             for frame in found]  # fmt: skip
    names = ["east_m", "north_m", "height_m", "yaw_deg", "pitch_deg", "roll_deg"]
    table = pd.DataFrame(np.asarray(poses, float), columns=names)
    table.insert(0, "frame", [frame.name for frame in found])
    table["seen"] = seen.mean(axis=(1, 2))
    angles = np.full((len(found), 2), np.nan)
    for k, one in zip(some, view, strict=True):
        zenith, azimuth = np.radians(one[seen[k]]).T
        x, y = np.mean(np.tan(zenith) * [np.sin(azimuth), np.cos(azimuth)], axis=1)
        angles[k] = np.degrees([np.arctan(np.hypot(x, y)), np.arctan2(x, y) % (2 * np.pi)])
    table["view_zenith_deg"], table["view_azimuth_deg"] = angles.T
    return table.round(6)


def _dataset(
    found: list[Frame],
    seen: Bool[np.ndarray, "frame y x"],
    view: Float[np.ndarray, "frame y x 2"],
    middles: Float[np.ndarray, "y x 3"],
    pixel: float,
    corner: tuple[float, float],
    crs: str | None,
) -> xr.Dataset:
    places = np.stack([frame.pixels(middles) for frame in found])
    places = np.where(seen[..., None], places, np.nan)
    at = image_array(
        seen[:1], ["seen"], [np.nan], pixel_m=pixel, origin_m=corner, crs=crs, long_name="seen"
    )
    named = {"frame": ("frame", [f.name for f in found], {"long_name": "name of the frame"})}
    coordinates = {"y": at["y"], "x": at["x"], **named}
    about = {} if crs is None else {"grid_mapping": "crs"}
    layers: dict[str, tuple[Any, str, str]] = {
        "seen": (seen.astype(np.uint8), "1", "whether the pixel lies wholly in the frame"),
        "view_zenith": (view[..., 0], "degree", "zenith angle of the camera"),
        "view_azimuth": (view[..., 1], "degree", "azimuth of the camera, clockwise from north"),
        "column": (places[..., 0], "1", "column in the picture, from the middle of the first"),
        "row": (places[..., 1], "1", "row in the picture, from the middle of the top one"),
    }
    variables: dict[str, Any] = {
        name: (
            ("frame", "y", "x"),
            values if values.dtype == np.uint8 else values.astype(np.float32),
            {"units": unit, "long_name": what, **about},
        )
        for name, (values, unit, what) in layers.items()
    }
    count = {"units": "1", "long_name": "frames that see the pixel", **about}
    variables["frames_per_pixel"] = (("y", "x"), seen.sum(axis=0).astype(np.int32), count)
    dataset = xr.Dataset(variables, coordinates)
    return dataset if crs is None else dataset.assign(crs=grid_mapping(crs))


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
    return lines

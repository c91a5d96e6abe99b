"""Frames of a flight as what a calibration is to reach: a view of each, from where it hung."""

import dataclasses
import warnings
from pathlib import Path

import jax.numpy as jnp
import numpy as np

from fynjax._core.errors import InputError, in_file
from fynjax._core.precision import double_precision
from fynjax.app.assembly._build import build_plot
from fynjax.app.assembly._targets import (
    RealImage,
    TargetRules,
    image_sight,
    target_rules,
    weighed_statistics,
)
from fynjax.app.compare import DroneImage
from fynjax.app.io.frames import FrameStack, read_frame_stack
from fynjax.app.io.plot import Plot, drone_sensor, read_cameras
from fynjax.inversion import BandView, Data, Source, join_data, look
from fynjax.scene import Placement
from fynjax.sensors import Frame, FrameCamera, Pose, lens_of


def flight_data(plot: Plot, path: Path, view: str = "") -> Data:
    """Statistics of each frame of a flight, as views of one camera.

    **Arguments:**

    - `plot`: as `read_plot` gives it, with the sensor that took the frames.
    - `path`: of frames on the ground, as `fynjax frames --images` writes them.
    - `view`: word that stands before the names of the frames; none by default.

    **Returns:** `Data` of all frames, each with its pose, lens and sun. Only pixels that a frame
    sees count, in the image and in what is simulated.

    **Raises:** `InputError` as `read_frame_stack`, for frames of another grid than that of the
    plot, and of bands that its sensor lacks.
    """
    stack = read_frame_stack(path)
    if stack.relative:
        warnings.warn(f"{path}: {stack.relative}", stacklevel=2)
    with in_file(path):
        shape = tuple(int(side / stack.pixel + 1e-6) for side in plot.size_m[::-1])
        if stack.reflectance.shape[2:] != shape:
            rows, columns = stack.reflectance.shape[2:]
            raise InputError(
                f"expected frames on the ground of a plot of {plot.size_m[0]:g} x "
                f"{plot.size_m[1]:g} m, {shape[1]} x {shape[0]} pixels of {stack.pixel:g} m, but "
                f"got {columns} x {rows}: are they of another plot?"
            )
        camera = drone_sensor(plot)
        if lacking := [name for name in stack.bands if name not in camera.bands.names]:
            raise InputError(
                f"expected bands of {camera.name!r} ({', '.join(camera.bands.names)}), but the "
                f"frames have {lacking[0]!r}: name the sensor that took them"
            )
        parts = [_frame_data(plot, stack, k, path) for k in range(len(stack.frames))]
    prefix = f"{view}_" if view else ""
    named = zip(parts, stack.views, strict=True)
    return join_data([part.renamed(f"{prefix}{name}") for part, name in named])


@double_precision
def simulated_flight(plot: Plot, path: Path, *, seed: int) -> tuple[FrameStack, FrameStack]:
    """Frames of a flight, and what the camera sees of the plot from where each hung.

    **Arguments:** `plot`, as `read_plot` gives it; `path`, as of `flight_data`; `seed` of the
    plants.

    **Returns:** both stacks, of the same pixels.

    **Raises:** `InputError` as `flight_data` and `build_plot`.
    """
    stack, data = read_frame_stack(path), flight_data(plot, path)
    scene, parameters = build_plot(plot, seed=seed, rounding="up")
    views = [one.source.view(scene, parameters) for one in data.parts if one.source is not None]
    _, *images = look(views, scene, parameters)
    assert isinstance(views[0], BandView)
    order = [views[0].bands.names.index(name) for name in stack.bands]
    seen = np.where(stack.seen[:, None], np.stack([np.asarray(i)[order] for i in images]), np.nan)
    return stack, dataclasses.replace(stack, reflectance=seen)


def mosaic_of(plot: Plot, path: Path) -> Frame:
    """The cameras of a mosaic of a plot, as one frame; those that see nothing of it are left out.

    **Arguments:**

    - `plot`: as `read_plot` gives it, with the camera that took the frames.
    - `path`: of the table of cameras.

    **Raises:** `InputError` as `read_cameras`, for a sensor that is no frame camera, and where no
    camera sees any of the plot.
    """
    sensor = drone_sensor(plot)
    if not isinstance(sensor.camera, FrameCamera):
        raise InputError(f"expected a frame camera, but {sensor.name!r} is none", file=plot.file)
    lens = lens_of(sensor.camera)
    east, north = (np.linspace(0.0, side, 9) for side in plot.size_m)
    points = np.stack([*np.meshgrid(east, north), np.zeros((9, 9))], axis=-1)
    every = [Frame(pose, lens, f"camera {k}") for k, pose in enumerate(read_cameras(path), 1)]
    some = tuple(frame for frame in every if frame.sees(points).any())
    if not some:
        raise InputError(
            f"expected cameras that see some of the plot of {plot.size_m[0]:g} x "
            f"{plot.size_m[1]:g} m, but none of {len(every)} does. Are positions counted from its "
            "south-west corner?",
            file=path,
        )
    height = float(np.mean([frame.pose.position[2] for frame in some]))
    middle = np.array([0.5 * plot.size_m[0], 0.5 * plot.size_m[1], height])
    return Frame(Pose(jnp.asarray(middle)), lens, path.name, some)


def _frame_data(plot: Plot, stack: FrameStack, number: int, path: Path) -> Data:
    frame, values = stack.frames[number], stack.reflectance[number]
    seen, bands = stack.seen[number], drone_sensor(plot).bands
    own = bands.select([bands.names.index(name) for name in stack.bands])
    rules: TargetRules = target_rules(plot)
    data = weighed_statistics(values, own, seen, stack.pixel, rules, side=min(plot.size_m))
    sight = dataclasses.replace(
        image_sight(plot, data.names),
        placement=Placement(pixel=stack.pixel, frame=frame),
        sun=stack.sun[number],
        mask=jnp.asarray(seen),
    )
    image = frames_image(path, stack, number)
    source = Source(
        "image",
        sight,
        f"{frame.name}: {len(data.names)} statistics of the {seen.mean():.0%} of the plot that it "
        f"sees, from {frame.pose.position[2]:.0f} m.",
        path,
        {"target_valid_share": float(seen.mean())},
        image=RealImage.of(image, stack.pixel, plot.size_m),
    )
    return dataclasses.replace(data, source=source)


def frames_image(path: Path, stack: FrameStack, number: int | None = None) -> DroneImage:
    """One of the frames of the file `path`, which is a `stack`, as an image, by its `number`;
    without one all of them, one beyond the other to the north."""
    some = slice(None) if number is None else slice(number, number + 1)
    seen = np.concatenate(list(stack.seen[some]))
    values = np.concatenate(list(stack.reflectance[some]), axis=1)
    return DroneImage(
        file=path,
        values=np.where(seen, values, np.nan),
        bands=stack.bands,
        mask=seen,
        taken=stack.bands,
        chosen_by="names",
        shape=(seen.shape[0], seen.shape[1]),
        step=1,
        pixel_m=stack.pixel,
        crs=None,
        without_data=int((~seen).sum()),
        saturated=0,
        not_positive=int((values[:, seen] <= 0.0).any(axis=0).sum()),
    )

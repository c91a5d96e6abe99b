"""Pictures that the made-up flight of `frame_files` would take of a ground whose reflectance is a
formula: by its own projections, none of fynjax's."""

from pathlib import Path

import numpy as np
from scipy.interpolate import LinearNDInterpolator

from fynjax.app.io.raster import write_geotiff
from fynjax.metrics import BANDS
from tests.io import frame_files as made

LEVELS = np.array([0.06, 0.05, 0.15, 0.30])
WAVES = (560.0, 650.0, 730.0, 860.0)


def ground(x, y):
    """Reflectance [band] at places of the ground [m]."""
    wave = 1.0 + 0.3 * np.sin(2 * np.pi * x / 1.3) * np.cos(2 * np.pi * y / 1.7)
    return LEVELS.reshape(-1, *[1] * np.ndim(wave)) * wave


def places(name, step=0.25, reach=(-3.0, 6.0)):
    """East and north of the ground that each pixel of a picture sees [row, column, 2], NaN far from
    the plot."""
    axis = np.arange(reach[0], reach[1] + step, step)
    x, y = np.meshgrid(axis, axis)
    points = np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], axis=1)
    seen = made.truth(name, points)
    columns, rows = made.SIZE
    column, row = np.meshgrid(np.arange(columns), np.arange(rows))
    return LinearNDInterpolator(seen, points[:, :2])(column, row)


def picture(name, reflectance=ground):
    """The picture of a frame [band, row, column], rows from the top."""
    x, y = np.moveaxis(places(name), -1, 0)
    return reflectance(x, y)


def write_pictures(folder: Path, reflectance=ground, tags=None, names=None) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    for k, name in enumerate(made.SHOTS if names is None else names):
        values = picture(name, reflectance)
        write_geotiff(
            folder / f"{Path(name).stem}_reflectance.tif", values[:, ::-1], BANDS, pixel_m=1.0,
            wavelengths=WAVES, tags=None if tags is None else tags[k],
        )  # fmt: skip
    return folder


def write_stack(path: Path, stack) -> Path:
    """Frames that lie on the ground already, as `fynjax frames` writes them."""
    import xarray as xr

    from fynjax.app.io.raster import write_run

    rows, columns = stack.reflectance.shape[2:]
    coordinates = {
        "frame": ("frame", [f.name for f in stack.frames], {"long_name": "name of the frame"}),
        "band": ("band", list(stack.bands), {"long_name": "band name"}),
    }
    for name, count in (("y", rows), ("x", columns)):
        about = {"units": "m", "long_name": name}
        coordinates[name] = (name, (np.arange(count) + 0.5) * stack.pixel, about)
    angle = {"units": "degree", "long_name": "zenith angle of the camera"}
    zenith = np.zeros((len(stack.frames), rows, columns))
    variables = stack.variables({}) | {"view_zenith": (("frame", "y", "x"), zenith, angle)}
    write_run(path, xr.Dataset(variables, coordinates, {"pixel_m": stack.pixel}))
    return path

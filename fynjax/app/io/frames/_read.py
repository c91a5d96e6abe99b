"""Frames of a flight, whoever calibrated them."""

from pathlib import Path

import pyproj

from fynjax._core.errors import InputError, in_file
from fynjax.app.io.frames._metashape import metashape_shots
from fynjax.app.io.frames._odm import odm_shots
from fynjax.app.io.frames._pictures import SUFFIXES, picture_shots
from fynjax.app.io.frames._pix4d import EXTERNAL, INTERNAL, pix4d_shots
from fynjax.app.io.frames._shot import placed
from fynjax.app.io.raster import check_metric, parse_crs
from fynjax.app.io.text import existing_file
from fynjax.sensors import Frame

_KINDS = (
    "OpenDroneMap's shots.geojson with cameras.json",
    f"Pix4D's *{EXTERNAL} with *{INTERNAL}",
    "Metashape's cameras.xml",
    "pictures of a DJI or MicaSense camera",
)


def read_frames(
    path: str | Path,
    *,
    crs: str | int | None = None,
    origin: tuple[float, float] = (0.0, 0.0),
    ground: float | None = None,
) -> list[Frame]:
    """Read poses and lenses of the frames of a flight, in the coordinates of a plot.

    **Arguments:**

    - `path`: OpenDroneMap's `shots.geojson` (its `cameras.json` lies beside it or in the folder
      above), Pix4D's `*_calibrated_external_camera_parameters.txt` (with
      `*_calibrated_camera_parameters.txt` beside it), Metashape's `cameras.xml`, a picture of a DJI
      or MicaSense camera, or a folder with one of these.
    - `crs`: reference system of the plot in metres, such as "EPSG:32734". Left out, that of the
      file, if its coordinates are metres.
    - `origin`: easting and northing of the plot's south-west corner in that system [m].
    - `ground`: mean height of the plot's ground in the system of the frames' heights [m]: with
      RTK and most software above the ellipsoid. Left out for pictures of a DJI, their height above
      the point of take-off is taken for that above the ground.

    **Returns:** the `Frame`s, one for each picture that was aligned, in the order of the file.
    Angles are turned from true or grid north of the file to grid north of the plot, and heights
    stretched as the plot's grid is. A frame without a lens takes that of the sensor.

    **Raises:** `InputError` with file and line, key or name of the frame, for files that are
    missing, damaged or do not fit together, and for what is not known of the plot.
    """
    system = None
    if crs is not None:
        parsed = parse_crs(crs)
        check_metric(parsed)
        system = pyproj.CRS.from_wkt(parsed.to_wkt())
    path = Path(path)
    file, pictures = _found(path)
    with in_file(path if file is None else file):
        if file is None:
            shots = picture_shots(pictures, above_ground=ground is None)
        elif file.suffix.lower() == ".geojson":
            shots = odm_shots(file)
        elif file.suffix.lower() == ".xml":
            shots = metashape_shots(file)
        else:
            shots = pix4d_shots(file)
        return placed(shots, system, origin, ground)


def _found(path: Path) -> tuple[Path | None, list[Path]]:
    """The export that a path means, or None and the pictures."""
    if path.is_dir():
        inside = sorted(p for p in path.iterdir() if p.is_file())
        reports = path / "odm_report" / "shots.geojson"
        exports = [p for p in inside if _is_export(p)] + [p for p in [reports] if p.is_file()]
        if len(exports) > 1:
            raise InputError(
                f"expected one export of frames, but this folder has {exports[0].name} and "
                f"{exports[1].name}: name one",
                file=path,
            )
        pictures = [p for p in inside if p.suffix.lower() in SUFFIXES]
        if not exports and not pictures:
            raise InputError(
                f"expected {', or '.join(_KINDS)}, but this folder has none", file=path
            )
        return (exports[0], []) if exports else (None, pictures)
    existing_file(path, "poses of a flight's frames")
    if _is_export(path) or path.name.endswith(INTERNAL):
        return path, []
    if path.suffix.lower() in SUFFIXES:
        return None, [path]
    raise InputError(f"expected {', or '.join(_KINDS)}, but it is called otherwise", file=path)


def _is_export(path: Path) -> bool:
    """Whether a file is called as an export of frames."""
    return path.suffix.lower() in (".geojson", ".xml") or path.name.endswith(EXTERNAL)

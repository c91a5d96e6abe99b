"""The job of `fynjax reflectance`: from raw pictures of a camera to reflectance."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal, NamedTuple

import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from fynjax._core.dry_run import begin_work
from fynjax._core.errors import InputError
from fynjax._core.precision import double_precision
from fynjax._core.progress import track
from fynjax.app.io.captures import (
    AlignedCapture,
    Capture,
    PanelView,
    Registration,
    aligned_radiance,
    find_captures,
    on_earth,
    panel_reflectance,
    read_capture,
    read_panel,
    same_capture,
    usable_captures,
)
from fynjax.app.io.frames import PICTURE_TAG, TIME_TAG, PicturePlace, utc_time
from fynjax.app.io.raster import RELATIVE_TAG, Cube, provenance, write_cube_geotiff
from fynjax.app.io.text import write_text
from fynjax.app.jobs._reflectance_record import (
    RELATIVE_REFLECTANCE,
    CaptureSummary,
    PanelSummary,
    calibration_table,
    capture_sentence,
    capture_summary,
    capture_warnings,
    oblique_warning,
    one_panel_sentence,
    panel_sentences,
    panel_summary,
)
from fynjax.app.jobs._result import JobResult
from fynjax.app.jobs._run import Run, paths_of
from fynjax.app.report import figures
from fynjax.app.report.pages import Picture
from fynjax.sensors import (
    EmpiricalLine,
    empirical_line,
    irradiance_line,
    one_panel_line,
    shipped_sensor,
)

_SHOWN = 12
"""Captures that a page shows, at most; each has its picture as a file."""
_CHANGED = 0.1
"""Change of the light between pictures of one panel that is warned of [-]."""
LIGHTS = ("panel", "sensor", "both")
"""Where the light comes from that reflectance is relative to."""


class ReflectanceResult(JobResult):
    """What `reflectance` converted, and by what calibration."""

    command: Literal["reflectance"] = "reflectance"
    light: str
    panel_sd: float
    light_sd: float
    panels: list[PanelSummary]
    captures: dict[str, CaptureSummary]


@double_precision
def reflectance(
    images: str | Path | Sequence[str | Path],
    output: str | Path,
    *,
    panels: Sequence[str | Path] = (),
    panel_reflectances: Sequence[str] = (),
    panel_areas: Sequence[str] = (),
    light: str | None = None,
    panel_sd: float = 0.02,
    light_sd: float | None = None,
    height: float | None = None,
    pixel: float | None = None,
    align: bool = True,
    own_pixels: bool = False,
) -> ReflectanceResult:
    """Turn raw pictures of a multispectral drone camera into reflectance.

    Every capture that shows no panel is converted; one that cannot be read, lacks a band that most
    have or a light sensor that is needed is skipped, with a warning.

    **Arguments:**

    - `images`: raw pictures of a MicaSense camera (RedEdge, RedEdge-P, Altum), a Mavic 3
      Multispectral or a Phantom 4 Multispectral: folders of captures, or files of bands.
    - `output`: folder of the results, made if missing.
    - `panels`: capture that shows a panel: its name, such as IMG_0000, or one of its files. The
      same again for a second panel in it; panels of different reflectance make an empirical line.
      Captures of one panel, such as before and after the flight, are averaged. Left out: captures
      whose metadata say that they show one.
    - `panel_reflectances`: reflectance of the panel: a number, one for each band in order with
      commas between, or a CSV file (band,reflectance or wavelength_nm,reflectance). Of each panel
      in the same order; one serves for all.
    - `panel_areas`: corners of its area, columns and rows of pixels, as "x,y x,y x,y ..."; found in
      the picture if left out.
    - `light`: what the light is known by: panel, steady since the panel; sensor, pi L / E by the
      downwelling light sensor; both, the panel, and the sensor for changes since. Left out: panel,
      or sensor where there is no panel.
    - `panel_sd`: relative standard deviation of the panel's reflectance.
    - `light_sd`: relative standard deviation of light and camera; that of the sensor file for this
      way if left out: 0.18 by the light sensor alone, 0.10 by a panel, 0.04 by several panels.
    - `height`: height of flight above the ground [m]; that above the take-off, as a DJI states it,
      if left out. Where it or `pixel` is known, a capture whose files have position and heading is
      turned to the north and laid there.
    - `pixel`: or the side of a pixel on the ground [m].
    - `align`: align the bands of a capture's files.
    - `own_pixels`: leave every capture on the pixels of its camera, as `frames` lays them on the
      ground, wherever it was taken.

    **Returns:** `ReflectanceResult`. Writes for each capture its reflectance and the standard
    deviation (GeoTIFF), `calibration.csv`, `provenance.json`, figures and a page into `output`.

    **Raises:** `InputError` as the readers, and for panels, light and captures that do not fit.

    Example: `jobs.reflectance(["flight"], "results", panel_reflectances=["0.5"], height=40.0)`.
    """
    run = Run(output)
    _check(panels, panel_reflectances, panel_areas, light, panel_sd, light_sd, height, pixel)
    if own_pixels and not (height is None and pixel is None):
        raise InputError("expected the pixels of the camera, or a height or pixel, but got both")
    captures = find_captures(paths_of(images))
    with run.stage("Read the panels"):
        usable, skipped, dark = usable_captures(captures)
        read = _panels(captures if panels else usable, panels, panel_areas, light)
        stated: Sequence[str | None] = panel_reflectances or [None]
        known = [
            panel_reflectance(stated[k] if len(stated) > 1 else stated[0], panel.capture)
            for k, panel in enumerate(read)
        ]
    light = light or ("panel" if read else "sensor")
    of_panels = {path.resolve() for panel in read for path in panel.capture.paths}
    wanted = {
        name: paths
        for name, paths in usable.items()
        if of_panels.isdisjoint(path.resolve() for path in paths)
    }
    unlit = {} if light == "panel" else {name: dark[name] for name in wanted if name in dark}
    if unlit and len(unlit) == len(wanted):
        raise next(iter(unlit.values()))
    wanted = {name: paths for name, paths in wanted.items() if name not in unlit}
    if not wanted:
        raise InputError(
            "expected captures to convert, but there are only those of panels: "
            f"{', '.join(dict.fromkeys(panel.capture.name for panel in read))}"
        )
    first = read_capture(*next(iter(wanted.items()))).bands[0]
    calibration = _calibration(read, known, light, panel_sd, light_sd, first.sensor)
    begin_work(
        {f"{name}_reflectance.tif": "" for name in wanted},
        (_line_of(read_capture(*capture), calibration) for capture in wanted.items()),
    )
    made = _convert(run, wanted, calibration, None if own_pixels else (height, pixel), align)
    headline = panel_sentences(read, known, light)
    warnings = [f"{name} is skipped: {error}" for name, error in (skipped | unlit).items()]
    if calibration.apart is not None:
        headline.append(one_panel_sentence(read, light, calibration.apart))
        if np.max(calibration.apart) > _CHANGED:
            warnings.append(headline[-1])
    headline += made.headline
    warnings += made.warnings
    if not (first.absolute or calibration.line is not None):
        warnings.append(RELATIVE_REFLECTANCE)
    missing = {what for summary in made.captures.values() for what in summary.missing_corrections}
    warnings += [
        f"the metadata have no numbers for {what}, which is not corrected"
        for what in sorted(missing)
    ]
    shown = made.pictures
    if read:
        what = "picture: the panels in every band, and the area that was read"
        shown = [Picture("panels.png", figures.panel_figure(read, known), what), *shown]
    what = "gain, offset and their uncertainty, for each capture and band"
    write_text(run.path("calibration.csv", what), calibration_table(made.captures))
    inputs = [path for panel in read for path in panel.capture.paths] + made.inputs
    run.pictures(
        "reflectance", f"Reflectance of {len(made.captures)} captures", headline, shown, inputs
    )
    path = run.path("provenance.json", "what was read, how, and what came of it")
    result = run.result(
        ReflectanceResult,
        headline=headline,
        warnings=warnings,
        light=light,
        panel_sd=panel_sd,
        light_sd=calibration.light_sd,
        panels=[panel_summary(panel, rho) for panel, rho in zip(read, known, strict=True)],
        captures=made.captures,
    )
    kept = {"light", "panel_sd", "light_sd", "panels", "captures"}
    about = provenance(inputs=dict.fromkeys(inputs)) | result.model_dump(mode="json", include=kept)
    write_text(path, json.dumps(about, indent=2) + "\n")
    return result


class _Calibration(NamedTuple):
    """Panels and the line through them, for light from one of `LIGHTS`."""

    light: str
    panels: Sequence[PanelView]
    line: EmpiricalLine | None
    """None where light is that of the light sensor alone."""
    light_sd: float
    """Standard deviation of light and camera together, relative [-]."""
    apart: NDArray[np.float64] | None = None
    """Range of the signals that one panel has in several pictures over their mean, in each band
    [-]; None of a panel in one picture, and of several panels."""


class _Converted(NamedTuple):
    """Captures that were converted, and what is said of them and of those that failed."""

    captures: dict[str, CaptureSummary]
    pictures: list[Picture]
    inputs: list[Path]
    headline: list[str]
    warnings: list[str]


def _convert(
    run: Run,
    captures: dict[str, list[Path]],
    calibration: _Calibration,
    ground: tuple[float | None, float | None] | None,
    align: bool,
) -> _Converted:
    """Write the reflectance of every capture whose bands can be aligned; `ground` is the height of
    flight and the size of a pixel [m], as far as they are stated, None of captures that are to stay
    on the pixels of their camera."""
    made = _Converted({}, [], [], [], [])
    oblique: dict[str, float] = {}
    failed: InputError | None = None
    for name, paths in track([*captures.items()], "Convert"):
        capture = read_capture(name, paths)
        line, change = _line_of(capture, calibration)
        try:
            aligned = aligned_radiance(capture, align=align)
        except InputError as problem:
            failed = problem
            made.warnings.append(f"{name} is skipped: {problem}")
            continue
        side, spread = None, None
        if ground is not None and (aside := capture.bands[0].oblique) is not None:
            oblique[name] = aside
        elif ground is not None:
            side, spread = _ground(capture, *ground)
        cube, doubt = _cubes(capture, aligned, line, side)
        tags = {
            **provenance(inputs=paths),
            "calibration": f"light: {calibration.light}",
            "coordinates": _place_text(side, spread),
        }
        if spread is None:
            tags[PICTURE_TAG] = _in_picture(capture, aligned).text()
        if (time := utc_time(capture.bands[0].utc)) is not None:
            tags[TIME_TAG] = time.isoformat()
        if calibration.line is None and not capture.absolute:
            tags[RELATIVE_TAG] = RELATIVE_REFLECTANCE
        picture = _write_capture(run, name, cube, doubt, tags)
        if len(made.pictures) < _SHOWN:
            made.pictures.append(picture)
        summary = capture_summary(capture, aligned, line, change, cube, side, spread)
        made.captures[name] = summary
        made.inputs.extend(paths)
        made.headline.append(capture_sentence(name, summary))
        made.warnings.extend(capture_warnings(name, summary, calibration.light))
    if failed is not None and not made.captures:
        raise failed
    if oblique:
        made.warnings.append(oblique_warning(oblique))
    return made


def _in_picture(capture: Capture, aligned: AlignedCapture) -> PicturePlace:
    """Where the pixels of an aligned capture lie in the picture of its first band, or in the frame
    that the maker lays all bands on."""
    rows, columns = capture.bands[0].counts.shape
    left, low = (
        round(0.5 * (count - 1) - middle)
        for count, middle in zip((columns, rows), aligned.middle, strict=True)
    )
    top = rows - low - aligned.radiance.shape[1]
    first = capture.bands[0]
    bands: dict[str, Registration | None] = {first.path.name: None}
    if aligned.alignment is not None and any(band.registration for band in capture.bands):
        # First those that the frame is the picture of: theirs is the pose that a gimbal has.
        moved = sorted(capture.bands, key=lambda band: not _stays(band.registration))
        bands = {band.path.name: band.registration for band in moved}
    return PicturePlace((columns, rows), (left, top), bands)


def _stays(registration: Registration | None) -> bool:
    return registration is None or np.allclose(registration.homography, np.eye(3))


def _write_capture(run: Run, name: str, cube: Cube, doubt: Cube, tags: dict[str, Any]) -> Picture:
    """Write a capture's reflectance, its standard deviation and a picture, which is returned."""
    what = f"reflectance of {len(cube.names)} bands"
    write_cube_geotiff(run.path(f"{name}_reflectance.tif", what), cube, tags)
    of_doubt = "standard deviation by panel and light, noise of pixels left out"
    what = "its standard deviation, by panel and light"
    path = run.path(f"{name}_reflectance_sd.tif", what)
    write_cube_geotiff(path, doubt, {**tags, "quantity_of": of_doubt})
    what = "picture: true and false colour, vegetation index"
    figure = figures.capture_figure(cube, name, pixels=tags["coordinates"].startswith("pixels"))
    picture = Picture(f"{name}.png", figure, what)
    run.picture(picture)
    return picture


def _check(
    panels: Sequence[str | Path],
    reflectances: Sequence[str],
    areas: Sequence[str],
    light: str | None,
    panel_sd: float,
    light_sd: float | None,
    height: float | None,
    pixel: float | None,
) -> None:
    if light not in (None, *LIGHTS):
        raise InputError(f"`light` must be one of {', '.join(LIGHTS)}, but is {light!r}")
    if areas and len(areas) != len(panels):
        raise InputError(f"expected one --panel-area for each --panel, but got {len(areas)}")
    if len(reflectances) > 1 and len(reflectances) != len(panels):
        raise InputError(
            f"expected one --panel-reflectance, or one for each of {len(panels)} --panel, but got "
            f"{len(reflectances)}"
        )
    for what, value in (("panel_sd", panel_sd), ("light_sd", light_sd)):
        if value is not None and not 0.0 <= value < 1.0:
            raise InputError(f"`{what}` must be a fraction from 0 to below 1, but is {value:g}")
    if height is not None and pixel is not None:
        raise InputError("expected the height of flight or the size of a pixel, but got both")
    for what, size in (("height", height), ("pixel", pixel)):
        if size is not None and not (np.isfinite(size) and size > 0.0):
            raise InputError(f"`{what}` must be positive [m], but is {size:g}")


def _corners(text: str) -> NDArray[np.float64]:
    try:
        corners = np.array([[float(v) for v in pair.split(",")] for pair in text.split()])
        if corners.ndim != 2 or corners.shape[1] != 2 or len(corners) < 3:
            raise ValueError
    except ValueError:
        raise InputError(
            'expected corners of a panel\'s area as "x,y x,y x,y ...", columns and rows of three '
            f"pixels or more, but got {text!r}"
        ) from None
    return corners


def _panels(
    captures: dict[str, list[Path]],
    panels: Sequence[str | Path],
    areas: Sequence[str],
    light: str | None,
) -> list[PanelView]:
    if light == "sensor" and not panels:
        return []
    if panels:
        named = [same_capture(panel, captures) for panel in panels]
        shown = {paths[0]: read_capture(name, paths) for name, paths in named}
        return [
            read_panel(shown[paths[0]], _corners(areas[k]) if areas else None)
            for k, (_, paths) in enumerate(named)
        ]
    every = (read_capture(name, paths) for name, paths in captures.items())
    marked = [c for c in every if all(band.panel_reflectance is not None for band in c.bands)]
    if not marked and light is not None:
        raise InputError(
            f"expected a picture of a panel for light from {light!r}, but no capture says that it "
            f"shows one. Name it: --panel {next(iter(captures))}"
        )
    return [read_panel(capture) for capture in marked]


def _calibration(
    panels: Sequence[PanelView],
    known: Sequence[NDArray[np.float64]],
    light: str,
    panel_sd: float,
    light_sd: float | None,
    sensor: str,
) -> _Calibration:
    """The line through panels of `known` reflectance, under the light of the first's picture."""
    by_sensor = not panels or light == "sensor"
    # Of one reflectance, and each in another picture.
    pictures = {panel.capture.paths[0] for panel in panels}
    one = len(pictures) == len(panels) and all(np.array_equal(rho, known[0]) for rho in known)
    if light_sd is None:  # the usual one of this way, by the sensor's file
        ways = {gains.way: gains.sd for gains in shipped_sensor(sensor).calibrations}
        by_panel = "panels" if one else "empirical_line"
        light_sd = float(np.max(ways["light_sensor" if by_sensor else by_panel]))
    if by_sensor:
        return _Calibration(light, panels, None, light_sd)
    first = panels[0].capture
    for panel in panels[1:]:
        _check_bands(panel.capture, first)
    by = np.array([panel.capture.irradiance / first.irradiance if light == "both"
                   else np.ones(len(first.bands)) for panel in panels])  # fmt: skip
    signal = jnp.array([panel.mean for panel in panels] / by)
    error = jnp.array([panel.spread / np.sqrt(panel.count) for panel in panels] / by)
    rho = jnp.array(known)
    if not one:
        line = empirical_line(signal, rho, signal_sd=error, reflectance_sd=panel_sd * rho)
        return _Calibration(light, panels, line, light_sd)
    mean = signal.mean(axis=0)
    error = jnp.linalg.norm(error, axis=0) / len(panels)
    line = one_panel_line(mean, rho[0], signal_sd=error, reflectance_sd=panel_sd * rho[0])
    apart = np.asarray(jnp.ptp(signal, axis=0) / mean) if len(panels) > 1 else None
    return _Calibration(light, panels, line, light_sd, apart)


def _check_bands(capture: Capture, first: Capture) -> None:
    if capture.names != first.names:
        raise InputError(
            f"expected the bands {', '.join(first.names)} as in {first.name}, but got "
            f"{', '.join(capture.names)}",
            file=capture.bands[0].path,
        )


def _line_of(
    capture: Capture, calibration: _Calibration
) -> tuple[EmpiricalLine, NDArray[np.float64] | None]:
    """The line under the light of a capture, and by what factor it changed since the panel."""
    light, panels, line, light_sd, apart = calibration
    if line is None:
        level = jnp.asarray(capture.irradiance)
        return irradiance_line(level, irradiance_sd=light_sd * level), None
    first = panels[0].capture
    _check_bands(capture, first)
    # Of one panel in several pictures the mean counts, as long as the line is of their mean.
    of_mean = apart is not None and light == "panel"
    shown = [panel.capture for panel in (panels if of_mean else panels[:1])]
    stated = all(b.irradiance is not None for c in (capture, *shown) for b in c.bands)
    change = None
    if stated or light == "both":
        change = capture.irradiance / np.mean([c.irradiance for c in shown], axis=0)
    ratio = change if light == "both" and change is not None else np.ones(len(capture.bands))
    return line.relit(jnp.asarray(ratio), jnp.asarray(light_sd * ratio)), change


def _place_text(side: float | None, spread: float | None) -> str:
    if side is None:
        return "pixels of the camera"
    if spread is None:
        return "metres from the picture's corner"
    return (
        f"metres, by GPS, height and heading: the middle to some {spread:.1f} m (standard "
        "deviation), the direction to some 5 degrees; ground taken as level"
    )


def _ground(
    capture: Capture, height: float | None, pixel: float | None
) -> tuple[float | None, float | None]:
    """Side of a pixel on the ground, and the standard deviation of where the capture lies [m];
    `None` where they are not known."""
    place, focal = capture.bands[0].place, capture.bands[0].focal_length
    if height is None and pixel is None and place is not None and focal is not None:
        height = place.height
    if height is not None:
        if focal is None:
            raise InputError(
                "expected the focal length in the metadata (EXIF), but it has none. Give the size "
                "of a pixel instead: --pixel METRES",
                file=capture.bands[0].path,
            )
        pixel = height / focal
    if pixel is None or place is None:
        return pixel, None
    return pixel, place.spread(pixel * (focal or 0.0))


def _cubes(
    capture: Capture, aligned: AlignedCapture, line: EmpiricalLine, side: float | None
) -> tuple[Cube, Cube]:
    """Reflectance and its standard deviation; on Earth where place and pixel are known."""
    signal = jnp.moveaxis(jnp.asarray(aligned.radiance), 0, -1)
    values = np.moveaxis(np.asarray(line.reflectance(signal)), -1, 0)
    doubt = np.moveaxis(np.asarray(line.standard_deviation(signal)), -1, 0)

    def cube(data: NDArray[np.floating]) -> Cube:
        seen = Cube(
            np.where(aligned.full, np.nan, data),
            capture.names,
            np.array([band.wavelength for band in capture.bands]),
            np.array([band.fwhm for band in capture.bands]),
            np.ones(len(capture.bands), bool),
            side or 1.0,
            (0.0, 0.0),
        )
        place = capture.bands[0].place
        return seen if place is None or side is None else on_earth(seen, place, aligned.middle)

    return cube(values), cube(doubt)

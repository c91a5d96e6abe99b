"""The job of `fynjax fit-canopy`: pixels in, traits with intervals out."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import pandas as pd
import xarray as xr
from pydantic import Field

from fynjax._core.dry_run import begin_work
from fynjax._core.errors import InputError
from fynjax._core.precision import double_precision
from fynjax.app.io.instruments import load_sensor
from fynjax.app.io.raster import grid_coordinates, grid_mapping, write_geotiff
from fynjax.app.io.spectra import read_curve, write_spectra_netcdf
from fynjax.app.jobs._canopy_input import ANGLES, CanopyPixels, read_canopy_pixels
from fynjax.app.jobs._result import JobResult, Number, Record
from fynjax.app.jobs._run import Run
from fynjax.app.report import figures
from fynjax.app.report.pages import Picture, Table
from fynjax.inversion import CanopyFits, CanopyView, canopy_units, fit_canopies

_UNLIKE = 2.0
"""Misfit [errors] beyond which a pixel is unlike any such canopy."""
_MANY_VIEWS = 20
_KINDS = {"": "estimate", "_q05": "5 % quantile", "_q95": "95 % quantile"}


class TraitSummary(Record):
    """A trait over the pixels."""

    trait: str
    unit: str
    median: Number = Field(description="Over pixels.")
    typical_low: Number = Field(description="Median over pixels of the lower end of the interval.")
    typical_high: Number = Field(description="Median of the upper end.")
    constrained: Number = Field(description="Median share of the prior variance taken away [-].")


class FitPixelsResult(JobResult):
    """Result of `fit_pixels`."""

    command: Literal["fit-canopy"] = "fit-canopy"
    pixels: int
    without_data: int
    unlike: int = Field(description="Pixels whose misfit is beyond 2 errors.")
    traits: list[TraitSummary]


@double_precision
def fit_pixels(
    pixels: str | Path,
    output: str | Path,
    *,
    sun_zenith: Annotated[float, Field(ge=0, le=89)] | None = None,
    view_zenith: Annotated[float, Field(ge=0, le=89)] = 0.0,
    relative_azimuth: Annotated[float, Field(ge=-360, le=360)] = 0.0,
    sky_share: Annotated[float, Field(ge=0, le=1)] = 0.0,
    sensor: str | Path | None = None,
    known: Sequence[str] = (),
    soil: str | Path | None = None,
) -> FitPixelsResult:
    """Leaves, leaf area, leaf angle and soil of uniform canopies from pixels of any sensor.

    Each pixel is fitted by PROSPECT-D and the light of a canopy without gaps or clumps
    (`fx.fit_canopy`), with 90 % intervals.

    **Arguments:**

    - `pixels`: a table, a row a pixel (CSV, Excel), or an image (GeoTIFF, ENVI, NetCDF, zarr). Its
      bands are named as those of `sensor`, such as B2, B02, SR_B2 or blue, or by wavelengths.
    - `output`: folder of the results, made if missing.
    - `sun_zenith`: zenith angle of the sun [degrees]; a table may have a column of it.
    - `view_zenith`: that of the sensor [degrees]; a table may have a column of it.
    - `relative_azimuth`: azimuth of the sensor less that of the sun [degrees]; a table may have a
      column of it, or `sun_azimuth` and `view_azimuth`.
    - `sky_share`: diffuse over total irradiance [-].
    - `sensor`: shipped sensor (sentinel_2a, landsat_8, ...) or a sensor file; wavelengths if left
      out.
    - `known`: a value that is not to be fitted, such as leaf_angle=57.
    - `soil`: table of the soil's own spectrum, whose brightness alone is fitted then.

    **Returns:** `FitPixelsResult`. Writes of a table `traits.csv`: its other columns, each trait
    with its interval, misfit and status; of an image `traits.nc` and `traits.tif`, a map each. A
    picture and a page, too.

    **Raises:** `InputError` for pixels that cannot be read, bands and values that are none, and
    without a sun.

    Example: `jobs.fit_pixels("pixels.csv", "results", sensor="sentinel_2a", sun_zenith=35.0)`.
    """
    run = Run(output)
    instrument = None if sensor is None else load_sensor(sensor)
    taken = _known(known)
    read = read_canopy_pixels(pixels, instrument)
    centre = np.asarray(getattr(read.bands, "centre", read.bands), float)
    ground = None
    if soil is not None:
        ground = np.interp(centre, *read_curve(soil, "the soil"), left=np.nan, right=np.nan)
    stated: dict[str, float | None] = {
        "sun_zenith": sun_zenith,
        "view_zenith": view_zenith,
        "relative_azimuth": relative_azimuth,
    }
    views = _views(read, stated, sky_share)
    for view, rows in views:
        view.check(read.bands, read.reflectance[rows], soil=ground, known=taken)
    size = f"{len(read.reflectance)} pixels"
    begin_work(
        {"traits.csv": size, "report.html": ""}
        if read.shape is None
        else {"traits.nc": size, "traits.tif": size, "report.html": ""}
    )
    with run.stage("Fit pixels", "fit"):
        fits = _fitted(read, views, taken, ground)
    table = _traits(read, fits)
    inputs = [pixels, soil]
    if read.shape is None:
        what = "each pixel's own columns, traits with 90 % intervals, misfit and status"
        run.table("traits.csv", table, what)
    else:
        _write_maps(run, read, fits, inputs)
    return _result(run, read, fits, inputs)


def _known(given: Sequence[str]) -> dict[str, float]:
    """Values by name."""
    found: dict[str, float] = {}
    for one in given:
        name, _, number = one.partition("=")
        try:
            value = float(number)
        except ValueError:
            raise InputError(
                f"expected what is known as NAME=NUMBER, such as leaf_angle=57, but got {one!r}"
            ) from None
        if found.get(name.strip(), value) != value and name.strip() in found:
            raise InputError(f"expected one value of {name.strip()}, but two are given")
        found[name.strip()] = value
    return found


def _views(
    read: CanopyPixels, stated: dict[str, float | None], sky_share: float
) -> list[tuple[CanopyView, np.ndarray]]:
    """Angles of sun and view, to a degree where the table states them, and the places of the pixels
    that have these and reflectance in three bands or more."""
    own = pd.DataFrame(index=range(len(read.reflectance))) if read.angles is None else read.angles
    there = (read.reflectance >= 0.0) & (read.reflectance <= 1.0)
    filled = there.sum(axis=1) >= 3
    if not filled.any():
        raise InputError("expected pixels with reflectance in at least three bands, but none has")
    sun = np.atleast_1d(own["sun_zenith"] if "sun_zenith" in own else stated["sun_zenith"] or 0.0)
    if 0.0 < (most := np.nanmax(sun, initial=0.0)) <= 0.5 * np.pi and most % 1.0 != 0.0:
        raise InputError(f"expected `sun_zenith` in degrees, but {most:g} looks like radians")
    columns = [own[name].round() if name in own else stated[name] for name in ANGLES]
    if columns[0] is None:
        raise InputError(
            "expected the zenith angle of the sun, `sun_zenith` [degrees], or a column of a table "
            "with it, but there is neither"
        )
    angles = pd.DataFrame(dict(zip(ANGLES, columns)), index=own.index).astype(float)
    # Left and right of the sun are alike, and straight down there is neither.
    azimuth = ((angles["relative_azimuth"] + 180.0) % 360.0 - 180.0).abs()
    angles["relative_azimuth"] = azimuth.where(angles["view_zenith"] != 0.0, 0.0)
    missing = ~np.isfinite(angles.to_numpy()).all(axis=1) & filled
    if missing.any():
        row = int(np.argmax(missing))
        raise InputError(f"expected finite angles of every pixel, but row {row + 2} has none")
    places = np.flatnonzero(filled)
    groups: Any = angles[filled].groupby(list(ANGLES)).indices
    if len(groups) > _MANY_VIEWS:
        raise InputError(
            f"expected at most {_MANY_VIEWS} ways in which pixels are lit and seen, to a degree, "
            f"for each takes some 20 s, but there are {len(groups)}. Round them, or split the table"
        )
    return [
        (CanopyView(angle[0], angle[1], angle[2], sky_share), places[rows])
        for angle, rows in groups.items()
    ]


def _fitted(
    read: CanopyPixels,
    views: list[tuple[CanopyView, np.ndarray]],
    known: dict[str, float],
    soil: np.ndarray | None,
) -> CanopyFits:
    """The fits of all views, in the order of the pixels; NaN of pixels in none."""
    parts = [
        fit_canopies(read.bands, read.reflectance[rows], view, soil=soil, known=known)
        for view, rows in views
    ]
    order = np.concatenate([rows for _, rows in views])
    joined = []
    for name in ("estimate", "lower", "upper", "constrained", "converged", "misfit"):
        found = np.concatenate([getattr(part, name) for part in parts])
        missing = False if found.dtype == bool else np.nan
        whole = np.full((len(read.reflectance), *found.shape[1:]), missing)
        whole[order] = found
        joined.append(whole)
    return CanopyFits(parts[0].names, *joined)


def _status(read: CanopyPixels, fits: CanopyFits) -> np.ndarray:
    status = np.where(fits.misfit > _UNLIKE, "unlike any such canopy", "ok").astype(object)
    status[~fits.converged] = "did not converge"
    there = (read.reflectance >= 0.0) & (read.reflectance <= 1.0)
    status[there.sum(axis=1) < 3] = "fewer than three bands"
    return status


def _traits(read: CanopyPixels, fits: CanopyFits) -> pd.DataFrame:
    columns: dict[str, Any] = {}
    for i, name in enumerate(fits.names):
        for kind, of in zip(_KINDS, (fits.estimate, fits.lower, fits.upper)):
            columns[f"{name}{kind}"] = of[:, i]
    columns |= {"misfit": fits.misfit, "status": _status(read, fits)}
    table = pd.DataFrame(columns)
    notes = [one for one in (read.notes, read.angles) if one is not None]
    notes = [one.rename(columns=lambda n: f"{n}_given" if n in columns else n) for one in notes]
    return pd.concat([*notes, table], axis=1)


def _write_maps(
    run: Run, read: CanopyPixels, fits: CanopyFits, inputs: Sequence[str | Path | None]
) -> None:
    """Maps of an image, as NetCDF and GeoTIFF."""
    assert read.shape is not None
    units, shape = canopy_units(), read.shape
    dims, coordinates = grid_coordinates(read.transform, read.crs, shape, shape[0])
    maps, words = {}, {}
    for i, name in enumerate(fits.names):
        for kind, of in zip(_KINDS, (fits.estimate, fits.lower, fits.upper)):
            maps[f"{name}{kind}"] = of[:, i].reshape(shape).astype(np.float32)
            words[f"{name}{kind}"] = units[name], f"{_KINDS[kind]} of {name.replace('_', ' ')}"
    maps["misfit"] = fits.misfit.reshape(shape).astype(np.float32)
    words["misfit"] = "1", "root mean square of what is left, in errors"
    record = run.record(inputs)
    mapping = {} if read.crs is None else {"crs": grid_mapping(read.crs)}
    on = {} if read.crs is None else {"grid_mapping": "crs"}
    variables = {
        name: (dims, values, {"units": words[name][0], "long_name": words[name][1], **on})
        for name, values in maps.items()
    }
    data = xr.Dataset(variables | mapping, coordinates, record)
    what = "maps of traits with their intervals, a variable each, for xarray"
    write_spectra_netcdf(data, run.path("traits.nc", what))
    write_geotiff(
        run.path("traits.tif", "the same, a band each, for a GIS"),
        np.stack([values[::-1] for values in maps.values()]), list(maps),
        transform=read.transform, crs=read.crs, tags=record,
    )  # fmt: skip


def _result(
    run: Run, read: CanopyPixels, fits: CanopyFits, inputs: Sequence[str | Path | None]
) -> FitPixelsResult:
    units = canopy_units()
    rows = [
        TraitSummary(
            trait=name, unit=units[name],
            median=np.nanmedian(fits.estimate[:, i]),
            typical_low=np.nanmedian(fits.lower[:, i]),
            typical_high=np.nanmedian(fits.upper[:, i]),
            constrained=np.nanmedian(fits.constrained[:, i]),
        )
        for i, name in enumerate(fits.names)
    ]  # fmt: skip
    empty = int(np.isnan(fits.misfit).sum())
    unlike = int((fits.misfit > _UNLIKE).sum())
    count = len(fits.misfit)
    constrained = [row.trait for row in rows if (row.constrained or 0.0) >= 0.5]
    main = {row.trait: row for row in rows}
    area = main.get("leaf_area_index") or rows[0]
    low, middle, high = (
        f"{n:.3g}" for n in (area.typical_low, area.median, area.typical_high) if n is not None
    )
    headline = [
        f"{count - empty} of {count} pixels fitted: median {area.trait.replace('_', ' ')} {middle} "
        f"{area.unit}, typically from {low} to {high}.",
        f"The bands constrain {', '.join(constrained).replace('_', ' ') or 'none of the traits'}; "
        f"other traits are nearly those of the prior. {unlike} pixels are unlike any such canopy.",
        "Next: look at the interval of each trait before you compare pixels"
        f"{', and state what you know (--known leaf_angle=57)' * ('leaf_angle' in main)}.",
        *read.said,
    ]
    table = pd.DataFrame([row.model_dump() for row in rows])
    shown: list[Any] = [Table(table, "Traits: medians over pixels, with the typical interval.")]
    if read.shape is not None:
        shapes = [name for name in constrained if name.startswith("soil_shape")]
        at = [i for i, n in enumerate(fits.names) if n in constrained and n not in shapes] or [0]
        maps = {
            fits.names[i]: (
                fits.estimate[:, i].reshape(read.shape),
                ((fits.upper - fits.lower)[:, i] / 3.29).reshape(read.shape),
                fits.names[i].replace("_", " "),
                units[fits.names[i]],
            )
            for i in at
        }
        misfit = fits.misfit.reshape(read.shape) / _UNLIKE
        words = f"misfit over {_UNLIKE:g} errors"
        shown.insert(0, Picture("traits.png", figures.maps_figure(maps, misfit, words), "maps"))
    run.pictures("fit-canopy", "Traits of canopies", headline, shown, inputs)
    return run.result(
        FitPixelsResult, headline=headline, pixels=count, without_data=empty, unlike=unlike,
        traits=rows, converged=bool(fits.converged[~np.isnan(fits.misfit)].all()),
    )  # fmt: skip

"""The job of `fynjax pattern`: from an image to a probability map of where plants stand."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field

from fynjax._core.arguments import Names, Seed
from fynjax._core.dry_run import begin_work
from fynjax._core.errors import InputError, in_file
from fynjax._core.precision import double_precision
from fynjax.app.io.raster import RAW_COUNTS, BandStack, read_band_stack, write_geotiff
from fynjax.app.jobs._doubt import doubt_spectrum
from fynjax.app.jobs._result import JobResult, Record
from fynjax.app.jobs._run import Run, paths_of
from fynjax.app.report import figures
from fynjax.app.report.pages import Picture
from fynjax.canopy import Greenness, VegetationPattern, choose_greenness, vegetation_pattern
from fynjax.sensors import BandSet, mavic_3m

_NEAR_INFRARED = 750.0  # nm
_WIDTH = 30.0  # of a band of which the file does not state it [nm]


class MapSummary(Record):
    """Where the map lies."""

    bounds_m: tuple[float, float, float, float]
    """West, south, east and north edge of the map [m]."""
    pixel_m: tuple[float, float]
    crs: str | None
    masked_pixels: int
    nodata: int | None


class BandSummary(Record):
    """A band of the image."""

    name: str
    wavelength_nm: float | None


class GreennessSummary(Record):
    """What orders the clusters."""

    name: str
    formula: str
    weight: float


class ClusterSummary(Record):
    """A cluster of pixels."""

    level: int
    share: float
    greenness: float
    mean_spectrum: list[float]
    standard_deviation: list[float]


class AlignmentSummary(Record):
    """How a band was moved onto the first."""

    shift_px: tuple[float, float]
    residual_px: float
    match: float


class PatternResult(JobResult):
    """Result of `pattern`: position of the map, and the clusters."""

    command: Literal["pattern"] = "pattern"
    map: MapSummary
    bands: list[BandSummary]
    greenness: GreennessSummary
    clusters: list[ClusterSummary]
    inertia: float
    alignment: list[AlignmentSummary] | None


@double_precision
def pattern(
    paths: str | Path | Sequence[str | Path],
    output: str | Path,
    *,
    clusters: Annotated[int, Field(ge=2, le=255)] = 3,
    bands: Names | None = None,
    greenness: str = "auto",
    greenness_weight: Annotated[float, Field(ge=0.0)] = 1.0,
    levels: Sequence[int] | None = None,
    pixel: float | None = None,
    align: bool = True,
    seed: Seed = 0,
) -> PatternResult:
    """Make a probability map from an image: where plants are likely to stand.

    Pixels are clustered by K-means and the clusters ordered by greenness. The map is for
    `probability_map` of a plot file.

    **Arguments:**

    - `paths`: image of several bands (GeoTIFF), or the single-band files of one capture in order.
    - `output`: folder of the results, made if missing.
    - `clusters`: number of clusters.
    - `bands`: names of the bands or their wavelengths [nm], in the order of the files, with commas
      between, where files lack them.
    - `greenness`: what orders the clusters: auto, ndvi, excess_green, or a band that is brighter
      where plants are (-BAND: darker); see `choose_greenness`.
    - `greenness_weight`: how much greenness counts in clustering; 0: the bands alone.
    - `levels`: grey of each cluster, 0 to 255, least green first, such as 0,128,255; evenly up to
      255 if left out. 0 keeps a cluster free of plants.
    - `pixel`: side of a pixel [m], for an image without a place.
    - `align`: align the bands of a capture's files.
    - `seed`: seed of everything random.

    **Returns:** `PatternResult`. Writes `map.tif`, a picture and a page into `output`.

    **Raises:** `InputError` for raw captures of a camera, and as `read_band_stack`,
    `choose_greenness` and `vegetation_pattern`.

    Example: `jobs.pattern(["drone.tif"], "results", clusters=4)`.
    """
    run, paths = Run(output, seed=seed), paths_of(paths)
    with run.stage("Read the image"):
        stack = read_band_stack(paths, bands=bands, pixel_m=pixel, align=align)
    if stack.raw:
        raise InputError(RAW_COUNTS, file=paths[0])
    with in_file(paths[0]):
        green = choose_greenness(stack.names, stack.wavelengths, index=greenness)
        _doubt(run, stack)
        with run.stage("Cluster the pixels"):
            pattern = vegetation_pattern(
                stack.values,
                green,
                mask=stack.mask,
                clusters=clusters,
                levels=levels,
                greenness_weight=greenness_weight,
                seed=seed,
            )
    rows, columns = stack.mask.shape
    begin_work({"map.tif": f"{rows} rows and {columns} columns of pixels", "report.html": ""})
    masked = int((~stack.mask).sum())
    with run.stage("Write"):
        write_geotiff(
            run.path("map.tif", "probability map, 0 to 255, for `probability_map` of a plot file"),
            pattern.grey[None],
            ["probability"],
            transform=stack.transform,
            crs=stack.crs,
            nodata=pattern.nodata if masked else None,
            tags={
                "quantity": "chance of a plant to stand here, 255 is 1",
                "clusters": clusters,
                "greenness": green.formula,
                "greenness_weight": greenness_weight,
                "levels": list(pattern.levels),
                "seed": seed,
            },
        )
        headline = _headline(stack, pattern, green)
        what = "the image, the map and the clusters' spectra"
        picture = Picture("pattern.png", figures.pattern_figure(stack, pattern, green), what)
        title = f"Probability map of {Path(paths[0]).name}"
        run.pictures("pattern", title, headline, [picture], paths)
    return _result(run, headline, stack, pattern, green, greenness_weight)


def _doubt(run: Run, stack: BandStack) -> None:
    """Say where an image of reflectance with near infrared is none of shrubland."""
    usual = {"blue": 475.0} | dict(zip(mavic_3m().names, mavic_3m().centre, strict=True))
    known = {
        name: (wave or usual[name], float(values[stack.mask].mean()))
        for name, wave, values in zip(stack.names, stack.wavelengths, stack.values, strict=True)
        if wave is not None or name in usual
    }
    centres, means = zip(*known.values(), strict=True) if known else ((0.0,), (0.0,))
    # Counts, and pictures of colours alone, are clustered as well as reflectance.
    if max(centres) > _NEAR_INFRARED and max(means) <= 1.0:
        doubt_spectrum(run, means, BandSet(tuple(known), centres, (_WIDTH,) * len(known)))


def _headline(stack: BandStack, pattern: VegetationPattern, green: Greenness) -> list[str]:
    rows, columns = stack.mask.shape
    t = stack.transform
    masked = int((~stack.mask).sum())
    clusters = "; ".join(
        f"{100 * share:.0f} % at {level} ({green.name} {value:.3g})"
        for share, level, value in zip(
            pattern.share, pattern.levels, pattern.greenness, strict=True
        )
    )
    headline = [
        f"{columns * t.a:g} m x {rows * -t.e:g} m in pixels of {t.a:g} m, "
        f"{len(stack.names)} bands: {stack.known_as}.",
        f"Clusters by {green.name} = {green.formula}: {clusters}.",
    ]
    if masked:
        headline.append(
            f"{masked} of {stack.mask.size} pixels have no data; a plot must not reach them."
        )
    if stack.alignment is not None:
        worst = max(band.residual for band in stack.alignment)
        headline.append(
            f"Bands aligned on the first; tiles still miss it by {worst:.1f} pixels at most, in "
            "the median of a band."
        )
    return headline


def _result(
    run: Run,
    headline: list[str],
    stack: BandStack,
    pattern: VegetationPattern,
    green: Greenness,
    weight: float,
) -> PatternResult:
    rows, columns = stack.mask.shape
    t = stack.transform
    masked = int((~stack.mask).sum())
    return run.result(
        PatternResult,
        headline=headline,
        map=MapSummary(
            bounds_m=(t.c, t.f + rows * t.e, t.c + columns * t.a, t.f),
            pixel_m=(t.a, -t.e),
            crs=stack.crs,
            masked_pixels=masked,
            nodata=pattern.nodata if masked else None,
        ),
        bands=[
            BandSummary(name=name, wavelength_nm=wave)
            for name, wave in zip(stack.names, stack.wavelengths, strict=True)
        ],
        greenness=GreennessSummary(name=green.name, formula=green.formula, weight=weight),
        clusters=[
            ClusterSummary(
                level=level,
                share=pattern.share[k],
                greenness=pattern.greenness[k],
                mean_spectrum=pattern.spectrum[k].tolist(),
                standard_deviation=pattern.spread[k].tolist(),
            )
            for k, level in enumerate(pattern.levels)
        ],
        inertia=pattern.inertia,
        alignment=None
        if stack.alignment is None
        else [
            AlignmentSummary(shift_px=band.shift, residual_px=band.residual, match=band.match)
            for band in stack.alignment
        ],
    )

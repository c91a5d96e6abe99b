"""The job of `fynjax map`: from a cube to maps with uncertainty."""

import json
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple

import jax.numpy as jnp
import numpy as np
import pandas as pd
from jaxtyping import Float
from pydantic import Field

from fynjax._core.arguments import Seed
from fynjax._core.checkpoint import forget_journal, signature
from fynjax._core.dry_run import begin_work, image_size
from fynjax._core.errors import InputError, in_file, listed
from fynjax._core.parts import Workers, at_work
from fynjax._core.precision import double_precision
from fynjax.app.assembly import STAND_QUANTITIES
from fynjax.app.compare import check_shrubland
from fynjax.app.io.plot import DEFAULT_PRIOR
from fynjax.app.io.raster import CubeBlocks, MapWriter, content_hash, file_hash, open_blocks
from fynjax.app.jobs._doubt import doubt_spectrum
from fynjax.app.jobs._map_pixels import (
    ChosenPixels,
    PixelPosterior,
    has_data,
    pick_pixels,
    pixel_journal,
    pixel_posteriors,
    prior_of,
)
from fynjax.app.jobs._result import JobResult, Number, Record
from fynjax.app.jobs._run import Run
from fynjax.app.jobs._train import SCORES, Training, read_training
from fynjax.app.report import figures
from fynjax.app.report.pages import Page, Picture, Section, Table
from fynjax.inversion import estimate_pixels
from fynjax.sensors import BandSet

_AT_ONCE = 8192
"""Pixels that are estimated at once."""
_SHOWN = 800
"""Pixels of a picture's longer side."""
_FEWEST_STEPS = 12
"""Least steps of a walker of a pixel's posterior."""
UNLIKENESS = "unlikeness"
_KINDS = {
    "": "{}",
    "_sd": "standard deviation of {}",
    "_q05": "5 % quantile of {}",
    "_q95": "95 % quantile of {}",
}
"""Endings of the names of a quantity's maps, and what they are, in words."""


class _Mask(NamedTuple):
    """Pixels less like the simulations than the share `likely` of these are masked, or kept."""

    likely: float
    keep_unlike: bool


class QuantityMap(Record):
    """A map, over the pixels that are not masked."""

    quantity: str
    unit: str
    mean: Number
    q05: Number = Field(description="5 % quantile over pixels.")
    q95: Number
    typical_sd: Number = Field(description="Median of the standard deviation of a pixel.")


class MapResult(JobResult):
    """Result of `map`."""

    command: Literal["map"] = "map"
    pixels: int = Field(description="Number of pixels of the cube.")
    without_data: int
    masked: int = Field(description="Pixels with data that are unlike the simulations.")
    unlike_beyond: float = Field(description="Share of simulations that are less unlike [-].")
    damaged_rows: list[tuple[int, int]] = Field(
        [], description="First and last row of the blocks that could not be read."
    )
    place: str = Field(description="How the maps lie on the earth.")
    maps: list[QuantityMap]
    posteriors: list[PixelPosterior] = Field(
        [], description="Full posteriors of the pixels asked for."
    )


@double_precision
def map_cube(
    cube: str | Path,
    training: str | Path,
    output: str | Path,
    *,
    likely: float = 0.99,
    keep_unlike: bool = False,
    skip_damaged: bool = False,
    zarr: bool = False,
    pixels: Sequence[tuple[int, int]] = (),
    pixel_steps: Annotated[int, Field(ge=12)] = 400,
    prior: str | Path = DEFAULT_PRIOR,
    seed: Seed = 0,
    checkpoint: str | Path,
    workers: Workers | None = None,
) -> MapResult:
    """Map covers, leaf area and leaf traits of a cube, each with its uncertainty.

    The cube is read block by block. Of pixels that are asked for, the full posterior stands beside
    it.

    **Arguments:**

    - `cube`: surface reflectance: ENVI, GeoTIFF, NetCDF or zarr, of any size.
    - `training`: file of `fynjax train`, for this sensor and about this sun.
    - `output`: folder of the results, made if missing.
    - `likely`: pixels less like the simulations than this share of these are masked [-].
    - `keep_unlike`: do not mask them; the map of it stays.
    - `skip_damaged`: leave rows that cannot be read without data, instead of an error.
    - `zarr`: write `maps.zarr` as well, a variable each.
    - `pixels`: sample the full posterior of this pixel by emcee as well, row and column counted
      from 1 at the upper left of the cube, such as 12,40; some 13 minutes of a core for 400 steps.
    - `pixel_steps`: steps of each of its 16 walkers.
    - `prior`: population that the training was made with, by name or file, for `pixels`.
    - `seed`: seed of the sampling.
    - `checkpoint`: folder of the unfinished maps, from which an interrupted run goes on.
    - `workers`: where blocks are read and estimated; in this process by default.

    **Returns:** `MapResult`. Writes `maps.tif` (cloud-optimised: of each quantity mean, standard
    deviation and 5 and 95 % quantile, and how unlike the simulations pixels are), a picture and a
    page into `output`; of `pixels` the table `pixels.csv` and the draws `pixels.nc`.

    Maps of a swath with a lookup table, as EMIT's, lie on the grid of that table, each pixel the
    nearest of the swath. Of a cube without a place they have rows and columns only, with a warning.

    **Raises:** `InputError` for a cube or training that cannot be read or do not go together, and
    for a damaged lookup table.
    """
    run = Run(output, seed=seed)
    if not 0.5 <= likely < 0.9995:
        raise InputError(f"expected a share of the simulations from 0.5 to 0.999, but got {likely}")
    if pixel_steps < _FEWEST_STEPS:
        raise InputError(
            f"expected {_FEWEST_STEPS} steps or more of a pixel, but got {pixel_steps}"
        )
    trained = read_training(training)
    with open_blocks(cube) as source:
        weights = _weights(source, trained)  # errors before any work
        scale = source.scale()
        used = weights.any(axis=0)
        seen = source.sample()[:, used]
        seen = seen[np.isfinite(seen).all(axis=1)]
        if len(seen):
            mean = weights[:, used] @ seen.mean(axis=0) / scale
            _check_divisor(source, scale, mean, trained.responses)
            doubt_spectrum(run, mean, trained.responses)
        chosen = None
        if pixels:
            learned = prior_of(trained, prior)
            places = list(dict.fromkeys(pixels))
            channels = pick_pixels(source, weights, scale, places)
            chosen = ChosenPixels(places, channels, learned, pixel_steps, seed)
        size = image_size(source.shape, 4 * len(STAND_QUANTITIES) + 1)
        begin_work(
            {"maps.tif": size, "report.html": ""}
            | ({"maps.zarr": size} if zarr else {})
            | ({} if chosen is None else {"pixels.csv": f"{len(places)} pixels", "pixels.nc": ""})
        )
        kept = Path(checkpoint) / "pixels"
        # Before the maps: the folder may be of other pixels.
        journal = None if chosen is None else pixel_journal(run, kept, trained, chosen)
        mask = _Mask(likely, keep_unlike)
        writer = _writer(Path(checkpoint), source, training, mask)
        shared = str(source.path), trained, scale, mask, skip_damaged
        damaged = _map_rows(run, source, writer, workers, shared)
        step = max(1, -(-max(source.shape) // _SHOWN))
        picture = writer.read(step)
        of_training = {k: str(v) for k, v in trained.record.items() if k != "scores"}
        record: dict[str, Any] = {
            **run.record([training]),
            "cube": source.path.name,
            "training": json.dumps(of_training),
            "masked_beyond": "nothing" if keep_unlike else likely,
            "place": _place(source),
        }
        with run.stage("Write"):
            writer.finish(run.path("maps.tif", "all maps, a band each, cloud-optimised"), record)
            if zarr:
                words = {
                    f"{name}{kind}": of_kind.format(quantity.words)
                    for name, quantity in STAND_QUANTITIES.items()
                    for kind, of_kind in _KINDS.items()
                }
                words[UNLIKENESS] = "distance from the simulations over that of most of them"
                path = run.path("maps.zarr", "all maps, a variable each, for xarray")
                writer.finish_zarr(path, record, words)
        posteriors: list[PixelPosterior] = []
        sections: list[Section] = []
        if chosen is not None:
            with at_work(workers) as pool:
                posteriors, sections = pixel_posteriors(
                    run, pool, trained, chosen, likely=likely, journal=journal, record=record
                )
    if "scores" in trained.record:
        scores = pd.DataFrame(json.loads(trained.record["scores"]))
        sections.append(Section("The training", [Table(scores, SCORES)]))
    result = _summary(run, source, picture, damaged, mask, record, posteriors, sections)
    forget_journal(kept)
    writer.forget()
    return result


def _map_rows(
    run: Run,
    source: CubeBlocks,
    writer: MapWriter,
    workers: Workers | None,
    shared: tuple[str, Training, float, _Mask, bool],
) -> list[tuple[int, int]]:
    """Map the blocks of rows that are not there yet; `shared` are the arguments of `_mapped`.

    Returns first and last row, counted from 1, of the blocks that could not be read.
    """
    rows, count = source.rows_at_once, source.shape[0]
    left = [i for i, done in enumerate(writer.done) if not done]
    parts = [(i * rows, min(rows, count - i * rows)) for i in left]
    with run.stage("Map", "maps", total=len(parts)), at_work(workers) as pool:
        done = pool.each(
            _mapped, parts, *shared,
            names=[f"rows {start + 1} to {start + n}" for start, n in parts],
        )  # fmt: skip
        for i, (maps, unreadable) in done:
            writer.write(left[i], parts[i][0], np.asarray(maps), damaged=bool(unreadable))
    return [(i * rows + 1, min((i + 1) * rows, count)) for i in sorted(writer.damaged)]


def _writer(checkpoint: Path, source: CubeBlocks, training: str | Path, mask: _Mask) -> MapWriter:
    """The maps that the folder `checkpoint` keeps, of this run alone."""
    rows = source.rows_at_once
    settings = ([content_hash(path) for path in source.files], *mask, rows)
    signed = signature(settings, [file_hash(training)])
    bands = [
        (f"{name}{kind}", quantity.unit)
        for name, quantity in STAND_QUANTITIES.items()
        for kind in _KINDS
    ]
    blocks = len(range(0, source.shape[0], rows))
    writer = MapWriter(checkpoint, signed, [*bands, (UNLIKENESS, "1")], source, blocks)
    if source.location is None and source.transform.is_identity:
        warnings.warn(
            f"{source.path} says no place on the earth: its maps have rows and columns only",
            stacklevel=3,
        )
    return writer


def _place(source: CubeBlocks) -> str:
    if source.location is not None:
        return "grid of the cube's own lookup table, each pixel the nearest of the swath"
    return "rows and columns only" if source.transform.is_identity else "grid of the cube"


def _check_divisor(source: CubeBlocks, scale: float, mean: np.ndarray, bands: BandSet) -> None:
    """Refuse integers that look like ten thousandths and are shrubland only if divided by more."""
    if scale == 1.0:
        return
    try:
        taken, other = (check_shrubland(mean * part, bands) for part in (1.0, scale / 32768.0))
    except InputError:  # too few bands to judge
        return
    if taken.unlike and not other.unlike:
        raise InputError(
            "expected reflectance in ten thousandths, as its numbers look, but shrubland has such "
            "bands only if 32768 is a reflectance of 1, as Metashape and MicaSense write it. Then "
            f"state it: gdal_edit.py -scale {1 / 32768:.6g} {source.path.name}",
            file=source.path,
        )


def _weights(source: CubeBlocks, trained: Training) -> Float[np.ndarray, "channel band"]:
    """Weights that make channels of the cube's bands."""
    wavelength = source.wavelength
    if np.isnan(wavelength).all():
        raise InputError(
            "expected a cube that states the wavelengths of its bands, but this one does not. "
            "Write them into its header",
            file=source.path,
        )
    with in_file(source.path):
        return trained.channels.weights(wavelength, source.good)


def _mapped(
    part: tuple[int, int],
    path: str,
    trained: Training,
    scale: float,
    mask: _Mask,
    skip_damaged: bool,
) -> tuple[np.ndarray, ...]:
    """Maps of a block of rows, and whether it could not be read."""
    start, count = part
    with open_blocks(path) as source:
        weights = _weights(source, trained)
        unreadable = False
        try:
            values = source.read(start, count)
        except InputError as error:
            if not skip_damaged:
                raise InputError(
                    f"{error} With --skip-damaged such rows are left without data."
                ) from error
            unreadable = True
            shape = (count, source.shape[1], len(source.wavelength))
            values = np.full(shape, np.nan, np.float32)
    rows, columns, bands = values.shape
    used = weights.any(axis=0)
    pixels = values.reshape(-1, bands)[:, used]
    channels = pixels @ (weights[:, used].T / scale).astype(np.float32)
    place = np.flatnonzero(has_data(channels))
    count = len(STAND_QUANTITIES)
    maps = np.full((len(pixels), count * len(_KINDS) + 1), np.nan, np.float32)
    for start in range(0, len(place), _AT_ONCE):
        some = place[start : start + _AT_ONCE]
        padded = np.zeros((_AT_ONCE, channels.shape[1]), np.float32)
        padded[: len(some)] = channels[some]
        found = estimate_pixels(trained.posterior, jnp.asarray(padded), mask.likely)
        parts = (found.mean, found.sd, found.lower, found.upper)
        each = np.stack([np.asarray(p)[: len(some)] for p in parts], axis=2)
        unlike = np.asarray(found.unlikeness)[: len(some)]
        if not mask.keep_unlike:
            each[unlike > 1.0] = np.nan
        maps[some, :-1] = each.reshape(len(some), -1)
        maps[some, -1] = unlike
    block = np.ascontiguousarray(maps.T).reshape(-1, rows, columns)
    return block, np.asarray(unreadable)


def _in_numbers(
    name: str, mean: Float[np.ndarray, "row column"], sd: Float[np.ndarray, "row column"]
) -> QuantityMap:
    """Statistics of the map of a quantity and of its standard deviation, over pixels with data."""
    ok = np.isfinite(mean)
    numbers = [np.nan] * 4
    if ok.any():
        numbers = [mean[ok].mean(), *np.quantile(mean[ok], [0.05, 0.95]), np.median(sd[ok])]
    of_map = dict(zip(("mean", "q05", "q95", "typical_sd"), map(float, numbers), strict=True))
    return QuantityMap(quantity=name, unit=STAND_QUANTITIES[name].unit, **of_map)


def _summary(
    run: Run,
    source: CubeBlocks,
    picture: Float[np.ndarray, "map row column"],
    damaged: list[tuple[int, int]],
    mask: _Mask,
    record: dict[str, Any],
    posteriors: list[PixelPosterior],
    sections: list[Section],
) -> MapResult:
    """Count the pixels, on a `picture` of the maps, and write the page; `sections` stand on it."""
    unlike = picture[-1]
    with_data = np.isfinite(unlike)
    pixels = source.shape[0] * source.shape[1]
    share = pixels / unlike.size  # of a large cube a sample of the pixels is counted
    lacking = round(share * float((~with_data).sum()))
    out = round(share * float((with_data & (unlike > 1.0)).sum()))
    shown = {
        name: (picture[i * len(_KINDS)], picture[i * len(_KINDS) + 1])
        for i, name in enumerate(STAND_QUANTITIES)
    }
    found = [_in_numbers(name, *maps) for name, maps in shown.items()]
    if damaged:
        warnings.warn(
            f"{source.path}: rows {', '.join(f'{a} to {b}' for a, b in damaged)} could not be read "
            "and are without data",
            stacklevel=2,
        )
    headline = _headline(source, pixels, lacking, out, mask)
    mostly_unlike = out > 0.5 * max(pixels - lacking, 1)
    status = "most pixels are unlike the simulations" if mostly_unlike else "ok"
    short = [f"row {one.row}, column {one.column}" for one in posteriors if not one.converged]
    if short:
        status = "the posterior of a pixel did not converge"
        headline.insert(0, f"Not converged: the posterior of {listed(short)}.")
    numbers = Table(
        pd.DataFrame([one.model_dump() for one in found]), "Over the pixels that are not masked."
    )
    words = [f"{q.words}: {q.description}" for q in STAND_QUANTITIES.values()]
    what = "maps, their standard deviations, and how unlike the simulations pixels are"
    if source.location is not None:
        what += "; rows and columns are the swath's, north is not up"
    drawn = {n: (*shown[n], q.words, q.unit) for n, q in STAND_QUANTITIES.items()}
    figure = figures.maps_figure(drawn, unlike, f"unlikeness (1: {100 * mask.likely:g} %)")
    sections = [
        Section("Maps", [Picture("maps.png", figure, what)]),
        *sections,
        Section("In numbers", [numbers, *words]),
    ]
    run.page(Page("map", f"Maps of {source.path.name}", headline[0], sections, record=record))
    return run.result(
        MapResult,
        headline=headline,
        status=status,
        converged=not short if posteriors else None,
        pixels=pixels,
        without_data=lacking,
        masked=out,
        unlike_beyond=mask.likely,
        damaged_rows=damaged,
        place=record["place"],
        maps=found,
        posteriors=posteriors,
    )


def _headline(source: CubeBlocks, pixels: int, lacking: int, out: int, mask: _Mask) -> list[str]:
    """The maps in sentences: `lacking` of the pixels have no data, `out` are masked."""
    valid = max(pixels - lacking, 1)
    headline = [
        f"{pixels} pixels, {lacking} without data; {out} ({100 * out / valid:.0f} % of the others) "
        f"are less like the simulations than {100 * mask.likely:g} % of these, and "
        + ("kept." if mask.keep_unlike else "masked.")
    ]
    if source.location is not None:
        headline.append(
            "The files of maps lie on the cube's own grid on the earth, each pixel that of the "
            "swath which its lookup table names. Pixels are counted, and pictures drawn, on the "
            "swath."
        )
    if out > 0.5 * valid:
        headline.append(
            "Most pixels are unlike what the training knows: other vegetation, another sun, other "
            "units, or clouds. Do not read the rest as if it were this vegetation."
        )
    return headline

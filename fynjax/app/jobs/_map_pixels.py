"""Full posteriors of some pixels of a map, for `fynjax map --pixel`."""

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
import pandas as pd
import xarray as xr
from jaxtyping import Bool, Float
from pydantic import Field

from fynjax._core.checkpoint import Journal
from fynjax._core.errors import InputError
from fynjax._core.parts import Pool
from fynjax._core.sampling import effective_size
from fynjax.app.assembly import STAND_QUANTITIES, StandSettings, sample_pixel
from fynjax.app.io.plot import LearnedPrior, read_prior
from fynjax.app.io.raster import CubeBlocks, file_hash, write_run
from fynjax.app.jobs._result import Number, Record
from fynjax.app.jobs._run import Run
from fynjax.app.jobs._train import Training
from fynjax.app.report import figures
from fynjax.app.report.pages import Picture, Section, Table
from fynjax.inversion import PixelEstimates, estimate_pixels
from fynjax.sensors import BandSet

_ENSEMBLES = 2
"""Independent ensembles of a pixel."""
_BURN_IN = 0.3
"""Share of the steps that is taken to depend on the start."""
_FEWEST = 32.0
"""Effective draws of the slowest quantity of a posterior that counts as converged: a mean is then
certain to a sixth of its standard deviation. Walkers that never mix have 16 or less."""


class PixelQuantity(Record):
    """A quantity of a pixel, by the regression of the map and by its full posterior."""

    quantity: str
    unit: str
    map_mean: Number
    map_sd: Number
    map_q05: Number
    map_q95: Number
    mean: Number
    sd: Number
    q05: Number
    median: Number
    q95: Number


class PixelPosterior(Record):
    """The full posterior of a pixel."""

    row: int
    column: int
    unlikeness: Number = Field(
        description="Distance of the spectrum from the simulations; above 1 the map is masked."
    )
    effective_size: Number = Field(description="Effective draws of the slowest quantity.")
    acceptance: Number
    converged: bool
    quantities: list[PixelQuantity]


def has_data(channels: Float[np.ndarray, "*pixel channel"]) -> Bool[np.ndarray, "*pixel"]:
    """Whether pixels have reflectance that a surface may have in all channels."""
    with np.errstate(invalid="ignore"):
        possible = np.isfinite(channels) & (channels > -0.05) & (channels < 2.5)
    return np.asarray(possible.all(axis=-1))


def pick_pixels(
    source: CubeBlocks,
    weights: Float[np.ndarray, "channel band"],
    scale: float,
    pixels: Sequence[tuple[int, int]],
) -> Float[np.ndarray, "pixel channel"]:
    """Channels of some pixels of a cube.

    **Arguments:** `weights` make channels of its bands, `scale` makes reflectance; `pixels` are row
    and column, counted from 1 at the upper left.

    **Raises:** `InputError` for a pixel outside, or without data.
    """
    rows, columns = source.shape
    found = []
    for row, column in pixels:
        if not (1 <= row <= rows and 1 <= column <= columns):
            raise InputError(
                f"expected pixels of rows 1 to {rows} and columns 1 to {columns}, but got row "
                f"{row}, column {column}",
                file=source.path,
            )
        values = source.read(row - 1, 1)[0, column - 1]
        used = weights.any(axis=0)
        channels = weights[:, used] @ values[used] / scale
        if not has_data(channels):
            raise InputError(
                f"expected a pixel with data, but that of row {row}, column {column} has none",
                file=source.path,
            )
        found.append(channels)
    return np.reshape(found, (len(pixels), len(weights)))


def prior_of(trained: Training, name_or_path: str | Path) -> LearnedPrior:
    """The prior that a training was made with, by the name or path of the same file.

    **Raises:** `InputError` for another.
    """
    prior = read_prior(name_or_path)
    if prior is None or trained.record.get("prior_sha256") != file_hash(prior.path):
        raise InputError(
            f"expected the prior that the training was made with, '{trained.record.get('prior')}', "
            f"but '{name_or_path}' is another. Name it by --prior"
        )
    return prior


@dataclass(frozen=True)
class ChosenPixels:
    """Pixels whose full posterior is sampled."""

    places: Sequence[tuple[int, int]]
    """Row and column of each, counted from 1 at the upper left."""
    channels: Float[np.ndarray, "pixel channel"]
    """Reflectance of each in the channels of the training."""
    prior: LearnedPrior
    """The prior that the training was made with."""
    steps: int
    """Steps of each walker."""
    seed: int
    """Seed of everything random; draws depend on row and column besides."""


def pixel_posteriors(
    run: Run,
    pool: Pool,
    trained: Training,
    chosen: ChosenPixels,
    *,
    likely: float,
    journal: Journal | None,
    record: dict[str, Any],
) -> tuple[list[PixelPosterior], list[Section]]:
    """Sample the posterior of some pixels by emcee, beside what the regression says of them.

    **Arguments:**

    - `run`: of the map; `pixels.csv` and `pixels.nc` are written into it.
    - `pool`: where the ensembles run.
    - `trained`, `chosen`: the training and the pixels.
    - `likely`: as of the map.
    - `journal`: of these pixels (`pixel_journal`).
    - `record`: of the map, for `pixels.nc`.

    **Returns:** the posteriors, and what the page says of them.
    """
    pixels, steps = chosen.places, chosen.steps
    parts = [(i, (*pixel, e)) for i, pixel in enumerate(pixels) for e in range(_ENSEMBLES)]
    names = [f"row {row}, column {column}, ensemble {e + 1}" for _, (row, column, e) in parts]
    with run.stage("Sample pixels by emcee", "pixels", total=len(parts)):
        made = pool.all(
            _sampled, parts, chosen, trained.responses, trained.settings,
            names=names, journal=journal,
        )  # fmt: skip
    first = round(_BURN_IN * steps)
    chains, accepted = [], []
    for i in range(len(pixels)):
        own = made[_ENSEMBLES * i :][:_ENSEMBLES]
        chains.append(np.concatenate([quantities[first:] for quantities, _ in own], axis=1))
        accepted.append(float(np.mean([share for _, share in own])))
    by_map = estimate_pixels(trained.posterior, jnp.asarray(chosen.channels, jnp.float32), likely)
    found = [_posterior(pixel, chains[i], accepted[i], by_map, i) for i, pixel in enumerate(pixels)]
    _warn(found)
    rows = [
        {"row": one.row, "column": one.column, **quantity.model_dump()}
        for one in found
        for quantity in one.quantities
    ]
    table = pd.DataFrame(rows)
    run.table("pixels.csv", table, "chosen pixels: full posterior beside the map's")
    title = {"title": "Draws of the posteriors of pixels, by emcee"}
    path = run.path("pixels.nc", "draws of the posteriors of the chosen pixels")
    write_run(path, _draws(pixels, chains), record | title)
    return found, [_section(found, table)]


def pixel_journal(
    run: Run, checkpoint: Path, trained: Training, chosen: ChosenPixels
) -> Journal | None:
    """The journal that keeps the ensembles of some pixels in the folder `checkpoint`. Raises
    `InputError` for a folder of other pixels."""
    signed = trained.settings, trained.responses, chosen.places, chosen.channels, chosen.steps
    return run.journal(checkpoint, *signed, files=[chosen.prior.path])


def _sampled(
    part: tuple[int, tuple[int, int, int]],
    chosen: ChosenPixels,
    bands: BandSet,
    settings: StandSettings,
) -> tuple[np.ndarray, ...]:
    """Draws of one ensemble of one pixel, and the share of its steps that was accepted."""
    pixel, place = part
    own = int(np.random.default_rng([chosen.seed, *place]).integers(2**31))
    chain = sample_pixel(
        chosen.channels[pixel], bands, chosen.prior, settings, steps=chosen.steps, seed=own
    )
    return chain.quantities, np.asarray(chain.acceptance)


def _posterior(
    pixel: tuple[int, int],
    chain: Float[np.ndarray, "step walker quantity"],
    accepted: float,
    by_map: PixelEstimates,
    place: int,
) -> PixelPosterior:
    size = effective_size(chain)
    draws = chain.reshape(-1, chain.shape[-1])
    low, middle, high = np.quantile(draws, [0.05, 0.5, 0.95], axis=0)
    quantities = [
        PixelQuantity(
            quantity=name,
            unit=quantity.unit,
            map_mean=float(by_map.mean[place, i]),
            map_sd=float(by_map.sd[place, i]),
            map_q05=float(by_map.lower[place, i]),
            map_q95=float(by_map.upper[place, i]),
            mean=float(draws[:, i].mean()),
            sd=float(draws[:, i].std()),
            q05=float(low[i]),
            median=float(middle[i]),
            q95=float(high[i]),
        )
        for i, (name, quantity) in enumerate(STAND_QUANTITIES.items())
    ]
    return PixelPosterior(
        row=pixel[0],
        column=pixel[1],
        unlikeness=float(by_map.unlikeness[place]),
        effective_size=size,
        acceptance=accepted,
        converged=size >= _FEWEST,
        quantities=quantities,
    )


def _warn(found: Sequence[PixelPosterior]) -> None:
    for one in found:
        where = f"row {one.row}, column {one.column}"
        if not one.converged:
            warnings.warn(
                f"the posterior of {where} did not converge: {one.effective_size:.0f} effective "
                f"draws of {_FEWEST:.0f}. Ask for more --pixel-steps",
                stacklevel=2,
            )
        if (one.unlikeness or 0.0) > 1.0:
            warnings.warn(
                f"the spectrum of {where} is unlike the simulations: its posterior is the best of "
                "stands that do not look like it",
                stacklevel=2,
            )


def _draws(
    pixels: Sequence[tuple[int, int]], chains: Sequence[Float[np.ndarray, "step walker quantity"]]
) -> xr.Dataset:
    """Draws of every quantity of every pixel."""
    draws = np.stack([chain.reshape(-1, chain.shape[-1]) for chain in chains])
    variables = {
        name: (("pixel", "draw"), draws[:, :, i], {"long_name": q.words, "units": q.unit})
        for i, (name, q) in enumerate(STAND_QUANTITIES.items())
    }
    place = np.array(pixels)
    coordinates = {
        "row": ("pixel", place[:, 0], {"long_name": "row from 1 at the top", "units": "1"}),
        "column": ("pixel", place[:, 1], {"long_name": "column from 1 at the left", "units": "1"}),
    }
    return xr.Dataset(variables, coords=coordinates)


def _section(found: Sequence[PixelPosterior], table: pd.DataFrame) -> Section:
    shown = {
        f"row {one.row}, column {one.column}": {
            q.quantity: ((q.map_q05, q.map_mean, q.map_q95), (q.q05, q.mean, q.q95))
            for q in one.quantities
        }
        for one in found
    }
    figure = figures.pixels_figure(
        shown, {n: (q.words, q.unit) for n, q in STAND_QUANTITIES.items()}
    )
    what = "mean and 90 % interval of chosen pixels, by the map's regression and by emcee"
    sampled = "; ".join(
        f"row {one.row}, column {one.column}: {one.effective_size:.0f} effective draws, "
        f"{100 * (one.acceptance or 0.0):.0f} % accepted"
        + ("" if one.converged else ", not converged")
        for one in found
    )
    return Section(
        "Chosen pixels",
        [
            "Full posteriors by emcee, with stands planted and lit at every step; the regression "
            f"of the map stands for them. {sampled}.",
            Picture("pixels.png", figure, what),
            Table(table, "Chosen pixels.", folded=True),
        ],
    )

"""Full posteriors of some pixels of a map: what `fynjax map --pixel` does beside the maps."""

import json
import warnings
from collections.abc import Sequence
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pandas as pd
import xarray as xr
from jaxtyping import Float
from pydantic import Field

from fynjax._core.checkpoint import Journal
from fynjax._core.errors import InputError
from fynjax._core.parts import Pool
from fynjax._core.sampling import autocorrelation_time, split_r_hat
from fynjax.assembly import STAND_QUANTITIES, StandSettings, sample_pixel
from fynjax.inversion import PixelEstimates, estimate_pixels, signature
from fynjax.io.plot import LearnedPrior, read_prior
from fynjax.io.raster import CubeBlocks, file_hash, write_run
from fynjax.jobs._result import Number, Record
from fynjax.jobs._run import Run
from fynjax.jobs._train import Training
from fynjax.report.figures import pixels_figure
from fynjax.report.pages import Picture, Section, Table
from fynjax.sensors import BandSet

_ENSEMBLES = 2
"""Independent ensembles of a pixel."""
_BURN_IN = 1 / 6
"""Share of the steps that still depends on the start."""
_FEWEST, _MOST_R_HAT = 100.0, 1.1
"""Effective draws, and how far ensembles may disagree, of a posterior that counts as converged."""


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
    unlikeness: Number = Field(description="Of the spectrum; above 1 the map is masked.")
    effective_size: Number = Field(description="Effective draws of the slowest quantity.")
    r_hat: Number = Field(description="Disagreement of the ensembles; 1 where there is none.")
    acceptance: Number
    converged: bool
    quantities: list[PixelQuantity]


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
        if not np.isfinite(channels).all():
            raise InputError(
                f"expected a pixel with data, but that of row {row}, column {column} has none",
                file=source.path,
            )
        found.append(channels)
    return np.array(found)


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


def pixel_posteriors(
    run: Run,
    pool: Pool,
    trained: Training,
    prior: LearnedPrior,
    pixels: Sequence[tuple[int, int]],
    channels: Float[np.ndarray, "pixel channel"],
    *,
    steps: int,
    seed: int,
    likely: float,
    checkpoint: Path,
) -> tuple[list[PixelPosterior], list[Section]]:
    """Sample the posterior of some pixels by emcee, beside what the regression says of them.

    **Arguments:**

    - `run`: of the map; `pixels.csv` and `pixels.nc` are written into it.
    - `pool`: where the ensembles run.
    - `trained`, `prior`: the training, and the prior that it was made with.
    - `pixels`, `channels`: row and column of each, and its reflectance in the channels.
    - `steps`: of each walker.
    - `seed`: of everything random.
    - `likely`: as of the map.
    - `checkpoint`: folder that keeps the ensembles.

    **Returns:** the posteriors, and what the page says of them.
    """
    low, high = json.loads(trained.record["sun_zenith_deg"])
    settings = StandSettings(
        sun_zenith=(low, high),
        size_m=float(trained.record["stand_size_m"]),
        voxel_m=float(trained.record["voxel_m"]),
    )
    parts = [(i, e) for i in range(len(pixels)) for e in range(_ENSEMBLES)]
    names = [f"row {pixels[i][0]}, column {pixels[i][1]}, ensemble {e + 1}" for i, e in parts]
    mark = signature((settings, trained.responses, channels, steps, seed), [file_hash(prior.path)])
    with run.stage("Sample pixels by emcee", "pixels", total=len(parts)):
        made = pool.all(
            _sampled, parts, channels, trained.responses, prior, settings, steps, seed,
            names=names, journal=Journal(checkpoint, mark), progress=run.progress,
        )  # fmt: skip
    first = round(_BURN_IN * steps)
    chains = [
        np.stack([made[_ENSEMBLES * i + e][0][first:] for e in range(_ENSEMBLES)])
        for i in range(len(pixels))
    ]
    accepted = [float(np.mean([m[1] for m in made[_ENSEMBLES * i :][:_ENSEMBLES]]))
                for i in range(len(pixels))]  # fmt: skip
    by_map = estimate_pixels(trained.posterior, jnp.asarray(channels, jnp.float32), likely)
    found = [_posterior(pixels[i], chains[i], accepted[i], by_map, i) for i in range(len(pixels))]
    _warn(found)
    _write(run, pixels, chains, found)
    return found, [_section(found)]


def _sampled(
    part: tuple[int, int],
    channels: np.ndarray,
    bands: BandSet,
    prior: LearnedPrior,
    settings: StandSettings,
    steps: int,
    seed: int,
) -> tuple[np.ndarray, ...]:
    pixel, ensemble = part
    own = int(np.random.default_rng([seed, pixel, ensemble]).integers(2**31))
    chain = sample_pixel(channels[pixel], bands, prior, settings, steps=steps, seed=own)
    return chain.quantities, np.asarray(chain.acceptance)


def _posterior(
    pixel: tuple[int, int],
    chain: Float[np.ndarray, "ensemble step walker quantity"],
    accepted: float,
    by_map: PixelEstimates,
    place: int,
) -> PixelPosterior:
    ensembles, steps, walkers, _ = chain.shape
    times = [autocorrelation_time(one) for one in chain]
    size = sum(steps * walkers / time for time in times)
    # An ensemble as one chain, its walkers one after the other within a step.
    apart = split_r_hat(np.moveaxis(chain.reshape(ensembles, steps * walkers, -1), 0, 1))
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
        r_hat=apart,
        acceptance=accepted,
        converged=bool(size >= _FEWEST and apart < _MOST_R_HAT),
        quantities=quantities,
    )


def _warn(found: Sequence[PixelPosterior]) -> None:
    for one in found:
        where = f"row {one.row}, column {one.column}"
        if not one.converged:
            warnings.warn(
                f"the posterior of {where} did not converge: {one.effective_size:.0f} effective "
                f"draws, R-hat {one.r_hat:.2f}. Ask for more --pixel-steps",
                stacklevel=2,
            )
        if (one.unlikeness or 0.0) > 1.0:
            warnings.warn(
                f"the spectrum of {where} is unlike the simulations: its posterior is the best of "
                "stands that do not look like it",
                stacklevel=2,
            )


def _write(
    run: Run,
    pixels: Sequence[tuple[int, int]],
    chains: Sequence[Float[np.ndarray, "ensemble step walker quantity"]],
    found: Sequence[PixelPosterior],
) -> None:
    run.table("pixels.csv", _table(found), "chosen pixels: full posterior beside the map's")
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
    record = {**run.record([]), "title": "Draws of the posteriors of pixels, by emcee"}
    path = run.path("pixels.nc", "draws of the posteriors of the chosen pixels")
    write_run(path, xr.Dataset(variables, coords=coordinates), record)


def _table(found: Sequence[PixelPosterior]) -> pd.DataFrame:
    return pd.DataFrame(
        [
            {"row": one.row, "column": one.column, **quantity.model_dump()}
            for one in found
            for quantity in one.quantities
        ]
    )


def _section(found: Sequence[PixelPosterior]) -> Section:
    shown = {
        f"row {one.row}, column {one.column}": {
            q.quantity: (
                (q.map_q05, q.map_mean, q.map_q95),
                (q.q05, q.mean, q.q95),
            )
            for q in one.quantities
        }
        for one in found
    }
    figure = pixels_figure(shown, {n: (q.words, q.unit) for n, q in STAND_QUANTITIES.items()})
    what = "mean and 90 % interval of chosen pixels, by the map's regression and by emcee"
    sampled = "; ".join(
        f"row {one.row}, column {one.column}: {one.effective_size:.0f} effective draws, R-hat "
        f"{one.r_hat:.2f}, {100 * (one.acceptance or 0.0):.0f} % accepted"
        + ("" if one.converged else ", not converged")
        for one in found
    )
    return Section(
        "Chosen pixels",
        [
            "Full posteriors by emcee, with stands planted and lit at every step; the regression "
            f"of the map stands for them. {sampled}.",
            Picture("pixels.png", figure, what),
            Table(_table(found), "Chosen pixels.", folded=True),
        ],
    )

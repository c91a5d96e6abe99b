"""Maps against field plots: what `fynjax map` says of the BioSCape plots' AVIRIS-NG spectra.

    python -m tests.benchmarks.map_plots [--training training.nc] [--simulations 20000] [--keep DIR]
    python -m tests.benchmarks.map_plots --folds 6 [--simulations 5000]

Trains for the spectra's good bands, unless a training is given. Plots are compared by the mean of
their flights; the mean of the other plots is what knows nothing of the spectrum. With `--folds`
plots are estimated by a training that is without them: the prior's means without them, covers and
growth forms by the moments of the others. (Leaf mass and water of the forms are by species, which
grow in many plots, and stay.)
"""

import argparse
import os
import tempfile
import warnings
from pathlib import Path
from unittest import mock

import jax.numpy as jnp
import numpy as np

from fynjax.assembly import STAND_QUANTITIES, _stands
from fynjax.inversion import estimate_pixels
from fynjax.io.plot import DEFAULT_PRIOR, read_prior, write_prior
from fynjax.io.plot._prior import _bounds
from fynjax.io.raster import Cube, write_cube_envi
from fynjax.jobs import read_training, train
from fynjax.studies.bioscape import read_bioscape
from fynjax.studies.bioscape._inversion_compare import field_values
from fynjax.studies.bioscape._spectra import read_plot_spectra, read_spectrometer

TABLES = Path(os.environ.get("FYNJAX_SHARED_DATA", "data")) / "eco" / "bioscape"
PERCENT = ("live_cover", "dead_cover", "bare_cover")


def write_plots(path: Path, spectra: np.ndarray, good: np.ndarray) -> None:
    """A cube of the spectra, a plot a pixel of one row."""
    sensor = read_spectrometer(TABLES)
    cube = Cube(
        values=np.nan_to_num(spectra).T[:, None, :],
        names=tuple(f"band {i}" for i in range(1, len(good) + 1)),
        wavelength=np.asarray(sensor.centre), fwhm=np.asarray(sensor.fwhm), good=good,
        pixel_m=5.0, origin_m=(0.0, 0.0), crs="EPSG:32734",
    )  # fmt: skip
    write_cube_envi(path, cube, {"source": "spectra of BioSCape plots"})


def beta_moments(values: np.ndarray) -> tuple[float, float]:
    """Parameters of the beta distribution of their mean and variance."""
    mean, variance = values.mean(), values.var(ddof=1)
    size = mean * (1.0 - mean) / variance - 1.0
    return float(size * mean), float(size * (1.0 - mean))


def moments_of(plots: list) -> dict:
    """What `fynjax.assembly._stands` assumes of covers and growth forms, as `plots` have it."""
    field = field_values(plots).value
    live, dead = (np.asarray(field[f"{name}_cover"], float) / 100.0 for name in ("live", "dead"))
    partly = live < 0.999
    forms = [
        [sum(s.cover for s in p.species if s.shape.growth_form == form) for form in _stands._SHARES]
        for p in plots
    ]
    shares = np.array(forms) / np.sum(forms, axis=1, keepdims=True)
    mean = shares.mean(axis=0)
    size = np.sum(mean * (1.0 - mean)) / np.sum(shares.var(axis=0, ddof=1)) - 1.0
    return {
        "_COVERED": beta_moments(live),
        "_DEAD": beta_moments(np.clip(dead[partly] / (1.0 - live[partly]), 0.0, 1.0)),
        "_SHARES": dict(zip(_stands._SHARES, np.maximum(size * mean, 0.05), strict=True)),
    }


def prior_without(plots: list, folder: Path) -> Path:
    """The shipped prior with the means that it would have without `plots`.

    To first order: each plot left out alone moves a mean of n by what it weighs; K together move
    it by the sum of that, times (n - 1) / (n - K), which is exact for plain means. In the logarithm
    of a value over what its bounds leave. Spreads and the model's error stay those of all plots.
    """
    prior = read_prior(DEFAULT_PRIOR)
    values = [prior.values(p.name) for p in plots if prior.knows(p.name)]
    count = prior.file.plots
    rows = []
    for row in prior.file.parameters:
        low, high = _bounds(row.name)

        def free(value, low=low, high=high):
            return np.log(value - low) - (np.log(high - value) if np.isfinite(high) else 0.0)

        moved = sum(free(v[row.name]) - free(row.mean) for v in values)
        z = free(row.mean) + (count - 1) / (count - len(values)) * moved
        mean = low + (np.exp(z) if np.isinf(high) else (high - low) / (1.0 + np.exp(-z)))
        rows.append(row.model_copy(update={"mean": float(mean)}))
    path = folder / "prior.toml"
    write_prior(path, prior.file.model_copy(update={"parameters": rows}))
    return path


def left_out(plots: list, spectra: np.ndarray, good: np.ndarray, folds: int, count: int) -> tuple:
    """Mean, lower and upper end of the interval of each plot, by trainings without it."""
    fold = np.random.default_rng(0).permutation(np.arange(len(plots)) % folds)
    found = np.empty((3, len(plots), len(STAND_QUANTITIES)))
    for one in range(folds):
        mine = fold == one
        out = [p for p, is_out in zip(plots, mine, strict=True) if is_out]
        others = moments_of([p for p in plots if p not in out])
        with tempfile.TemporaryDirectory() as work:
            folder = Path(work)
            write_plots(folder / "plots.hdr", spectra, good)
            with mock.patch.multiple(_stands, **others):
                train(
                    folder, like=folder / "plots.hdr", prior=prior_without(out, folder),
                    simulations=count, checkpoint=folder / "checkpoint",
                )  # fmt: skip
            trained = read_training(folder / "training.nc")
        weights = trained.channels.weights(read_spectrometer(TABLES).centre, good)
        channels = jnp.asarray(np.nan_to_num(spectra[mine]) @ weights.T, jnp.float32)
        estimate = estimate_pixels(trained.posterior, channels)
        found[:, mine] = estimate.mean, estimate.lower, estimate.upper
        print(f"fold {one + 1}: {int(mine.sum())} plots left out", flush=True)
    return tuple(found)


def print_table(plots: list, mean: np.ndarray, lower: np.ndarray, upper: np.ndarray) -> None:
    """Estimates against the field's values."""
    field = field_values(plots).value
    for name in (*PERCENT, "leaf_mass_per_area", "water_content"):
        i, scale = list(STAND_QUANTITIES).index(name), 100.0 if name in PERCENT else 1.0
        true = np.asarray(field[name], float)
        known = np.isfinite(true)
        middle, low, high = (scale * np.asarray(a)[known, i] for a in (mean, lower, upper))
        true = true[known]
        others = (true.sum() - true) / (len(true) - 1)
        rmse = lambda estimate: np.sqrt(np.mean((estimate - true) ** 2))  # noqa: B023, E731
        print(
            f"{name:20} RMSE {rmse(middle):.1f}, of the mean of the others {rmse(others):.1f}; "
            f"bias {(middle - true).mean():.1f}, r {np.corrcoef(middle, true)[0, 1]:.2f}, "
            f"{100 * np.mean((true >= low) & (true <= high)):.0f} % inside 90 %"
        )


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--folds", type=int)
    parser.add_argument("--training", type=Path)
    parser.add_argument("--simulations", type=int, default=20000)
    parser.add_argument("--keep", type=Path)
    given = parser.parse_args()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        plots = read_bioscape(TABLES)
    measured = read_plot_spectra(TABLES)
    plots = [p for p in plots if p.name in measured and measured[p.name].times]
    spectra = np.stack([measured[p.name].reflectance.mean(axis=0) for p in plots])
    good = np.isfinite(spectra).all(axis=0)
    if given.folds:
        return print_table(plots, *left_out(plots, spectra, good, given.folds, given.simulations))
    with tempfile.TemporaryDirectory() as work:
        folder = given.keep or Path(work)
        folder.mkdir(parents=True, exist_ok=True)
        training = given.training
        if training is None:
            write_plots(folder / "plots.hdr", spectra, good)
            made = train(
                folder, like=folder / "plots.hdr", simulations=given.simulations,
                checkpoint=folder / "checkpoint",
            )  # fmt: skip
            print("\n".join(made.headline), made.timings_s)
            for score in made.scores:
                print(
                    f"  {score.quantity}: explained {score.explained:.2f}, inside 50, 68, 90: "
                    f"{score.inside_50:.2f} {score.inside_68:.2f} {score.inside_90:.2f}"
                )
            training = folder / "training.nc"
        trained = read_training(training)
    weights = trained.channels.weights(read_spectrometer(TABLES).centre, good)
    channels = np.nan_to_num(spectra) @ weights.T
    found = estimate_pixels(trained.posterior, jnp.asarray(channels, jnp.float32))
    print_table(plots, found.mean, found.lower, found.upper)
    print("unlike the simulations:", np.asarray(found.unlikeness).round(2))
    flights = np.nan_to_num(np.concatenate([measured[p.name].reflectance for p in plots]))
    single = estimate_pixels(trained.posterior, jnp.asarray(flights @ weights.T, jnp.float32))
    print(
        f"masked: {int(np.sum(found.unlikeness > 1))} of {len(plots)} plots, "
        f"{int(np.sum(single.unlikeness > 1))} of their {len(flights)} overflights"
    )


if __name__ == "__main__":
    main()

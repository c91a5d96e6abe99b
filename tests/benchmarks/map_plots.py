"""Maps against field plots: what `fynjax map` says of the BioSCape plots' AVIRIS-NG spectra.

    python -m tests.benchmarks.map_plots [--training training.nc] [--simulations 20000] [--keep DIR]

Trains for the spectra's good bands, unless a training is given. Plots are compared by the mean of
their flights; the mean of the other plots is what knows nothing of the spectrum.
"""

import tempfile
from collections.abc import Sequence
from pathlib import Path

import jax.numpy as jnp
import numpy as np

from fynjax.app.assembly import STAND_QUANTITIES
from fynjax.app.io.raster import Cube, write_cube_envi
from fynjax.app.jobs import read_training, train
from fynjax.inversion import estimate_pixels
from fynjax.studies.bioscape._inversion_compare import field_values
from fynjax.studies.bioscape._spectra import read_spectrometer
from tests.benchmarks._measure import bioscape_plots, data_folder, options

TABLES = data_folder() / "eco" / "bioscape"
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


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the table."""
    parser = options(__doc__)
    parser.add_argument("--training", type=Path)
    parser.add_argument("--simulations", type=int, default=20000)
    parser.add_argument("--keep", type=Path)
    given = parser.parse_args(arguments)
    _, plots, measured = bioscape_plots()
    spectra = np.stack([measured[p.name].reflectance.mean(axis=0) for p in plots])
    good = np.isfinite(spectra).all(axis=0)
    if given.tiny:
        good &= np.arange(good.size) % 12 == 0
    with tempfile.TemporaryDirectory() as work:
        folder = given.keep or Path(work)
        folder.mkdir(parents=True, exist_ok=True)
        training = given.training
        if training is None:
            write_plots(folder / "plots.hdr", spectra, good)
            made = train(
                folder, like=folder / "plots.hdr", checkpoint=folder / "checkpoint",
                simulations=200 if given.tiny else given.simulations,
                steps=10 if given.tiny else 6000,
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

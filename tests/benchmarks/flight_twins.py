"""Twins seen from above alone, and from above and eight sides: whose intervals are narrower, by
how much, and whether they hold the truth.

    python -m tests.benchmarks.flight_twins --seeds 6

Truths are drawn from the prior of a plot of five common taxa of the shipped one, whose table states
the inclination of their leaves, and are planted with own seeds. Their frames are full renders with
gains that the frames of a camera share, a drift of each, the error that the model is believed to
have, and noise. Each twin is calibrated to the frame from above, and to all nine. Printed, by kind
of parameter: standard deviation of the posterior over that of the prior, by the fits and by
`fynjax information`, and how many truths the 90 % intervals hold. Results are kept in `--keep` as
they come, and a second run goes on with them.
"""

import dataclasses
import time
from collections.abc import Sequence
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
from scipy.special import ndtri

from fynjax import inversion
from fynjax._core.precision import double_precision
from fynjax.app.assembly import plot_problem
from fynjax.app.assembly._twin import draw_truth, measure_truth
from fynjax.app.io.plot import CalibrationTable, Plot, plot_instrument
from fynjax.app.jobs._information_flight import OBLIQUE_DEG, FlightSetting, flight_information
from fynjax.canopy import FORMS, leaf_angle
from fynjax.inversion import (
    BandFactors,
    CalibrationSettings,
    Data,
    ImageSight,
    ImageView,
    Problem,
    factors_by_view,
    join_data,
    weigh_targets,
)
from fynjax.scene import Placement
from fynjax.sensors import Frame, Pose
from tests.benchmarks._measure import example_plot, options

TAXA = (
    "Metalasia muricata", "Passerina corymbosa", "Erica irregularis", "Indigofera brachystachya",
    "Restio eleocharis",
)  # fmt: skip
"""Those of the shipped plot that cover most, and a restio."""
KINDS = ("cover", "height", "leaf_area_index", "leaf_angle", "dead_fraction")
PRIORS = {"*.cover": 0.3, "*.height": 0.2, "*.leaf_angle": 0.15, "*": 0.3}
NAMES = tuple(
    f"{layer}.{kind}"
    for layer in ("green", "red", "red_edge", "nir", "NDVI")
    for kind in ("mean", "std", "q05", "q25", "q50", "q75", "q95")
)
HEIGHT, OBLIQUE, PIXEL = 50.0, 8, 0.1
STATED = CalibrationTable().target_sd
FLIGHTS = {"nadir": slice(0, 1), "oblique": slice(None)}
FOUND = ("truth", "estimate", "sd", "converged", "misfit", "seconds")


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the table."""
    parser = options(__doc__)
    parser.add_argument("--size", type=float, default=3.0, help="side of the plot [m]")
    parser.add_argument("--seeds", type=int, default=6)
    parser.add_argument("--first", type=int, default=0, help="number of the first twin")
    parser.add_argument("--keep", type=Path, default=Path("flight_twins"))
    asked = parser.parse_args(arguments)
    if asked.tiny:
        asked.size, asked.seeds = 1.0, 1
    asked.keep.mkdir(parents=True, exist_ok=True)
    ready = plot_problem(plot_of(asked.size, asked.tiny), None, seed=0)
    for number in range(asked.first, asked.first + asked.seeds):
        for flight in FLIGHTS:
            path = asked.keep / f"{flight}_{number:03d}.npz"
            if not path.is_file():
                np.savez(path, **twin(ready, number, flight, asked.tiny))
                jax.clear_caches()
    known = None if asked.tiny else expected(asked.size)
    report(ready, known, asked.keep)


def plot_of(size: float, tiny: bool) -> Plot:
    """The taxa with the inclination of their form stated, and what is free of them."""
    plot = example_plot(size)
    species = tuple(
        row.replace(leaf_angle=float(leaf_angle(FORMS[row.growth_form].leaf_angle).mean_angle))
        for row in plot.species
        if row.taxon in TAXA[: 2 if tiny else None]
    )
    free = (*(f"species.*.{kind}" for kind in KINDS), "ground.brightness")
    calibration = plot.calibration.replace(free=free, priors=PRIORS)
    return plot.replace(species=species, calibration=calibration)


def views_of(problem: Problem, size: float) -> tuple[ImageView, ...]:
    """The frame from above, then those that look from 45 degrees, evenly round the plot."""
    frames = []
    for k in range(-1, OBLIQUE):
        zenith, azimuth = (0.0, 0.0) if k < 0 else (OBLIQUE_DEG, 360.0 * k / OBLIQUE)
        away = HEIGHT * np.tan(np.radians(zenith))
        east, north = (0.5 * size + away * f(np.radians(azimuth)) for f in (np.sin, np.cos))
        pose = Pose(jnp.array([east, north, HEIGHT]), (azimuth + 180.0) % 360.0, zenith)
        frames.append(Frame(pose, name=f"frame{k + 1}"))
    sensor = inversion_sensor(size)
    return tuple(
        ImageSight(NAMES, sensor, Placement(pixel=PIXEL, frame=frame), sensor.gains())(
            problem.scene, problem.scene.parameters
        ).named(frame.name)
        for frame in frames
    )


def inversion_sensor(size: float):
    """The camera of the shipped plot."""
    return plot_instrument(example_plot(size))


@double_precision
def measured(
    problem: Problem, views: Sequence[ImageView], truth: np.ndarray, number: int
) -> list[Data]:
    """What each frame has of the plot at `truth`: the same plants, gains of the camera with a drift
    of each frame, the model's error, noise."""
    random = np.random.default_rng([number, 19])
    factors = BandFactors.of(views, problem.error)
    errors = factors_by_view(views, jnp.asarray(factors.draw_errors(random)))
    root = np.asarray(factors.of_gains)
    drawn = random.multivariate_normal(np.zeros(len(root)), root, method="eigh")
    gains = factors_by_view(views, jnp.asarray(drawn))
    found = []
    for view, error, gain in zip(views, errors, gains, strict=True):
        value, _ = measure_truth(
            problem, view, truth, number, random, np.exp(np.asarray(error)), np.exp(gain)
        )
        known = weigh_targets(view.names, value, STATED)
        found.append(dataclasses.replace(known, names=view.statistic_names))
    return found


def twin(ready: Problem, number: int, flight: str, tiny: bool) -> dict[str, np.ndarray]:
    """One calibration of one truth."""
    size = float(ready.scene.grid.extent[0])
    truth = draw_truth(len(ready.free.names), np.random.default_rng([number, 17]))
    few = {"stand_realisations": 2, "scatter_draws": 8, "full_renders": 1, "max_steps": 2}
    settings = CalibrationSettings(seed=number, **few if tiny else {})
    views = views_of(ready, size)
    data = measured(ready, views, truth, number)
    chosen = FLIGHTS[flight]
    began = time.process_time()
    problem = Problem(
        ready.scene, join_data(data[chosen]), ready.free, views=views[chosen], error=ready.error,
        settings=settings,
    )  # fmt: skip
    found = inversion.fit(problem)
    fit = found.fit
    values = (
        truth, fit.whitened, np.sqrt(np.diagonal(fit.covariance)), fit.converged,
        2.0 * found.ends.objective[0], time.process_time() - began,
    )  # fmt: skip
    one = {name: np.asarray(value) for name, value in zip(FOUND, values, strict=True)}
    inside = np.abs(one["truth"] - one["estimate"]) < ndtri(0.95) * one["sd"]
    print(f"{flight} {number}: {one['seconds']:.0f} CPU s, converged {one['converged']}, "
          f"{inside.mean():.2f} held, sd {one['sd'].mean():.2f}", flush=True)  # fmt: skip
    return one


@double_precision
def expected(size: float) -> dict[str, np.ndarray]:
    """Standard deviation of each parameter over that of its prior, by `fynjax information`."""
    problem = plot_problem(plot_of(size, False), None, seed=0)
    settings = [FlightSetting(1, 0, 0.0), FlightSetting(1, OBLIQUE, 0.0)]
    bounds = flight_information(
        problem, inversion_sensor(size), settings, overlap=80.0, error=STATED, realisations=48
    )
    return {
        flight: np.asarray(one.bayesian / one.prior_sd)
        for flight, one in zip(FLIGHTS, bounds, strict=True)
    }


def report(ready: Problem, known: dict[str, np.ndarray] | None, keep: Path) -> None:
    """Error left of the prior's and truths in the intervals, by kind."""
    kinds = np.array([name.split(".", 2)[-1] for name in ready.free.names])
    rows = []
    for flight in FLIGHTS:
        kept = [np.load(path) for path in sorted(keep.glob(f"{flight}_*.npz"))]
        truth, estimate, sd = (np.stack([one[n] for one in kept]) for n in FOUND[:3])
        inside = np.abs(truth - estimate) < ndtri(0.95) * sd
        for kind in (*dict.fromkeys(kinds), "all"):
            place = np.full(len(kinds), True) if kind == "all" else kinds == kind
            row = {"flight": flight, "kind": kind, "twins": len(kept)}
            row["sd of fits"] = sd[:, place].mean()
            if known is not None:
                row["of information"] = known[flight][place].mean()
            row["rms error"] = np.sqrt(np.mean((truth - estimate)[:, place] ** 2))
            row["held"] = inside[:, place].mean()
            rows.append(row)
        held = inside.mean(axis=1)
        spread = f" +- {held.std(ddof=1) / np.sqrt(len(held)):.3f}" if len(held) > 1 else ""
        print(f"{flight}: converged {np.mean([one['converged'] for one in kept]):.2f}, median "
              f"{np.median([one['seconds'] for one in kept]):.0f} CPU s, held "
              f"{inside.mean():.3f}{spread}")  # fmt: skip
    print(pd.DataFrame(rows).round(2).to_string(index=False))


if __name__ == "__main__":
    main()

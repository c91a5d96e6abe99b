"""What sensors know together: `python -m tests.benchmarks.twin_sensors [--seeds 10] [--size 4]`.

Twins of the plot that burnt in 2006, cut to a square of SIZE m. For each seed the true parameters
are drawn from the prior, the truth's plants stand elsewhere than the scene's, and what the sensors
measure of it has errors drawn from those that the calibration assumes. The plot is calibrated from
the prior's centre to a drone's image (MSI), to MSI and LiDAR, and to AVIRIS-NG and LiDAR. Printed,
by the Laplace approximation: posterior widths by kind of parameter, coverage of the 68 and 95 %
intervals beside the binomial error of that many, bias of parameters called seen, and how far the
unseen left their prior. `--save FILE` keeps every number (CSV).

`--few` frees cover, diameter, chlorophyll, water and dry matter of the dominant species and the
soil's brightness alone, the rest is known. `--draws N` then samples each posterior by emcee too, to
N effective draws, on a polynomial that stands in for the search's renders, and prints its coverage
beside that of the Gaussian.
"""

import argparse
import dataclasses
import time
from collections.abc import Sequence
from itertools import combinations_with_replacement
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
from scipy.special import ndtri
from scipy.stats import qmc

from fynjax.assembly import build_plot, image_view
from fynjax.assembly._targets import reflectance_noise, structure_settings
from fynjax.inversion import (
    WELL_CONSTRAINED,
    AbstractView,
    Calibration,
    CalibrationSettings,
    Data,
    ImageView,
    ParameterSpace,
    PlotForward,
    SpectrumView,
    StructureView,
    calibrate_plot,
    free_space,
    join_data,
    sample_posterior,
    search_form,
    spectrum_view,
    structure_view,
    weigh_spectrum,
    weigh_structure,
    weigh_targets,
)
from fynjax.inversion._views import look
from fynjax.io.plot import Plot, example_folder, read_plot
from fynjax.metrics import BANDS
from fynjax.scene import PlotParameters, Scene, stand_realisation, with_values
from fynjax.sensors import BandSet, shipped_sensor

STATISTICS = tuple(f"{layer}.{kind}" for layer in (*BANDS, "NDVI") for kind in ("mean", "std"))
FREE = (
    *(f"species.*.{kind}" for kind in ("cover", "diameter", "height", "leaf_area_index")),
    *(f"species.*.leaf.{kind}" for kind in ("chlorophyll", "water", "dry_matter")),
    *("ground.brightness", "ground.litter_fraction"),
)
PRIOR = {"cover": 0.25, "diameter": 0.25, "height": 0.15}  # relative sd; the rest 0.3
SHARE = 0.02  # relative error of a mean, a band or a metric
PULSES = 100.0  # m-2
GRAIN = 1.0  # m, cells of the structure


FEW = ("cover", "diameter", "leaf.chlorophyll", "leaf.water", "leaf.dry_matter")


def few(scene: Scene, parameters: PlotParameters) -> tuple[str, ...]:
    """Names of the free parameters of the dominant species, and of the soil."""
    leafy = np.asarray(parameters.species.leaf_area_index) > 0
    taxon = scene.taxa[int(np.argmax(np.asarray(parameters.species.cover) * leafy))]
    return (*(f"species.{taxon}.{kind}" for kind in FEW), "ground.brightness")


def prior_sd(name: str) -> float:
    return PRIOR.get(name.rsplit(".", 1)[-1], 0.3)


def sensors(
    plot: Plot, scene: Scene, parameters: PlotParameters, bands: int
) -> dict[str, AbstractView]:
    """The three views: MSI, AVIRIS-NG in about `bands` bands, LiDAR."""
    own = shipped_sensor("aviris_ng").bands
    clear = [
        i for i, c in enumerate(own.centre)
        if 420 < c < 2440 and not (1340 < c < 1460 or 1790 < c < 2100)
    ]  # fmt: skip
    every = -(-len(clear) // bands)
    chosen = own.select(clear[every // 2 :: every])
    named = BandSet(tuple(f"{c:.1f}nm" for c in chosen.centre), chosen.centre, chosen.fwhm)
    settings, _ = structure_settings(plot)
    return {
        "MSI": image_view(plot, scene, parameters, STATISTICS),
        "AVIRIS-NG": spectrum_view(named, scene, parameters),
        "LiDAR": structure_view(settings=settings, grain=GRAIN, pulses=PULSES),
    }


def targets(view: AbstractView, value: np.ndarray, zenith: float, cells: int) -> Data:
    """What a sensor measures, with the errors of its kind."""
    if isinstance(view, ImageView):
        return weigh_targets(view.names, value, SHARE)
    if isinstance(view, StructureView):
        return weigh_structure(view.names, value, SHARE, sd=0.1 * np.abs(value) / np.sqrt(cells))
    assert isinstance(view, SpectrumView)
    noise = reflectance_noise(view.imager.sensor.bands, value, zenith)
    return weigh_spectrum(view.names, value, SHARE, noise=noise)


def noisy(data: Data, random: np.random.Generator) -> Data:
    """The same targets off by a draw of their errors."""
    normal = random.normal(size=data.value.size)
    if data.whitener is None:
        return Data(data.names, data.value + data.sd * normal, data.sd)
    off = np.linalg.solve(np.asarray(data.whitener), normal)
    return Data(data.names, data.value + off, data.sd, data.whitener)


class StandIn(eqx.Module):
    """A cubic polynomial of the statistics in whitened coordinates, for the search's cheap scene:
    the chain asks for some 10^5 of them."""

    coefficients: np.ndarray
    space: ParameterSpace

    @staticmethod
    def of(predict: Any, space: ParameterSpace, scene: Scene, scale: np.ndarray) -> "StandIn":
        """From renders spread over three prior standard deviations; prints its error in `scale`."""
        free = len(space.names)
        count, more = 3 * len(_terms(free)), 24
        shares = qmc.Sobol(free, rng=0).random(count + more)
        design = ndtri(np.clip(shares, 1e-3, 1.0 - 1e-3))
        once = eqx.filter_jit(lambda u, m: predict(space.physical(u), m))
        seen = np.array([once(jnp.asarray(u), scene) for u in design])
        basis = np.asarray(jax.vmap(lambda u: _powers(u, free))(jnp.asarray(design)))
        fitted = np.linalg.lstsq(basis[:count], seen[:count])[0]
        wrong = ((seen - basis @ fitted)[count:] ** 2).mean(axis=0) ** 0.5 / scale
        print(f"  stand-in: off by {np.median(wrong):.2f} of an error, at worst {wrong.max():.2f}")
        return StandIn(fitted, space)

    def __call__(self, values: jax.Array) -> jax.Array:
        return _powers(self.space.whitened(values), len(self.space.names)) @ self.coefficients


def _terms(free: int) -> list[tuple[int, ...]]:
    return [t for n in range(4) for t in combinations_with_replacement(range(free), n)]


def _powers(u: jax.Array, free: int) -> jax.Array:
    return jnp.stack([jnp.prod(u[jnp.array(t, int)]) for t in _terms(free)])


def sampled(
    stand_in: StandIn, found: Calibration, space: ParameterSpace, options: argparse.Namespace
) -> np.ndarray:
    """Draws by emcee in whitened coordinates [draw, free]."""
    # The cheap scene's statistics at the estimate, which the full one differs from.
    offset = found.statistics_after - stand_in(space.physical(found.fit.whitened))
    drawn = sample_posterior(
        lambda values, stand_in: stand_in(values),
        found.data,
        space,
        start=found.fit,
        offset=offset,
        context=(stand_in,),
        target=options.draws,
        predictive=1,
    )
    print(f"  emcee: {drawn.effective_size:.0f} effective draws, {drawn.status}", flush=True)
    return np.asarray(drawn.whitened).reshape(-1, len(space.names))


COMBINATIONS = (("MSI",), ("MSI", "LiDAR"), ("AVIRIS-NG", "LiDAR"))


def twin(
    seed: int,
    scene: Scene,
    parameters: PlotParameters,
    space: ParameterSpace,
    views: dict[str, AbstractView],
    observe: Any,
    options: argparse.Namespace,
    zenith: float,
    stand_ins: dict[tuple[str, ...], StandIn],
) -> list[dict[str, Any]]:
    """A row for each combination of sensors and parameter."""
    random = np.random.default_rng([seed, 2006])
    truth = random.normal(size=len(space.names)).clip(-2.0, 2.0)
    plot = with_values(parameters, scene.taxa, space.named(jnp.asarray(truth)))
    seen = observe(stand_realisation(scene, 1000 + seed), plot)
    cells = max(1, int(options.size / GRAIN) ** 2)
    measured = {
        name: noisy(targets(view, np.asarray(seen[name], float), zenith, cells), random)
        for name, view in views.items()
    }
    rows = []
    for names in COMBINATIONS:
        if options.sensors not in (None, " + ".join(names)):
            continue
        began = time.perf_counter()
        found = calibrate_plot(
            scene,
            parameters,
            join_data([measured[n] for n in names]),
            space,
            [views[n] for n in names],
            CalibrationSettings(
                stride=options.stride,
                max_steps=options.steps,
                stand_realisations=options.stand_realisations,
            ),
        )
        fit = found.fit
        width = np.sqrt(np.diagonal(np.asarray(fit.covariance)))
        draws = np.empty((0, len(space.names)))
        if options.draws:
            if names not in stand_ins:
                quick, cheap = search_form(
                    scene, parameters, [views[n] for n in names], stride=options.stride
                )
                predict = PlotForward(parameters, space.names, cheap)
                scale = np.asarray(found.data.sd)
                stand_ins[names] = StandIn.of(predict, space, quick, scale)
            draws = sampled(stand_ins[names], found, space, options)
        true = np.asarray(space.physical(jnp.asarray(truth)))
        rest = np.asarray(found.data.whiten(found.statistics_after - found.data.value))
        print(
            f"seed {seed}, {' + '.join(names)}: {time.perf_counter() - began:.0f} s, step "
            f"{found.seconds['step_s']:.1f} s, whitened misfit {np.sqrt(np.mean(rest**2)):.2f}, "
            f"{fit.explanation}",
            flush=True,
        )
        rows += [
            {
                "seed": seed,
                "sensors": " + ".join(names),
                "parameter": name,
                "kind": name.rsplit(".", 1)[-1],
                "width": width[i],
                "z": (float(fit.whitened[i]) - truth[i]) / width[i],
                "left_prior": float(fit.whitened[i]),
                "bias": float(fit.estimate[i]) / true[i] - 1.0,
                "seen": bool(fit.constrained[i] >= WELL_CONSTRAINED),
                "unseen": bool(fit.constrained[i] < 0.05),
                "rank": float(np.mean(draws[:, i] < truth[i])) if len(draws) else np.nan,
                "sampled_width": draws[:, i].std() if len(draws) else np.nan,
            }
            for i, name in enumerate(fit.names)
        ]
    return rows


def report(table: pd.DataFrame) -> None:
    """The tables."""
    if table["rank"].notna().any():
        print("\nBy emcee: coverage of the 68 and 95 % intervals, width over the Gaussian's")
        for name, part in table.groupby("sensors", sort=False):
            apart = (part["rank"] - 0.5).abs()
            inside = [float((apart <= level / 2).mean()) for level in (0.68, 0.95)]
            ratio = (part["sampled_width"] / part["width"]).median()
            print(f"{name:<20}{inside[0]:>13.3f}{inside[1]:>13.3f}{ratio:>13.2f}   n {len(part)}")
    order = [" + ".join(names) for names in COMBINATIONS]
    order = [name for name in order if (table["sensors"] == name).any()]
    width = table.pivot_table(index="kind", columns="sensors", values="width", aggfunc="median")
    print("\nPosterior width over the prior's, median over parameters and seeds")
    print(width[order].to_string(float_format="%.2f"))
    print("\nCoverage of the intervals, bias of the seen, how far the unseen left the prior")
    head = ("68 %", "95 %", "seen", "bias %", "unseen", "rms left")
    print(f"{'':<20}" + "".join(f"{h:>13}" for h in head))
    for name in order:
        part = table[table["sensors"] == name]
        inside = [float((part["z"].abs() < limit).mean()) for limit in (1.0, 1.96)]
        # Parameters of a seed hang together: each seed counts as one trial of all.
        by_seed = [
            part["z"].abs().lt(limit).groupby(part["seed"]).mean().std(ddof=1)
            / np.sqrt(part["seed"].nunique())
            for limit in (1.0, 1.96)
        ]
        seen, unseen = part[part["seen"]], part[part["unseen"]]
        left = float(np.sqrt(np.mean(unseen["left_prior"] ** 2))) if len(unseen) else np.nan
        bias = 100.0 * float(seen["bias"].mean()) if len(seen) else np.nan
        cells = [f"{v:.3f}±{e:.3f}" for v, e in zip(inside, by_seed)]
        print(
            f"{name:<20}{cells[0]:>13}{cells[1]:>13}{len(seen):>13}{bias:>13.1f}"
            f"{len(unseen):>13}{left:>13.2f}"
        )
    seen = table[table["seen"]]
    if len(seen):
        print("\nBias of parameters called seen, by kind [%], and how often")
        grouped = seen.groupby(["sensors", "kind"])["bias"].agg(["mean", "std", "size"])
        grouped[["mean", "std"]] *= 100.0
        print(grouped.to_string(float_format="%.1f"))


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])  # type: ignore[union-attr]
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--size", type=float, default=4.0, help="side of the plot [m]")
    parser.add_argument("--pixel", type=float, default=0.05, help="of the drone [m]")
    parser.add_argument("--bands", type=int, default=28, help="of the spectrometer")
    parser.add_argument("--stride", type=int, default=4, help="of the drone's pixels in the search")
    parser.add_argument("--steps", type=int, default=8)
    parser.add_argument("--stand-realisations", type=int, default=4)
    parser.add_argument("--few", action="store_true", help="free the dominant species alone")
    parser.add_argument("--draws", type=float, default=0.0, help="effective, by emcee")
    parser.add_argument("--sensors", help="only this combination, such as 'MSI + LiDAR'")
    parser.add_argument("--first", type=int, default=0, help="seed to begin with")
    parser.add_argument("--save", type=Path)
    options = parser.parse_args(arguments)
    read = read_plot(example_folder() / "plot.toml")
    side = (options.size, options.size)
    sensor = dataclasses.replace(read.sensor, pixel_m=options.pixel)
    read = dataclasses.replace(read, size_m=side, sensor=sensor)
    scene, parameters = build_plot(read, seed=0)
    free = few(scene, parameters) if options.few else FREE
    space = free_space(scene, parameters, free, prior_sd)
    chosen = [c for c in COMBINATIONS if options.sensors in (None, " + ".join(c))]
    views = {
        name: view
        for name, view in sensors(read, scene, parameters, options.bands).items()
        if any(name in names for names in chosen)
    }
    print(f"{len(space.names)} free parameters; {', '.join(map(' + '.join, chosen))}", flush=True)
    compiled = eqx.filter_jit(lambda m, p: {n: look([v], m, p)[0] for n, v in views.items()})
    rows: list[dict[str, Any]] = []
    stand_ins: dict[tuple[str, ...], StandIn] = {}
    zenith = read.sun.zenith_deg
    for seed in range(options.first, options.first + options.seeds):
        rows += twin(seed, scene, parameters, space, views, compiled, options, zenith, stand_ins)
        if options.save is not None:
            pd.DataFrame(rows).to_csv(options.save, index=False)
    report(pd.DataFrame(rows))


if __name__ == "__main__":
    main()

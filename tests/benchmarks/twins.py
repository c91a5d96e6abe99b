"""Calibrations of images whose truth is known, each of other plants than the search has.

    python -m tests.benchmarks.twins --seeds 20 --size 5

Truths are drawn from the prior and planted with own seeds; their images are full renders at
the camera's own pixels, with the camera's noise and gains. Printed: coverage of the intervals with
its binomial error, the share of the prior variance that estimates explain, by kind of parameter,
total live cover, time; and the same by ridge regression and a random forest trained on simulations
of the same prior, which is what a user would do otherwise. Results are kept in `--keep` as they
come, and a second run goes on with them: a folder for each experiment.
`--workers 2` calibrates two at once.

    python -m tests.benchmarks.twins --line --seeds 60 --keep FOLDER

takes of each image only the estimate by the line over the prior that a search starts from: seconds
an image. `--wrong form` or `soil` plants truths in which one species has another growth form, or on
another soil; the share of improbable misfits is the power of the diagnosis. `--apart 200` simulates
so many images of either plot instead and prints how well a classifier knows which is which, of
images left out: how much a diagnosis by these statistics may hope for.

`--sensors image spectrum lidar` calibrates to what several sensors measured of the same truth.
"""

import tempfile
import time
from pathlib import Path
from types import SimpleNamespace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
from scipy.special import ndtri
from scipy.stats import chi2
from sklearn.ensemble import RandomForestClassifier, RandomForestRegressor
from sklearn.linear_model import LogisticRegression, RidgeCV
from sklearn.metrics import roc_auc_score
from sklearn.model_selection import StratifiedKFold, cross_val_predict
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler

from fynjax import inversion
from fynjax._core.parts import Workers, at_work
from fynjax.app.assembly import image_view, plot_problem
from fynjax.app.assembly._targets import reflectance_noise, structure_settings
from fynjax.app.assembly._twin import draw_truth, measure_truth
from fynjax.app.io.plot import CalibrationTable
from fynjax.inversion import (
    BandFactors,
    CalibrationSettings,
    Data,
    ImageView,
    LogPosterior,
    PlotForward,
    PlotSearch,
    Problem,
    StructureView,
    compared_statistics,
    factors_by_view,
    join_data,
    look,
    predicted_statistics,
    search_form,
    spectrum_names,
    spectrum_view,
    stand_table,
    stand_values,
    structure_view,
    weigh_spectrum,
    weigh_structure,
    weigh_targets,
)
from fynjax.metrics import spectral_mask
from fynjax.scene import with_values
from fynjax.sensors import BandSet, shipped_sensor
from tests.benchmarks._measure import data_folder, example_plot, options

FREE = (
    *(f"species.*.{kind}" for kind in ("cover", "diameter", "leaf_area_index", "dead_fraction")),
    *("species.*.leaf.chlorophyll", "species.*.leaf.dry_matter"),
    *("ground.brightness", "ground.litter_fraction"),
)
SENSORS = ("image", "spectrum", "lidar")
SHARES = (0.5, 0.68, 0.9)
STATED = CalibrationTable().target_sd
"""Error of a statistic as a share of it, as a plot file has it by default [-]."""
FOUND = ("truth", "measured", "estimate", "covariance", "misfit", "seconds", "converged")
GRAIN, PULSES, CELLS_APART = 1.0, 100.0, 0.1
"""Of the LiDAR: cells of its metrics [m], pulses [m-2], how cells differ by sampling [-]."""


def wrong_plot(plot, what):
    """The plot as it is, where the model has it otherwise."""
    if what == "form":
        species = list(plot.species)
        i = next(i for i, one in enumerate(species) if one.taxon == "Erica irregularis")
        species[i] = species[i].replace(growth_form="tussock")
        return plot.replace(species=tuple(species))
    if what == "soil":
        soils = np.load(data_folder() / "leaf" / "soil_spectra.npz")
        of = list(soils["name"]).index("ossl_soil_28")  # reddish: 0.11 at 560, 0.24 at 660 nm
        path = Path(tempfile.mkdtemp()) / "soil.csv"
        columns = {"wavelength_nm": soils["wl"], "reflectance": soils["refl"][of]}
        pd.DataFrame(columns).to_csv(path, index=False)
        ground = plot.ground.replace(soil=path, moisture=0.0)
        return plot.replace(ground=ground)
    return plot


def plot_of(size, tiny):
    """The example plot, smaller, with covers free by a half and the rest by 30 %."""
    plot = example_plot(size, tiny)
    priors = {"*.cover": 0.5, "*": 0.3}
    return plot.replace(calibration=plot.calibration.replace(free=FREE, priors=priors))


def measure(problem, views, u, number, random):
    """What sensors measure of the plot at `u`, planted with its own seed: a camera with noise and
    gains, a spectrometer and a LiDAR with the errors that a calibration assumes of them."""
    found = []
    logs = BandFactors.of(views, problem.error).draw_errors(random)
    for view, log in zip(views, factors_by_view(views, jnp.asarray(logs)), strict=True):
        error = None if log is None else np.exp(np.asarray(log))
        value, _ = measure_truth(problem, view, u, number, random, error)
        if isinstance(view, ImageView):
            found.append(weigh_targets(view.names, value, STATED))
            continue
        data = weigh(problem.scene, view, value)
        whitener = np.diag(1.0 / data.sd) if data.whitener is None else np.asarray(data.whitener)
        value = value + np.linalg.solve(whitener, random.normal(size=value.size))
        found.append(weigh(problem.scene, view, value))
    return join_data(found)


def weigh(scene, view, value):
    """A spectrum or metrics of a cloud with their errors."""
    if isinstance(view, StructureView):
        cells = min(scene.grid.extent[:2]) ** 2 / GRAIN**2
        sd = CELLS_APART * np.abs(value) / np.sqrt(cells)
        return weigh_structure(view.names, value, STATED, sd=sd)
    zenith = float(scene.parameters.light.sun_zenith)
    noise = reflectance_noise(view.imager.sensor.bands, value, zenith)
    return weigh_spectrum(view.names, value, STATED, noise=noise)


def view_of(sensor, plot, scene, tiny):
    """Of the drone's camera, AVIRIS-NG in some thirty clear bands, or a LiDAR."""
    if sensor == "image":
        statistics = [n for n in compared_statistics() if "160cm" not in n or min(plot.size_m) >= 5]
        return image_view(plot, scene, scene.parameters, tuple(statistics[:: 9 if tiny else 1]))
    if sensor == "lidar":
        return structure_view(settings=structure_settings(plot)[0], grain=GRAIN, pulses=PULSES)
    bands = shipped_sensor("aviris_ng").bands
    clear = np.flatnonzero(spectral_mask(np.asarray(bands.centre), (420.0, 2440.0)))
    bands = bands.select([int(i) for i in clear[6 :: len(clear) // 28]])
    named = BandSet(spectrum_names(bands), bands.centre, bands.fwhm)
    return spectrum_view(named, scene, scene.parameters)


def simulations(ready, view, count, random, first=0):
    """Draws of the prior and the statistics of coarse renders of them, each planted anew."""
    quick, (cheap,) = search_form(ready.scene, ready.scene.parameters, [view])
    stands = [quick]
    stands += [
        search_form(ready.scene.realisation(first + i), ready.scene.parameters, [view])[0]
        for i in range(1, min(8, count // 4))
    ]
    none = jnp.zeros(len(view.names))
    forward = PlotForward(ready.scene.parameters, ready.free.names, (cheap,))
    data = Data(view.names, none, none + 1)
    draws = random.normal(size=(count, len(ready.free.names))).clip(-2.2, 2.2)
    found = []
    for i, u in enumerate(draws):
        stand = stands[i % len(stands)].reordered(5000 + first + i)
        density = LogPosterior(forward, ready.free, data, none, (stand,))
        found.append(np.asarray(predicted_statistics(density, jnp.asarray(u))))
    return draws, np.array(found)


def line(chosen, ready, truths, view):
    """Estimates by the line over the prior that a search starts from."""
    space, free = ready.free, len(ready.free.names)
    realisations, scatter = (2, 8) if chosen.tiny else (16, 200)
    settings = CalibrationSettings(stand_realisations=realisations, scatter_draws=scatter)
    centre = np.asarray(look((view,), ready.scene, ready.scene.parameters)[0])
    data = weigh_targets(view.names, centre, STATED)
    search = PlotSearch(
        Problem(ready.scene, data, space, views=[view], settings=settings, error=ready.error)
    )
    state = search.begin(jnp.zeros(free))
    place, weights = state.place, search.weights(state.place, state.subspace)
    jacobian = weights @ place.slope
    # Of parameters and factors of the bands together; the former are what is scored.
    covariance = np.linalg.inv(np.eye(jacobian.shape[1]) + jacobian.T @ jacobian)
    twins = []
    for number in range(chosen.seeds):
        random = np.random.default_rng([number, 17])
        truth = draw_truth(free, random)
        measured = np.asarray(measure(truths, (view,), truth, number, random).value)
        rest = weights @ (measured - np.asarray(place.statistics))
        estimate = (covariance @ jacobian.T @ rest)[:free]
        misfit = rest @ np.linalg.solve(np.eye(len(rest)) + jacobian @ jacobian.T, rest)
        twins.append(
            {
                "truth": truth,
                "measured": measured,
                "estimate": estimate,
                "covariance": covariance[:free, :free],
                "misfit": misfit,
                "seconds": np.nan,
                "converged": True,
            }
        )
        print(number, f"probability {chi2.sf(misfit, len(rest)):.4f}", flush=True)
    improbable = np.mean([chi2.sf(t["misfit"], len(jacobian)) < 0.05 for t in twins])
    print(f"misfits of a probability below 0.05: {improbable:.2f}")
    return twins


def explained(truth, estimate):
    """Share of the prior variance that estimates explain, over all truths and parameters."""
    return 1.0 - np.mean((truth - estimate) ** 2) / np.mean(truth**2)


def experiment(size, wrong, sensors, tiny):
    """The plot as the search has it, that of which truths are planted, and the sensors' views."""
    plot = plot_of(size, tiny)
    truths = ready = plot_problem(plot, None, seed=0)
    if wrong is not None:
        truths = plot_problem(wrong_plot(plot, wrong), None, seed=0)
    return ready, truths, tuple(view_of(sensor, plot, ready.scene, tiny) for sensor in sensors)


def twin(number, size, wrong, sensors):
    """A whole calibration of one truth: the arrays of `FOUND`."""
    ready, truths, views = experiment(size, wrong, sensors, False)
    random = np.random.default_rng([number, 17])
    truth = draw_truth(len(ready.free.names), random)
    data = measure(truths, views, truth, number, random)
    began = time.process_time()
    asked = Problem(
        ready.scene, data, ready.free, views=views, error=ready.error,
        settings=CalibrationSettings(seed=number),
    )  # fmt: skip
    found = inversion.fit(asked)
    fit = found.fit
    # Each has as many sites as its draws need, and so programs of its own: nine fill the memory
    # that the compiler may map.
    jax.clear_caches()
    misfit, seconds = 2.0 * found.ends.objective[0], time.process_time() - began
    arrays = (truth, data.value, fit.whitened, fit.covariance, misfit, seconds, fit.converged)
    return tuple(np.asarray(one) for one in arrays)


def apart(count, ready, truths, view):
    """How well images of the two plots can be distinguished by their statistics: coarse renders,
    with gains, without noise of pixels."""
    found = []
    slopes = np.asarray(view.factor_slopes(look((view,), ready.scene, ready.scene.parameters)[1]))
    for i, one in enumerate((ready, truths)):
        random = np.random.default_rng([31, i])
        # Plantings of their own, or pairs of the two would have the same.
        _, simulated = simulations(one, view, count, random, first=2000 * (i + 1))
        gains = random.multivariate_normal(np.zeros(4), view.gains.covariance(4), count)
        found.append(simulated + gains @ slopes.T)
    x, wrong = np.concatenate(found), np.repeat([0, 1], count)
    folds = StratifiedKFold(10, shuffle=True, random_state=0)
    linear = make_pipeline(StandardScaler(), LogisticRegression(C=0.01, max_iter=2000))
    forest = RandomForestClassifier(500, min_samples_leaf=3, random_state=0)
    for name, model in (("logistic regression", linear), ("forest", forest)):
        score = cross_val_predict(model, x, wrong, cv=folds, method="predict_proba")[:, 1]
        power = np.mean(score[wrong == 1] > np.quantile(score[wrong == 0], 0.95))
        area = roc_auc_score(wrong, score)
        print(f"{name}: area under the curve {area:.2f}, known with 5 % false alarms {power:.2f}")


def main(arguments=None):
    """Print the table."""
    parser = options(__doc__)
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--size", type=float, default=5.0)
    parser.add_argument("--train", type=int, default=400)
    parser.add_argument("--keep", type=Path, default=Path("twins"))
    parser.add_argument("--sensors", nargs="+", choices=SENSORS, default=("image",))
    parser.add_argument("--workers", type=int, default=0)
    parser.add_argument("--line", action="store_true")
    parser.add_argument("--apart", type=int)
    parser.add_argument("--wrong", choices=("form", "soil"))
    chosen = parser.parse_args(arguments)
    if chosen.tiny:
        chosen.line, chosen.seeds, chosen.size, chosen.train = True, 2, 2.0, 6
    if (chosen.line or chosen.apart) and tuple(chosen.sensors) != ("image",):
        parser.error("--line and --apart are of the image alone")
    chosen.keep.mkdir(parents=True, exist_ok=True)
    ready, truths, views = experiment(chosen.size, chosen.wrong, chosen.sensors, chosen.tiny)
    if chosen.apart:
        return apart(chosen.apart, ready, truths, views[0])
    if chosen.line:
        twins = line(chosen, ready, truths, views[0])
        return report(chosen, ready, views, twins) if chosen.wrong is None else None
    paths = [chosen.keep / f"twin_{number:03d}.npz" for number in range(chosen.seeds)]
    left = [number for number, path in enumerate(paths) if not path.is_file()]
    with at_work(Workers(chosen.workers)) as pool:
        for i, arrays in pool.each(twin, left, chosen.size, chosen.wrong, chosen.sensors):
            found = dict(zip(FOUND, arrays, strict=True))
            np.savez(paths[left[i]], **found)
            print(paths[left[i]].name, f"{found['seconds']:.0f} CPU s", flush=True)
    report(chosen, ready, views, [np.load(p) for p in sorted(chosen.keep.glob("twin_*.npz"))])


def report(chosen, ready, views, twins):
    names, space = ready.free.names, ready.free
    truth, estimate = (np.stack([t[k] for t in twins]) for k in ("truth", "estimate"))
    sd = np.sqrt(np.stack([np.diagonal(t["covariance"]) for t in twins]))
    score = (truth - estimate) / sd
    print(f"{len(twins)} twins of {chosen.size:g} m, {len(names)} parameters")
    print(f"converged {np.mean([t['converged'] for t in twins]):.2f}")
    if not chosen.line:
        print(f"CPU s a twin, median {np.median([t['seconds'] for t in twins]):.0f}")
    for share in SHARES:
        inside = np.abs(score) < ndtri(0.5 + 0.5 * share)
        # Parameters of one twin hang together: the error is that of the mean over twins.
        error = inside.mean(axis=1).std(ddof=1) / np.sqrt(len(twins))
        print(f"in the {100 * share:.0f} % interval {inside.mean():.3f} +- {error:.3f}")
    print(f"mean of scores {score.mean():.3f}, their sd {score.std():.3f}")
    print(f"expected share of the prior variance removed {1.0 - np.mean(sd**2):.3f}")
    methods = {"calibrate": estimate}
    if chosen.train and tuple(chosen.sensors) == ("image",):
        methods |= regressions(chosen, ready, views[0], twins)
    kinds = [name.split(".", 2)[-1] if name.startswith("species") else name for name in names]
    print(f"{'share of prior variance explained':40s}" + "".join(f"{m:>11s}" for m in methods))
    for kind in dict.fromkeys(kinds):
        place = [i for i, k in enumerate(kinds) if k == kind]
        values = [explained(truth[:, place], m[:, place]) for m in methods.values()]
        print(f"{kind:40s}" + "".join(f"{v:11.2f}" for v in values))
    cover = np.asarray(ready.scene.parameters.species.cover)
    live = [i for i, t in enumerate(ready.scene.taxa) if "dead" not in t.lower()]
    common = sorted(live, key=lambda i: -cover[i])[:6]
    for i in common:
        place = [names.index(f"species.{ready.scene.taxa[i]}.cover")]
        values = [explained(truth[:, place], m[:, place]) for m in methods.values()]
        print(f"cover of {ready.scene.taxa[i]:31s}" + "".join(f"{v:11.2f}" for v in values))
    place = [names.index(f"species.{ready.scene.taxa[i]}.cover") for i in live]
    physical = eqx.filter_jit(lambda u: jax.vmap(space.physical)(u))

    def total(u):
        return np.asarray(physical(jnp.asarray(u)))[:, place].sum(axis=1)

    prior = total(np.random.default_rng(1).normal(size=(500, len(names)))).std()
    errors = [np.sqrt(np.mean((total(truth) - total(m)) ** 2)) for m in methods.values()]
    print(
        f"{f'total live cover, rmse (prior {prior:.3f})':40s}"
        + "".join(f"{e:11.3f}" for e in errors)
    )
    of_the_stand(ready, twins)


def of_the_stand(ready, twins):
    """Numbers of the whole stand: how many truths their 90 % intervals hold, and what the data
    remove of their prior variance."""
    tables = []
    for one in twins:
        fit = SimpleNamespace(
            names=ready.free.names, space=ready.free, whitened=jnp.asarray(one["estimate"]),
            covariance=one["covariance"],
        )  # fmt: skip
        table = stand_table(ready.scene, ready.scene.parameters, fit)
        there = with_values(
            ready.scene.parameters, ready.scene.taxa, ready.free.named(jnp.asarray(one["truth"]))
        )
        truth = np.array([float(v) for v in stand_values(ready.scene.expected(), there).values()])
        table["inside"] = (table.q05 <= truth) & (truth <= table.q95)
        tables.append(table.set_index("name")[["inside", "constrained"]].astype(float))
    print(sum(tables).div(len(tables)).round(2).to_string())
    inside = np.array([table.inside.mean() for table in tables])
    spread = inside.std(ddof=1) / np.sqrt(len(inside))
    print(f"numbers of the stand in their 90 % intervals {inside.mean():.3f} +- {spread:.3f}")


def regressions(chosen, ready, view, twins):
    """Estimates by ridge regression and a random forest on simulations of the prior."""
    path = chosen.keep / f"train_{chosen.train}.npz"
    if path.is_file():
        kept = np.load(path)
        draws, simulated = kept["draws"], kept["simulated"]
    else:
        draws, simulated = simulations(ready, view, chosen.train, np.random.default_rng(23))
        np.savez(path, draws=draws, simulated=simulated)
    # What a coarse render lacks against a full one, at the prior's centre.
    quick, (cheap,) = search_form(ready.scene, ready.scene.parameters, [view])
    whole = np.asarray(look((view,), ready.scene, ready.scene.parameters)[0])
    lack = whole / np.asarray(look((cheap,), quick, ready.scene.parameters)[0])
    random = np.random.default_rng(29)
    gains = random.multivariate_normal(np.zeros(4), view.gains.covariance(4), len(draws))
    slopes = np.asarray(view.factor_slopes(look((view,), ready.scene, ready.scene.parameters)[1]))
    noisy = simulated * lack + gains @ slopes.T
    scale = StandardScaler().fit(noisy)
    x, measured = scale.transform(noisy), scale.transform([t["measured"] for t in twins])
    ridge = RidgeCV(np.logspace(0, 5, 11)).fit(x, draws).predict(measured)
    forest = RandomForestRegressor(200, min_samples_leaf=3, random_state=0).fit(x, draws)
    return {"ridge": ridge, "forest": forest.predict(measured)}


if __name__ == "__main__":
    main()

"""Views of several sensors: their numbers, slopes and errors, and a calibration to all of them."""

import dataclasses
from types import SimpleNamespace
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import jaxopt
import numpy as np
import optimistix as optx
import pytest
import scipy.optimize

from fynjax._core.checkpoint import forget_journal, signature
from fynjax._core.errors import InputError
from fynjax.app.jobs._follow import follow
from fynjax.app.jobs._run import Run
from fynjax.inversion import (
    COARSE,
    AbstractView,
    BroydenLM,
    CalibrationSettings,
    Data,
    FitStatus,
    ImageView,
    LogPosterior,
    PlotForward,
    PlotSearch,
    _expected,
    _search,
    _views,
    calibration,
    fit,
    fit_surrogate,
    free_space,
    join_data,
    predicted_statistics,
    search_form,
    search_starts,
    spectrum_view,
    statistics_and_jacobian,
    structure_view,
    weigh_spectrum,
    weigh_structure,
    weigh_targets,
    whitened_residual,
)
from fynjax.inversion._fit_result import scatter_covariance, scatter_of_views, status_of
from fynjax.inversion._search import Expectation
from fynjax.inversion._views import Directions, informative_directions, multiplied, under_sun
from fynjax.metrics.structure import STRUCTURE_METRICS, voxel_structure
from fynjax.radiation import parallel_rays, reflectance_factor, solve_light
from fynjax.scene import ModelError, Scene, with_values
from fynjax.scene._optics import seen_from_above
from fynjax.sensors import BandSet, Gains
from tests.heard import hearing
from tests.problems import calibrate_plot, search_of
from tests.scene.plots import TAXA, densities, drone, small_parameters, small_plot

BAND_MEANS = ("green.mean", "red.mean", "red_edge.mean", "nir.mean")
BANDS = BandSet(("a", "b", "c"), (550.0, 860.0, 1650.0), (20.0, 20.0, 20.0))
FREE = ("species.Erica irregularis.cover", "species.*.height", "*irregularis.leaf.water")
ACCURACY = dataclasses.replace(COARSE, coarsening=(2, 2), levels=1, tolerance=1e-11, iterations=200)


@pytest.fixture(scope="module")
def plot():
    """A plot of 2 m, its parameters and three kinds of free ones."""
    model, parameters = small_plot(extent=(2.0, 2.0)), small_parameters()
    return model, parameters, free_space(model, parameters, FREE, lambda _: 0.2)


def views_of(scene, accuracy):
    """Of a drone, a spectrometer and a LiDAR."""
    return (
        ImageView(("red.mean", "nir.mean", "NDVI.std"), drone(scene, accuracy)),
        spectrum_view(BANDS, scene, small_parameters(), accuracy),
        structure_view(grain=1.0),
    )


@pytest.fixture(scope="module")
def views(plot):
    return views_of(plot[0], ACCURACY)


def test_names_carry_the_sensor_but_for_the_drone(views):
    assert views[0].names == ("red.mean", "nir.mean", "NDVI.std")
    assert views[1].names == ("spectrum.550nm", "spectrum.860nm", "spectrum.1650nm")
    assert views[2].names[1] == "lidar.gap_fraction"


@pytest.mark.parametrize("together", [6, 2])
def test_a_spectrum_is_the_mean_of_the_plot_in_its_bands(plot, views, together, monkeypatch):
    """Against all of its bands solved for at once; in twos, of which the last repeats a band."""
    monkeypatch.setattr(_views, "_TOGETHER", together)
    model, parameters, _ = plot
    at = jnp.arange(20) * 0.1 + 0.05
    rays = parallel_rays(at, at, 0.1, jnp.zeros(()), jnp.zeros(()))
    every = eqx.filter_jit(
        lambda m, p: reflectance_factor(solve_light(m.voxels(p, BANDS), ACCURACY), rays)
    )
    expected = every(model, parameters).mean(axis=(1, 2))
    found = eqx.filter_jit(lambda m, p: views[1].predict(m, p))(model, parameters)
    np.testing.assert_allclose(found, expected, rtol=1e-8)

    def plot_at(u):
        return with_values(parameters, model.taxa, {"ground.brightness": u[0]})

    u = jnp.array([0.8])
    _, slopes = eqx.filter_jit(lambda u: views[1].jacobian(model, plot_at, u))(u)
    up, down = (every(model, plot_at(u + step)).mean(axis=(1, 2)) for step in (0.01, -0.01))
    np.testing.assert_allclose(slopes[:, 0], (up - down) / 0.02, rtol=1e-3)


def test_structure_is_that_of_all_that_a_beam_can_hit(plot, views):
    """Spherical normals: the projected area of leaves, wood and flowers is half of it."""
    model, parameters, _ = plot
    found = eqx.filter_jit(views[2].predict)(model, parameters)
    density = densities(model, parameters)
    share = np.asarray(seen_from_above(model.species))
    assert share.shape == (density.shape[0],)
    assert np.all(share[-2:] == 0.5)
    effective = jnp.einsum("c,czyx->zyx", share, density)
    layers = int(np.ceil((model.grid.extent[2] - 0.25) / 0.25))
    size = {"voxel": (0.1, 0.1), "grain": 1.0, "pulses": 100.0, "layers": layers}
    other = jax.jit(
        lambda area: voxel_structure(area, views[2].settings, projection=1.0, **size).means()
    )(effective)
    np.testing.assert_allclose(found, [other[m] for m in STRUCTURE_METRICS], rtol=1e-9)
    gap = np.exp(-np.asarray(effective).sum(axis=0) * 0.1).mean()
    assert float(found[1]) >= gap  # below 10 cm as well


@pytest.mark.parametrize(
    "number", [pytest.param(0, marks=pytest.mark.study), 1, 2], ids=["drone", "spectrum", "lidar"]
)
def test_slopes_of_each_view_are_those_of_central_differences(plot, views, number):
    """As a search has them; contracted to one number, along each free parameter.

    Of plants that fade: their value moves with their number as the slope says.
    """
    model, parameters, space = plot
    model = model.expected()
    coarse = views[number].for_search(model, ACCURACY, 3)
    predict = PlotForward(parameters, space.names, [coarse])
    none = jnp.zeros(len(coarse.names))
    density = LogPosterior(predict, space, Data(coarse.names, none, none + 1), none, (model,))
    u = 0.3 * jnp.arange(-2.0, len(space.names) - 2.0)
    value, rows = statistics_and_jacobian(density, u)
    weight = np.random.default_rng(5).normal(size=value.size) / np.asarray(value)
    step = 1e-5
    for i in range(u.size):
        up, down = (predicted_statistics(density, u.at[i].add(h)) for h in (step, -step))
        difference = weight @ np.asarray(up - down) / (2 * step)
        assert float(weight @ rows[:, i]) == pytest.approx(difference, rel=2e-5, abs=1e-8)
    seen = np.abs(np.asarray(rows)).max(axis=0)
    assert seen[0] > 0.0
    if number == 2:  # a LiDAR knows nothing of the water in a leaf
        assert seen[-1] == 0.0


def test_a_second_forward_model_of_the_same_shapes_compiles_nothing(plot, views):
    """Parameters and lines of sight are leaves: another plot's are other numbers of one program."""
    model, parameters, space = plot
    traced = []

    @eqx.filter_jit
    def predict(forward, values, scene):
        traced.append(1)
        return forward(values, scene)

    at, results = space.prior, []
    other = with_values(parameters, TAXA, {"ground.brightness": jnp.asarray(0.5)})
    for plant, start in ((model, parameters), (model.reordered(1), other)):
        quick, coarse = search_form(plant, start, views[1:2], accuracy=ACCURACY)
        results.append(predict(PlotForward(start, space.names, coarse), at, quick))
    assert traced == [1]
    assert np.abs(results[0] - results[1]).max() > 1e-3


def test_errors_of_a_spectrum_are_shared_by_its_bands():
    value, noise = np.array([0.1, 0.4]), np.array([0.002, 0.01])
    sampling = np.array([[4e-5, 1e-5], [1e-5, 9e-5]])
    data = weigh_spectrum(
        ("a", "b"), value, 0.02, noise=noise, sampling=sampling, gain=0.03, offset=0.004
    )
    together = 0.03**2 * 0.1 * 0.4 + 0.004**2 + 1e-5
    alone = [
        (0.02 * v) ** 2 + n**2 + (0.03 * v) ** 2 + 0.004**2 + s
        for v, n, s in zip(value, noise, (4e-5, 9e-5))
    ]
    covariance = np.linalg.inv(np.asarray(data.whitener.T @ data.whitener))
    expected = [[alone[0], together], [together, alone[1]]]
    np.testing.assert_allclose(covariance, expected, rtol=1e-10)
    np.testing.assert_allclose(data.sd, np.sqrt(alone))
    # A factor common to all bands costs little, the same deviations with unlike signs are not.
    gain, shape = (
        float(jnp.sum(data.whiten(jnp.asarray(d)) ** 2)) for d in ([0.003, 0.012], [0.003, -0.012])
    )
    assert gain < 0.6 * shape


def test_structure_has_the_error_of_its_cells_and_of_the_model():
    data = weigh_structure(("a", "b"), np.array([0.4, 2.0]), 0.02, sd=np.array([0.03, 0.0]))
    np.testing.assert_allclose(data.sd, [np.hypot(0.03, 0.02), 0.1])
    with pytest.raises(InputError, match="relative_sd"):
        weigh_structure(("a",), np.ones(1), 0.0, sd=np.ones(1))


def test_joined_targets_keep_their_errors_apart():
    drone = weigh_targets(("red.mean", "nir.mean"), np.array([0.05, 0.3]), 0.02)
    spectrum = weigh_spectrum(("s",), np.array([0.3]), 0.02)
    both = join_data([drone, spectrum])
    assert both.names == ("red.mean", "nir.mean", "s")
    rest = jnp.array([0.01, -0.02, 0.05])
    apart = jnp.concatenate([drone.whiten(rest[:2]), spectrum.whiten(rest[2:])])
    np.testing.assert_allclose(both.whiten(rest), apart)
    plain = join_data([drone, Data(("x",), jnp.ones(1), jnp.ones(1))])
    assert plain.whitener is None
    assert join_data([drone]) is drone


# -- the calibration ------------------------------------------------------------------------


class Sums(AbstractView):
    """Numbers of a plot that need neither plants nor light, so that nothing takes long."""

    names: tuple[str, ...] = eqx.field(static=True, default=("a", "b", "c", "d"))
    lack: float = eqx.field(static=True, default=0.0)
    """What the coarse form is off by."""

    def observe(self, model, parameters):
        height, cover = parameters.species.height, parameters.species.cover
        found = [height @ cover, height[0] ** 2, cover[1] * height[1], jnp.sum(cover)]
        return None, jnp.stack(found) + self.lack * height[0] ** 2

    def for_search(self, scene, accuracy, stride):
        return dataclasses.replace(self, lack=0.02)


HEIGHTS = ("species.*.height", "species.*.cover")


@pytest.fixture(scope="module")
def sums():
    """A plot, parameters to start from, targets of another plot, and the free space."""
    model, truth = small_plot(extent=(2.0, 2.0), dtype="float32"), small_parameters()
    value = np.asarray(Sums().predict(model, truth), float)
    data = weigh_structure(Sums().names, value, 0.02, sd=np.zeros(value.size))
    off = {"species.Erica irregularis.height": 0.8, "species.Restio eleocharis.cover": 0.1}
    start = with_values(truth, TAXA, {n: jnp.asarray(v) for n, v in off.items()})
    return model, start, data, free_space(model, start, HEIGHTS, lambda _: 0.3)


def calibrated(sums, view=Sums(), **options):  # noqa: B008
    fields = {field.name for field in dataclasses.fields(CalibrationSettings)}
    chosen = {name: options.pop(name) for name in fields & set(options)}
    settings = CalibrationSettings(
        **{"stand_realisations": 2, "scatter_draws": 3, "max_steps": 6} | chosen
    )
    return calibrate_plot(*sums, (view,), settings, **options)


class Stop(Exception):
    """What interrupts a run."""


def followed(sums, folder, **options):
    """The same calibration, its states kept in `folder`."""
    settings = {"stand_realisations": 2, "scatter_draws": 3, "max_steps": 6} | options
    search = search_of(*sums, (Sums(),), CalibrationSettings(**settings))
    return calibration(search, follow(search, search_starts(search), Run(folder), folder))


@pytest.fixture(scope="module")
def whole(sums):
    return calibrated(sums)


@pytest.mark.parametrize("count", [1, 3, 5])
def test_an_interrupted_run_ends_at_the_same_bits(sums, whole, tmp_path, count):
    folder = tmp_path / "kept"
    with pytest.raises(Stop), hearing(count + 1, Stop):
        followed(sums, folder)
    with hearing() as heard:
        found = followed(sums, folder)
    assert heard.count == len(whole.fit.loss)
    for name in ("estimate", "sd", "loss", "predicted", "covariance"):
        np.testing.assert_array_equal(getattr(found.fit, name), getattr(whole.fit, name))
    np.testing.assert_array_equal(found.statistics_after, whole.statistics_after)
    assert found.fit.status == whole.fit.status
    forget_journal(folder)
    assert not folder.exists()


def test_a_search_from_several_starts_goes_on_within_any_of_them(sums, tmp_path):
    """The second start shares sites and subspace with the first, which is read again."""
    folder = tmp_path / "kept"
    with hearing() as heard:
        whole = followed(sums, tmp_path / "whole", starts=2)
    with pytest.raises(Stop), hearing(heard.count - 2, Stop):
        followed(sums, folder, starts=2)
    assert {path.name for path in folder.glob("*.npz")} == {
        f"calibration.start_{number}.npz" for number in (1, 2)
    }
    (folder / "calibration.start_2.npz.work").write_bytes(b"cut while it was written")
    found = followed(sums, folder, starts=2)
    np.testing.assert_array_equal(found.ends.whitened, whole.ends.whitened)
    np.testing.assert_array_equal(found.ends.objective, whole.ends.objective)
    np.testing.assert_array_equal(found.fit.covariance, whole.fit.covariance)
    with pytest.raises(InputError, match="checkpoint is of another run"):
        followed(sums, folder, starts=3)
    forget_journal(folder)
    assert not folder.exists()


def test_a_calibration_tells_of_each_evaluation(sums):
    with hearing() as heard:
        found = calibrated(sums, max_steps=2)
    assert heard.stages == [("Calibrate", 5)]
    assert heard.count == len(found.fit.loss)
    assert heard.shown[0] == {
        "stage": "round 1",
        "loss": f"{found.fit.loss[0]:.1f}",
        "gradient": f"{found.fit.gradient_norm[0]:.1f}",
    }


@pytest.mark.parametrize(("most", "tolerance"), [(2, 1e-20), (12, 0.05)])
def test_the_steps_that_are_said_are_those_done(sums, monkeypatch, most, tolerance):
    """Whether rounds converged or came to the limit: with the objective at the beginning of each
    round and after each step."""
    done = []
    real = BroydenLM.step
    monkeypatch.setattr(BroydenLM, "step", lambda *a: (done.append(1), real(*a))[1])
    fit = calibrated(sums, max_steps=most, tolerance=tolerance).fit
    assert bool(fit.converged) == (most == 12), fit.explanation
    count, rounds = len(done), int(fit.rounds[-1])
    assert int(fit.steps) == count > 1
    assert len(fit.loss) == count + rounds
    assert f"after {count} steps in {rounds} rounds" in fit.explanation
    assert ("limit of steps of a round" in fit.explanation) == (most == 2)


def test_steps_of_another_solver_are_counted(sums):
    found = calibrated(sums, solver=optx.LevenbergMarquardt(1e-4, 1e-4), stand_realisations=0)
    assert int(found.fit.steps) > int(found.fit.rounds[-1]) == len(found.fit.loss)


def test_what_was_kept_is_not_done_again(sums, whole, tmp_path, monkeypatch):
    """A finished calibration is read, not computed: no step of the search may run."""
    folder = tmp_path / "kept"
    followed(sums, folder)

    def never(*_):
        raise AssertionError("this was computed before")

    for name in ("begin", "step"):
        monkeypatch.setattr(PlotSearch, name, never)
    found = followed(sums, folder)
    np.testing.assert_array_equal(found.fit.estimate, whole.fit.estimate)


def test_a_checkpoint_of_another_calibration_is_refused(sums, tmp_path):
    model, start, data, space = sums
    folder = tmp_path / "kept"
    with pytest.raises(Stop), hearing(2, Stop):
        followed(sums, folder)
    other = Data(data.names, data.value.at[0].mul(1.001), data.sd)
    for changed, options in (
        ((model, start, other, space), {}),
        ((model.reordered(1), start, data, space), {}),
        (sums, {"max_steps": 5}),
    ):
        with pytest.raises(InputError, match="checkpoint is of another run"):
            followed(changed, folder, **options)
    (last,) = folder.glob("*.npz")
    last.write_bytes(last.read_bytes()[:50])
    with pytest.raises(InputError, match="damaged one"):
        followed(sums, folder)


@pytest.mark.parametrize(
    "solver",
    [
        pytest.param(None, id="default"),
        pytest.param(BroydenLM(), id="BroydenLM"),
        pytest.param(optx.LevenbergMarquardt(1e-4, 1e-4), id="optimistix LevenbergMarquardt"),
        pytest.param(optx.Dogleg(1e-4, 1e-4), id="optimistix Dogleg"),
        pytest.param(optx.BFGS(1e-6, 1e-6), id="optimistix BFGS"),
        pytest.param(
            jaxopt.LBFGSB(fun=jnp.sum, tol=1e-3), id="jaxopt LBFGSB", marks=pytest.mark.study
        ),
        pytest.param(
            jaxopt.ProjectedGradient(
                fun=jnp.sum, projection=jaxopt.projection.projection_box, tol=1e-3
            ),
            id="jaxopt ProjectedGradient",
            marks=pytest.mark.study,
        ),
    ],
)
def test_any_solver_fits_a_plot(sums, solver):
    """In the same call, with the plot's scene as context, to the same minimum."""
    model, start, data, space = sums
    forward = PlotForward(start, space.names, (Sums(),))
    found = fit(forward, data, space, solver=solver, max_steps=200, context=(model.expected(),))
    assert found.converged, found.explanation
    residual = whitened_residual(forward, data, space, context=(model.expected(),))
    best = scipy.optimize.least_squares(
        lambda u: np.asarray(residual(jnp.asarray(u))), np.zeros(len(space.names))
    )
    sd = np.sqrt(np.diagonal(np.linalg.inv(best.jac.T @ best.jac)))
    assert np.abs((np.asarray(found.whitened) - best.x) / sd).max() < 0.1


def test_other_starts_end_in_the_same_minimum(sums, whole):
    found = calibrated(sums, starts=3, max_steps=12, tolerance=1e-3)
    ends = found.ends
    assert ends.objective.shape == (3,)
    assert ends.whitened.shape == (3, len(found.fit.names))
    assert ends.minima == 1
    assert ends.apart.max() < 1.0
    assert float(found.fit.loss[-1]) == pytest.approx(ends.objective.min(), rel=0.2)
    assert whole.ends.minima == 1
    np.testing.assert_allclose(whole.ends.apart, [0.0])


def test_views_must_be_those_of_the_data(sums, views):
    model, start, data, space = sums
    with pytest.raises(InputError, match="`views` must yield"):
        calibrate_plot(model, start, data, space, views)
    with pytest.raises(InputError, match="`views` must yield"):
        calibrate_plot(model, start, data, space, (Sums(), *views))
    with pytest.raises(InputError, match="`starts` must be at least 1"):
        calibrated(sums, starts=0)


class Beyond(Sums):
    """Its full form is not a number where the search would go."""

    def observe(self, model, parameters):
        _, found = super().observe(model, parameters)
        lost = (self.lack == 0.0) & (parameters.species.height[0] < 0.79)
        return None, jnp.where(lost, jnp.nan, found)


@pytest.mark.parametrize("stands", [0, 2])
def test_a_search_that_loses_a_statistic_keeps_what_it_found_before(sums, stands):
    """The start, with the errors there, the chance of plantings among them."""
    found = calibrated(sums, Beyond(), stand_realisations=stands)
    assert found.fit.status == FitStatus.no_gain
    np.testing.assert_allclose(found.fit.whitened, 0.0)
    assert np.isfinite(found.statistics_after).all()
    assert found.misfit == pytest.approx(2.0 * found.ends.objective[0])
    larger = np.asarray(found.data.sd) > 1.0001 * np.asarray(sums[2].sd)
    assert larger.all() if stands else not larger.any()


def test_what_a_broyden_solver_is_asked_for_counts_in_a_calibration(sums, monkeypatch):
    """Steps that are cut, with new slopes once a round as without it; and its tolerance. Further
    rounds of three steps follow, as each still moved."""
    count = []
    real = _expected.predicted_slopes
    monkeypatch.setattr(_expected, "predicted_slopes", lambda *a: (count.append(1), real(*a))[1])
    cut = calibrated(sums, rounds=1, stand_realisations=0, solver=BroydenLM(longest=0.05))
    further = len(count) - 1  # rounds
    assert 3 <= further <= 5
    # Of full length, but for those of the last round.
    steps = np.abs(np.asarray(cut.fit.whitened)).max() / 0.05
    assert 3 + 3 * further < steps < 6.01 + 3 * further
    loose, exact = (
        calibrated(sums, rounds=1, stand_realisations=0, max_steps=12, solver=BroydenLM(atol=atol))
        for atol in (0.05, 1e-8)
    )
    assert int(exact.fit.steps) > int(loose.fit.steps)


def test_a_checkpoint_knows_the_solver(sums):
    settings = CalibrationSettings(stand_realisations=0)
    signed = [
        signature(search_of(*sums, (Sums(),), settings, solver=solver).signed)
        for solver in (
            None,
            optx.Dogleg(1e-4, 1e-4),
            optx.Dogleg(1e-6, 1e-4),
            BroydenLM(longest=1.0),
        )
    ]
    assert len(set(signed)) == len(signed)


class Broken(Sums):
    """Is not a number, or has such a slope, though only where a search looks."""

    bad: str = eqx.field(static=True, default="value")

    def observe(self, model, parameters):
        _, found = super().observe(model, parameters)
        if self.bad == "value":
            return None, found.at[1].set(jnp.nan)
        # A root whose slope at zero is infinite, times zero.
        root = jnp.sqrt(0.0 * parameters.species.height[0])
        return None, found if self.lack == 0.0 else found + 0.0 * root


def test_a_loss_or_slope_that_is_not_finite_is_said(sums):
    with pytest.raises(InputError, match="the statistic b is not finite at the start"):
        calibrated(sums, Broken())
    found = calibrated(sums, Broken(bad="slope"))
    assert not found.fit.converged
    assert "slope of a by species.Erica irregularis.height is not finite" in found.fit.explanation
    np.testing.assert_allclose(found.fit.sd, found.fit.space.prior_sd, rtol=1e-6)
    np.testing.assert_allclose(found.fit.estimate, found.fit.space.prior, rtol=1e-6)


def test_a_parameter_that_nothing_depends_on_is_named(sums):
    model, start, data, _ = sums
    space = free_space(model, start, ("species.*.height", "ground.brightness"), lambda _: 0.3)
    found = calibrated((model, start, data, space), rounds=1)
    assert "No statistic depends on ground.brightness: flat" in found.fit.explanation
    i = found.fit.names.index("ground.brightness")
    assert float(found.fit.estimate[i]) == pytest.approx(float(space.prior[i]))


def test_a_search_that_starts_at_its_optimum_has_converged(sums):
    model, start, data, space = sums
    value = jnp.asarray(Sums().predict(model, start), float)
    same = Data(data.names, value, data.sd)
    found = calibrated((model, start, same, space), stand_realisations=0)
    assert found.fit.converged
    np.testing.assert_allclose(found.fit.whitened, 0.0, atol=1e-9)
    assert int(found.fit.steps) == 0
    assert found.fit.rounds.tolist() == [1, 2]  # one look a round


class Misleading(Sums):
    """Its coarse form falls where the full one rises."""

    def for_search(self, scene, accuracy, stride):
        return dataclasses.replace(self, lack=-3.0)


def test_a_search_without_gain_ends_at_its_start(sums):
    fixed = dataclasses.replace(sums[0], planted=None)  # which gets no more sites
    found = calibrated((fixed, *sums[1:]), Misleading(), rounds=1, stand_realisations=0)
    assert found.fit.status == FitStatus.no_gain
    np.testing.assert_allclose(found.fit.whitened, 0.0)
    np.testing.assert_allclose(found.fit.predicted, found.statistics_after)
    np.testing.assert_allclose(found.statistics_after, found.statistics_before)


def test_of_known_plants_the_best_place_is_kept(sums):
    """With the reason of the round that led there, or of one that ended there too."""
    search = search_of(*sums, (Sums(),), CalibrationSettings(stand_realisations=0))
    (u,) = search_starts(search)
    state = search.begin(u)
    start = state.best
    near, far = (dataclasses.replace(start, u=start.u + away) for away in (1e-3, 1.0))
    better = dataclasses.replace(far, statistics=sums[2].value)
    good, stopped, none = FitStatus.successful, FitStatus.max_steps, FitStatus.no_gain
    for place, reason, kept, status in (
        (better, stopped, better, stopped),
        (far, good, start, none),
        (near, stopped, start, none),
        (near, good, start, good),
    ):
        best, number = search._better(state, place, reason, fresh=False)
        assert best is kept
        assert status_of(number) == status


def test_slopes_are_computed_few_times(sums, monkeypatch):
    """Steps correct them; they are new at the start of a round."""
    count = []
    real = _expected.predicted_slopes
    monkeypatch.setattr(_expected, "predicted_slopes", lambda *a: (count.append(1), real(*a))[1])
    monkeypatch.setattr(_search, "is_new", lambda *_: False)  # nothing is compiled ahead
    found = calibrated(sums, max_steps=12)
    assert found.fit.converged
    assert len(found.fit.loss) > 2
    assert len(count) == 2 * 3  # of two draws, in three rounds: the second still moved


# -- plantings ------------------------------------------------------------------------------


class Chance(AbstractView):
    """Linear in the parameters, with slopes and values that hang on where plants stand."""

    names: tuple[str, ...] = eqx.field(static=True, default=("a", "b", "c"))

    def observe(self, model, parameters):
        e = model.planting.place[:3].astype(float)
        cover = parameters.species.cover
        return None, jnp.stack([cover[0], cover[1], cover[0] + cover[1]]) * (1.0 + 0.1 * e) + e

    def for_search(self, scene, accuracy, stride):
        return self


@pytest.fixture(scope="module")
def chance(sums):
    """A plot whose plantings are normal draws of known covariance."""
    model, _, _, _ = sums
    parameters = small_parameters()
    root = 0.02 * np.array([[1.0, 0.0, 0.0], [0.5, 1.0, 0.0], [0.0, -0.5, 1.0]])
    fields = {f.name: getattr(model, f.name) for f in dataclasses.fields(model)}

    class Drawn(Scene):
        def realisation(self, number, counts=None):
            drawn = root @ np.random.default_rng([number, 5]).normal(size=3)
            changed = np.concatenate([drawn, np.asarray(self.planting.place, float)[3:]])
            return eqx.tree_at(lambda m: m.planting.place, self, jnp.asarray(changed))

    plot = Drawn(**fields).realisation(0)

    def space(relative_sd):
        free = [f"species.{taxon}.cover" for taxon in TAXA[:2]]
        return free_space(model, parameters, free, lambda _: relative_sd)

    return parameters, space, root, plot


def test_data_count_as_one_draw_of_what_plantings_scatter(chance):
    """Against the normal equations with the expectation and the covariance over plantings, where
    statistics are linear over the posterior."""
    parameters, space, root, plot = chance
    space = space(0.03)
    count = 40
    cover = np.asarray(parameters.species.cover)[:2]
    value = jnp.asarray([*(cover * [1.05, 0.97]), cover.sum()])
    data = Data(Chance().names, value, jnp.full(3, 0.01))
    settings = CalibrationSettings(
        stand_realisations=count, scatter_draws=count, rounds=3, tolerance=1e-5
    )
    found = calibrate_plot(plot, parameters, data, space, [Chance()], settings)
    assert found.fit.converged
    places = [np.asarray(plot.realisation(i).planting.place)[:3] for i in range(count)]
    cover = np.asarray(found.after.species.cover)
    values = np.array([cover[0], cover[1], cover[0] + cover[1]])
    draws = np.array([values * (1.0 + 0.1 * e) + e for e in places])
    # The full form is that of fewer plantings, but it is the coarse one: nothing is lacking.
    np.testing.assert_allclose(found.statistics_after, draws.mean(axis=0), rtol=1e-3)
    extra = np.asarray(found.data.covariance) - 0.01**2 * np.eye(3)
    sample = np.cov(draws.T)
    np.testing.assert_allclose(np.diagonal(extra), np.diagonal(sample) * (1 + 1 / count), rtol=5e-3)
    true = root @ root.T
    assert abs(extra[0, 1] / true[0, 1] - 1.0) < 0.5
    # The slope of the objective is zero there, with the mean of the slopes.
    slopes = (1.0 + 0.1 * np.mean(places, axis=0))[:, None] * np.array([[1, 0], [0, 1], [1, 1]])
    jacobian = slopes * np.asarray(space.slope(found.fit.whitened))
    rest = found.data.whiten(jnp.asarray(found.statistics_after - data.value))
    gradient = np.asarray(found.data.whiten(jnp.asarray(jacobian))).T @ rest + found.fit.whitened
    assert np.abs(gradient).max() < 0.2
    information = np.asarray(found.data.whiten(jnp.asarray(jacobian)))
    expected = np.linalg.inv(np.eye(2) + information.T @ information)
    np.testing.assert_allclose(found.fit.covariance, expected, rtol=0.05, atol=1e-4)


class Seen(Chance):
    """One of several frames that see the same."""

    view: str = eqx.field(static=True, default="")


def test_frames_of_one_flight_share_their_chance(chance):
    """Few draws of statistics that are equal in all frames: so are their errors."""
    parameters, space, _, plot = chance
    views = [Seen(view=f"v{k}") for k in range(6)]
    names = tuple(name for view in views for name in view.statistic_names)
    cover = np.asarray(parameters.species.cover)[:2]
    value = jnp.tile(jnp.asarray([*cover, cover.sum()]), 6)
    data = Data(names, value, jnp.full(18, 0.002))
    settings = CalibrationSettings(stand_realisations=6, scatter_draws=6, rounds=1)
    found = calibrate_plot(plot, parameters, data, space(0.03), views, settings)
    error = np.asarray(found.data.covariance) - 0.002**2 * np.eye(18)
    own = np.sqrt(np.diagonal(error))
    between = (error / np.outer(own, own)).reshape(6, 3, 6, 3)
    assert min(between[0, k, v, k] for k in range(3) for v in range(1, 6)) > 0.97


@pytest.mark.study
def test_estimates_over_truths_have_the_stated_spread(chance):
    """Simulation-based calibration: truths of the prior, planted with seeds of their own."""
    parameters, space, _, stand = chance
    space = space(0.3)
    settings = CalibrationSettings(stand_realisations=24, scatter_draws=24, rounds=1)
    random, scores, chi = np.random.default_rng(3), [], []
    for number in range(40):
        truth = random.normal(size=2)
        plot = with_values(parameters, TAXA, space.named(jnp.asarray(truth)))
        value = Chance().predict(stand.realisation(500 + number), plot) + 0.01 * random.normal(
            size=3
        )
        data = Data(Chance().names, value, jnp.full(3, 0.01))
        found = calibrate_plot(stand, parameters, data, space, [Chance()], settings)
        sd = np.sqrt(np.diagonal(found.fit.covariance))
        scores.append((truth - np.asarray(found.fit.whitened)) / sd)
        chi.append(found.misfit)
    scores = np.array(scores)
    # Eighty scores of unit normals, but for the two dozen plantings: sd of their sd is 0.08.
    assert 0.8 < np.sqrt(np.mean(scores**2)) < 1.25
    assert 2.0 < np.mean(chi) < 4.5  # chi-square of three
    assert np.mean(np.array(chi) > 7.81) < 0.2


class Hinge(AbstractView):
    """Flat below the prior's centre, linear above: as of plants that are not there yet."""

    centre: float = eqx.field(static=True)
    names: tuple[str, ...] = eqx.field(static=True, default=("a",))

    def observe(self, model, parameters):
        return None, jnp.maximum(parameters.species.cover[:1] / self.centre - 1.0, 0.0)

    def for_search(self, scene, accuracy, stride):
        return self


def test_slopes_hold_over_what_is_unknown(chance):
    """The line that is best for a unit normal number above zero has the slope 1/2, and what it
    leaves has the variance 1/2 - 1/(2 pi) - 1/4."""
    parameters, space, _, stand = chance
    view = Hinge(float(parameters.species.cover[0]))
    data = Data(view.names, jnp.array([0.03 / np.sqrt(2.0 * np.pi)]), jnp.array([0.1]))
    settings = CalibrationSettings(stand_realisations=100, scatter_draws=400, rounds=1)
    found = calibrate_plot(stand, parameters, data, space(0.03), [view], settings)
    assert float(found.fit.jacobian[0, 0]) == pytest.approx(0.5 * 0.03, rel=0.1)
    left = float(found.data.sd[0] ** 2 - 0.1**2) / 0.03**2
    assert left == pytest.approx(0.25 - 0.5 / np.pi, rel=0.15)


class Bent(AbstractView):
    """An exponential: it grows by e with each standard deviation of the prior."""

    centre: float = eqx.field(static=True)
    names: tuple[str, ...] = eqx.field(static=True, default=("a",))

    def observe(self, model, parameters):
        return None, jnp.exp((parameters.species.cover[:1] / self.centre - 1.0) / 0.3)

    def for_search(self, scene, accuracy, stride):
        return self


def test_estimates_have_the_stated_spread_where_statistics_bend(chance):
    """Data that tell much: a line over the prior is far from one over the posterior, so rounds
    must follow until both agree."""
    parameters, space, _, stand = chance
    space, view = space(0.3), Bent(float(parameters.species.cover[0]))
    settings = CalibrationSettings(scatter_draws=16)
    random, scores = np.random.default_rng(3), []
    for _ in range(24):
        truth = random.normal(size=2)
        plot = with_values(parameters, TAXA, space.named(jnp.asarray(truth)))
        value = view.predict(stand, plot) * (1.0 + 0.1 * random.normal())
        data = Data(view.names, value, 0.1 * value)
        found = calibrate_plot(stand, parameters, data, space, [view], settings)
        sd = np.sqrt(np.diagonal(found.fit.covariance))[0]
        scores.append((truth[0] - float(found.fit.whitened[0])) / sd)
    assert 0.7 < np.sqrt(np.mean(np.square(scores))) < 1.4


def test_the_covariance_over_few_draws_is_shrunk_to_its_variances():
    draws = np.random.default_rng(1).normal(size=(12, 30)) * np.linspace(1.0, 2.0, 30)
    found = scatter_covariance(draws)
    np.testing.assert_allclose(np.diagonal(found), draws.var(axis=0, ddof=1))
    assert np.linalg.eigvalsh(found).min() > 0.0
    off = found / np.sqrt(np.outer(np.diagonal(found), np.diagonal(found))) - np.eye(30)
    assert np.sqrt(np.mean(off**2)) < 0.1  # 0.3 without shrinkage
    common = np.random.default_rng(2).normal(size=(200, 1)) + 0.1 * draws[:1].repeat(200, axis=0)
    kept = scatter_covariance(common)
    assert kept[0, 1] > 0.95 * kept[0, 0]


def test_informative_directions_hold_what_the_prior_moves():
    random = np.random.default_rng(4)
    slopes = random.normal(size=(40, 3))
    draws = random.normal(size=(60, 3)) @ slopes.T
    shared = random.normal(size=(40, 2))
    covariance = np.diag(random.uniform(0.5, 2.0, 40)) + shared @ shared.T
    for factors in (0, 2, 9):
        by_factors = 5.0 * random.normal(size=(40, factors))
        chosen = informative_directions(draws, covariance, by_factors, 3)
        rows, back = np.asarray(chosen.rows), np.asarray(chosen.back)
        whole = covariance + by_factors @ by_factors.T
        np.testing.assert_allclose(rows @ back, np.eye(3 + factors), atol=1e-10)
        np.testing.assert_allclose(rows @ whole @ rows.T, np.eye(3 + factors), atol=1e-10)
        np.testing.assert_allclose(back @ (rows @ slopes), slopes, atol=1e-8)
        # What all statistics tell of slopes and factors, by their errors, these directions tell.
        every = np.concatenate([slopes, by_factors], axis=1)
        told = rows @ every
        left = told.T @ np.linalg.solve(rows @ covariance @ rows.T, told)
        np.testing.assert_allclose(left, every.T @ np.linalg.solve(covariance, every), rtol=1e-8)


def test_factors_of_which_statistics_tell_nothing_take_no_direction():
    random = np.random.default_rng(5)
    draws, by_factors = random.normal(size=(60, 30)), random.normal(size=(30, 4))
    for size, more in ((1.0, 4), (0.03, 0)):
        chosen = informative_directions(draws, np.eye(30), size * by_factors, 6)
        assert chosen.rows.shape == (6 + more, 30)


def test_slopes_along_directions_are_those_of_central_differences(plot, views):
    """Of a drone's statistics: combined along directions, and spread over statistics again."""
    model, parameters, space = plot
    model = model.expected()
    rows = np.random.default_rng(6).normal(size=(2, len(views[0].names)))
    chosen = Directions(jnp.asarray(rows), jnp.asarray(np.linalg.pinv(rows)))
    coarse = dataclasses.replace(views[0].for_search(model, ACCURACY, 3), directions=chosen)
    none = jnp.zeros(len(coarse.names))
    predict = PlotForward(parameters, space.names, [coarse])
    density = LogPosterior(predict, space, Data(coarse.names, none, none + 1), none, (model,))
    u, step = 0.3 * jnp.arange(-2.0, len(space.names) - 2.0), 1e-5
    value, slopes = statistics_and_jacobian(density, u)
    np.testing.assert_allclose(value, predicted_statistics(density, u), rtol=1e-9)
    for i in range(u.size):
        up, down = (predicted_statistics(density, u.at[i].add(h)) for h in (step, -step))
        difference = np.linalg.pinv(rows) @ (rows @ np.asarray(up - down)) / (2 * step)
        np.testing.assert_allclose(slopes[:, i], difference, rtol=2e-5, atol=1e-7)
    assert np.abs(slopes).min(axis=1).max() > 0.0


class Strided(Sums):
    """Its coarse form is off by what pixels leave out."""

    def for_search(self, scene, accuracy, stride):
        return dataclasses.replace(self, lack=0.01 * stride)


def test_coarse_views_are_those_of_the_search(sums):
    """With its stride, so that a surrogate goes on with renders of the same form."""
    found = calibrated(sums, Strided(), stride=3)
    (coarse,) = found.plantings.views
    assert coarse.lack == pytest.approx(0.03)
    for stand, statistics in zip(found.plantings.stands, found.plantings.statistics, strict=True):
        again = coarse.predict(stand.expected(), found.after)
        np.testing.assert_allclose(again, statistics, rtol=1e-6)


def test_a_surrogate_bends_as_the_model_does(sums):
    """Quadratic statistics are met where linear ones are not."""
    model, start, _, space = sums
    whole = calibrated(sums, stand_realisations=8, scatter_draws=8)
    coarse = whole.plantings.views
    surrogate, error = fit_surrogate(whole)
    assert error.max() < 0.5
    fit = whole.fit
    lack = Sums().predict(model, whole.after) - coarse[0].predict(model, whole.after)
    near = np.random.default_rng(9).multivariate_normal(fit.whitened, 4.0 * fit.covariance, 100)
    bent, straight = [], []
    for u in map(jnp.asarray, near):
        plot = with_values(start, TAXA, space.named(u))
        true = coarse[0].predict(model, plot) + lack
        bent.append(fit.data.whiten(surrogate(space.physical(u)) - true))
        linear = fit.predicted + fit.jacobian @ (u - fit.whitened)
        straight.append(fit.data.whiten(linear - true))
    bent, straight = (np.sqrt(np.mean(np.square(one))) for one in (bent, straight))
    assert bent < 0.5 * straight
    # The fit's expectation is that of the surrogate over the posterior.
    away = 0.5 * (near - np.asarray(fit.whitened))
    draws = jnp.asarray(fit.whitened + np.concatenate([away, -away]))
    mean = np.mean([surrogate(space.physical(u)) for u in draws], axis=0)
    assert np.abs(np.asarray(fit.data.whiten(jnp.asarray(mean) - fit.predicted))).max() < 0.3


# -- the camera -----------------------------------------------------------------------------


def test_factors_of_bands_move_statistics_as_stated(views):
    image = 0.05 + 0.3 * np.random.default_rng(2).random((4, 6, 6))
    at = jnp.array([0.1, -0.05, 0.0, 0.2])
    slopes = np.asarray(views[0].factor_slopes(jnp.asarray(image), at))
    step = 1e-5
    for band in range(4):
        moved = step * jnp.eye(4)[band]
        up, down = (
            views[0].statistics(jnp.asarray(image * np.exp(at + s * moved)[:, None, None]))
            for s in (1, -1)
        )
        np.testing.assert_allclose(slopes[:, band], (up - down) / (2 * step), rtol=1e-5, atol=1e-8)


class Painted(eqx.Module):
    """A camera whose pixels are covers and their products: no light."""

    sensor: Any
    pixel: float = 0.1
    seen: Any = None

    def observe(self, scene, parameters):
        a, b, c = parameters.species.cover.astype(float)
        image = jnp.array([[[a, b], [c, a * b]], [[b, c], [a * c, a]], [[a, a], [b, b * c]]])
        return SimpleNamespace(reflectance=image)


@pytest.mark.parametrize("reduced", [False, True])
def test_slopes_of_an_image_by_parameters_and_factors(sums, reduced):
    """By pixels, and by the factors of the image that there is, as straight through both."""
    bands = BandSet(("red", "red_edge", "nir"), (650.0, 730.0, 860.0), (20.0,) * 3)
    names = ("red.mean", "nir.std", "NDVI.mean")
    view = ImageView(names, Painted(SimpleNamespace(bands=bands)))
    space = free_space(sums[0], small_parameters(), ("species.*.cover",), lambda _: 0.3)

    def plot_at(u):
        return with_values(small_parameters(), TAXA, space.named(u[: len(space.names)]))

    def factor_at(u):
        return 0.3 * u[len(space.names) :]

    u = jnp.linspace(-0.5, 0.7, len(space.names) + 3)
    want = AbstractView.jacobian(view, sums[0], plot_at, u, factor_at)
    if reduced:  # along all directions: the same
        rows = np.array([[1.0, 0.5, 0.0], [0.0, 1.0, 0.2], [0.3, 0.0, 1.0]])
        directions = Directions(jnp.asarray(rows), jnp.asarray(np.linalg.inv(rows)))
        view = dataclasses.replace(view, directions=directions)
    found = view.jacobian(sums[0], plot_at, u, factor_at)
    for one, other in zip(found, want, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-9, atol=1e-12)
    assert np.abs(np.asarray(want[1])[:, len(space.names) :]).max() > 0.01


CENTRES = (560.0, 650.0, 860.0)
ERROR = ModelError([500.0, 700.0, 900.0], [0.12, 0.1, 0.15], np.eye(3) + 0.5 * (1.0 - np.eye(3)))


class Bright(ImageView):
    """An image of as many bands as there are species, each as bright as its cover: no light."""

    @property
    def bands(self):
        return BandSet(("a", "b", "c"), CENTRES, (20.0,) * 3)

    @property
    def instrument(self):
        return self.camera or ""

    def observe(self, scene, parameters):
        cover = parameters.species.cover.astype(float)
        image = jnp.broadcast_to(cover[:, None, None], (cover.size, 2, 2))
        return image, self.statistics(image)

    def statistics(self, image, log_factor=None):
        return jnp.mean(multiplied(image, log_factor), axis=(1, 2))

    jacobian = AbstractView.jacobian

    def for_search(self, scene, accuracy, stride):
        return self


@pytest.mark.parametrize("cameras", [1, 2])
def test_parameters_gains_and_model_error_are_estimated_together(sums, cameras):
    """Against the density of all of them, gains and errors each for themselves, which SciPy climbs
    and whose curvature it takes by differences: two cameras share the error of the model."""
    model = sums[0]
    space = free_space(model, small_parameters(), ("species.*.cover",), lambda _: 0.3)
    gains = [Gains(0.1, 0.5), Gains([0.02, 0.2, 0.05], 0.2)][:cameras]
    views = [
        Bright(tuple(f"{k}{i}" for k in "abc"), None, gains=one) for i, one in enumerate(gains)
    ]
    start = np.asarray(small_parameters().species.cover, float)
    value = np.concatenate([start * [1.3, 0.9, 1.2], start * [1.1, 0.7, 1.0]])[: 3 * cameras]
    sd = 0.02 * value
    data = Data(tuple(n for v in views for n in v.names), value, sd)
    settings = CalibrationSettings(stand_realisations=0, rounds=3, tolerance=1e-8)
    found = calibrate_plot(model, small_parameters(), data, space, views, settings, error=ERROR)
    places = [space.names.index(f"species.{taxon}.cover") for taxon in TAXA]
    of_gains = [np.linalg.inv(one.covariance(3)) for one in gains]
    of_model = np.linalg.inv(ERROR.covariance(CENTRES))
    free = len(space.names)

    def objective(x):
        cover = np.asarray(space.physical(jnp.asarray(x[:free])))[places]
        model_error, total = x[free : free + 3], 0.5 * x[:free] @ x[:free]
        total += 0.5 * model_error @ of_model @ model_error
        for i, inverse in enumerate(of_gains):
            gain = x[free + 3 * (i + 1) : free + 3 * (i + 2)]
            rest = (cover * np.exp(gain + model_error) - value[3 * i : 3 * i + 3]) / sd[
                3 * i : 3 * i + 3
            ]
            total += 0.5 * gain @ inverse @ gain + 0.5 * rest @ rest
        return float(total)

    at = scipy.optimize.minimize(objective, np.zeros(free + 3 + 3 * cameras), method="BFGS").x
    covariance = np.linalg.inv(curvature(objective, at))
    assert found.excess == 1.0
    np.testing.assert_allclose(found.fit.whitened, at[:free], atol=2e-3)
    np.testing.assert_allclose(np.log(found.gain), at[free + 3 : free + 6], atol=2e-3)
    for one in found.model_error:
        np.testing.assert_allclose(np.log(one), at[free : free + 3], atol=2e-3)
    own = np.sqrt(np.diagonal(covariance))
    np.testing.assert_allclose(
        np.sqrt(np.diagonal(found.fit.covariance))[places], own[places], rtol=0.05
    )
    np.testing.assert_allclose(found.gain_sd, own[free + 3 : free + 6], rtol=0.05)
    np.testing.assert_allclose(found.model_error_sd[0], own[free : free + 3], rtol=0.05)
    cover = np.asarray(found.fit.estimate)[places]
    np.testing.assert_allclose(found.statistics_after[:3], cover, rtol=1e-6)
    np.testing.assert_allclose(found.statistics_with_gain[:3], cover * found.gain, rtol=1e-6)
    both = cover * found.gain * found.model_error[0]
    np.testing.assert_allclose(found.statistics_with_error[:3], both, rtol=1e-6)


def test_factors_of_bands_are_no_chance(sums):
    """A camera of unknown gains shows the plants as surely as one that is calibrated."""
    model, space = sums[0], free_space(sums[0], small_parameters(), HEIGHTS, lambda _: 0.3)
    value = np.asarray(small_parameters().species.cover, float)
    data, settings = Data(("a", "b", "c"), value, 0.02 * value), {"scatter_draws": 16}
    chance = []
    for sd in (0.01, 0.5):
        view = Bright(("a", "b", "c"), None, gains=Gains(sd, sd))
        asked = CalibrationSettings(stand_realisations=4, **settings)
        search = search_of(model, small_parameters(), data, space, (view,), asked)
        chance.append(np.asarray(search.begin(jnp.zeros(len(space.names))).place.covariance))
    assert (np.diagonal(chance[0]) > 0.0).all()
    np.testing.assert_allclose(chance[1], chance[0], rtol=1e-6)


def test_parameters_are_unknown_given_the_bands_factors(sums):
    """Expectations after the first round are over what is unknown of the parameters where factors
    are given: of normal laws the inverse of their block of the precision."""
    model, space = sums[0], free_space(sums[0], small_parameters(), HEIGHTS, lambda _: 0.3)
    value = np.asarray(small_parameters().species.cover, float)
    data = Data(("a", "b", "c"), value, 0.02 * value)
    view = Bright(("a", "b", "c"), None, gains=Gains(0.5, 0.5))
    asked = CalibrationSettings(stand_realisations=2, scatter_draws=6, rounds=1)
    search = search_of(model, small_parameters(), data, space, (view,), asked)
    state = search.begin(jnp.zeros(len(space.names)))
    while not state.ended:
        before, state = state, search.step(state)
    free = len(space.names)
    weights, slopes = search.weights(before.place, before.subspace), before.place.slopes
    rows = weights @ np.asarray(slopes).mean(axis=0)
    whole = np.linalg.inv(np.eye(rows.shape[1]) + rows.T @ rows)
    of_factors = np.linalg.solve(whole[free:, free:], whole[free:, :free])
    given = whole[:free, :free] - whole[:free, free:] @ of_factors
    root = np.asarray(state.place.spread)
    np.testing.assert_allclose((root @ root.T)[:free, :free], given, rtol=0.02, atol=1e-3)
    assert not root[free:].any()
    assert (np.diagonal(given) < 0.8 * np.diagonal(whole)[:free]).any()


def curvature(function, at, step=1e-4):
    """Second derivatives by central differences."""
    eye = step * np.eye(len(at))
    return np.array(
        [
            [
                function(at + a + b) - function(at + a - b) - function(at - a + b)
                + function(at - a - b)
                for b in eye
            ]
            for a in eye
        ]
    ) / (4.0 * step**2)  # fmt: skip


def test_what_the_data_ask_beyond_their_errors_widens_intervals(sums):
    """Two cameras that contradict each other: the misfit is told, and the errors grow by it."""
    model = sums[0]
    space = free_space(model, small_parameters(), ("species.*.cover",), lambda _: 0.3)
    views = [Bright(tuple(f"{k}{i}" for k in "abc"), None, gains=Gains(0.01)) for i in range(2)]
    cover = np.asarray(small_parameters().species.cover, float)
    names = tuple(n for v in views for n in v.names)
    settings = CalibrationSettings(stand_realisations=0, rounds=3)
    found = [
        calibrate_plot(
            model, small_parameters(),
            Data(names, np.concatenate([cover, by * cover]), 0.02 * np.tile(cover, 2)),
            space, views, settings,
        )
        for by in (1.0, 1.3)
    ]  # fmt: skip
    assert found[0].excess == 1.0
    # Half of 30 % apart is 15 %, of 2 % (and gains of 1 %): 3 x 2 times some 50, over 6.
    assert 30.0 < found[1].misfit / found[1].degrees < 60.0
    # As if the stated errors had been found from ten data; the prior pulls more once they grow.
    assert 0.5 < found[1].excess * (found[1].degrees + 10.0) / (found[1].misfit + 10.0) <= 1.0
    wider = np.asarray(found[1].fit.sd) / np.asarray(found[0].fit.sd)
    places = [space.names.index(f"species.{taxon}.cover") for taxon in TAXA]
    assert (wider[places] > 2.0).all()
    assert "times what was expected" in str(found[1])
    # The linear model by the stated errors asks for that excess, factors of bands among them.
    least = found[1].misfit_by_group()["misfit"][0]
    assert (least + 10.0) / (found[1].degrees + 10.0) == pytest.approx(found[1].excess, rel=0.02)


def test_a_signature_is_of_what_solvers_are_made_of():
    def solver(tol, scale=1.0):
        return jaxopt.LBFGSB(fun=lambda x: scale * x.sum(), tol=tol)

    assert signature(solver(1e-3)) == signature(solver(1e-3))
    assert signature(solver(1e-3)) != signature(solver(1e-4))
    assert signature(solver(1e-3)) != signature(solver(1e-3, 2.0))
    long = np.arange(5000.0)
    other = np.where(long == 2500.0, 0.0, long)
    assert signature({"a": long}) == signature({"a": long.copy()}) != signature({"a": other})
    assert signature(1, 2) != signature(1, 3)


@pytest.mark.study
def test_a_twin_of_three_sensors_is_reproduced():
    """What the sensors saw of a known plot comes back from parameters that are off by 20 %."""
    truth, model = small_parameters(), small_plot(extent=(2.0, 2.0), dtype="float32")
    views = views_of(model, COARSE)
    values = [np.asarray(eqx.filter_jit(v.predict)(model, truth), float) for v in views]
    data = join_data(
        [
            weigh_targets(views[0].names, values[0], 0.01),
            weigh_spectrum(views[1].names, values[1], 0.01, gain=0.005, offset=0.001),
            weigh_structure(views[2].names, values[2], 0.01, sd=np.zeros(len(values[2]))),
        ]
    )
    named = {"species.Erica irregularis.cover": 0.2, "species.Erica irregularis.height": 0.8}
    named |= {"species.Restio eleocharis.cover": 0.18, "ground.brightness": 0.65}
    start = with_values(truth, TAXA, {n: jnp.asarray(v) for n, v in named.items()})
    free = ("species.*.cover", "species.*.height", "species.*.leaf_area_index", "ground.brightness")
    space = free_space(model, start, free, lambda _: 0.3)
    settings = CalibrationSettings(stride=2, max_steps=10)
    found = calibrate_plot(model, start, data, space, views, settings)
    before, after = (
        np.asarray(found.data.whiten(s - data.value))
        for s in (found.statistics_before, found.statistics_after)
    )
    assert np.sqrt(np.mean(before**2)) > 1.5  # 12 combinations, of factors of bands too
    assert np.sqrt(np.mean(after**2)) < 0.7
    assert found.probability > 0.05
    i = found.fit.names.index("species.Erica irregularis.height")
    assert float(found.fit.estimate[i]) == pytest.approx(0.67, abs=2 * float(found.fit.sd[i]))
    assert "species.Erica irregularis.height" in found.fit.well_constrained()


@pytest.mark.parametrize(
    "solver",
    [
        optx.Dogleg(1e-4, 1e-4),
        pytest.param(jaxopt.LBFGSB(fun=jnp.sum, tol=1e-3), marks=pytest.mark.study),
    ],
    ids=["Dogleg", "LBFGSB"],
)
def test_a_calibration_takes_any_solver(sums, whole, solver, monkeypatch):
    """To the same estimate, with errors and rounds of its own search; compiled once for all."""
    traced, real = [], Expectation.statistics
    monkeypatch.setattr(Expectation, "statistics", lambda *a: (traced.append(1), real(*a))[1])
    calibrated(sums, rounds=1, max_steps=60, solver=solver)
    compiled = len(traced)
    assert compiled > 0
    found = calibrated(sums, max_steps=60, solver=solver)
    assert len(traced) == compiled
    assert found.fit.converged
    sd = np.sqrt(np.diagonal(whole.fit.covariance))
    assert (
        np.abs((np.asarray(found.fit.whitened) - np.asarray(whole.fit.whitened)) / sd).max() < 0.2
    )


@pytest.mark.parametrize(("views", "kinds", "count"), [(25, 6, 16), (9, 20, 48)])
def test_errors_stated_from_few_draws_of_many_views_are_those_made(views, kinds, count):
    """Generalised least squares of one number, of which the statistics change as by chance, and
    whose errors are little larger than they have to be."""
    random, off, wide = np.random.default_rng(3), [], []
    apart = np.abs(np.subtract.outer(np.arange(views), np.arange(views)))
    of_views = 0.97 ** np.minimum(apart, views - apart)
    near = np.abs(np.subtract.outer(np.arange(kinds), np.arange(kinds)))
    own = 0.7 * np.kron(of_views, np.exp(-near / 8.0))
    # Some of it is not of views and of kinds apart: every other kind is the more of its view.
    uneven = np.ones(kinds) + 0.5 * (np.arange(kinds) % 2)
    rest = np.kron(0.6 + 0.4 * np.eye(views), np.exp(-near / 2.0) * np.outer(uneven, uneven))
    own += 0.3 * rest
    root = np.linalg.cholesky(own)
    names = [str(kind) for kind in range(kinds)] * views
    for _ in range(40):
        slope = root @ random.normal(size=len(own))
        drawn = random.normal(size=(count, len(own))) @ root.T
        weights = np.linalg.solve(scatter_of_views(drawn, names), slope)
        information = slope @ weights
        off.append(weights @ (root @ random.normal(size=len(own))) / np.sqrt(information))
        wide.append(np.sqrt(slope @ np.linalg.solve(own, slope) / information))
    assert 0.6 < np.sqrt(np.mean(np.square(off))) < 1.2
    assert np.mean(wide) < 2.0


def test_views_of_unlike_statistics_and_statistics_that_never_change_have_a_covariance():
    random = np.random.default_rng(1)
    drawn = random.normal(size=(16, 1)) + 0.3 * random.normal(size=(16, 7))
    drawn[:, 4] = 2.0
    found = scatter_of_views(drawn, ["a", "b", "c", "a", "b", "a", "d"])
    assert np.isfinite(found).all()
    moving = np.delete(np.arange(7), 4)
    assert np.linalg.eigvalsh(found[np.ix_(moving, moving)]).min() > 0.0
    sd = np.sqrt(np.diagonal(found)[moving])
    assert (found[np.ix_(moving, moving)] / np.outer(sd, sd) > 0.53).all()


@pytest.mark.parametrize("count", [3, 4, 5, 6])
def test_very_few_draws_of_views_state_errors_neither_far_too_small_nor_without_end(count):
    """What generalised least squares is off by, over what is stated of it, on the mean over its
    logarithm; stated errors over those of the covariance itself."""
    random, views, kinds = np.random.default_rng(8), 9, 10
    apart = np.abs(np.subtract.outer(np.arange(kinds), np.arange(kinds)))
    own = np.kron(np.full((views, views), 0.9) + 0.1 * np.eye(views), 0.8**apart)
    root, names = np.linalg.cholesky(own), [str(kind) for kind in range(kinds)] * views
    off, wide = [], []
    for _ in range(60):
        found = scatter_of_views(random.normal(size=(count, len(own))) @ root.T, names)
        slope, error = root @ random.normal(size=(2, len(own), 1))
        weights = np.linalg.solve(found, slope)
        information = float(np.sum(slope * weights))
        off.append(abs(float(np.sum(weights * error))) / np.sqrt(information))
        wide.append(np.sqrt(np.sum(slope * np.linalg.solve(own, slope)) / information))
    assert np.median(off) < 1.5
    assert np.median(wide) < 20.0


@pytest.mark.parametrize("names", ["abab", "abcd"])
def test_a_statistic_that_is_not_finite_has_no_covariance(names):
    drawn = np.random.default_rng(2).normal(size=(16, 4))
    drawn[3, 2] = np.nan
    assert np.isnan(scatter_of_views(drawn, [*names])[2, 2])


def test_a_sun_west_of_north_is_that_of_a_whole_turn_more():
    light = under_sun(small_parameters(), (40.0, -10.0)).light
    assert (float(light.sun_zenith), float(light.sun_azimuth)) == (40.0, 350.0)

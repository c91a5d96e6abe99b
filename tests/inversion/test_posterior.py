"""Draws against the closed form of a linear model, against each other, and through a kill."""

import os
import signal
import subprocess
import sys
from collections import deque
from functools import cache
from pathlib import Path

import emcee
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import trapezoid

from fynjax._core.checkpoint import Journal, signature
from fynjax._core.errors import InputError, MissingExtraError
from fynjax._core.sampling import ChainState, Draws, Ensemble
from fynjax.inversion import Data, LogPosterior, ParameterSpace, PosteriorSampler, fit
from fynjax.inversion._posterior import _flatness, sample_posterior
from fynjax.inversion._posterior_result import _arviz
from tests.heard import hearing
from tests.helpers import stand_in, unix
from tests.inversion.linear import DATA, MATRIX, SPACE, posterior, predict

SAMPLERS = ["emcee", "nuts", "laplace"]
TWO = ParameterSpace(
    ("p.cover", "q.cover"), jnp.zeros(2), jnp.ones(2), jnp.array([0.3, 0.5]), jnp.full(2, 0.2)
)
"""Two parameters near their bounds, where the transform bends."""


def arviz():
    try:
        return _arviz()
    except MissingExtraError:
        pytest.skip("the extra `posterior` is not installed")


def need(method):
    if method == "nuts":
        pytest.importorskip("blackjax", reason="the extra `posterior` is not installed")


def curved(x):
    return jnp.array([x[0] * x[1], x[0] + x[1]])


CURVED = Data(("s", "t"), jnp.array([0.12, 0.9]), jnp.array([0.03, 0.1]))


@cache
def drawn(method):
    """Draws that several tests look at."""
    need(method)
    return sample_posterior(predict, DATA, SPACE, method=method, target=3000.0, seed=2)


@pytest.mark.parametrize("method", SAMPLERS)
def test_draws_are_those_of_the_normal_posterior(method):
    found = drawn(method)
    assert found.status.startswith("converged")
    mean, covariance = posterior()
    sd = np.sqrt(np.diag(covariance))
    flat = found.values.reshape(-1, 3)
    # Of 3000 effective draws a mean is known to 0.018 sd, an sd to 1.3 %.
    np.testing.assert_allclose((flat.mean(0) - mean) / sd, 0.0, atol=0.06)
    np.testing.assert_allclose(np.cov(flat.T) / np.outer(sd, sd), covariance / np.outer(sd, sd),
                               atol=0.07)  # fmt: skip
    low, high = found.quantiles(0.025, 0.975)
    np.testing.assert_allclose((high - low) / (2 * 1.96 * sd), 1.0, rtol=0.05)


def test_the_ensemble_is_as_wide_as_what_it_samples():
    """Six unit normals. A move that is not quite right shows here first: 4 % of the width."""
    start = np.random.default_rng(0).normal(size=(32, 6))
    found = Ensemble(
        lambda z: -0.5 * (z**2).sum(axis=1), start, target=3000.0, steps=20_000, seed=1
    ).run()
    assert found.status == "converged"
    # The mean of six widths, each of 3000 draws, is known to 0.5 %.
    assert found.chain.reshape(-1, 6).std(axis=0).mean() == pytest.approx(1.0, abs=0.015)


def test_an_ensemble_takes_moves_of_emcee_and_gives_its_chain():
    """Stretches alone: another chain, of the same posterior, in emcee's layout."""
    moves = emcee.moves.StretchMove(a=2.5)
    usual, found = (drawn("emcee"), sampler("emcee", moves=moves).posterior())
    flat = found.get_chain(flat=True)
    plain = sampler("emcee").posterior()
    assert plain.values.shape != found.values.shape or (plain.values != found.values).any()
    apart = flat.mean(axis=0) - usual.get_chain(flat=True).mean(axis=0)
    np.testing.assert_allclose(apart / flat.std(axis=0), 0.0, atol=0.25)
    # What emcee itself gives of the same steps.
    backend = emcee.backends.Backend()
    backend.reset(len(found.values), 3)
    backend.chain, backend.log_prob = np.swapaxes(found.values, 0, 1), found.log_density.T
    backend.iteration = len(backend.chain)
    for asked in ({}, {"discard": 2, "thin": 3}, {"thin": 4, "flat": True}):
        np.testing.assert_array_equal(found.get_chain(**asked), backend.get_chain(**asked))
        np.testing.assert_array_equal(found.get_log_prob(**asked), backend.get_log_prob(**asked))
    weighed = [(moves, 0.5), (emcee.moves.DEMove(), 0.5)]
    one, other, plain = (
        signature(sampler("emcee", moves=m).signed) for m in (moves, weighed, None)
    )
    assert len({one, other, plain}) == 3


def test_few_flat_directions_are_named_and_many_are_counted():
    one = {"c.cover": 1.0, "a.cover": -0.25}
    assert _flatness([one], 3) == "flat, the data say nothing along c.cover +1.00, a.cover -0.25"
    many = _flatness([one] * 95, 101)
    assert many == "flat, the data say nothing along 95 of 101 combinations of the parameters"


@pytest.mark.parametrize("method", SAMPLERS)
def test_what_the_data_cannot_see_is_named_and_stays_at_its_prior(method):
    found = drawn(method)
    assert found.converged
    assert "flat" in found.status
    ((name, weight),) = (one for one in found.flat[0] if abs(one[1]) > 0.01)
    assert name == "c.cover"
    assert abs(weight) == pytest.approx(1.0)
    assert found.constrained[2] == pytest.approx(0.0, abs=0.2)
    assert np.all(found.constrained[:2] > 0.8)


def grid_posterior():
    """Mean and sd over the unit square by quadrature, in own units: no transform in it."""
    axis = np.linspace(0.0, 1.0, 801)[1:-1]
    p, q = np.meshgrid(axis, axis, indexing="ij")
    misfit = ((p * q - 0.12) / 0.03) ** 2 + ((p + q - 0.9) / 0.1) ** 2
    # A prior uniform in p, and linear in q.
    weight = np.exp(-0.5 * misfit) * q
    weight /= weight.sum()
    moments = [(weight * x).sum() for x in (p, q, p**2, q**2)]
    mean = np.array(moments[:2])
    return mean, np.sqrt(np.array(moments[2:]) - mean**2)


@pytest.mark.parametrize("method", ["emcee", pytest.param("nuts", marks=pytest.mark.study)])
def test_a_prior_over_values_gets_its_jacobian(method):
    """Against quadrature in the parameters' own units."""
    need(method)
    found = sample_posterior(
        curved, CURVED, TWO, method=method, log_prior=lambda x: jnp.log(x[1]), target=4000.0
    )
    mean, sd = grid_posterior()
    flat = found.values.reshape(-1, 2)
    np.testing.assert_allclose((flat.mean(0) - mean) / sd, 0.0, atol=0.07)
    np.testing.assert_allclose(flat.std(0) / sd, 1.0, atol=0.06)


def test_the_prior_over_values_is_a_density():
    """The unit normal over |d value / d u| integrates to one over the bounds."""
    values = jnp.linspace(0.0, 1.0, 200_001)[1:-1]
    each = jnp.stack([values, values], axis=1)
    u = jax.vmap(TWO.whitened)(each)
    density = jnp.exp(-0.5 * u**2 - jax.vmap(TWO.log_slope)(u)) / np.sqrt(2 * np.pi)
    np.testing.assert_allclose(trapezoid(density, values, axis=0), 1.0, atol=1e-6)
    np.testing.assert_allclose(
        jnp.exp(TWO.log_slope(jnp.array([-1.0, 2.0]))), TWO.slope(jnp.array([-1.0, 2.0]))
    )
    assert np.all(np.isfinite(jax.grad(lambda u: TWO.log_slope(u).sum())(jnp.full(2, 400.0))))


def test_a_whitener_and_an_offset_are_in_the_density():
    moved = DATA.with_scatter(jnp.array([[0.4, 0.1, -0.2, 0.3]]))
    shift = jnp.array([0.2, -0.1, 0.0, 0.3])
    density = LogPosterior(predict, SPACE, moved, shift)
    u = jnp.array([0.3, -0.2, 1.0])
    rest = np.asarray(predict(SPACE.physical(u)) + shift - moved.value)
    w = np.asarray(moved.whitener)
    expected = -0.5 * (rest @ w.T @ w @ rest + float(u @ u))
    assert float(density(u)) == pytest.approx(expected, rel=1e-10)
    result = fit(predict, moved, SPACE, offset=shift, tolerance=1e-8)
    np.testing.assert_allclose(jax.grad(density)(result.whitened), 0.0, atol=1e-5)


# -- what goes wrong ------------------------------------------------------------------------


@pytest.mark.parametrize("method", SAMPLERS)
def test_a_posterior_that_is_not_finite_ends_in_a_status(method):
    need(method)
    start = fit(predict, DATA, SPACE)
    found = sample_posterior(
        lambda x: predict(x) * jnp.nan, DATA, SPACE, method=method,
        start=None if method == "laplace" else start,
    )  # fmt: skip
    assert not found.converged
    assert found.status.startswith("failed")
    assert "finite" in found.status
    assert found.whitened.shape[1] == 0


def test_a_hole_in_the_density_is_counted():
    def holed(x):
        return jnp.where(x[0] > 1.3, jnp.nan, predict(x))

    found = sample_posterior(holed, DATA, SPACE, target=300.0)
    assert found.values[..., 0].max() <= 1.3
    assert "not a number" in found.status


def test_too_few_steps_are_not_called_converged():
    found = sample_posterior(predict, DATA, SPACE, max_steps=30)
    assert not found.converged
    assert found.status.startswith("not converged")


@pytest.mark.parametrize(
    ("options", "text"),
    [
        ({"method": "gibbs"}, "'gibbs'"),
        ({"max_steps": 0}, "must be positive"),
        ({"chains": 4}, "at least 8 walkers"),
        ({"method": "laplace", "log_prior": lambda x: 0.0}, "log_prior"),
    ],
)
def test_wrong_arguments_are_refused(options, text):
    with pytest.raises(InputError, match=text):
        sample_posterior(predict, DATA, SPACE, **options)


def unwhitened(u):
    return np.asarray(jax.vmap(jax.vmap(SPACE.physical))(jnp.asarray(u)))


def test_the_sampler_of_emcee_is_at_hand():
    """With the chain of which the draws are a part, its moves, and the way on."""
    moves = emcee.moves.StretchMove(a=2.5)
    found = sampler("emcee", moves=moves, max_steps=400).posterior()
    ran = found.sampler
    assert isinstance(ran, emcee.EnsembleSampler)
    assert ran._moves == [moves]
    chain = unwhitened(ran.get_chain())
    assert len(chain) == ran.iteration == 400
    step = found.get_chain()[:, None] == chain
    places = step.all(axis=(2, 3)).argmax(axis=1)  # every draw is a step, in their order
    np.testing.assert_array_equal(chain[places], found.get_chain())
    assert len({*np.diff(places)}) == 1
    np.testing.assert_array_equal(ran.get_log_prob()[places], found.get_log_prob())
    assert 0.1 < ran.acceptance_fraction.mean() < 0.9
    ran.run_mcmc(None, 100)
    whole = sampler("emcee", moves=moves, max_steps=500).posterior().sampler
    np.testing.assert_array_equal(ran.get_chain(), whole.get_chain())
    np.testing.assert_array_equal(ran.acceptance_fraction, whole.acceptance_fraction)
    assert sampler("laplace").posterior().sampler is None


def test_a_chain_in_a_file_goes_on_as_if_it_had_not_been_stopped(tmp_path, monkeypatch):
    """Stopped at its end, and between the states that a run gives; read by emcee alone."""
    path = tmp_path / "chain.h5"
    sampler("emcee", backend=path, max_steps=70).posterior()
    assert emcee.backends.HDFBackend(str(path), read_only=True).iteration == 70
    real, saved = emcee.backends.HDFBackend.save_step, []

    def stopped(*given):
        saved.append(1)
        if len(saved) > 43:
            raise KeyboardInterrupt
        real(*given)

    with monkeypatch.context() as patch:
        patch.setattr(emcee.backends.HDFBackend, "save_step", stopped)
        with pytest.raises(KeyboardInterrupt):
            sampler("emcee", backend=path).posterior()
    kept = emcee.backends.HDFBackend(str(path))
    assert kept.iteration == 113
    found, whole = (sampler("emcee", backend=b).posterior() for b in (path, None))
    np.testing.assert_array_equal(found.values, whole.values)
    np.testing.assert_array_equal(found.predicted, whole.predicted)
    assert (found.acceptance, found.status) == (whole.acceptance, whole.status)
    assert found.sampler.backend.filename == str(path)
    np.testing.assert_array_equal(kept.get_chain(), whole.sampler.get_chain())
    # What has ended is taken as it is.
    monkeypatch.setattr(emcee.EnsembleSampler, "run_mcmc", None)
    np.testing.assert_array_equal(sampler("emcee", backend=kept).posterior().values, found.values)
    for options, text in (
        ({"chains": 40}, "has 32 walkers of 3 parameters, but 40 of 3"),
        ({"offset": jnp.full(4, 0.1)}, "is of another posterior: .* differs by up to"),
    ):
        with pytest.raises(InputError, match=text):
            sampler("emcee", backend=path, **options).posterior()


def test_a_backend_in_memory_holds_the_chain():
    """And a state from elsewhere is not mixed into it."""
    kept = emcee.backends.Backend()
    goes = sampler("emcee", backend=kept, max_steps=100)
    states = list(goes.states())
    assert kept.iteration == 100
    assert goes.posterior(states[-1]).sampler.backend is kept
    assert goes.posterior(states[1]).sampler.iteration == 50
    with pytest.raises(InputError, match="has 100 steps, but it was to go on from 50"):
        deque(goes.states(states[1]), maxlen=0)


@pytest.mark.parametrize(
    ("name", "text"),
    [("notes.txt", "notes.txt: expected an HDF5 file"), ("no/chain.h5", "there is no folder .*no")],
)
def test_a_file_that_cannot_keep_a_chain_is_refused(name, text, tmp_path):
    (tmp_path / "notes.txt").write_text("of the field")
    with pytest.raises(InputError, match=text):
        sampler("emcee", backend=tmp_path / name)
    assert (tmp_path / "notes.txt").read_text() == "of the field"


@pytest.mark.parametrize(
    ("options", "text"),
    [
        ({"backend": 5}, "path of an HDF5 file or as of emcee.backends, but got 5"),
        ({"backend": "chain.h5", "method": "nuts"}, "`backend` is of an .* not of 'nuts'"),
        ({"moves": "stretch"}, "of emcee.moves, such as .* but got 'stretch'"),
        ({"moves": emcee.moves.StretchMove(), "method": "laplace"}, "not of 'laplace'"),
    ],
)
def test_moves_and_backends_that_are_none_are_refused(options, text):
    with pytest.raises(InputError, match=text):
        sample_posterior(predict, DATA, SPACE, **options)


def test_a_missing_extra_names_the_line_to_type(monkeypatch):
    monkeypatch.setitem(sys.modules, "blackjax", None)
    monkeypatch.setitem(sys.modules, "h5py", None)
    for options in ({"method": "nuts"}, {"backend": "chain.h5"}):
        with pytest.raises(MissingExtraError, match=r"fynjax\[posterior\]"):
            sample_posterior(predict, DATA, SPACE, **options)


# -- interrupted ----------------------------------------------------------------------------


def sampler(method, **options):
    return PosteriorSampler(predict, DATA, SPACE, method=method, target=300.0, **options)


def followed(method, folder, **options):
    """The posterior, with the states kept in a folder."""
    goes = sampler(method, **{"max_steps": 1500} | options)
    journal = Journal(folder, signature(goes.signed))
    (end,) = deque(journal.states("chain", ChainState, goes.states), maxlen=1)
    return goes.posterior(end)


CUT = """
import signal, sys, time
# A shell that runs the tests in the background has them ignore Ctrl-C.
signal.signal(signal.SIGINT, signal.default_int_handler)
import fynjax._core.checkpoint as checkpoint
checkpoint._KEEP_SECONDS = float(sys.argv[3])
from tests.heard import Heard, listening
from tests.inversion.test_posterior import followed

class Slow(Heard):
    def advance(self, n, **info):
        super().advance(n)
        if self.count > 60:
            print("far", flush=True)
            time.sleep(60)
with listening(Slow()):
    followed(sys.argv[1], sys.argv[2])
"""


@unix
@pytest.mark.slow
@pytest.mark.parametrize(
    ("method", "end", "seconds"),
    [("emcee", "SIGKILL", 0), pytest.param("nuts", "SIGINT", 1000, marks=pytest.mark.study)],
)
def test_a_killed_run_goes_on_as_if_it_had_not_been(tmp_path, method, end, seconds):
    """What was done before the end is kept: by a kill what was written, else all of it."""
    need(method)
    whole = sampler(method, max_steps=1500).posterior()
    root = Path(__file__).resolve().parents[2]
    run = subprocess.Popen(
        [sys.executable, "-c", CUT, method, str(tmp_path), str(seconds)], cwd=root,
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        env=os.environ | {"JAX_ENABLE_X64": "1"},  # a model in 32 bits is another problem
    )  # fmt: skip
    assert run.stdout.readline().strip() == "far"
    run.send_signal(getattr(signal, end))
    assert run.wait(timeout=120) != 0
    for pipe in (run.stdout, run.stderr):
        pipe.close()
    with hearing() as heard:
        rest = followed(method, tmp_path)
    assert heard.steps[0] >= 50  # what was done before the end counts at once
    np.testing.assert_array_equal(rest.whitened, whole.whitened)
    np.testing.assert_array_equal(rest.log_density, whole.log_density)
    np.testing.assert_array_equal(rest.predicted, whole.predicted)
    assert (rest.acceptance, rest.status) == (whole.acceptance, whole.status)
    np.testing.assert_array_equal(followed(method, tmp_path).whitened, whole.whitened)
    with pytest.raises(InputError, match="of another run"):
        followed(method, tmp_path, seed=1)
    (tmp_path / "calibration.chain.npz").write_bytes(b"not a chain")
    with pytest.raises(InputError, match="no checkpoint"):
        followed(method, tmp_path)


@pytest.mark.parametrize("method", ["emcee", "nuts"])
def test_a_chain_that_was_too_short_goes_on(method):
    """From every state, and as one that may be so long from the start."""
    need(method)
    short = list(sampler(method, max_steps=70, warmup=30).states())
    long = sampler(method, max_steps=120, warmup=30)
    whole = list(long.states())
    assert [len(state.chain) for state in short][-1] == 70 + 30 * (method == "nuts")
    for state in (short[1], short[-1]):
        *_, end = long.states(state)
        np.testing.assert_array_equal(end.chain, whole[-1].chain)
        np.testing.assert_array_equal(end.accepted, whole[-1].accepted)
    assert long.posterior(whole[0]).status.startswith("not converged: no steps")
    np.testing.assert_array_equal(
        long.posterior(whole[-1]).predicted, long.posterior(whole[-1]).predicted
    )


# -- what is saved --------------------------------------------------------------------------


def test_it_is_saved_as_inference_data_and_diagnosed(tmp_path):
    az = arviz()
    found = drawn("emcee")
    diagnostics = found.diagnostics()
    assert all(one["r_hat"] < 1.03 for one in diagnostics.values())
    assert all(one["ess_bulk"] > 500 for one in diagnostics.values())
    path = tmp_path / "posterior.nc"
    found.inference_data({"source": "a test"}).to_netcdf(str(path))
    back = az.from_netcdf(str(path))
    assert {*back.posterior.data_vars} == {*SPACE.names}
    for i, name in enumerate(SPACE.names):
        np.testing.assert_array_equal(back.posterior[name], found.values[..., i])
    np.testing.assert_array_equal(back.unconstrained_posterior["whitened"], found.whitened)
    assert back.posterior.attrs["source"] == "a test"
    assert list(back.constant_data["parameter"].values) == list(SPACE.names)
    assert back.posterior_predictive["statistics"].shape == (1, 100, 4)
    np.testing.assert_allclose(back.observed_data["statistics"], DATA.value)
    # What is predicted at a draw is the model there: its spread is the posterior's through it.
    mean, covariance = posterior()
    expected = np.asarray(predict(mean))
    sd = np.sqrt(np.diag(np.asarray(jax.jacfwd(predict)(jnp.zeros(3))) @ covariance
                         @ np.asarray(jax.jacfwd(predict)(jnp.zeros(3))).T))  # fmt: skip
    np.testing.assert_allclose((found.predicted.mean(0) - expected) / sd, 0.0, atol=0.5)


def test_parameters_of_species_are_one_variable_over_these(tmp_path):
    """Whatever their order, also of some of the species; traits go by leaf or other material."""
    az = arviz()
    names = (
        "species.Erica sp. 1.cover", "ground.brightness", "species.Restio.leaf.chlorophyll",
        "species.Restio.cover", "species.Restio.twig.chlorophyll", "material.bark.water", "cover 2",
        "species.Restio.diameter", "species.Erica sp. 1.diameter",
    )  # fmt: skip
    count = len(names)
    sd = 0.1 + 0.01 * np.arange(count)
    space = ParameterSpace(names, np.zeros(count), np.full(count, 2.0), np.ones(count), sd)
    data = Data(("sum",), jnp.array([float(count)]), jnp.array([0.5]))
    found = sample_posterior(lambda x: x.sum()[None], data, space, method="laplace", target=50.0)
    found.inference_data().to_netcdf(str(tmp_path / "posterior.nc"))
    draws = az.from_netcdf(str(tmp_path / "posterior.nc")).posterior
    values = dict(zip(names, np.moveaxis(found.values, -1, 0)))
    assert {*draws.data_vars} == {
        "cover", "diameter", "leaf.chlorophyll", "twig.chlorophyll", "material.bark.water",
        "ground.brightness", "cover 2",
    }  # fmt: skip
    for kind in ("cover", "diameter"):
        for taxon in ("Erica sp. 1", "Restio"):
            np.testing.assert_array_equal(
                draws[kind].sel(species=taxon), values[f"species.{taxon}.{kind}"]
            )
    for kind in ("leaf.chlorophyll", "twig.chlorophyll"):
        np.testing.assert_array_equal(
            draws[kind].sel({f"species_{kind}": "Restio"}), values[f"species.Restio.{kind}"]
        )
    np.testing.assert_array_equal(draws["ground.brightness"], values["ground.brightness"])


# -- other samplers -------------------------------------------------------------------------


def check_draws(u):
    """Whitened draws [draw, parameter] are those of the normal posterior."""
    mean, covariance = posterior()
    flat = unwhitened(np.asarray(u)[None])[0]
    sd = np.sqrt(np.diag(covariance))
    np.testing.assert_allclose((flat.mean(0) - mean) / sd, 0.0, atol=0.12)
    np.testing.assert_allclose(flat.std(0) / sd, 1.0, rtol=0.07)


def test_blackjax_explores_the_log_density():
    import blackjax

    log_density = LogPosterior(predict, SPACE, DATA)
    warmup = blackjax.window_adaptation(blackjax.nuts, log_density)
    (state, tuned), _ = warmup.run(jax.random.key(1), jnp.zeros(3), num_steps=300)
    step = jax.jit(blackjax.nuts(log_density, **tuned).step)
    draws = []
    for key in jax.random.split(jax.random.key(2), 2000):
        state, _ = step(key, state)
        draws.append(state.position)
    check_draws(draws)


def test_numpyro_explores_the_log_density():
    from numpyro import infer

    log_density = LogPosterior(predict, SPACE, DATA)
    kernel = infer.NUTS(potential_fn=lambda u: -log_density(u))
    chains = infer.MCMC(kernel, num_warmup=300, num_samples=2000, progress_bar=False)
    chains.run(jax.random.key(1), init_params=jnp.zeros(3))
    check_draws(chains.get_samples())


def test_predictions_are_of_draws_from_all_over_the_chains():
    """Of chains whose steps are told apart by what they predict: each tenth of the steps and of the
    chains has its share of the predictions, as a draw of each place would have it."""
    sampler = PosteriorSampler(predict, DATA, SPACE, method="emcee", target=300.0, max_steps=200)
    steps, chains = 1000, 50
    step, chain = np.meshgrid(np.arange(steps), np.arange(chains), indexing="ij")
    places = np.stack([step / steps, chain / chains, 0.0 * step], axis=-1)
    whitened = np.asarray(jax.vmap(SPACE.whitened)(jnp.asarray(places.reshape(-1, 3))))

    class Sampler:
        def draws(self, end):
            found = drawn("emcee")
            flat = whitened.reshape(steps, chains, 3)
            return Draws(flat, np.zeros((steps, chains)), 300.0, 1.0, 0.3, found.status)

    sampler._sampler = Sampler()
    found = sampler.posterior(stand_in(ChainState))
    back, *_ = np.linalg.lstsq(np.asarray(MATRIX)[:, :2], found.predicted.T, rcond=None)
    count = len(found.predicted)
    assert count >= 100
    for share in back:
        tenths = np.bincount((10 * share + 1e-6).astype(int), minlength=10) / count
        assert np.abs(tenths - 0.1).max() < 4.0 * np.sqrt(0.09 / count)

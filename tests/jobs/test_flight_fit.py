"""A flight over a twin, fitted: a frame that was left out is predicted within its errors."""

from functools import partial

import jax.numpy as jnp
import numpy as np
import pytest

import fynjax as fx
from fynjax.app.assembly import build_plot, read_problem
from fynjax.app.io.frames import FrameStack
from fynjax.app.io.plot import read_plot
from fynjax.inversion import CalibrationSettings, plot_search
from fynjax.inversion._search import posterior_root
from fynjax.inversion._views import look
from fynjax.scene import with_values
from tests.io.flight_pictures import write_stack
from tests.small import write_plot

LENS = fx.Lens((2000, 1500), (1600.0, 1600.0), (999.5, 749.5))
AROUND = [(0.0, 0.0), (20.0, 80.0), (25.0, 140.0), (25.0, 260.0), (25.0, 20.0)]
"""Zenith and azimuth of each camera as seen from the middle of the plot [degrees]; the last,
nearest to the sun, is left out."""
FREE = ["species.*.cover", "species.*.leaf_area_index"]


def frames():
    found = []
    for k, (zenith, azimuth) in enumerate(AROUND):
        away = 30.0 * np.tan(np.radians(zenith))
        east, north = (1.0 + away * f(np.radians(azimuth)) for f in (np.sin, np.cos))
        pose = fx.Pose([east, north, 30.0], (azimuth + 180.0) % 360.0, zenith)
        found.append(fx.Frame(pose, LENS, f"frame{k}"))
    return found


def flown(folder, some):
    """The plot file of a twin of another truth than its table, with frames of it, of which `some`
    are targets."""
    folder.mkdir()
    plot = write_plot(folder)
    scene, parameters = build_plot(read_plot(plot), seed=77, rounding="random")
    known = {
        "species.Erica irregularis.leaf_area_index": 2.4,
        "species.Restio eleocharis.leaf_area_index": 4.4,
    }
    truth = with_values(parameters, scene.taxa, {n: jnp.asarray(v) for n, v in known.items()})
    gain = np.array([1.03, 0.98, 1.01, 1.02])[:, None, None]
    seen = [fx.observe(scene, "mavic_3m", parameters=truth, pixel=0.1, pose=f) for f in some]
    images = np.stack([np.where(s.seen, gain * np.asarray(s.reflectance), np.nan) for s in seen])
    stack = FrameStack(
        tuple(some), seen[0].bands, seen[0].wavelength, images, 0.1, (None,) * len(some)
    )
    write_stack(folder / "frames.nc", stack)
    plot.write_text(plot.read_text() + '\n[[target]]\nfile = "frames.nc"\n')
    return plot


@pytest.mark.study
def test_a_frame_that_was_left_out_is_predicted_within_its_errors(tmp_path, monkeypatch):
    few = partial(CalibrationSettings, stand_realisations=4, scatter_draws=16, full_renders=1)
    monkeypatch.setattr("fynjax.app.assembly._forward.CalibrationSettings", few)
    *used, last = frames()
    problem = read_problem(flown(tmp_path / "fit", used), free=FREE)
    fit = fx.fit(problem)
    other = read_problem(flown(tmp_path / "other", [last]), free=FREE)
    scene, (view,) = problem.scene, other.views
    # Parameters and factors of the bands are drawn together: what one lacks the other makes up for.
    (state,), search = fit.states, plot_search(problem)
    weights = search.weights(state.place, state.subspace)
    root = posterior_root(weights, np.asarray(state.best.slopes))
    random, free, drawn = np.random.default_rng(0), problem.free.names, []
    for k in range(24):
        u = jnp.asarray(fit.coordinates + root @ random.normal(size=len(root)))
        values, logs = jnp.split(search.space.physical(u), [len(free)])
        parameters = with_values(scene.parameters, scene.taxa, dict(zip(free, values, strict=True)))
        # The frame has the factors that the others share, and a drift of its own.
        own = logs.reshape(len(used), -1).mean(axis=0) + view.gains.drift * random.normal()
        stand, all_logs = scene.realisation(500 + k), jnp.concatenate([logs, own])
        found = look((*problem.views, view), stand, parameters, all_logs)[0]
        drawn.append(np.asarray(found).reshape(len(used) + 1, -1))
    # All frames see the same plants, whatever these are: the frame over the mean of the others.
    drawn = np.stack(drawn)
    ratio = drawn[:, -1] / drawn[:, :-1].mean(axis=1)
    known = np.asarray(problem.data.value).reshape(len(used), -1)
    measured = np.asarray(other.data.value) / known.mean(axis=0)
    error = np.asarray(other.data.sd / other.data.value) * measured
    sd = np.sqrt(ratio.var(axis=0, ddof=1) + (1.0 + 1.0 / len(used)) * error**2)
    off = (measured - ratio.mean(axis=0)) / sd
    means = [i for i, n in enumerate(view.names) if n in [f"{b}.mean" for b in view.bands.names]]
    print(np.round(measured[means], 3), np.round(ratio.mean(axis=0)[means], 3))
    print(np.round(sd[means], 3), [(view.names[i], off[i].round(2)) for i in means])
    print([(n, round(float(o), 2)) for n, o in zip(view.names, off) if abs(o) > 1.645])
    assert np.mean(np.abs(off) < 1.645) > 0.8
    assert np.abs(off[means]).max() < 2.0
    assert sd[means].max() < 0.08
    # It is brighter than they are, and predicted to be.
    assert (np.abs(ratio.mean(axis=0) - measured) < 0.5 * np.abs(measured - 1.0))[means].all()

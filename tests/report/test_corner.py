"""Posteriors over one another, drawn by corner."""

import jax.numpy as jnp
import numpy as np
import pytest
from matplotlib.colors import to_rgba

import fynjax as fx
from fynjax.app.report.figures import corner_plot


@pytest.fixture(scope="module")
def draws():
    """Of a sum that is measured, and a difference that is not, by two methods."""
    data = fx.Data(("sum",), jnp.array([1.2]), jnp.array([0.05]))
    space = fx.ParameterSpace(("first", "second"), [0, 0], [2, 2], [0.5, 0.5], [0.2, 0.2])
    fit = fx.fit(lambda x: x.sum()[None], data, space)
    options = {"predict": lambda x: x.sum()[None], "target": 300}
    return {name: fx.sample(fit, name, **options) for name in ("laplace", "emcee")}


def test_each_pair_has_contours_of_each_method_and_the_truth(draws):
    figure = fx.corner(draws, np.array([0.5, 3.0]))
    axes = np.reshape(figure.axes, (2, 2))
    assert axes[1, 0].get_xlabel() == "first"
    assert axes[1, 0].get_ylabel() == "second"
    low, high = axes[1, 1].get_xlim()
    assert low < 0.5 < 3.0 < high  # far from all draws, yet shown
    assert [text.get_text() for text in figure.legends[0].get_texts()] == [*draws, "prior"]
    colours = [line.get_color() for line in figure.legends[0].get_lines()]
    assert [patch.get_edgecolor() for patch in axes[0, 0].patches] == [
        to_rgba(colour) for colour in colours[:2]
    ]
    x, density = draws["emcee"].space.density()
    grey = axes[0, 0].lines[-1]
    np.testing.assert_allclose(grey.get_xdata(), x[:, 0])
    np.testing.assert_allclose(grey.get_ydata(), density[:, 0])


def test_one_posterior_needs_no_name(draws):
    figure = fx.corner(draws["emcee"])
    assert [t.get_text() for t in figure.legends[0].get_texts()] == ["posterior", "prior"]
    assert len(figure.axes) == 4


def test_labels_of_many_words_lie_in_the_figure():
    draws = np.random.default_rng(0).normal(size=(500, 2))
    names = ["species.Erica irregularis.leaf.chlorophyll [ug cm-2]", "ground.brightness [-]"]
    figure = corner_plot({"emcee": draws}, names, prior=(draws[:9], np.ones((9, 2))))
    figure.canvas.draw()
    for axes in figure.axes:
        for label in (axes.xaxis.label, axes.yaxis.label):
            box = label.get_window_extent()
            assert not label.get_text() or min(box.x0, box.y0) >= 0.0

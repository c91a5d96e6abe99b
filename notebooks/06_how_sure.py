# ---
# jupyter:
#   jupytext:
#     formats: ipynb,py:percent
#     text_representation:
#       extension: .py
#       format_name: percent
#       format_version: '1.3'
#       jupytext_version: 1.19.6
#   kernelspec:
#     display_name: Python 3
#     language: python
#     name: python3
# ---

# %% [markdown]
# # How sure? Laplace, emcee, NUTS
#
# A fit gives the best leaf, or the best plot, and an error. The posterior gives all that could have
# been. Is the error of the fit enough, or does one need the posterior?
#
# - **You learn** to fit any function of a few numbers, to draw from its posterior in three ways,
#   and to see in one picture what the data added to the prior (what was known before).
# - **You need** `pip install fynjax[posterior]`; without blackjax NUTS is left out.
# - **It takes** a minute.
#
# ![Figures of eight notebooks](../docs/images/notebooks.png)

# %%
import fynjax as fx  # before jax, so that kept programs are read without a word

PLOT = None  # your own: "my_plot/plot.toml" or "species.csv"; None takes the plot burnt in 2006

# %%
import importlib.util
import os

import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np

FAST = os.environ.get("FYNJAX_FAST") == "1"  # a smaller plot, shorter chains, for the check
METHODS = ["laplace", "emcee", *(["nuts"] if importlib.util.find_spec("blackjax") else [])]

# %% [markdown]
# ## A leaf, seen up to 1000 nm
#
# Four numbers of a leaf, measured with an error of 0.01 of reflectance in every band by an
# instrument that ends where water begins to absorb. Of each number the bounds, and median and
# standard deviation of the prior: leaves at large.

# %%
nm = np.arange(450, 2401, 10)
seen = nm <= 1000


def spectrum(x):
    leaf = fx.LeafParameters(structure=x[0], chlorophyll=x[1], water=x[2], dry_matter=x[3])
    return fx.prospect(leaf, nm).reflectance


unknown = {
    "layers": (1.0, 3.5, 1.6, 0.3),
    "chlorophyll [µg/cm²]": (0.0, 120.0, 40.0, 15.0),
    "water [cm]": (0.0, 0.06, 0.012, 0.005),
    "dry matter [g/cm²]": (0.0, 0.06, 0.008, 0.004),
}
leaf = fx.ParameterSpace(tuple(unknown), *np.transpose(list(unknown.values())))
leaf_truth = np.array([2.1, 28.0, 0.016, 0.014])
measured = spectrum(leaf_truth) + 0.01 * np.random.default_rng(0).normal(size=nm.size)
bands = fx.Data(tuple(f"{w} nm" for w in nm[seen]), measured[seen], np.full(seen.sum(), 0.01))

# %% [markdown]
# `fx.fit` is Laplace: a Gaussian about the best fit, in coordinates in which nothing passes its
# bounds. emcee walks through the posterior with many walkers, NUTS along its gradient with few.


# %%
def draw(function, data, space):
    """Draws from the posterior by each method."""
    fit, draws = fx.fit(function, data, space), {}
    for name in METHODS:
        target = 4000 if name == "laplace" else 50 if FAST else 400  # effective draws
        limits = {"target": target, "max_steps": 300 if FAST else 4000}
        draws[name] = fx.sample(fit, name, predict=function, **limits)
        print(f"{name}: {draws[name].effective_size:.0f} effective draws, {draws[name].status}")
    return draws


leaf_draws = draw(lambda x: spectrum(x)[seen], bands, leaf)

# %% [markdown]
# ## The posterior in one picture
#
# Contours hold 50 and 90 % of the draws; black is the truth, grey on the diagonal the prior.
# `draws.inference_data()` hands the same draws to arviz, with its diagnostics and plots.

# %%
fx.corner(leaf_draws, leaf_truth)

# %% [markdown]
# ## What the posterior foretells
#
# The draws say what the leaf's spectrum is beyond the instrument's end, without noise: the
# posterior predictive, beside what the prior alone foretold.

# %%
normal = jnp.asarray(np.random.default_rng(1).normal(size=(400, 4)))
drawn = leaf_draws["emcee"].values.reshape(-1, 4)[-400:]
cases = {"prior": jax.vmap(leaf.physical)(normal), "posterior": jnp.asarray(drawn)}
ends = {name: np.quantile(jax.vmap(spectrum)(x), [0.05, 0.95], axis=0) for name, x in cases.items()}
plt.figure(figsize=(8, 4))
for (name, (low, high)), colour in zip(ends.items(), ("0.6", "tab:orange")):
    plt.fill_between(nm, low, high, color=colour, alpha=0.5, label=f"90 % of the {name}")
plt.plot(nm[seen], measured[seen], "k.", ms=3, label="measured")
plt.plot(nm, spectrum(leaf_truth), "k", lw=0.8, label="truth")
plt.gca().set(xlabel="wavelength [nm]", ylabel="reflectance", title="Beyond what was measured")
plt.legend(frameon=False)
plt.show()

# %% [markdown]
# ## Four numbers of a plot
#
# Of the plot a drone's image gives five statistics; unknown are four factors on what its table
# says. A chain asks for thousands of images. A polynomial of second degree stands in for them
# (`fx.emulate`); its error, and what other plantings change, are added to those of the data.

# %%
factors = ["species.*.cover", "species.*.leaf.chlorophyll", "ground.litter*", "ground.brightness"]
names = ["green.mean", "red.mean", "red_edge.mean", "nir.mean", "NDVI.std"]
scene = fx.read_scene(PLOT, size=1.0 if FAST else 2.0, structure="even")


def statistics(x, stand):
    image = fx.observe(stand.scaled(dict(zip(factors, x))), "mavic_3m", pixel=0.1)
    return jnp.log(fx.metrics.image_statistics(image.reflectance, names))


ones, plot_truth = np.ones(4), np.array([0.8, 0.7, 0.7, 1.2])
labels = ("cover", "chlorophyll", "litter", "soil")
plot = fx.ParameterSpace(labels, 0.3 * ones, 1.9 * ones, ones, 0.27 * ones)
count = 24 if FAST else 60  # images that the polynomial is fitted to
quick = fx.emulate(lambda x: statistics(x, scene), 0.4 * ones, 1.7 * ones, points=count)
others = [statistics(ones, scene.realisation(k)) for k in range(1, 5 if FAST else 13)]
error = np.hypot(0.02, quick.error)
seen_there = statistics(plot_truth, scene.realisation(99))
data = fx.Data(tuple(names), seen_there, error).with_scatter(jnp.stack(others) - quick(ones))
print("error of the polynomial:", ", ".join(f"{n} {e:.1%}" for n, e in zip(names, quick.error)))

# %%
plot_draws = draw(quick, data, plot)
known = dict(zip(labels, plot_draws["emcee"].constrained.clip(0)))
print("Prior variance removed:", ", ".join(f"{n} {share:.0%}" for n, share in known.items()))
fx.corner(plot_draws, plot_truth)

# %% [markdown]
# What the posterior foretells of the image, beside what was measured, in standard errors:

# %%
draws = plot_draws["emcee"]
fx.report.figures.predictive_plot(draws.predicted, data.value, data.sd, names)

# %% [markdown]
# Where contours of the three ways lie on one another, the error of the fit is all one needs. Where
# a cloud leans, the image knows a combination better than either number alone, and one measurement
# on the ground of either of the two helps both.
#
# **For your own plot** set `PLOT`; `fynjax posterior plot.toml --target image.tif` does it for
# every parameter and can be interrupted.
#
# **Where to go next**: [07_three_sensors](07_three_sensors.ipynb) asks which sensor notices what,
# [08_the_paper](08_the_paper.ipynb) holds such a plot against printed numbers.

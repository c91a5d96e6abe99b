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
# # Sensitivity: what moves NDVI, and where in the image
#
# NDVI is read as greenness, or cover, or health. What does it respond to on this plot, in which
# pixels, and how sure is the answer when nobody knows where each plant stands?
#
# - **You learn** to take the derivative of a whole image, to check it against finite differences,
#   to see how far slopes depend on chance, and to share out the variance of NDVI among all that a
#   field table leaves open.
# - **You need** `pip install fynjax[analysis]`.
# - **It takes** two minutes the first time, most of it compilation.
#
# ![Where plants would move to brighten the near infrared](../docs/images/feet.png)

# %%
import fynjax as fx  # before jax, so that kept programs are read without a word

PLOT = None  # your own: "my_plot/plot.toml" or "species.csv"; None takes the plot burnt in 2006
SPECIES = None  # whose cover is moved in the image; None takes the one with the largest cover

# %%
import os

import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
import pandas as pd

FAST = os.environ.get("FYNJAX_FAST") == "1"  # a smaller plot, fewer plantings, for the check
scene = fx.read_scene(PLOT, size=1.0 if FAST else 2.0, structure="even")
taxa, cover = scene.taxa, scene.parameters.species.cover
SPECIES = SPECIES or taxa[int(np.argmax(cover))]

# %% [markdown]
# ## Where in the image
#
# `jax.jvp` takes the derivative of every pixel along one direction: more cover of one species. The
# plants of the picture are whole; the slope is that of the mean over all plantings, in which the
# next plant of the species may stand at some of the sites held ready for it.


# %%
@jax.jit
def ndvi(factors, stand):
    plot = stand.scaled({f"species.{taxon}.cover": f for taxon, f in zip(taxa, factors)})
    return fx.observe(plot, "mavic_3m", pixel=0.1).index("NDVI")


one, this = jnp.ones(len(taxa)), jnp.array([float(taxon == SPECIES) for taxon in taxa])
image = fx.observe(scene, "mavic_3m", pixel=0.1)
_, slope = jax.jvp(lambda factors: ndvi(factors, scene), (one,), (this,))

# %% [markdown]
# ## Is it right?
#
# Against finite differences, of the stand in expectation (`scene.expected()`), whose slope is
# taken. Whole plants come and go by jumps, which have no slope.

# %%
step, stand = 0.001, scene.expected()
_, exact = jax.jvp(lambda factors: ndvi(factors, stand), (one,), (this,))
quotient = (ndvi(one + step * this, stand) - ndvi(one - step * this, stand)) / (2 * step)
wrong = float(jnp.abs(quotient - exact).max() / jnp.abs(exact).max())
print(f"Largest difference from finite differences: {wrong:.2%} of the steepest pixel")

# %% [markdown]
# Image and gradient map. The slope sits where plants of the species come in or drop out, and
# where their shade falls; elsewhere the image does not notice.

# %%
fig, (left, right) = plt.subplots(1, 2, figsize=(10, 4.5), layout="constrained")
where = {"origin": "lower", "extent": (0, scene.grid.extent[0], 0, scene.grid.extent[1])}
left.imshow(fx.photo(image), **where)
left.set(title="the plot from above, nearly true colour", xlabel="east [m]", ylabel="north [m]")
most = 0.1 * float(jnp.abs(slope).max())
shown = right.imshow(0.1 * slope, cmap="PuOr", vmin=-most, vmax=most, **where)
right.set(title=f"10 % more {SPECIES}", xlabel="east [m]")
fig.colorbar(shown, label="change of NDVI")
plt.show()

# %% [markdown]
# ## Which species, and how sure?
#
# Now the mean over the image, and all species at once: one backward pass (`jax.grad`) a planting.
# The plants of a planting stand by chance, so a slope differs from planting to planting. Bars are
# means, lines 95 % intervals of the mean; a bar is hollow where another set of plantings could turn
# it round.

# %%
grad = jax.jit(jax.grad(lambda factors, stand: ndvi(factors, stand).mean()))
plantings = 4 if FAST else 16
each = 0.1 * np.array([grad(one, scene.realisation(k)) for k in range(plantings)])
bars = pd.DataFrame(
    {"mean": each.mean(0), "half": 2.1 * each.std(0, ddof=1) / plantings**0.5}, taxa
)
bars = bars.sort_values("mean")

# %%
sure = bars["mean"].abs() > bars["half"]
plt.figure(figsize=(8, 4.5), layout="constrained")
fill = np.where(sure, "tab:blue", "white")
plt.barh(bars.index, bars["mean"], xerr=bars["half"], color=fill, edgecolor="tab:blue")
plt.xlabel(f"change of the mean NDVI for 10 % more cover ({plantings} plantings)")
plt.title(f"{sure.sum()} of {len(bars)} slopes differ from zero")
plt.show()

# %% [markdown]
# ## All that the field leaves open
#
# A slope holds at one point, and says nothing of how far a parameter can stray. So let every
# parameter stray as far as its prior does, those of a kind together in all species. Sobol's index
# is the share of the variance of NDVI that a kind explains, alone and with its interactions.
# Thousands of images are needed for that; a polynomial of second degree stands in for them. Its
# error is in the title: shares smaller than its square say nothing.

# %%
kinds = ["cover", "dead_fraction", "leaf_area_index", "leaf.chlorophyll", "litter_fraction"]
kinds += ["brightness", "wood_brightness", "diameter", "height", "shoot_clumping"]
kinds += [f"leaf.{k}" for k in ("structure", "carotenoids", "water", "dry_matter")]
kinds = kinds[:7] if FAST else kinds
free = fx.free(scene, *(f"*.{kind}" for kind in kinds))
place = np.array([[n.endswith(f".{kind}") for kind in kinds].index(True) for n in free.names])


@jax.jit
def mean_ndvi(u):
    plot = stand.with_values(dict(zip(free.names, free.alone(u[place]))))
    return fx.observe(plot, "mavic_3m", pixel=0.1).index("NDVI").mean()[None]


# %%
zero, terms = np.zeros(len(kinds)), (len(kinds) + 1) * (len(kinds) + 2) // 2
quick = fx.emulate(mean_ndvi, zero - 2, zero + 2, points=2 * terms)
unit = fx.ParameterSpace(kinds, zero - 9, zero + 9, zero, zero + 1, distribution="normal")
sobol = fx.inversion.sobol_indices(quick, unit, ["NDVI"], samples=512)

# %%
share = pd.DataFrame({"alone": sobol.first[0], "with interactions": sobol.total[0]}, kinds)
spread = float(np.sqrt(sobol.variance[0]))
ax = (100 * share.sort_values("with interactions")).plot.barh(figsize=(8, 5), width=0.8)
ax.axvspan(0, 100 * (quick.error[0] / spread) ** 2, color="0.9", zorder=0)
ax.set(xlabel="share of the variance of the mean NDVI [%]; grey, the polynomial's error")
ax.set_title(f"NDVI strays by {spread:.3f}; the polynomial's error {quick.error[0] / spread:.0%}")
plt.show()

# %% [markdown]
# Slope and variance need not agree: a parameter with a gentle slope that nobody knows may matter
# more than a steep one that is well measured. Where kinds share the variance, a change of NDVI
# alone cannot say which of them changed.
#
# **For your own plot** set `PLOT` and `SPECIES`; `fynjax sensitivity plot.toml --sobol 256` does it
# for other indices and every parameter.
#
# **Where to go next**: [04_gradients](04_gradients.ipynb) shows how a number of whole plants gets a
# slope, [07_three_sensors](07_three_sensors.ipynb) asks which sensor notices what.

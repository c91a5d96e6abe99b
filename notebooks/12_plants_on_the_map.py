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
# # Plants that are on the map: every pixel counts
#
# In notebook [02](02_calibrate_by_gradient.ipynb) nobody knows where a plant stands, so an image is
# some statistics, and most of what is free stays where the table put it. Here the crowns were
# mapped in a GIS over the orthophoto. Each pixel then has its plant, and leaves come out.
#
# - **You learn** to fit a plot whose crowns are mapped, to look at what is left in each pixel, and
#   to see which pixels know a diameter and which a leaf.
# - **You need** fynjax; for a plot of your own its crowns (polygons or points with taxon and
#   diameter) and an orthophoto of reflectance.
# - **It takes** some three minutes the first time.
#
# ![Figures of eight notebooks](../docs/images/notebooks.png)

# %%
import fynjax as fx  # before jax, so that kept programs are read without a word

TABLE = None  # your own: "species.csv"; None takes three species
SIDE = 3.0  # m, of the plot

# %%
import os
from fnmatch import fnmatch

import jax
import matplotlib.pyplot as plt
import numpy as np

FAST = os.environ.get("FYNJAX_FAST") == "1"  # a smaller plot, for the check
SIDE = 1.5 if FAST else SIDE
columns = "taxon", "growth_form", "mean_diameter_cm", "cover_percent", "height_max_m"
erica = "Erica irregularis", "rounded_shrub", 45, 22, 0.67
metalasia = "Metalasia muricata", "upright_ericoid", 35, 15, 1.2
restio = "Restio eleocharis", "tussock", 40, 12, 0.6
table = TABLE or [dict(zip(columns, row)) for row in (erica, metalasia, restio)]

# %% [markdown]
# ## A plot, and what was mapped of it
#
# For an example whose truth is known: leaves, leaf area, crowns and ground are not those of the
# table, plants have lobes and shoots that no map holds, and the camera's bands are off by up to
# 10 %. What was mapped are the crowns' middles and, by eye, diameters that are all 15 % too wide.

# %%
WIDE = 1.15
drawn = fx.Scene.from_table(table, size=SIDE, seed=5)
stand = fx.scene.hard_instances(drawn, drawn.parameters)
feet = np.stack([stand.x, stand.y], axis=1)
crowns = fx.scene.Crowns(stand.species, feet, WIDE * stand.diameter, stand.height)
mapped = drawn.with_plants(crowns, seed=11)

what = {
    "species.*.diameter": 1.0 / WIDE, "species.*.leaf.chlorophyll": 0.7,
    "species.*.leaf_area_index": 0.8, "ground.brightness": 1.2,
}  # fmt: skip
truth = drawn.with_plants(crowns, seed=12).scaled(what)
gain, random = np.array([1.06, 0.95, 0.98, 1.05]), np.random.default_rng(1)
seen = np.asarray(fx.observe(truth, "mavic_3m", pixel=0.05).reflectance, float)
image = gain[:, None, None] * seen * (1.0 + 0.01 * random.normal(size=seen.shape))

# %% [markdown]
# ## The fit
#
# The same three lines as in notebook 02, but `from_pixels`. What a pixel is off by is not the
# camera's noise but the plants' lobes and shoots; fynjax computes it for the plot. Gains of the
# camera are estimated beside the plot.

# %%
free = fx.free(mapped, *what)
data = fx.Data.from_pixels(image, "mavic_3m", pixel=0.05, gains=fx.sensors.Gains(0.1))
fit = fx.fit(mapped, data, free, error="none")  # the model made the image
print(fit)

# %% [markdown]
# Start (the table and the map), end with its 90 % interval, and truth, each over the start. The
# objective falls in few steps.

# %%
found = fit.table().set_index("name")
true = [next(factor for w, factor in what.items() if fnmatch(n, w)) for n in found.index]
fig, (left, right) = plt.subplots(1, 2, figsize=(11, 4.5), layout="constrained")
ends = found[["q05", "q95"]].sub(found["estimate"], axis=0).abs().div(found["prior"], axis=0)
place = np.arange(len(found))
left.errorbar(found["estimate"] / found["prior"], place, xerr=ends.T.values, fmt="o")
left.plot(true, place, "kx")
left.set_yticks(place, [n.removeprefix("species.") for n in found.index])
left.set(title="found, and truth (x)", xlabel="over the value of table and map")
right.semilogy(np.asarray(fit.fit.loss), "o-")
right.set(xlabel="step", ylabel="objective")
plt.show()
held = np.mean((found["q05"] <= true * found["prior"]) & (true * found["prior"] <= found["q95"]))
print(f"{100 * held:.0f} % of the 90 % intervals hold the truth")

# %% [markdown]
# ## What is left in each pixel
#
# Measured and fitted (0 to 0.6), and their difference (-0.2 red to 0.2 blue), in the near infrared.
# What is left are lobes and shoots: no whole crown has one colour. A crown that has is of another
# species, or was mapped wrongly.

# %%
blocks, nir = fit.blocks, list(fx.metrics.BANDS).index("nir")
fig, axes = plt.subplots(1, 3, figsize=(11, 3.6), layout="constrained")
box = {"origin": "lower", "extent": (0, SIDE, 0, SIDE)}
last = blocks.with_error[nir] - blocks.measured[nir]
for axis, title, picture, style in (
    (axes[0], "measured", blocks.measured[nir], {"cmap": "gray", "vmin": 0.0, "vmax": 0.6}),
    (axes[1], "fitted", blocks.with_error[nir], {"cmap": "gray", "vmin": 0.0, "vmax": 0.6}),
    (axes[2], "fitted less measured", last, {"cmap": "RdBu", "vmin": -0.2, "vmax": 0.2}),
):
    axis.imshow(picture, **box, **style)
    axis.set(title=title, xlabel="m")
plt.show()

# %% [markdown]
# ## Which pixels know what
#
# The slope of the near infrared by the mean diameter of one species, and by the chlorophyll of its
# leaves in the red edge: a diameter is known at the edges of crowns and in the shade beside them,
# a leaf in the crowns themselves.


# %%
def pictured(factor, what):
    plot = mapped.scaled({f"species.{mapped.taxa[0]}.{what}": factor})
    return fx.observe(plot, "mavic_3m", pixel=0.05).reflectance


fig, axes = plt.subplots(1, 2, figsize=(8.5, 3.8), layout="constrained")
for axis, kind, band in ((axes[0], "diameter", "nir"), (axes[1], "leaf.chlorophyll", "red_edge")):
    slope = jax.jvp(lambda f, kind=kind: pictured(f, kind), (1.0,), (1.0,))[1]
    slope = np.asarray(slope[list(fx.metrics.BANDS).index(band)])
    most = np.quantile(np.abs(slope), 0.99)
    axis.imshow(slope, cmap="RdBu", vmin=-most, vmax=most, **box)
    axis.set(title=f"d {band} / d ln {kind}", xlabel="m")
plt.show()

# %% [markdown]
# **For your own plot** name the file of its crowns in the plot file (`crowns`), and give the
# orthophoto: `fynjax calibrate plot.toml --target orthophoto.tif` writes all this as a page, with
# the residuals of every band. Where crowns are not mapped, `fynjax crowns` finds plants in the
# orthophoto.
#
# **Where to go next**: [04_gradients](04_gradients.ipynb) for slopes of the expected stand,
# [10_what_a_sensor_can_know](10_what_a_sensor_can_know.ipynb) for what other sensors would know.

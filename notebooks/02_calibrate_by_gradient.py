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
# # Calibrate a plot to a drone image, by gradient
#
# A species table was written in the field: covers guessed by eye, leaves taken from a library. Then
# a drone flew over. Which of these numbers can its image correct?
#
# - **You learn** to fit a plot to an image in three lines; to do the same by hand, with
#   `jax.value_and_grad` and a solver of optimistix; and to see what the image decides and what it
#   leaves open.
# - **You need** fynjax; for a plot of your own its species table and an orthophoto of reflectance.
# - **It takes** two to three minutes the first time, most of it compilation.
#
# ![Images before and after a calibration](../docs/images/calibrate.png)

# %%
import fynjax as fx  # before jax, so that kept programs are read without a word

IMAGE = None  # your own: "orthophoto.tif"; None makes one of a plot that differs from its table
PLOT = None  # your own: "my_plot/plot.toml" or "species.csv"; None takes the plot burnt in 2006
SIDE = 3.0  # m, of the simulated plot

# %%
import os

import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import optimistix as optx
import pandas as pd

FAST = os.environ.get("FYNJAX_FAST") == "1"  # a smaller plot, fewer draws, for the check
scene = fx.read_scene(PLOT, size=1.0 if FAST else SIDE, structure="even")
what = ["species.*.cover", "species.*.leaf.chlorophyll", "ground.litter*", "ground.brightness"]

# %% [markdown]
# ## The image
#
# For an example whose truth is known the plot is planted anew, with little more than half of the
# cover and half of the chlorophyll, with less litter on brighter soil.

# %%
truth = None if IMAGE else scene.realisation(99).scaled(dict(zip(what, (0.55, 0.5, 0.6, 1.4))))
if truth:
    seen, IMAGE = fx.observe(truth, "mavic_3m", pixel=0.1), "example_orthophoto.tif"
    fx.io.raster.write_geotiff(IMAGE, seen.reflectance, seen.bands, pixel_m=0.1)
measured = fx.compare.read_drone_image(IMAGE)
print(measured.description())

# %% [markdown]
# ## Three lines
#
# What may move, with a prior. One eye guessed all covers and one library gave all leaves, so what
# they are off by is mostly `common` to the species. What was measured: statistics of the image, for
# nobody knows where each plant stands. And the fit, which averages over plantings. It prints the
# stand first: of single species an image says little, of all together more.

# %%
n = 2 if FAST else 4  # plantings; more take longer and leave less to chance
settings = fx.inversion.CalibrationSettings(rounds=1, stand_realisations=n, scatter_draws=4 * n)
far = dict(zip(what, (0.25, 0.4, 0.3, 0.3)))  # standard deviations, as shares of the table's values
free = fx.free(scene, *what, prior=far, common=0.95)
data = fx.Data.from_image(
    IMAGE, "mavic_3m", pixel=measured.pixel_m, statistics=("*.mean", "NDVI.std")
)
fit = fx.fit(scene, data, free, settings=settings)
print(fit)

# %%
for when, found in (("table", fit.statistics_before), ("calibrated", fit.statistics_after)):
    off = jnp.abs((jnp.asarray(found) - data.value) / fit.data.sd)
    print(f"{when}: up to {off.max():.1f} standard errors off ({data.names[int(off.argmax())]})")

# %% [markdown]
# ## The same by hand
#
# `u` are the free parameters in units of their priors, `free.named(u)` their values by name. The
# loss is half the squared misfit, in units of its error, plus half the squared distance from the
# prior. However many parameters are free, `jax.value_and_grad` takes one backward pass for all
# their slopes; the solver BFGS takes fifteen steps with them. One planting has to do here, whose
# stand is the one in expectation (`scene.expected()`): a smooth function, value and slope.


# %%
def statistics(values):
    plot = scene.expected().with_values(dict(zip(free.names, values)))
    image = fx.observe(plot, "mavic_3m", pixel=measured.pixel_m)
    return fx.metrics.image_statistics(image.reflectance, data.names)


residual = fx.whitened_residual(statistics, fit.data, free)


def loss(u, _):
    here = jax.lax.stop_gradient(u)
    value, slope = jax.value_and_grad(lambda u: 0.5 * jnp.sum(residual(u) ** 2))(here)
    return value + slope @ (u - here), None  # what the solver takes: the value, and its slope


# %%
solver, u, path, losses = optx.BFGS(rtol=1e-3, atol=1e-3), jnp.zeros(len(free.names)), [], []
state = solver.init(loss, u, None, {}, jax.ShapeDtypeStruct((), u.dtype), None, frozenset())
step = jax.jit(lambda u, state: solver.step(loss, u, None, {}, state, frozenset())[:2])
for _ in range(15):
    u, state = step(u, state)
    path.append(u)
    losses.append(float(state.f_info.f))

# %% [markdown]
# The loss, and the stand's numbers at each step over what they are by the table; dotted, the truth.

# %%
of_stand = jax.jit(lambda u: fx.inversion.stand_values(scene.with_values(free.named(u)).expected()))
walk = pd.DataFrame(map(of_stand, path)).astype(float).filter(regex="green|share|phyll|crown")
end = pd.Series(fx.inversion.stand_values(truth) if truth else {}, walk.columns, float)
fig, (left, right) = plt.subplots(1, 2, figsize=(11, 4), layout="constrained")
pd.Series(losses).plot(ax=left, logy=True, style="o-", xlabel="step", ylabel="loss")
(walk / walk.iloc[0]).plot(ax=right, style=["o-", "s--", "^-", "d:"], alpha=0.8)
right.hlines(end / walk.iloc[0], 0, len(walk), ["C0", "C1", "C2", "C3"], "dotted")
right.set(xlabel="step", ylabel="over the table's value")
right.legend(loc=(0.45, 0.3), frameon=False)
plt.show()

# %% [markdown]
# The walk stops where chance in one planting and the prior hold it: short of the truth where they
# are stronger than the image. In the pictures the calibrated plants are no copy of the measured
# ones, which stand elsewhere; it is the stand that is to be alike.

# %%
images = {"table": fit.image_before, "measured": measured.values, "calibrated": fit.image_after}
fx.report.figures.composites(images, fx.metrics.BANDS, pixel_m=measured.pixel_m, kind="true_like")

# %% [markdown]
# ## What stays dark
#
# Now leaf area, dead tissue and height of every species are free as well. Each bar is the share of
# its prior variance that the image removed: of the stand, of the ground, and of the species the
# median of a kind. A number can have moved and yet have a bar of zero: it is as uncertain as
# before. With `common=0.95` a species' bar is mostly that of all species together.

# %%
more = "species.*.leaf_area_index", "species.*.dead_fraction", "species.*.height"
wider = fx.free(scene, *what, *more, prior=far, common=0.95)
wide = fit if FAST else fx.fit(scene, data, wider, settings=settings, start=fit)
known = wide.table().set_index("name")["constrained"]
share = known.groupby([name.split(".")[-1] for name in known.index]).median()
stand = wide.stand().set_index("name")["constrained"].rename(lambda n: "stand: " + n)
share = 100 * pd.concat([stand, share]).sort_values()
share.plot.barh(
    figsize=(8, 4), title=f"{len(known)} parameters free", xlabel="variance removed [%]"
)
plt.show()

# %% [markdown]
# What the image does not see stays where the table put it, with the table's error. That is honest,
# and tells where a day in the field is worth most.
#
# **For your own plot** set `IMAGE`, `PLOT` and `SIDE`; the image's bands are known by their names,
# and pixels without data are left out. `fynjax calibrate plot.toml --target orthophoto.tif` does it
# on the command line and writes a page.
#
# **Where to go next**: [03_sensitivity](03_sensitivity.ipynb) asks what moves NDVI,
# [06_how_sure](06_how_sure.ipynb) draws the posterior of such a fit.

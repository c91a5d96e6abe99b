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
# # Calibrate a plot to its drone image
#
# A species table was written in the field: covers guessed by eye, leaves taken from a library. Then
# a drone flew over. Which of those numbers can the image correct, and which can it not? To know the
# right answer, we make the image ourselves, from a plot that differs from its table; what the
# calibration finds can then be held against the truth.

# %%
from fynjax.io.plot import example_folder

# Your own plot goes here, such as "my_plot/plot.toml"; `fynjax init my_plot` writes one.
PLOT = example_folder() / "plot.toml"
SPECIES = ("Erica irregularis", "Indigofera brachystachya")  # in truth less and more

# %%
import os

import equinox as eqx
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np

from fynjax.assembly import aim_without_air, build_plot
from fynjax.inversion import (
    CalibrationSettings,
    ImageView,
    calibrate_plot,
    free_space,
    weigh_targets,
)
from fynjax.io.instruments import load_sensor
from fynjax.io.plot import read_plot
from fynjax.metrics import image_statistics
from fynjax.scene import named_values, stand_realisation

FAST = os.environ.get("FYNJAX_FAST") == "1"  # a smaller plot, fewer steps
SIDE = 2.0 if FAST else 4.0  # m
PIXEL = 0.1 if FAST else 0.05  # m

# %% [markdown]
# ## The table, and the truth
#
# The table is that of the plot burnt in 2006. In truth there is less of *Erica*, more of
# *Indigofera*, the leaves hold a third less chlorophyll, and there is less litter on the ground.
# The real plants also stand elsewhere than those of the simulation, for nobody measured where each
# stands: `stand_realisation` draws other places.

# %%
plot = read_plot(PLOT)
plot = plot.replace(
    size_m=(SIDE, SIDE),
    structure_m="even",
    sensor=plot.sensor.replace(pixel_m=PIXEL),
)
scene, table = build_plot(plot)


place = np.array([plot.taxa.index(taxon) for taxon in SPECIES])
truth = eqx.tree_at(
    lambda p: (p.species.cover, p.leaf.chlorophyll, p.ground.litter_fraction),
    table,
    (
        table.species.cover.at[place].multiply(jnp.array([0.65, 1.4])),
        0.67 * table.leaf.chlorophyll,
        0.6 * table.ground.litter_fraction,
    ),
)

drone = aim_without_air(plot, scene, table, load_sensor("mavic_3m"))
render = eqx.filter_jit(lambda scene, parameters: drone.observe(scene, parameters).reflectance)
measured = render(stand_realisation(scene, 99), truth)

# %% [markdown]
# ## What is compared
#
# Not pixel with pixel, since the plants stand elsewhere, but the statistics of the image: mean and
# bright tail of the bands and of NDVI. Each gets an error of 2 %, for calibration and the model's
# own faults; what another planting changes is measured and added by `calibrate_plot`.

# %%
names = tuple(
    f"{layer}.{kind}"
    for layer in ("green", "red", "red_edge", "nir", "NDVI")
    for kind in ("mean", "q90")
)
targets = weigh_targets(names, np.asarray(image_statistics(measured, names)), relative_sd=0.02)

# %% [markdown]
# ## What may move
#
# Cover and chlorophyll of every species, litter and brightness of the ground. How far each may
# stray from the table is a prior, here those of the plot file: covers seen by eye are uncertain by
# a quarter, leaves that were not measured by half of their value and more.

# %%
free = ("species.*.cover", "species.*.leaf.chlorophyll", "ground.litter_fraction")
space = free_space(scene, table, (*free, "ground.brightness"), plot.calibration.relative_sd)
result = calibrate_plot(
    scene,
    table,
    targets,
    space,
    [ImageView(names, drone)],
    CalibrationSettings(
        stride=2 if FAST else 4,
        rounds=1,
        stand_realisations=3 if FAST else 6,
        max_steps=3 if FAST else 8,
    ),
)
print(f"{len(space.names)} free parameters, {len(names)} statistics: {result.fit.explanation}")
print("misfit at each step:", ", ".join(f"{loss:.3g}" for loss in result.fit.loss))

# %% [markdown]
# Each step is one render with its gradients: all the slopes of a statistic, with respect to all
# free parameters, cost a few renders, however many parameters there are. That is what makes such a
# search possible at all.

# %%
limits = {"origin": "lower", "extent": (0, SIDE, 0, SIDE)}
fig, axes = plt.subplots(1, 3, figsize=(10, 3.7), layout="constrained", sharey=True)
pictures = {
    "As the table says": result.image_before,
    "Measured (other plants)": measured,
    "Calibrated": result.image_after,
}
for ax, (title, image) in zip(axes, pictures.items()):
    green, red, _, nir = np.asarray(image)
    ax.imshow(np.stack([nir / 0.4, red / 0.1, green / 0.1], axis=-1).clip(0, 1), **limits)
    ax.set(title=title, xlabel="east [m]")
axes[0].set(ylabel="north [m]")
plt.show()

# %% [markdown]
# ## Does the image agree?
#
# Simulated minus measured, in units of the error. Within one or two, there is nothing left for
# these statistics to say.

# %%
sd = np.asarray(result.data.sd)
before = (np.asarray(result.statistics_before) - np.asarray(targets.value)) / sd
after = (np.asarray(result.statistics_after) - np.asarray(targets.value)) / sd
row = np.arange(len(names))
fig, ax = plt.subplots(figsize=(8, 4.6), layout="constrained")
ax.axvspan(-1, 1, color="0.92", lw=0)
ax.hlines(row, before, after, color="0.7", lw=1)
ax.plot(before, row, "o", color="tab:orange", label="as the table says")
ax.plot(after, row, "o", color="tab:blue", label="calibrated")
ax.set_yticks(row, [name.replace("_", " ") for name in names])
ax.invert_yaxis()
ax.set(
    xlabel="(simulated - measured) / error",
    title=f"Largest misfit {abs(before).max():.1f} errors before, {abs(after).max():.1f} after",
)
ax.legend(frameon=False)
plt.show()

# %% [markdown]
# ## Did it find the truth?
#
# Agreement of the image is no proof. Here is each parameter as a multiple of the table's value:
# grey, what the table left open; blue, what is left with the image; the cross is the truth.

# %%
fit = result.fit
true_values = {k: float(v) for k, v in named_values(truth, plot.taxa).items()}
prior = np.asarray(space.prior)
true = np.array([true_values[name] for name in space.names]) / prior
centre, width = np.asarray(fit.estimate) / prior, np.asarray(fit.sd) / prior
loose = np.asarray(space.prior_sd) / prior
known = np.asarray(fit.constrained)
halved = len(fit.well_constrained())


def short(name):
    return name.removeprefix("species.").replace(".leaf", "").replace(".", ": ")


order = np.argsort([("chlorophyll" in name) + 2 * ("ground" in name) for name in space.names])
row = np.arange(len(order))
fig, ax = plt.subplots(figsize=(8, 7), layout="constrained")
ax.barh(row, 2 * loose[order], left=1 - loose[order], color="0.88", height=0.8, label="prior")
ax.errorbar(
    centre[order], row, xerr=width[order], fmt="o", ms=4, color="tab:blue", label="with the image"
)
ax.plot(true[order], row, "x", color="k", ms=7, label="truth")
ax.set_yticks(row, [short(space.names[i]).replace("_", " ") for i in order], fontsize=8.5)
ax.invert_yaxis()
ax.set(
    xlabel="value over that of the table (bars: one standard deviation)",
    xlim=(0, 2.1),
    title=f"The image halves the error of {halved} of {len(space.names)} parameters",
)
fig.legend(loc="outside lower center", ncols=3, frameon=False)
plt.show()

# %%
off = (true - centre) / width
print(f"truth within one standard deviation: {np.mean(abs(off) < 1):.0%} (68 % expected)")
print(f"truth within two: {np.mean(abs(off) < 2):.0%} (95 % expected)")

# %% [markdown]
# ## What the image does say
#
# One species against another it can hardly tell: their leaves differ too little in four bands. But
# combinations of parameters it may know well. A Gaussian about the estimate gives the error of any
# sum, here of what an ecologist might ask for.

# %%
slope = np.asarray(space.slope(fit.whitened))  # own units for each whitened one
share = {"cover": np.zeros(len(prior)), "chlorophyll": np.zeros(len(prior))}
cover = np.asarray(table.species.cover)
for i, name in enumerate(space.names):
    if name.endswith(".cover") and "Deadwood" not in name:
        share["cover"][i] = 1.0
    if name.endswith("chlorophyll"):
        taxon = name.split(".")[1]
        share["chlorophyll"][i] = cover[plot.taxa.index(taxon)] / cover.sum()


def removed(weights):
    """Share of the prior's variance of a sum that the image removes."""
    scaled = weights * slope
    return 1 - scaled @ np.asarray(fit.covariance) @ scaled / (scaled @ scaled)


is_cover, is_green = (np.array([kind in n for n in space.names]) for kind in share)
groups = {
    "cover of one species (best)": known[is_cover].max(),
    "cover of one species (median)": np.median(known[is_cover]),
    "cover of all living plants": removed(share["cover"]),
    "chlorophyll of one species (best)": known[is_green].max(),
    "chlorophyll of one species (median)": np.median(known[is_green]),
    "chlorophyll, mean over the cover": removed(share["chlorophyll"]),
    "litter on the ground": known[space.names.index("ground.litter_fraction")],
    "brightness of the soil": known[space.names.index("ground.brightness")],
}
mean, one = "chlorophyll, mean over the cover", "chlorophyll of one species (median)"
fig, ax = plt.subplots(figsize=(9, 3.6), layout="constrained")
colours = ["tab:blue" if value >= 0.75 else "0.7" for value in groups.values()]
ax.barh(list(groups), [100 * value for value in groups.values()], color=colours)
ax.axvline(75, color="k", lw=0.8, ls=":")
ax.invert_yaxis()
ax.set(
    xlabel="variance that the image removes [%] (dotted: error halved)",
    xlim=(0, 100),
    title=f"Chlorophyll: {groups[mean]:.0%} for the mean, {groups[one]:.0%} for one species",
)
plt.show()

# %%
print("Hardly seen at all, for instance:")
for direction in fit.weakly_constrained_directions(2):
    terms = [f"{w:+.2f} {short(n)}" for n, w in direction.items() if abs(w) > 0.1]
    print("  ", " with ".join(terms))
best = {n: float(w) for n, w in zip(space.names, np.asarray(fit.modes)[0]) if abs(w) > 0.25}
print("Best seen:", " with ".join(f"{w:+.2f} {short(n)}" for n, w in best.items()))

# %% [markdown]
# A parameter that the image does not see stays where the table put it, with the table's error. That
# is honest, and it tells where a day in the field is worth most.
#
# **For your own data**: your plot file in the first cell, the image by
# `fynjax.compare.read_drone_image`, or a table of its statistics by
# `fynjax.io.plot.read_statistics`; put into `free` what you doubt. The command
# `fynjax calibrate plot.toml --target image.tif` does all of it and writes a page with these
# figures, and `fynjax demo` calibrates the plot burnt in 2006 to its real, published image.

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
# # What an index responds to
#
# NDVI is read as greenness, or cover, or health. What does it respond to on this plot: the plants,
# their leaves, or the ground between them? Three answers, from cheap to thorough: slopes at one
# point (elasticities), slopes averaged over all that the field leaves open (DGSM), and shares of
# the variance with all interactions (Sobol).

# %%
from fynjax.io.plot import example_folder

# Your own plot goes here, such as "my_plot/plot.toml"; `fynjax init my_plot` writes one.
PLOT = example_folder() / "plot.toml"

# %%
import os
from itertools import combinations_with_replacement

import equinox as eqx
import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
from scipy.special import ndtri
from scipy.stats import qmc

from fynjax.assembly import build_plot, image_view
from fynjax.inversion import (
    ParameterSpace,
    PlotForward,
    coarser,
    derivative_measures,
    expected_sensitivity,
    search_form,
    sobol_indices,
)
from fynjax.io.plot import read_plot
from fynjax.scene import named_values, stand_realisation

FAST = os.environ.get("FYNJAX_FAST") == "1"  # a smaller plot, fewer runs
SIDE = 2.0 if FAST else 4.0  # m
STRIDE = 2 if FAST else 4  # every so many pixels are rendered
METRICS = ("NDVI.mean", "GNDVI.mean", "GSAVI.mean")
LABELS = {"NDVI.mean": "NDVI", "GNDVI.mean": "GNDVI", "GSAVI.mean": "GSAVI"}

plot = read_plot(PLOT).replace(size_m=(SIDE, SIDE), structure_m="even")
plot = plot.replace(sensor=plot.sensor.replace(pixel_m=0.1))
whole, table = build_plot(plot, rounding="random")
view = image_view(plot, whole, table, METRICS)
scene, (view,) = search_form(whole, table, [view], stride=STRIDE)  # coarse, as a search sees it

# %% [markdown]
# ## One point, all parameters
#
# `jax.grad` behind `expected_sensitivity` gives the slope of each index with respect to every
# number of the plot at once. The elasticity is the slope in percent: by how many percent the index
# changes for 1 % more of a parameter. It depends on which plants stand where, most so for covers
# and diameters. So slopes are taken for one planting after another, and are means with an error,
# until that of the leading ones is small. First, kind by kind: what happens when a kind grows by
# 1 % in all species?

# %%
everything = named_values(table, plot.taxa)
names = [
    name
    for name, value in everything.items()
    if name.startswith(("species", "ground")) and float(value) > 0
]
predict = PlotForward(table, tuple(names), (view,))
at = jnp.array([float(everything[name]) for name in names])
kinds = sorted({name.rsplit(".", 1)[1] for name in names})
kind_of = np.array([kinds.index(name.rsplit(".", 1)[1]) for name in names])
cover = np.array([i for i, name in enumerate(names) if name.endswith(".cover")])
taxa = [names[i].split(".")[1] for i in cover]
factors = [*kinds, *taxa]  # of all parameters of a kind, and of the cover of a species


def scaled(factor, scene):
    values = at * factor[kind_of]
    values = values.at[cover].multiply(factor[len(kinds) :], unique_indices=True)
    return predict(values, scene)


def planting(number):
    chance, _ = build_plot(plot, seed=1000 + number, rounding="random")
    return (stand_realisation(coarser(chance, table), number),)


local = expected_sensitivity(
    scaled, factors, METRICS, np.ones(len(factors)), planting, most=8 if FAST else 64
)
print(f"{len(names)} parameters, {len(METRICS)} indices, {local.plantings} plantings:", end=" ")
print(", ".join(f"{LABELS[m]} {v:.3f}" for m, v in zip(METRICS, local.value)))
print(f"errors of the leading elasticities: at most {local.leading_error.max():.0%} of them")

interval = local.quantile * local.elasticity_error
total = local.elasticity[:, : len(kinds)].T
certain = local.distinguished[:, : len(kinds)].T
order = np.argsort(abs(total).max(axis=1))
order = order[abs(total).max(axis=1)[order] > 0.002]
row = np.arange(len(order))
fig, ax = plt.subplots(figsize=(8, 5), layout="constrained")
for k, (metric, colour) in enumerate(zip(METRICS, ("tab:green", "tab:olive", "tab:brown"))):
    told = certain[order, k]
    ax.barh(
        row + 0.26 * (1 - k),
        total[order, k],
        height=0.26,
        color=np.where(told, colour, "none"),
        edgecolor=np.where(told, colour, "0.6"),
        xerr=interval[k, order],
        error_kw={"lw": 0.8, "ecolor": "0.3"},
        label=LABELS[metric],
    )
ax.axvline(0, color="0.5", lw=0.8)
ax.set_yticks(row, [kinds[i].replace("_", " ") for i in order])
kind, index = np.unravel_index(np.argmax(abs(total) * certain), total.shape)
ax.set(
    xlabel="elasticity: % change of the plot's mean index for 1 % more (95 % intervals)",
    title=f"Steepest: {LABELS[METRICS[index]]} by {kinds[kind].replace('_', ' ')}, in all species",
)
ax.legend(frameon=False)
plt.show()

# %% [markdown]
# The same, species by species, for cover alone: an index does not see a species by its cover, but
# by how its crowns differ from what they hide. Hollow: another set of plantings could turn it
# round.

# %%
elastic, share = local.elasticity[:, len(kinds) :], at[cover]
certain = local.distinguished[:, len(kinds) :]
order = np.argsort(elastic[0])
fig, ax = plt.subplots(figsize=(8, 4.6), layout="constrained")
for k, shift, colour in ((0, 0.2, "tab:green"), (2, -0.2, "tab:brown")):
    told = certain[k, order]
    ax.barh(
        np.arange(len(order)) + shift,
        elastic[k, order],
        0.4,
        color=np.where(told, colour, "none"),
        edgecolor=np.where(told, colour, "0.6"),
        xerr=interval[k, len(kinds) + order],
        error_kw={"lw": 0.8, "ecolor": "0.3"},
        label=LABELS[METRICS[k]],
    )
ax.axvline(0, color="0.5", lw=0.8)
ax.set_yticks(np.arange(len(order)), [f"{taxa[i]} ({100 * share[i]:g} %)" for i in order])
raised = [taxa[i] for i in order if certain[0, i] and elastic[0, i] > 0]
ax.set(
    xlabel="elasticity: % change of the index for 1 % more of the cover (95 % intervals)",
    title=f"{raised[-1]} raises NDVI most" if raised else "No cover raises NDVI for certain",
)
ax.legend(frameon=False, loc="lower right")
plt.show()
print(f"{certain[0].sum()} of {len(taxa)} slopes of NDVI are distinguished from zero")

# %% [markdown]
# ## All that the field leaves open
#
# A slope holds at one point, and says nothing of how far a parameter can stray. So let five things
# stray together, in all species alike, as far as a table of the field is uncertain: cover by a
# quarter, leaf area and chlorophyll by 40 %, litter by half of itself, the soil's brightness by 30
# %.

# %%
knobs = {  # factor or value: lower, upper, middle, standard deviation
    "living cover": (0.3, 2.0, 1.0, 0.25),
    "leaf area": (0.1, 3.0, 1.0, 0.4),
    "chlorophyll": (0.1, 2.5, 1.0, 0.4),
    "litter": (0.01, 0.99, 0.5, 0.25),
    "soil brightness": (0.2, 1.8, 0.8, 0.25),
}
space = ParameterSpace(tuple(knobs), *(jnp.array(column) for column in zip(*knobs.values())))
living = np.array([one.growth_form != "deadwood" for one in plot.species])


def indices(values, scene):
    cover, leaf_area, chlorophyll, litter, soil = values
    changed = eqx.tree_at(
        lambda p: (
            p.species.cover,
            p.species.leaf_area_index,
            p.leaf.chlorophyll,
            p.ground.litter_fraction,
            p.ground.brightness,
        ),
        table,
        (
            table.species.cover * jnp.where(living, cover, 1.0),
            table.species.leaf_area_index * leaf_area,
            table.leaf.chlorophyll * chlorophyll,
            litter,
            soil,
        ),
    )
    return view.predict(scene, changed).astype(values.dtype)


# %% [markdown]
# Sobol's indices share out the variance of an index: *first order* is what a parameter does alone,
# *total* adds all its interactions. They take thousands of runs. The mean squared slope (DGSM)
# takes fewer, and bounds the total index from above: a parameter whose bound is small can be left
# alone.
#
# So many images of a plot take a while. Five unknowns need them not: some images, spread over what
# is open, fix a cubic polynomial, and others tell how wrong it is. (With patience, hand `indices`
# itself to the two functions, with `context=(scene,)`; or have more unknowns, and a machine with an
# accelerator.)

# %%
degree = 2 if FAST else 3
terms = [t for n in range(degree + 1) for t in combinations_with_replacement(range(len(knobs)), n)]


def powers(u):
    return jnp.stack([jnp.prod(u[jnp.array(t, int)]) for t in terms])


count = 40 if FAST else 232
shares = qmc.Sobol(len(knobs), rng=0).random(count + 24)  # a power of two in all
design = jnp.asarray(ndtri(np.clip(shares, 0.01, 0.99)))  # in units of the prior
once = jax.jit(indices)
runs = np.array([once(space.physical(u), scene) for u in design])
basis = np.asarray(jax.vmap(powers)(design))
coefficients = np.linalg.lstsq(basis[:count], runs[:count])[0]
wrong = (runs - basis @ coefficients)[count:].std(axis=0) / runs.std(axis=0)
print("error of the polynomial, as a share of the spread:", end=" ")
print(", ".join(f"{LABELS[m]} {w:.0%}" for m, w in zip(METRICS, wrong)))


def stand_in(values):
    return powers(space.whitened(values)) @ coefficients


bounds = derivative_measures(stand_in, space, METRICS, samples=256, seed=1)
sobol = sobol_indices(stand_in, space, METRICS, samples=512, seed=1)

fig, axes = plt.subplots(1, 3, figsize=(11, 4), layout="constrained", sharey=True)
row = np.arange(len(knobs))
for k, ax in enumerate(axes):
    for values, errors, shift, colour, label in (
        (sobol.total, sobol.total_error, -0.18, "tab:green", "total"),
        (sobol.first, sobol.first_error, 0.18, "tab:olive", "alone"),
    ):
        ax.barh(
            row + shift,
            100 * values[k],
            0.36,
            xerr=100 * errors[k],
            color=colour,
            ecolor="0.3",
            label=label,
        )
    ax.plot(100 * bounds.bound[k], row, "k|", ms=22, mew=2, label="bound by DGSM")
    first = list(knobs)[int(np.argmax(sobol.total[k]))]
    ax.set(
        xlabel="share of the variance [%]",
        xlim=(0, None),
        title=f"{LABELS[METRICS[k]]}: mostly {first}",
    )
axes[0].set_yticks(row, list(knobs))
axes[0].invert_yaxis()
fig.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=3, frameon=False)
plt.show()

# %%
for k, metric in enumerate(METRICS):
    spread = np.sqrt(sobol.variance[k])
    alone, error = sobol.first[k].sum(), np.hypot.reduce(sobol.first_error[k])
    print(f"{LABELS[metric]:<8}varies by {spread:.3f};", end=" ")
    print(f"parameters one by one explain {alone:.0%} of it (error {error:.0%})")

# %% [markdown]
# An index answers several questions at once, and its name names only one of them. Where two
# parameters share its variance, its change alone cannot say which of them changed; a second index
# helps only if its shares differ. And elasticity and variance need not agree: a parameter with a
# gentle slope that nobody knows may matter more than a steep one that is well measured.
#
# **For your own data**: your `plot.toml`, any of `fynjax.metrics.VEGETATION_INDICES` as
# "NAME.mean", and your own doubts as priors. `fynjax sensitivity plot.toml --sobol 256` does it for
# every parameter.

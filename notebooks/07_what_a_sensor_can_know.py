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
# # What a sensor can know
#
# From which pixel size on does a species vanish from the data, and do more bands bring it back? No
# algorithm can do better than the Cramér-Rao bound: the slopes of what a sensor measures, against
# its errors, limit how well any unbiased method can know a cover. Where that bound exceeds the
# cover itself, the species cannot be distinguished from absent.

# %%
from fynjax.io.plot import example_folder

# Your own plot goes here, such as "my_plot/plot.toml"; `fynjax init my_plot` writes one.
PLOT = example_folder() / "plot.toml"
SPECIES = (  # whose cover is asked for; of the first three also chlorophyll
    "Erica irregularis",
    "Indigofera brachystachya",
    "Metalasia muricata",
    "Restio eleocharis",
    "Chironia baccifera",
    "Deadwood",
)

# %%
import dataclasses
import os

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.colors import LogNorm

from fynjax.assembly import build_plot
from fynjax.inversion import even_bands, fisher_information, free_space, sweep_sensors
from fynjax.io.instruments import load_sensor
from fynjax.io.plot import read_plot

FAST = os.environ.get("FYNJAX_FAST") == "1"  # a smaller plot, fewer species free
SIDE = 2.0 if FAST else 4.0  # m
GSD = (0.1, 0.5, 2.0) if FAST else (0.1, 0.2, 0.4, 1.0, 2.0, 4.0)  # m, pixels
BANDS = (1, 4) if FAST else (1, 2, 4, 8)

# %% [markdown]
# ## The question
#
# The plot that burnt in 2006, seen by cameras that share the spectrum from 450 to 900 nm among one,
# two, four or more equal bands. Unknown are the covers of the species, the chlorophyll of the
# leaves, and the ground (not all of them in the small version). Priors are those of the field:
# covers seen by eye to a quarter.

# %%
plot = read_plot(PLOT).replace(size_m=(SIDE, SIDE), structure_m="even")
scene, table = build_plot(plot)
sensor = dataclasses.replace(load_sensor("mavic_3m"), bands=even_bands(max(BANDS), 450.0, 900.0))
free = [f"species.{taxon}.cover" for taxon in (SPECIES if FAST else plot.taxa)]
free += ["ground.litter_fraction", "ground.brightness"]
if not FAST:
    free += [f"species.{taxon}.leaf.chlorophyll" for taxon in SPECIES[:3]]
space = free_space(scene, table, free, plot.calibration.relative_sd)

# %% [markdown]
# ## The sweep
#
# What counts as data are statistics of the image: of each band the mean, the spread where there are
# four pixels or more, and tails from 25 on. An image can be made coarser and its bands wider
# afterwards, so a sensor is also given the statistics of every larger pixel and of fewer bands.
# Errors are the noise of a pixel (1 %), calibration (1 % of each statistic) and chance: where each
# plant stands nobody knows, so only slopes that other plantings of the same table share count as
# information, as far as chance does not explain them.

# %%
found = sweep_sensors(
    scene,
    table,
    space,
    sensor,
    gsd=GSD,
    bands=BANDS,
    noise=(0.01,),
    error=0.01,
    stand_realisations=7 if FAST else 31,
)
by = {(setting.gsd, setting.bands): information for setting, information in found}
worse = sum(
    np.any(fine.bound > coarse.bound * (1 + 1e-6))
    for (gsd, bands), fine in by.items()
    for (larger, fewer), coarse in by.items()
    if larger >= gsd and bands % fewer == 0
)
print(f"{len(found)} sensors, {len(space.names)} parameters")
print(f"Pairs of which the finer pixels or the more bands know less: {worse}")

# %% [markdown]
# ## Bounds against pixel size
#
# The bound is that of the image alone, with the other parameters known as well as the field knows
# them. Above the grey line a species may as well be absent.

# %%
value = dict(zip(space.names, np.asarray(space.prior)))
shown = [taxon for taxon in SPECIES if f"species.{taxon}.cover" in value]


def over_cover(gsd, bands):
    """Bound on each cover, over that cover."""
    information = by[gsd, bands]
    place = [information.names.index(f"species.{taxon}.cover") for taxon in shown]
    cover = np.array([value[f"species.{taxon}.cover"] for taxon in shown])
    return information.bound[place] / cover


CEILING = 100.0  # bounds beyond, infinite ones too, are drawn there
most = max(BANDS)
curves = np.array([np.minimum(over_cover(gsd, most), CEILING) for gsd in GSD])
kept = sum(curves.min(axis=0) < 1)
fig, ax = plt.subplots(figsize=(8, 4.4), layout="constrained")
for k, taxon in enumerate(shown):
    percent = 100 * value[f"species.{taxon}.cover"]
    ax.plot(GSD, curves[:, k] * 1.04 ** (k - 2), "o-", label=f"{taxon}, {percent:g} %")
ax.axhspan(1, 1.5 * CEILING, color="0.92", lw=0, zorder=0, label="bound larger than the cover")
ax.set(
    xscale="log",
    yscale="log",
    xlabel="size of a pixel on the ground [m]",
    ylabel=f"bound on the cover / cover ({CEILING:g} or more at the top)",
    ylim=(None, 1.5 * CEILING),
    title=f"{most} bands: {kept} of {len(shown)} species can be distinguished at some size",
)
ax.set_xticks(GSD, [f"{gsd:g}" for gsd in GSD])
ax.minorticks_off()
ax.legend(frameon=False, loc="center left", bbox_to_anchor=(1, 0.5))
plt.show()

# %% [markdown]
# ## Pixel size and number of bands together
#
# For each species and number of bands, the bound over the cover; the numbers in the fields. Dark
# blue is known, white is the limit, red is lost.

# %%
columns = 3
fig, axes = plt.subplots(2, columns, figsize=(10, 5.2), layout="constrained")
for ax, k in zip(axes.flat, range(len(shown))):
    ratio = np.array([[over_cover(gsd, bands)[k] for gsd in GSD] for bands in BANDS])
    drawn = ax.imshow(
        np.clip(ratio, 1 / CEILING, CEILING),
        norm=LogNorm(1 / 30, 30),
        cmap="RdBu_r",
        aspect="auto",
        origin="lower",
    )
    for (row, column), number in np.ndenumerate(ratio):
        text = "-" if number >= CEILING else f"{number:.2g}"
        strong = not 1 / 8 < number < 8
        ax.text(
            column, row, text, ha="center", va="center", color="white" if strong else "k", size=8
        )
    ax.set_xticks(range(len(GSD)), [f"{gsd:g}" for gsd in GSD])
    ax.set_yticks(range(len(BANDS)), [str(bands) for bands in BANDS])
    percent = 100 * value[f"species.{shown[k]}.cover"]
    ax.set_title(f"{shown[k]}, {percent:g} %", fontsize=9.5)
for ax in axes[-1]:
    ax.set(xlabel="pixel [m]")
for ax in axes[:, 0]:
    ax.set(ylabel="bands")
fig.colorbar(drawn, ax=axes, label="bound / cover (-: 100 or more)")
plt.show()

# %%
print(f"{'':<26}" + "".join(f"{bands:>9} band{'s' * (bands > 1):<1}" for bands in BANDS))
for k, taxon in enumerate(shown):
    limits = []
    for bands in BANDS:
        lost = [gsd for gsd in GSD if over_cover(gsd, bands)[k] > 1]
        limits.append(
            "at every one" if len(lost) == len(GSD) else f"{lost[0]:g} m" if lost else "at none"
        )
    print(f"{taxon:<26}" + "".join(f"{limit:>14}" for limit in limits))
print("Pixel from which on the bound on a species' cover exceeds the cover.")

# %% [markdown]
# ## What stays in the dark
#
# The bound of one parameter is one side of it. The information has directions: some combinations of
# parameters are seen well, others not at all, and no processing of the same data brings them back.

# %%
fine, coarse = by[GSD[0], most], by[GSD[-1], most]
fig, ax = plt.subplots(figsize=(7, 3.8), layout="constrained")
floor = 1e-4
for information, gsd, marker in ((fine, GSD[0], "o-"), (coarse, GSD[-1], "s-")):
    rank = np.arange(1, len(information.information) + 1)
    ax.plot(rank, np.maximum(information.information, floor), marker, label=f"{gsd:g} m a pixel")
ax.axhline(1, color="0.5", lw=0.8, ls=":")
ax.set(
    yscale="log",
    xlabel="direction, best seen first",
    ylabel=f"information, in units\nof the prior's (floor {floor:g})",
    title=(
        f"Directions that the image knows better than the field: "
        f"{sum(fine.information > 1)} and {sum(coarse.information > 1)} of {len(space.names)}"
    ),
)
ax.xaxis.get_major_locator().set_params(integer=True)
ax.legend(frameon=False)
plt.show()


# %%
def sentence(direction):
    parts = sorted(direction.items(), key=lambda item: -abs(item[1]))[:3]
    return ", ".join(f"{n.removeprefix('species.')} {w:+.2f}" for n, w in parts)


print("best known: ", sentence(dict(zip(fine.names, fine.modes[0].tolist()))))
for direction in fine.weakly_constrained_directions()[:2]:
    print("not known: ", sentence(direction))

# %% [markdown]
# ## Two sensors, or a better look at the ground?
#
# Informations of independent data add up. So one can ask beforehand what a second source is worth,
# without simulating it: a crew that measures litter with points to 5 % of the ground, say. That is
# one more observation, with a slope of one.

# %%
litter = space.names.index("ground.litter_fraction")
prior_sd = np.asarray(fine.prior_sd)
root = np.linalg.cholesky(fine.fisher + 1e-9 * np.diag(1 / prior_sd**2)).T
points = np.eye(len(space.names))[litter] / 0.05
both = fisher_information(space.names, np.vstack([root, points]), np.ones(len(root) + 1), prior_sd)
gain = 1 - both.bayesian / fine.bayesian
order = np.argsort(-gain)[:4]
print("Errors that shrink most when litter is measured on the ground:")
for i in order:
    print(f"   {space.names[i].removeprefix('species.'):<34}{100 * gain[i]:5.1f} % smaller")

# %% [markdown]
# A bound is a limit, not a promise: it holds for this plot, these errors, the statistics that were
# chosen, and a model that is right. What it calls lost is lost for data of this kind; what it calls
# known still needs a method that reaches it. And it is measured on a few plantings: smaller pixels
# and more bands never look worse by chance, since they contain what the others tell, but each
# number is uncertain. With only covers and ground free, bounds from 32 plantings of this plot were
# 0.7 to 1.5 times those of 1350, in 80 of 100 cases. More `stand_realisations` make them surer.
#
# **For your own data**: your `plot.toml`, pixels and bands of the cameras you can choose from,
# their noise. `sun_zenith=(20, 40, 60)` asks when to fly. `fynjax information plot.toml` does the
# sweep from the command line.

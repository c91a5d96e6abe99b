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
# # One plot, three sensors: who notices what, and from which pixel on it is lost
#
# A drone's camera, an imaging spectrometer and a LiDAR pass over the same plants. Which of them
# would notice that leaves dried, that plants were lower, that a species lost half of its ground?
# And up to which pixel does an image know that a species is there at all?
#
# - **You learn** to put one question to several sensors, and to weigh an answer against chance.
# - **You need** what notebook [05](05_plot_in_3d.ipynb) shows: a scene and an image of it.
# - **It takes** one to two minutes, half of them compilation.
#
# ![Error of a cover by size of pixel](../docs/images/information.png)

# %%
import fynjax as fx  # before jax, so that kept programs are read without a word

PLOT = None  # your "plot.toml" or species table "species.csv"; None is the plot burnt in 2006

# %%
import os

import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np

SMALL = os.environ.get("FYNJAX_FAST") == "1"  # a smaller plot, fewer bands and plantings
SIDE, STEP, PLANTINGS, STRUCTURE = (1.0, 800, 3, "even") if SMALL else (3.0, 100, 9, None)
PIXELS = (0.25, 1.0) if SMALL else (0.1, 0.2, 0.5, 1.0, 3.0)  # m

# %% [markdown]
# ## What each of them measures
#
# The camera has pixels of 5 cm in four bands; the spectrometer one pixel for the whole plot, at
# every wavelength (some of them here); the LiDAR the heights below which shares of its first
# returns lie. `fx.observe` takes them all, and may stand inside `jax.jit`.

# %%
scene = fx.read_scene(PLOT, size=SIDE, structure=STRUCTURE)
imager, lidar, levels = fx.sensor("aviris_ng"), fx.sensor("flash_lidar_paper"), (5, 25, 50, 75, 95)
wanted = sorted({*range(450, 2450, STEP), 860, 1650, 2200})  # nm
imager = imager.select([int(np.abs(np.array(imager.bands.centre) - w).argmin()) for w in wanted])


@jax.jit
def look(scene):
    image, cloud = fx.observe(scene, "mavic_3m", pixel=0.05), fx.observe(scene, lidar)
    spectrum = fx.observe(scene, imager, pixel=SIDE).reflectance[:, 0, 0]
    heights = [cloud.metric(f"height_p{level}") for level in levels]
    near, wet, dry = (spectrum[wanted.index(w)] for w in (860, 1650, 2200))
    camera = image.index("NDVI").mean(), image["red_edge"].mean()
    numbers = [*camera, wet / near, dry, heights[-1], cloud.metric("gap_fraction")]
    return image, spectrum, heights, jnp.stack(numbers)


# %%
image, spectrum, heights, first = look(scene)
fig, axes = plt.subplots(1, 3, figsize=(15, 4.6), layout="constrained")
axes[0].imshow(fx.photo(image), origin="lower", extent=(0, SIDE, 0, SIDE))
axes[0].set(title="Camera, nearly true colours", xlabel="east [m]", ylabel="north [m]")
axes[1].plot(wanted, spectrum, ".-")
axes[1].set(title="Spectrometer", xlabel="wavelength [nm]", ylabel="reflectance", ylim=(0, None))
axes[2].plot(levels, heights, ".-", color="tab:green")
axes[2].set(title="LiDAR", xlabel="first returns below [%]", ylabel="height [m]", xlim=(0, 100))
plt.show()

# %% [markdown]
# ## From which pixel on a species is lost
#
# No unbiased estimate from an image's means, spreads and quantiles can know a cover better than
# the Cramér-Rao bound, which their slopes give together with their errors: noise of 1 %, gains of
# the camera and what the model is off by, and that nobody knows where each plant stands. Where the
# bound is larger than the
# cover, the species may as well be absent. An image can be made coarser afterwards, so a finer
# pixel never knows less. The legend says up to which of these pixels a cover is larger than its
# bound.

# %%
free = fx.free(scene, "species.*.cover", prior={"*": 0.25})
bounds = fx.information(scene, free, "mavic_3m", gsd=PIXELS, plantings=PLANTINGS)
last = [f"up to {p:g} m" if p else "lost" for p in (bounds < 1).mul([*PIXELS]).max(axis=1)]
bounds.index = [f"{t}, {100 * c:g} %: {p}" for t, c, p in zip(scene.taxa, free.prior, last)]

# %%
fig, ax = plt.subplots(figsize=(11, 5), layout="constrained")
bounds.sort_values(PIXELS[0]).head(8).T.plot(ax=ax, logx=True, logy=True, marker="o")
ax.axhspan(1, max(ax.get_ylim()[1], 2), color="0.9", zorder=0, label="lost")
ax.legend(loc="center left", bbox_to_anchor=(1, 0.5))
ax.set(xlabel="pixel [m]", ylabel="bound / cover, the eight best known species")
ax.set_xticks(PIXELS, PIXELS), ax.set_xticks([], minor=True)
ax.yaxis.set(major_formatter="{x:g}", minor_formatter="{x:g}")
ax.set_title(f"{(bounds[PIXELS[0]] < 1).sum()} of {len(bounds)} are known from these statistics")
plt.show()

# %% [markdown]
# ## Who notices what
#
# Change one thing, measure again. What other plantings of the same table change is chance, so each
# change is given in standard deviations of that, and noticed beyond two.

# %%
names = ["camera:\nNDVI", "camera:\nred edge", "spectrometer:\n1650 / 860 nm"]
names += ["spectrometer:\n2200 nm", "LiDAR:\n95 % height", "LiDAR:\ngap"]
most = scene.taxa[int(np.argmax(scene.parameters.species.cover))]
changes = {
    "30 % less leaf water": {"species.*.leaf.water": 0.7},
    "30 % less chlorophyll": {"species.*.leaf.chlorophyll": 0.7},
    "plants 20 % lower": {"species.*.height": 0.8},
    "a third fewer leaves": {"species.*.leaf_area_index": 0.67},
    f"half of {most}": {f"species.{most}.cover": 0.5},
    "no litter": {"ground.litter_fraction": 0.0},
}
chance = np.std([look(scene.realisation(k))[3] for k in range(PLANTINGS + 1)], axis=0, ddof=1)
matrix = np.array([look(scene.scaled(by))[3] - first for by in changes.values()]) / chance

# %%
fig, ax = plt.subplots(figsize=(11, 5), layout="constrained")
shown = ax.imshow(matrix, cmap="PuOr", vmin=-6, vmax=6, aspect="auto")
for (row, column), value in np.ndenumerate(matrix):
    style = {"weight": "bold" if abs(value) > 2 else "normal", "c": "w" if abs(value) > 4 else "k"}
    ax.text(column, row, f"{value:+.1f}", ha="center", va="center", fontsize=12, **style)
ax.set_xticks(range(len(names)), names), ax.set_yticks(range(len(changes)), list(changes))
ax.set_title(
    f"{(np.abs(matrix) > 2).any(axis=1).sum()} of {len(changes)} changes are noticed (bold)"
)
fig.colorbar(shown, label="change, in standard deviations of chance")
plt.show()

# %% [markdown]
# Read the rows for who notices a change, and the columns for what one number cannot tell apart:
# that is why a calibration uses several numbers. A larger plot averages over more plants, so that
# chance shrinks and more is noticed; a bound is a limit, not a promise, and uncertain where few
# plantings were looked at.
#
# **For your own plot** set `PLOT`; `fynjax information plot.toml` sweeps sensors, `fynjax simulate`
# writes what each of them measures, as GeoTIFF, ENVI, NetCDF and LAZ.
#
# **Where to go next**: [02_calibrate_by_gradient](02_calibrate_by_gradient.ipynb) fits a plot to
# what was measured.

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
# # What can a sensor know of diversity, and from which pixel on is it lost?
#
# Many species make a varied image: that is the hope of those who map diversity from the air. Bare
# ground and shade make one too. Here communities are drawn whose diversity is known, each is seen
# by a camera and by an imaging spectrometer, and what their pixels say is held against what stands.
#
# - **You learn** how often pixels show their species, and which metrics follow which diversity.
# - **You need** what notebook [07](07_three_sensors.ipynb) shows; `pip install "fynjax[analysis]"`.
# - **It takes** three to five minutes.
#
# ![Figures of eight notebooks](../docs/images/notebooks.png)

# %%
import fynjax as fx  # before jax, so that kept programs are read without a word

PLOT = fx.io.plot.example_folder() / "plot.toml"  # or your own: its species are the pool

# %%
import os

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd

SMALL = os.environ.get("FYNJAX_FAST") == "1"  # fewer species, coarser voxels, for the check
SIDE, VOXEL = (1.0, 0.25) if SMALL else (4.0, 0.1)
PIXELS = (0.125, 0.25, 0.5) if SMALL else (0.1, 0.2, 0.5, 1, 2)
RANGES = {"richness": (1, 2) if SMALL else (2, 12), "cover": (0.3, 0.9)}

# %% [markdown]
# ## One stand: its species, and its spectral species
#
# `fx.pixel_truth` says of each pixel which plants its light comes from. Spectral species are groups
# of pixels that look alike (Féret and Asner 2014), found without knowing any plant. Colours mean
# nothing across the two maps, only whether their borders agree.

# %%
scene = fx.read_scene(PLOT, size=SIDE, voxel=VOXEL, structure="even")
image = fx.observe(scene, "mavic_3m", pixel=PIXELS[0])
species, share = fx.pixel_truth(scene, "mavic_3m", pixel=PIXELS[0]).leading()
parts = fx.diversity.windows(image.reflectance, len(share) // 2)  # four windows
found = fx.diversity.spectral_species(parts, clusters=6)
side = len(share) // 2
labels = found.label.reshape(2, 2, side, side).swapaxes(1, 2).reshape(2 * side, 2 * side)

# %%
fig, axes = plt.subplots(1, 3, figsize=(14, 4.6), layout="constrained")
titles = "nearly true colours", "leading species (blank: less than half)", "spectral species"
shown = fx.photo(image), np.where(share < 0.5, np.nan, species), labels
for ax, title, values in zip(axes, titles, shown):
    ax.imshow(values, origin="lower", extent=(0, SIDE, 0, SIDE), cmap="tab20")
    ax.set(title=title, xlabel="east [m]")
plt.show()

# %% [markdown]
# ## Many communities
#
# Each has some of the species, with covers more or less even, on more or less of the ground. It is
# planted, and seen in the finest pixels; coarser ones are means of these. `greenness` leaves out
# pixels that are mostly not green, so that bare ground does not pass for diversity. The same as
# a command: `fynjax diversity`, with a hundred communities of 10 m by default.

# %%
result = fx.studies.communities.diversity(
    "communities",
    fx.io.plot.as_plot(PLOT).replace(voxel_m=VOXEL, structure_m="even"),
    communities=10 if SMALL else 30,
    size=SIDE,
    gradients=fx.studies.communities.Gradients(**RANGES),
    sensors=("mavic_3m",) if SMALL else ("mavic_3m", "aviris_ng"),
    pixels=PIXELS,
    bands=10,
    greenness=None if SMALL else 0.4,
)
print(*result.headline, sep="\n")

# %% [markdown]
# Squared correlation of each metric with each diversity over the communities, against the pixel.
# Below the dashed line a diversity counts as lost. Of so few communities some metric goes with
# some diversity by accident: the table says how far that reaches.

# %%
fx.report.figures.agreement_plot(pd.read_csv("communities/agreement.csv"), 0.25)

# %%
best = pd.DataFrame(result.lost).query("metric == 'any'").set_index(["sensor", "diversity"])
best[["best_r2", "by_chance", "best_pixel_m", "lost_from_m"]].round(2)

# %% [markdown]
# ## Species, one pixel at a time
#
# A linear discriminant learns the spectra of species from half of the communities and names pixels
# of the others; dotted is chance. Leaves of one species are all alike here, so this is the most
# that can be hoped for.

# %%
fx.report.figures.recognition_plot(pd.read_csv("communities/recognition.csv"))

# %% [markdown]
# And whether two communities whose spectral species differ differ in their plants too: the
# correlation of the two dissimilarities over all pairs (Mantel), with its interval.

# %%
pd.DataFrame(result.composition).round(2)

# %% [markdown]
# Read the curves against the plants: where pixels outgrow them, each pixel is a mean of several
# species, and the curves fall. How far two communities differ is seen longer than how diverse one
# of them is. If `best_r2` is not above `by_chance`, nothing was shown, however high it is.
#
# **For your own plot** set `PLOT`; `fynjax diversity plot.toml --communities 100 --workers 4`
# makes the page with all tables. `fx.diversity` has every metric for images that were measured.
#
# **Where to go next**: `fynjax design` asks which bands a camera should have for a diversity.

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
# # From a species table to a plot in three dimensions, and what the drone sees of it
#
# In the field one writes down which plants stand on a plot: how much ground each species covers,
# how wide its crowns are, how tall it grows. Such a table becomes plants with leaves and stems, and
# these the picture that a drone's camera takes of them.
#
# - **You learn** how a table becomes a scene and an image, and what an image is in Python.
# - **You need** nothing but this; a species table of your own if you like.
# - **It takes** about a minute.
#
# ![Plants in the colours of their species](../docs/images/plot_oblique.png)

# %%
import fynjax as fx  # before jax, so that kept programs are read without a word

TABLE = None  # your species table, such as "species.csv"; None is the plot burnt in 2006

# %%
import os

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd

SMALL = os.environ.get("FYNJAX_FAST") == "1"  # a smaller plot, and pictures of fewer points
SIDE, PIXEL, POINTS = (1.0, 0.05, 100_000) if SMALL else (4.0, 0.02, 3_000_000)

# %% [markdown]
# ## The table
#
# A CSV file with the columns taxon, growth_form, mean_diameter_cm, cover_percent and height_max_m,
# separated by commas or semicolons, with decimal points or commas. The growth form is the shape
# that a plant is given, from ericoid shrubs and tussocks to deadwood. What the table does not say
# (leaves, ground, sun) has defaults, which `scene.parameters` shows.

# %%
scene = fx.read_scene(TABLE, size=SIDE)
scene

# %% [markdown]
# ## How many plants are that?
#
# The cover asks for a number of crowns: here by equation (10) of the article whose plot this is,
# with half of each living crown lying over others (`packing_percent`, ours); of your own table as
# many as lie over that share of the ground. Chance rounds it, up or down. Where plants stand, how
# they are turned and which are larger is drawn from the seed: `fx.read_scene(TABLE, size=SIDE,
# seed=2)` is another planting of the same table.

# %%
species, parameters = scene.parameters.species, scene.parameters
plants = pd.DataFrame(
    {
        "cover [%]": 100 * np.asarray(species.cover),
        "crown [cm]": 100 * np.asarray(species.diameter),
        "asked for": np.asarray(scene.counts(parameters)),
        "stand": np.asarray(scene.whole_counts(parameters), int),
    },
    index=scene.taxa,
)
plants.astype(float).round(1)

# %%
gap = float(scene.gap_fraction(parameters))
print(f"{plants.stand.sum()} plants on {SIDE:g} m x {SIDE:g} m; covers sum to", end=" ")
print(f"{plants['cover [%]'].sum():.0f} %, but crowns overlap and have holes: from straight above")
print(f"{100 * gap:.0f} % of the ground is in view.")

# %% [markdown]
# ## What the camera measures
#
# Reflectance in five bands, from 50 m above the middle of the plot, in whatever pixels you ask for.
# A band is an array with row 0 in the south, an index too; `image.to_xarray()` and
# `image.to_dataframe()` have coordinates and units. The first call compiles for some seconds.

# %%
image = fx.observe(scene, "rededge_3", altitude=50.0, pixel=PIXEL)
pd.DataFrame(
    {band: [float(image[band].mean()), float(image[band].std())] for band in image.bands},
    index=["mean", "standard deviation"],
).round(3)

# %% [markdown]
# ## Three pictures of the same plants
#
# From the side as meshes of leaves and stems, lit by the sun and the sky of the scene; from above
# in the camera's red, green and blue; and its NDVI, which tells leaves from ground, shade and wood.

# %%
ndvi = image.index("NDVI")
fig, axes = plt.subplots(1, 3, figsize=(16, 5.6), layout="constrained", width_ratios=(1.1, 1, 1))
axes[0].imshow(fx.lit_view(scene, points=POINTS), origin="lower")
axes[0].set(title="From the south-south-west")
axes[0].axis("off")
extent = (0, SIDE, 0, SIDE)
axes[1].imshow(fx.photo(image), origin="lower", extent=extent)
axes[1].set(
    title=f"From above, pixels of {100 * PIXEL:g} cm", xlabel="east [m]", ylabel="north [m]"
)
shown = axes[2].imshow(ndvi, origin="lower", extent=extent, cmap="RdYlGn", vmin=0, vmax=1)
axes[2].set(title=f"NDVI, mean {ndvi.mean():.2f}", xlabel="east [m]")
fig.colorbar(shown, ax=axes[2], shrink=0.8, label="NDVI")
plt.show()

# %% [markdown]
# **For your own plot** set `TABLE`; `fynjax render plot.toml` makes the image as GeoTIFF, and
# `fynjax build plot.toml` the plants, with tables and meshes.
#
# **Where to go next**: [03_sensitivity](03_sensitivity.ipynb) asks which species moves this NDVI,
# [07_three_sensors](07_three_sensors.ipynb) looks at the plot with other sensors.

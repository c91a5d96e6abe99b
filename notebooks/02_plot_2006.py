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
# # From a species table to a drone image
#
# In the field one writes down which plants stand on a plot: how much ground each species covers,
# how wide its crowns are, how tall it grows. Here such a table, 13 taxa of a fynbos plot that burnt
# in 2006, becomes a three-dimensional scene and then the image a drone camera would take of it.
# Every step can be differentiated, so we can ask which species an index such as NDVI responds to.

# %%
# Your own table goes here: a CSV file with the columns taxon, growth_form, mean_diameter_cm,
# cover_percent and height_max_m, such as "species.csv". None takes that of the plot burnt in 2006.
TABLE = None

# %%
import os
from functools import partial

import equinox as eqx
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
import pandas as pd

from fynjax.canopy import FORMS, hard_count, instance_area, table1_2006, target_area
from fynjax.leaf import LeafParameters
from fynjax.radiation import Accuracy
from fynjax.scene import (
    GroundParameters,
    LightParameters,
    Placement,
    PlantingRules,
    PlotParameters,
    Species,
    SpeciesParameters,
    aim,
    build_scene,
)
from fynjax.sensors import shipped_sensor

FAST = os.environ.get("FYNJAX_FAST") == "1"  # a smaller plot, fewer pixels, coarser light
SIDE = 2.5 if FAST else 10.0  # m
PIXEL = 0.1 if FAST else 0.025  # m
LIGHT = Accuracy(sublayers=1, levels=2, azimuths=4, refine=False) if FAST else None

# %% [markdown]
# ## The table
#
# Cover, mean crown diameter and greatest height are the article's. The growth form (the
# shape a plant is given) is ours, from the botany of each taxon.

# %%
table = table1_2006() if TABLE is None else pd.read_csv(TABLE, comment="#")
table[["taxon", "cover_percent", "mean_diameter_cm", "height_max_m", "growth_form"]]

# %% [markdown]
# ## How many plants are that?
#
# A species that covers 12 % of 100 m² with crowns 15 cm wide needs many plants. Equation (10) of
# the article divides the area to be covered by the ground one plant counts for, and rounds up.
# Images show whole plants; a gradient is that of the mean over plantings, whose number of plants
# is the real one.

# %%
diameter = table.mean_diameter_cm.to_numpy() / 100
height = table.height_max_m.to_numpy()
cover = table.cover_percent.to_numpy() / 100
each = instance_area(diameter, height)
count = hard_count(target_area(SIDE**2, cover), each)
for taxon, number, ground in zip(table.taxon, count, each):
    print(f"{taxon:<28}{number:>6} plants of {ground:6.3f} m²")

# %% [markdown]
# ## The scene
#
# What the table does not say has to be assumed, and is stated: leaf and wood area of crowns, the
# dead tissue and the clumping of their shoots and leaf angles come from the growth form, one leaf
# chemistry serves all species, the ground is dry soil with 30 % litter, the sun stands 28° from
# the zenith in the north. Where plants may stand, how they are turned and which are larger is
# drawn once, from the seed.

# %%
taxa, forms = tuple(table.taxon), tuple(table.growth_form)
species = len(taxa)


def every(value):
    return jnp.full(species, value)


parameters = PlotParameters(
    species=SpeciesParameters(
        cover=jnp.asarray(cover),
        diameter=jnp.asarray(diameter),
        height=jnp.asarray(height),
        packing=every(0.0),
        fill=every(1.0),
        leaf_area_index=jnp.array([FORMS[form].leaf_area_index for form in forms]),
        wood_area_index=jnp.array([FORMS[form].wood_area_index for form in forms]),
        shoot_clumping=jnp.array([FORMS[form].shoot_clumping for form in forms]),
        dead_fraction=jnp.array([FORMS[form].dead_fraction for form in forms]),
    ),
    leaf=LeafParameters.many(
        chlorophyll=every(40.0),
        structure=1.8,
        carotenoids=9.0,
        water=0.015,
        dry_matter=0.018,
    ),
    ground=GroundParameters(
        brightness=jnp.asarray(1.0),
        moisture=jnp.asarray(0.4),
        litter_fraction=jnp.asarray(0.3),
        char_fraction=jnp.asarray(0.0),
        rock_fraction=jnp.asarray(0.0),
        wood_brightness=jnp.asarray(0.8),
    ),
    light=LightParameters(
        sun_zenith=jnp.asarray(28.0), sun_azimuth=jnp.asarray(0.0), aerosol=jnp.asarray(0.1)
    ),
)
species = [Species(taxon, form) for taxon, form in zip(taxa, forms)]
rules = PlantingRules(structure="even")  # leaves fill the voxels, which takes half the time
scene = build_scene(species, parameters, extent=(SIDE, SIDE), voxel=0.1, seed=0, rules=rules)
density = np.asarray(eqx.filter_jit(scene.area_density)(parameters))  # [class, z, y, x]
edge = scene.grid.horizontal_size
print(f"{density.shape[0]} optical classes on {density.shape[1:]} voxels (z, y, x) of {edge} m")
print(f"leaf area index of the plot: {density[:-2].sum() * edge**3 / SIDE**2:.2f} m²/m²")

# %% [markdown]
# From above we see plant area per ground area; from the side, how it is spread over height. A sum
# over voxels gives back what was planted: nothing is lost on the way to the grid.

# %%
plan = density.sum(axis=(0, 1)) * edge
profile = {
    "leaves": density[:-2].sum(0).mean(axis=(1, 2)),
    "wood": density[-2].mean(axis=(1, 2)),
}
fig, (left, right) = plt.subplots(
    1, 2, figsize=(9, 4.2), layout="constrained", width_ratios=(1.2, 1)
)
shown = left.imshow(plan, origin="lower", extent=(0, SIDE, 0, SIDE), cmap="YlGn")
fig.colorbar(shown, ax=left, label="plant area per ground area [m²/m²]")
left.set(xlabel="east [m]", ylabel="north [m]", title="Plan view")
middle = (np.arange(density.shape[1]) + 0.5) * scene.grid.vertical_size
for (name, values), colour in zip(profile.items(), ("tab:green", "tab:brown")):
    right.plot(values, middle, color=colour, label=name)
right.set(
    xlabel="area density [m²/m³]",
    ylabel="height [m]",
    title="Profile",
    ylim=(0, None),
    xlim=(0, None),
)
right.legend(frameon=False)
plt.show()

# %% [markdown]
# ## What the drone sees
#
# Green, red, red edge and near infrared from 50 m above the middle of the plot, as reflectance.
# One call gives the image, its mean NDVI, and, for later, the derivative of that mean with respect
# to every parameter. The first call takes a minute or so: JAX compiles the program.


# %%
over = Placement(altitude=50.0, pixel=PIXEL)
drone = aim(scene, parameters, shipped_sensor("mavic_3m"), over, accuracy=LIGHT)


@eqx.filter_jit
@partial(eqx.filter_value_and_grad, has_aux=True)
def mean_ndvi(parameters, drone, scene):
    image = drone.observe(scene, parameters).reflectance  # [band, y, x], y to the north
    _, red, _, nir = image
    return jnp.mean((nir - red) / (nir + red)), image


(value, image), slope = mean_ndvi(parameters, drone, scene)
image = np.asarray(image)
for name, band in zip(drone.sensor.bands.names, image):
    print(f"{name:<10} mean {band.mean():.3f}   standard deviation {band.std():.3f}")

green, red, red_edge, nir = image
fig, axes = plt.subplots(1, 2, figsize=(9, 4.2), layout="constrained")
false_colour = np.stack([nir / 0.5, red / 0.15, green / 0.15], axis=-1).clip(0, 1)
axes[0].imshow(false_colour, origin="lower", extent=(0, SIDE, 0, SIDE))
axes[0].set(title="Near infrared, red, green as R, G, B", xlabel="east [m]", ylabel="north [m]")
ndvi = (nir - red) / (nir + red)
shown = axes[1].imshow(
    ndvi, origin="lower", extent=(0, SIDE, 0, SIDE), cmap="RdYlGn", vmin=0, vmax=1
)
fig.colorbar(shown, ax=axes[1])
axes[1].set(title="NDVI", xlabel="east [m]")
plt.show()

# %% [markdown]
# ## Which species does NDVI respond to?
#
# One gradient answers for all species, ground and leaves together: how the plot's mean NDVI changes
# when one species covers 1 % more of the ground and all else stays. Where the next plants of a
# species find bare ground, or stand above their neighbours, they count for much; under others, or
# without leaves as deadwood, for little.

# %%
per_percent = 0.01 * np.asarray(slope.species.cover)
order = np.argsort(per_percent)
fig, ax = plt.subplots(figsize=(8, 4.2), layout="constrained")
ax.barh([taxa[i] for i in order], 1000 * per_percent[order], color="tab:green")
ax.axvline(0, color="0.5", lw=0.8)
ax.set(
    xlabel="change of mean NDVI for 1 % more ground covered [0.001]",
    title=f"Mean NDVI {float(value):.3f}",
)
plt.show()

# %% [markdown]
# The gradient is exact for this scene, but it is one scene: with other random places, or in a
# denser plot, the order of species with similar bars may change. Let us see how far a straight
# line carries: cover of all living species from half to all of what was recorded.

# %%
factors = np.array([0.5, 1.25] if FAST else [0.5, 0.75, 1.0, 1.25])
living = np.array([form != "deadwood" for form in forms])
values = []
for factor in factors:
    moved = eqx.tree_at(
        lambda p: p.species.cover, parameters, jnp.asarray(np.where(living, factor * cover, cover))
    )
    values.append(float(mean_ndvi(moved, drone, scene)[0][0]))
along = float(jnp.sum(slope.species.cover * jnp.where(living, jnp.asarray(cover), 0.0)))
fig, ax = plt.subplots(figsize=(6, 4), layout="constrained")
total = 100 * factors * cover[living].sum()
ax.plot(total, values, "o-", color="tab:green", label="rendered")
ax.plot(
    total, float(value) + along * (factors - 1), "--", color="0.4", label="gradient at the table"
)
ax.set(xlabel="cover of all living species, overlaps counted twice [%]", ylabel="mean NDVI")
ax.legend(frameon=False)
plt.show()

# %% [markdown]
# NDVI climbs fast at first and then flattens: the denser the plot, the less NDVI tells about cover.
# That is why `fynjax calibrate` reports beside every estimate how far the image constrained it.

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
# # The paper rebuilt
#
# "Construction and Validation of a High-Fidelity Virtual Scene for Low-Stature and
# High-Biodiversity Ecosystems" (Remote Sensing) planted a fynbos plot that burnt in 2006 from its
# species table, looked at it with a drone's camera, AVIRIS-NG and a LiDAR, all simulated by DIRSIG,
# and compared with the real ones. Here its equations and tables are done again, from the same table
# and without any fit, and two of its numbers are looked into that no plants explain.
#
# - **You learn** what a species table alone predicts, and how to ask whether a number can be true.
# - **You need** what notebook [05](05_plot_in_3d.ipynb) shows: a scene and an image of it.
# - **It takes** about two minutes.
#
# ![Figures of eight notebooks](../docs/images/notebooks.png)

# %%
import fynjax as fx  # before jax, so that kept programs are read without a word

PLOT = None  # your "plot.toml" of this plot, such as a calibrated one; None is the shipped one

# %%
import os

import jax
import matplotlib.pyplot as plt
import numpy as np
import pandas as pd

SMALL = os.environ.get("FYNJAX_FAST") == "1"  # a smaller plot, fewer pixels, channels and canopies
SIDE, PIXEL, STRUCTURE = (1.0, 0.1, "even") if SMALL else (5.0, 0.05, None)
CHANNELS, CANOPIES = (30, 100) if SMALL else (140, 1000)

# %% [markdown]
# ## The equations
#
# How many plants does a cover ask for? The ground to be covered, equation (1), over the ground that
# one plant counts for, equations (5) to (9), rounded up, equation (10). On the article's 100 m²,
# without the packing of half of each living crown that the scene below has besides, chosen in view
# of the real plot's 6 % of gaps (it doubles these numbers):

# %%
scene = fx.read_scene(PLOT, size=SIDE, structure=STRUCTURE)
species = scene.parameters.species
each = fx.canopy.instance_area(species.diameter, species.height)
target = fx.canopy.target_area(100.0, species.cover)
count = fx.canopy.rounded_count(fx.canopy.soft_count(target, each)).astype(int)
pd.DataFrame({"m² each": each, "m² to cover": target, "plants": count}, scene.taxa).round(3)

# %% [markdown]
# ## The tables
#
# Sensors of tables 2 and 3; the drone's bands and indices (figure 9, table 4); the spectrometer
# (table 5, a mean over pixels of 3 m, as table 2 prints them; by its optics they would be 1 m), of
# which the ranges of the real spectrum follow from RMSE and NRMSE; the LiDAR (section 4.4).
# `definition` says how each is defined, and which contradict the article's own formulas.
# `fynjax article` writes all of them with a page, before and after a calibration.

# %%
table = fx.studies.fynbos_2006.article_tables(scene, pixel=PIXEL, channels=CHANNELS)
table = table[table[["real", "uncalibrated"]].notna().all(axis=1) & (table.table != "table 1")]
table.drop(columns="dirsig_off_percent").round(3)

# %% [markdown]
# ## A red edge that the assumed leaves cannot give
#
# Take canopies of leaves of any chlorophyll, structure and dry matter, of any area and over any
# soil, and ask what share of the near infrared they reflect at 730 nm. The real drone image has the
# share that is drawn as a line; spectra of fynbos plots by AVIRIS-NG (BioSCape), averaged over
# this camera's bands, have 0.62 to 0.83. `fx.check_vegetation` holds all four bands against such
# spectra. Published errors of such cameras reach 28 % (Fawcett et al. 2020, Remote Sensing 12:514),
# so the calibration of this band is the likely cause.

# %%
weights = fx.sensor("mavic_3m").bands.weights(np.arange(400.0, 2501.0))
low, high, random = [10, 1.2, 0.004, 0.5, 0.05], [120, 3, 0.03, 6, 0.3], np.random.default_rng(0)
chlorophyll, structure, dry_matter, area, soil = random.uniform(low, high, (CANOPIES, 5)).T
leaves = fx.prospect(chlorophyll=chlorophyll, structure=structure, dry_matter=dry_matter)
r, t = (np.asarray(spectra) @ weights.T for spectra in leaves)
canopy = jax.vmap(lambda r, t, area, soil: fx.canopy_reflectance(r, t, area, soil=soil))
share = np.divide(*np.asarray(canopy(r, t, area, soil))[:, 2:].T)
bands = {name: band.real_mean for name, band in fx.compare.bands_2006().items()}
printed = bands["red_edge"] / bands["nir"]

# %%
fig, ax = plt.subplots(figsize=(10, 5), layout="constrained")
dots = ax.scatter(chlorophyll, share, c=area, s=14, cmap="YlGn", edgecolor="0.4", lw=0.3)
ax.axhspan(0.616, 0.830, color="tab:blue", alpha=0.15, label="95 fynbos plots, AVIRIS-NG")
ax.axhline(printed, c="k", lw=2, label=f"the real drone image: {printed:.2f}")
ax.axvline(scene.parameters.leaf.chlorophyll.max(), c="tab:red", ls="--", label="most assumed")
ax.set(xlabel="leaf chlorophyll [µg cm⁻²]", ylabel="red edge / near infrared")
ax.set_title(f"As low only from {np.min(chlorophyll[share < printed], initial=120):.0f} µg cm⁻² on")
ax.legend(), fig.colorbar(dots, label="leaf area index")
plt.show()
print(fx.check_vegetation(bands, "mavic_3m"))

# %% [markdown]
# ## A short-wave infrared below zero
#
# At 2100 to 2450 nm (SWIR2) the article's simulated spectrum has a mean of 0.008, the real one of
# 0.063; the angle between them is 48.3°. An angle does not see a common factor, so no dimming that
# is alike at all wavelengths makes one. (Water and litter change the shape too; of them only three
# leaf waters are tried here.) Let the simulated spectrum be *offset + gain x real*. The left panel
# shows which gain gives the printed angle, the right one the spectrum that follows:

# %%
gains = np.linspace(0, 3, 601)
fig, (left, right) = plt.subplots(1, 2, figsize=(13, 4.8), layout="constrained")
for water in (0.005, 0.015, 0.04):  # shapes that the real spectrum may have
    shape = np.asarray(fx.prospect(water=water).reflectance)[1700:2051]
    spectrum = 0.063 + (shape - shape.mean()) * 0.0548 / 1.6122 / np.ptp(shape)  # printed range
    made = 0.008 + gains[:, None] * (spectrum - 0.063)
    cosine = made @ spectrum / np.linalg.norm(made, axis=1) / np.linalg.norm(spectrum)
    best = np.argmin(np.abs(cosine - np.cos(np.deg2rad(48.31))))
    left.plot(gains, np.rad2deg(np.arccos(cosine)), lw=2, label=f"leaf water {water:g} cm")
    label = f"gain {gains[best]:.2f}, offset {0.008 - gains[best] * 0.063:+.3f}"
    right.plot(np.arange(2100, 2451), made[best], lw=2, label=label)
left.axhline(48.31, c="k", ls="--", label="printed")
left.plot(0.008 / 0.063, 0, "ko", label="dimming alone")
left.set(xlabel="gain", ylabel="spectral angle [°]", title="Dimming does not turn a spectrum")
right.axhspan(-0.04, 0, color="0.9", label="no surface reflects less than nothing")
right.set(xlabel="wavelength [nm]", ylabel="simulated reflectance that is implied")
left.legend(), right.legend()
plt.show()

# %% [markdown]
# If the printed numbers are right and the relation is linear, something was subtracted on the way
# from radiance to reflectance: a dark panel brighter than believed, or path radiance taken off
# twice. Which of them, four numbers cannot tell.
#
# ## Every number on one line

# %%
fig, ax = plt.subplots(figsize=(9, 8), layout="constrained")
ax.plot([1e-2, 3e3], [1e-2, 3e3], "k-", lw=1, label="as in reality, or as printed")
ax.loglog(table.real.abs(), table.dirsig.abs(), "o", mfc="none", c="0.5", label="DIRSIG")
for name, rows in table.groupby("table", sort=False):
    ax.plot(rows.real.abs(), rows.uncalibrated.abs(), "o", ms=8, alpha=0.8, label=f"fynjax, {name}")
for _, row in table[table.uncalibrated_off_percent.abs() > 200].iterrows():
    at = abs(row.real), abs(row.uncalibrated)
    ax.annotate(row.quantity, at, (8, -3), textcoords="offset points")
ax.set(xlabel="real or printed, without sign", ylabel="simulated, without sign")
judged = table[table.nearest != ""].filter(like="off_percent").abs()
ours, theirs = (judged < 25).sum()[["uncalibrated_off_percent", "dirsig_off_percent"]]
ax.set_title(f"Within 25 %: fynjax {ours}, DIRSIG {theirs} of {len(judged)}")
ax.legend()
plt.show()

# %% [markdown]
# None of this was fitted: leaves, leaf area and dead tissue are those of other fynbos plots. The
# real plot is greener. What a fit to the drone's image changes stands in the documentation under
# "How well it agrees"; `fynjax demo` does it.
#
# **For your own data** set `PLOT`, to a calibrated one for instance; `fynjax validate` parts the
# misfit of spectra into gain, offset and shape.
#
# **Where to go next**: [02_calibrate_by_gradient](02_calibrate_by_gradient.ipynb) fits such a plot,
# [06_how_sure](06_how_sure.ipynb) says what is known then.

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
# # One plot, three sensors
#
# A drone camera, an imaging spectrometer in an aeroplane and a LiDAR pass over the same fynbos.
# Which of them would notice if the leaves dried, the plants were lower, or a species lost half of
# its ground? Here the plot that burnt in 2006 goes through all three; then it is changed, one thing
# at a time, and each sensor is asked what it noticed.

# %%
from fynjax.io.plot import example_folder

# Your own plot goes here, such as "my_plot/plot.toml"; `fynjax init my_plot` writes one.
PLOT = example_folder() / "plot.toml"
SPECIES = "Erica irregularis"  # of it half the cover will be taken

# %%
import dataclasses
import os

import equinox as eqx
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np

from fynjax.assembly import build_plot
from fynjax.inversion import COARSE, coarser
from fynjax.io.instruments import load_lidar, load_sensor
from fynjax.io.plot import read_plot
from fynjax.scene import Placement, PlotAir, aim, observe, stand_realisation

FAST = os.environ.get("FYNJAX_FAST") == "1"  # a smaller plot, fewer pixels and channels
SIDE = 2.0 if FAST else 6.0  # m
PIXEL = 0.1 if FAST else 0.05  # m, of the drone's image

# %% [markdown]
# ## The plot
#
# `fynjax init my_plot` writes such a plot file with its tables. The seed is in the file, so the
# same plants stand in the same places whichever sensor looks.

# %%
plot = read_plot(PLOT).replace(size_m=(SIDE, SIDE), structure_m="even")


scene, table = build_plot(plot)
# Thick layers and coarse light are good enough for a comparison.
quick = coarser(scene, table)
# %% [markdown]
# ## The drone camera
#
# Four bands from 50 m. At that height the air changes little; the image is calibrated with panels,
# so reflectance is what counts.

# %%
drone = load_sensor("mavic_3m")
drone_view = aim(quick, table, drone, Placement(pixel=PIXEL), accuracy=COARSE)
print(f"{len(drone.bands)} bands, {drone_view.shape[0]} x {drone_view.shape[1]} pixels")

# %% [markdown]
# ## The imaging spectrometer
#
# AVIRIS-NG from 1 km, 3 m a pixel, as the article has it. Here the air matters: it takes light on
# the way down and up and adds its own. The noise is that of the real instrument. Not every channel
# is simulated; `fynjax simulate plot.toml --sensor aviris_ng --pixel 3` takes all 425.

# %%
every = load_sensor("aviris_ng")
inside = [i for i, c in enumerate(every.bands.centre) if 415 < c < 2485]
imager = every.select(inside[:: 17 if FAST else 5])
air = PlotAir(water_vapour=1.5)
imager_view = aim(quick, table, imager, Placement(pixel=3.0), air=air, accuracy=COARSE)
# Sun and air stay as they are: their curves are computed once.
imager_view = dataclasses.replace(imager_view, air=imager_view.check(table))
print(f"{len(imager.bands)} channels, {imager_view.shape[0]} x {imager_view.shape[1]} pixels")

# %% [markdown]
# ## The LiDAR
#
# The article's flash LiDAR: pulses of 1064 nm, one for every 4 cm of ground, and what comes back is
# recorded in steps of 15 cm. A pulse meets whole leaves, not the mean of many: which it meets is
# drawn at random.

# %%
lidar = load_lidar("flash_lidar_paper")
flight = observe(scene, lidar, parameters=table, noise=True)
cloud = flight.returns
print(f"{len(flight.beams)} pulses, {len(cloud)} returns")

# %% [markdown]
# ## What each of them delivers

# %%
photo = eqx.filter_jit(lambda view, scene, table: view.observe(scene, table).reflectance)
scan = eqx.filter_jit(lambda view, scene, table: view.observe(scene, table, key=1))  # of the noise
image = np.asarray(photo(drone_view, quick, table))
spectra = scan(imager_view, quick, table)


def nearest(wavelength):
    return int(np.argmin(np.abs(np.asarray(imager.bands.centre) - wavelength)))


def false_colour(nir, red, green):
    return np.stack([nir / 0.4, red / 0.1, green / 0.1], axis=-1).clip(0, 1)


green, red, red_edge, nir = image
chosen = np.asarray(spectra.reflectance)[[nearest(w) for w in (860, 650, 560)]]
west, south = imager_view.origin
wide, high = (n * imager_view.pixel for n in imager_view.shape[::-1])

fig, axes = plt.subplots(1, 3, figsize=(11, 4.2), layout="constrained", width_ratios=(1, 1, 1.2))
axes[0].imshow(false_colour(nir, red, green), origin="lower", extent=(0, SIDE, 0, SIDE))
axes[0].set(title=f"Drone camera, {100 * PIXEL:.0f} cm", ylabel="north [m]")
axes[1].imshow(
    false_colour(*chosen), origin="lower", extent=(west, west + wide, south, south + high)
)
axes[1].set(title=f"Spectrometer, {imager_view.pixel:.0f} m")
x, y, z = cloud.position.T
dots = axes[2].scatter(x, y, c=z, s=80 / SIDE**2, cmap="viridis", lw=0)
fig.colorbar(dots, ax=axes[2], label="height of the return [m]")
axes[2].set(title="LiDAR, every return", aspect="equal", xlim=(0, SIDE), ylim=(0, SIDE))
for ax in axes:
    ax.set(xlabel="east [m]")
plt.show()

# %% [markdown]
# The camera has the shapes, the LiDAR the heights, and the spectrometer one number where the camera
# has thousands, but at every wavelength:

# %%
centre, width = np.asarray(imager.bands.centre), np.asarray(drone.bands.fwhm)
clear = np.asarray(spectra.transparent)
signal = np.asarray(spectra.radiance).mean(axis=(1, 2))
seen = np.where(clear, np.asarray(spectra.reflectance).mean(axis=(1, 2)), np.nan)

fig, (top, bottom) = plt.subplots(2, 1, figsize=(8, 5.5), layout="constrained", sharex=True)
top.plot(centre, signal, ".-", color="tab:orange")
top.set(
    ylabel="radiance [W m⁻² sr⁻¹ µm⁻¹]",
    title="What reaches the spectrometer: sunlight with the air's gaps in it",
)
bottom.plot(centre, seen, ".-", color="tab:blue", label="spectrometer, mean of its pixels")
bottom.errorbar(
    drone.bands.centre,
    image.mean(axis=(1, 2)),
    xerr=width / 2,
    fmt="ks",
    ms=4,
    label="drone camera, mean (bar: width of the band)",
)
bottom.set(
    xlabel="wavelength [nm]",
    ylabel="reflectance",
    ylim=(0, None),
    title="Calibrated: the camera's four bands end where leaf water begins to absorb",
)
bottom.legend(frameon=False, loc="upper right")
plt.show()

# %% [markdown]
# And the LiDAR has what neither of them has, the third dimension. (In a larger plot several frames
# of this flash LiDAR meet. Its beam is weak towards their corners, and there pulses may return
# nothing: white in the picture.) Pulses hit what stands highest, so the returns lie above the
# leaves and wood that were planted: the lower canopy is in the shade of the upper one for a laser,
# too.

# %%
density = np.asarray(flight.voxels.area_density)
planted = density.sum(axis=(0, 2, 3))
edges = np.arange(0, density.shape[1] + 1) * flight.voxels.vertical
vegetation = cloud.classification == 3  # of LAS 1.4: 2 is ground, 3 low vegetation
heights, _ = np.histogram(cloud.position[vegetation, 2], edges)
middle = 0.5 * (edges[1:] + edges[:-1])
mean_hit, mean_planted = cloud.position[vegetation, 2].mean(), (planted @ middle) / planted.sum()

fig, (left, right) = plt.subplots(
    1, 2, figsize=(10, 3.8), layout="constrained", width_ratios=(1.3, 1)
)
for kind, colour, name in ((vegetation, "tab:green", "vegetation"), (~vegetation, "0.5", "ground")):
    left.plot(x[kind], z[kind], ".", ms=1.5, color=colour, label=name)
left.set(xlabel="east [m]", ylabel="height [m]", title="The cloud from the side")
left.legend(markerscale=6, loc="upper left")
right.plot(100 * planted / planted.sum(), middle, color="tab:brown", label="plant area")
right.plot(100 * heights / heights.sum(), middle, color="tab:green", label="returns")
right.set(
    xlabel="share in each layer [%]",
    ylabel="height [m]",
    xlim=(0, None),
    title=f"Mean height: returns {mean_hit:.2f} m, area {mean_planted:.2f} m",
)
right.legend(frameon=False)
plt.show()

# %% [markdown]
# ## Who notices what?
#
# Change the plot, measure again. A change counts as noticed only when it is larger than what
# another planting of the very same table would do: nobody measured where each single plant stands.
# So the plot is also replanted a few times, and changes are given in standard deviations of that.


# %%
def figures(scene, parameters):
    """One or two numbers that each sensor is good for."""
    quick = coarser(scene, parameters)
    _, red, red_edge, nir = photo(drone_view, quick, parameters)
    spectrum = scan(imager_view, quick, parameters).reflectance.mean(axis=(1, 2))
    near, wet = spectrum[nearest(860)], spectrum[nearest(1650)]
    cloud = observe(scene, lidar, parameters=parameters, noise=True).returns
    hit = cloud.classification == 3
    return {
        "camera: NDVI": float(jnp.mean((nir - red) / (nir + red))),
        "camera: red edge": float(red_edge.mean()),
        "spectrometer: (R860 - R1650) / (R860 + R1650)": float((near - wet) / (near + wet)),
        "spectrometer: R2200": float(spectrum[nearest(2200)]),
        "LiDAR: 90 % height": float(np.quantile(cloud.position[hit, 2], 0.9)),
        "LiDAR: ground share": float(1 - hit.mean()),
    }


first = figures(scene, table)
others = []
for seed in range(1, 5):
    others.append(list(figures(stand_realisation(scene, seed), table).values()))
chance = np.std([list(first.values()), *others], axis=0, ddof=1)

species = plot.taxa.index(SPECIES)
changes = {
    "30 % less water in the leaves": (lambda p: p.leaf.water, 0.7 * table.leaf.water),
    "30 % less chlorophyll": (lambda p: p.leaf.chlorophyll, 0.7 * table.leaf.chlorophyll),
    "plants 20 % lower": (lambda p: p.species.height, 0.8 * table.species.height),
    "a third fewer leaves": (
        lambda p: p.species.leaf_area_index,
        0.67 * table.species.leaf_area_index,
    ),
    f"half the cover of {SPECIES.split()[0]}": (
        lambda p: p.species.cover,
        table.species.cover.at[species].multiply(0.5),
    ),
    "no litter": (lambda p: p.ground.litter_fraction, jnp.zeros_like(table.ground.litter_fraction)),
}
noticed = []
for where, value in changes.values():
    now = figures(scene, eqx.tree_at(where, table, value))
    noticed.append([now[name] - first[name] for name in first])
noticed = np.array(noticed) / chance

fig, ax = plt.subplots(figsize=(9, 4.6), layout="constrained")
shown = ax.imshow(noticed, cmap="PuOr", vmin=-6, vmax=6, aspect="auto")
for (row, column), value in np.ndenumerate(noticed):
    dark = abs(value) > 4
    ax.text(
        column,
        row,
        f"{value:+.1f}",
        ha="center",
        va="center",
        color="white" if dark else "black",
        weight="bold" if abs(value) > 2 else "normal",
    )
ax.set_yticks(range(len(changes)), list(changes))
ax.set_xticks(
    range(len(first)), [name.replace(": ", ":\n").replace(" / (", "\n/ (") for name in first]
)
ax.tick_params(length=0, labelsize=8.5)
fig.colorbar(shown, ax=ax, label="change, in standard deviations of replanting")
ax.set(title=f"A plot of {SIDE:g} m: what is noticed (bold) is more than chance would change")
plt.show()

# %%
for change, row in zip(changes, noticed):
    seen_by = [name for name, value in zip(first, row) if abs(value) > 2]
    print(f"{change}: {', '.join(seen_by) or 'nobody notices'}")

# %% [markdown]
# Read the rows: drier leaves need the short-wave infrared, less chlorophyll the camera's red edge,
# lower plants the laser, and a species that gives way moves numbers of several sensors, as fewer
# leaves do. Read the columns, too: one number that several changes move cannot say which of them
# happened. That is why calibration uses several numbers at once, and reports what they leave open
# (notebook 04).
#
# **For your own data**: name your `plot.toml` in the first cell, choose sensors by name
# (`fynjax.sensors.shipped_sensors()`) or from a file of yours, and put into `changes` what you want
# to detect. A larger plot (`size_m`) averages over more plants: chance shrinks, and more is
# noticed. `fynjax simulate` does the same from the command line and writes GeoTIFF, ENVI, NetCDF
# and LAZ.

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
# # A flight, not a picture: what frames from the side know
#
# A drone comes back with hundreds of frames of one plot, each from a place of its own. Looked at
# from the side shrubs hide the ground between them, and show lit or shaded leaves. What does that
# say of height, cover and leaf area that one picture from above cannot?
#
# - **You learn** to look from where a frame hung, what a mosaic of frames is, and what one and five
#   frames know.
# - **You need** what notebook [05](05_plot_in_3d.ipynb) shows: a scene and an image of it.
# - **It takes** about a minute, most of it compilation.
#
# ![What frames from the side know](../docs/images/flight.png)

# %%
import fynjax as fx  # before jax, so that kept programs are read without a word

PLOT = None  # your "plot.toml" or species table "species.csv"; None is the plot burnt in 2006

# %%
import os

import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np

SMALL = os.environ.get("FYNJAX_FAST") == "1"  # a smaller plot, voxels filled evenly
SIDE, STRUCTURE = (1.0, "even") if SMALL else (3.0, None)
HEIGHT, PIXEL = 30.0, 0.1  # m

# %% [markdown]
# ## Where the frames hung
#
# One straight above the middle, four from 30 degrees aside, all around. A `fx.Pose` counts metres
# from the plot's south-west corner and above its ground; with a pitch the camera looks ahead, to
# the upper edge of its picture, which points where `yaw` says. `fx.read_frames` reads poses of
# OpenDroneMap, Pix4D, Metashape, or of the pictures themselves.

# %%
scene = fx.read_scene(PLOT, size=SIDE, structure=STRUCTURE)
angles = [(0.0, 0.0), *((30.0, float(azimuth)) for azimuth in range(0, 360, 90))]


def from_side(zenith, azimuth):
    away, turn = HEIGHT * np.tan(np.radians(zenith)), np.radians(azimuth)
    place = [SIDE / 2 + away * np.sin(turn), SIDE / 2 + away * np.cos(turn), HEIGHT]
    return fx.Pose(place, (azimuth + 180.0) % 360.0, zenith)


poses = [from_side(*one) for one in angles]
images = [fx.observe(scene, "mavic_3m", pixel=PIXEL, pose=pose) for pose in poses]
light = scene.parameters.light
sun = float(light.sun_zenith), float(light.sun_azimuth)

# %%
fig = plt.figure(figsize=(14, 4.4), layout="constrained")
for k, (which, name) in enumerate([(0, "above"), (1, "the north"), (3, "the south")], 1):
    ax = fig.add_subplot(1, 4, k, title=f"From {name}")
    ax.imshow(fx.photo(images[which]), origin="lower", extent=(0, SIDE, 0, SIDE))
ax = fig.add_subplot(1, 4, 4, projection="polar", theta_direction=-1, theta_offset=np.pi / 2)
turn = np.radians([azimuth for _, azimuth in angles])
change = [100 * (float(image["red"].mean() / images[0]["red"].mean()) - 1) for image in images]
shown = ax.scatter(turn, [z for z, _ in angles], c=change, s=200, cmap="PuOr", vmin=-25, vmax=25)
ax.plot(np.radians(sun[1]), sun[0], "y*", ms=16, label="sun")
ax.set(title="Red by the camera's direction", rticks=[15, 30]), ax.legend(loc=(-0.25, -0.12))
fig.colorbar(shown, label="change from above [%]", shrink=0.8)
plt.show()

# %% [markdown]
# ## A mosaic is no picture
#
# An orthomosaic has each pixel from the camera that was nearest, or mixes all of them. Of `frames`
# that are its parts, `fx.Frame(..., mosaic=frames)` is what the nearest cameras saw. Taken for one
# picture from above it is off: by little in its means, by more in how its pixels differ.

# %%
lens = fx.Lens((2592, 1944), (2170.0, 2170.0), (1295.5, 971.5))
grid = [(e, n) for e in (-6.0, 3.0, 12.0) for n in (-4.0, 1.4, 7.0)]
parts = tuple(fx.Frame(fx.Pose([e, n, HEIGHT]), lens) for e, n in grid)
mosaic = fx.Frame(fx.Pose([SIDE / 2, SIDE / 2, HEIGHT]), lens, "mosaic", parts)
blended = fx.observe(scene, "mavic_3m", pixel=PIXEL, pose=mosaic)
off = {
    band: [100 * float(f(blended[band]) / f(images[0][band]) - 1) for f in (jnp.mean, jnp.std)]
    for band in blended.bands
}
print("\n".join(f"{b:9} mean {m:+.2f} %, spread {s:+.1f} %" for b, (m, s) in off.items()))

# %% [markdown]
# ## What one and five frames know
#
# Slopes of the means of all bands by height, leaf area and cover of all plants and by the ground's
# brightness; against errors: 5 % of each band that all frames share, as gains of one camera; 2 % of
# each frame, as its light drifts; 1 % of what is left. Beforehand each is known to 30 %.

# %%
names = ["species.*.height", "species.*.leaf_area_index", "species.*.cover", "ground.brightness"]


@jax.jit
def means(logs):
    seen = scene.expected().scaled({name: jnp.exp(log) for name, log in zip(names, logs)})
    views = [fx.observe(seen, "mavic_3m", pixel=PIXEL, pose=p).reflectance for p in poses]
    return jnp.log(jnp.stack([view.mean(axis=(1, 2)) for view in views]))


slopes = np.asarray(jax.jacfwd(means)(jnp.zeros(len(names))))  # [frame, band, parameter]
known = {}
for count in (1, 3, 5):
    bands, rows = slopes.shape[1], slopes[:count].reshape(-1, len(names))
    of_bands, of_frames = np.tile(np.eye(bands), (count, 1)), np.kron(np.eye(count), np.ones(bands))
    error = 0.05**2 * of_bands @ of_bands.T + 0.02**2 * of_frames.T @ of_frames
    error += 0.01**2 * np.eye(count * bands)
    information = rows.T @ np.linalg.solve(error, rows) + np.eye(len(names)) / 0.3**2
    known[count] = 100 * np.sqrt(np.diagonal(np.linalg.inv(information)))

# %%
fig, ax = plt.subplots(figsize=(9, 4), layout="constrained")
for k, (count, values) in enumerate(known.items()):
    label = f"{count} frame{'s' if count > 1 else ''}"
    ax.bar(np.arange(len(names)) + 0.25 * (k - 1), values, 0.23, label=label)
ax.axhline(30, color="0.5", lw=1, ls="--"), ax.text(-0.45, 30.4, "known beforehand", color="0.4")
ax.set_xticks(range(len(names)), [name.split(".")[-1].replace("_", " ") for name in names])
ax.set(ylabel="standard deviation [%]", ylim=(0, 40)), ax.legend(ncols=3, loc="upper right")
plt.show()

# %% [markdown]
# What frames from the side add is how a band changes with the view, in which the camera's gains
# cancel. It is a bound of a linear model, of means alone, for all plants at once: spreads of the
# pixels say more, chance of where plants stand takes some of it away.
#
# **For your own flight** `fynjax frames poses --images FOLDER --plot plot.toml` lays its pictures
# on the plot, and `file = "results/frames.nc"` under `[[target]]` of the plot file makes each of
# them a view of `fynjax calibrate`; of an orthomosaic `cameras = "results/frames.csv"` says where
# its frames hung.
#
# **Where to go next**: [06_how_sure](06_how_sure.ipynb) asks how sure a fit is.

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
# # A leaf, and what light tells about it
#
# PROSPECT turns what a leaf is made of (pigments, water, dry matter, and how spongy it is inside)
# into how much light it reflects and lets through, for every wavelength from 400 to 2500 nm. In
# fynjax it is one function, and JAX can differentiate it: for every wavelength we learn how much
# the reflectance moves when, say, the water content does. That is what lets a spectrum be read
# backwards, and it shows beforehand what a sensor cannot see.

# %%
# Your own leaves go here: an ASD, CSV or text file, or a folder of them. None takes an example.
SPECTRUM = None

# %%
import dataclasses

import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np

from fynjax.leaf import LeafParameters, prospect
from fynjax.sensors import mavic_3m

# %% [markdown]
# ## Two leaves
#
# A soft green leaf and a tough one, as many fynbos shrubs have: twice the dry matter, less
# chlorophyll, more layers of air and cell wall. Units are PROSPECT's own: pigments in µg/cm², water
# in cm (1 cm of water is 1 g/cm²), dry matter in g/cm². The numbers are examples, not measurements.

# %%
wavelength = np.arange(400.0, 2501.0)
leaves = {
    "soft": LeafParameters(
        structure=1.5, chlorophyll=45, carotenoids=9, water=0.012, dry_matter=0.006
    ),
    "tough": LeafParameters(
        structure=2.2, chlorophyll=30, carotenoids=8, water=0.016, dry_matter=0.02
    ),
}

fig, ax = plt.subplots(figsize=(8, 4.2), layout="constrained")
for colour, (name, leaf) in zip(("tab:green", "tab:brown"), leaves.items()):
    optics = prospect(leaf, wavelength)
    ax.plot(wavelength, optics.reflectance, color=colour, label=f"{name} leaf")
    ax.plot(wavelength, 1 - optics.transmittance, color=colour, ls="--")
ax.set(
    xlabel="wavelength [nm]",
    ylabel="share of the light",
    ylim=(0, 1),
    title="Reflected (solid, from below), transmitted (dashed, from above), absorbed (between)",
)
ax.legend(frameon=False)
plt.show()

# %% [markdown]
# ## What each substance does, wavelength by wavelength
#
# `jax.jacfwd` gives the derivative of the whole spectrum with respect to every parameter at once.
# Times one tenth of the parameter, it reads: by how much does the reflectance change when there is
# 10 % more of it? Where a curve is flat at zero, that wavelength knows nothing of the substance.

# %%
shown = {
    "structure": "layers N",
    "chlorophyll": "chlorophyll",
    "carotenoids": "carotenoids",
    "water": "water",
    "dry_matter": "dry matter",
}
leaf = leaves["tough"]
jacobian = jax.jacfwd(lambda p: prospect(p, wavelength).reflectance)(leaf)

fig, ax = plt.subplots(figsize=(8, 4.2), layout="constrained")
for field, label in shown.items():
    ax.plot(wavelength, 0.1 * getattr(leaf, field) * getattr(jacobian, field), label=label)
ax.axhline(0, color="0.7", lw=0.8, zorder=0)
for centre, width in zip(mavic_3m().centre, mavic_3m().fwhm):
    ax.axvspan(centre - width / 2, centre + width / 2, color="0.85", zorder=0)
ax.set(
    xlabel="wavelength [nm]",
    ylabel="change of reflectance for 10 % more",
    title="The tough leaf; grey: the four bands of the drone camera",
)
ax.legend(frameon=False, ncol=2)
plt.show()

# %% [markdown]
# The drone's four bands (grey) see chlorophyll, structure and dry matter, and in the near infrared
# the last two pull against each other. Water shows beyond 900 nm, so this camera cannot tell a wet
# leaf from a dry one: whatever a calibration says about water, it repeats what it was told before.

# %% [markdown]
# ## The same in the four bands
#
# Band averages of the derivatives, as the change for 10 % more, in units of 0.001 of reflectance.

# %%
grid = np.arange(450.0, 1001.0)
weights = mavic_3m().weights(grid)


def bands(p):
    return weights @ prospect(p, grid).reflectance


slope = jax.jacfwd(bands)(leaf)
print(f"{'':<14}" + "".join(f"{name:>10}" for name in mavic_3m().names))
print(f"{'reflectance':<14}" + "".join(f"{value:>10.3f}" for value in bands(leaf)))
for field, label in shown.items():
    change = 1000 * 0.1 * getattr(leaf, field) * getattr(slope, field)
    print(f"{label:<14}" + "".join(f"{value:>+10.2f}" for value in change))

# %% [markdown]
# ## Can the derivatives be trusted?
#
# Move each parameter a little up and down, and compare: in 64 bits, since a difference of near
# numbers has few of their digits.

# %%
worst = 0.0
with jax.enable_x64(True):
    exact = jax.tree.map(lambda field: jnp.asarray(field, float), leaf)
    slope = jax.jacfwd(bands)(exact)
    for field in shown:
        value = float(getattr(exact, field))
        step = 1e-5 * value
        up, down = (dataclasses.replace(exact, **{field: value + s}) for s in (step, -step))
        difference = (bands(up) - bands(down)) / (2 * step)
        error = jnp.max(jnp.abs(difference - getattr(slope, field))) / jnp.max(jnp.abs(difference))
        worst = max(worst, float(error))
print(f"Largest relative disagreement with finite differences: {worst:.1e}")
assert worst < 1e-6

# %% [markdown]
# ## Backwards: from a spectrum to the leaf
#
# `fx.read_spectra` reads files and folders, `fx.fit_leaf` reads spectra backwards, and `fynjax
# fit-leaf leaves/` does both on the command line. Reflectance alone is what a field instrument
# gives; the transmittance is predicted. These are the spectra named in the first cell. Where none
# is named but the reference data lie beside the project (or `FYNJAX_SHARED_DATA` says where), it is
# a real leaf clip reading of a lime tree, *Tilia americana*; elsewhere the tough leaf from above.

# %%
import os
import warnings
from pathlib import Path

import pandas as pd

import fynjax as fx

# What the white panel of the lime leaf reflects is not in its file: 1 to 2 % that are left alone.
warnings.filterwarnings("ignore", "The reflectance of .* is relative to a white panel")

folder = Path(os.environ.get("FYNJAX_SHARED_DATA", "../../shared/data")) / "leaf" / "asd"
found = sorted(folder.glob("serbin*.asd")) if SPECTRUM is None else SPECTRUM
if found:
    spectra = fx.read_spectra(found)
else:
    reflectance = np.asarray(prospect(leaf, wavelength).reflectance)
    spectra = pd.DataFrame([reflectance], ["the tough leaf"], wavelength)
fit = fx.fit_leaf(spectra, measurement=fx.leaf.LeafClip())
print(fit)

# %% [markdown]
# A row a leaf, with the ends of the 90 % intervals (`fit.to_xarray()` has the spectra too):

# %%
fit.table().set_index("name").T

# %%
fit.plot(0)
plt.show()

# %% [markdown]
# The interval is honest about what reflectance alone cannot say: PROSPECT's own error hangs
# together along the wavelength, so a thousand bands are not a thousand independent witnesses. That
# error was learned from the collections ANGERS, LOPEX and NASA FFT. With what the first two taught
# alone, the 90 % interval of T held 89 % of the measured bands of the third, that of water 89 % and
# that of dry matter 94 % of its leaves.

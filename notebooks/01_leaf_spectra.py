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
# # Fit PROSPECT to a folder of ASD spectra
#
# A folder of leaf spectra becomes a table of pigments, water and dry matter with their intervals,
# and we see how far to trust them.
#
# - **You learn** to read a folder of spectra, to fit PROSPECT to all of them at once, to see what
#   the spectrum decided and what the prior did (what was known of leaves before any measurement),
#   and to hold the result against a laboratory.
# - **You need** fynjax alone, and for your own leaves their files.
# - **It takes** about a minute.
#
# ![A leaf spectrum and its fit](../docs/images/fit-leaf.png)

# %%
import fynjax as fx

FOLDER = fx.io.spectra.example_leaves() / "reflectance"  # your own: a folder, a file, or several
PANEL = FOLDER.parent / "panel.csv"  # what your white panel reflects; None if files have it
TRANSMITTANCE = FOLDER.parent / "transmittance.csv"  # of the same leaves; None if not measured
LABORATORY = FOLDER.parent / "laboratory.csv"  # a row for each leaf; None if there is none

# %%
import os

import jax
import matplotlib.pyplot as plt
import numpy as np
import pandas as pd

plt.rcParams["figure.constrained_layout.use"] = True
FAST = os.environ.get("FYNJAX_FAST") == "1"  # a shorter chain, for the check of the notebooks

# %% [markdown]
# ## Read
#
# The six example leaves are simulated, with an instrument's noise and with errors of the model as
# measured leaves have them; no measured collection was found whose licence
# lets it be shipped. `read_spectra`
# takes ASD, SVC, Spectral Evolution, ENVI libraries, CSV and text, and refuses with a reason what
# is no reflectance.

# %%
spectra = fx.read_spectra(FOLDER, panel=PANEL)
spectra["reflectance"].plot.line(x="wavelength", figsize=(8, 3.5))
plt.title(f"{spectra.sizes['spectrum']} leaves, {spectra.sizes['wavelength']} bands")
plt.show()

# %% [markdown]
# ## What each substance does to a spectrum
#
# The model can be differentiated. `jax.jacfwd` gives the slope of every band by every parameter at
# once; times a tenth of the parameter it is what 10 % more would change. Where a curve is at zero,
# that band says nothing of the substance.

# %%
wavelength = np.arange(400.0, 2501.0)
leaf = fx.LeafParameters(
    structure=1.6, chlorophyll=40, carotenoids=8, water=0.012, dry_matter=0.008
)
slope = jax.jacfwd(lambda leaf: fx.prospect(leaf, wavelength).reflectance)(leaf)
for name in ("structure", "chlorophyll", "carotenoids", "water", "dry_matter"):
    plt.plot(wavelength, 0.1 * getattr(leaf, name) * getattr(slope, name), label=name)
plt.gcf().set_size_inches(8, 3.5)
plt.xlabel("wavelength [nm]")
plt.ylabel("change of R for 10 % more")
plt.legend(frameon=False, ncols=2)
plt.show()

# %% [markdown]
# ## Fit
#
# All leaves at once. `measurement=fx.leaf.LeafClip()` is for a leaf clip or contact probe; the
# default is an integrating sphere. A leaf that no leaf looks like has a status that says so.

# %%
fit = fx.fit_leaf(spectra)
print(fit)

# %%
traits = ["chlorophyll", "carotenoids", "water", "dry_matter"]
fit.table().set_index("name")[[*traits, "rmse", "prior_decides", "status"]].round(4)

# %% [markdown]
# ## Reflectance alone, or transmittance too?
#
# From reflectance alone the number of layers and the absorbers can stand in for one another, so a
# prior has to help. `prior_share` is the variance that is left after the spectrum over that before:
# near 0 the spectrum decides, near 1 the prior.

# %%
both = fit
if TRANSMITTANCE is not None:
    through = fx.read_spectra(TRANSMITTANCE)[["transmittance"]]
    both = fx.fit_leaf(spectra.merge(through, join="outer"))
share = {"R alone": fit.prior_share, "R and T": both.prior_share}
share = pd.DataFrame({k: np.median(v, axis=0) for k, v in share.items()}, fit.names)
share.plot.barh(figsize=(8, 3), xlabel="prior variance left [-], median of the leaves")
plt.gca().invert_yaxis()
plt.show()
most = share["R alone"].idxmax()
print(f"Least decided by R alone: {most}; {share['R alone'][most]:.0%} of the prior is left.")

# %% [markdown]
# ## One leaf by emcee, beside Laplace
#
# The posterior is what measurement and prior together leave possible. `fit_leaf` takes it for a
# Gaussian, in coordinates in which nothing becomes negative (Laplace's approximation). emcee walks
# through the posterior itself, under the same error of the model and prior.

# %%
one = str(spectra["spectrum"].values[-1])
chain = {"draws": 400, "max_steps": 300} if FAST else {"draws": 2000, "max_steps": 4000}
draws = fx.leaf.sample_leaf_posterior(spectra.sel(spectrum=[one]), **chain)
fig, axes = plt.subplots(1, 4, figsize=(11, 3))
for ax, name in zip(axes, traits):
    ax.hist(draws.samples[0][:, draws.names.index(name)], 40, density=True, label="emcee")
    i, j = fit.labels.index(one), fit.names.index(name)
    ax.axvspan(fit.lower[i, j], fit.upper[i, j], alpha=0.2, label="Laplace, 90 %")
    ax.set(xlabel=f"{name} [{fit.table().attrs['units'][name]}]", yticks=[])
axes[0].legend(frameon=False, loc="upper right")
fig.suptitle(f"{one}: {draws.status[0]}, {draws.effective_size[0]:.0f} effective draws")
plt.show()

# %% [markdown]
# ## Against the measurement, and against the laboratory
#
# Above, what was measured and what the model makes of it; below, what it leaves. The model's error
# hangs together along the wavelength: two thousand bands are far fewer independent ones. Then each
# trait with its 90 % interval against the laboratory's value: of the leaves that ship simulated
# too, which tests the method, not PROSPECT.

# %%
fig, (top, low) = plt.subplots(2, 1, figsize=(8, 5), sharex=True)
for label, measured, fitted in zip(both.labels, both.measured[:, 0], both.fitted[:, 0]):
    (line,) = top.plot(both.wavelength, fitted, label=label)
    top.plot(both.wavelength, measured, ".", ms=2.5, color=line.get_color())
    low.plot(both.wavelength, measured - fitted, ".-", ms=2.5, lw=0.7)
top.set(ylabel="reflectance: dots measured", title=f"Median RMSE {np.nanmedian(both.rmse):.3f}")
top.legend(frameon=False, ncols=2)
low.axhline(0, color="0.6", lw=0.8)
low.set(ylabel="measured - fitted", xlabel="wavelength [nm]")
plt.show()

# %%
if LABORATORY is not None:
    known = pd.read_csv(LABORATORY, index_col="name")
    known = known.reindex(both.labels)
    both.plot_traits(known)
    plt.show()

# %% [markdown]
# **For your own leaves** set `FOLDER`. On the command line `fynjax fit-leaf leaves/` writes the
# same table and a page.
#
# **Where to go next**: [02_calibrate_by_gradient](02_calibrate_by_gradient.ipynb) fits a plot to an
# image; [06_how_sure](06_how_sure.ipynb) goes on with posteriors.

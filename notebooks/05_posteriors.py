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
# # What else could it have been?
#
# A fit gives the best leaf, or the best plot, and an error. The posterior gives all that could have
# been: every set of parameters, as often as data and prior allow it. Is the error of the fit
# enough, or does one need the whole posterior? First a leaf, seen by two instruments; then a plot,
# seen by a drone.

# %%
from fynjax.io.plot import example_folder

# Your own plot goes here, such as "my_plot/plot.toml"; `fynjax init my_plot` writes one.
PLOT = example_folder() / "plot.toml"

# %%
import os
from itertools import combinations_with_replacement

import equinox as eqx
import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.patches import Ellipse
from scipy.special import ndtri
from scipy.stats import qmc

from fynjax.assembly import build_plot, image_view
from fynjax.inversion import (
    LogPosterior,
    ParameterSpace,
    fit,
    sample_posterior,
    search_form,
    weigh_targets,
)
from fynjax.io.plot import read_plot
from fynjax.leaf import LeafParameters, fit_leaf, prospect, sample_leaf_posterior
from fynjax.scene import stand_realisation

FAST = os.environ.get("FYNJAX_FAST") == "1"  # shorter chains, a smaller plot

# %% [markdown]
# ## A leaf
#
# A tough leaf whose chemistry we know, measured in reflectance with a little noise: once from 400
# to 2500 nm, once by an instrument that ends at 1000 nm. Your own spectra come from
# `fx.read_spectra`; where an instrument has no data there is NaN.

# %%
leaf = LeafParameters(structure=2.2, chlorophyll=30, carotenoids=8, water=0.016, dry_matter=0.02)
wavelength = np.arange(400.0, 2501.0)
clean = np.asarray(prospect(leaf, wavelength).reflectance)
full = clean + np.random.default_rng(0).normal(0, 0.002, clean.size)
short = np.where(wavelength <= 1000, full, np.nan)
both = np.stack([full, short])
instruments = {"400-2500 nm": "tab:blue", "400-1000 nm": "tab:orange"}

best = fit_leaf(wavelength, both)
draws = sample_leaf_posterior(
    wavelength, both, draws=400 if FAST else 2000, max_steps=200 if FAST else 4000
)
for name, status, size in zip(instruments, draws.status, draws.effective_size):
    print(f"{name}: {status}; {size:.0f} effective draws")

# %% [markdown]
# `fit_leaf` is the Laplace approximation: a Gaussian about the best fit, in coordinates in which no
# parameter can become negative, so its intervals are lopsided where they should be. emcee walks
# through the posterior itself, with the same priors and the same error of the model.


# %%
def ellipse(mean, covariance, **style):
    """The ellipse that holds 68 % of a Gaussian of two parameters."""
    values, vectors = np.linalg.eigh(covariance)
    wide = 2 * np.sqrt(2.28 * np.maximum(values, 0))  # chi-square with two degrees of freedom
    angle = np.degrees(np.arctan2(vectors[1, 1], vectors[0, 1]))
    return Ellipse(mean, wide[1], wide[0], angle=angle, fill=False, **style)


def corner(samples, gaussians, labels, true, colours, title):
    """Every parameter against every other: draws as dots, the Gaussians as ellipses."""
    count = len(labels)
    fig, axes = plt.subplots(count, count, figsize=(9, 8.4), layout="constrained", sharex="col")
    pooled = np.concatenate(list(samples.values()))
    low, high = np.quantile(pooled, [0.003, 0.997], axis=0)
    low, high = np.minimum(low, true), np.maximum(high, true)
    edge = 0.05 * (high - low)
    for i, j in np.ndindex(count, count):
        ax = axes[i, j]
        if j > i:
            ax.axis("off")
            continue
        for name, values in samples.items():
            mean, covariance = gaussians[name]
            colour = colours[name]
            if i == j:
                bins = np.linspace(low[i] - edge[i], high[i] + edge[i], 30)
                ax.hist(values[:, i], bins, density=True, histtype="step", color=colour, label=name)
            else:
                ax.plot(values[:, j], values[:, i], ".", ms=1.2, color=colour, alpha=0.35)
                pair = np.ix_([j, i], [j, i])
                ax.add_patch(ellipse(mean[[j, i]], covariance[pair], ec=colour, lw=1.5))
        ax.axvline(true[j], color="k", lw=0.7, ls=":")
        ax.set_xlim(low[j] - edge[j], high[j] + edge[j])
        ax.tick_params(labelsize=7.5)
        if i == j:
            ax.set_yticks([])
        else:
            ax.axhline(true[i], color="k", lw=0.7, ls=":")
            ax.set_ylim(low[i] - edge[i], high[i] + edge[i])
            if j > 0:
                ax.set_yticklabels([])
            else:
                ax.set_ylabel(labels[i], fontsize=8.5)
        if i == count - 1:
            ax.set_xlabel(labels[j], fontsize=8.5)
    handles, names = axes[0, 0].get_legend_handles_labels()
    fig.legend(handles, names, loc="upper right", bbox_to_anchor=(0.97, 0.93), frameon=False)
    fig.suptitle(title, fontsize=11)


shown = {
    "structure": "layers N",
    "chlorophyll": "chlorophyll\n[µg cm⁻²]",
    "carotenoids": "carotenoids\n[µg cm⁻²]",
    "water": "water [cm]",
    "dry_matter": "dry matter\n[g cm⁻²]",
}
pick = [draws.names.index(name) for name in shown]
at = [best.names.index(name) for name in shown]
leaf_samples, leaf_gaussians = {}, {}
for k, name in enumerate(instruments):
    leaf_samples[name] = draws.samples[k][:, pick]
    middle = np.array([float(getattr(best.parameters, field)[k]) for field in shown])
    leaf_gaussians[name] = middle, best.covariance[k][np.ix_(at, at)]
true = np.array([float(getattr(leaf, field)) for field in shown])

corner(
    leaf_samples,
    leaf_gaussians,
    list(shown.values()),
    true,
    instruments,
    "The leaf (dotted: the truth): draws by emcee, ellipses by Laplace (68 %)",
)
plt.show()

# %%
water = list(shown).index("water")
print(f"{'':<14}{'90 % by Laplace':>26}{'90 % by emcee':>26}{'truth':>10}")
for k, name in enumerate(instruments):
    print(name)
    for i, field in enumerate(shown):
        one, other = best.lower[k, at[i]], best.upper[k, at[i]]
        low, high = np.quantile(leaf_samples[name][:, i], [0.05, 0.95])
        print(f"{field:<14}{one:>12.4g} to {other:>9.4g}", end=" ")
        print(f"{low:>13.4g} to {high:>9.4g}{true[i]:>10.4g}")
spread = {k: np.ptp(np.quantile(v[:, water], [0.05, 0.95])) for k, v in leaf_samples.items()}
ratio = spread["400-1000 nm"] / spread["400-2500 nm"]
print(f"Without the short-wave infrared the interval of water is {ratio:.1f} times as wide.")

# %% [markdown]
# With the whole spectrum draws and Gaussian agree: there the error of the fit is all one needs.
# Without the short-wave infrared, water and dry matter are known from the prior rather than from
# the spectrum. Their clouds lean against zero, and an ellipse in plain units reaches below it. The
# intervals of the fit are made in coordinates that cannot, and still agree with the draws.

# %% [markdown]
# ## A plot
#
# Now a whole plot, of which a drone gave five statistics. Three things are unknown, in all species
# alike: how much ground living plants cover and how much chlorophyll their leaves hold, both as a
# multiple of the table's, and litter. The truth is another planting with 15 % less cover and 25 %
# less chlorophyll.

# %%
SIDE = 2.0 if FAST else 3.0  # m
STRIDE = 2 if FAST else 3  # every so many pixels of 10 cm are rendered
plot = read_plot(PLOT).replace(size_m=(SIDE, SIDE), structure_m="even")
plot = plot.replace(sensor=plot.sensor.replace(pixel_m=0.1))
scene, table = build_plot(plot)
living = jnp.array([one.growth_form != "deadwood" for one in plot.species])
unknown = {  # lower and upper bound, prior: middle and standard deviation
    "living cover": (0.3, 2.0, 1.0, 0.25),
    "chlorophyll": (0.1, 2.5, 1.0, 0.4),
    "litter": (0.01, 0.99, 0.5, 0.25),
}
space = ParameterSpace(tuple(unknown), *(jnp.array(column) for column in zip(*unknown.values())))
statistics = ("green.mean", "red.mean", "red_edge.mean", "nir.mean", "NDVI.std")
view = image_view(plot, scene, table, statistics)
scene, (view,) = search_form(scene, table, [view], stride=STRIDE)  # coarse, as a search sees it


def render(values, scene):
    """Statistics of the drone's image."""
    cover, chlorophyll, litter = values
    changed = eqx.tree_at(
        lambda p: (p.species.cover, p.leaf.chlorophyll, p.ground.litter_fraction),
        table,
        (
            table.species.cover * jnp.where(living, cover, 1.0),
            table.leaf.chlorophyll * chlorophyll,
            litter,
        ),
    )
    return view.predict(scene, changed).astype(values.dtype)


measure = jax.jit(render)
truth = jnp.array([0.85, 0.75, 0.5])
middle = space.prior
measured = measure(truth, stand_realisation(scene, 99))

# %% [markdown]
# ## A stand-in for the renderer
#
# An ensemble of walkers asks for tens of thousands of images. Three unknowns need no renderer for
# that: a few dozen images, spread over the prior, fix a cubic polynomial for the logarithm of each
# statistic. Further images tell how wrong it is; that goes into the errors. So does what another
# planting changes, which moves all statistics together.

# %%
terms = [t for degree in range(4) for t in combinations_with_replacement(range(3), degree)]


def powers(u):
    return jnp.stack([jnp.prod(u[jnp.array(t, int)]) for t in terms])


count = 40 if FAST else 104
shares = qmc.Sobol(3, rng=0).random(count + 24)  # a power of two in all
design = jnp.asarray(ndtri(np.clip(shares, 0.01, 0.99)))  # in units of the prior
runs = np.log([measure(space.physical(u), scene) for u in design])
basis = np.asarray(jax.vmap(powers)(design))
coefficients = np.linalg.lstsq(basis[:count], runs[:count])[0]
wrong = (runs - basis @ coefficients)[count:].std(axis=0)
print("error of the stand-in:", ", ".join(f"{n} {w:.1%}" for n, w in zip(statistics, wrong)))


def predict(values):
    """Statistics of the drone's image, by the stand-in."""
    return jnp.exp(powers(space.whitened(values)) @ coefficients)


plantings = jnp.stack([measure(middle, stand_realisation(scene, seed)) for seed in range(1, 17)])
data = weigh_targets(
    statistics, np.asarray(measured), 0.02, sd=np.asarray(measured) * np.hypot(0.02, wrong)
)
data = data.with_scatter(plantings - plantings.mean(axis=0))

# %% [markdown]
# `fit` finds the best parameters and the Gaussian about them; `sample_posterior` walks on from
# there. `LogPosterior` is the density both rest on: a function that JAX can differentiate, for any
# other sampler of yours.

# %%
start = fit(predict, data, space)
print(start.status)
posterior = sample_posterior(predict, data, space, start=start, max_steps=800 if FAST else 4000)
print(f"emcee: {posterior.status}; {posterior.effective_size:.0f} effective draws")
density = LogPosterior(predict, space, data, jnp.zeros(len(statistics)))
slope = jax.jit(jax.grad(density))(start.whitened)
print(f"slope of the log posterior at the best fit: {jnp.linalg.norm(slope):.1e} (0 at the top)")

# %%
sampled = posterior.values.reshape(-1, len(unknown))
covariance = np.asarray(start.covariance)
gaussian_draws = np.random.default_rng(1).multivariate_normal(start.whitened, covariance, 2000)
to_values = jax.jit(jax.vmap(space.physical))
gaussian = np.asarray(to_values(jnp.asarray(gaussian_draws)))  # in the parameters' own units
corner(
    {"emcee": sampled},
    {"emcee": (gaussian.mean(axis=0), np.cov(gaussian.T))},
    ["living cover\n[x the table's]", "chlorophyll\n[x the table's]", "litter\n[of the ground]"],
    np.asarray(truth),
    {"emcee": "tab:green"},
    "The plot (dotted: the truth): draws by emcee, ellipses by Laplace (68 %)",
)
plt.show()

# %%
prior_draws = np.random.default_rng(2).normal(size=(4000, len(unknown)))
before = np.asarray(to_values(jnp.asarray(prior_draws)))
fig, axes = plt.subplots(1, 3, figsize=(10.5, 3.4), layout="constrained")
for i, (ax, name) in enumerate(zip(axes, unknown)):
    bins = np.linspace(*np.quantile(before[:, i], [0.005, 0.995]), 30)
    for values, label, colour in (
        (before, "before the flight (prior)", "0.6"),
        (gaussian, "Laplace", "tab:blue"),
        (sampled, "emcee", "tab:green"),
    ):
        ax.hist(values[:, i], bins, density=True, histtype="step", color=colour, label=label)
    ax.axvline(truth[i], color="k", lw=0.8, ls=":")
    removed = max(posterior.constrained[i], 0.0)
    ax.set(xlabel=name, yticks=[], title=f"variance removed: {removed:.0%}")
fig.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=3, frameon=False)
plt.show()

# %% [markdown]
# An interval should be read together with the corner: where a cloud is long and narrow the image
# knows a combination, such as more cover with less litter, better than either of the two. One more
# measurement that cuts across the cloud, in the field or by another sensor, is worth more than
# another flight.
#
# The status says whether a chain is long enough; a short one is good for a picture, not for a
# paper. With dozens of free parameters an ensemble no longer mixes and no polynomial stands in:
# give `sample_posterior` the renderer itself and `method="nuts"`, which uses its gradients, or stay
# with Laplace.
#
# **For your own data**: leaf spectra through `fx.read_spectra`, or `fynjax fit-leaf leaf.asd
# --posterior emcee`; a plot through `fynjax posterior plot.toml --target image.tif`, which goes on
# where it was interrupted and writes the draws as NetCDF for arviz.

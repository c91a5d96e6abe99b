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
# # Gradients you can trust
#
# A fit, a sensitivity and an information bound are as good as the slopes they are made of. Here
# every kind of slope that fynjax gives is held against a second way to it.
#
# - **You learn** what the slope of a number of plants is, and how exact the slopes of a leaf, of
#   light and of an image are.
# - **You need** to know what a derivative is.
# - **It takes** one to two minutes, most of them compilation.
#
# ![Slopes of numbers of plants](../docs/images/slopes.png)

# %%
import fynjax as fx  # before jax, so that kept programs are read without a word

TABLE = None  # your species table, such as "species.csv"; None is the plot burnt in 2006

# %%
import os

import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np

SMALL = os.environ.get("FYNJAX_FAST") == "1"  # a smaller plot and fewer plantings
SIDE, PLANTINGS, COVERS = (1.0, 4, 9) if SMALL else (3.0, 16, 25)

# %% [markdown]
# ## Plants are counted, stands are expected
#
# The number of plants that a cover asks for is a real number, but 3.4 plants cannot stand: it is
# rounded, up or down by chance. Along the cover that is a staircase, with a slope of zero nearly
# everywhere. Where plants stand is chance as well. So the share of ground between the plants of a
# planting (its gap) goes in steps too, too fine to be seen here; only the mean over many
# plantings is smooth. **Its** slope is what JAX gets: the value is that of the whole plants of
# one planting, the derivative that of the expected stand.

# %%
scene = fx.read_scene(TABLE, size=SIDE, structure="even")  # leaves fill their voxels: quick
rare = int(np.argmin(scene.counts(scene.parameters)))  # the species of the fewest plants


@jax.jit
def look(scene, factor):  # plants of the rare species, their real number, gap; and the slopes
    def numbers(factor):
        moved = scene.scaled({"species.*.cover": factor})
        whole, real = (f(moved.parameters)[rare] for f in (moved.whole_counts, moved.counts))
        return jnp.stack([whole, real, moved.gap_fraction(moved.parameters)])

    return jax.jvp(numbers, (factor,), (1.0,))


factors = np.linspace(0.5, 1.5, COVERS)
plantings = [scene.realisation(k) for k in range(PLANTINGS)]
seen = np.array([[look(planted, factor) for factor in factors] for planted in plantings])
values, slopes = np.moveaxis(seen, 2, 0)  # each [planting, factor, number]

# %%
gap = values[..., 2]
fig, (left, right) = plt.subplots(1, 2, figsize=(12, 4.5), layout="constrained")
left.plot(factors, values[:3, :, 0].T, drawstyle="steps-mid")
left.plot(factors, values[0, :, 1], "k--", lw=2, label="asked for (solid: three plantings)")
left.set_title(f"Plants of {scene.taxa[rare]} on {SIDE:g} m x {SIDE:g} m")
right.plot(factors, gap[:3].T)
right.plot(factors, gap.mean(axis=0), "ko", label=f"mean of {PLANTINGS} plantings")
middle = gap[:, COVERS // 2].mean(), slopes[:, COVERS // 2, 2].mean()  # gap and slope at 1
right.axline((1, middle[0]), slope=middle[1], c="k", ls="--", lw=2, label="mean of gradients at 1")
right.set_title("Gap: steps of a planting, slope of the mean")
fig.supxlabel("cover of all species / that of the table")
left.legend(), right.legend()
plt.show()
changes = gap[:, -1] - gap[:, 0], np.trapezoid(slopes[..., 2], factors, axis=1)
for way, found in zip(("plants that stand:", "sum of the gradients:"), changes):
    error = found.std(ddof=1) / PLANTINGS**0.5
    print(f"gap at 1.5 less that at 0.5, {way:<22}{found.mean():+.3f} ± {error:.3f}")

# %% [markdown]
# ## Where other gradients stand
#
# Renderers that follow light by chance through a volume can be differentiated too. Their derivative
# by density can be biased, and the developers of Mitsuba 3 say so of theirs (pull requests 678 and
# 1939 of its repository). Measured with Mitsuba 3.9.1 (`prbvolpath`) on a scene of shrubs: the
# derivative of the mean of an image by the logarithm of density, beside central differences of the
# same images, with standard errors of the last digit in brackets.
#
# | | derivative | central differences | off by |
# |---|---|---|---|
# | green | −0.01287 (2) | −0.01339 (5) | 4 % |
# | red | −0.02058 (3) | −0.02106 (3) | 2 % |
# | near infrared | +0.0009 (3) | −0.0059 (4) | wrong sign |

# %% [markdown]
# ## Three functions, two ways to a slope
#
# Each has more of the package below it: a leaf's reflectance by its chlorophyll, a uniform canopy's
# by its leaf area, and the mean of an image by the leaf area of all plants that stand. `jax.jvp`
# gives value and slope at once; central differences need values only. Both are done in single and
# in double precision.

# %%
stands, slopes, errors, red = {}, {}, {}, fx.sensor("mavic_3m").select([1])


def leaf(x):
    return fx.prospect(chlorophyll=40.0 * x).reflectance[270]  # at 670 nm


def light(x):
    return fx.canopy_reflectance(0.05, 0.02, leaf_area_index=3.0 * x, soil=0.15)[0]


def image(x):
    now = stands[x.dtype.name].scaled({"species.*.leaf_area_index": x})
    return fx.observe(now, red, pixel=0.2)["red"].mean()


for dtype, smallest in (("float64", -8.0), ("float32", -5.0)):
    with jax.enable_x64(dtype == "float64"):
        plants = fx.read_scene(TABLE, size=SIDE, structure="even", dtype=dtype)
        stands[dtype] = fx.scene.hard_scene(plants, plants.parameters)  # without spare plants
        steps = 10.0 ** np.arange(smallest, -0.9, 0.5)
        for f in (leaf, light, image):
            both = jax.jit(lambda x, f=f: jax.jvp(f, (x,), (jnp.ones_like(x),)))
            slopes[f.__name__, dtype] = float(both(jnp.asarray(1.0, dtype))[1])
            ends = [[both(jnp.asarray(1 + s * h, dtype))[0] for s in (-1, 1)] for h in steps]
            rise = np.diff(np.array(ends, float))[:, 0] / (2 * steps)
            errors[f.__name__, dtype] = steps, np.abs(rise / slopes[f.__name__, "float64"] - 1)

# %% [markdown]
# ## Error against step
#
# A difference with a large step misses the curvature, with a small one it drowns in rounding. A
# gradient has no step. Errors are those against the gradient in double precision. There the
# differences of the image level off where the iterations of its scattered light stop, at a
# tolerance of 1e-4; with 1e-10 they go on down as those of the others.

# %%
fig, ax = plt.subplots(figsize=(10, 6), layout="constrained")
for colour, name in zip(("tab:green", "tab:orange", "tab:blue"), ("leaf", "light", "image")):
    for dtype, line in (("float64", ":"), ("float32", "-")):
        steps, error = errors[name, dtype]
        label = f"{name}, differences, {dtype}: at best {error.min():.0e}"
        ax.loglog(steps, error, line, c=colour, lw=2.5, label=label)
    single = abs(slopes[name, "float32"] / slopes[name, "float64"] - 1)
    ax.axhline(single, c=colour, lw=5, alpha=0.3, label=f"{name}, gradient, float32: {single:.0e}")
ax.set(xlabel="step, relative", ylabel="relative error of the slope")
ax.legend(ncols=3, fontsize=8.5, loc="upper center", bbox_to_anchor=(0.5, -0.1))
plt.show()

# %% [markdown]
# **For your own plot** set `TABLE`.
#
# **Where to go next**: [02_calibrate_by_gradient](02_calibrate_by_gradient.ipynb) descends such
# gradients to a drone's image, [03_sensitivity](03_sensitivity.ipynb) ranks parameters by them. The
# documentation tells under "What is modelled" what the slope of a number of plants was weighed
# against.

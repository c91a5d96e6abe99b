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
# # Where did the short-wave infrared go?
#
# The article whose plot this is compared its simulated AVIRIS-NG spectrum with the real one.
# Between 2100 and 2450 nm (SWIR2) the two disagree badly: the simulated mean reflectance is 0.008,
# the real one 0.063, the spectral angle 48°. Yet they correlate with 0.98. Water vapour, too little
# litter or deadwood, leaves too wet, or a wrong empirical line: which of these suspects could have
# done it? Four printed numbers do not suffice to convict, but they rule out a lot.

# %%
import dataclasses
import os

import equinox as eqx
import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
from scipy.optimize import brentq

from fynjax.assembly import build_plot
from fynjax.compare import table5_2006
from fynjax.inversion import COARSE, coarser
from fynjax.io.instruments import load_sensor
from fynjax.io.plot import example_folder, read_plot
from fynjax.leaf import LeafParameters, prospect
from fynjax.metrics import misfit_decomposition, pearson_correlation, spectral_angle, spectral_mask
from fynjax.radiation import directional_reflectance, solve_light
from fynjax.scene import background_spectrum, fitted_accuracy
from fynjax.sensors import (
    ClearAir,
    at_sensor_radiance,
    band_atmosphere,
    empirical_line,
    surface_reflectance,
    tabulated_atmosphere,
)

FAST = os.environ.get("FYNJAX_FAST") == "1"  # a smaller plot, fewer channels

# %% [markdown]
# ## What the four numbers say by themselves
#
# The angle is blind to a common factor, the correlation to factor and offset. Together with the
# means they are not: if the simulated spectrum is *offset + gain x real* plus something
# uncorrelated, angle, correlation and means leave one unknown, the spread of the real spectrum over
# its channels. Its range follows from the printed RMSE and NRMSE, and a spectrum's standard
# deviation is at most half its range.

# %%
printed = table5_2006()["swir2"]
REAL, SIMULATED = 0.063, 0.008  # means, from the article's text
span = printed.rmse / printed.nrmse
print(f"angle {printed.spectral_angle:g}°, r {printed.correlation:g}, RMSE {printed.rmse:g}")
print(f"range of the real spectrum: {span:.3f}")


def line(spread):
    """Gain and offset that reproduce means, angle and r, for the real spectrum's spread."""

    def excess(own):
        both = REAL * SIMULATED + printed.correlation * spread * own
        lengths = np.hypot(REAL, spread) * np.hypot(SIMULATED, own)
        return both / lengths - np.cos(np.deg2rad(printed.spectral_angle))

    own = brentq(excess, 1e-6, 0.2)
    gain = printed.correlation * own / spread
    return gain, SIMULATED - gain * REAL


spreads = np.linspace(span / 6, span / 2, 40)
gains, offsets = np.array([line(s) for s in spreads]).T
print(f"gain {gains.min():.2f} to {gains.max():.2f}, offset {offsets.min():.3f} to ", end="")
print(f"{offsets.max():.3f}; a factor alone would have to be {SIMULATED / REAL:.2f}")

# %% [markdown]
# Whatever the real spectrum looked like, something was *subtracted* from the simulated one, about
# as much as the whole signal; it was not dimmed. To see what that means, take shapes that such a
# spectrum may have, of leaves, litter, bark and soil, and give them the real mean and range.

# %%
imager = load_sensor("aviris_ng")
channels = np.flatnonzero(spectral_mask(imager.bands.centre, "swir2"))[:: 5 if FAST else 2]
imager = imager.select(channels.tolist())
centre, grid = np.asarray(imager.bands.centre), np.arange(2000.0, 2501.0)
weights = imager.bands.weights(grid)


def as_real(spectrum):
    """A shape with the mean and the range of the real spectrum."""
    return REAL + (spectrum - spectrum.mean()) * span / np.ptp(spectrum)


leaf = LeafParameters(structure=1.8, chlorophyll=50, carotenoids=10, water=0.02, dry_matter=0.015)
shapes = {
    f"leaves, water {water:g} cm": prospect(
        dataclasses.replace(leaf, water=jnp.asarray(water)), grid
    ).reflectance
    for water in (0.01, 0.02, 0.04)
}
shapes |= {name.replace("_", " "): background_spectrum(name, grid) for name in ("litter", "bark")}
shapes["dry soil"] = background_spectrum("dry_soil", grid)
shapes = {name: as_real(np.asarray(weights @ np.asarray(s))) for name, s in shapes.items()}
implied = {}
for name, real in shapes.items():
    gain, offset = line(real.std())
    implied[name] = offset + gain * real

real = shapes["leaves, water 0.02 cm"]
gain, offset = line(real.std())
stories = {
    f"dimmed: {SIMULATED / REAL:.2f} x": SIMULATED / REAL * real,
    f"shifted: {SIMULATED - REAL:+.3f}": real + SIMULATED - REAL,
    f"both: {gain:.2f} x {offset:+.3f}": offset + gain * real,
}
fig, (left, right) = plt.subplots(1, 2, figsize=(11, 4.2), layout="constrained", sharey=True)
left.plot(centre, real, "k", label="real (a leaf's shape)")
for name, spectrum in stories.items():
    angle = float(spectral_angle(real, spectrum))
    left.plot(centre, spectrum, label=f"{name}: angle {angle:.0f}°")
left.set(
    xlabel="wavelength [nm]",
    ylabel="reflectance",
    ylim=(-0.05, 0.125),
    title=f"Same mean {SIMULATED:g}; the printed angle is {printed.spectral_angle:.0f}°",
)
for name, spectrum in implied.items():
    right.plot(centre, spectrum, label=name)
right.axhspan(-0.05, 0, color="0.92", lw=0, zorder=0)
right.text(centre[0], -0.047, "no surface reflects less than nothing", color="0.35", fontsize=9)
below = sum(spectrum.min() < 0 for spectrum in implied.values())
right.set(
    xlabel="wavelength [nm]",
    title=f"Implied simulated spectrum: below zero for {below} of {len(implied)} shapes",
)
for ax in (left, right):
    ax.legend(frameon=False, fontsize=8.5, ncol=1 if ax is left else 2, loc="upper right")
plt.show()

# %% [markdown]
# No leaves, litter or soil can reflect less than nothing, in whatever shares they are mixed. If the
# printed numbers are right, something after the scene, on the way from radiance to reflectance,
# subtracted too much. The misfit in parts, for the last story on the left:

# %%
parts = misfit_decomposition(real, stories[list(stories)[-1]])
print(f"gain {float(parts.gain):.2f}, offset {float(parts.offset):+.4f}")
print(f"difference of the means by the offset: {float(parts.mean_by_offset):+.4f}")
print(f"                      and by the gain: {float(parts.mean_by_gain):+.4f}")
print(f"RMSE {float(parts.mean_squared_error) ** 0.5:.4f} (printed {printed.rmse:g});", end=" ")
print(f"without the offset {float(parts.rmse_without_offset):.4f},", end=" ")
print(f"without a factor {float(parts.rmse_without_gain):.4f}")

# %% [markdown]
# ## The suspects
#
# To try them, take a simulated plot whose SWIR2 mean is the real one (wood and dead tissue as
# bright as that takes), and let one thing go wrong at a time. Four suspects are in the scene: water
# in the leaves, how much of the ground living plants cover,
# deadwood, litter on the ground, and how bright the soil is. Two are on the way to reflectance:
# water vapour, if the air held more than the correction assumed, and the empirical line, if its
# dark panel was brighter than believed. How far each may plausibly stray is our assumption; change
# it where you know better.

# %%
SIDE = 2.0 if FAST else 4.0
plot = read_plot(example_folder() / "plot.toml")
plot = plot.replace(size_m=(SIDE, SIDE), structure_m="even")
scene, table = build_plot(plot)
scene = coarser(scene, table)
accuracy = fitted_accuracy(COARSE, scene, table)
living = np.array([one.growth_form != "deadwood" for one in plot.species])
knobs = ("leaf water", "living cover", "deadwood", "litter", "soil brightness", "dead tissue")


def spectrum_of(values, scene):
    """Reflectance of the plot from straight above, per channel."""
    water, cover, dead, litter, soil, wood = values
    changed = eqx.tree_at(
        lambda p: (
            p.leaf.water,
            p.species.cover,
            p.ground.litter_fraction,
            p.ground.brightness,
            p.ground.wood_brightness,
        ),
        table,
        (
            water * table.leaf.water,
            table.species.cover * jnp.where(living, cover, dead),
            litter,
            soil,
            wood,
        ),
    )
    light = solve_light(scene.voxels(changed, imager.bands), accuracy)
    return directional_reflectance(light, jnp.zeros(1), jnp.zeros(1))[0]


@eqx.filter_jit
def look(values, direction, scene):
    """The spectrum at some setting of the knobs, and its slope in one direction."""
    return jax.jvp(lambda v: spectrum_of(v, scene), (values,), (direction,))


def along(knob):
    return jnp.eye(len(knobs))[knobs.index(knob)]


ground = table.ground
base = jnp.array([1.0, 1.0, 1.0, ground.litter_fraction, ground.brightness, ground.wood_brightness])
start, _ = look(base, along("dead tissue"), scene)
print(f"the table's plot: mean {start.mean():.4f}, range {jnp.ptp(start):.4f}")
for _ in range(4):  # Newton's method: wood and dead tissue darker until the mean is the real one
    start, slope = look(base, along("dead tissue"), scene)
    base = base + along("dead tissue") * (REAL - start.mean()) / slope.mean()
start, _ = look(base, along("dead tissue"), scene)
print(f"with wood and dead tissue {base[-1]:.2f} times as bright as the bark: ", end="")
print(f"mean {start.mean():.4f}, range {jnp.ptp(start):.4f} (real {span:.4f})")

# %% [markdown]
# Now each suspect as a function: how far it strays in, a spectrum out.

# %%
zenith = float(table.light.sun_zenith)
ASSUMED = 1.5  # g cm-2 of water vapour, in the correction


@jax.jit
def air_of_bands(water):
    return band_atmosphere(
        tabulated_atmosphere(ClearAir(zenith, water_vapour=water, sensor_height=1000.0)),
        imager.bands,
    )


assumed = air_of_bands(ASSUMED)


def through_air(water):
    """Radiance made under so much water vapour, corrected with the assumed amount."""
    return surface_reflectance(assumed, at_sensor_radiance(air_of_bands(water), start))


def by_panels(excess):
    """An empirical line through a white panel and a dark one that is brighter than believed."""
    believed = jnp.array([[0.03], [0.5]]) * jnp.ones(len(imager.bands))
    true = believed + jnp.array([[1.0], [0.0]]) * excess
    found = empirical_line(at_sensor_radiance(assumed, true), believed)
    return found.reflectance(at_sensor_radiance(assumed, start))


def in_scene(knob):
    """Spectrum and slope where one knob of the plot is turned."""

    def turned(value):
        k = knobs.index(knob)
        return look(base.at[k].set(value), along(knob), scene)

    return turned


def measured(function):
    """Spectrum and slope where the way to reflectance went wrong."""

    def strayed(value):
        return jax.jvp(function, (jnp.asarray(float(value)),), (jnp.ones(()),))

    return strayed


# Name: function, value where all is right, plausible end, far end, unit.
wet, cover, _, litter, soil, _ = (float(v) for v in base)
suspects = {
    "leaf water": (in_scene("leaf water"), wet, 2 * wet, 5 * wet, "x the table's"),
    "living cover": (in_scene("living cover"), cover, 1.5 * cover, 2.2, "x the table's"),
    "deadwood": (in_scene("deadwood"), 1.0, 0.0, 0.0, "x the table's"),
    "litter": (in_scene("litter"), litter, 0.0, 0.0, "of the ground"),
    "soil brightness": (in_scene("soil brightness"), soil, soil / 2, 0.1, "x the usual soil"),
    "water vapour": (measured(through_air), ASSUMED, 3.0, 4.4, "g cm⁻²"),
    "empirical line": (measured(by_panels), 0.0, 0.02, 0.07, "of the dark panel's reflectance"),
}


@jax.jit
def figures(spectrum):
    """Mean, angle and correlation with the spectrum before anything went wrong."""
    return jnp.stack(
        [
            jnp.mean(spectrum),
            spectral_angle(start, spectrum),
            pearson_correlation(start, spectrum),
        ]
    )


slopes_of_figures = jax.jit(jax.jacfwd(figures))

# %% [markdown]
# ## What the gradients say
#
# The slope of mean, angle and correlation by each suspect: the chain rule joins the slope of the
# spectrum to those of the three numbers. Where nothing is wrong yet the angle has a corner and the
# correlation is flat, so slopes are taken a tenth of the way to the plausible end, and given for
# the whole of that way. What the mean's slope says would be needed is its missing part over that.

# %%
needed = SIMULATED - float(start.mean())
print(f"needed: mean {needed:+.4f}, angle {printed.spectral_angle:.0f}°\n")
print(f"{'to the plausible end':<24}{'d mean':>9}{'d angle':>9}{'d r':>9}{'so needed':>12}")
by_slope = {}
for name, (function, right_value, plausible, _, _) in suspects.items():
    way = plausible - right_value
    spectrum, slope = function(right_value + 0.1 * way)
    change = np.asarray(slopes_of_figures(spectrum) @ slope) * way
    by_slope[name] = change[0]
    text = f"{needed / change[0]:8.1f} ways" if change[0] < 0 else "  wrong sign"
    print(f"{name:<24}{change[0]:>+9.4f}{change[1]:>+8.1f}°{change[2]:>+9.3f}{text:>12}")

# %% [markdown]
# ## What finite changes say
#
# Slopes are local, and the needed change is almost the whole signal. So go all the way. Solid
# lines: to the plausible end; dotted: beyond it, to where the model ends.

# %%
STEPS = 4 if FAST else 6
paths = {}
for name, (function, right_value, plausible, far, _) in suspects.items():
    solid = np.linspace(right_value, plausible, STEPS + 1)
    dotted = np.linspace(plausible, far, STEPS + 1)[1:] if far != plausible else []
    values = np.concatenate([solid, dotted])
    rows = [np.asarray(figures(function(v)[0])) for v in values]
    rows[0] = np.array([start.mean(), 0.0, 1.0])  # to rounding
    paths[name] = values, np.array(rows)

colours = dict(zip(suspects, plt.get_cmap("tab10").colors))
fig, axes = plt.subplots(1, 2, figsize=(10.5, 4.4), layout="constrained")
for ax, column, target in (
    (axes[0], 1, printed.spectral_angle),
    (axes[1], 2, printed.correlation),
):
    for name, (_, rows) in paths.items():
        solid, dotted = rows[: STEPS + 1], rows[STEPS:]
        ax.plot(solid[:, 0], solid[:, column], "-", lw=2, color=colours[name], label=name)
        ax.plot(dotted[:, 0], dotted[:, column], ":", lw=1.5, color=colours[name])
        ax.plot(*solid[-1, [0, column]], "o", color=colours[name], ms=5)
    ax.plot(SIMULATED, target, "*", color="k", ms=14, label="as printed")
    ax.plot(start.mean(), rows[0, column], "s", color="k", ms=6, label="nothing wrong")
    ax.set(xlabel="SWIR2 mean reflectance")
axes[0].set(ylabel="spectral angle [degrees]", title="Only one path leads to the star")
axes[1].set(ylabel="correlation r", title="Correlation: water vapour bends the shape")
axes[0].legend(frameon=False, fontsize=8.5)
plt.show()

# %%
fig, ax = plt.subplots(figsize=(8.5, 4), layout="constrained")
place = np.arange(len(suspects))
plausibly = [rows[STEPS, 0] - rows[0, 0] for _, rows in paths.values()]
at_most = [rows[-1, 0] - rows[0, 0] for _, rows in paths.values()]
ax.barh(place, at_most, color="0.87", height=0.75, label="to the far end of the model")
ax.barh(place, plausibly, color=list(colours.values()), height=0.45, label="to the plausible end")
ax.plot(list(by_slope.values()), place, "k|", ms=16, mew=2, label="the same by the slope")
ax.axvline(needed, color="k", ls="--", lw=1)
ax.text(needed, len(place) - 0.35, " needed", va="bottom")
ax.set_yticks(place, list(suspects))
ax.set_ylim(-0.6, len(place) + 0.1)
able = sum(value <= needed for value in plausibly)
ax.set(
    xlabel="change of the SWIR2 mean reflectance",
    title=f"{able} of {len(suspects)} suspects alone suffice within what is plausible",
)
ax.legend(frameon=False, loc="lower left", fontsize=8.5)
plt.show()

# %%
print(f"{'':<18}{'needed for the mean':<38}{'angle':>8}{'r':>8}")
for name, (*_, unit) in suspects.items():
    values, rows = paths[name]
    mean = rows[:, 0]
    if mean.min() <= SIMULATED:
        k = int(np.argmax(mean <= SIMULATED))
        share = (mean[k - 1] - SIMULATED) / (mean[k - 1] - mean[k])
        at = values[k - 1] + share * (values[k] - values[k - 1])
        angle, r = rows[k - 1, 1:] + share * (rows[k, 1:] - rows[k - 1, 1:])
        text = f"{at:.3g} {unit}"
    else:
        k = int(np.argmin(mean))
        angle, r = rows[k, 1:]
        text = f"not reached: {mean[k]:.3f} at {values[k]:.3g}"
    print(f"{name:<18}{text:<38}{angle:>7.0f}°{r:>8.3f}")
print(f"{'as printed':<18}{'':<38}{printed.spectral_angle:>7.0f}°{printed.correlation:>8.3f}")

# %% [markdown]
# ## All suspects of the scene together
#
# Could the scene be wrong in every respect at once? Leaves twice as wet, half as much cover again,
# no deadwood, no litter, soil half as bright:

# %%
together = base
for k, name in enumerate(knobs):
    if by_slope.get(name, 0.0) < 0:
        together = together.at[k].set(suspects[name][2])
spectrum, _ = look(together, along("leaf water"), scene)
mean, angle, r = (float(v) for v in figures(spectrum))
print(f"mean {mean:.4f} (printed {SIMULATED:g}), angle {angle:.0f}°, r {r:.3f}")
print(f"lowest channel {spectrum.min():.4f}: a scene cannot go below zero")

# %% [markdown]
# ## What can be concluded
#
# - **Water vapour** is a factor on the signal. It takes a small part of what is needed from the
#   mean and turns the angle by a few degrees, with three times the usual column as well. It is not
#   the cause. But of all suspects it bends the shape most: the printed correlation, a little below
#   one, leaves room for some of it.
# - **The scene** (wet leaves, more cover, no litter or deadwood, dark soil), even in all respects
#   at once, stops far above 0.008, keeps the shape, and has no way to subtract.
# - **The empirical line** is the one suspect whose path meets the printed mean and angle. But it
#   needs a dark panel wrong by most of the whole signal, more than careful work with panels allows.
#   Another offset on the way from radiance to reflectance would look the same: a dark pixel that
#   was set to zero though it was not black, or path radiance taken off twice.
# - **What cannot be concluded**: which offset it was. The article prints means and measures of
#   agreement, not the spectra; the real spectrum here is a stand-in. If one of the four numbers is
#   misprinted or computed over other channels, the argument falls with it. And an offset does not
#   acquit the rest: with a scene that is too dark as well, a smaller one would do.
#
# One look at the spectrum would settle it: values below zero at 2400 nm, and the same amount
# missing over every target, dark or bright, mean an offset.
#
# **For your own data**: put your two spectra into `misfit_decomposition` before you look for a
# cause; `fynjax validate` does so for every region. Mostly offset: look at the calibration. Mostly
# gain: look at light and air. Mostly shape: look at leaves, litter and soil.

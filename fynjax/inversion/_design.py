"""Bands of a sensor, chosen by gradient for what they inform of in a stand."""

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from itertools import combinations
from pathlib import Path
from typing import Literal, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
import xarray as xr
from jaxtyping import Array, Float, Int
from scipy.optimize import minimize
from scipy.special import stdtrit

from fynjax._core.errors import InputError, did_you_mean, listed, whole_number
from fynjax._core.html import as_html
from fynjax._core.precision import double_precision
from fynjax._core.progress import track
from fynjax._core.spectral import FWHM_PER_SIGMA
from fynjax.diversity import shannon
from fynjax.inversion._bands import (
    FEWEST,
    RANGE,
    STEP,
    BandStatistics,
    Errors,
    PlantingSpectra,
    gaussian_weights,
    measured,
    render_plantings,
    scores,
)
from fynjax.inversion._calibrate import free_space
from fynjax.inversion._expected import other_plantings
from fynjax.inversion._functionals import Functional, StandNumbers, stand_functionals
from fynjax.inversion._problem import believed
from fynjax.inversion._space import ParameterSpace
from fynjax.metrics import spectral_mask
from fynjax.scene import ModelError, Scene, sensor_of
from fynjax.sensors import BandSet, Lidar, OrthographicCamera, Sensor

DESIGN_FREE = (
    *(f"species.*.{kind}" for kind in ("cover", "diameter", "dead_fraction")),
    *(f"species.*.leaf.{name}" for name in ("chlorophyll", "water", "dry_matter")),
    *("ground.brightness", "ground.moisture"),
)
"""Patterns of the parameters that are unknown in a design, by default."""
DESIGN_TARGET = ("green_leaf_area", "dead_share", "canopy_chlorophyll", "crown_cover", "shannon")
"""Numbers of a stand that a design is for by default."""
CAMERAS = ("mavic_3m", "rededge_3", "sentinel_2a")
"""Shipped sensors that a design is compared with by default."""
_CHANNELS = "aviris_ng"
"""Sensor of which as many channels as the design has bands are chosen, to compare."""
_WITHIN = 1.4
"""Least distance of a band's centre from either end of the range, over its full width at half
maximum [-]: beyond it lies 5e-4 of the response, which has fallen to 4e-3 of its peak."""
_RASTER = 80
"""Centres in the raster from which the first ascent starts."""
_PAIRED = 40
"""Channels of which all pairs are tried, at most."""
_DRAWS = 20
"""Random sets of bands of that raster of which the best is a start."""
_SHANNON = Functional(
    "Shannon entropy of the covers", "-", lambda scene, plot: shannon(plot.species.cover)
)
_OTHER_TARGETS = {
    "information": "information on the parameters one by one [bit]",
    "separability": "mean Jeffries-Matusita distance of two species [0 to 2]",
}
"""Targets that are no quantities, in words."""


class _Limits(NamedTuple):
    """Between which bands are looked for [nm]."""

    lowest: float
    highest: float
    narrowest: float
    widest: float

    def bands(self, x: Float[Array | np.ndarray, " coordinate"]) -> tuple[Array, Array]:
        """Centres and widths [nm] of bands from coordinates between 0 and 1."""
        place, size = jnp.split(jnp.asarray(x), 2)
        width = self.narrowest * (self.widest / self.narrowest) ** size
        room = self.highest - self.lowest - 2.0 * _WITHIN * width
        return self.lowest + _WITHIN * width + room * place, width


def _gaussian(spectra: PlantingSpectra, limits: _Limits, x: Array | np.ndarray) -> BandStatistics:
    centre, width = limits.bands(x)
    return measured(spectra, gaussian_weights(spectra.grid, centre, width), width)


def _value(spectra: PlantingSpectra, seen: BandStatistics, among: Array) -> Float[Array, ""]:
    """Mean over the plantings `among`, and over quantities, of what bands say; the least there can
    be where that is no number, so that no choice falls on it."""
    # A planting that is left out has no say, neither as judge nor as judged.
    value = among @ scores(spectra, seen, among).mean(axis=1) / among.sum()
    return jnp.where(jnp.isnan(value), -jnp.inf, value)


_seen, _seen_gaussian = eqx.filter_jit(measured), eqx.filter_jit(_gaussian)
_scores_of = eqx.filter_jit(scores)


@eqx.filter_jit
def _ascent(
    x: Array, spectra: PlantingSpectra, limits: _Limits, among: Array
) -> tuple[Array, Array]:
    """The negative of the target at bands, and its slopes."""
    return jax.value_and_grad(lambda x: -_value(spectra, _gaussian(spectra, limits, x), among))(x)


@eqx.filter_jit
def _values_of(
    spectra: PlantingSpectra, seen: BandStatistics, sets: Int[Array, "set band"], among: Array
) -> Float[Array, " set"]:
    """The target of sets of bands among those that are seen."""
    return jax.lax.map(lambda at: _value(spectra, seen.chosen(at), among), sets, batch_size=64)


def best_channels(
    spectra: PlantingSpectra, seen: BandStatistics, count: int, among: Float[Array, " planting"]
) -> list[int]:
    """The most informative channels of a sensor: each the best beside those before, from the best
    one or the best pair of a coarse raster, then exchanged one by one until no exchange adds
    information."""
    every = range(len(seen.noise))

    def best(sets: list[list[int]]) -> tuple[float, list[int]]:
        found = np.asarray(_values_of(spectra, seen, jnp.asarray(sets), among))
        return float(found.max()), sets[int(found.argmax())]

    def beside(rest: list[int]) -> tuple[float, list[int]]:
        return best([[*rest, i] for i in every if i not in rest])

    begin = [beside([])]
    if count > 1:
        # Bands that err together tell by their ratio, which no step from a single band finds.
        raster = every[:: -(-len(every) // _PAIRED)]
        begin.append(best([list(pair) for pair in combinations(raster, 2)]))
    return max(_exchanged(count, *start, beside) for start in begin)[1]


def _exchanged(
    count: int,
    value: float,
    chosen: list[int],
    beside: Callable[[list[int]], tuple[float, list[int]]],
) -> tuple[float, list[int]]:
    while len(chosen) < count:
        value, chosen = beside(chosen)
    while True:
        # Exchange: leave one out, and take whatever is best beside the rest.
        found = max(beside(chosen[:k] + chosen[k + 1 :]) for k in range(count))
        if found[0] <= value + 1e-9 * abs(value):
            return value, sorted(chosen)
        value, chosen = found


def _ascend(
    spectra: PlantingSpectra, limits: _Limits, start: np.ndarray, among: Array
) -> tuple[float, np.ndarray]:
    """The target and the place of the best bands near a start."""
    found = minimize(
        lambda x: tuple(np.asarray(a, float) for a in _ascent(x, spectra, limits, among)),
        start, jac=True, method="L-BFGS-B", bounds=[(0.0, 1.0)] * len(start),
        options={"maxiter": 200},
    )  # fmt: skip
    return -float(found.fun), np.asarray(found.x)


@dataclass(frozen=True)
class BandDesign:
    """The most informative bands on a stand, beside those of other sensors."""

    bands: BandSet
    """The designed bands, by rising centre."""
    target: str
    """Words for what the bands were designed for, with its unit."""
    pixel: float
    """Edge of a pixel on the ground [m], of several that of which the target is greatest."""
    pixels: pd.DataFrame
    """A row for each `pixel_m` [m] that was tried, with the `value` of its own best bands."""
    table: pd.DataFrame
    """A row for each sensor, the design first: its number of `bands`, the `value` of the target,
    that in plantings left out of the design (`left_out`), and by how much the design has more of it
    there (`gain`) with its interval of 5 to 95 % (`gain_q05`, `gain_q95`)."""
    quantities: pd.DataFrame
    """A row for each sensor, a column for each quantity that was asked for: the share of its prior
    variance that is removed [-], mean over plantings; of another target its value."""
    starts: Float[np.ndarray, " start"]
    """The target where each ascent ended, best first."""
    spectra: xr.Dataset
    """Over wavelength, `response` of the designed bands; `spectrum` of the plot, and of the pixels
    that are mostly of a species (`species_spectrum`), NaN where there are too few [-]; and the
    change of the mean spectrum that goes with a prior's standard deviation of each quantity
    (`slope`) [-], of none for another target."""
    cameras: tuple[Sensor, ...]
    """The other sensors, with the bands that were compared."""

    @property
    def sensor(self) -> Sensor:
        """A sensor with these bands that looks straight down, without noise or blur."""
        return Sensor(
            "designed", self.bands, OrthographicCamera(self.pixel), source="fynjax design"
        )

    def __str__(self) -> str:
        """The bands, and what they gain."""
        bands = ", ".join(
            f"{c:.0f} nm ({w:.0f} nm wide)" for c, w in zip(self.bands.centre, self.bands.fwhm)
        )
        first, *others = self.table.to_dict("records")
        tried = "" if len(self.pixels) == 1 else f" in pixels of {self.pixel:g} m"
        lines = [
            f"Bands at {bands}{tried}: {self.target} {first['value']:.3g}, of plantings left out "
            f"{first['left_out']:.3g}."
        ]
        lines += [
            f"{row['sensor']} ({row['bands']} bands): {row['left_out']:.3g}; the design has "
            f"{row['gain']:+.3g} [{row['gain_q05']:.2g}, {row['gain_q95']:.2g}]."
            for row in others
        ]
        return "\n".join(lines)

    _repr_html_ = as_html


@double_precision
def design(
    scenes: Scene | Sequence[Scene],
    bands: int = 4,
    target: str | Sequence[str] = DESIGN_TARGET,
    *,
    free: ParameterSpace | None = None,
    pixel: float | Sequence[float] = 0.1,
    spectrum: tuple[float, float] = RANGE,
    widths: tuple[float, float] = (10.0, 100.0),
    snr: float = 100.0,
    relative_sd: float = 0.01,
    error: ModelError | Literal["learned", "none"] | None = "learned",
    plantings: int = 6,
    compare: Sequence[str | Sensor] = CAMERAS,
    starts: int = 8,
    seed: int = 0,
) -> BandDesign:
    """The most informative bands of a camera on a stand, by gradient through the renderer.

    A camera measures mean and standard deviation of each band over the pixels. A quantity with
    slopes g by whitened parameters u, of which the statistics have the slopes J, is estimated from
    them as a'y with a = (C + mean J J')^-1 mean J g, the best linear estimate: C is the covariance
    of the statistics (where plants stand, factors that bands are off by in all pixels, an
    independent relative error of each, shot noise), and means are over plantings. In a planting
    that had no share in them the variance |g - J'a|^2 + (a'y)^2 + noise is left of |g|^2, with y
    less its mean over the others: every planting is judged by estimates that others made, so that
    slopes that are only where plants stand are no knowledge, however many bands there are. The
    target is the mean over plantings and quantities.

    The factor of a band is the sensor's gain (`Sensor.gains`; of designed bands and channels those
    assumed of any sensor) times the model's error, of a wide band the mean of that at its
    wavelengths, weighted by what it sees of the plot. The logarithms have a covariance F, and
    statistics scale with the factor of their band: of two, C has the product of their values times
    F of their bands. In `separability` factors have no share, since they are the same for all
    species.

    Centres and widths climb (L-BFGS) from the best of a raster and of random places. For each
    planting the design is made anew without it, and so is the choice of channels of AVIRIS-NG, and
    judged in it. Of several pixel sizes the best is chosen with all plantings and not anew without
    each: the interval of the gain leaves out that choice, which favours the design. As these
    designs share plantings, the interval is Student's with the variance of Nadeau and Bengio, 1 / P
    + 1 / (P - 1) of that of P plantings.

    **Arguments:**

    - `scenes`: one, of which other plantings are made; or several plantings of the same species,
      with the parameters of the first.
    - `bands`: their number.
    - `target`: names or patterns of numbers of the stand (`stand_functionals`, "shannon" of the
      covers) and of free parameters, of which the mean share of the variance removed counts;
      patterns leave out those that no free parameter changes.
      Or "information", the sum over all free parameters of -log2(share left) / 2 [bit], at most
      what bands say of them together; or "separability", the mean Jeffries-Matusita distance of two
      species' pixels along the line that parts them best in other plantings.
    - `free`: the unknown parameters with their priors; `DESIGN_FREE` with the usual priors if left
      out.
    - `pixel`: edge of a pixel on the ground [m]; of several, multiples of the smallest that divide
      the plot's sides, the design takes that of which the target is greatest.
    - `spectrum`: range of the detector [nm]; bands of other sensors beyond it are left out.
    - `widths`: least and greatest full width at half maximum [nm].
    - `snr`: signal over shot noise of one pixel, the smallest of several, in a band 10 nm wide at
      550 nm over a reflectance of 0.1, under the plot's own sun and a clear sky; elsewhere by the
      photons collected, which grow with the width of a band and the area of a pixel. The detector
      is alike at all wavelengths, and other sensors count with the same optics.
    - `relative_sd`: independent error of every statistic, relative [-].
    - `error`: what the model is off by over wavelength, as of `Problem`.
    - `plantings`: how many are made of one scene, at least 4.
    - `compare`: other sensors, shipped names or objects.
    - `starts`: ascents, the first from a raster of bands.
    - `seed`: of the starts.

    **Returns:** `BandDesign`. Not differentiable; what it climbs is, in centres and widths.

    **Raises:** `InputError` for settings that do not fit each other, a target that is unknown or
    that no free parameter changes, and species that lead in too few pixels to separate.

    Source: Chaloner and Verdinelli (1995), Statistical Science 10, 273; Nadeau and Bengio (2003),
    Machine Learning 52, 239.
    """
    _check_positive("relative_sd", relative_sd)
    errors = Errors(snr, relative_sd, believed(error))
    ready = check_design(
        scenes, bands, target, free=free, pixel=pixel, spectrum=spectrum, widths=widths, snr=snr,
        plantings=plantings, compare=compare, starts=starts, seed=seed,
    )  # fmt: skip
    stands, space, limits, grid, pixels, cameras, channels = ready
    scene = stands[0]
    if len(stands) == 1:
        stands = [scene, *other_plantings(scene, range(1, plantings))]
    kind = target if isinstance(target, str) and target in _OTHER_TARGETS else "quantities"
    named = {} if kind in _OTHER_TARGETS else _asked(stands, space, target)
    if kind == "quantities" and not named:
        raise InputError("what is asked for does not depend on any of the free parameters")
    if named:
        asked = np.stack([*named.values()], axis=1)
    else:  # of the parameters one by one, whose slopes are unit vectors; or of none
        own = np.eye(len(space.names))[: None if kind == "information" else 0]
        asked = np.stack([own] * len(stands))
    tried = render_plantings(stands, space, asked, grid, pixels, errors, kind)
    if kind == "separability":  # the same species in pixels of every size
        common = jnp.stack([image.species > 0 for image in tried]).all(axis=0)
        tried = [eqx.tree_at(lambda i: i.species, image, image.species * common) for image in tried]
    for image, edge in zip(tried, pixels, strict=True):
        if kind == "separability" and (np.asarray(image.species > 0).sum(axis=1) < 2).any():
            raise InputError(
                f"expected two species that lead in {FEWEST} pixels of {edge:g} m or more in every "
                "planting: take smaller pixels"
            )
    every = jnp.ones(len(stands))
    found = [_search(one, limits, bands, starts, seed, every) for one in tried]
    values = [ends[0][0] for ends in found]
    place = int(np.argmax(values))
    spectra, ends = tried[place], found[place]
    centre, width = (np.asarray(a) for a in limits.bands(ends[0][1]))
    order = np.argsort(centre)
    names = tuple(f"b{i + 1}" for i in range(bands))
    designed = BandSet(names, tuple(centre[order]), tuple(width[order]))
    # Each sensor with every planting, and with the one that its bands were chosen without.
    fine = _bands_of(spectra, channels)
    made = Sensor("designed", designed, OrthographicCamera(pixels[place]))
    seen = [_bands_of(spectra, one) for one in (made, *cameras)]
    best = best_channels(spectra, fine, bands, every)
    rows = [
        _scores_of(spectra, one, every).mean(axis=0)
        for one in (*seen, fine.chosen(jnp.asarray(best)))
    ]
    left = []
    for out in track(range(len(stands)), "Leave out each planting"):
        among = every.at[out].set(0.0)
        again = _seen_gaussian(
            spectra, limits, _search(spectra, limits, bands, starts, seed, among)[0][1]
        )
        few = fine.chosen(jnp.asarray(best_channels(spectra, fine, bands, among)))
        those = again, *seen[1:], few
        left.append([float(_scores_of(spectra, one, among)[out].mean()) for one in those])
    cameras.append(dataclasses.replace(channels.select(best), name=f"best {bands} of {_CHANNELS}"))
    quantities = pd.DataFrame(
        np.array(rows), ["designed", *(one.name for one in cameras)], list(named) or [kind]
    )
    return BandDesign(
        bands=designed,
        target=_OTHER_TARGETS.get(kind, "share of the variance removed"),
        pixel=pixels[place],
        pixels=pd.DataFrame({"pixel_m": pixels, "value": values}),
        table=_gains(quantities, [designed, *(one.bands for one in cameras)], np.array(left)),
        quantities=quantities,
        starts=np.array([value for value, _ in ends]),
        spectra=_curves(spectra, designed, list(named), scene.taxa),
        cameras=tuple(cameras),
    )


class _Ready(NamedTuple):
    """Settings of `design` that fit each other."""

    stands: list[Scene]
    space: ParameterSpace
    limits: _Limits
    grid: Float[np.ndarray, " wavelength"]
    pixels: tuple[float, ...]
    """In ascending order [m]."""
    cameras: list[Sensor]
    """Sensors that the design is compared with, each with those of its bands only that lie within
    the range of wavelengths that is designed for."""
    channels: Sensor
    """AVIRIS-NG, with those of its bands that lie within that range."""


@double_precision
def check_design(
    scenes: Scene | Sequence[Scene],
    bands: int,
    target: str | Sequence[str],
    *,
    free: ParameterSpace | None,
    pixel: float | Sequence[float],
    spectrum: tuple[float, float],
    widths: tuple[float, float],
    snr: float,
    plantings: int,
    compare: Sequence[str | Sensor],
    starts: int,
    seed: int,
) -> _Ready:
    """Check the settings of `design`, and make them what it computes with.

    **Arguments:** `scenes`, whose plants need not be drawn, `bands`, `target`, `free`, `pixel`,
    `spectrum`, `widths`, `snr`, `plantings`, `compare`, `starts` and `seed` as of `design`, which
    has what they are by default.

    **Raises:** `InputError` for settings that do not fit each other, and an unknown target. Whether
    a free parameter changes the target is up to the plants.
    """
    stands = [scenes] if isinstance(scenes, Scene) else list(scenes)
    limits, grid = _check(stands, bands, spectrum, widths, plantings)
    pixels = _pixels(stands[0], pixel)
    whole_number("starts", starts, 1)
    whole_number("seed", seed)
    _check_positive("snr", snr)
    scene = stands[0]
    space = free
    if space is None:
        space = free_space(scene, scene.parameters, DESIGN_FREE, lambda name: None)
    cameras = [_within(one, grid) for one in compare]
    # Channels are chosen as those of a camera yet to be made, and calibrated as that.
    channels = dataclasses.replace(_within(_CHANNELS, grid), calibrations=())
    place = np.asarray(scene.planting.place)
    if scene.known_plants or (place.size and not place.any()):
        raise InputError(
            "expected a plot whose plants are drawn, of which there are several plantings, but its "
            "plants are known and stand where they do: leave the crown map out"
        )
    if not (isinstance(target, str) and target in _OTHER_TARGETS):
        _check_names(scene, space, target)
    return _Ready(stands, space, limits, grid, pixels, cameras, channels)


def _check_positive(name: str, value: float) -> None:
    if not 0.0 < value < np.inf:
        raise InputError(f"`{name}` must be a positive number, but is {value:g}")


def _check(
    stands: Sequence[Scene],
    bands: int,
    spectrum: tuple[float, float],
    widths: tuple[float, float],
    plantings: int,
) -> tuple[_Limits, Float[np.ndarray, " wavelength"]]:
    """Limits of the bands, and the grid of wavelengths."""
    number = whole_number("plantings", plantings) if len(stands) == 1 else len(stands)
    if not all(isinstance(one, Scene) for one in stands) or number < 4:
        raise InputError(f"expected a scene and 4 `plantings` or more, or as many scenes: {number}")
    if len({one.taxa for one in stands}) > 1:
        raise InputError("expected scenes of the same species, in the same order")
    for name, pair, least, most in (
        ("spectrum", spectrum, *RANGE), ("widths", widths, STEP, np.inf)
    ):  # fmt: skip
        if len(pair) != 2 or not least <= pair[0] <= pair[1] <= most:
            raise InputError(
                f"expected `{name}` as two numbers in order, of {least:g} to {most:g} nm, but got "
                f"{listed(f'{one:g}' for one in pair)}"
            )
    grid = np.arange(spectrum[0] + STEP / 2.0, spectrum[1] - STEP / 2.0 + 1e-6, STEP)
    within = f"{spectrum[0]:g} to {spectrum[1]:g} nm"
    if len(grid) < 2 or 2.0 * _WITHIN * widths[1] > grid[-1] - grid[0]:
        raise InputError(f"a band {widths[1]:g} nm wide does not fit into {within}")
    whole_number("bands", bands, 1, len(grid))
    try:
        spectral_mask(grid, RANGE)
    except InputError as error:
        raise InputError(
            f"no light comes through the air from {within}: take a `spectrum` beyond the water "
            "windows"
        ) from error
    return _Limits(float(grid[0]), float(grid[-1]), *map(float, widths)), grid


def _pixels(scene: Scene, pixel: float | Sequence[float]) -> tuple[float, ...]:
    """Edges of a pixel [m] that are tried, in ascending order."""
    ascending = tuple(sorted({float(one) for one in np.atleast_1d(pixel)}))
    if not ascending or not 0.0 < ascending[0] <= ascending[-1] < np.inf:
        raise InputError(f"expected `pixel` as one or more positive numbers [m], but got {pixel}")
    sides = scene.grid.extent[:2]
    if ascending[-1] > max(sides) / 2.0:
        raise InputError(
            f"expected at least two pixels on a plot of {sides[0]:g} x {sides[1]:g} m, but got a "
            f"`pixel` of {ascending[-1]:g} m"
        )
    for one in ascending[1:]:
        wholes = np.array([one / ascending[0], *(side / one for side in sides)])
        if (np.abs(wholes - np.round(wholes)) > 1e-6 * wholes).any():
            raise InputError(
                f"expected each `pixel` as a multiple of the smallest, {ascending[0]:g} m, that "
                f"divides the sides of the plot, but got {one:g} m"
            )
    return ascending


def _within(sensor: str | Path | Sensor | Lidar, grid: Float[np.ndarray, " wavelength"]) -> Sensor:
    """A sensor with the bands that lie within a grid of wavelengths."""
    found = sensor_of(sensor)
    if not isinstance(found, Sensor):
        raise InputError(f"expected imaging sensors in `compare`, but got {found!r:.60}")
    places = found.bands.covered(grid)
    if not places:
        raise InputError(f"{found.name!r} has no band from {grid[0]:g} to {grid[-1]:g} nm")
    return found.select(places)


def _check_names(
    scene: Scene, space: ParameterSpace, target: str | Sequence[str]
) -> tuple[dict[str, Functional], list[str]]:
    """Numbers of the stand by their names, and what is asked for. Raises `InputError` for a name
    that is neither of them nor of a free parameter."""
    functionals = stand_functionals(scene) | {"shannon": _SHANNON}
    wanted = [target] if isinstance(target, str) else list(target)
    for pattern in wanted:
        if not any(fnmatchcase(name, pattern) for name in (*functionals, *space.names)):
            known = (*_OTHER_TARGETS, *functionals)
            raise InputError(
                f"expected a target among {', '.join(known)} or names of free parameters, but got "
                f"{pattern!r}.{did_you_mean(pattern, [*known, *space.names])}"
            )
    return functionals, wanted


def _asked(
    stands: Sequence[Scene], space: ParameterSpace, target: str | Sequence[str]
) -> dict[str, Float[np.ndarray, "planting free"]]:
    """Slopes by the whitened coordinates of each quantity whose name is asked for."""
    scene, none = stands[0], jnp.zeros(len(space.names))
    functionals, wanted = _check_names(scene, space, target)
    names = [*functionals, *space.names]
    values = tuple(one.value for one in functionals.values())
    own = jax.jacfwd(space.physical)(none)
    numbers = [StandNumbers(stand, scene.parameters, space, values) for stand in stands]
    found = np.stack([np.concatenate([one.linear(none)[1], own]) for one in numbers], axis=1)
    changed = {
        name: slopes
        for name, slopes in zip(names, found, strict=True)
        # In every planting: a quantity that some planting lacks has no share of variance there.
        if np.abs(slopes).max(axis=1).min() > 0.0
    }
    fixed = [name for name in wanted if name in names and name not in changed]
    if fixed and tuple(wanted) != DESIGN_TARGET:
        raise InputError(
            f"no free parameter changes {listed(fixed)} in every planting: free one that does, or "
            "leave it out of the `target`"
        )
    return {
        name: slopes
        for name, slopes in changed.items()
        if any(fnmatchcase(name, one) for one in wanted)
    }


def _bands_of(spectra: PlantingSpectra, sensor: Sensor) -> BandStatistics:
    weights = sensor.bands.weights(np.asarray(spectra.grid), max_loss=1e-2)
    width = jnp.asarray(sensor.bands.fwhm)
    return _seen(spectra, jnp.asarray(weights), width, sensor.gains())


def _search(
    spectra: PlantingSpectra, limits: _Limits, bands: int, starts: int, seed: int, among: Array
) -> list[tuple[float, np.ndarray]]:
    """Ends of ascents, best first: the first from the best bands of a raster of centres and widths
    (`best_channels`), the others from the best of random places."""
    # Coordinates between 0 and 1 of centres and widths (`_Limits.bands`), as the ascent has them.
    raster = np.stack(np.meshgrid(np.linspace(0.0, 1.0, _RASTER), (0.0, 0.5, 1.0)), -1)
    raster = raster.reshape(-1, 2)
    seen = _seen_gaussian(spectra, limits, raster.T.ravel())
    begin = [raster[best_channels(spectra, seen, bands, among)].T.ravel()]
    random = np.random.default_rng([seed, 89])
    for sets in random.integers(len(raster), size=(starts - 1, _DRAWS, bands)):
        values = np.asarray(_values_of(spectra, seen, jnp.asarray(sets), among))
        begin.append(raster[sets[int(values.argmax())]].T.ravel())
    ends = [_ascend(spectra, limits, start, among) for start in track(begin, "Ascend")]
    return sorted(ends, key=lambda end: -end[0])


def half_interval(gain: Float[np.ndarray, "planting sensor"]) -> Float[np.ndarray, " sensor"]:
    """Half of the interval of 90 % of a mean gain over plantings, each judged by the others:
    Student's, with the variance of Nadeau and Bengio."""
    count = len(gain)
    # Designs share all plantings but one, so that their gains are not independent.
    wider = np.sqrt(1.0 / count + 1.0 / (count - 1.0))
    return np.asarray(stdtrit(count - 1, 0.95) * wider * gain.std(axis=0, ddof=1))


def _gains(
    quantities: pd.DataFrame, bands: Sequence[BandSet], left: Float[np.ndarray, "planting sensor"]
) -> pd.DataFrame:
    """The table of a `BandDesign`."""
    gain = left[:, :1] - left
    mean, half = gain.mean(axis=0), half_interval(gain)
    return pd.DataFrame(
        {
            "sensor": quantities.index,
            "bands": [len(one) for one in bands],
            "value": quantities.mean(axis=1).to_numpy(),
            "left_out": left.mean(axis=0),
            "gain": mean,
            "gain_q05": mean - half,
            "gain_q95": mean + half,
        }
    )


def _curves(
    spectra: PlantingSpectra, designed: BandSet, asked: Sequence[str], taxa: Sequence[str]
) -> xr.Dataset:
    """The spectra of a `BandDesign`."""
    grid = np.asarray(spectra.grid)
    sigma = np.array(designed.fwhm)[:, None] / FWHM_PER_SIGMA
    off = (grid - np.array(designed.centre)[:, None]) / sigma
    of_named = np.asarray(spectra.asked)[:, : len(asked)]
    # Along the gradient of a quantity, of unit length: a prior's standard deviation of it.
    sd = np.sqrt(np.sum(of_named**2, axis=2, keepdims=True))
    slopes = np.einsum("pwk,pqk->pqw", spectra.mean_slope, of_named / sd)
    number = np.asarray(spectra.species)[..., None]
    with np.errstate(invalid="ignore"):
        species = (number * np.asarray(spectra.species_mean)).sum(axis=0) / number.sum(axis=0)
    factor = {"units": "1", "long_name": "reflectance factor"}
    return xr.Dataset(
        {
            "response": (("band", "wavelength"), np.exp(-0.5 * off**2), {"units": "1"}),
            "spectrum": ("wavelength", np.asarray(spectra.mean).mean(axis=0), factor),
            "species_spectrum": (("species", "wavelength"), species, factor),
            "slope": (("quantity", "wavelength"), slopes.mean(axis=0), {"units": "1"}),
        },
        {
            "wavelength": ("wavelength", grid, {"units": "nm"}),
            "band": list(designed.names),
            "species": list(taxa),
            "quantity": list(asked),
        },
        {"title": "bands of a designed sensor"},
    )

"""The numbers of the article beside those of a scene of its plot."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
import pandas as pd
from jaxtyping import Float

from fynjax._core.progress import advance, stage
from fynjax.app.compare import bands_2006, figure12_2006, table4_2006, table5_2006
from fynjax.app.compare.structure import structure_2006
from fynjax.canopy import table1_2006
from fynjax.metrics import BANDS, VEGETATION_INDICES, index_bands, spectral_mask, vegetation_indices
from fynjax.metrics.structure import (
    STRUCTURE_METRICS,
    StructureSettings,
    bin_returns,
    cell_grid,
    cell_structure,
)
from fynjax.scene import PlotAir, PlotParameters, Scene, observe
from fynjax.sensors import CameraNoise, Panel, shipped_lidar, shipped_sensor

SWIR2_MEAN = {"real": 0.063, "dirsig": 0.008}
"""Mean reflectance at 2100 to 2450 nm, from the article's text on AVIRIS-NG [-]."""
_RETURNS = 13.17, 693.39
"""Returns of the LiDAR [m-2], real and DIRSIG's, from section 4.4."""
_GRAINS = {1.0: (np.nan, 13.0, 17.9, 51.3), 2.0: (38.0, 52.0, 6.1, 10.6)}
"""Section 4.4, of the real cloud by the side of a cell [m]: returns in the emptiest and in the
median cell; median and largest change of the metrics to cells 1 m wider [%]."""
_GRAIN_NAMES = (
    "returns in the emptiest cell",
    "returns in the median cell",
    "median change to wider cells [%]",
    "largest change to wider cells [%]",
)
_TABLE_1 = {
    "cover [%]": ("cover_percent", "cover", 100.0),
    "crown diameter [cm]": ("mean_diameter_cm", "diameter", 100.0),
    "height [m]": ("height_max_m", "height", 1.0),
}
"""Columns of table 1: their names in `table1_2006` and in species parameters, and the factor to the
printed unit."""
_LIDARS = {"flash_lidar_paper": "", "scanning_lidar": ", by an aircraft's scanner"}
"""LiDAR systems that look at the plot, and what is added to the names of their numbers."""
_THINNINGS = 20
"""Times that a simulated cloud is thinned, at random, to the real number of returns."""


def article_tables(
    scene: Scene,
    calibrated: PlotParameters | None = None,
    *,
    gains: Sequence[float] | None = None,
    pixel: float = 0.025,
    channels: int = 425,
    chain: bool = False,
    seed: int = 0,
) -> pd.DataFrame:
    """Every number that the article prints in tables 1 to 5, figures 9 and 12 and section 4.4, what
    its DIRSIG made of it, and what a scene gives.

    **Arguments:**

    - `scene`: of the plot burnt in 2006 (`fx.read_scene()`), with level ground.
    - `calibrated`: parameters of its species after a calibration; none by default.
    - `gains`: factors of the drone's bands that the calibration estimated; none by default.
    - `pixel`: of the drone's image [m]; the article's by default.
    - `channels`: about so many of the spectrometer's are simulated.
    - `chain`: also what the instruments make of the plot. The drone's camera looks through 50 m of
      air at two panels on the plot, of reflectance 0.05 and 0.5, and is calibrated by their
      empirical line; pixels of the panels do not count. Its noise is assumed, as its maker states
      none: 10 000 electrons in the brightest pixel, 3 of reading, 12 bits. AVIRIS-NG has its own
      noise, and the air is taken out again as it is.
    - `seed`: of the noise.

    **Returns:** a row for each number with the columns table, quantity, real, dirsig,
    uncalibrated, nearest and definition; with `calibrated` a column of that name, and with `gains`
    calibrated_with_gains, the calibrated plot through a camera with these gains. `chain` adds
    uncalibrated_measured and calibrated_measured. Columns that end
    with off_percent have what each is off by in percent of the real number; of DIRSIG it is printed
    in some rows where its value is not. `nearest` names the column that is least off; it is empty
    where only one is known, and for numbers that contradict the article's own formulas. Of tables 2
    and 3 the printed value stands in `real`, and in the others what the shipped sensor has or
    the printed optics give. NaN where a number is not printed, and where only an agreement is, of
    histograms and spectra that are not published.
    """
    parts = _of_bands(), _of_indices(), _of_spectra(), _of_structure()
    table = pd.DataFrame([number for part in parts for number in part])
    table = table.astype(dict.fromkeys(["real", "dirsig", "dirsig_off_percent"], float))
    columns = {}
    states = {"uncalibrated": scene.parameters}
    if calibrated is not None:
        states["calibrated"] = calibrated
    with stage("Look at the plot", total=(4 + chain) * len(states)):
        for name, state in states.items():
            seen = observe(scene, "mavic_3m", pixel=pixel, parameters=state)
            image = np.asarray(seen.reflectance)
            advance()
            columns[name] = _drone(image) | _spectrometer(scene, state, channels)
            columns[name] |= _species(scene, state) | _sensors() | _structure(scene, state)
            if chain:
                columns[f"{name}_measured"] = {
                    **_drone(_measured(scene, state, pixel, seed)),
                    **_spectrometer(scene, state, channels, air=PlotAir(), noise=True, seed=seed),
                }
    if gains is not None and calibrated is not None:
        columns["calibrated_with_gains"] = _drone(image * np.reshape(gains, (-1, 1, 1)))
    for name, values in columns.items():
        table[name] = table["quantity"].map(values).astype(float)
    real = table["real"]
    off = {name: 100.0 * (table[name] - real) / real.abs() for name in ("dirsig", *columns)}
    off["dirsig"] = off["dirsig"].fillna(table.pop("dirsig_off_percent"))
    sizes = pd.DataFrame(off).abs()
    judged = table.pop("sound") & sizes[["dirsig", "uncalibrated"]].notna().all(axis=1)
    table["nearest"] = ""
    table.loc[judged, "nearest"] = sizes[judged].idxmin(axis=1)
    for name, percent in off.items():
        table[f"{name}_off_percent"] = percent
    return table[[*(c for c in table if c != "definition"), "definition"]]


class _Number(NamedTuple):
    """A printed number of the real plot, of DIRSIG's, and what the latter is off by [%]."""

    table: str
    quantity: str
    definition: str
    real: float | None = np.nan
    dirsig: float | None = np.nan
    dirsig_off_percent: float | None = np.nan
    sound: bool = True


def _of_bands() -> Iterator[_Number]:
    """Species, optics and bands: tables 1 to 3 and figure 9."""
    for _, species in table1_2006().iterrows():
        for quantity, (column, _, _) in _TABLE_1.items():
            what = "field survey; the input of a simulation, which a calibration may change"
            yield _Number("table 1", f"{species.taxon}: {quantity}", what, float(species[column]))
    for _, row in _optics().iterrows():
        yield _Number(f"table {row.table}", row.quantity, row.definition, row.printed)
    for name, band in bands_2006().items():
        what = "mean over the pixels; the real one follows from table 4; of DIRSIG no sign"
        yield _Number(
            "figure 9",
            f"{name}.mean",
            what,
            band.real_mean,
            dirsig_off_percent=100.0 * band.sim_abs_difference,
        )


def _of_indices() -> Iterator[_Number]:
    """Vegetation indices: table 4."""
    for name, row in table4_2006().items():
        form = f"of {VEGETATION_INDICES[name].formula}, inferred from the printed numbers"
        called = "" if row.printed == name else f", printed as {row.printed}"
        known = row.formula_confidence != "open"
        if not known:
            form = "of a form that is not printed and needs a blue band"
        form += called
        yield _Number("table 4", f"{name}.mean", f"mean over the pixels {form}",
            row.real_mean, row.sim_mean, sound=known)  # fmt: skip
        doubt = "; the printed real one contradicts this form" if known else ""
        doubt = "" if row.std_consistent else doubt
        yield _Number("table 4", f"{name}.std", f"standard deviation over the pixels {form}{doubt}",
            row.real_std, row.sim_std, sound=bool(row.std_consistent))  # fmt: skip
        pixels = "with the histogram of the real pixels, which are not published"
        yield _Number("table 4", f"{name}: overlap", f"histogram intersection {pixels}",
            dirsig=row.histogram_intersection)  # fmt: skip
        yield _Number("table 4", f"{name}: KS", f"largest distance of the distribution {pixels}",
            dirsig=row.ks)  # fmt: skip


def _of_spectra() -> Iterator[_Number]:
    """Spectra and their indices: table 5 and figure 12."""
    for region, found in table5_2006().items():
        spectrum = f"to the real spectrum, not published, {region}"
        yield _Number("table 5", f"spectral angle [deg], {region}", f"angle {spectrum}",
            dirsig=found.spectral_angle)  # fmt: skip
        yield _Number(
            "table 5", f"RMSE, {region}", f"root mean square distance {spectrum}", dirsig=found.rmse
        )
        what = "that over the range of the real one"
        yield _Number("table 5", f"NRMSE [%], {region}", what, dirsig=100.0 * found.nrmse)
        yield _Number(
            "table 5", f"correlation, {region}", f"Pearson's, {spectrum}", dirsig=found.correlation
        )
        what = "largest less smallest of the mean spectrum; the real one is RMSE over NRMSE"
        yield _Number("table 5", f"range of reflectance, {region}", what, found.rmse / found.nrmse)
    what = "mean of the mean spectrum at 2100 to 2450 nm, from the text"
    yield _Number(
        "table 5", "mean reflectance, swir2", what, SWIR2_MEAN["real"], SWIR2_MEAN["dirsig"]
    )
    for name, index in figure12_2006().items():
        ends = f"{100.0 * index.lower:g} to {100.0 * index.upper:g} %"
        what = f"of the mean spectra; printed as {ends}, sign " + (
            "plus" if index.simulated_higher else "not printed"
        )
        middle = 50.0 * (index.lower + index.upper)
        yield _Number("figure 12", f"{name} by AVIRIS-NG", what, dirsig_off_percent=middle)


def _of_structure() -> Iterator[_Number]:
    """Point clouds: section 4.4."""
    for name in ("height_percentile_rmse", "height_intersection"):
        structure = structure_2006()[name]
        what = f"against the real cloud, which is not published; {structure.remark}"
        yield _Number("section 4.4", name, what, dirsig=structure.simulated)
    for kind, ending in _LIDARS.items():
        what = f"by the system {kind}; of the flight and not of the plot"
        yield _Number("section 4.4", f"returns [m-2]{ending}", what, *_RETURNS, sound=False)
        for name in STRUCTURE_METRICS:
            structure = structure_2006()[name]
            what = "mean over cells of 2 m, returns thinned to the real number; "
            yield _Number("section 4.4", f"{name}{ending}", what + structure.remark, structure.real,
                structure.simulated, structure.difference_percent,
                sound=name != "foliage_height_diversity")  # fmt: skip
        gap = structure_2006()["gap_fraction"]
        what = "the same as the share of cells of 0.5 m without a return above 0.1 m"
        yield _Number(
            "section 4.4", f"gap_fraction, of cells{ending}", what, gap.real, gap.simulated
        )
        for grain, values in _GRAINS.items():
            for quantity, real in zip(_GRAIN_NAMES, values, strict=True):
                what = f"cells of {grain:g} m; the cloud thinned to the real number of returns"
                if np.isfinite(real):
                    yield _Number("section 4.4", f"{quantity}, {grain:g} m{ending}", what, real)


def _optics() -> pd.DataFrame:
    """What tables 2 and 3 print of the sensors, and what stands beside."""
    return pd.read_csv(Path(__file__).parent / "data" / "optics.csv")


def _sensors() -> dict[str, float]:
    """Numbers of the shipped sensors, and those that the printed optics give."""
    plane: Any = shipped_sensor("aviris_ng")
    drone: Any = shipped_sensor("mavic_3m")
    line, frame, bands = plane.camera.line, drone.camera, drone.bands
    lidar: Any = shipped_lidar("flash_lidar_paper")
    flash = lidar.geometry
    centres = plane.bands.centre
    values = [
        len(centres), centres[0], centres[-1], np.diff(centres).mean(),
        line.array[0], line.pixel_pitch_um, line.focal_length_mm, plane.altitude,
        27e-6 / 26.6e-3 * 1000.0,
        *np.stack([bands.centre, np.divide(bands.fwhm, 2.0)], axis=1).ravel().tolist(),
        *frame.array, frame.pixel_pitch_um, frame.focal_length_mm, drone.altitude,
        2e-6 / 4e-3 * 50.0,
        flash.altitude, flash.half_divergence_rad, flash.array[0], flash.pixel_pitch_um,
        flash.focal_length_mm, flash.frame_step, flash.rate, *lidar.gate, lidar.line_width,
        lidar.pulse_length, lidar.wavelength, lidar.sample, 100e-6 / 0.128 * 50.0,
        2.0 * 50.0 * np.tan(0.071),
    ]  # fmt: skip
    return dict(zip(_optics()["quantity"], map(float, values), strict=True))


def _species(scene: Scene, parameters: PlotParameters) -> dict[str, float]:
    return {
        f"{taxon}: {quantity}": factor * float(getattr(parameters.species, field)[i])
        for i, taxon in enumerate(scene.taxa)
        for quantity, (_, field, factor) in _TABLE_1.items()
    }


def _measured(
    scene: Scene, parameters: PlotParameters, pixel: float, seed: int
) -> Float[np.ndarray, "band pixel"]:
    """The drone's image as its camera measures it, without the panels and the pixels beside."""
    across = max(3, round(0.5 / pixel))
    wide = pixel * across
    panels = tuple(
        Panel(
            x_m=pixel + wide / 2 + k * (wide + pixel),
            y_m=pixel + wide / 2,
            side_m=wide,
            reflectance=r,
        )
        for k, r in enumerate((0.05, 0.5))
    )
    drone: Any = shipped_sensor("mavic_3m")
    over = {"pixel": pixel, "parameters": parameters, "air": PlotAir(), "panels": panels}
    full = np.asarray(observe(scene, drone, **over).radiance).max(axis=(1, 2))
    noise = CameraNoise(full, jnp.full(4, 1e4), jnp.full(4, 3.0), 12)
    image = observe(scene, replace(drone, noise=noise), noise=True, seed=seed, **over).reflectance
    plants = np.ones(image.shape[1:], bool)
    plants[: across + 3, : 2 * across + 4] = False
    return np.asarray(image)[:, plants]


def _drone(image: Float[np.ndarray, "band ..."]) -> dict[str, float]:
    """Means of bands, means and spreads of indices of an image."""
    found = {f"{name}.mean": float(band.mean()) for name, band in zip(BANDS, image, strict=True)}
    for name in table4_2006():
        (values,) = np.asarray(vegetation_indices(image, [name]))
        values = np.where(np.isfinite(values), values, np.nan)
        found[f"{name}.mean"] = float(np.nanmean(values))
        found[f"{name}.std"] = float(np.nanstd(values))
    return found


def _spectrometer(
    scene: Scene, parameters: PlotParameters, channels: int, **chain: Any
) -> dict[str, float]:
    """Numbers of the mean spectrum as AVIRIS-NG sees the plot."""
    sensor = shipped_sensor("aviris_ng")
    chosen = range(4, len(sensor.bands) - 4, max(1, len(sensor.bands) // channels))
    seen = observe(scene, sensor.select(list(chosen)), pixel=3.0, parameters=parameters, **chain)
    clear = np.asarray(seen.transparent)
    mean = np.asarray(seen.reflectance.mean(axis=(1, 2)))[clear]
    wavelength = np.array(seen.wavelength)[clear]
    inside = {region: mean[spectral_mask(wavelength, region)] for region in table5_2006()}
    ranges = {f"range of reflectance, {k}": float(np.ptp(v)) for k, v in inside.items()}
    there = index_bands(wavelength)
    names = [name for name in figure12_2006() if name in there]
    found = {}
    if names:  # of few channels some index has none
        indices = np.asarray(vegetation_indices(mean[:, None], names, wavelength))[:, 0]
        found = {f"{n} by AVIRIS-NG": float(v) for n, v in zip(names, indices, strict=True)}
    return ranges | found | {"mean reflectance, swir2": float(inside["swir2"].mean())}


def _structure(scene: Scene, parameters: PlotParameters) -> dict[str, float]:
    """Structure of the clouds, thinned to the real number of returns: medians over thinnings."""
    found: dict[str, float] = {}
    for kind, ending in _LIDARS.items():
        cloud = observe(scene, shipped_lidar(kind), parameters=parameters)
        advance()
        place = cloud.to_dataframe()[["x", "y", "z"]].to_numpy(float)
        wide, deep = scene.grid.extent[:2]
        found[f"returns [m-2]{ending}"] = len(place) / (wide * deep)
        kept = min(len(place), round(_RETURNS[0] * wide * deep))
        random = np.random.default_rng(0)
        draws = [
            _cells(place[random.choice(len(place), kept, replace=False)], (0.0, 0.0, wide, deep))
            for _ in range(_THINNINGS)
        ]
        medians = pd.DataFrame(draws).median()
        found |= {f"{name}{ending}": float(value) for name, value in medians.items()}
    return found


def _cells(
    place: Float[np.ndarray, "return 3"], bounds: tuple[float, float, float, float]
) -> dict[str, float]:
    """Structure of returns over level ground, mean over cells of 2 m, and what cells hold."""
    x, y, z = place.T
    settings = StructureSettings()
    found: dict[str, float] = {}

    def of(grain: float, settings: StructureSettings = settings) -> tuple[Any, dict[str, float]]:
        cells = cell_structure(bin_returns(x, y, z, cell_grid(bounds, grain), settings))
        return cells, cells.means()

    side = min(bounds[2:])
    grains = [grain for grain in (1.0, 2.0, 3.0) if grain <= side]
    each = {grain: of(grain) for grain in grains}
    for grain, wider in pairwise(grains):
        cells, means = each[grain]
        change = [100.0 * abs(each[wider][1][k] / v - 1.0) for k, v in means.items() if v]
        numbers = (
            cells.returns.min(),
            np.median(cells.returns),
            np.nanmedian(change),
            np.nanmax(change),
        )
        found |= {
            f"{quantity}, {grain:g} m": float(number)
            for quantity, number in zip(_GRAIN_NAMES, numbers, strict=True)
        }
    by_cells = replace(settings, gap_of="canopy")
    grain = min(2.0, side)
    found["gap_fraction, of cells"] = of(grain, by_cells)[1]["gap_fraction"]
    return found | of(grain)[1]

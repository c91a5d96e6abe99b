"""The job of `fynjax validate`: real against simulated data of any of three sensors."""

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
import pandas as pd
from pydantic import Field

from fynjax._core.arguments import Names, Seed
from fynjax._core.dry_run import begin_work
from fynjax._core.errors import InputError
from fynjax._core.precision import double_precision
from fynjax.app.assembly import frames_image, simulated_flight
from fynjax.app.compare import (
    DroneComparison,
    DroneImage,
    PublishedComparison,
    SpectralComparison,
    bands_2006,
    compare_drone_images,
    compare_spectra,
    compare_with_published,
    read_drone_image,
    read_spectra_sample,
    shared_bands,
    validation_dataset,
    wins,
)
from fynjax.app.compare.structure import (
    CloudOptions,
    StructureComparison,
    cloud_settings,
    compare_pair,
    read_pair,
)
from fynjax.app.io.frames import FrameStack, is_frame_stack
from fynjax.app.io.plot import as_plot
from fynjax.app.io.raster import write_run
from fynjax.app.io.text import existing_file
from fynjax.app.jobs._doubt import doubt_spectrum
from fynjax.app.jobs._result import JobResult, Record, Rows, rows_of
from fynjax.app.jobs._run import Run
from fynjax.app.report import figures
from fynjax.app.report.pages import (
    Page,
    Section,
    Table,
    drone_section,
    published_section,
    spectral_section,
    structure_section,
)
from fynjax.metrics import BANDS, WATER_WINDOWS, MatchingMethod
from fynjax.sensors import mavic_3m

PUBLISHED = "published"
"""Stands for the paper's real drone image, of which only statistics are printed."""


@dataclass(frozen=True)
class ValidationData:
    """The files of a validation; any of the three pairs may be missing."""

    real_drone: str | Path | None = None
    """Real drone image (GeoTIFF, reflectance); or frames of a flight on the ground (frames.nc of
    frames --images); or the name 'published': the printed statistics of the plot burnt in 2006."""
    simulated_drone: str | Path | None = None
    """Simulated drone image; of frames the plot file, by which each is simulated from where it
    hung."""
    real_spectra: Sequence[str | Path] = ()
    """Real spectra, all on one grid: CSV, ASD, ENVI library or cube, GeoTIFF, NetCDF."""
    simulated_spectra: Sequence[str | Path] = ()
    """Simulated spectra, in any of these."""
    real_cloud: str | Path | None = None
    """Real point cloud (LAS, LAZ, PLY, XYZ)."""
    simulated_cloud: str | Path | None = None
    """Simulated point cloud."""

    def __post_init__(self) -> None:
        pairs = {
            "drone": (self.real_drone, self.simulated_drone),
            "spectra": (self.real_spectra, self.simulated_spectra),
            "cloud": (self.real_cloud, self.simulated_cloud),
        }
        for name, (real, simulated) in pairs.items():
            if bool(real) != bool(simulated):
                there, lost = ("real", "simulated") if real else ("simulated", "real")
                hint = (
                    " Or --real-drone published, for the printed statistics of the 2006 plot."
                    if name == "drone" and lost == "real"
                    else ""
                )
                raise InputError(f"--{there}-{name} needs --{lost}-{name} beside it.{hint}")
        if not any(real for real, _ in pairs.values()):
            raise InputError(
                "expected at least one pair of files: --real-drone and --simulated-drone, "
                "--real-spectra and --simulated-spectra, or --real-cloud and --simulated-cloud"
            )

    def files(self) -> list[Path]:
        """Every file, each of which must exist."""
        paths: list[Path] = []
        for what, group in (
            ("a drone image", [self.real_drone, self.simulated_drone]),
            ("spectra", [*self.real_spectra, *self.simulated_spectra]),
            ("a point cloud", [self.real_cloud, self.simulated_cloud]),
        ):
            paths += [
                existing_file(path, what) for path in group if path and str(path) != PUBLISHED
            ]
        return paths


Drone = DroneComparison | PublishedComparison


class DroneSummary(Record):
    """Two drone images compared, or one with published statistics."""

    bands: Rows | None = Field(default=None, description="Rows of drone_bands.csv.")
    indices: Rows | None = Field(default=None, description="Rows of drone_indices.csv.")
    diversity: Rows | None = Field(default=None, description="Rows of drone_diversity.csv.")
    published: Rows | None = Field(default=None, description="Rows of drone_published.csv.")
    frames: Rows | None = Field(default=None, description="Rows of drone_frames.csv.")
    notes: list[str]


class SpectraSummary(Record):
    """Two sets of spectra compared."""

    matching: str
    regions: Rows = Field(description="Rows of spectral_agreement.csv.")
    misfit: Rows = Field(description="Rows of spectral_misfit.csv.")
    indices: Rows = Field(description="Rows of spectral_indices.csv.")
    notes: list[str]


class StructureSummary(Record):
    """Two point clouds compared."""

    settings: dict[str, Any] = Field(description="What the metrics depend on.")
    options: dict[str, Any] = Field(description="How the clouds were read and compared.")
    grain_m: float
    bounds_m: tuple[float, float, float, float]
    plot_bounds_m: tuple[float, float, float, float]
    grains: Rows = Field(description="Rows of structure_grains.csv.")
    matched_returns: int
    thinned: str
    clouds: dict[str, dict[str, str | float | None]] = Field(
        description="File, returns and ground of the real and the simulated cloud."
    )
    metrics: Rows = Field(description="Rows of structure.csv.")
    notes: list[str]


class ValidateResult(JobResult):
    """What `validate` compared; None where a pair of files was not given."""

    command: Literal["validate"] = "validate"
    drone: DroneSummary | None
    spectra: SpectraSummary | None
    structure: StructureSummary | None


@double_precision
def validate(
    data: ValidationData,
    output: str | Path,
    *,
    real_bands: Names | None = None,
    simulated_bands: Names | None = None,
    saturation: Annotated[float, Field(ge=0.0)] | None = None,
    pixels: Annotated[int, Field(ge=100)] = 1_000_000,
    matching: MatchingMethod = "auto",
    exclude: Sequence[tuple[float, float]] = (),
    structure_preset: str | None = None,
    cloud_options: CloudOptions | None = None,
    seed: Seed = 0,
) -> ValidateResult:
    """Compare simulated with real data: drone images, spectra, point clouds.

    Any of the three pairs may be left out. The published values of the fynbos scene paper stand
    beside them. The images need not lie on each other: distributions of pixels are compared.

    **Arguments:**

    - `data`: the files of the real and the simulated measurements.
    - `output`: folder of the results, made if missing.
    - `real_bands`: what each band of the real image is, names with commas between, where the file
      does not say: green, red, red_edge, nir, others as the sensor calls them, such as blue, and
      any other name for bands that are not used.
    - `simulated_bands`: the same of the simulated image.
    - `saturation`: saturation threshold of a drone pixel [-].
    - `pixels`: largest number of pixels of an image; larger ones are thinned evenly.
    - `matching`: how the finer spectra are brought onto the bands of the coarser.
    - `exclude`: wavelengths to leave out [nm], LOW-HIGH, such as 930-960, besides the water windows
      1340-1460 and 1790-2100.
    - `structure_preset`: name of the conventions of a known tool: fynjax, lidR, leafR,
      PyForestScan, GEDI L2B. The options of point clouds override it.
    - `cloud_options`: settings of point clouds that override the preset.
    - `seed`: seed of the random numbers in the comparison of clouds.

    **Returns:** `ValidateResult`. Writes tables (CSV), `validation.nc` and `structure.nc`, figures
    and a page into `output`.

    **Raises:** `InputError` as the readers and comparisons.

    Example: `jobs.validate(jobs.ValidationData(real_drone="real.tif",
    simulated_drone="image.tif"), "results")`.
    """
    run = Run(output, seed=seed)
    inputs = data.files()
    drone: Drone | None = None
    by_frame: tuple[FrameStack, FrameStack] | None = None
    if data.simulated_drone:
        read = partial(read_drone_image, saturation=saturation, most_pixels=pixels)
        by_frame = _by_frame(data, seed)
        if by_frame and (
            saturation is not None or pixels != 1_000_000 or real_bands or simulated_bands
        ):
            raise InputError("expected no saturation, pixels or names of bands with frames")
        drone = _compare_images(data, read, simulated_bands, real_bands, by_frame)
        _doubt(run, drone)
    spectra: SpectralComparison | None = None
    if data.simulated_spectra:
        spectra = compare_spectra(
            read_spectra_sample(data.real_spectra),
            read_spectra_sample(data.simulated_spectra),
            method=matching,
            windows=(*WATER_WINDOWS, *exclude),
        )
    files = {"report.html": ""}
    files |= {} if drone is None and spectra is None else {"validation.nc": ""}
    clouds = None
    if data.real_cloud and data.simulated_cloud:
        settings = cloud_settings(structure_preset, cloud_options or {})
        clouds = read_pair(data.real_cloud, data.simulated_cloud, settings)
        files["structure.nc"] = ""
    begin_work(files)
    structure = None if clouds is None else compare_pair(clouds, seed=seed)
    record = run.record(inputs)
    parts: dict[str, _Part] = {}
    with run.stage("Write"):
        if drone is not None:
            parts["drone"] = _write_drone(run, drone)
            if by_frame is not None:
                parts["drone"] = _with_frames(run, parts["drone"], *by_frame)
        if spectra is not None:
            parts["spectra"] = _write_spectra(run, spectra)
        if parts:
            path = run.path("validation.nc", "every number, NetCDF")
            write_run(path, validation_dataset(drone, spectra), record)
        if structure is not None:
            parts["structure"] = _write_structure(run, structure, record)
        keys = {name: value for part in parts.values() for name, value in part.keys.items()}
        lead = "Simulated against real data, after section 4 of the scene paper."
        sections = [part.section for part in parts.values()]
        first = " ".join(part.headline[0] for part in parts.values())
        run.page(Page("validate", "Validation", lead, sections, keys, record, first))
    return run.result(
        ValidateResult,
        headline=[sentence for part in parts.values() for sentence in part.headline],
        **dict.fromkeys(("drone", "spectra", "structure"))
        | {kind: part.summary for kind, part in parts.items()},
    )


class _Part(NamedTuple):
    """A comparison in sentences, in its main numbers, on the page and in the result."""

    headline: list[str]
    keys: dict[str, str]
    section: Section
    summary: Record


def _compare_images(
    data: ValidationData,
    read: Callable[..., DroneImage],
    simulated_bands: Sequence[str] | None,
    real_bands: Sequence[str] | None,
    by_frame: tuple[FrameStack, FrameStack] | None,
) -> Drone:
    if by_frame is not None:
        return compare_drone_images(
            *(frames_image(Path(str(data.real_drone)), stack) for stack in by_frame)
        )
    if str(data.real_drone) == PUBLISHED:
        return compare_with_published(read(data.simulated_drone, bands=simulated_bands))
    both = data.simulated_drone or "", data.real_drone or ""
    stated = simulated_bands, real_bands
    others = shared_bands(*both, bands=stated)
    pair = list(zip(both, stated, strict=True))
    simulated, real = (read(path, bands=bands, camera=others) for path, bands in pair)
    if simulated.bands != real.bands:  # a band of one alone must leave out no pixels
        simulated, real = (read(path, bands=bands) for path, bands in pair)
    return compare_drone_images(real, simulated)


def _by_frame(data: ValidationData, seed: int) -> tuple[FrameStack, FrameStack] | None:
    """Real frames and simulated ones; None where the real image is none of these."""
    real, simulated = Path(str(data.real_drone)), Path(str(data.simulated_drone))
    if str(data.real_drone) == PUBLISHED or not is_frame_stack(real):
        if simulated.suffix.lower() == ".toml":
            raise InputError(
                "expected frames.nc of `fynjax frames --images` as the real image beside a plot "
                "file, or a simulated image",
                file=real,
            )
        return None
    if simulated.suffix.lower() != ".toml":
        raise InputError(
            "expected the plot file that the frames are simulated by, beside real ones",
            file=simulated,
        )
    return simulated_flight(as_plot(simulated), real, seed=seed)


def _with_frames(run: Run, part: "_Part", real: FrameStack, simulated: FrameStack) -> "_Part":
    """What was said of all frames, with each of them beside the angles that it was seen from."""
    rows = []
    for k, frame in enumerate(real.frames):
        seen = real.seen[k]
        east, north, height = (float(v) for v in frame.pose.position)
        y_at, x_at = (np.mean(where + 0.5) * real.pixel for where in np.nonzero(seen))
        x, y = east - x_at, north - y_at
        zenith = np.degrees(np.arctan2(np.hypot(x, y), height))
        azimuth = np.degrees(np.arctan2(x, y)) % 360.0
        for i, band in enumerate(real.bands):
            there, here = (stack.reflectance[k, i][seen] for stack in (real, simulated))
            rows.append(
                {
                    "frame": frame.name, "view_zenith_deg": zenith, "view_azimuth_deg": azimuth,
                    "band": band, "real_mean": there.mean(), "simulated_mean": here.mean(),
                    "difference_percent": 100.0 * (here.mean() / there.mean() - 1.0),
                    "real_std": there.std(), "simulated_std": here.std(),
                }
            )  # fmt: skip
    table = pd.DataFrame(rows)
    run.table("drone_frames.csv", table, "each frame and band, real and simulated", "%.9g")
    spread = table.groupby("band")["difference_percent"].agg(np.ptp)
    worst = spread.idxmax()
    said = []
    if len(real.frames) > 1:
        said.append(
            f"Between the {len(real.frames)} frames the difference of a mean changes by "
            f"{spread.max():.1f} % at most, in {figures.words(str(worst))}."
        )
    shown = Table(table, "Frame by frame, by the angles that they were seen from.", folded=True)
    section = replace(part.section, parts=[*part.section.parts, *said, shown])
    assert isinstance(part.summary, DroneSummary)
    summary = part.summary.model_copy(update={"frames": rows_of(table)})
    return part._replace(headline=[*part.headline, *said], section=section, summary=summary)


def _doubt(run: Run, drone: Drone) -> None:
    """Say where the real image is none of shrubland."""
    if isinstance(drone, PublishedComparison):
        real = {name: row.real_mean for name, row in bands_2006().items()}
    else:
        real = dict(zip(BANDS, drone.real.pixels.mean(axis=1)))  # which come first
    doubt_spectrum(run, real, mavic_3m())


def _write_drone(run: Run, drone: Drone) -> _Part:
    if isinstance(drone, PublishedComparison):
        what = "statistics beside the published ones"
        run.table("drone_published.csv", drone.statistics, what, "%.9g")
        nearer, count = wins(drone.statistics)
        said = (
            "Against the published statistics of the 2006 plot's real image: nearer than the "
            f"paper's DIRSIG in {nearer} of {count} numbers that are sound."
        )
        what = "numbers nearer to the real image than the paper's DIRSIG"
        summary = DroneSummary(published=rows_of(drone.statistics), notes=list(drone.notes))
        return _Part([said], {what: f"{nearer} of {count}"}, published_section(drone), summary)
    run.table("drone_bands.csv", drone.bands, "bands, real and simulated", "%.9g")
    run.table("drone_indices.csv", drone.indices, "the twenty indices, with formulas", "%.9g")
    run.table("drone_diversity.csv", drone.variety, "how much spectra of pixels differ", "%.9g")
    bands = ", ".join(
        f"{figures.words(r['band'])} {r['difference_percent']:+.1f} %"
        for r in drone.bands.to_dict("records")
    )
    table = drone.indices
    worst = table.iloc[int(np.nanargmax(table["difference_percent"].abs()))]
    overlap = table["histogram_intersection"].median()
    headline = [
        f"Drone, simulated against real means: {bands}.",
        f"Twenty indices: median histogram intersection {overlap:.2f}, median KS "
        f"{table['ks'].median():.2f}, largest difference of a mean {worst['index']} "
        f"{worst['difference_percent']:+.0f} %.",
    ]
    largest = drone.bands["difference_percent"].abs().max()
    keys = {
        "largest difference of a band mean": f"{largest:.1f} %",
        "median histogram intersection, 20 indices": f"{overlap:.2f}",
    }
    summary = DroneSummary(
        bands=rows_of(drone.bands),
        indices=rows_of(drone.indices),
        diversity=rows_of(drone.variety),
        notes=list(drone.notes),
    )
    return _Part(headline, keys, drone_section(drone), summary)


def _write_spectra(run: Run, spectra: SpectralComparison) -> _Part:
    for name, table, what in (
        ("spectra.csv", spectra.spectra, "both mean spectra on common bands"),
        ("spectral_agreement.csv", spectra.regions, "agreement by region (table 5)"),
        ("spectral_misfit.csv", spectra.misfit, "offset, gain and shape of the misfit"),
        ("spectral_indices.csv", spectra.indices, "indices of the spectra, with formulas"),
    ):
        run.table(name, table, what, "%.9g")
    reading = dict(zip(spectra.misfit["region"], spectra.misfit["reading"], strict=True))
    regions = spectra.regions.to_dict("records")
    headline = [
        f"Spectra, {row['region']}: angle {_defined(row['spectral_angle_deg'], '.1f', '°')}, RMSE "
        f"{row['rmse']:.4f}, r {_defined(row['correlation'], '.3f')}, mean "
        f"{row['real_mean']:.3f} real and {row['simulated_mean']:.3f} simulated; "
        f"{reading[row['region']]}."
        for row in regions
    ]
    keys = {}
    for row in regions[:1]:
        angle = _defined(row["spectral_angle_deg"], ".1f", "°")
        keys[f"spectral angle, {row['region']}"] = angle
        keys[f"RMSE, {row['region']}"] = f"{row['rmse']:.3f}"
    summary = SpectraSummary(
        matching=spectra.match.method,
        regions=rows_of(spectra.regions),
        misfit=rows_of(spectra.misfit),
        indices=rows_of(spectra.indices),
        notes=list(spectra.notes),
    )
    return _Part(headline, keys, spectral_section(spectra), summary)


def _defined(value: float, form: str, unit: str = "") -> str:
    """A number with its unit, or that it is undefined."""
    return f"{value:{form}}{unit}" if np.isfinite(value) else "undefined"


def _write_structure(
    run: Run, structure: StructureComparison, record: dict[str, str | int]
) -> _Part:
    table, settings = structure.table(), structure.settings_table()
    run.table("structure.csv", table, "structure metrics with their intervals", "%.9g")
    run.table("structure_settings.csv", settings, "every setting they depend on", None)
    curves = structure.curves()
    for name, rows, what in (
        ("grains", structure.grains, "grains that were tried, with their cells, area and bounds"),
        ("profile", curves["profile"], "leaf area density by layer of both clouds [m2 m-3]"),
        ("percentiles", curves["percentiles"], "percentiles of height of both clouds [m]"),
        ("histogram", curves["histogram"], "share of returns by height of both clouds"),
    ):
        run.table(f"structure_{name}.csv", rows, what, "%.9g")
    dataset = structure.dataset()
    for key, variable in dataset.variables.items():  # as run files have them
        variable.attrs.setdefault("long_name", str(key).replace("_", " "))
        if variable.dtype.kind in "fiu":
            variable.attrs.setdefault("units", "1")
    path = run.path("structure.nc", "every number of both clouds, with maps by cell, NetCDF")
    write_run(path, dataset, record)
    changes = [
        f"{str(name).replace('_', ' ')} {change:+.0f} %"
        for name, change in structure.difference_percent.dropna().items()
    ]
    heights = structure.heights["value"]
    said = (
        f"Structure at {structure.grain:g} m, simulated against real: "
        f"{', '.join(changes) or 'no metric is defined in both'}; heights overlap by "
        f"{heights['height_intersection']:.2f}, their percentiles differ by "
        f"{heights['height_percentile_rmse']:.3f} m RMSE."
    )
    summary = _structure_summary(structure)
    cells = next(iter(structure.real.cells.values())).size
    keys = {f"cells of {structure.grain:g} m, returns": f"{cells}, {structure.matched_returns}"}
    return _Part([said], keys, structure_section(structure), summary)


def _structure_summary(structure: StructureComparison) -> StructureSummary:
    shown = (
        *("file", "returns", "density", "ground", "ground_share", "below_ground"),
        *("below_ground_share", "too_high", "highest", "nearly_highest"),
    )
    return StructureSummary(
        settings=asdict(structure.settings),
        options=structure.options,
        grain_m=structure.grain,
        bounds_m=structure.bounds,
        plot_bounds_m=structure.plot,
        grains=rows_of(structure.grains),
        matched_returns=structure.matched_returns,
        thinned=structure.thinned,
        clouds={
            n: {key: getattr(side, key) for key in shown} for n, side in structure.sides.items()
        },
        metrics=rows_of(structure.table()),
        notes=list(structure.notes),
    )

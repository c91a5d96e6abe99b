"""Real against simulated data of any of three sensors: what `fynjax validate` does."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd

from fynjax._core.errors import InputError
from fynjax._core.progress import NullProgress, Progress
from fynjax.compare import (
    DroneComparison,
    PublishedComparison,
    SpectralComparison,
    compare_drone_images,
    compare_spectra,
    compare_with_published,
    read_drone_image,
    read_spectra_sample,
    records,
    validation_dataset,
    wins,
)
from fynjax.io.raster import provenance, write_run
from fynjax.io.text import existing_file, write_text
from fynjax.metrics import WATER_WINDOWS, MatchingMethod
from fynjax.report.pages import (
    Files,
    Page,
    drone_headline,
    drone_section,
    published_section,
    spectral_headline,
    spectral_section,
    told,
)

PUBLISHED = "published"
"""Stands for the paper's real drone image, of which only statistics are printed."""


@dataclass(frozen=True)
class ValidationData:
    """The files of a validation; any of the three pairs may be missing."""

    real_drone: str | Path | None = None
    """Image (GeoTIFF), or 'published'."""
    simulated_drone: str | Path | None = None
    real_spectra: Sequence[str | Path] = ()
    """Tables, libraries, ASD files, cubes or NetCDF, all on one grid."""
    simulated_spectra: Sequence[str | Path] = ()
    real_cloud: str | Path | None = None
    """Point cloud (LAS, LAZ, PLY, XYZ)."""
    simulated_cloud: str | Path | None = None

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
        found = []
        for what, group in (
            ("a drone image", [self.real_drone, self.simulated_drone]),
            ("spectra", [*self.real_spectra, *self.simulated_spectra]),
            ("a point cloud", [self.real_cloud, self.simulated_cloud]),
        ):
            found += [
                existing_file(path, what) for path in group if path and str(path) != PUBLISHED
            ]
        return found


def validate(
    data: ValidationData,
    output: str | Path,
    *,
    real_bands: Sequence[str] | None = None,
    simulated_bands: Sequence[str] | None = None,
    saturation: float | None = None,
    most_pixels: int = 1_000_000,
    matching: MatchingMethod = "auto",
    windows: Sequence[tuple[float, float]] = WATER_WINDOWS,
    structure_preset: str | None = None,
    cloud_options: Mapping[str, Any] | None = None,
    seed: int = 0,
    progress: Progress | None = None,
) -> dict[str, Any]:
    """Compare real with simulated data, and write tables, figures, a run file and the page.

    **Arguments:** `real_bands`, `simulated_bands`, `saturation` and `most_pixels` as
    `read_drone_image` has them; `matching` and `windows` as `compare_spectra`;
    `structure_preset`, a name in `fynjax.metrics.STRUCTURE_PRESETS`, and `cloud_options` that
    override it, as `cloud_settings` has them; `seed` of what is drawn in the comparison of clouds.

    **Returns:** the summary: headline, files, every number.

    **Raises:** `InputError` as the readers and comparisons do.
    """
    progress = NullProgress() if progress is None else progress
    output = Path(output)
    inputs = data.files()
    drone: DroneComparison | PublishedComparison | None = None
    if data.simulated_drone:
        simulated = read_drone_image(
            data.simulated_drone,
            progress,
            bands=simulated_bands,
            saturation=saturation,
            most_pixels=most_pixels,
        )
        if str(data.real_drone) == PUBLISHED:
            drone = compare_with_published(simulated)
        else:
            real = read_drone_image(
                data.real_drone or "",
                progress,
                bands=real_bands,
                saturation=saturation,
                most_pixels=most_pixels,
            )
            drone = compare_drone_images(real, simulated, progress)
    spectra: SpectralComparison | None = None
    if data.simulated_spectra:
        spectra = compare_spectra(
            read_spectra_sample(data.real_spectra, progress),
            read_spectra_sample(data.simulated_spectra, progress),
            method=matching,
            windows=windows,
        )
    structure = _structure(data, structure_preset, cloud_options or {}, seed, progress)
    with progress.stage("Write"):
        return _write(output, inputs, drone, spectra, structure, seed)


def _structure(
    data: ValidationData,
    preset: str | None,
    options: Mapping[str, Any],
    seed: int,
    progress: Progress,
) -> Any | None:
    if not (data.real_cloud and data.simulated_cloud):
        return None
    from fynjax.compare.structure import cloud_settings, compare_clouds

    return compare_clouds(
        data.real_cloud,
        data.simulated_cloud,
        settings=cloud_settings(preset, options),
        seed=seed,
        progress=progress,
    )


def _write(
    output: Path,
    inputs: Sequence[Path],
    drone: DroneComparison | PublishedComparison | None,
    spectra: SpectralComparison | None,
    structure: Any | None,
    seed: int,
) -> dict[str, Any]:
    record = provenance(seed=seed, inputs=inputs)
    headline, files = _headline(drone, spectra), Files()
    summary: dict[str, Any] = {}
    page = Page("Validation", "Simulated against real data, after section 4 of the scene paper.")
    page.key_figures(_key_figures(drone, spectra))
    files["report.html"] = "all of it on one page"
    if isinstance(drone, PublishedComparison):
        files |= published_section(page, drone)
        files |= _tables(output, {"drone_published": drone.statistics})
        summary["drone"] = {"published": records(drone.statistics), "notes": drone.notes}
    elif drone is not None:
        files |= drone_section(page, output, drone)
        files |= _tables(output, {"drone_bands": drone.bands, "drone_indices": drone.indices})
        summary["drone"] = {
            "bands": records(drone.bands),
            "indices": records(drone.indices),
            "notes": drone.notes,
        }
    if spectra is not None:
        files |= spectral_section(page, output, spectra)
        tables = {
            "spectra": spectra.spectra,
            "spectral_agreement": spectra.regions,
            "spectral_misfit": spectra.misfit,
            "spectral_indices": spectra.indices,
        }
        files |= _tables(output, tables)
        summary["spectra"] = {
            "matching": spectra.match.method,
            "regions": records(spectra.regions),
            "misfit": records(spectra.misfit),
            "indices": records(spectra.indices),
            "notes": spectra.notes,
        }
    if drone is not None or spectra is not None:
        write_run(output / "validation.nc", validation_dataset(drone, spectra), record)
        files["validation.nc"] = "every number, NetCDF"
    if structure is not None:
        from fynjax.report.pages import structure_headline, structure_section

        files |= structure_section(page, output, structure, record)
        headline += structure_headline(structure)
        summary["structure"] = structure.as_dict()
    page.footer(record)
    page.write(output / "report.html")
    return {"headline": headline, "files": files, **summary}


_CSV = {
    "drone_bands": "bands, real and simulated",
    "drone_indices": "the twenty indices, with formulas",
    "drone_published": "statistics beside the published ones",
    "spectra": "both mean spectra on common bands",
    "spectral_agreement": "agreement by region (table 5)",
    "spectral_misfit": "offset, gain and shape of the misfit",
    "spectral_indices": "indices of the spectra, with formulas",
}


def _tables(folder: Path, tables: dict[str, pd.DataFrame]) -> Files:
    for name, table in tables.items():
        write_text(folder / f"{name}.csv", table.to_csv(index=False, float_format="%.9g"))
    return {f"{name}.csv": _CSV[name] for name in tables}


def _headline(
    drone: DroneComparison | PublishedComparison | None, spectra: SpectralComparison | None
) -> list[str]:
    lines: list[str] = []
    if isinstance(drone, PublishedComparison):
        nearer, of = wins(drone.statistics)
        lines.append(
            f"Against the published statistics of the 2006 plot's real image: nearer than the "
            f"paper's DIRSIG in {nearer} of {of} numbers that are sound."
        )
    elif drone is not None:
        lines += drone_headline(drone)
    if spectra is not None:
        lines += spectral_headline(spectra)
    return lines


def _key_figures(
    drone: DroneComparison | PublishedComparison | None, spectra: SpectralComparison | None
) -> dict[str, str]:
    figures: dict[str, str] = {}
    if isinstance(drone, DroneComparison):
        largest = drone.bands["difference_percent"].abs().max()
        overlap = drone.indices["histogram_intersection"].median()
        figures["largest difference of a band mean"] = f"{largest:.1f} %"
        figures["median histogram intersection, 20 indices"] = f"{overlap:.2f}"
    elif drone is not None:
        nearer, of = wins(drone.statistics)
        figures["numbers nearer to the real image than the paper's DIRSIG"] = f"{nearer} of {of}"
    if spectra is not None and len(spectra.regions):
        row = spectra.regions.iloc[0]
        figures[f"spectral angle, {row['region']}"] = told(row["spectral_angle_deg"], ".1f", "°")
        figures[f"RMSE, {row['region']}"] = f"{row['rmse']:.3f}"
    return figures

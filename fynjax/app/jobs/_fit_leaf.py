"""The job of `fynjax fit-leaf`: files of spectra in, traits and spectra out."""

from collections.abc import Sequence
from pathlib import Path
from typing import ClassVar, Literal

import numpy as np
import pandas as pd
import xarray as xr
from jaxtyping import Float
from pydantic import ConfigDict, Field

from fynjax._core.arguments import Seed
from fynjax._core.checkpoint import Journal, signature
from fynjax._core.dry_run import begin_work
from fynjax._core.errors import InputError
from fynjax._core.parts import Workers, at_work
from fynjax._core.precision import double_precision
from fynjax._core.progress import stage
from fynjax.app.io.spectra import (
    Refused,
    measured_dataset,
    read_curve,
    usable_spectra,
    warnings_of_reading,
    write_spectra_netcdf,
)
from fynjax.app.io.text import Strict, read_rows
from fynjax.app.jobs._result import JobResult
from fynjax.app.jobs._run import Run
from fynjax.app.jobs._spectra import RefusedSpectrum, SpectrumRepair, refused_spectra, repairs
from fynjax.app.report import figures
from fynjax.app.report.pages import Picture, Table
from fynjax.leaf import (
    MEASUREMENTS,
    AbstractMeasurement,
    ErrorName,
    FitDomain,
    LeafArea,
    LeafChunks,
    LeafFit,
    LeafGroups,
    LeafSettings,
    LeafShape,
    ProspectVersion,
    area_factors,
    bin_centres,
    fit_leaf_groups,
    resolved_by_two_readings,
    sample_leaf_posterior,
    to_bins,
    to_nanometres,
    transmittance_from_two_readings,
    usual_measurement,
)

Sampling = Literal["none", "emcee", "nuts"]
"""Sampler of the posterior, if one is asked for."""
_GRID = np.arange(350.0, 2501.0)
_SHOWN = 100
"""Spectra of which a page shows the traits, at most."""
_PART = 1024
"""Leaves that are fitted together, in memory of some 130 MB."""


class FitLeafResult(JobResult):
    """Result of `fit_leaf`: how many spectra were fitted, repaired and refused."""

    command: Literal["fit-leaf"] = "fit-leaf"
    spectra: int
    converged_spectra: int
    doubtful_spectra: int
    refused: list[RefusedSpectrum]
    repairs: list[SpectrumRepair]


def _measurement(
    name: str, shape: LeafShape, background: Float[np.ndarray, " band"] | None, second_reading: bool
) -> AbstractMeasurement:
    """Model of what an instrument records of leaves over a background on the file's grid.

    Behind the gaps of round leaves lies the light trap of a sphere, or a face that need not be
    black; light goes to and fro between those side by side. A thick pile has no gaps and hides what
    is behind. Where a second reading is over the background, the first is over black.
    """
    if second_reading:
        if background is None:
            raise InputError("readings over a background need its reflectance, `background`")
        background = None
    if name not in MEASUREMENTS:
        raise InputError(f"`measurement` must be one of {', '.join(MEASUREMENTS)}, but is {name!r}")
    single = MEASUREMENTS[name]()
    if name == "stack" or (shape == "broad" and background is None):
        return single
    behind: Float[np.ndarray, " bin"] | float | None = 0.0 if name == "sphere" else None
    if background is not None:
        binned = to_bins(_GRID, background)
        have = np.isfinite(binned)
        behind = np.interp(bin_centres(), bin_centres()[have], binned[have])
    return usual_measurement(shape, behind, single.offset_deviation)


def _background(given: str | Path | float, measurement: str) -> Float[np.ndarray, " band"]:
    """Reflectance behind the leaves on the file's grid: a number, or the table of that name."""
    if measurement not in ("leaf-clip", "probe"):
        raise InputError(
            f"a background is that of a leaf clip or a probe, but `measurement` is {measurement!r}"
        )
    try:
        level = float(str(given))
    except ValueError:
        wavelength, values = read_curve(str(given), "the background")
        return np.interp(_GRID, wavelength, values, left=np.nan, right=np.nan)
    if not 0.0 < level <= 1.0:
        raise InputError(f"`background` must be a reflectance of 0 to 1, but is {level:g}")
    return np.full(_GRID.shape, level)


def _in_nanometres(spectra: xr.Dataset) -> xr.Dataset:
    """The spectra on the file's grid."""
    fine = {
        str(key): (part.dims, to_nanometres(spectra["wavelength"].values, part.values)[1])
        for key, part in spectra.items() if "wavelength" in part.dims
    }  # fmt: skip
    return spectra.drop_dims("wavelength").assign(fine).assign_coords(wavelength=_GRID)


def _with_transmittance(
    first: xr.Dataset, second: xr.Dataset, background: Float[np.ndarray, " band"]
) -> xr.Dataset:
    """Readings over black with the transmittance that those over the background give, and a note;
    NaN where the leaf is opaque to the method.

    Readings belong together by name, or by their order if the names differ.
    """
    names = first["spectrum"].values.tolist()
    if set(second["spectrum"].values) == set(names):
        second = second.sel(spectrum=names)
    if second.sizes["spectrum"] != len(names):
        raise InputError(
            f"each leaf needs a reading over the background, but of {len(names)} leaves there are "
            f"{second.sizes['spectrum']}"
        )
    if "transmittance" in first:
        known = np.isfinite(first["transmittance"].values).any(1)
        raise InputError(
            f"the transmittance of {names[np.argmax(known)]!r} was measured, so readings over the "
            "background are one too many"
        )
    over_black, over = first["reflectance"].values, second["reflectance"].values
    through = np.asarray(transmittance_from_two_readings(over_black, over, background))
    # By bins of the fit: the bands left of a bin would be its brighter ones.
    centres = bin_centres()
    nearest = np.searchsorted((centres[1:] + centres[:-1]) / 2, _GRID, side="right")
    binned = (to_bins(_GRID, values) for values in (over_black, through, background))
    known = resolved_by_two_readings(*binned)[:, nearest]
    inside = (_GRID >= 450.0) & (_GRID <= 2400.0) & np.isfinite(over_black + over + background)
    if not inside.any(1).all():
        name = names[np.argmin(inside.any(1))]
        raise InputError(f"the readings of {name!r} have no bands in common")
    opaque = (inside & ~known).sum(1) / inside.sum(1)
    said = [
        f"{before}{'; ' if before else ''}transmittance from two readings; too opaque for it at "
        f"{100 * part:.0f} % of bands"
        for before, part in zip(first["repairs"].values, opaque)
    ]
    through = np.where(known, through, np.nan)
    return first.assign(
        transmittance=(("spectrum", "wavelength"), through),
        repairs=("spectrum", np.array(said, object)),
    )


class GroupRow(Strict):
    """The species of a spectrum; the table may have further columns."""

    model_config = ConfigDict(extra="ignore", frozen=True)
    unique: ClassVar[str] = "name"

    name: str = Field(description="Name of the spectrum, as in traits.csv.", min_length=1)
    species: str = Field(description="Species of the leaf.", min_length=1)


def _read_groups(path: str | Path, names: Sequence[str]) -> list[str]:
    """The species of each spectrum from a table with the columns `name` and `species`."""
    rows = read_rows(path, GroupRow, "a table of names and species")
    species = {row.name: row.species for _, row in rows}
    missing = [name for name in names if name not in species]
    if missing:
        raise InputError(
            f"no species for {len(missing)} spectra, the first is {missing[0]!r}; "
            "the column name holds names of spectra, as in traits.csv",
            file=path, column="name",
        )  # fmt: skip
    return [species[name] for name in names]


@double_precision
def fit_leaves(
    paths: Sequence[str | Path],
    output: str | Path,
    *,
    version: ProspectVersion = "D",
    measurement: str = "sphere",
    background: str | Path | float | None = None,
    over_background: Sequence[str | Path] = (),
    leaf_shape: LeafShape = "broad",
    area: LeafArea = "projected",
    domain: FitDomain = "full",
    error_model: ErrorName | None = None,
    panel: str | Path | None = None,
    detector_changes: Sequence[float] | None = None,
    transmittance: Sequence[str | Path] = (),
    groups: str | Path | None = None,
    posterior: Sampling = "none",
    seed: Seed = 0,
    checkpoint: str | Path | None = None,
    workers: Workers | None = None,
) -> FitLeafResult:
    """Fit PROSPECT to measured leaf spectra.

    A file or a spectrum that cannot be used does not stop the others: it becomes a row of
    `traits.csv` with the reason as status; the column `repairs` lists the repairs made while
    reading. If none can be used the first reason is raised. A table with reflectance and
    transmittance has a column of each, such as oak_R and oak_T.

    **Arguments:**

    - `paths`: files of spectra, or folders of them: ASD, SVC, Spectral Evolution, CSV, text, ENVI.
    - `output`: folder of the results, made if missing.
    - `version`: PROSPECT version.
    - `measurement`: how it was measured: sphere, leaf-clip, probe, or stack (piles, optically
      thick); see the classes of `fynjax.leaf` for what each identifies.
    - `background`: reflectance behind the leaf of a clip or probe, a number or a file; black by
      default. Where it is missing the leaf's reading is left out.
    - `over_background`: second readings of the same leaves over `background`; the first are then
      over black, and transmittance follows from both.
    - `leaf_shape`: shape of the leaves: needle, single or apart; mat, needles side by side; culm,
      culms side by side. Single needles reflect more at their surface. Gaps, what lies behind the
      leaves of a clip, and light between those side by side (the recollision probability), are
      estimated where transmittance is measured.
    - `area`: what contents are stated per in all tables: projected area, or half of the surface of
      the leaf; see `fynjax.leaf.area_factors`.
    - `domain`: wavelengths to fit: all, or the published sub-domains.
    - `error_model`: what spectra depart from PROSPECT by: laboratory (real leaves, a sphere), field
      (real leaves, a clip or probe), exact (simulated spectra). Left out: by `measurement`.
    - `panel`: table of the white panel's own reflectance, for spectra relative to it; those of ASD
      files that hold it are absolute already.
    - `detector_changes`: wavelengths [nm] where detectors change, such as 1000,1830, at which
      jumps are taken out of all spectra; ASD files state them themselves.
    - `transmittance`: transmittance of the same leaves, by name or in the same order, where no name
      or file says it, as oak_R.asd and oak_T.asd do.
    - `groups`: file (CSV) with columns name (of a spectrum) and species: leaves of a species are
      fitted together; `species.csv` then holds the mean leaf and five material variants of each,
      `leaves.csv` the variants of PROSPECT-D as a leaf table.
    - `posterior`: sampler of the posterior of each leaf, into `posterior.nc`, or none.
    - `seed`: seed of the posterior's random numbers; the fit itself draws none.
    - `checkpoint`: folder that keeps what each 1024 leaves of a larger table gave, from which an
      interrupted run goes on; none by default. Leaves that are fitted together (`groups`), and
      posteriors, are not kept.
    - `workers`: where chunks of 1024 leaves are fitted; in this process by default. Leaves that are
      fitted together (`groups`), and posteriors, stay there.

    **Returns:** `FitLeafResult`. Writes `traits.csv`, `spectra.nc`, a figure and a page into
    `output`, and where asked for `species.csv` and `posterior.nc`.

    **Raises:** `InputError` if no file holds a usable spectrum, or the table of groups is wrong,
    or for an unknown measurement or error model, "exact" with groups, or a checkpoint of another
    run; `MissingExtraError` for a sampler not installed.

    Example: `jobs.fit_leaves(["leaves.csv"], "results", version="PRO")`.
    """
    behind = None if background is None else _background(background, measurement)
    instrument = _measurement(measurement, leaf_shape, behind, bool(over_background))
    area_factors(area, leaf_shape)  # refuses an unknown area before anything is read
    read, refused = usable_spectra(paths, panel, detector_changes, transmittance)
    spectra = measured_dataset(read, {})
    if behind is not None:
        spectra = _in_nanometres(spectra)
        if over_background:
            second, bad = usable_spectra(over_background, panel, detector_changes)
            if bad:
                raise bad[0][2]
            others = _in_nanometres(measured_dataset(second, {}))
            spectra = _with_transmittance(spectra, others, behind)
        else:
            spectra["reflectance"] = spectra["reflectance"].where(np.isfinite(behind))
    names = spectra["spectrum"].values.tolist()
    run = Run(output, seed=seed)
    species = None if groups is None else _read_groups(groups, names)
    size = f"{len(names)} spectra"
    begin_work(
        {"traits.csv": f"{size}, {len(refused)} refused", "spectra.nc": size, "report.html": ""}
        | ({} if species is None else {"species.csv": f"{len(set(species))} species"})
        | ({} if posterior == "none" else {"posterior.nc": size})
    )
    how = LeafSettings(version, instrument, leaf_shape, domain, error_model=error_model)
    together = None if species is None else fit_leaf_groups(spectra, groups=species, settings=how)
    fit = _fit_apart(spectra, how, checkpoint, workers) if together is None else together.leaves
    settings = {
        "prospect_version": version,
        "measurement": measurement,
        "leaf_shape": leaf_shape,
        "area": area,
        "domain": domain,
        "seed": str(seed),
    }
    table = fit.table(area)
    if refused:
        rows = [{"file": f, "name": n, "status": f"refused: {e}"} for f, n, e in refused]
        table = pd.concat([table, pd.DataFrame(rows)], ignore_index=True)
    what = "parameters, deviations, 90 % intervals and status of each spectrum"
    run.table("traits.csv", table, what)
    what = "measured, fitted and predicted R and T on the fit's bins"
    dataset = fit.to_xarray(area).assign_attrs(settings)
    write_spectra_netcdf(dataset, run.path("spectra.nc", what))
    if together is not None:
        _write_species(run, together, version, area)
    if posterior != "none":
        draws = sample_leaf_posterior(spectra, sampler=posterior, settings=how, seed=seed)
        what = "draws of the parameters and of T from the posterior"
        dataset = draws.to_xarray(area).assign_attrs(settings)
        write_spectra_netcdf(dataset, run.path("posterior.nc", what))
    inputs = [*dict.fromkeys(file for file, _ in read), panel, groups]
    said = warnings_of_reading(read, refused, "traits.csv")
    return _result(run, spectra, refused, fit, table, f"PROSPECT-{version}", inputs, said)


def _fit_apart(
    spectra: xr.Dataset,
    settings: LeafSettings,
    checkpoint: str | Path | None,
    workers: Workers | None,
) -> LeafFit:
    """Each leaf fitted by itself, in parts that a checkpoint keeps."""
    journal, count = None, spectra.sizes["spectrum"]
    chunks = LeafChunks(spectra, settings=settings, size=_PART)
    if checkpoint is not None and count > _PART:
        journal = Journal(checkpoint, signature(chunks.parts, settings))
    with stage("Fit leaves", count), at_work(workers) as pool:
        done = dict(
            pool.each(
                LeafChunks.fit, chunks.parts, chunks.setup,
                names=[f"leaves {rows.start + 1} to {rows.stop}" for rows in chunks.rows],
                sizes=[rows.stop - rows.start for rows in chunks.rows],
                journal=journal,
            )
        )  # fmt: skip
    return chunks.join(done.pop(i) for i in range(len(chunks.rows)))


def _write_species(run: Run, species: LeafGroups, version: ProspectVersion, area: LeafArea) -> None:
    """Write the mean leaf and the variants of each species, also as the leaf table of a plot."""
    what = "mean leaf and material variants of each species"
    run.table("species.csv", species.table(run.seed, area), what)
    if version == "D":
        from fynjax.scene import LEAF_FIELDS  # late: the only need of a scene

        drawn = species.table(run.seed).query("variant > 0").rename(columns={"species": "taxon"})
        what = "these variants as the leaf table of a plot"
        run.table("leaves.csv", drawn[["taxon", *LEAF_FIELDS]], what)


def _result(
    run: Run,
    spectra: xr.Dataset,
    refused: Refused,
    fit: LeafFit,
    table: pd.DataFrame,
    model: str,
    inputs: Sequence[str | Path | None],
    warnings: list[str],
) -> FitLeafResult:
    """Write the page, and count the leaves that are fitted without doubt."""
    count = spectra.sizes["spectrum"]
    good = fit.status.count("converged")
    doubtful = count - good
    headline = _headline(spectra, table, good)
    pictures = []
    part = ""
    if count > figures.APART:
        every = figures.all_leaves_figure(fit)
        pictures.append(Picture("all_spectra.png", every, f"all {count} spectra"))
        part = f"{figures.APART} of {count}, evenly drawn from all, which are above."
    fitted = figures.leaf_fit_figure(fit)
    pictures.append(Picture("spectra.png", fitted, "measured and fitted spectra", part))
    shown = Table(
        table.head(_SHOWN), f"Traits, of the first {_SHOWN} spectra at most.", folded=True
    )
    run.pictures("fit-leaf", f"{model} of {count} spectra", headline, [*pictures, shown], inputs)
    return run.result(
        FitLeafResult,
        headline=headline,
        warnings=warnings,
        converged=doubtful == 0,
        status="ok"
        if doubtful == 0 and not refused
        else f"{doubtful} spectra in doubt, {len(refused)} refused: see traits.csv",
        spectra=count,
        converged_spectra=good,
        doubtful_spectra=doubtful,
        refused=refused_spectra(refused),
        repairs=repairs(spectra),
    )


def _headline(spectra: xr.Dataset, table: pd.DataFrame, good: int) -> list[str]:
    """The fit in sentences: of how many spectra it is without doubt, and what else to mind."""
    count = spectra.sizes["spectrum"]
    lines = [f"{good} of {count} spectra fitted without doubt."]
    if good < count:
        lines.append("The others say why in the column status of traits.csv.")
    if repaired := np.count_nonzero(spectra["repairs"].values != ""):
        lines.append(f"{repaired} were repaired while reading, see the column repairs.")
    if decided := np.count_nonzero(table["prior_decides"].fillna("") != ""):
        lines.append(
            f"Of {decided} the prior says more than the spectrum about a trait, see the column "
            "prior_decides."
        )
    return lines

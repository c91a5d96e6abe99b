"""What `fynjax fit-leaf` does: files of spectra in, traits and spectra out."""

import io
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pandas as pd
from jaxtyping import Float

from fynjax._core.checkpoint import Journal, signature
from fynjax._core.errors import InputError
from fynjax._core.parts import Workers, at_work
from fynjax._core.progress import stage
from fynjax.io.spectra import (
    MeasuredSpectrum,
    note,
    posterior_dataset,
    prior_decides,
    read_curve,
    species_table,
    spectra_dataset,
    traits_table,
    write_spectra_netcdf,
    write_traits_csv,
)
from fynjax.io.text import existing_file, read_text
from fynjax.jobs._result import JobResult
from fynjax.jobs._run import Run
from fynjax.jobs._spectra import (
    RefusedSpectrum,
    SpectrumRepair,
    refused_spectra,
    repairs,
    usable_spectra,
    warnings_of_reading,
)
from fynjax.leaf import (
    LARGEST_JUMP,
    AbstractMeasurement,
    FitDomain,
    IntegratingSphere,
    LeafArea,
    LeafChunks,
    LeafClip,
    LeafFit,
    LeafShape,
    LeafStack,
    ProspectVersion,
    area_factors,
    bin_centres,
    correct_detector_jumps,
    fit_leaf_groups,
    regress_water,
    resolved_by_two_readings,
    sample_leaf_posterior,
    to_bins,
    transmittance_from_two_readings,
    usual_measurement,
)
from fynjax.report.figures import leaf_fit_figure
from fynjax.report.pages import Picture

MEASUREMENTS: dict[str, Callable[[], AbstractMeasurement]] = {
    "sphere": IntegratingSphere,
    "leaf-clip": LeafClip,
    "probe": LeafClip,
    "stack": LeafStack,
}
Sampling = Literal["none", "emcee", "nuts"]
"""How the posterior is sampled, if at all."""
_GRID = np.arange(350.0, 2501.0)
_PART = 1024
"""Leaves that are fitted together, in memory of some 130 MB."""
_NOTED_JUMP = 0.005
"""Relative jump between detectors from which on a repair is noted [-]."""


class FitLeafResult(JobResult):
    """Result of `fit_leaf`: how many spectra were fitted, repaired and refused."""

    command: Literal["fit-leaf"] = "fit-leaf"
    spectra: int
    converged_spectra: int
    doubtful_spectra: int
    refused: list[RefusedSpectrum]
    repairs: list[SpectrumRepair]


def _measurement(
    name: str, shape: LeafShape, background: Float[np.ndarray, " band"] | None
) -> AbstractMeasurement:
    """What the instrument records of leaves of a shape over a background on the file's grid.

    Behind the gaps of round leaves lies the light trap of a sphere, or a face that need not be
    black; light goes to and fro between those side by side. A thick pile has no gaps and hides what
    is behind.
    """
    if name not in MEASUREMENTS:
        raise InputError(f"`measurement` must be one of {', '.join(MEASUREMENTS)}, but is {name!r}")
    single = MEASUREMENTS[name]()
    if name == "stack" or (shape == "broad" and background is None):
        return single
    behind: Any = 0.0 if name == "sphere" else None
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


def _transmittances(
    over_black: Float[np.ndarray, "leaf band"],
    first: list[MeasuredSpectrum],
    second: list[MeasuredSpectrum],
    background: Float[np.ndarray, " band"],
) -> Float[np.ndarray, "leaf band"]:
    """T of each leaf from its readings over black and over the background, with a note; NaN where
    the leaf is opaque to the method.

    Readings belong together by name, or by their order if the names differ.
    """
    names = [spectrum.name for spectrum in first]
    by_name = {spectrum.name: spectrum for spectrum in second}
    if set(by_name) == set(names):
        second = [by_name[name] for name in names]
    if len(second) != len(first):
        raise InputError(
            f"each leaf needs a reading over the background, but of {len(first)} leaves there are "
            f"{len(second)}"
        )
    for spectrum in first:
        if spectrum.transmittance is not None:
            raise InputError(
                f"the transmittance of {spectrum.name!r} was measured, so readings over the "
                "background are one too many"
            )
    over = np.stack([_on_grid(spectrum, spectrum.reflectance) for spectrum in second])
    through = np.asarray(transmittance_from_two_readings(over_black, over, background))
    # By bins of the fit: the bands left of a bin would be its brighter ones.
    centres = bin_centres()
    nearest = np.searchsorted((centres[1:] + centres[:-1]) / 2, _GRID, side="right")
    binned = (to_bins(_GRID, values) for values in (over_black, through, background))
    known = resolved_by_two_readings(*binned)[:, nearest]
    inside = (_GRID >= 450.0) & (_GRID <= 2400.0) & np.isfinite(over_black + over + background)
    for spectrum, row, resolved in zip(first, inside, known):
        if not row.any():
            raise InputError(f"the readings of {spectrum.name!r} have no bands in common")
        opaque = (row & ~resolved).sum() / row.sum()
        note(
            spectrum.meta,
            f"transmittance from two readings; too opaque for it at {100 * opaque:.0f} % of bands",
        )
    return np.where(known, through, np.nan)


def _without_jumps(spectrum: MeasuredSpectrum, changes: Sequence[float] | None) -> MeasuredSpectrum:
    """The spectrum with the jumps of its detectors taken out at `changes` [nm], or, if None, where
    the file says that they change."""
    stated = changes is not None
    changes = spectrum.meta.get("splices", []) if changes is None else changes
    if not changes:
        return spectrum
    meta = {**spectrum.meta, "repairs": list(spectrum.meta["repairs"])}
    parts = []
    for values in (spectrum.reflectance, spectrum.transmittance):
        if values is not None:
            values, jumps = correct_detector_jumps(spectrum.wavelength, values, changes)
            for at, jump in zip(changes, jumps):
                if np.isfinite(jump) and abs(jump) > _NOTED_JUMP:
                    what = "taken out" if abs(jump) <= LARGEST_JUMP else "too large, left alone"
                    note(meta, f"detectors change at {at:g} nm: {100 * jump:+.1f} %, {what}")
                if stated and not np.isfinite(jump):
                    note(meta, f"detectors change at {at:g} nm: too few bands beside it to tell")
        parts.append(values)
    return MeasuredSpectrum(spectrum.name, spectrum.wavelength, parts[0], parts[1], meta)


def _read_groups(path: str | Path, names: Sequence[str]) -> list[str]:
    """The species of each spectrum from a table with the columns `name` and `species`."""
    file = existing_file(path, "a table of names and species")
    try:
        table = pd.read_csv(io.StringIO(read_text(file)), dtype=str, keep_default_na=False)
    except (pd.errors.ParserError, pd.errors.EmptyDataError) as error:
        raise InputError(f"expected a table of names and species: {error}", file=path) from error
    for column in ("name", "species"):
        if column not in table:
            raise InputError(
                f"expected the columns name and species, but found {', '.join(table.columns)}",
                file=path,
            )
    twice = table["name"][table["name"].duplicated()]
    if len(twice):
        raise InputError(
            f"the spectrum {twice.iloc[0]!r} is named twice",
            file=path,
            row=int(twice.index[0]) + 2,
            column="name",
        )
    species = dict(zip(table["name"], table["species"]))
    missing = [name for name in names if not species.get(name)]
    if missing:
        raise InputError(
            f"no species for {len(missing)} spectra, the first is {missing[0]!r}; "
            "the column name holds names of spectra, as in traits.csv",
            file=path, column="name",
        )  # fmt: skip
    return [species[name] for name in names]


def _on_grid(spectrum: MeasuredSpectrum, values: np.ndarray | None) -> np.ndarray:
    """The spectrum on 1 nm steps; a band wider than that is spread no further than 25 nm."""
    if values is None:
        return np.full(_GRID.shape, np.nan)
    have = np.isfinite(values)
    if have.sum() < 2:
        return np.full(_GRID.shape, np.nan)
    at = spectrum.wavelength[have]
    result = np.interp(_GRID, at, values[have], left=np.nan, right=np.nan)
    right = np.clip(np.searchsorted(at, _GRID), 1, at.size - 1)
    gap = at[right] - at[right - 1]
    return np.where(gap <= 25.0, result, np.nan)


def _read(
    paths: Sequence[str | Path],
    panel: str | Path | None,
    detector_changes: Sequence[float] | None,
) -> tuple[list[tuple[str, MeasuredSpectrum]], list[tuple[str, str, InputError]]]:
    """`usable_spectra` of files, without the jumps of their detectors."""
    spectra, refused = usable_spectra(paths, panel)
    return [(file, _without_jumps(s, detector_changes)) for file, s in spectra], refused


def fit_leaf(
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
    panel: str | Path | None = None,
    detector_changes: Sequence[float] | None = None,
    groups: str | Path | None = None,
    regression: bool = False,
    posterior: Sampling = "none",
    seed: int = 0,
    checkpoint: str | Path | None = None,
    workers: Workers | None = None,
) -> FitLeafResult:
    """Fit PROSPECT to every leaf spectrum of every file.

    A file or a spectrum that cannot be used does not stop the others: it becomes a row of
    `traits.csv` with the reason as status; the column `repairs` lists the repairs made while
    reading. If none can be used the first reason is raised.

    **Arguments:**

    - `paths`: files of any format that `read_spectra` takes, and folders of them.
    - `output`: folder, made if missing.
    - `version`: "5", "D" or "PRO".
    - `measurement`: "sphere", "leaf-clip", "probe" or "stack", see the classes of
      `fynjax.leaf` for what each identifies.
    - `background`: reflectance behind the leaf of a clip or probe, a number or a file; black by
      default. Where it is missing the leaf's reading is left out.
    - `over_background`: files of second readings of the same leaves, over `background`; those of
      `paths` are then over black, and transmittance follows from both
      (`transmittance_from_two_readings`).
    - `leaf_shape`: "broad", "needle" (single or apart), "mat" (needles side by side) or "culm"
      (likewise). Single needles reflect more at their surface. Round leaves leave gaps: where
      transmittance was measured their part of the field of view is estimated, of a leaf clip also
      what lies behind, and of mats and culms the recollision probability (`recollided`).
    - `area`: what contents are stated per in all tables, "projected" or "half_total", see
      `fynjax.leaf.area_factors`.
    - `domain`: "full" or "optimal".
    - `panel`: file of the white panel's own reflectance, for spectra relative to it; those of ASD
      files that hold it are absolute already.
    - `detector_changes`: wavelengths where detectors change [nm], at which jumps are taken out of
      all spectra, see `correct_detector_jumps`; `None` for those that an ASD file states.
    - `groups`: a CSV with the columns `name` (of a spectrum) and `species`: leaves of a species are
      fitted together, and `species.csv` holds the mean leaf and five material variants of each.
    - `regression`: whether to correct water by `regress_water`: all spectra must be of one
      campaign. Not with `groups`, a posterior, or the domain "optimal".
    - `posterior`: "none", or sample it by "emcee" or "nuts" into `posterior.nc`.
    - `seed`: seed of the posterior's random numbers; the fit itself draws none.
    - `checkpoint`: folder that keeps what each 1024 leaves of a larger table gave, from which an
      interrupted run goes on; none by default. Leaves that are fitted together (`groups`), and
      posteriors, are not kept.
    - `workers`: where chunks of 1024 leaves are fitted; in this process by default. Leaves that
      are fitted together (`groups`), and posteriors, stay there.

    **Returns:** `FitLeafResult`. Writes `traits.csv`, `spectra.nc` and a figure into `output`, and
    where asked for `species.csv` and `posterior.nc`.

    **Raises:** `InputError` if no file holds a usable spectrum, or the table of groups is wrong,
    or for an unknown measurement, or a checkpoint of another run; `MissingExtraError` for a sampler
    not installed.

    Example: `jobs.fit_leaf(["leaves.csv"], "results", version="PRO")`.
    """
    if regression and (groups is not None or posterior != "none" or domain != "full"):
        raise InputError(
            "`regression` corrects leaves that are fitted one by one over all wavelengths, so it "
            'goes with neither `groups`, nor a posterior, nor the domain "optimal"'
        )
    behind = None if background is None else _background(background, measurement)
    if over_background and behind is None:
        raise InputError("readings over a background need its reflectance, `background`")
    instrument = _measurement(measurement, leaf_shape, None if over_background else behind)
    factors = area_factors(area, leaf_shape)
    spectra, refused = _read(paths, panel, detector_changes)
    r = np.stack([_on_grid(s, s.reflectance) for _, s in spectra])
    t = np.stack([_on_grid(s, s.transmittance) for _, s in spectra])
    if over_background and behind is not None:
        second, bad = _read(over_background, panel, detector_changes)
        if bad:
            raise bad[0][2]
        t = _transmittances(r, [s for _, s in spectra], [s for _, s in second], behind)
    elif behind is not None:
        r = np.where(np.isfinite(behind), r, np.nan)
    files, names = [f for f, _ in spectra], [s.name for _, s in spectra]
    run = Run(output, seed=seed)
    options: dict[str, Any] = {
        "version": version, "measurement": instrument, "leaf_shape": leaf_shape, "domain": domain
    }  # fmt: skip
    together = None
    if groups is not None:
        together = fit_leaf_groups(_GRID, r, t, groups=_read_groups(groups, names), **options)
        fit = together.leaves
    else:
        journal = None
        if checkpoint is not None and len(r) > _PART:
            journal = Journal(checkpoint, signature(r, t, options))
        chunks = LeafChunks(_GRID, r, t, size=_PART, **options)
        with stage("Fit leaves", len(r)), at_work(workers) as pool:
            done = dict(
                pool.each(
                    LeafChunks.fit, chunks.parts, chunks.setup,
                    names=[f"leaves {rows.start + 1} to {rows.stop}" for rows in chunks.rows],
                    sizes=[rows.stop - rows.start for rows in chunks.rows],
                    journal=journal,
                )
            )  # fmt: skip
        fit = chunks.join(done.pop(i) for i in range(len(chunks.rows)))
    if regression:
        fit = regress_water(fit)
    settings = {
        "prospect_version": version,
        "regression": "water" if regression else "none",
        "measurement": measurement,
        "leaf_shape": leaf_shape,
        "area": area,
        "domain": domain,
        "seed": str(seed),
    }
    table = traits_table(fit, files, names, area, factors)
    table["repairs"] = ["; ".join(s.meta["repairs"]) for _, s in spectra]
    if refused:
        rows = [{"file": f, "name": n, "status": f"refused: {e}"} for f, n, e in refused]
        table = pd.concat([table, pd.DataFrame(rows)], ignore_index=True)
    what = "parameters, deviations, 90 % intervals and status of each spectrum"
    write_traits_csv(table, run.path("traits.csv", what))
    what = "measured, fitted and predicted R and T on the fit's bins"
    dataset = spectra_dataset(fit, files, names, settings, factors)
    write_spectra_netcdf(dataset, run.path("spectra.nc", what))
    run.picture(Picture("spectra.png", leaf_fit_figure(fit, names), "measured and fitted spectra"))
    if together is not None:
        what = "mean leaf and material variants of each species"
        leaves = species_table(together, seed, area, factors)
        write_traits_csv(leaves, run.path("species.csv", what))
    if posterior != "none":
        draws = sample_leaf_posterior(_GRID, r, t, sampler=posterior, seed=seed, **options)
        what = "draws of the parameters and of T from the posterior"
        dataset = posterior_dataset(draws, fit, files, names, settings, factors)
        write_spectra_netcdf(dataset, run.path("posterior.nc", what))
    return _result(run, fit, spectra, refused, regression)


def _result(
    run: Run,
    fit: LeafFit,
    spectra: list[tuple[str, MeasuredSpectrum]],
    refused: list[tuple[str, str, InputError]],
    regression: bool,
) -> FitLeafResult:
    good = fit.status.count("converged")
    headline = [f"{good} of {len(spectra)} spectra fitted without doubt."]
    if good < len(spectra):
        headline.append("The others say why in the column status of traits.csv.")
    if regression:
        headline.append("Water is corrected by regression, as of leaves of one campaign.")
    repaired = sum(bool(s.meta["repairs"]) for _, s in spectra)
    if repaired:
        headline.append(f"{repaired} were repaired while reading, see the column repairs.")
    decided = sum(bool(names) for names in prior_decides(fit))
    if decided:
        headline.append(
            f"Of {decided} the prior says more than the spectrum about a trait, see the column "
            "prior_decides."
        )
    return run.result(
        FitLeafResult,
        headline=headline,
        warnings=warnings_of_reading(spectra, refused, "traits.csv"),
        converged=good == len(spectra),
        status="ok"
        if good == len(spectra) and not refused
        else f"{len(spectra) - good} spectra in doubt, {len(refused)} refused: see traits.csv",
        spectra=len(spectra),
        converged_spectra=good,
        doubtful_spectra=len(spectra) - good,
        refused=refused_spectra(refused),
        repairs=repairs(spectra),
    )

"""Leaves of a plot's taxa from folders of measured spectra: fitted once, and kept."""

import hashlib
import json
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import pandas as pd

from fynjax import __version__
from fynjax._core.compiler import cache_folder
from fynjax._core.dry_run import rehearsing
from fynjax._core.errors import InputError
from fynjax.io.plot import Plot
from fynjax.io.raster import file_hash
from fynjax.io.spectra import read_spectra
from fynjax.io.text import write_text
from fynjax.leaf import (
    MEASUREMENTS,
    AbstractMeasurement,
    LeafChunks,
    LeafFit,
    LeafSettings,
    fit_leaf,
    usual_measurement,
)
from fynjax.scene import LEAF_FIELDS, USUAL_LEAF, LeafRow


def leaf_instrument(plot: Plot) -> AbstractMeasurement:
    """Kind of measurement of the leaf spectra of a plot, as its file says."""
    single = MEASUREMENTS[plot.leaf_measurement]()
    if plot.leaf_background is None:
        return single
    return usual_measurement("broad", plot.leaf_background, single.offset_deviation)


def fit_or_check(*spectra: Any, instrument: AbstractMeasurement) -> LeafFit | None:
    """`fit_leaf` of spectra; in a dry run None, once they are checked."""
    if not rehearsing():
        return fit_leaf(*spectra, measurement=instrument)
    LeafChunks(*spectra, settings=LeafSettings(measurement=instrument))
    return None


def measured_leaves(plot: Plot) -> list[LeafRow]:
    """The mean leaf of each taxon that has files of spectra, by PROSPECT fitted to all of them.

    Fits are kept in the cache of compiled programs, by the content of the files.

    **Arguments:** `plot`, as `read_plot` gives it.

    **Raises:** `InputError` for a taxon of which no spectrum can be used. Warns of single ones.
    """
    files = plot.leaf_files
    if not files:
        return []
    how = [plot.leaf_measurement, plot.leaf_background]
    # By content, not by name: a file that was changed is fitted anew.
    content = [__version__, how, [(taxon, [*map(file_hash, own)]) for taxon, own in files.items()]]
    name = hashlib.sha256(json.dumps(content).encode()).hexdigest()
    kept = cache_folder() / "leaves" / f"{name}.json"
    found = None
    with suppress(OSError, ValueError):
        found = json.loads(kept.read_text("utf-8"))
    if found is None:
        found = _fitted(files, leaf_instrument(plot))
        if rehearsing():
            return [USUAL_LEAF.replace(taxon=taxon) for taxon in files]
        with suppress(OSError):  # a home that cannot be written costs the fit, nothing else
            kept.parent.mkdir(parents=True, exist_ok=True)
            write_text(kept, json.dumps(found))
    return [USUAL_LEAF.replace(taxon=taxon, **found[taxon]) for taxon in files]


def _fitted(
    files: Mapping[str, Sequence[Path]], instrument: AbstractMeasurement
) -> dict[str, dict[str, float]]:
    """Means of the leaf traits of each taxon over its leaves; those of doubtful fits count only
    where there are no others. None in a dry run, which reads and checks the spectra."""
    taxon_of = {str(file): taxon for taxon, own in files.items() for file in own}
    spectra = read_spectra(list(taxon_of))
    fit = fit_or_check(spectra, instrument=instrument)
    taxon = pd.Series([taxon_of[file] for file in spectra["file"].values])
    for one, own in files.items():
        if not (taxon == one).any():
            raise InputError(f"no leaf spectrum of {one!r} can be used", file=own[0])
    if fit is None:
        return {}
    traits = pd.DataFrame({name: getattr(fit.parameters, name) for name in LEAF_FIELDS})
    good = pd.Series([status == "converged" for status in fit.status])
    # Doubtful fits count only where a taxon has no others.
    counts = good | ~good.groupby(taxon).transform("any")
    means = traits[counts].groupby(taxon[counts]).mean()
    return {one: dict(zip(LEAF_FIELDS, means.loc[[one]].to_numpy()[0].tolist())) for one in files}

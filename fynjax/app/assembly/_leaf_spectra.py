"""Leaves of a plot's taxa from folders of measured spectra: fitted once, and kept."""

import json
import warnings
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool

from fynjax._core.dry_run import rehearsing
from fynjax._core.errors import LARGEST, InputError
from fynjax._core.store import Store, code_hash
from fynjax.app.io.plot import Plot
from fynjax.app.io.raster import file_hash
from fynjax.app.io.spectra import measured_dataset, usable_spectra, warnings_of_reading
from fynjax.leaf import (
    LEAF_PARAMETERS,
    MEASUREMENTS,
    AbstractMeasurement,
    LeafChunks,
    LeafFit,
    LeafSettings,
    fit_leaf,
    species_prior,
    usual_measurement,
)
from fynjax.scene import LEAF_FIELDS, USUAL_LEAF, LeafRow

_KEPT = Store("leaves", largest=1 << 26, entry=1 << 22)
_CODE = "_core", "leaf", "app/io/spectra", "app/assembly/_leaf_spectra.py"
"""What fits are made by: after a change of it they are made anew."""


class MeanLeaf(NamedTuple):
    """Mean leaf of a taxon by PROSPECT fits of its spectra, with its uncertainty."""

    traits: dict[str, float]
    """Means of `LEAF_FIELDS`."""
    spread: dict[str, float]
    """Relative standard deviations of these (`fynjax.leaf.species_prior`)."""
    said: list[str]
    """Doubts about the fits, in sentences."""


class MeasuredLeaves(NamedTuple):
    """The leaves of the taxa of a plot that were measured."""

    rows: list[LeafRow]
    """The mean leaf of each taxon."""
    spreads: dict[str, float]
    """Relative standard deviations of their priors by the names of parameters, as of
    `fynjax.scene.table_spreads`."""


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


def mean_leaf(fit: LeafFit, own: Bool[np.ndarray, " leaf"], whose: str) -> MeanLeaf | None:
    """The mean of fitted leaves, of which those in doubt count only where there are no others.

    **Arguments:** `fit`; `own`, which of its leaves; `whose` they are, for the doubts.

    **Returns:** None where none of the leaves could be fitted.
    """
    status = np.array(fit.status)
    fitted = own & np.isfinite(fit.rmse)
    if not fitted.any():
        return None
    good = own & (status == "converged")
    counts = good if good.any() else fitted
    said = []
    if (doubted := own & ~good).any():
        kinds = Counter(status[doubted].tolist()).most_common()
        reasons = "; ".join(f"{number} {text}" for text, number in kinds)
        name = fit.labels[int(np.argmax(doubted))]
        what = (
            f"they are left out of the mean of the other {good.sum()}"
            if good.any()
            else "they are used, since there are no others"
        )
        said.append(
            f"{doubted.sum()} of {own.sum()} leaf spectra of {whose} are fitted in doubt, such as "
            f"{name!r} ({reasons}): {what}"
        )
    means = {
        name: float(np.mean(np.asarray(getattr(fit.parameters, name))[counts]))
        for name in LEAF_FIELDS
    }
    return MeanLeaf(means, species_prior(fit, counts), said)


def measured_leaves(plot: Plot) -> MeasuredLeaves:
    """The mean leaf of each taxon that has files of spectra, by PROSPECT fitted to all of them, and
    how well it is known.

    Fits are kept (`fynjax._core.store`), by the content of the files and the code that makes them,
    with what was to be said of them.

    **Arguments:** `plot`, as `read_plot` gives it.

    **Raises:** `InputError` for a taxon of which no spectrum can be used. Warns of single ones, and
    of fits in doubt, also where they are kept.
    """
    files = plot.leaf_files
    if not files:
        return MeasuredLeaves([], {})
    how = [plot.leaf_measurement, plot.leaf_background, version("jax"), str(jnp.zeros(0).dtype)]
    # By content, not by name: a file that was changed is fitted anew. By name too, which the
    # warnings have.
    content = [
        code_hash(*_CODE), how,
        [(taxon, [(file.name, file_hash(file)) for file in own]) for taxon, own in files.items()],
    ]  # fmt: skip
    key = json.dumps(content)
    kept = _KEPT.get(key)
    found = None if kept is None else _whole(kept, files)
    if found is None:
        found = _fitted(files, leaf_instrument(plot))
        if not rehearsing():
            _KEPT.put(key, json.dumps(found).encode())
    for sentence in found["said"]:
        warnings.warn(sentence, stacklevel=2)
    leaves = found["leaves"]
    if rehearsing() and not leaves:
        return MeasuredLeaves([USUAL_LEAF.replace(taxon=taxon) for taxon in files], {})
    return MeasuredLeaves(
        [USUAL_LEAF.replace(taxon=taxon, **leaves[taxon]["traits"]) for taxon in files],
        {
            f"species.{taxon}.leaf.{trait}": sd
            for taxon in files
            for trait, sd in leaves[taxon]["spread"].items()
        },
    )


def _whole(kept: bytes, taxa: Iterable[str]) -> dict[str, Any] | None:
    """The kept fits of the leaves of `taxa`, as `_fitted` gives them; None where `kept` is damaged,
    lacks a taxon or has a number that no leaf can have."""
    try:
        found = json.loads(kept)
        said = found["said"]
        leaves = [found["leaves"][taxon] for taxon in taxa]
        traits = [(name, float(leaf["traits"][name])) for leaf in leaves for name in LEAF_FIELDS]
        spreads = [float(sd) for leaf in leaves for sd in leaf["spread"].values()]
        plain = isinstance(said, list) and all(isinstance(text, str) for text in said)
    except (AttributeError, LookupError, TypeError, ValueError, RecursionError):
        return None
    inside = all(LEAF_PARAMETERS[name].contains(value) for name, value in traits)
    known = all(0.0 <= sd < LARGEST for sd in spreads)
    return found if inside and known and plain else None


def _fitted(files: Mapping[str, Sequence[Path]], instrument: AbstractMeasurement) -> dict[str, Any]:
    """Mean traits of each taxon's leaves and their relative standard deviations [-], by fits of the
    spectra in its `files`, and warnings about spectra and fits. A dry run fits none: it reads and
    checks the spectra."""
    taxon_of = {str(file): taxon for taxon, own in files.items() for file in own}
    read, refused = usable_spectra(list(taxon_of))
    said, spectra = warnings_of_reading(read, refused), measured_dataset(read, {})
    fit = fit_or_check(spectra, instrument=instrument)
    taxon = np.array([taxon_of[file] for file in spectra["file"].values])
    leaves = {}
    for one, own in files.items():
        of_taxon = taxon == one
        found = None if fit is None or not of_taxon.any() else mean_leaf(fit, of_taxon, one)
        if not of_taxon.any() or (fit is not None and found is None):
            for sentence in said:
                warnings.warn(sentence, stacklevel=3)
            raise InputError(f"no leaf spectrum of {one!r} can be used", file=own[0])
        if found is not None:
            said += found.said
            leaves[one] = {"traits": found.traits, "spread": found.spread}
    return {"leaves": leaves, "said": said}

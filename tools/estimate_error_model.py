"""Recipe of `error_model.csv.gz` and `trait_model.csv`: what five campaigns say of PROSPECT-D.

Run `python -m tools.estimate_error_model FOLDER [OUTPUT]` with the folder that holds
`angers_spectra.npz`, `angers_chemistry.csv.gz` and the same of the others; the tables are written
into the folder OUTPUT (default: `fynjax/leaf/data`).

*Covariance of spectra*, of the sets with transmittance: for each leaf the measured pigments, water
and dry matter are put into PROSPECT-D; N, the anthocyanins, what was not measured and, of needles,
the gaps and the recollision between them are fitted to R and T, and what remains is the model's
error. LOPEX enters with the mean of its five spectra a sample, NASA FFT as two sets, broad leaves
and mats of needles.

*Correlation of traits*: of the logarithms within a set, the mean over k sets times k / (k + 1),
since they differ from set to set. How the sets' means lie to each other is left out: a prior with
that tripled the relative error of dry matter in ANGERS, whose leaves are thin for their N.

*Discrepancy of traits*: each campaign is fitted with the covariance and correlation of the others.
How it grows with dry matter is the most likely under Student errors. How large it is: sets differ
in the size of their errors, by a laboratory, a sphere, a notion of leaf area; the logarithms of
their sizes are a random effect whose standard deviation is pooled over traits, and the next set's
has a Student distribution of as many degrees of freedom as sets less traits. The discrepancy is
what makes 90 % intervals hold nine of ten measured values on the average over such sets to come.

*Dry matter from R alone*: how far dry matter of R and T is moved towards that of R alone, see
`reflectance_share`, before its discrepancy is estimated.

*Share of species*: in the same fits, the mean product of the errors of two leaves of a species over
the mean square, a mean over sets.
"""

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import get_args

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
from jaxtyping import Float
from scipy.optimize import brentq, minimize_scalar
from scipy.stats import t as student

from fynjax._core.precision import double_precision
from fynjax.leaf._area import LeafShape
from fynjax.leaf._coefficients import CONSTITUENTS
from fynjax.leaf._error_model import (
    POPULATION_TRAITS,
    ErrorModel,
    bin_centres,
    default_error_model,
    distrust,
    to_bins,
)
from fynjax.leaf._fit import NINETY_PERCENT, fit_leaf, thickness
from fynjax.leaf._measurement import AbstractMeasurement, usual_measurement
from fynjax.leaf._problem import LeafSettings, leaf_bounds, leaf_problems, make_setup
from fynjax.leaf._residual import MeasuredLeaf, observed, solve, to_physical, to_unconstrained

DATA = Path(__file__).resolve().parents[1] / "fynjax" / "leaf" / "data"
CAMPAIGNS = ("angers", "lopex", "nasa_fft", "california_asd", "divittorio_needle")
CHEMISTRY = {"chlorophyll": "cab", "carotenoids": "car", "water": "ewt", "dry_matter": "lma"}
"""Column of each trait that laboratories measured."""
_CALIFORNIAN_CONIFERS = ("ABCO", "CADE", "PILA", "PIPO")
"""Codes of USDA PLANTS: fir, incense cedar and two pines, whose needles lie side by side."""


@dataclass(frozen=True, eq=False)
class LeafSet:
    """Leaves of one campaign and one shape."""

    campaign: str
    shape: LeafShape
    spectra: np.ndarray
    """R and T on `bin_centres()` [leaf, 2, bin]; NaN where missing [-]."""
    chemistry: pd.DataFrame
    """What the laboratory measured, and what the campaign says of each leaf."""

    @property
    def name(self) -> str:
        """Campaign and shape."""
        return f"{self.campaign} {self.shape}"

    def measured(self, trait: str) -> np.ndarray:
        """The trait in the unit of `LeafParameters` [leaf]; NaN where it was not measured, or is
        too small for its logarithm to mean anything."""
        key = CHEMISTRY.get(trait, "")
        if key not in self.chemistry:
            return np.full(len(self.spectra), np.nan)
        values = self.chemistry[key].to_numpy(float)
        least = 1e-4 if trait in ("water", "dry_matter") else 0.05
        return np.where(values > least, values, np.nan)

    def species(self) -> np.ndarray:
        """Name or code of the species of each leaf."""
        column = "species" if "species" in self.chemistry else "species_code"
        return self.chemistry[column].astype(str).to_numpy()

    def measurement(self) -> AbstractMeasurement:
        """Needles leave gaps that differ from sample to sample, and in mats have neighbours."""
        return usual_measurement(self.shape)


@cache
def read(folder: Path, campaign: str) -> tuple[LeafSet, ...]:
    """The sets of a campaign, from its two files in `folder`."""
    with np.load(folder / f"{campaign}_spectra.npz") as stored:
        ids, wavelength = stored["id"], stored["wl"].astype(float)
        parts = [stored[key].astype(float) for key in ("refl", "tran") if key in stored]
    parts = [s.mean(1) if s.ndim == 3 else s for s in parts]
    parts += [np.full_like(parts[0], np.nan)] * (2 - len(parts))
    data = np.stack([to_bins(wavelength, s) for s in parts], axis=1)
    chemistry = pd.read_csv(folder / f"{campaign}_chemistry.csv.gz").set_index("id").loc[ids]
    if campaign == "california_asd":
        # The set's EWT is LMA times the water content of fresh mass, no water per area.
        content = chemistry["water_pct"] / 100.0
        chemistry["ewt"] = chemistry["lma"] * content / (1.0 - content)
    shapes = np.full(len(ids), "needle" if campaign == "divittorio_needle" else "broad")
    if "conifer" in chemistry:
        shapes[chemistry["conifer"].to_numpy() == 1] = "mat"
    if campaign == "california_asd":
        shapes[chemistry["species_code"].isin(_CALIFORNIAN_CONIFERS)] = "mat"
    return tuple(
        LeafSet(campaign, shape, data[shapes == shape], chemistry[shapes == shape])
        for shape in get_args(LeafShape)
        if np.any(shapes == shape)
    )


@cache
def at_measured_chemistry(leaves: LeafSet) -> tuple[np.ndarray, np.ndarray]:
    """Measured minus modelled R and T [leaf, 2, bin], and logarithms of `POPULATION_TRAITS` [leaf,
    trait], of which N is fitted and NaN without transmittance."""
    names = ("structure", *CONSTITUENTS["D"])
    model = independent_error_model(0.015)
    setup = make_setup(
        LeafSettings("D", leaves.measurement(), leaves.shape, free=names, error_model=model)
    )
    count = len(leaves.spectra)
    extra = len(setup.names) - len(names)
    known = np.tile([1.5, 40.0, 8.0, 1.0, 1e-3, 0.01, 0.009, *[0.05] * extra], (count, 1))
    precision = np.tile([0.1, 0.1, 0.1, 0.5, 1e3, 0.1, 0.1, *[1.0] * extra], (count, 1))
    for trait in CHEMISTRY:
        values, column = leaves.measured(trait), names.index(trait)
        have = np.isfinite(values)
        known[have, column], precision[have, column] = values[have], 1e6
    optics = setup.optics
    z = np.asarray(to_unconstrained(jnp.asarray(known), optics))
    inside = (bin_centres() >= 445) & (bin_centres() <= 2405)
    use = np.isfinite(leaves.spectra) & inside
    prior = (z, precision[:, :, None] * np.eye(len(setup.names)))
    problems = leaf_problems(setup, leaves.spectra, use, prior, np.ones(count))
    none = np.zeros_like(setup.factors)
    logits = np.concatenate([
        solve(z[at], MeasuredLeaf(*(part[at] for part in problems)), none, optics).z
        for at in (slice(i, i + 128) for i in range(0, count, 128))
    ])  # fmt: skip
    fitted = jax.vmap(lambda z: observed(to_physical(z, optics), optics))(logits)
    layers = np.asarray(to_physical(jnp.asarray(logits), optics))[:, 0]
    seen = use[:, 1].any(1) & np.isfinite(leaves.measured("dry_matter"))
    traits = [leaves.measured(trait) for trait in POPULATION_TRAITS]
    traits[0] = np.where(seen, layers, np.nan)
    return np.where(use, leaves.spectra - np.asarray(fitted), np.nan), np.log(np.stack(traits, 1))


def correlation(tables: Sequence[np.ndarray]) -> np.ndarray:
    """Correlation [trait, trait] of the columns of tables, from what is there.

    Correlations of pairs from different leaves need not fit together: eigenvalues are at least
    0.05.
    """
    count = tables[0].shape[1]
    result = np.eye(count)
    for i in range(count):
        for j in range(i):
            pairs = [table[np.isfinite(table[:, [i, j]]).all(1)] for table in tables]
            within = [np.corrcoef(pair[:, i], pair[:, j])[0, 1] for pair in pairs if len(pair) > 9]
            result[i, j] = result[j, i] = np.sum(within) / (len(within) + 1)
    sizes, directions = np.linalg.eigh(result)
    result = (directions * np.maximum(sizes, 0.05)) @ directions.T
    return result / np.sqrt(np.outer(np.diag(result), np.diag(result)))


@double_precision
def estimate_error_model(
    residual_sets: Sequence[Float[np.ndarray, "leaf 2 bin"]],
    factors: int = 40,
    own_share: float = 0.5,
    trait_correlation: Float[np.ndarray, "trait trait"] | None = None,
    trait_discrepancy: Float[np.ndarray, "trait 2"] | None = None,
    species_share: Float[np.ndarray, " trait"] | None = None,
    reflectance_share: float = 0.0,
) -> ErrorModel:
    """Factors of the discrepancy between PROSPECT and measured leaves of several data sets.

    Half of the covariance is the mean second moment of the residuals (each set counts the same, and
    about zero: a mean misfit of one set is an error another set need not share; a leaf counts as
    no more than 2.5 times the median size, so that a few do not make the model). The other half is
    a Gaussian process of the same variance with correlation lengths of 15, 60 and 300 nm (weights
    0.2, 0.4, 0.4), which covers errors of leaves from other data sets; without it the intervals
    are too narrow on every other set. Variances outside 450-2400 nm are those of the nearest band.

    **Arguments:**

    - `residual_sets`: for each data set measured minus modelled R (first) and T [leaf, 2, bin] on
      `bin_centres()` [-], NaN if missing.
    - `factors`: how many principal factors to keep; the rest becomes independent noise.
    - `own_share`: weight of the empirical covariance of the sets, 0 to 1; the rest is the weight of
      the Gaussian process.
    - `trait_correlation`, `trait_discrepancy`, `species_share`, `reflectance_share`: fields of the
      model; none, a quarter, 0.4 and 0 by default.

    **Returns:** `ErrorModel` on `bin_centres()`. NumPy; not differentiable.
    """
    centres = bin_centres()
    used = (centres >= 440.0) & (centres <= 2410.0)
    moments, sets = np.zeros((2, 2 * centres.size, 2 * centres.size))
    for residuals in residual_sets:
        flat = np.where(used, residuals, np.nan).reshape(len(residuals), -1)
        known = np.isfinite(flat)
        filled = np.where(known, flat, 0.0)
        size = np.sqrt((filled**2).sum(1) / np.maximum(known.sum(1), 1))
        filled *= np.minimum(1.0, 2.5 * np.median(size) / np.maximum(size, 1e-9))[:, None]
        pairs = known.T.astype(float) @ known
        moments += filled.T @ filled / np.maximum(pairs, 1.0)
        sets += pairs > 0
    empirical = moments / np.maximum(sets, 1.0)
    inner = (centres >= 450.0) & (centres <= 2400.0)
    distance2 = (centres[:, None] - centres) ** 2
    lengths = ((0.2, 15.0), (0.4, 60.0), (0.4, 300.0))
    correlation = sum(w * np.exp(-distance2 / (2.0 * length**2)) for w, length in lengths)
    smooth = np.zeros_like(empirical)
    bins = centres.size
    for part in range(2):
        block = slice(part * bins, (part + 1) * bins)
        variance = np.maximum(np.diag(empirical)[block], 1e-5)
        variance = np.interp(centres, centres[inner], variance[inner])
        near = np.exp(-distance2 / (2.0 * 60.0**2))
        variance = near @ variance / near.sum(1)
        smooth[block, block] = correlation * np.sqrt(np.outer(variance, variance))
    total = own_share * empirical + (1.0 - own_share) * smooth
    sizes, directions = np.linalg.eigh(total)
    sizes, directions = sizes[::-1][:factors], directions[:, ::-1][:, :factors]
    loadings = (directions * np.sqrt(np.maximum(sizes, 0.0))).T
    noise = np.sqrt(np.maximum(np.diag(total) - (loadings**2).sum(0), 0.0) + 1e-3**2)
    return ErrorModel(
        loadings[:, :bins],
        loadings[:, bins:],
        noise[:bins],
        noise[bins:],
        distrust(),
        np.eye(len(POPULATION_TRAITS)) if trait_correlation is None else trait_correlation,
        _assumed_discrepancy() if trait_discrepancy is None else trait_discrepancy,
        _assumed_share() if species_share is None else species_share,
        reflectance_share,
    )


def _assumed_discrepancy() -> Float[np.ndarray, "trait 2"]:
    """A quarter of every trait that a laboratory measures; nobody measures N."""
    assumed = np.tile([np.log(0.25), 0.0], (len(POPULATION_TRAITS), 1))
    assumed[POPULATION_TRAITS.index("structure"), 0] = -np.inf
    return assumed


def _assumed_share() -> Float[np.ndarray, " trait"]:
    """About the mean over the traits and campaigns of the package's model."""
    return np.full(len(POPULATION_TRAITS), 0.4)


def independent_error_model(standard_deviation: float = 0.01) -> ErrorModel:
    """Independent noise, the same at all bins: the assumption of older tools, for comparison.

    Its intervals are far too narrow for real leaves.

    **Arguments:** `standard_deviation` of R and of T at every bin [-].

    **Returns:** `ErrorModel` without factors.
    """
    bins = bin_centres().size
    # As many factors as the default has, so that the compiled programs of the fit are shared.
    none = np.zeros_like(default_error_model().reflectance_factors)
    flat = np.full(bins, standard_deviation)
    return ErrorModel(
        none,
        none,
        flat,
        flat,
        np.zeros(bins),
        np.eye(len(POPULATION_TRAITS)),
        _assumed_discrepancy(),
        _assumed_share(),
        0.0,
    )


_NO_DISCREPANCY = np.tile([-np.inf, 0.0], (len(POPULATION_TRAITS), 1))


def estimate_spectral(sets: Sequence[LeafSet]) -> ErrorModel:
    """The error model of some sets, as if spectra said of traits all that laboratories measure."""
    parts = [at_measured_chemistry(leaves) for leaves in sets]
    return estimate_error_model(
        [rest for rest, _ in parts if np.isfinite(rest[:, 1]).any()],
        trait_correlation=correlation([traits for _, traits in parts]),
        trait_discrepancy=_NO_DISCREPANCY,
    )


def trait_errors(leaves: LeafSet, model: ErrorModel) -> dict[str, list[np.ndarray]]:
    """Of each measured trait an array [leaf, 5] for R, and for R and T: error of the fit in the
    logit, its variance from the spectrum, inflation, `thickness`, and number of the species."""
    result: dict[str, list[np.ndarray]] = {}
    species = np.unique(leaves.species(), return_inverse=True)[1]
    both = np.isfinite(leaves.spectra[:, 1]).any()
    for through in (None, leaves.spectra[:, 1]) if both else (None,):
        fit = fit_leaf(
            bin_centres(), leaves.spectra[:, 0], through,
            measurement=leaves.measurement(), leaf_shape=leaves.shape, error_model=model,
        )  # fmt: skip
        for trait in CHEMISTRY:
            truth, low_high = leaves.measured(trait), leaf_bounds([trait])[0]
            have = np.isfinite(truth) & fit.converged
            if not have.any():
                continue
            value = np.asarray(getattr(fit.parameters, trait))
            at = fit.names.index(trait)
            unit = [(v - low_high[0]) / np.ptp(low_high) for v in (truth, value)]
            logit = [np.log(u / (1.0 - u)) for u in unit]
            slope = np.ptp(low_high) * unit[1] * (1.0 - unit[1])
            variance = (fit.standard_deviation[:, at] / slope) ** 2
            thick = thickness(np.asarray(fit.parameters.dry_matter))
            grown = np.minimum(fit.inflation, 10.0)
            columns = (logit[0] - logit[1], variance, grown, thick, species)
            result.setdefault(trait, []).append(np.stack(columns, 1)[have])
    return result


def discrepancy(errors: Sequence[dict[str, list[np.ndarray]]]) -> np.ndarray:
    """`ErrorModel.trait_discrepancy` from errors of sets that the model was not estimated from."""
    table = _NO_DISCREPANCY.copy()
    parts, sizes = {}, {}
    for row, trait in enumerate(POPULATION_TRAITS):
        parts[row] = [np.concatenate(of[trait]) for of in errors if trait in of]
        if parts[row]:
            table[row] = _level_and_slope(parts[row], trait in ("water", "dry_matter"))
            sizes[row] = np.array([_size(part, *table[row]) for part in parts[row]])
    freedom = sum(len(of) - 1 for of in sizes.values())
    if freedom == 0:
        return table
    spread = np.sqrt(sum(len(of) * of.var() for of in sizes.values()) / freedom)
    for row, of in sizes.items():
        next_set = student.ppf((np.arange(50) + 0.5) / 50, freedom) * spread
        next_set *= np.sqrt(1.0 + 1.0 / len(of))
        table[row, 0] = _level_of_next_set(parts[row], of, table[row, 1], next_set)
    return table


def _deviation(part: np.ndarray, level: float, slope: float) -> np.ndarray:
    """Standard deviation of the errors of a set [leaf, 5] with that discrepancy."""
    _, variance, inflation, thick = part[:, :4].T
    return np.sqrt(variance + inflation * np.exp(2.0 * (level + slope * thick)))


def _size(part: np.ndarray, level: float, slope: float) -> float:
    """Logarithm by how much nine of ten errors of a set are larger than its intervals."""
    ratio = np.abs(part[:, 0]) / _deviation(part, level, slope)
    return float(np.log(np.quantile(ratio, 0.9) / NINETY_PERCENT))


_LEAST, _MOST = np.log(0.01), np.log(5.0)


def _level_of_next_set(
    parts: Sequence[np.ndarray], sizes: np.ndarray, slope: float, next_set: np.ndarray
) -> float:
    """Level at which nine of ten intervals hold on the average over sets to come: those there are,
    each as if its errors had the sizes (logarithms about the mean) in `next_set`."""

    def short(level: float) -> float:
        inside = []
        for part, size in zip(parts, sizes):
            ratio = np.sort(np.abs(part[:, 0]) / _deviation(part, level, slope))
            limit = NINETY_PERCENT * np.exp(size - sizes.mean() - next_set)
            inside.append(np.mean(np.searchsorted(ratio, limit)) / ratio.size)
        return float(np.mean(inside)) - 0.9

    return brentq(short, _LEAST, _MOST) if short(_LEAST) < 0 else _LEAST


def _level_and_slope(parts: Sequence[np.ndarray], grows: bool) -> tuple[float, float]:
    """Discrepancy of one trait at which nine of ten intervals hold in these sets [leaf, 5], which
    count the same.

    The slope, where there may be one, has a prior of 0 +- 0.3, and each set counts as ten leaves:
    leaves of a campaign share much of their error.
    """
    weight = np.concatenate([np.full(len(p), 1.0 / len(p) / len(parts)) for p in parts])
    together = np.concatenate(parts)
    error = together[:, 0]

    def level(slope: float) -> float:
        """Logarithm at which nine of ten intervals hold the measured value."""

        def short(log: float) -> float:
            width = NINETY_PERCENT * _deviation(together, log, slope)
            return float(weight @ (np.abs(error) < width)) - 0.9

        return brentq(short, _LEAST, _MOST) if short(_LEAST) < 0 else _LEAST

    def surprise(slope: float) -> float:
        width = _deviation(together, level(slope), slope)
        likely = float(weight @ (student.logpdf(error / width, 5.0) - np.log(width)))
        return 0.5 * (slope / 0.3) ** 2 - 10.0 * len(parts) * likely

    slope = 0.0
    if grows:
        slope = minimize_scalar(surprise, bounds=(-1.0, 1.0), method="bounded").x
    return level(slope), slope


def way_to_reflectance(leaves: LeafSet, model: ErrorModel) -> tuple[float, float]:
    """Mean product of the error of log dry matter from R and T with its way to that from R alone,
    and mean square of the way, both over the mean square error; zeros without either.

    Of a set that `model` was not estimated from.
    """
    truth = np.log(leaves.measured("dry_matter"))
    if not (np.isfinite(truth).any() and np.isfinite(leaves.spectra[:, 1]).any()):
        return 0.0, 0.0
    fits = [
        fit_leaf(
            bin_centres(), leaves.spectra[:, 0], through,
            leaf_shape=leaves.shape, error_model=model,
        )
        for through in (leaves.spectra[:, 1], None)
    ]  # fmt: skip
    both, alone = (np.log(np.asarray(fit.parameters.dry_matter)) for fit in fits)
    have = np.isfinite(truth) & fits[0].converged & fits[1].converged
    error, way = (truth - both)[have], (alone - both)[have]
    size = np.mean(error**2)
    return float(np.mean(error * way) / size), float(np.mean(way**2) / size)


def reflectance_share(ways: Sequence[tuple[float, float]]) -> float:
    """`ErrorModel.reflectance_share` by least squares over sets, drawn to 0 a little."""
    gain, cost = np.sum(ways, axis=0)
    return float(np.clip(gain / (cost + 0.2), 0.0, 1.0))


def species_share(errors: Sequence[dict[str, list[np.ndarray]]]) -> np.ndarray:
    """`ErrorModel.species_share` from the same errors: mean product of two leaves of a species over
    the mean square, of sets with three species or more of several leaves."""
    table = np.full(len(POPULATION_TRAITS), np.nan)
    for row, trait in enumerate(POPULATION_TRAITS):
        shares = []
        for part in (part for of in errors for part in of.get(trait, ())):
            error, species = part[:, 0], part[:, 4].astype(int)
            leaves = np.bincount(species)
            several = leaves > 1
            if several.sum() > 2:
                sums, squares = np.bincount(species, error), np.bincount(species, error**2)
                pairs = (sums**2 - squares)[several] / (leaves[several] - 1)
                shares.append(pairs.sum() / squares[several].sum())
        if shares:
            table[row] = np.clip(np.mean(shares), 0.05, 0.95)
    return table


def estimate(folder: Path, campaigns: Sequence[str] = CAMPAIGNS) -> ErrorModel:
    """The error model of some campaigns, such as all but the one that it is tested on."""
    sets = [leaves for name in campaigns for leaves in read(folder, name)]
    without = {
        name: estimate_spectral([leaves for leaves in sets if leaves.campaign != name])
        for name in campaigns
    }
    models = [without[leaves.campaign] for leaves in sets]
    ways = [way_to_reflectance(leaves, model) for leaves, model in zip(sets, models)]
    # The errors of a campaign are those with the weight of the others.
    shares = {
        name: reflectance_share([w for w, s in zip(ways, sets) if s.campaign != name] or [(0, 0)])
        for name in campaigns
    }
    errors = [
        trait_errors(
            leaves, eqx.tree_at(lambda m: m.reflectance_share, model, shares[leaves.campaign])
        )
        for leaves, model in zip(sets, models)
    ]
    return eqx.tree_at(
        lambda m: (m.trait_discrepancy, m.species_share, m.reflectance_share),
        estimate_spectral(sets),
        (discrepancy(errors), species_share(errors), reflectance_share(ways)),
    )


def write(model: ErrorModel, folder: Path) -> None:
    """Write the tables into `folder`: a row for each bin, a row for each trait."""
    columns = {"wavelength_nm": bin_centres()}
    columns |= {"r_noise": model.reflectance_noise, "t_noise": model.transmittance_noise}
    for i, (r, t) in enumerate(zip(model.reflectance_factors, model.transmittance_factors)):
        columns |= {f"r_factor{i}": r, f"t_factor{i}": t}
    table = pd.DataFrame(columns)
    table.to_csv(
        folder / "error_model.csv.gz",
        index=False,
        float_format="%.5g",
        compression={"method": "gzip", "mtime": 1},
    )
    traits = pd.DataFrame(model.trait_correlation, columns=list(POPULATION_TRAITS))
    traits.insert(0, "trait", POPULATION_TRAITS)
    traits["log_discrepancy"], traits["dry_matter_slope"] = model.trait_discrepancy.T
    traits["species_share"] = model.species_share
    alone = [trait == "dry_matter" for trait in POPULATION_TRAITS]
    traits["reflectance_share"] = np.where(alone, model.reflectance_share, np.nan)
    traits.to_csv(folder / "trait_model.csv", index=False, float_format="%.4g")


if __name__ == "__main__":
    write(estimate(Path(sys.argv[1])), Path(sys.argv[2]) if len(sys.argv) > 2 else DATA)

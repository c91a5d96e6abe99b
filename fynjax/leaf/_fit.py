"""From spectra to leaf chemistry, transmittance and their uncertainty."""

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float
from numpy.typing import ArrayLike
from scipy.special import chdtri

from fynjax._core.precision import double_precision
from fynjax.leaf._area import LeafShape
from fynjax.leaf._coefficients import ProspectVersion
from fynjax.leaf._error_model import EXACT_NOISE, ErrorModel, ErrorName
from fynjax.leaf._measurement import AbstractMeasurement
from fynjax.leaf._parameters import LEAF_PARAMETERS, LeafParameters
from fynjax.leaf._problem import (
    USUAL_SETTINGS,
    FitDomain,
    LeafSettings,
    Prior,
    Setup,
    leaf_bounds,
    leaf_priors,
    leaf_problems,
    prepare,
)
from fynjax.leaf._residual import (
    MeasuredLeaf,
    Optics,
    Solution,
    batches,
    cut,
    factor_system,
    inverse_triangular,
    observed,
    solve,
    spectra,
    to_physical,
)
from fynjax.leaf._result import NINETY_PERCENT, LeafFit, LeafStatus
from fynjax.leaf._spectra import Provenance

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr

# One leaf in a hundred of ANGERS, LOPEX, NASA FFT is beyond it, and nine soils of ten.
_POOR_FIT = 4.0
# Noise that the search for a leaf begins with where PROSPECT is exact, over `EXACT_NOISE`, and how
# often another is taken.
_FIRST_NOISE, _MOST_NOISES = 100.0, 12
# What PROSPECT leaves of R and T of a leaf that it does not describe, where it counts as exact: as
# much as of real leaves [-].
_POOR_EXACT = 0.01
# Usable bins of a leaf that is fitted.
_FEWEST = 10
# Where dry matter absorbs [nm] (Feret et al. 2019, RSE 231, 110959), and the part of it that R must
# hold to say something alone: without the bands of water vapour outdoors 0.7 are left.
_DRY_MATTER_BANDS, _ENOUGH = (1700.0, 2400.0), 0.6
# One leaf in a hundred of the population is further from the usual leaf.
_RARE = 0.99
# Dry matter [g cm-2] at which the discrepancy of traits is stated, and how far from it, as a
# logarithm, it is taken to change: from 2.4 to 27 mg cm-2, which is where leaves were measured.
USUAL_DRY_MATTER, _THICKEST = 0.008, 1.2


@eqx.filter_jit
def _describe_many(tree: tuple, factors: Any, noise: Any, optics: Optics) -> dict[str, Array]:
    """Spectra at z and what the data say of them, of a batch of leaves.

    Products with the factors, which all leaves share, are taken of the whole batch at once: one
    large matrix product costs a fifth of many small ones.
    """
    z, problems, covariance = tree
    leaves, size = z.shape
    number = factors.shape[0]
    flat, through = factors.reshape(number, -1), factors[:, 1]

    def one(z: Array, problem: MeasuredLeaf) -> tuple[Array, ...]:
        def read(z: Array) -> tuple[Array, Array]:
            x = to_physical(z, optics)
            return spectra(x, optics), observed(x, optics)

        (model, recorded), push = jax.linearize(read, z)
        slopes, by_recorded = jax.vmap(push)(jnp.eye(size))
        # The misfit and its slopes are weighted alike, and go through the factors together.
        misfit = jnp.concatenate([(problem.data - recorded)[None], by_recorded])
        rows = (misfit * problem.precision).reshape(size + 1, -1)
        root = inverse_triangular(factor_system(factors, problem.precision))
        return model, recorded, slopes[:, 1], rows, root

    model, recorded, slopes, rows, root = jax.vmap(one)(z, problems)
    inverse = jnp.einsum("nij,nik->njk", root, root)
    loads = (rows.reshape(-1, flat.shape[1]) @ flat.T).reshape(leaves, size + 1, number)
    answers = jnp.einsum("nrj,njk->nrk", loads, inverse)
    # The last factor is the instrument's offset, which is no property of the leaf: it is of R alone
    # and the same at all bands.
    shown = answers[:, 0, :-1] @ flat[:-1]
    size_of_one = factors[-1, 0, 0]
    offset = size_of_one * answers[:, 0, -1]
    along = -size_of_one * answers[:, 1:, -1]
    spread = jnp.einsum("np,npq,nq->n", along, covariance, along)
    spread += size_of_one**2 * problems.inflation * inverse[:, -1, -1]
    recorded = recorded.at[:, 0].add(offset[:, None])
    # Slopes of T, less what the factors take up of them.
    effective = slopes - (answers[:, 1:].reshape(-1, number) @ through).reshape(slopes.shape)
    pairs = (through[:, None] * through[None]).reshape(number * number, -1)
    remaining = inverse.reshape(leaves, -1) @ pairs + noise[1] ** 2
    known = jnp.einsum("npb,npb->nb", effective, jnp.einsum("npq,nqb->npb", covariance, effective))
    return {
        "recorded": recorded,
        "offset": offset,
        "offset_variance": spread,
        "corrected": model + shown.reshape(model.shape),
        "variance": known + problems.inflation[:, None] * remaining,
    }


def solve_leaves(
    setup: Setup, data: np.ndarray, use: np.ndarray, prior: Prior
) -> tuple[Solution, MeasuredLeaf]:
    """Most probable z of each leaf, and its problem.

    A leaf that fits worse than the leaves of the error model has its covariance scaled up, one step
    of a Student likelihood with 50 degrees of freedom, and is solved again. The same for the prior
    was tried with 4 degrees: it adds half to the error of water in sclerophylls and needles.
    """
    if setup.error == "exact":
        return _solve_exact(setup, data, use, prior)
    problems = leaf_problems(setup, data, use, prior, np.ones(len(data)))
    found = solve(prior[0], problems, setup.factors, setup.optics)
    inflation = np.maximum(1.0, (50.0 + 10.0 * found.misfit) / (50.0 + use.sum((1, 2))))
    again = np.flatnonzero(inflation > 1.01)
    problems = problems._replace(inflation=np.where(inflation > 1.01, inflation, 1.0))
    if again.size:
        part = MeasuredLeaf(*(a[again] for a in problems))
        moved = solve(found.z[again], part, setup.factors, setup.optics)
        for whole, new in zip(found, moved):
            whole[again] = new
    return found, problems


def _solve_exact(
    setup: Setup, data: np.ndarray, use: np.ndarray, prior: Prior
) -> tuple[Solution, MeasuredLeaf]:
    """`solve_leaves` with noise of unknown size, the same at all bands: the variance of what the
    fit leaves, over the bands less the parameters, is found together with the leaf.

    The search begins with much noise, which the prior then helps; where it stops early, what it
    leaves is more than the noise, and it goes on with less.
    """
    freedom = np.maximum(use.sum((1, 2)) - len(setup.free), 1)
    found, inflation, again = None, np.full(len(data), _FIRST_NOISE**2), np.arange(len(data))
    for _ in range(_MOST_NOISES):
        problems = leaf_problems(setup, data, use, prior, inflation)
        part = MeasuredLeaf(*(a[again] for a in problems))
        start = (prior[0] if found is None else found.z)[again]
        moved = solve(start, part, setup.factors, setup.optics)
        if found is None:
            found = moved
        for whole, new in zip(found, moved):
            whole[again] = new
        left = np.maximum(1.0, found.misfit / freedom)
        again = np.flatnonzero(np.abs(np.log(left / inflation)) > 0.01)
        if not again.size:
            break
        inflation[again] = left[again]
    assert found is not None
    found.converged[again] = False
    return found, problems


def towards_reflectance(
    setup: Setup, data: np.ndarray, use: np.ndarray, z: np.ndarray
) -> Float[np.ndarray, "leaf parameter"]:
    """What z of R and T is moved by: dry matter a part of the way to what R alone says.

    Only where R holds most of the bands in which dry matter absorbs: beyond them R alone says the
    prior. A leaf whose fit to R does not converge is not moved.
    """
    change = np.zeros_like(z)
    if setup.reflectance_share == 0.0:
        return change
    low, high = _DRY_MATTER_BANDS
    absorbs = (setup.wavelength >= low) & (setup.wavelength <= high)
    known = use[:, 0, absorbs].mean(1) >= _ENOUGH
    both = np.flatnonzero(known & (use[:, 1].sum(1) >= _FEWEST))
    if both.size:
        at, seen = setup.names.index("dry_matter"), use[both]
        seen[:, 1] = False
        alone, _ = solve_leaves(setup, data[both], seen, leaf_priors(setup, data[both], seen))
        way = np.where(alone.converged, alone.z[:, at] - z[both, at], 0.0)
        change[both, at] = setup.reflectance_share * way
    return change


def describe(
    setup: Setup, problems: MeasuredLeaf, z: np.ndarray, covariance: np.ndarray
) -> dict[str, np.ndarray]:
    """Parameters and spectra at z, the errors the data show, and the spread of T."""
    parts = [
        cut(_describe_many(leaves, setup.factors, setup.noise, setup.optics), rows.size)
        for rows, leaves in batches((z, problems, covariance), np.arange(len(z)))
    ]
    return {key: np.concatenate([part[key] for part in parts]) for key in parts[0]}


def trait_variance(
    setup: Setup, inflation: np.ndarray, z: np.ndarray
) -> Float[np.ndarray, "leaf parameter"]:
    """Variance of z that the measured traits add to the spectrum's."""
    # Beyond tenfold the spectrum is not that of a leaf: the status says so, and the interval is
    # the range of the prior.
    grown = np.minimum(np.asarray(inflation), 10.0)
    # The discrepancy is stated at the usual dry matter, and changes with its logarithm.
    log, slope = setup.discrepancy.T
    mass = "dry_matter" if "dry_matter" in setup.names else "carbon_constituents"
    lower, upper = leaf_bounds([mass])[0]
    unit = 1.0 / (1.0 + np.exp(-z[:, setup.names.index(mass)]))
    thick = thickness(lower + (upper - lower) * unit)[:, None]
    return grown[:, None] * np.exp(2.0 * (log + slope * thick))


def thickness(dry_matter: np.ndarray) -> np.ndarray:
    """Logarithm of dry matter over the usual one, cut where no leaves were measured."""
    return np.clip(np.log(dry_matter / USUAL_DRY_MATTER), -_THICKEST, _THICKEST)


@double_precision
def fit_leaf(
    wavelength: "ArrayLike | pd.DataFrame | xr.DataArray | xr.Dataset",
    reflectance: ArrayLike | None = None,
    transmittance: "ArrayLike | pd.DataFrame | xr.DataArray | None" = None,
    *,
    version: ProspectVersion = "D",
    measurement: AbstractMeasurement | None = None,
    leaf_shape: LeafShape = "broad",
    domain: FitDomain = "full",
    free: Sequence[str] | None = None,
    outdoor: bool | None = None,
    detector_changes: Sequence[float] = (),
    error_model: ErrorName | ErrorModel | None = None,
) -> LeafFit:
    """Fit PROSPECT to measured reflectance, transmittance, or both, of any number of leaves.

    What is estimated, and how, is said at `LeafFit`.

    **Arguments:**

    - `wavelength`: band centres [nm], ascending; or in place of the arrays the dataset of
      `fynjax.read_spectra`, a DataArray over `wavelength`, or a table of pandas: wavelengths are
      its columns or its index, whichever is named so or alone holds numbers of 100 to 50 000.
    - `reflectance`, `transmittance`: [leaf, band], fractions, NaN where missing; one may be `None`.
      `transmittance=` may be a table with the labels of the first.
    - `version`: "5", "D" or "PRO".
    - `measurement`: what the instrument records; by default an integrating sphere, which of round
      leaves shows gaps, and of those side by side recollision (`LeafOverBackground`).
    - `leaf_shape`: "broad", "needle", or "mat" or "culm", which lie side by side.
    - `domain`: "full", 450-2400 nm, or "optimal", the published 520-560, 700-720, 1130 (for N) and
      1700-2400 nm.
    - `free`: parameters to fit; by default all of the version but `brown_pigments`.
    - `outdoor`: leave out the bands in which water vapour absorbs sunlight; `None`: of a spectrum
      with values there that are no reflectance.
    - `detector_changes`: where detectors change [nm]; jumps there are taken out
      (`correct_detector_jumps`). `read_spectra` does so where files state them.
    - `error_model`: what spectra depart from PROSPECT by. "laboratory" and "field": as real leaves
      do (`default_error_model`; an `ErrorModel` of one's own may stand here too), with an offset of
      R of 0.02 (a sphere's calibration) and of 0.04 (shine under a clip or probe). Left out: with
      the measurement's own offset, which is "field" of `LeafClip`, "laboratory" of others. "exact":
      noise that is independent from band to band, as of simulated spectra; the offset is a clip's
      shine alone, bands are not averaged to bins, and without noise all traits that the spectra
      tell come back to 1e-4. Of real leaves its intervals are far too narrow.

    **Returns:** `LeafFit` with the labels. NumPy, float64; not differentiable (see `prospect`).

    **Raises:** `InputError` for spectra or options that it does not take.

    >>> import fynjax as fx
    >>> r, t = fx.prospect(water=[0.008, 0.015])
    >>> fit = fx.fit_leaf(range(400, 2501), r, t)
    >>> fit.table()["water"].round(3).tolist()
    [0.008, 0.015]
    """
    settings = LeafSettings(
        version, measurement, leaf_shape, domain, free, outdoor, detector_changes, error_model
    )
    chunks = LeafChunks(wavelength, reflectance, transmittance, settings=settings)
    return chunks.join(chunks.fit(part, chunks.setup) for part in chunks.parts)


Chunk = tuple[np.ndarray, np.ndarray, Prior]
"""Data of some leaves, which of them to use, and their priors."""


class LeafChunks:
    """The leaves of a fit in chunks, each of which can be fitted elsewhere, kept, or counted.

    `fit_leaf` fits one after another. In place of `map` may stand that of processes, such as
    `concurrent.futures.ProcessPoolExecutor().map`.

    >>> from itertools import repeat
    >>> import numpy as np
    >>> import fynjax as fx
    >>> from fynjax.leaf import LeafChunks
    >>> leaf = fx.prospect(fx.LeafParameters())
    >>> spectra = np.tile(leaf.reflectance, (3, 1))
    >>> chunks = LeafChunks(np.asarray(leaf.wavelength), spectra, size=2)
    >>> fit = chunks.join(map(LeafChunks.fit, chunks.parts, repeat(chunks.setup)))
    >>> len(fit.status)
    3
    """

    rows: list[slice]
    """Leaves that each chunk holds."""
    parts: list[Chunk]
    """Spectra, bins and priors of the leaves of each chunk, as `fit` takes them."""
    setup: Setup
    """Settings that all leaves share."""

    @double_precision
    def __init__(
        self,
        wavelength: Any,
        reflectance: Any = None,
        transmittance: Any = None,
        *,
        settings: LeafSettings = USUAL_SETTINGS,
        size: int = 1024,
    ) -> None:
        """Chunks of `size` leaves; spectra and errors as of `fit_leaf`."""
        self.setup, self._data, self._use, (mean, precision), self._source = prepare(
            wavelength, reflectance, transmittance, settings
        )
        count = len(mean)
        self.rows = [slice(at, min(at + size, count)) for at in range(0, count, size)]
        self.parts = [(self._data[r], self._use[r], (mean[r], precision[r])) for r in self.rows]

    @staticmethod
    @double_precision
    def fit(part: Chunk, setup: Setup) -> tuple[np.ndarray, ...]:
        """Arrays that `join` takes, of a chunk; can be sent to another process."""
        data, use, prior = part
        found, problems = solve_leaves(setup, data, use, prior)
        covariance = np.linalg.inv(found.hessian)
        change = towards_reflectance(setup, data, use, found.z)
        values = describe_chunk(setup, found, problems, covariance, use, change)
        return np.array(list(values)), *values.values()

    @double_precision
    def join(self, fitted: Iterable[tuple[np.ndarray, ...]]) -> LeafFit:
        """The result, from what `fit` gave of each chunk, in their order."""
        parts = [dict(zip(map(str, names), arrays)) for names, *arrays in fitted]
        return assemble(self.setup, parts, self._data, self._use, self._source)


def describe_chunk(
    setup: Setup,
    found: Solution,
    problems: MeasuredLeaf,
    covariance: np.ndarray,
    use: np.ndarray,
    change: np.ndarray | float = 0.0,
) -> dict[str, np.ndarray]:
    """Everything `assemble` needs of leaves at z with that covariance, as the spectra give it, and
    of traits that `change` moves in z; spectra stay those before."""
    description: dict[str, Any] = describe(setup, problems, found.z, covariance)
    z = found.z + change
    inflation = np.asarray(problems.inflation)
    population = np.diag(np.linalg.inv(setup.prior_precision))
    # Before the discrepancy is added: what the spectrum leaves of the variance among leaves.
    own = np.einsum("npp->np", covariance).copy()
    share = own / population
    extra = trait_variance(setup, inflation, z)
    off = found.z - setup.prior_mean
    rarity = np.einsum("np,pq,nq->n", off, setup.prior_precision, off)
    covariance = covariance + np.eye(len(setup.names)) * extra[:, None]
    misfit = found.misfit / np.maximum(use.sum((1, 2)), 1)
    return description | {
        "z": z, "covariance": covariance, "chi2": misfit, "inflation": inflation,
        "converged": found.converged, "share": share, "rarity": rarity,
        "prospect": found.z, "prospect_variance": own,
    }  # fmt: skip


def assemble(
    setup: Setup,
    parts: list[dict[str, np.ndarray]],
    data: np.ndarray,
    use: np.ndarray,
    source: Provenance,
) -> LeafFit:
    """The result in physical units, and a status for each leaf.

    Takes the arrays out of `parts` and works in place, so that spectra of many leaves are not in
    memory twice.
    """
    names, free = setup.names, setup.free
    got = {key: np.concatenate([part.pop(key) for part in parts]) for key in list(parts[0])}
    bounds = leaf_bounds(names)
    width = bounds[:, 1] - bounds[:, 0]
    deviation = np.sqrt(np.einsum("npp->np", got["covariance"]))
    z = got["z"]
    unit = 1.0 / (1.0 + np.exp(-z))
    x = bounds[:, 0] + width * unit

    def ends(z: np.ndarray, deviation: np.ndarray) -> list[np.ndarray]:
        return [
            bounds[:, 0] + width / (1.0 + np.exp(-(z + sign * NINETY_PERCENT * deviation)))
            for sign in (-1, 1)
        ]

    lower, upper = ends(z, deviation)
    scale = width * unit * (1.0 - unit)
    # Of PROSPECT's own trait: about what explains the spectra, without the laboratory's part.
    own_deviation = np.sqrt(got["prospect_variance"])
    own_lower, own_upper = ends(got["prospect"], own_deviation)
    own_unit = 1.0 / (1.0 + np.exp(-got["prospect"]))
    own_spread = width * own_unit * (1.0 - own_unit) * own_deviation
    # From logits to units, to first order; intervals are carried over exactly.
    covariance = scale[:, :, None] * got["covariance"] * scale[:, None, :]
    few = use.sum((1, 2)) < _FEWEST
    at_bound = (x > bounds[:, 1] - 0.01 * width) & np.isin(names, free)
    reason = _status(setup, got, few, at_bound.any(1))
    measured = np.where(use, data, np.nan)
    off = np.nan_to_num(measured - got["recorded"], copy=False)
    rmse = np.sqrt(np.einsum("nqb,nqb->n", off, off) / np.maximum(use.sum((1, 2)), 1))
    del off
    for values in (x, got["recorded"], got["corrected"], got["variance"]):
        values[few] = np.nan
    corrected = np.clip(got["corrected"], 0.0, 1.0, out=got["corrected"])
    spread = np.sqrt(np.einsum("npp->np", covariance))
    known = dict(zip(names, x.T))
    fitted = tuple(name for name in free if name in LEAF_PARAMETERS)
    chosen = [names.index(name) for name in fitted]
    estimated = setup.optics.measurement.estimated
    shown = ~few & use[:, 1].any(1)  # without transmittance nothing is estimated, see leaf_priors
    own = [names.index(name) for name in estimated]

    def of_leaf(values: np.ndarray) -> np.ndarray:
        return np.where(few[:, None], np.nan, values)[:, chosen]

    return LeafFit(
        parameters=LeafParameters.many(**{n: known.get(n, 0.0) for n in LEAF_PARAMETERS}),
        names=fitted,
        standard_deviation=of_leaf(spread),
        covariance=covariance[:, chosen][:, :, chosen],
        lower=of_leaf(lower),
        upper=of_leaf(upper),
        prospect_deviation=of_leaf(own_spread),
        prospect_lower=of_leaf(own_lower),
        prospect_upper=of_leaf(own_upper),
        wavelength=setup.wavelength,
        measured=measured,
        fitted=got["recorded"],
        reflectance=corrected[:, 0],
        transmittance=corrected[:, 1],
        transmittance_deviation=np.sqrt(got["variance"], out=got["variance"]),
        rmse=np.where(few, np.nan, rmse),
        chi2=got["chi2"],
        inflation=got["inflation"],
        converged=got["converged"] & ~few,
        reason=reason,
        at_bound=at_bound[:, chosen],
        prior_share=of_leaf(got["share"]),
        offset=np.where(few, np.nan, got["offset"]),
        offset_deviation=np.where(few, np.nan, np.sqrt(got["offset_variance"])),
        measurement=np.where(shown[:, None], x[:, own], np.nan),
        measurement_deviation=np.where(shown[:, None], spread[:, own], np.nan),
        estimated=estimated,
        version=setup.version,
        leaf_shape=setup.shape,
        error_model=setup.error,
        source=source,
    )


def _status(
    setup: Setup,
    got: dict[str, np.ndarray],
    few: Bool[np.ndarray, " leaf"],
    at_bound: Bool[np.ndarray, " leaf"],
) -> np.ndarray:
    """Status of each leaf: the first doubt that holds."""
    exact = setup.error == "exact"
    most = (_POOR_EXACT / EXACT_NOISE) ** 2 if exact else _POOR_FIT
    rare = got["rarity"] > chdtri(len(setup.free), 1.0 - _RARE)
    doubts = {
        LeafStatus.failed: few,
        LeafStatus.max_steps: ~got["converged"],
        LeafStatus.at_bound: at_bound,
        LeafStatus.poor_fit: got["inflation"] > most,
        LeafStatus.unusual: rare & (not exact),
    }
    return np.select(list(doubts.values()), list(doubts), LeafStatus.converged)

"""From spectra to leaf chemistry, transmittance and their uncertainty."""

from collections.abc import Sequence
from typing import Literal, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from fynjax._core.progress import NullProgress, Progress
from fynjax.leaf import _levenberg as lm
from fynjax.leaf._coefficients import (
    CONSTITUENTS,
    ProspectVersion,
    check_version,
    coefficients_at,
    native_wavelength,
)
from fynjax.leaf._error_model import ErrorModel, bin_centres, default_error_model, to_bins
from fynjax.leaf._measurement import AbstractMeasurement, IntegratingSphere
from fynjax.leaf._parameters import LeafParameters
from fynjax.leaf._prospect import interface_transmissivity

FitDomain = Literal["full", "optimal"]
"""Wavelengths that a fit uses: all of 450-2400 nm, or the published sub-domains."""

NINETY_PERCENT = 1.6448536269514722
_WATER = ((1340.0, 1430.0), (1780.0, 1980.0), (2390.0, 2510.0))
# Published optimal sub-domains: Féret et al. 2019 (RSE 231, 110959), Spafford et al. 2021.
_OPTIMAL = ((520.0, 560.0), (700.0, 720.0), (1700.0, 2400.0))
_LINE_BAND, _LINE = 1130.0, (1.745, 0.133, 0.3)


class Prior(NamedTuple):
    """Bounds, middle and spread of a parameter, the spread in its logit coordinate."""

    lower: float
    upper: float
    middle: float
    spread: float


# Bounds after the R package `prospect`; middles and spreads are those of leaves at large: LMA
# after Wright et al. 2004 (Nature 428, 821; median 88 g/m2), the rest wide enough not to bind.
PRIORS: dict[str, Prior] = {
    "structure": Prior(0.8, 4.0, 1.5, 1.2),
    "chlorophyll": Prior(0.0, 150.0, 35.0, 0.8),
    "carotenoids": Prior(0.0, 40.0, 8.0, 0.8),
    "anthocyanins": Prior(0.0, 50.0, 0.5, 1.5),
    "brown_pigments": Prior(0.0, 4.0, 0.02, 1.5),
    "water": Prior(0.0, 0.1, 0.01, 0.6),
    "dry_matter": Prior(0.0, 0.06, 0.008, 0.8),
    "proteins": Prior(0.0, 0.006, 0.0008, 0.6),
    "carbon_constituents": Prior(0.0, 0.054, 0.007, 0.8),
}


class LeafFit(eqx.Module):
    """What `fit_leaf` found for each spectrum, and how far to trust it."""

    parameters: LeafParameters
    """Most probable parameters, each a vector [leaf]."""
    names: tuple[str, ...] = eqx.field(static=True)
    """Names of the fitted parameters, in the order of the arrays below."""
    standard_deviation: Float[np.ndarray, "leaf parameter"]
    """Standard deviation of each parameter, in its unit."""
    covariance: Float[np.ndarray, "leaf parameter parameter"]
    """Covariance of the parameters, in their units."""
    lower: Float[np.ndarray, "leaf parameter"]
    """Lower end of the 90 % interval."""
    upper: Float[np.ndarray, "leaf parameter"]
    """Upper end of the 90 % interval."""
    wavelength: Float[np.ndarray, " bin"]
    """Bins on which the fit stands [nm]."""
    measured: Float[np.ndarray, "leaf 2 bin"]
    """Recorded R and T on the bins; NaN where missing or left out of the fit [-]."""
    fitted: Float[np.ndarray, "leaf 2 bin"]
    """The model's R and T as the instrument would record them [-]."""
    reflectance: Float[np.ndarray, "leaf bin"]
    """R of the leaf: model plus the part of its error that the data show [-]."""
    transmittance: Float[np.ndarray, "leaf bin"]
    """T of the leaf, predicted where it was not measured [-]."""
    transmittance_deviation: Float[np.ndarray, "leaf bin"]
    """Standard deviation of `transmittance` [-]."""
    rmse: Float[np.ndarray, " leaf"]
    """Root mean square of measured minus fitted [-]."""
    chi2: Float[np.ndarray, " leaf"]
    """Squared misfit in units of the error model's covariance, per band; see `inflation` [-]."""
    inflation: Float[np.ndarray, " leaf"]
    """Factor on the error covariance because the leaf fits worse than those it stems from [-]."""
    converged: Bool[np.ndarray, " leaf"]
    """Whether the iteration reached its tolerance."""
    status: tuple[str, ...] = eqx.field(static=True)
    """`converged`, or the reason to doubt the result, for each leaf."""


def _inside(centres: np.ndarray, windows: Sequence[tuple[float, float]]) -> np.ndarray:
    return np.any([(centres >= low) & (centres <= high) for low, high in windows], axis=0)


def _optics(names: Sequence[str], version: str, measurement: AbstractMeasurement) -> lm.Optics:
    index, absorption = coefficients_at(version, native_wavelength())
    binned = to_bins(native_wavelength(), np.vstack([index, absorption]))
    bounds = np.array([PRIORS[name][:2] for name in names])
    return lm.Optics(
        jnp.asarray(binned[1:]),
        jnp.asarray(interface_transmissivity(40.0, binned[0])),
        jnp.asarray(interface_transmissivity(90.0, binned[0])),
        jnp.asarray(binned[0]),
        jnp.asarray(bounds[:, 0]),
        jnp.asarray(bounds[:, 1]),
        measurement,
    )


def _factors(model: ErrorModel, measurement: AbstractMeasurement) -> np.ndarray:
    offset = np.zeros((1, 2, bin_centres().size))
    offset[0, 0] = measurement.offset_deviation
    shared = np.stack([model.reflectance_factors, model.transmittance_factors], axis=1)
    return np.concatenate([shared, offset])


def usable_bins(data: np.ndarray, domain: str, outdoor: bool | None) -> np.ndarray:
    """Which bins [leaf, 2, bin] enter the fit: measured, possible, 450-2400 nm, in the domain.

    With `outdoor` `None` the water bands of a spectrum are left out if they hold impossible values.
    """
    centres = bin_centres()
    with np.errstate(invalid="ignore"):
        possible = np.isfinite(data) & (data > -0.02) & (data < 1.05)
    use = possible & (centres >= 445.0) & (centres <= 2405.0)
    water = _inside(centres, _WATER)
    spoilt = (np.isfinite(data) & ~possible & water).any((1, 2))
    noisy = spoilt if outdoor is None else np.full(len(data), outdoor)
    use &= ~(noisy[:, None, None] & water)
    if domain == "optimal":
        use &= _inside(centres, _OPTIMAL)
    return use


@eqx.filter_jit
def _solve_many(problems: lm.Problem, optics: lm.Optics) -> lm.Solution:
    return jax.vmap(lm.solve, in_axes=(0, None))(problems, optics)


@eqx.filter_jit
def _spectra_many(optics: lm.Optics, z: Array) -> tuple:
    """Parameters, their slope by z, and spectra with slopes: of the leaf, and as recorded."""

    def one(z: Array) -> tuple:
        x, unit = lm.to_physical(z, optics), jax.nn.sigmoid(z)
        scale = (optics.upper - optics.lower) * unit * (1.0 - unit)
        model, slopes = lm.spectra_and_slopes(x, optics)
        seen, seen_slopes = lm.observed_and_slopes(x, optics)
        wide = scale[:, None, None]
        return x, scale, model, slopes[:, 1] * wide[:, 0], seen, seen_slopes * wide

    return jax.vmap(one)(z)


def _describe(problems: lm.Problem, optics: lm.Optics, solution: lm.Solution) -> tuple:
    """Spectra, the errors the data show, misfit, and the spread of T of each leaf.

    In NumPy: these few small systems are solved once, and compiling them costs more.
    """
    x, scale, model, t_slopes, seen, seen_slopes = map(
        np.asarray, _spectra_many(optics, solution.z)
    )
    leaves, parameters = x.shape
    factors = np.asarray(problems.factors)
    flat = factors.reshape(leaves, factors.shape[1], -1)
    weight = np.asarray(problems.precision).reshape(leaves, -1)
    residual = np.where(weight > 0, (np.asarray(problems.data) - seen).reshape(leaves, -1), 0.0)
    weighted = flat * weight[:, None, :]
    system = np.eye(flat.shape[1]) + weighted @ flat.transpose(0, 2, 1)
    pulled = weighted @ residual[:, :, None]
    answers = weighted @ seen_slopes.reshape(leaves, parameters, -1).transpose(0, 2, 1)
    through = factors[:, :, 1]
    solved = np.linalg.solve(system, np.concatenate([pulled, answers, through], axis=2))
    scores, gain = solved[:, :, 0], solved[:, :, 1 : 1 + parameters]
    misfit = (weight * residual**2).sum(1) - (pulled[:, :, 0] * scores).sum(1)
    covariance = np.linalg.inv(np.asarray(solution.hessian))
    effective = t_slopes - gain.transpose(0, 2, 1) @ through
    variance = (effective * (covariance @ effective)).sum(1)
    variance = variance + (through * solved[:, :, 1 + parameters :]).sum(1)
    # The last factor is the instrument's offset, which is no property of the leaf.
    shown = np.einsum("nf,nfcb->ncb", scores[:, :-1], factors[:, :-1], optimize=True)
    return x, scale, seen, model + shown, misfit, covariance, variance


def fit_leaf(
    wavelength: Float[np.ndarray, " band"],
    reflectance: Float[np.ndarray, "leaf band"] | None = None,
    transmittance: Float[np.ndarray, "leaf band"] | None = None,
    *,
    version: ProspectVersion = "D",
    measurement: AbstractMeasurement | None = None,
    domain: FitDomain = "full",
    free: Sequence[str] | None = None,
    outdoor: bool | None = None,
    error_model: ErrorModel | None = None,
    chunk: int = 256,
    progress: Progress | None = None,
) -> LeafFit:
    """Fit PROSPECT to measured reflectance, transmittance, or both, of any number of leaves.

    The most probable parameters under a Gaussian error with covariance along the wavelength
    (`ErrorModel`), the measurement's offset, and wide priors on leaves at large; if T is missing,
    N also has the prior 1.745 R / (1 - R) + 0.133 at 1131 nm (after Spafford et al. 2021), with a
    standard deviation of 0.3. A leaf that fits worse than the leaves of the error model has its
    covariance scaled up (one step of a Student likelihood) and is fitted again. The fit stands on
    bins of 10 nm with mean absorption, which alone lowers chlorophyll by about 3 % and carotenoids
    by about 5 %; the error model, estimated on the same bins, contains this.

    **Arguments:**

    - `wavelength`: band centres [nm], ascending; bands outside 450-2400 nm are left out of the fit
      (PROSPECT has no data below 400 nm, and instruments are noisy at both ends).
    - `reflectance`, `transmittance`: [leaf, band], fractions, NaN where missing; one may be `None`.
    - `version`: "5", "D" or "PRO".
    - `measurement`: what the instrument records; an integrating sphere by default.
    - `domain`: "full", or "optimal" for the published sub-domains 520-560, 700-720, 1700-2400 nm.
    - `free`: parameters to fit; by default all of the version but `brown_pigments`.
    - `outdoor`: leave out the water bands; `None` decides by impossible values there.
    - `error_model`: covariance of the model's error; the one shipped by default.
    - `chunk`: leaves computed at once; memory is about 1.5 MB a leaf of a chunk.

    **Returns:** `LeafFit`. A leaf with less than ten usable bins has NaN and says so in `status`.

    **Raises:** `ValueError` for arrays that do not match, an unknown version, domain or parameter.
    """
    check_version(version)
    if domain not in ("full", "optimal"):
        raise ValueError(f'`domain` must be "full" or "optimal", but is {domain!r}')
    if reflectance is None and transmittance is None:
        raise ValueError("`fit_leaf` needs reflectance, transmittance, or both")
    measurement = IntegratingSphere() if measurement is None else measurement
    error_model = default_error_model() if error_model is None else error_model
    progress = NullProgress() if progress is None else progress
    grid = np.asarray(wavelength, float)
    if grid.ndim != 1 or np.any(np.diff(grid) <= 0):
        raise ValueError("`wavelength` must be an ascending vector [nm]")
    given = [np.atleast_2d(a) for a in (reflectance, transmittance) if a is not None]
    for array in given:
        if array.shape != (len(given[0]), grid.size):
            raise ValueError(f"spectra must have the shape (leaf, {grid.size}), but {array.shape}")
    missing = np.full((len(given[0]), grid.size), np.nan)
    data = np.stack(
        [
            to_bins(grid, missing if part is None else np.atleast_2d(part))
            for part in (reflectance, transmittance)
        ],
        axis=1,
    )
    names = ("structure", *CONSTITUENTS[version])
    free = tuple(n for n in names if n != "brown_pigments") if free is None else tuple(free)
    for name in free:
        if name not in names:
            raise ValueError(f"`free` names {name!r}, which PROSPECT-{version} does not have")
    with jax.enable_x64(True):
        use = usable_bins(data, domain, outdoor)
        optics = _optics(names, version, measurement)
        # Few sizes of batch, so that few programs are compiled.
        size = next((s for s in (1, 16, 64, 256) if s >= min(chunk, len(data))), chunk)
        size = min(size, chunk)
        parts = []
        with progress.stage("fitting leaves", len(data)):
            for at in range(0, len(data), chunk):
                stop = min(at + chunk, len(data))
                parts.append(_fit_chunk(data[at:stop], use[at:stop], optics, names, free,
                                        error_model, size))  # fmt: skip
                progress.advance(stop - at)
    return _assemble(parts, data, use, names, free)


def _fit_chunk(
    data: np.ndarray,
    use: np.ndarray,
    optics: lm.Optics,
    names: tuple[str, ...],
    free: tuple[str, ...],
    model: ErrorModel,
    size: int,
) -> dict[str, np.ndarray]:
    count = len(data)
    if count < size:  # one compiled shape serves the last chunk too
        data = np.concatenate([data, np.repeat(data[:1], size - count, 0)])
        use = np.concatenate([use, np.repeat(use[:1], size - count, 0)])
    factors = _factors(model, optics.measurement)
    noise = np.stack([model.reflectance_noise, model.transmittance_noise])
    middle = np.array([PRIORS[n].middle if n in free else 1e-4 * PRIORS[n].upper for n in names])
    spread = np.array([PRIORS[n].spread if n in free else 1e-3 for n in names])
    mean = np.asarray(lm.to_unconstrained(jnp.asarray(middle), optics))
    band = int(np.argmin(np.abs(bin_centres() - _LINE_BAND)))
    plateau = data[:, 0, band]
    alone = np.isfinite(plateau) & ~use[:, 1].any(1) & (plateau > 0.05) & (plateau < 0.9)
    safe = np.where(alone, plateau, 0.4)
    line = np.stack(
        [_LINE[0] * safe / (1 - safe) + _LINE[1], np.where(alone, _LINE[2] ** -2, 0.0)], axis=1
    )
    bands = use.sum((1, 2))
    inflation = np.ones(size)
    precision = np.where(use, noise**-2.0, 0.0)
    start = np.tile(mean, (size, 1))
    for _ in range(2):
        problems = lm.Problem(
            jnp.asarray(np.where(use, data, 0.0)),
            jnp.asarray(precision / inflation[:, None, None]),
            jnp.asarray(factors * np.sqrt(inflation)[:, None, None, None]),
            jnp.asarray(np.tile(mean, (size, 1))),
            jnp.asarray(np.tile(np.diag(spread**-2.0), (size, 1, 1))),
            jnp.asarray(line),
            jnp.asarray(start),
        )
        solution = _solve_many(problems, optics)
        start = np.asarray(solution.z)
        x, scale, seen, corrected, misfit, covariance, variance = _describe(
            problems, optics, solution
        )
        chi2 = misfit * inflation / np.maximum(bands, 1)
        last, inflation = inflation, np.maximum(1.0, (50.0 + 10.0 * chi2 * bands) / (50.0 + bands))
    variance = variance + last[:, None] * model.transmittance_noise**2
    out = {
        "z": start, "x": x, "scale": scale, "seen": seen, "corrected": corrected,
        "chi2": chi2, "covariance": covariance,
        "variance": variance, "converged": np.asarray(solution.converged), "inflation": last,
    }  # fmt: skip
    return {key: value[:count] for key, value in out.items()}


def _assemble(
    parts: list[dict[str, np.ndarray]],
    data: np.ndarray,
    use: np.ndarray,
    names: tuple[str, ...],
    free: tuple[str, ...],
) -> LeafFit:
    got = {key: np.concatenate([part[key] for part in parts]) for key in parts[0]}
    bounds = np.array([PRIORS[name][:2] for name in names])
    width = bounds[:, 1] - bounds[:, 0]
    deviation = np.sqrt(np.einsum("npp->np", got["covariance"]))
    z = got["z"]
    ends = [
        bounds[:, 0] + width / (1.0 + np.exp(-(z + sign * NINETY_PERCENT * deviation)))
        for sign in (-1, 1)
    ]
    scale = got["scale"]
    covariance = scale[:, :, None] * got["covariance"] * scale[:, None, :]
    few = use.sum((1, 2)) < 10
    measured = np.where(use, data, np.nan)
    square = np.where(use, (np.where(use, data, 0.0) - got["seen"]) ** 2, 0.0)
    rmse = np.sqrt(square.sum((1, 2)) / np.maximum(use.sum((1, 2)), 1))
    at_bound = (got["x"] > bounds[:, 1] - 0.01 * width) & np.isin(names, free)
    status = []
    for i in range(len(data)):
        if few[i]:
            status.append("failed: fewer than ten usable bands within 450-2400 nm")
        elif not got["converged"][i]:
            status.append("not converged: iteration limit reached")
        elif at_bound[i].any():
            status.append(f"at bound: {', '.join(np.array(names)[at_bound[i]])}")
        elif got["inflation"][i] > 8.0:
            status.append("converged, poor fit: unlike any leaf of the error model")
        else:
            status.append("converged")
    for key in ("x", "seen", "corrected", "variance"):
        got[key][few] = np.nan
    spread = np.sqrt(np.einsum("npp->np", covariance))
    values = dict(zip(names, got["x"].T))
    zeros = {name: 0.0 for name in PRIORS if name not in names}
    chosen = [names.index(name) for name in free]
    return LeafFit(
        parameters=LeafParameters.many(**zeros, **values),
        names=free,
        standard_deviation=np.where(few[:, None], np.nan, spread)[:, chosen],
        covariance=covariance[:, chosen][:, :, chosen],
        lower=np.where(few[:, None], np.nan, ends[0])[:, chosen],
        upper=np.where(few[:, None], np.nan, ends[1])[:, chosen],
        wavelength=bin_centres(),
        measured=measured,
        fitted=got["seen"],
        reflectance=np.clip(got["corrected"][:, 0], 0.0, 1.0),
        transmittance=np.clip(got["corrected"][:, 1], 0.0, 1.0),
        transmittance_deviation=np.sqrt(got["variance"]),
        rmse=np.where(few, np.nan, rmse),
        chi2=got["chi2"],
        inflation=got["inflation"],
        converged=got["converged"] & ~few,
        status=tuple(status),
    )  # fmt: skip

"""What a leaf fit is made of: bins that count, priors, and the problem of each leaf."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple, get_args

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from fynjax._core.errors import InputError, did_you_mean
from fynjax._core.parameters import Parameter
from fynjax.leaf._area import LeafShape, check_leaf_shape
from fynjax.leaf._coefficients import (
    CONSTITUENTS,
    ProspectVersion,
    check_version,
    coefficients_at,
    native_wavelength,
)
from fynjax.leaf._detectors import correct_detector_jumps
from fynjax.leaf._error_model import (
    EXACT_NOISE,
    OFFSETS,
    POPULATION_TRAITS,
    PUBLISHED_DOMAINS,
    ErrorModel,
    ErrorName,
    bin_centres,
    default_error_model,
    inside,
    to_bins,
    to_nanometres,
)
from fynjax.leaf._measurement import MEASUREMENT_PARAMETERS, AbstractMeasurement, usual_measurement
from fynjax.leaf._parameters import LEAF_PARAMETERS
from fynjax.leaf._prospect import interface_transmissivity, surface_transmissivity
from fynjax.leaf._residual import MeasuredLeaf, Optics, to_unconstrained
from fynjax.leaf._spectra import Provenance, Spectra, as_spectra, check_fractions

FitDomain = Literal["full", "optimal"]
"""Wavelengths that a fit uses: all of 450-2400 nm, or the published sub-domains."""

_USED = (450.0, 2400.0)
"""Ends of the wavelengths that a fit uses [nm]."""
_ENDS = (445.0, 2405.0)
"""Ends of the centres of the bins, or the bands, that hold these [nm]."""
_WATER = ((1340.0, 1430.0), (1780.0, 1980.0), (2390.0, 2510.0))
_LINE_BAND = 1130.0
# N from R / (1 - R) (Spafford et al. 2021) and from (1 - T) / T at that band: slope, offset (fitted
# to 1000 simulated leaves of N 1 to 2.5), and what real leaves scatter about the first: 0.06 in
# ANGERS, 0.09 in broad leaves of NASA FFT, 0.2 in LOPEX and needle mats.
_REFLECTANCE_LINE, _TRANSMITTANCE_LINE, _LINE_DEVIATION = (1.745, 0.133), (1.330, 0.120), 0.2


ASSUMED_DISCREPANCY = {"proteins": 0.25, "carbon_constituents": 0.25}
"""Discrepancy of traits that were measured in one campaign only, see `ErrorModel` [-]."""

# The logit of a parameter that is held at zero, where the model is exact.
_NOTHING = -28.0

# Leaves that are binned at once: what is made on the way takes a few arrays of their bands.
_BLOCK = 512

# A band outside spoils its bin, however the bin's mean looks.
_IMPOSSIBLE = (-0.1, 1.2)


def leaf_bounds(names: Sequence[str]) -> Float[np.ndarray, "parameter 2"]:
    """Lower and upper bounds of parameters."""
    return np.array([(_record(n).lower, _record(n).upper) for n in names])


def _record(name: str) -> Parameter:
    return LEAF_PARAMETERS[name] if name in LEAF_PARAMETERS else MEASUREMENT_PARAMETERS[name]


def _population(name: str) -> tuple[float, float]:
    """Centre of the prior of leaves at large, and its spread in the logit coordinate."""
    record = _record(name)
    assert record.population is not None
    centre, relative = record.population
    below, above = centre - record.lower, record.upper - centre
    return centre, relative * centre * (record.upper - record.lower) / (below * above)


@dataclass(frozen=True)
class LeafSettings:
    """Settings of a fit of leaves, as the arguments of `fit_leaf` of these names have them.

    Raises `InputError` for an unknown version, shape or domain.
    """

    version: ProspectVersion = "D"
    """Version of PROSPECT: "5", "D" or "PRO"."""
    measurement: AbstractMeasurement | None = None
    """Instrument's reading of a leaf; None: the usual one for the shape (`usual_measurement`)."""
    leaf_shape: LeafShape = "broad"
    """Shape of the leaves."""
    domain: FitDomain = "full"
    """Wavelengths that are used."""
    free: Sequence[str] | None = None
    """Parameters to fit; None: all of the version but `brown_pigments`."""
    outdoor: bool | None = None
    """Whether the bands of water vapour are left out; None: of spectra that are spoilt there."""
    detector_changes: Sequence[float] = ()
    """Wavelengths where detectors change [nm], at which jumps are taken out."""
    error_model: ErrorName | ErrorModel | None = None
    """What spectra depart from PROSPECT by: "exact", "laboratory", "field", or a covariance; None:
    "field" of a leaf clip or probe, "laboratory" of others."""

    def __post_init__(self) -> None:
        check_version(self.version)
        check_leaf_shape(self.leaf_shape)
        if self.domain not in get_args(FitDomain):
            raise InputError(f'`domain` must be "full" or "optimal", but is {self.domain!r}')
        if isinstance(self.error_model, str) and self.error_model not in get_args(ErrorName):
            raise InputError(
                f"`error_model` must be {', '.join(map(repr, get_args(ErrorName)))} or an "
                f"ErrorModel, but is {self.error_model!r}."
                f"{did_you_mean(self.error_model, get_args(ErrorName))}"
            )


USUAL_SETTINGS = LeafSettings()


class Setup(NamedTuple):
    """What all leaves of a fit share."""

    version: ProspectVersion
    shape: LeafShape
    names: tuple[str, ...]
    free: tuple[str, ...]
    optics: Optics
    factors: Float[np.ndarray, "factor 2 bin"]
    """Factors of the error model, and last the instrument's offset, no property of the leaf."""
    discrepancy: Float[np.ndarray, "parameter 2"]
    """Discrepancy of each parameter (`ErrorModel.trait_discrepancy`); none of those not fitted."""
    noise: Float[np.ndarray, "2 bin"]
    distrust: Float[np.ndarray, " bin"]
    prior_mean: Float[np.ndarray, " parameter"]
    prior_precision: Float[np.ndarray, "parameter parameter"]
    reflectance_share: float
    """Weight of the fit to R alone in dry matter (`ErrorModel.reflectance_share`); 0 where dry
    matter is not fitted."""
    wavelength: Float[np.ndarray, " bin"]
    """Bins that the fit stands on, or the spectra's own bands where PROSPECT is exact [nm]."""
    error: ErrorName | Literal["stated"]
    """What spectra depart from PROSPECT by."""


Prior = tuple[Float[np.ndarray, "leaf parameter"], Float[np.ndarray, "leaf parameter parameter"]]
"""Mean and precision of each leaf's prior, in unconstrained coordinates."""


def prepare(
    wavelength: Any, reflectance: Any, transmittance: Any, settings: LeafSettings
) -> tuple[
    Setup, Float[np.ndarray, "leaf 2 bin"], Bool[np.ndarray, "leaf 2 bin"], Prior, Provenance
]:
    """Constants of a fit, binned spectra, which bins to use, priors, and where leaves are from."""
    spectra = as_spectra(wavelength, reflectance, transmittance)
    centres = fit_wavelengths(spectra.wavelength, settings)
    data = binned_data(spectra, centres, settings.detector_changes)
    use = usable_bins(data, centres, settings.domain, settings.outdoor)
    setup = make_setup(settings, centres)
    return setup, data, use, leaf_priors(setup, data, use), spectra.source


def fit_wavelengths(
    grid: Float[np.ndarray, " band"], settings: LeafSettings
) -> Float[np.ndarray, " bin"]:
    """What a fit stands on [nm]: `bin_centres()`, or the bands of `grid` themselves where PROSPECT
    is exact, since the mean of its spectra over a bin is no spectrum of its.

    Raises `InputError` where no band is one of the fit's.
    """
    if not ((grid >= _USED[0]) & (grid <= _USED[1])).any():
        raise InputError(
            f"a fit needs bands within {_USED[0]:g}-{_USED[1]:g} nm, but they run from "
            f"{grid[0]:g} to {grid[-1]:g}; are they in another unit?"
        )
    if settings.error_model != "exact":
        return bin_centres()
    return grid[(grid >= _ENDS[0]) & (grid <= _ENDS[1])]


def _named_error(
    settings: LeafSettings, measurement: AbstractMeasurement, wavelength: np.ndarray
) -> tuple[AbstractMeasurement, ErrorModel, ErrorName | Literal["stated"]]:
    """The measurement with its offset, the covariance on the wavelengths, and what it is called."""
    model, own = settings.error_model, measurement.offset_deviation
    if isinstance(model, ErrorModel):
        return measurement, model, "stated"
    learned = default_error_model()
    if model != "exact":
        if model is not None:
            return _with_offset(measurement, OFFSETS[model]), learned, model
        known = [name for name, size in OFFSETS.items() if size == own]
        return measurement, learned, known[0] if known else "stated"
    # A clip's shine is part of what it reads; a calibration's offset is an error.
    measurement = _with_offset(measurement, own if measurement.shines else 0.0)
    behind = getattr(measurement, "background", None)
    if behind is not None and np.ndim(behind):  # by bin of the fit
        behind = np.interp(wavelength, bin_centres(), np.asarray(behind))
        measurement = eqx.tree_at(lambda m: m.background, measurement, behind)
    none, flat = np.zeros((0, wavelength.size)), np.full(wavelength.size, EXACT_NOISE)
    discrepancy = np.tile([-np.inf, 0.0], (len(POPULATION_TRAITS), 1))
    exact = ErrorModel(
        none, none, flat, flat, np.zeros(wavelength.size), learned.trait_correlation, discrepancy,
        np.zeros(len(POPULATION_TRAITS)), 0.0,
    )  # fmt: skip
    return measurement, exact, "exact"


def _with_offset(measurement: AbstractMeasurement, offset: float) -> AbstractMeasurement:
    return eqx.tree_at(lambda m: m.offset_deviation, measurement, offset)


def make_setup(
    settings: LeafSettings, wavelength: Float[np.ndarray, " bin"] | None = None
) -> Setup:
    """Constants of a fit on `fit_wavelengths`, by default those of the bins. Must run with 64-bit
    numbers on."""
    version, measurement, shape = settings.version, settings.measurement, settings.leaf_shape
    measurement = usual_measurement(shape) if measurement is None else measurement
    centres = bin_centres() if wavelength is None else wavelength
    measurement, model, error = _named_error(settings, measurement, centres)
    exact = error == "exact"
    leaf = ("structure", *CONSTITUENTS[version])
    usual = tuple(n for n in leaf if n != "brown_pigments")
    free = usual if settings.free is None else tuple(settings.free)
    for name in free:
        if name not in leaf:
            raise InputError(f"`free` names {name!r}, which PROSPECT-{version} does not have")
    names, free = leaf + measurement.estimated, free + measurement.estimated
    index, absorption = coefficients_at(version, centres if exact else native_wavelength())
    # Means over the bins, as spectra are fitted: `bin_centres` says what that costs.
    binned = np.vstack([index, absorption])
    binned = binned if exact else to_bins(native_wavelength(), binned)
    bounds = leaf_bounds(names)
    known = {name: _population(name) for name in names}
    optics = Optics(
        jnp.asarray(binned[1:]),
        jnp.asarray(surface_transmissivity(shape, binned[0])),
        jnp.asarray(interface_transmissivity(90.0, binned[0])),
        jnp.asarray(binned[0]),
        jnp.asarray(bounds[:, 0]),
        jnp.asarray(bounds[:, 1]),
        measurement,
    )
    # An instrument adds its offset to R alone.
    offset = np.zeros((1, 2, centres.size))
    offset[0, 0] = measurement.offset_deviation
    shared = np.stack([model.reflectance_factors, model.transmittance_factors], axis=1)
    loose = np.isin(names, free)
    # What is not free is held next to nothing: a narrow prior keeps all problems of one shape.
    middle = np.where(loose, [known[n][0] for n in names], 1e-4 * bounds[:, 1])
    spread = np.where(loose, [known[n][1] for n in names], 1e-3)
    # Carbon-based constituents are most of the dry matter, and are taken to vary as it does.
    alike = ["dry_matter" if n == "carbon_constituents" else n for n in names]
    rows = np.array([POPULATION_TRAITS.index(n) if n in POPULATION_TRAITS else -1 for n in alike])
    # Correlation of traits among leaves, for those that the error model knows.
    both = (rows >= 0) & loose
    correlation = np.eye(len(names))
    correlation[np.ix_(both, both)] = model.trait_correlation[np.ix_(rows[both], rows[both])]
    discrepancy = np.tile([-np.inf, 0.0], (len(names), 1))
    discrepancy[both] = model.trait_discrepancy[rows[both]]
    for i, name in enumerate(names):
        if loose[i] and name in ASSUMED_DISCREPANCY and not exact:
            discrepancy[i] = np.log(ASSUMED_DISCREPANCY[name]), 0.0
    prior_mean = np.asarray(to_unconstrained(jnp.asarray(middle), optics))
    if exact:  # next to nothing is too much
        prior_mean = np.where(loose, prior_mean, _NOTHING)
    return Setup(
        version,
        shape,
        names,
        free,
        optics,
        np.concatenate([shared, offset]),
        discrepancy,
        np.stack([model.reflectance_noise, model.transmittance_noise]),
        model.distrust,
        prior_mean,
        np.linalg.inv(correlation * np.outer(spread, spread)),
        model.reflectance_share if "dry_matter" in free else 0.0,
        centres,
        error,
    )


def binned_data(
    spectra: Spectra, centres: Float[np.ndarray, " bin"], detector_changes: Sequence[float] = ()
) -> Float[np.ndarray, "leaf 2 bin"]:
    """R and T on `centres`, those of the bins or some of the spectra's own bands; infinite where a
    bin holds a value that no leaf can have.

    Raises `InputError` for a spectrum in percent.
    """
    grid, labels = spectra.wavelength, spectra.source.labels
    own = np.isin(grid, centres)
    # Not `own.all()`: of few bands each may be the centre of a bin.
    binned = np.array_equal(centres, bin_centres()) and not np.array_equal(grid, centres)

    def bins(values: np.ndarray) -> np.ndarray:
        return to_bins(*to_nanometres(grid, values)) if binned else values[:, own]

    data = np.full((len(labels), 2, centres.size), np.nan)
    for number, part in enumerate((spectra.reflectance, spectra.transmittance)):
        for at in range(0, 0 if part is None else len(data), _BLOCK):
            rows = slice(at, at + _BLOCK)
            values = np.asarray(part)[rows].astype(np.float64)
            check_fractions(values, labels[rows])
            if detector_changes:
                values, _ = correct_detector_jumps(grid, values, detector_changes)
            wrong = (values < _IMPOSSIBLE[0]) | (values > _IMPOSSIBLE[1])
            data[rows, number] = bins(np.where(wrong, np.nan, values))
            if wrong.any():
                data[rows, number][bins(wrong.astype(float)) > 0] = np.inf
    return data


def usable_bins(
    data: Float[np.ndarray, "leaf 2 bin"],
    centres: Float[np.ndarray, " bin"],
    domain: str,
    outdoor: bool | None,
) -> Bool[np.ndarray, "leaf 2 bin"]:
    """Which bins enter the fit: measured, possible, 450-2400 nm, in the domain.

    With `outdoor` `None` the water bands of a spectrum are left out if they hold impossible values.
    """
    with np.errstate(invalid="ignore"):
        possible = np.isfinite(data) & (data > -0.02) & (data < 1.05)
    use = possible & (centres >= _ENDS[0]) & (centres <= _ENDS[1])
    water = inside(centres, _WATER)
    spoilt = (~np.isnan(data) & ~possible & water).any((1, 2))
    noisy = spoilt if outdoor is None else np.full(len(data), outdoor)
    use &= ~(noisy[:, None, None] & water)
    if domain == "optimal":
        use &= inside(centres, PUBLISHED_DOMAINS)
    return use


def leaf_priors(setup: Setup, data: np.ndarray, use: np.ndarray) -> Prior:
    """Prior mean and precision of each leaf.

    With R or T missing, N and the absorbers trade off against each other, and the plateau in the
    near infrared constrains N; not of a pile of leaves, nor of one over a bright background, nor
    where PROSPECT is exact.
    """
    exact = setup.error == "exact"
    # In precisions and pulls (precision times mean), which of prior and line add up.
    count, size = len(data), len(setup.names)
    band = int(np.argmin(np.abs(setup.wavelength - _LINE_BAND)))
    back, through = data[:, 0, band], data[:, 1, band]
    has_r, has_t = use[:, 0].any(1), use[:, 1].any(1)
    with np.errstate(invalid="ignore"):
        by_r = has_r & ~has_t & (back > 0.05) & (back < 0.9)
        by_t = has_t & ~has_r & (through > 0.1) & (through < 0.95)
    r, t = np.where(by_r, back, 0.4), np.where(by_t, through, 0.5)
    ratio = np.where(by_t, (1.0 - t) / t, r / (1.0 - r))
    slope, offset = np.where(by_t, np.array(_TRANSMITTANCE_LINE)[:, None],
                             np.array(_REFLECTANCE_LINE)[:, None])  # fmt: skip
    low, high = leaf_bounds(["structure"])[0]
    # What the line says beyond the bounds counts as at their edge, where its weight is small.
    unit = np.clip((slope * ratio + offset - low) / (high - low), 0.02, 0.98)
    # A deviation of N, carried to the logit of its place between the bounds.
    deviation = _LINE_DEVIATION / ((high - low) * unit * (1.0 - unit))
    known = "structure" in setup.free and setup.optics.measurement.leaf_alone and not exact
    weight = np.where((by_r | by_t) & known, deviation**-2.0, 0.0)
    precision = np.tile(setup.prior_precision, (count, 1, 1))
    pull = np.tile(setup.prior_precision @ setup.prior_mean, (count, 1))
    precision[:, 0, 0] += weight
    pull[:, 0] += weight * np.log(unit / (1.0 - unit))
    for name, none in (("gap_fraction", 0.0), ("background", 1e-3), ("recollision", 1e-3)):
        if name in setup.names:
            # Without transmittance nothing identifies them: taken for one leaf over black.
            at, (low, high) = setup.names.index(name), leaf_bounds([name])[0]
            unit = (none - low) / (high - low)
            weight = np.where(has_t, 0.0, 1e4 / (EXACT_NOISE**2 if exact else 1.0))
            precision[:, at, at] += weight
            pull[:, at] += weight * np.log(unit / (1.0 - unit))
    mean = np.linalg.solve(precision, pull[:, :, None])[:, :, 0]
    return mean.reshape(count, size), precision


def leaf_problems(
    setup: Setup, data: np.ndarray, use: np.ndarray, prior: Prior, inflation: np.ndarray
) -> MeasuredLeaf:
    """The problems of leaves as NumPy arrays with the leaf as first axis."""
    precision = np.where(use, 1.0 / (setup.noise**2 + setup.distrust**2), 0.0)
    return MeasuredLeaf(np.where(use, data, 0.0), precision, inflation, *prior)

"""Simulated against measured spectra of many plots: agreement, baselines, skill."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
from jaxtyping import Bool, Float
from scipy.special import stdtrit

from fynjax.metrics import SPECTRAL_REGIONS, misfit_decomposition, spectral_agreement, spectral_mask

MODEL, OTHERS, FLAT, FLIGHT = "model", "mean of other plots", "flat spectrum", "another flight"
"""Names of predictors of a plot's spectrum."""
PREDICTORS = {
    MODEL: "simulated from the plot's tables alone",
    OTHERS: "the mean measured spectrum of all other plots: knows fynbos, not the plot",
    FLAT: "one number for all bands, the mean of all other plots: knows nothing",
    FLIGHT: "one flight over the plot against the mean of its other flights: how well the "
    "measurement repeats itself",
}
"""What is compared with a plot's measured spectrum."""

MEASURES = ("spectral_angle", "rmse", "nrmse", "correlation", "relative_mean_difference")
"""How well two spectra agree."""


@dataclass(frozen=True)
class PlotSpectraPair:
    """Simulated and measured spectra of plots, on one grid."""

    plots: tuple[str, ...]
    wavelength: Float[np.ndarray, " band"]
    """Band centres [nm], without water windows and the sensor's edges."""
    simulated: Float[np.ndarray, "plot band"]
    """Simulated reflectance of each plot [-]."""
    flights: tuple[Float[np.ndarray, "flight band"], ...]
    """Measured spectra of each plot; none where nobody measured."""

    @property
    def measured(self) -> Float[np.ndarray, "plot band"]:
        """Mean of each plot's flights; NaN where a flight has no value, or there is none."""
        none = np.full(self.wavelength.size, np.nan)
        return np.stack([f.mean(axis=0) if len(f) else none for f in self.flights])

    def those_measured(self) -> "PlotSpectraPair":
        """The plots that have a measured spectrum."""
        keep = [i for i, flights in enumerate(self.flights) if len(flights)]
        return PlotSpectraPair(
            tuple(self.plots[i] for i in keep),
            self.wavelength,
            self.simulated[keep],
            tuple(self.flights[i] for i in keep),
        )


def leave_one_out(spectra: Float[np.ndarray, "plot band"]) -> Float[np.ndarray, "plot band"]:
    """Mean of all other spectra, for each spectrum.

    **Arguments:** `spectra`: in any unit, NaN where missing.

    **Returns:** the same shape and unit; NaN where there is no other value.

    >>> import numpy as np
    >>> from fynjax.app.compare import leave_one_out
    >>> leave_one_out(np.array([[1.0], [2.0], [6.0]]))
    array([[4. ],
           [3.5],
           [1.5]])
    """
    there = np.isfinite(spectra)
    total = np.where(there, spectra, 0.0).sum(axis=0) - np.where(there, spectra, 0.0)
    count = there.sum(axis=0) - there
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)


def predictions(pair: PlotSpectraPair) -> dict[str, Float[np.ndarray, "plot band"]]:
    """Spectra that each of `PREDICTORS` but the flights expects of the plots that were measured."""
    expected = {MODEL: pair.simulated}
    if len(pair.plots) > 1:
        expected[OTHERS] = leave_one_out(pair.measured)
        flat = np.nanmean(expected[OTHERS], axis=1, keepdims=True)
        expected[FLAT] = np.broadcast_to(flat, expected[OTHERS].shape)
    return expected


def agreement_table(pair: PlotSpectraPair) -> pd.DataFrame:
    """Agreement by plot, predictor (`PREDICTORS`) and region.

    The measures are those of `fynjax.metrics.spectral_agreement`. Of the flights the values are
    means over a plot's flights.

    **Arguments:** `pair`: plots that were all measured (`PlotSpectraPair.those_measured`).

    **Returns:** a row for each plot, predictor and region: spectral angle [degree], rmse [-], nrmse
    [-], correlation [-], relative difference of the means [-].

    >>> import numpy as np
    >>> from fynjax.app.compare import PlotSpectraPair, agreement_table
    >>> wavelength = np.linspace(500.0, 700.0, 21)
    >>> measured = np.linspace(0.05, 0.15, 21)
    >>> pair = PlotSpectraPair(("A",), wavelength, measured[None] + 0.01, (measured[None],))
    >>> table = agreement_table(pair)
    >>> table["region"].tolist()
    ['full', 'vnir']
    >>> round(float(table["rmse"][0]), 4)
    0.01
    """
    real, grid = pair.measured, pair.wavelength
    within = {n: (grid >= low) & (grid <= high) for n, (low, high) in SPECTRAL_REGIONS.items()}
    regions = {name: spectral_mask(grid, name) for name, of in within.items() if of.sum() > 2}
    rows = [
        _agreement(pair.plots, predictor, region, real, expected, mask)
        for predictor, expected in predictions(pair).items()
        for region, mask in regions.items()
    ]
    repeated = [(n, f) for n, f in zip(pair.plots, pair.flights) if len(f) > 1]
    for region, mask in regions.items() if repeated else ():
        names = [name for name, flights in repeated for _ in flights]
        single = np.concatenate([flights for _, flights in repeated])
        rest = np.concatenate([leave_one_out(flights) for _, flights in repeated])
        each = _agreement(names, FLIGHT, region, rest, single, mask)
        rows.append(each.groupby(["plot", "predictor", "region"], as_index=False).mean())
    return pd.concat(rows, ignore_index=True)


def _agreement(
    plots: tuple[str, ...] | list[str],
    predictor: str,
    region: str,
    real: Float[np.ndarray, "plot band"],
    expected: Float[np.ndarray, "plot band"],
    mask: Bool[np.ndarray, " band"],
) -> pd.DataFrame:
    valid = mask & np.isfinite(real) & np.isfinite(expected)
    agreement = jax.vmap(spectral_agreement)(jnp.asarray(real), jnp.asarray(expected), valid)
    return pd.DataFrame(
        {"plot": list(plots), "predictor": predictor, "region": region}
        | {name: np.asarray(getattr(agreement, name)) for name in MEASURES}
    )


def mean_agreement(table: pd.DataFrame) -> pd.DataFrame:
    """Means of an agreement over the plots, with the number of plots and the skill.

    Skill is 1 - MSE of the predictor / MSE of the mean of the other plots, over all plots: 1 is
    perfect, 0 no better than that mean, below 0 worse (Murphy 1988, Monthly Weather Review
    116:2417). Flights have none.

    **Arguments:** `table`: as of `agreement_table`.

    **Returns:** a row for each predictor and region, in the units of `table`.
    """
    keys = ["predictor", "region"]
    mean = table.groupby(keys, sort=False)[list(MEASURES)].mean()
    mean["plots"] = table.groupby(keys, sort=False).size()
    square = (table["rmse"] ** 2).groupby([table[k] for k in keys], sort=False).mean()
    base = square.get(OTHERS, pd.Series(dtype=float))
    # A flight is compared with other flights, not with the plot's mean: it has no such skill.
    mean["skill"] = [
        np.nan if key[0] == FLIGHT else 1.0 - square[key] / base.get(key[1], np.nan)
        for key in mean.index
    ]
    return mean.reset_index()


def misfit_table(pair: PlotSpectraPair) -> pd.DataFrame:
    """Level, contrast and shape of each plot's misfit, over all regions (`misfit_decomposition`).

    **Arguments:** `pair`: plots that were all measured.

    **Returns:** a row for each plot: rmse [-], gain [-], offset [-], and shares of the mean squared
    error [-].
    """
    mask = spectral_mask(pair.wavelength)
    real, simulated = jnp.asarray(pair.measured), jnp.asarray(pair.simulated)
    misfit = jax.vmap(misfit_decomposition)(real, simulated, mask & np.isfinite(pair.measured))
    shares = np.asarray(jax.vmap(lambda plot: plot.shares)(misfit))
    return pd.DataFrame(
        {
            "plot": list(pair.plots),
            "rmse": np.sqrt(np.asarray(misfit.mean_squared_error)),
            "gain": np.asarray(misfit.gain),
            "offset": np.asarray(misfit.offset),
            "level_share": shares[:, 0],
            "contrast_share": shares[:, 1],
            "shape_share": shares[:, 2],
        }
    )


def band_table(pair: PlotSpectraPair) -> pd.DataFrame:
    """Means, errors and the correlation across plots, by band.

    **Arguments:** `pair`: plots that were all measured.

    **Returns:** a row for each band: `wavelength_nm`; `measured`, `simulated`, means over the plots
    [-]; `residual`, its mean, and `residual_sd` [-]; `rmse_model`, `rmse_others`, errors of the
    model and of the mean of the other plots [-]; `flight_sd`, standard deviation of a plot's
    flights (root mean square over the plots) [-]; `correlation` of simulated with measured across
    plots [-].
    """
    real, simulated = pair.measured, pair.simulated
    residual = simulated - real
    noise = [f.var(axis=0, ddof=1) for f in pair.flights if len(f) > 1]
    blank = np.full(pair.wavelength.size, np.nan)
    several = len(pair.plots) > 1
    return pd.DataFrame(
        {
            "wavelength_nm": pair.wavelength,
            "measured": np.nanmean(real, axis=0),
            "simulated": simulated.mean(axis=0),
            "residual": np.nanmean(residual, axis=0),
            "residual_sd": np.nanstd(residual, axis=0, ddof=1) if several else blank,
            "rmse_model": np.sqrt(np.nanmean(residual**2, axis=0)),
            "rmse_others": np.sqrt(np.nanmean((leave_one_out(real) - real) ** 2, axis=0))
            if several
            else blank,
            "flight_sd": np.sqrt(np.nanmean(noise, axis=0)) if noise else blank,
            "correlation": _across(simulated, real) if len(pair.plots) > 2 else blank,
        }
    )


def _across(
    simulated: Float[np.ndarray, "plot band"], real: Float[np.ndarray, "plot band"]
) -> Float[np.ndarray, " band"]:
    known = [np.where(np.isfinite(real), values, np.nan) for values in (simulated, real)]
    a, b = (np.nan_to_num(values - np.nanmean(values, axis=0)) for values in known)
    size = np.sqrt((a**2).sum(axis=0) * (b**2).sum(axis=0))
    return np.where(size > 0, (a * b).sum(axis=0) / np.where(size > 0, size, 1.0), np.nan)


def chance_correlation(plots: int) -> float:
    """Correlation whose size chance alone exceeds in 1 of 20 sets of independent plots [-].

    From Student's t with `plots` - 2 degrees of freedom, two-sided.

    **Arguments:** `plots`: number of plots, above 2.

    >>> from fynjax.app.compare import chance_correlation
    >>> round(chance_correlation(20), 3)
    0.444
    """
    t = stdtrit(plots - 2, 0.975)
    return float(t / np.sqrt(plots - 2 + t**2))


Feature = Callable[[Callable[[float], np.ndarray]], np.ndarray]
FEATURES: Mapping[str, tuple[str, Feature]] = {
    "red": ("reflectance at 670 nm", lambda at: at(670)),
    "nir": ("reflectance at 860 nm", lambda at: at(860)),
    "swir1": ("reflectance at 1650 nm", lambda at: at(1650)),
    "swir2": ("reflectance at 2200 nm", lambda at: at(2200)),
    "ndvi": ("NDVI of 860 and 670 nm", lambda at: (at(860) - at(670)) / (at(860) + at(670))),
    "ndwi": ("NDWI of 860 and 1240 nm", lambda at: (at(860) - at(1240)) / (at(860) + at(1240))),
    "brownness": ("reflectance at 1240 over 780 nm", lambda at: at(1240) / at(780)),
}
"""What an ecologist would read from a spectrum: name, in words, and how."""


def feature_values(
    wavelength: Float[np.ndarray, " band"], spectra: Float[np.ndarray, "plot band"]
) -> dict[str, Float[np.ndarray, " plot"]]:
    """`FEATURES` of each spectrum.

    **Arguments:**

    - `wavelength`: band centres [nm].
    - `spectra`: reflectance [-], NaN where missing; the mean within 10 nm is taken.

    **Returns:** for each feature a value a plot [-].
    """

    def at(centre: float) -> np.ndarray:
        near = np.abs(wavelength - centre) <= 10.0
        near[np.abs(wavelength - centre).argmin()] = True
        return np.nanmean(spectra[:, near], axis=1)

    return {name: how(at) for name, (_, how) in FEATURES.items()}


def feature_table(pair: PlotSpectraPair) -> pd.DataFrame:
    """How well the model distinguishes plots: correlations of `FEATURES` across plots.

    **Arguments:** `pair`: plots that were all measured.

    **Returns:** a row for each feature: means and standard deviations over the plots [-],
    correlation and rank correlation (Spearman) of simulated with measured [-].
    """
    from scipy.stats import spearmanr  # late: it takes half a second

    real, simulated = (feature_values(pair.wavelength, s) for s in (pair.measured, pair.simulated))
    rows = []
    for name, (what, _) in FEATURES.items():
        x, y = real[name], simulated[name]
        several = len(x) > 2 and np.ptp(x) > 0 and np.ptp(y) > 0
        rows.append(
            {
                "feature": what,
                "measured": x.mean(),
                "simulated": y.mean(),
                "measured_sd": x.std(ddof=1) if len(x) > 1 else np.nan,
                "simulated_sd": y.std(ddof=1) if len(x) > 1 else np.nan,
                "correlation": np.corrcoef(x, y)[0, 1] if several else np.nan,
                "rank_correlation": spearmanr(x, y).statistic if several else np.nan,
            }
        )
    return pd.DataFrame(rows)

"""What a fit of leaves found: as arrays, a table, a dataset, a figure and sentences."""

import enum
from collections import Counter
from datetime import UTC, datetime
from importlib.metadata import version
from typing import TYPE_CHECKING, Any, Literal

import equinox as eqx
import numpy as np
import pandas as pd
from jaxtyping import Bool, Float, Int

from fynjax._core.errors import InputError, did_you_mean
from fynjax.leaf._area import LeafArea, LeafShape, area_factors
from fynjax.leaf._coefficients import ProspectVersion
from fynjax.leaf._error_model import ErrorName
from fynjax.leaf._parameters import LEAF_PARAMETERS, LeafParameters
from fynjax.leaf._spectra import SpectraSource

if TYPE_CHECKING:
    import xarray as xr

NINETY_PERCENT = 1.6448536269514722
_SHOWN_STATUS = 5


class LeafStatus(enum.IntEnum):
    """Whether a leaf's fit converged, or the first reason to doubt it."""

    converged = 0
    poor_fit = 1
    at_bound = 2
    max_steps = 3
    failed = 4
    unusual = 5


_SENTENCES = {
    LeafStatus.converged: "converged",
    LeafStatus.poor_fit: "converged, poor fit: unlike any leaf of the error model",
    LeafStatus.unusual: "converged, unusual traits: like none of the leaves of the error model",
    LeafStatus.at_bound: "at bound: ",
    LeafStatus.max_steps: "not converged: iteration limit reached",
    LeafStatus.failed: "failed: fewer than ten usable bands within 450-2400 nm",
}
_POOR_EXACT = "converged, poor fit: no spectrum of PROSPECT"


class LeafFit(eqx.Module):
    """Parameters, spectra and uncertainties that `fit_leaf` estimates for each leaf.

    The most probable parameters under a Gaussian error with covariance along the wavelength
    (`ErrorModel`), the measurement's offset, and wide priors on leaves at large; if T is missing,
    N also has the prior 1.745 R / (1 - R) + 0.133 at 1130 nm (after Spafford et al. 2021), with a
    standard deviation of 0.2, and if R is missing a similar prior in (1 - T) / T. A leaf that
    fits worse than the leaves of the error model has its covariance scaled up (one step of a
    Student likelihood) and is fitted again. Where T was measured, and R from 1700 to 2400 nm, dry
    matter is a weighted mean (of logits) with what R alone says (`ErrorModel.reflectance_share`):
    on campaigns left out that is nearer to what laboratories measured. The spectra are those before
    it, so PROSPECT of `parameters` differs a little from `fitted`.

    There are two intervals. `standard_deviation`, `lower` and `upper` are of the trait a laboratory
    would measure: they include the part of its variance that spectra do not explain
    (`ErrorModel.trait_discrepancy`). `prospect_deviation`, `prospect_lower` and `prospect_upper`
    are of the trait that PROSPECT has of this leaf, without that part: those to use where PROSPECT
    of the leaf goes on into a canopy. With `error_model="exact"` both are the same.

    Spectra are used from 450 to 2400 nm (PROSPECT has no data below 400 nm, and instruments are
    noisy at both ends), by straight lines in steps of 1 nm and as means in bins of 5 and 10 nm,
    with `error_model="exact"` as they are. A leaf with fewer than ten usable bins has NaN, and its
    `status` says so.
    """

    parameters: LeafParameters
    """Most probable parameters, each a vector [leaf]."""
    names: tuple[str, ...] = eqx.field(static=True)
    """Names of the fitted parameters, in the order of the arrays below."""
    standard_deviation: Float[np.ndarray, "leaf parameter"]
    """Standard deviation of each parameter as a laboratory would measure it, in its unit."""
    covariance: Float[np.ndarray, "leaf parameter parameter"]
    """Covariance of the parameters, in their units."""
    lower: Float[np.ndarray, "leaf parameter"]
    """Lower end of the 90 % interval of what a laboratory would measure."""
    upper: Float[np.ndarray, "leaf parameter"]
    """Upper end of the 90 % interval of what a laboratory would measure."""
    prospect_deviation: Float[np.ndarray, "leaf parameter"]
    """Standard deviation of each parameter as PROSPECT has it, in its unit."""
    prospect_lower: Float[np.ndarray, "leaf parameter"]
    """Lower end of the 90 % interval of PROSPECT's own trait. It stands about what explains the
    spectra: of dry matter from R and T before it is moved."""
    prospect_upper: Float[np.ndarray, "leaf parameter"]
    """Upper end of the 90 % interval of PROSPECT's own trait."""
    wavelength: Float[np.ndarray, " bin"]
    """Bins on which the fit stands, or the bands themselves where PROSPECT is exact [nm]."""
    measured: Float[np.ndarray, "leaf 2 bin"]
    """Recorded R and T on the bins; NaN where missing or left out of the fit [-]."""
    fitted: Float[np.ndarray, "leaf 2 bin"]
    """The model's R and T as the instrument would record them, with the offset of R [-]."""
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
    """Factor on the error covariance because the leaf fits worse than those it stems from; where
    PROSPECT is exact, on the variance of computed spectra, 1e-12 [-]."""
    converged: Bool[np.ndarray, " leaf"]
    """Whether the iteration reached its tolerance."""
    reason: Int[np.ndarray, " leaf"]
    """`LeafStatus` of each leaf."""
    at_bound: Bool[np.ndarray, "leaf parameter"]
    """Whether a parameter is within 1 % of its range from its upper bound."""
    prior_share: Float[np.ndarray, "leaf parameter"]
    """Variance of each parameter, as far as spectra explain it, over that in the population: near 0
    the spectrum decides, near 1 the prior [-]."""
    offset: Float[np.ndarray, " leaf"]
    """Most probable offset of R, the same at all bands: shine under a clip, or a calibration's
    error. A part of what looks like it may be PROSPECT's error [-]."""
    offset_deviation: Float[np.ndarray, " leaf"]
    """Standard deviation of `offset` [-]."""
    measurement: Float[np.ndarray, "leaf estimated"]
    """Estimates of the measurement, such as the gap fraction (see `estimated`); NaN where
    there is no transmittance, which alone shows it."""
    measurement_deviation: Float[np.ndarray, "leaf estimated"]
    """Standard deviation of `measurement`."""
    estimated: tuple[str, ...] = eqx.field(static=True)
    """Names of what was estimated of the measurement."""
    version: ProspectVersion = eqx.field(static=True)
    """Version of PROSPECT."""
    leaf_shape: LeafShape = eqx.field(static=True)
    """Shape that the leaves were taken to have."""
    error_model: ErrorName | Literal["stated"] = eqx.field(static=True)
    """What spectra were taken to depart from PROSPECT by: "exact", "laboratory", "field", or
    "stated" by a covariance or an offset."""
    source: SpectraSource = eqx.field(static=True)
    """Label of each leaf, and of spectra from files the file and what was repaired."""

    @property
    def status(self) -> tuple[str, ...]:
        """`converged`, or the reason to doubt the result, for each leaf."""
        said = _SENTENCES
        if self.error_model == "exact":
            said = said | {LeafStatus.poor_fit: _POOR_EXACT}
        sentences = [said[LeafStatus(code)] for code in self.reason.tolist()]
        for i in np.flatnonzero(self.reason == LeafStatus.at_bound):
            bounded = [name for name, at in zip(self.names, self.at_bound[i]) if at]
            sentences[i] += ", ".join(bounded)
        return tuple(sentences)

    @property
    def labels(self) -> tuple[str, ...]:
        """Name of each leaf, of the table, dataset or file it came from."""
        return self.source.labels

    def table(self, area: LeafArea = "projected") -> pd.DataFrame:
        """Traits of the leaves, one row for each.

        **Arguments:** `area` that contents are stated per: "projected", or "half_total", half of
        the leaf's surface (`area_factors`).

        **Returns:** file (of spectra from files), name, parameters in the units of
        `LeafParameters`, which `table.attrs["units"]` has by column, their standard deviations and
        the ends of their 90 % intervals as a laboratory would measure them, and the ends of those
        of PROSPECT's own traits; what was estimated of the measurement and the offset of R, rmse of
        the fit, inflation of the error, the area and the error model, traits that the prior
        decides, status in words, and repairs.
        """
        factors, units = area_factors(area, self.leaf_shape), dict[str, str]()
        columns: dict[str, Any] = {"file": list(self.source.files)} if self.source.files else {}
        columns["name"] = list(self.labels)
        for i, name in enumerate(self.names):
            own = {
                name: np.asarray(getattr(self.parameters, name)),
                f"{name}_sd": self.standard_deviation[:, i],
                f"{name}_lower90": self.lower[:, i],
                f"{name}_upper90": self.upper[:, i],
                f"{name}_prospect_lower90": self.prospect_lower[:, i],
                f"{name}_prospect_upper90": self.prospect_upper[:, i],
            }
            columns |= {key: factors[name] * values for key, values in own.items()}
            units |= dict.fromkeys(own, LEAF_PARAMETERS[name].unit)
        for i, name in enumerate(self.estimated):
            columns[name] = self.measurement[:, i]
            columns[f"{name}_sd"] = self.measurement_deviation[:, i]
        columns |= {
            "offset": self.offset,
            "offset_sd": self.offset_deviation,
            "rmse": self.rmse,
            "error_model": self.error_model,
            "error_inflation": self.inflation,
            "area": area,
            "prior_decides": [", ".join(names) for names in self._left_to_the_prior()],
            "status": list(self.status),
        }
        if self.source.repairs:
            columns["repairs"] = list(self.source.repairs)
        table = pd.DataFrame(columns)
        table.attrs["units"] = units
        return table

    def _left_to_the_prior(self) -> list[list[str]]:
        """Traits of each leaf of whose prior variance the spectrum leaves more than half.

        Anthocyanins are not named: of a green leaf a spectrum says no more than that they are few.
        """
        named = ~np.isin(self.names, ("structure", "anthocyanins"))
        return [list(np.array(self.names)[named & (share > 0.5)]) for share in self.prior_share]

    def to_xarray(self, area: LeafArea = "projected") -> "xr.Dataset":
        """Measured, fitted and predicted spectra of the leaves, and their traits.

        **Arguments:** `area` that contents are stated per, as of `table`.

        **Returns:** reflectance and transmittance [leaf, wavelength] as fractions [-], with the
        90 % interval of transmittance; traits [leaf] in the units of `LeafParameters`, with the
        standard deviations of what a laboratory would measure and of PROSPECT's own traits, and
        what was estimated of the measurement [-]; wavelength in nm. CF conventions.
        """

        wide = NINETY_PERCENT * self.transmittance_deviation
        low, high = (np.clip(self.transmittance + sign * wide, 0, 1) for sign in (-1, 1))
        what = "end of the 90 % interval of leaf transmittance"
        spectra = {
            "measured_reflectance": (self.measured[:, 0], "recorded reflectance used by the fit"),
            "measured_transmittance": (
                self.measured[:, 1], "recorded transmittance used by the fit"
            ),
            "fitted_reflectance": (
                self.fitted[:, 0], "reflectance of the fitted measurement model"
            ),
            "fitted_transmittance": (
                self.fitted[:, 1], "transmittance of the fitted measurement model"
            ),
            "reflectance": (self.reflectance, "reflectance of one leaf"),
            "transmittance": (self.transmittance, "transmittance of one leaf, if not measured too"),
            "transmittance_lower90": (low, f"lower {what}"),
            "transmittance_upper90": (high, f"upper {what}"),
        }  # fmt: skip
        variables: dict[str, Any] = {
            key: (("leaf", "wavelength"), values, {"units": "1", "long_name": text})
            for key, (values, text) in spectra.items()
        }
        table, factors = self.table(area), area_factors(area, self.leaf_shape)
        for i, name in enumerate(self.names):
            own = f"{name}_prospect_sd"
            table[own] = factors[name] * self.prospect_deviation[:, i]
            attributes = {
                "units": cf_unit(name),
                "long_name": f"standard deviation of PROSPECT's {name.replace('_', ' ')}",
            }
            variables[own] = ("leaf", table[own].to_numpy(), attributes)
        for name in (*self.names, *self.estimated, "offset"):
            words = "offset of reflectance" if name == "offset" else name.replace("_", " ")
            for key, text in ((name, words), (f"{name}_sd", f"standard deviation of {words}")):
                attributes = {"units": cf_unit(name), "long_name": text}
                variables[key] = ("leaf", table[key].to_numpy(), attributes)
        return leaf_dataset(
            variables, self.wavelength, self.source, self.status,
            "Leaf spectra and traits fitted with PROSPECT",
            prospect_version=self.version, leaf_shape=self.leaf_shape, area=area,
            error_model=self.error_model,
        )  # fmt: skip

    def plot(self, leaf: str | int = 0, axes: Any = None) -> Any:
        """Draw what was measured and fitted of a leaf, and what the fit leaves.

        R stands from below and 1 - T from above, with its 90 % interval.

        **Arguments:**

        - `leaf`: its label, or its place from 0.
        - `axes`: of matplotlib, in which spectra are drawn without what is left; both in a new
          figure by default.

        **Returns:** the axes, of the spectra and of what is left.

        **Raises:** `InputError` for a leaf that there is not.
        """
        at = self._place(leaf)
        inside = (self.wavelength >= 445.0) & (self.wavelength <= 2405.0)
        grid = self.wavelength[inside]
        (r, t), (model_r, model_t) = self.measured[at][:, inside], self.fitted[at][:, inside]
        through = 1.0 - self.transmittance[at][inside]
        wide = NINETY_PERCENT * self.transmittance_deviation[at][inside]
        panels = [axes]
        if axes is None:
            blank = pd.DataFrame(np.nan, grid, ["spectra", "left"])  # makes a figure of two panels
            panels = list(blank.plot(subplots=True, sharex=True, legend=False, figsize=(7, 5)))
            for panel in panels:
                panel.lines[0].remove()
            panels[0].set(ylabel="share of the light [-]", title=f"{self.labels[at]}")
            panels[1].set(ylabel="measured - model [-]", xlabel="wavelength [nm]")
            panels[1].axhline(0.0, color="0.7", lw=0.8)
            panels[1].plot(grid, r - model_r, "k.", ms=2.5, label="R")
        panel = panels[0]
        low, high = (np.clip(through + sign * wide, 0.0, 1.0) for sign in (-1, 1))
        blue, name = "tab:blue", "1 - T of one leaf" if self.estimated else "1 - T of leaf"
        green = "R of model" if self.error_model == "exact" else "R of model, with offset"
        panel.fill_between(grid, low, high, color=blue, alpha=0.25, lw=0,
                           label="90 % interval of 1 - T")  # fmt: skip
        panel.plot(grid, through, color=blue, label=name)
        panel.plot(grid, model_r, color="tab:green", label=green)
        panel.plot(grid, r, "k.", ms=2.5, label="R measured")
        if np.isfinite(t).any():
            if self.estimated:
                panel.plot(grid, 1.0 - model_t, "--", color="tab:purple",
                           label="1 - T of model, with gaps")  # fmt: skip
            panel.plot(grid, 1.0 - t, ".", color="0.45", ms=2.5, label="1 - T measured")
            if axes is None:
                panels[1].plot(grid, t - model_t, ".", color="0.45", ms=2.5, label="T")
        panel.set(xlim=(400, 2450), ylim=(0, 1))
        if axes is None:
            for panel in panels:
                panel.legend(frameon=False, fontsize=8)
        return panels

    def plot_traits(self, laboratory: pd.DataFrame) -> Any:
        """Draw traits with their 90 % intervals against what a laboratory measured of the leaves.

        **Arguments:** `laboratory`, a row for each leaf by its label, a column for each trait by
        the parameter's name and in its unit (`table().attrs["units"]`); NaN where not measured.

        **Returns:** the axes, one of each trait, in a new figure. Titles say how many of the
        laboratory's values lie within the intervals.

        **Raises:** `InputError` for a table without any of the traits, or of no leaf of the fit.
        """
        names = [name for name in self.names if name in laboratory]
        known = laboratory[names].reindex(self.labels)
        if not names or known.isna().all(axis=None):
            raise InputError(
                f"expected rows such as {self.labels[0]!r} with columns such as {self.names[1]!r}, "
                f"but the laboratory's table has rows {list(laboratory.index)[:3]} and columns "
                f"{list(laboratory.columns)[:3]}"
            )
        blank = pd.DataFrame(np.nan, [0.0], names)  # makes a figure of as many panels
        size = (2.8 * len(names), 3.0)
        options: dict[str, Any] = {"layout": (1, len(names)), "sharex": False, "figsize": size}
        panels = list(blank.plot(subplots=True, legend=False, **options).ravel())
        table, units = self.table(), self.table().attrs["units"]
        for name, panel in zip(names, panels, strict=True):
            panel.lines[0].remove()
            low, high = (table[f"{name}_{end}90"].to_numpy() for end in ("lower", "upper"))
            found, truth = table[name].to_numpy(), known[name].to_numpy(float)
            panel.errorbar(truth, found, yerr=[found - low, high - found], fmt="o", ms=4)
            panel.axline((0.0, 0.0), slope=1.0, color="0.6", lw=0.8)
            inside, count = int(((low <= truth) & (truth <= high)).sum()), np.isfinite(truth).sum()
            panel.set(
                xlim=(0, None), ylim=(0, None), xlabel=f"laboratory [{units[name]}]",
                title=f"{name.replace('_', ' ')}\n{inside} of {count} within 90 %",
            )  # fmt: skip
        panels[0].set_ylabel("fitted")
        panels[0].figure.set_layout_engine("constrained")
        return panels

    def _place(self, leaf: str | int) -> int:
        if isinstance(leaf, str) and leaf in self.labels:
            return self.labels.index(leaf)
        if isinstance(leaf, int) and -len(self.labels) <= leaf < len(self.labels):
            return leaf
        raise InputError(
            f"expected the label of a leaf, or its place of 0 to {len(self.labels) - 1}, but got "
            f"{leaf!r}.{did_you_mean(str(leaf), self.labels)}"
        )

    def __str__(self) -> str:
        """How many leaves converged, the range of each trait, and what the prior says."""
        count = len(self.labels)
        many = f"{count} leaves" if count > 1 else f"The leaf {self.labels[0]!r}"
        kinds = Counter(self.status).most_common()
        said = [f"{number} {text}" if count > 1 else text for text, number in kinds[:_SHOWN_STATUS]]
        if len(kinds) > _SHOWN_STATUS:
            said.append("others see `table()`")
        lines = [f"{many} fitted with PROSPECT-{self.version}: {'; '.join(said)}."]
        table = self.table()
        for name in (*self.names, *self.estimated):
            unit = table.attrs["units"].get(name, "-")
            values = table[[name, f"{name}_sd"]].dropna().to_numpy().T
            own = ""
            if name in self.names and values.size:
                spread = np.nanmedian(self.prospect_deviation[:, self.names.index(name)])
                if spread < 0.99 * np.median(values[1]):  # of N no laboratory knows
                    own = f" as a laboratory measures it, {spread:.2g} as PROSPECT has it"
            if values.size:
                low, high = values[0].min(), values[0].max()
                span = f"{low:.3g} to {high:.3g}" if count > 1 else f"{low:.3g}"
                lines.append(
                    f"  {name} {span}{'' if unit == '-' else f' {unit}'}, standard deviation "
                    f"{np.median(values[1]):.2g}{own}{' (medians)' if count > 1 else ''}"
                )
        left = Counter(name for names in self._left_to_the_prior() for name in names)
        if left:
            many = ", ".join(f"{k} ({n})" if count > 1 else k for k, n in left.items())
            lines.append(f"The prior says more than the spectrum of {many}.")
        return "\n".join(lines)


def cf_unit(name: str) -> str:
    """Unit of a parameter as the CF conventions write it."""
    unit = LEAF_PARAMETERS[name].unit if name in LEAF_PARAMETERS else "-"
    return "1" if unit == "-" else unit


def leaf_dataset(
    variables: dict[str, Any],
    wavelength: Float[np.ndarray, " bin"],
    source: SpectraSource,
    status: Any,
    title: str,
    **settings: str,
) -> "xr.Dataset":
    """A dataset by leaf and bin, with the status and file of each leaf, after the CF conventions.

    `settings`, how it was made, become attributes.
    """
    import xarray as xr  # late: the command line need not wait for it

    variables = {**variables, "status": ("leaf", np.array(status, object))}
    if source.files:
        variables["file"] = ("leaf", np.array(source.files, object))
    attributes = {
        "units": "nm", "standard_name": "radiation_wavelength", "long_name": "bin centre"
    }  # fmt: skip
    return xr.Dataset(
        variables,
        {
            "wavelength": ("wavelength", wavelength, attributes),
            "leaf": ("leaf", np.array(source.labels, object)),
        },
        {
            "Conventions": "CF-1.11",
            "title": title,
            "source": f"fynjax {version('fynjax')}",
            "history": f"{datetime.now(UTC).isoformat(timespec='seconds')} fynjax",
            **settings,
        },
    )

"""Prior files: what plots share, and how they vary, as `fynjax bioscape learn` finds it."""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from jaxtyping import Float
from pydantic import Field, model_validator

from fynjax._core.errors import did_you_mean
from fynjax._core.math import symmetric_power
from fynjax._core.seeds import generator
from fynjax.app.io.text import Strict, in_unit, read_toml, shipped_or_own, write_text
from fynjax.canopy import FORMS
from fynjax.scene import PARAMETERS, ModelError

DATA = Path(__file__).parent / "data"
SHIPPED_PRIORS = ("fynbos_2023",)
"""Names of the priors that ship."""
DEFAULT_PRIOR, NO_PRIOR = "fynbos_2023", "none"
"""Name of the prior that ships, and of none."""

LEAFY_FORMS = tuple(name for name, form in FORMS.items() if form.leafy)
"""Growth forms with leaves."""
BY_FORM = ("dead_fraction", "leaf_area_index", "shoot_clumping")
"""What each growth form has a value of, in its own unit."""
FACTORS = {
    "chlorophyll": "factor on chlorophyll and carotenoids of all leaves",
    "structure": "factor on PROSPECT's N of all leaves",
    "leaf_mass_per_area": "factor on dry matter of all leaves, water in proportion",
    "water_per_dry_matter": "factor on water of all leaves, dry matter as it is",
    "soil_brightness": "factor on the soil's reflectance",
    "wood_brightness": "factor on the reflectance of bark, deadwood and dead tissue of shoots",
}
"""Factors that all species of a plot share [-]."""
PRIOR_PARAMETERS = {
    **{
        f"{kind}.{form}": f"{PARAMETERS[kind].name} of the growth form {form}"
        for kind in BY_FORM
        for form in LEAFY_FORMS
    },
    **FACTORS,
}
"""Parameters of a plot that a population sets, and what each is."""


class PriorParameter(Strict):
    """A parameter of the population."""

    name: str
    """Name of the parameter, such as 'dead_fraction.tussock' or 'structure'."""
    mean: float = in_unit("-")
    """Value of the mean plot [-]."""
    mean_sd: float = in_unit("-", ge=0)
    """Standard error of `mean` [-]."""
    plot_sd: float = in_unit("-", ge=0)
    """Standard deviation between plots; 0 of what they share [-]."""
    assumed: float = in_unit("-")
    """What was assumed before any spectrum [-]."""
    assumed_sd: float = in_unit("-", gt=0)
    """Standard deviation of that [-]."""

    @model_validator(mode="after")
    def _varies(self) -> "PriorParameter":
        if self.mean_sd == self.plot_sd == 0.0:
            raise ValueError(
                f"expected a mean_sd or plot_sd of {self.name} above 0, but both are 0: nothing is "
                "known without error"
            )
        return self


class LeftOutPlot(Strict):
    """The population that all plots but one make."""

    plot: str = Field(min_length=1)
    """Name of the plot that is left out."""
    means: list[float]
    """Means, in the order of `parameters`."""


class PriorError(Strict):
    """What no parameter explains of the logarithm of a spectrum."""

    wavelength_nm: list[Annotated[float, Field(gt=300, lt=3000)]] = Field(min_length=2)
    """Wavelengths of the error, rising [nm]."""
    sd: list[Annotated[float, Field(gt=0)]]
    """Standard deviation of the logarithm of reflectance [-]."""
    correlation: list[list[float]]
    """Correlation of the error between wavelengths, rows of a matrix [-]."""


class PriorFile(Strict):
    """A population of plots: means, variation between plots and the model's remaining error."""

    title: str = Field(min_length=1)
    """Description of the plots, in words."""
    licence: str
    """Licence of these numbers."""
    sources: list[str]
    """Data that they were learned from."""
    made_with: str
    """Program and version, size and voxels of the plots."""
    plots: int = Field(ge=1)
    """Number of plots learned from."""
    error: PriorError
    """The model's remaining error."""
    parameters: list[PriorParameter] = Field(min_length=1)
    """Parameters of the population."""
    mean_correlation: list[list[float]]
    """Correlation of the errors of means, rows of a matrix over `parameters` [-]."""
    left_out: list[LeftOutPlot] = Field(default_factory=list)
    """Populations without one of the plots each."""

    @model_validator(mode="after")
    def _belongs_together(self) -> "PriorFile":
        names = [p.name for p in self.parameters]
        forms = {form for _, _, form in (n.partition(".") for n in names) if form in LEAFY_FORMS}
        expected = {*FACTORS, *(f"{kind}.{form}" for kind in BY_FORM for form in forms)}
        if unknown := [name for name in names if name not in expected]:
            raise ValueError(
                f"expected factors or a growth form's {', '.join(BY_FORM)}, but got "
                f"{unknown[0]!r}.{did_you_mean(unknown[0], PRIOR_PARAMETERS)}"
            )
        times = {name: names.count(name) for name in sorted(expected)}
        odd = [f"{name!r} is missing" for name, n in times.items() if n == 0]
        if odd := odd + [f"{name!r} is {n} times there" for name, n in times.items() if n > 1]:
            raise ValueError(
                f"expected each factor once, and each of {', '.join(BY_FORM)} of each growth form "
                f"that the file has, but {' and '.join(odd[:2])}"
            )
        for row in self.left_out:
            if len(row.means) != len(names):
                raise ValueError(
                    f"expected {len(names)} means without plot {row.plot!r}, but got "
                    f"{len(row.means)}"
                )
        for values in ([p.mean for p in self.parameters], *(row.means for row in self.left_out)):
            for name, value in zip(names, values, strict=True):
                low, high = _bounds(name)
                if not low < value < high:
                    raise ValueError(f"expected {name} inside {low:g} to {high:g}, but got {value}")
        count = len(self.error.wavelength_nm)
        if any(np.diff(self.error.wavelength_nm) <= 0):
            raise ValueError("expected rising wavelengths of the error")
        if len(self.error.sd) != count:
            raise ValueError(f"expected {count} standard deviations of the error")
        _check_correlation(self.error.correlation, count, "the error")
        _check_correlation(self.mean_correlation, len(names), "the means")
        return self


def _check_correlation(rows: list[list[float]], count: int, of: str) -> None:
    if [len(row) for row in rows] != [count] * count:
        raise ValueError(f"expected {count} rows of {count} correlations of {of}")
    matrix = np.asarray(rows)
    if not (
        np.allclose(matrix, matrix.T, atol=1e-3)
        and np.allclose(np.diagonal(matrix), 1.0, atol=1e-3)
        and np.linalg.eigvalsh(matrix)[0] > -1e-3
    ):
        raise ValueError(
            f"expected a symmetric correlation of {of} with ones on its diagonal and no negative "
            "eigenvalue"
        )


def _bounds(name: str) -> tuple[float, float]:
    """Limits between which a parameter lies; factors on what leaves hold are positive."""
    kind = name.split(".")[0]
    if name in FACTORS and kind not in ("soil_brightness", "wood_brightness"):
        return 0.0, math.inf
    record = PARAMETERS[kind.removeprefix("soil_")]
    return record.lower, record.upper


def leaf_factors(population: Mapping[str, Any]) -> dict[str, Any]:
    """Factors on the PROSPECT parameters of all leaves, by name [-].

    **Arguments:** `population`, with values of `FACTORS` [-], such as `LearnedPrior.values`.
    """
    mass = population["leaf_mass_per_area"]
    return {
        "structure": population["structure"],
        "chlorophyll": population["chlorophyll"],
        "carotenoids": population["chlorophyll"],
        "dry_matter": mass,
        "water": mass * population["water_per_dry_matter"],
    }


def assumed_by_form() -> dict[str, tuple[float, float]]:
    """Median and standard deviation that each growth form assumes of each of `BY_FORM`, by name as
    in `PRIOR_PARAMETERS`, in the parameter's own unit."""
    return {
        f"{kind}.{name}": getattr(form.prior, kind)
        for kind in BY_FORM
        for name, form in FORMS.items()
        if form.prior is not None
    }


@dataclass(frozen=True)
class LearnedPrior:
    """A population of plots, from a prior file.

    Of growth forms that the file does not have, `values` and `sd` give what the form itself
    assumes (`GrowthForm.prior`); `unlearned` says so.
    """

    path: Path
    file: PriorFile

    @property
    def kinds(self) -> tuple[str, ...]:
        """Kinds of parameters that it says of each growth form."""
        return BY_FORM

    @property
    def forms(self) -> tuple[str, ...]:
        """Growth forms that it was learned with, in the order of the file."""
        kind = BY_FORM[0]
        names = [p.name.partition(".") for p in self.file.parameters]
        return tuple(form for of, _, form in names if of == kind)

    def unlearned(self, forms: Iterable[str]) -> list[str]:
        """What a user must know of growth forms that the file does not have: a sentence for each.

        **Arguments:** `forms`, names of growth forms, in any number.
        """
        missing = [f for f in dict.fromkeys(forms) if f in LEAFY_FORMS and f not in self.forms]
        return [
            f"{self.path.name} has no growth form {form}: dead tissue, leaf area and clumping of "
            "its shoots are what the form itself assumes, learned from no spectrum"
            for form in missing
        ]

    def knows(self, plot: str) -> bool:
        """Whether it was learned from the plot of this name, among others."""
        return any(row.plot == plot for row in self.file.left_out)

    def values(self, plot: str = "") -> dict[str, float]:
        """Parameters of a plot (`PRIOR_PARAMETERS`) before its spectrum, of all growth forms.

        **Arguments:** `plot`, its name. If the population was learned from it, its values are
        those learned from all other plots; standard deviations and the error stay those of all.
        """
        means = [p.mean for p in self.file.parameters]
        means = next((row.means for row in self.file.left_out if row.plot == plot), means)
        learned = {p.name: m for p, m in zip(self.file.parameters, means, strict=True)}
        return {**{name: median for name, (median, _) in assumed_by_form().items()}, **learned}

    def sd(self, name: str, *, elsewhere: bool = False) -> float:
        """Standard deviation of a parameter of a plot before its spectrum: between plots, and of
        the mean.

        A plot `elsewhere` stands in another region than those learned from. How far regions differ
        cannot be learned from one: taken to be as far as its plots do.
        """
        found = next((p for p in self.file.parameters if p.name == name), None)
        if found is None:
            return assumed_by_form()[name][1]
        return math.hypot(found.mean_sd, found.plot_sd, found.plot_sd if elsewhere else 0.0)

    def draws(self, count: int, *, seed: int = 0) -> dict[str, Float[np.ndarray, " draw"]]:
        """Parameters of `count` plots elsewhere (`sd`), each of a region of its own (`drawn`); of
        the growth forms of the file."""
        _, own = self.numbers()
        return self.drawn(np.empty(0), generator(seed).normal(size=(count, own)))

    def numbers(self, shared: Sequence[str] = ()) -> tuple[int, int]:
        """How many unit normal numbers `drawn` takes for all plots and for each."""
        kinds = [p.name.split(".")[0] for p in self.file.parameters]
        alike = sum(kind in shared for kind in kinds) + len({k for k in kinds if k in shared})
        return alike, len(kinds) + len(set(kinds)) - alike

    def drawn(
        self,
        common: Float[np.ndarray, " common"],
        own: Float[np.ndarray, "draw own"],
        shared: Sequence[str] = (),
    ) -> dict[str, Float[np.ndarray, " draw"]]:
        """Parameters of plots elsewhere (`sd`), made of unit normal numbers.

        Normal in the logit between the bounds of a parameter, or the logarithm of one without an
        upper bound. Errors of the means are correlated as the file has it; what plots and regions
        differ by in dead tissue or leaf area is the same in all growth forms.

        **Arguments:**

        - `common`: numbers of all plots together.
        - `own`: numbers of each plot.
        - `shared`: kinds of parameters in which the plots are alike, such as "leaf_area_index".
          The others are as they are given these.
        """
        rows = self.file.parameters
        kinds = [p.name.split(".")[0] for p in rows]
        alike = np.array([kind in shared for kind in kinds])
        sd = np.array([p.mean_sd for p in rows])
        error = np.asarray(self.file.mean_correlation) * np.outer(sd, sd)
        # Errors of the means that plots share first, then those of the others given these.
        joint = error[np.ix_(alike, alike)]
        gain = error[np.ix_(~alike, alike)] @ np.linalg.pinv(joint)
        given = error[np.ix_(~alike, ~alike)] - gain @ error[np.ix_(alike, ~alike)]
        first, second = int(alike.sum()), int((~alike).sum())
        of_mean = np.empty((len(own), len(rows)))
        of_mean[:, alike] = symmetric_power(joint) @ common[:first]
        of_mean[:, ~alike] = of_mean[:, alike] @ gain.T + own[:, :second] @ symmetric_power(given)
        # By what plots and their regions differ, each with the standard deviation of plots: one
        # number for each kind, whatever the growth form.
        effect: dict[str, Any] = {}
        rest, own_rest = iter(common[first:]), iter(own[:, second:].T)
        for kind in dict.fromkeys(kinds):
            effect[kind] = math.sqrt(2.0) * next(rest if kind in shared else own_rest)
        drawn = {}
        for p, kind, apart in zip(rows, kinds, of_mean.T, strict=True):
            low, high = _bounds(p.name)
            apart = apart + p.plot_sd * effect[kind]
            if math.isinf(high):
                drawn[p.name] = p.mean * np.exp(apart / p.mean)
                continue
            # Move the logit by what moves the value by `apart` to first order.
            share = (p.mean - low) / (high - low)
            slope = (high - low) * share * (1.0 - share)
            z = math.log(share / (1.0 - share)) + apart / slope
            drawn[p.name] = low + (high - low) / (1.0 + np.exp(-z))
        return drawn

    @property
    def model_error(self) -> ModelError:
        """What the model is off by on plots such as those learned from."""
        error = self.file.error
        parts = error.wavelength_nm, error.sd, error.correlation
        return ModelError(*map(np.asarray, parts))


def read_prior(name_or_path: str | Path) -> LearnedPrior | None:
    """A prior by the name of a shipped one (`SHIPPED_PRIORS`) or the path of a prior file.

    **Arguments:** `name_or_path`; "none" is no prior.

    **Returns:** `LearnedPrior`, or None.

    **Raises:** `InputError` for another name, a file that is missing or cannot be read, and one
    whose parameters, left-out means or errors do not belong together.
    """
    if str(name_or_path) == NO_PRIOR:
        return None
    path = shipped_or_own(name_or_path, "prior", SHIPPED_PRIORS, DATA)
    return LearnedPrior(path, read_toml(path, PriorFile)[0])


def write_prior(path: Path, file: PriorFile) -> None:
    """Write a prior file as TOML, with a comment on what each parameter is.

    **Arguments:**

    - `path`: where to write; a file there is replaced.
    - `file`: the population.
    """

    def row(values: list[float]) -> str:
        return "[" + ", ".join(f"{v:.5g}" for v in values) + "]"

    def text(value: str) -> str:
        return '"' + value.replace("\\", "\\\\").replace('"', '\\"') + '"'

    lines = [
        "# Population of plots, as `fynjax bioscape learn` writes it and `--prior` takes it.",
        f"title = {text(file.title)}",
        f"licence = {text(file.licence)}",
        "sources = [", *(f"    {text(s)}," for s in file.sources), "]",
        f"made_with = {text(file.made_with)}",
        f"plots = {file.plots}",
        "# Between the errors of the means, in the order of the parameters below.",
        "mean_correlation = [", *(f"    {row(r)}," for r in file.mean_correlation), "]",
    ]  # fmt: skip
    for p in file.parameters:
        lines += ["", "[[parameters]]", f"# {PRIOR_PARAMETERS[p.name]}", f"name = {text(p.name)}"]
        for key in ("mean", "mean_sd", "plot_sd", "assumed", "assumed_sd"):
            lines.append(f"{key} = {getattr(p, key):.5g}")
    lines += [
        "",
        "# What no parameter explains of the logarithm of a plot's mean reflectance.",
        "[error]",
        f"wavelength_nm = {row(file.error.wavelength_nm)}",
        f"sd = {row(file.error.sd)}",
        "correlation = [", *(f"    {row(r)}," for r in file.error.correlation), "]",
    ]  # fmt: skip
    for left in file.left_out:
        lines += ["", "[[left_out]]", f"plot = {text(left.plot)}", f"means = {row(left.means)}"]
    write_text(path, "\n".join(lines) + "\n")

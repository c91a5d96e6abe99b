"""Results of jobs: the record that `--json` prints and `summary.json` holds."""

import math
from collections.abc import Mapping
from typing import Annotated, Any

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field

from fynjax import __version__

Scalar = bool | int | float | str | None
"""A value of a table, as JSON has it; None where a number is not finite."""


def _finite(value: Any) -> Any:
    """A Python value for a NumPy scalar; None for NaN and infinity, which JSON lacks."""
    value = value.item() if hasattr(value, "item") else value
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _finite_values(values: Mapping[str, Any]) -> dict[str, Any]:
    return {str(name): _finite(value) for name, value in values.items()}


def rows_of(table: Any) -> Any:
    """The rows of a pandas table, or of records."""
    rows = table.to_dict("records") if hasattr(table, "to_dict") else table
    return [_finite_values(row) if isinstance(row, Mapping) else row for row in rows]


Number = Annotated[float | None, BeforeValidator(_finite)]
"""A number, or None where it is not finite."""
Rows = Annotated[list[dict[str, Scalar]], BeforeValidator(rows_of)]
"""The rows of a table, by the names of its columns."""


class Record(BaseModel):
    """A part of a result. Records never change, and take no field that they do not name."""

    model_config = ConfigDict(frozen=True, extra="forbid", ser_json_inf_nan="null")


class JobResult(Record):
    """What every job returns. Each job adds its fields."""

    command: str = Field(description="Which command it is of, such as 'calibrate'.")
    version: str = Field(default=__version__, description="Version of fynjax.")
    output: str = Field(description="Folder of the files.")
    seed: int
    status: str = Field(default="ok", description="'ok', or why the answer is to be doubted.")
    converged: bool | None = Field(default=None, description="Null where nothing was fitted.")
    headline: list[str] = Field(
        [], description="The result in sentences, as the terminal shows it."
    )
    files: dict[str, str] = Field(
        default_factory=dict, description="What each file is, by its name in the folder."
    )
    hashes: dict[str, str] = Field(
        default_factory=dict,
        description="SHA-256 of each file in the folder, by its name: a later run of the command "
        "replaces or removes a file only while it has it.",
    )
    hash: str = Field(default="", description="SHA-256 of this record without it.")
    warnings: list[str] = []
    timings_s: dict[str, float] = Field(default_factory=dict, description="Wall time by stage [s].")
    peak_memory_mib: float | None = Field(
        default=None, description="Largest resident memory of the process [MiB]."
    )


class ParameterSummary(Record):
    """A parameter before and after the fit."""

    name: str = Field(description="Name that patterns match, such as 'species.Restio.cover'.")
    kind: str = Field(description="What it is, such as 'cover'.")
    unit: str
    prior: Number
    prior_sd: Number
    prior_q05: Number = Field(description="Prior's 5 % quantile.")
    prior_q95: Number
    estimate: Number
    sd: Number = Field(description="Standard deviation after the fit.")
    q05: Number = Field(description="5 % quantile after the fit.")
    q95: Number
    moved: Number = Field(
        default=None,
        description="Distance of the estimate from the prior's centre, in standard deviations of "
        "the prior.",
    )
    offered: Number = Field(
        default=None,
        description="The value to use: the estimate, or where it is worse than the field table the "
        "prior.",
    )
    constrained: Number = Field(
        default=None,
        description="Share of the prior variance that the data removed, in the coordinate in which "
        "the prior is normal [-].",
    )


class StatisticSummary(Record):
    """A statistic of the image before and after the fit."""

    statistic: str
    fitted: bool | None = Field(default=None, description="Whether the calibration fitted it.")
    target: Number
    target_sd: Number = None
    before: Number
    after: Number
    with_gain: Number = Field(
        default=None, description="After, as a camera with the estimated gains measures it."
    )
    with_error: Number = Field(
        default=None, description="The same with what the model is estimated to be off by."
    )
    reference: Number = Field(default=None, description="Another simulation of the same plot.")

"""The summary a run returns, as pydantic models."""

from pydantic import BaseModel, ConfigDict, Field


class ParameterSummary(BaseModel):
    """One parameter, before and after."""

    name: str = Field(description="Name as patterns see it, such as 'species.Restio.cover'.")
    kind: str = Field(description="What it is, such as 'cover'.")
    unit: str
    prior: float
    prior_sd: float | None
    estimate: float
    sd: float | None = Field(description="Standard deviation after the fit.")
    constrained: float | None = Field(
        default=None,
        description="1 - (sd / prior_sd)^2: 0, the data said nothing; 1, they said all [-].",
    )


class StatisticSummary(BaseModel):
    """One statistic of the image, before and after."""

    statistic: str
    fitted: bool | None = Field(default=None, description="Whether the calibration fitted it.")
    target: float | None
    target_sd: float | None = None
    before: float | None
    after: float | None
    reference: float | None = Field(
        default=None, description="Another simulation of the same plot."
    )


class RunSummary(BaseModel):
    """What `--json` prints and `summary.json` holds."""

    model_config = ConfigDict(extra="allow")

    command: str = Field(description="Which command made it, such as 'calibrate'.")
    version: str = Field(description="Version of fynjax.")
    output: str = Field(description="Folder of the files.")
    seed: int
    status: str = Field(description="'ok', or why the answer is to be doubted.")
    converged: bool | None = Field(default=None, description="Null where nothing was fitted.")
    headline: list[str] = Field(
        default_factory=list, description="The result in sentences, as the terminal shows it."
    )
    files: dict[str, str] = Field(
        default_factory=dict, description="What each file is, by its name in the folder."
    )
    timings_s: dict[str, float] = Field(default_factory=dict, description="Seconds by stage [s].")
    parameters: list[ParameterSummary] = Field(default_factory=list)
    statistics: list[StatisticSummary] = Field(default_factory=list)
    warnings: list[str] = Field(default_factory=list)

"""The [calibration] table of `plot.toml`, as a pydantic model."""

from fnmatch import fnmatchcase
from typing import Annotated

from pydantic import Field

from fynjax.app.io.text import Strict, in_unit
from fynjax.scene import PARAMETERS, parameter_kind

Share = Annotated[float, Field(ge=0, le=1, allow_inf_nan=False)]


class CalibrationTable(Strict):
    """What a calibration may move, and how far it trusts the field table."""

    free: list[str] | None = Field(default=None, min_length=1)
    """Patterns of the parameters to calibrate, such as 'species.*.cover'. Left out: cover, diameter
    and dead share of each species; leaf area and clumping where the species table states none; leaf
    traits where no leaf was measured; brightness, moisture and covers of the ground."""
    targets: list[str] = Field(default_factory=lambda: ["*"], min_length=1)
    """Patterns of the target's statistics to use, such as '*.mean'."""
    target_sd: float = in_unit("-", default=0.01, gt=0, le=1)
    """Relative standard deviation of a mean or quantile that states none [-]."""
    gain_sd: Share | dict[str, Share] | None = in_unit("-", default=None, several=True)
    """Standard deviation of the factor by which a band of the drone's camera may be off, 0 to 1:
    one of all bands or a table by band, such as {red_edge = 0.1}; of other bands, or left out, that
    of the sensor by `sensor.calibrated_by` [-]."""
    gain_shared: Share | None = in_unit("-", default=None, several=True)
    """Share of its variance that all bands have in common, as by light and exposure; left out, that
    of the sensor [-]."""
    model_error: float | None = in_unit("-", default=None, ge=0, le=10)
    """What the model is trusted to be off by in each band, as a factor on the standard deviations
    that were found on plots that were measured, 12 to 15 % from 450 to 1100 nm; 0 only where the
    model itself made the data. Left out: 1, and of generic plants 1.41, since no plot like them was
    learned from [-]."""
    pixel_sd: float | None = in_unit("-", default=None, gt=0, le=1)
    """Where the plants are known: relative error of a block of pixels, of camera and model,
    independent of other blocks and bands. Left out: 0.05, and what images of the same crowns with
    other lobes and shoots differ by, which bands and neighbours share [-]."""
    block_m: float | None = in_unit("m", default=None, gt=0, le=1000)
    """Where the plants are known: side of the blocks of pixels whose means are compared, a whole
    number of pixels; left out, the smallest of which an image has at most 40 000 values [m]."""
    priors: dict[str, Annotated[float, Field(gt=0, le=10)]] = Field(default_factory=dict)
    """Relative standard deviation of the prior, by pattern [-]. Left out: that of the parameter,
    which for dead tissue in shoots is 0.25, whatever its value."""
    max_iterations: int = Field(default=30, ge=1, le=10000)
    """Most steps of the optimiser in the first round; where plants are not known those after have
    half as many [-]."""
    rounds: int = Field(default=2, ge=1, le=100)
    """Rounds of a search, each corrected by whole scenes, where plants are not known; up to five
    more follow while the last still moved [-]."""
    starts: int = Field(default=1, ge=1, le=1000)
    """Searches: from the prior's centre, the others from draws of the prior [-]."""

    def relative_sd(self, name: str) -> float | None:
        """Relative prior standard deviation of parameter `name` [-]; None where it has no prior, or
        that of its record is absolute."""
        for pattern, sd in self.priors.items():
            if fnmatchcase(name, pattern):
                return sd
        return PARAMETERS[parameter_kind(name)].relative_sd

"""The species table of the 2006 plot as it may have been, or may be, at another age."""

from importlib import resources
from typing import TYPE_CHECKING

import numpy as np

from fynjax._core.errors import InputError
from fynjax.canopy import table1_2006

if TYPE_CHECKING:
    import pandas as pd

SURVEY_YEAR = 2022
"""Year of the first field campaign; table 1 is then of a stand 16 years old."""
SURVEYED_AGE = 16.0
OLDEST = 40.0
"""Fynbos as old is rare, and these curves say nothing of its decline [years]."""


RECOVERY = {"seed": (6.0, 4.0), "sprout": (3.0, 2.0)}
"""Times after a fire in which sizes, and covers, come within 37 % of their end [years], by the way
a taxon comes back. Assumptions: sprouters keep their roots and are quick, seedlings begin small;
cover closes before heights end."""
_LITTER, _CHAR = 5.0, 3.0
"""Years in which litter gathers, and in which char is weathered and covered. Assumptions."""
_CHARRED = 0.5
"""Share of the ground under ash and char just after the fire. An assumption."""
_SKELETONS = 0.5
"""Share of the deadwood of an old stand that a fire leaves as skeletons. An assumption."""


def table_after_fire(age: float) -> "pd.DataFrame":
    """Species table of the taxa of table 1, `age` years after a fire (1 to 40).

    Only the table of the stand burnt in 2006 is published, 16 years old when surveyed. Other ages
    are built on assumptions, not measured: crown diameter, height and cover of each living taxon
    approach their end as 1 - exp(-age / t), scaled to be those of table 1 at 16 years, with times
    t by the way it comes back (`RECOVERY`, `data/recovery.csv`). Exponential recovery after fire is
    what satellite series over the Cape Floristic Region follow (Wilson, Latimer and Silander
    2015); the times here are ours. Deadwood begins as the skeletons of the burnt stand and gathers
    evenly with age.

    Columns are those of `table1_2006`, and `after_fire`. Raises `InputError` for another age.
    """
    import pandas as pd

    _check_age(age)
    numbers = ["mean_diameter_cm", "cover_percent", "height_max_m"]
    table = table1_2006().astype(dict.fromkeys(numbers, float))
    with (resources.files("fynjax.studies.fynbos_2006") / "data" / "recovery.csv").open() as ways:
        table = table.merge(pd.read_csv(ways), on="taxon", validate="one_to_one")
    for row, way in zip(table.index, table["after_fire"], strict=True):
        if way == "dead":
            gathered = _SKELETONS + (1.0 - _SKELETONS) * age / SURVEYED_AGE
            table.loc[row, "cover_percent"] *= gathered
            continue
        of_size, of_cover = RECOVERY[way]
        for column in ("mean_diameter_cm", "height_max_m"):
            table.loc[row, column] *= _share(age, of_size)
        table.loc[row, "cover_percent"] *= _share(age, of_cover)
    return table


def ground_after_fire(age: float, litter: float) -> tuple[float, float]:
    """Shares of the ground under litter and under ash and char [-] `age` years after a fire (1 to
    40), given the share of `litter` at 16 years [-]. Raises `InputError` for another age."""
    _check_age(age)
    return min(litter * _share(age, _LITTER), 1.0), float(_CHARRED * np.exp(-age / _CHAR))


def _share(age: float, time: float) -> float:
    return float(np.expm1(-age / time) / np.expm1(-SURVEYED_AGE / time))


def _check_age(age: float) -> None:
    if not 1.0 <= age <= OLDEST:
        raise InputError(
            f"the age after a fire must be 1 to {OLDEST:g} years, but is {age:g}. A year instead "
            "of an age?"
        )

"""Table 1 of the paper: the 13 taxa of the 2006 burn plot."""

from importlib import resources
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import pandas as pd


def table1_2006() -> "pd.DataFrame":
    """The species table of the 2006 burn plot, one row a taxon (sources: `data/README.md`).

    **Returns:** a pandas frame with the columns taxon, mean_diameter_cm [cm], cover_percent [%],
    height_max_m [m], growth_form, and with documented defaults packing_percent [%], fill_percent
    [%], branches [-], rotation_spread_deg [degrees] and minimum_object_area_m2 [m2].

    >>> from fynjax.canopy import table1_2006
    >>> len(table1_2006())
    13
    """
    import pandas as pd  # late: the command line need not wait for it

    with (resources.files("fynjax.canopy") / "data" / "table1_2006.csv").open() as table:
        return pd.read_csv(table)

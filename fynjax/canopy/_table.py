"""Shipped tables of the 13 taxa of the 2006 burn plot: table 1 of the paper, and leaf sizes."""

from importlib import resources
from typing import TYPE_CHECKING, Any

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
    return _shipped("table1_2006.csv")


def leaf_sizes() -> "pd.DataFrame":
    """Leaf size of each taxon of table 1, with its source.

    **Returns:** a pandas frame with the columns taxon, organ_form (blade, culm, thread or none),
    outline, length_mm, width_mm (the diameter of culms and threads) [mm], basis (species, genus or
    assumed) and source.
    """
    return _shipped("leaf_sizes.csv", keep_default_na=False)


def _shipped(name: str, **options: Any) -> "pd.DataFrame":
    import pandas as pd  # late: the command line need not wait for it

    with (resources.files("fynjax.canopy") / "data" / name).open() as table:
        return pd.read_csv(table, **options)

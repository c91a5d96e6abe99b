"""Every number of a validation as a data set."""

from typing import Any

import numpy as np
import pandas as pd
import xarray as xr

from fynjax.app.compare._drone import DroneComparison
from fynjax.app.compare._published import PublishedComparison
from fynjax.app.compare._spectral import SpectralComparison

_UNITS = (("_percent", "percent"), ("_deg", "degree"), ("_nm", "nm"), ("_m", "m"))


def unit_of(column: str) -> str:
    """Unit of a table's `column`, by the end of its name; "1" without one.

    >>> from fynjax.app.compare import unit_of
    >>> unit_of("wavelength_nm"), unit_of("correlation")
    ('nm', '1')
    """
    return next((unit for end, unit in _UNITS if column.endswith(end)), "1")


def validation_dataset(
    drone: DroneComparison | PublishedComparison | None, spectra: SpectralComparison | None
) -> xr.Dataset:
    """What the run file of a validation holds: every column of every table, and the histograms.

    **Arguments:**

    - `drone`: comparison of drone images, or with what is published; `None` without one.
    - `spectra`: comparison of spectra; `None` without one.

    **Returns:** a data set; each numeric variable has `units` and `long_name`.
    """
    variables: dict[str, Any] = {}
    coords: dict[str, Any] = {}

    def add(table: pd.DataFrame, key: str, dimension: str, prefix: str, what: str) -> None:
        if table.empty:
            return
        coords[dimension] = (dimension, table[key].to_numpy(), {"long_name": what})
        if table[key].dtype.kind == "f":
            coords[dimension][2]["units"] = unit_of(key)
        for column in table.columns.drop(key):
            values = table[column].to_numpy()
            attributes = {"long_name": f"{column.replace('_', ' ')} ({what})"}
            if values.dtype == bool:
                values = values.astype(np.int8)
            if values.dtype.kind in "fiu":
                attributes["units"] = unit_of(column)
            else:
                values = values.astype(str)
            variables[f"{prefix}_{column}"] = (dimension, values, attributes)

    if isinstance(drone, PublishedComparison):
        add(drone.statistics, "statistic", "statistic", "drone", "statistic of the drone image")
    elif drone is not None:
        add(drone.bands, "band", "band", "band", "drone band")
        add(drone.indices, "index", "index", "index", "vegetation index of the drone image")
        add(drone.variety, "sample", "sample", "variety", "spectral diversity of the drone image")
        variables["histogram"] = (
            ("sample", "index", "bin"),
            drone.shares,
            {"long_name": "share of the pixels in each bin", "units": "1"},
        )
        variables["histogram_edge"] = (
            ("index", "edge"),
            drone.edges,
            {"long_name": "edges of the bins", "units": "1"},
        )
    if spectra is not None:
        add(spectra.spectra, "wavelength_nm", "wavelength", "spectrum", "band centre")
        add(spectra.regions, "region", "region", "agreement", "spectral region")
        add(spectra.misfit.drop(columns="rmse"), "region", "region", "misfit", "spectral region")
        add(spectra.indices, "index", "spectrometer_index", "spectrometer", "index of the spectra")
    return xr.Dataset(variables, coords=coords)

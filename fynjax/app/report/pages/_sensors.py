"""What a calibration's page says of each sensor beside the drone."""

import pandas as pd

from fynjax.app.report.figures import metric_plot, spectrum_plot
from fynjax.app.report.pages._page import Picture, Section, Table
from fynjax.inversion import Data


def sensor_section(data: Data, table: pd.DataFrame) -> Section:
    """The section of a spectrum or a cloud.

    **Arguments:** `data` of the sensor; `table` of its statistics, with the columns
    real, target_sd, before, after, and wavelength_nm of a spectrum, or metric and unit of a cloud.
    """
    source = data.source
    assert source is not None
    before = f"{source.name}_" if source.name else ""
    if source.spectrum is not None:
        title = "The spectrum"
        picture = Picture(
            f"{before}spectrum.png",
            spectrum_plot(*source.spectrum, table),
            "spectrum measured, before and after",
            "Above reflectance, below simulated less measured.",
        )
    else:
        cloud = source.kind == "structure"
        title, what = (
            ("The point cloud", "structure of the cloud")
            if cloud
            else ("The spectrum", "numbers of the spectrum")
        )
        picture = Picture(
            f"{before}{source.kind}.png",
            metric_plot(table),
            f"{what}, before and after",
            f"{what.capitalize()}, the real ones with their errors.",
        )
    title += f", {source.name}" if source.name else ""
    rows = Table(table, f"{title}, real and simulated.", folded=True)
    return Section(title, [source.description, picture, rows])

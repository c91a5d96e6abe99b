"""What a calibration's page says of each sensor beside the drone."""

import pandas as pd

from fynjax.app.assembly import Measured
from fynjax.app.report.figures import metric_plot, spectrum_plot
from fynjax.app.report.pages._page import Picture, Section, Table


def sensor_section(measured: Measured, table: pd.DataFrame) -> Section:
    """The section of a spectrum or a cloud.

    **Arguments:** `measured`, the measurement; `table` of its statistics, with the columns
    real, target_sd, before, after, and wavelength_nm of a spectrum, or metric and unit of a cloud.
    """
    if measured.spectrum is not None:
        title = "The spectrum"
        picture = Picture(
            "spectrum.png",
            spectrum_plot(*measured.spectrum, table),
            "spectrum measured, before and after",
            "Above reflectance, below simulated less measured.",
        )
    else:
        cloud = measured.kind == "structure"
        title, what = (
            ("The point cloud", "structure of the cloud")
            if cloud
            else ("The spectrum", "numbers of the spectrum")
        )
        picture = Picture(
            f"{measured.kind}.png",
            metric_plot(table),
            f"{what}, before and after",
            f"{what.capitalize()}, the real ones with their errors.",
        )
    rows = Table(table, f"{title}, real and simulated.", folded=True)
    return Section(title, [measured.description, picture, rows])

"""What a calibration's page says of each sensor beside the drone."""

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from fynjax.assembly import Measured
from fynjax.inversion import SpectrumView
from fynjax.metrics import STRUCTURE_METRICS
from fynjax.report.figures import metric_plot, spectrum_plot
from fynjax.report.pages._page import Page

_COLUMNS = ["real", "target_sd", "before", "after"]


def sensor_table(one: Measured, statistics: pd.DataFrame) -> pd.DataFrame:
    """The statistics of one sensor: real with its error, and simulated before and after."""
    rows = statistics.set_index("statistic").loc[list(one.data.names), _COLUMNS].reset_index()
    if isinstance(one.view, SpectrumView):
        rows.insert(0, "wavelength_nm", one.view.bands.centre)
    else:
        metrics = [name.split(".", 1)[1] for name in rows["statistic"]]
        rows.insert(0, "metric", metrics)
        rows.insert(1, "unit", [STRUCTURE_METRICS[name] for name in metrics])
    return rows.drop(columns="statistic")


def sensor_figure(one: Measured, statistics: pd.DataFrame) -> tuple[Any, str]:
    """The figure of a spectrum or a cloud, and what it shows."""
    table = sensor_table(one, statistics)
    if one.kind == "spectrum":
        assert one.spectrum is not None
        return spectrum_plot(*one.spectrum, table), "spectrum measured, before and after"
    return metric_plot(table), "structure of the cloud, before and after"


def sensor_headline(one: Measured, statistics: pd.DataFrame) -> str:
    """How well a spectrum or a cloud is met, before and after."""
    table = sensor_table(one, statistics)
    if one.kind == "spectrum":
        rmse = {c: float(np.sqrt(np.mean((table[c] - table["real"]) ** 2))) for c in _COLUMNS[2:]}
        return f"RMSE of the spectrum {rmse['before']:.3f} before, {rmse['after']:.3f} after."
    off = {
        c: float(((table[c] - table["real"]).abs() / table["target_sd"]).max())
        for c in _COLUMNS[2:]
    }
    return (
        f"Largest deviation of a structure metric {off['before']:.1f} of its standard deviations "
        f"before, {off['after']:.1f} after."
    )


def sensor_section(page: Page, folder: Path, one: Measured, statistics: pd.DataFrame) -> None:
    """A section with the figure, whose file is in `folder`, and the table of a sensor."""
    title, caption = {
        "spectrum": ("The spectrum", "Above reflectance, below simulated less measured."),
        "structure": ("The point cloud", "Each metric of the real cloud with its error."),
    }[one.kind]
    page.section(title).paragraph(one.told)
    page.figure(folder / f"{one.kind}.png", caption)
    page.table(sensor_table(one, statistics), caption=f"{title}, real and simulated.", folded=True)

"""How bright a plot is from every direction."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import xarray as xr

from fynjax.app.report.figures._style import GREY, Figure, style


@style()
def angles_polar(data: xr.Dataset, bands: Sequence[str]) -> Figure:
    """Reflectance factor over zenith angle and azimuth, a panel a band.

    **Arguments:** `data`, with `brf`, `view_zenith`, `view_azimuth` and the sun; `bands`, some of
    its bands.
    """
    figure = Figure(figsize=(4.8 * len(bands), 4.6))
    # Cells about each view, closed round the circle.
    azimuth = np.radians(data["view_azimuth"].values[0] + data["relative_azimuth"].values)
    around = np.append(azimuth, azimuth[0] + 2.0 * np.pi)
    for place, band in enumerate(bands, start=1):
        axes: Any = figure.add_subplot(1, len(bands), place, projection="polar")
        axes.set_theta_zero_location("N")
        axes.set_theta_direction(-1)
        values = data["brf"].sel(band=band).values
        values = np.concatenate([values, values[:, :1]], axis=1)
        shown = axes.pcolormesh(
            around, data["view_zenith"].values, values, cmap="viridis", shading="gouraud"
        )
        axes.plot(
            np.radians(float(data["sun_azimuth"])), float(data["sun_zenith"]), "o", ms=11,
            mfc="none", mec="white", mew=1.6,
        )  # fmt: skip
        axes.grid(False)
        axes.set_xticks(np.radians([0, 90, 180, 270]), list("NESW"))
        axes.set_yticks([30, 60], ["30°", "60°"])
        axes.tick_params(colors=GREY)
        axes.set_title(str(band))
        figure.colorbar(shown, ax=axes, label="Reflectance factor", shrink=0.8, pad=0.1)
    return figure


@style()
def angles_plane(data: xr.Dataset, bands: Sequence[str]) -> Figure:
    """Reflectance factor in the plane of the sun over the view's zenith angle, a line a band.

    **Arguments:** `data`, with `brf_principal_plane`, `view_angle` and the sun; `bands`, some of
    its bands.
    """
    figure = Figure(figsize=(6.4, 4.0))
    axes: Any = figure.add_subplot()
    for band in bands:
        line = data["brf_principal_plane"].sel(band=band)
        axes.plot(data["view_angle"].values, line.values, label=str(band))
    axes.axvline(float(data["sun_zenith"]), color=GREY, ls="--", lw=1)
    axes.set(xlabel="Zenith angle of the view, on the sun's side above 0 [degrees]",
             ylabel="Reflectance factor", ylim=(0, None))  # fmt: skip
    axes.set_xticks(range(-75, 76, 25))
    axes.legend(frameon=False)
    return figure

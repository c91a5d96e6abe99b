"""Traits and spectra of fitted leaves, as CSV and NetCDF."""

from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr

import fynjax
from fynjax.io._atomic import atomic_path
from fynjax.leaf import LeafFit, LeafGroups, LeafPosterior

# Column of traits.csv, unit.
_UNITS = {
    "structure": "1",
    "chlorophyll": "ug cm-2",
    "carotenoids": "ug cm-2",
    "anthocyanins": "ug cm-2",
    "brown_pigments": "1",
    "water": "cm",
    "dry_matter": "g cm-2",
    "proteins": "g cm-2",
    "carbon_constituents": "g cm-2",
}


def traits_table(fit: LeafFit, files: Sequence[str], names: Sequence[str]) -> pd.DataFrame:
    """One row a spectrum: file, name, parameters, their deviations and 90 % ends, rmse, status."""
    columns: dict[str, Any] = {"file": list(files), "name": list(names)}
    for i, name in enumerate(fit.names):
        columns[name] = np.asarray(getattr(fit.parameters, name))
        columns[f"{name}_sd"] = fit.standard_deviation[:, i]
        columns[f"{name}_lower90"] = fit.lower[:, i]
        columns[f"{name}_upper90"] = fit.upper[:, i]
    columns |= {"rmse": fit.rmse, "error_inflation": fit.inflation, "status": list(fit.status)}
    return pd.DataFrame(columns)


def write_traits_csv(table: pd.DataFrame, path: str | Path) -> None:
    """Write a table of traits; units are those of `LeafParameters`."""
    with atomic_path(path) as partial:
        table.to_csv(partial, index=False, float_format="%.6g")


def spectra_dataset(
    fit: LeafFit, files: Sequence[str], names: Sequence[str], settings: dict[str, str]
) -> xr.Dataset:
    """Measured, fitted and predicted spectra with the 90 % band of T, and the traits."""
    wide = 1.6448536269514722 * fit.transmittance_deviation
    tables: dict[str, tuple[np.ndarray, str]] = {
        "measured_reflectance": (fit.measured[:, 0], "recorded reflectance used by the fit"),
        "measured_transmittance": (fit.measured[:, 1], "recorded transmittance used by the fit"),
        "fitted_reflectance": (fit.fitted[:, 0], "reflectance of the fitted measurement model"),
        "fitted_transmittance": (fit.fitted[:, 1], "transmittance of the fitted measurement model"),
        "reflectance": (fit.reflectance, "leaf reflectance"),
        "transmittance": (fit.transmittance, "leaf transmittance, predicted if not measured"),
        "transmittance_lower90": (
            np.clip(fit.transmittance - wide, 0, 1),
            "lower end of the 90 % interval of leaf transmittance",
        ),
        "transmittance_upper90": (
            np.clip(fit.transmittance + wide, 0, 1),
            "upper end of the 90 % interval of leaf transmittance",
        ),
    }
    variables: dict[str, Any] = {
        key: (("leaf", "wavelength"), values.astype(np.float32), {"units": "1", "long_name": text})
        for key, (values, text) in tables.items()
    }
    for i, name in enumerate(fit.names):
        values = np.asarray(getattr(fit.parameters, name))
        attributes = {"units": _UNITS[name], "long_name": name.replace("_", " ")}
        variables[name] = ("leaf", values, attributes)
        deviation = fit.standard_deviation[:, i]
        text = f"standard deviation of {name.replace('_', ' ')}"
        variables[f"{name}_sd"] = ("leaf", deviation, attributes | {"long_name": text})
    variables["status"] = ("leaf", np.array(fit.status, dtype=object))
    variables["file"] = ("leaf", np.array(list(files), dtype=object))
    wavelength = (
        "wavelength",
        fit.wavelength,
        {"units": "nm", "standard_name": "radiation_wavelength", "long_name": "bin centre"},
    )
    return xr.Dataset(
        variables,
        coords={"wavelength": wavelength, "leaf": ("leaf", np.array(list(names), dtype=object))},
        attrs={
            "Conventions": "CF-1.11",
            "title": "Leaf spectra and traits fitted with PROSPECT",
            "source": f"fynjax {fynjax.__version__}, fit-leaf",
            "history": f"{datetime.now(UTC).isoformat(timespec='seconds')} fynjax fit-leaf",
            **settings,
        },
    )


def write_leaf_netcdf(dataset: xr.Dataset, path: str | Path) -> None:
    """Write the spectra as compressed NetCDF-4."""
    floats = [key for key, v in dataset.data_vars.items() if v.dtype.kind == "f"]
    with atomic_path(path) as partial:
        dataset.to_netcdf(partial, engine="netcdf4", encoding={k: {"zlib": True} for k in floats})


_VARIANTS = 5
_SHOWN = 12


def species_table(found: LeafGroups, seed: int) -> pd.DataFrame:
    """The mean leaf of each species (variant 0), and material variants of it."""
    drawn = found.variants(_VARIANTS, seed)
    rows = []
    for g, species in enumerate(found.groups):
        mean = {n: float(np.asarray(getattr(found.mean, n))[g]) for n in found.names}
        rows.append({"species": species, "variant": 0, **mean})
        for v in range(_VARIANTS):
            one = {n: float(np.asarray(getattr(drawn, n))[g, v]) for n in found.names}
            rows.append({"species": species, "variant": v + 1, **one})
    return pd.DataFrame(rows)


def posterior_dataset(
    drawn: LeafPosterior,
    fit: LeafFit,
    files: Sequence[str],
    names: Sequence[str],
    settings: dict[str, str],
) -> xr.Dataset:
    """Draws of the parameters and of T of each leaf."""
    variables: dict[str, Any] = {
        name: (
            ("leaf", "draw"),
            drawn.samples[:, :, i],
            {"units": _UNITS[name], "long_name": name.replace("_", " ")},
        )
        for i, name in enumerate(drawn.names)
    }
    variables["transmittance"] = (
        ("leaf", "draw", "wavelength"),
        drawn.transmittance.astype(np.float32),
        {"units": "1", "long_name": "leaf transmittance"},
    )
    variables["effective_size"] = ("leaf", drawn.effective_size, {"units": "1"})
    variables["status"] = ("leaf", np.array(drawn.status, dtype=object))
    variables["file"] = ("leaf", np.array(list(files), dtype=object))
    wavelength = ("wavelength", fit.wavelength, {"units": "nm", "long_name": "bin centre"})
    return xr.Dataset(
        variables,
        coords={"wavelength": wavelength, "leaf": ("leaf", np.array(list(names), dtype=object))},
        attrs={
            "Conventions": "CF-1.11",
            "title": "Posterior of leaf traits and transmittance under PROSPECT",
            "source": f"fynjax {fynjax.__version__}, fit-leaf",
            **settings,
        },
    )


def draw_fit(fit: LeafFit, names: Sequence[str], path: str | Path) -> None:
    """Draw R from below and 1 - T from above with its 90 % band, one panel a leaf.

    At most twelve leaves, evenly drawn from all, so that a run of thousands still fits a page.
    """
    from matplotlib.figure import Figure

    count = len(fit.status)
    shown = np.unique(np.linspace(0, count - 1, min(count, _SHOWN)).round().astype(int))
    columns = min(3, shown.size)
    rows = -(-shown.size // columns)
    figure = Figure(figsize=(4.2 * columns, 2.9 * rows + 0.5), layout="constrained")
    panels = figure.subplots(rows, columns, squeeze=False, sharex=True, sharey=True).ravel()
    wide = 1.6448536269514722 * fit.transmittance_deviation
    inside = (fit.wavelength >= 445.0) & (fit.wavelength <= 2405.0)
    grid = fit.wavelength[inside]
    for panel, i in zip(panels, shown):
        low, high = (
            np.clip(1.0 - fit.transmittance[i] + sign * wide[i], 0.0, 1.0)[inside]
            for sign in (-1, 1)
        )
        panel.fill_between(grid, low, high, color="tab:blue", alpha=0.25, lw=0,
                           label="90 % interval of 1 - T")  # fmt: skip
        panel.plot(
            grid, 1.0 - fit.transmittance[i][inside], color="tab:blue", label="1 - T of leaf"
        )
        panel.plot(grid, fit.fitted[i, 0][inside], color="tab:green", label="R of model")
        panel.plot(grid, fit.measured[i, 0][inside], "k.", ms=2.5, label="R measured")
        if np.isfinite(fit.measured[i, 1]).any():
            panel.plot(grid, 1.0 - fit.measured[i, 1][inside], ".", color="0.45", ms=2.5,
                       label="1 - T measured")  # fmt: skip
        short = names[i] if len(names[i]) <= 32 else "..." + names[i][-29:]
        doubt = "" if fit.status[i] == "converged" else f"\n{fit.status[i].split(':')[0]}"
        panel.set_title(short + doubt, fontsize=8)
    for panel in panels[shown.size :]:
        panel.set_axis_off()
    panels[0].set(xlim=(400, 2450), ylim=(0, 1))
    figure.supxlabel("wavelength [nm]", fontsize=9)
    figure.supylabel("share of the light [-]", fontsize=9)
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=5, fontsize=8, frameon=False)
    with atomic_path(path) as partial:
        figure.savefig(partial, dpi=130, format="png", metadata={"Software": None})

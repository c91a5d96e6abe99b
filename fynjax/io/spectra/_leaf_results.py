"""Traits and spectra of fitted leaves, as CSV and NetCDF."""

from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr

import fynjax
from fynjax.io.text import atomic_path
from fynjax.leaf import LEAF_PARAMETERS, LeafFit, LeafGroups, LeafPosterior

_UNITS = {name: "1" if p.unit == "-" else p.unit for name, p in LEAF_PARAMETERS.items()}
"""Units as the CF conventions write them."""


def traits_table(fit: LeafFit, files: Sequence[str], names: Sequence[str]) -> pd.DataFrame:
    """Traits of fitted leaves, one row for each spectrum.

    **Arguments:**

    - `fit`: of `fynjax.leaf.fit_leaf`, with one leaf for each spectrum.
    - `files`, `names`: file and name of each spectrum.

    **Returns:** file, name, parameters (units of `LeafParameters`), their standard deviations and
    the ends of their 90 % intervals, what was estimated of the measurement, rmse of the fit [-],
    inflation of the error [-], traits that the prior decides, and status. Traits are per projected
    area of the leaf: of a cylinder, half of its surface is 1.57 times that.
    """
    columns: dict[str, Any] = {"file": list(files), "name": list(names)}
    for i, name in enumerate(fit.names):
        columns[name] = np.asarray(getattr(fit.parameters, name))
        columns[f"{name}_sd"] = fit.standard_deviation[:, i]
        columns[f"{name}_lower90"] = fit.lower[:, i]
        columns[f"{name}_upper90"] = fit.upper[:, i]
    for i, name in enumerate(fit.estimated):
        columns[name] = fit.measurement[:, i]
        columns[f"{name}_sd"] = fit.measurement_deviation[:, i]
    columns |= {
        "rmse": fit.rmse,
        "error_inflation": fit.inflation,
        "area": "projected",
        "prior_decides": prior_decides(fit),
        "status": list(fit.status),
    }
    return pd.DataFrame(columns)


def prior_decides(fit: LeafFit) -> list[str]:
    """Traits of each leaf of `fit` of whose prior variance the spectrum leaves more than half.

    Anthocyanins are not named: of a green leaf a spectrum says no more than that they are few.
    """
    named = [name for name in fit.names if name not in ("structure", "anthocyanins")]
    columns = [fit.names.index(name) for name in named]
    return [
        ", ".join(name for name, at in zip(named, columns) if share[at] > 0.5)
        for share in fit.prior_share
    ]


def write_traits_csv(table: pd.DataFrame, path: str | Path) -> None:
    """Write a `table` of traits to the CSV file `path`; units are those of `LeafParameters`."""
    with atomic_path(path) as partial:
        table.to_csv(partial, index=False, float_format="%.6g")


def spectra_dataset(
    fit: LeafFit, files: Sequence[str], names: Sequence[str], settings: dict[str, str]
) -> xr.Dataset:
    """Measured, fitted and predicted spectra of leaves, and their traits.

    **Arguments:**

    - `fit`: of `fynjax.leaf.fit_leaf`, with one leaf for each spectrum.
    - `files`, `names`: file and name of each spectrum.
    - `settings`: how the fit was made; they become attributes.

    **Returns:** reflectance and transmittance [leaf, wavelength] as fractions [-], with the 90 %
    interval of transmittance; traits [leaf] in the units of `LeafParameters`; wavelength in nm.
    """
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


def write_spectra_netcdf(dataset: xr.Dataset, path: str | Path) -> None:
    """Write a `dataset` of spectra to the file `path`, as compressed NetCDF-4."""
    floats = [key for key, v in dataset.data_vars.items() if v.dtype.kind == "f"]
    with atomic_path(path) as partial:
        dataset.to_netcdf(partial, engine="netcdf4", encoding={k: {"zlib": True} for k in floats})


_VARIANTS = 5


def species_table(groups: LeafGroups, seed: int) -> pd.DataFrame:
    """The mean leaf of each species (variant 0), and material variants of it.

    **Arguments:**

    - `groups`: species means and their spread, as `fynjax.leaf` fits them.
    - `seed`: of the variants.

    **Returns:** species, variant and parameters, in the units of `LeafParameters`.
    """
    drawn = groups.variants(_VARIANTS, seed)
    rows = []
    for g, species in enumerate(groups.groups):
        mean = {n: float(np.asarray(getattr(groups.mean, n))[g]) for n in groups.names}
        rows.append({"species": species, "variant": 0, **mean})
        for v in range(_VARIANTS):
            values = {n: float(np.asarray(getattr(drawn, n))[g, v]) for n in groups.names}
            rows.append({"species": species, "variant": v + 1, **values})
    return pd.DataFrame(rows)


def posterior_dataset(
    drawn: LeafPosterior,
    fit: LeafFit,
    files: Sequence[str],
    names: Sequence[str],
    settings: dict[str, str],
) -> xr.Dataset:
    """Draws from the posterior of leaves: parameters and transmittance.

    **Arguments:**

    - `drawn`: the draws, of `fynjax.leaf`.
    - `fit`: from which they started; it holds the wavelengths.
    - `files`, `names`: file and name of each spectrum.
    - `settings`: how the draws were made; they become attributes.

    **Returns:** parameters [leaf, draw] in the units of `LeafParameters`, transmittance [leaf,
    draw, wavelength] as fractions [-], effective number of draws and status of each leaf.
    """
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
    variables["status"] = ("leaf", drawn.status.astype(object))
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

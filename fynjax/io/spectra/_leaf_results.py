"""Traits and spectra of fitted leaves, as CSV and NetCDF."""

from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr

import fynjax
from fynjax.io.text import atomic_path
from fynjax.leaf import (
    LEAF_PARAMETERS,
    LeafArea,
    LeafFit,
    LeafGroups,
    LeafParameters,
    LeafPosterior,
    area_factors,
)

_UNITS = {name: "1" if p.unit == "-" else p.unit for name, p in LEAF_PARAMETERS.items()}
"""Units as the CF conventions write them."""
PROJECTED = area_factors("projected", "broad")
"""Contents as spectra give them."""


def traits_table(
    fit: LeafFit,
    files: Sequence[str],
    names: Sequence[str],
    area: LeafArea = "projected",
    factors: Mapping[str, float] = PROJECTED,
) -> pd.DataFrame:
    """Traits of fitted leaves, one row for each spectrum.

    **Arguments:**

    - `fit`: of `fynjax.leaf.fit_leaf`, with one leaf for each spectrum.
    - `files`, `names`: file and name of each spectrum.
    - `area`, `factors`: what contents are stated per, and `fynjax.leaf.area_factors` of that.

    **Returns:** file, name, parameters (units of `LeafParameters`), their standard deviations and
    the ends of their 90 % intervals, what was estimated of the measurement, rmse of the fit [-],
    inflation of the error [-], the area, traits that the prior decides, and status.
    """
    columns: dict[str, Any] = {"file": list(files), "name": list(names)}
    for i, name in enumerate(fit.names):
        factor = factors[name]
        columns[name] = factor * np.asarray(getattr(fit.parameters, name))
        columns[f"{name}_sd"] = factor * fit.standard_deviation[:, i]
        columns[f"{name}_lower90"] = factor * fit.lower[:, i]
        columns[f"{name}_upper90"] = factor * fit.upper[:, i]
    for i, name in enumerate(fit.estimated):
        columns[name] = fit.measurement[:, i]
        columns[f"{name}_sd"] = fit.measurement_deviation[:, i]
    columns |= {
        "rmse": fit.rmse,
        "error_inflation": fit.inflation,
        "area": area,
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
    fit: LeafFit,
    files: Sequence[str],
    names: Sequence[str],
    settings: dict[str, str],
    factors: Mapping[str, float] = PROJECTED,
) -> xr.Dataset:
    """Measured, fitted and predicted spectra of leaves, and their traits.

    **Arguments:**

    - `fit`: of `fynjax.leaf.fit_leaf`, with one leaf for each spectrum.
    - `files`, `names`: file and name of each spectrum.
    - `settings`: how the fit was made, the area of contents too; they become attributes.
    - `factors`: `fynjax.leaf.area_factors` of that area.

    **Returns:** reflectance and transmittance [leaf, wavelength] as fractions [-], with the 90 %
    interval of transmittance; traits [leaf] in the units of `LeafParameters`, and what was
    estimated of the measurement [-]; wavelength in nm.
    """
    wide = 1.6448536269514722 * fit.transmittance_deviation
    tables: dict[str, tuple[np.ndarray, str]] = {
        "measured_reflectance": (fit.measured[:, 0], "recorded reflectance used by the fit"),
        "measured_transmittance": (fit.measured[:, 1], "recorded transmittance used by the fit"),
        "fitted_reflectance": (fit.fitted[:, 0], "reflectance of the fitted measurement model"),
        "fitted_transmittance": (fit.fitted[:, 1], "transmittance of the fitted measurement model"),
        "reflectance": (fit.reflectance, "reflectance of one leaf"),
        "transmittance": (fit.transmittance, "transmittance of one leaf, also if not measured"),
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
        values = factors[name] * np.asarray(getattr(fit.parameters, name))
        attributes = {"units": _UNITS[name], "long_name": name.replace("_", " ")}
        variables[name] = ("leaf", values, attributes)
        deviation = factors[name] * fit.standard_deviation[:, i]
        text = f"standard deviation of {name.replace('_', ' ')}"
        variables[f"{name}_sd"] = ("leaf", deviation, attributes | {"long_name": text})
    for i, name in enumerate(fit.estimated):
        attributes = {"units": "1", "long_name": name.replace("_", " ")}
        variables[name] = ("leaf", fit.measurement[:, i], attributes)
        text = f"standard deviation of {attributes['long_name']}"
        variables[f"{name}_sd"] = (
            "leaf", fit.measurement_deviation[:, i], attributes | {"long_name": text}
        )  # fmt: skip
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


def species_table(
    groups: LeafGroups,
    seed: int,
    area: LeafArea = "projected",
    factors: Mapping[str, float] = PROJECTED,
) -> pd.DataFrame:
    """The mean leaf of each species (variant 0), and material variants of it.

    **Arguments:**

    - `groups`: species means and their spread, as `fynjax.leaf` fits them.
    - `seed`: of the variants.
    - `area`, `factors`: what contents are stated per, and `fynjax.leaf.area_factors` of that.

    **Returns:** species, variant, the area and parameters, in the units of `LeafParameters`.
    """
    drawn = groups.variants(_VARIANTS, seed)
    names = [name for name in groups.names if name in LEAF_PARAMETERS]

    def row(species: str, variant: int, leaf: LeafParameters, at: tuple[int, ...]) -> dict:
        values = {n: factors[n] * float(np.asarray(getattr(leaf, n))[at]) for n in names}
        return {"species": species, "variant": variant, **values, "area": area}

    rows = []
    for g, species in enumerate(groups.groups):
        rows.append(row(species, 0, groups.mean, (g,)))
        rows += [row(species, v + 1, drawn, (g, v)) for v in range(_VARIANTS)]
    return pd.DataFrame(rows)


def posterior_dataset(
    drawn: LeafPosterior,
    fit: LeafFit,
    files: Sequence[str],
    names: Sequence[str],
    settings: dict[str, str],
    factors: Mapping[str, float] = PROJECTED,
) -> xr.Dataset:
    """Draws from the posterior of leaves: parameters and transmittance.

    **Arguments:**

    - `drawn`: the draws, of `fynjax.leaf`.
    - `fit`: from which they started; it holds the wavelengths.
    - `files`, `names`: file and name of each spectrum.
    - `settings`: how the draws were made, the area of contents too; they become attributes.
    - `factors`: `fynjax.leaf.area_factors` of that area.

    **Returns:** parameters [leaf, draw] in the units of `LeafParameters`, transmittance [leaf,
    draw, wavelength] as fractions [-], effective number of draws and status of each leaf.
    """
    variables: dict[str, Any] = {
        name: (
            ("leaf", "draw"),
            factors.get(name, 1.0) * drawn.samples[:, :, i],
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

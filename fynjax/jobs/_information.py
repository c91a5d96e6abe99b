"""What a sensor can know about a plot: what `fynjax information` does."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from fynjax._core.progress import NullProgress, Progress
from fynjax.assembly import prepare, shown_unit
from fynjax.inversion import Information, SensorSetting, even_bands, sweep_sensors
from fynjax.io.plot import Plot, as_plot
from fynjax.io.raster import provenance
from fynjax.io.text import write_text
from fynjax.jobs._calibrate import peak_memory_mib
from fynjax.report.figures import bound_plot, save_figure, short_name
from fynjax.report.pages import Page


def information(
    plot: Plot | str | Path,
    output: Path,
    *,
    free: Sequence[str] | None = None,
    gsd: Sequence[float] = (0.1, 0.2, 0.5, 1.0, 2.0, 5.0),
    bands: Sequence[int] = (2, 4, 8),
    spectrum: tuple[float, float] = (450.0, 900.0),
    noise: Sequence[float] = (0.01,),
    sun_zenith: Sequence[float] | None = None,
    error: float = 0.01,
    replants: int = 4,
    seed: int | None = None,
    progress: Progress | None = None,
) -> dict[str, Any]:
    """Bounds on a plot's parameters for sensors of every pixel, number of bands, noise and sun.

    **Arguments:** `free`, patterns of parameters that replace those of the plot file; `gsd` [m],
    multiples of the smallest; `bands`, each a divisor of the largest, share `spectrum` [nm]; the
    rest as `sweep_sensors` has it. Writes a table, figures and a page.
    """
    progress = NullProgress() if progress is None else progress
    read = as_plot(plot)
    seed = read.seed if seed is None else seed
    with progress.stage("Build the plot"):
        ready = prepare(read, free, seed=seed, bands=even_bands(max(bands), *spectrum))
    found = sweep_sensors(
        ready.model,
        ready.parameters,
        ready.space,
        gsd=gsd,
        bands=bands,
        noise=noise,
        sun_zenith=sun_zenith,
        error=error,
        replants=replants,
        seed=seed,
        progress=progress,
    )
    table = bound_table(found, np.asarray(ready.space.prior))
    first, best = found[0]
    covers = [n for n in ready.space.names if n.startswith("species.") and n.endswith(".cover")]
    with progress.stage("Write"):
        record = provenance(seed=seed, inputs=[p for p in ready.plot.inputs if p is not None])
        limits = limit_table(table, covers)
        result = _write(output, ready.plot.name, table, limits, covers, first, best, record)
    return {"seed": seed, **result}


def bound_table(
    found: Sequence[tuple[SensorSetting, Information]], value: np.ndarray
) -> pd.DataFrame:
    """One row a sensor and parameter, in field units."""
    rows = []
    for setting, one in found:
        for i, name in enumerate(one.names):
            _, unit, factor = shown_unit(name)
            rows.append(
                {
                    "gsd_m": setting.gsd,
                    "bands": setting.bands,
                    "noise": setting.noise,
                    "sun_zenith": setting.sun_zenith,
                    "pixels": setting.pixels,
                    "parameter": name,
                    "unit": unit,
                    "value": factor * value[i],
                    "prior_sd": factor * one.prior_sd[i],
                    "alone": factor * one.alone[i],
                    "bound": factor * one.bound[i],
                    "unaided": factor * one.unaided[i],
                    "with_prior": factor * one.with_prior[i],
                    "constrained": one.constrained[i],
                }
            )
    return pd.DataFrame(rows)


def limit_table(table: pd.DataFrame, covers: Sequence[str]) -> pd.DataFrame:
    """The finest pixel from which on a species' cover is not to be told from absence.

    For each species, number of bands, noise and sun: the smallest pixel of the sweep from which
    on, at it and at every larger one, the bound exceeds the cover; NaN where the largest still
    tells it.
    """
    rows = []
    keys = ["parameter", "bands", "noise", "sun_zenith"]
    for key, part in table[table["parameter"].isin(covers)].groupby(keys, sort=False):
        part = part.sort_values("gsd_m")
        lost = (part["bound"] > part["value"]).to_numpy()
        # Of a run of losses up to the coarsest pixel, the first.
        held = np.flatnonzero(~lost)
        first = int(held[-1]) + 1 if held.size else 0
        gsd = part["gsd_m"].to_numpy()
        rows.append(
            {
                **dict(zip(keys, key)),
                "cover_percent": float(part["value"].iloc[0]),
                "lost_from_gsd_m": float(gsd[first]) if first < len(gsd) else np.nan,
            }
        )
    return pd.DataFrame(rows, columns=[*keys, "cover_percent", "lost_from_gsd_m"])


def _write(
    folder: Path,
    name: str,
    table: pd.DataFrame,
    limits: pd.DataFrame,
    covers: Sequence[str],
    setting: SensorSetting,
    best: Information,
    record: Any,
) -> dict[str, Any]:
    write_text(folder / "bounds.csv", table.to_csv(index=False, float_format="%.6g"))
    write_text(folder / "limits.csv", limits.to_csv(index=False, float_format="%.6g"))
    files = {
        "report.html": "all of it on one page",
        "bounds.csv": "bounds on every parameter by every sensor",
        "limits.csv": "the pixel from which on each cover is not to be told from absence",
    }
    headline = []
    finest, coarsest = table["gsd_m"].min(), table["gsd_m"].max()
    for count, part in limits.groupby("bands"):
        gone = part[part["lost_from_gsd_m"] <= finest]
        later = part[(part["lost_from_gsd_m"] > finest)]
        told = part[part["lost_from_gsd_m"].isna()]
        headline.append(
            f"{count} bands: of {len(part)} covers {len(gone)} exceed their bound at no pixel, "
            f"{len(later)} only at fine ones, {len(told)} up to {coarsest:g} m."
        )
    unseen = best.unseen()
    sensor = f"{setting.bands} bands, pixels of {setting.gsd:g} m, noise {100 * setting.noise:g} %"
    headline.append(
        f"{sensor}: {len(unseen)} of {len(best.names)} directions are out of sight; of the "
        f"parameters {int((best.constrained > 0.75).sum())} have their error halved or better."
    )
    page = Page(f"Information: {name}", " ".join(headline))
    if covers:
        first = table[
            (table["noise"] == table["noise"].iloc[0])
            & (table["sun_zenith"] == table["sun_zenith"].iloc[0])
        ]
        save_figure(bound_plot(first, covers), folder / "cover_bounds.png")
        files["cover_bounds.png"] = "bound on each cover against the pixel"
        page.section("Cover").figure(
            folder / "cover_bounds.png",
            "Cramér-Rao bound on each species' cover over the cover itself, the other parameters "
            "as uncertain as their priors. In the shaded part the cover is not to be told from "
            "absence; lines that leave the panel have no bound.",
        )
        page.table(limits.assign(parameter=limits["parameter"].map(short_name)),
                   caption="Where each cover is lost (–: not in this sweep).")  # fmt: skip
    page.section("Out of sight").paragraph(
        f"Directions that {sensor} cannot see (largest members): "
        + "; ".join(
            ", ".join(f"{short_name(n)} {w:+.2f}" for n, w in d.items()) for d in unseen[:8]
        )
        + "."
        if unseen
        else "There is no direction out of sight."
    )
    page.table(table, caption="Every bound.", folded=True)
    page.footer(record)
    page.write(folder / "report.html")
    return {
        "headline": headline,
        "files": files,
        "limits": limits.to_dict("records"),
        "unseen": unseen,
        "peak_memory_mib": peak_memory_mib(),
    }

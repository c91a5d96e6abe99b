"""The plot burnt in 2006: what the paper prints as real, its DIRSIG, and fynjax before and after
calibration to the drone image.

    python -m tests.benchmarks.table_2006 [--calibration DIR] [--output DIR]

`--calibration` is the output folder of `fynjax demo`, which is run if it is left out. The drone
image is what the calibration was fitted to; spectrometer and LiDAR are predictions. LiDAR numbers
are those of the paper's simulated system and of an aircraft's scanner, as the real one was, in the
conventions of each known tool and with gaps as canopy cells without a return above the ground,
since the paper does not state its own.
"""

import shutil
import warnings
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import laspy
import numpy as np
import pandas as pd

from fynjax.compare import table5_2006
from fynjax.compare._images import read_drone_image
from fynjax.compare._published import compare_with_published, wins
from fynjax.compare.structure import structure_2006
from fynjax.io.plot import example_folder
from fynjax.jobs import render, simulate
from fynjax.metrics import spectral_mask
from fynjax.metrics.structure import (
    STRUCTURE_PRESETS,
    StructureSettings,
    bin_returns,
    cell_grid,
    cell_structure,
)
from fynjax.studies.fynbos_2006 import SWIR2_MEAN, demo
from tests.benchmarks._measure import options
from tests.helpers import read_cube

SEED = 0
REAL_RETURNS = 1317  # 13.17 per m2 on 100 m2
GRAIN = 2.0  # m
LIDARS = ("flash_lidar_paper", "scanning_lidar")
CONVENTIONS = {
    "fynjax": StructureSettings(),
    "gaps by cells of 0.5 m": replace(StructureSettings(), gap_of="canopy"),
    **STRUCTURE_PRESETS,
}


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the table."""
    parser = options(__doc__)
    parser.add_argument("--calibration", type=Path, help="output folder of `fynjax demo`")
    parser.add_argument("--output", type=Path, help="where the simulations and table.csv stay")
    given = parser.parse_args(arguments)
    with TemporaryDirectory() as scratch:
        output = given.output or Path(scratch)
        output.mkdir(parents=True, exist_ok=True)
        calibration, tiny = given.calibration, given.tiny
        if calibration is None and not tiny:
            calibration = output / "demo"
            calibration.mkdir()
            demo(calibration, seed=SEED)
        columns = {}
        lidars = LIDARS[:1] if tiny else LIDARS
        for name, values in (("uncalibrated", None), ("calibrated", calibration))[: 2 - tiny]:
            folder = output / name
            _simulate(_plot(folder / "plot", values, tiny), folder, lidars)
            columns[name] = pd.concat(
                [_drone(folder), _spectrometer(folder), *(_lidar(folder, l, tiny) for l in lidars)]
            )
        table = columns["uncalibrated"].drop(columns="simulated")
        for name, column in columns.items():
            table[name] = column["simulated"]
        for name in ("dirsig", *columns):
            error = 100.0 * (table[name] - table["real"]) / table["real"].abs()
            table[f"{name}_error_percent"] = error
        table.to_csv(output / "table.csv", index=False, float_format="%.5g")
    print(table.to_string(index=False, float_format=lambda v: f"{v:.4g}", na_rep=""))
    drone = table[table["sensor"] == "drone"].dropna(subset=["dirsig_abs_error_percent"])
    for name in columns:
        renamed = drone.assign(simulated_error_percent=drone[f"{name}_error_percent"])
        nearer, of = wins(renamed)
        print(f"drone, {name}: nearer to the real image than DIRSIG in {nearer} of {of} numbers")


def _plot(folder: Path, calibration: Path | None, tiny: bool) -> Path:
    """The shipped plot file, with the estimates of a calibration; where `tiny`, of 2 m and two
    species with usual leaves."""
    shutil.copytree(example_folder(), folder)
    path = folder / "plot.toml"
    text = path.read_text("utf-8")
    if calibration is not None:
        shutil.copy(calibration / "parameters.csv", folder)
        text = text.replace("[scene]\n", '[scene]\nparameters = "parameters.csv"\n')
    if tiny:
        text = text.replace("size_m = 10.0", "size_m = 2.0").replace(
            "leaf_table =", "# leaf_table ="
        )
        lines = (folder / "species.csv").read_text("utf-8").splitlines()
        head = sum(line.startswith("#") for line in lines)
        (folder / "species.csv").write_text("\n".join(lines[: head + 3]))
    path.write_text(text)
    return path


def _simulate(plot: Path, folder: Path, lidars: Sequence[str]) -> None:
    for name in ("drone", "aviris_ng", *lidars):
        (folder / name).mkdir()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # the paper's pixel against the optics
        render(plot, folder / "drone", seed=SEED)
        simulate(
            plot, folder / "aviris_ng", sensor="aviris_ng", pixel=3.0, products=["reflectance"]
        )
    for name in lidars:
        simulate(plot, folder / name, sensor=name, seed=SEED)


def _drone(folder: Path) -> pd.DataFrame:
    image = read_drone_image(folder / "drone" / "image.tif")
    table = compare_with_published(image).statistics
    keep = ["statistic", "status", "real", "dirsig", "dirsig_abs_error_percent", "simulated"]
    return table[keep].assign(sensor="drone")


def _spectrometer(folder: Path) -> pd.DataFrame:
    cube = read_cube(folder / "aviris_ng" / "reflectance.tif")
    mean = cube.values.mean(axis=(1, 2))
    wavelength = cube.wavelength
    rows = []
    for region, row in table5_2006().items():
        inside = spectral_mask(wavelength, region) & np.isfinite(mean)
        # NRMSE is RMSE over the range of the real spectrum, so the two printed give it.
        rows.append(
            {
                "statistic": f"{region} range of reflectance",
                "status": "derived",
                "real": row.rmse / row.nrmse,
                "simulated": np.ptp(mean[inside]),
            }
        )
    inside = spectral_mask(wavelength, "swir2") & np.isfinite(mean)
    rows.append(
        {
            "statistic": "swir2 mean reflectance",
            "status": "printed",
            **SWIR2_MEAN,
            "simulated": mean[inside].mean(),
        }
    )
    return pd.DataFrame(rows).assign(sensor="aviris_ng")


def _lidar(folder: Path, sensor: str, tiny: bool) -> pd.DataFrame:
    cloud = laspy.read(folder / sensor / "cloud.laz")
    x, y, z = (np.asarray(getattr(cloud, axis)) for axis in "xyz")
    side = 2.0 if tiny else 10.0
    grid = cell_grid((0.0, 0.0, side, side), GRAIN)
    kept, times = min(len(x), REAL_RETURNS), 2 if tiny else 100
    published, rows = structure_2006(), []
    for name, settings in CONVENTIONS.items():
        found: dict[str, list[float]] = {}
        rng = np.random.default_rng(SEED)
        for _ in range(times):
            chosen = rng.choice(len(x), kept, replace=False)
            cells = cell_structure(bin_returns(x[chosen], y[chosen], z[chosen], grid, settings))
            for metric, values in cells.metrics.items():
                known = values[np.isfinite(values)]
                found.setdefault(metric, []).append(known.mean() if known.size else np.nan)
        for metric, printed in published.items():
            if printed.real is not None:
                rows.append(
                    {
                        "statistic": f"{metric} ({name})",
                        "status": "conventions not printed",
                        "real": printed.real,
                        "dirsig": printed.simulated,
                        "simulated": float(np.median(found[metric])),
                    }
                )
    return pd.DataFrame(rows).assign(sensor=sensor)


if __name__ == "__main__":
    main()

"""What a map costs: simulations, pixels a CPU second beside reading the cube alone.

    python -m tests.benchmarks.bench_map [--training training.nc] [--pixels 200000]

Without a training it times simulations, too, and trains on few of them.
"""

import argparse
import resource
import tempfile
from pathlib import Path

import numpy as np
import rasterio

from fynjax.io.raster import open_blocks
from fynjax.jobs import map_cube, train
from fynjax.sensors import shipped_sensor


def cpu() -> float:
    """CPU time of this process [s]."""
    usage = resource.getrusage(resource.RUSAGE_SELF)
    return usage.ru_utime + usage.ru_stime


def write_cube(path: Path, sensor: str, rows: int, columns: int) -> None:
    """An ENVI cube of shrubland-like spectra, interleaved by pixel."""
    bands = shipped_sensor(sensor).bands
    centre = np.asarray(bands.centre)
    rng = np.random.default_rng(0)
    spectrum = 0.05 + 0.2 / (1.0 + np.exp(-(centre - 720.0) / 15.0)) - 5e-5 * (centre - 400.0)
    profile = {"driver": "ENVI", "dtype": "float32", "interleave": "bip", "crs": "EPSG:32734"}
    profile |= {"count": len(centre), "height": rows, "width": columns}
    profile["transform"] = rasterio.Affine(5, 0, 0, 0, -5, 0)
    listed = lambda values: "{" + ",".join(f"{v:.6g}" for v in values) + "}"  # noqa: E731
    with rasterio.open(path, "w", **profile) as file:
        bright = rng.uniform(0.8, 1.2, (1, rows, columns))
        file.write((np.maximum(spectrum, 0.02)[:, None, None] * bright).astype(np.float32))
        file.update_tags(
            ns="ENVI", wavelength=listed(centre), fwhm=listed(bands.fwhm),
            wavelength_units="Nanometers",
        )  # fmt: skip


def main() -> None:
    """Print the figures."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--training", type=Path)
    parser.add_argument("--sensor", default="aviris_ng")
    parser.add_argument("--pixels", type=int, default=200000)
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as work:
        folder = Path(work)
        training = given.training
        if training is None:
            began = cpu()
            first = train(
                folder / "warm", sensor=given.sensor, simulations=200, steps=10,
                checkpoint=folder / "warm.checkpoint",
            )  # fmt: skip
            compiled, began = cpu() - began, cpu()
            made = train(
                folder / "training", sensor=given.sensor, simulations=1600, steps=1000,
                checkpoint=folder / "checkpoint", seed=1,
            )  # fmt: skip
            print(f"first {first.simulations} spectra with compilation: {compiled:.0f} CPU s")
            per = made.timings_s["simulation"] / made.simulations
            print(f"simulation {1e3 * per:.1f} ms a spectrum (wall), {cpu() - began:.0f} CPU s")
            training = folder / "training" / "training.nc"
        columns = 1000
        rows = given.pixels // columns
        path = folder / "cube.dat"
        write_cube(path, given.sensor, rows, columns)
        began = cpu()
        with open_blocks(path) as cube:
            for start in range(0, rows, cube.rows_at_once):
                cube.read(start, min(cube.rows_at_once, rows - start))
        reading = cpu() - began
        for run in ("first", "second"):
            began = cpu()
            map_cube(path, training, folder / run, checkpoint=folder / f"{run}.checkpoint")
            spent = cpu() - began
            print(
                f"{run} map: {given.pixels / spent:.0f} pixels a CPU s; reading alone "
                f"{given.pixels / reading:.0f}"
            )
        print(f"10^9 pixels: {1e9 / (given.pixels / spent) / 3600:.1f} CPU h")


if __name__ == "__main__":
    main()

"""One tiny case of every command."""

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np
import pandas as pd
from typer.testing import CliRunner

from fynjax.app.cli import app
from fynjax.app.io.raster import write_geotiff
from fynjax.app.jobs import render_plot
from fynjax.leaf import LeafParameters, prospect
from fynjax.metrics import BANDS
from tests.canopy.test_pattern import BANDS as PATTERN_BANDS
from tests.canopy.test_pattern import drawn as drawn_pattern
from tests.cli import test_build
from tests.compare.test_spectra import WAVE, cube, write_csv
from tests.compare.test_structure import plot as drawn_cloud
from tests.compare.test_structure import write_las
from tests.frozen.numbers import Numbers, numbers_of
from tests.io.flight_pictures import write_pictures
from tests.io.frame_files import CRS as FLIGHT_CRS
from tests.io.frame_files import GROUND, ORIGIN, write_odm
from tests.io.rededge_files import lit, panel_scene, write_rededge
from tests.jobs import test_simulate
from tests.jobs.test_reflectance import PANEL, ground
from tests.jobs.test_validate import drawn
from tests.small import write_plot
from tests.studies.test_bioscape_validate import write_tables
from tests.studies.test_learn import write_population
from tests.terrain.synthetic import shrubland

RESIDUAL = "largest_residual"
"""What iterations of light leave, the difference of nearly equal numbers."""

Runs = Mapping[str, list[Any]]
"""The command lines of a case, in order, by the names of their output folders."""


class Case(NamedTuple):
    """A function that writes the input into a folder and says what to run, of which `out` there
    holds the results; and the mark of the test.

    `loose` is what numbers may differ by that amplify rounding, by pattern: some three times what
    another set of flags of XLA and two threads instead of one changed. All others kept 1e-5.
    """

    runs: Callable[[Path], Runs]
    mark: str | None
    loose: Mapping[str, float]


CASES: dict[str, Case] = {}


def _case(
    command: str, mark: str | None = None, loose: Mapping[str, float] | None = None
) -> Callable[[Callable[[Path], Runs]], Callable[[Path], Runs]]:
    def add(runs: Callable[[Path], Runs]) -> Callable[[Path], Runs]:
        CASES[command] = Case(runs, mark, loose or {})
        return runs

    return add


def run(command: str, folder: Path) -> Numbers:
    """The numbers of what `fynjax command` writes, with its input and results in `folder`."""
    out = folder / "out"
    out.mkdir()
    for name, line in CASES[command].runs(folder).items():
        line = list(map(str, line))
        if line[0] not in ("sensors", "doctor", "identify", "view"):
            line += ["--output", str(out / name), "--quiet"]
        result = CliRunner().invoke(app, line, catch_exceptions=False)
        assert result.exit_code == 0, f"{line}: {result.output}"
        if line[0] in ("sensors", "doctor", "identify"):
            (out / f"{name}.json").write_text(json.dumps(json.loads(result.stdout)))
        if line[0] == "view":
            page = Path("".join(result.stdout.split("\n")))
            (out / page.name).write_text("")
    return numbers_of(out)


SMALL = """
[sensor]
pixel_m = 0.1
[calibration]
free = ["species.*.cover", "species.Erica*.leaf.chlorophyll", "ground.brightness"]
max_iterations = 2
"""
TARGET = "statistic,value,sd\nred.mean,0.06,0.002\nnir.mean,0.22,0.005\nNDVI.std,0.2,0.05\n"


def _small(folder: Path) -> tuple[Path, Path]:
    """A plot file, and statistics of its image."""
    (folder / "target.csv").write_text(TARGET)
    return write_plot(folder, SMALL), folder / "target.csv"


@_case("demo", "study", {"weakly_constrained": np.inf, "": 6e-4})
def _demo(folder: Path) -> Runs:
    return {"demo": ["demo"]}


@_case("article", "study", loose={"others|structure|returns": 1e-3})
def _article(folder: Path) -> Runs:
    (folder / "parameters.csv").write_text(
        "name,unit,estimate\nground.brightness,-,0.9\nspecies.Erica irregularis.cover,%,25\n"
    )
    rows = [f"{band}.mean,0.1,{0.1 * gain},0.1" for band, gain in zip(BANDS, (0.9, 0.9, 0.7, 1.1))]
    text = "\n".join(["statistic,after,with_gain,image_after", *rows])
    (folder / "statistics.csv").write_text(text)
    small = ["--size", 2, "--pixel", 0.2, "--channels", 20]
    return {"small": ["article", "--calibration", folder, *small]}


@_case("render")
def _render(folder: Path) -> Runs:
    plot, _ = _small(folder)
    fine = folder / "fine.toml"
    fine.write_text(plot.read_text().replace('structure_m = "even"\n', "hot_spot = true\n"))
    return {"even": ["render", plot], "fine": ["render", fine]}


@_case(
    "simulate",
    loose={RESIDUAL: 1e-3, "^lidar/(cloud|heights|truth|waveforms)": 3e-3, "^lidar/summary": 2e-2},
)
def _simulate(folder: Path) -> Runs:
    plot, _ = _small(folder)
    (folder / "camera").mkdir()
    camera = test_simulate.write_plot(folder / "camera")
    return {
        "camera": ["simulate", camera, "--seed", 4],
        "lidar": ["simulate", plot, "--sensor", "flash_lidar_paper"],
        "angles": ["simulate", plot, "--angles"],
    }


@_case("doctor", loose={"found": np.inf})
def _doctor(folder: Path) -> Runs:
    return {"doctor": ["doctor", "--json"]}


@_case("sensors")
def _sensors(folder: Path) -> Runs:
    return {"sensors": ["sensors", "--json"]}


@_case("build")
def _build(folder: Path) -> Runs:
    (folder / "species.csv").write_text(test_build.SPECIES)
    (folder / "plot.toml").write_text(test_build.PLOT)
    (folder / "own").mkdir()
    own = write_plot(folder / "own")
    own.write_text(own.read_text().replace('cover_definition = "article"\n', ""))
    return {
        "build": ["build", folder / "plot.toml", "--mesh", "--triangles", 20_000],
        "projected": ["build", own],
    }


@_case("calibrate", "study", {"weakly_constrained": 1e-3, "": 1e-4})
def _calibrate(folder: Path) -> Runs:
    plot, target = _small(folder)
    spectrum, cloud = folder / "spectrum.csv", folder / "cloud.csv"
    spectrum.write_text("wavelength_nm,mean\n550,0.06\n680,0.08\n860,0.26\n1650,0.22\n")
    cloud.write_text("metric,value,sd,grain_m,returns_m2\ngap_fraction,0.45,0.02,1,100\n")
    return {
        "drone": ["calibrate", plot, "--target", target],
        "others": ["calibrate", plot, "--target", spectrum, "--target", cloud],
    }


@_case("bioscape-calibrate", "study", loose={"": 3e-2})
def _calibrate_plots(folder: Path) -> Runs:
    write_tables(folder / "tables")
    return {"plots": ["bioscape", "calibrate", folder / "tables", "--size", 2]}


@_case("posterior", "study", loose={"^emcee": 5e-4, "^laplace": 2e-4})
def _posterior(folder: Path) -> Runs:
    plot, target = _small(folder)
    line = ["posterior", plot, "--target", target]
    return {
        "laplace": [*line, "--method", "laplace"],
        "emcee": [*line, "--steps", 4, "--draws", 10],
    }


@_case("sensitivity", "study", loose={"metric_sd|bound": 1e-4})
def _sensitivity(folder: Path) -> Runs:
    line = ["sensitivity", _small(folder)[0], "--metrics", "nir.mean,NDVI.std", "--plantings", 2]
    return {"sensitivity": [*line, "--derivatives", 2, "--sobol", 2]}


@_case("information")
def _information(folder: Path) -> Runs:
    line = ["information", _small(folder)[0], "--gsd", "0.1,0.5", "--bands", "2,4"]
    (folder / "flown").mkdir()
    flown = write_plot(folder / "flown", SMALL, voxel=0.2)
    flight = ["information", flown, "--frames", "1,3", "--oblique", "0,4", "--pulses", "50"]
    return {"information": [*line, "--realisations", 2], "flight": [*flight, "--realisations", 2]}


@_case("design", "study", loose={"gain": np.inf, "": 2e-2})
def _design(folder: Path) -> Runs:
    line = ["design", _small(folder)[0], "--bands", 2, "--target", "crown_cover,dead_share"]
    line += ["--free", "species.*.cover", "--free", "species.*.dead_fraction", "--spectrum"]
    line += ["400,1000", "--compare", "mavic_3m", "--plantings", 4, "--starts", 1, "--pixel"]
    line += ["0.1,0.2"]
    return {"design": line}


@_case("crowns", "study", loose={"": 1e-2})
def _crowns(folder: Path) -> Runs:
    plot = _small(folder)[0]
    render_plot(plot, folder / "rendered", seed=5)
    image = next((folder / "rendered").glob("*.tif"))
    return {"crowns": ["crowns", image, "--plot", plot, "--rounds", 2]}


def _leaves(folder: Path) -> Path:
    """Reflectance and transmittance of three leaves, as text."""
    leaves = LeafParameters.many(chlorophyll=np.array([20.0, 40.0, 60.0]), water=0.01)
    optics = jax.vmap(prospect)(leaves)
    table = {"wavelength": np.asarray(optics.wavelength)[0]}
    for i, (r, t) in enumerate(zip(optics.reflectance, optics.transmittance)):
        table |= {f"leaf{i}_R": np.round(r, 4), f"leaf{i}_T": np.round(t, 4)}
    pd.DataFrame(table).to_csv(folder / "leaves.csv", index=False)
    return folder / "leaves.csv"


@_case("fit-leaf")
def _fit_leaf(folder: Path) -> Runs:
    return {"D": ["fit-leaf", _leaves(folder)],
            "PRO": ["fit-leaf", _leaves(folder), "--version", "PRO"]}  # fmt: skip


@_case("convert")
def _convert(folder: Path) -> Runs:
    return {"convert": ["convert", _leaves(folder)]}


@_case("plant")
def _plant(folder: Path) -> Runs:
    line = ["plant", "Chironia baccifera", "--elements", 400, "--max-triangles", 5000]
    mesh = ["plant", folder / "out" / "taxon" / "plant.obj", "--elements", 100, "--branches", 3]
    return {"taxon": line, "branches": mesh}


@_case("diversity", "study", loose={"": 1e-3})
def _diversity(folder: Path) -> Runs:
    plot, _ = _small(folder)
    line = ["diversity", plot, "--communities", 10, "--size", 1, "--pixels", "0.125,0.25,0.5"]
    return {"diversity": [*line, "--bands", 6, "--richness", "1,2", "--samples", 5]}


@_case("bioscape-learn", "study")
def _learn(folder: Path) -> Runs:
    write_population(folder / "tables")
    plots = [part for i in range(4) for part in ("--plot", f"P{i}")]
    line = ["bioscape", "learn", folder / "tables", *plots, "--size", 2, "--voxel", 0.25]
    return {"learn": line}


# More steps would amplify rounding.
TRAIN = ["train", "sentinel_2a", "--sun-zenith", "25-35", "--simulations", 200, "--steps", 30]


@_case("train", "study")
def _train(folder: Path) -> Runs:
    return {"train": TRAIN}


@_case("fit-canopy", "study")
def _fit_canopy(folder: Path) -> Runs:
    peers = pd.read_csv(Path(__file__).parents[1] / "inversion" / "canopies_by_prosail.csv")
    peers.iloc[:3, 9:].to_csv(folder / "pixels.csv", index=False)
    known = ["--known", "leaf_angle=50", "--known", "structure=1.6"]
    return {"table": ["fit-canopy", folder / "pixels.csv", "--sun-zenith", 35, *known]}


@_case("map", "study")
def _map(folder: Path) -> Runs:
    rng = np.random.default_rng(5)
    names = [f"B{i}" for i in range(1, 14)]
    centre = [443, 492, 560, 665, 704, 741, 783, 833, 865, 945, 1374, 1614, 2202]
    level = [0.03, 0.04, 0.05, 0.06, 0.1, 0.17, 0.2, 0.22, 0.23, 0.23, 0.01, 0.2, 0.12]
    image = np.array(level)[:, None, None] * rng.uniform(0.8, 1.2, (13, 3, 4))
    write_geotiff(
        folder / "cube.tif", image.astype(np.float32), names, pixel_m=10.0, crs="EPSG:32734",
        wavelengths=centre, widths=[20.0] * 13,
    )  # fmt: skip
    training = folder / "out" / "train" / "training.nc"
    line = ["map", folder / "cube.tif", "--training", training, "--keep-unlike", "--zarr"]
    return {"train": TRAIN, "map": line}


@_case("terrain")
def _terrain(folder: Path) -> Runs:
    cloud, _ = shrubland(density=10.0)
    points = pd.DataFrame({"x": cloud.x, "y": cloud.y, "z": cloud.z}).round(4)
    points.to_csv(folder / "plot.csv", index=False)
    line = ["terrain", folder / "plot.csv", "--size", 20, "--cell", 0.5, "--unit", "metre"]
    raster = ["terrain", folder / "out" / "cloud" / "terrain.tif", "--size", 10]
    return {"cloud": line, "raster": raster}


@_case("frames")
def _frames(folder: Path) -> Runs:
    plot = write_plot(folder)
    flight = write_odm(folder / "flight")
    (east, north), where = ORIGIN, ["--crs", FLIGHT_CRS, "--ground", GROUND]
    line = ["frames", flight, "--plot", plot, "--origin", f"{east},{north}", *where]
    images = ["--images", write_pictures(folder / "images"), "--most", 2]
    return {"frames": [*line, "--pixel", 0.25], "pictures": [*line, "--pixel", 0.25, *images]}


@_case("reflectance")
def _reflectance(folder: Path) -> Runs:
    (folder / "flight").mkdir()
    write_rededge(folder / "flight", "IMG_0000", lit(panel_scene()[0]))
    write_rededge(folder / "flight", "IMG_0001", lit(ground()))
    return {"reflectance": ["reflectance", folder / "flight", *PANEL, "--height", 60]}


@_case("bioscape-plots")
def _bioscape(folder: Path) -> Runs:
    write_tables(folder / "tables")
    return {"bioscape": ["bioscape", "plots", folder / "tables"]}


@_case("pattern")
def _pattern(folder: Path) -> Runs:
    write_geotiff(folder / "a.tif", drawn_pattern()[0], PATTERN_BANDS, pixel_m=0.1)
    return {"pattern": ["pattern", folder / "a.tif", "--levels", "0,128,255"]}


@_case("validate")
def _validate(folder: Path) -> Runs:
    for i, name in enumerate(("real", "simulated")):
        write_geotiff(folder / f"{name}.tif", drawn(1 + i, 30, 30), BANDS, pixel_m=0.05 + 0.05 * i)
        write_csv(folder / f"{name}.csv", (1.0 - 0.2 * i) * cube().reshape(len(WAVE), -1).T)
        x, y, height, *_ = drawn_cloud(i, 13.0 + 10.0 * i)
        write_las(folder / f"{name}.las", x, y, height)
    files = [
        part
        for kind, ending in (("drone", "tif"), ("spectra", "csv"), ("cloud", "las"))
        for name in ("real", "simulated")
        for part in (f"--{name}-{kind}", folder / f"{name}.{ending}")
    ]
    return {"validate": ["validate", *files, "--real-ground", "none", "--simulated-ground", "none",
                         "--repetitions", 3, "--bounds", "0,0,10,10"]}  # fmt: skip


@_case("bioscape-validate", loose={RESIDUAL: 1e-3})
def _validate_plots(folder: Path) -> Runs:
    write_tables(folder / "tables")
    return {"plots": ["bioscape", "validate", folder / "tables", "--size", 2, "--voxel", 0.25]}


@_case("init")
def _init(folder: Path) -> Runs:
    return {
        "heath": ["init"],
        "paper": ["init", "--example", "fynbos"],
        "later": ["init", "--burnt", 2016],
    }


@_case("identify")
def _identify(folder: Path) -> Runs:
    (folder / "leaves.csv").write_text("wavelength,oak,elm\n500,0.05,0.06\n800,0.45,0.42\n")
    plants = folder / "releve.csv"
    plants.write_text("Species,Cover,Height (cm)\nErica arborea,40,120\nUlex minor,5,40\n")
    return {"identify": ["identify", folder / "leaves.csv", plants, "--json"]}


@_case("view")
def _view(folder: Path) -> Runs:
    (folder / "run").mkdir()
    (folder / "run" / "report.html").write_text("")
    return {"view": ["view", folder / "run", "--print"]}

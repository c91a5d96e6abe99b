"""The commands: what each is called, which job it is, and an example.

All else, options and help, is read in the signature and the docstring of the job.
"""

from collections.abc import Mapping
from typing import NamedTuple

_JOBS, _CLI = "fynjax.app.jobs", "fynjax.app.cli._plain"
_PLOT, _COMMUNITIES = "fynjax.studies.fynbos_2006", "fynjax.studies.communities"
_BIOSCAPE = "fynjax.studies.bioscape"


class Command(NamedTuple):
    """A command of the command line."""

    name: str
    job: str
    """Module and function."""
    panel: str
    example: str
    given: str = "PLOT.toml"
    """What stands in help for the argument without a flag: the job's first one that has a place
    before or after the folder of its results."""
    names: Mapping[str, str] = {}
    """Options that are named otherwise than the arguments of the job."""
    panels: Mapping[str, str] = {}
    """Headings in help of options that are fields of a record, by the record's argument."""
    optional: Mapping[str, object] = {}
    """What the command takes for an argument that the job must have, if it is left out."""
    keeps: bool = False
    """Whether the unfinished run stays when the run has succeeded, for a longer one."""
    plain: bool = False
    """Whether it writes no folder of results; its function prints what it finds."""


COMMANDS = (
    Command("demo", f"{_PLOT}:demo", "Plot", "fynjax demo --output my_demo"),
    Command(
        "init", f"{_CLI}:init", "Plot",
        "fynjax init my_plot --table releve.xlsx --place 43.75,3.70 --image ortho.tif",
        given="DIR", plain=True,
    ),
    Command("build", f"{_JOBS}:build", "Plot", "fynjax build plot.toml --size 20 --output scene",
            names={"max_triangles": "triangles"}),
    Command("render", f"{_JOBS}:render_plot", "Plot", "fynjax render plot.toml --output render"),
    Command("view", f"{_CLI}:view", "Plot", "fynjax view output/demo", given="RUN", plain=True,
            names={"print_path": "print"}),
    Command("article", f"{_PLOT}:article", "Plot", "fynjax article --calibration output/demo"),
    Command(
        "plant", f"{_JOBS}:plant", "Plot",
        'fynjax plant "Metalasia muricata" --elements 5000 --output metalasia',
        given="MESH|SCAN|TAXON", names={"n_elements": "elements"},
    ),
    Command("terrain", f"{_JOBS}:terrain", "Plot",
            "fynjax terrain plot.laz --size 66 --output terrain", given="FILE"),
    Command("pattern", f"{_JOBS}:pattern", "Plot",
            "fynjax pattern orthophoto.tif --levels 0,128,255 --output pattern",
            given="IMAGE..."),
    Command("fit-leaf", f"{_JOBS}:fit_leaves", "Leaf",
            "fynjax fit-leaf leaf_1.asd leaf_2.asd --output traits", given="SPECTRUM..."),
    Command("convert", f"{_JOBS}:convert", "Leaf",
            "fynjax convert campaign leaf_1.asd --output spectra", given="SPECTRUM..."),
    Command("doctor", f"{_CLI}:doctor", "This machine", "JAX_PLATFORMS=cpu fynjax doctor",
            plain=True),
    Command("identify", f"{_CLI}:identify", "This machine",
            "fynjax identify leaves.csv ortho.tif", given="FILE...", plain=True),
    Command("sensors", f"{_CLI}:sensors", "Sensors",
            "fynjax simulate plot.toml --sensor scanning_lidar", plain=True),
    Command("simulate", f"{_JOBS}:simulate", "Sensors",
            "fynjax simulate plot.toml --sensor aviris_ng --pixel 3 --output aviris"),
    Command(
        "reflectance", f"{_JOBS}:reflectance", "Sensors",
        "fynjax reflectance flight --panel IMG_0000 --panel-reflectance panel.csv --height 70",
        given="FOLDER_OR_FILES...",
    ),
    Command("frames", f"{_JOBS}:frames", "Sensors",
            "fynjax frames odm_report/shots.geojson --plot plot.toml --ground 312.4",
            given="FLIGHT"),
    Command(
        "calibrate", f"{_JOBS}:calibrate", "Inversion",
        "fynjax calibrate plot.toml --target statistics.csv --target cloud.laz",
        optional={"targets": ()},
    ),
    Command("crowns", f"{_JOBS}:crowns", "Inversion",
            "fynjax crowns ortho.tif --plot plot.toml --output crowns", given="ORTHO.tif"),
    Command(
        "fit-canopy", f"{_JOBS}:fit_pixels", "Inversion",
        "fynjax fit-canopy pixels.csv --sensor sentinel_2a --sun-zenith 35 --output traits",
        given="PIXELS",
    ),
    Command(
        "posterior", f"{_JOBS}:posterior", "Inversion",
        "fynjax posterior plot.toml --target statistics.csv --method laplace",
        names={"target_size": "draws", "max_steps": "steps"}, keeps=True,
    ),
    Command(
        "sensitivity", f"{_JOBS}:sensitivity", "Inversion",
        "fynjax sensitivity plot.toml --metrics NDVI.mean,nir.mean --derivatives 64",
    ),
    Command(
        "information", f"{_JOBS}:plot_information", "Inversion",
        "fynjax information plot.toml --free 'species.*.cover' --gsd 0.1,0.5,1,5 --bands 2,4,8",
        names={"sun_zenith": "sun"},
    ),
    Command(
        "design", f"{_JOBS}:design_bands", "Inversion",
        "fynjax design plot.toml --bands 4 --target dead_share,shannon --output designed",
    ),
    Command(
        "validate", f"{_JOBS}:validate", "Validation",
        "fynjax validate --real-drone plot.tif --simulated-drone image.tif --output validation",
        panels={"cloud_options": "Point clouds"},
    ),
    Command("train", f"{_JOBS}:train", "Many plots",
            "fynjax train emit --sun-zenith 25-35 --output emit_30", given="SENSOR"),
    Command(
        "map", f"{_JOBS}:map_cube", "Many plots",
        "fynjax map flight.hdr --training emit_30/training.nc --output maps",
        given="CUBE", keeps=True,
    ),
    Command(
        "diversity", f"{_COMMUNITIES}:diversity", "Many plots",
        "fynjax diversity --communities 20 --size 5 --pixels 0.05,0.1,0.5,1,2.5 --output out",
        given="PLOT",
    ),
    Command("bioscape plots", f"{_BIOSCAPE}:run_bioscape", "Many plots",
            "fynjax bioscape plots tables --output plots && fynjax render plots/T068/plot.toml",
            given="FOLDER"),
    Command("bioscape learn", f"{_BIOSCAPE}:learn", "Many plots",
            "fynjax bioscape learn tables --output population", given="FOLDER..."),
    Command("bioscape validate", f"{_BIOSCAPE}:validate_plots", "Many plots",
            "fynjax bioscape validate tables --output validation", given="FOLDER"),
    Command("bioscape calibrate", f"{_BIOSCAPE}:calibrate_plots", "Many plots",
            "fynjax bioscape calibrate tables --output inference", given="FOLDER"),
)  # fmt: skip

"""JSON Schemas of the files a user meets, made from the models.

`python -m fynjax.app.jobs._schemas` writes them to `data_schemas/` of the checkout.
"""

import json
import sys
from functools import reduce
from operator import or_
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field, TypeAdapter

from fynjax import jobs
from fynjax.app.io.instruments import BandRow, CurveRow, LidarFile, NoiseRow, SensorFile
from fynjax.app.io.plot import (
    CameraRow,
    CrownRow,
    LeafFileRow,
    ParameterRow,
    PlotFile,
    PriorFile,
    SkyPatternRow,
    SkyRow,
    StatisticRow,
    StructureRow,
)
from fynjax.app.io.text import write_text
from fynjax.scene import LeafRow, SpeciesRow

RESULTS = [
    getattr(jobs, name)
    for name in sorted(dir(jobs))
    if name.endswith("Result") and name != "JobResult"
]
"""Results of the commands of `fynjax.app.jobs`; those of `fynjax.studies` add fields likewise."""
Summary: Any = Annotated[
    reduce(or_, RESULTS),
    Field(description="What `--json` prints and `summary.json` holds, by the command."),
]

SCHEMAS: dict[str, Any] = {
    "plot": PlotFile,
    "species_table_row": SpeciesRow,
    "crowns_row": CrownRow,
    "cameras_row": CameraRow,
    "leaf_table_row": LeafRow,
    "leaf_spectra_row": LeafFileRow,
    "sky_table_row": SkyRow,
    "sky_pattern_row": SkyPatternRow,
    "statistics_row": StatisticRow,
    "structure_row": StructureRow,
    "parameters_row": ParameterRow,
    "prior": PriorFile,
    "lidar": LidarFile,
    "sensor": SensorFile,
    "sensor_band_row": BandRow,
    "sensor_curve_row": CurveRow,
    "sensor_noise_row": NoiseRow,
    "summary": Summary,
}
"""Model behind each `data_schemas/<name>.schema.json`."""


def json_schema(name: str) -> dict[str, Any]:
    """Schema `name` of `SCHEMAS`, JSON Schema Draft 2020-12."""
    # The summary is a file that is written, the others are read.
    schema = TypeAdapter(SCHEMAS[name]).json_schema(
        mode="serialization" if name == "summary" else "validation"
    )
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **schema}


def write_schemas(folder: str | Path) -> list[Path]:
    """Write every schema into `folder`; returns the files."""
    paths = []
    for name in SCHEMAS:
        path = Path(folder) / f"{name}.schema.json"
        write_text(path, json.dumps(json_schema(name), indent=2, ensure_ascii=False) + "\n")
        paths.append(path)
    return paths


if __name__ == "__main__":
    default = Path(__file__).resolve().parents[3] / "data_schemas"
    for written in write_schemas(sys.argv[1] if len(sys.argv) > 1 else default):
        print(written)

"""The schemas on disk are those of the models, valid, and agree with them on real files."""

import csv
import json
import tomllib
from pathlib import Path

import jsonschema
import pytest

from fynjax.app.io.plot import example_folder
from fynjax.app.jobs import TerrainResult
from fynjax.app.jobs._schemas import SCHEMAS, json_schema, write_schemas

FOLDER = Path(__file__).resolve().parents[2] / "data_schemas"


def test_files_are_those_of_the_models(tmp_path):
    written = write_schemas(tmp_path)
    assert sorted(p.name for p in written) == sorted(p.name for p in FOLDER.glob("*.json"))
    for path in written:
        assert path.read_text("utf-8") == (FOLDER / path.name).read_text("utf-8"), (
            f"{path.name} is out of date: run python -m fynjax.app.jobs._schemas"
        )


@pytest.mark.parametrize("name", sorted(SCHEMAS))
def test_schema_is_valid_draft_2020_12(name):
    jsonschema.Draft202012Validator.check_schema(json_schema(name))


@pytest.mark.parametrize("name", ["plot", "species_table_row", "leaf_table_row", "statistics_row"])
def test_every_field_is_described(name):
    schema = json_schema(name)
    for part in (schema, *schema.get("$defs", {}).values()):
        for field, entry in part["properties"].items():
            assert "description" in entry or "$ref" in entry, field


def is_valid(name, instance):
    return jsonschema.Draft202012Validator(json_schema(name)).is_valid(instance)


def test_example_plot_is_valid_and_slips_are_not():
    plot = tomllib.loads((example_folder() / "plot.toml").read_text("utf-8"))
    assert is_valid("plot", plot)
    assert not is_valid("plot", {**plot, "sun": {"zenith_deg": 90}})
    assert not is_valid("plot", {**plot, "moon": {}})
    assert not is_valid("plot", {})


def typed(cell):
    try:
        return float(cell)
    except ValueError:
        return cell


@pytest.mark.parametrize(
    ("file", "name"),
    [
        ("species.csv", "species_table_row"),
        ("leaves.csv", "leaf_table_row"),
        ("statistics.csv", "statistics_row"),
    ],
)
def test_rows_of_the_example_are_valid(file, name):
    lines = (example_folder() / file).read_text("utf-8").splitlines()
    for row in csv.DictReader(line for line in lines if not line.startswith("#")):
        assert is_valid(name, {k: typed(v) for k, v in row.items() if v != ""}), row


def test_schema_and_model_refuse_the_same_leaf_rows():
    values = {"structure": 1.5, "chlorophyll": 40, "carotenoids": 8, "water": 0.01}
    good = {"taxon": "A", **values, "dry_matter": 0.01}
    assert is_valid("leaf_table_row", good)
    assert is_valid("leaf_table_row", {"taxon": "A", "spectrum": "a.csv"})
    assert not is_valid("leaf_table_row", {"taxon": "A"})
    assert not is_valid("leaf_table_row", {**good, "spectrum": "a.csv"})
    assert not is_valid("leaf_table_row", {**good, "water": 10})
    assert is_valid("leaf_table_row", {"taxon": "A", "chlorophyll": 40})
    bark = {"taxon": "A", "material": "bark", "reflectance": "a.csv"}
    assert is_valid("leaf_table_row", {**bark, "transmittance": "b.csv"})
    assert not is_valid("leaf_table_row", {**good, **bark})
    assert not is_valid("leaf_table_row", {**bark, "spectrum": "a.csv"})
    assert not is_valid("leaf_table_row", {"taxon": "A", "reflectance": "a.csv"})
    assert not is_valid("leaf_table_row", {"taxon": "A", "chlorophyll": 4, "transmittance": "b"})


def test_a_summary_of_another_shape_is_not_valid():
    bounds = {"bounds_m": (0, 0, 1, 1), "cell_m": 1, "lowest_m": 0, "relief_m": 0}
    result = TerrainResult(output="o", seed=0, terrain={**bounds, "median_slope_deg": float("nan")})
    summary = json.loads(result.model_dump_json())
    assert summary["terrain"]["median_slope_deg"] is None  # JSON has no NaN
    assert not is_valid("summary", summary)
    summary["terrain"]["median_slope_deg"] = 3.0
    assert is_valid("summary", summary)
    assert not is_valid("summary", {**summary, "terrain": None})
    assert not is_valid("summary", {**summary, "moon": 1})
    assert not is_valid("summary", {"command": "terrain"})

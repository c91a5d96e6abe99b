"""Files, schemas, fits, priors and tables read what is known of a parameter from its record.

The checks run twice: on the records as they are, and in another process on records that were
moved before anything read them. What is written down in a second place does not move with them.
"""

import os
import subprocess
import sys
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest

import fynjax._core.parameters as records
from fynjax._core.errors import InputError

ROOT = Path(__file__).resolve().parents[1]
COLUMNS = {
    "cover": ("species_table_row", "cover_percent"),
    "diameter": ("species_table_row", "mean_diameter_cm"),
    "height": ("species_table_row", "height_max_m"),
    "packing": ("species_table_row", "packing_percent"),
    "fill": ("species_table_row", "fill_percent"),
    "leaf_area_index": ("species_table_row", "leaf_area_index"),
    "wood_area_index": ("species_table_row", "wood_area_index"),
    "shoot_clumping": ("species_table_row", "shoot_clumping"),
    "dead_fraction": ("species_table_row", "dead_fraction"),
    "structure": ("leaf_table_row", "structure"),
    "chlorophyll": ("leaf_table_row", "chlorophyll"),
    "carotenoids": ("leaf_table_row", "carotenoids"),
    "anthocyanins": ("leaf_table_row", "anthocyanins"),
    "brown_pigments": ("leaf_table_row", "brown_pigments"),
    "water": ("leaf_table_row", "water"),
    "dry_matter": ("leaf_table_row", "dry_matter"),
    "leaf_angle": ("species_table_row", "leaf_angle_deg"),
    "brightness": ("GroundTable", "brightness"),
    "moisture": ("GroundTable", "moisture"),
    "litter_fraction": ("GroundTable", "litter_fraction"),
    "char_fraction": ("GroundTable", "char_fraction"),
    "rock_fraction": ("GroundTable", "rock_fraction"),
    "sun_zenith": ("SunTable", "zenith_deg"),
    "sun_azimuth": ("SunTable", "azimuth_deg"),
    "aerosol": ("SkyTable", "aerosol_optical_depth"),
}
WITHOUT_A_COLUMN = {"wood_brightness", "leaf_spread"}
LEFT_OUT = {
    *("packing", "fill", "anthocyanins", "brown_pigments"),
    *("litter_fraction", "char_fraction", "rock_fraction"),
}
"""Stated in words, as the files' own default is None."""
TAXON = "Erica irregularis"
CLOSER = ("cover", "diameter")
"""Bounded closer in a fit, by the sites held ready."""


def full_name(kind):
    from fynjax.leaf import LEAF_PARAMETERS
    from fynjax.scene import GroundParameters, LightParameters

    for group, module in (("ground", GroundParameters), ("light", LightParameters)):
        if kind in records.parameters_of(module):
            return f"{group}.{kind}"
    return f"species.{TAXON}.{'leaf.' if kind in LEAF_PARAMETERS else ''}{kind}"


def check_schemas():
    """Range, unit, default and words of every column, and the values that a file may hold."""
    from fynjax.app.jobs._schemas import json_schema
    from fynjax.scene import PARAMETERS

    assert set(COLUMNS) | WITHOUT_A_COLUMN == set(PARAMETERS)
    tables = json_schema("plot")["$defs"]
    tables |= {name: json_schema(name) for name in ("species_table_row", "leaf_table_row")}
    for kind, (table, column) in COLUMNS.items():
        record, entry = PARAMETERS[kind], tables[table]["properties"][column]
        number = next((e for e in entry.get("anyOf", [entry]) if e.get("type") == "number"), entry)
        limits = [record.shown_factor * limit for limit in (record.lower, record.upper)]
        assert [number["minimum"], number["maximum"]] == limits, kind
        assert entry["unit"] == record.shown_unit, kind
        assert entry["description"].startswith(record.name), kind
        assert record.description in entry["description"], kind
        if entry.get("default") is not None:
            assert entry["default"] == record.shown_factor * record.default, kind
        if kind in LEFT_OUT:
            default = f"; {record.shown_factor * record.default:g} if left out"
            assert default in entry["description"], kind


def check_fits():
    """Bounds and priors of fits of plots and of leaves."""
    from fynjax.app.io.plot import CalibrationTable
    from fynjax.inversion._space import make_space
    from fynjax.leaf import LEAF_PARAMETERS, LeafParameters
    from fynjax.leaf._problem import LeafSettings, make_setup
    from fynjax.leaf._residual import to_physical
    from fynjax.scene import PARAMETERS
    from fynjax.studies.bioscape._inversion import FREE

    plain = CalibrationTable()
    for kind, record in PARAMETERS.items():
        name = full_name(kind)
        value = 0.1 * record.lower + 0.9 * record.upper
        if record.prior_sd(value) is None:
            with pytest.raises(InputError, match="cannot be free"):
                make_space({name: value}, {name: 0.1})
            continue
        sd = plain.relative_sd(name)
        assert sd == record.relative_sd, kind
        if record.sd is not None:
            own = make_space({name: float(np.mean(record.usual))}, {name: None})
            np.testing.assert_allclose(own.prior_sd[0], record.sd, rtol=1e-6)
        narrow = 0.05  # a wider prior so near the upper bound would be narrowed
        space = make_space({name: value}, {name: narrow})
        np.testing.assert_allclose(space.prior[0], value, rtol=1e-6)
        np.testing.assert_allclose(space.prior_sd[0], narrow * value, rtol=1e-6)
        np.testing.assert_allclose(space.upper[0], record.upper, rtol=1e-6)
        np.testing.assert_allclose(space.lower[0], record.lower, rtol=1e-6)
        assert space.distribution == (record.distribution,)
        for wrong, bound in (
            (record.upper * 1.01, record.upper),
            (record.lower - 0.01 * record.upper, record.lower),
        ):
            with pytest.raises(InputError) as caught:
                make_space({name: wrong}, {name: sd})
            assert f"{bound:g}" in str(caught.value), kind
            assert f"{wrong:g}" in str(caught.value), kind

    setup = make_setup(LeafSettings("PRO"))
    centres = np.asarray(to_physical(jnp.asarray(setup.prior_mean), setup.optics))
    for i, name in enumerate(setup.names):
        record = LEAF_PARAMETERS[name]
        limits = float(setup.optics.lower[i]), float(setup.optics.upper[i])
        np.testing.assert_allclose(limits, (record.lower, record.upper), rtol=1e-6)
        if name in setup.free:
            np.testing.assert_allclose(centres[i], record.population[0], rtol=1e-4)
    for name, record in LEAF_PARAMETERS.items():
        assert float(getattr(LeafParameters(), name)) == pytest.approx(record.default)
        LeafParameters(**{name: record.upper})
        with pytest.raises(InputError, match=name):
            LeafParameters(**{name: 1.01 * record.upper})
    for name, kind in (
        ("soil_brightness", "brightness"),
        ("soil_moisture", "moisture"),
        ("litter", "litter_fraction"),
    ):
        assert (FREE[name].lower, FREE[name].upper) == (
            PARAMETERS[kind].lower,
            PARAMETERS[kind].upper,
        )


def check_plots_and_tables(folder):
    """Values of a plot file in the parameters' units, defaults, and tables in shown units."""
    from fynjax.app.assembly import plot_parameters
    from fynjax.app.io.plot import read_plot, with_parameter_table
    from fynjax.inversion import parameter_columns
    from fynjax.scene import LEAF_FIELDS, PARAMETERS, named_values, parameter_reference

    folder.mkdir(exist_ok=True)
    shown = {k: r.shown_factor * np.mean(r.usual) for k, r in PARAMETERS.items()}
    row = ["mean_diameter_cm", "cover_percent", "height_max_m", "leaf_angle_deg"]
    kinds = {column: kind for kind, (_, column) in COLUMNS.items()}
    cells = [TAXON, *(str(shown[kinds[column]]) for column in row)]
    (folder / "species.csv").write_text(f"taxon,{','.join(row)}\n{','.join(cells)}\n")
    (folder / "plot.toml").write_text("[plot]\nsize_m = 10.0\nleaf_variants = 2\n")
    plot = read_plot(folder / "plot.toml")
    parameters = plot_parameters(plot)
    values = named_values(parameters, plot.taxa)
    for kind in ("cover", "diameter", "height", "leaf_angle"):
        np.testing.assert_allclose(
            values[full_name(kind)], np.mean(PARAMETERS[kind].usual), rtol=1e-6, err_msg=kind
        )
    stated = [k for k in PARAMETERS if PARAMETERS[k].default is not None and k not in LEAF_FIELDS]
    assert len(stated) == 12
    for kind in stated:
        np.testing.assert_allclose(
            values[full_name(kind)], PARAMETERS[kind].default, rtol=1e-6, err_msg=kind
        )

    middles = [np.mean(record.usual) for record in PARAMETERS.values()]
    table = parameter_columns([full_name(kind) for kind in PARAMETERS], {"estimate": middles})
    assert table["unit"].tolist() == [r.shown_unit for r in PARAMETERS.values()]
    np.testing.assert_allclose(table["estimate"], list(shown.values()))
    covers = table["kind"].str.endswith("_fraction")
    table.loc[covers, "estimate"] /= 3.0
    table.to_csv(folder / "parameters.csv", index=False)
    changed = named_values(
        with_parameter_table(parameters, plot.taxa, folder / "parameters.csv"), plot.taxa
    )
    for i, (kind, record) in enumerate(PARAMETERS.items()):
        expected = np.mean(record.usual) / (3.0 if covers[i] else 1.0)
        np.testing.assert_allclose(changed[full_name(kind)], expected, rtol=1e-6, err_msg=kind)
        wrong = table.iloc[[i]].assign(estimate=1.01 * record.shown_factor * record.upper)
        wrong.to_csv(folder / "wrong.csv", index=False)
        with pytest.raises(InputError, match=f"{record.shown_factor * record.upper:g}") as caught:
            with_parameter_table(parameters, plot.taxa, folder / "wrong.csv")
        assert caught.value.column == "estimate"

    page = parameter_reference().set_index("parameter")
    for kind, record in PARAMETERS.items():
        assert page.loc[kind, "lower"] == record.lower
        assert page.loc[kind, "upper"] == record.upper
        assert page.loc[kind, "unit"] == record.unit
        assert page.loc[kind, "description"] == record.description
        assert page.loc[kind, "source"] == record.source


def check_all(folder):
    check_schemas()
    check_fits()
    check_plots_and_tables(folder)


def moved(field):
    """`parameter_field` of records whose numbers, units and words are others."""

    def other(*, required=False, **record):
        low, high = record["lower"], record["upper"]
        record |= {
            "name": f"Moved {record['name']}",
            "description": f"Moved: {record['description']}",
            "lower": low - (high - low) / 1024.0,
            "upper": high + 0.03125 * (high - low),
            "usual": (low + 0.0625 * (high - low), high),
            "unit": f"moved {record['unit']}",
        }
        if "shown" in record:
            record["shown"] = (f"moved {record['shown'][0]}", 2.0 * record["shown"][1])
        if record.get("default") is not None:
            record["default"] += 0.0625 * (high - record["default"]) + 0.015625 * (high - low)
        if record.get("relative_sd") is not None:
            record["relative_sd"] *= 1.25
        if record.get("sd") is not None:
            record["sd"] *= 0.75  # a wider one would be narrowed
        if record.get("population") is not None:
            centre, sd = record["population"]
            record["population"] = (centre + 0.0625 * (high - centre), 0.75 * sd)
        return field(required=required, **record)

    return other


def test_every_consumer_agrees_with_the_records(tmp_path):
    check_all(tmp_path)


def test_every_consumer_follows_records_that_move(tmp_path):
    """In a process of its own: models and tables are made from the records on import."""
    code = (
        "import sys, pathlib, fynjax._core.parameters as records\n"
        "import tests.test_parameters as test\n"
        "assert 'fynjax.leaf' not in sys.modules\n"
        "records.parameter_field = test.moved(records.parameter_field)\n"
        "test.check_all(pathlib.Path(sys.argv[1]))\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, str(tmp_path / "plot")],
        cwd=ROOT,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert done.returncode == 0, done.stderr[-3000:]


def test_what_is_assumed_of_leaves_and_forms_lies_within_the_bounds():
    from fynjax.canopy import FORMS
    from fynjax.scene import LEAF_FIELDS, PARAMETERS, USUAL_LEAF
    from fynjax.studies.bioscape._assumed import pigments

    of_forms = ("leaf_area_index", "wood_area_index", "shoot_clumping", "dead_fraction")
    assumed = [USUAL_LEAF.model_dump(include=set(LEAF_FIELDS)), *(pigments(form) for form in FORMS)]
    assumed += [{kind: getattr(d, kind) for kind in of_forms} for d in FORMS.values()]
    for values in assumed:
        for kind, value in values.items():
            assert PARAMETERS[kind].contains(value), (kind, value)


def test_the_commented_example_states_the_ranges_of_the_records():
    from fynjax.app.io.plot import example_folder
    from fynjax.scene import PARAMETERS

    text = (example_folder() / "plot.toml").read_text("utf-8")
    for kind, words in (
        ("brightness", "factor on the soil, {low:g} to {high:g} [{default:g}]"),
        ("sun_zenith", "from straight up; 0 is overhead [{default:g}]"),
        ("aerosol", "at 500 nm, {low:g} to {high:g}"),
        ("litter_fraction", "an old stand has much [{default:g}]"),
    ):
        record = PARAMETERS[kind]
        assert words.format(low=record.lower, high=record.upper, default=record.default) in text


def test_a_record_refuses_a_default_outside_its_bounds():
    words = {"symbol": "x", "name": "X", "unit": "-", "description": ".", "source": "Assumed."}
    with pytest.raises(ValueError, match="outside the bounds"):
        records.Parameter(**words, lower=0.0, upper=1.0, usual=(0.0, 1.0), default=1.5)
    with pytest.raises(ValueError, match="no source"):
        records.Parameter(**{**words, "source": " "}, lower=0.0, upper=1.0, usual=(0.0, 1.0))
    record = records.Parameter(**words, lower=0.0, upper=1.0, usual=(0.0, 1.0))
    assert record.contains(float(np.float32(1.0)) + 5e-7)
    assert not record.contains(float("nan"))
    with pytest.raises(InputError, match=r"from 0 to 1, but got nan"):
        record.check(float("nan"), "X")

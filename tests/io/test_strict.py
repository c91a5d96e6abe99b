"""What is no number is none: `true`, 1_0, and a formula of a spreadsheet."""

import csv
import io
import re
from pathlib import Path

import pandas as pd
import pytest
from pydantic import ValidationError
from typer.testing import CliRunner

import fynjax.studies.bioscape  # noqa: F401 - their records are looked at
from fynjax._core.errors import InputError
from fynjax._core.records import Strict, _keys_of_numbers
from fynjax.app.cli import app
from fynjax.app.io.frames._shot import finite
from fynjax.app.io.plot import read_plot
from fynjax.app.io.raster import open_blocks
from fynjax.app.io.raster._crs import geotransform
from fynjax.app.io.text import rows_text, table_text
from fynjax.scene import LeafRow
from tests.small import write_plot


def test_a_table_for_spreadsheets_has_no_formulas() -> None:
    """Names, of columns too; numbers, signs alone and what only contains such a sign stay."""
    names = ["=1+1", "+x", "-A1", "@SUM(A1)", "\t=1", "-", "Erica=b", "-5", "+1e-3"]
    names += ["\n=1", "\uff1d1+1", "\uff20A1"]  # also wide ones, as spreadsheets in Japan take them
    table = pd.DataFrame({"name": names, "=cmd|'/c calc'!A0": -2.0, "unit": "=m"})
    table.loc[0, "unit"] = "-"
    table["unit"] = pd.Categorical(table["unit"])
    cells = list(csv.reader(io.StringIO(table_text(table, "%.3g"))))
    assert cells[0] == ["name", "'=cmd|'/c calc'!A0", "unit"]
    shown = ["'=1+1", "'+x", "'-A1", "'@SUM(A1)", "'\t=1", "-", "Erica=b", "-5", "+1e-3"]
    shown += ["'\n=1", "'\uff1d1+1", "'\uff20A1"]
    assert [row[0] for row in cells[1:]] == shown
    assert [row[1:] for row in cells[1:3]] == [["-2", "-"], ["-2", "'=m"]]
    assert table["name"][0] == "=1+1"  # the table itself is as it was
    assert rows_text([["=a", 1], [None, "b"]]) == "'=a,1\n,b\n"


def _records(kind: type[Strict]) -> set[type[Strict]]:
    return {kind}.union(*map(_records, kind.__subclasses__()))


NEEDED = {LeafRow: {"taxon": "a", "material": "young", "chlorophyll": 40.0}}
"""What a record states besides, where a number by itself is too little."""
NUMBERS = [
    pytest.param(record, key, id=f"{record.__name__}-{key}")
    for record in sorted(_records(Strict), key=lambda one: one.__qualname__)
    if record.__module__.startswith("fynjax.")
    for key, texts in _keys_of_numbers(record)
    if not texts
]


@pytest.mark.parametrize(("record", "key"), NUMBERS)
def test_true_is_no_number_and_1_0_no_ten(record: type[Strict], key: str) -> None:
    """Of any record of a table or a file, alone and in a list."""
    for value in (True, False, "1_0", "\u0661", [True, 2.0], ["1_0", "2"]):
        with pytest.raises(ValidationError) as caught:
            record.model_validate(NEEDED.get(record, {}) | {key: value})
        assert key in {str(error["loc"][0]) for error in caught.value.errors() if error["loc"]}


def test_what_is_no_number_is_said_as_it_was_written(tmp_path: Path) -> None:
    assert len(NUMBERS) > 150
    plot = write_plot(tmp_path)
    plot.write_text(re.sub(r"size_m = \S+", "size_m = true", plot.read_text()), "utf-8")
    with pytest.raises(InputError, match=r"line \d+, key 'plot.size_m': .*but got true"):
        read_plot(plot)
    table = tmp_path / "species.csv"
    plot = write_plot(tmp_path)
    lines = table.read_text("utf-8").splitlines()
    table.write_text(re.sub(r",\d+", ",1_0", "\n".join([lines[0], lines[1]]), count=1), "utf-8")
    with pytest.raises(InputError, match=r"row 2, .*got '1_0'\. Marks between thousands\?"):
        read_plot(plot)


@pytest.mark.parametrize("wrong", ["1_0", "\uff11\uff12", "\u0661", "0x10", "1d3", "\u22125"])
def test_numbers_of_texts_are_strict_in_every_format(tmp_path: Path, wrong: str) -> None:
    header = tmp_path / "cube.hdr"
    text = "ENVI\nsamples = 1\nlines = 1\nbands = 1\ndata type = 4\ninterleave = bsq\n"
    (tmp_path / "cube.dat").write_bytes(bytes(4000))
    place = "map info = {UTM, 5, 1, 0, 0, 1, 1, 34, South}"
    for key in ("samples = 1", place, "reflectance scale factor = 2", "wavelength = {500}"):
        stated = re.sub(r"\d+", wrong, key, count=1)
        header.write_text(f"{text}{stated}\n", "utf-8")
        with pytest.raises(InputError, match=r"cube\.hdr"), open_blocks(header) as cube:
            cube.wavelength, cube.read(0, 1)
    for numbers in (f"0 1 0 0 0 {wrong}", f"{wrong} 1 0 0 0 -1"):
        with pytest.raises(InputError, match="six numbers"):
            geotransform(numbers, "GeoTransform")
    with pytest.raises(InputError, match="expected 2 numbers"):
        finite(["1", wrong], 2, "a place")


@pytest.mark.parametrize(
    "line",
    [["render", "a.toml", "--seed", "1_0"], ["fit-leaf", "a", "--detector-changes", "1_000,1830"],
     ["plant", "a", "--elements=1_0"], ["article", "--size", "\u0661\u0660"]],
)  # fmt: skip
def test_1_0_is_no_ten_as_an_option(line: list[str]) -> None:
    result = CliRunner().invoke(app, line)
    assert isinstance(result.exception, InputError)
    assert re.search("`--.*` must be .*numbers?|wavelengths", str(result.exception))


@pytest.mark.parametrize("key", ["a", '"a"', "a "])
@pytest.mark.parametrize("form", ["{0} = 1", "[{0}]", "x = {{{0} = 1}}", "[[{0}]]"])
def test_keys_of_many_parts_are_refused_before_they_are_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, key: str, form: str
) -> None:
    path = tmp_path / "plot.toml"
    path.write_text("# A plot.\n" + form.format(".".join([key] * 8000)) + "\n", "utf-8")
    with monkeypatch.context() as patched:
        patched.setattr("tomllib.loads", None)
        with pytest.raises(InputError, match=r"line 2: expected TOML whose keys have at most 32"):
            read_plot(path)
    sentence = "file names such as a.b.c, and numbers, 0.1.2... " * 400
    path.write_text(f"# {sentence}\nname = '{sentence}'\n", "utf-8")
    with pytest.raises(InputError, match="unknown name 'name'"):
        read_plot(path)

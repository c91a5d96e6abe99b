"""Tables in the dialects that people bring: read to the bit, or refused with what to change."""

import codecs
import csv
import io
import itertools
import sys
import warnings
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import openpyxl
import pandas as pd
import pytest
from pydantic import Field

from fynjax._core import tables
from fynjax._core.errors import InputError, MissingExtraError
from fynjax._core.tables import open_points, open_table
from fynjax.app.io.plot import read_statistics
from fynjax.app.io.spectra import read_spectra_file as read_file
from fynjax.app.io.text import Strict, in_unit, read_rows
from fynjax.app.terrain import read_cloud

CHANCE = np.random.default_rng(7)
NUMBERS = np.concatenate([CHANCE.uniform(-1, 1, 30) * 10.0 ** CHANCE.integers(-12, 12, 30), [0, 7]])
NAMES = ["Erica plukenetii", "Protea repens", "Café, größer", "Restio; a", "9#"] * 6 + ["x", "1,5"]


class NamedRow(Strict):
    """A row of the table that is written here."""

    taxon: str = Field(description="Name.")
    a_m: float = in_unit("m", of="A length")
    b_m: float | None = in_unit("m", of="Another", default=None)


FRAME = pd.DataFrame({"taxon": NAMES, "a_m": NUMBERS, "b_m": NUMBERS[::-1] / 3.0})

DIALECTS = [
    *itertools.product([","], ["."], ["utf-8", "utf-8-sig", "utf-16", "cp1252"], ["\n"]),
    *itertools.product(";\t|", ",.", ["utf-8"], ["\n"]),
    *itertools.product(";\t", ",", ["utf-8-sig", "utf-16", "utf-16-le", "cp1252"], ["\r\n"]),
    (" ", ".", "utf-8", "\n"),
    (" ", ",", "utf-16-be", "\r\n"),
    (";", ",", "latin-1", "\r"),
]


@pytest.mark.parametrize(("separator", "decimal", "encoding", "end"), DIALECTS)
def test_a_table_in_any_dialect_is_read_to_the_bit(tmp_path, separator, decimal, encoding, end):
    path = tmp_path / "table.csv"
    FRAME.to_csv(path, index=False, sep=separator, decimal=decimal, encoding=encoding,
                 lineterminator=end)  # fmt: skip
    rows = [row for _, row in read_rows(path, NamedRow, "a table")]
    assert [row.taxon for row in rows] == NAMES
    np.testing.assert_array_equal([row.a_m for row in rows], FRAME["a_m"])
    np.testing.assert_array_equal([row.b_m for row in rows], FRAME["b_m"])


@pytest.mark.parametrize(("separator", "decimal", "encoding", "end"), DIALECTS)
@pytest.mark.parametrize("odd", [False, True])
def test_numbers_in_any_dialect_are_read_to_the_bit(
    tmp_path, separator, decimal, encoding, end, odd
):
    """Written by Python's own module; what pandas cannot read at once is read row by row."""
    text = io.StringIO()
    table = np.stack([NUMBERS, NUMBERS[::-1], 1.0 / (2.0 + NUMBERS)], axis=1)
    writer = csv.writer(text, delimiter=separator, lineterminator=end)
    writer.writerow(["x", "y", "z"])
    writer.writerows([[repr(v).replace(".", decimal) for v in row] for row in table.tolist()])
    if odd:
        text.write(f"# a remark{end}{end}")
    path = tmp_path / "table.txt"
    path.write_bytes(text.getvalue().encode(encoding))
    read = open_points(path, "a table", "xyz").columns([0, 1, 2]).to_numpy()
    np.testing.assert_array_equal(read, table)


@pytest.mark.parametrize("separator", ["\t", ";", " "])
def test_spectra_with_decimal_commas(tmp_path, separator):
    waves, values = np.arange(400.0, 900.0, 7.3), CHANCE.uniform(0.01, 0.6, (2, 69))
    frame = pd.DataFrame({"wavelength_nm": waves, "oak": values[0], "elm": values[1]})
    frame.loc[3, "elm"] = np.nan
    frame.to_csv(tmp_path / "columns.csv", sep=separator, decimal=",", index=False, na_rep="NA")
    wide = pd.DataFrame(values, columns=[f"{w:.0f}" for w in 10 * np.arange(40, 109)])
    wide.insert(0, "sample", ["oak", "elm"])
    wide.to_csv(tmp_path / "rows.csv", sep=separator, decimal=",", index=False)
    oak, elm = read_file(tmp_path / "columns.csv")
    np.testing.assert_array_equal(oak.wavelength, waves)
    np.testing.assert_array_equal(oak.reflectance, values[0])
    np.testing.assert_array_equal(elm.reflectance, frame["elm"])
    for spectrum, expected in zip(read_file(tmp_path / "rows.csv"), values, strict=True):
        np.testing.assert_array_equal(spectrum.reflectance, expected)


def workbook(path: Path, *sheets: list[list[Any]]) -> Path:
    book = openpyxl.Workbook()
    book.remove(book.active)
    for k, rows in enumerate(sheets):
        sheet = book.create_sheet(f"sheet {k}")
        for row in rows:
            sheet.append(row)
    book.save(path)
    return path


def test_excel_workbooks(tmp_path, monkeypatch):
    frame = FRAME.assign(b_m=[float(f"{v:.14g}") for v in FRAME["b_m"]])  # openpyxl rounds
    rows = [list(frame), [], *frame.to_numpy().tolist()]
    path = workbook(tmp_path / "table.xlsx", [], rows)
    read = read_rows(path, NamedRow, "a table")
    assert [row for row, _ in read] == list(range(3, 35))
    np.testing.assert_array_equal([row.b_m for _, row in read], frame["b_m"])
    assert [row.taxon for _, row in read] == NAMES
    waves = [[400 + 10.0 * k, round(0.1 + 0.01 * k, 2)] for k in range(20)]
    (spectrum,) = read_file(workbook(tmp_path / "oak.xlsx", [["wavelength_nm", "oak"], *waves]))
    np.testing.assert_array_equal(spectrum.reflectance, [row[1] for row in waves])
    for sheets, words in (
        ([rows, rows], "expected one sheet, but sheet 0, sheet 1 have cells"),
        ([[["taxon", "a_m"], ["x", "#DIV/0!"]]], r"row 2, column 'a_m': .*error of the spread"),
        ([[["taxon", "a_m"], ["x", "trace"]]], "row 2, column 'a_m': expected a number m, but"),
        ([[]], "the file is empty"),
    ):
        with pytest.raises(InputError, match=words):
            read_rows(workbook(tmp_path / "bad.xlsx", *sheets), NamedRow, "a table")
    book = openpyxl.load_workbook(path)
    book["sheet 1"]["XFD9999"] = 1
    book.save(tmp_path / "wide.xlsx")
    with pytest.raises(InputError, match="'sheet 1' reaches to row 9999 or"):
        read_rows(tmp_path / "wide.xlsx", NamedRow, "a table")
    del book["sheet 1"]._cells[9999, 16384]
    book["sheet 1"]["B3"].number_format = "0.00%"
    book.save(tmp_path / "percent.xlsx")
    with pytest.raises(InputError, match=r"row 3, column 'a_m': .*Or format the cells of"):
        read_rows(tmp_path / "percent.xlsx", NamedRow, "a table")
    for value, form, cell in ((1, "0%", "100%"), (12, '0" %"', "12"), (12.5, r"0.0\%", "12.5")):
        book = openpyxl.Workbook()
        book.active.append(["taxon", "a_m"])
        book.active.append(["x", value])
        book.active["B2"].number_format = form
        book.save(tmp_path / "shown.xlsx")
        ((_, cells),) = open_table(tmp_path / "shown.xlsx", "a table").records()
        assert cells == ["x", cell]
    shown = [["wavelength_nm", "oak (%)"], *([w, v / 100] for w, v in waves)]
    book = openpyxl.load_workbook(workbook(tmp_path / "shown.xlsx", shown))
    for (cell,) in book.worksheets[0]["B2:B9999"]:
        cell.number_format = "0.00%"
    book.save(tmp_path / "shown.xlsx")
    (in_percent,) = read_file(tmp_path / "shown.xlsx")
    np.testing.assert_allclose(in_percent.reflectance, 0.01 * spectrum.reflectance, rtol=1e-14)
    monkeypatch.setitem(sys.modules, "openpyxl", None)
    with pytest.raises(MissingExtraError, match=r'pip install "fynjax\[tables\]"'):
        read_rows(path, NamedRow, "a table")


HEAD = "taxon;a_m;b_m\n"


@pytest.mark.parametrize(
    ("above", "titled"),
    [("Survey;;\n", True), ("Plot 12, 2022-03-14\nObserver: Smith\n\n", True),
     ("Plot;12\nObserver;Smith\n", True), ("Plot 12;Date;2022-03-14\nObserver: Smith;;\n", True),
     ("# Survey\n", False)],
)  # fmt: skip
def test_a_title_above_the_header_is_left_out(tmp_path: Path, above: str, titled: bool) -> None:
    path = tmp_path / "table.csv"
    path.write_text(f"{above}{HEAD}x;1;2\ny;3;4\n", "utf-8")
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        rows = read_rows(path, NamedRow, "a table")
    assert [(row.taxon, row.a_m, row.b_m) for _, row in rows] == [("x", 1, 2), ("y", 3, 4)]
    assert [f"row {1 + path.read_text().count(chr(10)) - 3} is taken" in str(t.message)
            for t in told] == [True] * titled  # fmt: skip


@pytest.mark.parametrize(
    "text",
    ["taxon;kind;layer\nShrubs;;\nx;low;tall\ny;3;4\n", "taxon;kind\nx;low;odd\ny;3;4\n",
     "taxon;kind\nx\ny;3\n", "1;2\nx\ntaxon;kind\nx;low\n"],
)  # fmt: skip
def test_a_header_is_no_title(tmp_path: Path, text: str) -> None:
    (tmp_path / "table.csv").write_text(text)
    assert open_table(tmp_path / "table.csv", "a table").row == 1
    (tmp_path / "table.csv").write_text("Survey;;\ntaxon;kind\nx;low\n")
    with pytest.raises(InputError, match=r"expected 1 cells .* Is the first row a title\?"):
        list(open_table(tmp_path / "table.csv", "a table").records())


@pytest.mark.parametrize(
    ("text", "row", "words"),
    [
        (HEAD + "x;trace;1", 2, "expected a number m, but got 'trace'. Write the number to take"),
        (HEAD + "x;<1;1", 2, "'<1'. A limit"),
        (HEAD + "x;5-10;1", 2, "'5-10'. A range"),
        (HEAD + "x;5±1;1", 2, "without its error"),
        (HEAD + "x;2a;1", 2, "'2a'. A cover class"),
        (HEAD + "x;n.d.;1", 2, "Not measured"),
        (HEAD + "x;−5;1", 2, "minus as a hyphen"),
        (HEAD + "x;1O;1", 2, "A letter for a digit"),
        (HEAD + "x;1.234,5;1", 2, "'1.234,5'. Marks between thousands"),
        (HEAD + "x;1 234,5;1", 2, "Marks between thousands"),
        (HEAD + "x;40 cm;1", 2, "Leave out the unit, 'cm': write the number alone"),
        (HEAD + "x;1,5;1\ny;2;1.234", 3, "one decimal mark .*'1.234' here and '1,5' in row 2"),
        (HEAD + "x;1.234;1\ny;2;1,5", 3, "one decimal mark .*'1,5' here and '1.234' in row 2"),
        ('taxon,a_m\nx,"1,5"', 2, "A decimal comma. Write 1.5"),
        ('taxon,a_m\nx,"1,234"', 2, "A decimal comma. Write 1.234. Marks between thousands"),
        ("taxon,a_m\nx,1,5", 2, "expected 2 cells as in the header.* has 3: .*decimal comma"),
        (HEAD + "x;1", 2, "expected 3 cells .* has 2"),
        (HEAD + "x;1;2;3", 2, "expected 3 cells .* has 4: 'x;1;2;3'. A separator inside a name"),
        ("taxon;a_m;a_m\nx;1;1", 1, "column 'a_m': this column is there twice"),
        ("# a\n\ntaxon;a_m;b_m\nx;1;1\n # b\n;;\n\ny;z;1", 8, "'z'"),
        ('# a\ntaxon;a_m\n"x\ny";1\n"a\n\nb";2\nz;w', 8, "'w'"),
        ('taxon;a_m\n"x\ny";w', 2, "'w'"),
        ('taxon;a_m\nx;1\n"y;1\nz;1', 3, "a quotation mark opens a cell in this row, and none"),
        ("taxon;a_m\nx;nan", 2, "Not measured"),
        ("taxon;a_m\nx;inf", 2, "got inf"),
        ("taxon;a_m\nx;1e999", 2, "got"),
        (HEAD, None, "only a header"),
        ("# a\n\n", None, "empty"),
        (" \n\n", None, "empty"),
    ],
)
def test_what_is_wrong_is_named_with_its_line(tmp_path, text, row, words):
    path = tmp_path / "table.csv"
    for encoded in (text.encode(), text.replace("\n", "\r\n").encode("utf-16")):
        path.write_bytes(encoded)
        with pytest.raises(InputError, match=words) as caught:
            read_rows(path, NamedRow, "a table")
        assert (caught.value.file, caught.value.row) == (path, row)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (bytes(range(256)) * 40, "byte|binary"),
        (b"taxon,a_m\nx,1\0\n", "binary"),
        (b"taxon,a_m\nx\x9d,1\n", "row 2: expected text, but byte 0x9d"),
        ("taxon,a_m\ncafé,1\nÉ,1".encode()[:-3], "row 3: .*0xc3|cut short"),
        ("taxon,a_m\né,1\n".encode() + b"\xe9,1\n", "row 3: expected text, but byte 0xe9"),
        (codecs.BOM_UTF16_LE + b"abc", "UTF-16"),
        (b"PK\3\4" + bytes(80), "damaged or cut short"),
        (b"\xd0\xcf\x11\xe0" + bytes(80), "Excel before 2007"),
    ],
)
def test_what_is_no_text_is_refused(tmp_path, content, words):
    path = tmp_path / "table.csv"
    path.write_bytes(content)
    with pytest.raises(InputError, match=words):
        read_rows(path, NamedRow, "a table")


def cloud(text: str) -> Callable[[Path], Any]:
    return lambda path: read_cloud(path) if path.write_text(text) else None


@pytest.mark.parametrize(
    ("text", "read", "words"),
    [
        ("1,5,2,5,3,5\n" * 9, read_cloud, "'1,5,2,5,3,5' can be read with commas between"),
        ("400,0,1\n410,0,2\n420,0,3\n", read_file, "'400,0,1' can be read with commas"),
        ("wavelength,leaf\n400,0,1\n410,0,2\n", read_file, "expected 2 cells .*decimal comma"),
        ("wavelength,leaf,elm\n400,0.1\n410,0.2\n", read_file, "expected 3 cells .* has 2"),
        ("leaf,elm\n400,0.1,0.1\n410,0.2,0.2\n", read_file, "expected 2 cells .* has 3"),
        ("wavelength;leaf\n999;0,1\n1.000;0,2\n", read_file, "one decimal mark .*'1.000' here"),
    ],
)
def test_what_can_be_read_in_two_ways_is_refused(tmp_path, text, read, words):
    path = tmp_path / "table.csv"
    path.write_text(text)
    with pytest.raises(InputError, match=words):
        read(path)


def test_marks_that_may_part_thousands_are_said(tmp_path):
    path = tmp_path / "table.csv"
    for text in ("taxon;a_m\nx;1.234\ny;12.500\n", "taxon\ta_m\nx\t1,234\ny\t12,500\n"):
        path.write_text(text)
        with pytest.warns(UserWarning, match="numbers such as 1.234 are read as 1.234. If the"):
            rows = read_rows(path, NamedRow, "a table")
        assert [row.a_m for _, row in rows] == [1.234, 12.5]
    for text in ("taxon;a_m\nx;1.234\ny;0.500\n", "taxon,a_m\nx,1.234\n", "taxon\ta_m\nx\t1.234\n"):
        path.write_text(text)
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            assert read_rows(path, NamedRow, "a table")[0][1].a_m == 1.234


@pytest.mark.parametrize(
    ("text", "separator"),
    [
        ("sep=;\na;b\n1;2\n", ";"),
        ("name,remark\nErica,burnt; green\nProtea,dead; old\nRestio,new\n", ","),
        ("name;value\n\"a;b\";1,5\n'c';2,5\n", ";"),
        ("Plot 1\t5\t7\nPlot 2\t\t8\n", "\t"),
        ("Plot 1,5,7\nPlot 2,6,8\n", ","),
        ("a, b, c\n1, 2, 3\n", ","),
        ("wavelength reflectance\n400 0,5\n410 0,25\n", " "),
        ("x  y z\n 1,5  2,5 3,5 \n", " "),
        ("1 2 3\n4 5;a 6\n7 8 9\n7 8 9\n", " "),
        ("1 2 3 a,b\n4 5 6 c,d\n", " "),
        ("500,\n600,0.2\n", ","),
        ("a,b\n400,5\n410,6\n", ","),
    ],
)
def test_the_separator_is_found(tmp_path, text, separator):
    path = tmp_path / "table.csv"
    path.write_text(text)
    assert open_table(path, "a table").separator == separator


def test_cells_at_the_end_may_be_empty_in_all_rows(tmp_path):
    path = tmp_path / "table.csv"
    path.write_text("statistic;value;sd;;\nNDVI.mean;0,7;0,01;;\nNDVI.std;0,1;;;\n")
    read = read_statistics(path)
    assert [(row.value, row.sd) for row in read] == [(0.7, 0.01), (0.1, None)]


@pytest.mark.parametrize("remark", ["", "# a remark\n"])
def test_numbers_that_are_none(tmp_path, remark):
    path = tmp_path / "table.csv"
    path.write_text("wavelength;leaf\n400;0,1\n410;-999\n420;0,2\n" + remark)
    (spectrum,) = read_file(path)
    np.testing.assert_array_equal(spectrum.reflectance, [0.1, np.nan, 0.2])
    for cell in ("inf", "1e999", "-nan"):
        path.write_text(f"x,y,z\n1,2,3\n1,2,{cell}\n{remark}")
        with pytest.raises(InputError, match=f"row 3, column 'z': expected a number, .*'{cell}'"):
            open_points(path, "a table", "xyz").columns([0, 1, 2])


def test_decimal_marks_are_compared_through_the_whole_table(tmp_path):
    path = tmp_path / "table.csv"
    path.write_text("x;y;z\n1;2;3\n1;2,5;3\n" + "1;2;3\n" * 9 + "1;2;1.234\n")
    with pytest.raises(InputError, match=r"row 13, column 'z': .*'1.234' here and '2,5' in row 3"):
        open_points(path, "a table", "xyz").columns([0, 1, 2])


def test_letters_that_look_like_those_of_another_encoding_are_said(tmp_path):
    path = tmp_path / "table.csv"
    path.write_bytes("taxon,a_m\nCafé,1\n".encode("mac_roman"))
    with pytest.warns(UserWarning, match="read as Windows-1252, with 'Ž' in it"):
        assert read_rows(path, NamedRow, "a table")[0][1].taxon == "CafŽ"


def test_a_library_of_one_column_is_refused(tmp_path):
    path = tmp_path / "leaf.txt"
    path.write_text("Name: leaf\nX Units: Wavelength (micrometers)\n\n0.4\t\n1.3\t40\n1.36\t40\n")
    with pytest.raises(InputError, match="row 4: expected 2 columns, but the first row has 1"):
        read_file(path)


def test_a_row_that_is_commented_out_is_no_row(tmp_path):
    path = tmp_path / "table.csv"
    rows = [f"{name},{','.join(['0.1'] * 10)}\n" for name in ("a", "#b", "c")]
    path.write_text("".join([f"name,{','.join(map(str, range(400, 500, 10)))}\n", *rows]))
    assert [spectrum.name for spectrum in read_file(path)] == ["a", "c"]


def test_a_workbook_that_unfolds_to_more_than_64_mib_is_refused_unread(tmp_path, monkeypatch):
    path = tmp_path / "table.xlsx"
    monkeypatch.setattr(tables, "require", lambda *_: pytest.fail("opened"))
    size = 2**26 + 1
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as parts:
        parts.writestr("xl/workbook.xml", "<a/>")
        parts.writestr("xl/worksheets/sheet1.xml", bytes(size - len("<a/>")))
    assert path.stat().st_size < 2**20
    with pytest.raises(InputError, match="unfolds to 64 MiB: save it as CSV"):
        open_table(path, "a table")
    monkeypatch.setattr(tables, "_LARGEST_WORKBOOK", size)
    with pytest.raises(pytest.fail.Exception, match="opened"):
        open_table(path, "a table")


def test_an_error_of_a_spreadsheet_is_no_comment(tmp_path):
    path = tmp_path / "table.csv"
    path.write_text("a_m;taxon\n1;x\n#N/A;y\n# z\n")
    with pytest.raises(InputError, match=r"row 3, column 'a_m': .*'#N/A'. An error of the spread"):
        read_rows(path, NamedRow, "a table")

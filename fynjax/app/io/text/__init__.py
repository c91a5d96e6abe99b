"""Text files of a user: strict tables and TOML with errors that point at the cell; safe writing."""

from fynjax._core.errors import did_you_mean
from fynjax._core.files import NamedFile, check_stated_size, existing_file, read_bytes
from fynjax._core.records import Slip, Strict, in_unit, quantity
from fynjax._core.tables import TextTable, open_table
from fynjax.app.io.text._atomic import (
    atomic_path,
    remove_abandoned,
    remove_replaced,
    staged_folder,
    write_text,
)
from fynjax.app.io.text._bounds import check_fits, check_geopackage, stated_number
from fynjax.app.io.text._cells import rows_text, table_text
from fynjax.app.io.text._earlier import SUMMARY, EarlierRun, sealed
from fynjax.app.io.text._tables import read_rows
from fynjax.app.io.text._toml import line_of, read_toml, shipped_or_own

__all__ = [
    "SUMMARY",
    "EarlierRun",
    "NamedFile",
    "Slip",
    "Strict",
    "TextTable",
    "atomic_path",
    "check_fits",
    "check_geopackage",
    "check_stated_size",
    "did_you_mean",
    "existing_file",
    "in_unit",
    "line_of",
    "open_table",
    "quantity",
    "read_bytes",
    "read_rows",
    "read_toml",
    "remove_abandoned",
    "remove_replaced",
    "rows_text",
    "sealed",
    "shipped_or_own",
    "staged_folder",
    "stated_number",
    "table_text",
    "write_text",
]

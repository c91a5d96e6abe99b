"""Text files of a user: strict tables and TOML with errors that point at the cell; safe writing."""

from fynjax._core.errors import did_you_mean
from fynjax._core.records import Slip, Strict, number, optional_quantity, quantity
from fynjax._core.validation import first_error, sentence
from fynjax.io.text._atomic import (
    atomic_path,
    remove_abandoned,
    remove_replaced,
    staged_folder,
    write_text,
)
from fynjax.io.text._files import (
    NamedFile,
    check_stated_size,
    existing_file,
    named_file,
    read_bytes,
)
from fynjax.io.text._named import shipped_or_own
from fynjax.io.text._tables import (
    broken_row,
    foreign_rows,
    read_rows,
    read_text,
    split_line,
    split_lines,
)
from fynjax.io.text._toml import line_of, read_toml

__all__ = [
    "NamedFile",
    "Slip",
    "Strict",
    "atomic_path",
    "broken_row",
    "check_stated_size",
    "did_you_mean",
    "existing_file",
    "first_error",
    "foreign_rows",
    "line_of",
    "named_file",
    "number",
    "optional_quantity",
    "quantity",
    "read_bytes",
    "read_rows",
    "read_text",
    "read_toml",
    "remove_abandoned",
    "remove_replaced",
    "sentence",
    "shipped_or_own",
    "split_line",
    "split_lines",
    "staged_folder",
    "write_text",
]

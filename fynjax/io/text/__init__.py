"""Text files of a user: strict tables and TOML with errors that point at the cell; safe writing."""

from fynjax._core.errors import did_you_mean
from fynjax.io.text._atomic import (
    atomic_path,
    remove_abandoned,
    remove_replaced,
    staged_folder,
    write_text,
)
from fynjax.io.text._named import shipped_or_own
from fynjax.io.text._strict import Slip, Strict, number, optional_quantity, quantity
from fynjax.io.text._tables import existing_file, read_rows, read_text
from fynjax.io.text._toml import line_of, read_toml
from fynjax.io.text._validate import first_error, sentence

__all__ = [
    "Slip",
    "Strict",
    "atomic_path",
    "did_you_mean",
    "existing_file",
    "first_error",
    "line_of",
    "number",
    "optional_quantity",
    "quantity",
    "read_rows",
    "read_text",
    "read_toml",
    "remove_abandoned",
    "remove_replaced",
    "sentence",
    "shipped_or_own",
    "staged_folder",
    "write_text",
]

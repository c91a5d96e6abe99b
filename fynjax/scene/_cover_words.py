"""Covers as field crews write them: classes of Braun-Blanquet, limits, ranges and traces."""

import re
import warnings
from collections.abc import Sequence
from typing import Any

from fynjax._core.errors import listed

CLASSES: dict[str, tuple[float, float]] = {
    "r": (0.0, 0.1),
    "+": (0.1, 1.0),
    "1": (1.0, 5.0),
    "2": (5.0, 25.0),
    "2m": (1.0, 5.0),
    "2a": (5.0, 12.5),
    "2b": (12.5, 25.0),
    "3": (25.0, 50.0),
    "4": (50.0, 75.0),
    "5": (75.0, 100.0),
}
"""Ranges of the scale of Braun-Blanquet [%], with the parts of 2 after Barkman, Doing and Segal
(1964, Acta Botanica Neerlandica 13, 394). The scale says of r and + only that they cover little: up
to 0.1 and 1 % are taken."""
_TRACE = re.compile(r"tr(ace)?s?\.?|present|x|p", re.IGNORECASE)
_LIMIT = re.compile(r"(<|≤|<=|>|≥|>=)\s*(\d+(?:[.,]\d*)?)\s*%?")
_RANGE = re.compile(
    r"(\d+(?:[.,]\d*)?)\s*%?\s*(?:-|–|—|\.\.+|to|bis)\s*(\d+(?:[.,]\d*)?)\s*%?", re.IGNORECASE
)
_DIGITS = ("1", "2", "3", "4", "5")
_SOCIABLE = re.compile(r"(r|\+|2[mab]|[1-5])[.,][1-5]")
"""A class with a sociability behind it, as "4.5" or "+.2"."""
_FEW = 3
"""Rows of a table from which on covers of 1 to 5 alone may be classes."""


def cover_range(text: str) -> tuple[float, float] | None:
    """Least and largest cover [%] that a word of a table stands for; `None` of a plain number.

    **Arguments:** `text`: a class of Braun-Blanquet that is no plain number ("+", "2a", or "class
    3"), with a sociability or none ("+.2"), "<1", ">75", "5-10", or "trace".
    """
    word = text.strip().lower()
    name = "".join(word.removeprefix("class ").split())
    if (match := _SOCIABLE.fullmatch(name)) and match[1] not in _DIGITS:
        name = match[1]
    known = CLASSES.get(name)
    if known is not None and word not in _DIGITS:
        return known
    if _TRACE.fullmatch(word):
        return CLASSES["r"]
    if match := _LIMIT.fullmatch(word):
        value = _number(match[2])
        return (0.0, value) if match[1] in ("<", "≤", "<=") else (value, max(value, 100.0))
    if match := _RANGE.fullmatch(word):
        low, high = _number(match[1]), _number(match[2])
        return (low, high) if low < high else None
    return None


def _number(text: str) -> float:
    return float(text.replace(",", "."))


def name_classes(cells: Sequence[Any], *, stated: bool = False) -> list[Any]:
    """The column of covers of a table with its classes of Braun-Blanquet named as such.

    A plain 1 to 5 is a class where another cell is a class that is no number, such as "+" or "2a",
    and the rest are classes, traces, or 0; else it is percent, with a warning where it may be meant
    as a class all the same. A trace alone makes no classes. Where a cell such as "+.2" shows that a
    sociability stands behind the classes, 4.5 is class 4.

    **Arguments:** `cells`, as a table has them; `stated`: whether its heading says that these are
    classes of Braun-Blanquet.
    """
    words = [_plain(cell) for cell in cells]
    bare = [match[1] if (match := _SOCIABLE.fullmatch(word)) else word for word in words]
    if sociable := stated or any(b != w and b not in _DIGITS for b, w in zip(bare, words)):
        words = bare
    signs = [word for word in words if word in CLASSES and word not in _DIGITS]
    others = [
        word for word in words if word not in CLASSES and word != "0" and not _TRACE.fullmatch(word)
    ]
    if (signs or stated) and not others:
        return [f"class {w}" if w in _DIGITS else cell for w, cell in zip(words, cells)]
    words = [_plain(cell) for cell in cells]
    digits = [bool(re.fullmatch(r"[1-5]([.,][1-5])?", word)) for word in words]
    numbers = sum(bool(re.fullmatch(r"\d+([.,]\d+)?", word)) for word in words)
    whole = sum(word in _DIGITS for word in words)
    parts = sociable or (2 * whole >= numbers and any(word in ("2m", "2a", "2b") for word in signs))
    if any(digits) and (parts or (len(words) >= _FEW and all(digits))):
        warnings.warn(
            f"covers of {listed(dict.fromkeys(w for w, d in zip(words, digits) if d))} are taken "
            "for percent. Are they classes of Braun-Blanquet (2.3: 2, with a sociability)? Then "
            "write 'class 3' for 3",
            stacklevel=2,
        )
    return list(cells)


def _plain(cell: Any) -> str:
    """A cell in small letters; a whole number without its decimals."""
    word = "".join(str(cell).lower().split())
    return short if (short := word.removesuffix(".0")) in (*_DIGITS, "0") else word

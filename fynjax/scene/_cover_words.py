"""Covers as field crews write them: classes of Braun-Blanquet, limits, ranges and traces."""

import re
from collections.abc import Sequence
from typing import Any

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
_LIMIT = re.compile(r"(<|≤|<=|>|≥|>=)\s*(\d+[.,]?\d*)\s*%?")
_RANGE = re.compile(
    r"(\d+[.,]?\d*)\s*%?\s*(?:-|–|—|\.\.+|to|bis)\s*(\d+[.,]?\d*)\s*%?", re.IGNORECASE
)
_DIGITS = ("1", "2", "3", "4", "5")


def cover_range(text: str) -> tuple[float, float] | None:
    """Least and largest cover [%] that a word of a table stands for; `None` of a plain number.

    **Arguments:** `text`: a class of Braun-Blanquet that is no plain number ("+", "2a", or "class
    3"), "<1", ">75", "5-10", or "trace".
    """
    word = text.strip().lower()
    known = CLASSES.get(word.removeprefix("class ").strip())
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


def middle(low: float, high: float) -> float:
    """The cover taken for a range, its middle [%]."""
    return 0.5 * (low + high)


def name_classes(cells: Sequence[Any]) -> list[Any]:
    """The column of covers of a table with its classes of Braun-Blanquet named as such.

    A plain 1 to 5 is a class where the column holds nothing but classes and one of them is no
    number, such as "+" or "2a"; else it is percent.

    **Arguments:** `cells`, as a table has them.
    """
    words = [str(cell).strip().lower() for cell in cells]
    classes = all(word in CLASSES or _TRACE.fullmatch(word) for word in words)
    if not classes or all(word in _DIGITS for word in words):
        return list(cells)
    return [f"class {w}" if w in _DIGITS else cell for w, cell in zip(words, cells, strict=True)]

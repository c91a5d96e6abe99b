"""Docstrings as Markdown: examples stand as code, and `[x] [m]` is no link."""

import re
from typing import Any

import griffe

_EXAMPLE = re.compile(r"^((?:>>> .*\n?)(?:.+\n?)*)", re.MULTILINE)


def as_markdown(text: str) -> str:
    """A docstring with its examples fenced, and brackets side by side kept as text."""
    parts = _EXAMPLE.split(text)
    parts[::2] = [unlinked(part) for part in parts[::2]]
    parts[1::2] = [f"```pycon\n{part.rstrip()}\n```\n" for part in parts[1::2]]
    return "".join(parts)


def unlinked(text: str) -> str:
    """Words in which one bracket after another, outside code, makes no link."""
    parts = re.split(r"(`[^`]*`)", text)
    return "".join(p if p[:1] == "`" else re.sub(r"\](\s?)\[", r"]\1\\[", p) for p in parts)


class Docstrings(griffe.Extension):
    """Applies `as_markdown` to every object that has a docstring."""

    def on_instance(self, *, obj: Any, **_: Any) -> None:
        if obj.docstring is not None:
            obj.docstring.value = as_markdown(obj.docstring.value)

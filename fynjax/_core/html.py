"""What a notebook shows of an object that prints itself."""

import html
from typing import Any


def as_html(self: Any) -> str:
    """The text of an object as a notebook shows it (`_repr_html_ = as_html`)."""
    return f"<pre>{html.escape(str(self))}</pre>"

"""One HTML page, made from sections: pictures and a small script inside, no network.

Without JavaScript the page shows the same; with it pictures can be zoomed and moved, views of the
ground in one section all together; pictures of one place are shown one at a time, and rows of one
name are marked together in all tables and in all figures that have a row for each name. Dark where
the reader's system is; figures stay on white.
`page.html`, `page.css` and `page.js` beside this module hold what does not change.
"""

import base64
import json
import re
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
from jinja2 import Environment, FileSystemLoader, StrictUndefined

from fynjax.app.io.text import write_text
from fynjax.app.report import figures

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from PIL.Image import Image

_QUALITY = 88  # of WebP: figures' letters stay sharp
_NARROW = 640
"""Pixels of a picture's width above which a phone needs its panels one below the other."""
_UNITS = {
    "_percent": "%", "_deg": "°", "_nm": "nm",
    "_g_m2": "g m⁻²", "_per_m2": "m⁻²", "_m2": "m²", "_m": "m",
}  # fmt: skip
"""Units by the ends of columns' names."""


def format_number(value: float, digits: int = 4) -> str:
    """A `value` as text: `digits` significant digits, no trailing zeros, – for NaN."""
    if not np.isfinite(value):
        return "–"
    if value == 0:
        return "0"
    if not 1e-4 <= abs(value) < 1e6:
        return f"{value:.{digits - 1}e}".replace("-", "−")
    decimals = max(digits - 1 - int(np.floor(np.log10(abs(value)))), 0)
    text = f"{value:.{decimals}f}"
    text = text.rstrip("0").rstrip(".") if "." in text else text
    return text.replace("-", "−")


def _cell(value: object, digits: int) -> str:
    if value is None or value is pd.NA or (isinstance(value, float) and np.isnan(value)):
        return "–"
    if isinstance(value, (bool, np.bool_)):
        return "yes" if value else "no"
    if isinstance(value, (int, np.integer)):
        return str(int(value)).replace("-", "−")
    if isinstance(value, (float, np.floating)):
        return format_number(float(value), digits)
    return str(value)


@dataclass(frozen=True)
class Picture:
    """A figure with the file that it becomes."""

    file: str
    """Name of the file in the folder of results (PNG)."""
    figure: "Figure"
    what: str
    """Description of the file, for the list of files."""
    caption: str = ""
    """Below the figure on the page; `what` as a sentence if left out."""

    def write(self, folder: Path) -> None:
        """Write the file into `folder`, whole or not at all."""
        figures.save_figure(self.figure, folder / self.file)


@dataclass(frozen=True)
class Table:
    """A table of a page."""

    rows: pd.DataFrame
    caption: str = ""
    units: Mapping[str, str] = field(default_factory=dict)
    """Units by column, below headers; those that names of columns end with need not be said."""
    headers: Mapping[str, str] = field(default_factory=dict)
    """Headers by column; one without shows its name without unit and underscores."""
    digits: int = 4
    """Significant digits of numbers."""
    folded: bool = False
    """Whether the table is hidden behind its caption."""

    def header(self, column: object) -> tuple[str, str]:
        """Header and unit of a column, such as "relief" and "m" of relief_m; "" without a unit."""
        name = str(column)
        ending = next((end for end in _UNITS if name.endswith(end)), "")
        words = self.headers.get(name) or name.removesuffix(ending).replace("_", " ")
        return words, self.units.get(name) or _UNITS.get(ending, "")

    @property
    def text_columns(self) -> list[Any]:
        """Columns that hold no numbers, in their order."""
        return [c for c in self.rows if not pd.api.types.is_numeric_dtype(self.rows[c])]


@dataclass(frozen=True)
class Views:
    """Pictures of one place, of which a reader chooses the one to see: bands, colours, indices."""

    pictures: Mapping[str, Picture]
    """Pictures by the labels of their buttons; the first is seen first."""


Part = str | Picture | Views | Table
"""A paragraph, a figure, figures to choose from, or a table."""


@dataclass(frozen=True)
class Section:
    """Part of a page under a heading; without a title it has no heading."""

    title: str
    parts: Sequence[Part]


@dataclass(frozen=True)
class Page:
    """What a page shows, from top to bottom. Every text is escaped: none can become markup.

    It begins with three lines: the result, whether it may be trusted, and what to do next, the last
    two of `answers.toml` beside this module where the page does not say them.
    """

    command: str
    """Command that wrote the page, such as "render": a key of `answers.toml`."""
    title: str
    lead: str
    """All of the result in words; its first sentence is the first line."""
    sections: Sequence[Section]
    key_figures: Mapping[str, str] = field(default_factory=dict)
    """The numbers that matter most, shown large: value by what it is."""
    record: Mapping[str, Any] = field(default_factory=dict)
    """Record of how the page was made, as `fynjax.app.io.raster.provenance` has it."""
    result: str = ""
    """The first line, where it is not the lead's first sentence."""
    trust: str = ""
    """The second line, where the run itself knows."""

    @property
    def answer(self) -> dict[str, str]:
        """The three lines, by what they answer."""
        said = _ANSWERS[self.command]
        first = self.result or re.split(r"(?<=[.!?])\s+(?=[A-Z0-9])", self.lead)[0]
        return dict(zip(_ASKED, (first, self.trust or said["trust"], said["next"]), strict=True))

    @property
    def provenance(self) -> dict[str, Any]:
        """The record, each input with its hash as a row of its own."""
        hashes = json.loads(str(self.record.get("input_sha256", "{}")))
        rows = {k: v for k, v in self.record.items() if k != "input_sha256"}
        return rows | {f"SHA-256 of {name}": value for name, value in hashes.items()}


def write_page(page: Page, folder: Path) -> dict[str, str]:
    """Write `page`, as report.html, and its pictures into `folder`, which is made if missing.

    **Returns:** a description of each file, by its name.
    """
    parts = [part for section in page.sections for part in section.parts]
    pictures = [part for part in parts if isinstance(part, Picture)]
    pictures += [p for part in parts if isinstance(part, Views) for p in part.pictures.values()]
    for picture in pictures:
        picture.write(folder)
    shown = {picture.file: _shown(picture, folder) for picture in pictures}
    template = _ENVIRONMENT.get_template("page.html")
    write_text(folder / "report.html", template.render(page=page, shown=shown) + "\n")
    return {"report.html": "all of it on one page"} | {p.file: p.what for p in pictures}


def _shown(picture: Picture, folder: Path) -> dict[str, Any]:
    """A picture as a page holds it: its address, its width [pixels], its named rows, its views of
    the ground, and of a wide one what a phone shows: its panels below each other."""
    from PIL.Image import fromarray  # late: a dry run shows no picture
    from PIL.Image import open as open_image

    png = (folder / picture.file).read_bytes()
    with open_image(BytesIO(png)) as read:
        whole = read.convert("RGB")
    rows, grounds = figures.named_rows(picture.figure), figures.ground_panels(picture.figure)
    narrow = []
    if whole.width > _NARROW:
        parts = figures.stacked_panels(picture.figure, _NARROW / figures.FIGURE_DPI)
        narrow = [(_address(fromarray(part)), round(0.66 * part.shape[1])) for part in parts]
    return {
        "source": _address(whole, png),
        "width": whole.width,
        "rows": rows,
        "grounds": grounds,
        "narrow": narrow,
    }


def _address(image: "Image", png: bytes = b"") -> str:
    """An image as an address: as WebP, of which pictures of plots take a quarter of their `png`, or
    as that where it is smaller."""
    webp = BytesIO()
    image.save(webp, "WEBP", quality=_QUALITY, method=3)
    smaller = 0 < len(png) < len(webp.getvalue())
    kind, data = ("png", png) if smaller else ("webp", webp.getvalue())
    return f"data:image/{kind};base64,{base64.b64encode(data).decode('ascii')}"


_ASKED = "Result", "May it be trusted?", "What next?"
_ANSWERS = tomllib.loads((Path(__file__).parent / "answers.toml").read_text("utf-8"))
_ENVIRONMENT = Environment(
    loader=FileSystemLoader(Path(__file__).parent), autoescape=True, undefined=StrictUndefined
)
_ENVIRONMENT.filters |= {"cell": _cell, "units": lambda text: figures.typeset(text)}

"""One HTML page, made from sections: pictures and a small script inside, no network.

Without JavaScript the page shows the same; with it pictures can be zoomed and moved, those of
one place are shown one at a time, and rows of one name are marked together in all tables and in
all figures that have a row for each name. Dark where the reader's system is; figures stay on white.
"""

import base64
import html
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from PIL import Image

from fynjax.io.text import write_text
from fynjax.report.figures import FIGURE_DPI, named_rows, save_figure

_QUALITY = 88  # of WebP: figures' letters stay sharp

_CSS = """
:root { color-scheme: light dark; --page: #fff; --ink: #1d1d1b; --soft: #50504a; --line: #dcdcd8;
  --plate: #f4f5f1; --edge: #8a8a84; --same: #ffe9a8; }
@media screen and (prefers-color-scheme: dark) { :root { --page: #191a18; --ink: #ecece6;
  --soft: #b4b4ac; --line: #3c3d39; --plate: #282a26; --edge: #85857e; --same: #5c4a12; }
  .picture { border-radius: .4rem; overflow: hidden; filter: brightness(.92); } }
* { box-sizing: border-box; }
body { margin: 0; background: var(--page); color: var(--ink);
  font: 16px/1.55 system-ui, -apple-system, "Segoe UI", Roboto, "Helvetica Neue", sans-serif; }
main { max-width: 62rem; margin: 0 auto; padding: 1.2rem 1rem 3rem; }
h1 { font-size: 1.7rem; line-height: 1.2; margin: .6rem 0 .2rem; }
h2 { font-size: 1.2rem; margin: 2.4rem 0 .5rem; padding-top: .6rem;
  border-top: 1px solid var(--line); }
p { max-width: 44rem; margin: .5rem 0; }
.lead { color: var(--soft); }
.keys { display: grid; grid-template-columns: repeat(auto-fit, minmax(10.5rem, 1fr)); gap: .6rem;
  margin: 1rem 0; }
.key { background: var(--plate); border-radius: .4rem; padding: .6rem .8rem; }
.key b { display: block; font-size: 1.35rem; line-height: 1.3; font-weight: 600; }
.key span { font-size: .85rem; color: var(--soft); }
figure { margin: 1rem 0 1.6rem; }
.picture { position: relative; max-width: 100%; transform-origin: 0 0; user-select: none; }
.picture img { width: 100%; height: auto; display: block; }
.picture i { position: absolute; border-radius: 2px; }
.picture i.same { background: #ffc40066; }
figcaption, .caption { font-size: .9rem; color: var(--soft); max-width: 44rem; margin: .4rem 0; }
.scroll { overflow-x: auto; margin: .6rem 0 1.2rem; }
table { border-collapse: collapse; font-size: .86rem; font-variant-numeric: tabular-nums; }
th, td { padding: .25rem .7rem .25rem 0; text-align: right; white-space: nowrap;
  border-bottom: 1px solid var(--line); }
th { white-space: normal; vertical-align: bottom; border-bottom: 1.5px solid var(--edge);
  font-weight: 600; }
th small { display: block; font-weight: 400; color: var(--soft); }
th.text, td.text { text-align: left; }
details { margin: .6rem 0; }
summary { cursor: pointer; }
footer { margin-top: 2.5rem; font-size: .8rem; color: var(--soft);
  border-top: 1px solid var(--line); }
footer dl { display: grid; grid-template-columns: auto 1fr; gap: .1rem .8rem; }
footer dt { font-weight: 600; } footer dd { margin: 0; overflow-wrap: anywhere; }
.view { overflow: hidden; max-width: 100%; width: fit-content; cursor: zoom-in; }
.view.zoomed { cursor: grab; touch-action: none; }
tr.same td { background: var(--same); }
.choose { display: flex; flex-wrap: wrap; gap: .4rem; margin: 1rem 0 0; }
.choose button { font: inherit; font-size: .9rem; padding: .35rem .8rem; cursor: pointer;
  color: inherit; background: var(--plate); border: 1px solid var(--edge); border-radius: .4rem; }
.choose button[aria-pressed="true"] {
  background: var(--ink); border-color: var(--ink); color: var(--page); }
@media print { .choose { display: none; } .views figure { display: block !important; } }
@media print { .picture { transform: none !important; }
  body { font-size: 10pt; } main { max-width: none; padding: 0; }
  figure, tr, .key { break-inside: avoid; } h2 { break-after: avoid; }
  .scroll { overflow: visible; }
  table { font-size: 7.5pt; } th, td { white-space: normal; } }
"""

_SCRIPT = """
for (const image of document.querySelectorAll(".picture")) {
  const view = document.createElement("div");
  let scale = 1, x = 0, y = 0, held = null;
  view.className = "view";
  view.title = "Double-click: larger (with Shift: all of it). Ctrl and wheel: zoom. Drag: move.";
  image.replaceWith(view);
  view.append(image);
  image.firstElementChild.draggable = false;
  const show = () => {
    x = Math.min(0, Math.max(x, view.clientWidth * (1 - scale)));
    y = Math.min(0, Math.max(y, view.clientHeight * (1 - scale)));
    image.style.transform = `translate(${x}px, ${y}px) scale(${scale})`;
    view.classList.toggle("zoomed", scale > 1);
  };
  const zoom = (event, wanted) => {
    const next = Math.min(16, Math.max(1, wanted)), at = view.getBoundingClientRect();
    x = event.clientX - at.left - (event.clientX - at.left - x) * next / scale;
    y = event.clientY - at.top - (event.clientY - at.top - y) * next / scale;
    scale = next;
    show();
  };
  view.addEventListener("dblclick", e => zoom(e, e.shiftKey ? 1 : 2 * scale));
  view.addEventListener("wheel", e => {
    if (!e.ctrlKey && !e.metaKey) return;
    e.preventDefault();
    zoom(e, scale * Math.exp(-0.002 * e.deltaY));
  }, {passive: false});
  view.addEventListener("pointerdown", e => {
    if (scale === 1) return;
    held = [e.clientX - x, e.clientY - y];
    view.setPointerCapture(e.pointerId);
  });
  view.addEventListener("pointermove", e => {
    if (held) { x = e.clientX - held[0]; y = e.clientY - held[1]; show(); }
  });
  for (const end of ["pointerup", "pointercancel"]) view.addEventListener(end, () => held = null);
}
for (const views of document.querySelectorAll(".views")) {
  const figures = [...views.children], bar = document.createElement("div");
  bar.className = "choose";
  const choose = chosen => figures.forEach((figure, i) => {
    figure.style.display = i === chosen ? "" : "none";
    bar.children[i].setAttribute("aria-pressed", i === chosen);
  });
  figures.forEach((figure, i) => {
    const button = document.createElement("button");
    button.type = "button";
    button.textContent = figure.dataset.label;
    button.addEventListener("click", () => choose(i));
    bar.append(button);
  });
  views.prepend(bar);
  choose(0);
}
const rows = [...document.querySelectorAll("[data-name]")];
for (const row of rows) for (const enter of [true, false])
  row.addEventListener(enter ? "mouseenter" : "mouseleave", () => {
    for (const other of rows)
      if (other.dataset.name === row.dataset.name) other.classList.toggle("same", enter);
  });
"""


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


def _cell(value: Any, digits: int) -> str:
    if value is None or value is pd.NA or (isinstance(value, float) and np.isnan(value)):
        return "–"
    if isinstance(value, (bool, np.bool_)):
        return "yes" if value else "no"
    if isinstance(value, (int, np.integer)):
        return str(int(value)).replace("-", "−")
    if isinstance(value, (float, np.floating)):
        return format_number(float(value), digits)
    return html.escape(str(value))


@dataclass(frozen=True)
class Picture:
    """A figure with the file that it becomes."""

    file: str
    """Name of the file in the folder of results (PNG)."""
    figure: Figure
    what: str
    """What the file is, for the list of files."""
    caption: str = ""
    """Below the figure on the page; `what` as a sentence if left out."""

    def write(self, folder: Path) -> None:
        """Write the file into `folder`, whole or not at all."""
        save_figure(self.figure, folder / self.file)


@dataclass(frozen=True)
class Table:
    """A table of a page."""

    rows: pd.DataFrame
    caption: str = ""
    units: Mapping[str, str] = field(default_factory=dict)
    """By column, shown below its header."""
    headers: Mapping[str, str] = field(default_factory=dict)
    """By column; one without a header shows its name with spaces for underscores."""
    digits: int = 4
    """Significant digits of numbers."""
    folded: bool = False
    """Whether the table is hidden behind its caption."""


@dataclass(frozen=True)
class Views:
    """Pictures of one place, of which a reader chooses the one to see: bands, colours, indices."""

    pictures: Mapping[str, Picture]
    """By the label of its button; the first is seen first."""


Part = str | Picture | Views | Table
"""A paragraph, a figure, figures to choose from, or a table."""


@dataclass(frozen=True)
class Section:
    """Part of a page under a heading; without a title it has no heading."""

    title: str
    parts: Sequence[Part]


@dataclass(frozen=True)
class Page:
    """What a page shows, from top to bottom. Every text is escaped: none can become markup."""

    title: str
    lead: str
    sections: Sequence[Section]
    key_figures: Mapping[str, str] = field(default_factory=dict)
    """The numbers that matter most, shown large: value by what it is."""
    record: Mapping[str, Any] = field(default_factory=dict)
    """How the page came to be, as `fynjax.io.raster.provenance` has it."""


def write_page(page: Page, folder: Path, file: str = "report.html") -> dict[str, str]:
    """Write a page and its pictures into a folder.

    **Arguments:** `page`; `folder`, made if missing; `file`, name of the page.

    **Returns:** a description of each file, by its name.
    """
    files = {file: "all of it on one page"}
    title = html.escape(page.title)
    body = [f"<h1>{title}</h1>"]
    if page.lead:
        body.append(f'<p class="lead">{html.escape(page.lead)}</p>')
    if page.key_figures:
        cells = "".join(
            f'<div class="key"><b>{html.escape(value)}</b><span>{html.escape(what)}</span></div>'
            for what, value in page.key_figures.items()
        )
        body.append(f'<div class="keys">{cells}</div>')
    for section in page.sections:
        if section.title:
            body.append(f"<h2>{html.escape(section.title)}</h2>")
        for part in section.parts:
            pictures = part.pictures if isinstance(part, Views) else {}
            for picture in (part,) if isinstance(part, Picture) else pictures.values():
                picture.write(folder)
                files[picture.file] = picture.what
            if isinstance(part, Picture):
                body.append(_picture(part, folder))
            elif isinstance(part, Views):
                shown = "".join(_picture(p, folder, label) for label, p in pictures.items())
                body.append(f'<div class="views">{shown}</div>')
            else:
                body.append(_table(part) if isinstance(part, Table) else _paragraph(part))
    body.append(_footer(page.record))
    text = (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{title}</title><style>{_CSS}</style></head>\n<body><main>\n"
        + "\n".join(body)
        + f"\n</main><script>{_SCRIPT}</script></body></html>\n"
    )
    write_text(folder / file, text)
    return files


def _paragraph(text: str) -> str:
    return f"<p>{html.escape(text)}</p>"


def _picture(picture: Picture, folder: Path, label: str = "") -> str:
    png = (folder / picture.file).read_bytes()
    inches = int.from_bytes(png[16:20], "big") / FIGURE_DPI  # the width in a PNG's header
    caption = picture.caption or f"{picture.what[0].upper()}{picture.what[1:]}."
    text = html.escape(caption, quote=True)
    kind, data = _small(png)
    mark = f' data-label="{html.escape(label, quote=True)}"' if label else ""
    rows = "".join(
        f'<i data-name="{html.escape(name, quote=True)}" style="left: {100 * left:.2f}%; '
        f'top: {100 * top:.2f}%; width: {100 * wide:.2f}%; height: {100 * high:.2f}%"></i>'
        for name, (left, top, wide, high) in named_rows(picture.figure)
    )
    return (
        f'<figure{mark}><div class="picture" style="width: {inches * 105:.0f}px">'
        f'<img alt="{text}" src="data:image/{kind};base64,{data}">{rows}</div>'
        f"<figcaption>{text}</figcaption></figure>"
    )


def _small(png: bytes) -> tuple[str, str]:
    """A picture as a page holds it: its kind and its bytes in base 64. Pictures of plots as WebP
    take a quarter of their PNG, which lies beside the page as a file."""
    webp = BytesIO()
    with Image.open(BytesIO(png)) as image:
        image.convert("RGB").save(webp, "WEBP", quality=_QUALITY, method=3)
    kind, data = min(("png", png), ("webp", webp.getvalue()), key=lambda one: len(one[1]))
    return kind, base64.b64encode(data).decode("ascii")


def _table(table: Table) -> str:
    rows = table.rows
    text = {c for c in rows.columns if not pd.api.types.is_numeric_dtype(rows[c])}
    head = "".join(
        f"<th{_class(c in text)}>"
        + html.escape(table.headers.get(c, str(c).replace("_", " ")))
        + (f"<small>[{html.escape(table.units[c])}]</small>" if c in table.units else "")
        + "</th>"
        for c in rows.columns
    )
    columns: Sequence[Any] = list(rows.columns)
    named = next((i for i, c in enumerate(columns) if c in text), None)
    body = "".join(
        f"<tr{_row_name(row, named)}>"
        + "".join(
            f"<td{_class(c in text)}>{_cell(value, table.digits)}</td>"
            for c, value in zip(columns, row, strict=True)
        )
        + "</tr>"
        for row in rows.itertuples(index=False, name=None)
    )
    grid = (
        f'<div class="scroll"><table><thead><tr>{head}</tr></thead>'
        f"<tbody>{body}</tbody></table></div>"
    )
    caption = html.escape(table.caption)
    if table.folded:
        return f"<details><summary>{caption or 'Table'}</summary>{grid}</details>"
    return f'<p class="caption">{caption}</p>{grid}' if caption else grid


def _footer(record: Mapping[str, Any]) -> str:
    rows = "".join(
        f"<dt>{html.escape(str(k).replace('_', ' '))}</dt><dd>{html.escape(str(v))}</dd>"
        for k, v in record.items()
    )
    return f"<footer><dl>{rows}</dl></footer>"


def _row_name(row: Sequence[Any], column: int | None) -> str:
    """The attribute that rows of one name share: the first text of the row."""
    if column is None:
        return ""
    return f' data-name="{html.escape(str(row[column]), quote=True)}"'


def _class(is_text: bool) -> str:
    return ' class="text"' if is_text else ""

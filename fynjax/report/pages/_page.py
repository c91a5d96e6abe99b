"""One HTML page that needs nothing else: pictures inside, no scripts, no network."""

import base64
import html
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from fynjax.io.text import write_text
from fynjax.report.figures import FIGURE_DPI

_CSS = """
:root { color-scheme: light; }
* { box-sizing: border-box; }
body { margin: 0; background: #fff; color: #1d1d1b;
  font: 16px/1.55 system-ui, -apple-system, "Segoe UI", Roboto, "Helvetica Neue", sans-serif; }
main { max-width: 62rem; margin: 0 auto; padding: 1.2rem 1rem 3rem; }
h1 { font-size: 1.7rem; line-height: 1.2; margin: .6rem 0 .2rem; }
h2 { font-size: 1.2rem; margin: 2.4rem 0 .5rem; padding-top: .6rem; border-top: 1px solid #d8d8d4; }
p { max-width: 44rem; margin: .5rem 0; }
.lead { color: #55554f; }
.keys { display: grid; grid-template-columns: repeat(auto-fit, minmax(10.5rem, 1fr)); gap: .6rem;
  margin: 1rem 0; }
.key { background: #f4f5f1; border-radius: .4rem; padding: .6rem .8rem; }
.key b { display: block; font-size: 1.35rem; line-height: 1.3; font-weight: 600; }
.key span { font-size: .85rem; color: #55554f; }
figure { margin: 1rem 0 1.6rem; }
figure img { max-width: 100%; height: auto; display: block; }
figcaption, .caption { font-size: .9rem; color: #44443f; max-width: 44rem; margin: .4rem 0; }
.scroll { overflow-x: auto; margin: .6rem 0 1.2rem; }
table { border-collapse: collapse; font-size: .86rem; font-variant-numeric: tabular-nums; }
th, td { padding: .25rem .7rem .25rem 0; text-align: right; white-space: nowrap;
  border-bottom: 1px solid #ebebe7; }
th { vertical-align: bottom; border-bottom: 1.5px solid #8a8a84; font-weight: 600; }
th small { display: block; font-weight: 400; color: #66665f; }
th.text, td.text { text-align: left; }
details { margin: .6rem 0; }
summary { cursor: pointer; }
footer { margin-top: 2.5rem; font-size: .8rem; color: #66665f; border-top: 1px solid #d8d8d4; }
footer dl { display: grid; grid-template-columns: auto 1fr; gap: .1rem .8rem; }
footer dt { font-weight: 600; } footer dd { margin: 0; overflow-wrap: anywhere; }
@media print { body { font-size: 10pt; } main { max-width: none; padding: 0; }
  figure, tr, .key { break-inside: avoid; } h2 { break-after: avoid; }
  .scroll { overflow: visible; }
  table { font-size: 7.5pt; } th, td { white-space: normal; } }
"""


def format_number(value: float, digits: int = 4) -> str:
    """A number for a reader: `digits` significant digits, no needless zeros, – for none."""
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


class Page:
    """A report that grows from top to bottom and is written at the end.

    Every text is escaped; nothing a user names can become markup.
    """

    def __init__(self, title: str, lead: str = "") -> None:
        self._title = html.escape(title)
        self._parts = [f"<h1>{self._title}</h1>"]
        if lead:
            self._parts.append(f'<p class="lead">{html.escape(lead)}</p>')

    def section(self, title: str) -> "Page":
        """A heading."""
        self._parts.append(f"<h2>{html.escape(title)}</h2>")
        return self

    def paragraph(self, text: str) -> "Page":
        """A paragraph."""
        self._parts.append(f"<p>{html.escape(text)}</p>")
        return self

    def key_figures(self, figures: Mapping[str, str]) -> "Page":
        """The numbers that matter most, large: value by what it is."""
        cells = "".join(
            f'<div class="key"><b>{html.escape(value)}</b><span>{html.escape(what)}</span></div>'
            for what, value in figures.items()
        )
        self._parts.append(f'<div class="keys">{cells}</div>')
        return self

    def figure(self, path: str | Path, caption: str) -> "Page":
        """A figure that `save_figure` wrote as PNG, with its caption."""
        png = Path(path).read_bytes()
        inches = int.from_bytes(png[16:20], "big") / FIGURE_DPI  # the width in a PNG's header
        text = html.escape(caption, quote=True)
        data = base64.b64encode(png).decode("ascii")
        self._parts.append(
            f'<figure><img style="width: {inches * 105:.0f}px" alt="{text}" '
            f'src="data:image/png;base64,{data}"><figcaption>{text}</figcaption></figure>'
        )
        return self

    def table(
        self,
        table: pd.DataFrame,
        *,
        caption: str = "",
        units: Mapping[str, str] | None = None,
        headers: Mapping[str, str] | None = None,
        digits: int = 4,
        folded: bool = False,
    ) -> "Page":
        """A table, numbers to `digits` significant digits.

        **Arguments:** `units` and `headers` by column name; a column without a header shows its
        name with spaces for underscores. `folded` hides a long table behind its caption.
        """
        units, headers = units or {}, headers or {}
        text = {c for c in table.columns if not pd.api.types.is_numeric_dtype(table[c])}
        head = "".join(
            f"<th{_class(c in text)}>{html.escape(headers.get(c, str(c).replace('_', ' ')))}"
            + (f"<small>[{html.escape(units[c])}]</small>" if c in units else "")
            + "</th>"
            for c in table.columns
        )
        columns: Sequence[Any] = list(table.columns)
        body = "".join(
            "<tr>"
            + "".join(
                f"<td{_class(c in text)}>{_cell(value, digits)}</td>"
                for c, value in zip(columns, row, strict=True)
            )
            + "</tr>"
            for row in table.itertuples(index=False, name=None)
        )
        grid = (
            f'<div class="scroll"><table><thead><tr>{head}</tr></thead>'
            f"<tbody>{body}</tbody></table></div>"
        )
        label = html.escape(caption)
        if folded:
            grid = f"<details><summary>{label or 'Table'}</summary>{grid}</details>"
        elif caption:
            grid = f'<p class="caption">{label}</p>{grid}'
        self._parts.append(grid)
        return self

    def footer(self, entries: Mapping[str, Any]) -> "Page":
        """How the page came to be, such as the record of `fynjax.io.provenance`."""
        rows = "".join(
            f"<dt>{html.escape(str(k).replace('_', ' '))}</dt><dd>{html.escape(str(v))}</dd>"
            for k, v in entries.items()
        )
        self._parts.append(f"<footer><dl>{rows}</dl></footer>")
        return self

    def html(self) -> str:
        """The page as text."""
        return (
            '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
            '<meta name="viewport" content="width=device-width, initial-scale=1">'
            f"<title>{self._title}</title><style>{_CSS}</style></head>\n<body><main>\n"
            + "\n".join(self._parts)
            + "\n</main></body></html>\n"
        )

    def write(self, path: str | Path) -> None:
        """Write the page, whole or not at all."""
        write_text(path, self.html())


def _class(is_text: bool) -> str:
    return ' class="text"' if is_text else ""

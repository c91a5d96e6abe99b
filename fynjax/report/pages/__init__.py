"""The HTML page of a run, from sections."""

from fynjax.report.pages._page import (
    Page,
    Part,
    Picture,
    Section,
    Table,
    Views,
    format_number,
    write_page,
)
from fynjax.report.pages._sensors import sensor_section
from fynjax.report.pages._structure import structure_section
from fynjax.report.pages._validation import drone_section, published_section, spectral_section

__all__ = [
    "Page",
    "Part",
    "Picture",
    "Section",
    "Table",
    "Views",
    "drone_section",
    "format_number",
    "published_section",
    "sensor_section",
    "spectral_section",
    "structure_section",
    "write_page",
]

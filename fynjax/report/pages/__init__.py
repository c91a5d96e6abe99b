"""The HTML page of a run, from sections."""

from fynjax.report.pages._page import Page, format_number
from fynjax.report.pages._sensors import sensor_figure, sensor_headline, sensor_section
from fynjax.report.pages._structure import structure_headline, structure_section
from fynjax.report.pages._validation import (
    Files,
    drone_headline,
    drone_section,
    published_section,
    spectral_headline,
    spectral_section,
    told,
)

__all__ = [
    "Files",
    "Page",
    "drone_headline",
    "drone_section",
    "format_number",
    "published_section",
    "sensor_figure",
    "sensor_headline",
    "sensor_section",
    "spectral_headline",
    "spectral_section",
    "structure_headline",
    "structure_section",
    "told",
]

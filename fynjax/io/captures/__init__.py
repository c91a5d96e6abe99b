"""Raw captures of multispectral cameras (MicaSense, DJI) and of their reference panels."""

from fynjax.io.captures._camera_place import CameraPlace, on_earth
from fynjax.io.captures._capture import (
    AlignedCapture,
    Capture,
    aligned_radiance,
    find_captures,
    read_capture,
    same_capture,
    usable_captures,
)
from fynjax.io.captures._panel import PanelView, panel_reflectance, read_panel

__all__ = [
    "AlignedCapture",
    "CameraPlace",
    "Capture",
    "PanelView",
    "aligned_radiance",
    "find_captures",
    "on_earth",
    "panel_reflectance",
    "read_capture",
    "read_panel",
    "same_capture",
    "usable_captures",
]

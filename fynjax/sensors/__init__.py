"""Sensors: spectral bands and the lines of sight of their pixels."""

from fynjax.sensors._bands import BandSet, mavic_3m
from fynjax.sensors._camera import (
    AbstractCamera,
    FrameCamera,
    OrthographicCamera,
    check_ground_sample_distance,
    mavic_3m_camera,
    mavic_3m_paper_camera,
)

__all__ = [
    "AbstractCamera",
    "BandSet",
    "FrameCamera",
    "OrthographicCamera",
    "check_ground_sample_distance",
    "mavic_3m",
    "mavic_3m_camera",
    "mavic_3m_paper_camera",
]

"""Cameras against the numbers of their makers, and what cannot be one."""

import pytest

from fynjax._core.errors import InputError
from fynjax.sensors import FrameCamera, OrthographicCamera, PushbroomCamera, shipped_sensor


def frame(**changes: object) -> FrameCamera:
    settings: dict = {
        "position": (5.0, 4.0, 50.0),
        "focal_length_mm": 4.0,
        "pixel_pitch_um": 2.0,
        "array": (8, 6),
    }
    return FrameCamera(**{**settings, **changes})


def test_paper_and_maker_cameras() -> None:
    """Table 2 of the paper, and DJI's own 2170 px focal length."""
    paper, maker = (shipped_sensor(name).camera for name in ("mavic_3m_paper", "mavic_3m"))
    assert paper.shape == (480, 640)
    assert maker.shape == (1944, 2592)
    assert float(paper.pixel_at(50.0)) == pytest.approx(0.025, rel=1e-12)
    assert float(maker.pixel_at(50.0)) == pytest.approx(50.0 / 2170.0, rel=1e-12)
    assert float(frame().ground_sample_distance) == pytest.approx(0.025, rel=1e-12)


def test_bad_views() -> None:
    with pytest.raises(InputError, match="one row"):
        PushbroomCamera(frame())
    with pytest.raises(InputError, match="gimbal"):
        frame(tilt=-90.0)
    with pytest.raises(InputError, match="view_zenith"):
        OrthographicCamera(0.5, 90.0)

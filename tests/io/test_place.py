"""Pictures laid on Earth by position, height and heading of the camera."""

import numpy as np
import pytest
from pyproj import Geod, Transformer

from fynjax.app.io.captures import CameraPlace, on_earth
from fynjax.app.io.captures._band import Stated
from fynjax.app.io.captures._micasense import _place
from fynjax.app.io.raster import Cube

SIDE = 0.2


@pytest.mark.parametrize(
    ("latitude", "longitude", "heading"),
    [(-33.95, 18.1, 0.0), (57.0, 11.9, 205.0), (-54.8, 17.9, -70.0)],
)
def test_pixels_lie_where_a_walk_from_below_the_camera_leads(latitude, longitude, heading) -> None:
    """Forward along the heading, and to its right, on the ellipsoid; the first near the edge of a
    zone, whose grid is turned by 2.4 degrees against the meridian."""
    values = np.indices((300, 400)).astype(float)
    nm = np.array([560.0, 860.0])
    cube = Cube(values, ("a", "b"), nm, nm / 20, np.ones(2, bool), SIDE, (0.0, 0.0))
    middle = (190.0, 160.0)
    laid = on_earth(cube, CameraPlace(latitude, longitude, heading, 1.0), middle)
    zone = int((longitude + 180.0) // 6.0) + 1
    assert laid.crs == f"EPSG:{(32600 if latitude > 0 else 32700) + zone}"
    to_zone = Transformer.from_crs(4326, laid.crs, always_xy=True)
    for forward, right in ((0, 0), (130, 0), (-150, 0), (0, 200), (0, -180), (80, -120)):
        x, y, _ = Geod(ellps="WGS84").fwd(
            longitude, latitude, heading + np.degrees(np.arctan2(right, forward)),
            SIDE * np.hypot(forward, right),
        )  # fmt: skip
        east, north = to_zone.transform(x, y)
        column = int((east - laid.origin_m[0]) // SIDE)
        row = int((north - laid.origin_m[1]) // SIDE)
        seen = laid.values[:, row, column]
        np.testing.assert_allclose(seen, (160 + forward, 190 + right), atol=1.1)
    known = np.isfinite(laid.values).all(axis=0)
    assert known.sum() == pytest.approx(values[0].size, rel=0.01)


def test_the_place_of_a_micasense() -> None:
    tags = {
        "EXIF_GPSLatitude": "(36) (34) (33.8934)", "EXIF_GPSLatitudeRef": "N",
        "EXIF_GPSLongitude": "(119) (26) (6.93744)", "EXIF_GPSLongitudeRef": "W",
    }  # fmt: skip
    place = _place(Stated({"IrradianceYaw": ["-21.1"]}, tags))
    assert place is not None
    assert place.latitude == pytest.approx(36.576081, abs=1e-6)
    assert place.longitude == pytest.approx(-119.435260, abs=1e-6)
    assert place.heading == -21.1
    # From 70 m an axis that is off by 5 degrees looks 6.1 m past what is below.
    assert place.spread(70.0) == pytest.approx(np.hypot(3.0, 6.124), rel=1e-3)
    assert _place(Stated({}, tags)) is None
    tags["EXIF_GPSLatitude"] = tags["EXIF_GPSLongitude"] = "(0) (0) (0)"
    assert _place(Stated({"IrradianceYaw": ["-21.1"]}, tags)) is None

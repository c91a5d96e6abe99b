"""The air between sun, ground and sensor: atmospheres, the clear sky, the place of the sun."""

from fynjax.sensors.air._atmosphere import (
    SPACE,
    Atmosphere,
    ClearAir,
    at_sensor_radiance,
    band_atmosphere,
    is_transparent,
    surface_reflectance,
)
from fynjax.sensors.air._sixs_table import check_within_table, tabulated_atmosphere
from fynjax.sensors.air._spectrl2 import clear_sky_atmosphere, clear_sky_diffuse_fraction
from fynjax.sensors.air._sun import SunPosition, sun_position

__all__ = ["Atmosphere", "ClearAir", "SunPosition", "sun_position"]
